//! Batches of growing size on a device and on the CPU: candidates per second, time per shader, transfers, host time and memory.
//!
//! `cargo bench --bench batches -- [--device NAME] [--scenario NAME] [--from N] [--to N] [--towr] [--slots N] [--workgroup N] [--alone]`.
//! Batch sizes double, by default from 16 to 256. Each is solved once before it is timed, which excludes compilation. Candidates are drawn
//! as in the first generation of a search. With `--alone` the CPU solves nothing, and nothing is certified. Prints Markdown.
//!
//! `cargo bench --bench batches -- --host [--scenario NAME] [--from N]`: cost of a candidate on the host, without a device.
//!
//! `cargo bench --bench batches -- --traffic [--scenario NAME] [--from N] [--towr]`: bytes and operations per round and shader, and the
//! resulting bounds of GPUs. Nothing runs on a device.

mod counted;
mod host;
mod operations;
mod traffic;

use cregopt::backend::gpu::Device;
use cregopt::backend::{Backend, Cpu, Gpu, Instance, Job, Precision, Solution};
use cregopt::gait::Schedule;
use cregopt::gait::family::families;
use cregopt::nlp::transcription;
use cregopt::scenario::Scenario;
use cregopt::search::cem::{
    self, CemSettings, Distribution, Evaluation, FreeDistribution, GenerationEvaluator, GenerationResults, PeriodicDistribution,
    PeriodicSettings, SelectionGoal,
};
use cregopt::search::evaluate::{LowerSettings, evaluate};
use cregopt::settings::{Transcription, TranscriptionSettings};
use cregopt::task::Task;
use cregopt::{Error, Result};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

struct Arguments {
    device: Option<String>,
    scenario: String,
    from: usize,
    to: usize,
    rows: Transcription,
    slots: Option<usize>,
    workgroup: Option<u32>,
    alone: bool,
    host: bool,
    traffic: bool,
}

fn arguments() -> Result<Arguments> {
    let mut parsed = Arguments {
        device: None,
        scenario: "s1".into(),
        from: 16,
        to: 256,
        rows: Transcription::Momentum,
        slots: None,
        workgroup: None,
        alone: false,
        host: false,
        traffic: false,
    };
    let mut arguments = std::env::args().skip(1).filter(|a| a != "--bench");
    while let Some(argument) = arguments.next() {
        let mut text = || arguments.next().unwrap_or_default();
        let number = |text: String| text.parse::<usize>().map_err(|_| Error::invalid("argument", text, "a number"));
        match argument.as_str() {
            "--device" => parsed.device = Some(text()),
            "--scenario" => parsed.scenario = text(),
            "--from" => parsed.from = number(text())?.max(1),
            "--to" => parsed.to = number(text())?,
            "--slots" => parsed.slots = Some(number(text())?),
            "--workgroup" => parsed.workgroup = Some(number(text())? as u32),
            "--alone" => parsed.alone = true,
            "--host" => parsed.host = true,
            "--traffic" => parsed.traffic = true,
            "--towr" => parsed.rows = Transcription::Towr,
            _ => return Err(Error::invalid("argument", argument, "one of those in benches/batches/main.rs")),
        }
    }
    Ok(parsed)
}

/// Evaluator that only keeps the first generation of a search: its schedules, the time of drawing them in s, and the start.
struct Keep(Vec<Schedule>, f64, Instant);

impl GenerationEvaluator for Keep {
    type Solution = ();

    fn evaluate(&mut self, _: usize, schedules: &[Schedule], _: &SelectionGoal) -> GenerationResults<()> {
        self.1 = self.2.elapsed().as_secs_f64();
        self.0 = schedules.to_vec();
        let evaluation = Evaluation { n_violated: 1, feasible: false, certified: true, mean_normal_force: 0., cost: None };
        schedules.iter().map(|_| Some((evaluation, None))).collect()
    }
}

/// Settings of the paper with another population.
fn settings(count: usize) -> Result<CemSettings> {
    Ok(CemSettings { population: count, elites: (count / 4).max(1), generations: 1, ..CemSettings::preset("experiment1")? })
}

/// Generation of candidates, with the times of drawing it and of the update after it, s.
fn population(distribution: impl Distribution, settings: &CemSettings) -> Result<(Vec<Schedule>, f64, f64)> {
    let mut keep = Keep(Vec::new(), 0., Instant::now());
    cem::run(settings, distribution, 1, 0, &mut keep, &mut |_| ())?;
    let whole = keep.2.elapsed().as_secs_f64();
    Ok((keep.0, keep.1, whole - keep.1))
}

/// Time of solving a batch on a backend without certification, s, and how many were solved.
fn solve(backend: &dyn Backend, task: &Task, schedules: &[Schedule], lower: &LowerSettings) -> (f64, usize) {
    let interval = transcription::interval(&lower.transcription, &task.robot);
    let instances: Vec<Instance> = schedules.iter().map(|s| Instance { task, schedule: s.aligned(interval) }).collect();
    let LowerSettings { transcription, solver, .. } = lower;
    let job = Job { instances: &instances, transcription, settings: solver, precision: Precision::F32, certified: false };
    let solved = AtomicUsize::new(0);
    let count = |_: usize, s: Solution| {
        solved.fetch_add(usize::from(s.outcome.status == cregopt::solver::Status::Solved), Ordering::Relaxed);
    };
    let start = Instant::now();
    backend.solve(&job, &|_| false, &count);
    (start.elapsed().as_secs_f64(), solved.into_inner())
}

