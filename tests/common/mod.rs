//! Helpers of the test binaries: seeded gaits and points, reference data, and rows as dense matrices.
#![allow(dead_code, reason = "each test binary uses a part of this")]

use cregopt::gait::Schedule;
use cregopt::gait::cost::CostWeights;
use cregopt::nlp::Problem;
use cregopt::nlp::transcription::{interval, towr::FORCE_LIMIT};
use cregopt::real::Real;
use cregopt::robot::leg::{Leg, LegJoint};
use cregopt::robot::{FootReach, Reach, Robot, Slab, Sole};
use cregopt::rows::table::NONE;
use cregopt::rows::{Family, RowKind, Shared};
use cregopt::scenario::Scenario;
use cregopt::settings::{Friction, Transcription, TranscriptionSettings};
use cregopt::task::{BaseState, Goal, PeriodicStride, SwingState, Task};
use cregopt::terrain::{Grid, Ground, Shape, Terrain};
use cregopt::{Trajectory, verify};
use nalgebra::DMatrix;
use std::ops::RangeInclusive;
use std::path::Path;
use std::sync::Arc;

/// Seeded random numbers (SplitMix64).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Random {
        Random(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn index(&mut self, range: RangeInclusive<usize>) -> usize {
        range.start() + (self.next() % (range.end() - range.start() + 1) as u64) as usize
    }

    fn normal(&mut self) -> f64 {
        // Box-Muller; 1 - u is never 0.
        let radius = (-2. * (1. - self.between(0., 1.)).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.between(0., 1.)).cos()
    }
}

/// Random gait with the distribution of the reference: log durations N(-1.75, 1), clamped to [-2.5, -1].
pub fn gait(random: &mut Random, feet: usize, stances: RangeInclusive<usize>) -> Schedule {
    let mut foot = || {
        let phases = 2 * random.index(stances.clone()) - 1;
        (0..phases).map(|_| (random.normal() - 1.75).clamp(-2.5, -1.).exp()).collect()
    };
    Schedule::new((0..feet).map(|_| foot()).collect()).unwrap()
}

/// Task for a built-in robot on a built-in terrain.
pub fn task(robot: &str, terrain: &str, goal: [f64; 2], yaw: f64) -> Task {
    task_for(Robot::named(robot).unwrap(), Terrain::named(terrain).unwrap(), goal, yaw)
}

/// Task whose goal is at the robot's base height above the terrain.
pub fn task_for(robot: Robot, terrain: Terrain, [x, y]: [f64; 2], yaw: f64) -> Task {
    Task::new(robot, terrain, Goal::at(x, y).yaw(yaw)).unwrap()
}

/// Task in mid-stride, and its schedule over 0.8 s: every other foot is in the air at both ends, the rest step between.
///
/// * `since` - time since the lift-off of the feet in the air, whose swing lasts 0.25 s; they rise if it is below 0.08 s
pub fn mid_stride(task: &Task, since: f64) -> (Task, Schedule) {
    let swing = |foot: usize| {
        let [x, y] = task.start_feet[foot];
        let position = [x - 0.02, y + 0.01, task.terrain.height(x - 0.02, y + 0.01) + 0.05];
        SwingState { position, velocity: [0.6, 0.1, if since < 0.08 { 0.2 } else { -0.1 }], since }
    };
    let feet = 0..task.robot.feet();
    let swings = feet.clone().map(|foot| (foot % 2 == 1).then(|| swing(foot)));
    let phases = |foot: usize| match foot % 2 {
        0 => vec![0.2, 0.25, 0.35],
        _ => vec![0., 0.25 - since, 0.45 + since, 0.3, -0.2],
    };
    (task.with_swings(swings.collect()).unwrap(), Schedule::new(feet.map(phases).collect()).unwrap())
}

/// Task with a periodic stride of 0.6 s, and its schedule: every other foot swings where the stride begins and ends, the rest stand
/// there. Intervals between knots last 0.1 s.
pub fn striding(task: &Task) -> (Task, Schedule) {
    let phases = |foot: usize| match foot % 2 {
        0 => vec![0.4, 0.25, 0.35, 0.25, 0.35, 0.25, 0.35],
        _ => vec![0.2, 0.25, 0.35, 0.25, 0.35, 0.25, 0.55],
    };
    let stride = PeriodicStride { start: 3, intervals: 6, displacement: [0.1, 0.05, 0.02], costs_alone: true };
    (Task { stride: Some(stride), ..task.clone() }, Schedule::new((0..task.robot.feet()).map(phases).collect()).unwrap())
}

