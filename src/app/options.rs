//! Settings of both levels from named options, tables of a scenario file and `KEY=VALUE` assignments.

use super::scenario_file::ScenarioFile;
use crate::backend::Precision;
use crate::error::{Error, Result, from_json};
use crate::files;
use crate::gait::Schedule;
use crate::gait::family::GaitFamily;
use crate::search::cem::{Objective, Sampler};
use crate::search::evaluate::LowerSettings;
use crate::search::{Gaits, SearchSettings};
use crate::settings::{Legs, SolverSettings, Transcription, TranscriptionSettings, present_name};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Iterations of the smoothing that `smooth` turns on. With more, the cost falls no further.
const SMOOTH_ITERATIONS: usize = 20;

/// Options of the upper level.
#[derive(Debug, Clone, Default)]
pub struct SearchOptions {
    /// Gaits to search: `all`, names of families separated by commas, `free`, or a file with `durations`.
    pub gait: Option<String>,
    /// Candidates per generation; elites keep their share.
    pub population: Option<usize>,
    /// Largest number of generations after the typical gaits of the families.
    pub generations: Option<usize>,
    /// Name of the objective.
    pub objective: Option<String>,
    /// Time after which a search ends with the best gait so far, s.
    pub time: Option<f64>,
    /// True if a search ends with its first gait.
    pub first: bool,
    /// Number of gaits to return: the best, and the best of other families.
    pub alternatives: Option<usize>,
    /// True for plain random sampling, which never updates the distribution.
    pub random: bool,
}

impl SearchOptions {
    /// Settings with the options applied.
    ///
    /// # Errors
    /// For an unknown gait or objective, and a file without a gait.
    pub fn over(&self, mut settings: SearchSettings) -> Result<SearchSettings> {
        if let Some(gait) = &self.gait {
            settings.gaits = gaits(gait)?;
        }
        if let Some(population) = self.population {
            settings = settings.with_population(population);
        }
        settings.generations = self.generations.unwrap_or(settings.generations);
        if let Some(name) = &self.objective {
            let first_of_many = settings.first && settings.objective != Objective::Feasibility;
            settings = settings.seeking(Objective::named(name)?);
            settings.first |= first_of_many;
        }
        settings.first |= self.first;
        settings.alternatives = self.alternatives.unwrap_or(settings.alternatives);
        settings.seconds = self.time.or(settings.seconds);
        if self.random {
            settings.free.sampler = Sampler::Random;
        }
        Ok(settings)
    }
}

/// Gaits from the text of an option. Names of families take precedence over files of the same name.
fn gaits(text: &str) -> Result<Gaits> {
    /// Durations in a trajectory, in a line of schedules, or in the gait of a result.
    #[derive(Deserialize)]
    struct Durations {
        durations: Schedule,
    }
    #[derive(Deserialize)]
    struct File {
        durations: Option<Schedule>,
        gait: Option<Durations>,
    }
    let path = Path::new(text);
    let families = || text.split(',').map(|name| GaitFamily::named(name.trim())).collect::<Result<_>>().map(Gaits::Families);
    match text {
        "all" => Ok(Gaits::All),
        "free" => Ok(Gaits::Free),
        _ => families().or_else(|unknown| {
            if !path.exists() && path.extension().is_none() {
                return Err(unknown);
            }
            let file: File = from_json(&files::read(path)?).map_err(|e| e.in_file(path, None))?;
            let durations = file.durations.or(file.gait.map(|gait| gait.durations));
            let missing = || Error::Format { message: "missing field `durations`, in the file or in its `gait`".into() };
            durations.map(Gaits::Around).ok_or_else(|| missing().in_file(path, None))
        }),
    }
}

/// Options of the lower level.
#[derive(Debug, Clone, Default)]
pub struct LowerOptions {
    /// Rows that a motion must satisfy.
    pub transcription: Option<Transcription>,
    /// True if forces and base motion are smoothed after each solve.
    pub smooth: bool,
    /// Scalar of the solver.
    pub precision: Option<Precision>,
    /// Assignments `path.to.setting=value`. Those that begin with `search.` or `refine.` belong to the other settings.
    pub set: Vec<String>,
}

