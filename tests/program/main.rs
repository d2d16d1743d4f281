//! Tests of the program as its users meet it, and of the processes that it starts for Ipopt.

#[path = "../common/mod.rs"]
mod common;

mod atlas;
#[cfg(all(feature = "gpu", feature = "experiment"))]
mod cli;
mod export;
mod ipopt;
mod pictures;
#[cfg(feature = "urdf")]
mod robot_files;
#[cfg(feature = "schema")]
mod schema;
#[cfg(feature = "view")]
mod view;
