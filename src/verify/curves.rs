//! Curves of a trajectory as the check evaluates them: base, feet and forces at any time.

use crate::error::Result;
use crate::gait::{Curve, FootCurves, Trajectory};
use crate::robot::{GRAVITY, Robot, Slab};
use crate::terrain::Terrain;
use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::Serialize;

/// Times closer than this count as equal, s. Sums of durations differ in their last digits between programs.
pub(crate) const SAME_TIME: f64 = 1e-6;

/// Maximum of a quantity over the trajectory, never negative; infinite if the quantity was NaN at some time.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Extreme {
    /// The value, in the unit of the field.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub value: f64,
    /// First time at which it occurs, s.
    pub time: f64,
    /// Foot at which it occurs; `None` for the base, or if the value is zero.
    pub foot: Option<usize>,
}

impl Extreme {
    pub(super) fn update(&mut self, value: f64, foot: Option<usize>, time: f64) {
        let value = if value.is_nan() { f64::INFINITY } else { value };
        if value > self.value {
            *self = Extreme { value, time, foot };
        }
    }
}

/// Formats a number with few digits, with an exponent only if it is very small or very large.
pub(crate) fn readable(value: f64) -> String {
    if value == 0. || (1e-3..1e6).contains(&value) { format!("{value:.3}") } else { format!("{value:.2e}") }
}

/// Value and derivatives of a curve at one time.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Point {
    /// Value.
    pub value: Vector3<f64>,
    /// First derivative.
    pub first: Vector3<f64>,
    /// Second derivative.
    pub second: Vector3<f64>,
}

/// Hermite curve with the times of its nodes.
pub(crate) struct TimedCurve<'a> {
    /// The curve.
    pub curve: &'a Curve,
    /// Times of the nodes, s.
    pub times: Vec<f64>,
    /// Coefficients of each piece, see [`TimedCurve::cubic`].
    cubics: Vec<[Vector3<f64>; 4]>,
}

impl<'a> TimedCurve<'a> {
    fn new(curve: &'a Curve) -> Self {
        let mut times = vec![0.];
        let mut end = 0.;
        for duration in &curve.poly_durations {
            end += duration;
            times.push(end);
        }
        let pieces = curve.nodes.windows(2).zip(&curve.poly_durations);
        let cubics = pieces.map(|(nodes, &length)| cubic(&nodes[0], &nodes[1], length)).collect();
        TimedCurve { curve, times, cubics }
    }

    /// Value of a node.
    pub fn value(&self, node: usize) -> Vector3<f64> {
        value(&self.curve.nodes[node])
    }

    /// Slope of a node.
    pub fn slope(&self, node: usize) -> Vector3<f64> {
        slope(&self.curve.nodes[node])
    }

    /// Point at a time, which is clamped to the curve. At a node the piece that ends there counts, as in TOWR.
    pub fn at(&self, time: f64) -> Point {
        // The slack selects the same side of a node if its time is a sum of other durations.
        let after = self.times[1..].partition_point(|&end| end < time - 1e-9);
        let piece = after.min(self.curve.poly_durations.len() - 1);
        self.on_piece(piece, time - self.times[piece])
    }

    /// Point of a piece at `t` s after its start, clamped to the piece.
    pub fn on_piece(&self, piece: usize, t: f64) -> Point {
        self.beyond(piece, t.clamp(0., self.length(piece)))
    }

    /// Point of the cubic of a piece at `t` s after its start, also after its end.
    pub fn beyond(&self, piece: usize, t: f64) -> Point {
        let [a, b, c, d] = self.cubic(piece);
        Point { value: a + (b + (c + d * t) * t) * t, first: b + (c * 2. + d * (3. * t)) * t, second: c * 2. + d * (6. * t) }
    }

    /// `[a, b, c, d]` of a piece, `a + b t + c t^2 + d t^3` at `t` s after its start: the cubic through both nodes with their slopes.
    pub fn cubic(&self, piece: usize) -> [Vector3<f64>; 4] {
        self.cubics[piece]
    }

    /// Index of the piece that contains a time.
    pub fn piece_around(&self, time: f64) -> usize {
        self.times[1..].partition_point(|&end| end < time).min(self.pieces() - 1)
    }

