//! Arguments that several commands share.

use super::Failure;
use super::scenario_file::{ScenarioFile, Start};
use crate::backend::{Backend, Cpu, Precision};
use crate::error::{Error, Result, check_range};
use crate::reference::ipopt;
use crate::reference::workers::Workers;
use crate::robot::{ROBOTS, Robot};
use crate::scenario::Scenario;
use crate::search::evaluate::LowerSettings;
use crate::settings::{Legs, SolverSettings, Transcription, TranscriptionSettings, present_name};
use crate::task::{Goal, Task};
use crate::terrain::{TERRAINS, Terrain};
use clap::Args;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::f64::consts::PI;
use std::path::Path;
use std::sync::{Arc, Once};
use tracing::warn;

/// A goal more than a turn away is told of once.
static TURNS: Once = Once::new();

/// What is odd in a yaw at the goal, rad, that may be one in degrees.
pub fn in_degrees(yaw: f64) -> Option<String> {
    let turns = yaw / (2. * PI);
    (turns.abs() > 1.).then(|| format!("goal yaw {yaw} rad is {turns:.1} turns; {yaw} degrees are {:.4} rad", yaw.to_radians()))
}

/// Robot by name, or a JSON or TOML file.
pub fn robot(name: &str) -> Result<Arc<Robot>> {
    named_or_file(name, &ROBOTS, "robot", Robot::named, Robot::read).map(Arc::new)
}

/// Terrain by name, or a JSON or TOML file.
pub fn terrain(name: &str) -> Result<Arc<Terrain>> {
    named_or_file(name, &TERRAINS, "terrain", Terrain::named, Terrain::read).map(Arc::new)
}

fn named_or_file<T>(
    name: &str,
    known: &[&str],
    what: &'static str,
    named: impl Fn(&str) -> Result<T>,
    read: impl Fn(&Path) -> Result<T>,
) -> Result<T> {
    let path = Path::new(name);
    if known.contains(&name) {
        named(name)
    } else if path.exists() || path.extension().is_some() || path.components().count() > 1 {
        read(path)
    } else {
        Err(Error::Unknown { what, name: name.into(), known: format!("{}, or a .json or .toml file", known.join(", ")) })
    }
}

/// Robot and ground.
#[derive(Debug, Clone, Default, Args)]
pub struct WorldArgs {
    /// Robot: a name from `list`, or a JSON or TOML file; the scenario's by default. SCENARIO=NAME|FILE for the lines of one scenario
    #[arg(long, value_name = "NAME|FILE")]
    pub robot: Vec<String>,
    /// Terrain: as --robot
    #[arg(long, value_name = "NAME|FILE")]
    pub terrain: Vec<String>,
    /// Largest normal force of a foot, N; else the robot's (from its weight and feet unless its file says), with TOWR's rows 1000
    #[arg(long, value_name = "N")]
    pub force_limit: Option<f64>,
}

