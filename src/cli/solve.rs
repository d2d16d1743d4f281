//! `solve`: search for a gait.

use super::args::{GoalArg, GoalSource, LowerArgs, WorldArgs, apply, merge};
use super::leg::{Asking, Leg, News, Way};
use super::scenario_file::{ScenarioFile, Start};
use super::{CANCELLED, Failure, Verdict, print, to_json};
use crate::error::{Error, Result, from_json};
use crate::gait::Schedule;
use crate::gait::cost::Cost;
use crate::gait::family::GaitFamily;
use crate::refine::RefineSettings;
use crate::report::motion_plot;
use crate::report::result::{GaitResult, Refinement};
use crate::report::{SolveResult, files, gait_diagram};
use crate::scenario::Scenario;
use crate::search::cem::objective::OBJECTIVES;
use crate::search::cem::{Objective, Sampler};
use crate::search::{Gaits, Progress, SearchSettings};
use crate::settings::Legs;
use crate::task::{Goal, Task};
use clap::Args;
use clap::builder::PossibleValuesParser;
use indicatif::{ProgressBar, ProgressFinish};
use serde::Deserialize;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};
use tracing::{Level, enabled, info, warn};

#[derive(Debug, Clone, Default, Args)]
pub struct Solve {
    /// Scenario file (.toml) with anything that follows; flags override it. `init` writes one
    #[arg(value_name = "SCENARIO.toml")]
    file: Option<PathBuf>,
    /// Scenario from `list`
    #[arg(long)]
    scenario: Option<String>,
    /// Target of the scenario, 1 to 20 [default: 10]
    #[arg(long)]
    target: Option<usize>,
    /// Goal instead of a target, m; without Z the base is as high above the ground there as at the start, or as its feet reach
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true)]
    goal: Option<GoalArg>,
    /// Pass through a place on the way and stop there, m. The motion to each is a folder of its own: leg-1, leg-2 and on
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true)]
    via: Vec<GoalArg>,
    /// Start here, m, with the feet at their nominal places on the ground; above the origin by default
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true, conflicts_with = "from")]
    start: Option<GoalArg>,
    /// Yaw at the start, rad
    #[arg(long, allow_hyphen_values = true, conflicts_with = "from")]
    start_yaw: Option<f64>,
    /// Start where the motion of a trajectory file ends, with base and feet as they are then
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,
    /// Final yaw, rad; the scenario's by default
    #[arg(long, allow_hyphen_values = true)]
    yaw: Option<f64>,
    #[command(flatten)]
    world: WorldArgs,
    /// Seed of the search [default: 1]
    #[arg(long)]
    seed: Option<u64>,
    /// Which gaits: all families that the robot can have, some of them, any schedule at all as in the paper, or those near the `durations` of a
    /// JSON file
    #[arg(long, value_name = "all|FAMILY,...|free|FILE")]
    gait: Option<String>,
    /// The paper's search, from `list`: any schedule, legs that can do anything
    #[arg(long)]
    preset: Option<String>,
    /// Candidates a generation; elites keep their share
    #[arg(long)]
    population: Option<usize>,
    /// Most generations, behind the families' typical gaits
    #[arg(long)]
    generations: Option<usize>,
    /// What is best among gaits
    #[arg(long, value_parser = PossibleValuesParser::new(OBJECTIVES.map(|(name, _)| name)))]
    objective: Option<String>,
    /// End after this time with the best so far, s. Gaits then depend on the machine
    #[arg(long, value_name = "SECONDS")]
    time: Option<f64>,
    /// End with the first gait
    #[arg(long)]
    first: bool,
    /// Gaits to return: the best, and the best of other families [default: 1]
    #[arg(long, value_name = "K")]
    alternatives: Option<usize>,
    /// Bring the gait to a local optimum of its cost, phase durations among the variables
    #[arg(long)]
    refine: bool,
    /// Plain random sampling: never update the distribution
    #[arg(long)]
    random: bool,
    #[command(flatten)]
    pub lower: LowerArgs,
    /// Folder for result.json, trajectory.json and scenario.toml; alternatives are trajectory-2.json and on
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Draw the gait, its forces and its way: .svg or .png
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Print result.json instead of text
    #[arg(long)]
    json: bool,
    /// The file.
    #[arg(skip)]
    asked: ScenarioFile,
}

/// A seed that none asked for.
const SEED: u64 = 1;

/// A target that none asked for.
const TARGET: usize = 10;

