//! The independent check of trajectories: it accepts what TOWR found, and counts planted faults where they belong.

use cregopt::certify::verify::{Family, Report, TOLERANCE, verify};
use cregopt::gait::{Curve, FootCurves, Trajectory};
use cregopt::robot::{ROBOTS, Robot};
use cregopt::scenario::Scenario;
use cregopt::task::DEFAULT_FORCE_LIMIT;
use cregopt::terrain::Terrain;

/// Pieces of the base, s. Three of them between two dynamics instants: the nodes 4 and 5 move without touching any instant.
const BASE_PIECE: f64 = 0.1 / 3.;

/// A curve that keeps a value.
fn constant(value: [f64; 3], durations: &[f64]) -> Curve {
    let [x, y, z] = value;
    Curve { poly_durations: durations.into(), nodes: vec![[x, y, z, 0., 0., 0.]; durations.len() + 1] }
}

/// A robot that stands still for 1 s with all forces straight up, m g / n each.
fn standing(robot: &Robot) -> Trajectory {
    let thirds = [0.3, 0.4, 0.3];
    let base = [0., 0., robot.base_height];
    let load = [0., 0., robot.weight() / robot.feet() as f64];
    let foot = |p: &[f64; 3]| FootCurves { motion: constant([p[0], p[1], 0.], &thirds), force: constant(load, &thirds) };
    Trajectory {
        scenario: None,
        target: None,
        robot: None,
        terrain: None,
        transcription: None,
        seed: None,
        version: None,
        init_base: None,
        base_target: base,
        yaw_target: 0.,
        force_limit: None,
        durations: vec![vec![1.]; robot.feet()],
        horizon: 1.,
        base_lin: constant(base, &[BASE_PIECE; 30]),
        base_ang: constant([0.; 3], &[BASE_PIECE; 30]),
        ee: robot.nominal_feet.iter().map(foot).collect(),
    }
}

/// ANYmal at rest lifts its left front foot (0) by 5 cm from 0.3 to 0.7 s and puts it back.
///
/// Diagonal pairs carry equal forces, so that there is no moment: 0 and 3 go from m g / 4 to 0 and stay there, 1 and 2 carry the rest.
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

/// Moves load between the diagonals at a force node, N a foot: no force or moment on the base changes.
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
    verify(trajectory, &anymal(), &flat(), DEFAULT_FORCE_LIMIT).unwrap()
}

#[test]
fn every_reference_solution_of_towr_breaks_no_row() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/reference/towr_solutions.jsonl");
    let Ok(text) = std::fs::read_to_string(path) else {
        eprintln!("skipped every_reference_solution_of_towr_breaks_no_row: cannot read {path}");
        return;
    };
    for (line, text) in text.lines().enumerate() {
        let trajectory = Trajectory::from_json(text).unwrap();
        let scenario = Scenario::named(trajectory.scenario.as_ref().unwrap()).unwrap();
        // The hexapod solutions were made with the inertia as it was published.
        let robot = Robot::named(if scenario.robot == "pexod" { "pexod-as-published" } else { scenario.robot }).unwrap();
        let terrain = Terrain::named(scenario.terrain).unwrap();
        let report = verify(&trajectory, &robot, &terrain, DEFAULT_FORCE_LIMIT).unwrap();
        println!("line {}, {}, T = {}\n{report}", line + 1, scenario.name, trajectory.horizon);
        assert!(report.feasible && report.n_violated == 0, "line {}\n{report}", line + 1);
        assert!(report.families.iter().all(|f| f.rows > 0 && f.worst.is_some()), "line {}\n{report}", line + 1);
    }
}

