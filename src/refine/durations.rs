//! Descent of the optimal cost along the phase durations.
//!
//! Let `V(t)` be the smallest cost of a gait with the phase boundaries and the interval `t`. Where the motion is optimal, the derivative of
//! `V` is that of the Lagrangian at fixed variables and multipliers (envelope theorem):
//!
//! `V' = d/dt (C + l' c + z' g)`.
//!
//! It is a difference of rebuilt problems, in which boundaries that share no row are moved at once (`rows`). A quadratic model of
//! `V`, whose curvature is learned from the steps (`curvature`), gives the next durations within a trust region and above the
//! shortest phases. Closing steps bring the motion onto the rows of these durations, and a few iterations minimise its cost from the
//! multipliers before ([`Solver::resume`]). A step is taken if the cost falls. A step that is refused adds its change of the derivative to
//! the curvature, too: without that ever shorter steps from the same point are predicted by the same wrong model, and 15 searches of five
//! tasks end 0.2 % above those with it in the geometric mean, in 7 % less time.
//!
//! The steps are along `Move`s. With single boundaries alone, the trust region would hold back changes of the lead-in or the tail, which
//! move all boundaries relative to the horizon: ANYmal's trot of 2 m ends at a cost of 1.856 without the common moves and at 1.823 with
//! them.

use super::convex::Step;
use super::convex_cost::Model;
use super::curvature::History;
use super::rows::{Known, Linear, Residuals, Row, Sides, Values, by_group, cost_parts, interval_limits, known, shortest_phases};
use super::variables::{Move, Point, Space};
use super::{RefineSettings, closing_settings, convex};
use crate::error::Result;
use crate::gait::AlignedSchedule;
use crate::gait::cost::{CostWeights, cost};
use crate::nlp::{Problem, trajectory};
use crate::rows::RowKind;
use crate::settings::{OptimiseSettings, SolverSettings, TranscriptionSettings};
use crate::solver::objective::Objective;
use crate::solver::{self, Finish, Outcome, Resume, Solver, Status};
use crate::task::Task;
use std::ops::Range;
use tracing::trace;

/// Barrier parameter with which a minimisation begins. With 1e-5 after a change of the durations, absolute values are rounded too little to
/// move: a gait of ANYmal kept 1.2 % of its cost, which 40 iterations from 1e-4 then saved.
const BARRIER: f64 = 1e-4;
/// Effort of the descents of a search. With 8 iterations after a change of the durations instead of 6, searches of ten tasks ended 1 %
/// higher in the mean, in 7 % more time.
const EFFORT: Effort = Effort { first: 24, iterations: 6, rounded: false };
/// Infeasibility at which the closing steps before a minimisation end. With 1e-4 instead the trot ends at 1.835.
const CLOSED: f64 = 1e-6;
/// Initial and largest step, in the trust lengths of the moves.
const TRUST: [f64; 2] = [0.5, 2.];
/// Trust below which the descent ends.
const LEAST_TRUST: f64 = 0.02;
/// Ratios of actual to predicted decrease below which the trust region shrinks and above which it grows.
const RATIOS: [f64; 2] = [0.3, 0.7];
/// Rise of the cost, in units of its predicted fall, above which the minimisation after a step has failed.
const FAILED: f64 = 4.;
/// Limits of the curvature that is assumed in directions along which none was learned, in costs per squared trust length. Within them it
/// is the median along the stored steps. With the lower limit throughout, the hexapod ends at 1.283 instead of 1.268.
const OTHER_CURVATURE: [f64; 2] = [1e-3, 0.1];

/// A gait after a descent along its durations.
#[derive(Debug, Clone)]
pub struct Timed {
    /// Phase durations.
    pub schedule: AlignedSchedule,
    /// Values of the variables, as in [`Problem::initial`] for this schedule.
    pub x: Vec<f64>,
    /// Effort of all solves.
    pub outcome: Outcome,
}

/// Effort of a descent.
#[derive(Debug, Clone, Copy)]
pub(super) struct Effort {
    /// Largest number of iterations for the given motion.
    pub first: usize,
    /// Largest number of iterations after a change of the durations.
    pub iterations: usize,
    /// True if the cost counts as it is rounded in its rows.
    pub rounded: bool,
}

/// Motion of least cost for its durations.
#[derive(Debug)]
struct Optimum {
    point: Point,
    /// Multipliers of the rows, in the order of [`known`], relative to the weight of the cost.
    multipliers: Values,
    cost: f64,
}

