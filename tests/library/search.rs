//! The whole search through the library's interface, on a biped that walks a metre.

use crate::common::task;
use cregopt::gait::Curve;
use cregopt::gait::cost::CostWeights;
use cregopt::gait::family::{GaitFamily, PeriodicGait};
use cregopt::gait::spline::hermite;
use cregopt::nlp::transcription::force_limit;
use cregopt::robot::{GRAVITY, Reach};
use cregopt::scenario::Scenario;
use cregopt::search::cem::{CemSettings, Objective, Sampler, StopReason};
use cregopt::search::evaluate::{Evaluate, LowerSettings};
use cregopt::search::{Gaits, SearchEvent, SearchSettings};
use cregopt::{Cpu, Error, Goal, Robot, Schedule, Search, SearchResult, Task, Terrain, verify};
use std::sync::atomic::AtomicBool;

/// Interval between the times at which a foot is examined, s.
const SAMPLES: f64 = 1e-3;

/// Largest excess of samples over a limit: the certificate's tolerance.
const TOLERANCE: f64 = 1e-4;

fn walk() -> Task {
    task("biped", "flat", [0.8, 0.1], 0.2)
}

fn run(search: Search) -> SearchResult {
    search.run(&Cpu::new(2).unwrap()).unwrap()
}

/// Cost of transport of the best gait.
fn cost(gait: &cregopt::search::Gait) -> f64 {
    gait.candidate.solution.cost.unwrap().total
}

#[test]
fn the_same_seed_gives_the_same_gait_at_any_number_of_threads() {
    let task = walk();
    let [one, two] = [1, 2].map(|threads| Search::new(&task).seed(3).run(&Cpu::new(threads).unwrap()).unwrap());
    let parts = |found: &SearchResult| {
        let best = &found.best.candidate;
        (best.generation, best.index, best.schedule.clone(), best.solution.x.clone(), best.solution.cost, best.family, found.stop)
    };
    assert_eq!(parts(&one), parts(&two));
    assert_eq!(one.best.trajectory(), two.best.trajectory());
    assert_eq!(one.generations, two.generations);
    let history = |found: &SearchResult| found.improvements.iter().map(|i| (i.generation, i.candidates, i.objective)).collect::<Vec<_>>();
    assert_eq!(history(&one), history(&two));
    // Typical gaits come first and do not depend on the seed; the gaits that are drawn after them do.
    let other = run(Search::new(&task).seed(4));
    assert_eq!(one.generations[0], other.generations[0]);
    assert_ne!(one.generations[1], other.generations[1]);
}

#[test]
fn standing_still_is_one_stance_per_foot() {
    let found = run(Search::new(&task("biped", "flat", [0., 0.], 0.)));
    assert!(found.best.feasible() && found.best.certificate().feasible);
    assert!(found.best.schedule().durations().iter().all(|phases| phases.len() == 1), "{:?}", found.best.schedule());
    assert_eq!((found.stop, found.generations.len(), found.generations[0].evaluated), (StopReason::Converged, 1, 1));
    // Half the weight on each of two feet.
    let cost = found.best.candidate.solution.cost.unwrap();
    assert!((cost.effort - 0.5).abs() < 0.01 && cost.leg_work < 0.01 && cost.swing_work == 0., "{cost:?}");
}

#[test]
fn alternatives_are_of_other_families_and_none_is_cheaper_than_the_best() {
    let task = walk();
    let found = run(Search::new(&task).settings(SearchSettings { alternatives: 3, ..SearchSettings::default() }));
    let gaits: Vec<_> = std::iter::once(&found.best).chain(&found.alternatives).collect();
    assert!((2..=3).contains(&gaits.len()), "{} gaits", gaits.len());
    let mut families: Vec<GaitFamily> = gaits.iter().map(|gait| gait.candidate.family.unwrap()).collect();
    assert!(gaits.is_sorted_by(|a, b| cost(a) <= cost(b)), "{:?}", gaits.iter().map(|g| cost(g)).collect::<Vec<_>>());
    families.dedup();
    families.sort_by_key(|family| family.name());
    families.dedup();
    assert_eq!(families.len(), gaits.len(), "{families:?}");
    for gait in gaits {
        let limit = force_limit(&LowerSettings::default().transcription, &task);
        assert!(gait.feasible() && verify(gait.trajectory(), &task.robot, &task.terrain, limit).unwrap().feasible);
    }
    assert!(run(Search::new(&task).first()).alternatives.is_empty(), "none were requested");
}

