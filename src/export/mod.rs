//! Motions in file formats of other programs, as written by `cregopt export`.
//!
//! # Frames and signs
//! Units are SI, angles are in rad. Times run from 0 to the horizon, which is always the last time.
//!
//! | quantity | frame | meaning and sign |
//! |---|---|---|
//! | base position | world | position of the centre of mass, which is the origin of the base frame; z up |
//! | base orientation | base to world | unit quaternion; columns w, x, y, z. Continuous: its sign does not flip between rows |
//! | roll, pitch, yaw | base to world | the same rotation as `Rz(yaw) Ry(pitch) Rx(roll)`; yaw is continuous over full turns |
//! | base velocity | world | of the centre of mass |
//! | base angular velocity | world | right-handed: positive about z turns to the left. In the base frame it is `R' w` |
//! | foot position, velocity | world | of the contact point, not relative to the base |
//! | foot force | world | force of the ground on the foot: a supporting force has positive z; 0 in swing |
//! | moment, yaw of a sole | world | moment of the ground on the foot about the centre of the sole; only for feet with soles |
//! | foot contact | | 1 in stance, 0 in swing; at a phase boundary the value of the phase that begins |
//!
//! Base axes: x forward, y left, z up. Feet are named as in pictures: `LF`, `RF`, ... by side and row, or `foot_0`, ... if these names are
//! not distinct. A motion has no joint angles, because the robot is modelled as a body with feet; they follow from the inverse kinematics
//! of the robot.
//!
//! # MCAP
//! Messages are JSON with JSON Schemas, uncompressed; log time 0 is the start of the motion.
//!
//! | topic | schema | content |
//! |---|---|---|
//! | `/tf` | `foxglove.FrameTransforms` | `world` to `base` and to each `foot_NAME` |
//! | `/scene` | `foxglove.SceneUpdate` | ground, path and planned footholds once; body, legs, feet and forces |
//! | `/motion` | `cregopt.Motion` | the columns of the CSV, and normal force and friction utilisation of each foot, for plots |

pub mod csv;
#[cfg(feature = "mcap")]
pub mod mcap;

use crate::error::{Result, check_range};
use crate::gait::Trajectory;
use crate::report::samples::{Sample, Sampler, foot_names};
use crate::robot::Robot;
use crate::terrain::Terrain;

/// Largest sampling rate, Hz.
pub const MOST_RATE: f64 = 10_000.;

/// Sampled motion with the names of the feet.
pub struct Sampled {
    /// States, in order of time.
    pub samples: Vec<Sample>,
    /// Names of the feet, as used in headers and topics.
    pub names: Vec<String>,
}

impl Sampled {
    /// Samples a motion at `rate`.
    ///
    /// * `rate` - sampling rate, Hz, at most [`MOST_RATE`]
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] if the rate is out of range, the trajectory is malformed, or the robot has another number of feet.
    pub fn new(trajectory: &Trajectory, robot: &Robot, terrain: &Terrain, rate: f64) -> Result<Sampled> {
        check_range("rate, Hz", rate, 1e-3, MOST_RATE)?;
        let samples = Sampler::new(trajectory, robot, terrain)?.samples(rate);
        Ok(Sampled { samples, names: column_names(robot) })
    }
}

/// Names of the feet in names of columns.
pub fn column_names(robot: &Robot) -> Vec<String> {
    foot_names(robot).iter().map(|name| name.replace(' ', "_")).collect()
}
