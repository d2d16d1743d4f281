//! Scenario files: everything that `solve` can be asked, in TOML. Flags override what stands in them.

use super::args::{robot, terrain};
use super::search_args::SearchArgs;
use crate::backend::Precision;
use crate::error::{Error, Result, from_toml, to_toml};
use crate::gait::Trajectory;
use crate::gait::trajectory::NamedOr;
use crate::report::files;
use crate::robot::Robot;
use crate::settings::Transcription;
use crate::task::{BaseState, Goal, Task};
use crate::terrain::Terrain;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A scenario. Every key may be left out; paths are relative to the file. `cregopt init` writes one with all keys explained.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScenarioFile {
    /// Version of the program that wrote it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub version: Option<String>,
    /// Built-in scenario that fills in what is left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scenario: Option<String>,
    /// Its target, 1 to 20.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<usize>,
    /// Seed of the search.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// As `--gait`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gait: Option<String>,
    /// The paper's search, by name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<String>,
    /// What is best among gaits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub objective: Option<String>,
    /// Candidates a generation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub population: Option<usize>,
    /// Most generations behind the families' typical gaits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub generations: Option<usize>,
    /// End after this time with the best so far, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time: Option<f64>,
    /// End with the first gait.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub first: Option<bool>,
    /// Gaits to return.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alternatives: Option<usize>,
    /// Bring the gait to a local optimum of its cost.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refine: Option<bool>,
    /// Lower forces and base motion after each solve.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub smooth: Option<bool>,
    /// Plain random sampling.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub random: Option<bool>,
    /// Rows that a motion must satisfy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transcription: Option<Transcription>,
    /// Scalar of the solver.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub precision: Option<Precision>,
    /// Where to solve: `auto`, `cpu`, `gpu` or `gpu:NAME`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// Threads; 0 is one a processor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threads: Option<usize>,
    /// Largest normal force of a foot, N.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_limit: Option<f64>,
    /// Folder for results.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub out: Option<PathBuf>,
    /// Where the robot starts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start: Option<Start>,
    /// Where its base is to end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub goal: Option<Goal>,
    /// Places on the way at which the base is to be, in order.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub waypoints: Vec<Goal>,
    /// Robot: a name, a file, or a table.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub robot: Option<NamedOr<Robot>>,
    /// Terrain: a name, a file, or a table.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub terrain: Option<NamedOr<Terrain>>,
    /// Any setting in the tables `search`, `transcription`, `solver` and `refine`, as in the file that a run writes.
    #[serde(skip_serializing_if = "toml::Table::is_empty")]
    pub settings: toml::Table,
}

/// Where a robot starts: a place, as of a [`Goal`], or the end of a motion.
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
    /// Where each foot stands (x, y), m; at its nominal place under the base when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feet: Option<Vec<[f64; 2]>>,
    /// Trajectory file at whose end to start, instead of all these.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after: Option<PathBuf>,
}

impl Default for Start {
    fn default() -> Start {
        Start::at(Goal::at(0., 0.))
    }
}

impl Start {
    /// At a place, with the feet under it.
    pub fn at(Goal { xy, z, yaw, tilt, velocity, rates }: Goal) -> Start {
        Start { xy, z, yaw, tilt, velocity, rates, feet: None, after: None }
    }

    /// At the end of the motion of a file.
    pub fn after(path: PathBuf) -> Start {
        Start { after: Some(path), ..Start::default() }
    }

    /// With another yaw, rad, if one is given.
    ///
    /// # Errors
    /// [`Error::Invalid`] where the end of a motion says which it is.
    pub fn turned(self, yaw: Option<f64>) -> Result<Start> {
        match yaw {
            None => Ok(self),
            Some(yaw) if self.after.is_none() => Ok(Start { yaw, ..self }),
            Some(yaw) => Err(Start::turned_after(yaw)),
        }
    }

    /// A yaw beside the end of a motion.
    pub fn turned_after(yaw: f64) -> Error {
        Error::invalid("yaw at the start", yaw, "left out where the start is the end of a motion")
    }

    /// In a state, with the feet in their places.
    pub fn in_state(state: &BaseState, feet: &[[f64; 2]]) -> Start {
        Start { feet: Some(feet.to_vec()), ..Start::at(of_state(state)) }
    }

    /// The place.
    pub fn place(&self) -> Goal {
        Goal { xy: self.xy, z: self.z, yaw: self.yaw, tilt: self.tilt, velocity: self.velocity, rates: self.rates }
    }

