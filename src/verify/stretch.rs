//! Body on a stretch of a motion: an interval in which the same feet stand and no curve has a node.
//!
//! Forces and feet are cubics in time there, so position, velocity and angular momentum are polynomials that are known in closed form. With
//! `r` the displacement from the position `p0` at the start of the stretch, `F` the sum of all forces and `H = L + m r x v` the angular
//! momentum about `p0`:
//!
//! `m v' = F - m g e_z`, `r' = v`, `H' = sum ((x_i - p0) x f_i + m_i) - m g r x e_z`, `L = H - m r x v`.
//!
//! Only the attitude is integrated numerically: `q' = q w / 2`, `w = I^-1 R' L` in the base frame.

use super::curves::{DenseState, Motion, TimedCurve};
use crate::robot::GRAVITY;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// State of a body, world frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Body {
    /// Position, m.
    pub position: Vector3<f64>,
    /// Velocity, m/s.
    pub velocity: Vector3<f64>,
    /// Base to world.
    rotation: UnitQuaternion<f64>,
    /// Angular momentum about the centre of mass, N m s.
    pub momentum: Vector3<f64>,
}

impl Body {
    /// State that the plan prescribes.
    pub fn planned(motion: &Motion, base: &DenseState) -> Body {
        let rotation = base.rotation.matrix();
        Body {
            position: base.position,
            velocity: base.velocity,
            rotation: UnitQuaternion::from_rotation_matrix(&base.rotation),
            momentum: rotation * (motion.inertia() * (rotation.transpose() * base.omega)),
        }
    }

    /// Angle of the rotation to another attitude, rad.
    pub fn angle_to(&self, other: &Body) -> f64 {
        self.rotation.angle_to(&other.rotation)
    }
}

/// Coefficients of a polynomial in the time since the start of its stretch, in ascending order of powers.
type Polynomial<const N: usize> = [Vector3<f64>; N];

fn at<const N: usize>(polynomial: &Polynomial<N>, time: f64) -> Vector3<f64> {
    polynomial.iter().rev().fold(Vector3::zeros(), |sum, c| sum * time + c)
}

/// Coefficients of the curve piece that contains `around`, as a polynomial in the time since `start`.
fn cubic(curve: &TimedCurve, around: f64, start: f64) -> Polynomial<4> {
    let piece = curve.piece_around(around);
    let ([a, b, c, d], t) = (curve.cubic(piece), start - curve.times[piece]);
    [a + (b + (c + d * t) * t) * t, b + (c * 2. + d * (3. * t)) * t, c + d * (3. * t), d]
}

/// Motion of a body under the forces of the standing feet.
pub(super) struct Stretch {
    mass: f64,
    inverse_inertia: Matrix3<f64>,
    /// Body at the start.
    first: Body,
    /// Sum of the forces, N.
    force: Polynomial<4>,
    /// Moment of the forces about the position of the body at the start, N m.
    moment: Polynomial<7>,
    /// Velocity, m/s.
    velocity: Polynomial<5>,
    /// Displacement from the position at the start, m.
    displacement: Polynomial<6>,
    /// Angular momentum about the position at the start, N m s.
    spin: Polynomial<8>,
}

