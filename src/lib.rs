//! Gait optimisation for legged robots.
pub mod backend;
pub mod cem;
pub mod certify;
pub mod cli;
pub mod error;
pub mod evaluate;
pub mod gait;
pub mod kernels;
pub mod nlp;
pub mod report;
pub mod robot;
pub mod scenario;
pub mod search;
pub mod settings;
pub mod solver;
pub mod task;
pub mod terrain;

pub use error::{Error, Result};
