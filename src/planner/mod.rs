//! Planning online: the gait is chosen again many times a second, from any state.
//!
//! Each update takes the measured state and a command, and solves a small batch of candidates over a short horizon: the gait that is being
//! performed, from the point where it is; the same with changed durations; the families, entered at the phase in which the feet are; and
//! standing. Feet may be in the air at both ends. The pose at the end is free; its distance from that which the command asks for is a cost,
//! beside that of [`crate::gait::cost`]. Its yaw follows from the commands so far, and stays near the measured one. A gait is solved from
//! the motion that its family had at the last update, or from its own first guess. The cheapest candidate wins; a change of the family must
//! pay for itself. The gait in force and standing are solved first; a candidate that is much more expensive after the first iterations is
//! dropped, and a family that lost in this way rests for some updates. All families are tried when the command changes or the gait in force
//! becomes more expensive, as after a push. Otherwise the next step is put off by a quarter of a swing at most. If no candidate holds, legs
//! may stretch to the end of their reach. If none holds even then, they are solved with wider limits: legs stretch further for some steps,
//! and feet are faster than usual. Those of the gait in force come first, and the others only if none of them holds. If no other holds
//! either, the plan before stays.
//!
//! The result of an update depends on the states, commands and times of all updates so far and on the seed, but not on the number of
//! threads. With a deadline it also depends on how fast the machine is.
//!
//! # Beside a controller
//! An update takes longer than a control period. Planner and controller run in two threads with one clock and exchange two messages: the
//! newest state, and the newest plan.
//!
//! ```text
//! planner:     wait for a state; take the newest one, drop older ones
//!              update(state, command, time of the state); if renewed: sample the plan, send the samples with its start
//! controller,  send the measured state with its time
//! at 500 Hz:   if a plan has arrived and its start has come: follow it from now on
//!              track the samples at the time since the start of the plan
//! ```
//!
//! * [`Planner::update`] returns when the plan is chosen. The plan is an `Arc`: sending it copies no motion. From Python, other threads run
//!   during an update. [`PlannerSettings::threads`] should leave a processor to the controller.
//! * [`crate::export::Sampled`] samples base, feet, forces and contacts of [`Plan::motion`] at the control rate. Time 0 of the
//!   samples is [`Plan::start`] on the clock of the updates. [`Plan::state`] gives base and feet at one time, without forces.
//! * [`PlannerSettings::latency`] is the time from the state to the start of the plan: that of an update and of the messages. The planner
//!   moves the state by it as the plan before moves. Too short: plans arrive late. Too long: disturbances are answered late.
//! * A plan that arrives late is entered at the time since its start. The robot has followed the plan before until then, so that the
//!   references may jump.
//! * [`PlannerSettings::deadline`] drops the candidates that are not solved by then. The best one is still checked afterwards, so that an
//!   update lasts a little longer.
//! * If [`Update::renewed`] is false, the plan before stays in force. It ends after [`PlannerSettings::horizon`], possibly in motion: the
//!   controller then needs a reaction of its own, such as standing.
//! * An update fails for a state out of range and for a time before that of the last update. Before there is a plan, it also fails if no
//!   candidate holds.
//! * Contacts and measured positions correct the planned phases: a contact in the second half of a swing ends it, and a foot that should
//!   stand is in the air only if it is not loaded and more than 1 cm off the terrain, or has not been loaded since it swung. Slow filters
//!   on contacts delay this.
//! * Positions of the base and the feet must agree with each other. Where loaded feet are more than 2 cm off the terrain, or a foot
//!   finds no ground, the terrain is corrected around them: see [`Plan::terrain`].

mod alternatives;
mod candidates;
mod cycle;
mod reach;
mod solve;
mod touched;
mod warm;

pub use cycle::{Contact, Cycle};

use crate::backend::{Backend, Cpu};
use crate::error::{Error, Result, check_range};
use crate::gait::Trajectory;
use crate::gait::cost::CostWeights;
use crate::gait::family::{GaitFamily, default_families, offsets, time_scale};
use crate::gait::schedule::starts_in_swing;
use crate::gait::spline::hermite_acceleration;
use crate::gait::trajectory::GoalVelocity;
use crate::nlp::RESPONSE;
use crate::nlp::transcription::{interval, legs};
use crate::robot::{Reach, Robot};
use crate::settings::{SolverSettings, Stretch, TranscriptionSettings};
use crate::solver::Solver;
use crate::task::{BaseState, Goal, SwingState, Task};
use crate::terrain::Terrain;
use alternatives::Alternatives;
use candidates::{Candidate, descent};
use serde::{Deserialize, Serialize};
use solve::{Choice, Solved, Updating};
use std::f64::consts::TAU;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use touched::{APART, Touched};
use warm::Before;

