//! Cost of a motion as a sum of absolute values of smooth functions and a quadratic function, with derivatives.
//!
//! A stance leg has two powers, along the leg and across it. Their absolute values are integrated by the three-point Gauss-Legendre rule
//! between the joints of the curves that a power is made of. Every quadrature point is a [`Term`]: `cost = sum weight |power| + effort`.
//! With the powers linearised inside the absolute value this is convex and equals the cost to first order, however often powers change
//! sign. At an optimum many powers are zero over long times. [`crate::gait::cost`] integrates the absolute value of the parabola through
//! the same points: the result is equal where no power changes sign, and smooth where one does. Effort is quadratic in the forces and
//! linear in the durations of their pieces.
//!
//! Absolute values may be [`rounded`]. Without rounding, a motion with zero power at many points is stuck, because every change costs
//! something at first.
//!
//! Derivatives are exact, by dual numbers over the variables that affect an interval of base knots. This includes durations, because every
//! time in the interval is a dual number.

use super::variables::{Point, Space};
use crate::gait::cost::{CostWeights, distance};
use crate::gait::spline::{HERMITE_GRAM, hermite, hermite_acceleration, hermite_rate};
use crate::gait::swing::MID_SPEED;
use crate::nlp::transcription::momentum::PIECE;
use crate::quadrature::{GAUSS_3, GAUSS_3_NODE, GAUSS_3_WEIGHTS};
use crate::real::Number;
use crate::robot::{GRAVITY, MAX_FEET};
use crate::rows::table::NONE;
use nalgebra::{SVector, Vector3};
use num_dual::{Derivative, DualSVec64};
use rayon::prelude::*;

/// Sparse derivatives: variable and value.
pub(super) type Gradient = Vec<(usize, f64)>;

/// One quadrature step of a foot's power.
#[derive(Debug, Clone)]
pub(super) struct Cell {
    /// Identifies the cell among models with the same number of cells: interval, foot, number within these.
    pub key: [usize; 3],
    /// Weight of work in the cost, 1/J.
    pub weight: f64,
    /// Powers at the Gauss-Legendre points times half the length of the step, J.
    pub powers: [f64; 3],
    /// Derivatives of the powers: variable and values.
    pub by: Vec<(usize, [f64; 3])>,
}

/// A part `weight |value|` of the cost: the power at one point of a cell.
#[derive(Debug, Clone)]
pub(super) struct Term {
    /// Index of the cell in [`Model::cells`].
    pub cell: usize,
    /// Index of the power in the cell.
    pub point: usize,
    pub weight: f64,
    pub value: f64,
    pub by: Gradient,
}

impl Cell {
    /// Terms of the cell.
    fn terms(&self, cell: usize) -> impl Iterator<Item = Term> + '_ {
        (0..3).map(move |point| {
            let by = self.by.iter().map(|(i, by)| (*i, by[point])).filter(|(_, d)| *d != 0.).collect();
            Term { cell, point, weight: self.weight * GAUSS_3_WEIGHTS[point], value: self.powers[point], by }
        })
    }
}

/// Huber's function: absolute value, with a parabola around zero.
pub(super) fn rounded(value: f64, rounding: f64) -> f64 {
    if value.abs() < rounding { value * value / (2. * rounding) } else { value.abs() - 0.5 * rounding }
}

/// Derivative of [`rounded`].
pub(super) fn rounded_slope(value: f64, rounding: f64) -> f64 {
    if value.abs() < rounding { value / rounding } else { value.signum() }
}

/// Model of the cost around a point: first order in powers and durations, second order in forces.
#[derive(Debug, Clone, Default)]
pub(super) struct Model {
    /// Quadrature steps, ordered by their keys.
    pub cells: Vec<Cell>,
    pub terms: Vec<Term>,
    /// Rounding of the terms' absolute values, J.
    pub rounding: f64,
    /// Weighted effort cost.
    pub effort: f64,
    /// Derivatives of the effort, `[variables]`.
    pub effort_by: Vec<f64>,
    /// Second derivatives of the effort with respect to forces, upper triangle: row, column, value.
    pub effort_by_forces: Vec<(usize, usize, f64)>,
}

