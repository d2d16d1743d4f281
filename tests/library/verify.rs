//! The independent verification of trajectories: it accepts TOWR's solutions, and counts planted faults in their families.

use cregopt::gait::trajectory::{GoalVelocity, MotionLimits, NamedOr};
use cregopt::gait::{Curve, FootCurves, Trajectory};
use cregopt::nlp::transcription::towr::FORCE_LIMIT;
use cregopt::robot::{FootReach, GRAVITY, ROBOTS, Reach, Robot, Slab};
use cregopt::scenario::Scenario;
use cregopt::terrain::{Grid, Shape, Terrain};
use cregopt::verify::report::{CheckFamily, DENSE_REACH, PENETRATION, ROLLOUT_ATTITUDE, ROLLOUT_POSITION, Tolerances};
use cregopt::verify::{Report, RolloutReport, TOLERANCE, verify, verify_rows};
use nalgebra::{Matrix3, Vector3};

/// Pieces of the base, s. Three of them fit between two dynamics instants: nodes 4 and 5 can move without affecting any instant.
const BASE_PIECE: f64 = 0.1 / 3.;

/// A curve with a constant value.
fn constant(value: [f64; 3], durations: &[f64]) -> Curve {
    let [x, y, z] = value;
    Curve { poly_durations: durations.into(), nodes: vec![[x, y, z, 0., 0., 0.]; durations.len() + 1] }
}

/// A robot that stands still for 1 s, with vertical forces of m g / n.
fn standing(robot: &Robot) -> Trajectory {
    standing_for(robot, 1., &[BASE_PIECE; 30])
}

/// A robot that stands still for the total duration of the base pieces.
fn standing_for(robot: &Robot, horizon: f64, base_pieces: &[f64]) -> Trajectory {
    let thirds = [0.3 * horizon, 0.4 * horizon, 0.3 * horizon];
    let base = [0., 0., robot.base_height];
    let load = [0., 0., robot.weight() / robot.feet() as f64];
    let foot = |p: &[f64; 3]| {
        let plain = FootCurves::new(constant([p[0], p[1], 0.], &thirds), constant(load, &thirds));
        let sole = robot.sole.map(|_| (constant([0.; 3], &thirds), vec![0.]));
        let (moment, yaws) = sole.unzip();
        FootCurves { moment, yaws, ..plain }
    };
    let base = [base, [0.; 3]].map(|value| constant(value, base_pieces));
    Trajectory::new(vec![vec![horizon]; robot.feet()], horizon, base, robot.nominal_feet.iter().map(foot).collect())
}

/// ANYmal at rest lifts its left front foot (0) by 5 cm from 0.3 to 0.7 s and puts it back.
///
/// Diagonal pairs carry equal forces, so that there is no moment: feet 0 and 3 go from m g / 4 to 0 and stay there, feet 1 and 2 carry the
/// rest.
fn step() -> Trajectory {
    let robot = anymal();
    let pieces = [0.1, 0.1, 0.1, 0.4, 0.1, 0.1, 0.1];
    let quarter = robot.weight() / 4.;
    let mut trajectory = standing(&robot);
    trajectory.durations[0] = vec![0.3, 0.4, 0.3];
    trajectory.ee[0].motion = constant(trajectory.ee[0].motion.nodes[0][..3].try_into().unwrap(), &[0.3, 0.2, 0.2, 0.3]);
    trajectory.ee[0].motion.nodes[2][2] = 0.05;
    for curves in &mut trajectory.ee {
        curves.force = constant([0., 0., quarter], &pieces);
    }
    for node in 3..8 {
        shift_load(&mut trajectory, node, -quarter);
    }
    trajectory
}

/// Moves load between the diagonals at a force node, N per foot: no force or moment on the base changes.
fn shift_load(trajectory: &mut Trajectory, node: usize, load: f64) {
    for (foot, sign) in [1., -1., -1., 1.].iter().enumerate() {
        trajectory.ee[foot].force.nodes[node][2] += sign * load;
    }
}

fn anymal() -> Robot {
    Robot::named("anymal").unwrap()
}

fn flat() -> Terrain {
    Terrain::named("flat").unwrap()
}

fn check(trajectory: &Trajectory) -> Report {
    verify(trajectory, &anymal(), &flat(), FORCE_LIMIT).unwrap()
}

#[test]
fn towrs_reference_solutions_violate_no_row() {
    let text = include_str!("../data/towr_solutions.jsonl");
    for (line, text) in text.lines().enumerate() {
        let trajectory = Trajectory::from_json(text).unwrap();
        let scenario = Scenario::named(trajectory.scenario.as_ref().unwrap()).unwrap();
        // The hexapod solutions were computed with the inertia as published.
        let robot = Robot::named(if scenario.robot == "pexod" { "pexod-as-published" } else { scenario.robot }).unwrap();
        let terrain = Terrain::named(scenario.terrain).unwrap();
        let report = verify(&trajectory, &robot, &terrain, FORCE_LIMIT).unwrap();
        println!("line {}, {}, T = {}\n{report}", line + 1, scenario.name, trajectory.horizon);
        assert!(report.feasible && report.n_violated == 0, "line {}\n{report}", line + 1);
        // All families except those of the other transcription.
        let asked = |family| ![CheckFamily::Momentum, CheckFamily::Motion, CheckFamily::Footing, CheckFamily::Sole].contains(&family);
        assert!(report.families.iter().all(|f| asked(f.family) == (f.rows > 0 && f.worst.is_some())), "line {}\n{report}", line + 1);
    }
}

#[test]
fn a_standing_robot_violates_no_row_and_has_no_defect() {
    for name in ROBOTS {
        let robot = Robot::named(name).unwrap();
        let report = verify(&standing(&robot), &robot, &flat(), FORCE_LIMIT).unwrap();
        assert!(report.feasible && report.n_violated == 0 && report.max_violation < 1e-12, "{name}\n{report}");
        let dense = &report.dense;
        for extreme in [dense.force_defect, dense.moment_defect] {
            assert!(extreme.value < 1e-12, "{name}\n{report}");
        }
        for extreme in [dense.reach_excess, dense.pull, dense.friction_excess, dense.penetration, dense.foot_height, dense.foot_speed] {
            assert_eq!((extreme.value, extreme.foot), (0., None), "{name}\n{report}");
        }
        assert_eq!((dense.samples, dense.final_base_speed), (1002, 0.));
        let RolloutReport { position, attitude } = report.rollout.unwrap();
        assert!(position.value < 1e-12 && attitude.value < 1e-9, "{name}\n{report}");
    }
}

#[test]
fn a_step_violates_no_row_and_its_rows_are_those_of_towr() {
    let report = check(&step());
    assert!(report.feasible && report.max_violation < 1e-12, "{report}");
    let rows = |family| report.family(family).rows;
    assert_eq!(rows(CheckFamily::Dynamics), 6 * 11);
    assert_eq!(rows(CheckFamily::BaseAcceleration), 2 * 3 * 29);
    // t = 0, 0.08, ..., 0.96 and 1.
    assert_eq!(rows(CheckFamily::Reach), 14 * 4 * 3);
    assert_eq!(rows(CheckFamily::Terrain), 4 + 3 * 3);
    // Foot 0 has free nodes at 0, 0.1, 0.2 and 0.8, 0.9, 1; the others at all eight.
    assert_eq!(rows(CheckFamily::Force), 6 * (6 + 3 * 8));
    assert_eq!(rows(CheckFamily::Swing), 4);
    assert_eq!(rows(CheckFamily::Bounds), 6 + 6 + 3 + 3 + 4 * 3);
    // Two switches on two curves; stance nodes, mid node; swing force at both switches.
    assert_eq!(rows(CheckFamily::Structure), 2 * 2 + 6 * (4 + 3 * 4) + 1 + 6 * 2);
    assert_eq!(report.n_rows, CheckFamily::ALL.map(rows).iter().sum::<usize>());
    // Between the instants: the apex of the foot, and its highest speed in the middle of the ascent, 1.5 x 0.05 m / 0.2 s.
    let (height, speed) = (report.dense.foot_height, report.dense.foot_speed);
    assert!((height.value - 0.05).abs() < 1e-12 && (height.time - 0.5).abs() < 1e-9 && height.foot == Some(0));
    assert!((speed.value - 0.375).abs() < 1e-9 && speed.foot == Some(0));
    assert!(report.dense.force_defect.value < 1e-12 && report.dense.reach_excess.value == 0.);
}

