//! Reach rows in the normal equations. Contributions of all feet in a step to the blocks of the base and to the columns of footholds and
//! swing heights are summed before they are added to the front.

use super::front::{NormalEquations, tile_of};
use super::lanes::LANES;
use crate::nlp::Layout;
use crate::real::Real;
use crate::rows::reach::{POSE, ReachInstant, ReachLeg};
use crate::rows::table::{NONE, Place};
use multiversion::multiversion;

/// Pairs of base blocks, upper triangle.
const PAIRS: [(usize, usize); 10] = [(0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3)];

/// Sums over the feet at one reach instant with respect to the base pose.
struct ByPose<T> {
    /// `P' W P` by rows; the last two columns are unused.
    products: [[T; LANES]; POSE],
    /// `P' v`; the last two values are unused.
    values: [T; LANES],
}

/// Sums over the instants of a step for the columns of one leg: footholds and swing height.
#[derive(Debug)]
struct ByOwn<T> {
    /// Index of the leg.
    leg: u32,
    /// Index in the front and column in the rows of each variable: two per foothold, one per swing height.
    slots: [(usize, usize); 5],
    count: usize,
    columns: [OwnColumn<T>; 5],
}

/// Sums for one column `a` of a leg.
#[derive(Debug, Clone, Copy)]
struct OwnColumn<T> {
    /// `w_i P' W a` for each base block; the last two values are unused.
    by_base: [[T; LANES]; 4],
    /// Products with all columns of the rows; those with the pose columns are unused.
    by_own: [T; 2 * LANES],
    /// `a' v`.
    value: T,
}

impl<T: Real> ByOwn<T> {
    fn none() -> Self {
        let zero = T::zero();
        let nothing = OwnColumn { by_base: [[zero; LANES]; 4], by_own: [zero; 2 * LANES], value: zero };
        ByOwn { leg: NONE, slots: [(0, 0); 5], count: 0, columns: [nothing; 5] }
    }

    /// Resets the sums for a leg.
    fn begin(&mut self, number: u32, leg: &ReachLeg<T>) {
        *self = ByOwn { leg: number, count: 0, ..Self::none() };
        let columns = [leg.foothold_column[0], leg.foothold_column[1], leg.height_column];
        for ((slot, column), len) in leg.front.into_iter().zip(columns).zip([2, 2, 1]).filter(|((slot, _), _)| *slot != NONE) {
            for d in 0..len {
                self.slots[self.count] = ((slot + d) as usize, (column + d) as usize);
                self.count += 1;
            }
        }
    }

    /// Adds the sums to the front.
    #[inline(always)]
    fn add(&self, blocks: &[u32; 4], front: &mut [T], size: usize, stride: usize) {
        let slots = &self.slots[..self.count];
        for (column, &(slot, _)) in self.columns.iter().zip(slots) {
            front[slot * stride + size] -= column.value;
            for (&block, sums) in blocks.iter().zip(&column.by_base).filter(|(block, _)| **block != NONE) {
                let block = block as usize;
                // Only the upper triangle is stored.
                if block > slot {
                    let line = &mut front[slot * stride + block..][..POSE];
                    for c in 0..POSE {
                        line[c] += sums[c];
                    }
                } else {
                    for c in 0..POSE {
                        front[(block + c) * stride + slot] += sums[c];
                    }
                }
            }
            for &(other, of_row) in slots.iter().filter(|(other, _)| *other >= slot) {
                front[slot * stride + other] += column.by_own[of_row];
            }
        }
    }
}

/// Sums of the legs in one step. Only the first `used` are valid; the rest is kept for reuse.
#[derive(Debug)]
pub(super) struct OwnSums<T> {
    legs: Vec<ByOwn<T>>,
    used: usize,
}

impl<T> Default for OwnSums<T> {
    fn default() -> Self {
        OwnSums { legs: Vec::new(), used: 0 }
    }
}

impl<T: Real> OwnSums<T> {
    /// Sums of a leg, reset when the leg first occurs in the step.
    #[inline(always)]
    fn of(&mut self, leg: u32, legs: &[ReachLeg<T>]) -> &mut ByOwn<T> {
        let at = self.legs[..self.used].iter().rposition(|own| own.leg == leg).unwrap_or_else(|| self.begin(leg, legs));
        &mut self.legs[at]
    }

    fn begin(&mut self, leg: u32, legs: &[ReachLeg<T>]) -> usize {
        if self.used == self.legs.len() {
            self.legs.push(ByOwn::none());
        }
        self.legs[self.used].begin(leg, &legs[leg as usize]);
        self.used += 1;
        self.used - 1
    }
}