impl Model {
    /// Cost at the point.
    pub fn value(&self) -> f64 {
        self.terms.iter().map(|t| t.weight * rounded(t.value, self.rounding)).sum::<f64>() + self.effort
    }
}

/// Number of variables whose derivatives are computed in one pass.
const LANES: usize = 16;
type Dual = DualSVec64<LANES>;

/// Evaluation of the cost of motions in a space.
#[derive(Debug)]
pub(super) struct Price<'a> {
    space: &'a Space<'a>,
    /// Weights of leg work, 1/J, and of swing work, kg/J; the latter applies to work per kg of leg mass.
    work: [f64; 2],
    /// Weight of effort, 1/(N² s).
    effort: f64,
}

type Vec3<D> = Vector3<D>;
/// Position, attitude and their rates at a base node.
type State<D> = [Vec3<D>; 4];

fn vec3<D: Number>(v: Vector3<f64>) -> Vec3<D> {
    v.map(D::from)
}

/// One cubic piece of a force or a swing.
#[derive(Clone, Copy)]
struct Piece<D> {
    start: D,
    length: D,
    /// Value and slope at the start, value and slope at the end.
    nodes: [Vec3<D>; 4],
}

impl<D: Number> Piece<D> {
    fn sum(&self, weights: [D; 4]) -> Vec3<D> {
        let [a, b, c, d] = self.nodes;
        a * weights[0] + b * weights[1] + c * weights[2] + d * weights[3]
    }

    fn value(&self, time: D) -> Vec3<D> {
        self.sum(hermite(time - self.start, self.length))
    }

    fn first(&self, time: D) -> Vec3<D> {
        self.sum(hermite_rate(time - self.start, self.length))
    }

    fn second(&self, time: D) -> Vec3<D> {
        self.sum(hermite_acceleration(time - self.start, self.length))
    }
}

/// Curves of a foot within an interval.
struct Foot<D> {
    /// Times at which a power may have a kink: the joints of its curves, s.
    joints: Vec<D>,
    /// Cubic pieces: forces with their foothold, swings with `None`.
    pieces: Vec<(Piece<D>, Option<Vec3<D>>)>,
}

impl<'a> Price<'a> {
    /// Prepares the evaluation in a space.
    ///
    /// * `leg_mass` - equivalent mass of a leg at its foot, kg
    pub fn new(space: &'a Space<'a>, weights: &CostWeights, leg_mass: f64) -> Self {
        let (task, robot) = (space.task, &space.task.robot);
        let weight = robot.weight();
        let distance = distance(robot, std::array::from_fn(|i| task.goal.position[i] - task.start.position[i]), task.turn());
        Price {
            space,
            work: [weights.leg_work, weights.swing_work * leg_mass].map(|w| w / (weight * distance)),
            effort: weights.effort * (GRAVITY * robot.base_height).sqrt() / (weight * weight * distance),
        }
    }

    /// Cost at a point, with powers [`rounded`].
    pub fn value(&self, point: &Point, rounding: f64) -> f64 {
        self.sum(point, &|power| rounded(power, rounding))
    }

    /// Cost at a point, with absolute values of powers replaced by another function of the powers.
    pub fn sum(&self, point: &Point, size: &(impl Fn(f64) -> f64 + Sync)) -> f64 {
        let of_interval = |k: usize| {
            let mut cells = Vec::new();
            self.interval_powers(point, k, &|i| point.v[i], &mut cells);
            let cell =
                |(_, weight, powers): (usize, f64, [f64; 3])| (0..3).map(|i| weight * GAUSS_3_WEIGHTS[i] * size(powers[i])).sum::<f64>();
            cells.into_iter().map(cell).sum::<f64>()
        };
        // Summed in order, so that the result is bitwise equal for any number of threads.
        let sums: Vec<f64> = (0..self.space.intervals).into_par_iter().map(of_interval).collect();
        let mut model = Model::default();
        self.effort(point, &mut model);
        sums.iter().sum::<f64>() + model.effort
    }