/// A fault whose size is the violation of its worst row.
struct Fault {
    name: &'static str,
    plant: fn(&mut Trajectory, f64),
    family: CheckFamily,
    /// Number of rows that it violates when it is just beyond the tolerance.
    rows: usize,
    row: &'static str,
    foot: Option<usize>,
    time: f64,
}

impl Fault {
    /// Tolerance of the row: TOWR's, or the one that depends on the robot's weight and size.
    fn tolerance(&self, trajectory: &Trajectory) -> f64 {
        if trajectory.transcription.as_deref() != Some("momentum") {
            return TOLERANCE;
        }
        let t = Tolerances::of(&anymal());
        match self.row {
            row if row.starts_with("mean force") => t.force,
            row if row.starts_with("mean moment") => t.moment,
            row if row.starts_with("mid node") => t.length,
            "foot accelerated too hard" => t.acceleration,
            row if row.starts_with("final rate") => t.rate,
            _ => t.speed,
        }
    }
}

#[rustfmt::skip]
const FAULTS: [Fault; 19] = [
    Fault { name: "one foot pushes more", plant: |t, s| t.ee[1].force.nodes[1][2] += s,
        family: CheckFamily::Dynamics, rows: 1, row: "force z", foot: None, time: 0.1 },
    // Front feet push, hind feet pull: a moment about y of 4 x 0.34 m times the force.
    Fault { name: "the load is too far in front", plant: |t, s| for (foot, sign) in [1., 1., -1., -1.].iter().enumerate() { t.ee[foot].force.nodes[1][2] += sign * s / 1.36 },
        family: CheckFamily::Dynamics, rows: 1, row: "moment y", foot: None, time: 0.1 },
    // A slope s at the end of a piece of length L accelerates by 4 s / L there, and by -4 s / L at the start of the next.
    Fault { name: "base speed jumps", plant: |t, s| t.base_lin.nodes[4][4] += s * BASE_PIECE / 8.,
        family: CheckFamily::BaseAcceleration, rows: 1, row: "acceleration y", foot: None, time: 4. * BASE_PIECE },
    Fault { name: "base rate jumps", plant: |t, s| t.base_ang.nodes[4][5] += s * BASE_PIECE / 8.,
        family: CheckFamily::BaseAcceleration, rows: 1, row: "angular acceleration yaw", foot: None, time: 4. * BASE_PIECE },
    // Box top at 0.5 - 0.42 + 0.1 = 0.18 m; at 0.48 s, 0.9 of the way up, the foot is at 0.972 of the apex.
    Fault { name: "the foot leaves its box", plant: |t, s| t.ee[0].motion.nodes[2][2] = (0.18 + s) / 0.972,
        family: CheckFamily::Reach, rows: 1, row: "z", foot: Some(0), time: 0.48 },
    Fault { name: "a lifted stance foot", plant: |t, s| { t.ee[0].motion.nodes[3][2] += s; t.ee[0].motion.nodes[4][2] += s },
        family: CheckFamily::Terrain, rows: 2, row: "stance z", foot: Some(0), time: 0.7 },
    Fault { name: "a buried mid node", plant: |t, s| t.ee[0].motion.nodes[2][2] = -s,
        family: CheckFamily::Terrain, rows: 1, row: "swing z", foot: Some(0), time: 0.5 },
    // Two feet pull; none of the four sides of the pyramid holds then.
    Fault { name: "a foot pulls", plant: |t, s| { let now = t.ee[0].force.nodes[1][2]; shift_load(t, 1, -now - s) },
        family: CheckFamily::Force, rows: 10, row: "normal force, pull", foot: Some(0), time: 0.1 },
    // The feet of one side push in opposite directions: no moment, because they share y and z.
    Fault { name: "a foot slips", plant: |t, s| { let load = t.ee[0].force.nodes[1][2] + s; t.ee[0].force.nodes[1][0] += load; t.ee[2].force.nodes[1][0] -= load },
        family: CheckFamily::Force, rows: 2, row: "friction +t1", foot: Some(0), time: 0.1 },
    Fault { name: "a force at the first node", plant: |t, s| { let now = t.ee[0].force.nodes[0][2]; shift_load(t, 0, -now - s) },
        family: CheckFamily::Force, rows: 10, row: "normal force, pull", foot: Some(0), time: 0. },
    Fault { name: "a shifted mid node", plant: |t, s| t.ee[0].motion.nodes[2][0] += s,
        family: CheckFamily::Swing, rows: 1, row: "mid node x", foot: Some(0), time: 0.5 },
    Fault { name: "a mid node too fast", plant: |t, s| t.ee[0].motion.nodes[2][4] += s,
        family: CheckFamily::Swing, rows: 1, row: "mid node velocity y", foot: Some(0), time: 0.5 },
    Fault { name: "the goal is missed", plant: |t, s| t.base_target[1] += s,
        family: CheckFamily::Bounds, rows: 1, row: "final position y", foot: None, time: 1. },
    Fault { name: "the final yaw is missed", plant: |t, s| t.yaw_target -= s,
        family: CheckFamily::Bounds, rows: 1, row: "final angle yaw", foot: None, time: 1. },
    Fault { name: "a sliding stance foot", plant: |t, s| t.ee[0].motion.nodes[4][0] += s,
        family: CheckFamily::Structure, rows: 1, row: "standing foot moved, x", foot: Some(0), time: 1. },
    Fault { name: "a foot that touches down with speed", plant: |t, s| t.ee[0].motion.nodes[3][3] += s,
        family: CheckFamily::Structure, rows: 1, row: "velocity of standing foot, x", foot: Some(0), time: 0.7 },
    Fault { name: "a mid node that rises", plant: |t, s| t.ee[0].motion.nodes[2][5] += s,
        family: CheckFamily::Structure, rows: 1, row: "mid node velocity z", foot: Some(0), time: 0.5 },
    Fault { name: "a force at lift-off", plant: |t, s| shift_load(t, 3, s),
        family: CheckFamily::Structure, rows: 1, row: "force in swing, z", foot: Some(0), time: 0.3 },
    Fault { name: "a force slope at touch-down", plant: |t, s| for (foot, sign) in [1., -1., -1., 1.].iter().enumerate() { t.ee[foot].force.nodes[4][5] += sign * s },
        family: CheckFamily::Structure, rows: 1, row: "force slope in swing, z", foot: Some(0), time: 0.7 },
];

/// Plants every fault just below the tolerance, just above it and well above it.
fn check_faults(faults: &[Fault], faultless: fn() -> Trajectory) {
    for fault in faults {
        for part in [0.99, 1.01, 10.] {
            let mut trajectory = faultless();
            let tolerance = fault.tolerance(&trajectory);
            let size = part * tolerance;
            (fault.plant)(&mut trajectory, size);
            let report = check(&trajectory);
            let context = format!("{} by {size}\n{report}", fault.name);
            let counted = report.family(fault.family);
            assert_eq!(counted.violated, report.n_violated, "in another family: {context}");
            assert_eq!(report.feasible, part < 1., "{context}");
            if part == 1.01 {
                assert_eq!(counted.violated, fault.rows, "{context}");
            }
            let worst = counted.worst.as_ref().unwrap();
            assert_eq!((worst.row.as_str(), worst.foot), (fault.row, fault.foot), "{context}");
            assert!((worst.time - fault.time).abs() < 1e-9 && (worst.violation - size).abs() < 1e-9, "{context}");
            assert_eq!(report.max_violation, counted.max_violation, "{context}");
        }
    }
}

#[test]
fn planted_faults_are_counted_in_their_family_and_beyond_the_tolerance_only() {
    check_faults(&FAULTS, step);
}

