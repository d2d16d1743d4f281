//! Products of the Jacobian with a direction.

use super::simd::dot;
use crate::nlp::Problem;
use crate::nlp::problem::Element;
use crate::real::Real;
use crate::rows::RowKind;
use crate::rows::table::Place;
use multiversion::multiversion;

/// Product `J d`: equalities in `c_change`, inequalities in `g_change`. The lower side of a two-sided row has the opposite sign.
///
/// * `local` - scratch, `[widest]`
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
pub fn jacobian_times<T: Real>(problem: &Problem<T>, jacobian: &[T], d: &[T], local: &mut [T], c_change: &mut [T], g_change: &mut [T]) {
    for element in &problem.elements {
        element_times(problem, element, jacobian, d, local, c_change, g_change);
    }
    problem.reach_rows.times(jacobian, d, c_change, g_change);
}

/// Products of the rows of one element with the direction.
#[inline(always)]
fn element_times<T: Real>(
    problem: &Problem<T>,
    element: &Element,
    jacobian: &[T],
    d: &[T],
    local: &mut [T],
    c_change: &mut [T],
    g_change: &mut [T],
) {
    let place = &element.place;
    let (rows, pairs) = (element.rows as usize, element.pairs as usize);
    let stride = place.stride as usize;
    let kind = problem.rows.kind(place.row);
    // Values of `d` for the columns of the element; the padding of Jacobian rows is zero.
    local[..stride].fill(T::zero());
    for run in &problem.runs[element.runs.range()] {
        local[run.column as usize..(run.column + run.len) as usize]
            .copy_from_slice(&d[run.variable as usize..(run.variable + run.len) as usize]);
    }
    for r in 0..rows {
        let product = dot(&jacobian[place.jacobian as usize + r * stride..][..stride], &local[..stride]);
        put(kind, place, rows, pairs, r, product, c_change, g_change);
    }
}

/// Writes the product of row `r` of an element of `rows` rows.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "both slices and the shape of the element")]
pub(super) fn put<T: Real>(
    kind: RowKind,
    place: &Place,
    rows: usize,
    pairs: usize,
    r: usize,
    product: T,
    c_change: &mut [T],
    g_change: &mut [T],
) {
    if kind != RowKind::Inequality {
        c_change[place.row as usize + r] = product;
    } else {
        let at = place.inequality as usize + r;
        g_change[at] = product;
        if r < pairs {
            g_change[at + rows] = -product;
        }
    }
}
