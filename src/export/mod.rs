//! Motions for other programs: what `cregopt export` writes.
//!
//! # Frames and signs
//! Units are SI, angles rad. Times run from 0 to the horizon, which is always the last one.
//!
//! | quantity | frame | meaning and sign |
//! |---|---|---|
//! | base position | world | place of the centre of mass, which is the origin of the base frame; z up |
//! | base orientation | base to world | unit quaternion; columns w, x, y, z. Continuous: its sign never flips from one row to the next |
//! | roll, pitch, yaw | base to world | the same rotation as `Rz(yaw) Ry(pitch) Rx(roll)`; yaw counts turns on |
//! | base velocity | world | of the centre of mass |
//! | base angular velocity | world | right-handed: positive about z turns to the left. In the base frame it is `R' w` |
//! | foot position, velocity | world | of the point of contact, not relative to the base |
//! | foot force | world | of the ground on the foot, so pushing up is positive in z; 0 in swing |
//! | foot contact | | 1 while the foot stands, 0 in swing; at a change what begins |
//!
//! Base axes: x forward, y left, z up. Feet have the names of the pictures: `LF`, `RF`, ... by side and row, or `foot_0`, ... where these are not
//! distinct. Joint angles are not part of a motion: a robot is a body with feet, and its own inverse kinematics gives them.
//!
//! # MCAP
//! Messages are JSON with JSON Schemas, uncompressed; log time 0 is the start of the motion.
//!
//! | topic | schema | what |
//! |---|---|---|
//! | `/tf` | `foxglove.FrameTransforms` | `world` to `base` and to each `foot_NAME` |
//! | `/scene` | `foxglove.SceneUpdate` | ground, path and planned footholds once; body, legs, feet and forces |
//! | `/motion` | `cregopt.Motion` | the columns of the CSV, with normal force and use of friction of each foot, to be plotted |

pub mod csv;
#[cfg(feature = "mcap")]
pub mod mcap;

use crate::error::{Result, check_range};
use crate::gait::Trajectory;
use crate::report::samples::{Sample, Sampler, foot_names};
use crate::robot::Robot;
use crate::terrain::Terrain;

/// Most samples a second.
pub const MOST_RATE: f64 = 10_000.;

/// A motion at instants, with the names of its feet.
pub struct Sampled {
    /// States, in time.
    pub samples: Vec<Sample>,
    /// Names of the feet, as they stand in headers and topics.
    pub names: Vec<String>,
}

impl Sampled {
    /// Samples a motion.
    ///
    /// * `rate` - Hz, to [`MOST_RATE`]
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for another rate, a malformed trajectory, or a robot with another number of feet.
    pub fn new(trajectory: &Trajectory, robot: &Robot, terrain: &Terrain, rate: f64) -> Result<Sampled> {
        check_range("rate, Hz", rate, 1e-3, MOST_RATE)?;
        let samples = Sampler::new(trajectory, robot, terrain)?.samples(rate);
        Ok(Sampled { samples, names: foot_names(robot).iter().map(|name| name.replace(' ', "_")).collect() })
    }
}
