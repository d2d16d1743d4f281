//! Gauss-Legendre quadrature with three and six nodes, exact for polynomials of degree 5 and 11.

use std::sync::LazyLock;

/// Outer node of the rule with three nodes on \[-1, 1\], `sqrt(3 / 5)`; the nodes are `-GAUSS_3_NODE`, 0 and `GAUSS_3_NODE`.
pub(crate) const GAUSS_3_NODE: f64 = 0.774_596_669_241_483_4;

/// Weights of the rule with three nodes on \[-1, 1\].
pub(crate) const GAUSS_3_WEIGHTS: [f64; 3] = [5. / 9., 8. / 9., 5. / 9.];

/// Nodes and weights of the rule with three nodes on (0, 1).
pub(crate) const GAUSS_3: [[f64; 2]; 3] = [[(1. - GAUSS_3_NODE) / 2., 5. / 18.], [0.5, 8. / 18.], [(1. + GAUSS_3_NODE) / 2., 5. / 18.]];

/// Nodes and weights of the rule with six nodes on (0, 1), by Newton's method on the Legendre polynomial.
pub(crate) static GAUSS_6: LazyLock<[[f64; 2]; 6]> = LazyLock::new(|| {
    const N: usize = 6;
    std::array::from_fn(|i| {
        let mut x = -(std::f64::consts::PI * (i as f64 + 0.75) / (N as f64 + 0.5)).cos();
        let mut slope = 1.;
        for _ in 0..20 {
            let (mut before, mut now) = (1., x);
            for k in 2..=N {
                (before, now) = (now, ((2 * k - 1) as f64 * x * now - (k - 1) as f64 * before) / k as f64);
            }
            slope = N as f64 * (x * now - before) / (x * x - 1.);
            x -= now / slope;
        }
        [(1. + x) / 2., 1. / ((1. - x * x) * slope * slope)]
    })
});

/// Value at `u` of the Lagrange polynomial that is 1 at node `i` and 0 at the other nodes.
pub(crate) fn lagrange(nodes: &[f64], i: usize, u: f64) -> f64 {
    (0..nodes.len()).filter(|&j| j != i).map(|j| (u - nodes[j]) / (nodes[i] - nodes[j])).product()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Integral of `u^degree` over (0, 1) by a rule.
    fn power(rule: &[[f64; 2]], degree: i32) -> f64 {
        rule.iter().map(|[u, weight]| weight * u.powi(degree)).sum()
    }

    #[test]
    fn rules_integrate_polynomials_up_to_their_degree_exactly_and_no_further() {
        for (rule, exact) in [(&GAUSS_3[..], 5), (&GAUSS_6[..], 11)] {
            for degree in 0..=exact {
                let error = power(rule, degree) - 1. / f64::from(degree + 1);
                assert!(error.abs() < 1e-15, "{} nodes, degree {degree}: {error:e}", rule.len());
            }
            let error = power(rule, exact + 1) - 1. / f64::from(exact + 2);
            assert!(error.abs() > 1e-9, "{} nodes, degree {}: {error:e}", rule.len(), exact + 1);
        }
    }

    #[test]
    fn both_forms_of_the_rule_with_three_nodes_agree() {
        let nodes = [-GAUSS_3_NODE, 0., GAUSS_3_NODE];
        for (([u, weight], node), whole) in GAUSS_3.into_iter().zip(nodes).zip(GAUSS_3_WEIGHTS) {
            assert_eq!([u, weight], [(1. + node) / 2., whole / 2.]);
        }
    }

    #[test]
    fn lagrange_polynomials_are_one_at_their_node_and_zero_at_the_others() {
        let nodes = GAUSS_6.map(|[u, _]| u);
        for i in 0..6 {
            for j in 0..6 {
                assert_eq!(lagrange(&nodes, i, nodes[j]), f64::from(u8::from(i == j)));
            }
        }
    }
}
