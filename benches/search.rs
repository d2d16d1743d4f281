//! Comparison of searches: best cost that the cross-entropy method, with and without gradients of the durations, random sampling and a
//! grid reach with the same number of evaluations on one core.
//!
//!     cargo bench --bench search -- [--seeds 10] [--evaluations 64,256,1024] [--families] [ROBOT:X,Y ...]
//!
//! An evaluation is a solve of a schedule with the minimisation of its cost, or one minimisation in the descent along the durations. The
//! typical gaits of the families, with which every search but the grid begins, are evaluations, too. `--families` leaves out free gaits.

#[path = "common/cpu_time.rs"]
mod cpu_time;

use cpu_time::cpu_seconds;
use cregopt::gait::Schedule;
use cregopt::gait::family::{GaitFamily, PeriodicGait, default_families, offsets, speed_scale, time_scale};
use cregopt::search::cem::Sampler;
use cregopt::search::evaluate::LowerSettings;
use cregopt::search::{Gaits, Search, SearchSettings};
use cregopt::{Cpu, Error, Evaluate, Goal, Result, Robot, Task, Terrain};

/// Number of generations of the cross-entropy method, including the one in the neighbourhood of the best gait.
const GENERATIONS: usize = 7;

/// Ranges of swing, stance and speed of the grid, in the scales of the robot.
const GRID: [[f64; 2]; 3] = [[0.8, 2.], [0.8, 5.], [0.3, 1.2]];

/// Largest share of the evaluations that are steps along the gradient of the durations.
const GRADIENT_SHARE: f64 = 0.5;

/// Number of descents along the durations in the three rounds of a search with the default number of gaits, if other numbers of strides
/// are better once. Each begins with one minimisation and may repeat that of one motion.
const DESCENTS: usize = 4 + 4 + 3;

/// Number of minimisations with other numbers of strides in these rounds.
const OTHER_STRIDES: usize = 12;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Method {
    Gradients,
    Cem,
    Random,
    Grid,
    FreeCem,
    FreeRandom,
}

const METHODS: [(&str, Method); 6] = [
    ("families, CEM with gradients", Method::Gradients),
    ("families, CEM", Method::Cem),
    ("families, random", Method::Random),
    ("families, grid", Method::Grid),
    ("free, CEM", Method::FreeCem),
    ("free, random", Method::FreeRandom),
];

/// Result of a search.
struct Found {
    /// Cost of the best gait; `None` if the search finds no gait.
    cost: Option<f64>,
    evaluations: usize,
}

/// Searches with at most about `evaluations` evaluations.
fn search(method: Method, task: &Task, evaluations: usize, seed: u64, cpu: &Cpu) -> Result<Found> {
    let mut settings = SearchSettings { further_generations: 0, duration_steps: 0, ..SearchSettings::default() };
    if method == Method::Grid {
        let mut lower = LowerSettings::default();
        lower.solver.optimise.iterations = settings.optimise_iterations;
        lower.transcription.reach_margin = settings.reach_margin * task.robot.base_height;
        let schedules = grid(task, evaluations)?;
        let solved = Evaluate::new(task).settings(lower).run(&schedules, cpu)?;
        let cost = solved.into_iter().flatten().filter_map(|e| e.cost).map(|c| c.total).reduce(f64::min);
        return Ok(Found { cost, evaluations: schedules.len() });
    }
    let free = matches!(method, Method::FreeCem | Method::FreeRandom);
    let cem = matches!(method, Method::Gradients | Method::Cem | Method::FreeCem);
    let mut drawn = evaluations;
    if free {
        settings.gaits = Gaits::Free;
    } else {
        drawn = drawn.saturating_sub(default_families(&task.robot).len());
    }
    if method == Method::Gradients {
        let descents = (GRADIENT_SHARE * evaluations as f64) as usize;
        let steps = (descents.saturating_sub(OTHER_STRIDES) / DESCENTS).saturating_sub(1).max(1);
        settings.duration_steps = (3 * steps).min(SearchSettings::default().duration_steps);
        drawn = drawn.saturating_sub(OTHER_STRIDES + DESCENTS * (2 + settings.duration_steps / 3));
    }
    settings = settings.with_population(if cem { (drawn / GENERATIONS).max(2) } else { drawn });
    (settings.generations, settings.perturbed_generations) = if cem { (GENERATIONS - 1, 1) } else { (1, 0) };
    if !cem {
        settings.free.sampler = Sampler::Random;
    }
    let found = Search::new(task).settings(settings).seed(seed).run(cpu)?;
    let cost = found.best.candidate.solution.cost.filter(|_| found.best.feasible()).map(|c| c.total);
    Ok(Found { cost, evaluations: found.generations.iter().map(|g| g.evaluated).sum::<usize>() + found.duration_solves })
}

