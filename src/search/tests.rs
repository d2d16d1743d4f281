//! Tests of the search: dropped solutions, on-demand certification and skipped candidates.

use super::cem::{
    CemSettings, Evaluation, FreeDistribution, GenerationEvaluator, GenerationResults, Objective, SelectionGoal, Stopping, run,
};
use super::*;
use crate::backend::Cpu;
use crate::gait::cost::{Cost, CostWeights};
use crate::gait::family::PeriodicGait;
use crate::{Goal, Robot, Terrain};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

fn walk() -> Task {
    Task::new(Robot::named("biped").unwrap(), Terrain::flat(), Goal::at(0.8, 0.1)).unwrap()
}

/// Parts of a result that do not depend on time.
fn parts(found: &SearchResult) -> impl PartialEq + std::fmt::Debug {
    let gait = |gait: &Gait| {
        let Candidate { family, generation, index, stances, schedule, objective, evaluation, solution } = gait.candidate.clone();
        let solved = (solution.outcome, solution.cost, solution.schedule, solution.x);
        (family, (generation, index, stances, schedule, objective, evaluation), solved, gait.trajectory.clone())
    };
    let gaits: Vec<_> = std::iter::once(&found.best).chain(&found.alternatives).map(gait).collect();
    let improvements: Vec<_> = found.improvements.iter().map(|i| (i.family, i.generation, i.candidates, i.objective)).collect();
    (gaits, improvements, found.generations.clone(), found.stop)
}

/// Asserts that the result of a search does not depend on the number of solutions that it keeps.
fn assert_result_independent_of_kept_solutions<'a>(search: impl Fn() -> Search<'a>, backend: &dyn Backend) -> SearchResult {
    let keeping = |max_solutions: usize| Search { max_solutions, ..search() }.run(backend).unwrap();
    let all = keeping(MAX_SOLUTIONS);
    for max_solutions in [0, 3] {
        let some = keeping(max_solutions);
        assert!(parts(&some) == parts(&all), "{:#?}\n{:#?}", parts(&some), parts(&all));
    }
    all
}

#[test]
fn the_result_of_a_search_does_not_depend_on_the_number_of_kept_solutions() {
    let task = walk();
    let cpu = Cpu::new(2).unwrap();
    let settings = SearchSettings { alternatives: 4, ..SearchSettings::default() };
    let search = || Search::new(&task).settings(settings.clone()).seed(3).population(40).generations(2);
    let found = assert_result_independent_of_kept_solutions(search, &cpu);
    assert!(found.best.feasible() && found.improvements.len() > 1 && !found.alternatives.is_empty());
    // With an objective that is better for most infeasible motions than for feasible ones.
    let found = assert_result_independent_of_kept_solutions(
        || search().settings(settings.clone().seeking(Objective::LeastForce)).generations(1),
        &cpu,
    );
    assert!(found.best.feasible());
    // Without a gait the candidate with the fewest violations is returned.
    let mut lower = LowerSettings::default();
    lower.solver.max_iterations = 2;
    let without_further = SearchSettings { further_generations: 0, ..settings.clone() };
    let found = assert_result_independent_of_kept_solutions(
        || search().settings(without_further.clone()).generations(1).lower(lower.clone()),
        &cpu,
    );
    assert!(!found.best.feasible());
}

#[cfg(feature = "gpu")]
#[test]
fn on_a_gpu_the_result_does_not_depend_on_the_number_of_kept_solutions() {
    let name = std::env::var("CREGOPT_TEST_ADAPTER").ok();
    let gpu = match crate::backend::Gpu::open(name.as_deref(), 2) {
        Ok(gpu) => gpu,
        Err(error) if std::env::var("GPU_TESTS").is_ok_and(|v| v == "require") => panic!("{error}"),
        Err(error) => return eprintln!("skipped: on_a_gpu_the_result_does_not_depend_on_the_number_of_kept_solutions: {error}"),
    };
    let task = walk();
    let settings = SearchSettings { perturbed_generations: 0, ..SearchSettings::default() };
    let found = assert_result_independent_of_kept_solutions(|| Search::new(&task).settings(settings.clone()).seed(3).generations(1), &gpu);
    assert!(found.best.feasible() && gpu.fallback().is_none());
}

