//! Steps of the solver against their plain formulas.

use super::{ELEMENTWISE_TOLERANCE, F32_FALL_ERROR, SUM_TOLERANCE, assert_close, cases, in_scalar, random_vector};
use crate::common::{Random, Rows, dense_inequalities, dense_jacobian, gait, point, problem_with, rows, transcriptions};
use cregopt::linear::simd::BLOCK;
use cregopt::nlp::Problem;
use cregopt::real::Real;
use cregopt::rows::table::NONE;
use cregopt::settings::{Transcription, TranscriptionSettings};
use cregopt::solver::judge::{infeasibility, infeasibility_fall, merit_falls, nonlinearity, smoothing_fall, update_slacks};
use cregopt::solver::slacks::{BarrierTarget, Lengths, Slacks, mean_product, slack_steps, target};
use cregopt::solver::start::{column_scaling, start_slacks};
use cregopt::solver::weights::{barrier_rows, closing_reach, closing_rows, variable_terms};
use nalgebra::DVector;

/// Random solver state on the second case: rows, slacks and multipliers around 1, some small; steps of a predictor.
pub struct State {
    pub problem: Problem<f64>,
    pub rows: Rows<f64>,
    pub slacks: Slacks<f64>,
    pub x: Vec<f64>,
}

fn state(settings: &TranscriptionSettings) -> State {
    let case = &cases()[1];
    let mut random = Random::new(11);
    let problem = problem_with::<f64>(&case.task, &gait(&mut random, 4, 3..=5), settings);
    let x = point(&problem, &mut random, 0.);
    let rows = rows(&problem, &x, 0.);
    let mut positive = || (0..problem.inequalities).map(|_| random.between(-6., 1.).exp()).collect::<Vec<f64>>();
    let (slack, multiplier) = (positive(), positive());
    let mut part_of = |values: &[f64]| values.iter().map(|v| v * random.between(-1., 1.)).collect::<Vec<f64>>();
    let (slack_step, multiplier_step) = (part_of(&slack), part_of(&multiplier));
    State { rows, slacks: Slacks { slack, multiplier, slack_step, multiplier_step }, problem, x }
}

pub fn states() -> [State; 3] {
    transcriptions().map(|settings| state(&settings))
}

/// Barrier parameter of the elementwise tests.
const MU: f64 = 0.03;

/// Aims of a predictor, of a plain barrier step, and of a corrected step.
const AIMS: [BarrierTarget<f64>; 3] =
    [BarrierTarget { mu: 0., correction: 0. }, BarrierTarget { mu: MU, correction: 0. }, BarrierTarget { mu: MU, correction: 0.7 }];

#[test]
fn terms_of_single_variables_are_their_plain_formulas() {
    let (proximal, weight) = (0.02, 0.3);
    for State { problem, x, .. } in states() {
        let n = problem.variables;
        let positive = |seed| random_vector(seed, n).iter().map(|v| v + 1.5).collect::<Vec<f64>>();
        let (scaling, smoothing) = (positive(15), positive(16));
        let (mut diagonal, mut gradient) = (vec![f64::NAN; n], vec![f64::NAN; n]);
        let smoothed = Problem { smoothing: smoothing.clone(), ..problem.clone() };
        variable_terms(&smoothed, &scaling, proximal, weight, &x, &mut diagonal, &mut gradient);
        let of_each = |term: &dyn Fn(usize) -> f64| (0..n).map(term).collect::<Vec<f64>>();
        let expected = of_each(&|i| proximal * scaling[i] + weight * smoothing[i]);
        assert_close(&diagonal, &expected, ELEMENTWISE_TOLERANCE, "diagonal");
        let expected = of_each(&|i| weight * smoothing[i] * (x[i] - problem.initial[i]));
        assert_close(&gradient, &expected, ELEMENTWISE_TOLERANCE, "gradient");

        // Forces, attitudes and rates are smoothed in `momentum` only.
        let mut expected = vec![0.; n];
        if problem.curves.transcription == Transcription::Momentum {
            for &node in problem.curves.feet.iter().flat_map(|f| &f.force_nodes).flatten().filter(|&&node| node != NONE) {
                expected[node as usize..node as usize + 6].fill(1.);
            }
            for (i, &block) in problem.curves.base.iter().enumerate().filter(|(_, block)| (**block as usize) < n) {
                let smoothing = if i % 2 == 0 { [0., 0., 0., 1., 1., 1.] } else { [0.1; 6] };
                expected[block as usize..block as usize + 6].copy_from_slice(&smoothing);
            }
        }
        assert_eq!(problem.smoothing, expected);
    }
}

