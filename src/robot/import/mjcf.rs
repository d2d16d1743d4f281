//! Masses, joints, motors and collision shapes of an MJCF file, the format of MuJoCo. Meshes are not read.
//!
//! Follows the XML reference of MuJoCo 3: classes of defaults, `<frame>`, `<include>`, several joints per body, and angles in degrees unless
//! `<compiler>` says otherwise. The robot is the body in the world below which most joints move, with all bodies that it carries. Joints of
//! this body itself place the robot in the world; they are held at zero.

use super::body::composite;
use super::model::{Collision, Inertial, Joint, Link, Mimic, Model, Motion, Shape};
use super::solid::Solid;
use super::xml::{MAX_FILE, document, line, list, number, numbers, place, scalar, shortened, size, text};
use crate::error::{Error, Result};
use crate::files;
use crate::robot::leg::joint_motion;
use nalgebra::{Isometry3, Matrix3, Quaternion, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};
use roxmltree::{Document, Node};
use std::collections::HashSet;
use std::path::Path;

/// Deepest nesting of bodies, frames and classes.
const DEEPEST: usize = 200;
/// Largest number of included files.
const MAX_INCLUDES: usize = 100;
/// Attributes that give an orientation.
const ORIENTATIONS: [&str; 5] = ["quat", "axisangle", "euler", "xyaxes", "zaxis"];
/// Elements with bodies that are not read.
const UNREAD: [&str; 4] = ["replicate", "attach", "composite", "flexcomp"];
/// Elements that are motors. They share their defaults.
const MOTORS: [&str; 8] = ["general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder", "muscle"];
/// Density of geoms without one, kg/m³.
const DENSITY: f64 = 1000.;

/// Parses the text of an MJCF file.
///
/// * `folder` - folder of included files; `None` if they cannot be read
///
/// # Errors
/// [`Error::Format`] for text that is not XML; [`Error::Invalid`] names the line, the element and the invalid value, and the file if it
/// is an included one; also for included files that cannot be read.
pub fn parse(text: &str, folder: Option<&Path>) -> Result<Model> {
    let texts = included(text, folder)?;
    let main = document(text, "an MJCF file", "mujoco")?;
    let documents = texts.iter().map(|(name, text)| {
        let document = document(text, "an MJCF file", "mujoco").map_err(|e| e.in_file(Path::new(name), None))?;
        Ok((name.as_str(), document))
    });
    let documents = documents.collect::<Result<Vec<_>>>()?;
    let mut reader = Reader { included: &documents, classes: Vec::new(), compiler: Compiler::default(), paired: HashSet::new() };
    let sections = reader.children(main.root_element());
    let named = |name: &'static str| sections.iter().filter(move |section| section.tag_name().name() == name).copied();
    reader.compiler = reader.compiler(named("compiler"))?;
    let pairs = named("contact").flat_map(|section| reader.children(section)).filter(|node| node.tag_name().name() == "pair");
    reader.paired = pairs.flat_map(|pair| ["geom1", "geom2"].into_iter().filter_map(move |end| pair.attribute(end))).collect();
    reader.classes.push(Class { name: "main".into(), above: None, elements: Vec::new() });
    for section in named("default") {
        reader.class(section, None, 0)?;
    }
    let mut parts = Vec::new();
    for (node, class, at) in
        named("worldbody").map(|world| reader.contents(world, 0, Isometry3::identity(), 0)).collect::<Result<Vec<_>>>()?.concat()
    {
        if node.tag_name().name() == "body" {
            let mut part = Part::default();
            reader.body(&mut part, node, &at, None, class, 0)?;
            parts.push(part);
        }
    }
    let coordinates: usize = parts.iter().flat_map(|part| &part.coordinates).map(|(count, _)| count).sum();
    let moving = |part: &Part| part.joints.iter().filter(|joint| joint.motion != Motion::Fixed).count();
    // The first of several with equally many.
    let Some(chosen) = (0..parts.len()).rev().max_by_key(|&i| moving(&parts[i])).filter(|&i| moving(&parts[i]) > 0) else {
        return Err(Error::invalid("<worldbody>", "no body with joints below it", "a legged robot"));
    };
    let before: usize = parts[..chosen].iter().flat_map(|part| &part.coordinates).map(|(count, _)| count).sum();
    let mut part = parts.swap_remove(chosen);
    if let Some(error) = part.unknown.take() {
        return Err(error);
    }
    reader.motors(&mut part, named("actuator"))?;
    reader.equalities(&mut part, named("equality"))?;
    reader.compiler.set_mass(&mut part.links);
    let stance = reader.stance(&part, named("keyframe"), before, coordinates)?;
    let name = main.root_element().attribute("model").unwrap_or_default().trim().to_owned();
    Ok(Model { name, links: part.links, joints: part.joints, stance, notes: part.notes })
}