impl Solve {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        match &self.file {
            None => self.clone().over(ScenarioFile::default())?.run_merged(),
            Some(path) => self.clone().over(ScenarioFile::read(path)?).map_err(|e| e.in_file(path, None))?.run_merged(),
        }
    }

    /// What is not given here as in a scenario file.
    ///
    /// # Errors
    /// For a device that cannot be, or settings that are no table.
    pub fn over(self, file: ScenarioFile) -> Result<Solve> {
        let asked = file.clone();
        // A goal on the command line is one without the file's way to its own.
        let waypoints = if self.goal.is_none() { file.waypoints } else { Vec::new() };
        Ok(Solve {
            scenario: self.scenario.or(file.scenario),
            target: self.target.or(file.target),
            seed: self.seed.or(file.seed),
            gait: self.gait.or(file.gait),
            preset: self.preset.or(file.preset),
            population: self.population.or(file.population),
            generations: self.generations.or(file.generations),
            objective: self.objective.or(file.objective),
            time: self.time.or(file.time),
            first: self.first || file.first.unwrap_or(false),
            alternatives: self.alternatives.or(file.alternatives),
            refine: self.refine || file.refine.unwrap_or(false),
            random: self.random || file.random.unwrap_or(false),
            lower: self.lower.over(&asked)?,
            out: self.out.or(file.out),
            asked: ScenarioFile { waypoints, ..asked },
            ..self
        })
    }

    /// Places on the way: those of the command line, else the file's. Those without a yaw of their own turn evenly.
    fn waypoints(&self) -> Vec<(Goal, bool)> {
        if self.via.is_empty() {
            self.asked.waypoints.iter().map(|&goal| (goal, false)).collect()
        } else {
            self.via.iter().map(|via| (via.goal(), true)).collect()
        }
    }

    fn run_merged(&self) -> std::result::Result<Verdict, Failure> {
        let watched = std::io::stderr().is_terminal() && enabled!(Level::INFO);
        let mut tell: Option<Teller> = None;
        let mut hear = |news: News| match news {
            News::Warning(finding) => warn!("warning: {finding}"),
            News::Begun => tell = Some(if watched { Box::new(bar()) } else { Box::new(tell_now_and_then()) }),
            News::Progress(progress) => tell.as_mut().map_or((), |tell| tell(progress)),
            News::Ended => tell = None,
        };
        let (legs, whole) = self.legs(&CANCELLED, &mut hear, &mut |leg, folder| {
            let run = leg.run();
            let result = leg.result(&run);
            print(&if self.json { to_json(&result)? } else { text(&result, folder)? })
        })?;
        if legs.len() < whole {
            warn!("leg {} of {whole} has no gait: the further ones were not looked for", legs.len());
        }
        let feasible = legs.iter().all(|leg| leg.found.best.feasible());
        Ok(if feasible { Verdict::Feasible } else { Verdict::Infeasible })
    }

    /// Searches leg by leg until one has no gait. Returns those that were searched, and how many there are.
    ///
    /// * `cancelled`, `hear`, `each` - as [`Way::search`] has them
    pub fn legs(
        &self,
        cancelled: &AtomicBool,
        hear: &mut (dyn FnMut(News) + Send),
        each: &mut dyn FnMut(&Leg, Option<&Path>) -> Result<()>,
    ) -> std::result::Result<(Vec<Leg>, usize), Failure> {
        let asking = self.asking()?;
        let way = self.way()?;
        self.plot.as_deref().map_or(Ok(()), motion_plot::check)?;
        let backend = self.lower.backend(asking.search.population)?;
        let legs = way.search(&asking, self.out.as_deref(), &*backend, cancelled, hear, &mut |leg, folder| {
            self.plot.as_deref().map_or(Ok(()), |path| motion_plot::write(&leg.plot(&leg.found.best), path))?;
            each(leg, folder)
        })?;
        Ok((legs, way.legs()))
    }

    /// What is to be done.
    ///
    /// # Errors
    /// For a task that cannot be.
    pub fn way(&self) -> Result<Way> {
        let scenario = self.scenario.as_deref().map(Scenario::named).transpose()?;
        let target = scenario.filter(|_| self.goal.is_none() && self.asked.goal.is_none()).map(|_| self.target.unwrap_or(TARGET));
        Ok(Way { task: self.task(scenario.as_ref())?, places: self.waypoints(), named: (scenario.map(|s| s.name), target) })
    }

    /// What is asked besides the task.
    ///
    /// # Errors
    /// For settings that are out of their limits.
    pub fn asking(&self) -> Result<Asking> {
        Ok(Asking {
            lower: self.lower.settings(if self.preset.is_some() { Legs::Free } else { Legs::Limited })?,
            search: self.search_settings()?,
            seed: self.seed.unwrap_or(SEED),
            refines: self.refine,
            refine: self.refine_settings()?,
        })
    }

    fn task(&self, scenario: Option<&Scenario>) -> Result<Task> {
        let goal = GoalSource {
            target: scenario.map(|_| self.target.unwrap_or(TARGET)),
            goal: self.goal.map(GoalArg::goal).or(self.asked.goal),
            yaw: self.yaw.or(self.asked.goal.filter(|_| self.goal.is_none()).map(|goal| goal.yaw)),
        };
        let start = match (&self.from, self.start) {
            (Some(path), _) => Start::after(path.clone()),
            (None, Some(place)) => Start::at(place.goal().yaw(self.start_yaw.unwrap_or(0.))),
            (None, None) => {
                let start = self.asked.start.clone().unwrap_or_default();
                Start { yaw: self.start_yaw.unwrap_or(start.yaw), ..start }
            }
        };
        self.world.over(&self.asked)?.task(scenario, &start, goal)
    }

    fn refine_settings(&self) -> Result<RefineSettings> {
        let sets = self.lower.set.iter().filter_map(|s| s.strip_prefix("refine."));
        let settings = merge(RefineSettings::default(), &self.asked.settings_of("refine")?, "settings.refine")?;
        apply(settings, "refine.", sets)
    }

    /// The preset with what was given on top.
    fn search_settings(&self) -> Result<SearchSettings> {
        let mut settings = self.preset.as_deref().map_or_else(|| Ok(SearchSettings::default()), SearchSettings::preset)?;
        if let Some(gait) = &self.gait {
            settings.gaits = gaits(gait)?;
        }
        if let Some(population) = self.population {
            settings = settings.with_population(population);
        }
        if let Some(generations) = self.generations {
            settings.generations = generations;
        }
        if let Some(name) = &self.objective {
            settings = settings.seeking(Objective::named(name)?);
        }
        settings.first |= self.first;
        settings.alternatives = self.alternatives.unwrap_or(settings.alternatives);
        settings.seconds = self.time.or(settings.seconds);
        if self.random {
            settings.free.sampler = Sampler::Random;
        }
        let settings = merge(settings, &self.asked.settings_of("search")?, "settings.search")?;
        let settings = apply(settings, "search.", self.lower.set.iter().filter_map(|s| s.strip_prefix("search.")))?;
        settings.validate()?;
        Ok(settings)
    }
}

