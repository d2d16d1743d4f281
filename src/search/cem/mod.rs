//! The upper level: mixed-distribution cross-entropy search (CEM-MD) over contact schedules. Source: \[1\].
//!
//! Each generation draws `N` candidates from a [`Distribution`], lets the lower level evaluate them, and fits the distribution to the `M` best.
//! There are three: the paper's ([`free`]), whose discrete variables are the numbers of stance phases of the feet and whose continuous ones are
//! the logarithms of all phase durations; [`periodic`] gaits of several families; and the neighbourhood of a schedule ([`perturb`]). The
//! objective, maximised, is `J = f - alpha N_vc`: see [`Objective`].
//!
//! This module sees only "evaluate these schedules" ([`Evaluator`]); it draws all random numbers of the crate.

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
pub(in crate::search) use run::summarise;
pub use run::{Generation, run, run_observed};
pub use settings::{CemSettings, PRESETS, Sampler, Stopping};

use crate::error::Result;
use crate::gait::Schedule;
use crate::gait::cost::Cost;
use crate::gait::family::GaitFamily;
use random::Draws;
use serde::Serialize;
use std::cmp::Ordering;

/// What candidates are drawn from, and fitted to elites.
pub trait Distribution {
    /// One draw.
    type Sample: Clone;

    /// Draws a candidate. Every number comes from a dimension of its own, whatever else is drawn.
    fn sample(&self, draws: Draws) -> Self::Sample;

    /// The schedule of a sample. Feet may end at different times.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] when there is no such schedule, e.g. one of too many strides.
    fn schedule(&self, sample: &Self::Sample) -> Result<Schedule>;

    /// Fits the distribution to the elites. Without elites nothing changes.
    fn update(&mut self, elites: &[&Self::Sample]);

    /// Mean entropy of the discrete dimensions, nats; 0 without any.
    fn entropy(&self) -> f64;

    /// Largest standard deviation of the continuous dimensions that the likeliest categories use.
    fn largest_std(&self) -> f64;

    /// Whether the search has settled.
    fn converged(&self) -> bool;

    /// Family of a sample, where there are families.
    fn family(&self, _sample: &Self::Sample) -> Option<GaitFamily> {
        None
    }
}

/// What the lower level says about one schedule.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Evaluation {
    /// Violated constraints `N_vc`.
    pub n_violated: usize,
    /// Whether the motion counts as found.
    pub feasible: bool,
    /// Whether that was certified; otherwise it is the solver's word.
    pub certified: bool,
    /// Mean of |normal force| over all force nodes of all feet, N.
    pub mean_normal_force: f64,
    /// What the motion costs, when it counts as found and anybody asks.
    pub cost: Option<Cost>,
}

/// What a search wants to know of the schedules of a generation.
#[derive(Debug, Clone, Copy)]
pub struct Aim<'a> {
    settings: &'a CemSettings,
    schedules: &'a [Schedule],
    /// Whether the first feasible candidate ends the search, whatever comes behind it.
    pub first_feasible: bool,
    /// How many feasible candidates, the best of all, are enough.
    pub enough: usize,
}

impl<'a> Aim<'a> {
    /// All is to be known of these schedules.
    pub(in crate::search) fn all(settings: &'a CemSettings, schedules: &'a [Schedule]) -> Self {
        Aim { settings, schedules, first_feasible: false, enough: usize::MAX }
    }

    /// The first feasible one is enough, if so it is wanted.
    pub(in crate::search) fn or_first(self, first: bool) -> Self {
        if first { Aim { first_feasible: true, enough: 1, ..self } } else { self }
    }

    /// What a schedule is worth, by its index and what the lower level says of it: the objective.
    pub fn worth(&self, index: usize, evaluation: &Evaluation) -> f64 {
        self.settings.worth(&self.schedules[index], evaluation)
    }

    /// What a feasible schedule counts for among those that are [`Aim::enough`]: what it is worth, or as much as any other where the first one
    /// ends the search.
    pub fn counts(&self, index: usize, evaluation: &Evaluation) -> f64 {
        if self.first_feasible { 0. } else { self.worth(index, evaluation) }
    }

