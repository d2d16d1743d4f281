//! Momentum rows of the single rigid body over the intervals between base knots.
//!
//! With `J`, `P`, `W` the first to third integral of the forces from the start of an interval (`_k`), `J_i` that of the foot at `x_i`:
//! `m (v - v_k - h g) - J`, divided by `m g h`; `m (p - p_k - h v_k - h^2 g / 2) - P`, divided by `m g h^2 / 2`;
//! `L - L(h)` and twice the mean of `L - L(tau)`, divided by `m g l h`, where `L = R I R' omega` of the planned motion and
//! `L(tau) = L_k + sum (x_i - p_k) x J_i + (m v_k tau^2 / 2 + W) x g - m d x v`, `v = v_k + g tau + J / m`,
//! `d = v_k tau + g tau^2 / 2 + P / m`. World frame. See [`crate::nlp::momentum`].

use super::Rows;
use super::dynamics::{along, put_cross};
use super::math::{Mat3, Vec3, add, cross, euler, mul, mul_transposed, scale, sub};
use crate::nlp::layout::{Deviation, INNER_POINTS, Impulse, MOMENTUM_POINTS, MomentumInterval, NONE};
use crate::nlp::{Layout, Real};
use crate::robot::GRAVITY;
use crate::terrain::Ground;
use multiversion::multiversion;

/// Angular momentum `R I R' omega` and its derivatives.
pub struct AngularMomentum<T> {
    /// Rotation from base to world.
    pub rot_wb: Mat3<T>,
    /// Its value, N m s.
    pub value: Vec3<T>,
    /// With respect to each Euler angle, `[angle]`.
    pub by_angle: [Vec3<T>; 3],
    /// With respect to each rate.
    pub by_rate: [Vec3<T>; 3],
}

/// Angular momentum of a body from its Euler angles and their rates.
#[inline(always)]
pub fn angular_momentum<T: Real>(inertia: &Mat3<T>, angles: Vec3<T>, rates: Vec3<T>) -> AngularMomentum<T> {
    let (rot_wb, axes) = euler(angles);
    let inertia_times = |v: Vec3<T>| mul(&rot_wb, mul(inertia, mul_transposed(&rot_wb, v)));
    let omega = along(&axes, rates);
    let value = inertia_times(omega);
    // Turning the body about an axis while omega stays: axis x L - I_w (axis x omega).
    let by_turn = |axis: Vec3<T>| sub(cross(axis, value), inertia_times(cross(axis, omega)));
    // The pitch carries the roll axis along, the yaw everything.
    let carried = inertia_times(scale(rates[0], cross(axes[1], axes[0])));
    AngularMomentum {
        rot_wb,
        value,
        by_angle: [by_turn(axes[0]), add(by_turn(axes[1]), carried), cross(axes[2], value)],
        by_rate: [inertia_times(axes[0]), inertia_times(axes[1]), inertia_times(axes[2])],
    }
}

/// Momentum rows of all intervals.
///
/// * `deviations` - in and out, `[intervals]`
/// * `frozen` - whether the deviations are taken as they are
/// * `residual` - out, at each interval's places
/// * `jacobian` - out, likewise
#[multiversion(targets("x86_64+avx2"))]
pub fn momentum<T: Real>(
    layout: &Layout<T>,
    x: &[T],
    ground: &[Ground<T>],
    deviations: &mut [Deviation<T>],
    frozen: bool,
    residual: &mut [T],
    mut jacobian: Option<&mut [T]>,
) {
    for (interval, deviation) in layout.momentum.iter().zip(deviations) {
        momentum_interval(layout, interval, x, ground, deviation, frozen, residual, jacobian.as_deref_mut());
    }
}

/// `[points]` of vectors.
type Points<T> = [Vec3<T>; MOMENTUM_POINTS];

