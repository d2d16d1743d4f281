//! Settings of the cross-entropy loop and of the distribution of \[1\], with defaults and limits.

use super::{Evaluation, Objective, heuristic, stances};
use crate::error::{Error, Result, check_range};
use crate::gait::Schedule;
use crate::gait::schedule::{MAX_HORIZON, MIN_PHASE};
use serde::{Deserialize, Serialize};

/// Presets by name with their purpose. Their values are those of the section of \[1\] with the same name.
pub const PRESETS: [(&str, &str); 3] = [
    ("experiment1", "find any feasible gait, 16 candidates per generation"),
    ("experiment2", "the settings of experiment1, to compare robots"),
    ("experiment3", "find the gait with the fewest stances, 64 candidates per generation, 50 generations"),
];

/// Condition that ends a search before its last generation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Stopping {
    /// End with the first generation that has a feasible candidate.
    FirstFeasible,
    /// End when the distribution has converged: see [`super::Distribution::converged`].
    Convergence,
}

/// Source of the candidates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Sampler {
    /// Distribution that is fitted to the elites after each generation.
    Cem,
    /// Initial distribution throughout: plain random search, for comparisons.
    Random,
}

/// Settings of the cross-entropy loop and of the distribution of \[1\], with its symbols.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct CemSettings {
    /// Candidates per generation, `N`. Too small: the elites say little about the distribution; too large: few generations in the same
    /// time.
    pub population: usize,
    /// Number of elites, `M`. Too small: premature convergence; close to `population`: no selection.
    pub elites: usize,
    /// Largest number of generations, `K`. Too small: the search ends before it converges; too large: only time is lost.
    pub generations: usize,
    /// Smallest number of stance phases of a foot. The heuristic draws at least two more.
    pub min_stances: usize,
    /// Largest number of stance phases of a foot. The heuristic draws at most `min_stances + 8` and requires at least that here.
    pub max_stances: usize,
    /// True if the feet pick their stance counts from a common triplet: see [`heuristic`].
    pub heuristic: bool,
    /// Limits of the log durations (durations in s). Samples are clamped to them.
    pub log_duration: [f64; 2],
    /// Mean of every log duration in the first generation.
    pub initial_mean: f64,
    /// Standard deviation of every log duration in the first generation.
    pub initial_std: f64,
    /// Smallest standard deviation of a log duration. Too small: the search freezes; too large: it never converges.
    pub min_std: f64,
    /// Added to the share of each category among the elites before normalising. 0: a category can be lost for good; too large: no learning.
    pub floor: f64,
    /// Penalty `alpha` per violated constraint, in the unit of the objective. Too small: infeasible gaits win.
    pub penalty: f64,
    /// Objective among feasible gaits.
    pub objective: Objective,
    /// Condition for an early end.
    pub stopping: Stopping,
    /// True if a generation is evaluated beyond its first feasible candidate, so that the search returns the best feasible candidate
    /// instead of the one with the lowest index. Only with [`Stopping::FirstFeasible`].
    pub whole_generation: bool,
    /// The distribution counts as converged if the largest standard deviation of the used log durations is below this. 0: never.
    pub converged_std: f64,
    /// Source of the candidates.
    pub sampler: Sampler,
}

impl Default for CemSettings {
    /// Returns the preset `experiment1`.
    fn default() -> Self {
        CemSettings {
            population: 16,
            elites: 12,
            generations: 20,
            min_stances: 5,
            max_stances: 13,
            heuristic: true,
            log_duration: [-2.5, -1.],
            initial_mean: -1.75,
            initial_std: 1.,
            min_std: 1e-3,
            floor: 0.05,
            penalty: 100.,
            objective: Objective::Feasibility,
            stopping: Stopping::FirstFeasible,
            whole_generation: false,
            converged_std: 5e-3,
            sampler: Sampler::Cem,
        }
    }
}

impl CemSettings {
    /// Returns the preset with this name.
    ///
    /// # Errors
    /// [`Error::Unknown`] lists [`PRESETS`].
    pub fn preset(name: &str) -> Result<CemSettings> {
        match name {
            "experiment1" | "experiment2" => Ok(CemSettings::default()),
            "experiment3" => Ok(CemSettings {
                population: 64,
                elites: 32,
                generations: 50,
                min_stances: 3,
                max_stances: 11,
                penalty: 1000.,
                objective: Objective::FewestStances,
                stopping: Stopping::Convergence,
                ..CemSettings::default()
            }),
            _ => Err(Error::Unknown { what: "preset", name: name.into(), known: PRESETS.map(|(name, _)| name).join(", ") }),
        }
    }

    /// Changes the population; the elites keep their share of it.
    pub fn with_population(self, population: usize) -> CemSettings {
        // A product that overflows is outside the limits anyway.
        let elites = (population.saturating_mul(self.elites) / self.population.max(1)).max(1);
        CemSettings { population, elites, ..self }
    }