#[test]
fn acceleration_may_jump_in_another_transcription() {
    let mut trajectory = step();
    trajectory.base_lin.nodes[4][4] += 0.01;
    for (transcription, feasible) in [(None, false), (Some("towr"), false), (Some("momentum"), false), (Some("contact-implicit"), true)] {
        trajectory.transcription = transcription.map(Into::into);
        let report = check(&trajectory);
        assert_eq!(report.feasible, feasible, "{report}");
        let of_towr = [None, Some("towr")].contains(&transcription);
        assert_eq!(report.family(CheckFamily::BaseAcceleration).rows > 0, of_towr);
        // No force makes the base jump.
        let momentum = report.family(CheckFamily::Momentum);
        assert_eq!(momentum.violated, if transcription == Some("momentum") { report.n_violated } else { 0 }, "{report}");
        // Not at an instant, but reported: 4 x 0.01 m/s in a thirtieth of 0.1 s.
        let defect = report.dense.force_defect;
        let peak = 4. * 0.01 / BASE_PIECE / GRAVITY;
        assert!(defect.value < peak && defect.value > 0.9 * peak && (defect.time - 4. * BASE_PIECE).abs() < 1e-3, "{report}");
    }
}

#[test]
fn an_unknown_transcription_is_an_error_that_names_the_known_ones() {
    let trajectory = Trajectory { transcription: Some("foo".into()), ..step() };
    let error = verify(&trajectory, &anymal(), &flat(), FORCE_LIMIT).unwrap_err().to_string();
    assert!(error.contains("transcription `foo`") && error.contains("momentum, towr"), "{error}");
}

#[test]
fn normal_forces_are_counted_against_the_given_limit() {
    let half = anymal().weight() / 2.;
    let with_limit = |limit| verify(&step(), &anymal(), &flat(), limit).unwrap();
    assert!(with_limit(half - 0.99 * TOLERANCE).feasible);
    let report = with_limit(half - 1.01 * TOLERANCE);
    // Feet 1 and 2 carry half the weight at the nodes 3 to 7.
    assert_eq!((report.n_violated, report.family(CheckFamily::Force).violated), (10, 10), "{report}");
    let worst = report.family(CheckFamily::Force).worst.as_ref().unwrap();
    assert_eq!((worst.row.as_str(), worst.foot), ("normal force, limit", Some(1)));
    assert!(with_limit(f64::NAN).family(CheckFamily::Force).violated > 0);
}

/// ANYmal in stance around x = 1.5 m, with one force on each foot.
fn standing_on(terrain: &Terrain, force: [f64; 3]) -> Trajectory {
    let mut trajectory = standing(&anymal());
    for curves in &mut trajectory.ee {
        for node in &mut curves.motion.nodes {
            node[0] += 1.5;
            node[2] = terrain.height(node[0], node[1]);
        }
        curves.force = constant(force, &curves.force.poly_durations);
    }
    trajectory
}

#[test]
fn friction_is_that_of_the_slope_under_the_foothold() {
    // A vertical force on a slope of 0.7 has a component along the slope 0.7 times as large as its normal component.
    let load = anymal().weight() / 4.;
    for (friction, violated) in [(0.701, 0), (0.699, 4 * 4)] {
        let terrain = Terrain { friction, ..Terrain::named("slope").unwrap() };
        let report = verify(&standing_on(&terrain, [0., 0., load]), &anymal(), &terrain, FORCE_LIMIT).unwrap();
        assert_eq!(report.family(CheckFamily::Force).violated, violated, "{report}");
        assert_eq!(report.family(CheckFamily::Terrain).violated, 0, "{report}");
        // Divided by the length of (1, 0, 0.7).
        let excess = (0.7 - friction).max(0.) / 4. / 1.49_f64.sqrt();
        assert!((report.dense.friction_excess.value - excess).abs() < 1e-12, "{report}");
    }
    // A force normal to the slope needs no friction; rotated about the vertical it slips.
    for (name, across) in [("slope", [-70., 0., 100.]), ("chimney", [0., -300., 100.])] {
        let terrain = Terrain { friction: 1e-3, ..Terrain::named(name).unwrap() };
        let violated = |force, limit| {
            let report = verify(&standing_on(&terrain, force), &anymal(), &terrain, limit).unwrap();
            report.family(CheckFamily::Force).violated
        };
        let whole = across.iter().map(|f| f * f).sum::<f64>().sqrt();
        assert_eq!(violated(across, whole + 0.99 * TOLERANCE), 0, "{name}");
        assert_eq!(violated(across, whole - 1.01 * TOLERANCE), 4 * 4, "{name}");
        assert!(violated([-across[0], -across[1], across[2]], whole) > 0, "{name}");
    }
}

#[test]
fn violations_between_the_instants_are_reported_but_not_counted() {
    let mut trajectory = step();
    // A slope of the force where the load is zero: next to the node one diagonal pulls, and the other carries more.
    for (foot, sign) in [-1., 1., 1., -1.].iter().enumerate() {
        trajectory.ee[foot].force.nodes[5][5] += sign * 2000.;
    }
    // The apex at 0.5 s is 1 mm out of reach; the nearest reach instants are 0.48 and 0.56 s.
    trajectory.ee[0].motion.nodes[2][2] = 0.181;
    let report = check(&trajectory);
    assert!(report.feasible, "{report}");
    // A piece of length d that is zero at both ends, with slope s at one of them, has its extreme 4/27 s d at a distance of d / 3 from
    // there.
    let expected = 4. / 27. * 2000. * 0.1 / anymal().weight();
    let (pull, reach) = (report.dense.pull, report.dense.reach_excess);
    assert!((pull.value - expected).abs() < 1e-3 * expected && [Some(0), Some(3)].contains(&pull.foot), "{report}");
    assert!((pull.time - (0.8 + 0.1 / 3.)).abs() < 1e-3, "{report}");
    assert!((reach.value - 0.001).abs() < 1e-12 && reach.foot == Some(0) && (reach.time - 0.5).abs() < 1e-9, "{report}");
    assert!(report.dense.force_defect.value < 1e-12, "{report}");
}

#[test]
fn one_moved_phase_boundary_is_one_violated_row_per_curve() {
    let mut trajectory = step();
    trajectory.durations[0] = vec![0.31, 0.39, 0.3];
    let report = check(&trajectory);
    let structure = report.family(CheckFamily::Structure);
    assert_eq!((report.n_violated, structure.violated), (2, 2), "{report}");
    let worst = structure.worst.as_ref().unwrap();
    assert_eq!((worst.row.as_str(), worst.foot, worst.time), ("motion node at phase boundary", Some(0), 0.31));
    assert!((worst.violation - 0.01).abs() < 1e-12);
    // Below 1e-4, but not the same time any more.
    trajectory.durations[0] = vec![0.3 + 1e-5, 0.4 - 1e-5, 0.3];
    assert_eq!(check(&trajectory).family(CheckFamily::Structure).violated, 2);
    trajectory.durations[0] = vec![0.3 + 1e-7, 0.4 - 1e-7, 0.3];
    assert!(check(&trajectory).feasible);
}

#[test]
fn a_robot_with_another_number_of_feet_is_refused() {
    let error = verify(&step(), &Robot::named("biped").unwrap(), &flat(), FORCE_LIMIT).unwrap_err().to_string();
    assert!(error.contains("4 feet") && error.contains("2 feet") && error.contains("biped"), "{error}");
}

