//! Position and velocity of a hip and their derivatives, for the powers of legs.
//!
//! The hip of a foot is above its nominal position, as high as the base: `p + R h` with `h = (x, y, 0)` in the base frame. Its velocity
//! is `v + omega x R h`. Pose and rate of the base are Hermite interpolants of the knots plus the deviation that the forces cause;
//! derivatives leave the deviation out.

use super::Tables;
use super::math::{Mat3, Vec3, add, add_weighted, along, cross, dot, euler, mul, scale};
use super::momentum::{Deviation, INNER_POINTS};
use super::table::NONE;
use super::write::Rows;
use crate::real::Real;

crate::table! {
    /// Base and hip at one point of a quadrature.
    pub struct HipPoint<T> {
        /// Pose on the straight line from start to goal, m and rad.
        pub reference: [T; 6],
        /// Hermite weights of the interval's four blocks for the pose.
        pub value: [T; 4],
        /// Hermite weights of the interval's four blocks for the rate, 1/s.
        pub rate: [T; 4],
        /// Weights of the deviations at the inner points for the pose.
        pub deviation: [T; INNER_POINTS],
        /// Weights of the deviations at the inner points for the rate, 1/s.
        pub deviation_rate: [T; INNER_POINTS],
        /// Interval in [`Tables::momentum_intervals`].
        pub interval: u32,
        /// Columns of the interval's blocks.
        pub column: [u32; 4],
        /// Hip in the base frame (x, y), m.
        pub hip: [T; 2],
    }
}

/// Position and velocity of a hip, world frame.
pub struct Hip<T> {
    /// Base to world.
    pub rot_wb: Mat3<T>,
    /// Position, m.
    pub position: Vec3<T>,
    /// Velocity, m/s.
    pub velocity: Vec3<T>,
    /// Derivatives of the position with respect to each Euler angle, which are those of the velocity with respect to each rate.
    position_by: [Vec3<T>; 3],
    /// Derivatives of the velocity with respect to each Euler angle.
    velocity_by: [Vec3<T>; 3],
    /// Angular velocity of the base, rad/s.
    pub omega: Vec3<T>,
    /// Derivatives of the angular velocity with respect to each Euler angle.
    omega_by: [Vec3<T>; 3],
    /// Axes of the Euler angles: derivatives of the angular velocity with respect to their rates.
    axes: [Vec3<T>; 3],
}

/// The hip at a point.
#[inline(always)]
pub fn hip<T: Real>(tables: &Tables<T>, x: &[T], deviations: &[Deviation<T>], at: &HipPoint<T>) -> Hip<T> {
    let interval = &tables.momentum_intervals[at.interval as usize];
    let (mut pose, mut rate) = (at.reference, interval.rate);
    for i in 0..4 {
        let block = interval.variable[i] as usize;
        add_weighted(&mut pose, at.value[i], &x[block..]);
        add_weighted(&mut rate, at.rate[i], &x[block..]);
    }
    for q in 0..INNER_POINTS {
        let deviation = &deviations[at.interval as usize].pose[q];
        add_weighted(&mut pose, at.deviation[q], deviation);
        add_weighted(&mut rate, at.deviation_rate[q], deviation);
    }
    let (rot_wb, axes) = euler([pose[3], pose[4], pose[5]]);
    let omega = along(&axes, [rate[3], rate[4], rate[5]]);
    let arm = mul(&rot_wb, [at.hip[0], at.hip[1], T::zero()]);
    let position_by = axes.map(|axis| cross(axis, arm));
    // The pitch moves the roll axis, the yaw moves both.
    let omega_by = [[T::zero(); 3], scale(rate[3], cross(axes[1], axes[0])), cross(axes[2], omega)];
    Hip {
        position: add([pose[0], pose[1], pose[2]], arm),
        velocity: add([rate[0], rate[1], rate[2]], cross(omega, arm)),
        position_by,
        velocity_by: std::array::from_fn(|i| add(cross(omega_by[i], arm), cross(omega, position_by[i]))),
        omega,
        omega_by,
        axes,
        rot_wb,
    }
}

/// Writes the base columns of a row.
///
/// * `by` - derivatives of the row with respect to position and velocity of the hip and to the angular velocity
#[inline(always)]
pub fn put_base<T: Real>(rows: &mut Rows<T>, row: usize, at: &HipPoint<T>, hip: &Hip<T>, by: [Vec3<T>; 3]) {
    let [by_position, by_velocity, by_omega] = by;
    let by_angle: Vec3<T> = std::array::from_fn(|i| {
        dot(by_position, hip.position_by[i]) + dot(by_velocity, hip.velocity_by[i]) + dot(by_omega, hip.omega_by[i])
    });
    put_columns(rows, row, at, hip, (by, by_angle));
}

/// Writes the base columns of a row that also depends on the attitude of the base itself.
///
/// * `by` - derivatives of the row with respect to position and velocity of the hip, to the angular velocity, and to a rotation of the
///   base, about the axes of the world
#[inline(always)]
pub fn put_turned<T: Real>(rows: &mut Rows<T>, row: usize, at: &HipPoint<T>, hip: &Hip<T>, by: [Vec3<T>; 4]) {
    let [by_position, by_velocity, by_omega, by_turn] = by;
    let by_angle: Vec3<T> = std::array::from_fn(|i| {
        dot(by_position, hip.position_by[i])
            + dot(by_velocity, hip.velocity_by[i])
            + dot(by_omega, hip.omega_by[i])
            + dot(by_turn, hip.axes[i])
    });
    put_columns(rows, row, at, hip, ([by_position, by_velocity, by_omega], by_angle));
}

/// Writes the base columns of a row from its derivatives and those with respect to the Euler angles.
#[inline(always)]
fn put_columns<T: Real>(rows: &mut Rows<T>, row: usize, at: &HipPoint<T>, hip: &Hip<T>, (by, by_angle): ([Vec3<T>; 3], Vec3<T>)) {
    let [by_position, by_velocity, by_omega] = by;
    let by_rate: Vec3<T> = std::array::from_fn(|i| dot(by_velocity, hip.position_by[i]) + dot(by_omega, hip.axes[i]));
    for i in 0..4 {
        if at.column[i] == NONE {
            continue;
        }
        let (value, rate, column) = (at.value[i], at.rate[i], at.column[i] as usize);
        rows.put_three(row, column, add(scale(value, by_position), scale(rate, by_velocity)));
        rows.put_three(row, column + 3, add(scale(value, by_angle), scale(rate, by_rate)));
    }
}
