//! Properties of any gait, robot and goal.

use crate::common::{Random, Rows, gait, lopsided, point, problem_with, rows, task, task_for, transcriptions};
use cregopt::backend::Cpu;
use cregopt::gait::Schedule;
use cregopt::gait::spline::hermite;
use cregopt::gait::trajectory::GoalVelocity;
use cregopt::nlp::Problem;
use cregopt::nlp::transcription::interval;

use cregopt::robot::{GRAVITY, Robot};
use cregopt::rows::acceleration::Acceleration;
use cregopt::rows::footing::Footing;
use cregopt::rows::stride::Stride;
use cregopt::rows::table::{NONE, Run};
use cregopt::rows::{Family, RowKind};
use cregopt::search::evaluate::{LowerSettings, evaluate};
use cregopt::settings::{Friction, Legs, Transcription, TranscriptionSettings};
use cregopt::solver::Status;
use cregopt::task::{Goal, Task};
use cregopt::terrain::Terrain;
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Error of sums of up to 45 durations, s.
const TIME_TOLERANCE: f64 = 1e-12;

/// Error of rows of two problems with different orders of variables: sums in another order, of terms up to 100.
const MIRROR_TOLERANCE: f64 = 1e-11;

/// Imbalance of a certified trajectory, N: the residual that the solver leaves, less than what the certificate counts.
const BALANCE_TOLERANCE: f64 = 1e-4;

/// Configuration with the same cases in every run and no files next to the sources.
fn config(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() }
}

/// Durations of one foot: an odd number of phases, some of the least duration.
fn durations() -> impl Strategy<Value = Vec<f64>> {
    let phase = || prop_oneof![4 => 0.05..0.6, 1 => Just(0.001), 1 => Just(0.1), 1 => Just(0.08)];
    (0..12usize).prop_flat_map(move |swings| vec(phase(), 2 * swings + 1))
}

fn schedule(feet: std::ops::RangeInclusive<usize>) -> impl Strategy<Value = Schedule> {
    vec(durations(), feet).prop_map(|d| Schedule::new(d).unwrap())
}

fn transcription() -> impl Strategy<Value = TranscriptionSettings> {
    let rows = prop_oneof![Just(Transcription::Momentum), Just(Transcription::Towr)];
    let goal_velocity = prop_oneof![Just(GoalVelocity::Zero), Just(GoalVelocity::Free), Just(GoalVelocity::Near)];
    let numbers = (0.04..0.4, 0.03..0.3, 2..6usize);
    let legs = prop_oneof![Just(Legs::Limited), Just(Legs::Free)];
    (rows, legs, goal_velocity, any::<bool>(), numbers).prop_map(
        |(rows, legs, goal_velocity, cone, (interval, reach_interval, force_pieces))| {
            TranscriptionSettings {
                rows,
                legs,
                goal_velocity,
                // TOWR has a pyramid only.
                friction: Some(if cone && rows == Transcription::Momentum { Friction::Cone } else { Friction::Pyramid }),
                interval: Some(interval),
                reach_interval,
                force_pieces: Some(force_pieces),
                ..TranscriptionSettings::default()
            }
        },
    )
}

fn end(durations: &[f64]) -> f64 {
    durations.iter().sum()
}

proptest! {
    #![proptest_config(config(256))]

    #[test]
    fn aligned_schedules_end_together_and_only_last_stances_grow(schedule in schedule(1..=8), interval in 0.02..0.5) {
        let aligned = schedule.aligned(interval);
        let horizon = schedule.intervals(interval) as f64 * interval;
        prop_assert!(horizon > schedule.horizon() - 1e-8 && horizon - interval < schedule.horizon(), "as few intervals as reach the end");
        for (before, after) in schedule.durations().iter().zip(aligned.durations()) {
            let last = before.len() - 1;
            prop_assert_eq!(&before[..last], &after[..last]);
            prop_assert!(after[last] > before[last] - 1e-8);
            prop_assert!((end(after) - horizon).abs() < TIME_TOLERANCE);
        }
        prop_assert_eq!(aligned.intervals(interval), schedule.intervals(interval));
        for (once, twice) in aligned.durations().iter().flatten().zip(aligned.aligned(interval).durations().iter().flatten()) {
            prop_assert!((once - twice).abs() < TIME_TOLERANCE);
        }
    }

    #[test]
    fn any_schedule_has_a_consistent_layout(schedule in schedule(1..=8), settings in transcription(), edges in any::<bool>()) {
        let terrain = Terrain::named(if edges { "slope" } else { "flat" }).unwrap();
        let task = task_for(crate::common::spider(schedule.feet()), terrain, [2., 0.5], 1.);
        let problem = Problem::<f32>::new(&task, &schedule.aligned(interval(&settings, &task.robot)), &settings);
        check_sizes(&problem, &schedule, &settings)?;
        check_places(&problem)?;
        check_sweep(&problem)?;
        prop_assert!(problem.initial.iter().all(|v| v.is_finite()));
        let evaluated = rows(&problem, &problem.initial, 0.);
        prop_assert!(evaluated.c.iter().chain(&evaluated.g).all(|v| v.is_finite()), "every row is written");
    }
}

