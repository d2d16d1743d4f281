//! Conversion of solver variables to curves with Hermite nodes, in the form that TOWR \[3\] uses.

use super::{Curves, transcription};
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
    let feet = feet.map(|foot| FootCurves { motion: motion_curve(task, curves, x, foot), force: force_curve(curves, x, foot) });
    let trajectory = task.trajectory(curves.transcription.name(), curves.force_limit, durations, horizon, base, feet.collect());
    Trajectory { limits: curves.limits, ..trajectory }
}

/// Motion of a foot: one piece per stance, two per swing.
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
            curve.nodes.extend([[px, py, pz, 0., 0., 0.]; 2]);
            curve.poly_durations.push(phase.duration());
        } else {
            let (a, b) = (foothold(i / 2), foothold(i / 2 + 1));
            let z = x[blocks.heights[i / 2] as usize];
            let mid = |d: usize| (a[d] + b[d]) / 2.;
            let time = transcription::of::<f64>(curves.transcription).mid_time(*phase);
            let speed = |d: usize| (b[d] - a[d]) / time;
            curve.nodes.push([mid(0), mid(1), z, speed(0), speed(1), 0.]);
            curve.poly_durations.extend([phase.duration() / 2.; 2]);
        }
    }
    curve
}

/// Force of a foot: the configured number of pieces per stance, one zero piece per swing.
fn force_curve(curves: &Curves, x: &[f64], foot: usize) -> Curve {
    let blocks = &curves.feet[foot];
    let unit = curves.force_unit;
    let mut curve = Curve { poly_durations: Vec::new(), nodes: Vec::new() };
    for (i, phase) in blocks.phases.iter().enumerate() {
        if !phase.stance {
            curve.poly_durations.push(phase.duration());
            continue;
        }
        let nodes = &blocks.force_nodes[i / 2];
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
