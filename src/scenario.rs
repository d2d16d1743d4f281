//! Scenarios of the paper \[1\]: a robot, a terrain and twenty targets on an arc.

use crate::error::{Error, Result};
use crate::robot::Robot;
use crate::task::{Goal, Task};
use crate::terrain::Terrain;
use std::f64::consts::PI;

/// Distance of every target from the origin, m.
pub const TARGET_DISTANCE: f64 = 6.;

/// Number of targets per scenario.
pub const TARGETS: usize = 20;

/// A named scenario.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scenario {
    /// Name on the command line and in files.
    pub name: &'static str,
    /// Description.
    pub about: &'static str,
    /// Built-in robot.
    pub robot: &'static str,
    /// Built-in terrain.
    pub terrain: &'static str,
    /// Final yaw, rad.
    pub yaw_target: f64,
}

/// All scenarios.
pub const SCENARIOS: [Scenario; 5] = [
    Scenario { name: "s1", about: "quadruped, 6 m on flat ground", robot: "anymal", terrain: "flat", yaw_target: 0. },
    Scenario { name: "s2", about: "quadruped, 6 m on flat ground while turning round", robot: "anymal", terrain: "flat", yaw_target: PI },
    Scenario { name: "s3", about: "quadruped, 6 m up a 0.15 m step while turning round", robot: "anymal", terrain: "step", yaw_target: PI },
    Scenario { name: "biped", about: "biped, 6 m on flat ground", robot: "biped", terrain: "flat", yaw_target: 0. },
    Scenario { name: "hex", about: "hexapod, 6 m on flat ground", robot: "pexod", terrain: "flat", yaw_target: 0. },
];

impl Scenario {
    /// Finds a scenario by name.
    ///
    /// # Errors
    /// [`Error::Unknown`] lists [`SCENARIOS`].
    pub fn named(name: &str) -> Result<Scenario> {
        SCENARIOS.iter().find(|s| s.name == name).copied().ok_or_else(|| Error::Unknown {
            what: "scenario",
            name: name.into(),
            known: SCENARIOS.map(|s| s.name).join(", "),
        })
    }

    /// Position (x, y) of target `1..=20`, m: `6 (cos a, sin a)`, `a = -pi/4 + (target - 1)/19 pi/2`.
    ///
    /// # Errors
    /// [`Error::Invalid`] if there is no such target.
    pub fn goal(target: usize) -> Result<[f64; 2]> {
        if !(1..=TARGETS).contains(&target) {
            return Err(Error::invalid("target", target, format!("1 to {TARGETS}")));
        }
        let angle = -PI / 4. + (target - 1) as f64 / (TARGETS - 1) as f64 * PI / 2.;
        Ok([TARGET_DISTANCE * angle.cos(), TARGET_DISTANCE * angle.sin()])
    }

    /// Task of the scenario for a target.
    ///
    /// # Errors
    /// [`Error::Invalid`] if there is no such target.
    pub fn task(&self, target: usize) -> Result<Task> {
        self.task_to(Scenario::goal(target)?)
    }

    /// Task of the scenario for another goal (x, y), m.
    ///
    /// # Errors
    /// The errors of [`Task::new`].
    pub fn task_to(&self, [x, y]: [f64; 2]) -> Result<Task> {
        Task::new(Robot::named(self.robot)?, Terrain::named(self.terrain)?, Goal::at(x, y).yaw(self.yaw_target))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn target_10_is_where_the_reference_data_has_it() {
        let task = Scenario::named("s3").unwrap().task(10).unwrap();
        let expected = [5.994874550323806, -0.2479498454928793, 0.65];
        for axis in 0..3 {
            assert!((task.goal.position[axis] - expected[axis]).abs() < 1e-12);
        }
        assert!(Scenario::goal(21).is_err() && Scenario::named("s4").is_err());
    }
}
