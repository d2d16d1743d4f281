//! A task: robot, terrain, and the states of the base at start and goal.

mod relief;
mod standing;
mod state;
mod stride;

pub use state::{BaseState, SwingState};
pub use stride::PeriodicStride;

use crate::error::{Error, Result, check_range};
use crate::gait::schedule::MAX_HORIZON;
use crate::gait::{Curve, FootCurves, Schedule, Trajectory};
use crate::robot::Robot;
use crate::terrain::Terrain;
use serde::{Deserialize, Serialize};
use standing::standing;
pub(crate) use standing::tilt_over;
use std::borrow::Cow;
use std::sync::Arc;

/// A motion problem: the initial state of the robot and the goal state of its base.
#[derive(Debug, Clone, PartialEq)]
pub struct Task {
    /// Robot.
    pub robot: Arc<Robot>,
    /// Terrain.
    pub terrain: Arc<Terrain>,
    /// State of the base at the start.
    pub start: BaseState,
    /// Initial foothold of each foot (x, y), world frame, m.
    pub start_feet: Vec<[f64; 2]>,
    /// State of each foot that is in the air at the start; `None` for a foot that stands. `[feet]`
    pub start_swings: Vec<Option<SwingState>>,
    /// Yaw of each sole at the start, world frame, rad; that of the base by default. Without effect for feet without soles. `[feet]`
    pub start_yaws: Vec<f64>,
    /// State of the base at the goal.
    pub goal: BaseState,
    /// Largest normal force of a foot, N. Default: the robot's, or else the transcription's.
    pub force_limit: Option<f64>,
    /// Duration of the motion, s. Schedules are scaled to it. Default: that of each schedule.
    pub duration: Option<f64>,
    /// Stride that repeats, if one does.
    pub stride: Option<PeriodicStride>,
}

/// Shortest duration of a motion, s.
const LEAST_DURATION: f64 = 0.05;

/// Largest difference between two states that is attributed to rounding, m, rad, m/s and rad/s.
const SAME: f64 = 1e-9;

/// State of the base at one end of a motion. Missing values follow from the ground there.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Goal {
    /// Position, world frame, m.
    pub xy: [f64; 2],
    /// Height, m. Default: the robot's `base_height` above the ground, or the closest height from which all feet reach the ground.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub z: Option<f64>,
    /// Yaw, rad.
    #[serde(default)]
    pub yaw: f64,
    /// Roll and pitch, rad. Default: along the ground under the feet, or level if a height is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tilt: Option<[f64; 2]>,
    /// Velocity, world frame, m/s.
    #[serde(default)]
    pub velocity: [f64; 3],
    /// Rates of roll, pitch and yaw, rad/s.
    #[serde(default)]
    pub rates: [f64; 3],
    /// Time of arrival, s from the start. Default: any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<f64>,
}

impl Goal {
    /// Rest above a point of the ground, with yaw 0.
    pub fn at(x: f64, y: f64) -> Goal {
        Goal { xy: [x, y], z: None, yaw: 0., tilt: None, velocity: [0.; 3], rates: [0.; 3], time: None }
    }

    /// Rest at a position, level, with yaw 0.
    pub fn position([x, y, z]: [f64; 3]) -> Goal {
        Goal { z: Some(z), ..Goal::at(x, y) }
    }

    /// Sets the yaw, rad.
    pub fn yaw(self, yaw: f64) -> Goal {
        Goal { yaw, ..self }
    }

    /// Sets roll and pitch, rad.
    pub fn tilt(self, roll: f64, pitch: f64) -> Goal {
        Goal { tilt: Some([roll, pitch]), ..self }
    }

    /// Sets the velocity, world frame, m/s.
    pub fn velocity(self, velocity: [f64; 3]) -> Goal {
        Goal { velocity, ..self }
    }

    /// Sets the time of arrival, s from the start.
    pub fn arriving(self, time: f64) -> Goal {
        Goal { time: Some(time), ..self }
    }

    /// State of the base with all defaults filled in.
    ///
    /// * `end` - name of the state in errors
    /// * `fixed_feet` - true if the feet are at their nominal positions, false if they may be anywhere in reach
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
    /// [`Error::Invalid`] if the goal is outside the terrain, or a number is out of range.
    pub fn new(robot: impl Into<Arc<Robot>>, terrain: impl Into<Arc<Terrain>>, goal: Goal) -> Result<Task> {
        Task::between(robot, terrain, Goal::at(0., 0.), goal)
    }

    /// A validated task between two states, with the feet initially at their nominal positions.
    ///
    /// # Errors
    /// See [`Task::new`].
    pub fn between(robot: impl Into<Arc<Robot>>, terrain: impl Into<Arc<Terrain>>, start: Goal, goal: Goal) -> Result<Task> {
        Task::from_feet(robot, terrain, start, None, goal)
    }

