//! Joints of a leg in closed form, for the cost rows of torques and speeds.
//!
//! A leg of three revolute joints whose last two axes are parallel, as those of most quadrupeds. With the vector `r` from the first joint
//! to the foot, the first joint turns the second axis `a` until `a . r` is the sideways offset of the foot. The other two joints are then
//! those of a planar leg, whose knee lies where two circles intersect. Of the two solutions of each step, that of the nominal posture is
//! taken. No angle is needed: the columns `a_j x (foot - joint_j)` of the Jacobian consist of axes and positions.

use super::math::{Mat3, Vec3, add, along, cross, dot, mul, mul_transposed, scale, sub};
use crate::gait::joints::IN_HAND;
use crate::real::Real;
use crate::robot::leg::Leg;
use nalgebra::Vector3;

/// Share of its limit above which a joint costs. It is smaller than [`IN_HAND`], because a quadratic price permits a small excess.
pub const FREE_SHARE: f64 = IN_HAND - 0.02;
/// Square of the least distance of a leg from the postures in which its joints lose control of the foot, relative to its size.
pub const LEAST_BEND: f64 = 2.5e-3;
/// Largest sine of the angle between axes that count as parallel, and least one of those that do not.
const PARALLEL: f64 = 1e-3;

crate::table! {
    /// Geometry and limits of a leg.
    pub struct JointLeg<T> {
        /// First joint, base frame, m.
        pub anchor: [T; 3],
        /// Axis of the first joint, base frame, unit.
        pub axis: [T; 3],
        /// Direction of the part of the second axis across the first in the nominal posture, base frame, unit.
        pub across: [T; 3],
        /// Parts of the second axis along and across the first.
        pub second: [T; 2],
        /// Distance of the foot from the first joint along the second axis, m.
        pub offset: T,
        /// Second joint relative to the first: along the first axis, along `across`, and along their cross product, m.
        pub arm: [T; 3],
        /// Distances from the second to the third joint and from there to the foot, across their axis, m.
        pub links: [T; 2],
        /// Signs that choose the solutions of both steps.
        pub sides: [T; 2],
        /// Radius of the ball of the foot, m.
        pub radius: T,
        /// Inverse of the torque limits, 1/(N m); 0 without a limit.
        pub per_torque: [T; 3],
        /// Inverse of the speed limits, s/rad; 0 without a limit.
        pub per_speed: [T; 3],
    }
}

impl<T: Real> JointLeg<T> {
    /// The closed form of a leg; `None` if it has none or no joint has a limit.
    pub fn of(leg: &Leg) -> Option<JointLeg<T>> {
        let [first, second, third] = &leg.chain[..] else { return None };
        let joints = [first, second, third];
        if joints.iter().any(|joint| !joint.turns) || joints.iter().all(|joint| joint.effort.is_none() && joint.velocity.is_none()) {
            return None;
        }
        let at = leg.posture(&leg.nominal());
        let (axis, second_axis) = (at.axes[0], at.axes[1]);
        let across = second_axis - axis * axis.dot(&second_axis);
        if second_axis.cross(&at.axes[2]).norm() > PARALLEL || across.norm() < PARALLEL {
            return None;
        }
        let parts = [axis.dot(&second_axis), across.norm()];
        let across = across / parts[1];
        let third_direction = axis.cross(&across);
        let (foot, arm) = (at.tip - at.anchors[0], at.anchors[1] - at.anchors[0]);
        let planar = |v: Vector3<f64>| v - second_axis * second_axis.dot(&v);
        let (thigh, shank) = (planar(at.anchors[2] - at.anchors[1]), planar(at.tip - at.anchors[2]));
        // The first joint cannot choose a side for a foot beside its axis, nor the knee one for a stretched leg.
        let sides = [-foot.dot(&third_direction), second_axis.cross(&(thigh + shank)).dot(&thigh)];
        let sizes = [foot.norm(), thigh.norm() * shank.norm()];
        if sides.iter().zip(sizes).any(|(side, size)| side.abs() <= PARALLEL * size) {
            return None;
        }
        let of = |v: Vector3<f64>| <[f64; 3]>::from(v).map(T::of);
        let inverse =
            |limit: fn(&crate::robot::leg::LegJoint) -> Option<f64>| joints.map(|joint| T::of(limit(joint).map_or(0., f64::recip)));
        Some(JointLeg {
            anchor: of(at.anchors[0]),
            axis: of(axis),
            across: of(across),
            second: parts.map(T::of),
            offset: T::of(second_axis.dot(&foot)),
            arm: [axis, across, third_direction].map(|direction| T::of(direction.dot(&arm))),
            links: [thigh, shank].map(|link| T::of(link.norm())),
            sides: sides.map(|side| T::of(side.signum())),
            radius: T::of(leg.radius),
            per_torque: inverse(|joint| joint.effort),
            per_speed: inverse(|joint| joint.velocity),
        })
    }
}

