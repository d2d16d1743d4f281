//! Costs and derivatives along the durations of a short walk, and descents from it.

use super::super::tests::{found, task};
use super::super::variables::SHORT;
use super::*;
use crate::gait::family::GaitFamily;
use crate::rows::table::NONE;
use crate::search::evaluate::{Evaluated, LowerSettings};
use crate::settings::Friction;
use crate::verify::verify_rows;

/// Predicted relative fall of the cost at which the minimisations of these tests end.
const TOLERANCE: f64 = 1e-8;

fn transcription() -> TranscriptionSettings {
    TranscriptionSettings { friction: Some(Friction::Cone), ..TranscriptionSettings::default() }
}

fn settings(tolerance: f64) -> SolverSettings {
    let optimise = OptimiseSettings { iterations: 1, tolerance, ..OptimiseSettings::default() };
    SolverSettings { optimise, ..SolverSettings::default() }
}

/// A few steps of a turning biped.
fn walk() -> (Task, Evaluated) {
    let task = task("biped", "flat", [0.3, 0.05], 0.3);
    let gait = found(&task, GaitFamily::Walk, &LowerSettings { transcription: transcription(), ..LowerSettings::default() });
    (task, gait)
}

/// Calls `then` with a minimiser for the walk and its initial point.
fn with_walk(then: impl Fn(&mut Minimiser, Point)) {
    let (task, gait) = walk();
    let (transcription, weights, settings) = (transcription(), CostWeights::default(), settings(TOLERANCE));
    let space = Space::new(&task, &gait.schedule, &transcription, &RefineSettings::default()).with_cost(&weights);
    let point = space.start(&gait.schedule, &gait.x);
    then(&mut Minimiser::new(space, &weights, &settings, EFFORT), point);
}

/// Motion of least cost with the durations of a point, after more iterations than a descent has.
fn least(minimiser: &mut Minimiser, point: Point, multipliers: Option<&Values>) -> Optimum {
    let near = minimiser.optimum(point, multipliers, &|| false).unwrap();
    let found = minimiser.solver.multipliers();
    let from = Resume { x: &near.point.x, multipliers: &found, barrier: BARRIER, iterations: 60 };
    let finish = Finish::Rows(minimiser.settings.row_tolerance);
    let outcome = minimiser.solver.resume(&near.point.problem, &minimiser.settings, finish, &from, &|| false);
    assert_eq!(outcome.status, Status::Solved);
    let found = minimiser.solver.multipliers();
    let multipliers = known(&minimiser.space, &near.point.problem).iter().flat_map(|row| row.values(&found.c, &found.g)).collect();
    let point = minimiser.space.moved(near.point, minimiser.solver.solution());
    let motion = trajectory(minimiser.space.task, &point.problem.curves, &point.x);
    let robot = &minimiser.space.task.robot;
    let cost = cost(&motion, robot, robot.leg_mass(), minimiser.weights).unwrap().total;
    Optimum { point, multipliers, cost }
}

#[test]
fn derivatives_along_the_durations_agree_with_costs_minimised_again() {
    with_walk(|minimiser, point| {
        let here = least(minimiser, point, None);
        let moves = minimiser.space.moves(&here.point);
        let slope = minimiser.slope(&here, &moves).unwrap();
        let single = moves.iter().zip(&slope).filter(|(m, _)| m.by.len() == 1);
        for (m, slope) in single {
            let (at, step) = (m.by[0].0, 0.04 * m.length);
            let mut side = |sign: f64| {
                let mut v = here.point.v.clone();
                v[at] += sign * step;
                minimiser.space.keep_impulses(&here.point.v, &mut v);
                // The cost of the rows: near powers that are zero that of the motion differs, because it has no rounding.
                let found = least(minimiser, minimiser.space.point(v).unwrap(), Some(&here.multipliers));
                cost_of_rows(&found.point, minimiser.settings.optimise.rounding_floor)
            };
            let [up, down] = [side(1.), side(-1.)];
            let expected = (up - down) / (2. * step);
            assert!((slope - expected).abs() < 0.05 * expected.abs(), "variable {at}: {slope} is not {expected}");
        }
    });
}