/// Height above the ground from which a foot without contact counts as in the air although the plan has it on the ground, m.
const LIFTED: f64 = 0.01;
/// Time after its planned touchdown at which a foot without contact has found no ground, s.
const LATE: f64 = 0.01;
/// Part of a swing after which a contact ends it.
const LATE_SWING: f64 = 0.5;
/// Part of a swing that is assumed to have passed at least for a foot that should stand but is in the air: it only descends.
const FALLING: f64 = 0.5;
/// Share of the acceleration limit of a foot that an early landing may need, and the range of times that are tried for it, s.
const LANDING_SHARE: f64 = 0.8;
const SHORTEST_LANDING: f64 = 0.01;
const LONGEST_LANDING: f64 = 0.3;
/// Horizon by default, s, and that on soles: with 0.8 s, Unitree's G1 at 0.3 m/s changes between walking and standing in each step.
const HORIZON: f64 = 0.8;
const HORIZON_ON_SOLES: f64 = 1.2;
/// Longest time between the knots of the base by default, s.
const LONGEST_INTERVAL: f64 = 0.1;
/// Time in which the error of the velocity is compensated, s, and largest compensation, as a share of the command.
const COMPENSATION: (f64, f64) = (1., 0.3);
/// Part of a swing by which changes of the gait in force may put off the next lift-off.
const POSTPONED: f64 = 0.25;
/// Largest difference between the yaw to which the commands lead and that of the base, rad.
const HEADING: f64 = 0.1;
/// Rise of the cost of the gait in force, as a factor, above which all families are tried.
const COST_RISE: f64 = 1.5;
/// Factor of the speed and acceleration of feet in states from which no candidate holds.
const HURRY: f64 = 2.;
/// Time in which steps may begin that have the wider reach, [`time_scale`]s. Without a limit, Go1 kept it for 18 s after a push.
const STRETCHED_FOR: f64 = 5.;

/// Settings of a [`Planner`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlannerSettings {
    /// Horizon, s; by default 0.8 s, and 1.2 s on soles, which step more slowly. Too short: the robot cannot catch itself. Too long: updates
    /// are slow.
    pub horizon: Option<f64>,
    /// Time between the knots of the base, s. By default twice that of [`interval`], at most 0.1 s. Too short: updates are slow. Too long:
    /// motions are inexact.
    pub interval: Option<f64>,
    /// Number of cubics of the force of a stance, at least 2. See [`TranscriptionSettings::force_pieces`]. With 2, a trot of ANYmal costs
    /// 40 % more than with 3, and its lateral velocity at the updates scatters by 0.05 instead of 0.01 m/s.
    pub force_pieces: usize,
    /// Largest number of candidates of an update.
    pub candidates: usize,
    /// Families to choose from, in addition to standing. `None`: those of [`default_families`].
    pub families: Option<Vec<GaitFamily>>,
    /// False to keep the typical durations of the families.
    pub change_durations: bool,
    /// Largest number of iterations that solve the rows of a candidate.
    pub iterations: usize,
    /// Number of iterations that minimise the cost of a candidate.
    pub optimise_iterations: usize,
    /// Part of the cost by which another gait must be cheaper to be chosen. Too small: the gait changes back and forth.
    pub hysteresis: f64,
    /// Spread of changed candidates: standard deviation of the logarithm of the swing duration. That of the stance duration is 1.5 times as
    /// large, that of the phase, in strides, half as large.
    pub spread: f64,
    /// Time between the measured state and the start of the plan, s.
    pub latency: f64,
    /// Longest time of an update, s; `None`: no limit. Candidates that are not solved then are dropped.
    pub deadline: Option<f64>,
    /// Margin of the reach boxes along the legs, base heights. See [`TranscriptionSettings::reach_margin`].
    pub reach_margin: f64,
    /// Number of threads; 0: one per processor.
    pub threads: usize,
    /// Seed of the changes.
    pub seed: u64,
    /// Weights of the cost.
    pub cost: CostWeights,
}

impl Default for PlannerSettings {
    fn default() -> Self {
        PlannerSettings {
            horizon: None,
            interval: None,
            force_pieces: 3,
            candidates: 16,
            families: None,
            change_durations: true,
            iterations: 20,
            optimise_iterations: 4,
            hysteresis: 0.05,
            spread: 0.15,
            latency: 0.,
            deadline: None,
            reach_margin: 0.03,
            threads: 0,
            seed: 1,
            cost: CostWeights { joint_excess: 0., ..CostWeights::default() },
        }
    }
}