impl Stretch {
    /// * `body` - state at `start`
    /// * `start` - start of the stretch, s
    /// * `around` - a time within the stretch, s
    pub fn new(motion: &Motion, inverse_inertia: Matrix3<f64>, body: &Body, start: f64, around: f64) -> Stretch {
        let mass = motion.robot.mass;
        let (mut force, mut moment) = ([Vector3::zeros(); 4], [Vector3::zeros(); 7]);
        for foot in motion.feet.iter().filter(|foot| foot.foothold(around).is_some()) {
            let (push, mut arm) = (cubic(&foot.force, around, start), cubic(&foot.motion, around, start));
            arm[0] -= body.position;
            for (i, push) in push.iter().enumerate() {
                force[i] += push;
                // The position of a standing foot is constant: its higher coefficients are zero.
                for (j, arm) in arm.iter().enumerate().filter(|(_, arm)| **arm != Vector3::zeros()) {
                    moment[i + j] += arm.cross(push);
                }
            }
            if let Some(curve) = &foot.moment {
                moment.iter_mut().zip(cubic(curve, around, start)).for_each(|(sum, own)| *sum += own);
            }
        }
        let (mut velocity, mut displacement, mut spin) = ([body.velocity; 5], [Vector3::zeros(); 6], [body.momentum; 8]);
        for i in 0..4 {
            velocity[i + 1] = force[i] / (mass * (i + 1) as f64);
        }
        velocity[1].z -= GRAVITY;
        for i in 0..5 {
            displacement[i + 1] = velocity[i] / (i + 1) as f64;
        }
        for i in 0..7 {
            let weight = displacement.get(i).map_or(Vector3::zeros(), |d| d.cross(&Vector3::z()) * (mass * GRAVITY));
            spin[i + 1] = (moment[i] - weight) / (i + 1) as f64;
        }
        Stretch { mass, inverse_inertia, first: *body, force, moment, velocity, displacement, spin }
    }

    /// Sum of the forces, N.
    ///
    /// * `time` - time since the start of the stretch, s
    pub fn force(&self, time: f64) -> Vector3<f64> {
        at(&self.force, time)
    }

    /// Upper bound of the moment about the centre of mass over a step, N m.
    ///
    /// The moment is taken about the position at the start of the step, where standing feet make it a cubic; the body does not move far
    /// from there.
    ///
    /// * `time` - start of the step since the start of the stretch, s
    /// * `step` - length of the step, s
    /// * `push` - upper bound of the force, N
    /// * `displacement` - upper bound of the displacement of the body within the step, m
    pub fn moment_bound(&self, time: f64, step: f64, push: f64, displacement: f64) -> f64 {
        let (here, [a, b, c, d, ..]) = (at(&self.displacement, time), self.moment);
        let about_here = |time: f64| at(&[a, b, c, d], time) - here.cross(&self.force(time));
        let moving: f64 = (4..7).map(|i| self.moment[i].norm() * (time + step).powi(i as i32)).sum();
        greatest_of_cubic(time, step, |time| about_here(time).norm()) + moving + push * displacement
    }

    /// State of the body at a time after the start.
    ///
    /// * `before` - the body `step` s earlier
    /// * `time` - time since the start of the stretch, s
    pub fn after(&self, before: &Body, time: f64, step: f64) -> Body {
        let momentum = self.momentum(time);
        Body {
            position: self.first.position + at(&self.displacement, time),
            velocity: at(&self.velocity, time),
            rotation: self.turned(before, time - step, step, momentum),
            momentum,
        }
    }

    /// Angular momentum about the centre of mass, N m s.
    fn momentum(&self, time: f64) -> Vector3<f64> {
        at(&self.spin, time) - at(&self.displacement, time).cross(&at(&self.velocity, time)) * self.mass
    }

    /// Attitude after a step. The derivative preserves the norm of any quaternion, so one normalisation at the end suffices.
    ///
    /// * `time` - start of the step since the start of the stretch, s
    /// * `last` - angular momentum at the end of the step, N m s
    fn turned(&self, before: &Body, time: f64, step: f64, last: Vector3<f64>) -> UnitQuaternion<f64> {
        let mut rates = [Quaternion::from_imag(Vector3::zeros()); 6];
        let advanced = |weights: &[f64], rates: &[Quaternion<f64>]| {
            weights.iter().zip(rates).fold(*before.rotation.quaternion(), |sum, (weight, rate)| sum + rate * (weight * step))
        };
        for (i, (part, weights)) in STAGES.into_iter().enumerate() {
            let attitude = advanced(weights, &rates);
            let momentum = match part {
                0. => before.momentum,
                1. => last,
                _ => self.momentum(time + part * step),
            };
            let omega = self.inverse_inertia * UnitQuaternion::new_unchecked(attitude).inverse_transform_vector(&momentum);
            rates[i] = attitude * Quaternion::from_imag(omega * 0.5);
        }
        UnitQuaternion::from_quaternion(advanced(&WEIGHTS, &rates))
    }
}

