//! `evaluate`: solve given schedules.

use super::args::{GoalSource, LowerArgs, World, WorldArgs, workers};
use super::label::label;
use super::scenario_file::Start;
use super::{CANCELLED, Failure, Verdict, print};
use crate::backend::Backend;
use crate::error::{Error, Result, from_json};
use crate::gait::cost::CostWeights;
use crate::gait::{Schedule, Trajectory};
use crate::reference::ipopt::Options;
use crate::reference::job::{Answer, Job};
use crate::reference::workers::Workers;
use crate::report::files::{self, Growing};
use crate::report::result::SolvedOn;
use crate::report::{EvaluateResult, IpoptResult};
use crate::scenario::Scenario;
use crate::search::evaluate::{Evaluated, LowerSettings, check_candidate, evaluate};
use crate::settings::Legs;
use crate::task::{Goal, Task};
use clap::{Args, ValueEnum};
use serde::Deserialize;
use serde_json::{Map, Value};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Instant;
use tracing::info;

/// Time between two lines on how far it is, s.
const TELL: f64 = 10.;

#[derive(Debug, Args)]
pub struct Evaluate {
    /// Schedules: JSON lines with `durations` per foot, and optionally `scenario`, `base_target`, `yaw_target`
    schedules: PathBuf,
    /// Results: the same lines with `result`
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Trajectories, one a line, feasible or not
    #[arg(long, value_name = "FILE")]
    trajectories: Option<PathBuf>,
    /// Scenario for lines that name none
    #[arg(long)]
    scenario: Option<String>,
    #[command(flatten)]
    world: WorldArgs,
    #[command(flatten)]
    lower: LowerArgs,
    /// Who solves: this program, or Ipopt as in the paper, on TOWR's whole program (feature `ipopt`; rows are TOWR's)
    #[arg(long, value_enum, default_value = "own")]
    solver: SolverArg,
    /// Print the result lines instead of a summary
    #[arg(long)]
    json: bool,
}

/// `--solver`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SolverArg {
    Own,
    Ipopt,
}

/// What is read of a line; other keys are copied.
#[derive(Deserialize)]
struct Line {
    durations: Vec<Vec<f64>>,
    scenario: Option<String>,
    target: Option<usize>,
    base_target: Option<Vec<f64>>,
    yaw_target: Option<f64>,
}

/// A line that can be solved.
struct Item {
    object: Map<String, Value>,
    scenario: Option<String>,
    task: Task,
    schedule: Schedule,
}

/// One line's answer.
struct Answered {
    feasible: bool,
    iterations: usize,
    /// For the key `result`.
    result: Value,
    /// When trajectories are wanted.
    trajectory: Option<Trajectory>,
}

/// What has been solved so far.
#[derive(Debug, Default)]
struct Tally {
    lines: usize,
    feasible: usize,
    iterations: usize,
}

impl Tally {
    fn add(&mut self, feasible: bool, iterations: usize) {
        self.lines += 1;
        self.feasible += usize::from(feasible);
        self.iterations += iterations;
    }

    /// A line of an earlier run.
    fn add_line(&mut self, line: &str) -> Result<()> {
        let object: Value = from_json(line)?;
        let result = &object["result"];
        self.add(result["feasible"] == true, result["iterations"].as_u64().unwrap_or(0) as usize);
        Ok(())
    }
}

/// Who solves the lines.
enum Solver {
    Own(Box<dyn Backend>, Box<LowerSettings>),
    Ipopt(Workers),
}

impl Solver {
    /// Lines solved at once: what an end in the middle loses.
    fn chunk(&self) -> usize {
        match self {
            Solver::Own(backend, _) => backend.batch(),
            Solver::Ipopt(workers) => 16 * workers.count,
        }
    }

    /// For results.
    fn device(&self) -> String {
        match self {
            Solver::Own(backend, settings) => SolvedOn::new(&**backend, settings.precision).device,
            Solver::Ipopt(workers) => workers.device(),
        }
    }

