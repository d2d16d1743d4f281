//! The frontal Cholesky factorisation in time order: assemble, eliminate, slide on; then substitute back from the end.
//!
//! Solves `(E + J' W J) d = -(u + J' v)` with `W` and `v` given for each Jacobian row, `E` and `u` for each variable. The front holds the upper triangle row by row, the
//! right-hand side stands in the column after the last variable, so that forward substitution happens along the way.

use super::lanes::LANES;
use crate::nlp::Layout;
use crate::nlp::layout::Element;
use crate::real::Real;
use crate::rows::reach::{ReachFoot, ReachInstant};
use crate::rows::table::{NONE, Span};
use aligned_vec::{AVec, CACHELINE_ALIGN};
use multiversion::multiversion;

/// Buffers of the factorisation.
#[derive(Debug)]
pub struct Factor<T> {
    /// Front and next front, `[size][stride]`.
    fronts: [AVec<T>; 2],
    /// Pivot rows of all steps.
    pub pivot_rows: AVec<T>,
    /// Jacobian rows of one element, spread over the front.
    spread: AVec<T>,
    /// What reach rows make of the columns that feet have to themselves.
    own: OwnSums<T>,
    /// Solution on the front of one step.
    pub(super) local: AVec<T>,
}

impl<T> Default for Factor<T> {
    fn default() -> Self {
        // Vectors of whole cache lines.
        let [a, b, pivot_rows, spread, local] = std::array::from_fn(|_| AVec::new(CACHELINE_ALIGN));
        Factor { fronts: [a, b], pivot_rows, spread, own: OwnSums { feet: Vec::new(), used: 0 }, local }
    }
}

impl<T: Real> Factor<T> {
    /// Makes the buffers large enough for a layout.
    pub fn resize(&mut self, layout: &Layout<T>) {
        let stride = layout.front_stride;
        for front in &mut self.fronts {
            front.resize(stride * stride, T::zero());
        }
        self.pivot_rows.resize(layout.factor_len, T::zero());
        self.spread.resize((2 * AT_ONCE + 1) * stride, T::zero());
        self.local.resize(stride, T::zero());
    }
}

/// The normal equations: by Jacobian rows, and what falls on single variables.
#[derive(Debug, Clone, Copy)]
pub struct NormalEquations<'a, T> {
    /// Values of every element.
    pub jacobian: &'a [T],
    /// `W`, `[rows]`, not negative; elements of weight 0 are skipped, and `v` of a row of weight 0 must be 0.
    pub weight: &'a [T],
    /// `v`, `[rows]`.
    pub value: &'a [T],
    /// `E`, `[variables]`.
    pub diagonal: &'a [T],
    /// `u`, `[variables]`.
    pub gradient: &'a [T],
}

/// Factorises. Returns false when a pivot is not positive (or not finite).
pub fn factorise<T: Real>(layout: &Layout<T>, system: &NormalEquations<T>, factor: &mut Factor<T>) -> bool {
    // Columns at a time: two vector registers in either precision.
    if size_of::<T>() == size_of::<f32>() {
        factorise_by::<T, 16>(layout, system, factor)
    } else {
        factorise_by::<T, 8>(layout, system, factor)
    }
}

/// As [`factorise`], in tiles of `W` columns.
fn factorise_by<T: Real, const W: usize>(layout: &Layout<T>, system: &NormalEquations<T>, factor: &mut Factor<T>) -> bool {
    let stride = layout.front_stride;
    let [mut front, mut next] = factor.fronts.each_mut().map(|f| &mut f[..]);
    let mut previous_size = 0;
    for step in &layout.steps {
        let (size, pivots) = (step.size as usize, step.pivots as usize);
        std::mem::swap(&mut front, &mut next);
        front[..size * stride].fill(T::zero());
        move_front(layout, step.moves, next, previous_size, front, size, stride);
        for element in &layout.elements[step.elements.range()] {
            assemble::<T, W>(layout, element, system, front, size, stride, &mut factor.spread);
        }
        if !step.reach.range().is_empty() {
            assemble_reach(layout, &layout.reach_instants[step.reach.range()], system, front, size, stride, &mut factor.own);
        }
        for i in 0..pivots {
            front[i * stride + i] += system.diagonal[step.variable as usize + i];
            front[i * stride + size] -= system.gradient[step.variable as usize + i];
        }
        if !partial_cholesky::<T, W>(front, stride, size, pivots) {
            return false;
        }
        for i in 0..pivots {
            let at = step.factor as usize + i * step.stride as usize;
            factor.pivot_rows[at + i..at + size + 1].copy_from_slice(&front[i * stride + i..i * stride + size + 1]);
        }
        previous_size = size;
    }
    true
}