/// A trotting ANYmal: the base moves at 0.5 m/s, and feet 1 and 2 have swung for `since` of 0.25 s.
pub fn trotting(since: f64) -> Task {
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
pub fn trot() -> Schedule {
    let (in_air, standing) = (vec![0., 0.15, 0.4, 0.3, -0.05], vec![0.2, 0.25, 0.35]);
    Schedule::new(vec![standing.clone(), in_air.clone(), in_air, standing]).unwrap()
}

/// Made-up robot with `feet` feet on an ellipse and a full inertia tensor.
pub fn spider(feet: usize) -> Robot {
    let nominal_feet = (0..feet).map(|foot| {
        let angle = std::f64::consts::TAU * (foot as f64 + 0.3) / feet as f64;
        [0.4 * angle.cos(), 0.3 * angle.sin(), -0.3 - 0.01 * foot as f64]
    });
    let robot = Robot {
        name: format!("spider with {feet} feet"),
        mass: 12.,
        inertia: [[0.31, 0.02, -0.03], [0.02, 0.42, 0.01], [-0.03, 0.01, 0.55]],
        base_height: 0.33,
        nominal_feet: nominal_feet.collect(),
        reach: [0.2, 0.15, 0.12].into(),
        force_limit: None,
        leg_mass: None,
        joints: None,
        foot_radius: None,
        sole: None,
    };
    robot.validate().unwrap();
    robot
}

/// Rows that the certificate counts as violated, one line per family, or the error.
pub fn faults(motion: &Trajectory, task: &Task) -> String {
    match verify(motion, &task.robot, &task.terrain, motion.force_limit.unwrap()) {
        Err(error) => error.to_string(),
        Ok(report) if report.feasible => String::new(),
        Ok(report) => {
            let worst = report.families.iter().filter(|f| f.violated > 0).filter_map(|f| f.worst.as_ref());
            worst.map(|w| format!("{} of {:?} at {:.3}\n", w.row, w.foot, w.time)).collect()
        }
    }
}

/// A forgery, and a part of the message that refuses it.
pub type Forgery = (&'static str, fn(&mut Trajectory), &'static str);

/// Made-up humanoid of 35 kg.
pub fn humanoid() -> Robot {
    let side = |left: bool| [[-0.3, 0.3], if left { [-0.04, 0.15] } else { [-0.15, 0.04] }, [-0.06, 0.12]];
    let robot = Robot {
        name: "made-up humanoid".into(),
        mass: 35.,
        inertia: [[3., 0., 0.1], [0., 2.8, 0.], [0.1, 0., 0.45]],
        base_height: 0.68,
        nominal_feet: vec![[0., 0.12, -0.68], [0., -0.12, -0.68]],
        reach: Reach::boxes(vec![side(true), side(false)]),
        leg_mass: Some(3.),
        ..soled(Robot::named("biped").unwrap())
    };
    robot.validate().unwrap();
    robot
}

/// Robot with a sole on every foot.
pub fn soled(robot: Robot) -> Robot {
    let sole = Some(Sole { length: 0.2, width: 0.08, turn: 0.5 });
    Robot { name: format!("{} with soles", robot.name), sole, foot_radius: None, ..robot }
}

/// Robot whose legs have three joints, and limits of them that a random motion exceeds at some times: a hip that rolls and a knee. The legs
/// are twice as long as needed, so that they reach the feet of random points and are never nearly stretched.
pub fn jointed(robot: Robot) -> Robot {
    let leg = |[x, y, z]: [f64; 3]| {
        let (link, side) = (2. * z.abs(), 0.05 * y.signum());
        let bend = (z.abs() / (2. * link)).acos();
        let joint = |name: &str, axis: nalgebra::Unit<nalgebra::Vector3<f64>>, at: [f64; 3], nominal: f64| LegJoint {
            name: name.into(),
            turns: true,
            origin: nalgebra::Isometry3::translation(at[0], at[1], at[2]),
            axis,
            limits: [-3., 3.],
            velocity: Some(6.),
            effort: Some(0.05 * robot.weight()),
            nominal,
        };
        let pitch = nalgebra::Vector3::y_axis();
        let chain = vec![
            joint("roll", nalgebra::Vector3::x_axis(), [x, y - side, 0.], 0.),
            joint("pitch", pitch, [0., side, 0.], bend),
            joint("knee", pitch, [0., 0., -link], -2. * bend),
        ];
        Leg { foot: "foot".into(), tip: [0., 0., -link], radius: 0.02, sole: None, chain }
    };
    let joints = Some(robot.nominal_feet.iter().map(|foot| leg(*foot)).collect());
    Robot { name: format!("{} with joints", robot.name), joints, ..robot }
}

/// Robot whose feet reach less far back, inward and down; each pair of feet reaches less than the previous one.
pub fn lopsided(robot: Robot) -> Robot {
    let sides = |foot: usize| {
        let ([x, y, z], less) = (robot.reach.of(foot).half_widths(), 0.01 * (foot / 2 + 1) as f64);
        [[less - x, x], if robot.nominal_feet[foot][1] > 0. { [less - y, y] } else { [-y, y - less] }, [less - z, z]]
    };
    Robot { reach: Reach::boxes((0..robot.feet()).map(sides)), ..robot }
}

/// Robot whose reach is cut by slabs: by two at even feet, by four at odd ones.
pub fn cut(robot: Robot) -> Robot {
    let diagonals = |foot: usize| {
        let normals = [[0.6, 0., -0.8], [0.48, 0.64, 0.6], [-0.28, 0.96, 0.], [0., 0.8, 0.6]];
        let slab = |(i, normal): (usize, [f64; 3])| Slab { normal, sides: [-0.05 - 0.01 * i as f64, 0.06 + 0.01 * foot as f64] };
        normals.into_iter().take(if foot.is_multiple_of(2) { 2 } else { 4 }).enumerate().map(slab).collect()
    };
    let reach = |foot: usize| FootReach { diagonals: diagonals(foot), ..robot.reach.foot(foot).into_owned() };
    let robot =
        Robot { name: format!("{} with diagonals", robot.name), reach: Reach::PerFoot((0..robot.feet()).map(reach).collect()), ..robot };
    robot.validate().unwrap();
    robot
}

/// Terrain of grid cells of 0.7 m by 0.5 m. Heights differ along both axes, so that every cell is twisted.
pub fn hills() -> Terrain {
    let height = |i: usize, j: usize| 0.05 * ((3 * i + 5 * j + i * j) % 7) as f64;
    let heights = (0..20).map(|i| (0..16).map(|j| height(i, j)).collect()).collect();
    let terrain = Terrain { name: "hills".into(), friction: 0.8, shape: Shape::Grid(Grid { low: [-7., -4.], high: [7., 4.], heights }) };
    terrain.validate().unwrap();
    terrain
}

/// Plane that rises by 0.2 along x and falls by 0.1 along y.
pub fn tilted() -> Terrain {
    let height = |x: f64, y: f64| 0.2 * x - 0.1 * y;
    let heights = [-7., 7.].map(|x| [-4., 4.].map(|y| height(x, y)).to_vec()).to_vec();
    let terrain = Terrain { name: "tilted".into(), friction: 0.8, shape: Shape::Grid(Grid { low: [-7., -4.], high: [7., 4.], heights }) };
    terrain.validate().unwrap();
    terrain
}

/// Settings of the `momentum` transcription without limits on the legs, which random gaits would exceed.
pub fn momentum() -> TranscriptionSettings {
    TranscriptionSettings::paper(Transcription::Momentum)
}

/// Settings of the `towr` transcription with TOWR's own interval.
pub fn towr() -> TranscriptionSettings {
    TranscriptionSettings::paper(Transcription::Towr)
}

/// Settings of both transcriptions without limits on the legs.
pub fn free_legs() -> [TranscriptionSettings; 2] {
    [momentum(), towr()]
}

/// Settings of all kinds: limited legs (the default, with every family of `momentum` rows), then both transcriptions without limits on the
/// legs.
pub fn transcriptions() -> [TranscriptionSettings; 3] {
    [TranscriptionSettings::default(), momentum(), towr()]
}

/// Default settings with friction cones.
pub fn cones() -> TranscriptionSettings {
    TranscriptionSettings { friction: Some(Friction::Cone), ..TranscriptionSettings::default() }
}

/// Settings that have rows of every family: both transcriptions, legs with limits, pyramids and friction cones.
pub fn families() -> [TranscriptionSettings; 4] {
    let pyramids = |settings| TranscriptionSettings { friction: Some(Friction::Pyramid), ..settings };
    let [limited, free, towr] = transcriptions().map(pyramids);
    [limited, free, towr, cones()]
}

/// Problem of a schedule that is not aligned yet, in `momentum` without limits on the legs.
pub fn problem<T: Real>(task: &Task, schedule: &Schedule) -> Problem<T> {
    problem_with(task, schedule, &momentum())
}

/// Problem of a schedule that is not aligned yet.
pub fn problem_with<T: Real>(task: &Task, schedule: &Schedule, settings: &TranscriptionSettings) -> Problem<T> {
    Problem::new(task, &schedule.aligned(interval(settings, &task.robot)), settings)
}

/// Problem of a schedule that is not aligned yet, with the rows of the default cost where the transcription has them.
pub fn problem_with_cost<T: Real>(task: &Task, schedule: &Schedule, settings: &TranscriptionSettings) -> Problem<T> {
    Problem::with_cost(task, &schedule.aligned(interval(settings, &task.robot)), settings, Some(&CostWeights::default()))
}

/// Distance between random points and terrain edges, m. Larger than a central difference or f32 rounding moves a point.
const CLEARANCE: f64 = 1e-4;

/// True if the ground around a point is smooth: its slope changes as its curvature predicts.
fn smooth(terrain: &Terrain, x: f64, y: f64) -> bool {
    let here = terrain.ground(x, y);
    let [[xx, xy], [_, yy]] = here.curvature;
    [[-1., 0.], [1., 0.], [0., -1.], [0., 1.]].iter().all(|[u, v]| {
        let (dx, dy) = (u * CLEARANCE, v * CLEARANCE);
        let there = terrain.ground(x + dx, y + dy);
        let jump = [there.slope[0] - here.slope[0] - xx * dx - xy * dy, there.slope[1] - here.slope[1] - xy * dx - yy * dy];
        jump.iter().all(|jump| jump.abs() < 1e-9)
    })
}

/// Random point near the initial guess. Footholds, the points `edge_radius` around them, and the points of swings that have rows are clear
/// of terrain edges. Forces are near the weight per foot.
pub fn point(problem: &Problem<f64>, random: &mut Random, edge_radius: f64) -> Vec<f64> {
    let mut x = problem.initial.clone();
    let free = |at: usize| at < problem.variables;
    for block in problem.curves.base.iter().map(|&b| b as usize).filter(|&b| free(b)) {
        for d in 0..6 {
            x[block + d] += if d < 3 { random.between(-0.1, 0.1) } else { random.between(-0.4, 0.4) };
        }
    }
    let clear = |[x, y]: [f64; 2], radius: f64| {
        let around = [[0., 0.], [-radius, 0.], [radius, 0.], [0., -radius], [0., radius]];
        around.iter().all(|[dx, dy]| smooth(&problem.terrain, x + dx, y + dy))
    };
    let mut number = 0;
    for foot in &problem.curves.feet {
        for &node in foot.force_nodes.iter().flatten().filter(|&&n| n != NONE) {
            for d in 0..6 {
                x[node as usize + d] = if d == 2 { 1. } else { 0. } + random.between(-0.6, 0.6);
            }
        }
        for &node in foot.moment_nodes.iter().flatten().filter(|&&n| n != NONE) {
            (0..6).for_each(|d| x[node as usize + d] = random.between(-0.6, 0.6));
        }
        for at in foot.yaws.iter().map(|&at| at as usize).filter(|&at| free(at)) {
            x[at] += random.between(-0.4, 0.4);
        }
        for &height in &foot.heights {
            x[height as usize] += random.between(-0.1, 0.1);
        }
        let mut previous: Option<[f64; 2]> = None;
        for at in foot.footholds.iter().map(|&f| f as usize) {
            let guess = [x[at], x[at + 1]];
            let mut foothold = guess;
            while free(at) {
                foothold = guess.map(|v| v + random.between(-0.15, 0.15));
                // Points of the swing that ends at this foothold at which rows limit the height.
                let swings = problem.swing_nodes.iter().filter(|s| s.foothold[1] == number);
                let on_the_way = |p: [f64; 2], [a, b]: [f64; 2], offset: [f64; 3]| [0, 1].map(|d| offset[d] + a * p[d] + b * foothold[d]);
                let mut passes = swings.filter_map(|s| previous.map(|p| on_the_way(p, s.xy_weights, s.offset)));
                if clear(foothold, edge_radius) && passes.all(|p| clear(p, 0.)) {
                    break;
                }
            }
            x[at..at + 2].copy_from_slice(&foothold);
            previous = Some(foothold);
            number += 1;
        }
    }
    x
}

/// Gives each element a number of rows from 1 to 13 in turn. The new rows and Jacobian values come after the existing ones. Elements that
/// the factorisation handles by family (reach, linear momentum) do not change.
pub fn with_any_rows<T: Real>(problem: &mut Problem<T>) {
    let any = problem.elements.iter_mut().filter(|e| e.family != Family::LinearMomentum);
    for (element, rows) in any.zip((1..=13).cycle()) {
        element.rows = rows;
        element.place.row = problem.rows.all() as u32;
        element.place.jacobian = problem.jacobian_len as u32;
        problem.rows.inequalities += rows;
        problem.jacobian_len += (rows * element.place.stride) as usize;
    }
}

/// Jacobian values of such a problem at a point: the true values for existing rows, random ones for new rows, of which a third are zero.
pub fn any_jacobian<T: Real>(problem: &Problem<T>, x: &[T], random: &mut Random) -> Vec<T> {
    let mut values = rows(problem, x, 0.).jacobian;
    for element in problem.elements.iter().filter(|e| e.family != Family::LinearMomentum) {
        let place = &element.place;
        for run in &problem.runs[element.runs.range()] {
            for (r, i) in (0..element.rows).flat_map(|r| (0..run.len).map(move |i| (r, i))) {
                let value = random.between(-2., 2.);
                let at = (place.jacobian + r * place.stride + run.column + i) as usize;
                values[at] = if value.abs() < 0.7 { T::zero() } else { T::of(value) };
            }
        }
    }
    values
}

/// Residuals and Jacobian values at a point.
pub struct Rows<T> {
    pub c: Vec<T>,
    pub g: Vec<T>,
    pub jacobian: Vec<T>,
}

/// Evaluates the rows at a point.
pub fn rows<T: Real>(problem: &Problem<T>, x: &[T], edge_radius: f64) -> Rows<T> {
    rows_with(problem, x, edge_radius, &mut shared(problem))
}

/// Evaluates the rows. Residuals are filled with NaN before, so that a residual that is not written is noticed.
pub fn rows_with<T: Real>(problem: &Problem<T>, x: &[T], edge_radius: f64, shared: &mut Shared<T>) -> Rows<T> {
    let mut rows = Rows {
        c: vec![T::nan(); problem.rows.one_sided()],
        g: vec![T::nan(); problem.inequalities],
        jacobian: vec![T::zero(); problem.jacobian_len],
    };
    cregopt::rows::residuals(problem, x, T::of(edge_radius), shared, &mut rows.c, &mut rows.g, Some(&mut rows.jacobian));
    rows
}

/// Shared quantities of the rows at a point, with the deviations of the base from its cubics frozen there.
pub fn frozen_at<T: Real>(problem: &Problem<T>, x: &[T], edge_radius: f64) -> Shared<T> {
    let mut shared = shared(problem);
    rows_with(problem, x, edge_radius, &mut shared);
    shared.frozen = true;
    shared
}

/// Shared quantities of the rows when the base follows its cubics.
pub fn straight<T: Real>(problem: &Problem<T>) -> Shared<T> {
    Shared { frozen: true, ..shared(problem) }
}

/// Shared quantities of the rows, not evaluated yet.
pub fn shared<T: Real>(problem: &Problem<T>) -> Shared<T> {
    let mut shared = Shared::default();
    shared.resize(problem);
    shared.ground.fill(Ground::level(T::nan()));
    shared
}

/// Dense Jacobian, `[rows][variables]`, from the tables of the problem.
pub fn dense_jacobian<T: Real>(problem: &Problem<T>, values: &[T]) -> DMatrix<f64> {
    let mut dense = DMatrix::zeros(problem.rows.all(), problem.variables);
    for (element, runs) in problem.all_elements().zip(problem.columns()) {
        let place = &element.place;
        for r in 0..element.rows as usize {
            for (run, weight) in &runs {
                for i in 0..run.len as usize {
                    let value = values[place.jacobian as usize + r * place.stride as usize + run.column as usize + i];
                    dense[(place.row as usize + r, run.variable as usize + i)] += weight.as_f64() * value.as_f64();
                }
            }
        }
    }
    dense
}

/// Dense Jacobian of all inequalities, both sides, `[inequalities][variables]`.
pub fn dense_inequalities<T: Real>(problem: &Problem<T>, values: &[T]) -> DMatrix<f64> {
    let by_row = dense_jacobian(problem, values);
    let mut dense = DMatrix::zeros(problem.inequalities, problem.variables);
    for element in problem.all_elements().filter(|e| e.kind() == RowKind::Inequality) {
        let (row, at) = (element.place.row as usize, element.place.inequality as usize);
        for r in 0..element.rows as usize {
            dense.set_row(at + r, &by_row.row(row + r));
            if r < element.pairs as usize {
                dense.set_row(at + element.rows as usize + r, &-by_row.row(row + r));
            }
        }
    }
    dense
}

/// One residual per Jacobian row: equalities, and the upper sides of inequalities.
pub fn one_sided<T: Real>(problem: &Problem<T>, c: &[T], g: &[T]) -> Vec<f64> {
    let mut residuals = vec![f64::NAN; problem.rows.all()];
    for element in problem.all_elements() {
        let (row, at) = (element.place.row as usize, element.place.inequality as usize);
        for r in 0..element.rows as usize {
            residuals[row + r] = if element.kind() != RowKind::Inequality { c[row + r] } else { g[at + r] }.as_f64();
        }
    }
    residuals
}

/// Text of a file in `tests/data`.
pub fn data(name: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)).unwrap()
}

