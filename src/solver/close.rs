//! Closing steps: an f32 solution made exact in f64.

use super::{Finish, Outcome, Solver, Status};
use crate::nlp::Layout;
use crate::settings::{SolverSettings, StallSettings};
use std::cell::RefCell;

thread_local! {
    /// Buffers of a thread, which are larger than what allocators keep at hand.
    static SOLVER: RefCell<Solver<f64>> = RefCell::default();
}

/// Infeasibility below which a solve that f32 did not end goes on in f64.
pub const CONTINUE_BELOW: f64 = 1e-2;
/// Largest barrier parameter with which it does.
const ONWARDS_BARRIER: f64 = 1e-3;

/// Whether an f32 solve came near enough for [`close`] to do anything.
pub fn can_close(outcome: &Outcome) -> bool {
    outcome.status == Status::Solved || outcome.infeasibility < CONTINUE_BELOW
}

/// Brings an f32 solution to f64 accuracy.
///
/// One or two Gauss-Newton steps from a solved point usually do. Where they do not, the solve is repeated in f64. Where f32 crept without
/// arriving (`F` below [`CONTINUE_BELOW`]), it goes on in f64 from there, with a small barrier. Everything else is returned as it is.
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
    let finish = Finish::Rows(settings.row_tolerance);
    let closing = SolverSettings {
        max_iterations: settings.closing_steps,
        closing: f64::INFINITY,
        edge_radius: 0.,
        proximal: settings.proximal_floor,
        stall: StallSettings { enabled: false, ..settings.stall.clone() },
        ..settings.clone()
    };
    let barrier = settings.barrier(layout.curves.transcription).min(ONWARDS_BARRIER);
    let onwards = SolverSettings { barrier: Some(barrier), ..settings.clone() };
    // What f32 did not solve goes on from where it is; what it solved must close, and has more to fall back on.
    let attempts: &[(&SolverSettings, Option<&[f64]>)] =
        if f32_outcome.status == Status::Solved { &[(&closing, Some(&x)), (settings, None)] } else { &[(&onwards, Some(&x))] };
    SOLVER.with_borrow_mut(|solver| {
        let mut total = f32_outcome;
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
    })
}
