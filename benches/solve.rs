//! Criterion benchmarks of the 16 reference candidates of target 10 of each scenario, on one thread, in `momentum` with free legs.
//!
//! * `solve/<scenario>/<precision>` - problem, solve and certification of all 16, solved or not
//! * `problem/<scenario>` - only the tables of all 16
//! * `factorise/<scenario>` - one factorisation of each with all rows active, in f32

use cregopt::backend::{Cpu, Precision};
use cregopt::gait::{AlignedSchedule, Schedule};
use cregopt::linear::NormalEquations;
use cregopt::linear::front::{Factor, factorise};
use cregopt::nlp::Problem;
use cregopt::nlp::transcription::interval;
use cregopt::rows;
use cregopt::scenario::{SCENARIOS, Scenario};
use cregopt::search::evaluate::{LowerSettings, evaluate};
use cregopt::settings::{Transcription, TranscriptionSettings};
use cregopt::solver::start::column_scaling;
use cregopt::task::Task;
use criterion::{BenchmarkId, Criterion, SamplingMode, Throughput};
use std::hint::black_box;
use std::time::Duration;

const TARGET: usize = 10;

fn transcription() -> TranscriptionSettings {
    TranscriptionSettings::paper(Transcription::Momentum)
}

/// Line of the reference data.
#[derive(serde::Deserialize)]
struct Line {
    scenario: String,
    target: usize,
    durations: Vec<Vec<f64>>,
}

/// Reference schedules of a scenario.
fn schedules(reference: &str, scenario: &str) -> Vec<Schedule> {
    let lines = reference.lines().map(|line| serde_json::from_str(line).expect("a line of the reference data"));
    let chosen = lines.filter(|line: &Line| line.scenario == scenario && line.target == TARGET);
    chosen.map(|line| Schedule::new(line.durations).expect("a schedule of the reference data")).collect()
}

fn solve(c: &mut Criterion, scenario: &Scenario, task: &Task, schedules: &[Schedule]) {
    let backend = Cpu::new(1).expect("one thread");
    let candidates: Vec<(&Task, &Schedule)> = schedules.iter().map(|s| (task, s)).collect();
    let mut group = c.benchmark_group("solve");
    group.sample_size(10).sampling_mode(SamplingMode::Flat);
    group.warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(4));
    group.throughput(Throughput::Elements(candidates.len() as u64));
    for (name, precision) in [("f32", Precision::F32), ("f64", Precision::F64)] {
        let settings = LowerSettings { precision, transcription: transcription(), ..LowerSettings::default() };
        let run = || evaluate(&candidates, &settings, None, &backend, false, &|| false).expect("valid candidates");
        let results = run();
        // Feasible candidates are counted, because a solver that fails quickly is not fast.
        let feasible = results.iter().flatten().filter(|r| r.feasible).count();
        let iterations: usize = results.iter().flatten().map(|r| r.outcome.iterations).sum();
        println!("solve/{}/{name}: {feasible} of {} feasible, {iterations} iterations", scenario.name, candidates.len());
        group.bench_function(BenchmarkId::new(scenario.name, name), |b| b.iter(|| black_box(run())));
    }
}

fn problem(c: &mut Criterion, scenario: &Scenario, task: &Task, schedules: &[Schedule]) {
    let settings = transcription();
    let aligned: Vec<AlignedSchedule> = schedules.iter().map(|s| s.aligned(interval(&settings, &task.robot))).collect();
    let mut group = c.benchmark_group("layout");
    group.warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(2)).sample_size(20);
    group.throughput(Throughput::Elements(aligned.len() as u64));
    group.bench_function(scenario.name, |b| {
        b.iter(|| {
            for schedule in &aligned {
                black_box(Problem::<f32>::new(task, schedule, &settings));
            }
        });
    });
}

/// Candidate at its initial values, ready for a factorisation.
struct Linearised {
    problem: Problem<f32>,
    jacobian: Vec<f32>,
    weight: Vec<f32>,
    value: Vec<f32>,
    diagonal: Vec<f32>,
    gradient: Vec<f32>,
}

impl Linearised {
    fn new(task: &Task, schedule: &Schedule) -> Linearised {
        let settings = transcription();
        let problem = Problem::<f32>::new(task, &schedule.aligned(interval(&settings, &task.robot)), &settings);
        let mut shared = rows::Shared::default();
        shared.resize(&problem);
        let (mut c, mut g) = (vec![0.; problem.rows.one_sided()], vec![0.; problem.inequalities]);
        let mut jacobian = vec![0.; problem.jacobian_len];
        rows::residuals(&problem, &problem.initial, 0., &mut shared, &mut c, &mut g, Some(&mut jacobian));
        let mut diagonal = vec![0.; problem.variables];
        let (mut counts, mut local) = (vec![0.; problem.rows.all()], vec![0.; problem.widest]);
        column_scaling(&problem, &jacobian, &mut counts, &mut local, &mut diagonal);
        diagonal.iter_mut().for_each(|d| *d *= 1e-3);
        let (weight, value, gradient) = (vec![1.; problem.rows.all()], vec![0.1; problem.rows.all()], vec![0.; problem.variables]);
        Linearised { problem, jacobian, weight, value, diagonal, gradient }
    }
}

fn factorisation(c: &mut Criterion, scenario: &Scenario, task: &Task, schedules: &[Schedule]) {
    let candidates: Vec<Linearised> = schedules.iter().map(|s| Linearised::new(task, s)).collect();
    let mut factor = Factor::default();
    let mut group = c.benchmark_group("factorise");
    group.warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(2)).sample_size(20);
    group.throughput(Throughput::Elements(candidates.len() as u64));
    group.bench_function(scenario.name, |b| {
        b.iter(|| {
            for candidate in &candidates {
                let Linearised { problem, jacobian, weight, value, diagonal, gradient } = candidate;
                factor.resize(problem);
                let system = NormalEquations { jacobian, weight, value, diagonal, gradient };
                assert!(factorise(problem, &system, &mut factor), "a positive pivot");
            }
        });
    });
}

fn main() {
    let reference = include_str!("../tests/data/ipopt_candidates.jsonl");
    let mut c = Criterion::default().configure_from_args();
    for scenario in &SCENARIOS {
        let task = scenario.task(TARGET).expect("a target of the scenario");
        let schedules = schedules(reference, scenario.name);
        solve(&mut c, scenario, &task, &schedules);
        problem(&mut c, scenario, &task, &schedules);
        factorisation(&mut c, scenario, &task, &schedules);
    }
    c.final_summary();
}