    /// Model of the cost around a point, with powers [`rounded`].
    pub fn model(&self, point: &Point, rounding: f64) -> Model {
        let of_interval = |k: usize| self.interval_model(point, k);
        let cells: Vec<Vec<Cell>> = (0..self.space.intervals).into_par_iter().map(of_interval).collect();
        let cells: Vec<Cell> = cells.into_iter().flatten().collect();
        let terms = cells.iter().enumerate().flat_map(|(i, cell)| cell.terms(i)).collect();
        let mut model = Model { cells, terms, rounding, ..Model::default() };
        self.effort(point, &mut model);
        model
    }

    /// Effort and its derivatives.
    fn effort(&self, point: &Point, model: &mut Model) {
        let variables = &self.space.variables;
        let unit = point.problem.constants.force_unit;
        let interval = point.schedule.interval();
        model.effort_by = vec![0.; variables.count];
        for (foot, of_foot) in variables.feet.iter().enumerate() {
            for (stance, nodes) in of_foot.force_nodes.iter().enumerate() {
                let phase = point.problem.curves.feet[foot].phases[2 * stance];
                let pieces = (nodes.len() - 1) as f64;
                let price = self.effort * unit * unit / pieces;
                let mut mean = 0.;
                for piece in nodes.windows(2) {
                    let places = [piece[0], piece[0].map(|v| v + 3), piece[1], piece[1].map(|v| v + 3)];
                    for (i, a) in places.iter().enumerate() {
                        for (j, b) in places.iter().enumerate() {
                            let (Some(a), Some(b)) = (*a, *b) else { continue };
                            let second = 2. * HERMITE_GRAM[i][j] * price * phase.duration();
                            for d in 0..3 {
                                mean += HERMITE_GRAM[i][j] * point.v[a + d] * point.v[b + d];
                                model.effort_by[a + d] += second * point.v[b + d];
                                if a <= b {
                                    model.effort_by_forces.push((a + d, b + d, second));
                                }
                            }
                        }
                    }
                }
                model.effort += price * mean * phase.duration();
                // Derivatives with respect to the ends of the stance, in intervals, and to the interval.
                for (boundary, sign) in [((2 * stance).checked_sub(1), -1.), (Some(2 * stance), 1.)] {
                    let variable = boundary.and_then(|b| of_foot.boundaries.get(b).copied().flatten());
                    if let Some(at) = variable {
                        model.effort_by[at] += sign * price * mean * interval;
                    }
                }
                if let Some(at) = variables.interval {
                    model.effort_by[at] += price * mean * phase.duration() / interval;
                }
            }
        }
    }

    /// Cells of an interval with their derivatives.
    fn interval_model(&self, point: &Point, k: usize) -> Vec<Cell> {
        let local = self.locals(point, k);
        let mut cells: Vec<Cell> = Vec::new();
        let mut pass = Vec::new();
        for lanes in local.chunks(LANES) {
            pass.clear();
            let get = |i: usize| match lanes.binary_search(&i) {
                Ok(lane) => {
                    let mut unit = SVector::<f64, LANES>::zeros();
                    unit[lane] = 1.;
                    Dual::new(point.v[i], Derivative::some(unit))
                }
                Err(_) => Dual::from(point.v[i]),
            };
            self.interval_powers(point, k, &get, &mut pass);
            if cells.is_empty() {
                let mut number = [0; MAX_FEET];
                cells.extend(pass.iter().map(|&(foot, weight, powers)| {
                    number[foot] += 1;
                    Cell { key: [k, foot, number[foot]], weight, powers: powers.map(|p| p.re), by: Vec::new() }
                }));
            }
            for (cell, (_, _, powers)) in cells.iter_mut().zip(&pass) {
                let by = powers.map(|p| p.eps.0.unwrap_or_default());
                let lanes = lanes.iter().enumerate().map(|(lane, &i)| (i, by.map(|by| by[lane])));
                cell.by.extend(lanes.filter(|(_, by)| *by != [0.; 3]));
            }
        }
        cells
    }

