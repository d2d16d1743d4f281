//! Evaluation of the rows.

use super::candidates::{Candidate, candidates, long_candidates};
use super::lab::{CAPACITY, Expected, Lab, SMALL, State, gpu, states, stem};
use super::{ARITHMETIC, CURVED, DEVIATION, TRIGONOMETRY};
use crate::common;
use cregopt::backend::gpu::Prepared;
use cregopt::backend::gpu::shaders::Shader;
use cregopt::backend::tables::Slot as Counts;
use cregopt::rows::momentum::Deviation;
use cregopt::rows::table::NONE;
use cregopt::rows::{
    Shared, acceleration, cone, cone_curvature, dynamics, effort, footing, force, goal, ground, joint_speed, joint_torque, momentum,
    periodic, reach, sole, stance_power, stride, swing, swing_power, turn,
};
use cregopt::solver::control::{CLOSE, ENDED, EXACT, SHORTER, SOLVED, STEP};
use cregopt::terrain::Ground;
use std::collections::{BTreeMap, BTreeSet};

/// Number of long candidates.
const LONG: usize = 4;

/// Truncates tables so that their numbers of entries lie around the workgroup size.
fn around_the_workgroup(s: usize, prepared: &mut Prepared) {
    let count = [63, 64, 65, usize::MAX][s / LONG % 4];
    let (problem, slot) = (&mut prepared.problem, &mut prepared.slot);
    problem.dynamics_instants.truncate(count);
    problem.momentum_intervals.truncate(count);
    problem.reach_instants.truncate(count);
    problem.force_nodes.truncate(count);
    problem.swing_nodes.truncate(count);
    problem.strides.truncate(count);
    problem.accelerations.truncate(count);
    problem.cones.truncate(count);
    problem.footings.truncate(count);
    problem.sole_points.truncate(count);
    problem.turns.truncate(count);
    problem.periodics.truncate(count);
    problem.cone_curvatures.truncate(count);
    problem.efforts.truncate(count);
    problem.stance_powers.truncate(count);
    problem.swing_powers.truncate(count);
    problem.goals.truncate(count);
    // One entry per part of a stance or a swing: the first ones of a foot already reach the intervals that were cut off.
    let intervals = problem.momentum_intervals.len() as u32;
    problem.joint_torques.retain(|torque| torque.base.interval < intervals);
    problem.joint_speeds.retain(|speed| speed.base.interval < intervals);
    problem.joint_torques.truncate(count);
    problem.joint_speeds.truncate(count);
    slot.dynamics_instants = problem.dynamics_instants.len() as u32;
    slot.momentum_intervals = problem.momentum_intervals.len() as u32;
    slot.reach_instants = problem.reach_instants.len() as u32;
    slot.force_nodes = problem.force_nodes.len() as u32;
    slot.swing_nodes = problem.swing_nodes.len() as u32;
    slot.strides = problem.strides.len() as u32;
    slot.accelerations = problem.accelerations.len() as u32;
    slot.cones = problem.cones.len() as u32;
    slot.footings = problem.footings.len() as u32;
    slot.sole_points = problem.sole_points.len() as u32;
    slot.turns = problem.turns.len() as u32;
    slot.periodics = problem.periodics.len() as u32;
    slot.cone_curvatures = problem.cone_curvatures.len() as u32;
    slot.efforts = problem.efforts.len() as u32;
    slot.stance_powers = problem.stance_powers.len() as u32;
    slot.swing_powers = problem.swing_powers.len() as u32;
    slot.goals = problem.goals.len() as u32;
    slot.joint_torques = problem.joint_torques.len() as u32;
    slot.joint_speeds = problem.joint_speeds.len() as u32;
    slot.footholds = slot.footholds.min(count as u32);
}

