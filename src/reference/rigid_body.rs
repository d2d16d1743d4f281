//! Rows of the single rigid body with exact derivatives: by dual numbers in the angles, by hand where the rows are bilinear. The formulas
//! are deliberately independent of the solver's.

use super::curve::Point;
use super::nlp::{INFINITY, Rows};
use crate::robot::Robot;
use crate::terrain::Terrain;
use nalgebra::{Matrix3, SVector, Vector3};
use num_dual::{Derivative, DualNum, DualSVec64};

/// Limits of an equality row.
pub const ZERO: [f64; 2] = [0., 0.];

/// Position and attitude of the base at a time, with their derivatives.
#[derive(Debug)]
pub struct Base {
    /// Position, m.
    pub position: Point,
    /// Acceleration, m/s².
    pub acceleration: Point,
    /// Roll, pitch and yaw, rad, with their first and second derivatives.
    pub angles: [Point; 3],
}

/// Dual numbers of independent variables.
fn variables<const N: usize>(values: SVector<f64, N>) -> [DualSVec64<N>; N] {
    std::array::from_fn(|i| {
        let mut unit = SVector::zeros();
        unit[i] = 1.;
        DualSVec64::new(values[i], Derivative::some(unit))
    })
}

/// Gradient of a dual number.
fn gradient<const N: usize>(dual: &DualSVec64<N>) -> SVector<f64, N> {
    dual.eps.unwrap_generic(nalgebra::Const, nalgebra::Const)
}

/// Rotation from base to world, `Rz(yaw) Ry(pitch) Rx(roll)`.
fn rotation<const N: usize>([roll, pitch, yaw]: [DualSVec64<N>; 3]) -> Matrix3<DualSVec64<N>> {
    let ((sr, cr), (sp, cp), (sy, cy)) = (roll.sin_cos(), pitch.sin_cos(), yaw.sin_cos());
    let (zero, one) = (DualSVec64::from(0.), DualSVec64::from(1.));
    let rx = Matrix3::new(one, zero, zero, zero, cr, -sr, zero, sr, cr);
    let ry = Matrix3::new(cp, zero, sp, zero, one, zero, -sp, zero, cp);
    let rz = Matrix3::new(cy, -sy, zero, sy, cy, zero, zero, zero, one);
    rz * ry * rx
}

/// Rate of change of the angular momentum, world frame, N m: `I_w dw/dt + w x I_w w`.
fn spin(inertia: &Matrix3<f64>, [angles, rates, second]: [[DualSVec64<9>; 3]; 3]) -> Vector3<DualSVec64<9>> {
    let ((sp, cp), (sy, cy)) = (angles[1].sin_cos(), angles[2].sin_cos());
    let (zero, one) = (DualSVec64::from(0.), DualSVec64::from(1.));
    // Axes of yaw, pitch and roll, and the rates of change of the latter two.
    let (z, y, x) = (Vector3::new(zero, zero, one), Vector3::new(-sy, cy, zero), Vector3::new(cy * cp, sy * cp, -sp));
    let (y_rate, x_rate) = (z.cross(&y) * rates[2], (z * rates[2] + y * rates[1]).cross(&x));
    let omega = z * rates[2] + y * rates[1] + x * rates[0];
    let omega_rate = z * second[2] + y * second[1] + x * second[0] + y_rate * rates[1] + x_rate * rates[0];
    let r = rotation(angles);
    let inertia_w = r * inertia.map(DualSVec64::from) * r.transpose();
    inertia_w * omega_rate + omega.cross(&(inertia_w * omega))
}