/// What is printed of a result.
///
/// * `folder` - where it was written
pub fn text(result: &SolveResult, folder: Option<&Path>) -> Result<String> {
    let [x, y, z] = result.base_target;
    let scenario = result.run.scenario.map(|s| format!("{s}: ")).unwrap_or_default();
    let mut text = format!(
        "{scenario}{} on {}, to ({x:.3}, {y:.3}, {z:.3}) m, yaw {:.3} rad\nseed {}, {}, {} rows\n",
        result.robot,
        result.terrain,
        result.yaw_target,
        result.run.seed,
        result.solved_on.device,
        result.transcription.name()
    );
    if let Some(fallback) = &result.solved_on.fallback {
        text += &format!("{} candidates on the cpu, for {}\n", fallback.candidates, fallback.reason);
    }
    let generations = result.generations.len();
    let evaluated: usize = result.generations.iter().map(|g| g.evaluated).sum();
    let verdict = if result.feasible { "gait found" } else { "no feasible gait" };
    text += &format!("\n{verdict} in {:.3} s ({}; candidates: {evaluated}, generations: {generations})\n", result.seconds, result.stop);
    if let Some(after) = result.first_feasible_seconds {
        text += &format!("first feasible gait after {after:.3} s\n");
    }
    if let Some(Refinement { refined, seconds, .. }) = &result.refinement {
        let residual = refined.optimality.map_or("-".into(), |o| format!("{:.1e}", o.residual()));
        text += &format!(
            "refined in {seconds:.2} s ({}, {} convex problems, optimality residual {residual}): cost {:.3} before; {} durations moved, by up to {:.3} s\n",
            refined.status, refined.iterations, refined.before.total, refined.changed, refined.largest_change
        );
    }
    text += &gait_text(&result.gait);
    text += &format!("\n{}", gait_diagram(&Schedule::new(result.gait.durations.clone())?));
    for gait in &result.alternatives {
        text += &format!("\nalternative\n{}", gait_text(gait));
    }
    text += &format!("\n{}\n", result.certificate);
    if let Some(joints) = &result.joints {
        text += &format!("\njoints\n{joints}");
        if !joints.kept {
            let advice = if result.run.search.prefers_joint_limits() {
                "one family alone (`--gait`), or a larger `--population`, may have a gait within them"
            } else {
                "this search did not look at joints: without `--first` the objectives transport, time and effort do, by `search.cost.joint_excess`"
            };
            text += &format!("  {advice}\n");
        }
    }
    if let Some(diagnosis) = &result.diagnosis {
        text += &format!("\n{diagnosis}");
    }
    if let Some(folder) = folder {
        text += &format!("\nwritten to {}\n", folder.display());
    }
    Ok(text)
}