/// Settings of a search that takes the first motion that holds and keeps the durations as they were drawn.
fn plain() -> SearchSettings {
    SearchSettings { optimise_iterations: 0, duration_steps: 0, ..SearchSettings::default() }
}

#[test]
fn every_improvement_is_better_and_the_last_is_the_best() {
    let task = walk();
    for settings in [plain(), SearchSettings::default()] {
        let durations_are_optimised = settings.duration_steps > 0;
        let (mut improvements, mut generations) = (Vec::new(), Vec::new());
        let found = run(Search::new(&task).settings(settings).seed(2).on_progress(|progress| match progress {
            SearchEvent::Improvement(improvement) => improvements.push((*improvement).clone()),
            SearchEvent::Generation(record) => generations.push((*record).clone()),
            SearchEvent::LowerGround(_) => panic!("the ground is flat"),
        }));
        assert_eq!((&improvements, &generations), (&found.improvements, &found.generations));
        assert!(improvements.is_sorted_by(|a, b| a.objective < b.objective && a.seconds <= b.seconds));
        let last = improvements.last().unwrap();
        assert_eq!((last.objective, last.generation, last.family), {
            let best = &found.best.candidate;
            (best.objective, best.generation, best.family)
        });
        assert_eq!(last.objective, -cost(&found.best));
        // The records agree. The durations are optimised after the last generation, without further candidates.
        let best_ever: Vec<f64> = generations.iter().filter_map(|g| g.best_ever_objective).collect();
        let drawn = improvements.iter().position(|i| Some(&i.objective) == best_ever.last()).unwrap();
        let (drawn, optimised) = improvements.split_at(drawn + 1);
        assert!(best_ever.is_sorted() && drawn.is_sorted_by(|a, b| a.candidates < b.candidates), "{best_ever:?}");
        let candidates: usize = generations.iter().map(|g| g.evaluated).sum();
        assert!(optimised.is_empty() != durations_are_optimised && optimised.iter().all(|i| i.candidates == candidates), "{optimised:?}");
        assert!(found.first_feasible_after.unwrap() <= found.seconds);
        assert!(drawn.len() > 1, "the search does better than typical gaits");
    }
}

#[test]
fn a_gait_with_too_many_strides_loses_some() {
    let task = task("anymal", "flat", [2., 0.], 0.);
    let typical = PeriodicGait::typical(GaitFamily::Trot, &task).unwrap();
    let found = run(Search::new(&task).gaits(Gaits::Families(vec![GaitFamily::Trot])));
    let (strides, cost) = (found.best.candidate.solution.schedule.stances(0) - 1, cost(&found.best));
    // Seeds 1 to 3 end between 1.67 and 1.70. With three force pieces it was 1.77 to 1.80, and with the five strides of the typical gait 1.83.
    assert!(typical.strides == 5 && strides == 4 && cost < 1.74, "{strides} strides, cost {cost}");
}

#[test]
fn a_long_turn_has_few_strides_and_a_short_horizon() {
    let task = Scenario::named("s2").unwrap().task(4).unwrap();
    let found = run(Search::new(&task).seed(1));
    let (schedule, cost) = (&found.best.candidate.solution.schedule, cost(&found.best));
    // With the time in the air kept alone, the search ended with 17 strides in 6.6 s, at 1.376.
    assert!(schedule.horizon() < 6. && cost < 1.32, "{} s, cost {cost}", schedule.horizon());
}