/// Numbers of variables and rows, derived from the schedule alone.
fn check_sizes(problem: &Problem<f32>, schedule: &Schedule, settings: &TranscriptionSettings) -> Result<(), TestCaseError> {
    let (pieces, knots) = (settings.force_pieces(), problem.curves.intervals);
    let stances: usize = (0..schedule.feet()).map(|foot| schedule.stances(foot)).sum();
    let swings = stances - schedule.feet();
    let momentum = settings.rows == Transcription::Momentum;
    // Base: all coefficients but three, or pose and rates at every knot but those of the start, the goal and, if it is at rest, its rates.
    let (base, fixed) = match (momentum, settings.goal_velocity) {
        (false, _) => (6 * knots, 18),
        (true, GoalVelocity::Zero) => (12 * (knots - 1), 24),
        (true, GoalVelocity::Free) => (12 * (knots - 1) + 6, 18),
        (true, GoalVelocity::Near) => (12 * knots, 12),
    };
    // Two coordinates of each foothold but the first; heights; force nodes but two per swing.
    let nodes = stances * (pieces + 1) - 2 * swings;
    prop_assert_eq!(problem.variables, base + 2 * swings + swings + 6 * nodes);
    prop_assert_eq!(problem.initial.len(), problem.variables + fixed + 2 * schedule.feet());
    // Rows of a force: at its nodes, or at two Bezier points per node; the end nodes of a stance are such a point themselves.
    let (forces, per_swing, sides) = match momentum {
        false => (nodes, 1, 1),
        // The height has nine points where there are edges, and its upper limit is a row of its own.
        true if problem.terrain.has_edges() => (2 * nodes, 9 + 1, 1),
        true => (2 * nodes, 1, 2),
    };
    let balance = if momentum { [0, knots, knots] } else { [knots + 1, 0, 0] };
    prop_assert_eq!(problem.rows.of(RowKind::Equality).len(), 6 * balance.iter().sum::<usize>());
    let reach = match momentum {
        // At most 0.026 s apart, and five per swing.
        true => ((problem.curves.interval / 0.026).ceil() as usize * knots + 1) * schedule.feet() + 5 * swings,
        false => problem.reach_instants.len() * schedule.feet(),
    };
    let strides = if momentum { swings } else { 0 };
    // At lift-off and at touchdown, where legs are limited.
    let accelerations = if momentum && settings.legs == Legs::Limited { swings } else { 0 };
    // All footholds but the first have a box where there are edges.
    let boxes = if momentum && problem.terrain.has_edges() { swings } else { 0 };
    // The normal force has two sides; in addition the pyramid has four rows, the cone one.
    let (friction, pyramids, cones) = if settings.friction() == Friction::Cone { (1, 0, forces) } else { (4, forces, 0) };
    prop_assert_eq!(
        problem.rows.of(RowKind::Inequality).len(),
        3 * reach + (1 + friction) * forces + per_swing * swings + strides + 2 * accelerations + 2 * boxes
    );
    prop_assert_eq!(
        problem.inequalities,
        6 * reach + (2 + friction) * forces + sides * per_swing * swings + strides + 2 * accelerations + 4 * boxes
    );
    let count = |family| problem.all_elements().filter(|e| e.family == family).count();
    prop_assert_eq!([Family::Dynamics, Family::LinearMomentum, Family::AngularMomentum].map(count), balance);
    let counts =
        [Family::Reach, Family::Force, Family::Cone, Family::Swing, Family::Stride, Family::Acceleration, Family::Footing].map(count);
    prop_assert_eq!(counts, [reach, pyramids, cones, per_swing * swings, strides, accelerations, boxes]);
    Ok(())
}

