//! Iterations that the stall rule saves and candidates that it loses: every candidate is solved with and without it, in f32.
//!
//! `cargo bench --bench stall_rule -- [CANDIDATES]`: number of candidates per target (default 32), drawn as in the first generation of
//! experiment 1, with different seeds. Prints a Markdown table.

use cregopt::gait::Schedule;
use cregopt::nlp::Problem;
use cregopt::nlp::transcription::interval;
use cregopt::scenario::{SCENARIOS, Scenario};
use cregopt::search::cem::random::Draws;
use cregopt::search::cem::{CemSettings, Distribution, FreeDistribution};
use cregopt::settings::{SolverSettings, StallSettings, Transcription, TranscriptionSettings};
use cregopt::solver::{Finish, Outcome, Solver, Status};
use cregopt::task::Task;
use cregopt::{Error, Result};
use rayon::prelude::*;

const TARGETS: [usize; 4] = [3, 8, 13, 18];
const SEED: u64 = 20_251;

/// Outcomes of a candidate with and without the rule.
struct Pair {
    target: usize,
    index: usize,
    without: Outcome,
    with: Outcome,
}

/// Sums over candidates.
#[derive(Default)]
struct Row {
    candidates: usize,
    solved_without: usize,
    solved_with: usize,
    lost: Vec<String>,
    iterations_without: usize,
    iterations_with: usize,
}

impl Row {
    fn add(&mut self, scenario: &str, pair: &Pair) {
        let [without, with] = [pair.without.status, pair.with.status].map(|status| status == Status::Solved);
        self.candidates += 1;
        self.solved_without += usize::from(without);
        self.solved_with += usize::from(with);
        if without && !with {
            self.lost.push(format!("{scenario} target {} no. {}", pair.target, pair.index));
        }
        self.iterations_without += pair.without.iterations;
        self.iterations_with += pair.with.iterations;
    }

    fn print(&self, name: &str) {
        let lost = if self.lost.is_empty() { String::new() } else { format!(": {}", self.lost.join(", ")) };
        let saved = 100. * (1. - self.iterations_with as f64 / self.iterations_without.max(1) as f64);
        println!(
            "| {name} | {} | {} | {} | {}{lost} | {} | {} | {saved:.1} % |",
            self.candidates,
            self.solved_without,
            self.solved_with,
            self.lost.len(),
            self.iterations_without,
            self.iterations_with
        );
    }
}

/// Parses the number of candidates per target. Skips `--bench`, which cargo adds.
fn candidates() -> Result<usize> {
    match std::env::args().skip(1).find(|a| a != "--bench") {
        Some(text) => text.parse().map_err(|_| Error::invalid("argument", text, "a number of candidates per target")),
        None => Ok(32),
    }
}

fn draw(task: &Task, target: usize, index: usize) -> Result<Schedule> {
    let settings = CemSettings::preset("experiment1")?;
    let distribution = FreeDistribution::initial(&settings, task.robot.feet())?;
    distribution.schedule(&distribution.sample(Draws::new(SEED, target, index)))
}

fn solve(task: &Task, target: usize, index: usize) -> Result<Pair> {
    let transcription = TranscriptionSettings::paper(Transcription::Momentum);
    let problem = Problem::<f32>::new(task, &draw(task, target, index)?.aligned(interval(&transcription, &task.robot)), &transcription);
    let outcome = |enabled| {
        let stall = StallSettings { enabled, ..StallSettings::default() };
        let settings = SolverSettings { stall, ..SolverSettings::default() };
        Solver::<f32>::default().solve(&problem, &settings, Finish::Infeasibility(settings.tolerance), None, &|| false)
    };
    Ok(Pair { target, index, without: outcome(false), with: outcome(true) })
}

fn pairs(scenario: &Scenario, candidates: usize) -> Result<Vec<Pair>> {
    let mut pairs = Vec::new();
    for target in TARGETS {
        let task = scenario.task(target)?;
        let solved: Result<Vec<Pair>> = (0..candidates).into_par_iter().map(|index| solve(&task, target, index)).collect();
        pairs.extend(solved?);
    }
    Ok(pairs)
}

fn main() -> Result<()> {
    let candidates = candidates()?;
    let settings = SolverSettings::default();
    println!(
        "cregopt {}, f32, targets {TARGETS:?}, {candidates} candidates each, at most {} iterations, {:?}\n",
        env!("CARGO_PKG_VERSION"),
        settings.max_iterations,
        settings.stall
    );
    println!("| scenario | candidates | solved without | solved with | lost | iterations without | iterations with | saved |");
    println!("|---|---|---|---|---|---|---|---|");
    let mut total = Row::default();
    for scenario in &SCENARIOS {
        let mut row = Row::default();
        for pair in pairs(scenario, candidates)? {
            row.add(scenario.name, &pair);
            total.add(scenario.name, &pair);
        }
        row.print(scenario.name);
    }
    total.print("total");
    Ok(())
}
