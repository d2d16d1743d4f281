//! Elements of an MJCF file with the defaults of their classes, and orientations.

use super::super::model::Link;
use super::super::xml::{list, number, numbers, place, scalar, shortened};
use super::{DEEPEST, MOTORS};
use crate::error::{Error, Result};
use nalgebra::{Isometry3, Matrix3, Quaternion, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};
use roxmltree::{Document, Node};
use std::collections::HashSet;
use std::path::Path;

/// Attributes that give an orientation.
const ORIENTATIONS: [&str; 5] = ["quat", "axisangle", "euler", "xyaxes", "zaxis"];

/// Settings of `<compiler>`.
#[derive(Debug, Default)]
pub struct Compiler {
    radians: bool,
    /// Axes of Euler angles, `xyz` if empty; capital letters are fixed axes.
    euler: String,
    /// Ranges are no limits unless an element says so.
    explicit_limits: bool,
    /// Inertia of bodies by their geoms: always or never; `None` where `<inertial>` is missing.
    pub by_geoms: Option<bool>,
    /// Groups of geoms that have a mass.
    pub groups: Option<[f64; 2]>,
    total_mass: Option<f64>,
}

impl Compiler {
    /// An angle of the file in rad.
    pub fn angle(&self, value: f64) -> f64 {
        if self.radians { value } else { value.to_radians() }
    }

    /// Scales masses and inertias to the total mass.
    pub fn set_mass(&self, links: &mut [Link]) {
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
pub struct Class<'a> {
    name: String,
    above: Option<usize>,
    elements: Vec<Node<'a, 'a>>,
}

/// An element with the class of its defaults.
#[derive(Clone, Copy)]
pub struct Item<'a> {
    pub node: Node<'a, 'a>,
    pub class: usize,
}

/// Elements of a file and of those that it includes.
pub struct Reader<'a> {
    included: &'a [(&'a str, Document<'a>)],
    classes: Vec<Class<'a>>,
    pub compiler: Compiler,
    /// Geoms that collide in pairs, whatever their types.
    pub paired: HashSet<&'a str>,
}

impl<'a> Reader<'a> {
    /// Reads settings, classes and pairs of a file. Also returns its sections.
    ///
    /// * `included` - names and documents of the files that it includes
    pub fn new(root: Node<'a, 'a>, included: &'a [(&'a str, Document<'a>)]) -> Result<(Reader<'a>, Vec<Node<'a, 'a>>)> {
        let mut reader = Reader { included, classes: Vec::new(), compiler: Compiler::default(), paired: HashSet::new() };
        let sections = reader.children(root);
        let named = |name: &'static str| sections.iter().filter(move |section| section.tag_name().name() == name).copied();
        reader.compiler = reader.compiler(named("compiler"))?;
        let pairs = named("contact").flat_map(|section| reader.children(section)).filter(|node| node.tag_name().name() == "pair");
        reader.paired = pairs.flat_map(|pair| ["geom1", "geom2"].into_iter().filter_map(move |end| pair.attribute(end))).collect();
        reader.classes.push(Class { name: "main".into(), above: None, elements: Vec::new() });
        for section in named("default") {
            reader.class(section, None, 0)?;
        }
        Ok((reader, sections))
    }

    /// Names the file in an error about an element of an included file.
    pub fn checked<T>(&self, node: Node, result: Result<T>) -> Result<T> {
        result.map_err(|e| match self.included.iter().find(|(_, document)| std::ptr::eq(document, node.document())) {
            Some((name, _)) => e.in_file(Path::new(name), None),
            None => e,
        })
    }

    /// Error for a value of an attribute, or of the element itself if `what` is empty.
    pub fn invalid<T>(&self, node: Node, what: &str, value: impl std::fmt::Display, limit: &str) -> Result<T> {
        let what = if what.is_empty() { place(node) } else { format!("{}, `{what}`", place(node)) };
        self.checked(node, Err(Error::invalid(what, value, limit)))
    }

    /// Elements below one, with those of included files in place of `<include>`.
    pub fn children(&self, node: Node<'a, 'a>) -> Vec<Node<'a, 'a>> {
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
    pub fn class_of(&self, node: Node, attribute: &str, class: usize) -> Result<usize> {
        let Some(name) = node.attribute(attribute) else { return Ok(class) };
        match self.classes.iter().position(|class| class.name == name) {
            Some(class) => Ok(class),
            None => self.invalid(node, attribute, format!("\"{}\"", shortened(name)), "a class of <default>"),
        }
    }

    pub fn item(&self, node: Node<'a, 'a>, class: usize) -> Result<Item<'a>> {
        Ok(Item { node, class: self.class_of(node, "class", class)? })
    }

    /// Element that gives one of some attributes: the item itself, or else the innermost of its classes that has it.
    pub fn source(&self, item: Item<'a>, attributes: &[&str]) -> Option<Node<'a, 'a>> {
        fn kind(tag: &str) -> &str {
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

    pub fn numbers<const N: usize>(&self, item: Item<'a>, attribute: &str, default: [f64; N]) -> Result<[f64; N]> {
        self.source(item, &[attribute]).map_or(Ok(default), |node| self.checked(node, numbers(node, attribute, default)))
    }

    /// First number of an attribute.
    pub fn first(&self, item: Item<'a>, attribute: &str) -> Result<Option<f64>> {
        let values = self.source(item, &[attribute]).map_or(Ok(Vec::new()), |node| self.checked(node, list(node, attribute)));
        Ok(values?.first().copied())
    }

    /// One of some words.
    pub fn word(&self, item: Item<'a>, attribute: &str, words: &[&str]) -> Result<Option<&'a str>> {
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
    pub fn range(&self, item: Item<'a>, range: &str, limited: &str) -> Result<Option<[f64; 2]>> {
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
    pub fn pose(&self, item: Item<'a>) -> Result<Isometry3<f64>> {
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
}

/// Smallest rotation that turns z into a direction.
pub fn upright(direction: &Unit<Vector3<f64>>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between_axis(&Vector3::z_axis(), direction)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}
