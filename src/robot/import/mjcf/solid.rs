//! Volumes and inertias of uniform solids.

use super::super::model::Shape;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::PI;

/// A solid about its centre. Cylinders and capsules are along z. Lengths in m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Solid {
    /// A shape that feet can have.
    Shape(Shape),
    /// Half-axes.
    Ellipsoid([f64; 3]),
}

impl Solid {
    /// Volume, m³.
    pub fn volume(self) -> f64 {
        match self {
            Solid::Shape(Shape::Sphere(r)) => 4. / 3. * PI * r.powi(3),
            Solid::Shape(Shape::Box([x, y, z])) => x * y * z,
            Solid::Shape(Shape::Cylinder(r, length)) => PI * r * r * length,
            Solid::Shape(Shape::Capsule(r, length)) => PI * r * r * (length + 4. / 3. * r),
            Solid::Ellipsoid([x, y, z]) => 4. / 3. * PI * x * y * z,
        }
    }

    /// Inertia tensor about the centre for a mass of 1 kg, m².
    pub fn inertia(self) -> Matrix3<f64> {
        let diagonal = match self {
            Solid::Shape(Shape::Sphere(r)) => [0.4 * r * r; 3],
            Solid::Shape(Shape::Box([x, y, z])) => [y * y + z * z, x * x + z * z, x * x + y * y].map(|v| v / 12.),
            Solid::Shape(Shape::Cylinder(r, length)) => {
                let across = (3. * r * r + length * length) / 12.;
                [across, across, r * r / 2.]
            }
            Solid::Shape(Shape::Capsule(r, length)) => {
                // Two half balls, whose centres of mass are 3/8 r beyond the ends of the cylinder.
                let caps = 4. * r / (4. * r + 3. * length);
                let across =
                    (1. - caps) * (3. * r * r + length * length) / 12. + caps * (0.4 * r * r + length * length / 4. + 3. / 8. * length * r);
                [across, across, (1. - caps) * r * r / 2. + caps * 0.4 * r * r]
            }
            Solid::Ellipsoid([x, y, z]) => [y * y + z * z, x * x + z * z, x * x + y * y].map(|v| v / 5.),
        };
        Matrix3::from_diagonal(&Vector3::from(diagonal))
    }
}
