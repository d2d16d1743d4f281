//! What really happens under the planned forces: the rigid body integrated in f64 from its state, with forces and footholds as planned
//! and nothing else, and compared with the planned base.
//!
//! State: position, velocity, rotation, angular momentum about the centre of mass, world frame;
//! `p' = v`, `m v' = sum f_i - m g e_z`, `L' = sum (x_i - p) x f_i`, `q' = omega q / 2`, `omega = R I^-1 R' L`. Runge-Kutta steps of fifth
//! order between all times at which a curve has a node or a contact changes: in between forces and feet are cubics.

use super::bernstein::{acceleration, velocity};
use super::dense::{BaseState, Extreme, Motion, TimedCurve, readable};
use crate::robot::GRAVITY;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use serde::Serialize;
use std::fmt;

/// Longest step, s.
const STEP: f64 = 0.01;

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

/// One piece of a curve.
struct Cubic {
    /// s.
    start: f64,
    coefficients: [Vector3<f64>; 4],
}

impl Cubic {
    /// The piece around a time.
    fn around(curve: &TimedCurve, time: f64) -> Cubic {
        let piece = curve.piece_around(time);
        Cubic { start: curve.times[piece], coefficients: curve.cubic(piece) }
    }

    fn at(&self, time: f64) -> Vector3<f64> {
        let ([a, b, c, d], t) = (&self.coefficients, time - self.start);
        a + (b + (c + d * t) * t) * t
    }
}

/// A foot that stands, between two times at which anything changes.
pub(super) struct Contact {
    /// Where, m.
    place: Cubic,
    /// N.
    force: Cubic,
}

/// Integrates bodies along a plan.
pub(super) struct Rollout<'a> {
    motion: &'a Motion<'a>,
    inverse_inertia: Matrix3<f64>,
    /// Times at which a curve has a node or a contact changes, ascending.
    nodes: Vec<f64>,
}

impl<'a> Rollout<'a> {
    /// None when the inertia has no inverse.
    pub fn new(motion: &'a Motion<'a>) -> Option<Self> {
        let mut nodes: Vec<f64> = motion.base_lin.times.iter().chain(&motion.base_ang.times).copied().collect();
        for foot in &motion.feet {
            nodes.extend(foot.motion.times.iter().chain(&foot.force.times).chain(&foot.switches));
        }
        nodes.sort_by(f64::total_cmp);
        nodes.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
        Some(Rollout { motion, inverse_inertia: motion.inertia().try_inverse()?, nodes })
    }

    /// The body at `end`, from `body` at `start`.
    pub fn run(&self, body: Body, start: f64, end: f64) -> Body {
        self.steps(body, start, end, STEP, |_, _, _| {})
    }

    /// As [`Rollout::run`], in steps of a length, s; `observe` sees the body after every step, and the feet that stood.
    fn steps(&self, mut body: Body, start: f64, end: f64, longest: f64, mut observe: impl FnMut(&Body, f64, &[Contact])) -> Body {
        let mut time = start;
        let mut contacts = Vec::new();
        let first = self.nodes.partition_point(|&t| t <= start + 1e-9);
        for &node in self.nodes[first..].iter().take_while(|&&t| t < end - 1e-9).chain([&end]) {
            let middle = (time + node) / 2.;
            contacts.clear();
            contacts.extend(
                self.motion
                    .feet
                    .iter()
                    .filter(|foot| foot.foothold(middle).is_some())
                    .map(|foot| Contact { place: Cubic::around(&foot.motion, middle), force: Cubic::around(&foot.force, middle) }),
            );
            let steps = ((node - time) / longest).ceil().max(1.);
            let step = (node - time) / steps;
            for i in 0..steps as usize {
                let at = time + i as f64 * step;
                body = self.step(&body, at, step, &contacts);
                observe(&body, at + step, &contacts);
            }
            time = node;
        }
        body
    }

    fn step(&self, body: &Body, time: f64, step: f64, contacts: &[Contact]) -> Body {
        let mut rates = [*body; 6];
        for (i, (part, weights)) in STAGES.into_iter().enumerate() {
            rates[i] = self.rate(&body.advanced(weights, &rates, step), time + part * step, contacts);
        }
        let mut body = body.advanced(&WEIGHTS, &rates, step);
        body.rotation.normalize_mut();
        body
    }

