//! Momentum rows of the single rigid body over the intervals between base knots.
//!
//! With `J`, `P`, `W` the first to third integral of the forces from the start of an interval (`_k`), `J_i` that of the foot at `x_i`,
//! `M` that of the moments of soles:
//! `m (v - v_k - h g) - J`, divided by `m g h`; `m (p - p_k - h v_k - h^2 g / 2) - P`, divided by `m g h^2 / 2`;
//! `L - L(h)` and twice the mean of `L - L(tau)`, divided by `m g l h`, where `L = R I R' omega` of the planned motion and
//! `L(tau) = L_k + sum (x_i - p_k) x J_i + M + (m v_k tau^2 / 2 + W) x g - m d x v`, `v = v_k + g tau + J / m`,
//! `d = v_k tau + g tau^2 / 2 + P / m`. World frame. See [`crate::nlp::transcription::momentum`].

use super::blocks::Placed;
use super::math::{Mat3, Vec3, add, along, cross, euler, mul, mul_transposed, scale, sub};
use super::table::{NONE, Place, Span};
use super::write::Rows;
use super::{Constants, RowKind, Spec, Tables};
use crate::gait::spline::{hermite, hermite_rate};
use crate::quadrature::{GAUSS_6, lagrange};
use crate::real::Real;
use crate::robot::GRAVITY;
use crate::terrain::Ground;
use multiversion::multiversion;

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
        /// Moment nodes that act in the interval, in `impulses`.
        pub moments: Span,
        /// Place of the linear element's rows in the buffers.
        pub linear: Place,
        /// Place of the angular element's rows in the buffers.
        pub angular: Place,
    }

    /// Impulses of one force or moment node in one interval. Of a moment only the first integral counts, and it has no foothold.
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

/// Writes columns of the angular element. Roles: those of [`place_linear`], then the foothold of each force node, then the moment
/// nodes that act in the interval.
pub(super) fn place_angular<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let interval = &mut tables.momentum_intervals[entry];
    interval.angular = at.place;
    interval.angular_column = at.columns(0);
    let impulses = &mut tables.impulses[interval.impulses.range()];
    let (nodes, others) = at.seats[4..].split_at(impulses.len());
    let (footholds, moments) = others.split_at(impulses.len());
    for ((impulse, node), foothold) in impulses.iter_mut().zip(nodes).zip(footholds) {
        impulse.angular_column = node.column;
        impulse.foothold_column = foothold.column;
    }
    for (impulse, node) in tables.impulses[interval.moments.range()].iter_mut().zip(moments) {
        impulse.node = node.position;
        impulse.angular_column = node.column;
    }
}

/// Points of an interval of length `h`, s.
pub fn points<T: Real>(h: f64) -> [MomentumPoint<T>; MOMENTUM_POINTS] {
    let rule = *GAUSS_6;
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
        momentum_interval(&Inputs::new(tables, interval, x, ground), deviation, frozen, residual, jacobian.as_deref_mut());
    }
}

/// One vector per momentum point.
type Points<T> = [Vec3<T>; MOMENTUM_POINTS];

/// Index of the end of an interval among its momentum points.
const END: usize = INNER_POINTS;

/// Angular half of a pose or of its rate.
#[inline(always)]
fn angular<T: Copy>(v: &[T; 6]) -> Vec3<T> {
    [v[3], v[4], v[5]]
}

/// Momentum rows of one interval.
#[inline(always)]
fn momentum_interval<T: Real>(
    at: &Inputs<T>,
    deviation: &mut Deviation<T>,
    frozen: bool,
    residual: &mut [T],
    mut jacobian: Option<&mut [T]>,
) {
    let forces = at.impulses(jacobian.as_deref_mut());
    let motion = at.follow(&forces);
    let planned = at.plan(jacobian.is_some());
    if !frozen {
        *deviation = at.deviate(&motion, &planned);
    }
    at.put_linear(&forces, residual);
    at.put_angular(&motion, &planned, deviation, residual);
    let Some(jacobian) = jacobian else { return };
    at.put_by_start(&forces, jacobian);
    at.put_by_attitude(&planned, jacobian);
    at.put_by_forces(&motion, jacobian);
}

