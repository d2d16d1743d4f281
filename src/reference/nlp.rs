//! Nonlinear programs as general solvers take them: bounds, rows, and a sparse exact Jacobian; what such a solver is told, and what it tells.

use serde::{Deserialize, Serialize};

/// Anything at least as large is no limit.
pub const INFINITY: f64 = 1e20;

/// `lower <= x <= upper`, `lower_i <= row_i(x) <= upper_i`, and, in some, a smooth function to minimise.
pub trait Nlp {
    /// Where to start.
    fn initial(&self) -> &[f64];

    /// Lower and upper bound of each variable.
    fn bounds(&self) -> &[[f64; 2]];

    /// Pushes every row, in the same order and with the same entries at any `x`.
    fn rows(&self, x: &[f64], rows: &mut Rows);

    /// What is to be minimised, and its derivatives into `gradient`; zero unless a program says otherwise.
    fn objective(&self, x: &[f64], gradient: Option<&mut [f64]>) -> f64 {
        let _ = x;
        gradient.map_or(0., |g| {
            g.fill(0.);
            0.
        })
    }
}

/// Rows at a point, with their limits and derivatives.
#[derive(Debug, Default)]
pub struct Rows {
    /// Value of each row.
    pub values: Vec<f64>,
    /// Lower and upper limit of each row.
    pub limits: Vec<[f64; 2]>,
    /// `(row, variable, derivative)`; a pair may come more than once, and then its derivatives add up.
    pub entries: Vec<(u32, u32, f64)>,
}

impl Rows {
    /// Forgets all rows and keeps the memory.
    pub fn clear(&mut self) {
        self.values.clear();
        self.limits.clear();
        self.entries.clear();
    }

    /// Begins a row.
    pub fn row(&mut self, value: f64, limits: [f64; 2]) {
        self.values.push(value);
        self.limits.push(limits);
    }

    /// Derivative of the row begun last.
    pub fn entry(&mut self, variable: usize, derivative: f64) {
        self.entries.push((self.values.len() as u32 - 1, variable as u32, derivative));
    }
}

/// Which entries the Jacobian has, each once, and where each entry pushed by [`Nlp::rows`] goes.
#[derive(Debug)]
pub struct Pattern {
    /// `(row, variable)` of each value.
    pub entries: Vec<(u32, u32)>,
    slots: Vec<u32>,
}

impl Pattern {
    /// Pattern of the entries at any point.
    pub fn new(rows: &Rows) -> Pattern {
        let mut entries: Vec<(u32, u32)> = rows.entries.iter().map(|&(row, variable, _)| (row, variable)).collect();
        entries.sort_unstable();
        entries.dedup();
        let slot = |&(row, variable, _): &(u32, u32, f64)| entries.partition_point(|&entry| entry < (row, variable)) as u32;
        let slots = rows.entries.iter().map(slot).collect();
        Pattern { entries, slots }
    }

    /// Values of the Jacobian, in the order of [`Pattern::entries`].
    pub fn values(&self, rows: &Rows, into: &mut [f64]) {
        debug_assert_eq!(rows.entries.len(), self.slots.len(), "every point pushes the same entries");
        into.fill(0.);
        for (&(_, _, derivative), &slot) in rows.entries.iter().zip(&self.slots) {
            into[slot as usize] += derivative;
        }
    }
}

/// Options of Ipopt; all others are Ipopt's defaults but for a limited-memory Hessian and no output.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Options {
    /// `tol`.
    pub tolerance: f64,
    /// `max_iter`.
    pub max_iterations: usize,
    /// `max_cpu_time`, s.
    pub max_seconds: f64,
    /// `mu_init`, with starts pushed into their bounds by no more; Ipopt's own when absent. Small: the optimum near the start.
    pub barrier: Option<f64>,
}

impl Options {
    /// Those of the paper's lower level: 50 iterations, 5 s.
    pub const LOWER_LEVEL: Options = Options { tolerance: 1e-3, max_iterations: 50, max_seconds: 5., barrier: None };
    /// Those of the paper's baselines: 200 iterations, 40 s.
    pub const BASELINE: Options = Options { tolerance: 1e-3, max_iterations: 200, max_seconds: 40., barrier: None };
}

/// How a solve ended, and what it cost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// Ipopt's `ApplicationReturnStatus`: 0 solved, 1 to an acceptable level, 2 infeasible, -1 iteration limit, -4 time limit, ...
    pub status: i32,
    /// Iterations.
    pub iterations: usize,
    /// Wall time, s.
    pub seconds: f64,
    /// Part of it spent in rows and Jacobians, s.
    pub evaluation_seconds: f64,
    /// Variables, fixed ones included.
    pub n_variables: usize,
    /// Rows.
    pub n_constraints: usize,
    /// Entries of the Jacobian.
    pub nnz_jacobian: usize,
}
