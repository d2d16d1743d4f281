//! Comparison of a refinement with Ipopt from the same gait.
//!
//! The durations are given, so that the optimum is unique. With free durations there are many optima, and two methods seldom find the same
//! one.

use super::tests::{found, task};
use super::*;
use crate::gait::family::GaitFamily;
use crate::reference::ipopt::{Options, solve};
use crate::search::evaluate::LowerSettings;

/// Largest relative excess of the refined cost over Ipopt's cost.
const AGREEMENT: f64 = 1e-3;

/// Violation of a row below which Ipopt's point counts as feasible.
const FEASIBLE: f64 = 1e-5;

/// Refines a gait, then runs Ipopt from the given and from the refined gait. Returns the costs: given, refined, and Ipopt's two.
fn compare(task: &Task, family: GaitFamily, settings: &RefineSettings) -> [f64; 4] {
    let lower = LowerSettings::default();
    let gait = found(task, family, &lower);
    let weights = CostWeights::default();
    let refined = refine(task, &gait.schedule, &gait.x, &lower.transcription, &weights, settings, &|| false).unwrap();
    assert!(refined.certified && refined.status != RefineStatus::NotClosed, "{:?}", refined.status);
    let cones = TranscriptionSettings { friction: Some(Friction::Cone), ..lower.transcription.clone() };
    let space = Space::new(task, &gait.schedule, &cones, settings);
    let price = Price::new(&space, &weights, task.robot.leg_mass());
    let given = space.start(&gait.schedule, &gait.x);
    let own = space.found(&refined.schedule, &refined.x);
    let (before, after) = (price.value(&given, 0.), price.value(&own, 0.));
    eprintln!(
        "{} {}: given {before:.6}, refined {after:.6}, {:?} {:?}",
        task.robot.name,
        family.name(),
        refined.status,
        refined.optimality
    );
    let ipopt = |from: &Point, roundings: &[f64], barrier: Option<f64>| {
        // Phase boundaries may move around the refined ones.
        let mut program = program::Program::new(&space, &price, &own, 0.).unwrap();
        let mut x: Vec<f64> = from.v.iter().zip(&space.variables.step).map(|(v, l)| v / l).collect();
        // The rounding decreases; every program starts from the solution of the last one.
        let mut best = f64::INFINITY;
        for rounding in roundings {
            program.rounding = rounding * task.robot.weight();
            // Iterations limit the run, not time, so the result is the same on a busy machine.
            let options = Options { tolerance: 1e-6, max_iterations: 400, max_seconds: 600., barrier };
            let (end, how) = solve(&program, Some(&x), &options).unwrap();
            let (violation, cost, _) = program.judged(&end).unwrap();
            eprintln!("{} rounding {rounding:.0e}: cost {cost:.6}, violation {violation:.1e}, {how:?}", family.name());
            x = end;
            if violation < FEASIBLE {
                best = best.min(cost);
            }
        }
        best
    };
    [before, after, ipopt(&given, &[1e-4], None), ipopt(&own, &[1e-4, 1e-5], Some(1e-6))]
}

#[test]
fn ipopt_finds_no_cheaper_gait_with_the_durations_given() {
    let settings = RefineSettings { durations: false, horizon: false, ..RefineSettings::default() };
    let [given, refined, from_given, from_refined] = compare(&task("biped", "flat", [0.6, 0.], 0.), GaitFamily::Walk, &settings);
    assert!(refined < given);
    assert!(refined < from_given * (1. + AGREEMENT), "Ipopt finds {from_given} from the given gait, not {refined}");
    assert!(from_refined.is_finite(), "Ipopt ends at no feasible point");
    assert!(refined < from_refined * (1. + AGREEMENT), "Ipopt goes on to {from_refined} from {refined}");
}
