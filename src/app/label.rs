//! Origin of a trajectory, as its file states it.

use crate::gait::Trajectory;
use crate::gait::trajectory::NamedOr;
use crate::robot::{ROBOTS, Robot};
use crate::task::Task;
use crate::terrain::{TERRAINS, Terrain};
use crate::verify::labels::scenario_differs;

/// Built-in scenario and target that a task was named by.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Provenance {
    /// Scenario, if one was named.
    pub scenario: Option<&'static str>,
    /// Its target, 1 to 20, if one was named.
    pub target: Option<usize>,
}

/// Adds robot, terrain, seed and provenance to a trajectory. Built-in robots and terrains are named, a user's own are written in full. The
/// scenario is left out if robot, terrain or goal differ from it.
pub fn label(trajectory: Trajectory, task: &Task, Provenance { scenario, target }: Provenance, seed: Option<u64>) -> Trajectory {
    let (robot, terrain) = world_of(task);
    let mut own = Trajectory { scenario: scenario.map(Into::into), target, seed, robot: Some(robot), terrain: Some(terrain), ..trajectory };
    if !matches!(scenario_differs(&own), Ok(None)) {
        (own.scenario, own.target) = (None, None);
    }
    own
}

/// Robot and terrain of a task: built-in ones by name, a user's own in full.
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
