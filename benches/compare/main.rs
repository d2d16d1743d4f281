//! Comparison of this solver and Ipopt on the same problems, candidate by candidate, on one core each, as Markdown.
//!
//! `cargo bench --features ipopt --bench compare -- [CANDIDATES] [--seed N]`: rates and their ratio. CANDIDATES (default 16) per scenario,
//! spread over its targets and drawn as in the first generation of a search. Horizons are rounded as this solver needs it. This solver uses
//! TOWR's rows, Ipopt TOWR's complete program with the paper's options. Both times include failing candidates and the count of violated
//! rows.
//!
//! `cargo bench --features ipopt --bench compare -- --optimise [CANDIDATES] [FILTER]`: cost and time of minimised motions with the
//! durations held, `momentum` rows, for typical gaits whose label contains FILTER and for CANDIDATES (default 1) feasible reference
//! candidates per scenario. Ipopt starts once from the initial values of the problem and once from the feasible motion, with exact first
//! derivatives, a limited-memory Hessian and the cost at the final rounding. Its motions are closed as this solver's are, outside its time.
//!
//! `cargo bench --features ipopt --bench compare -- --soles [CANDIDATES] [--seed N] [--robot FILE]`: verdicts, times and sizes for
//! CANDIDATES (default 40) problems of a robot with soles (default `humanoid`), without a cost: walks of the first generation of the
//! default search ahead, back, aside and on the spot, and standing. Ipopt solves the same `momentum` rows from the same initial values.
//! This solver also solves them with points in place of the soles.

#[path = "../common/cpu_time.rs"]
mod cpu_time;
mod optimise;
mod soles;

use cregopt::backend::Cpu;
use cregopt::experiment::summary::Spread;
use cregopt::gait::Schedule;
use cregopt::nlp::transcription::{self, towr::FORCE_LIMIT};
use cregopt::reference::ipopt::{self, Options};
use cregopt::reference::job::Job;
use cregopt::scenario::{SCENARIOS, Scenario, TARGETS};
use cregopt::search::cem::random::Draws;
use cregopt::search::cem::{CemSettings, Distribution, FreeDistribution};
use cregopt::search::evaluate::{LowerSettings, evaluate};
use cregopt::settings::{Transcription, TranscriptionSettings};
use cregopt::task::Task;
use cregopt::{Error, Result};
use std::time::Instant;

/// One candidate, solved twice.
struct Pair {
    seconds: [f64; 2],
    feasible: [bool; 2],
    iterations: [usize; 2],
    /// Part of Ipopt's time that rows and Jacobians take, s.
    evaluation_seconds: f64,
}

/// Parses the number of candidates per scenario and the seed. Skips `--bench`, which cargo adds.
fn arguments() -> Result<(usize, u64)> {
    let (mut count, mut seed) = (16, 101);
    let mut arguments = std::env::args().skip(1).filter(|a| a != "--bench");
    while let Some(argument) = arguments.next() {
        let number = |text: &str| text.parse::<u32>().map_err(|_| Error::invalid("argument", text, "[CANDIDATES] [--seed N]"));
        if argument == "--seed" {
            seed = number(&arguments.next().unwrap_or_default())?.into();
        } else {
            count = number(&argument)?.max(1) as usize;
        }
    }
    Ok((count, seed))
}

fn pair(task: &Task, schedule: &Schedule, settings: &LowerSettings, backend: &Cpu, own_first: bool) -> Result<Pair> {
    let own = || {
        let start = Instant::now();
        let results = evaluate(&[(task, schedule)], settings, None, backend, false, &|| false)?;
        let result = results.into_iter().next().flatten();
        Ok::<_, Error>((
            start.elapsed().as_secs_f64(),
            result.as_ref().is_some_and(|r| r.feasible),
            result.map_or(0, |r| r.outcome.iterations),
        ))
    };
    let interval = transcription::interval(&settings.transcription, &task.robot);
    let other = || {
        let start = Instant::now();
        let answer = Job::fixed(task, &schedule.aligned(interval), Options::LOWER_LEVEL).run()?;
        Ok::<_, Error>((start.elapsed().as_secs_f64(), answer))
    };
    // They take turns, so that warming up and other load on the machine affect both.
    let (own, (seconds, answer)) = if own_first {
        (own()?, other()?)
    } else {
        let other = other()?;
        (own()?, other)
    };
    Ok(Pair {
        seconds: [own.0, seconds],
        feasible: [own.1, answer.feasible],
        iterations: [own.2, answer.statistics.iterations],
        evaluation_seconds: answer.statistics.evaluation_seconds,
    })
}

fn main() -> Result<()> {
    ipopt::check()?;
    let mut words = std::env::args().skip(1).filter(|a| a != "--bench").peekable();
    if words.next_if(|word| word == "--optimise").is_some() {
        return optimise::run(&words.collect::<Vec<_>>());
    }
    if words.next_if(|word| word == "--soles").is_some() {
        return soles::run(&words.collect::<Vec<_>>());
    }
    let (count, seed) = arguments()?;
    let backend = Cpu::new(1)?;
    let settings = LowerSettings { transcription: TranscriptionSettings::paper(Transcription::Towr), ..LowerSettings::default() };
    let search = CemSettings::preset("experiment1")?;
    println!(
        "cregopt {}, f32 closed in f64, and Ipopt {}; one core each, in turns",
        env!("CARGO_PKG_VERSION"),
        ipopt::VERSION.unwrap_or("-")
    );
    println!("{count} candidates per scenario over targets 1 to {TARGETS}, seed {seed}; TOWR's rows\n");
    println!(
        "| scenario | feasible, own / Ipopt / both | iterations, own / Ipopt | own, candidates/s | Ipopt, candidates/s | ratio | median ratio of pairs | Ipopt's time in rows and Jacobians |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for scenario in SCENARIOS.iter().map(|s| Scenario::named(s.name)) {
        let scenario = scenario?;
        let mut pairs = Vec::new();
        for candidate in 0..count {
            let mut task = scenario.task(1 + (7 * candidate) % TARGETS)?;
            task.force_limit = Some(FORCE_LIMIT);
            let distribution = FreeDistribution::initial(&search, task.robot.feet())?;
            let schedule = distribution.schedule(&distribution.sample(Draws::new(seed, 0, candidate)))?;
            pairs.push(pair(&task, &schedule, &settings, &backend, candidate % 2 == 0)?);
        }
        let feasible = |who: fn(&Pair) -> bool| pairs.iter().filter(|p| who(p)).count();
        let rate = |who: usize| count as f64 / pairs.iter().map(|p| p.seconds[who]).sum::<f64>();
        let iterations = |who: usize| pairs.iter().map(|p| p.iterations[who]).sum::<usize>();
        println!(
            "| {} | {} / {} / {} | {} / {} | {:.1} | {:.2} | **{:.0}** | {:.0} | {:.1} % |",
            scenario.name,
            feasible(|p| p.feasible[0]),
            feasible(|p| p.feasible[1]),
            feasible(|p| p.feasible[0] && p.feasible[1]),
            iterations(0),
            iterations(1),
            rate(0),
            rate(1),
            rate(0) / rate(1),
            Spread::of(pairs.iter().map(|p| p.seconds[1] / p.seconds[0])).map_or(f64::NAN, |s| s.median),
            100. * pairs.iter().map(|p| p.evaluation_seconds).sum::<f64>() / pairs.iter().map(|p| p.seconds[1]).sum::<f64>(),
        );
    }
    Ok(())
}
