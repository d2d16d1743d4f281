//! Tests of the program as its users meet it, and of the processes that it starts for Ipopt.

#[path = "../common/mod.rs"]
mod common;

mod atlas;
#[cfg(feature = "dataset")]
mod dataset;
#[cfg(feature = "gpu")]
mod devices;
mod evaluate;
#[cfg(all(feature = "gpu", feature = "experiment"))]
mod exit_codes;
#[cfg(feature = "experiment")]
mod experiment;
mod export;
mod harness;
mod input_files;
mod ipopt;
mod pictures;
mod processes;
#[cfg(feature = "urdf")]
mod robot_files;
mod scenario_file;
#[cfg(feature = "schema")]
mod schema;
mod solve;
#[cfg(feature = "import")]
mod terrain_files;
mod verify;
#[cfg(feature = "view")]
mod view;
