//! The independent check: an evaluation of a motion in f64 that shares nothing with the solver. It imports gait, robot and terrain, and for
//! what a file says of itself scenarios and settings.
//!
//! Nothing is certified by samples alone: forces, speeds and depths have their greatest values on whole pieces, what turns
//! with the base is bounded between the times at which it is evaluated.
//!
//! # What a certificate says
//! `verify` shares no code with the solver, and no value of a `momentum` motion is certified by samples alone: normal force, force limit and the friction cone
//! are bounded on whole pieces (a convex function of a cubic is not above its control points, and halving closes the gap), and so are speed, acceleration and
//! depth of feet and base, how far a standing foot is off its foothold, the terrain split where its patches meet; reach, and the way off the rollout,
//! which turn with the base, by their second derivative between the times at which they are evaluated. What the forces add to a momentum that the plan does
//! not have is told as a mean force, over 0.1 s at most. Feet are held to the exact cone; TOWR's own motions to its pyramid, which circumscribes the cone, and the
//! report says which. What no robot does is refused in every motion: pieces shorter than 1 ms, a base that turns by more than 10 `sqrt(g / l)`, accelerates
//! more than its feet push, or is below the ground; in all but TOWR's own, feet faster than 30 m/s. Tolerances of `momentum` go by the robot: 1e-4 of its
//! weight `W`, 1e-4 `W l`, 5e-4 of its leg `l`, 5e-4 `sqrt(g l)`, 1e-3 `g`, 1e-4 rad (1e-2 for what the momentum of one base piece turns it off the plan); N_vc of TOWR's rows is counted beyond 1e-4 as in the paper.
//! Robot, ground, goal and limits are those of the file unless given, and are printed as such; a name or a scenario that its content contradicts is an error.

mod ball;
mod bernstein;
mod certificate;
pub mod dense;
mod exact;
pub mod labels;
pub mod report;
pub mod rollout;
mod stretch;

pub use certificate::{MOTION_LIMITS, verify, verify_rows};
pub use dense::DenseReport;
pub use report::{Report, RowReport, TOLERANCE};
pub use rollout::RolloutReport;
