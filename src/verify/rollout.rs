//! What really happens under the planned forces: the rigid body in f64 from its state, with forces and footholds as planned and nothing else, and
//! compared with the planned base. Between two times at which a curve has a node or a contact changes all but its attitude is known in closed form.

use super::dense::{Extreme, Motion, readable};
use super::exact::turning;
use super::stretch::{Body, Stretch, greatest_of_cubic};
use crate::robot::GRAVITY;
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use std::fmt;

/// Longest step, s. Over motions of six seconds attitudes are then within 1e-7 rad.
const STEP: f64 = 0.02;
/// Distance of the times at which a report looks at most, s.
const LOOK: f64 = 0.01;
/// How often a step is halved to see whether limits hold within it.
const HALVINGS: u32 = 7;

/// How far the integrated motion strays from the plan.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RolloutReport {
    /// Distance of the base from its plan, m.
    pub position: Extreme,
    /// Angle of the rotation between the base and its plan, degrees.
    pub attitude: Extreme,
}

impl fmt::Display for RolloutReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for (name, extreme, unit) in [("position", self.position, "m"), ("attitude", self.attitude, "deg")] {
            writeln!(f, "{name:<18}{:>10} {unit:<6} at {:.3} s", readable(extreme.value), extreme.time)?;
        }
        Ok(())
    }
}

/// Follows bodies along a plan.
pub(super) struct Rollout<'a> {
    motion: &'a Motion<'a>,
    inverse_inertia: Matrix3<f64>,
    /// Times at which a curve has a node or a contact changes, ascending.
    nodes: Vec<f64>,
}

/// A body before and after a step of a stretch.
struct Step<'a> {
    stretch: &'a Stretch,
    before: &'a Body,
    after: &'a Body,
    /// Start of the stretch, s.
    origin: f64,
    /// Start of the step since then, s.
    since: f64,
    /// Its length, s.
    length: f64,
    /// How often it was halved.
    halved: u32,
}

impl Step<'_> {
    /// When it starts, s.
    fn start(&self) -> f64 {
        self.origin + self.since
    }

    /// When it ends, s.
    fn end(&self) -> f64 {
        self.start() + self.length
    }
}

impl<'a> Rollout<'a> {
    /// None when the inertia has no inverse.
    pub fn new(motion: &'a Motion<'a>) -> Option<Self> {
        let mut nodes: Vec<f64> = motion.base_lin.times.iter().chain(&motion.base_ang.times).copied().collect();
        for foot in &motion.feet {
            // Where a swinging foot is does not matter.
            let standing = foot.motion.times.iter().filter(|&&time| foot.foothold(time).is_some());
            nodes.extend(standing.chain(&foot.force.times).chain(&foot.switches));
        }
        nodes.sort_by(f64::total_cmp);
        nodes.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
        Some(Rollout { motion, inverse_inertia: motion.inertia().try_inverse()?, nodes })
    }

    /// The body at `end`, from `body` at `start`.
    pub fn run(&self, body: Body, start: f64, end: f64) -> Body {
        self.steps(body, start, end, STEP, |_| true)
    }

    /// As [`Rollout::run`], in steps of a length, s, that is halved where `observe` does not see enough.
    fn steps(&self, mut body: Body, start: f64, end: f64, longest: f64, mut observe: impl FnMut(Step) -> bool) -> Body {
        let mut time = start;
        let first = self.nodes.partition_point(|&t| t <= start + 1e-9);
        for &node in self.nodes[first..].iter().take_while(|&&t| t < end - 1e-9).chain([&end]) {
            let stretch = Stretch::new(self.motion, self.inverse_inertia, &body, time, (time + node) / 2.);
            let (mut i, mut steps, mut halved) = (0., ((node - time) / longest).ceil().max(1.), 0);
            while i < steps {
                let length = (node - time) / steps;
                let since = i * length;
                let after = stretch.after(&body, since + length, length);
                if observe(Step { stretch: &stretch, before: &body, after: &after, origin: time, since, length, halved }) {
                    body = after;
                    i += 1.;
                } else {
                    (i, steps, halved) = (2. * i, 2. * steps, halved + 1);
                }
            }
            time = node;
        }
        body
    }

    /// From the planned state at the start, with nothing corrected on the way, as it is at steps of [`LOOK`] at most.
    pub fn report(&self) -> RolloutReport {
        self.compared(LOOK, |_, _| None)
    }

    /// As [`Rollout::report`], but beyond `limits` (m, degrees) wherever it is so at any time: steps are halved until that is clear.
    pub fn certified(&self, limits: [f64; 2]) -> RolloutReport {
        let least = self.motion.inertia().symmetric_eigenvalues().min();
        self.compared(STEP, |step, ends| {
            let gaps = self.gaps(step, ends, least);
            let most = [0, 1].map(|i| f64::max(ends[0][i], ends[1][i]));
            let within = [0, 1].map(|i| most[i] + gaps[i]);
            // What is no number holds nothing.
            let holds = |values: [f64; 2], i: usize| values[i] <= limits[i];
            [0, 1].into_iter().any(|i| holds(most, i) && !holds(within, i)).then_some(within)
        })
    }