impl PlannerSettings {
    /// Checks every field.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first field that is out of its limits.
    pub fn validate(&self) -> Result<()> {
        if let Some(horizon) = self.horizon {
            check_range("planner.horizon", horizon, 0.2, 10.)?;
        }
        if let Some(interval) = self.interval {
            check_range("planner.interval", interval, 0.01, 0.2)?;
        }
        check_range("planner.force_pieces", self.force_pieces as f64, 2., 16.)?;
        check_range("planner.candidates", self.candidates as f64, 1., 4096.)?;
        check_range("planner.iterations", self.iterations as f64, 1., 1e4)?;
        check_range("planner.optimise_iterations", self.optimise_iterations as f64, 1., 1e4)?;
        check_range("planner.hysteresis", self.hysteresis, 0., 1.)?;
        check_range("planner.spread", self.spread, 0., 1.)?;
        check_range("planner.latency", self.latency, 0., 1.)?;
        check_range("planner.reach_margin", self.reach_margin, 0., 1.)?;
        if let Some(deadline) = self.deadline {
            check_range("planner.deadline", deadline, 1e-4, 10.)?;
        }
        if self.families.as_ref().is_some_and(Vec::is_empty) {
            return Err(Error::invalid("planner.families", "none", "at least one family, or no list"));
        }
        self.cost.validate()
    }
}

/// Measured state of a foot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FootState {
    /// Position, world frame, m.
    pub position: [f64; 3],
    /// Velocity, world frame, m/s.
    pub velocity: [f64; 3],
    /// True if the foot is loaded.
    pub contact: bool,
    /// Yaw of a sole, world frame, rad. Without effect for a ball or point.
    #[serde(default)]
    pub yaw: f64,
}

/// Measured state of a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotState {
    /// Base.
    pub base: BaseState,
    /// Each foot.
    pub feet: Vec<FootState>,
}

impl RobotState {
    /// A robot that stands still on its nominal footholds.
    pub fn standing(task: &Task) -> RobotState {
        let foot = |(&[x, y], &yaw): (&[f64; 2], &f64)| {
            let position = [x, y, task.terrain.height(x, y)];
            FootState { position, velocity: [0.; 3], contact: true, yaw }
        };
        RobotState { base: task.start, feet: task.start_feet.iter().zip(&task.start_yaws).map(foot).collect() }
    }
}

/// Desired motion of the base.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Command {
    /// Velocity forward and to the left, in the horizontal axes of the base, m/s.
    pub velocity: [f64; 2],
    /// Yaw rate, rad/s. The yaw to which it leads is held: with 0 the robot goes straight ahead.
    pub yaw_rate: f64,
}

/// Plan of one update.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Time at which the motion starts, s, on the clock of the updates.
    pub start: f64,
    /// The motion. It has no goal of its own: the command is a cost.
    pub motion: Trajectory,
    /// Gait at the start of the motion.
    pub gait: Cycle,
    /// Cost, per weight and a typical distance; includes the distance from the command.
    pub cost: f64,
    /// Robot for which the motion holds: the planner's, with a wider reach box for a foot that is beyond its box at the start.
    pub robot: Arc<Robot>,
    /// Terrain for which the motion holds: the planner's, or if contacts of the feet were off it, a grid through their last contacts.
    pub terrain: Arc<Terrain>,
    /// Contact of each foot at the start.
    contacts: Vec<Contact>,
}

impl Plan {
    /// Planned state at a time on the clock of the updates; after the horizon that at its end.
    pub fn state(&self, time: f64) -> RobotState {
        let at = Before::new(&self.motion, time - self.start);
        let [[x, y, z, roll, pitch, yaw], [vx, vy, vz, droll, dpitch, dyaw]] = at.base(0.);
        let base = BaseState { position: [x, y, z], angles: [roll, pitch, yaw], velocity: [vx, vy, vz], rates: [droll, dpitch, dyaw] };
        let foot = |foot: usize| {
            let [position, velocity] = at.foot(foot, 0.).map(Into::into);
            FootState { position, velocity, contact: !planned_contact(self, foot, time).0.in_air, yaw: at.sole_yaw(foot, 0.) }
        };
        RobotState { base, feet: (0..self.contacts.len()).map(foot).collect() }
    }
}

/// Result of one update.
#[derive(Debug, Clone)]
pub struct Update {
    /// The plan in force.
    pub plan: Arc<Plan>,
    /// True if this update made it, false if no candidate held and the plan before stays.
    pub renewed: bool,
    /// True if this update made it with wider limits of the legs, because no candidate held with the usual ones.
    pub stretched: bool,
    /// Number of candidates that were solved.
    pub solved: usize,
    /// Number of candidates, dropped ones included.
    pub candidates: usize,
    /// Iterations of all candidates.
    pub iterations: usize,
    /// Duration of the update, s.
    pub seconds: f64,
}

