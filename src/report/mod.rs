//! What users read: result files and text for the terminal.

pub mod atlas;
pub mod atlas_plot;
pub mod files;
pub mod gait_diagram;
pub mod result;

pub use gait_diagram::gait_diagram;
pub use result::{EvaluateResult, IpoptResult, SolveResult};
