//! Solution and choice of the candidates.

use super::candidates::Candidate;
use super::warm::Before;
use super::{Cycle, Planner};
use crate::backend::{Backend, locked};
use crate::gait::Trajectory;
use crate::gait::family::GaitFamily;
use crate::nlp::{Curves, Problem, trajectory};
use crate::settings::{SolverSettings, TranscriptionSettings};
use crate::solver::{Finish, Outcome, Residuals, Resume, Solver, Status, close};
use crate::verify::verify_rows;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Barrier parameter with which a motion near the one before is minimised.
const WARM_BARRIER: f64 = 3e-4;
/// Cost above which the minimisation of a candidate ends, in costs of the gait in force or of standing. ANYmal at 0.5 m/s then needs 2.4
/// instead of 6.2 iterations per minimisation, and the cheapest candidate of an update costs 0.4 % more in the mean.
const MOST: f64 = 1.25;
/// Part of the cost by which changed durations must be cheaper.
const CHANGE: f64 = 0.02;

/// Data of one update.
pub(super) struct Updating<'a> {
    /// Motions before, of the families that have one; `None`: standing.
    pub guesses: &'a [(Option<GaitFamily>, Before)],
    /// Deadline.
    pub until: Option<Instant>,
}

impl Updating<'_> {
    fn late(&self) -> bool {
        self.until.is_some_and(|until| Instant::now() >= until)
    }

    /// Motion before of the family of a candidate.
    fn guess(&self, candidate: &Candidate) -> Option<&Before> {
        self.guesses.iter().find(|(family, _)| *family == candidate.gait.family).map(|(_, before)| before)
    }
}

/// A candidate that was solved in f32.
pub(super) struct Solved {
    pub x: Vec<f64>,
    pub curves: Curves,
    pub cost: f64,
    outcome: Outcome,
}

/// Gait that was chosen, its motion and cost.
pub(super) type Choice = (Cycle, Trajectory, f64);