/// Says how far a search is.
type Teller = Box<dyn FnMut(&Progress) + Send>;

/// Seconds between two lines of a search that nobody watches.
const TELL: f64 = 10.;

/// The line of a generation now and then, for logs.
fn tell_now_and_then() -> impl FnMut(&Progress) + Send {
    let mut told = Instant::now();
    move |progress| {
        let Progress::Generation(g) = progress else { return };
        if told.elapsed().as_secs_f64() >= TELL {
            told = Instant::now();
            let fewest = g.lowest_n_violated.map_or("-".into(), |n| n.to_string());
            let counts = format!("{} evaluated, {} feasible, fewest violations {fewest}", g.evaluated, g.feasible);
            info!("generation {}: {counts}", g.generation);
        }
    }
}

/// A line that says how far the search is and what is the best so far, for those who watch.
fn bar() -> impl FnMut(&Progress) + Send {
    let bar = ProgressBar::new_spinner().with_finish(ProgressFinish::AndClear);
    bar.enable_steady_tick(Duration::from_millis(120));
    let (mut evaluated, mut feasible, mut best) = (0, 0, String::from("no gait yet"));
    move |progress| {
        match progress {
            Progress::Generation(g) => (evaluated, feasible) = (evaluated + g.evaluated, feasible + g.feasible),
            Progress::Improvement(i) => {
                let family = i.family.map(|f| format!("{f}, ")).unwrap_or_default();
                best = format!("best {family}{:.3} after {:.2} s", -i.objective, i.seconds);
            }
        }
        bar.set_message(format!("{evaluated} candidates, {feasible} gaits, {best}"));
    }
}

/// A gait in a few lines.
fn gait_text(gait: &GaitResult) -> String {
    let evaluated = &gait.evaluated;
    let total: usize = gait.n_stance.iter().sum();
    let family = gait.family.map(|f| format!("{f}, ")).unwrap_or_default();
    let mut text = format!(
        "{family}horizon {:.2} s, stance phases {:?} ({total}), {} variables, {} after {} iterations\n",
        evaluated.horizon, gait.n_stance, evaluated.n_variables, evaluated.outcome.status, evaluated.outcome.iterations
    );
    if let Some(cost) = &evaluated.cost {
        text += &cost_text(cost);
    }
    text
}

/// What a motion costs, and what its legs have to do.
fn cost_text(cost: &Cost) -> String {
    let joints = if cost.joint_cost > 0. { format!(", joints {:.3}", cost.joint_cost) } else { String::new() };
    format!(
        "cost {:.3} a weight and distance: leg work {:.3}, swing work {:.3}, effort {:.3} ({:.3} weights^2){joints}\n\
         peak force {:.2} weights, tilt {:.1} deg, feet up to {:.2} m/s and {:.0} m/s^2\n",
        cost.total,
        cost.leg_work,
        cost.swing_work,
        cost.effort_cost,
        cost.effort,
        cost.peak_force,
        cost.tilt,
        cost.foot_speed,
        cost.foot_acceleration
    )
}

/// `--gait`.
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
    match text {
        "all" => Ok(Gaits::All),
        "free" => Ok(Gaits::Free),
        _ if path.exists() || path.extension().is_some() => {
            let file: File = from_json(&files::read(path)?).map_err(|e| e.in_file(path, None))?;
            let durations = file.durations.or(file.gait.map(|gait| gait.durations));
            let missing = || Error::Format { message: "missing field `durations`, in the file or in its `gait`".into() };
            durations.map(Gaits::Around).ok_or_else(|| missing().in_file(path, None))
        }
        _ => text.split(',').map(|name| GaitFamily::named(name.trim())).collect::<Result<_>>().map(Gaits::Families),
    }
}
