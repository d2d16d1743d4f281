//! Robots and terrains for one scenario or for all, and tasks from them.

use super::named::{robot, terrain};
use super::scenario_file::{ScenarioFile, Start};
use crate::error::{Error, Result, check_range};
use crate::robot::Robot;
use crate::scenario::Scenario;
use crate::task::{Goal, Task};
use crate::terrain::Terrain;
use std::f64::consts::PI;
use std::path::Path;
use std::sync::{Arc, Once};
use tracing::warn;

/// Guard that warns only once about a goal yaw of more than one turn.
static TURNS: Once = Once::new();

/// Warning about a goal yaw of more than one turn, which may have been meant in degrees.
///
/// * `yaw` - rad
pub fn yaw_warning(yaw: f64) -> Option<String> {
    let turns = yaw / (2. * PI);
    (turns.abs() > 1.).then(|| format!("goal yaw {yaw} rad is {turns:.1} turns; {yaw} degrees are {:.4} rad", yaw.to_radians()))
}

/// Names and files of robots and terrains, as a user gives them.
#[derive(Debug, Clone, Default)]
pub struct WorldNames {
    /// Robots: `NAME|FILE` for all scenarios, `SCENARIO=NAME|FILE` for one.
    pub robots: Vec<String>,
    /// Terrains: `NAME|FILE` for all scenarios, `SCENARIO=NAME|FILE` for one.
    pub terrains: Vec<String>,
    /// Largest normal force of a foot, N.
    pub force_limit: Option<f64>,
}

/// Things chosen for one scenario, or for all.
#[derive(Debug)]
struct Choices<T>(Vec<(Option<&'static str>, Arc<T>)>);

impl<T> Choices<T> {
    fn read(texts: &[String], read: impl Fn(&str) -> Result<Arc<T>>) -> Result<Self> {
        let choice = |text: &String| match text.split_once('=') {
            // Names of folders and files may contain `=`.
            Some((scenario, name)) if !Path::new(text).exists() => Ok((Some(Scenario::named(scenario)?.name), read(name)?)),
            _ => Ok((None, read(text)?)),
        };
        texts.iter().map(choice).collect::<Result<_>>().map(Choices)
    }

    fn one(choice: Option<Arc<T>>) -> Self {
        Choices(choice.map(|choice| (None, choice)).into_iter().collect())
    }

    /// Choice for a scenario: its own takes precedence over that for all, the last one given over earlier ones.
    fn get(&self, scenario: Option<&str>) -> Option<Arc<T>> {
        let own = self.0.iter().rfind(|(s, _)| s.is_some() && *s == scenario);
        own.or_else(|| self.0.iter().rfind(|(s, _)| s.is_none())).map(|(_, v)| v.clone())
    }
}

/// Robots and terrains that a user chose, read once.
#[derive(Debug)]
pub struct World {
    robots: Choices<Robot>,
    terrains: Choices<Terrain>,
    /// Largest normal force of a foot, N.
    pub force_limit: Option<f64>,
}

impl WorldNames {
    /// Reads what is named.
    ///
    /// # Errors
    /// Errors of [`robot`] and [`terrain`], and of unknown scenarios.
    pub fn read(&self) -> Result<World> {
        self.over(&ScenarioFile::default())
    }

    /// Reads what is named, and takes the rest from a scenario file.
    ///
    /// # Errors
    /// Errors of [`WorldNames::read`], also for names in the file.
    pub fn over(&self, file: &ScenarioFile) -> Result<World> {
        let (mut robots, mut terrains) = (Choices::read(&self.robots, robot)?, Choices::read(&self.terrains, terrain)?);
        if robots.0.is_empty() {
            robots.0.extend(file.robot()?.map(|own| (None, own)));
        }
        if terrains.0.is_empty() {
            terrains.0.extend(file.terrain()?.map(|own| (None, own)));
        }
        Ok(World { robots, terrains, force_limit: self.force_limit.or(file.force_limit) })
    }
}

/// Sources of a goal: a target of the scenario, or a goal in numbers, which takes precedence.
#[derive(Debug, Clone, Copy, Default)]
pub struct GoalSource {
    /// Target of the scenario, 1 to 20.
    pub target: Option<usize>,
    /// Goal in numbers; its yaw is ignored.
    pub goal: Option<Goal>,
    /// Final yaw, rad; the scenario's, or 0, if absent.
    pub yaw: Option<f64>,
}

impl World {
    /// At most one robot and one terrain, for all scenarios.
    pub fn of(robot: Option<Arc<Robot>>, terrain: Option<Arc<Terrain>>, force_limit: Option<f64>) -> World {
        let (robots, terrains) = (Choices::one(robot), Choices::one(terrain));
        World { robots, terrains, force_limit }
    }

    /// Checks the largest normal force.
    ///
    /// # Errors
    /// [`Error::Invalid`] if it is not from 0.001 to 1e7 N.
    pub fn check_force_limit(&self) -> Result<()> {
        self.force_limit.map_or(Ok(()), |limit| check_range("force_limit", limit, 1e-3, 1e7))
    }

    /// Robot chosen for a scenario.
    pub fn robot(&self, scenario: Option<&str>) -> Option<Arc<Robot>> {
        self.robots.get(scenario)
    }

    /// Terrain chosen for a scenario.
    pub fn terrain(&self, scenario: Option<&str>) -> Option<Arc<Terrain>> {
        self.terrains.get(scenario)
    }

    /// Task with the chosen robot, terrain and goal. The scenario fills in the rest; without one, the ground is flat.
    ///
    /// # Errors
    /// [`Error::Invalid`] if robot or goal are missing, and errors of [`Start::task`].
    pub fn task(&self, scenario: Option<&Scenario>, start: &Start, goal: GoalSource) -> Result<Task> {
        let missing = |what: &str, by: &str| {
            Error::invalid(what, "none", format!("given by {by}, or by a scenario (--scenario, or `scenario` in the line)"))
        };
        let name = scenario.map(|s| s.name);
        let robot = match (self.robot(name), scenario) {
            (Some(robot), _) => robot,
            (None, Some(s)) => Arc::new(Robot::named(s.robot)?),
            (None, None) => return Err(missing("robot", "--robot")),
        };
        let terrain = match (self.terrain(name), scenario) {
            (Some(terrain), _) => terrain,
            (None, Some(s)) => Arc::new(Terrain::named(s.terrain)?),
            (None, None) => Arc::new(Terrain::named("flat")?),
        };
        let place = match (goal.goal, goal.target) {
            (Some(place), _) => place,
            (None, Some(target)) => {
                let [x, y] = Scenario::goal(target)?;
                Goal::at(x, y)
            }
            (None, None) => return Err(missing("goal", "--goal, `base_target` in the line, `goal` in a scenario file")),
        };
        let yaw = goal.yaw.or(scenario.map(|s| s.yaw_target)).unwrap_or(0.);
        if let Some(warning) = yaw_warning(yaw) {
            TURNS.call_once(|| warn!("{warning}"));
        }
        start.task(robot, terrain, place.yaw(yaw), self.force_limit)
    }
}
