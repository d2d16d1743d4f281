//! Cost of a motion: the work of its legs and the forces that they bear, per weight and distance.
//!
//! With mass `m`, base height `l`, horizon `T` and distance `d` (see [`Cost::distance`]):
//!
//! ```text
//! leg work    = int sum over standing feet |f . e  e . v| + |f . (v - omega x r) - f . e  e . v| dt / (m g d)
//! swing work  = int sum over swinging feet |m_leg a_foot . v| dt / (m g d)
//! effort      = int sum (|f|^2 + |m|^2 / x^2) + |m_trunk|^2 / x^2 dt / ((m g)^2 T)
//! effort cost = effort T sqrt(g l) / d
//! ```
//!
//! with the moment `m` of a sole of length `2 x` and the moment `m_trunk` that holds a tilted trunk (both 0 without soles),
//! `v = v_foot - v_hip`, the angular velocity `omega` of the body, and `e` the direction of the leg `r` from the hip to the foot. The hip
//! is above the nominal foothold, at base height.
//!
//! A leg does work along its direction, when its knee extends and flexes, and across it, when its hip turns it against the body. The sum
//! of both is the power by which the leg changes the energy of the body: without the turn of the body, `omega x r`, a body that pitches
//! would climb at less than the work of lifting its weight. The absolute value of each counts: braking costs as much as driving, and the
//! work absorbed by one joint does not drive the other, because muscles and motors recover little energy. With their sum alone,
//! a body could ride at no cost on bent legs that swing under a level trunk while the hip absorbs all the work of the knee. A stiff leg
//! that vaults with its force along the leg costs nothing in either term. Legs that work against each other both count.
//!
//! Effort is the cost of bearing a force without motion: the heat of a motor is proportional to the square of its torque, and muscles also
//! consume energy over time. Per distance, effort makes slow gaits costly, as swing work does fast ones.
//!
//! For robots with joints the cost also penalises the joint-limit excess. This is a preference, not a constraint: the minimisation lowers a
//! quadratic price of it ([`rows::joint_torque`](crate::rows::joint_torque), [`rows::joint_speed`](crate::rows::joint_speed)), and the
//! search prefers gaits without it.
//!
//! # Weights
//! The weights of the three terms are 1. Among motions that were not minimised, a trot was ANYmal's cheapest gait at every speed with an
//! effort weight below about 0.7; from there on a walk was cheapest at low speeds, because more feet share the weight. Robots with longer
//! legs walked at lower weights, too. The value
//! also suits electric legs, whose motors convert more power to heat than to work: at weight 1 a quadruped of 30 kg and 0.5 m height spends
//! 160 W on standing. The weight of joints is 50: an excess of one twentieth of a limit costs as much as a whole trot. With weights of
//! 0, 10, 20 and 50, 5, 12, 13 and 14 of 16 searches returned gaits within the limits. The atlases in `benches/atlas` show the gaits that
//! result.
//!
//! # Integration
//! Quantities of a single curve are exact, by Bernstein polynomials: their integral is the mean of the coefficients, and they do not exceed
//! the largest coefficient. Powers combine several curves and the attitude. They are integrated between all nodes of all curves, in steps
//! of at most [`STEP`], as the absolute value of the parabola through the powers at three Gauss-Legendre points. Without a change of sign
//! this is the Gauss-Legendre rule, exact to fifth order.

use super::joints::excess;
use super::piece::{Piece, SAME_TIME, pieces};
use super::{Curve, Phase, Schedule, Trajectory};
use crate::error::{Result, check_range};
use crate::quadrature::GAUSS_3_NODE;
use crate::robot::{GRAVITY, Robot};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Smallest distance by which costs are divided, in base heights. A robot that stands still has a cost per time, as if it covered this
/// distance.
pub const LEAST_DISTANCE: f64 = 0.1;

/// Longest step of the quadrature, s. A power that is not a parabola and changes its sign has an error of fourth order.
pub const STEP: f64 = 0.04;

/// Moment that holds the trunk of a robot with soles, in weights times base height per rad of roll or pitch: that of half of the weight at
/// 0.3 base heights above the hips. Without it tilting costs nothing, and a walk of a humanoid tilts its trunk by 17 degrees.
pub(crate) const TRUNK_MOMENT: f64 = 0.15;

/// Shortest leg that has a direction, m.
pub(crate) const LEAST_LEG: f64 = 1e-6;

/// Weights of the terms of the total cost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct CostWeights {
    /// Weight of [`Cost::leg_work`], dimensionless.
    pub leg_work: f64,
    /// Weight of [`Cost::swing_work`], dimensionless. Too small: feet move hastily; too large: long swings.
    pub swing_work: f64,
    /// Weight of [`Cost::effort_cost`], dimensionless. Too small: short stances with high forces, and a trot is best at every speed; too
    /// large: feet move hastily in order to stand longer.
    pub effort: f64,
    /// Weight of the joint-limit excess, see [`excess`], in [`Cost::joint_cost`]. Too small: gaits that the robot's motors cannot follow;
    /// 0: joints are not evaluated.
    pub joint_excess: f64,
}

