//! The factorisation, substitutions and products against dense linear algebra.

use super::solver::{State, states};
use super::{
    Case, DIFFERENCE_STEP, F32_BACKWARD_ERROR, F64_SOLVE_TOLERANCE, JACOBIAN_TOLERANCE, SUM_TOLERANCE, assert_close, cases, in_scalar,
    random_vector,
};
use crate::common::{
    Random, any_jacobian, dense_jacobian, families, frozen_at, gait, point, problem_with, rows, rows_with, task, transcriptions,
    with_any_rows,
};
use cregopt::gait::Schedule;
use cregopt::linear::NormalEquations;
use cregopt::linear::forward::forward;
use cregopt::linear::front::{Factor, factorise};
use cregopt::linear::product::jacobian_times;
use cregopt::linear::substitute::substitute;
use cregopt::linear::transposed::transposed_times;
use cregopt::nlp::Problem;
use cregopt::real::Real;
use cregopt::settings::TranscriptionSettings;
use cregopt::solver::advance::advance;
use nalgebra::{DMatrix, DVector};

/// Random weights with single-variable terms. Some weights are zero, with zero values.
struct RandomSystem {
    weight: Vec<f64>,
    value: Vec<f64>,
    diagonal: Vec<f64>,
    gradient: Vec<f64>,
}

impl RandomSystem {
    fn new<T: Real>(problem: &Problem<T>, random: &mut Random, zeros: f64, proximal: f64) -> RandomSystem {
        let weight: Vec<f64> =
            (0..problem.rows.all()).map(|_| if random.between(0., 1.) < zeros { 0. } else { random.between(0.01, 1.) }).collect();
        let value = weight.iter().map(|&w| if w == 0. { 0. } else { random.between(-1., 1.) }).collect();
        let diagonal = (0..problem.variables).map(|_| proximal * random.between(0.01, 10.)).collect();
        let gradient = (0..problem.variables).map(|_| random.between(-1., 1.)).collect();
        RandomSystem { weight, value, diagonal, gradient }
    }

    /// `E + J' W J` and `-(u + J' v)`.
    fn dense<T: Real>(&self, problem: &Problem<T>, jacobian: &[T]) -> (DMatrix<f64>, DVector<f64>) {
        let j = dense_jacobian(problem, jacobian);
        let mut matrix = DMatrix::from_diagonal(&DVector::from_vec(self.diagonal.clone()));
        for (row, &w) in j.row_iter().zip(&self.weight) {
            let entries: Vec<(usize, f64)> = row.iter().copied().enumerate().filter(|entry| entry.1 != 0.).collect();
            for &(a, left) in &entries {
                for &(b, right) in &entries {
                    matrix[(b, a)] += w * left * right;
                }
            }
        }
        (matrix, -(j.tr_mul(&DVector::from_vec(self.value.clone())) + DVector::from_vec(self.gradient.clone())))
    }

    /// The direction computed with the front; `None` if the matrix was not positive definite.
    fn solve<T: Real>(&self, problem: &Problem<T>, jacobian: &[T], factor: &mut Factor<T>) -> Option<DVector<f64>> {
        factor.resize(problem);
        let [weight, value, diagonal, gradient] =
            [&self.weight, &self.value, &self.diagonal, &self.gradient].map(|values| in_scalar::<T>(values));
        let (weight, value, diagonal, gradient) = (&weight, &value, &diagonal, &gradient);
        factorise(problem, &NormalEquations { jacobian, weight, value, diagonal, gradient }, factor).then(|| back(problem, factor))
    }
}

/// Back substitution.
fn back<T: Real>(problem: &Problem<T>, factor: &mut Factor<T>) -> DVector<f64> {
    let mut direction = vec![T::nan(); problem.variables];
    substitute(problem, factor, &mut direction);
    DVector::from_iterator(problem.variables, direction.iter().map(|d| d.as_f64()))
}

