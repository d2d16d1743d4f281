//! The `towr` transcription: TOWR's rows \[3\] in variables that eliminate its linear equalities.
//!
//! The base is the C2 cubic spline that TOWR's acceleration rows enforce on its Hermite nodes.

use super::{Guess, ReachTime, SwingLaw, Transcribe, initial_guess};
use crate::gait::spline::{BSpline, hermite};
use crate::gait::trajectory::MotionLimits;
use crate::gait::{Curve, Phase};
use crate::nlp::builder::Builder;
use crate::nlp::problem::Curves;
use crate::real::Real;
use crate::robot::Robot;
use crate::rows::Family;
use crate::rows::blocks::Use;
use crate::rows::dynamics::DynamicsInstant;
use crate::rows::foot::StanceForce;
use crate::rows::momentum::INNER_POINTS;
use crate::rows::reach::ReachInstant;
use crate::rows::table::{NONE, Place, Span};
use crate::rows::turn::YAW;
use crate::settings::TranscriptionSettings;
use crate::task::Task;

/// Interval between base knots and dynamics rows, s.
pub const INTERVAL: f64 = 0.1;

/// Average swing duration that TOWR assumes for the mid-swing velocity, s.
pub const SWING_DURATION: f64 = 0.3;

/// Largest normal force of a foot in TOWR, N, for every robot.
pub const FORCE_LIMIT: f64 = 1000.;

/// Implementation of the `towr` transcription.
pub(super) struct Towr;

impl<T: Real> Transcribe<T> for Towr {
    fn steps(&self, intervals: usize) -> usize {
        intervals + 1
    }

    /// Adds the base coefficients as deviations from the reference line. The first two (start pose and rate) and the last (goal) are fixed.
    fn base_blocks(&self, b: &mut Builder<T>) {
        let spline = BSpline::new(b.intervals, b.interval);
        let count = spline.coefficients();
        let (start, rate) = (b.reference(0.), b.task.start.rate());
        let rise = initial_guess::final_base_height(b.task) - b.task.goal.position[2];
        for j in 0..count {
            let on_line = b.reference(spline.greville(j));
            let fixed = j < 2 || j == count - 1;
            let initial = if j < 2 {
                std::array::from_fn(|i| start[i] + rate[i] * spline.greville(j) - on_line[i])
            } else if j == count - 1 {
                [0.; 6]
            } else {
                [0., 0., spline.greville(j) / b.horizon * rise, 0., 0., 0.]
            };
            let id = b.block(fixed, initial, [0.; 6]);
            b.base.push(id);
        }
    }

    /// Adds Newton-Euler rows at every knot.
    fn dynamics(&self, b: &mut Builder<T>) {
        let spline = BSpline::new(b.intervals, b.interval);
        for k in 0..=b.intervals {
            let t = k as f64 * b.interval;
            // At a knot three of the four basis functions are nonzero: the first three of the interval that starts there.
            let (interval, skip) = if k < b.intervals { (k, 0) } else { (k - 1, 1) };
            let weights = std::array::from_fn(|derivative| {
                let basis = spline.basis(interval, t, derivative);
                std::array::from_fn(|i| T::of(basis[i + skip]))
            });
            let first = b.tables.stance_forces.len();
            let mut uses: Vec<Use> = b.base[k..k + 3].iter().map(|&id| Use::Touches(id)).collect();
            for foot in 0..b.feet.len() {
                let phase = b.feet[foot].phase_at(t);
                if b.feet[foot].phases[phase].stance {
                    let (force, of_force) = stance_force(b, foot, phase, t);
                    b.tables.stance_forces.push(force);
                    uses.extend(of_force);
                }
            }
            b.tables.dynamics_instants.push(DynamicsInstant {
                reference: b.reference(t).map(T::of),
                rate: b.reference_rate().map(T::of),
                weights,
                variable: [NONE; 3],
                column: [NONE; 3],
                forces: Span::added(first, &b.tables.stance_forces),
                place: Place::default(),
            });
            b.element(Family::Dynamics, k, k, &uses);
        }
    }

