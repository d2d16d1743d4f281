//! Robot models: a single rigid body whose feet reach inside boxes and slabs.

mod built_in;
#[cfg(feature = "urdf")]
pub mod import;
pub mod leg;
mod reach;
mod sole;

pub use built_in::ROBOTS;
pub(crate) use built_in::ROUNDED;
pub use reach::{FootReach, Reach, ReachBox, Slab};
pub(crate) use sole::LARGEST_TURN;
pub use sole::{PRESSURE_SHARE, SOLE_TURN, Sole};

use crate::error::{Error, Result, check_name, check_range};
use crate::files;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Standard gravity, m/s². Source: \[3\].
pub const GRAVITY: f64 = 9.80665;

/// Largest number of feet.
pub const MAX_FEET: usize = 8;

/// A legged robot as the solver sees it.
///
/// The origin of the base frame is the centre of mass: x forward, y left, z up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Robot {
    /// Name, shown in results.
    pub name: String,
    /// Mass, kg.
    pub mass: f64,
    /// Inertia tensor about the centre of mass, base frame, kg m², rows of the symmetric 3 x 3 matrix.
    /// Off-diagonal entries are tensor entries: `inertia[0][1] = -int x y dm`.
    pub inertia: [[f64; 3]; 3],
    /// Height of the base above the terrain at the start, m.
    pub base_height: f64,
    /// Nominal foot positions in the base frame, m, `[feet][3]`.
    pub nominal_feet: Vec<[f64; 3]>,
    /// Offsets from its nominal position that each foot can reach.
    pub reach: Reach,
    /// Largest normal force of a foot, N. Default: [`Robot::default_force_limit`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_limit: Option<f64>,
    /// Equivalent mass of a leg at its foot, kg. Default: [`LEG_MASS`] times the mass.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub leg_mass: Option<f64>,
    /// Joints of each leg, used for joint trajectories. The solver does not need them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joints: Option<Vec<leg::Leg>>,
    /// Radius of the foot ball, m; 0 for a point foot. Default: [`FOOT_RADIUS`] times the leg height. The foot position of a motion is the
    /// point where the ball touches the ground.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub foot_radius: Option<f64>,
    /// Flat sole of every foot. Default: none, the feet are balls or points. A foot with a sole has no ball.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sole: Option<Sole>,
}

/// Default equivalent mass of a leg at its foot, relative to the mass of the robot.
pub const LEG_MASS: f64 = 0.03;

/// Default radius of a foot, in leg heights. Unitree's quadrupeds have 0.02 m at 0.25 to 0.32 m, ANYmal 0.03 m at 0.42 m.
pub const FOOT_RADIUS: f64 = 0.06;

/// Largest normal force of a foot if the leg's own strength is not limited, in weights: the load on a runner's leg.
pub const FORCE_LIMIT_WEIGHTS: f64 = 3.;

impl Robot {
    /// Reads a robot from JSON text and validates it.
    ///
    /// # Errors
    /// [`Error::Format`] for malformed JSON, unknown or missing keys; [`Error::Invalid`] for impossible values.
    pub fn from_json(text: &str) -> Result<Robot> {
        let robot: Robot = crate::error::from_json(text)?;
        robot.validate_own()?;
        Ok(robot)
    }

    /// Reads a robot from a file and validates it. The file is TOML if its name ends in `.toml`, otherwise JSON.
    ///
    /// # Errors
    /// See [`Robot::from_json`], with the name of the file; [`Error::Io`] if the system refuses.
    pub fn read(path: &Path) -> Result<Robot> {
        let robot: Robot = files::read_value(path)?;
        robot.validate_own().map_err(|e| e.in_file(path, None))?;
        Ok(robot)
    }

    /// Text of a robot file in the format that [`Robot::read`] expects for a file of this name.
    ///
    /// # Errors
    /// [`Error::Format`] for values that TOML cannot represent.
    pub fn file_text(&self, path: &Path) -> Result<String> {
        if files::is_toml(path) { crate::error::to_toml(self) } else { Ok(serde_json::to_string_pretty(self)? + "\n") }
    }

