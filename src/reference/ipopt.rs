//! Ipopt, where the feature `ipopt` has linked it.
//!
//! One solve at a time in a process: Debian's Ipopt factors with MUMPS, whose state is global, and its time limit counts the CPU time of the
//! whole process. [`super::workers`] runs several processes.

use super::nlp::Nlp;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Version that was linked; none without the feature.
pub const VERSION: Option<&str> = option_env!("IPOPT_VERSION");

/// Options; all others are Ipopt's defaults but for a limited-memory Hessian and no output.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Options {
    /// `tol`.
    pub tolerance: f64,
    /// `max_iter`.
    pub max_iterations: usize,
    /// `max_cpu_time`, s.
    pub max_seconds: f64,
}

impl Options {
    /// Those of the paper's lower level: 50 iterations, 5 s.
    pub const LOWER_LEVEL: Options = Options { tolerance: 1e-3, max_iterations: 50, max_seconds: 5. };
    /// Those of the paper's baselines: 200 iterations, 40 s.
    pub const BASELINE: Options = Options { tolerance: 1e-3, max_iterations: 200, max_seconds: 40. };
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

fn missing() -> Error {
    let how = "this build has no Ipopt; build it with `--features ipopt` (Debian: apt-get install coinor-libipopt-dev pkg-config)";
    Error::Missing { message: how.into() }
}

/// That there is an Ipopt.
///
/// # Errors
/// [`Error::Missing`] without the feature.
pub fn check() -> Result<()> {
    VERSION.map(|_| ()).ok_or_else(missing)
}

/// Solves from `start`, or from the program's own initial point. Returns the last point.
///
/// # Errors
/// As [`check`].
#[cfg(feature = "ipopt")]
pub fn solve(nlp: &dyn Nlp, start: Option<&[f64]>, options: &Options) -> Result<(Vec<f64>, Statistics)> {
    Ok(super::ipopt_binding::solve(nlp, start, options))
}

/// There is no Ipopt in this build.
///
/// # Errors
/// As [`check`].
#[cfg(not(feature = "ipopt"))]
pub fn solve(_: &dyn Nlp, _: Option<&[f64]>, _: &Options) -> Result<(Vec<f64>, Statistics)> {
    Err(missing())
}
