//! A certificate as rows of a table.

use super::Scene;
use crate::report::samples::Sample;
use crate::report::verdict::verdict;
use crate::verify::dense::Extreme;
use crate::verify::labels::of_momentum;
use crate::verify::report::{DENSE_REACH, Family, PENETRATION, ROLLOUT_ATTITUDE, ROLLOUT_POSITION};
use serde::Serialize;

/// A certificate for readers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Certificate {
    /// Whether it holds.
    pub feasible: bool,
    /// What it says in a few words.
    pub verdict: String,
    /// What it was held to, and whose word that is.
    pub terms: Vec<String>,
    /// Worst values over the whole motion.
    pub worst: Vec<WorstRow>,
    /// Counts of rows.
    pub families: Vec<FamilyRow>,
}

/// The worst value of a quantity.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorstRow {
    /// What, in words.
    pub what: &'static str,
    /// Value and its unit.
    pub value: f64,
    /// Unit of value and limit.
    pub unit: &'static str,
    /// What it is held to; none where it is held to nothing.
    pub limit: Option<f64>,
    /// When it occurs first, s.
    pub time: Option<f64>,
    /// At which foot.
    pub foot: Option<usize>,
}

/// One kind of rows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FamilyRow {
    /// What must hold, in words.
    pub about: &'static str,
    /// Number of rows.
    pub rows: usize,
    /// Those violated by more than their tolerance.
    pub violated: usize,
    /// The worst row in words, where one is not exactly kept.
    pub worst: Option<String>,
}

/// What a kind of rows asks for.
fn about(family: Family) -> &'static str {
    match family {
        Family::Dynamics => "Newton and Euler, at instants",
        Family::Momentum => "Forces move the base, each interval",
        Family::BaseAcceleration => "Base acceleration without jumps",
        Family::Reach => "Feet within reach",
        Family::Terrain => "Standing feet on the ground",
        Family::Force => "Normal forces and friction",
        Family::Swing => "Height and speed of swings",
        Family::Bounds => "Start and goal",
        Family::Structure => "Standing feet stand, swinging feet bear nothing",
        Family::Possible => "What no robot does",
        Family::Motion => "All of it between the instants",
        Family::Footing => "Feet as balls, clear of edges",
    }
}

impl Certificate {
    /// The certificate of a motion.
    pub fn new(scene: &Scene, samples: &[Sample]) -> Certificate {
        let report = &scene.report;
        let dense = &report.dense;
        let asked = |limit: f64| of_momentum(scene.trajectory).then_some(limit);
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
            of("Use of friction", friction, 100., "%", None),
            of("Force outside the friction cone", dense.friction_excess, weight, "N", asked(slack)),
            of("Pull of a foot on the ground", dense.pull, weight, "N", asked(slack)),
            of("Foot out of reach", dense.reach_excess, 1e3, "mm", asked(DENSE_REACH)),
            of("Foot below the ground", dense.penetration, 1e3, "mm", asked(PENETRATION)),
            of("Height of a foot", dense.foot_height, 1e3, "mm", None),
            of("Speed of a foot", dense.foot_speed, 1., "m/s", None),
        ];
        if let Some(rollout) = &report.rollout {
            worst.push(of("Base off its plan under the forces", rollout.position, 1e3, "mm", asked(ROLLOUT_POSITION)));
            worst.push(of("Attitude off its plan", rollout.attitude, 1., "deg", asked(ROLLOUT_ATTITUDE)));
        }
        let end = Extreme { value: dense.final_base_speed, time: scene.trajectory.horizon, foot: None };
        worst.push(of("Speed of the base at the end", end, 1., "m/s", None));
        let families = report.families.iter().filter(|family| family.rows > 0);
        Certificate {
            feasible: report.feasible,
            verdict: verdict(scene.trajectory, report),
            terms: scene.terms.clone(),
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
