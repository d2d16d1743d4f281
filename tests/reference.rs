//! The kernels against independent f64 formulas on TOWR's node values, central differences and dense linear algebra.

mod common;

use common::{
    Random, Rows, dense_inequalities, dense_jacobian, frozen_at, gait, hills, layout_with, momentum, one_sided, point, rows, rows_with,
    spider, straight, task, task_for, towr, transcriptions,
};
use cregopt::gait::{Curve, FootCurves, Schedule, Trajectory};
use cregopt::linear::forward::forward;
use cregopt::linear::front::{Factor, NormalEquations, factorise};
use cregopt::linear::product::jacobian_times;
use cregopt::linear::substitute::substitute;
use cregopt::linear::transposed::transposed_times;
use cregopt::nlp::Layout;
use cregopt::nlp::layout::Element;
use cregopt::nlp::trajectory;
use cregopt::nlp::transcription::force_limit;
use cregopt::real::Real;
use cregopt::robot::GRAVITY;
use cregopt::rows::table::NONE;
use cregopt::settings::{Transcription, TranscriptionSettings};
use cregopt::solver::advance::advance;
use cregopt::solver::judge::{infeasibility, infeasibility_fall, merit_fall, nonlinearity, smoothing_fall, update_slacks};
use cregopt::solver::slacks::{Aim, Slacks, mean_product, slack_steps, target};
use cregopt::solver::start::{column_scaling, start_slacks};
use cregopt::solver::weights::{barrier_rows, closing_rows, variable_terms};
use cregopt::task::Task;
use cregopt::terrain::{Shape, Terrain};
use cregopt::verify::certificate::{Family, verify_rows};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Residuals, kernel against formula. Second differences of node values 0.1 s apart lose four of sixteen digits.
const RESIDUAL_TOLERANCE: f64 = 1e-10;

/// Step of central differences; the error of their quotient is near 1e-10 by rounding and by curvature.
const DIFFERENCE_STEP: f64 = 1e-5;

/// Jacobian entries against central differences, relative to the larger of 1 and the entry.
const JACOBIAN_TOLERANCE: f64 = 2e-6;

/// Direction, f64 front against dense solve, relative to its norm: condition numbers up to 1e7 on 1e-16.
const F64_SOLVE_TOLERANCE: f64 = 1e-9;

/// Backward error of the f32 front, in units of f32 precision: a Cholesky solve is backward stable, and sums of up to 100 products grow
/// like the root of their number.
const F32_BACKWARD_ERROR: f64 = 20. * f32::EPSILON as f64;

/// f32 kernels against f64 kernels at the same point, relative to the larger of 1 and the value. Positions up to 6 m are 2.4e-7 m off,
/// which rows in units of 0.1 m multiply by 10, and the normal of the steep gap by its curvature of 33/m.
const F32_TOLERANCE: f64 = 2e-4;

/// Deviations of the base from its cubics in f32, relative to the larger of 1 (m, rad, N m s) and the value. They divide what is left of
/// angular momenta by the inertia: up to 1e3 N m s at a random point, 1e-7 of that lost, over 0.05 kg m².
const F32_DEVIATION_TOLERANCE: f64 = 2e-3;

/// Linear conditions of elementwise steps, relative to the sizes of their terms: a few roundings.
const ELEMENTWISE_TOLERANCE: f64 = 1e-14;

/// Sums over all rows in another order, relative.
const SUM_TOLERANCE: f64 = 1e-11;

/// Falls in f32, relative to how far the terms fall, up or down, and to the norm of those terms that are rounded before their difference is
/// taken: each has a few roundings of its own, and their signs are random.
const F32_FALL_ERROR: f64 = 4. * f32::EPSILON as f64;

struct Case {
    name: String,
    task: Task,
    schedule: Schedule,
}

/// Robots with one to eight feet, on every kind of terrain, with and without a turn.
fn cases() -> Vec<Case> {
    let mut random = Random::new(1);
    let gap = || Terrain::named("gap").unwrap();
    let tasks = [
        task("anymal", "flat", [5.9, -0.3], std::f64::consts::PI),
        task("anymal", "step", [3.9, 0.4], 2.),
        task("biped", "gap", [2.7, 0.2], 0.3),
        task("monoped", "slope", [2.8, -0.2], -0.4),
        task("pexod", "slope", [3.3, 0.5], 1.),
        task_for(spider(3), gap(), [2.5, 0.1], -1.),
        task_for(spider(5), hills(), [1., 1.], 0.),
        task_for(spider(7), hills(), [4.5, -1.], 0.5),
        task_for(spider(8), gap(), [2.6, -0.4], 0.7),
    ];
    let case = |task: Task| {
        let feet = task.robot.feet();
        let name = format!("{} on {}", task.robot.name, task.terrain.name);
        Case { name, schedule: gait(&mut random, feet, 5..=13), task }
    };
    let mut cases: Vec<Case> = tasks.into_iter().map(case).collect();
    // Phases that begin and end at instants, and one that lasts throughout.
    let round =
        Schedule::new(vec![vec![0.4, 0.4, 0.2], vec![0.1, 0.3, 0.16, 0.24, 0.2], vec![1.], vec![0.08, 0.16, 0.56, 0.1, 0.1]]).unwrap();
    cases.push(Case { name: "round durations".into(), task: task("anymal", "flat", [0.3, 0.1], 0.2), schedule: round });
    cases
}

/// Value, first and second derivative of a curve. The piece as a polynomial in seconds.
fn at(curve: &Curve, t: f64) -> [Vector3<f64>; 3] {
    let (mut start, mut piece) = (0., 0);
    while piece + 1 < curve.poly_durations.len() && t > start + curve.poly_durations[piece] {
        start += curve.poly_durations[piece];
        piece += 1;
    }
    let (d, u) = (curve.poly_durations[piece], t - start);
    let value = |node: usize| Vector3::from_column_slice(&curve.nodes[node][..3]);
    let slope = |node: usize| Vector3::from_column_slice(&curve.nodes[node][3..]);
    let (p, q, v, w) = (value(piece), value(piece + 1), slope(piece), slope(piece + 1));
    let a = (3. * (q - p) - d * (2. * v + w)) / (d * d);
    let b = (2. * (p - q) + d * (v + w)) / (d * d * d);
    [p + u * (v + u * (a + u * b)), v + u * (2. * a + u * 3. * b), 2. * a + 6. * u * b]
}

/// Rotation from base to world by Euler angles roll, pitch, yaw, and its first two derivatives in time.
fn rotation([angles, rates, accelerations]: [Vector3<f64>; 3]) -> [Matrix3<f64>; 3] {
    // One axis: R(a), R' = a' dR/da, R'' = a'' dR/da + a'^2 d2R/da2.
    let turn = |axis: usize| {
        let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
        let plane = |cos: f64, sin: f64, one: f64| {
            let mut m = Matrix3::zeros();
            m[(axis, axis)] = one;
            (m[(j, j)], m[(k, k)], m[(k, j)], m[(j, k)]) = (cos, cos, sin, -sin);
            m
        };
        let (sin, cos) = angles[axis].sin_cos();
        let (value, first, second) = (plane(cos, sin, 1.), plane(-sin, cos, 0.), plane(-cos, -sin, 0.));
        [value, first * rates[axis], first * accelerations[axis] + second * rates[axis].powi(2)]
    };
    let product =
        |a: [Matrix3<f64>; 3], b: [Matrix3<f64>; 3]| [a[0] * b[0], a[1] * b[0] + a[0] * b[1], a[2] * b[0] + 2. * a[1] * b[1] + a[0] * b[2]];
    product(product(turn(2), turn(1)), turn(0))
}

/// The vector `v` of a matrix `[v]x`.
fn axial(m: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(m[(2, 1)], m[(0, 2)], m[(1, 0)])
}

/// Moment and force that the forces of the feet miss at time `t`.
fn defect(task: &Task, nodes: &Trajectory, t: f64) -> [Vector3<f64>; 2] {
    let robot = &task.robot;
    let [p, _, acceleration] = at(&nodes.base_lin, t);
    let [r, r1, r2] = rotation(at(&nodes.base_ang, t));
    let (omega, omega_dot) = (axial(&(r1 * r.transpose())), axial(&(r2 * r.transpose() + r1 * r1.transpose())));
    let inertia_w = r * Matrix3::from_fn(|i, j| robot.inertia[i][j]) * r.transpose();
    let mut moment = inertia_w * omega_dot + omega.cross(&(inertia_w * omega));
    let mut force = robot.mass * (acceleration + Vector3::new(0., 0., GRAVITY));
    for foot in &nodes.ee {
        let (x, f) = (at(&foot.motion, t)[0], at(&foot.force, t)[0]);
        moment -= (x - p).cross(&f);
        force -= f;
    }
    [moment, force]
}

