//! Scenario files: everything that `solve` can be asked, in TOML. Flags override them.

use super::named::{robot, terrain};
use crate::backend::Precision;
use crate::error::{Error, Result, from_toml, to_toml};
use crate::files;
use crate::gait::Trajectory;
use crate::gait::trajectory::NamedOr;
use crate::robot::Robot;
use crate::settings::Transcription;
use crate::task::{BaseState, Goal, Task};
use crate::terrain::Terrain;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Template of a scenario file, with every key explained.
pub const TEMPLATE: &str = include_str!("scenario.toml");

/// Scenario file. Every key is optional; paths are relative to the file. `cregopt init` writes [`TEMPLATE`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScenarioFile {
    /// Version of the program that wrote the file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub version: Option<String>,
    /// Built-in scenario for robot, terrain and goal where these are absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scenario: Option<String>,
    /// Target of the scenario, 1 to 20.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<usize>,
    /// Seed of the search.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Gaits to search: `all`, names of families, `free`, or a file with `durations`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gait: Option<String>,
    /// Search of the paper, by name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<String>,
    /// Objective by which gaits are ranked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub objective: Option<String>,
    /// Candidates per generation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub population: Option<usize>,
    /// Largest number of generations after the typical gaits of the families.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub generations: Option<usize>,
    /// Time after which a search ends with the best gait so far, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time: Option<f64>,
    /// True if a search ends with its first gait.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub first: Option<bool>,
    /// Number of gaits to return.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alternatives: Option<usize>,
    /// True if the best gait is refined to a local optimum of its cost.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refine: Option<bool>,
    /// True if forces and base motion are smoothed after each solve.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub smooth: Option<bool>,
    /// True for plain random sampling.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub random: Option<bool>,
    /// Rows that a motion must satisfy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transcription: Option<Transcription>,
    /// Scalar of the solver.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub precision: Option<Precision>,
    /// Device: `auto`, `cpu`, `gpu` or `gpu:NAME`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// Threads of the CPU; 0: one per processor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threads: Option<usize>,
    /// Largest normal force of a foot, N.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_limit: Option<f64>,
    /// Folder for results.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub out: Option<PathBuf>,
    /// Start of the robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start: Option<Start>,
    /// Goal of the base.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub goal: Option<Goal>,
    /// Places at which the base stops on the path to the goal, in order.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub waypoints: Vec<Goal>,
    /// Robot: a name, a file, or a table.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub robot: Option<NamedOr<Robot>>,
    /// Terrain: a name, a file, or a table.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub terrain: Option<NamedOr<Terrain>>,
    /// Tables `search`, `transcription`, `solver` and `refine` with any settings; a run writes all of them.
    #[serde(skip_serializing_if = "toml::Table::is_empty")]
    pub settings: toml::Table,
}

/// Start of a robot: a place with the keys of a [`Goal`], or the end of a motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Start {
    /// Position, world frame, m; above the origin when absent.
    #[serde(default)]
    pub xy: [f64; 2],
    /// Height, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub z: Option<f64>,
    /// Yaw, rad.
    #[serde(default)]
    pub yaw: f64,
    /// Roll and pitch, rad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tilt: Option<[f64; 2]>,
    /// Velocity, world frame, m/s.
    #[serde(default)]
    pub velocity: [f64; 3],
    /// Rates of roll, pitch and yaw, rad/s.
    #[serde(default)]
    pub rates: [f64; 3],
    /// Foothold of each foot (x, y), world frame, m; the nominal footholds under the base when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feet: Option<Vec<[f64; 2]>>,
    /// Trajectory file at whose end the robot starts; replaces all other keys.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after: Option<PathBuf>,
}

impl Default for Start {
    fn default() -> Start {
        Start::at(Goal::at(0., 0.))
    }
}

impl Start {
    /// Start at a place, with the feet at their nominal footholds.
    pub fn at(Goal { xy, z, yaw, tilt, velocity, rates, .. }: Goal) -> Start {
        Start { xy, z, yaw, tilt, velocity, rates, feet: None, after: None }
    }

    /// Start at the end of the motion in a file.
    pub fn after(path: PathBuf) -> Start {
        Start { after: Some(path), ..Start::default() }
    }

    /// Replaces the yaw, if one is given.
    ///
    /// * `yaw` - rad
    ///
    /// # Errors
    /// [`Error::Invalid`] at the end of a motion, which has a yaw of its own.
    pub fn turned(self, yaw: Option<f64>) -> Result<Start> {
        match yaw {
            None => Ok(self),
            Some(yaw) if self.after.is_none() => Ok(Start { yaw, ..self }),
            Some(yaw) => Err(Start::turned_after(yaw)),
        }
    }

    /// Error for a yaw given together with the end of a motion.
    pub fn turned_after(yaw: f64) -> Error {
        Error::invalid("yaw at the start", yaw, "left out where the start is the end of a motion")
    }

