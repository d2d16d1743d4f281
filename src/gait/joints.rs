//! Joint trajectories: positions, velocities and torques of the legs of a robot with a joint model.
//!
//! The motion is that of a rigid body with massless legs, so the torques are those of the contact forces and moments alone, `-J' f - A' m`
//! (see [`Leg::efforts`]). The torques that accelerate and carry the legs themselves are left out. The centre of a foot's ball is straight
//! above its contact point. A sole lies on the ground and turns in swings as the certificate assumes.

use super::Trajectory;
use super::piece::{Piece, SAME_TIME, pieces};
use crate::error::{Error, Result, check_range};
use crate::robot::Robot;
use crate::robot::leg::{Leg, LegJoint, PRECISION};
use crate::terrain::Terrain;
use crate::verify::curves::Motion;
use crate::verify::sole;
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde::Serialize;
use std::fmt;

/// Default sampling rate of joints, Hz.
pub const RATE: f64 = 100.;
/// Smallest and largest sampling rate, Hz.
pub const RATES: [f64; 2] = [1., 10_000.];
/// Share of its limits that a joint may use before [`excess`] begins. The rest is a reserve for the times between the samples.
pub const IN_HAND: f64 = 0.95;
/// Half of the time over which the turning rate of a sole is a difference, s.
const TURNING: f64 = 1e-5;
/// Largest distance of a foot from its planned position, m. Equal to the distance by which the certificate lets a foot leave its reach box.
const ALLOWED_MISS: f64 = 5e-3;

/// Values of all joints at one time, ordered by foot and along each leg's chain.
#[derive(Debug, Clone, PartialEq)]
pub struct JointSample {
    /// Time, s.
    pub time: f64,
    /// Joint positions, rad, or m for a prismatic joint.
    pub positions: Vec<f64>,
    /// Joint velocities, rad/s or m/s.
    pub velocities: Vec<f64>,
    /// Joint torques or forces, N m or N, that a joint exerts on the link it moves.
    pub efforts: Vec<f64>,
}

impl JointSample {
    /// Values of a row in the order of [`JointMotion::columns`].
    pub fn values(&self) -> impl Iterator<Item = f64> {
        (0..self.positions.len()).flat_map(|joint| [self.positions[joint], self.velocities[joint], self.efforts[joint]])
    }
}

/// The value that is closest to its limit, or farthest beyond it.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Nearest {
    /// Name of the joint, or of the foot.
    pub name: String,
    /// Unit of the value and of the limit.
    pub unit: &'static str,
    /// Time, s.
    pub time: f64,
    /// Value.
    pub value: f64,
    /// Limit.
    pub limit: f64,
}

/// Joint limits and their use by a motion, at the times of the samples. An entry is `None` if no joint has such a limit.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct JointLimits {
    /// Smallest distance of a position from its nearer limit, rad or m. Positions never exceed their limits.
    pub position_margin: Option<Nearest>,
    /// Largest speed relative to its limit.
    pub velocity: Option<Nearest>,
    /// Largest torque or force relative to its limit.
    pub effort: Option<Nearest>,
    /// Largest distance of a foot from its planned position, m; for a sole with that of its attitude, at a lever of a fifth of the leg's
    /// length. It is above 0 where joints within their limits cannot bring the foot closer.
    pub miss: Nearest,
    /// True if no limit is exceeded.
    pub kept: bool,
}

impl fmt::Display for JointLimits {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let mut line = |what: &str, worst: &Option<Nearest>, say: &dyn Fn(&Nearest) -> String| match worst {
            Some(w) => writeln!(f, "  {what:<10}{}, joint {} at {:.3} s", say(w), w.name, w.time),
            None => writeln!(f, "  {what:<10}no limits"),
        };
        let distance = |w: &Nearest| format!("{:.4} {} from its limit {:.4}", (w.value - w.limit).abs(), w.unit, w.limit);
        let share =
            |w: &Nearest| format!("{:.1} % of its limit: {:.3} of {:.3} {}", 100. * w.value.abs() / w.limit, w.value, w.limit, w.unit);
        line("position", &self.position_margin, &distance)?;
        line("velocity", &self.velocity, &share)?;
        line("torque", &self.effort, &share)?;
        let Nearest { name, time, value, .. } = &self.miss;
        if *value > 0. {
            writeln!(f, "  foot {name} is out of reach by {value:.4} m at {time:.3} s")?;
        }
        writeln!(f, "  {}", if self.kept { "within all limits" } else { "beyond the limits" })
    }
}

