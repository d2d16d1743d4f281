//! Search of experiment 1 for every scenario, target and seed. One search stops at the first feasible gait, one after a whole generation.
//!
//! `cargo bench --bench targets -- [SEEDS] [--threads N] [--towr]`: seeds 1 to SEEDS (default 1); 0 threads (default) is one per processor;
//! `--towr` selects TOWR's rows and force limit. Prints Markdown.

use cregopt::backend::{Backend, Cpu};
use cregopt::experiment::summary::Spread;
use cregopt::nlp::transcription::towr::FORCE_LIMIT;
use cregopt::scenario::{SCENARIOS, Scenario, TARGETS};
use cregopt::search::cem::{CemSettings, FreeDistribution};
use cregopt::search::evaluate::LowerSettings;
use cregopt::search::{BatchSolver, search_with};
use cregopt::settings::{Transcription, TranscriptionSettings};
use cregopt::{Error, Result};
use std::sync::atomic::AtomicBool;

/// Summary of a search.
struct Run {
    /// Time to the first feasible gait, s.
    first: Option<f64>,
    /// Time of the whole search, s.
    seconds: f64,
    generations: usize,
    candidates: usize,
}

/// Parses `SEEDS`, `--threads N` and the rows. Skips `--bench`, which cargo adds.
fn arguments() -> Result<(u64, usize, Transcription)> {
    let (mut seeds, mut threads, mut rows) = (1, 0, Transcription::Momentum);
    let mut arguments = std::env::args().skip(1).filter(|a| a != "--bench");
    while let Some(argument) = arguments.next() {
        let number = |text: &str| text.parse::<u32>().map_err(|_| Error::invalid("argument", text, "[SEEDS] [--threads N] [--towr]"));
        if argument == "--threads" {
            threads = number(&arguments.next().unwrap_or_default())? as usize;
        } else if argument == "--towr" {
            rows = Transcription::Towr;
        } else {
            seeds = number(&argument)?.into();
        }
    }
    Ok((seeds, threads, rows))
}

fn run(scenario: &Scenario, rows: Transcription, whole_generation: bool, seeds: u64, backend: &dyn Backend) -> Result<Vec<Run>> {
    let settings = CemSettings { whole_generation, ..CemSettings::preset("experiment1")? };
    let lower = LowerSettings { transcription: TranscriptionSettings::paper(rows), ..LowerSettings::default() };
    let mut runs = Vec::new();
    for target in 1..=TARGETS {
        let mut task = scenario.task(target)?;
        if rows == Transcription::Towr {
            task.force_limit = Some(FORCE_LIMIT);
        }
        for seed in 1..=seeds {
            let level = BatchSolver { task: &task, settings: &lower, backend, cost: None, incumbent: None };
            let distribution = FreeDistribution::initial(&settings, task.robot.feet())?;
            let found = search_with(&level, distribution, &settings, seed, &AtomicBool::new(false), &mut |_| ())?;
            runs.push(Run {
                first: found.first_feasible_after,
                seconds: found.seconds,
                generations: found.generations.len(),
                candidates: found.generations.iter().map(|g| g.evaluated).sum(),
            });
        }
    }
    Ok(runs)
}

/// Median and largest value as two cells of the table.
fn median_and_worst(values: impl Iterator<Item = f64>, decimals: usize) -> String {
    Spread::of(values).map_or("- | -".into(), |s| format!("{:.decimals$} | {:.decimals$}", s.median, s.max))
}

fn main() -> Result<()> {
    let (seeds, threads, rows) = arguments()?;
    let backend = Cpu::new(threads)?;
    let (version, device) = (env!("CARGO_PKG_VERSION"), backend.device());
    println!("cregopt {version}, {device}, {} rows, preset experiment1, targets 1 to {TARGETS}, seeds 1 to {seeds}", rows.name());
    for scenario in &SCENARIOS {
        println!("\n### {}: {}\n", scenario.name, scenario.about);
        println!(
            "| stops at | found | first gait, s: median | worst | whole search, s: median | worst | generations: median | worst | candidates |"
        );
        println!("|---|---|---|---|---|---|---|---|---|");
        for (name, whole_generation) in [("first feasible gait", false), ("whole generation", true)] {
            let runs = run(scenario, rows, whole_generation, seeds, &backend)?;
            println!(
                "| {name} | {} of {} | {} | {} | {} | {} |",
                runs.iter().filter(|r| r.first.is_some()).count(),
                runs.len(),
                median_and_worst(runs.iter().filter_map(|r| r.first), 4),
                median_and_worst(runs.iter().map(|r| r.seconds), 4),
                median_and_worst(runs.iter().map(|r| r.generations as f64), 1),
                runs.iter().map(|r| r.candidates).sum::<usize>()
            );
        }
    }
    Ok(())
}
