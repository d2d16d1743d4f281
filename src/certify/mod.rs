//! Certification: f64 closing steps, and an evaluation of the result that shares nothing with the solver.

mod close;
pub mod dense;
pub mod rollout;
pub mod verify;

pub use close::{CONTINUE_BELOW, close};
pub use dense::DenseReport;
pub use rollout::RolloutReport;
pub use verify::{Report, RowReport, TOLERANCE, verify, verify_rows};
