//! Checks the labels of a trajectory (transcription, scenario, robot, terrain, limits) against its content.

use crate::error::{Error, Result, check_range};
use crate::gait::Trajectory;
use crate::gait::trajectory::{MotionLimits, NamedOr};
use crate::robot::{FORCE_LIMIT_WEIGHTS, ROUNDED, Robot};
use crate::scenario::{Scenario, TARGETS};
use crate::settings::Transcription;
use crate::terrain::Terrain;

/// Transcriptions whose rows are known.
pub const TRANSCRIPTIONS: [&str; 3] = ["momentum", "towr", "contact-implicit"];

/// Limit of normal forces in TOWR \[3\], N.
const TOWR_FORCE_LIMIT: f64 = 1000.;

/// Largest distance of a goal from the goal of its label, m and rad.
const SAME_GOAL: f64 = 1e-6;

/// Checks the labels of a trajectory.
///
/// # Errors
/// [`Error::Invalid`] or [`Error::Unknown`] for a transcription without rows, for limits outside the accepted ranges, for a built-in name
/// on a different robot or terrain, and for a scenario whose robot, terrain, goal or yaw differs from the content.
pub fn check_labels(trajectory: &Trajectory) -> Result<()> {
    if let Some(name) = trajectory.transcription.as_deref().filter(|name| !TRANSCRIPTIONS.contains(name)) {
        return Err(Error::Unknown { what: "transcription", name: name.into(), known: TRANSCRIPTIONS.join(", ") });
    }
    trajectory.limits.as_ref().map_or(Ok(()), check_limits)?;
    trajectory.force_limit.map_or(Ok(()), |limit| check_range("force_limit", limit, 1e-3, 1e7))?;
    if let Some(NamedOr::Own(robot)) = &trajectory.robot {
        robot.validate_own()?;
    }
    if let Some(NamedOr::Own(terrain)) = &trajectory.terrain {
        terrain.validate_own()?;
    }
    let Some(differs) = scenario_differs(trajectory)? else { return Ok(()) };
    Err(Error::invalid("scenario", format!("`{}`", trajectory.scenario.as_deref().unwrap_or_default().escape_debug()), differs))
}

/// Largest normal force of a foot when the caller gives none, N, and the source of that limit: the file's limit, but not more than the
/// robot's.
///
/// # Errors
/// [`Error::Invalid`] if the file allows more than any leg of its robot can take: such a limit must be requested explicitly.
pub fn own_force_limit(trajectory: &Trajectory, robot: &Robot) -> Result<(f64, &'static str)> {
    let of_momentum = of_momentum(trajectory);
    let most = FORCE_LIMIT_WEIGHTS * robot.weight();
    let most = if of_momentum { most } else { most.max(TOWR_FORCE_LIMIT) };
    match (trajectory.force_limit, robot.force_limit) {
        (Some(file), Some(robot)) if robot < file => Ok((robot, "the robot's")),
        (Some(file), None) if file > most * (1. + ROUNDED) => {
            let limit = format!("at most {most:.1} N for the robot `{}`, unless more is given as --force-limit", robot.name.escape_debug());
            Err(Error::invalid("force_limit", format!("{file} N"), limit))
        }
        (Some(file), _) => Ok((file, "the file's own")),
        (None, Some(robot)) => Ok((robot, "the robot's")),
        (None, None) if of_momentum => Ok((robot.default_force_limit(), "default for a robot without a limit")),
        (None, None) => Ok((TOWR_FORCE_LIMIT, "TOWR's")),
    }
}

/// Checks that limits are within the ranges that the settings of a transcription accept.
fn check_limits(limits: &MotionLimits) -> Result<()> {
    check_range("limits.clearance", limits.clearance, 0., 10.)?;
    check_range("limits.swing_height", limits.swing_height, limits.clearance, 100.)?;
    check_range("limits.foot_speed", limits.foot_speed, 0.1, 1000.)?;
    limits.foot_acceleration.map_or(Ok(()), |a| check_range("limits.foot_acceleration", a, 1., 1e6))
}

/// Returns the first difference between a trajectory and the scenario that it names, or `None`.
///
/// # Errors
/// [`Error::Unknown`] or [`Error::Invalid`] for a scenario or a target that does not exist.
pub fn scenario_differs(trajectory: &Trajectory) -> Result<Option<String>> {
    let Some(name) = trajectory.scenario.as_deref() else { return Ok(None) };
    let scenario = Scenario::named(name)?;
    let named = Robot::named(scenario.robot)?;
    match &trajectory.robot {
        Some(NamedOr::Name(robot)) if robot != scenario.robot => {
            return Ok(Some(format!("that of a motion of the robot `{}`", scenario.robot)));
        }
        Some(NamedOr::Own(robot)) if robot.name != scenario.robot || robot.difference(&named).is_some() => {
            return Ok(Some(format!("that of a motion of the robot `{}`", scenario.robot)));
        }
        _ => {}
    }
    let ground = Terrain::named(scenario.terrain)?;
    let same_ground = match &trajectory.terrain {
        Some(NamedOr::Name(terrain)) => terrain == scenario.terrain,
        Some(NamedOr::Own(terrain)) => *terrain == ground,
        None => true,
    };
    if !same_ground {
        return Ok(Some(format!("that of a motion on the terrain `{}`", scenario.terrain)));
    }
    let origin = [0., 0., named.base_height + ground.height(0., 0.)];
    let elsewhere = |start: [f64; 3]| start.iter().zip(origin).any(|(a, b)| (a - b).abs() > SAME_GOAL);
    if trajectory.start.is_some()
        || trajectory.start_feet.is_some()
        || trajectory.goal.is_some()
        || trajectory.init_base.is_some_and(elsewhere)
    {
        return Ok(Some("that of a motion between rests, from above the origin with yaw 0 and with feet at their nominal places".into()));
    }
    let [x, y, z] = trajectory.base_target;
    let there = |target: usize| Scenario::goal(target).map(|[gx, gy]| (gx - x).abs().max((gy - y).abs()) <= SAME_GOAL);
    let matches = match trajectory.target {
        Some(target) => there(target)?,
        None => (1..=TARGETS).any(|target| there(target).is_ok_and(|there| there)),
    };
    if !matches {
        let target = trajectory.target.map_or("one of its targets".into(), |target| format!("its target {target}"));
        return Ok(Some(format!("that of a motion to {target}, and not to ({x:.3}, {y:.3}) m")));
    }
    let height = named.base_height + ground.height(x, y);
    if (z - height).abs() > SAME_GOAL {
        return Ok(Some(format!("that of a motion to the height {height:.3} m, and not {z:.3}")));
    }
    if (trajectory.yaw_target - scenario.yaw_target).abs() > SAME_GOAL {
        return Ok(Some(format!("that of a motion to the yaw {:.4} rad, and not {:.4}", scenario.yaw_target, trajectory.yaw_target)));
    }
    Ok(None)
}

/// True if the motion is checked against the rows of `momentum`, and therefore also between the instants.
pub(crate) fn of_momentum(trajectory: &Trajectory) -> bool {
    trajectory.transcription.as_deref() == Some(Transcription::Momentum.name())
}
