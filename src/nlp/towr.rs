//! The `towr` transcription: TOWR's rows \[3\] in variables that leave no linear equality.
//!
//! The base is the C2 cubic spline that TOWR's acceleration rows make of its Hermite nodes.

use super::builder::Builder;
use super::layout::{BasePoint, DynamicsInstant, Family, INNER_POINTS, NONE, Place, StanceForce};
use super::sweep::Span;
use super::{Layout, Real, initial_guess};
use crate::gait::Curve;
use crate::gait::spline::{BSpline, hermite};
use crate::task::Task;

/// Average swing duration that TOWR assumes for the mid-swing velocity, s.
pub const SWING_DURATION: f64 = 0.3;

/// Largest normal force of a foot in TOWR, N, whatever the robot.
pub const FORCE_LIMIT: f64 = 1000.;

/// Base coefficients as deviations from the reference line. The first two (start pose at rest) and the last (goal) are fixed.
pub(super) fn base_blocks<T: Real>(b: &mut Builder<T>) {
    let spline = BSpline::new(b.intervals, b.interval);
    let count = spline.coefficients();
    let start = b.reference(0.);
    let rise = initial_guess::final_base_height(b.task) - b.task.base_target[2];
    for j in 0..count {
        let on_line = b.reference(spline.greville(j));
        let fixed = j < 2 || j == count - 1;
        let initial = if j < 2 {
            (0..6).map(|i| start[i] - on_line[i]).collect()
        } else if j == count - 1 {
            vec![0.; 6]
        } else {
            vec![0., 0., spline.greville(j) / b.horizon * rise, 0., 0., 0.]
        };
        let id = b.block(fixed, initial);
        b.curves.base.push(id);
    }
}

/// Newton-Euler rows at every knot.
pub(super) fn dynamics_elements<T: Real>(b: &mut Builder<T>) {
    let spline = BSpline::new(b.intervals, b.interval);
    for k in 0..=b.intervals {
        let t = k as f64 * b.interval;
        // At a knot three of the four functions are alive: the first three of the interval that starts there.
        let (interval, skip) = if k < b.intervals { (k, 0) } else { (k - 1, 1) };
        let weights = std::array::from_fn(|derivative| {
            let basis = spline.basis(interval, t, derivative);
            std::array::from_fn(|i| T::of(basis[i + skip]))
        });
        let coefficients: [u32; 3] = std::array::from_fn(|i| b.curves.base[k + i]);
        let first_force = b.stance_forces.len() as u32;
        let mut blocks = coefficients.to_vec();
        for foot in 0..b.curves.feet.len() {
            let phase = b.phase_at(foot, t);
            if !b.curves.feet[foot].phases[phase].stance {
                continue;
            }
            let force = stance_force(b, foot, phase, t);
            blocks.extend(force.node);
            blocks.push(b.foothold_blocks[force.foothold as usize]);
            b.stance_forces.push(force);
        }
        b.dynamics.push(DynamicsInstant {
            reference: b.reference(t).map(T::of),
            rate: b.reference_rate().map(T::of),
            weights,
            variable: coefficients,
            column: [NONE; 3],
            forces: Span { start: first_force, end: b.stance_forces.len() as u32 },
            place: Place::default(),
        });
        b.element(Family::Dynamics, k, k, blocks);
    }
}

/// Weights of a force at time `t`.
fn stance_force<T: Real>(b: &Builder<T>, foot: usize, phase: usize, t: f64) -> StanceForce<T> {
    let span = b.curves.feet[foot].phases[phase];
    let nodes = &b.curves.feet[foot].force_nodes[phase / 2];
    let pieces = b.settings.force_pieces;
    let duration = span.duration() / pieces as f64;
    let piece = (((t - span.start) / duration).max(0.) as usize).min(pieces - 1);
    let w = hermite(t - span.start - piece as f64 * duration, duration);
    let (value, slope) = (b.force_unit(), b.force_unit() / duration);
    StanceForce {
        weights: [[T::of(w[0] * value), T::of(w[1] * slope)], [T::of(w[2] * value), T::of(w[3] * slope)]],
        node: [nodes[piece], nodes[piece + 1]],
        node_column: [NONE; 2],
        foothold: (b.first_foothold[foot] + phase / 2) as u32,
        foothold_column: NONE,
    }
}

/// Reach rows of all feet every `reach_interval` and at the end.
pub(super) fn reach_elements<T: Real>(b: &mut Builder<T>) {
    let spline = BSpline::new(b.intervals, b.interval);
    let every = b.settings.reach_interval;
    let mut times: Vec<f64> = (0..=(b.horizon / every + 1e-9) as usize).map(|i| i as f64 * every).collect();
    if b.horizon - times[times.len() - 1] > 1e-6 {
        times.push(b.horizon);
    }
    for t in times {
        let t = t.min(b.horizon);
        let interval = ((t / b.interval + 1e-9) as usize).min(b.intervals - 1);
        // The last instant goes with the last dynamics rows.
        let step = if t >= b.horizon - 1e-9 { b.intervals } else { interval };
        let base = BasePoint {
            reference: b.reference(t).map(T::of),
            weights: spline.basis(interval, t, 0).map(T::of),
            variable: std::array::from_fn(|i| b.curves.base[interval + i]),
            slot: [NONE; 4],
            interval: NONE,
            deviation_weights: [T::zero(); INNER_POINTS],
        };
        b.reach_instant(t, 0..b.curves.feet.len(), step, base);
    }
}

/// Base position (`first = 0`) or Euler angles (`first = 3`) at the knots.
pub(super) fn base_curve(task: &Task, layout: &Layout<f64>, x: &[f64], first: usize) -> Curve {
    let curves = &layout.curves;
    let (n, h) = (curves.intervals, curves.interval);
    let (spline, horizon) = (BSpline::new(n, h), n as f64 * h);
    let start = [task.base_start(), [0.; 3]].concat();
    let goal = [task.base_target, [0., 0., task.yaw_target]].concat();
    let nodes = (0..=n).map(|k| {
        let (t, interval) = (k as f64 * h, k.min(n - 1));
        let weights = [spline.basis(interval, t, 0), spline.basis(interval, t, 1)];
        std::array::from_fn(|i| {
            let (derivative, d) = (i / 3, first + i % 3);
            let rate = (goal[d] - start[d]) / horizon;
            let reference = if derivative == 0 { start[d] + rate * t } else { rate };
            reference + (0..4).map(|j| weights[derivative][j] * x[curves.base[interval + j] as usize + d]).sum::<f64>()
        })
    });
    Curve { poly_durations: vec![h; n], nodes: nodes.collect() }
}