    /// Number of pieces.
    pub fn pieces(&self) -> usize {
        self.curve.poly_durations.len()
    }

    /// Applies a function to the piece that contains a time.
    pub fn on<T>(&self, time: f64, f: impl Fn(&Curve, usize) -> T) -> T {
        f(self.curve, self.piece_around(time))
    }

    /// Length of a piece, s.
    pub fn length(&self, piece: usize) -> f64 {
        self.curve.poly_durations[piece]
    }
}

fn value(node: &[f64; 6]) -> Vector3<f64> {
    Vector3::new(node[0], node[1], node[2])
}

fn slope(node: &[f64; 6]) -> Vector3<f64> {
    Vector3::new(node[3], node[4], node[5])
}

/// The cubic through two nodes, see [`TimedCurve::cubic`].
fn cubic(from: &[f64; 6], to: &[f64; 6], length: f64) -> [Vector3<f64>; 4] {
    let (a, b, next) = (value(from), slope(from), slope(to));
    // Differences first, so that a standing foot has exactly zero velocity.
    let mean = (value(to) - a) / length;
    let c = (mean * 3. - b * 2. - next) / length;
    let d = (b + next - mean * 2.) / (length * length);
    [a, b, c, d]
}

/// Curves of a foot and its phases.
pub(crate) struct FootMotion<'a> {
    /// Position, m.
    pub motion: TimedCurve<'a>,
    /// Force, N.
    pub force: TimedCurve<'a>,
    /// Moment of a sole, N m.
    pub moment: Option<TimedCurve<'a>>,
    /// Yaw of a sole in each stance, rad.
    pub yaws: Option<&'a [f64]>,
    /// Times at which the contact changes, s; the first phase is a stance, which has no length if the foot is in the air at the start. The
    /// last time is after the horizon if the foot is in the air there.
    pub switches: Vec<f64>,
    /// True if the foot is in the air at the start.
    pub lifted: bool,
    /// Position in each stance phase, m.
    footholds: Vec<Vector3<f64>>,
}

impl<'a> FootMotion<'a> {
    fn new(curves: &'a FootCurves, durations: &[f64]) -> Self {
        let (motion, force) = (TimedCurve::new(&curves.motion), TimedCurve::new(&curves.force));
        let mut starts = vec![0.];
        let mut end = 0.;
        for duration in durations {
            end += duration;
            starts.push(end);
        }
        starts.pop();
        // Taken from the node, not the curve: a node on an edge of the terrain must stay on its side of the edge.
        let footholds = starts.iter().step_by(2).map(|&start| motion.value(nearest(&motion.times, start))).collect();
        starts.remove(0);
        let lifted = durations.len() > 1 && durations[0] == 0.;
        let (moment, yaws) = (curves.moment.as_ref().map(TimedCurve::new), curves.yaws.as_deref());
        FootMotion { motion, force, moment, yaws, switches: starts, lifted, footholds }
    }

    /// First and last phase that a time belongs to: two neighbours at a switch, otherwise twice the same phase. Stance phases are even.
    pub fn phases(&self, time: f64) -> (usize, usize) {
        let first = self.switches.partition_point(|&s| s < time - SAME_TIME).max(usize::from(self.lifted));
        (first, self.switches.partition_point(|&s| s <= time + SAME_TIME))
    }

    /// Times of lift-off and touchdown of every swing, or of the start and the end of the motion in that swing, s.
    pub fn swings(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        let end = self.end();
        self.switches.chunks_exact(2).map(move |swing| [swing[0], swing[1].min(end)])
    }

    /// Start and end of a phase, s; the end is after the horizon for a swing that lands later.
    pub fn phase_bounds(&self, phase: usize) -> [f64; 2] {
        let at = |i: usize| self.switches.get(i).copied().unwrap_or(self.end());
        [if phase == 0 { 0. } else { at(phase - 1) }, at(phase)]
    }

    /// Position in a stance, m.
    ///
    /// * `stance` - index among the stances; after the last one, that of the last
    pub fn stance_place(&self, stance: usize) -> Vector3<f64> {
        self.footholds[stance.min(self.footholds.len() - 1)]
    }

