//! Files of a stage: results, motions, and a scenario file that repeats the search.

use super::label::{Provenance, world_of};
use super::request::Request;
use super::scenario_file::{ScenarioFile, Start, of_state, table_of};
use super::stage::MissionStage;
use crate::error::{Error, Result, to_json};
use crate::files;
use crate::scenario::Scenario;
use crate::search::Gait;
use crate::task::Goal;
use std::path::{Path, PathBuf};

/// Folder of a stage: `out` itself if it is the only one, else `stage-NUMBER` in it.
///
/// * `number` - from 1
/// * `count` - stages of the mission
pub fn stage_folder(out: &Path, number: usize, count: usize) -> PathBuf {
    if count == 1 { out.to_owned() } else { out.join(format!("stage-{number}")) }
}

/// File of a stage: `path` itself if it is the only one, else with `-stage-NUMBER` before the extension.
///
/// * `number` - from 1
/// * `count` - stages of the mission
pub fn stage_file(path: &Path, number: usize, count: usize) -> PathBuf {
    let (stem, extension) = (path.file_stem().unwrap_or_default(), path.extension().unwrap_or_default());
    let numbered = || path.with_file_name(format!("{}-stage-{number}.{}", stem.to_string_lossy(), extension.to_string_lossy()));
    if count == 1 { path.to_owned() } else { numbered() }
}

/// Folders with motions of an earlier run that could be taken for motions of this one.
///
/// * `searched` - stages that have a result
/// * `count` - stages of the mission
pub fn left_over(out: &Path, searched: usize, count: usize) -> Vec<PathBuf> {
    let has_motion = |folder: &PathBuf| folder.join("trajectory.json").is_file();
    let first = if count == 1 { 1 } else { searched + 1 };
    let stages = (first..).map(|number| out.join(format!("stage-{number}"))).take_while(has_motion);
    let whole = Some(out.to_owned()).filter(|out| count > 1 && has_motion(out));
    whole.into_iter().chain(stages).collect()
}

impl MissionStage {
    /// Writes `result.json`, `scenario.toml`, and a trajectory file for each gait. Trajectory files of an earlier run beyond these are
    /// removed.
    ///
    /// # Errors
    /// [`Error::Io`] when the system refuses.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let text = |gait: &Gait| serde_json::to_string(&self.trajectory(gait));
        let trajectories: Vec<String> = self.gaits().map(text).collect::<std::result::Result<_, _>>()?;
        write_trajectories(folder, &trajectories)?;
        files::write(&folder.join("result.json"), &to_json(&self.result())?)?;
        files::write(&folder.join("scenario.toml"), &self.scenario_file()?.text()?)
    }

    /// Scenario file that repeats the search, of a built-in scenario or complete in itself.
    fn scenario_file(&self) -> Result<ScenarioFile> {
        let Request { seed, search, lower, refines, refine } = &self.request;
        let (task, Provenance { scenario, target }) = (&self.task, self.provenance);
        let (robot, terrain) = world_of(task);
        let of_target = |target| Scenario::named(scenario?).ok()?.task(target).ok();
        let is_its = target.and_then(of_target).is_some_and(|own| own.goal == task.goal && own.duration == task.duration);
        let settings = [
            ("search", table_of(search)?),
            ("transcription", table_of(&lower.transcription)?),
            ("solver", table_of(&lower.solver)?),
            ("refine", table_of(refine)?),
        ];
        Ok(ScenarioFile {
            version: Some(env!("CARGO_PKG_VERSION").into()),
            scenario: scenario.map(Into::into),
            target,
            seed: Some(*seed),
            refine: refines.then_some(true),
            transcription: Some(lower.transcription.rows),
            precision: Some(lower.precision),
            device: Some(self.solved_on.choice.to_string()),
            force_limit: task.force_limit,
            start: Some(Start::in_state(&task.start, &task.start_feet)),
            goal: (!is_its).then(|| Goal { time: task.duration, ..of_state(&task.goal) }),
            robot: Some(robot),
            terrain: Some(terrain),
            settings: settings.into_iter().map(|(name, table)| (name.into(), toml::Value::Table(table))).collect(),
            ..ScenarioFile::default()
        })
    }
}

/// Writes the motions of the best gait and its alternatives, and removes those of an earlier run that follow them.
fn write_trajectories(folder: &Path, trajectories: &[String]) -> Result<()> {
    let path = |number: usize| folder.join(if number == 1 { "trajectory.json".into() } else { format!("trajectory-{number}.json") });
    for (number, trajectory) in (1..).zip(trajectories) {
        files::write(&path(number), &format!("{trajectory}\n"))?;
    }
    for path in (trajectories.len() + 1..).map(path).take_while(|path| path.is_file()) {
        std::fs::remove_file(&path).map_err(|source| Error::Io { action: "remove", path, source })?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_of_a_stage_has_its_number_before_the_extension() {
        let named = |file: &str, count: usize| stage_file(Path::new(file), 2, count).to_string_lossy().into_owned();
        assert_eq!(named("to/run1.5.svg", 3), "to/run1.5-stage-2.svg");
        assert_eq!(named("to/run1.5.svg", 1), "to/run1.5.svg");
    }
}
