//! The frontal Cholesky factorisation in time order: assemble, eliminate, slide on; then substitute back from the end.
//!
//! Solves `(eps D + J' W J) d = -J' v` with `W` and `v` given for each Jacobian row. The front holds the upper triangle row by row, the
//! right-hand side stands in the column after the last variable, so that forward substitution happens along the way.

use crate::nlp::layout::Element;
use crate::nlp::{Layout, Real};
use multiversion::multiversion;

/// Buffers of the factorisation.
#[derive(Debug, Default)]
pub struct Factor<T> {
    /// Front and next front, `[size][stride]`.
    fronts: [Vec<T>; 2],
    /// Pivot rows of all steps.
    rows: Vec<T>,
    /// Jacobian rows of one element, spread over the front.
    spread: Vec<T>,
    /// Solution on the front of one step.
    local: Vec<T>,
}

impl<T: Real> Factor<T> {
    /// Makes the buffers large enough for a layout.
    pub fn resize(&mut self, layout: &Layout<T>) {
        let stride = layout.front_stride;
        for front in &mut self.fronts {
            front.resize(stride * stride, T::zero());
        }
        self.rows.resize(layout.factor_len, T::zero());
        self.spread.resize(6 * stride, T::zero());
        self.local.resize(stride, T::zero());
    }
}

/// Factorises. Returns false when a pivot is not positive (or not finite).
///
/// * `weight` - `W`, `[rows]`, not negative; rows of weight 0 are skipped
/// * `value` - `v`, `[rows]`
/// * `diagonal` - `D`, `[variables]`
/// * `proximal` - `eps`
pub fn factorise<T: Real>(
    layout: &Layout<T>,
    jacobian: &[T],
    weight: &[T],
    value: &[T],
    diagonal: &[T],
    proximal: T,
    factor: &mut Factor<T>,
) -> bool {
    let stride = layout.front_stride;
    let [mut front, mut next] = factor.fronts.each_mut().map(|f| &mut f[..]);
    let mut previous_size = 0;
    for step in &layout.steps {
        let (size, pivots) = (step.size as usize, step.pivots as usize);
        std::mem::swap(&mut front, &mut next);
        for i in 0..size {
            front[i * stride + i..i * stride + size + 1].fill(T::zero());
        }
        move_front(layout, &step.moves, next, previous_size, front, size, stride);
        for element in &layout.elements[step.elements.start as usize..step.elements.end as usize] {
            assemble(layout, element, jacobian, weight, value, front, size, stride, &mut factor.spread);
        }
        for i in 0..pivots {
            front[i * stride + i] += proximal * diagonal[step.variable as usize + i];
        }
        if !T::partial_cholesky(front, stride, size, pivots) {
            return false;
        }
        for i in 0..pivots {
            let at = step.factor as usize + i * step.stride as usize;
            factor.rows[at + i..at + size + 1].copy_from_slice(&front[i * stride + i..i * stride + size + 1]);
        }
        previous_size = size;
    }
    true
}

/// Copies what stays of the old front to its slots in the new one.
#[multiversion(targets("x86_64+avx2"))]
fn move_front<T: Real>(
    layout: &Layout<T>,
    moves: &std::ops::Range<u32>,
    old: &[T],
    old_size: usize,
    new: &mut [T],
    new_size: usize,
    stride: usize,
) {
    let runs = &layout.front_runs[moves.start as usize..moves.end as usize];
    for (first, rows) in runs.iter().enumerate() {
        for i in 0..rows.len as usize {
            let (from, to) = ((rows.column as usize + i) * stride, (rows.slot as usize + i) * stride);
            for (run, columns) in runs[first..].iter().enumerate() {
                let skip = if run == 0 { i } else { 0 };
                let (a, b, len) = (columns.column as usize + skip, columns.slot as usize + skip, columns.len as usize - skip);
                new[to + b..to + b + len].copy_from_slice(&old[from + a..from + a + len]);
            }
            new[to + new_size] = old[from + old_size];
        }
    }
}