    /// The task of going from here to a goal.
    ///
    /// # Errors
    /// As [`Task::new`], and for a file that is no trajectory.
    pub fn task(&self, robot: Arc<Robot>, terrain: Arc<Terrain>, goal: Goal, force_limit: Option<f64>) -> Result<Task> {
        let task = match self.motion()? {
            Some(motion) => Task::between(robot, terrain, goal, goal)?.after(&motion)?,
            None => Task::from_feet(robot, terrain, self.place(), self.feet.clone(), goal)?,
        };
        let task = Task { force_limit, ..task };
        task.validate()?;
        Ok(task)
    }

    /// The motion at whose end to start.
    ///
    /// # Errors
    /// For a file that is no trajectory.
    pub fn motion(&self) -> Result<Option<Trajectory>> {
        let read = |path: &PathBuf| Trajectory::from_json(&files::read(path)?).map_err(|e| e.in_file(path, None));
        self.after.as_ref().map(read).transpose()
    }
}

/// A state as a goal that says everything.
pub fn of_state(state: &BaseState) -> Goal {
    let ([x, y, z], [roll, pitch, yaw]) = (state.position, state.angles);
    Goal { velocity: state.velocity, rates: state.rates, ..Goal::position([x, y, z]).yaw(yaw).tilt(roll, pitch) }
}

impl ScenarioFile {
    /// Reads a file; relative paths in it become relative to the working directory.
    ///
    /// # Errors
    /// [`Error::InFile`] for what cannot be read or is no scenario.
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

    /// Checks the names of the tables of settings.
    ///
    /// # Errors
    /// [`Error::Unknown`] for one that nothing reads.
    pub fn check_settings(&self) -> Result<()> {
        const KNOWN: [&str; 4] = ["search", "transcription", "solver", "refine"];
        match self.settings.keys().find(|key| !KNOWN.contains(&key.as_str())) {
            Some(name) => Err(Error::Unknown { what: "table of settings", name: name.clone(), known: KNOWN.join(", ") }),
            None => Ok(()),
        }
    }

    /// What it asks of the search.
    pub fn search(&self) -> SearchArgs {
        SearchArgs {
            gait: self.gait.clone(),
            population: self.population,
            generations: self.generations,
            objective: self.objective.clone(),
            time: self.time,
            first: self.first.unwrap_or(false),
            alternatives: self.alternatives,
            random: self.random.unwrap_or(false),
        }
    }

    /// Without its task, for that of another scenario.
    pub fn without_task(self) -> ScenarioFile {
        let file = ScenarioFile { scenario: None, target: None, force_limit: None, start: None, goal: None, ..self };
        ScenarioFile { waypoints: Vec::new(), robot: None, terrain: None, ..file }
    }

    /// Without what it says of gaits and legs, for what a preset says.
    pub fn without_search(mut self) -> ScenarioFile {
        self.settings.remove("search");
        if let Some(toml::Value::Table(transcription)) = self.settings.get_mut("transcription") {
            transcription.remove("legs");
        }
        let file = ScenarioFile { preset: None, gait: None, population: None, generations: None, objective: None, ..self };
        ScenarioFile { first: None, alternatives: None, random: None, ..file }
    }

    /// The robot, if one is named or described.
    ///
    /// # Errors
    /// For a name or a file that does not exist, or no possible robot.
    pub fn robot(&self) -> Result<Option<Arc<Robot>>> {
        read(self.robot.as_ref(), robot, Robot::validate_own)
    }

    /// The terrain, if one is named or described.
    ///
    /// # Errors
    /// For a name or a file that does not exist, or no possible terrain.
    pub fn terrain(&self) -> Result<Option<Arc<Terrain>>> {
        read(self.terrain.as_ref(), terrain, Terrain::validate_own)
    }

    /// A table of settings; empty when the file has none.
    ///
    /// # Errors
    /// [`Error::Invalid`] when something else has its name.
    pub fn settings_of(&self, name: &str) -> Result<toml::Table> {
        match self.settings.get(name) {
            None => Ok(toml::Table::new()),
            Some(toml::Value::Table(table)) => Ok(table.clone()),
            Some(other) => Err(Error::invalid(format!("settings.{name}"), other, "a table")),
        }
    }

    /// As text.
    ///
    /// # Errors
    /// [`Error::Format`] for what TOML cannot hold.
    pub fn text(&self) -> Result<String> {
        let head = "# What was asked, whole: `cregopt solve` with this file finds the same gait.\n\n";
        Ok(head.to_string() + &to_toml(self)?)
    }
}

/// What is named, or described and possible.
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

/// A settings tree as a table of TOML, which has no word for nothing.
///
/// # Errors
/// [`Error::Format`] for what TOML cannot hold.
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
    use crate::cli::init::TEMPLATE;
    use crate::task::Task;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// The commented scenario with every key in force, and with its robot and terrain in full.
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
    fn mutated_files_are_read_or_refused() {
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
