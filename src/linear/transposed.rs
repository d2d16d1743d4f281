//! Products of the transposed Jacobian, or of its squared values, with one value per row.

use super::lanes::LANES;
use crate::nlp::Layout;
use crate::real::Real;
use crate::rows::reach::ReachInstant;
use crate::rows::table::NONE;
use multiversion::multiversion;

/// Transposed product `out = J' v`.
///
/// * `v` - `[rows]`
/// * `local` - scratch, `[widest]`
pub fn transposed_times<T: Real>(layout: &Layout<T>, jacobian: &[T], v: &[T], local: &mut [T], out: &mut [T]) {
    by_column::<T, false>(layout, jacobian, v, local, out);
}

/// Transposed product of the squared Jacobian values: `out[j] = sum_i v[i] J[i][j]^2`.
pub fn transposed_squares_times<T: Real>(layout: &Layout<T>, jacobian: &[T], v: &[T], local: &mut [T], out: &mut [T]) {
    by_column::<T, true>(layout, jacobian, v, local, out);
}

/// Weighted column sums of the Jacobian values, or of their squares.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
fn by_column<T: Real, const SQUARED: bool>(layout: &Layout<T>, jacobian: &[T], v: &[T], local: &mut [T], out: &mut [T]) {
    out.fill(T::zero());
    for element in &layout.elements {
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
        for run in &layout.runs[element.runs.range()] {
            let (to, from, len) = (run.variable as usize, run.column as usize, run.len as usize);
            for (sum, local) in out[to..to + len].iter_mut().zip(&local[from..from + len]) {
                *sum += *local;
            }
        }
    }
    for instant in &layout.reach_instants {
        reach_by_column::<T, SQUARED>(layout, instant, jacobian, v, out);
    }
}

/// Adds the reach rows of all feet at one instant. Their sums for the pose are distributed to the blocks of the base by weight.
#[inline(always)]
fn reach_by_column<T: Real, const SQUARED: bool>(layout: &Layout<T>, instant: &ReachInstant<T>, jacobian: &[T], v: &[T], out: &mut [T]) {
    let mut pose = [T::zero(); 6];
    for foot in instant.feet.range() {
        if layout.reach_feet[foot].stride as usize == LANES {
            foot_by_column::<T, 1, SQUARED>(layout, foot, jacobian, v, &mut pose, out);
        } else {
            foot_by_column::<T, 2, SQUARED>(layout, foot, jacobian, v, &mut pose, out);
        }
    }
    let (weights, blocks) = (&instant.base.weights, &layout.base_blocks[instant.base.blocks as usize]);
    for i in (0..4).filter(|&i| blocks.front[i] != NONE) {
        let weight = if SQUARED { weights[i] * weights[i] } else { weights[i] };
        for (sum, pose) in out[blocks.variable[i] as usize..][..6].iter_mut().zip(pose) {
            *sum = weight.mul_add(pose, *sum);
        }
    }
}

/// Adds the reach rows of one foot, which have `GROUPS` times eight columns: pose columns to `pose`, the other columns to `out`.
///
/// * `number` - index in the table of feet
#[inline(always)]
fn foot_by_column<T: Real, const GROUPS: usize, const SQUARED: bool>(
    layout: &Layout<T>,
    number: usize,
    jacobian: &[T],
    v: &[T],
    pose: &mut [T; 6],
    out: &mut [T],
) {
    let foot = &layout.reach_feet[number];
    let (leg, place) = (&layout.reach_legs[foot.leg as usize], layout.reach_place(number));
    let mut local = [[T::zero(); LANES]; GROUPS];
    for r in 0..3 {
        let values = &jacobian[place.jacobian as usize + r * GROUPS * LANES..][..GROUPS * LANES];
        for (sums, values) in local.iter_mut().zip(values.chunks_exact(LANES)) {
            add_row::<T, SQUARED>(sums, values, v[place.row as usize + r]);
        }
    }
    let columns = local.as_flattened();
    for (sum, value) in pose.iter_mut().zip(columns) {
        *sum += *value;
    }
    for own in 0..3 {
        let Some(run) = leg.own_run(own, &layout.footholds) else { continue };
        for i in 0..run.len as usize {
            out[run.variable as usize + i] += columns[run.column as usize + i];
        }
    }
}

/// Adds eight values of a row, or their squares, times `v`.
#[inline(always)]
fn add_row<T: Real, const SQUARED: bool>(sums: &mut [T], values: &[T], v: T) {
    for l in 0..LANES {
        let value = if SQUARED { values[l] * values[l] } else { values[l] };
        sums[l] = v.mul_add(value, sums[l]);
    }
}
