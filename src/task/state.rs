//! Pose and velocity of the base.

use crate::error::{Result, check_range};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, PI};

/// Pose and velocity of the base at one end of a motion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct BaseState {
    /// Position, world frame, m.
    pub position: [f64; 3],
    /// Roll, pitch and yaw, rad; rotation `Rz(yaw) Ry(pitch) Rx(roll)` from base to world.
    #[serde(default)]
    pub angles: [f64; 3],
    /// Velocity, world frame, m/s.
    #[serde(default)]
    pub velocity: [f64; 3],
    /// Rates of roll, pitch and yaw, rad/s.
    #[serde(default)]
    pub rates: [f64; 3],
}

/// State of a foot that is in the air at the start of a motion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SwingState {
    /// Position, world frame, m.
    pub position: [f64; 3],
    /// Velocity, world frame, m/s.
    #[serde(default)]
    pub velocity: [f64; 3],
    /// Time since lift-off, s. The foot still rises to the middle of the whole swing, and only descends after that.
    #[serde(default)]
    pub since: f64,
}

impl SwingState {
    /// Time until the middle of the whole swing, s, for a foot that lands after `left` s; `None` for a foot that only descends, because the
    /// middle has passed or is less than a quarter of that time ahead.
    pub(crate) fn rise(&self, left: f64) -> Option<f64> {
        Some((left - self.since) / 2.).filter(|rise| *rise >= left / 4.)
    }

    /// Checks that all numbers are in range.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] names the first number out of range, for example `start_swings[2].velocity[0]`.
    pub fn validate(&self, foot: usize) -> Result<()> {
        for (what, values, limit) in [("position", self.position, 1100.), ("velocity", self.velocity, 100.)] {
            for axis in 0..3 {
                check_range(&format!("start_swings[{foot}].{what}[{axis}]"), values[axis], -limit, limit)?;
            }
        }
        check_range(&format!("start_swings[{foot}].since"), self.since, 0., crate::gait::schedule::MAX_HORIZON)
    }
}

/// Largest roll and pitch, rad. Euler angles are singular at a pitch of 90 degrees.
pub const LARGEST_TILT: f64 = 1.4;

impl BaseState {
    /// State at rest and level.
    pub fn level(position: [f64; 3], yaw: f64) -> BaseState {
        BaseState { position, angles: [0., 0., yaw], velocity: [0.; 3], rates: [0.; 3] }
    }

    /// State of a base with a rotation matrix, by rows, and an angular velocity in the world frame, rad/s. The yaw is within half a turn.
    pub fn of_rotation(position: [f64; 3], rotation: [[f64; 3]; 3], velocity: [f64; 3], omega: [f64; 3]) -> BaseState {
        let r = &rotation;
        let (roll, pitch, yaw) = (r[2][1].atan2(r[2][2]), (-r[2][0]).clamp(-1., 1.).asin(), r[1][0].atan2(r[0][0]));
        // omega = roll' R e_x + pitch' Rz e_y + yaw' e_z
        let (sin, cos) = yaw.sin_cos();
        let along = cos * omega[0] + sin * omega[1];
        let roll_rate = along / pitch.cos();
        let rates = [roll_rate, cos * omega[1] - sin * omega[0], omega[2] + roll_rate * pitch.sin()];
        BaseState { position, angles: [roll, pitch, yaw], velocity, rates }
    }

    /// Yaw, rad.
    pub fn yaw(&self) -> f64 {
        self.angles[2]
    }

    /// Position and angles.
    pub fn pose(&self) -> [f64; 6] {
        join(self.position, self.angles)
    }

    /// Velocity and angle rates.
    pub fn rate(&self) -> [f64; 6] {
        join(self.velocity, self.rates)
    }

    /// True if the base neither moves nor rotates.
    pub fn at_rest(&self) -> bool {
        self.rate() == [0.; 6]
    }

    /// True if the base is at rest with zero roll and pitch.
    pub fn is_level(&self) -> bool {
        self.at_rest() && self.angles[..2] == [0.; 2]
    }

