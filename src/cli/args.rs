//! Arguments that several commands share.

use crate::app::options::{LowerOptions, SearchOptions};
use crate::app::world::{World, WorldNames};
use crate::app::{Ends, TermOverrides};
use crate::backend::choose::check_threads;
use crate::backend::{Backend, DeviceChoice, Precision};
use crate::error::{Error, Result};
use crate::reference::ipopt;
use crate::reference::workers::Workers;
use crate::search::cem::objective::OBJECTIVES;
use crate::settings::Transcription;
use crate::task::Goal;
use clap::Args;
use clap::builder::PossibleValuesParser;

/// Robot and ground.
#[derive(Debug, Clone, Default, Args)]
pub struct WorldArgs {
    /// Robot: a name from `list`, or a JSON or TOML file [default: the scenario's]. `SCENARIO=NAME|FILE` sets it for one scenario only
    #[arg(long, value_name = "NAME|FILE")]
    robot: Vec<String>,
    /// Terrain: a name from `list`, a JSON or TOML file, a mesh (.obj, .ply) or a grid map (.mcap) [default: the scenario's].
    /// `SCENARIO=NAME|FILE` sets it for one scenario only
    #[arg(long, value_name = "NAME|FILE")]
    terrain: Vec<String>,
    /// Largest normal force of a foot, N [default: by the robot; 1000 with the rows of TOWR]
    #[arg(long, value_name = "N")]
    force_limit: Option<f64>,
}

impl WorldArgs {
    /// Names and files as given.
    pub fn names(self) -> WorldNames {
        WorldNames { robots: self.robot, terrains: self.terrain, force_limit: self.force_limit }
    }

    /// Reads robots and terrains.
    ///
    /// # Errors
    /// Errors of [`WorldNames::read`].
    pub fn read(&self) -> Result<World> {
        self.clone().names().read()
    }

    /// Reads robots and terrains, and checks the force limit.
    ///
    /// # Errors
    /// Errors of [`WorldArgs::read`] and [`World::check_force_limit`].
    pub fn read_checked(&self) -> Result<World> {
        let world = self.read()?;
        world.check_force_limit()?;
        Ok(world)
    }
}

/// Upper level of a search.
#[derive(Debug, Clone, Default, Args)]
pub struct SearchArgs {
    /// Gaits to search: all families that the robot can have but the pace, some of them, any contact schedule (`free`, as in the paper), or the
    /// neighbourhood of the `durations` in a JSON file [default: all]
    #[arg(long, value_name = "all|FAMILY,...|free|FILE")]
    gait: Option<String>,
    /// Candidates per generation; elites keep their share [default: 16]
    #[arg(long)]
    population: Option<usize>,
    /// Largest number of generations after the typical gaits of the families [default: 3]
    #[arg(long)]
    generations: Option<usize>,
    /// Objective by which gaits are ranked [default: transport]
    #[arg(long, value_parser = PossibleValuesParser::new(OBJECTIVES.map(|(name, _)| name)))]
    objective: Option<String>,
    /// End each search after this time with the best gait so far, s. Results then depend on the machine. Each stage has this time, and
    /// `--refine` takes more
    #[arg(long, value_name = "SECONDS")]
    time: Option<f64>,
    /// End with the first gait
    #[arg(long)]
    first: bool,
    /// Number of gaits to return: the best, and the best of other families [default: 1]
    #[arg(long, value_name = "K")]
    alternatives: Option<usize>,
    /// Plain random sampling: never update the distribution, nor search around the best gait
    #[arg(long)]
    random: bool,
}

impl SearchArgs {
    /// Options of the upper level.
    pub fn options(self) -> SearchOptions {
        let SearchArgs { gait, population, generations, objective, time, first, alternatives, random } = self;
        SearchOptions { gait, population, generations, objective, time, first, alternatives, random }
    }
}

/// Device.
#[derive(Debug, Clone, Default, Args)]
pub struct DeviceArgs {
    /// Device: `auto` uses a GPU for batch sizes at which it measured faster than the CPU; `gpu:NAME` is an adapter from `devices`
    /// [default: auto]
    #[arg(long, value_name = "auto|cpu|gpu[:NAME]")]
    pub device: Option<DeviceChoice>,
    /// Threads of the CPU; 0: one per processor. Results do not depend on it [default: 0]
    #[arg(long)]
    pub threads: Option<usize>,
}

impl DeviceArgs {
    /// Opens the device for batches of a size.
    ///
    /// # Errors
    /// Errors of [`DeviceChoice::open`].
    pub fn backend(&self, batch: usize, precision: Precision) -> Result<Box<dyn Backend>> {
        self.device.clone().unwrap_or_default().open(batch, self.threads.unwrap_or(0), precision)
    }
}