/// Pushes six rows of an instant: `dL/dt - sum (x_i - p) x f_i = 0`, N m, and `m a - sum f_i + m g e_z = 0`, N.
///
/// * `feet` - position, m, and force, N, of each foot, world frame
pub fn dynamics(robot: &Robot, base: &Base, feet: &[(Point, Point)], rows: &mut Rows) {
    let inertia = Matrix3::from_fn(|r, c| robot.inertia[r][c]);
    let given = variables(SVector::<f64, 9>::from_fn(|i, _| base.angles[i / 3].value[i % 3]));
    let of = |order: usize| [given[3 * order], given[3 * order + 1], given[3 * order + 2]];
    let spin = spin(&inertia, [of(0), of(1), of(2)]);
    let moment: Vector3<f64> = feet.iter().map(|(x, f)| (x.value - base.position.value).cross(&f.value)).sum();
    let total: Vector3<f64> = feet.iter().map(|(_, f)| f.value).sum();
    for axis in 0..3 {
        rows.row(spin[axis].re - moment[axis], ZERO);
        let by = gradient(&spin[axis]);
        for (order, angles) in base.angles.iter().enumerate() {
            angles.push(by.fixed_rows::<3>(3 * order).into_owned(), rows);
        }
        // The component of the moment is e . (r x f): its gradient is f x e by r and e x r by f.
        let e = Vector3::ith(axis, 1.);
        let others = [0, 1, 2].map(|d| d != axis);
        base.position.push_where(others, total.cross(&e), rows);
        for (x, f) in feet {
            x.push_where(others, -f.value.cross(&e), rows);
            f.push_where(others, -e.cross(&(x.value - base.position.value)), rows);
        }
    }
    for axis in 0..3 {
        let weight = if axis == 2 { robot.weight() } else { 0. };
        rows.row(robot.mass * base.acceleration.value[axis] - total[axis] + weight, ZERO);
        base.acceleration.push_axis(axis, robot.mass, rows);
        for (_, f) in feet {
            f.push_axis(axis, -1., rows);
        }
    }
}

/// Pushes a row per slab: a foot inside its reach, base frame, m.
pub fn reach(robot: &Robot, foot: usize, base: &Point, angles: &Point, at: &Point, rows: &mut Rows) {
    let given = variables::<3>(angles.value);
    let r = at.value - base.value;
    let to_base = rotation(given).transpose();
    let in_base = to_base * r.map(DualSVec64::from);
    for slab in robot.reach.foot(foot).slabs() {
        let normal = Vector3::from(slab.normal);
        let along = in_base.dot(&normal.map(DualSVec64::from));
        let nominal = slab.along(robot.nominal_feet[foot]);
        rows.row(along.re, slab.sides.map(|side| nominal + side));
        let by_position = to_base.map(|v| v.re).tr_mul(&normal);
        angles.push(gradient(&along), rows);
        at.push(by_position, rows);
        base.push(-by_position, rows);
    }
}

/// Pushes five rows: normal force between 0 and its limit, and the friction pyramid on two tangents, N.
///
/// * `at` - foothold; normal and tangents are those of the terrain there
pub fn contact_force(terrain: &Terrain, limit: f64, force: &Point, at: &Point, rows: &mut Rows) {
    let ground = terrain.ground(at.value.x, at.value.y);
    let given = variables(SVector::<f64, 5>::from_fn(|i, _| if i < 3 { force.value[i] } else { ground.slope[i - 3] }));
    let (f, [hx, hy]) = (Vector3::new(given[0], given[1], given[2]), [given[3], given[4]]);
    let (zero, one) = (DualSVec64::from(0.), DualSVec64::from(1.));
    let unit = |v: Vector3<DualSVec64<5>>| v * v.dot(&v).sqrt().recip();
    let normal = f.dot(&unit(Vector3::new(-hx, -hy, one)));
    let mut rows_of = |value: DualSVec64<5>, limits| {
        rows.row(value.re, limits);
        let by = gradient(&value);
        force.push(by.fixed_rows::<3>(0).into_owned(), rows);
        let by_place = |d: usize| by[3] * ground.curvature[0][d] + by[4] * ground.curvature[1][d];
        at.push(Vector3::new(by_place(0), by_place(1), 0.), rows);
    };
    rows_of(normal, [0., limit]);
    for tangent in [Vector3::new(one, zero, hx), Vector3::new(zero, one, hy)] {
        let along = f.dot(&unit(tangent));
        rows_of(along - normal * terrain.friction, [-INFINITY, 0.]);
        rows_of(along + normal * terrain.friction, [0., INFINITY]);
    }
}

/// Pushes one row: height of a point above the terrain, m.
pub fn height(terrain: &Terrain, at: &Point, limits: [f64; 2], rows: &mut Rows) {
    let ground = terrain.ground(at.value.x, at.value.y);
    rows.row(at.value.z - ground.height, limits);
    at.push(Vector3::new(-ground.slope[0], -ground.slope[1], 1.), rows);
}

/// Pushes three rows: continuous acceleration at an inner node.
pub fn continuous_acceleration(before: &Point, after: &Point, rows: &mut Rows) {
    for axis in 0..3 {
        rows.row(before.value[axis] - after.value[axis], ZERO);
        before.push_axis(axis, 1., rows);
        after.push_axis(axis, -1., rows);
    }
}
