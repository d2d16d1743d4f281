//! What really happens under the planned forces: the rigid body integrated in f64 from its state, with forces and footholds as planned
//! and nothing else, and compared with the planned base.
//!
//! State: position, velocity, rotation, angular momentum about the centre of mass, world frame;
//! `p' = v`, `m v' = sum f_i - m g e_z`, `L' = sum (x_i - p) x f_i`, `q' = omega q / 2`, `omega = R I^-1 R' L`. Runge-Kutta steps of fifth
//! order between all times at which a curve has a node.

use super::dense::{BaseState, Extreme, Motion, readable};
use crate::robot::GRAVITY;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use serde::Serialize;
use std::fmt;

/// Longest step, s.
const STEP: f64 = 0.01;

/// How far the integrated motion strays from the plan.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
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

/// State of the body.
#[derive(Debug, Clone, Copy)]
pub(super) struct Body {
    /// Position, m.
    pub position: Vector3<f64>,
    /// Velocity, m/s.
    pub velocity: Vector3<f64>,
    /// Base to world, a unit quaternion.
    rotation: Quaternion<f64>,
    /// Angular momentum about the centre of mass, N m s.
    pub momentum: Vector3<f64>,
}

impl Body {
    /// The state of the plan.
    pub fn planned(motion: &Motion, base: &BaseState) -> Body {
        let rotation = base.rotation.matrix();
        Body {
            position: base.position,
            velocity: base.velocity,
            rotation: *UnitQuaternion::from_rotation_matrix(&base.rotation).quaternion(),
            momentum: rotation * (motion.inertia() * (rotation.transpose() * base.omega)),
        }
    }

    /// Angle of the rotation to another attitude, rad.
    pub fn angle_to(&self, other: &Body) -> f64 {
        UnitQuaternion::from_quaternion(self.rotation).angle_to(&UnitQuaternion::from_quaternion(other.rotation))
    }

    /// `self + sum_i weights[i] rates[i]`, a rate being a body of derivatives.
    fn advanced(&self, weights: &[f64], rates: &[Body], step: f64) -> Body {
        let mut body = *self;
        for (weight, rate) in weights.iter().zip(rates) {
            let w = weight * step;
            body.position += rate.position * w;
            body.velocity += rate.velocity * w;
            body.rotation += rate.rotation * w;
            body.momentum += rate.momentum * w;
        }
        body
    }
}

/// Fifth-order method of Dormand and Prince (1980): time, then weights of the rates before, of each stage.
const STAGES: [(f64, &[f64]); 6] = [
    (0., &[]),
    (1. / 5., &[1. / 5.]),
    (3. / 10., &[3. / 40., 9. / 40.]),
    (4. / 5., &[44. / 45., -56. / 15., 32. / 9.]),
    (8. / 9., &[19372. / 6561., -25360. / 2187., 64448. / 6561., -212. / 729.]),
    (1., &[9017. / 3168., -355. / 33., 46732. / 5247., 49. / 176., -5103. / 18656.]),
];

/// Weights of the stages in the step.
const WEIGHTS: [f64; 6] = [35. / 384., 0., 500. / 1113., 125. / 192., -2187. / 6784., 11. / 84.];

/// Integrates bodies along a plan.
pub(super) struct Rollout<'a> {
    motion: &'a Motion<'a>,
    inverse_inertia: Matrix3<f64>,
    /// Times at which a curve has a node, ascending.
    nodes: Vec<f64>,
}

impl<'a> Rollout<'a> {
    /// None when the inertia has no inverse.
    pub fn new(motion: &'a Motion<'a>) -> Option<Self> {
        let mut nodes: Vec<f64> = motion.base_lin.times.clone();
        for foot in &motion.feet {
            nodes.extend(foot.motion.times.iter().chain(&foot.force.times));
        }
        nodes.sort_by(f64::total_cmp);
        nodes.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
        Some(Rollout { motion, inverse_inertia: motion.inertia().try_inverse()?, nodes })
    }

    /// The body at `end`, from `body` at `start`; `observe` sees it after every step.
    pub fn run(&self, mut body: Body, start: f64, end: f64, mut observe: impl FnMut(&Body, f64)) -> Body {
        let mut time = start;
        let first = self.nodes.partition_point(|&t| t <= start + 1e-9);
        for &node in self.nodes[first..].iter().take_while(|&&t| t < end - 1e-9).chain([&end]) {
            let steps = ((node - time) / STEP).ceil().max(1.);
            let step = (node - time) / steps;
            for i in 0..steps as usize {
                let at = time + i as f64 * step;
                body = self.step(&body, at, step);
                observe(&body, at + step);
            }
            time = node;
        }
        body
    }

    fn step(&self, body: &Body, time: f64, step: f64) -> Body {
        let mut rates = [*body; 6];
        for (i, (part, weights)) in STAGES.into_iter().enumerate() {
            // At both ends of the step, inside of it: at a node forces and feet belong to the piece that is stepped over.
            let at = time + part.clamp(1e-9, 1. - 1e-9) * step;
            rates[i] = self.rate(&body.advanced(weights, &rates, step), at);
        }
        let mut body = body.advanced(&WEIGHTS, &rates, step);
        body.rotation.normalize_mut();
        body
    }

    /// Derivatives of the state.
    fn rate(&self, body: &Body, time: f64) -> Body {
        let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
        for foot in &self.motion.feet {
            if foot.foothold(time).is_some() {
                let f = foot.force.at(time).value;
                force += f;
                moment += (foot.motion.at(time).value - body.position).cross(&f);
            }
        }
        let rotation = UnitQuaternion::from_quaternion(body.rotation);
        let omega = rotation * (self.inverse_inertia * rotation.inverse_transform_vector(&body.momentum));
        Body {
            position: body.velocity,
            velocity: force / self.motion.robot.mass - Vector3::z() * GRAVITY,
            rotation: Quaternion::from_imag(omega * 0.5) * body.rotation,
            momentum: moment,
        }
    }

    /// From the planned state at the start, with nothing corrected on the way.
    pub fn report(&self) -> RolloutReport {
        let mut report = RolloutReport::default();
        let start = Body::planned(self.motion, &self.motion.base(0.));
        self.run(start, 0., self.motion.horizon, |body, time| {
            let plan = Body::planned(self.motion, &self.motion.base(time));
            report.position.update((body.position - plan.position).norm(), None, time);
            report.attitude.update(body.angle_to(&plan).to_degrees(), None, time);
        });
        report
    }
}