    /// Start in a state with given footholds (x, y), world frame, m.
    pub fn in_state(state: &BaseState, feet: &[[f64; 2]]) -> Start {
        Start { feet: Some(feet.to_vec()), ..Start::at(of_state(state)) }
    }

    /// Place of the start.
    pub fn place(&self) -> Goal {
        Goal { xy: self.xy, z: self.z, yaw: self.yaw, tilt: self.tilt, velocity: self.velocity, rates: self.rates, time: None }
    }

    /// Task from this start to a goal.
    ///
    /// # Errors
    /// Errors of [`Task::new`], and of a file that is not a trajectory.
    pub fn task(&self, robot: Arc<Robot>, terrain: Arc<Terrain>, goal: Goal, force_limit: Option<f64>) -> Result<Task> {
        let task = match self.motion()? {
            Some(motion) => Task::between(robot, terrain, goal, goal)?.after(&motion)?,
            None => Task::from_feet(robot, terrain, self.place(), self.feet.clone(), goal)?,
        };
        let task = Task { force_limit, ..task };
        task.validate()?;
        Ok(task)
    }

    /// Motion at whose end the robot starts, if there is one.
    ///
    /// # Errors
    /// For a file that is not a trajectory.
    pub fn motion(&self) -> Result<Option<Trajectory>> {
        let read = |path: &PathBuf| Trajectory::from_json(&files::read(path)?).map_err(|e| e.in_file(path, None));
        self.after.as_ref().map(read).transpose()
    }
}

/// Goal that states every part of a state.
pub fn of_state(state: &BaseState) -> Goal {
    let ([x, y, z], [roll, pitch, yaw]) = (state.position, state.angles);
    Goal { velocity: state.velocity, rates: state.rates, ..Goal::position([x, y, z]).yaw(yaw).tilt(roll, pitch) }
}

impl ScenarioFile {
    /// Reads a file. Paths in it become relative to the working directory.
    ///
    /// # Errors
    /// [`Error::InFile`] for a file that is not a scenario; [`Error::Io`] for one that cannot be read.
    pub fn read(path: &Path) -> Result<ScenarioFile> {
        ScenarioFile::from_text(&files::read(path)?, path)
    }

    /// Text of the file at `path`; names of files are relative to its folder.
    fn from_text(text: &str, path: &Path) -> Result<ScenarioFile> {
        let read: Result<ScenarioFile> = from_toml(text);
        let mut file = read.map_err(|e| e.in_file(path, None))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let resolve = |name: &mut String| {
            let is_path = Path::new(name.as_str()).extension().is_some() || Path::new(name.as_str()).components().count() > 1;
            if is_path {
                *name = folder.join(&*name).to_string_lossy().into_owned();
            }
        };
        if let Some(NamedOr::Name(name)) = &mut file.robot {
            resolve(name);
        }
        if let Some(NamedOr::Name(name)) = &mut file.terrain {
            resolve(name);
        }
        if let Some(gait) = &mut file.gait {
            resolve(gait);
        }
        for own in [file.out.as_mut(), file.start.as_mut().and_then(|start| start.after.as_mut())].into_iter().flatten() {
            *own = folder.join(&*own);
        }
        file.check_settings().map_err(|e| e.in_file(path, None))?;
        Ok(file)
    }

    /// Checks the names of the tables in `settings`.
    ///
    /// # Errors
    /// [`Error::Unknown`] for an unknown table.
    pub fn check_settings(&self) -> Result<()> {
        const KNOWN: [&str; 4] = ["search", "transcription", "solver", "refine"];
        match self.settings.keys().find(|key| !KNOWN.contains(&key.as_str())) {
            Some(name) => Err(Error::Unknown { what: "table of settings", name: name.clone(), known: KNOWN.join(", ") }),
            None => Ok(()),
        }
    }

    /// File without its task, for the task of another scenario.
    pub fn without_task(self) -> ScenarioFile {
        let file = ScenarioFile { scenario: None, target: None, force_limit: None, start: None, goal: None, ..self };
        ScenarioFile { waypoints: Vec::new(), robot: None, terrain: None, ..file }
    }

    /// File without its settings of search and legs, for those of a preset.
    pub fn without_search(mut self) -> ScenarioFile {
        self.settings.remove("search");
        if let Some(toml::Value::Table(transcription)) = self.settings.get_mut("transcription") {
            transcription.remove("legs");
        }
        let file = ScenarioFile { preset: None, gait: None, population: None, generations: None, objective: None, ..self };
        ScenarioFile { first: None, alternatives: None, random: None, ..file }
    }

    /// Robot, if one is named or described.
    ///
    /// # Errors
    /// For an unknown name, a missing file, or an invalid robot.
    pub fn robot(&self) -> Result<Option<Arc<Robot>>> {
        read(self.robot.as_ref(), robot, Robot::validate_own)
    }

    /// Terrain, if one is named or described.
    ///
    /// # Errors
    /// For an unknown name, a missing file, or an invalid terrain.
    pub fn terrain(&self) -> Result<Option<Arc<Terrain>>> {
        read(self.terrain.as_ref(), terrain, Terrain::validate_own)
    }

