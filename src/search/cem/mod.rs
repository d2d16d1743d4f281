//! The upper level: mixed-distribution cross-entropy search (CEM-MD) over contact schedules. Source: \[1\].
//!
//! Discrete variables are the numbers of stance phases of the feet, continuous ones the logarithms of all phase durations. Each
//! generation draws `N` candidates, lets the lower level evaluate them, and fits the distribution to the `M` best. The objective,
//! maximised, is `J = f - alpha N_vc`: see [`Objective`].
//!
//! This module sees only "evaluate these schedules" ([`Evaluate`]); it draws all random numbers of the crate.

pub mod distribution;
pub mod heuristic;
pub mod objective;
pub mod periodic;
pub mod random;
pub mod run;
pub mod settings;

pub use distribution::{Distribution, Sample};
pub use objective::Objective;
pub use run::run;
pub use settings::{CemSettings, PRESETS, Sampler, Stopping};

use crate::gait::Schedule;
use serde::Serialize;

/// What the lower level says about one schedule.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Evaluation {
    /// Violated constraints `N_vc`.
    pub n_violated: usize,
    /// Whether the motion counts as found.
    pub feasible: bool,
    /// Mean of |normal force| over all force nodes of all feet, N.
    pub mean_normal_force: f64,
}

/// The lower level.
pub trait Evaluate {
    /// What is kept of an evaluated schedule, e.g. a trajectory.
    type Solution;

    /// Evaluates the schedules of one generation; the result has their order and number.
    ///
    /// With `first_feasible`, candidates after a feasible one may be left out (`None`): the result must be `Some` for every index up to
    /// the lowest feasible one. Once [`Evaluate::cancelled`] holds, any candidate may be `None`.
    fn evaluate(&mut self, generation: usize, schedules: &[Schedule], first_feasible: bool) -> Vec<Option<(Evaluation, Self::Solution)>>;

    /// Whether the user asked for the end. Read before and after every generation; the best candidate so far is returned.
    fn cancelled(&self) -> bool {
        false
    }
}

/// One evaluated schedule.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate<S> {
    /// Generation, from 0.
    pub generation: usize,
    /// Index in its generation, from 0.
    pub index: usize,
    /// Stance phases of each foot.
    pub stances: Vec<usize>,
    /// The schedule, as drawn: feet end at different times.
    pub schedule: Schedule,
    /// Objective `J`; negative infinity when it was no number.
    pub objective: f64,
    /// What the lower level said.
    pub evaluation: Evaluation,
    /// What the lower level found.
    pub solution: S,
}

/// One generation in numbers. Objectives are `None` when no candidate has a finite one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GenerationRecord {
    /// Generation, from 0.
    pub generation: usize,
    /// Candidates that count: evaluated, and not after the first feasible one when the search ends there.
    pub evaluated: usize,
    /// Feasible ones among them.
    pub feasible: usize,
    /// Largest `J` of the generation.
    pub best_objective: Option<f64>,
    /// Mean of the finite `J`.
    pub mean_objective: Option<f64>,
    /// Largest `J` so far.
    pub best_ever_objective: Option<f64>,
    /// Fewest violated constraints of a candidate; `None` when none was evaluated.
    pub lowest_n_violated: Option<usize>,
    /// Mean entropy of the categoricals after the generation, nats.
    pub entropy: f64,
    /// Largest standard deviation of a log duration that the likeliest stance counts use, after the generation.
    pub largest_std: f64,
}

/// Why a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum StopReason {
    /// A feasible candidate was found and no more was asked for.
    FirstFeasible,
    /// The distribution has converged: see [`Distribution::converged`].
    Converged,
    /// All generations were run.
    GenerationLimit,
    /// [`Evaluate::cancelled`].
    Cancelled,
}

impl std::fmt::Display for StopReason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            StopReason::FirstFeasible => "first feasible",
            StopReason::Converged => "converged",
            StopReason::GenerationLimit => "generation limit",
            StopReason::Cancelled => "cancelled",
        })
    }
}

/// How a search ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome<S> {
    /// The candidate that ended the search ([`StopReason::FirstFeasible`]), otherwise the first one with the largest `J`.
    /// `None` only when nothing was evaluated.
    pub best: Option<Candidate<S>>,
    /// One record a generation.
    pub generations: Vec<GenerationRecord>,
    /// Why it ended.
    pub stop: StopReason,
    /// The last distribution. A generation that ends the search as first feasible or cancelled has not changed it.
    pub distribution: Distribution,
}