/// Runs an evaluation shader on short candidates and on long ones, and its twin.
///
/// * `counted` - entries that the shader processes
/// * `twin` - writes the expected results at the trial point: slot, its problem, x, ground and deviations there, output
fn evaluation(
    shader: Shader,
    counted: fn(&Counts) -> u32,
    tolerance: f32,
    twin: impl Fn(&Lab, usize, &[f32], &Shared<f32>, &mut Expected),
) {
    let test = format!("{}_agrees_with_its_twin", stem(shader));
    let Some(device) = gpu(&test) else { return };
    let (small, long) = (candidates(), long_candidates());
    let labs = [Lab::new(&device, &small, CAPACITY, SMALL, |_, _| {}), Lab::new(&device, &long, 4 * LONG, SMALL, around_the_workgroup)];
    let long_counts: BTreeSet<u32> = labs[1].slots.iter().map(|s| counted(&s.counts)).collect();
    assert!([63, 64, 65].iter().all(|n| long_counts.contains(n)), "entries of the long candidates: {long_counts:?}");
    // All long candidates are evaluated.
    for (mut lab, of_states) in labs.into_iter().zip([&[STEP, CLOSE, EXACT, SOLVED, SHORTER][..], &[STEP, CLOSE, EXACT, SHORTER]]) {
        let mut before = lab.poisoned();
        states(&lab, &mut before, of_states);
        // Shared by all lists: x, ground and deviations at the trial point.
        let mut shared = Vec::new();
        for (s, slot) in lab.slots.iter().enumerate() {
            let (problem, x) = (&slot.problem, &slot.candidate.x);
            let at = common::shared(problem);
            let mut at =
                Shared { ground: at.ground, deviations: vec![Deviation::default(); problem.momentum_intervals.len()], frozen: false };
            ground::ground(problem, x, &mut at.ground);
            let mut c = vec![0.; problem.rows.one_sided()];
            momentum::momentum(problem, x, &at.ground, &mut at.deviations, false, &mut c, None);
            let trial = 1 - before.progress[s].current;
            before.values[lab.x(s, trial)].copy_from_slice(x);
            if shader != Shader::Ground {
                let to = lab.range(s, lab.batch.ground, 3 * at.ground.len());
                before.values[to].copy_from_slice(&flat(&at.ground));
            }
            if matches!(shader, Shader::Reach | Shader::StancePower | Shader::SwingPower | Shader::JointTorque | Shader::JointSpeed) {
                let to = lab.range(s, lab.batch.deviations, 36 * at.deviations.len());
                before.values[to].copy_from_slice(&poses(&at.deviations));
            }
            shared.push(at);
        }
        for list in lab.lists() {
            let mut expected = Expected { state: before.clone(), sizes: BTreeMap::new() };
            for &s in &list {
                let s = s as usize;
                if before.progress[s].state < ENDED {
                    twin(&lab, s, &lab.slots[s].candidate.x, &shared[s], &mut expected);
                }
            }
            let got = lab.run(shader, &list, &before);
            lab.check(shader, &got, &expected, |name| match name {
                "deviations" => DEVIATION,
                "c" | "g" | "jacobian" | "ground" => tolerance,
                _ => 0.,
            });
        }
    }
}

fn flat(ground: &[Ground<f32>]) -> Vec<f32> {
    ground.iter().flat_map(|g| [g.height, g.slope[0], g.slope[1]]).collect()
}

fn poses(deviations: &[Deviation<f32>]) -> Vec<f32> {
    deviations.iter().flat_map(|d| d.pose.into_iter().flatten()).collect()
}

/// Residuals and Jacobian of the trial point, in the state.
fn trial<'s>(lab: &Lab, s: usize, equality: bool, state: &'s mut State) -> (&'s mut [f32], &'s mut [f32]) {
    let half = 1 - state.progress[s].current;
    let residual = if equality { lab.c(s, half) } else { lab.g(s, half) };
    (&mut state.values[residual], &mut state.jacobian[lab.jacobian(s, half)])
}

#[test]
fn ground_agrees_with_its_twin() {
    evaluation(
        Shader::Ground,
        |slot| slot.footholds,
        ARITHMETIC,
        |lab, s, _, shared, expected| {
            let count = lab.slots[s].counts.footholds as usize;
            let ground = flat(&shared.ground[..count]);
            // The slopes of the terrains reach 17.
            let to = lab.range(s, lab.batch.ground, ground.len());
            expected.state.values[to].copy_from_slice(&ground);
        },
    );
}

#[test]
fn dynamics_agrees_with_its_twin() {
    evaluation(
        Shader::Dynamics,
        |slot| slot.dynamics_instants,
        TRIGONOMETRY,
        |lab, s, x, shared, expected| {
            let (c, jacobian) = trial(lab, s, true, &mut expected.state);
            dynamics::dynamics(&lab.slots[s].problem, x, &shared.ground, c, Some(jacobian));
        },
    );
}

#[test]
fn momentum_agrees_with_its_twin() {
    evaluation(
        Shader::Momentum,
        |slot| slot.momentum_intervals,
        TRIGONOMETRY,
        |lab, s, x, shared, expected| {
            let problem = &lab.slots[s].problem;
            let mut deviations = vec![Deviation::default(); problem.momentum_intervals.len()];
            let (c, jacobian) = trial(lab, s, true, &mut expected.state);
            momentum::momentum(problem, x, &shared.ground, &mut deviations, false, c, Some(jacobian));
            let to = lab.range(s, lab.batch.deviations, 36 * deviations.len());
            expected.state.values[to].copy_from_slice(&poses(&deviations));
        },
    );
}

