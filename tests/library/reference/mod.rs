//! The kernels against independent f64 formulas on TOWR's node values, central differences and dense linear algebra.

mod formulas;
mod linear;
mod rows;
mod solver;

use crate::common::{Random, cut, gait, hills, lopsided, spider, task, task_for};
use cregopt::gait::Schedule;
use cregopt::real::Real;
use cregopt::task::Task;
use cregopt::terrain::Terrain;

/// Tolerance of residuals, kernel against formula. Second differences of node values 0.1 s apart lose four of sixteen digits.
const RESIDUAL_TOLERANCE: f64 = 1e-10;

/// Step of central differences. The error of their quotient is near 1e-10, from rounding and from curvature.
const DIFFERENCE_STEP: f64 = 1e-5;

/// Tolerance of Jacobian entries against central differences, relative to the larger of 1 and the entry.
const JACOBIAN_TOLERANCE: f64 = 2e-6;

/// Tolerance of the direction, f64 front against dense solve, relative to its norm: condition numbers up to 1e7 times 1e-16.
const F64_SOLVE_TOLERANCE: f64 = 1e-9;

/// Backward error of the f32 front, in units of f32 precision. A Cholesky solve is backward stable, and the error of sums of up to 100
/// products grows with the square root of their number.
const F32_BACKWARD_ERROR: f64 = 20. * f32::EPSILON as f64;

/// Tolerance of f32 kernels against f64 kernels at the same point, relative to the larger of 1 and the value. Positions up to 6 m are off
/// by 2.4e-7 m, which rows in units of 0.1 m multiply by 10, and the normal of the steep gap by its curvature of 33/m.
const F32_TOLERANCE: f64 = 2e-4;

/// Tolerance of deviations of the base from its cubics in f32, relative to the larger of 1 (m, rad, N m s) and the value. They divide the
/// remainder of angular momenta by the inertia: up to 1e3 N m s at a random point, of which 1e-7 is lost, over 0.05 kg m².
const F32_DEVIATION_TOLERANCE: f64 = 2e-3;

/// Tolerance of the linear conditions of elementwise steps, relative to the sizes of their terms: a few roundings.
const ELEMENTWISE_TOLERANCE: f64 = 1e-14;

/// Relative tolerance of sums over all rows in another order.
const SUM_TOLERANCE: f64 = 1e-11;

/// Tolerance of falls in f32, relative to the absolute falls of the terms and to the norm of those terms that are rounded before their
/// difference is taken. Each of these has a few roundings of its own with random signs.
const F32_FALL_ERROR: f64 = 4. * f32::EPSILON as f64;

struct Case {
    name: String,
    task: Task,
    schedule: Schedule,
}

/// Robots with one to eight feet, on every kind of terrain, with and without a turn.
fn cases() -> Vec<Case> {
    let mut random = Random::new(1);
    let gap = || Terrain::named("gap").unwrap();
    let tasks = [
        task("anymal", "flat", [5.9, -0.3], std::f64::consts::PI),
        task("anymal", "step", [3.9, 0.4], 2.),
        task("biped", "gap", [2.7, 0.2], 0.3),
        task("monoped", "slope", [2.8, -0.2], -0.4),
        task("pexod", "slope", [3.3, 0.5], 1.),
        task_for(spider(3), gap(), [2.5, 0.1], -1.),
        task_for(lopsided(spider(5)), hills(), [1., 1.], 0.),
        task_for(spider(7), hills(), [4.5, -1.], 0.5),
        task_for(spider(8), gap(), [2.6, -0.4], 0.7),
    ];
    let case = |task: Task| {
        let feet = task.robot.feet();
        let name = format!("{} on {}", task.robot.name, task.terrain.name);
        Case { name, schedule: gait(&mut random, feet, 5..=13), task }
    };
    let mut cases: Vec<Case> = tasks.into_iter().map(case).collect();
    // Phases that begin and end at instants, and one that lasts throughout.
    let round =
        Schedule::new(vec![vec![0.4, 0.4, 0.2], vec![0.1, 0.3, 0.16, 0.24, 0.2], vec![1.], vec![0.08, 0.16, 0.56, 0.1, 0.1]]).unwrap();
    cases.push(Case { name: "round durations".into(), task: task("anymal", "flat", [0.3, 0.1], 0.2), schedule: round });
    let diagonals = task_for(cut(lopsided(spider(4))), hills(), [1.5, -0.6], 0.3);
    cases.push(Case { name: "diagonals".into(), schedule: gait(&mut random, 4, 3..=7), task: diagonals });
    cases
}

/// Finds the first pair that differs by more than `tolerance * max(1, |expected|)`; NaN differs from everything.
fn first_difference(got: &[f64], expected: &[f64], tolerance: f64) -> Option<usize> {
    assert_eq!(got.len(), expected.len());
    let close = |a: f64, b: f64| (a - b).abs() <= tolerance * b.abs().max(1.);
    got.iter().zip(expected).position(|(&a, &b)| !close(a, b))
}

fn assert_close(got: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    if let Some(i) = first_difference(got, expected, tolerance) {
        panic!("{what}, entry {i}: {:e} against {:e}, gap {:e}", got[i], expected[i], got[i] - expected[i]);
    }
}

fn in_scalar<T: Real>(values: &[f64]) -> Vec<T> {
    values.iter().map(|&v| T::of(v)).collect()
}

fn random_vector(seed: u64, len: usize) -> Vec<f64> {
    let mut random = Random::new(seed);
    (0..len).map(|_| random.between(-1., 1.)).collect()
}