#[test]
fn odd_but_well_formed_trajectories_get_a_verdict() {
    let spoil: [fn(&mut Trajectory); 6] = [
        // Curves without a node at any phase boundary.
        |t| t.ee[0].motion = constant([0.34, 0.19, 0.], &[1.]),
        |t| t.ee[0].force = constant([0., 0., 1.], &[1.]),
        // A stance without a node in it.
        |t| t.durations[0] = vec![0.31, 0.1, 0.01, 0.08, 0.5],
        // Numbers that overflow.
        |t| t.ee[2].force.nodes[3] = [1e308; 6],
        |t| t.base_ang.nodes[5] = [-1e300; 6],
        // A piece so short that its cubic has no finite coefficients.
        |t| {
            t.base_lin.poly_durations.push(1e-300);
            t.base_lin.nodes.push([1.; 6]);
        },
    ];
    for (case, spoil) in spoil.iter().enumerate() {
        let mut trajectory = step();
        spoil(&mut trajectory);
        let report = check(&trajectory);
        assert!(!report.feasible && report.max_violation > 0., "case {case}\n{report}");
        assert!(!serde_json::to_string(&report).unwrap().is_empty());
    }
    // A malformed trajectory is refused even if the caller did not check it.
    let mut trajectory = step();
    trajectory.ee[1].motion.nodes.pop();
    assert!(verify(&trajectory, &anymal(), &flat(), FORCE_LIMIT).is_err());
}

// ---------------------------------------------------------------- momentum

const LIMITS: MotionLimits =
    MotionLimits { clearance: 0.03, swing_height: 0.2, foot_speed: 0.5, foot_acceleration: None, goal_velocity: GoalVelocity::Zero };

fn momentum(trajectory: Trajectory) -> Trajectory {
    Trajectory { transcription: Some("momentum".into()), limits: Some(LIMITS), ..trajectory }
}

/// The step as a motion of the `momentum` transcription.
fn momentum_step() -> Trajectory {
    momentum(step())
}

#[test]
fn a_step_violates_no_row_of_momentum() {
    let report = check(&momentum_step());
    assert!(report.feasible && report.max_violation < 1e-9, "{report}");
    let rows = |family| report.family(family).rows;
    assert_eq!((rows(CheckFamily::Dynamics), rows(CheckFamily::BaseAcceleration)), (0, 0));
    // Velocity, position, angular momentum and the angle at the end of each base piece.
    assert_eq!(rows(CheckFamily::Momentum), 30 * (3 * 3 + 1));
    assert_eq!((rows(CheckFamily::Swing), rows(CheckFamily::Motion)), (3, 8));
    assert_eq!(rows(CheckFamily::Bounds), 6 + 6 + 3 + 3 + 4 * 3 + 3 + 3);
    for family in [CheckFamily::Reach, CheckFamily::Terrain, CheckFamily::Structure] {
        assert_eq!(rows(family), check(&step()).family(family).rows);
    }
    // One cone instead of the four sides of a pyramid.
    assert_eq!(rows(CheckFamily::Force) * 2, check(&step()).family(CheckFamily::Force).rows);
    // A trajectory without limits is verified against the defaults.
    let report = check(&Trajectory { limits: None, ..momentum_step() });
    assert_eq!((report.family(CheckFamily::Swing).rows, report.family(CheckFamily::Bounds).rows), (3, rows(CheckFamily::Bounds)));
}

/// The base rises from rest by `acceleration` and turns about the vertical by `turn`, as the forces of feet 1 and 2 require.
fn accelerate(trajectory: &mut Trajectory, acceleration: f64, turn: f64) {
    let (robot, half_length) = (anymal(), 0.34);
    for (node, t) in (0..=30).map(|k| f64::from(k) * BASE_PIECE).enumerate() {
        for (curve, axis, by) in [(&mut trajectory.base_lin, 2, acceleration), (&mut trajectory.base_ang, 2, turn)] {
            curve.nodes[node][axis] += by * t * t / 2.;
            curve.nodes[node][axis + 3] += by * t;
        }
    }
    trajectory.base_target[2] += acceleration / 2.;
    trajectory.yaw_target += turn / 2.;
    for (foot, sign) in [(1, 1.), (2, -1.)] {
        for node in &mut trajectory.ee[foot].force.nodes {
            node[2] += robot.mass * acceleration / 2.;
            node[1] += sign * robot.inertia[2][2] * turn / (2. * half_length);
        }
    }
}

/// Mean, over its first third, of a force that falls from s to 0 along half a cubic in 0.1 s; and the mean weighted with the remaining
/// time (`int 2 (1 - w) (1 - w^2/3 + 2 w^3/27) dw`).
const MEAN: f64 = 49. / 54.;
const EARLY_MEAN: f64 = 257. / 270.;

#[rustfmt::skip]
const MOMENTUM_FAULTS: [Fault; 10] = [
    Fault { name: "one foot pushes more at the start", plant: |t, s| t.ee[1].force.nodes[0][2] += s / EARLY_MEAN,
        family: CheckFamily::Momentum, rows: 1, row: "mean force for the displacement z", foot: None, time: BASE_PIECE },
    // Late forces have less effect on the position.
    Fault { name: "one foot pushes more at the end", plant: |t, s| t.ee[1].force.nodes[7][2] += s / MEAN,
        family: CheckFamily::Momentum, rows: 1, row: "mean force z", foot: None, time: 1. },
    Fault { name: "the load is too far in front", plant: |t, s| for (foot, sign) in [1., 1., -1., -1.].iter().enumerate() { t.ee[foot].force.nodes[0][2] += sign * s / 1.36 / MEAN },
        family: CheckFamily::Momentum, rows: 1, row: "mean moment y", foot: None, time: BASE_PIECE },
    // The piece after the jump goes s L too far; correcting the position takes twice the force that corrects the velocity.
    Fault { name: "base speed jumps", plant: |t, s| t.base_lin.nodes[4][4] += s * BASE_PIECE / (2. * anymal().mass),
        family: CheckFamily::Momentum, rows: 1, row: "mean force for the displacement y", foot: None, time: 5. * BASE_PIECE },
    Fault { name: "a mid node too low", plant: |t, s| t.ee[0].motion.nodes[2][2] = 0.03 - s,
        family: CheckFamily::Swing, rows: 1, row: "mid node too low", foot: Some(0), time: 0.5 },
    Fault { name: "a mid node too high", plant: |t, s| { t.limits = Some(MotionLimits { swing_height: 0.1, ..LIMITS }); t.ee[0].motion.nodes[2][2] = 0.1 + s },
        family: CheckFamily::Swing, rows: 1, row: "mid node too high", foot: Some(0), time: 0.5 },
    Fault { name: "a foot too fast", plant: |t, s| { t.ee[0].motion.nodes[2][3] = 0.3; t.ee[0].motion.nodes[2][4] = ((0.5 + s).powi(2) - 0.09).sqrt() },
        family: CheckFamily::Swing, rows: 1, row: "foot too fast", foot: Some(0), time: 0.5 },
    // Ascent to the height h from rest to rest in 0.2 s: 6 h / 0.04 s^2.
    Fault { name: "a foot accelerated too hard", plant: |t, s| { t.limits = Some(MotionLimits { foot_acceleration: Some(7.5), ..LIMITS }); t.ee[0].motion.nodes[2][2] = (7.5 + s) / 150. },
        family: CheckFamily::Swing, rows: 1, row: "foot accelerated too hard", foot: Some(0), time: 0.5 },
    Fault { name: "the base arrives with speed", plant: |t, s| accelerate(t, s, 0.),
        family: CheckFamily::Bounds, rows: 1, row: "final velocity z", foot: None, time: 1. },
    Fault { name: "the base arrives turning", plant: |t, s| accelerate(t, 0., s),
        family: CheckFamily::Bounds, rows: 1, row: "final rate yaw", foot: None, time: 1. },
];

#[test]
fn planted_faults_of_momentum_are_counted_in_their_family_and_beyond_the_tolerance_only() {
    check_faults(&MOMENTUM_FAULTS, momentum_step);
}

