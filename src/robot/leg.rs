//! Legs as chains of joints: forward kinematics, Jacobian, and inverse kinematics of the foot: of its position, and for a sole also of its
//! attitude.
//!
//! The crate `k` is not used because it depends on another version of nalgebra.

use crate::error::{Error, Result, check_name, check_range};
use nalgebra::{DMatrix, DVector, Isometry3, Point3, Quaternion, SMatrix, SVector, Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Largest number of joints of a leg.
pub const MAX_JOINTS: usize = 64;
/// Accuracy of the inverse kinematics, m.
pub const PRECISION: f64 = 1e-6;
/// Smallest number of joints with which a leg places a sole with any attitude.
pub const SOLE_JOINTS: usize = 6;
/// Lever with which a rotation of a sole counts as a distance, relative to the length of the leg. It is about half a foot.
const LEVER: f64 = 0.2;
/// Most iterations of a solve. From a neighbouring position it needs three to five.
const STEPS: usize = 100;
/// Largest step of a joint in one iteration, rad or m. Longer steps leave the range in which the Jacobian predicts the motion of the foot.
const LONGEST_STEP: f64 = 0.3;

/// A joint of a leg.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "file::Joint", into = "file::Joint")]
pub struct LegJoint {
    /// Name in the robot's file.
    pub name: String,
    /// True for a revolute joint, false for a prismatic one.
    pub turns: bool,
    /// Frame of the joint at zero, in the frame of the joint before it; for the first joint, in the base frame.
    pub origin: Isometry3<f64>,
    /// Axis in the joint's own frame.
    pub axis: Unit<Vector3<f64>>,
    /// Lower and upper limit, rad or m; infinite if there is no limit.
    pub limits: [f64; 2],
    /// Largest speed, rad/s or m/s.
    pub velocity: Option<f64>,
    /// Largest torque or force, N m or N.
    pub effort: Option<f64>,
    /// Value in the nominal configuration, rad or m.
    pub nominal: f64,
}

impl LegJoint {
    /// Names of the columns of a table, with units: position, velocity and torque, or force of a prismatic joint.
    pub fn columns(&self) -> [String; 3] {
        let parts = if self.turns { ["position_rad", "velocity_rad/s", "torque_Nm"] } else { ["position_m", "velocity_m/s", "force_N"] };
        parts.map(|part| format!("{}_{part}", self.name))
    }
}

/// A chain of joints from the base to a foot. The first joint is the one at the base.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Leg {
    /// Name of the foot's link.
    pub foot: String,
    /// Centre of the foot ball in the frame of the last joint, m. Equal to the contact point if the radius is zero.
    pub tip: [f64; 3],
    /// Radius of the foot ball, m. The contact point is this far below its centre.
    pub radius: f64,
    /// Rotation from the axes of the sole (forward, left, up) to the frame of the last joint, unit quaternion w, x, y, z. Absent for a ball
    /// or point. The tip is then the centre of the sole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sole: Option<[f64; 4]>,
    /// Joints, 1 to [`MAX_JOINTS`].
    #[cfg_attr(feature = "schema", schemars(with = "Vec<file::Joint>"))]
    pub chain: Vec<LegJoint>,
}

/// Geometry of a leg for given joint values, base frame.
#[derive(Debug, Clone)]
pub struct Posture {
    /// Centre of the foot ball or of the sole, m.
    pub tip: Vector3<f64>,
    /// Rotation from the axes of the sole to the base frame; from the frame of the last joint for a ball or point.
    pub attitude: UnitQuaternion<f64>,
    /// Position of each joint, m.
    pub anchors: Vec<Vector3<f64>>,
    /// Axis of each joint, unit.
    pub axes: Vec<Vector3<f64>>,
}

impl Leg {
    /// Nominal joint values, rad or m.
    pub fn nominal(&self) -> Vec<f64> {
        self.chain.iter().map(|joint| joint.nominal).collect()
    }

