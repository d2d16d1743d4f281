//! Tables of a certificate for the page.

use super::Scene;
use crate::report::samples::Sample;
use crate::report::verdict::verdict;
use crate::verify::curves::Extreme;
use crate::verify::labels::of_momentum;
use crate::verify::report::{CheckFamily, DENSE_REACH, PENETRATION, ROLLOUT_ATTITUDE, ROLLOUT_POSITION};
use serde::Serialize;

/// Certificate as text and tables.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Certificate {
    /// True if the motion is certified.
    pub feasible: bool,
    /// Verdict in a few words.
    pub verdict: String,
    /// Limits used for verification and where each came from.
    pub terms: Vec<String>,
    /// Worst values over the whole motion.
    pub worst: Vec<WorstRow>,
    /// Numbers of rows, per family.
    pub families: Vec<FamilyRow>,
}

/// Worst value of a quantity over the motion.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorstRow {
    /// Name of the quantity.
    pub what: &'static str,
    /// Worst value, in `unit`.
    pub value: f64,
    /// Unit of `value` and `limit`.
    pub unit: &'static str,
    /// Limit in `unit`, or `None` if the quantity is only reported.
    pub limit: Option<f64>,
    /// Time at which the worst value first occurs, s.
    pub time: Option<f64>,
    /// Foot with the worst value.
    pub foot: Option<usize>,
}

/// Counts of the rows of one family.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FamilyRow {
    /// Condition that the rows express.
    pub about: &'static str,
    /// Number of rows.
    pub rows: usize,
    /// Number of rows violated by more than their tolerance.
    pub violated: usize,
    /// Worst row as text, or `None` if no row is violated at all.
    pub worst: Option<String>,
}

/// Condition that the rows of a family express.
fn about(family: CheckFamily) -> &'static str {
    match family {
        CheckFamily::Dynamics => "Newton-Euler equations at instants",
        CheckFamily::Momentum => "Base motion from the forces, per interval",
        CheckFamily::BaseAcceleration => "Continuous base acceleration",
        CheckFamily::Reach => "Feet within reach",
        CheckFamily::Terrain => "Stance feet on the ground",
        CheckFamily::Force => "Normal forces and friction",
        CheckFamily::Swing => "Swing height and speed",
        CheckFamily::Bounds => "Start and goal",
        CheckFamily::Structure => "Stance feet at rest, swing feet unloaded",
        CheckFamily::Possible => "Physical plausibility",
        CheckFamily::Motion => "Limits between the instants",
        CheckFamily::Footing => "Foot balls clear of edges",
        CheckFamily::Sole => "Soles: pressure, torsion, flat ground, yaw, distance",
    }
}

impl Certificate {
    /// Builds the tables from the report of a scene and the samples of its motion.
    pub fn new(scene: &Scene, samples: &[Sample]) -> Certificate {
        let report = scene.report;
        let dense = &report.dense;
        let checked = |limit: f64| of_momentum(scene.trajectory).then_some(limit);
        let of = |what, extreme: Extreme, scale: f64, unit, limit: Option<f64>| WorstRow {
            what,
            value: extreme.value * scale,
            unit,
            limit: limit.map(|limit| limit * scale),
            time: (extreme.value > 0.).then_some(extreme.time),
            foot: extreme.foot,
        };
        let feet = || samples.iter().flat_map(|s| s.feet.iter().enumerate().map(move |(foot, f)| (s.time, foot, f)));
        let greatest = |values: &mut dyn Iterator<Item = (f64, usize, f64)>| {
            let first = Extreme { value: 0., time: 0., foot: None };
            values.fold(
                first,
                |worst, (time, foot, value)| {
                    if value > worst.value { Extreme { value, time, foot: Some(foot) } } else { worst }
                },
            )
        };
        let push = greatest(&mut feet().map(|(time, foot, f)| (time, foot, f.normal_force)));
        let friction = greatest(&mut feet().filter_map(|(time, foot, f)| Some((time, foot, f.friction_use?))));
        let weight = scene.robot.weight();
        let slack = report.tolerances.force / weight;
        let mut worst = vec![
            of("Normal force of a foot", push, 1., "N", Some(scene.force_limit + report.tolerances.force)),
            of("Friction utilisation", friction, 100., "%", None),
            of("Force outside the friction cone", dense.friction_excess, weight, "N", checked(slack)),
            of("Pull of a foot on the ground", dense.pull, weight, "N", checked(slack)),
            of("Foot beyond its reach", dense.reach_excess, 1e3, "mm", checked(DENSE_REACH)),
            of("Foot below the ground", dense.penetration, 1e3, "mm", checked(PENETRATION)),
            of("Height of a foot", dense.foot_height, 1e3, "mm", None),
            of("Speed of a foot", dense.foot_speed, 1., "m/s", None),
        ];
        if let Some(rollout) = &report.rollout {
            worst.push(of("Drift of the base under the planned forces", rollout.position, 1e3, "mm", checked(ROLLOUT_POSITION)));
            worst.push(of("Drift of the attitude", rollout.attitude, 1., "deg", checked(ROLLOUT_ATTITUDE)));
        }
        let end = Extreme { value: dense.final_base_speed, time: scene.trajectory.horizon, foot: None };
        worst.push(of("Speed of the base at the end", end, 1., "m/s", None));
        let families = report.families.iter().filter(|family| family.rows > 0);
        Certificate {
            feasible: report.feasible,
            verdict: verdict(scene.trajectory, report),
            terms: scene.terms.to_vec(),
            worst,
            families: families
                .map(|family| FamilyRow {
                    about: about(family.family),
                    rows: family.rows,
                    violated: family.violated,
                    worst: family.worst.as_ref().filter(|worst| worst.violation > 0.).map(|worst| {
                        let foot = worst.foot.map(|foot| format!(", foot {foot}")).unwrap_or_default();
                        format!("{} by {:.1e} at {:.2} s{foot}", worst.row, worst.violation, worst.time)
                    }),
                })
                .collect(),
        }
    }
}