/// Joints along a motion.
#[derive(Debug, Clone, PartialEq)]
pub struct JointMotion {
    /// Joints, in the order of the values in a sample.
    pub joints: Vec<LegJoint>,
    /// Samples at a fixed rate, and at the end.
    pub samples: Vec<JointSample>,
    /// Use of the joint limits.
    pub limits: JointLimits,
}

impl JointMotion {
    /// Names of the columns of a table, with units: position, velocity and torque of each joint.
    pub fn columns(&self) -> impl Iterator<Item = String> {
        self.joints.iter().flat_map(LegJoint::columns)
    }
}

/// Value of a joint at one time together with its limit.
#[derive(Clone, Copy)]
struct Use<'a> {
    joint: &'a LegJoint,
    time: f64,
    value: f64,
    limit: f64,
}

impl Use<'_> {
    /// Absolute value relative to the limit.
    fn share(&self) -> f64 {
        self.value.abs() / self.limit
    }

    /// Converts to [`Nearest`]. `units` are those of a revolute and of a prismatic joint.
    fn named(&self, units: [&'static str; 2]) -> Nearest {
        let Use { joint, time, value, limit } = *self;
        Nearest { name: joint.name.clone(), unit: units[usize::from(!joint.turns)], time, value, limit }
    }
}

/// Keeps the worse of two: the one with the larger measure.
fn keep<'a>(worst: &mut Option<Use<'a>>, measure: impl Fn(&Use) -> f64, new: Use<'a>) {
    if worst.as_ref().is_none_or(|old| measure(&new) > measure(old)) {
        *worst = Some(new);
    }
}

/// Computes the joint trajectories of a motion.
///
/// Each sample starts its inverse kinematics from the joints of the sample before, the first from the nominal joints, so that legs stay on
/// one branch. Velocities solve `J q' = v` with the velocity `v` of the foot relative to the base, and of a sole also its turning rate.
///
/// * `terrain` - ground, to which soles are parallel
/// * `rate` - sampling rate, Hz
///
/// # Errors
/// [`Error::Invalid`] if the robot has no joints, robot and motion disagree on the number of feet, or the rate is out of range.
pub fn follow(trajectory: &Trajectory, robot: &Robot, terrain: &Terrain, rate: f64) -> Result<JointMotion> {
    check_range("rate", rate, RATES[0], RATES[1])?;
    robot.validate()?;
    let Some(legs) = &robot.joints else {
        let limit = "the joints of its legs in its file, as `robot import` writes them";
        return Err(Error::invalid(format!("robot `{}`", robot.name.escape_debug()), "no `joints`", limit));
    };
    let motion = Course::new(trajectory, robot, terrain)?;
    let mut tracker = Tracker::new(legs);
    let samples = motion.times(rate).into_iter().map(|time| tracker.sample(&motion, time)).collect();
    let Tracker { position, velocity, effort, miss, .. } = tracker;
    let kept = [velocity, effort].iter().flatten().all(|w| w.share() <= 1.) && miss.value <= miss.limit;
    let [position, velocity, effort] = [(position, ["rad", "m"]), (velocity, ["rad/s", "m/s"]), (effort, ["N m", "N"])]
        .map(|(worst, units)| worst.map(|w| w.named(units)));
    Ok(JointMotion {
        joints: legs.iter().flat_map(|leg| leg.chain.clone()).collect(),
        samples,
        limits: JointLimits { position_margin: position, velocity, effort, miss, kept },
    })
}

