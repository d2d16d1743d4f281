//! `terrain`: converts maps and meshes to terrain files.

use super::{Failure, Verdict, print_about};
use crate::files;
use crate::terrain::import::{FRICTION, Placement, read};
use clap::{Args, Subcommand};
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct TerrainCommand {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Convert a map or a mesh to a terrain file: CSV, NPY (`z[i][j]` at x and y), grey PNG (x to the right, y up), OBJ and PLY (m, z up), or
    /// `grid_map` in MCAP
    Import(Import),
}

#[derive(Debug, Args)]
struct Import {
    /// Map or mesh: .csv, .npy, .png, .obj, .ply or .mcap. NaN, transparent pixels and places without a surface are holes, which admit no
    /// foothold
    file: PathBuf,
    /// Distance between samples, m; needed for .csv, .npy and .png [default: that of a grid map; 1/200 of the longer side of a mesh, rounded
    /// down]
    #[arg(long, value_name = "M")]
    cell: Option<f64>,
    /// Position of the first sample, m; robots start at the origin by default [default: that of a mesh or grid map, otherwise 0,0]
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    origin: Option<Origin>,
    /// Factor on heights; for a picture the height of white, m
    #[arg(long, default_value_t = 1., allow_hyphen_values = true)]
    height_scale: f64,
    /// Friction coefficient
    #[arg(long, default_value_t = FRICTION)]
    friction: f64,
    /// Layer of a grid map [default: elevation]
    #[arg(long)]
    layer: Option<String>,
    /// Topic of a grid map, whose last message is read [default: the only one]
    #[arg(long)]
    topic: Option<String>,
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
        let imported = read(&import.file, &import.placement(), import.name.as_deref())?;
        files::write(&import.out, &imported.terrain.file_text(&import.out)?)?;
        print_about(&import.out, &imported.about())?;
        print_about(&import.out, &format!("written to {}\n", import.out.display()))?;
        Ok(Verdict::Feasible)
    }
}

impl Import {
    fn placement(&self) -> Placement {
        Placement {
            cell: self.cell,
            origin: self.origin.as_ref().map(|origin| origin.0),
            height_scale: self.height_scale,
            friction: self.friction,
            layer: self.layer.clone(),
            topic: self.topic.clone(),
        }
    }
}
