//! Results in the forms that other tools rely on (`result.json`, and the `result` of each line of `evaluate`).

use crate::reference::ipopt::Statistics;
use crate::reference::job::Answer;
use crate::search::Found;
use crate::search::cem::{CemSettings, GenerationRecord, StopReason};
use crate::search::evaluate::{Evaluated, LowerSettings};
use crate::settings::Transcription;
use crate::solver::Status;
use crate::task::Task;
use crate::verify::Report;
use serde::Serialize;

/// `result` of one line of `evaluate`.
#[derive(Debug, Clone, Serialize)]
pub struct EvaluateResult {
    /// How the solve ended.
    pub status: Status,
    /// Whether the certificate holds.
    pub feasible: bool,
    /// Iterations.
    pub iterations: usize,
    /// Factorisations.
    pub factorizations: usize,
    /// Violated rows and bounds beyond 1e-4 in TOWR's units.
    pub n_violated: usize,
    /// Worst of them.
    pub max_violation: f64,
    /// Horizon, s.
    pub horizon: f64,
    /// Variables of the reduced problem.
    pub n_variables: usize,
    /// Time from the start of the batch to the end of this candidate, s.
    pub seconds: f64,
    /// Where it was solved.
    pub device: String,
    /// Rows it was solved for.
    pub transcription: Transcription,
    /// Version of this program.
    pub version: &'static str,
}

impl EvaluateResult {
    /// The result of one candidate.
    pub fn new(evaluated: &Evaluated, device: &str) -> EvaluateResult {
        EvaluateResult {
            status: evaluated.status,
            feasible: evaluated.feasible,
            iterations: evaluated.iterations,
            factorizations: evaluated.factorisations,
            n_violated: evaluated.n_violated,
            max_violation: evaluated.max_violation,
            horizon: evaluated.horizon,
            n_variables: evaluated.n_variables,
            seconds: evaluated.finished_after,
            device: device.into(),
            transcription: evaluated.transcription,
            version: env!("CARGO_PKG_VERSION"),
        }
    }
}

/// `result` of one line of `evaluate --solver ipopt`.
#[derive(Debug, Clone, Serialize)]
pub struct IpoptResult {
    /// Ipopt's status, iterations, time, and sizes of the whole program.
    #[serde(flatten)]
    pub statistics: Statistics,
    /// Whether the certificate holds.
    pub feasible: bool,
    /// Violated rows and bounds beyond 1e-4 in TOWR's units.
    pub n_violated: usize,
    /// Worst of them.
    pub max_violation: f64,
    /// Horizon, s.
    pub horizon: f64,
    /// Where it was solved.
    pub device: String,
    /// Rows it was solved for.
    pub transcription: Transcription,
    /// Version of this program.
    pub version: &'static str,
}

impl IpoptResult {
    /// The result of one candidate.
    pub fn new(answer: &Answer, device: &str) -> IpoptResult {
        IpoptResult {
            statistics: answer.statistics.clone(),
            feasible: answer.feasible,
            n_violated: answer.n_violated,
            max_violation: answer.max_violation,
            horizon: answer.trajectory.horizon,
            device: device.into(),
            transcription: Transcription::Towr,
            version: env!("CARGO_PKG_VERSION"),
        }
    }
}

/// The gait of a [`SolveResult`].
#[derive(Debug, Clone, Serialize)]
pub struct Gait {
    /// Generation that found it, from 0.
    pub generation: usize,
    /// Its index there.
    pub index: usize,
    /// Stance phases per foot.
    pub n_stance: Vec<usize>,
    /// Phase durations after the horizon is rounded, s, `[feet][phases]`.
    pub durations: Vec<Vec<f64>>,
    /// Horizon, s.
    pub horizon: f64,
    /// Objective `J`.
    pub objective: f64,
    /// How its solve ended.
    pub status: Status,
    /// Iterations.
    pub iterations: usize,
    /// Factorisations.
    pub factorizations: usize,
    /// Variables.
    pub n_variables: usize,
    /// Mean normal force over all force nodes, N.
    pub mean_normal_force: f64,
}

