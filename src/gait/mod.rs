//! Gaits: contact schedules, curves, and trajectories as node values.

pub mod cost;
pub mod family;
pub mod joints;
pub(crate) mod piece;
pub mod schedule;
pub mod spline;
pub mod swing;
pub mod trajectory;

pub use schedule::{AlignedSchedule, Kept, Phase, Schedule};
pub use trajectory::{Curve, FootCurves, Trajectory};
