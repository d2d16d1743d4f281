//! Programs for Ipopt, checked against central differences, TOWR's own numbers and solutions, and this program's solver; and Ipopt's
//! solutions of them, if the feature `ipopt` is enabled.

use crate::common::{Random, data, gait, hills, reference_candidates, spider, task_for, towr};
#[cfg(any(feature = "experiment", feature = "ipopt"))]
use crate::harness;
use cregopt::backend::Cpu;
use cregopt::gait::{Schedule, Trajectory};
use cregopt::reference::contact_implicit::{ContactImplicit, Contacts};
use cregopt::reference::nlp::{Nlp, Pattern, Rows, Variables};
use cregopt::reference::towr::Towr;
use cregopt::robot::Robot;
use cregopt::search::evaluate::{LowerSettings, evaluate};
use cregopt::task::Task;
use cregopt::terrain::Terrain;
use std::collections::BTreeMap;

/// Step of the central differences.
const STEP: f64 = 1e-6;
/// Largest difference from them, relative to the larger of 1 and the derivative. Their own error is 1e-16 of the largest terms (1e3 N m)
/// over the step, and the step's square times third derivatives.
const DIFFERENCE: f64 = 2e-6;

fn rows_at(nlp: &dyn Nlp, x: &[f64]) -> Rows {
    let mut rows = Rows::default();
    nlp.rows(x, &mut rows);
    rows
}

/// Largest violation of a row or bound.
fn worst_violation(nlp: &dyn Nlp, x: &[f64]) -> f64 {
    let rows = rows_at(nlp, x);
    let outside = |value: f64, [low, high]: [f64; 2]| (low - value).max(value - high).max(0.);
    let of_rows = rows.values.iter().zip(&rows.limits).map(|(v, l)| outside(*v, *l));
    of_rows.chain(x.iter().zip(&nlp.variables().bounds).map(|(v, b)| outside(*v, *b))).fold(0., f64::max)
}

/// Compares the Jacobian at a point with central differences, every entry, including those that the program omits.
fn check_jacobian(nlp: &dyn Nlp, x: &[f64], name: &str) {
    let rows = rows_at(nlp, x);
    let pattern = Pattern::new(&rows);
    let mut values = vec![f64::NAN; pattern.entries.len()];
    pattern.values(&rows, &mut values);
    let jacobian: BTreeMap<(u32, u32), f64> = pattern.entries.iter().copied().zip(values).collect();
    assert_eq!(jacobian.len(), pattern.entries.len(), "{name}: an entry comes twice");
    for variable in 0..x.len() {
        let at = |step: f64| {
            let mut x = x.to_vec();
            x[variable] += step;
            rows_at(nlp, &x)
        };
        let (above, below) = (at(STEP), at(-STEP));
        for row in 0..rows.values.len() {
            let difference = (above.values[row] - below.values[row]) / (2. * STEP);
            let exact = jacobian.get(&(row as u32, variable as u32)).copied().unwrap_or(0.);
            let apart = (difference - exact).abs() / (1. + exact.abs());
            assert!(apart < DIFFERENCE, "{name}: row {row} by variable {variable}: {exact}, central difference {difference}");
        }
    }
    assert_eq!(Pattern::new(&rows_at(nlp, &nlp.variables().initial)).entries, pattern.entries, "{name}: the pattern depends on the point");
}

/// The initial point with a small random change of every variable.
fn near_initial(nlp: &dyn Nlp, random: &mut Random, by: f64) -> Vec<f64> {
    nlp.variables().initial.iter().map(|v| v + by * (1. + v.abs()) * random.between(-1., 1.)).collect()
}

/// A gait whose feet end together, short enough for dense differences.
fn short_gait(random: &mut Random, feet: usize) -> Schedule {
    gait(random, feet, 2..=3).stretched()
}

#[test]
fn the_jacobian_of_towrs_program_matches_central_differences() {
    let mut random = Random::new(11);
    for (robot, terrain) in [(Robot::named("biped").unwrap(), hills()), (spider(3), Terrain::named("slope").unwrap())] {
        let name = format!("{} on {}", robot.name, terrain.name);
        let task = task_for(robot, terrain, [0.7, 0.2], 0.4);
        let schedule = short_gait(&mut random, task.robot.feet());
        let fixed = Towr::fixed(&task, &schedule);
        check_jacobian(&fixed, &near_initial(&fixed, &mut random, 0.02), &format!("{name}, durations fixed"));
        let free = Towr::free(&task, &schedule, [0.05, 0.5]);
        check_jacobian(&free, &near_initial(&free, &mut random, 0.02), &format!("{name}, durations free"));
    }
}

