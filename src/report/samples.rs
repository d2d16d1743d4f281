//! A motion sampled in time, for pictures and exports. Values come from the trajectory's exact curves.

use crate::error::Result;
use crate::gait::{Schedule, Trajectory};
use crate::robot::{Robot, Sole};
use crate::terrain::Terrain;
use crate::verify::curves::{ContactAxes, Motion};
use crate::verify::sole;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// One colour per foot, distinguishable with most colour vision deficiencies (after Okabe and Ito), the same in every picture.
pub const FOOT_COLORS: [&str; crate::robot::MAX_FEET] =
    ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5230", "#6b6b6b"];

/// Smallest normal force for which the use of friction is reported, in weights. Below it the quotient of two small forces is meaningless.
const LOADED: f64 = 0.01;

/// A motion that can be evaluated at any time.
pub struct Sampler<'a> {
    motion: Motion<'a>,
    terrain: &'a Terrain,
    schedule: Schedule,
}

/// State at one time, world frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Time, s.
    pub time: f64,
    /// Base.
    pub base: BaseSample,
    /// Feet.
    pub feet: Vec<FootSample>,
}

/// State of the base, which is the centre of mass.
#[derive(Debug, Clone, PartialEq)]
pub struct BaseSample {
    /// Position, world frame, m.
    pub position: [f64; 3],
    /// Velocity, world frame, m/s.
    pub velocity: [f64; 3],
    /// Roll, pitch, yaw, rad; base to world is `Rz(yaw) Ry(pitch) Rx(roll)`.
    pub angles: [f64; 3],
    /// Unit quaternion w, x, y, z of the same rotation. Its sign is chosen so that it is close to the previous sample's, if there is one.
    pub quaternion: [f64; 4],
    /// Angular velocity, world frame, rad/s.
    pub angular_velocity: [f64; 3],
    /// Acceleration, world frame, m/s². At a node of the curve that of the piece that ends there.
    pub acceleration: [f64; 3],
    /// Angular acceleration, world frame, rad/s².
    pub angular_acceleration: [f64; 3],
}

/// State of a foot.
#[derive(Debug, Clone, PartialEq)]
pub struct FootSample {
    /// Position, world frame, m.
    pub position: [f64; 3],
    /// Velocity, world frame, m/s.
    pub velocity: [f64; 3],
    /// True in stance. At a phase change the phase that begins counts.
    pub stance: bool,
    /// Force of the ground on the foot, world frame, N.
    pub force: [f64; 3],
    /// Component of the force along the terrain normal, N; 0 in swing.
    pub normal_force: f64,
    /// Use of friction, `|t.f| / (mu n.f)`: 1 is the edge of the friction cone. `None` if the normal force is below a hundredth of the
    /// weight.
    pub friction_use: Option<f64>,
    /// Sole; `None` for a ball or point.
    pub sole: Option<SoleSample>,
}

impl FootSample {
    /// Point at which the force acts, world frame, m: the centre of pressure of a sole, otherwise the position of the foot.
    pub fn force_origin(&self) -> [f64; 3] {
        self.sole.as_ref().and_then(|sole| sole.pressure).unwrap_or(self.position)
    }
}

/// State of a sole, world frame.
#[derive(Debug, Clone, PartialEq)]
pub struct SoleSample {
    /// Moment of the ground on the foot about the centre of the sole, N m.
    pub moment: [f64; 3],
    /// Unit vectors from heel to toe, and to the left.
    pub axes: [[f64; 3]; 2],
    /// Centre of pressure, m; `None` if the normal force is below a hundredth of the weight.
    pub pressure: Option<[f64; 3]>,
}

impl SoleSample {
    /// Yaw of the sole, rad.
    pub fn yaw(&self) -> f64 {
        self.axes[0][1].atan2(self.axes[0][0])
    }

    /// Unit quaternion w, x, y, z from the sole to the world.
    pub fn quaternion(&self) -> [f64; 4] {
        let [x, y] = self.axes.map(Vector3::from);
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, x.cross(&y)]));
        let turn = UnitQuaternion::from_rotation_matrix(&rotation);
        [turn.w, turn.i, turn.j, turn.k]
    }
}