#[test]
fn the_neighbourhood_of_a_schedule_has_a_gait_that_costs_no_more() {
    let task = task("biped", "flat", [0.5, 0.], 0.);
    let own = Schedule::new(vec![vec![0.2, 0.3, 0.5, 0.3, 0.5, 0.3, 0.2], vec![0.6, 0.3, 0.5, 0.3, 0.6]]).unwrap();
    // By default the search takes the cheapest motion of a schedule, not the first that holds.
    let default = SearchSettings::default();
    let mut cheapest = LowerSettings::default();
    cheapest.solver.optimise.iterations = default.optimise_iterations;
    cheapest.solver.optimise.cost = default.cost;
    cheapest.transcription.reach_margin = default.reach_margin * task.robot.base_height;
    let costs = [(plain(), LowerSettings::default()), (default, cheapest)].map(|(settings, lower)| {
        let evaluate = Evaluate::new(&task).settings(lower);
        let evaluated = evaluate.run(std::slice::from_ref(&own), &Cpu::new(1).unwrap()).unwrap().remove(0).unwrap();
        assert!(evaluated.feasible);
        let own_cost = evaluated.cost.unwrap().total;
        let found = run(Search::new(&task).settings(settings).gaits(Gaits::Around(own.clone())).population(8));
        assert!(found.best.feasible() && cost(&found.best) <= own_cost);
        // The schedule itself comes first, then its neighbours: as many strides, or one less.
        assert_eq!(found.improvements[0].objective, -own_cost);
        assert_eq!((found.improvements[0].generation, found.improvements[0].family), (0, None));
        assert!((0..2).all(|foot| found.best.candidate.stances[foot] <= own.stances(foot)));
        own_cost
    });
    assert!(costs[1] < costs[0], "{costs:?}");
}

#[test]
fn a_search_for_the_first_gait_stops_there() {
    let found = run(Search::new(&walk()).first());
    assert_eq!((found.stop, found.generations.len(), found.improvements.len()), (StopReason::FirstFeasible, 1, 1));
    assert!(found.best.feasible());
}

#[test]
fn a_search_that_was_cancelled_before_it_began_has_nothing_to_return() {
    let task = walk();
    let refused = Search::new(&task).cancelled_by(&AtomicBool::new(true)).run(&Cpu::new(1).unwrap()).unwrap_err();
    assert!(matches!(&refused, Error::Ended { message } if message.contains("cancelled")), "{refused}");
}

#[test]
fn a_search_at_its_time_limit_returns_the_best_of_its_first_generation() {
    let found = run(Search::new(&walk()).settings(SearchSettings { seconds: Some(0.), ..SearchSettings::default() }));
    assert_eq!((found.stop, found.generations.len()), (StopReason::TimeLimit, 1));
    assert!(found.best.feasible());
}

#[test]
fn a_search_without_a_gait_at_its_time_limit_has_no_second_generation() {
    let task = Task { force_limit: Some(20.), ..walk() };
    let found = run(Search::new(&task).settings(SearchSettings { seconds: Some(0.), ..SearchSettings::default() }));
    assert_eq!((found.stop, found.generations.len()), (StopReason::TimeLimit, 1));
    assert!(!found.best.feasible());
}

#[test]
fn further_generations_follow_when_no_generation_was_planned() {
    let free = |further_generations: usize| {
        let gaits = SearchSettings { gaits: Gaits::Free, generations: 0, further_generations, ..SearchSettings::default() };
        Search::new(&walk()).settings(gaits).run(&Cpu::new(2).unwrap())
    };
    assert!(free(12).unwrap().best.feasible());
    assert!(matches!(free(0).unwrap_err(), Error::Ended { .. }));
}