    /// A validated task between two states.
    ///
    /// * `feet` - initial footholds (x, y), world frame, m. Default: the nominal positions
    ///
    /// # Errors
    /// See [`Task::new`].
    pub fn from_feet(
        robot: impl Into<Arc<Robot>>,
        terrain: impl Into<Arc<Terrain>>,
        start: Goal,
        feet: Option<Vec<[f64; 2]>>,
        goal: Goal,
    ) -> Result<Task> {
        let (robot, terrain) = (robot.into(), terrain.into());
        robot.validate()?;
        terrain.validate()?;
        let from = start.state("start", &robot, &terrain, true)?;
        let to = goal.state("goal", &robot, &terrain, false)?;
        let task = Task { duration: goal.time, ..Task::of_states(robot, terrain, from, feet, to)? };
        task.validate()?;
        Ok(task)
    }

    /// A validated task between two complete states.
    ///
    /// * `feet` - initial footholds (x, y), world frame, m. Default: the nominal positions
    ///
    /// # Errors
    /// See [`Task::new`].
    pub fn of_states(
        robot: impl Into<Arc<Robot>>,
        terrain: impl Into<Arc<Terrain>>,
        start: BaseState,
        feet: Option<Vec<[f64; 2]>>,
        goal: BaseState,
    ) -> Result<Task> {
        let robot = robot.into();
        let start_feet = feet.unwrap_or_else(|| nominal_footholds(&robot, &start));
        let start_swings = vec![None; start_feet.len()];
        let start_yaws = vec![start.yaw(); start_feet.len()];
        let terrain = terrain.into();
        let task =
            Task { robot, terrain, start, start_feet, start_swings, start_yaws, goal, force_limit: None, duration: None, stride: None };
        task.validate()?;
        Ok(task)
    }

    /// Copy of the task with feet that are in the air at the start.
    ///
    /// * `swings` - state of each foot that is in the air, `None` for a foot that stands, `[feet]`
    ///
    /// # Errors
    /// [`Error::Invalid`] if the number of feet is not that of the robot, or a number is out of range.
    pub fn with_swings(&self, swings: Vec<Option<SwingState>>) -> Result<Task> {
        let mut task = Task { start_swings: swings, ..self.clone() };
        for (place, swing) in task.start_feet.iter_mut().zip(&task.start_swings) {
            if let Some(SwingState { position: [x, y, _], .. }) = swing {
                *place = [*x, *y];
            }
        }
        task.validate()?;
        Ok(task)
    }

    /// Copy of the task with another goal.
    ///
    /// # Errors
    /// See [`Task::new`].
    pub fn to(&self, goal: Goal) -> Result<Task> {
        let task = Task { goal: goal.state("goal", &self.robot, &self.terrain, false)?, duration: goal.time, ..self.clone() };
        task.validate()?;
        Ok(task)
    }

    /// Copy of the task that starts at the end of a motion, with the base and the feet as they are there.
    ///
    /// # Errors
    /// See [`Task::new`]; also for a motion with another number of feet.
    pub fn after(&self, motion: &Trajectory) -> Result<Task> {
        let (end, asked) = (motion.end_state(), motion.goal_state());
        let apart = |a: [f64; 6], b: [f64; 6]| (0..6).any(|i| (a[i] - b[i]).abs() > SAME);
        let from = if apart(end.pose(), asked.pose()) || apart(end.rate(), asked.rate()) { end } else { asked };
        let task = Task::of_states(self.robot.clone(), self.terrain.clone(), from, Some(motion.end_feet()), self.goal)?;
        let start_yaws = motion.end_yaws().unwrap_or(task.start_yaws.clone());
        Task { force_limit: self.force_limit, duration: self.duration, start_yaws, ..task }.with_swings(motion.end_swings())
    }