/// Excess over [`IN_HAND`] of the joint limits in a part of a motion, sampled at [`RATE`]. It is the sum of three terms, each relative to
/// its limit and clamped to 0 to 1: the largest speed, the largest torque, and the largest distance of a foot from its planned position. 0
/// for a robot without joints. Soles count as level, whatever the ground.
///
/// * `part` - start and end, s
///
/// # Errors
/// [`Error::Invalid`] if the robot is invalid, or robot and motion disagree on the number of feet.
pub fn excess(trajectory: &Trajectory, robot: &Robot, [start, end]: [f64; 2]) -> Result<f64> {
    let Some(legs) = &robot.joints else { return Ok(0.) };
    robot.validate()?;
    let level = Terrain::flat();
    let motion = Course::new(trajectory, robot, &level)?;
    let mut tracker = Tracker::new(legs);
    for time in motion.times(RATE).into_iter().filter(|time| (start..=end).contains(time)) {
        tracker.sample(&motion, time);
    }
    let Tracker { velocity, effort, miss, .. } = tracker;
    let shares = [velocity, effort].into_iter().flatten().map(|w| w.share()).chain([miss.value / miss.limit]);
    Ok(shares.map(|share| (share - IN_HAND).clamp(0., 1.)).sum())
}

/// Use of the joint limits by a motion, sampled at [`RATE`]; `None` if the robot has no joints.
///
/// # Errors
/// See [`follow`].
pub fn limits(trajectory: &Trajectory, robot: &Robot, terrain: &Terrain) -> Result<Option<JointLimits>> {
    robot.joints.as_ref().map(|_| Ok(follow(trajectory, robot, terrain, RATE)?.limits)).transpose()
}

/// Curves of a trajectory as pieces, for a robot that fits it.
struct Course<'a> {
    horizon: f64,
    base_lin: Vec<Piece>,
    base_ang: Vec<Piece>,
    /// Position and force of each foot.
    feet: Vec<[Vec<Piece>; 2]>,
    /// Moments of each foot, the whole motion and the ground; for soles only.
    soles: Option<(Vec<Vec<Piece>>, Motion<'a>, &'a Terrain)>,
}

/// Planned state of a sole at one time, world frame.
struct SolePlan {
    attitude: UnitQuaternion<f64>,
    /// Angular velocity, rad/s.
    spin: Vector3<f64>,
    /// Moment of the ground about its centre, N m.
    moment: Vector3<f64>,
}

/// State of the base at one time, world frame.
struct Base {
    position: Vector3<f64>,
    velocity: Vector3<f64>,
    /// Base to world.
    rotation: Rotation3<f64>,
    omega: Vector3<f64>,
}

impl<'a> Course<'a> {
    fn new(trajectory: &'a Trajectory, robot: &'a Robot, terrain: &'a Terrain) -> Result<Course<'a>> {
        trajectory.validate()?;
        trajectory.check_feet(robot)?;
        let feet = trajectory.ee.iter().map(|curves| [pieces(&curves.motion), pieces(&curves.force)]).collect();
        let (base_lin, base_ang) = (pieces(&trajectory.base_lin), pieces(&trajectory.base_ang));
        let moments = || trajectory.ee.iter().map(|curves| curves.moment.as_ref().map_or_else(Vec::new, pieces)).collect();
        let soles = robot.sole.map(|_| Ok::<_, Error>((moments(), Motion::new(trajectory, robot)?, terrain))).transpose()?;
        Ok(Course { horizon: trajectory.horizon, base_lin, base_ang, feet, soles })
    }

    /// Planned state of a sole; `None` for a ball or point.
    fn sole(&self, foot: usize, time: f64) -> Option<SolePlan> {
        let (moments, motion, terrain) = self.soles.as_ref()?;
        let attitude = |time: f64| {
            let [forward, left] = sole::posture(&motion.feet[foot], terrain, time).axes;
            Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[forward, left, forward.cross(&left)]))
        };
        let [before, after] = [(time - TURNING).max(0.), (time + TURNING).min(self.horizon)];
        // As a quaternion: rounding of a small rotation matrix can raise its trace above 3, for which the angle of the matrix is NaN.
        let spin = UnitQuaternion::from(attitude(after) * attitude(before).inverse()).scaled_axis() / (after - before);
        Some(SolePlan { attitude: attitude(time).into(), spin, moment: Piece::at(&moments[foot], time)[0] })
    }

    /// Sample times from 0 to the horizon, which is always the last, s.
    fn times(&self, rate: f64) -> Vec<f64> {
        let before = |&time: &f64| time < self.horizon - SAME_TIME;
        (0u32..).map(|i| f64::from(i) / rate).take_while(before).chain([self.horizon]).collect()
    }

    /// State of the base. With rotation `Rz(yaw) Ry(pitch) Rx(roll)`, `omega = roll' x_base + pitch' Rz e_y + yaw' e_z`.
    fn base(&self, time: f64) -> Base {
        let [position, velocity] = Piece::at(&self.base_lin, time);
        let [angle, rate] = Piece::at(&self.base_ang, time);
        let rotation = Rotation3::from_euler_angles(angle.x, angle.y, angle.z);
        let (sin, cos) = angle.z.sin_cos();
        let (roll_axis, pitch_axis) = (rotation.matrix().column(0).into_owned(), Vector3::new(-sin, cos, 0.));
        Base { position, velocity, rotation, omega: roll_axis * rate.x + pitch_axis * rate.y + Vector3::z() * rate.z }
    }
}

