//! Variables of a refinement: those of the problem in an order independent of the durations, and the phase boundaries.
//!
//! A [`Problem`] orders its variables by time, so other durations give another order. Here blocks are ordered by curve: base knots, then
//! for each foot its footholds, swing heights and force nodes. The values are those of the problem except for the rates of the base.
//! These are absolute and multiplied by `h / h_0`, where `h` is the interval of base knots and `h_0` its initial value. Slopes of forces
//! are already per piece. A motion in which only the interval grows therefore follows the same path more slowly.
//!
//! Phase boundaries follow, in intervals. A boundary affects two phases only, whereas a change of a duration would shift everything after
//! it. The last variable, if the horizon is free, is the interval: the number of intervals is fixed, so it determines the horizon.

use super::RefineSettings;
use crate::error::{Error, Result};
use crate::gait::cost::CostWeights;
use crate::gait::family::time_scale;
use crate::gait::schedule::MIN_PHASE;
use crate::gait::{AlignedSchedule, Schedule};
use crate::nlp::Problem;
use crate::nlp::transcription::momentum::PIECE;
use crate::rows::footing::Footing;
use crate::rows::table::NONE;
use crate::settings::TranscriptionSettings;
use crate::task::Task;

/// Relative amount by which a phase may be shorter than the shortest. Closing steps do not correct it.
pub(super) const SHORT: f64 = 1e-3;
/// Step of a base position at trust 1, m.
const POSITION_STEP: f64 = 0.05;
/// Step of an attitude angle at trust 1, rad.
const ANGLE_STEP: f64 = 0.1;
/// Step of a velocity or angular rate at trust 1, m/s or rad/s.
const RATE_STEP: f64 = 0.5;
/// Step of a foothold at trust 1, m.
const FOOTHOLD_STEP: f64 = 0.05;
/// Step of a swing height at trust 1, m.
const HEIGHT_STEP: f64 = 0.05;
/// Step of a force, and of its change over a piece, at trust 1, in weights per foot.
const FORCE_STEP: f64 = 1.;
/// Step of a phase boundary at trust 1, in units of [`time_scale`].
const BOUNDARY_STEP: f64 = 0.1;
/// Step of the interval at trust 1, relative to the interval.
const INTERVAL_STEP: f64 = 0.03;

/// Positions of the variables. Fixed values are `None`.
#[derive(Debug, Clone)]
pub(super) struct Variables {
    /// Number of variables.
    pub count: usize,
    /// First variable of each block at the base knots: pose and rates alternate.
    pub base: Vec<Option<usize>>,
    /// Variables of each foot.
    pub feet: Vec<FootVariables>,
    /// Variable of the interval.
    pub interval: Option<usize>,
    /// Trust length of each variable: its largest step at trust 1.
    pub step: Vec<f64>,
}

/// First variables of one foot's blocks.
#[derive(Debug, Clone, Default)]
pub(super) struct FootVariables {
    /// Foothold of each stance.
    pub footholds: Vec<Option<usize>>,
    /// Height of each swing.
    pub heights: Vec<Option<usize>>,
    /// Force nodes of each stance.
    pub force_nodes: Vec<Vec<Option<usize>>>,
    /// Ends of all phases but the last; `None` if durations are fixed.
    pub boundaries: Vec<Option<usize>>,
}

/// A point in the space of the variables, with its schedule and problem.
#[derive(Debug, Clone)]
pub(super) struct Point {
    /// Values of the variables.
    pub v: Vec<f64>,
    /// Phase durations.
    pub schedule: AlignedSchedule,
    /// Problem of the schedule.
    pub problem: Problem<f64>,
    /// Values of the problem's variables, including fixed ones.
    pub x: Vec<f64>,
}

/// A move of the durations.
#[derive(Debug, Clone)]
pub(super) struct Move {
    /// Variables that it changes, and their changes per unit.
    pub by: Vec<(usize, f64)>,
    /// Step at trust 1.
    pub length: f64,
}

