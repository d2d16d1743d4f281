//! Motions that start and end anywhere: in mid-stride, with feet in the air, at any velocity.

use crate::common::{Forgery, faults, rows, trot, trotting};
use cregopt::gait::cost::{CostWeights, cost};
use cregopt::gait::trajectory::GoalVelocity;
use cregopt::gait::{Curve, FootCurves, Schedule};
use cregopt::nlp::Problem;
use cregopt::nlp::transcription::interval;
use cregopt::robot::GRAVITY;
use cregopt::search::evaluate::{Evaluated, LowerSettings};
use cregopt::solver::Status;
use cregopt::solver::objective::Objective;
use cregopt::task::{SwingState, Task};
use cregopt::{Cpu, Evaluate, Trajectory, verify};

fn settings(iterations: usize) -> LowerSettings {
    let mut settings = LowerSettings::default();
    settings.transcription.goal_velocity = GoalVelocity::Near;
    settings.solver.optimise.iterations = iterations;
    settings
}

fn solved(task: &Task, schedule: &Schedule, iterations: usize) -> (Evaluated, Trajectory) {
    let evaluate = Evaluate::new(task).settings(settings(iterations)).cost(CostWeights::default());
    let found = evaluate.run(std::slice::from_ref(schedule), &Cpu::new(1).unwrap()).unwrap().remove(0).unwrap();
    let motion = evaluate.trajectory(&found);
    (found, motion)
}

#[test]
fn a_motion_starts_and_ends_with_feet_in_the_air() {
    for since in [0.03, 0.1, 0.15] {
        let task = trotting(since);
        let (found, motion) = solved(&task, &trot(), 12);
        let report = verify(&motion, &task.robot, &task.terrain, motion.force_limit.unwrap()).unwrap();
        assert!(found.feasible && report.rows.feasible, "{since}: {report:#?}");
        // The foot continues from its state, and is in the air at the end.
        let feet = &motion.ee[1].motion;
        let state = task.start_swings[1].unwrap();
        assert_eq!((feet.nodes[0][..3].to_vec(), feet.nodes[0][3..].to_vec()), (state.position.to_vec(), state.velocity.to_vec()));
        let end = motion.end_swings();
        assert!(end[1].is_some_and(|s| s.position[2] > 0.001 && (s.since - 0.25).abs() < 1e-9), "{end:?}");
        assert!(end[0].is_none());
        // The cost draws the base to the goal.
        let goal = motion.end_state();
        assert!((goal.position[0] - 0.4).abs() < 0.03 && (goal.velocity[0] - 0.5).abs() < 0.15, "{goal:?}");
    }
}

#[test]
fn swings_that_had_begun_before_keep_the_limits_of_their_feet() {
    let mut held = 0;
    for landing in [0.03, 0.05, 0.08, 0.15] {
        for (speed, up) in [(0.5, 0.), (1.5, 0.3), (2.5, 0.), (3., -0.3), (3.5, 0.2), (4., 0.)] {
            let (mut task, mut durations) = (trotting(0.2), trot().durations().to_vec());
            for foot in [1, 2] {
                let state = task.start_swings[foot].as_mut().unwrap();
                (state.position[2], state.velocity) = (0.01, [speed, 0.1 * speed, up]);
                let earlier = durations[foot][1] - landing;
                durations[foot][1] = landing;
                durations[foot][2] += earlier;
            }
            let (found, motion) = solved(&task, &Schedule::new(durations).unwrap(), 0);
            if found.outcome.status == Status::Solved {
                held += 1;
                let report = verify(&motion, &task.robot, &task.terrain, motion.force_limit.unwrap()).unwrap();
                let swings = report.rows.families.iter().find(|f| f.family.name() == "swing").unwrap();
                assert_eq!(swings.violated, 0, "{landing} s, {speed} m/s: {swings:?}");
            }
        }
    }
    assert!(held >= 20, "{held} of 24");
}