/// Joints of a leg for one position of its foot, world frame.
pub struct LegJoints<T> {
    /// Axes of the first joint and of the other two, unit.
    axes: [Vec3<T>; 2],
    /// Columns of the Jacobian of the foot, m.
    columns: [Vec3<T>; 3],
    /// Rows of its inverse, 1/m.
    pub inverse: [Vec3<T>; 3],
}

/// Joints of a leg. Where the foot is out of reach, those of a nearly stretched leg.
///
/// * `rot_wb` - base to world
/// * `foot` - centre of the ball relative to the base, world frame, m
#[inline(always)]
pub fn leg_joints<T: Real>(leg: &JointLeg<T>, rot_wb: &Mat3<T>, foot: Vec3<T>) -> LegJoints<T> {
    let one = T::one();
    let least = T::of(LEAST_BEND);
    let (axis, across) = (leg.axis, leg.across);
    let third = cross(axis, across);
    let r = sub(mul_transposed(rot_wb, foot), leg.anchor);
    // Turn of the first joint: `second[1] (cos u + sin v) = offset - second[0] axis . r`.
    let (u, v) = (dot(across, r), dot(third, r));
    let square = u * u + v * v;
    let p = (leg.offset - leg.second[0] * dot(axis, r)) / leg.second[1];
    let q = leg.sides[0] * (square - p * p).max(least * square).sqrt();
    let norm = one / (square * (p * p + q * q)).sqrt();
    let (cos, sin) = ((p * u - q * v) * norm, (p * v + q * u) * norm);
    let across = add(scale(cos, across), scale(sin, third));
    let third = cross(axis, across);
    let second = add(scale(leg.second[0], axis), scale(leg.second[1], across));
    // The planar leg.
    let from_second = sub(r, along(&[axis, across, third], leg.arm));
    let planar = sub(from_second, scale(dot(from_second, second), second));
    let [thigh, shank] = leg.links;
    let square = dot(planar, planar).max(least * thigh * thigh);
    let distance = square.sqrt();
    let ahead = (thigh * thigh - shank * shank + square) / (distance + distance);
    let aside = leg.sides[1] * (thigh * thigh - ahead * ahead).max(least * thigh * thigh).sqrt();
    let direction = scale(one / distance, planar);
    let from_third = sub(from_second, add(scale(ahead, direction), scale(aside, cross(second, direction))));
    let columns = [cross(axis, r), cross(second, from_second), cross(second, from_third)].map(|column| mul(rot_wb, column));
    let volume = cross(columns[1], columns[2]);
    let determinant = one / dot(columns[0], volume);
    LegJoints {
        axes: [axis, second].map(|axis| mul(rot_wb, axis)),
        inverse: [volume, cross(columns[2], columns[0]), cross(columns[0], columns[1])].map(|row| scale(determinant, row)),
        columns,
    }
}

impl<T: Real> LegJoints<T> {
    /// Axis of joint `j`.
    #[inline(always)]
    pub fn axis(&self, j: usize) -> Vec3<T> {
        self.axes[j.min(1)]
    }

    /// Derivative with respect to joint `k` of the column of joint `j`, for a foot at `to_contact` from the centre of its ball.
    ///
    /// * `to_contact` - constant vector in the base frame, in world coordinates, m
    #[inline(always)]
    pub fn column_by(&self, j: usize, k: usize, to_contact: Vec3<T>) -> Vec3<T> {
        let by_centre = cross(self.axis(k.min(j)), self.columns[k.max(j)]);
        // The last two axes are parallel: only the first joint turns them.
        if k == 0 && j > 0 { add(by_centre, cross(cross(self.axes[0], self.axes[1]), to_contact)) } else { by_centre }
    }

    /// Column of joint `j` for a point at `to_contact` from the centre of the ball.
    #[inline(always)]
    pub fn column(&self, j: usize, to_contact: Vec3<T>) -> Vec3<T> {
        add(self.columns[j], cross(self.axis(j), to_contact))
    }

    /// Derivative with respect to the foot of a value whose derivatives with respect to the joints are given.
    #[inline(always)]
    pub fn by_foot(&self, by_joint: Vec3<T>) -> Vec3<T> {
        along(&self.inverse, by_joint)
    }
}

