//! Evaluation of schedules: solves a batch, refines each solution in f64 (closing), and certifies and costs it.

use super::cem::Evaluation;
use super::needed::NeededCandidates;
use crate::backend::{Backend, Instance, Job, Precision, Solution, locked};
use crate::error::{Error, Result};
use crate::gait::cost::{CostWeights, cost};
use crate::gait::schedule::MAX_HORIZON;
use crate::gait::{AlignedSchedule, Schedule, Trajectory};
use crate::nlp::transcription::{force_limit, interval};
use crate::nlp::{Curves, Problem, trajectory};
use crate::settings::{SolverSettings, Transcription, TranscriptionSettings};
use crate::solver::{Outcome, Status, can_close, close};
use crate::task::Task;
use crate::verify::verify_rows;
use serde::{Deserialize, Serialize};
use std::ops::Deref;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Function that returns true if the work is to end. Called regularly.
pub type Cancelled<'a> = &'a (dyn Fn() -> bool + Sync);

/// Largest memory of the tables and buffers of one candidate, bytes.
pub const MAX_CANDIDATE_MEMORY: usize = 1 << 28;

/// Settings of the lower level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct LowerSettings {
    /// Settings of the variables and rows.
    pub transcription: TranscriptionSettings,
    /// Settings of the solver.
    pub solver: SolverSettings,
    /// Floating-point type of the main solve.
    pub precision: Precision,
}

impl Default for LowerSettings {
    fn default() -> Self {
        LowerSettings { transcription: TranscriptionSettings::default(), solver: SolverSettings::default(), precision: Precision::F32 }
    }
}

impl LowerSettings {
    /// Checks every field.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first field that is outside its limits.
    pub fn validate(&self) -> Result<()> {
        self.transcription.validate()?;
        self.solver.validate()
    }
}

/// Result of one schedule: evaluation, status and solution.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Evaluated {
    /// Status and effort of the solve, including the closing in f64.
    #[serde(flatten)]
    pub outcome: Outcome,
    /// Numbers by which the upper level ranks the schedule.
    #[serde(flatten)]
    pub evaluation: Evaluation,
    /// Worst violation, in the unit of its row.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub max_violation: f64,
    /// Horizon, s.
    pub horizon: f64,
    /// Number of variables of the reduced problem.
    pub n_variables: usize,
    /// Time from the start of its batch to the end of its certification, s.
    #[serde(rename = "seconds")]
    pub finished_after: f64,
    /// Transcription that was solved.
    pub transcription: Transcription,
    /// Schedule after its horizon was rounded up to whole intervals.
    #[serde(skip)]
    pub schedule: AlignedSchedule,
    /// Values of the variables, as in [`Problem::initial`].
    #[serde(skip)]
    pub x: Vec<f64>,
}

impl Evaluated {
    /// Phase durations of the trajectory, s, `[feet][phases]`.
    pub fn durations(&self) -> Vec<Vec<f64>> {
        let phases = (0..self.schedule.feet()).map(|foot| self.schedule.phases(foot));
        phases.map(|phases| phases.iter().map(|p| p.duration()).collect()).collect()
    }

    /// Certifies the result if it has no certificate yet: closes the solution in f64, counts its violations and computes its cost.
    ///
    /// * `task`, `settings` - task and settings of the evaluation
    pub(super) fn certify(self, task: &Task, settings: &LowerSettings, weights: Option<&CostWeights>) -> Evaluated {
        if self.certified {
            return self;
        }
        let Evaluated { outcome, schedule, x, finished_after, .. } = self;
        let context = EvaluationContext { task, schedule: &schedule, settings, weights };
        Evaluated { finished_after, ..context.examined(context.closed(outcome, x, &|| false)) }
    }

    /// Motion, feasible or not. It is computed on demand, because the motions of a population would take gigabytes.
    ///
    /// * `task`, `settings` - task and settings of the evaluation
    pub fn trajectory(&self, task: &Task, settings: &TranscriptionSettings) -> Trajectory {
        trajectory(task, &Curves::new(task, &self.schedule, settings), &self.x)
    }
}

impl Deref for Evaluated {
    type Target = Evaluation;

    fn deref(&self) -> &Evaluation {
        &self.evaluation
    }
}