    /// Rotation matrix from base to world, by rows.
    pub fn rotation(&self) -> [[f64; 3]; 3] {
        let [(sr, cr), (sp, cp), (sy, cy)] = self.angles.map(f64::sin_cos);
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    }

    /// World position of a point of the base frame, m.
    pub fn to_world(&self, point: [f64; 3]) -> [f64; 3] {
        let rotation = self.rotation();
        std::array::from_fn(|i| (0..3).fold(self.position[i], |sum, j| sum + rotation[i][j] * point[j]))
    }

    /// Base-frame position of a point of the world, m.
    pub fn to_base(&self, point: [f64; 3]) -> [f64; 3] {
        let rotation = self.rotation();
        std::array::from_fn(|i| (0..3).map(|j| rotation[j][i] * (point[j] - self.position[j])).sum())
    }

    /// Checks that all numbers are in range.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] names the first number out of range, for example `goal.pitch`.
    pub fn validate(&self, end: &str) -> Result<()> {
        let turns = 20. * PI;
        for (what, values, limit) in [("position", self.position, 1000.), ("velocity", self.velocity, 100.), ("rates", self.rates, 100.)] {
            for axis in 0..3 {
                check_range(&format!("{end}.{what}[{axis}]"), values[axis], -limit, limit)?;
            }
        }
        let limits = [LARGEST_TILT, LARGEST_TILT, turns];
        for (what, (angle, limit)) in ["roll", "pitch", "yaw"].into_iter().zip(self.angles.into_iter().zip(limits)) {
            check_range(&format!("{end}.{what}"), angle, -limit, limit)?;
        }
        Ok(())
    }
}

const _: () = assert!(LARGEST_TILT < FRAC_PI_2);

fn join(a: [f64; 3], b: [f64; 3]) -> [f64; 6] {
    [a[0], a[1], a[2], b[0], b[1], b[2]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rotation_agrees_with_euler_angles() {
        let state = BaseState { angles: [0.3, -0.4, 2.1], ..BaseState::level([1., 2., 3.], 0.) };
        let expected = nalgebra::Rotation3::from_euler_angles(0.3, -0.4, 2.1);
        let rotation = state.rotation();
        for i in 0..3 {
            for j in 0..3 {
                assert!((rotation[i][j] - expected[(i, j)]).abs() < 1e-15);
            }
        }
        let back = state.to_base(state.to_world([0.1, -0.7, 0.4]));
        assert!(back.iter().zip([0.1, -0.7, 0.4]).all(|(a, b)| (a - b).abs() < 1e-14), "{back:?}");
    }

    #[test]
    fn a_rotation_and_an_angular_velocity_give_angles_and_rates() {
        let (angles, rates) = ([0.3, -0.4, 2.1], [0.7, -1.1, 0.4]);
        let state = BaseState { angles, rates, ..BaseState::level([1., 2., 3.], 0.) };
        // R' = [omega]x R, by differences.
        let moved = |step: f64| {
            let angles = std::array::from_fn(|i| angles[i] + step * rates[i]);
            nalgebra::Matrix3::from_fn(|r, c| BaseState { angles, ..state }.rotation()[r][c])
        };
        let spin = (moved(1e-6) - moved(-1e-6)) / 2e-6 * moved(0.).transpose();
        let omega = [spin[(2, 1)], spin[(0, 2)], spin[(1, 0)]];
        let back = BaseState::of_rotation(state.position, state.rotation(), state.velocity, omega);
        assert!((0..3).all(|i| (back.angles[i] - angles[i]).abs() < 1e-12 && (back.rates[i] - rates[i]).abs() < 1e-8), "{back:?}");
    }

    #[test]
    fn errors_name_the_value_out_of_range() {
        let steep = BaseState { angles: [0., 1.5, 0.], ..BaseState::level([0.; 3], 0.) };
        assert!(steep.validate("goal").unwrap_err().to_string().starts_with("goal.pitch"));
        let nan = BaseState { rates: [0., 0., f64::NAN], ..BaseState::level([0.; 3], 0.) };
        assert!(nan.validate("start").unwrap_err().to_string().starts_with("start.rates[2]"));
    }
}
