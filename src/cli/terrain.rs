//! `terrain`: converts height maps to terrain files.

use super::{Failure, Verdict, print_about};
use crate::error::{Error, Result};
use crate::files;
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
    /// Convert a height map to a terrain file: CSV, NPY (`z[i][j]` at x and y) or grey PNG (x to the right, y up)
    Import(Import),
}

#[derive(Debug, Args)]
struct Import {
    /// Height map: .csv, .npy or .png. NaN and transparent pixels are holes, which admit no foothold
    file: PathBuf,
    /// Distance between samples, m
    #[arg(long, value_name = "M")]
    cell: f64,
    /// Position of the first sample, m; robots start at the origin by default
    #[arg(long, value_name = "X,Y", default_value = "0,0", allow_hyphen_values = true)]
    origin: Origin,
    /// Factor on heights; for a picture the height of white, m
    #[arg(long, default_value_t = 1., allow_hyphen_values = true)]
    height_scale: f64,
    /// Friction coefficient
    #[arg(long, default_value_t = 0.8)]
    friction: f64,
    /// Name of the terrain [default: the name of the file, with `-imported` appended if a built-in terrain has it]
    #[arg(long)]
    name: Option<String>,
    /// Terrain file to write, .json or .toml
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
        print_about(&import.out, &imported.about())?;
        print_about(&import.out, &format!("written to {}\n", import.out.display()))?;
        Ok(Verdict::Feasible)
    }
}

impl Import {
    fn read(&self) -> Result<Imported> {
        let placement = Placement { cell: self.cell, origin: self.origin.0, height_scale: self.height_scale, friction: self.friction };
        let bytes = files::read_bytes(&self.file, files::MAX_FILE)?;
        terrain_of(&self.file, &bytes, &placement, self.name.as_deref()).map_err(|e| match e {
            // Options of the command line are not in the file.
            Error::Invalid { ref place, .. } if place.starts_with("--") => e,
            e => e.in_file(&self.file, None),
        })
    }
}