/// Lower level of a search.
#[derive(Debug, Clone, Default, Args)]
pub struct LowerArgs {
    /// Rows that a motion must satisfy [default: momentum]
    #[arg(long, value_enum)]
    transcription: Option<Transcription>,
    /// Smooth forces and base motion after each solve: gentler motions, a third slower
    #[arg(long)]
    smooth: bool,
    /// Scalar of the solver [default: f32]
    #[arg(long, value_enum)]
    precision: Option<Precision>,
    #[command(flatten)]
    pub place: DeviceArgs,
    /// Any setting by its path, e.g. `solver.max_iterations=100`; scenario.toml of a run lists all of them
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

impl LowerArgs {
    /// Options of the lower level.
    pub fn options(&self) -> LowerOptions {
        let LowerArgs { transcription, smooth, precision, set, .. } = self.clone();
        LowerOptions { transcription, smooth, precision, set }
    }
}

/// Terms of a verification that replace those of the file.
#[derive(Debug, Default, Args)]
pub struct TermArgs {
    /// Verify against this goal instead of the file's, m; without Z, at the height that `solve` would choose
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true, conflicts_with = "scenario")]
    goal: Option<GoalArg>,
    /// Final yaw of that goal, rad [default: 0]
    #[arg(long, allow_hyphen_values = true, requires = "goal")]
    yaw: Option<f64>,
    /// Verify against a start at rest here, m [default with --goal: above the origin]
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true, requires = "goal")]
    start: Option<GoalArg>,
    /// Yaw at that start, rad [default: 0]
    #[arg(long, allow_hyphen_values = true, requires = "start")]
    start_yaw: Option<f64>,
    /// Verify against start and goal of this scenario
    #[arg(long, requires = "target")]
    scenario: Option<String>,
    /// Target of that scenario, 1 to 20
    #[arg(long, requires = "scenario")]
    target: Option<usize>,
    /// Verify against the limits that `solve` has by default for the robot, whatever the file states
    #[arg(long)]
    default_limits: bool,
}

impl TermArgs {
    /// Terms that replace those of a file.
    pub fn overrides(&self) -> TermOverrides {
        let ends = match (&self.scenario, self.goal) {
            (Some(name), _) => Some(Ends::Scenario { name: name.clone(), target: self.target }),
            (None, Some(goal)) => {
                let start = self.start.map_or(Goal::at(0., 0.), GoalArg::goal).yaw(self.start_yaw.unwrap_or(0.));
                Some(Ends::Between(Box::new([start, goal.goal().yaw(self.yaw.unwrap_or(0.))])))
            }
            (None, None) => None,
        };
        TermOverrides { ends, default_limits: self.default_limits }
    }
}

/// Processes of this program that solve with Ipopt.
///
/// # Errors
/// Without Ipopt, and for too many threads.
pub fn workers(threads: usize) -> Result<Workers> {
    ipopt::check()?;
    let program = std::env::current_exe().map_err(|source| Error::Io { action: "find", path: "this program".into(), source })?;
    Ok(Workers::new(program, check_threads(threads)?))
}

/// Place on the command line: `X,Y` or `X,Y,Z`, m.
#[derive(Debug, Clone, Copy)]
pub struct GoalArg {
    xy: [f64; 2],
    /// Height, if given.
    z: Option<f64>,
}

impl GoalArg {
    /// Goal at rest with yaw 0.
    pub fn goal(self) -> Goal {
        let [x, y] = self.xy;
        Goal { z: self.z, ..Goal::at(x, y) }
    }
}

impl std::str::FromStr for GoalArg {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let numbers: std::result::Result<Vec<f64>, _> = text.split(',').map(|v| v.trim().parse::<f64>()).collect();
        match numbers.as_deref() {
            Ok(numbers) if numbers.iter().any(|v| !v.is_finite()) => Err("expected finite numbers".into()),
            Ok(&[x, y]) => Ok(GoalArg { xy: [x, y], z: None }),
            Ok(&[x, y, z]) => Ok(GoalArg { xy: [x, y], z: Some(z) }),
            _ => Err("expected X,Y or X,Y,Z in metres".into()),
        }
    }
}

/// Place on the command line with its time of arrival: `X,Y`, `X,Y,Z`, `X,Y@T` or `X,Y,Z@T`, m and s.
#[derive(Debug, Clone, Copy)]
pub struct TimedGoalArg {
    place: GoalArg,
    /// Time of arrival, if given, s.
    time: Option<f64>,
}

impl TimedGoalArg {
    /// Goal at rest with yaw 0.
    pub fn goal(self) -> Goal {
        Goal { time: self.time, ..self.place.goal() }
    }
}

impl std::str::FromStr for TimedGoalArg {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (place, time) = text.split_once('@').map_or((text, None), |(place, time)| (place, Some(time)));
        let seconds = |time: &str| time.trim().parse::<f64>().ok().filter(|time| time.is_finite());
        let time = time.map(|time| seconds(time).ok_or("expected a time in seconds after @")).transpose()?;
        Ok(TimedGoalArg { place: place.parse()?, time })
    }
}
