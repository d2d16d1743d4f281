//! Results in the forms that other tools rely on (`result.json`, and the `result` of each line of `evaluate`).

use crate::backend::{Backend, DeviceChoice, Fallback, Precision};
use crate::gait::family::GaitFamily;
use crate::gait::joints::JointLimits;
use crate::reference::ipopt::Statistics;
use crate::reference::job::Answer;
use crate::refine::{RefineSettings, Refined};
use crate::search::cem::{GenerationRecord, StopReason};
use crate::search::diagnosis::Diagnosis;
use crate::search::evaluate::{Evaluated, LowerSettings};
use crate::search::precheck::Finding;
use crate::search::{Gait, Improvement, SearchResult, SearchSettings};
use crate::settings::Transcription;
use crate::task::Task;
use crate::verify::Report;
use serde::Serialize;

/// Where it was solved.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SolvedOn {
    /// Name of the device, and the scalar.
    pub device: String,
    /// What the device left to the CPU.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fallback: Option<Fallback>,
    /// Choice that opens the device again.
    #[serde(skip)]
    pub choice: DeviceChoice,
}

impl SolvedOn {
    /// A backend, after its work: it says what could not be done where it should have been.
    pub fn new(backend: &dyn Backend, precision: Precision) -> SolvedOn {
        let precision = match precision {
            Precision::F32 => "f32 closed in f64",
            Precision::F64 => "f64",
        };
        SolvedOn { device: format!("{}, {precision}", backend.device()), fallback: backend.fallback(), choice: backend.choice() }
    }
}

/// `result` of one line of `evaluate`.
#[derive(Debug, Clone, Serialize)]
pub struct EvaluateResult<'a> {
    /// What came of it.
    #[serde(flatten)]
    pub evaluated: &'a Evaluated,
    /// Where it was solved.
    #[serde(flatten)]
    pub solved_on: &'a SolvedOn,
    /// Version of this program.
    pub version: &'static str,
}

impl EvaluateResult<'_> {
    /// The result of one candidate.
    pub fn new<'a>(evaluated: &'a Evaluated, solved_on: &'a SolvedOn) -> EvaluateResult<'a> {
        EvaluateResult { evaluated, solved_on, version: env!("CARGO_PKG_VERSION") }
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

/// A gait of a [`SolveResult`].
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GaitResult {
    /// Its family, where it is one of a family or near one.
    pub family: Option<GaitFamily>,
    /// Generation that found it, from 0.
    pub generation: usize,
    /// Its index there.
    pub index: usize,
    /// Stance phases per foot.
    pub n_stance: Vec<usize>,
    /// Phase durations after the horizon is rounded, s, `[feet][phases]`.
    pub durations: Vec<Vec<f64>>,
    /// Objective `J`, maximised.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub objective: f64,
    /// Mean normal force over all force nodes, N.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub mean_normal_force: f64,
    /// How it was solved, and what it costs.
    #[serde(flatten)]
    pub evaluated: Evaluated,
}

impl GaitResult {
    fn new(gait: &Gait) -> GaitResult {
        let candidate = &gait.candidate;
        GaitResult {
            family: gait.family,
            generation: candidate.generation,
            index: candidate.index,
            n_stance: candidate.stances.clone(),
            durations: candidate.solution.durations(),
            objective: candidate.objective,
            mean_normal_force: candidate.solution.mean_normal_force,
            evaluated: candidate.solution.clone(),
        }
    }
}

/// `result.json` of `solve`: everything needed to repeat the run, and what came of it.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SolveResult<'a> {
    /// Version of this program.
    pub version: &'static str,
    /// What was asked for.
    #[serde(flatten)]
    pub run: &'a Run<'a>,
    /// Robot.
    pub robot: &'a str,
    /// Terrain.
    pub terrain: &'a str,
    /// Goal position, m.
    pub base_target: [f64; 3],
    /// Goal yaw, rad.
    pub yaw_target: f64,
    /// Rows it was solved for.
    pub transcription: Transcription,
    /// Where it was solved.
    #[serde(flatten)]
    pub solved_on: SolvedOn,
    /// Whether a certified gait was found.
    pub feasible: bool,
    /// Why the search ended.
    pub stop: StopReason,
    /// N_vc of the gait.
    pub n_violated: usize,
    /// Its worst violation, in the row's own unit.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub max_violation: f64,
    /// Time to the first certified gait, s.
    pub first_feasible_seconds: Option<f64>,
    /// Time of the search, s.
    pub seconds: f64,
    /// What was pointed out before the search.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<Finding>,
    /// How near the gait comes to the limits of the robot's joints, where it has joints.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joints: Option<JointLimits>,
    /// Why nothing was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub diagnosis: Option<Diagnosis>,
    /// The best gait.
    pub gait: GaitResult,
    /// How it was refined, if it was: the gait and its certificate are those after it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refinement: Option<&'a Refinement>,
    /// Its certificate.
    pub certificate: &'a Report,
    /// The best of other families.
    pub alternatives: Vec<GaitResult>,
    /// Each gait that was the best so far.
    pub improvements: &'a [Improvement],
    /// The search by generation.
    pub generations: &'a [GenerationRecord],
}

/// What became of the best gait when it was refined.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Refinement {
    /// How it went.
    #[serde(flatten)]
    pub refined: Refined,
    /// Settings.
    pub settings: RefineSettings,
    /// Time, s.
    pub seconds: f64,
}

/// What a run was asked to do, for its result.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Run<'a> {
    /// Scenario, if one was named.
    pub scenario: Option<&'a str>,
    /// Its target.
    pub target: Option<usize>,
    /// Task.
    #[serde(skip)]
    pub task: &'a Task,
    /// Seed.
    pub seed: u64,
    /// Largest normal force of a foot, N.
    pub force_limit: f64,
    /// Settings of the upper level.
    pub search: &'a SearchSettings,
    /// Settings of the lower level.
    pub lower: &'a LowerSettings,
}

impl<'a> SolveResult<'a> {
    /// The result of a search, without warnings and diagnosis.
    pub fn new(run: &'a Run<'a>, found: &'a SearchResult, refinement: Option<&'a Refinement>, solved_on: SolvedOn) -> SolveResult<'a> {
        let best = &found.best;
        SolveResult {
            version: env!("CARGO_PKG_VERSION"),
            run,
            robot: &run.task.robot.name,
            terrain: &run.task.terrain.name,
            base_target: run.task.goal.position,
            yaw_target: run.task.goal.yaw(),
            transcription: run.lower.transcription.rows,
            solved_on,
            feasible: best.feasible(),
            stop: found.stop,
            n_violated: best.candidate.solution.n_violated,
            max_violation: best.candidate.solution.max_violation,
            first_feasible_seconds: found.first_feasible_after,
            seconds: found.seconds,
            warnings: Vec::new(),
            joints: None,
            diagnosis: None,
            gait: GaitResult::new(best),
            refinement,
            certificate: best.certificate(),
            alternatives: found.alternatives.iter().map(GaitResult::new).collect(),
            improvements: &found.improvements,
            generations: &found.generations,
        }
    }
}