/// Checks that the rows, inequalities and Jacobian values of the elements cover their buffers once.
fn check_places(problem: &Problem<f32>) -> Result<(), TestCaseError> {
    let (mut row, mut inequality, mut jacobian) =
        (vec![0; problem.rows.all()], vec![0; problem.inequalities], vec![0; problem.jacobian_len]);
    let mut cover = |buffer: usize, from: u32, len: u32| {
        let buffer = [&mut row, &mut inequality, &mut jacobian][buffer].iter_mut();
        buffer.skip(from as usize).take(len as usize).for_each(|used| *used += 1);
    };
    for (element, runs) in problem.all_elements().zip(problem.columns()) {
        let place = &element.place;
        cover(0, place.row, element.rows);
        cover(2, place.jacobian, element.rows * place.stride);
        prop_assert_eq!(problem.rows.kind(place.row), element.kind());
        if element.kind() == RowKind::Inequality {
            cover(1, place.inequality, element.rows + element.pairs);
        }
        // The base blocks share the columns of the pose, the first six of a foot's reach, through weights.
        let shared = if element.family == Family::Reach { 6 } else { 0 };
        let mut column = shared;
        for (run, weight) in &runs {
            prop_assert!((run.variable + run.len) as usize <= problem.variables);
            if run.column < shared {
                prop_assert!((run.column, run.len) == (0, shared) && *weight != 0.);
                continue;
            }
            prop_assert!(run.column == column && *weight == 1., "columns follow each other");
            column += run.len;
        }
        if element.family == Family::Reach {
            prop_assert!(element.runs.range().is_empty(), "their tables have them");
        } else {
            let apart = |a: &(Run, f32), b: &(Run, f32)| a.0.variable + a.0.len < b.0.variable;
            prop_assert!(runs.is_sorted_by(apart), "runs are apart and in order");
        }
        prop_assert!(column <= place.stride && place.stride % 8 == 0);
    }
    for (name, used) in [("row", row), ("inequality", inequality), ("Jacobian value", jacobian)] {
        prop_assert!(used.iter().all(|&used| used == 1), "every {} belongs to one element", name);
    }
    Ok(())
}

/// Checks that every variable is eliminated once, at the last step that touches it, and that fronts contain what they need.
fn check_sweep(problem: &Problem<f32>) -> Result<(), TestCaseError> {
    prop_assert_eq!(problem.steps.iter().map(|s| s.pivots as usize).sum::<usize>(), problem.variables);
    prop_assert_eq!(problem.steps.iter().map(|s| (s.pivots * s.stride) as usize).sum::<usize>(), problem.factor_len);
    let mut last_step = vec![usize::MAX; problem.variables];
    let (mut next_element, mut next_pivot, mut next_instant) = (0, 0, 0);
    let columns = problem.columns();
    for (k, step) in problem.steps.iter().enumerate() {
        prop_assert_eq!(step.elements.start, next_element);
        next_element = step.elements.end;
        prop_assert!(step.pivots == 0 || step.variable == next_pivot);
        next_pivot += step.pivots;
        prop_assert!(step.pivots <= step.size && step.size < step.stride && (step.size as usize) < problem.front_stride);
        // Variables of the front in order: pivots, then the rest.
        let mut front: Vec<u32> = (step.variable..step.variable + step.pivots).collect();
        for run in &problem.front_runs[step.rest.range()] {
            prop_assert_eq!(run.front as usize, front.len());
            front.extend(run.variable..run.variable + run.len);
        }
        prop_assert_eq!(front.len(), step.size as usize);
        let of_step = problem.reach_rows.steps[k];
        prop_assert_eq!(of_step.start, next_instant);
        next_instant = of_step.end;
        let instants = &problem.reach_rows.instants[of_step.range()];
        let factored = instants.iter().flat_map(|instant| instant.elements.range()).map(|number| problem.elements.len() + number);
        for element in step.elements.range().chain(factored) {
            for (run, _) in &columns[element] {
                for i in 0..run.len {
                    prop_assert_eq!(front[(run.front + i) as usize], run.variable + i);
                    last_step[(run.variable + i) as usize] = k;
                }
            }
        }
        let pivots = &last_step[step.variable as usize..(step.variable + step.pivots) as usize];
        prop_assert!(pivots.iter().all(|&last| last == k), "eliminated where they are last touched");
    }
    prop_assert_eq!(next_element as usize, problem.elements.len());
    let factored = &problem.reach_rows;
    prop_assert_eq!([next_instant as usize, factored.instants.len()], [problem.reach_instants.len(); 2]);
    let mut next = 0;
    for instant in &factored.instants {
        prop_assert!(instant.elements.start == next && instant.elements.end > next);
        next = instant.elements.end;
    }
    prop_assert!(problem.elements.iter().all(|e| e.family != Family::Reach));
    prop_assert_eq!([factored.as_elements().count(), problem.reach_feet.len()], [next as usize; 2]);
    prop_assert!(factored.as_elements().is_sorted_by(|a, b| a.place.jacobian < b.place.jacobian), "in the order of the feet");
    // Own columns and base blocks are in one step, because their places in its front are valid only there.
    let mut step_of = [vec![usize::MAX; factored.own.len()], vec![usize::MAX; factored.base_blocks.len()]];
    for (k, of_step) in factored.steps.iter().enumerate() {
        for instant in &factored.instants[of_step.range()] {
            let own = factored.elements[instant.elements.range()].iter().map(|element| (0, element.own));
            for (table, entry) in own.chain([(1, instant.blocks)]) {
                let of = &mut step_of[table][entry as usize];
                prop_assert!(*of == usize::MAX || *of == k);
                *of = k;
            }
        }
    }
    prop_assert!(step_of.iter().flatten().all(|step| *step != usize::MAX), "none is left out");
    Ok(())
}