#[test]
fn the_jacobian_of_the_contact_implicit_program_matches_central_differences() {
    let mut random = Random::new(12);
    let task = task_for(Robot::named("biped").unwrap(), hills(), [0.4, 0.1], 0.3);
    let contacts = vec![vec![true, true, false, false, true, true], vec![true, false, false, true, true, true]];
    for contacts in [Contacts::Relaxed(0.1), Contacts::Given(contacts)] {
        let nlp = ContactImplicit::new(&task, 0.6, contacts.clone());
        check_jacobian(&nlp, &near_initial(&nlp, &mut random, 0.02), &format!("{contacts:?}"));
    }
}

#[test]
fn the_jacobian_test_sees_a_wrong_entry() {
    /// A program with one derivative that is 1 % off.
    struct Off<'a>(Towr<'a>);
    impl Nlp for Off<'_> {
        fn variables(&self) -> &Variables {
            self.0.variables()
        }
        fn rows(&self, x: &[f64], rows: &mut Rows) {
            self.0.rows(x, rows);
            let largest = rows.entries.iter_mut().max_by(|a, b| a.2.abs().total_cmp(&b.2.abs())).unwrap();
            largest.2 *= 1.01;
        }
    }
    let task = task_for(Robot::named("biped").unwrap(), Terrain::named("flat").unwrap(), [0.4, 0.], 0.);
    let off = Off(Towr::fixed(&task, &short_gait(&mut Random::new(1), 2)));
    let x = off.variables().initial.clone();
    let check = std::panic::AssertUnwindSafe(|| check_jacobian(&off, &x, "off"));
    assert!(std::panic::catch_unwind(check).is_err());
}

#[test]
fn sizes_are_those_of_towr() {
    let candidates = reference_candidates();
    for candidate in &candidates {
        let nlp = Towr::fixed(&candidate.task, &candidate.schedule);
        let rows = rows_at(&nlp, &nlp.variables().initial);
        let name = format!("{} target {} candidate {}", candidate.scenario, candidate.target, candidate.index);
        assert_eq!((nlp.variables().initial.len(), rows.values.len()), (candidate.n_variables, candidate.n_constraints), "{name}");
        // Entries that are zero at every point are counted differently.
        let ratio = Pattern::new(&rows).entries.len() as f64 / candidate.nnz_jacobian as f64;
        assert!((0.9..1.1).contains(&ratio), "{name}: {ratio}");
    }
}

#[test]
fn towrs_own_solutions_satisfy_the_program() {
    let candidates = reference_candidates();
    for line in data("towr_solutions.jsonl").lines() {
        let trajectory = Trajectory::from_json(line).unwrap();
        let value: serde_json::Value = serde_json::from_str(line).unwrap();
        let same = |c: &&crate::common::ReferenceCandidate| {
            c.scenario == value["scenario"] && c.target == value["target"] && c.index == value["idx"]
        };
        let candidate = candidates.iter().find(same).unwrap();
        let nlp = Towr::fixed(&candidate.task, &Schedule::new(trajectory.durations.clone()).unwrap());
        let x = nlp.point(&trajectory).unwrap();
        // Solved to 1e-4, written with fifteen digits.
        assert!(worst_violation(&nlp, &x) < 1.01e-4, "{} {}: {}", value["scenario"], value["idx"], worst_violation(&nlp, &x));
        let back = nlp.trajectory(&x);
        assert_eq!(back.base_lin.nodes, trajectory.base_lin.nodes);
        assert_eq!(back.ee.len(), trajectory.ee.len());
        for (a, b) in back.ee.iter().zip(&trajectory.ee) {
            let apart =
                |a: &[[f64; 6]], b: &[[f64; 6]]| a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs()).fold(0., f64::max);
            assert!(apart(&a.motion.nodes, &b.motion.nodes) < 1e-12 && apart(&a.force.nodes, &b.force.nodes) < 1e-12);
        }
    }
}

