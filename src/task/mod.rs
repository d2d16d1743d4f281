//! A task: which robot, on which ground, from where to where.

mod standing;
mod state;

pub use state::BaseState;

use crate::error::{Error, Result, check_range};
use crate::gait::{Curve, FootCurves, Trajectory};
use crate::robot::Robot;
use crate::terrain::Terrain;
use serde::Deserialize;
use standing::standing;
pub(crate) use standing::tilt_over;
use std::sync::Arc;

/// What is to be done: how the robot stands and moves at first, and how its base is to be at the end.
#[derive(Debug, Clone, PartialEq)]
pub struct Task {
    /// The robot.
    pub robot: Arc<Robot>,
    /// The ground.
    pub terrain: Arc<Terrain>,
    /// Base at the start.
    pub start: BaseState,
    /// Where each foot stands at the start (x, y), world frame, m.
    pub start_feet: Vec<[f64; 2]>,
    /// Force of each foot at the start and its slope, world frame, N and N/s; any when there are none. They let a motion go on from another.
    pub start_forces: Option<Vec<[f64; 6]>>,
    /// Base at the end.
    pub goal: BaseState,
    /// Largest normal force of a foot, N; the robot's or the transcription's when none is asked for.
    pub force_limit: Option<f64>,
}

/// Where the base is to be at one end of a motion. What is not said follows from the ground there.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Goal {
    /// Position, world frame, m.
    pub xy: [f64; 2],
    /// Height, m; without it as high above the ground as the robot's `base_height`, or as near to that as the feet reach the ground from.
    #[serde(default)]
    pub z: Option<f64>,
    /// Yaw, rad.
    #[serde(default)]
    pub yaw: f64,
    /// Roll and pitch, rad; without them along the ground under the feet or, where a height is given, level.
    #[serde(default)]
    pub tilt: Option<[f64; 2]>,
    /// Velocity, world frame, m/s.
    #[serde(default)]
    pub velocity: [f64; 3],
    /// Rates of roll, pitch and yaw, rad/s.
    #[serde(default)]
    pub rates: [f64; 3],
}

impl Goal {
    /// At rest above a point of the ground, with yaw 0.
    pub fn at(x: f64, y: f64) -> Goal {
        Goal { xy: [x, y], z: None, yaw: 0., tilt: None, velocity: [0.; 3], rates: [0.; 3] }
    }

    /// At rest and level at a position, with yaw 0.
    pub fn position([x, y, z]: [f64; 3]) -> Goal {
        Goal { z: Some(z), ..Goal::at(x, y) }
    }

    /// The same with a yaw, rad.
    pub fn yaw(self, yaw: f64) -> Goal {
        Goal { yaw, ..self }
    }

    /// The same with roll and pitch, rad.
    pub fn tilt(self, roll: f64, pitch: f64) -> Goal {
        Goal { tilt: Some([roll, pitch]), ..self }
    }

    /// The same with a velocity, world frame, m/s.
    pub fn velocity(self, velocity: [f64; 3]) -> Goal {
        Goal { velocity, ..self }
    }

    /// The state that is asked for.
    ///
    /// * `end` - its name in errors
    /// * `fixed_feet` - whether feet stand under their nominal places, or anywhere in reach
    fn state(&self, end: &str, robot: &Robot, terrain: &Terrain, fixed_feet: bool) -> Result<BaseState> {
        let [x, y] = self.xy;
        let level = BaseState::level([x, y, self.z.unwrap_or(0.)], self.yaw);
        let [roll, pitch] = self.tilt.unwrap_or_default();
        let asked = BaseState { angles: [roll, pitch, self.yaw], velocity: self.velocity, rates: self.rates, ..level };
        asked.validate(end)?;
        if self.z.is_some() {
            return Ok(asked);
        }
        terrain.check_inside(end, x, y)?;
        let standing = standing(robot, terrain, self.xy, self.yaw, self.tilt, fixed_feet);
        Ok(BaseState { velocity: self.velocity, rates: self.rates, ..standing })
    }
}

impl Task {
    /// A validated task that starts at rest above the origin with yaw 0, and has no force limit of its own.
    ///
    /// # Errors
    /// [`Error::Invalid`] when the goal is off the terrain, or a number is out of its limits.
    pub fn new(robot: impl Into<Arc<Robot>>, terrain: impl Into<Arc<Terrain>>, goal: Goal) -> Result<Task> {
        Task::between(robot, terrain, Goal::at(0., 0.), goal)
    }

    /// A validated task from one place to another, with the feet at their nominal places under the first.
    ///
    /// # Errors
    /// As [`Task::new`].
    pub fn between(robot: impl Into<Arc<Robot>>, terrain: impl Into<Arc<Terrain>>, start: Goal, goal: Goal) -> Result<Task> {
        let (robot, terrain) = (robot.into(), terrain.into());
        robot.validate()?;
        terrain.validate()?;
        let from = start.state("start", &robot, &terrain, true)?;
        let to = goal.state("goal", &robot, &terrain, false)?;
        Task::of_states(robot, terrain, from, None, to)
    }

    /// A validated task from one state to another.
    ///
    /// * `feet` - where they stand at the start (x, y), world frame, m; at their nominal places when none are given
    ///
    /// # Errors
    /// As [`Task::new`].
    pub fn of_states(
        robot: impl Into<Arc<Robot>>,
        terrain: impl Into<Arc<Terrain>>,
        start: BaseState,
        feet: Option<Vec<[f64; 2]>>,
        goal: BaseState,
    ) -> Result<Task> {
        let robot = robot.into();
        let start_feet = feet.unwrap_or_else(|| nominal_footholds(&robot, &start));
        let task = Task { robot, terrain: terrain.into(), start, start_feet, start_forces: None, goal, force_limit: None };
        task.validate()?;
        Ok(task)
    }

