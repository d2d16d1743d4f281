//! Feet with flat soles: rectangles that stay flat on the ground in contact.

use crate::error::{Result, check_range};
use serde::{Deserialize, Serialize};

/// Share of the half length and half width within which the centre of pressure stays. It leaves torsional friction at the corners, see
/// [`Sole::torsion_radius`].
pub const PRESSURE_SHARE: f64 = 0.8;

/// Default largest yaw of a foot relative to the base, rad.
pub const SOLE_TURN: f64 = 0.4;

/// Largest limit of the yaw of a foot relative to the base, rad.
pub(crate) const LARGEST_TURN: f64 = 1.5;

/// A rectangular sole. The foot position of a motion is the centre of the rectangle.
///
/// In contact it transmits a force through its centre and a moment. Both hold exactly if forces at the four corners inside their friction
/// cones can produce them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Sole {
    /// Length from heel to toe, m.
    pub length: f64,
    /// Width, m.
    pub width: f64,
    /// Largest yaw of a foot relative to the base, rad. Default: [`SOLE_TURN`].
    #[serde(default = "default_turn")]
    pub turn: f64,
}

fn default_turn() -> f64 {
    SOLE_TURN
}

impl Sole {
    /// Checks every field.
    ///
    /// * `longest` - largest length and width, m
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] names the first field that is out of range.
    pub fn validate(&self, longest: f64) -> Result<()> {
        check_range("robot.sole.length", self.length, 1e-3, longest)?;
        check_range("robot.sole.width", self.width, 1e-3, longest)?;
        check_range("robot.sole.turn", self.turn, 0.01, LARGEST_TURN)
    }

    /// Half of the length and of the width, m.
    pub fn half_extents(&self) -> [f64; 2] {
        [self.length / 2., self.width / 2.]
    }

    /// Distance from the centre to a corner, m.
    pub fn radius(&self) -> f64 {
        let [x, y] = self.half_extents();
        x.hypot(y)
    }

    /// Lever of torsional friction, m: with the centre of pressure within [`PRESSURE_SHARE`] of the sole, a force `f` and a moment `m` about
    /// the normal through the centre of pressure hold if `|f_t| + |m| / r <= mu f_n`.
    ///
    /// The corners carry bilinear shares of the pressure. With the centre of pressure at `c` and half extents `X`, `Y`, tangential forces of
    /// `mu p_i |x_i - c| / d` perpendicular to `x_i - c`, where `d` is the largest of these distances, have no sum and the moment
    /// `mu f_n (X^2 + Y^2 - |c|^2) / d`, which is least with `c` at a corner of its range: `(1 - share) sqrt(X^2 + Y^2)`.
    pub fn torsion_radius(&self) -> f64 {
        (1. - PRESSURE_SHARE) * self.radius()
    }
}
