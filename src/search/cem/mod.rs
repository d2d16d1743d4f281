//! The upper level: mixed-distribution cross-entropy search (CEM-MD) over contact schedules. Source: \[1\].
//!
//! Each generation draws `N` candidates from a [`Distribution`], evaluates them with the lower level and fits the distribution to the `M`
//! best, the elites. There are three distributions:
//! * [`free`]: the paper's. Its discrete variables are the stance counts of the feet, its continuous ones the logarithms of all phase
//!   durations.
//! * [`periodic`]: periodic gaits of several families.
//! * [`perturb`]: the neighbourhood of one schedule.
//!
//! The objective, maximised, is `J = f - alpha N_vc`: see [`Objective`].
//!
//! This module knows the lower level only as a [`GenerationEvaluator`]. It draws all random numbers of the crate.

pub mod free;
pub mod heuristic;
pub mod marginals;
pub mod objective;
pub mod periodic;
pub mod perturb;
pub mod random;
mod run;
pub mod settings;

pub use free::FreeDistribution;
pub use objective::Objective;
pub use periodic::{PeriodicDistribution, PeriodicSettings};
pub use perturb::{PerturbDistribution, PerturbSettings};
pub use run::{Generation, run, run_observed};
pub(in crate::search) use run::{candidates, summarise};
pub use settings::{CemSettings, PRESETS, Sampler, Stopping};

use crate::error::Result;
use crate::gait::Schedule;
use crate::gait::cost::Cost;
use crate::gait::family::GaitFamily;
use random::Draws;
use serde::Serialize;
use std::cmp::Ordering;

/// Distribution that candidates are drawn from and that is fitted to the elites.
pub trait Distribution {
    /// One draw.
    type Sample: Clone;

    /// Draws a candidate. Each number has its own random dimension and does not depend on other draws.
    fn sample(&self, draws: Draws) -> Self::Sample;

    /// The schedule of a sample. Feet may end at different times.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] if the sample describes no valid schedule, e.g. because it has too many strides.
    fn schedule(&self, sample: &Self::Sample) -> Result<Schedule>;

    /// Fits the distribution to the elites. Changes nothing without elites.
    fn update(&mut self, elites: &[&Self::Sample]);

    /// Mean entropy of the discrete dimensions, nats; 0 without any.
    fn entropy(&self) -> f64;

    /// Largest standard deviation of the continuous dimensions that the likeliest categories use.
    fn largest_std(&self) -> f64;

    /// True if the distribution has converged.
    fn converged(&self) -> bool;

    /// Gait family of a sample; `None` if the distribution has no families.
    fn family(&self, _sample: &Self::Sample) -> Option<GaitFamily> {
        None
    }
}

/// Numbers by which the cross-entropy loop ranks a schedule. The rest of the lower level's result may be dropped; for
/// [`BatchSolver`](super::BatchSolver) it is an [`Evaluated`](super::evaluate::Evaluated).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Evaluation {
    /// True if every row of the certificate holds. Without a certificate: true if the solver solved the problem.
    pub feasible: bool,
    /// True if the motion was certified. With [`Certify::Unsolved`](super::Certify::Unsolved), solved motions are not.
    #[serde(skip)]
    pub certified: bool,
    /// Number of rows and bounds of the certificate that are violated by more than their tolerance, `N_vc`: see
    /// [`verify`](mod@crate::verify).
    pub n_violated: usize,
    /// Mean over all force nodes of the magnitude of the normal force, N.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub mean_normal_force: f64,
    /// Cost of the motion; `None` if it is infeasible or no cost was requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cost: Option<Cost>,
}

/// Goal of a generation: objective values of its schedules, and the candidates that selection needs.
#[derive(Debug, Clone, Copy)]
pub struct SelectionGoal<'a> {
    settings: &'a CemSettings,
    schedules: &'a [Schedule],
    /// True if the first feasible candidate ends the search, so that later candidates are irrelevant.
    pub first_feasible: bool,
    /// Number of best feasible candidates that the search needs.
    pub enough: usize,
}