/// Inputs of the momentum rows of one interval.
struct Inputs<'a, T> {
    tables: &'a Tables<T>,
    interval: &'a MomentumInterval<T>,
    x: &'a [T],
    ground: &'a [Ground<T>],
    /// Deviations from the reference line: pose and rates at the start, pose and rates at the end.
    state: [[T; 6]; 4],
    /// Base position at the start.
    base_w: Vec3<T>,
    /// Base velocity at the start.
    velocity_w: Vec3<T>,
    /// Scales of the linear rows: velocity, position.
    linear_scales: [T; 2],
    /// Scales of the angular rows: at the end, mean.
    angular_scales: [T; 2],
}

/// Integrals of the forces of all feet from the start of the interval to each point.
#[derive(Default)]
struct Impulses<T> {
    first: Points<T>,
    second: Points<T>,
    third: Points<T>,
    /// Moment of the first integral about the base position at the start, and integral of the moments of soles.
    moment: Points<T>,
}

/// Linear motion of the base under the forces, at each point.
#[derive(Default)]
struct Motion<T> {
    /// Displacement since the start of the interval.
    moved: Points<T>,
    velocity: Points<T>,
    /// Change of the angular momentum since the start of the interval.
    gained: Points<T>,
    /// Mean of the change over the interval.
    gained_mean: Vec3<T>,
}

/// Planned motion of the attitude.
struct Planned<T> {
    start: AngularMomentum<T>,
    end: AngularMomentum<T>,
    inside: [Inside<T>; INNER_POINTS],
    /// Mean angular momentum over the interval.
    mean: Vec3<T>,
    /// Derivatives of the mean with respect to angles and rates at the start, angles and rates at the end, `[block][angle]`; 0 if the
    /// Jacobian is not computed.
    mean_by: [[Vec3<T>; 3]; 4],
}

/// Planned attitude at an inner point.
#[derive(Clone, Copy)]
struct Inside<T> {
    angles: Vec3<T>,
    rot_wb: Mat3<T>,
    momentum: Vec3<T>,
}

impl<'a, T: Real> Inputs<'a, T> {
    #[inline(always)]
    fn new(tables: &'a Tables<T>, interval: &'a MomentumInterval<T>, x: &'a [T], ground: &'a [Ground<T>]) -> Self {
        let (constants, two) = (&tables.constants, T::of(2.));
        let state: [[T; 6]; 4] = interval.variable.map(|at| std::array::from_fn(|d| x[at as usize + d]));
        let (linear_scale, end_scale) = (constants.balance_scale / constants.interval, constants.moment_scale / constants.interval);
        Inputs {
            tables,
            interval,
            x,
            ground,
            state,
            base_w: std::array::from_fn(|d| interval.reference[0][d] + state[0][d]),
            velocity_w: std::array::from_fn(|d| interval.rate[d] + state[1][d]),
            linear_scales: [linear_scale, two * linear_scale / constants.interval],
            angular_scales: [end_scale, two * end_scale],
        }
    }