/// What was named for one scenario, or for all.
#[derive(Debug)]
struct Choices<T>(Vec<(Option<&'static str>, Arc<T>)>);

impl<T> Choices<T> {
    fn read(texts: &[String], read: impl Fn(&str) -> Result<Arc<T>>) -> Result<Self> {
        let choice = |text: &String| match text.split_once('=') {
            // Folders and files may have a `=` in their names.
            Some((scenario, name)) if !Path::new(text).exists() => Ok((Some(Scenario::named(scenario)?.name), read(name)?)),
            _ => Ok((None, read(text)?)),
        };
        texts.iter().map(choice).collect::<Result<_>>().map(Choices)
    }

    fn one(choice: Option<Arc<T>>) -> Self {
        Choices(choice.map(|choice| (None, choice)).into_iter().collect())
    }

    /// The choice for a scenario: its own before the one for all, the last given before earlier ones.
    fn get(&self, scenario: Option<&str>) -> Option<Arc<T>> {
        let own = self.0.iter().rfind(|(s, _)| s.is_some() && *s == scenario);
        own.or_else(|| self.0.iter().rfind(|(s, _)| s.is_none())).map(|(_, v)| v.clone())
    }
}

/// Robots and terrains that were named, read once.
#[derive(Debug)]
pub struct World {
    robots: Choices<Robot>,
    terrains: Choices<Terrain>,
    pub force_limit: Option<f64>,
}

impl WorldArgs {
    /// Reads what was named.
    pub fn read(&self) -> Result<World> {
        self.over(&ScenarioFile::default())
    }

    /// Reads what was named, and what a file says besides.
    pub fn over(&self, file: &ScenarioFile) -> Result<World> {
        let (mut robots, mut terrains) = (Choices::read(&self.robot, robot)?, Choices::read(&self.terrain, terrain)?);
        if robots.0.is_empty() {
            robots.0.extend(file.robot()?.map(|own| (None, own)));
        }
        if terrains.0.is_empty() {
            terrains.0.extend(file.terrain()?.map(|own| (None, own)));
        }
        Ok(World { robots, terrains, force_limit: self.force_limit.or(file.force_limit) })
    }
}

/// Where a goal comes from: a scenario's target, or numbers, which win.
#[derive(Debug, Clone, Copy, Default)]
pub struct GoalSource {
    pub target: Option<usize>,
    pub goal: Option<Goal>,
    /// Final yaw, rad; when absent the scenario's, or 0, whatever the goal has.
    pub yaw: Option<f64>,
}

impl World {
    /// One robot and one terrain, each if any, for all scenarios.
    pub fn of(robot: Option<Arc<Robot>>, terrain: Option<Arc<Terrain>>, force_limit: Option<f64>) -> World {
        let (robots, terrains) = (Choices::one(robot), Choices::one(terrain));
        World { robots, terrains, force_limit }
    }

    /// Checks the largest normal force that was named.
    pub fn check_force_limit(&self) -> Result<()> {
        self.force_limit.map_or(Ok(()), |limit| check_range("--force-limit", limit, 1e-3, 1e7))
    }

    /// The robot that was named for a scenario.
    pub fn robot(&self, scenario: Option<&str>) -> Option<Arc<Robot>> {
        self.robots.get(scenario)
    }

    /// The terrain that was named for a scenario.
    pub fn terrain(&self, scenario: Option<&str>) -> Option<Arc<Terrain>> {
        self.terrains.get(scenario)
    }

    /// A task from what was named, the scenario filling in the rest.
    pub fn task(&self, scenario: Option<&Scenario>, start: &Start, goal: GoalSource) -> Result<Task> {
        let missing = |what: &str, by: &str| {
            Error::invalid(what, "none", format!("given by {by}, or by a scenario (--scenario, or `scenario` in the line)"))
        };
        let name = scenario.map(|s| s.name);
        let robot = match (self.robot(name), scenario) {
            (Some(robot), _) => robot,
            (None, Some(s)) => Arc::new(Robot::named(s.robot)?),
            (None, None) => return Err(missing("robot", "--robot")),
        };
        let terrain = match (self.terrain(name), scenario) {
            (Some(terrain), _) => terrain,
            (None, Some(s)) => Arc::new(Terrain::named(s.terrain)?),
            (None, None) => Arc::new(Terrain::named("flat")?),
        };
        let place = match (goal.goal, goal.target) {
            (Some(place), _) => place,
            (None, Some(target)) => {
                let [x, y] = Scenario::goal(target)?;
                Goal::at(x, y)
            }
            (None, None) => return Err(missing("goal", "--goal, `base_target` in the line, `goal` in a scenario file")),
        };
        let yaw = goal.yaw.or(scenario.map(|s| s.yaw_target)).unwrap_or(0.);
        if let Some(doubt) = in_degrees(yaw) {
            TURNS.call_once(|| warn!("{doubt}"));
        }
        let place = place.yaw(yaw);
        start.task(robot, terrain, place, self.force_limit)
    }
}

/// Iterations of `--smooth`: after as many, the cost falls no further.
const SMOOTH_ITERATIONS: usize = 20;

/// Where to solve.
#[derive(Debug, Clone, Default, Args)]
pub struct DeviceArgs {
    /// Where to solve: `auto` takes a GPU for batches that it measured to be sooner done there, `gpu:NAME` an adapter of that name, see `devices` [default: auto]
    #[arg(long, value_name = "auto|cpu|gpu[:NAME]")]
    pub device: Option<DeviceArg>,
    /// Threads; 0 is one a processor. Results do not depend on it [default: 0]
    #[arg(long)]
    pub threads: Option<usize>,
}

/// How to solve.
#[derive(Debug, Clone, Default, Args)]
pub struct LowerArgs {
    /// Rows that a motion must satisfy [default: momentum]
    #[arg(long, value_enum)]
    pub transcription: Option<Transcription>,
    /// Lower a cost of forces and of base motion after each solve: feasible and gentler, a third slower
    #[arg(long)]
    pub smooth: bool,
    /// Scalar of the solver [default: f32]
    #[arg(long, value_enum)]
    pub precision: Option<Precision>,
    #[command(flatten)]
    pub place: DeviceArgs,
    /// Any setting by its path, e.g. `solver.max_iterations=100`; all are in the tables of scenario.toml
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// What a scenario file says.
    #[arg(skip)]
    file: LowerOfFile,
}

/// What a scenario file says of how to solve.
#[derive(Debug, Clone, Default)]
struct LowerOfFile {
    transcription: Option<Transcription>,
    smooth: bool,
    /// Its tables.
    of_transcription: toml::Table,
    of_solver: toml::Table,
}

impl LowerArgs {
    /// What is not given here as in a scenario file.
    pub fn over(self, file: &ScenarioFile) -> Result<LowerArgs> {
        let device = file.device.as_deref().map(|text| {
            let known = |e: String| Error::invalid("device", format!("`{}`", text.escape_debug()), e);
            text.parse::<DeviceArg>().map_err(known)
        });
        Ok(LowerArgs {
            precision: self.precision.or(file.precision),
            place: DeviceArgs { device: self.place.device.or(device.transpose()?), threads: self.place.threads.or(file.threads) },
            file: LowerOfFile {
                transcription: file.transcription,
                smooth: file.smooth.unwrap_or(false),
                of_transcription: file.settings_of("transcription")?,
                of_solver: file.settings_of("solver")?,
            },
            ..self
        })
    }

    /// Settings of the lower level; keys that begin with `search.` or `refine.` are left alone.
    ///
    /// * `legs` - what legs can do, unless it is set
    pub fn settings(&self, legs: Legs) -> Result<LowerSettings> {
        let rows = self.file.transcription.unwrap_or(Transcription::Momentum);
        let transcription = TranscriptionSettings { legs, ..TranscriptionSettings::of(rows) };
        let mut transcription = merge(transcription, &self.file.of_transcription, "settings.transcription")?;
        transcription.rows = self.transcription.unwrap_or(transcription.rows);
        let solver = smoothed(SolverSettings::default(), self.file.smooth);
        let solver = smoothed(merge(solver, &self.file.of_solver, "settings.solver")?, self.smooth);
        let settings = LowerSettings { transcription, solver, precision: self.precision.unwrap_or(Precision::F32) };
        let sets = self.set.iter().filter(|s| !(s.starts_with("search.") || s.starts_with("refine.")));
        let settings = apply(settings, "", sets.map(String::as_str))?;
        settings.validate()?;
        Ok(settings)
    }
}

/// Settings with smoothing, where that is asked for and they have none.
fn smoothed(mut settings: SolverSettings, smooth: bool) -> SolverSettings {
    if smooth && settings.smooth.iterations == 0 {
        settings.smooth.iterations = SMOOTH_ITERATIONS;
    }
    settings
}

impl DeviceArgs {
    /// The device that was asked for, for batches of a size.
    pub fn backend(&self, batch: usize, precision: Precision) -> std::result::Result<Box<dyn Backend>, Failure> {
        let threads = check_threads(self.threads.unwrap_or(0))?;
        let cpu = || Ok(Box::new(Cpu::new(threads)?) as Box<dyn Backend>);
        match (self.device.as_ref().unwrap_or(&DeviceArg::Auto), precision) {
            (DeviceArg::Cpu, _) | (DeviceArg::Auto, Precision::F64) => cpu(),
            (DeviceArg::Gpu(_), Precision::F64) => {
                Err(Error::invalid("--device", "gpu", "`cpu` or `auto` with --precision f64, which only the CPU has").into())
            }
            (DeviceArg::Gpu(name), _) => Ok(gpu(name.as_deref(), threads)?),
            (DeviceArg::Auto, _) if batch < AUTO_BATCH => cpu(),
            (DeviceArg::Auto, _) => sooner(batch, Cpu::new(threads)?).or_else(|error| {
                warn!("on the CPU: {error}");
                cpu()
            }),
        }
    }
}

/// A GPU or a software adapter, by its name or the first one.
#[cfg(feature = "gpu")]
fn gpu(name: Option<&str>, threads: usize) -> Result<Box<dyn Backend>> {
    Ok(Box::new(crate::backend::Gpu::open(name, threads)?))
}

/// A GPU where a batch is sooner done on it, otherwise the CPU.
#[cfg(feature = "gpu")]
fn sooner(batch: usize, cpu: Cpu) -> Result<Box<dyn Backend>> {
    use crate::backend::gpu::{Folder, crossover::choose};
    choose(batch, cpu, &Folder::of_user())
}

#[cfg(not(feature = "gpu"))]
fn gpu(_: Option<&str>, _: usize) -> Result<Box<dyn Backend>> {
    Err(Error::Device { message: "this program was built without the feature `gpu`".into() })
}

#[cfg(not(feature = "gpu"))]
fn sooner(_: usize, cpu: Cpu) -> Result<Box<dyn Backend>> {
    gpu(None, cpu.threads())
}

/// Processes of this program that solve with Ipopt.
pub fn workers(threads: usize) -> Result<Workers> {
    ipopt::check()?;
    let program = std::env::current_exe().map_err(|source| Error::Io { action: "find", path: "this program".into(), source })?;
    Ok(Workers::new(program, check_threads(threads)?))
}

/// Checks how many threads are asked for.
pub fn check_threads(threads: usize) -> Result<usize> {
    if threads > MAX_THREADS {
        return Err(Error::invalid("--threads", threads, format!("at most {MAX_THREADS}")));
    }
    Ok(threads)
}

/// Most threads that can be asked for.
const MAX_THREADS: usize = 4096;

/// Candidates at once from which `--device auto` looks for a GPU: fewer are solved before it is measured.
pub const AUTO_BATCH: usize = 64;

/// `--device`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DeviceArg {
    /// A GPU for large batches, else the CPU.
    Auto,
    /// The CPU.
    Cpu,
    /// A GPU, or a software adapter; the first one, or one of a name.
    Gpu(Option<String>),
}

impl std::str::FromStr for DeviceArg {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text.split_once(':') {
            None if text == "auto" => Ok(DeviceArg::Auto),
            None if text == "cpu" => Ok(DeviceArg::Cpu),
            None if text == "gpu" => Ok(DeviceArg::Gpu(None)),
            Some(("gpu", name)) if !name.is_empty() => Ok(DeviceArg::Gpu(Some(name.into()))),
            _ => Err("expected auto, cpu, gpu, or gpu: and part of an adapter's name".into()),
        }
    }
}

