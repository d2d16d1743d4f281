//! Candidates, short and long ones, and a point of each.

use super::lab::POISON;
use crate::common::{
    Random, cones, cut, gait, hills, jointed, lopsided, mid_stride, point, problem_with, problem_with_cost, soled, spider, striding, task,
    task_for, towr, transcriptions,
};
use cregopt::gait::Schedule;
use cregopt::gait::trajectory::GoalVelocity;
use cregopt::nlp::Problem;
use cregopt::robot::Robot;
use cregopt::settings::{Transcription, TranscriptionSettings};
use cregopt::task::Task;
use cregopt::terrain::{Shape, Terrain};

/// A candidate, and a point at which it is evaluated.
pub struct Candidate {
    pub name: String,
    pub feet: usize,
    pub problem: Problem<f32>,
    pub x: Vec<f32>,
    pub first_height: u32,
}

impl Candidate {
    pub fn new(task: Task, schedule: Schedule, settings: &TranscriptionSettings, random: &mut Random) -> Candidate {
        let problem = problem_with_cost::<f32>(&task, &schedule, settings);
        let exact = problem_with::<f64>(&task, &schedule, settings);
        let x = point(&exact, random, EDGE_RADIUS).into_iter().map(|v| v as f32).collect();
        let first_height = grids().1.iter().find(|g| g.0 == task.terrain.name).map_or(0, |g| g.1);
        let name = format!("{} on {}, {}", task.robot.name, task.terrain.name, settings.rows.name());
        Candidate { name, feet: task.robot.feet(), problem, x, first_height }
    }
}

/// Edge rounding of the force rows, m.
pub const EDGE_RADIUS: f64 = 0.04;

/// Heights of all grids, after some values that belong to no grid, and the index at which each grid begins.
pub fn grids() -> (Vec<f32>, Vec<(String, u32)>) {
    let (mut heights, mut firsts) = (vec![POISON; 5], Vec::new());
    for terrain in [Terrain::named("step").unwrap(), hills()] {
        let Shape::Grid(grid) = &terrain.shape else { panic!() };
        firsts.push((terrain.name.clone(), heights.len() as u32));
        heights.extend(grid.heights.iter().flatten().map(|h| *h as f32));
    }
    (heights, firsts)
}

/// Short candidates: robots with one to eight feet on every terrain, with all kinds of rows, some turned by more than half a turn; a few
/// with friction cones.
pub fn candidates() -> Vec<Candidate> {
    let named = |name| Terrain::named(name).unwrap();
    let mut random = Random::new(11);
    let mut candidates = Vec::new();
    for settings in transcriptions() {
        let tasks = [
            task("monoped", "stairs", [2.2, 0.1], 0.3),
            task("biped", "chimney-lr", [2.2, 0.], -0.4),
            task("anymal", "step", [4.5, -0.2], 0.),
            task("pexod", "slope", [2.8, 0.2], 0.5),
            task_for(spider(8), named("gap"), [2.2, -0.1], 0.7),
            task_for(lopsided(spider(1)), hills(), [2.5, 1.], -1.),
            task("biped", "block", [2.2, 0.1], 3.1),
            task("anymal", "flat", [1., -0.3], std::f64::consts::PI),
            task_for(lopsided(spider(6)), hills(), [-3., 1.5], 6.2),
            task("monoped", "chimney", [2., 0.2], -3.1),
        ];
        for task in tasks {
            let feet = task.robot.feet();
            let schedule = gait(&mut random, feet, if feet > 4 { 1..=2 } else { 2..=3 });
            candidates.push(Candidate::new(task, schedule, &settings, &mut random));
        }
    }
    for task in
        [task("biped", "slope", [2.2, 0.1], 0.2), task("anymal", "step", [4.5, -0.2], 0.), task_for(spider(6), hills(), [-3., 1.5], 6.2)]
    {
        let schedule = gait(&mut random, task.robot.feet(), 1..=2);
        candidates.push(Candidate::new(task, schedule, &cones(), &mut random));
    }
    // Feet in the air at both ends; a swing of which little has passed rises, one of which much has passed only descends.
    let near = TranscriptionSettings { goal_velocity: GoalVelocity::Near, ..TranscriptionSettings::default() };
    for (task, since) in [
        (task("anymal", "flat", [0.4, 0.1], 0.2), 0.05),
        (task("biped", "slope", [0.3, 0.1], 0.2), 0.2),
        (task_for(spider(6), hills(), [0.3, 0.2], 6.2), 0.05),
        (task_for(lopsided(spider(5)), hills(), [-0.3, 0.2], 0.4), 0.2),
    ] {
        let (task, schedule) = mid_stride(&task, since);
        candidates.push(Candidate::new(task, schedule, &near, &mut random));
    }
    for task in [task("biped", "slope", [0.3, 0.1], 0.2), task_for(spider(6), hills(), [0.3, 0.2], 6.2)] {
        let (task, schedule) = striding(&task);
        candidates.push(Candidate::new(task, schedule, &cones(), &mut random));
    }
    let mut own = Random::new(13);
    for (robot, ground, settings) in
        [(Robot::named("biped").unwrap(), named("slope"), cones()), (lopsided(spider(3)), hills(), TranscriptionSettings::default())]
    {
        let task = task_for(soled(robot), ground, [2.2, 0.4], 0.9);
        let schedule = gait(&mut own, task.robot.feet(), 2..=3);
        candidates.push(Candidate::new(task, schedule, &settings, &mut own));
    }
    let jointed_task = task_for(jointed(lopsided(spider(5))), hills(), [-0.3, 0.2], 0.4);
    let (task, schedule) = mid_stride(&jointed_task, 0.05);
    candidates.push(Candidate::new(task, schedule, &near, &mut own));
    // Few stances: its sweep must fit in one dispatch.
    let task = task_for(cut(lopsided(spider(2))), hills(), [0.5, -0.3], 0.6);
    let schedule = gait(&mut own, 2, 1..=2);
    candidates.push(Candidate::new(task, schedule, &TranscriptionSettings::default(), &mut own));
    candidates
}

/// Candidates with more entries than a workgroup has invocations in every table.
pub fn long_candidates() -> Vec<Candidate> {
    // At no node of these draws is the tangential force so small that the cone's rows amplify rounding.
    let mut random = Random::new(16);
    let fine = |own: TranscriptionSettings| TranscriptionSettings { interval: Some(0.05), ..own };
    let candidate = |settings: TranscriptionSettings| {
        let robot = match settings {
            TranscriptionSettings { goal_velocity: GoalVelocity::Near, .. } => soled(spider(8)),
            TranscriptionSettings { rows: Transcription::Momentum, .. } => jointed(spider(8)),
            _ => spider(8),
        };
        let task = task_for(robot, hills(), [2., 1.], 0.4);
        Candidate::new(task, gait(&mut random, 8, 10..=10), &fine(settings), &mut random)
    };
    // Only one has joints; another one has a free end and soles, and only that has goal rows and rows of soles.
    let near = TranscriptionSettings { goal_velocity: GoalVelocity::Near, ..cones() };
    let mut candidates: Vec<Candidate> = [TranscriptionSettings::default(), towr(), near].map(candidate).into();
    // A stride has fewer periodic rows than a workgroup has invocations. Equal entries write equal values.
    let (task, schedule) = striding(&task_for(spider(8), hills(), [2., 1.], 0.4));
    let mut repeated = Candidate::new(task, schedule, &cones(), &mut random);
    repeated.problem.periodics = repeated.problem.periodics.repeat(3);
    candidates.push(repeated);
    candidates
}
