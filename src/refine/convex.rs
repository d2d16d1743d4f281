//! Convex problem around a point, solved by Clarabel.
//!
//! The unknowns are the step `d` (in trust lengths) and, for each [`Term`] whose sign may change within the trust region, its positive and
//! negative parts `p`, `n`, and a squared part `s` if terms are rounded:
//!
//! ```text
//! minimise    sum weight (p + n + s^2 / (2 rounding)) + sum weight sign (value + by . d)
//!             + effort + effort' d + d' (effort'' + curvature) d / 2
//! such that   value + by . d = p - n + s,  p >= 0,  n >= 0
//!             c + c' d = 0
//!             g + g' d <= 0, or as close to it as half the trust region allows
//!             |(tangential force, m)| <= mu (normal force) - m      second-order cones
//!             |d| <= trust
//! ```
//!
//! Rows and terms that no step within the trust region can activate are left out. The solution is the same.

use super::convex_cost::{Gradient, Model, Term, rounded, rounded_slope};
use super::curvature::Curvature;
use super::rows::{Linear, Row};
use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT};

/// Accuracy of the convex problem. Too large: inaccurate multipliers; too small: rounding prevents Clarabel from reaching it.
const CLARABEL_TOLERANCE: f64 = 1e-8;

/// Solution of the convex problem.
#[derive(Debug, Clone)]
pub(super) struct Step {
    /// Step, in the units of the variables.
    pub by: Vec<f64>,
    /// Predicted decrease of the cost: first order in the variables, second order in the forces.
    pub predicted: f64,
    /// Largest derivative of the Lagrangian without the trust region, see [`super::Optimality`], relative to the cost.
    pub stationarity: f64,
    /// Largest product of a row's multiplier and its distance from the limit, relative to the cost.
    pub complementarity: f64,
    /// Multipliers of rows and powers, in costs.
    pub multipliers: Multipliers,
}

/// Multipliers of rows and powers in the Lagrangian.
#[derive(Debug, Clone)]
pub(super) struct Multipliers {
    equalities: Vec<f64>,
    inequalities: Vec<f64>,
    /// Multipliers of the powers of each cell, with its key.
    cells: Vec<([usize; 3], [f64; 3])>,
}

impl Multipliers {
    /// Derivative of the Lagrangian, without effort and cones, with respect to a step in trust lengths.
    ///
    /// Powers of cells without a stored multiplier are weighted by their sign.
    pub fn lagrangian(&self, linear: &Linear, model: &Model, length: &[f64]) -> Vec<f64> {
        let mut by = vec![0.; length.len()];
        let mut add = |gradient: &Gradient, weight: f64| gradient.iter().for_each(|&(i, d)| by[i] += weight * d * length[i]);
        let rows = linear.equalities.iter().zip(&self.equalities).chain(linear.inequalities.iter().zip(&self.inequalities));
        rows.filter(|(_, weight)| **weight != 0.).for_each(|(row, weight)| add(&row.by, *weight));
        let mut strange = vec![true; model.cells.len()];
        for (i, cell) in model.cells.iter().enumerate() {
            let Ok(at) = self.cells.binary_search_by(|(key, _)| key.cmp(&cell.key)) else { continue };
            strange[i] = false;
            let weights = self.cells[at].1;
            for (variable, d) in &cell.by {
                add(&vec![(*variable, (0..3).map(|p| weights[p] * d[p]).sum())], 1.);
            }
        }
        for term in model.terms.iter().filter(|t| strange[t.cell]) {
            add(&term.by, term.weight * rounded_slope(term.value, model.rounding));
        }
        by
    }
}

/// Constraint matrix under construction, row by row: `b - A x` in a cone.
#[derive(Default)]
struct Constraints {
    rows: Vec<usize>,
    columns: Vec<usize>,
    values: Vec<f64>,
    b: Vec<f64>,
    cones: Vec<SupportedConeT<f64>>,
}

impl Constraints {
    /// Adds the slack `room - by . d`.
    fn slack(&mut self, room: f64, by: impl IntoIterator<Item = (usize, f64)>) {
        let row = self.b.len();
        for (column, value) in by {
            self.rows.push(row);
            self.columns.push(column);
            self.values.push(value);
        }
        self.b.push(room);
    }

