//! `solve`: search for a gait.

use super::args::{Goal, GoalArg, LowerArgs, WorldArgs, apply};
use super::label::{device, label};
use super::{CANCELLED, Failure, Verdict, print, to_json};
use crate::error::Result;
use crate::gait::Schedule;
use crate::nlp::transcription;
use crate::report::result::Run;
use crate::report::{SolveResult, files, gait_diagram};
use crate::scenario::Scenario;
use crate::search::cem::{CemSettings, Objective, Sampler, Stopping};
use crate::search::search;
use crate::task::Task;
use crate::verify::verify;
use clap::{Args, ValueEnum};
use std::io::IsTerminal;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct Solve {
    /// Scenario from `list`
    #[arg(long)]
    scenario: Option<String>,
    /// Target of the scenario, 1 to 20
    #[arg(long, default_value_t = 10)]
    target: usize,
    /// Goal instead of a target, m; without Z the base is as high above the ground there as at the start
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true)]
    goal: Option<GoalArg>,
    /// Final yaw, rad; the scenario's by default
    #[arg(long, allow_hyphen_values = true)]
    yaw: Option<f64>,
    #[command(flatten)]
    world: WorldArgs,
    /// Seed of the search
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Search settings to start from, from `list`
    #[arg(long, default_value = "experiment1")]
    preset: String,
    /// Candidates a generation; elites keep their share
    #[arg(long)]
    population: Option<usize>,
    /// Most generations
    #[arg(long)]
    generations: Option<usize>,
    /// What to search for; anything but feasibility runs until convergence
    #[arg(long, value_enum)]
    objective: Option<ObjectiveArg>,
    /// Draw stance counts of the feet independently instead of in triplets
    #[arg(long)]
    no_heuristic: bool,
    /// Plain random sampling: never update the distribution
    #[arg(long)]
    random: bool,
    /// Evaluate the whole generation even when a candidate is feasible
    #[arg(long)]
    whole_generation: bool,
    #[command(flatten)]
    lower: LowerArgs,
    /// Folder for result.json and trajectory.json
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print result.json instead of text
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ObjectiveArg {
    /// Any feasible gait
    Feasibility,
    /// Fewest stance phases
    FewestStances,
    /// Least mean normal force
    LeastForce,
}

impl Solve {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let scenario = self.scenario.as_deref().map(Scenario::named).transpose()?;
        let mut lower = self.lower.settings()?;
        let settings = self.search_settings()?;
        let task = self.task(scenario.as_ref())?;
        let force_limit = transcription::force_limit(lower.transcription.rows, &task);
        // So that the result says which it was.
        lower.transcription.interval = Some(transcription::interval(&lower.transcription, &task.robot));
        if let Some(folder) = &self.out {
            files::make_folder(folder)?;
        }
        let backend = self.lower.backend(settings.population)?;

        let terminal = std::io::stderr().is_terminal();
        let mut progress = |g: &crate::search::cem::GenerationRecord| {
            if terminal {
                let fewest = g.lowest_n_violated.map_or("-".into(), |n| n.to_string());
                eprintln!("generation {}: {} evaluated, {} feasible, fewest violations {fewest}", g.generation, g.evaluated, g.feasible);
            }
        };
        let found = search(&task, &settings, &lower, self.seed, &*backend, &CANCELLED, &mut progress)?;

