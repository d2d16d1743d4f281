//! `terrain`: height maps as terrain files.

use super::{Failure, Verdict, print_beside};
use crate::error::{Error, Result};
use crate::report::files;
use crate::terrain::import::{Imported, Placement, terrain_of};
use clap::{Args, Subcommand};
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct TerrainCommand {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Make a terrain file of a height map: CSV, NPY (`z[i][j]` at x and y) or grey PNG (x to the right, y up)
    Import(Import),
}

#[derive(Debug, Args)]
struct Import {
    /// Height map: .csv, .npy or .png. What is not a number, or transparent, is ground on which nothing can stand
    file: PathBuf,
    /// Distance of samples, m
    #[arg(long, value_name = "M")]
    cell: f64,
    /// Where the first sample stands, m; the robot starts at the origin by default
    #[arg(long, value_name = "X,Y", default_value = "0,0", allow_hyphen_values = true)]
    origin: Origin,
    /// Factor on heights; of a picture the height of white, m
    #[arg(long, default_value_t = 1., allow_hyphen_values = true)]
    height_scale: f64,
    /// Friction coefficient
    #[arg(long, default_value_t = 0.8)]
    friction: f64,
    /// Name of the terrain; that of the file by default, with `-imported` behind it where a built-in terrain has that
    #[arg(long)]
    name: Option<String>,
    /// Terrain file, .json or .toml
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
}

#[derive(Debug, Clone)]
struct Origin([f64; 2]);

impl std::str::FromStr for Origin {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let numbers: std::result::Result<Vec<f64>, _> = text.split(',').map(|v| v.trim().parse::<f64>()).collect();
        match numbers.as_deref() {
            Ok(&[x, y]) if x.is_finite() && y.is_finite() => Ok(Origin([x, y])),
            _ => Err("expected X,Y in metres".into()),
        }
    }
}

impl TerrainCommand {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let Command::Import(import) = &self.command;
        files::check_writable(&import.out)?;
        let imported = import.read()?;
        files::write(&import.out, &imported.terrain.file_text(&import.out)?)?;
        print_beside(&import.out, &imported.about())?;
        print_beside(&import.out, &format!("written to {}\n", import.out.display()))?;
        Ok(Verdict::Feasible)
    }
}

impl Import {
    fn read(&self) -> Result<Imported> {
        let placement = Placement { cell: self.cell, origin: self.origin.0, height_scale: self.height_scale, friction: self.friction };
        let bytes = files::read_bytes(&self.file, files::MAX_FILE)?;
        terrain_of(&self.file, &bytes, &placement, self.name.as_deref()).map_err(|e| match e {
            // Flags are not in the file.
            Error::Invalid { ref place, .. } if place.starts_with("--") => e,
            e => e.in_file(&self.file, None),
        })
    }
}
