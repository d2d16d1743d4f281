//! Planning online, with a robot that follows its plans exactly.

use cregopt::gait::family::GaitFamily;
use cregopt::planner::{Command, Planner, PlannerSettings, RobotState, Update};
use cregopt::terrain::{Grid, Shape, Terrain};
use cregopt::{Error, Goal, Robot, Task, verify};
use std::sync::Arc;

/// Updates per second.
const RATE: f64 = 50.;

/// Largest error of the mean velocity, relative to the command.
const SPEED_TOLERANCE: f64 = 0.1;
/// Largest second difference of the horizontal velocity at three updates, rms, m/s.
const JITTER: f64 = 0.03;

/// Settings with few candidates over a short horizon.
fn settings() -> PlannerSettings {
    PlannerSettings { horizon: Some(0.6), candidates: 5, families: Some(vec![GaitFamily::Trot]), threads: 1, ..PlannerSettings::default() }
}

/// A robot of the size of a dog: 12 kg, legs of 0.3 m.
fn small() -> Robot {
    let feet = [[0.19, 0.13], [0.19, -0.13], [-0.19, 0.13], [-0.19, -0.13]];
    Robot {
        name: "small".into(),
        mass: 12.,
        inertia: [[0.1, 0., 0.], [0., 0.25, 0.], [0., 0., 0.3]],
        base_height: 0.3,
        nominal_feet: feet.map(|[x, y]| [x, y, -0.3]).into(),
        reach: [0.12, 0.08, 0.06].into(),
        force_limit: None,
        leg_mass: None,
        joints: None,
        foot_radius: None,
        sole: None,
    }
}

fn anymal() -> Robot {
    Robot::named("anymal").unwrap()
}

fn ahead(speed: f64) -> Command {
    Command { velocity: [speed, 0.], yaw_rate: 0. }
}

/// A planner and the state of a robot that follows its plans.
struct Walk {
    planner: Planner,
    state: RobotState,
    tick: usize,
}

impl Walk {
    /// The robot stands.
    fn new(robot: Robot, settings: PlannerSettings) -> Walk {
        let state = RobotState::standing(&Task::new(robot.clone(), Terrain::flat(), Goal::at(0., 0.)).unwrap());
        Walk { planner: Planner::new(robot, Terrain::flat(), settings).unwrap(), state, tick: 0 }
    }

    fn now(&self) -> f64 {
        self.tick as f64 / RATE
    }

    /// One update, from a state that differs from the planned one, and the step to the next state.
    fn step_from(&mut self, state: &RobotState, command: &Command) -> Update {
        let update = self.planner.update(state, command, self.now()).unwrap();
        self.tick += 1;
        self.state = update.plan.state(self.now());
        update
    }

    fn step(&mut self, command: &Command) -> Update {
        let state = self.state.clone();
        self.step_from(&state, command)
    }

    fn walk(&mut self, command: &Command, seconds: f64) -> Vec<Update> {
        (0..(seconds * RATE) as usize).map(|_| self.step(command)).collect()
    }

    /// Position ahead, m.
    fn x(&self) -> f64 {
        self.state.base.position[0]
    }
}

/// True if a foot is in the air at the start of the plan of an update.
fn lifted(update: &Update, foot: usize) -> bool {
    update.plan.motion.durations[foot][0] == 0.
}

#[test]
fn robots_walk_at_the_commanded_velocity() {
    for (robot, family) in [(anymal(), GaitFamily::Trot), (small(), GaitFamily::Trot), (Robot::named("pexod").unwrap(), GaitFamily::Tripod)]
    {
        let name = robot.name.clone();
        let mut walk = Walk::new(robot, PlannerSettings { families: Some(vec![family]), ..settings() });
        let first = walk.walk(&ahead(0.5), 1.);
        let from = walk.x();
        let (mut second, mut velocities) = (Vec::new(), Vec::new());
        for _ in 0..RATE as usize {
            second.push(walk.step(&ahead(0.5)));
            velocities.push(walk.state.base.velocity);
        }
        let speed = walk.x() - from;
        // Each plan must go on as the one before: the velocity at the updates does not alternate.
        let bend = |of: &[[f64; 3]]| (0..2).map(|i| (of[2][i] - 2. * of[1][i] + of[0][i]).powi(2)).sum::<f64>();
        let jitter = (velocities.windows(3).map(bend).sum::<f64>() / (velocities.len() - 2) as f64).sqrt();
        let held = first.iter().chain(&second).filter(|update| !update.renewed).count();
        println!("{name}: {speed} m/s, {held} updates kept the plan before, jitter {jitter} m/s");
        assert!(jitter < JITTER, "{name}: {jitter} m/s");
        assert!((speed - 0.5).abs() < SPEED_TOLERANCE * 0.5, "{name}: {speed} m/s");
        assert!(walk.state.base.position[1].abs() < 0.05, "{name}: {:?}", walk.state.base);
        // At times the gait in force does not hold.
        let same = second.iter().filter(|update| update.plan.gait.family == Some(family)).count();
        assert!(10 * same >= 9 * second.len() && held <= 5, "{name}: {same} updates chose the family, {held} kept the plan before");
    }
}

