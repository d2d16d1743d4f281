//! The paper's experiments \[1\], with its method and its baselines beside this program's.
//!
//! A [`plan()`] lists the runs of an experiment; [`run()`](run::run) makes one; [`Log`] keeps what is done, so that a stopped experiment
//! goes on where it was; [`summary`] and [`plot`] read the log.

pub mod log;
pub mod plan;
pub mod plot;
pub mod run;
pub mod summary;

pub use log::Log;
pub use plan::{Case, Method, plan};
pub use run::{Devices, Run, run};
