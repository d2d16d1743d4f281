//! Counts the rows of TOWR \[3\] that a trajectory breaks, in f64 from its node values, apart from the solver's kernels.
//!
//! Rows hold at instants and nodes only; [`super::dense`] reports what happens in between.

use super::dense::{ContactAxes, DenseReport, FootMotion, Motion, SAME_TIME, nearest, readable, sample};
use super::rollout::{Body, Rollout, RolloutReport};
use crate::error::Result;
use crate::gait::Trajectory;
use crate::gait::trajectory::{GoalVelocity, MotionLimits};
use crate::robot::Robot;
use crate::settings::Transcription;
use crate::terrain::Terrain;
use nalgebra::Vector3;
use serde::Serialize;
use std::fmt;

/// Largest violation that does not count, in the unit of the row.
pub const TOLERANCE: f64 = 1e-4;

/// Distance of the instants of the dynamics rows, s.
const DYNAMICS_STEP: f64 = 0.1;
/// Distance of the instants of the reach rows, s.
const REACH_STEP: f64 = 0.08;
/// Duration of a swing from which TOWR takes the horizontal velocity of its mid node, s.
const SWING_DURATION: f64 = 0.3;

/// Limits of a `momentum` motion between its instants: distance of the base from its rollout, m,
pub const ROLLOUT_POSITION: f64 = 0.01;
/// angle between the base and its rollout, degrees,
pub const ROLLOUT_ATTITUDE: f64 = 1.;
/// how far a foot may be outside its box, m,
pub const DENSE_REACH: f64 = 5e-3;
/// and below the terrain, m.
pub const PENETRATION: f64 = 1e-3;

/// How far the attitude may stray over one base piece, rad. What they add up to is limited by [`ROLLOUT_ATTITUDE`].
const PIECE_ATTITUDE: f64 = 1e-2;

/// What a `momentum` motion whose file names no limits is held to.
const MOTION_LIMITS: MotionLimits =
    MotionLimits { clearance: 0.03, swing_height: 0.2, foot_speed: 20., foot_acceleration: None, goal_velocity: GoalVelocity::Zero };

/// Points of a swing at which the speed of the foot is taken.
const SPEED_SAMPLES: u32 = 20;

const AXES: [&str; 3] = ["x", "y", "z"];
const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];

/// Kinds of rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Family {
    /// Newton and Euler equations of the base, every 0.1 s and at the end.
    Dynamics,
    /// Momentum, position and attitude at the end of every base piece as the forces make them. Only asked of `momentum` motions.
    Momentum,
    /// Acceleration of the base continuous between its pieces. Only asked of TOWR's own transcription.
    BaseAcceleration,
    /// Feet inside their boxes, every 0.08 s and at the end; of `momentum` motions up to [`DENSE_REACH`] outside.
    Reach,
    /// Standing feet on the terrain, mid nodes of a swing not below it.
    Terrain,
    /// Normal force between 0 and its limit, friction pyramid.
    Force,
    /// Mid node of a two-piece swing halfway between the footholds, with the velocity that TOWR prescribes, in TOWR's own transcription; of
    /// `momentum` motions high enough, not too high, not too fast.
    Swing,
    /// Start of base and feet, goal of the base.
    Bounds,
    /// What TOWR's variables hold by construction: standing feet stand, swinging feet carry nothing, nodes at phase boundaries.
    Structure,
    /// What must hold between the instants, beyond its limit. Only asked of `momentum` motions whose other rows hold.
    Motion,
}

impl Family {
    /// Every family, in the order of [`RowReport::families`].
    pub const ALL: [Family; 10] = [
        Family::Dynamics,
        Family::Momentum,
        Family::BaseAcceleration,
        Family::Reach,
        Family::Terrain,
        Family::Force,
        Family::Swing,
        Family::Bounds,
        Family::Structure,
        Family::Motion,
    ];

    /// Name, as in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Family::Dynamics => "dynamics",
            Family::Momentum => "momentum",
            Family::BaseAcceleration => "base-acceleration",
            Family::Reach => "reach",
            Family::Terrain => "terrain",
            Family::Force => "force",
            Family::Swing => "swing",
            Family::Bounds => "bounds",
            Family::Structure => "structure",
            Family::Motion => "motion",
        }
    }

    /// Units of its rows; where there are several, the name of the row says which.
    pub fn unit(self) -> &'static str {
        match self {
            Family::Dynamics => "N, N m",
            Family::Momentum => "N, N m, rad",
            Family::BaseAcceleration => "m/s2, rad/s2",
            Family::Reach | Family::Terrain => "m",
            Family::Force => "N",
            Family::Swing => "m, m/s",
            Family::Bounds => "m, rad, 1/s",
            Family::Structure => "m, m/s, N, N/s, s",
            Family::Motion => "m, deg, m g",
        }
    }
}

