//! One run of an experiment, and its record.

use super::plan::{Case, Method};
use crate::backend::Backend;
use crate::error::Result;
use crate::gait::Trajectory;
use crate::nlp::transcription;
use crate::reference::ipopt::Options;
use crate::reference::job::{Answer, Job, Program};
use crate::reference::workers::{IpoptLevel, Workers, threads_or_all};
use crate::search::cem::Candidate;
use crate::search::cem::FreeDistribution;
use crate::search::evaluate::LowerSettings;
use crate::search::{BatchSolver, CemSearchResult, ScheduleSolver, search_with};
use crate::settings::TranscriptionSettings;
use crate::task::Task;
use crate::verify::{Report, verify};
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// Stance phases per foot in the baselines.
const BASELINE_STANCES: usize = 10;
/// Initial stance and swing durations of TOWR, s.
const BASELINE_DURATIONS: [f64; 2] = [0.2, 0.1];
/// Bounds of TOWR's durations, s.
const BASELINE_LIMITS: [f64; 2] = [0.08, 0.36];

/// Devices and processes that run the methods.
pub struct Devices<'a> {
    /// Backend of this program's solver.
    pub backend: &'a dyn Backend,
    /// Ipopt workers; `None` without the feature.
    pub workers: Option<&'a Workers>,
}

/// Record of a run: a line of `experimentN.jsonl`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// Specification of the run.
    #[serde(flatten)]
    pub case: Case,
    /// Version of this program.
    pub version: String,
    /// Processor.
    pub machine: String,
    /// Device of the solves.
    pub device: String,
    /// Number of threads or processes.
    pub threads: usize,
    /// Computing budget.
    pub budget: String,
    /// Time of its end, s since 1970.
    pub unix_time: u64,
    /// True if a motion was found that satisfies every row of its certificate.
    pub success: bool,
    /// Time to the first certified motion, s.
    pub first_feasible_seconds: Option<f64>,
    /// Time of the whole run, including failed candidates, s.
    pub seconds: f64,
    /// Number of generations; 0 without a search.
    pub generations_run: usize,
    /// Number of candidates that count ([`crate::search::cem::GenerationRecord::evaluated`]); 1 without a search.
    pub candidates: usize,
    /// Number of rows of `verify` that the result violates.
    pub n_violated: Option<usize>,
    /// Largest of these violations, in the unit of its row.
    pub max_violation: Option<f64>,
    /// Largest position error of the body when it is simulated with the planned forces only, m.
    pub rollout_position: Option<f64>,
    /// Largest attitude error of the body when it is simulated with the planned forces only, degrees.
    pub rollout_attitude: Option<f64>,
    /// Largest distance of a foot outside its box at any time, m.
    pub reach_excess: Option<f64>,
    /// Mean of |normal force| over the force nodes of the result, N.
    pub mean_normal_force: Option<f64>,
    /// Best objective so far after each generation; `None` until there is one.
    pub best_objectives: Vec<Option<f64>>,
    /// Phase durations of the result, s, `[feet][phases]`.
    pub durations: Vec<Vec<f64>>,
}

impl Run {
    /// Time to the first certified motion, or the whole time if none was found.
    pub fn first_or_all(&self) -> f64 {
        self.first_feasible_seconds.unwrap_or(self.seconds)
    }

    /// Objective of the result as a cost: number of stance phases, or N; `None` if nothing was found.
    pub fn cost(&self) -> Option<f64> {
        self.best_objectives.last().copied().flatten().filter(|_| self.success).map(|j| 0. - j)
    }

    /// Number of stance phases of all feet.
    pub fn stances(&self) -> usize {
        self.durations.iter().map(|phases| phases.len().div_ceil(2)).sum()
    }
}

/// RunOutcome common to all methods.
struct RunOutcome {
    success: bool,
    first_feasible: Option<f64>,
    seconds: f64,
    generations: usize,
    candidates: usize,
    best_objectives: Vec<Option<f64>>,
    mean_normal_force: Option<f64>,
    trajectory: Option<Trajectory>,
    device: String,
    threads: usize,
}

/// Processor of this machine, as far as the system reports it.
pub fn machine() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':')).map(|(_, name)| name.trim().to_owned());
    format!("{}, {} processors, {}", model.unwrap_or_else(|| std::env::consts::ARCH.into()), threads_or_all(0), std::env::consts::OS)
}