#[test]
fn a_distance_too_long_for_one_family_is_left_to_the_others() {
    let task = task("pexod", "flat", [24., 0.], 0.);
    let mut lower = LowerSettings::default();
    // Only the choice of families matters, not how the solves end.
    lower.solver.max_iterations = 0;
    let search = |families: &[GaitFamily]| {
        let settings = SearchSettings {
            gaits: Gaits::Families(families.to_vec()),
            generations: 0,
            further_generations: 0,
            ..SearchSettings::default()
        };
        Search::new(&task).settings(settings).lower(lower.clone()).run(&Cpu::new(2).unwrap())
    };
    assert!(search(&[GaitFamily::Wave]).unwrap_err().to_string().contains("at most 120 s"));
    let found = search(&[GaitFamily::Wave, GaitFamily::Tripod]).unwrap();
    assert_eq!((found.generations[0].evaluated, found.best.candidate.family), (1, Some(GaitFamily::Tripod)));
}

#[test]
fn a_gait_onto_a_high_block_is_raised_from_lower_ground() {
    // Up 0.4 m: the regular strides of the families do not lead there.
    let block = Terrain::named("block").unwrap().with_relief(0.8, 0., [[-2., -2.], [4., 2.]]);
    let task = Task::new(Robot::named("hyq").unwrap(), block, Goal::at(2., 0.)).unwrap();
    let search = |relief_levels: usize, threads: usize, ground: &mut Vec<f64>| {
        let settings = SearchSettings { generations: 0, further_generations: 0, first: true, relief_levels, ..SearchSettings::default() };
        let search = Search::new(&task).settings(settings).on_progress(|progress| {
            if let SearchEvent::LowerGround(lower) = progress {
                ground.push(lower.share);
            }
        });
        search.run(&Cpu::new(threads).unwrap()).unwrap()
    };
    let mut shares = Vec::new();
    let without = search(0, 2, &mut shares);
    assert!(!without.best.feasible() && without.lower_ground.is_none() && shares.is_empty());
    let found = search(60, 2, &mut shares);
    let ground = found.lower_ground.unwrap();
    assert_eq!((found.stop, ground.share, ground.levels), (StopReason::FirstFeasible, 1., shares.len()));
    assert!(shares.is_sorted() && ground.levels > 2 && ground.candidates > ground.levels, "{shares:?}");
    let limit = force_limit(&LowerSettings::default().transcription, &task);
    assert!(verify(found.best.trajectory(), &task.robot, &task.terrain, limit).unwrap().feasible);
    // All feet end on the block, and the base follows: it noses up while only the front feet are there.
    assert!(found.best.trajectory().end_feet().iter().all(|[x, y]| (task.terrain.height(*x, *y) - 0.4).abs() < 1e-9));
    let cost = found.best.candidate.solution.cost.unwrap();
    assert!((10. ..60.).contains(&cost.tilt), "{cost:?}");
    // A level that is not reached is reported, and the number of threads decides nothing.
    let [few, same] = [1, 2].map(|threads| search(3, threads, &mut Vec::new()));
    let ended = few.lower_ground.unwrap();
    assert!(!few.best.feasible() && ended.levels == 3 && ended.share == shares[2], "{ended:?}");
    assert_eq!(few.lower_ground, same.lower_ground);
}

#[test]
fn plain_random_sampling_learns_nothing() {
    let mut settings = SearchSettings::default();
    settings.free.sampler = Sampler::Random;
    let found = run(Search::new(&walk()).settings(settings.clone()));
    // All families are as likely at the end as at the beginning, and no candidate is drawn around the best.
    assert!(found.best.feasible() && found.generations.len() == 1 + settings.generations);
    assert!(found.generations[1..].iter().all(|g| (g.entropy - 3f64.ln()).abs() < 1e-12), "{:?}", found.generations);
}

