//! The certificate rejects every perturbation of a certified motion that matters in practice.

use crate::common::Random;
use cregopt::gait::trajectory::NamedOr;
use cregopt::gait::{Curve, Trajectory};
use cregopt::robot::{GRAVITY, Robot};
use cregopt::terrain::Terrain;
use cregopt::verify::verify;
use cregopt::{Cpu, Evaluate, Goal, Schedule, Task};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// A certified motion.
struct Certified {
    task: Task,
    trajectory: Trajectory,
    /// N.
    force_limit: f64,
}

/// A motion under perturbation, and the limit that it is verified against.
struct Perturbed<'a> {
    robot: &'a Robot,
    trajectory: Trajectory,
    force_limit: f64,
}

/// Robots and gaits that move 5 cm ahead.
fn gaits() -> Vec<(&'static str, Vec<Vec<f64>>)> {
    let tripods = [vec![0.2, 0.3, 0.5], vec![0.6, 0.3, 0.1]];
    vec![
        ("anymal", vec![vec![0.4, 0.3, 0.7], vec![0.9, 0.3, 0.2], vec![0.9, 0.3, 0.2], vec![0.4, 0.3, 0.7]]),
        ("hyq", vec![vec![0.3, 0.35, 0.75], vec![1.4], vec![0.8, 0.35, 0.25], vec![1.4]]),
        ("biped", vec![vec![0.4, 0.3, 0.9], vec![0.9, 0.3, 0.4]]),
        ("pexod", [0, 1, 1, 0, 0, 1].map(|tripod| tripods[tripod].clone()).into()),
    ]
}

/// Solves and certifies a gait.
fn certified(robot: &str, durations: Vec<Vec<f64>>, backend: &Cpu) -> Certified {
    let task = Task::new(Robot::named(robot).unwrap(), Terrain::flat(), Goal::at(0.05, 0.)).unwrap();
    let evaluate = Evaluate::new(&task);
    let solved = evaluate.run(&[Schedule::new(durations).unwrap()], backend).unwrap().remove(0).unwrap();
    let (trajectory, force_limit) = (evaluate.trajectory(&solved), evaluate.force_limit());
    let report = verify(&trajectory, &task.robot, &task.terrain, force_limit).unwrap();
    assert!(report.feasible, "{robot}\n{report}");
    Certified { task, trajectory, force_limit }
}

/// An index below `count`.
fn any(random: &mut Random, count: usize) -> usize {
    random.index(0..=count - 1)
}

fn sign(random: &mut Random) -> f64 {
    [1., -1.][any(random, 2)]
}

/// Adds to one component of a random node. `slope`: of its slope, not its value.
fn move_node(curve: &mut Curve, slope: bool, by: impl Fn(usize) -> f64, random: &mut Random) {
    let (node, axis) = (any(random, curve.nodes.len()), any(random, 3));
    curve.nodes[node][axis + if slope { 3 } else { 0 }] += sign(random) * by(axis);
}

/// Shortens a random piece of a curve by 90 % in favour of the next one, among the pieces along which a value changes by more than `least`.
/// Returns `false` if no piece does.
fn retime(curve: &mut Curve, least: f64, random: &mut Random) -> bool {
    let moves = |i: &usize| (0..3).any(|d| (curve.nodes[i + 1][d] - curve.nodes[*i][d]).abs() > least);
    let pieces: Vec<usize> = (0..curve.poly_durations.len() - 1).filter(moves).collect();
    if pieces.is_empty() {
        return false;
    }
    let piece = pieces[any(random, pieces.len())];
    let by = 0.9 * curve.poly_durations[piece].min(curve.poly_durations[piece + 1]);
    curve.poly_durations[piece] -= by;
    curve.poly_durations[piece + 1] += by;
    true
}

/// Moves the boundary between two phases of a foot whose curves stay.
fn move_phase_boundary(t: &mut Trajectory, random: &mut Random) -> bool {
    let lifted: Vec<usize> = (0..t.durations.len()).filter(|&foot| t.durations[foot].len() > 1).collect();
    let phases = &mut t.durations[lifted[any(random, lifted.len())]];
    let phase = any(random, phases.len() - 1);
    let by = sign(random) * 0.2 * phases[phase].min(phases[phase + 1]);
    phases[phase] += by;
    phases[phase + 1] -= by;
    true
}

/// A change of a motion. Returns `false` if the motion has nothing to change.
type Perturbation = fn(&mut Perturbed, &mut Random) -> bool;

/// Foot with random index.
fn foot(of: &Perturbed, random: &mut Random) -> usize {
    any(random, of.robot.feet())
}