#[test]
fn a_robot_on_soles_walks_and_turns() {
    let command = Command { velocity: [0.2, 0.], yaw_rate: 0.3 };
    let mut walk = Walk::new(
        Robot::named("humanoid").unwrap(),
        PlannerSettings { families: Some(vec![GaitFamily::Walk]), horizon: None, candidates: 16, ..settings() },
    );
    walk.walk(&command, 1.);
    let (start, mut yaws, mut held) = (walk.state.base, Vec::new(), 0);
    for _ in 0..(3. * RATE) as usize {
        let before = walk.state.clone();
        let update = walk.step(&command);
        held += usize::from(!update.renewed);
        // Soles turn in the air only, and stay near the yaw of the base.
        for (foot, (before, after)) in before.feet.iter().zip(&walk.state.feet).enumerate() {
            if before.contact && after.contact {
                assert!((before.yaw - after.yaw).abs() < 1e-9, "foot {foot} turns on the ground at {} s", walk.now());
            }
        }
        yaws.push(walk.state.feet.iter().map(|foot| foot.yaw).sum::<f64>() / 2. - walk.state.base.yaw());
    }
    let end = walk.state.base;
    let (distance, turn) = ((end.position[0] - start.position[0]).hypot(end.position[1] - start.position[1]), end.yaw() - start.yaw());
    let apart = yaws.iter().fold(0_f64, |most, yaw| most.max(yaw.abs()));
    println!("{distance} m, {turn} rad, soles {apart} rad from the base, {held} updates kept the plan before");
    assert!((distance - 0.6).abs() < 0.15 && (turn - 0.9).abs() < 0.25 && apart < 0.3 && held <= 5);
}

#[test]
fn soles_turned_beyond_their_limit_are_no_obstacle() {
    let robot = Robot::named("humanoid").unwrap();
    let turn = robot.sole.unwrap().turn;
    let families = Some(vec![GaitFamily::Walk]);
    let mut walk = Walk::new(robot, PlannerSettings { families, horizon: None, candidates: 8, ..settings() });
    for foot in &mut walk.state.feet {
        foot.yaw = turn + 0.1;
    }
    let updates = walk.walk(&Command::default(), 0.1);
    assert!(updates.iter().all(|update| update.renewed && !update.stretched));
}

#[test]
fn the_next_step_is_not_put_off_by_every_update() {
    for (name, speed) in [("anymal", 0.3), ("anymal", 0.8), ("hyq", 0.3)] {
        let mut walk = Walk::new(Robot::named(name).unwrap(), PlannerSettings { candidates: 16, horizon: None, ..settings() });
        walk.walk(&ahead(speed), 1.);
        let gaits: Vec<_> = walk.walk(&ahead(speed), 3.).iter().map(|update| update.plan.gait).collect();
        let (mut passed, mut expected) = (0., 0.);
        for gaits in gaits.windows(2) {
            let phase = gaits[1].phase - gaits[0].phase;
            passed += phase - phase.round();
            expected += 1. / RATE / gaits[0].period();
        }
        println!("{name} at {speed} m/s: {passed} of {expected} strides");
        assert!(passed > 0.95 * expected, "{name} at {speed} m/s: {passed} of {expected} strides");
    }
}

#[test]
fn a_robot_that_is_turned_returns_to_its_heading() {
    // (turn, rad, and the yaw to return to): a large turn is followed.
    for (turn, heading) in [(0.08, 0.), (-0.08, 0.), (0.5, 0.4)] {
        let mut walk = Walk::new(small(), settings());
        walk.walk(&ahead(0.3), 0.5);
        walk.state.base.angles[2] += turn;
        walk.walk(&ahead(0.3), 2.5);
        let yaw = walk.state.base.yaw();
        println!("turned by {turn} rad: {yaw} rad after 2.5 s");
        assert!((yaw - heading).abs() < 0.03, "turned by {turn} rad: {yaw} rad after 2.5 s");
    }
}