#[test]
fn the_result_of_the_papers_loop_does_not_depend_on_the_number_of_kept_solutions() {
    let (task, lower, cpu) = (walk(), LowerSettings::default(), Cpu::new(2).unwrap());
    let solver = BatchSolver { task: &task, settings: &lower, backend: &cpu, cost: None, incumbent: None };
    let loops = [(Objective::Feasibility, Stopping::FirstFeasible, false), (Objective::LeastForce, Stopping::Convergence, true)];
    for (objective, stopping, whole_generation) in loops {
        let settings = CemSettings { objective, stopping, whole_generation, generations: 3, ..CemSettings::default() };
        let keeping = |max_solutions: usize, improvements: bool| {
            let evaluator = TimedEvaluator::new(&solver, Clock::new(None, None)).max_solutions(max_solutions);
            let mut evaluator = if improvements { evaluator.certifying_improvements() } else { evaluator };
            let distribution = FreeDistribution::initial(&settings, task.robot.feet()).unwrap();
            let outcome = run(&settings, distribution, 1, 0, &mut evaluator, &mut |_| ()).unwrap();
            let best = outcome.best.unwrap();
            (best.generation, best.index, best.objective, best.evaluation, best.solution.x, outcome.generations, outcome.stop)
        };
        for improvements in [false, true] {
            assert_eq!(keeping(0, improvements), keeping(MAX_SOLUTIONS, improvements));
        }
    }
}

#[test]
fn a_candidate_that_costs_much_more_than_the_best_gait_is_not_minimised_to_the_end() {
    let (task, cpu, weights) = (walk(), Cpu::new(1).unwrap(), CostWeights::default());
    let mut lower = LowerSettings::default();
    SearchSettings::default().minimise(&task.robot, &mut lower);
    let schedule = PeriodicGait::typical(GaitFamily::Walk, &task).unwrap().schedule().unwrap();
    let solved = |best: Option<f64>| {
        let incumbent = Incumbent::default();
        if let Some(cost) = best {
            incumbent.set(cost);
        }
        let solver = BatchSolver { task: &task, settings: &lower, backend: &cpu, cost: Some(&weights), incumbent: Some(&incumbent) };
        let (evaluation, solution) = solver.certify_again(&schedule).unwrap();
        assert!(evaluation.certified && evaluation.feasible);
        (evaluation.cost.unwrap().total, solution.outcome.iterations)
    };
    let (cost, iterations) = solved(None);
    assert_eq!(solved(Some(cost)), (cost, iterations));
    let (given_up, fewer) = solved(Some(cost / 3.));
    assert!(given_up > cost && fewer < iterations, "{given_up} after {fewer} iterations, {cost} after {iterations}");
}

/// Solver that reports every schedule as solved, but certifies only schedules that last long enough. Shorter schedules need less
/// force.
struct Optimist {
    certified: AtomicUsize,
}

impl Optimist {
    fn holds(schedule: &Schedule) -> bool {
        schedule.horizon() > 1.8
    }
}

impl ScheduleSolver for Optimist {
    type Solution = bool;

    fn solve(
        &self,
        schedules: &[Schedule],
        certify: Certify,
        _: &(dyn Fn(usize) -> bool + Sync),
        finish: &(dyn Fn(usize, Evaluation, bool) + Sync),
    ) -> Result<()> {
        let certified = certify == Certify::All;
        for (index, schedule) in schedules.iter().enumerate() {
            self.certified.fetch_add(usize::from(certified), Ordering::Relaxed);
            let feasible = !certified || Optimist::holds(schedule);
            let mean_normal_force = 10. * schedule.horizon();
            let evaluation = Evaluation { n_violated: usize::from(!feasible), feasible, certified, mean_normal_force, cost: None };
            finish(index, evaluation, certified);
        }
        Ok(())
    }
}

