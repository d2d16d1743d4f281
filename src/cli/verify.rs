//! `verify`: count what a trajectory file violates.

use super::args::WorldArgs;
use super::held::{Asked, Held, shown};
use super::{Failure, Verdict, print, to_json};
use crate::error::Error;
use crate::gait::Trajectory;
use crate::report::files;
use crate::report::motion_plot::{self, MotionPlot};
use crate::verify::Report;
use clap::Args;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct Verify {
    /// A trajectory (.json), or one a line (.jsonl)
    file: PathBuf,
    #[command(flatten)]
    world: WorldArgs,
    #[command(flatten)]
    asked: Asked,
    /// Draw the motion, its forces and its way: .svg or .png; of a file with one trajectory
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
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
    /// What it was held to, and whose word that is.
    terms: Vec<String>,
    #[serde(flatten)]
    report: Report,
}

impl Verify {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let world = self.world.read()?;
        world.check_force_limit()?;
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
        if let Some(path) = &self.plot {
            if documents.len() > 1 {
                return Err(Error::invalid("--plot", format!("{} trajectories", documents.len()), "of a file with one trajectory").into());
            }
            motion_plot::check(path)?;
        }
        let mut reports = Vec::new();
        let mut failure = None;
        for (line, document) in documents {
            let report = Trajectory::from_json(document).and_then(|trajectory| {
                let Held { robot, terrain, force_limit, terms, report } = Held::new(&world, &trajectory, &self.asked)?;
                if let Some(path) = &self.plot {
                    let verdict = if report.feasible { "certified" } else { "not certified" };
                    let title = format!("{:.2} s, {verdict}", trajectory.horizon);
                    motion_plot::write(
                        &MotionPlot { title, trajectory: &trajectory, robot: &robot, terrain: &terrain, force_limit },
                        path,
                    )?;
                }
                Ok(Line { line, scenario: trajectory.scenario, robot: robot.name.clone(), terrain: terrain.name.clone(), terms, report })
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
                let scenario = r.scenario.as_deref().map(|s| format!("scenario {}, ", shown(s))).unwrap_or_default();
                let terms: String = r.terms.iter().map(|term| format!("  {term}\n")).collect();
                let (robot, terrain) = (shown(&r.robot), shown(&r.terrain));
                print(&format!("line {}: {scenario}robot {robot}, terrain {terrain}\n{terms}{}\n\n", r.line, r.report))?;
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
