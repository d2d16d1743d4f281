//! The independent check: an evaluation of a motion in f64 that shares nothing with the solver. It imports gait, robot and terrain alone.
//!
//! Nothing is certified by samples alone: forces, speeds and depths have their greatest values on whole pieces, what turns
//! with the base is bounded between the times at which it is evaluated.

mod ball;
mod bernstein;
pub mod certificate;
pub mod dense;
mod exact;
pub mod labels;
pub mod rollout;

pub use certificate::{Report, RowReport, TOLERANCE, verify, verify_rows};
pub use dense::DenseReport;
pub use rollout::RolloutReport;
