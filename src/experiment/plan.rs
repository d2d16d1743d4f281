//! Runs of each experiment.

use crate::error::{Error, Result};
use crate::reference::ipopt::{self, Options};
use crate::scenario::{Scenario, TARGETS};
use crate::search::cem::{CemSettings, Objective, Sampler};
use crate::settings::Transcription;
use crate::task::Task;
use serde::{Deserialize, Serialize};

/// Valid experiment numbers.
pub const EXPERIMENTS: std::ops::RangeInclusive<u8> = 1..=3;
/// Replicates of experiment 1 (one per target) and of experiment 2.
const REPLICATES: u64 = 20;
/// Replicates of experiment 3.
const OBJECTIVE_REPLICATES: u64 = 10;
/// Population of the first part of experiment 3, with and without the heuristic.
const POPULATION: usize = 64;
/// Larger populations of experiment 3, with the heuristic. They show the quality and the cost of larger searches.
const POPULATIONS: [usize; 3] = [256, 1024, 4096];
/// Larger populations of a quick run of experiment 3.
const QUICK_POPULATIONS: [usize; 2] = [256, 1024];
/// Generations of experiment 3, and of its quick run.
const GENERATIONS: [usize; 2] = [50, 10];
/// Scenario of experiment 3. The robot turns during the motion.
const OBJECTIVE_SCENARIO: &str = "s2";
/// Goal of experiment 3 (x, y), m.
const OBJECTIVE_GOAL: [f64; 2] = [3., 3.];

/// Compared methods.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// This program: CEM-MD over this solver, `momentum` rows.
    Cregopt,
    /// CEM-MD over this solver, TOWR's rows.
    CregoptTowr,
    /// CEM-MD over Ipopt on TOWR's program: the paper's method.
    Ipopt,
    /// TOWR with durations as variables.
    Towr,
    /// Contact-implicit optimisation.
    ContactImplicit,
    /// Random search over this solver, `momentum` rows.
    Random,
    /// Random search over this solver, TOWR's rows.
    RandomTowr,
    /// Random search over Ipopt.
    RandomIpopt,
    /// [`Method::Cregopt`] without the stall rule.
    NoStall,
    /// [`Method::CregoptTowr`] without the stall rule.
    NoStallTowr,
}

impl Method {
    /// Every method, in the order of tables.
    pub const ALL: [Method; 10] = [
        Method::Cregopt,
        Method::CregoptTowr,
        Method::Ipopt,
        Method::Towr,
        Method::ContactImplicit,
        Method::Random,
        Method::RandomTowr,
        Method::RandomIpopt,
        Method::NoStall,
        Method::NoStallTowr,
    ];

    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Method::Cregopt => "cregopt",
            Method::CregoptTowr => "cregopt-towr",
            Method::Ipopt => "ipopt",
            Method::Random => "random",
            Method::RandomTowr => "random-towr",
            Method::RandomIpopt => "random-ipopt",
            Method::NoStall => "no-stall",
            Method::NoStallTowr => "no-stall-towr",
            Method::Towr => "towr",
            Method::ContactImplicit => "contact-implicit",
        }
    }

    /// Description, for tables.
    pub fn about(self) -> &'static str {
        match self {
            Method::Cregopt => "CEM-MD, this solver, `momentum` rows",
            Method::CregoptTowr => "CEM-MD, this solver, TOWR's rows",
            Method::Ipopt => "CEM-MD, Ipopt, TOWR's rows (the paper)",
            Method::Random => "random, this solver, `momentum` rows",
            Method::RandomTowr => "random, this solver, TOWR's rows",
            Method::RandomIpopt => "random, Ipopt, TOWR's rows",
            Method::NoStall => "CEM-MD, this solver without stall rule, `momentum` rows",
            Method::NoStallTowr => "CEM-MD, this solver without stall rule, TOWR's rows",
            Method::Towr => "TOWR, durations optimised, Ipopt",
            Method::ContactImplicit => "contact-implicit, Ipopt",
        }
    }

    /// Method with a name.
    ///
    /// # Errors
    /// [`Error::Unknown`] lists all methods.
    pub fn named(name: &str) -> Result<Method> {
        let known = || Method::ALL.map(Method::name).join(", ");
        Method::ALL.into_iter().find(|m| m.name() == name).ok_or_else(|| Error::Unknown {
            what: "method",
            name: name.into(),
            known: known(),
        })
    }

    /// True if the method needs Ipopt.
    pub fn needs_ipopt(self) -> bool {
        matches!(self, Method::Ipopt | Method::RandomIpopt | Method::Towr | Method::ContactImplicit)
    }

    /// True if the method searches over schedules. The others solve one program.
    pub fn searches(self) -> bool {
        !matches!(self, Method::Towr | Method::ContactImplicit)
    }

    /// Sampler of the schedules.
    pub fn sampler(self) -> Sampler {
        match self {
            Method::Random | Method::RandomTowr | Method::RandomIpopt => Sampler::Random,
            _ => Sampler::Cem,
        }
    }

    /// Transcription whose rows its motions satisfy.
    pub fn rows(self) -> Transcription {
        match self {
            Method::Cregopt | Method::Random | Method::NoStall => Transcription::Momentum,
            _ => Transcription::Towr,
        }
    }

    /// True if this solver applies the stall rule, which ends candidates that make no progress.
    pub fn stall_rule(self) -> bool {
        !matches!(self, Method::NoStall | Method::NoStallTowr)
    }
}