#[test]
fn invalid_requests_are_refused() {
    let task = walk();
    let refused = |settings: SearchSettings| Search::new(&task).settings(settings).run(&Cpu::new(1).unwrap()).unwrap_err();
    let default = SearchSettings::default;
    let trot = refused(SearchSettings { gaits: Gaits::Families(vec![GaitFamily::Trot]), ..default() });
    assert!(matches!(&trot, Error::Unknown { name, known, .. } if name == "trot" && known == "walk, run, hop"), "{trot}");
    for (settings, place) in [
        (SearchSettings { gaits: Gaits::Families(Vec::new()), ..default() }, "search.gaits"),
        (SearchSettings { elites: 17, ..default() }, "search.elites"),
        (SearchSettings { alternatives: 0, ..default() }, "search.alternatives"),
        (SearchSettings { seconds: Some(f64::NAN), ..default() }, "search.seconds"),
        (SearchSettings { free: CemSettings { min_stances: 0, ..CemSettings::default() }, ..default() }, "search.free.min_stances"),
        (SearchSettings { gaits: Gaits::Around(Schedule::new(vec![vec![1.]; 3]).unwrap()), ..default() }, "durations"),
    ] {
        let error = refused(settings);
        assert!(matches!(&error, Error::Invalid { place: at, .. } if at == place), "{error}");
    }
}

#[test]
fn without_a_gait_the_candidate_that_violates_least_is_returned() {
    // Two feet that bear a tenth of the weight each cannot carry the robot.
    let mut task = walk();
    task.force_limit = Some(0.1 * task.robot.weight());
    let found = run(Search::new(&task).settings(SearchSettings { generations: 0, further_generations: 0, ..SearchSettings::default() }));
    assert!(!found.best.feasible() && found.best.certificate().n_violated > 0);
    assert_eq!(Some(found.best.certificate().n_violated), found.generations[0].lowest_n_violated);
    assert!(found.improvements.is_empty() && found.first_feasible_after.is_none() && found.best.candidate.solution.cost.is_none());
}

#[test]
fn the_objective_decides_which_gait_is_best() {
    // Work alone gives no reason to hurry.
    let task = walk();
    let cost = CostWeights { effort: 0., ..CostWeights::default() };
    let settings = SearchSettings { cost, ..SearchSettings::default() };
    let best = |objective| run(Search::new(&task).settings(settings.clone().seeking(objective))).best.candidate;
    let (quickest, cheapest) = (best(Objective::Time), best(Objective::Transport));
    assert_eq!(quickest.objective, -quickest.solution.cost.unwrap().horizon);
    assert!(quickest.solution.horizon < cheapest.solution.horizon);
    assert!(quickest.solution.cost.unwrap().total >= cheapest.solution.cost.unwrap().total);
}

/// Value, first and second derivative of a curve at a time, per component.
fn sample(curve: &Curve, time: f64) -> [[f64; 3]; 3] {
    let (mut start, mut piece) = (0., 0);
    while piece + 1 < curve.poly_durations.len() && time > start + curve.poly_durations[piece] {
        start += curve.poly_durations[piece];
        piece += 1;
    }
    let (length, t) = (curve.poly_durations[piece], time - start);
    let (a, b) = (&curve.nodes[piece], &curve.nodes[piece + 1]);
    let value = hermite(t, length);
    // p = a + v t + (3 d - (2 v + w) T) (t / T)^2 + ((v + w) T - 2 d) (t / T)^3, d = b - a.
    let derivatives = |i: usize| {
        let (d, v, w) = (b[i] - a[i], a[3 + i], b[3 + i]);
        let (square, cube) = (3. * d - (2. * v + w) * length, (v + w) * length - 2. * d);
        let u = t / length;
        [v + (2. * square * u + 3. * cube * u * u) / length, (2. * square + 6. * cube * u) / (length * length)]
    };
    let rates: [[f64; 2]; 3] = std::array::from_fn(derivatives);
    [
        std::array::from_fn(|i| value[0] * a[i] + value[1] * a[3 + i] + value[2] * b[i] + value[3] * b[3 + i]),
        rates.map(|r| r[0]),
        rates.map(|r| r[1]),
    ]
}