#[test]
fn solutions_of_this_solver_satisfy_towrs_whole_program() {
    // Both solvers have the same problem: rows that this one eliminates are not missing.
    let task = |scenario: &str| {
        let mut task = cregopt::scenario::Scenario::named(scenario).unwrap().task(7).unwrap();
        task.force_limit = Some(cregopt::nlp::transcription::towr::FORCE_LIMIT);
        task
    };
    let settings = LowerSettings { transcription: towr(), ..LowerSettings::default() };
    for scenario in ["s1", "s2", "s3", "biped", "hex"] {
        let task: Task = task(scenario);
        let mut random = Random::new(5);
        let schedules: Vec<Schedule> = (0..8).map(|_| gait(&mut random, task.robot.feet(), 10..=13)).collect();
        let candidates: Vec<(&Task, &Schedule)> = schedules.iter().map(|s| (&task, s)).collect();
        let results = evaluate(&candidates, &settings, None, &Cpu::new(0).unwrap(), false, &|| false).unwrap();
        let feasible: Vec<_> = results.iter().flatten().filter(|r| r.feasible).collect();
        assert!(!feasible.is_empty(), "{scenario}: nothing to check");
        for result in feasible {
            let trajectory = result.trajectory(&task, &settings.transcription);
            let nlp = Towr::fixed(&task, &Schedule::new(trajectory.durations.clone()).unwrap());
            let worst = worst_violation(&nlp, &nlp.point(&trajectory).unwrap());
            assert!(worst < 1e-4, "{scenario}: {worst}");
        }
    }
}

#[test]
fn a_point_of_another_schedule_is_refused_by_name() {
    let task = task_for(Robot::named("biped").unwrap(), Terrain::named("flat").unwrap(), [0.4, 0.], 0.);
    let [one, other] = [vec![vec![0.6]; 2], vec![vec![0.2, 0.2, 0.2]; 2]].map(|d| Schedule::new(d).unwrap());
    let (one, other) = (Towr::fixed(&task, &one), Towr::fixed(&task, &other));
    let error = one.point(&other.trajectory(&other.variables().initial)).unwrap_err().to_string();
    assert!(error.contains("ee[0].motion.nodes") && error.contains("5 nodes") && error.contains("2 nodes"), "{error}");
}

#[cfg(not(feature = "ipopt"))]
#[test]
fn without_the_feature_ipopt_says_how_to_get_it() {
    let task = task_for(Robot::named("biped").unwrap(), Terrain::named("flat").unwrap(), [0.1, 0.], 0.);
    let nlp = Towr::fixed(&task, &Schedule::new(vec![vec![0.6]; 2]).unwrap());
    let error = cregopt::reference::ipopt::solve(&nlp, None, &cregopt::reference::ipopt::Options::LOWER_LEVEL).unwrap_err();
    assert!(error.to_string().contains("--features ipopt") && error.to_string().contains("coinor-libipopt-dev"), "{error}");
}

#[cfg(not(feature = "ipopt"))]
#[cfg(feature = "experiment")]
#[test]
fn without_ipopt_its_commands_exit_2_and_say_how_to_install_it() {
    let folder = harness::folder();
    harness::write_lines(folder.path(), &[harness::standing().to_string()]);
    for command in ["evaluate in.jsonl --robot anymal --solver ipopt", "experiment 1 --methods towr"] {
        harness::run(folder.path(), command).ends_with(2).says(&["--features ipopt", "coinor-libipopt-dev"]);
    }
}

#[cfg(feature = "ipopt")]
mod with_ipopt {
    use super::*;
    use cregopt::reference::ipopt::{self, Options};
    use cregopt::reference::job::{Answer, Job, Program};
    use cregopt::reference::workers::{Workers, serve};
    use cregopt::task::{BaseState, Goal};
    use cregopt::verify::verify_rows;
    use serde_json::json;
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn workers(count: usize) -> Workers {
        Workers::new(env!("CARGO_BIN_EXE_cregopt").into(), count)
    }

    fn scenario(name: &str, target: usize) -> Task {
        let mut task = cregopt::scenario::Scenario::named(name).unwrap().task(target).unwrap();
        task.force_limit = Some(cregopt::nlp::transcription::towr::FORCE_LIMIT);
        task
    }

    fn standing() -> (Task, Schedule) {
        (
            task_for(Robot::named("biped").unwrap(), Terrain::named("flat").unwrap(), [0.05, 0.], 0.),
            Schedule::new(vec![vec![0.6]; 2]).unwrap(),
        )
    }

    #[test]
    fn standing_is_solved_and_verified() {
        let (task, schedule) = standing();
        let nlp = Towr::fixed(&task, &schedule);
        let (x, statistics) = ipopt::solve(&nlp, None, &Options::LOWER_LEVEL).unwrap();
        assert_eq!(statistics.status, 0);
        assert!(worst_violation(&nlp, &x) < 1e-4);
        assert!(
            verify_rows(&nlp.trajectory(&x), &task.robot, &task.terrain, cregopt::nlp::transcription::towr::FORCE_LIMIT).unwrap().feasible
        );
    }