#[test]
fn a_foot_that_is_accelerated_too_hard_is_refused_where_there_is_a_limit() {
    // In the middle 7.5 m/s^2 downwards, and 4 v / 0.2 s = 6 m/s^2 along: sqrt(92.25) = 9.605 m/s^2, the largest acceleration of the
    // swing.
    let mut trajectory = momentum_step();
    trajectory.ee[0].motion.nodes[2][4] = 0.3;
    for (limit, rows, violated) in [(None, 3, 0), (Some(9.61), 4, 0), (Some(9.59), 4, 1)] {
        trajectory.limits = Some(MotionLimits { foot_acceleration: limit, ..LIMITS });
        let report = check(&trajectory);
        let swing = report.family(CheckFamily::Swing);
        assert_eq!((report.feasible, swing.rows, swing.violated), (violated == 0, rows, violated), "{limit:?}\n{report}");
        // Stance feet have no acceleration: the same limit holds for a robot that stands.
        let standing = momentum(standing(&anymal()));
        assert!(check(&Trajectory { limits: trajectory.limits, ..standing }).feasible);
    }
}

#[test]
fn the_base_may_arrive_with_speed_where_its_goal_is_free() {
    let mut trajectory = momentum_step();
    accelerate(&mut trajectory, 0.02, 1e-3);
    let report = check(&trajectory);
    assert_eq!((report.n_violated, report.family(CheckFamily::Bounds).violated), (2, 2), "{report}");
    assert!((report.dense.final_base_speed - 0.02).abs() < 1e-12);
    trajectory.limits = Some(MotionLimits { goal_velocity: GoalVelocity::Free, ..LIMITS });
    assert!(check(&trajectory).feasible);
}

#[test]
fn the_attitude_of_a_base_piece_has_its_own_limit() {
    for (angle, violated) in [(0.99e-2, 0), (1.01e-2, 2)] {
        // Turned at one node and at rest there: the pieces before and after it do not move that way.
        let mut trajectory = momentum_step();
        trajectory.base_ang.nodes[4][2] = angle;
        let report = check(&trajectory);
        assert_eq!((report.n_violated, report.family(CheckFamily::Momentum).violated), (violated, violated), "{report}");
        let worst = report.family(CheckFamily::Momentum).worst.as_ref().unwrap();
        assert!(worst.row == "attitude" && (worst.violation - angle).abs() < 1e-9, "{report}");
    }
}

#[test]
fn a_foot_may_be_a_little_outside_its_box() {
    // Apex at a reach instant.
    for (outside, reach, motion) in [(0.0049, 0, 0), (0.00505, 0, 1), (0.0053, 1, 0)] {
        let mut trajectory = momentum_step();
        trajectory.ee[0].motion.poly_durations = vec![0.3, 0.18, 0.22, 0.3];
        trajectory.ee[0].motion.nodes[2][2] = 0.18 + outside;
        let report = check(&trajectory);
        assert_eq!((report.family(CheckFamily::Reach).violated, report.family(CheckFamily::Motion).violated), (reach, motion), "{report}");
        assert_eq!(report.n_violated, reach + motion, "{report}");
        trajectory.transcription = Some("towr".into());
        assert_eq!(check(&trajectory).family(CheckFamily::Reach).violated, 1);
    }
}

/// ANYmal with one box per foot.
fn with_reach(change: impl FnOnce(&mut Vec<[[f64; 2]; 3]>)) -> Robot {
    let mut boxes = vec![[[-0.15, 0.15], [-0.1, 0.1], [-0.1, 0.1]]; 4];
    change(&mut boxes);
    Robot { reach: Reach::boxes(boxes), ..anymal() }
}

#[test]
fn a_foot_is_verified_against_its_own_box() {
    // The feet stand 8 cm below their nominal positions; foot 0 swings 3 cm ahead and back.
    let swung = |x: f64| {
        let mut trajectory = momentum_step();
        trajectory.ee[0].motion.nodes[2][0] += x;
        trajectory
    };
    let check = |trajectory: &Trajectory, robot: &Robot| verify(trajectory, robot, &flat(), FORCE_LIMIT).unwrap();
    let narrow = with_reach(|boxes| boxes[0][0] = [-0.15, 0.02]);
    assert!(check(&swung(0.03), &with_reach(|_| {})).feasible);
    assert!(check(&swung(-0.03), &narrow).feasible);
    let report = check(&swung(0.03), &narrow);
    let worst = report.family(CheckFamily::Reach).worst.clone().unwrap();
    assert!(!report.feasible && worst.row == "x" && worst.foot == Some(0), "{report}");
    assert!((report.dense.reach_excess.value - 0.01).abs() < 1e-9 && report.dense.reach_excess.foot == Some(0), "{report}");
    // The sides of the other feet do not apply to foot 0.
    assert!(check(&swung(0.03), &with_reach(|boxes| boxes[1][0] = [-0.15, 0.02])).feasible);
    let report = check(&swung(0.), &with_reach(|boxes| boxes[2][2] = [-0.07, 0.1]));
    assert!(!report.feasible && report.family(CheckFamily::Reach).worst.as_ref().unwrap().foot == Some(2), "{report}");
    assert!(check(&swung(0.), &with_reach(|boxes| boxes[2][2] = [-0.08, 0.])).feasible);
}

#[test]
fn a_foot_beyond_a_diagonal_face_is_refused() {
    // Foot 0 swings 5 cm ahead and back. Its place is 8 cm below the nominal position: 0.8 x - 0.6 z is 0.048 m there.
    let swung = |x: f64| {
        let mut trajectory = momentum_step();
        trajectory.ee[0].motion.nodes[2][0] += x;
        trajectory
    };
    let check = |x: f64, foot: usize, normal: [f64; 3], sides: [f64; 2]| {
        let mut feet: Vec<FootReach> = vec![[[-0.15, 0.15], [-0.1, 0.1], [-0.1, 0.1]].into(); 4];
        feet[foot].diagonals.push(Slab { normal, sides });
        let robot = Robot { reach: Reach::PerFoot(feet), ..anymal() };
        robot.validate().unwrap();
        verify(&swung(x), &robot, &flat(), FORCE_LIMIT).unwrap()
    };
    let lean = [0.8, 0., -0.6];
    for (x, foot, normal, sides, feasible) in [
        (0., 0, lean, [-0.1, 0.05], true),
        (0.05, 0, lean, [-0.1, 0.1], true),
        (0.05, 1, lean, [-0.1, 0.05], true),
        (0.05, 0, lean, [-0.1, 0.05], false),
        (0.05, 0, lean.map(|v| -v), [-0.05, 0.1], false),
        (0., 2, lean, [-0.1, 0.04], false),
    ] {
        let report = check(x, foot, normal, sides);
        assert_eq!(report.feasible, feasible, "{x} {sides:?}: {report}");
        if !feasible {
            let worst = report.family(CheckFamily::Reach).worst.clone().unwrap();
            assert!(worst.row == "diagonal" && worst.foot == Some(foot), "{report}");
            assert!(report.dense.reach_excess.value > 5e-3 && report.dense.reach_excess.foot == Some(foot), "{report}");
        }
    }
}

/// Level ground that rises to 0.2 m within 2 mm before `x`.
fn riser(x: f64) -> Terrain {
    let heights = (0..1000).map(|i| vec![if f64::from(i) * 2e-3 - 1. >= x - 1e-9 { 0.2 } else { 0. }; 2]).collect();
    Terrain { name: "riser".into(), friction: 1., shape: Shape::Grid(Grid { low: [-1.; 2], high: [1.; 2], heights }) }
}

