//! How good a trial point is, and the update of slacks and multipliers where it is taken.

use super::slacks::{MULTIPLIER_FLOOR, SLACK_FLOOR, Slacks};
use crate::linear::front::dot;
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
    let half = T::of(0.5);
    let mut lanes = [T::zero(); 8];
    for i in 0..g.len() {
        let over = over(g[i]);
        lanes[i % 8] += over * over;
    }
    half * (dot(c, c) + lanes.into_iter().sum::<T>())
}

/// How far half the squares fall from `a` to `b`, term by term: near a solution the sums differ in their last digits only.
#[inline(always)]
fn squares_fall<T: Real>(a: &[T], b: &[T]) -> T {
    let mut lanes = [T::zero(); 8];
    for i in 0..a.len() {
        lanes[i % 8] += (a[i] - b[i]) * (a[i] + b[i]);
    }
    T::of(0.5) * lanes.into_iter().sum::<T>()
}

/// How far the infeasibility falls from `(c, g)` to `(c_to, g_to)`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn infeasibility_fall<T: Real>(c: &[T], g: &[T], c_to: &[T], g_to: &[T]) -> T {
    let mut lanes = [T::zero(); 8];
    for i in 0..g.len() {
        let (from, to) = (over(g[i]), over(g_to[i]));
        lanes[i % 8] += (from - to) * (from + to);
    }
    squares_fall(c, c_to) + T::of(0.5) * lanes.into_iter().sum::<T>()
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
/// products of eight ratios of slacks, in `f64` for the products' sake.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn merit_fall<T: Real>(c: &[T], g: &[T], c_to: &[T], g_to: &[T], mu: T) -> T {
    let mut squares = [T::zero(); 8];
    let mut logs = 0.;
    for (from, to) in g.chunks(8).zip(g_to.chunks(8)) {
        let mut ratio = [T::one(); 8];
        for l in 0..from.len() {
            let (over, slack) = smoothed(from[l], mu);
            let (over_to, slack_to) = smoothed(to[l], mu);
            squares[l] += (over - over_to) * (over + over_to);
            ratio[l] = slack_to / slack;
        }
        logs += ratio.iter().map(|r| r.as_f64()).product::<f64>().ln();
    }
    squares_fall(c, c_to) + T::of(0.5) * squares.into_iter().sum::<T>() + mu * T::of(logs)
}

/// How far the cost of being away from the initial values falls from `x` to `x_to`: that of `sum smoothing (x - initial)^2 / 2`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn smoothing_fall<T: Real>(smoothing: &[T], x: &[T], x_to: &[T], initial: &[T]) -> T {
    let mut lanes = [T::zero(); 8];
    for i in 0..smoothing.len() {
        let (away, away_to) = (x[i] - initial[i], x_to[i] - initial[i]);
        lanes[i % 8] += smoothing[i] * (away - away_to) * (away + away_to);
    }
    T::of(0.5) * lanes.into_iter().sum::<T>()
}

/// Squared distance of residuals from their linear model: `(|c - c_lin|^2 + |g - g_lin|^2) / 2`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn nonlinearity<T: Real>(c: &[T], c_linear: &[T], g: &[T], g_linear: &[T]) -> T {
    let mut lanes = [T::zero(); 8];
    for (value, linear) in [(c, c_linear), (g, g_linear)] {
        for i in 0..value.len() {
            let gap = value[i] - linear[i];
            lanes[i % 8] += gap * gap;
        }
    }
    T::of(0.5) * lanes.into_iter().sum::<T>()
}

/// Moves slacks and multipliers along their steps and keeps them off zero.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn update_slacks<T: Real>(slacks: &mut Slacks<T>, step: T) {
    let (slack_floor, multiplier_floor) = (T::of(SLACK_FLOOR), T::of(MULTIPLIER_FLOOR));
    for i in 0..slacks.slack.len() {
        slacks.slack[i] = (slacks.slack[i] + step * slacks.slack_step[i]).max(slack_floor);
        slacks.multiplier[i] = (slacks.multiplier[i] + step * slacks.multiplier_step[i]).max(multiplier_floor);
    }
}