/// A candidate of `ipopt_candidates.jsonl`.
pub struct ReferenceCandidate {
    pub scenario: String,
    pub target: u64,
    pub index: u64,
    pub task: Task,
    pub schedule: Schedule,
    /// True if Ipopt solved TOWR's problem in 50 or in 500 iterations.
    pub solved_by_ipopt: bool,
    /// True if Ipopt solved it in 50 iterations.
    pub solved_at_once: bool,
    /// Status of Ipopt after 50 iterations.
    pub status: i32,
    /// Sizes of TOWR's problem.
    pub n_variables: usize,
    pub n_constraints: usize,
    pub nnz_jacobian: usize,
}

/// Reads the reference candidates.
pub fn reference_candidates() -> Vec<ReferenceCandidate> {
    data("ipopt_candidates.jsonl").lines().map(reference_candidate).collect()
}

fn reference_candidate(line: &str) -> ReferenceCandidate {
    let value: serde_json::Value = serde_json::from_str(line).unwrap();
    let scenario = Scenario::named(value["scenario"].as_str().unwrap()).unwrap();
    let target = value["target"].as_u64().unwrap();
    let mut task = scenario.task(target as usize).unwrap();
    if scenario.name == "hex" {
        // The reference was computed with the inertia as published.
        task.robot = Arc::new(Robot::named("pexod-as-published").unwrap());
    }
    task.force_limit = Some(FORCE_LIMIT);
    let durations: Vec<Vec<f64>> = serde_json::from_value(value["durations"].clone()).unwrap();
    let size = |key: &str| value["ipopt"][key].as_u64().unwrap() as usize;
    ReferenceCandidate {
        scenario: scenario.name.into(),
        target,
        index: value["idx"].as_u64().unwrap(),
        task,
        schedule: Schedule::new(durations).unwrap(),
        solved_by_ipopt: ["ipopt", "ipopt_long"].iter().any(|run| value[run]["n_violated"] == 0),
        solved_at_once: value["ipopt"]["n_violated"] == 0,
        status: value["ipopt"]["status"].as_i64().unwrap() as i32,
        n_variables: size("n_variables"),
        n_constraints: size("n_constraints"),
        nnz_jacobian: size("nnz_jacobian"),
    }
}
