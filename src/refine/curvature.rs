//! What rows and powers add to the curvature of the Lagrangian, learned from how its derivatives change from point to point.
//!
//! The convex problem has the curvature of the effort alone. That of products (forces with arms, forces with speeds, anything with times) is
//! taken from the last steps `s` and the changes `y` of the derivative of the Lagrangian along them, by the BFGS formula with Powell's damping
//! in the space that they span. Convex it stays: of directions that bend down, none is kept.
//!
//! Source: J. Nocedal, S. J. Wright, "Numerical Optimization", 2nd edition, 2006, procedure 18.2.

use nalgebra::{DMatrix, DVector};
use std::collections::VecDeque;

/// Steps that are remembered.
const MEMORY: usize = 20;

/// Directions whose curvature is kept, the most curved: each is a dense row of the convex problem.
const DIRECTIONS: usize = 16;

/// Powell's damping: the least share of the curvature so far that a new step has to show.
const DAMPING: f64 = 0.2;

/// Curvature by trust lengths, in costs: `least` in all directions and more in some.
#[derive(Debug, Clone, Default)]
pub(super) struct Curvature {
    pub least: f64,
    /// Beyond `least`, with the unit direction.
    pub directions: Vec<(f64, Vec<f64>)>,
}

impl Curvature {
    /// Product with a step.
    pub fn times(&self, d: &[f64]) -> Vec<f64> {
        let mut product: Vec<f64> = d.iter().map(|d| self.least * d).collect();
        for (bend, direction) in &self.directions {
            let along: f64 = direction.iter().zip(d).map(|(a, b)| a * b).sum();
            product.iter_mut().zip(direction).for_each(|(p, q)| *p += bend * along * q);
        }
        product
    }

    /// Second derivative along a step.
    pub fn along(&self, d: &[f64]) -> f64 {
        self.times(d).iter().zip(d).map(|(p, d)| p * d).sum()
    }
}

/// The last steps and what the derivative of the Lagrangian did along them, in trust lengths and costs.
#[derive(Debug, Default)]
pub(super) struct History {
    steps: VecDeque<(DVector<f64>, DVector<f64>)>,
}

impl History {
    /// Remembers a step, with the derivatives of the Lagrangian after it and before, in the unit of `cost`.
    pub fn push(&mut self, step: Vec<f64>, after: Vec<f64>, before: &[f64], cost: f64) {
        let change: Vec<f64> = after.iter().zip(before).map(|(a, b)| (a - b) / cost).collect();
        if self.steps.len() == MEMORY {
            self.steps.pop_front();
        }
        self.steps.push_back((DVector::from_vec(step), DVector::from_vec(change)));
    }

    /// Curvature from `least` in all directions on.
    pub fn curvature(&self, least: f64) -> Curvature {
        let mut basis: Vec<DVector<f64>> = Vec::new();
        for vector in self.steps.iter().flat_map(|(s, y)| [s, y]) {
            let mut left = vector.clone();
            // Twice is enough.
            for _ in 0..2 {
                for b in &basis {
                    let along = b.dot(&left);
                    left.axpy(-along, b, 1.);
                }
            }
            let size = left.norm();
            if size > 1e-8 * vector.norm() {
                basis.push(left / size);
            }
        }
        if basis.is_empty() {
            return Curvature { least, directions: Vec::new() };
        }
        let basis = DMatrix::from_columns(&basis);
        let mut b = DMatrix::identity(basis.ncols(), basis.ncols()) * least;
        for (s, y) in &self.steps {
            let (s, mut y) = (basis.tr_mul(s), basis.tr_mul(y));
            let bs = &b * &s;
            let (now, seen) = (s.dot(&bs), s.dot(&y));
            if now <= 0. {
                continue;
            }
            if seen < DAMPING * now {
                let part = (1. - DAMPING) * now / (now - seen);
                y = y * part + &bs * (1. - part);
            }
            b += &y * y.transpose() / s.dot(&y) - &bs * bs.transpose() / now;
        }
        let eigen = b.symmetric_eigen();
        let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).filter(|&i| eigen.eigenvalues[i] > 1.5 * least).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        order.truncate(DIRECTIONS);
        let directions = order.into_iter().map(|i| {
            let direction = &basis * eigen.eigenvectors.column(i);
            (eigen.eigenvalues[i] - least, direction.iter().copied().collect())
        });
        Curvature { least, directions: directions.collect() }
    }
}
