//! Terms under which a trajectory file is verified: robot, ground, ends and limits, each from the user, the file, or its scenario.

use super::scenario_file::Start;
use super::world::{GoalSource, World};
use crate::error::{Error, Result};
use crate::gait::Trajectory;
use crate::gait::trajectory::{GoalVelocity, NamedOr};
use crate::nlp::transcription::momentum;
use crate::robot::Robot;
use crate::scenario::Scenario;
use crate::settings::{Legs, Transcription, TranscriptionSettings};
use crate::task::{BaseState, Goal, Task};
use crate::terrain::Terrain;
use crate::verify::labels::{check_labels, of_momentum, own_force_limit};
use crate::verify::{MOTION_LIMITS, Report, verify};
use std::sync::Arc;

/// Start and goal that replace those of a file.
#[derive(Debug, Clone)]
pub enum Ends {
    /// Start and goal of a built-in scenario.
    Scenario {
        /// Name of the scenario.
        name: String,
        /// Target, 1 to 20.
        target: Option<usize>,
    },
    /// Start, with the feet at their nominal places, and goal.
    Between(Box<[Goal; 2]>),
}

/// Terms that replace those of a file.
#[derive(Debug, Clone, Default)]
pub struct TermOverrides {
    /// Start and goal.
    pub ends: Option<Ends>,
    /// True for the limits that `solve` has by default for the robot.
    pub default_limits: bool,
}

/// Terms under which a motion is verified, and the motion under these terms.
pub struct VerificationTerms {
    /// Robot.
    pub robot: Arc<Robot>,
    /// Ground.
    pub terrain: Arc<Terrain>,
    /// Largest normal force of a foot, N.
    pub force_limit: f64,
    /// The terms as text, one per line, each with its source.
    pub lines: Vec<String>,
    /// Motion with the ends and limits of these terms.
    trajectory: Trajectory,
}

impl VerificationTerms {
    /// Terms of a motion: those of the user, else those of its file, else those of its scenario.
    ///
    /// * `world` - robot, terrain and force limit of the user
    ///
    /// # Errors
    /// For labels that contradict the motion, and a robot or terrain that is neither given nor known.
    pub fn new(world: &World, trajectory: &Trajectory, overrides: &TermOverrides) -> Result<VerificationTerms> {
        check_labels(trajectory)?;
        let (robot, robot_source) = robot_of(world, trajectory)?;
        let (terrain, terrain_source) = terrain_of(world, trajectory)?;
        let (force_limit, limit_source) = match world.force_limit {
            Some(limit) => (limit, "given"),
            None => own_force_limit(trajectory, &robot)?,
        };
        let trajectory = overrides.over(trajectory.clone(), world, &robot, &terrain)?;
        trajectory.validate()?;
        trajectory.check_feet(&robot)?;
        let mut lines = vec![
            format!("robot {}, {robot_source}; terrain {}, {terrain_source}", shown(&robot.name), shown(&terrain.name)),
            format!("normal force at most {force_limit:.1} N, {limit_source}"),
        ];
        lines.extend(overrides.lines(&trajectory, &terrain));
        Ok(VerificationTerms { robot, terrain, force_limit, lines, trajectory })
    }

    /// Verifies the motion under these terms.
    ///
    /// # Errors
    /// Errors of [`verify`].
    pub fn verify(&self) -> Result<Report> {
        verify(&self.trajectory, &self.robot, &self.terrain, self.force_limit)
    }
}

/// Name as it is printed: quoted, unless it consists of plain characters.
pub fn shown(name: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    if name.chars().all(plain) { name.into() } else { format!("\"{}\"", name.escape_debug()) }
}

fn scenario_of(trajectory: &Trajectory, what: &str) -> Result<Scenario> {
    let name = trajectory.scenario.as_deref();
    let name = name.ok_or_else(|| Error::invalid(what, "missing", format!("in the file, its scenario's, or given as --{what}")))?;
    Scenario::named(name)
}

impl TermOverrides {
    /// Motion with these ends and limits in place of its own.
    fn over(&self, trajectory: Trajectory, world: &World, robot: &Arc<Robot>, terrain: &Arc<Terrain>) -> Result<Trajectory> {
        let task = match &self.ends {
            Some(Ends::Scenario { name, target }) => {
                let scenario = Scenario::named(name)?;
                let goal = GoalSource { target: *target, ..GoalSource::default() };
                let own = World::of(Some(robot.clone()), Some(terrain.clone()), world.force_limit);
                Some(own.task(Some(&scenario), &Start::default(), goal)?)
            }
            Some(Ends::Between(ends)) => Some(Task::between(robot.clone(), terrain.clone(), ends[0], ends[1])?),
            None => None,
        };
        let mut own = match task {
            Some(task) => task.asked_of(trajectory),
            None => trajectory,
        };
        if self.default_limits && of_momentum(&own) {
            let settings = TranscriptionSettings { legs: Legs::Limited, ..TranscriptionSettings::of(Transcription::Momentum) };
            own.limits = Some(momentum::limits(&settings, robot));
        }
        Ok(own)
    }

