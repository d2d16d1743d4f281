//! The `momentum` transcription: base states at knots, and the exact change of momentum over the interval between two knots.
//!
//! Forces are cubics, so their impulses are exact weights on the force nodes. The angular momentum is exact too: it is taken about the base
//! position `p_k` at the start of the interval instead of the moving base, so that it changes only by the moments of impulses about fixed
//! footholds and by the moment of gravity, and both are integrals of the forces alone. With `J_i`, `P`, `W` the first to third integral of
//! forces,
//!
//! `v = v_k + g tau + J / m`, `d = v_k tau + g tau^2 / 2 + P / m`,
//! `L = L_k + sum (x_i - p_k) x J_i + (m v_k tau^2 / 2 + W) x g - m d x v`.
//!
//! Moments need no quadrature. Only the attitude does: the mean of `L` over an interval must equal that of the planned motion,
//! `R I R' omega`, at the nodes of a Gauss-Legendre rule.

use super::legs::{foot_acceleration, foot_speed};
use super::{Guess, ReachTime, SwingLaw, Transcribe, initial_guess};
use crate::gait::family::RAMP;
use crate::gait::spline::{hermite, hermite_rate};
use crate::gait::swing::{MID_SPEED, TOP_ACCELERATION, TOP_SPEED};
use crate::gait::trajectory::{GoalVelocity, MotionLimits};
use crate::gait::{Curve, Phase};
use crate::nlp::builder::Builder;
use crate::nlp::problem::{Curves, FootBlocks};
use crate::quadrature::{GAUSS_3, GAUSS_6};
use crate::real::Real;
use crate::robot::{GRAVITY, Robot};
use crate::rows::Family;
use crate::rows::blocks::Use;
use crate::rows::math::euler;
use crate::rows::momentum::{INNER_POINTS, Impulse, MOMENTUM_POINTS, MomentumInterval};
use crate::rows::reach::ReachInstant;
use crate::rows::table::{NONE, Place, Span};
use crate::rows::turn::YAW;
use crate::settings::TranscriptionSettings;
use crate::task::Task;
use nalgebra::{Matrix3, Vector3};
use std::sync::LazyLock;

/// Weight that attracts footholds to the initial guess, relative to 1 for a force of the weight per foot, 1/m². It would not slow the feet:
/// with 0, 1, 10 and 100 the fastest foot of ANYmal's smoothed trot reaches 3.47, 3.51, 3.42 and 3.70 m/s.
const FOOTHOLD_SMOOTHING: f64 = 0.;

/// Weights that attract the base pose to the initial guess, relative to 1 for a force of the weight per foot: attitude only, 1/rad².
const POSE_SMOOTHING: [f64; 6] = [0., 0., 0., 1., 1., 1.];
/// Weights that attract the base rates to the initial guess, relative to 1 for a force of the weight per foot, s²/m² and s²/rad².
const RATE_SMOOTHING: [f64; 6] = [0.1; 6];

/// Degree of the polynomials of the deviation.
const DEVIATION_DEGREE: usize = INNER_POINTS + 1;

/// Coefficients of the polynomials that are 1 at one inner point and 0 at the others and at both ends of an interval, constant term first.
static DEVIATION_POLYNOMIALS: LazyLock<[[f64; DEVIATION_DEGREE + 1]; INNER_POINTS]> = LazyLock::new(|| {
    let inner = GAUSS_6.map(|[u, _]| u);
    std::array::from_fn(|i| {
        let mut polynomial = [0.; DEVIATION_DEGREE + 1];
        polynomial[0] = 1.;
        // One factor (u - node) / (inner[i] - node) after the other.
        for node in inner.into_iter().chain([0., 1.]).filter(|node| *node != inner[i]) {
            for power in (0..=DEVIATION_DEGREE).rev() {
                let lower = if power > 0 { polynomial[power - 1] } else { 0. };
                polynomial[power] = (lower - node * polynomial[power]) / (inner[i] - node);
            }
        }
        polynomial
    })
});

/// Weights of the deviations at the inner points for fraction `u` of an interval: a polynomial that vanishes at both ends.
pub(crate) fn deviation_weights(u: f64) -> [f64; INNER_POINTS] {
    DEVIATION_POLYNOMIALS.map(|polynomial| polynomial.iter().rev().fold(0., |sum, c| sum * u + c))
}