impl std::fmt::Display for Method {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// Specification of one run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Number of the experiment, 1 to 3.
    pub experiment: u8,
    /// Scenario.
    pub scenario: String,
    /// Target number in the scenario; `None` if the experiment defines its own goal.
    pub target: Option<usize>,
    /// Number of the replicate, from 1.
    pub replicate: u64,
    /// Seed of the search. All methods of a replicate share it and therefore draw the same first generation.
    pub seed: u64,
    /// Method.
    pub method: Method,
    /// True if stance counts are drawn in triplets.
    pub heuristic: bool,
    /// Objective.
    pub objective: Objective,
    /// Candidates per generation.
    pub population: usize,
    /// Largest number of generations.
    pub generations: usize,
}

impl Case {
    /// Task of the run.
    ///
    /// # Errors
    /// See [`Scenario::named`] and [`Scenario::task`].
    pub fn task(&self) -> Result<Task> {
        let scenario = Scenario::named(&self.scenario)?;
        self.target.map_or_else(|| scenario.task_to(OBJECTIVE_GOAL), |target| scenario.task(target))
    }

    /// Settings of the search.
    ///
    /// # Errors
    /// See [`CemSettings::preset`].
    pub fn search(&self) -> Result<CemSettings> {
        let preset = CemSettings::preset(&format!("experiment{}", self.experiment))?;
        Ok(CemSettings {
            generations: self.generations,
            heuristic: self.heuristic,
            objective: self.objective,
            whole_generation: true,
            // All generations are run, so that medians per generation are over the same runs.
            converged_std: 0.,
            sampler: self.method.sampler(),
            ..preset.with_population(self.population)
        })
    }

    /// Computing budget, for results.
    pub fn budget(&self) -> String {
        let ipopt = |o: Options| format!("{} iterations, {} s CPU", o.max_iterations, o.max_seconds);
        let search = format!("{} generations of {}", self.generations, self.population);
        match self.method {
            Method::Ipopt | Method::RandomIpopt => format!("{search}; per candidate: {}", ipopt(Options::LOWER_LEVEL)),
            Method::Towr => ipopt(Options::BASELINE),
            Method::ContactImplicit => format!("{} per solve, all solves together within that time", ipopt(Options::BASELINE)),
            _ => search,
        }
    }

    /// Table line of the run. The runs of a group differ only in target, replicate and seed.
    pub fn group(&self) -> Group {
        Group {
            scenario: self.scenario.clone(),
            objective: self.objective,
            population: self.population,
            generations: self.generations,
            heuristic: self.heuristic,
            method: self.method,
        }
    }
}

/// Common properties of the runs in one line of a table.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// Scenario.
    pub scenario: String,
    /// Objective.
    pub objective: Objective,
    /// Candidates per generation.
    pub population: usize,
    /// Largest number of generations.
    pub generations: usize,
    /// True if stance counts are drawn in triplets.
    pub heuristic: bool,
    /// Method.
    pub method: Method,
}

/// Extent of an experiment.
#[derive(Debug, Clone)]
pub struct Extent {
    /// Restricts it to a representative part that takes minutes.
    pub quick: bool,
    /// Seed of the first replicate. Later replicates use consecutive seeds.
    pub seed: u64,
    /// Methods to run; empty for all that the experiment compares.
    pub methods: Vec<Method>,
    /// Largest number of replicates (targets in experiment 1).
    pub replicates: Option<u64>,
    /// Generations of experiment 3.
    pub generations: Option<usize>,
    /// Populations of experiment 3; empty for all.
    pub populations: Vec<usize>,
}

impl Extent {
    /// Replicates to run: `REPLICATES` of all, or those of a quick run, spread evenly.
    fn replicates(&self, all: u64, quick: u64) -> Vec<u64> {
        let count = self.replicates.unwrap_or(if self.quick { quick } else { all }).clamp(1, all);
        // 1, all, and evenly spaced values between: the targets lie on an arc.
        (0..count).map(|i| if count == 1 { all.div_ceil(2) } else { 1 + (i * (all - 1) + (count - 1) / 2) / (count - 1) }).collect()
    }