    /// Checks robot, terrain, both ends and the feet.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first value that is out of its limits.
    pub fn validate(&self) -> Result<()> {
        self.robot.validate()?;
        self.terrain.validate()?;
        for (end, state) in [("start", &self.start), ("goal", &self.goal)] {
            state.validate(end)?;
            let [x, y, z] = state.position;
            self.terrain.check_inside(end, x, y)?;
            let ground = self.terrain.height(x, y);
            if z <= ground {
                return Err(Error::invalid(format!("{end}.position[2]"), z, format!("above the terrain, which is {ground} m high there")));
            }
        }
        let feet = self.robot.feet();
        if self.start_feet.len() != feet {
            return Err(Error::invalid("start_feet", format!("{} feet", self.start_feet.len()), format!("those of the robot, {feet}")));
        }
        for (foot, place) in self.start_feet.iter().enumerate() {
            for axis in 0..2 {
                check_range(&format!("start_feet[{foot}][{axis}]"), place[axis], -1100., 1100.)?;
            }
        }
        if let Some(forces) = &self.start_forces {
            if forces.len() != feet {
                return Err(Error::invalid("start_forces", format!("{} feet", forces.len()), format!("those of the robot, {feet}")));
            }
            for (foot, force) in forces.iter().enumerate() {
                for (part, &value) in force.iter().enumerate() {
                    check_range(&format!("start_forces[{foot}][{part}]"), value, -1e9, 1e9)?;
                }
            }
        }
        self.force_limit.map_or(Ok(()), |limit| check_range("force_limit", limit, 1e-3, 1e7))
    }

    /// The straight line from start to goal: pose at a part of the way, m and rad.
    pub fn line(&self, part: f64) -> [f64; 6] {
        let (start, goal) = (self.start.pose(), self.goal.pose());
        std::array::from_fn(|i| start[i] + part * (goal[i] - start[i]))
    }

    /// From start to goal (x, y), in the axes of the base at the start, m.
    pub fn way(&self) -> [f64; 2] {
        let [x, y] = [0, 1].map(|i| self.goal.position[i] - self.start.position[i]);
        let (sin, cos) = self.start.yaw().sin_cos();
        [cos * x + sin * y, cos * y - sin * x]
    }

    /// From start to goal, rad.
    pub fn turn(&self) -> f64 {
        self.goal.yaw() - self.start.yaw()
    }

    /// A motion of this task, from its curves.
    ///
    /// * `transcription` - name of the rows that it was made for
    /// * `force_limit` - largest normal force of a foot that it was made for, N
    /// * `durations` - s, `[feet][phases]`
    /// * `base` - position, and Euler angles
    pub fn trajectory(
        &self,
        transcription: &str,
        force_limit: f64,
        durations: Vec<Vec<f64>>,
        horizon: f64,
        base: [Curve; 2],
        ee: Vec<FootCurves>,
    ) -> Trajectory {
        Trajectory {
            transcription: Some(transcription.into()),
            version: Some(env!("CARGO_PKG_VERSION").into()),
            init_base: Some(self.start.position),
            start: (!self.start.is_level() || self.start.yaw() != 0.).then_some(self.start),
            start_feet: (self.start_feet != nominal_footholds(&self.robot, &self.start)).then(|| self.start_feet.clone()),
            base_target: self.goal.position,
            yaw_target: self.goal.yaw(),
            goal: (!self.goal.is_level()).then_some(self.goal),
            force_limit: Some(force_limit),
            ..Trajectory::new(durations, horizon, base, ee)
        }
    }

    /// Ground under a foot at the start, m, measured along the vertical of the base.
    pub fn ground_at_start(&self, foot: usize) -> f64 {
        standing::ground_at(&self.terrain, &self.start, self.start_feet[foot])
    }

    /// Lowest and highest ground that a foot has within its reach along x and y at the goal, m, measured along the vertical of the base.
    pub fn ground_at_goal(&self, foot: usize) -> [f64; 2] {
        standing::ground_of_foot(&self.robot, &self.terrain, &self.goal, foot, false)
    }

    /// Lowest and highest base at the goal from which every foot reaches ground, m; empty, with the lowest above the highest, where no height will do.
    pub fn heights_at_goal(&self) -> [f64; 2] {
        standing::heights(&self.robot, &self.terrain, &self.goal, false)
    }

    /// Foothold of a foot at the start (x, y), world frame, m.
    pub fn foothold_start(&self, foot: usize) -> [f64; 2] {
        self.start_feet[foot]
    }

    /// Nominal foothold of a foot at the goal (x, y), world frame, m.
    pub fn foothold_goal(&self, foot: usize) -> [f64; 2] {
        let [x, y, _] = self.goal.to_world(self.robot.nominal_feet[foot]);
        [x, y]
    }
}

/// Where the nominal feet of a base are (x, y), world frame, m.
pub fn nominal_footholds(robot: &Robot, base: &BaseState) -> Vec<[f64; 2]> {
    let foothold = |&foot: &[f64; 3]| {
        let [x, y, _] = base.to_world(foot);
        [x, y]
    };
    robot.nominal_feet.iter().map(foothold).collect()
}
