//! `schema`: prints the JSON Schema of a file format.

use super::{Failure, Verdict, print, to_json};
use crate::report::schema::{Document, schema};
use clap::{Args, ValueEnum};

#[derive(Debug, Args)]
pub struct Schema {
    /// File format
    #[arg(value_enum)]
    file: File,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum File {
    /// result.json of `solve`
    Result,
    /// trajectory.json
    Trajectory,
    /// Robot file
    Robot,
    /// Terrain file
    Terrain,
}

impl Schema {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let document = match self.file {
            File::Result => Document::Result,
            File::Trajectory => Document::Trajectory,
            File::Robot => Document::Robot,
            File::Terrain => Document::Terrain,
        };
        print(&to_json(&schema(document))?)?;
        Ok(Verdict::Feasible)
    }
}
