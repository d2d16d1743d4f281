//! Speeds of the joints of swinging legs beyond their limits, as cost rows.
//!
//! The joints follow the foot with `q' = J^-1 v`, where `v` is the velocity of the foot relative to the base. A row is a weight times the
//! excess of a speed over [`FREE_SHARE`](super::leg_joints::FREE_SHARE) of its limit, relative to the limit, and zero below.

use super::Tables;
use super::blocks::Placed;
use super::foot::{SwingMotion, put_swing, swing_motion};
use super::hip::{HipPoint, hip, put_turned};
use super::leg_joints::{JointLeg, beyond, leg_joints};
use super::math::{Vec3, add, cross, dot, scale, sub};
use super::momentum::Deviation;
use super::table::Place;
use super::write::Rows;
use super::{RowKind, Spec};
use crate::real::Real;
use crate::terrain::Ground;
use multiversion::multiversion;

/// One row per joint.
pub const SPEC: Spec = Spec { rows: 3, pairs: 0, kind: RowKind::Cost, unit: "" };

/// See [`super::Family::allowed`].
pub(super) use super::any_residual as allowed;

crate::table! {
    /// Speeds of the joints of one swinging leg at one point of the quadrature.
    pub struct JointSpeed<T> {
        /// Base; its hip is at the centre of the base.
        pub base: HipPoint<T>,
        /// Position and velocity of the foot.
        pub foot: SwingMotion<T>,
        /// Geometry and limits of the leg.
        pub leg: JointLeg<T>,
        /// Weight of the excess.
        pub weight: T,
        /// Place of the rows.
        pub place: Place,
    }
}

/// Roles: the four blocks of the base, the swing height, the footholds before and after.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let speed = &mut tables.joint_speeds[entry];
    speed.place = at.place;
    speed.base.column = at.columns(0);
    speed.foot.place(at, 4);
}

/// Speeds of the joints of all swinging legs at all points.
///
/// * `residual` - out, by row: one per joint
/// * `jacobian` - out, three rows at each place
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn joint_speed<T: Real>(
    tables: &Tables<T>,
    x: &[T],
    ground: &[Ground<T>],
    deviations: &[Deviation<T>],
    residual: &mut [T],
    mut jacobian: Option<&mut [T]>,
) {
    for speed in &tables.joint_speeds {
        let base = hip(tables, x, deviations, &speed.base);
        let [position, foot_velocity] = swing_motion(tables, x, ground, &speed.foot);
        let leg = &speed.leg;
        let center = add(position, [T::zero(), T::zero(), leg.radius]);
        let foot = sub(center, base.position);
        let velocity = sub(sub(foot_velocity, base.velocity), cross(base.omega, foot));
        let joints = leg_joints(leg, &base.rot_wb, foot);
        let rates = joints.inverse.map(|row| dot(row, velocity));
        // Changes of `J q'` with each joint at constant `q'`.
        let still = [T::zero(); 3];
        let changes: [Vec3<T>; 3] = std::array::from_fn(|k| {
            let by = |j: usize| scale(rates[j], joints.column_by(j, k, still));
            add(add(by(0), by(1)), by(2))
        });
        for j in 0..3 {
            let [excess, active] = beyond(rates[j] * leg.per_speed[j]);
            residual[speed.place.row as usize + j] = speed.weight * excess;
            let Some(jacobian) = jacobian.as_deref_mut() else { continue };
            let by_velocity = scale(speed.weight * active * leg.per_speed[j], joints.inverse[j]);
            let by_posture = joints.by_foot(changes.map(|change| -dot(by_velocity, change)));
            // The velocity of the base at the foot depends on where the foot is.
            let by_foot = add(by_posture, cross(base.omega, by_velocity));
            let turned = add(cross(foot, by_posture), cross(velocity, by_velocity));
            let mut rows = Rows::new(jacobian, &speed.place);
            let negative = -T::one();
            let by = [scale(negative, by_foot), scale(negative, by_velocity), cross(by_velocity, foot), scale(negative, turned)];
            put_turned(&mut rows, j, &speed.base, &base, by);
            put_swing(&mut rows, j, &speed.foot, ground, [by_foot, by_velocity]);
        }
    }
}