/// Checks that a schedule fits a task and can be solved within [`MAX_CANDIDATE_MEMORY`].
///
/// # Errors
/// [`Error::Invalid`] if the numbers of feet differ or the problem is too large.
pub fn check_candidate(task: &Task, schedule: &Schedule, settings: &LowerSettings) -> Result<()> {
    let (feet, expected) = (schedule.feet(), task.robot.feet());
    if feet != expected {
        return Err(Error::invalid("durations", format!("{feet} feet"), format!("{expected} feet, as robot `{}` has", task.robot.name)));
    }
    check_ends(task, schedule, settings.transcription.rows)?;
    let schedule = &*task.timed(schedule)?;
    let interval = task.interval(interval(&settings.transcription, &task.robot));
    if let Some(stride) = &task.stride {
        if settings.transcription.rows != Transcription::Momentum {
            return Err(Error::invalid("transcription.rows", settings.transcription.rows.name(), "`momentum` for a periodic stride"));
        }
        stride.check(&schedule.aligned(interval))?;
    }
    let horizon = schedule.intervals(interval) as f64 * interval;
    if horizon > MAX_HORIZON {
        return Err(Error::invalid(
            "durations",
            format!("{horizon} s in whole intervals of {interval} s"),
            format!("at most {MAX_HORIZON} s"),
        ));
    }
    let phases: usize = schedule.durations().iter().map(Vec::len).sum();
    let a_phase = 6 * settings.transcription.force_pieces() + 4;
    let variables = 12 * (schedule.intervals(interval) + 1) + phases * a_phase;
    // A front contains the variables of one interval, twice. The factor that it produces has as many rows as there are variables.
    let front = 24 + a_phase * most_phases(schedule, interval);
    let estimate = 8 * (2 * front * front).max(400 * variables);
    if estimate > MAX_CANDIDATE_MEMORY {
        return Err(Error::invalid(
            "durations",
            format!("{phases} phases, about {variables} variables and {} MiB", estimate >> 20),
            format!("a problem of at most {} MiB", MAX_CANDIDATE_MEMORY >> 20),
        ));
    }
    Ok(())
}

/// Checks that the feet in the air at the start are those of the task, and that the rows can have feet in the air at the ends.
fn check_ends(task: &Task, schedule: &Schedule, rows: Transcription) -> Result<()> {
    if rows != Transcription::Momentum && task.robot.sole.is_some() {
        return Err(Error::invalid("robot.sole", "a sole", format!("none for the rows `{}`", rows.name())));
    }
    for (foot, swing) in task.start_swings.iter().enumerate() {
        let place = || format!("durations, foot {foot}");
        let lifted = schedule.starts_in_swing(foot);
        if lifted != swing.is_some() {
            let [value, limit] = if lifted {
                ["a first stance of 0 s", "a longer one: the foot stands at the start of the task"]
            } else {
                ["a first stance", "0 s: the foot is in the air at the start of the task"]
            };
            return Err(Error::invalid(place(), value, limit));
        }
        if rows != Transcription::Momentum && (lifted || schedule.lands_after(foot).is_some()) {
            return Err(Error::invalid(place(), "in the air at an end", "stances at both ends, for the rows `towr`"));
        }
    }
    Ok(())
}

/// Largest number of phases of all feet together that overlap one interval.
fn most_phases(schedule: &Schedule, interval: f64) -> usize {
    let mut touched = vec![0; schedule.intervals(interval) + 1];
    for phases in schedule.durations() {
        let mut start = 0.;
        for duration in phases {
            let end = start + duration;
            let last = ((end / interval) as usize).min(touched.len() - 1);
            touched[((start / interval) as usize).min(last)..=last].iter_mut().for_each(|count| *count += 1);
            start = end;
        }
    }
    touched.into_iter().max().unwrap_or(0)
}

/// Solves and certifies a batch.
///
/// * `cost` - weights of the cost that every feasible motion gets; `None`: no cost
/// * `first_feasible` - drops candidates after the lowest feasible index (`None`); that index does not depend on the number of threads
/// * `cancelled` - ends the evaluation; unfinished candidates are `None`
///
/// # Errors
/// Errors of [`check_candidate`] for the first candidate that does not fit.
pub fn evaluate(
    candidates: &[(&Task, &Schedule)],
    settings: &LowerSettings,
    cost: Option<&CostWeights>,
    backend: &dyn Backend,
    first_feasible: bool,
    cancelled: Cancelled,
) -> Result<Vec<Option<Evaluated>>> {
    // All feasible candidates have the same value, so the first one is the best.
    let needed = NeededCandidates::new(vec![0.; candidates.len()], if first_feasible { 1 } else { usize::MAX });
    let results: Vec<Mutex<Option<Evaluated>>> = candidates.iter().map(|_| Mutex::default()).collect();
    let skip = |index: usize| cancelled() || !needed.contains(index);
    batch(candidates, settings, cost, backend, Certify::All, &skip, &|index, evaluated| {
        if evaluated.feasible {
            needed.record(index, 0.);
        }
        *locked(&results[index]) = Some(evaluated);
    })?;
    let results = results.iter().enumerate();
    Ok(results.map(|(index, result)| locked(result).take().filter(|_| needed.contains(index))).collect())
}

