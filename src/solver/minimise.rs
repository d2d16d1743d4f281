//! Minimisation of the cost of a solved motion: the smoothing term, the objective of the cost rows, or both.
//!
//! The method of multipliers with one barrier step between two updates of the multipliers: residuals are shifted by the multipliers of
//! their rows, those of inequalities come from the barrier. The multipliers are small because the weight of the cost is, so that a
//! penalty of 1 is enough. At the end the rows are solved again without the cost. The phases are those of [`control`](super::control).

use super::Residuals;
use super::slacks::Slacks;
use crate::nlp::Problem;
use crate::real::Real;
use crate::rows::RowKind;

/// Adds the shifts to the residuals of a trial point. Cost rows have none.
pub fn add_shifts<T: Real>(residuals: &mut Residuals<T>, shift: &Residuals<T>) {
    for (to, by) in residuals.pairs(shift) {
        to.iter_mut().zip(by).for_each(|(to, by)| *to += *by);
    }
}

/// Subtracts the shifts from the residuals of the current point.
pub fn subtract_shifts<T: Real>(residuals: &mut Residuals<T>, shift: &Residuals<T>) {
    for (from, by) in residuals.pairs(shift) {
        from.iter_mut().zip(by).for_each(|(from, by)| *from -= *by);
    }
}

/// Updates the shifts after an accepted step, and with them the residuals of the new current point.
pub fn update_shifts<T: Real>(problem: &Problem<T>, now: &mut Residuals<T>, shift: &mut Residuals<T>, slacks: &Slacks<T>) {
    // Equalities: the new multiplier is the sum of multiplier and residual. Inequalities take their multipliers from the barrier.
    for (c, shift) in now.c[problem.rows.of(RowKind::Equality)].iter_mut().zip(&mut shift.c) {
        let residual = *c - *shift;
        *shift = *c;
        *c += residual;
    }
    for ((g, shift), z) in now.g.iter_mut().zip(&mut shift.g).zip(&slacks.multiplier) {
        *g += *z - *shift;
        *shift = *z;
    }
}