/// Applies `path.to.field=value` assignments to settings. `prefix` is what users type before the path.
pub fn apply<'a, S: Serialize + DeserializeOwned>(settings: S, prefix: &str, sets: impl Iterator<Item = &'a str>) -> Result<S> {
    let mut tree = serde_json::to_value(settings)?;
    let mut known = Vec::new();
    leaves(&tree, prefix.trim_end_matches('.').into(), &mut known);
    for set in sets {
        let Some((key, value)) = set.split_once('=') else {
            return Err(Error::invalid("--set", set, "KEY=VALUE"));
        };
        let pointer: String = key.split('.').map(|name| format!("/{}", present_name(name))).collect();
        match tree.pointer_mut(&pointer) {
            Some(slot) if !slot.is_object() => *slot = serde_json::from_str(value).unwrap_or_else(|_| value.into()),
            _ => return Err(Error::Unknown { what: "setting", name: format!("{prefix}{key}"), known: known.join(", ") }),
        }
        let right: serde_json::Result<S> = serde_json::from_value(tree.clone());
        right.map_err(|e| Error::invalid(format!("--set {prefix}{set}"), e, "a value of the setting's type"))?;
    }
    Ok(serde_json::from_value(tree)?)
}

/// Settings with a table of some of them on top.
///
/// * `place` - where the table stands, for errors
pub fn merge<S: Serialize + DeserializeOwned>(settings: S, table: &toml::Table, place: &str) -> Result<S> {
    let mut tree = serde_json::to_value(settings)?;
    graft(&mut tree, serde_json::to_value(table)?, place)?;
    serde_path_to_error::deserialize(tree).map_err(|e| {
        let path = format!("{place}.{}", e.path());
        Error::Format { message: format!("{path}: {}", e.inner()) }
    })
}