/// Scaled residuals of the reduced problem from TOWR's node values, in the order of the layout.
fn expected(task: &Task, nodes: &Trajectory, layout: &Layout<f64>) -> (Vec<f64>, Vec<f64>) {
    let (robot, settings) = (&task.robot, towr());
    let (weight, feet) = (robot.mass * GRAVITY, robot.feet());
    let leg = robot.nominal_feet[0][2].abs();
    let mut c = vec![f64::NAN; layout.equalities];
    let mut g = vec![f64::NAN; layout.inequalities];

    let instants = (nodes.horizon / 0.1).round() as usize + 1;
    assert_eq!(layout.dynamics_instants.len(), instants);
    for (k, instant) in layout.dynamics_instants.iter().enumerate() {
        let [moment, force] = defect(task, nodes, k as f64 * 0.1);
        for d in 0..3 {
            c[instant.place.row as usize + d] = moment[d] / (weight * leg);
            c[instant.place.row as usize + 3 + d] = force[d] / weight;
        }
    }

    let mut times: Vec<f64> = (0..).map(|i| i as f64 * 0.08).take_while(|&t| t < nodes.horizon - 1e-9).collect();
    times.push(nodes.horizon);
    assert_eq!(layout.reach_instants.len(), times.len());
    for (instant, t) in layout.reach_instants.iter().zip(times) {
        let base = at(&nodes.base_lin, t)[0];
        let to_base = rotation(at(&nodes.base_ang, t))[0].transpose();
        for (foot, entry) in layout.reach_feet[instant.feet.range()].iter().enumerate() {
            let offset = to_base * (at(&nodes.ee[foot].motion, t)[0] - base) - Vector3::from(robot.nominal_feet[foot]);
            for d in 0..3 {
                let row = entry.place.inequality as usize + d;
                // In units of 0.1 m.
                g[row] = (offset[d] - robot.reach[d] + settings.length_margin) / 0.1;
                g[row + 3] = (-offset[d] - robot.reach[d] + settings.length_margin) / 0.1;
            }
        }
    }

    let (mut force_nodes, mut swing_nodes) = (layout.force_nodes.iter(), layout.swing_nodes.iter());
    let unit = weight / feet as f64;
    let margin = settings.force_margin * weight;
    for (foot, durations) in nodes.ee.iter().zip(&nodes.durations) {
        let stances = durations.len().div_ceil(2);
        for stance in 0..stances {
            // Motion nodes: two a stance, one a swing. Force nodes: four a stance.
            let foothold = foot.motion.nodes[3 * stance];
            let [hx, hy] = task.terrain.ground(foothold[0], foothold[1]).slope;
            let n = Vector3::new(-hx, -hy, 1.).normalize();
            let tangents = [Vector3::new(1., 0., hx).normalize(), Vector3::new(0., 1., hy).normalize()];
            let free = usize::from(stance > 0)..4 - usize::from(stance + 1 < stances);
            for node in free {
                let f = Vector3::from_column_slice(&foot.force.nodes[4 * stance + node][..3]);
                let row = force_nodes.next().unwrap().place.inequality as usize;
                let (normal, limit) = (n.dot(&f), task.terrain.friction * n.dot(&f));
                let sides = [
                    normal - force_limit(&towr(), task),
                    tangents[0].dot(&f) - limit,
                    -tangents[0].dot(&f) - limit,
                    tangents[1].dot(&f) - limit,
                    -tangents[1].dot(&f) - limit,
                    -normal,
                ];
                for (r, side) in sides.into_iter().enumerate() {
                    g[row + r] = (side + margin) / unit;
                }
            }
            if stance + 1 < stances {
                let mid = foot.motion.nodes[3 * stance + 2];
                let row = swing_nodes.next().unwrap().place.inequality as usize;
                g[row] = (task.terrain.height(mid[0], mid[1]) - mid[2] + settings.length_margin) / 0.1;
            }
        }
    }
    assert!(force_nodes.next().is_none() && swing_nodes.next().is_none());
    (c, g)
}

/// Body that falls and turns under the forces of the feet: position, velocity, angular momentum about the centre of mass.
#[derive(Clone, Copy)]
struct Body {
    position: Vector3<f64>,
    velocity: Vector3<f64>,
    momentum: Vector3<f64>,
}

impl Body {
    /// The planned state at a time, from curves.
    fn planned(task: &Task, nodes: &Trajectory, t: f64) -> Body {
        let [position, velocity, _] = at(&nodes.base_lin, t);
        let [r, r1, _] = rotation(at(&nodes.base_ang, t));
        let inertia = Matrix3::from_fn(|i, j| task.robot.inertia[i][j]);
        Body { position, velocity, momentum: r * inertia * r.transpose() * axial(&(r1 * r.transpose())) }
    }

    /// Carried on from `start` to `end` by forces that have nodes at `times`, in short steps between them.
    fn carried(self, task: &Task, nodes: &Trajectory, times: &[f64], start: f64, end: f64) -> Body {
        const STEPS: usize = 4;
        let mut body = self;
        let inner = times.iter().copied().filter(|&t| t > start + 1e-9 && t < end - 1e-9);
        let marks: Vec<f64> = std::iter::once(start).chain(inner).chain([end]).collect();
        for piece in marks.windows(2) {
            let step = (piece[1] - piece[0]) / STEPS as f64;
            for i in 0..STEPS {
                body = body.stepped(task, nodes, piece[0] + i as f64 * step, step);
            }
        }
        body
    }

    /// Impulses and their moments by four points of Gauss; the way within a step is taken from the forces as well.
    fn stepped(self, task: &Task, nodes: &Trajectory, start: f64, step: f64) -> Body {
        let (inner, outer) = ((3. / 7. - 2. / 7. * 1.2_f64.sqrt()).sqrt(), (3. / 7. + 2. / 7. * 1.2_f64.sqrt()).sqrt());
        let (near, far) = ((18. + 30_f64.sqrt()) / 72., (18. - 30_f64.sqrt()) / 72.);
        let rule = [(-outer, far), (-inner, near), (inner, near), (outer, far)].map(|(x, w)| ((1. + x) / 2., w));
        let gravity = Vector3::new(0., 0., -GRAVITY);
        let of_foot = |foot: &FootCurves, t: f64| (at(&foot.motion, t)[0], at(&foot.force, t)[0]);
        let force = |t: f64| nodes.ee.iter().map(|foot| of_foot(foot, t).1).sum::<Vector3<f64>>();
        // Position after `u`: v u + g u^2 / 2 + int (u - s) f ds / m.
        let way = |u: f64| {
            let pushed: Vector3<f64> = rule.iter().map(|(x, w)| force(start + x * u) * (w * u * (1. - x) * u)).sum();
            self.velocity * u + gravity * (u * u / 2.) + pushed / task.robot.mass
        };
        let mut next = Body { position: self.position + way(step), velocity: self.velocity + gravity * step, ..self };
        for (x, w) in rule {
            let t = start + x * step;
            next.velocity += force(t) * (w * step / task.robot.mass);
            let position = self.position + way(x * step);
            for foot in &nodes.ee {
                let (place, f) = of_foot(foot, t);
                next.momentum += (place - position).cross(&f) * (w * step);
            }
        }
        next
    }
}

