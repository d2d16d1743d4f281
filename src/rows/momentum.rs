//! Momentum rows of the single rigid body over the intervals between base knots.
//!
//! With `J`, `P`, `W` the first to third integral of the forces from the start of an interval (`_k`), `J_i` that of the foot at `x_i`:
//! `m (v - v_k - h g) - J`, divided by `m g h`; `m (p - p_k - h v_k - h^2 g / 2) - P`, divided by `m g h^2 / 2`;
//! `L - L(h)` and twice the mean of `L - L(tau)`, divided by `m g l h`, where `L = R I R' omega` of the planned motion and
//! `L(tau) = L_k + sum (x_i - p_k) x J_i + (m v_k tau^2 / 2 + W) x g - m d x v`, `v = v_k + g tau + J / m`,
//! `d = v_k tau + g tau^2 / 2 + P / m`. World frame. See [`crate::nlp::transcription::momentum`].

use super::blocks::Placed;
use super::math::{Mat3, Vec3, add, along, cross, euler, mul, mul_transposed, scale, sub};
use super::table::{NONE, Place, Span};
use super::write::Rows;
use super::{Constants, RowKind, Spec, Tables};
use crate::gait::spline::{hermite, hermite_rate};
use crate::real::Real;
use crate::robot::GRAVITY;
use crate::terrain::Ground;
use multiversion::multiversion;
use std::sync::LazyLock;

/// Six equalities: change of velocity, then of position.
pub const LINEAR: Spec = Spec { rows: 6, pairs: 0, kind: RowKind::Equality, unit: "N" };

/// Six equalities: angular momentum at the end, then its mean.
pub const ANGULAR: Spec = Spec { rows: 6, pairs: 0, kind: RowKind::Equality, unit: "N m" };

/// See [`super::Family::allowed`].
pub fn linear_allowed<T: Real>(constants: &Constants<T>, _: usize, tolerance: T) -> T {
    tolerance * constants.balance_scale
}

/// See [`super::Family::allowed`].
pub fn angular_allowed<T: Real>(constants: &Constants<T>, _: usize, tolerance: T) -> T {
    tolerance * constants.moment_scale
}

/// Number of nodes of the Gauss-Legendre rule at which the motion inside an interval is evaluated. With the mean of the angular
/// momentum alone, attitudes were up to 3.6 degrees off a rollout with knots every 0.1 s; with these points they are 0.3 degrees off.
pub const INNER_POINTS: usize = 6;
/// Number of points of an interval at which its momentum is evaluated: the inner points, then the end.
pub const MOMENTUM_POINTS: usize = INNER_POINTS + 1;
/// Smallest cosine of the pitch by which the rates of the Euler angles are divided.
pub const STEEP_COSINE: f64 = 0.1;

crate::table! {
    /// One of the [`MOMENTUM_POINTS`] points of every interval.
    #[derive(Default)]
    pub struct MomentumPoint<T> {
        /// Time since the start of the interval, s.
        pub time: T,
        /// Quadrature weight in the mean over the interval; 0 at the end.
        pub mean: T,
        /// Hermite weights of the value here, for value and rate at the start, value and rate at the end.
        pub value: [T; 4],
        /// Hermite weights of the rate here, for value and rate at the start, value and rate at the end.
        pub rate: [T; 4],
        /// Weights of the inner points in the integral from the start of the interval to this point, s.
        pub integral: [T; INNER_POINTS],
    }

    /// Momentum rows of one interval.
    pub struct MomentumInterval<T> {
        /// Pose on the reference line at the start and at the end.
        pub reference: [[T; 6]; 2],
        /// Rate of the reference line, m/s and rad/s.
        pub rate: [T; 6],
        /// Positions in `x` of the blocks: pose and rates at the start, pose and rates at the end, as deviations from the reference line.
        pub variable: [u32; 4],
        /// Columns of the blocks in the linear element.
        pub linear_column: [u32; 4],
        /// Columns of the blocks in the angular element.
        pub angular_column: [u32; 4],
        /// Force nodes that act in the interval, in `impulses`; those of one foothold are adjacent.
        pub impulses: Span,
        /// Place of the linear element's rows in the buffers.
        pub linear: Place,
        /// Place of the angular element's rows in the buffers.
        pub angular: Place,
    }

    /// Impulses of one force node in one interval.
    pub struct Impulse<T> {
        /// Weights at each point `tau`, for value and slope of the node with basis function `b`: `int b`, `int (tau - s) b` and
        /// `int (tau - s)^2 / 2 b ds` from the start of the interval, times the scale of the variables.
        pub weights: [[[T; 2]; 3]; MOMENTUM_POINTS],
        /// Position of the node in `x`.
        pub node: u32,
        /// Column of the node in the linear element.
        pub linear_column: u32,
        /// Column of the node in the angular element.
        pub angular_column: u32,
        /// Index of the foothold.
        pub foothold: u32,
        /// Column of the foothold in the angular element.
        pub foothold_column: u32,
    }
}

