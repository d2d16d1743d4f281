//! Default limits of the legs, used if the settings specify none.

use crate::gait::family::{FOOT_SPEED_SCALED, speed_scale};
use crate::robot::{GRAVITY, Robot};
use crate::settings::{Legs, TranscriptionSettings};

/// Moment of a swinging leg relative to the largest moment of the sole on which the robot stands.
pub const SWING_MOMENT: f64 = 2.;

/// Largest horizontal speed of a foot, m/s. If the settings specify none: `1.9 sqrt(g l)` for legs with base height `l`, or 20 for free
/// legs.
pub fn foot_speed(settings: &TranscriptionSettings, robot: &Robot) -> f64 {
    settings.foot_speed.unwrap_or_else(|| match settings.legs {
        Legs::Limited => FOOT_SPEED_SCALED * speed_scale(robot),
        Legs::Free => 20.,
    })
}

/// Largest acceleration of a swinging foot, m/s². If the settings specify none: 20 g, or no limit (`None`) for free legs.
///
/// The moment of a swinging leg about the base turns a robot that stands on one sole. With soles the default is therefore at most that at
/// which this moment is [`SWING_MOMENT`] times the largest that the sole can bear: 48 m/s² for Unitree's G1, which fell in MuJoCo when it
/// followed walks with 150 m/s², and followed all that were tried with up to 80 m/s².
pub fn foot_acceleration(settings: &TranscriptionSettings, robot: &Robot) -> Option<f64> {
    let borne = |half_length: f64| SWING_MOMENT * robot.weight() * half_length / (robot.leg_mass() * robot.leg_height());
    let default = robot.sole.map_or(f64::INFINITY, |sole| borne(sole.half_extents()[0])).min(20. * GRAVITY);
    settings.foot_acceleration.or(match settings.legs {
        Legs::Limited => Some(default),
        Legs::Free => None,
    })
}