/// Derivatives of [`deviation_weights`] with respect to `u`.
pub(crate) fn deviation_rates(u: f64) -> [f64; INNER_POINTS] {
    let terms = |polynomial: [f64; DEVIATION_DEGREE + 1]| (1..=DEVIATION_DEGREE).rev().map(move |power| power as f64 * polynomial[power]);
    DEVIATION_POLYNOMIALS.map(|polynomial| terms(polynomial).fold(0., |sum, c| sum * u + c))
}

/// Pose and rate of the base in the initial guess at time `t`.
///
/// The base follows the straight line and the ground path. It accelerates from rest, and decelerates to rest if the goal velocity is to be
/// zero. The start and goal rates of the task are added as Hermite terms.
///
/// If the end is free, it is one cubic from start to goal, and continues at the velocity of the goal.
fn base_guess<T: Real>(b: &Builder<T>, t: f64) -> ([f64; 6], [f64; 6]) {
    let (start, goal) = (b.reference(0.), b.reference(b.horizon));
    if b.settings.goal_velocity == GoalVelocity::Near {
        let (within, beyond) = (t.min(b.horizon), (t - b.horizon).max(0.));
        let (value, slope) = (hermite(within, b.horizon), hermite_rate(within, b.horizon));
        let (from, to) = (b.task.start.rate(), b.task.goal.rate());
        let at = |w: [f64; 4], i: usize| w[0] * start[i] + w[1] * from[i] + w[2] * goal[i] + w[3] * to[i];
        return (std::array::from_fn(|i| at(value, i) + beyond * to[i]), std::array::from_fn(|i| at(slope, i)));
    }
    let slows = b.settings.goal_velocity == GoalVelocity::Zero;
    let u = (t / b.horizon).clamp(0., 1.);
    // Trapezoidal speed profile with area 1: linear over the ramp, constant, and linear again if the base decelerates.
    let peak = 1. / if slows { 1. - RAMP } else { 1. - RAMP / 2. };
    let (part, speed) = if u < RAMP {
        (peak * u * u / (2. * RAMP), peak * u / RAMP)
    } else if slows && u > 1. - RAMP {
        let left = 1. - u;
        (1. - peak * left * left / (2. * RAMP), peak * left / RAMP)
    } else {
        (peak * (u - RAMP / 2.), peak)
    };
    let ([_, leave, _, arrive], [_, leaves, _, arrives]) = (hermite(t, b.horizon), hermite_rate(t, b.horizon));
    let (from, to) = (b.task.start.rate(), b.task.goal.rate());
    let mut pose: [f64; 6] = std::array::from_fn(|i| start[i] + part * (goal[i] - start[i]) + leave * from[i] + arrive * to[i]);
    let mut rate: [f64; 6] = std::array::from_fn(|i| speed * (goal[i] - start[i]) / b.horizon + leaves * from[i] + arrives * to[i]);
    if let Some(path) = &b.ground_path {
        let [off, slope] = path.at(part);
        for i in 0..3 {
            pose[2 + i] += off[i];
            rate[2 + i] += speed / b.horizon * slope[i];
        }
    }
    (pose, rate)
}

/// Fractions of a swing at which its height is constrained on ground with edges. On other ground the mid node suffices, because z rises to
/// it and falls from it. For the upper limit the mid node always suffices.
const SWING_HEIGHTS: [f64; 9] = [0.0625, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 0.9375];

/// Interval between base knots for a robot, s, limited by how fast a body on such legs can turn and fall.
///
/// Half of `sqrt(l / g)`, in steps of 0.025 s from 0.025 to 0.1 s. That is 0.1 s for legs of 0.4 m and 0.05 s for those of 0.14 m.
/// Of 120 candidates of a hexapod with legs of 0.14 m, 5 to 12 are certified with 0.1 s, 26 with 0.075 s and 38 with 0.05 s.
pub fn interval(robot: &Robot) -> f64 {
    ((0.5 * (robot.leg_height() / GRAVITY).sqrt() / 0.025).floor() * 0.025).clamp(0.025, 0.1)
}

