//! Newton-Euler equations of the single rigid body at the dynamics instants.
//!
//! `moment = I_w omega' + omega x I_w omega - sum (x_i - p) x f_i`, divided by `m g l`;
//! `balance = m p'' - sum f_i + m g e_z`, divided by `m g`. World frame, `I_w = R I R'`. Source: \[3\].

use super::blocks::Placed;
use super::foot::{StanceForce, stance_force};
use super::math::{Mat3, Vec3, add, add_weighted, along, cross, euler, mul, mul_transposed, scale, sub};
use super::table::{NONE, Place, Span};
use super::write::Rows;
use super::{Constants, RowKind, Spec, Tables};
use crate::real::Real;
use crate::terrain::Ground;
use multiversion::multiversion;

/// Six equalities: moments, then forces.
pub const SPEC: Spec = Spec { rows: 6, pairs: 0, kind: RowKind::Equality, unit: "N m, N" };

/// See [`super::Family::allowed`].
pub fn allowed<T: Real>(constants: &Constants<T>, r: usize, tolerance: T) -> T {
    tolerance * if r < 3 { constants.moment_scale } else { constants.balance_scale }
}

crate::table! {
    /// Dynamics rows at one instant.
    pub struct DynamicsInstant<T> {
        /// Pose on the reference line, m and rad.
        pub reference: [T; 6],
        /// Rate of the reference line, m/s and rad/s.
        pub rate: [T; 6],
        /// Spline weights of value, first and second derivative for three coefficients.
        pub weights: [[T; 3]; 3],
        /// Positions of the coefficients in `x`.
        pub variable: [u32; 3],
        /// Columns of the coefficients.
        pub column: [u32; 3],
        /// Feet in contact, in `stance_forces`.
        pub forces: Span,
        /// Place of the rows in the buffers.
        pub place: Place,
    }
}

/// Writes positions and columns into an entry. Roles: the three coefficients, then two force nodes and the foothold of each foot in
/// contact.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let instant = &mut tables.dynamics_instants[entry];
    instant.place = at.place;
    instant.variable = at.positions(0);
    instant.column = at.columns(0);
    for (i, force) in tables.stance_forces[instant.forces.range()].iter_mut().enumerate() {
        force.node = at.positions(3 + 3 * i);
        force.node_column = at.columns(3 + 3 * i);
        force.foothold_column = at.seats[5 + 3 * i].column;
    }
}

/// Rate of angular momentum of a rotating body and its derivatives.
pub struct Spin<T> {
    /// `I_w omega' + omega x I_w omega`, N m.
    pub moment: Vec3<T>,
    /// Derivative of the moment with respect to each Euler angle, `[angle]`.
    pub by_angle: [Vec3<T>; 3],
    /// Derivative of the moment with respect to each Euler angle rate, `[angle]`.
    pub by_rate: [Vec3<T>; 3],
    /// Derivative of the moment with respect to each Euler angle acceleration, `[angle]`.
    pub by_acceleration: [Vec3<T>; 3],
}

/// Attitude and motion of a rotating body, with the quantities derived from them.
struct Body<'a, T> {
    rot_wb: Mat3<T>,
    inertia: &'a Mat3<T>,
    omega: Vec3<T>,
    omega_dot: Vec3<T>,
    /// `I_w omega`.
    momentum: Vec3<T>,
    /// `I_w omega'`.
    inertial: Vec3<T>,
}

impl<T: Real> Body<'_, T> {
    /// `I_w v` with `I_w = R I R'`.
    #[inline(always)]
    fn inertia_times(&self, v: Vec3<T>) -> Vec3<T> {
        mul(&self.rot_wb, mul(self.inertia, mul_transposed(&self.rot_wb, v)))
    }

    /// Change of the moment when `omega` and `omega'` change by `w` and `a` while the body keeps its attitude.
    #[inline(always)]
    fn by_motion(&self, w: Vec3<T>, a: Vec3<T>) -> Vec3<T> {
        add(self.inertia_times(a), add(cross(w, self.momentum), cross(self.omega, self.inertia_times(w))))
    }

    /// Change of the moment when the body rotates about an axis: `d(I_w v) = axis x I_w v - I_w (axis x v)`.
    #[inline(always)]
    fn by_turn(&self, axis: Vec3<T>) -> Vec3<T> {
        let turned = sub(cross(axis, self.inertial), self.inertia_times(cross(axis, self.omega_dot)));
        let momentum_turned = sub(cross(axis, self.momentum), self.inertia_times(cross(axis, self.omega)));
        add(turned, cross(self.omega, momentum_turned))
    }
}