    /// Yaw of a sole in the stance phase at a time, rad; 0 in a swing and for a foot without a sole.
    pub fn yaw(&self, time: f64) -> f64 {
        let (first, last) = self.phases(time);
        let stance = [first, last].into_iter().find(|phase| phase % 2 == 0);
        stance.zip(self.yaws).and_then(|(phase, yaws)| yaws.get(phase / 2)).copied().unwrap_or(0.)
    }

    /// End of the motion, s.
    pub fn end(&self) -> f64 {
        self.motion.times[self.motion.times.len() - 1]
    }

    /// True if one of [`FootMotion::swings`] ends with the foot in the air, because it lands after the end of the motion.
    pub fn lands_later(&self, swing: [f64; 2]) -> bool {
        swing[1] == self.end() && self.switches.last().is_some_and(|&last| last > self.end() + SAME_TIME)
    }

    /// Position of the node at a time, m. At an edge of the terrain the curve may lie on the other side of the edge.
    pub fn place(&self, time: f64) -> Vector3<f64> {
        self.motion.value(nearest(&self.motion.times, time))
    }

    /// Foothold of the stance phase at a time, m; `None` during a swing.
    pub fn foothold(&self, time: f64) -> Option<Vector3<f64>> {
        let (first, last) = self.phases(time);
        [first, last].into_iter().find(|phase| phase % 2 == 0).map(|stance| self.footholds[stance / 2])
    }
}

/// Index of the time nearest to another, in an ascending list.
pub(super) fn nearest(times: &[f64], time: f64) -> usize {
    let after = times.partition_point(|&t| t < time).min(times.len() - 1);
    let before = after.saturating_sub(1);
    if (times[before] - time).abs() < (times[after] - time).abs() { before } else { after }
}

/// Normal and tangents of the terrain under a foothold, unit vectors.
///
/// `n ~ (-h_x, -h_y, 1)`, `t1 ~ (1, 0, h_x)`, `t2 ~ (0, 1, h_y)`; on a slope along both axes t1 and t2 are not orthogonal, as in TOWR.
pub(crate) struct ContactAxes {
    pub normal: Vector3<f64>,
    pub tangents: [Vector3<f64>; 2],
}

impl ContactAxes {
    pub fn new(terrain: &Terrain, foothold: Vector3<f64>) -> Self {
        let [hx, hy] = terrain.ground(foothold.x, foothold.y).slope;
        ContactAxes {
            normal: Vector3::new(-hx, -hy, 1.).normalize(),
            tangents: [Vector3::new(1., 0., hx).normalize(), Vector3::new(0., 1., hy).normalize()],
        }
    }
}

/// State of the base at one time, world frame.
pub(crate) struct DenseState {
    pub position: Vector3<f64>,
    pub velocity: Vector3<f64>,
    pub acceleration: Vector3<f64>,
    /// Base to world.
    pub rotation: Rotation3<f64>,
    pub omega: Vector3<f64>,
    pub omega_dot: Vector3<f64>,
}

/// Trajectory laid out in time, with a robot that has its number of feet.
pub(crate) struct Motion<'a> {
    pub robot: &'a Robot,
    pub horizon: f64,
    pub base_lin: TimedCurve<'a>,
    pub base_ang: TimedCurve<'a>,
    pub feet: Vec<FootMotion<'a>>,
}

impl<'a> Motion<'a> {
    pub fn new(trajectory: &'a Trajectory, robot: &'a Robot) -> Result<Self> {
        trajectory.validate()?;
        if trajectory.ee.len() != robot.feet() {
            let limit = format!("{} feet, as the robot `{}` has", robot.feet(), robot.name);
            return Err(crate::error::Error::invalid("ee", format!("{} feet", trajectory.ee.len()), limit));
        }
        let curves = trajectory.ee.iter().zip(&trajectory.durations);
        for (foot, curves) in trajectory.ee.iter().enumerate() {
            if curves.yaws.is_some() != robot.sole.is_some() {
                let [have, limit] = if robot.sole.is_some() { ["absent", "present"] } else { ["present", "absent"] };
                let what = format!("{limit}: the robot `{}` has {}", robot.name, if robot.sole.is_some() { "soles" } else { "no soles" });
                return Err(crate::error::Error::invalid(format!("ee[{foot}].yaws"), have, what));
            }
        }
        let feet = curves.map(|(e, d)| FootMotion::new(e, d)).collect();
        let (base_lin, base_ang) = (TimedCurve::new(&trajectory.base_lin), TimedCurve::new(&trajectory.base_ang));
        Ok(Motion { robot, horizon: trajectory.horizon, base_lin, base_ang, feet })
    }