/// Weighted cost of the cost rows of a point.
///
/// * `rounding` - of absolute values, m/s
fn cost_of_rows(point: &Point, rounding: f64) -> f64 {
    let objective = Objective { weight: 1., rounding };
    objective.cost(&point.problem, &Residuals::new(&point.problem, &point.x, false).c)
}

#[test]
fn cost_rows_add_up_to_the_cost_of_the_walk() {
    with_walk(|minimiser, point| {
        let at = least(minimiser, point, None);
        let got = cost_of_rows(&at.point, 1e-9);
        assert!((got - at.cost).abs() < 1e-3 * at.cost, "{got} by rows, {} by the motion", at.cost);
    });
}

#[test]
fn the_cost_is_continuous_where_a_boundary_passes_a_knot() {
    with_walk(|minimiser, point| {
        let space = &minimiser.space;
        for at in space.variables.feet.iter().flat_map(|foot| &foot.boundaries).flatten() {
            let cost = |to: f64| {
                let mut v = point.v.clone();
                v[*at] = to;
                cost_of_rows(&space.point(v).unwrap(), 1e-9)
            };
            let knot = point.v[*at].round();
            // A part of the quadrature is shorter than the shortest one, equal to it or longer.
            for by in [1e-9, 1e-7, 1e-5, 1e-4, 1e-3] {
                let jump = (cost(knot + by) - cost(knot - by)).abs();
                assert!(jump < 4. * by + 1e-9, "variable {at}: {jump} within {by} of knot {knot}");
            }
        }
    });
}

#[test]
fn parts_of_the_cost_have_all_derivatives_of_its_sum() {
    with_walk(|minimiser, point| {
        let space = &minimiser.space;
        let objective = Objective { weight: 1., rounding: 0.01 };
        let parts = |problem: &Problem<f64>, x: &[f64]| cost_parts(problem, &Residuals::new(problem, x, false).c, &objective);
        let (windows, here): (Vec<_>, Vec<f64>) = parts(&point.problem, &point.x).into_iter().unzip();
        let values = |problem: &Problem<f64>, x: &[f64]| parts(problem, x).into_iter().map(|(_, cost)| cost).collect();
        let mut slope = vec![0.; space.variables.count];
        by_group(space, &point, &windows, &here, &values, Sides::Ahead, &mut |_, variable, by| slope[variable] += by).unwrap();
        let whole = |point: &Point| objective.cost(&point.problem, &Residuals::new(&point.problem, &point.x, false).c);
        assert!((here.iter().sum::<f64>() - whole(&point)).abs() < 1e-12 * whole(&point));
        for m in space.moves(&point).iter().filter(|m| m.by.len() == 1) {
            let (at, step) = (m.by[0].0, 1e-5);
            let side = |sign: f64| {
                let mut v = point.v.clone();
                v[at] += sign * step * m.length;
                whole(&space.point(v).unwrap())
            };
            let expected = (side(1.) - side(-1.)) / (2. * step);
            let got = slope[at] * m.length;
            assert!((got - expected).abs() < 1e-6, "variable {at}: {got} is not {expected}");
        }
    });
}