    /// In the order of the items; none where the user ended it.
    fn solve(&self, items: &[Item], trajectories: bool) -> Result<Vec<Option<Answered>>> {
        match self {
            Solver::Own(backend, settings) => {
                let candidates: Vec<(&Task, &Schedule)> = items.iter().map(|i| (&i.task, &i.schedule)).collect();
                let cancelled = || CANCELLED.load(Ordering::Relaxed);
                let evaluated = evaluate(&candidates, settings, Some(&CostWeights::default()), &**backend, false, &cancelled)?;
                let solved_on = SolvedOn::new(&**backend, settings.precision);
                let done = |(item, evaluated): (&Item, Option<Evaluated>)| {
                    let Some(evaluated) = evaluated else { return Ok(None) };
                    Ok(Some(Answered {
                        feasible: evaluated.feasible,
                        iterations: evaluated.outcome.iterations,
                        result: serde_json::to_value(EvaluateResult::new(&evaluated, &solved_on))?,
                        trajectory: trajectories.then(|| evaluated.trajectory(&item.task, &settings.transcription)),
                    }))
                };
                items.iter().zip(evaluated).map(done).collect()
            }
            Solver::Ipopt(workers) => {
                let jobs: Vec<Job> = items.iter().map(|item| Job::fixed(&item.task, &item.schedule, Options::LOWER_LEVEL)).collect();
                let done = |answer: Answer| {
                    Ok(Answered {
                        feasible: answer.feasible,
                        iterations: answer.statistics.iterations,
                        result: serde_json::to_value(IpoptResult::new(&answer, &self.device()))?,
                        trajectory: trajectories.then_some(answer.trajectory),
                    })
                };
                workers.answers(&jobs, &CANCELLED)?.into_iter().map(|answer| answer.map(done).transpose()).collect()
            }
        }
    }
}

impl Evaluate {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let settings = self.lower.settings(Legs::Limited)?;
        let world = self.world.read()?;
        // A wrong flag is a usage error, not one of the file.
        self.scenario.as_deref().map(Scenario::named).transpose()?;
        if let Some(set) = self.lower.set.iter().find(|s| s.starts_with("search.") || s.starts_with("refine.")) {
            let limit = "a setting of transcription, solver or precision: nothing is searched or refined here";
            return Err(Error::invalid("--set", set, limit).into());
        }
        if self.out.is_some() && self.out == self.trajectories {
            return Err(Error::invalid("--trajectories", "the file of --out", "another file").into());
        }
        let text = files::read(&self.schedules)?;
        for path in [&self.out, &self.trajectories].into_iter().flatten() {
            files::check_writable(path)?;
        }
        // Lines before a bad one keep their results.
        let mut failure = None;
        let mut items = Vec::new();
        for (number, line) in files::lines(&text) {
            match self.item(line, &world).and_then(|item| check_candidate(&item.task, &item.schedule, &settings).map(|()| item)) {
                Ok(item) => items.push(item),
                Err(e) => {
                    failure = Some(e.in_file(&self.schedules, Some(number)));
                    break;
                }
            }
        }
        if items.is_empty() && failure.is_none() {
            failure = Some(Error::invalid("schedules", "none", "at least one line").in_file(&self.schedules, None));
        }