/// Stages of the fifth-order method of Dormand and Prince (1980): time within the step, and weights of the earlier rates.
const STAGES: [(f64, &[f64]); 6] = [
    (0., &[]),
    (1. / 5., &[1. / 5.]),
    (3. / 10., &[3. / 40., 9. / 40.]),
    (4. / 5., &[44. / 45., -56. / 15., 32. / 9.]),
    (8. / 9., &[19372. / 6561., -25360. / 2187., 64448. / 6561., -212. / 729.]),
    (1., &[9017. / 3168., -355. / 33., 46732. / 5247., 49. / 176., -5103. / 18656.]),
];

/// Weights of the stages in the result of the step.
const WEIGHTS: [f64; 6] = [35. / 384., 0., 500. / 1113., 125. / 192., -2187. / 6784., 11. / 84.];

/// Lebesgue constant of four evenly spaced points including both ends: largest ratio of a cubic's maximum to the largest of its values
/// there.
const FOUR_POINTS: f64 = 1.64;

/// Upper bound of the magnitude of a cubic over a step.
///
/// * `size` - magnitude at a time
pub(super) fn greatest_of_cubic(time: f64, step: f64, size: impl Fn(f64) -> f64) -> f64 {
    let sizes = [0., 1. / 3., 2. / 3., 1.].map(|part| size(time + part * step));
    // NaN is kept.
    FOUR_POINTS * sizes.into_iter().fold(0., |most, size| if size > most || size.is_nan() { size } else { most })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::gait::trajectory::FootCurves;
    use crate::gait::{Curve, Trajectory};
    use crate::robot::Robot;

    /// Biped for 0.5 s under forces that do not balance its weight, on sliding feet: one stands, the other swings from 0.2 to 0.3 s.
    ///
    /// * `size` - scale of all random parts
    pub fn wild(seed: u64, size: f64) -> (Robot, Trajectory) {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(1);
        let mut random = |most: f64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            size * most * ((state >> 40) as f64 / (1_u64 << 23) as f64 - 1.)
        };
        let mut curve = |middle: [f64; 3], value: f64, slope: f64| Curve {
            poly_durations: vec![0.1; 5],
            nodes: (0..6).map(|_| std::array::from_fn(|i| if i < 3 { middle[i] + random(value) } else { random(slope) })).collect(),
        };
        let inertia = [[1.2, 0.1, -0.2], [0.1, 0.8, 0.05], [-0.2, 0.05, 0.5]];
        let robot = Robot { inertia, ..Robot::named("biped").unwrap() };
        let base = [curve([3., -1., 0.6], 0.01, 0.1), curve([0.; 3], 0.2, 0.5)];
        let load = robot.weight() / 2.;
        let feet = [0.1, -0.1].map(|y| FootCurves::new(curve([3., y - 1., 0.], 0.02, 0.5), curve([0., 0., load], 0.3 * load, load)));
        (robot, Trajectory::new(vec![vec![0.5], vec![0.2, 0.1, 0.2]], 0.5, base, feet.into()))
    }

    /// Integrates the whole state with one method in small steps, directly from the curves.
    fn integrated(motion: &Motion, start: f64, end: f64) -> Body {
        let inertia = motion.inertia();
        let inverse = inertia.try_inverse().unwrap();
        let mass = motion.robot.mass;
        // Position, velocity, rotation by its columns, angular momentum.
        let rate = |time: f64, [p, v, x, y, z, l]: [Vector3<f64>; 6]| {
            let rotation = Matrix3::from_columns(&[x, y, z]);
            let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
            for foot in motion.feet.iter().filter(|foot| foot.foothold((start + end) / 2.).is_some()) {
                let f = foot.force.at(time).value;
                force += f;
                moment += (foot.motion.at(time).value - p).cross(&f);
            }
            let omega = rotation * inverse * rotation.transpose() * l;
            [v, force / mass - Vector3::z() * GRAVITY, omega.cross(&x), omega.cross(&y), omega.cross(&z), moment]
        };
        let plus = |s: [Vector3<f64>; 6], r: [Vector3<f64>; 6], by: f64| std::array::from_fn(|i| s[i] + r[i] * by);
        let base = motion.base(start);
        let first = Body::planned(motion, &base);
        let columns = [0, 1, 2].map(|i| base.rotation.matrix().column(i).into_owned());
        let mut s = [first.position, first.velocity, columns[0], columns[1], columns[2], first.momentum];
        let step = (end - start) / 1000.;
        for i in 0..1000 {
            let time = start + f64::from(i) * step;
            let a = rate(time, s);
            let b = rate(time + step / 2., plus(s, a, step / 2.));
            let c = rate(time + step / 2., plus(s, b, step / 2.));
            let d = rate(time + step, plus(s, c, step));
            s = std::array::from_fn(|i| s[i] + (a[i] + (b[i] + c[i]) * 2. + d[i]) * (step / 6.));
        }
        let rotation = UnitQuaternion::from_matrix(&Matrix3::from_columns(&[s[2], s[3], s[4]]));
        Body { position: s[0], velocity: s[1], rotation, momentum: s[5] }
    }

    #[test]
    fn the_closed_form_matches_integration_in_small_steps() {
        for (seed, start) in [(1, 0.), (2, 0.1), (3, 0.2), (4, 0.4)] {
            let (robot, trajectory) = wild(seed, 1.);
            let motion = Motion::new(&trajectory, &robot).unwrap();
            let inverse = motion.inertia().try_inverse().unwrap();
            let first = Body::planned(&motion, &motion.base(start));
            let stretch = Stretch::new(&motion, inverse, &first, start, start + 0.05);
            let mut body = first;
            for i in 1..=10 {
                body = stretch.after(&body, 0.01 * f64::from(i), 0.01);
            }
            let expected = integrated(&motion, start, start + 0.1);
            let apart = [
                (body.position - expected.position).norm(),
                (body.velocity - expected.velocity).norm(),
                (body.momentum - expected.momentum).norm(),
                body.angle_to(&expected),
            ];
            assert!(apart.iter().all(|&d| d < 1e-8), "seed {seed}: {apart:?}");
            assert!((body.momentum - first.momentum).norm() > 0.1 && body.angle_to(&first) > 0.01);
        }
    }

    #[test]
    fn moments_are_within_their_bound() {
        for (seed, size) in (0..20).flat_map(|seed| [(seed, 1.), (seed, 0.05)]) {
            let (robot, trajectory) = wild(seed, size);
            let motion = Motion::new(&trajectory, &robot).unwrap();
            let inverse = motion.inertia().try_inverse().unwrap();
            let first = Body::planned(&motion, &motion.base(0.));
            let stretch = Stretch::new(&motion, inverse, &first, 0., 0.05);
            for (time, step) in [(0., 0.1), (0., 0.02), (0.04, 0.02), (0.08, 0.02)] {
                let parts = (0..=100).map(|i| time + step * f64::from(i) / 100.);
                let d = 1e-5;
                let rate = |t: f64| (stretch.momentum(t + d) - stretch.momentum(t - d)) / (2. * d);
                let most = parts.clone().map(|t| rate(t).norm()).fold(0., f64::max);
                let push = parts.clone().map(|t| stretch.force(t).norm()).fold(0., f64::max);
                let displacement =
                    parts.map(|t| (at(&stretch.displacement, t) - at(&stretch.displacement, time)).norm()).fold(0., f64::max);
                let bound = stretch.moment_bound(time, step, push, displacement);
                let close = size == 1. || bound < 4. * most + push * displacement;
                assert!(bound > most - 1e-6 && close, "seed {seed}, size {size}, {time} s: {bound} for {most}");
            }
        }
    }
}
