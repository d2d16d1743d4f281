//! What a leg is asked for where the settings name no limit.

use crate::gait::family::{FOOT_SPEED, speed_scale};
use crate::robot::{GRAVITY, Robot};
use crate::settings::{Legs, TranscriptionSettings};

/// Highest horizontal speed of a foot, m/s: that of the settings, else `1.9 sqrt(g l)` for legs of base height `l`, or 20 where legs are free.
pub fn foot_speed(settings: &TranscriptionSettings, robot: &Robot) -> f64 {
    settings.foot_speed.unwrap_or_else(|| match settings.legs {
        Legs::Limited => FOOT_SPEED * speed_scale(robot),
        Legs::Free => 20.,
    })
}

/// Largest acceleration of a swinging foot, m/s²: that of the settings, else 20 g, or none where legs are free.
pub fn foot_acceleration(settings: &TranscriptionSettings) -> Option<f64> {
    settings.foot_acceleration.or(match settings.legs {
        Legs::Limited => Some(20. * GRAVITY),
        Legs::Free => None,
    })
}