impl Default for CostWeights {
    fn default() -> Self {
        CostWeights { leg_work: 1., swing_work: 1., effort: 1., joint_excess: 50. }
    }
}

impl CostWeights {
    /// Checks every field.
    ///
    /// # Errors
    /// [`Invalid`](crate::Error::Invalid) names the first field that is out of its limits.
    pub fn validate(&self) -> Result<()> {
        check_range("cost.leg_work", self.leg_work, 0., 1e6)?;
        check_range("cost.swing_work", self.swing_work, 0., 1e6)?;
        check_range("cost.effort", self.effort, 0., 1e6)?;
        check_range("cost.joint_excess", self.joint_excess, 0., 1e6)
    }
}

/// Costs of a motion, and the demands on its legs.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Cost {
    /// Weighted sum of leg work, swing work, effort cost and joint excess; it includes [`Cost::joint_cost`].
    pub total: f64,
    /// Work of standing legs on the body, per weight and distance.
    pub leg_work: f64,
    /// Work of moving the mass of swinging legs, per weight and distance.
    pub swing_work: f64,
    /// Mean over time of `sum |f|^2 / (m g)^2`, with the moments of soles and trunk over the half length of a sole; `1 / n` when standing on
    /// `n` feet.
    pub effort: f64,
    /// Effort per distance, `effort T sqrt(g l) / d`.
    pub effort_cost: f64,
    /// Weighted excess of joints beyond their limits, see [`excess`]; 0 for a robot without joints.
    #[serde(default)]
    pub joint_cost: f64,
    /// Distance `d` by which costs are divided, m: from start to goal, plus `l` per rad of yaw; at least [`LEAST_DISTANCE`] `l`.
    pub distance: f64,
    /// Horizon, s.
    pub horizon: f64,
    /// Largest force of a foot, weights.
    pub peak_force: f64,
    /// Largest angle between the body's and the world's vertical at the points of the quadrature, degrees.
    pub tilt: f64,
    /// Highest speed of a foot, world frame, m/s.
    pub foot_speed: f64,
    /// Largest acceleration of a foot, m/s².
    pub foot_acceleration: f64,
    /// Highest speed of a foot at the end of a swing, m/s.
    pub touch_down_speed: f64,
    /// Largest moment `|sum m_leg (x_i - p) x a_i|` of swinging legs about the base at the points of the quadrature, in `m g l`.
    pub swing_moment: f64,
}

/// Computes the costs of a motion.
///
/// * `leg_mass` - mass of a leg, concentrated at the foot, kg
///
/// # Errors
/// [`Invalid`](crate::Error::Invalid) if the trajectory is malformed, robot and trajectory disagree on the number of feet, or the robot's
/// joint model is invalid.
pub fn cost(trajectory: &Trajectory, robot: &Robot, leg_mass: f64, weights: &CostWeights) -> Result<Cost> {
    trajectory.validate()?;
    let (lin, ang) = (&trajectory.base_lin.nodes[0], &trajectory.base_ang.nodes[0]);
    let displacement = std::array::from_fn(|i| trajectory.base_target[i] - lin[i]);
    let distance = distance(robot, displacement, trajectory.yaw_target - ang[2]);
    priced(trajectory, robot, leg_mass, weights, [0., trajectory.horizon], distance)
}

/// Computes the costs of a part of a motion, from `start` to `end` s, and the demands on its legs in that part.
///
/// If the part is a whole number of steady strides, its cost is that of the gait without starting and stopping. [`Cost::horizon`] is the
/// duration of the part, [`Cost::distance`] the distance that the base covers in it.
///
/// # Errors
/// The errors of [`cost`], and [`Invalid`](crate::Error::Invalid) if the part is empty or outside the motion.
pub fn cost_between(trajectory: &Trajectory, robot: &Robot, leg_mass: f64, weights: &CostWeights, part: [f64; 2]) -> Result<Cost> {
    trajectory.validate()?;
    let [start, end] = part;
    check_range("start", start, 0., trajectory.horizon - SAME_TIME)?;
    check_range("end", end, start + SAME_TIME, trajectory.horizon + SAME_TIME)?;
    let at = |curve: &Curve, time: f64| {
        let pieces = pieces(curve);
        let mut piece = 0;
        advance(&mut piece, &pieces, time, Piece::end);
        pieces[piece].value(time)
    };
    let displacement = at(&trajectory.base_lin, end) - at(&trajectory.base_lin, start);
    let turn = at(&trajectory.base_ang, end).z - at(&trajectory.base_ang, start).z;
    priced(trajectory, robot, leg_mass, weights, part, distance(robot, displacement.into(), turn))
}