/// Momentum rows of one interval.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "separate slices: the compiler knows that they do not overlap")]
fn momentum_interval<T: Real>(
    layout: &Layout<T>,
    interval: &MomentumInterval<T>,
    x: &[T],
    ground: &[Ground<T>],
    deviation: &mut Deviation<T>,
    frozen: bool,
    residual: &mut [T],
    mut jacobian: Option<&mut [T]>,
) {
    const END: usize = INNER_POINTS;
    let constants = &layout.constants;
    let (zero, half, two) = (T::zero(), T::of(0.5), T::of(2.));
    let (mass, h, gravity) = (constants.mass, constants.interval, T::of(-GRAVITY));
    let points = &layout.momentum_points;
    // Deviations from the reference line: pose and rates at the start, pose and rates at the end.
    let state: [[T; 6]; 4] = interval.variable.map(|at| std::array::from_fn(|d| x[at as usize + d]));
    let angular = |v: &[T; 6]| [v[3], v[4], v[5]];
    let pose: [[T; 6]; 2] = std::array::from_fn(|i| std::array::from_fn(|d| interval.reference[i][d] + state[2 * i][d]));
    let rate: [[T; 6]; 2] = std::array::from_fn(|i| std::array::from_fn(|d| interval.rate[d] + state[2 * i + 1][d]));
    let base_w = [pose[0][0], pose[0][1], pose[0][2]];
    let velocity_w = [rate[0][0], rate[0][1], rate[0][2]];

    let linear_scale = constants.balance_scale / h;
    let position_scale = two * linear_scale / h;
    let end_scale = constants.moment_scale / h;
    let mean_scale = two * end_scale;

    // Impulses of all feet, and their moments about the base at the start.
    let (mut first, mut second, mut third, mut moment): (Points<T>, Points<T>, Points<T>, Points<T>) = Default::default();
    let impulses = &layout.impulses[interval.impulses.range()];
    for of_foothold in impulses.chunk_by(|a, b| a.foothold == b.foothold) {
        let mut foot_first: Points<T> = Default::default();
        for impulse in of_foothold {
            let node: [T; 6] = std::array::from_fn(|d| x[impulse.node as usize + d]);
            for (q, w) in impulse.weights.iter().enumerate() {
                for d in 0..3 {
                    foot_first[q][d] += w[0][0] * node[d] + w[0][1] * node[3 + d];
                    second[q][d] += w[1][0] * node[d] + w[1][1] * node[3 + d];
                    third[q][d] += w[2][0] * node[d] + w[2][1] * node[3 + d];
                }
            }
        }
        let foothold = of_foothold[0].foothold as usize;
        let at = layout.footholds[foothold] as usize;
        let under = &ground[foothold];
        let arm = sub([x[at], x[at + 1], under.height], base_w);
        let mut mean = [zero; 3];
        for q in 0..MOMENTUM_POINTS {
            first[q] = add(first[q], foot_first[q]);
            moment[q] = add(moment[q], cross(arm, foot_first[q]));
            mean = add(mean, scale(points[q].mean, foot_first[q]));
        }
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        // -d(arm x J)/d arm = [J]x; the height follows the slope.
        let column = of_foothold[0].foothold_column;
        if column != NONE {
            let mut rows = Rows::new(jacobian, &interval.angular);
            for (row, j) in [(0, scale(end_scale, foot_first[END])), (3, scale(mean_scale, mean))] {
                let along_z = [j[1], -j[0], zero];
                let along_x = add([zero, j[2], -j[1]], scale(under.slope[0], along_z));
                let along_y = add([-j[2], zero, j[0]], scale(under.slope[1], along_z));
                for r in 0..3 {
                    rows.put(row + r, column as usize, along_x[r]);
                    rows.put(row + r, column as usize + 1, along_y[r]);
                }
            }
        }
    }

    // The linear motion that follows, and the angular momentum gained.
    let gravity_w = [zero, zero, gravity];
    let (mut moved, mut velocity, mut gained): (Points<T>, Points<T>, Points<T>) = Default::default();
    let mut gained_mean = [zero; 3];
    for q in 0..MOMENTUM_POINTS {
        let t = points[q].time;
        let fallen = half * gravity * t * t;
        for d in 0..3 {
            velocity[q][d] = velocity_w[d] + first[q][d] / mass;
            moved[q][d] = t * velocity_w[d] + second[q][d] / mass;
        }
        velocity[q][2] += gravity * t;
        moved[q][2] += fallen;
        let lever = add(scale(half * mass * t * t, velocity_w), third[q]);
        let carried = sub(cross(lever, gravity_w), scale(mass, cross(moved[q], velocity[q])));
        gained[q] = add(moment[q], carried);
        gained_mean = add(gained_mean, scale(points[q].mean, gained[q]));
    }

    let start = angular_momentum(&constants.inertia, angular(&pose[0]), angular(&rate[0]));
    let end = angular_momentum(&constants.inertia, angular(&pose[1]), angular(&rate[1]));
    // Mean of the planned angular momentum, and its derivatives by angles and rates at the start and at the end.
    let mut planned = [zero; 3];
    let mut planned_by = [[[zero; 3]; 3]; 4];
    let line: Vec3<T> = std::array::from_fn(|d| interval.rate[3 + d]);
    let mut inside: [(Vec3<T>, Mat3<T>, Vec3<T>); END] = [([zero; 3], [[zero; 3]; 3], [zero; 3]); END];
    for (q, point) in points[..END].iter().enumerate() {
        let (mut angles, mut rates) = (add(angular(&interval.reference[0]), scale(point.time, line)), line);
        for i in 0..4 {
            angles = add(angles, scale(point.value[i], angular(&state[i])));
            rates = add(rates, scale(point.rate[i], angular(&state[i])));
        }
        let here = angular_momentum(&constants.inertia, angles, rates);
        planned = add(planned, scale(point.mean, here.value));
        inside[q] = (angles, here.rot_wb, here.value);
        if jacobian.is_some() {
            for i in 0..4 {
                let (value, slope) = (point.mean * point.value[i], point.mean * point.rate[i]);
                for d in 0..3 {
                    planned_by[i][d] = add(planned_by[i][d], add(scale(value, here.by_angle[d]), scale(slope, here.by_rate[d])));
                }
            }
        }
    }

    if !frozen {
        let gained_end = sub(add(start.value, gained[END]), end.value);
        let gained_mean = sub(add(start.value, gained_mean), planned);
        *deviation = deviate(layout, interval, &state, &start.value, &gained, &inside, gained_end, gained_mean, &moved, &velocity);
    }
    let at = interval.linear.row as usize;
    for d in 0..3 {
        let weight = if d == 2 { gravity } else { zero };
        let sped_up = mass * (state[3][d] - state[1][d] - h * weight) - first[END][d];
        let moved_on = mass * (state[2][d] - state[0][d] - h * state[1][d] - half * h * h * weight) - second[END][d];
        residual[at + d] = sped_up * linear_scale;
        residual[at + 3 + d] = moved_on * position_scale;
    }
    let at = interval.angular.row as usize;
    for d in 0..3 {
        residual[at + d] = (end.value[d] - start.value[d] - gained[END][d]) * end_scale;
        residual[at + 3 + d] = (planned[d] - start.value[d] - gained_mean[d] + deviation.mean[d]) * mean_scale;
    }

    let Some(jacobian) = jacobian else { return };
    let mut rows = Rows::new(jacobian, &interval.linear);
    for impulse in impulses {
        let w = &impulse.weights[END];
        for part in 0..2 {
            for d in 0..3 {
                let column = impulse.linear_column as usize + 3 * part + d;
                rows.put(d, column, -w[0][part] * linear_scale);
                rows.put(3 + d, column, -w[1][part] * position_scale);
            }
        }
    }
    // Velocity and position rows by pose and rates at the start, pose and rates at the end.
    for (i, by) in [[zero, -mass], [-mass, -mass * h], [zero, mass], [mass, zero]].into_iter().enumerate() {
        if interval.linear_column[i] != NONE {
            for d in 0..3 {
                let column = interval.linear_column[i] as usize + d;
                rows.put(d, column, by[0] * linear_scale);
                rows.put(3 + d, column, by[1] * position_scale);
            }
        }
    }

    let mut rows = Rows::new(jacobian, &interval.angular);
    angular_by_forces(layout, impulses, x, ground, base_w, &moved, &velocity, [end_scale, mean_scale], &mut rows);
    // By position and velocity at the start: -[J]x and -[tau J - P]x.
    let mut by_start = [[first[END], [zero; 3]], [sub(scale(h, first[END]), second[END]), [zero; 3]]];
    for q in 0..END {
        let (t, mean) = (points[q].time, points[q].mean);
        by_start[0][1] = add(by_start[0][1], scale(mean, first[q]));
        by_start[1][1] = add(by_start[1][1], scale(mean, sub(scale(t, first[q]), second[q])));
    }
    for i in 0..2 {
        if interval.angular_column[i] != NONE {
            let column = interval.angular_column[i] as usize;
            put_cross(&mut rows, 0, column, scale(-end_scale, by_start[i][0]));
            put_cross(&mut rows, 3, column, scale(-mean_scale, by_start[i][1]));
        }
    }
    let ends = [&start.by_angle, &start.by_rate, &end.by_angle, &end.by_rate];
    for i in 0..4 {
        if interval.angular_column[i] == NONE {
            continue;
        }
        let column = interval.angular_column[i] as usize + 3;
        for d in 0..3 {
            for r in 0..3 {
                let (by_end, by_mean) =
                    if i < 2 { (-ends[i][d][r], planned_by[i][d][r] - ends[i][d][r]) } else { (ends[i][d][r], planned_by[i][d][r]) };
                rows.put(r, column + d, by_end * end_scale);
                rows.put(3 + r, column + d, by_mean * mean_scale);
            }
        }
    }
}

