//! Cost and time of motions of least cost with the durations held.

use crate::cpu_time::cpu_seconds;
use cregopt::backend::Cpu;
use cregopt::experiment::summary::Spread;
use cregopt::gait::cost::{CostWeights, cost};
use cregopt::gait::family::{GaitFamily, PeriodicGait};
use cregopt::gait::{AlignedSchedule, Schedule};
use cregopt::nlp::transcription::force_limit;
use cregopt::nlp::{Problem, trajectory};
use cregopt::reference::ipopt::{Options, Statistics};
use cregopt::refine::program::minimise;
use cregopt::scenario::{SCENARIOS, Scenario};
use cregopt::search::evaluate::{Evaluated, LowerSettings, evaluate};
use cregopt::settings::{Transcription, TranscriptionSettings};
use cregopt::solver::{Outcome, Status, close};
use cregopt::verify::verify_rows;
use cregopt::{Error, Goal, Result, Robot, Task, Terrain, Trajectory};
use std::sync::Arc;

/// Iterations of this solver that minimise the cost.
const ITERATIONS: [usize; 3] = [12, 20, 40];

/// Number of solves over which this solver's time is averaged.
const REPEATS: usize = 5;

/// Options of Ipopt, from the initial values and from the feasible motion.
const OPTIONS: [Options; 2] = [
    Options { tolerance: 1e-4, max_iterations: 500, max_seconds: 60., barrier: None },
    Options { tolerance: 1e-4, max_iterations: 500, max_seconds: 60., barrier: Some(1e-4) },
];

/// Largest relative excess over the best cost of Ipopt with which its faster run counts.
const AS_GOOD: f64 = 0.005;

/// Robots, goals and families that are compared at the typical values of the families.
const GAITS: [(&str, [f64; 2], &[GaitFamily]); 5] = [
    ("biped", [1., 0.], &[GaitFamily::Walk, GaitFamily::Run, GaitFamily::Hop]),
    ("anymal", [2., 0.], &[GaitFamily::Trot, GaitFamily::Walk]),
    ("anymal", [1., 1.], &[GaitFamily::Trot, GaitFamily::Walk]),
    ("pexod", [0.5, 0.], &[GaitFamily::Tripod, GaitFamily::Ripple]),
    ("anymal", [1., 0.], &[GaitFamily::Bound, GaitFamily::Pace, GaitFamily::Pronk]),
];

struct Gait {
    label: String,
    task: Task,
    schedule: Schedule,
    settings: LowerSettings,
}

/// Motion of least cost, or the last point of a run.
struct Run {
    cost: f64,
    feasible: bool,
    seconds: f64,
    /// Iterations, status and time without evaluations of Ipopt.
    statistics: Option<Statistics>,
}

fn typical_gaits() -> Result<Vec<Gait>> {
    let mut gaits = Vec::new();
    for (name, [x, y], families) in GAITS {
        let task = Task::new(Robot::named(name)?, Terrain::flat(), Goal::at(x, y))?;
        for family in families {
            let schedule = PeriodicGait::typical(*family, &task)?.schedule()?;
            let label = format!("{name} {family} ({x}, {y})");
            gaits.push(Gait { label, task: task.clone(), schedule, settings: LowerSettings::default() });
        }
    }
    Ok(gaits)
}

/// Reference candidates of a scenario.
fn reference_gaits(scenario: &Scenario) -> Result<Vec<Gait>> {
    let mut gaits = Vec::new();
    for line in include_str!("../../tests/data/ipopt_candidates.jsonl").lines() {
        let value: serde_json::Value = serde_json::from_str(line).map_err(|e| Error::invalid("line", e, "JSON"))?;
        if value["scenario"] != scenario.name {
            continue;
        }
        let mut task = scenario.task(value["target"].as_u64().unwrap_or(1) as usize)?;
        if scenario.name == "hex" {
            // The reference was computed with the inertia as published.
            task.robot = Arc::new(Robot::named("pexod-as-published")?);
        }
        let durations = serde_json::from_value(value["durations"].clone()).map_err(|e| Error::invalid("durations", e, "lists"))?;
        let label = format!("{} target {} candidate {}", scenario.name, value["target"], value["idx"]);
        // The candidates were drawn for legs without limits.
        let transcription = TranscriptionSettings::paper(Transcription::Momentum);
        let settings = LowerSettings { transcription, ..LowerSettings::default() };
        gaits.push(Gait { label, task, schedule: Schedule::new(durations)?, settings });
    }
    Ok(gaits)
}

