//! The `momentum` transcription: invariance to the position of the scene, motion between knots, exact integrals.

use crate::common::{Random, gait, jointed, point, problem, problem_with, rows_with, shared, soled, task, task_for};
use cregopt::gait::spline::hermite;
use cregopt::gait::{Schedule, Trajectory};
use cregopt::nlp::{Problem, trajectory};
use cregopt::robot::Robot;
use cregopt::rows::Family;
use cregopt::rows::momentum::{INNER_POINTS, MOMENTUM_POINTS};
use cregopt::rows::table::NONE;
use cregopt::settings::{Friction, SolverSettings, TranscriptionSettings};
use cregopt::solver::{Finish, Outcome, Solver, Status};
use cregopt::task::{Goal, Task};
use cregopt::terrain::{Grid, Shape, Terrain};
use nalgebra::Vector3;
use std::f64::consts::FRAC_PI_2;

/// Tolerance of rows and deviations of a moved scene, relative to the larger of 1 and the value. Positions of some metres are off by
/// 1e-15, which rows multiply by 10; the rest are sums of some hundred terms.
const MOVED_TOLERANCE: f64 = 1e-12;

/// Tolerance of solutions from moved starts, in the units of the variables: the row errors after ten iterations whose systems are solved
/// to 1e-9 of a step.
const SOLUTION_TOLERANCE: f64 = 1e-10;

/// Largest error of the base between knots, m and rad: reach rows against the integrated forces. A stance of 0.08 s has three force cubics
/// in less than an interval, and the deviations are one polynomial over the interval; the angles also take the rotation to second order
/// only.
const BETWEEN_TOLERANCE: [f64; 2] = [3e-4, 2e-3];

/// Largest error of the base between knots, m and rad, when every force cubic lasts longer than an interval.
const SMOOTH_TOLERANCE: [f64; 2] = [2e-6, 1e-4];

/// Least ratio of the error of the plain cubics to that of the reach rows.
const BENT: f64 = 5.;

/// Error of integrals per unit of the time that they cover: Simpson's rule with 256 panels on polynomials of degree 5.
const INTEGRAL_TOLERANCE: f64 = 1e-11;

/// Error of the moments of a quadrature rule on (0, 1): a few roundings.
const RULE_TOLERANCE: f64 = 1e-14;

/// Tangential force beyond the friction cone, N: the residual that the solver leaves in a row, and rounding.
const SLIP_TOLERANCE: f64 = 3e-5;

/// Transformation of the whole scene: rotation about the vertical through the origin, then translation.
#[derive(Debug, Clone, Copy)]
struct Move {
    yaw: f64,
    by: [f64; 2],
}

impl Move {
    fn turned(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.yaw.sin_cos();
        [cos * x - sin * y, sin * x + cos * y]
    }

    fn shifted(&self, at: [f64; 2]) -> [f64; 2] {
        let [x, y] = self.turned(at);
        [x + self.by[0], y + self.by[1]]
    }

    /// The point after the transformation, fixed values included.
    fn point(&self, problem: &Problem<f64>, x: &[f64]) -> Vec<f64> {
        let mut moved = vec![f64::NAN; x.len()];
        let knots =
            problem.momentum_intervals.iter().map(|i| i.reference[0]).chain(problem.momentum_intervals.last().map(|i| i.reference[1]));
        for (knot, line) in problem.curves.base.chunks(2).zip(knots) {
            // Deviations from the pose and the rate of the reference line.
            for (&at, line, rate) in [(&knot[0], line, false), (&knot[1], problem.momentum_intervals[0].rate, true)] {
                let at = at as usize;
                let mut value: [f64; 6] = std::array::from_fn(|d| line[d] + x[at + d]);
                let xy = [value[0], value[1]];
                [value[0], value[1]] = if rate { self.turned(xy) } else { self.shifted(xy) };
                value[5] += if rate { 0. } else { self.yaw };
                (0..6).for_each(|d| moved[at + d] = value[d] - line[d]);
            }
        }
        for foot in &problem.curves.feet {
            for at in foot.footholds.iter().map(|&at| at as usize) {
                moved[at..at + 2].copy_from_slice(&self.shifted([x[at], x[at + 1]]));
            }
            for at in foot.heights.iter().map(|&at| at as usize) {
                moved[at] = x[at];
            }
            let nodes = foot.force_nodes.iter().chain(&foot.moment_nodes).flatten();
            for at in nodes.filter(|&&at| at != NONE).flat_map(|&at| [at as usize, at as usize + 3]) {
                moved[at..at + 2].copy_from_slice(&self.turned([x[at], x[at + 1]]));
                moved[at + 2] = x[at + 2];
            }
            for at in foot.yaws.iter().map(|&at| at as usize) {
                moved[at] = x[at] + self.yaw;
            }
        }
        assert!(moved.iter().all(|v| v.is_finite()), "everything is moved");
        moved
    }
}

