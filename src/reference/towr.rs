//! TOWR's whole nonlinear program \[3\]: every node, row and bound, with fixed phase durations or with durations as variables.
//!
//! Nothing is eliminated, and nothing is shared with [`crate::nlp`] or [`crate::rows`], because this program serves as the reference for
//! their solver. Formulas that occur in both are repeated deliberately.

use super::curve::{Curve, Point, Timing};
use super::nlp::{INFINITY, Nlp, Rows, Variables};
use super::rigid_body::{Base, ZERO, contact_force, continuous_acceleration, dynamics, height, reach};
use crate::error::{Error, Result};
use crate::gait::{FootCurves, Schedule, Trajectory};
use crate::nlp::transcription;
use crate::robot::Robot;
use crate::settings::{Transcription, TranscriptionSettings};
use crate::task::Task;
use nalgebra::Vector3;

/// Duration of a base piece and interval between the dynamics rows, s.
const DYNAMICS_STEP: f64 = 0.1;
/// Interval between the reach rows, s.
const REACH_STEP: f64 = 0.08;
/// Number of force pieces per stance.
const FORCE_PIECES: usize = 3;
/// Number of motion pieces per swing.
const SWING_PIECES: usize = 2;
/// Swing duration by which the mid-swing velocities are computed, s.
const MEAN_SWING: f64 = 0.3;
/// Smallest sum of all durations of a foot except the last, s.
const LEAST_TOTAL: f64 = 0.1;
/// Smallest amount by which the sum of all durations of a foot except the last is below the horizon, s.
const TOTAL_MARGIN: f64 = 0.2;

/// Program of one schedule.
#[derive(Debug)]
pub struct Towr<'a> {
    task: &'a Task,
    horizon: f64,
    base: BaseCurves,
    feet: Vec<Foot>,
    variables: Variables,
}

/// Curves of the position and the Euler angles of the base.
#[derive(Debug)]
pub(super) struct BaseCurves {
    linear: Curve,
    angular: Curve,
    timing: Timing,
}

#[derive(Debug)]
struct Foot {
    motion: Curve,
    force: Curve,
    timing: Timing,
}

impl BaseCurves {
    /// Adds nodes every 0.1 s on a line from start to goal. Start pose, start velocity and goal pose are fixed.
    pub fn new(task: &Task, horizon: f64, variables: &mut Variables) -> BaseCurves {
        let full = ((horizon + 1e-10) / DYNAMICS_STEP) as usize;
        let mut durations = vec![DYNAMICS_STEP; full];
        let rest = horizon - full as f64 * DYNAMICS_STEP;
        if rest > 1e-9 {
            durations.push(rest);
        }
        let pieces = durations.len();
        let [gx, gy, _] = task.goal.position;
        // TOWR's initial height: straight legs above the ground at the goal.
        let high = task.terrain.height(gx, gy) - task.robot.nominal_feet[0][2];
        let goals = [task.goal.position, task.goal.angles];
        let guesses = [[gx, gy, high], goals[1]];
        let starts = [task.start.position, task.start.angles];
        let rates = [task.start.velocity, task.start.rates];
        let [linear, angular] = [0, 1].map(|which| {
            let (start, rate, goal, guess) = (starts[which], rates[which], goals[which], guesses[which]);
            let mut curve = Curve { nodes: Vec::new(), phases: (0..pieces).collect() };
            for node in 0..=pieces {
                let part = node as f64 / pieces as f64;
                curve.nodes.push(std::array::from_fn(|i| {
                    let (d, travel) = (i % 3, guess[i % 3] - start[i % 3]);
                    let variable = variables.free(if i < 3 { start[d] + part * travel } else { travel / horizon });
                    if node == 0 {
                        variables.fix(variable, if i < 3 { start[d] } else { rate[d] });
                    } else if node == pieces && i < 3 {
                        variables.fix(variable, goal[d]);
                    }
                    Some(variable)
                }));
            }
            curve
        });
        BaseCurves { linear, angular, timing: Timing::fixed(durations) }
    }

