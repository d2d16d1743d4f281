//! Powers of swinging legs as cost rows: `a . (v - v_hip)`, in m/s, with the acceleration `a` of the foot times the share of the leg's mass
//! in the weight. [`crate::gait::cost`] explains them.

use super::Tables;
use super::blocks::Placed;
use super::foot::foot_motion;
use super::hip::{HipPoint, hip, put_base};
use super::math::{add, dot, scale, sub};
use super::momentum::Deviation;
use super::table::{NONE, Place};
use super::write::Rows;
use super::{RowKind, Spec};
use crate::real::Real;
use crate::terrain::Ground;

/// One row.
pub const SPEC: Spec = Spec { rows: 1, pairs: 0, kind: RowKind::Cost, unit: "m/s" };

/// See [`super::Family::allowed`].
pub(super) use super::any_residual as allowed;

crate::table! {
    /// Power of one swinging leg at one point of the quadrature.
    pub struct SwingPower<T> {
        /// Base and hip.
        pub base: HipPoint<T>,
        /// Weights of the footholds before and after for the horizontal velocity, 1/s, and the horizontal acceleration.
        pub xy_weights: [[T; 2]; 2],
        /// Weights of the heights of the footholds and of the mid node for the vertical velocity and the vertical acceleration.
        pub z_weights: [[T; 3]; 2],
        /// Constant parts of velocity and acceleration; zero unless the swing had begun before the motion.
        pub offset: [[T; 3]; 2],
        /// Position of the swing height in `x`.
        pub height: u32,
        /// Column of the swing height.
        pub height_column: u32,
        /// Footholds before and after.
        pub foothold: [u32; 2],
        /// First columns of the footholds.
        pub foothold_column: [u32; 2],
        /// Place of the row.
        pub place: Place,
    }
}

/// Roles: the four blocks of the base, the swing height, the footholds before and after.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let power = &mut tables.swing_powers[entry];
    power.place = at.place;
    power.base.column = at.columns(0);
    power.height = at.seats[4].position;
    power.height_column = at.seats[4].column;
    power.foothold_column = at.columns(5);
}

/// Powers of all swinging legs at all points.
///
/// * `residual` - out, by row, m/s
/// * `jacobian` - out, one row at each place
#[inline(always)]
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
        // Velocity and acceleration of the foot.
        let motion = |order: usize| {
            let (xy_weights, z_weights) = (power.xy_weights[order], power.z_weights[order]);
            add(foot_motion(tables, x, ground, power.foothold, power.height, xy_weights, z_weights), power.offset[order])
        };
        let [velocity, acceleration] = [motion(0), motion(1)];
        let v = sub(velocity, hip.velocity);
        residual[power.place.row as usize] = dot(acceleration, v);
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &power.place);
        let none = [T::zero(); 3];
        put_base(&mut rows, 0, &power.base, &hip, [none, scale(-T::one(), acceleration), none]);
        let by = [acceleration, v];
        for i in 0..2 {
            if power.foothold_column[i] == NONE {
                continue;
            }
            let slope = ground[power.foothold[i] as usize].slope;
            for d in 0..2 {
                let mut sum = T::zero();
                for order in 0..2 {
                    sum += power.xy_weights[order][i] * by[order][d] + power.z_weights[order][i] * slope[d] * by[order][2];
                }
                rows.put(0, power.foothold_column[i] as usize + d, sum);
            }
        }
        if power.height_column != NONE {
            rows.put(0, power.height_column as usize, power.z_weights[0][2] * by[0][2] + power.z_weights[1][2] * by[1][2]);
        }
    }
}
