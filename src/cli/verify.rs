//! `verify`: checks trajectory files with the independent certificate.

use super::args::{TermArgs, WorldArgs};
use super::{Failure, Verdict, print, to_json};
use crate::app::VerificationTerms;
use crate::app::terms::shown;
use crate::app::world::World;
use crate::error::{Error, Result};
use crate::files;
use crate::gait::Trajectory;
use crate::report::motion_plot::{self, MotionPlot};
use crate::report::verdict::verdict;
use crate::verify::Report;
use clap::Args;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct Verify {
    /// Trajectory (.json), or one per line (.jsonl)
    file: PathBuf,
    #[command(flatten)]
    world: WorldArgs,
    #[command(flatten)]
    terms: TermArgs,
    /// Draw the motion, its forces and its path: .svg, or .png with the feature `pictures`; for a file with one trajectory
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Print JSON: an array with one report per trajectory
    #[arg(long)]
    json: bool,
}

/// Report on one trajectory, with its subject.
#[derive(serde::Serialize)]
struct Line {
    line: usize,
    scenario: Option<String>,
    robot: String,
    terrain: String,
    /// Terms of the verification, each with its source.
    terms: Vec<String>,
    #[serde(flatten)]
    report: Report,
}

impl Verify {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let world = self.world.read_checked()?;
        let text = files::read(&self.file)?;
        let documents = self.documents(&text)?;
        if let Some(path) = &self.plot {
            if documents.len() > 1 {
                return Err(Error::invalid("--plot", format!("{} trajectories", documents.len()), "of a file with one trajectory").into());
            }
            motion_plot::check(path)?;
        }
        let mut reports = Vec::new();
        let mut failure = None;
        for (line, document) in documents {
            match self.line(line, document, &world) {
                Ok(report) => reports.push(report),
                Err(e) => {
                    failure = Some(e.in_file(&self.file, Some(line)));
                    break;
                }
            }
        }
        print(&if self.json { to_json(&reports)? } else { text_of(&reports) })?;
        match failure {
            Some(error) => Err(error.into()),
            None if reports.iter().all(|r| r.report.feasible) => Ok(Verdict::Feasible),
            None => Ok(Verdict::Infeasible),
        }
    }

    /// Trajectories of the file with their line numbers. A pretty-printed document is one trajectory; otherwise each line is one.
    fn documents<'a>(&self, text: &'a str) -> Result<Vec<(usize, &'a str)>> {
        let documents: Vec<(usize, &str)> = match serde_json::from_str::<serde::de::IgnoredAny>(text) {
            Ok(_) => vec![(1, text)],
            Err(e) if self.file.extension().is_some_and(|x| x == "json") => return Err(Error::from(e).in_file(&self.file, None)),
            Err(_) => files::lines(text).collect(),
        };
        if documents.is_empty() {
            return Err(Error::invalid("trajectories", "none", "at least one").in_file(&self.file, None));
        }
        Ok(documents)
    }

    /// Verifies and draws one trajectory.
    fn line(&self, line: usize, document: &str, world: &World) -> Result<Line> {
        let trajectory = Trajectory::from_json(document)?;
        let terms = VerificationTerms::new(world, &trajectory, &self.terms.overrides())?;
        let report = terms.verify()?;
        let VerificationTerms { robot, terrain, force_limit, lines, .. } = terms;
        if let Some(path) = &self.plot {
            let title = format!("{:.2} s, {}", trajectory.horizon, verdict(&trajectory, &report));
            motion_plot::write(&MotionPlot { title, trajectory: &trajectory, robot: &robot, terrain: &terrain, force_limit }, path)?;
        }
        let (robot, terrain) = (robot.name.clone(), terrain.name.clone());
        Ok(Line { line, scenario: trajectory.scenario, robot, terrain, terms: lines, report })
    }
}

fn text_of(reports: &[Line]) -> String {
    let mut text = String::new();
    for r in reports {
        let scenario = r.scenario.as_deref().map(|s| format!("scenario {}, ", shown(s))).unwrap_or_default();
        let terms: String = r.terms.iter().map(|term| format!("  {term}\n")).collect();
        let (robot, terrain) = (shown(&r.robot), shown(&r.terrain));
        text += &format!("line {}: {scenario}robot {robot}, terrain {terrain}\n{terms}{}\n\n", r.line, r.report);
    }
    if reports.len() > 1 {
        let feasible = reports.iter().filter(|r| r.report.feasible).count();
        text += &format!("{feasible} of {} trajectories feasible\n", reports.len());
    }
    text
}