    /// Force nodes that act in the interval.
    #[inline(always)]
    fn nodes(&self) -> &'a [Impulse<T>] {
        &self.tables.impulses[self.interval.impulses.range()]
    }

    /// Moment nodes that act in the interval.
    #[inline(always)]
    fn moments(&self) -> &'a [Impulse<T>] {
        &self.tables.impulses[self.interval.moments.range()]
    }

    /// Vector from the base at the start to a foothold.
    #[inline(always)]
    fn arm(&self, foothold: usize) -> Vec3<T> {
        let at = self.tables.footholds[foothold] as usize;
        sub([self.x[at], self.x[at + 1], self.ground[foothold].height], self.base_w)
    }

    /// Integrals of the forces. Writes the derivatives with respect to the footholds into the Jacobian.
    #[inline(always)]
    fn impulses(&self, mut jacobian: Option<&mut [T]>) -> Impulses<T> {
        let mut sum = Impulses::default();
        for of_foothold in self.nodes().chunk_by(|a, b| a.foothold == b.foothold) {
            let mut first: Points<T> = Default::default();
            for impulse in of_foothold {
                let node: [T; 6] = std::array::from_fn(|d| self.x[impulse.node as usize + d]);
                for (q, w) in impulse.weights.iter().enumerate() {
                    for d in 0..3 {
                        first[q][d] += w[0][0] * node[d] + w[0][1] * node[3 + d];
                        sum.second[q][d] += w[1][0] * node[d] + w[1][1] * node[3 + d];
                        sum.third[q][d] += w[2][0] * node[d] + w[2][1] * node[3 + d];
                    }
                }
            }
            let arm = self.arm(of_foothold[0].foothold as usize);
            let mut mean = [T::zero(); 3];
            for q in 0..MOMENTUM_POINTS {
                sum.first[q] = add(sum.first[q], first[q]);
                sum.moment[q] = add(sum.moment[q], cross(arm, first[q]));
                mean = add(mean, scale(self.tables.momentum_points[q].mean, first[q]));
            }
            if let Some(jacobian) = jacobian.as_deref_mut() {
                self.put_by_foothold(&of_foothold[0], [first[END], mean], jacobian);
            }
        }
        for impulse in self.moments() {
            let node: [T; 6] = std::array::from_fn(|d| self.x[impulse.node as usize + d]);
            for (q, w) in impulse.weights.iter().enumerate() {
                for d in 0..3 {
                    sum.moment[q][d] += w[0][0] * node[d] + w[0][1] * node[3 + d];
                }
            }
        }
        sum
    }

    /// Writes the derivatives of the angular rows with respect to a foothold: `-d(arm x J)/d arm = [J]x`.
    ///
    /// * `of` - an impulse of the foothold
    /// * `impulses` - integral of the foothold's force to the end, and the mean of the integrals to the inner points
    #[inline(always)]
    fn put_by_foothold(&self, of: &Impulse<T>, impulses: [Vec3<T>; 2], jacobian: &mut [T]) {
        if of.foothold_column == NONE {
            return;
        }
        let (column, slope) = (of.foothold_column as usize, self.ground[of.foothold as usize].slope);
        let mut rows = Rows::new(jacobian, &self.interval.angular);
        for i in 0..2 {
            rows.put_by_foothold(3 * i, column, scale(self.angular_scales[i], impulses[i]), slope);
        }
    }

    /// Linear motion under the forces, and the change of angular momentum.
    #[inline(always)]
    fn follow(&self, forces: &Impulses<T>) -> Motion<T> {
        let (zero, half, gravity, mass) = (T::zero(), T::of(0.5), T::of(-GRAVITY), self.tables.constants.mass);
        let gravity_w = [zero, zero, gravity];
        let mut motion = Motion::default();
        let Motion { moved, velocity, gained, gained_mean } = &mut motion;
        for q in 0..MOMENTUM_POINTS {
            let t = self.tables.momentum_points[q].time;
            let fallen = half * gravity * t * t;
            for d in 0..3 {
                velocity[q][d] = self.velocity_w[d] + forces.first[q][d] / mass;
                moved[q][d] = t * self.velocity_w[d] + forces.second[q][d] / mass;
            }
            velocity[q][2] += gravity * t;
            moved[q][2] += fallen;
            let lever = add(scale(half * mass * t * t, self.velocity_w), forces.third[q]);
            let carried = sub(cross(lever, gravity_w), scale(mass, cross(moved[q], velocity[q])));
            gained[q] = add(forces.moment[q], carried);
            *gained_mean = add(*gained_mean, scale(self.tables.momentum_points[q].mean, gained[q]));
        }
        motion
    }

    /// Planned motion of the attitude, and its angular momentum.
    ///
    /// * `derivatives` - true if the Jacobian is computed
    #[inline(always)]
    fn plan(&self, derivatives: bool) -> Planned<T> {
        let (zero, interval, inertia) = (T::zero(), self.interval, &self.tables.constants.inertia);
        let line = angular(&interval.rate);
        // At the start (0) or at the end (1).
        let at_knot = |i: usize| {
            let (pose, rate) = (angular(&self.state[2 * i]), angular(&self.state[2 * i + 1]));
            angular_momentum(inertia, add(angular(&interval.reference[i]), pose), add(line, rate))
        };
        let mut planned = Planned {
            start: at_knot(0),
            end: at_knot(1),
            inside: [Inside { angles: [zero; 3], rot_wb: [[zero; 3]; 3], momentum: [zero; 3] }; END],
            mean: [zero; 3],
            mean_by: [[[zero; 3]; 3]; 4],
        };
        for (q, point) in self.tables.momentum_points[..END].iter().enumerate() {
            let (mut angles, mut rates) = (add(angular(&interval.reference[0]), scale(point.time, line)), line);
            for i in 0..4 {
                angles = add(angles, scale(point.value[i], angular(&self.state[i])));
                rates = add(rates, scale(point.rate[i], angular(&self.state[i])));
            }
            let here = angular_momentum(inertia, angles, rates);
            planned.mean = add(planned.mean, scale(point.mean, here.value));
            planned.inside[q] = Inside { angles, rot_wb: here.rot_wb, momentum: here.value };
            if derivatives {
                for i in 0..4 {
                    let (value, slope) = (point.mean * point.value[i], point.mean * point.rate[i]);
                    for d in 0..3 {
                        let by = add(scale(value, here.by_angle[d]), scale(slope, here.by_rate[d]));
                        planned.mean_by[i][d] = add(planned.mean_by[i][d], by);
                    }
                }
            }
        }
        planned
    }

    /// Deviation of the motion inside the interval from the cubic through its knots.
    ///
    /// The position deviates by its difference to the cubic that ends where the forces lead. The attitude deviates by the rotation vector
    /// `eps' = I_w^-1 (e - eps x L)`, where `e` is the difference between the angular momentum under the forces and the planned one,
    /// minus a quadratic that absorbs the residuals of the rows. Unsatisfied rows therefore cause no deviation.
    #[inline(always)]
    fn deviate(&self, motion: &Motion<T>, planned: &Planned<T>) -> Deviation<T> {
        let points = &self.tables.momentum_points;
        let Motion { moved, velocity, .. } = motion;
        let mut deviation = Deviation::default();
        for q in 0..END {
            let w = &points[q].value;
            for d in 0..3 {
                deviation.pose[q][d] = moved[q][d] - (w[1] * self.velocity_w[d] + w[2] * moved[END][d] + w[3] * velocity[END][d]);
            }
        }
        let [turned, rate] = self.turn(&self.beyond(motion, planned), planned);
        let mut mean_rate = [T::zero(); 3];
        for q in 0..END {
            mean_rate = add(mean_rate, scale(points[q].mean, rate[q]));
            // Conversion of a rotation vector to Euler angles with the inverse of the axes, bounded where the pitch is steep.
            let angles = planned.inside[q].angles;
            let (sz, cz) = angles[2].sin_cos();
            let (sy, cy) = angles[1].sin_cos();
            let cy = if cy.abs() < T::of(STEEP_COSINE) { T::of(STEEP_COSINE) } else { cy };
            let forward = cz * turned[q][0] + sz * turned[q][1];
            deviation.pose[q][3] = forward / cy;
            deviation.pose[q][4] = cz * turned[q][1] - sz * turned[q][0];
            deviation.pose[q][5] = turned[q][2] + forward * sy / cy;
        }
        let rot_wb = &planned.inside[END / 2].rot_wb;
        deviation.mean = scale(-T::one(), mul(rot_wb, mul(&self.tables.constants.inertia, mul_transposed(rot_wb, mean_rate))));
        deviation
    }

    /// Difference `e` at the inner points between the angular momentum under the forces and the planned one, without the residuals of the
    /// rows: see [`Inputs::deviate`].
    #[inline(always)]
    fn beyond(&self, motion: &Motion<T>, planned: &Planned<T>) -> [Vec3<T>; INNER_POINTS] {
        let (two, three, six) = (T::of(2.), T::of(3.), T::of(6.));
        let start = planned.start.value;
        let end = sub(add(start, motion.gained[END]), planned.end.value);
        let mean = sub(add(start, motion.gained_mean), planned.mean);
        let mut beyond = [[T::zero(); 3]; END];
        for q in 0..END {
            let u = self.tables.momentum_points[q].time / self.tables.constants.interval;
            for d in 0..3 {
                let quadratic = u * (six * mean[d] - two * end[d]) + u * u * (three * end[d] - six * mean[d]);
                beyond[q][d] = start[d] + motion.gained[q][d] - planned.inside[q].momentum[d] - quadratic;
            }
        }
        beyond
    }

    /// Rotation vectors `eps` at the inner points for the differences [`Inputs::beyond`], and their rates.
    #[inline(always)]
    fn turn(&self, beyond: &[Vec3<T>; INNER_POINTS], planned: &Planned<T>) -> [[Vec3<T>; INNER_POINTS]; 2] {
        let zero = T::zero();
        let mut turned = [[zero; 3]; END];
        let mut rate = [[zero; 3]; END];
        // Two fixed-point iterations: the second includes the rotation found by the first.
        for _ in 0..2 {
            for q in 0..END {
                let Inside { rot_wb, momentum, .. } = &planned.inside[q];
                let change = sub(beyond[q], cross(turned[q], *momentum));
                rate[q] = mul(rot_wb, mul(&self.tables.constants.inverse_inertia, mul_transposed(rot_wb, change)));
            }
            for q in 0..END {
                turned[q] = [zero; 3];
                for r in 0..END {
                    turned[q] = add(turned[q], scale(self.tables.momentum_points[q].integral[r], rate[r]));
                }
            }
        }
        [turned, rate]
    }

    /// Writes the residuals of the linear rows.
    #[inline(always)]
    fn put_linear(&self, forces: &Impulses<T>, residual: &mut [T]) {
        let (zero, half, gravity) = (T::zero(), T::of(0.5), T::of(-GRAVITY));
        let (mass, h, state) = (self.tables.constants.mass, self.tables.constants.interval, &self.state);
        let at = self.interval.linear.row as usize;
        for d in 0..3 {
            let weight = if d == 2 { gravity } else { zero };
            let sped_up = mass * (state[3][d] - state[1][d] - h * weight) - forces.first[END][d];
            let moved_on = mass * (state[2][d] - state[0][d] - h * state[1][d] - half * h * h * weight) - forces.second[END][d];
            residual[at + d] = sped_up * self.linear_scales[0];
            residual[at + 3 + d] = moved_on * self.linear_scales[1];
        }
    }

    /// Writes the residuals of the angular rows.
    #[inline(always)]
    fn put_angular(&self, motion: &Motion<T>, planned: &Planned<T>, deviation: &Deviation<T>, residual: &mut [T]) {
        let (start, end) = (&planned.start.value, &planned.end.value);
        let at = self.interval.angular.row as usize;
        for d in 0..3 {
            residual[at + d] = (end[d] - start[d] - motion.gained[END][d]) * self.angular_scales[0];
            residual[at + 3 + d] = (planned.mean[d] - start[d] - motion.gained_mean[d] + deviation.mean[d]) * self.angular_scales[1];
        }
    }

    /// Writes the derivatives with respect to the linear part of pose and rates: linear rows at the start and at the end, angular rows at
    /// the start.
    #[inline(always)]
    fn put_by_start(&self, forces: &Impulses<T>, jacobian: &mut [T]) {
        let (zero, mass, h) = (T::zero(), self.tables.constants.mass, self.tables.constants.interval);
        let mut rows = Rows::new(jacobian, &self.interval.linear);
        // Derivatives of the velocity and position rows with respect to pose and rates at the start, pose and rates at the end.
        for (i, by) in [[zero, -mass], [-mass, -mass * h], [zero, mass], [mass, zero]].into_iter().enumerate() {
            if self.interval.linear_column[i] != NONE {
                for d in 0..3 {
                    let column = self.interval.linear_column[i] as usize + d;
                    rows.put(d, column, by[0] * self.linear_scales[0]);
                    rows.put(3 + d, column, by[1] * self.linear_scales[1]);
                }
            }
        }
        // Derivatives of the angular rows with respect to position and velocity at the start: -[J]x and -[tau J - P]x.
        let Impulses { first, second, .. } = forces;
        let mut by_start = [[first[END], [zero; 3]], [sub(scale(h, first[END]), second[END]), [zero; 3]]];
        for q in 0..END {
            let MomentumPoint { time, mean, .. } = self.tables.momentum_points[q];
            by_start[0][1] = add(by_start[0][1], scale(mean, first[q]));
            by_start[1][1] = add(by_start[1][1], scale(mean, sub(scale(time, first[q]), second[q])));
        }
        let mut rows = Rows::new(jacobian, &self.interval.angular);
        let [end_scale, mean_scale] = self.angular_scales;
        for i in 0..2 {
            if self.interval.angular_column[i] != NONE {
                let column = self.interval.angular_column[i] as usize;
                rows.put_cross(0, column, scale(-end_scale, by_start[i][0]));
                rows.put_cross(3, column, scale(-mean_scale, by_start[i][1]));
            }
        }
    }

    /// Writes the derivatives of the angular rows with respect to the Euler angles and their rates at the start and at the end.
    #[inline(always)]
    fn put_by_attitude(&self, planned: &Planned<T>, jacobian: &mut [T]) {
        let [end_scale, mean_scale] = self.angular_scales;
        let (start, end) = (&planned.start, &planned.end);
        let ends = [&start.by_angle, &start.by_rate, &end.by_angle, &end.by_rate];
        let mut rows = Rows::new(jacobian, &self.interval.angular);
        for i in 0..4 {
            if self.interval.angular_column[i] == NONE {
                continue;
            }
            let column = self.interval.angular_column[i] as usize + 3;
            for r in 0..3 {
                let sign = if i < 2 { -end_scale } else { end_scale };
                rows.put_three(r, column, std::array::from_fn(|d| sign * ends[i][d][r]));
                let start = |d: usize| if i < 2 { ends[i][d][r] } else { T::zero() };
                rows.put_three(3 + r, column, std::array::from_fn(|d| (planned.mean_by[i][d][r] - start(d)) * mean_scale));
            }
        }
    }

    /// Writes the derivatives with respect to the force nodes.
    ///
    /// The derivatives of the angular rows are `-[a]x` with `a = w_1 (x_i - p_k - d) + w_2 v - w_3 g`, where `w` are the integrals of the
    /// node's basis function.
    #[inline(always)]
    fn put_by_forces(&self, motion: &Motion<T>, jacobian: &mut [T]) {
        let mut rows = Rows::new(jacobian, &self.interval.linear);
        for impulse in self.nodes() {
            let w = &impulse.weights[END];
            for part in 0..2 {
                for d in 0..3 {
                    let column = impulse.linear_column as usize + 3 * part + d;
                    rows.put(d, column, -w[0][part] * self.linear_scales[0]);
                    rows.put(3 + d, column, -w[1][part] * self.linear_scales[1]);
                }
            }
        }
        let mut rows = Rows::new(jacobian, &self.interval.angular);
        let [end_scale, mean_scale] = self.angular_scales;
        for of_foothold in self.nodes().chunk_by(|a, b| a.foothold == b.foothold) {
            let arm = self.arm(of_foothold[0].foothold as usize);
            let arms: Points<T> = std::array::from_fn(|q| sub(arm, motion.moved[q]));
            for impulse in of_foothold {
                for part in 0..2 {
                    let lever = |q: usize| {
                        let w = &impulse.weights[q];
                        let mut a = add(scale(w[0][part], arms[q]), scale(w[1][part], motion.velocity[q]));
                        a[2] += w[2][part] * T::of(GRAVITY);
                        a
                    };
                    let mut mean = [T::zero(); 3];
                    for (q, point) in self.tables.momentum_points[..END].iter().enumerate() {
                        mean = add(mean, scale(point.mean, lever(q)));
                    }
                    let column = impulse.angular_column as usize + 3 * part;
                    rows.put_cross(0, column, scale(-end_scale, lever(END)));
                    rows.put_cross(3, column, scale(-mean_scale, mean));
                }
            }
        }
        for impulse in self.moments() {
            for part in 0..2 {
                let mut mean = T::zero();
                for (w, point) in impulse.weights[..END].iter().zip(&self.tables.momentum_points) {
                    mean += point.mean * w[0][part];
                }
                let column = impulse.angular_column as usize + 3 * part;
                for r in 0..3 {
                    let along = |value: T| std::array::from_fn(|d| if d == r { value } else { T::zero() });
                    rows.put_three(r, column, along(-end_scale * impulse.weights[END][0][part]));
                    rows.put_three(3 + r, column, along(-mean_scale * mean));
                }
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
