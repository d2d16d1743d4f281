//! Rollout: integrates the rigid body in f64 under the planned forces and footholds, without any correction, and compares it with the
//! planned base. Between two successive nodes or contact changes everything except the attitude is known in closed form.

use super::curves::{Extreme, Motion, readable};
use super::exact::turning;
use super::stretch::{Body, Stretch, greatest_of_cubic};
use crate::robot::GRAVITY;
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use std::fmt;

/// Longest step, s. Attitudes are then accurate to 1e-7 rad over motions of six seconds.
const STEP: f64 = 0.02;
/// Longest interval between the times that a report compares, s.
const LOOK: f64 = 0.01;
/// Largest number of halvings of a step to decide whether limits hold within it.
const HALVINGS: u32 = 7;

/// Deviation of the integrated motion from the plan.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RolloutReport {
    /// Largest distance of the base from its plan, m.
    pub position: Extreme,
    /// Largest angle of the rotation between the base and its plan, degrees.
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

/// Integrates bodies along a plan.
pub(super) struct Rollout<'a> {
    motion: &'a Motion<'a>,
    inverse_inertia: Matrix3<f64>,
    /// Times of nodes and contact changes, ascending, s.
    nodes: Vec<f64>,
}

/// Body before and after a step of a stretch.
struct Step<'a> {
    stretch: &'a Stretch,
    before: &'a Body,
    after: &'a Body,
    /// Start of the stretch, s.
    origin: f64,
    /// Start of the step since `origin`, s.
    since: f64,
    /// Length of the step, s.
    length: f64,
    /// Number of times that it was halved.
    halved: u32,
}

impl Step<'_> {
    /// Start time, s.
    fn start(&self) -> f64 {
        self.origin + self.since
    }

    /// End time, s.
    fn end(&self) -> f64 {
        self.start() + self.length
    }
}

impl<'a> Rollout<'a> {
    /// Returns `None` if the inertia has no inverse.
    pub fn new(motion: &'a Motion<'a>) -> Option<Self> {
        let mut nodes: Vec<f64> = motion.base_lin.times.iter().chain(&motion.base_ang.times).copied().collect();
        for foot in &motion.feet {
            // The position of a swinging foot has no effect.
            let standing = foot.motion.times.iter().filter(|&&time| foot.foothold(time).is_some());
            let moments = foot.moment.iter().flat_map(|moment| &moment.times);
            nodes.extend(standing.chain(&foot.force.times).chain(moments).chain(&foot.switches));
        }
        nodes.sort_by(f64::total_cmp);
        nodes.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
        Some(Rollout { motion, inverse_inertia: motion.inertia().try_inverse()?, nodes })
    }

    /// Integrates `body` from `start` to `end`, s.
    pub fn run(&self, body: Body, start: f64, end: f64) -> Body {
        self.steps(body, start, end, STEP, |_| true)
    }

    /// [`Rollout::run`] in steps of at most `longest`, s, which are halved for as long as `observe` returns false.
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

    /// Deviation of the rollout from the planned initial state, compared at steps of at most [`LOOK`].
    pub fn report(&self) -> RolloutReport {
        self.compared(LOOK, |_, _| None)
    }

    /// [`Rollout::report`] whose result exceeds `limits` (m, degrees) if the motion exceeds them at any time: steps are halved until this
    /// is decided.
    pub fn certified(&self, limits: [f64; 2]) -> RolloutReport {
        let least = self.motion.inertia().symmetric_eigenvalues().min();
        self.compared(STEP, |step, ends| {
            let gaps = self.gaps(step, ends, least);
            let most = [0, 1].map(|i| f64::max(ends[0][i], ends[1][i]));
            let within = [0, 1].map(|i| most[i] + gaps[i]);
            // NaN satisfies no limit.
            let holds = |values: [f64; 2], i: usize| values[i] <= limits[i];
            [0, 1].into_iter().any(|i| holds(most, i) && !holds(within, i)).then_some(within)
        })
    }

    /// Compares a rollout with the plan, in steps.
    ///
    /// * `longest` - longest step, s
    /// * `doubt` - upper bound of the deviation within a step, given those at its start and end (m, degrees); `None` if the ends decide
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

    /// Largest excess of the deviation within a step over that at both its ends, m and degrees.
    ///
    /// Over an interval of length `h` a function exceeds the larger of its end values by at most `h^2 / 8 max |f''|`. For the distance from
    /// the plan, `f''` is the difference between the acceleration by the forces and the planned one, a cubic. For the angle it is bounded
    /// by the sum of both angular accelerations and the square of the sum of both angular velocities, plus a tenth as long as the angle is
    /// small.
    ///
    /// * `ends` - deviation at both ends, m and degrees
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
        // Displacement of the base within the step: from its speed and the speed that it gains.
        let displacement = length * (before.velocity.norm().max(after.velocity.norm()) + length * (push / mass + GRAVITY));
        let moment = stretch.moment_bound(*since, *length, push, displacement);
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
    fn longer_steps_give_the_same_result() {
        let (robot, trajectory) = wild(5, 1.);
        let motion = Motion::new(&trajectory, &robot).unwrap();
        let rollout = Rollout::new(&motion).unwrap();
        let start = Body::planned(&motion, &motion.base(0.));
        let [long, short] = [STEP, STEP / 40.].map(|step| rollout.steps(start, 0., motion.horizon, step, |_| true));
        // Positions and momenta are exact; five pieces of 0.1 s rotate at up to 3 rad/s.
        assert!((long.position - short.position).norm() < 1e-13 && (long.momentum - short.momentum).norm() < 1e-12);
        assert!(start.angle_to(&long) > 0.1 && long.angle_to(&short) < 1e-6, "{}", long.angle_to(&short));
    }

    /// Steps whose ends are within the limits are halved for as long as the limits may be exceeded in between.
    #[test]
    fn the_certified_deviation_bounds_that_of_fine_steps() {
        for seed in 0..20 {
            let (robot, trajectory) = wild(seed, 0.02);
            let motion = Motion::new(&trajectory, &robot).unwrap();
            let rollout = Rollout::new(&motion).unwrap();
            let seen = rollout.compared(1e-4, |_, _| None);
            // Limits just above and just below the actual deviation.
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