/// Costs of a part of a valid trajectory, per `distance`.
fn priced(trajectory: &Trajectory, robot: &Robot, leg_mass: f64, weights: &CostWeights, part: [f64; 2], distance: f64) -> Result<Cost> {
    trajectory.check_feet(robot)?;
    let (weight, horizon) = (robot.weight(), part[1] - part[0]);
    let motion = Motion::new(trajectory, robot, part)?;
    let mut cost = Cost { distance, horizon, ..motion.extremes() };
    cost.peak_force /= weight;
    cost.effort /= weight * weight * horizon;
    cost.effort_cost = cost.effort * horizon * (GRAVITY * robot.base_height).sqrt() / distance;
    let work = motion.work();
    cost.leg_work = work.leg / (weight * distance);
    cost.swing_work = leg_mass * work.swing / (weight * distance);
    cost.swing_moment = leg_mass * work.swing_moment / (weight * robot.base_height);
    cost.tilt = work.upright.clamp(-1., 1.).acos().to_degrees();
    if weights.joint_excess > 0. {
        cost.joint_cost = weights.joint_excess * excess(trajectory, robot, part)?;
    }
    cost.total =
        weights.leg_work * cost.leg_work + weights.swing_work * cost.swing_work + weights.effort * cost.effort_cost + cost.joint_cost;
    Ok(cost)
}

/// [`Cost::distance`] of a displacement in m and a turn in rad.
pub(crate) fn distance(robot: &Robot, displacement: [f64; 3], turn: f64) -> f64 {
    let l = robot.base_height;
    (displacement.iter().map(|d| d * d).sum::<f64>().sqrt() + l * turn.abs()).max(LEAST_DISTANCE * l)
}

/// Moment that holds the trunk over the half length of a sole, N per rad of roll or pitch; 0 without soles.
pub(crate) fn trunk_force(robot: &Robot) -> f64 {
    robot.sole.map_or(0., |sole| TRUNK_MOMENT * robot.weight() * robot.base_height / sole.half_extents()[0])
}

/// Curves and phases of a foot.
struct Foot {
    motion: Vec<Piece>,
    force: Vec<Piece>,
    /// Moment of a sole; empty for other feet.
    moment: Vec<Piece>,
    phases: Vec<Phase>,
    /// Hip, base frame (x, y), m: above the nominal foothold, at base height.
    hip: [f64; 2],
}

/// Curves of a part of a trajectory.
struct Motion {
    start: f64,
    base_lin: Vec<Piece>,
    base_ang: Vec<Piece>,
    feet: Vec<Foot>,
    /// Half length of a sole, m.
    half_length: f64,
    /// See [`trunk_force`].
    trunk_force: f64,
}

/// Integrals and extremes of quantities that combine several curves.
struct Work {
    /// Work of standing legs, J.
    leg: f64,
    /// Work of swinging legs, J per kg of leg mass.
    swing: f64,
    /// Largest moment of swinging legs, N m per kg of leg mass.
    swing_moment: f64,
    /// Smallest cosine of the angle between the body's and the world's vertical.
    upright: f64,
}

impl Motion {
    fn new(trajectory: &Trajectory, robot: &Robot, part: [f64; 2]) -> Result<Motion> {
        let pieces = |curve: &Curve| -> Vec<Piece> { pieces(curve).iter().filter_map(|piece| piece.between(part)).collect() };
        let schedule = Schedule::new(trajectory.durations.clone())?;
        let feet = trajectory.ee.iter().enumerate().map(|(foot, curves)| {
            let [x, y, _] = robot.nominal_feet[foot];
            let moment = curves.moment.as_ref().map(pieces).unwrap_or_default();
            Foot { motion: pieces(&curves.motion), force: pieces(&curves.force), moment, phases: schedule.phases(foot), hip: [x, y] }
        });
        let (base_lin, base_ang) = (pieces(&trajectory.base_lin), pieces(&trajectory.base_ang));
        let half_length = robot.sole.map_or(1., |sole| sole.half_extents()[0]);
        Ok(Motion { start: part[0], feet: feet.collect(), base_lin, base_ang, half_length, trunk_force: trunk_force(robot) })
    }

    /// Quantities of single curves: speeds and accelerations of feet, the largest force in N, the effort in N² s.
    fn extremes(&self) -> Cost {
        let (mut speed, mut acceleration, mut touch_down, mut force, mut effort): (f64, f64, f64, f64, f64) = Default::default();
        for foot in &self.feet {
            for piece in &foot.force {
                let squares = Squares::new(&piece.control());
                force = squares.largest(force);
                effort += squares.mean() * piece.length;
            }
            for piece in &foot.moment {
                effort += Squares::new(&piece.control()).mean() * piece.length / (self.half_length * self.half_length);
            }
            let mut phase = 0;
            for piece in &foot.motion {
                // The acceleration is linear on a piece, so its maximum is at an end.
                acceleration = acceleration.max(piece.second(piece.start).norm()).max(piece.second(piece.end()).norm());
                speed = Squares::new(&piece.control_rate()).largest(speed);
                advance(&mut phase, &foot.phases, (piece.start + piece.end()) / 2., |p| p.end);
                let phase = &foot.phases[phase];
                if !phase.stance && (piece.end() - phase.end).abs() < SAME_TIME {
                    touch_down = touch_down.max(piece.first(piece.end()).norm());
                }
            }
        }
        for piece in self.base_ang.iter().filter(|_| self.trunk_force > 0.) {
            let tilt = piece.control().map(|angles| Vector3::new(angles.x, angles.y, 0.) * self.trunk_force);
            effort += Squares::new(&tilt).mean() * piece.length;
        }
        Cost {
            foot_speed: speed.sqrt(),
            foot_acceleration: acceleration,
            touch_down_speed: touch_down,
            peak_force: force.sqrt(),
            effort,
            ..Default::default()
        }
    }

