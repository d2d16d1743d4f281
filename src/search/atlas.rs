//! An atlas of gaits: what every regular gait of a robot costs at every speed, and where none exists.
//!
//! # How a speed is held
//! A motion starts and ends at rest. Its base speeds up over 30 % of the horizon, moves evenly over 40 %, and slows down over 30 %, as the
//! initial guess has it. Costs are those of whole strides in the even part ([`cost_between`]): what starting and stopping takes is not in
//! them. Horizons are long enough for the even part to last [`Plan::even`], and for the body to lean into its start.
//!
//! # What is not in it
//! A gait that is not certified may exist all the same: the solver is local. Motions are feasible, not optimal; two gaits whose costs are
//! closer than a few percent are equally good.

use crate::backend::Backend;
use crate::error::{Error, Result, check_range};
use crate::gait::Schedule;
use crate::gait::cost::{Cost, CostWeights, cost_between};
use crate::gait::family::{
    ACCELERATION, GaitFamily, MEAN_SPEED, PeriodicGait, TYPICAL_LEAD_IN, TYPICAL_TAIL, families, froude, offsets, speed_scale, time_scale,
};
use crate::robot::{GRAVITY, Robot};
use crate::search::evaluate::{Evaluated, LowerSettings, evaluate};
use crate::solver::Status;
use crate::task::{Goal, Task};
use crate::terrain::{Grid, Shape, Terrain};
use serde::Serialize;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Default speeds, [`speed_scale`]s.
pub const SPEEDS: [f64; 11] = [0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1., 1.3, 1.6];
/// Default periods of a stride, [`time_scale`]s.
pub const PERIODS: [f64; 7] = [1., 1.3, 1.7, 2.2, 2.9, 3.8, 5.];
/// Default shares of a stride that a foot stands.
pub const DUTIES: [f64; 7] = [0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85];
/// Default duration of the even part of a motion, [`time_scale`]s.
pub const EVEN_TIME: f64 = 8.;

/// Part of the horizon that is even; the rest is for starting and stopping.
const EVEN: f64 = 0.4;
/// Largest part of the reach box, along the way, that a stance at even speed may take: a little more than all, since no speed is quite even.
const REACH: f64 = 1.05;
/// Shortest phase, [`time_scale`]s. The grid holds shorter ones: no leg follows them.
const SHORTEST_PHASE: f64 = 0.35;
/// Friction of the ground.
const FRICTION: f64 = 1.;
/// How far a slope goes beyond the goal, m.
const BEYOND: f64 = 10.;
/// Steepest slope.
const MAX_SLOPE: f64 = 1.;
/// Most problems of one atlas.
pub const MAX_PROBLEMS: usize = 1_000_000;

/// Cubic pieces of the force in a stance. With the usual three, forces of feet that overlap cannot add up to the weight: the body bounces,
/// and pays for it, unless the duty suits the pieces. Measured: from eight on costs change no more than solvers differ.
pub const FORCE_PIECES: usize = 8;

/// Settings of the lower level that suit an atlas.
pub fn atlas_settings() -> LowerSettings {
    let mut settings = LowerSettings::default();
    settings.transcription.force_pieces = FORCE_PIECES;
    settings
}

/// What an atlas is made of: every combination of these that a leg can follow.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The robot.
    pub robot: Arc<Robot>,
    /// Gaits.
    pub families: Vec<GaitFamily>,
    /// Periods of a stride, s.
    pub periods: Vec<f64>,
    /// Shares of a stride that a foot stands.
    pub duties: Vec<f64>,
    /// Travel speeds, m/s, from slow to fast.
    pub speeds: Vec<f64>,
    /// Slopes of the ground along the way, rise over run.
    pub slopes: Vec<f64>,
    /// Duration of the even part of a motion, s, at least. Short: a cost of few strides; long: motions that stray from their rollout.
    pub even: f64,
    /// Weights of the cost.
    pub weights: CostWeights,
}

/// One gait at one speed.
#[derive(Debug, Clone)]
struct Problem {
    gait: PeriodicGait,
    speed: f64,
    slope: f64,
    task: Task,
    schedule: Schedule,
}

