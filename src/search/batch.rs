//! Who solves the schedules of a search, and the clock beside it.

use super::cem::{Candidate, CemSettings, Distribution, Evaluation, Evaluator, GenerationRecord, StopReason, run};
use super::evaluate::{Cancelled, Certify, Evaluated, LowerSettings, batch};
use crate::backend::Backend;
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::gait::cost::CostWeights;
use crate::task::Task;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// One candidate as a [`LowerLevel`] solved it.
#[derive(Debug)]
pub struct Solved<S> {
    /// For the upper level.
    pub evaluation: Evaluation,
    /// Time from the start of its batch, s.
    pub finished_after: f64,
    /// What is kept.
    pub solution: S,
}

/// Who solves the schedules: this program's solver ([`BatchSolver`]), or another one to compare with.
pub trait LowerLevel {
    /// What is kept of a candidate.
    type Solution;

    /// Solves schedules; the result has their order and number. `first_feasible` and `cancelled` as in
    /// [`evaluate`](super::evaluate::evaluate()).
    ///
    /// # Errors
    /// What keeps it from solving any.
    fn solve(&self, schedules: &[Schedule], first_feasible: bool, cancelled: Cancelled) -> Result<Vec<Option<Solved<Self::Solution>>>>;

    /// As [`LowerLevel::solve`] of all, leaving it to the caller to certify the solved ones that it wants. By default nothing is left.
    ///
    /// # Errors
    /// As [`LowerLevel::solve`].
    fn solve_alone(&self, schedules: &[Schedule], cancelled: Cancelled) -> Result<Vec<Option<Solved<Self::Solution>>>> {
        self.solve(schedules, false, cancelled)
    }
}

/// This program's solver, with the certificate and, when it is asked for, the cost of what it finds.
#[derive(Clone, Copy)]
pub struct BatchSolver<'a> {
    /// The task.
    pub task: &'a Task,
    /// Settings.
    pub settings: &'a LowerSettings,
    /// Where it is solved.
    pub backend: &'a dyn Backend,
    /// Weights of the cost of transport; none: no cost is worked out.
    pub cost: Option<&'a CostWeights>,
}

impl LowerLevel for BatchSolver<'_> {
    type Solution = Evaluated;

    fn solve(&self, schedules: &[Schedule], first_feasible: bool, cancelled: Cancelled) -> Result<Vec<Option<Solved<Evaluated>>>> {
        self.certifying(schedules, if first_feasible { Certify::UntilFeasible } else { Certify::All }, cancelled)
    }

    fn solve_alone(&self, schedules: &[Schedule], cancelled: Cancelled) -> Result<Vec<Option<Solved<Evaluated>>>> {
        self.certifying(schedules, Certify::Unsolved, cancelled)
    }
}

impl BatchSolver<'_> {
    fn certifying(&self, schedules: &[Schedule], wanted: Certify, cancelled: Cancelled) -> Result<Vec<Option<Solved<Evaluated>>>> {
        let candidates: Vec<(&Task, &Schedule)> = schedules.iter().map(|s| (self.task, s)).collect();
        let results = batch(&candidates, self.settings, self.cost, self.backend, wanted, cancelled)?;
        let solved = |r: Evaluated| Solved { evaluation: r.evaluation(), finished_after: r.finished_after, solution: r };
        Ok(results.into_iter().map(|r| r.map(solved)).collect())
    }
}

/// When a search began, and what ends it from outside.
#[derive(Clone, Copy)]
pub(super) struct Clock<'a> {
    start: Instant,
    cancelled: Option<&'a AtomicBool>,
    limit: Option<Duration>,
}

impl<'a> Clock<'a> {
    pub fn new(cancelled: Option<&'a AtomicBool>, limit: Option<Duration>) -> Self {
        Clock { start: Instant::now(), cancelled, limit }
    }