/// Joints of the previous sample, and the worst values so far.
struct Tracker<'a> {
    legs: &'a [Leg],
    joints: Vec<Vec<f64>>,
    position: Option<Use<'a>>,
    velocity: Option<Use<'a>>,
    effort: Option<Use<'a>>,
    miss: Nearest,
}

impl<'a> Tracker<'a> {
    fn new(legs: &'a [Leg]) -> Self {
        let miss = Nearest { name: String::new(), unit: "m", time: 0., value: 0., limit: ALLOWED_MISS };
        Tracker { legs, joints: legs.iter().map(Leg::nominal).collect(), position: None, velocity: None, effort: None, miss }
    }

    /// Computes the joints at a time.
    fn sample(&mut self, motion: &Course, time: f64) -> JointSample {
        let base = motion.base(time);
        let to_base = base.rotation.inverse();
        let omega = to_base * base.omega;
        let mut sample = JointSample { time, positions: vec![], velocities: vec![], efforts: vec![] };
        for (foot, leg) in self.legs.iter().enumerate() {
            let [path, force] = &motion.feet[foot];
            let [place, velocity] = Piece::at(path, time);
            let contact = to_base * (place - base.position);
            let center = to_base * (place + Vector3::z() * leg.radius - base.position);
            let sole = motion.sole(foot, time);
            let attitude = |sole: &SolePlan| UnitQuaternion::from(to_base) * sole.attitude;
            let (joints, missed) = match &sole {
                Some(sole) => leg.approach_sole(&Isometry3::from_parts(center.into(), attitude(sole)), &self.joints[foot]),
                None => leg.approach(&center, &self.joints[foot]),
            };
            if missed > PRECISION && missed > self.miss.value {
                self.miss = Nearest { name: leg.foot.clone(), time, value: missed, ..self.miss };
            }
            let at = leg.posture(&joints);
            let against_base = to_base * (velocity - base.velocity) - omega.cross(&center);
            let rates = match &sole {
                Some(sole) => leg.sole_rates(&at, &against_base, &(to_base * sole.spin - omega)),
                None => leg.rates(&at, &against_base),
            };
            let moment = sole.map_or(Vector3::zeros(), |sole| to_base * sole.moment);
            let efforts = leg.efforts(&at, &contact, &(to_base * Piece::at(force, time)[0]), &moment);
            for (j, joint) in leg.chain.iter().enumerate() {
                self.look(joint, time, [joints[j], rates[j], efforts[j]]);
            }
            self.joints[foot].clone_from(&joints);
            sample.positions.extend(joints);
            sample.velocities.extend(rates);
            sample.efforts.extend(efforts);
        }
        sample
    }

