//! Evaluation of generations under a clock: decides which candidates are solved and certified, and ends on cancellation or a time limit.

use super::batch::ScheduleSolver;
use super::cem::{
    Candidate, CemSettings, Distribution, Evaluation, GenerationEvaluator, GenerationRecord, GenerationResults, SelectionGoal, StopReason,
    rank_order, run,
};
use super::evaluate::{Certify, Evaluated};
use super::needed::NeededCandidates;
use super::population::{MAX_SOLUTIONS, Population};
use crate::backend::locked;
use crate::error::{Error, Result};
use crate::gait::Schedule;
use std::borrow::Cow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Start time of a search and its external end conditions: cancellation and time limit.
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

    /// True if the caller cancelled the search.
    pub fn cancelled(&self) -> bool {
        self.cancelled.is_some_and(|flag| flag.load(Ordering::Relaxed))
    }

    /// True if the time limit is reached.
    pub fn expired(&self) -> bool {
        self.limit.is_some_and(|limit| self.start.elapsed() >= limit)
    }

    /// True if the search must end.
    pub fn over(&self) -> bool {
        self.cancelled() || self.expired()
    }

    /// Reason for the end of a search that an external condition ended.
    pub fn stop_reason(&self) -> StopReason {
        if self.cancelled() { StopReason::Cancelled } else { StopReason::TimeLimit }
    }
}

/// Policy that decides which candidates of a generation are certified once a certified candidate exists.
#[derive(Debug, Clone, Copy, PartialEq)]
enum CertificationPolicy {
    /// Every candidate.
    All,
    /// No candidate: the caller certifies those that it selects.
    OnDemand,
    /// Candidates that would be the best so far, best first, until a certificate is valid.
    Improvements {
        /// Objective of the best certified candidate so far.
        objective: f64,
    },
}

/// Evaluator of generations with a schedule solver, a clock and a certification policy.
pub(super) struct TimedEvaluator<'a, S> {
    solver: &'a S,
    clock: Clock<'a>,
    /// Time from the start of the search to the end of the first successful certification, s.
    pub first_feasible_after: Option<f64>,
    /// True once a generation was evaluated.
    begun: bool,
    policy: CertificationPolicy,
    /// Number of solutions kept per generation.
    max_solutions: usize,
    error: Option<Error>,
}

impl<'a, S> TimedEvaluator<'a, S> {
    /// An evaluator that certifies every candidate.
    pub fn new(solver: &'a S, clock: Clock<'a>) -> Self {
        let policy = CertificationPolicy::All;
        TimedEvaluator { solver, clock, first_feasible_after: None, begun: false, policy, max_solutions: MAX_SOLUTIONS, error: None }
    }

    /// Selects on-demand certification: once a certified candidate exists, the caller certifies those that it selects.
    pub fn certifying_on_demand(self) -> Self {
        TimedEvaluator { policy: CertificationPolicy::OnDemand, ..self }
    }

    /// Selects certification of improvements: once a certified candidate exists, only those that would be the best so far are certified.
    pub fn certifying_improvements(self) -> Self {
        TimedEvaluator { policy: CertificationPolicy::Improvements { objective: f64::NEG_INFINITY }, ..self }
    }

    /// Sets the number of solutions kept per generation.
    pub fn max_solutions(self, max_solutions: usize) -> Self {
        TimedEvaluator { max_solutions, ..self }
    }

    /// Returns and clears the error of the solver.
    pub fn take_error(&mut self) -> Result<()> {
        self.error.take().map_or(Ok(()), Err)
    }
}

impl<S: ScheduleSolver> TimedEvaluator<'_, S> {
    /// Candidates of a generation that are needed, given the results so far.
    fn needed(&self, goal: &SelectionGoal, results: &GenerationResults<S::Solution>) -> NeededCandidates {
        // With on-demand certification every candidate may be needed, because the elites can fail their certificates.
        let all = self.policy == CertificationPolicy::OnDemand && !goal.first_feasible;
        let bounds = (0..results.len()).map(|index| goal.upper_bound(index)).collect();
        let needed = NeededCandidates::new(bounds, if all { usize::MAX } else { goal.enough });
        for (index, (evaluation, _)) in results.iter().enumerate().filter_map(|(index, result)| Some((index, result.as_ref()?))) {
            record(&needed, goal, index, evaluation);
        }
        needed
    }

    /// Solves the open candidates of a generation that are needed. Returns the result of each.
    ///
    /// * `open` - indices of the candidates in `schedules`, in the order of solving
    /// * `limited` - true if the time limit applies
    fn solve(
        &mut self,
        schedules: &[Schedule],
        open: &[usize],
        goal: &SelectionGoal,
        needed: &NeededCandidates,
        (certify, limited): (Certify, bool),
    ) -> Result<GenerationResults<S::Solution>> {
        let clock = self.clock;
        let skip = |at: usize| clock.cancelled() || (limited && clock.expired()) || !needed.contains(open[at]);
        let population = Mutex::new(Population::new(open.len(), self.max_solutions));
        let in_order = open.len() == schedules.len() && open.is_sorted();
        let schedules = if in_order { Cow::Borrowed(schedules) } else { open.iter().map(|&index| schedules[index].clone()).collect() };
        self.solver.solve(&schedules, certify, &skip, &|at, evaluation, solution| {
            record(needed, goal, open[at], &evaluation);
            let objective = goal.objective(open[at], &evaluation);
            let seconds = clock.seconds();
            locked(&population).add(at, objective, seconds, evaluation, solution);
        })?;
        let mut population = population.into_inner().unwrap_or_else(PoisonError::into_inner);
        let first = population.first_feasible_after();
        population.retain(|at| needed.contains(open[at]));
        // If the first feasible candidate in the order of draws ends the search, its time counts.
        let first = if goal.first_feasible { population.first_feasible_after() } else { first };
        self.first_feasible_after = self.first_feasible_after.or(first);
        Ok(population.results())
    }
}

