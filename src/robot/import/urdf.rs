//! Masses, joints and collision shapes of a URDF file. Visuals, meshes and plugins are not read.

use super::model::{Collision, Inertial, Joint, Link, Mimic, Model, Motion, Shape};
use super::xml::{element, elements, name, number, numbers, outermost, place, required, scalar, shortened, size, text};
use crate::error::{Error, Result};
use nalgebra::{Isometry3, Matrix3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};
use roxmltree::{Document, Node};

/// Name of the format in messages.
pub const FORMAT: &str = "a URDF";

/// Reads a URDF document.
///
/// # Errors
/// [`Error::Invalid`] names the line, the element and the invalid value.
pub fn read(document: &Document) -> Result<Model> {
    let root = outermost(document, FORMAT, "robot")?;
    let name = root.attribute("name").unwrap_or_default().trim().to_owned();
    let links = elements(root, "link").map(link).collect::<Result<Vec<_>>>()?;
    let joints = elements(root, "joint").map(joint).collect::<Result<Vec<_>>>()?;
    Ok(Model { name, links, joints, stance: Vec::new(), notes: Vec::new() })
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