    /// Compares a joint's values with its limits.
    fn look(&mut self, joint: &'a LegJoint, time: f64, [position, velocity, effort]: [f64; 3]) {
        let used = |value: f64, limit: f64| Use { joint, time, value, limit };
        for limit in joint.limits.into_iter().filter(|limit| limit.is_finite()) {
            keep(&mut self.position, |w| -(w.value - w.limit).abs(), used(position, limit));
        }
        joint.velocity.into_iter().for_each(|limit| keep(&mut self.velocity, |w| w.share(), used(velocity, limit)));
        joint.effort.into_iter().for_each(|limit| keep(&mut self.effort, |w| w.share(), used(effort, limit)));
    }
}

#[cfg(all(test, feature = "urdf"))]
pub(crate) mod tests {
    use super::*;
    use crate::gait::{Curve, FootCurves};
    use crate::robot::import::{Import, configuration};
    use crate::terrain::{Grid, Shape};

    /// The quadruped of the import tests, standing.
    pub fn quadruped() -> Robot {
        let values = ["LF", "RF", "LH", "RH"].map(|leg| format!("{leg}_pitch=0.7854,{leg}_knee=-1.5708")).join(",");
        let import = Import { configuration: configuration(&values).unwrap(), ..Import::default() };
        import.urdf(include_str!("../../tests/data/quadruped.urdf")).unwrap().robot
    }

    /// Half a second in which the base moves and turns while feet 0 and 3 are in stance and the others swing.
    pub fn motion(robot: &Robot) -> Trajectory {
        let curve = |from: [f64; 6], to: [f64; 6]| Curve { poly_durations: vec![0.5], nodes: vec![from, to] };
        let h = robot.base_height;
        let base =
            [curve([0., 0., h, 0.1, 0., 0.], [0.04, 0.01, h - 0.02, 0.1, 0.05, -0.1]), curve([0.; 6], [0.05, -0.04, 0.1, 0.1, 0., 0.2])];
        let foot = |f: usize| {
            let [x, y, _] = robot.nominal_feet[f];
            let swings = f == 1 || f == 2;
            let to = if swings { [x + 0.06, y, 0.03, 0.3, 0., 0.] } else { [x, y, 0., 0., 0., 0.] };
            let push = if swings { [0.; 6] } else { [5., -3., robot.weight() / 2., 0., 0., 0.] };
            FootCurves::new(curve([x, y, 0., 0., 0., 0.], to), curve(push, push))
        };
        Trajectory::new(vec![vec![0.5]; 4], 0.5, base, (0..4).map(foot).collect())
    }

    #[test]
    fn joints_place_the_feet_as_planned_and_velocities_match_the_positions() {
        let robot = quadruped();
        let trajectory = motion(&robot);
        let rate = 2000.;
        let found = follow(&trajectory, &robot, &Terrain::flat(), rate).unwrap();
        let legs = robot.joints.as_ref().unwrap();
        assert_eq!((found.samples.len(), found.joints.len()), (1001, 12));
        assert!(found.limits.miss.value == 0. && found.limits.kept, "{:?}", found.limits);
        let motion = Motion::new(&trajectory, &robot).unwrap();
        for sample in found.samples.iter().step_by(100) {
            let base = motion.base(sample.time);
            for (foot, leg) in legs.iter().enumerate() {
                let tip = leg.posture(&sample.positions[3 * foot..3 * foot + 3]).tip;
                let contact = base.position + base.rotation * tip - Vector3::z() * leg.radius;
                assert!((contact - motion.feet[foot].motion.at(sample.time).value).norm() < 2. * PRECISION);
            }
        }
        for three in found.samples.windows(3).take(998) {
            for j in 0..12 {
                let difference = (three[2].positions[j] - three[0].positions[j]) * rate / 2.;
                // The tolerance covers the precision of the positions over the lever arm, and the third derivative.
                assert!((difference - three[1].velocities[j]).abs() < 2e-2, "joint {j}: {difference} and {}", three[1].velocities[j]);
            }
        }
    }