#[test]
fn the_front_solves_what_a_dense_cholesky_solves() {
    // One factor for all systems, so that leftovers of another problem are noticed.
    let (mut factor, mut factor_f32) = (Factor::default(), Factor::default());
    let mut problems: Vec<(Case, TranscriptionSettings)> = Vec::new();
    for own in families() {
        // Many reach instants in a step, and steps without any.
        let coarse = TranscriptionSettings { interval: Some(0.3), reach_interval: 0.02, force_pieces: Some(4), ..own.clone() };
        let fine = TranscriptionSettings { interval: Some(0.05), reach_interval: 0.11, force_pieces: Some(2), ..own.clone() };
        for (i, case) in cases().into_iter().enumerate() {
            let mut random = Random::new(i as u64);
            let schedule = gait(&mut random, case.task.robot.feet(), if i % 2 == 0 { 3..=7 } else { 1..=3 });
            problems.push((Case { schedule, ..case }, [own.clone(), coarse.clone(), fine.clone()][i % 3].clone()));
        }
        // One interval: only one coefficient of the base is free, or none.
        let short = Schedule::new(vec![vec![0.08]; 4]).unwrap();
        let case = Case { name: "short".into(), task: task("anymal", "flat", [0., 0.], 0.), schedule: short };
        problems.push((case, own));
    }
    for (seed, (case, settings)) in problems.iter().enumerate() {
        let mut random = Random::new(seed as u64);
        let problem = problem_with::<f64>(&case.task, &case.schedule, settings);
        let layout_f32 = problem_with::<f32>(&case.task, &case.schedule, settings);
        let x = point(&problem, &mut random, 0.);
        let jacobian = rows(&problem, &x, 0.).jacobian;
        let jacobian_f32 = rows(&layout_f32, &in_scalar(&x), 0.).jacobian;
        for (zeros, proximal) in [(0., 1e-3), (0.4, 1e-3), (1., 1.)] {
            let what = format!("{}, {}, {zeros} of the weights zero", case.name, settings.rows.name());
            let system = RandomSystem::new(&problem, &mut random, zeros, proximal);
            // A second right-hand side for the same matrix.
            let other: Vec<f64> = (0..problem.variables).map(|_| random.between(-1., 1.)).collect();
            let other_rhs = -DVector::from_vec(other.clone());

            let (matrix, rhs) = system.dense(&problem, &jacobian);
            let dense = matrix.clone().cholesky().unwrap();
            let direction = system.solve(&problem, &jacobian, &mut factor).unwrap();
            forward(&problem, &mut factor, &mut other.clone());
            let replaced = back(&problem, &mut factor);
            for (direction, rhs) in [(&direction, &rhs), (&replaced, &other_rhs)] {
                let exact = dense.solve(rhs);
                let error = (direction - &exact).norm();
                assert!(error <= F64_SOLVE_TOLERANCE * exact.norm(), "{what}, f64: error {error:e} of {:e}", exact.norm());
            }

            let (matrix, rhs) = system.dense(&layout_f32, &jacobian_f32);
            let direction = system.solve(&layout_f32, &jacobian_f32, &mut factor_f32).unwrap();
            forward(&layout_f32, &mut factor_f32, &mut in_scalar(&other));
            let replaced = back(&layout_f32, &mut factor_f32);
            for (direction, rhs) in [(&direction, &rhs), (&replaced, &other_rhs)] {
                let (residual, size) = ((&matrix * direction - rhs).norm(), matrix.norm() * direction.norm() + rhs.norm());
                assert!(residual <= F32_BACKWARD_ERROR * size, "{what}, f32: backward error {:e}", residual / size);
                assert!(direction.norm() > 0., "{what}");
            }
        }
    }
}