/// How the motion inside an interval deviates from the cubic through its knots.
///
/// In position by the difference to the cubic through the end that the forces lead to. In attitude by the rotation vector
/// `eps' = I_w^-1 (e - eps x L)`, where `e` is the angular momentum that the forces give beyond the planned one, less a quadratic
/// that takes what is missing in the rows, so that rows that do not hold yet bend nothing.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "what its caller has at hand")]
fn deviate<T: Real>(
    layout: &Layout<T>,
    interval: &MomentumInterval<T>,
    state: &[[T; 6]; 4],
    momentum_start: &Vec3<T>,
    gained: &Points<T>,
    inside: &[(Vec3<T>, Mat3<T>, Vec3<T>); INNER_POINTS],
    beyond_end: Vec3<T>,
    beyond_mean: Vec3<T>,
    moved: &Points<T>,
    velocity: &Points<T>,
) -> Deviation<T> {
    const END: usize = INNER_POINTS;
    let zero = T::zero();
    let (constants, points) = (&layout.constants, &layout.momentum_points);
    let mut deviation = Deviation::default();
    let velocity_w: Vec3<T> = std::array::from_fn(|d| interval.rate[d] + state[1][d]);
    for q in 0..END {
        let w = &points[q].value;
        for d in 0..3 {
            deviation.pose[q][d] = moved[q][d] - (w[1] * velocity_w[d] + w[2] * moved[END][d] + w[3] * velocity[END][d]);
        }
    }
    // Twice: the second time with the turning of what has been gained.
    let (two, three, six) = (T::of(2.), T::of(3.), T::of(6.));
    let mut beyond = [[zero; 3]; END];
    for q in 0..END {
        let u = points[q].time / constants.interval;
        for d in 0..3 {
            let quadratic = u * (six * beyond_mean[d] - two * beyond_end[d]) + u * u * (three * beyond_end[d] - six * beyond_mean[d]);
            beyond[q][d] = momentum_start[d] + gained[q][d] - inside[q].2[d] - quadratic;
        }
    }
    let mut turned = [[zero; 3]; END];
    let mut rate = [[zero; 3]; END];
    for _ in 0..2 {
        for q in 0..END {
            let (_, rot_wb, momentum) = &inside[q];
            let change = sub(beyond[q], cross(turned[q], *momentum));
            rate[q] = mul(rot_wb, mul(&constants.inverse_inertia, mul_transposed(rot_wb, change)));
        }
        for q in 0..END {
            turned[q] = [zero; 3];
            for r in 0..END {
                turned[q] = add(turned[q], scale(points[q].integral[r], rate[r]));
            }
        }
    }
    let mut mean_rate = [zero; 3];
    for q in 0..END {
        mean_rate = add(mean_rate, scale(points[q].mean, rate[q]));
        // From a rotation vector to Euler angles: the inverse of the axes, kept finite where the pitch is steep.
        let angles = inside[q].0;
        let (sz, cz) = angles[2].sin_cos();
        let (sy, cy) = angles[1].sin_cos();
        let cy = if cy.abs() < T::of(0.1) { T::of(0.1) } else { cy };
        let forward = cz * turned[q][0] + sz * turned[q][1];
        deviation.pose[q][3] = forward / cy;
        deviation.pose[q][4] = cz * turned[q][1] - sz * turned[q][0];
        deviation.pose[q][5] = turned[q][2] + forward * sy / cy;
    }
    let rot_wb = &inside[END / 2].1;
    deviation.mean = scale(-T::one(), mul(rot_wb, mul(&constants.inertia, mul_transposed(rot_wb, mean_rate))));
    deviation
}