/// A stance phase.
#[derive(Debug, Clone, PartialEq)]
pub struct Stance {
    /// Start and end, s.
    pub times: [f64; 2],
    /// Foothold, world frame, m.
    pub foothold: [f64; 3],
    /// Terrain normal at the foothold, unit.
    pub normal: [f64; 3],
    /// Corners of a sole in order around it, world frame, m; empty for a ball or point.
    pub corners: Vec<[f64; 3]>,
}

impl<'a> Sampler<'a> {
    /// Prepares a trajectory for sampling.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] if the trajectory is malformed, or robot and trajectory disagree on the number of feet.
    pub fn new(trajectory: &'a Trajectory, robot: &'a Robot, terrain: &'a Terrain) -> Result<Sampler<'a>> {
        Ok(Sampler { motion: Motion::new(trajectory, robot)?, terrain, schedule: Schedule::new(trajectory.durations.clone())? })
    }

    /// Samples at a fixed rate from time 0, and at the horizon.
    ///
    /// * `rate` - Hz, positive
    pub fn samples(&self, rate: f64) -> Vec<Sample> {
        let mut samples: Vec<Sample> = Vec::new();
        for time in self.motion.times(rate) {
            let mut sample = self.at(time);
            if let Some(last) = samples.last() {
                let dot: f64 = sample.base.quaternion.iter().zip(&last.base.quaternion).map(|(a, b)| a * b).sum();
                if dot < 0. {
                    sample.base.quaternion = sample.base.quaternion.map(|v| -v);
                }
            }
            samples.push(sample);
        }
        samples
    }

    /// State at a time, s.
    pub fn at(&self, time: f64) -> Sample {
        let base = self.motion.base(time);
        let quaternion = UnitQuaternion::from_rotation_matrix(&base.rotation);
        let weight = self.motion.robot.weight();
        let feet = self.motion.feet.iter().map(|foot| {
            let (place, force) = (foot.motion.at(time), foot.force.at(time).value);
            let stance = foot.phases(time).1.is_multiple_of(2);
            let foothold = if stance { foot.foothold(time) } else { None };
            let normal = foothold.map(|foothold| ContactAxes::new(self.terrain, foothold).normal);
            let normal_force = normal.map_or(0., |n| n.dot(&force));
            let sideways = normal.map_or(0., |n| (force - n * normal_force).norm());
            let loaded = normal_force > LOADED * weight;
            let sole = foot.moment.as_ref().map(|moment| {
                let (moment, at) = (moment.at(time).value, sole::posture(foot, self.terrain, time));
                let [along, aside] = at.axes;
                let pressure = || at.centre + (aside * moment.dot(&along) - along * moment.dot(&aside)) / normal_force;
                SoleSample { moment: moment.into(), axes: at.axes.map(Into::into), pressure: loaded.then(|| pressure().into()) }
            });
            FootSample {
                position: place.value.into(),
                velocity: place.first.into(),
                stance,
                force: force.into(),
                normal_force,
                sole,
                friction_use: loaded.then(|| sideways / (self.terrain.friction * normal_force)),
            }
        });
        Sample {
            time,
            base: BaseSample {
                position: base.position.into(),
                velocity: base.velocity.into(),
                angles: self.motion.base_ang.at(time).value.into(),
                quaternion: [quaternion.w, quaternion.i, quaternion.j, quaternion.k],
                angular_velocity: base.omega.into(),
                acceleration: base.acceleration.into(),
                angular_acceleration: base.omega_dot.into(),
            },
            feet: feet.collect(),
        }
    }

    /// Stance phases of a foot.
    pub fn stances(&self, foot: usize) -> Vec<Stance> {
        let stances = self.schedule.phases(foot).into_iter().filter(|phase| phase.stance && phase.duration() > 0.);
        let place = |time: f64| self.motion.feet[foot].foothold(time).unwrap_or_else(|| self.motion.feet[foot].motion.at(time).value);
        stances
            .map(|phase| {
                let foothold: Vector3<f64> = place((phase.start + phase.end) / 2.);
                let normal = ContactAxes::new(self.terrain, foothold).normal;
                let at = |shape: &Sole| {
                    let at = sole::posture(&self.motion.feet[foot], self.terrain, (phase.start + phase.end) / 2.);
                    [[1., 1.], [1., -1.], [-1., -1.], [-1., 1.]].map(|share| at.point(shape, share).into()).to_vec()
                };
                let corners = self.motion.robot.sole.as_ref().map(at).unwrap_or_default();
                Stance { times: [phase.start, phase.end], foothold: foothold.into(), normal: normal.into(), corners }
            })
            .collect()
    }

    /// Number of feet.
    pub fn feet(&self) -> usize {
        self.motion.feet.len()
    }
}

/// Short names of the feet by position: L and R; LF, RF, LH, RH for fore and hind; LM and RM between them. Falls back to `foot 0`, `foot
/// 1`, ... if two names would be equal or a name cannot be formed.
pub fn foot_names(robot: &Robot) -> Vec<String> {
    let mut rows: Vec<f64> = robot.nominal_feet.iter().map(|p| p[0]).collect();
    rows.sort_by(|a, b| b.total_cmp(a));
    rows.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
    let row_names: &[&str] = match rows.len() {
        1 => &[""],
        2 => &["F", "H"],
        3 => &["F", "M", "H"],
        _ => &[],
    };
    let name = |&[x, y, _]: &[f64; 3]| {
        let row = rows.iter().position(|r| (r - x).abs() < 1e-6).and_then(|row| row_names.get(row))?;
        let side = if y.abs() < 1e-6 {
            ""
        } else if y > 0. {
            "L"
        } else {
            "R"
        };
        Some(format!("{side}{row}")).filter(|name| !name.is_empty())
    };
    let names: Option<Vec<String>> = robot.nominal_feet.iter().map(name).collect();
    let distinct = |names: &Vec<String>| names.iter().collect::<std::collections::BTreeSet<_>>().len() == names.len();
    names.filter(distinct).unwrap_or_else(|| (0..robot.feet()).map(|foot| format!("foot {foot}")).collect())
}

/// Length, width and height of the box that represents the body in pictures, m. A robot's description has no body size.
pub fn body_size(robot: &Robot) -> [f64; 3] {
    let leg = robot.leg_height();
    let extent = |axis: usize| robot.nominal_feet.iter().map(|p| p[axis].abs()).fold(0., f64::max);
    // A robot with all feet in one row has an upright body.
    let height = if extent(0) < 0.2 * leg { 0.5 } else { 0.26 };
    [(2. * extent(0) + 0.1 * leg).max(0.4 * leg), (1.2 * extent(1)).max(0.4 * leg), height * leg]
}

/// Points where the legs meet the body box, base frame, m.
pub fn hips(robot: &Robot) -> Vec<[f64; 3]> {
    let half = body_size(robot)[1] / 2.;
    robot.nominal_feet.iter().map(|&[x, y, _]| [x, y.clamp(-half, half), 0.]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gait::{Curve, FootCurves};
    use crate::robot::ROBOTS;

    /// A monoped that stands for 0.4 s, hops for 0.2 s and stands again on sloping ground.
    fn hop() -> (Trajectory, Robot, Terrain) {
        let curve = |durations: &[f64], nodes: &[[f64; 6]]| Curve { poly_durations: durations.to_vec(), nodes: nodes.to_vec() };
        let base = curve(&[1.], &[[0., 0., 0.6, 1., 0., 0.], [1., 0., 0.6, 1., 0., 0.]]);
        let angles = curve(&[1.], &[[0.1, -0.2, 3.0, 0., 0., 0.5], [0.1, -0.2, 3.5, 0., 0., 0.5]]);
        let (from, to) = ([0., 0., 0.], [1., 0., 0.5]);
        let still = |[x, y, z]: [f64; 3]| [x, y, z, 0., 0., 0.];
        let motion = curve(&[0.4, 0.2, 0.4], &[still(from), still(from), still(to), still(to)]);
        let push = [-20., 10., 100., 0., 0., 0.];
        let force = curve(&[0.4, 0.2, 0.4], &[push, [0.; 6], [0.; 6], push]);
        let trajectory = Trajectory::new(vec![vec![0.4, 0.2, 0.4]], 1., [base, angles], vec![FootCurves::new(motion, force)]);
        let heights = (0..4).map(|i| vec![0.5 * f64::from(i) - 0.5; 4]).collect();
        let shape = crate::terrain::Shape::Grid(crate::terrain::Grid { low: [-1., -2.], high: [3., 2.], heights });
        (trajectory, Robot::named("monoped").unwrap(), Terrain { name: "ramp".into(), friction: 0.8, shape })
    }

    #[test]
    fn a_sample_holds_the_values_of_the_curves() {
        let (trajectory, robot, terrain) = hop();
        let sampler = Sampler::new(&trajectory, &robot, &terrain).unwrap();
        let at = sampler.at(0.);
        assert_eq!(at.base.position, [0., 0., 0.6]);
        assert_eq!(at.base.angles, [0.1, -0.2, 3.0]);
        assert!((at.base.angular_velocity[2] - 0.5).abs() < 1e-12);
        // The ground has slope 1/2: n = (-1, 0, 2) / sqrt 5.
        let normal_force = (20. + 200.) / 5f64.sqrt();
        assert!((at.feet[0].normal_force - normal_force).abs() < 1e-9);
        let sideways = (20f64.powi(2) + 10f64.powi(2) + 100f64.powi(2) - normal_force.powi(2)).sqrt();
        assert!((at.feet[0].friction_use.unwrap() - sideways / (0.8 * normal_force)).abs() < 1e-9);
        let swing = sampler.at(0.5);
        assert!(!swing.feet[0].stance && swing.feet[0].normal_force == 0. && swing.feet[0].friction_use.is_none());
        let [x, y, z] = swing.feet[0].position;
        assert!((x - 0.5).abs() < 1e-12 && y == 0. && (z - 0.25).abs() < 1e-12 && (swing.base.position[0] - 0.5).abs() < 1e-12);
        assert!((swing.feet[0].velocity[0] - 7.5).abs() < 1e-12);
        // At a phase change the phase that begins counts.
        assert!(!sampler.at(0.4).feet[0].stance && sampler.at(0.6).feet[0].stance && sampler.at(1.).feet[0].stance);
    }

    #[test]
    fn samples_begin_at_0_and_end_at_the_horizon_and_quaternions_do_not_jump() {
        let (trajectory, robot, terrain) = hop();
        let sampler = Sampler::new(&trajectory, &robot, &terrain).unwrap();
        let times = |rate: f64| sampler.samples(rate).iter().map(|sample| sample.time).collect::<Vec<_>>();
        assert_eq!(times(4.), [0., 0.25, 0.5, 0.75, 1.]);
        assert_eq!((times(3.).len(), times(3.).last()), (4, Some(&1.)));
        // Yaw passes pi during the motion.
        let samples = sampler.samples(50.);
        for pair in samples.windows(2) {
            let dot: f64 = pair[0].base.quaternion.iter().zip(&pair[1].base.quaternion).map(|(a, b)| a * b).sum();
            assert!(dot > 0.99, "at {} s", pair[1].time);
        }
        let stances = sampler.stances(0);
        assert_eq!(stances.iter().map(|s| s.foothold).collect::<Vec<_>>(), [[0.; 3], [1., 0., 0.5]]);
        assert!((stances[1].times[0] - 0.6).abs() < 1e-12 && stances[1].times[1] == 1.);
    }

    #[test]
    fn feet_are_named_by_side_and_row() {
        let names = |name: &str| foot_names(&Robot::named(name).unwrap());
        assert_eq!(names("anymal"), ["LF", "RF", "LH", "RH"]);
        assert_eq!(names("pexod"), ["LF", "RF", "LM", "RM", "LH", "RH"]);
        assert_eq!(names("biped"), ["L", "R"]);
        assert_eq!(names("monoped"), ["foot 0"]);
        assert!(ROBOTS.iter().all(|robot| names(robot).len() == Robot::named(robot).unwrap().feet()));
        let mut robot = Robot::named("anymal").unwrap();
        robot.nominal_feet[1] = robot.nominal_feet[0];
        assert_eq!(foot_names(&robot)[3], "foot 3");
    }
}
