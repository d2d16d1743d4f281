//! What a trajectory is held to: its robot, its ground, its limits, and its certificate under them.

use super::args::{GoalArg, GoalSource, World, WorldArgs};
use super::scenario_file::Start;
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
use clap::Args;
use std::sync::Arc;

/// What was named on the command line.
///
/// # Errors
/// As [`WorldArgs::read`], and for a force limit that is none.
pub fn read_world(args: &WorldArgs) -> Result<World> {
    let world = args.read()?;
    world.check_force_limit()?;
    Ok(world)
}

/// What a motion is asked, instead of what its file says.
#[derive(Debug, Default, Args)]
pub struct Asked {
    /// Goal that is asked of the motion, m, instead of its file's own; without Z as `solve` has it
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true, conflicts_with = "scenario")]
    goal: Option<GoalArg>,
    /// Final yaw that is asked of it, rad
    #[arg(long, allow_hyphen_values = true, requires = "goal")]
    yaw: Option<f64>,
    /// Start that is asked of it, m, at rest; above the origin when a goal is given without one
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true, requires = "goal")]
    start: Option<GoalArg>,
    /// Yaw at the start that is asked of it, rad
    #[arg(long, allow_hyphen_values = true, requires = "start")]
    start_yaw: Option<f64>,
    /// Scenario whose start and goal are asked of it
    #[arg(long, requires = "target")]
    scenario: Option<String>,
    /// Target of that scenario, 1 to 20
    #[arg(long, requires = "scenario")]
    target: Option<usize>,
    /// Hold it to the limits that `solve` has by default for its robot, whatever its file says
    #[arg(long)]
    default_limits: bool,
}

/// A trajectory's world and its certificate.
pub struct Held {
    pub robot: Arc<Robot>,
    pub terrain: Arc<Terrain>,
    /// Largest normal force of a foot, N.
    pub force_limit: f64,
    /// What it was held to, and whose word that is.
    pub terms: Vec<String>,
    pub report: Report,
}

impl Held {
    /// Verifies a trajectory under what was given on the command line, else what it says itself.
    pub fn new(world: &World, trajectory: &Trajectory, asked: &Asked) -> Result<Held> {
        check_labels(trajectory)?;
        let (robot, whose_robot) = robot_of(world, trajectory)?;
        let (terrain, whose_terrain) = terrain_of(world, trajectory)?;
        let (force_limit, whose_limit) = match world.force_limit {
            Some(limit) => (limit, "given"),
            None => own_force_limit(trajectory, &robot)?,
        };
        let trajectory = &asked.asked_of(trajectory.clone(), world, &robot, &terrain)?;
        let report = verify(trajectory, &robot, &terrain, force_limit)?;
        let mut terms = vec![
            format!("robot {}, {whose_robot}; terrain {}, {whose_terrain}", shown(&robot.name), shown(&terrain.name)),
            format!("normal force at most {force_limit:.1} N, {whose_limit}"),
        ];
        terms.extend(asked.terms(trajectory, &terrain));
        Ok(Held { robot, terrain, force_limit, terms, report })
    }
}

/// A name as it is printed.
pub fn shown(name: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    if name.chars().all(plain) { name.into() } else { format!("\"{}\"", name.escape_debug()) }
}

fn scenario_of(trajectory: &Trajectory, what: &str) -> Result<Scenario> {
    let name = trajectory.scenario.as_deref();
    let name = name.ok_or_else(|| Error::invalid(what, "missing", format!("in the file, its scenario's, or given as --{what}")))?;
    Scenario::named(name)
}

impl Asked {
    /// The motion, with what the command line asks of it instead of what its file does.
    fn asked_of(&self, trajectory: Trajectory, world: &World, robot: &Arc<Robot>, terrain: &Arc<Terrain>) -> Result<Trajectory> {
        let scenario = self.scenario.as_deref().map(Scenario::named).transpose()?;
        let task = match (&scenario, self.goal) {
            (Some(scenario), _) => {
                let goal = GoalSource { target: self.target, ..GoalSource::default() };
                let own = World::of(Some(robot.clone()), Some(terrain.clone()), world.force_limit);
                Some(own.task(Some(scenario), &Start::default(), goal)?)
            }
            (None, Some(goal)) => {
                let start = self.start.map_or(Goal::at(0., 0.), GoalArg::goal).yaw(self.start_yaw.unwrap_or(0.));
                Some(Task::between(robot.clone(), terrain.clone(), start, goal.goal().yaw(self.yaw.unwrap_or(0.)))?)
            }
            (None, None) => None,
        };
        let mut asked = match task {
            Some(task) => task.asked_of(trajectory),
            None => trajectory,
        };
        if self.default_limits && of_momentum(&asked) {
            let settings = TranscriptionSettings { legs: Legs::Limited, ..TranscriptionSettings::of(Transcription::Momentum) };
            asked.limits = Some(momentum::limits(&settings, robot));
        }
        Ok(asked)
    }

