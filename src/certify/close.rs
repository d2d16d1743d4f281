//! Closing steps: an f32 solution made exact in f64.

use crate::backend::Solution;
use crate::nlp::Layout;
use crate::settings::{SolverSettings, StallSettings};
use crate::solver::{Finish, Outcome, Solver, Status};

/// Infeasibility below which a solve that f32 did not end goes on in f64.
pub const CONTINUE_BELOW: f64 = 1e-2;

/// Brings an f32 solution to f64 accuracy.
///
/// One or two Gauss-Newton steps from a solved point usually do. Where they do not, the solve is repeated in f64. Where f32 crept without
/// arriving (`F` below [`CONTINUE_BELOW`]), it goes on in f64 from there, with a small barrier. Everything else is returned as it is.
///
/// Returns the outcome with the costs of all attempts added, and the point.
pub fn close(layout: &Layout<f64>, solution: Solution, settings: &SolverSettings, cancel: &dyn Fn() -> bool) -> (Outcome, Vec<f64>) {
    let solved = solution.outcome.status == Status::Solved;
    let near = solution.outcome.infeasibility < CONTINUE_BELOW;
    if !solved && !near {
        return (solution.outcome, solution.x);
    }
    let finish = Finish::Rows(settings.row_tolerance);
    let closing = SolverSettings {
        max_iterations: settings.closing_steps,
        closing: f64::INFINITY,
        edge_radius: 0.,
        proximal: settings.proximal_floor,
        stall: StallSettings { enabled: false, ..settings.stall.clone() },
        ..settings.clone()
    };
    let onwards = SolverSettings { barrier: settings.barrier.min(1e-3), ..settings.clone() };
    // What f32 did not solve goes on from where it is; what it solved must close, and has more to fall back on.
    let attempts: &[(&SolverSettings, Option<&[f64]>)] =
        if solved { &[(&closing, Some(&solution.x)), (settings, None)] } else { &[(&onwards, Some(&solution.x))] };
    let mut solver = Solver::<f64>::default();
    let mut total = solution.outcome;
    for &(settings, start) in attempts {
        let outcome = solver.solve(layout, settings, finish, start, cancel);
        total = Outcome {
            iterations: total.iterations + outcome.iterations,
            factorisations: total.factorisations + outcome.factorisations,
            ..outcome
        };
        if outcome.status == Status::Solved || outcome.status == Status::Cancelled {
            break;
        }
    }
    (total, solver.solution())
}
