//! Factored rows in products and in the normal equations, see [`crate::rows::factored`].
//!
//! A product computes the change of the pose once per instant; a transposed product sums over the elements of an instant before it
//! distributes the sum to the base blocks. In the normal equations, the contributions of all elements in a step to the base blocks and to
//! their own columns are summed before they are added to the front.

use super::product::put;
use super::simd::{LANES, dot, tile_of};
use super::transposed::add_row;
use super::{NormalEquations, Shape};
use crate::real::Real;
use crate::rows::factored::{FactoredInstant, FactoredRows, OWN_COLUMNS, OwnColumns, POSE, POSE_BLOCKS};
use crate::rows::table::{NONE, Place};
use multiversion::multiversion;

impl<T: Real, const R: usize> FactoredRows<T, R> {
    /// Products of the rows with a direction `d`, as [`jacobian_times`](super::product::jacobian_times).
    #[inline(always)]
    pub(super) fn times(&self, jacobian: &[T], d: &[T], c_change: &mut [T], g_change: &mut [T]) {
        for instant in &self.instants {
            let mut pose = [T::zero(); POSE];
            for (i, run) in self.blocks_of(instant).present() {
                let block = &d[run.variable as usize..][..POSE];
                for c in 0..POSE {
                    pose[c] = instant.weights[i].mul_add(block[c], pose[c]);
                }
            }
            for number in instant.elements.range() {
                if self.elements[number].stride as usize == LANES {
                    self.element_times::<1>(number, &pose, jacobian, d, c_change, g_change);
                } else {
                    self.element_times::<2>(number, &pose, jacobian, d, c_change, g_change);
                }
            }
        }
    }

    /// Products of the rows of one element, which have `GROUPS` times eight columns.
    #[inline(always)]
    fn element_times<const GROUPS: usize>(
        &self,
        number: usize,
        pose: &[T; POSE],
        jacobian: &[T],
        d: &[T],
        c_change: &mut [T],
        g_change: &mut [T],
    ) {
        let place = self.place(number);
        let mut local = [[T::zero(); LANES]; GROUPS];
        let columns = local.as_flattened_mut();
        columns[..POSE].copy_from_slice(pose);
        for run in &self.own[self.elements[number].own as usize].runs {
            for i in 0..run.len as usize {
                columns[run.column as usize + i] = d[run.variable as usize + i];
            }
        }
        let first = place.jacobian as usize;
        for r in 0..R {
            let product = dot(&jacobian[first + r * GROUPS * LANES..][..GROUPS * LANES], local.as_flattened());
            put(self.spec.kind, &place, R, self.spec.pairs, r, product, c_change, g_change);
        }
    }

    /// Adds the column sums of the rows, weighted by `v`, or those of their squares.
    #[inline(always)]
    pub(super) fn by_column<const SQUARED: bool>(&self, jacobian: &[T], v: &[T], out: &mut [T]) {
        for instant in &self.instants {
            let mut pose = [T::zero(); POSE];
            for number in instant.elements.range() {
                if self.elements[number].stride as usize == LANES {
                    self.element_by_column::<1, SQUARED>(number, jacobian, v, &mut pose, out);
                } else {
                    self.element_by_column::<2, SQUARED>(number, jacobian, v, &mut pose, out);
                }
            }
            for (i, run) in self.blocks_of(instant).present() {
                let weight = if SQUARED { instant.weights[i] * instant.weights[i] } else { instant.weights[i] };
                for (sum, pose) in out[run.variable as usize..][..POSE].iter_mut().zip(pose) {
                    *sum = weight.mul_add(pose, *sum);
                }
            }
        }
    }

    /// Adds the rows of one element, which have `GROUPS` times eight columns: pose columns to `pose`, the other columns to `out`.
    #[inline(always)]
    fn element_by_column<const GROUPS: usize, const SQUARED: bool>(
        &self,
        number: usize,
        jacobian: &[T],
        v: &[T],
        pose: &mut [T; POSE],
        out: &mut [T],
    ) {
        let place = self.place(number);
        let mut local = [[T::zero(); LANES]; GROUPS];
        for r in 0..R {
            let values = &jacobian[place.jacobian as usize + r * GROUPS * LANES..][..GROUPS * LANES];
            for (sums, values) in local.iter_mut().zip(values.chunks_exact(LANES)) {
                add_row::<T, SQUARED>(sums, values, v[place.row as usize + r]);
            }
        }
        let columns = local.as_flattened();
        for (sum, value) in pose.iter_mut().zip(columns) {
            *sum += *value;
        }
        for run in &self.own[self.elements[number].own as usize].runs {
            for i in 0..run.len as usize {
                out[run.variable as usize + i] += columns[run.column as usize + i];
            }
        }
    }

