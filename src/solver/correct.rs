//! The corrector, Mehrotra's way: the barrier parameter follows from how far the predictor could go, and the product of the predictor's steps
//! is taken into account.

use super::slacks::{Aim, Slacks, slack_steps, target};
use super::weights::barrier_rows;
use crate::nlp::Layout;
use crate::real::Real;
use multiversion::multiversion;

/// Steps of slacks and multipliers of the predictor, and the rows for the corrector. Returns the barrier parameter.
///
/// * `g_change` - products of the Jacobian with the predictor
/// * `weight`, `value` - out, of the rows
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn correct<T: Real>(
    layout: &Layout<T>,
    c: &[T],
    g: &[T],
    g_change: &[T],
    slacks: &mut Slacks<T>,
    weight: &mut [T],
    value: &mut [T],
) -> T {
    let lengths = slack_steps(g, g_change, Aim::predictor(), slacks);
    let mu = target(slacks, lengths);
    barrier_rows(layout, c, g, slacks, Aim::corrector(mu), weight, value);
    mu
}
