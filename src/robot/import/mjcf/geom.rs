//! Geoms: solids that have a mass and may touch the ground.

use super::super::model::{Inertial, Shape};
use super::super::xml::list;
use super::reader::{Item, Reader, upright};
use super::solid::Solid;
use crate::error::Result;
use nalgebra::{Isometry3, Unit, Vector3};

/// Density of geoms without one, kg/m³.
const DENSITY: f64 = 1000.;

/// A geom of a body, in the frame of the body.
pub struct Geom {
    pub pose: Isometry3<f64>,
    pub solid: Option<Solid>,
    /// Mass if given, and density, kg and kg/m³.
    pub mass: Option<f64>,
    pub density: f64,
    pub collides: bool,
    pub weighed: bool,
}

impl Geom {
    /// Mass and inertia; `None` for a mesh.
    pub fn inertial(&self) -> Option<Inertial> {
        let solid = self.solid?;
        let mass = self.mass.unwrap_or_else(|| self.density * solid.volume());
        Some(Inertial { origin: self.pose, mass, inertia: mass * solid.inertia() })
    }
}

impl<'a> Reader<'a> {
    /// A geom; `None` for planes and height fields.
    pub fn geom(&self, item: Item<'a>, at: &Isometry3<f64>) -> Result<Option<Geom>> {
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
}
