//! Powers of standing legs as cost rows, along the leg and across it.
//!
//! With the force `f` in weights, the direction `e` of the leg `r` from hip to foot, the velocity `v = -v_hip` of the foot relative to the
//! hip and the angular velocity `omega` of the base, the powers are `(f . e)(e . v)` and `f . (v - omega x r) - (f . e)(e . v)`, in m/s.
//! [`crate::gait::cost`] explains them.

use super::Tables;
use super::blocks::Placed;
use super::foot::{StanceForce, put_stance, stance_force};
use super::hip::{Hip, HipPoint, hip, put_base};
use super::math::{Vec3, add, cross, dot, scale, sub};
use super::momentum::Deviation;
use super::table::Place;
use super::write::Rows;
use super::{RowKind, Spec};
use crate::gait::cost::LEAST_LEG;
use crate::real::Real;
use crate::terrain::Ground;
use multiversion::multiversion;

/// Along the leg, across it.
pub const SPEC: Spec = Spec { rows: 2, pairs: 0, kind: RowKind::Cost, unit: "m/s" };

/// See [`super::Family::allowed`].
pub(super) use super::any_residual as allowed;

crate::table! {
    /// Powers of one standing leg at one point of the quadrature.
    pub struct StancePower<T> {
        /// Base and hip.
        pub base: HipPoint<T>,
        /// Force of the foot, in weights.
        pub stance: StanceForce<T>,
        /// Place of the rows.
        pub place: Place,
    }
}

/// Roles: the four blocks of the base, the two nodes, the foothold.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let power = &mut tables.stance_powers[entry];
    power.place = at.place;
    power.base.column = at.columns(0);
    power.stance.place(at, 4);
}

/// Powers of all standing legs at all points.
///
/// * `residual` - out, by row: along, across, m/s
/// * `jacobian` - out, two rows at each place
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn stance_power<T: Real>(
    tables: &Tables<T>,
    x: &[T],
    ground: &[Ground<T>],
    deviations: &[Deviation<T>],
    residual: &mut [T],
    mut jacobian: Option<&mut [T]>,
) {
    for power in &tables.stance_powers {
        let hip = hip(tables, x, deviations, &power.base);
        let foothold = tables.footholds[power.stance.foothold as usize] as usize;
        let under = &ground[power.stance.foothold as usize];
        let force = stance_force(&power.stance, x);
        let leg = sub([x[foothold], x[foothold + 1], under.height], hip.position);
        let inverse = T::one() / dot(leg, leg).sqrt().max(T::of(LEAST_LEG));
        let e = scale(inverse, leg);
        let v = scale(-T::one(), hip.velocity);
        let (pushed, stretched) = (dot(force, e), dot(e, v));
        let at = power.place.row as usize;
        residual[at] = pushed * stretched;
        let against_body = sub(v, cross(hip.omega, leg));
        residual[at + 1] = dot(force, against_body) - pushed * stretched;
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &power.place);
        // Derivatives with respect to e, then to the leg: those of a unit vector.
        let by_e = add(scale(stretched, force), scale(pushed, v));
        let by_leg = scale(inverse, sub(by_e, scale(dot(e, by_e), e)));
        let along = [scale(stretched, e), scale(pushed, e), by_leg, [T::zero(); 3]];
        let across = [sub(against_body, along[0]), sub(force, along[1]), sub(cross(hip.omega, force), by_leg), cross(force, leg)];
        put_row(&mut rows, 0, power, &hip, under, along);
        put_row(&mut rows, 1, power, &hip, under, across);
    }
}

/// Writes one row from its derivatives with respect to force, velocity, leg and angular velocity.
#[inline(always)]
fn put_row<T: Real>(rows: &mut Rows<T>, row: usize, power: &StancePower<T>, hip: &Hip<T>, under: &Ground<T>, by: [Vec3<T>; 4]) {
    let [by_force, by_velocity, by_leg, by_omega] = by;
    put_base(rows, row, &power.base, hip, [scale(-T::one(), by_leg), scale(-T::one(), by_velocity), by_omega]);
    put_stance(rows, row, &power.stance, under, [by_force, by_leg]);
}