/// Scaled momentum residuals of the intervals, from node values, in the order of the layout.
fn expected_momentum(task: &Task, nodes: &Trajectory, layout: &Layout<f64>) -> Vec<f64> {
    // Abscissae on (-1, 1) of the rule of Gauss and Legendre with six points, and weights that add up to 1.
    let half = [(0.238_619_186_083_196_9, 0.467_913_934_572_691), (0.661_209_386_466_264_5, 0.360_761_573_048_138_6)];
    let outer = [(0.932_469_514_203_152, 0.171_324_492_379_170_4)];
    let rule: Vec<(f64, f64)> = half.into_iter().chain(outer).flat_map(|(x, w)| [(-x, w / 2.), (x, w / 2.)]).collect();
    let mut times: Vec<f64> = Vec::new();
    for foot in &nodes.ee {
        let mut end = 0.;
        times.extend(foot.force.poly_durations.iter().map(|d| {
            end += d;
            end
        }));
    }
    times.sort_by(f64::total_cmp);
    let (mass, h) = (task.robot.mass, layout.curves.interval);
    let weight = mass * GRAVITY;
    let leg = task.robot.nominal_feet[0][2].abs();
    // The attitude between two knots is the cubic through both: nodes in between are there for the trajectory alone.
    let pieces = nodes.base_lin.poly_durations.len() / layout.curves.intervals;
    let at_knots = |curve: &Curve| Curve {
        poly_durations: vec![h; layout.curves.intervals],
        nodes: curve.nodes.iter().copied().step_by(pieces).collect(),
    };
    let knots = Trajectory { base_lin: at_knots(&nodes.base_lin), base_ang: at_knots(&nodes.base_ang), ..nodes.clone() };
    let mut c = vec![f64::NAN; layout.equalities];
    for (k, interval) in layout.momentum_intervals.iter().enumerate() {
        let (start, end) = (k as f64 * h, (k + 1) as f64 * h);
        let (before, after) = (Body::planned(task, &knots, start), Body::planned(task, &knots, end));
        let carried = before.carried(task, nodes, &times, start, end);
        let mean: Vector3<f64> = rule
            .iter()
            .map(|&(x, w)| {
                let t = start + (1. + x) / 2. * h;
                (Body::planned(task, &knots, t).momentum - before.carried(task, nodes, &times, start, t).momentum) * w
            })
            .sum();
        for d in 0..3 {
            let (linear, angular) = (interval.linear.row as usize + d, interval.angular.row as usize + d);
            c[linear] = mass * (after.velocity - carried.velocity)[d] / (weight * h);
            c[linear + 3] = mass * (after.position - carried.position)[d] / (weight * h * h / 2.);
            c[angular] = (after.momentum - carried.momentum)[d] / (weight * leg * h);
            c[angular + 3] = 2. * mean[d] / (weight * leg * h);
        }
    }
    c
}

/// The first pair that differs by more than `tolerance * max(1, |expected|)`; NaN differs from everything.
fn first_difference(got: &[f64], expected: &[f64], tolerance: f64) -> Option<usize> {
    assert_eq!(got.len(), expected.len());
    let close = |a: f64, b: f64| (a - b).abs() <= tolerance * b.abs().max(1.);
    got.iter().zip(expected).position(|(&a, &b)| !close(a, b))
}

fn assert_close(got: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    if let Some(i) = first_difference(got, expected, tolerance) {
        panic!("{what}, entry {i}: {:e} against {:e}, gap {:e}", got[i], expected[i], got[i] - expected[i]);
    }
}

#[test]
fn node_values_give_towrs_rows_the_residuals_of_the_reduced_problem() {
    for (seed, case) in cases().iter().enumerate() {
        let layout = layout_with::<f64>(&case.task, &case.schedule, &towr());
        let x = point(&layout, &mut Random::new(seed as u64), 0.);
        let rows = rows(&layout, &x, 0.);
        let (c, g) = expected(&case.task, &trajectory(&case.task, &layout, &x), &layout);
        assert_close(&rows.c, &c, RESIDUAL_TOLERANCE, &format!("{}, equalities", case.name));
        assert_close(&rows.g, &g, RESIDUAL_TOLERANCE, &format!("{}, inequalities", case.name));
    }
}

#[test]
fn node_values_give_the_momentum_residuals() {
    for (seed, case) in cases().iter().enumerate() {
        let layout = layout_with::<f64>(&case.task, &case.schedule, &TranscriptionSettings::default());
        let x = point(&layout, &mut Random::new(seed as u64), 0.);
        let c = expected_momentum(&case.task, &trajectory(&case.task, &layout, &x), &layout);
        assert_close(&rows_with(&layout, &x, 0., &mut straight(&layout)).c, &c, RESIDUAL_TOLERANCE, &case.name);
    }
}

/// Acceleration at both ends of a piece of a curve: by `p'' = (6 (q - p) - d (4 v + 2 w)) / d^2` at its start.
fn accelerations(curve: &Curve, piece: usize) -> [Vector3<f64>; 2] {
    let d = curve.poly_durations[piece];
    let part = |node: usize, from: usize| Vector3::from_column_slice(&curve.nodes[node][from..from + 3]);
    let (way, v, w) = (part(piece + 1, 0) - part(piece, 0), part(piece, 3), part(piece + 1, 3));
    [(6. * way - d * (4. * v + 2. * w)) / (d * d), (d * (2. * v + 4. * w) - 6. * way) / (d * d)]
}

#[test]
fn node_values_give_the_accelerations_of_swinging_feet() {
    for (seed, case) in cases().iter().enumerate() {
        let layout = layout_with::<f64>(&case.task, &case.schedule, &TranscriptionSettings::default());
        let x = point(&layout, &mut Random::new(seed as u64), 0.);
        let rows = rows(&layout, &x, 0.);
        let nodes = trajectory(&case.task, &layout, &x);
        let mut entries = layout.accelerations.iter();
        for (foot, durations) in nodes.ee.iter().zip(&nodes.durations) {
            for swing in 0..durations.len() / 2 {
                // Of motion a stance has one piece, a swing two.
                let [up, down] = [1, 2].map(|piece| accelerations(&foot.motion, 3 * swing + piece).map(|a| a.norm()));
                let row = |a: f64| ((a / (20. * GRAVITY)).powi(2) - 1. + 2e-3) / 2.;
                let at = entries.next().unwrap().place.inequality as usize;
                assert_close(&rows.g[at..at + 2], &[row(up[0]), row(down[1])], RESIDUAL_TOLERANCE, &case.name);
                // About the middle it is not accelerated harder: no row is missing there.
                assert!(up[1].max(down[0]) <= (1. + 1e-9) * up[0].max(down[1]), "{}: {up:?}, {down:?}", case.name);
            }
        }
        assert!(entries.next().is_none() && layout.accelerations.len() > 4);
    }
    let case = &cases()[0];
    assert!(layout_with::<f64>(&case.task, &case.schedule, &momentum()).accelerations.is_empty(), "free legs have no limit");
}

#[test]
fn rows_that_were_eliminated_hold_at_any_point() {
    for (seed, case) in cases().iter().enumerate() {
        let layout = layout_with::<f64>(&case.task, &case.schedule, &towr());
        let x = point(&layout, &mut Random::new(seed as u64), 0.);
        let limit = |settings: &TranscriptionSettings| force_limit(settings, &case.task);
        let nodes = trajectory(&case.task, &layout, &x);
        let report = verify_rows(&nodes, &case.task.robot, &case.task.terrain, limit(&towr())).unwrap();
        for family in [Family::BaseAcceleration, Family::Swing, Family::Bounds, Family::Structure] {
            assert_eq!(report.family(family).violated, 0, "{}\n{report}", case.name);
        }
        assert!(report.family(Family::Dynamics).violated > 0, "a random point does not move like a rigid body");

        let layout = layout_with::<f64>(&case.task, &case.schedule, &TranscriptionSettings::default());
        let x = point(&layout, &mut Random::new(seed as u64), 0.);
        let nodes = trajectory(&case.task, &layout, &x);
        let report = verify_rows(&nodes, &case.task.robot, &case.task.terrain, limit(&TranscriptionSettings::default())).unwrap();
        for family in [Family::Bounds, Family::Structure] {
            assert_eq!(report.family(family).violated, 0, "{}\n{report}", case.name);
        }
        assert!(report.family(Family::Momentum).violated > 0, "nor does this one");
    }
}

/// Jacobian by central differences of one-sided residuals, `[rows][variables]`.
fn differences(layout: &Layout<f64>, x: &[f64], edge_radius: f64) -> DMatrix<f64> {
    let mut result = DMatrix::zeros(layout.rows, layout.variables);
    // Derivatives take deviations from the cubics between knots as given.
    let mut given = frozen_at(layout, x, edge_radius);
    let mut x = x.to_vec();
    for column in 0..layout.variables {
        let mut moved = |by: f64| {
            let before = x[column];
            x[column] += by;
            let Rows { c, g, .. } = rows_with(layout, &x, edge_radius, &mut given);
            x[column] = before;
            DVector::from_vec(one_sided(layout, &c, &g))
        };
        let difference = moved(DIFFERENCE_STEP) - moved(-DIFFERENCE_STEP);
        result.set_column(column, &(difference / (2. * DIFFERENCE_STEP)));
    }
    result
}

