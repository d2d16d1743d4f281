//! Counts the violated rows of a trajectory, in f64 from its node values and independently of the solver's kernels.
//!
//! The rows of TOWR \[3\] hold only at instants and nodes; [`super::dense`] reports what happens in between. Rows of `momentum` motions are
//! bounded over whole curves.

use super::curves::{ContactAxes, Extreme, FootMotion, Motion, Point, SAME_TIME, nearest};
use super::dense::sample;
use super::labels::{check_labels, of_momentum};
use super::report::{
    BALL_DEPTH, BASE_RATE, CheckFamily, DENSE_REACH, DENSE_TURN, FOOTHOLD_PLANE, FamilyReport, MAX_FOOT_SPEED, PENETRATION,
    ROLLOUT_ATTITUDE, ROLLOUT_POSITION, Report, RowReport, SHORTEST_PIECE, SOLE_OFF_GROUND, Tolerances, Worst,
};
use super::rollout::Rollout;
use super::stretch::Body;
use super::{ball, exact, sole};
use crate::error::Result;
use crate::gait::Trajectory;
use crate::gait::trajectory::{GoalVelocity, MotionLimits};
use crate::robot::{GRAVITY, Robot};
use crate::settings::Transcription;
use crate::terrain::Terrain;
use nalgebra::{Rotation3, Vector3};
use std::fmt;

/// Interval between the instants of the dynamics rows, s.
const DYNAMICS_STEP: f64 = 0.1;
/// Interval between the instants of the reach rows, s.
const REACH_STEP: f64 = 0.08;
/// Swing duration by which TOWR computes the prescribed horizontal velocity of the mid node, s.
const SWING_DURATION: f64 = 0.3;

/// Longest time over which a mean force or moment is computed, s.
const MEAN_OVER: f64 = 0.1;
/// Largest attitude difference at the end of one base piece, rad. [`ROLLOUT_ATTITUDE`] limits their sum.
const PIECE_ATTITUDE: f64 = 1e-2;

/// Limits for a `momentum` motion whose file specifies none.
pub const MOTION_LIMITS: MotionLimits =
    MotionLimits { clearance: 0.03, swing_height: 0.2, foot_speed: 20., foot_acceleration: None, goal_velocity: GoalVelocity::Zero };

/// Part of the rest of a swing that had begun before the motion which the foot rises at least if it rises at all.
const DESCENT: f64 = 0.25;

/// Shortest cubic that is continued to a touchdown after the end, s. Rounding errors of a shorter one would exceed the tolerances.
const CONTINUED: f64 = 1e-3;

const AXES: [&str; 3] = ["x", "y", "z"];
const SLABS: [&str; 4] = ["x", "y", "z", "diagonal"];
const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];

/// Counter of the rows of one family.
struct Tally {
    report: FamilyReport,
    tolerances: Tolerances,
    /// Violation of the worst row, in multiples of its tolerance.
    worst: f64,
}

impl Tally {
    fn new(family: CheckFamily, tolerances: Tolerances) -> Self {
        let report = FamilyReport { family, unit: family.unit(), rows: 0, violated: 0, max_violation: 0., worst: None };
        Tally { report, tolerances, worst: 0. }
    }

    /// Counts one row. `violation` is non-negative (NaN counts as infinite); the row is violated if it exceeds `tolerance`.
    fn row(&mut self, violation: f64, tolerance: f64, row: fmt::Arguments, foot: Option<usize>, time: f64) {
        let violation = if violation.is_nan() { f64::INFINITY } else { violation };
        let report = &mut self.report;
        report.rows += 1;
        report.violated += usize::from(violation > tolerance);
        report.max_violation = report.max_violation.max(violation);
        let in_tolerances = if violation == 0. { 0. } else { violation / tolerance };
        let ahead = |worst: &Worst| in_tolerances > self.worst || in_tolerances == self.worst && violation > worst.violation;
        if report.worst.as_ref().is_none_or(ahead) {
            self.worst = in_tolerances;
            report.worst = Some(Worst { violation, row: row.to_string(), foot, time });
        }
    }

    /// Counts equality rows `residual = 0`, one per axis.
    fn zero(&mut self, residual: Vector3<f64>, tolerance: f64, what: &str, axes: [&str; 3], foot: Option<usize>, time: f64) {
        for (axis, value) in axes.iter().zip(residual.iter()) {
            self.row(value.abs(), tolerance, format_args!("{what} {axis}"), foot, time);
        }
    }