    /// Times of all nodes of all curves, ascending, s.
    fn times(&self) -> Vec<f64> {
        let feet = self.feet.iter().flat_map(|f| [&f.motion, &f.force]);
        let mut times: Vec<f64> =
            std::iter::once(self.start).chain([&self.base_lin, &self.base_ang].into_iter().chain(feet).flatten().map(Piece::end)).collect();
        times.sort_by(f64::total_cmp);
        times.dedup_by(|b, a| *b - *a < SAME_TIME);
        times
    }

    fn work(&self) -> Work {
        let mut work = Work { leg: 0., swing: 0., swing_moment: 0., upright: 1. };
        let times = self.times();
        let (mut lin, mut ang) = (0, 0);
        // Indices of the motion piece, force piece and phase of each foot.
        let mut places = vec![[0; 3]; self.feet.len()];
        // Power along and across the leg of a standing foot; the total power in the first entry for a swinging foot.
        let mut powers = vec![[[0.; 3]; 2]; self.feet.len()];
        let steps = times.windows(2).flat_map(|w| {
            let count = ((w[1] - w[0]) / STEP).ceil();
            let half = (w[1] - w[0]) / count / 2.;
            (0..count as usize).map(move |i| (w[0] + (2 * i + 1) as f64 * half, half))
        });
        for (mid, half) in steps {
            advance(&mut lin, &self.base_lin, mid, Piece::end);
            advance(&mut ang, &self.base_ang, mid, Piece::end);
            for (foot, [motion, force, phase]) in self.feet.iter().zip(&mut places) {
                advance(motion, &foot.motion, mid, Piece::end);
                advance(force, &foot.force, mid, Piece::end);
                advance(phase, &foot.phases, mid, |p| p.end);
            }
            for (point, time) in [mid - GAUSS_3_NODE * half, mid, mid + GAUSS_3_NODE * half].into_iter().enumerate() {
                let base = Base::new(&self.base_lin[lin], &self.base_ang[ang], time);
                let mut moment = Vector3::zeros();
                for (i, (foot, &[motion, force, phase])) in self.feet.iter().zip(&places).enumerate() {
                    let (motion, hip) = (&foot.motion[motion], base.hip_velocity(foot.hip));
                    let against_hip = motion.first(time) - hip;
                    let [along, across] = &mut powers[i];
                    if foot.phases[phase].stance {
                        let force = foot.force[force].value(time);
                        let leg = motion.value(time) - base.hip(foot.hip);
                        let against_body = against_hip - base.omega.cross(&leg);
                        // A leg of zero length has no direction.
                        let leg = leg.try_normalize(LEAST_LEG).unwrap_or_default();
                        along[point] = force.dot(&leg) * against_hip.dot(&leg);
                        across[point] = force.dot(&against_body) - along[point];
                    } else {
                        let acceleration = motion.second(time);
                        moment += (motion.value(time) - base.position).cross(&acceleration);
                        (along[point], across[point]) = (acceleration.dot(&against_hip), 0.);
                    }
                }
                work.swing_moment = work.swing_moment.max(moment.norm());
                work.upright = work.upright.min(base.upright);
            }
            for (i, foot) in self.feet.iter().enumerate() {
                let done: f64 = powers[i].iter().map(|&power| absolute_integral(power, half)).sum();
                *if foot.phases[places[i][2]].stance { &mut work.leg } else { &mut work.swing } += done;
            }
        }
        work
    }
}

/// Advances an index to the item that contains a time: the first that ends after it.
fn advance<T>(index: &mut usize, items: &[T], time: f64, end: impl Fn(&T) -> f64) {
    while *index + 1 < items.len() && end(&items[*index]) < time {
        *index += 1;
    }
}

/// State of the base at one time, world frame.
struct Base {
    position: Vector3<f64>,
    velocity: Vector3<f64>,
    omega: Vector3<f64>,
    /// Axes x and y of the base.
    axes: [Vector3<f64>; 2],
    /// Cosine of the angle between the verticals of base and world.
    upright: f64,
}

impl Base {
    /// State from the pieces of position and attitude. With rotation `Rz(yaw) Ry(pitch) Rx(roll)`, `omega = roll' x_base + pitch' Rz e_y +
    /// yaw' e_z`.
    fn new(lin: &Piece, ang: &Piece, time: f64) -> Base {
        let (angle, rate) = (ang.value(time), ang.first(time));
        let ((sr, cr), (sp, cp), (sy, cy)) = (angle.x.sin_cos(), angle.y.sin_cos(), angle.z.sin_cos());
        let x = Vector3::new(cy * cp, sy * cp, -sp);
        let y = Vector3::new(cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr);
        let omega = x * rate.x + Vector3::new(-sy, cy, 0.) * rate.y + Vector3::z() * rate.z;
        Base { position: lin.value(time), velocity: lin.first(time), omega, axes: [x, y], upright: cp * cr }
    }