#[test]
fn jacobians_match_central_differences() {
    for (seed, case) in cases().iter().enumerate() {
        for settings in transcriptions() {
            // Fewer stances than in the search: every variable takes two evaluations.
            let schedule = gait(&mut Random::new(seed as u64), case.task.robot.feet(), 3..=6);
            let layout = layout_with::<f64>(&case.task, &schedule, &settings);
            for edge_radius in [0., 0.04] {
                let x = point(&layout, &mut Random::new(seed as u64), edge_radius);
                let analytic = dense_jacobian(&layout, &rows(&layout, &x, edge_radius).jacobian);
                let numeric = differences(&layout, &x, edge_radius);
                let difference = first_difference(analytic.as_slice(), numeric.as_slice(), JACOBIAN_TOLERANCE);
                if let Some((row, variable)) = difference.map(|i| (i % layout.rows, i / layout.rows)) {
                    let of_row = |e: &&Element| (e.place.row..e.place.row + e.rows).contains(&(row as u32));
                    let family = layout.elements.iter().find(of_row).unwrap().family;
                    let (a, b) = (analytic[(row, variable)], numeric[(row, variable)]);
                    panic!("{}, edge radius {edge_radius}, {family:?} row {row}, variable {variable}: {a:e} against {b:e}", case.name);
                }
            }
        }
    }
}

#[test]
fn the_cases_stand_on_slopes_wherever_there_are_any() {
    for (seed, case) in cases().iter().enumerate().filter(|(_, case)| case.task.terrain.shape != Shape::Flat) {
        for settings in transcriptions() {
            let layout = layout_with::<f64>(&case.task, &case.schedule, &settings);
            let x = point(&layout, &mut Random::new(seed as u64), 0.);
            let slope = |at: usize| case.task.terrain.ground(x[at], x[at + 1]).slope;
            let on_slope = layout.footholds.iter().filter(|&&f| slope(f as usize) != [0.; 2]);
            let count = on_slope.count();
            assert!(count >= 3, "{}: {count} of {}", case.name, layout.footholds.len());
        }
    }
}

#[test]
fn a_wrong_entry_is_seen() {
    let case = &cases()[0];
    for settings in transcriptions() {
        let layout = layout_with::<f64>(&case.task, &gait(&mut Random::new(0), 4, 3..=3), &settings);
        let x = point(&layout, &mut Random::new(0), 0.);
        let Rows { jacobian, .. } = rows(&layout, &x, 0.);
        let numeric = differences(&layout, &x, 0.);
        let mut analytic = dense_jacobian(&layout, &jacobian);
        assert_eq!(first_difference(analytic.as_slice(), numeric.as_slice(), JACOBIAN_TOLERANCE), None);
        let middle = analytic.len() / 2;
        let small = 3. * JACOBIAN_TOLERANCE * numeric.as_slice()[middle].abs().max(1.);
        for wrong in [small, -small, f64::NAN, f64::INFINITY] {
            let right = std::mem::replace(&mut analytic.as_mut_slice()[middle], wrong + numeric.as_slice()[middle]);
            assert_eq!(first_difference(analytic.as_slice(), numeric.as_slice(), JACOBIAN_TOLERANCE), Some(middle), "off by {wrong}");
            analytic.as_mut_slice()[middle] = right;
        }
    }
    // A foot 1 um off moves a moment.
    for settings in transcriptions() {
        let layout = layout_with::<f64>(&case.task, &gait(&mut Random::new(0), 4, 3..=3), &settings);
        let x = point(&layout, &mut Random::new(0), 0.);
        let c = rows_with(&layout, &x, 0., &mut straight(&layout)).c;
        let formula = |nodes: &Trajectory| match settings.rows {
            Transcription::Towr => expected(&case.task, nodes, &layout).0,
            Transcription::Momentum => expected_momentum(&case.task, nodes, &layout),
        };
        let nodes = trajectory(&case.task, &layout, &x);
        let mut moved = nodes.clone();
        moved.ee[0].motion.nodes.iter_mut().for_each(|node| node[0] += 1e-6);
        assert_eq!(first_difference(&c, &formula(&nodes), RESIDUAL_TOLERANCE), None);
        assert!(first_difference(&c, &formula(&moved), RESIDUAL_TOLERANCE).is_some());
    }
}

/// Random weights, some of them zero, with values that are zero there too; what falls on single variables.
struct RandomSystem {
    weight: Vec<f64>,
    value: Vec<f64>,
    diagonal: Vec<f64>,
    gradient: Vec<f64>,
}

impl RandomSystem {
    fn new<T: Real>(layout: &Layout<T>, random: &mut Random, zeros: f64, proximal: f64) -> RandomSystem {
        let weight: Vec<f64> =
            (0..layout.rows).map(|_| if random.between(0., 1.) < zeros { 0. } else { random.between(0.01, 1.) }).collect();
        let value = weight.iter().map(|&w| if w == 0. { 0. } else { random.between(-1., 1.) }).collect();
        let diagonal = (0..layout.variables).map(|_| proximal * random.between(0.01, 10.)).collect();
        let gradient = (0..layout.variables).map(|_| random.between(-1., 1.)).collect();
        RandomSystem { weight, value, diagonal, gradient }
    }

    /// `E + J' W J` and `-(u + J' v)`.
    fn dense<T: Real>(&self, layout: &Layout<T>, jacobian: &[T]) -> (DMatrix<f64>, DVector<f64>) {
        let j = dense_jacobian(layout, jacobian);
        let mut matrix = DMatrix::from_diagonal(&DVector::from_vec(self.diagonal.clone()));
        for (row, &w) in j.row_iter().zip(&self.weight) {
            let entries: Vec<(usize, f64)> = row.iter().copied().enumerate().filter(|entry| entry.1 != 0.).collect();
            for &(a, left) in &entries {
                for &(b, right) in &entries {
                    matrix[(b, a)] += w * left * right;
                }
            }
        }
        (matrix, -(j.tr_mul(&DVector::from_vec(self.value.clone())) + DVector::from_vec(self.gradient.clone())))
    }

    /// The direction by the front; `None` when it was not positive definite.
    fn solve<T: Real>(&self, layout: &Layout<T>, jacobian: &[T], factor: &mut Factor<T>) -> Option<DVector<f64>> {
        factor.resize(layout);
        let [weight, value, diagonal, gradient] =
            [&self.weight, &self.value, &self.diagonal, &self.gradient].map(|values| in_scalar::<T>(values));
        let (weight, value, diagonal, gradient) = (&weight, &value, &diagonal, &gradient);
        factorise(layout, &NormalEquations { jacobian, weight, value, diagonal, gradient }, factor).then(|| back(layout, factor))
    }
}

fn in_scalar<T: Real>(values: &[f64]) -> Vec<T> {
    values.iter().map(|&v| T::of(v)).collect()
}

/// Back substitution.
fn back<T: Real>(layout: &Layout<T>, factor: &mut Factor<T>) -> DVector<f64> {
    let mut direction = vec![T::nan(); layout.variables];
    substitute(layout, factor, &mut direction);
    DVector::from_iterator(layout.variables, direction.iter().map(|d| d.as_f64()))
}