    /// Counts an inequality row `value <= 0`.
    fn not_positive(&mut self, value: f64, tolerance: f64, row: fmt::Arguments, foot: Option<usize>, time: f64) {
        // Not `f64::max`, which would drop a NaN.
        self.row(if value <= 0. { 0. } else { value }, tolerance, row, foot, time);
    }
}

/// Counts the violated rows of a trajectory, samples it between them and integrates it under its planned forces.
///
/// * `force_limit` - largest normal force of a foot, N
///
/// # Errors
/// [`crate::Error::Invalid`] if the trajectory is malformed, if robot and trajectory disagree on the number of feet, or if the labels of
/// the trajectory contradict its content ([`check_labels`]).
pub fn verify(trajectory: &Trajectory, robot: &Robot, terrain: &Terrain, force_limit: f64) -> Result<Report> {
    let rows = verify_rows(trajectory, robot, terrain, force_limit)?;
    let motion = Motion::new(trajectory, robot)?;
    Ok(Report { rows, dense: sample(&motion, terrain), rollout: Rollout::new(&motion).map(|r| r.report()) })
}

/// Counts the violated rows of a trajectory as [`verify`] does, without the reports in between.
///
/// # Errors
/// The errors of [`verify`].
pub fn verify_rows(trajectory: &Trajectory, robot: &Robot, terrain: &Terrain, force_limit: f64) -> Result<RowReport> {
    let motion = Motion::new(trajectory, robot)?;
    check_labels(trajectory)?;
    let name = trajectory.transcription.as_deref();
    let impulsive = of_momentum(trajectory);
    let of_towr = name.is_none_or(|name| name == Transcription::Towr.name());
    let mut broken = 0;
    let tolerances = if impulsive { Tolerances::of(robot) } else { Tolerances::TOWR };
    let families = CheckFamily::ALL.map(|family| {
        let mut tally = Tally::new(family, tolerances);
        match family {
            CheckFamily::Dynamics if impulsive => {}
            CheckFamily::Dynamics => dynamics(&mut tally, &motion),
            CheckFamily::Momentum if impulsive => momentum(&mut tally, &motion),
            CheckFamily::Momentum => {}
            CheckFamily::BaseAcceleration if of_towr => base_acceleration(&mut tally, &motion),
            CheckFamily::BaseAcceleration => {}
            CheckFamily::Reach => reach(&mut tally, &motion, if impulsive { DENSE_REACH } else { 0. }),
            CheckFamily::Terrain => on_terrain(&mut tally, &motion, terrain),
            CheckFamily::Force => force(&mut tally, &motion, terrain, force_limit, impulsive),
            CheckFamily::Swing if impulsive => swing_heights(&mut tally, &motion, trajectory, terrain),
            CheckFamily::Swing if of_towr => swing(&mut tally, &motion),
            CheckFamily::Swing => {}
            CheckFamily::Bounds => bounds(&mut tally, &motion, trajectory, terrain, impulsive),
            CheckFamily::Structure => structure(&mut tally, &motion, of_towr || impulsive),
            CheckFamily::Possible => possible(&mut tally, &motion, trajectory, terrain, of_towr),
            CheckFamily::Motion if impulsive && broken == 0 => between(&mut tally, &motion, terrain, force_limit),
            CheckFamily::Motion => {}
            CheckFamily::Footing if impulsive && broken == 0 => footing(&mut tally, &motion, terrain),
            CheckFamily::Footing => {}
            CheckFamily::Sole => soles(&mut tally, &motion, terrain),
        }
        broken += tally.report.violated;
        tally.report
    });
    let n_violated = families.iter().map(|f| f.violated).sum();
    Ok(RowReport {
        n_rows: families.iter().map(|f| f.rows).sum(),
        n_violated,
        max_violation: families.iter().map(|f| f.max_violation).fold(0., f64::max),
        feasible: n_violated == 0,
        tolerances,
        families: families.into(),
    })
}

/// Instants 0, step, 2 step, ... and the horizon, which occurs only once.
fn instants(horizon: f64, step: f64) -> impl Iterator<Item = f64> {
    (0..).map(move |i| f64::from(i) * step).take_while(move |&t| t < horizon - SAME_TIME).chain([horizon])
}