/// Scene on flat ground with a random gait.
fn scene(robot: &str, random: &mut Random, stances: std::ops::RangeInclusive<usize>) -> (Task, Schedule) {
    let goal = [random.between(0.3, 2.), random.between(-0.5, 0.5)];
    let (name, change): (&str, fn(Robot) -> Robot) = match robot.split_once(" with ") {
        Some((name, "soles")) => (name, soled),
        Some((name, _)) => (name, jointed),
        None => (robot, |robot| robot),
    };
    let robot = change(Robot::named(name).unwrap());
    let task = task_for(robot, Terrain::flat(), goal, random.between(-1., 1.));
    let schedule = gait(random, task.robot.feet(), stances);
    (task, schedule)
}

#[track_caller]
fn assert_close(got: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    assert_eq!(got.len(), expected.len());
    for (i, (a, b)) in got.iter().zip(expected).enumerate() {
        assert!((a - b).abs() <= tolerance * b.abs().max(1.), "{what} {i}: {a} against {b}");
    }
}

#[test]
fn moving_and_yawing_the_scene_moves_the_rows_with_it() {
    let mut random = Random::new(21);
    for (robot, round) in ["anymal", "anymal with joints", "biped", "biped with soles", "pexod"]
        .into_iter()
        .flat_map(|robot| (0..4).map(move |round| (robot, round)))
    {
        let (task, schedule) = scene(robot, &mut random, 2..=6);
        let friction = Some(if round < 2 { Friction::Pyramid } else { Friction::Cone });
        let problem = problem_with::<f64>(&task, &schedule, &TranscriptionSettings { friction, ..TranscriptionSettings::default() });
        let x = point(&problem, &mut random, 0.);
        let quarter = round % 2 == 0;
        let yaw = if quarter { FRAC_PI_2 } else { random.between(-3., 3.) };
        let scene = Move { yaw, by: [random.between(-3., 3.), random.between(-3., 3.)] };
        let (mut here, mut there) = (shared(&problem), shared(&problem));
        let rows = rows_with(&problem, &x, 0., &mut here);
        let moved = rows_with(&problem, &scene.point(&problem, &x), 0., &mut there);
        assert!(!there.frozen);
        let turned = |v: &[f64]| {
            let [x, y] = scene.turned([v[0], v[1]]);
            [x, y, v[2]]
        };
        for element in problem.all_elements() {
            let (row, at) = (element.place.row as usize, element.place.inequality as usize);
            let sides = (element.rows + element.pairs) as usize;
            let name = format!("{robot} {scene:?} {:?}", element.family);
            match element.family {
                Family::LinearMomentum | Family::AngularMomentum => {
                    let expected = [turned(&rows.c[row..]), turned(&rows.c[row + 3..])].concat();
                    assert_close(&moved.c[row..row + 6], &expected, MOVED_TOLERANCE, &name)
                }
                Family::Reach | Family::Swing | Family::Stride | Family::Acceleration | Family::Sole | Family::Turn => {
                    assert_close(&moved.g[at..at + sides], &rows.g[at..at + sides], MOVED_TOLERANCE, &name)
                }
                Family::StancePower | Family::SwingPower | Family::JointTorque | Family::JointSpeed => {
                    let rows_of = row..row + element.rows as usize;
                    assert_close(&moved.c[rows_of.clone()], &rows.c[rows_of], MOVED_TOLERANCE, &name)
                }
                // Both rows of x, of y, of z.
                Family::Effort => {
                    for r in 0..2 {
                        let axes = |c: &[f64]| [0, 2, 4].map(|d| c[row + d + r]);
                        assert_close(&axes(&moved.c), &turned(&axes(&rows.c)), MOVED_TOLERANCE, &name)
                    }
                }
                // The pyramid stays aligned with the world axes: its sides only map to each other after a quarter turn.
                Family::Force if quarter => {
                    let expected = [0, 4, 3, 1, 2, 5].map(|r| rows.g[at + r]);
                    assert_close(&moved.g[at..at + 6], &expected, MOVED_TOLERANCE, &name)
                }
                Family::Force => {
                    let normal = |g: &[f64]| [g[at], g[at + 5]];
                    assert_close(&normal(&moved.g), &normal(&rows.g), MOVED_TOLERANCE, &name)
                }
                // A cone has no axes.
                Family::Cone => assert_close(&moved.g[at..at + 3], &rows.g[at..at + 3], MOVED_TOLERANCE, &name),
                Family::Dynamics | Family::Footing | Family::Periodic | Family::ConeCurvature | Family::Goal => {
                    unreachable!("flat ground, fixed goal")
                }
            }
        }
        let mut largest = 0_f64;
        for (here, there) in here.deviations.iter().zip(&there.deviations) {
            for (here, there) in here.pose.iter().zip(&there.pose) {
                let expected = [turned(&here[..3]), [here[3], here[4], here[5]]].concat();
                assert_close(there, &expected, MOVED_TOLERANCE, "deviation");
                largest = largest.max(here[3].abs());
            }
            assert_close(&there.mean, &turned(&here.mean), MOVED_TOLERANCE, "deviation of the mean");
        }
        assert!(largest > 1e-3, "there are deviations: {largest} rad");
    }
}

