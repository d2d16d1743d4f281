//! The same problems for a general solver: what this program is compared with.
//!
//! [`towr`] is TOWR's whole program \[3\] for fixed durations, or with durations as variables, which is the paper's \[1\] first baseline;
//! [`contact_implicit`] its second. All are given to Ipopt by [`ipopt`], one as a [`job`], many by [`workers`]. Ipopt itself is there with the
//! feature `ipopt` only.

pub mod contact_implicit;
mod curve;
pub mod ipopt;
#[cfg(feature = "ipopt")]
mod ipopt_binding;
pub mod job;
pub mod nlp;
mod rigid_body;
pub mod towr;
pub mod workers;