/// A robot whose left and right halves mirror each other.
fn symmetric_robot(robot: &str) -> Robot {
    let mut robot = Robot::named(robot).unwrap();
    let inertia = &mut robot.inertia;
    // Mirroring y changes the signs of xy and yz.
    for (i, j) in [(0, 1), (1, 0), (1, 2), (2, 1)] {
        inertia[i][j] = 0.;
    }
    lopsided(robot)
}

/// Indices of the left and the right foot of a pair.
fn mirrored_foot(foot: usize) -> usize {
    foot ^ 1
}

/// The mirrored point: each block of `x` with the signs of its components, at its place in the other problem.
fn mirrored_point(problem: &Problem<f64>, other: &Problem<f64>, x: &[f64]) -> Vec<f64> {
    let mut mirrored = vec![f64::NAN; x.len()];
    let mut copy = |from: u32, to: u32, signs: &[f64]| {
        for (i, sign) in signs.iter().enumerate() {
            mirrored[to as usize + i] = sign * x[from as usize + i];
        }
    };
    for (&from, &to) in problem.curves.base.iter().zip(&other.curves.base) {
        // Position, or its rate; roll and yaw change sign.
        copy(from, to, &[1., -1., 1., -1., 1., -1.]);
    }
    for (foot, blocks) in problem.curves.feet.iter().enumerate() {
        let there = &other.curves.feet[mirrored_foot(foot)];
        blocks.footholds.iter().zip(&there.footholds).for_each(|(&from, &to)| copy(from, to, &[1., -1.]));
        blocks.heights.iter().zip(&there.heights).for_each(|(&from, &to)| copy(from, to, &[1.]));
        for (&from, &to) in blocks.force_nodes.iter().flatten().zip(there.force_nodes.iter().flatten()) {
            assert_eq!(from == NONE, to == NONE);
            if from != NONE {
                copy(from, to, &[1., -1., 1., 1., -1., 1.]);
            }
        }
    }
    assert!(mirrored.iter().all(|v| v.is_finite()), "every value has its mirror image");
    mirrored
}

