//! What is searched for, how long, and where candidates come from.

use super::cem::{CemSettings, Objective, PeriodicSettings, PerturbSettings, Stopping};
use crate::error::{Error, Result, check_range};
use crate::gait::Schedule;
use crate::gait::cost::CostWeights;
use crate::gait::family::GaitFamily;
use serde::{Deserialize, Serialize};

/// Which gaits are looked at.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Gaits {
    /// Periodic gaits of all families that the robot can have.
    #[default]
    All,
    /// Periodic gaits of these families.
    Families(Vec<GaitFamily>),
    /// Any gait: the paper's distribution \[1\].
    Free,
    /// The neighbourhood of a schedule.
    Around(Schedule),
}

/// Settings of a search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct SearchSettings {
    /// Which gaits.
    pub gaits: Gaits,
    /// What is sought.
    pub objective: Objective,
    /// Weights of the cost of transport.
    pub cost: CostWeights,
    /// Candidates a generation.
    pub population: usize,
    /// Elites of a generation.
    pub elites: usize,
    /// Most generations over periodic gaits, behind the families' typical ones.
    pub generations: usize,
    /// Most generations behind those while there is no gait, or none within the limits of the robot's joints.
    pub further_generations: usize,
    /// Most generations around the best gait so far.
    pub perturbed_generations: usize,
    /// Time after which no generation begins and the one that runs does not count any more (the first does), s; none: the generations decide alone.
    pub seconds: Option<f64>,
    /// Whether the first certified gait is enough.
    pub first: bool,
    /// How many gaits are returned: the best, and the best of other families.
    pub alternatives: usize,
    /// How periodic gaits are drawn.
    pub periodic: PeriodicSettings,
    /// How the neighbourhood of a gait is drawn.
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
            perturbed_generations: 1,
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
    /// A preset by name: the paper's search, which is the paper's distribution and loop and nothing else.
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
            perturbed_generations: 0,
            first: free.stopping == Stopping::FirstFeasible,
            free,
            ..SearchSettings::default()
        })
    }

    /// With another population; elites keep their share.
    pub fn with_population(self, population: usize) -> SearchSettings {
        // A product that overflows is out of the limits anyway.
        let elites = (population.saturating_mul(self.elites) / self.population.max(1)).max(1);
        SearchSettings { population, elites, free: self.free.with_population(population), ..self }
    }

    /// With another objective. Only feasibility ends with the first gait.
    pub fn seeking(self, objective: Objective) -> SearchSettings {
        SearchSettings { objective, first: objective == Objective::Feasibility, ..self }
    }

    /// Whether gaits within the limits of the robot's joints are preferred to others: the first gait is returned as it is, and some objectives
    /// leave joints out.
    pub fn prefers_joint_limits(&self) -> bool {
        !self.first && self.cost.joint_excess > 0. && self.objective.counts_joints()
    }

    /// The paper's loop over a distribution, with this search's population and generations.
    pub(super) fn cem(&self, generations: usize) -> CemSettings {
        let (stopping, population) = (if self.first { Stopping::FirstFeasible } else { Stopping::Convergence }, self.population);
        CemSettings { population, elites: self.elites, generations, objective: self.objective, stopping, ..self.free.clone() }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first field that is out of its limits.
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
        count("search.perturbed_generations", self.perturbed_generations, 0, 100_000)?;
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
