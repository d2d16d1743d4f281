//! Gait optimisation for legged robots.
pub mod backend;
pub mod cem;
pub mod certify;
pub mod error;
pub mod evaluate;
pub mod gait;
pub mod kernels;
pub mod nlp;
pub mod robot;
pub mod scenario;
pub mod settings;
pub mod solver;
pub mod task;
pub mod terrain;

pub use error::{Error, Result};