    /// Whether ends are those of the command line.
    fn ends_given(&self) -> bool {
        self.goal.is_some() || self.scenario.is_some()
    }

    /// Rows, ends and limits that a trajectory is held to.
    fn terms(&self, trajectory: &Trajectory, terrain: &Terrain) -> Vec<String> {
        let rows = trajectory.transcription.as_deref().unwrap_or("towr");
        let friction = if of_momentum(trajectory) { "the friction cone" } else { "TOWR's friction pyramid" };
        let [x, y, z] = trajectory.base_target;
        let whose = match (&trajectory.scenario, trajectory.target) {
            _ if self.ends_given() => "given".into(),
            (Some(_), Some(target)) => format!("target {target} of its scenario"),
            (Some(_), None) => "a target of its scenario".into(),
            (None, _) => "the file's own".into(),
        };
        let mut terms = vec![
            format!("rows {rows}, with {friction} of coefficient {}", terrain.friction),
            format!("goal ({x:.3}, {y:.3}, {z:.3}) m, yaw {:.4} rad{}, {whose}", trajectory.yaw_target, moves(trajectory.goal.as_ref())),
        ];
        let feet = if trajectory.start_feet.is_some() { "feet where they stood" } else { "feet at their nominal places" };
        let start = match (&trajectory.start, trajectory.init_base) {
            (None, None) => "above the origin, level and at rest".into(),
            (None, Some([x, y, z])) => format!("({x:.3}, {y:.3}, {z:.3}) m, yaw 0, level and at rest"),
            (Some(s), _) => {
                let [x, y, z] = s.position;
                format!("({x:.3}, {y:.3}, {z:.3}) m, yaw {:.4} rad{}", s.yaw(), moves(Some(s)))
            }
        };
        terms.push(format!("start {start}, {feet}, {}", if self.ends_given() { "given" } else { "the file's own" }));
        terms.push(self.limits_text(trajectory));
        terms
    }

    fn limits_text(&self, trajectory: &Trajectory) -> String {
        if !of_momentum(trajectory) {
            return "no limits for legs".into();
        }
        let l = trajectory.limits.unwrap_or(MOTION_LIMITS);
        let whose = match trajectory.limits {
            _ if self.default_limits => "the defaults",
            Some(_) => "the file's own",
            None => "as the file has none those of legs that can do anything",
        };
        let hardest = l.foot_acceleration.map_or("any".into(), |a| format!("at most {a:.3}"));
        let arrives = if l.goal_velocity == GoalVelocity::Zero { "as the goal asks" } else { "with any velocity" };
        format!(
            "limits, {whose}: foot {:.3} to {:.3} m high in mid-swing, at most {:.3} m/s, {hardest} m/s2; arrives {arrives}",
            l.clearance, l.swing_height, l.foot_speed
        )
    }
}

/// What a state has besides its position and yaw, for a line of text.
fn moves(state: Option<&BaseState>) -> String {
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

/// The robot on the command line, else the file's, else its scenario's, and which of them it is.
pub fn robot_of(world: &World, trajectory: &Trajectory) -> Result<(Arc<Robot>, &'static str)> {
    match (world.robot(trajectory.scenario.as_deref()), &trajectory.robot) {
        (Some(robot), _) => Ok((robot, "given")),
        (None, Some(NamedOr::Name(name))) => Ok((Arc::new(Robot::named(name)?), "built in")),
        (None, Some(NamedOr::Own(robot))) => robot.validate().map(|()| (Arc::new(robot.clone()), "the file's own")),
        (None, None) => Ok((Arc::new(Robot::named(scenario_of(trajectory, "robot")?.robot)?), "its scenario's")),
    }
}

/// The terrain on the command line, else the file's, else its scenario's, and which of them it is.
pub fn terrain_of(world: &World, trajectory: &Trajectory) -> Result<(Arc<Terrain>, &'static str)> {
    match (world.terrain(trajectory.scenario.as_deref()), &trajectory.terrain) {
        (Some(terrain), _) => Ok((terrain, "given")),
        (None, Some(NamedOr::Name(name))) => Ok((Arc::new(Terrain::named(name)?), "built in")),
        (None, Some(NamedOr::Own(terrain))) => terrain.validate().map(|()| (Arc::new(terrain.clone()), "the file's own")),
        (None, None) => Ok((Arc::new(Terrain::named(scenario_of(trajectory, "terrain")?.terrain)?), "its scenario's")),
    }
}