impl<S: ScheduleSolver> GenerationEvaluator for TimedEvaluator<'_, S> {
    type Solution = S::Solution;

    fn check(&self, schedule: &Schedule) -> Result<()> {
        self.solver.check(schedule)
    }

    fn evaluate(&mut self, _generation: usize, schedules: &[Schedule], goal: &SelectionGoal) -> GenerationResults<S::Solution> {
        let nothing = || schedules.iter().map(|_| None).collect();
        // The time limit does not apply to the first generation: a search without a candidate has nothing to return.
        let limited = std::mem::replace(&mut self.begun, true);
        let found = self.first_feasible_after.is_some();
        let all = self.policy == CertificationPolicy::All || !found || goal.first_feasible;
        let certify = if all { Certify::All } else { Certify::Unsolved };
        let mut results: GenerationResults<S::Solution> = nothing();
        let mut solved = vec![false; schedules.len()];
        // Repeats if certificates fail, because lower-ranked candidates may be needed then.
        loop {
            let needed = self.needed(goal, &results);
            // In the order of draws until a gait exists: the schedules with the best bounds are the least likely to be feasible.
            let mut open = if found { needed.solve_order() } else { (0..results.len()).collect() };
            open.retain(|&index| !solved[index] && needed.contains(index));
            if open.is_empty() {
                return results;
            }
            let new = match self.solve(schedules, &open, goal, &needed, (certify, limited)) {
                Ok(new) => new,
                Err(error) => {
                    self.error = Some(error);
                    return nothing();
                }
            };
            for (&index, result) in open.iter().zip(new) {
                solved[index] = result.is_some();
                results[index] = result;
            }
            let ended = open.iter().any(|&index| !solved[index] && needed.contains(index));
            // The machine decides which candidates were solved before the time limit, so the whole generation is discarded.
            if ended && limited && self.clock.expired() && !self.clock.cancelled() {
                return nothing();
            }
            if let CertificationPolicy::Improvements { objective } = &mut self.policy {
                *objective = certify_improvements(self.solver, schedules, &mut results, goal, *objective);
            }
            if ended {
                return results;
            }
        }
    }

    fn solve_again(&mut self, schedule: &Schedule) -> Option<S::Solution> {
        self.solver.certify_again(schedule).map(|(_, solution)| solution)
    }

    fn cancelled(&self) -> bool {
        self.error.is_some() || self.clock.over()
    }
}

/// Registers an evaluated candidate if it is feasible.
fn record(needed: &NeededCandidates, goal: &SelectionGoal, index: usize, evaluation: &Evaluation) {
    if evaluation.feasible {
        needed.record(index, goal.competing_value(index, evaluation));
    }
}

/// Certifies candidates of a generation, best first, until a certificate is valid or the next candidate is no better than the best so far.
/// Replaces the results of the candidates that it certifies.
///
/// * `objective` - objective of the best certified candidate so far
///
/// Returns the objective of the best certified candidate, including this generation.
fn certify_improvements<S: ScheduleSolver>(
    solver: &S,
    schedules: &[Schedule],
    results: &mut GenerationResults<S::Solution>,
    goal: &SelectionGoal,
    objective: f64,
) -> f64 {
    loop {
        let evaluations = results.iter().enumerate().filter_map(|(index, result)| Some((index, &result.as_ref()?.0)));
        let ranked = evaluations.map(|(index, evaluation)| ((goal.objective(index, evaluation), index), evaluation));
        let Some(((value, index), evaluation)) = ranked.min_by(|(a, _), (b, _)| rank_order(*a, *b)) else { return objective };
        if evaluation.certified || value <= objective {
            return objective.max(value);
        }
        results[index] = solver.certify_again(&schedules[index]).map(|(evaluation, solution)| (evaluation, Some(Box::new(solution))));
    }
}

/// Result of [`search_with`].
#[derive(Debug)]
pub struct CemSearchResult<S = Evaluated> {
    /// Feasible gait that ended the search, or the best candidate; `None` only if no candidate was evaluated.
    pub best: Option<Candidate<S>>,
    /// Statistics of each generation.
    pub generations: Vec<GenerationRecord>,
    /// Reason for the end.
    pub stop: StopReason,
    /// Time from the start to the end of the first successful certification, s.
    pub first_feasible_after: Option<f64>,
    /// Total time of the search, s.
    pub seconds: f64,
}

/// Runs the cross-entropy loop of the paper \[1\] over a distribution with any solver.
///
/// # Errors
/// [`Error::Invalid`] for settings outside their limits; errors of the solver.
pub fn search_with<S: ScheduleSolver, D: Distribution>(
    solver: &S,
    distribution: D,
    settings: &CemSettings,
    seed: u64,
    cancelled: &AtomicBool,
    progress: &mut dyn FnMut(&GenerationRecord),
) -> Result<CemSearchResult<S::Solution>> {
    let clock = Clock::new(Some(cancelled), None);
    let mut evaluator = TimedEvaluator::new(solver, clock).certifying_improvements();
    let outcome = run(settings, distribution, seed, 0, &mut evaluator, progress)?;
    evaluator.take_error()?;
    Ok(CemSearchResult {
        best: outcome.best,
        generations: outcome.generations,
        stop: outcome.stop,
        first_feasible_after: evaluator.first_feasible_after,
        seconds: clock.seconds(),
    })
}