    /// Checks robot, terrain, both ends and the feet.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first value that is out of range.
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
            return Err(Error::invalid("start_feet", format!("{} feet", self.start_feet.len()), format!("{feet} feet, as the robot has")));
        }
        if self.start_swings.len() != feet {
            let limit = format!("{feet} feet, as the robot has");
            return Err(Error::invalid("start_swings", format!("{} feet", self.start_swings.len()), limit));
        }
        for (foot, swing) in self.start_swings.iter().enumerate() {
            swing.map_or(Ok(()), |swing| swing.validate(foot))?;
        }
        if self.start_yaws.len() != feet {
            return Err(Error::invalid("start_yaws", format!("{} feet", self.start_yaws.len()), format!("{feet} feet, as the robot has")));
        }
        for (foot, yaw) in self.start_yaws.iter().enumerate() {
            check_range(&format!("start_yaws[{foot}]"), *yaw, -1e3, 1e3)?;
        }
        for (foot, place) in self.start_feet.iter().enumerate() {
            for axis in 0..2 {
                check_range(&format!("start_feet[{foot}][{axis}]"), place[axis], -1100., 1100.)?;
            }
        }
        self.duration.map_or(Ok(()), |duration| check_range("goal.time", duration, LEAST_DURATION, MAX_HORIZON))?;
        self.force_limit.map_or(Ok(()), |limit| check_range("force_limit", limit, 1e-3, 1e7))
    }

    /// A schedule of this task: with its duration, if it has one.
    ///
    /// # Errors
    /// [`Error::Invalid`] if a phase becomes too short.
    pub fn timed<'a>(&self, schedule: &'a Schedule) -> Result<Cow<'a, Schedule>> {
        self.duration.map_or(Ok(Cow::Borrowed(schedule)), |duration| schedule.lasting(duration).map(Cow::Owned))
    }

    /// Interval between base knots, of which the duration is a multiple, s.
    ///
    /// * `longest` - interval without a duration, s
    pub fn interval(&self, longest: f64) -> f64 {
        self.duration.map_or(longest, |duration| duration / (duration / longest - 1e-9).ceil())
    }

    /// Pose on the straight line from start to goal, m and rad.
    ///
    /// * `part` - 0 at the start, 1 at the goal
    pub fn line(&self, part: f64) -> [f64; 6] {
        let (start, goal) = (self.start.pose(), self.goal.pose());
        std::array::from_fn(|i| start[i] + part * (goal[i] - start[i]))
    }

    /// Displacement from start to goal (x, y), in the axes of the base at the start, m.
    pub fn displacement(&self) -> [f64; 2] {
        let [x, y] = [0, 1].map(|i| self.goal.position[i] - self.start.position[i]);
        let (sin, cos) = self.start.yaw().sin_cos();
        [cos * x + sin * y, cos * y - sin * x]
    }

    /// Change of yaw from start to goal, rad.
    pub fn turn(&self) -> f64 {
        self.goal.yaw() - self.start.yaw()
    }

    /// Trajectory of this task, made of its curves.
    ///
    /// * `transcription` - name of the transcription that it was solved with
    /// * `force_limit` - largest normal force of a foot in its solve, N
    /// * `durations` - phase durations, s, `[feet][phases]`
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
        let own = Trajectory {
            transcription: Some(transcription.into()),
            version: Some(env!("CARGO_PKG_VERSION").into()),
            force_limit: Some(force_limit),
            ..Trajectory::new(durations, horizon, base, ee)
        };
        self.asked_of(own)
    }

    /// Copy of a motion whose required start and goal are those of this task.
    pub fn asked_of(&self, motion: Trajectory) -> Trajectory {
        Trajectory {
            init_base: Some(self.start.position),
            start: (!self.start.is_level() || self.start.yaw() != 0.).then_some(self.start),
            start_feet: (self.start_feet != nominal_footholds(&self.robot, &self.start)).then(|| self.start_feet.clone()),
            start_yaws: (self.robot.sole.is_some() && self.start_yaws.iter().any(|yaw| *yaw != self.start.yaw()))
                .then(|| self.start_yaws.clone()),
            start_swings: self.start_swings.iter().any(Option::is_some).then(|| self.start_swings.clone()),
            base_target: self.goal.position,
            yaw_target: self.goal.yaw(),
            goal: (!self.goal.is_level()).then_some(self.goal),
            ..motion
        }
    }

    /// Ground under a foot at the start, m, measured along the vertical of the base.
    pub fn ground_at_start(&self, foot: usize) -> f64 {
        standing::ground_at(&self.terrain, &self.start, self.start_feet[foot])
    }

    /// Lowest and highest ground within a foot's reach along x and y at the goal, m, measured along the vertical of the base.
    pub fn ground_at_goal(&self, foot: usize) -> [f64; 2] {
        standing::ground_of_foot(&self.robot, &self.terrain, &self.goal, foot, false)
    }

    /// Lowest and highest base position at the goal from which every foot reaches the ground, m. The first exceeds the second if there is
    /// none.
    pub fn heights_at_goal(&self) -> [f64; 2] {
        standing::heights(&self.robot, &self.terrain, &self.goal, false)
    }

    /// Initial foothold of a foot (x, y), world frame, m.
    pub fn foothold_start(&self, foot: usize) -> [f64; 2] {
        self.start_feet[foot]
    }

    /// Nominal foothold of a foot at the goal (x, y), world frame, m.
    pub fn foothold_goal(&self, foot: usize) -> [f64; 2] {
        let [x, y, _] = self.goal.to_world(self.robot.nominal_feet[foot]);
        [x, y]
    }
}

