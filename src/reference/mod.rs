//! Reference programs: the same problems formulated for a general solver, with which this program is compared.
//!
//! [`towr`] is TOWR's whole program \[3\] with fixed durations, or with durations as variables; the latter is the first baseline of the
//! paper \[1\]. [`contact_implicit`] is the second baseline, and [`momentum`] this solver's own rows. [`ipopt`] passes them to Ipopt,
//! [`job`] runs one problem, [`workers`] runs many in parallel. Ipopt itself is only available with the feature `ipopt`.
//!
//! The formulas for Hermite pieces, Euler angles and the rigid body are deliberately repeated here, except in [`momentum`]: an independent
//! formulation shares no error with the solver that is compared with it.

pub mod contact_implicit;
mod curve;
pub mod ipopt;
#[cfg(feature = "ipopt")]
mod ipopt_binding;
pub mod job;
pub mod momentum;
pub mod nlp;
mod rigid_body;
pub mod towr;
pub mod workers;