    /// Geometry of the leg for joint values `q`, rad or m.
    pub fn posture(&self, q: &[f64]) -> Posture {
        let mut frame = Isometry3::identity();
        let (mut anchors, mut axes) = (Vec::with_capacity(q.len()), Vec::with_capacity(q.len()));
        for (joint, &value) in self.chain.iter().zip(q) {
            frame *= joint.origin;
            anchors.push(frame.translation.vector);
            axes.push(frame.rotation * joint.axis.into_inner());
            frame *= joint_motion(joint.turns, &joint.axis, value);
        }
        let tip = (frame * Point3::from(Vector3::from(self.tip))).coords;
        Posture { tip, attitude: frame.rotation * self.sole_axes(), anchors, axes }
    }

    /// Rotation from the axes of the sole to the frame of the last joint; the identity for a ball or point.
    fn sole_axes(&self) -> UnitQuaternion<f64> {
        self.sole.map_or_else(UnitQuaternion::identity, |[w, i, j, k]| UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k)))
    }

    /// Jacobian of the tip: its velocity for unit speed of each joint, base frame, `[3][joints]`.
    pub fn jacobian(&self, at: &Posture) -> DMatrix<f64> {
        let columns = self
            .chain
            .iter()
            .enumerate()
            .map(|(j, joint)| if joint.turns { at.axes[j].cross(&(at.tip - at.anchors[j])) } else { at.axes[j] });
        let columns: Vec<_> = columns.collect();
        DMatrix::from_fn(3, columns.len(), |row, column| columns[column][row])
    }

    /// Length of the leg from its first joint to the tip, m: the largest distance it can reach.
    pub fn length(&self) -> f64 {
        let between: f64 = self.chain.iter().skip(1).map(|joint| joint.origin.translation.vector.norm()).sum();
        between + Vector3::from(self.tip).norm()
    }

    /// Jacobian of a sole: that of its centre, and its angular velocity times the lever of rotations, base frame, `[6][joints]`.
    fn sole_jacobian(&self, at: &Posture) -> DMatrix<f64> {
        let (centre, lever) = (self.jacobian(at), self.lever());
        let turns = |row: usize, j: usize| if self.chain[j].turns { lever * at.axes[j][row] } else { 0. };
        DMatrix::from_fn(6, self.chain.len(), |row, j| if row < 3 { centre[(row, j)] } else { turns(row - 3, j) })
    }

    /// Lever with which a rotation of the sole counts as a distance, m.
    fn lever(&self) -> f64 {
        LEVER * self.length()
    }

    /// Joint values within their limits that bring the tip to a position within [`PRECISION`]; `None` if none were found. See
    /// [`Leg::approach`].
    pub fn reach(&self, target: &Vector3<f64>, start: &[f64]) -> Option<Vec<f64>> {
        let (q, missed) = self.approach(target, start);
        (missed <= PRECISION).then_some(q)
    }

    /// Joint values within their limits that bring the tip as close to a position as possible, and the remaining distance, m.
    ///
    /// Levenberg-Marquardt: `dq = J' (J J' + d I)^-1 e`. Joints at a limit are left out if the step would exceed it. The result is
    /// deterministic and continuous in the target: of several solutions it is the one on the branch of `start`.
    ///
    /// * `target` - position of the tip, base frame, m
    /// * `start` - joint values of a nearby position, rad or m
    pub fn approach(&self, target: &Vector3<f64>, start: &[f64]) -> (Vec<f64>, f64) {
        self.descend(start, |at| target - at.tip, |at| self.jacobian(at))
    }

    /// Like [`Leg::approach`] for the centre and the attitude of a sole. The remaining distance includes that of the attitude, at a lever
    /// of a fifth of the leg's length.
    pub fn approach_sole(&self, target: &Isometry3<f64>, start: &[f64]) -> (Vec<f64>, f64) {
        let lever = self.lever();
        let missing = |at: &Posture| {
            let turn = (target.rotation * at.attitude.inverse()).scaled_axis() * lever;
            let away = target.translation.vector - at.tip;
            SVector::<f64, 6>::new(away.x, away.y, away.z, turn.x, turn.y, turn.z)
        };
        self.descend(start, missing, |at| self.sole_jacobian(at))
    }

    /// Levenberg-Marquardt for `R` rows: see [`Leg::approach`].
    fn descend<const R: usize>(
        &self,
        start: &[f64],
        missing_at: impl Fn(&Posture) -> SVector<f64, R>,
        jacobian: impl Fn(&Posture) -> DMatrix<f64>,
    ) -> (Vec<f64>, f64) {
        let mut q = self.within_limits(start);
        let mut at = self.posture(&q);
        let mut missing = missing_at(&at);
        let scale = self.length().max(PRECISION);
        let mut damping = 1e-4 * scale * scale;
        for _ in 0..STEPS {
            if missing.norm() <= PRECISION || damping > 1e4 * scale * scale {
                break;
            }
            let Some(next) = self.step(&q, jacobian(&at), &missing, damping) else { break };
            let next = self.within_limits(&next);
            let there = self.posture(&next);
            let left = missing_at(&there);
            if left.norm() < missing.norm() {
                (q, at, missing) = (next, there, left);
                damping *= 0.1;
            } else {
                damping *= 10.;
            }
        }
        (q, missing.norm())
    }

    /// One step towards a target. Joints at a limit that the step would exceed do not take part.
    fn step<const R: usize>(&self, q: &[f64], mut jacobian: DMatrix<f64>, missing: &SVector<f64, R>, damping: f64) -> Option<Vec<f64>> {
        loop {
            let normal = SMatrix::<f64, R, R>::from_fn(|r, c| jacobian.row(r).dot(&jacobian.row(c)));
            let solved = (normal + SMatrix::identity() * damping.max(1e-12)).try_inverse()? * missing;
            let step = jacobian.transpose() * DVector::from_column_slice(solved.as_slice());
            let blocked = |j: usize| {
                let [lower, upper] = self.chain[j].limits;
                step[j] < 0. && q[j] <= lower || step[j] > 0. && q[j] >= upper
            };
            let Some(stopped) = (0..q.len()).find(|&j| blocked(j)) else {
                let longest = step.amax();
                let shorter = if longest > LONGEST_STEP { LONGEST_STEP / longest } else { 1. };
                return Some(q.iter().zip(step.iter()).map(|(v, d)| v + d * shorter).collect());
            };
            // The joint's part of the step is zero from now on, so it is found at most once.
            jacobian.column_mut(stopped).fill(0.);
        }
    }

    fn within_limits(&self, q: &[f64]) -> Vec<f64> {
        self.chain.iter().zip(q).map(|(joint, v)| v.max(joint.limits[0]).min(joint.limits[1])).collect()
    }

    /// Joint speeds that give the tip a velocity, least squares, rad/s or m/s. They are large near a singular posture.
    ///
    /// * `velocity` - of the tip relative to the base, base frame, m/s
    pub fn rates(&self, at: &Posture, velocity: &Vector3<f64>) -> Vec<f64> {
        self.least_squares(&self.jacobian(at), velocity)
    }

    /// Like [`Leg::rates`] for the velocity of the centre of a sole and its angular velocity, both relative to the base, rad/s.
    pub fn sole_rates(&self, at: &Posture, velocity: &Vector3<f64>, spin: &Vector3<f64>) -> Vec<f64> {
        let turn = spin * self.lever();
        self.least_squares(&self.sole_jacobian(at), &SVector::<f64, 6>::new(velocity.x, velocity.y, velocity.z, turn.x, turn.y, turn.z))
    }

    fn least_squares<const R: usize>(&self, jacobian: &DMatrix<f64>, velocity: &SVector<f64, R>) -> Vec<f64> {
        let normal = SMatrix::<f64, R, R>::from_fn(|r, c| jacobian.row(r).dot(&jacobian.row(c)));
        // Small enough to have no effect where the leg can move, and positive where it cannot.
        let damped = normal + SMatrix::identity() * (1e-10 * self.length() * self.length()).max(f64::MIN_POSITIVE);
        let solved = damped.try_inverse().map_or(SVector::zeros(), |inverse| inverse * velocity);
        (jacobian.transpose() * DVector::from_column_slice(solved.as_slice())).as_slice().to_vec()
    }

    /// Torques (forces of prismatic joints) with which massless joints balance a force and a moment on the foot: `-J' f - A' m`, with the
    /// axes `A` of revolute joints, N m or N.
    ///
    /// * `contact` - point where the force acts, base frame, m
    /// * `force`, `moment` - on the robot, base frame, N and N m, the moment about the contact; zero for a ball or point
    pub fn efforts(&self, at: &Posture, contact: &Vector3<f64>, force: &Vector3<f64>, moment: &Vector3<f64>) -> Vec<f64> {
        let jacobian = self.jacobian(&Posture { tip: *contact, ..at.clone() });
        let of_force = -jacobian.transpose() * DVector::from_column_slice(force.as_slice());
        let of_moment = |j: usize| if self.chain[j].turns { at.axes[j].dot(moment) } else { 0. };
        of_force.iter().enumerate().map(|(j, effort)| effort - of_moment(j)).collect()
    }

    /// Checks that this is a valid leg.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the field.
    pub(super) fn validate(&self, place: &str) -> Result<()> {
        if self.chain.is_empty() || self.chain.len() > MAX_JOINTS {
            let value = format!("{} joints", self.chain.len());
            return Err(Error::invalid(format!("{place}.chain"), value, format!("1 to {MAX_JOINTS} joints")));
        }
        check_name(&format!("{place}.foot"), &self.foot)?;
        check_range(&format!("{place}.radius"), self.radius, 0., 10.)?;
        self.tip.iter().try_for_each(|&v| check_range(&format!("{place}.tip"), v, -100., 100.))?;
        if let Some(axes) = &self.sole {
            let length = axes.iter().map(|v| v * v).sum::<f64>().sqrt();
            check_range(&format!("{place}.sole, length of the quaternion"), length, 1. - 1e-6, 1. + 1e-6)?;
            if self.chain.len() < SOLE_JOINTS {
                let value = format!("{} joints", self.chain.len());
                return Err(Error::invalid(format!("{place}.chain"), value, format!("at least {SOLE_JOINTS} joints above a `sole`")));
            }
        }
        for (j, joint) in self.chain.iter().enumerate() {
            let place = format!("{place}.chain[{j}]");
            check_name(&format!("{place}.name"), &joint.name)?;
            let [lower, upper] = joint.limits;
            if lower.is_nan() || upper.is_nan() || lower > upper {
                return Err(Error::invalid(format!("{place}.lower"), lower, format!("at most `upper`, {upper}")));
            }
            check_range(&format!("{place}.nominal"), joint.nominal, lower.max(-1e3), upper.min(1e3))?;
            joint.origin.translation.vector.iter().try_for_each(|&v| check_range(&format!("{place}.origin"), v, -100., 100.))?;
            for (limit, name) in [(joint.velocity, "velocity"), (joint.effort, "effort")] {
                limit.map_or(Ok(()), |v| check_range(&format!("{place}.{name}"), v, 1e-9, 1e9))?;
            }
        }
        Ok(())
    }

    /// Largest vertical force at the foot that the joint efforts can bear in a posture, N: `|J_z' f| <= effort`. Infinite if no joint has
    /// an effort limit.
    pub fn vertical_force(&self, at: &Posture) -> f64 {
        let jacobian = self.jacobian(at);
        let bears = |(j, joint): (usize, &LegJoint)| joint.effort.map_or(f64::INFINITY, |effort| effort / jacobian[(2, j)].abs());
        self.chain.iter().enumerate().map(bears).fold(f64::INFINITY, f64::min)
    }

    /// Largest speed of the tip that the joint speeds allow along x and along y, m/s; a sole keeps its attitude. Infinite if no joint has a
    /// speed limit, `None` if the tip cannot move along one of the two axes.
    pub fn horizontal_speed(&self, at: &Posture) -> Option<f64> {
        let jacobian = if self.sole.is_some() { self.sole_jacobian(at) } else { self.jacobian(at) };
        let inverse = jacobian.clone().pseudo_inverse(1e-6).ok()?;
        let moves = |axis: usize| {
            let rates = inverse.column(axis);
            let reached = (&jacobian * rates)[axis];
            let fastest = |(j, joint): (usize, &LegJoint)| joint.velocity.map_or(f64::INFINITY, |v| v / rates[j].abs());
            (reached > 0.99).then(|| self.chain.iter().enumerate().map(fastest).fold(f64::INFINITY, f64::min))
        };
        Some(moves(0)?.min(moves(1)?))
    }
}

