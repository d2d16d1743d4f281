//! Masses, joints, motors and collision shapes of an MJCF file, the format of MuJoCo. Meshes are not read.
//!
//! Follows the XML reference of MuJoCo 3: classes of defaults, `<frame>`, `<include>`, several joints per body, and angles in degrees
//! unless `<compiler>` says otherwise. The robot is the body in the world below which most joints move, with all bodies that it carries.
//! Joints of this body itself place the robot in the world; they are held at zero.

mod geom;
mod reader;
mod solid;
#[cfg(test)]
mod tests;

use super::body::composite;
use super::model::{Collision, Inertial, Joint, Link, Mimic, Model, Motion};
use super::xml::{MAX_FILE, document, line, list, numbers, outermost, place, shortened, size, text};
use crate::error::{Error, Result};
use crate::files;
use crate::robot::leg::joint_motion;
use geom::Geom;
use nalgebra::{Isometry3, Matrix3, Translation3, Unit, Vector3};
use reader::{Item, Reader};
use roxmltree::{Document, Node};
use solid::Solid;
use std::path::Path;

/// Deepest nesting of bodies, frames and classes.
const DEEPEST: usize = 200;
/// Largest number of included files.
const MAX_INCLUDES: usize = 100;
/// Elements with bodies that are not read.
const UNREAD: [&str; 4] = ["replicate", "attach", "composite", "flexcomp"];
/// Elements that are motors. They share their defaults.
const MOTORS: [&str; 8] = ["general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder", "muscle"];

/// Name of the format in messages.
pub const FORMAT: &str = "an MJCF file";
/// Name of the outermost element.
pub const OUTERMOST: &str = "mujoco";

/// Reads an MJCF document.
///
/// * `folder` - folder of included files; `None` if they cannot be read
///
/// # Errors
/// [`Error::Invalid`] names the line, the element and the invalid value, and the file if it is an included one; also for included files
/// that cannot be read.
pub fn read(main: &Document, folder: Option<&Path>) -> Result<Model> {
    let root = outermost(main, FORMAT, OUTERMOST)?;
    let texts = included(main, folder)?;
    let documents = texts.iter().map(|(name, text)| Ok((name.as_str(), included_document(name, text)?))).collect::<Result<Vec<_>>>()?;
    let (reader, sections) = Reader::new(root, &documents)?;
    let named = |name: &'static str| sections.iter().filter(move |section| section.tag_name().name() == name).copied();
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
    let name = root.attribute("model").unwrap_or_default().trim().to_owned();
    Ok(Model { name, links: part.links, joints: part.joints, stance, notes: part.notes })
}

/// Names and texts of included files. Each is included once.
fn included(main: &Document, folder: Option<&Path>) -> Result<Vec<(String, String)>> {
    let mut texts = Vec::new();
    include(main, folder, &mut texts)?;
    // Included files may include others.
    let mut next = 0;
    while let Some((name, text)) = texts.get(next).cloned() {
        include(&included_document(&name, &text)?, folder, &mut texts).map_err(|e| e.in_file(Path::new(&name), None))?;
        next += 1;
    }
    Ok(texts)
}

/// Document of an included file.
fn included_document<'t>(name: &str, text: &'t str) -> Result<Document<'t>> {
    let parse = || {
        let parsed = document(text, FORMAT)?;
        outermost(&parsed, FORMAT, OUTERMOST)?;
        Ok(parsed)
    };
    parse().map_err(|e: Error| e.in_file(Path::new(name), None))
}

/// Adds the files that a document includes.
fn include(document: &Document, folder: Option<&Path>, texts: &mut Vec<(String, String)>) -> Result<()> {
    for include in document.descendants().filter(|node| node.tag_name().name() == "include") {
        let file = text(include, "file")?;
        let refused = |limit: String| Error::invalid(format!("{}, `file`", place(include)), format!("\"{}\"", shortened(file)), limit);
        let Some(folder) = folder else {
            return Err(refused("absent: a text without a folder includes no files".into()));
        };
        if texts.iter().any(|(other, _)| other == file) || texts.len() >= MAX_INCLUDES {
            return Err(refused(format!("included once, as one of at most {MAX_INCLUDES} files")));
        }
        texts.push((file.into(), files::read_at_most(&folder.join(file), MAX_FILE as u64)?));
    }
    Ok(())
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

impl<'a> Reader<'a> {
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
