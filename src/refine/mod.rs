//! Refinement of a found gait to a local optimum of its cost: a descent along its durations, then sequential convex programming.
//!
//! The solver minimises the cost for given durations, and the durations follow their gradient (`durations`), with absolute values of powers
//! that are rounded less and less. Where that ends, all variables move together in a few convex problems.
//!
//! The variables are those of the `momentum` problem, the boundaries between phases and, if the horizon is free, the interval of base knots
//! (`variables`). At every point the rows are linearised, friction cones are kept as cones (`rows`), and the cost is approximated by a
//! convex model (`convex_cost`) whose curvature is learned from the iterations (`curvature`). Clarabel solves this problem within a trust
//! region (`convex`). Gauss-Newton steps in f64 then bring the point back onto the rows, as they close every solution of this program.
//! Every iterate is therefore a valid gait, and the cost alone decides whether it is accepted. The trust region grows if the cost falls as
//! predicted and shrinks if it does not. The result is certified and costs no more than the given gait.
//!
//! ```text
//! v        the given gait, closed with exact friction cones
//!          v descends along its durations
//! repeat   d    minimises the convex cost around v, |d| <= trust
//!          w    v + d, closed
//!          if w is certified and cost(w) < cost(v) - ACCEPTED * predicted decrease: v becomes w
//!          trust grows or shrinks
//! until    the optimality residual is below its tolerance, or the predicted decrease is negligible
//! ```

mod convex;
mod convex_cost;
mod curvature;
pub mod durations;
#[cfg(feature = "ipopt")]
pub mod program;
mod rows;
mod variables;

use crate::error::{Error, Result, check_range};
use crate::gait::cost::{self, Cost, CostWeights};
use crate::gait::family::MIN_PHASE_SCALED;
use crate::gait::{AlignedSchedule, Trajectory};
use crate::nlp::{Curves, Problem, trajectory};
use crate::robot::Robot;
use crate::settings::{Friction, OptimiseSettings, SolverSettings, StallSettings, Transcription, TranscriptionSettings};
use crate::solver::{Finish, Solver, Status};
use crate::task::Task;
use crate::verify::verify_rows;
use convex::Multipliers;
use convex_cost::Price;
use curvature::History;
use durations::{Descent as DurationDescent, Effort};
use serde::{Deserialize, Serialize};
use variables::{Point, Space};

/// Settings of the refinement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct RefineSettings {
    /// Largest number of convex problems. Too small: the refinement ends above the optimum; too large: costs time. After the sixth problem
    /// the cost of gaits of ANYmal, HyQ and the biped fell by at most 0.2 %.
    pub iterations: usize,
    /// Optimality residual at which the refinement ends with `optimal`. Too small: never reached; too large: the result is not optimal.
    pub tolerance: f64,
    /// Predicted relative decrease of the cost below which a step is negligible. The refinement ends after two consecutive such steps.
    /// Too small: iterations without effect; too large: ends early.
    pub gain: f64,
    /// Makes phase durations variables.
    pub durations: bool,
    /// Makes the horizon a variable, unless the task has a duration. The number of base intervals is kept and their length changes, within
    /// the range that keeps the number of pieces per interval: an interval of 0.1 s may become 0.078 to 0.104 s.
    pub horizon: bool,
    /// Initial trust region. The unit 1 means 5 cm, 0.1 rad, 0.5 m/s, one weight per foot, and a tenth of `sqrt(l / g)` for each phase
    /// boundary. Too large: the first steps are rejected; too small: many steps until it has grown.
    pub trust: f64,
    /// Shortest phase, in units of `sqrt(l / g)`. Phases of the given gait that are shorter may keep their duration. Too
    /// small: swings too fast for motors and controllers; too large: less freedom for the durations.
    pub shortest_phase: f64,
    /// Equivalent mass of a leg at its foot, kg. Default: the robot's.
    pub leg_mass: Option<f64>,
}