    /// What a schedule counts for at most, whatever the lower level says of it.
    pub fn most(&self, index: usize) -> f64 {
        if self.first_feasible { 0. } else { self.settings.objective.most(&self.schedules[index], self.settings.penalty) }
    }
}

/// What an evaluator says of a schedule; of most schedules of a large generation without the solution, of which nobody will want to know.
pub type Answer<S> = (Evaluation, Option<Box<S>>);

/// The lower level.
pub trait Evaluator {
    /// What is kept of an evaluated schedule, e.g. a trajectory.
    type Solution;

    /// Evaluates the schedules of one generation; the result has their order and number.
    ///
    /// With [`Aim::first_feasible`], candidates after a feasible one may be left out (`None`): the result must be `Some` for every index up to
    /// the lowest feasible one. So may those that could only come behind [`Aim::enough`] feasible ones. Once [`Evaluator::cancelled`] holds,
    /// any candidate may be `None`.
    fn evaluate(&mut self, generation: usize, schedules: &[Schedule], aim: &Aim) -> Vec<Option<Answer<Self::Solution>>>;

    /// Checks that a schedule can be evaluated at all; others are drawn instead of one that cannot.
    ///
    /// # Errors
    /// What is wrong with it.
    fn check(&self, _schedule: &Schedule) -> Result<()> {
        Ok(())
    }

    /// The solution of a schedule that was evaluated, made again; `None` when it cannot be. An evaluator that keeps all solutions is never asked.
    fn again(&mut self, _schedule: &Schedule) -> Option<Self::Solution> {
        None
    }

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

impl<S> Candidate<S> {
    /// A schedule with what the lower level said of it.
    pub fn new(settings: &CemSettings, generation: usize, index: usize, schedule: Schedule, evaluation: Evaluation, solution: S) -> Self {
        let objective = settings.worth(&schedule, &evaluation);
        Candidate { generation, index, stances: stances(&schedule), schedule, objective, evaluation, solution }
    }
}

/// A candidate of a generation, whose solution may have been let go of.
pub type Member<S> = Candidate<Option<Box<S>>>;

impl<S> Member<S> {
    /// With its solution, which is made again where it was let go of; `None` when it cannot be.
    pub fn solved(self, again: impl FnOnce(&Schedule) -> Option<S>) -> Option<Candidate<S>> {
        let Candidate { generation, index, stances, schedule, objective, evaluation, solution } = self;
        let solution = solution.map(|solution| *solution).or_else(|| again(&schedule))?;
        Some(Candidate { generation, index, stances, schedule, objective, evaluation, solution })
    }
}

/// The order of candidates in a generation, each by its objective and its index: by falling objective, ties by index.
pub(in crate::search) fn rank_order((a, i): (f64, usize), (b, j): (f64, usize)) -> Ordering {
    b.total_cmp(&a).then(i.cmp(&j))
}

/// Stance phases of each foot.
fn stances(schedule: &Schedule) -> Vec<usize> {
    (0..schedule.feet()).map(|foot| schedule.stances(foot)).collect()
}

/// One generation in numbers. Objectives are `None` when no candidate has a finite one.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GenerationRecord {
    /// Generation, from 0.
    pub generation: usize,
    /// Candidates that count: evaluated, not after the first feasible one when the search ends there, and none that could only come behind
    /// the elites.
    pub evaluated: usize,
    /// Feasible ones among them; where not all were certified, solved ones.
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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum StopReason {
    /// A feasible candidate was found and no more was asked for.
    FirstFeasible,
    /// The distribution has converged: see [`Distribution::converged`].
    Converged,
    /// All generations were run.
    GenerationLimit,
    /// [`Evaluator::cancelled`].
    Cancelled,
    /// The time was up.
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

/// How a search ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome<S, D> {
    /// The candidate that ended the search ([`StopReason::FirstFeasible`]), otherwise the first one with the largest `J`.
    /// `None` only when nothing was evaluated.
    pub best: Option<Candidate<S>>,
    /// One record a generation.
    pub generations: Vec<GenerationRecord>,
    /// Why it ended.
    pub stop: StopReason,
    /// The last distribution. A generation that ends the search as first feasible or cancelled has not changed it.
    pub distribution: D,
}