    /// Rows, ends and limits as text.
    fn lines(&self, trajectory: &Trajectory, terrain: &Terrain) -> Vec<String> {
        let rows = trajectory.transcription.as_deref().unwrap_or("towr");
        let friction = if of_momentum(trajectory) { "the friction cone" } else { "TOWR's friction pyramid" };
        let [x, y, z] = trajectory.base_target;
        let source = match (&trajectory.scenario, trajectory.target) {
            _ if self.ends.is_some() => "given".into(),
            (Some(_), Some(target)) => format!("target {target} of its scenario"),
            (Some(_), None) => "a target of its scenario".into(),
            (None, _) => "the file's own".into(),
        };
        let mut lines = vec![
            format!("rows {rows}, with {friction} of coefficient {}", terrain.friction),
            format!(
                "goal ({x:.3}, {y:.3}, {z:.3}) m, yaw {:.4} rad{}, {source}",
                trajectory.yaw_target,
                motion_text(trajectory.goal.as_ref())
            ),
        ];
        let feet = if trajectory.start_feet.is_some() { "given footholds" } else { "nominal footholds" };
        let start = match (&trajectory.start, trajectory.init_base) {
            (None, None) => "above the origin, level and at rest".into(),
            (None, Some([x, y, z])) => format!("({x:.3}, {y:.3}, {z:.3}) m, yaw 0, level and at rest"),
            (Some(s), _) => {
                let [x, y, z] = s.position;
                format!("({x:.3}, {y:.3}, {z:.3}) m, yaw {:.4} rad{}", s.yaw(), motion_text(Some(s)))
            }
        };
        lines.push(format!("start {start}, {feet}, {}", if self.ends.is_some() { "given" } else { "the file's own" }));
        lines.push(self.limits_line(trajectory));
        lines
    }

    fn limits_line(&self, trajectory: &Trajectory) -> String {
        if !of_momentum(trajectory) {
            return "no limits on the legs".into();
        }
        let l = trajectory.limits.unwrap_or(MOTION_LIMITS);
        let source = match trajectory.limits {
            _ if self.default_limits => "the defaults",
            Some(_) => "the file's own",
            None => "unlimited legs, because the file specifies no limits",
        };
        let acceleration = l.foot_acceleration.map_or("any".into(), |a| format!("at most {a:.3}"));
        let arrival = match l.goal_velocity {
            GoalVelocity::Zero => "at the velocity of the goal",
            GoalVelocity::Free => "with any velocity",
            GoalVelocity::Near => "near the goal, with any velocity",
        };
        format!(
            "limits, {source}: foot {:.3} to {:.3} m high in mid-swing, at most {:.3} m/s, {acceleration} m/s2; arrives {arrival}",
            l.clearance, l.swing_height, l.foot_speed
        )
    }
}

/// Tilt, velocity and rates of a state, where they are not zero.
fn motion_text(state: Option<&BaseState>) -> String {
    let Some(state) = state else { return String::new() };
    let mut text = String::new();
    let [roll, pitch, _] = state.angles;
    if [roll, pitch] != [0.; 2] {
        text += &format!(", roll {roll:.4} and pitch {pitch:.4} rad");
    }
    if !state.at_rest() {
        text += &format!(", velocity {:?} m/s and rates {:?} rad/s", state.velocity, state.rates);
    }
    text
}

/// Robot given by the user, else that of the file, else that of its scenario; and its source.
///
/// # Errors
/// For an unknown or invalid robot, and if none of the three has a robot.
pub fn robot_of(world: &World, trajectory: &Trajectory) -> Result<(Arc<Robot>, &'static str)> {
    match (world.robot(trajectory.scenario.as_deref()), &trajectory.robot) {
        (Some(robot), _) => Ok((robot, "given")),
        (None, Some(NamedOr::Name(name))) => Ok((Arc::new(Robot::named(name)?), "built in")),
        (None, Some(NamedOr::Own(robot))) => robot.validate().map(|()| (Arc::new(robot.clone()), "the file's own")),
        (None, None) => Ok((Arc::new(Robot::named(scenario_of(trajectory, "robot")?.robot)?), "its scenario's")),
    }
}

/// Ground for the joints of a robot: flat for balls and points, whose joints do not depend on it, and otherwise that of
/// [`terrain_of`].
///
/// # Errors
/// See [`terrain_of`].
pub fn ground_of(world: &World, trajectory: &Trajectory, robot: &Robot) -> Result<Arc<Terrain>> {
    if robot.sole.is_some() { terrain_of(world, trajectory).map(|(terrain, _)| terrain) } else { Ok(Arc::new(Terrain::flat())) }
}

/// Terrain given by the user, else that of the file, else that of its scenario; and its source.
///
/// # Errors
/// For an unknown or invalid terrain, and if none of the three has a terrain.
pub fn terrain_of(world: &World, trajectory: &Trajectory) -> Result<(Arc<Terrain>, &'static str)> {
    match (world.terrain(trajectory.scenario.as_deref()), &trajectory.terrain) {
        (Some(terrain), _) => Ok((terrain, "given")),
        (None, Some(NamedOr::Name(name))) => Ok((Arc::new(Terrain::named(name)?), "built in")),
        (None, Some(NamedOr::Own(terrain))) => terrain.validate().map(|()| (Arc::new(terrain.clone()), "the file's own")),
        (None, None) => Ok((Arc::new(Terrain::named(scenario_of(trajectory, "terrain")?.terrain)?), "its scenario's")),
    }
}