impl fmt::Display for Family {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(self.name())
    }
}

/// The most violated row of a family.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Worst {
    /// Its violation, in its unit; infinite (`null` in JSON) when it was no number.
    pub violation: f64,
    /// Which row, e.g. `moment x`.
    pub row: String,
    /// Foot; none for the base.
    pub foot: Option<usize>,
    /// Time, s.
    pub time: f64,
}

/// Count of one kind of rows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FamilyReport {
    /// Which.
    pub family: Family,
    /// Units of its rows.
    pub unit: &'static str,
    /// Number of rows.
    pub rows: usize,
    /// Those violated by more than [`TOLERANCE`].
    pub violated: usize,
    /// Largest violation, 0 without rows.
    pub max_violation: f64,
    /// The row that has it, if there is any row.
    pub worst: Option<Worst>,
}

/// Count of all rows.
#[derive(Debug, Clone, Serialize)]
pub struct RowReport {
    /// Number of rows.
    pub n_rows: usize,
    /// Number of violated rows: N_vc.
    pub n_violated: usize,
    /// Largest violation of any row, in its own unit.
    pub max_violation: f64,
    /// Whether no row is violated.
    pub feasible: bool,
    /// By kind, in the order of [`Family::ALL`].
    pub families: Vec<FamilyReport>,
}

/// Result of [`verify`].
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// At the rows.
    #[serde(flatten)]
    pub rows: RowReport,
    /// Between the instants.
    pub dense: DenseReport,
    /// Under the planned forces alone; none when the inertia has no inverse.
    pub rollout: Option<RolloutReport>,
}

impl std::ops::Deref for Report {
    type Target = RowReport;

    fn deref(&self) -> &RowReport {
        &self.rows
    }
}

impl RowReport {
    /// Count of one kind of rows.
    pub fn family(&self, family: Family) -> &FamilyReport {
        // `families` is `Family::ALL` mapped in order.
        &self.families[family as usize]
    }
}

impl fmt::Display for RowReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let verdict = if self.feasible { "feasible" } else { "not feasible" };
        writeln!(f, "{verdict}: {} of {} rows violated by more than {TOLERANCE:.0e}", self.n_violated, self.n_rows)?;
        writeln!(f)?;
        writeln!(f, "{:<18}{:>6}{:>10}{:>11}  {:<18} worst row", "rows", "count", "violated", "worst", "unit")?;
        for family in &self.families {
            let worst = family.worst.as_ref().map_or("-".into(), |worst| readable(worst.violation));
            write!(f, "{:<18}{:>6}{:>10}{worst:>11}  {:<18}", family.family, family.rows, family.violated, family.unit)?;
            // A row that holds exactly is as good as any other.
            if let Some(worst) = family.worst.as_ref().filter(|worst| worst.violation > 0.) {
                write!(f, " {} at {:.3} s", worst.row, worst.time)?;
                write!(f, "{}", worst.foot.map(|foot| format!(", foot {foot}")).unwrap_or_default())?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(f, "{}", self.rows)?;
        writeln!(f, "between the instants, {} samples", self.dense.samples)?;
        write!(f, "{}", self.dense)?;
        let Some(rollout) = &self.rollout else { return Ok(()) };
        writeln!(f, "\nintegrated from the start under the planned forces alone, off the plan by")?;
        write!(f, "{rollout}")
    }
}

/// Counts the rows of one family.
struct Tally(FamilyReport);

impl Tally {
    fn new(family: Family) -> Self {
        Tally(FamilyReport { family, unit: family.unit(), rows: 0, violated: 0, max_violation: 0., worst: None })
    }

    /// A row that is violated by `violation`, never negative.
    fn row(&mut self, violation: f64, row: fmt::Arguments, foot: Option<usize>, time: f64) {
        self.judged(violation, violation > TOLERANCE || violation.is_nan(), row, foot, time);
    }

