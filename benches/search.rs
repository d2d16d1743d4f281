//! Comparison of searches: best cost that the cross-entropy method, random sampling and a grid reach with the same number of evaluations.
//!
//!     cargo bench --bench search -- [--seeds 10] [--evaluations 64,256,1024] [ROBOT:X,Y ...]

use cregopt::gait::Schedule;
use cregopt::gait::family::{GaitFamily, PeriodicGait, families, offsets, speed_scale, time_scale};
use cregopt::search::cem::Sampler;
use cregopt::search::{Gaits, Search, SearchSettings};
use cregopt::{Cpu, Error, Evaluate, Goal, Result, Robot, Task, Terrain};
use std::time::Instant;

/// Number of generations of the cross-entropy method, including the one in the neighbourhood of the best gait.
const GENERATIONS: usize = 7;

/// Ranges of swing, stance and speed of the grid, in the scales of the robot.
const GRID: [[f64; 2]; 3] = [[0.8, 2.], [0.8, 5.], [0.3, 1.2]];

#[derive(Debug, Clone, Copy, PartialEq)]
enum Method {
    Cem,
    Random,
    Grid,
    FreeCem,
    FreeRandom,
}

const METHODS: [(&str, Method); 5] = [
    ("families, CEM", Method::Cem),
    ("families, random", Method::Random),
    ("families, grid", Method::Grid),
    ("free, CEM", Method::FreeCem),
    ("free, random", Method::FreeRandom),
];

/// Best cost that a method finds, or `None` if it finds no gait.
fn best(method: Method, task: &Task, evaluations: usize, seed: u64, cpu: &Cpu) -> Result<Option<f64>> {
    if method == Method::Grid {
        let solved = Evaluate::new(task).run(&grid(task, evaluations)?, cpu)?;
        return Ok(solved.into_iter().flatten().filter_map(|e| e.cost).map(|c| c.total).reduce(f64::min));
    }
    let cem = matches!(method, Method::Cem | Method::FreeCem);
    let population = if cem { (evaluations / GENERATIONS).max(2) } else { evaluations };
    let mut settings = SearchSettings { further_generations: 0, ..SearchSettings::default() }.with_population(population);
    if matches!(method, Method::FreeCem | Method::FreeRandom) {
        settings.gaits = Gaits::Free;
    }
    (settings.generations, settings.perturbed_generations) = if cem { (GENERATIONS - 1, 1) } else { (1, 0) };
    if !cem {
        settings.free.sampler = Sampler::Random;
    }
    let found = Search::new(task).settings(settings).seed(seed).run(cpu)?;
    Ok(found.best.candidate.solution.cost.filter(|_| found.best.feasible()).map(|c| c.total))
}

/// Schedules of all families on a grid of swings, stances and speeds, at most `evaluations` of them.
fn grid(task: &Task, evaluations: usize) -> Result<Vec<Schedule>> {
    let robot = &task.robot;
    let families: Vec<GaitFamily> = families(robot);
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
    let (mut seeds, mut evaluations, mut tasks) = (10, vec![64, 256, 1024], Vec::new());
    let mut arguments = std::env::args().skip(1).filter(|a| a != "--bench");
    while let Some(argument) = arguments.next() {
        let mut numbers = || arguments.next().unwrap_or_default().split(',').filter_map(|v| v.parse().ok()).collect::<Vec<usize>>();
        match argument.as_str() {
            "--seeds" => seeds = numbers().first().copied().unwrap_or(seeds),
            "--evaluations" => evaluations = numbers(),
            _ => tasks.push(argument),
        }
    }
    if tasks.is_empty() {
        tasks = ["anymal:2,0", "biped:2,0", "pexod:0.5,0"].map(String::from).to_vec();
    }
    let cpu = Cpu::new(0)?;
    println!("| task | evaluations | method | found of {seeds} | cost, median (quartiles) | s per search |\n|---|---|---|---|---|---|");
    for name in &tasks {
        let task = task(name)?;
        for &count in &evaluations {
            for (label, method) in METHODS {
                // A grid has no seed.
                let seeds = if method == Method::Grid { 1 } else { seeds };
                let start = Instant::now();
                let mut costs: Vec<f64> = Vec::new();
                for seed in 1..=seeds as u64 {
                    costs.extend(best(method, &task, count, seed, &cpu)?);
                }
                costs.sort_by(f64::total_cmp);
                let seconds = start.elapsed().as_secs_f64() / seeds as f64;
                let found = costs.len();
                let cost = if costs.is_empty() {
                    "-".into()
                } else {
                    let [low, median, high] = quartiles(&costs);
                    format!("{median:.4} ({low:.4}, {high:.4})")
                };
                println!("| {name} | {count} | {label} | {found} of {seeds} | {cost} | {seconds:.2} |");
            }
        }
    }
    Ok(())
}