#[test]
fn without_a_command_the_robot_comes_to_stand() {
    let mut walk = Walk::new(anymal(), settings());
    walk.walk(&ahead(0.5), 0.8);
    assert!(walk.state.base.velocity[0] > 0.3);
    let last = walk.walk(&ahead(0.), 1.2).pop().unwrap();
    assert_eq!(last.plan.gait.family, None);
    assert!(last.plan.motion.durations.iter().all(|phases| phases.len() == 1), "{:?}", last.plan.motion.durations);
    assert!(walk.state.base.velocity.iter().all(|v| v.abs() < 0.05), "{:?}", walk.state.base);
}

#[test]
fn plans_depend_on_the_seed_but_not_on_the_number_of_threads() {
    let plans = |threads: usize, seed: u64| {
        let mut walk = Walk::new(anymal(), PlannerSettings { threads, seed, candidates: 8, ..settings() });
        let updates = walk.walk(&ahead(0.4), 0.3);
        updates.into_iter().map(|u| (u.plan.motion.clone(), u.plan.cost.to_bits(), u.renewed, u.iterations)).collect::<Vec<_>>()
    };
    let one = plans(1, 1);
    assert!(one == plans(3, 1), "the number of threads changes a plan");
    assert!(one != plans(1, 2), "the seed changes nothing");
}

#[test]
fn touchdowns_that_are_measured_change_the_schedule() {
    // Two planners get the same states up to the tick at which a foot touches down early or late.
    let start = || {
        let mut walk = Walk::new(anymal(), settings());
        walk.walk(&ahead(0.4), 0.2);
        walk
    };
    let (mut early, mut late) = (0, 0);
    let mut walk = start();
    for ticks in 0..30 {
        let (before, state) = (walk.planner.plan().unwrap().clone(), walk.state.clone());
        let was = before.state(walk.now() - 1. / RATE);
        let plan_of = |change: &dyn Fn(&mut RobotState)| {
            let mut other = start();
            other.walk(&ahead(0.4), (f64::from(ticks) + 0.5) / RATE);
            let mut state = other.state.clone();
            change(&mut state);
            other.step_from(&state, &ahead(0.4))
        };
        let usual = walk.step(&ahead(0.4));
        for foot in 0..4 {
            let left = usual.plan.motion.durations[foot][1..].first().copied().unwrap_or(0.);
            let since = usual.plan.motion.start_swing(foot).map_or(0., |swing| swing.since);
            // In the second half of the swing by the plan before, too, which may have a longer one.
            if early == 0 && since > 2. * left && left > 0.03 {
                let update = plan_of(&|state| {
                    let at = &mut state.feet[foot];
                    (at.contact, at.position[2], at.velocity) = (true, 0., [0.; 3]);
                });
                assert!(update.renewed && !lifted(&update, foot), "foot {foot} still swings");
                early += 1;
            }
            if late == 0 && !was.feet[foot].contact && state.feet[foot].contact && !lifted(&usual, foot) {
                let update = plan_of(&|state| {
                    let at = &mut state.feet[foot];
                    (at.contact, at.position[2], at.velocity) = (false, 0.03, [0.1, 0., -0.2]);
                });
                assert!(update.renewed && lifted(&update, foot), "foot {foot} stands in the air");
                let swing = update.plan.motion.start_swing(foot).unwrap();
                // It has passed the middle of the swing: it only descends.
                assert!(swing.position[2] > 0.02 && swing.since >= 0.5 * before.gait.swing - 1e-9, "{swing:?}");
                late += 1;
            }
        }
        if early + late == 2 {
            return;
        }
    }
    panic!("{early} early and {late} late touchdowns");
}

#[test]
fn the_terrain_can_change_between_updates() {
    let mut walk = Walk::new(anymal(), settings());
    walk.walk(&ahead(0.3), 0.1);
    // It rises by 0.05 along x.
    let heights = (0..9).map(|i| vec![0.05 * f64::from(i - 4); 9]).collect();
    let ramp = Terrain { name: "ramp".into(), friction: 0.7, shape: Shape::Grid(Grid { low: [-4., -4.], high: [4., 4.], heights }) };
    let broken = Terrain { friction: f64::NAN, ..ramp.clone() };
    assert!(walk.planner.set_terrain(broken).is_err());
    assert!(matches!(walk.planner.terrain().shape, Shape::Flat));
    walk.planner.set_terrain(ramp.clone()).unwrap();
    let mut state = walk.state.clone();
    for foot in &mut state.feet {
        let [x, y, z] = &mut foot.position;
        *z += ramp.height(*x, *y);
    }
    let update = walk.step_from(&state, &ahead(0.3));
    let motion = &update.plan.motion;
    assert!(update.renewed);
    let holds = |terrain: &Terrain| verify(motion, walk.planner.robot(), terrain, motion.force_limit.unwrap()).unwrap().feasible;
    assert!(holds(&ramp) && !holds(&Terrain::flat()));
}

