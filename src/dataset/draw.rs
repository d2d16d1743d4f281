//! Draws: the command, gait and task of a motion, as functions of the seed, the robot and the number of the draw.

use super::spec::{DatasetPlan, Ground, Kind};
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::gait::family::{
    FOOT_SPEED_SCALED, GaitFamily, MEAN_SPEED, MIN_PHASE_SCALED, PeriodicGait, RAMP, REACH_SHARE, TYPICAL_LEAD_IN, TYPICAL_TAIL, offsets,
    speed_scale, time_scale,
};
use crate::gait::swing::TOP_SPEED;
use crate::nlp::transcription::interval;
use crate::planner::{Contact, Cycle};
use crate::robot::{ReachBox, Robot};
use crate::search::cem::random::Draws;
use crate::search::evaluate::{LowerSettings, check_candidate};
use crate::task::{Goal, PeriodicStride, Task};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Relative standard deviations of the duration of a swing and of rests, standard deviation of the duty factor, and largest number of
/// standard deviations drawn.
const SWING_STD: f64 = 0.12;
const REST_STD: f64 = 0.25;
const DUTY_STD: f64 = 0.05;
const MOST_STDS: f64 = 2.;
/// Smallest and largest duty factor drawn.
const DUTIES: [f64; 2] = [0.3, 0.85];
/// Time over which the slope of the ground under the base is measured, s, and steepest slope of the velocity at an end.
const SLOPE_TIME: f64 = 0.2;
const STEEPEST: f64 = 0.7;
/// Largest share of its reach by which a foot is away from its nominal position at a start in motion.
const FIRST_FOOTHOLD: f64 = 0.45;

// Dimensions of the random numbers of a draw.
const FORWARD: usize = 0;
const PLACE: usize = 3;
const SWING: usize = 6;
const DUTY: usize = 7;
const PHASE: usize = 8;
const LEAD_IN: usize = 9;
const TAIL: usize = 10;

/// Gait of a motion as a function of time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Stride {
    /// Period of a stride, s.
    pub period: f64,
    /// Phase at the start, in strides; the foot with offset `phi` lifts off at phase `phi`.
    pub phase: f64,
    /// Time during which all feet stand at the start, s.
    pub lead_in: f64,
    /// Largest number of strides since the first lift-off; unlimited if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub strides: Option<f64>,
}

impl Stride {
    /// Fraction of the stride that has passed, in \[0, 1\).
    pub fn at(&self, time: f64) -> f64 {
        let passed = ((time - self.lead_in) / self.period).clamp(0., self.strides.unwrap_or(f64::INFINITY));
        // The remainder of a tiny negative number rounds to 1.
        let phase = (self.phase + passed).rem_euclid(1.);
        if phase < 1. { phase } else { 0. }
    }
}

/// Draw that a motion comes from: the key `draw` of its line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Drawn {
    /// Number of the draw of its robot.
    pub number: usize,
    /// Gait family.
    pub family: GaitFamily,
    /// Ends of the motion.
    pub kind: Kind,
    /// Commanded speeds forward and to the left, m/s, and yaw rate, rad/s, in the frame of the base.
    pub command: [f64; 3],
    /// Start: x, y, m, and yaw, rad.
    pub start: [f64; 3],
    /// Gait as a function of time.
    #[serde(flatten)]
    pub stride: Stride,
    /// Start and end of the stride that repeats, s, for a periodic motion.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats: Option<[f64; 2]>,
}

/// A motion to solve.
#[derive(Debug, Clone)]
pub struct Draw {
    /// Draw.
    pub drawn: Drawn,
    /// Task.
    pub task: Task,
    /// Contact schedule.
    pub schedule: Schedule,
}

/// Interval between base knots with which all motions of a robot are solved, s: it divides the duration of a motion.
pub fn common_interval(length: f64, settings: &LowerSettings, robot: &Robot) -> f64 {
    length / (length / interval(&settings.transcription, robot) - 1e-9).ceil().max(1.)
}

