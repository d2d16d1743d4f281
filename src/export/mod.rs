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
//! Messages are uncompressed; log time 0 is the start of the motion. In the format `mcap` they are JSON with JSON Schemas:
//!
//! | topic | schema | content |
//! |---|---|---|
//! | `/tf` | `foxglove.FrameTransforms` | `world` to `base` and to each `foot_NAME` |
//! | `/scene` | `foxglove.SceneUpdate` | ground, path and planned footholds once; body, legs, feet and forces |
//! | `/motion` | `cregopt.Motion` | the columns of the CSV, and normal force and friction utilisation of each foot, for plots |
//!
//! In the format `ros2` they are standard messages of ROS 2 in CDR. `ros2 bag play` and rosbag2's readers accept the file:
//!
//! | topic | type | content |
//! |---|---|---|
//! | `/base_trajectory` | `trajectory_msgs/msg/MultiDOFJointTrajectory` | pose, velocity, acceleration of `base` in `world`, once |
//! | `/joint_trajectory` | `trajectory_msgs/msg/JointTrajectory` | positions, velocities, efforts, once; for a robot with joints |
//! | `/tf` | `tf2_msgs/msg/TFMessage` | `world` to `base` and to each `foot_NAME` |
//! | `/feet/NAME/wrench` | `geometry_msgs/msg/WrenchStamped` | wrench of the ground on the foot, in frame `foot_NAME` |
//! | `/feet/NAME/contact` | `std_msgs/msg/Bool` | true in stance |
//!
//! Stamps are times of the motion. Those of the trajectories are 0, which controllers take as "now". The frame of a foot without a sole has
//! the axes of the world, so its wrench has a force alone. At a node of the base curve, its acceleration is that of the piece that ends.

pub mod csv;
#[cfg(feature = "mcap")]
mod log;
#[cfg(feature = "mcap")]
pub mod mcap;
#[cfg(feature = "mcap")]
pub mod ros2;

#[cfg(not(feature = "mcap"))]
use crate::error::Error;
use crate::error::{Result, check_range};
use crate::gait::Trajectory;
#[cfg(feature = "mcap")]
use crate::report::samples::{FootSample, SoleSample};
use crate::report::samples::{Sample, Sampler, foot_names};
use crate::robot::Robot;
use crate::terrain::Terrain;
use serde::{Deserialize, Serialize};

/// Largest sampling rate, Hz.
pub const MOST_RATE: f64 = 10_000.;

/// File formats: each has a file in this module.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// Table with units in its header
    Csv,
    /// MCAP with the schemas of Foxglove, for viewers
    Mcap,
    /// MCAP with messages of ROS 2: trajectories of base and joints, wrenches and contacts of the feet
    Ros2,
}

impl Format {
    /// Extension of a file.
    pub fn extension(self) -> &'static str {
        match self {
            Format::Csv => "csv",
            Format::Mcap => "mcap",
            Format::Ros2 => "ros2.mcap",
        }
    }

    /// Bytes of the file of a motion, and the number of its samples.
    ///
    /// * `rate` - sampling rate, Hz, at most [`MOST_RATE`]
    ///
    /// # Errors
    /// Errors of [`Sampled::new`], and [`crate::Error::Missing`] for a format that this build does not have.
    pub fn bytes(self, trajectory: &Trajectory, robot: &Robot, terrain: &Terrain, rate: f64) -> Result<(Vec<u8>, usize)> {
        let sampled = Sampled::new(trajectory, robot, terrain, rate)?;
        let bytes = match self {
            Format::Csv => csv::csv(&sampled).into_bytes(),
            #[cfg(feature = "mcap")]
            Format::Mcap => mcap::mcap(&sampled, trajectory, robot, terrain)?,
            #[cfg(feature = "mcap")]
            Format::Ros2 => ros2::ros2(&sampled, trajectory, robot, terrain, rate)?,
            #[cfg(not(feature = "mcap"))]
            Format::Mcap | Format::Ros2 => {
                return Err(Error::Missing { message: "this program was built without the feature `mcap`".into() });
            }
        };
        Ok((bytes, sampled.samples.len()))
    }
}

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

/// Unit quaternion w, x, y, z of no rotation.
#[cfg(feature = "mcap")]
const NO_TURN: [f64; 4] = [1., 0., 0., 0.];

/// Unit quaternion w, x, y, z from a foot to the world: that of a sole, no rotation for a ball or point.
#[cfg(feature = "mcap")]
fn turn_of(foot: &FootSample) -> [f64; 4] {
    foot.sole.as_ref().map_or(NO_TURN, SoleSample::quaternion)
}

/// Name of the frame of a foot.
#[cfg(feature = "mcap")]
fn frame_name(foot: &str) -> String {
    if foot.starts_with("foot_") { foot.to_owned() } else { format!("foot_{foot}") }
}
