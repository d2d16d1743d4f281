//! `atlas`: solves every regular gait of a robot at every speed.

use super::args::DeviceArgs;
use super::{CANCELLED, Failure, Verdict, print, to_json};
use crate::app::named::robot;
use crate::app::options::apply;
use crate::backend::{DeviceChoice, Precision};
use crate::error::Result;
use crate::files;
use crate::gait::family::GaitFamily;
use crate::report::atlas::{AtlasResult, csv};
use crate::report::atlas_plot::svg;
use crate::report::result::SolvedOn;
use crate::search::atlas::{AtlasPlan, atlas_settings};
use crate::search::evaluate::LowerSettings;
use clap::Args;
use std::path::PathBuf;
use tracing::{info, warn};

/// Number of problems solved at once on the CPU: few, so that progress is reported often.
const CHUNK: usize = 256;
/// Number of problems solved at once on a GPU; bounds memory.
const CHUNK_GPU: usize = 8192;

/// Prefix of settings that are weights of the cost; the others belong to the lower level.
const COST: &str = "cost.";

#[derive(Debug, Args)]
pub struct Atlas {
    /// Robot: a name from `list`, or a JSON or TOML file
    #[arg(long, value_name = "NAME|FILE")]
    robot: String,
    /// Gaits [default: all that the robot can have]
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    gait: Vec<String>,
    /// Travel speeds, ascending, m/s [default: 0.1 to 1.6 sqrt(g l), l: height of the base]
    #[arg(long, value_name = "M/S,...", value_delimiter = ',')]
    speeds: Vec<f64>,
    /// Stride periods, s [default: 1 to 5 sqrt(l / g)]
    #[arg(long, value_name = "S,...", value_delimiter = ',')]
    periods: Vec<f64>,
    /// Duty factors: share of a stride that a foot is in stance [default: 0.25 to 0.85]
    #[arg(long, value_name = "SHARE,...", value_delimiter = ',')]
    duties: Vec<f64>,
    /// Slopes of the ground, rise over run [default: 0]
    #[arg(long, value_name = "SLOPE,...", value_delimiter = ',', allow_hyphen_values = true)]
    slopes: Vec<f64>,
    /// Smallest time at constant speed, s; the cost is that of one stride in it [default: 8 sqrt(l / g)]
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// Folder for atlas.csv, atlas.json and atlas.svg
    #[arg(long, value_name = "DIR", default_value = "atlas")]
    out: PathBuf,
    #[command(flatten)]
    place: DeviceArgs,
    /// Any setting by its path, e.g. `solver.max_iterations=100` or `cost.effort=0.1`
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

impl Atlas {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let plan = self.plan()?;
        let settings = self.settings()?;
        files::make_folder(&self.out)?;
        let backend = self.place.backend(plan.count()?, Precision::F32)?;
        let chunk = if backend.choice() == DeviceChoice::Cpu { CHUNK } else { CHUNK_GPU };
        let progress = &mut |done, all| info!("{}: {done} of {all} problems solved", self.robot);
        let atlas = plan.run(&settings, &*backend, chunk, &CANCELLED, progress)?;
        let result = AtlasResult::new(&atlas, &settings, SolvedOn::new(&*backend, settings.precision));
        files::write(&self.out.join("atlas.csv"), &csv(&atlas)?)?;
        files::write(&self.out.join("atlas.json"), &to_json(&result)?)?;
        for &slope in &atlas.plan.slopes {
            let name = if atlas.plan.slopes.len() == 1 { "atlas.svg".into() } else { format!("atlas_slope_{slope}.svg") };
            files::write(&self.out.join(name), &svg(&atlas, slope))?;
        }
        if result.solved < result.problems {
            warn!("stopped: {} of {} problems solved", result.solved, result.problems);
        }
        print(&format!("{}written to {}\n", result.text(), self.out.display()))?;
        Ok(if result.certified > 0 { Verdict::Feasible } else { Verdict::Infeasible })
    }

    /// Settings of the lower level: those of an atlas with the assignments of the command line.
    fn settings(&self) -> Result<LowerSettings> {
        let own = atlas_settings();
        let sets = self.set.iter().map(String::as_str).filter(|s| !s.starts_with(COST));
        let settings: LowerSettings = apply(own, "", sets)?;
        settings.validate()?;
        Ok(settings)
    }

    fn plan(&self) -> Result<AtlasPlan> {
        let mut plan = AtlasPlan::new(robot(&self.robot)?);
        if !self.gait.is_empty() {
            plan.families = self.gait.iter().map(|name| GaitFamily::named(name)).collect::<Result<_>>()?;
        }
        for (values, given) in [
            (&mut plan.speeds, &self.speeds),
            (&mut plan.periods, &self.periods),
            (&mut plan.duties, &self.duties),
            (&mut plan.slopes, &self.slopes),
        ] {
            if !given.is_empty() {
                values.clone_from(given);
            }
        }
        let costs = self.set.iter().filter_map(|s| s.strip_prefix(COST));
        plan.weights = apply(plan.weights, COST, costs)?;
        plan.even = self.seconds.unwrap_or(plan.even);
        plan.validate()?;
        Ok(plan)
    }
}