#[test]
fn row_weights_are_those_of_the_full_system() {
    for State { problem, rows, slacks, .. } in states() {
        let (jc, jg) = (
            dense_jacobian(&problem, &rows.jacobian).rows(0, problem.rows.equalities as usize).into_owned(),
            dense_inequalities(&problem, &rows.jacobian),
        );
        let j = dense_jacobian(&problem, &rows.jacobian);
        let c = DVector::from_column_slice(&rows.c);
        let mut g = rows.g.clone();
        g.iter_mut().step_by(5).for_each(|g| *g = -2e-5);
        g.iter_mut().skip(1).step_by(5).for_each(|g| *g = -4e-5);
        let g = &g;
        let inequality = |i: usize, aim: Option<BarrierTarget<f64>>| {
            let (s, z) = (slacks.slack[i], slacks.multiplier[i]);
            let w = 1. / (s / z + 1.);
            match aim {
                Some(aim) => {
                    let product = aim.mu - aim.correction * slacks.slack_step[i] * slacks.multiplier_step[i];
                    (w, z + w * (g[i] - z + product / z))
                }
                None if g[i] > 0. => (1., g[i]),
                None if g[i] > -3e-5 => (1., 0.),
                None => (0., 0.),
            }
        };
        for aim in AIMS.map(Some).into_iter().chain([None]) {
            let (mut weight, mut value) = (vec![f64::NAN; problem.rows.all()], vec![f64::NAN; problem.rows.all()]);
            match aim {
                Some(aim) => barrier_rows(&problem, &rows.c, g, &slacks, aim, &mut weight, &mut value),
                None => closing_rows(&problem, &rows.c, g, closing_reach(CLOSE_BY, 0), &mut weight, &mut value),
            }
            // J' W J e and J' v over all rows, against one weight for both sides of a row.
            let probe = DVector::from_fn(problem.variables, |i, _| ((i * 7919) % 13) as f64 / 13. - 0.4);
            let (by_c, mut by_g) = (&jc * &probe, &jg * &probe);
            let mut v = DVector::zeros(problem.inequalities);
            for i in 0..problem.inequalities {
                let (w, value) = inequality(i, aim);
                by_g[i] *= w;
                v[i] = value;
            }
            let product = jc.tr_mul(&by_c) + jg.tr_mul(&by_g);
            let gradient = jc.tr_mul(&c) + jg.tr_mul(&v);
            let weighted = (&j * &probe).component_mul(&DVector::from_vec(weight));
            assert_close(j.tr_mul(&weighted).as_slice(), product.as_slice(), SUM_TOLERANCE, "matrix");
            assert_close(j.tr_mul(&DVector::from_vec(value)).as_slice(), gradient.as_slice(), SUM_TOLERANCE, "right-hand side");
        }
    }
}

#[test]
fn closing_steps_reach_farther_after_refused_attempts() {
    let close = |infeasibility: f64, attempts, expected: f64| {
        let got = closing_reach(infeasibility, attempts);
        assert!((got - expected).abs() <= ELEMENTWISE_TOLERANCE * expected, "{got:e} against {expected:e}");
    };
    close(CLOSE_BY, 0, 3e-5);
    close(CLOSE_BY, 3, 3e-5 * 64.);
    close(1., 0, 1e-4);
    close(1., 4, 1e-4 * 256.);
}