/// `result.json` of `solve`: everything needed to repeat the run, and what came of it.
#[derive(Debug, Clone, Serialize)]
pub struct SolveResult {
    /// Version of this program.
    pub version: &'static str,
    /// Scenario, if one was named.
    pub scenario: Option<String>,
    /// Its target.
    pub target: Option<usize>,
    /// Robot.
    pub robot: String,
    /// Terrain.
    pub terrain: String,
    /// Goal position, m.
    pub base_target: [f64; 3],
    /// Goal yaw, rad.
    pub yaw_target: f64,
    /// Largest normal force of a foot, N.
    pub force_limit: f64,
    /// Seed.
    pub seed: u64,
    /// Where it was solved.
    pub device: String,
    /// Rows it was solved for.
    pub transcription: Transcription,
    /// Settings of the upper level.
    pub search: CemSettings,
    /// Settings of the lower level.
    pub lower: LowerSettings,
    /// Whether a certified gait was found.
    pub feasible: bool,
    /// Why the search ended.
    pub stop: StopReason,
    /// N_vc of the gait.
    pub n_violated: Option<usize>,
    /// Its worst violation in TOWR's units.
    pub max_violation: Option<f64>,
    /// Time to the first certified gait, s.
    pub first_feasible_seconds: Option<f64>,
    /// Time of the search, s.
    pub seconds: f64,
    /// The gait.
    pub gait: Option<Gait>,
    /// Its certificate.
    pub certificate: Option<Report>,
    /// The search by generation.
    pub generations: Vec<GenerationRecord>,
}

/// What a run was asked to do, for its result.
#[derive(Debug, Clone)]
pub struct Run<'a> {
    /// Scenario and target, if named.
    pub scenario: Option<(&'a str, Option<usize>)>,
    /// Task.
    pub task: &'a Task,
    /// Settings of the upper level.
    pub search: &'a CemSettings,
    /// Settings of the lower level.
    pub lower: &'a LowerSettings,
    /// Seed.
    pub seed: u64,
    /// Device name.
    pub device: String,
    /// Largest normal force of a foot, N.
    pub force_limit: f64,
}

impl SolveResult {
    /// The result of a search.
    pub fn new(run: &Run, found: &Found, certificate: Option<Report>) -> SolveResult {
        let best = found.best.as_ref();
        SolveResult {
            version: env!("CARGO_PKG_VERSION"),
            scenario: run.scenario.map(|s| s.0.into()),
            target: run.scenario.and_then(|s| s.1),
            robot: run.task.robot.name.clone(),
            terrain: run.task.terrain.name.clone(),
            base_target: run.task.base_target,
            yaw_target: run.task.yaw_target,
            force_limit: run.force_limit,
            seed: run.seed,
            device: run.device.clone(),
            transcription: run.lower.transcription.rows,
            search: run.search.clone(),
            lower: run.lower.clone(),
            feasible: best.is_some_and(|b| b.solution.feasible),
            stop: found.stop,
            n_violated: best.map(|b| b.solution.n_violated),
            max_violation: best.map(|b| b.solution.max_violation),
            first_feasible_seconds: found.first_feasible_after,
            seconds: found.seconds,
            gait: best.map(|b| Gait {
                generation: b.generation,
                index: b.index,
                n_stance: b.stances.clone(),
                durations: b.solution.durations(),
                horizon: b.solution.horizon,
                objective: b.objective,
                status: b.solution.status,
                iterations: b.solution.iterations,
                factorizations: b.solution.factorisations,
                n_variables: b.solution.n_variables,
                mean_normal_force: b.solution.mean_normal_force,
            }),
            certificate,
            generations: found.generations.clone(),
        }
    }
}