/// Selection of the candidates of a batch that are certified at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Certify {
    /// Certify every candidate.
    All,
    /// Certify unsolved candidates at once, without closing, to report what they violate. Solved candidates are costed now and certified
    /// only if they are selected.
    Unsolved,
}

/// Solves a batch like [`evaluate`] and passes each result to `finish`, in any order and from any thread.
///
/// * `certify` - candidates to certify
/// * `skip` - returns true if a candidate is to be dropped; called before and during its solve
pub(super) fn batch<'a>(
    candidates: &[(&'a Task, &'a Schedule)],
    settings: &LowerSettings,
    cost: Option<&CostWeights>,
    backend: &dyn Backend,
    certify: Certify,
    skip: &(dyn Fn(usize) -> bool + Sync),
    finish: &(dyn Fn(usize, Evaluated) + Sync),
) -> Result<()> {
    let instance = |(task, schedule): &(&'a Task, &'a Schedule)| {
        check_candidate(task, schedule, settings)?;
        let interval = task.interval(interval(&settings.transcription, &task.robot));
        Ok(Instance { task, schedule: task.timed(schedule)?.aligned(interval) })
    };
    let instances: Vec<Instance> = candidates.iter().map(instance).collect::<Result<_>>()?;
    let start = Instant::now();
    let finish = |index: usize, solution: Solution| {
        let Instance { task, schedule } = &instances[index];
        let context = EvaluationContext { task, schedule, settings, weights: cost };
        let mut evaluated = match certify {
            Certify::All => context.certified(solution, &|| skip(index)),
            Certify::Unsolved if solution.outcome.status == Status::Solved => context.evaluated(solution, false),
            // Closing in f64 would make one of eight such candidates feasible, and each attempt costs as much as four new candidates.
            Certify::Unsolved => context.examined(solution),
        };
        if evaluated.outcome.status == Status::Cancelled && !evaluated.feasible {
            return;
        }
        evaluated.finished_after = start.elapsed().as_secs_f64();
        finish(index, evaluated);
    };
    let LowerSettings { transcription, solver, precision } = settings;
    let job = Job { instances: &instances, transcription, settings: solver, precision: *precision, certified: certify == Certify::All };
    backend.solve(&job, skip, &finish);
    Ok(())
}

/// Solves and certifies given schedules of a task as one batch.
///
/// ```
/// use cregopt::{Cpu, Evaluate, Goal, Robot, Schedule, Task, Terrain};
///
/// let task = Task::new(Robot::named("biped")?, Terrain::flat(), Goal::at(0.5, 0.0))?;
/// // Stance, swing, stance, ... of each foot, s.
/// let walk = Schedule::new(vec![vec![0.2, 0.3, 0.5, 0.3, 0.5, 0.3, 0.2], vec![0.6, 0.3, 0.5, 0.3, 0.6]])?;
/// let evaluate = Evaluate::new(&task);
/// let solved = evaluate.run(&[walk], &Cpu::new(0)?)?.remove(0).expect("not cancelled");
/// assert!(solved.feasible);
/// let trajectory = evaluate.trajectory(&solved);
/// println!("{} s, {} feet", trajectory.horizon, trajectory.ee.len());
/// # Ok::<(), cregopt::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Evaluate<'a> {
    task: &'a Task,
    settings: LowerSettings,
    cost: CostWeights,
    cancelled: Option<&'a AtomicBool>,
}

impl<'a> Evaluate<'a> {
    /// An evaluation with the default settings.
    pub fn new(task: &'a Task) -> Self {
        Evaluate { task, settings: LowerSettings::default(), cost: CostWeights::default(), cancelled: None }
    }

    /// Sets the settings of the lower level.
    pub fn settings(self, settings: LowerSettings) -> Self {
        Evaluate { settings, ..self }
    }

    /// Sets the weights of the cost of transport.
    pub fn cost(self, cost: CostWeights) -> Self {
        Evaluate { cost, ..self }
    }

    /// Sets a flag that ends the evaluation.
    pub fn cancelled_by(self, flag: &'a AtomicBool) -> Self {
        Evaluate { cancelled: Some(flag), ..self }
    }

    /// Solves and certifies schedules, scaled to the duration of the task if it has one. The result has their order; entries are `None` if
    /// the evaluation was cancelled before.
    ///
    /// # Errors
    /// [`Error::Invalid`] for settings or a task outside their limits, or a schedule that does not fit the robot.
    pub fn run(&self, schedules: &[Schedule], backend: &dyn Backend) -> Result<Vec<Option<Evaluated>>> {
        self.settings.validate()?;
        self.cost.validate()?;
        self.task.validate()?;
        let candidates: Vec<(&Task, &Schedule)> = schedules.iter().map(|schedule| (self.task, schedule)).collect();
        let cancelled = || self.cancelled.is_some_and(|flag| flag.load(Ordering::Relaxed));
        evaluate(&candidates, &self.settings, Some(&self.cost), backend, false, &cancelled)
    }

