//! Masses, joints and collision shapes of a URDF file. Visuals, meshes and plugins are not read.

use crate::error::{Error, Result};
use nalgebra::{Isometry3, Matrix3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};
use roxmltree::{Document, Node, ParsingOptions};

/// Largest file, bytes.
pub const MAX_URDF: usize = 64 << 20;
/// Largest number of elements, texts and comments in a file.
const MAX_NODES: u32 = 4_000_000;
/// Largest absolute value of a number in a file, in its unit.
const LARGEST: f64 = 1e9;

/// Links and joints in file order. Their connections are not checked.
#[derive(Debug, Clone)]
pub struct Model {
    /// Name of the robot.
    pub name: String,
    /// Links.
    pub links: Vec<Link>,
    /// Joints.
    pub joints: Vec<Joint>,
}

/// A rigid body.
#[derive(Debug, Clone)]
pub struct Link {
    /// Name, unique among links.
    pub name: String,
    /// Mass and inertia, if it has any.
    pub inertial: Option<Inertial>,
    /// Collision shapes without meshes.
    pub collisions: Vec<Collision>,
}

/// Mass and inertia of a link.
#[derive(Debug, Clone, Copy)]
pub struct Inertial {
    /// Centre of mass and axes of the inertia tensor, in the frame of the link.
    pub origin: Isometry3<f64>,
    /// Mass, kg.
    pub mass: f64,
    /// Inertia tensor about the centre of mass in the axes of `origin`, kg m².
    pub inertia: Matrix3<f64>,
}

/// A collision shape.
#[derive(Debug, Clone, Copy)]
pub struct Collision {
    /// Pose of the shape's centre in the frame of the link.
    pub origin: Isometry3<f64>,
    /// Shape.
    pub shape: Shape,
}

/// A primitive shape about its centre. Cylinders and capsules are along z. Lengths in m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// Radius.
    Sphere(f64),
    /// Full side lengths.
    Box([f64; 3]),
    /// Radius and length.
    Cylinder(f64, f64),
    /// Radius, and length without the caps.
    Capsule(f64, f64),
}

/// Kind of motion of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// Fixed. Floating and planar joints place the robot in the world, so they are also held at zero.
    Fixed,
    /// Rotation about the axis.
    Revolute,
    /// Translation along the axis.
    Prismatic,
}

/// A joint between two links.
#[derive(Debug, Clone)]
pub struct Joint {
    /// Name, unique among joints.
    pub name: String,
    /// Kind of motion.
    pub motion: Motion,
    /// Parent link.
    pub parent: String,
    /// Child link, which the joint moves.
    pub child: String,
    /// Frame of the child at joint value zero, in the frame of the parent.
    pub origin: Isometry3<f64>,
    /// Axis in the frame of the child.
    pub axis: Unit<Vector3<f64>>,
    /// Lower and upper limit, rad or m; infinite if there is no limit.
    pub limits: [f64; 2],
    /// Largest speed, rad/s or m/s, if given.
    pub velocity: Option<f64>,
    /// Largest torque or force, N m or N, if given.
    pub effort: Option<f64>,
    /// Joint that it follows: `multiplier * value + offset`.
    pub mimic: Option<Mimic>,
}

/// Dependence of a joint on another one.
#[derive(Debug, Clone)]
pub struct Mimic {
    /// Name of the other joint.
    pub joint: String,
    /// Factor.
    pub multiplier: f64,
    /// Offset, rad or m.
    pub offset: f64,
}

/// Parses the text of a URDF file.
///
/// # Errors
/// [`Error::Format`] for text that is not XML; [`Error::Invalid`] names the line, the element and the invalid value.
pub fn parse(text: &str) -> Result<Model> {
    if text.len() > MAX_URDF {
        return Err(Error::invalid("size of the URDF", format!("{} bytes", text.len()), format!("at most {MAX_URDF} bytes")));
    }
    if text.trim().is_empty() {
        return Err(Error::Format { message: "the file is empty, but a URDF was expected".into() });
    }
    let options = ParsingOptions { nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text, options).map_err(|e| Error::Format { message: format!("not XML: {e}") })?;
    let root = document.root_element();
    if root.tag_name().name() != "robot" {
        let name = format!("<{}>", shortened(root.tag_name().name()));
        let hint = if name == "<sdf>" || name == "<mujoco>" { "<robot>, as of a URDF: convert the file first" } else { "<robot>" };
        return Err(Error::invalid("outermost element", name, hint));
    }
    let name = root.attribute("name").unwrap_or_default().trim().to_owned();
    let links = elements(root, "link").map(link).collect::<Result<Vec<_>>>()?;
    let joints = elements(root, "joint").map(joint).collect::<Result<Vec<_>>>()?;
    Ok(Model { name, links, joints })
}

