//! What trajectories say of where they come from.

use crate::gait::Trajectory;
use crate::gait::trajectory::NamedOr;
use crate::robot::{ROBOTS, Robot};
use crate::task::Task;
use crate::terrain::{TERRAINS, Terrain};
use crate::verify::labels::scenario_differs;

/// A trajectory with its task, target and seed. Built-in robots and terrains go by their names, a user's own in full. A scenario is named where the
/// motion is one of it: with another robot, ground or goal it is the user's own.
pub fn label(trajectory: Trajectory, task: &Task, scenario: Option<&str>, target: Option<usize>, seed: Option<u64>) -> Trajectory {
    let (robot, terrain) = world_of(task);
    let mut own = Trajectory { scenario: scenario.map(Into::into), target, seed, robot: Some(robot), terrain: Some(terrain), ..trajectory };
    if !matches!(scenario_differs(&own), Ok(None)) {
        (own.scenario, own.target) = (None, None);
    }
    own
}

/// Robot and terrain of a task: built-in ones by their names, a user's own in full.
pub fn world_of(task: &Task) -> (NamedOr<Robot>, NamedOr<Terrain>) {
    (
        named_or_own(&*task.robot, &task.robot.name, &ROBOTS, |name| Robot::named(name).ok()),
        named_or_own(&*task.terrain, &task.terrain.name, &TERRAINS, |name| Terrain::named(name).ok()),
    )
}

fn named_or_own<T: Clone + PartialEq>(own: &T, name: &str, known: &[&str], named: impl Fn(&str) -> Option<T>) -> NamedOr<T> {
    let built_in = known.contains(&name) && named(name).is_some_and(|n| n == *own);
    if built_in { NamedOr::Name(name.into()) } else { NamedOr::Own(own.clone()) }
}