/// Chooses gaits online.
pub struct Planner {
    robot: Arc<Robot>,
    /// Wider reach, for states from which no candidate holds otherwise.
    stretched: Reach,
    /// Terrain as it is known.
    map: Arc<Terrain>,
    /// Last contacts of the feet.
    touched: Touched,
    /// State and goal of the last update, the robot with the reach of that update, and the terrain as corrected by contacts.
    task: Task,
    settings: PlannerSettings,
    transcription: TranscriptionSettings,
    /// Without the margin of the reach boxes, for states from which no candidate holds with it.
    full: TranscriptionSettings,
    /// With faster feet, for states from which no candidate holds with the usual limits.
    hurried: TranscriptionSettings,
    solver: SolverSettings,
    families: Vec<(GaitFamily, Vec<f64>)>,
    cpu: Cpu,
    solvers: Vec<Mutex<Solver<f32>>>,
    plan: Option<Arc<Plan>>,
    alternatives: Alternatives,
    contacts: Vec<Contact>,
    /// Earliest time at which the next foot was to lift off, s; infinite if none was.
    next_lift: f64,
    /// Time from which steps stay within the usual reach again, if the plan in force exceeds it, s.
    stretched_until: f64,
    updates: u64,
    /// Command and time of the last update, s.
    command: Command,
    now: f64,
    /// Compensation of the error of the velocity, in the horizontal axes of the base, and of the yaw rate.
    compensation: [f64; 3],
    /// Yaw to which the commands lead at the start of the plan, rad; `None` before the first update.
    heading: Option<f64>,
}

impl Planner {
    /// Creates a planner for a robot that stands, or is in any other state at the first update.
    ///
    /// # Errors
    /// [`Error::Invalid`] for settings out of range or a robot without gaits; the errors of [`Task::new`].
    pub fn new(robot: impl Into<Arc<Robot>>, terrain: impl Into<Arc<Terrain>>, settings: PlannerSettings) -> Result<Planner> {
        settings.validate()?;
        let task = Task::new(robot, terrain, Goal::at(0., 0.))?;
        let names = settings.families.clone().unwrap_or_else(|| default_families(&task.robot));
        let families = names.into_iter().map(|family| Ok((family, offsets(family, &task.robot)?))).collect::<Result<Vec<_>>>()?;
        let cpu = Cpu::new(settings.threads)?;
        let usual = interval(&TranscriptionSettings::default(), &task.robot);
        let transcription = TranscriptionSettings {
            goal_velocity: GoalVelocity::Near,
            interval: Some(settings.interval.unwrap_or((2. * usual).min(LONGEST_INTERVAL))),
            force_pieces: Some(settings.force_pieces),
            reach_margin: settings.reach_margin * task.robot.base_height,
            ..TranscriptionSettings::default()
        };
        let full = TranscriptionSettings { reach_margin: 0., ..transcription.clone() };
        let hurried = TranscriptionSettings {
            foot_speed: Some(HURRY * legs::foot_speed(&transcription, &task.robot)),
            foot_acceleration: legs::foot_acceleration(&transcription, &task.robot).map(|limit| HURRY * limit),
            ..full.clone()
        };
        let mut solver = SolverSettings { max_iterations: settings.iterations, ..SolverSettings::default() };
        solver.optimise.iterations = settings.optimise_iterations;
        solver.optimise.cost = settings.cost;
        let solvers = (0..cpu.threads()).map(|_| Mutex::default()).collect();
        let contacts = vec![Contact::STANDING; task.robot.feet()];
        let alternatives = Alternatives::new(families.iter().map(|(family, _)| *family));
        Ok(Planner {
            robot: task.robot.clone(),
            stretched: reach::stretched(&task.robot),
            map: task.terrain.clone(),
            touched: Touched::new(task.robot.feet()),
            task,
            settings,
            transcription,
            full,
            hurried,
            solver,
            families,
            cpu,
            solvers,
            plan: None,
            alternatives,
            contacts,
            next_lift: f64::INFINITY,
            stretched_until: f64::NEG_INFINITY,
            updates: 0,
            command: Command::default(),
            now: 0.,
            compensation: [0.; 3],
            heading: None,
        })
    }

    /// The plan in force; `None` before the first update that found one.
    pub fn plan(&self) -> Option<&Arc<Plan>> {
        self.plan.as_ref()
    }

