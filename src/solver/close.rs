//! Closing in f64: brings an f32 solution to f64 accuracy.

use super::{Finish, Outcome, Solver, Status};
use crate::nlp::Problem;
use crate::settings::{OptimiseSettings, SmoothSettings, SolverSettings, StallSettings};
use std::cell::RefCell;

thread_local! {
    /// Buffers of one thread, reused because they are larger than the blocks that allocators cache.
    static SOLVER: RefCell<Solver<f64>> = RefCell::default();
}

/// Infeasibility below which an f32 solve that did not finish is continued in f64. Of 64 such candidates 8 were solved, after 21 to 36
/// iterations.
pub const CONTINUE_BELOW: f64 = 1e-2;
/// Largest barrier parameter for continuing an unfinished f32 solve in f64.
const CONTINUE_BARRIER: f64 = 1e-3;
/// Iteration limit for continuing an unfinished f32 solve in f64. All that converge do so within 40 iterations.
const CONTINUE_ITERATIONS: usize = 40;
/// Barrier parameters of the restarts, tried in this order, for a point at which the closing steps fail.
const RESTART_BARRIERS: [f64; 2] = [1e-3, 3e-3];
/// Iteration limit of each restart.
const RESTART_ITERATIONS: usize = 20;

/// True if an f32 solve came close enough to a solution for [`close`] to work on it.
pub fn can_close(outcome: &Outcome) -> bool {
    outcome.status == Status::Solved || outcome.infeasibility < CONTINUE_BELOW
}

/// Brings an f32 solution to f64 accuracy.
///
/// 1. An unfinished f32 solve with `F` below [`CONTINUE_BELOW`] is first continued in f64 with a small barrier parameter.
/// 2. From a solved point, one or two Gauss-Newton steps usually satisfy the rows.
/// 3. If they do not, they act on the wrong set of violated rows. Restarts with fresh slacks and a small barrier parameter then find the
///    right set in about ten iterations.
/// 4. If f32 solved the candidate, the last resort is a solve in f64 from the initial values.
///
/// An f32 outcome for which [`can_close`] is false is returned unchanged.
///
/// Returns the outcome, with the iterations and factorisations of all attempts added, and the point.
pub fn close(
    problem: &Problem<f64>,
    f32_outcome: Outcome,
    x: Vec<f64>,
    settings: &SolverSettings,
    cancel: &dyn Fn() -> bool,
) -> (Outcome, Vec<f64>) {
    if !can_close(&f32_outcome) {
        return (f32_outcome, x);
    }
    SOLVER.with_borrow_mut(|solver| {
        let mut so_far = Closing { problem, solver, cancel, outcome: f32_outcome, x };
        so_far.run(settings);
        (so_far.outcome, so_far.x)
    })
}

/// State of a closing: the current point, its outcome, and the iterations and factorisations spent so far.
struct Closing<'a> {
    problem: &'a Problem<f64>,
    solver: &'a mut Solver<f64>,
    cancel: &'a dyn Fn() -> bool,
    outcome: Outcome,
    x: Vec<f64>,
}

impl Closing<'_> {
    fn run(&mut self, settings: &SolverSettings) {
        let solved_before = self.outcome.status == Status::Solved;
        if !solved_before {
            let barrier = settings.barrier(self.problem.curves.transcription).min(CONTINUE_BARRIER);
            let continued = SolverSettings { barrier: Some(barrier), ..at_most(CONTINUE_ITERATIONS, settings) };
            self.attempt(&continued, Finish::Infeasibility(settings.tolerance), true);
            if self.outcome.status != Status::Solved {
                return;
            }
        }
        // Smoothing and optimisation have already run on this point, so they are not repeated from here.
        let smooth = SmoothSettings { iterations: 0, ..settings.smooth.clone() };
        let optimise = OptimiseSettings { iterations: 0, ..settings.optimise.clone() };
        let once = SolverSettings { smooth, optimise, ..settings.clone() };
        let steps = SolverSettings {
            max_iterations: settings.closing_steps,
            closing: f64::INFINITY,
            edge_radius: 0.,
            proximal: settings.proximal_floor,
            stall: StallSettings { enabled: false, ..settings.stall.clone() },
            ..once.clone()
        };
        let restart = |barrier| SolverSettings { barrier: Some(barrier), smoothing: 0., ..at_most(RESTART_ITERATIONS, &once) };
        let from_here = std::iter::once(steps).chain(RESTART_BARRIERS.map(restart)).map(|settings| (settings, true));
        let from_the_start = solved_before.then(|| (settings.clone(), false));
        for (settings, from_here) in from_here.chain(from_the_start) {
            self.attempt(&settings, Finish::Rows(settings.row_tolerance), from_here);
            if matches!(self.outcome.status, Status::Solved | Status::Cancelled) {
                return;
            }
        }
    }

    fn attempt(&mut self, settings: &SolverSettings, finish: Finish, from_here: bool) {
        let outcome = self.solver.solve(self.problem, settings, finish, from_here.then_some(&self.x), self.cancel);
        self.outcome = Outcome {
            iterations: self.outcome.iterations + outcome.iterations,
            factorisations: self.outcome.factorisations + outcome.factorisations,
            ..outcome
        };
        self.x = self.solver.solution();
    }
}

/// Copy of the settings with the iteration limit reduced to `iterations`, unless it is already lower.
fn at_most(iterations: usize, settings: &SolverSettings) -> SolverSettings {
    SolverSettings { max_iterations: settings.max_iterations.min(iterations), ..settings.clone() }
}
