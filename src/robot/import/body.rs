//! Mass, centre of mass and inertia of all links together.

use super::model::Inertial;
use nalgebra::{Isometry3, Matrix3, Vector3};

/// Mass properties of a rigid body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass, m; the origin for a body without mass.
    pub center: Vector3<f64>,
    /// Inertia tensor about the centre of mass, kg m².
    pub inertia: Matrix3<f64>,
}

/// Mass properties of rigidly connected links: `I = sum R I_i R' + m_i (|d|^2 1 - d d')`, with `d` measured from the centre of mass.
///
/// * `links` - frame and mass properties of each link
pub fn composite<'a>(links: impl Iterator<Item = (&'a Isometry3<f64>, &'a Inertial)> + Clone) -> Body {
    let mass: f64 = links.clone().map(|(_, part)| part.mass).sum();
    let center_of = |frame: &Isometry3<f64>, part: &Inertial| (frame * part.origin).translation.vector;
    let moment: Vector3<f64> = links.clone().map(|(frame, part)| center_of(frame, part) * part.mass).sum();
    let center = if mass > 0. { moment / mass } else { Vector3::zeros() };
    let mut inertia = Matrix3::zeros();
    for (frame, part) in links {
        let turn = (frame.rotation * part.origin.rotation).to_rotation_matrix();
        let d = center_of(frame, part) - center;
        inertia += turn * part.inertia * turn.transpose() + (Matrix3::identity() * d.norm_squared() - d * d.transpose()) * part.mass;
    }
    // Removes the asymmetry caused by rounding.
    Body { mass, center, inertia: (inertia + inertia.transpose()) / 2. }
}