    fn hip(&self, hip: [f64; 2]) -> Vector3<f64> {
        self.position + self.axes[0] * hip[0] + self.axes[1] * hip[1]
    }

    fn hip_velocity(&self, hip: [f64; 2]) -> Vector3<f64> {
        self.velocity + self.omega.cross(&(self.axes[0] * hip[0] + self.axes[1] * hip[1]))
    }
}

/// Integral over \[-1, 1\], times `half`, of the absolute value of the parabola through values at the Gauss-Legendre points.
fn absolute_integral([a, b, c]: [f64; 3], half: f64) -> f64 {
    // q = b + q1 s + q2 s^2
    let (q1, q2) = ((c - a) / (2. * GAUSS_3_NODE), (a + c - 2. * b) / (2. * GAUSS_3_NODE * GAUSS_3_NODE));
    let antiderivative = |s: f64| (b + (q1 / 2. + q2 / 3. * s) * s) * s;
    // Bernstein coefficients of equal sign: no root.
    let (left, middle, right) = (b - q1 + q2, b - q2, b + q1 + q2);
    let mut cuts = [-1., -1., -1., 1.];
    if left.min(middle).min(right) < 0. && left.max(middle).max(right) > 0. {
        let discriminant = q1 * q1 - 4. * q2 * b;
        if discriminant > 0. {
            // Formula without cancellation; a root at infinity or no root is moved to an end.
            let t = -0.5 * (q1 + discriminant.sqrt().copysign(q1));
            let inside = |root: f64| if root > -1. && root < 1. { root } else { -1. };
            let roots = [inside(t / q2), inside(b / t)];
            cuts[1] = roots[0].min(roots[1]);
            cuts[2] = roots[0].max(roots[1]);
        }
    }
    cuts.windows(2).map(|w| (antiderivative(w[1]) - antiderivative(w[0])).abs()).sum::<f64>() * half
}

/// Bernstein coefficients of the squared length of a Bernstein polynomial with at most four coefficients.
#[derive(Clone, Copy)]
struct Squares {
    coefficients: [f64; 7],
    count: usize,
}

impl Squares {
    /// `c_k = sum over i + j = k of (n over i) (n over j) / (2 n over k) p_i . p_j`
    fn new(points: &[Vector3<f64>]) -> Squares {
        const BINOMIALS: [[f64; 7]; 7] = [
            [1., 0., 0., 0., 0., 0., 0.],
            [1., 1., 0., 0., 0., 0., 0.],
            [1., 2., 1., 0., 0., 0., 0.],
            [1., 3., 3., 1., 0., 0., 0.],
            [1., 4., 6., 4., 1., 0., 0.],
            [1., 5., 10., 10., 5., 1., 0.],
            [1., 6., 15., 20., 15., 6., 1.],
        ];
        let n = points.len() - 1;
        let mut coefficients = [0.; 7];
        for i in 0..=n {
            for j in 0..=n {
                coefficients[i + j] += BINOMIALS[n][i] * BINOMIALS[n][j] / BINOMIALS[2 * n][i + j] * points[i].dot(&points[j]);
            }
        }
        Squares { coefficients, count: 2 * n + 1 }
    }

    /// Mean over the piece.
    fn mean(&self) -> f64 {
        self.coefficients[..self.count].iter().sum::<f64>() / self.count as f64
    }

    /// Larger of `best` and the maximum on the piece, to nine digits.
    fn largest(&self, best: f64) -> f64 {
        self.largest_of_halves(best, 40)
    }

