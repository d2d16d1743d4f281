//! Initialisation of a solve: column scaling, slacks and multipliers.

use super::judge::smoothed;
use super::slacks::{MULTIPLIER_FLOOR, SLACK_FLOOR, Slacks};
use crate::linear::transposed::transposed_squares_times;
use crate::nlp::Problem;
use crate::real::Real;
use crate::rows::RowKind;
use multiversion::multiversion;

/// Smallest column scaling.
pub const SCALING_FLOOR: f64 = 1e-2;

/// Column scaling `D_j = sum_eq J_ij^2 + 1/2 sum_ineq J_ij^2`, at least [`SCALING_FLOOR`].
///
/// * `counts` - scratch, `[rows]`
/// * `local` - scratch, `[widest]`
pub fn column_scaling<T: Real>(problem: &Problem<T>, jacobian: &[T], counts: &mut [T], local: &mut [T], diagonal: &mut [T]) {
    counts.fill(T::one());
    counts[problem.rows.of(RowKind::Cost)].fill(T::zero());
    for element in problem.all_elements().filter(|e| problem.rows.kind(e.place.row) == RowKind::Inequality) {
        // A two-sided row stands for two inequalities, so only one-sided rows get the factor 1/2.
        let row = element.place.row as usize;
        counts[row + element.pairs as usize..row + element.rows as usize].fill(T::of(0.5));
    }
    transposed_squares_times(problem, jacobian, counts, local, diagonal);
    for d in diagonal {
        *d = d.max(T::of(SCALING_FLOOR));
    }
}

/// Initial slacks `max(|g|, sqrt(mu))` and multipliers `mu / s`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn start_slacks<T: Real>(g: &[T], mu: T, slacks: &mut Slacks<T>) {
    let least = mu.sqrt();
    for i in 0..g.len() {
        let s = g[i].abs().max(least);
        slacks.slack[i] = s;
        slacks.multiplier[i] = mu / s;
    }
}

/// Slacks and multipliers of a solve that is resumed, from residuals that are shifted by the multipliers of the point before: the
/// smoothed `max(-g, 0)` and `max(g, 0)`, whose product is `mu`.
pub fn resume_slacks<T: Real>(g: &[T], mu: T, slacks: &mut Slacks<T>) {
    for ((g, slack), multiplier) in g.iter().zip(&mut slacks.slack).zip(&mut slacks.multiplier) {
        let [z, s] = smoothed(*g, mu);
        (*slack, *multiplier) = (s.max(T::of(SLACK_FLOOR)), z.max(T::of(MULTIPLIER_FLOOR)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resumed_slacks_and_multipliers_differ_by_the_residual_and_have_the_product_mu() {
        fn check<T: Real>() {
            let g: Vec<T> = [-3., -0.02, -1e-4, 0., 1e-4, 0.02, 3.].map(T::of).into();
            let zeros = vec![T::zero(); g.len()];
            let of = |mu: f64| {
                let mut slacks = Slacks { slack: zeros.clone(), multiplier: zeros.clone(), ..Slacks::default() };
                resume_slacks(&g, T::of(mu), &mut slacks);
                slacks.slack.into_iter().zip(slacks.multiplier)
            };
            let mu = 1e-5;
            for ((s, z), g) in of(mu).zip(&g) {
                assert!((s * z - T::of(mu)).abs() < T::of(4. * mu) * T::epsilon(), "{g:?}: {s:?} times {z:?}");
                assert!((z - s - *g).abs() < T::of(4.) * T::epsilon() * (s + z), "{g:?}: {z:?} less {s:?}");
            }
            // Floors act where the product would make one of them too small.
            let floors = [SLACK_FLOOR, MULTIPLIER_FLOOR].map(T::of);
            let narrow: Vec<_> = of(1e-12).collect();
            assert!(narrow[0].1 == floors[1] && narrow[6].0 == floors[0]);
        }
        check::<f32>();
        check::<f64>();
    }
}