/// File format of joints.
mod file {
    use super::{Isometry3, LegJoint, Quaternion, Unit, UnitQuaternion, Vector3};
    use serde::{Deserialize, Serialize};

    #[derive(Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[serde(deny_unknown_fields)]
    pub struct Joint {
        name: String,
        #[serde(rename = "type")]
        kind: Kind,
        /// x, y, z, m.
        origin: [f64; 3],
        /// w, x, y, z.
        rotation: [f64; 4],
        axis: [f64; 3],
        #[serde(default, skip_serializing_if = "Option::is_none")]
        lower: Option<f64>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        upper: Option<f64>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        velocity: Option<f64>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        effort: Option<f64>,
        nominal: f64,
    }

    #[derive(Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[serde(rename_all = "lowercase")]
    enum Kind {
        Revolute,
        Prismatic,
    }

    impl TryFrom<Joint> for LegJoint {
        type Error = String;

        fn try_from(joint: Joint) -> Result<LegJoint, String> {
            let wrong = |what: &str, value: &[f64]| {
                format!("joint `{}`, {what}: {value:?}, but it must be numbers that are not all zero", joint.name.escape_debug())
            };
            // A vector that already has unit length keeps its digits.
            let has_length = |values: &[f64]| (values.iter().map(|v| v * v).sum::<f64>() - 1.).abs() < 1e-12;
            let ([w, i, j, k], axis) = (joint.rotation, Vector3::from(joint.axis));
            let turn = Quaternion::new(w, i, j, k);
            let turn = if has_length(&joint.rotation) { Some(Unit::new_unchecked(turn)) } else { Unit::try_new(turn, 1e-6) };
            let axis = if has_length(&joint.axis) { Some(Unit::new_unchecked(axis)) } else { Unit::try_new(axis, 1e-6) };
            let turn: UnitQuaternion<f64> = turn.ok_or_else(|| wrong("rotation", &joint.rotation))?;
            let axis = axis.ok_or_else(|| wrong("axis", &joint.axis))?;
            Ok(LegJoint {
                origin: Isometry3::from_parts(Vector3::from(joint.origin).into(), turn),
                turns: matches!(joint.kind, Kind::Revolute),
                axis,
                limits: [joint.lower.unwrap_or(f64::NEG_INFINITY), joint.upper.unwrap_or(f64::INFINITY)],
                velocity: joint.velocity,
                effort: joint.effort,
                nominal: joint.nominal,
                name: joint.name,
            })
        }
    }

