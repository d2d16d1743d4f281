//! Motions of robots with soles: certified, forged, continued, and their cost.

use crate::common::{Forgery, faults, humanoid, rows, task_for, tilted};
use cregopt::gait::cost::{CostWeights, cost};
use cregopt::gait::family::{GaitFamily, PeriodicGait};
use cregopt::gait::{Curve, Schedule};
use cregopt::nlp::Problem;
use cregopt::refine::check_robot;
use cregopt::robot::{GRAVITY, Robot, Sole};
use cregopt::search::evaluate::{Evaluated, LowerSettings};
use cregopt::settings::Transcription;
use cregopt::solver::objective::Objective;
use cregopt::task::Task;
use cregopt::terrain::{Grid, Shape, Terrain};
use cregopt::{Cpu, Evaluate, Goal, Trajectory, verify};
use std::f64::consts::FRAC_PI_2;

/// Typical gaits swing their feet faster than a sole can bear by default, and the forgeries are written for the nodes of three pieces.
fn lower() -> LowerSettings {
    let mut settings = LowerSettings::default();
    settings.transcription.foot_acceleration = Some(20. * GRAVITY);
    settings.transcription.force_pieces = Some(3);
    settings
}

fn solved(task: &Task, schedule: &Schedule, iterations: usize) -> (Evaluated, Trajectory) {
    let mut settings = lower();
    settings.solver.optimise.iterations = iterations;
    let evaluate = Evaluate::new(task).settings(settings).cost(CostWeights::default());
    let found = evaluate.run(std::slice::from_ref(schedule), &Cpu::new(1).unwrap()).unwrap().remove(0).unwrap();
    let motion = evaluate.trajectory(&found);
    (found, motion)
}

fn typical(family: GaitFamily, task: &Task) -> Schedule {
    PeriodicGait::typical(family, task).unwrap().schedule().unwrap()
}

fn walked() -> (Task, Trajectory) {
    let task = task_for(humanoid(), Terrain::flat(), [0.8, 0.], 0.);
    let (_, motion) = solved(&task, &typical(GaitFamily::Walk, &task), 0);
    (task, motion)
}

fn stood() -> (Task, Trajectory) {
    let task = task_for(humanoid(), Terrain::flat(), [0.03, 0.], 0.);
    let (_, motion) = solved(&task, &Schedule::new(vec![vec![1.]; 2]).unwrap(), 0);
    (task, motion)
}

/// Terrain of strips along x, from their heights across y, m.
fn strips(height: impl Fn(f64) -> f64) -> Terrain {
    let across: Vec<f64> = (0..=800).map(|i| height(f64::from(i) / 200. - 2.)).collect();
    let shape = Shape::Grid(Grid { low: [-3., -2.], high: [3., 2.], heights: vec![across.clone(), across] });
    Terrain { name: "strips".into(), friction: 1., shape }
}

#[test]
fn a_humanoid_stands_walks_steps_aside_turns_and_climbs() {
    let flat = Terrain::flat;
    for (name, terrain, goal, yaw, families) in [
        ("ahead", flat(), [1., 0.], 0., &[GaitFamily::Walk, GaitFamily::Run][..]),
        ("backwards", flat(), [-0.6, 0.], 0., &[GaitFamily::Walk]),
        ("aside", flat(), [0., 0.4], 0., &[GaitFamily::Walk]),
        ("turn", flat(), [0., 0.], FRAC_PI_2, &[GaitFamily::Walk]),
        ("uphill", tilted(), [0.5, 0.], 0., &[GaitFamily::Walk]),
    ] {
        let task = task_for(humanoid(), terrain, goal, yaw);
        for &family in families {
            let (found, motion) = solved(&task, &typical(family, &task), 12);
            assert_eq!(faults(&motion, &task), "", "{name}, {family}: {:?}", found.outcome.status);
            assert!(found.feasible, "{name}, {family}");
            let report = verify(&motion, &task.robot, &task.terrain, motion.force_limit.unwrap()).unwrap();
            assert!(report.rollout.unwrap().attitude.value < 0.5, "{name}, {family}");
            for foot in &motion.ee {
                let (moment, yaws) = (foot.moment.as_ref().unwrap(), foot.yaws.as_ref().unwrap());
                assert!(moment.nodes.iter().any(|node| node[..3].iter().any(|m| m.abs() > 0.5)), "{name}, {family}");
                assert!((yaws[yaws.len() - 1] - yaw).abs() <= 0.5 && yaws[0] == 0., "{name}, {family}: {yaws:?}");
            }
        }
    }
    let (task, motion) = stood();
    assert_eq!(faults(&motion, &task), "");
}

