//! Linear algebra of one iteration: the frontal factorisation in time order, its substitutions, and products with the Jacobian.
//!
//! Products are accumulated by fused multiply-add in a fixed order, so that results depend neither on the processor nor on its vector
//! width: on processors without the instruction, a slow function computes the same numbers.

pub mod forward;
pub mod front;
pub mod lanes;
pub mod product;
mod reach;
pub mod substitute;
pub mod transposed;
