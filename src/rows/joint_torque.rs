//! Torques of standing legs beyond the limits of their joints, as cost rows.
//!
//! A massless leg balances the force `f` on its foot with the torques `-(a_j x (contact - joint_j)) . f`, see [`crate::gait::joints`]. A
//! row is a weight times the excess of a torque over [`FREE_SHARE`](super::leg_joints::FREE_SHARE) of its limit, relative to the limit,
//! and zero below.

use super::Tables;
use super::blocks::Placed;
use super::foot::{StanceForce, put_stance, stance_force};
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
    /// Torques of one standing leg at one point of the quadrature.
    pub struct JointTorque<T> {
        /// Base; its hip is at the centre of the base.
        pub base: HipPoint<T>,
        /// Force of the foot, N.
        pub stance: StanceForce<T>,
        /// Geometry and limits of the leg.
        pub leg: JointLeg<T>,
        /// Weight of the excess.
        pub weight: T,
        /// Place of the rows.
        pub place: Place,
    }
}

/// Roles: the four blocks of the base, the two nodes, the foothold.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let torque = &mut tables.joint_torques[entry];
    torque.place = at.place;
    torque.base.column = at.columns(0);
    torque.stance.place(at, 4);
}

/// Torques of all standing legs at all points.
///
/// * `residual` - out, by row: one per joint
/// * `jacobian` - out, three rows at each place
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn joint_torque<T: Real>(
    tables: &Tables<T>,
    x: &[T],
    ground: &[Ground<T>],
    deviations: &[Deviation<T>],
    residual: &mut [T],
    mut jacobian: Option<&mut [T]>,
) {
    for torque in &tables.joint_torques {
        let base = hip(tables, x, deviations, &torque.base);
        let foothold = tables.footholds[torque.stance.foothold as usize] as usize;
        let under = &ground[torque.stance.foothold as usize];
        let force = stance_force(&torque.stance, x);
        let leg = &torque.leg;
        let to_contact = [T::zero(), T::zero(), -leg.radius];
        let foot = sub(sub([x[foothold], x[foothold + 1], under.height], to_contact), base.position);
        let joints = leg_joints(leg, &base.rot_wb, foot);
        for j in 0..3 {
            let column = joints.column(j, to_contact);
            let [excess, active] = beyond(-dot(column, force) * leg.per_torque[j]);
            let row = torque.place.row as usize + j;
            residual[row] = torque.weight * excess;
            let Some(jacobian) = jacobian.as_deref_mut() else { continue };
            let unit = -(torque.weight * active * leg.per_torque[j]);
            let by_joint: Vec3<T> = std::array::from_fn(|k| unit * dot(joints.column_by(j, k, to_contact), force));
            let by_foot = joints.by_foot(by_joint);
            let by_force = scale(unit, column);
            // The ball is above the contact in the world: its centre turns against the leg.
            let by_contact = scale(unit, cross(force, joints.axis(j)));
            let turned = add(add(cross(foot, by_foot), cross(force, by_force)), cross(to_contact, by_contact));
            let mut rows = Rows::new(jacobian, &torque.place);
            let (none, negative) = ([T::zero(); 3], -T::one());
            put_turned(&mut rows, j, &torque.base, &base, [scale(negative, by_foot), none, none, scale(negative, turned)]);
            put_stance(&mut rows, j, &torque.stance, under, [by_force, by_foot]);
        }
    }
}
