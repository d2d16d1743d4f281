//! Atlas of gaits: the cost of every periodic gait of a robot at every speed, and the speeds at which none exists.
//!
//! # Speed
//! A motion starts and ends at rest. In the initial guess the base accelerates over 30 % of the horizon, moves at constant speed over 40 %
//! (the even part) and decelerates over 30 %. One stride in the middle is periodic ([`PeriodicStride`]): it covers the distance of the
//! travel speed, and at its end base and feet are as at its start. The cost is that of this stride ([`cost_between`]), and it is minimised;
//! what comes before and after costs nothing. The horizon is long enough that the even part lasts [`AtlasPlan::even`] and that the
//! acceleration stays within that of [`ACCELERATION`]. The interval between base knots divides the period.
//!
//! If the stride were not periodic, the minimum would spend kinetic energy that was gained before it, and cost less than the work of
//! lifting the weight on a slope.
//!
//! # Limits of an atlas
//! A gait without a certificate may exist all the same, because the solver is local, and so are the minima.

use crate::backend::Backend;
use crate::error::{Error, Result, check_range};
use crate::gait::cost::{Cost, CostWeights, cost_between};
use crate::gait::family::{
    ACCELERATION, GaitFamily, MEAN_SPEED, PeriodicGait, RAMP, TYPICAL_LEAD_IN, TYPICAL_TAIL, families, froude, offsets, speed_scale,
    time_scale,
};
use crate::gait::piece::{Piece, pieces};
use crate::gait::{Curve, Schedule, Trajectory};
use crate::nlp::transcription::interval;
use crate::robot::{GRAVITY, Robot};
use crate::search::evaluate::{Evaluated, LowerSettings, evaluate};
use crate::settings::TranscriptionSettings;
use crate::solver::Status;
use crate::task::{Goal, PeriodicStride, Task};
use crate::terrain::{Grid, Shape, Terrain};
use nalgebra::Vector3;
use serde::Serialize;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Default speeds, in units of [`speed_scale`].
pub const SPEEDS: [f64; 11] = [0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1., 1.3, 1.6];
/// Default stride periods, in units of [`time_scale`].
pub const PERIODS: [f64; 7] = [1., 1.3, 1.7, 2.2, 2.9, 3.8, 5.];
/// Default duty factors: share of a stride during which a foot is in stance.
pub const DUTIES: [f64; 7] = [0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85];
/// Default duration of the even part of a motion, in units of [`time_scale`]; 1.8 s for ANYmal. Over 14 of its gaits, an even part of 2.7 s
/// instead of 1.8 s changes the cost by at most 2.3 %, one of 1.2 s by up to 11 %.
pub const EVEN_TIME: f64 = 8.;

/// Share of the horizon at constant speed; the rest is for starting and stopping.
const EVEN: f64 = 1. - 2. * RAMP;
/// Largest share of the length of the reach box that the base may travel in a stance. Slightly above 1, because the speed is never exactly
/// constant.
const REACH: f64 = 1.05;
/// Shortest phase, in units of [`time_scale`]. Grid points with shorter phases are skipped: no leg can follow them.
const SHORTEST_PHASE: f64 = 0.35;
/// Largest difference between the states at both ends of a periodic stride, m, rad, m/s and rad/s.
pub(crate) const REPEATS: f64 = 1e-3;
/// Friction coefficient of the ground.
const FRICTION: f64 = 1.;
/// Length of a slope beyond the goal, m.
const BEYOND: f64 = 10.;
/// Steepest slope, rise over run.
const MAX_SLOPE: f64 = 1.;
/// Largest number of problems of one atlas.
pub const MAX_PROBLEMS: usize = 1_000_000;

/// Number of cubic pieces of the force in a stance. With three, the forces of overlapping stances cannot add up to the weight:
/// the body bounces, at a cost, unless the duty factor suits the pieces. ANYmal's cheapest trot at 0.25 `sqrt(g l)` costs 0.53
/// with 3 pieces and 0.41, 0.40 and 0.34 with 4, 6 and 8 (effort weight 0.07); eight take 1.2 to 1.6 times the time of four.
pub const FORCE_PIECES: usize = 8;

/// Largest number of iterations of the minimisation.
pub const ITERATIONS: usize = 20;