fn dynamics(tally: &mut Tally, motion: &Motion) {
    for time in instants(motion.horizon, DYNAMICS_STEP) {
        let (moment, force) = motion.defect(&motion.base(time), time);
        tally.zero(moment, tally.tolerances.moment, "moment", AXES, None, time);
        tally.zero(force, tally.tolerances.force, "force", AXES, None, time);
    }
}

/// Integrates the body over every base piece separately, from the planned state at its start to its end. Differences of velocity, position
/// and angular momentum are expressed as the mean force or moment that would compensate them, over at most [`MEAN_OVER`].
fn momentum(tally: &mut Tally, motion: &Motion) {
    let Some(rollout) = Rollout::new(motion) else {
        return tally.row(f64::INFINITY, 0., format_args!("inertia without inverse"), None, 0.);
    };
    let (mass, tolerances) = (motion.robot.mass, tally.tolerances);
    for piece in motion.base_lin.times.windows(2) {
        let (start, end) = (piece[0], piece[1]);
        // A small mean force over a long piece adds up to a large momentum.
        let length = (end - start).min(MEAN_OVER);
        let reached = rollout.run(Body::planned(motion, &motion.base(start)), start, end);
        let plan = Body::planned(motion, &motion.base(end));
        tally.zero((reached.velocity - plan.velocity) * mass / length, tolerances.force, "mean force", AXES, None, end);
        tally.zero(
            (reached.position - plan.position) * 2. * mass / (length * length),
            tolerances.force,
            "mean force for the displacement",
            AXES,
            None,
            end,
        );
        tally.zero((reached.momentum - plan.momentum) / length, tolerances.moment, "mean moment", AXES, None, end);
        let apart = reached.angle_to(&plan);
        tally.row(apart, PIECE_ATTITUDE, format_args!("attitude"), None, end);
    }
}

/// Checks the conditions of a `momentum` motion that must hold at all times, on whole curves.
fn between(tally: &mut Tally, motion: &Motion, terrain: &Terrain, force_limit: f64) {
    let Some(rollout) = Rollout::new(motion).map(|r| r.certified([ROLLOUT_POSITION, ROLLOUT_ATTITUDE])) else { return };
    let weight = motion.robot.weight();
    let [pull, limit, friction] = exact::forces(motion, terrain, force_limit, tally.tolerances.force);
    let in_weights = |e: Extreme| Extreme { value: e.value / weight, ..e };
    let (force, length) = (tally.tolerances.force / weight, tally.tolerances.length);
    let rows = [
        ("position off the rollout", rollout.position, ROLLOUT_POSITION),
        ("attitude off the rollout", rollout.attitude, ROLLOUT_ATTITUDE),
        ("reach", exact::reach(motion, DENSE_REACH), DENSE_REACH),
        ("normal force, pull", in_weights(pull), force),
        ("normal force, limit", in_weights(limit), force),
        ("friction cone", in_weights(friction), force),
        ("foot below terrain", exact::penetration(motion, terrain, PENETRATION), PENETRATION),
        ("standing foot off its foothold", exact::standing(motion, length), length),
    ];
    for (what, extreme, limit) in rows {
        let over = (extreme.value - limit).max(0.);
        tally.row(over, 0., format_args!("{what}"), extreme.foot, extreme.time);
    }
}

/// Checks the balls of the feet. The initial stance is given, so the first lift-off of a foot may start as deep in the ground as it stands.
fn footing(tally: &mut Tally, motion: &Motion, terrain: &Terrain) {
    let radius = motion.robot.foot_radius();
    if radius == 0. || !terrain.has_edges() {
        return;
    }
    let (deepest, farthest) = (BALL_DEPTH * radius, FOOTHOLD_PLANE * radius);
    for (foot, curves) in motion.feet.iter().enumerate() {
        for (number, swing) in curves.swings().enumerate() {
            let start = curves.place(swing[0]);
            let stood = number == 0 && !curves.lifted;
            let at_start = if stood { ball::standing_depth(terrain, start, radius, deepest) } else { deepest };
            let over = ball::swing_depth(curves, swing, terrain, radius, [at_start, deepest]);
            tally.not_positive(over.value, 0., format_args!("ball in the ground"), Some(foot), over.time);
            if curves.lands_later(swing) {
                continue;
            }
            let off = ball::off_plane(terrain, curves.place(swing[1]), radius, farthest);
            tally.not_positive(off - farthest, 0., format_args!("foothold at an edge"), Some(foot), swing[1]);
        }
    }
}