#[test]
fn columns_are_scaled_by_their_squares() {
    for State { problem, rows, .. } in states() {
        let (j, jg) = (dense_jacobian(&problem, &rows.jacobian), dense_inequalities(&problem, &rows.jacobian));
        let mut diagonal = vec![f64::NAN; problem.variables];
        let (mut counts, mut local) = (vec![0.; problem.rows.all()], vec![0.; problem.widest]);
        column_scaling(&problem, &rows.jacobian, &mut counts, &mut local, &mut diagonal);
        let formula = |i: usize| {
            let equalities = j.column(i).rows(0, problem.rows.equalities as usize).norm_squared();
            (equalities + 0.5 * jg.column(i).norm_squared()).max(1e-2)
        };
        let expected: Vec<f64> = (0..problem.variables).map(formula).collect();
        assert_close(&diagonal, &expected, SUM_TOLERANCE, "diagonal");
    }
}

fn half_square(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>() / 2.
}

/// Terms of the infeasibility.
fn infeasibility_terms(c: &[f64], g: &[f64]) -> Vec<f64> {
    c.iter().copied().chain(g.iter().map(|g| g.max(0.))).map(|v| v * v / 2.).collect()
}

/// Terms of the merit with each slack `factor` times the best one, for which `s (g + s) = mu`.
fn merit_terms(c: &[f64], g: &[f64], mu: f64, factor: f64) -> Vec<f64> {
    let of_row = |g: f64| {
        let best = ((g * g + 4. * mu).sqrt() - g) / 2.;
        assert!((best * (g + best) - mu).abs() <= 1e-9 * (g * g + mu));
        let s = factor * best;
        (g + s).powi(2) / 2. - mu * s.ln()
    };
    c.iter().map(|c| c * c / 2.).chain(g.iter().map(|&g| of_row(g))).collect()
}

/// Terms of the cost of deviations from the initial values.
fn smoothing_terms(smoothing: &[f64], x: &[f64], initial: &[f64]) -> Vec<f64> {
    smoothing.iter().zip(x.iter().zip(initial)).map(|(smoothing, (x, initial))| smoothing * (x - initial).powi(2) / 2.).collect()
}

/// Compares a fall with the difference of two sums.
fn assert_falls(got: f64, from: &[f64], to: &[f64], tolerance: f64, what: &str) {
    let [sum, sum_to] = [from, to].map(|terms| terms.iter().sum::<f64>());
    let (gap, size) = (got - (sum - sum_to), sum.abs().max(sum_to.abs()).max(1.));
    assert!(gap.abs() <= tolerance * size, "{what}: {got:e} against {:e}, gap {gap:e} of {size:e}", sum - sum_to);
}

/// Error of a fall relative to the difference of two sums, in units of the error that f32 may have.
///
/// * `rounded` - terms that are rounded before their difference is taken
fn f32_error(got: f32, from: &[f64], to: &[f64], rounded: &[f64]) -> f64 {
    let falls: Vec<f64> = from.iter().zip(to).map(|(from, to)| from - to).collect();
    let size = falls.iter().map(|fall| fall.abs()).sum::<f64>() + rounded.iter().map(|v| v * v).sum::<f64>().sqrt();
    (f64::from(got) - falls.iter().sum::<f64>()).abs() / (F32_FALL_ERROR * size)
}

/// Error of the difference of two f32 sums, in the same units.
fn f32_error_of_sums(from: &[f64], to: &[f64], rounded: &[f64]) -> f64 {
    let [sum, sum_to] = [from, to].map(|terms| terms.iter().map(|&v| v as f32).sum::<f32>());
    f32_error(sum - sum_to, from, to, rounded)
}

/// Values in f32, and the same values in f64.
fn narrow(values: &[f64]) -> (Vec<f32>, Vec<f64>) {
    let narrow = in_scalar::<f32>(values);
    let wide = narrow.iter().map(|&v| v.into()).collect();
    (narrow, wide)
}

/// Values near others, on average smaller by a share of `away`.
fn near(values: &[f64], random: &mut Random, away: f64) -> Vec<f64> {
    values.iter().map(|v| v * (1. - random.between(-0.5 * away, away))).collect()
}

/// Residuals of a state and of one that follows it: some rows hold in one of them only.
fn residuals_from_and_to(Rows { c, g, .. }: &Rows<f64>) -> [(Vec<f64>, Vec<f64>); 2] {
    let moved = |values: &[f64], seed| -> Vec<f64> {
        let moves = random_vector(seed, values.len());
        values.iter().zip(moves).map(|(value, by)| 0.6 * value + by).collect()
    };
    let (c_to, g_to) = (moved(c, 17), moved(g, 18));
    assert!(g.iter().zip(&g_to).any(|(g, to)| *g > 0. && *to < 0.) && g.iter().zip(&g_to).any(|(g, to)| *g < 0. && *to > 0.));
    [(c.clone(), g.clone()), (c_to, g_to)]
}