/// Settings of the lower level for an atlas.
pub fn atlas_settings() -> LowerSettings {
    let mut settings = LowerSettings::default();
    settings.transcription.force_pieces = Some(FORCE_PIECES);
    settings.solver.optimise.iterations = ITERATIONS;
    settings
}

/// Grid of an atlas: every combination of these values that a leg can follow.
#[derive(Debug, Clone)]
pub struct AtlasPlan {
    /// The robot.
    pub robot: Arc<Robot>,
    /// Gait families.
    pub families: Vec<GaitFamily>,
    /// Stride periods, s.
    pub periods: Vec<f64>,
    /// Duty factors: share of a stride during which a foot is in stance.
    pub duties: Vec<f64>,
    /// Travel speeds, m/s, in increasing order.
    pub speeds: Vec<f64>,
    /// Slopes of the ground in travel direction, rise over run.
    pub slopes: Vec<f64>,
    /// Smallest duration of the even part of a motion, s. Too small: the cost averages few strides; too large: motions stray from their
    /// rollout.
    pub even: f64,
    /// Weights of the cost.
    pub weights: CostWeights,
}

/// One grid point: a gait at a speed, with its task and schedule.
#[derive(Debug, Clone)]
struct AtlasProblem {
    gait: PeriodicGait,
    speed: f64,
    slope: f64,
    task: Task,
    schedule: Schedule,
    /// Periodic stride of the task.
    stride: PeriodicStride,
    /// Interval between base knots, s.
    interval: f64,
}

/// Result at one grid point.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AtlasPoint {
    /// Gait family.
    pub family: GaitFamily,
    /// Stride period, s.
    pub period: f64,
    /// Duty factor: share of a stride during which a foot is in stance.
    pub duty: f64,
    /// Requested travel speed, m/s.
    pub speed: f64,
    /// Froude number of the requested speed.
    pub froude: f64,
    /// Slope of the ground, rise over run.
    pub slope: f64,
    /// Number of strides, including starting and stopping.
    pub strides: usize,
    /// Status at the end of the solve.
    pub status: Status,
    /// True if the motion has a valid certificate.
    pub certified: bool,
    /// Number of iterations of the solver.
    pub iterations: usize,
    /// Speed in the even part, m/s; `None` if not certified.
    pub even_speed: Option<f64>,
    /// Cost of the even part; `None` if not certified.
    pub cost: Option<Cost>,
}

/// Speed at which another gait becomes the best.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Transition {
    /// Best gait below this speed; `None` if no gait exists.
    pub from: Option<GaitFamily>,
    /// Best gait above this speed; `None` if no gait exists.
    pub to: Option<GaitFamily>,
    /// Speed at which both costs are equal, interpolated linearly between the speeds of the plan, m/s.
    pub speed: f64,
    /// Froude number of this speed.
    pub froude: f64,
}

/// Results of an atlas.
#[derive(Debug, Clone)]
pub struct Atlas {
    /// Grid that was requested.
    pub plan: AtlasPlan,
    /// Number of grid points that were to be solved.
    pub problems: usize,
    /// Number of combinations that were skipped because no leg can follow them.
    pub left_out: usize,
    /// Results in the order of the plan; fewer than `problems` if the atlas was cancelled.
    pub points: Vec<AtlasPoint>,
    /// Total time, s.
    pub seconds: f64,
}

