//! The same problems for a general solver: what this program is compared with.
//!
//! [`towr`] is TOWR's whole program \[3\] for fixed durations, or with durations as variables, which is the paper's \[1\] first baseline;
//! [`contact_implicit`] its second. All are
//! given to Ipopt by [`ipopt`], one as a [`job`], many by [`workers`]. Ipopt itself is there with the feature `ipopt` only.

pub mod contact_implicit;
mod curve;
pub mod ipopt;
#[cfg(feature = "ipopt")]
mod ipopt_binding;
pub mod job;
pub mod nlp;
mod rigid_body;
pub mod towr;
pub mod workers;

use crate::gait::{Curve, FootCurves, Trajectory};
use crate::task::Task;

/// A trajectory of `task` under its own name.
fn trajectory(
    task: &Task,
    transcription: &str,
    durations: Vec<Vec<f64>>,
    horizon: f64,
    [base_lin, base_ang]: [Curve; 2],
    ee: Vec<FootCurves>,
) -> Trajectory {
    Trajectory {
        scenario: None,
        target: None,
        robot: None,
        terrain: None,
        transcription: Some(transcription.into()),
        seed: None,
        version: Some(env!("CARGO_PKG_VERSION").into()),
        init_base: Some(task.base_start()),
        base_target: task.base_target,
        yaw_target: task.yaw_target,
        force_limit: Some(task.force_limit),
        limits: None,
        durations,
        horizon,
        base_lin,
        base_ang,
        ee,
    }
}