#[test]
fn a_ball_keeps_from_a_riser_and_a_foothold_from_an_edge() {
    // Foot 0 stands at x = 0.34 m.
    let swung = |x: f64, landing: f64| {
        let mut trajectory = momentum_step();
        trajectory.ee[0].motion.nodes[2][0] += x;
        trajectory.ee[0].motion.nodes[3][0] += landing;
        trajectory.ee[0].motion.nodes[4][0] += landing;
        trajectory
    };
    let with = |radius| Robot { foot_radius: Some(radius), ..anymal() };
    let check = |trajectory: &Trajectory, radius: f64, x: f64| verify(trajectory, &with(radius), &riser(x), FORCE_LIMIT).unwrap();
    let worst = |report: &Report| {
        let footing = report.family(CheckFamily::Footing);
        assert_eq!((report.n_violated, footing.violated), (1, 1), "{report}");
        let worst = footing.worst.clone().unwrap();
        assert_eq!(worst.foot, Some(0));
        (worst.row, worst.violation, worst.time)
    };
    // The bottom of the riser is 2 cm ahead of the swing's turning point, and its face leans by 1 mm.
    let report = check(&swung(0.02, 0.), 0.03, 0.382);
    let (row, violation, time) = worst(&report);
    assert!(row == "ball in the ground" && (violation - (0.01 - 0.125 * 0.03)).abs() < 1e-3 && (time - 0.5).abs() < 0.01, "{report}");
    assert!((report.dense.ball_depth.value - 0.01).abs() < 1e-3 && report.dense.ball_depth.foot == Some(0), "{report}");
    assert!(check(&swung(0.02, 0.), 0.02, 0.382).feasible && check(&swung(0.02, 0.), 0., 0.382).feasible);
    assert!(check(&swung(0.01, 0.), 0.03, 0.382).feasible);
    // The foothold at the start is given, the landing one is not: 1 cm from the riser, whose upper edge is 0.2 m off the plane.
    let report = check(&swung(0., 0.), 0.03, 0.352);
    let (row, violation, time) = worst(&report);
    assert!(row == "foothold at an edge" && (violation - (0.2 - 0.015)).abs() < 1e-9 && (time - 0.7).abs() < 1e-9, "{report}");
    assert!((report.dense.foothold_off_plane.value - 0.2).abs() < 1e-9, "{report}");
    assert!(check(&swung(0., 0.), 0.009, 0.352).feasible);
    // Flat ground has no edges to keep from, and TOWR's own rows have no such limit.
    assert_eq!(verify(&swung(0.02, 0.), &with(0.03), &flat(), FORCE_LIMIT).unwrap().family(CheckFamily::Footing).rows, 0);
    let towr = Trajectory { transcription: None, limits: None, ..swung(0., 0.) };
    let report = check(&towr, 0.03, 0.352);
    assert!(report.family(CheckFamily::Footing).rows == 0 && report.dense.foothold_off_plane.value > 0.1, "{report}");
}

/// A fault between the instants; its size is in the unit of the row.
struct MotionFault {
    name: &'static str,
    faultless: fn() -> Trajectory,
    plant: fn(&mut Trajectory, f64),
    row: &'static str,
    /// Limit of the row, in the unit of `plant`.
    limit: f64,
    unit: f64,
    foot: Option<usize>,
    time: f64,
}

/// Extreme of a cubic that is zero at both ends of a piece of 0.1 s, per slope at one of them; it is a third of the piece away from there.
const BULGE: f64 = 4. / 27. * 0.1;

/// Weight of ANYmal, N.
const WEIGHT: f64 = 29.5 * GRAVITY;

/// Duration of a stance in which forces within the tolerance move the base visibly, s.
const LONG: f64 = 110.;

#[rustfmt::skip]
const MOTION_FAULTS: [MotionFault; 6] = [
    // dF T^2 / (2 m), by four feet.
    MotionFault { name: "a small force for long", faultless: || momentum(standing_for(&anymal(), LONG, &[0.1; 10 * LONG as usize])),
        plant: |t, s| t.ee.iter_mut().flat_map(|e| &mut e.force.nodes).for_each(|node| node[2] += 2. * anymal().mass * s / (LONG * LONG) / 4.),
        row: "position off the rollout", limit: ROLLOUT_POSITION, unit: 1., foot: None, time: LONG },
    // In two parts, each within the limit of a piece.
    MotionFault { name: "the base turns by itself", faultless: momentum_step,
        plant: |t, s| for (node, part) in [(4, 0.5), (5, 1.), (6, 0.5)] { t.base_ang.nodes[node][2] = part * s.to_radians() },
        row: "attitude off the rollout", limit: ROLLOUT_ATTITUDE, unit: 1., foot: None, time: 5. * BASE_PIECE },
    // The box ends at 0.18 m; the nearest reach instant is 0.02 s before the apex.
    MotionFault { name: "the foot leaves its box", faultless: momentum_step, plant: |t, s| t.ee[0].motion.nodes[2][2] = 0.18 + s,
        row: "reach", limit: DENSE_REACH, unit: 1., foot: Some(0), time: 0.5 },
    MotionFault { name: "a foot pulls between nodes", faultless: momentum_step,
        plant: |t, s| for (foot, sign) in [1., -1., -1., 1.].iter().enumerate() { t.ee[foot].force.nodes[7][5] = sign * s / BULGE },
        row: "normal force, pull", limit: 1e-4 * WEIGHT, unit: WEIGHT, foot: Some(0), time: 0.9 + 0.2 / 3. },
    // The feet of one side push in opposite directions.
    MotionFault { name: "a foot slips between nodes", faultless: momentum_step,
        plant: |t, s| for (foot, sign) in [(0, 1.), (2, -1.)] { t.ee[foot].force.nodes[0][3] = sign * (0.5 * WEIGHT / 4. + s) / BULGE },
        row: "friction cone", limit: 1e-4 * WEIGHT, unit: WEIGHT, foot: Some(0), time: 0.1 / 3. },
    // A swing in three pieces that touches the ground twice.
    MotionFault { name: "a foot dips into the ground", faultless: momentum_step,
        plant: |t, s| {
            let motion = &mut t.ee[0].motion;
            motion.poly_durations = vec![0.3, 0.2, 0.1, 0.1, 0.3];
            let mut touching = motion.nodes[3];
            touching[5] = -s / BULGE;
            motion.nodes.insert(3, touching);
        },
        row: "foot below terrain", limit: PENETRATION, unit: 1., foot: Some(0), time: 0.6 + 0.1 / 3. },
];

/// Level ground on which a foot slips before it pulls.
fn smooth() -> Terrain {
    Terrain { friction: 0.5, ..flat() }
}

#[test]
fn planted_faults_between_the_instants_are_counted_beyond_their_limit_only() {
    for fault in &MOTION_FAULTS {
        for part in [0.99, 1.01] {
            let mut trajectory = (fault.faultless)();
            (fault.plant)(&mut trajectory, part * fault.limit);
            let report = verify(&trajectory, &anymal(), &smooth(), FORCE_LIMIT).unwrap();
            let context = format!("{}, {part} of its limit\n{report}", fault.name);
            let (motion, violated) = (report.family(CheckFamily::Motion), usize::from(part > 1.));
            assert_eq!((motion.rows, motion.violated, report.n_violated), (8, violated, violated), "{context}");
            assert_eq!(report.feasible, part < 1., "{context}");
            if part > 1. {
                let worst = motion.worst.as_ref().unwrap();
                assert_eq!((worst.row.as_str(), worst.foot), (fault.row, fault.foot), "{context}");
                let over = 0.01 * fault.limit / fault.unit;
                assert!((worst.time - fault.time).abs() < 1e-4 && (worst.violation - over).abs() < 1e-3 * over, "{context}");
            }
        }
    }
}

#[test]
fn a_stance_foot_that_moves_between_its_nodes_is_refused() {
    let limit = Tolerances::of(&anymal()).length;
    for part in [0.99, 1.01] {
        let mut trajectory = momentum(standing_for(&anymal(), LONG, &[0.1; 10 * LONG as usize]));
        // So slowly that the nodes do not show it, over 44 s.
        trajectory.ee[1].motion.nodes[1][5] = part * limit / (4. / 27. * 0.4 * LONG);
        let report = check(&trajectory);
        assert_eq!((report.feasible, report.n_violated), (part < 1., usize::from(part > 1.)), "{report}");
        if part > 1. {
            let worst = report.family(CheckFamily::Motion).worst.as_ref().unwrap();
            assert_eq!((worst.row.as_str(), worst.foot), ("standing foot off its foothold", Some(1)), "{report}");
            assert!((worst.time - (0.3 + 0.4 / 3.) * LONG).abs() < 0.1, "{report}");
        }
    }
}

