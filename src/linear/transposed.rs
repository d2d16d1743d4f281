//! Products of the transposed Jacobian with values of the rows.

use crate::nlp::Layout;
use crate::real::Real;
use multiversion::multiversion;

/// Transposed product `out = J' v`.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
pub fn transposed_times<T: Real>(layout: &Layout<T>, jacobian: &[T], v: &[T], local: &mut [T], out: &mut [T]) {
    out.fill(T::zero());
    for element in &layout.elements {
        let place = &element.place;
        let (row, stride) = (place.row as usize, place.stride as usize);
        local[..stride].fill(T::zero());
        for r in 0..element.rows as usize {
            let v = v[row + r];
            let values = &jacobian[place.jacobian as usize + r * stride..][..stride];
            for (sum, value) in local[..stride].chunks_exact_mut(8).zip(values.chunks_exact(8)) {
                for l in 0..8 {
                    sum[l] = v.mul_add(value[l], sum[l]);
                }
            }
        }
        for run in &layout.runs[element.runs.range()] {
            let (to, from, len) = (run.variable as usize, run.column as usize, run.len as usize);
            for (sum, local) in out[to..to + len].iter_mut().zip(&local[from..from + len]) {
                *sum = run.weight.mul_add(*local, *sum);
            }
        }
    }
}
