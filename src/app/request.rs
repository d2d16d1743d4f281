//! Input of a search: a task with waypoints, and settings.

use super::label::Provenance;
use crate::error::{Error, Result};
use crate::nlp::transcription;
use crate::refine::RefineSettings;
use crate::robot::Robot;
use crate::search::evaluate::LowerSettings;
use crate::search::precheck::Finding;
use crate::search::{SearchEvent, SearchSettings};
use crate::task::{Goal, Task};

/// Settings of a search, apart from its task.
#[derive(Debug, Clone)]
pub struct Request {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Settings of the upper level, which draws gaits.
    pub search: SearchSettings,
    /// Settings of the lower level, which solves a trajectory for each gait.
    pub lower: LowerSettings,
    /// True if the best gait is refined to a local optimum of its cost.
    pub refines: bool,
    /// Settings of the refinement.
    pub refine: RefineSettings,
}

impl Default for Request {
    fn default() -> Self {
        Request {
            seed: 1,
            search: SearchSettings::default(),
            lower: LowerSettings::default(),
            refines: false,
            refine: RefineSettings::default(),
        }
    }
}

impl Request {
    /// Fixes the settings that depend on the robot, so that the result states them.
    pub fn at_robot(&mut self, robot: &Robot) {
        let transcription = &mut self.lower.transcription;
        transcription.interval = Some(transcription::interval(transcription, robot));
    }
}

/// Place at which the base stops on the path to the goal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Waypoint {
    /// State of the base there.
    pub goal: Goal,
    /// True if the yaw is interpolated between the start and the goal of the mission; `goal.yaw` is then ignored.
    pub turns_evenly: bool,
}

impl Waypoint {
    /// Waypoint above a point of the ground, with an interpolated yaw.
    ///
    /// * `x`, `y` - world frame, m
    pub fn at(x: f64, y: f64) -> Waypoint {
        Waypoint { goal: Goal::at(x, y), turns_evenly: true }
    }
}

/// Waypoint with the yaw of a goal.
impl From<Goal> for Waypoint {
    fn from(goal: Goal) -> Waypoint {
        Waypoint { goal, turns_evenly: false }
    }
}

/// Task with waypoints. Each waypoint and the goal end a [`MissionStage`](super::MissionStage), which has a search and a gait of its own.
#[derive(Debug, Clone)]
pub struct Mission {
    /// Task from the start to the goal.
    pub task: Task,
    /// Waypoints, in order.
    pub waypoints: Vec<Waypoint>,
    /// Scenario that the task was named by.
    pub provenance: Provenance,
}

/// Event of a search in progress.
pub enum ProgressEvent<'a> {
    /// Finding of the checks before the search: it makes a gait unlikely, but not impossible.
    Warning(&'a Finding),
    /// Start of the search of a stage.
    Started,
    /// Generation or improvement.
    Progress(&'a SearchEvent<'a>),
    /// End of the search of a stage; a refinement or a diagnosis may follow.
    Ended,
}

impl Mission {
    /// Mission without waypoints.
    pub fn new(task: Task) -> Mission {
        Mission { task, waypoints: Vec::new(), provenance: Provenance::default() }
    }

    /// Adds a waypoint after the others.
    pub fn by_way_of(mut self, waypoint: impl Into<Waypoint>) -> Mission {
        self.waypoints.push(waypoint.into());
        self
    }

    /// Checks that times of arrival increase.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first waypoint, or the goal, that is not after the one before it.
    pub fn check_times(&self) -> Result<()> {
        let mut before = 0.;
        let places = self.waypoints.iter().zip(1..).map(|(waypoint, number)| (format!("waypoint {number}"), waypoint.goal.time));
        for (place, time) in places.chain([("goal".into(), self.task.duration)]) {
            let Some(time) = time else { continue };
            if time <= before {
                return Err(Error::invalid(format!("{place}: time"), time, format!("later than {before} s, the time before it")));
            }
            before = time;
        }
        Ok(())
    }

    /// Number of stages.
    pub fn stages(&self) -> usize {
        self.waypoints.len() + 1
    }
}
