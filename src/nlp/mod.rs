//! Trajectory optimisation problem of one candidate: its variables, its rows and the tables that the loops use.
//!
//! Rows form elements. An element is a small group of rows with the same columns, such as the six dynamics rows of an instant. Each family
//! computes residuals and dense Jacobians of its elements. All later stages (assembly, products, steps) work on elements, so they are the
//! same for every transcription.

mod builder;
mod cost;
mod feet;
mod footing;
pub mod layout;
pub mod sweep;
mod trajectory;
pub mod transcription;

pub use layout::{Curves, Layout};
pub use trajectory::trajectory;