    /// A row with its own verdict.
    fn judged(&mut self, violation: f64, violated: bool, row: fmt::Arguments, foot: Option<usize>, time: f64) {
        let violation = if violation.is_nan() { f64::INFINITY } else { violation };
        let report = &mut self.0;
        report.rows += 1;
        report.violated += usize::from(violated);
        if report.worst.as_ref().is_none_or(|worst| violation > worst.violation) {
            report.max_violation = violation;
            report.worst = Some(Worst { violation, row: row.to_string(), foot, time });
        }
    }

    /// Equalities, one for each axis: `residual = 0`.
    fn zero(&mut self, residual: Vector3<f64>, what: &str, axes: [&str; 3], foot: Option<usize>, time: f64) {
        for (axis, value) in axes.iter().zip(residual.iter()) {
            self.row(value.abs(), format_args!("{what} {axis}"), foot, time);
        }
    }

    /// An inequality: `value <= 0`.
    fn not_positive(&mut self, value: f64, row: fmt::Arguments, foot: Option<usize>, time: f64) {
        // Not `f64::max`, which would drop a NaN.
        self.row(if value <= 0. { 0. } else { value }, row, foot, time);
    }
}

/// Counts violated rows of a trajectory, and samples it between them.
///
/// * `force_limit` - largest normal force of a foot, N
///
/// # Errors
/// [`crate::Error::Invalid`] when the trajectory is malformed, or robot and trajectory disagree on the number of feet.
pub fn verify(trajectory: &Trajectory, robot: &Robot, terrain: &Terrain, force_limit: f64) -> Result<Report> {
    let rows = verify_rows(trajectory, robot, terrain, force_limit)?;
    let motion = Motion::new(trajectory, robot)?;
    Ok(Report { rows, dense: sample(&motion, terrain), rollout: Rollout::new(&motion).map(|r| r.report()) })
}

/// The rows of [`verify`] alone.
///
/// # Errors
/// As [`verify`].
pub fn verify_rows(trajectory: &Trajectory, robot: &Robot, terrain: &Terrain, force_limit: f64) -> Result<RowReport> {
    let motion = Motion::new(trajectory, robot)?;
    let name = trajectory.transcription.as_deref();
    let impulsive = name == Some(Transcription::Momentum.name());
    let of_towr = name.is_none_or(|name| name == Transcription::Towr.name());
    let mut broken = 0;
    let families = Family::ALL.map(|family| {
        let mut tally = Tally::new(family);
        match family {
            Family::Dynamics if impulsive => {}
            Family::Dynamics => dynamics(&mut tally, &motion),
            Family::Momentum if impulsive => momentum(&mut tally, &motion),
            Family::Momentum => {}
            Family::BaseAcceleration if of_towr => base_acceleration(&mut tally, &motion),
            Family::BaseAcceleration => {}
            Family::Reach => reach(&mut tally, &motion, if impulsive { DENSE_REACH } else { 0. }),
            Family::Terrain => on_terrain(&mut tally, &motion, terrain),
            Family::Force => force(&mut tally, &motion, terrain, force_limit),
            Family::Swing if impulsive => swing_heights(&mut tally, &motion, terrain, trajectory.limits),
            Family::Swing if of_towr => swing(&mut tally, &motion),
            Family::Swing => {}
            Family::Bounds => bounds(&mut tally, &motion, trajectory, terrain, impulsive),
            Family::Structure => structure(&mut tally, &motion, of_towr || impulsive),
            Family::Motion if impulsive && broken == 0 => between(&mut tally, &motion, terrain),
            Family::Motion => {}
        }
        broken += tally.0.violated;
        tally.0
    });
    let n_violated = families.iter().map(|f| f.violated).sum();
    Ok(RowReport {
        n_rows: families.iter().map(|f| f.rows).sum(),
        n_violated,
        max_violation: families.iter().map(|f| f.max_violation).fold(0., f64::max),
        feasible: n_violated == 0,
        families: families.into(),
    })
}

/// 0, step, 2 step, ... and the horizon, once.
fn instants(horizon: f64, step: f64) -> impl Iterator<Item = f64> {
    (0..).map(move |i| f64::from(i) * step).take_while(move |&t| t < horizon - SAME_TIME).chain([horizon])
}

fn dynamics(tally: &mut Tally, motion: &Motion) {
    for time in instants(motion.horizon, DYNAMICS_STEP) {
        let (moment, force) = motion.defect(&motion.base(time), time);
        tally.zero(moment, "moment", AXES, None, time);
        tally.zero(force, "force", AXES, None, time);
    }
}

