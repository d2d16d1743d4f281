//! Interface to Ipopt, which the feature `ipopt` links.
//!
//! Only one solve runs per process at a time: Debian's Ipopt factorises with MUMPS, whose state is global, and its time limit counts the
//! CPU time of the whole process. [`super::workers`] runs several processes.

use super::nlp::Nlp;
pub use super::nlp::{Options, Statistics};
use crate::error::{Error, Result};

/// Version of the linked Ipopt; `None` without the feature.
pub const VERSION: Option<&str> = option_env!("IPOPT_VERSION");

fn missing() -> Error {
    let how = "this build has no Ipopt; build it with `--features ipopt` (Debian: apt-get install coinor-libipopt-dev pkg-config)";
    Error::Missing { message: how.into() }
}

/// Checks that Ipopt is available.
///
/// # Errors
/// [`Error::Missing`] without the feature.
pub fn check() -> Result<()> {
    VERSION.map(|_| ()).ok_or_else(missing)
}

/// Solves a program from `start`, or from its own initial point. Returns the last point.
///
/// # Errors
/// [`Error::Missing`] without the feature.
#[cfg(feature = "ipopt")]
pub fn solve(nlp: &dyn Nlp, start: Option<&[f64]>, options: &Options) -> Result<(Vec<f64>, Statistics)> {
    Ok(super::ipopt_binding::solve(nlp, start, options))
}

/// Fails, because this build has no Ipopt.
///
/// # Errors
/// [`Error::Missing`] always.
#[cfg(not(feature = "ipopt"))]
pub fn solve(_: &dyn Nlp, _: Option<&[f64]>, _: &Options) -> Result<(Vec<f64>, Statistics)> {
    Err(missing())
}
