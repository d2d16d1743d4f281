//! Closing steps: an f32 solution made exact in f64.

use super::{Finish, Outcome, Solver, Status};
use crate::nlp::Layout;
use crate::settings::{SmoothSettings, SolverSettings, StallSettings};
use std::cell::RefCell;

thread_local! {
    /// Buffers of a thread, which are larger than what allocators keep at hand.
    static SOLVER: RefCell<Solver<f64>> = RefCell::default();
}

/// Infeasibility below which a solve that f32 did not end goes on in f64.
pub const CONTINUE_BELOW: f64 = 1e-2;
/// Largest barrier parameter with which it does.
const ONWARDS_BARRIER: f64 = 1e-3;
/// Iterations after which it ends: those that arrive do so after 40 at most.
const ONWARDS_ITERATIONS: usize = 40;
/// Barrier parameters with which a point that does not close is begun anew, one after the other, and the iterations of each.
const ANEW_BARRIERS: [f64; 2] = [1e-3, 3e-3];
const ANEW_ITERATIONS: usize = 20;

/// Whether an f32 solve came near enough for [`close`] to do anything.
pub fn can_close(outcome: &Outcome) -> bool {
    outcome.status == Status::Solved || outcome.infeasibility < CONTINUE_BELOW
}

/// Brings an f32 solution to f64 accuracy.
///
/// Where f32 crept without arriving (`F` below [`CONTINUE_BELOW`]), f64 first goes on from there, with a small barrier. One or two
/// Gauss-Newton steps from a solved point usually make its rows hold. Where they do not, they close on the wrong rows: fresh slacks on a small
/// barrier find the right ones from there in some ten iterations. What f32 solved has a solve in f64 from the start to fall back on. Everything
/// else is returned as it is.
///
/// Returns the outcome with the costs of all attempts added, and the point.
pub fn close(
    layout: &Layout<f64>,
    f32_outcome: Outcome,
    x: Vec<f64>,
    settings: &SolverSettings,
    cancel: &dyn Fn() -> bool,
) -> (Outcome, Vec<f64>) {
    if !can_close(&f32_outcome) {
        return (f32_outcome, x);
    }
    SOLVER.with_borrow_mut(|solver| {
        let mut so_far = Closing { layout, solver, cancel, outcome: f32_outcome, x };
        so_far.run(settings);
        (so_far.outcome, so_far.x)
    })
}

/// A point on its way, and what was spent on it.
struct Closing<'a> {
    layout: &'a Layout<f64>,
    solver: &'a mut Solver<f64>,
    cancel: &'a dyn Fn() -> bool,
    outcome: Outcome,
    x: Vec<f64>,
}

impl Closing<'_> {
    fn run(&mut self, settings: &SolverSettings) {
        let solved_before = self.outcome.status == Status::Solved;
        if !solved_before {
            let barrier = settings.barrier(self.layout.curves.transcription).min(ONWARDS_BARRIER);
            let onwards = SolverSettings { barrier: Some(barrier), ..at_most(ONWARDS_ITERATIONS, settings) };
            self.attempt(&onwards, Finish::Infeasibility(settings.tolerance), true);
            if self.outcome.status != Status::Solved {
                return;
            }
        }
        // What was solved has been smoothed.
        let smooth = SmoothSettings { iterations: 0, ..settings.smooth.clone() };
        let once = SolverSettings { smooth, ..settings.clone() };
        let steps = SolverSettings {
            max_iterations: settings.closing_steps,
            closing: f64::INFINITY,
            edge_radius: 0.,
            proximal: settings.proximal_floor,
            stall: StallSettings { enabled: false, ..settings.stall.clone() },
            ..once.clone()
        };
        let anew = |barrier| SolverSettings { barrier: Some(barrier), smoothing: 0., ..at_most(ANEW_ITERATIONS, &once) };
        let from_here = std::iter::once(steps).chain(ANEW_BARRIERS.map(anew)).map(|settings| (settings, true));
        let from_the_start = solved_before.then(|| (settings.clone(), false));
        for (settings, from_here) in from_here.chain(from_the_start) {
            self.attempt(&settings, Finish::Rows(settings.row_tolerance), from_here);
            if matches!(self.outcome.status, Status::Solved | Status::Cancelled) {
                return;
            }
        }
    }

    fn attempt(&mut self, settings: &SolverSettings, finish: Finish, from_here: bool) {
        let outcome = self.solver.solve(self.layout, settings, finish, from_here.then_some(&self.x), self.cancel);
        self.outcome = Outcome {
            iterations: self.outcome.iterations + outcome.iterations,
            factorisations: self.outcome.factorisations + outcome.factorisations,
            ..outcome
        };
        self.x = self.solver.solution();
    }
}

/// The settings with a limit of iterations, if they have no lower one.
fn at_most(iterations: usize, settings: &SolverSettings) -> SolverSettings {
    SolverSettings { max_iterations: settings.max_iterations.min(iterations), ..settings.clone() }
}