    /// Derivatives of the state.
    fn rate(&self, body: &Body, time: f64, contacts: &[Contact]) -> Body {
        let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
        for contact in contacts {
            let f = contact.force.at(time);
            force += f;
            moment += (contact.place.at(time) - body.position).cross(&f);
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
        self.bounded(STEP).0
    }

    /// As [`Rollout::report`], with what the motion may stray beyond that between the steps, in the same units, made small enough to tell
    /// whether `limits` hold.
    pub fn certified(&self, limits: [f64; 2]) -> RolloutReport {
        let mut step = STEP;
        loop {
            let (report, [position, attitude]) = self.bounded(step);
            let unclear = |e: Extreme, gap: f64, limit: f64| e.value <= limit && e.value + gap > limit;
            let open = [unclear(report.position, position, limits[0]), unclear(report.attitude, attitude, limits[1])];
            if open == [false; 2] {
                return report;
            }
            step /= 2.;
            if step < STEP / 100. {
                let beyond = |e: Extreme, open: bool, gap: f64| if open { Extreme { value: e.value + gap, ..e } } else { e };
                return RolloutReport {
                    position: beyond(report.position, open[0], position),
                    attitude: beyond(report.attitude, open[1], attitude),
                };
            }
        }
    }

    /// The report of a rollout in steps, and bounds of what either of its values may be more between them.
    ///
    /// Between two times `h` apart a function is not above its greater end by more than `h^2 / 8 max |f''|`. Of the distance from the plan, `f''` is
    /// what forces and plan accelerate the base differently: a cubic, not above [`FOUR_POINTS`] times its values at four points. Of the angle it
    /// is not above what the angular accelerations and squares of the angular velocities of both add up to, a tenth added while the angle is small.
    fn bounded(&self, longest: f64) -> (RolloutReport, [f64; 2]) {
        let motion = self.motion;
        let moments = motion.inertia().symmetric_eigenvalues();
        let least = moments.min();
        let mut report = RolloutReport::default();
        let mut gaps = [0., 0.];
        let mut pushes = Vec::new();
        let start = Body::planned(motion, &motion.base(0.));
        let mut before = (start, 0., 0.);
        self.steps(start, 0., motion.horizon, longest, |body, time, contacts| {
            let plan = Body::planned(motion, &motion.base(time));
            let away = body.angle_to(&plan);
            report.position.update((body.position - plan.position).norm(), None, time);
            report.attitude.update(away.to_degrees(), None, time);
            let (earlier, since, earlier_away) = &before;
            let step = time - since;
            let middle = since + step / 2.;
            let planned = motion.base_lin.piece_around(middle);
            let [_, _, c, d] = motion.base_lin.cubic(planned);
            let mut apart = 0_f64;
            pushes.clear();
            pushes.resize(contacts.len(), 0_f64);
            for part in [0., 1. / 3., 2. / 3., 1.] {
                let at = since + part * step;
                let mut force = Vector3::zeros();
                for (contact, push) in contacts.iter().zip(&mut pushes) {
                    let f = contact.force.at(at);
                    *push = push.max(f.norm());
                    force += f;
                }
                let acceleration = c * 2. + d * (6. * (at - motion.base_lin.times[planned]));
                apart = apart.max((force / motion.robot.mass - Vector3::z() * GRAVITY - acceleration).norm());
            }
            gaps[0] = f64::max(gaps[0], FOUR_POINTS * apart * step * step / 8.);
            let rates = motion.base_ang.on(middle, |curve, piece| greatest(&velocity(curve, piece)));
            let turn = motion.base_ang.on(middle, |curve, piece| greatest(&acceleration(curve, piece)));
            // The way of the base within the step, by its speed and what it gains.
            let gained = pushes.iter().sum::<f64>() * FOUR_POINTS / motion.robot.mass + GRAVITY;
            let way = step * (body.velocity.norm().max(earlier.velocity.norm()) + step * gained);
            let moment: f64 = contacts.iter().zip(&pushes).fold(0., |sum, (contact, push)| {
                let place = contact.place.at(middle);
                let arm = (place - body.position).norm().max((place - earlier.position).norm()) + way;
                sum + arm * push * FOUR_POINTS
            });
            let momentum = body.momentum.norm().max(earlier.momentum.norm()) + moment * step / 2.;
            let omega = momentum / least;
            let curvature = turn + rates * rates + (moment + omega * momentum) / least + (rates + omega).powi(2);
            let small = away.max(*earlier_away) + (rates + omega) * step < 0.3;
            let gap = if small { 1.1 * curvature * step * step / 8. } else { f64::INFINITY };
            gaps[1] = f64::max(gaps[1], gap.to_degrees());
            before = (*body, time, away);
        });
        (report, gaps)
    }
}

/// How far a cubic may be above the greatest of its values at four evenly spaced points, the outer two its ends: their Lebesgue constant.
const FOUR_POINTS: f64 = 1.64;

/// Sum of the sizes of the components, greatest among control points.
fn greatest(control: &[Vector3<f64>]) -> f64 {
    control.iter().map(|c| c.lp_norm(1)).fold(0., f64::max)
}