/// Angular rows by the forces: `-[a]x` with `a = w_1 (x_i - p_k - d) + w_2 v - w_3 g`, `w` the integrals of the node's basis function.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "separate slices: the compiler knows that they do not overlap")]
fn angular_by_forces<T: Real>(
    layout: &Layout<T>,
    impulses: &[Impulse<T>],
    x: &[T],
    ground: &[Ground<T>],
    base_w: Vec3<T>,
    moved: &Points<T>,
    velocity: &Points<T>,
    [end_scale, mean_scale]: [T; 2],
    rows: &mut Rows<T>,
) {
    const END: usize = INNER_POINTS;
    let zero = T::zero();
    for of_foothold in impulses.chunk_by(|a, b| a.foothold == b.foothold) {
        let foothold = of_foothold[0].foothold as usize;
        let at = layout.footholds[foothold] as usize;
        let arm = sub([x[at], x[at + 1], ground[foothold].height], base_w);
        let arms: Points<T> = std::array::from_fn(|q| sub(arm, moved[q]));
        for impulse in of_foothold {
            for part in 0..2 {
                let lever = |q: usize| {
                    let w = &impulse.weights[q];
                    let mut a = add(scale(w[0][part], arms[q]), scale(w[1][part], velocity[q]));
                    a[2] += w[2][part] * T::of(GRAVITY);
                    a
                };
                let mut mean = [zero; 3];
                for (q, point) in layout.momentum_points[..END].iter().enumerate() {
                    mean = add(mean, scale(point.mean, lever(q)));
                }
                let column = impulse.angular_column as usize + 3 * part;
                put_cross(rows, 0, column, scale(-end_scale, lever(END)));
                put_cross(rows, 3, column, scale(-mean_scale, mean));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::math::dot;
    use super::*;

    #[test]
    fn angular_momentum_derivatives_match_central_differences() {
        let inertia = [[0.9, -0.01, 0.05], [-0.01, 1.9, 0.02], [0.05, 0.02, 2.1]];
        let at = [0.3, -0.4, 2.0, 0.7, -1.1, 0.9];
        let value = |v: [f64; 6]| angular_momentum(&inertia, [v[0], v[1], v[2]], [v[3], v[4], v[5]]);
        let exact = value(at);
        let d = 1e-6;
        for i in 0..6 {
            let (mut up, mut down) = (at, at);
            up[i] += d;
            down[i] -= d;
            let difference = scale(1. / (2. * d), sub(value(up).value, value(down).value));
            let analytic = [exact.by_angle, exact.by_rate][i / 3][i % 3];
            let gap = sub(difference, analytic);
            assert!(dot(gap, gap).sqrt() < 1e-8, "derivative {i}: {difference:?} against {analytic:?}");
        }
    }
}