    #[test]
    fn torques_do_the_virtual_work_of_the_contact_force() {
        // Virtual work: effort . dq = -f . dx for every joint displacement, x the contact point under a ball that does not rotate.
        let mut robot = quadruped();
        robot.joints.as_mut().unwrap().iter_mut().for_each(|leg| leg.radius = 0.);
        robot.nominal_feet.iter_mut().for_each(|foot| foot[2] += 0.02);
        robot.base_height -= 0.02;
        let trajectory = motion(&robot);
        let found = follow(&trajectory, &robot, &Terrain::flat(), 20.).unwrap();
        let legs = robot.joints.as_ref().unwrap();
        let motion = Motion::new(&trajectory, &robot).unwrap();
        for sample in &found.samples {
            let to_base = motion.base(sample.time).rotation.inverse();
            for (foot, leg) in legs.iter().enumerate() {
                let force = to_base * motion.feet[foot].force.at(sample.time).value;
                let q = &sample.positions[3 * foot..3 * foot + 3];
                for j in 0..3 {
                    let moved = |d: f64| leg.posture(&std::array::from_fn::<f64, 3, _>(|i| q[i] + if i == j { d } else { 0. })).tip;
                    let work = -force.dot(&(moved(1e-6) - moved(-1e-6))) / 2e-6;
                    assert!((work - sample.efforts[3 * foot + j]).abs() < 1e-6 * robot.weight(), "foot {foot}, joint {j}");
                }
            }
        }
    }

    /// The humanoid of the import tests, and 0.5 s in which its base moves and turns while foot 0 stands and foot 1 swings and turns.
    fn humanoid() -> (Robot, Trajectory) {
        let robot = Import::default().urdf(include_str!("../../tests/data/humanoid.urdf")).unwrap().robot;
        let curve = |durations: &[f64], nodes: &[[f64; 6]]| Curve { poly_durations: durations.to_vec(), nodes: nodes.to_vec() };
        let h = robot.base_height;
        let base = [
            curve(&[0.5], &[[0., 0., h, 0.1, 0., 0.], [0.04, 0.01, h + 0.01, 0.1, 0.05, -0.1]]),
            curve(&[0.5], &[[0.; 6], [0.03, -0.04, 0.1, 0.1, 0., 0.2]]),
        ];
        let [[lx, ly, _], [rx, ry, _]] = [robot.nominal_feet[0], robot.nominal_feet[1]];
        let (place, load) = ([lx, ly, 0., 0., 0., 0.], [5., -3., robot.weight(), 0., 10., 0.]);
        let mut left = FootCurves::new(curve(&[0.5], &[place, place]), curve(&[0.5], &[load, load]));
        left.moment = Some(curve(&[0.5], &[[2., -7., 1., 0., 0., 3.], [-1., 4., 0.5, 0., 0., 0.]]));
        left.yaws = Some(vec![0.05]);
        let [from, to] = [[rx, ry, 0., 0., 0., 0.], [rx + 0.06, ry - 0.02, 0., 0., 0., 0.]];
        let (times, top) = ([0.1, 0.15, 0.15, 0.1], [rx + 0.03, ry - 0.01, 0.04, 0.2, 0., 0.]);
        let mut right = FootCurves::new(curve(&times, &[from, from, top, to, to]), curve(&times, &[[0.; 6]; 5]));
        right.moment = Some(curve(&times, &[[0.; 6]; 5]));
        right.yaws = Some(vec![0., 0.15]);
        let feet = vec![left, right];
        let trajectory = Trajectory::new(vec![vec![0.5], vec![0.1, 0.3, 0.1]], 0.5, base, feet);
        (robot, trajectory)
    }