/// Barrier parameters at the end of a solve, in the middle, and far above.
const MUS: [f64; 3] = [1e-6, MU, 2.];

#[test]
fn infeasibility_and_nonlinearity_are_their_plain_formulas() {
    for State { rows: Rows { c, g, .. }, .. } in states() {
        let violated: Vec<f64> = g.iter().map(|g| g.max(0.)).collect();
        assert_close(&[infeasibility(&c, &g)], &[half_square(&c) + half_square(&violated)], SUM_TOLERANCE, "infeasibility");
        let far: Vec<f64> = c.iter().map(|c| c + 0.1).collect();
        let further: Vec<f64> = g.iter().map(|g| g - 0.2).collect();
        let gap = (0.01 * c.len() as f64 + 0.04 * g.len() as f64) / 2.;
        assert_close(&[nonlinearity(&far, &c, &further, &g)], &[gap], SUM_TOLERANCE, "nonlinearity");
    }
}

#[test]
fn non_finite_residuals_show_in_every_sum() {
    // More inequalities than are processed at once.
    let (c, g) = (vec![0.1; 13], vec![-0.2; 2 * BLOCK + 21]);
    let spoilt = |values: &[f64], at: usize| {
        let mut values = values.to_vec();
        values[at] = f64::NAN;
        values
    };
    let by_c = (0..c.len()).map(|at| (spoilt(&c, at), g.clone()));
    let by_g = (0..g.len()).map(|at| (c.clone(), spoilt(&g, at)));
    for (bad_c, bad_g) in by_c.chain(by_g) {
        assert!(infeasibility(&bad_c, &bad_g).is_nan());
        assert!(infeasibility_fall(&c, &g, &bad_c, &bad_g).is_nan());
        let [fall, other] = merit_falls(&c, &g, [(&bad_c, &bad_g), (&c, &g)], MU);
        assert!(fall.is_nan() && other == 0.);
        assert!(nonlinearity(&bad_c, &c, &bad_g, &g).is_nan());
    }
}

#[test]
fn falls_are_differences_of_the_plain_formulas() {
    for State { rows, .. } in states() {
        let [(c, g), (c_to, g_to)] = residuals_from_and_to(&rows);
        let (from, to) = (infeasibility_terms(&c, &g), infeasibility_terms(&c_to, &g_to));
        assert_falls(infeasibility_fall(&c, &g, &c_to, &g_to), &from, &to, SUM_TOLERANCE, "infeasibility");
        assert_falls(infeasibility_fall(&c_to, &g_to, &c, &g), &to, &from, SUM_TOLERANCE, "infeasibility, back");
        assert_eq!(infeasibility_fall(&c, &g, &c, &g), 0.);
        for mu in MUS {
            let (from, to) = (merit_terms(&c, &g, mu, 1.), merit_terms(&c_to, &g_to, mu, 1.));
            let [there, none] = merit_falls(&c, &g, [(&c_to, &g_to), (&c, &g)], mu);
            assert_falls(there, &from, &to, SUM_TOLERANCE, "merit");
            assert_eq!(none, 0.);
            let [none, back] = merit_falls(&c_to, &g_to, [(&c_to, &g_to), (&c, &g)], mu);
            assert_falls(back, &to, &from, SUM_TOLERANCE, "merit, back");
            assert_eq!(none, 0.);
            // No other slack is better.
            let with = |factor: f64| merit_terms(&c, &g, mu, factor).iter().sum::<f64>();
            assert!(with(1.01) > with(1.) && with(0.99) > with(1.));
        }
    }
}