    /// Times 0, `1 / rate`, `2 / rate`, ... and the horizon, s.
    ///
    /// * `rate` - Hz, positive
    pub fn times(&self, rate: f64) -> Vec<f64> {
        let before = |&time: &f64| time < self.horizon - SAME_TIME;
        (0u32..).map(|i| f64::from(i) / rate).take_while(before).chain([self.horizon]).collect()
    }

    /// State of the base at a time.
    ///
    /// The Euler angles turn about the axes `a_yaw = e_z`, `a_pitch = Rz e_y`, `a_roll = Rz Ry e_x`:
    /// `w = roll' a_roll + pitch' a_pitch + yaw' a_yaw`. Each axis is rotated by the angles before it.
    pub fn base(&self, time: f64) -> DenseState {
        let lin = self.base_lin.at(time);
        let ang = self.base_ang.at(time);
        let (angle, rate, rate_dot) = (ang.value, ang.first, ang.second);
        let rotation = Rotation3::from_euler_angles(angle.x, angle.y, angle.z);
        let (sin, cos) = angle.z.sin_cos();
        let a_yaw = Vector3::z();
        let a_pitch = Vector3::new(-sin, cos, 0.);
        let a_roll = rotation.matrix().column(0).into_owned();
        let a_pitch_dot = (a_yaw * rate.z).cross(&a_pitch);
        let a_roll_dot = (a_yaw * rate.z + a_pitch * rate.y).cross(&a_roll);
        DenseState {
            position: lin.value,
            velocity: lin.first,
            acceleration: lin.second,
            rotation,
            omega: a_roll * rate.x + a_pitch * rate.y + a_yaw * rate.z,
            omega_dot: a_roll * rate_dot.x + a_pitch * rate_dot.y + a_yaw * rate_dot.z + a_pitch_dot * rate.y + a_roll_dot * rate.x,
        }
    }

    /// Inertia in the base frame, kg m².
    pub fn inertia(&self) -> Matrix3<f64> {
        Matrix3::from_fn(|r, c| self.robot.inertia[r][c])
    }

    /// Residuals of the rigid body, world frame: moment `I_w wdot + w x I_w w - sum (x_i - p) x f_i`, N m, and force `m pddot - sum f_i + m
    /// g e_z`, N.
    pub fn defect(&self, base: &DenseState, time: f64) -> (Vector3<f64>, Vector3<f64>) {
        let rotation = base.rotation.matrix();
        let inertia = rotation * self.inertia() * rotation.transpose();
        let mut moment = inertia * base.omega_dot + base.omega.cross(&(inertia * base.omega));
        let mut force = (base.acceleration + Vector3::z() * GRAVITY) * self.robot.mass;
        for foot in &self.feet {
            let f = foot.force.at(time).value;
            moment -= (foot.motion.at(time).value - base.position).cross(&f);
            moment -= foot.moment.as_ref().map_or(Vector3::zeros(), |m| m.at(time).value);
            force -= f;
        }
        (moment, force)
    }