/// Residuals at the mirrored point, computed from those at the point: `[c, g]` in the order of the other problem.
fn mirrored_rows(robot: &Robot, problem: &Problem<f64>, other: &Problem<f64>, rows: &Rows<f64>) -> [Vec<f64>; 2] {
    let (mut c, mut g) = (vec![f64::NAN; other.rows.one_sided()], vec![f64::NAN; other.inequalities]);
    for (from, to) in problem.dynamics_instants.iter().zip(&other.dynamics_instants) {
        // Moments about x and z change sign, and the force along y.
        for (i, sign) in [-1., 1., -1., 1., -1., 1.].into_iter().enumerate() {
            c[to.place.row as usize + i] = sign * rows.c[from.place.row as usize + i];
        }
    }
    for (from, to) in problem.momentum_intervals.iter().zip(&other.momentum_intervals) {
        // Velocity and position along y; angular momenta about x and z.
        for (from, to, sign) in [(&from.linear, &to.linear, 1.), (&from.angular, &to.angular, -1.)] {
            for (i, side) in [1., -1., 1., 1., -1., 1.].into_iter().enumerate() {
                c[to.row as usize + i] = sign * side * rows.c[from.row as usize + i];
            }
        }
    }
    let mut copy = |from: u32, to: u32, order: &[usize]| {
        for (i, &j) in order.iter().enumerate() {
            g[to as usize + i] = rows.g[from as usize + j];
        }
    };
    let feet = problem.curves.feet.len();
    for foot in 0..feet {
        // A foot is identified by the centre of its box; its entries are in order of time.
        let of = |problem: &Problem<f64>, foot: usize| -> Vec<u32> {
            let (nominal, middle) = (robot.nominal_feet[foot], robot.reach.of(foot).center());
            let center = std::array::from_fn(|axis| nominal[axis] + middle[axis]);
            {
                let of_foot = |element: &usize| problem.reach_legs[problem.reach_feet[*element].leg as usize].center == center;
                let place = |element: usize| problem.reach_rows.place(element).inequality;
                (0..problem.reach_feet.len()).filter(of_foot).map(place).collect()
            }
        };
        let (here, there) = (of(problem, foot), of(other, mirrored_foot(foot)));
        assert!(!here.is_empty() && here.len() == there.len());
        // The upper and lower sides of y are exchanged.
        here.iter().zip(&there).for_each(|(&from, &to)| copy(from, to, &[0, 4, 2, 3, 1, 5]));
    }
    // Force nodes and swings are ordered by foot.
    for foot in 0..feet {
        let of = |problem: &Problem<f64>, foot: usize| {
            let blocks = &problem.curves.feet[foot];
            let forces = |&node: &u32| problem.force_nodes.iter().filter(move |n| n.node == node).map(|n| n.place.inequality);
            let swings = |&height: &u32| problem.swing_nodes.iter().filter(move |s| s.height == height).map(|s| s.place.inequality);
            let strides = |&foothold: &u32| {
                let ends_there = move |s: &&Stride<f64>| problem.footholds[s.foothold[1] as usize] == foothold;
                problem.strides.iter().filter(ends_there).map(|s| s.place.inequality)
            };
            let boxes = |&foothold: &u32| {
                let of_it = move |f: &&Footing<f64>| problem.footholds[f.foothold as usize] == foothold;
                problem.footings.iter().filter(of_it).map(|f| f.place.inequality)
            };
            let accelerations = |&foothold: &u32| {
                let ends_there = move |a: &&Acceleration<f64>| problem.footholds[a.foothold[1] as usize] == foothold;
                problem.accelerations.iter().filter(ends_there).map(|a| a.place.inequality)
            };
            [
                blocks.force_nodes.iter().flatten().filter(|&&n| n != NONE).flat_map(forces).collect::<Vec<u32>>(),
                blocks.heights.iter().flat_map(swings).collect(),
                blocks.footholds.iter().flat_map(strides).collect(),
                blocks.footholds.iter().flat_map(accelerations).collect(),
                blocks.footholds.iter().flat_map(boxes).collect(),
            ]
        };
        let (here, there) = (of(problem, foot), of(other, mirrored_foot(foot)));
        assert_eq!(here.each_ref().map(Vec::len), there.each_ref().map(Vec::len));
        // The sides of the pyramid along y are exchanged, too. A swing's height is two-sided in `momentum` on level ground.
        let two_sided = problem.curves.transcription == Transcription::Momentum && !problem.terrain.has_edges();
        let heights: &[usize] = if two_sided { &[0, 1] } else { &[0] };
        for (i, order) in [&[0, 1, 2, 4, 3, 5], heights, &[0], &[0, 1], &[0, 3, 2, 1]].into_iter().enumerate() {
            here[i].iter().zip(&there[i]).for_each(|(&from, &to)| copy(from, to, order));
        }
    }
    [c, g]
}