/// Checks the soles on whole curves.
fn soles(tally: &mut Tally, motion: &Motion, terrain: &Terrain) {
    let Some(sole) = &motion.robot.sole else { return };
    let (weight, length) = (motion.robot.weight(), tally.tolerances.length);
    let force = tally.tolerances.force;
    let [pressure, friction] = sole::wrenches(motion, sole, terrain, force);
    let in_weights = |e: Extreme| Extreme { value: e.value / weight, ..e };
    let rate = exact::base_rate(&motion.base_ang, 0.).value;
    let rows = [
        ("centre of pressure outside the sole", in_weights(pressure), force / weight),
        ("friction with torsion", in_weights(friction), force / weight),
        ("sole off the ground", sole::off_ground(motion, sole, terrain), SOLE_OFF_GROUND),
        ("sole in the ground", sole::penetration(motion, sole, terrain, PENETRATION), PENETRATION),
        ("sole turned from the base", sole::turned(motion, sole, rate, DENSE_TURN), DENSE_TURN),
        ("soles overlap", sole::overlap(motion, sole, terrain, length), length),
    ];
    for (what, extreme, limit) in rows {
        let over = (extreme.value - limit).max(0.);
        tally.row(over, 0., format_args!("{what}"), extreme.foot, extreme.time);
    }
}

/// Checks limits that no robot can exceed.
///
/// * `of_towr` - true if the motion is only checked against TOWR's rows
fn possible(tally: &mut Tally, motion: &Motion, trajectory: &Trajectory, terrain: &Terrain, of_towr: bool) {
    let robot = motion.robot;
    let mut row = |over: f64, what: &str, foot: Option<usize>, time: f64| {
        let over = if over <= 0. { 0. } else { over };
        tally.row(over, 0., format_args!("{what}"), foot, time);
    };
    let base = [(None, &motion.base_lin), (None, &motion.base_ang)];
    let feet = motion.feet.iter().enumerate().flat_map(|(foot, curves)| [(Some(foot), &curves.motion), (Some(foot), &curves.force)]);
    for (foot, curve) in base.into_iter().chain(feet) {
        let pieces = (0..curve.pieces()).map(|piece| (curve.length(piece), curve.times[piece]));
        let (shortest, time) = pieces.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::NAN, 0.));
        row(SHORTEST_PIECE * (1. - 1e-6) - shortest, "piece too short", foot, time);
    }
    // TOWR's rows do not limit feet during a swing: its published solutions reach foot speeds of 150 m/s.
    for (foot, curves) in motion.feet.iter().enumerate().filter(|_| !of_towr) {
        let speed = exact::foot_speed(curves, 0..curves.motion.pieces(), false, MAX_FOOT_SPEED);
        row(speed.value - MAX_FOOT_SPEED, "foot faster than possible", Some(foot), speed.time);
    }
    let limit = BASE_RATE * (GRAVITY / robot.leg_height()).sqrt();
    let rate = exact::base_rate(&motion.base_ang, limit);
    row(rate.value - limit, "base turns too fast", None, rate.time);
    let pushed = exact::push(motion) / robot.weight() + 1.;
    let lin = &motion.base_lin;
    let hardest = exact::ends(lin, 0..lin.pieces(), |a| (a / GRAVITY + Vector3::z()).norm());
    row(hardest.value - pushed, "base accelerates more than its feet push", None, hardest.time);
    let below = exact::base_depth(motion, terrain);
    row(below.value, "base below the terrain", None, below.time);
    let [x, y, z] = trajectory.base_target;
    row(terrain.height(x, y) - z, "goal below the terrain", None, motion.horizon);
}

fn base_acceleration(tally: &mut Tally, motion: &Motion) {
    let curves = [(&motion.base_lin, "acceleration", AXES), (&motion.base_ang, "angular acceleration", ANGLES)];
    for (curve, what, axes) in curves {
        for junction in 1..curve.times.len() - 1 {
            let before = curve.on_piece(junction - 1, curve.length(junction - 1)).second;
            let after = curve.on_piece(junction, 0.).second;
            tally.zero(before - after, tally.tolerances.acceleration, what, axes, None, curve.times[junction]);
        }
    }
}

