//! `evaluate`: solve given schedules.

use super::args::{GoalSource, LowerArgs, World, WorldArgs, workers};
use super::label::label;
use super::{CANCELLED, Failure, Verdict, complain, print};
use crate::backend::Backend;
use crate::error::{Error, Result, from_json};
use crate::gait::cost::CostWeights;
use crate::gait::{Schedule, Trajectory};
use crate::reference::ipopt::Options;
use crate::reference::job::{Answer, Job};
use crate::reference::workers::Workers;
use crate::report::result::SolvedOn;
use crate::report::{EvaluateResult, IpoptResult, files};
use crate::scenario::Scenario;
use crate::search::evaluate::{Evaluated, LowerSettings, check_candidate, evaluate};
use crate::settings::Legs;
use crate::task::Task;
use clap::{Args, ValueEnum};
use serde::Deserialize;
use serde_json::{Map, Value};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Candidates solved at once; bounds memory for long files.
const CHUNK: usize = 8192;

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
    base_target: Option<[f64; 3]>,
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

/// Who solves the lines.
enum Solver {
    Own(Box<dyn Backend>, Box<LowerSettings>),
    Ipopt(Workers),
}

impl Solver {
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
        if let Some(set) = self.lower.set.iter().find(|s| s.starts_with("search.")) {
            return Err(Error::invalid("--set", set, "a setting of transcription, solver or precision: nothing is searched here").into());
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
            SolverArg::Own => Solver::Own(self.lower.backend(items.len())?, Box::new(settings)),
            SolverArg::Ipopt => Solver::Ipopt(workers(self.lower.place.threads)?),
        };
        let start = Instant::now();
        let (mut results, mut trajectories) = (String::new(), String::new());
        let (mut feasible, mut evaluated_lines, mut iterations) = (0, 0, 0);
        for chunk in items.chunks(CHUNK) {
            let answers = solver.solve(chunk, self.trajectories.is_some())?;
            for (item, done) in chunk.iter().zip(answers) {
                let Some(done) = done else { break };
                evaluated_lines += 1;
                feasible += usize::from(done.feasible);
                iterations += done.iterations;
                let mut object = item.object.clone();
                object.insert("result".into(), done.result);
                results += &(Value::Object(object).to_string() + "\n");
                if let Some(trajectory) = done.trajectory {
                    let number = |key: &str| item.object.get(key).and_then(Value::as_u64);
                    let target = number("target").map(|t| t as usize);
                    let trajectory = label(trajectory, &item.task, item.scenario.as_deref(), target, number("seed"));
                    trajectories += &(serde_json::to_string(&trajectory).map_err(Error::from)? + "\n");
                }
            }
            if CANCELLED.load(Ordering::Relaxed) {
                break;
            }
        }
        if evaluated_lines < items.len() {
            complain(&format!("stopped: {evaluated_lines} of {} lines evaluated", items.len()));
        }
        let seconds = start.elapsed().as_secs_f64();
        if let Some(path) = &self.out {
            files::write(path, &results)?;
        }
        if let Some(path) = &self.trajectories {
            files::write(path, &trajectories)?;
        }
        if self.json {
            print(&results)?;
        } else {
            let rate = evaluated_lines as f64 / seconds.max(1e-9);
            print(&format!(
                "{feasible} of {evaluated_lines} candidates feasible, {iterations} iterations, {seconds:.3} s, {rate:.1} candidates/s ({})\n",
                solver.device()
            ))?;
        }
        match failure {
            Some(error) => Err(Failure::Input(error)),
            None if feasible > 0 => Ok(Verdict::Feasible),
            None => Ok(Verdict::Infeasible),
        }
    }

    fn item(&self, line: &str, world: &World) -> Result<Item> {
        let object: Map<String, Value> = from_json(line)?;
        let parsed: Line = from_json(line)?;
        let schedule = Schedule::new(parsed.durations)?;
        let scenario = parsed.scenario.or_else(|| self.scenario.clone());
        let named = scenario.as_deref().map(Scenario::named).transpose()?;
        let goal = GoalSource { target: parsed.target, base_target: parsed.base_target, xy: None, yaw: parsed.yaw_target };
        Ok(Item { object, scenario, task: world.task(named.as_ref(), goal)?, schedule })
    }
}