#[test]
fn feet_stay_within_the_limits_of_legs() {
    // At the fastest gaits of the families the limits are active.
    let task = task("biped", "flat", [1.2, 0.], 0.);
    let settings = SearchSettings { alternatives: 3, ..SearchSettings::default().seeking(Objective::Time) };
    let found = run(Search::new(&task).settings(settings));
    let robot = &task.robot;
    let (speed, acceleration) = (1.9 * (GRAVITY * robot.base_height).sqrt(), 20. * GRAVITY);
    let force = 2.5 * robot.mass * GRAVITY;
    let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let mut greatest = [0_f64; 3];
    for gait in std::iter::once(&found.best).chain(&found.alternatives) {
        let trajectory = gait.trajectory();
        assert!(gait.feasible() && trajectory.limits.unwrap().foot_acceleration == Some(acceleration));
        for foot in &trajectory.ee {
            for i in 0..=(trajectory.horizon / SAMPLES) as usize {
                let [_, rate, second] = sample(&foot.motion, i as f64 * SAMPLES);
                let [push, ..] = sample(&foot.force, i as f64 * SAMPLES);
                for (greatest, value) in greatest.iter_mut().zip([norm(&rate[..2]), norm(&second), push[2]]) {
                    *greatest = greatest.max(value);
                }
            }
        }
    }
    for (value, limit) in greatest.into_iter().zip([speed, acceleration, force]) {
        assert!(value <= limit + TOLERANCE, "{greatest:?}");
        assert!(value > 0.2 * limit, "far from any limit: {greatest:?}");
    }
}

#[test]
fn hind_feet_stay_within_a_shorter_reach_ahead() {
    const LESS: f64 = 0.03;
    let with = |reach| {
        let robot = Robot { reach, name: "short behind".into(), ..Robot::named("anymal").unwrap() };
        Task::new(robot, Terrain::flat(), Goal::at(2., 0.)).unwrap()
    };
    let side = |ahead| [[-0.15, ahead], [-0.1, 0.1], [-0.1, 0.1]];
    let whole = with([0.15, 0.1, 0.1].into());
    let less = with(Reach::boxes(vec![side(0.15), side(0.15), side(0.15 - LESS), side(0.15 - LESS)]));
    let schedule = PeriodicGait::typical(GaitFamily::Trot, &less).unwrap().schedule().unwrap();
    let [free, kept] = [&whole, &less].map(|task| {
        let evaluate = Evaluate::new(task);
        let solved = evaluate.run(std::slice::from_ref(&schedule), &Cpu::new(2).unwrap()).unwrap().remove(0).unwrap();
        evaluate.trajectory(&solved)
    });
    let report = |trajectory| verify(trajectory, &less.robot, &less.terrain, less.robot.default_force_limit()).unwrap();
    // The limit is active: with the whole reach the hind feet get farther ahead.
    let excess = report(&free).dense.reach_excess;
    assert!(excess.value > 0.01 && excess.foot.is_some_and(|foot| foot >= 2), "{excess:?}");
    let kept = report(&kept);
    assert!(kept.feasible && kept.dense.reach_excess.value < 5e-3, "{kept}");
}

#[test]
fn a_gap_is_crossed_with_every_whole_foot_on_its_rims() {
    let task = task("hyq", "gap", [2.5, 0.], 0.);
    let found = run(Search::new(&task).settings(SearchSettings { first: true, ..SearchSettings::default() }));
    assert!(found.best.feasible(), "{}", found.best.certificate());
    let radius = task.robot.foot_radius();
    let footholds = |e: &cregopt::gait::FootCurves| e.motion.nodes.iter().filter(|n| n[2] == 0.).map(|n| n[0]).collect::<Vec<_>>();
    let places: Vec<f64> = found.best.trajectory().ee.iter().flat_map(footholds).collect();
    // A slope of ten to one, which begins a twentieth of a radius inside, is half a radius off the plane.
    assert!(places.iter().all(|&x| x < 1. - 0.95 * radius + 1e-3 || x > 1.6 + 0.95 * radius - 1e-3), "{places:?}");
    assert!(places.iter().any(|&x| x < 1.) && places.iter().any(|&x| x > 1.6));
}
