//! Powers of swinging legs as cost rows: `a . (v - v_hip)`, in m/s, with the acceleration `a` of the foot times the share of the leg's mass
//! in the weight. [`crate::gait::cost`] explains them.

use super::Tables;
use super::blocks::Placed;
use super::foot::{SwingMotion, put_swing, swing_motion};
use super::hip::{HipPoint, hip, put_base};
use super::math::{dot, scale, sub};
use super::momentum::Deviation;
use super::table::Place;
use super::write::Rows;
use super::{RowKind, Spec};
use crate::real::Real;
use crate::terrain::Ground;
use multiversion::multiversion;

/// One row.
pub const SPEC: Spec = Spec { rows: 1, pairs: 0, kind: RowKind::Cost, unit: "m/s" };

/// See [`super::Family::allowed`].
pub(super) use super::any_residual as allowed;

crate::table! {
    /// Power of one swinging leg at one point of the quadrature.
    pub struct SwingPower<T> {
        /// Base and hip.
        pub base: HipPoint<T>,
        /// Velocity of the foot, m/s, and its acceleration times the share of the leg's mass in the weight.
        pub foot: SwingMotion<T>,
        /// Place of the row.
        pub place: Place,
    }
}

/// Roles: the four blocks of the base, the swing height, the footholds before and after.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let power = &mut tables.swing_powers[entry];
    power.place = at.place;
    power.base.column = at.columns(0);
    power.foot.place(at, 4);
}

/// Powers of all swinging legs at all points.
///
/// * `residual` - out, by row, m/s
/// * `jacobian` - out, one row at each place
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn swing_power<T: Real>(
    tables: &Tables<T>,
    x: &[T],
    ground: &[Ground<T>],
    deviations: &[Deviation<T>],
    residual: &mut [T],
    mut jacobian: Option<&mut [T]>,
) {
    for power in &tables.swing_powers {
        let hip = hip(tables, x, deviations, &power.base);
        let [velocity, acceleration] = swing_motion(tables, x, ground, &power.foot);
        let v = sub(velocity, hip.velocity);
        residual[power.place.row as usize] = dot(acceleration, v);
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &power.place);
        let none = [T::zero(); 3];
        put_base(&mut rows, 0, &power.base, &hip, [none, scale(-T::one(), acceleration), none]);
        put_swing(&mut rows, 0, &power.foot, ground, [acceleration, v]);
    }
}