    /// The end coefficients are values, no value exceeds the largest coefficient, and halving closes the gap.
    fn largest_of_halves(&self, best: f64, halvings: usize) -> f64 {
        let c = &self.coefficients[..self.count];
        let best = best.max(c[0]).max(c[self.count - 1]);
        let bound = c.iter().copied().fold(0., f64::max);
        if halvings == 0 || bound <= best * (1. + 1e-9) {
            return best;
        }
        // De Casteljau's steps leave the right half in place; the left half consists of the first coefficients of every step.
        let (mut left, mut right) = (*self, *self);
        for step in 1..self.count {
            for i in 0..self.count - step {
                right.coefficients[i] = (right.coefficients[i] + right.coefficients[i + 1]) / 2.;
            }
            left.coefficients[step] = right.coefficients[0];
        }
        right.largest_of_halves(left.largest_of_halves(best, halvings - 1), halvings - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gait::FootCurves;

    fn near(got: f64, want: f64) {
        assert!((got - want).abs() <= 1e-9 * want.abs().max(1.), "{got} is not {want}");
    }

    /// Monoped of 20 kg and base height 0.58 m.
    fn monoped() -> Robot {
        Robot::named("monoped").unwrap()
    }

    fn curve(length: f64, nodes: &[[f64; 6]]) -> Curve {
        Curve { poly_durations: vec![length; nodes.len() - 1], nodes: nodes.to_vec() }
    }

    fn at(value: [f64; 3], slope: [f64; 3]) -> [f64; 6] {
        std::array::from_fn(|i| if i < 3 { value[i] } else { slope[i - 3] })
    }

    fn still(value: [f64; 3]) -> [f64; 6] {
        at(value, [0.; 3])
    }

    fn trajectory(durations: Vec<f64>, base_lin: Curve, base_ang: Curve, motion: Curve, force: Curve) -> Trajectory {
        let horizon = durations.iter().sum();
        Trajectory::new(vec![durations], horizon, [base_lin, base_ang], vec![FootCurves::new(motion, force)])
    }

    fn priced(t: &Trajectory) -> Cost {
        cost(t, &monoped(), 0.5, &CostWeights::default()).unwrap()
    }

    #[test]
    fn standing_still_costs_effort_by_time() {
        let w = monoped().weight();
        let (base, none) = (still([0., 0., 0.58]), still([0.; 3]));
        let stand = |horizon: f64| {
            let of = |node| curve(horizon, &[node, node]);
            priced(&trajectory(vec![horizon], of(base), of(none), of(none), of(still([0., 0., w]))))
        };
        let (one, two) = (stand(1.), stand(2.));
        near(one.effort, 1.);
        near(one.peak_force, 1.);
        // A tenth of 0.58 m; effort cost sqrt(g l) / 0.058 m.
        near(one.distance, 0.058);
        near(one.effort_cost, (9.80665f64 * 0.58).sqrt() / 0.058);
        near(one.total, one.effort_cost);
        near(two.total, 2. * one.total);
        assert_eq!([one.leg_work, one.swing_work, one.tilt, one.foot_speed, one.foot_acceleration, one.swing_moment], [0.; 6]);
    }

    #[test]
    fn a_squat_works_against_its_weight_down_and_up() {
        // Down by 0.1 m and up again under a constant force equal to the weight w: 2 * 0.1 m * w, over 0.058 m.
        let w = monoped().weight();
        let base = curve(0.5, &[still([0., 0., 0.58]), still([0., 0., 0.48]), still([0., 0., 0.58])]);
        let of = |node| curve(1., &[node, node]);
        let c = priced(&trajectory(vec![1.], base, of(still([0.; 3])), of(still([0.; 3])), of(still([0., 0., w]))));
        near(c.leg_work, 0.2 / 0.058);
        // Under a level body that advances by x the leg extends and the hip absorbs the same work: int w h x / (x^2 + h^2) each.
        let base = curve(0.5, &[still([0., 0., 0.58]), at([0.15, 0., 0.58], [0.45, 0., 0.]), still([0.3, 0., 0.58])]);
        let c = priced(&trajectory(vec![1.], base, of(still([0.; 3])), of(still([0.; 3])), of(still([0., 0., w]))));
        let work = 0.58 * (1. + (0.3f64 / 0.58).powi(2)).ln() / 0.3;
        assert!((c.leg_work - work).abs() < 1e-6 * work, "{} is not {work}", c.leg_work);
        near(c.distance, 0.3);
    }

    #[test]
    fn a_hip_works_while_the_body_turns_above_its_foot() {
        // Under a horizontal force of a third of the weight w the hip, 0.58 m above the foot, turns a body at rest by 0.2 rad.
        let w = monoped().weight();
        let of = |node| curve(1., &[node, node]);
        let turning = curve(1., &[at([0.; 3], [0., 0.2, 0.]), at([0., 0.2, 0.], [0., 0.2, 0.])]);
        let c = priced(&trajectory(vec![1.], of(still([0., 0., 0.58])), turning, of(still([0.; 3])), of(still([w / 3., 0., w]))));
        near(c.leg_work, 0.58 * 0.2 / 3. / 0.058);
    }

    #[test]
    fn a_force_that_changes_its_sign_does_work_in_both_directions() {
        // The base advances at 1 m/s; the force along x rises linearly from -100 to 100 N in 1 s: int |f v| = 50 J, over 1 m.
        let base = curve(1., &[at([0., 0., 0.58], [1., 0., 0.]), at([1., 0., 0.58], [1., 0., 0.])]);
        let of = |node| curve(1., &[node, node]);
        let force = curve(1., &[at([-100., 0., 0.], [200., 0., 0.]), at([100., 0., 0.], [200., 0., 0.])]);
        let c = priced(&trajectory(vec![1.], base, of(still([0.; 3])), of(still([0.; 3])), force));
        let w = monoped().weight();
        // The components along and across the leg are not parabolas.
        assert!((c.leg_work * w - 50.).abs() < 1e-4, "{}", c.leg_work * w);
        near(c.peak_force, 100. / w);
        // int (200 t - 100)^2 = 1e4 / 3.
        near(c.effort, 1e4 / 3. / (w * w));
        near(c.total, c.leg_work + c.effort * (9.80665f64 * 0.58).sqrt());
    }

    #[test]
    fn a_stiff_leg_that_vaults_does_no_work() {
        // The base moves on a circle around the foot, in short pieces, with the force along the leg.
        let (radius, rate) = (0.58, 0.8);
        let on = |f: fn(f64) -> f64, g: fn(f64) -> f64, size: f64, u: f64| [size * f(u), 0., size * g(u)];
        let node = |t: f64| {
            let [x, _, z] = on(f64::sin, f64::cos, radius, rate * t);
            at([x, 0., z], [rate * z, 0., -rate * x])
        };
        let push = |t: f64| {
            let [x, _, z] = on(f64::sin, f64::cos, 100., rate * t);
            at([x, 0., z], [rate * z, 0., -rate * x])
        };
        let times: Vec<f64> = (0..=40).map(|i| -0.4 + 0.02 * f64::from(i)).collect();
        let base = curve(0.02, &times.iter().map(|&t| node(t)).collect::<Vec<_>>());
        let force = curve(0.02, &times.iter().map(|&t| push(t)).collect::<Vec<_>>());
        let of = |node| curve(0.8, &[node, node]);
        let c = priced(&trajectory(vec![0.8], base, of(still([0.; 3])), of(still([0.; 3])), force));
        assert!(c.leg_work < 1e-5, "{}", c.leg_work);
    }

    #[test]
    fn the_work_of_parts_adds_up_to_that_of_the_motion() {
        // Even horizontal speed under a constant force for 1 s.
        let w = monoped().weight();
        let base = curve(0.5, &[at([0., 0., 0.58], [0.2, 0., 0.]), at([0.1, 0., 0.48], [0.2, 0., 0.]), at([0.2, 0., 0.58], [0.2, 0., 0.])]);
        let of = |node| curve(1., &[node, node]);
        let t = trajectory(vec![1.], base, of(still([0.; 3])), of(still([0.; 3])), of(still([0., 0., w])));
        let part = |start, end| cost_between(&t, &monoped(), 0.5, &CostWeights::default(), [start, end]).unwrap();
        let (whole, first, second) = (part(0., 1.), part(0., 0.37), part(0.37, 1.));
        near(whole.distance, 0.2);
        near(first.horizon, 0.37);
        near(first.effort, 1.);
        let work = |c: Cost| c.leg_work * c.distance;
        assert!((work(first) + work(second) - work(whole)).abs() < 1e-5 * work(whole));
        for part in [[0.5, 0.5], [-0.1, 0.5], [0.5, 1.1]] {
            assert!(cost_between(&t, &monoped(), 0.5, &CostWeights::default(), part).is_err());
        }
    }

    #[test]
    fn a_swing_along_a_known_cubic() {
        // From rest to rest over 0.4 m in 0.5 s, x = 0.4 (3 u^2 - 2 u^3), between stances of 0.25 s.
        let (far, length) = (still([0.4, 0., 0.]), 0.5);
        let of = |node| curve(1., &[node, node]);
        let motion = Curve { poly_durations: vec![0.25, length, 0.25], nodes: vec![still([0.; 3]), still([0.; 3]), far, far] };
        let base = still([0., 0., 0.58]);
        let c = priced(&trajectory(vec![0.25, length, 0.25], of(base), of(still([0.; 3])), motion, of(still([0.; 3]))));
        // Peak speed 1.5 mean speeds; acceleration 6 d / s^2 at the ends; speeding up and slowing down each cost m v^2 / 2.
        near(c.foot_speed, 1.2);
        near(c.foot_acceleration, 6. * 0.4 / 0.25);
        let work = 0.5 * 1.2 * 1.2 / (monoped().weight() * 0.058);
        assert!((c.swing_work - work).abs() < 1e-5 * work, "{} is not {work}", c.swing_work);
        assert_eq!((c.touch_down_speed, c.leg_work, c.effort), (0., 0., 0.));
        // The moment about the base, 0.58 m higher, is largest near the ends: 0.5 kg * 9.6 m/s2 * 0.58 m.
        assert!(c.swing_moment > 0.7 * 0.5 * 9.6 / monoped().weight() && c.swing_moment < 0.5 * 9.6 / monoped().weight());
    }

    #[test]
    fn the_touchdown_speed_of_a_fast_foot_is_reported() {
        let motion = Curve {
            poly_durations: vec![0.2, 0.4, 0.4],
            nodes: vec![still([0.; 3]), still([0.; 3]), at([0.1, 0., 0.], [0., 0., -0.5]), still([0.1, 0., 0.])],
        };
        let of = |node| curve(1., &[node, node]);
        let c = priced(&trajectory(vec![0.2, 0.4, 0.4], of(still([0., 0., 0.58])), of(still([0.; 3])), motion, of(still([0.; 3]))));
        near(c.touch_down_speed, 0.5);
    }

    #[test]
    fn hips_turn_with_the_base() {
        // The base yaws at 1 rad/s about the origin. Its hip moves with e_z x R (0.3, 0.2), above a foot that stands at (1, 0) under a force
        // of 10 N along x. The force has no moment about z, so the work across the leg is the opposite of that along it.
        let robot = Robot { nominal_feet: vec![[0.3, 0.2, -0.58]], ..monoped() };
        let of = |node| curve(2., &[node, node]);
        let turn = curve(2., &[at([0.; 3], [0., 0., 1.]), at([0., 0., 2.], [0., 0., 1.])]);
        let mut t = trajectory(vec![2.], of(still([0., 0., 0.58])), turn, of(still([1., 0., 0.])), of(still([10., 0., 0.])));
        // Short pieces, as in computed motions.
        let piece = |i: usize| at([0., 0., 0.05 * i as f64], [0., 0., 1.]);
        t.base_ang = curve(0.05, &(0..=40).map(piece).collect::<Vec<_>>());
        let c = cost(&t, &robot, 0.5, &CostWeights::default()).unwrap();
        // The hip is at (x, y), and the leg stretches at y / |leg|; by the midpoint rule.
        let power = |t: f64| {
            let (x, y) = (0.3 * t.cos() - 0.2 * t.sin(), 0.3 * t.sin() + 0.2 * t.cos());
            10. * (1. - x) * y / ((1. - x) * (1. - x) + y * y + 0.58 * 0.58)
        };
        let along = (0..20_000).map(|i| power((f64::from(i) + 0.5) * 1e-4) * 1e-4).sum::<f64>();
        near(c.distance, 1.16);
        let work = c.leg_work * robot.weight() * 1.16;
        assert!(along > 1. && (work - 2. * along).abs() < 1e-6, "{work} is not twice {along}");
    }

    #[test]
    fn tilt_is_the_angle_between_the_verticals() {
        let lean = at([0.3, 0.4, 1.], [0.; 3]);
        let of = |node| curve(1., &[node, node]);
        let c = priced(&trajectory(vec![1.], of(still([0., 0., 0.58])), of(lean), of(still([0.; 3])), of(still([0.; 3]))));
        near(c.tilt, (0.3f64.cos() * 0.4f64.cos()).acos().to_degrees());
    }

    #[test]
    fn maxima_inside_a_piece_are_found() {
        // Random values and slopes, compared with a fine grid.
        for seed in 0..20 {
            let r = |i: usize| ((seed * 37 + i * 101) as f64 * 0.7).sin();
            let nodes = [0, 1].map(|k| std::array::from_fn(|i| r(6 * k + i)));
            let piece = &pieces(&curve(0.7, &nodes))[0];
            let grid = (0..=10_000).map(|i| 0.7 * f64::from(i) / 10_000.);
            let value = grid.clone().map(|t| piece.value(t).norm_squared()).fold(0., f64::max);
            let speed = grid.clone().map(|t| piece.first(t).norm_squared()).fold(0., f64::max);
            let mean = grid.map(|t| piece.value(t).norm_squared()).sum::<f64>() / 10_001.;
            let (of_value, of_speed) = (Squares::new(&piece.control()), Squares::new(&piece.control_rate()));
            assert!((of_value.largest(0.) - value).abs() < 1e-6 * value && (of_speed.largest(0.) - speed).abs() < 1e-6 * speed);
            assert!((of_value.mean() - mean).abs() < 1e-3 * mean);
        }
    }

    #[test]
    fn the_absolute_integral_of_a_parabola() {
        let of = |q: fn(f64) -> f64| absolute_integral([q(-GAUSS_3_NODE), q(0.), q(GAUSS_3_NODE)], 1.);
        near(of(|_| -3.), 6.);
        near(of(|s| s), 1.);
        // Roots at +-0.5: 2 (int_0^0.5 - int_0.5^1) of 0.25 - s^2 = 2 (1/12 + 1/6).
        near(of(|s| 0.25 - s * s), 0.5);
        near(of(|s| s * s + 0.1), 2. / 3. + 0.2);
        near(of(|s| (s - 0.5) * (s - 3.)), integral(|s| ((s - 0.5) * (s - 3.)).abs()));
        assert_eq!(of(|_| 0.), 0.);
    }

    fn integral(q: fn(f64) -> f64) -> f64 {
        // Simpson's rule between -1, 0.5 and 1: exact for parabolas.
        [(-1., 0.5), (0.5, 1.)].iter().map(|&(a, b): &(f64, f64)| (b - a) / 6. * (q(a) + 4. * q((a + b) / 2.) + q(b))).sum()
    }

    #[test]
    fn other_robots_and_bad_weights_are_refused() {
        let of = |node| curve(1., &[node, node]);
        let t = trajectory(vec![1.], of(still([0., 0., 0.58])), of(still([0.; 3])), of(still([0.; 3])), of(still([0.; 3])));
        let refused = cost(&t, &Robot::named("biped").unwrap(), 0.5, &CostWeights::default()).unwrap_err().to_string();
        assert!(refused.contains("1 feet") && refused.contains("biped"));
        assert!(CostWeights { effort: f64::NAN, ..Default::default() }.validate().unwrap_err().to_string().contains("cost.effort"));
        assert!(serde_json::from_str::<CostWeights>(r#"{"effort": 1, "wings": 2}"#).is_err());
    }
}
