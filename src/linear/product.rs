//! Products of the Jacobian with a direction.

use super::lanes::{LANES, dot};
use crate::nlp::Layout;
use crate::nlp::layout::Element;
use crate::real::Real;
use crate::rows::RowKind;
use crate::rows::reach::ReachInstant;
use crate::rows::table::NONE;
use multiversion::multiversion;

/// Product `J d`: equalities in `c_change`, inequalities in `g_change`. The lower side of a two-sided row has the opposite sign.
///
/// * `local` - scratch, `[widest]`
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
pub fn jacobian_times<T: Real>(layout: &Layout<T>, jacobian: &[T], d: &[T], local: &mut [T], c_change: &mut [T], g_change: &mut [T]) {
    for element in &layout.elements {
        element_times(layout, element, jacobian, d, local, c_change, g_change);
    }
    for instant in &layout.reach_instants {
        reach_times(layout, instant, jacobian, d, g_change);
    }
}

/// Products of the rows of one element with the direction.
#[inline(always)]
fn element_times<T: Real>(
    layout: &Layout<T>,
    element: &Element,
    jacobian: &[T],
    d: &[T],
    local: &mut [T],
    c_change: &mut [T],
    g_change: &mut [T],
) {
    let place = &element.place;
    let (rows, pairs) = (element.rows as usize, element.pairs as usize);
    let (row, at, stride) = (place.row as usize, place.inequality as usize, place.stride as usize);
    let kind = layout.rows.kind(place.row);
    // Values of `d` for the columns of the element; the padding of Jacobian rows is zero.
    local[..stride].fill(T::zero());
    for run in &layout.runs[element.runs.range()] {
        local[run.column as usize..(run.column + run.len) as usize]
            .copy_from_slice(&d[run.variable as usize..(run.variable + run.len) as usize]);
    }
    for r in 0..rows {
        let product = dot(&jacobian[place.jacobian as usize + r * stride..][..stride], &local[..stride]);
        if kind != RowKind::Inequality {
            c_change[row + r] = product;
        } else {
            g_change[at + r] = product;
            if r < pairs {
                g_change[at + rows + r] = -product;
            }
        }
    }
}

/// Products of the reach rows of all feet at one instant, for which the change of the base pose is computed once.
#[inline(always)]
fn reach_times<T: Real>(layout: &Layout<T>, instant: &ReachInstant<T>, jacobian: &[T], d: &[T], g_change: &mut [T]) {
    let (weights, blocks) = (&instant.base.weights, &layout.base_blocks[instant.base.blocks as usize]);
    let mut pose = [T::zero(); 6];
    for i in (0..4).filter(|&i| blocks.front[i] != NONE) {
        let block = &d[blocks.variable[i] as usize..][..6];
        for c in 0..6 {
            pose[c] = weights[i].mul_add(block[c], pose[c]);
        }
    }
    for foot in instant.feet.range() {
        if layout.reach_feet[foot].stride as usize == LANES {
            foot_times::<T, 1>(layout, foot, &pose, jacobian, d, g_change);
        } else {
            foot_times::<T, 2>(layout, foot, &pose, jacobian, d, g_change);
        }
    }
}

/// Products of the reach rows of one foot, which have `GROUPS` times eight columns.
///
/// * `number` - index in the table of feet
#[inline(always)]
fn foot_times<T: Real, const GROUPS: usize>(layout: &Layout<T>, number: usize, pose: &[T; 6], jacobian: &[T], d: &[T], g_change: &mut [T]) {
    let foot = &layout.reach_feet[number];
    let (leg, place) = (&layout.reach_legs[foot.leg as usize], layout.reach_place(number));
    let mut local = [[T::zero(); LANES]; GROUPS];
    let columns = local.as_flattened_mut();
    columns[..6].copy_from_slice(pose);
    for own in 0..3 {
        let Some(run) = leg.own_run(own, &layout.footholds) else { continue };
        for i in 0..run.len as usize {
            columns[run.column as usize + i] = d[run.variable as usize + i];
        }
    }
    let (first, at) = (place.jacobian as usize, place.inequality as usize);
    for r in 0..3 {
        let product = dot(&jacobian[first + r * GROUPS * LANES..][..GROUPS * LANES], local.as_flattened());
        g_change[at + r] = product;
        g_change[at + 3 + r] = -product;
    }
}
