//! `export`: converts a motion for other programs.

use super::args::WorldArgs;
use super::{Failure, Verdict, print_about};
use crate::app::{TermOverrides, VerificationTerms};
#[cfg(not(feature = "mcap"))]
use crate::error::Error;
use crate::error::Result;
use crate::export::{Sampled, csv};
use crate::files;
use crate::gait::Trajectory;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Converts a motion to CSV or MCAP. World frame z up, SI units; forces act on the robot.
#[derive(Debug, Args)]
pub struct Export {
    /// Trajectory (.json)
    file: PathBuf,
    /// CSV with units in its header, or MCAP with the schemas of Foxglove
    #[arg(long, value_enum)]
    format: Format,
    /// Sampling rate
    #[arg(long, value_name = "HZ", default_value_t = 100.)]
    rate: f64,
    /// Output file [default: that of the trajectory with another extension]
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
        let world = self.world.read_checked()?;
        let trajectory = Trajectory::from_json(&files::read(&self.file)?).map_err(|e| e.in_file(&self.file, None))?;
        let terms = VerificationTerms::new(&world, &trajectory, &TermOverrides::default()).map_err(|e| e.in_file(&self.file, None))?;
        let sampled = Sampled::new(&trajectory, &terms.robot, &terms.terrain, self.rate)?;
        let (extension, bytes) = match self.format {
            Format::Csv => ("csv", csv::csv(&sampled).into_bytes()),
            Format::Mcap => ("mcap", mcap(&sampled, &trajectory, &terms)?),
        };
        let output = self.output.clone().unwrap_or_else(|| self.file.with_extension(extension));
        files::write_bytes(&output, &bytes)?;
        print_about(&output, &format!("{} samples written to {}\n", sampled.samples.len(), output.display()))?;
        Ok(Verdict::Feasible)
    }
}

#[cfg(feature = "mcap")]
fn mcap(sampled: &Sampled, trajectory: &Trajectory, terms: &VerificationTerms) -> Result<Vec<u8>> {
    crate::export::mcap::mcap(sampled, trajectory, &terms.robot, &terms.terrain)
}

#[cfg(not(feature = "mcap"))]
fn mcap(_: &Sampled, _: &Trajectory, _: &VerificationTerms) -> Result<Vec<u8>> {
    Err(Error::Missing { message: "this program was built without the feature `mcap`".into() })
}