#[test]
fn long_pieces_accumulate_as_much_drift_as_short_ones() {
    // A push before the end that the plan does not contain: 1.5 mm/s at the end for 29.5 kg.
    for pieces in [&[2.][..], &[0.1; 20]] {
        let mut trajectory = momentum(standing_for(&anymal(), 2., pieces));
        assert!(check(&trajectory).feasible);
        for foot in &mut trajectory.ee {
            foot.force.nodes[3][2] += 1.5e-3 * anymal().mass / 0.3 / 4.;
        }
        let report = check(&trajectory);
        assert!(report.family(CheckFamily::Momentum).violated > 0, "{report}");
    }
}

#[test]
fn rows_between_the_instants_count_only_in_momentum_and_if_all_others_hold() {
    for fault in &MOTION_FAULTS[2..] {
        let mut trajectory = (fault.faultless)();
        (fault.plant)(&mut trajectory, 1.01 * fault.limit);
        for transcription in [None, Some("towr"), Some("momentum")] {
            trajectory.transcription = transcription.map(Into::into);
            let report = verify(&trajectory, &anymal(), &smooth(), FORCE_LIMIT).unwrap();
            let asked = transcription == Some("momentum");
            let rows = |family| report.family(family).rows;
            assert_eq!(
                (rows(CheckFamily::Momentum) > 0, rows(CheckFamily::Motion) > 0, report.feasible),
                (asked, asked, !asked),
                "{report}"
            );
            assert!(report.rollout.is_some());
        }
        trajectory.base_target[0] += 0.01;
        let report = verify(&trajectory, &anymal(), &smooth(), FORCE_LIMIT).unwrap();
        assert_eq!((report.family(CheckFamily::Motion).rows, report.n_violated), (0, 1), "{report}");
    }
    // Nor do the limits of a swing and the rest at the goal.
    let mut trajectory = step();
    trajectory.ee[0].motion.nodes[2][2] = 0.01;
    assert!(check(&trajectory).feasible);
}

// ---------------------------------------------------------------- rollout

fn rollout(trajectory: &Trajectory, robot: &Robot) -> RolloutReport {
    verify(trajectory, robot, &flat(), FORCE_LIMIT).unwrap().rollout.unwrap()
}

#[test]
fn a_force_missing_from_the_plan_moves_the_base() {
    // However the base turns, it moves by dF T^2 / (2 m).
    let (robot, force) = (anymal(), [7., -3., 5.]);
    let mut trajectory = standing(&robot);
    for node in trajectory.ee.iter_mut().flat_map(|e| &mut e.force.nodes) {
        (0..3).for_each(|d| node[d] += force[d] / 4.);
    }
    let position = rollout(&trajectory, &robot).position;
    let expected = Vector3::from(force).norm() / (2. * robot.mass);
    assert!((position.value - expected).abs() < 1e-9 && (position.time - 1.).abs() < 1e-9, "{position:?}");
}

#[test]
fn a_couple_missing_from_the_plan_turns_the_base() {
    let mut robot = anymal();
    robot.inertia = [[1., 0., 0.], [0., 2., 0.], [0., 0., 2.]];
    let mut trajectory = standing(&robot);
    // Front feet to the left, hind feet to the right, 1 N each at 0.34 m: 1.36 N m.
    for (curves, sign) in trajectory.ee.iter_mut().zip([1., 1., -1., -1.]) {
        curves.force.nodes.iter_mut().for_each(|node| node[1] = sign);
    }
    let report = rollout(&trajectory, &robot);
    let expected = (0.5_f64 * 1.36 / 2.).to_degrees();
    assert!((report.attitude.value - expected).abs() < 1e-9 && (report.attitude.time - 1.).abs() < 1e-9, "{report}");
    assert!(report.position.value < 1e-12, "{report}");
}

#[test]
fn a_robot_that_lifts_its_only_foot_falls() {
    let robot = Robot::named("monoped").unwrap();
    let weight = robot.weight();
    let mut trajectory = standing(&robot);
    trajectory.durations[0] = vec![0.3, 0.4, 0.3];
    trajectory.ee[0].motion = constant([0.; 3], &[0.3, 0.2, 0.2, 0.3]);
    trajectory.ee[0].force = constant([0., 0., weight], &[0.2, 0.1, 0.4, 0.1, 0.2]);
    for node in [2, 3] {
        trajectory.ee[0].force.nodes[node][2] = 0.;
    }
    let report = rollout(&trajectory, &robot);
    // 0.4 s without any force and 0.2 s with half of it, symmetric about 0.5 s: as if the weight were removed for 0.5 s, all at 0.5 s.
    let expected = GRAVITY * 0.5 * 0.5;
    assert!((report.position.value - expected).abs() < 1e-9 && (report.position.time - 1.).abs() < 1e-9, "{report}");
    assert!(report.attitude.value < 1e-9, "{report}");
    // Forces of a foot off the ground do not count.
    trajectory.ee[0].force.nodes[2][5] = 2000.;
    let pushes = rollout(&trajectory, &robot).position.value;
    let before_lift_off = 2000. * 0.1 * 0.1 / robot.mass * (0.7 / 12. + 0.1 / 30.);
    assert!((pushes - (expected + before_lift_off)).abs() < 1e-6, "{pushes} against {expected} + {before_lift_off}");
}

/// Orientation and angular velocity in body axes.
#[derive(Clone, Copy)]
struct Spin {
    rotation: Matrix3<f64>,
    omega: Vector3<f64>,
}

impl Spin {
    /// One step of the classical Runge-Kutta method for Euler's equations in body axes, `I w' = -w x I w` and `R' = R [w]x`.
    fn after(self, inertia: &Matrix3<f64>, step: f64) -> Spin {
        let inverse = inertia.try_inverse().unwrap();
        let rate = |s: Spin| Spin { rotation: s.rotation * s.omega.cross_matrix(), omega: inverse * (inertia * s.omega).cross(&s.omega) };
        let plus = |r: Spin, by: f64| Spin { rotation: self.rotation + r.rotation * by, omega: self.omega + r.omega * by };
        let k1 = rate(self);
        let k2 = rate(plus(k1, step / 2.));
        let k3 = rate(plus(k2, step / 2.));
        let k4 = rate(plus(k3, step));
        let rotation = (k1.rotation + (k2.rotation + k3.rotation) * 2. + k4.rotation) / 6.;
        let omega = (k1.omega + (k2.omega + k3.omega) * 2. + k4.omega) / 6.;
        plus(Spin { rotation, omega }, step)
    }

    /// Euler angles of `Rz(yaw) Ry(pitch) Rx(roll)` and their rates, away from a pitch of 90 degrees.
    fn euler(&self) -> [f64; 6] {
        let r = &self.rotation;
        let (roll, pitch, yaw) = (r[(2, 1)].atan2(r[(2, 2)]), (-r[(2, 0)]).asin(), r[(1, 0)].atan2(r[(0, 0)]));
        let [p, q, w] = [self.omega.x, self.omega.y, self.omega.z];
        let turn = q * roll.sin() + w * roll.cos();
        [roll, pitch, yaw, p + turn * pitch.tan(), q * roll.cos() - w * roll.sin(), turn / pitch.cos()]
    }
}

