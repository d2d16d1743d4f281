//! `view`: results as a page for a browser.

use super::args::WorldArgs;
use super::held::{Asked, Held, read_world};
use super::{Failure, Verdict, print_beside};
use crate::error::{Error, Result, from_json};
use crate::gait::Trajectory;
use crate::report::animation::animation;
use crate::report::files;
use crate::report::joints;
use crate::view::{MOST_SCENES, Scene, page};
use clap::Args;
use serde::Deserialize;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub struct View {
    /// Folders that `solve` has written, or trajectories (.json)
    #[arg(required = true, value_name = "OUT")]
    results: Vec<PathBuf>,
    /// The page; default view.html in the folder of the first result
    #[arg(short, long, value_name = "FILE.html")]
    output: Option<PathBuf>,
    /// Draw the first result as a moving picture besides, for pages that run no scripts
    #[arg(long, value_name = "FILE.svg")]
    animate: Option<PathBuf>,
    #[command(flatten)]
    world: WorldArgs,
}

/// A result that is shown.
pub struct Found {
    /// What it is called.
    pub name: String,
    /// Its motion.
    pub trajectory: Trajectory,
    /// What that is held to, and its certificate.
    pub held: Held,
    /// Its gait, and what it costs, where that is known.
    pub about: Vec<String>,
}

impl View {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let world = read_world(&self.world)?;
        if self.results.len() > MOST_SCENES {
            return Err(Error::invalid("results", self.results.len(), format!("at most {MOST_SCENES} on a page")).into());
        }
        let paths: Vec<PathBuf> = self.results.iter().map(|result| trajectory_path(result)).collect::<Result<_>>()?;
        let names = names(&self.results);
        let read = |(path, name): (&PathBuf, String)| {
            let trajectory = Trajectory::from_json(&files::read(path)?).map_err(|e| e.in_file(path, None))?;
            let held = Held::new(&world, &trajectory, &Asked::default()).map_err(|e| e.in_file(path, None))?;
            let joints = joints::limits(&trajectory, &held.robot)?;
            let joints = joints.map(|limits| format!("joints {} their limits", if limits.kept { "within" } else { "beyond" }));
            Ok(Found { name, about: about(path, &trajectory)?.into_iter().chain(joints).collect(), trajectory, held })
        };
        let found: Vec<Found> = paths.iter().zip(names).map(read).collect::<Result<_>>()?;
        let scenes: Vec<Scene> = found.iter().map(scene).collect();
        let output = self.output.clone().unwrap_or_else(|| paths[0].with_file_name("view.html"));
        files::write(&output, &page(&scenes)?)?;
        if let Some(path) = &self.animate {
            let Found { trajectory, held, .. } = &found[0];
            files::write(path, &animation(trajectory, &held.robot, &held.terrain)?)?;
        }
        print_beside(&output, &format!("written to {}; open it in a browser\n", output.display()))?;
        Ok(Verdict::Feasible)
    }
}

/// As the page has it.
pub fn scene(found: &Found) -> Scene<'_> {
    let Held { robot, terrain, force_limit, terms, report } = &found.held;
    Scene {
        name: found.name.clone(),
        trajectory: &found.trajectory,
        robot,
        terrain,
        force_limit: *force_limit,
        terms: terms.clone(),
        report: report.clone(),
        about: found.about.clone(),
    }
}

/// The trajectory of a folder, or the file itself.
fn trajectory_path(result: &Path) -> Result<PathBuf> {
    if !result.is_dir() {
        return Ok(result.to_owned());
    }
    let path = result.join("trajectory.json");
    if path.is_file() {
        return Ok(path);
    }
    Err(Error::invalid("folder", "no trajectory.json in it", "one that `solve --out` has written").in_file(result, None))
}

/// What results are called: the last part of their path, or as much of it as tells them apart.
fn names(results: &[PathBuf]) -> Vec<String> {
    let whole = |path: &PathBuf| std::fs::canonicalize(path).unwrap_or_else(|_| path.clone());
    // The ending is one of files alone.
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

/// What `result.json` beside a trajectory says of it: its gait and what it costs. Nothing where that is the result of another trajectory.
fn about(path: &Path, trajectory: &Trajectory) -> Result<Vec<String>> {
    /// What is read of a result.
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
    Ok(said(gait.family, gait.cost.map(|cost| cost.total)))
}

/// What a page says of a gait: its family and its cost, where they are known.
pub fn said(family: Option<String>, cost: Option<f64>) -> Vec<String> {
    family.into_iter().chain(cost.map(|cost| format!("cost {cost:.3}"))).collect()
}