impl LowerOptions {
    /// Settings of the lower level: defaults, then keys and tables of the file, then the options, then the assignments.
    ///
    /// * `legs` - default limits of the legs
    ///
    /// # Errors
    /// For unknown settings and values out of their limits.
    pub fn settings(&self, file: &ScenarioFile, legs: Legs) -> Result<LowerSettings> {
        let rows = file.transcription.unwrap_or(Transcription::Momentum);
        let transcription = TranscriptionSettings { legs, ..TranscriptionSettings::of(rows) };
        let mut transcription = merge(transcription, &file.settings_of("transcription")?, "settings.transcription")?;
        transcription.rows = self.transcription.unwrap_or(transcription.rows);
        let solver = smoothed(SolverSettings::default(), file.smooth.unwrap_or(false));
        let solver = smoothed(merge(solver, &file.settings_of("solver")?, "settings.solver")?, self.smooth);
        let precision = self.precision.or(file.precision).unwrap_or(Precision::F32);
        let sets = self.set.iter().filter(|s| !(s.starts_with("search.") || s.starts_with("refine.")));
        let settings = apply(LowerSettings { transcription, solver, precision }, "", sets.map(String::as_str))?;
        settings.validate()?;
        Ok(settings)
    }
}

/// Turns smoothing on, unless the settings have it already.
fn smoothed(mut settings: SolverSettings, smooth: bool) -> SolverSettings {
    if smooth && settings.smooth.iterations == 0 {
        settings.smooth.iterations = SMOOTH_ITERATIONS;
    }
    settings
}

/// Applies `path.to.field=value` assignments to settings.
///
/// * `prefix` - text that users type before the path, for errors
///
/// # Errors
/// [`Error::Unknown`] for an unknown setting; [`Error::Invalid`] for a value of the wrong type, or text without `=`.
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
            Some(place) if !place.is_object() => *place = serde_json::from_str(value).unwrap_or_else(|_| value.into()),
            _ => return Err(Error::Unknown { what: "setting", name: format!("{prefix}{key}"), known: known.join(", ") }),
        }
        let right: serde_json::Result<S> = serde_json::from_value(tree.clone());
        right.map_err(|e| Error::invalid(format!("--set {prefix}{set}"), e, "a value of the setting's type"))?;
    }
    Ok(serde_json::from_value(tree)?)
}

/// Replaces some settings by those of a table.
///
/// * `place` - path of the table, for errors
///
/// # Errors
/// [`Error::Unknown`] or [`Error::Format`] name the setting.
pub fn merge<S: Serialize + DeserializeOwned>(settings: S, table: &toml::Table, place: &str) -> Result<S> {
    let mut tree = serde_json::to_value(settings)?;
    graft(&mut tree, serde_json::to_value(table)?, place)?;
    serde_path_to_error::deserialize(tree).map_err(|e| {
        let path = format!("{place}.{}", e.path());
        Error::Format { message: format!("{path}: {}", e.inner()) }
    })
}

/// Copies the leaves of a tree into another one, which must have all of their keys.
fn graft(tree: &mut serde_json::Value, other: serde_json::Value, place: &str) -> Result<()> {
    match (tree, other) {
        (serde_json::Value::Object(own), serde_json::Value::Object(other)) => {
            for (key, value) in other {
                let Some(inner) = own.get_mut(present_name(&key)) else {
                    let known: Vec<&str> = own.keys().map(String::as_str).collect();
                    return Err(Error::Unknown { what: "setting", known: known.join(", "), name: key }.within(place));
                };
                graft(inner, value, &format!("{place}.{key}"))?;
            }
        }
        (tree, value) => *tree = value,
    }
    Ok(())
}

/// Collects the paths of all leaves of a settings tree.
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