    /// Motion of a result, feasible or not.
    pub fn trajectory(&self, evaluated: &Evaluated) -> Trajectory {
        evaluated.trajectory(self.task, &self.settings.transcription)
    }

    /// Largest normal force of a foot, N: the limit to pass to [`verify`](crate::verify()).
    pub fn force_limit(&self) -> f64 {
        force_limit(&self.settings.transcription, self.task)
    }
}

/// Schedule and settings of one evaluation. Turns the solution of the solver into an [`Evaluated`].
#[derive(Clone, Copy)]
pub(super) struct EvaluationContext<'a> {
    pub task: &'a Task,
    /// Schedule that was solved.
    pub schedule: &'a AlignedSchedule,
    pub settings: &'a LowerSettings,
    /// Weights of the cost; `None`: no cost is computed.
    pub weights: Option<&'a CostWeights>,
}

impl EvaluationContext<'_> {
    /// Certified result of a candidate, closed in f64 unless it already is or cannot be.
    fn certified(self, solution: Solution, cancel: &dyn Fn() -> bool) -> Evaluated {
        let final_already = solution.closed || self.settings.precision == Precision::F64 || !can_close(&solution.outcome);
        self.examined(if final_already { solution } else { self.closed(solution.outcome, solution.x, cancel) })
    }

    /// Closes a solution in f64. A solution of an f64 solve stays unchanged.
    fn closed(self, outcome: Outcome, x: Vec<f64>, cancel: &dyn Fn() -> bool) -> Solution {
        let EvaluationContext { task, schedule, settings, .. } = self;
        let (outcome, x, curves) = match settings.precision {
            Precision::F32 => {
                let problem = Problem::<f64>::new(task, schedule, &settings.transcription);
                let (outcome, x) = close(&problem, outcome, x, &settings.solver, cancel);
                (outcome, x, problem.curves)
            }
            Precision::F64 => (outcome, x, Curves::new(task, schedule, &settings.transcription)),
        };
        Solution { outcome, x, variables: curves.variables, curves, closed: true }
    }

    /// Certified result of a candidate, with its cost. The solution is not closed before.
    pub fn examined(self, solution: Solution) -> Evaluated {
        self.evaluated(solution, true)
    }

    /// Result of a candidate, with its cost.
    ///
    /// * `certified` - false: the solver solved the problem, and the motion gets no certificate
    fn evaluated(self, solution: Solution, certified: bool) -> Evaluated {
        let EvaluationContext { task, settings, weights, .. } = self;
        let motion = trajectory(task, &solution.curves, &solution.x);
        let (n_violated, max_violation, feasible) = if certified {
            let report = verify_rows(&motion, &task.robot, &task.terrain, force_limit(&settings.transcription, task));
            report.map_or((usize::MAX, f64::NAN, false), |r| (r.n_violated, r.max_violation, r.feasible))
        } else {
            (0, f64::NAN, true)
        };
        let robot = &task.robot;
        let cost = weights.filter(|_| feasible).and_then(|weights| cost(&motion, robot, robot.leg_mass(), weights).ok());
        Evaluated {
            outcome: solution.outcome,
            evaluation: Evaluation { feasible, certified, n_violated, mean_normal_force: mean_normal_force(task, &motion), cost },
            max_violation,
            horizon: motion.horizon,
            n_variables: solution.variables,
            finished_after: 0.,
            transcription: settings.transcription.rows,
            schedule: self.schedule.clone(),
            x: solution.x,
        }
    }
}

/// Mean over all force nodes, including the zero ones of swings, of `|n . f|`, N, where `n` is the terrain normal under the foot at that
/// node.
pub(crate) fn mean_normal_force(task: &Task, trajectory: &Trajectory) -> f64 {
    let (mut sum, mut count) = (0., 0);
    for (foot, durations) in trajectory.ee.iter().zip(&trajectory.durations) {
        let force_pieces = (foot.force.poly_durations.len() - durations.len() / 2) / durations.len().div_ceil(2);
        // Force nodes are stored stance by stance, `force_pieces + 1` each; motion nodes two per stance and one per swing.
        for (i, node) in foot.force.nodes.iter().enumerate() {
            let stance = i / (force_pieces + 1);
            let at = foot.motion.nodes[(3 * stance).min(foot.motion.nodes.len() - 1)];
            let [hx, hy] = task.terrain.ground(at[0], at[1]).slope;
            let normal = (node[2] - hx * node[0] - hy * node[1]) / (1. + hx * hx + hy * hy).sqrt();
            sum += normal.abs();
            count += 1;
        }
    }
    sum / f64::from(count.max(1))
}
