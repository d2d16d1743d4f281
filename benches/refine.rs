//! Cost, time and changed durations of typical gaits: as found, minimised with their durations held, and refined. Beside them the best gait
//! that a search finds in the same family.
//! `cargo bench --bench refine -- [--fixed] [--horizon-fixed] [NAME]...`

#[path = "common/cpu_time.rs"]
mod cpu_time;

use cpu_time::cpu_seconds;
use cregopt::backend::Cpu;
use cregopt::gait::cost::{CostWeights, cost};
use cregopt::gait::family::{GaitFamily, PeriodicGait};
use cregopt::refine::{RefineSettings, refine};
use cregopt::robot::Robot;
use cregopt::search::evaluate::{Evaluated, LowerSettings, evaluate};
use cregopt::search::{Gaits, Search, SearchSettings};
use cregopt::task::{Goal, Task};
use cregopt::terrain::Terrain;
use std::f64::consts::PI;
use std::time::Instant;

/// Iterations that minimise the cost for given durations.
const ITERATIONS: usize = 20;

/// Robot, gait, terrain, goal (x, y), yaw.
const GAITS: [(&str, &str, &str, [f64; 2], f64); 20] = [
    ("anymal", "trot", "flat", [2., 0.], 0.),
    ("anymal", "walk", "flat", [2., 0.], 0.),
    ("anymal", "pace", "flat", [2., 0.], 0.),
    ("anymal", "bound", "flat", [2., 0.], 0.),
    ("anymal", "canter", "flat", [2., 0.], 0.),
    ("anymal", "trot", "flat", [1., 1.], PI / 2.),
    ("anymal", "walk", "flat", [1., 1.], PI / 2.),
    ("anymal", "trot", "flat", [0., 0.], PI),
    ("anymal", "trot", "flat", [0., 1.], 0.),
    ("anymal", "trot", "slope", [2., 0.], 0.),
    ("anymal", "trot", "flat", [6., 0.], 0.),
    ("anymal", "walk", "flat", [6., 0.], 0.),
    ("anymal", "trot", "step", [6., 0.], PI),
    ("hyq", "trot", "flat", [2., 0.], 0.),
    ("hyq", "walk", "flat", [2., 0.], 0.),
    ("biped", "walk", "flat", [2., 0.], 0.),
    ("biped", "run", "flat", [2., 0.], 0.),
    ("biped", "walk", "flat", [1., 0.5], PI / 2.),
    ("pexod", "tripod", "flat", [1., 0.], 0.),
    ("pexod", "ripple", "flat", [1., 0.], 0.),
];

fn task(robot: &str, terrain: &str, [x, y]: [f64; 2], yaw: f64) -> cregopt::Result<Task> {
    let (robot, terrain) = (Robot::named(robot)?, Terrain::named(terrain)?);
    Task::new(robot, terrain, Goal::at(x, y).yaw(yaw))
}

/// Typical gait of a family, and the time of its solve, s; `None` if it is not feasible.
///
/// * `iterations` - iterations that minimise the cost
fn found(task: &Task, gait: &str, iterations: usize) -> cregopt::Result<Option<(Evaluated, f64)>> {
    let schedule = PeriodicGait::typical(GaitFamily::named(gait)?, task)?.schedule()?;
    let mut settings = LowerSettings::default();
    settings.solver.optimise.iterations = iterations;
    let start = Instant::now();
    let mut results = evaluate(&[(task, &schedule)], &settings, Some(&CostWeights::default()), &Cpu::new(1)?, false, &|| false)?;
    Ok(results.pop().flatten().filter(|r| r.feasible).map(|r| (r, start.elapsed().as_secs_f64())))
}

/// Cost of the best gait that a search with default settings finds in a family, and the CPU time of the search, s.
fn searched(task: &Task, gait: &str) -> cregopt::Result<(f64, f64)> {
    let settings = SearchSettings { gaits: Gaits::Families(vec![GaitFamily::named(gait)?]), ..SearchSettings::default() };
    let start = cpu_seconds();
    let best = Search::new(task).settings(settings).seed(1).run(&Cpu::new(1)?)?.best;
    let cost = best.candidate.solution.cost.filter(|_| best.feasible()).map_or(f64::NAN, |c| c.total);
    Ok((cost, cpu_seconds() - start))
}

fn main() -> cregopt::Result<()> {
    let args: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let has = |name: &str| args.iter().any(|a| a == name);
    let names: Vec<&String> = args.iter().filter(|a| !a.starts_with("--")).collect();
    let settings = RefineSettings { durations: !has("--fixed"), horizon: !has("--horizon-fixed"), ..RefineSettings::default() };
    let transcription = LowerSettings::default().transcription;
    let weights = CostWeights::default();
    println!(
        "| gait | found | minimised | refined | minimised over refined | searched | searched over refined | leg, swing, effort before | after | horizon, s | changed, s | residual | status | problems | found, s | minimised, s | refined, s | CPU s | searched, CPU s |"
    );
    println!("{}|", "|---".repeat(19));
    for (robot, gait, terrain, goal, yaw) in GAITS {
        let name = format!("{robot} {gait} {terrain} {goal:?} {yaw:.2}");
        if !names.is_empty() && !names.iter().all(|n| name.contains(&n[..])) {
            continue;
        }
        let task = task(robot, terrain, goal, yaw)?;
        let price = |e: &Evaluated| cost(&e.trajectory(&task, &transcription), &task.robot, task.robot.leg_mass(), &weights);
        let Some((plain, seconds)) = found(&task, gait, 0)? else {
            println!("| {name} | not found |");
            continue;
        };
        let minimised = found(&task, gait, ITERATIONS)?;
        let cost_minimised = minimised.as_ref().map(|(e, _)| price(e)).transpose()?.map_or(f64::NAN, |c| c.total);
        let (start, cpu) = (Instant::now(), cpu_seconds());
        let refined = refine(&task, &plain.schedule, &plain.x, &transcription, &weights, &settings, &|| false)?;
        let (took, cpu) = (start.elapsed().as_secs_f64(), cpu_seconds() - cpu);
        let (best, searching) = searched(&task, gait)?;
        let parts = |c: &cregopt::gait::cost::Cost| format!("{:.3} {:.3} {:.3}", c.leg_work, c.swing_work, weights.effort * c.effort_cost);
        println!(
            "| {name} | {:.4} | {cost_minimised:.4} | {:.4}{} | {:.3} | {best:.4} | {:.3} | {} | {} | {:.2} to {:.2} | {} by up to {:.3} | {:.1e} | {:?} | {} | {seconds:.3} | {} | {took:.0} | {cpu:.1} | {searching:.1} |",
            price(&plain)?.total,
            refined.after.total,
            if refined.certified { "" } else { " NOT CERTIFIED" },
            cost_minimised / refined.after.total,
            best / refined.after.total,
            parts(&refined.before),
            parts(&refined.after),
            refined.before.horizon,
            refined.after.horizon,
            refined.changed,
            refined.largest_change,
            refined.optimality.map_or(f64::NAN, |o| o.residual()),
            refined.status,
            refined.iterations,
            minimised.as_ref().map_or("-".into(), |(_, s)| format!("{s:.3}")),
        );
    }
    Ok(())
}