impl Default for RefineSettings {
    fn default() -> Self {
        RefineSettings {
            iterations: 6,
            tolerance: 1e-4,
            gain: 1e-4,
            durations: true,
            horizon: true,
            trust: 0.5,
            shortest_phase: MIN_PHASE_SCALED,
            leg_mass: None,
        }
    }
}

impl RefineSettings {
    /// Checks every field.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first field that is out of range.
    pub fn validate(&self) -> Result<()> {
        check_range("refine.iterations", self.iterations as f64, 0., 1e5)?;
        check_range("refine.tolerance", self.tolerance, 0., 1.)?;
        check_range("refine.gain", self.gain, 0., 1.)?;
        check_range("refine.trust", self.trust, LEAST_TRUST, MOST_TRUST)?;
        check_range("refine.shortest_phase", self.shortest_phase, 0., 100.)?;
        self.leg_mass.map_or(Ok(()), |mass| check_range("refine.leg_mass", mass, 0., 1e6))
    }

    /// Checks every field, and that gaits of this transcription can be refined.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first field that is out of range, or `transcription.rows`.
    pub fn validate_for(&self, transcription: &TranscriptionSettings) -> Result<()> {
        if transcription.rows != Transcription::Momentum {
            return Err(Error::invalid("transcription.rows", transcription.rows.name(), "`momentum` for a gait to be refined"));
        }
        self.validate()
    }
}

/// Reason for which a refinement ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum RefineStatus {
    /// Reached a local optimum within the tolerance.
    Optimal,
    /// Predicted decreases became negligible, see [`RefineSettings::gain`].
    Settled,
    /// The trust region became too small to decrease the cost.
    Stalled,
    /// Reached the iteration limit.
    MaxIterations,
    /// Cancelled by the caller.
    Cancelled,
    /// The given gait could not be brought inside the friction cones. It is returned unchanged.
    NotClosed,
}

impl std::fmt::Display for RefineStatus {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            RefineStatus::Optimal => "optimal",
            RefineStatus::Settled => "settled",
            RefineStatus::Stalled => "stalled",
            RefineStatus::MaxIterations => "iteration limit",
            RefineStatus::Cancelled => "cancelled",
            RefineStatus::NotClosed => "not closed",
        })
    }
}

/// Distance of a point from a local optimum. Dimensionless: relative to the gait's cost, with variables in trust lengths.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Optimality {
    /// Largest derivative of the Lagrangian with respect to a variable.
    pub stationarity: f64,
    /// Largest scaled residual of a row.
    pub feasibility: f64,
    /// Largest product of a multiplier and its row.
    pub complementarity: f64,
}

impl Optimality {
    /// Largest of the three.
    pub fn residual(&self) -> f64 {
        self.stationarity.max(self.feasibility).max(self.complementarity)
    }
}

/// A refined gait.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Refined {
    /// Reason for which the refinement ended.
    pub status: RefineStatus,
    /// Phase durations.
    #[serde(skip)]
    pub schedule: AlignedSchedule,
    /// Values of the variables, ordered as in [`Problem::initial`] for this schedule.
    #[serde(skip)]
    pub x: Vec<f64>,
    /// Cost of the given gait.
    pub before: Cost,
    /// Cost of the refined gait.
    pub after: Cost,
    /// True if every row of the certificate holds.
    pub certified: bool,
    /// Residuals of the optimality conditions at the point of the last convex problem, with its multipliers; `None` if no convex problem
    /// was solved.
    pub optimality: Option<Optimality>,
    /// Number of convex problems solved.
    pub iterations: usize,
    /// Largest change of a phase duration, s.
    pub largest_change: f64,
    /// Number of phases whose duration changed by more than a millisecond.
    pub changed: usize,
}

impl Refined {
    /// The motion.
    ///
    /// * `task`, `settings` - task and settings of the refinement
    pub fn trajectory(&self, task: &Task, settings: &TranscriptionSettings) -> Trajectory {
        trajectory(task, &Curves::new(task, &self.schedule, settings), &self.x)
    }
}