#[test]
fn reach_agrees_with_its_twin() {
    evaluation(
        Shader::Reach,
        |slot| slot.reach_instants,
        // In units of 0.1 m, of feet that are some metres away.
        2. * TRIGONOMETRY,
        |lab, s, x, shared, expected| {
            let (g, jacobian) = trial(lab, s, false, &mut expected.state);
            reach::reach(&lab.slots[s].problem, x, &shared.ground, &shared.deviations, g, Some(jacobian));
        },
    );
}

#[test]
fn force_agrees_with_its_twin() {
    evaluation(
        Shader::Force,
        |slot| slot.force_nodes,
        CURVED,
        |lab, s, x, _, expected| {
            let edge_radius = expected.state.progress[s].edge_radius;
            let (g, jacobian) = trial(lab, s, false, &mut expected.state);
            force::force(&lab.slots[s].problem, x, edge_radius, g, Some(jacobian));
        },
    );
}

#[test]
fn cone_agrees_with_its_twin() {
    evaluation(
        Shader::Cone,
        |slot| slot.cones,
        // The tangential force has a root of its own, whose parts cancel: the same error again, and more where that force is small.
        3. * CURVED,
        |lab, s, x, _, expected| {
            let edge_radius = expected.state.progress[s].edge_radius;
            let (g, jacobian) = trial(lab, s, false, &mut expected.state);
            cone::cone(&lab.slots[s].problem, x, edge_radius, g, Some(jacobian));
        },
    );
}

#[test]
fn cone_curvature_agrees_with_its_twin() {
    evaluation(
        Shader::ConeCurvature,
        |slot| slot.cone_curvatures,
        // As above.
        3. * CURVED,
        |lab, s, x, _, expected| {
            let (c, jacobian) = trial(lab, s, true, &mut expected.state);
            cone_curvature::cone_curvature(&lab.slots[s].problem, x, c, Some(jacobian));
        },
    );
}

#[test]
fn swing_agrees_with_its_twin() {
    // The rows are in units of 0.1 m.
    evaluation(
        Shader::Swing,
        |slot| slot.swing_nodes,
        16. * ARITHMETIC,
        |lab, s, x, shared, expected| {
            let (g, jacobian) = trial(lab, s, false, &mut expected.state);
            swing::swing(&lab.slots[s].problem, x, &shared.ground, g, Some(jacobian));
        },
    );
}

#[test]
fn stride_agrees_with_its_twin() {
    evaluation(
        Shader::Stride,
        |slot| slot.strides,
        8. * ARITHMETIC,
        |lab, s, x, _, expected| {
            let (g, jacobian) = trial(lab, s, false, &mut expected.state);
            stride::stride(&lab.slots[s].problem, x, g, Some(jacobian));
        },
    );
}

#[test]
fn footing_agrees_with_its_twin() {
    evaluation(
        Shader::Footing,
        |slot| slot.footings,
        8. * ARITHMETIC,
        |lab, s, x, _, expected| {
            let (g, jacobian) = trial(lab, s, false, &mut expected.state);
            footing::footing(&lab.slots[s].problem, x, g, Some(jacobian));
        },
    );
}

#[test]
fn sole_agrees_with_its_twin() {
    evaluation(
        Shader::Sole,
        |slot| slot.sole_points,
        // Twice the parts of a cone: the torsion has a root of its own, and is divided by the normal force.
        8. * CURVED,
        |lab, s, x, _, expected| {
            let (g, jacobian) = trial(lab, s, false, &mut expected.state);
            sole::sole(&lab.slots[s].problem, x, g, Some(jacobian));
        },
    );
}

#[test]
fn turn_agrees_with_its_twin() {
    evaluation(
        Shader::Turn,
        |slot| slot.turns,
        8. * ARITHMETIC,
        |lab, s, x, _, expected| {
            let (g, jacobian) = trial(lab, s, false, &mut expected.state);
            turn::turn(&lab.slots[s].problem, x, g, Some(jacobian));
        },
    );
}

#[test]
fn acceleration_agrees_with_its_twin() {
    evaluation(
        Shader::Acceleration,
        |slot| slot.accelerations,
        8. * ARITHMETIC,
        |lab, s, x, shared, expected| {
            let (g, jacobian) = trial(lab, s, false, &mut expected.state);
            acceleration::acceleration(&lab.slots[s].problem, x, &shared.ground, g, Some(jacobian));
        },
    );
}

