//! Minimisation of a cost from a solved motion: the smoothing of forces, or the objective of the cost rows.
//!
//! The method of multipliers with one barrier step between two updates of the multipliers: residuals are shifted by the multipliers of
//! their rows, those of inequalities come from the barrier. The multipliers are small because the weight of the cost is, so that a
//! penalty of 1 is enough. At the end the rows are solved again without the cost.

use super::control::{self, Limits, Progress};
use super::objective::Objective;
use super::round::{ROUND, Stage};
use super::start::start_slacks;
use super::{Residuals, Solve, Solver, Status};
use crate::nlp::Problem;
use crate::real::Real;
use crate::settings::{OptimiseSettings, SolverSettings};

/// Barrier parameter at which smoothing starts: near rows bend the cost early.
const SMOOTH_BARRIER: f64 = 2e-4;

/// Barrier parameter with which the rows are solved again after an optimisation: the active rows are known.
const RESTORE_BARRIER: f64 = 1e-6;

/// Length of a step from which its predicted fall of the cost says how far the optimum is.
const TRUSTED_LENGTH: f64 = 0.5;

/// A cost that is minimised.
#[derive(Debug, Clone, Copy)]
struct Minimisation<T> {
    /// Barrier parameter at the start.
    barrier: T,
    /// Barrier parameter with which the rows are solved again.
    restore: T,
    iterations: usize,
    /// Weight of the smoothing.
    smoothing: T,
    objective: Objective<T>,
    /// Smallest rounding of the objective.
    rounding_floor: T,
    /// Predicted relative fall of the cost at which the minimisation ends.
    tolerance: T,
}

impl<T: Real> Solver<T> {
    /// Smooths a solved motion: forces towards equal shares of the weight, attitude and rates towards the initial guess.
    pub(super) fn smooth(&mut self, solve: &Solve<T>, settings: &SolverSettings, progress: &mut Progress<T>, cancel: &dyn Fn() -> bool) {
        let problem = solve.problem;
        if settings.smooth.iterations == 0 || problem.smoothing.iter().all(|p| *p == T::zero()) {
            return;
        }
        let barrier = progress.barrier.min(T::of(SMOOTH_BARRIER));
        let smoothing = Minimisation {
            barrier,
            restore: barrier,
            iterations: settings.smooth.iterations,
            smoothing: T::of(settings.smooth.weight),
            objective: Objective::none(),
            rounding_floor: T::one(),
            tolerance: T::zero(),
        };
        self.minimise(solve, settings, smoothing, progress, cancel);
    }

    /// Minimises the objective of the cost rows from a solved motion.
    pub(super) fn optimise(&mut self, solve: &Solve<T>, settings: &SolverSettings, progress: &mut Progress<T>, cancel: &dyn Fn() -> bool) {
        let OptimiseSettings { iterations, weight, barrier, rounding, rounding_floor, tolerance, .. } = settings.optimise;
        if iterations == 0 || solve.problem.cost_weights.is_empty() {
            return;
        }
        let optimisation = Minimisation {
            barrier: T::of(barrier),
            restore: T::of(RESTORE_BARRIER),
            iterations,
            smoothing: T::zero(),
            objective: Objective { weight: T::of(weight), rounding: T::of(rounding) },
            rounding_floor: T::of(rounding_floor),
            tolerance: T::of(tolerance),
        };
        self.minimise(solve, settings, optimisation, progress, cancel);
    }

    /// Minimises a cost and solves the rows again. Restores the original motion if that last solve fails.
    fn minimise(
        &mut self,
        solve: &Solve<T>,
        settings: &SolverSettings,
        cost: Minimisation<T>,
        progress: &mut Progress<T>,
        cancel: &dyn Fn() -> bool,
    ) {
        let problem = solve.problem;
        let (solved, infeasibility) = (self.x.clone(), progress.infeasibility);
        let onwards = SolverSettings {
            proximal: settings.proximal_floor,
            smoothing: 0.,
            max_iterations: progress.iterations as usize + cost.iterations + settings.max_iterations,
            ..settings.clone()
        };
        let solve = Solve { limits: Limits::new(&onwards, problem.curves.transcription), ..*solve };
        let renewed = |progress: &Progress<T>, recorded: usize, barrier: T| Progress {
            iterations: progress.iterations,
            factorisations: progress.factorisations,
            recorded: recorded as u32,
            stall_from: recorded as u32,
            infeasibility: progress.infeasibility,
            ..Progress::first(&solve.limits, barrier, T::zero())
        };
        *progress = renewed(progress, self.history.len(), cost.barrier);
        progress.smoothing = cost.smoothing;
        self.objective = cost.objective;
        self.shift.resize(problem);
        start_slacks(&self.now.g, cost.barrier, &mut self.slacks);
        let end = progress.iterations + cost.iterations as u32;
        while progress.iterations < end && !progress.ended() && !cancel() {
            let before = progress.iterations;
            self.weigh(problem, progress);
            for (stage, when) in ROUND.into_iter().filter(|(stage, _)| *stage != Stage::Weights) {
                self.turn(stage, when, &solve, progress);
            }
            if progress.iterations > before && !progress.ended() {
                // No stage begins a round in this loop: the next step needs a new direction, even if this one was shortened.
                progress.state = control::STEP;
                self.shift_residuals(problem);
                if self.is_optimal(problem, &cost, progress) {
                    break;
                }
                // Absolute values are rounded less as the barrier falls.
                let part = (progress.mu / cost.barrier).sqrt().min(T::one());
                self.objective.rounding = (cost.objective.rounding * part).max(cost.rounding_floor);
            }
        }
        self.objective = Objective::none();
        self.shift = Residuals::default();
        *progress = renewed(progress, self.history.len(), cost.restore);
        self.trial.clone_from(&self.x);
        self.evaluate(problem, progress);
        self.take_trial();
        start_slacks(&self.now.g, cost.restore, &mut self.slacks);
        self.stage(Stage::Weights, &solve, progress);
        if self.iterate(&solve, progress, cancel) != Status::Solved {
            self.x = solved;
            progress.infeasibility = infeasibility;
        }
    }

    /// True if the last step, long enough to be trusted, predicted hardly any fall of the cost at the smallest rounding.
    fn is_optimal(&self, problem: &Problem<T>, cost: &Minimisation<T>, progress: &Progress<T>) -> bool {
        let sharp = self.objective.rounding <= cost.rounding_floor;
        let allowed = cost.tolerance * self.objective.weight * self.objective.cost(problem, &self.now.c);
        self.objective.weight > T::zero() && sharp && progress.length > T::of(TRUSTED_LENGTH) && self.predicted < allowed
    }

    /// Updates the multipliers by which residuals are shifted.
    fn shift_residuals(&mut self, problem: &Problem<T>) {
        // Equalities: the new multiplier is the sum of multiplier and residual. Inequalities take their multipliers from the barrier.
        let equalities = problem.rows.equalities as usize;
        for (c, shift) in self.now.c[..equalities].iter_mut().zip(&mut self.shift.c) {
            let residual = *c - *shift;
            *shift = *c;
            *c += residual;
        }
        for ((g, shift), z) in self.now.g.iter_mut().zip(&mut self.shift.g).zip(&self.slacks.multiplier) {
            *g += *z - *shift;
            *shift = *z;
        }
    }
}