/// Smallest accepted ratio of actual to predicted decrease of the cost.
const ACCEPTED: f64 = 0.1;
/// Ratio of actual to predicted decrease above which the trust region grows.
const GOOD: f64 = 0.7;
/// Ratio of actual to predicted decrease below which the trust region shrinks.
const POOR: f64 = 0.3;
/// Trust below which a refinement is stalled.
const LEAST_TRUST: f64 = 1e-6;
/// Largest trust.
const MOST_TRUST: f64 = 1.;
/// Curvature added in every direction, in costs per squared trust length: initial, smallest and largest value. It increases when the trust
/// region shrinks and decreases when the trust region grows. Too small: directions with almost no effect on the cost drift; too large:
/// short steps.
const LEAST_CURVATURE: [f64; 3] = [1e-3, 1e-5, 1e2];
/// Huber roundings of the absolute values of powers, applied one after the other, in metres times the weight at each quadrature point: from
/// a smooth cost to the exact one. The rounded ones are for gaits from which the descent failed: without them such gaits end in the nearest
/// of many optima, because where powers are zero, every direction increases the exact cost at first.
const ROUNDINGS: [f64; 4] = [1., 0.1, 0.01, 0.];
/// Roundings of the absolute values of powers in the descent along the durations, m/s. Without the first two ANYmal's trot of 2 m ends at
/// 1.824 instead of 1.821.
const DESCENT_ROUNDINGS: [f64; 3] = [3e-2, 3e-3, 3e-5];
/// Predicted relative fall of the cost at which a minimisation of the descent ends.
const DESCENT_TOLERANCE: f64 = 1e-6;
/// Effort of the descent.
const DESCENT: Effort = Effort { first: 30, iterations: 8, rounded: false };
/// Largest number of changes of the durations in the descent with one rounding.
const DESCENT_STEPS: usize = 100;
/// Predicted relative decrease of a rounded cost below which a step is negligible.
const ROUNDED_GAIN: f64 = 1e-3;
/// Number of consecutive negligible steps after which a refinement ends.
const IDLE: usize = 2;
/// Half the sum of squared scaled violations at which a point counts as closed. Closing steps nearly always end far below. With redundant
/// rows they converge slowly, and a smaller limit would reject good points.
const CLOSED: f64 = 1e-13;
/// Shares of the rows' margins, tried one after the other.
const MARGINS: [f64; 2] = [1., 0.1];
/// Initial barrier parameter for bringing a given gait inside the cones if closing steps fail.
const START_BARRIER: f64 = 1e-3;
/// Largest number of closing steps per point.
const CLOSING_STEPS: usize = 8;

/// An accepted step, in trust lengths.
struct Taken {
    step: Vec<f64>,
    /// Derivative of the Lagrangian before the step.
    before: Vec<f64>,
    /// Multipliers of the convex problem.
    multipliers: Multipliers,
}