#[test]
fn the_front_solves_what_a_dense_cholesky_solves() {
    // One factor for all, so that leftovers of another layout would show.
    let (mut factor, mut factor_f32) = (Factor::default(), Factor::default());
    let mut problems: Vec<(Case, TranscriptionSettings)> = Vec::new();
    for own in transcriptions() {
        // Many reach instants in a step, and steps without any.
        let coarse = TranscriptionSettings { interval: Some(0.3), reach_interval: 0.02, force_pieces: 4, ..own.clone() };
        let fine = TranscriptionSettings { interval: Some(0.05), reach_interval: 0.11, force_pieces: 2, ..own.clone() };
        for (i, case) in cases().into_iter().enumerate() {
            let mut random = Random::new(i as u64);
            let schedule = gait(&mut random, case.task.robot.feet(), if i % 2 == 0 { 3..=7 } else { 1..=3 });
            problems.push((Case { schedule, ..case }, [own.clone(), coarse.clone(), fine.clone()][i % 3].clone()));
        }
        // One interval: of the base only one coefficient is free, or nothing.
        let short = Schedule::new(vec![vec![0.08]; 4]).unwrap();
        let case = Case { name: "short".into(), task: task("anymal", "flat", [0., 0.], 0.), schedule: short };
        problems.push((case, own));
    }
    for (seed, (case, settings)) in problems.iter().enumerate() {
        let mut random = Random::new(seed as u64);
        let layout = layout_with::<f64>(&case.task, &case.schedule, settings);
        let layout_f32 = layout_with::<f32>(&case.task, &case.schedule, settings);
        let x = point(&layout, &mut random, 0.);
        let jacobian = rows(&layout, &x, 0.).jacobian;
        let jacobian_f32 = rows(&layout_f32, &in_scalar(&x), 0.).jacobian;
        for (zeros, proximal) in [(0., 1e-3), (0.4, 1e-3), (1., 1.)] {
            let what = format!("{}, {}, {zeros} of the weights zero", case.name, settings.rows.name());
            let system = RandomSystem::new(&layout, &mut random, zeros, proximal);
            // A second right-hand side for the same matrix.
            let other: Vec<f64> = (0..layout.variables).map(|_| random.between(-1., 1.)).collect();
            let other_rhs = -DVector::from_vec(other.clone());

            let (matrix, rhs) = system.dense(&layout, &jacobian);
            let dense = matrix.clone().cholesky().unwrap();
            let direction = system.solve(&layout, &jacobian, &mut factor).unwrap();
            forward(&layout, &mut factor, &mut other.clone());
            let replaced = back(&layout, &mut factor);
            for (direction, rhs) in [(&direction, &rhs), (&replaced, &other_rhs)] {
                let exact = dense.solve(rhs);
                let error = (direction - &exact).norm();
                assert!(error <= F64_SOLVE_TOLERANCE * exact.norm(), "{what}, f64: error {error:e} of {:e}", exact.norm());
            }

            let (matrix, rhs) = system.dense(&layout_f32, &jacobian_f32);
            let direction = system.solve(&layout_f32, &jacobian_f32, &mut factor_f32).unwrap();
            forward(&layout_f32, &mut factor_f32, &mut in_scalar(&other));
            let replaced = back(&layout_f32, &mut factor_f32);
            for (direction, rhs) in [(&direction, &rhs), (&replaced, &other_rhs)] {
                let (residual, size) = ((&matrix * direction - rhs).norm(), matrix.norm() * direction.norm() + rhs.norm());
                assert!(residual <= F32_BACKWARD_ERROR * size, "{what}, f32: backward error {:e}", residual / size);
                assert!(direction.norm() > 0., "{what}");
            }
        }
    }
}

#[test]
fn a_system_that_is_not_positive_definite_is_refused() {
    let case = &cases()[0];
    for settings in transcriptions() {
        let layout = layout_with::<f64>(&case.task, &case.schedule, &settings);
        let mut random = Random::new(3);
        let x = point(&layout, &mut random, 0.);
        let jacobian = rows(&layout, &x, 0.).jacobian;
        let mut factor = Factor::default();
        let mut solves = |system: &RandomSystem| system.solve(&layout, &jacobian, &mut factor).is_some();
        let system = |random: &mut Random, zeros, proximal| RandomSystem::new(&layout, random, zeros, proximal);
        assert!(solves(&system(&mut random, 0., 1e-3)));
        assert!(!solves(&system(&mut random, 1., 0.)), "a zero matrix");
        assert!(!solves(&system(&mut random, 0., -10.)), "a negative diagonal");
        for (at, bad) in [(0, -1e3), (layout.variables / 2, -1e3), (layout.variables - 1, -1e3), (layout.variables - 1, f64::NAN)] {
            let mut spoilt = system(&mut random, 0., 1e-3);
            spoilt.diagonal[at] = bad;
            assert!(!solves(&spoilt), "diagonal {at} is {bad}");
        }
        assert!(solves(&system(&mut random, 0., 1e-3)), "a refusal leaves nothing behind");
    }
}

#[test]
fn f32_kernels_agree_with_f64_kernels() {
    for (seed, case) in cases().iter().enumerate() {
        for settings in transcriptions() {
            let layout = layout_with::<f64>(&case.task, &case.schedule, &settings);
            let layout_f32 = layout_with::<f32>(&case.task, &case.schedule, &settings);
            let x_f32: Vec<f32> = in_scalar(&point(&layout, &mut Random::new(100 + seed as u64), 0.04));
            let x: Vec<f64> = x_f32.iter().map(|&v| v.into()).collect();
            for edge_radius in [0., 0.04] {
                // Both with the same deviations; those have a tolerance of their own.
                let mut shared = frozen_at(&layout, &x, edge_radius);
                let mut shared_f32 = frozen_at(&layout_f32, &x_f32, edge_radius);
                for (narrow, wide) in shared_f32.deviations.iter_mut().zip(&mut shared.deviations) {
                    let pairs = narrow.pose.iter_mut().flatten().zip(wide.pose.iter_mut().flatten());
                    for (narrow, wide) in pairs.chain(narrow.mean.iter_mut().zip(&mut wide.mean)) {
                        let gap = (f64::from(*narrow) - *wide).abs();
                        assert!(gap <= F32_DEVIATION_TOLERANCE * wide.abs().max(1.), "{}: {narrow:e} against {wide:e}", case.name);
                        *wide = f64::from(*narrow);
                    }
                }
                let wide = rows_with(&layout, &x, edge_radius, &mut shared);
                let narrow = rows_with(&layout_f32, &x_f32, edge_radius, &mut shared_f32);
                let widened = |values: &[f32]| values.iter().map(|&v| v.into()).collect::<Vec<f64>>();
                let close = |got: &[f32], expected: &[f64], what: &str| {
                    let what = format!("{}, {}, edge radius {edge_radius}, {what}", case.name, settings.rows.name());
                    assert_close(&widened(got), expected, F32_TOLERANCE, &what);
                };
                close(&narrow.c, &wide.c, "equalities");
                close(&narrow.g, &wide.g, "inequalities");
                close(&narrow.jacobian, &wide.jacobian, "Jacobian");
            }
        }
    }
}

/// A random solver state on the second case: rows, slacks and multipliers around 1, some small; steps of a predictor.
struct State {
    layout: Layout<f64>,
    rows: Rows<f64>,
    slacks: Slacks<f64>,
    x: Vec<f64>,
}

fn state(settings: &TranscriptionSettings) -> State {
    let case = &cases()[1];
    let mut random = Random::new(11);
    let layout = layout_with::<f64>(&case.task, &gait(&mut random, 4, 3..=5), settings);
    let x = point(&layout, &mut random, 0.);
    let rows = rows(&layout, &x, 0.);
    let mut positive = || (0..layout.inequalities).map(|_| random.between(-6., 1.).exp()).collect::<Vec<f64>>();
    let (slack, multiplier) = (positive(), positive());
    let mut part_of = |values: &[f64]| values.iter().map(|v| v * random.between(-1., 1.)).collect::<Vec<f64>>();
    let (slack_step, multiplier_step) = (part_of(&slack), part_of(&multiplier));
    State { rows, slacks: Slacks { slack, multiplier, slack_step, multiplier_step }, layout, x }
}

fn states() -> [State; 3] {
    transcriptions().map(|settings| state(&settings))
}

/// Barrier parameter of the elementwise tests.
const MU: f64 = 0.03;

/// Aims of a predictor, of a plain barrier step, of a corrected one.
const AIMS: [Aim<f64>; 3] = [Aim { mu: 0., correction: 0. }, Aim { mu: MU, correction: 0. }, Aim { mu: MU, correction: 0.7 }];

fn random_vector(seed: u64, len: usize) -> Vec<f64> {
    let mut random = Random::new(seed);
    (0..len).map(|_| random.between(-1., 1.)).collect()
}