proptest! {
    #![proptest_config(config(64))]

    #[test]
    fn mirrored_gaits_give_mirrored_residuals(
        seed in any::<u64>(),
        (robot, terrain) in prop_oneof![Just(("anymal", "flat")), Just(("biped", "slope")), Just(("pexod", "gap")), Just(("hyq", "step"))],
        (x, y, yaw) in (1.0..4.5, -1.0..1.0, -2.0..2.0),
    ) {
        let robot = symmetric_robot(robot);
        let terrain = Terrain::named(terrain).unwrap();
        let (here, there) = (task_for(robot.clone(), terrain.clone(), [x, y], yaw), task_for(robot, terrain, [x, -y], -yaw));
        let mut random = Random::new(seed);
        let schedule = gait(&mut random, here.robot.feet(), 3..=7);
        let durations = schedule.durations();
        let mirrored = Schedule::new((0..durations.len()).map(|foot| durations[mirrored_foot(foot)].clone()).collect()).unwrap();
        // The test follows the places of the pyramid's rows.
        for settings in transcriptions().map(|s| TranscriptionSettings { friction: Some(Friction::Pyramid), ..s }) {
            let (problem, other) = (problem_with::<f64>(&here, &schedule, &settings), problem_with::<f64>(&there, &mirrored, &settings));
            let point = point(&problem, &mut random, 0.04);
            for edge_radius in [0., 0.04] {
                let [c, g] = mirrored_rows(&here.robot, &problem, &other, &rows(&problem, &point, edge_radius));
                let got = rows(&other, &mirrored_point(&problem, &other, &point), edge_radius);
                for (name, got, expected) in [("equality", got.c, c), ("inequality", got.g, g)] {
                    for (i, (a, b)) in got.iter().zip(&expected).enumerate() {
                        prop_assert!((a - b).abs() <= MIRROR_TOLERANCE * b.abs().max(1.), "{} {}: {} against {}", name, i, a, b);
                    }
                }
            }
        }
    }
}

/// A quadruped of any size in stance on a level rectangle of feet.
fn stander(mass: f64, half_length: f64, half_width: f64, height: f64) -> Robot {
    let feet = [(1., 1.), (1., -1.), (-1., 1.), (-1., -1.)];
    // A solid box as long and wide as the stance and a third as high as the base.
    let [xx, yy, zz] = [half_length, half_width, height / 6.].map(|half| 4. * half * half * mass / 12.);
    Robot {
        name: "stander".into(),
        mass,
        inertia: [[yy + zz, 0., 0.], [0., xx + zz, 0.], [0., 0., xx + yy]],
        base_height: height,
        nominal_feet: feet.map(|(x, y)| [x * half_length, y * half_width, -height]).to_vec(),
        reach: [0.1, 0.1, 0.1].into(),
        force_limit: None,
        leg_mass: None,
        joints: None,
        foot_radius: None,
        sole: None,
    }
}

/// Force on the base at time `t`, N.
fn total_force(trajectory: &cregopt::gait::Trajectory, t: f64) -> [f64; 3] {
    let mut total = [0.; 3];
    for foot in &trajectory.ee {
        let (mut start, mut piece) = (0., 0);
        while piece + 1 < foot.force.poly_durations.len() && t > start + foot.force.poly_durations[piece] {
            start += foot.force.poly_durations[piece];
            piece += 1;
        }
        let weights = hermite(t - start, foot.force.poly_durations[piece]);
        for d in 0..3 {
            let (a, b) = (foot.force.nodes[piece], foot.force.nodes[piece + 1]);
            total[d] += weights[0] * a[d] + weights[1] * a[3 + d] + weights[2] * b[d] + weights[3] * b[3 + d];
        }
    }
    total
}

/// Mean force on the base from `start` on, N, by Simpson's rule.
fn mean_force(trajectory: &cregopt::gait::Trajectory, start: f64, length: f64) -> [f64; 3] {
    const PANELS: usize = 100;
    let mut mean = [0.; 3];
    for i in 0..=2 * PANELS {
        let weight = if i == 0 || i == 2 * PANELS { 1. } else { [2., 4.][i % 2] } / (6 * PANELS) as f64;
        let force = total_force(trajectory, start + length * i as f64 / (2 * PANELS) as f64);
        (0..3).for_each(|d| mean[d] += weight * force[d]);
    }
    mean
}

proptest! {
    #![proptest_config(config(24))]

    #[test]
    fn a_standing_robot_carries_its_weight(
        (mass, half_length, half_width, height) in (1.0..100.0, 0.15..0.5, 0.1..0.3, 0.2..0.6),
        intervals in 3..12usize,
    ) {
        let task = Task::new(stander(mass, half_length, half_width, height), Terrain::flat(), Goal::at(0., 0.)).unwrap();
        let horizon = intervals as f64 * 0.1;
        let schedule = Schedule::new(vec![vec![horizon]; 4]).unwrap();

        for settings in transcriptions() {
            check_balance(&task, &schedule, settings)?;
        }
    }
}

