//! The trajectory optimisation problem of one candidate: its variables, its rows and the tables that the loops walk.
//!
//! Rows come in elements. An element is a small group of rows that share their columns, such as the six dynamics rows of an instant.
//! Each family fills its elements' residuals and dense Jacobians; everything after that (assembly, products, steps) knows elements only
//! and serves every transcription.

mod builder;
mod feet;
mod footing;
pub mod layout;
pub mod sweep;
mod trajectory;
pub mod transcription;

pub use layout::{Curves, Layout};
pub use trajectory::trajectory;