    /// Instants of all feet every `reach_interval` and at the end of the horizon.
    fn reach_times(&self, b: &Builder<T>) -> Vec<ReachTime<T>> {
        let spline = BSpline::new(b.intervals, b.interval);
        let every = b.settings.reach_interval;
        let mut times: Vec<f64> = (0..=(b.horizon / every + 1e-9) as usize).map(|i| i as f64 * every).collect();
        if b.horizon - times[times.len() - 1] > 1e-6 {
            times.push(b.horizon);
        }
        let time = |t: f64| {
            let t = t.min(b.horizon);
            let interval = ((t / b.interval + 1e-9) as usize).min(b.intervals - 1);
            // The instant at the end of the horizon belongs to the step of the last dynamics rows.
            let step = if t >= b.horizon - 1e-9 { b.intervals } else { interval };
            ReachTime {
                t,
                feet: 0..b.feet.len(),
                step,
                interval: NONE,
                weights: spline.basis(interval, t, 0).map(T::of),
                blocks: std::array::from_fn(|i| b.base[interval + i]),
                entry: ReachInstant { reference: b.reference(t).map(T::of), deviation_weights: [T::zero(); INNER_POINTS] },
            }
        };
        times.into_iter().map(time).collect()
    }

    fn foothold_smoothing(&self) -> f64 {
        0.
    }

    fn foothold(&self, b: &Builder<T>, foot: usize, stance: usize, stances: usize) -> [f64; 2] {
        initial_guess::foothold(b.task, foot, stance, stances)
    }

    /// Equal share of the weight among all feet.
    fn force(&self, _: &Builder<T>, _: f64) -> Guess {
        Guess { initial: [0., 0., 1., 0., 0., 0.], smoothing: [0.; 6] }
    }

    fn yaw(&self, b: &Builder<T>, t: f64) -> f64 {
        b.reference(t)[YAW]
    }

    fn slopes(&self, _: usize, _: usize) -> &'static [f64] {
        &[0.]
    }

    fn mid_time(&self, _: Phase) -> f64 {
        SWING_DURATION
    }

    fn swing(&self, _: &TranscriptionSettings, _: &Task, _: Phase) -> SwingLaw {
        SwingLaw {
            over: initial_guess::swing_height,
            above: 0.,
            parts: &[0.5],
            clearance: 0.,
            limited: false,
            longest_step: None,
            accelerations: None,
        }
    }

    fn limits(&self, _: &TranscriptionSettings, _: &Robot) -> Option<MotionLimits> {
        None
    }

    fn base_curves(&self, task: &Task, curves: &Curves, x: &[f64]) -> [Curve; 2] {
        [0, 3].map(|first| base_curve(task, curves, x, first))
    }
}

/// Weights of the force of a foot at time `t`, and the blocks of its nodes and of its foothold.
fn stance_force<T: Real>(b: &Builder<T>, foot: usize, phase: usize, t: f64) -> (StanceForce<T>, [Use; 3]) {
    let span = b.feet[foot].phases[phase];
    let (nodes, foothold) = (&b.feet[foot].force_nodes[phase / 2], b.feet[foot].footholds[phase / 2]);
    let pieces = b.settings.force_pieces();
    let duration = span.duration() / pieces as f64;
    let piece = (((t - span.start) / duration).max(0.) as usize).min(pieces - 1);
    let w = hermite(t - span.start - piece as f64 * duration, duration);
    let (value, slope) = (b.force_unit(), b.force_unit() / duration);
    let force = StanceForce {
        weights: [[T::of(w[0] * value), T::of(w[1] * slope)], [T::of(w[2] * value), T::of(w[3] * slope)]],
        node: [NONE; 2],
        node_column: [NONE; 2],
        foothold: foothold.index,
        foothold_column: NONE,
    };
    let [first, last] = [nodes[piece], nodes[piece + 1]].map(|node| node.map_or(Use::Nothing, Use::Touches));
    (force, [first, last, Use::Touches(foothold.block)])
}

/// Curve of base position (`first = 0`) or Euler angles (`first = 3`) with nodes at the knots.
fn base_curve(task: &Task, curves: &Curves, x: &[f64], first: usize) -> Curve {
    let (n, h) = (curves.intervals, curves.interval);
    let (spline, horizon) = (BSpline::new(n, h), n as f64 * h);
    let (start, goal) = (task.start.pose(), task.goal.pose());
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
