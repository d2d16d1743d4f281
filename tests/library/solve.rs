//! Small whole problems with known answers, every status that a solve can end with, and independence of threads and order.

use crate::common::{
    Random, ReferenceCandidate, free_legs, gait, momentum, problem, problem_with, problem_with_cost, reference_candidates, rows, task,
    towr, transcriptions,
};
use cregopt::backend::{Backend, Cpu, Job, Precision, Solution};
use cregopt::gait::Schedule;
use cregopt::gait::cost::CostWeights;
use cregopt::nlp::Problem;
use cregopt::nlp::transcription::force_limit;
use cregopt::real::Real;
use cregopt::scenario::Scenario;
use cregopt::search::cem::{CemSettings, FreeDistribution, StopReason};
use cregopt::search::evaluate::{Evaluated, LowerSettings, evaluate};
use cregopt::search::{BatchSolver, CemSearchResult, search_with};
use cregopt::settings::{Friction, OptimiseSettings, SmoothSettings, SolverSettings, StallSettings, TranscriptionSettings};
use cregopt::solver::judge::smoothing_fall;
use cregopt::solver::objective::Objective;
use cregopt::solver::{Finish, Outcome, Residuals, Resume, Solver, Status, can_close, close};
use cregopt::task::Task;
use cregopt::terrain::Terrain;
use cregopt::verify::{verify, verify_rows};
use std::alloc::{GlobalAlloc, Layout as Memory, System};
use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// The system's allocator, with a count of the allocations of each thread.
struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

fn count() {
    ALLOCATIONS.set(ALLOCATIONS.get() + 1);
}