/// Level ground as a grid of heights.
fn level(height: f64) -> Terrain {
    Terrain {
        name: "level".into(),
        friction: 1.,
        shape: Shape::Grid(Grid { low: [-4.; 2], high: [4.; 2], heights: vec![vec![height; 9]; 9] }),
    }
}

#[test]
fn on_a_grid_feet_land_as_on_flat_ground() {
    let mut walk = Walk::new(small(), settings());
    walk.planner.set_terrain(level(0.)).unwrap();
    let held = walk.walk(&ahead(0.4), 1.).iter().filter(|update| !update.renewed).count();
    println!("{held} of 50 updates kept the plan before");
    assert!(held <= 3 && walk.x() > 0.25, "{held} of 50 updates kept the plan before, x = {}", walk.x());
}

#[test]
fn a_robot_finds_ground_that_the_map_lacks() {
    // The ground is lower than the map by this, m, from a place on that the front feet reach.
    const DEPTH: f64 = 0.04;
    let mut walk = Walk::new(small(), settings());
    // A foot that is planned to stand but does not touch the ground goes on downwards.
    let (mut held, mut sunk, mut before) = (0, [0.; 4], 0.);
    for tick in 0..150 {
        let mut state = walk.state.clone();
        for (foot, sunk) in state.feet.iter_mut().zip(&mut sunk) {
            let ground = if foot.position[0] > 0.3 { -DEPTH } else { 0. };
            let above = foot.position[2] > ground + 1e-3;
            *sunk = if foot.contact && above { *sunk + 0.3 / RATE } else { 0. };
            let planned = foot.position[2] - *sunk;
            foot.position[2] = planned.max(ground);
            // A foot that is planned to go on below the ground bears load.
            foot.contact = planned < ground || foot.contact && planned < ground + 1e-3;
        }
        held += usize::from(!walk.step_from(&state, &ahead(0.4)).renewed);
        if tick == 20 {
            before = walk.state.base.position[2];
        }
    }
    let feet: Vec<f64> = walk.state.feet.iter().map(|foot| foot.position[2]).collect();
    println!("x = {}, feet at {feet:?}, {held} of 150 updates kept the plan before", walk.x());
    assert!(walk.x() > 1. && held <= 3, "x = {}, {held} kept", walk.x());
    let lowered = before - walk.state.base.position[2];
    assert!((lowered - DEPTH).abs() < 0.02, "the base is {lowered} m lower");
    let plan = walk.planner.plan().unwrap();
    assert!((plan.terrain.height(walk.x(), 0.) + DEPTH).abs() < 0.01);
    assert!(matches!(walk.planner.terrain().shape, Shape::Flat));
}

#[test]
fn a_foot_that_finds_no_ground_reaches_deeper_at_once() {
    let mut walk = Walk::new(small(), settings());
    walk.walk(&ahead(0.4), 0.3);
    let landing = |walk: &mut Walk| loop {
        let before = walk.state.clone();
        walk.step(&ahead(0.4));
        let lands = |foot: &usize| walk.state.feet[*foot].contact && !before.feet[*foot].contact;
        if let Some(foot) = (0..4).find(lands) {
            return foot;
        }
    };
    for touches in [true, false] {
        let foot = landing(&mut walk);
        // Only 4 mm above the map at its planned touchdown, and below it afterwards.
        let mut last = None;
        for (height, contact) in [(0.004, false), (-0.004, touches)] {
            let mut state = walk.state.clone();
            (state.feet[foot].position[2], state.feet[foot].contact) = (height, contact);
            last = Some((walk.step_from(&state, &ahead(0.4)), state.feet[foot].position));
        }
        let (update, [x, y, _]) = last.unwrap();
        let ground = update.plan.terrain.height(x, y);
        assert!(update.renewed && lifted(&update, foot) != touches, "touches: {touches}, lifted: {}", lifted(&update, foot));
        assert!(if touches { ground == 0. } else { ground < -0.03 }, "the ground is expected at {ground} m");
        walk.walk(&ahead(0.4), 0.3);
    }
}

