//! Scenario file with overrides: the mission, the request and the device that they describe.

use super::label::Provenance;
use super::options::{LowerOptions, SearchOptions, apply, merge};
use super::request::{Mission, Request, Waypoint};
use super::scenario_file::{ScenarioFile, Start};
use super::world::{GoalSource, WorldNames};
use crate::backend::{Backend, DeviceChoice, Precision};
use crate::error::Result;
use crate::refine::RefineSettings;
use crate::scenario::Scenario;
use crate::search::SearchSettings;
use crate::settings::Legs;
use crate::task::{Goal, Task};
use std::path::PathBuf;

/// Default seed.
const SEED: u64 = 1;

/// Default target of a scenario.
const TARGET: usize = 10;

/// Values that override those of a scenario file. Absent values leave the file's.
#[derive(Debug, Clone, Default)]
pub struct Overrides {
    /// Built-in scenario. Another one than the file's drops the file's task.
    pub scenario: Option<String>,
    /// Target of the scenario, 1 to 20. Drops the file's goal and waypoints.
    pub target: Option<usize>,
    /// Goal; its yaw is ignored. Drops the file's waypoints.
    pub goal: Option<Goal>,
    /// Final yaw, rad.
    pub yaw: Option<f64>,
    /// Start.
    pub start: Option<Start>,
    /// Yaw at the start, rad.
    pub start_yaw: Option<f64>,
    /// Waypoints; none keep the file's.
    pub waypoints: Vec<Waypoint>,
    /// Robots, terrains and force limit.
    pub world: WorldNames,
    /// Seed of the search.
    pub seed: Option<u64>,
    /// Search of the paper, by name. Drops the file's settings of the search.
    pub preset: Option<String>,
    /// Options of the upper level.
    pub search: SearchOptions,
    /// True to refine the best gait.
    pub refine: bool,
    /// Options of the lower level, and assignments to any setting.
    pub lower: LowerOptions,
    /// Device.
    pub device: Option<DeviceChoice>,
    /// Threads of the CPU; 0: one per processor.
    pub threads: Option<usize>,
    /// Folder for results.
    pub out: Option<PathBuf>,
}

/// Scenario file with overrides.
#[derive(Debug, Clone)]
pub struct Setup {
    /// Scenario file, without the parts that the overrides drop.
    file: ScenarioFile,
    overrides: Overrides,
    device: DeviceChoice,
}

impl Setup {
    /// Puts overrides over a scenario file.
    ///
    /// # Errors
    /// For an unknown device, and settings that are not a table.
    pub fn new(mut file: ScenarioFile, overrides: Overrides) -> Result<Setup> {
        if overrides.scenario.is_some() && file.scenario.is_some() && overrides.scenario != file.scenario {
            file = file.without_task();
        }
        if overrides.preset.is_some() {
            file = file.without_search();
        }
        if overrides.goal.is_some() || overrides.target.is_some() {
            // The file's waypoints lead to its own goal.
            file = ScenarioFile { goal: None, waypoints: Vec::new(), ..file };
        }
        let of_file = file.device.as_deref().map(str::parse).transpose()?;
        for table in ["transcription", "solver"] {
            file.settings_of(table)?;
        }
        let device = overrides.device.clone().or(of_file).unwrap_or_default();
        Ok(Setup { file, overrides, device })
    }

    /// Folder for results, if one was given.
    pub fn out(&self) -> Option<PathBuf> {
        self.overrides.out.clone().or_else(|| self.file.out.clone())
    }

    /// Opens the device.
    ///
    /// * `batch` - candidates per batch
    ///
    /// # Errors
    /// Errors of [`DeviceChoice::open`].
    pub fn backend(&self, batch: usize, precision: Precision) -> Result<Box<dyn Backend>> {
        self.device.open(batch, self.overrides.threads.or(self.file.threads).unwrap_or(0), precision)
    }