    impl From<LegJoint> for Joint {
        fn from(joint: LegJoint) -> Joint {
            let turn = joint.origin.rotation;
            let [lower, upper] = joint.limits.map(|limit| limit.is_finite().then_some(limit));
            Joint {
                name: joint.name,
                kind: if joint.turns { Kind::Revolute } else { Kind::Prismatic },
                origin: joint.origin.translation.vector.into(),
                rotation: [turn.w, turn.i, turn.j, turn.k],
                axis: joint.axis.into_inner().into(),
                lower,
                upper,
                velocity: joint.velocity,
                effort: joint.effort,
                nominal: joint.nominal,
            }
        }
    }
}

/// Displacement of a joint's child for a joint value.
pub(super) fn joint_motion(turns: bool, axis: &Unit<Vector3<f64>>, value: f64) -> Isometry3<f64> {
    if turns {
        Isometry3::from_parts(Default::default(), UnitQuaternion::from_axis_angle(axis, value))
    } else {
        Isometry3::translation(axis.x * value, axis.y * value, axis.z * value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn joint(name: &str, axis: Unit<Vector3<f64>>, xyz: [f64; 3], limits: [f64; 2], nominal: f64) -> LegJoint {
        let [x, y, z] = xyz;
        let origin = Isometry3::translation(x, y, z);
        LegJoint { name: name.into(), turns: true, origin, axis, limits, velocity: Some(10.), effort: Some(20.), nominal }
    }

    /// Hip about x, thigh and calf of 0.2 m about y, knee bent backwards by 90 degrees.
    fn leg() -> Leg {
        let y = Vector3::y_axis();
        Leg {
            foot: "foot".into(),
            chain: vec![
                joint("hip", Vector3::x_axis(), [0.3, 0.1, 0.], [-0.5, 0.5], 0.),
                joint("thigh", y, [0., 0., 0.], [-2., 2.], PI / 4.),
                joint("calf", y, [0., 0., -0.2], [-2.5, -0.5], -PI / 2.),
            ],
            tip: [0., 0., -0.2],
            radius: 0.,
            sole: None,
        }
    }

    #[test]
    fn the_foot_position_agrees_with_trigonometry() {
        let leg = leg();
        let at = leg.posture(&leg.nominal());
        // Both links are 45 degrees off the vertical.
        assert!((at.tip - Vector3::new(0.3, 0.1, -0.4 * (PI / 4.).cos())).norm() < 1e-15);
        assert!((leg.length() - 0.4).abs() < 1e-15);
    }

    #[test]
    fn the_jacobian_agrees_with_differences_for_revolute_and_prismatic_joints() {
        let mut leg = leg();
        leg.chain[1].turns = false;
        for leg in [leg, self::leg()] {
            let q = [0.3, -0.2, -1.1];
            let jacobian = leg.jacobian(&leg.posture(&q));
            for j in 0..3 {
                let tip = |d: f64| leg.posture(&std::array::from_fn::<f64, 3, _>(|i| q[i] + if i == j { d } else { 0. })).tip;
                let difference = (tip(1e-6) - tip(-1e-6)) / 2e-6;
                assert!((0..3).all(|row| (jacobian[(row, j)] - difference[row]).abs() < 1e-9), "joint {j}");
            }
        }
    }

    #[test]
    fn positions_are_reached_within_the_joint_limits_only() {
        let leg = leg();
        let nominal = leg.nominal();
        for q in [[0.4, 1., -2.], [-0.49, -0.5, -0.6], [0.5, 0.3, -0.5]] {
            let target = leg.posture(&q).tip;
            let found = leg.reach(&target, &nominal).unwrap();
            assert!((leg.posture(&found).tip - target).norm() <= PRECISION);
            // The knee keeps its side, so the solution is unique.
            assert!(found.iter().zip(q).all(|(a, b)| (a - b).abs() < 1e-3), "{found:?}, but {q:?}");
            assert!(found.iter().zip(&leg.chain).all(|(v, j)| (j.limits[0]..=j.limits[1]).contains(v)));
        }
        // Targets beyond the leg's length, closer than the knee can fold, and farther to the side than the hip can turn.
        for target in [[0.3, 0.1, -0.41], [0.3, 0.1, -0.05], [0.3, 0.4, -0.2]] {
            assert_eq!(leg.reach(&target.into(), &nominal), None, "{target:?}");
        }
    }

    #[test]
    fn forces_and_speeds_agree_with_the_lever_arms() {
        let leg = leg();
        let at = leg.posture(&leg.nominal());
        // The foot is below the hip, so only the calf has a lever arm: 0.2 sin 45.
        let lever = 0.2 * (PI / 4.).sin();
        assert!((leg.vertical_force(&at) - 20. / lever).abs() < 1e-9);
        // Thigh and hip move the foot along x and y. They are 2 lever arms above it.
        assert!((leg.horizontal_speed(&at).unwrap() - 10. * 2. * lever).abs() < 1e-9);
        let mut weak = leg.clone();
        weak.chain.iter_mut().for_each(|joint| joint.effort = None);
        assert_eq!(weak.vertical_force(&at), f64::INFINITY);
    }
}