/// Implementation of the `momentum` transcription.
pub(super) struct Momentum;

impl<T: Real> Transcribe<T> for Momentum {
    fn steps(&self, intervals: usize) -> usize {
        intervals
    }

    /// Adds pose and rates at every knot, as deviations from the reference line.
    fn base_blocks(&self, b: &mut Builder<T>) {
        let line_rate = b.reference_rate();
        for k in 0..=b.intervals {
            let t = k as f64 * b.interval;
            let (first, last) = (k == 0, k == b.intervals);
            let ((pose, rate), line) = (base_guess(b, t), b.reference(t));
            let pose: [f64; 6] = std::array::from_fn(|i| pose[i] - line[i]);
            let rate: [f64; 6] = std::array::from_fn(|i| rate[i] - line_rate[i]);
            let (stops, arrives) = (b.settings.goal_velocity == GoalVelocity::Zero, b.settings.goal_velocity != GoalVelocity::Near);
            let pose = b.block(first || (last && arrives), pose, POSE_SMOOTHING);
            let rate = b.block(first || (last && stops), rate, RATE_SMOOTHING);
            b.base.extend([pose, rate]);
        }
    }

    /// Adds the momentum rows of every interval.
    fn dynamics(&self, b: &mut Builder<T>) {
        let mut uses = ImpulseUses::default();
        for k in 0..b.intervals {
            let t = k as f64 * b.interval;
            let first = b.tables.impulses.len();
            uses.linear.clear();
            uses.linear.extend(b.base[2 * k..2 * k + 4].iter().map(|&id| Use::Touches(id)));
            for foot in 0..b.feet.len() {
                for stance in 0..b.feet[foot].force_nodes.len() {
                    stance_impulses(b, foot, stance, t, &mut uses);
                }
            }
            let impulses = Span::added(first, &b.tables.impulses);
            b.tables.impulses.append(&mut uses.moment_impulses);
            b.tables.momentum_intervals.push(MomentumInterval {
                reference: [t, t + b.interval].map(|t| b.reference(t).map(T::of)),
                rate: b.reference_rate().map(T::of),
                variable: [NONE; 4],
                linear_column: [NONE; 4],
                angular_column: [NONE; 4],
                impulses,
                moments: Span::added(impulses.end as usize, &b.tables.impulses),
                linear: Place::default(),
                angular: Place::default(),
            });
            let ImpulseUses { linear, footholds, moments, .. } = &mut uses;
            b.element(Family::LinearMomentum, k, k, linear);
            linear.append(footholds);
            linear.append(moments);
            b.element(Family::AngularMomentum, k, k, linear);
        }
    }

    /// Instants of all feet at most [`REACH`] apart, and instants of swinging feet at fractions of their swings.
    fn reach_times(&self, b: &Builder<T>) -> Vec<ReachTime<T>> {
        let h = b.interval;
        let phases: Vec<&[Phase]> = b.feet.iter().map(|foot| &foot.phases[..]).collect();
        let time = |ReachTiming { t, feet, .. }| {
            let k = ((t / h + 1e-9) as usize).min(b.intervals - 1);
            let in_interval = match t - k as f64 * h {
                // Rounds to the knot, so that blocks without weight there are left out.
                u if u < 1e-9 => 0.,
                u if u > h - 1e-9 => h,
                u => u,
            };
            let deviation_weights = deviation_weights(in_interval / h).map(T::of);
            ReachTime {
                t,
                feet,
                step: k,
                interval: k as u32,
                weights: hermite(in_interval, h).map(T::of),
                blocks: std::array::from_fn(|i| b.base[2 * k + i]),
                entry: ReachInstant { reference: b.reference(t).map(T::of), deviation_weights },
            }
        };
        reach_timings(&phases, h, b.intervals).into_iter().map(time).collect()
    }

    fn foothold_smoothing(&self) -> f64 {
        FOOTHOLD_SMOOTHING
    }

