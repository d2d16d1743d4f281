//! Sums in eight lanes. Vector registers of every width compute them in the same order, so results do not depend on the processor.

use crate::real::Real;

/// Number of lanes of a sum: term `i` is added to lane `i % LANES`.
pub const LANES: usize = 8;
/// Number of values computed in one block: the compiler would unroll a shorter loop before it could vectorise it.
pub const BLOCK: usize = 8 * LANES;

/// Sum of `term` over the values at each index. All slices must be at least as long as the first.
#[inline(always)]
pub fn sum_over<T: Real, const N: usize>(slices: [&[T]; N], term: impl Fn([T; N]) -> T) -> T {
    let count = slices[0].len();
    let parts = slices.map(|values| values[..count].as_chunks::<LANES>());
    let groups = parts.map(|part| part.0);
    let mut lanes = [T::zero(); LANES];
    for i in 0..count / LANES {
        let at = groups.map(|groups| &groups[i]);
        for l in 0..LANES {
            lanes[l] += term(at.map(|values| values[l]));
        }
    }
    for (i, lane) in lanes.iter_mut().enumerate().take(count % LANES) {
        *lane += term(parts.map(|part| part.1[i]));
    }
    lanes.into_iter().sum()
}

/// Dot product in eight partial sums.
#[inline(always)]
pub fn dot<T: Real>(a: &[T], b: &[T]) -> T {
    let mut lanes = [T::zero(); LANES];
    let (a_chunks, b_chunks) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let (a_rest, b_rest) = (a_chunks.remainder(), b_chunks.remainder());
    for (a, b) in a_chunks.zip(b_chunks) {
        for l in 0..LANES {
            lanes[l] = a[l].mul_add(b[l], lanes[l]);
        }
    }
    for (l, (a, b)) in a_rest.iter().zip(b_rest).enumerate() {
        lanes[l] = a.mul_add(*b, lanes[l]);
    }
    ((lanes[0] + lanes[4]) + (lanes[2] + lanes[6])) + ((lanes[1] + lanes[5]) + (lanes[3] + lanes[7]))
}

/// First `W` values of a slice.
#[inline(always)]
pub(super) fn tile_of<T: Real, const W: usize>(values: &[T]) -> [T; W] {
    let mut tile = [T::zero(); W];
    tile.copy_from_slice(&values[..W]);
    tile
}