impl<'a> SelectionGoal<'a> {
    /// Requires the evaluation of every schedule.
    pub(in crate::search) fn all(settings: &'a CemSettings, schedules: &'a [Schedule]) -> Self {
        SelectionGoal { settings, schedules, first_feasible: false, enough: usize::MAX }
    }

    /// Requires only the candidates up to the first feasible one if `first` is set.
    pub(in crate::search) fn or_first(self, first: bool) -> Self {
        if first { SelectionGoal { first_feasible: true, enough: 1, ..self } } else { self }
    }

    /// Objective of the schedule with this index, given its evaluation.
    pub fn objective(&self, index: usize, evaluation: &Evaluation) -> f64 {
        self.settings.objective_of(&self.schedules[index], evaluation)
    }

    /// Value by which feasible schedules compete for the [`SelectionGoal::enough`] places: their objective, or 0 for all if the first
    /// feasible one ends the search.
    pub fn competing_value(&self, index: usize, evaluation: &Evaluation) -> f64 {
        if self.first_feasible { 0. } else { self.objective(index, evaluation) }
    }

    /// Upper bound of [`SelectionGoal::competing_value`], known before the schedule is evaluated.
    pub fn upper_bound(&self, index: usize) -> f64 {
        if self.first_feasible { 0. } else { self.settings.objective.upper_bound(&self.schedules[index], self.settings.penalty) }
    }
}

/// Evaluation of each schedule of a generation, with its solution. An entry is `None` if the schedule was not evaluated. The solution is
/// `None` for most schedules of a large generation, because it was dropped.
pub type GenerationResults<S> = Vec<Option<(Evaluation, Option<Box<S>>)>>;

/// Lower level as the cross-entropy loop sees it: evaluates the schedules of one generation.
///
/// The search implements it on top of a [`ScheduleSolver`](super::ScheduleSolver).
pub trait GenerationEvaluator {
    /// Solution of an evaluated schedule, e.g. a trajectory.
    type Solution;

    /// Evaluates the schedules of one generation. The results have their order and number.
    ///
    /// An entry may be `None` in three cases:
    /// * with [`SelectionGoal::first_feasible`], for an index above the lowest feasible one;
    /// * for a candidate that could only rank after [`SelectionGoal::enough`] feasible ones;
    /// * for any candidate once [`GenerationEvaluator::cancelled`] returns true.
    fn evaluate(&mut self, generation: usize, schedules: &[Schedule], goal: &SelectionGoal) -> GenerationResults<Self::Solution>;

    /// Checks that a schedule can be evaluated. The search draws a replacement for one that cannot.
    ///
    /// # Errors
    /// Describes why the schedule cannot be evaluated.
    fn check(&self, _schedule: &Schedule) -> Result<()> {
        Ok(())
    }

    /// Recomputes the solution of a schedule that was evaluated before; `None` if that fails. Never called for an evaluator that keeps all
    /// solutions.
    fn solve_again(&mut self, _schedule: &Schedule) -> Option<Self::Solution> {
        None
    }

    /// True if the search must end. Read before and after every generation; the search then returns its best candidate so far.
    fn cancelled(&self) -> bool {
        false
    }
}

/// One evaluated schedule of a generation. `S` is its solution.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate<S> {
    /// Gait family, if the schedule was drawn from one or from the neighbourhood of one.
    pub family: Option<GaitFamily>,
    /// Generation, from 0.
    pub generation: usize,
    /// Index in the generation, from 0.
    pub index: usize,
    /// Number of stance phases of each foot.
    pub stances: Vec<usize>,
    /// Schedule as drawn: feet may end at different times.
    pub schedule: Schedule,
    /// Objective `J`; negative infinity if it was NaN.
    pub objective: f64,
    /// Evaluation by the lower level.
    pub evaluation: Evaluation,
    /// Solution of the lower level.
    pub solution: S,
}

impl<S> Candidate<S> {
    /// Combines a schedule with its evaluation and solution, and computes the objective.
    pub fn new(
        settings: &CemSettings,
        family: Option<GaitFamily>,
        generation: usize,
        index: usize,
        schedule: Schedule,
        evaluation: Evaluation,
        solution: S,
    ) -> Self {
        let objective = settings.objective_of(&schedule, &evaluation);
        Candidate { family, generation, index, stances: stances(&schedule), schedule, objective, evaluation, solution }
    }

