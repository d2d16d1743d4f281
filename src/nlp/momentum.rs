//! The `momentum` transcription: base states at knots, and the exact change of momentum over each interval in between.
//!
//! Forces are cubics, so their impulses are exact weights on the force nodes. So is the angular momentum: taken about the base position
//! `p_k` at the start of the interval instead of the moving base, it changes by the moments of impulses about fixed footholds and by
//! the moment of gravity, and both are integrals of the forces alone. With `J_i`, `P`, `W` the first to third integral of forces,
//!
//! `v = v_k + g tau + J / m`, `d = v_k tau + g tau^2 / 2 + P / m`,
//! `L = L_k + sum (x_i - p_k) x J_i + (m v_k tau^2 / 2 + W) x g - m d x v`.
//!
//! No quadrature of moments is needed; only the attitude asks for one: the mean of `L` over an interval must be that of the planned
//! motion, `R I R' omega`, at the nodes of a Gauss-Legendre rule.

use super::builder::Builder;
use super::layout::{BasePoint, Family, INNER_POINTS, Impulse, MOMENTUM_POINTS, MomentumInterval, MomentumPoint, NONE, Place};
use super::sweep::Span;
use super::{Layout, Real};
use crate::gait::spline::{hermite, hermite_rate};
use crate::gait::{Curve, Phase};
use crate::robot::GRAVITY;
use crate::settings::GoalVelocity;
use crate::task::Task;
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::sync::LazyLock;

/// Horizontal speed of a foot in mid-swing, in its mean speeds.
///
/// One cubic from rest to rest has 1.5. The slower the middle, the faster a foot leaves the ground and the less the base, moving on,
/// drags it out of reach before it follows: see `benches/README.md`.
pub const MID_SPEED: f64 = 0.75;

/// Highest horizontal speed in a swing, in mean speeds: of `v(u) = (6 - 2 c) u - (6 - 3 c) u^2` in each half, with `c` = [`MID_SPEED`].
pub const TOP_SPEED: f64 = (6. - 2. * MID_SPEED) * (6. - 2. * MID_SPEED) / (4. * (6. - 3. * MID_SPEED));

/// How firmly the base is pulled to the initial guess, against 1 for a force of the weight per foot: its attitude, 1/rad², and its rates,
/// s²/m² and s²/rad².
const POSE_PULL: [f64; 6] = [0., 0., 0., 1., 1., 1.];
const RATE_PULL: [f64; 6] = [0.1; 6];

/// Part of the horizon in which the initial guess speeds up, and slows down again.
const RAMP: f64 = 0.3;

/// Gauss-Legendre rule on (0, 1) with three nodes: exact for the integrals of a cubic that are needed.
const EXACT_RULE: [[f64; 2]; 3] = [[0.112_701_665_379_258_3, 5. / 18.], [0.5, 8. / 18.], [0.887_298_334_620_741_7, 5. / 18.]];