#[test]
fn the_minimised_objective_is_the_cost_of_the_motion() {
    let task = task_for(humanoid(), Terrain::flat(), [0.8, 0.1], 0.4);
    let weights = CostWeights::default();
    let of = |iterations| {
        let (found, motion) = solved(&task, &typical(GaitFamily::Walk, &task), iterations);
        assert!(found.feasible);
        cost(&motion, &task.robot, task.robot.leg_mass(), &weights).unwrap()
    };
    let (first, best) = (of(0), of(20));
    assert!(best.total < 0.9 * first.total, "{} {}", best.total, first.total);
    // The rows add up to the cost; that of the trunk is the trapezoidal rule over the knots.
    let (found, motion) = solved(&task, &typical(GaitFamily::Walk, &task), 0);
    let effort = CostWeights { leg_work: 0., swing_work: 0., joint_excess: 0., ..weights };
    let problem = Problem::<f64>::with_cost(&task, &found.schedule, &lower().transcription, Some(&effort));
    assert!(!problem.goals.is_empty());
    let of_rows = Objective { weight: 1., rounding: 1e-9 }.cost(&problem, &rows(&problem, &found.x, 0.).c);
    let of_motion = cost(&motion, &task.robot, task.robot.leg_mass(), &effort).unwrap().total;
    assert!((of_rows - of_motion).abs() < 2e-3 * of_motion, "{of_rows} by rows, {of_motion}");
    let upright =
        Trajectory { base_ang: Curve { nodes: vec![[0.; 6]; motion.base_ang.nodes.len()], ..motion.base_ang.clone() }, ..motion.clone() };
    let without_trunk = cost(&upright, &task.robot, task.robot.leg_mass(), &effort).unwrap().total;
    assert!(of_motion - without_trunk > 1e-4 * of_motion, "{without_trunk} without the trunk, {of_motion} with it");
    // Without its moments the motion would have a lower effort.
    let mut bare = motion.clone();
    for foot in &mut bare.ee {
        foot.moment.as_mut().unwrap().nodes.iter_mut().for_each(|node| *node = [0.; 6]);
    }
    let half = task.robot.sole.unwrap().half_extents()[0];
    // Integral of the squared moments by Simpson's rule.
    let squares = |curve: &Curve| -> f64 {
        let pieces = curve.nodes.windows(2).zip(&curve.poly_durations);
        let of_piece = |nodes: &[[f64; 6]], length: f64| {
            let at = |u: f64| -> f64 {
                let w = cregopt::gait::spline::hermite(u * length, length);
                let value = |d: usize| w[0] * nodes[0][d] + w[1] * nodes[0][d + 3] + w[2] * nodes[1][d] + w[3] * nodes[1][d + 3];
                (0..3).map(|d| value(d) * value(d)).sum()
            };
            let panel = |i: usize| {
                at(i as f64 / 64.)
                    * if i == 0 || i == 64 {
                        1.
                    } else if i % 2 == 1 {
                        4.
                    } else {
                        2.
                    }
            };
            (0..=64).map(panel).sum::<f64>() * length / 192.
        };
        pieces.map(|(nodes, &length)| of_piece(nodes, length)).sum()
    };
    let moments: f64 = motion.ee.iter().map(|foot| squares(foot.moment.as_ref().unwrap())).sum();
    let effort = |motion: &Trajectory| cost(motion, &task.robot, task.robot.leg_mass(), &weights).unwrap().effort;
    let expected = moments / (half * half) / (task.robot.weight().powi(2) * motion.horizon);
    let difference = effort(&motion) - effort(&bare);
    assert!((difference - expected).abs() < 1e-6 * expected, "{difference} {expected}");
}