/// This solver's motion with `iterations` iterations that minimise the cost, and the mean time of a solve.
fn own(gait: &Gait, iterations: usize, cpu: &Cpu) -> Result<(Option<Evaluated>, f64)> {
    let mut settings = gait.settings.clone();
    settings.solver.optimise.iterations = iterations;
    let start = cpu_seconds();
    let mut solved = None;
    for _ in 0..REPEATS {
        let results = evaluate(&[(&gait.task, &gait.schedule)], &settings, Some(&CostWeights::default()), cpu, false, &|| false)?;
        solved = results.into_iter().next().flatten();
    }
    Ok((solved, (cpu_seconds() - start) / REPEATS as f64))
}

/// Ipopt's motion from the initial values of the problem or from a feasible motion.
fn ipopt(gait: &Gait, schedule: &AlignedSchedule, from: Option<&[f64]>) -> Result<Run> {
    let (settings, weights) = (&gait.settings, CostWeights::default());
    let options = &OPTIONS[usize::from(from.is_some())];
    let (rounding, start) = (settings.solver.optimise.rounding_floor, cpu_seconds());
    let (x, statistics) = minimise(&gait.task, (schedule, from), &settings.transcription, &weights, rounding, options)?;
    let seconds = cpu_seconds() - start;
    let (motion, feasible) = closed(&gait.task, schedule, x, settings)?;
    let robot = &gait.task.robot;
    let cost = cost(&motion, robot, robot.leg_mass(), &weights)?.total;
    Ok(Run { cost, feasible, seconds, statistics: Some(statistics) })
}

/// Motion closed as this solver's are, and whether it is certified.
pub fn closed(task: &Task, schedule: &AlignedSchedule, x: Vec<f64>, settings: &LowerSettings) -> Result<(Trajectory, bool)> {
    let problem = Problem::<f64>::new(task, schedule, &settings.transcription);
    let outcome = Outcome { status: Status::Solved, iterations: 0, factorisations: 0, infeasibility: 0. };
    let (_, x) = close(&problem, outcome, x, &settings.solver, &|| false);
    let motion = trajectory(task, &problem.curves, &x);
    let report = verify_rows(&motion, &task.robot, &task.terrain, force_limit(&settings.transcription, task))?;
    Ok((motion, report.feasible))
}

/// A gait minimised by both solvers.
struct Compared {
    /// Relative excess of this solver's costs over Ipopt's best one.
    excess: [f64; ITERATIONS.len()],
    /// Ratios of Ipopt's time to this solver's: all of it, and without rows, Jacobians and objective.
    ratios: [[f64; ITERATIONS.len()]; 2],
}

