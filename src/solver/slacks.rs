//! Slacks and multipliers of the inequalities: their steps, and where a barrier step aims.

use crate::linear::lanes::{LANES, sum_over};
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
    let count = g.len();
    let (s, z) = (&slacks.slack[..count], &slacks.multiplier[..count]);
    let (ds, dz) = (&mut slacks.slack_step[..count], &mut slacks.multiplier_step[..count]);
    let g_change = &g_change[..count];
    // Steps, and the reciprocals of those at which slack and multiplier reach zero: -change / value.
    let step = |s: T, z: T, g: T, g_change: T, ds: T, dz: T| {
        let ratio = s / z;
        let centre = aim.product(ds, dz) / z;
        let w = one / (ratio + one);
        let dz = w * (g_change + g - z + centre);
        let ds = centre - s - ratio * dz;
        (ds, dz, [-ds / s, -dz / z])
    };
    let mut steepest = [[T::zero(); LANES]; 2];
    let whole = count - count % LANES;
    let groups = (s.as_chunks::<LANES>().0, z.as_chunks::<LANES>().0, g.as_chunks::<LANES>().0, g_change.as_chunks::<LANES>().0);
    let steps = (ds.as_chunks_mut::<LANES>().0, dz.as_chunks_mut::<LANES>().0);
    for i in 0..count / LANES {
        let (s, z, g, g_change) = (&groups.0[i], &groups.1[i], &groups.2[i], &groups.3[i]);
        let (ds, dz) = (&mut steps.0[i], &mut steps.1[i]);
        for l in 0..LANES {
            let steep;
            (ds[l], dz[l], steep) = step(s[l], z[l], g[l], g_change[l], ds[l], dz[l]);
            steepest[0][l] = larger(steepest[0][l], steep[0]);
            steepest[1][l] = larger(steepest[1][l], steep[1]);
        }
    }
    for i in whole..count {
        let steep;
        (ds[i], dz[i], steep) = step(s[i], z[i], g[i], g_change[i], ds[i], dz[i]);
        steepest[0][0] = larger(steepest[0][0], steep[0]);
        steepest[1][0] = larger(steepest[1][0], steep[1]);
    }
    Lengths::up_to_the_boundary(steepest.map(|lanes| lanes.into_iter().fold(T::zero(), larger)))
}

/// The larger of two; what is no number counts as less than any.
#[inline(always)]
fn larger<T: Real>(a: T, b: T) -> T {
    if b > a { b } else { a }
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
