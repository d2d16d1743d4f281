//! Settings of the search: gaits, objective, budget and distributions.

use super::cem::{CemSettings, Objective, PeriodicSettings, PerturbSettings, Stopping};
use crate::error::{Error, Result, check_range};
use crate::gait::Schedule;
use crate::gait::cost::CostWeights;
use crate::gait::family::GaitFamily;
#[cfg(doc)]
use crate::gait::family::default_families;
use crate::robot::Robot;
use crate::search::evaluate::LowerSettings;
use serde::{Deserialize, Serialize};

/// Gaits that are searched.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Gaits {
    /// Periodic gaits of all families that are possible for the robot, except the pace, see [`default_families`].
    #[default]
    All,
    /// Periodic gaits of these families.
    Families(Vec<GaitFamily>),
    /// Any gait, from the distribution of the paper \[1\].
    Free,
    /// The neighbourhood of a schedule.
    Around(Schedule),
}

/// Settings of a search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct SearchSettings {
    /// Gaits that are searched.
    pub gaits: Gaits,
    /// Objective.
    pub objective: Objective,
    /// Weights of the cost of transport.
    pub cost: CostWeights,
    /// Candidates per generation. Too small: the elites say little about the distribution; too large: few generations in the same time.
    /// From 64 to 256 evaluations the cost falls by 2 to 3 %.
    pub population: usize,
    /// Elites per generation. Too small: premature convergence; close to `population`: no selection.
    pub elites: usize,
    /// Largest number of generations after the typical gaits of the families. Too small: costly gaits; too large: only time is lost.
    pub generations: usize,
    /// Largest number of additional generations, which run while no certified gait exists or none within the joint limits of the robot.
    /// With 12 of them 30 of 32 searches for ANYmal C and HyQ ended within the limits, without them 21.
    pub further_generations: usize,
    /// Largest number of levels of the ground that are tried if no gait is found on uneven ground: a gait on ground of half the relief is
    /// changed while the ground rises; 0: none. Too small: the ground of the task is not reached; too large: only time is lost.
    pub relief_levels: usize,
    /// Largest number of generations in the neighbourhood of the best gait. Too small: phase times are not tuned; too large: only time is
    /// lost.
    pub perturbed_generations: usize,
    /// Iterations that minimise the cost of each candidate, unless `solver.optimise.iterations` is set; 0: each candidate keeps the first
    /// motion that satisfies its rows. Too small: gaits are compared by chance; too large: only time is lost. With 0, 4, 6 and 12 ANYmal's
    /// trot of 2 m costs 2.217, 1.967, 1.964 and 1.957, and the search takes 0.09, 0.22, 0.27 and 0.39 s. Only for the objectives
    /// `transport` and `effort`, and not if the first gait ends the search.
    pub optimise_iterations: usize,
    /// `transcription.reach_margin` of motions whose cost is minimised, in base heights. An optimal motion lies on its limits, and a
    /// stretched leg cannot correct an error. Too small: gaits that a robot cannot follow; too large: costly gaits. Without it Spot's trot
    /// of 3 m fell in MuJoCo in two of three plays.
    pub reach_margin: f64,
    /// Number of gaits whose durations are optimised at the end: the best ones of different families. After a third of the steps half of
    /// them go on, and the best one is also tried with 0.7 to 1.4 times as many strides. Too small: another family may be better with its
    /// best durations; too large: only time is lost.
    pub timed_gaits: usize,
    /// Largest number of steps along the gradient of the cost with respect to the durations, for each of these gaits; 0: durations and
    /// numbers of strides stay as they were drawn. While another number of strides is better or the cost falls, more steps follow. Too small:
    /// durations are not the best; too large: only time is lost. With 21 and 30 steps a hexapod's 6 m cost 1.287 and 1.274 with its first
    /// number of strides, and 30 take 16 % more time. Only for the objective `transport`.
    pub duration_steps: usize,
    /// Time limit, s; `None`: only the numbers of generations limit the search. After this time no generation begins, and a generation
    /// that is still running does not count, except the first.
    pub seconds: Option<f64>,
    /// True if the search ends with the first certified gait.
    pub first: bool,
    /// Number of gaits to return: the best one, then the best ones of other families.
    pub alternatives: usize,
    /// Distribution over periodic gaits.
    pub periodic: PeriodicSettings,
    /// Distribution over the neighbourhood of a gait.
    pub perturb: PerturbSettings,
    /// The paper's distribution and loop, for [`Gaits::Free`].
    pub free: CemSettings,
}