impl Planner {
    /// Solves candidates, in their order because a deadline drops the last ones. Returns their solutions and the number of iterations.
    ///
    /// * `limit` - cost above which a candidate is dropped
    pub(super) fn solve(
        &self,
        candidates: &[Candidate],
        updating: &Updating,
        transcription: &TranscriptionSettings,
        limit: Option<f64>,
    ) -> (Vec<Option<Solved>>, usize) {
        let mut settings = self.solver.clone();
        settings.optimise.cost_limit = limit;
        let (next, iterations) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let results: Vec<Mutex<Option<Solved>>> = candidates.iter().map(|_| Mutex::default()).collect();
        self.cpu.pool().scope(|scope| {
            for solver in self.solvers.iter().take(candidates.len()) {
                let (next, iterations, results, settings) = (&next, &iterations, &results, &settings);
                scope.spawn(move |_| {
                    let mut solver = locked(solver);
                    loop {
                        let index = next.fetch_add(1, Ordering::Relaxed);
                        let Some(candidate) = candidates.get(index).filter(|_| !updating.late()) else { break };
                        let (solved, count) = self.solve_one(candidate, updating, transcription, settings, &mut solver);
                        iterations.fetch_add(count, Ordering::Relaxed);
                        *locked(&results[index]) = solved;
                    }
                });
            }
        });
        let solved = results.into_iter().map(|result| result.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner));
        (solved.collect(), iterations.into_inner())
    }

    /// Solves a candidate. Returns its solution, if there is one, and the number of iterations.
    fn solve_one(
        &self,
        candidate: &Candidate,
        updating: &Updating,
        transcription: &TranscriptionSettings,
        settings: &SolverSettings,
        solver: &mut Solver<f32>,
    ) -> (Option<Solved>, usize) {
        let task = &candidate.task;
        let problem = Problem::<f32>::with_cost(task, &candidate.schedule, transcription, settings.optimise.objective());
        let (finish, late) = (Finish::Infeasibility(settings.tolerance), || updating.late());
        let found = |solver: &Solver<f32>, outcome| (solver.solution(), solver.cost(&problem, settings), outcome);
        // The forces of another gait are of no use.
        let guess = updating.guess(candidate).map(|before| before.guess(task, &problem));
        let (start, barrier, rows) = match guess {
            // Near the motion before, the rows need no solve of their own before the minimisation.
            Some(guess) if std::ptr::eq(transcription, &self.transcription) => (guess, WARM_BARRIER, None),
            guess => {
                let mut rows = settings.clone();
                rows.optimise.iterations = 0;
                let outcome = solver.solve(&problem, &rows, finish, guess.as_deref(), &late);
                if outcome.status != Status::Solved {
                    return (None, outcome.iterations);
                }
                (solver.solution(), settings.optimise.barrier, Some(found(solver, outcome)))
            }
        };
        let multipliers = Residuals { c: vec![0.; problem.rows.one_sided()], g: vec![0.; problem.inequalities] };
        let from = Resume { x: &start, multipliers: &multipliers, barrier, iterations: settings.optimise.iterations };
        let outcome = solver.resume(&problem, settings, finish, &from, &late);
        let iterations = outcome.iterations + rows.as_ref().map_or(0, |(.., outcome)| outcome.iterations);
        let best = match outcome.status {
            Status::Solved => Some(found(solver, outcome)),
            // It is too expensive.
            Status::TerminatedEarly => None,
            _ => rows,
        };
        (best.map(|(x, cost, outcome)| Solved { x, curves: problem.curves, cost, outcome }), iterations)
    }

    /// Motion of a solved candidate, closed in f64; `None` if its certificate is not valid.
    fn certified(&self, candidate: &Candidate, solved: Solved, transcription: &TranscriptionSettings) -> Option<Trajectory> {
        let (task, robot) = (&candidate.task, &self.task.robot);
        let problem = Problem::<f64>::new(task, &candidate.schedule, transcription);
        let (outcome, x) = close(&problem, solved.outcome, solved.x, &self.solver, &|| false);
        if outcome.status != Status::Solved {
            return None;
        }
        let motion = trajectory(task, &problem.curves, &x);
        let report = verify_rows(&motion, robot, &task.terrain, problem.curves.force_limit).ok()?;
        report.feasible.then_some(motion)
    }

    /// Family of the gait in force; the inner `None` is standing.
    pub(super) fn in_force(&self) -> Option<Option<GaitFamily>> {
        self.plan.as_ref().map(|plan| plan.gait.family)
    }

    /// The cheapest candidate whose motion the certificate accepts; another gait than that in force must be cheaper by the hysteresis.
    ///
    /// * `transcription` - with which the candidates were solved
    pub(super) fn choose(
        &self,
        candidates: &[Candidate],
        solved: &mut [Option<Solved>],
        transcription: &TranscriptionSettings,
    ) -> Option<Choice> {
        let in_force = self.in_force();
        let value = |index: usize, cost: f64| {
            let stays = in_force == Some(candidates[index].gait.family);
            let unchanged = stays && index == 0;
            cost * if stays { 1. - self.settings.hysteresis } else { 1. } * if unchanged { 1. } else { 1. + CHANGE }
        };
        loop {
            let of = solved.iter().enumerate().filter_map(|(index, s)| s.as_ref().map(|s| (index, value(index, s.cost))));
            let (best, _) = of.min_by(|a, b| a.1.total_cmp(&b.1))?;
            let found = solved[best].take()?;
            let cost = found.cost;
            if let Some(motion) = self.certified(&candidates[best], found, transcription) {
                return Some((candidates[best].gait, motion, cost));
            }
        }
    }
}

/// Cost above which other candidates are dropped, if the gait in force goes on.
///
/// * `steady` - solutions of the gait in force and of standing
pub(super) fn limit(steady: &[Option<Solved>]) -> Option<f64> {
    let in_force = steady.first()?.as_ref()?.cost;
    Some(MOST * steady.iter().flatten().map(|s| s.cost).fold(in_force, f64::min))
}