    /// State of the base at a time.
    pub fn at(&self, x: &[f64], time: f64) -> Base {
        let at = |curve: &Curve, order| curve.at(x, &self.timing, time, order);
        Base { position: at(&self.linear, 0), acceleration: at(&self.linear, 2), angles: [0, 1, 2].map(|order| at(&self.angular, order)) }
    }

    /// Pushes the rows of continuous acceleration at inner nodes.
    pub fn continuity_rows(&self, x: &[f64], rows: &mut Rows) {
        for curve in [&self.linear, &self.angular] {
            for (piece, pair) in self.timing.durations.windows(2).enumerate() {
                let before = curve.on_piece(x, piece, pair[0], pair[0], 2);
                let after = curve.on_piece(x, piece + 1, pair[1], 0., 2);
                continuous_acceleration(&before, &after, rows);
            }
        }
    }

    /// Pushes the rows of feet in their reach boxes at TOWR's instants.
    ///
    /// * `at` - position of a foot at a time
    pub fn reach_rows(&self, robot: &Robot, x: &[f64], horizon: f64, at: impl Fn(usize, f64) -> Point, rows: &mut Rows) {
        for time in instants(horizon, REACH_STEP) {
            let [position, angles] = [&self.linear, &self.angular].map(|curve| curve.at(x, &self.timing, time, 0));
            for foot in 0..robot.feet() {
                reach(robot, foot, &position, &angles, &at(foot, time), rows);
            }
        }
    }

    /// Curves as in trajectory files: position, then angles.
    pub fn curves(&self, x: &[f64]) -> [crate::gait::Curve; 2] {
        [&self.linear, &self.angular].map(|curve| nodes_at(curve, &self.timing, x))
    }
}

/// Curve of a trajectory file, with the node values at `x`.
pub(super) fn nodes_at(curve: &Curve, timing: &Timing, x: &[f64]) -> crate::gait::Curve {
    crate::gait::Curve { poly_durations: curve.piece_durations(timing), nodes: (0..curve.nodes.len()).map(|n| curve.node(n, x)).collect() }
}

/// Instants 0, step, 2 step, ... and the horizon. As in TOWR, a horizon that is a multiple of the step occurs twice.
fn instants(horizon: f64, step: f64) -> impl Iterator<Item = f64> {
    let full = (horizon / step).floor() as usize;
    (0..=full).map(move |i| i as f64 * step).chain([horizon])
}

/// Largest normal force of a foot in a reference program, N.
pub(super) fn force_limit(task: &Task) -> f64 {
    transcription::force_limit(&TranscriptionSettings::of(Transcription::Towr), task)
}