fn elements<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(move |child| child.is_element() && child.tag_name().name() == name)
}

fn element<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> Option<Node<'a, 'i>> {
    elements(node, name).next()
}

/// Beginning of a text, for an error message.
fn shortened(text: &str) -> String {
    let mut shown: String = text.chars().take(40).collect();
    if shown.len() < text.len() {
        shown += "...";
    }
    shown.escape_debug().to_string()
}

/// Line and element, and the link or joint that contains it.
fn place(node: Node) -> String {
    let line = node.document().text_pos_at(node.range().start).row;
    let owner = node.ancestors().find(|a| ["link", "joint"].contains(&a.tag_name().name()));
    let owner = owner.map(|o| format!("{} `{}`", o.tag_name().name(), shortened(o.attribute("name").unwrap_or_default())));
    match owner {
        Some(owner) if !["link", "joint"].contains(&node.tag_name().name()) => {
            format!("line {line}, {owner}, <{}>", shortened(node.tag_name().name()))
        }
        Some(owner) => format!("line {line}, {owner}"),
        None => format!("line {line}, <{}>", shortened(node.tag_name().name())),
    }
}

fn required<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> Result<Node<'a, 'i>> {
    element(node, name).ok_or_else(|| Error::invalid(format!("{}, <{name}>", place(node)), "missing", "present"))
}

fn text<'a>(node: Node<'a, '_>, attribute: &str) -> Result<&'a str> {
    node.attribute(attribute).ok_or_else(|| Error::invalid(format!("{}, `{attribute}`", place(node)), "missing", "given"))
}

fn name(node: Node) -> Result<String> {
    let name = text(node, "name")?;
    if name.trim().is_empty() { Err(Error::invalid(format!("{}, `name`", place(node)), "\"\"", "a name")) } else { Ok(name.into()) }
}

/// Parses a number. If `infinite` is set, as for joint limits, numbers beyond the largest one become infinite.
fn number(node: Node, attribute: &str, text: &str, infinite: bool) -> Result<f64> {
    match text.trim().parse::<f64>() {
        Ok(v) if v.abs() <= LARGEST => Ok(v),
        Ok(v) if infinite && !v.is_nan() => Ok(v.signum() * f64::INFINITY),
        _ => {
            let limit = format!("a number from {} to {LARGEST}", -LARGEST);
            Err(Error::invalid(format!("{}, `{attribute}`", place(node)), format!("\"{}\"", shortened(text)), limit))
        }
    }
}

fn numbers<const N: usize>(node: Node, attribute: &str, default: [f64; N]) -> Result<[f64; N]> {
    let Some(text) = node.attribute(attribute) else { return Ok(default) };
    let parts: Vec<&str> = text.split_whitespace().take(N + 1).collect();
    if parts.len() != N {
        return Err(Error::invalid(format!("{}, `{attribute}`", place(node)), format!("\"{}\"", shortened(text)), format!("{N} numbers")));
    }
    let mut values = default;
    for (value, part) in values.iter_mut().zip(parts) {
        *value = number(node, attribute, part, false)?;
    }
    Ok(values)
}

/// A mandatory number.
fn scalar(node: Node, attribute: &str) -> Result<f64> {
    number(node, attribute, text(node, attribute)?, false)
}

/// A mandatory size, zero or positive.
fn size(node: Node, attribute: &str) -> Result<f64> {
    let value = scalar(node, attribute)?;
    if value >= 0. { Ok(value) } else { Err(Error::invalid(format!("{}, `{attribute}`", place(node)), value, "not negative")) }
}

/// Pose from the `<origin>` of an element; the identity if absent. Rotations are fixed-axis roll, pitch and yaw, or a quaternion.
fn origin(node: Node) -> Result<Isometry3<f64>> {
    let Some(origin) = element(node, "origin") else { return Ok(Isometry3::identity()) };
    let [x, y, z] = numbers(origin, "xyz", [0.; 3])?;
    let [roll, pitch, yaw] = numbers(origin, "rpy", [0.; 3])?;
    let mut rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    if origin.has_attribute("quat_xyzw") {
        let [i, j, k, w] = numbers(origin, "quat_xyzw", [0., 0., 0., 1.])?;
        rotation = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-6)
            .ok_or_else(|| Error::invalid(format!("{}, `quat_xyzw`", place(origin)), "0 0 0 0", "not zero"))?;
    }
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