/// Rate of angular momentum from Euler angles, their rates and accelerations.
///
/// With axes `E = (e_r, e_p, e_z)`: `omega = E angles'` and
/// `omega' = E angles'' + (pitch' e_p + yaw' e_z) x roll' e_r + yaw' e_z x pitch' e_p`.
/// A change of yaw rotates everything; a change of pitch rotates `e_r`; a change of roll rotates no axis.
#[inline(always)]
pub fn spin<T: Real>(inertia: &Mat3<T>, angles: Vec3<T>, rates: Vec3<T>, accelerations: Vec3<T>) -> Spin<T> {
    let (rot_wb, axes) = euler(angles);
    let [e_r, e_p, e_z] = axes;
    // Angular velocity of the roll axis, and the angular velocity about each axis.
    let carrier = add(scale(rates[1], e_p), scale(rates[2], e_z));
    let (roll, pitch, yaw) = (scale(rates[0], e_r), scale(rates[1], e_p), scale(rates[2], e_z));
    let bias = add(cross(carrier, roll), cross(yaw, pitch));
    let (omega, omega_dot) = (along(&axes, rates), add(along(&axes, accelerations), bias));
    let mut body = Body { rot_wb, inertia, omega, omega_dot, momentum: omega, inertial: omega_dot };
    body.momentum = body.inertia_times(omega);
    body.inertial = body.inertia_times(omega_dot);

    let moment = add(body.inertial, cross(omega, body.momentum));
    let e_r_pitched = cross(e_p, e_r);
    let roll_pitched = scale(rates[0], e_r_pitched);
    let by_pitch = body.by_motion(roll_pitched, add(scale(accelerations[0], e_r_pitched), cross(carrier, roll_pitched)));
    Spin {
        moment,
        by_angle: [body.by_turn(e_r), add(body.by_turn(e_p), by_pitch), cross(e_z, moment)],
        by_rate: [
            body.by_motion(e_r, cross(carrier, e_r)),
            body.by_motion(e_p, add(cross(e_p, roll), cross(yaw, e_p))),
            body.by_motion(e_z, cross(e_z, add(roll, pitch))),
        ],
        by_acceleration: [body.inertia_times(e_r), body.inertia_times(e_p), body.inertia_times(e_z)],
    }
}

/// Dynamics rows of all instants.
///
/// * `residual` - out, `[instants][6]`, moment then balance
/// * `jacobian` - out, at each instant's place
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn dynamics<T: Real>(tables: &Tables<T>, x: &[T], ground: &[Ground<T>], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    for instant in &tables.dynamics_instants {
        dynamics_instant(tables, instant, x, ground, residual, jacobian.as_deref_mut());
    }
}

/// Dynamics rows of one instant.
#[inline(always)]
fn dynamics_instant<T: Real>(
    tables: &Tables<T>,
    instant: &DynamicsInstant<T>,
    x: &[T],
    ground: &[Ground<T>],
    residual: &mut [T],
    jacobian: Option<&mut [T]>,
) {
    let constants = &tables.constants;
    let [pose, rate, acceleration] = base_motion(instant, x);
    let base_w = [pose[0], pose[1], pose[2]];
    let spin = spin(
        &constants.inertia,
        [pose[3], pose[4], pose[5]],
        [rate[3], rate[4], rate[5]],
        [acceleration[3], acceleration[4], acceleration[5]],
    );

    let mut force_sum = [T::zero(); 3];
    let mut moment_sum = [T::zero(); 3];
    let mut rows = jacobian.map(|j| Rows::new(j, &instant.place));
    for stance in &tables.stance_forces[instant.forces.range()] {
        let force_w = stance_force(stance, x);
        let at = tables.footholds[stance.foothold as usize] as usize;
        let under = &ground[stance.foothold as usize];
        let arm = sub([x[at], x[at + 1], under.height], base_w);
        force_sum = add(force_sum, force_w);
        moment_sum = add(moment_sum, cross(arm, force_w));
        if let Some(rows) = rows.as_mut() {
            put_by_force(constants, stance, arm, rows);
            put_by_foothold(constants, stance, force_w, under.slope, rows);
        }
    }

    let at = instant.place.row as usize;
    for d in 0..3 {
        residual[at + d] = (spin.moment[d] - moment_sum[d]) * constants.moment_scale;
        let gravity = if d == 2 { constants.weight } else { T::zero() };
        residual[at + 3 + d] = (constants.mass * acceleration[d] - force_sum[d] + gravity) * constants.balance_scale;
    }
    if let Some(rows) = rows.as_mut() {
        put_by_base(constants, instant, &spin, force_sum, rows);
    }
}