    /// Mission: task, waypoints and provenance.
    ///
    /// # Errors
    /// For a task that is incomplete or impossible.
    pub fn mission(&self) -> Result<Mission> {
        let name = self.overrides.scenario.as_ref().or(self.file.scenario.as_ref());
        let scenario = name.map(|name| Scenario::named(name)).transpose()?;
        let target = self.overrides.target.or(self.file.target).unwrap_or(TARGET);
        let by_target = scenario.is_some() && self.overrides.goal.is_none() && self.file.goal.is_none();
        let provenance = Provenance { scenario: scenario.as_ref().map(|s| s.name), target: by_target.then_some(target) };
        let waypoints = if self.overrides.waypoints.is_empty() {
            self.file.waypoints.iter().map(|&goal| goal.into()).collect()
        } else {
            self.overrides.waypoints.clone()
        };
        Ok(Mission { task: self.task(scenario.as_ref(), target)?, waypoints, provenance })
    }

    fn task(&self, scenario: Option<&Scenario>, target: usize) -> Result<Task> {
        let goal = GoalSource {
            target: scenario.map(|_| target),
            goal: self.overrides.goal.or(self.file.goal),
            yaw: self.overrides.yaw.or(self.file.goal.map(|goal| goal.yaw)),
        };
        let start = self.overrides.start.as_ref().or(self.file.start.as_ref()).cloned().unwrap_or_default();
        let start = start.turned(self.overrides.start_yaw)?;
        self.overrides.world.over(&self.file)?.task(scenario, &start, goal)
    }

    /// Request: settings of both levels, seed and refinement.
    ///
    /// # Errors
    /// For unknown settings and values out of their limits.
    pub fn request(&self) -> Result<Request> {
        let preset = self.preset();
        let lower = self.overrides.lower.settings(&self.file, if preset.is_some() { Legs::Free } else { Legs::Limited })?;
        let refine = self.refine_settings()?;
        let refines = self.overrides.refine || self.file.refine.unwrap_or(false);
        // Checked now: after a search the gait would be lost.
        if refines {
            refine.validate_for(&lower.transcription)?
        } else {
            refine.validate()?
        }
        let seed = self.overrides.seed.or(self.file.seed).unwrap_or(SEED);
        Ok(Request { lower, search: self.search_settings()?, seed, refines, refine })
    }

    fn preset(&self) -> Option<&str> {
        self.overrides.preset.as_deref().or(self.file.preset.as_deref())
    }

    /// Assignments to settings with a prefix, without it.
    fn sets<'a>(&'a self, prefix: &'a str) -> impl Iterator<Item = &'a str> {
        self.overrides.lower.set.iter().filter_map(move |set| set.strip_prefix(prefix))
    }

    fn refine_settings(&self) -> Result<RefineSettings> {
        let settings = merge(RefineSettings::default(), &self.file.settings_of("refine")?, "settings.refine")?;
        apply(settings, "refine.", self.sets("refine."))
    }

    /// Settings of the upper level: the preset, then keys and tables of the file, then options, then assignments.
    fn search_settings(&self) -> Result<SearchSettings> {
        let preset = self.preset().map_or_else(|| Ok(SearchSettings::default()), SearchSettings::preset)?;
        let of_file = SearchOptions {
            gait: self.file.gait.clone(),
            population: self.file.population,
            generations: self.file.generations,
            objective: self.file.objective.clone(),
            time: self.file.time,
            first: self.file.first.unwrap_or(false),
            alternatives: self.file.alternatives,
            random: self.file.random.unwrap_or(false),
        };
        let settings = merge(of_file.over(preset)?, &self.file.settings_of("search")?, "settings.search")?;
        let settings = apply(self.overrides.search.over(settings)?, "search.", self.sets("search."))?;
        settings.validate()?;
        Ok(settings)
    }
}

#[cfg(test)]
mod tests {
    use super::super::scenario_file::table_of;
    use super::*;
    use crate::gait::family::GaitFamily;
    use crate::search::Gaits;
    use crate::search::cem::{Objective, Sampler};
    use crate::settings::{SolverSettings, Transcription, TranscriptionSettings};