    #[test]
    fn limits_end_a_solve() {
        let task = scenario("s1", 10);
        let mut random = Random::new(3);
        let schedule = gait(&mut random, 4, 6..=6).stretched();
        let nlp = Towr::fixed(&task, &schedule);
        let (_, statistics) = ipopt::solve(&nlp, None, &Options { max_iterations: 3, ..Options::LOWER_LEVEL }).unwrap();
        assert_eq!((statistics.status, statistics.iterations), (-1, 3));
    }

    /// Interval between the reference candidates that are solved, of 240.
    const EVERY: usize = 7;
    /// Least number of equal verdicts, of 10. The others are cut off by a limit on one side.
    const SAME_OF_TEN: usize = 9;

    #[test]
    fn verdicts_equal_towrs_except_for_candidates_that_a_limit_cuts_off() {
        let candidates = reference_candidates();
        let candidates: Vec<_> = candidates.into_iter().step_by(EVERY).collect();
        let solve = |of: &[usize], options: Options| {
            let jobs: Vec<Job> = of.iter().map(|&i| Job::fixed(&candidates[i].task, &candidates[i].schedule, options)).collect();
            let answers: Vec<Mutex<Option<Answer>>> = jobs.iter().map(|_| Mutex::default()).collect();
            workers(2).solve(&jobs, &|_| false, &|i, answer| *answers[i].lock().unwrap() = Some(answer)).unwrap();
            answers.into_iter().map(|a| a.into_inner().unwrap().unwrap()).collect::<Vec<Answer>>()
        };
        let all: Vec<usize> = (0..candidates.len()).collect();
        // CPU seconds differ from machine to machine; iterations do not.
        let answers = solve(&all, Options { max_seconds: 60., ..Options::LOWER_LEVEL });
        let differing: Vec<usize> = all.into_iter().filter(|&i| answers[i].feasible != candidates[i].solved_at_once).collect();
        let longer = solve(&differing, Options { max_seconds: 60., max_iterations: 500, ..Options::LOWER_LEVEL });
        for (&i, longer) in differing.iter().zip(&longer) {
            let c = &candidates[i];
            println!("{} target {} candidate {}: {} here, {} there", c.scenario, c.target, c.index, answers[i].statistics.status, c.status);
            // If only one of TOWR's Ipopt and this one found a motion, the other had reached the iteration limit.
            assert!(longer.feasible, "not even in 500 iterations");
            assert!(if answers[i].feasible { [-1, -4].contains(&c.status) } else { answers[i].statistics.status == -1 });
        }
        let same = candidates.len() - differing.len();
        assert!(10 * same >= SAME_OF_TEN * candidates.len(), "{same} of {}", candidates.len());
    }

    #[test]
    fn towr_with_free_durations_finds_a_gait_inside_its_bounds() {
        let task = scenario("s1", 10);
        let durations: Vec<f64> = (0..19).map(|phase| if phase % 2 == 0 { 0.2 } else { 0.1 }).collect();
        let job = Job::new(&task, Program::Free(vec![durations; 4], [0.08, 0.36]), Options { max_seconds: 120., ..Options::BASELINE });
        let answer = job.run().unwrap();
        assert!(answer.feasible, "{} violated, status {}", answer.n_violated, answer.statistics.status);
        let moved = answer.trajectory.durations.iter().flatten().filter(|d| (**d - 0.1).abs() > 1e-3 && (**d - 0.2).abs() > 1e-3);
        assert!(moved.count() > 10);
        for phases in &answer.trajectory.durations {
            assert!((phases.iter().sum::<f64>() - 2.9).abs() < 1e-9);
            assert!(phases[..18].iter().all(|d| (0.0799..=0.3601).contains(d)), "{phases:?}");
        }
    }

    #[test]
    fn the_contact_implicit_program_finds_a_schedule() {
        let task = scenario("biped", 10);
        let task = Task::new(task.robot.clone(), task.terrain.clone(), Goal::position([1.5, 0., 0.65])).unwrap();
        let answer = Job::new(&task, Program::ContactImplicit(2.), Options { max_seconds: 120., ..Options::BASELINE }).run().unwrap();
        assert!(answer.feasible, "{} violated, status {}", answer.n_violated, answer.statistics.status);
        assert!(answer.trajectory.durations.iter().any(|phases| phases.len() > 1), "no foot was lifted");
        assert_eq!(answer.trajectory.transcription.as_deref(), Some("contact-implicit"));
    }