    /// Robot.
    pub fn robot(&self) -> &Arc<Robot> {
        &self.robot
    }

    /// Terrain as it is known, without the corrections by contacts.
    pub fn terrain(&self) -> &Arc<Terrain> {
        &self.map
    }

    /// Replaces the terrain, for example by a map as the robot sees it now. Contacts until now no longer correct it.
    ///
    /// # Errors
    /// The errors of [`Terrain::validate`].
    pub fn set_terrain(&mut self, terrain: impl Into<Arc<Terrain>>) -> Result<()> {
        let terrain = terrain.into();
        terrain.validate()?;
        self.map = terrain;
        self.touched = Touched::new(self.robot.feet());
        Ok(())
    }

    /// Chooses a gait and plans its motion from a state.
    ///
    /// * `now` - time of the state on any clock that does not go back, s
    ///
    /// # Errors
    /// [`Error::Invalid`] for a state out of range or another number of feet, and if no candidate holds and there is no plan before.
    pub fn update(&mut self, state: &RobotState, command: &Command, now: f64) -> Result<Update> {
        let clock = Instant::now();
        self.check(state, command, now)?;
        let start = now + self.settings.latency;
        self.touch(state, now);
        let yaw = state.base.yaw();
        let before = self.plan.as_ref().map(|plan| Before::new(&plan.motion, start - plan.start).turned_to(yaw));
        let state = self.ahead(state, before.as_ref());
        self.update_contacts(&state, start);
        let passed = if self.updates > 0 { now - self.now } else { 0. };
        let compensated = self.compensated(&state.base, command, passed);
        let turn = compensated.yaw_rate * self.horizon() + self.lag(state.base.yaw(), passed);
        self.task = self.task_of(&state, &compensated, turn)?;
        self.limit_later_steps();
        let until = self.settings.deadline.map(|seconds| clock + Duration::from_secs_f64(seconds));
        let mut guesses: Vec<_> = self.in_force().zip(before).into_iter().collect();
        let steady = self.steady(start);
        let mut candidates = self.candidates(&steady)?;
        let (mut solved, mut iterations) = self.solve(&candidates, &Updating { guesses: &guesses, until }, &self.transcription, None);
        let limit = solve::limit(&solved);
        let disturbed = self.disturbed(command, &solved);
        if disturbed {
            self.alternatives.wake();
        } else {
            guesses.extend(self.alternatives.guesses(start, yaw).map(|(family, motion)| (Some(family), motion)));
        }
        let updating = Updating { guesses: &guesses, until };
        let mut others = self.candidates(&self.others(&steady))?;
        if !disturbed {
            self.drop_late_steps(&mut others, start, &candidates[0]);
        }
        let (of_others, more) = self.solve(&others, &updating, &self.transcription, limit);
        candidates.extend(others);
        solved.extend(of_others);
        iterations += more;
        let mut count = solved.iter().flatten().count();
        self.alternatives.learn(&candidates, &solved, start);
        let mut best = self.choose(&candidates, &mut solved, &self.transcription);
        let tried = candidates.len();
        if best.is_none() {
            best = self.solve_again(&candidates, &updating, &self.full, &mut iterations, &mut count);
        }
        let stretches = best.is_none();
        if stretches {
            self.task.robot = self.stretching();
            let reach = Arc::new(self.task.robot.reach.clone());
            // Another gait is the last resort of a robot that is about to fall.
            let in_force = self.in_force();
            let (same, others): (Vec<_>, Vec<_>) = candidates.into_iter().partition(|c| in_force == Some(c.gait.family));
            // As planned before, the legs return to their usual reach at a certain time, otherwise later.
            let latest = start + STRETCHED_FOR * time_scale(&self.robot);
            for until in [self.stretched_until, latest].into_iter().filter(|until| *until > start) {
                let stretch = Some(Stretch { reach: reach.clone(), until: until - start });
                let wider = TranscriptionSettings { stretch, ..self.hurried.clone() };
                let mut again = |candidates| self.solve_again(candidates, &updating, &wider, &mut iterations, &mut count);
                best = again(&same).or_else(|| again(&others));
                if best.is_some() {
                    self.stretched_until = until;
                    break;
                }
            }
        }
        let renewed = best.is_some();
        if let Some((gait, motion, cost)) = best {
            let stays = self.in_force() == Some(gait.family);
            self.next_lift = (start + next_lift(&motion.durations)).min(if stays { self.next_lift } else { f64::INFINITY });
            let contacts = self.contacts.clone();
            let (robot, terrain) = (self.task.robot.clone(), self.task.terrain.clone());
            self.plan = Some(Arc::new(Plan { start, motion, gait, cost, robot, terrain, contacts }));
        }
        self.updates += 1;
        self.now = now;
        self.command = *command;
        let plan = self.plan.clone().ok_or_else(|| {
            Error::invalid("state", format!("none of {tried} candidates holds"), "a state from which the robot can go on")
        })?;
        let seconds = clock.elapsed().as_secs_f64();
        Ok(Update { plan, renewed, stretched: stretches && renewed, solved: count, candidates: tried, iterations, seconds })
    }