    /// Overrides over a file that has every setting in its tables, as a run writes it.
    fn over(overrides: Overrides) -> Setup {
        let tables = [
            ("search", table_of(&SearchSettings::default())),
            ("transcription", table_of(&TranscriptionSettings::default())),
            ("solver", table_of(&SolverSettings::default())),
        ];
        let file = ScenarioFile {
            scenario: Some("s1".into()),
            target: Some(3),
            goal: Some(Goal::at(1., 0.)),
            waypoints: vec![Goal::at(0.5, 0.)],
            time: Some(50.),
            gait: Some("walk".into()),
            population: Some(5),
            settings: tables.into_iter().map(|(name, table)| (name.into(), toml::Value::Table(table.unwrap()))).collect(),
            ..ScenarioFile::default()
        };
        Setup::new(file, overrides).unwrap()
    }

    #[test]
    fn options_override_the_tables_of_a_file_and_these_override_its_keys() {
        let request = over(Overrides::default()).request().unwrap();
        assert_eq!((&request.search.gaits, request.search.population, request.lower.solver), (&Gaits::All, 16, SolverSettings::default()));

        let search = SearchOptions {
            gait: Some("trot".into()),
            population: Some(64),
            generations: Some(9),
            objective: Some("time".into()),
            time: Some(7.),
            first: true,
            alternatives: Some(3),
            random: true,
        };
        let lower = LowerOptions {
            transcription: Some(Transcription::Towr),
            smooth: true,
            precision: Some(Precision::F64),
            set: vec!["search.elites=2".into()],
        };
        let request = over(Overrides { search, lower, ..Overrides::default() }).request().unwrap();
        let search = &request.search;
        assert_eq!(search.gaits, Gaits::Families(vec![GaitFamily::Trot]));
        assert_eq!((search.population, search.elites, search.generations, search.alternatives), (64, 2, 9, 3));
        assert_eq!((search.objective, search.first, search.seconds), (Objective::Time, true, Some(7.)));
        assert_eq!(search.free.sampler, Sampler::Random);
        assert_eq!(request.lower.transcription.rows, Transcription::Towr);
        assert_eq!((request.lower.solver.smooth.iterations, request.lower.precision), (20, Precision::F64));

        let search = SearchOptions { population: Some(8), ..SearchOptions::default() };
        let request = over(Overrides { preset: Some("experiment3".into()), search, ..Overrides::default() }).request().unwrap();
        assert_eq!((request.search.gaits, request.search.population, request.search.elites), (Gaits::Free, 8, 4));
        assert_eq!((request.search.objective, request.lower.transcription.legs), (Objective::FewestStances, Legs::Free));
    }

    #[test]
    fn another_goal_or_scenario_drops_those_of_the_file() {
        let mission = |overrides: Overrides| {
            let mission = over(overrides).mission().unwrap();
            let Provenance { scenario, target } = mission.provenance;
            ((scenario, target), mission.waypoints.len(), mission.task.goal.position[0], mission.task.robot.name.clone())
        };
        let scenario = |name: &str| Overrides { scenario: Some(name.into()), ..Overrides::default() };
        let s1 = |target: usize| Scenario::named("s1").unwrap().task(target).unwrap().goal.position[0];
        assert_eq!(mission(Overrides::default()), ((Some("s1"), None), 1, 1., "anymal".into()));
        let goal = Overrides { goal: Some(Goal::at(2., 0.)), ..Overrides::default() };
        assert_eq!(mission(goal), ((Some("s1"), None), 0, 2., "anymal".into()));
        let target = Overrides { target: Some(4), ..Overrides::default() };
        assert_eq!(mission(target), ((Some("s1"), Some(4)), 0, s1(4), "anymal".into()));
        assert_eq!(mission(scenario("s1")), ((Some("s1"), None), 1, 1., "anymal".into()));
        let [x, _] = Scenario::goal(TARGET).unwrap();
        assert_eq!(mission(scenario("biped")), ((Some("biped"), Some(TARGET)), 0, x, "biped".into()));
    }
}