#[test]
fn jacobian_products_are_derivatives_along_the_direction() {
    for State { layout, rows, x, .. } in states() {
        let direction = random_vector(12, layout.variables);
        let (mut by_c, mut by_g) = (vec![f64::NAN; layout.equalities], vec![f64::NAN; layout.inequalities]);
        jacobian_times(&layout, &rows.jacobian, &direction, &mut vec![0.; layout.widest], &mut by_c, &mut by_g);
        // Along a straight line, both sides of every inequality.
        let moved = |by: f64| {
            let mut moved = x.clone();
            advance(&x[..layout.variables], by, &direction, &mut moved[..layout.variables]);
            rows_with(&layout, &moved, 0., &mut frozen_at(&layout, &x, 0.))
        };
        let (ahead, behind) = (moved(DIFFERENCE_STEP), moved(-DIFFERENCE_STEP));
        let quotient = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| (a - b) / (2. * DIFFERENCE_STEP)).collect() };
        assert_close(&by_c, &quotient(&ahead.c, &behind.c), JACOBIAN_TOLERANCE, "equalities");
        assert_close(&by_g, &quotient(&ahead.g, &behind.g), JACOBIAN_TOLERANCE, "inequalities");
    }
}

#[test]
fn transposed_products_are_those_of_the_dense_jacobian() {
    for State { layout, rows, .. } in states() {
        let v = random_vector(14, layout.rows);
        // What is left in either buffer must not show.
        let (mut product, mut local) = (vec![f64::NAN; layout.variables], vec![f64::NAN; layout.widest]);
        transposed_times(&layout, &rows.jacobian, &v, &mut local, &mut product);
        let expected = dense_jacobian(&layout, &rows.jacobian).tr_mul(&DVector::from_vec(v));
        assert_close(&product, expected.as_slice(), SUM_TOLERANCE, "product");
    }
}

#[test]
fn terms_of_single_variables_are_their_plain_formulas() {
    let (proximal, weight) = (0.02, 0.3);
    for State { layout, x, .. } in states() {
        let n = layout.variables;
        let positive = |seed| random_vector(seed, n).iter().map(|v| v + 1.5).collect::<Vec<f64>>();
        let (scaling, pull) = (positive(15), positive(16));
        let (mut diagonal, mut gradient) = (vec![f64::NAN; n], vec![f64::NAN; n]);
        variable_terms(&scaling, proximal, &pull, weight, &x, &layout.initial, &mut diagonal, &mut gradient);
        let of_each = |term: &dyn Fn(usize) -> f64| (0..n).map(term).collect::<Vec<f64>>();
        let expected = of_each(&|i| proximal * scaling[i] + weight * pull[i]);
        assert_close(&diagonal, &expected, ELEMENTWISE_TOLERANCE, "diagonal");
        let expected = of_each(&|i| weight * pull[i] * (x[i] - layout.initial[i]));
        assert_close(&gradient, &expected, ELEMENTWISE_TOLERANCE, "gradient");

        // Forces, attitudes and rates are pulled, in `momentum` alone.
        let mut expected = vec![0.; n];
        if layout.transcription == Transcription::Momentum {
            for &node in layout.curves.feet.iter().flat_map(|f| &f.force_nodes).flatten().filter(|&&node| node != NONE) {
                expected[node as usize..node as usize + 6].fill(1.);
            }
            for (i, &block) in layout.curves.base.iter().enumerate().filter(|(_, block)| (**block as usize) < n) {
                let pull = if i % 2 == 0 { [0., 0., 0., 1., 1., 1.] } else { [0.1; 6] };
                expected[block as usize..block as usize + 6].copy_from_slice(&pull);
            }
        }
        assert_eq!(layout.smoothing, expected);
    }
}

#[test]
fn row_weights_are_those_of_the_full_system() {
    for State { layout, rows, slacks, .. } in states() {
        let (jc, jg) =
            (dense_jacobian(&layout, &rows.jacobian).rows(0, layout.equalities).into_owned(), dense_inequalities(&layout, &rows.jacobian));
        let j = dense_jacobian(&layout, &rows.jacobian);
        let (c, g) = (DVector::from_column_slice(&rows.c), &rows.g);
        let inequality = |i: usize, aim: Option<Aim<f64>>| {
            let (s, z) = (slacks.slack[i], slacks.multiplier[i]);
            let w = 1. / (s / z + 1.);
            match aim {
                Some(aim) => {
                    let product = aim.mu - aim.correction * slacks.slack_step[i] * slacks.multiplier_step[i];
                    (w, z + w * (g[i] - z + product / z))
                }
                None if g[i] > 0. => (1., g[i]),
                None => (0., 0.),
            }
        };
        for aim in AIMS.map(Some).into_iter().chain([None]) {
            let (mut weight, mut value) = (vec![f64::NAN; layout.rows], vec![f64::NAN; layout.rows]);
            match aim {
                Some(aim) => barrier_rows(&layout, &rows.c, g, &slacks, aim, &mut weight, &mut value),
                None => closing_rows(&layout, &rows.c, g, &mut weight, &mut value),
            }
            // J' W J e and J' v with all rows, against one weight for both sides of a row.
            let probe = DVector::from_fn(layout.variables, |i, _| ((i * 7919) % 13) as f64 / 13. - 0.4);
            let (by_c, mut by_g) = (&jc * &probe, &jg * &probe);
            let mut v = DVector::zeros(layout.inequalities);
            for i in 0..layout.inequalities {
                let (w, value) = inequality(i, aim);
                by_g[i] *= w;
                v[i] = value;
            }
            let product = jc.tr_mul(&by_c) + jg.tr_mul(&by_g);
            let gradient = jc.tr_mul(&c) + jg.tr_mul(&v);
            let weighted = (&j * &probe).component_mul(&DVector::from_vec(weight));
            assert_close(j.tr_mul(&weighted).as_slice(), product.as_slice(), SUM_TOLERANCE, "matrix");
            assert_close(j.tr_mul(&DVector::from_vec(value)).as_slice(), gradient.as_slice(), SUM_TOLERANCE, "right-hand side");
        }
    }
}

#[test]
fn columns_are_scaled_by_their_squares() {
    for State { layout, rows, .. } in states() {
        let (j, jg) = (dense_jacobian(&layout, &rows.jacobian), dense_inequalities(&layout, &rows.jacobian));
        let mut diagonal = vec![f64::NAN; layout.variables];
        column_scaling(&layout, &rows.jacobian, &mut diagonal);
        let formula = |i: usize| {
            let equalities = j.column(i).rows(0, layout.equalities).norm_squared();
            (equalities + 0.5 * jg.column(i).norm_squared()).max(1e-2)
        };
        let expected: Vec<f64> = (0..layout.variables).map(formula).collect();
        assert_close(&diagonal, &expected, SUM_TOLERANCE, "diagonal");
    }
}

fn half_square(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>() / 2.
}

/// Terms of the infeasibility.
fn infeasibility_terms(c: &[f64], g: &[f64]) -> Vec<f64> {
    c.iter().copied().chain(g.iter().map(|g| g.max(0.))).map(|v| v * v / 2.).collect()
}

/// Terms of the merit with each slack `factor` times the best one, at which `s (g + s) = mu`.
fn merit_terms(c: &[f64], g: &[f64], mu: f64, factor: f64) -> Vec<f64> {
    let of_row = |g: f64| {
        let best = ((g * g + 4. * mu).sqrt() - g) / 2.;
        assert!((best * (g + best) - mu).abs() <= 1e-9 * (g * g + mu));
        let s = factor * best;
        (g + s).powi(2) / 2. - mu * s.ln()
    };
    c.iter().map(|c| c * c / 2.).chain(g.iter().map(|&g| of_row(g))).collect()
}

/// Terms of the cost of being away from the initial values.
fn pull_terms(pull: &[f64], x: &[f64], initial: &[f64]) -> Vec<f64> {
    pull.iter().zip(x.iter().zip(initial)).map(|(pull, (x, initial))| pull * (x - initial).powi(2) / 2.).collect()
}

/// A fall against the difference of two sums.
fn assert_falls(got: f64, from: &[f64], to: &[f64], tolerance: f64, what: &str) {
    let [sum, sum_to] = [from, to].map(|terms| terms.iter().sum::<f64>());
    let (gap, size) = (got - (sum - sum_to), sum.abs().max(sum_to.abs()).max(1.));
    assert!(gap.abs() <= tolerance * size, "{what}: {got:e} against {:e}, gap {gap:e} of {size:e}", sum - sum_to);
}

