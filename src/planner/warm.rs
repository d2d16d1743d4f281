//! First guess of a candidate from a motion that was planned before.
//!
//! The base keeps its times. The feet keep their phases: a stance gets the forces and the foothold of the stance of the same rank before,
//! stretched to its duration. What that motion does not contain has its initial values.

use super::Cycle;
use crate::gait::piece::{Piece, pieces};
use crate::gait::schedule::phases_of;
use crate::gait::{Phase, Trajectory};
use crate::nlp::Problem;
use crate::real::Real;
use crate::rows::table::NONE;
use crate::task::Task;
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Time in which the first guess returns from the measured state to the motion planned before, s.
const RETURN: f64 = 0.3;

/// Motion planned before, as polynomials.
pub(super) struct Before {
    base: [Vec<Piece>; 2],
    feet: Vec<[Vec<Piece>; 2]>,
    /// Phases of each foot, s after the start of the motion. The last ones last as long as the gait has them, also beyond the end.
    phases: Vec<Vec<Phase>>,
    gait: Cycle,
    /// Time that has passed since its start, s.
    pub passed: f64,
    horizon: f64,
    /// Whole turns that are added to the yaw, rad.
    turns: f64,
}

impl Before {
    /// * `gait` - of the motion
    /// * `passed` - time that has passed since the start of the motion, s
    pub fn new(motion: &Trajectory, gait: Cycle, passed: f64) -> Before {
        let whole = |durations: &Vec<f64>| {
            let mut phases = phases_of(durations);
            if let [_, .., last] = &mut phases[..] {
                last.end = last.end.max(last.start + if gait.family.is_some() { gait.stance } else { 0. });
            }
            phases
        };
        Before {
            base: [&motion.base_lin, &motion.base_ang].map(pieces),
            feet: motion.ee.iter().map(|foot| [&foot.motion, &foot.force].map(pieces)).collect(),
            phases: motion.durations.iter().map(whole).collect(),
            gait,
            passed,
            horizon: motion.horizon,
            turns: 0.,
        }
    }

    /// The motion with its yaw within half a turn of a measured one, rad.
    pub fn turned_to(self, yaw: f64) -> Before {
        let [pose, _] = self.base(0.);
        let turns = ((yaw - pose[5]) / TAU).round() * TAU;
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

    /// True if the motion lasts until `time` s after now.
    fn covers(&self, time: f64) -> bool {
        self.passed + time <= self.horizon
    }

    /// Force on a foot and its slope, `time` s after now; `None` in the air and after the motion.
    fn force(&self, foot: usize, time: f64) -> Option<[Vector3<f64>; 2]> {
        let force = Piece::at(&self.feet[foot][1], self.passed + time);
        (self.covers(time) && force[0].norm() > 0.).then_some(force)
    }

    /// Variables of a problem that starts now: those of this motion where it has them, and the initial values of the problem elsewhere.
    ///
    /// * `gait` - of the problem
    pub fn guess<T: Real>(&self, task: &Task, gait: &Cycle, problem: &Problem<T>) -> Vec<f64> {
        let mut x: Vec<f64> = problem.initial.iter().map(|v| v.as_f64()).collect();
        self.guess_base(task, problem, &mut x);
        for foot in 0..self.feet.len() {
            self.guess_foot(task, gait, problem, foot, &mut x);
        }
        // Fixed values follow the variables; a solve takes those of the problem.
        x.truncate(problem.variables);
        x
    }

    fn guess_base<T: Real>(&self, task: &Task, problem: &Problem<T>, x: &mut [f64]) {
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
    }

    fn guess_foot<T: Real>(&self, task: &Task, gait: &Cycle, problem: &Problem<T>, foot: usize, x: &mut [f64]) {
        let (curves, blocks) = (&problem.curves, &problem.curves.feet[foot]);
        let first = usize::from(blocks.phases[0].duration() <= 0.);
        let ranks = self.ranks(foot, first);
        // Forces of a gait whose feet stand for a larger part of the time are smaller.
        let duty = |gait: &Cycle| gait.stance / gait.period();
        let cyclic = gait.family.is_some() && self.gait.family.is_some();
        let less = if cyclic { duty(&self.gait) / duty(gait) } else { 1. };
        let scale = less / curves.force_unit;
        for (i, &span) in blocks.phases.iter().enumerate().step_by(2) {
            let old = i.checked_add_signed(ranks).and_then(|rank| self.phase(foot, rank));
            let Some(old) = old.filter(|old| self.covers(old.start)) else { continue };
            if i > 0 {
                let place = self.foothold(task, foot, old, span.start + gait.stance / 2.);
                let at = blocks.footholds[i / 2] as usize;
                (x[at], x[at + 1]) = (place.x, place.y);
            }
            let from = if i == first { old.start.max(0.) } else { old.start };
            let last = i + 1 == blocks.phases.len();
            let whole = if last && cyclic && i > 0 { span.duration().max(gait.stance) } else { span.duration() };
            let stretch = if last && i == first { 1. } else { (old.end - from).max(0.) / whole };
            let nodes = &blocks.force_nodes[i / 2];
            let piece = span.duration() / (nodes.len() - 1) as f64;
            for (n, &node) in nodes.iter().enumerate().filter(|(_, node)| **node != NONE) {
                let Some([value, slope]) = self.force(foot, from + stretch * piece * n as f64) else { continue };
                for d in 0..3 {
                    x[node as usize + d] = value[d] * scale;
                    x[node as usize + 3 + d] = slope[d] * stretch * piece * scale;
                }
            }
        }
    }

    /// Rank of the present phase of a foot less its rank in a problem, in which it is `first`; even, so that stances match stances.
    fn ranks(&self, foot: usize, first: usize) -> isize {
        let phases = &self.phases[foot];
        let present = phases.iter().position(|phase| phase.end > self.passed + 1e-9).unwrap_or(phases.len() - 1);
        match (present % 2, first) {
            // Early touchdown: its stance has begun.
            (1, 0) => present as isize + 1,
            // Late touchdown: the stance before comes later.
            (0, 1) => present as isize - 2,
            _ => present as isize - first as isize,
        }
    }

    /// Phase of a foot in the motion, s after now.
    fn phase(&self, foot: usize, rank: usize) -> Option<Phase> {
        let phase = *self.phases[foot].get(rank)?;
        Some(Phase { start: phase.start - self.passed, end: phase.end - self.passed, ..phase })
    }

    /// Foothold of a stance, moved as the base moves between the middles of the old stance and of the new one.
    fn foothold(&self, task: &Task, foot: usize, old: Phase, middle: f64) -> Vector3<f64> {
        let [place, _] = self.foot(foot, (old.start + old.end.min(self.horizon - self.passed)) / 2.);
        let later = middle - (old.start + self.gait.stance / 2.);
        let [vx, vy, _, _, _, turn] = task.goal.rate();
        let [x, y, _] = task.start.position;
        place + Vector3::new(vx - turn * (place.y - y), vy + turn * (place.x - x), 0.) * later
    }
}
