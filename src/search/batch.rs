//! Lower level of the search: solves the schedules of a generation, with a clock and a certification policy.

use super::cem::{Aim, Answer, Candidate, CemSettings, Distribution, Evaluation, Evaluator, GenerationRecord, StopReason, rank_order, run};
use super::evaluate::{Certify, Evaluated, LowerSettings, Needed, batch, check_candidate};
use super::population::{KEPT, Population};
use crate::backend::{Backend, locked};
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::gait::cost::CostWeights;
use crate::task::Task;
use std::borrow::Cow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// One candidate solved by a [`LowerLevel`].
#[derive(Debug)]
pub struct Solved<S> {
    /// Evaluation for the upper level.
    pub evaluation: Evaluation,
    /// Time from the start of its batch, s.
    pub finished_after: f64,
    /// Solution.
    pub solution: S,
}

/// Solver of schedules: the solver of this crate ([`BatchSolver`]) or another one for comparison.
pub trait LowerLevel {
    /// Solution of a candidate.
    type Solution: Send;

    /// Checks that a schedule can be solved.
    ///
    /// # Errors
    /// Describes why the schedule cannot be solved.
    fn check(&self, _schedule: &Schedule) -> Result<()> {
        Ok(())
    }

    /// Solves schedules and passes each result to `finish`, in any order and from any thread.
    ///
    /// * `certify` - candidates that must be certified; the solver may certify more
    /// * `skip` - returns true if a candidate is to be dropped; called before and during its solve
    ///
    /// # Errors
    /// Describes why no schedule could be solved.
    fn solve(
        &self,
        schedules: &[Schedule],
        certify: Certify,
        skip: &(dyn Fn(usize) -> bool + Sync),
        finish: &(dyn Fn(usize, Solved<Self::Solution>) + Sync),
    ) -> Result<()>;

    /// Solves schedules again that were solved before. An entry is `None` if that fails.
    fn again(&self, schedules: &[Schedule], certify: Certify) -> Vec<Option<Solved<Self::Solution>>> {
        let again: Vec<Mutex<Option<Solved<Self::Solution>>>> = schedules.iter().map(|_| Mutex::new(None)).collect();
        let done = self.solve(schedules, certify, &|_| false, &|index, solved| *locked(&again[index]) = Some(solved));
        again.iter().map(|solved| locked(solved).take().filter(|_| done.is_ok())).collect()
    }

    /// Solves one schedule again and certifies it; `None` if that fails.
    fn certified_again(&self, schedule: &Schedule) -> Option<Solved<Self::Solution>> {
        self.again(std::slice::from_ref(schedule), Certify::All).pop().flatten()
    }
}

/// Solver of this crate, with the certificate and, on request, the cost of each motion.
#[derive(Clone, Copy)]
pub struct BatchSolver<'a> {
    /// Task.
    pub task: &'a Task,
    /// Settings of the lower level.
    pub settings: &'a LowerSettings,
    /// Backend that solves the batches.
    pub backend: &'a dyn Backend,
    /// Weights of the cost of transport; `None`: no cost is computed.
    pub cost: Option<&'a CostWeights>,
}

impl LowerLevel for BatchSolver<'_> {
    type Solution = Evaluated;

    fn check(&self, schedule: &Schedule) -> Result<()> {
        check_candidate(self.task, schedule, self.settings)
    }

    fn solve(
        &self,
        schedules: &[Schedule],
        certify: Certify,
        skip: &(dyn Fn(usize) -> bool + Sync),
        finish: &(dyn Fn(usize, Solved<Evaluated>) + Sync),
    ) -> Result<()> {
        let candidates: Vec<(&Task, &Schedule)> = schedules.iter().map(|s| (self.task, s)).collect();
        let solved = |r: Evaluated| Solved { evaluation: r.evaluation(), finished_after: r.finished_after, solution: r };
        batch(&candidates, self.settings, self.cost, self.backend, certify, skip, &|index, r| finish(index, solved(r)))
    }
}

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
    pub fn up(&self) -> bool {
        self.limit.is_some_and(|limit| self.start.elapsed() >= limit)
    }

    /// Reason for the end of a search that an external condition ended.
    pub fn stop(&self) -> StopReason {
        if self.cancelled() { StopReason::Cancelled } else { StopReason::TimeLimit }
    }
}