/// Durations of a gait, s.
#[derive(Clone, Copy)]
struct Durations {
    swing: f64,
    stance: f64,
}

impl Durations {
    fn period(&self) -> f64 {
        self.swing + self.stance
    }

    /// Scales the gait to another period, s.
    fn with_period(self, period: f64) -> Durations {
        let scale = period / self.period();
        Durations { swing: scale * self.swing, stance: scale * self.stance }
    }
}

/// Draws a motion; `None` if no leg can follow its command, or its task is impossible.
///
/// * `subject` - index of the robot
/// * `settings` - settings with the interval of the robot
pub fn draw(plan: &DatasetPlan, subject: usize, number: usize, settings: &LowerSettings) -> Option<Draw> {
    let (spec, of) = (&plan.spec, &plan.subjects[subject]);
    let (ground, family, command, kind) = of.combinations[number % of.combinations.len()];
    let mut draws = Draws::new(spec.seed, subject, number);
    let mut within = |dimension: usize, [low, high]: [f64; 2]| low + (high - low) * draws.uniform(dimension);
    let ranges = &spec.commands[command];
    let mut command = [ranges.forward, ranges.sideways, ranges.yaw];
    if kind == Kind::Periodic {
        command[2] = [0.; 2];
    }
    let even = match kind {
        Kind::Rest => MEAN_SPEED,
        Kind::Start => 1. - RAMP / 2.,
        Kind::Steady | Kind::Periodic => 1.,
    } * spec.length;
    let scale = if ranges.displacement { even } else { 1. };
    let command: [f64; 3] = std::array::from_fn(|i| within(FORWARD + i, command[i]) / scale);
    let start: [f64; 3] = std::array::from_fn(|i| within(PLACE + i, plan.grounds[ground].start[i]));
    let request = Request { robot: &of.robot, ground: &plan.grounds[ground], family, kind, command, start, even, length: spec.length };
    let (task, schedule, stride) = request.solved_for(&mut draws, settings).ok()?;
    let times = task.stride.map(|repeats| repeats.times(interval(&settings.transcription, &of.robot)));
    let repeats = times.map(|times| [times.start, times.end]);
    Some(Draw { drawn: Drawn { number, family, kind, command, start, stride, repeats }, task, schedule })
}

/// Command with its robot and ground.
struct Request<'a> {
    robot: &'a Arc<Robot>,
    ground: &'a Ground,
    family: GaitFamily,
    kind: Kind,
    command: [f64; 3],
    start: [f64; 3],
    /// Time for which the base would travel at the commanded velocity to cover its displacement, s.
    even: f64,
    length: f64,
}

