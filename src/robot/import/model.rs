//! Links and joints of a robot as its file gives them.

use nalgebra::{Isometry3, Matrix3, Unit, Vector3};

/// Links and joints in file order. Their connections are not checked.
#[derive(Debug, Clone)]
pub struct Model {
    /// Name of the robot.
    pub name: String,
    /// Links.
    pub links: Vec<Link>,
    /// Joints.
    pub joints: Vec<Joint>,
    /// Values of joints in which the robot stands, rad or m, if the file gives them.
    pub stance: Vec<(String, f64)>,
    /// Notes for the user.
    pub notes: Vec<String>,
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

impl Joint {
    /// A joint that does not move.
    pub fn fixed(name: String, parent: String, child: String, origin: Isometry3<f64>) -> Joint {
        Joint {
            name,
            motion: Motion::Fixed,
            parent,
            child,
            origin,
            axis: Vector3::x_axis(),
            limits: [f64::NEG_INFINITY, f64::INFINITY],
            velocity: None,
            effort: None,
            mimic: None,
        }
    }
}