    /// Variables that affect the terms of an interval, ascending.
    pub fn locals(&self, point: &Point, k: usize) -> Vec<usize> {
        let variables = &self.space.variables;
        let (t, h) = (k as f64 * point.schedule.interval(), point.schedule.interval());
        let mut local = Vec::new();
        let mut block = |at: Option<usize>, len: usize| local.extend(at.into_iter().flat_map(|at| at..at + len));
        variables.base[2 * k..2 * k + 4].iter().for_each(|&at| block(at, 6));
        for (foot, of_foot) in variables.feet.iter().enumerate() {
            for (i, phase) in point.problem.curves.feet[foot].phases.iter().enumerate() {
                if phase.end <= t || phase.start >= t + h {
                    continue;
                }
                if phase.stance {
                    of_foot.force_nodes[i / 2].iter().for_each(|&at| block(at, 6));
                    block(of_foot.footholds[i / 2], 2);
                } else {
                    block(of_foot.footholds[i / 2], 2);
                    block(of_foot.footholds[i / 2 + 1], 2);
                    block(of_foot.heights[i / 2], 1);
                }
                for boundary in [i.checked_sub(1), Some(i)].into_iter().flatten() {
                    block(of_foot.boundaries.get(boundary).copied().flatten(), 1);
                }
            }
        }
        block(variables.interval, 1);
        local.sort_unstable();
        local.dedup();
        local
    }

    /// Foot, weight, and powers times half the step, of every cell of an interval.
    fn interval_powers<D: Number>(&self, point: &Point, k: usize, get: &impl Fn(usize) -> D, cells: &mut Vec<(usize, f64, [D; 3])>) {
        let space = self.space;
        let h = space.variables.interval.map_or(D::from(point.schedule.interval()), get);
        let start = h * k as f64;
        let feet: Vec<Foot<D>> = (0..space.variables.feet.len()).map(|foot| self.foot(point, foot, start, h, get)).collect();
        let (first, last) = (self.knot(point, k, h, get), self.knot(point, k + 1, h, get));
        let pieces = (point.schedule.interval() / PIECE).ceil() as usize;
        let mut states = vec![first];
        self.between(&feet, &first, start, h, pieces, &mut states);
        states.push(last);
        let length = h / pieces as f64;
        for (foot, of_foot) in feet.iter().enumerate() {
            let mut cuts: Vec<D> = (0..=pieces).map(|q| start + length * q as f64).collect();
            let (low, high) = (cuts[0].re(), cuts[pieces].re());
            cuts.extend(of_foot.joints.iter().filter(|t| t.re() > low && t.re() < high));
            cuts.sort_by(|a, b| a.re().total_cmp(&b.re()));
            let [x, y, _] = space.task.robot.nominal_feet[foot];
            for cut in cuts.windows(2) {
                let (middle, half) = ((cut[0] + cut[1]) * 0.5, (cut[1] - cut[0]) * 0.5);
                let q = (((middle.re() - low) / length.re()) as usize).min(pieces - 1);
                let piece = |i: usize| Piece {
                    start: start + length * q as f64,
                    length,
                    nodes: [states[q][i], states[q][i + 2], states[q + 1][i], states[q + 1][i + 2]],
                };
                let base = [piece(0), piece(1)];
                let mine = of_foot.pieces.iter().find(|(p, _)| middle.re() < p.start.re() + p.length.re());
                let Some((mine, foothold)) = mine.or(of_foot.pieces.last()) else { continue };
                let times = [-GAUSS_3_NODE, 0., GAUSS_3_NODE].map(|node| middle + half * node);
                let mut cell = |weight: f64, powers: [D; 3]| cells.push((foot, weight, powers.map(|p| p * half)));
                match foothold {
                    Some(foothold) => {
                        let powers = times.map(|time| stance_powers(&mine.value(time), foothold, hip(&base, time, [x, y])));
                        cell(self.work[0], powers.map(|[along, _]| along));
                        cell(self.work[0], powers.map(|[_, across]| across));
                    }
                    None => {
                        cell(self.work[1], times.map(|time| mine.second(time).dot(&(mine.first(time) - hip(&base, time, [x, y])[1]))));
                    }
                }
            }
        }
    }

