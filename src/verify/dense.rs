//! Worst values of a trajectory between the instants of its rows, in f64 and independently of the solver's kernels.
//!
//! The formulas for Hermite pieces, Euler angles and the rigid body are written here a second time on purpose, so that an error in the
//! solver is not repeated in its check.

use super::curves::{Extreme, Motion, readable};
use super::{ball, exact};
use crate::error::Result;
use crate::gait::Trajectory;
use crate::robot::Robot;
use crate::terrain::Terrain;
use serde::Serialize;
use std::fmt;

/// Interval between the times at which a trajectory is sampled, s.
pub const SAMPLE_STEP: f64 = 1e-3;

/// Worst values between the rows. Forces, penetration and foot speed are bounded on whole curves; quantities that depend on the attitude of
/// the base and the foot height are sampled every [`SAMPLE_STEP`] and at the end.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct DenseReport {
    /// Number of times sampled.
    pub samples: usize,
    /// `|m pddot - sum f + m g e_z| / (m g)`, body weights.
    pub force_defect: Extreme,
    /// `|I_w wdot + w x I_w w - sum (x_i - p) x f_i| / (m g l)`, body weights times leg height.
    pub moment_defect: Extreme,
    /// Largest distance of a foot outside its reach box, along the worst axis of the base, m.
    pub reach_excess: Extreme,
    /// Largest pulling (negative) normal force of a foot, body weights.
    pub pull: Extreme,
    /// Largest force outside the friction cone, `|f_t| - mu f_n`, body weights.
    pub friction_excess: Extreme,
    /// Largest depth of a foot below the terrain, m.
    pub penetration: Extreme,
    /// Largest depth of a foot's ball in the ground during a swing, m.
    pub ball_depth: Extreme,
    /// Largest deviation of the ground within one radius of a foothold from its plane, m; the initial footholds are not counted.
    pub foothold_off_plane: Extreme,
    /// Largest height of a foot above the terrain, m.
    pub foot_height: Extreme,
    /// Largest speed of a foot, m/s.
    pub foot_speed: Extreme,
    /// Speed of the base at the end, m/s.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub final_base_speed: f64,
}

impl fmt::Display for DenseReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let lines = [
            ("force defect", self.force_defect, "m g"),
            ("moment defect", self.moment_defect, "m g l"),
            ("reach excess", self.reach_excess, "m"),
            ("pull", self.pull, "m g"),
            ("friction excess", self.friction_excess, "m g"),
            ("penetration", self.penetration, "m"),
            ("ball in ground", self.ball_depth, "m"),
            ("foothold off plane", self.foothold_off_plane, "m"),
            ("foot height", self.foot_height, "m"),
            ("foot speed", self.foot_speed, "m/s"),
        ];
        for (name, extreme, unit) in lines {
            write!(f, "{name:<18}{:>10} {unit:<6}", readable(extreme.value))?;
            if extreme.value > 0. {
                write!(f, " at {:.3} s", extreme.time)?;
            }
            writeln!(f, "{}", extreme.foot.map(|foot| format!(", foot {foot}")).unwrap_or_default())?;
        }
        writeln!(f, "{:<18}{:>10} m/s", "final base speed", readable(self.final_base_speed))
    }
}

/// Samples a trajectory and reports the worst value of each quantity.
///
/// # Errors
/// [`crate::Error::Invalid`] if the trajectory is malformed, or if robot and trajectory disagree on the number of feet.
pub fn dense(trajectory: &Trajectory, robot: &Robot, terrain: &Terrain) -> Result<DenseReport> {
    Ok(sample(&Motion::new(trajectory, robot)?, terrain))
}

/// [`dense`] for curves that are already laid out in time.
pub(super) fn sample(motion: &Motion, terrain: &Terrain) -> DenseReport {
    let robot = motion.robot;
    let (weight, leg) = (robot.weight(), robot.leg_height());
    let mut report = DenseReport::default();
    let steps = (motion.horizon / SAMPLE_STEP) as usize;
    for time in (0..=steps).map(|i| i as f64 * SAMPLE_STEP).chain([motion.horizon]) {
        report.samples += 1;
        let base = motion.base(time);
        let (moment, force) = motion.defect(&base, time);
        report.moment_defect.update(moment.norm() / (weight * leg), None, time);
        report.force_defect.update(force.norm() / weight, None, time);
        for foot in 0..motion.feet.len() {
            let at = Some(foot);
            let place = motion.feet[foot].motion.at(time);
            for excess in motion.reach_excess(&base, foot, place.value) {
                report.reach_excess.update(excess, at, time);
            }
            report.foot_height.update(place.value.z - terrain.height(place.value.x, place.value.y), at, time);
        }
    }
    let [pull, _, friction] = exact::forces(motion, terrain, f64::INFINITY, 0.);
    let in_weights = |e: Extreme| Extreme { value: e.value / weight, ..e };
    (report.pull, report.friction_excess) = (in_weights(pull), in_weights(friction));
    report.penetration = exact::penetration(motion, terrain, 0.);
    let radius = motion.robot.foot_radius();
    for (foot, curves) in motion.feet.iter().enumerate().filter(|_| radius > 0. && terrain.has_edges()) {
        for swing in curves.swings() {
            let before = report.ball_depth.value;
            let over = ball::swing_depth(curves, swing, terrain, radius, [before; 2]);
            report.ball_depth.update(before + over.value, Some(foot), over.time);
            if curves.lands_later(swing) {
                continue;
            }
            let off = ball::off_plane(terrain, curves.place(swing[1]), radius, report.foothold_off_plane.value);
            report.foothold_off_plane.update(off, Some(foot), swing[1]);
        }
    }
    for (foot, curves) in motion.feet.iter().enumerate() {
        let speed = exact::foot_speed(curves, 0..curves.motion.pieces(), false, report.foot_speed.value);
        report.foot_speed.update(speed.value, Some(foot), speed.time);
    }
    report.final_base_speed = motion.base_lin.at(motion.horizon).first.norm();
    report
}