/// Adds what stays of the old front to its slots in the new one, which is zero: runs are short, and a call that copies is longer.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
fn move_front<T: Real>(layout: &Layout<T>, moves: Span, old: &[T], old_size: usize, new: &mut [T], new_size: usize, stride: usize) {
    let runs = &layout.front_runs[moves.range()];
    for (first, rows) in runs.iter().enumerate() {
        for i in 0..rows.len as usize {
            let (from, to) = ((rows.column as usize + i) * stride, (rows.front as usize + i) * stride);
            for (run, columns) in runs[first..].iter().enumerate() {
                let skip = if run == 0 { i } else { 0 };
                let (a, b, len) = (columns.column as usize + skip, columns.front as usize + skip, columns.len as usize - skip);
                for (new, old) in new[to + b..to + b + len].iter_mut().zip(&old[from + a..from + a + len]) {
                    *new += *old;
                }
            }
            new[to + new_size] = old[from + old_size];
        }
    }
}

/// Adds `J' W J` and `-J' v` of one element to the front.
#[inline(always)]
fn assemble<T: Real, const W: usize>(
    layout: &Layout<T>,
    element: &Element,
    system: &NormalEquations<T>,
    front: &mut [T],
    size: usize,
    stride: usize,
    spread: &mut [T],
) {
    if element.place.stride as usize == LANES {
        return assemble_narrow(layout, element, system, front, size, stride);
    }
    let rows = element.rows as usize;
    for first in (0..rows).step_by(AT_ONCE) {
        match rows - first {
            1 => assemble_rows::<T, 1, W>(layout, element, first, system, front, size, stride, spread),
            2 => assemble_rows::<T, 2, W>(layout, element, first, system, front, size, stride, spread),
            3 => assemble_rows::<T, 3, W>(layout, element, first, system, front, size, stride, spread),
            4 => assemble_rows::<T, 4, W>(layout, element, first, system, front, size, stride, spread),
            5 => assemble_rows::<T, 5, W>(layout, element, first, system, front, size, stride, spread),
            _ => assemble_rows::<T, AT_ONCE, W>(layout, element, first, system, front, size, stride, spread),
        }
    }
}

/// Adds rows with a handful of columns, as they stand.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
fn assemble_narrow<T: Real>(
    layout: &Layout<T>,
    element: &Element,
    system: &NormalEquations<T>,
    front: &mut [T],
    size: usize,
    stride: usize,
) {
    let (place, count) = (&element.place, element.rows as usize);
    let weights = &system.weight[place.row as usize..][..count];
    let values = &system.value[place.row as usize..][..count];
    if weights.iter().all(|w| *w == T::zero()) {
        return;
    }
    let rows = &system.jacobian[place.jacobian as usize..][..count * LANES];
    let runs = &layout.runs[element.runs.range()];
    for (first, run) in runs.iter().enumerate() {
        for i in 0..run.len as usize {
            let mut products = [T::zero(); LANES];
            let mut sum = T::zero();
            for ((row, weight), value) in rows.chunks_exact(LANES).zip(weights).zip(values) {
                let of_column = row[run.column as usize + i];
                let left = *weight * of_column;
                sum += *value * of_column;
                for l in 0..LANES {
                    products[l] = left.mul_add(row[l], products[l]);
                }
            }
            let line = &mut front[(run.front as usize + i) * stride..][..stride];
            line[size] -= sum;
            // What lies left of the diagonal is never read.
            for other in &runs[first..] {
                let line = &mut line[other.front as usize..][..other.len as usize];
                for (to, product) in line.iter_mut().zip(&products[other.column as usize..]) {
                    *to += *product;
                }
            }
        }
    }
}