/// Each base piece by itself: from the planned state at its start, the body is integrated to its end. Momenta are given by the mean force
/// or moment that would make up for them.
fn momentum(tally: &mut Tally, motion: &Motion) {
    let Some(rollout) = Rollout::new(motion) else {
        return tally.row(f64::INFINITY, format_args!("inertia without inverse"), None, 0.);
    };
    let mass = motion.robot.mass;
    for piece in motion.base_lin.times.windows(2) {
        let (start, end) = (piece[0], piece[1]);
        let length = end - start;
        let reached = rollout.run(Body::planned(motion, &motion.base(start)), start, end, |_, _| {});
        let plan = Body::planned(motion, &motion.base(end));
        tally.zero((reached.velocity - plan.velocity) * mass / length, "mean force", AXES, None, end);
        tally.zero((reached.position - plan.position) * 2. * mass / (length * length), "mean force for the way", AXES, None, end);
        tally.zero((reached.momentum - plan.momentum) / length, "mean moment", AXES, None, end);
        let apart = reached.angle_to(&plan);
        tally.judged(apart, apart > PIECE_ATTITUDE || apart.is_nan(), format_args!("attitude"), None, end);
    }
}

/// What must hold at all times.
fn between(tally: &mut Tally, motion: &Motion, terrain: &Terrain) {
    let dense = sample(motion, terrain);
    let Some(rollout) = Rollout::new(motion).map(|r| r.report()) else { return };
    let force = TOLERANCE / motion.robot.weight();
    let rows = [
        ("position off the rollout", rollout.position, ROLLOUT_POSITION),
        ("attitude off the rollout", rollout.attitude, ROLLOUT_ATTITUDE),
        ("reach", dense.reach_excess, DENSE_REACH),
        ("normal force, pull", dense.pull, force),
        ("friction", dense.friction_excess, force),
        ("foot below terrain", dense.penetration, PENETRATION),
    ];
    for (what, extreme, limit) in rows {
        let over = (extreme.value - limit).max(0.);
        tally.judged(over, extreme.value > limit, format_args!("{what}"), extreme.foot, extreme.time);
    }
}

fn base_acceleration(tally: &mut Tally, motion: &Motion) {
    let curves = [(&motion.base_lin, "acceleration", AXES), (&motion.base_ang, "angular acceleration", ANGLES)];
    for (curve, what, axes) in curves {
        for junction in 1..curve.times.len() - 1 {
            let before = curve.on_piece(junction - 1, curve.length(junction - 1)).second;
            let after = curve.on_piece(junction, 0.).second;
            tally.zero(before - after, what, axes, None, curve.times[junction]);
        }
    }
}

fn reach(tally: &mut Tally, motion: &Motion, allowed: f64) {
    for time in instants(motion.horizon, REACH_STEP) {
        let base = motion.base(time);
        for (foot, curves) in motion.feet.iter().enumerate() {
            let excess = motion.reach_excess(&base, foot, curves.motion.at(time).value);
            for (axis, &value) in AXES.iter().zip(excess.iter()) {
                tally.not_positive(value - allowed, format_args!("{axis}"), Some(foot), time);
            }
        }
    }
}

fn on_terrain(tally: &mut Tally, motion: &Motion, terrain: &Terrain) {
    for (foot, curves) in motion.feet.iter().enumerate() {
        for (node, &time) in curves.motion.times.iter().enumerate().skip(1) {
            let position = curves.motion.value(node);
            let height = position.z - terrain.height(position.x, position.y);
            if swing_at(curves, time).is_some() {
                tally.not_positive(-height, format_args!("swing z"), Some(foot), time);
            } else {
                tally.row(height.abs(), format_args!("stance z"), Some(foot), time);
            }
        }
    }
}

fn force(tally: &mut Tally, motion: &Motion, terrain: &Terrain, force_limit: f64) {
    let friction = terrain.friction;
    for (foot, curves) in motion.feet.iter().enumerate() {
        for (node, &time) in curves.force.times.iter().enumerate() {
            let (first, last) = curves.phases(time);
            let Some(foothold) = curves.foothold(time).filter(|_| first == last) else { continue };
            let (axes, value, foot) = (ContactAxes::new(terrain, foothold), curves.force.value(node), Some(foot));
            let normal = value.dot(&axes.normal);
            tally.not_positive(-normal, format_args!("normal force, pull"), foot, time);
            tally.not_positive(normal - force_limit, format_args!("normal force, limit"), foot, time);
            for (axis, tangent) in ["t1", "t2"].iter().zip(&axes.tangents) {
                tally.not_positive((tangent - axes.normal * friction).dot(&value), format_args!("friction +{axis}"), foot, time);
                tally.not_positive(-(tangent + axes.normal * friction).dot(&value), format_args!("friction -{axis}"), foot, time);
            }
        }
    }
}

