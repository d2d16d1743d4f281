//! Result of a search as text for a terminal.

use crate::error::Result;
use crate::gait::Schedule;
use crate::gait::cost::Cost;
use crate::report::result::{GaitResult, Refinement};
use crate::report::{SolveResult, gait_diagram};
use crate::search::LowerGround;
use std::path::Path;

/// Text of a result.
///
/// * `folder` - folder that the result was written to, if any
///
/// # Errors
/// For durations that are not a schedule.
pub fn text(result: &SolveResult, folder: Option<&Path>) -> Result<String> {
    let mut text = search_text(result);
    text += &gait_text(&result.gait);
    text += &format!("\n{}", gait_diagram(&Schedule::new(result.gait.durations.clone())?));
    for gait in &result.alternatives {
        text += &format!("\nalternative\n{}", gait_text(gait));
    }
    text += &format!("\n{}\n", result.certificate);
    if let Some(joints) = &result.joints {
        text += &format!("\njoints\n{joints}");
        if !joints.kept {
            let advice = if result.search.prefers_joint_limits() {
                "a single family (`--gait`) or a larger `--population` may have a gait within them"
            } else {
                "this search ignored joint limits: without `--first`, the objectives transport, time and effort count them by \
                 `search.cost.joint_excess`"
            };
            text += &format!("  {advice}\n");
        }
    }
    if let Some(diagnosis) = &result.diagnosis {
        text += &format!("\n{diagnosis}");
    }
    if let Some(folder) = folder {
        text += &format!("\nwritten to {}\n", folder.display());
    }
    Ok(text)
}

/// Task, device, and course of the search.
fn search_text(result: &SolveResult) -> String {
    let [x, y, z] = result.base_target;
    let scenario = result.scenario.map(|s| format!("{s}: ")).unwrap_or_default();
    let mut text = format!(
        "{scenario}{} on {}, to ({x:.3}, {y:.3}, {z:.3}) m, yaw {:.3} rad\nseed {}, {}, {} rows\n",
        result.robot,
        result.terrain,
        result.yaw_target,
        result.seed,
        result.solved_on.device,
        result.transcription.name()
    );
    if let Some(fallback) = &result.solved_on.fallback {
        text += &format!("{fallback}\n");
    }
    let generations = result.generations.len();
    let evaluated: usize = result.generations.iter().map(|g| g.evaluated).sum();
    let verdict = if result.feasible { "gait found" } else { "no feasible gait" };
    text += &format!("\n{verdict} in {:.3} s ({}; candidates: {evaluated}, generations: {generations})\n", result.seconds, result.stop);
    if let Some(LowerGround { share, levels, candidates }) = result.lower_ground {
        text += &format!("ground raised from lower relief to {:.1} %: {levels} searches, {candidates} candidates\n", 100. * share);
    }
    if let Some(after) = result.first_feasible_seconds {
        text += &format!("first feasible gait after {after:.3} s\n");
    }
    if let Some(Refinement { refined, seconds, .. }) = &result.refinement {
        let residual = refined.optimality.map_or("-".into(), |o| format!("{:.1e}", o.residual()));
        text += &format!(
            "refined in {seconds:.2} s ({}, {} convex problems, optimality residual {residual}): cost {:.3} before; {} durations changed, by up to {:.3} s\n",
            refined.status, refined.iterations, refined.before.total, refined.changed, refined.largest_change
        );
    }
    text
}

/// A gait in a few lines.
fn gait_text(gait: &GaitResult) -> String {
    let evaluated = &gait.evaluated;
    let total: usize = gait.n_stance.iter().sum();
    let family = gait.family.map(|f| format!("{f}, ")).unwrap_or_default();
    let mut text = format!(
        "{family}horizon {:.2} s, stance phases {:?} ({total}), {} variables, {} after {} iterations\n",
        evaluated.horizon, gait.n_stance, evaluated.n_variables, evaluated.outcome.status, evaluated.outcome.iterations
    );
    if let Some(cost) = &evaluated.cost {
        text += &cost_text(cost);
    }
    text
}

/// Cost of a motion, and the demands on its legs.
fn cost_text(cost: &Cost) -> String {
    let joints = if cost.joint_cost > 0. { format!(", joints {:.3}", cost.joint_cost) } else { String::new() };
    format!(
        "cost {:.3} per weight and distance: leg work {:.3}, swing work {:.3}, effort {:.3} ({:.3} weights^2){joints}\n\
         peak force {:.2} weights, tilt {:.1} deg, feet up to {:.2} m/s and {:.0} m/s^2\n",
        cost.total,
        cost.leg_work,
        cost.swing_work,
        cost.effort_cost,
        cost.effort,
        cost.peak_force,
        cost.tilt,
        cost.foot_speed,
        cost.foot_acceleration
    )
}
