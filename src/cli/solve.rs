//! `solve`: searches for a gait.

use super::args::{GoalArg, LowerArgs, SearchArgs, TimedGoalArg, WorldArgs};
use super::{CANCELLED, Failure, Verdict, print, to_json};
use crate::app::save::stage_file;
use crate::app::scenario_file::{ScenarioFile, Start};
use crate::app::summary::text;
use crate::app::{Overrides, ProgressEvent, Setup, Waypoint};
use crate::report::motion_plot;
use crate::search::SearchEvent;
use clap::Args;
use indicatif::{ProgressBar, ProgressFinish};
use std::io::IsTerminal;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use tracing::{Level, enabled, info, warn};

#[derive(Debug, Clone, Default, Args)]
pub struct Solve {
    /// Scenario file (.toml). Options override it; `init` writes one with every key explained
    #[arg(value_name = "SCENARIO.toml")]
    file: Option<PathBuf>,
    /// Built-in scenario from `list`
    #[arg(long)]
    scenario: Option<String>,
    /// Target of the scenario, 1 to 20 [default: 10]
    #[arg(long)]
    target: Option<usize>,
    /// Goal instead of a target, m. Without Z, the base ends at its `base_height` above the ground, or at a height from which all feet
    /// reach it. With T, it arrives at this time, s
    #[arg(long, value_name = "X,Y[,Z][@T]", allow_hyphen_values = true)]
    goal: Option<TimedGoalArg>,
    /// Waypoint at which the base stops, m, and its time from the start of the mission, s; repeatable. Each stage of the mission has a folder
    /// of its own: stage-1, stage-2, ...
    #[arg(long, value_name = "X,Y[,Z][@T]", allow_hyphen_values = true)]
    via: Vec<TimedGoalArg>,
    /// Start, m, with the feet at their nominal places on the ground [default: above the origin]
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true, conflicts_with = "from")]
    start: Option<GoalArg>,
    /// Yaw at the start, rad [default: 0]
    #[arg(long, allow_hyphen_values = true, conflicts_with = "from")]
    start_yaw: Option<f64>,
    /// Start where the motion of a trajectory file ends, with its base and feet
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,
    /// Final yaw, rad [default: the scenario's, or 0]
    #[arg(long, allow_hyphen_values = true)]
    yaw: Option<f64>,
    #[command(flatten)]
    world: WorldArgs,
    /// Seed of the search [default: 1]
    #[arg(long)]
    seed: Option<u64>,
    /// Search of the paper, from `list`: any contact schedule, unlimited legs
    #[arg(long)]
    preset: Option<String>,
    #[command(flatten)]
    search: SearchArgs,
    /// Refine the best gait, with its phase durations, to a local optimum of its cost
    #[arg(long)]
    refine: bool,
    #[command(flatten)]
    lower: LowerArgs,
    /// Folder for result.json, trajectory.json and scenario.toml; alternatives are trajectory-2.json, ...
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Draw the gait, its forces and its path: .svg, or .png with the feature `pictures`; with waypoints FILE-stage-1, FILE-stage-2, ...
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Print result.json instead of text
    #[arg(long)]
    json: bool,
}

impl Solve {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let setup = match &self.file {
            None => Setup::new(ScenarioFile::default(), self.overrides())?,
            Some(path) => Setup::new(ScenarioFile::read(path)?, self.overrides()).map_err(|e| e.in_file(path, None))?,
        };
        let (request, mission) = (setup.request()?, setup.mission()?);
        self.plot.as_deref().map_or(Ok(()), motion_plot::check)?;
        let backend = setup.backend(request.search.population, request.lower.precision)?;
        let whole = mission.stages();
        let mut display = Display::new();
        let mut number = 0;
        let stages = mission.search_with(
            &request,
            &*backend,
            setup.out().as_deref(),
            &CANCELLED,
            &mut |event| display.show(event),
            &mut |stage, folder| {
                number += 1;
                let plot = self.plot.as_deref().map(|plot| stage_file(plot, number, whole));
                plot.map_or(Ok(()), |path| motion_plot::write(&stage.plot(&stage.found.best), &path))?;
                let result = stage.result();
                print(&if self.json { to_json(&result)? } else { text(&result, folder)? })
            },
        )?;
        let feasible = stages.iter().all(|stage| stage.found.best.feasible());
        if stages.len() < whole {
            let why = if feasible { "has a gait, but the run was cancelled" } else { "has no gait" };
            warn!("stage {} of {whole} {why}; later stages were not searched", stages.len());
        }
        Ok(if feasible && stages.len() == whole { Verdict::Feasible } else { Verdict::Infeasible })
    }

    /// Values of the command line, which override the scenario file.
    fn overrides(&self) -> Overrides {
        let start = match (&self.from, self.start) {
            (Some(path), _) => Some(Start::after(path.clone())),
            (None, start) => start.map(|place| Start::at(place.goal())),
        };
        Overrides {
            scenario: self.scenario.clone(),
            target: self.target,
            goal: self.goal.map(TimedGoalArg::goal),
            yaw: self.yaw,
            start,
            start_yaw: self.start_yaw,
            waypoints: self.via.iter().map(|via| Waypoint { goal: via.goal(), turns_evenly: true }).collect(),
            world: self.world.clone().names(),
            seed: self.seed,
            preset: self.preset.clone(),
            search: self.search.clone().options(),
            refine: self.refine,
            lower: self.lower.options(),
            device: self.lower.place.device.clone(),
            threads: self.lower.place.threads,
            out: self.out.clone(),
        }
    }
}