#[test]
fn a_standing_robot_breaks_no_row_and_has_no_defect() {
    for name in ROBOTS {
        let robot = Robot::named(name).unwrap();
        let report = verify(&standing(&robot), &robot, &flat(), DEFAULT_FORCE_LIMIT).unwrap();
        assert!(report.feasible && report.n_violated == 0 && report.max_violation < 1e-12, "{name}\n{report}");
        let dense = &report.dense;
        for extreme in [dense.force_defect, dense.moment_defect] {
            assert!(extreme.value < 1e-12, "{name}\n{report}");
        }
        for extreme in [dense.reach_excess, dense.pull, dense.friction_excess, dense.penetration, dense.foot_height, dense.foot_speed] {
            assert_eq!((extreme.value, extreme.foot), (0., None), "{name}\n{report}");
        }
        assert_eq!((dense.samples, dense.final_base_speed), (1002, 0.));
    }
}

#[test]
fn a_step_breaks_no_row_and_its_rows_are_those_of_towr() {
    let report = check(&step());
    assert!(report.feasible && report.max_violation < 1e-12, "{report}");
    let rows = |family| report.family(family).rows;
    assert_eq!(rows(Family::Dynamics), 6 * 11);
    assert_eq!(rows(Family::BaseAcceleration), 2 * 3 * 29);
    // t = 0, 0.08, ..., 0.96 and 1.
    assert_eq!(rows(Family::Reach), 14 * 4 * 3);
    assert_eq!(rows(Family::Terrain), 4 + 3 * 3);
    // Foot 0 has free nodes at 0, 0.1, 0.2 and 0.8, 0.9, 1; the others at all eight.
    assert_eq!(rows(Family::Force), 6 * (6 + 3 * 8));
    assert_eq!(rows(Family::Swing), 4);
    assert_eq!(rows(Family::Bounds), 6 + 6 + 3 + 3 + 4 * 3);
    // Two switches on two curves; standing nodes, mid node; swing force at both switches.
    assert_eq!(rows(Family::Structure), 2 * 2 + 6 * (4 + 3 * 4) + 1 + 6 * 2);
    assert_eq!(report.n_rows, Family::ALL.map(rows).iter().sum::<usize>());
    // Between the instants: the foot's apex, and its fastest in the middle of the way up, 1.5 x 0.05 m / 0.2 s.
    let (height, speed) = (report.dense.foot_height, report.dense.foot_speed);
    assert!((height.value - 0.05).abs() < 1e-12 && (height.time - 0.5).abs() < 1e-9 && height.foot == Some(0));
    assert!((speed.value - 0.375).abs() < 1e-9 && speed.foot == Some(0));
    assert!(report.dense.force_defect.value < 1e-12 && report.dense.reach_excess.value == 0.);
}

/// A fault whose size is the violation of its worst row.
struct Fault {
    name: &'static str,
    plant: fn(&mut Trajectory, f64),
    family: Family,
    /// Rows that it violates when it is just beyond the tolerance.
    rows: usize,
    row: &'static str,
    foot: Option<usize>,
    time: f64,
}