/// Adds opposite moments to the feet of a standing robot, at all nodes.
fn twist(motion: &mut Trajectory, moment: [f64; 3]) {
    for (foot, sign) in [(0, 1.), (1, -1.)] {
        for node in &mut motion.ee[foot].moment.as_mut().unwrap().nodes {
            (0..3).for_each(|d| node[d] += sign * moment[d]);
        }
    }
}

fn moment_of(motion: &mut Trajectory, foot: usize) -> &mut Curve {
    motion.ee[foot].moment.as_mut().unwrap()
}

#[test]
fn forged_soles_are_refused() {
    let standing: &[Forgery] = &[
        ("pressure beyond the toe", |m| twist(m, [0., -19., 0.]), "centre of pressure outside the sole"),
        ("pressure beyond the heel", |m| twist(m, [0., 19., 0.]), "centre of pressure outside the sole"),
        ("pressure beyond the side", |m| twist(m, [8., 0., 0.]), "centre of pressure outside the sole"),
        ("torsion beyond friction", |m| twist(m, [0., 0., 20.]), "friction with torsion"),
        ("torsion with the pressure near the toe", |m| twist(m, [0., -15., 6.]), "friction with torsion"),
        (
            "pressure beyond the toe between the nodes",
            |m| {
                for (foot, sign) in [(0, 1.), (1, -1.)] {
                    let curve = moment_of(m, foot);
                    let last = curve.nodes.len() - 1;
                    (curve.nodes[last - 1][4], curve.nodes[last][4]) = (400. * sign, -400. * sign);
                }
            },
            "centre of pressure outside the sole",
        ),
        ("a moment that no row explains", |m| moment_of(m, 0).nodes[1][0] += 3., "mean moment x"),
        ("another yaw at the start", |m| m.ee[0].yaws.as_mut().unwrap()[0] = 0.2, "start yaw of Some(0)"),
        (
            "turned too far from the base",
            |m| (m.ee[0].yaws, m.start_yaws) = (Some(vec![0.6]), Some(vec![0.6, 0.])),
            "sole turned from the base of Some(0)",
        ),
        ("no moment", |m| m.ee[0].moment = None, "ee[0].moment"),
        ("no yaws", |m| m.ee[1].yaws = None, "ee[1].moment"),
        ("a ball instead of a sole", |m| (m.ee[0].moment, m.ee[0].yaws) = (None, None), "ee[0].yaws: absent"),
        ("too many yaws", |m| m.ee[0].yaws = Some(vec![0.; 2]), "ee[0].yaws: 2 yaws"),
        ("yaw is NaN", |m| m.ee[0].yaws = Some(vec![f64::NAN]), "ee[0].yaws[0]"),
        ("moment is NaN", |m| moment_of(m, 1).nodes[1][2] = f64::NAN, "ee[1].moment.nodes[1]"),
        ("yaws of three feet at the start", |m| m.start_yaws = Some(vec![0.; 3]), "start_yaws: 3 feet"),
    ];
    let walking: &[Forgery] = &[
        ("moment at the lift-off", |m| moment_of(m, 0).nodes[3][1] = 2., "moment in swing, y of Some(0)"),
        (
            "moment before the lift-off",
            |m| {
                moment_of(m, 0).poly_durations[2] -= 0.02;
                moment_of(m, 0).poly_durations[3] += 0.02;
            },
            "of Some(0)",
        ),
        ("a foot through the other", |m| m.ee[0].motion.nodes.iter_mut().skip(2).take(1).for_each(|node| node[1] -= 0.2), "soles overlap"),
        ("a sole turned in the air over the other", |m| m.ee[0].yaws.as_mut().unwrap()[1] = FRAC_PI_2, "sole turned from the base"),
    ];
    let mut wrong = Vec::new();
    for ((task, motion), forgeries) in [(stood(), standing), (walked(), walking)] {
        assert_eq!(faults(&motion, &task), "");
        for (name, forge, expected) in forgeries {
            let mut forged = motion.clone();
            forge(&mut forged);
            let faults = faults(&forged, &task);
            if !faults.contains(expected) {
                wrong.push(format!("{name}: `{expected}` is not among\n{faults}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn ground_that_a_sole_does_not_fit_is_refused() {
    let (task, motion) = walked();
    let on = |terrain: Terrain| faults(&motion, &Task { terrain: terrain.into(), ..task.clone() });
    assert_eq!(on(strips(|_| 0.)), "");
    // A ridge under the left side of the left foot, which its centre does not touch.
    let ridge = |high: f64| strips(move |y| if (0.148..0.157).contains(&y) { high } else { 0. });
    let faults = on(ridge(0.02));
    assert!(faults.contains("sole off the ground of Some(0)") || faults.contains("sole in the ground of Some(0)"), "{faults}");
    // 3 mm are less than the certificate allows under a standing sole, but not in a swing.
    assert!(on(ridge(0.003)).contains("sole in the ground of Some(0)"), "{}", on(ridge(0.003)));
    // Soles that would overlap, although the robot's own do not.
    let wide = Robot { sole: Some(Sole { width: 0.26, ..task.robot.sole.unwrap() }), ..(*task.robot).clone() };
    let report = verify(&motion, &wide, &task.terrain, motion.force_limit.unwrap()).unwrap();
    assert!(report.families.iter().any(|f| f.worst.as_ref().is_some_and(|w| w.row == "soles overlap" && w.violation > 0.)));
    // A robot without soles.
    let bare = Robot { sole: None, ..(*task.robot).clone() };
    let error = verify(&motion, &bare, &task.terrain, motion.force_limit.unwrap()).unwrap_err().to_string();
    assert!(error.contains("ee[0].yaws: present") && error.contains("no soles"), "{error}");
}

#[test]
fn a_motion_is_read_back_and_continued_with_the_yaws_of_its_soles() {
    let task = task_for(humanoid(), Terrain::flat(), [0.3, 0.1], 0.7);
    let (_, motion) = solved(&task, &typical(GaitFamily::Walk, &task), 0);
    let back = Trajectory::from_json(&serde_json::to_string(&motion).unwrap()).unwrap();
    assert_eq!(back, motion);
    let ends = motion.end_yaws().unwrap();
    assert_ne!(ends, [0.7; 2]);
    let next = task.after(&motion).unwrap().to(Goal::at(0.8, 0.3).yaw(0.7)).unwrap();
    assert_eq!(next.start_yaws, ends);
    let (found, motion) = solved(&next, &typical(GaitFamily::Walk, &next), 0);
    assert!(found.feasible);
    assert_eq!(motion.start_yaws, Some(ends.clone()));
    assert_eq!(motion.ee.iter().map(|foot| foot.yaws.as_ref().unwrap()[0]).collect::<Vec<_>>(), ends);
    assert_eq!(faults(&motion, &next), "");
}

#[test]
fn what_soles_cannot_do_is_refused_with_its_place() {
    let task = task_for(humanoid(), Terrain::flat(), [0.3, 0.], 0.);
    let mut settings = LowerSettings::default();
    settings.transcription = cregopt::settings::TranscriptionSettings::of(Transcription::Towr);
    let schedule = typical(GaitFamily::Walk, &task);
    let towr = Evaluate::new(&task).settings(settings).run(&[schedule], &Cpu::new(1).unwrap());
    assert!(towr.err().unwrap().to_string().contains("robot.sole"));
    assert!(check_robot(&task.robot).unwrap_err().to_string().starts_with("robot.sole"));
    for (sole, place) in [
        (Sole { length: 0., width: 0.1, turn: 0.4 }, "robot.sole.length"),
        (Sole { length: 0.2, width: f64::NAN, turn: 0.4 }, "robot.sole.width"),
        (Sole { length: 0.2, width: 0.1, turn: 2. }, "robot.sole.turn"),
    ] {
        let error = Robot { sole: Some(sole), ..humanoid() }.validate().unwrap_err().to_string();
        assert!(error.starts_with(place), "{error}");
    }
    let error = Robot { foot_radius: Some(0.02), ..humanoid() }.validate().unwrap_err().to_string();
    assert!(error.starts_with("robot.foot_radius"), "{error}");
}