/// Adds `J' W J` and `-J' v` of the reach rows of all feet at the instants of one step, which share their base blocks.
///
/// Rows depend on the base only through its pose, with weights `w` that all feet at an instant share. With `P` the columns for the pose and
/// `A` those for footholds and swing height, the base block of coefficients `i` and `j` is `w_i w_j sum P' W P`, and the block of a
/// coefficient and a foot is `w_i P' W A`.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
pub(super) fn assemble_reach<T: Real>(
    layout: &Layout<T>,
    instants: &[ReachInstant<T>],
    system: &NormalEquations<T>,
    front: &mut [T],
    size: usize,
    stride: usize,
    own: &mut OwnSums<T>,
) {
    let mut slots = [NONE; 4];
    let mut sums = [[[T::zero(); LANES]; POSE]; PAIRS.len()];
    let mut values = [[T::zero(); LANES]; 4];
    own.used = 0;
    for instant in instants {
        let (weights, blocks) = (instant.base.weights, &layout.base_blocks[instant.base.blocks as usize]);
        for i in 0..4 {
            if blocks.front[i] != NONE {
                slots[i] = blocks.front[i];
            }
        }
        let mut by_pose = ByPose { products: [[T::zero(); LANES]; POSE], values: [T::zero(); LANES] };
        for number in instant.feet.range() {
            let foot = &layout.reach_feet[number];
            let (place, of_leg) = (layout.reach_place(number), (foot.leg, &layout.reach_legs[..]));
            if foot.stride as usize == LANES {
                add_foot::<T, LANES>(place, of_leg, &weights, system, &mut by_pose, own);
            } else {
                add_foot::<T, { 2 * LANES }>(place, of_leg, &weights, system, &mut by_pose, own);
            }
        }
        for (sum, (i, j)) in sums.iter_mut().zip(PAIRS) {
            let w = weights[i] * weights[j];
            if w != T::zero() {
                for c in 0..POSE {
                    for l in 0..LANES {
                        sum[c][l] = w.mul_add(by_pose.products[c][l], sum[c][l]);
                    }
                }
            }
        }
        for i in 0..4 {
            for l in 0..LANES {
                values[i][l] = weights[i].mul_add(by_pose.values[l], values[i][l]);
            }
        }
    }
    for own in &own.legs[..own.used] {
        own.add(&slots, front, size, stride);
    }
    for i in (0..4).filter(|&i| slots[i] != NONE) {
        for c in 0..POSE {
            front[(slots[i] as usize + c) * stride + size] -= values[i][c];
        }
    }
    for (sum, (i, j)) in sums.iter().zip(PAIRS).filter(|(_, (i, j))| slots[*i] != NONE && slots[*j] != NONE) {
        // The sums are symmetric, so the pair may be swapped into the upper triangle.
        let (row, column) = (slots[i].min(slots[j]) as usize, slots[i].max(slots[j]) as usize);
        for c in 0..POSE {
            let line = &mut front[(row + c) * stride + column..][..POSE];
            for d in 0..POSE {
                line[d] += sum[c][d];
            }
        }
    }
}

/// Adds the contributions of a foot's rows to the sums of the pose and of the leg. `W` columns: pose, footholds and swing height, padding.
///
/// * `weights` - weights of the base blocks
#[inline(always)]
fn add_foot<T: Real, const W: usize>(
    place: Place,
    (leg, legs): (u32, &[ReachLeg<T>]),
    weights: &[T; 4],
    system: &NormalEquations<T>,
    by_pose: &mut ByPose<T>,
    own: &mut OwnSums<T>,
) {
    let row = place.row as usize;
    let (w, v): ([T; 3], [T; 3]) = (tile_of(&system.weight[row..]), tile_of(&system.value[row..]));
    if w == [T::zero(); 3] {
        return;
    }
    let rows: [[T; W]; 3] = std::array::from_fn(|r| tile_of(&system.jacobian[place.jacobian as usize + r * W..]));
    let mut weighted = rows;
    for r in 0..3 {
        for l in 0..W {
            weighted[r][l] *= w[r];
        }
    }
    for c in 0..POSE {
        let products = column_products(&weighted, &rows, c);
        for l in 0..LANES {
            by_pose.products[c][l] += products[l];
        }
    }
    let values = combined(v, &rows);
    for l in 0..LANES {
        by_pose.values[l] += values[l];
    }
    let own = own.of(leg, legs);
    for (sum, &(_, column)) in own.columns.iter_mut().zip(&own.slots[..own.count]) {
        let products = column_products(&weighted, &rows, column);
        sum.value += values[column];
        for (by_base, weight) in sum.by_base.iter_mut().zip(weights) {
            for l in 0..LANES {
                by_base[l] = weight.mul_add(products[l], by_base[l]);
            }
        }
        for (sum, product) in sum.by_own.iter_mut().zip(products) {
            *sum += product;
        }
    }
}

/// Products of one column of three weighted rows with all columns of the rows.
#[inline(always)]
fn column_products<T: Real, const W: usize>(weighted: &[[T; W]; 3], rows: &[[T; W]; 3], column: usize) -> [T; W] {
    combined(std::array::from_fn(|r| weighted[r][column]), rows)
}

/// `sum_r left[r] rows[r]`.
#[inline(always)]
fn combined<T: Real, const W: usize>(left: [T; 3], rows: &[[T; W]; 3]) -> [T; W] {
    let mut sums = [T::zero(); W];
    for l in 0..W {
        sums[l] = left[2].mul_add(rows[2][l], left[1].mul_add(rows[1][l], left[0] * rows[0][l]));
    }
    sums
}