    /// Checks that this is a physically possible body.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first field that is out of range.
    pub fn validate(&self) -> Result<()> {
        check_name("robot.name", &self.name)?;
        check_range("robot.mass", self.mass, 1e-3, 1e6)?;
        check_range("robot.base_height", self.base_height, 1e-3, 100.)?;
        if self.nominal_feet.is_empty() || self.nominal_feet.len() > MAX_FEET {
            return Err(Error::invalid("robot.nominal_feet", format!("{} feet", self.nominal_feet.len()), format!("1 to {MAX_FEET} feet")));
        }
        for (foot, p) in self.nominal_feet.iter().enumerate() {
            for (axis, &v) in p.iter().enumerate() {
                check_range(&format!("robot.nominal_feet[{foot}][{axis}]"), v, -100., 100.)?;
            }
        }
        self.reach.validate(self.feet())?;
        if let Some(limit) = self.force_limit {
            check_range("robot.force_limit", limit, 1e-3, 1e7)?;
        }
        if let Some(mass) = self.leg_mass {
            check_range("robot.leg_mass", mass, 0., self.mass)?;
        }
        if let Some(legs) = &self.joints {
            if legs.len() != self.feet() {
                let limit = format!("{} legs, one for each of `nominal_feet`", self.feet());
                return Err(Error::invalid("robot.joints", format!("{} legs", legs.len()), limit));
            }
            for (foot, leg) in legs.iter().enumerate() {
                leg.validate(&format!("robot.joints[{foot}]"))?;
                if leg.sole.is_some() != self.sole.is_some() {
                    let [value, limit] = if self.sole.is_some() {
                        ["absent", "the axes of the sole: the robot has a `sole`"]
                    } else {
                        ["the axes of a sole", "absent: the robot has no `sole`"]
                    };
                    return Err(Error::invalid(format!("robot.joints[{foot}].sole"), value, limit));
                }
            }
        }
        if let Some(radius) = self.foot_radius {
            check_range("robot.foot_radius", radius, 0., self.leg_height() / 2.)?;
        }
        if let Some(sole) = &self.sole {
            sole.validate(self.leg_height())?;
            if let Some(radius) = self.foot_radius.filter(|radius| *radius != 0.) {
                return Err(Error::invalid("robot.foot_radius", radius, "0 or absent for feet with a `sole`"));
            }
        }
        let i = &self.inertia;
        for r in 0..3 {
            for c in 0..3 {
                check_range(&format!("robot.inertia[{r}][{c}]"), i[r][c], -1e6, 1e6)?;
                if i[r][c] != i[c][r] {
                    return Err(Error::invalid(
                        format!("robot.inertia[{r}][{c}]"),
                        i[r][c],
                        format!("equal to inertia[{c}][{r}] = {}", i[c][r]),
                    ));
                }
            }
        }
        if self.name == "pexod-as-published" && *self == Robot::named("pexod-as-published")? {
            return Ok(());
        }
        let mut eigen = nalgebra::Matrix3::from_fn(|r, c| i[r][c]).symmetric_eigenvalues();
        eigen.as_mut_slice().sort_by(f64::total_cmp);
        if eigen[0] <= 0. || eigen[0] + eigen[1] < eigen[2] * (1. - 1e-9) {
            return Err(Error::invalid(
                "robot.inertia",
                format!("principal moments {:.4e}, {:.4e}, {:.4e}", eigen[0], eigen[1], eigen[2]),
                "positive, none larger than the sum of the other two",
            ));
        }
        Ok(())
    }

    /// Number of feet.
    pub fn feet(&self) -> usize {
        self.nominal_feet.len()
    }

    /// Reach box of each foot, in the order of the feet.
    pub fn reach_boxes(&self) -> impl Iterator<Item = ReachBox> {
        (0..self.feet()).map(|foot| self.reach.of(foot))
    }

    /// Nominal leg height, m: the length that makes moments dimensionless. At least 0.1 m.
    pub fn leg_height(&self) -> f64 {
        self.nominal_feet[0][2].abs().max(0.1)
    }