    #[test]
    fn joints_hold_soles_on_the_ground_with_their_yaws_and_velocities_match_the_positions() {
        let (robot, trajectory) = humanoid();
        let rate = 2000.;
        // Samples at x = -1 and 1.
        let heights = vec![vec![-0.2; 2], vec![0.2; 2]];
        let uphill = Shape::Grid(Grid { low: [-1., -2.], high: [3., 2.], heights });
        for terrain in [Terrain::flat(), Terrain { shape: uphill, ..Terrain::flat() }] {
            let found = follow(&trajectory, &robot, &terrain, rate).unwrap();
            assert!(found.joints.len() == 12 && found.limits.miss.value == 0., "{:?}", found.limits);
            let motion = Motion::new(&trajectory, &robot).unwrap();
            let up = sole::posture(&motion.feet[0], &terrain, 0.2).axes[0].z;
            assert_eq!(up > 0.19, matches!(terrain.shape, Shape::Grid(_)), "{up}");
            for sample in found.samples.iter().step_by(50) {
                let base = motion.base(sample.time);
                for (foot, leg) in robot.joints.as_ref().unwrap().iter().enumerate() {
                    let at = leg.posture(&sample.positions[6 * foot..6 * foot + 6]);
                    assert!(
                        (base.position + base.rotation * at.tip - motion.feet[foot].motion.at(sample.time).value).norm() < 2. * PRECISION
                    );
                    let planned = sole::posture(&motion.feet[foot], &terrain, sample.time).axes;
                    for (axis, planned) in [Vector3::x(), Vector3::y()].into_iter().zip(planned) {
                        assert!((base.rotation * (at.attitude * axis) - planned).norm() < 2e-5);
                    }
                }
            }
            for three in found.samples.windows(3).take(998) {
                for j in 0..12 {
                    let difference = (three[2].positions[j] - three[0].positions[j]) * rate / 2.;
                    assert!((difference - three[1].velocities[j]).abs() < 2e-2, "joint {j}: {difference} and {}", three[1].velocities[j]);
                }
            }
        }
    }

    #[test]
    fn torques_do_the_virtual_work_of_the_force_and_the_moment_on_a_sole() {
        // Virtual work: effort . dq = -f . dx - m . dr for every joint displacement, x the centre of the sole, dr its rotation.
        let (robot, trajectory) = humanoid();
        let found = follow(&trajectory, &robot, &Terrain::flat(), 20.).unwrap();
        let motion = Motion::new(&trajectory, &robot).unwrap();
        let mut largest: f64 = 0.;
        for sample in &found.samples {
            let to_base = motion.base(sample.time).rotation.inverse();
            for (foot, leg) in robot.joints.as_ref().unwrap().iter().enumerate() {
                let curves = &motion.feet[foot];
                let (force, moment) = (to_base * curves.force.at(sample.time).value, curves.moment.as_ref().unwrap());
                let moment = to_base * moment.at(sample.time).value;
                let q = &sample.positions[6 * foot..6 * foot + 6];
                for j in 0..6 {
                    let moved = |d: f64| leg.posture(&std::array::from_fn::<f64, 6, _>(|i| q[i] + if i == j { d } else { 0. }));
                    let (after, before) = (moved(1e-6), moved(-1e-6));
                    let turned = (after.attitude * before.attitude.inverse()).scaled_axis();
                    let work = -(force.dot(&(after.tip - before.tip)) + moment.dot(&turned)) / 2e-6;
                    assert!((work - sample.efforts[6 * foot + j]).abs() < 1e-6 * robot.weight(), "foot {foot}, joint {j}");
                    largest = largest.max(moment.dot(&turned).abs() / 2e-6);
                }
            }
        }
        assert!(largest > 5., "the moments act on the joints: {largest}");
    }

