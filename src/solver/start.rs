//! The start of a solve: column scaling, first slacks and multipliers.

use super::slacks::Slacks;
use crate::nlp::Layout;
use crate::real::Real;
use multiversion::multiversion;

/// Column scaling `D_j = sum_eq J_ij^2 + 1/2 sum_ineq J_ij^2`, at least 1e-2.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn column_scaling<T: Real>(layout: &Layout<T>, jacobian: &[T], diagonal: &mut [T]) {
    diagonal.fill(T::zero());
    for element in &layout.elements {
        let place = &element.place;
        for r in 0..element.rows as usize {
            // A two-sided row counts twice.
            let sides = if (place.row as usize) < layout.equalities || r < element.pairs as usize { T::one() } else { T::of(0.5) };
            let row = &jacobian[place.jacobian as usize + r * place.stride as usize..][..place.stride as usize];
            for run in &layout.runs[element.runs.range()] {
                for i in 0..run.len as usize {
                    let v = run.weight * row[run.column as usize + i];
                    diagonal[run.variable as usize + i] += sides * v * v;
                }
            }
        }
    }
    for d in diagonal {
        *d = d.max(T::of(1e-2));
    }
}

/// First slacks, `max(|g|, sqrt(mu / 5))`, and the multipliers that go with the barrier parameter.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn start_slacks<T: Real>(g: &[T], mu: T, slacks: &mut Slacks<T>) {
    // At the default barrier 0.1; what starts near its end starts with small slacks, too.
    let least = (T::of(0.2) * mu).sqrt();
    for i in 0..g.len() {
        let s = g[i].abs().max(least);
        slacks.slack[i] = s;
        slacks.multiplier[i] = mu / s;
    }
}