/// Deviation of the motion inside an interval from the cubic between its knots, under the forces of the last evaluation.
///
/// The rows treat it as constant: their derivatives do not include it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Deviation<T> {
    /// Deviation of the pose at the inner points, m and rad.
    pub pose: [[T; 6]; INNER_POINTS],
    /// Correction of the mean angular momentum over the interval for which the attitude at its end becomes exact, N m s.
    pub mean: [T; 3],
}

/// Writes positions and columns of the linear element. Roles: pose and rates at the start, pose and rates at the end, then the force nodes
/// that act in the interval.
pub(super) fn place_linear<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let interval = &mut tables.momentum_intervals[entry];
    interval.linear = at.place;
    interval.variable = at.positions(0);
    interval.linear_column = at.columns(0);
    for (impulse, seat) in tables.impulses[interval.impulses.range()].iter_mut().zip(&at.seats[4..]) {
        impulse.node = seat.position;
        impulse.linear_column = seat.column;
    }
}

/// Writes columns of the angular element. Roles: those of [`place_linear`], then the foothold of each force node.
pub(super) fn place_angular<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let interval = &mut tables.momentum_intervals[entry];
    interval.angular = at.place;
    interval.angular_column = at.columns(0);
    let impulses = &mut tables.impulses[interval.impulses.range()];
    let (nodes, footholds) = at.seats[4..].split_at(impulses.len());
    for ((impulse, node), foothold) in impulses.iter_mut().zip(nodes).zip(footholds) {
        impulse.angular_column = node.column;
        impulse.foothold_column = foothold.column;
    }
}

/// Nodes and weights of the Gauss-Legendre rule with [`INNER_POINTS`] nodes on (0, 1), by Newton's method on the Legendre polynomial.
pub static INNER_RULE: LazyLock<[[f64; 2]; INNER_POINTS]> = LazyLock::new(|| {
    let n = INNER_POINTS;
    std::array::from_fn(|i| {
        let mut x = -(std::f64::consts::PI * (i as f64 + 0.75) / (n as f64 + 0.5)).cos();
        let mut slope = 1.;
        for _ in 0..20 {
            let (mut before, mut now) = (1., x);
            for k in 2..=n {
                (before, now) = (now, ((2 * k - 1) as f64 * x * now - (k - 1) as f64 * before) / k as f64);
            }
            slope = n as f64 * (x * now - before) / (x * x - 1.);
            x -= now / slope;
        }
        [(1. + x) / 2., 1. / ((1. - x * x) * slope * slope)]
    })
});

/// Value at `u` of the Lagrange polynomial that is 1 at node `i` and 0 at the other nodes.
pub fn lagrange(nodes: &[f64], i: usize, u: f64) -> f64 {
    (0..nodes.len()).filter(|&j| j != i).map(|j| (u - nodes[j]) / (nodes[i] - nodes[j])).product()
}

/// Points of an interval of length `h`, s.
pub fn points<T: Real>(h: f64) -> [MomentumPoint<T>; MOMENTUM_POINTS] {
    let rule = *INNER_RULE;
    let nodes = rule.map(|[u, _]| u);
    std::array::from_fn(|q| {
        let [part, mean] = rule.get(q).copied().unwrap_or([1., 0.]);
        let t = part * h;
        // The rule, scaled to the time from the start to this point, integrates polynomials through its nodes exactly.
        let integral = |i: usize| rule.iter().map(|[u, weight]| weight * t * lagrange(&nodes, i, u * part)).sum::<f64>();
        MomentumPoint {
            time: T::of(t),
            mean: T::of(mean),
            value: hermite(t, h).map(T::of),
            rate: hermite_rate(t, h).map(T::of),
            integral: std::array::from_fn(|i| T::of(integral(i))),
        }
    })
}