impl AtlasPlan {
    /// Default plan of a robot: all its families on level ground.
    pub fn new(robot: Arc<Robot>) -> AtlasPlan {
        let (time, speed) = (time_scale(&robot), speed_scale(&robot));
        AtlasPlan {
            families: families(&robot),
            periods: PERIODS.map(|p| p * time).to_vec(),
            duties: DUTIES.to_vec(),
            speeds: SPEEDS.map(|v| v * speed).to_vec(),
            slopes: vec![0.],
            even: EVEN_TIME * time,
            weights: CostWeights::default(),
            robot,
        }
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first value outside its limits, [`Error::Unknown`] a gait that the robot cannot have.
    pub fn validate(&self) -> Result<()> {
        self.robot.validate()?;
        self.weights.validate()?;
        for &family in &self.families {
            offsets(family, &self.robot)?;
        }
        let lists = [
            ("periods", &self.periods, 0.01, 100.),
            ("duties", &self.duties, 0.05, 0.95),
            ("speeds", &self.speeds, 1e-3, 100.),
            ("slopes", &self.slopes, -MAX_SLOPE, MAX_SLOPE),
        ];
        for (name, values, low, high) in lists {
            if values.is_empty() {
                return Err(Error::invalid(name, "empty", "at least one value"));
            }
            for (i, &value) in values.iter().enumerate() {
                check_range(&format!("{name}[{i}]"), value, low, high)?;
            }
        }
        if let Some(i) = (1..self.speeds.len()).find(|&i| self.speeds[i] <= self.speeds[i - 1]) {
            let limit = format!("more than {}, the one before", self.speeds[i - 1]);
            return Err(Error::invalid(format!("speeds[{i}]"), self.speeds[i], limit));
        }
        let sizes = [self.families.len(), self.periods.len(), self.duties.len(), self.speeds.len(), self.slopes.len()];
        let problems = sizes.iter().fold(1usize, |product, &size| product.saturating_mul(size));
        check_range("problems", problems as f64, 1., MAX_PROBLEMS as f64)?;
        check_range("even", self.even, 0.05, 20.)
    }

    /// Problems to solve, and the number of combinations that are skipped because a foot would leave its reach box, a phase would be too
    /// short or the duty factor belongs to another family.
    fn problems(&self, transcription: &TranscriptionSettings) -> Result<(Vec<AtlasProblem>, usize)> {
        let robot = &self.robot;
        let longest = interval(transcription, robot);
        let (time, mut problems, mut left_out) = (time_scale(robot), Vec::new(), 0);
        // The foot with the shortest reach is the first to leave it.
        let along = (0..robot.feet()).map(|foot| robot.reach.width(foot, 0)).fold(f64::INFINITY, f64::min);
        for &slope in &self.slopes {
            for &family in &self.families {
                let offsets = offsets(family, robot)?;
                for (&speed, &period, &duty) in grid(&self.speeds, &self.periods, &self.duties) {
                    let (swing, stance) = ((1. - duty) * period, duty * period);
                    let far = speed * stance > REACH * along;
                    if far || !is_itself(family, robot.feet(), duty) || swing.min(stance) < SHORTEST_PHASE * time * (1. - 1e-9) {
                        left_out += 1;
                        continue;
                    }
                    let (lead_in, tail) = (TYPICAL_LEAD_IN * time, TYPICAL_TAIL * time);
                    let mut gait = PeriodicGait { family, offsets: offsets.clone(), swing, stance, strides: 0, lead_in, tail };
                    // The even part is long enough, and the acceleration stays below ACCELERATION g.
                    let ramp = speed / (ACCELERATION * GRAVITY * FRICTION);
                    let horizon = (self.even.max(period) / EVEN).max(ramp / ((1. - EVEN) / 2.));
                    gait.strides = ((horizon - gait.horizon()) / period).ceil().max(1.) as usize;
                    let intervals = (period / longest - 1e-9).ceil();
                    let (schedule, interval) = (gait.schedule()?, period / intervals);
                    let (count, intervals) = (schedule.intervals(interval), intervals as usize);
                    let along = |time: f64| speed * time / slope.hypot(1.);
                    let x = MEAN_SPEED * along(count as f64 * interval);
                    let terrain = Arc::new(sloping(slope, x));
                    // The base is parallel to the slope at the start and at the goal.
                    let task = Task::new(robot.clone(), terrain, Goal::at(x, 0.))?;
                    let displacement = [along(period), 0., along(period) * slope];
                    let stride = PeriodicStride { start: count.saturating_sub(intervals) / 2, intervals, displacement, costs_alone: true };
                    let task = Task { stride: Some(stride), ..task };
                    problems.push(AtlasProblem { schedule, gait, speed, slope, task, stride, interval });
                }
            }
        }
        Ok((problems, left_out))
    }

    /// Number of problems of the plan.
    ///
    /// # Errors
    /// Errors of [`AtlasPlan::validate`].
    pub fn count(&self) -> Result<usize> {
        self.validate()?;
        Ok(self.problems(&TranscriptionSettings::default())?.0.len())
    }

    /// Solves every problem of the plan, in batches of `chunk`.
    ///
    /// * `progress` - called with the number of finished problems and the total number
    /// * `cancelled` - ends the run; the atlas then has the problems finished so far
    ///
    /// # Errors
    /// Errors of [`AtlasPlan::validate`] and [`evaluate`].
    pub fn run(
        self,
        settings: &LowerSettings,
        backend: &dyn Backend,
        chunk: usize,
        cancelled: &AtomicBool,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Atlas> {
        self.validate()?;
        let start = Instant::now();
        let mut settings = settings.clone();
        settings.solver.optimise.cost = self.weights;
        let (problems, left_out) = self.problems(&settings.transcription)?;
        let mut points: Vec<Option<AtlasPoint>> = problems.iter().map(|_| None).collect();
        let mut done = 0;
        // The candidates of a batch have the same interval.
        let mut order: Vec<usize> = (0..problems.len()).collect();
        order.sort_by(|&a, &b| problems[a].interval.total_cmp(&problems[b].interval));
        let batches = order.chunk_by(|&a, &b| problems[a].interval == problems[b].interval);
        for batch in batches.flat_map(|batch| batch.chunks(chunk.max(1))) {
            settings.transcription.interval = Some(problems[batch[0]].interval);
            let candidates: Vec<(&Task, &Schedule)> = batch.iter().map(|&i| (&problems[i].task, &problems[i].schedule)).collect();
            let evaluated = evaluate(&candidates, &settings, None, backend, false, &|| cancelled.load(Ordering::Relaxed))?;
            for (&i, evaluated) in batch.iter().zip(evaluated) {
                if let Some(evaluated) = evaluated {
                    points[i] = Some(point(&problems[i], &evaluated, &settings, &self.weights)?);
                    done += 1;
                }
            }
            progress(done, problems.len());
            if cancelled.load(Ordering::Relaxed) {
                break;
            }
        }
        let points = points.into_iter().flatten().collect();
        Ok(Atlas { problems: problems.len(), left_out, points, seconds: start.elapsed().as_secs_f64(), plan: self })
    }
}

impl Atlas {
    /// Cheapest result of a family at each speed of the plan on one slope; the first one in a tie.
    pub fn curve(&self, family: GaitFamily, slope: f64) -> Vec<Option<&AtlasPoint>> {
        let on = |speed: f64| self.points.iter().filter(move |p| p.family == family && p.slope == slope && p.speed == speed);
        self.plan.speeds.iter().map(|&speed| cheapest(on(speed))).collect()
    }

    /// Cheapest result of all families at each speed of the plan on one slope.
    pub fn best(&self, slope: f64) -> Vec<Option<&AtlasPoint>> {
        let on = |speed: f64| self.points.iter().filter(move |p| p.slope == slope && p.speed == speed);
        self.plan.speeds.iter().map(|&speed| cheapest(on(speed))).collect()
    }

    /// Speeds at which another gait becomes the best on one slope, in increasing order.
    pub fn transitions(&self, slope: f64) -> Vec<Transition> {
        let (best, speeds) = (self.best(slope), &self.plan.speeds);
        let family = |i: usize| best[i].map(|p| p.family);
        let changes = (1..speeds.len()).filter(|&i| family(i - 1) != family(i));
        changes
            .map(|i| {
                let (from, to) = (family(i - 1), family(i));
                // Cost of the lower gait minus cost of the upper gait, at either end of the speed interval.
                let excess = |at: usize| Some(self.curve(from?, slope)[at]?.total()? - self.curve(to?, slope)[at]?.total()?);
                let part = match (excess(i - 1), excess(i)) {
                    (Some(below), Some(above)) if above > below => below / (below - above),
                    _ => 0.5,
                };
                let speed = speeds[i - 1] + part * (speeds[i] - speeds[i - 1]);
                Transition { from, to, speed, froude: froude(&self.plan.robot, speed) }
            })
            .collect()
    }

    /// Number of certified results.
    pub fn certified(&self) -> usize {
        self.points.iter().filter(|p| p.certified).count()
    }
}

impl AtlasPoint {
    /// Weighted sum of the cost terms; `None` if not certified.
    pub fn total(&self) -> Option<f64> {
        self.cost.map(|c| c.total)
    }
}

/// Result with the lowest cost; the first one in a tie.
fn cheapest<'a>(points: impl Iterator<Item = &'a AtlasPoint>) -> Option<&'a AtlasPoint> {
    points.filter(|p| p.cost.is_some()).min_by(|a, b| a.total().unwrap_or(f64::NAN).total_cmp(&b.total().unwrap_or(f64::NAN)))
}

