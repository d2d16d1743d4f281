//! Frontal Cholesky factorisation in time order: assemble a front, eliminate its pivots, carry the rest over to the next front; then
//! substitute back from the end.
//!
//! Solves `(E + J' W J) d = -(u + J' v)` with `W` and `v` given per Jacobian row, `E` and `u` per variable. The front stores the upper
//! triangle by rows. The right-hand side is in the column after the last variable, so that the elimination includes forward substitution.

use super::factored::OwnSums;
use super::simd::{LANES, tile_of};
use super::{NormalEquations, Shape};
use crate::nlp::Problem;
use crate::nlp::problem::Element;
use crate::real::Real;
use crate::rows::table::Span;
use aligned_vec::{AVec, CACHELINE_ALIGN};
use multiversion::multiversion;

/// Buffers of the factorisation.
#[derive(Debug)]
pub struct Factor<T> {
    /// Current and previous front, `[size][stride]`.
    fronts: [AVec<T>; 2],
    /// Pivot rows of all steps.
    pub pivot_rows: AVec<T>,
    /// Jacobian rows of one element, scattered to the columns of the front.
    spread: AVec<T>,
    /// Contributions of the factored rows to their own columns.
    own: OwnSums<T>,
    /// Solution for the front of one step.
    pub(super) local: AVec<T>,
}

impl<T> Default for Factor<T> {
    fn default() -> Self {
        // Vectors are aligned to cache lines.
        let [a, b, pivot_rows, spread, local] = std::array::from_fn(|_| AVec::new(CACHELINE_ALIGN));
        Factor { fronts: [a, b], pivot_rows, spread, own: OwnSums::default(), local }
    }
}

impl<T: Real> Factor<T> {
    /// Resizes the buffers for a problem.
    pub fn resize(&mut self, problem: &Problem<T>) {
        let stride = problem.front_stride;
        for front in &mut self.fronts {
            front.resize(stride * stride, T::zero());
        }
        self.pivot_rows.resize(problem.factor_len, T::zero());
        self.spread.resize((2 * AT_ONCE + 1) * stride, T::zero());
        self.local.resize(stride, T::zero());
    }
}

/// Factorises the normal equations. Returns false if a pivot is not positive or not finite.
pub fn factorise<T: Real>(problem: &Problem<T>, system: &NormalEquations<T>, factor: &mut Factor<T>) -> bool {
    // Columns per tile: two vector registers in either precision.
    if size_of::<T>() == size_of::<f32>() {
        factorise_by::<T, 16>(problem, system, factor)
    } else {
        factorise_by::<T, 8>(problem, system, factor)
    }
}

/// Implementation of [`factorise`] with tiles of `W` columns.
fn factorise_by<T: Real, const W: usize>(problem: &Problem<T>, system: &NormalEquations<T>, factor: &mut Factor<T>) -> bool {
    let stride = problem.front_stride;
    let [mut front, mut next] = factor.fronts.each_mut().map(|f| &mut f[..]);
    let mut previous_size = 0;
    for (k, step) in problem.steps.iter().enumerate() {
        let (size, pivots) = (step.size as usize, step.pivots as usize);
        let shape = Shape { size, stride };
        std::mem::swap(&mut front, &mut next);
        front[..size * stride].fill(T::zero());
        move_front(problem, step.moves, next, previous_size, front, size, stride);
        for element in &problem.elements[step.elements.range()] {
            assemble::<T, W>(problem, element, system, front, shape, &mut factor.spread);
        }
        problem.reach_rows.assemble(k, system, front, shape, &mut factor.own);
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

/// Adds the remaining part of the old front to the new front, which is zero. It adds instead of copying because runs are short, and a call
/// of a copy routine takes longer.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
fn move_front<T: Real>(problem: &Problem<T>, moves: Span, old: &[T], old_size: usize, new: &mut [T], new_size: usize, stride: usize) {
    let runs = &problem.front_runs[moves.range()];
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
    problem: &Problem<T>,
    element: &Element,
    system: &NormalEquations<T>,
    front: &mut [T],
    shape: Shape,
    spread: &mut [T],
) {
    if element.place.stride as usize == LANES {
        return assemble_narrow(problem, element, system, front, shape);
    }
    let rows = element.rows as usize;
    for first in (0..rows).step_by(AT_ONCE) {
        match rows - first {
            1 => assemble_rows::<T, 1, W>(problem, element, first, system, front, shape, spread),
            2 => assemble_rows::<T, 2, W>(problem, element, first, system, front, shape, spread),
            3 => assemble_rows::<T, 3, W>(problem, element, first, system, front, shape, spread),
            4 => assemble_rows::<T, 4, W>(problem, element, first, system, front, shape, spread),
            5 => assemble_rows::<T, 5, W>(problem, element, first, system, front, shape, spread),
            _ => assemble_rows::<T, AT_ONCE, W>(problem, element, first, system, front, shape, spread),
        }
    }
}

/// Adds rows with at most eight columns directly, without scattering them to the front first.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
fn assemble_narrow<T: Real>(problem: &Problem<T>, element: &Element, system: &NormalEquations<T>, front: &mut [T], shape: Shape) {
    let (place, count, Shape { size, stride }) = (&element.place, element.rows as usize, shape);
    let weights = &system.weight[place.row as usize..][..count];
    let values = &system.value[place.row as usize..][..count];
    if weights.iter().all(|w| *w == T::zero()) {
        return;
    }
    let rows = &system.jacobian[place.jacobian as usize..][..count * LANES];
    let runs = &problem.runs[element.runs.range()];
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
            // Values left of the diagonal are never read.
            for other in &runs[first..] {
                let line = &mut line[other.front as usize..][..other.len as usize];
                for (to, product) in line.iter_mut().zip(&products[other.column as usize..]) {
                    *to += *product;
                }
            }
        }
    }
}

/// Number of rows of an element that are assembled together.
const AT_ONCE: usize = 6;

/// Adds `M` rows of an element, starting at row `first`, in tiles of four by `W`.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl", "x86_64+avx2+fma"))]
fn assemble_rows<T: Real, const M: usize, const W: usize>(
    problem: &Problem<T>,
    element: &Element,
    first: usize,
    system: &NormalEquations<T>,
    front: &mut [T],
    shape: Shape,
    spread: &mut [T],
) {
    let (place, Shape { size, stride }) = (&element.place, shape);
    let row = place.row as usize + first;
    let weights: [T; M] = tile_of(&system.weight[row..]);
    let values: [T; M] = tile_of(&system.value[row..]);
    if weights.iter().all(|w| *w == T::zero()) {
        return;
    }
    let runs = &problem.runs[element.runs.range()];
    let Some(end) = runs.last().map(|r| ((r.front + r.len) as usize).next_multiple_of(W)) else { return };
    let begin = runs[0].front as usize / W * W;
    let width = end - begin;
    // Rows scattered to the front, the same rows weighted, and their contributions to the right-hand side.
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
        // Columns between two runs are zero.
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

/// Eliminates the first `pivots` variables of a front: `A = U' U` row by row; the rest becomes the Schur complement.
///
/// Processes four rows and `W` columns at a time, so that a 4 x `W` tile stays in registers while all earlier pivot rows are subtracted.
/// Returns false if a pivot is not positive.
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

/// Processes rows `first..first + R` of [`partial_cholesky`]: subtracts all earlier pivot rows, then eliminates the pivots among these
/// rows.
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
        // Processes whole tiles, from the one that contains the diagonal to the one that contains the right-hand side: values left of the
        // diagonal are never read.
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