/// Descent of the cost of a gait along its durations. It can be continued, and keeps what it has learned.
#[derive(Debug)]
pub struct Descent<'a> {
    minimiser: Minimiser<'a>,
    moves: Vec<Move>,
    /// Trust length of each move.
    length: Vec<f64>,
    history: History,
    /// Best motion so far.
    now: Optimum,
    trust: f64,
    /// True if the best motion was minimised once only.
    again: bool,
    /// Last step and the derivatives before it, in trust lengths.
    last: Option<(Vec<f64>, Vec<f64>)>,
    /// True if no further step is possible.
    ended: bool,
}

impl<'a> Descent<'a> {
    /// Minimises the cost of a gait with its durations. `None` if its motion cannot be minimised.
    ///
    /// * `schedule`, `x` - the gait, as in [`crate::search::evaluate::Evaluated`]
    /// * `transcription` - settings of its solve, with `momentum` rows
    /// * `weights` - weights of the cost
    /// * `settings` - settings of the solver
    /// * `cancel` - ends the minimisation when it returns true
    pub fn new(
        task: &'a Task,
        (schedule, x): (&AlignedSchedule, &[f64]),
        transcription: &'a TranscriptionSettings,
        weights: &'a CostWeights,
        settings: &SolverSettings,
        cancel: &dyn Fn() -> bool,
    ) -> Option<Self> {
        let space = Space::new(task, schedule, transcription, &RefineSettings::default()).with_cost(weights);
        let from = space.start(schedule, x);
        Descent::within(space, from, weights, settings, EFFORT, cancel)
    }

    /// Minimises the cost of a point of a space with cost rows. `None` if that fails.
    pub(super) fn within(
        space: Space<'a>,
        from: Point,
        weights: &'a CostWeights,
        settings: &SolverSettings,
        effort: Effort,
        cancel: &dyn Fn() -> bool,
    ) -> Option<Self> {
        let mut minimiser = Minimiser::new(space, weights, settings, effort);
        let now = minimiser.optimum(from, None, cancel)?;
        let moves = minimiser.space.moves(&now.point);
        let length = moves.iter().map(|m| m.length).collect();
        let (history, ended) = (History::default(), moves.is_empty());
        Some(Descent { minimiser, moves, length, history, now, trust: TRUST[0], again: true, last: None, ended })
    }

    /// Cost of the best gait so far.
    pub fn cost(&self) -> f64 {
        self.now.cost
    }

    /// Number of minimisations so far.
    pub fn minimisations(&self) -> usize {
        self.minimiser.minimisations
    }

    /// The best gait so far.
    pub fn timed(&self) -> Timed {
        let Point { schedule, x, .. } = &self.now.point;
        Timed { schedule: schedule.clone(), x: x.clone(), outcome: self.minimiser.outcome }
    }

    /// The space and the best point so far.
    pub(super) fn into_parts(self) -> (Space<'a>, Point) {
        (self.minimiser.space, self.now.point)
    }

    /// Takes steps along the durations.
    ///
    /// * `steps` - largest number of changes of the durations
    /// * `cancel` - returns true if the descent is to end with the best durations so far
    pub fn advance(&mut self, steps: usize, cancel: &dyn Fn() -> bool) {
        let mut tried = 0;
        while tried < steps && !self.ended && !cancel() {
            let Ok(slope) = self.minimiser.slope(&self.now, &self.moves) else { break };
            let scaled = relative(&slope, &self.length, |s, l| s * l);
            if let Some((step, before)) = self.last.take() {
                self.history.push(step, scaled.clone(), &before, self.now.cost);
            }
            let model = Model { effort: self.now.cost, effort_by: slope, ..Model::default() };
            let linear = Linear { inequalities: self.minimiser.limits(&self.now.point, &self.moves), ..Linear::default() };
            // Shorter and shorter steps from one point.
            loop {
                self.ended = self.trust < LEAST_TRUST;
                if tried == steps || self.ended || cancel() {
                    return;
                }
                let curvature = self.history.curvature(other_curvature(&self.history));
                let Some(step) = convex::solve(&linear, &model, &curvature, &self.length, self.trust) else { return };
                // A step that cannot be made costs nothing, so it does not count.
                let Some(point) = self.minimiser.after(&self.now.point, &self.moves, &step.by) else {
                    self.shrink(&step);
                    continue;
                };
                tried += 1;
                if self.moved(point, &step, &scaled, cancel) {
                    break;
                }
            }
        }
    }

    /// Largest part of a step, in trust lengths.
    fn length_of(&self, step: &Step) -> f64 {
        step.by.iter().zip(&self.length).map(|(d, l)| (d / l).abs()).fold(0., f64::max)
    }

    /// Makes the trust region smaller than a step.
    fn shrink(&mut self, step: &Step) {
        self.trust = 0.5 * self.length_of(step).min(self.trust);
    }

