//! `solve`: search for a gait.

use super::args::{GoalArg, GoalSource, LowerArgs, WorldArgs, apply, merge};
use super::label::{label, world_of};
use super::scenario_file::{ScenarioFile, Start, of_state, table_of};
use super::{CANCELLED, Failure, Verdict, print, to_json};
use crate::backend::Backend;
use crate::error::{Error, Result, from_json};
use crate::gait::cost::Cost;
use crate::gait::family::GaitFamily;
use crate::gait::{Schedule, Trajectory};
use crate::nlp::transcription;
use crate::refine::RefineSettings;
use crate::report::joints;
use crate::report::motion_plot::{self, MotionPlot};
use crate::report::result::{GaitResult, Refinement, Run, SolvedOn};
use crate::report::verdict::verdict;
use crate::report::{SolveResult, files, gait_diagram};
use crate::scenario::Scenario;
use crate::search::cem::objective::OBJECTIVES;
use crate::search::cem::{Objective, Sampler};
use crate::search::diagnosis::{Diagnosis, diagnose};
use crate::search::evaluate::LowerSettings;
use crate::search::precheck::{Finding, precheck};
use crate::search::{Gaits, Progress, Search, SearchResult, SearchSettings};
use crate::settings::Legs;
use crate::task::{Goal, Task};
use clap::Args;
use clap::builder::PossibleValuesParser;
use indicatif::{ProgressBar, ProgressFinish};
use serde::Deserialize;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use tracing::{Level, enabled, info, warn};

