//! Who solves the schedules of a search, and the clock beside it.

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

    /// Checks that a schedule can be solved at all.
    ///
    /// # Errors
    /// What is wrong with it.
    fn check(&self, _schedule: &Schedule) -> Result<()> {
        Ok(())
    }

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
    /// Whether any candidate was evaluated.
    begun: bool,
    certified: Certified,
    /// Solutions that are kept of a generation.
    kept: usize,
    error: Option<Error>,
}

impl<'a, L> Timed<'a, L> {
    pub fn new(level: &'a L, clock: Clock<'a>) -> Self {
        Timed { level, clock, first_feasible_after: None, begun: false, certified: Certified::All, kept: KEPT, error: None }
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
    pub fn failure(&mut self) -> Result<()> {
        self.error.take().map_or(Ok(()), Err)
    }
}

impl<L: LowerLevel> Timed<'_, L> {
    /// Which candidates of a generation are needed, as far as answers say.
    fn needed(&self, aim: &Aim, answers: &[Option<Answer<L::Solution>>]) -> Needed {
        // Who certifies afterwards may want what is behind all elites, when they do not hold.
        let all = self.certified == Certified::OnDemand && !aim.first_feasible;
        let most = (0..answers.len()).map(|index| aim.most(index)).collect();
        let needed = Needed::new(most, if all { usize::MAX } else { aim.enough });
        for (index, (evaluation, _)) in answers.iter().enumerate().filter_map(|(index, answer)| Some((index, answer.as_ref()?))) {
            note(&needed, aim, index, evaluation);
        }
        needed
    }

    /// Solves the candidates of a generation that are open, as long as they are needed. Returns what is known of each.
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
        // Where the first one in the order of draws ends the search, it is the time of that one.
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
        // The first generation is solved whatever the time: a search without a candidate has nothing to return.
        let timed = std::mem::replace(&mut self.begun, true);
        let found = self.first_feasible_after.is_some();
        let certify = if self.certified != Certified::All && found && !aim.first_feasible { Certify::Unsolved } else { Certify::All };
        let mut answers: Vec<Option<Answer<L::Solution>>> = nothing();
        let mut solved = vec![false; schedules.len()];
        // Once more where certificates do not hold: what is behind them may be needed then.
        loop {
            let needed = self.needed(aim, &answers);
            // Until there is a gait, in the order of draws: what may be worth most is the least likely to be found.
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
            // Which candidates were solved before the time was up depends on the machine: then none of the generation counts.
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

/// Takes note of a candidate that was evaluated.
fn note(needed: &Needed, aim: &Aim, index: usize, evaluation: &Evaluation) {
    if evaluation.feasible {
        needed.note(index, aim.counts(index, evaluation));
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
    level.failure()?;
    Ok(Found {
        best: outcome.best,
        generations: outcome.generations,
        stop: outcome.stop,
        first_feasible_after: level.first_feasible_after,
        seconds: clock.seconds(),
    })
}
