//! `export`: converts a motion for other programs.

use super::args::WorldArgs;
use super::{Failure, Verdict, print_about};
use crate::app::{TermOverrides, VerificationTerms};
use crate::export::Format;
use crate::files;
use crate::gait::Trajectory;
use clap::Args;
use std::path::PathBuf;

/// Converts a motion to CSV, to MCAP for viewers, or to messages of ROS 2 in MCAP. World frame z up, SI units; forces act on the robot.
#[derive(Debug, Args)]
pub struct Export {
    /// Trajectory (.json)
    file: PathBuf,
    /// File format
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

impl Export {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let world = self.world.read_checked()?;
        let trajectory = Trajectory::from_json(&files::read(&self.file)?).map_err(|e| e.in_file(&self.file, None))?;
        let terms = VerificationTerms::new(&world, &trajectory, &TermOverrides::default()).map_err(|e| e.in_file(&self.file, None))?;
        let (bytes, samples) = self.format.bytes(&trajectory, &terms.robot, &terms.terrain, self.rate)?;
        let output = self.output.clone().unwrap_or_else(|| self.file.with_extension(self.format.extension()));
        files::write_bytes(&output, &bytes)?;
        print_about(&output, &format!("{samples} samples written to {}\n", output.display()))?;
        Ok(Verdict::Feasible)
    }
}