    /// Solves candidates with other limits, and chooses one.
    ///
    /// * `iterations`, `count` - in and out: numbers of iterations and of solutions of the update
    fn solve_again(
        &self,
        candidates: &[Candidate],
        updating: &Updating,
        transcription: &TranscriptionSettings,
        iterations: &mut usize,
        count: &mut usize,
    ) -> Option<Choice> {
        let (mut solved, more) = self.solve(candidates, updating, transcription, None);
        *iterations += more;
        *count += solved.iter().flatten().count();
        self.choose(candidates, &mut solved, transcription)
    }

    fn check(&self, state: &RobotState, command: &Command, now: f64) -> Result<()> {
        let feet = self.task.robot.feet();
        if state.feet.len() != feet {
            return Err(Error::invalid("state.feet", format!("{} feet", state.feet.len()), format!("{feet} feet, as the robot has")));
        }
        state.base.validate("state.base")?;
        for (foot, at) in state.feet.iter().enumerate() {
            check_range(&format!("state.feet[{foot}].yaw"), at.yaw, -1e3, 1e3)?;
            for (what, values, limit) in [("position", at.position, 1100.), ("velocity", at.velocity, 100.)] {
                for axis in 0..3 {
                    check_range(&format!("state.feet[{foot}].{what}[{axis}]"), values[axis], -limit, limit)?;
                }
            }
        }
        for (axis, v) in command.velocity.iter().enumerate() {
            check_range(&format!("command.velocity[{axis}]"), *v, -20., 20.)?;
        }
        check_range("command.yaw_rate", command.yaw_rate, -20., 20.)?;
        check_range("now", now, if self.updates > 0 { self.now } else { -1e12 }, 1e12)
    }

    /// The state after the latency: the measured one, moved as the plan moves.
    fn ahead(&self, state: &RobotState, before: Option<&Before>) -> RobotState {
        let latency = self.settings.latency;
        let (Some(before), true) = (before, latency > 0.) else { return state.clone() };
        let moved = |now: [f64; 3], [from, to]: [[f64; 3]; 2]| std::array::from_fn(|i| now[i] + to[i] - from[i]);
        let ([pose, rate], [to_pose, to_rate]) = (before.base(-latency), before.base(0.));
        let part = |v: [f64; 6], first: usize| [v[first], v[first + 1], v[first + 2]];
        let base = BaseState {
            position: moved(state.base.position, [part(pose, 0), part(to_pose, 0)]),
            angles: moved(state.base.angles, [part(pose, 3), part(to_pose, 3)]),
            velocity: moved(state.base.velocity, [part(rate, 0), part(to_rate, 0)]),
            rates: moved(state.base.rates, [part(rate, 3), part(to_rate, 3)]),
        };
        let foot = |(foot, at): (usize, &FootState)| {
            let ([place, velocity], [to_place, to_velocity]) = (before.foot(foot, -latency), before.foot(foot, 0.));
            FootState {
                position: moved(at.position, [place.into(), to_place.into()]),
                velocity: moved(at.velocity, [velocity.into(), to_velocity.into()]),
                contact: at.contact,
                yaw: at.yaw + before.sole_yaw(foot, 0.) - before.sole_yaw(foot, -latency),
            }
        };
        RobotState { base, feet: state.feet.iter().enumerate().map(foot).collect() }
    }

    /// Drops changes of the gait in force that put off its next lift-off too far. Otherwise each update puts it off, because standing on all
    /// feet costs less, and the robot falls behind its command.
    ///
    /// * `start` - of the plan, s
    /// * `unchanged` - the gait in force
    fn drop_late_steps(&self, others: &mut Vec<Candidate>, start: f64, unchanged: &Candidate) {
        let lift = |candidate: &Candidate| start + next_lift(candidate.schedule.durations());
        let latest = lift(unchanged).max(self.next_lift + POSTPONED * unchanged.gait.swing);
        others.retain(|other| other.gait.family != unchanged.gait.family || lift(other) <= latest);
    }