fn solve(problem: &Problem<f64>, settings: &SolverSettings) -> (Outcome, Vec<f64>) {
    let mut solver = Solver::<f64>::default();
    let outcome = solver.solve(problem, settings, Finish::Rows(settings.row_tolerance), None, &|| false);
    (outcome, solver.solution())
}

#[test]
fn the_whole_solve_moves_with_the_scene() {
    let scene = Move { yaw: FRAC_PI_2, by: [0.7, -1.3] };
    // The solve closes from near the solution: a last step of decimetres, whose system is solved to 1e-9 of it, would hide finer
    // differences.
    let settings = SolverSettings { closing: 1e-6, ..SolverSettings::default() };
    for seed in 0..4 {
        let task = task("biped", "flat", [0.5, 0.1], 0.2);
        let mut problem = problem::<f64>(&task, &gait(&mut Random::new(seed), 2, 4..=6));
        let (here, solution) = solve(&problem, &settings);
        problem.initial = scene.point(&problem, &problem.initial);
        let (there, moved) = solve(&problem, &settings);
        assert_eq!([here.status, there.status], [Status::Solved; 2]);
        assert!(here.iterations > 4);
        assert_eq!((here.iterations, here.factorisations), (there.iterations, there.factorisations));
        assert_close(&moved, &scene.point(&problem, &solution), SOLUTION_TOLERANCE, &format!("gait {seed}"));
    }
}

/// Largest distance of the base from its nodes between knots, m and rad: as the reach rows evaluate it, and by its plain cubics.
fn between_knots(task: &Task, schedule: &Schedule) -> [[f64; 2]; 2] {
    let problem =
        problem_with::<f64>(task, schedule, &TranscriptionSettings { friction: Some(Friction::Pyramid), ..crate::common::momentum() });
    let (outcome, x) = solve(&problem, &SolverSettings::default());
    assert_eq!(outcome.status, Status::Solved);
    let mut shared = shared(&problem);
    rows_with(&problem, &x, 0., &mut shared);
    let nodes = trajectory(task, &problem.curves, &x);
    // Rows that contain all feet are at the times of the nodes.
    let feet = task.robot.feet();
    let instants = problem.reach_instants.iter().zip(&problem.reach_rows.instants);
    let instants: Vec<_> = instants.filter(|(_, factored)| factored.elements.range().len() == feet).collect();
    assert_eq!(instants.len(), nodes.base_lin.nodes.len());
    assert!(instants.len() > 2 * problem.curves.intervals);
    let mut farthest = [[0_f64; 2]; 2];
    for ((instant, factored), (lin, ang)) in instants.iter().zip(nodes.base_lin.nodes.iter().zip(&nodes.base_ang.nodes)) {
        let blocks = problem.reach_rows.blocks_of(factored);
        let deviation = &shared.deviations[blocks.interval as usize];
        for d in 0..6 {
            let cubic = instant.reference[d] + (0..4).map(|i| factored.weights[i] * x[blocks.variable[i] as usize + d]).sum::<f64>();
            let bent = cubic + (0..INNER_POINTS).map(|q| instant.deviation_weights[q] * deviation.pose[q][d]).sum::<f64>();
            let node = [&lin[..3], &ang[..3]][d / 3][d % 3];
            for (farthest, pose) in farthest.iter_mut().zip([bent, cubic]) {
                farthest[d / 3] = farthest[d / 3].max((pose - node).abs());
            }
        }
    }
    farthest
}

