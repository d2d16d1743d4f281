//! Contact-implicit program without a schedule: complementarity decides where contact forces act.
//!
//! Base, dynamics, reach and friction are those of TOWR. The feet have a position, a velocity and a force at knots every [`STEP`]. The
//! complementarity and its relaxation, which is tightened from solve to solve, are those of \[5\]. For height `z` above the ground, force
//! `f` and the motion `x` around a knot:
//!
//! ```text
//! f_z >= 0,  z >= 0,  f_z z <= epsilon,  |f_z dx| <= epsilon to both neighbours,  |f_z v| <= epsilon there and here
//! ```
//!
//! A foot with a force at a knot therefore stands through both adjacent intervals, and a solution without relaxation is a schedule. The
//! last solve fixes the contacts found so far and satisfies them exactly. Feet stand in the first and in the last interval, as in the
//! phase-based programs.

use super::curve::{Curve, Point, Timing};
use super::nlp::{INFINITY, Nlp, Rows, Variables};
use super::rigid_body::{ZERO, contact_force, dynamics, height};
use super::towr::{self, BaseCurves, nodes_at};
use crate::gait::{FootCurves, Trajectory};
use crate::task::Task;

/// Interval between the knots, s.
pub const STEP: f64 = 0.1;
/// Relaxations of the complementarity, one per solve, in body weights times m and body weights times m/s.
pub const RELAXATIONS: [f64; 4] = [1e-1, 1e-2, 1e-3, 1e-4];
/// Smallest vertical force that counts as contact, in body weights.
const CONTACT: f64 = 1e-2;
/// Largest motion in an interval, and height, at which a foot counts as standing, m.
const STILL: f64 = 1e-3;

/// Formulation of the contacts.
#[derive(Debug, Clone, PartialEq)]
pub enum Contacts {
    /// Complementarity with this relaxation.
    Relaxed(f64),
    /// Given contacts: true if the foot stands in the interval, `[feet][intervals]`.
    Given(Vec<Vec<bool>>),
}

impl Contacts {
    /// True if a foot must stand in an interval: as given, or in the first and the last one.
    fn stands(&self, foot: usize, interval: usize, steps: usize) -> bool {
        match self {
            Contacts::Relaxed(_) => interval == 0 || interval + 1 == steps,
            Contacts::Given(stands) => stands[foot][interval],
        }
    }

    /// Result of [`Contacts::stands`] for the intervals before and after a knot; at both ends the only interval counts twice.
    fn around(&self, foot: usize, knot: usize, steps: usize) -> [bool; 2] {
        [knot.saturating_sub(1), knot.min(steps - 1)].map(|interval| self.stands(foot, interval, steps))
    }
}

/// Contact-implicit program of a task.
#[derive(Debug)]
pub struct ContactImplicit<'a> {
    task: &'a Task,
    steps: usize,
    contacts: Contacts,
    base: BaseCurves,
    feet: Vec<Foot>,
    timing: Timing,
    variables: Variables,
}

#[derive(Debug)]
struct Foot {
    motion: Curve,
    force: Curve,
}