#[test]
fn effort_agrees_with_its_twin() {
    evaluation(
        Shader::Effort,
        |slot| slot.efforts,
        ARITHMETIC,
        |lab, s, x, _, expected| {
            let (c, jacobian) = trial(lab, s, true, &mut expected.state);
            effort::effort(&lab.slots[s].problem, x, c, Some(jacobian));
        },
    );
}

#[test]
fn stance_power_agrees_with_its_twin() {
    evaluation(
        Shader::StancePower,
        |slot| slot.stance_powers,
        8. * TRIGONOMETRY,
        |lab, s, x, shared, expected| {
            let (c, jacobian) = trial(lab, s, true, &mut expected.state);
            stance_power::stance_power(&lab.slots[s].problem, x, &shared.ground, &shared.deviations, c, Some(jacobian));
        },
    );
}

#[test]
fn swing_power_agrees_with_its_twin() {
    evaluation(
        Shader::SwingPower,
        |slot| slot.swing_powers,
        8. * TRIGONOMETRY,
        |lab, s, x, shared, expected| {
            let (c, jacobian) = trial(lab, s, true, &mut expected.state);
            swing_power::swing_power(&lab.slots[s].problem, x, &shared.ground, &shared.deviations, c, Some(jacobian));
        },
    );
}

#[test]
fn periodic_agrees_with_its_twin() {
    evaluation(
        Shader::Periodic,
        |slot| slot.periodics,
        ARITHMETIC,
        |lab, s, x, _, expected| {
            let (c, jacobian) = trial(lab, s, true, &mut expected.state);
            periodic::periodic(&lab.slots[s].problem, x, c, Some(jacobian));
        },
    );
}

#[test]
fn joint_torque_agrees_with_its_twin() {
    evaluation(
        Shader::JointTorque,
        |slot| slot.joint_torques,
        8. * TRIGONOMETRY,
        |lab, s, x, shared, expected| {
            let (c, jacobian) = trial(lab, s, true, &mut expected.state);
            joint_torque::joint_torque(&lab.slots[s].problem, x, &shared.ground, &shared.deviations, c, Some(jacobian));
        },
    );
}

#[test]
fn joint_speed_agrees_with_its_twin() {
    evaluation(
        Shader::JointSpeed,
        |slot| slot.joint_speeds,
        // Rates are divided by lever arms of decimetres, and their derivatives once more.
        64. * TRIGONOMETRY,
        |lab, s, x, shared, expected| {
            let (c, jacobian) = trial(lab, s, true, &mut expected.state);
            joint_speed::joint_speed(&lab.slots[s].problem, x, &shared.ground, &shared.deviations, c, Some(jacobian));
        },
    );
}

#[test]
fn goal_agrees_with_its_twin() {
    evaluation(
        Shader::Goal,
        |slot| slot.goals,
        ARITHMETIC,
        |lab, s, x, _, expected| {
            let (c, jacobian) = trial(lab, s, true, &mut expected.state);
            goal::goal(&lab.slots[s].problem, x, c, Some(jacobian));
        },
    );
}

#[test]
fn the_candidates_in_mid_stride_cover_swings_that_rise_and_swings_that_only_descend() {
    let candidates = candidates();
    let fixed = |column: u32| column == NONE;
    let of = |count: fn(&Candidate) -> usize| candidates.iter().map(count).sum::<usize>();
    assert!(of(|c| c.problem.goals.len()) > 20);
    // Offsets of the position, the velocity and the acceleration.
    assert!(of(|c| c.problem.reach_legs.iter().filter(|leg| leg.offset != [0.; 3]).count()) > 20);
    assert!(of(|c| c.problem.swing_powers.iter().filter(|power| power.foot.offset != [[0.; 3]; 2]).count()) > 20);
    for descends in [false, true] {
        let swings = candidates.iter().flat_map(|c| &c.problem.swing_nodes).filter(|s| s.offset[..2] != [0.; 2]);
        assert!(swings.filter(|s| fixed(s.height_column) == descends).count() > 2, "swings, fixed height: {descends}");
    }
    // The foothold before a swing that had begun is a fixed point.
    let accelerations = || candidates.iter().flat_map(|c| &c.problem.accelerations);
    assert!(accelerations().filter(|a| fixed(a.height_column)).count() > 2);
    assert!(accelerations().filter(|a| !fixed(a.height_column) && fixed(a.foothold_column[0])).count() > 2);
}