    /// Position, attitude and their rates at a knot.
    fn knot<D: Number>(&self, point: &Point, k: usize, h: D, get: &impl Fn(usize) -> D) -> State<D> {
        let (space, problem) = (self.space, &point.problem);
        let line = space.task.line(k as f64 / space.intervals as f64);
        let at = problem.curves.base[2 * k] as usize;
        let pose = |d: usize| space.variables.base[2 * k].map_or(D::from(point.x[at + d]), |v| get(v + d)) + line[d];
        // A fixed rate is the rate at an end of the motion.
        let end = if k == 0 { space.task.start.rate() } else { space.task.goal.rate() };
        let slower = h.recip() * space.interval;
        let rate = |d: usize| space.variables.base[2 * k + 1].map_or(D::from(end[d]), |v| get(v + d) * slower);
        let of = |f: &dyn Fn(usize) -> D, first: usize| Vec3::new(f(first), f(first + 1), f(first + 2));
        [of(&pose, 0), of(&pose, 3), of(&rate, 0), of(&rate, 3)]
    }

    /// Curves of a foot in the interval that starts at `from`.
    fn foot<D: Number>(&self, point: &Point, foot: usize, from: D, h: D, get: &impl Fn(usize) -> D) -> Foot<D> {
        let (space, blocks) = (self.space, &point.problem.curves.feet[foot]);
        let variables = &space.variables.feet[foot];
        let (low, high) = (from.re(), from.re() + h.re());
        let last = blocks.phases.len() - 1;
        let boundary = |i: usize| variables.boundaries[i].map_or(D::from(space.boundary(&point.v, foot, i)), get) * h;
        let foothold = |stance: usize| {
            let at = blocks.footholds[stance] as usize;
            let of = |d: usize| variables.footholds[stance].map_or(D::from(point.x[at + d]), |v| get(v + d));
            let ground = space.task.terrain.ground(point.x[at], point.x[at + 1]);
            let (x, y) = (of(0), of(1));
            let height = (x - point.x[at]) * ground.slope[0] + (y - point.x[at + 1]) * ground.slope[1] + ground.height;
            Vec3::new(x, y, height)
        };
        let mut result = Foot { joints: Vec::new(), pieces: Vec::new() };
        for (i, phase) in blocks.phases.iter().enumerate() {
            if phase.end <= low || phase.start >= high {
                continue;
            }
            let start = if i == 0 { D::from(0.) } else { boundary(i - 1) };
            let end = if i == last { h * space.intervals as f64 } else { boundary(i) };
            result.joints.extend([start, end]);
            if phase.stance {
                let (nodes, under) = (&blocks.force_nodes[i / 2], foothold(i / 2));
                let pieces = nodes.len() - 1;
                let length = (end - start) / pieces as f64;
                let unit = point.problem.constants.force_unit;
                for piece in 0..pieces {
                    let begin = start + length * piece as f64;
                    result.joints.push(begin);
                    if begin.re() + length.re() <= low || begin.re() >= high {
                        continue;
                    }
                    let slower = length.recip() * unit;
                    let node = |n: usize| match variables.force_nodes[i / 2][n] {
                        None => [Vec3::from_element(D::from(0.)); 2],
                        Some(v) => [
                            Vec3::new(get(v), get(v + 1), get(v + 2)) * D::from(unit),
                            Vec3::new(get(v + 3), get(v + 4), get(v + 5)) * slower,
                        ],
                    };
                    let ([a, b], [c, d]) = (node(piece), node(piece + 1));
                    debug_assert!(variables.force_nodes[i / 2][piece].is_some() || nodes[piece] == NONE);
                    result.pieces.push((Piece { start: begin, length, nodes: [a, b, c, d] }, Some(under)));
                }
            } else {
                let (a, b) = (foothold(i / 2), foothold(i / 2 + 1));
                let length = (end - start) * 0.5;
                let height = variables.heights[i / 2].map_or(D::from(point.x[blocks.heights[i / 2] as usize]), get);
                let zero = Vec3::from_element(D::from(0.));
                let mut middle = (a + b) * D::from(0.5);
                middle.z = height;
                let mut speed = (b - a) * ((end - start).recip() * MID_SPEED);
                speed.z = D::from(0.);
                result.joints.push(start + length);
                result.pieces.push((Piece { start, length, nodes: [a, zero, middle, speed] }, None));
                result.pieces.push((Piece { start: start + length, length, nodes: [middle, speed, b, zero] }, None));
            }
        }
        result
    }