    /// Middle of the foot's reach under the initial guess of the base in the middle of the stance; nominal footholds at start and goal,
    /// unless the end is free.
    fn foothold(&self, b: &Builder<T>, foot: usize, stance: usize, stances: usize) -> [f64; 2] {
        if stance == 0 {
            return b.task.foothold_start(foot);
        }
        if stance + 1 == stances && b.settings.goal_velocity != GoalVelocity::Near {
            return b.task.foothold_goal(foot);
        }
        let span = b.feet[foot].phases[2 * stance];
        let (pose, _) = base_guess(b, (span.start + span.end) / 2.);
        initial_guess::under_base(b.task, foot, pose)
    }

    /// Equal share of the weight among the feet in contact.
    fn force(&self, b: &Builder<T>, t: f64) -> Guess {
        let in_contact = b.feet.iter().filter(|foot| foot.phases[foot.phase_at(t)].stance).count();
        Guess { initial: [0., 0., b.feet.len() as f64 / in_contact as f64, 0., 0., 0.], smoothing: [1.; 6] }
    }

    fn yaw(&self, b: &Builder<T>, t: f64) -> f64 {
        base_guess(b, t).0[YAW]
    }

    /// A cubic lies in the convex hull of its Bezier points; an inner node lies between the two Bezier points next to it.
    fn slopes(&self, node: usize, pieces: usize) -> &'static [f64] {
        match node {
            0 => &[0., 1. / 3.],
            node if node == pieces => &[-1. / 3., 0.],
            _ => &[-1. / 3., 1. / 3.],
        }
    }

    fn mid_time(&self, span: Phase) -> f64 {
        span.duration() / MID_SPEED
    }

    fn swing(&self, settings: &TranscriptionSettings, task: &Task, span: Phase) -> SwingLaw {
        let duration = span.duration();
        let square = duration * duration;
        SwingLaw {
            over: initial_guess::highest,
            above: settings.clearance,
            parts: if task.terrain.has_edges() { &SWING_HEIGHTS } else { &[0.5] },
            clearance: settings.clearance,
            limited: true,
            longest_step: Some(foot_speed(settings, &task.robot) * duration / TOP_SPEED),
            accelerations: foot_acceleration(settings, &task.robot).map(|_| [TOP_ACCELERATION / square, 24. / square]),
        }
    }

    fn limits(&self, settings: &TranscriptionSettings, robot: &Robot) -> Option<MotionLimits> {
        Some(limits(settings, robot))
    }

    fn base_curves(&self, task: &Task, curves: &Curves, x: &[f64]) -> [Curve; 2] {
        base_curves(task, curves, x)
    }
}

/// Limits that a motion of a robot satisfies in addition to its rows.
pub(crate) fn limits(settings: &TranscriptionSettings, robot: &Robot) -> MotionLimits {
    MotionLimits {
        clearance: settings.clearance,
        swing_height: settings.swing_height,
        foot_speed: foot_speed(settings, robot),
        foot_acceleration: foot_acceleration(settings, robot),
        goal_velocity: settings.goal_velocity,
    }
}

/// First to third integral of the basis functions of one node, `[value, slope]`.
type Integrals = [[f64; 2]; 3];

/// Calls `at` with every quadrature point of the force of a stance from `t` to `end`: index of the piece, basis functions at the point, and
/// weights of the point in `int f`, `int (end - s) f` and `int (end - s)^2 / 2 f ds`.
fn integrate(span: Phase, pieces: usize, t: f64, end: f64, mut at: impl FnMut(usize, [f64; 4], [f64; 3])) {
    let duration = span.duration() / pieces as f64;
    for piece in 0..pieces {
        let start = span.start + piece as f64 * duration;
        let (low, high) = (start.max(t), (start + duration).min(end));
        if low >= high {
            continue;
        }
        // Exact for the integrals of a cubic.
        for [part, weight] in GAUSS_3 {
            let s = low + part * (high - low);
            let (by, left) = (weight * (high - low), end - s);
            at(piece, hermite(s - start, duration), [by, by * left, by * left * left / 2.]);
        }
    }
}