/// Changes the state of foot 1 at the start, in the task and in the curve.
fn start_of_foot_1(motion: &mut Trajectory, change: fn(&mut SwingState)) {
    let state = motion.start_swings.as_mut().unwrap()[1].as_mut().unwrap();
    change(state);
    let ([x, y, z], [vx, vy, vz]) = (state.position, state.velocity);
    motion.ee[1].motion.nodes[0] = [x, y, z, vx, vy, vz];
}

/// Removes the limit of acceleration, which hides smaller faults of the same family.
fn without_acceleration(motion: &mut Trajectory) {
    motion.limits.as_mut().unwrap().foot_acceleration = None;
}

#[test]
fn forged_motions_in_mid_stride_are_refused() {
    // In one the feet in the air rise, in the other they only descend.
    let rises: &[Forgery] = &[
        ("mid node below the ground", |m| m.ee[1].motion.nodes[1][2] = -0.02, "mid node too low"),
        (
            "mid node too high",
            |m| {
                without_acceleration(m);
                m.ee[1].motion.nodes[1][2] = 0.3
            },
            "mid node too high of Some(1)",
        ),
        (
            "it dips before it rises",
            |m| {
                without_acceleration(m);
                start_of_foot_1(m, |s| s.velocity[2] = -12.)
            },
            "foot below terrain",
        ),
    ];
    let descends: &[Forgery] = &[
        ("it dips into the ground", |m| start_of_foot_1(m, |s| s.velocity[2] = -3.), "foot below terrain"),
        ("most of the swing is ahead", |m| m.start_swings.as_mut().unwrap()[1].as_mut().unwrap().since = 0., "mid node too low"),
    ];
    let both: &[Forgery] = &[
        ("start position, curve", |m| m.ee[1].motion.nodes[0][0] += 0.01, "start position x of Some(1)"),
        (
            "start position, state",
            |m| m.start_swings.as_mut().unwrap()[1].as_mut().unwrap().position[2] += 0.01,
            "start position z of Some(1)",
        ),
        ("start velocity, curve", |m| m.ee[1].motion.nodes[0][3] += 0.1, "start velocity x of Some(1)"),
        (
            "start velocity, state",
            |m| m.start_swings.as_mut().unwrap()[2].as_mut().unwrap().velocity[1] -= 0.1,
            "start velocity y of Some(2)",
        ),
        ("no states", |m| m.start_swings = None, "start_swings[1]"),
        ("a state is missing", |m| m.start_swings.as_mut().unwrap()[2] = None, "start_swings[2]"),
        ("state of a standing foot", |m| m.start_swings.as_mut().unwrap().swap(0, 1), "start_swings[0]"),
        ("states of three feet", |m| m.start_swings.as_mut().unwrap().truncate(3), "start_swings: 3 feet"),
        (
            "position is NaN",
            |m| m.start_swings.as_mut().unwrap()[1].as_mut().unwrap().position[0] = f64::NAN,
            "start_swings[1].position[0]",
        ),
        ("force at the start of the swing", |m| m.ee[1].force.nodes[0][2] = 20., "force in swing, z of Some(1)"),
        ("force before the touchdown", |m| m.ee[1].force.nodes[1][2] = 20., "force in swing, z of Some(1)"),
        ("force at the end of the last swing", |m| m.ee[1].force.nodes.last_mut().unwrap()[2] = 20., "force in swing, z of Some(1)"),
        ("the end is not free", |m| m.limits.as_mut().unwrap().goal_velocity = GoalVelocity::Zero, "final"),
        ("the pose at the end is not free", |m| m.limits.as_mut().unwrap().goal_velocity = GoalVelocity::Free, "final"),
        ("another transcription", |m| m.transcription = Some("towr".into()), "final position"),
        ("no limits", |m| m.limits = None, "final"),
        ("the first swing lasts longer", |m| (m.durations[1][1], m.durations[1][2]) = (0.2, 0.35), "node at phase boundary of Some(1)"),
        ("it lands later", |m| (m.durations[1][3], m.durations[1][4]) = (0.35, -0.1), "of Some(1)"),
        ("it lands earlier", |m| (m.durations[1][3], m.durations[1][4]) = (0.27, -0.02), "touchdown"),
        ("it stands at the end", |m| (m.durations[1][3], m.durations[1][4]) = (0.2, 0.05), "of Some(1)"),
        (
            "it stands at the start",
            |m| {
                m.durations[1][0] = 0.55;
                m.durations[1].drain(1..3);
                m.start_swings.as_mut().unwrap()[1] = None
            },
            "of Some(1)",
        ),
        (
            "the last swing ends above the ground",
            |m| m.ee[1].motion.nodes.iter_mut().rev().take(2).for_each(|n| n[2] += 0.5),
            "touchdown z of Some(1)",
        ),
        (
            "the last swing is too high",
            |m| {
                without_acceleration(m);
                m.ee[1].motion.nodes.iter_mut().rev().take(2).for_each(|n| (n[2], n[5]) = (8. * n[2], 8. * n[5]));
            },
            "mid node too high of Some(1)",
        ),
        ("faster than its limit", |m| m.limits.as_mut().unwrap().foot_speed = 0.5, "foot too fast"),
        ("thrown", |m| start_of_foot_1(m, |s| s.velocity[0] = 30.), "foot accelerated too hard of Some(1)"),
    ];
    let mut wrong = Vec::new();
    for (since, own) in [(0.03, rises), (0.1, descends)] {
        let task = trotting(since);
        let (_, motion) = solved(&task, &trot(), 12);
        assert_eq!(faults(&motion, &task), "", "{since}");
        for (name, forge, expected) in both.iter().chain(own) {
            let mut forged = motion.clone();
            forge(&mut forged);
            assert!(forged != motion, "{name} changes nothing");
            let faults = faults(&forged, &task);
            if !faults.contains(expected) {
                wrong.push(format!("{since}, {name}: `{expected}` is not among\n{faults}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_motion_in_mid_stride_is_read_back_and_continued() {
    let task = trotting(0.1);
    let (_, motion) = solved(&task, &trot(), 12);
    let text = serde_json::to_string(&motion).unwrap();
    let back = Trajectory::from_json(&text).unwrap();
    assert!(text.contains("start_swings") && text.contains("\"near\""));
    assert_eq!(back, motion);
    assert_eq!(faults(&back, &task), "");
    let mut goal = motion.end_state();
    goal.position[0] += 0.3;
    let next = Task { goal, ..task.after(&motion).unwrap() };
    assert_eq!((next.start, &next.start_swings), (motion.end_state(), &motion.end_swings()));
    assert_eq!(next.start_feet, motion.end_feet());
    // The feet land when the schedule before had them land.
    let schedule = Schedule::new(vec![vec![0.1, 0.25, 0.25], vec![0., 0.05, 0.55], vec![0., 0.05, 0.55], vec![0.1, 0.25, 0.25]]).unwrap();
    let (found, further) = solved(&next, &schedule, 12);
    assert!(found.feasible, "{}", faults(&further, &next));
    for foot in 0..4 {
        let [end, start] = [&motion, &further].map(|m| &m.ee[foot].motion.nodes);
        assert_eq!(end[end.len() - 1], start[0]);
    }
}

/// Weight of one term of the cost.
fn one_term(term: usize) -> CostWeights {
    let w = |of: usize| if of == term { 1. } else { 0. };
    CostWeights { leg_work: w(0), swing_work: w(1), effort: w(2), joint_excess: 0. }
}

#[test]
fn cost_rows_in_mid_stride_add_up_to_the_cost_of_the_motion() {
    for since in [0.03, 0.1] {
        let task = trotting(since);
        let (found, motion) = solved(&task, &trot(), 12);
        let objective = Objective { weight: 1., rounding: 1e-9 };
        let cost_of = |weights: &CostWeights| cost(&motion, &task.robot, task.robot.leg_mass(), weights).unwrap();
        let speed = (GRAVITY * task.robot.base_height).sqrt();
        // The rows of a motion with a free end are per 0.3 sqrt(g l) times the horizon.
        let distance = 0.3 * speed * motion.horizon;
        let with = |weights: &CostWeights| Problem::<f64>::with_cost(&task, &found.schedule, &settings(0).transcription, Some(weights));
        let rows_of = |problem: &Problem<f64>| {
            let c = rows(problem, &found.x, 0.).c;
            let goal: f64 = problem.goals.iter().flat_map(|g| &c[g.place.row as usize..][..6]).map(|r| r * r / 2.).sum();
            [objective.cost(problem, &c) - goal, goal]
        };
        for term in 0..3 {
            let weights = one_term(term);
            let (of_motion, [of_rows, _]) = (cost_of(&weights), rows_of(&with(&weights)));
            let expected = of_motion.total * of_motion.distance / distance;
            // Two quadratures of absolute values; the effort is exact.
            let tolerance = [0.03, 0.03, 1e-6][term];
            assert!(
                expected > 1e-3 && (of_rows - expected).abs() < tolerance * expected,
                "{since}, {weights:?}: {of_rows} by rows, {expected}"
            );
        }
        // Distance from the goal, and that of the rates at the knots from their approach to the goal.
        let [_, goal] = rows_of(&with(&CostWeights::default()));
        let l = task.robot.base_height;
        let square = |a: [f64; 6], b: [f64; 6], linear: f64, angular: f64| -> f64 {
            (0..6).map(|i| ((a[i] - b[i]) / if i < 3 { linear } else { angular }).powi(2)).sum()
        };
        let (start, to) = (task.start.rate(), task.goal.rate());
        let mut expected = 40. * square(motion.end_state().pose(), task.goal.pose(), l, 1.);
        let interval = interval(&settings(0).transcription, &task.robot);
        let knots = (motion.horizon / interval).round() as usize;
        for knot in 1..=knots {
            let t = knot as f64 * interval;
            let rate = rate_at(&motion, t);
            let wanted = std::array::from_fn(|i| to[i] + (-t / 0.15_f64).exp() * (start[i] - to[i]));
            expected += 400. / knots as f64 * square(rate, wanted, speed, speed / l / 2.);
        }
        assert!(expected > 1e-4 && (goal - expected).abs() < 1e-9 + 1e-6 * expected, "{since}: {goal} by rows, {expected}");
    }
}

/// Velocity and angle rates of the base at a node of its curves.
fn rate_at(motion: &Trajectory, time: f64) -> [f64; 6] {
    let at = |curve: &Curve| {
        let mut end = 0.;
        let before = curve
            .poly_durations
            .iter()
            .take_while(|&&d| {
                end += d;
                end < time + 1e-9
            })
            .count();
        curve.nodes[before]
    };
    let (lin, ang) = (at(&motion.base_lin), at(&motion.base_ang));
    [lin[3], lin[4], lin[5], ang[3], ang[4], ang[5]]
}

#[test]
fn a_swing_through_the_whole_motion_keeps_its_lift_off() {
    let still = |node: [f64; 6]| Curve { poly_durations: vec![0.8], nodes: vec![node; 2] };
    let foot = || FootCurves::new(still([0., 0., 0.1, 0., 0., 0.]), still([0.; 6]));
    let durations = vec![vec![0., 0.9, -0.1], vec![0.8]];
    let mut motion = Trajectory::new(durations, 0.8, [still([0.; 6]), still([0.; 6])], vec![foot(), foot()]);
    motion.start_swings = Some(vec![Some(SwingState { position: [0., 0., 0.1], velocity: [0.; 3], since: 0.2 }), None]);
    motion.validate().unwrap();
    let end = motion.end_swings();
    assert!(end[0].is_some_and(|state| (state.since - 1.).abs() < 1e-12) && end[1].is_none(), "{end:?}");
}