    /// Time since the start, s.
    pub fn seconds(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    /// Whether the user asked for the end.
    pub fn cancelled(&self) -> bool {
        self.cancelled.is_some_and(|flag| flag.load(Ordering::Relaxed))
    }

    /// Whether the time is up.
    pub fn up(&self) -> bool {
        self.limit.is_some_and(|limit| self.start.elapsed() >= limit)
    }

    /// Why a search that was ended from outside was.
    pub fn stop(&self) -> StopReason {
        if self.cancelled() { StopReason::Cancelled } else { StopReason::TimeLimit }
    }
}

/// A lower level as the upper level sees it, with a clock.
pub(super) struct Timed<'a, L> {
    level: &'a L,
    clock: Clock<'a>,
    pub first_feasible_after: Option<f64>,
    /// Whether only what is wanted is certified, once there is a certified candidate.
    on_demand: bool,
    error: Option<Error>,
}

impl<'a, L> Timed<'a, L> {
    pub fn new(level: &'a L, clock: Clock<'a>) -> Self {
        Timed { level, clock, first_feasible_after: None, on_demand: false, error: None }
    }

    /// Once there is a certified candidate, the caller certifies what it wants.
    pub fn on_demand(self) -> Self {
        Timed { on_demand: true, ..self }
    }

    /// What the lower level could not do.
    pub fn check(&mut self) -> Result<()> {
        self.error.take().map_or(Ok(()), Err)
    }
}

impl<L: LowerLevel> Evaluator for Timed<'_, L> {
    type Solution = L::Solution;

    fn evaluate(&mut self, _generation: usize, schedules: &[Schedule], first_feasible: bool) -> Vec<Option<(Evaluation, L::Solution)>> {
        let (before, clock) = (self.clock.seconds(), self.clock);
        // The first generation is solved whatever the time: a search without a candidate has nothing to return.
        let ends = |timed: bool| clock.cancelled() || (timed && clock.up());
        let timed = self.first_feasible_after.is_some();
        let ends = || ends(timed);
        let results = if self.on_demand && timed && !first_feasible {
            self.level.solve_alone(schedules, &ends)
        } else {
            self.level.solve(schedules, first_feasible, &ends)
        };
        let results = results.unwrap_or_else(|e| {
            self.error = Some(e);
            schedules.iter().map(|_| None).collect()
        });
        let feasible = results.iter().flatten().filter(|r| r.evaluation.feasible).map(|r| before + r.finished_after);
        self.first_feasible_after = self.first_feasible_after.or_else(|| feasible.reduce(f64::min));
        // Which candidates were solved before the time was up depends on the machine: then none of the generation counts.
        let cut = timed && clock.up() && !clock.cancelled() && !first_feasible && results.iter().any(Option::is_none);
        results.into_iter().map(|r| r.filter(|_| !cut).map(|r| (r.evaluation, r.solution))).collect()
    }

    fn cancelled(&self) -> bool {
        self.error.is_some() || self.clock.cancelled() || self.clock.up()
    }
}

/// How a search by the paper's loop alone ended.
#[derive(Debug)]
pub struct Found<S = Evaluated> {
    /// The feasible gait that ended the search, or the best candidate; `None` only when nothing was evaluated.
    pub best: Option<Candidate<S>>,
    /// One record a generation.
    pub generations: Vec<GenerationRecord>,
    /// Why it ended.
    pub stop: StopReason,
    /// Time from the start to the end of the first certification that succeeded, s.
    pub first_feasible_after: Option<f64>,
    /// Time of the whole search, s.
    pub seconds: f64,
}

/// The paper's loop \[1\] over a distribution, with any lower level.
///
/// # Errors
/// [`Error::Invalid`] for settings out of their limits, and what the lower level says.
pub fn search_with<L: LowerLevel, D: Distribution>(
    level: &L,
    distribution: D,
    settings: &CemSettings,
    seed: u64,
    cancelled: &AtomicBool,
    progress: &mut dyn FnMut(&GenerationRecord),
) -> Result<Found<L::Solution>> {
    let clock = Clock::new(Some(cancelled), None);
    let mut level = Timed::new(level, clock);
    let outcome = run(settings, distribution, seed, 0, &mut level, progress)?;
    level.check()?;
    Ok(Found {
        best: outcome.best,
        generations: outcome.generations,
        stop: outcome.stop,
        first_feasible_after: level.first_feasible_after,
        seconds: clock.seconds(),
    })
}
