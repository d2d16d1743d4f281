//! Mehrotra's corrector: chooses the barrier parameter from the step lengths of the predictor and adds the second-order term of the
//! predictor's steps.

use super::slacks::{BarrierTarget, Slacks, slack_steps, target};
use super::weights::barrier_rows;
use crate::nlp::Problem;
use crate::real::Real;
use multiversion::multiversion;

/// Computes the predictor's steps of slacks and multipliers and the row weights and values of the corrector. Returns the barrier parameter.
///
/// * `g_change` - product of the inequality Jacobian with the predictor's direction
/// * `floor` - smallest barrier parameter
/// * `weight`, `value` - out, per row
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn correct<T: Real>(
    problem: &Problem<T>,
    c: &[T],
    g: &[T],
    g_change: &[T],
    slacks: &mut Slacks<T>,
    floor: T,
    [weight, value]: [&mut [T]; 2],
) -> T {
    let lengths = slack_steps(g, g_change, BarrierTarget::predictor(), slacks);
    let mu = target(slacks, lengths, floor);
    barrier_rows(problem, c, g, slacks, BarrierTarget::corrector(mu), weight, value);
    mu
}