    /// Adds `J' W J` and `-J' v` of the rows of one step of the sweep to the front.
    pub(super) fn assemble(&self, step: usize, system: &NormalEquations<T>, front: &mut [T], shape: Shape, own: &mut OwnSums<T>) {
        let instants = &self.instants[self.steps[step].range()];
        if !instants.is_empty() {
            assemble(self, instants, system, front, shape, own);
        }
    }
}

/// Pairs of base blocks, upper triangle.
const PAIRS: [(usize, usize); 10] = [(0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3)];

/// Sums over the elements at one instant with respect to the pose.
struct ByPose<T> {
    /// `P' W P` by rows; the last two columns are unused.
    products: [[T; LANES]; POSE],
    /// `P' v`; the last two values are unused.
    values: [T; LANES],
}

/// Sums over the instants of a step for own columns.
#[derive(Debug)]
struct ByOwn<T> {
    /// Index of the own columns.
    own: u32,
    /// Index in the front and column in the rows of each variable.
    at: [(usize, usize); OWN_COLUMNS],
    count: usize,
    columns: [OwnColumn<T>; OWN_COLUMNS],
}

/// Sums for one own column `a`.
#[derive(Debug, Clone, Copy)]
struct OwnColumn<T> {
    /// `w_i P' W a` for each base block; the last two values are unused.
    by_base: [[T; LANES]; POSE_BLOCKS],
    /// Products with all columns of the rows; those with the pose columns are unused.
    by_own: [T; 2 * LANES],
    /// `a' v`.
    value: T,
}

impl<T: Real> ByOwn<T> {
    fn none() -> Self {
        let zero = T::zero();
        let nothing = OwnColumn { by_base: [[zero; LANES]; POSE_BLOCKS], by_own: [zero; 2 * LANES], value: zero };
        ByOwn { own: NONE, at: [(0, 0); OWN_COLUMNS], count: 0, columns: [nothing; OWN_COLUMNS] }
    }

    /// Resets the sums for own columns.
    fn begin(&mut self, number: u32, own: &OwnColumns) {
        *self = ByOwn { own: number, count: 0, ..Self::none() };
        for run in &own.runs {
            for d in 0..run.len {
                self.at[self.count] = ((run.front + d) as usize, (run.column + d) as usize);
                self.count += 1;
            }
        }
    }

    /// Adds the sums to the front.
    #[inline(always)]
    fn add(&self, blocks: &[u32; POSE_BLOCKS], front: &mut [T], Shape { size, stride }: Shape) {
        let at = &self.at[..self.count];
        for (column, &(own, _)) in self.columns.iter().zip(at) {
            front[own * stride + size] -= column.value;
            for (&block, sums) in blocks.iter().zip(&column.by_base).filter(|(block, _)| **block != NONE) {
                let block = block as usize;
                // Only the upper triangle is stored.
                if block > own {
                    let line = &mut front[own * stride + block..][..POSE];
                    for c in 0..POSE {
                        line[c] += sums[c];
                    }
                } else {
                    for c in 0..POSE {
                        front[(block + c) * stride + own] += sums[c];
                    }
                }
            }
            for &(other, of_row) in at.iter().filter(|(other, _)| *other >= own) {
                front[own * stride + other] += column.by_own[of_row];
            }
        }
    }
}

/// Sums for all own columns in one step. Only the first `used` are valid; the rest is kept for reuse.
#[derive(Debug)]
pub(super) struct OwnSums<T> {
    all: Vec<ByOwn<T>>,
    used: usize,
}

impl<T> Default for OwnSums<T> {
    fn default() -> Self {
        OwnSums { all: Vec::new(), used: 0 }
    }
}

impl<T: Real> OwnSums<T> {
    /// Sums for own columns, reset when these first occur in the step.
    #[inline(always)]
    fn of(&mut self, number: u32, own: &[OwnColumns]) -> &mut ByOwn<T> {
        let at = self.all[..self.used].iter().rposition(|sums| sums.own == number).unwrap_or_else(|| self.begin(number, own));
        &mut self.all[at]
    }

    fn begin(&mut self, number: u32, own: &[OwnColumns]) -> usize {
        if self.used == self.all.len() {
            self.all.push(ByOwn::none());
        }
        self.all[self.used].begin(number, &own[number as usize]);
        self.used += 1;
        self.used - 1
    }
}