impl<'a> Towr<'a> {
    /// Program with the durations of a schedule, whose feet must end at the same time.
    pub fn fixed(task: &'a Task, schedule: &Schedule) -> Towr<'a> {
        Towr::new(task, schedule, None)
    }

    /// Program with durations as variables within `limits`, s, starting from those of a schedule.
    pub fn free(task: &'a Task, schedule: &Schedule, limits: [f64; 2]) -> Towr<'a> {
        Towr::new(task, schedule, Some(limits))
    }

    fn new(task: &'a Task, schedule: &Schedule, limits: Option<[f64; 2]>) -> Towr<'a> {
        let horizon = schedule.horizon();
        let mut variables = Variables::default();
        let base = BaseCurves::new(task, horizon, &mut variables);
        let mut feet = Vec::new();
        for (foot, durations) in schedule.durations().iter().enumerate() {
            let motion = motion(task, foot, durations.len(), horizon, &mut variables);
            let force = force(task, durations.len(), &mut variables);
            let mut timing = Timing::fixed(durations.clone());
            if let (Some(limits), [free @ .., _]) = (limits, durations.as_slice()) {
                timing.variables = free.iter().map(|&duration| variables.bounded(duration, limits)).collect();
            }
            feet.push(Foot { motion, force, timing });
        }
        Towr { task, horizon, base, feet, variables }
    }

    /// Point of the program that represents the curves of a trajectory, as an initial point or to check it.
    ///
    /// # Errors
    /// [`Error::Invalid`] if a curve has a different number of nodes.
    pub fn point(&self, trajectory: &Trajectory) -> Result<Vec<f64>> {
        let mut x = self.variables.initial.clone();
        let mut take = |name: &str, curve: &Curve, nodes: &[[f64; 6]]| {
            if curve.nodes.len() != nodes.len() {
                return Err(Error::invalid(
                    format!("{name}.nodes"),
                    format!("{} nodes", nodes.len()),
                    format!("{} nodes", curve.nodes.len()),
                ));
            }
            for (variables, values) in curve.nodes.iter().zip(nodes) {
                for (variable, value) in variables.iter().zip(values) {
                    if let Some(variable) = *variable {
                        x[variable] = *value;
                    }
                }
            }
            Ok(())
        };
        take("base_lin", &self.base.linear, &trajectory.base_lin.nodes)?;
        take("base_ang", &self.base.angular, &trajectory.base_ang.nodes)?;
        if trajectory.ee.len() != self.feet.len() {
            return Err(Error::invalid("ee", format!("{} feet", trajectory.ee.len()), format!("{} feet", self.feet.len())));
        }
        for (i, (foot, curves)) in self.feet.iter().zip(&trajectory.ee).enumerate() {
            take(&format!("ee[{i}].motion"), &foot.motion, &curves.motion.nodes)?;
            take(&format!("ee[{i}].force"), &foot.force, &curves.force.nodes)?;
        }
        for (foot, durations) in self.feet.iter().zip(&trajectory.durations) {
            for (&variable, &duration) in foot.timing.variables.iter().zip(durations) {
                x[variable] = duration;
            }
        }
        Ok(x)
    }

    /// Trajectory at `x`.
    pub fn trajectory(&self, x: &[f64]) -> Trajectory {
        let timings: Vec<Timing> = self.feet.iter().map(|foot| foot.timing.at(x)).collect();
        let feet = self.feet.iter().zip(&timings);
        let ee = feet.map(|(foot, timing)| FootCurves::new(nodes_at(&foot.motion, timing, x), nodes_at(&foot.force, timing, x)));
        let ee = ee.collect();
        let durations = timings.into_iter().map(|timing| timing.durations).collect();
        self.task.trajectory(Transcription::Towr.name(), force_limit(self.task), durations, self.horizon, self.base.curves(x), ee)
    }
}

/// Nodes of a foot's motion. The two nodes of a stance share one position; the middle node of a swing has zero vertical velocity.
fn motion(task: &Task, foot: usize, phases: usize, horizon: f64, variables: &mut Variables) -> Curve {
    let mut curve = Curve::default();
    let nodes = (phases.div_ceil(2) + SWING_PIECES * (phases / 2)) + 1;
    let [sx, sy] = task.foothold_start(foot);
    let [gx, gy] = task.foothold_goal(foot);
    let start = Vector3::new(sx, sy, task.terrain.height(sx, sy));
    let goal = Vector3::new(gx, gy, task.terrain.height(gx, gy));
    let guess = |node: usize| start + (goal - start) * (node as f64 / (nodes - 1) as f64);
    let mean_velocity = (goal - start) / horizon;
    for phase in 0..phases {
        if phase % 2 == 0 {
            // The initial position of a stance is that of its second node.
            let place = guess(curve.nodes.len() + 1);
            let at: [usize; 3] = std::array::from_fn(|d| variables.free(place[d]));
            if phase == 0 {
                for d in 0..3 {
                    variables.fix(at[d], start[d]);
                }
            }
            curve.nodes.extend([[Some(at[0]), Some(at[1]), Some(at[2]), None, None, None]; 2]);
            curve.phases.push(phase);
        } else {
            let place = guess(curve.nodes.len());
            let [x, y, z] = std::array::from_fn(|d| variables.free(place[d]));
            let [vx, vy] = std::array::from_fn(|d| variables.free(mean_velocity[d]));
            curve.nodes.push([Some(x), Some(y), Some(z), Some(vx), Some(vy), None]);
            curve.phases.extend([phase; SWING_PIECES]);
        }
    }
    curve
}

/// Nodes of a foot's force, which is zero at both ends of a swing and free elsewhere.
fn force(task: &Task, phases: usize, variables: &mut Variables) -> Curve {
    let mut curve = Curve::default();
    let share = task.robot.weight() / task.robot.feet() as f64;
    for phase in 0..phases {
        if phase % 2 == 1 {
            curve.phases.push(phase);
            continue;
        }
        for node in 0..=FORCE_PIECES {
            let in_swing = (node == 0 && phase > 0) || (node == FORCE_PIECES && phase + 1 < phases);
            let node = std::array::from_fn(|i| (!in_swing).then(|| variables.free(if i == 2 { share } else { 0. })));
            curve.nodes.push(node);
        }
        curve.phases.extend([phase; FORCE_PIECES]);
    }
    curve
}

impl Nlp for Towr<'_> {
    fn variables(&self) -> &Variables {
        &self.variables
    }

    fn rows(&self, x: &[f64], rows: &mut Rows) {
        let (robot, terrain) = (&*self.task.robot, &*self.task.terrain);
        let timings: Vec<Timing> = self.feet.iter().map(|foot| foot.timing.at(x)).collect();
        for time in instants(self.horizon, DYNAMICS_STEP) {
            let feet = self.feet.iter().zip(&timings);
            let feet: Vec<(Point, Point)> =
                feet.map(|(foot, timing)| (foot.motion.at(x, timing, time, 0), foot.force.at(x, timing, time, 0))).collect();
            dynamics(robot, &self.base.at(x, time), &feet, rows);
        }
        self.base.continuity_rows(x, rows);
        let at = |foot: usize, time| self.feet[foot].motion.at(x, &timings[foot], time, 0);
        self.base.reach_rows(robot, x, self.horizon, at, rows);
        for (foot, timing) in self.feet.iter().zip(&timings) {
            self.force_rows(foot, x, rows);
            // The first node is the start position, which is fixed.
            for node in 1..foot.motion.nodes.len() {
                let limits = if swings(&foot.motion, node) { [0., INFINITY] } else { ZERO };
                height(terrain, &foot.motion.node_point(node, x, false), limits, rows);
            }
            swing_rows(foot, x, rows);
            if let Some(&first) = timing.variables.first() {
                let total: f64 = timing.variables.iter().map(|&v| x[v]).sum();
                rows.row(total, [LEAST_TOTAL, self.horizon - TOTAL_MARGIN]);
                (first..first + timing.variables.len()).for_each(|variable| rows.entry(variable, 1.));
            }
        }
    }
}

impl Towr<'_> {
    /// Pushes friction and normal force at every force node that is not zero by construction, with the foothold of its phase.
    fn force_rows(&self, foot: &Foot, x: &[f64], rows: &mut Rows) {
        for (node, values) in foot.force.nodes.iter().enumerate() {
            if values[0].is_none() {
                continue;
            }
            // A free node has stance on both sides.
            let phase = foot.force.phases[node.min(foot.force.phases.len() - 1)];
            let stance = foot.motion.phases.partition_point(|&p| p < phase);
            let at = foot.motion.node_point(stance, x, false);
            contact_force(&self.task.terrain, force_limit(self.task), &foot.force.node_point(node, x, false), &at, rows);
        }
    }
}

/// True if a motion node is in the middle of a swing.
fn swings(motion: &Curve, node: usize) -> bool {
    motion.nodes[node][3].is_some()
}

/// Pushes the rows of mid-swing nodes: halfway between the footholds, with the velocity of their distance over [`MEAN_SWING`].
fn swing_rows(foot: &Foot, x: &[f64], rows: &mut Rows) {
    let motion = &foot.motion;
    for node in (0..motion.nodes.len()).filter(|&node| swings(motion, node)) {
        let [before, at, after] = [node - 1, node, node + 1].map(|n| motion.node_point(n, x, false));
        let velocity = motion.node_point(node, x, true);
        for d in 0..2 {
            rows.row(at.value[d] - (before.value[d] + after.value[d]) / 2., ZERO);
            at.push_axis(d, 1., rows);
            before.push_axis(d, -0.5, rows);
            after.push_axis(d, -0.5, rows);
            rows.row(velocity.value[d] - (after.value[d] - before.value[d]) / MEAN_SWING, ZERO);
            velocity.push_axis(d, 1., rows);
            after.push_axis(d, -1. / MEAN_SWING, rows);
            before.push_axis(d, 1. / MEAN_SWING, rows);
        }
    }
}