/// Puts the leaves of a tree into another that has a place for each.
fn graft(tree: &mut serde_json::Value, other: serde_json::Value, place: &str) -> Result<()> {
    match (tree, other) {
        (serde_json::Value::Object(own), serde_json::Value::Object(other)) => {
            for (key, value) in other {
                let Some(slot) = own.get_mut(present_name(&key)) else {
                    let known: Vec<&str> = own.keys().map(String::as_str).collect();
                    return Err(Error::Unknown { what: "setting", known: known.join(", "), name: key }.within(place));
                };
                graft(slot, value, &format!("{place}.{key}"))?;
            }
        }
        (slot, value) => *slot = value,
    }
    Ok(())
}

/// Paths of all leaves of a settings tree.
fn leaves(tree: &serde_json::Value, path: String, into: &mut Vec<String>) {
    match tree.as_object() {
        Some(object) => {
            for (key, value) in object {
                leaves(value, if path.is_empty() { key.clone() } else { format!("{path}.{key}") }, into);
            }
        }
        None => into.push(path),
    }
}

/// `--goal`: `X,Y` or `X,Y,Z`, m.
#[derive(Debug, Clone, Copy)]
pub struct GoalArg {
    /// Where on the ground.
    pub xy: [f64; 2],
    /// Height, if given.
    pub z: Option<f64>,
}