    /// Tries a step. Returns true if the best motion is another one now.
    ///
    /// * `point` - the best motion with the durations after the step
    /// * `slope` - derivatives at the best motion, in trust lengths
    fn moved(&mut self, point: Point, step: &Step, slope: &[f64], cancel: &dyn Fn() -> bool) -> bool {
        let next = self.minimiser.optimum(point, Some(&self.now.multipliers), cancel);
        let fall = next.as_ref().map_or(f64::NEG_INFINITY, |next| self.now.cost - next.cost);
        let (ratio, trust, cost) = (fall / step.predicted, self.trust, self.now.cost);
        trace!("cost {cost:.5}, predicted fall {:.5}, fall {fall:.5}, trust {trust:.3}", step.predicted);
        let by = relative(&step.by, &self.length, |d, l| d / l);
        if ratio < RATIOS[0] {
            self.shrink(step);
        } else if ratio > RATIOS[1] && self.length_of(step) > 0.9 * trust {
            self.trust = (2. * trust).min(TRUST[1]);
        }
        match next {
            Some(next) if fall > 0. => {
                self.again = true;
                self.last = Some((by, slope.to_vec()));
                self.now = next;
                return true;
            }
            // A refused step says as much about the curvature as one that is taken, unless its minimisation failed.
            Some(refused) => {
                if -fall < FAILED * step.predicted
                    && let Ok(there) = self.minimiser.slope(&refused, &self.moves)
                {
                    self.history.push(by, relative(&there, &self.length, |s, l| s * l), slope, self.now.cost);
                }
            }
            None => {}
        }
        // If a step does not help, the current motion may not be optimal yet.
        std::mem::take(&mut self.again) && {
            let better = self.minimiser.optimum(self.now.point.clone(), Some(&self.now.multipliers), cancel);
            better.filter(|better| better.cost < self.now.cost).map(|better| self.now = better).is_some()
        }
    }
}

/// Minimises the cost of motions with given durations.
#[derive(Debug)]
struct Minimiser<'a> {
    space: Space<'a>,
    weights: &'a CostWeights,
    settings: SolverSettings,
    effort: Effort,
    solver: Solver<f64>,
    /// Effort so far.
    outcome: Outcome,
    /// Number of minimisations so far.
    minimisations: usize,
}

impl<'a> Minimiser<'a> {
    fn new(space: Space<'a>, weights: &'a CostWeights, settings: &SolverSettings, effort: Effort) -> Self {
        // Without iterations of its own a minimisation has no weight for the cost.
        let iterations = settings.optimise.iterations.max(effort.first);
        let optimise = OptimiseSettings { iterations, cost: *weights, cost_limit: None, ..settings.optimise.clone() };
        let settings = SolverSettings { optimise, ..settings.clone() };
        let outcome = Outcome { status: Status::Solved, iterations: 0, factorisations: 0, infeasibility: 0. };
        Minimiser { space, weights, settings, effort, solver: Solver::default(), outcome, minimisations: 0 }
    }

    /// Motion after a step along the moves, not minimised yet; `None` if a phase becomes too short, see [`Space::lasts`]: the limits of
    /// the phases are linear in the moves, but their durations are not.
    fn after(&self, from: &Point, moves: &[Move], step: &[f64]) -> Option<Point> {
        let mut v = from.v.clone();
        for (m, step) in moves.iter().zip(step) {
            m.by.iter().for_each(|(at, by)| v[*at] += by * step);
        }
        self.space.keep_impulses(&from.v, &mut v);
        let point = self.space.point(v).ok()?;
        self.space.lasts(&point.schedule, &from.schedule).then_some(point)
    }

    /// Minimises the cost of the motion with the durations of `point`; `None` if its rows cannot be solved.
    ///
    /// * `multipliers` - of a motion with similar durations
    fn optimum(&mut self, point: Point, multipliers: Option<&Values>, cancel: &dyn Fn() -> bool) -> Option<Optimum> {
        let problem = &point.problem;
        let rows = known(&self.space, problem);
        let multipliers = multipliers.filter(|m| m.len() == rows.iter().map(|row| row.rows).sum::<usize>());
        let mut x = point.x.clone();
        let mut given = solver::Residuals { c: vec![0.; problem.rows.one_sided()], g: vec![0.; problem.inequalities] };
        let mut iterations = self.effort.first;
        if let Some(values) = multipliers {
            scatter(&rows, values, &mut given);
            iterations = self.effort.iterations;
            let mut closing = closing_settings();
            closing.optimise.iterations = 0;
            let outcome = self.solver.solve(problem, &closing, Finish::Infeasibility(CLOSED), Some(&x), cancel);
            if self.counted(outcome).status == Status::Solved {
                x = self.solver.solution();
            }
        }
        self.minimisations += 1;
        let from = Resume { x: &x, multipliers: &given, barrier: BARRIER, iterations };
        let outcome = self.solver.resume(problem, &self.settings, Finish::Rows(self.settings.row_tolerance), &from, cancel);
        if self.counted(outcome).status != Status::Solved {
            return None;
        }
        let found = self.solver.multipliers();
        let multipliers = rows.iter().flat_map(|row| row.values(&found.c, &found.g)).collect();
        let point = self.space.moved(point, self.solver.solution());
        let motion = trajectory(self.space.task, &point.problem.curves, &point.x);
        let robot = &self.space.task.robot;
        let cost = if self.effort.rounded {
            let objective = Objective { weight: 1., rounding: self.settings.optimise.rounding_floor };
            let residuals = Residuals::new(&point.problem, &point.x, false);
            cost_parts(&point.problem, &residuals.c, &objective).into_iter().map(|(_, cost)| cost).sum()
        } else {
            cost(&motion, robot, robot.leg_mass(), self.weights).ok()?.total
        };
        Some(Optimum { point, multipliers, cost })
    }

