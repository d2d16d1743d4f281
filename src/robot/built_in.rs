//! The built-in robots, and the check that a robot with such a name is the built-in one.

use super::{Reach, Robot, SOLE_TURN, Sole};
use crate::error::{Error, Result};

/// Names of the built-in robots.
pub const ROBOTS: [&str; 7] = ["monoped", "biped", "humanoid", "hyq", "anymal", "pexod", "pexod-as-published"];

/// Largest deviation from the built-in robot of the same name, relative to the largest number of its kind. It also applies to a force limit
/// above the largest that a leg can bear. Leaves room for rounded numbers.
pub(crate) const ROUNDED: f64 = 0.01;

/// Symmetric matrix from its six entries.
fn symmetric(xx: f64, yy: f64, zz: f64, xy: f64, xz: f64, yz: f64) -> [[f64; 3]; 3] {
    [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
}

/// Feet in pairs left, right, from front to hind, mirrored in y: LF, RF, LH, RH for a quadruped.
fn pairs(xs: &[f64], y: f64, z: f64) -> Vec<[f64; 3]> {
    xs.iter().flat_map(|&x| [[x, y, z], [x, -y, z]]).collect()
}

/// Robot without reach, limits, joints and soles.
fn plain(name: &str, mass: f64, inertia: [[f64; 3]; 3], base_height: f64, nominal_feet: Vec<[f64; 3]>) -> Robot {
    Robot {
        name: name.into(),
        mass,
        inertia,
        base_height,
        nominal_feet,
        reach: [0.; 3].into(),
        force_limit: None,
        leg_mass: None,
        joints: None,
        foot_radius: None,
        sole: None,
    }
}

impl Robot {
    /// Built-in robot of a name. Sources of the numbers: \[3\] for monoped, biped, HyQ and ANYmal, \[4\] for the hexapod; the humanoid is
    /// made up.
    ///
    /// # Errors
    /// [`Error::Unknown`] lists [`ROBOTS`].
    pub fn named(name: &str) -> Result<Robot> {
        let (mass, inertia, base_height, nominal_feet, reach) = match name {
            "monoped" => (20., symmetric(1.2, 5.5, 6.0, 0., 0.2, 0.01), 0.58, vec![[0., 0., -0.58]], [0.25, 0.15, 0.2]),
            "biped" => (20., symmetric(1.209, 5.583, 6.056, -0.005, 0.19, 0.012), 0.65, pairs(&[0.], 0.2, -0.65), [0.25, 0.15, 0.15]),
            // Height and mass of a small humanoid on bent knees, soles of 0.2 m by 0.07 m. The inner sides of the boxes keep the feet apart.
            "humanoid" => {
                return Ok(Robot {
                    reach: Reach::boxes(vec![[[-0.3, 0.3], [-0.04, 0.15], [-0.1, 0.12]], [[-0.3, 0.3], [-0.15, 0.04], [-0.1, 0.12]]]),
                    leg_mass: Some(3.),
                    sole: Some(Sole { length: 0.2, width: 0.07, turn: SOLE_TURN }),
                    ..plain(name, 35., symmetric(3., 2.8, 0.45, 0., 0., 0.), 0.66, pairs(&[0.], 0.12, -0.66))
                });
            }
            "hyq" => {
                (83., symmetric(4.26, 8.97, 9.88, 0.0063, -0.193, -0.0126), 0.58, pairs(&[0.31, -0.31], 0.29, -0.58), [0.25, 0.2, 0.1])
            }
            "anymal" => (
                29.5,
                symmetric(0.946438, 1.94478, 2.01835, -0.000938112, 0.00595386, 0.00146328),
                0.5,
                pairs(&[0.34, -0.34], 0.19, -0.42),
                [0.15, 0.1, 0.1],
            ),
            // Inertia of a 0.24 x 0.20 x 0.04 m box.
            "pexod" => (
                1.031,
                symmetric(0.00357413333333, 0.00508626666667, 0.00838546666667, 0., 0., 0.),
                0.14,
                pairs(&[0.11, 0., -0.11], 0.185, -0.14),
                [0.15, 0.1, 0.05],
            ),
            // Numbers of `pexod` in the order in which the public code of [4] passes them. This body is physically impossible; it is kept
            // for comparisons.
            "pexod-as-published" => (
                1.031,
                symmetric(0.00357413333333, 0., 0., -0.00508626666667, 0., -0.00838546666667),
                0.14,
                pairs(&[0.11, 0., -0.11], 0.185, -0.14),
                [0.15, 0.1, 0.05],
            ),
            _ => return Err(Error::Unknown { what: "robot", name: name.into(), known: ROBOTS.join(", ") }),
        };
        Ok(Robot { reach: reach.into(), ..plain(name, mass, inertia, base_height, nominal_feet) })
    }

    /// Checks like [`Robot::validate`], and that a robot with the name of a built-in one equals it. Otherwise motions of another robot
    /// would be refused.
    ///
    /// # Errors
    /// See [`Robot::validate`]; also [`Error::Invalid`] with the first property that differs.
    pub fn validate_own(&self) -> Result<()> {
        self.validate()?;
        let Some(what) = self.differs_from_named() else { return Ok(()) };
        let limit = format!("a different name: the built-in robot of this name has another {what}");
        Err(Error::invalid("robot.name", format!("`{}`", self.name), limit))
    }

    /// Property in which it differs from the built-in robot of the same name, or `None`.
    pub(crate) fn differs_from_named(&self) -> Option<&'static str> {
        Robot::named(&self.name).ok().and_then(|named| self.difference(&named))
    }

    /// First property that differs from a built-in robot by more than rounding. Force limit and foot radius count only if the legs are
    /// stronger or the feet smaller.
    pub(crate) fn difference(&self, named: &Robot) -> Option<&'static str> {
        let near = |own: &[f64], named: &[f64]| {
            let scale = named.iter().fold(0., |scale: f64, v| scale.max(v.abs()));
            own.len() == named.len() && own.iter().zip(named).all(|(a, b)| (a - b).abs() <= ROUNDED * scale)
        };
        let feet = |robot: &Robot| robot.nominal_feet.concat();
        let inertia = |robot: &Robot| robot.inertia.concat();
        let force_limit = |robot: &Robot| robot.force_limit.unwrap_or_else(|| robot.default_force_limit());
        let soles = |robot: &Robot| robot.sole.map(|sole| [sole.length, sole.width, sole.turn]);
        let slabs =
            |robot: &Robot| (0..robot.feet()).flat_map(|foot| robot.reach.foot(foot).slabs().collect::<Vec<_>>()).collect::<Vec<_>>();
        let reach = |robot: &Robot| slabs(robot).iter().flat_map(|slab| slab.normal.into_iter().chain(slab.sides)).collect::<Vec<_>>();
        if !near(&[self.mass], &[named.mass]) {
            Some("mass")
        } else if !near(&[self.base_height], &[named.base_height]) {
            Some("base height")
        } else if !near(&inertia(self), &inertia(named)) {
            Some("inertia")
        } else if !near(&feet(self), &feet(named)) {
            Some("place of its feet")
        } else if !near(&reach(self), &reach(named)) {
            Some("reach")
        } else if soles(self) != soles(named) {
            Some("sole")
        } else if self.foot_radius.is_some_and(|radius| radius < (1. - ROUNDED) * named.foot_radius()) {
            Some("radius of its feet")
        } else if self.force_limit.is_some_and(|limit| limit > (1. + ROUNDED) * force_limit(named)) {
            Some("force limit")
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_file_with_a_built_in_name_must_hold_that_robot() {
        let read = |robot: &Robot| Robot::from_json(&serde_json::to_string(robot).unwrap()).map_err(|e| e.to_string());
        let anymal = Robot::named("anymal").unwrap();
        // Rounded numbers are accepted, and so is a weaker robot.
        read(&Robot { mass: 29.6, force_limit: Some(300.), foot_radius: Some(0.06), ..anymal.clone() }).unwrap();
        for (what, other) in [
            ("mass", Robot { mass: 31., ..anymal.clone() }),
            ("base height", Robot { base_height: 0.55, ..anymal.clone() }),
            ("reach", Robot { reach: [0.15, 0.2, 0.1].into(), ..anymal.clone() }),
            ("force limit", Robot { force_limit: Some(2000.), ..anymal.clone() }),
        ] {
            let error = read(&other).unwrap_err();
            assert!(error.contains("robot.name: `anymal`") && error.ends_with(&format!("has another {what}")), "{error}");
            read(&Robot { name: "own".into(), ..other }).unwrap();
        }
    }
}