/// Refines a gait to a local optimum of its cost.
///
/// * `schedule`, `x` - the gait, as in [`crate::search::evaluate::Evaluated`]
/// * `transcription` - settings of its solve, with `momentum` rows. Forces are kept inside exact friction cones whatever the settings say
/// * `cancel` - ends the refinement at the next iteration when it returns true
///
/// # Errors
/// [`Error::Invalid`] for settings out of range, rows other than `momentum`, or a gait that does not fit the task.
pub fn refine(
    task: &Task,
    schedule: &AlignedSchedule,
    x: &[f64],
    transcription: &TranscriptionSettings,
    weights: &CostWeights,
    settings: &RefineSettings,
    cancel: &dyn Fn() -> bool,
) -> Result<Refined> {
    task.validate()?;
    transcription.validate()?;
    weights.validate()?;
    settings.validate_for(transcription)?;
    check(task, schedule, x, transcription)?;
    // If the rows cannot hold with their full margins, the certificate may still hold.
    let cones = MARGINS.map(|share| TranscriptionSettings {
        friction: Some(Friction::Cone),
        length_margin: share * transcription.length_margin,
        force_margin: share * transcription.force_margin,
        ..transcription.clone()
    });
    let leg_mass = settings.leg_mass.unwrap_or_else(|| task.robot.leg_mass());
    let pricing = Pricing { task, weights, leg_mass };
    let mut solver = Solver::<f64>::default();
    let spaces = cones.iter().map(|cones| Space::new(task, schedule, cones, settings));
    let mut closed = spaces.filter_map(|space| close_given(&space, &mut solver, schedule, x, cancel).map(|point| (space, point)));
    let Some((space, now)) = closed.next() else {
        let given = Space::new(task, schedule, &cones[0], settings).start(schedule, x);
        let status = if cancel() { RefineStatus::Cancelled } else { RefineStatus::NotClosed };
        return pricing.report(&given, given.clone(), status, None, 0);
    };
    let given = space.start(schedule, x);
    let descended = descended(&space, schedule, &now, weights, &mut solver, settings, cancel);
    let price = Price::new(&space, weights, leg_mass);
    let history = History::default();
    // After the descent, which rounds the cost by itself, the exact cost is left.
    let first = if descended.is_some() { ROUNDINGS.len() - 1 } else { 0 };
    let start = match descended {
        Some(point) if pricing.cost(&point)?.total < pricing.cost(&now)?.total => point,
        _ => now,
    };
    let now = start.clone();
    let mut descent =
        Descent { task, space: &space, price: &price, settings, cancel, solver, history, now, iterations: 0, optimality: None };
    let mut status = RefineStatus::MaxIterations;
    for (i, rounding) in ROUNDINGS.iter().enumerate().skip(first) {
        let gain = if *rounding > 0. { settings.gain.max(ROUNDED_GAIN) } else { settings.gain };
        let most = settings.iterations * (i + 1) / ROUNDINGS.len();
        status = descent.run(rounding * task.robot.weight(), gain, most)?;
        if status == RefineStatus::Cancelled {
            break;
        }
    }
    // The convex problems do not count joints beyond their limits.
    let last = if pricing.cost(&descent.now)?.total < pricing.cost(&start)?.total { descent.now } else { start };
    pricing.report(&given, last, status, descent.optimality, descent.iterations)
}

/// State of the descent.
struct Descent<'a> {
    task: &'a Task,
    space: &'a Space<'a>,
    price: &'a Price<'a>,
    settings: &'a RefineSettings,
    cancel: &'a dyn Fn() -> bool,
    solver: Solver<f64>,
    history: History,
    /// Current point.
    now: Point,
    iterations: usize,
    optimality: Option<Optimality>,
}