/// Every triple of the three lists; the last list varies fastest.
fn grid<'a>(a: &'a [f64], b: &'a [f64], c: &'a [f64]) -> impl Iterator<Item = (&'a f64, &'a f64, &'a f64)> {
    a.iter().flat_map(move |a| b.iter().flat_map(move |b| c.iter().map(move |c| (a, b, c))))
}

/// True if the duty factor belongs to the family. A walk and a run on two feet have the same footfall pattern; only a run has a flight
/// phase.
fn is_itself(family: GaitFamily, feet: usize, duty: f64) -> bool {
    match family {
        GaitFamily::Walk if feet == 2 => duty >= 0.5,
        GaitFamily::Run => duty < 0.5,
        _ => true,
    }
}

/// Level ground, or a plane that rises along x.
///
/// * `distance` - distance to travel along x, m
fn sloping(slope: f64, distance: f64) -> Terrain {
    let far = (distance + BEYOND).max(50.);
    let shape = if slope == 0. {
        Shape::Flat
    } else {
        // The last row extends to the upper edge.
        Shape::Grid(Grid { low: [-far; 2], high: [3. * far; 2], heights: [-far * slope, far * slope].map(|h| vec![h; 2]).to_vec() })
    };
    Terrain { name: if slope == 0. { "flat".into() } else { format!("slope of {slope}") }, friction: FRICTION, shape }
}

