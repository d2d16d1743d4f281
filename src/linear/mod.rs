//! Linear algebra of one iteration: the frontal factorisation in time order, its substitutions, and products with the Jacobian.
//!
//! Products are accumulated by fused multiply-add in a fixed order, so that results depend neither on the processor nor on its vector
//! width: on processors without the instruction, a slow function computes the same numbers.

mod factored;
pub mod forward;
pub mod front;
pub mod product;
pub mod simd;
pub mod substitute;
pub mod transposed;

/// Normal equations: terms per Jacobian row and per variable.
#[derive(Debug, Clone, Copy)]
pub struct NormalEquations<'a, T> {
    /// Jacobian values of every element.
    pub jacobian: &'a [T],
    /// `W`, `[rows]`, not negative; elements whose weights are all 0 are skipped, and `v` of a row of weight 0 must be 0.
    pub weight: &'a [T],
    /// `v`, `[rows]`.
    pub value: &'a [T],
    /// `E`, `[variables]`.
    pub diagonal: &'a [T],
    /// `u`, `[variables]`.
    pub gradient: &'a [T],
}

/// Shape of a front: `size` variables, then the right-hand side, in rows of length `stride`.
#[derive(Clone, Copy)]
pub(crate) struct Shape {
    pub size: usize,
    pub stride: usize,
}
