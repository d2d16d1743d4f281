//! `evaluate`: solves given contact schedules.

use super::args::{LowerArgs, WorldArgs, workers};
use super::{CANCELLED, Failure, Verdict, print};
use crate::app::label::{Provenance, label};
use crate::app::scenario_file::{ScenarioFile, Start};
use crate::app::world::{GoalSource, World};
use crate::backend::Backend;
use crate::error::{Error, Result, from_json};
use crate::files::{self, Growing};
use crate::gait::cost::CostWeights;
use crate::gait::{Schedule, Trajectory};
use crate::reference::ipopt::Options;
use crate::reference::job::{Answer, Job};
use crate::reference::workers::Workers;
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

/// Time between two progress lines, s.
const LOG_INTERVAL: f64 = 10.;

#[derive(Debug, Args)]
pub struct Evaluate {
    /// Schedules: JSON lines with `durations` per foot, s, and optionally `scenario`, `target`, `base_target`, `yaw_target`
    schedules: PathBuf,
    /// File for the results: the input lines with `result` added
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// File for the trajectories, one per line, feasible or not
    #[arg(long, value_name = "FILE")]
    trajectories: Option<PathBuf>,
    /// Scenario for lines that do not name one
    #[arg(long)]
    scenario: Option<String>,
    #[command(flatten)]
    world: WorldArgs,
    #[command(flatten)]
    lower: LowerArgs,
    /// Solver: this program's own, or Ipopt as in the paper, on the whole program of TOWR with its rows (feature `ipopt`)
    #[arg(long, value_enum, default_value = "own")]
    solver: SolverArg,
    /// Print the result lines instead of a summary
    #[arg(long)]
    json: bool,
}

/// Value of `--solver`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SolverArg {
    Own,
    Ipopt,
}

/// Keys of a line that are used; other keys are copied.
#[derive(Deserialize)]
struct Line {
    durations: Vec<Vec<f64>>,
    scenario: Option<String>,
    target: Option<usize>,
    base_target: Option<Vec<f64>>,
    yaw_target: Option<f64>,
}

/// Line that can be solved.
struct Item {
    object: Map<String, Value>,
    scenario: Option<&'static str>,
    task: Task,
    schedule: Schedule,
}

/// Answer for one line.
struct Answered {
    feasible: bool,
    iterations: usize,
    /// Value of the key `result`.
    result: Value,
    /// Motion, if trajectories are written.
    trajectory: Option<Trajectory>,
}

/// Counts of the lines solved so far.
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

    /// Counts a line of an earlier run.
    fn add_line(&mut self, line: &str) -> Result<()> {
        let object: Value = from_json(line)?;
        let result = &object["result"];
        self.add(result["feasible"] == true, result["iterations"].as_u64().unwrap_or(0) as usize);
        Ok(())
    }
}

/// Solver of the lines.
enum Solver {
    Own(Box<dyn Backend>, Box<LowerSettings>),
    Ipopt(Workers),
}

impl Solver {
    /// Number of lines solved at once; a cancellation loses at most as many.
    fn chunk(&self) -> usize {
        match self {
            Solver::Own(backend, _) => backend.batch(),
            Solver::Ipopt(workers) => 16 * workers.count,
        }
    }

    /// Name of the device, for results.
    fn device(&self) -> String {
        match self {
            Solver::Own(backend, settings) => SolvedOn::new(&**backend, settings.precision).device,
            Solver::Ipopt(workers) => workers.device(),
        }
    }