/// Policy that decides which candidates of a generation are certified once a certified candidate exists.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Certified {
    /// Every candidate.
    All,
    /// No candidate: the caller certifies those that it selects.
    OnDemand,
    /// Candidates that would be the best so far, best first, until a certificate is valid.
    Best {
        /// Objective of the best certified candidate so far.
        objective: f64,
    },
}

/// Lower level with a clock and a certification policy, as the cross-entropy loop uses it.
pub(super) struct Timed<'a, L> {
    level: &'a L,
    clock: Clock<'a>,
    pub first_feasible_after: Option<f64>,
    /// True once a generation was evaluated.
    begun: bool,
    certified: Certified,
    /// Number of solutions kept per generation.
    kept: usize,
    error: Option<Error>,
}

impl<'a, L> Timed<'a, L> {
    pub fn new(level: &'a L, clock: Clock<'a>) -> Self {
        Timed { level, clock, first_feasible_after: None, begun: false, certified: Certified::All, kept: KEPT, error: None }
    }

    /// Selects on-demand certification: once a certified candidate exists, the caller certifies those that it selects.
    pub fn on_demand(self) -> Self {
        Timed { certified: Certified::OnDemand, ..self }
    }

    /// Selects certification of improvements: once a certified candidate exists, only those that would be the best so far are certified.
    pub fn best_alone(self) -> Self {
        Timed { certified: Certified::Best { objective: f64::NEG_INFINITY }, ..self }
    }

    /// Sets the number of solutions kept per generation.
    pub fn keeping(self, kept: usize) -> Self {
        Timed { kept, ..self }
    }

    /// Returns and clears the error of the lower level.
    pub fn failure(&mut self) -> Result<()> {
        self.error.take().map_or(Ok(()), Err)
    }
}

impl<L: LowerLevel> Timed<'_, L> {
    /// Candidates of a generation that are needed, given the answers so far.
    fn needed(&self, aim: &Aim, answers: &[Option<Answer<L::Solution>>]) -> Needed {
        // With on-demand certification every candidate may be needed, because the elites can fail their certificates.
        let all = self.certified == Certified::OnDemand && !aim.first_feasible;
        let most = (0..answers.len()).map(|index| aim.most(index)).collect();
        let needed = Needed::new(most, if all { usize::MAX } else { aim.enough });
        for (index, (evaluation, _)) in answers.iter().enumerate().filter_map(|(index, answer)| Some((index, answer.as_ref()?))) {
            note(&needed, aim, index, evaluation);
        }
        needed
    }

    /// Solves the open candidates of a generation that are needed. Returns the answer for each.
    fn solve(
        &mut self,
        schedules: &[Schedule],
        open: &[usize],
        aim: &Aim,
        needed: &Needed,
        (certify, timed): (Certify, bool),
    ) -> Result<Vec<Option<Answer<L::Solution>>>> {
        let (before, clock) = (self.clock.seconds(), self.clock);
        let skip = |at: usize| clock.cancelled() || (timed && clock.up()) || !needed.has(open[at]);
        let population = Mutex::new(Population::new(open.len(), self.kept));
        let in_order = open.len() == schedules.len() && open.is_sorted();
        let schedules = if in_order { Cow::Borrowed(schedules) } else { open.iter().map(|&index| schedules[index].clone()).collect() };
        self.level.solve(&schedules, certify, &skip, &|at, solved| {
            note(needed, aim, open[at], &solved.evaluation);
            let objective = aim.worth(open[at], &solved.evaluation);
            locked(&population).add(at, objective, solved);
        })?;
        let mut population = population.into_inner().unwrap_or_else(PoisonError::into_inner);
        let first = population.first_feasible_after();
        population.retain(|at| needed.has(open[at]));
        // If the first feasible candidate in the order of draws ends the search, its time counts.
        let first = if aim.first_feasible { population.first_feasible_after() } else { first };
        self.first_feasible_after = self.first_feasible_after.or(first.map(|after| before + after));
        Ok(population.answers())
    }
}