/// Compares the solvers on a gait and prints a line; `None` if the gait is not feasible.
fn compare(gait: &Gait, cpu: &Cpu) -> Result<Option<Compared>> {
    let (Some(first), _) = own(gait, 0, cpu)? else { return Ok(None) };
    if !first.feasible {
        return Ok(None);
    }
    let mut own_runs = Vec::new();
    for iterations in ITERATIONS {
        let (solved, seconds) = own(gait, iterations, cpu)?;
        let found = solved.as_ref().and_then(|s| Some((s.cost.as_ref()?.total, s.feasible)));
        let (cost, feasible) = found.unwrap_or((f64::NAN, false));
        own_runs.push(Run { cost, feasible, seconds, statistics: None });
    }
    let runs = [ipopt(gait, &first.schedule, None)?, ipopt(gait, &first.schedule, Some(&first.x))?];
    let best = runs.iter().filter(|r| r.feasible).map(|r| r.cost).fold(f64::INFINITY, f64::min);
    // Ipopt's time is that of its fastest run with the best cost.
    let good = runs.iter().filter(|r| r.feasible && r.cost <= (1. + AS_GOOD) * best);
    let own_time = |r: &Run| r.seconds * r.statistics.as_ref().map_or(1., |s| 1. - s.evaluation_seconds / s.seconds);
    let fastest = |time: &dyn Fn(&Run) -> f64| good.clone().map(time).fold(f64::INFINITY, f64::min);
    let times = [fastest(&|r| r.seconds), fastest(&own_time)];
    let cell = |r: &Run| if r.feasible { format!("{:.4}", r.cost) } else { format!("({:.4})", r.cost) };
    let how = |r: &Run| r.statistics.as_ref().map_or(String::new(), |s| format!("{} in {}", s.status, s.iterations));
    let before = first.cost.as_ref().map_or(f64::NAN, |c| c.total);
    let own_costs = own_runs.iter().map(cell).collect::<Vec<_>>().join(" / ");
    let own_times = own_runs.iter().map(|r| format!("{:.3}", r.seconds)).collect::<Vec<_>>().join(" / ");
    let excess: [f64; 3] = std::array::from_fn(|i| if own_runs[i].feasible { own_runs[i].cost / best - 1. } else { f64::NAN });
    let ratios = times.map(|time| std::array::from_fn(|i| time / own_runs[i].seconds));
    println!(
        "| {} | {before:.4} | {own_costs} | {own_times} | {} / {} | {} / {} | {:.2} / {:.2} | {:.2} / {:.2} | {} | {} |",
        gait.label,
        cell(&runs[0]),
        cell(&runs[1]),
        how(&runs[0]),
        how(&runs[1]),
        runs[0].seconds,
        runs[1].seconds,
        own_time(&runs[0]),
        own_time(&runs[1]),
        excess.map(|e| format!("{:+.2}", 100. * e)).join(" / "),
        ratios[0].map(|r: f64| format!("{r:.0}")).join(" / "),
    );
    Ok(best.is_finite().then_some(Compared { excess, ratios }))
}

/// Runs the comparison.
///
/// * `arguments` - number of reference candidates per scenario, and a part of the label of the typical gaits, each optional
pub fn run(arguments: &[String]) -> Result<()> {
    let count = arguments.iter().find_map(|a| a.parse::<usize>().ok()).unwrap_or(1);
    let filter = arguments.iter().find(|a| a.parse::<usize>().is_err());
    let cpu = Cpu::new(1)?;
    println!("Costs in parentheses are not certified; excess over Ipopt's better run; times are CPU times\n");
    println!(
        "| gait | first motion | own, {} iterations | own, s | Ipopt, from initial values / from the first motion | status, iterations | Ipopt, s | without evaluations, s | excess, % | ratio of times |",
        ITERATIONS.map(|i| i.to_string()).join(" / ")
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let mut all = Vec::new();
    // Ipopt's program evaluates its intervals in parallel; one thread keeps it on one core.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().map_err(|e| Error::invalid("threads", e, "a thread"))?;
    pool.install(|| {
        for gait in typical_gaits()?.iter().filter(|gait| filter.is_none_or(|f| gait.label.contains(f.as_str()))) {
            all.extend(compare(gait, &cpu)?);
        }
        for scenario in SCENARIOS.iter().map(|s| Scenario::named(s.name)) {
            let mut compared = 0;
            for gait in &reference_gaits(&scenario?)? {
                if compared == count {
                    break;
                }
                if let Some(one) = compare(gait, &cpu)? {
                    all.push(one);
                    compared += 1;
                }
            }
        }
        Ok::<_, Error>(())
    })?;
    println!(
        "\n| iterations | excess, %: least | median | largest | over 0.5 % | ratio: least | median | largest | median without evaluations |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for (i, iterations) in ITERATIONS.iter().enumerate() {
        let excess: Vec<f64> = all.iter().map(|c| 100. * c.excess[i]).collect();
        let spread = |values: Vec<f64>| Spread::of(values).map_or([f64::NAN; 3], |s| [s.min, s.median, s.max]);
        let [low, median, high] = spread(excess.clone());
        let [slow, ratio, fast] = spread(all.iter().map(|c| c.ratios[0][i]).collect());
        let [_, bare, _] = spread(all.iter().map(|c| c.ratios[1][i]).collect());
        let over = excess.iter().filter(|e| **e > 100. * AS_GOOD || e.is_nan()).count();
        println!(
            "| {iterations} | {low:+.2} | {median:+.2} | {high:+.2} | {over} of {} | {slow:.0} | {ratio:.0} | {fast:.0} | {bare:.0} |",
            all.len()
        );
    }
    Ok(())
}