fn reach(tally: &mut Tally, motion: &Motion, allowed: f64) {
    for time in instants(motion.horizon, REACH_STEP) {
        let base = motion.base(time);
        for (foot, curves) in motion.feet.iter().enumerate() {
            let excess = motion.reach_excess(&base, foot, curves.motion.at(time).value);
            for (slab, value) in excess.enumerate() {
                let name = format_args!("{}", SLABS[slab.min(3)]);
                tally.not_positive(value - allowed, tally.tolerances.length, name, Some(foot), time);
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
                tally.not_positive(-height, tally.tolerances.length, format_args!("swing z"), Some(foot), time);
            } else {
                tally.row(height.abs(), tally.tolerances.length, format_args!("stance z"), Some(foot), time);
            }
        }
    }
}

/// * `cone` - true for the exact friction cone, false for TOWR's pyramid
fn force(tally: &mut Tally, motion: &Motion, terrain: &Terrain, force_limit: f64, cone: bool) {
    let (friction, tolerance) = (terrain.friction, tally.tolerances.force);
    for (foot, curves) in motion.feet.iter().enumerate() {
        for (node, &time) in curves.force.times.iter().enumerate() {
            let (first, last) = curves.phases(time);
            let Some(foothold) = curves.foothold(time).filter(|_| first == last) else { continue };
            let (axes, value, foot) = (ContactAxes::new(terrain, foothold), curves.force.value(node), Some(foot));
            let normal = value.dot(&axes.normal);
            tally.not_positive(-normal, tolerance, format_args!("normal force, pull"), foot, time);
            tally.not_positive(normal - force_limit, tolerance, format_args!("normal force, limit"), foot, time);
            if cone {
                let outside = (value - axes.normal * normal).norm() - friction * normal;
                tally.not_positive(outside, tolerance, format_args!("friction cone"), foot, time);
                continue;
            }
            for (axis, tangent) in ["t1", "t2"].iter().zip(&axes.tangents) {
                tally.not_positive((tangent - axes.normal * friction).dot(&value), tolerance, format_args!("friction +{axis}"), foot, time);
                tally.not_positive(
                    -(tangent + axes.normal * friction).dot(&value),
                    tolerance,
                    format_args!("friction -{axis}"),
                    foot,
                    time,
                );
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
                tally.row(place[axis].abs(), tally.tolerances.length, format_args!("mid node {}", AXES[axis]), Some(foot), time);
                tally.row(velocity[axis].abs(), tally.tolerances.speed, format_args!("mid node velocity {}", AXES[axis]), Some(foot), time);
            }
        }
    }
}