#[derive(Debug, Clone, Args)]
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
    lower: LowerArgs,
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
    fn over(self, file: ScenarioFile) -> Result<Solve> {
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
        let scenario = self.scenario.as_deref().map(Scenario::named).transpose()?;
        let mut lower = self.lower.settings(if self.preset.is_some() { Legs::Free } else { Legs::Limited })?;
        let settings = self.search_settings()?;
        let whole = self.task(scenario.as_ref())?;
        // So that the result says which it was.
        lower.transcription.interval = Some(transcription::interval(&lower.transcription, &whole.robot));
        self.plot.as_deref().map_or(Ok(()), motion_plot::check)?;
        let backend = self.lower.backend(settings.population)?;
        let waypoints = self.waypoints();
        let legs = waypoints.len() + 1;
        let mut start = None;
        for leg in 1..=legs {
            let task = self.leg(&whole, &waypoints, leg, start.as_ref())?;
            let folder = self.out.as_ref().map(|out| if legs == 1 { out.clone() } else { out.join(format!("leg-{leg}")) });
            let scenario = scenario.as_ref().filter(|_| leg == legs);
            let (verdict, motion) = self.run_leg(&task, folder.as_deref(), scenario, &settings, &lower, &*backend)?;
            if verdict != Verdict::Feasible {
                if leg < legs {
                    warn!("leg {leg} of {legs} has no gait: the further ones were not looked for");
                }
                return Ok(verdict);
            }
            start = Some(motion);
        }
        Ok(Verdict::Feasible)
    }

    /// The task of a leg: from the start, or where the leg before ends, to the next place on the way.
    fn leg(&self, whole: &Task, waypoints: &[(Goal, bool)], leg: usize, before: Option<&Trajectory>) -> Result<Task> {
        let task = before.map_or_else(|| Ok(whole.clone()), |motion| whole.after(motion))?;
        let Some(&(goal, turns_evenly)) = waypoints.get(leg - 1) else { return Ok(task) };
        let part = 1. / (waypoints.len() + 2 - leg) as f64;
        let goal = if turns_evenly { goal.yaw(task.line(part)[5]) } else { goal };
        task.to(goal).map_err(|e| e.within(format_args!("place {leg} on the way")))
    }

    /// Searches for the gait of a leg, and writes and prints what was found.
    fn run_leg(
        &self,
        task: &Task,
        folder: Option<&Path>,
        scenario: Option<&Scenario>,
        settings: &SearchSettings,
        lower: &LowerSettings,
        backend: &dyn Backend,
    ) -> std::result::Result<(Verdict, Trajectory), Failure> {
        let warnings = possible(task, settings, lower)?;
        if let Some(folder) = folder {
            files::make_folder(folder)?;
        }
        let seed = self.seed.unwrap_or(SEED);
        let search = Search::new(task).settings(settings.clone()).lower(lower.clone()).seed(seed).cancelled_by(&CANCELLED);
        let search = if std::io::stderr().is_terminal() && enabled!(Level::INFO) {
            search.on_progress(bar())
        } else {
            search.on_progress(tell_now_and_then())
        };
        let mut found = search.run(backend)?;
        let refined = if self.refine && found.best.feasible() { Some(self.refine(task, settings, lower, &mut found)?) } else { None };

        let target = scenario.filter(|_| self.goal.is_none() && self.asked.goal.is_none()).map(|_| self.target.unwrap_or(TARGET));
        let name = scenario.map(|s| s.name);
        let run = Run {
            scenario: name,
            target,
            task,
            seed,
            force_limit: transcription::force_limit(&lower.transcription, task),
            search: settings,
            lower,
        };
        let mut result = SolveResult::new(&run, &found, refined.as_ref(), SolvedOn::new(backend, lower.precision));
        result.warnings = warnings;
        if !result.feasible {
            result.diagnosis = Some(diagnosed(task, settings, lower, &found, backend)?);
        }
        result.joints = joints::limits(found.best.trajectory(), &task.robot)?.filter(|_| result.feasible);
        if let Some(folder) = folder {
            let gaits = std::iter::once(&found.best).chain(&found.alternatives);
            let trajectories: Vec<String> = gaits
                .map(|gait| serde_json::to_string(&label(gait.trajectory().clone(), task, name, target, Some(seed))))
                .collect::<std::result::Result<_, _>>()
                .map_err(Error::from)?;
            write_trajectories(folder, &trajectories)?;
            files::write(&folder.join("result.json"), &to_json(&result)?)?;
            files::write(&folder.join("scenario.toml"), &self.scenario_of(task, &run, &result.solved_on.device)?.text()?)?;
        }
        if let Some(path) = &self.plot {
            let (robot, terrain, force_limit) = (&*task.robot, &*task.terrain, run.force_limit);
            let trajectory = found.best.trajectory();
            motion_plot::write(&MotionPlot { title: plot_title(&result, trajectory), trajectory, robot, terrain, force_limit }, path)?;
        }
        print(&if self.json { to_json(&result)? } else { text(&result, folder)? })?;
        let verdict = if result.feasible { Verdict::Feasible } else { Verdict::Infeasible };
        Ok((verdict, found.best.trajectory().clone()))
    }

    /// Refines the best gait in its place.
    fn refine(&self, task: &Task, search: &SearchSettings, lower: &LowerSettings, found: &mut SearchResult) -> Result<Refinement> {
        let settings = self.refine_settings()?;
        let start = Instant::now();
        let (best, refined) = found.best.refined(task, search, lower, &settings, &|| CANCELLED.load(Ordering::Relaxed))?;
        found.best = best;
        Ok(Refinement { refined, settings, seconds: start.elapsed().as_secs_f64() })
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

    /// A scenario file that asks for the same again, of a built-in scenario or whole.
    fn scenario_of(&self, task: &Task, run: &Run, device: &str) -> Result<ScenarioFile> {
        let (robot, terrain) = world_of(task);
        let of_target = |target| Scenario::named(run.scenario?).ok()?.task(target).ok();
        let is_its = run.target.and_then(of_target).is_some_and(|own| own.goal == task.goal);
        let settings = [
            ("search", table_of(run.search)?),
            ("transcription", table_of(&run.lower.transcription)?),
            ("solver", table_of(&run.lower.solver)?),
            ("refine", table_of(&self.refine_settings()?)?),
        ];
        Ok(ScenarioFile {
            version: Some(env!("CARGO_PKG_VERSION").into()),
            scenario: run.scenario.map(Into::into),
            target: run.target,
            seed: Some(run.seed),
            refine: self.refine.then_some(true),
            transcription: Some(run.lower.transcription.rows),
            precision: Some(run.lower.precision),
            device: Some(if device.starts_with("cpu") { "cpu" } else { "gpu" }.into()),
            force_limit: task.force_limit,
            start: Some(Start::in_state(&task.start, &task.start_feet)),
            goal: (!is_its).then(|| of_state(&task.goal)),
            robot: Some(robot),
            terrain: Some(terrain),
            settings: settings.into_iter().map(|(name, table)| (name.into(), toml::Value::Table(table))).collect(),
            ..ScenarioFile::default()
        })
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
fn text(result: &SolveResult, folder: Option<&Path>) -> Result<String> {
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
        text += &format!("\njoints, whose limits no search knows\n{joints}");
    }
    if let Some(diagnosis) = &result.diagnosis {
        text += &format!("\n{diagnosis}");
    }
    if let Some(folder) = folder {
        text += &format!("\nwritten to {}\n", folder.display());
    }
    Ok(text)
}

/// What a picture of the gait says above it.
fn plot_title(result: &SolveResult, trajectory: &Trajectory) -> String {
    let family = result.gait.family.map(|f| format!("{f}, ")).unwrap_or_default();
    let cost = result.gait.evaluated.cost.as_ref().map(|c| format!(", cost {:.3}", c.total)).unwrap_or_default();
    format!("{family}{:.2} s{cost}, {}", trajectory.horizon, verdict(trajectory, result.certificate))
}

/// What stands in the way of a gait without making it impossible, said on the way.
///
/// # Errors
/// What makes it impossible.
fn possible(task: &Task, settings: &SearchSettings, lower: &LowerSettings) -> Result<Vec<Finding>> {
    let findings = precheck(task, settings, &lower.transcription);
    if let Some(certain) = findings.iter().find(|finding| finding.certain) {
        return Err(certain.clone().into());
    }
    findings.iter().for_each(|finding| warn!("warning: {finding}"));
    Ok(findings)
}

/// Part of the time of a search that looking for the reasons of its failure may take, and how long it may take at least.
const DIAGNOSIS: (f64, Duration) = (0.25, Duration::from_secs(2));

/// Why a search found nothing.
fn diagnosed(
    task: &Task,
    settings: &SearchSettings,
    lower: &LowerSettings,
    found: &SearchResult,
    backend: &dyn Backend,
) -> Result<Diagnosis> {
    let limit = Duration::from_secs_f64(DIAGNOSIS.0 * found.seconds).max(DIAGNOSIS.1);
    diagnose(task, &found.best, &settings.gaits, lower, backend, limit, &|| CANCELLED.load(Ordering::Relaxed))
}

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
    format!(
        "cost {:.3} a weight and distance: leg work {:.3}, swing work {:.3}, effort {:.3} ({:.3} weights^2)\n\
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

/// Writes the best and its alternatives, and takes away those of an earlier run, which would pass for this one's.
fn write_trajectories(folder: &Path, trajectories: &[String]) -> Result<()> {
    let path = |number: usize| folder.join(if number == 1 { "trajectory.json".into() } else { format!("trajectory-{number}.json") });
    for (number, trajectory) in (1..).zip(trajectories) {
        files::write(&path(number), &format!("{trajectory}\n"))?;
    }
    for path in (trajectories.len() + 1..).map(path).take_while(|path| path.is_file()) {
        std::fs::remove_file(&path).map_err(|source| Error::Io { action: "remove", path, source })?;
    }
    Ok(())
}