impl Request<'_> {
    /// Task, schedule and stride.
    ///
    /// # Errors
    /// For a command that no leg can follow, and a task that is impossible.
    fn solved_for(&self, draws: &mut Draws, settings: &LowerSettings) -> Result<(Task, Schedule, Stride)> {
        let offsets = offsets(self.family, self.robot)?;
        let interval = interval(&settings.transcription, self.robot);
        let drawn = self.durations(draws)?;
        let mut rest = |dimension: usize, typical: f64| {
            typical * time_scale(self.robot) * (REST_STD * draws.normal(dimension).clamp(-MOST_STDS, MOST_STDS)).exp()
        };
        let rests = [rest(LEAD_IN, TYPICAL_LEAD_IN), rest(TAIL, TYPICAL_TAIL)];
        let (schedule, durations, stride) = self.schedule(drawn, rests, &offsets, draws.uniform(PHASE), interval)?;
        self.check_durations(&durations)?;
        let task = self.task(&schedule, &durations)?;
        let task = if self.kind == Kind::Periodic { self.with_stride(task, &durations, interval) } else { task };
        check_candidate(&task, &schedule, settings)?;
        Ok((task, schedule, stride))
    }

    /// Durations around the typical ones of the family, with stances that are short enough for the command.
    fn durations(&self, draws: &mut Draws) -> Result<Durations> {
        let typical = self.family.typical(self.robot.feet());
        let mut normal = |dimension: usize| draws.normal(dimension).clamp(-MOST_STDS, MOST_STDS);
        let swing = typical.swing * time_scale(self.robot) * (SWING_STD * normal(SWING)).exp();
        let duty = (typical.duty + DUTY_STD * normal(DUTY)).clamp(DUTIES[0], DUTIES[1]);
        let stance = (swing * duty / (1. - duty)).min(self.longest_stance());
        Ok(Durations { swing, stance })
    }

    /// Velocity of a nominal foothold in the base frame at the commanded velocity, m/s.
    fn velocity_of(&self, foot: &[f64; 3]) -> [f64; 2] {
        let [forward, sideways, yaw] = self.command;
        [forward - yaw * foot[1], sideways + yaw * foot[0]]
    }

    /// Longest stance in which no foot uses more than its share of the reach, s.
    fn longest_stance(&self) -> f64 {
        let feet = self.robot.nominal_feet.iter().zip(self.robot.reach_boxes());
        let of_foot = |(foot, reach): (&[f64; 3], ReachBox)| {
            let (velocity, widths) = (self.velocity_of(foot), reach.widths());
            [0, 1].map(|axis| REACH_SHARE * widths[axis] / velocity[axis].abs().max(1e-9)).into_iter().fold(f64::INFINITY, f64::min)
        };
        feet.map(of_foot).fold(f64::INFINITY, f64::min)
    }

    /// Checks that phases are not too short, swings not too fast, and the duty factor is that of the family.
    fn check_durations(&self, durations: &Durations) -> Result<()> {
        let Durations { swing, stance } = *durations;
        let shortest = MIN_PHASE_SCALED * time_scale(self.robot) * (1. - 1e-9);
        let fastest = self.robot.nominal_feet.iter().map(|foot| self.velocity_of(foot)).map(|[x, y]| x.hypot(y)).fold(0., f64::max);
        let foot_speed = TOP_SPEED * fastest * durations.period() / swing;
        let limit = FOOT_SPEED_SCALED * speed_scale(self.robot);
        let own = match self.family {
            GaitFamily::Walk if self.robot.feet() == 2 => stance >= swing,
            GaitFamily::Run => stance < swing,
            _ => true,
        };
        if stance.min(swing) < shortest || stance > self.longest_stance() * (1. + 1e-9) || foot_speed > limit || !own {
            return Err(Error::invalid("command", format!("{:?}", self.command), format!("one that a {} can follow", self.family)));
        }
        Ok(())
    }

    /// Schedule of exactly the duration of a motion, with its durations and stride.
    ///
    /// * `rests` - time during which all feet stand at a start and at an end at rest, s
    fn schedule(
        &self,
        drawn: Durations,
        [lead_in, tail]: [f64; 2],
        offsets: &[f64],
        phase: f64,
        interval: f64,
    ) -> Result<(Schedule, Durations, Stride)> {
        let latest = offsets.iter().copied().fold(0., f64::max);
        match self.kind {
            Kind::Rest => {
                let moving = self.length - lead_in - tail;
                let strides = (moving / drawn.period() - latest).round().max(1.);
                let own = drawn.with_period(moving / (strides + latest));
                let Durations { swing, stance } = own;
                let strides = strides as usize;
                let gait = PeriodicGait { family: self.family, offsets: offsets.to_vec(), swing, stance, strides, lead_in, tail };
                let strides = Some(strides as f64 + latest);
                Ok((gait.schedule()?, own, Stride { period: own.period(), phase: 0., lead_in, strides }))
            }
            Kind::Start => {
                let cycle = Cycle { family: Some(self.family), swing: drawn.swing, stance: drawn.stance, phase };
                let moving = cycle.schedule(offsets, &vec![Contact::STANDING; offsets.len()], self.length - lead_in)?;
                let mut durations = moving.durations().to_vec();
                durations.iter_mut().for_each(|phases| phases[0] += lead_in);
                let stride = Stride { period: drawn.period(), phase, lead_in, strides: None };
                Ok((Schedule::new(durations)?, drawn, stride))
            }
            Kind::Steady | Kind::Periodic => {
                let own = if self.kind == Kind::Periodic {
                    // A stride that repeats takes whole intervals.
                    drawn.with_period((drawn.period() / interval).round().max(1.) * interval)
                } else {
                    drawn
                };
                let cycle = Cycle { family: Some(self.family), swing: own.swing, stance: own.stance, phase };
                let schedule = cycle.schedule(offsets, &vec![Contact::STANDING; offsets.len()], self.length)?;
                Ok((schedule, own, Stride { period: own.period(), phase, lead_in: 0., strides: None }))
            }
        }
    }

    /// Commanded velocity at an end, world frame.
    fn velocity(&self, [x, y]: [f64; 2], yaw: f64) -> [f64; 3] {
        let [forward, sideways, _] = self.command;
        let (sin, cos) = yaw.sin_cos();
        let [vx, vy] = [cos * forward - sin * sideways, sin * forward + cos * sideways];
        let height = |time: f64| self.ground.terrain.height(x + vx * time, y + vy * time);
        let rise = (height(SLOPE_TIME) - height(-SLOPE_TIME)) / (2. * SLOPE_TIME);
        let steepest = STEEPEST * vx.hypot(vy);
        [vx, vy, rise.clamp(-steepest, steepest)]
    }

    /// Task between the start and the place to which the command leads.
    fn task(&self, schedule: &Schedule, durations: &Durations) -> Result<Task> {
        let ([x, y, heading], [forward, sideways, yaw]) = (self.start, self.command);
        // Displacement at constant speeds in the frame of the start.
        let turn = yaw * self.even;
        let [along, across] = if turn.abs() < 1e-6 {
            [forward * self.even, sideways * self.even]
        } else {
            let (sin, cos) = turn.sin_cos();
            [(forward * sin - sideways * (1. - cos)) / yaw, (forward * (1. - cos) + sideways * sin) / yaw]
        };
        let (sin, cos) = heading.sin_cos();
        let end = [x + cos * along - sin * across, y + sin * along + cos * across];
        let mut from = Goal::at(x, y).yaw(heading);
        let mut to = Goal::at(end[0], end[1]).yaw(heading + turn);
        if self.kind != Kind::Rest {
            to = Goal { rates: [0., 0., yaw], ..to.velocity(self.velocity(end, heading + turn)) };
        }
        let moving = matches!(self.kind, Kind::Steady | Kind::Periodic);
        if moving {
            from = Goal { rates: [0., 0., yaw], ..from.velocity(self.velocity([x, y], heading)) };
        }
        let feet = moving.then(|| self.first_footholds(schedule, durations));
        let task = Task::from_feet(self.robot.clone(), self.ground.terrain.clone(), from, feet, to)?;
        for place in &task.start_feet {
            task.terrain.check_inside("start_feet", place[0], place[1])?;
        }
        Ok(task)
    }

    /// Footholds at a start in motion, (x, y), world frame, m. Each foot passes its nominal position in the middle of its stance.
    fn first_footholds(&self, schedule: &Schedule, durations: &Durations) -> Vec<[f64; 2]> {
        let ([x, y, heading], robot) = (self.start, self.robot);
        let (sin, cos) = heading.sin_cos();
        let place = |(i, (foot, reach)): (usize, (&[f64; 3], ReachBox))| {
            let first = schedule.durations()[i].first().copied().unwrap_or(0.);
            let (velocity, time) = (self.velocity_of(foot), first - durations.stance / 2.);
            let [a, b]: [f64; 2] = std::array::from_fn(|axis| {
                let [low, high] = [reach.low[axis], reach.high[axis]];
                let (middle, half) = ((low + high) / 2., FIRST_FOOTHOLD * (high - low));
                foot[axis] + (velocity[axis] * time).clamp((middle - half).min(0.), (middle + half).max(0.))
            });
            [x + cos * a - sin * b, y + sin * a + cos * b]
        };
        robot.nominal_feet.iter().zip(robot.reach_boxes()).enumerate().map(place).collect()
    }

    /// Task with the stride in the middle that repeats.
    fn with_stride(&self, task: Task, durations: &Durations, interval: f64) -> Task {
        let intervals = (durations.period() / interval).round() as usize;
        let count = (self.length / interval).round() as usize;
        let part = durations.period() / self.length;
        let displacement = std::array::from_fn(|axis| part * (task.goal.position[axis] - task.start.position[axis]));
        let stride = PeriodicStride { start: count.saturating_sub(intervals) / 2, intervals, displacement, costs_alone: false };
        Task { stride: Some(stride), ..task }
    }
}