#[test]
fn falls_to_a_point_nearby_are_good_in_f32() {
    let mut random = Random::new(19);
    // Differences of sums are less accurate; otherwise this test would prove nothing.
    let mut worst_of_sums = [0_f64; 2];
    for State { rows: Rows { c, g, .. }, .. } in states() {
        for (size, away) in [1., 1e-3].into_iter().flat_map(|size| [1e-2, 1e-4, 1e-6].map(|away| (size, away))) {
            // Equalities and violated rows go to zero together.
            let scaled = |values: &[f64]| values.iter().map(|v| if *v > 0. { size * v } else { *v }).collect::<Vec<f64>>();
            let c: Vec<f64> = c.iter().map(|c| size * c).collect();
            let ((c, wide_c), (g, wide_g)) = (narrow(&c), narrow(&scaled(&g)));
            let [(c_to, wide_c_to), (g_to, wide_g_to)] = [&wide_c, &wide_g].map(|values| narrow(&near(values, &mut random, away)));
            let (from, to) = (infeasibility_terms(&wide_c, &wide_g), infeasibility_terms(&wide_c_to, &wide_g_to));
            let error = f32_error(infeasibility_fall(&c, &g, &c_to, &g_to), &from, &to, &[]);
            assert!(error <= 1., "infeasibility, {size} of it, {away} away: {error}");
            worst_of_sums[0] = worst_of_sums[0].max(f32_error_of_sums(&from, &to, &[]));
            for mu in MUS {
                let mu = mu as f32;
                let (from, to) = (merit_terms(&wide_c, &wide_g, mu.into(), 1.), merit_terms(&wide_c_to, &wide_g_to, mu.into(), 1.));
                let [fall, _] = merit_falls(&c, &g, [(&c_to, &g_to), (&c, &g)], mu);
                let error = f32_error(fall, &from, &to, &from);
                assert!(error <= 1., "merit, mu = {mu}, {size} of it, {away} away: {error}");
                worst_of_sums[1] = worst_of_sums[1].max(f32_error_of_sums(&from, &to, &from));
            }
        }
    }
    assert!(worst_of_sums.iter().all(|worst| *worst > 10.), "{worst_of_sums:?}");
}

#[test]
fn the_cost_of_the_smoothing_falls_by_its_plain_formula() {
    for State { problem, x, .. } in states() {
        let n = problem.variables;
        let smoothing: Vec<f64> = random_vector(16, n).iter().map(|v| v + 1.5).collect();
        let (initial, x) = (&problem.initial[..n], &x[..n]);
        let x_to: Vec<f64> = x.iter().zip(random_vector(20, n)).map(|(x, by)| x + 0.3 * by).collect();
        let (from, to) = (smoothing_terms(&smoothing, x, initial), smoothing_terms(&smoothing, &x_to, initial));
        assert!(from.iter().sum::<f64>() > 1.);
        assert_falls(smoothing_fall(&smoothing, x, &x_to, initial), &from, &to, SUM_TOLERANCE, "cost");
        assert_falls(smoothing_fall(&smoothing, &x_to, x, initial), &to, &from, SUM_TOLERANCE, "cost, back");
        // Deviations from the initial values are not costed.
        assert_falls(smoothing_fall(&smoothing, x, initial, initial), &from, &[], SUM_TOLERANCE, "whole cost");
        assert_eq!(smoothing_fall(&smoothing, x, x, initial), 0.);

        let mut random = Random::new(21);
        for away in [1e-2, 1e-4, 1e-6] {
            let [(smoothing, wide_smoothing), (initial, wide_initial), (x, wide_x)] = [&smoothing, initial, x].map(narrow);
            let (x_to, wide_x_to) = narrow(&near(&wide_x, &mut random, away));
            let (from, to) =
                (smoothing_terms(&wide_smoothing, &wide_x, &wide_initial), smoothing_terms(&wide_smoothing, &wide_x_to, &wide_initial));
            let error = f32_error(smoothing_fall(&smoothing, &x, &x_to, &initial), &from, &to, &from);
            assert!(error <= 1., "{away} away: {error}");
        }
    }
}

