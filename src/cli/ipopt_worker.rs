//! `ipopt-worker`: solves problems from stdin with Ipopt, for the other commands.

use super::{Failure, Verdict};
use crate::reference::workers::serve;
use clap::Args;

#[derive(Debug, Args)]
pub struct IpoptWorker {}

impl IpoptWorker {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        serve(std::io::stdin().lock(), std::io::stdout().lock())?;
        Ok(Verdict::Feasible)
    }
}