/// Data shared by all points.
#[derive(Debug)]
pub(super) struct Space<'a> {
    pub task: &'a Task,
    pub settings: &'a TranscriptionSettings,
    /// Weights of the cost rows of its problems; `None`: no cost rows.
    cost: Option<&'a CostWeights>,
    pub variables: Variables,
    /// Initial boxes of the footholds. Other durations do not move them.
    footings: Vec<Footing<f64>>,
    /// Initial interval, s.
    pub interval: f64,
    /// Number of intervals.
    pub intervals: usize,
    /// Initial ends of all phases but the last, in intervals, `[feet][phases - 1]`.
    boundaries: Vec<Vec<f64>>,
    /// Shortest allowed duration of each phase, s, `[feet][phases]`.
    pub shortest: Vec<Vec<f64>>,
}

impl<'a> Space<'a> {
    /// Problem of a schedule, with the initial boxes of the footholds.
    fn problem(&self, schedule: &AlignedSchedule) -> Problem<f64> {
        let mut problem = Problem::<f64>::with_cost(self.task, schedule, self.settings, self.cost);
        for (footing, start) in problem.tables.footings.iter_mut().zip(&self.footings) {
            (footing.low, footing.high) = (start.low, start.high);
        }
        problem
    }

    /// Space of the variables around a gait.
    pub fn new(task: &'a Task, schedule: &AlignedSchedule, transcription: &'a TranscriptionSettings, settings: &RefineSettings) -> Self {
        let problem = Problem::<f64>::new(task, schedule, transcription);
        let (interval, intervals) = (schedule.interval(), schedule.count());
        let mut space = Allot { problem: &problem, step: Vec::new() };
        let base = problem.curves.base.iter().enumerate().map(|(i, &at)| {
            let steps = if i % 2 == 0 { [POSITION_STEP, ANGLE_STEP] } else { [RATE_STEP; 2] };
            space.block(at, &[[steps[0]; 3], [steps[1]; 3]].concat())
        });
        let base = base.collect();
        let time = time_scale(&task.robot);
        let feet = problem.curves.feet.iter().map(|foot| FootVariables {
            footholds: foot.footholds.iter().map(|&at| space.block(at, &[FOOTHOLD_STEP; 2])).collect(),
            heights: foot.heights.iter().map(|&at| space.block(at, &[HEIGHT_STEP])).collect(),
            force_nodes: foot.force_nodes.iter().map(|nodes| nodes.iter().map(|&at| space.block(at, &[FORCE_STEP; 6])).collect()).collect(),
            boundaries: vec![None; foot.phases.len() - 1],
        });
        let mut feet: Vec<FootVariables> = feet.collect();
        let mut step = space.step;
        let mut another = |by: f64| {
            step.push(by);
            step.len() - 1
        };
        if settings.durations {
            for boundary in feet.iter_mut().flat_map(|f| &mut f.boundaries) {
                *boundary = Some(another(BOUNDARY_STEP * time / interval));
            }
        }
        let free = settings.horizon && task.duration.is_none() && feet.iter().any(|f| !f.boundaries.is_empty());
        let of_interval = free.then(|| another(INTERVAL_STEP * interval));
        let variables = Variables { count: step.len(), base, feet, interval: of_interval, step };
        let phases = |foot: usize| schedule.phases(foot);
        let ends = |foot: usize| phases(foot).iter().map(|p| p.end / interval).take(phases(foot).len() - 1).collect();
        let least = (settings.shortest_phase * time).max(MIN_PHASE);
        let shortest = |foot: usize| phases(foot).iter().map(|p| p.duration().min(least)).collect();
        Space {
            task,
            settings: transcription,
            cost: None,
            variables,
            footings: problem.tables.footings.clone(),
            interval,
            intervals,
            boundaries: (0..schedule.feet()).map(ends).collect(),
            shortest: (0..schedule.feet()).map(shortest).collect(),
        }
    }

    /// The space with problems that have cost rows.
    pub fn with_cost(self, weights: &'a CostWeights) -> Self {
        Space { cost: Some(weights), ..self }
    }

