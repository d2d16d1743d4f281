//! Lower level of the search: solves batches of schedules.

use super::cem::Evaluation;
use super::evaluate::{Certify, Evaluated, LowerSettings, batch, check_candidate};
use crate::backend::{Backend, locked};
use crate::error::Result;
use crate::gait::Schedule;
use crate::gait::cost::CostWeights;
use crate::task::Task;
use std::sync::Mutex;

/// Solver of batches of schedules: that of this crate ([`BatchSolver`]) or another one for comparison.
///
/// A solver knows nothing of generations. [`GenerationEvaluator`](super::cem::GenerationEvaluator) is the interface on top of it that the
/// cross-entropy loop uses; it decides which schedules of a generation are solved and certified.
pub trait ScheduleSolver {
    /// Solution of a schedule.
    type Solution: Send;

    /// Checks that a schedule can be solved.
    ///
    /// # Errors
    /// Describes why the schedule cannot be solved.
    fn check(&self, _schedule: &Schedule) -> Result<()> {
        Ok(())
    }

    /// Solves schedules and passes index, evaluation and solution of each to `finish`, in any order and from any thread.
    ///
    /// * `certify` - schedules whose motion must be certified; the solver may certify more
    /// * `skip` - returns true if a schedule is to be dropped; called before and during its solve
    ///
    /// # Errors
    /// Describes why no schedule could be solved.
    fn solve(
        &self,
        schedules: &[Schedule],
        certify: Certify,
        skip: &(dyn Fn(usize) -> bool + Sync),
        finish: &(dyn Fn(usize, Evaluation, Self::Solution) + Sync),
    ) -> Result<()>;

    /// Solves schedules again that were solved before. An entry is `None` if that fails.
    fn solve_again(&self, schedules: &[Schedule], certify: Certify) -> Vec<Option<(Evaluation, Self::Solution)>> {
        let results: Vec<_> = schedules.iter().map(|_| Mutex::new(None)).collect();
        let done = self.solve(schedules, certify, &|_| false, &|index, evaluation, solution| {
            *locked(&results[index]) = Some((evaluation, solution));
        });
        results.iter().map(|result| locked(result).take().filter(|_| done.is_ok())).collect()
    }

    /// Solves one schedule again and certifies it; `None` if that fails.
    fn certify_again(&self, schedule: &Schedule) -> Option<(Evaluation, Self::Solution)> {
        self.solve_again(std::slice::from_ref(schedule), Certify::All).pop().flatten()
    }
}

/// Cost after an iteration of the minimisation, relative to that of the best gait so far, above which a candidate is terminated early.
/// Of 627 candidates of seven tasks none lost more than 20.2 % of its cost after the first iteration.
const COST_LIMIT: f64 = 1.25;

/// Cost of the best gait so far. It changes between generations only, so that results do not depend on the order of solves.
#[derive(Debug, Default)]
pub struct Incumbent(Mutex<Option<f64>>);

impl Incumbent {
    /// Sets the cost.
    pub fn set(&self, cost: f64) {
        *locked(&self.0) = Some(cost);
    }

    /// Cost above which a candidate is terminated early, if there is a gait.
    fn limit(&self) -> Option<f64> {
        locked(&self.0).map(|cost| COST_LIMIT * cost)
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
    /// Best gait so far; candidates that cost much more are not minimised to the end. `None`: all are.
    pub incumbent: Option<&'a Incumbent>,
}

impl ScheduleSolver for BatchSolver<'_> {
    type Solution = Evaluated;

    fn check(&self, schedule: &Schedule) -> Result<()> {
        check_candidate(self.task, schedule, self.settings)
    }

    fn solve(
        &self,
        schedules: &[Schedule],
        certify: Certify,
        skip: &(dyn Fn(usize) -> bool + Sync),
        finish: &(dyn Fn(usize, Evaluation, Evaluated) + Sync),
    ) -> Result<()> {
        let candidates: Vec<(&Task, &Schedule)> = schedules.iter().map(|s| (self.task, s)).collect();
        let limited = self.incumbent.and_then(Incumbent::limit).map(|limit| {
            let mut settings = self.settings.clone();
            settings.solver.optimise.cost_limit = Some(limit);
            settings
        });
        batch(&candidates, limited.as_ref().unwrap_or(self.settings), self.cost, self.backend, certify, skip, &|index, result| {
            finish(index, result.evaluation, result);
        })
    }
}
