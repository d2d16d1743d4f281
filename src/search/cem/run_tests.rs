//! Tests of the cross-entropy loop with evaluators that need no solver.

use super::*;
use crate::error::check_range;
use crate::search::cem::{Evaluation, FreeDistribution, Objective};

/// Evaluator made from a function of (generation, index, schedule). Its solution is (generation, index).
struct Synthetic<F> {
    answer: F,
    calls: usize,
    cancel_after: usize,
    /// Longest horizon that the evaluator accepts, s.
    longest: f64,
}

fn synthetic<F: FnMut(usize, usize, &Schedule) -> Option<Evaluation>>(answer: F) -> Synthetic<F> {
    Synthetic { answer, calls: 0, cancel_after: usize::MAX, longest: f64::INFINITY }
}

impl<F: FnMut(usize, usize, &Schedule) -> Option<Evaluation>> GenerationEvaluator for Synthetic<F> {
    type Solution = (usize, usize);

    fn check(&self, schedule: &Schedule) -> Result<()> {
        check_range("horizon", schedule.horizon(), 0., self.longest)
    }

    fn evaluate(&mut self, generation: usize, schedules: &[Schedule], _: &SelectionGoal) -> GenerationResults<Self::Solution> {
        self.calls += 1;
        let schedules = schedules.iter().enumerate();
        schedules.map(|(i, s)| (self.answer)(generation, i, s).map(|e| (e, Some(Box::new((generation, i)))))).collect()
    }

    fn cancelled(&self) -> bool {
        self.calls >= self.cancel_after
    }
}

fn violating(n_violated: usize) -> Evaluation {
    Evaluation { n_violated, feasible: n_violated == 0, certified: true, mean_normal_force: 10., cost: None }
}

/// Number of violated constraints: 5 times the distance of the stance counts from a hidden pattern plus 10 times that of the log durations
/// from -1.3.
fn hidden_pattern(_: usize, _: usize, schedule: &Schedule) -> Option<Evaluation> {
    let wrong: usize = [9usize, 10, 10, 11].iter().enumerate().map(|(foot, &n)| schedule.stances(foot).abs_diff(n)).sum();
    let late: f64 = schedule.durations().iter().flatten().map(|d| (d.ln() + 1.3).abs()).sum();
    Some(violating(5 * wrong + (10. * late) as usize))
}

fn initial(settings: &CemSettings) -> FreeDistribution {
    FreeDistribution::initial(settings, 4).unwrap()
}

fn search<F>(settings: &CemSettings, seed: u64, evaluator: &mut Synthetic<F>) -> CemOutcome<(usize, usize), FreeDistribution>
where
    F: FnMut(usize, usize, &Schedule) -> Option<Evaluation>,
{
    run(settings, initial(settings), seed, 0, evaluator, &mut |_| ()).unwrap()
}

#[test]
fn cem_beats_random_search_with_the_same_budget() {
    let cem = CemSettings { population: 32, elites: 8, generations: 30, ..Default::default() };
    let random = CemSettings { sampler: Sampler::Random, ..cem.clone() };
    for seed in 0..5 {
        let best = |settings| search(settings, seed, &mut synthetic(hidden_pattern)).best.unwrap().objective;
        assert!(best(&cem) > 0.5 * best(&random), "seed {seed}: {} and {}", best(&cem), best(&random));
    }
}

#[test]
fn random_search_never_changes_the_distribution() {
    let settings = CemSettings { sampler: Sampler::Random, generations: 3, stopping: Stopping::Convergence, ..Default::default() };
    let outcome = search(&settings, 1, &mut synthetic(hidden_pattern));
    assert_eq!((outcome.stop, outcome.generations.len()), (StopReason::GenerationLimit, 3));
    assert_eq!(outcome.distribution, initial(&settings));
}

#[test]
fn the_same_seed_gives_the_same_outcome() {
    let settings = CemSettings { generations: 5, ..Default::default() };
    let [a, b, c] = [1, 1, 2].map(|seed| search(&settings, seed, &mut synthetic(hidden_pattern)));
    assert_eq!(a, b);
    assert_ne!(a, c);
}