    /// Distances of a foot outside each slab of its reach, m; negative inside. The first three are along the axes of the base.
    pub fn reach_excess(&self, base: &DenseState, foot: usize, position: Vector3<f64>) -> impl Iterator<Item = f64> {
        let in_base = base.rotation.inverse() * (position - base.position);
        let from_nominal = in_base - Vector3::from(self.robot.nominal_feet[foot]);
        let outside = move |slab: Slab| {
            let (value, [low, high]) = (Vector3::from(slab.normal).dot(&from_nominal), slab.sides);
            if value.is_nan() { value } else { (low - value).max(value - high) }
        };
        let reach = self.robot.reach.foot(foot).into_owned();
        (0..reach.count()).map(move |number| outside(reach.slab(number)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_piece_is_the_cubic_through_its_nodes() {
        // p = 1 - 2 t + 3 t^2 - 4 t^3 over 0.5 s; the z component is constant.
        let (p, v) = (|t: f64| 1. - 2. * t + 3. * t * t - 4. * t * t * t, |t: f64| -2. + 6. * t - 12. * t * t);
        let node = |t: f64| [p(t), 0., 7., v(t), 0., 0.];
        let curve = Curve { poly_durations: vec![0.2, 0.3], nodes: vec![node(0.), node(0.2), node(0.5)] };
        let timed = TimedCurve::new(&curve);
        for t in [0., 0.1, 0.2, 0.37, 0.5] {
            let at = timed.at(t);
            assert!((at.value.x - p(t)).abs() < 1e-14 && (at.first.x - v(t)).abs() < 1e-13, "t = {t}");
            assert!((at.second.x - (6. - 24. * t)).abs() < 1e-12, "t = {t}");
            assert_eq!((at.value.z, at.first.z, at.second.z), (7., 0., 0.));
        }
        assert_eq!(timed.at(-1.).value, timed.at(0.).value);
        assert_eq!(timed.at(9.).value, timed.at(0.5).value);
    }

    #[test]
    fn at_a_node_the_earlier_piece_gives_the_acceleration() {
        let curve = Curve { poly_durations: vec![0.1; 2], nodes: vec![[0.; 6], [1., 0., 0., 0., 0., 0.], [0.; 6]] };
        let timed = TimedCurve::new(&curve);
        assert!(timed.at(0.1).second.x < 0. && timed.at(0.1 + 1e-12).second.x < 0.);
        assert_eq!(timed.at(0.1).second, timed.on_piece(0, 0.1).second);
        assert_eq!([-1., 0.04, 0.06, 0.2, 3.].map(|t| nearest(&timed.times, t)), [0, 0, 1, 2, 2]);
    }

    #[test]
    fn angular_velocity_and_acceleration_match_the_rotation() {
        let robot = Robot::named("monoped").unwrap();
        let still = Curve { poly_durations: vec![1.], nodes: vec![[0.; 6]; 2] };
        let turning = Curve { poly_durations: vec![1.], nodes: vec![[0.3, -0.4, 2., 1., 2., -3.], [0.9, 0.6, -1., -2., 1., 0.5]] };
        let motion =
            Motion { robot: &robot, horizon: 1., base_lin: TimedCurve::new(&still), base_ang: TimedCurve::new(&turning), feet: vec![] };
        let d = 1e-5;
        for t in [0.2, 0.5, 0.9] {
            let (before, now, after) = (motion.base(t - d), motion.base(t), motion.base(t + d));
            let angles = motion.base_ang.at(t).value;
            assert!((now.rotation.matrix() - Rotation3::from_euler_angles(angles.x, angles.y, angles.z).matrix()).norm() < 1e-14);
            // R' = [w]x R
            let spin = (after.rotation.matrix() - before.rotation.matrix()) / (2. * d) * now.rotation.matrix().transpose();
            assert!((Vector3::new(spin[(2, 1)], spin[(0, 2)], spin[(1, 0)]) - now.omega).norm() < 1e-8);
            assert!(((after.omega - before.omega) / (2. * d) - now.omega_dot).norm() < 1e-7);
        }
    }

    #[test]
    fn an_extreme_keeps_the_first_maximum_and_turns_nan_into_infinity() {
        let mut e = Extreme::default();
        e.update(-1., Some(1), 0.1);
        assert_eq!(e, Extreme::default());
        e.update(2., Some(1), 0.2);
        e.update(2., Some(3), 0.3);
        assert_eq!((e.value, e.time, e.foot), (2., 0.2, Some(1)));
        e.update(f64::NAN, None, 0.4);
        assert_eq!((e.value, e.time), (f64::INFINITY, 0.4));
    }
}
