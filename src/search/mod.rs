//! The whole search: cross-entropy over schedules, with a lower level that solves each.

pub mod atlas;
pub mod cem;
pub mod evaluate;

use crate::backend::Backend;
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::task::Task;
use cem::{Candidate, CemSettings, Evaluate, Evaluation, GenerationRecord, StopReason};
use evaluate::{Evaluated, LowerSettings, evaluate};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// How a search ended.
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

/// Who solves the schedules: this program's solver ([`Own`]), or another one to compare with.
pub trait LowerLevel {
    /// What is kept of a candidate.
    type Solution;

    /// Solves schedules; the result has their order and number. `first_feasible` and `cancelled` as in [`evaluate()`].
    ///
    /// # Errors
    /// What keeps it from solving any.
    fn solve(&self, schedules: &[Schedule], first_feasible: bool, cancelled: &AtomicBool) -> Result<Vec<Option<Solved<Self::Solution>>>>;
}

/// This program's solver.
#[derive(Clone, Copy)]
pub struct Own<'a> {
    /// The task.
    pub task: &'a Task,
    /// Settings.
    pub settings: &'a LowerSettings,
    /// Where it is solved.
    pub backend: &'a dyn Backend,
}

impl LowerLevel for Own<'_> {
    type Solution = Evaluated;

    fn solve(&self, schedules: &[Schedule], first_feasible: bool, cancelled: &AtomicBool) -> Result<Vec<Option<Solved<Evaluated>>>> {
        let candidates: Vec<(&Task, &Schedule)> = schedules.iter().map(|s| (self.task, s)).collect();
        let results = evaluate(&candidates, self.settings, self.backend, first_feasible, cancelled)?;
        let solved = |r: Evaluated| Solved {
            evaluation: Evaluation { n_violated: r.n_violated, feasible: r.feasible, mean_normal_force: r.mean_normal_force },
            finished_after: r.finished_after,
            solution: r,
        };
        Ok(results.into_iter().map(|r| r.map(solved)).collect())
    }
}

/// A lower level as the upper level sees it, with a clock.
struct Timed<'a, L> {
    level: &'a L,
    cancelled: &'a AtomicBool,
    start: Instant,
    first_feasible_after: Option<f64>,
    error: Option<Error>,
}

impl<L: LowerLevel> Evaluate for Timed<'_, L> {
    type Solution = L::Solution;

    fn evaluate(&mut self, _generation: usize, schedules: &[Schedule], first_feasible: bool) -> Vec<Option<(Evaluation, L::Solution)>> {
        let before = self.start.elapsed().as_secs_f64();
        let results = self.level.solve(schedules, first_feasible, self.cancelled).unwrap_or_else(|e| {
            self.error = Some(e);
            schedules.iter().map(|_| None).collect()
        });
        let feasible = results.iter().flatten().filter(|r| r.evaluation.feasible).map(|r| before + r.finished_after);
        self.first_feasible_after = self.first_feasible_after.or_else(|| feasible.reduce(f64::min));
        results.into_iter().map(|r| r.map(|r| (r.evaluation, r.solution))).collect()
    }

    fn cancelled(&self) -> bool {
        self.error.is_some() || self.cancelled.load(Ordering::Relaxed)
    }
}

/// Searches for a gait with this program's solver. The same seed gives the same gait at any number of threads.
///
/// # Errors
/// [`Error::Invalid`] for settings or candidates out of their limits.
pub fn search(
    task: &Task,
    search: &CemSettings,
    lower: &LowerSettings,
    seed: u64,
    backend: &dyn Backend,
    cancelled: &AtomicBool,
    progress: &mut dyn FnMut(&GenerationRecord),
) -> Result<Found> {
    lower.validate()?;
    search_with(&Own { task, settings: lower, backend }, task, search, seed, cancelled, progress)
}

/// Searches for a gait with any lower level.
///
/// # Errors
/// [`Error::Invalid`] for settings out of their limits, and what the lower level says.
pub fn search_with<L: LowerLevel>(
    level: &L,
    task: &Task,
    search: &CemSettings,
    seed: u64,
    cancelled: &AtomicBool,
    progress: &mut dyn FnMut(&GenerationRecord),
) -> Result<Found<L::Solution>> {
    task.validate()?;
    let start = Instant::now();
    let mut level = Timed { level, cancelled, start, first_feasible_after: None, error: None };
    let outcome = cem::run(search, task.robot.feet(), seed, &mut level, progress)?;
    if let Some(error) = level.error {
        return Err(error);
    }
    Ok(Found {
        best: outcome.best,
        generations: outcome.generations,
        stop: outcome.stop,
        first_feasible_after: level.first_feasible_after,
        seconds: start.elapsed().as_secs_f64(),
    })
}