#[test]
fn slacks_start_where_their_products_are_the_barrier_parameter() {
    fn check<T: Real>(g: &[f64], tolerance: f64) {
        for mu in [1e-3, 0.05, 2.] {
            let g: Vec<T> = in_scalar(g);
            let unset = || vec![T::nan(); g.len()];
            let mut slacks = Slacks { slack: unset(), multiplier: unset(), slack_step: unset(), multiplier_step: unset() };
            start_slacks(&g, T::of(mu), &mut slacks);
            for ((g, s), z) in g.iter().zip(&slacks.slack).zip(&slacks.multiplier) {
                let expected = g.abs().as_f64().max(mu.sqrt());
                assert!((s.as_f64() - expected).abs() <= tolerance * expected, "slack {s:?} at {g:?}");
                assert!((z.as_f64() * expected - mu).abs() <= tolerance * mu, "multiplier {z:?} at {g:?}");
            }
        }
    }
    for State { rows: Rows { g, .. }, .. } in states() {
        assert!(g.iter().any(|g| g.abs() < 0.01) && g.iter().any(|g| *g > 1.) && g.iter().any(|g| *g < -1.));
        check::<f64>(&g, ELEMENTWISE_TOLERANCE);
        check::<f32>(&g, 4. * f64::from(f32::EPSILON));
    }
    let mut slacks = Slacks { slack: vec![0.; 3], multiplier: vec![0.; 3], ..Slacks::default() };
    start_slacks(&[-0.5, 0.02, 0.25], 0.01, &mut slacks);
    assert_close(&slacks.slack, &[0.5, 0.1, 0.25], ELEMENTWISE_TOLERANCE, "slack");
    assert_close(&slacks.multiplier, &[0.02, 0.1, 0.04], ELEMENTWISE_TOLERANCE, "multiplier");
}

/// Infeasibility of closing steps: inequalities take part from -3e-5 on.
const CLOSE_BY: f64 = 1e-10;

/// Floor of the target.
const FLOOR: f64 = 1e-9;

#[test]
fn the_target_is_the_square_of_what_the_predictor_leaves() {
    for State { mut slacks, .. } in states() {
        let mean = |slacks: &Slacks<f64>, reach: Lengths<f64>| {
            let slack = |i: usize| slacks.slack[i] + reach.primal * slacks.slack_step[i];
            let multiplier = |i: usize| slacks.multiplier[i] + reach.dual * slacks.multiplier_step[i];
            (0..slacks.slack.len()).map(|i| slack(i) * multiplier(i)).sum::<f64>() / slacks.slack.len() as f64
        };
        let close = |slacks: &Slacks<f64>, reach: Lengths<f64>, expected: f64| {
            let got = target(slacks, reach, FLOOR);
            assert!((got - expected).abs() <= SUM_TOLERANCE * expected, "reach {reach:?}: {got:e} against {expected:e}");
        };
        let whole = Lengths::whole();
        let before = mean(&slacks, Lengths::none());
        close(&slacks, Lengths::none(), before);
        // All slacks lose nine tenths, and the multipliers nothing.
        slacks.slack_step = slacks.slack.iter().map(|s| -0.9 * s).collect();
        slacks.multiplier_step.fill(0.);
        close(&slacks, whole, before / 100.);
        close(&slacks, Lengths { dual: 0.2, ..whole }, before / 100.);
        // Some of both.
        slacks.multiplier_step = slacks.multiplier.iter().zip(random_vector(22, slacks.slack.len())).map(|(z, by)| 0.5 * z * by).collect();
        for (primal, dual) in [(0.1, 0.1), (0.6, 0.3), (0.2, 0.9), (1., 1.)] {
            let reach = Lengths { primal, dual };
            let after = mean(&slacks, reach);
            assert!(after > 0. && after < before);
            close(&slacks, reach, after * after / before);
        }
        // The target does not rise above the present value nor fall below its floor, not even where products become negative.
        slacks.slack_step = slacks.slack.clone();
        close(&slacks, whole, before);
        slacks.multiplier_step.fill(0.);
        for part in [1., 1.5] {
            slacks.slack_step = slacks.slack.iter().map(|s| -part * s).collect();
            assert_eq!([FLOOR, 1e-7].map(|floor| target(&slacks, whole, floor)), [FLOOR, 1e-7]);
        }
    }
}

