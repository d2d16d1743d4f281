//! Feet of an imported robot: their links, contact points, and the legs that move them.

use super::model::{Collision, Motion, Shape};
use super::tree::Tree;
use crate::error::{Error, Result};
use crate::robot::MAX_FEET;
use crate::robot::leg::{Leg, LegJoint, MAX_JOINTS};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use std::collections::HashSet;

/// Largest height of a foot above the lowest one for both to be on the ground, relative to the height of the centre of mass above the
/// lowest.
const SAME_GROUND: f64 = 0.05;
/// Largest height difference between the lowest points of a foot's shapes for them to touch the ground together, m.
const SAME_SOLE: f64 = 5e-3;

/// Contact of a foot with the ground in a configuration.
#[derive(Debug, Clone, Copy)]
pub struct Contact {
    /// Link of the foot.
    pub link: usize,
    /// Centre of the foot ball, or the contact point if there is no ball, base frame, m.
    pub center: Vector3<f64>,
    /// Radius of the ball, m; zero for a point.
    pub radius: f64,
    /// Number of shapes that touch the ground together. A flat foot has several, or a single one that is not a ball.
    pub touching: usize,
    /// Rotation from the axes of the sole to the frame of the link, whose centre is then the contact point; `None` for a ball or point.
    pub sole: Option<UnitQuaternion<f64>>,
}

impl Contact {
    /// Contact point, base frame, m.
    pub fn point(&self) -> Vector3<f64> {
        self.center - Vector3::z() * self.radius
    }
}

/// Depth of a shape's lowest point below its centre, m.
fn depth(shape: Shape, turn: &Isometry3<f64>) -> f64 {
    let axis = |axis: Vector3<f64>| (turn.rotation * axis).z.abs();
    let (upright, radial) = (axis(Vector3::z()), |z: f64| (1. - z * z).max(0.).sqrt());
    match shape {
        Shape::Sphere(radius) => radius,
        Shape::Box([x, y, z]) => (axis(Vector3::x()) * x + axis(Vector3::y()) * y + upright * z) / 2.,
        Shape::Cylinder(radius, length) => upright * length / 2. + radial(upright) * radius,
        Shape::Capsule(radius, length) => upright * length / 2. + radius,
    }
}

/// Contact of a link with the ground: the lowest of its collision spheres, else of its other shapes, else the origin of its frame.
///
/// Several shapes that touch together are a flat foot. It is represented by the point of its sole that is closest to the
/// vertical through the origin of the link's frame.
pub fn contact(tree: &Tree, frames: &[Isometry3<f64>], link: usize) -> Contact {
    let (frame, collisions) = (&frames[link], &tree.model.links[link].collisions);
    let is_ball = |c: &&Collision| matches!(c.shape, Shape::Sphere(_));
    let balls: Vec<&Collision> = collisions.iter().filter(is_ball).collect();
    let shapes: Vec<&Collision> = if balls.is_empty() { collisions.iter().collect() } else { balls };
    let placed: Vec<(Vector3<f64>, f64)> = shapes
        .iter()
        .map(|c| {
            let at = frame * c.origin;
            (at.translation.vector, depth(c.shape, &at))
        })
        .collect();
    let lowest = placed.iter().map(|(middle, depth)| middle.z - depth).fold(f64::INFINITY, f64::min);
    let touching: Vec<usize> = (0..placed.len()).filter(|&i| placed[i].0.z - placed[i].1 <= lowest + SAME_SOLE).collect();
    match touching.as_slice() {
        [] => Contact { link, center: frame.translation.vector, radius: 0., touching: 0, sole: None },
        &[only] => match shapes[only].shape {
            Shape::Sphere(radius) => Contact { link, center: placed[only].0, radius, touching: 1, sole: None },
            _ => Contact { link, center: placed[only].0 - Vector3::z() * placed[only].1, radius: 0., touching: 1, sole: None },
        },
        several => {
            let soles: Vec<Vector3<f64>> = several.iter().map(|&i| placed[i].0 - Vector3::z() * placed[i].1).collect();
            let mean = soles.iter().sum::<Vector3<f64>>() / soles.len() as f64;
            // The point of the sole closest to the vertical through the ankle (the link's frame): a force there causes the smallest torques.
            let along = |axis: usize| {
                let ends = soles.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], p| [low.min(p[axis]), high.max(p[axis])]);
                frame.translation.vector[axis].max(ends[0]).min(ends[1])
            };
            let sole = Vector3::new(along(0), along(1), mean.z);
            Contact { link, center: sole, radius: 0., touching: several.len(), sole: None }
        }
    }
}