    /// Answers in the order of the items; `None` for those that a cancellation left unsolved.
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
        let settings = self.lower.options().settings(&ScenarioFile::default(), Legs::Limited)?;
        let world = self.world.read()?;
        self.check_flags()?;
        let text = files::read(&self.schedules)?;
        for path in [&self.out, &self.trajectories].into_iter().flatten() {
            files::check_writable(path)?;
        }
        let (items, failure) = self.items(&text, &world, &settings);
        let solver = match self.solver {
            SolverArg::Own => Solver::Own(self.lower.place.backend(items.len(), settings.precision)?, Box::new(settings.clone())),
            SolverArg::Ipopt => Solver::Ipopt(workers(self.lower.place.threads.unwrap_or(0))?),
        };
        let start = Instant::now();
        let mut content = DefaultHasher::new();
        (&text, format!("{world:?}")).hash(&mut content);
        let stamp = serde_json::to_string(&self.stamp(&settings, &solver, content.finish())).map_err(Error::from)?;
        let mut files = Files::open(self, &stamp, items.len())?;
        let mut tally = Tally::default();
        if let Some(out) = &files.out {
            out.text().lines().try_for_each(|line| tally.add_line(line))?;
        }
        if files.done_before > 0 {
            info!("{} of {} lines were done by an earlier run", files.done_before, items.len());
        }
        let printed = self.solve(&items, &solver, &mut files, &mut tally)?;
        if self.json {
            print(files.out.as_ref().map_or(&printed, Growing::text))?;
        } else {
            let (Tally { lines, feasible, iterations }, seconds) = (&tally, start.elapsed().as_secs_f64());
            let rate = (lines - files.done_before) as f64 / seconds.max(1e-9);
            print(&format!(
                "{feasible} of {lines} candidates feasible, {iterations} iterations, {seconds:.3} s, {rate:.1} candidates/s ({})\n",
                solver.device()
            ))?;
        }
        if tally.lines < items.len() {
            let kept =
                self.out.as_ref().map_or(String::new(), |out| format!("; {}.part has them, and the same command continues", out.display()));
            let message = format!("stopped: {} of {} lines evaluated{kept}", tally.lines, items.len());
            return Err(Failure::Ended(Error::Ended { message }));
        }
        files.finish()?;
        match failure {
            Some(error) => Err(Failure::Input(error)),
            None if tally.feasible > 0 => Ok(Verdict::Feasible),
            None => Ok(Verdict::Infeasible),
        }
    }

    /// Checks what is wrong with the command line rather than with the file.
    fn check_flags(&self) -> Result<()> {
        self.scenario.as_deref().map(Scenario::named).transpose()?;
        if let Some(set) = self.lower.set.iter().find(|s| s.starts_with("search.") || s.starts_with("refine.")) {
            let limit = "a setting of transcription, solver or precision: nothing is searched or refined here";
            return Err(Error::invalid("--set", set, limit));
        }
        if self.out.is_some() && self.out == self.trajectories {
            return Err(Error::invalid("--trajectories", "the file of --out", "another file"));
        }
        Ok(())
    }

    /// Lines before the first bad one, which keep their results, and its error.
    fn items(&self, text: &str, world: &World, settings: &LowerSettings) -> (Vec<Item>, Option<Error>) {
        let mut items = Vec::new();
        for (number, line) in files::lines(text) {
            match self.item(line, world).and_then(|item| check_candidate(&item.task, &item.schedule, settings).map(|()| item)) {
                Ok(item) => items.push(item),
                Err(e) => return (items, Some(e.in_file(&self.schedules, Some(number)))),
            }
        }
        let empty = || Error::invalid("schedules", "none", "at least one line").in_file(&self.schedules, None);
        let failure = items.is_empty().then(empty);
        (items, failure)
    }

    /// Solves the lines that are not done yet, until the end or a cancellation. Returns result lines that only are to be printed.
    fn solve(&self, items: &[Item], solver: &Solver, files: &mut Files, tally: &mut Tally) -> Result<String> {
        let mut printed = String::new();
        let mut logged = Instant::now();
        for chunk in items[files.done_before..].chunks(solver.chunk()) {
            let answers = solver.solve(chunk, self.trajectories.is_some())?;
            let (mut lines, mut motions) = (String::new(), String::new());
            for (item, answer) in chunk.iter().zip(answers) {
                let Some(answer) = answer else { break };
                tally.add(answer.feasible, answer.iterations);
                let mut object = item.object.clone();
                object.insert("result".into(), answer.result);
                lines += &(Value::Object(object).to_string() + "\n");
                if let Some(trajectory) = answer.trajectory {
                    motions += &(serde_json::to_string(&item.labelled(trajectory))? + "\n");
                }
            }
            for (file, lines) in [(&mut files.out, &lines), (&mut files.trajectories, &motions)] {
                file.as_mut().map_or(Ok(()), |file| file.add(lines))?;
            }
            if self.json && files.out.is_none() {
                printed += &lines;
            }
            if CANCELLED.load(Ordering::Relaxed) {
                break;
            }
            if logged.elapsed().as_secs_f64() > LOG_INTERVAL && tally.lines < items.len() {
                info!("{} of {} lines, {} feasible", tally.lines, items.len(), tally.feasible);
                logged = Instant::now();
            }
        }
        Ok(printed)
    }

    /// Everything that the results depend on.
    ///
    /// * `content` - hash of the lines, robots and terrains, because their files may have changed before the next run
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
        // A goal of two numbers has no height of its own.
        let place = match parsed.base_target.as_deref() {
            None => None,
            Some(&[x, y]) => Some(Goal::at(x, y)),
            Some(&[x, y, z]) => Some(Goal::position([x, y, z])),
            Some(other) => return Err(Error::invalid("base_target", format!("{} numbers", other.len()), "2 or 3: x, y, z in m")),
        };
        let goal = GoalSource { target: parsed.target, goal: place, yaw: parsed.yaw_target };
        let task = world.task(named.as_ref(), &Start::default(), goal)?;
        Ok(Item { object, scenario: named.map(|scenario| scenario.name), task, schedule })
    }
}

impl Item {
    /// Trajectory with robot, terrain, scenario, target and seed of the line.
    fn labelled(&self, trajectory: Trajectory) -> Trajectory {
        let number = |key: &str| self.object.get(key).and_then(Value::as_u64);
        let provenance = Provenance { scenario: self.scenario, target: number("target").map(|t| t as usize) };
        label(trajectory, &self.task, provenance, number("seed"))
    }
}

/// Output files, which grow line by line.
struct Files {
    out: Option<Growing>,
    trajectories: Option<Growing>,
    /// Number of lines that an earlier run has done.
    done_before: usize,
}

impl Files {
    /// Opens the files, and keeps the lines of an earlier run that all of them have.
    fn open(command: &Evaluate, stamp: &str, lines: usize) -> Result<Files> {
        let open = |path: &Option<PathBuf>| path.as_deref().map(|path| Growing::open(path, stamp)).transpose();
        let (mut out, mut trajectories) = (open(&command.out)?, open(&command.trajectories)?);
        // Without a file of results, the outcome of earlier lines is unknown.
        let fewest = [&out, &trajectories].into_iter().flatten().map(Growing::count).min();
        let done_before = fewest.filter(|_| out.is_some()).map_or(0, |count| count.min(lines));
        for file in [&mut out, &mut trajectories].into_iter().flatten() {
            file.keep(done_before)?;
        }
        Ok(Files { out, trajectories, done_before })
    }

    fn finish(self) -> Result<()> {
        [self.out, self.trajectories].into_iter().flatten().try_for_each(Growing::finish)
    }
}