    /// The report of a rollout in steps.
    ///
    /// * `doubt` - of a step, with how far the body is off the plan at its start and its end (m, degrees): how far it may be off within, where
    ///   that matters
    fn compared(&self, longest: f64, mut doubt: impl FnMut(&Step, [[f64; 2]; 2]) -> Option<[f64; 2]>) -> RolloutReport {
        let motion = self.motion;
        let mut report = RolloutReport::default();
        let mut before = [0.; 2];
        self.steps(Body::planned(motion, &motion.base(0.)), 0., motion.horizon, longest, |step| {
            let time = step.end();
            let plan = Body::planned(motion, &motion.base(time));
            let after = [(step.after.position - plan.position).norm(), step.after.angle_to(&plan).to_degrees()];
            let doubted = doubt(&step, [before, after]);
            if doubted.is_some() && step.halved < HALVINGS {
                return false;
            }
            let [position, attitude] = doubted.unwrap_or(after);
            report.position.update(position, None, time);
            report.attitude.update(attitude, None, time);
            before = after;
            true
        });
        report
    }

    /// How much farther off the plan a body may be within a step than at both ends of it, m and degrees.
    ///
    /// Between two times `h` apart a function is not above its greater end by more than `h^2 / 8 max |f''|`. Of the distance from the plan, `f''` is
    /// what forces and plan accelerate the base differently, a cubic. Of the angle it is not above what the angular accelerations and squares of the
    /// angular velocities of both add up to, a tenth added while the angle is small.
    ///
    /// * `ends` - how far it is off at both ends
    /// * `least` - smallest moment of inertia, kg m²
    fn gaps(&self, step: &Step, ends: [[f64; 2]; 2], least: f64) -> [f64; 2] {
        let (motion, mass, Step { stretch, before, after, since, length, .. }) = (self.motion, self.motion.robot.mass, step);
        let middle = step.start() + length / 2.;
        let by_curvature = length * length / 8.;
        let planned = motion.base_lin.piece_around(middle);
        let [_, _, c, d] = motion.base_lin.cubic(planned);
        let apart = greatest_of_cubic(*since, *length, |time| {
            let acceleration = c * 2. + d * (6. * (step.origin + time - motion.base_lin.times[planned]));
            (stretch.force(time) / mass - Vector3::z() * GRAVITY - acceleration).norm()
        });
        let [rates, alpha] = turning(&motion.base_ang, middle);
        let push = greatest_of_cubic(*since, *length, |time| stretch.force(time).norm());
        // The way of the base within the step, by its speed and what it gains.
        let way = length * (before.velocity.norm().max(after.velocity.norm()) + length * (push / mass + GRAVITY));
        let moment = stretch.moment_bound(*since, *length, push, way);
        let momentum = before.momentum.norm().max(after.momentum.norm()) + moment * length / 2.;
        let omega = momentum / least;
        let curvature = alpha + (moment + omega * momentum) / least + (rates + omega).powi(2);
        let away = f64::max(ends[0][1], ends[1][1]).to_radians();
        let angle = if away + (rates + omega) * length < 0.3 { 1.1 * curvature * by_curvature } else { f64::INFINITY };
        [apart * by_curvature, angle.to_degrees()]
    }
}

#[cfg(test)]
mod tests {
    use super::super::stretch::tests::wild;
    use super::*;

    #[test]
    fn longer_steps_lead_to_the_same_place() {
        let (robot, trajectory) = wild(5, 1.);
        let motion = Motion::new(&trajectory, &robot).unwrap();
        let rollout = Rollout::new(&motion).unwrap();
        let start = Body::planned(&motion, &motion.base(0.));
        let [long, short] = [STEP, STEP / 40.].map(|step| rollout.steps(start, 0., motion.horizon, step, |_| true));
        // Positions and momenta are exact; five pieces of 0.1 s turn by up to 3 rad/s.
        assert!((long.position - short.position).norm() < 1e-13 && (long.momentum - short.momentum).norm() < 1e-12);
        assert!(start.angle_to(&long) > 0.1 && long.angle_to(&short) < 1e-6, "{}", long.angle_to(&short));
    }

    /// Steps that see nothing wrong at their ends are halved as long as something may be wrong in between.
    #[test]
    fn what_is_certified_is_above_what_fine_steps_see() {
        for seed in 0..20 {
            let (robot, trajectory) = wild(seed, 0.02);
            let motion = Motion::new(&trajectory, &robot).unwrap();
            let rollout = Rollout::new(&motion).unwrap();
            let seen = rollout.compared(1e-4, |_, _| None);
            // Just above what there is, and just below.
            for (part, held) in [(1.01, true), (0.99, false)] {
                let limits = [part * seen.position.value, part * seen.attitude.value];
                let certified = rollout.certified(limits);
                let values = [certified.position.value, certified.attitude.value];
                let within = [values[0] <= limits[0], values[1] <= limits[1]];
                assert_eq!(within, [held; 2], "seed {seed}: {values:?} against {limits:?}");
            }
        }
    }
}