#[test]
fn the_papers_loop_certifies_the_gait_that_it_returns_and_few_others() {
    let solver = Optimist { certified: AtomicUsize::new(0) };
    let settings = CemSettings {
        objective: Objective::LeastForce,
        stopping: Stopping::Convergence,
        population: 64,
        elites: 48,
        generations: 12,
        ..CemSettings::default()
    };
    let distribution = FreeDistribution::initial(&settings, 2).unwrap();
    let found = search_with(&solver, distribution, &settings, 1, &AtomicBool::new(false), &mut |_| ()).unwrap();
    let best = found.best.unwrap();
    assert!(best.solution && best.evaluation.certified && best.evaluation.feasible && Optimist::holds(&best.schedule));
    let objectives: Vec<f64> = found.generations.iter().filter_map(|g| g.best_ever_objective).collect();
    assert_eq!((objectives.len(), objectives.last()), (12, Some(&best.objective)));
    assert!(objectives.is_sorted() && objectives[0] < best.objective, "{objectives:?}");
    // The first generation and some later candidates: most later ones rank before the best certified one and have to be certified.
    let certified = solver.certified.into_inner();
    println!("{certified} certified of {}", 12 * 64);
    assert!((64 + 1..12 * 64).contains(&certified), "{certified}");
}

/// Solver that solves some schedules, in the given or the reverse order. Not all solved schedules pass their certificate.
struct Half {
    backwards: bool,
    solved: AtomicUsize,
}

impl ScheduleSolver for Half {
    type Solution = ();

    fn solve(
        &self,
        schedules: &[Schedule],
        certify: Certify,
        skip: &(dyn Fn(usize) -> bool + Sync),
        finish: &(dyn Fn(usize, Evaluation, ()) + Sync),
    ) -> Result<()> {
        for at in 0..schedules.len() {
            let index = if self.backwards { schedules.len() - 1 - at } else { at };
            if skip(index) {
                continue;
            }
            self.solved.fetch_add(1, Ordering::Relaxed);
            let schedule = &schedules[index];
            // Pseudo-random digit of the schedule, identical in every call.
            let digit = (schedule.durations()[0][0] * 1e6) as usize % 10;
            let certified = certify == Certify::All || digit < 4;
            let feasible = digit >= if certified { 6 } else { 4 };
            let n_violated = usize::from(!feasible) * (1 + digit);
            let cost = feasible.then(|| Cost { horizon: schedule.aligned(0.1).horizon(), ..Cost::default() });
            let evaluation = Evaluation { n_violated, feasible, certified, mean_normal_force: 0., cost };
            finish(index, evaluation, ());
        }
        Ok(())
    }
}

/// Evaluator that evaluates every candidate of a generation.
struct Whole<E>(E);

impl<E: GenerationEvaluator> GenerationEvaluator for Whole<E> {
    type Solution = E::Solution;

    fn evaluate(&mut self, generation: usize, schedules: &[Schedule], goal: &SelectionGoal) -> GenerationResults<E::Solution> {
        let mut goal = *goal;
        goal.enough = usize::MAX;
        self.0.evaluate(generation, schedules, &goal)
    }
}

#[test]
fn candidates_that_can_only_rank_after_the_elites_are_not_solved() {
    for (objective, share) in [(Objective::FewestStances, 0.7), (Objective::Time, 0.7), (Objective::Feasibility, 0.6)] {
        let settings = CemSettings {
            objective,
            stopping: Stopping::Convergence,
            population: 128,
            elites: 16,
            generations: 12,
            ..CemSettings::default()
        };
        for seed in 1..6 {
            let found = |whole: bool, backwards: bool| {
                let solver = Half { backwards, solved: AtomicUsize::new(0) };
                let mut evaluator = TimedEvaluator::new(&solver, Clock::new(None, None)).certifying_improvements();
                let distribution = FreeDistribution::initial(&settings, 2).unwrap();
                let outcome = match whole {
                    true => run(&settings, distribution, seed, 0, &mut Whole(evaluator), &mut |_| ()).unwrap(),
                    false => run(&settings, distribution, seed, 0, &mut evaluator, &mut |_| ()).unwrap(),
                };
                let best: Vec<_> = outcome.generations.iter().map(|g| g.best_ever_objective).collect();
                let evaluated: Vec<_> = outcome.generations.iter().map(|g| (g.evaluated, g.feasible)).collect();
                ((outcome.best.unwrap(), outcome.distribution, best), evaluated, solver.solved.into_inner())
            };
            let (all, needed, backwards) = (found(true, false), found(false, false), found(false, true));
            assert!(all.0 == needed.0 && all.0 == backwards.0, "{objective:?}, seed {seed}");
            // The candidates that count do not depend on the order of solving, although more are solved.
            assert_eq!(needed.1, backwards.1);
            assert!((needed.2 as f64) < share * all.2 as f64 && needed.2 < backwards.2, "{} and {} of {}", needed.2, backwards.2, all.2);
        }
    }
}
