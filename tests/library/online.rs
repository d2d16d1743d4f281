//! Motions that start and end anywhere: in mid-stride, with feet in the air, at any velocity.

use cregopt::gait::Schedule;
use cregopt::gait::cost::CostWeights;
use cregopt::gait::trajectory::GoalVelocity;
use cregopt::robot::Robot;
use cregopt::search::evaluate::{Evaluated, LowerSettings};
use cregopt::task::{BaseState, SwingState, Task};
use cregopt::terrain::Terrain;
use cregopt::{Cpu, Evaluate, Trajectory, verify};

/// A trotting ANYmal: the base moves at 0.5 m/s, and feet 1 and 2 have swung for `since` of 0.25 s.
fn trotting(since: f64) -> Task {
    let robot = Robot::named("anymal").unwrap();
    let state = |x: f64| BaseState { velocity: [0.5, 0., 0.], ..BaseState::level([x, 0., 0.5], 0.) };
    let task = Task::of_states(robot, Terrain::named("flat").unwrap(), state(0.), None, state(0.4)).unwrap();
    let swings = (0..4).map(|foot| {
        let [x, y] = task.start_feet[foot];
        let height = if since < 0.125 { 0.05 } else { 0.06 };
        (foot == 1 || foot == 2).then_some(SwingState { position: [x - 0.02, y, height], velocity: [1., 0., 0.], since })
    });
    task.with_swings(swings.collect()).unwrap()
}

/// Feet 1 and 2 land after 0.15 s, stand for 0.3 s, and swing beyond the end at 0.8 s; the others swing from 0.2 to 0.45 s.
fn trot() -> Schedule {
    let (in_air, standing) = (vec![0., 0.15, 0.4, 0.3, -0.05], vec![0.2, 0.25, 0.35]);
    Schedule::new(vec![standing.clone(), in_air.clone(), in_air, standing]).unwrap()
}

fn settings(iterations: usize) -> LowerSettings {
    let mut settings = LowerSettings::default();
    settings.transcription.goal_velocity = GoalVelocity::Near;
    settings.solver.optimise.iterations = iterations;
    settings
}

fn solved(task: &Task, schedule: &Schedule, iterations: usize) -> (Evaluated, Trajectory) {
    let evaluate = Evaluate::new(task).settings(settings(iterations)).cost(CostWeights::default());
    let found = evaluate.run(std::slice::from_ref(schedule), &Cpu::new(1).unwrap()).unwrap().remove(0).unwrap();
    let motion = evaluate.trajectory(&found);
    (found, motion)
}

#[test]
fn a_motion_starts_and_ends_with_feet_in_the_air() {
    for since in [0.1, 0.15] {
        let task = trotting(since);
        let (found, motion) = solved(&task, &trot(), 12);
        let report = verify(&motion, &task.robot, &task.terrain, motion.force_limit.unwrap()).unwrap();
        assert!(found.feasible && report.rows.feasible, "{since}: {report:#?}");
        // The foot continues from its state, and is in the air at the end.
        let feet = &motion.ee[1].motion;
        let state = task.start_swings[1].unwrap();
        assert_eq!((feet.nodes[0][..3].to_vec(), feet.nodes[0][3..].to_vec()), (state.position.to_vec(), state.velocity.to_vec()));
        let end = motion.end_swings();
        assert!(end[1].is_some_and(|s| s.position[2] > 0.001 && (s.since - 0.25).abs() < 1e-9), "{end:?}");
        assert!(end[0].is_none());
        // The cost draws the base to the goal.
        let goal = motion.end_state();
        println!("{since}: {:?} {:?} cost {:?}", goal, found.outcome, found.cost.map(|c| c.total));
        assert!((goal.position[0] - 0.4).abs() < 0.03 && (goal.velocity[0] - 0.5).abs() < 0.15, "{goal:?}");
    }
}
