//! Products of the Jacobian with a direction.

use super::front::dot;
use crate::nlp::Layout;
use crate::real::Real;
use multiversion::multiversion;

/// Products `J d`: for equalities in `c_change`, for inequalities (with the sign of their side) in `g_change`.
///
/// * `local` - scratch, `[widest]`
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
pub fn jacobian_times<T: Real>(layout: &Layout<T>, jacobian: &[T], d: &[T], local: &mut [T], c_change: &mut [T], g_change: &mut [T]) {
    for element in &layout.elements {
        let place = &element.place;
        let (rows, pairs) = (element.rows as usize, element.pairs as usize);
        let (row, at, stride) = (place.row as usize, place.inequality as usize, place.stride as usize);
        // The element's part of d; the padding of Jacobian rows is zero.
        local[..stride].fill(T::zero());
        for run in &layout.runs[element.runs.range()] {
            local[run.column as usize..(run.column + run.len) as usize]
                .copy_from_slice(&d[run.variable as usize..(run.variable + run.len) as usize]);
        }
        for r in 0..rows {
            let product = dot(&jacobian[place.jacobian as usize + r * stride..][..stride], &local[..stride]);
            if row < layout.equalities {
                c_change[row + r] = product;
            } else {
                g_change[at + r] = product;
                if r < pairs {
                    g_change[at + rows + r] = -product;
                }
            }
        }
    }
}