/// How far a fall is off the difference of two sums, in units of the error that f32 may have.
///
/// * `rounded` - terms that are rounded before their difference is taken
fn f32_error(got: f32, from: &[f64], to: &[f64], rounded: &[f64]) -> f64 {
    let falls: Vec<f64> = from.iter().zip(to).map(|(from, to)| from - to).collect();
    let size = falls.iter().map(|fall| fall.abs()).sum::<f64>() + rounded.iter().map(|v| v * v).sum::<f64>().sqrt();
    (f64::from(got) - falls.iter().sum::<f64>()).abs() / (F32_FALL_ERROR * size)
}

/// The same of the difference of two sums in f32.
fn f32_error_of_sums(from: &[f64], to: &[f64], rounded: &[f64]) -> f64 {
    let [sum, sum_to] = [from, to].map(|terms| terms.iter().map(|&v| v as f32).sum::<f32>());
    f32_error(sum - sum_to, from, to, rounded)
}

/// Values in f32, and those in f64.
fn narrow(values: &[f64]) -> (Vec<f32>, Vec<f64>) {
    let narrow = in_scalar::<f32>(values);
    let wide = narrow.iter().map(|&v| v.into()).collect();
    (narrow, wide)
}

/// Values near others, on the whole smaller by a share of `away`.
fn near(values: &[f64], random: &mut Random, away: f64) -> Vec<f64> {
    values.iter().map(|v| v * (1. - random.between(-0.5 * away, away))).collect()
}

/// Residuals of a state and others at which it may arrive: some rows hold in one of them only.
fn residuals_from_and_to(Rows { c, g, .. }: &Rows<f64>) -> [(Vec<f64>, Vec<f64>); 2] {
    let moved = |values: &[f64], seed| -> Vec<f64> {
        let moves = random_vector(seed, values.len());
        values.iter().zip(moves).map(|(value, by)| 0.6 * value + by).collect()
    };
    let (c_to, g_to) = (moved(c, 17), moved(g, 18));
    assert!(g.iter().zip(&g_to).any(|(g, to)| *g > 0. && *to < 0.) && g.iter().zip(&g_to).any(|(g, to)| *g < 0. && *to > 0.));
    [(c.clone(), g.clone()), (c_to, g_to)]
}

/// Barrier parameters at the end of a solve, in its midst, and far above.
const MUS: [f64; 3] = [1e-6, MU, 2.];

#[test]
fn infeasibility_and_nonlinearity_are_their_plain_formulas() {
    for State { rows: Rows { c, g, .. }, .. } in states() {
        let violated: Vec<f64> = g.iter().map(|g| g.max(0.)).collect();
        assert_close(&[infeasibility(&c, &g)], &[half_square(&c) + half_square(&violated)], SUM_TOLERANCE, "infeasibility");
        let far: Vec<f64> = c.iter().map(|c| c + 0.1).collect();
        let further: Vec<f64> = g.iter().map(|g| g - 0.2).collect();
        let gap = (0.01 * c.len() as f64 + 0.04 * g.len() as f64) / 2.;
        assert_close(&[nonlinearity(&far, &c, &further, &g)], &[gap], SUM_TOLERANCE, "nonlinearity");
    }
}

#[test]
fn residuals_that_are_no_numbers_show_in_every_sum() {
    let (c, g) = (vec![0.1; 13], vec![-0.2; 21]);
    let spoilt = |values: &[f64], at: usize| {
        let mut values = values.to_vec();
        values[at] = f64::NAN;
        values
    };
    let by_c = (0..c.len()).map(|at| (spoilt(&c, at), g.clone()));
    let by_g = (0..g.len()).map(|at| (c.clone(), spoilt(&g, at)));
    for (bad_c, bad_g) in by_c.chain(by_g) {
        assert!(infeasibility(&bad_c, &bad_g).is_nan());
        assert!(infeasibility_fall(&c, &g, &bad_c, &bad_g).is_nan());
        assert!(merit_fall(&c, &g, &bad_c, &bad_g, MU).is_nan());
        assert!(nonlinearity(&bad_c, &c, &bad_g, &g).is_nan());
    }
}

#[test]
fn falls_are_differences_of_the_plain_formulas() {
    for State { rows, .. } in states() {
        let [(c, g), (c_to, g_to)] = residuals_from_and_to(&rows);
        let (from, to) = (infeasibility_terms(&c, &g), infeasibility_terms(&c_to, &g_to));
        assert_falls(infeasibility_fall(&c, &g, &c_to, &g_to), &from, &to, SUM_TOLERANCE, "infeasibility");
        assert_falls(infeasibility_fall(&c_to, &g_to, &c, &g), &to, &from, SUM_TOLERANCE, "infeasibility, back");
        assert_eq!(infeasibility_fall(&c, &g, &c, &g), 0.);
        for mu in MUS {
            let (from, to) = (merit_terms(&c, &g, mu, 1.), merit_terms(&c_to, &g_to, mu, 1.));
            assert_falls(merit_fall(&c, &g, &c_to, &g_to, mu), &from, &to, SUM_TOLERANCE, "merit");
            assert_falls(merit_fall(&c_to, &g_to, &c, &g, mu), &to, &from, SUM_TOLERANCE, "merit, back");
            assert_eq!(merit_fall(&c, &g, &c, &g, mu), 0.);
            // No other slack is better.
            let with = |factor: f64| merit_terms(&c, &g, mu, factor).iter().sum::<f64>();
            assert!(with(1.01) > with(1.) && with(0.99) > with(1.));
        }
    }
}

#[test]
fn falls_to_a_point_nearby_are_good_in_f32() {
    let mut random = Random::new(19);
    // Differences of sums are not: otherwise this test would say nothing.
    let mut worst_of_sums = [0_f64; 2];
    for State { rows: Rows { c, g, .. }, .. } in states() {
        for (size, away) in [1., 1e-3].into_iter().flat_map(|size| [1e-2, 1e-4, 1e-6].map(|away| (size, away))) {
            // Equalities and violated rows go to zero together.
            let scaled = |values: &[f64]| values.iter().map(|v| if *v > 0. { size * v } else { *v }).collect::<Vec<f64>>();
            let c: Vec<f64> = c.iter().map(|c| size * c).collect();
            let ((c, wide_c), (g, wide_g)) = (narrow(&c), narrow(&scaled(&g)));
            let [(c_to, wide_c_to), (g_to, wide_g_to)] = [&wide_c, &wide_g].map(|values| narrow(&near(values, &mut random, away)));
            let (from, to) = (infeasibility_terms(&wide_c, &wide_g), infeasibility_terms(&wide_c_to, &wide_g_to));
            let error = f32_error(infeasibility_fall(&c, &g, &c_to, &g_to), &from, &to, &[]);
            assert!(error <= 1., "infeasibility, {size} of it, {away} away: {error}");
            worst_of_sums[0] = worst_of_sums[0].max(f32_error_of_sums(&from, &to, &[]));
            for mu in MUS {
                let mu = mu as f32;
                let (from, to) = (merit_terms(&wide_c, &wide_g, mu.into(), 1.), merit_terms(&wide_c_to, &wide_g_to, mu.into(), 1.));
                let error = f32_error(merit_fall(&c, &g, &c_to, &g_to, mu), &from, &to, &from);
                assert!(error <= 1., "merit, mu = {mu}, {size} of it, {away} away: {error}");
                worst_of_sums[1] = worst_of_sums[1].max(f32_error_of_sums(&from, &to, &from));
            }
        }
    }
    assert!(worst_of_sums.iter().all(|worst| *worst > 10.), "{worst_of_sums:?}");
}

#[test]
fn the_cost_of_the_pull_falls_by_its_plain_formula() {
    for State { layout, x, .. } in states() {
        let n = layout.variables;
        let pull: Vec<f64> = random_vector(16, n).iter().map(|v| v + 1.5).collect();
        let (initial, x) = (&layout.initial[..n], &x[..n]);
        let x_to: Vec<f64> = x.iter().zip(random_vector(20, n)).map(|(x, by)| x + 0.3 * by).collect();
        let (from, to) = (pull_terms(&pull, x, initial), pull_terms(&pull, &x_to, initial));
        assert!(from.iter().sum::<f64>() > 1.);
        assert_falls(smoothing_fall(&pull, x, &x_to, initial), &from, &to, SUM_TOLERANCE, "cost");
        assert_falls(smoothing_fall(&pull, &x_to, x, initial), &to, &from, SUM_TOLERANCE, "cost, back");
        // Initial values cost nothing.
        assert_falls(smoothing_fall(&pull, x, initial, initial), &from, &[], SUM_TOLERANCE, "whole cost");
        assert_eq!(smoothing_fall(&pull, x, x, initial), 0.);

        let mut random = Random::new(21);
        for away in [1e-2, 1e-4, 1e-6] {
            let [(pull, wide_pull), (initial, wide_initial), (x, wide_x)] = [&pull, initial, x].map(narrow);
            let (x_to, wide_x_to) = narrow(&near(&wide_x, &mut random, away));
            let (from, to) = (pull_terms(&wide_pull, &wide_x, &wide_initial), pull_terms(&wide_pull, &wide_x_to, &wide_initial));
            let error = f32_error(smoothing_fall(&pull, &x, &x_to, &initial), &from, &to, &from);
            assert!(error <= 1., "{away} away: {error}");
        }
    }
}

