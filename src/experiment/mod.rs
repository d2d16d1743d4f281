//! The paper's experiments \[1\]: its method and its baselines compared with this program.
//!
//! [`plan()`] lists the runs of an experiment and [`run()`](run::run) makes one. [`Log`] stores finished runs, so that a stopped experiment
//! can be resumed. [`summary`] and [`plot`] evaluate the log.

pub mod log;
pub mod plan;
pub mod plot;
pub mod run;
pub mod summary;

pub use log::Log;
pub use plan::{Case, Method, plan};
pub use run::{Devices, Run, run};
