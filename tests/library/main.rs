//! Tests of the library: the rows and the solver, whole searches, and the independent verification.

#[path = "../common/mod.rs"]
mod common;

mod momentum;
mod online;
mod perturbations;
mod planner;
mod properties;
mod reference;
mod search;
#[cfg(feature = "gpu")]
mod shader_layout;
mod soles;
mod solve;
mod verify;
