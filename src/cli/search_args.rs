//! What is asked of a search, by flags or by the keys of a scenario file.

use crate::error::{Error, Result, from_json};
use crate::gait::Schedule;
use crate::gait::family::GaitFamily;
use crate::report::files;
use crate::search::cem::objective::OBJECTIVES;
use crate::search::cem::{Objective, Sampler};
use crate::search::{Gaits, SearchSettings};
use clap::Args;
use clap::builder::PossibleValuesParser;
use serde::Deserialize;
use std::path::Path;

/// The search.
#[derive(Debug, Clone, Default, Args)]
pub struct SearchArgs {
    /// Which gaits: all families that the robot can have, some of them, any schedule at all as in the paper, or those near the `durations` of a
    /// JSON file
    #[arg(long, value_name = "all|FAMILY,...|free|FILE")]
    pub gait: Option<String>,
    /// Candidates a generation; elites keep their share
    #[arg(long)]
    pub population: Option<usize>,
    /// Most generations, behind the families' typical gaits
    #[arg(long)]
    pub generations: Option<usize>,
    /// What is best among gaits
    #[arg(long, value_parser = PossibleValuesParser::new(OBJECTIVES.map(|(name, _)| name)))]
    pub objective: Option<String>,
    /// End a search after this time with the best so far, s; each leg has it anew, and `--refine` comes on top. Gaits then depend on the machine
    #[arg(long, value_name = "SECONDS")]
    pub time: Option<f64>,
    /// End with the first gait
    #[arg(long)]
    pub first: bool,
    /// Gaits to return: the best, and the best of other families [default: 1]
    #[arg(long, value_name = "K")]
    pub alternatives: Option<usize>,
    /// Plain random sampling: never update the distribution, nor look around the best
    #[arg(long)]
    pub random: bool,
}

impl SearchArgs {
    /// Settings with what is asked on top.
    ///
    /// # Errors
    /// For a gait, a file of one, or an objective that does not exist.
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

/// `--gait`. A family's name is one, whatever files there are.
fn gaits(text: &str) -> Result<Gaits> {
    /// What is read of a trajectory or a line of schedules, and of the gait of a result.
    #[derive(Deserialize)]
    struct Durations {
        durations: Schedule,
    }
    /// What is read of a file.
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