impl Descent<'_> {
    /// Minimises the cost with rounded absolute values of powers.
    ///
    /// * `rounding` - J per quadrature point
    /// * `gain` - predicted relative decrease below which a step is negligible
    /// * `most` - largest number of iterations, counted over all calls
    fn run(&mut self, rounding: f64, gain: f64, most: usize) -> Result<RefineStatus> {
        let (task, space, price, settings) = (self.task, self.space, self.price, self.settings);
        let length = &space.variables.step;
        let closing = closing_settings();
        let mut value = price.value(&self.now, rounding);
        let (mut trust, mut least) = (settings.trust, LEAST_CURVATURE[0]);
        let mut last: Option<Taken> = None;
        // Consecutive negligible steps.
        let mut idle = 0;
        loop {
            let linear = rows::linear(space, &self.now)?;
            let model = price.model(&self.now, rounding);
            let feasibility = rows::Residuals::new(&self.now.problem, &self.now.x, false).violation();
            if let Some(taken) = last.take() {
                self.history.push(taken.step, taken.multipliers.lagrangian(&linear, &model, length), &taken.before, value);
            }
            // Shorter and shorter steps from one point.
            loop {
                if (self.cancel)() {
                    return Ok(RefineStatus::Cancelled);
                }
                if self.iterations >= most {
                    return Ok(RefineStatus::MaxIterations);
                }
                if trust < LEAST_TRUST {
                    return Ok(RefineStatus::Stalled);
                }
                self.iterations += 1;
                let Some(step) = convex::solve(&linear, &model, &self.history.curvature(least), length, trust) else {
                    trust *= 0.25;
                    continue;
                };
                let here = Optimality { stationarity: step.stationarity, feasibility, complementarity: step.complementarity };
                self.optimality = Some(here);
                idle = if step.predicted < gain * value { idle + 1 } else { 0 };
                if here.residual() < settings.tolerance {
                    return Ok(RefineStatus::Optimal);
                }
                if idle == IDLE {
                    return Ok(RefineStatus::Settled);
                }
                let moved = self.now.v.iter().zip(&step.by).map(|(v, d)| v + d).collect();
                let trial = space.point(moved).ok().and_then(|p| close(space, &mut self.solver, p, &closing, self.cancel));
                let next = trial.as_ref().map_or(f64::INFINITY, |p| price.value(p, rounding));
                let ratio = (value - next) / step.predicted;
                let went = step.by.iter().zip(length).map(|(d, l)| (d / l).abs()).fold(0., f64::max);
                let lasts = |p: &Point| space.lasts(&p.schedule, &self.now.schedule);
                let taken = trial.filter(|p| next < value && ratio > ACCEPTED && lasts(p) && certified(task, p));
                if taken.is_none() || ratio < POOR {
                    trust = 0.5 * went.min(trust);
                    least = (4. * least).min(LEAST_CURVATURE[2]);
                } else if ratio > GOOD {
                    trust = if went > 0.9 * trust { (2. * trust).min(MOST_TRUST) } else { trust };
                    least = (0.5 * least).max(LEAST_CURVATURE[1]);
                }
                if let Some(point) = taken {
                    let step_taken = point.v.iter().zip(&self.now.v).zip(length).map(|((a, b), l)| (a - b) / l).collect();
                    let before = step.multipliers.lagrangian(&linear, &model, length);
                    last = Some(Taken { step: step_taken, before, multipliers: step.multipliers });
                    (self.now, value) = (point, next);
                    break;
                }
            }
        }
    }
}

/// Checks that a gait fits its task and its transcription.
fn check(task: &Task, schedule: &AlignedSchedule, x: &[f64], transcription: &TranscriptionSettings) -> Result<()> {
    check_robot(&task.robot)?;
    if schedule.feet() != task.robot.feet() {
        let limit = format!("{} feet, as robot `{}` has", task.robot.feet(), task.robot.name);
        return Err(Error::invalid("durations", format!("{} feet", schedule.feet()), limit));
    }
    if task.stride.is_some() {
        return Err(Error::invalid("task.stride", "a periodic stride", "none for a gait to be refined"));
    }
    let expected = Problem::<f64>::new(task, schedule, transcription).initial.len();
    if x.len() != expected || x.iter().any(|v| !v.is_finite()) {
        return Err(Error::invalid("x", format!("{} values", x.len()), format!("{expected} finite values, for this schedule")));
    }
    Ok(())
}

/// Checks that gaits of a robot can be refined.
///
/// # Errors
/// [`Error::Invalid`] for a robot with soles.
pub fn check_robot(robot: &Robot) -> Result<()> {
    if robot.sole.is_none() {
        return Ok(());
    }
    Err(Error::invalid("robot.sole", "a sole", "none for a gait to be refined"))
}

/// Solver settings for closing steps only.
fn closing_settings() -> SolverSettings {
    let settings = SolverSettings::default();
    SolverSettings {
        max_iterations: CLOSING_STEPS,
        closing: f64::INFINITY,
        edge_radius: 0.,
        proximal: settings.proximal_floor,
        stall: StallSettings { enabled: false, ..settings.stall.clone() },
        ..settings
    }
}

/// Brings a point onto its rows; `None` if that fails.
fn close(space: &Space, solver: &mut Solver<f64>, point: Point, settings: &SolverSettings, cancel: &dyn Fn() -> bool) -> Option<Point> {
    let outcome = solver.solve(&point.problem, settings, Finish::Infeasibility(CLOSED), Some(&point.x), cancel);
    (outcome.status == Status::Solved).then(|| space.moved(point, solver.solution()))
}

