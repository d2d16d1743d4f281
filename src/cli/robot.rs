//! `robot`: robot files from robots' models.

use super::{Failure, Verdict, complain, print};
use crate::report::files;
use crate::robot::import::{Import, Imported, MAX_URDF, configuration};
use clap::{Args, Subcommand};
use std::fmt::Write;
use std::path::PathBuf;

#[derive(Debug, Subcommand)]
pub enum Robot {
    /// Make a robot file of a URDF: mass, inertia, feet, reach and forces in one configuration of its joints
    Import(ImportUrdf),
}

impl Robot {
    pub fn run(&self) -> Result<Verdict, Failure> {
        match self {
            Robot::Import(command) => command.run(),
        }
    }
}

#[derive(Debug, Args)]
pub struct ImportUrdf {
    /// URDF file; meshes are not needed
    file: PathBuf,
    /// Links of the feet; else those that stand on the ground in the configuration
    #[arg(long, value_name = "LINK,...", value_delimiter = ',')]
    feet: Vec<String>,
    /// Joint values in which it stands, rad or m; the others are at zero, or in the middle of their limits when zero is outside
    #[arg(long, value_name = "JOINT=VALUE,...", allow_hyphen_values = true)]
    configuration: Vec<String>,
    /// Name of the robot; the file's by default
    #[arg(long)]
    name: Option<String>,
    /// Where to write the robot, .json or .toml; else it is printed as JSON
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
}

impl ImportUrdf {
    fn run(&self) -> Result<Verdict, Failure> {
        let import = Import {
            feet: self.feet.iter().map(|name| name.trim().to_owned()).collect(),
            configuration: configuration(&self.configuration.join(","))?,
            name: self.name.clone(),
        };
        self.out.as_deref().map_or(Ok(()), files::check_writable)?;
        let text = files::read_at_most(&self.file, MAX_URDF as u64)?;
        let imported = import.urdf(&text).map_err(|e| e.in_file(&self.file, None))?;
        match &self.out {
            Some(out) => {
                files::write(out, &imported.robot.file_text(out)?)?;
                print(&summary(&imported))?;
            }
            None => {
                complain(&summary(&imported).trim_end());
                print(&super::to_json(&imported.robot)?)?;
            }
        }
        Ok(Verdict::Feasible)
    }
}

/// What was computed, for people.
fn summary(imported: &Imported) -> String {
    let robot = &imported.robot;
    let [x, y, z] = imported.center_of_mass;
    let mut text = format!("{}: {:.3} kg, centre of mass ({x:.4}, {y:.4}, {z:.4}) m in the root link", robot.name, robot.mass);
    text += &format!(", {:.4} m above the ground\n", robot.base_height);
    for (foot, (at, reach)) in imported.feet.iter().zip(robot.nominal_feet.iter().zip(robot.reach_boxes())) {
        let [x, y, z] = at;
        let side = |axis: usize| format!("{:.3} to {:.3}", reach.low[axis], reach.high[axis]);
        // Writing to a string cannot fail.
        let _ = writeln!(text, "  foot {}: ({x:.4}, {y:.4}, {z:.4}) m, reach {}, {}, {} m", foot.link, side(0), side(1), side(2));
    }
    let force = robot.force_limit.map_or("by weight".into(), |limit| format!("{limit:.1} N, {:.2} weights", limit / robot.weight()));
    let leg = robot.leg_mass();
    let speed = imported.foot_speed.map_or("unlimited".into(), |speed| format!("{speed:.2} m/s"));
    let radius = imported.foot_radius.map_or("none".into(), |radius| format!("{radius:.4} m"));
    let _ = writeln!(text, "  force limit {force}; leg {leg:.3} kg at the foot; foot speed {speed}; radius of the feet {radius}");
    imported.notes.iter().for_each(|note| text += &format!("  note: {note}\n"));
    text
}