/// Makes a run. Returns `None` if it was cancelled, or if it needs Ipopt and this build has none.
///
/// # Errors
/// Returns an error if the case cannot run. Finding no motion is not an error.
pub fn run(case: &Case, devices: &Devices, cancelled: &AtomicBool) -> Result<Option<Run>> {
    let task = case.task()?;
    let phases: Vec<f64> = (0..2 * BASELINE_STANCES - 1).map(|phase| BASELINE_DURATIONS[phase % 2]).collect();
    let outcome = match (case.method, devices.workers) {
        (method, None) if method.needs_ipopt() => return Ok(None),
        (Method::Towr, Some(workers)) => {
            baseline(&task, Program::Free(vec![phases; task.robot.feet()], BASELINE_LIMITS), workers, cancelled)?
        }
        // Same horizon as TOWR.
        (Method::ContactImplicit, Some(workers)) => baseline(&task, Program::ContactImplicit(phases.iter().sum()), workers, cancelled)?,
        (Method::Ipopt | Method::RandomIpopt, Some(workers)) => {
            let level = IpoptLevel { task: &task, workers, options: Options::LOWER_LEVEL };
            let trajectory = |c: &Candidate<Answer>| c.solution.trajectory.clone();
            searched(&level, case, &task, cancelled, trajectory, (workers.device(), workers.count))?
        }
        _ => {
            let transcription = TranscriptionSettings::paper(case.method.rows());
            let mut settings = LowerSettings { transcription, ..LowerSettings::default() };
            settings.solver.stall.enabled = case.method.stall_rule();
            settings.validate()?;
            let level = BatchSolver { task: &task, settings: &settings, backend: devices.backend, cost: None, incumbent: None };
            let trajectory = |c: &Candidate<crate::search::evaluate::Evaluated>| c.solution.trajectory(&task, &settings.transcription);
            searched(&level, case, &task, cancelled, trajectory, (devices.backend.device(), devices.backend.threads()))?
        }
    };
    if cancelled.load(Ordering::Relaxed) {
        return Ok(None);
    }
    let report: Option<Report> = match &outcome.trajectory {
        Some(trajectory) => Some(verify(
            trajectory,
            &task.robot,
            &task.terrain,
            transcription::force_limit(&TranscriptionSettings::paper(case.method.rows()), &task),
        )?),
        None => None,
    };
    let rollout = report.as_ref().and_then(|r| r.rollout.as_ref());
    Ok(Some(Run {
        case: case.clone(),
        version: env!("CARGO_PKG_VERSION").into(),
        machine: machine(),
        device: outcome.device,
        threads: outcome.threads,
        budget: case.budget(),
        unix_time: SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs()),
        success: outcome.success,
        first_feasible_seconds: outcome.first_feasible,
        seconds: outcome.seconds,
        generations_run: outcome.generations,
        candidates: outcome.candidates,
        n_violated: report.as_ref().map(|r| r.rows.n_violated),
        max_violation: report.as_ref().map(|r| r.rows.max_violation).filter(|v| v.is_finite()),
        rollout_position: rollout.map(|r| r.position.value).filter(|v| v.is_finite()),
        rollout_attitude: rollout.map(|r| r.attitude.value).filter(|v| v.is_finite()),
        reach_excess: report.as_ref().map(|r| r.dense.reach_excess.value).filter(|v| v.is_finite()),
        mean_normal_force: outcome.mean_normal_force,
        best_objectives: outcome.best_objectives,
        durations: outcome.trajectory.map(|t| t.durations).unwrap_or_default(),
    }))
}

/// Runs a search over schedules.
fn searched<L: ScheduleSolver>(
    level: &L,
    case: &Case,
    task: &Task,
    cancelled: &AtomicBool,
    trajectory: impl Fn(&Candidate<L::Solution>) -> Trajectory,
    (device, threads): (String, usize),
) -> Result<RunOutcome> {
    let settings = case.search()?;
    let distribution = FreeDistribution::initial(&settings, task.robot.feet())?;
    let found: CemSearchResult<L::Solution> = search_with(level, distribution, &settings, case.seed, cancelled, &mut |_| ())?;
    let best = found.best.as_ref();
    Ok(RunOutcome {
        success: best.is_some_and(|b| b.evaluation.feasible),
        first_feasible: found.first_feasible_after,
        seconds: found.seconds,
        generations: found.generations.len(),
        candidates: found.generations.iter().map(|g| g.evaluated).sum(),
        best_objectives: found.generations.iter().map(|g| g.best_ever_objective).collect(),
        mean_normal_force: best.map(|b| b.evaluation.mean_normal_force),
        trajectory: best.map(trajectory),
        device,
        threads,
    })
}

/// Solves one program once in one process.
fn baseline(task: &Task, program: Program, workers: &Workers, cancelled: &AtomicBool) -> Result<RunOutcome> {
    let start = Instant::now();
    let answer = workers.answers(&[Job::new(task, program, Options::BASELINE)], cancelled)?.pop().flatten();
    let seconds = start.elapsed().as_secs_f64();
    let feasible = answer.as_ref().is_some_and(|a| a.feasible);
    Ok(RunOutcome {
        success: feasible,
        first_feasible: feasible.then_some(seconds),
        seconds,
        generations: 0,
        candidates: 1,
        best_objectives: Vec::new(),
        mean_normal_force: answer.as_ref().map(|a| a.mean_normal_force),
        trajectory: answer.map(|a| a.trajectory),
        device: workers.device(),
        threads: 1,
    })
}
