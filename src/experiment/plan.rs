//! Which runs an experiment has.

use crate::error::{Error, Result};
use crate::reference::ipopt::{self, Options};
use crate::scenario::{Scenario, TARGETS};
use crate::search::cem::{CemSettings, Objective, Sampler};
use crate::settings::Transcription;
use crate::task::Task;
use serde::{Deserialize, Serialize};

/// Numbers of the experiments.
pub const EXPERIMENTS: std::ops::RangeInclusive<u8> = 1..=3;
/// Replicates of experiments 1 (one a target) and 2.
const REPLICATES: u64 = 20;
/// Of experiment 3.
const OBJECTIVE_REPLICATES: u64 = 10;
/// Population of its first part, with and without the heuristic.
const POPULATION: usize = 64;
/// Larger ones, with the heuristic: do they find better gaits, and what does it cost?
const POPULATIONS: [usize; 3] = [256, 1024, 4096];
/// Of a quick run.
const QUICK_POPULATIONS: [usize; 2] = [256, 1024];
/// Generations of experiment 3, and of a quick run.
const GENERATIONS: [usize; 2] = [50, 10];
/// Scenario and goal of experiment 3: turning round on the way.
const OBJECTIVE_SCENARIO: &str = "s2";
/// m.
const OBJECTIVE_GOAL: [f64; 2] = [3., 3.];

/// What is compared.
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
    /// Contact-implicit.
    ContactImplicit,
    /// Random search over this solver, `momentum` rows.
    Random,
    /// Random search over this solver, TOWR's rows.
    RandomTowr,
    /// Random search over Ipopt.
    RandomIpopt,
    /// As [`Method::Cregopt`], without the stall rule.
    NoStall,
    /// As [`Method::CregoptTowr`], without the stall rule.
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

    /// Name, as in files.
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

    /// What it is, for tables.
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

    /// A method by name.
    ///
    /// # Errors
    /// [`Error::Unknown`] lists all.
    pub fn named(name: &str) -> Result<Method> {
        let known = || Method::ALL.map(Method::name).join(", ");
        Method::ALL.into_iter().find(|m| m.name() == name).ok_or_else(|| Error::Unknown {
            what: "method",
            name: name.into(),
            known: known(),
        })
    }

    /// Whether it asks for Ipopt.
    pub fn needs_ipopt(self) -> bool {
        matches!(self, Method::Ipopt | Method::RandomIpopt | Method::Towr | Method::ContactImplicit)
    }

    /// Whether it searches over schedules; the others solve one program.
    pub fn searches(self) -> bool {
        !matches!(self, Method::Towr | Method::ContactImplicit)
    }

    /// How its schedules are drawn.
    pub fn sampler(self) -> Sampler {
        match self {
            Method::Random | Method::RandomTowr | Method::RandomIpopt => Sampler::Random,
            _ => Sampler::Cem,
        }
    }

    /// Rows that its motions satisfy.
    pub fn rows(self) -> Transcription {
        match self {
            Method::Cregopt | Method::Random | Method::NoStall => Transcription::Momentum,
            _ => Transcription::Towr,
        }
    }

    /// Whether this solver gives up candidates that do not get anywhere.
    pub fn stall_rule(self) -> bool {
        !matches!(self, Method::NoStall | Method::NoStallTowr)
    }
}

impl std::fmt::Display for Method {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// One run, before it is made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// 1 to 3.
    pub experiment: u8,
    /// Scenario.
    pub scenario: String,
    /// Its target; none where the goal is the experiment's own.
    pub target: Option<usize>,
    /// From 1.
    pub replicate: u64,
    /// Seed of the search: the same for all methods of a replicate, which then draw the same first generation.
    pub seed: u64,
    /// Who solves it.
    pub method: Method,
    /// Whether stance counts are drawn in triplets.
    pub heuristic: bool,
    /// What is sought.
    pub objective: Objective,
    /// Candidates a generation.
    pub population: usize,
    /// Most generations.
    pub generations: usize,
}

impl Case {
    /// The task.
    ///
    /// # Errors
    /// As [`Scenario::named`] and [`Scenario::task`].
    pub fn task(&self) -> Result<Task> {
        let scenario = Scenario::named(&self.scenario)?;
        self.target.map_or_else(|| scenario.task_to(OBJECTIVE_GOAL), |target| scenario.task(target))
    }

    /// Settings of the search.
    ///
    /// # Errors
    /// As [`CemSettings::preset`].
    pub fn search(&self) -> Result<CemSettings> {
        let preset = CemSettings::preset(&format!("experiment{}", self.experiment))?;
        Ok(CemSettings {
            generations: self.generations,
            heuristic: self.heuristic,
            objective: self.objective,
            whole_generation: true,
            // All generations, so that medians over generations are over the same runs.
            converged_std: 0.,
            sampler: self.method.sampler(),
            ..preset.with_population(self.population)
        })
    }

    /// What it may use, for results.
    pub fn budget(&self) -> String {
        let ipopt = |o: Options| format!("{} iterations, {} s CPU", o.max_iterations, o.max_seconds);
        let search = format!("{} generations of {}", self.generations, self.population);
        match self.method {
            Method::Ipopt | Method::RandomIpopt => format!("{search}; a candidate: {}", ipopt(Options::LOWER_LEVEL)),
            Method::Towr => ipopt(Options::BASELINE),
            Method::ContactImplicit => format!("{} a solve, all solves together in that time", ipopt(Options::BASELINE)),
            _ => search,
        }
    }

    /// Where it stands in tables: runs of a group differ in target, replicate and seed only.
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

/// What the runs of one line of a table have in common.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// Scenario.
    pub scenario: String,
    /// What is sought.
    pub objective: Objective,
    /// Candidates a generation.
    pub population: usize,
    /// Most generations.
    pub generations: usize,
    /// Whether stance counts are drawn in triplets.
    pub heuristic: bool,
    /// Who solves it.
    pub method: Method,
}

/// How much of an experiment.
#[derive(Debug, Clone)]
pub struct Extent {
    /// A representative part that takes minutes.
    pub quick: bool,
    /// Seed of the first replicate; the next ones follow.
    pub seed: u64,
    /// Only these methods; empty for all that the experiment compares.
    pub methods: Vec<Method>,
    /// Most replicates (targets, in experiment 1).
    pub replicates: Option<u64>,
    /// Generations of experiment 3.
    pub generations: Option<usize>,
    /// Populations of experiment 3; empty for all.
    pub populations: Vec<usize>,
}

impl Extent {
    /// `REPLICATES` of all, or those of a quick run, spread over them.
    fn replicates(&self, all: u64, quick: u64) -> Vec<u64> {
        let count = self.replicates.unwrap_or(if self.quick { quick } else { all }).clamp(1, all);
        // 1, all, and evenly between: targets lie on an arc.
        (0..count).map(|i| if count == 1 { all.div_ceil(2) } else { 1 + (i * (all - 1) + (count - 1) / 2) / (count - 1) }).collect()
    }

    fn methods(&self, compared: &[Method]) -> Vec<Method> {
        let wanted = |m: &&Method| self.methods.is_empty() || self.methods.contains(m);
        let possible = |m: &&Method| !m.needs_ipopt() || ipopt::VERSION.is_some();
        compared.iter().filter(wanted).filter(possible).copied().collect()
    }
}

/// The runs of an experiment, replicate by replicate so that every method has as many when it is stopped. Methods that this build does not have
/// are left out.
///
/// # Errors
/// [`Error::Invalid`] for another experiment.
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
            // In experiment 3 they differ in the number of generations only.
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