#[test]
fn the_search_stops_at_the_first_feasible_candidate() {
    let found = |generation, i, _: &Schedule| Some(violating(if generation == 2 && (i == 5 || i == 9) { 0 } else { 3 }));
    let mut seen = Vec::new();
    let outcome =
        run(&CemSettings::default(), initial(&CemSettings::default()), 1, 0, &mut synthetic(found), &mut |r| seen.push(r.clone())).unwrap();
    let best = outcome.best.unwrap();
    assert_eq!((outcome.stop, best.generation, best.index, best.solution, best.objective), (StopReason::FirstFeasible, 2, 5, (2, 5), 0.));
    assert_eq!(best.stances, (0..4).map(|foot| best.schedule.stances(foot)).collect::<Vec<_>>());
    assert_eq!(seen, outcome.generations);
    // Candidates after the first feasible one do not count, evaluated or not.
    assert_eq!((seen.len(), seen[2].evaluated, seen[2].feasible, seen[2].lowest_n_violated), (3, 6, 1, Some(0)));
}

#[test]
fn a_whole_generation_gives_its_best_feasible_candidate() {
    let mut force = |_, i: usize, _: &Schedule| {
        Some(Evaluation {
            n_violated: 0,
            feasible: i > 2,
            certified: true,
            mean_normal_force: [1., 1., 1., 50., 40., 30., 30.][i.min(6)],
            cost: None,
        })
    };
    let settings = CemSettings { objective: Objective::LeastForce, whole_generation: true, ..Default::default() };
    let outcome = search(&settings, 1, &mut synthetic(&mut force));
    // The first three have the largest J but are not feasible; 5 and 6 are equal.
    assert_eq!((outcome.best.unwrap().index, outcome.generations[0].evaluated), (5, 16));
    let settings = CemSettings { whole_generation: false, ..settings };
    assert_eq!(search(&settings, 1, &mut synthetic(&mut force)).best.unwrap().index, 3);
}

#[test]
fn with_convergence_a_feasible_candidate_does_not_end_the_search_and_ties_go_to_the_first() {
    let settings = CemSettings { generations: 4, stopping: Stopping::Convergence, ..Default::default() };
    let outcome = search(&settings, 1, &mut synthetic(|g, i, _| Some(violating(usize::from(g == 0 || i < 2)))));
    let best = outcome.best.unwrap();
    assert_eq!((outcome.stop, outcome.generations.len(), best.generation, best.index), (StopReason::GenerationLimit, 4, 1, 2));
    assert_eq!(outcome.generations[0].best_ever_objective, Some(-100.));
    assert_eq!(outcome.generations[3].best_ever_objective, Some(0.));
}

#[test]
fn a_converged_distribution_ends_the_search() {
    // One elite, so every category settles at once, and a loose threshold for the durations.
    let settings = CemSettings { elites: 1, stopping: Stopping::Convergence, converged_std: 2., ..Default::default() };
    let outcome = search(&settings, 1, &mut synthetic(hidden_pattern));
    assert_eq!((outcome.stop, outcome.generations.len()), (StopReason::Converged, 1));
    let never = CemSettings { converged_std: 0., ..settings };
    assert_eq!(search(&never, 1, &mut synthetic(hidden_pattern)).stop, StopReason::GenerationLimit);
}

#[test]
fn a_cancelled_search_returns_the_best_so_far() {
    let mut evaluator = synthetic(|_, i, _: &Schedule| (i % 2 == 0).then(|| violating(20 - i)));
    evaluator.cancel_after = 2;
    let outcome = search(&CemSettings::default(), 1, &mut evaluator);
    assert_eq!((outcome.stop, outcome.generations.len(), outcome.generations[1].evaluated), (StopReason::Cancelled, 2, 8));
    assert_eq!(outcome.best.unwrap().index, 14);
    evaluator.cancel_after = 0;
    let outcome = search(&CemSettings::default(), 1, &mut evaluator);
    assert!(outcome.best.is_none() && outcome.generations.is_empty() && outcome.stop == StopReason::Cancelled);
}

#[test]
fn candidates_that_were_not_evaluated_are_no_elites() {
    // Candidate 3 alone is evaluated: the distribution takes its values.
    let settings = CemSettings { generations: 1, ..Default::default() };
    let outcome = search(&settings, 1, &mut synthetic(|_, i, _| (i == 3).then(|| violating(1))));
    let sample = initial(&settings).sample(Draws::new(1, 0, 3));
    let mut want = initial(&settings);
    want.update(&[&sample]);
    assert_eq!(outcome.distribution, want);
    // With none there is nothing to learn and nothing to return.
    let outcome = search(&settings, 1, &mut synthetic(|_, _, _| None));
    assert!(outcome.best.is_none() && outcome.distribution == initial(&settings));
    assert_eq!((outcome.generations[0].best_objective, outcome.generations[0].lowest_n_violated), (None, None));
}