        let target = scenario.filter(|_| self.goal.is_none()).map(|_| self.target);
        let trajectory = found.best.as_ref().map(|b| {
            let trajectory = b.solution.trajectory(&task, &lower.transcription);
            label(trajectory, &task, scenario.as_ref().map(|s| s.name), target, Some(self.seed))
        });
        let certificate = trajectory.as_ref().map(|t| verify(t, &task.robot, &task.terrain, force_limit)).transpose()?;
        let device = device(&*backend, lower.precision);
        let run = Run {
            scenario: scenario.as_ref().map(|s| (s.name, target)),
            task: &task,
            search: &settings,
            lower: &lower,
            seed: self.seed,
            device,
            force_limit,
        };
        let result = SolveResult::new(&run, &found, certificate);
        if let Some(folder) = &self.out {
            let path = folder.join("trajectory.json");
            if let Some(trajectory) = &trajectory {
                files::write(&path, &(serde_json::to_string(trajectory).map_err(crate::Error::from)? + "\n"))?;
            } else if path.is_file() {
                // One of an earlier run would pass for this one's.
                std::fs::remove_file(&path).map_err(|source| crate::Error::Io { action: "remove", path, source })?;
            }
            files::write(&folder.join("result.json"), &to_json(&result)?)?;
        }
        print(&if self.json { to_json(&result)? } else { self.text(&result)? })?;
        Ok(if result.feasible { Verdict::Feasible } else { Verdict::Infeasible })
    }

    fn task(&self, scenario: Option<&Scenario>) -> Result<Task> {
        let goal = Goal {
            target: scenario.map(|_| self.target),
            base_target: self.goal.and_then(|g| g.z.map(|z| [g.xy[0], g.xy[1], z])),
            xy: self.goal.map(|g| g.xy),
            yaw: self.yaw,
        };
        self.world.read()?.task(scenario, goal)
    }

    /// The preset with what was given on top.
    fn search_settings(&self) -> Result<CemSettings> {
        let mut settings = CemSettings::preset(&self.preset)?;
        if let Some(population) = self.population {
            settings = settings.with_population(population);
        }
        if let Some(generations) = self.generations {
            settings.generations = generations;
        }
        if let Some(objective) = self.objective {
            (settings.objective, settings.stopping) = match objective {
                ObjectiveArg::Feasibility => (Objective::Feasibility, Stopping::FirstFeasible),
                ObjectiveArg::FewestStances => (Objective::FewestStances, Stopping::Convergence),
                ObjectiveArg::LeastForce => (Objective::LeastForce, Stopping::Convergence),
            };
        }
        settings.heuristic &= !self.no_heuristic;
        settings.whole_generation |= self.whole_generation;
        if self.random {
            settings.sampler = Sampler::Random;
        }
        let settings = apply(settings, "search.", self.lower.set.iter().filter_map(|s| s.strip_prefix("search.")))?;
        settings.validate()?;
        Ok(settings)
    }

    fn text(&self, result: &SolveResult) -> Result<String> {
        let [x, y, z] = result.base_target;
        let scenario = result.scenario.as_deref().map(|s| format!("{s}: ")).unwrap_or_default();
        let mut text = format!(
            "{scenario}{} on {}, to ({x:.3}, {y:.3}, {z:.3}) m, yaw {:.3} rad\nseed {}, {}, {} rows\n\n",
            result.robot,
            result.terrain,
            result.yaw_target,
            result.seed,
            result.device,
            result.transcription.name()
        );
        let generations = result.generations.len();
        let evaluated: usize = result.generations.iter().map(|g| g.evaluated).sum();
        let verdict = if result.feasible { "gait found" } else { "no feasible gait" };
        text += &format!("{verdict} in {:.3} s ({}; candidates: {evaluated}, generations: {generations})\n", result.seconds, result.stop);
        if let Some(after) = result.first_feasible_seconds {
            text += &format!("first feasible gait after {after:.3} s\n");
        }
        if let Some(gait) = &result.gait {
            let total: usize = gait.n_stance.iter().sum();
            text += &format!(
                "horizon {:.1} s, stance phases {:?} ({total}), {} variables, {} after {} iterations, mean normal force {:.1} N\n\n",
                gait.horizon, gait.n_stance, gait.n_variables, gait.status, gait.iterations, gait.mean_normal_force
            );
            text += &gait_diagram(&Schedule::new(gait.durations.clone())?);
        }
        if let Some(certificate) = &result.certificate {
            text += &format!("\n{certificate}\n");
        }
        if let Some(folder) = &self.out {
            text += &format!("\nwritten to {}\n", folder.display());
        }
        Ok(text)
    }
}
