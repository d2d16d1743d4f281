//! Certified motions of a data set: their lines in a file of gaits, and their rows in both tables.

use super::draw::{Draw, Drawn};
use super::table::{Table, Values};
use crate::app::label::{Provenance, label};
use crate::app::terms::{TermOverrides, VerificationTerms};
use crate::app::world::World;
use crate::error::{Error, Result, from_json};
use crate::export::{Sampled, column_names, csv};
use crate::gait::cost::{Cost, CostWeights, cost};
use crate::gait::joints::{JointMotion, Nearest, follow};
use crate::gait::trajectory::Trajectory;
use crate::report::samples::{Sample, Sampler};
use crate::robot::Robot;
use crate::robot::leg::LegJoint;
use crate::search::atlas::{REPEATS, mismatch};
use crate::search::evaluate::{Evaluated, LowerSettings};
use crate::verify::Report;
use nalgebra::{UnitQuaternion, Vector3};
use serde::Deserialize;

/// Number of instants at which motions are compared.
pub(super) const COMPARED: usize = 9;
/// Largest difference of two motions that count as the same: positions relative to the height of the base, angles in rad.
pub const SAME_MOTION: f32 = 0.02;

/// Largest difference between both ends of a stride that repeats, m, rad, m/s and rad/s. Rates of Euler angles, which [`REPEATS`] bounds,
/// differ from angular velocities by a few percent.
const MOST_APART: f64 = 2. * REPEATS;

/// Columns of the command.
const COMMAND: [&str; 3] = ["command_forward_m/s", "command_sideways_m/s", "command_yaw_rad/s"];

/// Part of a line beside the trajectory.
#[derive(Deserialize)]
struct Line {
    draw: Drawn,
}

/// A motion with everything that a data set states about it.
#[derive(Debug, Clone)]
pub struct Record {
    /// Draw that it came from.
    pub drawn: Drawn,
    /// Motion with its robot and ground.
    pub trajectory: Trajectory,
    /// Name of the ground.
    pub ground: String,
    /// Cost of the whole motion.
    pub cost: Cost,
    /// Certificate.
    pub report: Report,
    /// Rows of the frames, in the order of [`Record::columns_of`].
    pub frames: Vec<Vec<f64>>,
    /// Use of the joint limits; `None` for a robot without joints.
    pub joints: Option<JointUse>,
    /// Largest difference between both ends of its stride that repeats, see [`MOST_APART`]; 0 without one.
    apart: f64,
    /// Pose and feet at a few instants, for comparisons.
    pub fingerprint: Vec<f32>,
}

/// Largest shares of the limits of joints, and largest distance of a foot from its planned position, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointUse {
    /// Speed relative to its limit; 0 without limits.
    pub velocity: f64,
    /// Torque relative to its limit; 0 without limits.
    pub effort: f64,
    /// Distance, m.
    pub miss: f64,
    /// True if the joints bring every foot close enough to its planned position.
    pub attained: bool,
}

/// Reason for which a draw has no record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dropped {
    /// The solve failed, or the motion has no certificate.
    Infeasible,
    /// Joints exceed their limits, or do not attain the motion.
    Joints,
}

impl Record {
    /// Record of a solved draw, or the reason to drop it.
    ///
    /// * `joint_limits` - true to drop motions beyond a limit of a joint
    ///
    /// # Errors
    /// Errors of the certificate and of the export, which a feasible motion does not have.
    pub fn new(
        draw: &Draw,
        evaluated: &Evaluated,
        settings: &LowerSettings,
        [rate, interval]: [f64; 2],
        seed: u64,
        joint_limits: bool,
    ) -> Result<std::result::Result<Record, Dropped>> {
        if !evaluated.feasible {
            return Ok(Err(Dropped::Infeasible));
        }
        let motion = evaluated.trajectory(&draw.task, &settings.transcription);
        if let Some(stride) = &draw.task.stride
            && mismatch(&motion, stride, interval) > REPEATS
        {
            return Ok(Err(Dropped::Infeasible));
        }
        let record = Record::of(label(motion, &draw.task, Provenance::default(), Some(seed)), draw.drawn.clone(), rate)?;
        if record.frames.iter().flatten().any(|value| !value.is_finite()) {
            return Ok(Err(Dropped::Joints));
        }
        let beyond = |used: JointUse| !used.attained || joint_limits && used.velocity.max(used.effort) > 1.;
        Ok(if !record.report.feasible || record.check_loop().is_err() {
            Err(Dropped::Infeasible)
        } else if record.joints.is_some_and(beyond) {
            Err(Dropped::Joints)
        } else {
            Ok(record)
        })
    }

