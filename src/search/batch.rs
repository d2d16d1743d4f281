//! Who solves the schedules of a search, and the clock beside it.

use super::cem::{
    Answer, Candidate, CemSettings, Distribution, Evaluation, Evaluator, GenerationRecord, StopReason, Worth, rank_order, run,
};
use super::evaluate::{Certify, Evaluated, LowerSettings, Needed, batch};
use super::population::{KEPT, Population};
use crate::backend::{Backend, locked};
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::gait::cost::CostWeights;
use crate::task::Task;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
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
    type Solution: Send;

    /// Solves schedules, and hands over each when it is solved, in any order and from any thread.
    ///
    /// * `certify` - which of them have to be certified; more may be
    /// * `skip` - asked before and during the solve of a candidate whether to drop it
    ///
    /// # Errors
    /// What keeps it from solving any.
    fn solve(
        &self,
        schedules: &[Schedule],
        certify: Certify,
        skip: &(dyn Fn(usize) -> bool + Sync),
        finish: &(dyn Fn(usize, Solved<Self::Solution>) + Sync),
    ) -> Result<()>;

    /// Schedules that were solved before, solved again; `None` where that fails.
    fn again(&self, schedules: &[Schedule], certify: Certify) -> Vec<Option<Solved<Self::Solution>>> {
        let again: Vec<Mutex<Option<Solved<Self::Solution>>>> = schedules.iter().map(|_| Mutex::new(None)).collect();
        let done = self.solve(schedules, certify, &|_| false, &|index, solved| *locked(&again[index]) = Some(solved));
        again.iter().map(|solved| locked(solved).take().filter(|_| done.is_ok())).collect()
    }

    /// As [`LowerLevel::again`], of one schedule and certified.
    fn certified_again(&self, schedule: &Schedule) -> Option<Solved<Self::Solution>> {
        self.again(std::slice::from_ref(schedule), Certify::All).pop().flatten()
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

/// What of a generation is certified, once there is a certified candidate.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Certified {
    /// All.
    All,
    /// What the caller wants, by itself.
    OnDemand,
    /// What would be the best so far, in order, until a certificate holds.
    Best {
        /// Objective of the best so far.
        objective: f64,
    },
}

/// A lower level as the upper level sees it, with a clock.
pub(super) struct Timed<'a, L> {
    level: &'a L,
    clock: Clock<'a>,
    pub first_feasible_after: Option<f64>,
    certified: Certified,
    /// Solutions that are kept of a generation.
    kept: usize,
    error: Option<Error>,
}

impl<'a, L> Timed<'a, L> {
    pub fn new(level: &'a L, clock: Clock<'a>) -> Self {
        Timed { level, clock, first_feasible_after: None, certified: Certified::All, kept: KEPT, error: None }
    }

    /// Once there is a certified candidate, the caller certifies what it wants.
    pub fn on_demand(self) -> Self {
        Timed { certified: Certified::OnDemand, ..self }
    }

    /// Once there is a certified candidate, only what would be the best so far is certified.
    pub fn best_alone(self) -> Self {
        Timed { certified: Certified::Best { objective: f64::NEG_INFINITY }, ..self }
    }

    /// Keeps this many solutions of a generation.
    pub fn keeping(self, kept: usize) -> Self {
        Timed { kept, ..self }
    }

    /// What the lower level could not do.
    pub fn check(&mut self) -> Result<()> {
        self.error.take().map_or(Ok(()), Err)
    }
}

impl<L: LowerLevel> Evaluator for Timed<'_, L> {
    type Solution = L::Solution;

    fn evaluate(
        &mut self,
        _generation: usize,
        schedules: &[Schedule],
        first_feasible: bool,
        worth: Worth,
    ) -> Vec<Option<Answer<L::Solution>>> {
        let (before, clock) = (self.clock.seconds(), self.clock);
        // The first generation is solved whatever the time: a search without a candidate has nothing to return.
        let timed = self.first_feasible_after.is_some();
        let certify = if self.certified != Certified::All && timed && !first_feasible { Certify::Unsolved } else { Certify::All };
        let needed = Needed::new(first_feasible);
        let skip = |index: usize| clock.cancelled() || (timed && clock.up()) || !needed.has(index);
        let population = Mutex::new(Population::new(schedules.len(), self.kept));
        let solved = self.level.solve(schedules, certify, &skip, &|index, solved| {
            needed.note(index, solved.evaluation.feasible);
            let objective = worth(index, &solved.evaluation);
            locked(&population).add(index, objective, solved);
        });
        if let Err(error) = solved {
            self.error = Some(error);
            return schedules.iter().map(|_| None).collect();
        }
        let mut population = population.into_inner().unwrap_or_else(PoisonError::into_inner);
        population.retain(|index| needed.has(index));
        self.first_feasible_after = self.first_feasible_after.or(population.first_feasible_after().map(|after| before + after));
        let mut answers = population.answers();
        if let Certified::Best { objective } = &mut self.certified {
            *objective = certify_best(self.level, schedules, &mut answers, worth, *objective);
        }
        // Which candidates were solved before the time was up depends on the machine: then none of the generation counts.
        let cut = timed && clock.up() && !clock.cancelled() && !first_feasible && answers.iter().any(Option::is_none);
        if cut { schedules.iter().map(|_| None).collect() } else { answers }
    }

    fn again(&mut self, schedule: &Schedule) -> Option<L::Solution> {
        self.level.certified_again(schedule).map(|solved| solved.solution)
    }

    fn cancelled(&self) -> bool {
        self.error.is_some() || self.clock.cancelled() || self.clock.up()
    }
}

/// Certifies candidates of a generation, best first, until one holds or is no better than the best so far. Those whose certificate does not
/// hold are violated from then on.
///
/// * `objective` - of the best so far
///
/// Returns the objective of the best, this generation included.
fn certify_best<L: LowerLevel>(
    level: &L,
    schedules: &[Schedule],
    answers: &mut [Option<Answer<L::Solution>>],
    worth: Worth,
    objective: f64,
) -> f64 {
    loop {
        let evaluations = answers.iter().enumerate().filter_map(|(index, answer)| Some((index, &answer.as_ref()?.0)));
        let best = evaluations.map(|(index, said)| ((worth(index, said), index), said)).min_by(|(a, _), (b, _)| rank_order(*a, *b));
        let Some(((value, index), evaluation)) = best else { return objective };
        if evaluation.certified || value <= objective {
            return objective.max(value);
        }
        answers[index] = level.certified_again(&schedules[index]).map(|solved| (solved.evaluation, Some(Box::new(solved.solution))));
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
    let mut level = Timed::new(level, clock).best_alone();
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