/// Perturbations of the curves and of the phases, by amounts that matter.
const MOTIONS: &[(&str, Perturbation)] = &[
    ("base position by a tenth of a leg", |p, random| {
        let leg = p.robot.leg_height();
        move_node(&mut p.trajectory.base_lin, false, |_| 0.1 * leg, random);
        true
    }),
    ("base angle by a tenth of a turn, a turn, or a thousand", |p, random| {
        let turns = [0.1, 1., 1000.][any(random, 3)];
        move_node(&mut p.trajectory.base_ang, false, |_| turns * TAU, random);
        true
    }),
    ("base velocity by 0.3 of the Froude velocity", |p, random| {
        let velocity = 0.3 * (GRAVITY * p.robot.leg_height()).sqrt();
        move_node(&mut p.trajectory.base_lin, true, |_| velocity, random);
        true
    }),
    ("foot by half a leg and out of its box", |p, random| {
        let foot = foot(p, random);
        let (leg, widths) = (p.robot.leg_height(), p.robot.reach.of(foot).widths());
        move_node(&mut p.trajectory.ee[foot].motion, false, |axis| f64::max(0.5 * leg, 1.1 * widths[axis]), random);
        true
    }),
    ("force by half a weight", |p, random| {
        let (foot, weight) = (foot(p, random), p.robot.weight());
        move_node(&mut p.trajectory.ee[foot].force, false, |_| 0.5 * weight, random);
        true
    }),
    ("slope of a force by 50 weights per second", |p, random| {
        let (foot, weight) = (foot(p, random), p.robot.weight());
        move_node(&mut p.trajectory.ee[foot].force, true, |_| 50. * weight, random);
        true
    }),
    ("boundary of two phases", |p, random| move_phase_boundary(&mut p.trajectory, random)),
    ("times of the base position", |p, random| {
        let least = LEAST_MOVE * p.robot.leg_height();
        retime(&mut p.trajectory.base_lin, least, random)
    }),
    ("times of the base angles", |p, random| retime(&mut p.trajectory.base_ang, LEAST_TURN, random)),
    ("times of a foot's motion", |p, random| {
        let (foot, least) = (foot(p, random), LEAST_MOVE * p.robot.leg_height());
        retime(&mut p.trajectory.ee[foot].motion, least, random)
    }),
    ("times of a foot's force", |p, random| {
        let (foot, least) = (foot(p, random), LEAST_LOAD * p.robot.weight());
        retime(&mut p.trajectory.ee[foot].force, least, random)
    }),
];

/// Least change of a position along a piece that is timed again, leg heights.
const LEAST_MOVE: f64 = 0.01;
/// Least change of an angle, rad.
const LEAST_TURN: f64 = 0.01;
/// Least change of a force, weights.
const LEAST_LOAD: f64 = 0.01;

/// Labels and limits that the motion does not obey.
const LABELS: &[(&str, Perturbation)] = &[
    ("goal", |p, random| {
        let (axis, by) = (any(random, 3), sign(random) * 0.1 * p.robot.leg_height());
        p.trajectory.base_target[axis] += by;
        true
    }),
    ("goal yaw by a turn", |p, random| {
        p.trajectory.yaw_target += sign(random) * TAU;
        true
    }),
    ("transcription", |p, _| {
        p.trajectory.transcription = Some("another".into());
        true
    }),
    ("scenario", |p, _| {
        p.trajectory.scenario = Some("s1".into());
        true
    }),
    ("mass", |p, _| {
        p.trajectory.robot = Some(NamedOr::Own(Robot { mass: 1.1 * p.robot.mass, ..p.robot.clone() }));
        true
    }),
    ("start", |p, _| {
        p.trajectory.init_base = Some([0.1 * p.robot.leg_height(), 0., p.robot.base_height]);
        true
    }),
    ("force limit", |p, _| {
        p.force_limit = 0.2 * p.robot.weight() / p.robot.feet() as f64;
        true
    }),
    ("clearance", |p, _| {
        let limits = p.trajectory.limits.as_mut().unwrap();
        (limits.clearance, limits.swing_height) = (0.19, 0.2);
        true
    }),
    ("swing height", |p, _| {
        p.trajectory.limits.as_mut().unwrap().swing_height = 1e300;
        true
    }),
];

/// Perturbations of each kind and robot.
const ROUNDS: usize = 12;

#[test]
fn no_perturbation_of_a_certified_motion_is_missed() {
    let backend = Cpu::new(0).unwrap();
    let certified: Vec<Certified> = gaits().into_iter().map(|(robot, durations)| certified(robot, durations, &backend)).collect();
    let mut random = Random::new(42);
    let (mut tried, mut missed) = (BTreeMap::new(), Vec::new());
    for (what, perturb) in MOTIONS.iter().chain(LABELS) {
        for Certified { task, trajectory, force_limit } in certified.iter().cycle().take(ROUNDS * certified.len()) {
            let mut perturbed = Perturbed { robot: &task.robot, trajectory: trajectory.clone(), force_limit: *force_limit };
            if !perturb(&mut perturbed, &mut random) {
                continue;
            }
            *tried.entry(*what).or_insert(0) += 1;
            let report = verify(&perturbed.trajectory, &task.robot, &task.terrain, perturbed.force_limit);
            if report.is_ok_and(|report| report.feasible) {
                missed.push(format!("{}: {what}", task.robot.name));
            }
        }
    }
    println!("{tried:#?}");
    assert!(missed.is_empty(), "{} missed: {missed:#?}", missed.len());
    // Every kind did its work, on more than one motion.
    for (what, _) in MOTIONS.iter().chain(LABELS) {
        assert!(tried.get(what).is_some_and(|&times| times > ROUNDS), "{what}: {tried:?}");
    }
}
