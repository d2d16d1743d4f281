//! `robot`: imports robots from URDF and MJCF files, and computes joints along motions.

use super::{Failure, Verdict, print, print_about, to_json};
use crate::app::named;
use crate::app::terms::{ground_of, robot_of};
use crate::app::world::World;
use crate::error::{Error, Result, check_range};
use crate::files;
use crate::gait::Trajectory;
use crate::gait::joints::{JointMotion, RATE, RATES, follow};
#[cfg(feature = "urdf")]
use crate::robot::import::{Import, Imported, Soles, configuration};
use clap::{Args, Subcommand};
use std::path::{Path, PathBuf};

#[derive(Debug, Subcommand)]
pub enum Robot {
    /// Convert a URDF or MJCF file to a robot file: mass, inertia, feet, reach and forces in one configuration of its joints
    #[cfg(feature = "urdf")]
    Import(ImportFile),
    /// Compute the joints of an imported robot along a motion: positions, velocities, torques, and use of their limits
    Joints(Joints),
}

impl Robot {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        match self {
            #[cfg(feature = "urdf")]
            Robot::Import(command) => command.run(),
            Robot::Joints(command) => command.run(),
        }
    }
}

#[cfg(feature = "urdf")]
#[derive(Debug, Args)]
pub struct ImportFile {
    /// URDF file, or MJCF file of MuJoCo; meshes are not needed
    file: PathBuf,
    /// Links (bodies) of the feet [default: those on the ground in the configuration]
    #[arg(long, value_name = "LINK,...", value_delimiter = ',')]
    feet: Vec<String>,
    /// Joint values in which the robot stands, rad or m. Other joints are at zero, or in the middle of their limits if zero is outside.
    /// Without values, the robot stands as in the keyframe of an MJCF file, or on bent legs
    #[arg(long, value_name = "JOINT=VALUE,...", allow_hyphen_values = true)]
    configuration: Vec<String>,
    /// Soles of the feet: `auto` (flat lower sides of collision shapes, if the legs have six joints), `none` (points or balls), or length and
    /// width, m
    #[arg(long, value_name = "LENGTH,WIDTH", default_value = "auto")]
    sole: Soles,
    /// Name of the robot [default: the name in the file, with `-imported` appended if a built-in robot has it]
    #[arg(long)]
    name: Option<String>,
    /// Robot file to write, .json or .toml [default: print JSON]
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
}

#[cfg(feature = "urdf")]
impl ImportFile {
    fn run(&self) -> std::result::Result<Verdict, Failure> {
        let import = Import {
            feet: self.feet.iter().map(|name| name.trim().to_owned()).collect(),
            configuration: configuration(&self.configuration.join(","))?,
            name: self.name.clone(),
            soles: self.sole,
        };
        self.out.as_deref().map_or(Ok(()), files::check_writable)?;
        let imported = import.file(&self.file)?;
        match &self.out {
            Some(out) => {
                files::write(out, &imported.robot.file_text(out)?)?;
                print_about(out, &summary(&imported))?;
            }
            None => {
                super::complain(&summary(&imported).trim_end());
                print(&to_json(&imported.robot)?)?;
            }
        }
        Ok(Verdict::Feasible)
    }
}

/// Text about an imported robot.
#[cfg(feature = "urdf")]
fn summary(imported: &Imported) -> String {
    let robot = &imported.robot;
    let [x, y, z] = imported.center_of_mass;
    let mut text = format!("{}: {:.3} kg, centre of mass ({x:.4}, {y:.4}, {z:.4}) m in the root link", robot.name, robot.mass);
    text += &format!(", {:.4} m above the ground\n", robot.base_height);
    for (number, (foot, [x, y, z])) in imported.feet.iter().zip(&robot.nominal_feet).enumerate() {
        let (reach, diagonals) = (robot.reach.of(number), robot.reach.foot(number).diagonals.len());
        let cut = if diagonals == 0 { String::new() } else { format!(", cut by {} diagonal faces", 2 * diagonals) };
        let side = |axis: usize| format!("{:.3} to {:.3}", reach.low[axis], reach.high[axis]);
        text += &format!("  foot {}: ({x:.4}, {y:.4}, {z:.4}) m, reach {}, {}, {} m{cut}\n", foot.link, side(0), side(1), side(2));
    }
    let force = robot.force_limit.map_or("by weight".into(), |limit| format!("{limit:.1} N, {:.2} weights", limit / robot.weight()));
    let leg = robot.leg_mass();
    let speed = imported.foot_speed.map_or("unlimited".into(), |speed| format!("{speed:.2} m/s"));
    let shape = match (robot.sole, robot.foot_radius) {
        (Some(sole), _) => format!("soles {:.3} x {:.3} m, turn {:.2} rad", sole.length, sole.width, sole.turn),
        (None, radius) => radius.map_or("radius of the feet by size".into(), |radius| format!("radius of the feet {radius:.4} m")),
    };
    text += &format!("  force limit {force}; leg {leg:.3} kg at the foot; foot speed {speed}; {shape}\n");
    imported.notes.iter().for_each(|note| text += &format!("  note: {note}\n"));
    text
}

#[derive(Debug, Args)]
pub struct Joints {
    /// Trajectory file of `solve`
    file: PathBuf,
    /// Robot with joints: a JSON or TOML file [default: the robot in the trajectory]
    #[arg(long, value_name = "FILE")]
    robot: Option<String>,
    /// Sampling rate
    #[arg(long, value_name = "HZ", default_value_t = RATE)]
    rate: f64,
    /// CSV file for the joints: one row per sample, three columns per joint
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print the limits as JSON instead of text
    #[arg(long)]
    json: bool,
}

impl Joints {
    fn run(&self) -> std::result::Result<Verdict, Failure> {
        check_range("--rate", self.rate, RATES[0], RATES[1])?;
        self.out.as_deref().map_or(Ok(()), files::check_writable)?;
        let world = World::of(self.robot.as_deref().map(named::robot).transpose()?, None, None);
        let trajectory = Trajectory::from_json(&files::read(&self.file)?).map_err(|e| e.in_file(&self.file, None))?;
        let motion = robot_of(&world, &trajectory).and_then(|(robot, _)| {
            let terrain = ground_of(&world, &trajectory, &robot)?;
            follow(&trajectory, &robot, &terrain, self.rate)
        });
        let motion = motion.map_err(|e| e.in_file(&self.file, None))?;
        if let Some(out) = &self.out {
            files::write(out, &csv_text(&motion, out)?)?;
        }
        let text = if self.json {
            to_json(&motion.limits)?
        } else {
            format!("{} joints at {} times\n{}", motion.joints.len(), motion.samples.len(), motion.limits)
        };
        self.out.as_deref().map_or_else(|| print(&text), |out| print_about(out, &text))?;
        Ok(if motion.limits.kept { Verdict::Feasible } else { Verdict::Infeasible })
    }
}

/// CSV text with one row per sample: `time_s`, then position, velocity and torque of each joint.
fn csv_text(motion: &JointMotion, out: &Path) -> Result<String> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let io = |e: csv::Error| Error::Io { action: "write", path: out.to_owned(), source: std::io::Error::other(e) };
    writer.write_record(std::iter::once("time_s".into()).chain(motion.columns())).map_err(io)?;
    for sample in &motion.samples {
        let numbers = std::iter::once(sample.time).chain(sample.values());
        writer.write_record(numbers.map(|v| v.to_string())).map_err(io)?;
    }
    let bytes = writer.into_inner().map_err(|e| io(e.into_error().into()))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}