    /// Corrects the terrain by the feet that bear load, and by those that found no ground.
    fn touch(&mut self, state: &RobotState, now: f64) {
        for (foot, at) in state.feet.iter().enumerate() {
            let planned = self.plan.as_ref().map(|plan| planned_contact(plan, foot, now));
            let swings = planned.is_some_and(|(contact, _)| contact.in_air);
            let [x, y, z] = at.position;
            let below = self.task.terrain.height(x, y) - z;
            if !at.contact {
                // A foot that should have landed but bears no load is above the ground, however near to the map it is.
                let late = self.touched.hangs[foot] && planned.is_some_and(|(contact, _)| contact.since > LATE);
                let least = if swings { APART } else { LIFTED * if late { -1. } else { 1. } };
                if below > least {
                    self.touched.misses(foot, at.position, self.robot.base_height);
                }
                self.touched.hangs[foot] |= swings;
            } else if planned.is_none_or(|(contact, left)| !contact.in_air || lands_early(contact, left)) {
                self.touched.bears(foot, at.position);
            }
        }
        self.task.terrain = self.touched.correct(&self.map, self.robot.base_height);
    }

    /// Contacts at the start of the plan: those of the plan before, corrected by what was measured.
    fn update_contacts(&mut self, state: &RobotState, start: f64) {
        for (foot, at) in state.feet.iter().enumerate() {
            let planned = self.plan.as_ref().map(|plan| planned_contact(plan, foot, start));
            let [x, y, z] = at.position;
            let lifted = !at.contact && z > self.task.terrain.height(x, y) + LIFTED;
            let stood = !self.contacts[foot].in_air;
            self.contacts[foot] = match planned {
                None if lifted => Contact { in_air: true, since: 0., ..Contact::STANDING },
                None => Contact::STANDING,
                // Early touchdown.
                Some((contact, left)) if at.contact && lands_early(contact, left) => Contact { since: 0., ..Contact::STANDING },
                // Late touchdown, or a foot that lost the ground.
                Some((contact @ Contact { in_air: false, since, .. }, _)) if lifted => {
                    let swing = self.plan.as_ref().map_or(0., |plan| plan.gait.swing);
                    Contact { in_air: true, since: since.max(FALLING * swing), ..contact }
                }
                Some((contact, _)) => contact,
            };
            self.contacts[foot].landing = self.landing(at);
            if stood && self.contacts[foot].in_air {
                self.next_lift = f64::INFINITY;
            }
        }
    }

    /// Shortest time in which a foot can land without being accelerated too hard, s.
    fn landing(&self, at: &FootState) -> f64 {
        let Some(limit) = legs::foot_acceleration(&self.transcription, &self.robot) else { return 0. };
        let ([x, y, z], [vx, vy, vz]) = (at.position, at.velocity);
        let height = (z - self.task.terrain.height(x, y)).max(0.);
        let hardest = |time: f64| {
            let down = descent(height, vz, time);
            let [start, end] = [0., time].map(|t| {
                let [by_height, by_velocity, ..] = hermite_acceleration(t, time);
                (by_height * height + by_velocity * down).abs()
            });
            // The foothold that needs the least acceleration along x and y is `v time / 2` away.
            (vx.hypot(vy) / time).hypot(start.max(end))
        };
        let mut time = SHORTEST_LANDING;
        while hardest(time) > LANDING_SHARE * limit && time < LONGEST_LANDING {
            time *= 1.1;
        }
        time
    }

    /// The command with the compensation of the mean error so far: the cost of effort holds the velocity below the command.
    ///
    /// * `passed` - time since the last update, s
    fn compensated(&mut self, base: &BaseState, command: &Command, passed: f64) -> Command {
        let (sin, cos) = base.yaw().sin_cos();
        let [x, y, _] = base.velocity;
        let actual = [cos * x + sin * y, cos * y - sin * x, base.rates[2]];
        let asked = [command.velocity[0], command.velocity[1], command.yaw_rate];
        let share = (passed / COMPENSATION.0).min(1.);
        // A robot that walks and turns also drifts to the side.
        let speed = asked[0].hypot(asked[1]);
        for (i, most) in [speed, speed, asked[2].abs()].map(|of| COMPENSATION.1 * of).into_iter().enumerate() {
            self.compensation[i] = (self.compensation[i] + share * (asked[i] - actual[i])).clamp(-most, most);
        }
        let [x, y, turn] = std::array::from_fn(|i| asked[i] + self.compensation[i]);
        Command { velocity: [x, y], yaw_rate: turn }
    }

