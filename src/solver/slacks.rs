//! Slacks and multipliers of the inequalities: their steps, and where a barrier step aims.

use crate::linear::lanes::{BLOCK, LANES, sum_over};
use crate::real::Real;
use multiversion::multiversion;

/// Barrier state of the inequalities, each `[inequalities]`.
#[derive(Debug, Default)]
pub struct Slacks<T> {
    /// Slacks `s`, positive.
    pub slack: Vec<T>,
    /// Multipliers `z`, positive.
    pub multiplier: Vec<T>,
    /// Steps of the slacks.
    pub slack_step: Vec<T>,
    /// Steps of the multipliers.
    pub multiplier_step: Vec<T>,
}

/// Smallest slack.
pub const SLACK_FLOOR: f64 = 1e-6;
/// Smallest barrier parameter.
pub const BARRIER_FLOOR: f64 = 1e-9;
/// Smallest multiplier.
pub const MULTIPLIER_FLOOR: f64 = 1e-8;
/// How much of its way to zero a slack or multiplier may go in a step.
pub const TO_THE_BOUNDARY: f64 = 0.99;

/// Lengths of a step, from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lengths<T> {
    /// Of variables and slacks.
    pub primal: T,
    /// Of multipliers.
    pub dual: T,
}

impl<T: Real> Lengths<T> {
    /// No step.
    pub fn none() -> Self {
        Lengths { primal: T::zero(), dual: T::zero() }
    }

    /// The whole step.
    pub fn whole() -> Self {
        Lengths { primal: T::one(), dual: T::one() }
    }

    /// The longest step, by the reciprocals of the steps at which the first slack and the first multiplier reach zero.
    fn up_to_the_boundary(steepest: [T; 2]) -> Self {
        let [primal, dual] = steepest.map(|steepest| {
            let most = T::of(TO_THE_BOUNDARY);
            if steepest > most { most / steepest } else { T::one() }
        });
        Lengths { primal, dual }
    }
}

/// Where a barrier step aims: at products `s z = mu - correction ds dz`, with the steps of the predictor.
#[derive(Debug, Clone, Copy)]
pub struct Aim<T> {
    /// Barrier parameter.
    pub mu: T,
    /// Share of the second-order term that is corrected for: 0 in the predictor itself, 1 after it.
    pub correction: T,
}

impl<T: Real> Aim<T> {
    /// Where the predictor aims: at the end.
    pub fn predictor() -> Self {
        Aim { mu: T::zero(), correction: T::zero() }
    }

    /// Where the corrector aims.
    pub fn corrector(mu: T) -> Self {
        Aim { mu, correction: T::one() }
    }

    #[inline(always)]
    pub(super) fn product(&self, slack_step: T, multiplier_step: T) -> T {
        self.mu - self.correction * slack_step * multiplier_step
    }
}

/// Steps of slacks and multipliers for `d`: `dz = w (J d + g - z/rho + mu/z)`, `ds = -(s - mu/z) - (s/z) dz`.
///
/// Returns how far they may go.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn slack_steps<T: Real>(g: &[T], g_change: &[T], aim: Aim<T>, slacks: &mut Slacks<T>) -> Lengths<T> {
    let one = T::one();
    // How steeply slacks and multipliers fall: the reciprocals of the steps at which they reach zero.
    let mut steepest = [[T::zero(); LANES]; 2];
    let Slacks { slack, multiplier, slack_step, multiplier_step } = slacks;
    for first in (0..g.len()).step_by(BLOCK) {
        let count = BLOCK.min(g.len() - first);
        let (s, z) = (&slack[first..][..count], &multiplier[first..][..count]);
        let (ds, dz) = (&mut slack_step[first..][..count], &mut multiplier_step[first..][..count]);
        let (g, g_change) = (&g[first..][..count], &g_change[first..][..count]);
        let mut steep = [[T::zero(); BLOCK]; 2];
        let [steep_s, steep_z] = &mut steep;
        for i in 0..count {
            let ratio = s[i] / z[i];
            let centre = aim.product(ds[i], dz[i]) / z[i];
            let w = one / (ratio + one);
            dz[i] = w * (g_change[i] + g[i] - z[i] + centre);
            ds[i] = centre - s[i] - ratio * dz[i];
            steep_s[i] = -ds[i] / s[i];
            steep_z[i] = -dz[i] / z[i];
        }
        for (most, steep) in steepest.iter_mut().zip(&steep) {
            for group in steep.as_chunks::<LANES>().0 {
                for l in 0..LANES {
                    most[l] = larger(most[l], group[l]);
                }
            }
        }
    }
    Lengths::up_to_the_boundary(steepest.map(|lanes| lanes.into_iter().fold(T::zero(), larger)))
}

/// The larger of two; what is no number counts as less than any.
#[inline(always)]
fn larger<T: Real>(a: T, b: T) -> T {
    if b > a { b } else { a }
}

/// The largest of non-negative values; 0 of none.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn largest<T: Real>(values: &[T]) -> T {
    let (groups, rest) = values.as_chunks::<LANES>();
    let mut most = [T::zero(); LANES];
    for group in groups {
        for l in 0..LANES {
            most[l] = larger(most[l], group[l]);
        }
    }
    most.into_iter().chain(rest.iter().copied()).fold(T::zero(), larger)
}

/// Mean of the products `s z`, `lengths` along their steps.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn mean_product<T: Real>(slacks: &Slacks<T>, lengths: Lengths<T>) -> T {
    let Lengths { primal, dual } = lengths;
    let Slacks { slack, multiplier, slack_step, multiplier_step } = slacks;
    let products = sum_over([slack, multiplier, slack_step, multiplier_step], |[s, z, ds, dz]| (s + primal * ds) * (z + dual * dz));
    products / T::of(slack.len().max(1) as f64)
}

/// Barrier parameter to aim for, Mehrotra's way: the farther the predictor could go, the lower.
///
/// * `lengths` - of the predictor's step
pub fn target<T: Real>(slacks: &Slacks<T>, lengths: Lengths<T>) -> T {
    let before = mean_product(slacks, Lengths::none());
    let share = mean_product(slacks, lengths) / before;
    let share = share.max(T::zero()).min(T::one());
    (before * share * share).max(T::of(BARRIER_FLOOR))
}