#[test]
fn a_candidate_with_a_nan_objective_ranks_after_every_finite_one() {
    let force = |i: usize| if i < 13 { f64::NAN } else { i as f64 };
    let answer =
        |_, i, _: &Schedule| Some(Evaluation { n_violated: 9, feasible: false, certified: true, mean_normal_force: force(i), cost: None });
    let settings = CemSettings { generations: 1, elites: 3, objective: Objective::LeastForce, ..Default::default() };
    let outcome = search(&settings, 1, &mut synthetic(answer));
    let initial = initial(&settings);
    let samples = [13, 14, 15].map(|i| initial.sample(Draws::new(1, 0, i)));
    let mut want = initial;
    want.update(&samples.iter().collect::<Vec<_>>());
    assert_eq!(outcome.distribution, want);
    assert_eq!(outcome.best.unwrap().index, 13);
    assert_eq!(outcome.generations[0].mean_objective, Some(-914.));
}

#[test]
fn invalid_arguments_are_rejected() {
    for feet in [0, 9] {
        assert!(FreeDistribution::initial(&CemSettings::default(), feet).unwrap_err().to_string().starts_with("feet"));
    }
    let settings = CemSettings { population: 0, ..Default::default() };
    assert!(FreeDistribution::initial(&settings, 4).is_err());
    let distribution = initial(&CemSettings::default());
    assert!(run(&settings, distribution, 1, 0, &mut synthetic(hidden_pattern), &mut |_| ()).is_err());
}

#[test]
fn generations_with_different_numbers_draw_different_candidates() {
    let settings = CemSettings { generations: 1, ..Default::default() };
    let best = |first| run(&settings, initial(&settings), 1, first, &mut synthetic(hidden_pattern), &mut |_| ()).unwrap().best.unwrap();
    assert_eq!((best(3).generation, best(0).generation), (3, 0));
    assert_ne!(best(3).schedule, best(0).schedule);
}

#[test]
fn a_record_does_not_depend_on_the_order_of_candidates() {
    let settings = CemSettings { population: 16, generations: 1, ..Default::default() };
    let mut seen = 0;
    let mut evaluator = synthetic(|_, i, _| Some(violating([3, 1, 2][i % 3])));
    run_observed(&settings, initial(&settings), 1, 0, &mut evaluator, &mut |generation| {
        let candidates = || generation.ranked.iter();
        let of = |record: GenerationRecord| (record.best_objective, record.lowest_n_violated, record.evaluated);
        assert_eq!(of(summarise(0, candidates(), 0., 0.)), of(summarise(0, candidates().rev(), 0., 0.)));
        assert_eq!(generation.record.best_objective, Some(-100.));
        seen += 1;
    })
    .unwrap();
    assert_eq!(seen, 1);
}

#[test]
fn candidates_that_cannot_be_evaluated_are_redrawn_or_left_out_and_it_is_an_error_if_none_remains() {
    let settings = CemSettings { population: 32, elites: 4, generations: 3, ..CemSettings::default() };
    let horizons = |longest: f64| {
        let mut horizons = Vec::new();
        let mut evaluator = Synthetic {
            longest,
            ..synthetic(|generation, _, schedule: &Schedule| {
                horizons.push((generation, schedule.horizon()));
                Some(violating(1))
            })
        };
        run(&settings, initial(&settings), 1, 0, &mut evaluator, &mut |_| ()).map(|_| horizons)
    };
    let mut first: Vec<f64> = horizons(f64::INFINITY).unwrap().iter().filter(|(generation, _)| *generation == 0).map(|(_, h)| *h).collect();
    first.sort_by(f64::total_cmp);
    // If half of the draws are too long, all are replaced. If nearly all are, some candidates are left out.
    for (longest, all) in [(first[16], true), (first[1], false)] {
        let horizons = horizons(longest).unwrap();
        assert!(horizons.iter().all(|(_, horizon)| *horizon <= longest));
        assert_eq!(horizons.len() == 32 * 3, all, "{} of {}", horizons.len(), 32 * 3);
    }
    assert!(horizons(1e-3).unwrap_err().to_string().starts_with("horizon: "));
}
