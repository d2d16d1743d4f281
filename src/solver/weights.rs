//! Weights and values of the rows in the normal equations, and what falls on single variables.

use super::slacks::{Aim, Slacks};
use crate::nlp::Layout;
use crate::real::Real;
use multiversion::multiversion;

/// Spreads values of the inequalities over their Jacobian rows: `out[row] = upper +- lower`.
#[inline(always)]
fn per_row<T: Real>(layout: &Layout<T>, weight: &mut [T], value: &mut [T], of: impl Fn(usize) -> (T, T)) {
    for element in &layout.elements {
        let (rows, pairs) = (element.rows as usize, element.pairs as usize);
        let (row, at) = (element.place.row as usize, element.place.inequality as usize);
        if row < layout.equalities {
            continue;
        }
        for r in 0..rows {
            let (mut w, mut v) = of(at + r);
            if r < pairs {
                let lower = of(at + rows + r);
                w += lower.0;
                v -= lower.1;
            }
            weight[row + r] = w;
            value[row + r] = v;
        }
    }
}

/// Row weights of a barrier step: `W = rho` and `w = 1 / (s/z + 1/rho)`, `v = rho c` and `z + w (g - z/rho + mu/z)`, with `rho = 1`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn barrier_rows<T: Real>(layout: &Layout<T>, c: &[T], g: &[T], slacks: &Slacks<T>, aim: Aim<T>, weight: &mut [T], value: &mut [T]) {
    let one = T::one();
    weight[..layout.equalities].fill(one);
    value[..layout.equalities].copy_from_slice(c);
    per_row(layout, weight, value, |i| {
        let (s, z) = (slacks.slack[i], slacks.multiplier[i]);
        let w = one / (s / z + one);
        (w, z + w * (g[i] - z + aim.product(slacks, i) / z))
    });
}

/// Row weights of a closing step: the equalities and the violated inequalities.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn closing_rows<T: Real>(layout: &Layout<T>, c: &[T], g: &[T], weight: &mut [T], value: &mut [T]) {
    let (zero, one) = (T::zero(), T::one());
    weight[..layout.equalities].fill(one);
    value[..layout.equalities].copy_from_slice(c);
    per_row(layout, weight, value, |i| if g[i] > zero { (one, g[i]) } else { (zero, zero) });
}

/// What falls on single variables: `eps D + weight smoothing` and `weight smoothing (x - initial)`.
#[multiversion(targets("x86_64+avx2+fma"))]
#[allow(clippy::too_many_arguments, reason = "separate slices: the compiler knows that they do not overlap")]
pub fn variable_terms<T: Real>(
    scaling: &[T],
    proximal: T,
    smoothing: &[T],
    weight: T,
    x: &[T],
    initial: &[T],
    diagonal: &mut [T],
    gradient: &mut [T],
) {
    for i in 0..diagonal.len() {
        let smoothing = weight * smoothing[i];
        diagonal[i] = proximal * scaling[i] + smoothing;
        gradient[i] = smoothing * (x[i] - initial[i]);
    }
}