fn swing(tally: &mut Tally, motion: &Motion) {
    for (foot, curves) in motion.feet.iter().enumerate() {
        for mid in mid_nodes(curves) {
            let (time, curve) = (curves.motion.times[mid], &curves.motion);
            let (previous, next) = (curve.value(mid - 1), curve.value(mid + 1));
            let (place, velocity) = (curve.value(mid) - (previous + next) / 2., curve.slope(mid) - (next - previous) / SWING_DURATION);
            for axis in 0..2 {
                tally.row(place[axis].abs(), format_args!("mid node {}", AXES[axis]), Some(foot), time);
                tally.row(velocity[axis].abs(), format_args!("mid node velocity {}", AXES[axis]), Some(foot), time);
            }
        }
    }
}

fn swing_heights(tally: &mut Tally, motion: &Motion, terrain: &Terrain, limits: Option<MotionLimits>) {
    let limits = limits.unwrap_or(MOTION_LIMITS);
    for (foot, curves) in motion.feet.iter().enumerate() {
        for swing in curves.switches.chunks_exact(2) {
            let (start, end) = (swing[0], swing[1]);
            let time = (start + end) / 2.;
            let place = curves.motion.at(time).value;
            let height = place.z - terrain.height(place.x, place.y);
            tally.not_positive(limits.clearance - height, format_args!("mid node too low"), Some(foot), time);
            // Above lift-off and landing: over a pit a foot need not go down.
            let feet = [start, end].map(|t| curves.motion.at(t).value.z);
            let height = height.min(place.z - feet[0].max(feet[1]));
            tally.not_positive(height - limits.swing_height, format_args!("mid node too high"), Some(foot), time);
            let speed = |i: u32| curves.motion.at(start + (end - start) * f64::from(i) / f64::from(SPEED_SAMPLES)).first.xy().norm();
            let fastest = (1..SPEED_SAMPLES).map(speed).fold(0., f64::max);
            tally.not_positive(fastest - limits.foot_speed, format_args!("foot too fast"), Some(foot), time);
            if let Some(limit) = limits.foot_acceleration {
                // It is linear on each piece.
                let curve = &curves.motion;
                let (first, last) = (nearest(&curve.times, start), nearest(&curve.times, end));
                let ends = |piece: usize| [curve.on_piece(piece, 0.), curve.on_piece(piece, curve.length(piece))];
                let hardest = (first..last).flat_map(ends).map(|p| p.second.norm()).fold(0., f64::max);
                tally.not_positive(hardest - limit, format_args!("foot accelerated too hard"), Some(foot), time);
            }
        }
    }
}

fn bounds(tally: &mut Tally, motion: &Motion, trajectory: &Trajectory, terrain: &Terrain, impulsive: bool) {
    let robot = motion.robot;
    let start = trajectory.init_base.unwrap_or([0., 0., robot.base_height + terrain.height(0., 0.)]);
    let (lin, ang) = (&motion.base_lin, &motion.base_ang);
    tally.zero(lin.value(0) - Vector3::from(start), "start position", AXES, None, 0.);
    tally.zero(lin.slope(0), "start velocity", AXES, None, 0.);
    tally.zero(ang.value(0), "start angle", ANGLES, None, 0.);
    tally.zero(ang.slope(0), "start rate", ANGLES, None, 0.);
    let (goal, attitude) = (Vector3::from(trajectory.base_target), Vector3::new(0., 0., trajectory.yaw_target));
    tally.zero(lin.value(lin.times.len() - 1) - goal, "final position", AXES, None, motion.horizon);
    tally.zero(ang.value(ang.times.len() - 1) - attitude, "final angle", ANGLES, None, motion.horizon);
    if impulsive && trajectory.limits.is_none_or(|l| l.goal_velocity == GoalVelocity::Zero) {
        tally.zero(lin.slope(lin.times.len() - 1), "final velocity", AXES, None, motion.horizon);
        tally.zero(ang.slope(ang.times.len() - 1), "final rate", ANGLES, None, motion.horizon);
    }
    for (foot, curves) in motion.feet.iter().enumerate() {
        let [x, y, _] = robot.nominal_feet[foot];
        let (x, y) = (start[0] + x, start[1] + y);
        let nominal = Vector3::new(x, y, terrain.height(x, y));
        tally.zero(curves.motion.value(0) - nominal, "start position", AXES, Some(foot), 0.);
    }
}