/// Integrals of the basis functions of a stance's force nodes, from `t` to each of `ends`.
///
/// * `integrals` - out, one per node
fn basis_integrals(span: Phase, nodes: usize, t: f64, ends: [f64; MOMENTUM_POINTS], integrals: &mut Vec<[Integrals; MOMENTUM_POINTS]>) {
    integrals.clear();
    integrals.resize(nodes, Default::default());
    for (q, end) in ends.into_iter().enumerate() {
        integrate(span, nodes - 1, t, end, |piece, basis, weights| {
            for i in 0..2 {
                for (sums, weight) in integrals[piece + i][q].iter_mut().zip(weights) {
                    for part in 0..2 {
                        sums[part] += weight * basis[2 * i + part];
                    }
                }
            }
        });
    }
}

/// First to third integral of the force of a stance from `t` to `end`: `int f`, `int (end - s) f`, `int (end - s)^2 / 2 f ds`.
///
/// * `nodes` - positions of the force nodes in `x`
/// * `unit` - force unit, N
fn impulses(span: Phase, nodes: &[u32], x: &[f64], unit: f64, t: f64, end: f64) -> [Vector3<f64>; 3] {
    let pieces = nodes.len() - 1;
    let piece_duration = span.duration() / pieces as f64;
    let vector = |node: u32, part: usize| match node {
        NONE => Vector3::zeros(),
        node => Vector3::from_column_slice(&x[node as usize + 3 * part..][..3]),
    };
    let mut sums = [Vector3::zeros(); 3];
    integrate(span, pieces, t, end, |piece, basis, weights| {
        let force = (0..2).fold(Vector3::zeros(), |sum, i| {
            let node = nodes[piece + i];
            sum + vector(node, 0) * (unit * basis[2 * i]) + vector(node, 1) * (unit / piece_duration * basis[2 * i + 1])
        });
        for (sum, weight) in sums.iter_mut().zip(weights) {
            *sum += force * weight;
        }
    });
    sums
}

/// Blocks of the impulses in one interval.
#[derive(Default)]
struct ImpulseUses<T> {
    /// Base blocks, then force nodes.
    linear: Vec<Use>,
    /// Foothold of each force node.
    footholds: Vec<Use>,
    /// Moment nodes, and their impulses.
    moments: Vec<Use>,
    moment_impulses: Vec<Impulse<T>>,
    /// Scratch.
    integrals: Vec<[Integrals; MOMENTUM_POINTS]>,
}

/// Adds the impulses of a stance's force and moment nodes in the interval that starts at `t`.
fn stance_impulses<T: Real>(b: &mut Builder<T>, foot: usize, stance: usize, t: f64, uses: &mut ImpulseUses<T>) {
    let h = b.interval;
    let span = b.feet[foot].phases[2 * stance];
    if span.end <= t + 1e-9 || span.start >= t + h - 1e-9 {
        return;
    }
    let nodes = &b.feet[foot].force_nodes[stance];
    let pieces = b.settings.force_pieces() as f64;
    let [scale, moment_scale] = [b.force_unit(), b.moment_unit()].map(|unit| [unit, unit * pieces / span.duration()]);
    let ends = std::array::from_fn(|q| t + GAUSS_6.get(q).map_or(1., |n| n[0]) * h);
    basis_integrals(span, nodes.len(), t, ends, &mut uses.integrals);
    let foothold = b.feet[foot].footholds[stance];
    let moments = b.feet[foot].moment_nodes.get(stance);
    let impulse = |weights: &[Integrals; MOMENTUM_POINTS], scale: [f64; 2], foothold: u32| Impulse {
        weights: weights.map(|point| point.map(|order| std::array::from_fn(|part| T::of(order[part] * scale[part])))),
        node: NONE,
        linear_column: NONE,
        angular_column: NONE,
        foothold,
        foothold_column: NONE,
    };
    for (i, weights) in uses.integrals.iter().enumerate() {
        if let Some(node) = nodes[i]
            && weights[MOMENTUM_POINTS - 1][0] != [0.; 2]
        {
            uses.linear.push(Use::Touches(node));
            uses.footholds.push(Use::Touches(foothold.block));
            if let Some(moment) = moments.and_then(|moments| moments[i]) {
                uses.moments.push(Use::Touches(moment));
                uses.moment_impulses.push(impulse(weights, moment_scale, NONE));
            }
            b.tables.impulses.push(impulse(weights, scale, foothold.index));
        }
    }
}