/// True if the motion of a point passes the independent check.
fn certified(task: &Task, point: &Point) -> bool {
    let motion = trajectory(task, &point.problem.curves, &point.x);
    verify_rows(&motion, &task.robot, &task.terrain, point.problem.force_limit()).is_ok_and(|r| r.feasible)
}

/// Brings the given gait onto its rows; `None` if that fails.
fn close_given(space: &Space, solver: &mut Solver<f64>, schedule: &AlignedSchedule, x: &[f64], cancel: &dyn Fn() -> bool) -> Option<Point> {
    // Forces outside their cones may be too far off for closing steps.
    let continued = SolverSettings { barrier: Some(START_BARRIER), ..SolverSettings::default() };
    let attempts = [closing_settings(), continued, SolverSettings::default()];
    let closed = |settings| close(space, solver, space.start(schedule, x), settings, cancel).filter(|p| certified(space.task, p));
    attempts.iter().find_map(closed)
}

/// Lowers the cost of a closed gait by minimisations of the solver and along its durations, with absolute values that are rounded less and
/// less. `None` if its motion cannot be minimised, or does not pass the independent check afterwards.
fn descended(
    space: &Space,
    schedule: &AlignedSchedule,
    closed: &Point,
    weights: &CostWeights,
    solver: &mut Solver<f64>,
    settings: &RefineSettings,
    cancel: &dyn Fn() -> bool,
) -> Option<Point> {
    let mut costly = Space::new(space.task, schedule, space.settings, settings).with_cost(weights);
    let mut point = costly.start(schedule, &closed.x);
    for rounding_floor in DESCENT_ROUNDINGS {
        let optimise = OptimiseSettings { tolerance: DESCENT_TOLERANCE, rounding_floor, ..OptimiseSettings::default() };
        let optimise = OptimiseSettings { rounding: rounding_floor.max(optimise.rounding), ..optimise };
        let solver = SolverSettings { optimise, ..SolverSettings::default() };
        let effort = Effort { rounded: rounding_floor > DESCENT_ROUNDINGS[2], ..DESCENT };
        let mut descent = DurationDescent::within(costly, point, weights, &solver, effort, cancel)?;
        descent.advance(DESCENT_STEPS, cancel);
        (costly, point) = descent.into_parts();
    }
    let point = close(space, solver, space.point(point.v).ok()?, &closing_settings(), cancel)?;
    certified(space.task, &point).then_some(point)
}

/// Task and weights for evaluating the cost of a gait.
struct Pricing<'a> {
    task: &'a Task,
    weights: &'a CostWeights,
    leg_mass: f64,
}

impl Pricing<'_> {
    fn cost(&self, point: &Point) -> Result<Cost> {
        cost::cost(&trajectory(self.task, &point.problem.curves, &point.x), &self.task.robot, self.leg_mass, self.weights)
    }

    /// Result: the last point, or the given one if that costs less.
    fn report(
        &self,
        given: &Point,
        last: Point,
        status: RefineStatus,
        optimality: Option<Optimality>,
        iterations: usize,
    ) -> Result<Refined> {
        let (before, mut after) = (self.cost(given)?, self.cost(&last)?);
        let mut last = last;
        if after.total > before.total && certified(self.task, given) {
            (last, after) = (given.clone(), before);
        }
        let durations = |point: &Point| -> Vec<f64> { point.schedule.durations().iter().flatten().copied().collect() };
        let changes: Vec<f64> = durations(given).iter().zip(durations(&last)).map(|(a, b)| (a - b).abs()).collect();
        Ok(Refined {
            status,
            certified: certified(self.task, &last),
            schedule: last.schedule,
            x: last.x,
            before,
            after,
            optimality,
            iterations,
            largest_change: changes.iter().copied().fold(0., f64::max),
            changed: changes.iter().filter(|c| **c > 1e-3).count(),
        })
    }
}

#[cfg(test)]
mod tests;

#[cfg(all(test, feature = "ipopt"))]
mod ipopt_tests;