#[test]
fn the_front_takes_elements_of_any_number_of_rows() {
    fn check<T: Real>(random: &mut Random, holds: impl Fn(&DMatrix<f64>, &DVector<f64>, &DVector<f64>) -> bool) {
        let mut factor = Factor::default();
        for (case, settings) in cases().iter().flat_map(|case| families().map(|settings| (case, settings))) {
            let schedule = gait(random, case.task.robot.feet(), 2..=4);
            let mut problem = problem_with::<T>(&case.task, &schedule, &settings);
            with_any_rows(&mut problem);
            let x: Vec<T> = in_scalar(&point(&problem_with(&case.task, &schedule, &settings), random, 0.));
            let jacobian = any_jacobian(&problem, &x, random);
            for zeros in [0., 0.4] {
                let system = RandomSystem::new(&problem, random, zeros, 1e-3);
                let (matrix, rhs) = system.dense(&problem, &jacobian);
                let direction = system.solve(&problem, &jacobian, &mut factor).unwrap();
                assert!(holds(&matrix, &rhs, &direction), "{}, {}, {zeros} of the weights zero", case.name, settings.rows.name());
            }
        }
    }
    check::<f64>(&mut Random::new(23), |matrix, rhs, direction| {
        let exact = matrix.clone().cholesky().unwrap().solve(rhs);
        (direction - &exact).norm() <= F64_SOLVE_TOLERANCE * exact.norm()
    });
    check::<f32>(&mut Random::new(24), |matrix, rhs, direction| {
        (matrix * direction - rhs).norm() <= F32_BACKWARD_ERROR * (matrix.norm() * direction.norm() + rhs.norm())
    });
}

#[test]
fn a_system_that_is_not_positive_definite_is_refused() {
    let case = &cases()[0];
    for settings in transcriptions() {
        let problem = problem_with::<f64>(&case.task, &case.schedule, &settings);
        let mut random = Random::new(3);
        let x = point(&problem, &mut random, 0.);
        let jacobian = rows(&problem, &x, 0.).jacobian;
        let mut factor = Factor::default();
        let mut solves = |system: &RandomSystem| system.solve(&problem, &jacobian, &mut factor).is_some();
        let system = |random: &mut Random, zeros, proximal| RandomSystem::new(&problem, random, zeros, proximal);
        assert!(solves(&system(&mut random, 0., 1e-3)));
        assert!(!solves(&system(&mut random, 1., 0.)), "a zero matrix");
        assert!(!solves(&system(&mut random, 0., -10.)), "a negative diagonal");
        for (at, bad) in [(0, -1e3), (problem.variables / 2, -1e3), (problem.variables - 1, -1e3), (problem.variables - 1, f64::NAN)] {
            let mut spoilt = system(&mut random, 0., 1e-3);
            spoilt.diagonal[at] = bad;
            assert!(!solves(&spoilt), "diagonal {at} is {bad}");
        }
        assert!(solves(&system(&mut random, 0., 1e-3)), "a refusal leaves nothing behind");
    }
}

#[test]
fn jacobian_products_are_derivatives_along_the_direction() {
    for State { problem, rows, x, .. } in states() {
        let direction = random_vector(12, problem.variables);
        let (mut by_c, mut by_g) = (vec![f64::NAN; problem.rows.one_sided()], vec![f64::NAN; problem.inequalities]);
        jacobian_times(&problem, &rows.jacobian, &direction, &mut vec![0.; problem.widest], &mut by_c, &mut by_g);
        // Along a straight line, both sides of every inequality.
        let moved = |by: f64| {
            let mut moved = x.clone();
            advance(&x[..problem.variables], by, &direction, &mut moved[..problem.variables]);
            rows_with(&problem, &moved, 0., &mut frozen_at(&problem, &x, 0.))
        };
        let (ahead, behind) = (moved(DIFFERENCE_STEP), moved(-DIFFERENCE_STEP));
        let quotient = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| (a - b) / (2. * DIFFERENCE_STEP)).collect() };
        assert_close(&by_c, &quotient(&ahead.c, &behind.c), JACOBIAN_TOLERANCE, "equalities");
        assert_close(&by_g, &quotient(&ahead.g, &behind.g), JACOBIAN_TOLERANCE, "inequalities");
    }
}

#[test]
fn transposed_products_are_those_of_the_dense_jacobian() {
    for State { problem, rows, .. } in states() {
        let v = random_vector(14, problem.rows.all());
        // Leftovers in either buffer must not affect the result.
        let (mut product, mut local) = (vec![f64::NAN; problem.variables], vec![f64::NAN; problem.widest]);
        transposed_times(&problem, &rows.jacobian, &v, &mut local, &mut product);
        let expected = dense_jacobian(&problem, &rows.jacobian).tr_mul(&DVector::from_vec(v));
        assert_close(&product, expected.as_slice(), SUM_TOLERANCE, "product");
    }
}