    /// Adds the effort of a solve.
    fn counted(&mut self, outcome: Outcome) -> Outcome {
        self.outcome.iterations += outcome.iterations;
        self.outcome.factorisations += outcome.factorisations;
        outcome
    }

    /// Derivatives of the cost along the moves.
    fn slope(&self, at: &Optimum, moves: &[Move]) -> Result<Vec<f64>> {
        let (space, optimise) = (&self.space, &self.settings.optimise);
        let objective = Objective { weight: optimise.weight, rounding: optimise.rounding_floor };
        // Constraints weighted by their multipliers, then parts of the cost.
        let lagrangian = |problem: &Problem<f64>, x: &[f64]| -> Vec<(Range<f64>, f64)> {
            let residuals = Residuals::new(problem, x, false);
            let rows = known(space, problem);
            let windows = rows.iter().flat_map(|row| std::iter::repeat_n(&row.window, row.rows));
            let values = residuals.values(&rows).into_iter().zip(&at.multipliers).zip(windows);
            let weighted = values.map(|(((value, lower), (by, by_lower)), window)| {
                (window.clone(), value * by + lower.zip(*by_lower).map_or(0., |(lower, by)| lower * by))
            });
            let costs = cost_parts(problem, &residuals.c, &objective);
            weighted.chain(costs.into_iter().map(|(window, cost)| (window, objective.weight * cost))).collect()
        };
        let (windows, here): (Vec<_>, Vec<f64>) = lagrangian(&at.point.problem, &at.point.x).into_iter().unzip();
        let values = |problem: &Problem<f64>, x: &[f64]| lagrangian(problem, x).into_iter().map(|(_, value)| value).collect();
        let mut slope = vec![0.; space.variables.count];
        by_group(space, &at.point, &windows, &here, &values, Sides::Ahead, &mut |_, variable, by| slope[variable] += by)?;
        Ok(moves.iter().map(|m| m.by.iter().map(|(at, by)| by * slope[*at]).sum::<f64>() / objective.weight).collect())
    }

    /// Limits of the durations as rows of the moves: the shortest phases and the range of the interval.
    fn limits(&self, point: &Point, moves: &[Move]) -> Vec<Row> {
        let along = |row: &Row, m: &Move| -> f64 {
            let by = |at: usize| row.by.iter().filter(|(i, _)| *i == at).map(|(_, by)| by).sum::<f64>();
            m.by.iter().map(|(at, weight)| weight * by(*at)).sum()
        };
        let rows = shortest_phases(&self.space, point).chain(interval_limits(&self.space, point));
        rows.map(|row| {
            let by = moves.iter().map(|m| along(&row, m)).enumerate().filter(|(_, by)| *by != 0.).collect();
            Row { by, ..row }
        })
        .collect()
    }
}

/// Curvature in directions along which none was learned.
fn other_curvature(history: &History) -> f64 {
    history.median().clamp(OTHER_CURVATURE[0], OTHER_CURVATURE[1])
}

/// Values in the unit of trust lengths.
fn relative(values: &[f64], length: &[f64], by: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    values.iter().zip(length).map(|(value, length)| by(*value, *length)).collect()
}

/// Writes values of the constraints to their places in a problem.
fn scatter(rows: &[Known], values: &Values, to: &mut solver::Residuals<f64>) {
    let mut values = values.iter();
    for row in rows {
        for (r, (value, lower)) in values.by_ref().take(row.rows).enumerate() {
            let at = row.place.inequality as usize + r;
            if row.spec.kind == RowKind::Equality {
                to.c[row.place.row as usize + r] = *value;
            } else {
                to.g[at] = *value;
                if let Some(lower) = lower {
                    to.g[at + row.spec.rows] = *lower;
                }
            }
        }
    }
}

#[cfg(test)]
#[path = "durations_tests.rs"]
mod tests;