/// Excess of a share of a limit over [`FREE_SHARE`], with its sign, and its derivative.
#[inline(always)]
pub fn beyond<T: Real>(share: T) -> [T; 2] {
    let excess = share.abs() - T::of(FREE_SHARE);
    if excess <= T::zero() { [T::zero(); 2] } else { [if share < T::zero() { -excess } else { excess }, T::one()] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::leg::LegJoint;
    use nalgebra::{Isometry3, Unit, UnitQuaternion};

    /// Legs of several shapes: hip about x; about a tilted axis; knee forwards, turned frames, links with sideways offsets.
    fn legs() -> Vec<Leg> {
        let joint = |axis: [f64; 3], at: [f64; 3], turn: f64, nominal: f64| LegJoint {
            name: String::new(),
            turns: true,
            origin: Isometry3::from_parts(Vector3::from(at).into(), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn)),
            axis: Unit::new_normalize(axis.into()),
            limits: [f64::NEG_INFINITY, f64::INFINITY],
            velocity: Some(10.),
            effort: Some(20.),
            nominal,
        };
        let leg = |chain: [LegJoint; 3], tip: [f64; 3]| Leg { foot: "foot".into(), chain: chain.into(), tip, radius: 0.02, sole: None };
        let y = [0., 1., 0.];
        vec![
            leg(
                [joint([1., 0., 0.], [0.3, 0.1, 0.], 0., 0.1), joint(y, [0.; 3], 0., 0.8), joint(y, [0., 0., -0.2], 0., -1.5)],
                [0., 0., -0.2],
            ),
            leg(
                [
                    joint([1., 0.2, -0.1], [-0.3, -0.2, 0.03], 0.4, 0.1),
                    joint([0.1, -1., 0.2], [0.05, -0.08, 0.01], -0.3, 0.5),
                    joint([0.1, -1., 0.2], [0.02, -0.03, -0.3], 0., 1.2),
                ],
                [0.03, -0.02, -0.25],
            ),
            // A hip that turns about z, as an insect's.
            leg(
                [joint([0., 0., 1.], [0.2, 0.1, 0.], 0.7, 0.2), joint(y, [0.06, 0., 0.], 0., -0.6), joint(y, [0.1, 0., 0.], 0., 1.4)],
                [0.15, 0., 0.],
            ),
        ]
    }

    #[test]
    fn the_closed_form_is_the_jacobian_of_the_chain() {
        let turn = nalgebra::Rotation3::from_euler_angles(0.2, -0.3, 0.9);
        let rot: Mat3<f64> = std::array::from_fn(|r| std::array::from_fn(|c| turn[(r, c)]));
        for (number, leg) in legs().iter().enumerate() {
            let form = JointLeg::<f64>::of(leg).unwrap();
            for d in [[0., 0., 0.], [0.3, -0.2, 0.25], [-0.4, 0.3, -0.3]] {
                let q: Vec<f64> = leg.nominal().iter().zip(d).map(|(q, d)| q + d).collect();
                let at = leg.posture(&q);
                let jacobian = leg.jacobian(&at);
                let found = leg_joints(&form, &rot, (turn * at.tip).into());
                for j in 0..3 {
                    let expected = turn * Vector3::from_iterator(jacobian.column(j).iter().copied());
                    let column = Vector3::from(found.columns[j]);
                    assert!((column - expected).norm() < 1e-9, "leg {number}, {d:?}, joint {j}: {column} {expected}");
                    for k in 0..3 {
                        let product = dot(found.inverse[j], found.columns[k]);
                        assert!((product - f64::from(j == k)).abs() < 1e-9);
                    }
                }
            }
        }
    }

    #[test]
    fn derivatives_of_columns_are_those_of_the_chain() {
        let rot = [[1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
        let to_contact = [0.01, -0.02, -0.03];
        for leg in legs() {
            let form = JointLeg::<f64>::of(&leg).unwrap();
            let q = leg.nominal();
            let column = |k: usize, by: f64, j: usize| {
                let q: Vec<f64> = (0..3).map(|i| q[i] + if i == k { by } else { 0. }).collect();
                Vector3::from(leg_joints(&form, &rot, leg.posture(&q).tip.into()).column(j, to_contact))
            };
            let here = leg_joints(&form, &rot, leg.posture(&q).tip.into());
            for (j, k) in (0..3).flat_map(|j| (0..3).map(move |k| (j, k))) {
                let difference = (column(k, 1e-6, j) - column(k, -1e-6, j)) / 2e-6;
                assert!((Vector3::from(here.column_by(j, k, to_contact)) - difference).norm() < 1e-8, "column {j} by joint {k}");
            }
        }
    }

    #[test]
    fn legs_without_a_closed_form_have_no_rows() {
        let of = |change: fn(&mut Leg)| {
            let mut leg = legs().remove(0);
            change(&mut leg);
            JointLeg::<f64>::of(&leg).is_some()
        };
        assert!(of(|_| {}));
        assert!(!of(|leg| leg.chain.truncate(2)));
        assert!(!of(|leg| leg.chain[1].turns = false));
        assert!(!of(|leg| leg.chain[2].axis = Vector3::x_axis()), "the knee is not parallel to the thigh's axis");
        assert!(!of(|leg| leg.chain[2].nominal = 0.), "a stretched leg has no side");
        assert!(!of(|leg| leg.chain.iter_mut().for_each(|joint| (joint.effort, joint.velocity) = (None, None))));
    }

    #[test]
    fn an_unreachable_foot_has_finite_joints() {
        let rot = [[1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
        for leg in legs() {
            let form = JointLeg::<f32>::of(&leg).unwrap();
            for foot in [[0.; 3], [0., 0., -3.], [2., 1., 0.4]] {
                let found = leg_joints(&form, &rot, foot);
                assert!(found.inverse.as_flattened().iter().all(|v| v.is_finite()), "{foot:?}: {:?}", found.inverse);
            }
        }
    }
}
