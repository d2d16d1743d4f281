//! What a trajectory is held to: its robot, its ground, its limits, and its certificate under them.

use super::args::{World, WorldArgs};
use crate::error::{Error, Result, check_range};
use crate::gait::Trajectory;
use crate::gait::trajectory::{GoalVelocity, NamedOr};
use crate::robot::Robot;
use crate::scenario::Scenario;
use crate::settings::Transcription;
use crate::terrain::Terrain;
use crate::verify::labels::own_force_limit;
use crate::verify::{Report, verify};
use std::sync::Arc;

/// What was named on the command line.
///
/// # Errors
/// As [`WorldArgs::read`], and for a force limit that is none.
pub fn read_world(args: &WorldArgs) -> Result<World> {
    let world = args.read()?;
    world.force_limit.map_or(Ok(()), |limit| check_range("--force-limit", limit, 1e-3, 1e7))?;
    Ok(world)
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
    pub fn new(world: &World, trajectory: &Trajectory) -> Result<Held> {
        let (robot, whose_robot) = robot_of(world, trajectory)?;
        let (terrain, whose_terrain) = terrain_of(world, trajectory)?;
        let (force_limit, whose_limit) = match world.force_limit {
            Some(limit) => (limit, "given"),
            None => own_force_limit(trajectory, &robot)?,
        };
        let report = verify(trajectory, &robot, &terrain, force_limit)?;
        let mut terms = vec![
            format!("robot {}, {whose_robot}; terrain {}, {whose_terrain}", shown(&robot.name), shown(&terrain.name)),
            format!("normal force at most {force_limit:.1} N, {whose_limit}"),
        ];
        terms.extend(terms_of(trajectory));
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

/// Rows, goal and limits that a trajectory names itself.
fn terms_of(trajectory: &Trajectory) -> [String; 3] {
    let rows = trajectory.transcription.as_deref().unwrap_or("towr");
    let of_momentum = rows == Transcription::Momentum.name();
    let friction = if of_momentum { "the friction cone" } else { "TOWR's friction pyramid" };
    let [x, y, z] = trajectory.base_target;
    let goal = match (&trajectory.scenario, trajectory.target) {
        (Some(_), Some(target)) => format!("target {target} of its scenario"),
        (Some(_), None) => "a target of its scenario".into(),
        (None, _) => "the file's own".into(),
    };
    let limits = match trajectory.limits {
        _ if !of_momentum => "no limits for legs".into(),
        None => "limits for legs: the defaults".into(),
        Some(l) => {
            let hardest = l.foot_acceleration.map_or("any".into(), |a| format!("at most {a:.3}"));
            let arrives = if l.goal_velocity == GoalVelocity::Zero { "at rest" } else { "with any velocity" };
            format!(
                "limits, the file's own: foot {:.3} to {:.3} m high in mid-swing, at most {:.3} m/s, {hardest} m/s2; arrives {arrives}",
                l.clearance, l.swing_height, l.foot_speed
            )
        }
    };
    [
        format!("rows {rows}, with {friction}"),
        format!("goal ({x:.3}, {y:.3}, {z:.3}) m, yaw {:.4} rad, {goal}", trajectory.yaw_target),
        limits,
    ]
}

/// The robot on the command line, else the file's, else its scenario's, and which of them it is.
fn robot_of(world: &World, trajectory: &Trajectory) -> Result<(Arc<Robot>, &'static str)> {
    match (world.robot(trajectory.scenario.as_deref()), &trajectory.robot) {
        (Some(robot), _) => Ok((robot, "given")),
        (None, Some(NamedOr::Name(name))) => Ok((Arc::new(Robot::named(name)?), "built in")),
        (None, Some(NamedOr::Own(robot))) => robot.validate().map(|()| (Arc::new(robot.clone()), "the file's own")),
        (None, None) => Ok((Arc::new(Robot::named(scenario_of(trajectory, "robot")?.robot)?), "its scenario's")),
    }
}

/// The terrain on the command line, else the file's, else its scenario's, and which of them it is.
fn terrain_of(world: &World, trajectory: &Trajectory) -> Result<(Arc<Terrain>, &'static str)> {
    match (world.terrain(trajectory.scenario.as_deref()), &trajectory.terrain) {
        (Some(terrain), _) => Ok((terrain, "given")),
        (None, Some(NamedOr::Name(name))) => Ok((Arc::new(Terrain::named(name)?), "built in")),
        (None, Some(NamedOr::Own(terrain))) => terrain.validate().map(|()| (Arc::new(terrain.clone()), "the file's own")),
        (None, None) => Ok((Arc::new(Terrain::named(scenario_of(trajectory, "terrain")?.terrain)?), "its scenario's")),
    }
}
