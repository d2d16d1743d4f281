//! Default limits of the legs, used if the settings specify none.

use crate::gait::family::{FOOT_SPEED_SCALED, speed_scale};
use crate::robot::{GRAVITY, Robot};
use crate::settings::{Legs, TranscriptionSettings};

/// Largest horizontal speed of a foot, m/s. If the settings specify none: `1.9 sqrt(g l)` for legs with base height `l`, or 20 for free
/// legs.
pub fn foot_speed(settings: &TranscriptionSettings, robot: &Robot) -> f64 {
    settings.foot_speed.unwrap_or_else(|| match settings.legs {
        Legs::Limited => FOOT_SPEED_SCALED * speed_scale(robot),
        Legs::Free => 20.,
    })
}

/// Largest acceleration of a swinging foot, m/s². If the settings specify none: 20 g, or no limit (`None`) for free legs.
pub fn foot_acceleration(settings: &TranscriptionSettings) -> Option<f64> {
    settings.foot_acceleration.or(match settings.legs {
        Legs::Limited => Some(20. * GRAVITY),
        Legs::Free => None,
    })
}
