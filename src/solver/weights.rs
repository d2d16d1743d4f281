//! Weights and values of the rows in the normal equations, and the terms on single variables.

use super::slacks::{BarrierTarget, Slacks};
use crate::nlp::Problem;
use crate::real::Real;
use crate::rows::RowKind;
use multiversion::multiversion;

/// Distance from zero, as a multiple of the root of the infeasibility, within which an inequality takes part in closing steps. Without it a
/// closing step from an optimum on its limits violates rows that it left out; it is then refused, and barrier steps lead away from the
/// optimum: the cost of a biped's walk of 0.51 m rose by 3.8 % in 200 iterations.
pub const CLOSING_REACH: f64 = 3.;
/// Upper limit of this distance, in the scale of the rows. Without it a biped's hop that was resumed beside its optimum, in values of up to
/// 0.01, ended 6 % above it after two iterations, with it 1.7 %.
pub const LARGEST_CLOSING_REACH: f64 = 1e-4;
/// Number of times that this distance is doubled for every refused attempt.
pub const REACH_DOUBLINGS: u32 = 2;
/// Number of inequalities whose weights and values are computed in one block.
const AT_ONCE: usize = 256;

/// Combines the weights and values of the inequalities into those of their Jacobian rows. The two sides of a two-sided row are added:
/// weights as `upper + lower`, values as `upper - lower`.
///
/// * `make` - writes weights and values of consecutive inequalities, starting at an index
#[inline(always)]
fn per_row<T: Real>(problem: &Problem<T>, weight: &mut [T], value: &mut [T], make: impl Fn(usize, &mut [T], &mut [T])) {
    let (mut weights, mut values) = ([T::zero(); AT_ONCE], [T::zero(); AT_ONCE]);
    // Range of the inequalities in the current block.
    let mut made = 0..0;
    for element in problem.all_elements() {
        let (rows, pairs) = (element.rows as usize, element.pairs as usize);
        let (row, at) = (element.place.row as usize, element.place.inequality as usize);
        if problem.rows.kind(element.place.row) != RowKind::Inequality {
            continue;
        }
        if at < made.start || at + rows + pairs > made.end {
            made = at..problem.inequalities.min(at + AT_ONCE);
            make(at, &mut weights[..made.len()], &mut values[..made.len()]);
        }
        let (weights, values) = (&weights[at - made.start..][..rows + pairs], &values[at - made.start..][..rows + pairs]);
        let (weight, value) = (&mut weight[row..][..rows], &mut value[row..][..rows]);
        for r in 0..pairs {
            weight[r] = weights[r] + weights[rows + r];
            value[r] = values[r] - values[rows + r];
        }
        for r in pairs..rows {
            (weight[r], value[r]) = (weights[r], values[r]);
        }
    }
}

/// Row weights and values of a barrier step: `W = rho` and `w = 1 / (s/z + 1/rho)`, `v = rho c` and `z + w (g - z/rho + mu/z)`, with
/// `rho = 1`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn barrier_rows<T: Real>(
    problem: &Problem<T>,
    c: &[T],
    g: &[T],
    slacks: &Slacks<T>,
    aim: BarrierTarget<T>,
    weight: &mut [T],
    value: &mut [T],
) {
    let one = T::one();
    let equalities = problem.rows.of(RowKind::Equality);
    weight[equalities.clone()].fill(one);
    value[equalities.clone()].copy_from_slice(&c[equalities]);
    per_row(problem, weight, value, |first, weights, values| {
        let count = weights.len();
        let (values, g) = (&mut values[..count], &g[first..][..count]);
        let (s, z) = (&slacks.slack[first..][..count], &slacks.multiplier[first..][..count]);
        let (ds, dz) = (&slacks.slack_step[first..][..count], &slacks.multiplier_step[first..][..count]);
        for i in 0..count {
            let w = one / (s[i] / z[i] + one);
            weights[i] = w;
            values[i] = z[i] + w * (g[i] - z[i] + aim.product(ds[i], dz[i]) / z[i]);
        }
    });
}

/// Distance from zero within which an inequality takes part in a closing step.
///
/// * `infeasibility` - at the point
/// * `attempts` - attempts refused at the point: a step may have been refused because it violates a row just beyond the distance
pub fn closing_reach<T: Real>(infeasibility: T, attempts: u32) -> T {
    let first = (T::of(CLOSING_REACH) * infeasibility.sqrt()).min(T::of(LARGEST_CLOSING_REACH));
    first * T::of(f64::from(1_u32 << (REACH_DOUBLINGS * attempts)))
}

/// Row weights and values of a closing step: the equalities and the inequalities that are violated or nearly active. The step keeps the
/// latter where they are.
///
/// * `reach` - see [`closing_reach`]
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn closing_rows<T: Real>(problem: &Problem<T>, c: &[T], g: &[T], reach: T, weight: &mut [T], value: &mut [T]) {
    let (zero, one) = (T::zero(), T::one());
    let equalities = problem.rows.of(RowKind::Equality);
    weight[equalities.clone()].fill(one);
    value[equalities.clone()].copy_from_slice(&c[equalities]);
    per_row(problem, weight, value, |first, weights, values| {
        for ((weight, value), &g) in weights.iter_mut().zip(values).zip(&g[first..]) {
            *weight = if g > -reach { one } else { zero };
            *value = if g > zero { g } else { zero };
        }
    });
}

/// Terms on single variables: diagonal `eps D + weight smoothing` and gradient `weight smoothing (x - initial)`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn variable_terms<T: Real>(
    problem: &Problem<T>,
    scaling: &[T],
    proximal: T,
    weight: T,
    x: &[T],
    diagonal: &mut [T],
    gradient: &mut [T],
) {
    let (smoothing, initial) = (&problem.smoothing[..], &problem.initial[..]);
    for i in 0..diagonal.len() {
        let smoothing = weight * smoothing[i];
        diagonal[i] = proximal * scaling[i] + smoothing;
        gradient[i] = smoothing * (x[i] - initial[i]);
    }
}