    /// Angle by which the base lags behind the yaw to which the commands have led, rad, at most [`HEADING`]. A turn within a stance, as
    /// single supports cause it, is undone in this way.
    ///
    /// * `yaw` - yaw of the base at the start of the plan, rad
    /// * `passed` - time since the last update, s
    fn lag(&mut self, yaw: f64, passed: f64) -> f64 {
        let lag = self.heading.map_or(0., |heading| heading + self.command.yaw_rate * passed - yaw);
        // A yaw is measured up to whole turns.
        let lag = (lag - whole_turns(lag)).clamp(-HEADING, HEADING);
        self.heading = Some(yaw + lag);
        lag
    }

    /// The task from a state to where the command leads.
    ///
    /// * `turn` - change of the yaw over the horizon, rad
    fn task_of(&self, state: &RobotState, command: &Command, turn: f64) -> Result<Task> {
        let (base, horizon) = (&state.base, self.horizon());
        let swings = state.feet.iter().zip(&self.contacts).map(|(foot, contact)| {
            let FootState { position, velocity, .. } = *foot;
            contact.in_air.then_some(SwingState { position, velocity, since: contact.since })
        });
        let feet = state.feet.iter().map(|foot| [foot.position[0], foot.position[1]]).collect();
        let (robot, terrain) = (self.reaching(state), self.task.terrain.clone());
        let mut task = Task::of_states(robot, terrain, *base, Some(feet), *base)?.with_swings(swings.collect())?;
        // Within half a turn of the base.
        let yaws = state.feet.iter().map(|foot| foot.yaw + whole_turns(base.yaw() - foot.yaw));
        task.start_yaws = yaws.collect();
        // The velocity approaches the command exponentially, in the axes of the base, which turn.
        let [vx, vy] = command.velocity;
        let along = |yaw: f64| [vx * yaw.cos() - vy * yaw.sin(), vx * yaw.sin() + vy * yaw.cos()];
        let (middle, end) = (along(base.yaw() + turn / 2.), along(base.yaw() + turn));
        let excess = RESPONSE * (1. - (-horizon / RESPONSE).exp());
        let start = along(base.yaw());
        let xy = [0, 1].map(|i| base.position[i] + middle[i] * horizon + (base.velocity[i] - start[i]) * excess);
        task.to(Goal {
            xy,
            z: None,
            yaw: base.yaw() + turn,
            tilt: None,
            velocity: [end[0], end[1], 0.],
            rates: [0., 0., command.yaw_rate],
            time: None,
        })
    }

    /// Horizon in whole intervals, s.
    fn horizon(&self) -> f64 {
        let interval = interval(&self.transcription, &self.task.robot);
        let default = if self.robot.sole.is_some() { HORIZON_ON_SOLES } else { HORIZON };
        (self.settings.horizon.unwrap_or(default) / interval).round().max(2.) * interval
    }

    /// True if the gait in force became more expensive or cannot go on, or if the command changed.
    ///
    /// * `steady` - solutions of the gait in force and of standing
    fn disturbed(&self, command: &Command, steady: &[Option<Solved>]) -> bool {
        let Some(plan) = &self.plan else { return true };
        let cost = steady.first().and_then(|s| s.as_ref()).map(|s| s.cost);
        *command != self.command || cost.is_none_or(|cost| cost > COST_RISE * plan.cost)
    }
}

/// Time until the next foot lifts off, s; infinite if none does.
fn next_lift(durations: &[Vec<f64>]) -> f64 {
    let standing = durations.iter().filter(|phases| phases.len() > 1 && !starts_in_swing(phases));
    standing.map(|phases| phases[0]).fold(f64::INFINITY, f64::min)
}

/// The whole turns nearest to an angle, rad.
fn whole_turns(angle: f64) -> f64 {
    (angle / TAU).round() * TAU
}

/// True if a foot in the air that bears load ends its swing.
///
/// * `left` - time until the swing would end, s
fn lands_early(planned: Contact, left: f64) -> bool {
    planned.in_air && planned.since > LATE_SWING * (planned.since + left)
}

/// Contact of a foot in a plan at a time, and the time until it changes, s.
fn planned_contact(plan: &Plan, foot: usize, time: f64) -> (Contact, f64) {
    let (passed, contact) = (time - plan.start, plan.contacts[foot]);
    let mut start = 0.;
    let durations = &plan.motion.durations[foot];
    let first = usize::from(starts_in_swing(durations));
    for (phase, &duration) in durations.iter().enumerate() {
        let end = start + duration;
        if phase >= first && (passed < end || phase + 1 == durations.len()) {
            // The first phase had begun before the plan.
            let since = if phase == first { passed + contact.since } else { passed - start };
            return (Contact { in_air: phase % 2 == 1, since: since.max(0.), ..contact }, (end - passed).max(0.));
        }
        start = end;
    }
    (contact, 0.)
}