/// Names and texts of included files. Each is included once.
fn included(text: &str, folder: Option<&Path>) -> Result<Vec<(String, String)>> {
    let mut texts: Vec<(String, String)> = Vec::new();
    for at in 0.. {
        let (name, text) = match at {
            0 => ("", text),
            _ => match texts.get(at - 1) {
                Some((name, text)) => (name.as_str(), text.as_str()),
                None => break,
            },
        };
        let mut found = Vec::new();
        let document = document(text, "an MJCF file", "mujoco").map_err(|e| if at == 0 { e } else { e.in_file(Path::new(name), None) })?;
        for include in document.descendants().filter(|node| node.tag_name().name() == "include") {
            let file = self::text(include, "file")?.to_owned();
            let place = format!("{}, `file`", place(include));
            let Some(folder) = folder else {
                return Err(Error::invalid(
                    place,
                    format!("\"{}\"", shortened(&file)),
                    "absent: a text without a folder includes no files",
                ));
            };
            if texts.iter().chain(&found).any(|(other, _)| *other == file) || texts.len() + found.len() >= MAX_INCLUDES {
                let limit = format!("included once, as one of at most {MAX_INCLUDES} files");
                return Err(Error::invalid(place, format!("\"{}\"", shortened(&file)), limit));
            }
            let text = files::read_at_most(&folder.join(&file), MAX_FILE as u64)?;
            found.push((file, text));
        }
        texts.append(&mut found);
    }
    Ok(texts)
}

/// Settings of `<compiler>`.
#[derive(Debug, Default)]
struct Compiler {
    radians: bool,
    /// Axes of Euler angles, `xyz` if empty; capital letters are fixed axes.
    euler: String,
    /// Ranges are no limits unless an element says so.
    explicit_limits: bool,
    /// Inertia of bodies by their geoms: always or never; `None` where `<inertial>` is missing.
    by_geoms: Option<bool>,
    /// Groups of geoms that have a mass.
    groups: Option<[f64; 2]>,
    total_mass: Option<f64>,
}

impl Compiler {
    /// An angle of the file in rad.
    fn angle(&self, value: f64) -> f64 {
        if self.radians { value } else { value.to_radians() }
    }

    /// Scales masses and inertias to the total mass.
    fn set_mass(&self, links: &mut [Link]) {
        let mass: f64 = links.iter().filter_map(|link| link.inertial).map(|part| part.mass).sum();
        if let Some(total) = self.total_mass.filter(|total| *total > 0. && mass > 0.) {
            for part in links.iter_mut().filter_map(|link| link.inertial.as_mut()) {
                part.mass *= total / mass;
                part.inertia *= total / mass;
            }
        }
    }
}

/// Defaults of elements.
struct Class<'a> {
    name: String,
    above: Option<usize>,
    elements: Vec<Node<'a, 'a>>,
}

/// An element with the class of its defaults.
#[derive(Clone, Copy)]
struct Item<'a> {
    node: Node<'a, 'a>,
    class: usize,
}

/// A body of the world with all bodies below it.
#[derive(Default)]
struct Part {
    links: Vec<Link>,
    joints: Vec<Joint>,
    /// Joint values at which the bodies have their poses in the file, rad or m.
    references: Vec<f64>,
    /// Coordinates in a keyframe: their number, and the joint whose value they are.
    coordinates: Vec<(usize, Option<usize>)>,
    notes: Vec<String>,
    /// First body whose inertia is not in the file.
    unknown: Option<Error>,
}

/// A geom of a body, in the frame of the body.
struct Geom {
    pose: Isometry3<f64>,
    solid: Option<Solid>,
    /// Mass if given, and density, kg and kg/m³.
    mass: Option<f64>,
    density: f64,
    collides: bool,
    weighed: bool,
}