impl<L: LowerLevel> Evaluator for Timed<'_, L> {
    type Solution = L::Solution;

    fn check(&self, schedule: &Schedule) -> Result<()> {
        self.level.check(schedule)
    }

    fn evaluate(&mut self, _generation: usize, schedules: &[Schedule], aim: &Aim) -> Vec<Option<Answer<L::Solution>>> {
        let nothing = || schedules.iter().map(|_| None).collect();
        // The time limit does not apply to the first generation: a search without a candidate has nothing to return.
        let timed = std::mem::replace(&mut self.begun, true);
        let found = self.first_feasible_after.is_some();
        let certify = if self.certified != Certified::All && found && !aim.first_feasible { Certify::Unsolved } else { Certify::All };
        let mut answers: Vec<Option<Answer<L::Solution>>> = nothing();
        let mut solved = vec![false; schedules.len()];
        // Repeats if certificates fail, because lower-ranked candidates may be needed then.
        loop {
            let needed = self.needed(aim, &answers);
            // In the order of draws until a gait exists: the schedules with the best bounds are the least likely to be feasible.
            let mut open = if found { needed.order() } else { (0..answers.len()).collect() };
            open.retain(|&index| !solved[index] && needed.has(index));
            if open.is_empty() {
                return answers;
            }
            let found = match self.solve(schedules, &open, aim, &needed, (certify, timed)) {
                Ok(found) => found,
                Err(error) => {
                    self.error = Some(error);
                    return nothing();
                }
            };
            for (&index, answer) in open.iter().zip(found) {
                solved[index] = answer.is_some();
                answers[index] = answer;
            }
            let ended = open.iter().any(|&index| !solved[index] && needed.has(index));
            // The machine decides which candidates were solved before the time limit, so the whole generation is discarded.
            if ended && timed && self.clock.up() && !self.clock.cancelled() {
                return nothing();
            }
            if let Certified::Best { objective } = &mut self.certified {
                *objective = certify_best(self.level, schedules, &mut answers, aim, *objective);
            }
            if ended {
                return answers;
            }
        }
    }

    fn again(&mut self, schedule: &Schedule) -> Option<L::Solution> {
        self.level.certified_again(schedule).map(|solved| solved.solution)
    }

    fn cancelled(&self) -> bool {
        self.error.is_some() || self.clock.cancelled() || self.clock.up()
    }
}

/// Registers an evaluated candidate.
fn note(needed: &Needed, aim: &Aim, index: usize, evaluation: &Evaluation) {
    if evaluation.feasible {
        needed.note(index, aim.counts(index, evaluation));
    }
}

/// Certifies candidates of a generation, best first, until a certificate is valid or the next candidate is no better than the best so far.
/// Replaces the answers of the candidates that it certifies.
///
/// * `objective` - objective of the best certified candidate so far
///
/// Returns the objective of the best certified candidate, including this generation.
fn certify_best<L: LowerLevel>(
    level: &L,
    schedules: &[Schedule],
    answers: &mut [Option<Answer<L::Solution>>],
    aim: &Aim,
    objective: f64,
) -> f64 {
    loop {
        let evaluations = answers.iter().enumerate().filter_map(|(index, answer)| Some((index, &answer.as_ref()?.0)));
        let best = evaluations.map(|(index, said)| ((aim.worth(index, said), index), said)).min_by(|(a, _), (b, _)| rank_order(*a, *b));
        let Some(((value, index), evaluation)) = best else { return objective };
        if evaluation.certified || value <= objective {
            return objective.max(value);
        }
        answers[index] = level.certified_again(&schedules[index]).map(|solved| (solved.evaluation, Some(Box::new(solved.solution))));
    }
}

/// Result of [`search_with`].
#[derive(Debug)]
pub struct Found<S = Evaluated> {
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

/// Runs the cross-entropy loop of the paper \[1\] over a distribution with any lower level.
///
/// # Errors
/// [`Error::Invalid`] for settings outside their limits; errors of the lower level.
pub fn search_with<L: LowerLevel, D: Distribution>(
    level: &L,
    distribution: D,
    settings: &CemSettings,
    seed: u64,
    cancelled: &AtomicBool,
    progress: &mut dyn FnMut(&GenerationRecord),
) -> Result<Found<L::Solution>> {
    let clock = Clock::new(Some(cancelled), None);
    let mut level = Timed::new(level, clock).best_alone();
    let outcome = run(settings, distribution, seed, 0, &mut level, progress)?;
    level.failure()?;
    Ok(Found {
        best: outcome.best,
        generations: outcome.generations,
        stop: outcome.stop,
        first_feasible_after: level.first_feasible_after,
        seconds: clock.seconds(),
    })
}