/// The limits of height apply in the middle of a whole swing, if the motion contains it.
fn swing_heights(tally: &mut Tally, motion: &Motion, trajectory: &Trajectory, terrain: &Terrain) {
    let (limits, tolerances) = (trajectory.limits.unwrap_or(MOTION_LIMITS), tally.tolerances);
    for (foot, curves) in motion.feet.iter().enumerate() {
        for (number, swing) in curves.switches.chunks_exact(2).enumerate() {
            let (start, end) = (swing[0], swing[1].min(motion.horizon));
            let pieces = nearest(&curves.motion.times, start)..nearest(&curves.motion.times, end);
            let fastest = exact::foot_speed(curves, pieces.clone(), true, limits.foot_speed);
            tally.not_positive(
                fastest.value - limits.foot_speed,
                tolerances.speed,
                format_args!("foot too fast"),
                Some(foot),
                fastest.time.max(start),
            );
            let began = trajectory.start_swing(foot).filter(|_| number == 0).map_or(start, |state| start - state.since);
            let time = (began + swing[1]) / 2.;
            if let Some(limit) = limits.foot_acceleration {
                let hardest = exact::foot_acceleration(curves, pieces);
                tally.not_positive(
                    hardest.value - limit,
                    tolerances.acceleration,
                    format_args!("foot accelerated too hard"),
                    Some(foot),
                    time.clamp(start, end),
                );
            }
            let started = number == 0 && curves.lifted;
            // A swing that had begun before passes over its middle only if that is far enough ahead.
            let ahead = !started || time - start >= (swing[1] - start) * DESCENT;
            let landing = landing(curves, swing[1], if ahead { time } else { start });
            if let Some(landing) = &landing {
                let height = landing.value.z - terrain.height(landing.value.x, landing.value.y);
                tally.row(height.abs(), tolerances.length, format_args!("touchdown z"), Some(foot), end);
                tally.zero(landing.first, tolerances.speed, "touchdown velocity", AXES, Some(foot), end);
            }
            if !ahead || time > motion.horizon {
                continue;
            }
            let place = curves.motion.at(time).value;
            let height = place.z - terrain.height(place.x, place.y);
            tally.not_positive(limits.clearance - height, tolerances.length, format_args!("mid node too low"), Some(foot), time);
            // Height above lift-off and touchdown: a foot need not descend into a pit that it crosses.
            let on_ground = |t: f64| curves.motion.at(t).value.z;
            let under = |t: f64| {
                let place = curves.motion.at(t).value;
                terrain.height(place.x, place.y)
            };
            // A foot in the air at an end of the motion is measured from the ground below it, or from where it lands.
            let lift_off = if started { under(start) } else { on_ground(start) };
            let touchdown = match &landing {
                Some(landing) => landing.value.z,
                None if swing[1] > motion.horizon + SAME_TIME => under(end),
                None => on_ground(end),
            };
            let height = height.min(place.z - lift_off.max(touchdown));
            tally.not_positive(height - limits.swing_height, tolerances.length, format_args!("mid node too high"), Some(foot), time);
        }
    }
}

/// Point at a touchdown after the end of the motion, to which the last cubic continues; `None` if the foot lands in the motion, or if the
/// last cubic is not one from the middle of the swing or too short to be continued.
fn landing(curves: &FootMotion, touchdown: f64, middle: f64) -> Option<Point> {
    let last = curves.motion.pieces() - 1;
    let from = curves.motion.times[last];
    let follows = from >= middle - SAME_TIME && curves.motion.length(last) >= CONTINUED;
    if !follows || touchdown <= curves.end() + SAME_TIME {
        return None;
    }
    Some(curves.motion.beyond(last, touchdown - from))
}

fn bounds(tally: &mut Tally, motion: &Motion, trajectory: &Trajectory, terrain: &Terrain, impulsive: bool) {
    let (robot, tolerances) = (motion.robot, tally.tolerances);
    let (start, goal) = (trajectory.start_state(robot, terrain), trajectory.goal_state());
    let (lin, ang) = (&motion.base_lin, &motion.base_ang);
    tally.zero(lin.value(0) - Vector3::from(start.position), tolerances.length, "start position", AXES, None, 0.);
    tally.zero(lin.slope(0) - Vector3::from(start.velocity), tolerances.speed, "start velocity", AXES, None, 0.);
    tally.zero(ang.value(0) - Vector3::from(start.angles), tolerances.angle, "start angle", ANGLES, None, 0.);
    tally.zero(ang.slope(0) - Vector3::from(start.rates), tolerances.rate, "start rate", ANGLES, None, 0.);
    let end = [&lin.times, &ang.times].map(|times| times.len() - 1);
    let bound = trajectory.limits.map_or(GoalVelocity::Zero, |limits| limits.goal_velocity);
    if bound != GoalVelocity::Near || !impulsive {
        tally.zero(lin.value(end[0]) - Vector3::from(goal.position), tolerances.length, "final position", AXES, None, motion.horizon);
        tally.zero(ang.value(end[1]) - Vector3::from(goal.angles), tolerances.angle, "final angle", ANGLES, None, motion.horizon);
    }
    if impulsive && bound == GoalVelocity::Zero {
        tally.zero(lin.slope(end[0]) - Vector3::from(goal.velocity), tolerances.speed, "final velocity", AXES, None, motion.horizon);
        tally.zero(ang.slope(end[1]) - Vector3::from(goal.rates), tolerances.rate, "final rate", ANGLES, None, motion.horizon);
    }
    for (foot, curves) in motion.feet.iter().enumerate() {
        let [x, y] = match &trajectory.start_feet {
            Some(feet) => feet[foot],
            None => {
                let [roll, pitch, yaw] = start.angles;
                let place = Rotation3::from_euler_angles(roll, pitch, yaw) * Vector3::from(robot.nominal_feet[foot]);
                [start.position[0] + place.x, start.position[1] + place.y]
            }
        };
        let mut place = Vector3::new(x, y, terrain.height(x, y));
        if let Some(state) = trajectory.start_swing(foot) {
            place = state.position.into();
            let velocity = curves.motion.slope(0) - Vector3::from(state.velocity);
            tally.zero(velocity, tolerances.speed, "start velocity", AXES, Some(foot), 0.);
        }
        tally.zero(curves.motion.value(0) - place, tolerances.length, "start position", AXES, Some(foot), 0.);
        if let Some([yaw, ..]) = curves.yaws {
            let asked = trajectory.start_yaws.as_ref().map_or(start.yaw(), |yaws| yaws[foot]);
            tally.row((yaw - asked).abs(), tolerances.angle, format_args!("start yaw"), Some(foot), 0.);
        }
    }
}