impl Geom {
    /// Mass and inertia; `None` for a mesh.
    fn inertial(&self) -> Option<Inertial> {
        let solid = self.solid?;
        let mass = self.mass.unwrap_or_else(|| self.density * solid.volume());
        Some(Inertial { origin: self.pose, mass, inertia: mass * solid.inertia() })
    }
}

struct Reader<'a> {
    included: &'a [(&'a str, Document<'a>)],
    classes: Vec<Class<'a>>,
    compiler: Compiler,
    /// Geoms that collide in pairs, whatever their types.
    paired: HashSet<&'a str>,
}

impl<'a> Reader<'a> {
    /// Names the file in an error about an element of an included file.
    fn checked<T>(&self, node: Node, result: Result<T>) -> Result<T> {
        result.map_err(|e| match self.included.iter().find(|(_, document)| std::ptr::eq(document, node.document())) {
            Some((name, _)) => e.in_file(Path::new(name), None),
            None => e,
        })
    }

    fn invalid<T>(&self, node: Node, what: &str, value: impl std::fmt::Display, limit: &str) -> Result<T> {
        let what = if what.is_empty() { place(node) } else { format!("{}, `{what}`", place(node)) };
        self.checked(node, Err(Error::invalid(what, value, limit)))
    }

    /// Elements below one, with those of included files in place of `<include>`.
    fn children(&self, node: Node<'a, 'a>) -> Vec<Node<'a, 'a>> {
        let mut found = Vec::new();
        for child in node.children().filter(Node::is_element) {
            let file = child.attribute("file").filter(|_| child.tag_name().name() == "include");
            match file.and_then(|file| self.included.iter().find(|(name, _)| *name == file)) {
                Some((_, document)) => found.append(&mut self.children(document.root_element())),
                None => found.push(child),
            }
        }
        found
    }

    fn compiler(&self, elements: impl Iterator<Item = Node<'a, 'a>>) -> Result<Compiler> {
        let mut compiler = Compiler::default();
        for node in elements {
            let word = |attribute, words: &[&str]| self.word(Item { node, class: usize::MAX }, attribute, words);
            if let Some(angle) = word("angle", &["degree", "radian"])? {
                compiler.radians = angle == "radian";
            }
            if let Some(limits) = word("autolimits", &["true", "false"])? {
                compiler.explicit_limits = limits == "false";
            }
            if let Some(inertia) = word("inertiafromgeom", &["true", "false", "auto"])? {
                compiler.by_geoms = inertia.parse().ok();
            }
            if let Some(sequence) = node.attribute("eulerseq") {
                if sequence.len() != 3 || !sequence.chars().all(|axis| "xyzXYZ".contains(axis)) {
                    return self.invalid(node, "eulerseq", format!("\"{}\"", shortened(sequence)), "three of the letters x, y, z, X, Y, Z");
                }
                compiler.euler = sequence.into();
            }
            if node.has_attribute("inertiagrouprange") {
                compiler.groups = Some(self.checked(node, numbers(node, "inertiagrouprange", [0.; 2]))?);
            }
            if node.has_attribute("settotalmass") {
                compiler.total_mass = Some(self.checked(node, scalar(node, "settotalmass"))?);
            }
        }
        Ok(compiler)
    }

    /// Reads a class of defaults and those inside it.
    fn class(&mut self, node: Node<'a, 'a>, above: Option<usize>, depth: usize) -> Result<()> {
        let name = node.attribute("class").unwrap_or(if above.is_none() { "main" } else { "" });
        if name.is_empty() || depth > DEEPEST {
            return self.invalid(node, "class", format!("\"\" at depth {depth}"), &format!("a name, at a depth of at most {DEEPEST}"));
        }
        let class = match self.classes.iter().position(|class| class.name == name) {
            Some(class) => class,
            None => {
                self.classes.push(Class { name: name.into(), above, elements: Vec::new() });
                self.classes.len() - 1
            }
        };
        for child in self.children(node) {
            match child.tag_name().name() {
                "default" => self.class(child, Some(class), depth + 1)?,
                _ => self.classes[class].elements.push(child),
            }
        }
        Ok(())
    }