/// * `level` - whether feet are level in the middle of a swing of two pieces, as both phase-based transcriptions have them
fn structure(tally: &mut Tally, motion: &Motion, level: bool) {
    for (foot, curves) in motion.feet.iter().enumerate() {
        let at = Some(foot);
        for (curve, what) in [(&curves.motion, "motion node at phase boundary"), (&curves.force, "force node at phase boundary")] {
            for &switch in &curves.switches {
                let mismatch = (curve.times[nearest(&curve.times, switch)] - switch).abs();
                tally.judged(mismatch, mismatch > SAME_TIME, format_args!("{what}"), at, switch);
            }
        }
        for (node, &time) in curves.motion.times.iter().enumerate() {
            // The foothold is a node of its phase: that one compares with itself.
            if let Some(foothold) = curves.foothold(time) {
                tally.zero(curves.motion.value(node) - foothold, "standing foot moved,", AXES, at, time);
                tally.zero(curves.motion.slope(node), "velocity of standing foot,", AXES, at, time);
            }
        }
        for mid in mid_nodes(curves).filter(|_| level) {
            tally.row(curves.motion.slope(mid).z.abs(), format_args!("mid node velocity z"), at, curves.motion.times[mid]);
        }
        for (node, &time) in curves.force.times.iter().enumerate() {
            let (first, last) = curves.phases(time);
            if first != last || first % 2 == 1 {
                tally.zero(curves.force.value(node), "force in swing,", AXES, at, time);
                tally.zero(curves.force.slope(node), "force slope in swing,", AXES, at, time);
            }
        }
    }
}

/// The swing phase strictly inside of which a time is.
fn swing_at(curves: &FootMotion, time: f64) -> Option<usize> {
    let (first, last) = curves.phases(time);
    (first == last && first % 2 == 1).then_some(first)
}

/// Motion nodes in the middle of the swings that have exactly two pieces.
fn mid_nodes<'a>(curves: &'a FootMotion) -> impl Iterator<Item = usize> + 'a {
    let swing = |node: usize| swing_at(curves, curves.motion.times[node]);
    // The last node is at the end of the last stance.
    (1..curves.motion.times.len() - 1).filter(move |&node| swing(node).is_some() && swing(node - 1).is_none() && swing(node + 1).is_none())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instants_end_once_at_the_horizon() {
        let times = |horizon, step| instants(horizon, step).collect::<Vec<f64>>();
        assert_eq!(times(0.25, 0.1), [0., 0.1, 0.2, 0.25]);
        assert_eq!(times(0.3, 0.1).len(), 4);
        assert_eq!(times(0.3 + 1e-9, 0.1).last(), Some(&(0.3 + 1e-9)));
        assert_eq!(times(0.3 + 1e-9, 0.1).len(), 4);
        assert_eq!(times(0.05, 0.1), [0., 0.05]);
        assert_eq!(times(120., 0.1).len(), 1201);
    }

    #[test]
    fn a_tally_counts_beyond_the_tolerance_and_nan() {
        let mut tally = Tally::new(Family::Force);
        tally.not_positive(-5., format_args!("a"), None, 0.);
        tally.row(TOLERANCE, format_args!("b"), None, 1.);
        tally.not_positive(1.01 * TOLERANCE, format_args!("c"), Some(2), 2.);
        assert_eq!((tally.0.rows, tally.0.violated), (3, 1));
        assert_eq!(tally.0.worst.as_ref().map(|w| (w.row.as_str(), w.foot)), Some(("c", Some(2))));
        tally.not_positive(f64::NAN, format_args!("d"), None, 3.);
        assert_eq!((tally.0.violated, tally.0.max_violation), (2, f64::INFINITY));
    }

    #[test]
    fn families_are_found_by_their_place_in_the_list() {
        for (place, family) in Family::ALL.into_iter().enumerate() {
            assert_eq!(family as usize, place);
            assert_eq!(serde_json::to_value(family).unwrap(), family.name());
        }
    }
}