/// Force balance of a standing robot, at the initial guess and at the solution.
fn check_balance(task: &Task, schedule: &Schedule, transcription: TranscriptionSettings) -> Result<(), TestCaseError> {
    // Equal shares on all feet and a base at rest: no defect. A foot that pushes a tenth more adds a fortieth of the weight.
    let problem = problem_with::<f64>(task, schedule, &transcription);
    let residual = |x: &[f64]| rows(&problem, x, 0.).c;
    prop_assert!(residual(&problem.initial).iter().all(|c| c.abs() < 1e-12));
    let mut pushed = problem.initial.clone();
    for &node in problem.curves.feet[1].force_nodes.iter().flatten() {
        pushed[node as usize + 2] *= 1.1;
    }
    let residual = residual(&pushed);
    let upward: Vec<u32> = match transcription.rows {
        Transcription::Towr => problem.dynamics_instants.iter().map(|instant| instant.place.row + 5).collect(),
        Transcription::Momentum => problem.momentum_intervals.iter().flat_map(|i| [i.linear.row + 2, i.linear.row + 5]).collect(),
    };
    for row in upward {
        let lift = residual[row as usize];
        prop_assert!((lift + 0.1 / 4.).abs() < 1e-12, "row {}: {}", row, lift);
    }

    // The forces carry the solved motion, whatever it is.
    let settings = LowerSettings { transcription: transcription.clone(), ..LowerSettings::default() };
    let results = evaluate(&[(task, schedule)], &settings, None, &Cpu::new(1).unwrap(), false, &|| false).unwrap();
    let result = results[0].as_ref().unwrap();
    prop_assert!(result.feasible && result.outcome.status == Status::Solved && result.outcome.iterations <= 12, "{:?}", result);
    let mass = task.robot.mass;
    let weight = |d: usize| if d == 2 { mass * GRAVITY } else { 0. };
    let trajectory = result.trajectory(task, &transcription);
    let base = &trajectory.base_lin;
    let mut start = 0.;
    for (piece, ends) in base.poly_durations.iter().zip(base.nodes.windows(2)) {
        let (a, b) = (ends[0], ends[1]);
        for d in 0..3 {
            let missing = match transcription.rows {
                // By the second derivative at the start of the piece.
                Transcription::Towr => {
                    let acceleration = (6. * (b[d] - a[d]) - piece * (4. * a[3 + d] + 2. * b[3 + d])) / (piece * piece);
                    total_force(&trajectory, start)[d] - weight(d) - mass * acceleration
                }
                // By the mean over the piece.
                Transcription::Momentum => mean_force(&trajectory, start, *piece)[d] - weight(d) - mass * (b[3 + d] - a[3 + d]) / piece,
            };
            prop_assert!(missing.abs() < BALANCE_TOLERANCE, "axis {} at {} s: {} N", d, start, missing);
        }
        start += piece;
    }
    prop_assert!((result.mean_normal_force / (mass * GRAVITY / 4.) - 1.).abs() < 0.2, "{} N", result.mean_normal_force);
    Ok(())
}

#[test]
fn a_robot_that_is_not_symmetric_is_not_mirrored() {
    // The mirror test notices a difference: ANYmal's own inertia has small products.
    let (here, there) = (task("anymal", "flat", [2., 0.5], 0.6), task("anymal", "flat", [2., -0.5], -0.6));
    let mut random = Random::new(1);
    let schedule = gait(&mut random, 4, 3..=5);
    let durations = schedule.durations();
    let mirrored = Schedule::new((0..4).map(|foot| durations[mirrored_foot(foot)].clone()).collect()).unwrap();
    for settings in transcriptions() {
        let (problem, other) = (problem_with::<f64>(&here, &schedule, &settings), problem_with::<f64>(&there, &mirrored, &settings));
        let point = point(&problem, &mut random, 0.);
        let [c, _] = mirrored_rows(&here.robot, &problem, &other, &rows(&problem, &point, 0.));
        let got = rows(&other, &mirrored_point(&problem, &other, &point), 0.).c;
        assert!(got.iter().zip(&c).any(|(a, b)| (a - b).abs() > 1e6 * MIRROR_TOLERANCE));
    }
}
