//! Merit of a trial point, and the update of slacks and multipliers after it was accepted.

use super::slacks::{Lengths, MULTIPLIER_FLOOR, SLACK_FLOOR, Slacks};
use crate::linear::simd::{BLOCK, LANES, dot, sum_over};
use crate::real::Real;
use multiversion::multiversion;

/// Violation `max(g, 0)`; NaN stays NaN.
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

/// Decrease of half the sum of squares from `a` to `b`, term by term: near a solution the two sums differ only in their last digits.
#[inline(always)]
fn squares_fall<T: Real>(a: &[T], b: &[T]) -> T {
    T::of(0.5) * sum_over([a, b], |[a, b]| (a - b) * (a + b))
}

/// Decrease of the infeasibility from `(c, g)` to `(c_to, g_to)`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn infeasibility_fall<T: Real>(c: &[T], g: &[T], c_to: &[T], g_to: &[T]) -> T {
    let violated = sum_over([g, g_to], |[from, to]| {
        let (from, to) = (over(from), over(to));
        (from - to) * (from + to)
    });
    squares_fall(c, c_to) + T::of(0.5) * violated
}

/// Smoothed `max(g, 0)` and the corresponding slack: `(q + g) / 2` and `(q - g) / 2` with `q = sqrt(g^2 + 4 mu)`.
#[inline(always)]
pub fn smoothed<T: Real>(g: T, mu: T) -> [T; 2] {
    let q = (g * g + T::of(4.) * mu).sqrt();
    // The smaller of the two is mu / larger, which avoids cancellation.
    let larger = T::of(0.5) * (q + g.abs());
    let smaller = mu / larger;
    if g > T::zero() { [larger, smaller] } else { [smaller, larger] }
}

/// Accumulated decrease of the smoothed merit of the inequalities, used by [`merit_falls`].
struct Falls<T> {
    squares: [T; LANES],
    /// Products of slack ratios whose logarithms have not been taken yet.
    ratios: [f64; LANES],
    logs: f64,
}

impl<T: Real> Falls<T> {
    fn none() -> Self {
        Falls { squares: [T::zero(); LANES], ratios: [1.; LANES], logs: 0. }
    }

    /// Adds the decrease from one block of smoothed values to another.
    #[inline(always)]
    fn add(&mut self, [over, slack]: &[[T; BLOCK]; 2], [over_to, slack_to]: &[[T; BLOCK]; 2]) {
        let (mut squares, mut ratios) = ([T::zero(); BLOCK], [0.; BLOCK]);
        for i in 0..BLOCK {
            squares[i] = (over[i] - over_to[i]) * (over[i] + over_to[i]);
            ratios[i] = (slack_to[i] / slack[i]).as_f64();
        }
        for (squares, ratios) in squares.as_chunks::<LANES>().0.iter().zip(ratios.as_chunks::<LANES>().0) {
            let mut far = false;
            for l in 0..LANES {
                self.squares[l] += squares[l];
                self.ratios[l] *= ratios[l];
                // Within these bounds the product with one more ratio cannot overflow.
                far |= !(1e-150..1e150).contains(&self.ratios[l]);
            }
            if far {
                self.take_logs();
            }
        }
    }

    fn take_logs(&mut self) {
        self.logs += self.ratios.iter().map(|ratio| ratio.ln()).sum::<f64>();
        self.ratios = [1.; LANES];
    }

    fn sum(mut self, mu: T) -> T {
        self.take_logs();
        T::of(0.5) * self.squares.into_iter().sum::<T>() + mu * T::of(self.logs)
    }
}

/// Decrease of the smoothed merit from `(c, g)` to each of two points `(c_to, g_to)`.
///
/// `M = |c|^2 / 2 + sum phi(g)`, `phi(g) = (g + s)^2 / 2 - mu ln s` at the optimal slack `s = (q - g) / 2`, `q = sqrt(g^2 + 4 mu)`. The
/// derivative of `phi` is `(g + q) / 2`, a smooth `max(g, 0)`. Differences are taken term by term, so that they are accurate in `f32`.
/// Logarithms are taken of products of slack ratios, of as many ratios as fit the range of `f64`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn merit_falls<T: Real>(c: &[T], g: &[T], to: [(&[T], &[T]); 2], mu: T) -> [T; 2] {
    let mut falls = to.map(|_| Falls::none());
    for first in (0..g.len()).step_by(BLOCK) {
        // Padding beyond the last inequality is the same at all points and adds nothing.
        let values = |g: &[T]| {
            let [mut values, mut over, mut slack] = [[T::zero(); BLOCK]; 3];
            let count = BLOCK.min(g.len() - first);
            values[..count].copy_from_slice(&g[first..][..count]);
            for i in 0..BLOCK {
                [over[i], slack[i]] = smoothed(values[i], mu);
            }
            [over, slack]
        };
        let from = values(g);
        for (falls, (_, g_to)) in falls.iter_mut().zip(to) {
            falls.add(&from, &values(g_to));
        }
    }
    let [a, b] = falls.map(|falls| falls.sum(mu));
    [squares_fall(c, to[0].0) + a, squares_fall(c, to[1].0) + b]
}

/// Decrease of the smoothing term `sum smoothing (x - initial)^2 / 2` from `x` to `x_to`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn smoothing_fall<T: Real>(smoothing: &[T], x: &[T], x_to: &[T], initial: &[T]) -> T {
    let fall = sum_over([smoothing, x, x_to, initial], |[smoothing, x, x_to, initial]| {
        let (away, away_to) = (x - initial, x_to - initial);
        smoothing * (away - away_to) * (away + away_to)
    });
    T::of(0.5) * fall
}

/// Half the squared distance of the residuals from their linear model: `(|c - c_lin|^2 + |g - g_lin|^2) / 2`.
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

/// Moves slacks and multipliers along their steps, each by its own length, and keeps them above their floors.
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