/// What became of a problem.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Point {
    /// The gait.
    pub family: GaitFamily,
    /// Period of a stride, s.
    pub period: f64,
    /// Share of a stride that a foot stands.
    pub duty: f64,
    /// Travel speed that was asked for, m/s.
    pub speed: f64,
    /// Its Froude number.
    pub froude: f64,
    /// Slope of the ground.
    pub slope: f64,
    /// Number of strides, starting and stopping included.
    pub strides: usize,
    /// How the solve ended.
    pub status: Status,
    /// Whether its motion is certified.
    pub certified: bool,
    /// Iterations of the solver.
    pub iterations: usize,
    /// Speed of the even part, m/s.
    pub even_speed: Option<f64>,
    /// What its even part costs, if certified.
    pub cost: Option<Cost>,
}

/// A speed at which another gait becomes the best.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Transition {
    /// The best below; `None`: no gait exists.
    pub from: Option<GaitFamily>,
    /// The best above.
    pub to: Option<GaitFamily>,
    /// Where the costs of both are the same, m/s, on straight lines between the speeds of the plan.
    pub speed: f64,
    /// Its Froude number.
    pub froude: f64,
}

/// An atlas.
#[derive(Debug, Clone)]
pub struct Atlas {
    /// What was asked for.
    pub plan: Plan,
    /// Problems of the plan.
    pub problems: usize,
    /// Combinations that no leg can follow.
    pub left_out: usize,
    /// What became of the problems, in the order of the plan; fewer when it was cancelled.
    pub points: Vec<Point>,
    /// Time of all of them, s.
    pub seconds: f64,
}

impl Plan {
    /// The default plan of a robot: all its families on level ground.
    pub fn new(robot: Arc<Robot>) -> Plan {
        let (time, speed) = (time_scale(&robot), speed_scale(&robot));
        Plan {
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
    /// [`Error::Invalid`] names the first that is out of its limits, [`Error::Unknown`] a gait that the robot cannot have.
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
                return Err(Error::invalid(name, "none", "at least one"));
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

    /// Problems, and the number of combinations that are none: a foot would leave its reach, or hurry, or the gait be another one.
    fn problems(&self) -> Result<(Vec<Problem>, usize)> {
        let robot = &self.robot;
        let (time, mut problems, mut left_out) = (time_scale(robot), Vec::new(), 0);
        // The foot with the shortest box is the first to leave it.
        let along = robot.reach_boxes().map(|reach| reach.widths()[0]).fold(f64::INFINITY, f64::min);
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
                    // Even for long enough, and no faster to its speed than a body can lean.
                    let ramp = speed / (ACCELERATION * GRAVITY * FRICTION);
                    let horizon = (self.even.max(period) / EVEN).max(ramp / ((1. - EVEN) / 2.));
                    gait.strides = ((horizon - gait.horizon()) / period).ceil().max(1.) as usize;
                    let x = MEAN_SPEED * speed * gait.horizon() / slope.hypot(1.);
                    let terrain = Arc::new(sloping(slope, x));
                    // Along the slope at the goal, as at the start.
                    let task = Task::new(robot.clone(), terrain, Goal::at(x, 0.))?;
                    problems.push(Problem { schedule: gait.schedule()?, gait, speed, slope, task });
                }
            }
        }
        Ok((problems, left_out))
    }

    /// Number of its problems.
    ///
    /// # Errors
    /// As [`Plan::validate`].
    pub fn count(&self) -> Result<usize> {
        self.validate()?;
        Ok(self.problems()?.0.len())
    }

    /// Solves every problem of the plan, `chunk` of them at once.
    ///
    /// * `progress` - told how many problems are done, of how many
    /// * `cancelled` - ends it with the problems that are done
    ///
    /// # Errors
    /// As [`Plan::validate`] and [`evaluate`].
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
        let (problems, left_out) = self.problems()?;
        let mut points = Vec::with_capacity(problems.len());
        for chunk in problems.chunks(chunk.max(1)) {
            let candidates: Vec<(&Task, &Schedule)> = chunk.iter().map(|p| (&p.task, &p.schedule)).collect();
            let evaluated = evaluate(&candidates, settings, None, backend, false, &|| cancelled.load(Ordering::Relaxed))?;
            for (problem, evaluated) in chunk.iter().zip(evaluated) {
                if let Some(evaluated) = evaluated {
                    points.push(point(problem, &evaluated, settings, &self.weights)?);
                }
            }
            progress(points.len(), problems.len());
            if cancelled.load(Ordering::Relaxed) {
                break;
            }
        }
        Ok(Atlas { problems: problems.len(), left_out, points, seconds: start.elapsed().as_secs_f64(), plan: self })
    }
}