/// Prints the table of the host's work, for draws of the paper and of a default search.
fn host(task: &Task, count: usize) -> Result<()> {
    let settings = settings(count)?;
    let paper = population(FreeDistribution::initial(&settings, task.robot.feet())?, &settings)?.0;
    let periodic = PeriodicDistribution::initial(task, &families(&task.robot), &PeriodicSettings::default())?;
    let gaits = population(periodic, &settings)?.0;
    host::print_head(count);
    for rows in [Transcription::Momentum, Transcription::Towr] {
        let free = LowerSettings { transcription: TranscriptionSettings::paper(rows), ..LowerSettings::default() };
        host::print("the paper's", task, &paper, &free);
        let limited = LowerSettings { transcription: TranscriptionSettings::of(rows), ..LowerSettings::default() };
        host::print("periodic gaits", task, &gaits, &limited);
    }
    Ok(())
}

fn main() -> Result<()> {
    let arguments = arguments()?;
    let task = Scenario::named(&arguments.scenario)?.task(10)?;
    if arguments.host {
        return host(&task, arguments.from);
    }
    let lower = LowerSettings { transcription: TranscriptionSettings::paper(arguments.rows), ..LowerSettings::default() };
    if arguments.traffic {
        let settings = settings(arguments.from)?;
        let schedules = population(FreeDistribution::initial(&settings, task.robot.feet())?, &settings)?.0;
        return traffic::print(&task, &schedules, &lower);
    }
    let open = || -> Result<Gpu> {
        let mut device = Device::open(arguments.device.as_deref())?;
        if let Some(invocations) = arguments.workgroup {
            device = device.with_workgroup(invocations);
        }
        let gpu = Gpu::new(device, 0)?;
        Ok(match arguments.slots {
            Some(slots) => gpu.with_slots(slots),
            None => gpu,
        })
    };
    let start = Instant::now();
    let gpu = open()?;
    println!("{}; opened, compiled and tested in {:.2} s", gpu.device(), start.elapsed().as_secs_f64());
    let start = Instant::now();
    let timed = open()?.timed();
    println!("a second time {:.2} s; {}, {} rows\n", start.elapsed().as_secs_f64(), arguments.scenario, arguments.rows.name());
    let cpu = Cpu::new(0)?;
    println!(
        "| batch | gpu, candidates/s | cpu, candidates/s | solved, gpu / cpu | certified as well, candidates/s | drawing + update, us per candidate |\
 tables, us | sending, us | sent, KiB | read, KiB | waiting for the device | buffers, MiB | slots | submissions | rounds |"
    );
    println!("|{}", "---|".repeat(15));
    let mut count = arguments.from;
    let mut shaders = Vec::new();
    while count <= arguments.to {
        let free = FreeDistribution::initial(&settings(count)?, task.robot.feet())?;
        let (schedules, draw, update) = population(free, &settings(count)?)?;
        // The first call with a size allocates buffers and compiles shaders.
        solve(&gpu, &task, &schedules, &lower);
        gpu.take_profile();
        let (seconds, solved) = solve(&gpu, &task, &schedules, &lower);
        let p = gpu.take_profile();
        let candidates: Vec<(&Task, &Schedule)> = schedules.iter().map(|s| (&task, s)).collect();
        let (mut cpu_seconds, mut cpu_solved, mut certified) = (f64::NAN, 0, f64::NAN);
        if !arguments.alone {
            (cpu_seconds, cpu_solved) = solve(&cpu, &task, &schedules, &lower);
            let start = Instant::now();
            evaluate(&candidates, &lower, None, &gpu, false, &|| false)?;
            certified = start.elapsed().as_secs_f64();
        }
        let each = |total: f64| total / count as f64;
        println!(
            "| {count} | {:.1} | {:.1} | {solved} / {cpu_solved} | {:.1} | {:.1} | {:.0} | {:.0} | {:.0} | {:.1} | {:.0} % | {} | {} | {} | {} |",
            count as f64 / seconds,
            count as f64 / cpu_seconds,
            count as f64 / certified,
            each(draw + update) * 1e6,
            each(p.tables) * 1e6,
            each(p.sending) * 1e6,
            each(p.sent as f64 / 1024.),
            each(p.received as f64 / 1024.),
            100. * p.device / seconds,
            p.memory >> 20,
            p.slots,
            p.submissions,
            p.rounds
        );
        if timed.open_device().timestamps {
            solve(&timed, &task, &schedules, &lower);
            shaders.push((count, timed.take_profile().shaders));
        }
        count *= 2;
    }
    println!("\nTime on the device by shader, % (s in all):\n");
    let names: Vec<&str> = shaders.first().map(|(_, s)| s.keys().copied().collect()).unwrap_or_default();
    println!("| batch | all, s | {} |", names.join(" | "));
    println!("|{}", "---|".repeat(names.len() + 2));
    for (count, times) in &shaders {
        let all: f64 = times.values().map(|t| t.seconds).sum();
        let shares: Vec<String> = names.iter().map(|n| format!("{:.1}", 100. * times[n].seconds / all)).collect();
        println!("| {count} | {all:.3} | {} |", shares.join(" | "));
    }
    Ok(())
}