    #[test]
    fn an_exceeded_limit_is_reported_with_its_joint() {
        let mut robot = quadruped();
        let trajectory = motion(&robot);
        let free = follow(&trajectory, &robot, &Terrain::flat(), RATE).unwrap();
        let worst = free.limits.velocity.clone().unwrap();
        let share = |s: &JointSample| s.velocities.iter().map(|v| v.abs() / 12.).fold(0., f64::max);
        assert_eq!(worst.value.abs() / 12., free.samples.iter().map(share).fold(0., f64::max));
        // Limits below the speed and the torque of the motion, and a knee that cannot fold far enough.
        let effort = free.limits.effort.clone().unwrap();
        assert!(free.limits.kept && excess(&trajectory, &robot, [0., 0.5]).unwrap() == 0.);
        for (change, part) in [
            (&|joint: &mut LegJoint| joint.velocity = Some(worst.value.abs() * 0.9), 0),
            (&|joint: &mut LegJoint| joint.effort = Some(effort.value.abs() * 0.9), 1),
        ] as [(&dyn Fn(&mut LegJoint), usize); 2]
        {
            let mut weak = robot.clone();
            weak.joints.as_mut().unwrap().iter_mut().flat_map(|leg| &mut leg.chain).for_each(change);
            let limits = follow(&trajectory, &weak, &Terrain::flat(), RATE).unwrap().limits;
            // 1 / 0.9 of the limit, in the part of the motion where it occurs only.
            let from = |start: f64| excess(&trajectory, &weak, [start, 0.5]).unwrap();
            let more = 1. / 0.9 - IN_HAND;
            assert!((from(0.) - more).abs() < 1e-12 && (from([worst.time, effort.time][part] + 0.02) < more), "{}", from(0.));
            let reported = [limits.velocity, limits.effort][part].clone().unwrap();
            assert!(!limits.kept && reported.value.abs() > reported.limit && reported.name == [&worst, &effort][part].name);
        }
        let knee = &mut robot.joints.as_mut().unwrap()[1].chain[2];
        knee.limits[0] = knee.nominal;
        let stiff = follow(&trajectory, &robot, &Terrain::flat(), RATE).unwrap().limits;
        assert!(!stiff.kept && stiff.miss.value > ALLOWED_MISS && stiff.miss.name == "RF_foot", "{stiff:?}");
        assert!(excess(&trajectory, &robot, [0., 0.5]).unwrap() > 0.05);
        assert!(stiff.position_margin.unwrap().name == "RF_knee");
    }

    #[test]
    fn a_robot_without_joints_or_with_other_feet_is_refused() {
        let robot = quadruped();
        let trajectory = motion(&robot);
        let refused = |robot: &Robot, rate: f64| follow(&trajectory, robot, &Terrain::flat(), rate).unwrap_err().to_string();
        assert!(refused(&Robot::named("anymal").unwrap(), RATE).contains("no `joints`"));
        assert!(refused(&robot, 0.).contains("rate: 0") && refused(&robot, f64::NAN).contains("rate"));
        let mut odd = robot.clone();
        odd.joints.as_mut().unwrap().pop();
        assert!(refused(&odd, RATE).contains("robot.joints: 3 legs"));
        odd.nominal_feet.pop();
        odd.reach = crate::robot::Reach::Symmetric([0.1; 3]);
        assert!(refused(&odd, RATE).contains("ee: 4 feet"));
        assert!(excess(&trajectory, &odd, [0., 0.5]).is_err());
        assert_eq!(excess(&trajectory, &Robot::named("anymal").unwrap(), [0., 0.5]).unwrap(), 0.);
    }

    #[test]
    fn joints_survive_json_and_toml_bit_for_bit_and_bad_ones_are_named() {
        let robot = quadruped();
        let json = serde_json::to_string(&robot).unwrap();
        assert_eq!(Robot::from_json(&json).unwrap(), robot);
        for (from, to, parts) in [
            ("\"axis\":[1.0,0.0,0.0]", "\"axis\":[0,0,0]", &["joints[0].chain[0]", "`LF_roll`, axis", "not all zero"][..]),
            ("\"lower\":-0.6", "\"lower\":0.7", &["robot.joints[0].chain[0].lower", "0.7", "0.6"]),
            ("\"velocity\":12.0", "\"velocity\":0", &["robot.joints[0].chain[0].velocity", "0"]),
            ("\"type\":\"revolute\"", "\"type\":\"ball\"", &["joints[0].chain[0].type", "ball"]),
            ("\"nominal\":0.0", "\"nominal\":1", &["robot.joints[0].chain[0].nominal", "0.6"]),
        ] {
            let changed = json.replacen(from, to, 1);
            assert_ne!(changed, json, "{from}");
            let error = Robot::from_json(&changed).unwrap_err().to_string();
            assert!(parts.iter().all(|part| error.contains(part)), "{error}");
        }
        assert_eq!(crate::error::from_toml::<Robot>(&crate::error::to_toml(&robot).unwrap()).unwrap(), robot);
    }
}