    fn methods(&self, compared: &[Method]) -> Vec<Method> {
        let wanted = |m: &&Method| self.methods.is_empty() || self.methods.contains(m);
        let possible = |m: &&Method| !m.needs_ipopt() || ipopt::VERSION.is_some();
        compared.iter().filter(wanted).filter(possible).copied().collect()
    }
}

/// Runs of an experiment, ordered by replicate, so that every method has equally many when the experiment is stopped. Methods that this
/// build lacks are left out.
///
/// # Errors
/// [`Error::Invalid`] for an unknown experiment.
pub fn plan(experiment: u8, extent: &Extent) -> Result<Vec<Case>> {
    let case = |scenario: &str, target, replicate: u64, method, heuristic| Case {
        experiment,
        scenario: scenario.into(),
        target,
        replicate,
        seed: extent.seed.wrapping_add(replicate - 1),
        method,
        heuristic,
        objective: Objective::Feasibility,
        population: 16,
        generations: 20,
    };
    let mut cases = Vec::new();
    match experiment {
        1 => {
            for target in extent.replicates(TARGETS as u64, 5) {
                for scenario in ["s1", "s2", "s3"] {
                    for method in extent.methods(&Method::ALL) {
                        cases.push(case(scenario, Some(target as usize), target, method, true));
                    }
                }
            }
        }
        2 => {
            for replicate in extent.replicates(REPLICATES, 5) {
                for scenario in ["biped", "s1", "hex"] {
                    for method in extent.methods(&[
                        Method::Cregopt,
                        Method::CregoptTowr,
                        Method::Ipopt,
                        Method::Random,
                        Method::RandomTowr,
                        Method::RandomIpopt,
                    ]) {
                        for heuristic in [true, false] {
                            cases.push(case(scenario, Some(TARGETS / 2), replicate, method, heuristic));
                        }
                    }
                }
            }
        }
        3 => {
            let larger = if extent.quick { &QUICK_POPULATIONS[..] } else { &POPULATIONS[..] };
            let all: Vec<usize> = std::iter::once(POPULATION).chain(larger.iter().copied()).collect();
            let populations = if extent.populations.is_empty() { &all } else { &extent.populations };
            let generations = extent.generations.unwrap_or(GENERATIONS[usize::from(extent.quick)]);
            for replicate in extent.replicates(OBJECTIVE_REPLICATES, 2) {
                for &population in populations {
                    for objective in [Objective::FewestStances, Objective::LeastForce] {
                        for method in extent.methods(&[Method::Cregopt]) {
                            for heuristic in if population == POPULATION { &[true, false][..] } else { &[true][..] } {
                                let case = case(OBJECTIVE_SCENARIO, None, replicate, method, *heuristic);
                                cases.push(Case { objective, population, generations, ..case });
                            }
                        }
                    }
                }
            }
        }
        _ => return Err(Error::invalid("experiment", experiment, "1, 2 or 3")),
    }
    Ok(cases)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn extent(quick: bool) -> Extent {
        Extent { quick, seed: 1, methods: vec![], replicates: None, generations: None, populations: vec![] }
    }

    #[test]
    fn a_quick_plan_is_part_of_the_whole() {
        for experiment in EXPERIMENTS {
            let (quick, whole) = (plan(experiment, &extent(true)).unwrap(), plan(experiment, &extent(false)).unwrap());
            assert!(!quick.is_empty() && quick.len() < whole.len());
            // In experiment 3 they differ only in the number of generations.
            let same = |a: &Case, b: &Case| Case { generations: b.generations, ..a.clone() } == *b;
            assert!(quick.iter().all(|q| whole.iter().any(|w| same(q, w))), "experiment {experiment}");
        }
        assert!(plan(4, &extent(true)).unwrap_err().to_string().contains("1, 2 or 3"));
    }

    #[test]
    fn every_case_has_a_task_and_valid_settings() {
        for experiment in EXPERIMENTS {
            for case in plan(experiment, &extent(false)).unwrap() {
                case.task().unwrap();
                case.search().unwrap().validate().unwrap();
            }
        }
    }

    #[test]
    fn methods_of_a_replicate_share_its_seed_and_targets_do_not() {
        let cases = plan(1, &extent(false)).unwrap();
        let seeds: std::collections::BTreeSet<u64> = cases.iter().map(|c| c.seed).collect();
        assert_eq!(seeds.len(), TARGETS);
        assert!(cases.iter().all(|c| c.target == Some(c.seed as usize)));
    }
}