/// Links on the ground: the lowest of the leaves that joints move. Of several leaves whose last moving joint is the same, such as the sole
/// and the sensors of one foot, the first in the file is chosen.
///
/// * `center` - centre of mass, frame of the base, m
///
/// # Errors
/// [`Error::Invalid`] if there are no feet, or more than [`MAX_FEET`].
pub fn find(tree: &Tree, frames: &[Isometry3<f64>], center: &Vector3<f64>) -> Result<Vec<usize>> {
    let mut movers = vec![None; frames.len()];
    for &link in &tree.order {
        let own = tree.above[link].filter(|&j| tree.model.joints[j].motion != Motion::Fixed);
        movers[link] = own.or_else(|| tree.parents[link].and_then(|parent| movers[parent]));
    }
    let height = |link: usize| contact(tree, frames, link).point().z;
    let leaves: Vec<(usize, f64)> = tree.leaves().filter(|&link| movers[link].is_some()).map(|link| (link, height(link))).collect();
    let lowest = leaves.iter().map(|leaf| leaf.1).fold(f64::INFINITY, f64::min);
    let ground = lowest + SAME_GROUND * (center.z - lowest);
    let mut moved = HashSet::new();
    let stands = |&(link, z): &(usize, f64)| (z <= ground && z < center.z && moved.insert(movers[link])).then_some(link);
    let feet: Vec<usize> = leaves.iter().filter_map(stands).collect();
    if feet.is_empty() || feet.len() > MAX_FEET {
        let names: Vec<String> = feet.iter().take(10).map(|&f| format!("`{}`", tree.model.links[f].name.escape_debug())).collect();
        let found = if feet.is_empty() { "none found".into() } else { format!("{} found: {}", feet.len(), names.join(", ")) };
        let limit = format!("1 to {MAX_FEET} links below the centre of mass: name them with --feet, or give another --configuration");
        return Err(Error::invalid("feet", found, limit));
    }
    Ok(feet)
}

/// Legs of the feet. A leg has the joints above its foot that move no other foot; the remaining joints belong to the body and are fixed.
///
/// * `values` - values of all joints, rad or m
/// * `center` - centre of mass, base frame, m; the origin of the legs' base frame
///
/// # Errors
/// [`Error::Invalid`] for a foot without a joint of its own, or with one that follows another joint.
pub fn legs(tree: &Tree, frames: &[Isometry3<f64>], values: &[f64], center: &Vector3<f64>, contacts: &[Contact]) -> Result<Vec<Leg>> {
    let paths: Vec<Vec<usize>> = contacts.iter().map(|contact| tree.path(contact.link)).collect();
    let mut users = vec![0; values.len()];
    paths.iter().flatten().for_each(|&j| users[j] += 1);
    let leg = |(contact, path): (&Contact, &Vec<usize>)| {
        let name = &tree.model.links[contact.link].name;
        let (mut chain, mut pending) = (Vec::new(), Isometry3::translation(-center.x, -center.y, -center.z));
        for &j in path {
            let joint = &tree.model.joints[j];
            if joint.motion == Motion::Fixed || users[j] > 1 {
                pending *= tree.transform(joint, values[j]);
                continue;
            }
            if let Some(mimic) = &joint.mimic {
                let value = format!("follows joint `{}`", mimic.joint.escape_debug());
                let limit = "moved by itself: joints of legs that follow others (mimic) are not supported";
                return Err(Error::invalid(format!("joint `{}`", joint.name.escape_debug()), value, limit));
            }
            chain.push(LegJoint {
                name: joint.name.clone(),
                turns: joint.motion == Motion::Revolute,
                origin: pending * joint.origin,
                axis: joint.axis,
                limits: joint.limits,
                velocity: joint.velocity,
                effort: joint.effort,
                nominal: values[j],
            });
            pending = Isometry3::identity();
        }
        if chain.len() > MAX_JOINTS {
            let limit = format!("moved by at most {MAX_JOINTS} joints");
            return Err(Error::invalid(format!("foot `{}`", name.escape_debug()), format!("{} joints", chain.len()), limit));
        }
        if chain.is_empty() {
            let limit = "moved by at least one joint that moves no other foot";
            return Err(Error::invalid(format!("foot `{}`", name.escape_debug()), "no joint of its own", limit));
        }
        let tip = frames[contact.link].inverse_transform_point(&Point3::from(contact.center));
        let axes = |sole: UnitQuaternion<f64>| pending.rotation * sole;
        let sole = contact.sole.map(axes).map(|axes| [axes.w, axes.i, axes.j, axes.k]);
        Ok(Leg { foot: name.clone(), tip: (pending * tip).coords.into(), radius: contact.radius, sole, chain })
    };
    contacts.iter().zip(&paths).map(leg).collect()
}

/// Links that the joints of a leg move.
pub fn moved_by(tree: &Tree, leg: &Leg) -> Vec<usize> {
    let mut moved = vec![false; tree.parents.len()];
    for &link in &tree.order {
        let first = tree.above[link].is_some_and(|j| tree.model.joints[j].name == leg.chain[0].name);
        moved[link] = first || tree.parents[link].is_some_and(|parent| moved[parent]);
    }
    (0..moved.len()).filter(|&link| moved[link]).collect()
}