    /// Puts the slacks from `from` on into a cone.
    fn cone(&mut self, from: usize, cone: impl Fn(usize) -> SupportedConeT<f64>) {
        if self.b.len() > from {
            self.cones.push(cone(self.b.len() - from));
        }
    }
}

/// Largest change of a row within the trust region.
fn reach(by: &Gradient, step: &[f64], trust: f64) -> f64 {
    by.iter().map(|&(i, d)| (d * step[i]).abs()).sum::<f64>() * trust
}

/// Solves the convex problem around a point; `None` if Clarabel fails.
///
/// * `length` - trust length of each variable
pub(super) fn solve(linear: &Linear, model: &Model, curvature: &Curvature, length: &[f64], trust: f64) -> Option<Step> {
    let subproblem = Subproblem::new(linear, model, curvature, length, trust);
    let (p, q) = subproblem.objective();
    let (constraints, starts) = subproblem.constraints();
    let Constraints { rows, columns, values, b, cones } = constraints;
    let a = CscMatrix::new_from_triplets(b.len(), q.len(), rows, columns, values);
    let settings = DefaultSettings {
        verbose: false,
        max_iter: 100,
        tol_gap_abs: CLARABEL_TOLERANCE,
        tol_gap_rel: CLARABEL_TOLERANCE,
        tol_feas: CLARABEL_TOLERANCE,
        presolve_enable: false,
        direct_solve_method: "qdldl".into(),
        max_threads: 1,
        ..DefaultSettings::default()
    };
    let mut solver = DefaultSolver::new(&p, &q, &a, &b, &cones, settings).ok()?;
    solver.solve();
    let solution = &solver.solution;
    if !matches!(solution.status, SolverStatus::Solved | SolverStatus::AlmostSolved | SolverStatus::InsufficientProgress) {
        return None;
    }
    let scaled = &solution.x[..length.len()];
    let d: Vec<f64> = scaled.iter().zip(length).map(|(d, l)| d * l).collect();
    if d.iter().any(|d| !d.is_finite()) {
        return None;
    }
    let after = predict(model, &d) + 0.5 * subproblem.cost * curvature.along(scaled);
    Some(Step {
        by: d,
        predicted: subproblem.cost - after,
        stationarity: subproblem.stationarity(scaled, &solution.z, &starts),
        complementarity: subproblem.complementarity(&b, &solution.z, &starts),
        multipliers: subproblem.multipliers(&solution.z, &starts),
    })
}

/// The convex problem. Its unknowns are the step, the parts of the open terms, their squared parts, and the components of the step along
/// the curved directions, in this order.
struct Subproblem<'a> {
    linear: &'a Linear,
    model: &'a Model,
    curvature: &'a Curvature,
    /// Trust length of each variable.
    length: &'a [f64],
    trust: f64,
    /// Cost at the point. Costs in the problem are relative to it, so that tolerances mean the same for every gait.
    cost: f64,
    /// Terms whose sign may change within the trust region.
    open: Vec<&'a Term>,
    /// All other terms.
    settled: Vec<&'a Term>,
    /// Inequalities that may become active within the trust region, with their indices.
    near: Vec<(usize, &'a Row)>,
}

/// First constraint of each kind.
struct Starts {
    terms: usize,
    inequalities: usize,
    parts: usize,
    trust: usize,
    cones: usize,
}