    /// States at the starts of the interval's pieces from the second on, as in the trajectory of the transcription.
    fn between<D: Number>(&self, feet: &[Foot<D>], first: &State<D>, start: D, h: D, pieces: usize, states: &mut Vec<State<D>>) {
        let robot = &self.space.task.robot;
        let mass = robot.mass;
        let gravity = Vector3::new(0., 0., -GRAVITY);
        let inertia = nalgebra::Matrix3::from_fn(|r, c| robot.inertia[r][c]);
        let inverse = inertia.try_inverse().unwrap_or_else(nalgebra::Matrix3::zeros);
        let [p, angles, v, rates] = *first;
        let step = h / (2 * pieces) as f64;
        let at_start = {
            let [x, y, z] = axes(&angles);
            inertia_times(&inertia, &angles, &(x * rates.x + y * rates.y + z * rates.z))
        };
        let rates_at = |angles: &Vec3<D>, momentum: &Vec3<D>| {
            let omega = inertia_times(&inverse, angles, momentum);
            let ((sy, cy), (sz, cz)) = (angles.y.sin_cos(), angles.z.sin_cos());
            let roll = (cz * omega.x + sz * omega.y) / cy;
            Vec3::new(roll, cz * omega.y - sz * omega.x, omega.z + sy * roll)
        };
        let zero = Vec3::from_element(D::from(0.));
        // Integrals of the forces so far, and of their moment about the initial base position.
        let (mut first, mut second, mut third, mut moment) = (zero, zero, zero, zero);
        let mut now = angles;
        let mut gained = zero;
        let half = step * 0.5;
        for i in 0..2 * (pieces - 1) {
            let mut halfway = zero;
            let (mut moved, mut velocity) = (zero, v);
            for part in 0..2 {
                let from = start + step * i as f64 + half * part as f64;
                let to = from + half;
                let (mut j, mut w, mut q) = (zero, zero, zero);
                for (piece, foothold) in feet.iter().flat_map(|f| &f.pieces) {
                    let Some(foothold) = foothold else { continue };
                    let end = piece.start + piece.length;
                    let low = if piece.start.re() > from.re() { piece.start } else { from };
                    let high = if end.re() < to.re() { end } else { to };
                    if low.re() >= high.re() {
                        continue;
                    }
                    let mut impulse = zero;
                    for [node, weight] in GAUSS_3 {
                        let time = low + (high - low) * node;
                        let force = piece.value(time) * ((high - low) * weight);
                        let left = to - time;
                        impulse += force;
                        w += force * left;
                        q += force * (left * left * 0.5);
                    }
                    moment += (foothold - p).cross(&impulse);
                    j += impulse;
                }
                third += second * half + first * (half * half * 0.5) + q;
                second += first * half + w;
                first += j;
                let tau = to - start;
                velocity = v + vec3::<D>(gravity) * tau + first / D::from(mass);
                moved = v * tau + vec3::<D>(gravity) * (tau * tau * 0.5) + second / D::from(mass);
                let lever = v * (tau * tau * (0.5 * mass)) + third;
                let here = moment + lever.cross(&vec3(gravity)) - moved.cross(&velocity) * D::from(mass);
                if part == 0 {
                    halfway = here;
                } else {
                    let k1 = rates_at(&now, &(at_start + gained));
                    let k2 = rates_at(&(now + k1 * half), &(at_start + halfway));
                    let k3 = rates_at(&(now + k2 * half), &(at_start + halfway));
                    let k4 = rates_at(&(now + k3 * step), &(at_start + here));
                    now += (k1 + (k2 + k3) * D::from(2.) + k4) * (step / 6.);
                    gained = here;
                }
            }
            if i % 2 == 1 {
                states.push([p + moved, now, velocity, rates_at(&now, &(at_start + gained))]);
            }
        }
    }
}