    /// Table of settings; empty if the file has none.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the value of this name is not a table.
    pub fn settings_of(&self, name: &str) -> Result<toml::Table> {
        match self.settings.get(name) {
            None => Ok(toml::Table::new()),
            Some(toml::Value::Table(table)) => Ok(table.clone()),
            Some(other) => Err(Error::invalid(format!("settings.{name}"), other, "a table")),
        }
    }

    /// TOML text of the file.
    ///
    /// # Errors
    /// [`Error::Format`] for values that TOML cannot hold.
    pub fn text(&self) -> Result<String> {
        let head = "# All settings of a run: `cregopt solve` with this file finds the same gait.\n\n";
        Ok(head.to_string() + &to_toml(self)?)
    }
}

/// Reads a named thing, or checks a described one.
fn read<T: Clone>(
    from: Option<&NamedOr<T>>,
    named: impl Fn(&str) -> Result<Arc<T>>,
    check: impl Fn(&T) -> Result<()>,
) -> Result<Option<Arc<T>>> {
    match from {
        None => Ok(None),
        Some(NamedOr::Name(name)) => named(name).map(Some),
        Some(NamedOr::Own(own)) => check(own).map(|()| Some(Arc::new(own.clone()))),
    }
}

/// TOML table of settings. Null values are left out, because TOML has no null.
///
/// # Errors
/// [`Error::Format`] for values that TOML cannot hold.
pub fn table_of(settings: &impl Serialize) -> Result<toml::Table> {
    fn without_null(value: serde_json::Value) -> Option<serde_json::Value> {
        match value {
            serde_json::Value::Null => None,
            serde_json::Value::Object(object) => {
                Some(object.into_iter().filter_map(|(key, value)| Some((key, without_null(value)?))).collect())
            }
            other => Some(other),
        }
    }
    let value = without_null(serde_json::to_value(settings)?).unwrap_or_default();
    toml::Table::try_from(value).map_err(|e| Error::Format { message: e.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::Task;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Template with every key active, and with robot and terrain written in full.
    fn everything() -> String {
        let key = |line: &str| line.split_once(" = ").is_some_and(|(key, _)| key.chars().all(|c| c.is_ascii_lowercase() || c == '_'));
        let named = |line: &&str| !line.starts_with("robot = ") && !line.starts_with("terrain = ");
        let lines = TEMPLATE
            .lines()
            .map(|line| line.strip_prefix("# ").filter(|line| key(line) || line.starts_with('[')).unwrap_or(line))
            .filter(named);
        let tables = toml::Table::from_iter([
            ("robot".to_string(), toml::Value::try_from(Robot::named("anymal").unwrap()).unwrap()),
            ("terrain".to_string(), toml::Value::try_from(Terrain::named("gap").unwrap()).unwrap()),
        ]);
        lines.collect::<Vec<_>>().join("\n") + "\n" + &to_toml(&tables).unwrap()
    }

    #[test]
    fn randomly_changed_files_are_read_or_refused() {
        let path = Path::new("walk.toml");
        let good: Vec<char> = everything().chars().collect();
        ScenarioFile::from_text(&everything(), path).unwrap();
        let parts = [
            "\"",
            "'",
            "[",
            "]",
            "[[",
            "{",
            "}",
            "=",
            ",",
            "\n",
            "#",
            "-",
            "0",
            "1e308",
            "-1e-308",
            "nan",
            "inf",
            "true",
            " ",
            "",
            ".",
            "_",
            "\u{e9}",
            "[robot]\n",
            "gap",
            "reach",
        ];
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let (mut posed, mut refused) = (0, 0);
        for i in 0..3000 {
            let mut text = good.clone();
            for _ in 0..random.random_range(0..3) {
                let at = random.random_range(0..text.len());
                let until = (at + random.random_range(0..6)).min(text.len());
                text.splice(at..until, parts[random.random_range(0..parts.len())].chars());
            }
            if i % 20 == 19 {
                text.truncate(random.random_range(0..text.len()));
            }
            let task = ScenarioFile::from_text(&text.into_iter().collect::<String>(), path).and_then(|file| {
                for table in ["search", "transcription", "solver", "refine"] {
                    file.settings_of(table)?;
                }
                let (robot, terrain) = (file.robot()?, file.terrain()?);
                let (start, goal) = (file.start.unwrap_or_default(), file.goal.unwrap_or(Goal::at(1., 0.)));
                let Some((robot, terrain)) = robot.zip(terrain) else { return Ok(None) };
                Task::from_feet(robot, terrain, start.place(), start.feet.clone(), goal)
                    .and_then(|task| task.validate().map(|()| Some(task)))
            });
            match task {
                Ok(task) => posed += usize::from(task.is_some()),
                Err(error) => {
                    assert!(!error.to_string().is_empty());
                    refused += 1;
                }
            }
        }
        assert!(posed > 200 && refused > 200, "{posed} posed, {refused} refused");
    }
}