impl<'a> ContactImplicit<'a> {
    /// Creates the program.
    ///
    /// * `horizon` - s, rounded to at least three whole steps
    pub fn new(task: &'a Task, horizon: f64, contacts: Contacts) -> ContactImplicit<'a> {
        let steps = ((horizon / STEP).round() as usize).max(3);
        let horizon = steps as f64 * STEP;
        let mut variables = Variables::default();
        let base = BaseCurves::new(task, horizon, &mut variables);
        let share = task.robot.weight() / task.robot.feet() as f64;
        let mut feet = Vec::new();
        for foot in 0..task.robot.feet() {
            let [sx, sy] = task.foothold_start(foot);
            let [gx, gy] = task.foothold_goal(foot);
            let ground = |x: f64, y: f64| [x, y, task.terrain.height(x, y)];
            let curve = || Curve { nodes: Vec::new(), phases: (0..steps).collect() };
            let (mut motion, mut force) = (curve(), curve());
            for knot in 0..=steps {
                let part = knot as f64 / steps as f64;
                let at = ground(sx + part * (gx - sx), sy + part * (gy - sy));
                let position: [usize; 3] = std::array::from_fn(|d| variables.free(at[d]));
                let velocity: [usize; 3] = std::array::from_fn(|_| variables.free(0.));
                let forces: [usize; 3] = std::array::from_fn(|d| variables.free(if d == 2 { share } else { 0. }));
                let [before, after] = contacts.around(foot, knot, steps);
                if knot == 0 {
                    (0..3).for_each(|d| variables.fix(position[d], at[d]));
                }
                if before || after {
                    velocity.iter().for_each(|&v| variables.fix(v, 0.));
                }
                if matches!(contacts, Contacts::Given(_)) && !(before && after) {
                    forces.iter().for_each(|&f| variables.fix(f, 0.));
                }
                let some = |v: [usize; 3]| v.map(Some);
                let ([x, y, z], [vx, vy, vz], [fx, fy, fz]) = (some(position), some(velocity), some(forces));
                motion.nodes.push([x, y, z, vx, vy, vz]);
                // Zero slope at the knots: between two knots a force stays between their values.
                force.nodes.push([fx, fy, fz, None, None, None]);
            }
            feet.push(Foot { motion, force });
        }
        let timing = Timing::fixed(vec![STEP; steps]);
        ContactImplicit { task, steps, contacts, base, feet, timing, variables }
    }

    /// Contacts `[feet][intervals]`, as given or as they are at `x`. There a foot stands if it carries a force at either end of the
    /// interval, or does not move and is on the ground.
    pub fn contacts(&self, x: &[f64]) -> Vec<Vec<bool>> {
        if let Contacts::Given(stands) = &self.contacts {
            return stands.clone();
        }
        let stands = |foot: &Foot, interval: usize| {
            let [a, b] = [interval, interval + 1].map(|knot| foot.motion.node(knot, x));
            let carries = [interval, interval + 1].into_iter().any(|k| foot.force.node(k, x)[2] > CONTACT * self.task.robot.weight());
            let moves = (0..3).map(|d| (b[d] - a[d]).abs()).fold(0., f64::max);
            let high = a[2] - self.task.terrain.height(a[0], a[1]);
            carries || (moves < STILL && high < STILL)
        };
        let feet = self.feet.iter().enumerate();
        let held = |foot, interval| self.contacts.stands(foot, interval, self.steps);
        feet.map(|(i, foot)| (0..self.steps).map(|interval| held(i, interval) || stands(foot, interval)).collect()).collect()
    }

    /// Trajectory at `x` with the contacts found there.
    pub fn trajectory(&self, x: &[f64]) -> Trajectory {
        let curves = |foot: &Foot| FootCurves::new(nodes_at(&foot.motion, &self.timing, x), nodes_at(&foot.force, &self.timing, x));
        let durations = self.contacts(x).iter().map(|stands| phases(stands)).collect();
        let ee = self.feet.iter().map(curves).collect();
        self.task.trajectory("contact-implicit", towr::force_limit(self.task), durations, self.steps as f64 * STEP, self.base.curves(x), ee)
    }

    /// Pushes the rows of the contacts: complementarity, or standing feet if the contacts are given.
    fn contact_rows(&self, foot: usize, x: &[f64], rows: &mut Rows) {
        let terrain = &self.task.terrain;
        let Foot { motion, force } = &self.feet[foot];
        let place = |knot: usize| motion.node_point(knot, x, false);
        for interval in 0..self.steps {
            if self.contacts.stands(foot, interval, self.steps) {
                let (a, b) = (place(interval), place(interval + 1));
                for d in 0..3 {
                    rows.row(b.value[d] - a.value[d], ZERO);
                    b.push_axis(d, 1., rows);
                    a.push_axis(d, -1., rows);
                }
            }
        }
        for knot in 0..=self.steps {
            let at = place(knot);
            let [before, after] = self.contacts.around(foot, knot, self.steps);
            // The first knot is fixed.
            if knot > 0 {
                height(terrain, &at, if before || after { ZERO } else { [0., INFINITY] }, rows);
            }
            let Contacts::Relaxed(epsilon) = self.contacts else { continue };
            let load = force.node_point(knot, x, false);
            let weights = load.value.z / self.task.robot.weight();
            let mut product = |value: f64, limits, by: &mut dyn FnMut(&mut Rows, f64)| {
                rows.row(weights * value, limits);
                load.push_axis(2, value / self.task.robot.weight(), rows);
                by(rows, weights);
            };
            let ground = terrain.ground(at.value.x, at.value.y);
            product(at.value.z - ground.height, [-INFINITY, epsilon], &mut |rows, weights| {
                for (d, slope) in [-ground.slope[0], -ground.slope[1], 1.].into_iter().enumerate() {
                    at.push_axis(d, weights * slope, rows);
                }
            });
            let neighbours = knot.saturating_sub(1)..=(knot + 1).min(self.steps);
            for other in neighbours {
                let velocity = motion.node_point(other, x, true);
                let there = place(other);
                for d in 0..3 {
                    product(velocity.value[d], [-epsilon, epsilon], &mut |rows, weights| velocity.push_axis(d, weights, rows));
                    if other != knot {
                        product(there.value[d] - at.value[d], [-epsilon, epsilon], &mut |rows, weights| {
                            there.push_axis(d, weights, rows);
                            at.push_axis(d, -weights, rows);
                        });
                    }
                }
            }
        }
    }
}

/// Durations of the phases of a foot, s, from its contact in each interval. The foot stands in the first and the last interval.
fn phases(stands: &[bool]) -> Vec<f64> {
    stands.chunk_by(|a, b| a == b).map(|phase| phase.len() as f64 * STEP).collect()
}

impl Nlp for ContactImplicit<'_> {
    fn variables(&self) -> &Variables {
        &self.variables
    }

    fn rows(&self, x: &[f64], rows: &mut Rows) {
        let (robot, terrain) = (&*self.task.robot, &*self.task.terrain);
        for knot in 0..=self.steps {
            let feet: Vec<(Point, Point)> =
                self.feet.iter().map(|foot| (foot.motion.node_point(knot, x, false), foot.force.node_point(knot, x, false))).collect();
            dynamics(robot, &self.base.at(x, knot as f64 * STEP), &feet, rows);
        }
        self.base.continuity_rows(x, rows);
        let at = |foot: usize, time| self.feet[foot].motion.at(x, &self.timing, time, 0);
        self.base.reach_rows(robot, x, self.steps as f64 * STEP, at, rows);
        for (foot, curves) in self.feet.iter().enumerate() {
            for knot in 0..=self.steps {
                let (force, at) = (curves.force.node_point(knot, x, false), curves.motion.node_point(knot, x, false));
                contact_force(terrain, towr::force_limit(self.task), &force, &at, rows);
            }
            self.contact_rows(foot, x, rows);
        }
    }
}