    /// Certifies, samples and prices a motion.
    ///
    /// # Errors
    /// Errors of the certificate, of the export and of the joints.
    pub fn of(trajectory: Trajectory, drawn: Drawn, rate: f64) -> Result<Record> {
        let world = World::of(None, None, None);
        let terms = VerificationTerms::new(&world, &trajectory, &TermOverrides::default())?;
        let report = terms.verify()?;
        let (robot, terrain) = (terms.robot.clone(), terms.terrain.clone());
        let cost = cost(&trajectory, &robot, robot.leg_mass(), &CostWeights::default())?;
        let sampled = Sampled::new(&trajectory, &robot, &terrain, rate)?;
        let joints = robot.joints.as_ref().map(|_| follow(&trajectory, &robot, &terrain, rate)).transpose()?;
        let row = |(i, sample): (usize, &Sample)| {
            let mut row = csv::row(sample);
            row.push(drawn.stride.at(sample.time));
            row.extend(drawn.command);
            row.extend(joints.iter().flat_map(|joints| joints.samples[i].values()));
            row
        };
        let frames = sampled.samples.iter().enumerate().map(row).collect();
        let sampler = Sampler::new(&trajectory, &robot, &terrain)?;
        let fingerprint = fingerprint(&sampler, trajectory.horizon, &robot);
        let apart = drawn.repeats.map_or(0., |times| apart(&sampler, times));
        let ground = terrain.name.clone();
        Ok(Record { drawn, trajectory, ground, cost, report, frames, joints: joints.map(|j| used(&j)), apart, fingerprint })
    }

    /// Record of a motion whose certificate and stride hold.
    ///
    /// # Errors
    /// Errors of [`Record::of`] and [`Record::check_loop`]; [`Error::Invalid`] if rows of the certificate are violated.
    pub fn certified(trajectory: Trajectory, drawn: Drawn, rate: f64) -> Result<Record> {
        let record = Record::of(trajectory, drawn, rate)?;
        record.check_loop()?;
        if !record.report.feasible {
            let value = format!("{} of {} rows violated", record.report.n_violated, record.report.n_rows);
            return Err(Error::invalid("certificate", value, "feasible"));
        }
        Ok(record)
    }

    /// Checks that the motion at the end of its stride that repeats is that at the start, moved by the displacement of the base.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the largest difference.
    pub fn check_loop(&self) -> Result<()> {
        let Some([start, end]) = self.drawn.repeats.filter(|_| self.apart > MOST_APART) else { return Ok(()) };
        let place = format!("stride from {start} s to {end} s");
        Err(Error::invalid(place, format!("ends that are {} apart", self.apart), format!("at most {MOST_APART} apart")))
    }

    /// Name of the ground and fingerprint of a motion.
    ///
    /// # Errors
    /// Errors of [`VerificationTerms::new`] and of the export.
    pub fn print(trajectory: &Trajectory) -> Result<(String, Vec<f32>)> {
        let terms = VerificationTerms::new(&World::of(None, None, None), trajectory, &TermOverrides::default())?;
        let sampler = Sampler::new(trajectory, &terms.robot, &terms.terrain)?;
        Ok((terms.terrain.name.clone(), fingerprint(&sampler, trajectory.horizon, &terms.robot)))
    }

    /// Names of the columns of a robot's frames.
    pub fn columns_of(robot: &Robot) -> Vec<String> {
        let joints = robot.joints.iter().flatten().flat_map(|leg| &leg.chain);
        let mut columns = csv::header(&column_names(robot), robot.sole.is_some());
        columns.extend(std::iter::once("phase").chain(COMMAND).map(String::from));
        columns.extend(joints.flat_map(LegJoint::columns));
        columns
    }

    /// Reads a line of a file of gaits: its motion and draw.
    ///
    /// # Errors
    /// [`Error::Format`] for malformed JSON; [`Error::Invalid`] for impossible numbers.
    pub fn read(line: &str) -> Result<(Trajectory, Drawn)> {
        Ok((Trajectory::from_json(line)?, from_json::<Line>(line)?.draw))
    }

    /// Line of the file of gaits: the trajectory as `verify` reads it, and the draw as the key `draw`.
    ///
    /// # Errors
    /// [`Error::Format`] for numbers that JSON cannot represent.
    pub fn line(&self) -> Result<String> {
        let mut value = serde_json::to_value(&self.trajectory)?;
        value["draw"] = serde_json::to_value(&self.drawn)?;
        Ok(value.to_string() + "\n")
    }

    /// True if another motion of the same robot on the same ground is nearly this one.
    pub fn is_same(fingerprint: &[f32], other: &[f32]) -> bool {
        fingerprint.len() == other.len() && fingerprint.iter().zip(other).all(|(a, b)| (a - b).abs() <= SAME_MOTION)
    }
}

/// Largest difference of the motion between two times, m, rad, m/s and rad/s; positions of feet relative to the base.
fn apart(sampler: &Sampler, times: [f64; 2]) -> f64 {
    let [from, to] = times.map(|time| sampler.at(time));
    let moved = |a: &[f64; 3], b: &[f64; 3]| Vector3::from(*b) - Vector3::from(*a);
    let (one, other) = (&from.base, &to.base);
    let displacement = moved(&one.position, &other.position);
    let rates = [(one.velocity, other.velocity), (one.angles, other.angles), (one.angular_velocity, other.angular_velocity)];
    let feet = from.feet.iter().zip(&to.feet).map(|(a, b)| (moved(&a.position, &b.position) - displacement).amax());
    rates.iter().map(|(a, b)| moved(a, b).amax()).chain(feet).fold(0., f64::max)
}