#[test]
fn moves_keep_the_impulses_of_the_stances() {
    with_walk(|minimiser, point| {
        let space = &minimiser.space;
        let mut v = point.v.clone();
        for (i, m) in space.moves(&point).iter().enumerate() {
            m.by.iter().for_each(|(at, by)| v[*at] += 0.05 * m.length * by * (i as f64).sin());
        }
        space.keep_impulses(&point.v, &mut v);
        let moved = space.point(v).unwrap();
        let impulses = |point: &Point| -> Vec<[f64; 3]> {
            let of_stance = |(phase, nodes): (&crate::gait::Phase, &Vec<u32>)| {
                let piece = phase.duration() / (nodes.len() - 1) as f64;
                let at = |node: u32, d: usize| if node == NONE { 0. } else { point.x[node as usize + d] };
                std::array::from_fn(|d| {
                    let of_piece = |w: &[u32]| (at(w[0], d) + at(w[1], d)) / 2. + (at(w[0], d + 3) - at(w[1], d + 3)) / 12.;
                    nodes.windows(2).map(of_piece).sum::<f64>() * piece
                })
            };
            point.problem.curves.feet.iter().flat_map(|foot| foot.phases.iter().step_by(2).zip(&foot.force_nodes)).map(of_stance).collect()
        };
        let durations = |point: &Point| point.schedule.durations().to_vec();
        assert!(durations(&moved) != durations(&point));
        for (before, after) in impulses(&point).iter().zip(impulses(&moved)) {
            for (before, after) in before.iter().zip(after) {
                assert!((before - after).abs() < 1e-12, "{after} is not {before}");
            }
        }
    });
}

#[test]
fn steps_that_shorten_a_phase_too_much_are_not_made() {
    with_walk(|minimiser, point| {
        let (moves, space) = (minimiser.space.moves(&point), &minimiser.space);
        // The first move is that of the end of the first stance.
        let (shortest, now) = (space.shortest[0][0], point.schedule.durations()[0][0]);
        for (share, made) in [(1. - 0.5 * SHORT, true), (1. - 2. * SHORT, false)] {
            let mut step = vec![0.; moves.len()];
            step[0] = (share * shortest - now) / point.schedule.interval();
            assert_eq!(minimiser.after(&point, &moves, &step).is_some(), made, "{share} of the shortest duration");
        }
    });
}

/// Result and cost of a descent from the walk, after checks of its rows and durations.
///
/// * `steps` - largest number of changes of the durations
/// * `iterations` - those of the settings, which are for solves
fn descended(steps: usize, iterations: usize) -> (Timed, f64) {
    let (task, gait) = walk();
    let weights = CostWeights::default();
    let mut settings = settings(OptimiseSettings::default().tolerance);
    settings.optimise.iterations = iterations;
    let transcription = transcription();
    let mut descent = Descent::new(&task, (&gait.schedule, &gait.x), &transcription, &weights, &settings, &|| false).unwrap();
    descent.advance(steps, &|| false);
    let timed = descent.timed();
    let problem = Problem::<f64>::new(&task, &timed.schedule, &transcription);
    assert_eq!(timed.x.len(), problem.initial.len());
    let motion = trajectory(&task, &problem.curves, &timed.x);
    assert!(verify_rows(&motion, &task.robot, &task.terrain, problem.force_limit()).unwrap().feasible);
    let cost = cost(&motion, &task.robot, task.robot.leg_mass(), &weights).unwrap().total;
    // Without steps the durations are those of the walk.
    assert_eq!(timed.schedule == gait.schedule, steps == 0);
    let least = RefineSettings::default().shortest_phase * crate::gait::family::time_scale(&task.robot);
    let given = gait.schedule.durations().iter().flatten();
    for (duration, given) in timed.schedule.durations().iter().flatten().zip(given) {
        assert!(*duration > given.min(least) * (1. - SHORT), "{duration} is shorter than {}", given.min(least));
    }
    (timed, cost)
}

#[test]
fn a_descent_lowers_the_cost_and_ends_with_a_certified_gait() {
    let (first, before) = descended(0, 12);
    let (timed, after) = descended(6, 12);
    assert!(after < 0.99 * before, "{after} after, {before} before");
    assert!(timed.outcome.iterations > first.outcome.iterations);
}

#[test]
fn a_descent_minimises_the_cost_even_if_solves_do_not() {
    let [none, some] = [0, 12].map(|iterations| descended(2, iterations).1);
    assert_eq!(none, some);
}

#[test]
fn a_cancelled_descent_has_no_result() {
    let (task, gait) = walk();
    let (weights, settings) = (CostWeights::default(), settings(TOLERANCE));
    assert!(Descent::new(&task, (&gait.schedule, &gait.x), &transcription(), &weights, &settings, &|| true).is_none());
}
