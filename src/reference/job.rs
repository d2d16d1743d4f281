//! Job for Ipopt: builds a program, solves it and counts the violated rows.

use super::contact_implicit::{ContactImplicit, Contacts, RELAXATIONS};
use super::ipopt::{self, Options, Statistics};
use super::towr::Towr;
use crate::error::Result;
use crate::gait::{Schedule, Trajectory};
use crate::nlp::transcription::force_limit;
use crate::robot::Robot;
use crate::search::evaluate::mean_normal_force;
use crate::settings::{Transcription, TranscriptionSettings};
use crate::task::{BaseState, Task};
use crate::terrain::Terrain;
use crate::verify::verify_rows;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Program to solve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Program {
    /// TOWR's program with the durations of a schedule, s, `[feet][phases]`.
    Fixed(Vec<Vec<f64>>),
    /// TOWR's program with durations as variables within limits, s, starting from the given durations.
    Free(Vec<Vec<f64>>, [f64; 2]),
    /// Contact-implicit program with a horizon, s.
    ContactImplicit(f64),
}

/// Complete problem that can be sent to another process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// Robot.
    pub robot: Robot,
    /// Terrain.
    pub terrain: Terrain,
    /// Base at the start.
    pub start: BaseState,
    /// Initial position of each foot (x, y), m.
    pub start_feet: Vec<[f64; 2]>,
    /// Base at the end.
    pub goal: BaseState,
    /// Largest normal force of a foot, N.
    pub force_limit: f64,
    /// Program to solve.
    pub program: Program,
    /// Ipopt's options.
    pub options: Options,
}

/// Result of a job.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Answer {
    /// Statistics, summed over all solves if there are several; status and sizes are those of the last one.
    #[serde(flatten)]
    pub statistics: Statistics,
    /// True if no row of `verify` is violated.
    pub feasible: bool,
    /// Number of rows of `verify` violated by more than 1e-4.
    pub n_violated: usize,
    /// Largest violation.
    pub max_violation: f64,
    /// Mean of |normal force| over all force nodes, N.
    pub mean_normal_force: f64,
    /// Trajectory, feasible or not.
    pub trajectory: Trajectory,
}

impl Job {
    /// Job for a task.
    pub fn new(task: &Task, program: Program, options: Options) -> Job {
        Job {
            robot: (*task.robot).clone(),
            terrain: (*task.terrain).clone(),
            start: task.start,
            start_feet: task.start_feet.clone(),
            goal: task.goal,
            force_limit: force_limit(&TranscriptionSettings::of(Transcription::Towr), task),
            program,
            options,
        }
    }

    /// TOWR's program of a schedule whose feet are stretched to the longest one, as in the paper \[1\].
    pub fn fixed(task: &Task, schedule: &Schedule, options: Options) -> Job {
        Job::new(task, Program::Fixed(schedule.stretched().durations().to_vec()), options)
    }

    /// Solves the job in this process and checks the trajectory.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for an invalid task or schedule, [`crate::Error::Missing`] without Ipopt.
    pub fn run(self) -> Result<Answer> {
        let Job { robot, terrain, start, start_feet, goal, force_limit, program, options } = self;
        let mut task = Task::of_states(robot, terrain, start, Some(start_feet), goal)?;
        task.force_limit = Some(force_limit);
        task.validate()?;
        let fixed_or_free = |nlp: &Towr| -> Result<(Statistics, Trajectory)> {
            let (x, statistics) = ipopt::solve(nlp, None, &options)?;
            Ok((statistics, nlp.trajectory(&x)))
        };
        let (statistics, trajectory) = match program {
            Program::Fixed(durations) => fixed_or_free(&Towr::fixed(&task, &Schedule::new(durations)?))?,
            Program::Free(durations, limits) => fixed_or_free(&Towr::free(&task, &Schedule::new(durations)?, limits))?,
            Program::ContactImplicit(horizon) => contact_implicit(&task, horizon, &options)?,
        };
        let report = verify_rows(&trajectory, &task.robot, &task.terrain, force_limit)?;
        Ok(Answer {
            statistics,
            feasible: report.feasible,
            n_violated: report.n_violated,
            max_violation: report.max_violation,
            mean_normal_force: mean_normal_force(&task, &trajectory),
            trajectory,
        })
    }
}

/// Solves with decreasing relaxation, each time from the previous solution, and finally with the contacts found.
///
/// The time limit applies to all solves together, the iteration limit to each.
fn contact_implicit(task: &Task, horizon: f64, options: &Options) -> Result<(Statistics, Trajectory)> {
    let start = Instant::now();
    let left = || Options { max_seconds: (options.max_seconds - start.elapsed().as_secs_f64()).max(1e-3), ..*options };
    let (mut iterations, mut evaluation_seconds, mut x) = (0, 0., None::<Vec<f64>>);
    let mut contacts = Contacts::Relaxed(RELAXATIONS[0]);
    for relaxation in RELAXATIONS {
        let nlp = ContactImplicit::new(task, horizon, Contacts::Relaxed(relaxation));
        let (reached, statistics) = ipopt::solve(&nlp, x.as_deref(), &left())?;
        iterations += statistics.iterations;
        evaluation_seconds += statistics.evaluation_seconds;
        contacts = Contacts::Given(nlp.contacts(&reached));
        x = Some(reached);
    }
    let nlp = ContactImplicit::new(task, horizon, contacts);
    let (x, last) = ipopt::solve(&nlp, x.as_deref(), &left())?;
    let statistics = Statistics {
        iterations: iterations + last.iterations,
        evaluation_seconds: evaluation_seconds + last.evaluation_seconds,
        seconds: start.elapsed().as_secs_f64(),
        ..last
    };
    Ok((statistics, nlp.trajectory(&x)))
}
