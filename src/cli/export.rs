//! `export`: a motion for other programs.

use super::args::WorldArgs;
use super::held::{Asked, Held, read_world};
use super::{Failure, Verdict, print_beside};
#[cfg(not(feature = "mcap"))]
use crate::error::Error;
use crate::error::Result;
use crate::export::{Sampled, csv};
use crate::gait::Trajectory;
use crate::report::files;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Frames and signs: documentation of the module `export`.
#[derive(Debug, Args)]
pub struct Export {
    /// A trajectory (.json)
    file: PathBuf,
    /// CSV with units in its header, or MCAP with Foxglove's schemas
    #[arg(long, value_enum)]
    format: Format,
    /// Samples a second
    #[arg(long, value_name = "HZ", default_value_t = 100.)]
    rate: f64,
    /// The file to write; default that of the trajectory with another ending
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    world: WorldArgs,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    Csv,
    Mcap,
}

impl Export {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let world = read_world(&self.world)?;
        let trajectory = Trajectory::from_json(&files::read(&self.file)?).map_err(|e| e.in_file(&self.file, None))?;
        let held = Held::new(&world, &trajectory, &Asked::default()).map_err(|e| e.in_file(&self.file, None))?;
        let sampled = Sampled::new(&trajectory, &held.robot, &held.terrain, self.rate)?;
        let (ending, bytes) = match self.format {
            Format::Csv => ("csv", csv::csv(&sampled).into_bytes()),
            Format::Mcap => ("mcap", mcap(&sampled, &trajectory, &held)?),
        };
        let output = self.output.clone().unwrap_or_else(|| self.file.with_extension(ending));
        files::write_bytes(&output, &bytes)?;
        print_beside(&output, &format!("{} samples written to {}\n", sampled.samples.len(), output.display()))?;
        Ok(Verdict::Feasible)
    }
}

#[cfg(feature = "mcap")]
fn mcap(sampled: &Sampled, trajectory: &Trajectory, held: &Held) -> Result<Vec<u8>> {
    crate::export::mcap::mcap(sampled, trajectory, &held.robot, &held.terrain)
}

#[cfg(not(feature = "mcap"))]
fn mcap(_: &Sampled, _: &Trajectory, _: &Held) -> Result<Vec<u8>> {
    Err(Error::Missing { message: "this program was built without the feature `mcap`".into() })
}
