//! Result formats that other tools rely on: `result.json`, and the `result` of each line of `evaluate`.

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
use crate::search::{Gait, Improvement, LowerGround, SearchSettings};
use crate::settings::Transcription;
use crate::verify::Report;
use serde::Serialize;

/// Device and precision of a run.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SolvedOn {
    /// Name of the device, and its scalar type.
    pub device: String,
    /// Work that the device left to the CPU.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fallback: Option<Fallback>,
    /// Choice that opens the device again.
    #[serde(skip)]
    pub choice: DeviceChoice,
}

impl SolvedOn {
    /// Describes a backend. To be called after its work, when the fallback to the CPU is known.
    pub fn new(backend: &dyn Backend, precision: Precision) -> SolvedOn {
        SolvedOn {
            device: format!("{}, {}", backend.device(), precision.described()),
            fallback: backend.fallback(),
            choice: backend.choice(),
        }
    }
}

/// `result` of one line of `evaluate`.
#[derive(Debug, Clone, Serialize)]
pub struct EvaluateResult<'a> {
    /// Outcome.
    #[serde(flatten)]
    pub evaluated: &'a Evaluated,
    /// Device and precision.
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
    /// True if the certificate holds.
    pub feasible: bool,
    /// Number of rows and bounds violated by more than 1e-4 in TOWR's units.
    pub n_violated: usize,
    /// Largest of these violations.
    pub max_violation: f64,
    /// Horizon, s.
    pub horizon: f64,
    /// Solver.
    pub device: String,
    /// Transcription whose rows were solved.
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
    /// Gait family that the gait belongs to or is close to.
    pub family: Option<GaitFamily>,
    /// Generation that found the gait, from 0.
    pub generation: usize,
    /// Index of the gait in its generation.
    pub index: usize,
    /// Stance phases per foot.
    pub n_stance: Vec<usize>,
    /// Phase durations, with the horizon rounded, s, `[feet][phases]`.
    pub durations: Vec<Vec<f64>>,
    /// Objective `J`, maximised.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub objective: f64,
    /// Outcome of the solve, and the cost.
    #[serde(flatten)]
    pub evaluated: Evaluated,
}

impl GaitResult {
    /// The result of one gait.
    pub fn new(gait: &Gait) -> GaitResult {
        let candidate = &gait.candidate;
        GaitResult {
            family: candidate.family,
            generation: candidate.generation,
            index: candidate.index,
            n_stance: candidate.stances.clone(),
            durations: candidate.solution.durations(),
            objective: candidate.objective,
            evaluated: candidate.solution.clone(),
        }
    }
}

/// `result.json` of `solve`: everything needed to repeat the run, and its outcome.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SolveResult<'a> {
    /// Version of this program.
    pub version: &'static str,
    /// Scenario, if the request named one.
    pub scenario: Option<&'a str>,
    /// Target number in the scenario.
    pub target: Option<usize>,
    /// Seed.
    pub seed: u64,
    /// Largest normal force of a foot, N.
    pub force_limit: f64,
    /// Settings of the upper level.
    pub search: &'a SearchSettings,
    /// Settings of the lower level.
    pub lower: &'a LowerSettings,
    /// Name of the robot.
    pub robot: &'a str,
    /// Name of the terrain.
    pub terrain: &'a str,
    /// Goal position, m.
    pub base_target: [f64; 3],
    /// Goal yaw, rad.
    pub yaw_target: f64,
    /// Transcription whose rows were solved.
    pub transcription: Transcription,
    /// Device and precision.
    #[serde(flatten)]
    pub solved_on: SolvedOn,
    /// True if a certified gait was found.
    pub feasible: bool,
    /// Reason for which the search ended.
    pub stop: StopReason,
    /// Number of violated rows of the gait, N_vc.
    pub n_violated: usize,
    /// Largest violation of the gait, in the unit of its row.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub max_violation: f64,
    /// Time to the first certified gait, s.
    pub first_feasible_seconds: Option<f64>,
    /// Time of the search, s.
    pub seconds: f64,
    /// Findings of the checks before the search.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<Finding>,
    /// Use of the joint limits by the gait, if the robot has joints.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joints: Option<JointLimits>,
    /// Diagnosis if no certified gait was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub diagnosis: Option<Diagnosis>,
    /// Best gait.
    pub gait: GaitResult,
    /// Refinement of the gait, if requested. The gait and its certificate are then the refined ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refinement: Option<&'a Refinement>,
    /// Certificate of the gait.
    pub certificate: &'a Report,
    /// Best gaits of other families.
    pub alternatives: Vec<GaitResult>,
    /// Search on lower ground, if there was one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lower_ground: Option<LowerGround>,
    /// Every gait that was the best so far.
    pub improvements: &'a [Improvement],
    /// Record of each generation.
    pub generations: &'a [GenerationRecord],
}

/// Refinement of the best gait.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Refinement {
    /// Outcome.
    #[serde(flatten)]
    pub refined: Refined,
    /// Settings.
    pub settings: RefineSettings,
    /// Time, s.
    pub seconds: f64,
}