/// Nodes and weights of the Gauss-Legendre rule of [`INNER_POINTS`] on (0, 1), by Newton's method on the Legendre polynomial.
static INNER_RULE: LazyLock<[[f64; 2]; INNER_POINTS]> = LazyLock::new(|| {
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

/// Value at `u` of the polynomial that is 1 at node `i` and 0 at the others.
fn lagrange(nodes: &[f64], i: usize, u: f64) -> f64 {
    (0..nodes.len()).filter(|&j| j != i).map(|j| (u - nodes[j]) / (nodes[i] - nodes[j])).product()
}

/// Points of an interval of length `h`.
pub(super) fn points<T: Real>(h: f64) -> [MomentumPoint<T>; MOMENTUM_POINTS] {
    let rule = *INNER_RULE;
    let nodes = rule.map(|[u, _]| u);
    std::array::from_fn(|q| {
        let [part, mean] = rule.get(q).copied().unwrap_or([1., 0.]);
        let t = part * h;
        // The rule itself is exact for polynomials through its nodes.
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

/// Weights of the deviations at the inner points at part `u` of an interval: a polynomial that vanishes at both ends.
fn deviation_weights(u: f64) -> [f64; INNER_POINTS] {
    let nodes = INNER_RULE.map(|[u, _]| u);
    std::array::from_fn(|i| lagrange(&nodes, i, u) * u * (1. - u) / (nodes[i] * (1. - nodes[i])))
}

/// Where the initial guess has the base at time `t`, and its rate: along the line, from rest, and to rest when the goal asks for it.
pub(super) fn base_guess<T: Real>(b: &Builder<T>, t: f64) -> ([f64; 6], [f64; 6]) {
    let (start, goal) = (b.reference(0.), b.reference(b.horizon));
    let slows = b.settings.goal_velocity == GoalVelocity::Zero;
    let u = (t / b.horizon).clamp(0., 1.);
    // Speed rises linearly over the ramp, stays, falls linearly; the area is 1.
    let peak = 1. / if slows { 1. - RAMP } else { 1. - RAMP / 2. };
    let (part, speed) = if u < RAMP {
        (peak * u * u / (2. * RAMP), peak * u / RAMP)
    } else if slows && u > 1. - RAMP {
        let left = 1. - u;
        (1. - peak * left * left / (2. * RAMP), peak * left / RAMP)
    } else {
        (peak * (u - RAMP / 2.), peak)
    };
    let pose = std::array::from_fn(|i| start[i] + part * (goal[i] - start[i]));
    (pose, std::array::from_fn(|i| speed * (goal[i] - start[i]) / b.horizon))
}

/// Pose and rates at every knot, as deviations from the reference line.
pub(super) fn base_blocks<T: Real>(b: &mut Builder<T>) {
    let line_rate = b.reference_rate();
    for k in 0..=b.intervals {
        let t = k as f64 * b.interval;
        let (first, last) = (k == 0, k == b.intervals);
        let ((pose, rate), line) = (base_guess(b, t), b.reference(t));
        let pose = (0..6).map(|i| pose[i] - line[i]).collect();
        let rate = (0..6).map(|i| rate[i] - line_rate[i]).collect();
        let pose = b.block(first || last, pose);
        let rate = b.block(first || (last && b.settings.goal_velocity == GoalVelocity::Zero), rate);
        b.pull(pose, POSE_PULL);
        b.pull(rate, RATE_PULL);
        b.curves.base.extend([pose, rate]);
    }
}

/// Momentum rows of every interval.
pub(super) fn interval_elements<T: Real>(b: &mut Builder<T>) {
    for k in 0..b.intervals {
        let t = k as f64 * b.interval;
        let variable: [u32; 4] = std::array::from_fn(|i| b.curves.base[2 * k + i]);
        let first = b.impulses.len();
        for foot in 0..b.curves.feet.len() {
            for stance in 0..b.curves.feet[foot].force_nodes.len() {
                let impulses = stance_impulses(b, foot, stance, t);
                b.impulses.extend(impulses);
            }
        }
        b.momentum.push(MomentumInterval {
            reference: [t, t + b.interval].map(|t| b.reference(t).map(T::of)),
            rate: b.reference_rate().map(T::of),
            variable,
            linear_column: [NONE; 4],
            angular_column: [NONE; 4],
            impulses: Span { start: first as u32, end: b.impulses.len() as u32 },
            linear: Place::default(),
            angular: Place::default(),
        });
        let nodes: Vec<u32> = variable.into_iter().chain(b.impulses[first..].iter().map(|i| i.node)).collect();
        let footholds: Vec<u32> = b.impulses[first..].iter().map(|i| b.foothold_blocks[i.foothold as usize]).collect();
        b.element(Family::LinearMomentum, k, k, nodes.iter().copied());
        b.element(Family::AngularMomentum, k, k, nodes.into_iter().chain(footholds));
    }
}

/// First to third integral of each node's basis functions, `[value, slope]`.
type Integrals = [[f64; 2]; 3];

/// Integrals from `t` to `end` of the basis functions of a stance's force nodes: `int b`, `int (end - s) b`, `int (end - s)^2 / 2 b ds`.
fn basis_integrals(span: Phase, nodes: usize, t: f64, end: f64) -> Vec<Integrals> {
    let duration = span.duration() / (nodes - 1) as f64;
    let mut integrals = vec![Integrals::default(); nodes];
    for piece in 0..nodes - 1 {
        let start = span.start + piece as f64 * duration;
        let (low, high) = (start.max(t), (start + duration).min(end));
        if low >= high {
            continue;
        }
        for [part, weight] in EXACT_RULE {
            let s = low + part * (high - low);
            let basis = hermite(s - start, duration);
            let left = end - s;
            for (order, kernel) in [1., left, left * left / 2.].into_iter().enumerate() {
                for i in 0..2 {
                    for part in 0..2 {
                        integrals[piece + i][order][part] += weight * (high - low) * kernel * basis[2 * i + part];
                    }
                }
            }
        }
    }
    integrals
}

/// What the force nodes of a stance do in the interval that starts at `t`.
fn stance_impulses<T: Real>(b: &Builder<T>, foot: usize, stance: usize, t: f64) -> Vec<Impulse<T>> {
    let h = b.interval;
    let span = b.curves.feet[foot].phases[2 * stance];
    if span.end <= t + 1e-9 || span.start >= t + h - 1e-9 {
        return Vec::new();
    }
    let nodes = &b.curves.feet[foot].force_nodes[stance];
    let scale = [b.force_unit(), b.force_unit() * b.settings.force_pieces as f64 / span.duration()];
    let points: [Vec<Integrals>; MOMENTUM_POINTS] = std::array::from_fn(|q| {
        let end = t + INNER_RULE.get(q).map_or(1., |n| n[0]) * h;
        basis_integrals(span, nodes.len(), t, end)
    });
    let impulse = |node: usize| Impulse {
        weights: std::array::from_fn(|q| points[q][node].map(|order| std::array::from_fn(|part| T::of(order[part] * scale[part])))),
        node: nodes[node],
        linear_column: NONE,
        angular_column: NONE,
        foothold: (b.first_foothold[foot] + stance) as u32,
        foothold_column: NONE,
    };
    let at_work = |&node: &usize| nodes[node] != NONE && points[MOMENTUM_POINTS - 1][node][0] != [0.; 2];
    (0..nodes.len()).filter(at_work).map(impulse).collect()
}

/// Longest time between reach rows of all feet, s.
const REACH: f64 = 0.026;

/// Parts of a swing at which reach is held besides: near its ends the base drags the foot along, or runs ahead of it.
const SWING_PARTS: [f64; 5] = [0.0625, 0.125, 0.5, 0.875, 0.9375];

/// Reach rows of all feet at most [`REACH`] apart, and of swinging feet at parts of their swings.
pub(super) fn reach_elements<T: Real>(b: &mut Builder<T>) {
    let (h, feet) = (b.interval, b.curves.feet.len());
    let pieces = (h / REACH).ceil() as usize;
    let mut instants: Vec<(f64, std::ops::Range<usize>)> =
        (0..=pieces * b.intervals).map(|i| (i as f64 * h / pieces as f64, 0..feet)).collect();
    for foot in 0..feet {
        for swing in b.curves.feet[foot].phases.iter().filter(|p| !p.stance) {
            instants.extend(SWING_PARTS.map(|part| (swing.start + part * swing.duration(), foot..foot + 1)));
        }
    }
    instants.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (t, feet) in instants {
        let k = ((t / h + 1e-9) as usize).min(b.intervals - 1);
        let in_interval = match t - k as f64 * h {
            // A knot is a knot: what has no part in it is left out.
            u if u < 1e-9 => 0.,
            u if u > h - 1e-9 => h,
            u => u,
        };
        let base = BasePoint {
            reference: b.reference(t).map(T::of),
            weights: hermite(in_interval, h).map(T::of),
            variable: std::array::from_fn(|i| b.curves.base[2 * k + i]),
            slot: [NONE; 4],
            interval: k as u32,
            deviation_weights: deviation_weights(in_interval / h).map(T::of),
        };
        b.reach_instant(t, feet, k, base);
    }
}

/// Longest piece of a base curve, s. A cubic over twice as much would be up to a centimetre off what the forces do.
const PIECE: f64 = 0.026;

/// Base position and Euler angles: at every knot those of the solution, in between what the forces make of them.
pub(super) fn base_curves(task: &Task, layout: &Layout<f64>, x: &[f64]) -> [Curve; 2] {
    let curves = &layout.curves;
    let (n, h) = (curves.intervals, curves.interval);
    let start = [task.base_start(), [0.; 3]].concat();
    let goal = [task.base_target, [0., 0., task.yaw_target]].concat();
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
        let between = if k < n { between(task, layout, x, k as f64 * h, state, pieces) } else { Vec::new() };
        for state in std::iter::once(state).chain(between) {
            nodes[0].push(node(state, 0));
            nodes[1].push(node(state, 3));
        }
    }
    nodes.map(|nodes| Curve { poly_durations: vec![h / pieces as f64; pieces * n], nodes })
}

/// Pose and rates at the ends of all but the last of the `pieces` of an interval, from the state at its start, `t`, under the planned
/// forces.
///
/// Position and velocity are exact; the attitude takes two Runge-Kutta steps a piece along the exact angular momentum.
fn between(task: &Task, layout: &Layout<f64>, x: &[f64], t: f64, [pose, rate]: [[f64; 6]; 2], pieces: usize) -> Vec<[[f64; 6]; 2]> {
    let robot = &task.robot;
    let (mass, gravity) = (robot.mass, Vector3::new(0., 0., -GRAVITY));
    let inertia = Matrix3::from_fn(|r, c| robot.inertia[r][c]);
    let vector = |v: &[f64]| Vector3::new(v[0], v[1], v[2]);
    let (p, v) = (vector(&pose), vector(&rate));
    // Moved, velocity and angular momentum gained after `tau`.
    let after = |tau: f64| {
        let (mut first, mut second, mut third, mut moment) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        for foot in &layout.curves.feet {
            for (stance, nodes) in foot.force_nodes.iter().enumerate() {
                let span = foot.phases[2 * stance];
                if span.end <= t || span.start >= t + tau {
                    continue;
                }
                let piece = span.duration() / (nodes.len() - 1) as f64;
                let scale = [layout.constants.force_unit, layout.constants.force_unit / piece];
                let mut sums = [Vector3::zeros(); 3];
                for (&node, integrals) in nodes.iter().zip(basis_integrals(span, nodes.len(), t, t + tau)).filter(|(n, _)| **n != NONE) {
                    for (sum, weights) in sums.iter_mut().zip(integrals) {
                        for part in 0..2 {
                            *sum += vector(&x[node as usize + 3 * part..]) * (weights[part] * scale[part]);
                        }
                    }
                }
                let at = foot.footholds[stance] as usize;
                let foothold = Vector3::new(x[at], x[at + 1], task.terrain.height(x[at], x[at + 1]));
                moment += (foothold - p).cross(&sums[0]);
                first += sums[0];
                second += sums[1];
                third += sums[2];
            }
        }
        let velocity = v + gravity * tau + first / mass;
        let moved = v * tau + gravity * (tau * tau / 2.) + second / mass;
        let gained = moment + (v * (mass * tau * tau / 2.) + third).cross(&gravity) - moved.cross(&velocity) * mass;
        (moved, velocity, gained)
    };
    let turn = |angles: &Vector3<f64>| Rotation3::from_euler_angles(angles.x, angles.y, angles.z);
    // omega = E rates
    let axes = |angles: &Vector3<f64>| {
        let yaw = Rotation3::from_axis_angle(&Vector3::z_axis(), angles.z);
        let pitch = Rotation3::from_axis_angle(&Vector3::y_axis(), angles.y);
        Matrix3::from_columns(&[yaw * pitch * Vector3::x(), yaw * Vector3::y(), Vector3::z()])
    };
    let (angles, rates) = (vector(&pose[3..]), vector(&rate[3..]));
    let rotation = turn(&angles);
    let at_start = rotation * (inertia * (rotation.inverse() * (axes(&angles) * rates)));
    let inverse = inertia.try_inverse().unwrap_or_else(Matrix3::zeros);
    let rates_at = |angles: &Vector3<f64>, momentum: Vector3<f64>| {
        let rotation = turn(angles);
        let omega = rotation * (inverse * (rotation.inverse() * momentum));
        axes(angles).try_inverse().unwrap_or_else(Matrix3::zeros) * omega
    };
    let step = layout.curves.interval / (2 * pieces) as f64;
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
