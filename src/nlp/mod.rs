//! The trajectory optimisation problem of one candidate: its variables, its rows and the tables that the kernels walk.
//!
//! Rows come in elements. An element is a small group of rows that share their columns, such as the six dynamics rows of an instant.
//! The kernels fill each element's residuals and dense Jacobian; everything after that (assembly, products, steps) knows elements only
//! and serves every transcription.

mod builder;
pub mod initial_guess;
pub mod layout;
pub mod momentum;
pub mod nodes;
pub mod sweep;
pub mod towr;

pub use layout::Layout;
pub use nodes::node_values;

/// Scalar of the solver: `f32` for speed, `f64` for certification.
pub trait Real: num_traits::Float + num_traits::NumAssign + std::iter::Sum + Default + std::fmt::Debug + Send + Sync + 'static {
    /// Nearest value to an `f64`.
    fn of(value: f64) -> Self;
    /// This value as an `f64`.
    fn as_f64(self) -> f64;
}

impl Real for f32 {
    #[inline(always)]
    fn of(value: f64) -> Self {
        value as f32
    }
    #[inline(always)]
    fn as_f64(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    #[inline(always)]
    fn of(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn as_f64(self) -> f64 {
        self
    }
}