/// Display of progress on stderr.
struct Display {
    /// True if stderr is a terminal that shows information.
    watched: bool,
    reporter: Option<Reporter>,
}

/// Function that reports how far a search is.
type Reporter = Box<dyn FnMut(&SearchEvent) + Send>;

impl Display {
    fn new() -> Display {
        Display { watched: std::io::stderr().is_terminal() && enabled!(Level::INFO), reporter: None }
    }

    fn show(&mut self, event: ProgressEvent) {
        match event {
            ProgressEvent::Warning(finding) => warn!("warning: {finding}"),
            ProgressEvent::Started => self.reporter = Some(if self.watched { Box::new(bar()) } else { Box::new(log_lines()) }),
            ProgressEvent::Progress(progress) => self.reporter.as_mut().map_or((), |report| report(progress)),
            ProgressEvent::Ended => self.reporter = None,
        }
    }
}

/// Seconds between two log lines of a search.
const LOG_INTERVAL: f64 = 10.;

/// Log line of a generation, at most one per [`LOG_INTERVAL`].
fn log_lines() -> impl FnMut(&SearchEvent) + Send {
    let mut last = Instant::now();
    move |progress| {
        if last.elapsed().as_secs_f64() < LOG_INTERVAL {
            return;
        }
        match progress {
            SearchEvent::Generation(g) => {
                let fewest = g.lowest_n_violated.map_or("-".into(), |n| n.to_string());
                let counts = format!("{} evaluated, {} feasible, fewest violations {fewest}", g.evaluated, g.feasible);
                info!("generation {}: {counts}", g.generation);
            }
            SearchEvent::LowerGround(ground) => {
                info!("a gait on {:.1} % of the relief, {} candidates", 100. * ground.share, ground.candidates)
            }
            SearchEvent::Improvement(_) => return,
        }
        last = Instant::now();
    }
}

/// Line on a terminal with the number of candidates and the best gait so far.
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
            SearchEvent::LowerGround(ground) => best = format!("a gait on {:.0} % of the relief", 100. * ground.share),
        }
        bar.set_message(format!("{evaluated} candidates, {feasible} gaits, {best}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::Setup;
    use crate::backend::{DeviceChoice, Precision};
    use crate::search::Gaits;
    use crate::search::cem::Objective;
    use clap::Parser;

    #[derive(Parser)]
    struct Flags {
        #[command(flatten)]
        solve: Solve,
    }

    #[test]
    fn options_of_the_command_line_reach_mission_and_request() {
        let flags = "solve --robot anymal --goal 2,0.5 --yaw 0.3 --via 1,0 --start 0.1,0 --start-yaw -0.2 --seed 7 --gait free --objective time \
                     --precision f64 --device cpu --threads 2 --set solver.max_iterations=150 --out out";
        let overrides = Flags::parse_from(flags.split_whitespace()).solve.overrides();
        assert_eq!((&overrides.device, overrides.threads, &overrides.out), (&Some(DeviceChoice::Cpu), Some(2), &Some("out".into())));
        let setup = Setup::new(ScenarioFile::default(), overrides).unwrap();
        let (mission, request) = (setup.mission().unwrap(), setup.request().unwrap());
        assert_eq!((mission.stages(), mission.task.goal.position[1], mission.task.goal.yaw()), (2, 0.5, 0.3));
        assert_eq!((mission.task.start.position[0], mission.task.start.yaw()), (0.1, -0.2));
        assert_eq!((request.seed, &request.search.gaits, request.search.objective), (7, &Gaits::Free, Objective::Time));
        assert_eq!((request.lower.precision, request.lower.solver.max_iterations), (Precision::F64, 150));
    }
}