/// Adds `J' W J` and `-J' v` of one element to the front.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "buffers of one kernel")]
fn assemble<T: Real>(
    layout: &Layout<T>,
    element: &Element,
    jacobian: &[T],
    weight: &[T],
    value: &[T],
    front: &mut [T],
    size: usize,
    stride: usize,
    spread: &mut [T],
) {
    match element.rows {
        1 => assemble_rows::<T, 1>(layout, element, jacobian, weight, value, front, size, stride, spread),
        3 => assemble_rows::<T, 3>(layout, element, jacobian, weight, value, front, size, stride, spread),
        5 => assemble_rows::<T, 5>(layout, element, jacobian, weight, value, front, size, stride, spread),
        _ => assemble_rows::<T, 6>(layout, element, jacobian, weight, value, front, size, stride, spread),
    }
}

/// Width of the vector loops of [`assemble`].
const LANES: usize = 8;

#[multiversion(targets("x86_64+avx2"))]
#[expect(clippy::too_many_arguments, reason = "buffers of one kernel")]
fn assemble_rows<T: Real, const M: usize>(
    layout: &Layout<T>,
    element: &Element,
    jacobian: &[T],
    weight: &[T],
    value: &[T],
    front: &mut [T],
    size: usize,
    stride: usize,
    spread: &mut [T],
) {
    let place = &element.place;
    let row = place.row as usize;
    let weights: [T; M] = tile_of(&weight[row..]);
    let values: [T; M] = tile_of(&value[row..]);
    if weights.iter().all(|w| *w == T::zero()) {
        return;
    }
    let runs = &layout.runs[element.runs.start as usize..element.runs.end as usize];
    let Some(end) = runs.last().map(|r| ((r.slot + r.len) as usize).next_multiple_of(LANES)) else { return };
    let begin = runs[0].slot as usize / LANES * LANES;
    // Lanes of all rows side by side: slot `s` of row `r` stands at `(s / LANES * M + r) * LANES + s % LANES`.
    let at = |slot: usize, r: usize| (slot / LANES * M + r) * LANES + slot % LANES;
    spread[begin * M..end * M].fill(T::zero());
    for r in 0..M {
        let source = &jacobian[place.jacobian as usize + r * place.stride as usize..][..place.stride as usize];
        for run in runs {
            let values = &source[run.column as usize..(run.column + run.len) as usize];
            for (i, &v) in values.iter().enumerate() {
                spread[at(run.slot as usize + i, r)] = v;
            }
        }
    }
    for run in runs {
        for i in run.slot as usize..(run.slot + run.len) as usize {
            // Rows that do not touch this column (many: a balance row touches one axis) are left out.
            let mut left = [T::zero(); M];
            let mut touching = [0; M];
            let mut count = 0;
            let mut rhs = T::zero();
            for r in 0..M {
                let v = weights[r] * spread[at(i, r)];
                rhs += values[r] * spread[at(i, r)];
                left[count] = v;
                touching[count] = r * LANES;
                count += usize::from(v != T::zero());
            }
            let from = i / LANES * LANES;
            let line = &mut front[i * stride..(i + 1) * stride];
            line[size] -= rhs;
            let (line, tile) = (&mut line[from..end], &spread[from * M..end * M]);
            match count {
                0 => {}
                1 => accumulate::<T, 1>(line, tile, LANES * M, &left, &touching),
                2 => accumulate::<T, 2>(line, tile, LANES * M, &left, &touching),
                3 => accumulate::<T, 3>(line, tile, LANES * M, &left, &touching),
                4 => accumulate::<T, 4>(line, tile, LANES * M, &left, &touching),
                5 => accumulate::<T, 5>(line, tile, LANES * M, &left, &touching),
                _ => accumulate::<T, 6>(line, tile, LANES * M, &left, &touching),
            }
        }
    }
}

/// `line += sum_k left[k] row_k`, where row `k` stands `offset[k]` into each group of `width` values of `tile`.
#[inline(always)]
fn accumulate<T: Real, const K: usize>(line: &mut [T], tile: &[T], width: usize, left: &[T], offset: &[usize]) {
    let (left, offset): ([T; K], [usize; K]) = (tile_of(left), std::array::from_fn(|k| offset[k]));
    for (sum, right) in line.chunks_exact_mut(LANES).zip(tile.chunks_exact(width)) {
        for k in 0..K {
            let right = &right[offset[k]..offset[k] + LANES];
            for l in 0..LANES {
                sum[l] += left[k] * right[l];
            }
        }
    }
}