#[test]
fn a_tumbling_body_keeps_its_angular_momentum() {
    let inertia = [[0.31, 0.02, -0.03], [0.02, 0.42, 0.01], [-0.03, 0.01, 0.55]];
    let robot = Robot { inertia, ..Robot::named("monoped").unwrap() };
    let inertia = Matrix3::from_fn(|i, j| inertia[i][j]);
    let pieces = [0.02; 40];
    let mut trajectory = momentum(standing_for(&robot, 0.8, &pieces));
    trajectory.ee[0].force = constant([0.; 3], &[0.8]);
    let mut spin = Spin { rotation: Matrix3::identity(), omega: Vector3::new(1.5, 1., -2.) };
    let momentum = |spin: &Spin| spin.rotation * (inertia * spin.omega);
    let (start, velocity) = (momentum(&spin), [0.3, -0.2, 1.]);
    let (mut fastest, mut slowest) = (0_f64, f64::INFINITY);
    for node in 0..=pieces.len() {
        let t = 0.02 * node as f64;
        trajectory.base_ang.nodes[node] = spin.euler();
        let fall = [0., 0., -GRAVITY];
        for d in 0..3 {
            trajectory.base_lin.nodes[node][d] += velocity[d] * t + fall[d] * t * t / 2.;
            trajectory.base_lin.nodes[node][d + 3] = velocity[d] + fall[d] * t;
        }
        for _ in 0..200 {
            spin = spin.after(&inertia, 1e-4);
        }
        (fastest, slowest) = (fastest.max(spin.omega.norm()), slowest.min(spin.omega.norm()));
    }
    assert!((momentum(&spin) - start).norm() < 1e-9, "the plan conserves it");
    assert!(fastest > 1.01 * slowest, "it tumbles: {slowest} to {fastest} rad/s");

    let report = verify(&trajectory, &robot, &flat(), FORCE_LIMIT).unwrap();
    let RolloutReport { position, attitude } = report.rollout.unwrap();
    assert!(position.value < 1e-9 && attitude.value < 1e-4, "{report}");
    // From node to node only gravity changes the velocity, and nothing changes the angular momentum.
    let kept = report.family(CheckFamily::Momentum);
    assert!(kept.rows == 400 && kept.max_violation < 1e-6, "{report}");
    assert!(report.dense.moment_defect.value < 1e-3, "{report}");

    // A body that kept its first Euler rates would end elsewhere.
    let first = trajectory.base_ang.nodes[0];
    for (node, angles) in trajectory.base_ang.nodes.iter_mut().enumerate() {
        *angles = first;
        (0..3).for_each(|d| angles[d] += 0.02 * node as f64 * first[d + 3]);
    }
    let rows = verify_rows(&trajectory, &robot, &flat(), FORCE_LIMIT).unwrap();
    assert!(rollout(&trajectory, &robot).attitude.value > 5. && rows.family(CheckFamily::Momentum).violated > 100, "{rows}");
}

// ---------------------------------------------------------------- forgeries

/// Text of the row or error, and the change of the trajectory.
type Forgery = (&'static str, fn(&mut Trajectory));

/// A step as a file of its own, with impossible changes.
#[test]
fn physically_impossible_motions_are_refused_in_every_transcription() {
    let forge: [Forgery; 6] = [
        // 0.1 m to the side and back, in a fifth of a millisecond.
        ("piece too short", |t| {
            t.ee[0].motion.poly_durations = vec![0.3, 0.2, 1e-4, 1e-4, 0.2 - 2e-4, 0.3];
            let [up, aside] = [t.ee[0].motion.nodes[2], t.ee[0].motion.nodes[2]];
            t.ee[0].motion.nodes.splice(3..3, [up, aside]);
            t.ee[0].motion.nodes[3][1] += 0.1;
        }),
        // 0.3 m within two milliseconds.
        ("foot faster than possible", |t| {
            t.ee[0].motion.poly_durations = vec![0.3, 0.2, 0.002, 0.002, 0.196, 0.3];
            let [up, aside] = [t.ee[0].motion.nodes[2], t.ee[0].motion.nodes[2]];
            t.ee[0].motion.nodes.splice(3..3, [up, aside]);
            t.ee[0].motion.nodes[3][1] += 0.3;
        }),
        // Between two instants of TOWR's rows: the acceleration is continuous at every one of them.
        ("base accelerates more than its feet push", |t| t.base_lin.nodes[4][0] += 0.1),
        // A whole turn between two nodes.
        ("base turns too fast", |t| t.base_ang.nodes[5..].iter_mut().for_each(|node| node[2] += std::f64::consts::TAU)),
        ("goal below the terrain", |t| t.base_target[2] = -0.1),
        ("base below the terrain", |t| {
            for node in &mut t.base_lin.nodes[10..20] {
                node[2] = -0.01;
            }
        }),
    ];
    for (row, forge) in forge {
        for transcription in [None, Some("towr"), Some("contact-implicit"), Some("momentum")] {
            if row == "foot faster than possible" && [None, Some("towr")].contains(&transcription) {
                continue;
            }
            let mut trajectory = Trajectory { transcription: transcription.map(Into::into), ..step() };
            forge(&mut trajectory);
            let report = check(&trajectory);
            let worst: Vec<_> = report.families.iter().filter_map(|f| f.worst.as_ref().filter(|w| w.violation > 0.)).collect();
            assert!(!report.feasible && report.family(CheckFamily::Possible).violated > 0, "{row} in {transcription:?}\n{report}");
            if !["base below the terrain", "piece too short"].contains(&row) {
                assert!(worst.iter().any(|w| w.row == row), "{row} in {transcription:?}\n{report}");
            }
        }
    }
}

#[test]
fn labels_that_contradict_the_content_are_errors() {
    let labelled = |change: fn(&mut Trajectory)| {
        let mut trajectory = Trajectory { scenario: Some("s1".into()), ..momentum_step() };
        let [x, y] = Scenario::goal(10).unwrap();
        (trajectory.base_target, trajectory.target) = ([x, y, 0.5], Some(10));
        trajectory.robot = Some(NamedOr::Own(anymal()));
        trajectory.terrain = Some(NamedOr::Own(flat()));
        change(&mut trajectory);
        verify(&trajectory, &anymal(), &flat(), FORCE_LIMIT).map(|_| ()).map_err(|e| e.to_string())
    };
    fn robot(t: &mut Trajectory) -> &mut Robot {
        match &mut t.robot {
            Some(NamedOr::Own(robot)) => robot,
            _ => unreachable!("its own"),
        }
    }
    labelled(|_| {}).unwrap();
    // A robot with rounded numbers counts as the same.
    labelled(|t| robot(t).inertia[0][0] = 0.95).unwrap();
    // So does a robot with lower limits.
    labelled(|t| robot(t).force_limit = Some(300.)).unwrap();
    labelled(|t| robot(t).foot_radius = Some(0.06)).unwrap();
    let contradictions: [Forgery; 18] = [
        ("target 10", |t| t.base_target = [0., 0., 0.5]),
        ("one of its targets", |t| (t.base_target, t.target) = ([1., 0., 0.5], None)),
        ("target 11", |t| t.target = Some(11)),
        ("height", |t| t.base_target[2] = 0.6),
        ("yaw", |t| t.yaw_target = 1.),
        ("`s9`", |t| t.scenario = Some("s9".into())),
        ("above the origin", |t| t.init_base = Some(t.base_target)),
        ("radius of its feet", |t| robot(t).foot_radius = Some(0.)),
        ("force limit", |t| robot(t).force_limit = Some(2000.)),
        ("anymal", |t| robot(t).name = "mine".into()),
        ("mass", |t| robot(t).mass = 31.),
        ("reach", |t| robot(t).reach = [0.15, 0.2, 0.1].into()),
        ("reach", |t| robot(t).reach = Reach::boxes(vec![[[-0.15, 0.12], [-0.1, 0.1], [-0.1, 0.1]]; 4])),
        ("robot `anymal`", |t| t.robot = Some(NamedOr::Name("hyq".into()))),
        ("another shape", |t| t.terrain = Some(NamedOr::Own(Terrain { name: "flat".into(), ..Terrain::named("slope").unwrap() }))),
        ("terrain `flat`", |t| t.terrain = Some(NamedOr::Own(Terrain { friction: 2., ..flat() }))),
        ("limits.clearance", |t| t.limits = Some(MotionLimits { clearance: -1e300, ..LIMITS })),
        ("limits.foot_speed", |t| t.limits = Some(MotionLimits { foot_speed: 1e300, ..LIMITS })),
    ];
    for (part, change) in contradictions {
        let error = labelled(change).unwrap_err();
        assert!(error.contains(part), "{part}: {error}");
    }
    // A name may not move the cursor.
    for name in ["", "mine\nfeasible: 0 of 9 rows violated", "mine\u{1b}[8m", "mine\u{202e}"] {
        assert!(Robot { name: name.into(), ..anymal() }.validate().is_err(), "{name:?}");
        assert!(Terrain { name: name.into(), ..flat() }.validate().is_err(), "{name:?}");
    }
}
