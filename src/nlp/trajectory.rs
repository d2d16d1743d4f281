//! Conversion of solver variables to curves with Hermite nodes, in the form that TOWR \[3\] uses.

use super::swing_curve::SwingCurve;
use super::{Curves, transcription};
use crate::gait::piece::SAME_TIME;
use crate::gait::spline::{hermite, hermite_rate};
use crate::gait::{Curve, FootCurves, Trajectory};
use crate::rows::table::NONE;
use crate::task::Task;

/// Converts a solution to a motion of Hermite pieces.
///
/// * `x` - as [`Problem::initial`](super::Problem::initial), fixed values included
pub fn trajectory(task: &Task, curves: &Curves, x: &[f64]) -> Trajectory {
    let horizon = curves.intervals as f64 * curves.interval;
    let base = transcription::of::<f64>(curves.transcription).base_curves(task, curves, x);
    let durations = curves.feet.iter().map(|f| f.phases.iter().map(|p| p.duration()).collect()).collect();
    let feet = 0..curves.feet.len();
    let feet = feet.map(|foot| {
        let blocks = &curves.feet[foot];
        let wrench = |nodes: &[Vec<u32>], unit: f64| wrench_curve(curves, x, foot, nodes, unit);
        let sole = !blocks.yaws.is_empty();
        FootCurves {
            motion: motion_curve(task, curves, x, foot),
            force: wrench(&blocks.force_nodes, curves.force_unit),
            moment: sole.then(|| wrench(&blocks.moment_nodes, curves.moment_unit)),
            yaws: sole.then(|| blocks.yaws.iter().map(|&at| x[at as usize]).collect()),
        }
    });
    let trajectory = task.trajectory(curves.transcription.name(), curves.force_limit, durations, horizon, base, feet.collect());
    Trajectory { limits: curves.limits, ..trajectory }
}

/// Motion of a foot: one piece per stance, two per swing, up to the horizon.
fn motion_curve(task: &Task, curves: &Curves, x: &[f64], foot: usize) -> Curve {
    let blocks = &curves.feet[foot];
    let foothold = |stance: usize| {
        let at = blocks.footholds[stance] as usize;
        let [px, py] = [x[at], x[at + 1]];
        [px, py, task.terrain.height(px, py)]
    };
    let mut curve = Curve { poly_durations: Vec::new(), nodes: Vec::new() };
    for (i, phase) in blocks.phases.iter().enumerate() {
        if phase.stance {
            let [px, py, pz] = foothold(i / 2);
            let node = [px, py, pz, 0., 0., 0.];
            curve.nodes.push(node);
            // A stance at an end of the horizon has no length if the foot is in the air there.
            if phase.duration() > 0. {
                curve.nodes.push(node);
                curve.poly_durations.push(phase.duration());
            }
            continue;
        }
        let own = transcription::of::<f64>(curves.transcription);
        let swing = SwingCurve::new(task, foot, i / 2, &blocks.phases, |span| own.mid_time(span));
        let (nodes, durations) = swing.pieces([foothold(i / 2), foothold(i / 2 + 1)], x[blocks.heights[i / 2] as usize]);
        if swing.started() {
            curve.nodes[0] = nodes[0];
        }
        curve.nodes.extend(&nodes[1..nodes.len() - 1]);
        curve.poly_durations.extend(durations);
    }
    end_at(&mut curve, curves.intervals as f64 * curves.interval);
    curve
}

/// Removes the part of a curve after `horizon`.
fn end_at(curve: &mut Curve, horizon: f64) {
    let mut end: f64 = curve.poly_durations.iter().sum();
    while let (Some(&duration), Some(&next)) = (curve.poly_durations.last(), curve.nodes.last()) {
        let over = end - horizon;
        if over < SAME_TIME {
            return;
        }
        curve.poly_durations.pop();
        curve.nodes.pop();
        end -= duration;
        let left = duration - over;
        if left > SAME_TIME {
            let before = curve.nodes[curve.nodes.len() - 1];
            let at = |w: [f64; 4], d: usize| w[0] * before[d] + w[1] * before[d + 3] + w[2] * next[d] + w[3] * next[d + 3];
            let (value, slope) = (hermite(left, duration), hermite_rate(left, duration));
            curve.nodes.push(std::array::from_fn(|i| if i < 3 { at(value, i) } else { at(slope, i - 3) }));
            curve.poly_durations.push(left);
            return;
        }
    }
}

/// Force or moment of a foot: the configured number of pieces per stance, one zero piece per swing, up to the horizon.
///
/// * `nodes` - of each stance, positions in `x`
/// * `unit` - of the values in `x`
fn wrench_curve(curves: &Curves, x: &[f64], foot: usize, nodes: &[Vec<u32>], unit: f64) -> Curve {
    let blocks = &curves.feet[foot];
    let horizon = curves.intervals as f64 * curves.interval;
    let mut curve = Curve { poly_durations: Vec::new(), nodes: Vec::new() };
    for (i, phase) in blocks.phases.iter().enumerate() {
        if !phase.stance {
            curve.poly_durations.push(phase.end.min(horizon) - phase.start);
            continue;
        }
        if phase.duration() <= 0. {
            curve.nodes.push([0.; 6]);
            continue;
        }
        let nodes = &nodes[i / 2];
        let duration = phase.duration() / (nodes.len() - 1) as f64;
        curve.poly_durations.extend(vec![duration; nodes.len() - 1]);
        curve.nodes.extend(nodes.iter().map(|&node| {
            if node == NONE {
                return [0.; 6];
            }
            let at = node as usize;
            std::array::from_fn(|d| x[at + d] * if d < 3 { unit } else { unit / duration })
        }));
    }
    curve
}