    /// Objective `J` of an evaluated schedule.
    pub(in crate::search) fn objective_of(&self, schedule: &Schedule, evaluation: &Evaluation) -> f64 {
        self.objective.value(&stances(schedule), evaluation, self.penalty)
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first field that is outside its limits.
    pub fn validate(&self) -> Result<()> {
        check_count("search.free.population", self.population, 1, 65_536)?;
        check_count("search.free.elites", self.elites, 1, self.population)?;
        check_count("search.free.generations", self.generations, 1, 100_000)?;
        check_count("search.free.min_stances", self.min_stances, 1, 501)?;
        check_count("search.free.max_stances", self.max_stances, self.min_stances, 501)?;
        if self.heuristic && self.max_stances < self.min_stances + heuristic::LARGEST {
            let limit =
                format!("at least min_stances + {} = {} with the heuristic", heuristic::LARGEST, self.min_stances + heuristic::LARGEST);
            return Err(Error::invalid("search.free.max_stances", self.max_stances, limit));
        }
        let [low, high] = self.log_duration;
        if !(low.is_finite() && high.is_finite() && low < high) {
            return Err(Error::invalid(
                "search.free.log_duration",
                format!("[{low}, {high}]"),
                "two finite numbers, the smaller one first",
            ));
        }
        if low.exp() < MIN_PHASE {
            return Err(Error::invalid("search.free.log_duration[0]", low, format!("at least ln {MIN_PHASE} s = {:.4}", MIN_PHASE.ln())));
        }
        // Ensures that every schedule that can be drawn is valid.
        let longest = MAX_HORIZON / self.phases() as f64;
        if high.exp() > longest {
            let limit = format!("at most {:.4}, so that {} phases last at most {MAX_HORIZON} s", longest.ln(), self.phases());
            return Err(Error::invalid("search.free.log_duration[1]", high, limit));
        }
        check_range("search.free.initial_mean", self.initial_mean, low, high)?;
        check_range("search.free.initial_std", self.initial_std, 1e-9, 100.)?;
        check_range("search.free.min_std", self.min_std, 1e-9, 100.)?;
        check_range("search.free.floor", self.floor, 0., 1.)?;
        check_range("search.free.penalty", self.penalty, 0., 1e12)?;
        check_range("search.free.converged_std", self.converged_std, 0., 100.)
    }

    /// Largest stance count that can be drawn.
    pub fn largest_stances(&self) -> usize {
        if self.heuristic { self.min_stances + heuristic::LARGEST } else { self.max_stances }
    }

    /// Number of phases of a foot with the largest stance count.
    pub fn phases(&self) -> usize {
        2 * self.largest_stances() - 1
    }
}

/// Checks that a count is inside `[low, high]`.
fn check_count(place: &str, value: usize, low: usize, high: usize) -> Result<()> {
    if (low..=high).contains(&value) { Ok(()) } else { Err(Error::invalid(place, value, format!("an integer from {low} to {high}"))) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_is_valid_and_survives_json() {
        for (name, line) in PRESETS {
            let settings = CemSettings::preset(name).unwrap();
            settings.validate().unwrap();
            assert!(!line.is_empty());
            assert_eq!(serde_json::from_str::<CemSettings>(&serde_json::to_string(&settings).unwrap()).unwrap(), settings);
        }
        assert_eq!(CemSettings { population: 0, ..CemSettings::default() }.with_population(4).population, 4);
        assert!(CemSettings::preset("experiment9").unwrap_err().to_string().contains("experiment1, experiment2, experiment3"));
    }

    #[test]
    fn bad_settings_name_the_field_the_value_and_the_limit() {
        let refused = |change: fn(&mut CemSettings)| {
            let mut settings = CemSettings::default();
            change(&mut settings);
            settings.validate().unwrap_err().to_string()
        };
        assert_eq!(refused(|s| s.population = 70_000), "search.free.population: 70000, but it must be an integer from 1 to 65536");
        assert_eq!(refused(|s| s.elites = 17), "search.free.elites: 17, but it must be an integer from 1 to 16");
        assert!(refused(|s| s.elites = 0).starts_with("search.free.elites"));
        assert!(refused(|s| s.generations = 0).starts_with("search.free.generations"));
        assert!(refused(|s| s.min_stances = 0).starts_with("search.free.min_stances"));
        assert!(refused(|s| s.min_stances = 14).starts_with("search.free.max_stances"));
        assert!(refused(|s| s.max_stances = 12).contains("= 13 with the heuristic"));
        assert!(refused(|s| s.log_duration = [f64::NAN, -1.]).contains("NaN"));
        assert!(refused(|s| s.log_duration = [-1., -1.]).contains("smaller one first"));
        assert!(refused(|s| s.log_duration[0] = -7.).contains("0.001 s"));
        assert!(refused(|s| s.log_duration[1] = 2.).contains("25 phases"));
        assert!(refused(|s| s.initial_mean = 0.).starts_with("search.free.initial_mean"));
        assert!(refused(|s| s.initial_std = 0.).starts_with("search.free.initial_std"));
        assert!(refused(|s| s.min_std = -1.).starts_with("search.free.min_std"));
        assert!(refused(|s| s.floor = 1.1).starts_with("search.free.floor"));
        assert!(refused(|s| s.penalty = -1.).starts_with("search.free.penalty"));
        assert!(refused(|s| s.converged_std = f64::NAN).starts_with("search.free.converged_std"));
    }
}