    /// Moves of the durations: every phase boundary, the interval, and two common moves of all boundaries, by the same time and in
    /// proportion to their times.
    pub fn moves(&self, point: &Point) -> Vec<Move> {
        let alone = |at: usize| Move { by: vec![(at, 1.)], length: self.variables.step[at] };
        let boundaries: Vec<usize> = self.variables.feet.iter().flat_map(|foot| &foot.boundaries).copied().flatten().collect();
        let mut moves: Vec<Move> = boundaries.iter().copied().chain(self.variables.interval).map(alone).collect();
        if let Some(first) = boundaries.first() {
            moves.push(Move { by: boundaries.iter().map(|at| (*at, 1.)).collect(), length: self.variables.step[*first] });
            moves.push(Move { by: boundaries.iter().map(|at| (*at, point.v[*at])).collect(), length: INTERVAL_STEP });
        }
        moves
    }

    /// Smallest and largest interval, s. Within them, base curves and reach rows divide an interval into as many pieces as initially, so
    /// that no row appears or disappears.
    pub fn interval_limits(&self) -> [f64; 2] {
        let pieces = (self.interval / PIECE).ceil();
        [(pieces - 1.).max(0.5) * PIECE + PIECE * 1e-6, pieces * PIECE * (1. - 1e-6)]
    }

    /// True if phases are long enough after a step: none is too short by more than [`SHORT`], or none by more than before.
    pub fn lasts(&self, schedule: &AlignedSchedule, before: &AlignedSchedule) -> bool {
        let short = self.shortness(schedule);
        short < SHORT || short <= self.shortness(before)
    }