#[test]
fn between_knots_the_base_follows_the_forces() {
    let walk = task("anymal", "flat", [1.5, 0.2], 0.3);
    let mut cases: Vec<_> = (0..5).map(|seed| (walk.clone(), gait(&mut Random::new(seed), 4, 6..=8), BETWEEN_TOLERANCE)).collect();
    let trot = [[0.5, 0.25, 0.75, 0.25, 0.35], [0.6, 0.25, 0.4, 0.25, 0.6]];
    let trot = Schedule::new([0, 1, 1, 0].map(|pair| trot[pair].to_vec()).to_vec()).unwrap();
    cases.push((task("anymal", "flat", [0.6, 0.1], 0.2), trot, SMOOTH_TOLERANCE));
    for (task, schedule, tolerance) in cases {
        let [bent, cubic] = between_knots(&task, &schedule);
        for i in 0..2 {
            assert!(bent[i] <= tolerance[i] && cubic[i] >= BENT * bent[i], "{bent:?} against {cubic:?}");
        }
    }
}

/// Integral by Simpson's rule.
fn integral(low: f64, high: f64, f: impl Fn(f64) -> f64) -> f64 {
    const PANELS: usize = 256;
    let part = |i: usize| f(low + (high - low) * i as f64 / (2 * PANELS) as f64) * if i % 2 == 1 { 4. } else { 2. };
    (f(low) + f(high) + (1..2 * PANELS).map(part).sum::<f64>()) * (high - low) / (6 * PANELS) as f64
}

#[test]
fn integrals_of_force_nodes_are_exact() {
    let mut random = Random::new(23);
    let (task, schedule) = scene("biped", &mut random, 3..=4);
    let problem = problem::<f64>(&task, &schedule);
    let h = problem.curves.interval;
    for (k, interval) in problem.momentum_intervals.iter().enumerate() {
        let start = k as f64 * h;
        let impulses = &problem.impulses[interval.impulses.range()];
        let mut at_work = 0;
        let stances = problem.curves.feet.iter().flat_map(|f| f.force_nodes.iter().zip(f.phases.iter().step_by(2)).zip(&f.footholds));
        for ((nodes, span), foothold) in stances {
            let piece = span.duration() / (nodes.len() - 1) as f64;
            for (i, &node) in nodes.iter().enumerate().filter(|n| *n.1 != NONE) {
                let middle = span.start + i as f64 * piece;
                let (low, high) = ((middle - piece).max(span.start), (middle + piece).min(span.end));
                let Some(impulse) = impulses.iter().find(|impulse| impulse.node == node) else {
                    assert!(high < start + 1e-8 || low > start + h - 1e-8, "node {i} of a stance from {} s", span.start);
                    continue;
                };
                at_work += 1;
                assert_eq!(problem.footholds[impulse.foothold as usize], *foothold);
                // Value 1 and slope 0 at its own time, or value 0 and slope 1 (slopes per piece); 0 at the neighbouring nodes.
                let basis: [&dyn Fn(f64) -> f64; 2] =
                    [&|u: f64| (1. - u.abs()).powi(2) * (1. + 2. * u.abs()), &|u: f64| u * (1. - u.abs()).powi(2)];
                for q in 0..MOMENTUM_POINTS {
                    let time = problem.momentum_points[q].time;
                    let end = start + time;
                    for order in 0..3 {
                        let kernel = |s: f64| [1., end - s, (end - s).powi(2) / 2.][order];
                        let unit = time.powi(order as i32 + 1);
                        for (part, basis) in basis.iter().enumerate() {
                            let half =
                                |a: f64, b: f64| if a < b { integral(a, b, |s| kernel(s) * basis((s - middle) / piece)) } else { 0. };
                            let (low, high) = (low.max(start), high.min(end));
                            let expected = (half(low, middle.min(high)) + half(middle.max(low), high)) / unit;
                            let got = impulse.weights[q][order][part] / (problem.constants.force_unit * unit);
                            let what = format!("interval {k}, node {i}, point {q}, order {order}, part {part}");
                            assert_close(&[got], &[expected], INTEGRAL_TOLERANCE, &what);
                        }
                    }
                }
            }
        }
        assert_eq!(at_work, impulses.len(), "every impulse is one of a node");
    }
}

