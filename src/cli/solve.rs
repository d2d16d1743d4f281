//! `solve`: search for a gait.

use super::args::{GoalArg, GoalSource, LowerArgs, WorldArgs, apply, merge};
use super::leg::{Asking, Leg, News, Way, leg_file};
use super::scenario_file::{ScenarioFile, Start};
use super::search_args::SearchArgs;
use super::{CANCELLED, Failure, Verdict, print, to_json};
use crate::error::Result;
use crate::gait::Schedule;
use crate::gait::cost::Cost;
use crate::refine::RefineSettings;
use crate::report::motion_plot;
use crate::report::result::{GaitResult, Refinement};
use crate::report::{SolveResult, gait_diagram};
use crate::scenario::Scenario;
use crate::search::{SearchEvent, SearchSettings};
use crate::settings::Legs;
use crate::task::{Goal, Task};
use clap::Args;
use indicatif::{ProgressBar, ProgressFinish};
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
    /// Goal instead of a target, m; without Z the base is above the ground there by its `base_height`, or as its feet reach
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
    /// The paper's search, from `list`: any schedule, legs that can do anything
    #[arg(long)]
    preset: Option<String>,
    #[command(flatten)]
    search: SearchArgs,
    /// Bring the gait to a local optimum of its cost, phase durations among the variables
    #[arg(long)]
    refine: bool,
    #[command(flatten)]
    pub lower: LowerArgs,
    /// Folder for result.json, trajectory.json and scenario.toml; alternatives are trajectory-2.json and on
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Draw the gait, its forces and its way: .svg or .png; with places on the way FILE-leg-1 and on
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
    pub fn over(self, mut file: ScenarioFile) -> Result<Solve> {
        if self.scenario.is_some() && file.scenario.is_some() && self.scenario != file.scenario {
            file = file.without_task();
        }
        if self.preset.is_some() {
            file = file.without_search();
        }
        if self.goal.is_some() || self.target.is_some() {
            // Another goal is one without the file's way to its own.
            file = ScenarioFile { goal: None, waypoints: Vec::new(), ..file };
        }
        let asked = file.clone();
        Ok(Solve {
            scenario: self.scenario.or(file.scenario),
            target: self.target.or(file.target),
            seed: self.seed.or(file.seed),
            preset: self.preset.or(file.preset),
            refine: self.refine || file.refine.unwrap_or(false),
            lower: self.lower.over(&asked)?,
            out: self.out.or(file.out),
            asked,
            ..self
        })
    }

    /// To a target of its scenario, if one is given.
    #[cfg(feature = "python")]
    pub fn at_target(self, target: Option<usize>) -> Solve {
        Solve { target, ..self }
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
        let feasible = legs.iter().all(|leg| leg.found.best.feasible());
        if legs.len() < whole {
            let why = if feasible {
                "has one, but the end was asked for: the further ones were not looked for"
            } else {
                "has no gait: the further ones were not looked for"
            };
            warn!("leg {} of {whole} {why}", legs.len());
        }
        Ok(if feasible && legs.len() == whole { Verdict::Feasible } else { Verdict::Infeasible })
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
        let backend = self.lower.place.backend(asking.search.population, asking.lower.precision)?;
        let mut number = 0;
        let legs = way.search(&asking, self.out.as_deref(), &*backend, cancelled, hear, &mut |leg, folder| {
            number += 1;
            let plot = self.plot.as_deref().map(|plot| leg_file(plot, number, way.legs()));
            plot.map_or(Ok(()), |path| motion_plot::write(&leg.plot(&leg.found.best), &path))?;
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
        let lower = self.lower.settings(if self.preset.is_some() { Legs::Free } else { Legs::Limited })?;
        let refine = self.refine_settings()?;
        // Not after a search whose gait would be lost.
        if self.refine {
            refine.validate_for(&lower.transcription)?
        } else {
            refine.validate()?
        }
        Ok(Asking { lower, search: self.search_settings()?, seed: self.seed.unwrap_or(SEED), refines: self.refine, refine })
    }

    fn task(&self, scenario: Option<&Scenario>) -> Result<Task> {
        let goal = GoalSource {
            target: scenario.map(|_| self.target.unwrap_or(TARGET)),
            goal: self.goal.map(GoalArg::goal).or(self.asked.goal),
            yaw: self.yaw.or(self.asked.goal.map(|goal| goal.yaw)),
        };
        let start = match (&self.from, self.start) {
            (Some(path), _) => Start::after(path.clone()),
            (None, Some(place)) => Start::at(place.goal().yaw(self.start_yaw.unwrap_or(0.))),
            (None, None) => self.asked.start.clone().unwrap_or_default().turned(self.start_yaw)?,
        };
        self.world.over(&self.asked)?.task(scenario, &start, goal)
    }

    fn refine_settings(&self) -> Result<RefineSettings> {
        let sets = self.lower.set.iter().filter_map(|s| s.strip_prefix("refine."));
        let settings = merge(RefineSettings::default(), &self.asked.settings_of("refine")?, "settings.refine")?;
        apply(settings, "refine.", sets)
    }

    /// The preset, with what the file's keys say on top, then its tables, flags, and `--set`.
    fn search_settings(&self) -> Result<SearchSettings> {
        let preset = self.preset.as_deref().map_or_else(|| Ok(SearchSettings::default()), SearchSettings::preset)?;
        let settings = merge(self.asked.search().over(preset)?, &self.asked.settings_of("search")?, "settings.search")?;
        let settings = self.search.over(settings)?;
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
        text += &format!("{fallback}\n");
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
type Teller = Box<dyn FnMut(&SearchEvent) + Send>;

/// Seconds between two lines of a search that nobody watches.
const TELL: f64 = 10.;

/// The line of a generation now and then, for logs.
fn tell_now_and_then() -> impl FnMut(&SearchEvent) + Send {
    let mut told = Instant::now();
    move |progress| {
        let SearchEvent::Generation(g) = progress else { return };
        if told.elapsed().as_secs_f64() >= TELL {
            told = Instant::now();
            let fewest = g.lowest_n_violated.map_or("-".into(), |n| n.to_string());
            let counts = format!("{} evaluated, {} feasible, fewest violations {fewest}", g.evaluated, g.feasible);
            info!("generation {}: {counts}", g.generation);
        }
    }
}

/// A line that says how far the search is and what is the best so far, for those who watch.
fn bar() -> impl FnMut(&SearchEvent) + Send {
    let bar = ProgressBar::new_spinner().with_finish(ProgressFinish::AndClear);
    bar.enable_steady_tick(Duration::from_millis(120));
    let (mut evaluated, mut feasible, mut best) = (0, 0, String::from("no gait yet"));
    move |progress| {
        match progress {
            SearchEvent::Generation(g) => (evaluated, feasible) = (evaluated + g.evaluated, feasible + g.feasible),
            SearchEvent::Improvement(i) => {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::scenario_file::table_of;
    use crate::gait::family::GaitFamily;
    use crate::search::Gaits;
    use crate::search::cem::{Objective, Sampler};
    use crate::settings::{SolverSettings, Transcription, TranscriptionSettings};
    use clap::Parser;

    #[derive(Parser)]
    struct Flags {
        #[command(flatten)]
        solve: Solve,
    }

    /// What is asked by flags over a file with every setting in its tables, as a run writes it.
    fn over(flags: &str) -> Solve {
        let tables = [
            ("search", table_of(&SearchSettings::default())),
            ("transcription", table_of(&TranscriptionSettings::default())),
            ("solver", table_of(&SolverSettings::default())),
        ];
        let file = ScenarioFile {
            scenario: Some("s1".into()),
            target: Some(3),
            goal: Some(Goal::at(1., 0.)),
            waypoints: vec![Goal::at(0.5, 0.)],
            time: Some(50.),
            gait: Some("walk".into()),
            population: Some(5),
            settings: tables.into_iter().map(|(name, table)| (name.into(), toml::Value::Table(table.unwrap()))).collect(),
            ..ScenarioFile::default()
        };
        let words = std::iter::once("solve").chain(flags.split_whitespace());
        Flags::parse_from(words).solve.over(file).unwrap()
    }

    #[test]
    fn flags_are_stronger_than_the_tables_of_a_file_and_these_than_its_keys() {
        let asked = over("").asking().unwrap();
        assert_eq!((&asked.search.gaits, asked.search.population, asked.lower.solver), (&Gaits::All, 16, SolverSettings::default()));

        let flags = "--gait trot --population 64 --generations 9 --objective time --time 7 --first --alternatives 3 --random --smooth \
                     --transcription towr --precision f64 --set search.elites=2";
        let asked = over(flags).asking().unwrap();
        let search = &asked.search;
        assert_eq!(search.gaits, Gaits::Families(vec![GaitFamily::Trot]));
        assert_eq!((search.population, search.elites, search.generations, search.alternatives), (64, 2, 9, 3));
        assert_eq!((search.objective, search.first, search.seconds), (Objective::Time, true, Some(7.)));
        assert_eq!(search.free.sampler, Sampler::Random);
        assert_eq!(asked.lower.transcription.rows, Transcription::Towr);
        assert_eq!((asked.lower.solver.smooth.iterations, asked.lower.precision), (20, crate::backend::Precision::F64));

        let asked = over("--preset experiment3 --population 8").asking().unwrap();
        assert_eq!((asked.search.gaits, asked.search.population, asked.search.elites), (Gaits::Free, 8, 4));
        assert_eq!((asked.search.objective, asked.lower.transcription.legs), (Objective::FewestStances, Legs::Free));
    }

    #[test]
    fn another_goal_or_scenario_is_one_without_those_of_the_file() {
        let task = |flags: &str| {
            let way = over(flags).way().unwrap();
            (way.named, way.places.len(), way.task.goal.position[0], way.task.robot.name.clone())
        };
        let s1 = |target: usize| Scenario::named("s1").unwrap().task(target).unwrap().goal.position[0];
        assert_eq!(task(""), ((Some("s1"), None), 1, 1., "anymal".into()));
        assert_eq!(task("--goal 2,0"), ((Some("s1"), None), 0, 2., "anymal".into()));
        assert_eq!(task("--target 4"), ((Some("s1"), Some(4)), 0, s1(4), "anymal".into()));
        assert_eq!(task("--scenario s1"), ((Some("s1"), None), 1, 1., "anymal".into()));
        let [x, _] = Scenario::goal(TARGET).unwrap();
        assert_eq!(task("--scenario biped"), ((Some("biped"), Some(TARGET)), 0, x, "biped".into()));
    }
}
