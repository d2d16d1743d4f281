//! The independent check: an evaluation of a motion in f64 that shares nothing with the solver. It imports gait, robot and terrain alone.

pub mod certificate;
pub mod dense;
pub mod rollout;

pub use certificate::{Report, RowReport, TOLERANCE, verify, verify_rows};
pub use dense::DenseReport;
pub use rollout::RolloutReport;