    /// Class that an attribute of an element names, or else the given one.
    fn class_of(&self, node: Node, attribute: &str, class: usize) -> Result<usize> {
        let Some(name) = node.attribute(attribute) else { return Ok(class) };
        match self.classes.iter().position(|class| class.name == name) {
            Some(class) => Ok(class),
            None => self.invalid(node, attribute, format!("\"{}\"", shortened(name)), "a class of <default>"),
        }
    }

    fn item(&self, node: Node<'a, 'a>, class: usize) -> Result<Item<'a>> {
        Ok(Item { node, class: self.class_of(node, "class", class)? })
    }

    /// Element that gives one of some attributes: the item itself, or else the innermost of its classes that has it.
    fn source(&self, item: Item<'a>, attributes: &[&str]) -> Option<Node<'a, 'a>> {
        fn kind<'t>(tag: &'t str) -> &'t str {
            if MOTORS.contains(&tag) { "general" } else { tag }
        }
        let gives = |node: &Node| attributes.iter().any(|attribute| node.has_attribute(*attribute));
        if gives(&item.node) {
            return Some(item.node);
        }
        let tag = kind(item.node.tag_name().name());
        let mut next = self.classes.get(item.class);
        while let Some(class) = next {
            if let Some(&found) = class.elements.iter().rev().find(|node| kind(node.tag_name().name()) == tag && gives(node)) {
                return Some(found);
            }
            next = class.above.map(|above| &self.classes[above]);
        }
        None
    }

    fn numbers<const N: usize>(&self, item: Item<'a>, attribute: &str, default: [f64; N]) -> Result<[f64; N]> {
        self.source(item, &[attribute]).map_or(Ok(default), |node| self.checked(node, numbers(node, attribute, default)))
    }

    /// First number of an attribute.
    fn first(&self, item: Item<'a>, attribute: &str) -> Result<Option<f64>> {
        let values = self.source(item, &[attribute]).map_or(Ok(Vec::new()), |node| self.checked(node, list(node, attribute)));
        Ok(values?.first().copied())
    }

    /// One of some words.
    fn word(&self, item: Item<'a>, attribute: &str, words: &[&str]) -> Result<Option<&'a str>> {
        let Some(node) = self.source(item, &[attribute]) else { return Ok(None) };
        match node.attribute(attribute).filter(|word| words.contains(word)) {
            Some(word) => Ok(Some(word)),
            None => {
                let word = shortened(node.attribute(attribute).unwrap_or_default());
                self.invalid(node, attribute, format!("\"{word}\""), &words.join(", "))
            }
        }
    }

    /// Range of an element, lower end first, if it is a limit.
    fn range(&self, item: Item<'a>, range: &str, limited: &str) -> Result<Option<[f64; 2]>> {
        let asked = self.word(item, limited, &["true", "false", "auto"])?;
        let Some(node) = self.source(item, &[range]) else { return Ok(None) };
        let value = |part: &str| self.checked(node, number(node, range, part, true));
        let values = node.attribute(range).unwrap_or_default().split_whitespace().take(3).map(value).collect::<Result<Vec<f64>>>()?;
        let &[low, high] = values.as_slice() else {
            return self.invalid(node, range, format!("{} numbers", values.len()), "2 numbers");
        };
        if low > high {
            return self.invalid(node, range, format!("{low} to {high}"), "the lower end first");
        }
        let limits = match asked {
            Some("true") => true,
            Some("false") => false,
            // Equal ends mean that there is no range.
            _ => !self.compiler.explicit_limits && low < high,
        };
        Ok(limits.then_some([low, high]))
    }

    /// Pose of an element in the frame that contains it.
    fn pose(&self, item: Item<'a>) -> Result<Isometry3<f64>> {
        let at = Translation3::from(Vector3::from(self.numbers(item, "pos", [0.; 3])?));
        let Some(node) = self.source(item, &ORIENTATIONS) else { return Ok(at.into()) };
        Ok(Isometry3::from_parts(at, self.checked(node, self.orientation(node))?))
    }

    /// Orientation in an element that gives one.
    fn orientation(&self, node: Node) -> Result<UnitQuaternion<f64>> {
        let direction = |attribute, [x, y, z]: [f64; 3]| {
            let missing = || Error::invalid(format!("{}, `{attribute}`", place(node)), "no direction", "not zero");
            Unit::try_new(Vector3::new(x, y, z), 1e-12).ok_or_else(missing)
        };
        if node.has_attribute("quat") {
            let [w, i, j, k] = numbers(node, "quat", [0.; 4])?;
            let missing = || Error::invalid(format!("{}, `quat`", place(node)), "0 0 0 0", "not zero");
            UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-12).ok_or_else(missing)
        } else if node.has_attribute("axisangle") {
            let [x, y, z, angle] = numbers(node, "axisangle", [0.; 4])?;
            Ok(UnitQuaternion::from_axis_angle(&direction("axisangle", [x, y, z])?, self.compiler.angle(angle)))
        } else if node.has_attribute("euler") {
            let angles = numbers(node, "euler", [0.; 3])?;
            let sequence = if self.compiler.euler.is_empty() { "xyz" } else { &self.compiler.euler };
            Ok(sequence.chars().zip(angles).fold(UnitQuaternion::identity(), |turned, (axis, angle)| {
                let about = match axis.to_ascii_lowercase() {
                    'x' => Vector3::x_axis(),
                    'y' => Vector3::y_axis(),
                    _ => Vector3::z_axis(),
                };
                let turn = UnitQuaternion::from_axis_angle(&about, self.compiler.angle(angle));
                if axis.is_lowercase() { turned * turn } else { turn * turned }
            }))
        } else if node.has_attribute("xyaxes") {
            let [a, b, c, d, e, f] = numbers(node, "xyaxes", [0.; 6])?;
            let x = direction("xyaxes", [a, b, c])?;
            let y = Vector3::new(d, e, f);
            let y = direction("xyaxes", (y - x.into_inner() * x.dot(&y)).into())?;
            let axes = Matrix3::from_columns(&[x.into_inner(), y.into_inner(), x.cross(&y)]);
            Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes)))
        } else {
            Ok(upright(&direction("zaxis", numbers(node, "zaxis", [0.; 3])?)?))
        }
    }

    /// Elements of a body with the classes and poses that frames around them add.
    fn contents(
        &self,
        node: Node<'a, 'a>,
        class: usize,
        at: Isometry3<f64>,
        depth: usize,
    ) -> Result<Vec<(Node<'a, 'a>, usize, Isometry3<f64>)>> {
        if depth > DEEPEST {
            return self.invalid(node, "", format!("at depth {depth}"), &format!("at a depth of at most {DEEPEST}"));
        }
        let mut found = Vec::new();
        for child in self.children(node) {
            match child.tag_name().name() {
                "frame" => {
                    let class = self.class_of(child, "childclass", class)?;
                    found.append(&mut self.contents(child, class, at * self.pose(Item { node: child, class })?, depth + 1)?);
                }
                _ => found.push((child, class, at)),
            }
        }
        Ok(found)
    }

    /// Reads a body and those below it.
    ///
    /// * `at` - frame that contains the body, in the frame of its parent
    /// * `parent` - link of the parent; `None` for the world
    fn body(
        &self,
        part: &mut Part,
        node: Node<'a, 'a>,
        at: &Isometry3<f64>,
        parent: Option<&str>,
        class: usize,
        depth: usize,
    ) -> Result<()> {
        let class = self.class_of(node, "childclass", class)?;
        let name = node.attribute("name").map_or_else(|| format!("body{}", part.links.len()), str::to_owned);
        let contents = self.contents(node, class, Isometry3::identity(), depth)?;
        let (mut inertial, mut geoms, mut bodies) = (None, Vec::new(), Vec::new());
        // The link above the next joint, and the frame of the body in it.
        let (mut above, mut frame) = (parent.map(str::to_owned), at * self.pose(Item { node, class })?);
        for (child, class, at) in contents {
            match child.tag_name().name() {
                "inertial" => inertial = Some(self.inertial(child, &at)?),
                "geom" => geoms.extend(self.geom(self.item(child, class)?, &at)?),
                "body" => bodies.push((child, class, at)),
                "joint" | "freejoint" => {
                    let item = self.item(child, class)?;
                    if let Some((joint, reference, anchor)) = self.joint(part, item, &at, &name, above.as_deref())? {
                        let joint = Joint {
                            origin: frame
                                * Translation3::from(anchor)
                                * joint_motion(joint.motion == Motion::Revolute, &joint.axis, -reference),
                            ..joint
                        };
                        part.links.push(Link { name: joint.child.clone(), inertial: None, collisions: Vec::new() });
                        above = Some(joint.child.clone());
                        frame = Translation3::from(-anchor).into();
                        part.coordinates.push((1, Some(part.joints.len())));
                        part.joints.push(joint);
                        part.references.push(reference);
                    }
                }
                other if UNREAD.contains(&other) => part.notes.push(format!("<{other}> in body `{}` is left out", shortened(&name))),
                _ => {}
            }
        }
        if let Some(above) = above {
            part.joints.push(Joint::fixed(format!("{name} (fixed)"), above, name.clone(), frame));
            part.references.push(0.);
        }
        let inertial = match inertial.filter(|_| self.compiler.by_geoms != Some(true)) {
            Some(inertial) => Some(inertial),
            None if self.compiler.by_geoms == Some(false) => None,
            None => {
                let weighed = geoms.iter().filter(|geom| geom.weighed && geom.mass.unwrap_or(geom.density) > 0.);
                let parts: Option<Vec<Inertial>> = weighed.map(Geom::inertial).collect();
                if parts.is_none() && part.unknown.is_none() {
                    part.unknown = self.invalid::<()>(node, "", "a mesh, and no <inertial>", "<inertial>: meshes are not read").err();
                }
                let level = Isometry3::identity();
                let whole = composite(parts.iter().flatten().map(|part| (&level, part)));
                (whole.mass > 0.).then(|| Inertial {
                    origin: Translation3::from(whole.center).into(),
                    mass: whole.mass,
                    inertia: whole.inertia,
                })
            }
        };
        let shape = |geom: &Geom| match geom.solid {
            Some(Solid::Shape(shape)) if geom.collides => Some(Collision { origin: geom.pose, shape }),
            _ => None,
        };
        part.links.push(Link { name: name.clone(), inertial, collisions: geoms.iter().filter_map(shape).collect() });
        for (child, class, at) in bodies {
            self.body(part, child, &at, Some(&name), class, depth + 1)?;
        }
        Ok(())
    }

    /// A joint below a link with its reference value and its anchor in the frame of the body; its origin is left to the caller. `None` for
    /// joints that place the robot in the world.
    ///
    /// * `above` - link above the joint; `None` for the world
    fn joint(
        &self,
        part: &mut Part,
        item: Item<'a>,
        at: &Isometry3<f64>,
        body: &str,
        above: Option<&str>,
    ) -> Result<Option<(Joint, f64, Vector3<f64>)>> {
        let free = item.node.tag_name().name() == "freejoint";
        let kind = if free { "free" } else { self.word(item, "type", &["free", "ball", "slide", "hinge"])?.unwrap_or("hinge") };
        let Some(above) = above else {
            part.coordinates.push((
                if kind == "free" {
                    7
                } else if kind == "ball" {
                    4
                } else {
                    1
                },
                None,
            ));
            return Ok(None);
        };
        let motion = match kind {
            "hinge" => Motion::Revolute,
            "slide" => Motion::Prismatic,
            _ => return self.invalid(item.node, "type", format!("\"{kind}\""), "hinge or slide below the base"),
        };
        let value = |value: f64| if motion == Motion::Revolute { self.compiler.angle(value) } else { value };
        let axis = at.rotation * Vector3::from(self.numbers(item, "axis", [0., 0., 1.])?);
        let Some(axis) = Unit::try_new(axis, 1e-12) else {
            return self.invalid(item.node, "axis", "0 0 0", "a direction");
        };
        let limits = self.range(item, "range", "limited")?.map_or([f64::NEG_INFINITY, f64::INFINITY], |range| range.map(value));
        let anchor = at * nalgebra::Point3::from(self.numbers(item, "pos", [0.; 3])?);
        let joint = Joint {
            name: item.node.attribute("name").map_or_else(|| format!("joint{}", part.joints.len()), str::to_owned),
            motion,
            parent: above.into(),
            child: format!("{body} (joint {})", part.joints.len()),
            origin: Isometry3::identity(),
            axis,
            limits,
            velocity: None,
            effort: self.range(item, "actuatorfrcrange", "actuatorfrclimited")?.map(largest),
            mimic: None,
        };
        Ok(Some((joint, value(self.numbers(item, "ref", [0.])?[0]), anchor.coords)))
    }

    /// Mass and inertia of a body.
    fn inertial(&self, node: Node<'a, 'a>, at: &Isometry3<f64>) -> Result<Inertial> {
        let mass = self.checked(node, size(node, "mass"))?;
        let mut origin = at * self.pose(Item { node, class: usize::MAX })?;
        let inertia = if node.has_attribute("fullinertia") {
            let [xx, yy, zz, xy, xz, yz] = self.checked(node, numbers(node, "fullinertia", [0.; 6]))?;
            origin.rotation = at.rotation;
            Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
        } else {
            self.checked(node, text(node, "diaginertia"))?;
            Matrix3::from_diagonal(&self.checked(node, numbers(node, "diaginertia", [0.; 3]))?.into())
        };
        Ok(Inertial { origin, mass, inertia })
    }

    /// A geom; `None` for planes and height fields.
    fn geom(&self, item: Item<'a>, at: &Isometry3<f64>) -> Result<Option<Geom>> {
        let kinds = ["sphere", "capsule", "cylinder", "box", "ellipsoid", "mesh", "sdf", "plane", "hfield"];
        let kind = self.word(item, "type", &kinds)?.unwrap_or("sphere");
        if ["plane", "hfield"].contains(&kind) {
            return Ok(None);
        }
        let mut pose = self.pose(item)?;
        let sizes = self.source(item, &["size"]).map_or(Ok(Vec::new()), |node| self.checked(node, list(node, "size")))?;
        let mut halves: [f64; 3] = std::array::from_fn(|i| sizes.get(i).copied().unwrap_or(0.));
        if self.source(item, &["fromto"]).is_some() {
            let [x, y, z, to @ ..] = self.numbers(item, "fromto", [0.; 6])?;
            let (from, to) = (Vector3::new(x, y, z), Vector3::from(to));
            let Some(along) = Unit::try_new(from - to, 1e-12) else {
                return self.invalid(item.node, "fromto", "the same point twice", "two points");
            };
            pose = Isometry3::from_parts(((from + to) / 2.).into(), upright(&along));
            let half = (from - to).norm() / 2.;
            halves = if ["box", "ellipsoid"].contains(&kind) { [halves[0], halves[0], half] } else { [halves[0], half, 0.] };
        }
        let [a, b, c] = halves;
        let (count, solid) = match kind {
            // The size of a mesh is in its file, also that of a shape around a mesh.
            _ if self.source(item, &["mesh"]).is_some() => (0, None),
            "sphere" => (1, Some(Solid::Shape(Shape::Sphere(a)))),
            "capsule" => (2, Some(Solid::Shape(Shape::Capsule(a, 2. * b)))),
            "cylinder" => (2, Some(Solid::Shape(Shape::Cylinder(a, 2. * b)))),
            "box" => (3, Some(Solid::Shape(Shape::Box([2. * a, 2. * b, 2. * c])))),
            "ellipsoid" => (3, Some(Solid::Ellipsoid(halves))),
            _ => (0, None),
        };
        if !halves[..count].iter().all(|half| *half > 0.) {
            let shown: Vec<String> = halves[..count].iter().map(f64::to_string).collect();
            return self.invalid(item.node, "size", shown.join(" "), &format!("{count} positive numbers for a {kind}"));
        }
        let [contype, conaffinity] = [self.numbers(item, "contype", [1.])?, self.numbers(item, "conaffinity", [1.])?];
        let group = self.numbers(item, "group", [0.])?[0];
        let mass = self.source(item, &["mass"]).map(|_| self.numbers(item, "mass", [0.])).transpose()?;
        Ok(Some(Geom {
            pose: at * pose,
            solid,
            mass: mass.map(|[mass]| mass),
            density: self.numbers(item, "density", [DENSITY])?[0],
            collides: contype != [0.] || conaffinity != [0.] || item.node.attribute("name").is_some_and(|name| self.paired.contains(name)),
            weighed: self.compiler.groups.is_none_or(|[first, last]| (first..=last).contains(&group)),
        }))
    }

    /// Forces of joints: the sum of their motors', at most what the joint itself allows.
    fn motors(&self, part: &mut Part, sections: impl Iterator<Item = Node<'a, 'a>>) -> Result<()> {
        let mut sums: Vec<Option<f64>> = vec![None; part.joints.len()];
        for node in sections.flat_map(|section| self.children(section)).filter(|node| MOTORS.contains(&node.tag_name().name())) {
            let Some(name) = node.attribute("joint").or_else(|| node.attribute("jointinparent")) else { continue };
            let Some(joint) = part.joints.iter().position(|joint| joint.name == name) else { continue };
            let item = self.item(node, 0)?;
            let mut range = self.range(item, "forcerange", "forcelimited")?;
            if range.is_none() && node.tag_name().name() == "motor" {
                range = self.range(item, "ctrlrange", "ctrllimited")?;
            }
            if let Some(range) = range {
                let gear = self.first(item, "gear")?.unwrap_or(1.);
                *sums[joint].get_or_insert(0.) += gear.abs() * largest(range);
            }
        }
        for (joint, sum) in part.joints.iter_mut().zip(sums) {
            joint.effort = joint.effort.into_iter().chain(sum).reduce(f64::min).filter(|effort| *effort > 0.);
        }
        Ok(())
    }

    /// Joints that follow others. Loops that other constraints close stay open.
    fn equalities(&self, part: &mut Part, sections: impl Iterator<Item = Node<'a, 'a>>) -> Result<()> {
        for node in sections.flat_map(|section| self.children(section)) {
            let (item, tag) = (self.item(node, 0)?, node.tag_name().name());
            if self.word(item, "active", &["true", "false"])? == Some("false") {
                continue;
            }
            let find = |attribute| part.joints.iter().position(|joint| node.attribute(attribute) == Some(&joint.name));
            match (tag, find("joint1"), find("joint2")) {
                ("joint", Some(joint), Some(other)) => {
                    let source = self.source(item, &["polycoef"]);
                    let given = source.map_or(Ok(Vec::new()), |node| self.checked(node, list(node, "polycoef")))?;
                    let factor = |i: usize| given.get(i).copied().unwrap_or(if i == 1 { 1. } else { 0. });
                    if (2..5).any(|i| factor(i) != 0.) {
                        part.notes
                            .push(format!("joint `{}` follows another as a polynomial; it is taken as free", part.joints[joint].name));
                        continue;
                    }
                    // The polynomial relates distances from the reference values.
                    let offset = factor(0) + part.references[joint] - factor(1) * part.references[other];
                    let name = part.joints[other].name.clone();
                    part.joints[joint].mimic = Some(Mimic { joint: name, multiplier: factor(1), offset });
                }
                ("connect" | "weld", ..) => {
                    let carried = |attribute| part.links.iter().any(|link| node.attribute(attribute) == Some(&link.name));
                    if carried("body1") || node.has_attribute("site1") {
                        part.notes.push(format!("the loop that line {} closes by <{tag}> stays open", line(node)));
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Values of the joints in the keyframe `home`, or else in the first one, within their limits.
    ///
    /// * `before` - number of coordinates of bodies before the robot
    /// * `coordinates` - number of coordinates of all bodies
    fn stance(
        &self,
        part: &Part,
        sections: impl Iterator<Item = Node<'a, 'a>>,
        before: usize,
        coordinates: usize,
    ) -> Result<Vec<(String, f64)>> {
        let keys: Vec<Node> = sections.flat_map(|section| self.children(section)).filter(|key| key.has_attribute("qpos")).collect();
        let Some(&key) = keys.iter().find(|key| key.attribute("name") == Some("home")).or(keys.first()) else { return Ok(Vec::new()) };
        let values = self.checked(key, list(key, "qpos"))?;
        if values.len() != coordinates {
            return self.invalid(key, "qpos", format!("{} numbers", values.len()), &format!("{coordinates} numbers"));
        }
        let mut stance = Vec::new();
        let mut at = before;
        for &(count, joint) in &part.coordinates {
            if let Some(joint) = joint.map(|joint| &part.joints[joint]).filter(|joint| joint.mimic.is_none()) {
                stance.push((joint.name.clone(), values[at].clamp(joint.limits[0], joint.limits[1])));
            }
            at += count;
        }
        Ok(stance)
    }
}

/// Larger of the two forces at the ends of a range.
fn largest([low, high]: [f64; 2]) -> f64 {
    low.abs().max(high.abs())
}

/// Smallest rotation that turns z into a direction.
fn upright(direction: &Unit<Vector3<f64>>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between_axis(&Vector3::z_axis(), direction)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}
