//! Interface of nonlinear programs for general solvers: bounds, rows with a sparse exact Jacobian, options and statistics of a solve.

use serde::{Deserialize, Serialize};

/// Limits of at least this magnitude count as no limit.
pub const INFINITY: f64 = 1e20;

/// Nonlinear program: `lower <= x <= upper`, `lower_i <= row_i(x) <= upper_i`, and optionally a smooth function to minimise.
pub trait Nlp {
    /// Initial point and bounds.
    fn variables(&self) -> &Variables;

    /// Pushes every row, in the same order and with the same entries at any `x`.
    fn rows(&self, x: &[f64], rows: &mut Rows);

    /// Function to minimise; writes its derivatives into `gradient`. Zero by default.
    fn objective(&self, x: &[f64], gradient: Option<&mut [f64]>) -> f64 {
        let _ = x;
        gradient.map_or(0., |g| {
            g.fill(0.);
            0.
        })
    }
}

/// Initial point and bounds of a program.
#[derive(Debug, Default)]
pub struct Variables {
    /// Initial point.
    pub initial: Vec<f64>,
    /// Lower and upper bound of each variable.
    pub bounds: Vec<[f64; 2]>,
}

impl Variables {
    /// Adds a free variable and returns its index.
    pub fn free(&mut self, initial: f64) -> usize {
        self.bounded(initial, [-INFINITY, INFINITY])
    }

    /// Adds a variable with bounds and returns its index.
    pub fn bounded(&mut self, initial: f64, bounds: [f64; 2]) -> usize {
        self.initial.push(initial);
        self.bounds.push(bounds);
        self.initial.len() - 1
    }

    /// Fixes a variable.
    pub fn fix(&mut self, variable: usize, value: f64) {
        self.bounds[variable] = [value, value];
    }
}

/// Rows at a point, with their limits and derivatives.
#[derive(Debug, Default)]
pub struct Rows {
    /// Value of each row.
    pub values: Vec<f64>,
    /// Lower and upper limit of each row.
    pub limits: Vec<[f64; 2]>,
    /// Derivatives `(row, variable, derivative)`. Those of repeated pairs are added.
    pub entries: Vec<(u32, u32, f64)>,
}

impl Rows {
    /// Removes all rows and keeps the allocated memory.
    pub fn clear(&mut self) {
        self.values.clear();
        self.limits.clear();
        self.entries.clear();
    }

    /// Starts a new row.
    pub fn row(&mut self, value: f64, limits: [f64; 2]) {
        self.values.push(value);
        self.limits.push(limits);
    }

    /// Adds a derivative of the most recent row.
    pub fn entry(&mut self, variable: usize, derivative: f64) {
        self.entries.push((self.values.len() as u32 - 1, variable as u32, derivative));
    }
}

/// Sparsity pattern of the Jacobian without repetitions, and the position in it of every entry that [`Nlp::rows`] pushes.
#[derive(Debug)]
pub struct Pattern {
    /// `(row, variable)` of each value.
    pub entries: Vec<(u32, u32)>,
    slots: Vec<u32>,
}

impl Pattern {
    /// Pattern of the given rows; it is the same at every point.
    pub fn new(rows: &Rows) -> Pattern {
        let mut entries: Vec<(u32, u32)> = rows.entries.iter().map(|&(row, variable, _)| (row, variable)).collect();
        entries.sort_unstable();
        entries.dedup();
        let slot = |&(row, variable, _): &(u32, u32, f64)| entries.partition_point(|&entry| entry < (row, variable)) as u32;
        let slots = rows.entries.iter().map(slot).collect();
        Pattern { entries, slots }
    }

    /// Writes the values of the Jacobian, in the order of [`Pattern::entries`].
    pub fn values(&self, rows: &Rows, into: &mut [f64]) {
        debug_assert_eq!(rows.entries.len(), self.slots.len(), "every point pushes the same entries");
        into.fill(0.);
        for (&(_, _, derivative), &slot) in rows.entries.iter().zip(&self.slots) {
            into[slot as usize] += derivative;
        }
    }
}

/// Options of Ipopt. All others have Ipopt's defaults, except a limited-memory Hessian and no output.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Options {
    /// Convergence tolerance, Ipopt's `tol`.
    pub tolerance: f64,
    /// Largest number of iterations, Ipopt's `max_iter`.
    pub max_iterations: usize,
    /// Time limit, Ipopt's `max_cpu_time`, s.
    pub max_seconds: f64,
    /// Initial barrier parameter `mu_init`, also the distance by which the start is pushed inside its bounds; `None` for Ipopt's defaults.
    /// A small value finds the optimum near the start.
    pub barrier: Option<f64>,
}

impl Options {
    /// Options of the paper's lower level: 50 iterations, 5 s.
    pub const LOWER_LEVEL: Options = Options { tolerance: 1e-3, max_iterations: 50, max_seconds: 5., barrier: None };
    /// Options of the paper's baselines: 200 iterations, 40 s.
    pub const BASELINE: Options = Options { tolerance: 1e-3, max_iterations: 200, max_seconds: 40., barrier: None };
}

/// Result status, size and cost of a solve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// Ipopt's `ApplicationReturnStatus`: 0 solved, 1 solved to the acceptable level, 2 infeasible, -1 iteration limit, -4 time limit, ...
    pub status: i32,
    /// Number of iterations.
    pub iterations: usize,
    /// Wall time, s.
    pub seconds: f64,
    /// Part of the wall time spent in rows, Jacobians and the objective, s.
    pub evaluation_seconds: f64,
    /// Number of variables, including fixed ones.
    pub n_variables: usize,
    /// Number of rows.
    pub n_constraints: usize,
    /// Number of entries of the Jacobian.
    pub nnz_jacobian: usize,
}