#[test]
fn the_rule_inside_intervals_is_exact_for_polynomials() {
    let (task, schedule) = scene("anymal", &mut Random::new(24), 2..=3);
    let problem = problem::<f64>(&task, &schedule);
    let (h, points) = (problem.curves.interval, &problem.momentum_points);
    let inner = points[..INNER_POINTS].iter();
    assert_eq!((points[INNER_POINTS].time, points[INNER_POINTS].mean), (h, 0.));
    for degree in 0..=11 {
        let mean = inner.clone().map(|p| p.mean * (p.time / h).powi(degree)).sum::<f64>();
        assert_close(&[mean], &[1. / f64::from(degree + 1)], RULE_TOLERANCE, &format!("mean of degree {degree}"));
    }
    for (q, to) in points.iter().enumerate() {
        for degree in 0..=5 {
            let got = inner.clone().zip(&to.integral).map(|(p, w)| w / h * (p.time / h).powi(degree)).sum::<f64>();
            let expected = (to.time / h).powi(degree + 1) / f64::from(degree + 1);
            assert_close(&[got], &[expected], RULE_TOLERANCE, &format!("integral of degree {degree} to point {q}"));
        }
    }
}

/// Largest tangential force beyond the friction cones of the ground under the feet, N: `|t| - mu n.f` at many times of every stance.
fn out_of_the_cone(task: &Task, nodes: &Trajectory) -> f64 {
    const TIMES: usize = 50;
    let mut farthest = f64::NEG_INFINITY;
    for (foot, durations) in nodes.ee.iter().zip(&nodes.durations) {
        let stances = durations.len().div_ceil(2);
        let pieces = foot.force.nodes.len() / stances - 1;
        for stance in 0..stances {
            let [x, y, ..] = foot.motion.nodes[3 * stance];
            let [hx, hy] = task.terrain.ground(x, y).slope;
            let n = Vector3::new(-hx, -hy, 1.).normalize();
            for piece in 0..pieces {
                let ends = &foot.force.nodes[(pieces + 1) * stance + piece..][..2];
                let duration = foot.force.poly_durations[(pieces + 1) * stance + piece];
                for i in 0..=TIMES {
                    let w = hermite(duration * i as f64 / TIMES as f64, duration);
                    let of = |d: usize| w[0] * ends[0][d] + w[1] * ends[0][3 + d] + w[2] * ends[1][d] + w[3] * ends[1][3 + d];
                    let force = Vector3::new(of(0), of(1), of(2));
                    farthest = farthest.max(n.cross(&force).norm() - task.terrain.friction * n.dot(&force));
                }
            }
        }
    }
    farthest
}

/// Ground that rises by 0.2 along x and falls by 0.1 along y.
fn ramp() -> Terrain {
    let heights = (0..8).map(|i| (0..8).map(|j| 0.2 * f64::from(i) - 0.1 * f64::from(j)).collect()).collect();
    Terrain { name: "ramp".into(), friction: 1., shape: Shape::Grid(Grid { low: [-4., -4.], high: [4., 4.], heights }) }
}

#[test]
fn with_cones_no_foot_slips_at_any_time() {
    // The ground is so slippery that feet slip under a pyramid.
    let cases = [("anymal", Terrain::named("flat").unwrap(), 0.27), ("biped", ramp(), 0.3), ("pexod", ramp(), 0.65)];
    for (robot, terrain, friction) in cases {
        let (robot_of, terrain) = (Robot::named(robot).unwrap(), Terrain { friction, ..terrain });
        // The base is level at both ends: along a ramp it leans to where the low friction can hardly hold it.
        let level = |x: f64, y: f64| Goal::position([x, y, robot_of.base_height + terrain.height(x, y)]);
        let task = Task::between(robot_of.clone(), terrain.clone(), level(0., 0.), level(0.5, 0.5).yaw(0.3)).unwrap();
        for seed in 0..3 {
            let schedule = gait(&mut Random::new(seed), task.robot.feet(), 5..=7);
            let [pyramid, cone] = [Friction::Pyramid, Friction::Cone].map(Some).map(|friction| {
                let settings = TranscriptionSettings { friction, force_pieces: Some(3), ..TranscriptionSettings::default() };
                let problem = problem_with(&task, &schedule, &settings);
                let (outcome, x) = solve(&problem, &SolverSettings::default());
                assert_eq!(outcome.status, Status::Solved, "{robot}, gait {seed}, {friction:?}");
                out_of_the_cone(&task, &trajectory(&task, &problem.curves, &x))
            });
            assert!(cone <= SLIP_TOLERANCE, "{robot}, gait {seed}: {cone} N beyond the cone");
            assert!(pyramid > 5e-3 * task.robot.weight(), "{robot}, gait {seed}: no foot slips anyhow");
        }
    }
}