/// Rotation axes of roll, pitch and yaw, world frame.
fn axes<D: Number>(angles: &Vec3<D>) -> [Vec3<D>; 3] {
    let ((sy, cy), (sz, cz)) = (angles.y.sin_cos(), angles.z.sin_cos());
    let (zero, one) = (D::from(0.), D::from(1.));
    [Vec3::new(cy * cz, cy * sz, -sy), Vec3::new(-sz, cz, zero), Vec3::new(zero, zero, one)]
}

/// Axes of the base, world frame.
fn base_axes<D: Number>(angles: &Vec3<D>) -> [Vec3<D>; 3] {
    let ((sx, cx), (sy, cy), (sz, cz)) = (angles.x.sin_cos(), angles.y.sin_cos(), angles.z.sin_cos());
    [
        Vec3::new(cy * cz, cy * sz, -sy),
        Vec3::new(sx * sy * cz - cx * sz, sx * sy * sz + cx * cz, sx * cy),
        Vec3::new(cx * sy * cz + sx * sz, cx * sy * sz - sx * cz, cx * cy),
    ]
}

/// `R M R' v`.
fn inertia_times<D: Number>(matrix: &nalgebra::Matrix3<f64>, angles: &Vec3<D>, v: &Vec3<D>) -> Vec3<D> {
    let axes = base_axes(angles);
    let in_base = Vec3::new(axes[0].dot(v), axes[1].dot(v), axes[2].dot(v));
    let row = |r: usize| in_base.x * matrix[(r, 0)] + in_base.y * matrix[(r, 1)] + in_base.z * matrix[(r, 2)];
    axes[0] * row(0) + axes[1] * row(1) + axes[2] * row(2)
}

/// Position and velocity of a hip at (x, y) in the base frame, and angular velocity of the base, from the pieces of position and attitude.
fn hip<D: Number>([lin, ang]: &[Piece<D>; 2], time: D, [x, y]: [f64; 2]) -> [Vec3<D>; 3] {
    let (angles, rates) = (ang.value(time), ang.first(time));
    let [roll, pitch, yaw] = axes(&angles);
    let omega = roll * rates.x + pitch * rates.y + yaw * rates.z;
    let [bx, by, _] = base_axes(&angles);
    let arm = bx * D::from(x) + by * D::from(y);
    [lin.value(time) + arm, lin.first(time) + omega.cross(&arm), omega]
}

/// Powers of a stance leg along the leg and across it.
fn stance_powers<D: Number>(force: &Vec3<D>, foothold: &Vec3<D>, [hip, velocity, omega]: [Vec3<D>; 3]) -> [D; 2] {
    let leg = foothold - hip;
    let along = -force.dot(&leg) * velocity.dot(&leg) / leg.dot(&leg);
    [along, -force.dot(&(velocity + omega.cross(&leg))) - along]
}