    /// Largest relative shortfall of a phase from its shortest duration; negative or zero if no phase is too short.
    fn shortness(&self, schedule: &AlignedSchedule) -> f64 {
        let phases = schedule.durations().iter().flatten().zip(self.shortest.iter().flatten());
        phases.map(|(duration, shortest)| 1. - duration / shortest).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Interval at a point, s.
    pub fn interval_at(&self, v: &[f64]) -> f64 {
        self.variables.interval.map_or(self.interval, |at| v[at])
    }

    /// End of a phase, in intervals.
    pub fn boundary(&self, v: &[f64], foot: usize, phase: usize) -> f64 {
        self.variables.feet[foot].boundaries[phase].map_or(self.boundaries[foot][phase], |at| v[at])
    }

    /// Point with given values of the variables.
    ///
    /// # Errors
    /// [`Error::Invalid`] if a phase is shorter than schedules allow.
    pub fn point(&self, v: Vec<f64>) -> Result<Point> {
        let interval = self.interval_at(&v);
        let durations = (0..self.boundaries.len()).map(|foot| {
            let ends = (0..self.boundaries[foot].len()).map(|phase| self.boundary(&v, foot, phase) * interval);
            let ends: Vec<f64> = std::iter::once(0.).chain(ends).chain([self.intervals as f64 * interval]).collect();
            ends.windows(2).map(|w| w[1] - w[0]).collect()
        });
        let schedule = Schedule::new(durations.collect())?.aligned(interval);
        if schedule.count() != self.intervals {
            return Err(Error::invalid("durations", format!("{} intervals", schedule.count()), format!("{} intervals", self.intervals)));
        }
        let problem = self.problem(&schedule);
        let mut x = problem.initial.clone();
        self.pairs(&problem, |at, variable, of_rate| x[at] = of_rate.map_or(v[variable], |(scale, line)| v[variable] * scale - line));
        Ok(Point { v, schedule, problem, x })
    }

    /// Scales the forces of every stance so that their impulses stay the same when the durations change.
    ///
    /// * `before`, `v` - values of the variables before and after the change
    pub fn keep_impulses(&self, before: &[f64], v: &mut [f64]) {
        for (foot, of_foot) in self.variables.feet.iter().enumerate() {
            let last = self.boundaries[foot].len();
            for (stance, nodes) in of_foot.force_nodes.iter().enumerate() {
                let duration = |v: &[f64]| {
                    let start = if stance == 0 { 0. } else { self.boundary(v, foot, 2 * stance - 1) };
                    let end = if 2 * stance == last { self.intervals as f64 } else { self.boundary(v, foot, 2 * stance) };
                    (end - start) * self.interval_at(v)
                };
                let ratio = duration(before) / duration(v);
                for node in nodes.iter().flatten() {
                    v[*node..node + 6].iter_mut().for_each(|f| *f *= ratio);
                }
            }
        }
    }

    /// Point with the schedule of another one and new values of its problem.
    pub fn moved(&self, point: Point, x: Vec<f64>) -> Point {
        let mut v = point.v;
        self.pairs(&point.problem, |at, variable, of_rate| v[variable] = of_rate.map_or(x[at], |(scale, line)| (x[at] + line) / scale));
        Point { v, x, ..point }
    }

    /// Point of the initial gait.
    pub fn start(&self, schedule: &AlignedSchedule, x: &[f64]) -> Point {
        let mut v = vec![0.; self.variables.count];
        for (foot, ends) in self.variables.feet.iter().zip(&self.boundaries) {
            for (at, end) in foot.boundaries.iter().zip(ends) {
                if let Some(at) = at {
                    v[*at] = *end;
                }
            }
        }
        if let Some(at) = self.variables.interval {
            v[at] = self.interval;
        }
        let problem = self.problem(schedule);
        self.moved(Point { v, schedule: schedule.clone(), problem, x: x.to_vec() }, x.to_vec())
    }

    /// Point of a gait that was refined from the initial one.
    #[cfg(all(test, feature = "ipopt"))]
    pub fn found(&self, schedule: &AlignedSchedule, x: &[f64]) -> Point {
        let mut v = vec![0.; self.variables.count];
        for (foot, of_foot) in self.variables.feet.iter().enumerate() {
            for (at, phase) in of_foot.boundaries.iter().zip(schedule.phases(foot)) {
                if let Some(at) = at {
                    v[*at] = phase.end / schedule.interval();
                }
            }
        }
        if let Some(at) = self.variables.interval {
            v[at] = schedule.interval();
        }
        let problem = self.problem(schedule);
        self.moved(Point { v, schedule: schedule.clone(), problem, x: x.to_vec() }, x.to_vec())
    }

    /// Visits every free value of a problem: its position in `x`, its variable, and for a rate its scale and the rate of the reference line,
    /// `x = v scale - line`.
    fn pairs(&self, problem: &Problem<f64>, mut visit: impl FnMut(usize, usize, Option<(f64, f64)>)) {
        let mut block = |at: u32, variable: Option<usize>, len: usize, line: Option<&[f64; 6]>| {
            if let Some(first) = variable {
                let scale = self.interval / problem.curves.interval;
                (0..len).for_each(|d| visit(at as usize + d, first + d, line.map(|l| (scale, l[d]))));
            }
        };
        let line = problem.momentum_intervals.first().map(|i| i.rate).unwrap_or_default();
        for (i, (&at, &variable)) in problem.curves.base.iter().zip(&self.variables.base).enumerate() {
            block(at, variable, 6, (i % 2 == 1).then_some(&line));
        }
        for (blocks, variables) in problem.curves.feet.iter().zip(&self.variables.feet) {
            blocks.footholds.iter().zip(&variables.footholds).for_each(|(&at, &v)| block(at, v, 2, None));
            blocks.heights.iter().zip(&variables.heights).for_each(|(&at, &v)| block(at, v, 1, None));
            let nodes = blocks.force_nodes.iter().flatten().zip(variables.force_nodes.iter().flatten());
            nodes.for_each(|(&at, &v)| block(at, v, 6, None));
        }
    }

    /// Variable of each position in `x`, and the derivative of that value with respect to it.
    pub fn columns(&self, problem: &Problem<f64>) -> Vec<(usize, f64)> {
        let mut columns = vec![(usize::MAX, 0.); problem.variables];
        self.pairs(problem, |at, variable, of_rate| columns[at] = (variable, of_rate.map_or(1., |(scale, _)| scale)));
        columns
    }
}

/// Assigns variables to blocks.
struct Allot<'a> {
    problem: &'a Problem<f64>,
    step: Vec<f64>,
}

impl Allot<'_> {
    fn block(&mut self, at: u32, steps: &[f64]) -> Option<usize> {
        if at == NONE || at as usize >= self.problem.variables {
            return None;
        }
        self.step.extend_from_slice(steps);
        Some(self.step.len() - steps.len())
    }
}