impl Default for SearchSettings {
    fn default() -> Self {
        SearchSettings {
            gaits: Gaits::All,
            objective: Objective::Transport,
            cost: CostWeights::default(),
            population: 16,
            elites: 4,
            generations: 3,
            further_generations: 12,
            relief_levels: 60,
            perturbed_generations: 1,
            optimise_iterations: 6,
            reach_margin: 0.03,
            timed_gaits: 4,
            duration_steps: 21,
            seconds: None,
            first: false,
            alternatives: 1,
            periodic: PeriodicSettings::default(),
            perturb: PerturbSettings::default(),
            free: CemSettings::default(),
        }
    }
}

impl SearchSettings {
    /// Returns the preset with this name: the search of the paper, i.e. its distribution and its loop only.
    ///
    /// # Errors
    /// [`Error::Unknown`] lists [`super::cem::PRESETS`].
    pub fn preset(name: &str) -> Result<SearchSettings> {
        let free = CemSettings::preset(name)?;
        Ok(SearchSettings {
            gaits: Gaits::Free,
            objective: free.objective,
            population: free.population,
            elites: free.elites,
            generations: free.generations,
            further_generations: 0,
            relief_levels: 0,
            perturbed_generations: 0,
            optimise_iterations: 0,
            duration_steps: 0,
            first: free.stopping == Stopping::FirstFeasible,
            free,
            ..SearchSettings::default()
        })
    }

    /// Changes the population; the elites keep their share of it.
    pub fn with_population(self, population: usize) -> SearchSettings {
        // A product that overflows is outside the limits anyway.
        let elites = (population.saturating_mul(self.elites) / self.population.max(1)).max(1);
        SearchSettings { population, elites, free: self.free.with_population(population), ..self }
    }

    /// Changes the objective. Only [`Objective::Feasibility`] ends the search with the first gait.
    pub fn seeking(self, objective: Objective) -> SearchSettings {
        SearchSettings { objective, first: objective == Objective::Feasibility, ..self }
    }

    /// True if gaits within the joint limits of the robot are preferred. False if the first gait ends the search or the objective does not
    /// include the joint cost.
    pub fn prefers_joint_limits(&self) -> bool {
        !self.first && self.cost.joint_excess > 0. && self.objective.counts_joints()
    }

    /// Makes the lower level minimise the cost of every candidate, unless the objective is no cost or the first gait ends the search.
    pub(super) fn minimise(&self, robot: &Robot, lower: &mut LowerSettings) {
        let optimise = &mut lower.solver.optimise;
        let cost = match self.objective {
            Objective::Transport if !self.first => self.cost,
            Objective::Effort if !self.first => CostWeights { leg_work: 0., swing_work: 0., ..self.cost },
            _ => {
                optimise.iterations = 0;
                return;
            }
        };
        optimise.cost = cost;
        if optimise.iterations == 0 {
            optimise.iterations = self.optimise_iterations;
        }
        if optimise.iterations > 0 {
            let margin = &mut lower.transcription.reach_margin;
            *margin = margin.max(self.reach_margin * robot.base_height);
        }
    }

    /// True if durations are optimised at the end.
    pub(super) fn optimises_durations(&self) -> bool {
        self.duration_steps > 0 && self.objective == Objective::Transport && !self.first
    }

    /// Settings of the cross-entropy loop with the population and objective of this search.
    pub(super) fn cem(&self, generations: usize) -> CemSettings {
        let (stopping, population) = (if self.first { Stopping::FirstFeasible } else { Stopping::Convergence }, self.population);
        CemSettings { population, elites: self.elites, generations, objective: self.objective, stopping, ..self.free.clone() }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first field that is outside its limits.
    pub fn validate(&self) -> Result<()> {
        let count = |place: &str, value: usize, low: usize, high: usize| {
            let limit = format!("an integer from {low} to {high}");
            if (low..=high).contains(&value) { Ok(()) } else { Err(Error::invalid(place, value, limit)) }
        };
        if self.gaits == Gaits::Families(Vec::new()) {
            return Err(Error::invalid("search.gaits", "no family", "at least one"));
        }
        count("search.population", self.population, 1, 65_536)?;
        count("search.elites", self.elites, 1, self.population)?;
        count("search.generations", self.generations, 0, 100_000)?;
        count("search.further_generations", self.further_generations, 0, 100_000)?;
        count("search.relief_levels", self.relief_levels, 0, 10_000)?;
        count("search.perturbed_generations", self.perturbed_generations, 0, 100_000)?;
        count("search.optimise_iterations", self.optimise_iterations, 0, 10_000)?;
        check_range("search.reach_margin", self.reach_margin, 0., 1.)?;
        count("search.timed_gaits", self.timed_gaits, 1, 100)?;
        count("search.duration_steps", self.duration_steps, 0, 100_000)?;
        count("search.alternatives", self.alternatives, 1, 100)?;
        if let Some(seconds) = self.seconds {
            check_range("search.seconds", seconds, 0., 1e7)?;
        }
        self.cost.validate()?;
        self.periodic.validate()?;
        self.perturb.validate()?;
        self.free.validate()
    }
}