/// * `level` - true if the vertical velocity must be zero at the mid node of a two-piece swing, as in both phase-based transcriptions
fn structure(tally: &mut Tally, motion: &Motion, level: bool) {
    let tolerances = tally.tolerances;
    for (foot, curves) in motion.feet.iter().enumerate() {
        let at = Some(foot);
        let wrench = std::iter::once((&curves.force, "force")).chain(curves.moment.iter().map(|moment| (moment, "moment")));
        for (curve, what) in std::iter::once((&curves.motion, "motion")).chain(wrench.clone()) {
            for &switch in curves.switches.iter().filter(|&&switch| switch <= motion.horizon + SAME_TIME) {
                let mismatch = (curve.times[nearest(&curve.times, switch)] - switch).abs();
                tally.row(mismatch, SAME_TIME, format_args!("{what} node at phase boundary"), at, switch);
            }
        }
        for (node, &time) in curves.motion.times.iter().enumerate() {
            // The node that defines the foothold of its phase is compared with itself.
            if let Some(foothold) = curves.foothold(time) {
                tally.zero(curves.motion.value(node) - foothold, tolerances.length, "standing foot moved,", AXES, at, time);
                tally.zero(curves.motion.slope(node), tolerances.speed, "velocity of standing foot,", AXES, at, time);
            }
        }
        for mid in mid_nodes(curves).filter(|_| level) {
            tally.row(
                curves.motion.slope(mid).z.abs(),
                tolerances.speed,
                format_args!("mid node velocity z"),
                at,
                curves.motion.times[mid],
            );
        }
        for (curve, what) in wrench {
            for (node, &time) in curve.times.iter().enumerate() {
                let (first, last) = curves.phases(time);
                if first != last || first % 2 == 1 {
                    tally.zero(curve.value(node), tolerances.force, &format!("{what} in swing,"), AXES, at, time);
                    tally.zero(curve.slope(node), tolerances.force, &format!("{what} slope in swing,"), AXES, at, time);
                }
            }
        }
    }
}

/// Returns the swing phase that contains a time strictly, or `None`.
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
    use super::super::report::TOLERANCE;
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
    fn a_tally_counts_nan_and_rows_beyond_the_tolerance() {
        let mut tally = Tally::new(CheckFamily::Force, Tolerances::TOWR);
        tally.not_positive(-5., TOLERANCE, format_args!("a"), None, 0.);
        tally.row(TOLERANCE, TOLERANCE, format_args!("b"), None, 1.);
        tally.not_positive(1.01 * TOLERANCE, TOLERANCE, format_args!("c"), Some(2), 2.);
        assert_eq!((tally.report.rows, tally.report.violated), (3, 1));
        assert_eq!(tally.report.worst.as_ref().map(|w| (w.row.as_str(), w.foot)), Some(("c", Some(2))));
        tally.not_positive(f64::NAN, TOLERANCE, format_args!("d"), None, 3.);
        assert_eq!((tally.report.violated, tally.report.max_violation), (2, f64::INFINITY));
    }

    #[test]
    fn a_family_is_the_index_into_the_list_of_families() {
        for (place, family) in CheckFamily::ALL.into_iter().enumerate() {
            assert_eq!(family as usize, place);
            assert_eq!(serde_json::to_value(family).unwrap(), family.name());
        }
    }
}