impl Atlas {
    /// Least cost of a family at each speed of the plan, on one slope; of equals the first.
    pub fn curve(&self, family: GaitFamily, slope: f64) -> Vec<Option<&Point>> {
        let on = |speed: f64| self.points.iter().filter(move |p| p.family == family && p.slope == slope && p.speed == speed);
        self.plan.speeds.iter().map(|&speed| cheapest(on(speed))).collect()
    }

    /// Least cost of all at each speed of the plan, on one slope.
    pub fn best(&self, slope: f64) -> Vec<Option<&Point>> {
        let on = |speed: f64| self.points.iter().filter(move |p| p.slope == slope && p.speed == speed);
        self.plan.speeds.iter().map(|&speed| cheapest(on(speed))).collect()
    }

    /// Where another gait becomes the best, on one slope, from slow to fast.
    pub fn transitions(&self, slope: f64) -> Vec<Transition> {
        let (best, speeds) = (self.best(slope), &self.plan.speeds);
        let family = |i: usize| best[i].map(|p| p.family);
        let changes = (1..speeds.len()).filter(|&i| family(i - 1) != family(i));
        changes
            .map(|i| {
                let (from, to) = (family(i - 1), family(i));
                // How much the gait from below costs more than that from above, on either side.
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

    /// Problems that were certified.
    pub fn certified(&self) -> usize {
        self.points.iter().filter(|p| p.certified).count()
    }
}

impl Point {
    /// Weighted sum of the costs, if certified.
    pub fn total(&self) -> Option<f64> {
        self.cost.map(|c| c.total)
    }
}

fn cheapest<'a>(points: impl Iterator<Item = &'a Point>) -> Option<&'a Point> {
    points.filter(|p| p.cost.is_some()).min_by(|a, b| a.total().unwrap_or(f64::NAN).total_cmp(&b.total().unwrap_or(f64::NAN)))
}

/// Every triple, the last one fastest.
fn grid<'a>(a: &'a [f64], b: &'a [f64], c: &'a [f64]) -> impl Iterator<Item = (&'a f64, &'a f64, &'a f64)> {
    a.iter().flat_map(move |a| b.iter().flat_map(move |b| c.iter().map(move |c| (a, b, c))))
}

/// Whether a duty is one of the family: on two feet a walk and a run tread alike, and only a run has flight.
fn is_itself(family: GaitFamily, feet: usize, duty: f64) -> bool {
    match family {
        GaitFamily::Walk if feet == 2 => duty >= 0.5,
        GaitFamily::Run => duty < 0.5,
        _ => true,
    }
}

/// Level ground, or a plane that rises along x, for a way along it, m.
fn sloping(slope: f64, way: f64) -> Terrain {
    let far = (way + BEYOND).max(50.);
    let shape = if slope == 0. {
        Shape::Flat
    } else {
        // The last row reaches on to the upper edge.
        Shape::Grid(Grid { low: [-far; 2], high: [3. * far; 2], heights: [-far * slope, far * slope].map(|h| vec![h; 2]).to_vec() })
    };
    Terrain { name: if slope == 0. { "flat".into() } else { format!("slope of {slope}") }, friction: FRICTION, shape }
}

/// The whole strides in the middle of the even part, s.
fn even_part(gait: &PeriodicGait, horizon: f64) -> [f64; 2] {
    let strides = (EVEN * horizon / gait.period() + 1e-9).floor().max(1.);
    let half = (strides * gait.period() / 2.).min(horizon / 2.);
    [horizon / 2. - half, horizon / 2. + half]
}

