//! Sums in eight lanes: vector registers of any width do them alike, so that their order depends on no processor.

use crate::real::Real;

/// Lanes of a sum: term `i` is added in lane `i % LANES`.
pub const LANES: usize = 8;
/// Values that are worked out at once: a shorter loop is unrolled before it could be made one over vectors.
pub const BLOCK: usize = 8 * LANES;

/// Sum of a term of the values at each index. All slices are as long as the first, at least.
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
