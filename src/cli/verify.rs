//! `verify`: count what a trajectory file violates.

use super::args::{World, WorldArgs, robot as robot_by_name, terrain as terrain_by_name};
use super::{Failure, Verdict, print, to_json};
use crate::error::{Error, Result};
use crate::gait::Trajectory;
use crate::gait::trajectory::NamedOr;
use crate::nlp::transcription::towr;
use crate::report::files;
use crate::robot::Robot;
use crate::scenario::Scenario;
use crate::terrain::Terrain;
use crate::verify::{Report, verify};
use clap::Args;
use std::path::PathBuf;
use std::sync::Arc;

#[derive(Debug, Args)]
pub struct Verify {
    /// A trajectory (.json), or one a line (.jsonl)
    file: PathBuf,
    #[command(flatten)]
    world: WorldArgs,
    /// Print JSON: an array with one report a trajectory
    #[arg(long)]
    json: bool,
}

/// A report with what it is about.
#[derive(serde::Serialize)]
struct Line {
    line: usize,
    scenario: Option<String>,
    robot: String,
    terrain: String,
    #[serde(flatten)]
    report: Report,
}

impl Verify {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let world = self.world.read()?;
        let text = files::read(&self.file)?;
        // A pretty-printed document is one trajectory; otherwise each line is one.
        let documents: Vec<(usize, &str)> = match serde_json::from_str::<serde::de::IgnoredAny>(&text) {
            Ok(_) => vec![(1, &text)],
            Err(e) if self.file.extension().is_some_and(|x| x == "json") => {
                return Err(Error::from(e).in_file(&self.file, None).into());
            }
            Err(_) => files::lines(&text).collect(),
        };
        if documents.is_empty() {
            return Err(Error::invalid("trajectories", "none", "at least one").in_file(&self.file, None).into());
        }
        let mut reports = Vec::new();
        let mut failure = None;
        for (line, document) in documents {
            let report = Trajectory::from_json(document).and_then(|trajectory| {
                let robot = robot_of(&world, &trajectory)?;
                let terrain = terrain_of(&world, &trajectory)?;
                let force_limit = world.force_limit.or(trajectory.force_limit).unwrap_or(towr::FORCE_LIMIT);
                let report = verify(&trajectory, &robot, &terrain, force_limit)?;
                Ok(Line { line, scenario: trajectory.scenario, robot: robot.name.clone(), terrain: terrain.name.clone(), report })
            });
            match report {
                Ok(report) => reports.push(report),
                Err(e) => {
                    failure = Some(e.in_file(&self.file, Some(line)));
                    break;
                }
            }
        }
        if self.json {
            print(&to_json(&reports)?)?;
        } else {
            for r in &reports {
                let scenario = r.scenario.as_deref().map(|s| format!("scenario {s}, ")).unwrap_or_default();
                print(&format!("line {}: {scenario}robot {}, terrain {}\n{}\n\n", r.line, r.robot, r.terrain, r.report))?;
            }
            if reports.len() > 1 {
                let feasible = reports.iter().filter(|r| r.report.feasible).count();
                print(&format!("{feasible} of {} trajectories feasible\n", reports.len()))?;
            }
        }
        match failure {
            Some(error) => Err(error.into()),
            None if reports.iter().all(|r| r.report.feasible) => Ok(Verdict::Feasible),
            None => Ok(Verdict::Infeasible),
        }
    }
}

fn scenario_of(trajectory: &Trajectory, what: &str) -> Result<Scenario> {
    let name = trajectory.scenario.as_deref();
    let name = name.ok_or_else(|| Error::invalid(what, "missing", format!("in the file, its scenario's, or given as --{what}")))?;
    Scenario::named(name)
}

/// The robot on the command line, else the file's, else its scenario's.
fn robot_of(world: &World, trajectory: &Trajectory) -> Result<Arc<Robot>> {
    match (world.robot(trajectory.scenario.as_deref()), &trajectory.robot) {
        (Some(robot), _) => Ok(robot),
        (None, Some(NamedOr::Name(name))) => robot_by_name(name),
        (None, Some(NamedOr::Own(robot))) => robot.validate().map(|()| Arc::new(robot.clone())),
        (None, None) => robot_by_name(scenario_of(trajectory, "robot")?.robot),
    }
}

/// The terrain on the command line, else the file's, else its scenario's.
fn terrain_of(world: &World, trajectory: &Trajectory) -> Result<Arc<Terrain>> {
    match (world.terrain(trajectory.scenario.as_deref()), &trajectory.terrain) {
        (Some(terrain), _) => Ok(terrain),
        (None, Some(NamedOr::Name(name))) => terrain_by_name(name),
        (None, Some(NamedOr::Own(terrain))) => terrain.validate().map(|()| Arc::new(terrain.clone())),
        (None, None) => terrain_by_name(scenario_of(trajectory, "terrain")?.terrain),
    }
}
