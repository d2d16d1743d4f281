//! Output for users: result files, tables, pictures and text for the terminal.

pub mod animation;
#[cfg(feature = "cli")]
pub mod atlas;
#[cfg(feature = "cli")]
pub mod atlas_plot;
pub mod gait_diagram;
pub mod ground_mesh;
pub mod motion_plot;
#[cfg(feature = "pictures")]
mod png;
pub mod result;
pub mod samples;
#[cfg(feature = "schema")]
pub mod schema;
pub mod svg;
pub mod verdict;

pub use gait_diagram::gait_diagram;
pub use result::{EvaluateResult, IpoptResult, SolveResult};