fn point(problem: &Problem, evaluated: &Evaluated, settings: &LowerSettings, weights: &CostWeights) -> Result<Point> {
    let Problem { gait, speed, slope, task, .. } = problem;
    let robot = &task.robot;
    let cost = if evaluated.feasible {
        let trajectory = evaluated.trajectory(task, &settings.transcription);
        let part = even_part(gait, trajectory.horizon);
        Some(cost_between(&trajectory, robot, robot.leg_mass(), weights, part)?)
    } else {
        None
    };
    Ok(Point {
        family: gait.family,
        period: gait.period(),
        duty: gait.duty(),
        speed: *speed,
        froude: froude(robot, *speed),
        slope: *slope,
        strides: gait.strides,
        status: evaluated.outcome.status,
        certified: evaluated.feasible,
        iterations: evaluated.outcome.iterations,
        even_speed: cost.map(|c| c.distance / c.horizon),
        cost,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn biped() -> Plan {
        Plan::new(Arc::new(Robot::named("biped").unwrap()))
    }

    /// A point of an atlas with nothing but a cost.
    fn at(family: GaitFamily, speed: f64, total: Option<f64>) -> Point {
        let cost = total.map(|total| Cost { total, ..Cost::default() });
        Point {
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

    fn atlas(speeds: Vec<f64>, points: Vec<Point>) -> Atlas {
        Atlas { plan: Plan { speeds, ..biped() }, problems: points.len(), left_out: 0, points, seconds: 0. }
    }

    #[test]
    fn a_transition_lies_where_two_curves_cross() {
        let [walk, run] = [GaitFamily::Walk, GaitFamily::Run];
        let costs = [(walk, 1., 1.), (walk, 1., 1.5), (run, 1., 2.), (walk, 2., 2.), (run, 2., 1.), (run, 2., 3.)];
        let atlas = atlas(vec![1., 2.], costs.map(|(f, v, c)| at(f, v, Some(c))).to_vec());
        assert_eq!(atlas.best(0.).iter().map(|p| p.map(|p| p.family)).collect::<Vec<_>>(), [Some(walk), Some(run)]);
        assert_eq!(atlas.curve(walk, 0.).iter().map(|p| p.and_then(Point::total)).collect::<Vec<_>>(), [Some(1.), Some(2.)]);
        let transitions = atlas.transitions(0.);
        assert_eq!((transitions.len(), transitions[0].from, transitions[0].to, transitions[0].speed), (1, Some(walk), Some(run), 1.5));
        assert!(atlas.best(0.1).iter().all(Option::is_none));
    }

    #[test]
    fn the_end_of_all_gaits_is_a_transition_too() {
        let points = vec![at(GaitFamily::Walk, 1., Some(1.)), at(GaitFamily::Walk, 2., None)];
        let transitions = atlas(vec![1., 2.], points).transitions(0.);
        assert_eq!((transitions[0].from, transitions[0].to, transitions[0].speed), (Some(GaitFamily::Walk), None, 1.5));
    }

    #[test]
    fn problems_are_what_legs_can_follow() {
        let plan = Plan { speeds: vec![0.5], periods: vec![0.5], duties: vec![0.4, 0.6], ..biped() };
        let (problems, left_out) = plan.problems().unwrap();
        let families: Vec<_> = problems.iter().map(|p| (p.gait.family, p.gait.duty() < 0.5)).collect();
        use GaitFamily::{Hop, Run, Walk};
        assert_eq!((families, left_out), (vec![(Walk, false), (Run, true), (Hop, true), (Hop, false)], 2));
        // A stance at 2 m/s of 0.5 s would take 1 m, and the box is 0.5 m long.
        let fast = Plan { speeds: vec![2.], periods: vec![1.], duties: vec![0.5], families: vec![Walk], ..biped() };
        assert_eq!(fast.problems().unwrap().1, 1);
    }

    #[test]
    fn the_even_part_is_whole_strides_in_the_middle() {
        let plan = Plan { speeds: vec![0.5], periods: vec![0.5], duties: vec![0.6], families: vec![GaitFamily::Walk], ..biped() };
        let gait = &plan.problems().unwrap().0[0].gait;
        let [start, end] = even_part(gait, 6.);
        // 40 % of 6 s hold four strides of 0.5 s.
        assert!((start - 2.).abs() < 1e-9 && (end - 4.).abs() < 1e-9, "{start} to {end}");
    }

    #[test]
    fn slopes_rise_along_the_way() {
        let terrain = sloping(0.2, 60.);
        terrain.validate().unwrap();
        assert!((terrain.height(10., 3.) - 2.).abs() < 1e-12 && terrain.height(0., 0.).abs() < 1e-12);
        // To the end of the way and a little farther.
        assert!((terrain.height(60. + BEYOND, 0.) - 0.2 * (60. + BEYOND)).abs() < 1e-9);
        assert_eq!(sloping(0., 60.).shape, Shape::Flat);
    }

    #[test]
    fn bad_plans_are_refused() {
        let refused = |plan: Plan| plan.validate().unwrap_err().to_string();
        assert!(refused(Plan { duties: vec![1.5], ..biped() }).contains("duties[0]"));
        assert!(refused(Plan { speeds: vec![], ..biped() }).contains("speeds"));
        assert!(refused(Plan { speeds: vec![1., 0.5], ..biped() }).contains("speeds[1]: 0.5, but it must be more than 1"));
        assert!(refused(Plan { families: vec![GaitFamily::Trot], ..biped() }).contains("walk, run, hop"));
        assert!(refused(Plan { even: 1e3, ..biped() }).contains("even"));
        biped().validate().unwrap();
    }
}
