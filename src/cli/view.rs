//! `view`: writes a web page that shows results.

use super::args::WorldArgs;
use super::{Failure, Verdict, print_about};
use crate::app::page::{Exhibit, description};
use crate::app::{TermOverrides, VerificationTerms};
use crate::error::{Error, Result, from_json};
use crate::files;
use crate::gait::Trajectory;
use crate::gait::joints;
use crate::report::animation::animation;
use crate::view::{MOST_SCENES, Scene, page};
use clap::Args;
use serde::Deserialize;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub struct View {
    /// Folders written by `solve`, or trajectories (.json)
    #[arg(required = true, value_name = "OUT")]
    results: Vec<PathBuf>,
    /// Page to write [default: view.html in the folder of the first result]
    #[arg(short, long, value_name = "FILE.html")]
    output: Option<PathBuf>,
    /// Also write the first result as an animated picture, for pages without scripts
    #[arg(long, value_name = "FILE.svg")]
    animate: Option<PathBuf>,
    #[command(flatten)]
    world: WorldArgs,
}

impl View {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let world = self.world.read_checked()?;
        if self.results.len() > MOST_SCENES {
            return Err(Error::invalid("results", self.results.len(), format!("at most {MOST_SCENES} on a page")).into());
        }
        let paths: Vec<PathBuf> = self.results.iter().map(|result| trajectory_path(result)).collect::<Result<_>>()?;
        let names = names(&self.results);
        let read = |(path, name): (&PathBuf, String)| {
            let trajectory = Trajectory::from_json(&files::read(path)?).map_err(|e| e.in_file(path, None))?;
            let terms = VerificationTerms::new(&world, &trajectory, &TermOverrides::default()).map_err(|e| e.in_file(path, None))?;
            let report = terms.verify().map_err(|e| e.in_file(path, None))?;
            let joints = joints::limits(&trajectory, &terms.robot, &terms.terrain)?;
            let joints = joints.map(|limits| format!("joints {} their limits", if limits.kept { "within" } else { "beyond" }));
            let about = about(path, &trajectory)?.into_iter().chain(joints).collect();
            Ok(Exhibit { name, trajectory, terms, report, about })
        };
        let exhibits: Vec<Exhibit> = paths.iter().zip(names).map(read).collect::<Result<_>>()?;
        let scenes: Vec<Scene> = exhibits.iter().map(Exhibit::scene).collect();
        let output = self.output.clone().unwrap_or_else(|| paths[0].with_file_name("view.html"));
        files::write(&output, &page(&scenes)?)?;
        if let Some(path) = &self.animate {
            let Exhibit { trajectory, terms, .. } = &exhibits[0];
            files::write(path, &animation(trajectory, &terms.robot, &terms.terrain)?)?;
        }
        print_about(&output, &format!("written to {}; open it in a browser\n", output.display()))?;
        Ok(Verdict::Feasible)
    }
}

/// Trajectory file of a folder, or the file itself.
fn trajectory_path(result: &Path) -> Result<PathBuf> {
    if !result.is_dir() {
        return Ok(result.to_owned());
    }
    let path = result.join("trajectory.json");
    if path.is_file() {
        return Ok(path);
    }
    Err(Error::invalid("folder", "no trajectory.json in it", "one that `solve --out` wrote").in_file(result, None))
}

/// Names of results: the last part of their path, or as many parts as make them distinct.
fn names(results: &[PathBuf]) -> Vec<String> {
    let whole = |path: &PathBuf| std::fs::canonicalize(path).unwrap_or_else(|_| path.clone());
    // Only files have an extension.
    let whole = |path: &PathBuf| if path.is_dir() { whole(path) } else { whole(path).with_extension("") };
    let parts: Vec<Vec<String>> =
        results.iter().map(|path| whole(path).components().map(|part| part.as_os_str().to_string_lossy().into_owned()).collect()).collect();
    let tail = |parts: &[String], count: usize| parts[parts.len().saturating_sub(count)..].join("/");
    let most = parts.iter().map(Vec::len).max().unwrap_or(1);
    let apart = |&count: &usize| {
        let distinct: std::collections::BTreeSet<String> = parts.iter().map(|p| tail(p, count)).collect();
        distinct.len() == parts.len()
    };
    let count = (1..most).find(apart).unwrap_or(1);
    parts.iter().map(|p| tail(p, count)).collect()
}

/// Gait and cost from the `result.json` in the folder of a trajectory; empty if that is the result of another trajectory.
fn about(path: &Path, trajectory: &Trajectory) -> Result<Vec<String>> {
    /// Keys of a result that are used.
    #[derive(Deserialize)]
    struct File {
        gait: Gait,
    }
    #[derive(Deserialize)]
    struct Gait {
        family: Option<String>,
        durations: Vec<Vec<f64>>,
        cost: Option<Cost>,
    }
    #[derive(Deserialize)]
    struct Cost {
        total: f64,
    }
    let beside = path.with_file_name("result.json");
    if !beside.is_file() || beside == path {
        return Ok(Vec::new());
    }
    let File { gait } = from_json(&files::read(&beside)?).map_err(|e| e.in_file(&beside, None))?;
    let near = |a: &[f64], b: &[f64]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
    let durations = &trajectory.durations;
    if gait.durations.len() != durations.len() || !gait.durations.iter().zip(durations).all(|(a, b)| near(a, b)) {
        return Ok(Vec::new());
    }
    Ok(description(gait.family, gait.cost.map(|cost| cost.total)))
}