    /// Copy of the candidate with another evaluation and solution.
    pub fn evaluated_again<R>(&self, settings: &CemSettings, evaluation: Evaluation, solution: R) -> Candidate<R> {
        Candidate::new(settings, self.family, self.generation, self.index, self.schedule.clone(), evaluation, solution)
    }
}

/// Candidate of a ranked generation. The solutions of most candidates of a large generation are dropped.
pub type RankedCandidate<S> = Candidate<Option<Box<S>>>;

impl<S> RankedCandidate<S> {
    /// The candidate with its solution, which `solve_again` recomputes if it was dropped; `None` if that fails.
    pub fn with_solution(self, solve_again: impl FnOnce(&Schedule) -> Option<S>) -> Option<Candidate<S>> {
        let Candidate { family, generation, index, stances, schedule, objective, evaluation, solution } = self;
        let solution = solution.map(|solution| *solution).or_else(|| solve_again(&schedule))?;
        Some(Candidate { family, generation, index, stances, schedule, objective, evaluation, solution })
    }
}

/// Order of candidates in a generation, given as (objective, index): by decreasing objective, ties by index.
pub(in crate::search) fn rank_order((a, i): (f64, usize), (b, j): (f64, usize)) -> Ordering {
    b.total_cmp(&a).then(i.cmp(&j))
}

/// Number of stance phases of each foot.
pub(in crate::search) fn stances(schedule: &Schedule) -> Vec<usize> {
    (0..schedule.feet()).map(|foot| schedule.stances(foot)).collect()
}

/// Statistics of one generation. Objectives are `None` if no candidate has a finite one.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GenerationRecord {
    /// Generation, from 0.
    pub generation: usize,
    /// Number of candidates that count: those evaluated, without candidates after a first feasible one that ends the search and without
    /// those that could only rank after the elites.
    pub evaluated: usize,
    /// Number of feasible candidates among them. A candidate without a certificate counts if the solver solved it.
    pub feasible: usize,
    /// Largest objective of the generation.
    pub best_objective: Option<f64>,
    /// Mean of the finite objectives.
    pub mean_objective: Option<f64>,
    /// Largest objective so far.
    pub best_ever_objective: Option<f64>,
    /// Smallest number of violated constraints of a candidate; `None` if no candidate was evaluated.
    pub lowest_n_violated: Option<usize>,
    /// Mean entropy of the categorical distributions after the generation, nats.
    pub entropy: f64,
    /// Largest standard deviation, after the generation, of a log duration that the likeliest stance counts use.
    pub largest_std: f64,
}

/// Reason for the end of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum StopReason {
    /// A feasible candidate was found, and the search was set to stop at the first one.
    FirstFeasible,
    /// The distribution has converged: see [`Distribution::converged`].
    Converged,
    /// All generations were run.
    GenerationLimit,
    /// [`GenerationEvaluator::cancelled`] returned true.
    Cancelled,
    /// The time limit was reached.
    TimeLimit,
}

impl std::fmt::Display for StopReason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            StopReason::FirstFeasible => "first feasible",
            StopReason::Converged => "converged",
            StopReason::GenerationLimit => "generation limit",
            StopReason::Cancelled => "cancelled",
            StopReason::TimeLimit => "time limit",
        })
    }
}

/// Result of the cross-entropy loop.
#[derive(Debug, Clone, PartialEq)]
pub struct CemOutcome<S, D> {
    /// Candidate that ended the search ([`StopReason::FirstFeasible`]), otherwise the first one with the largest objective.
    /// `None` only if no candidate was evaluated.
    pub best: Option<Candidate<S>>,
    /// Statistics of each generation.
    pub generations: Vec<GenerationRecord>,
    /// Reason for the end.
    pub stop: StopReason,
    /// Last distribution. A generation that ends the search as first feasible or cancelled does not change it.
    pub distribution: D,
}
