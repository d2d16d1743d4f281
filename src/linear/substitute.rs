//! Back substitution with a factor: computes the direction from the substituted right-hand side.

use super::front::Factor;
use super::simd::dot;
use crate::nlp::Problem;
use crate::real::Real;
use multiversion::multiversion;

/// Back substitution after [`factorise`](super::front::factorise) or [`forward`](super::forward::forward).
///
/// * `direction` - out, `d`, `[variables]`
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
pub fn substitute<T: Real>(problem: &Problem<T>, factor: &mut Factor<T>, direction: &mut [T]) {
    let local = &mut factor.local;
    for step in problem.steps.iter().rev() {
        let (size, pivots) = (step.size as usize, step.pivots as usize);
        for run in &problem.front_runs[step.rest.range()] {
            let (at, variable, len) = (run.front as usize, run.variable as usize, run.len as usize);
            local[at..at + len].copy_from_slice(&direction[variable..variable + len]);
        }
        for i in (0..pivots).rev() {
            let row = &factor.pivot_rows[step.factor as usize + i * step.stride as usize..][..size + 1];
            let rest = dot(&row[i + 1..size], &local[i + 1..size]);
            local[i] = (row[size] - rest) / row[i];
        }
        let first = step.variable as usize;
        direction[first..first + pivots].copy_from_slice(&local[..pivots]);
    }
}
