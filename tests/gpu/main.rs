//! Tests on a GPU or a software adapter: every shader against its Rust twin, and whole solves against those on the CPU.
//!
//! `CREGOPT_TEST_ADAPTER` names the adapter. Without an adapter every test reports that it is skipped; with `GPU_TESTS=require` it fails.

#[path = "../common/mod.rs"]
mod common;

mod parity;
mod solves;
