//! Curvature of the Lagrangian from rows and powers, learned from the change of its derivative between iterates.
//!
//! The convex problem contains the curvature of the effort only. The curvature of products (forces with lever arms, forces with speeds,
//! anything with times) is estimated from the last steps `s` and the changes `y` of the derivative of the Lagrangian along them, by the
//! BFGS formula with Powell's damping in the space that they span. The estimate is convex: directions of negative curvature are dropped.
//!
//! Source: J. Nocedal, S. J. Wright, "Numerical Optimization", 2nd edition, 2006, procedure 18.2.

use nalgebra::{DMatrix, DVector};
use std::collections::VecDeque;

/// Number of steps that are stored.
const MEMORY: usize = 20;

/// Number of directions of largest curvature that are kept. Each is a dense row of the convex problem.
const DIRECTIONS: usize = 16;

/// Powell's damping: smallest curvature of a new step relative to the estimate so far.
const DAMPING: f64 = 0.2;

/// Curvature in costs per squared trust length: `least` in all directions, and more in some.
#[derive(Debug, Clone, Default)]
pub(super) struct Curvature {
    pub least: f64,
    /// Curvature beyond `least`, with its unit direction.
    pub directions: Vec<(f64, Vec<f64>)>,
}

impl Curvature {
    /// Product of the curvature matrix with a step.
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

/// Stored steps, in trust lengths, and the changes of the derivative of the Lagrangian along them, in costs.
#[derive(Debug, Default)]
pub(super) struct History {
    steps: VecDeque<(DVector<f64>, DVector<f64>)>,
}

impl History {
    /// Stores a step with the derivatives of the Lagrangian after and before it, in the unit of `cost`.
    pub fn push(&mut self, step: Vec<f64>, after: Vec<f64>, before: &[f64], cost: f64) {
        let change: Vec<f64> = after.iter().zip(before).map(|(a, b)| (a - b) / cost).collect();
        if self.steps.len() == MEMORY {
            self.steps.pop_front();
        }
        self.steps.push_back((DVector::from_vec(step), DVector::from_vec(change)));
    }

    /// Median curvature along the stored steps; 0 without steps.
    pub fn median(&self) -> f64 {
        let mut along: Vec<f64> = self.steps.iter().map(|(s, y)| s.dot(y) / s.dot(s)).collect();
        along.sort_by(f64::total_cmp);
        along.get(along.len() / 2).copied().unwrap_or(0.)
    }

    /// Curvature estimate that starts from `least` in all directions.
    pub fn curvature(&self, least: f64) -> Curvature {
        let mut basis: Vec<DVector<f64>> = Vec::new();
        for vector in self.steps.iter().flat_map(|(s, y)| [s, y]) {
            let mut left = vector.clone();
            // Two passes of Gram-Schmidt are enough.
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
