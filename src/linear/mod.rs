//! Linear algebra of one iteration: the frontal factorisation in time order, its substitutions, and products with the Jacobian.
//!
//! Products are added by fused multiply-add, in a fixed order, so that results depend neither on the processor nor on the width of its vectors:
//! where there is no such instruction the same numbers come slowly from a function.

pub mod forward;
pub mod front;
pub mod lanes;
pub mod product;
mod reach;
pub mod substitute;
pub mod transposed;