/// Longest time between reach rows of all feet, s. With 0.05 s solves are 15 % faster, but two thirds of the certified gaits are lost.
const REACH: f64 = 0.026;

/// Fractions of a swing with additional reach rows: near its ends the base drags the foot along or runs ahead of it.
/// Certified of a test set: 927 with all five, 928 without the middle one (in 5 % more iterations), 922 with the outermost two (4 % more),
/// 643 with none.
const SWING_PARTS: [f64; 5] = [0.0625, 0.125, 0.5, 0.875, 0.9375];

/// Time and feet of a reach instant.
pub(crate) struct ReachTiming {
    /// Time, s.
    pub t: f64,
    /// Range of the feet.
    pub feet: std::ops::Range<usize>,
    /// Index that does not depend on the durations of the phases, only on their number. In the order of time, instants can change places.
    pub number: usize,
}

/// Reach instants in the order of time: of all feet at most [`REACH`] apart, and of swinging feet at fractions of their swings.
pub(crate) fn reach_timings(phases: &[&[Phase]], interval: f64, intervals: usize) -> Vec<ReachTiming> {
    let (h, feet) = (interval, phases.len());
    let pieces = (h / REACH).ceil() as usize;
    let mut instants: Vec<(f64, std::ops::Range<usize>)> =
        (0..=pieces * intervals).map(|i| (i as f64 * h / pieces as f64, 0..feet)).collect();
    for (foot, phases) in phases.iter().enumerate() {
        for swing in phases.iter().filter(|p| !p.stance) {
            // A swing can last beyond the horizon.
            let times = SWING_PARTS.map(|part| swing.start + part * swing.duration()).into_iter();
            instants.extend(times.filter(|t| *t <= intervals as f64 * h).map(|t| (t, foot..foot + 1)));
        }
    }
    let mut timings: Vec<ReachTiming> =
        instants.into_iter().enumerate().map(|(number, (t, feet))| ReachTiming { t, feet, number }).collect();
    timings.sort_by(|a, b| a.t.total_cmp(&b.t));
    timings
}

/// Longest piece of a base curve, s. A cubic over twice that time would deviate by up to a centimetre from the motion under the forces.
pub(crate) const PIECE: f64 = 0.026;

/// Curves of base position and Euler angles: the solution at every knot, and the motion under the planned forces in between.
fn base_curves(task: &Task, curves: &Curves, x: &[f64]) -> [Curve; 2] {
    let (n, h) = (curves.intervals, curves.interval);
    let (start, goal) = (task.start.pose(), task.goal.pose());
    let knot = |k: usize| -> [[f64; 6]; 2] {
        std::array::from_fn(|i| {
            std::array::from_fn(|d| {
                let slope = (goal[d] - start[d]) / (n as f64 * h);
                let reference = if i == 0 { start[d] + slope * k as f64 * h } else { slope };
                reference + x[curves.base[2 * k + i] as usize + d]
            })
        })
    };
    let node =
        |[pose, rate]: [[f64; 6]; 2], first: usize| std::array::from_fn(|i| if i < 3 { pose[first + i] } else { rate[first + i - 3] });
    let pieces = (h / PIECE).ceil() as usize;
    let mut nodes: [Vec<[f64; 6]>; 2] = Default::default();
    for k in 0..=n {
        let state = knot(k);
        let between = if k < n { between(task, curves, x, k as f64 * h, state, pieces) } else { Vec::new() };
        for state in std::iter::once(state).chain(between) {
            nodes[0].push(node(state, 0));
            nodes[1].push(node(state, 3));
        }
    }
    nodes.map(|nodes| Curve { poly_durations: vec![h / pieces as f64; pieces * n], nodes })
}

