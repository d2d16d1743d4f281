//! Objective of the cost rows, and their part in the normal equations.
//!
//! A quadratic row counts half of its square. Any other row counts its absolute value, rounded to `sqrt(r^2 + rounding^2) - rounding`
//! (pseudo-Huber); its weight in the normal equations is that of the parabola that touches this function at the current point and is above
//! it everywhere (iteratively reweighted least squares).

use super::control::{Limits, MINIMISE, Progress};
use crate::nlp::Problem;
use crate::real::Real;
use crate::rows::RowKind;

/// Objective of one iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Objective<T> {
    /// Weight of the cost relative to the constraints; 0 if the cost rows are not minimised.
    pub weight: T,
    /// Rounding of absolute values, m/s.
    pub rounding: T,
}

impl<T: Real> Objective<T> {
    /// No cost.
    pub fn none() -> Self {
        Objective { weight: T::zero(), rounding: T::one() }
    }

    /// Objective of the current phase: that of the cost rows while the cost is minimised.
    pub fn of(limits: &Limits<T>, progress: &Progress<T>) -> Self {
        if progress.phase == MINIMISE {
            Objective { weight: limits.minimise.weight, rounding: progress.rounding }
        } else {
            Objective::none()
        }
    }

    /// Weighted cost of residuals.
    ///
    /// * `c` - residuals of equalities and cost rows
    pub fn cost(&self, problem: &Problem<T>, c: &[T]) -> T {
        if self.weight == T::zero() {
            return T::zero();
        }
        let rows = c[problem.rows.of(RowKind::Cost)].iter().zip(&problem.cost_weights);
        self.weight * rows.map(|(&r, &of_row)| self.of_row(r, of_row)).sum()
    }

    /// Decrease of the weighted cost between two points, row by row: near an optimum the two costs differ only in their last digits.
    ///
    /// * `from`, `to` - residuals of equalities and cost rows
    pub fn fall(&self, problem: &Problem<T>, from: &[T], to: &[T]) -> T {
        if self.weight == T::zero() {
            return T::zero();
        }
        let costs = problem.rows.of(RowKind::Cost);
        let rows = from[costs.clone()].iter().zip(&to[costs]).zip(&problem.cost_weights);
        self.weight * rows.map(|((&r, &to), &of_row)| self.fall_of_row(r, to, of_row)).sum()
    }

    /// Cost of a row.
    ///
    /// * `of_row` - weight of its absolute value; 0 if half of its square counts, negative if the row is no part of the cost
    pub fn of_row(&self, r: T, of_row: T) -> T {
        if of_row < T::zero() {
            return T::zero();
        }
        if of_row == T::zero() { T::of(0.5) * r * r } else { of_row * (self.rounded(r) - self.rounding) }
    }

    /// Decrease of the cost of a row.
    fn fall_of_row(&self, r: T, to: T, of_row: T) -> T {
        if of_row < T::zero() {
            return T::zero();
        }
        let squares = (r - to) * (r + to);
        if of_row == T::zero() { T::of(0.5) * squares } else { of_row * squares / (self.rounded(r) + self.rounded(to)) }
    }

    /// Weights and values of the cost rows in the normal equations.
    ///
    /// * `c` - residuals of equalities and cost rows
    /// * `multiplier` - multipliers of the inequalities
    /// * `weight`, `value` - out, `[rows]`
    pub fn rows(&self, problem: &Problem<T>, c: &[T], multiplier: &[T], weight: &mut [T], value: &mut [T]) {
        let costs = problem.rows.of(RowKind::Cost);
        let out = weight[costs.clone()].iter_mut().zip(&mut value[costs.clone()]);
        for ((weight, value), (&r, &of_row)) in out.zip(c[costs].iter().zip(&problem.cost_weights)) {
            *weight = if self.weight == T::zero() || of_row == T::zero() {
                self.weight
            } else if of_row < T::zero() {
                multiplier[(-T::one() - of_row).as_f64() as usize]
            } else {
                self.weight * of_row / self.rounded(r)
            };
            *value = *weight * r;
        }
    }

    fn rounded(&self, r: T) -> T {
        (r * r + self.rounding * self.rounding).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gait::Schedule;
    use crate::gait::cost::CostWeights;
    use crate::robot::Robot;
    use crate::settings::TranscriptionSettings;
    use crate::task::{Goal, Task};
    use crate::terrain::Terrain;

    /// Problem of a biped's step with cost rows.
    fn problem() -> Problem<f64> {
        let task = Task::new(Robot::named("biped").unwrap(), Terrain::flat(), Goal::at(0.5, 0.)).unwrap();
        let schedule = Schedule::new(vec![vec![0.3, 0.2, 0.3], vec![0.4, 0.2, 0.2]]).unwrap().aligned(0.1);
        Problem::with_cost(&task, &schedule, &TranscriptionSettings::default(), Some(&CostWeights::default()))
    }

    #[test]
    fn values_are_the_gradient_of_the_cost() {
        let problem = problem();
        let objective = Objective { weight: 0.5, rounding: 0.01 };
        let costs = problem.rows.of(RowKind::Cost);
        let mut c: Vec<f64> = (0..costs.end).map(|i| 0.03 * (i as f64).sin()).collect();
        let (mut weight, mut value) = (vec![0.; problem.rows.all()], vec![0.; problem.rows.all()]);
        objective.rows(&problem, &c, &vec![0.; problem.inequalities], &mut weight, &mut value);
        assert!(problem.cost_weights.contains(&0.) && problem.cost_weights.iter().any(|w| *w > 0.));
        for row in costs.step_by(7) {
            let before = c[row];
            let side = |c: &mut Vec<f64>, step: f64| {
                c[row] = before + step;
                objective.cost(&problem, c)
            };
            let slope = (side(&mut c, 1e-6) - side(&mut c, -1e-6)) / 2e-6;
            c[row] = before;
            assert!((slope - value[row]).abs() < 1e-8, "row {row}: {} against {slope}", value[row]);
            assert!((value[row] - weight[row] * before).abs() < 1e-15);
        }
    }

    #[test]
    fn curvature_rows_are_no_part_of_the_cost() {
        let problem = problem();
        let objective = Objective { weight: 0.5, rounding: 0.01 };
        let costs = problem.rows.of(RowKind::Cost);
        let without: Vec<f64> = (0..costs.end).map(|i| 0.03 * (i as f64).sin()).collect();
        let mut with = without.clone();
        for node in &problem.cone_curvatures {
            with[node.place.row as usize..][..2].fill(0.7);
        }
        assert!(with != without && objective.cost(&problem, &without) > 0.);
        assert_eq!(objective.cost(&problem, &with), objective.cost(&problem, &without));
        assert_eq!(objective.fall(&problem, &with, &without), 0.);
        // All other rows have their part.
        let others = costs.len() - 2 * problem.cone_curvatures.len();
        assert_eq!(problem.cost_weights.iter().filter(|w| **w >= 0.).count(), others);
    }
}