/// Implementation of [`FactoredRows::assemble`] for the instants of one step, which share their base blocks.
///
/// With the weights `w` of an instant, the factors `P` and the own columns `A`, the block of base blocks `i` and `j` is
/// `w_i w_j sum P' W P`, and that of base block `i` and own columns is `w_i P' W A`.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
fn assemble<T: Real, const R: usize>(
    rows: &FactoredRows<T, R>,
    instants: &[FactoredInstant<T>],
    system: &NormalEquations<T>,
    front: &mut [T],
    shape: Shape,
    own: &mut OwnSums<T>,
) {
    let Shape { size, stride } = shape;
    let mut at = [NONE; POSE_BLOCKS];
    let mut sums = [[[T::zero(); LANES]; POSE]; PAIRS.len()];
    let mut values = [[T::zero(); LANES]; POSE_BLOCKS];
    own.used = 0;
    for instant in instants {
        let weights = instant.weights;
        for (i, run) in rows.blocks_of(instant).present() {
            at[i] = run.front;
        }
        let mut by_pose = ByPose { products: [[T::zero(); LANES]; POSE], values: [T::zero(); LANES] };
        for number in instant.elements.range() {
            let element = &rows.elements[number];
            let (place, of_own) = (rows.place(number), (element.own, &rows.own[..]));
            if element.stride as usize == LANES {
                add_element::<T, R, LANES>(place, of_own, &weights, system, &mut by_pose, own);
            } else {
                add_element::<T, R, { 2 * LANES }>(place, of_own, &weights, system, &mut by_pose, own);
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
        for i in 0..POSE_BLOCKS {
            for l in 0..LANES {
                values[i][l] = weights[i].mul_add(by_pose.values[l], values[i][l]);
            }
        }
    }
    for own in &own.all[..own.used] {
        own.add(&at, front, shape);
    }
    for i in (0..POSE_BLOCKS).filter(|&i| at[i] != NONE) {
        for c in 0..POSE {
            front[(at[i] as usize + c) * stride + size] -= values[i][c];
        }
    }
    for (sum, (i, j)) in sums.iter().zip(PAIRS).filter(|(_, (i, j))| at[*i] != NONE && at[*j] != NONE) {
        // The sums are symmetric, so the pair may be swapped into the upper triangle.
        let (row, column) = (at[i].min(at[j]) as usize, at[i].max(at[j]) as usize);
        for c in 0..POSE {
            let line = &mut front[(row + c) * stride + column..][..POSE];
            for d in 0..POSE {
                line[d] += sum[c][d];
            }
        }
    }
}

/// Adds the contributions of an element's rows to the sums of the pose and of its own columns. `W` columns: pose, own columns, padding.
///
/// * `weights` - weights of the base blocks
#[inline(always)]
fn add_element<T: Real, const R: usize, const W: usize>(
    place: Place,
    (number, all): (u32, &[OwnColumns]),
    weights: &[T; POSE_BLOCKS],
    system: &NormalEquations<T>,
    by_pose: &mut ByPose<T>,
    own: &mut OwnSums<T>,
) {
    let row = place.row as usize;
    let (w, v): ([T; R], [T; R]) = (tile_of(&system.weight[row..]), tile_of(&system.value[row..]));
    if w == [T::zero(); R] {
        return;
    }
    let rows: [[T; W]; R] = std::array::from_fn(|r| tile_of(&system.jacobian[place.jacobian as usize + r * W..]));
    let mut weighted = rows;
    for r in 0..R {
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
    let own = own.of(number, all);
    for (sum, &(_, column)) in own.columns.iter_mut().zip(&own.at[..own.count]) {
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

/// Products of one column of weighted rows with all columns of the rows.
#[inline(always)]
fn column_products<T: Real, const R: usize, const W: usize>(weighted: &[[T; W]; R], rows: &[[T; W]; R], column: usize) -> [T; W] {
    combined(std::array::from_fn(|r| weighted[r][column]), rows)
}

/// `sum_r left[r] rows[r]`.
#[inline(always)]
fn combined<T: Real, const R: usize, const W: usize>(left: [T; R], rows: &[[T; W]; R]) -> [T; W] {
    let mut sums = rows[0].map(|value| left[0] * value);
    for r in 1..R {
        for l in 0..W {
            sums[l] = left[r].mul_add(rows[r][l], sums[l]);
        }
    }
    sums
}
