//! Products of the transposed Jacobian, or of its squared values, with one value per row.

use super::simd::LANES;
use crate::nlp::Problem;
use crate::real::Real;
use multiversion::multiversion;

/// Transposed product `out = J' v`.
///
/// * `v` - `[rows]`
/// * `local` - scratch, `[widest]`
pub fn transposed_times<T: Real>(problem: &Problem<T>, jacobian: &[T], v: &[T], local: &mut [T], out: &mut [T]) {
    by_column::<T, false>(problem, jacobian, v, local, out);
}

/// Transposed product of the squared Jacobian values: `out[j] = sum_i v[i] J[i][j]^2`.
pub fn transposed_squares_times<T: Real>(problem: &Problem<T>, jacobian: &[T], v: &[T], local: &mut [T], out: &mut [T]) {
    by_column::<T, true>(problem, jacobian, v, local, out);
}

/// Weighted column sums of the Jacobian values, or of their squares.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
fn by_column<T: Real, const SQUARED: bool>(problem: &Problem<T>, jacobian: &[T], v: &[T], local: &mut [T], out: &mut [T]) {
    out.fill(T::zero());
    for element in &problem.elements {
        let place = &element.place;
        let (row, stride) = (place.row as usize, place.stride as usize);
        let local = &mut local[..stride];
        local.fill(T::zero());
        for r in 0..element.rows as usize {
            let values = &jacobian[place.jacobian as usize + r * stride..][..stride];
            for (sums, values) in local.chunks_exact_mut(LANES).zip(values.chunks_exact(LANES)) {
                add_row::<T, SQUARED>(sums, values, v[row + r]);
            }
        }
        for run in &problem.runs[element.runs.range()] {
            let (to, from, len) = (run.variable as usize, run.column as usize, run.len as usize);
            for (sum, local) in out[to..to + len].iter_mut().zip(&local[from..from + len]) {
                *sum += *local;
            }
        }
    }
    problem.reach_rows.by_column::<SQUARED>(jacobian, v, out);
}

/// Adds eight values of a row, or their squares, times `v`.
#[inline(always)]
pub(super) fn add_row<T: Real, const SQUARED: bool>(sums: &mut [T], values: &[T], v: T) {
    for l in 0..LANES {
        let value = if SQUARED { values[l] * values[l] } else { values[l] };
        sums[l] = v.mul_add(value, sums[l]);
    }
}