/// Pose and rates at the end of each of the `pieces` of an interval except the last, from the state at its start `t`, under the planned
/// forces.
///
/// Position and velocity are exact. The attitude is integrated along the exact angular momentum with two Runge-Kutta steps per piece.
fn between(task: &Task, curves: &Curves, x: &[f64], t: f64, [pose, rate]: [[f64; 6]; 2], pieces: usize) -> Vec<[[f64; 6]; 2]> {
    let robot = &task.robot;
    let (mass, gravity) = (robot.mass, Vector3::new(0., 0., -GRAVITY));
    let inertia = Matrix3::from_fn(|r, c| robot.inertia[r][c]);
    let vector = |v: &[f64]| Vector3::new(v[0], v[1], v[2]);
    let (p, v) = (vector(&pose), vector(&rate));
    let end = t + curves.interval;
    let stances = curves.feet.iter().flat_map(|foot| (0..foot.footholds.len()).map(move |stance| (foot, stance)));
    let place = |at: usize| Vector3::new(x[at], x[at + 1], task.terrain.height(x[at], x[at + 1]));
    // Stances that act in the interval, with the arm of their foothold from the base position at `t`.
    let at_work: Vec<(&FootBlocks, usize, Vector3<f64>)> = stances
        .filter(|&(foot, stance)| foot.phases[2 * stance].end > t && foot.phases[2 * stance].start < end)
        .map(|(foot, stance)| (foot, stance, place(foot.footholds[stance] as usize) - p))
        .collect();
    // First to third integral of the forces since `t`, and the moment of their impulses about the base position at `t`, with that of soles.
    let (mut done, mut integrals, mut moment) = (0., [Vector3::zeros(); 3], Vector3::zeros());
    // Displacement, velocity and gained angular momentum after `tau`, which must not decrease between calls.
    let mut after = |tau: f64| {
        let [first, second, third] = &mut integrals;
        let by = tau - done;
        *third += *second * by + *first * (by * by / 2.);
        *second += *first * by;
        for &(foot, stance, arm) in &at_work {
            let span = foot.phases[2 * stance];
            let [one, two, three] = impulses(span, &foot.force_nodes[stance], x, curves.force_unit, t + done, t + tau);
            moment += arm.cross(&one);
            if let Some(moments) = foot.moment_nodes.get(stance) {
                moment += impulses(span, moments, x, curves.moment_unit, t + done, t + tau)[0];
            }
            *first += one;
            *second += two;
            *third += three;
        }
        done = tau;
        let velocity = v + gravity * tau + *first / mass;
        let moved = v * tau + gravity * (tau * tau / 2.) + *second / mass;
        let gained = moment + (v * (mass * tau * tau / 2.) + *third).cross(&gravity) - moved.cross(&velocity) * mass;
        (moved, velocity, gained)
    };
    // Rotation from base to world, and the matrix `E` of `omega = E rates`.
    let turn = |angles: &Vector3<f64>| {
        let (rotation, axes) = euler((*angles).into());
        (Matrix3::from(rotation).transpose(), Matrix3::from(axes))
    };
    let (angles, rates) = (vector(&pose[3..]), vector(&rate[3..]));
    let (rotation, axes) = turn(&angles);
    let at_start = rotation * (inertia * rotation.tr_mul(&(axes * rates)));
    let inverse = inertia.try_inverse().unwrap_or_else(Matrix3::zeros);
    let rates_at = |angles: &Vector3<f64>, momentum: Vector3<f64>| {
        let (rotation, axes) = turn(angles);
        axes.try_inverse().unwrap_or_else(Matrix3::zeros) * (rotation * (inverse * rotation.tr_mul(&momentum)))
    };
    let step = curves.interval / (2 * pieces) as f64;
    let join = |a: Vector3<f64>, b: Vector3<f64>| [a.x, a.y, a.z, b.x, b.y, b.z];
    let mut now = angles;
    let mut at = after(0.);
    let mut states = Vec::with_capacity(pieces - 1);
    for i in 0..2 * (pieces - 1) {
        let (middle, end) = (after((i as f64 + 0.5) * step), after((i as f64 + 1.) * step));
        let k1 = rates_at(&now, at_start + at.2);
        let k2 = rates_at(&(now + k1 * (step / 2.)), at_start + middle.2);
        let k3 = rates_at(&(now + k2 * (step / 2.)), at_start + middle.2);
        let k4 = rates_at(&(now + k3 * step), at_start + end.2);
        now += (k1 + (k2 + k3) * 2. + k4) * (step / 6.);
        at = end;
        if i % 2 == 1 {
            states.push([join(p + at.0, now), join(at.1, rates_at(&now, at_start + at.2))]);
        }
    }
    states
}