/// Largest difference between the end of a stride and its start, moved by the displacement, m, rad, m/s and rad/s: pose and rates of the
/// base, positions of the feet. It is read from the curves of the motion.
pub(crate) fn mismatch(motion: &Trajectory, stride: &PeriodicStride, interval: f64) -> f64 {
    let Range { start, end } = stride.times(interval);
    let moved = Vector3::from(stride.displacement);
    // Largest differences of value and slope.
    let apart = |curve: &Curve, moved: Vector3<f64>| -> [f64; 2] {
        let pieces = pieces(curve);
        let ([from, rate], [to, next_rate]) = (Piece::at(&pieces, start), Piece::at(&pieces, end));
        [(to - from - moved).amax(), (next_rate - rate).amax()]
    };
    let base = [apart(&motion.base_lin, moved), apart(&motion.base_ang, Vector3::zeros())];
    let feet = motion.ee.iter().map(|foot| apart(&foot.motion, moved)[0]);
    base.into_iter().flatten().chain(feet).fold(0., f64::max)
}

/// Result at a grid point, with the cost of its stride.
fn point(problem: &AtlasProblem, evaluated: &Evaluated, settings: &LowerSettings, weights: &CostWeights) -> Result<AtlasPoint> {
    let AtlasProblem { gait, speed, slope, task, stride, interval, .. } = problem;
    let robot = &task.robot;
    let trajectory = evaluated.trajectory(task, &settings.transcription);
    let certified = evaluated.feasible && mismatch(&trajectory, stride, *interval) < REPEATS;
    let cost = if certified {
        let Range { start, end } = stride.times(*interval);
        Some(cost_between(&trajectory, robot, robot.leg_mass(), weights, [start, end])?)
    } else {
        None
    };
    Ok(AtlasPoint {
        family: gait.family,
        period: gait.period(),
        duty: gait.duty(),
        speed: *speed,
        froude: froude(robot, *speed),
        slope: *slope,
        strides: gait.strides,
        status: evaluated.outcome.status,
        certified,
        iterations: evaluated.outcome.iterations,
        even_speed: cost.map(|c| c.distance / c.horizon),
        cost,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nlp::Problem;

    fn biped() -> AtlasPlan {
        AtlasPlan::new(Arc::new(Robot::named("biped").unwrap()))
    }

    /// Result of an atlas with nothing but a cost.
    fn at(family: GaitFamily, speed: f64, total: Option<f64>) -> AtlasPoint {
        let cost = total.map(|total| Cost { total, ..Cost::default() });
        AtlasPoint {
            family,
            period: 1.,
            duty: 0.5,
            speed,
            froude: 0.,
            slope: 0.,
            strides: 1,
            status: Status::Solved,
            certified: cost.is_some(),
            iterations: 1,
            even_speed: None,
            cost,
        }
    }

    fn atlas(speeds: Vec<f64>, points: Vec<AtlasPoint>) -> Atlas {
        Atlas { plan: AtlasPlan { speeds, ..biped() }, problems: points.len(), left_out: 0, points, seconds: 0. }
    }

    #[test]
    fn a_transition_lies_where_two_curves_cross() {
        let [walk, run] = [GaitFamily::Walk, GaitFamily::Run];
        let costs = [(walk, 1., 1.), (walk, 1., 1.5), (run, 1., 2.), (walk, 2., 2.), (run, 2., 1.), (run, 2., 3.)];
        let atlas = atlas(vec![1., 2.], costs.map(|(f, v, c)| at(f, v, Some(c))).to_vec());
        assert_eq!(atlas.best(0.).iter().map(|p| p.map(|p| p.family)).collect::<Vec<_>>(), [Some(walk), Some(run)]);
        assert_eq!(atlas.curve(walk, 0.).iter().map(|p| p.and_then(AtlasPoint::total)).collect::<Vec<_>>(), [Some(1.), Some(2.)]);
        let transitions = atlas.transitions(0.);
        assert_eq!((transitions.len(), transitions[0].from, transitions[0].to, transitions[0].speed), (1, Some(walk), Some(run), 1.5));
        assert!(atlas.best(0.1).iter().all(Option::is_none));
    }

    #[test]
    fn the_highest_speed_of_any_gait_is_a_transition() {
        let points = vec![at(GaitFamily::Walk, 1., Some(1.)), at(GaitFamily::Walk, 2., None)];
        let transitions = atlas(vec![1., 2.], points).transitions(0.);
        assert_eq!((transitions[0].from, transitions[0].to, transitions[0].speed), (Some(GaitFamily::Walk), None, 1.5));
    }

    #[test]
    fn combinations_that_legs_cannot_follow_are_skipped() {
        let plan = AtlasPlan { speeds: vec![0.5], periods: vec![0.5], duties: vec![0.4, 0.6], ..biped() };
        let (problems, left_out) = plan.problems(&TranscriptionSettings::default()).unwrap();
        let families: Vec<_> = problems.iter().map(|p| (p.gait.family, p.gait.duty() < 0.5)).collect();
        use GaitFamily::{Hop, Run, Walk};
        assert_eq!((families, left_out), (vec![(Walk, false), (Run, true), (Hop, true), (Hop, false)], 2));
        // A stance of 0.5 s at 2 m/s would take 1 m, but the reach box is 0.5 m long.
        let fast = AtlasPlan { speeds: vec![2.], periods: vec![1.], duties: vec![0.5], families: vec![Walk], ..biped() };
        assert_eq!(fast.problems(&TranscriptionSettings::default()).unwrap().1, 1);
    }

    #[test]
    fn the_stride_is_in_the_middle_and_repeats() {
        for family in [GaitFamily::Walk, GaitFamily::Run] {
            let duty = if family == GaitFamily::Walk { 0.6 } else { 0.4 };
            let plan = AtlasPlan { speeds: vec![0.5], periods: vec![0.5], duties: vec![duty], families: vec![family], ..biped() };
            let problem = &plan.problems(&TranscriptionSettings::default()).unwrap().0[0];
            let schedule = problem.schedule.aligned(problem.interval);
            problem.stride.check(&schedule).unwrap();
            let Range { start, end } = problem.stride.times(problem.interval);
            assert!(
                (end - start - 0.5).abs() < 1e-12 && (start + end - schedule.end()).abs() <= problem.interval + 1e-9,
                "{start} to {end}"
            );
            assert_eq!(problem.stride.displacement, [0.25, 0., 0.]);
            let longer = PeriodicStride { intervals: problem.stride.intervals + 2, ..problem.stride };
            assert!(longer.check(&schedule).unwrap_err().to_string().contains("phases that do not repeat"));
        }
    }

    #[test]
    fn a_periodic_stride_widens_the_front_by_the_state_of_the_base() {
        for (robot, family) in [("anymal", GaitFamily::Trot), ("biped", GaitFamily::Walk), ("pexod", GaitFamily::Tripod)] {
            let plan = AtlasPlan { families: vec![family], ..AtlasPlan::new(Arc::new(Robot::named(robot).unwrap())) };
            let settings = atlas_settings().transcription;
            let (problems, _) = plan.problems(&settings).unwrap();
            let (mut most, mut largest) = (0, [0; 2]);
            for AtlasProblem { task, schedule, stride, interval, .. } in &problems {
                let sizes = [None, Some(*stride)].map(|stride| {
                    let task = Task { stride, ..task.clone() };
                    let steps = Problem::<f32>::new(&task, &schedule.aligned(*interval), &settings).steps;
                    steps.iter().map(|step| step.size).collect::<Vec<u32>>()
                });
                for (without, with) in sizes[0].iter().zip(&sizes[1]) {
                    most = most.max(with - without);
                    largest = [largest[0].max(*without), largest[1].max(*with)];
                }
            }
            // Pose and rates. Footholds and heights stay until a stride later, too, but not those of all feet at once.
            let feet = plan.robot.feet() as u32;
            assert!((12..12 + 5 * feet).contains(&most) && largest[1] <= largest[0] + most, "{robot}: {most}, {largest:?}");
        }
    }

    #[test]
    fn costs_are_those_of_periodic_strides() {
        let plan = AtlasPlan { speeds: vec![0.6], periods: vec![0.6], duties: vec![0.6], families: vec![GaitFamily::Walk], ..biped() };
        let (problems, _) = plan.problems(&TranscriptionSettings::default()).unwrap();
        let mut settings = atlas_settings();
        settings.transcription.interval = Some(problems[0].interval);
        let candidate = (&problems[0].task, &problems[0].schedule);
        let backend = crate::backend::Cpu::new(1).unwrap();
        let evaluated = evaluate(&[candidate], &settings, None, &backend, false, &|| false).unwrap().pop().flatten().unwrap();
        let motion = evaluated.trajectory(&problems[0].task, &settings.transcription);
        let problem = |by: f64| PeriodicStride { displacement: [0.36 + by, 0., 0.], ..problems[0].stride };
        let [right, wrong] = [0., 0.01].map(|by| mismatch(&motion, &problem(by), problems[0].interval));
        assert!(evaluated.feasible && right < 1e-6 && (wrong - 0.01).abs() < 1e-6, "{right:e} {wrong:e}");
        let found = plan.run(&settings, &backend, 1, &AtomicBool::new(false), &mut |_, _| {}).unwrap();
        let cost = found.points[0].cost.unwrap();
        assert!((cost.distance - 0.36).abs() < 1e-5 && (cost.horizon - 0.6).abs() < 1e-9, "{cost:?}");
    }

    #[test]
    fn slopes_rise_in_travel_direction() {
        let terrain = sloping(0.2, 60.);
        terrain.validate().unwrap();
        assert!((terrain.height(10., 3.) - 2.).abs() < 1e-12 && terrain.height(0., 0.).abs() < 1e-12);
        // To the goal and BEYOND it.
        assert!((terrain.height(60. + BEYOND, 0.) - 0.2 * (60. + BEYOND)).abs() < 1e-9);
        assert_eq!(sloping(0., 60.).shape, Shape::Flat);
    }

    #[test]
    fn invalid_plans_are_rejected() {
        let refused = |plan: AtlasPlan| plan.validate().unwrap_err().to_string();
        assert!(refused(AtlasPlan { duties: vec![1.5], ..biped() }).contains("duties[0]"));
        assert!(refused(AtlasPlan { speeds: vec![], ..biped() }).contains("speeds"));
        assert!(refused(AtlasPlan { speeds: vec![1., 0.5], ..biped() }).contains("speeds[1]: 0.5, but it must be more than 1"));
        assert!(refused(AtlasPlan { families: vec![GaitFamily::Trot], ..biped() }).contains("walk, run, hop"));
        assert!(refused(AtlasPlan { even: 1e3, ..biped() }).contains("even"));
        biped().validate().unwrap();
    }
}
