//! Row residuals from node values, derived independently of the kernels.

use crate::common::{cones, towr};
use cregopt::gait::{Curve, FootCurves, Trajectory};
use cregopt::nlp::Problem;
use cregopt::nlp::transcription::force_limit;
use cregopt::robot::{GRAVITY, Slab};
use cregopt::task::Task;
use nalgebra::{Matrix3, Vector3};

/// Value, first and second derivative of a curve; the piece is a polynomial in seconds.
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

/// Rotation from base to world by the Euler angles roll, pitch, yaw, and its first two derivatives in time.
fn rotation([angles, rates, accelerations]: [Vector3<f64>; 3]) -> [Matrix3<f64>; 3] {
    // About one axis: R(a), R' = a' dR/da, R'' = a'' dR/da + a'^2 d2R/da2.
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

/// Defects of moment and force at time `t`: the rate of change of momentum, less gravity and the forces of the feet.
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

/// Scaled residuals of the reduced problem from TOWR's node values, in the order of the problem.
pub fn expected(task: &Task, nodes: &Trajectory, problem: &Problem<f64>) -> (Vec<f64>, Vec<f64>) {
    let (robot, settings) = (&task.robot, towr());
    let (weight, feet) = (robot.mass * GRAVITY, robot.feet());
    let leg = robot.nominal_feet[0][2].abs();
    let mut c = vec![f64::NAN; problem.rows.one_sided()];
    let mut g = vec![f64::NAN; problem.inequalities];

    let instants = (nodes.horizon / 0.1).round() as usize + 1;
    assert_eq!(problem.dynamics_instants.len(), instants);
    for (k, instant) in problem.dynamics_instants.iter().enumerate() {
        let [moment, force] = defect(task, nodes, k as f64 * 0.1);
        for d in 0..3 {
            c[instant.place.row as usize + d] = moment[d] / (weight * leg);
            c[instant.place.row as usize + 3 + d] = force[d] / weight;
        }
    }

    let mut times: Vec<f64> = (0..).map(|i| i as f64 * 0.08).take_while(|&t| t < nodes.horizon - 1e-9).collect();
    times.push(nodes.horizon);
    assert_eq!(problem.reach_instants.len(), times.len());
    for (instant, t) in problem.reach_rows.instants.iter().zip(times) {
        let base = at(&nodes.base_lin, t)[0];
        let to_base = rotation(at(&nodes.base_ang, t))[0].transpose();
        let mut numbers = instant.elements.range();
        for foot in 0..feet {
            let offset = to_base * (at(&nodes.ee[foot].motion, t)[0] - base) - Vector3::from(robot.nominal_feet[foot]);
            let slabs: Vec<Slab> = robot.reach.foot(foot).slabs().collect();
            for group in slabs.chunks(3) {
                let number = numbers.next().unwrap();
                for d in 0..3 {
                    // A group that is not full repeats its first slab.
                    let Slab { normal, sides: [low, high] } = group[if d < group.len() { d } else { 0 }];
                    let along = Vector3::from(normal).dot(&offset);
                    let row = problem.reach_rows.place(number).inequality as usize + d;
                    // In units of 0.1 m.
                    g[row] = (along - high + settings.length_margin) / 0.1;
                    g[row + 3] = (low - along + settings.length_margin) / 0.1;
                }
            }
        }
        assert_eq!(numbers.next(), None);
    }

    let (mut force_nodes, mut swing_nodes) = (problem.force_nodes.iter(), problem.swing_nodes.iter());
    let unit = weight / feet as f64;
    let margin = settings.force_margin * weight;
    for (foot, durations) in nodes.ee.iter().zip(&nodes.durations) {
        let stances = durations.len().div_ceil(2);
        for stance in 0..stances {
            // Motion nodes: two per stance, one per swing. Force nodes: four per stance.
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

/// Acceleration at both ends of a piece of a curve; at its start `p'' = (6 (q - p) - d (4 v + 2 w)) / d^2`.
pub fn accelerations(curve: &Curve, piece: usize) -> [Vector3<f64>; 2] {
    let d = curve.poly_durations[piece];
    let part = |node: usize, from: usize| Vector3::from_column_slice(&curve.nodes[node][from..from + 3]);
    let (displacement, v, w) = (part(piece + 1, 0) - part(piece, 0), part(piece, 3), part(piece + 1, 3));
    [(6. * displacement - d * (4. * v + 2. * w)) / (d * d), (d * (2. * v + 4. * w) - 6. * displacement) / (d * d)]
}

/// Cone rows from node values: at the Bezier points of the pieces of every stance, each once, except those next to its ends in the air.
pub fn expected_cones(task: &Task, nodes: &Trajectory, problem: &Problem<f64>) -> Vec<f64> {
    let settings = cones();
    let weight = task.robot.mass * GRAVITY;
    let (unit, margin, limit) = (weight / task.robot.feet() as f64, settings.force_margin * weight, force_limit(&settings, task));
    let mut g = vec![f64::NAN; problem.inequalities];
    let mut rows = problem.cones.iter();
    for (foot, durations) in nodes.ee.iter().zip(&nodes.durations) {
        let stances = durations.len().div_ceil(2);
        for stance in 0..stances {
            let foothold = foot.motion.nodes[3 * stance];
            let [hx, hy] = task.terrain.ground(foothold[0], foothold[1]).slope;
            let n = Vector3::new(-hx, -hy, 1.).normalize();
            let pieces = settings.force_pieces();
            let third = durations[2 * stance] / pieces as f64 / 3.;
            for node in usize::from(stance > 0)..pieces + usize::from(stance + 1 == stances) {
                let [value, slope] = [0, 3].map(|d| Vector3::from_column_slice(&foot.force.nodes[(pieces + 1) * stance + node][d..d + 3]));
                let before = if node == 0 { value } else { value - third * slope };
                let after = if node == pieces { value } else { value + third * slope };
                for f in [before, after] {
                    let (normal, tangential) = (n.dot(&f), n.cross(&f));
                    let row = rows.next().unwrap().place.inequality as usize;
                    g[row] = (normal - limit + margin) / unit;
                    // The margin rounds the tip.
                    g[row + 1] = (tangential.norm().hypot(margin) - task.terrain.friction * normal + margin) / unit;
                    g[row + 2] = (margin - normal) / unit;
                }
            }
        }
    }
    assert!(rows.next().is_none());
    g
}

/// Free body under gravity and the forces of the feet: position, velocity, angular momentum about the centre of mass.
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

    /// Integrates from `start` to `end` under forces that have nodes at `times`, in short steps between them.
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

    /// Impulses and their moments by four Gauss points; the displacement within a step is also integrated from the forces.
    fn stepped(self, task: &Task, nodes: &Trajectory, start: f64, step: f64) -> Body {
        let (inner, outer) = ((3. / 7. - 2. / 7. * 1.2_f64.sqrt()).sqrt(), (3. / 7. + 2. / 7. * 1.2_f64.sqrt()).sqrt());
        let (near, far) = ((18. + 30_f64.sqrt()) / 72., (18. - 30_f64.sqrt()) / 72.);
        let rule = [(-outer, far), (-inner, near), (inner, near), (outer, far)].map(|(x, w)| ((1. + x) / 2., w));
        let gravity = Vector3::new(0., 0., -GRAVITY);
        let of_foot = |foot: &FootCurves, t: f64| (at(&foot.motion, t)[0], at(&foot.force, t)[0]);
        let force = |t: f64| nodes.ee.iter().map(|foot| of_foot(foot, t).1).sum::<Vector3<f64>>();
        // Displacement after `u`: v u + g u^2 / 2 + int (u - s) f ds / m.
        let displacement = |u: f64| {
            let pushed: Vector3<f64> = rule.iter().map(|(x, w)| force(start + x * u) * (w * u * (1. - x) * u)).sum();
            self.velocity * u + gravity * (u * u / 2.) + pushed / task.robot.mass
        };
        let mut next = Body { position: self.position + displacement(step), velocity: self.velocity + gravity * step, ..self };
        for (x, w) in rule {
            let t = start + x * step;
            next.velocity += force(t) * (w * step / task.robot.mass);
            let position = self.position + displacement(x * step);
            for foot in &nodes.ee {
                let (place, f) = of_foot(foot, t);
                next.momentum += (place - position).cross(&f) * (w * step);
            }
        }
        next
    }
}

/// Scaled momentum residuals of the intervals from node values, in the order of the problem.
pub fn expected_momentum(task: &Task, nodes: &Trajectory, problem: &Problem<f64>) -> Vec<f64> {
    // Gauss-Legendre rule with six points: abscissae on (-1, 1), and weights that add up to 1.
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
    let (mass, h) = (task.robot.mass, problem.curves.interval);
    let weight = mass * GRAVITY;
    let leg = task.robot.nominal_feet[0][2].abs();
    // The attitude between two knots is the cubic through both; nodes in between serve the trajectory only.
    let pieces = nodes.base_lin.poly_durations.len() / problem.curves.intervals;
    let at_knots = |curve: &Curve| Curve {
        poly_durations: vec![h; problem.curves.intervals],
        nodes: curve.nodes.iter().copied().step_by(pieces).collect(),
    };
    let knots = Trajectory { base_lin: at_knots(&nodes.base_lin), base_ang: at_knots(&nodes.base_ang), ..nodes.clone() };
    let mut c = vec![f64::NAN; problem.rows.one_sided()];
    for (k, interval) in problem.momentum_intervals.iter().enumerate() {
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
