//! First guess of a candidate from the motion that was planned before.

use super::whole_turns;
use crate::gait::Trajectory;
use crate::gait::piece::{Piece, pieces};
use crate::gait::trajectory::SoleYaws;
use crate::nlp::Problem;
use crate::real::Real;
use crate::rows::table::NONE;
use crate::task::Task;
use nalgebra::Vector3;

/// Time in which the first guess returns from the measured state to the motion planned before, s.
const RETURN: f64 = 0.3;

/// Motion planned before, as polynomials.
pub(super) struct Before {
    base: [Vec<Piece>; 2],
    feet: Vec<[Vec<Piece>; 2]>,
    /// Moment and yaw of each sole.
    soles: Vec<Option<(Vec<Piece>, SoleYaws)>>,
    /// Time that has passed since its start, s.
    pub passed: f64,
    horizon: f64,
    /// Whole turns that are added to the yaw, rad.
    turns: f64,
}

impl Before {
    /// * `passed` - time that has passed since the start of the motion, s
    pub fn new(motion: &Trajectory, passed: f64) -> Before {
        Before {
            base: [&motion.base_lin, &motion.base_ang].map(pieces),
            feet: motion.ee.iter().map(|foot| [&foot.motion, &foot.force].map(pieces)).collect(),
            soles: (0..motion.ee.len()).map(|foot| Some((pieces(motion.ee[foot].moment.as_ref()?), motion.sole_yaws(foot)?))).collect(),
            passed,
            horizon: motion.horizon,
            turns: 0.,
        }
    }

    /// The motion with its yaw within half a turn of a measured one, rad.
    pub fn turned_to(self, yaw: f64) -> Before {
        let [pose, _] = self.base(0.);
        let turns = whole_turns(yaw - pose[5]);
        Before { turns: self.turns + turns, ..self }
    }

    /// Pose and rates of the base, `time` s after now.
    pub fn base(&self, time: f64) -> [[f64; 6]; 2] {
        let [[p, v], [a, w]] = self.base.each_ref().map(|curve| Piece::at(curve, self.passed + time));
        [[p.x, p.y, p.z, a.x, a.y, a.z + self.turns], [v.x, v.y, v.z, w.x, w.y, w.z]]
    }

    /// Position and velocity of a foot, `time` s after now.
    pub fn foot(&self, foot: usize, time: f64) -> [Vector3<f64>; 2] {
        Piece::at(&self.feet[foot][0], self.passed + time)
    }

    /// Yaw of a sole, `time` s after now; 0 for a ball or point.
    pub fn sole_yaw(&self, foot: usize, time: f64) -> f64 {
        self.soles[foot].as_ref().map_or(0., |(_, yaws)| yaws.at(self.passed + time) + self.turns)
    }

    /// True if the motion lasts until `time` s after now.
    fn covers(&self, time: f64) -> bool {
        self.passed + time <= self.horizon
    }

    /// Variables of a problem that starts now: those of this motion where it has them, and the initial values of the problem elsewhere.
    pub fn guess<T: Real>(&self, task: &Task, problem: &Problem<T>) -> Vec<f64> {
        let mut x: Vec<f64> = problem.initial.iter().map(|v| v.as_f64()).collect();
        let curves = &problem.curves;
        let (start, goal) = (task.start.pose(), task.goal.pose());
        let horizon = curves.intervals as f64 * curves.interval;
        let rate: [f64; 6] = std::array::from_fn(|i| (goal[i] - start[i]) / horizon);
        // The measured state less the planned one; it fades.
        let [pose, rates] = self.base(0.);
        let off: [[f64; 6]; 2] = [std::array::from_fn(|i| start[i] - pose[i]), std::array::from_fn(|i| task.start.rate()[i] - rates[i])];
        for (k, blocks) in curves.base.chunks_exact(2).enumerate() {
            let t = k as f64 * curves.interval;
            if !self.covers(t) {
                continue;
            }
            let [pose, rates] = self.base(t);
            let fade = (-t / RETURN).exp();
            for i in 0..6 {
                // off (1 + t / R) + off' t, times exp(-t / R): starts with the differences of value and slope.
                let value = pose[i] + fade * (off[0][i] * (1. + t / RETURN) + off[1][i] * t);
                let slope = rates[i] + fade * (off[1][i] * (1. - t / RETURN) - off[0][i] * t / (RETURN * RETURN));
                x[blocks[0] as usize + i] = value - start[i] - rate[i] * t;
                x[blocks[1] as usize + i] = slope - rate[i];
            }
        }
        for (foot, blocks) in curves.feet.iter().enumerate() {
            let [places, forces] = &self.feet[foot];
            for (i, span) in blocks.phases.iter().enumerate().step_by(2) {
                let middle = (span.start + span.end.max(span.start)) / 2.;
                let stood = |t: f64| Piece::at(forces, self.passed + t)[0].norm() > 0. && self.covers(t);
                if i > 0 && stood(middle) {
                    let [place, _] = Piece::at(places, self.passed + middle);
                    let at = blocks.footholds[i / 2] as usize;
                    (x[at], x[at + 1]) = (place.x, place.y);
                    if let Some(&yaw) = blocks.yaws.get(i / 2) {
                        x[yaw as usize] = self.sole_yaw(foot, middle);
                    }
                }
                let moments = blocks.moment_nodes.get(i / 2).zip(self.soles[foot].as_ref());
                let moments = moments.map(|(nodes, (moments, _))| (nodes, moments, curves.moment_unit));
                for (nodes, of, unit) in [(&blocks.force_nodes[i / 2], forces, curves.force_unit)].into_iter().chain(moments) {
                    let piece = span.duration() / (nodes.len() - 1) as f64;
                    for (n, &node) in nodes.iter().enumerate().filter(|(_, node)| **node != NONE) {
                        let t = span.start + piece * n as f64;
                        if !stood(t) {
                            continue;
                        }
                        let [value, slope] = Piece::at(of, self.passed + t);
                        for d in 0..3 {
                            x[node as usize + d] = value[d] / unit;
                            x[node as usize + 3 + d] = slope[d] * piece / unit;
                        }
                    }
                }
            }
        }
        // Fixed values follow the variables; a solve takes those of the problem.
        x.truncate(problem.variables);
        x
    }
}