/// Rows of an element that are assembled together.
const AT_ONCE: usize = 6;

/// Adds `M` rows of an element from the `first` on, in tiles of four by `W`.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
#[allow(clippy::too_many_arguments, reason = "separate slices: the compiler knows that they do not overlap")]
fn assemble_rows<T: Real, const M: usize, const W: usize>(
    layout: &Layout<T>,
    element: &Element,
    first: usize,
    system: &NormalEquations<T>,
    front: &mut [T],
    size: usize,
    stride: usize,
    spread: &mut [T],
) {
    let place = &element.place;
    let row = place.row as usize + first;
    let weights: [T; M] = tile_of(&system.weight[row..]);
    let values: [T; M] = tile_of(&system.value[row..]);
    if weights.iter().all(|w| *w == T::zero()) {
        return;
    }
    let runs = &layout.runs[element.runs.range()];
    let Some(end) = runs.last().map(|r| ((r.front + r.len) as usize).next_multiple_of(W)) else { return };
    let begin = runs[0].front as usize / W * W;
    let width = end - begin;
    // The rows over the front, the same weighted, and what they make of the right-hand side.
    let (rows, rest) = spread.split_at_mut(M * width);
    let (weighted, sums) = rest.split_at_mut(M * width);
    let sums = &mut sums[..width];
    rows.fill(T::zero());
    sums.fill(T::zero());
    for (r, (line, weighted)) in rows.chunks_exact_mut(width).zip(weighted.chunks_exact_mut(width)).enumerate() {
        let source = &system.jacobian[place.jacobian as usize + (first + r) * place.stride as usize..][..place.stride as usize];
        for run in runs {
            let line = &mut line[run.front as usize - begin..][..run.len as usize];
            for (to, from) in line.iter_mut().zip(&source[run.column as usize..][..run.len as usize]) {
                *to += *from;
            }
        }
        for ((weighted, sum), value) in weighted.iter_mut().zip(&mut *sums).zip(&*line) {
            *weighted = weights[r] * *value;
            *sum += values[r] * *value;
        }
    }
    for i in (0..width).step_by(4) {
        let left: [[T; 4]; M] = std::array::from_fn(|r| tile_of(&weighted[r * width + i..]));
        // Runs leave gaps.
        if left == [[T::zero(); 4]; M] {
            continue;
        }
        let front = &mut front[(begin + i) * stride + begin..];
        for j in (i / W * W..width).step_by(W) {
            let mut tile: [[T; W]; 4] = std::array::from_fn(|q| tile_of(&front[q * stride + j..]));
            for r in 0..M {
                let right: [T; W] = tile_of(&rows[r * width + j..]);
                for q in 0..4 {
                    for l in 0..W {
                        tile[q][l] = left[r][q].mul_add(right[l], tile[q][l]);
                    }
                }
            }
            for q in 0..4 {
                front[q * stride + j..][..W].copy_from_slice(&tile[q]);
            }
        }
    }
    for run in runs {
        for i in run.front as usize..(run.front + run.len) as usize {
            front[i * stride + size] -= sums[i - begin];
        }
    }
}

/// Values of a pose.
const POSE: usize = 6;
/// Pairs of base blocks.
const PAIRS: [(usize, usize); 10] = [(0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3)];

/// What the feet at one reach instant make of its pose.
struct ByPose<T> {
    /// `P' W P`, row by row, and two columns that mean nothing.
    products: [[T; LANES]; POSE],
    /// `P' v`, likewise.
    values: [T; LANES],
}