#[rustfmt::skip]
const FAULTS: [Fault; 19] = [
    Fault { name: "one foot pushes more", plant: |t, s| t.ee[1].force.nodes[1][2] += s,
        family: Family::Dynamics, rows: 1, row: "force z", foot: None, time: 0.1 },
    // Front feet push, hind feet pull: a moment about y of 4 x 0.34 m times the force.
    Fault { name: "the load is too far in front", plant: |t, s| for (foot, sign) in [1., 1., -1., -1.].iter().enumerate() { t.ee[foot].force.nodes[1][2] += sign * s / 1.36 },
        family: Family::Dynamics, rows: 1, row: "moment y", foot: None, time: 0.1 },
    // A slope s at the end of a piece of length L accelerates by 4 s / L there, and by -4 s / L at the start of the next.
    Fault { name: "base speed jumps", plant: |t, s| t.base_lin.nodes[4][4] += s * BASE_PIECE / 8.,
        family: Family::BaseAcceleration, rows: 1, row: "acceleration y", foot: None, time: 4. * BASE_PIECE },
    Fault { name: "base rate jumps", plant: |t, s| t.base_ang.nodes[4][5] += s * BASE_PIECE / 8.,
        family: Family::BaseAcceleration, rows: 1, row: "angular acceleration yaw", foot: None, time: 4. * BASE_PIECE },
    // Box top at 0.5 - 0.42 + 0.1 = 0.18 m; at 0.48 s, 0.9 of the way up, the foot is at 0.972 of the apex.
    Fault { name: "the foot leaves its box", plant: |t, s| t.ee[0].motion.nodes[2][2] = (0.18 + s) / 0.972,
        family: Family::Reach, rows: 1, row: "z", foot: Some(0), time: 0.48 },
    Fault { name: "a lifted stance foot", plant: |t, s| { t.ee[0].motion.nodes[3][2] += s; t.ee[0].motion.nodes[4][2] += s },
        family: Family::Terrain, rows: 2, row: "stance z", foot: Some(0), time: 0.7 },
    Fault { name: "a buried mid node", plant: |t, s| t.ee[0].motion.nodes[2][2] = -s,
        family: Family::Terrain, rows: 1, row: "swing z", foot: Some(0), time: 0.5 },
    // Two feet pull; none of the four sides of the pyramid holds then either.
    Fault { name: "a foot pulls", plant: |t, s| { let now = t.ee[0].force.nodes[1][2]; shift_load(t, 1, -now - s) },
        family: Family::Force, rows: 10, row: "normal force, pull", foot: Some(0), time: 0.1 },
    // The feet of a side pull apart: no moment, as they share y and z.
    Fault { name: "a foot slips", plant: |t, s| { let load = t.ee[0].force.nodes[1][2] + s; t.ee[0].force.nodes[1][0] += load; t.ee[2].force.nodes[1][0] -= load },
        family: Family::Force, rows: 2, row: "friction +t1", foot: Some(0), time: 0.1 },
    Fault { name: "a force at the first node", plant: |t, s| { let now = t.ee[0].force.nodes[0][2]; shift_load(t, 0, -now - s) },
        family: Family::Force, rows: 10, row: "normal force, pull", foot: Some(0), time: 0. },
    Fault { name: "a shifted mid node", plant: |t, s| t.ee[0].motion.nodes[2][0] += s,
        family: Family::Swing, rows: 1, row: "mid node x", foot: Some(0), time: 0.5 },
    Fault { name: "a mid node too fast", plant: |t, s| t.ee[0].motion.nodes[2][4] += s,
        family: Family::Swing, rows: 1, row: "mid node velocity y", foot: Some(0), time: 0.5 },
    Fault { name: "the goal is missed", plant: |t, s| t.base_target[1] += s,
        family: Family::Bounds, rows: 1, row: "final position y", foot: None, time: 1. },
    Fault { name: "the final yaw is missed", plant: |t, s| t.yaw_target -= s,
        family: Family::Bounds, rows: 1, row: "final angle yaw", foot: None, time: 1. },
    Fault { name: "a sliding stance foot", plant: |t, s| t.ee[0].motion.nodes[4][0] += s,
        family: Family::Structure, rows: 1, row: "standing foot moved, x", foot: Some(0), time: 1. },
    Fault { name: "a foot that touches down with speed", plant: |t, s| t.ee[0].motion.nodes[3][3] += s,
        family: Family::Structure, rows: 1, row: "velocity of standing foot, x", foot: Some(0), time: 0.7 },
    Fault { name: "a mid node that rises", plant: |t, s| t.ee[0].motion.nodes[2][5] += s,
        family: Family::Structure, rows: 1, row: "mid node velocity z", foot: Some(0), time: 0.5 },
    Fault { name: "a force at lift-off", plant: |t, s| shift_load(t, 3, s),
        family: Family::Structure, rows: 1, row: "force in swing, z", foot: Some(0), time: 0.3 },
    Fault { name: "a force slope at touch-down", plant: |t, s| for (foot, sign) in [1., -1., -1., 1.].iter().enumerate() { t.ee[foot].force.nodes[4][5] += sign * s },
        family: Family::Structure, rows: 1, row: "force slope in swing, z", foot: Some(0), time: 0.7 },
];