    /// Default largest normal force of a foot, N: 1.2 weights for three feet or more, 2.5 for two, 3 for one. A biped needs at least two
    /// weights for a flight phase; a quadruped hardly needs one.
    pub fn default_force_limit(&self) -> f64 {
        let weights = match self.feet() {
            1 => FORCE_LIMIT_WEIGHTS,
            2 => 2.5,
            _ => 1.2,
        };
        weights * self.weight()
    }

    /// Equivalent mass of a leg at its foot, kg.
    pub fn leg_mass(&self) -> f64 {
        self.leg_mass.unwrap_or(LEG_MASS * self.mass)
    }

    /// Radius of the foot ball, m; 0 for a point foot and for a sole.
    pub fn foot_radius(&self) -> f64 {
        let default = || if self.sole.is_some() { 0. } else { FOOT_RADIUS * self.leg_height() };
        self.foot_radius.unwrap_or_else(default)
    }

    /// Weight, N.
    pub fn weight(&self) -> f64 {
        self.mass * GRAVITY
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_robot_is_valid_and_survives_json() {
        for name in ROBOTS {
            let robot = Robot::named(name).unwrap();
            robot.validate().unwrap();
            assert_eq!(Robot::from_json(&serde_json::to_string(&robot).unwrap()).unwrap(), robot);
            let ball = if robot.sole.is_some() { 0. } else { 0.06 * robot.leg_height() };
            assert_eq!(robot.foot_radius(), ball);
        }
        assert!(Robot::named("cat").unwrap_err().to_string().contains("anymal"));
    }

    #[test]
    fn the_file_name_selects_toml_or_json() {
        let folder = tempfile::tempdir().unwrap();
        let mut robot = Robot { name: "own".into(), ..Robot::named("biped").unwrap() };
        robot.reach = Reach::boxes(vec![[[-0.1, 0.2], [0., 0.1], [-0.2, 1. / 3.]]; 2]);
        robot.force_limit = Some(500.);
        for name in ["robot.toml", "robot.TOML", "robot.json", "robot"] {
            let path = folder.path().join(name);
            files::write(&path, &robot.file_text(&path).unwrap()).unwrap();
            assert_eq!(files::read(&path).unwrap().starts_with('{'), !name.to_lowercase().ends_with("toml"));
            assert_eq!(Robot::read(&path).unwrap(), robot);
        }
        let good = robot.file_text(Path::new("robot.toml")).unwrap();
        for (from, to, parts) in [
            ("mass = 20.0", "mass = 0", ["robot.mass", "0, but"]),
            ("mass = 20.0", "mass = \"heavy\"", ["line 2", "mass"]),
            ("mass = 20.0", "wings = 2", ["wings", "line 2"]),
            ("mass = 20.0", "mass = ", ["line 2", "robot.toml"]),
        ] {
            let path = folder.path().join("robot.toml");
            files::write(&path, &good.replace(from, to)).unwrap();
            let error = Robot::read(&path).unwrap_err().to_string();
            assert!(parts.iter().all(|part| error.contains(part)) && error.lines().count() == 1, "{error}");
        }
        assert!(Robot::read(&folder.path().join("none.toml")).unwrap_err().to_string().contains("none.toml"));
    }

    #[test]
    fn feet_may_be_points_and_at_most_half_a_leg_in_radius() {
        let with = |radius| Robot { name: "own".into(), foot_radius: Some(radius), ..Robot::named("anymal").unwrap() };
        assert_eq!(Robot::from_json(&serde_json::to_string(&with(0.)).unwrap()).unwrap().foot_radius(), 0.);
        with(0.21).validate().unwrap();
        for radius in [-0.01, 0.22, f64::NAN] {
            assert!(with(radius).validate().unwrap_err().to_string().contains("robot.foot_radius"));
        }
    }

    #[test]
    fn impossible_bodies_are_refused() {
        let mut robot = Robot::named("anymal").unwrap();
        robot.inertia[2][2] = 10.;
        assert!(robot.validate().unwrap_err().to_string().contains("principal moments"));
        let mut robot = Robot::named("anymal").unwrap();
        robot.nominal_feet = vec![[0.; 3]; 9];
        assert!(robot.validate().unwrap_err().to_string().contains("9 feet"));
        assert!(Robot::from_json(r#"{"name":"x","mass":1,"wings":2}"#).unwrap_err().to_string().contains("wings"));
    }
}
