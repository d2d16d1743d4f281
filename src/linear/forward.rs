//! Forward substitution with an existing factor for a new right-hand side.

use super::front::Factor;
use crate::nlp::Problem;
use crate::real::Real;
use multiversion::multiversion;

/// Replaces the right-hand side after [`factorise`](super::front::factorise) by forward substitution of `-(u + J' v)`.
///
/// * `gradient` - `u + J' v`, `[variables]`; overwritten
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
pub fn forward<T: Real>(problem: &Problem<T>, factor: &mut Factor<T>, gradient: &mut [T]) {
    let local = &mut factor.local;
    for step in &problem.steps {
        let (size, pivots, first) = (step.size as usize, step.pivots as usize, step.variable as usize);
        // Contributions of the pivots to the variables that remain in the front.
        local[..size].fill(T::zero());
        for i in 0..pivots {
            let row = &mut factor.pivot_rows[step.factor as usize + i * step.stride as usize..][..size + 1];
            let value = (-gradient[first + i] - local[i]) / row[i];
            row[size] = value;
            for (sum, &left) in local[i + 1..size].iter_mut().zip(&row[i + 1..size]) {
                *sum = left.mul_add(value, *sum);
            }
        }
        for run in &problem.front_runs[step.rest.range()] {
            let (at, variable, len) = (run.front as usize, run.variable as usize, run.len as usize);
            for i in 0..len {
                gradient[variable + i] += local[at + i];
            }
        }
    }
}