fn link(node: Node) -> Result<Link> {
    let inertial = element(node, "inertial").map(inertial).transpose()?;
    let mut collisions = Vec::new();
    for collision in elements(node, "collision") {
        if let Some(shape) = element(collision, "geometry").map(shape).transpose()?.flatten() {
            collisions.push(Collision { origin: origin(collision)?, shape });
        }
    }
    Ok(Link { name: name(node)?, inertial, collisions })
}

fn inertial(node: Node) -> Result<Inertial> {
    let mass = size(required(node, "mass")?, "value")?;
    let tensor = required(node, "inertia")?;
    let entry = |name| scalar(tensor, name);
    let [xx, yy, zz] = [entry("ixx")?, entry("iyy")?, entry("izz")?];
    let [xy, xz, yz] = [entry("ixy")?, entry("ixz")?, entry("iyz")?];
    Ok(Inertial { origin: origin(node)?, mass, inertia: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) })
}

/// Primitive shape of a geometry; `None` for a mesh.
fn shape(geometry: Node) -> Result<Option<Shape>> {
    let Some(shape) = geometry.children().find(|child| child.is_element()) else { return Ok(None) };
    Ok(match shape.tag_name().name() {
        "sphere" => Some(Shape::Sphere(size(shape, "radius")?)),
        "box" => {
            text(shape, "size")?;
            Some(Shape::Box(numbers(shape, "size", [0.; 3])?.map(f64::abs)))
        }
        "cylinder" => Some(Shape::Cylinder(size(shape, "radius")?, size(shape, "length")?)),
        "capsule" => Some(Shape::Capsule(size(shape, "radius")?, size(shape, "length")?)),
        _ => None,
    })
}

fn joint(node: Node) -> Result<Joint> {
    let kind = text(node, "type")?;
    let motion = match kind {
        "revolute" | "continuous" => Motion::Revolute,
        "prismatic" => Motion::Prismatic,
        "fixed" | "floating" | "planar" => Motion::Fixed,
        _ => {
            let known = "revolute, continuous, prismatic, fixed, floating or planar";
            return Err(Error::invalid(format!("{}, `type`", place(node)), format!("\"{}\"", shortened(kind)), known));
        }
    };
    let [parent, child] = ["parent", "child"].map(|end| required(node, end).and_then(|e| text(e, "link")));
    let (mut limits, mut velocity, mut effort) = ([f64::NEG_INFINITY, f64::INFINITY], None, None);
    // In most files zero means "unknown" and infinity "unlimited".
    let said = |v: f64| (v != 0. && v.is_finite()).then_some(v.abs());
    if let Some(limit) = element(node, "limit").filter(|_| motion != Motion::Fixed) {
        let value = |name| limit.attribute(name).map_or(Ok(0.), |text| number(limit, name, text, true));
        if kind != "continuous" && (limit.has_attribute("lower") || limit.has_attribute("upper")) {
            limits = [value("lower")?, value("upper")?];
        }
        if limits[0] > limits[1] {
            let [lower, upper] = limits;
            return Err(Error::invalid(format!("{}, `lower`", place(limit)), lower, format!("at most `upper`, {upper}")));
        }
        (velocity, effort) = (said(value("velocity")?), said(value("effort")?));
    }
    Ok(Joint {
        name: name(node)?,
        motion,
        parent: parent?.into(),
        child: child?.into(),
        origin: origin(node)?,
        axis: axis(node)?,
        limits,
        velocity,
        effort,
        mimic: element(node, "mimic").map(mimic).transpose()?,
    })
}

/// Axis of a joint; x if absent.
fn axis(node: Node) -> Result<Unit<Vector3<f64>>> {
    let Some(axis) = element(node, "axis") else { return Ok(Vector3::x_axis()) };
    let xyz = Vector3::from(numbers(axis, "xyz", [1., 0., 0.])?);
    match Unit::try_new(xyz, 1e-6) {
        Some(axis) => Ok(axis),
        // A joint that does not move needs no axis.
        None if !["revolute", "continuous", "prismatic"].contains(&node.attribute("type").unwrap_or_default()) => Ok(Vector3::x_axis()),
        None => Err(Error::invalid(format!("{}, `xyz`", place(axis)), "0 0 0", "a direction")),
    }
}

fn mimic(node: Node) -> Result<Mimic> {
    let [multiplier] = numbers(node, "multiplier", [1.])?;
    let [offset] = numbers(node, "offset", [0.])?;
    Ok(Mimic { joint: text(node, "joint")?.into(), multiplier, offset })
}
