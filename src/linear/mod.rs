//! Linear algebra of one iteration: the frontal factorisation in time order, its substitutions, and products with the Jacobian.

pub mod forward;
pub mod front;
pub mod product;
pub mod substitute;
pub mod transposed;