/// Schedules of the default families on a grid of swings, stances and speeds, at most `evaluations` of them.
fn grid(task: &Task, evaluations: usize) -> Result<Vec<Schedule>> {
    let robot = &task.robot;
    let families: Vec<GaitFamily> = default_families(robot);
    let points = ((evaluations / families.len()) as f64).cbrt() as usize;
    let value = |[low, high]: [f64; 2], i: usize| low * (high / low).powf((i as f64 + 0.5) / points as f64);
    let mut schedules = Vec::new();
    for family in families {
        for index in 0..points.pow(3) {
            let [swing, stance, speed] = [index % points, index / points % points, index / points / points];
            let gait = PeriodicGait {
                family,
                offsets: offsets(family, robot)?,
                swing: value(GRID[0], swing) * time_scale(robot),
                stance: value(GRID[1], stance) * time_scale(robot),
                strides: 0,
                lead_in: time_scale(robot),
                tail: 0.5 * time_scale(robot),
            };
            schedules.push(gait.for_travel(task, value(GRID[2], speed) * speed_scale(robot)).schedule()?);
        }
    }
    Ok(schedules)
}

/// Lower quartile, median and upper quartile of sorted numbers.
fn quartiles(sorted: &[f64]) -> [f64; 3] {
    [1, 2, 3].map(|q| sorted[(q * (sorted.len() - 1) + 2) / 4])
}

fn task(text: &str) -> Result<Task> {
    let wrong = || Error::Unknown { what: "task", name: text.into(), known: "ROBOT:X,Y".into() };
    let (robot, goal) = text.split_once(':').ok_or_else(wrong)?;
    let goal: Vec<f64> = goal.split(',').filter_map(|v| v.parse().ok()).collect();
    let &[x, y] = goal.as_slice() else { return Err(wrong()) };
    Task::new(Robot::named(robot)?, Terrain::flat(), Goal::at(x, y))
}

fn main() -> Result<()> {
    let (mut seeds, mut evaluations, mut tasks, mut free) = (10, vec![64, 256, 1024], Vec::new(), true);
    let mut arguments = std::env::args().skip(1).filter(|a| a != "--bench");
    while let Some(argument) = arguments.next() {
        let mut numbers = || arguments.next().unwrap_or_default().split(',').filter_map(|v| v.parse().ok()).collect::<Vec<usize>>();
        match argument.as_str() {
            "--seeds" => seeds = numbers().first().copied().unwrap_or(seeds),
            "--evaluations" => evaluations = numbers(),
            "--families" => free = false,
            _ => tasks.push(argument),
        }
    }
    if tasks.is_empty() {
        tasks = ["anymal:2,0", "biped:2,0", "pexod:0.5,0"].map(String::from).to_vec();
    }
    let cpu = Cpu::new(1)?;
    println!(
        "| task | limit | method | found of {seeds} | evaluations | cost, median (quartiles) | CPU s per search |\n|---|---|---|---|---|---|---|"
    );
    for name in &tasks {
        let task = task(name)?;
        for &count in &evaluations {
            for (label, method) in METHODS {
                if !free && matches!(method, Method::FreeCem | Method::FreeRandom) {
                    continue;
                }
                // A grid has no seed.
                let seeds = if method == Method::Grid { 1 } else { seeds };
                let start = cpu_seconds();
                let (mut costs, mut evaluated) = (Vec::<f64>::new(), 0);
                for seed in 1..=seeds as u64 {
                    let found = search(method, &task, count, seed, &cpu)?;
                    costs.extend(found.cost);
                    evaluated += found.evaluations;
                }
                costs.sort_by(f64::total_cmp);
                let (seconds, evaluated) = ((cpu_seconds() - start) / seeds as f64, evaluated as f64 / seeds as f64);
                let found = costs.len();
                let cost = if costs.is_empty() {
                    "-".into()
                } else {
                    let [low, median, high] = quartiles(&costs);
                    format!("{median:.4} ({low:.4}, {high:.4})")
                };
                println!("| {name} | {count} | {label} | {found} of {seeds} | {evaluated:.0} | {cost} | {seconds:.2} |");
            }
        }
    }
    Ok(())
}