#[cfg(test)]
mod tests {
    use super::super::spec::Spec;
    use super::*;
    use crate::error::from_toml;

    fn plan(text: &str) -> (DatasetPlan, LowerSettings) {
        let plan = from_toml::<Spec>(text).unwrap().plan().unwrap();
        let mut settings = plan.settings.clone();
        settings.transcription.interval = Some(common_interval(plan.spec.length, &settings, &plan.subjects[0].robot));
        (plan, settings)
    }

    const ALL: &str = "count = 9\nrobots = [\"anymal\"]\nkinds = [\"rest\", \"start\", \"steady\", \"periodic\"]\n\
        [[commands]]\nforward = [-0.3, 0.6]\nsideways = [-0.1, 0.1]\nyaw = [-0.4, 0.4]\n";

    #[test]
    fn a_draw_depends_on_nothing_but_seed_robot_and_number() {
        let (plan, settings) = plan(ALL);
        let drawn: Vec<Option<Draw>> = (0..40).map(|number| draw(&plan, 0, number, &settings)).collect();
        assert!(drawn.iter().flatten().count() > 20);
        let again = draw(&plan, 0, 7, &settings);
        assert_eq!(format!("{again:?}"), format!("{:?}", drawn[7]));
    }

    #[test]
    fn every_motion_has_the_same_duration_and_ends_where_its_command_leads() {
        let (plan, settings) = plan(ALL);
        for draw in (0..200).filter_map(|number| draw(&plan, 0, number, &settings)) {
            let aligned = draw.schedule.aligned(interval(&settings.transcription, &draw.task.robot));
            assert!((aligned.end() - 2.).abs() < 1e-9, "{} s", aligned.end());
            let [forward, _, yaw] = draw.drawn.command;
            let even = match draw.drawn.kind {
                Kind::Rest => 1.4,
                Kind::Start => 1.7,
                _ => 2.,
            };
            assert!((draw.task.turn() - yaw * even).abs() < 1e-9);
            assert!(draw.task.displacement()[0] * forward >= 0. || forward.abs() < 0.1);
            let moving = |velocity: [f64; 3]| velocity[0].hypot(velocity[1]) > 0.;
            assert_eq!(moving(draw.task.start.velocity), matches!(draw.drawn.kind, Kind::Steady | Kind::Periodic));
            assert_eq!(moving(draw.task.goal.velocity), draw.drawn.kind != Kind::Rest);
            assert_eq!(draw.task.stride.is_some(), draw.drawn.kind == Kind::Periodic);
            assert!((0..200).all(|i| (0. ..1.).contains(&draw.drawn.stride.at(0.01 * f64::from(i)))));
        }
    }

    #[test]
    fn impossible_commands_are_not_drawn() {
        let (plan, settings) = plan(&ALL.replace("-0.3, 0.6", "20, 30"));
        assert!((0..20).all(|number| draw(&plan, 0, number, &settings).is_none()));
    }
}