#[test]
fn planted_faults_are_counted_in_their_family_and_beyond_the_tolerance_only() {
    for fault in &FAULTS {
        for size in [0.99 * TOLERANCE, 1.01 * TOLERANCE, 1e-3] {
            let mut trajectory = step();
            (fault.plant)(&mut trajectory, size);
            let report = check(&trajectory);
            let context = format!("{} by {size}\n{report}", fault.name);
            let counted = report.family(fault.family);
            assert_eq!(counted.violated, report.n_violated, "in another family: {context}");
            assert_eq!(report.feasible, size < TOLERANCE, "{context}");
            if size == 1.01 * TOLERANCE {
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
fn acceleration_may_jump_in_another_transcription() {
    let mut trajectory = step();
    trajectory.base_lin.nodes[4][4] += 0.01;
    for (transcription, feasible) in [(None, false), (Some("towr"), false), (Some("momentum"), true)] {
        trajectory.transcription = transcription.map(Into::into);
        let report = check(&trajectory);
        assert_eq!(report.feasible, feasible, "{report}");
        assert_eq!(report.family(Family::BaseAcceleration).rows > 0, transcription != Some("momentum"));
        // Not at an instant, but seen: 4 x 0.01 m/s in a thirtieth of 0.1 s.
        let defect = report.dense.force_defect;
        let peak = 4. * 0.01 / BASE_PIECE / cregopt::robot::GRAVITY;
        assert!(defect.value < peak && defect.value > 0.9 * peak && (defect.time - 4. * BASE_PIECE).abs() < 1e-3, "{report}");
    }
}

#[test]
fn normal_forces_are_counted_against_the_given_limit() {
    let half = anymal().weight() / 2.;
    let with_limit = |limit| verify(&step(), &anymal(), &flat(), limit).unwrap();
    assert!(with_limit(half - 0.99 * TOLERANCE).feasible);
    let report = with_limit(half - 1.01 * TOLERANCE);
    // Feet 1 and 2 carry half the weight at the nodes 3 to 7.
    assert_eq!((report.n_violated, report.family(Family::Force).violated), (10, 10), "{report}");
    let worst = report.family(Family::Force).worst.as_ref().unwrap();
    assert_eq!((worst.row.as_str(), worst.foot), ("normal force, limit", Some(1)));
    assert!(with_limit(f64::NAN).family(Family::Force).violated > 0);
}

/// ANYmal standing around x = 1.5 m, with one force on each foot.
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
    // A vertical force on a slope of 0.7 has 0.7 times as much force along the slope as across.
    let load = anymal().weight() / 4.;
    for (friction, violated) in [(0.701, 0), (0.699, 4 * 4)] {
        let terrain = Terrain { friction, ..Terrain::named("slope").unwrap() };
        let report = verify(&standing_on(&terrain, [0., 0., load]), &anymal(), &terrain, DEFAULT_FORCE_LIMIT).unwrap();
        assert_eq!(report.family(Family::Force).violated, violated, "{report}");
        assert_eq!(report.family(Family::Terrain).violated, 0, "{report}");
        // Over the length of (1, 0, 0.7).
        let excess = (0.7 - friction).max(0.) / 4. / 1.49_f64.sqrt();
        assert!((report.dense.friction_excess.value - excess).abs() < 1e-12, "{report}");
    }
    // A force across the slope needs no friction and is all normal force; turned about the vertical it slips.
    for (name, across) in [("slope", [-70., 0., 100.]), ("chimney", [0., -300., 100.])] {
        let terrain = Terrain { friction: 1e-3, ..Terrain::named(name).unwrap() };
        let violated = |force, limit| {
            let report = verify(&standing_on(&terrain, force), &anymal(), &terrain, limit).unwrap();
            report.family(Family::Force).violated
        };
        let whole = across.iter().map(|f| f * f).sum::<f64>().sqrt();
        assert_eq!(violated(across, whole + 0.99 * TOLERANCE), 0, "{name}");
        assert_eq!(violated(across, whole - 1.01 * TOLERANCE), 4 * 4, "{name}");
        assert!(violated([-across[0], -across[1], across[2]], whole) > 0, "{name}");
    }
}

#[test]
fn what_happens_between_the_instants_is_reported_but_not_counted() {
    let mut trajectory = step();
    // A slope where the load is zero: next to the node one diagonal pulls, and the other carries more.
    for (foot, sign) in [-1., 1., 1., -1.].iter().enumerate() {
        trajectory.ee[foot].force.nodes[5][5] += sign * 2000.;
    }
    // The apex at 0.5 s is 1 mm out of reach; the nearest reach instants are 0.48 and 0.56 s.
    trajectory.ee[0].motion.nodes[2][2] = 0.181;
    let report = check(&trajectory);
    assert!(report.feasible, "{report}");
    // A piece of length d that is zero at both ends with a slope s at one has its extreme, 4/27 s d, a third of d from there.
    let expected = 4. / 27. * 2000. * 0.1 / anymal().weight();
    let (pull, reach) = (report.dense.pull, report.dense.reach_excess);
    assert!((pull.value - expected).abs() < 1e-3 * expected && [Some(0), Some(3)].contains(&pull.foot), "{report}");
    assert!((pull.time - (0.8 + 0.1 / 3.)).abs() < 1e-3, "{report}");
    assert!((reach.value - 0.001).abs() < 1e-12 && reach.foot == Some(0) && (reach.time - 0.5).abs() < 1e-9, "{report}");
    assert!(report.dense.force_defect.value < 1e-12, "{report}");
}

#[test]
fn one_rigged_phase_boundary_is_one_violated_row_a_curve() {
    let mut trajectory = step();
    trajectory.durations[0] = vec![0.31, 0.39, 0.3];
    let report = check(&trajectory);
    let structure = report.family(Family::Structure);
    assert_eq!((report.n_violated, structure.violated), (2, 2), "{report}");
    let worst = structure.worst.as_ref().unwrap();
    assert_eq!((worst.row.as_str(), worst.foot, worst.time), ("motion node at phase boundary", Some(0), 0.31));
    assert!((worst.violation - 0.01).abs() < 1e-12);
    // Below 1e-4, but no longer the same time.
    trajectory.durations[0] = vec![0.3 + 1e-5, 0.4 - 1e-5, 0.3];
    assert_eq!(check(&trajectory).family(Family::Structure).violated, 2);
    trajectory.durations[0] = vec![0.3 + 1e-7, 0.4 - 1e-7, 0.3];
    assert!(check(&trajectory).feasible);
}

#[test]
fn a_robot_with_another_number_of_feet_is_refused() {
    let error = verify(&step(), &Robot::named("biped").unwrap(), &flat(), DEFAULT_FORCE_LIMIT).unwrap_err().to_string();
    assert!(error.contains("4 feet") && error.contains("2 feet") && error.contains("biped"), "{error}");
}

#[test]
fn odd_but_well_formed_trajectories_get_a_verdict() {
    let spoil: [fn(&mut Trajectory); 6] = [
        // Curves without a node at any phase boundary.
        |t| t.ee[0].motion = constant([0.34, 0.19, 0.], &[1.]),
        |t| t.ee[0].force = constant([0., 0., 1.], &[1.]),
        // A stance without any node in it.
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
    // A malformed one is refused even when the caller did not check it.
    let mut trajectory = step();
    trajectory.ee[1].motion.nodes.pop();
    assert!(verify(&trajectory, &anymal(), &flat(), DEFAULT_FORCE_LIMIT).is_err());
}
