//! How good a trial point is, and the update of slacks and multipliers where it is taken.

use super::slacks::{Lengths, MULTIPLIER_FLOOR, SLACK_FLOOR, Slacks};
use crate::linear::lanes::{LANES, dot, sum_over};
use crate::real::Real;
use multiversion::multiversion;

/// What is violated: `max(g, 0)`, but no number stays none.
#[inline(always)]
fn over<T: Real>(g: T) -> T {
    if g <= T::zero() { T::zero() } else { g }
}

/// Infeasibility `F = (|c|^2 + |max(g, 0)|^2) / 2`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn infeasibility<T: Real>(c: &[T], g: &[T]) -> T {
    let violated = sum_over([g], |[g]| {
        let over = over(g);
        over * over
    });
    T::of(0.5) * (dot(c, c) + violated)
}

/// How far half the squares fall from `a` to `b`, term by term: near a solution the sums differ in their last digits only.
#[inline(always)]
fn squares_fall<T: Real>(a: &[T], b: &[T]) -> T {
    T::of(0.5) * sum_over([a, b], |[a, b]| (a - b) * (a + b))
}

/// How far the infeasibility falls from `(c, g)` to `(c_to, g_to)`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn infeasibility_fall<T: Real>(c: &[T], g: &[T], c_to: &[T], g_to: &[T]) -> T {
    let violated = sum_over([g, g_to], |[from, to]| {
        let (from, to) = (over(from), over(to));
        (from - to) * (from + to)
    });
    squares_fall(c, c_to) + T::of(0.5) * violated
}

/// Smoothed `max(g, 0)` and the slack that goes with it: `(q + g) / 2` and `(q - g) / 2`, `q = sqrt(g^2 + 4 mu)`.
#[inline(always)]
fn smoothed<T: Real>(g: T, mu: T) -> (T, T) {
    let q = (g * g + T::of(4.) * mu).sqrt();
    // The smaller of the two is mu / larger: no cancellation.
    let larger = T::of(0.5) * (q + g.abs());
    let smaller = mu / larger;
    if g > T::zero() { (larger, smaller) } else { (smaller, larger) }
}

/// How far the smoothed merit falls from `(c, g)` to `(c_to, g_to)`.
///
/// `M = |c|^2 / 2 + sum phi(g)`, `phi(g) = (g + s)^2 / 2 - mu ln s` at the best slack `s = (q - g) / 2`, `q = sqrt(g^2 + 4 mu)`. Its
/// derivative is `(g + q) / 2`, a smooth `max(g, 0)`. Differences are taken term by term, so that they are good in `f32`; logarithms of
/// products of ratios of slacks, as many as `f64` has room for.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn merit_fall<T: Real>(c: &[T], g: &[T], c_to: &[T], g_to: &[T], mu: T) -> T {
    let ((groups, rest), (groups_to, rest_to)) = (g.as_chunks(), g_to.as_chunks());
    // What stays as it is adds nothing.
    let (mut last, mut last_to) = ([T::zero(); LANES], [T::zero(); LANES]);
    last[..rest.len()].copy_from_slice(rest);
    last_to[..rest_to.len()].copy_from_slice(rest_to);
    let mut squares = [T::zero(); LANES];
    let (mut ratios, mut logs) = ([1f64; LANES], 0.);
    let log = |ratios: &[f64; LANES]| ratios.iter().map(|ratio| ratio.ln()).sum::<f64>();
    for (from, to) in groups.iter().zip(groups_to).chain([(&last, &last_to)]) {
        let mut far = false;
        for l in 0..LANES {
            let (over, slack) = smoothed(from[l], mu);
            let (over_to, slack_to) = smoothed(to[l], mu);
            squares[l] += (over - over_to) * (over + over_to);
            ratios[l] *= (slack_to / slack).as_f64();
            // One more ratio is within the range of numbers, too.
            far |= !(1e-150..1e150).contains(&ratios[l]);
        }
        if far {
            logs += log(&ratios);
            ratios = [1.; LANES];
        }
    }
    squares_fall(c, c_to) + T::of(0.5) * squares.into_iter().sum::<T>() + mu * T::of(logs + log(&ratios))
}

/// How far the cost of being away from the initial values falls from `x` to `x_to`: that of `sum smoothing (x - initial)^2 / 2`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn smoothing_fall<T: Real>(smoothing: &[T], x: &[T], x_to: &[T], initial: &[T]) -> T {
    let fall = sum_over([smoothing, x, x_to, initial], |[smoothing, x, x_to, initial]| {
        let (away, away_to) = (x - initial, x_to - initial);
        smoothing * (away - away_to) * (away + away_to)
    });
    T::of(0.5) * fall
}

/// Squared distance of residuals from their linear model: `(|c - c_lin|^2 + |g - g_lin|^2) / 2`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn nonlinearity<T: Real>(c: &[T], c_linear: &[T], g: &[T], g_linear: &[T]) -> T {
    let gaps = |values: &[T], linear: &[T]| {
        sum_over([values, linear], |[value, linear]| {
            let gap = value - linear;
            gap * gap
        })
    };
    T::of(0.5) * (gaps(c, c_linear) + gaps(g, g_linear))
}

/// Moves slacks and multipliers along their steps, each by its length, and keeps them off zero.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn update_slacks<T: Real>(slacks: &mut Slacks<T>, lengths: Lengths<T>) {
    let (slack_floor, multiplier_floor) = (T::of(SLACK_FLOOR), T::of(MULTIPLIER_FLOOR));
    for (value, change) in slacks.slack.iter_mut().zip(&slacks.slack_step) {
        *value = (*value + lengths.primal * *change).max(slack_floor);
    }
    for (value, change) in slacks.multiplier.iter_mut().zip(&slacks.multiplier_step) {
        *value = (*value + lengths.dual * *change).max(multiplier_floor);
    }
}