        let solver = match self.solver {
            SolverArg::Own => Solver::Own(self.lower.place.backend(items.len(), settings.precision)?, Box::new(settings.clone())),
            SolverArg::Ipopt => Solver::Ipopt(workers(self.lower.place.threads.unwrap_or(0))?),
        };
        let start = Instant::now();
        let mut content = DefaultHasher::new();
        (&text, format!("{world:?}")).hash(&mut content);
        let stamp = serde_json::to_string(&self.stamp(&settings, &solver, content.finish())).map_err(Error::from)?;
        let open = |path: &Option<PathBuf>| path.as_deref().map(|path| Growing::open(path, &stamp)).transpose();
        let (mut out, mut trajectories) = (open(&self.out)?, open(&self.trajectories)?);
        // Results alone say what came of the lines.
        let fewest = [&out, &trajectories].into_iter().flatten().map(Growing::count).min();
        let done_before = fewest.filter(|_| out.is_some()).map_or(0, |count| count.min(items.len()));
        for file in [&mut out, &mut trajectories].into_iter().flatten() {
            file.keep(done_before)?;
        }
        let mut tally = Tally::default();
        let mut printed = String::new();
        if let Some(out) = &out {
            out.text().lines().try_for_each(|line| tally.add_line(line))?;
        }
        if done_before > 0 {
            info!("{done_before} of {} lines are done already", items.len());
        }
        let mut told = Instant::now();
        for chunk in items[done_before..].chunks(solver.chunk()) {
            let answers = solver.solve(chunk, self.trajectories.is_some())?;
            let (mut lines, mut motions) = (String::new(), String::new());
            for (item, done) in chunk.iter().zip(answers) {
                let Some(done) = done else { break };
                tally.add(done.feasible, done.iterations);
                let mut object = item.object.clone();
                object.insert("result".into(), done.result);
                lines += &(Value::Object(object).to_string() + "\n");
                if let Some(trajectory) = done.trajectory {
                    let number = |key: &str| item.object.get(key).and_then(Value::as_u64);
                    let target = number("target").map(|t| t as usize);
                    let trajectory = label(trajectory, &item.task, item.scenario.as_deref(), target, number("seed"));
                    motions += &(serde_json::to_string(&trajectory).map_err(Error::from)? + "\n");
                }
            }
            for (file, lines) in [(&mut out, &lines), (&mut trajectories, &motions)] {
                file.as_mut().map_or(Ok(()), |file| file.add(lines))?;
            }
            if self.json && out.is_none() {
                printed += &lines;
            }
            if CANCELLED.load(Ordering::Relaxed) {
                break;
            }
            if told.elapsed().as_secs_f64() > TELL && tally.lines < items.len() {
                info!("{} of {} lines, {} feasible", tally.lines, items.len(), tally.feasible);
                told = Instant::now();
            }
        }
        let seconds = start.elapsed().as_secs_f64();
        let whole = tally.lines == items.len();
        if self.json {
            print(out.as_ref().map_or(&printed, Growing::text))?;
        } else {
            let Tally { lines, feasible, iterations } = tally;
            let rate = (lines - done_before) as f64 / seconds.max(1e-9);
            print(&format!(
                "{feasible} of {lines} candidates feasible, {iterations} iterations, {seconds:.3} s, {rate:.1} candidates/s ({})\n",
                solver.device()
            ))?;
        }
        if whole {
            for file in [out, trajectories].into_iter().flatten() {
                file.finish()?;
            }
        }
        if !whole {
            let kept = self
                .out
                .as_ref()
                .map_or(String::new(), |out| format!("; they are in {}.part, and the same command goes on from there", out.display()));
            let message = format!("stopped: {} of {} lines evaluated{kept}", tally.lines, items.len());
            return Err(Failure::Ended(Error::Ended { message }));
        }
        match failure {
            Some(error) => Err(Failure::Input(error)),
            None if tally.feasible > 0 => Ok(Verdict::Feasible),
            None => Ok(Verdict::Infeasible),
        }
    }

    /// What the results depend on.
    ///
    /// * `content` - of the lines, robots and terrains: files may be others by the time of the next run
    fn stamp(&self, settings: &LowerSettings, solver: &Solver, content: u64) -> Value {
        serde_json::json!({
            "version": env!("CARGO_PKG_VERSION"),
            "device": solver.device(),
            "settings": settings,
            "content": content,
            "scenario": self.scenario,
            "trajectories": self.trajectories.is_some(),
        })
    }

    fn item(&self, line: &str, world: &World) -> Result<Item> {
        let object: Map<String, Value> = from_json(line)?;
        let parsed: Line = from_json(line)?;
        let schedule = Schedule::new(parsed.durations)?;
        let scenario = parsed.scenario.or_else(|| self.scenario.clone());
        let named = scenario.as_deref().map(Scenario::named).transpose()?;
        // A goal on the ground has no height of its own.
        let place = match parsed.base_target.as_deref() {
            None => None,
            Some(&[x, y]) => Some(Goal::at(x, y)),
            Some(&[x, y, z]) => Some(Goal::position([x, y, z])),
            Some(other) => return Err(Error::invalid("base_target", format!("{} numbers", other.len()), "2 or 3: x, y, z in m")),
        };
        let goal = GoalSource { target: parsed.target, goal: place, yaw: parsed.yaw_target };
        Ok(Item { object, scenario, task: world.task(named.as_ref(), &Start::default(), goal)?, schedule })
    }
}