fn used(joints: &JointMotion) -> JointUse {
    let limits = &joints.limits;
    let share = |worst: &Option<Nearest>| worst.as_ref().map_or(0., |w| w.value.abs() / w.limit);
    let miss = limits.miss.value;
    JointUse { velocity: share(&limits.velocity), effort: share(&limits.effort), miss, attained: miss <= limits.miss.limit }
}

/// Position of the base and its feet relative to its height, and its attitude as a rotation vector, at a few instants.
fn fingerprint(sampler: &Sampler, horizon: f64, robot: &Robot) -> Vec<f32> {
    let at = |i: usize| {
        let sample = sampler.at(horizon * i as f64 / (COMPARED - 1) as f64);
        let [roll, pitch, yaw] = sample.base.angles;
        let turn: [f64; 3] = UnitQuaternion::from_euler_angles(roll, pitch, yaw).scaled_axis().into();
        let places = std::iter::once(sample.base.position).chain(sample.feet.iter().map(|foot| foot.position));
        places.flatten().map(|v| v / robot.base_height).chain(turn).map(|v| v as f32).collect::<Vec<f32>>()
    };
    (0..COMPARED).flat_map(at).collect()
}

/// Table of the frames of motions: `motion`, `frame`, and the columns of the records.
pub fn frames(records: &[Record], columns: &[String]) -> Table {
    let mut table = Table::default();
    let numbers = |records: &[Record], number: &dyn Fn(usize, usize) -> i32| {
        records.iter().enumerate().flat_map(|(m, r)| (0..r.frames.len()).map(move |f| (m, f))).map(|(m, f)| number(m, f)).collect()
    };
    table.add("motion", Values::Int(numbers(records, &|motion, _| motion as i32)));
    table.add("frame", Values::Int(numbers(records, &|_, frame| frame as i32)));
    for (i, name) in columns.iter().enumerate() {
        let values = records.iter().flat_map(|record| &record.frames).map(|row| row[i]);
        let values = if name == "time_s" {
            Values::Double(values.collect())
        } else if name.ends_with("_contact") {
            Values::Int(values.map(|v| v as i32).collect())
        } else {
            Values::Float(values.map(|v| v as f32).collect())
        };
        table.add(name.clone(), values);
    }
    table
}

/// Table of motions, one row per motion.
pub fn motions(records: &[Record]) -> Table {
    let mut table = Table::default();
    let int = |of: &dyn Fn(usize, &Record) -> usize| Values::Int(records.iter().enumerate().map(|(i, r)| of(i, r) as i32).collect());
    let text = |of: &dyn Fn(&Record) -> String| Values::Text(records.iter().map(of).collect());
    let number = |of: &dyn Fn(&Record) -> f64| Values::Double(records.iter().map(of).collect());
    let used = |of: fn(&JointUse) -> f64| number(&|r| r.joints.as_ref().map_or(0., of));
    table.add("motion", int(&|i, _| i));
    table.add("draw", int(&|_, r| r.drawn.number));
    table.add("ground", text(&|r| r.ground.clone()));
    table.add("family", text(&|r| r.drawn.family.name().into()));
    table.add("kind", text(&|r| r.drawn.kind.name().into()));
    for (i, name) in COMMAND.into_iter().enumerate() {
        table.add(name, number(&|r| r.drawn.command[i]));
    }
    for (i, name) in ["start_x_m", "start_y_m", "start_yaw_rad"].into_iter().enumerate() {
        table.add(name, number(&|r| r.drawn.start[i]));
    }
    table.add("period_s", number(&|r| r.drawn.stride.period));
    // The whole motion if no stride repeats.
    table.add("loop_start_s", number(&|r| r.drawn.repeats.map_or(0., |times| times[0])));
    table.add("loop_end_s", number(&|r| r.drawn.repeats.map_or(r.trajectory.horizon, |times| times[1])));
    table.add("cost", number(&|r| r.cost.total));
    table.add("cost_leg_work", number(&|r| r.cost.leg_work));
    table.add("cost_swing_work", number(&|r| r.cost.swing_work));
    table.add("cost_effort", number(&|r| r.cost.effort_cost));
    table.add("certificate_rows", int(&|_, r| r.report.n_rows));
    table.add("certificate_violated", int(&|_, r| r.report.n_violated));
    table.add("certificate_max_violation", number(&|r| r.report.max_violation));
    table.add("rollout_position_m", number(&|r| r.report.rollout.as_ref().map_or(0., |rollout| rollout.position.value)));
    table.add("rollout_attitude_deg", number(&|r| r.report.rollout.as_ref().map_or(0., |rollout| rollout.attitude.value)));
    table.add("joint_velocity_share", used(|u| u.velocity));
    table.add("joint_torque_share", used(|u| u.effort));
    table.add("joint_miss_m", used(|u| u.miss));
    table
}