impl<'a> Subproblem<'a> {
    fn new(linear: &'a Linear, model: &'a Model, curvature: &'a Curvature, length: &'a [f64], trust: f64) -> Subproblem<'a> {
        let (open, settled) = model.terms.iter().partition(|t| reach(&t.by, length, trust) >= t.value.abs() - model.rounding);
        let near = |(_, row): &(usize, &Row)| {
            let change = reach(&row.by, length, trust);
            row.value + change > 0. || row.lower.is_some_and(|lower| lower + change > 0.)
        };
        let near = linear.inequalities.iter().enumerate().filter(near).collect();
        Subproblem { linear, model, curvature, length, trust, cost: model.value(), open, settled, near }
    }

    /// Index of the first squared part of an open term.
    fn squares(&self) -> usize {
        self.length.len() + 2 * self.open.len()
    }

    /// Number of squared parts.
    fn n_squares(&self) -> usize {
        if self.model.rounding > 0. { self.open.len() } else { 0 }
    }

    /// Index of the first component along a curved direction.
    fn bends(&self) -> usize {
        self.squares() + self.n_squares()
    }

    /// Derivatives with respect to the step in trust lengths.
    fn scaled(&self, by: &Gradient) -> Gradient {
        by.iter().map(|&(i, d)| (i, d * self.length[i])).collect()
    }

    /// Quadratic and linear part of the objective.
    fn objective(&self) -> (CscMatrix<f64>, Vec<f64>) {
        let Subproblem { model, curvature, length, cost, .. } = self;
        let mut q: Vec<f64> = model.effort_by.iter().zip(*length).map(|(d, l)| d * l / cost).collect();
        for term in &self.settled {
            term.by.iter().for_each(|&(i, d)| q[i] += term.weight * term.value.signum() * d * length[i] / cost);
        }
        q.extend(self.open.iter().flat_map(|t| [t.weight / cost; 2]));
        let (mut rows, mut columns, mut values): (Vec<_>, Vec<_>, Vec<_>) = (0..length.len()).map(|i| (i, i, curvature.least)).collect();
        for &(a, b, second) in &model.effort_by_forces {
            rows.push(a);
            columns.push(b);
            values.push(second * length[a] * length[b] / cost);
        }
        for (i, term) in self.open[..self.n_squares()].iter().enumerate() {
            rows.push(self.squares() + i);
            columns.push(self.squares() + i);
            values.push(term.weight / (cost * model.rounding));
            q.push(0.);
        }
        for (i, (bend, _)) in curvature.directions.iter().enumerate() {
            rows.push(self.bends() + i);
            columns.push(self.bends() + i);
            values.push(*bend);
            q.push(0.);
        }
        (CscMatrix::new_from_triplets(q.len(), q.len(), rows, columns, values), q)
    }

    fn constraints(&self) -> (Constraints, Starts) {
        let (n, length, trust) = (self.length.len(), self.length, self.trust);
        let mut constraints = Constraints::default();
        for row in &self.linear.equalities {
            constraints.slack(-row.value, self.scaled(&row.by));
        }
        for (i, (_, direction)) in self.curvature.directions.iter().enumerate() {
            let by = direction.iter().copied().enumerate().filter(|(_, d)| *d != 0.);
            constraints.slack(0., by.chain([(self.bends() + i, -1.)]));
        }
        let terms = constraints.b.len();
        for (i, term) in self.open.iter().enumerate() {
            let square = (self.n_squares() > 0).then_some((self.squares() + i, -1.));
            let parts = [(n + 2 * i, -1.), (n + 2 * i + 1, 1.)];
            constraints.slack(-term.value, self.scaled(&term.by).into_iter().chain(parts).chain(square));
        }
        constraints.cone(0, SupportedConeT::ZeroConeT);
        let inequalities = constraints.b.len();
        for (_, row) in &self.near {
            // A violated row is repaired as far as half the trust region allows.
            let most = -0.5 * reach(&row.by, length, trust);
            constraints.slack((-row.value).max(most), self.scaled(&row.by));
            if let Some(lower) = row.lower {
                constraints.slack((-lower).max(most), self.scaled(&row.by).into_iter().map(|(i, d)| (i, -d)));
            }
        }
        let parts = constraints.b.len();
        for i in 0..2 * self.open.len() {
            constraints.slack(0., [(n + i, -1.)]);
        }
        let of_trust = constraints.b.len();
        for i in 0..n {
            constraints.slack(trust, [(i, 1.)]);
            constraints.slack(trust, [(i, -1.)]);
        }
        constraints.cone(inequalities, SupportedConeT::NonnegativeConeT);
        let cones = constraints.b.len();
        for cone in &self.linear.cones {
            let at = constraints.b.len();
            // A force outside its cone may stay as far outside.
            let [room, t @ ..] = cone.value;
            let size = (t.iter().map(|t| t * t).sum::<f64>() + cone.margin * cone.margin).sqrt();
            constraints.slack(room.max(size), self.scaled(&cone.by[0]).into_iter().map(|(i, d)| (i, -d)));
            for (value, by) in t.iter().zip(&cone.by[1..]) {
                constraints.slack(*value, self.scaled(by).into_iter().map(|(i, d)| (i, -d)));
            }
            constraints.slack(cone.margin, []);
            constraints.cone(at, SupportedConeT::SecondOrderConeT);
        }
        (constraints, Starts { terms, inequalities, parts, trust: of_trust, cones })
    }

    /// Stationarity at the point, see [`Step::stationarity`]: the part that trust region and curvature had to balance.
    ///
    /// * `d` - step in trust lengths
    /// * `z` - multipliers of the constraints
    fn stationarity(&self, d: &[f64], z: &[f64], starts: &Starts) -> f64 {
        let mut bend = self.curvature.times(d);
        for &(i, j, second) in &self.model.effort_by_forces {
            let second = second * self.length[i] * self.length[j] / self.cost;
            bend[i] += second * d[j];
            if i != j {
                bend[j] += second * d[i];
            }
        }
        let held = |i: usize| z[starts.trust + 2 * i] - z[starts.trust + 2 * i + 1];
        (0..d.len()).map(|i| (held(i) + bend[i]).abs()).fold(0., f64::max)
    }

    /// Complementarity at the point, see [`Step::complementarity`].
    ///
    /// * `b` - slacks of the constraints at the point
    /// * `z` - multipliers of the constraints
    fn complementarity(&self, b: &[f64], z: &[f64], starts: &Starts) -> f64 {
        let of_inequalities = (starts.inequalities..starts.parts).map(|i| z[i] * b[i]);
        let of_cones = self.linear.cones.iter().enumerate().map(|(i, cone)| {
            let z = &z[starts.cones + 5 * i..][..5];
            let [room, t @ ..] = cone.value;
            (room * z[0] + t.iter().zip(&z[1..]).map(|(t, z)| t * z).sum::<f64>() + cone.margin * z[4]).abs()
        });
        of_inequalities.chain(of_cones).fold(0., f64::max)
    }

    /// Multipliers of rows and powers from those of the constraints.
    fn multipliers(&self, z: &[f64], starts: &Starts) -> Multipliers {
        let Subproblem { linear, model, cost, .. } = self;
        let mut multipliers = Multipliers {
            equalities: z[..linear.equalities.len()].iter().map(|z| z * cost).collect(),
            inequalities: vec![0.; linear.inequalities.len()],
            cells: model.cells.iter().map(|c| (c.key, [0.; 3])).collect(),
        };
        let mut at = starts.inequalities;
        for &(i, row) in &self.near {
            multipliers.inequalities[i] = cost * (z[at] - if row.lower.is_some() { z[at + 1] } else { 0. });
            at += 1 + usize::from(row.lower.is_some());
        }
        let mut add = |term: &Term, multiplier: f64| {
            let (_, cell) = &mut multipliers.cells[term.cell];
            cell[term.point] = multiplier;
        };
        self.settled.iter().for_each(|term| add(term, term.weight * term.value.signum()));
        for (i, term) in self.open.iter().enumerate() {
            add(term, cost * z[starts.terms + i]);
        }
        multipliers
    }
}

/// Cost after a step according to the model.
fn predict(model: &Model, d: &[f64]) -> f64 {
    let along = |by: &Gradient| by.iter().map(|&(i, by)| by * d[i]).sum::<f64>();
    let terms = model.terms.iter().map(|t| t.weight * rounded(t.value + along(&t.by), model.rounding)).sum::<f64>();
    let first: f64 = model.effort_by.iter().zip(d).map(|(by, d)| by * d).sum();
    let second = |&(a, b, second): &(usize, usize, f64)| second * d[a] * d[b] * if a == b { 0.5 } else { 1. };
    terms + model.effort + first + model.effort_by_forces.iter().map(second).sum::<f64>()
}