/// Angular momentum `R I R' omega` and its derivatives.
pub struct AngularMomentum<T> {
    /// Rotation from base to world.
    pub rot_wb: Mat3<T>,
    /// Angular momentum in the world frame, N m s.
    pub value: Vec3<T>,
    /// Derivative with respect to each Euler angle, `[angle]`.
    pub by_angle: [Vec3<T>; 3],
    /// Derivative with respect to each Euler angle rate, `[angle]`.
    pub by_rate: [Vec3<T>; 3],
}

/// Angular momentum of a body from its Euler angles and their rates.
#[inline(always)]
pub fn angular_momentum<T: Real>(inertia: &Mat3<T>, angles: Vec3<T>, rates: Vec3<T>) -> AngularMomentum<T> {
    let (rot_wb, axes) = euler(angles);
    // Rows of R I R', which is symmetric.
    let row = |r: usize| mul(&rot_wb, mul(inertia, rot_wb[r]));
    let inertia_w = [row(0), row(1), row(2)];
    let inertia_times = |v: Vec3<T>| mul(&inertia_w, v);
    let omega = along(&axes, rates);
    let value = inertia_times(omega);
    // Rotation of the body about an axis at constant omega: axis x L - I_w (axis x omega).
    let by_turn = |axis: Vec3<T>| sub(cross(axis, value), inertia_times(cross(axis, omega)));
    // A change of pitch rotates the roll axis; a change of yaw rotates everything.
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
/// * `frozen` - true to keep the deviations unchanged
/// * `residual` - out, at the places of each interval
/// * `jacobian` - out, at the places of each interval
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn momentum<T: Real>(
    tables: &Tables<T>,
    x: &[T],
    ground: &[Ground<T>],
    deviations: &mut [Deviation<T>],
    frozen: bool,
    residual: &mut [T],
    mut jacobian: Option<&mut [T]>,
) {
    for (interval, deviation) in tables.momentum_intervals.iter().zip(deviations) {
        momentum_interval(tables, interval, x, ground, deviation, frozen, residual, jacobian.as_deref_mut());
    }
}

/// One vector per momentum point.
type Points<T> = [Vec3<T>; MOMENTUM_POINTS];

/// Momentum rows of one interval.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "separate slices: the compiler knows that they do not overlap")]
fn momentum_interval<T: Real>(
    tables: &Tables<T>,
    interval: &MomentumInterval<T>,
    x: &[T],
    ground: &[Ground<T>],
    deviation: &mut Deviation<T>,
    frozen: bool,
    residual: &mut [T],
    mut jacobian: Option<&mut [T]>,
) {
    const END: usize = INNER_POINTS;
    let constants = &tables.constants;
    let (zero, half, two) = (T::zero(), T::of(0.5), T::of(2.));
    let (mass, h, gravity) = (constants.mass, constants.interval, T::of(-GRAVITY));
    let points = &tables.momentum_points;
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

    // Impulses of all feet, and their moments about the base position at the start of the interval.
    let (mut first, mut second, mut third, mut moment): (Points<T>, Points<T>, Points<T>, Points<T>) = Default::default();
    let impulses = &tables.impulses[interval.impulses.range()];
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
        let at = tables.footholds[foothold] as usize;
        let under = &ground[foothold];
        let arm = sub([x[at], x[at + 1], under.height], base_w);
        let mut mean = [zero; 3];
        for q in 0..MOMENTUM_POINTS {
            first[q] = add(first[q], foot_first[q]);
            moment[q] = add(moment[q], cross(arm, foot_first[q]));
            mean = add(mean, scale(points[q].mean, foot_first[q]));
        }
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        // -d(arm x J)/d arm = [J]x; the height of the foothold changes with the slope.
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

    // Linear motion under these impulses, and the change of angular momentum.
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
    // Mean of the planned angular momentum, and its derivatives with respect to angles and rates at the start and at the end.
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
        *deviation = deviate(tables, interval, &state, &start.value, &gained, &inside, gained_end, gained_mean, &moved, &velocity);
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
    // Derivatives of the velocity and position rows with respect to pose and rates at the start, pose and rates at the end.
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
    angular_by_forces(tables, impulses, x, ground, base_w, &moved, &velocity, [end_scale, mean_scale], &mut rows);
    // Derivatives with respect to position and velocity at the start: -[J]x and -[tau J - P]x.
    let mut by_start = [[first[END], [zero; 3]], [sub(scale(h, first[END]), second[END]), [zero; 3]]];
    for q in 0..END {
        let (t, mean) = (points[q].time, points[q].mean);
        by_start[0][1] = add(by_start[0][1], scale(mean, first[q]));
        by_start[1][1] = add(by_start[1][1], scale(mean, sub(scale(t, first[q]), second[q])));
    }
    for i in 0..2 {
        if interval.angular_column[i] != NONE {
            let column = interval.angular_column[i] as usize;
            rows.put_cross(0, column, scale(-end_scale, by_start[i][0]));
            rows.put_cross(3, column, scale(-mean_scale, by_start[i][1]));
        }
    }
    let ends = [&start.by_angle, &start.by_rate, &end.by_angle, &end.by_rate];
    for i in 0..4 {
        if interval.angular_column[i] == NONE {
            continue;
        }
        let column = interval.angular_column[i] as usize + 3;
        for r in 0..3 {
            let sign = if i < 2 { -end_scale } else { end_scale };
            rows.put_three(r, column, std::array::from_fn(|d| sign * ends[i][d][r]));
            let start = |d: usize| if i < 2 { ends[i][d][r] } else { zero };
            rows.put_three(3 + r, column, std::array::from_fn(|d| (planned_by[i][d][r] - start(d)) * mean_scale));
        }
    }
}

/// Deviation of the motion inside an interval from the cubic through its knots.
///
/// The position deviates by its difference to the cubic that ends where the forces lead. The attitude deviates by the rotation vector
/// `eps' = I_w^-1 (e - eps x L)`, where `e` is the difference between the angular momentum under the forces and the planned one, minus a
/// quadratic that absorbs the residuals of the rows. Unsatisfied rows therefore cause no deviation.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "intermediate results of its only caller")]
fn deviate<T: Real>(
    tables: &Tables<T>,
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
    let (constants, points) = (&tables.constants, &tables.momentum_points);
    let mut deviation = Deviation::default();
    let velocity_w: Vec3<T> = std::array::from_fn(|d| interval.rate[d] + state[1][d]);
    for q in 0..END {
        let w = &points[q].value;
        for d in 0..3 {
            deviation.pose[q][d] = moved[q][d] - (w[1] * velocity_w[d] + w[2] * moved[END][d] + w[3] * velocity[END][d]);
        }
    }
    // Two fixed-point iterations: the second includes the rotation found by the first.
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
        // Conversion of a rotation vector to Euler angles with the inverse of the axes, bounded where the pitch is steep.
        let angles = inside[q].0;
        let (sz, cz) = angles[2].sin_cos();
        let (sy, cy) = angles[1].sin_cos();
        let cy = if cy.abs() < T::of(STEEP_COSINE) { T::of(STEEP_COSINE) } else { cy };
        let forward = cz * turned[q][0] + sz * turned[q][1];
        deviation.pose[q][3] = forward / cy;
        deviation.pose[q][4] = cz * turned[q][1] - sz * turned[q][0];
        deviation.pose[q][5] = turned[q][2] + forward * sy / cy;
    }
    let rot_wb = &inside[END / 2].1;
    deviation.mean = scale(-T::one(), mul(rot_wb, mul(&constants.inertia, mul_transposed(rot_wb, mean_rate))));
    deviation
}

/// Derivatives of the angular rows with respect to the forces: `-[a]x` with `a = w_1 (x_i - p_k - d) + w_2 v - w_3 g`, where `w` are the
/// integrals of the node's basis function.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "separate slices: the compiler knows that they do not overlap")]
fn angular_by_forces<T: Real>(
    tables: &Tables<T>,
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
        let at = tables.footholds[foothold] as usize;
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
                for (q, point) in tables.momentum_points[..END].iter().enumerate() {
                    mean = add(mean, scale(point.mean, lever(q)));
                }
                let column = impulse.angular_column as usize + 3 * part;
                rows.put_cross(0, column, scale(-end_scale, lever(END)));
                rows.put_cross(3, column, scale(-mean_scale, mean));
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