/// What the instants of a step make of the columns that a foot has to itself as long as its phase lasts.
#[derive(Debug)]
struct ByOwn<T> {
    /// Those of the foot, by which it is found.
    front: [u32; 3],
    /// Of each column the slot in the front, and which of the rows' columns it is: two a foothold, one a swing height.
    slots: [(usize, usize); 5],
    count: usize,
    columns: [OwnColumn<T>; 5],
}

/// Sums for one of them, `a`.
#[derive(Debug, Clone, Copy)]
struct OwnColumn<T> {
    /// For each base block `w_i P' W a`, and two values that mean nothing.
    by_base: [[T; LANES]; 4],
    /// With all columns of the rows, of which those of the pose mean nothing.
    by_own: [T; 2 * LANES],
    /// `a' v`.
    value: T,
}

impl<T: Real> ByOwn<T> {
    fn none() -> Self {
        let zero = T::zero();
        let nothing = OwnColumn { by_base: [[zero; LANES]; 4], by_own: [zero; 2 * LANES], value: zero };
        ByOwn { front: [NONE; 3], slots: [(0, 0); 5], count: 0, columns: [nothing; 5] }
    }

    /// Begins the sums of a foot.
    fn begin(&mut self, foot: &ReachFoot<T>) {
        *self = ByOwn { front: foot.front, count: 0, ..Self::none() };
        let columns = [foot.foothold_column[0], foot.foothold_column[1], foot.height_column];
        for ((slot, column), len) in foot.front.into_iter().zip(columns).zip([2, 2, 1]).filter(|((slot, _), _)| *slot != NONE) {
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
                // Only what lies right of the diagonal.
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

/// Those of one step; of earlier ones there may be more.
#[derive(Debug)]
struct OwnSums<T> {
    feet: Vec<ByOwn<T>>,
    used: usize,
}

impl<T: Real> OwnSums<T> {
    /// Those of a foot in a phase.
    #[inline(always)]
    fn of(&mut self, foot: &ReachFoot<T>) -> &mut ByOwn<T> {
        let at = self.feet[..self.used].iter().rposition(|own| own.front == foot.front).unwrap_or_else(|| self.begin(foot));
        &mut self.feet[at]
    }

    fn begin(&mut self, foot: &ReachFoot<T>) -> usize {
        if self.used == self.feet.len() {
            self.feet.push(ByOwn::none());
        }
        self.feet[self.used].begin(foot);
        self.used += 1;
        self.used - 1
    }
}

/// Adds `J' W J` and `-J' v` of the reach rows of all feet at the instants of one step, which share their base blocks.
///
/// All rows touch the base through its pose alone, with weights `w` that an instant's feet share: with `P` the rows by the pose, `A` by the
/// foot's own columns, the base block of coefficients `i` and `j` is `w_i w_j sum P' W P`, that of coefficient and foot `w_i P' W A`.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
fn assemble_reach<T: Real>(
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
        let weights = instant.base.weights;
        for i in 0..4 {
            if instant.base.front[i] != NONE {
                slots[i] = instant.base.front[i];
            }
        }
        let mut by_pose = ByPose { products: [[T::zero(); LANES]; POSE], values: [T::zero(); LANES] };
        for foot in &layout.reach_feet[instant.feet.range()] {
            if foot.place.stride as usize == LANES {
                add_foot::<T, LANES>(foot, &weights, system, &mut by_pose, own);
            } else {
                add_foot::<T, { 2 * LANES }>(foot, &weights, system, &mut by_pose, own);
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
    for own in &own.feet[..own.used] {
        own.add(&slots, front, size, stride);
    }
    for i in (0..4).filter(|&i| slots[i] != NONE) {
        for c in 0..POSE {
            front[(slots[i] as usize + c) * stride + size] -= values[i][c];
        }
    }
    for (sum, (i, j)) in sums.iter().zip(PAIRS).filter(|(_, (i, j))| slots[*i] != NONE && slots[*j] != NONE) {
        // The sums are symmetric.
        let (row, column) = (slots[i].min(slots[j]) as usize, slots[i].max(slots[j]) as usize);
        for c in 0..POSE {
            let line = &mut front[(row + c) * stride + column..][..POSE];
            for d in 0..POSE {
                line[d] += sum[c][d];
            }
        }
    }
}

/// Adds up what a foot's rows make of the pose, and of its own columns. `W` columns: the pose's, its own, padding.
///
/// * `weights` - of the base blocks
#[inline(always)]
fn add_foot<T: Real, const W: usize>(
    foot: &ReachFoot<T>,
    weights: &[T; 4],
    system: &NormalEquations<T>,
    by_pose: &mut ByPose<T>,
    own: &mut OwnSums<T>,
) {
    let (row, place) = (foot.place.row as usize, &foot.place);
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
    let own = own.of(foot);
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

/// Products of one column of three weighted rows with all columns.
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

/// Eliminates the first `pivots` variables of a front: `A = U' U` row by row, the rest becomes the Schur complement.
///
/// Rows are taken four at a time, columns `W` at a time, so that a 4 x `W` tile stays in registers while all earlier pivot rows pass.
/// Returns false when a pivot is not positive.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
pub fn partial_cholesky<T: Real, const W: usize>(front: &mut [T], stride: usize, size: usize, pivots: usize) -> bool {
    let mut first = 0;
    while first + 4 <= size {
        if !eliminate_rows::<T, W, 4>(front, stride, size, pivots, first) {
            return false;
        }
        first += 4;
    }
    while first < size {
        if !eliminate_rows::<T, W, 1>(front, stride, size, pivots, first) {
            return false;
        }
        first += 1;
    }
    true
}

/// Rows `first..first + R` of [`partial_cholesky`]: subtracts all earlier pivot rows, then eliminates what of them is a pivot.
#[inline(always)]
fn eliminate_rows<T: Real, const W: usize, const R: usize>(
    front: &mut [T],
    stride: usize,
    size: usize,
    pivots: usize,
    first: usize,
) -> bool {
    let done = first.min(pivots);
    let (above, below) = front.split_at_mut(first * stride);
    let above = &above[..done * stride];
    let mut j = first / W * W;
    while j <= size && done > 0 {
        let mut tile = [[T::zero(); W]; R];
        for r in 0..R {
            tile[r] = tile_of(&below[r * stride + j..]);
        }
        for pivot in above.chunks_exact(stride) {
            let left: [T; R] = tile_of(&pivot[first..]);
            let right: [T; W] = tile_of(&pivot[j..]);
            for r in 0..R {
                for l in 0..W {
                    tile[r][l] = (-left[r]).mul_add(right[l], tile[r][l]);
                }
            }
        }
        for r in 0..R {
            below[r * stride + j..r * stride + j + W].copy_from_slice(&tile[r]);
        }
        j += W;
    }
    for r in 0..R {
        let i = first + r;
        let (earlier, line) = below.split_at_mut(r * stride);
        // Whole tiles, from the one that holds the diagonal to the one that holds the right-hand side: what lies left of the diagonal is
        // never read.
        let (from, to) = (i / W * W, (size + 1).next_multiple_of(W));
        for pivot in earlier.chunks_exact(stride).take(pivots.saturating_sub(first)) {
            let left = pivot[i];
            for (sum, right) in line[from..to].chunks_exact_mut(W).zip(pivot[from..to].chunks_exact(W)) {
                for l in 0..W {
                    sum[l] = (-left).mul_add(right[l], sum[l]);
                }
            }
        }
        if i < pivots {
            let pivot = line[i];
            if !(pivot > T::zero() && pivot.is_finite()) {
                return false;
            }
            let inverse = T::one() / pivot.sqrt();
            for sum in line[from..to].chunks_exact_mut(W) {
                for v in sum {
                    *v *= inverse;
                }
            }
        }
    }
    true
}

#[inline(always)]
fn tile_of<T: Real, const W: usize>(values: &[T]) -> [T; W] {
    let mut tile = [T::zero(); W];
    tile.copy_from_slice(&values[..W]);
    tile
}