/// Nominal footholds for a state of the base (x, y), world frame, m.
pub fn nominal_footholds(robot: &Robot, base: &BaseState) -> Vec<[f64; 2]> {
    let foothold = |&foot: &[f64; 3]| {
        let [x, y, _] = base.to_world(foot);
        [x, y]
    };
    robot.nominal_feet.iter().map(foothold).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn anymal(terrain: &str, start: Goal, goal: Goal) -> Task {
        Task::between(Robot::named("anymal").unwrap(), Terrain::named(terrain).unwrap(), start, goal).unwrap()
    }

    #[test]
    fn on_flat_ground_a_robot_stands_level_at_its_height() {
        let task = anymal("flat", Goal::at(1., -2.).yaw(0.4), Goal::at(3., 0.).yaw(1.));
        assert_eq!((task.start, task.goal), (BaseState::level([1., -2., 0.5], 0.4), BaseState::level([3., 0., 0.5], 1.)));
        let (sin, cos) = 0.4f64.sin_cos();
        let [x, y] = task.foothold_start(1);
        assert!((x - (1. + cos * 0.34 + sin * 0.19)).abs() < 1e-12 && (y - (-2. + sin * 0.34 - cos * 0.19)).abs() < 1e-12);
        // 2 m along x and along y, in the axes of a rotated base.
        let [along, across] = task.displacement();
        assert!((along - (2. * cos + 2. * sin)).abs() < 1e-12 && (across - (2. * cos - 2. * sin)).abs() < 1e-12);
        assert!((task.turn() - 0.6).abs() < 1e-12);
    }

    #[test]
    fn on_a_slope_a_robot_stands_along_the_ground_by_default() {
        // The ground rises by 0.7 m per metre, about 35 degrees, which is slightly more than the largest default tilt.
        let task = anymal("slope", Goal::at(1.5, 0.), Goal::at(1.5, 0.).yaw(std::f64::consts::FRAC_PI_2));
        assert_eq!(task.start.angles, [0., -0.6, 0.]);
        let [roll, pitch, _] = task.goal.angles;
        assert!((roll + 0.6).abs() < 1e-9 && pitch.abs() < 1e-9, "{:?}", task.goal);
        for state in [task.start, task.goal] {
            let [low, high] = standing::heights(&task.robot, &task.terrain, &state, false);
            assert!(low < state.position[2] && state.position[2] < high);
        }
        // A given height makes the base level. A given tilt is kept.
        assert_eq!(anymal("slope", Goal::at(0., 0.), Goal::position([1.5, 0., 0.9])).goal, BaseState::level([1.5, 0., 0.9], 0.));
        let tilted = anymal("slope", Goal::at(0., 0.), Goal::at(1.5, 0.).tilt(0.1, -0.3));
        assert_eq!(tilted.goal.angles, [0.1, -0.3, 0.]);
    }

    #[test]
    fn feet_in_a_line_tilt_the_base_along_it_only() {
        let biped = Robot::named("biped").unwrap();
        let [roll, pitch] = tilt_over(&biped, &[0.1, 0.]);
        assert!((roll - (0.1f64 / 0.4).atan()).abs() < 1e-9 && pitch.abs() < 1e-12, "{roll} {pitch}");
        assert_eq!(tilt_over(&biped, &[0.1, 0.1]), [0.; 2]);
    }

    #[test]
    fn errors_name_the_impossible_value() {
        let between = |start, goal| Task::between(Robot::named("anymal").unwrap(), Terrain::named("step").unwrap(), start, goal);
        let refused = |result: Result<Task>, place: &str| {
            let error = result.unwrap_err().to_string();
            assert!(error.starts_with(place), "{error}");
        };
        refused(between(Goal::at(-20., 0.), Goal::at(1., 0.)), "start: (-20, 0)");
        refused(between(Goal::at(0., 0.), Goal::at(20., 0.)), "goal: (20, 0)");
        refused(between(Goal::at(0., 0.), Goal::at(1., 0.).tilt(0., 1.5)), "goal.pitch");
        refused(between(Goal::position([0., 0., -1.]), Goal::at(1., 0.)), "start.position[2]");
        refused(between(Goal::at(0., 0.).velocity([0., 0., f64::NAN]), Goal::at(1., 0.)), "start.velocity[2]");
        let task = between(Goal::at(0., 0.), Goal::at(1., 0.)).unwrap();
        refused(
            Task::of_states(task.robot.clone(), task.terrain.clone(), task.start, Some(vec![[0.; 2]; 3]), task.goal),
            "start_feet: 3 feet",
        );
    }
}