#[test]
fn a_robot_that_is_pushed_in_a_stride_gets_new_plans() {
    for (start, push) in [(1., [2., 0.]), (1.06, [0., 1.8]), (1.12, [-1.5, -1.5])] {
        let mut walk = Walk::new(small(), PlannerSettings { threads: 1, ..PlannerSettings::default() });
        walk.walk(&ahead(0.4), start);
        let updates: Vec<Update> = (0..15)
            .map(|tick| {
                let mut state = walk.state.clone();
                // A push of 0.1 s.
                for axis in 0..if tick < 5 { 2 } else { 0 } {
                    state.base.velocity[axis] += push[axis] / 5.;
                }
                walk.step_from(&state, &ahead(0.4))
            })
            .collect();
        let [renewed, stretched] = [|u: &Update| u.renewed, |u: &Update| u.stretched].map(|of| updates.iter().filter(|u| of(u)).count());
        assert!(renewed >= 14 && stretched > 0, "{push:?}: {renewed} of 15 renewed, {stretched} stretched");
        for update in updates.iter().filter(|update| update.renewed) {
            let plan = &update.plan;
            let report = verify(&plan.motion, &plan.robot, &plan.terrain, plan.motion.force_limit.unwrap()).unwrap();
            assert!(report.feasible, "{push:?}: {report:#?}");
        }
    }
}

#[test]
fn if_no_candidate_holds_the_plan_before_stays() {
    let mut walk = Walk::new(anymal(), settings());
    let mut fallen = walk.state.clone();
    (fallen.base.position[2], fallen.base.angles[0]) = (0.1, 1.2);
    let error = walk.planner.update(&fallen, &ahead(0.3), 0.).unwrap_err().to_string();
    assert!(error.starts_with("state: none of"), "{error}");
    assert!(walk.planner.plan().is_none());
    let before = walk.step(&ahead(0.3));
    assert!(before.renewed);
    let update = walk.step_from(&fallen, &ahead(0.3));
    assert!(!update.renewed && Arc::ptr_eq(&update.plan, &before.plan));
    assert!(walk.step(&ahead(0.3)).renewed);
}

#[test]
fn errors_name_the_place_of_a_bad_input() {
    let place = |result: Result<Update, Error>| result.unwrap_err().to_string();
    let mut walk = Walk::new(anymal(), settings());
    let good = walk.state.clone();
    walk.step(&ahead(0.3));
    walk.step(&ahead(0.3));
    type Change = fn(&mut RobotState);
    let states: [(Change, &str); 6] = [
        (|s| s.feet.truncate(3), "state.feet: 3 feet"),
        (|s| s.base.velocity[1] = f64::NAN, "state.base.velocity[1]"),
        (|s| s.base.angles[1] = 1.5, "state.base.pitch"),
        (|s| s.base.position[0] = f64::INFINITY, "state.base.position[0]"),
        (|s| s.feet[2].position[0] = f64::NAN, "state.feet[2].position[0]"),
        (|s| s.feet[3].velocity[2] = 1e3, "state.feet[3].velocity[2]"),
    ];
    for (change, expected) in states {
        let mut state = good.clone();
        change(&mut state);
        let error = place(walk.planner.update(&state, &ahead(0.3), walk.now()));
        assert!(error.starts_with(expected), "`{expected}`: {error}");
    }
    let commands = [
        (Command { velocity: [0., f64::NAN], yaw_rate: 0. }, walk.now(), "command.velocity[1]"),
        (Command { velocity: [0.; 2], yaw_rate: 100. }, walk.now(), "command.yaw_rate"),
        (ahead(0.3), 0.5 / RATE, "now"),
        (ahead(0.3), f64::NAN, "now"),
    ];
    for (command, now, expected) in commands {
        let error = place(walk.planner.update(&good, &command, now));
        assert!(error.starts_with(expected), "`{expected}`: {error}");
    }
    // Refused updates leave the planner as it is.
    assert!(walk.step(&ahead(0.3)).renewed);
    type Setting = fn(&mut PlannerSettings);
    let settings_of: [(Setting, &str); 10] = [
        (|s| s.horizon = Some(0.1), "planner.horizon"),
        (|s| s.interval = Some(1.), "planner.interval"),
        (|s| s.force_pieces = 1, "planner.force_pieces"),
        (|s| s.candidates = 0, "planner.candidates"),
        (|s| s.iterations = 0, "planner.iterations"),
        (|s| s.hysteresis = f64::NAN, "planner.hysteresis"),
        (|s| s.spread = -0.1, "planner.spread"),
        (|s| s.latency = -0.1, "planner.latency"),
        (|s| s.deadline = Some(0.), "planner.deadline"),
        (|s| s.families = Some(Vec::new()), "planner.families"),
    ];
    for (change, expected) in settings_of {
        let mut own = settings();
        change(&mut own);
        let error = Planner::new(anymal(), Terrain::flat(), own).err().expect(expected).to_string();
        assert!(error.starts_with(expected), "`{expected}`: {error}");
    }
}
