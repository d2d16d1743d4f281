//! `init`: writes a template of a scenario file, with every key explained.

use super::{Failure, Verdict, complain, print};
use crate::app::scenario_file::TEMPLATE;
use crate::error::Error;
use crate::files;
use clap::Args;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub struct Init {
    /// File to write; `-` prints it
    #[arg(default_value = "scenario.toml")]
    file: PathBuf,
}

impl Init {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        if self.file == Path::new("-") {
            print(TEMPLATE)?;
            return Ok(Verdict::Feasible);
        }
        if self.file.exists() {
            let limit = "a file that does not exist yet";
            return Err(Error::invalid("file", "it exists", limit).in_file(&self.file, None).into());
        }
        files::write(&self.file, TEMPLATE)?;
        complain(&format!("written to {0}; solve it with `cregopt solve {0}`", self.file.display()));
        Ok(Verdict::Feasible)
    }
}