#[test]
fn slack_steps_solve_the_linearised_conditions_and_keep_a_hundredth() {
    for settings in transcriptions() {
        for (aim, size) in AIMS.into_iter().flat_map(|aim| [1., 1e-3].map(|size| (aim, size))) {
            let State { problem, rows: Rows { g, .. }, mut slacks, .. } = state(&settings);
            let mut random = Random::new(13);
            let change: Vec<f64> = (0..problem.inequalities).map(|_| size * random.between(-1., 1.)).collect();
            let predicted = (slacks.slack_step.clone(), slacks.multiplier_step.clone());
            let lengths = slack_steps(&g, &change, aim, &mut slacks);
            let mut largest = [f64::INFINITY; 2];
            for i in 0..problem.inequalities {
                let (s, z, ds, dz) = (slacks.slack[i], slacks.multiplier[i], slacks.slack_step[i], slacks.multiplier_step[i]);
                let second_order = aim.correction * predicted.0[i] * predicted.1[i];
                // z = g + s with penalty 1, to first order; s z = mu, corrected by the predictor's steps.
                let (penalty, centre) = (g[i] + change[i] + s + ds - z - dz, s * z + s * dz + z * ds - aim.mu + second_order);
                let sizes =
                    [g[i].abs() + s + ds.abs() + z + dz.abs(), s * z + (s * dz).abs() + (z * ds).abs() + aim.mu + second_order.abs()];
                assert!(penalty.abs() <= ELEMENTWISE_TOLERANCE * sizes[0], "inequality {i}: {penalty:e}");
                assert!(centre.abs() <= ELEMENTWISE_TOLERANCE * sizes[1], "inequality {i}: {centre:e}");
                for (largest, (value, change)) in largest.iter_mut().zip([(s, ds), (z, dz)]) {
                    if change < 0. {
                        *largest = largest.min(-value / change);
                    }
                }
            }
            let expected = largest.map(|largest| (0.99 * largest).min(1.));
            assert_close(&[lengths.primal, lengths.dual], &expected, SUM_TOLERANCE, "lengths");

            let before = (slacks.slack.clone(), slacks.multiplier.clone());
            let after = |step: Lengths<f64>, i: usize| {
                (before.0[i] + step.primal * slacks.slack_step[i], before.1[i] + step.dual * slacks.multiplier_step[i])
            };
            let mean = |step: Lengths<f64>| {
                let products = (0..problem.inequalities).map(|i| after(step, i)).map(|(s, z)| s * z);
                products.sum::<f64>() / problem.inequalities as f64
            };
            for ahead in [Lengths::none(), Lengths { primal: 0.3 * lengths.primal, ..lengths }, lengths] {
                assert_close(&[mean_product(&slacks, ahead)], &[mean(ahead)], SUM_TOLERANCE, "mean product ahead");
            }
            let expected: Vec<(f64, f64)> = (0..problem.inequalities).map(|i| after(lengths, i)).collect();
            update_slacks(&mut slacks, lengths);
            for (i, (s, z)) in expected.into_iter().enumerate() {
                assert_eq!((slacks.slack[i], slacks.multiplier[i]), (s.max(1e-6), z.max(1e-8)));
                assert!(s >= 0.0099 * before.0[i] && z >= 0.0099 * before.1[i]);
            }
        }
    }
}

#[test]
fn slacks_and_multipliers_stay_off_zero() {
    let mut slacks = Slacks { slack: vec![1., 2.], multiplier: vec![3., 4.], slack_step: vec![-1., 0.5], multiplier_step: vec![1., -4.] };
    update_slacks(&mut slacks, Lengths { primal: 0.5, dual: 0.25 });
    assert_eq!((&slacks.slack, &slacks.multiplier), (&vec![0.5, 2.25], &vec![3.25, 3.]));
    update_slacks(&mut slacks, Lengths::whole());
    assert_eq!((&slacks.slack, &slacks.multiplier), (&vec![1e-6, 2.75], &vec![4.25, 1e-8]));
    // Values at the floor leave it when they grow.
    (slacks.slack_step, slacks.multiplier_step) = (vec![0.25, 0.], vec![0., 0.5]);
    update_slacks(&mut slacks, Lengths::whole());
    assert_eq!((slacks.slack, slacks.multiplier), (vec![0.250_001, 2.75], vec![4.25, 0.500_000_01]));
}
