//! Independent check: evaluates a motion in f64 without sharing any code with the solver. It imports gait, robot and terrain, and scenarios
//! and settings for the labels of a file. It deliberately repeats the formulas for Hermite pieces, Bernstein control points and Euler
//! angles, so that an error in the solver is not repeated in its check.
//!
//! # Content of a certificate
//! No value of a `momentum` motion is certified by samples alone.
//!
//! * Normal force, force limit, friction cone, speed and acceleration of feet, depth of feet and base, and the distance of a standing foot
//!   from its foothold are bounded on whole pieces. A convex function of a cubic is bounded by its maximum at the control points, and
//!   halving closes the gap. The terrain is split where its patches meet.
//! * Wrenches of soles, their distance from the ground and from each other, and their yaw are bounded on parts that are halved: see `sole`.
//! * Reach and the deviation from the rollout depend on the attitude of the base. They are bounded between the times of their evaluation by
//!   the second derivative.
//! * The difference between the integrated forces and the planned momentum is reported as a mean force over at most 0.1 s.
//!
//! Feet are checked against the exact friction cone, in TOWR's own motions against its pyramid, which circumscribes the cone; the report
//! names the one used. Every motion is refused that no robot can perform: pieces shorter than 1 ms, a base that turns faster than 10
//! `sqrt(g / l)`, accelerates more than its feet push, or is below the ground; in all but TOWR's own motions also feet faster than 30 m/s.
//!
//! Tolerances of `momentum` scale with the robot's weight `W` and leg length `l`: forces 1e-4 `W`, moments 1e-4 `W l`, lengths 5e-4 `l`,
//! speeds 5e-4 `sqrt(g l)`, accelerations 1e-3 `g`, angles 1e-4 rad (1e-2 rad for the attitude that one base piece may differ from the
//! plan). N_vc of TOWR's rows counts violations above 1e-4, as in the paper.
//!
//! Robot, ground, goal and limits are those of the file unless given, and the report prints their source. A name or a scenario that
//! contradicts the content of the file is an error.

mod ball;
mod bernstein;
mod certificate;
pub(crate) mod curves;
pub mod dense;
mod exact;
pub mod labels;
pub mod report;
pub mod rollout;
pub(crate) mod sole;
mod stretch;

pub use certificate::{MOTION_LIMITS, verify, verify_rows};
pub use dense::DenseReport;
pub use report::{Report, RowReport, TOLERANCE};
pub use rollout::RolloutReport;
