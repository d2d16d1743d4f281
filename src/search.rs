//! The whole search: cross-entropy over schedules, with the batched solver below.

use crate::backend::Backend;
use crate::cem::{self, Candidate, CemSettings, Evaluate, Evaluation, GenerationRecord, StopReason};
use crate::error::{Error, Result};
use crate::evaluate::{Evaluated, LowerSettings, evaluate};
use crate::gait::Schedule;
use crate::task::Task;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// How a search ended.
#[derive(Debug)]
pub struct Found {
    /// The feasible gait that ended the search, or the best candidate; `None` only when nothing was evaluated.
    pub best: Option<Candidate<Evaluated>>,
    /// One record a generation.
    pub generations: Vec<GenerationRecord>,
    /// Why it ended.
    pub stop: StopReason,
    /// Time from the start to the end of the first certification that succeeded, s.
    pub first_feasible_after: Option<f64>,
    /// Time of the whole search, s.
    pub seconds: f64,
}

/// The lower level as the upper level sees it.
struct Lower<'a> {
    task: &'a Task,
    settings: &'a LowerSettings,
    backend: &'a dyn Backend,
    cancelled: &'a AtomicBool,
    start: Instant,
    first_feasible_after: Option<f64>,
    error: Option<Error>,
}

impl Evaluate for Lower<'_> {
    type Solution = Evaluated;

    fn evaluate(&mut self, _generation: usize, schedules: &[Schedule], first_feasible: bool) -> Vec<Option<(Evaluation, Evaluated)>> {
        let before = self.start.elapsed().as_secs_f64();
        let candidates: Vec<(&Task, &Schedule)> = schedules.iter().map(|s| (self.task, s)).collect();
        let results = evaluate(&candidates, self.settings, self.backend, first_feasible, self.cancelled).unwrap_or_else(|e| {
            self.error = Some(e);
            schedules.iter().map(|_| None).collect()
        });
        let feasible = results.iter().flatten().filter(|r| r.feasible).map(|r| before + r.finished_after);
        self.first_feasible_after = self.first_feasible_after.or_else(|| feasible.reduce(f64::min));
        let evaluation =
            |r: &Evaluated| Evaluation { n_violated: r.n_violated, feasible: r.feasible, mean_normal_force: r.mean_normal_force };
        results.into_iter().map(|r| r.map(|r| (evaluation(&r), r))).collect()
    }

    fn cancelled(&self) -> bool {
        self.error.is_some() || self.cancelled.load(Ordering::Relaxed)
    }
}

/// Searches for a gait. The same seed gives the same gait at any number of threads.
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
    task.validate()?;
    lower.validate()?;
    let start = Instant::now();
    let mut level = Lower { task, settings: lower, backend, cancelled, start, first_feasible_after: None, error: None };
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
