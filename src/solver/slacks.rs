//! Slacks and multipliers of the inequalities: their steps, and where a barrier step aims.

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

/// Where a barrier step aims: at products `s z = mu - correction ds dz`, with the steps of the predictor.
#[derive(Debug, Clone, Copy)]
pub struct Aim<T> {
    /// Barrier parameter.
    pub mu: T,
    /// Share of the second-order term that is corrected for; 0 in the predictor itself.
    pub correction: T,
}

impl<T: Real> Aim<T> {
    /// Where the predictor aims: at the end.
    pub fn predictor() -> Self {
        Aim { mu: T::zero(), correction: T::zero() }
    }

    #[inline(always)]
    pub(super) fn product(&self, slacks: &Slacks<T>, i: usize) -> T {
        self.mu - self.correction * slacks.slack_step[i] * slacks.multiplier_step[i]
    }
}

/// Steps of slacks and multipliers for `d`: `dz = w (J d + g - z/rho + mu/z)`, `ds = -(s - mu/z) - (s/z) dz`.
///
/// Returns the largest step in `(0, 1]` that keeps a twentieth of every slack and multiplier.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn slack_steps<T: Real>(g: &[T], g_change: &[T], aim: Aim<T>, slacks: &mut Slacks<T>) -> T {
    let one = T::one();
    let count = g.len();
    let (s, z) = (&slacks.slack[..count], &slacks.multiplier[..count]);
    let (ds, dz) = (&mut slacks.slack_step[..count], &mut slacks.multiplier_step[..count]);
    let g_change = &g_change[..count];
    let mut steepest = [T::zero(); 8];
    for i in 0..count {
        let ratio = s[i] / z[i];
        let centre = (aim.mu - aim.correction * ds[i] * dz[i]) / z[i];
        let w = one / (ratio + one);
        dz[i] = w * (g_change[i] + g[i] - z[i] + centre);
        ds[i] = centre - s[i] - ratio * dz[i];
        // -change / value: the reciprocal of the step at which it reaches zero.
        let steep = (-ds[i] / s[i]).max(-dz[i] / z[i]);
        steepest[i % 8] = steepest[i % 8].max(steep);
    }
    let steepest = steepest.into_iter().fold(T::zero(), T::max);
    if steepest * T::of(1. / 0.95) > one { T::of(0.95) / steepest } else { one }
}

/// Mean of the products `s z` after a step.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn mean_product<T: Real>(slacks: &Slacks<T>, step: T) -> T {
    let count = slacks.slack.len();
    let mut lanes = [T::zero(); 8];
    for i in 0..count {
        let s = slacks.slack[i] + step * slacks.slack_step[i];
        let z = slacks.multiplier[i] + step * slacks.multiplier_step[i];
        lanes[i % 8] += s * z;
    }
    lanes.into_iter().sum::<T>() / T::of(count.max(1) as f64)
}

/// Barrier parameter to aim for, Mehrotra's way: the farther the predictor could go, the lower.
///
/// * `length` - of the predictor's step
pub fn target<T: Real>(slacks: &Slacks<T>, length: T) -> T {
    let before = mean_product(slacks, T::zero());
    let share = mean_product(slacks, length) / before;
    let share = share.max(T::zero()).min(T::one());
    (before * share * share).max(T::of(BARRIER_FLOOR))
}