#[test]
fn slacks_start_where_their_products_are_the_barrier_parameter() {
    fn check<T: Real>(g: &[f64], tolerance: f64) {
        for mu in [1e-3, 0.05, 2.] {
            let g: Vec<T> = in_scalar(g);
            let unset = || vec![T::nan(); g.len()];
            let mut slacks = Slacks { slack: unset(), multiplier: unset(), slack_step: unset(), multiplier_step: unset() };
            start_slacks(&g, T::of(mu), &mut slacks);
            for ((g, s), z) in g.iter().zip(&slacks.slack).zip(&slacks.multiplier) {
                let expected = g.abs().as_f64().max((mu / 5.).sqrt());
                assert!((s.as_f64() - expected).abs() <= tolerance * expected, "slack {s:?} at {g:?}");
                assert!((z.as_f64() * expected - mu).abs() <= tolerance * mu, "multiplier {z:?} at {g:?}");
            }
        }
    }
    for State { rows: Rows { g, .. }, .. } in states() {
        assert!(g.iter().any(|g| g.abs() < 0.01) && g.iter().any(|g| *g > 1.) && g.iter().any(|g| *g < -1.));
        check::<f64>(&g, ELEMENTWISE_TOLERANCE);
        check::<f32>(&g, 4. * f64::from(f32::EPSILON));
    }
    // At the default barrier.
    let mut slacks = Slacks { slack: vec![0.; 3], multiplier: vec![0.; 3], ..Slacks::default() };
    start_slacks(&[-0.5, 0.02, 0.25], 0.05, &mut slacks);
    assert_close(&slacks.slack, &[0.5, 0.1, 0.25], ELEMENTWISE_TOLERANCE, "slack");
    assert_close(&slacks.multiplier, &[0.1, 0.5, 0.2], ELEMENTWISE_TOLERANCE, "multiplier");
}

#[test]
fn the_target_is_the_square_of_what_the_predictor_leaves() {
    for State { mut slacks, .. } in states() {
        let mean = |slacks: &Slacks<f64>, reach: f64| {
            let of =
                |i: usize| (slacks.slack[i] + reach * slacks.slack_step[i]) * (slacks.multiplier[i] + reach * slacks.multiplier_step[i]);
            (0..slacks.slack.len()).map(of).sum::<f64>() / slacks.slack.len() as f64
        };
        let close = |slacks: &Slacks<f64>, reach: f64, expected: f64| {
            let got = target(slacks, reach);
            assert!((got - expected).abs() <= SUM_TOLERANCE * expected, "reach {reach}: {got:e} against {expected:e}");
        };
        let before = mean(&slacks, 0.);
        close(&slacks, 0., before);
        // Nine tenths of every slack go, and nothing of the multipliers.
        slacks.slack_step = slacks.slack.iter().map(|s| -0.9 * s).collect();
        slacks.multiplier_step.fill(0.);
        close(&slacks, 1., before / 100.);
        // Some of both.
        slacks.multiplier_step = slacks.multiplier.iter().zip(random_vector(22, slacks.slack.len())).map(|(z, by)| 0.5 * z * by).collect();
        for reach in [0.1, 0.6, 1.] {
            let after = mean(&slacks, reach);
            assert!(after > 0. && after < before);
            close(&slacks, reach, after * after / before);
        }
        // It does not rise above what is, nor fall below its floor, not even where products turn negative.
        slacks.slack_step = slacks.slack.clone();
        close(&slacks, 1., before);
        slacks.multiplier_step.fill(0.);
        for part in [1., 1.5] {
            slacks.slack_step = slacks.slack.iter().map(|s| -part * s).collect();
            assert_eq!(target(&slacks, 1.), 1e-9);
        }
    }
}

#[test]
fn slack_steps_solve_the_linearised_conditions_and_keep_a_twentieth() {
    for settings in transcriptions() {
        for (aim, size) in AIMS.into_iter().flat_map(|aim| [1., 1e-3].map(|size| (aim, size))) {
            let State { layout, rows: Rows { g, .. }, mut slacks, .. } = state(&settings);
            let mut random = Random::new(13);
            let change: Vec<f64> = (0..layout.inequalities).map(|_| size * random.between(-1., 1.)).collect();
            let predicted = (slacks.slack_step.clone(), slacks.multiplier_step.clone());
            let step = slack_steps(&g, &change, aim, &mut slacks);
            let mut largest = f64::INFINITY;
            for i in 0..layout.inequalities {
                let (s, z, ds, dz) = (slacks.slack[i], slacks.multiplier[i], slacks.slack_step[i], slacks.multiplier_step[i]);
                let second_order = aim.correction * predicted.0[i] * predicted.1[i];
                // z = g + s with penalty 1, to first order; s z = mu, corrected by the predictor's steps.
                let (penalty, centre) = (g[i] + change[i] + s + ds - z - dz, s * z + s * dz + z * ds - aim.mu + second_order);
                let sizes =
                    [g[i].abs() + s + ds.abs() + z + dz.abs(), s * z + (s * dz).abs() + (z * ds).abs() + aim.mu + second_order.abs()];
                assert!(penalty.abs() <= ELEMENTWISE_TOLERANCE * sizes[0], "inequality {i}: {penalty:e}");
                assert!(centre.abs() <= ELEMENTWISE_TOLERANCE * sizes[1], "inequality {i}: {centre:e}");
                for (value, change) in [(s, ds), (z, dz)] {
                    if change < 0. {
                        largest = largest.min(-value / change);
                    }
                }
            }
            assert_close(&[step], &[(0.95 * largest).min(1.)], SUM_TOLERANCE, "step");

            let before = (slacks.slack.clone(), slacks.multiplier.clone());
            let after = |step: f64, i: usize| (before.0[i] + step * slacks.slack_step[i], before.1[i] + step * slacks.multiplier_step[i]);
            let mean = |step: f64| {
                let products = (0..layout.inequalities).map(|i| after(step, i)).map(|(s, z)| s * z);
                products.sum::<f64>() / layout.inequalities as f64
            };
            for length in [0., 0.3 * step, step] {
                assert_close(&[mean_product(&slacks, length)], &[mean(length)], SUM_TOLERANCE, "mean product ahead");
            }
            let expected: Vec<(f64, f64)> = (0..layout.inequalities).map(|i| after(step, i)).collect();
            update_slacks(&mut slacks, step);
            for (i, (s, z)) in expected.into_iter().enumerate() {
                assert_eq!((slacks.slack[i], slacks.multiplier[i]), (s.max(1e-6), z.max(1e-8)));
                assert!(s >= 0.049 * before.0[i] && z >= 0.049 * before.1[i]);
            }
        }
    }
}

#[test]
fn slacks_and_multipliers_stay_off_zero() {
    let mut slacks = Slacks { slack: vec![1., 2.], multiplier: vec![3., 4.], slack_step: vec![-1., 0.5], multiplier_step: vec![1., -4.] };
    update_slacks(&mut slacks, 0.5);
    assert_eq!((&slacks.slack, &slacks.multiplier), (&vec![0.5, 2.25], &vec![3.5, 2.]));
    update_slacks(&mut slacks, 1.);
    assert_eq!((&slacks.slack, &slacks.multiplier), (&vec![1e-6, 2.75], &vec![4.5, 1e-8]));
    // Those on the floor leave it when they grow.
    (slacks.slack_step, slacks.multiplier_step) = (vec![0.25, 0.], vec![0., 0.5]);
    update_slacks(&mut slacks, 1.);
    assert_eq!((slacks.slack, slacks.multiplier), (vec![0.250_001, 2.75], vec![4.5, 0.500_000_01]));
}