impl GoalArg {
    /// As a goal.
    pub fn goal(self) -> Goal {
        let [x, y] = self.xy;
        Goal { z: self.z, ..Goal::at(x, y) }
    }
}

impl std::str::FromStr for GoalArg {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let numbers: std::result::Result<Vec<f64>, _> = text.split(',').map(|v| v.trim().parse::<f64>()).collect();
        match numbers.as_deref() {
            Ok(numbers) if numbers.iter().any(|v| !v.is_finite()) => Err("expected finite numbers".into()),
            Ok(&[x, y]) => Ok(GoalArg { xy: [x, y], z: None }),
            Ok(&[x, y, z]) => Ok(GoalArg { xy: [x, y], z: Some(z) }),
            _ => Err("expected X,Y or X,Y,Z in metres".into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::StallSettings;

    #[test]
    fn former_names_of_settings_are_read() {
        let expected = StallSettings { early_termination: 2., ..StallSettings::default() };
        assert_eq!(apply(StallSettings::default(), "", ["hopeless_above=2"].into_iter()).unwrap(), expected);
        let table = toml::from_str("hopeless_above = 2").unwrap();
        assert_eq!(merge(StallSettings::default(), &table, "settings.solver.stall").unwrap(), expected);
        assert_eq!(serde_json::from_str::<StallSettings>(r#"{ "hopeless_above": 2 }"#).unwrap(), expected);
    }
}