    #[test]
    fn workers_answer_jobs_in_order() {
        let (task, schedule) = standing();
        let jobs: Vec<Job> = (1..=5)
            .map(|i| Job {
                goal: BaseState::level([0.01 * f64::from(i), 0., 0.65], 0.),
                ..Job::fixed(&task, &schedule, Options::LOWER_LEVEL)
            })
            .collect();
        let seen = Mutex::new(vec![0.; 5]);
        workers(2).solve(&jobs, &|_| false, &|i, answer| seen.lock().unwrap()[i] = answer.trajectory.base_target[0]).unwrap();
        assert_eq!(*seen.lock().unwrap(), [0.01, 0.02, 0.03, 0.04, 0.05]);
    }

    #[test]
    fn a_solve_that_is_no_longer_wanted_ends_with_its_process() {
        let task = scenario("hex", 10);
        let mut random = Random::new(4);
        let hard = Options { max_iterations: 100_000, max_seconds: 600., tolerance: 1e-12, barrier: None };
        let jobs: Vec<Job> = (0..4).map(|_| Job::fixed(&task, &gait(&mut random, 6, 13..=13), hard)).collect();
        // No longer wanted when two of them have run for a while: a solve is asked about before it starts, then every few milliseconds.
        let (asked, finished) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let enough = |_| asked.fetch_add(1, Ordering::Relaxed) > 100;
        let finish = |_, _| _ = finished.fetch_add(1, Ordering::Relaxed);
        workers(2).solve(&jobs, &enough, &finish).unwrap();
        // If their processes went on, all four would finish, after minutes.
        assert!(finished.into_inner() < 4);
    }

    #[test]
    fn a_process_that_is_not_a_worker_is_an_error() {
        let (task, schedule) = standing();
        let jobs = [Job::fixed(&task, &schedule, Options::LOWER_LEVEL)];
        let missing = Workers::new("/nowhere/cregopt".into(), 1).solve(&jobs, &|_| false, &|_, _| ()).unwrap_err();
        assert!(missing.to_string().contains("/nowhere/cregopt"), "{missing}");
        let mute = Workers::new("/bin/true".into(), 1).solve(&jobs, &|_| false, &|_, _| ()).unwrap_err();
        assert!(mute.to_string().contains("without an answer to candidate 0"), "{mute}");
    }

    #[test]
    fn a_worker_answers_nonsense_with_an_error_and_goes_on() {
        let (task, schedule) = standing();
        let mut job = Job::fixed(&task, &schedule, Options::LOWER_LEVEL);
        let good = serde_json::to_string(&job).unwrap();
        job.robot.mass = -1.;
        let input = format!("nonsense\n{}\n{good}\n", serde_json::to_string(&job).unwrap());
        let mut output = Vec::new();
        serve(input.as_bytes(), &mut output).unwrap();
        let output = String::from_utf8(output).unwrap();
        let lines: Vec<&str> = output.lines().collect();
        assert_eq!(lines.len(), 3);
        assert!(lines[0].contains("Err") && lines[1].contains("robot.mass") && lines[2].contains("\"feasible\":true"), "{output}");
    }

    #[test]
    fn evaluate_solves_the_same_lines_with_ipopt() {
        let folder = harness::folder();
        let mut odd = harness::standing();
        odd["durations"] = json!([[0.6], [0.2, 0.1, 0.25], [0.6], [0.6]]);
        odd["note"] = json!("kept");
        harness::write_lines(folder.path(), &[harness::standing().to_string(), odd.to_string()]);
        let command = "evaluate in.jsonl --robot anymal --solver ipopt --threads 2 --out results.jsonl --trajectories motions.jsonl";
        let ran = harness::run(folder.path(), command);
        ran.ends_with(0);
        assert!(ran.stdout.contains("2 of 2 candidates feasible") && ran.stdout.contains("ipopt"), "{}", ran.stdout);
        let results = harness::read_lines(folder.path().join("results.jsonl"));
        assert_eq!((&results[0]["result"]["status"], &results[0]["result"]["transcription"]), (&json!(0), &json!("towr")));
        assert_eq!((&results[1]["note"], &results[1]["result"]["n_violated"]), (&json!("kept"), &json!(0)));
        harness::run(folder.path(), "verify motions.jsonl").ends_with(0);
    }
}