/// Eliminates the first `pivots` variables of a front: `A = U' U` row by row, the rest becomes the Schur complement.
///
/// Rows are taken four at a time, columns `W` at a time, so that a 4 x `W` tile stays in registers while all earlier pivot rows pass.
/// Returns false when a pivot is not positive.
#[multiversion(targets("x86_64+avx2"))]
pub fn partial_cholesky<T: Real, const W: usize>(front: &mut [T], stride: usize, size: usize, pivots: usize) -> bool {
    const R: usize = 4;
    let mut first = 0;
    while first < size {
        let rows = R.min(size - first);
        let done = first.min(pivots);
        let (above, below) = front.split_at_mut(first * stride);
        if done > 0 {
            let mut j = first / W * W;
            while j <= size {
                // Rows past the end repeat the last one and are not stored.
                let mut tile = [[T::zero(); W]; R];
                for r in 0..R {
                    tile[r] = tile_of(&below[r.min(rows - 1) * stride + j..]);
                }
                for c in 0..done {
                    let pivot = &above[c * stride..(c + 1) * stride];
                    let right: [T; W] = tile_of(&pivot[j..]);
                    for r in 0..R {
                        let left = pivot[first + r.min(rows - 1)];
                        for l in 0..W {
                            tile[r][l] -= left * right[l];
                        }
                    }
                }
                for r in 0..rows {
                    below[r * stride + j..r * stride + j + W].copy_from_slice(&tile[r]);
                }
                j += W;
            }
        }
        if first < pivots {
            for r in 0..rows {
                let i = first + r;
                let (earlier, line) = below.split_at_mut(r * stride);
                let line = &mut line[..stride];
                for p in 0..r.min(pivots - first) {
                    let pivot = &earlier[p * stride..(p + 1) * stride];
                    let left = pivot[i];
                    for j in i..size + 1 {
                        line[j] -= left * pivot[j];
                    }
                }
                if i < pivots {
                    let pivot = line[i];
                    if !(pivot > T::zero() && pivot.is_finite()) {
                        return false;
                    }
                    let inverse = T::one() / pivot.sqrt();
                    for v in &mut line[i..size + 1] {
                        *v *= inverse;
                    }
                }
            }
        }
        first += R;
    }
    true
}

#[inline(always)]
fn tile_of<T: Real, const W: usize>(values: &[T]) -> [T; W] {
    let mut tile = [T::zero(); W];
    tile.copy_from_slice(&values[..W]);
    tile
}

/// Back substitution after [`factorise`].
///
/// * `direction` - out, `d`, `[variables]`
#[multiversion(targets("x86_64+avx2"))]
pub fn substitute<T: Real>(layout: &Layout<T>, factor: &mut Factor<T>, direction: &mut [T]) {
    let local = &mut factor.local;
    for step in layout.steps.iter().rev() {
        let (size, pivots) = (step.size as usize, step.pivots as usize);
        for run in &layout.front_runs[step.rest.start as usize..step.rest.end as usize] {
            let (slot, variable, len) = (run.slot as usize, run.variable as usize, run.len as usize);
            local[slot..slot + len].copy_from_slice(&direction[variable..variable + len]);
        }
        for i in (0..pivots).rev() {
            let row = &factor.rows[step.factor as usize + i * step.stride as usize..][..size + 1];
            let rest = dot(&row[i + 1..size], &local[i + 1..size]);
            local[i] = (row[size] - rest) / row[i];
        }
        let first = step.variable as usize;
        direction[first..first + pivots].copy_from_slice(&local[..pivots]);
    }
}

/// Dot product in [`LANES`] partial sums, so that its order does not depend on the vector width.
#[inline(always)]
pub fn dot<T: Real>(a: &[T], b: &[T]) -> T {
    let mut lanes = [T::zero(); LANES];
    let (a_chunks, b_chunks) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let (a_rest, b_rest) = (a_chunks.remainder(), b_chunks.remainder());
    for (a, b) in a_chunks.zip(b_chunks) {
        for l in 0..LANES {
            lanes[l] += a[l] * b[l];
        }
    }
    for (l, (a, b)) in a_rest.iter().zip(b_rest).enumerate() {
        lanes[l] += *a * *b;
    }
    ((lanes[0] + lanes[4]) + (lanes[2] + lanes[6])) + ((lanes[1] + lanes[5]) + (lanes[3] + lanes[7]))
}
