//! Ipopt, where the feature `ipopt` has linked it.
//!
//! One solve at a time in a process: Debian's Ipopt factors with MUMPS, whose state is global, and its time limit counts the CPU time of the
//! whole process. [`super::workers`] runs several processes.

use super::nlp::Nlp;
pub use super::nlp::{Options, Statistics};
use crate::error::{Error, Result};

/// Version that was linked; none without the feature.
pub const VERSION: Option<&str> = option_env!("IPOPT_VERSION");

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