// SAFETY: every call goes to the system's allocator; counting in a constant-initialised `Cell` does not allocate.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, memory: Memory) -> *mut u8 {
        count();
        unsafe { System.alloc(memory) }
    }

    unsafe fn dealloc(&self, at: *mut u8, memory: Memory) {
        unsafe { System.dealloc(at, memory) }
    }

    unsafe fn alloc_zeroed(&self, memory: Memory) -> *mut u8 {
        count();
        unsafe { System.alloc_zeroed(memory) }
    }

    unsafe fn realloc(&self, at: *mut u8, memory: Memory, size: usize) -> *mut u8 {
        count();
        unsafe { System.realloc(at, memory, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// ANYmal at rest, with its goal at its start.
fn standing() -> (Task, Schedule) {
    (task("anymal", "flat", [0., 0.], 0.), Schedule::new(vec![vec![1.]; 4]).unwrap())
}

/// A walk that takes some iterations.
fn walking() -> (Task, Schedule) {
    (task("anymal", "flat", [1.5, 0.2], 0.3), gait(&mut Random::new(3), 4, 6..=8))
}

fn solve<T: Real>(
    walk: &(Task, Schedule),
    transcription: &TranscriptionSettings,
    settings: &SolverSettings,
    start: Option<&[f64]>,
    cancel: bool,
) -> Outcome {
    let finish = if size_of::<T>() == 4 { Finish::Infeasibility(settings.tolerance) } else { Finish::Rows(settings.row_tolerance) };
    Solver::<T>::default().solve(&problem_with(&walk.0, &walk.1, transcription), settings, finish, start, &|| cancel)
}

/// Runs a check in f32 and in f64, with both transcriptions and without limits on the legs.
fn solve_all(walk: &(Task, Schedule), settings: &SolverSettings) -> impl Iterator<Item = Outcome> {
    free_legs().into_iter().flat_map(|t| {
        let (narrow, wide) = (solve::<f32>(walk, &t, settings, None, false), solve::<f64>(walk, &t, settings, None, false));
        [narrow, wide]
    })
}

fn evaluate_all(candidates: &[(&Task, &Schedule)], lower: &LowerSettings, threads: usize) -> Vec<Option<Evaluated>> {
    evaluate_on(&Cpu::new(threads).unwrap(), candidates, lower, false)
}

fn evaluate_on(
    backend: &dyn Backend,
    candidates: &[(&Task, &Schedule)],
    lower: &LowerSettings,
    first_feasible: bool,
) -> Vec<Option<Evaluated>> {
    evaluate(candidates, lower, None, backend, first_feasible, &|| false).unwrap()
}

fn lower(transcription: TranscriptionSettings, precision: Precision) -> LowerSettings {
    LowerSettings { transcription, precision, ..LowerSettings::default() }
}

/// A backend that finishes the last candidate first.
struct Backwards(Cpu);

impl Backend for Backwards {
    fn device(&self) -> String {
        "backwards".into()
    }

    fn pool(&self) -> &rayon::ThreadPool {
        self.0.pool()
    }

    fn solve(&self, job: &Job, skip: &(dyn Fn(usize) -> bool + Sync), finish: &(dyn Fn(usize, Solution) + Sync)) {
        for (index, walk) in job.instances.iter().enumerate().rev() {
            let job = Job { instances: std::slice::from_ref(walk), ..*job };
            self.0.solve(&job, &|_| skip(index), &|_, solution| finish(index, solution));
        }
    }
}

#[test]
fn standing_still_is_solved_in_a_few_iterations() {
    let (task, schedule) = standing();
    for transcription in transcriptions() {
        for precision in [Precision::F32, Precision::F64] {
            let results = evaluate_all(&[(&task, &schedule)], &lower(transcription.clone(), precision), 1);
            let result = results[0].as_ref().unwrap();
            assert_eq!((result.outcome.status, result.feasible, result.n_violated), (Status::Solved, true, 0));
            assert!(result.outcome.iterations <= 8, "{} iterations", result.outcome.iterations);
            assert_eq!((result.horizon, result.transcription), (1., transcription.rows));
            // The base starts and ends 0.5 m above the ground, and its four feet never leave it.
            let curves = &result.trajectory(&task, &transcription);
            assert_eq!(curves.ee.iter().map(|foot| foot.motion.poly_durations.len()).sum::<usize>(), 4);
            assert!((curves.base_lin.nodes.last().unwrap()[2] - 0.5).abs() < 1e-12);
        }
    }
}

#[test]
fn a_solvable_walk_ends_as_solved() {
    for outcome in solve_all(&walking(), &SolverSettings::default()) {
        assert_eq!(outcome.status, Status::Solved, "{outcome:?}");
        assert!(outcome.factorisations >= outcome.iterations && outcome.iterations > 1, "{outcome:?}");
    }
}

#[test]
fn an_iteration_limit_of_one_ends_as_max_iterations() {
    for outcome in solve_all(&walking(), &SolverSettings { max_iterations: 1, ..SolverSettings::default() }) {
        assert_eq!((outcome.status, outcome.iterations), (Status::MaxIterations, 1));
        assert!(outcome.infeasibility.is_finite());
    }
}

#[test]
fn six_metres_in_four_tenths_of_a_second_terminate_early() {
    let impossible = (task("anymal", "flat", [6., 0.], 0.), Schedule::new(vec![vec![0.15, 0.1, 0.15]; 4]).unwrap());
    for outcome in solve_all(&impossible, &SolverSettings::default()) {
        assert_eq!(outcome.status, Status::TerminatedEarly, "{outcome:?}");
        // The rule ends the solve well before the limit.
        assert!(outcome.iterations < 40 && outcome.infeasibility > 1., "{outcome:?}");
    }
    for transcription in transcriptions() {
        let results = evaluate_all(&[(&impossible.0, &impossible.1)], &lower(transcription, Precision::F32), 1);
        let result = results[0].as_ref().unwrap();
        assert!(!result.feasible && result.n_violated > 0 && result.outcome.status == Status::TerminatedEarly);
    }
}

#[test]
fn a_start_without_finite_residuals_ends_as_non_finite() {
    let walk = walking();
    for transcription in transcriptions() {
        let problem = problem_with::<f64>(&walk.0, &walk.1, &transcription);
        // Every quantity that the balance depends on: a pose, a force, a foothold.
        let foot = &problem.curves.feet[1];
        let places = [problem.curves.base[4], foot.force_nodes[1][1], foot.footholds[1]];
        assert!(places.iter().all(|&at| (at as usize) < problem.variables));
        for bad in [f64::NAN, f64::INFINITY, 1e30] {
            for at in places.map(|at| at as usize) {
                let mut start = problem.initial.clone();
                start[at] = bad;
                let outcome = solve::<f32>(&walk, &transcription, &SolverSettings::default(), Some(&start), false);
                assert_eq!((outcome.status, outcome.iterations), (Status::NonFinite, 0), "x[{at}] = {bad}");
            }
        }
    }
}

#[test]
fn a_cancelled_solve_ends_as_cancelled() {
    let outcome = solve::<f32>(&walking(), &momentum(), &SolverSettings::default(), None, true);
    assert_eq!((outcome.status, outcome.iterations), (Status::Cancelled, 0));
    // Also in the middle.
    let walk = walking();
    let asked = Cell::new(0);
    let cancel = || {
        asked.set(asked.get() + 1);
        asked.get() > 3
    };
    let outcome =
        Solver::<f32>::default().solve(&problem(&walk.0, &walk.1), &SolverSettings::default(), Finish::Infeasibility(1e-7), None, &cancel);
    assert_eq!((outcome.status, outcome.iterations), (Status::Cancelled, 3));
    // A cancelled batch has no results.
    let results = evaluate(&[(&walk.0, &walk.1)], &LowerSettings::default(), None, &Cpu::new(1).unwrap(), false, &|| true).unwrap();
    assert!(matches!(results[..], [None]));
}

#[test]
fn what_f32_left_near_is_closed_in_f64_and_what_it_left_afar_is_not_touched() {
    let ((task, schedule), settings) = (walking(), SolverSettings::default());
    for transcription in free_legs() {
        let (narrow, wide) = (problem_with::<f32>(&task, &schedule, &transcription), problem_with::<f64>(&task, &schedule, &transcription));
        let mut solver = Solver::<f32>::default();
        let (mut afar, mut near) = (0, 0);
        // Terminates after one iteration, after two, and so on, until the solve succeeds.
        for max_iterations in 1.. {
            let limited = SolverSettings { max_iterations, ..settings.clone() };
            let outcome = solver.solve(&narrow, &limited, Finish::Infeasibility(settings.tolerance), None, &|| false);
            let x = solver.solution();
            let (closed, at) = close(&wide, outcome, x.clone(), &settings, &|| false);
            if !can_close(&outcome) {
                assert_eq!((closed, at), (outcome, x));
                afar += 1;
                continue;
            }
            assert_eq!(closed.status, Status::Solved, "after {max_iterations} iterations in f32");
            assert_eq!(close(&wide, outcome, x, &settings, &|| true).0.status, Status::Cancelled);
            if outcome.status == Status::Solved {
                assert!(closed.iterations - outcome.iterations <= settings.closing_steps);
                break;
            }
            near += 1;
        }
        assert!(afar > 0 && near > 0, "{afar} afar, {near} near");
    }
}

#[test]
fn closing_on_the_wrong_rows_restarts_from_the_same_point() {
    let ((task, schedule), settings) = (walking(), SolverSettings::default());
    let transcription = TranscriptionSettings::default();
    let problem = problem_with::<f64>(&task, &schedule, &transcription);
    let mut solver = Solver::<f64>::default();
    let outcome = solver.solve(&problem, &settings, Finish::Rows(settings.row_tolerance), None, &|| false);
    assert_eq!(outcome.status, Status::Solved);
    let (solution, mut restarted) = (solver.solution(), 0);
    for seed in 0..8 {
        let mut random = Random::new(seed);
        let mut x = solution.clone();
        x[..problem.variables].iter_mut().for_each(|v| *v += random.between(-0.1, 0.1));
        let closed = close(&problem, outcome, x, &settings, &|| false).0;
        let steps = closed.iterations - outcome.iterations;
        assert_eq!(closed.status, Status::Solved, "seed {seed}");
        assert!(steps < settings.closing_steps + 20, "seed {seed}: {steps} steps, as many as a solve from the start");
        restarted += usize::from(steps > settings.closing_steps);
    }
    assert!(restarted > 0, "all closed at once");
}

#[test]
fn a_candidate_with_other_feet_is_refused() {
    let (task, _) = standing();
    let schedule = Schedule::new(vec![vec![1.]; 2]).unwrap();
    let error = evaluate(&[(&task, &schedule)], &LowerSettings::default(), None, &Cpu::new(1).unwrap(), false, &|| false);
    assert!(error.unwrap_err().to_string().contains("2 feet"));
}

/// Twelve gaits over a distance that some of them cover; their sizes vary.
fn population() -> (Task, Vec<Schedule>) {
    let mut random = Random::new(21);
    let schedules = (0..12).map(|i| gait(&mut random, 4, if i % 3 == 0 { 8..=11 } else { 4..=7 })).collect();
    (task("anymal", "step", [4.5, 0.4], 1.), schedules)
}

/// All fields except times.
fn same(a: &Evaluated, b: &Evaluated) -> bool {
    let numbers = |e: &Evaluated| [e.max_violation, e.mean_normal_force, e.horizon].map(f64::to_bits);
    let counts =
        |e: &Evaluated| (e.outcome.status, e.feasible, e.outcome.iterations, e.outcome.factorisations, e.n_violated, e.n_variables);
    a.schedule == b.schedule && a.x == b.x && numbers(a) == numbers(b) && counts(a) == counts(b)
}

#[test]
fn results_do_not_depend_on_threads_or_order() {
    let (task, schedules) = population();
    let candidates: Vec<(&Task, &Schedule)> = schedules.iter().map(|s| (&task, s)).collect();
    let lower = lower(momentum(), Precision::F32);
    let one = evaluate_all(&candidates, &lower, 1);
    let two = evaluate_all(&candidates, &lower, 2);
    // 5 and 12 are coprime.
    let order: Vec<usize> = (0..12).map(|i| (5 * i + 3) % 12).collect();
    let permuted: Vec<(&Task, &Schedule)> = order.iter().map(|&i| candidates[i]).collect();
    let permuted = evaluate_all(&permuted, &lower, 2);
    for i in 0..12 {
        let at = order.iter().position(|&j| j == i).unwrap();
        let [a, b, c] = [&one[i], &two[i], &permuted[at]].map(|r| r.as_ref().unwrap());
        assert!(same(a, b) && same(a, c), "candidate {i}");
    }
    assert!(!same(one[0].as_ref().unwrap(), one[1].as_ref().unwrap()), "two candidates that differ");
}

#[test]
fn first_feasible_keeps_everything_up_to_the_lowest_feasible_index() {
    let (_, mut schedules) = population();
    // On level ground with high friction several candidates are feasible.
    let mut task = task("anymal", "flat", [4.5, 0.4], 1.);
    task.terrain = Arc::new(Terrain { friction: 5., ..Terrain::flat() });
    let candidates: Vec<(&Task, &Schedule)> = schedules.iter().map(|s| (&task, s)).collect();
    let lower = lower(momentum(), Precision::F32);
    let all = evaluate_all(&candidates, &lower, 2);
    let feasible: Vec<bool> = all.iter().map(|r| r.as_ref().unwrap().feasible).collect();
    assert!(feasible.contains(&true) && feasible.contains(&false), "{feasible:?}");
    // Infeasible candidates come first, so that several threads pass the answer before it is known.
    let (mut order, good): (Vec<usize>, Vec<usize>) = (0..12).partition(|&i| !feasible[i]);
    order.extend(good);
    let lowest = order.iter().position(|&i| feasible[i]).unwrap();
    assert!(lowest > 0 && lowest < 11, "{feasible:?}");
    schedules = order.iter().map(|&i| schedules[i].clone()).collect();
    let candidates: Vec<(&Task, &Schedule)> = schedules.iter().map(|s| (&task, s)).collect();
    let threads = |threads| Cpu::new(threads).unwrap();
    let backends: [&dyn Backend; 4] = [&threads(1), &threads(2), &threads(3), &Backwards(threads(1))];
    for backend in backends {
        let results = evaluate_on(backend, &candidates, &lower, true);
        for (at, result) in results.iter().enumerate() {
            assert_eq!(result.is_some(), at <= lowest, "{}, candidate {at}", backend.device());
            if let Some(result) = result {
                assert!(same(result, all[order[at]].as_ref().unwrap()), "{}, candidate {at}", backend.device());
            }
        }
    }
}

#[test]
fn reference_candidates_are_solved_in_both_precisions() {
    let candidates = reference_candidates();
    let candidates: Vec<ReferenceCandidate> = candidates.into_iter().filter(|c| c.target == 10).collect();
    assert_eq!(candidates.len(), 80);
    let problems: Vec<(&Task, &Schedule)> = candidates.iter().map(|c| (&c.task, &c.schedule)).collect();
    let [narrow, wide] = [Precision::F32, Precision::F64].map(|precision| evaluate_all(&problems, &lower(towr(), precision), 2));
    let mut solved = std::collections::BTreeMap::new();
    let mut failures = Vec::new();
    for ((candidate, narrow), wide) in candidates.iter().zip(&narrow).zip(&wide) {
        let (narrow, wide) = (narrow.as_ref().unwrap(), wide.as_ref().unwrap());
        let name = format!("{} {}", candidate.scenario, candidate.index);
        if narrow.feasible != wide.feasible {
            failures.push(format!("{name}: feasible in f32 {}, in f64 {}", narrow.feasible, wide.feasible));
        }
        if candidate.solved_by_ipopt && !narrow.feasible {
            failures.push(format!("{name}: solved by Ipopt alone"));
        }
        // Counts again, from the trajectory that the user gets.
        let task = &candidate.task;
        let rows = verify_rows(&narrow.trajectory(task, &towr()), &task.robot, &task.terrain, force_limit(&towr(), task)).unwrap();
        if (narrow.feasible, narrow.n_violated) != (rows.n_violated == 0, rows.n_violated) {
            failures.push(format!("{name}: feasible {}, {} violated, {} counted", narrow.feasible, narrow.n_violated, rows.n_violated));
        }
        *solved.entry(candidate.scenario.as_str()).or_insert(0) += usize::from(narrow.feasible);
    }
    println!("solved of 16: {solved:?}");
    for (scenario, at_least) in [("s1", 12), ("s2", 11), ("s3", 11), ("biped", 16), ("hex", 3)] {
        if solved[scenario] < at_least {
            failures.push(format!("{scenario}: {} solved, {at_least} once were", solved[scenario]));
        }
    }
    assert!(failures.is_empty(), "{failures:#?}");
}

#[test]
fn momentum_gaits_of_the_biped_hold_between_the_instants() {
    let candidates = reference_candidates();
    let chosen: Vec<&ReferenceCandidate> = candidates.iter().filter(|c| c.scenario == "biped" && c.target == 10).collect();
    // The robot's own force limit, not TOWR's.
    let mut tasks: Vec<Task> = chosen.iter().map(|_| Scenario::named("biped").unwrap().task(10).unwrap()).collect();
    // Higher friction: at 1 two of the gaits are not found inside the cone, which lies inside TOWR's pyramid.
    for task in &mut tasks {
        task.terrain = Arc::new(Terrain { friction: 2., ..Terrain::flat() });
    }
    let pairs: Vec<(&Task, &Schedule)> = tasks.iter().zip(&chosen).map(|(task, c)| (task, &c.schedule)).collect();
    for precision in [Precision::F32, Precision::F64] {
        for (index, evaluated) in evaluate_all(&pairs, &lower(momentum(), precision), 2).into_iter().flatten().enumerate() {
            let trajectory = &evaluated.trajectory(&tasks[0], &momentum());
            assert!(evaluated.feasible, "candidate {index}, {precision:?}: {} rows violated", evaluated.n_violated);
            let report = verify(trajectory, &tasks[0].robot, &tasks[0].terrain, force_limit(&momentum(), &tasks[0])).unwrap();
            let rollout = report.rollout.unwrap();
            assert!(rollout.position.value < 0.01 && rollout.attitude.value < 1. && report.dense.reach_excess.value < 5e-3, "{report}");
            assert!(report.dense.final_base_speed < 1e-4);
            assert_eq!((report.dense.pull.value, report.dense.friction_excess.value), (0., 0.));
        }
    }
}

#[test]
fn smoothing_lowers_the_cost_of_a_motion_that_stays_solved() {
    let (task, schedule) = walking();
    let problem = problem_with::<f64>(&task, &schedule, &TranscriptionSettings { friction: Some(Friction::Pyramid), ..momentum() });
    let cost = |smooth: SmoothSettings| {
        let settings = SolverSettings { smooth, ..SolverSettings::default() };
        let mut solver = Solver::<f64>::default();
        let outcome = solver.solve(&problem, &settings, Finish::Rows(settings.row_tolerance), None, &|| false);
        assert_eq!(outcome.status, Status::Solved);
        // Deviations from the initial values are not costed.
        smoothing_fall(&problem.smoothing, &solver.solution(), &problem.initial, &problem.initial)
    };
    let plain = cost(SmoothSettings::default());
    let smooth = |iterations| cost(SmoothSettings { iterations, ..SmoothSettings::default() });
    let (some, many) = (smooth(10), smooth(40));
    assert!(some < 0.99 * plain, "{some} after, {plain} before");
    assert!(many < 1.01 * some, "{many} after more of it, {some} before");
}

#[test]
fn optimisation_lowers_the_cost_of_a_motion_that_stays_certified() {
    let (task, schedule) = walking();
    let weights = CostWeights::default();
    let solved = |optimise: OptimiseSettings, precision| {
        let solver = SolverSettings { optimise, ..SolverSettings::default() };
        let settings = LowerSettings { solver, precision, ..LowerSettings::default() };
        let results = evaluate(&[(&task, &schedule)], &settings, Some(&weights), &Cpu::new(1).unwrap(), false, &|| false).unwrap();
        let result = results.into_iter().next().unwrap().unwrap();
        assert!(result.feasible && result.certified);
        result.cost.unwrap()
    };
    for precision in [Precision::F32, Precision::F64] {
        let plain = solved(OptimiseSettings::default(), precision);
        let optimised = |iterations| solved(OptimiseSettings { iterations, ..OptimiseSettings::default() }, precision);
        let (some, many) = (optimised(8), optimised(40));
        assert!(some.total < 0.97 * plain.total, "{} after, {} before", some.total, plain.total);
        assert!(many.total < 1.002 * some.total, "{} after more iterations, {} before", many.total, some.total);
    }
}

#[test]
fn cost_rows_add_up_to_the_cost_of_the_motion() {
    let (task, schedule) = walking();
    let settings = LowerSettings::default();
    let weights = CostWeights::default();
    let results = evaluate(&[(&task, &schedule)], &settings, Some(&weights), &Cpu::new(1).unwrap(), false, &|| false).unwrap();
    let result = results.into_iter().next().unwrap().unwrap();
    let cost = result.cost.unwrap();
    let problem = Problem::<f64>::with_cost(&task, &result.schedule, &settings.transcription, Some(&weights));
    let c = rows(&problem, &result.x, 0.).c;
    let objective = Objective { weight: 1., rounding: 1e-9 };
    let got = objective.cost(&problem, &c);
    // Two quadratures of absolute values.
    assert!((got - cost.total).abs() < 0.01 * cost.total, "{got} by rows, {} by the motion", cost.total);
}

#[test]
fn a_minimisation_resumed_near_its_result_returns_to_it_in_a_few_iterations() {
    let task = task("biped", "flat", [0.5, 0.1], 0.2);
    let problem = problem_with_cost::<f64>(&task, &gait(&mut Random::new(3), 2, 4..=6), &TranscriptionSettings::default());
    let optimise = OptimiseSettings { iterations: 100, tolerance: 1e-6, ..OptimiseSettings::default() };
    let settings = SolverSettings { optimise, ..SolverSettings::default() };
    let finish = Finish::Rows(settings.row_tolerance);
    let objective = Objective { weight: 1., rounding: settings.optimise.rounding_floor };
    let cost = |x: &[f64]| objective.cost(&problem, &rows(&problem, x, 0.).c);
    let mut solver = Solver::<f64>::default();
    let plain = SolverSettings::default();
    assert_eq!(solver.solve(&problem, &plain, finish, None, &|| false).status, Status::Solved);
    let given = cost(&solver.solution());
    let first = solver.solve(&problem, &settings, finish, None, &|| false);
    assert_eq!(first.status, Status::Solved);
    let (x, multipliers) = (solver.solution(), solver.multipliers());
    let least = cost(&x);
    assert!(least < 0.9 * given, "{least} after, {given} before");
    let zero = Residuals { c: vec![0.; multipliers.c.len()], g: vec![0.; multipliers.g.len()] };
    // Outcome, and the excess of its cost, of a solve that is resumed from a point beside the result.
    let mut resumed = |by: f64, multipliers: &Residuals<f64>, iterations: usize, cancel: bool| {
        let mut random = Random::new(7);
        let x: Vec<f64> = x.iter().map(|x| x + by * random.between(-1., 1.)).collect();
        let resume = Resume { x: &x, multipliers, barrier: 1e-5, iterations };
        let outcome = solver.resume(&problem, &settings, finish, &resume, &|| cancel);
        (outcome, (cost(&solver.solution()) - least) / least)
    };
    let (outcome, excess) = resumed(0., &multipliers, 4, false);
    assert!(outcome.status == Status::Solved && outcome.iterations <= 6, "{outcome:?}");
    assert!(excess.abs() < 1e-4, "{excess}");
    // A barrier of 1e-5 and no multipliers push the motion away from its active rows.
    let [with, without] = [&multipliers, &zero].map(|multipliers| resumed(0., multipliers, 2, false).1);
    assert!(without > 5. * with, "{without} without multipliers, {with} with them");
    for (by, close) in [(1e-3, 1e-4), (1e-2, 1e-3)] {
        let [restored, minimised] = [0, 20].map(|iterations| resumed(by, &multipliers, iterations, false));
        assert_eq!([restored.0.status, minimised.0.status], [Status::Solved; 2]);
        assert!(minimised.1.abs() < close && restored.1 > 10. * close, "{by}: {} after, {} before", minimised.1, restored.1);
    }
    assert_eq!(resumed(0., &multipliers, 4, true).0.status, Status::Cancelled);
}

#[test]
fn a_warm_solver_does_not_allocate() {
    fn check<T: Real>(transcription: &TranscriptionSettings) {
        let (task, _) = walking();
        let problem = problem_with::<T>(&task, &walking().1, transcription);
        let settings = |max_iterations| SolverSettings {
            max_iterations,
            // Only the iteration limit ends the solve.
            closing: 0.,
            stall: StallSettings { enabled: false, ..StallSettings::default() },
            ..SolverSettings::default()
        };
        let mut solver = Solver::<T>::default();
        let mut solve = |iterations| {
            let before = ALLOCATIONS.get();
            let outcome = solver.solve(&problem, &settings(iterations), Finish::Infeasibility(0.), None, &|| false);
            (outcome.iterations, ALLOCATIONS.get() - before)
        };
        let (iterations, cold) = solve(40);
        assert!(iterations > 10 && cold > 10, "{iterations} iterations, {cold} allocations");
        assert_eq!(solve(5), (5, 0));
        assert_eq!(solve(40), (iterations, 0));
    }
    for transcription in transcriptions() {
        check::<f32>(&transcription);
        check::<f64>(&transcription);
    }
}

/// The paper's search loop with its settings and seed 1.
fn papers_search(task: &Task, threads: usize, cancelled: &AtomicBool, generation: &mut dyn FnMut()) -> CemSearchResult {
    let (upper, lower, backend) = (CemSettings::default(), lower(momentum(), Precision::F32), Cpu::new(threads).unwrap());
    let level = BatchSolver { task, settings: &lower, backend: &backend, cost: None, incumbent: None };
    let distribution = FreeDistribution::initial(&upper, task.robot.feet()).unwrap();
    search_with(&level, distribution, &upper, 1, cancelled, &mut |_| generation()).unwrap()
}

#[test]
fn the_papers_search_finds_a_gait_and_the_same_one_on_two_threads() {
    let task = Scenario::named("s1").unwrap().task(10).unwrap();
    let run = |threads| {
        let mut generations = 0;
        let found = papers_search(&task, threads, &AtomicBool::new(false), &mut || generations += 1);
        assert_eq!((found.stop, found.generations.len()), (StopReason::FirstFeasible, generations));
        found.best.unwrap()
    };
    let (one, two) = (run(1), run(2));
    assert!(one.evaluation.feasible && one.evaluation.n_violated == 0);
    let rows =
        verify_rows(&one.solution.trajectory(&task, &momentum()), &task.robot, &task.terrain, force_limit(&momentum(), &task)).unwrap();
    assert!(rows.feasible, "{rows}");
    assert_eq!((one.generation, one.index, &one.schedule), (two.generation, two.index, &two.schedule));
    assert!(same(&one.solution, &two.solution));
}

#[test]
fn a_cancelled_search_reports_it() {
    let task = Scenario::named("s1").unwrap().task(10).unwrap();
    let found = papers_search(&task, 1, &AtomicBool::new(true), &mut || ());
    assert_eq!(found.stop, StopReason::Cancelled);
    assert!(found.best.is_none() && found.first_feasible_after.is_none());
}
