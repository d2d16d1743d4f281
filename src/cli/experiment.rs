//! `experiment`: repeats the experiments of the paper, with baselines.

use super::args::{DeviceArgs, workers};
use super::{CANCELLED, Failure, Verdict, print};
use crate::backend::Precision;
use crate::error::{Error, Result};
use crate::experiment::plan::{EXPERIMENTS, Extent};
use crate::experiment::{Devices, Log, Method, plan, plot, run, summary};
use crate::files;
use crate::reference::ipopt;
use crate::reference::workers::{Workers, threads_or_all};
use clap::Args;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use tracing::{info, warn};

#[derive(Debug, Args)]
pub struct Experiment {
    /// 1: three quadruped scenarios, 20 targets, all methods; 2: biped, quadruped, hexapod; 3: fewest steps and least force; or `all`
    experiment: ExperimentArg,
    /// Folder for raw runs, tables and plots. Runs that it has already are not repeated
    #[arg(long, value_name = "DIR", default_value = "experiments")]
    out: PathBuf,
    /// Representative part, in minutes: 5 of 20 targets or replicates; experiment 3: 2 of 10 replicates, 10 of 50 generations, populations
    /// up to 1024
    #[arg(long)]
    quick: bool,
    /// Methods [default: all of the experiment]: cregopt, cregopt-towr, ipopt, towr, contact-implicit, random, random-towr, random-ipopt,
    /// no-stall, no-stall-towr
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    methods: Vec<String>,
    /// Largest number of targets (experiment 1) or replicates
    #[arg(long)]
    replicates: Option<u64>,
    /// Generations of experiment 3
    #[arg(long)]
    generations: Option<usize>,
    /// Populations of experiment 3
    #[arg(long, value_name = "N,...", value_delimiter = ',')]
    populations: Vec<usize>,
    /// Seed of the first replicate; later ones count up
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    place: DeviceArgs,
}

/// Number of an experiment, or all of them.
#[derive(Debug, Clone, Copy)]
struct ExperimentArg(Option<u8>);

impl std::str::FromStr for ExperimentArg {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text.parse() {
            _ if text == "all" => Ok(ExperimentArg(None)),
            Ok(number) if EXPERIMENTS.contains(&number) => Ok(ExperimentArg(Some(number))),
            _ => Err("expected 1, 2, 3 or all".into()),
        }
    }
}

impl Experiment {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let methods = self.methods.iter().map(|name| Method::named(name)).collect::<Result<Vec<Method>>>()?;
        if methods.iter().any(|m| m.needs_ipopt()) {
            ipopt::check()?;
        }
        if self.replicates == Some(0) {
            return Err(Error::invalid("--replicates", 0, "at least 1").into());
        }
        let extent = Extent {
            quick: self.quick,
            seed: self.seed,
            methods,
            replicates: self.replicates,
            generations: self.generations,
            populations: self.populations.clone(),
        };
        files::make_folder(&self.out)?;
        let workers = ipopt::check().ok().map(|()| workers(self.place.threads.unwrap_or(0))).transpose()?;
        if workers.is_none() {
            warn!("without Ipopt: its methods are skipped (build with `--features ipopt`)");
        }
        let numbers = self.experiment.0.map_or(EXPERIMENTS.collect(), |number| vec![number]);
        let mut found = false;
        for number in numbers {
            let runs = self.experiment(number, &extent, workers.as_ref())?;
            found |= runs.iter().any(|run| run.success);
            if !runs.is_empty() {
                print(&format!("\n## Experiment {number}\n\n{}\n", summary::markdown(number, &runs)))?;
            }
            if CANCELLED.load(Ordering::Relaxed) {
                break;
            }
        }
        print(&format!("written to {}\n", self.out.display()))?;
        Ok(if found { Verdict::Feasible } else { Verdict::Infeasible })
    }

    /// Runs the missing cases, and writes tables and plots of all runs.
    fn experiment(&self, number: u8, extent: &Extent, workers: Option<&Workers>) -> std::result::Result<Vec<run::Run>, Failure> {
        let cases = plan(number, extent)?;
        if cases.is_empty() && self.experiment.0.is_some() {
            let methods = self.methods.join(",");
            return Err(Error::invalid("--methods", methods, format!("methods that experiment {number} compares")).into());
        }
        for case in &cases {
            case.search()?.validate()?;
        }
        let mut log = Log::open(&self.out.join(format!("experiment{number}.jsonl")), threads_or_all(self.place.threads.unwrap_or(0)))?;
        // The faster device depends on the population.
        let mut backends = BTreeMap::new();
        let count = cases.len();
        for (i, case) in cases.into_iter().enumerate() {
            if log.has(&case) {
                continue;
            }
            let backend = match backends.entry(case.population) {
                Entry::Occupied(entry) => entry.into_mut(),
                Entry::Vacant(entry) => entry.insert(self.place.backend(case.population, Precision::F32)?),
            };
            let devices = Devices { backend: &**backend, workers };
            let Some(run) = run::run(&case, &devices, &CANCELLED)? else { break };
            let target = case.target.map(|t| format!(" target {t}")).unwrap_or_default();
            let verdict = if run.success { "found" } else { "nothing found" };
            info!(
                "experiment {number}, {} of {count}: {}{target}, replicate {}, {}, population {}, heuristic {}: {verdict} in {:.3} s of {:.3} s",
                i + 1,
                case.scenario,
                case.replicate,
                case.method,
                case.population,
                case.heuristic,
                run.first_or_all(),
                run.seconds,
            );
            log.add(run)?;
        }
        self.write(number, log.runs())?;
        Ok(log.runs().to_vec())
    }

    fn write(&self, number: u8, runs: &[run::Run]) -> Result<()> {
        let path = |end: &str| self.out.join(format!("experiment{number}{end}"));
        if runs.is_empty() {
            return Ok(());
        }
        files::write(&path(".csv"), &summary::csv(runs)?)?;
        files::write(&path(".json"), &summary::json(number, runs)?)?;
        files::write(&path(".md"), &summary::markdown(number, runs))?;
        files::write(&path("_gaits.svg"), &plot::gaits(runs)?)?;
        if number < 3 {
            files::write(&path("_times.svg"), &plot::times(runs)?)
        } else {
            files::write(&path("_objectives.svg"), &plot::objectives(runs)?)
        }
    }
}