/// Pose, rate and acceleration of the base at an instant.
#[inline(always)]
fn base_motion<T: Real>(instant: &DynamicsInstant<T>, x: &[T]) -> [[T; 6]; 3] {
    let (mut pose, mut rate, mut acceleration) = (instant.reference, instant.rate, [T::zero(); 6]);
    for i in 0..3 {
        let at = instant.variable[i] as usize;
        add_weighted(&mut pose, instant.weights[0][i], &x[at..]);
        add_weighted(&mut rate, instant.weights[1][i], &x[at..]);
        add_weighted(&mut acceleration, instant.weights[2][i], &x[at..]);
    }
    [pose, rate, acceleration]
}

/// Writes the derivatives with respect to the force nodes of a foot: `d(-arm x f)/df = -[arm]x`, `d(-f)/df = -1`.
#[inline(always)]
fn put_by_force<T: Real>(constants: &Constants<T>, stance: &StanceForce<T>, arm: Vec3<T>, rows: &mut Rows<T>) {
    let minus_arm = scale(-constants.moment_scale, arm);
    for i in 0..2 {
        if stance.node[i] == NONE {
            continue;
        }
        let column = stance.node_column[i] as usize;
        for part in 0..2 {
            let w = stance.weights[i][part];
            let c = column + 3 * part;
            rows.put_cross(0, c, scale(w, minus_arm));
            for r in 0..3 {
                for d in 0..3 {
                    rows.put(3 + r, c + d, if r == d { -w * constants.balance_scale } else { T::zero() });
                }
            }
        }
    }
}

/// Writes the derivatives with respect to the foothold of a foot: `d(-arm x f)/d arm = [f]x`.
#[inline(always)]
fn put_by_foothold<T: Real>(constants: &Constants<T>, stance: &StanceForce<T>, force_w: Vec3<T>, slope: [T; 2], rows: &mut Rows<T>) {
    if stance.foothold_column == NONE {
        return;
    }
    let c = stance.foothold_column as usize;
    rows.put_by_foothold(0, c, scale(constants.moment_scale, force_w), slope);
    for r in 0..3 {
        rows.put(3 + r, c, T::zero());
        rows.put(3 + r, c + 1, T::zero());
    }
}

/// Writes the derivatives with respect to the base coefficients: `d(-(x - p) x f)/dp = -[sum f]x`.
#[inline(always)]
fn put_by_base<T: Real>(constants: &Constants<T>, instant: &DynamicsInstant<T>, spin: &Spin<T>, force_sum: Vec3<T>, rows: &mut Rows<T>) {
    let zero = T::zero();
    let minus_force = scale(-constants.moment_scale, force_sum);
    for i in 0..3 {
        if instant.column[i] == NONE {
            continue;
        }
        let c = instant.column[i] as usize;
        let (w0, w1, w2) = (instant.weights[0][i], instant.weights[1][i], instant.weights[2][i]);
        rows.put_cross(0, c, scale(w0, minus_force));
        for r in 0..3 {
            for d in 0..3 {
                rows.put(3 + r, c + d, if r == d { constants.mass * w2 * constants.balance_scale } else { zero });
                rows.put(3 + r, c + 3 + d, zero);
                let turn = w0 * spin.by_angle[d][r] + w1 * spin.by_rate[d][r] + w2 * spin.by_acceleration[d][r];
                rows.put(r, c + 3 + d, turn * constants.moment_scale);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::math::dot;
    use super::*;

    #[test]
    fn spin_derivatives_match_central_differences() {
        let inertia = [[0.9, -0.01, 0.05], [-0.01, 1.9, 0.02], [0.05, 0.02, 2.1]];
        let at = [0.3, -0.4, 2.0, 0.7, -1.1, 0.9, 1.5, -0.6, 2.2];
        let value = |v: [f64; 9]| spin(&inertia, [v[0], v[1], v[2]], [v[3], v[4], v[5]], [v[6], v[7], v[8]]);
        let exact = value(at);
        let d = 1e-6;
        for i in 0..9 {
            let (mut up, mut down) = (at, at);
            up[i] += d;
            down[i] -= d;
            let difference = scale(1. / (2. * d), sub(value(up).moment, value(down).moment));
            let analytic = [exact.by_angle, exact.by_rate, exact.by_acceleration][i / 3][i % 3];
            let gap = sub(difference, analytic);
            assert!(dot(gap, gap).sqrt() < 1e-7, "derivative {i}: {difference:?} against {analytic:?}");
        }
    }
}
