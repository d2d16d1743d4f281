//! Elastic primal-dual augmented-Lagrangian Gauss-Newton solver for one candidate.
//!
//! For scaled equalities `c(x) = 0` and inequalities `g(x) <= 0` with slacks `s`, multipliers `z` and penalty `rho = 1`, it minimises
//! `rho/2 |c|^2 + rho/2 |g + s|^2 - mu sum ln s` with a proximal term. Eliminating slacks and multipliers leaves one positive definite
//! system an iteration,
//!
//! `(eps D + rho Jc'Jc + Jg' W Jg) d = -(rho Jc' c + Jg'(z + w (g - z/rho + mu/z)))`, `w = 1 / (s/z + 1/rho)`,
//!
//! whose weights are bounded by `rho`, so that it is safe in f32. Each factorisation serves twice: a predictor with `mu = 0` says how far the
//! barrier can fall, and Mehrotra's corrector goes there. Near a solution, closing steps (Gauss-Newton on the equalities and the
//! violated rows) converge quadratically.

mod status;

pub use status::{Outcome, Status};

use crate::kernels::Shared;
use crate::kernels::advance::{add, advance};
use crate::kernels::control::{self, Limits, Progress};
use crate::kernels::forward::forward;
use crate::kernels::front::{Factor, NormalEquations, factorise};
use crate::kernels::judge::{infeasibility, infeasibility_fall, merit_fall, nonlinearity, pull_fall, update_slacks};
use crate::kernels::product::jacobian_times;
use crate::kernels::rows::{barrier_rows, closing_rows, variable_terms};
use crate::kernels::slacks::{Aim, Slacks, slack_steps, target};
use crate::kernels::start::{column_scaling, start_slacks};
use crate::kernels::substitute::substitute;
use crate::kernels::transposed::transposed_times;
use crate::nlp::layout::Family;
use crate::nlp::{Layout, Real};
use crate::settings::SolverSettings;

/// When a solve is done.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Finish {
    /// The scaled infeasibility `F`, margins included, is below this.
    Infeasibility(f64),
    /// No row is violated by more than this in its own unit (N, N m, m); margins do not count.
    Rows(f64),
}

/// Residuals at one point.
#[derive(Debug, Default)]
struct Residuals<T> {
    c: Vec<T>,
    g: Vec<T>,
}

impl<T: Real> Residuals<T> {
    fn resize(&mut self, layout: &Layout<T>) {
        self.c.resize(layout.equalities, T::zero());
        self.g.resize(layout.inequalities, T::zero());
    }

    fn clear(&mut self) {
        self.c.fill(T::zero());
        self.g.fill(T::zero());
    }
}

/// Buffers for one candidate at a time; made once a thread and reused, so that a solve allocates only when it meets a larger candidate.
#[derive(Debug)]
pub struct Solver<T> {
    x: Vec<T>,
    trial: Vec<T>,
    /// The direction on the columns of one element.
    local: Vec<T>,
    direction: Vec<T>,
    scaling: Vec<T>,
    diagonal: Vec<T>,
    gradient: Vec<T>,
    shared: Shared<T>,
    now: Residuals<T>,
    next: Residuals<T>,
    change: Residuals<T>,
    linear: Residuals<T>,
    jacobian: Vec<T>,
    /// That of the trial point.
    next_jacobian: Vec<T>,
    /// Multipliers that residuals are shifted by, of equalities and inequalities; zero but while a cost is lowered.
    shift: Residuals<T>,
    weight: Vec<T>,
    value: Vec<T>,
    slacks: Slacks<T>,
    factor: Factor<T>,
    history: Vec<T>,
}

impl<T: Real> Default for Solver<T> {
    fn default() -> Self {
        Solver {
            x: Vec::new(),
            trial: Vec::new(),
            local: Vec::new(),
            direction: Vec::new(),
            scaling: Vec::new(),
            diagonal: Vec::new(),
            gradient: Vec::new(),
            shared: Shared::default(),
            now: Residuals::default(),
            next: Residuals::default(),
            change: Residuals::default(),
            linear: Residuals::default(),
            jacobian: Vec::new(),
            next_jacobian: Vec::new(),
            shift: Residuals::default(),
            weight: Vec::new(),
            value: Vec::new(),
            slacks: Slacks::default(),
            factor: Factor::default(),
            history: Vec::new(),
        }
    }
}

/// Barrier parameter at which a cost begins to be lowered: near rows bend it early.
const SMOOTH_BARRIER: f64 = 1e-3;

impl<T: Real> Solver<T> {
    /// Solves one candidate from `start` (or from the layout's initial values).
    ///
    /// The result does not depend on what was solved before. `cancel` ends the solve at the next iteration.
    pub fn solve(
        &mut self,
        layout: &Layout<T>,
        settings: &SolverSettings,
        finish: Finish,
        start: Option<&[f64]>,
        cancel: &dyn Fn() -> bool,
    ) -> Outcome {
        self.prepare(layout, start);
        let limits = Limits::new(settings);
        let edge_radius = T::of(settings.edge_radius_on(&layout.terrain));
        let mut progress = Progress::first(&limits, edge_radius);
        self.linearise(layout, edge_radius);
        column_scaling(layout, &self.jacobian, &mut self.scaling);
        let status = self.iterate(layout, &limits, finish, &mut progress, cancel);
        if status == Status::Solved {
            self.smooth(layout, settings, finish, &mut progress, cancel);
        }
        Outcome {
            status,
            iterations: progress.iterations as usize,
            factorisations: progress.factorisations as usize,
            infeasibility: progress.infeasibility.as_f64(),
        }
    }

    /// Barrier and closing steps from the linearisation at `x` to the end. Returns how it ended; `x` is the last point.
    fn iterate(
        &mut self,
        layout: &Layout<T>,
        limits: &Limits<T>,
        finish: Finish,
        progress: &mut Progress<T>,
        cancel: &dyn Fn() -> bool,
    ) -> Status {
        start_slacks(&self.now.g, limits.barrier, &mut self.slacks);
        loop {
            if progress.attempts == 0 {
                let f = infeasibility(&self.now.c, &self.now.g);
                let before = self.history.len().checked_sub(limits.stall_window as usize).map_or(f, |at| self.history[at]);
                let held = self.finished(layout, finish, f);
                control::begin(progress, limits, f, before, held);
                if progress.state != control::EXACT {
                    self.history.push(f);
                }
                if let Some(status) = Status::of(progress.state) {
                    return status;
                }
                if cancel() {
                    return Status::Cancelled;
                }
            }
            self.round(layout, limits, progress);
            if let Some(status) = Status::of(progress.state) {
                return status;
            }
        }
    }

    /// Makes a trial point from the linearisation at `x` and takes it when it is good.
    fn round(&mut self, layout: &Layout<T>, limits: &Limits<T>, progress: &mut Progress<T>) {
        if progress.state == control::EXACT {
            self.linearise(layout, progress.edge_radius);
            return control::renew(progress);
        }
        if !self.direction(layout, progress) {
            return control::refuse(progress);
        }
        // With the Jacobian: nearly every trial is accepted.
        crate::kernels::evaluate(
            layout,
            &self.trial,
            progress.edge_radius,
            &mut self.shared,
            &mut self.next.c,
            &mut self.next.g,
            Some(&mut self.next_jacobian),
        );
        add(&mut self.next.c, &self.shift.c);
        add(&mut self.next.g, &self.shift.g);
        let (now, next, linear) = (&self.now, &self.next, &self.linear);
        let closing = progress.state == control::CLOSE;
        let falls = |to: &Residuals<T>| {
            if closing { infeasibility_fall(&now.c, &now.g, &to.c, &to.g) } else { merit_fall(&now.c, &now.g, &to.c, &to.g, progress.mu) }
        };
        let pulled = progress.pull * pull_fall(&layout.pull, &self.x, &self.trial, &layout.initial);
        let (fall, predicted) = (falls(next) + pulled, falls(linear) + pulled);
        let gap = nonlinearity(&next.c, &linear.c, &next.g, &linear.g);
        if control::acceptable(progress, fall, predicted, gap) {
            if !closing {
                update_slacks(&mut self.slacks, progress.length);
            }
            let ratio = if predicted > T::zero() { fall / predicted } else { T::zero() };
            control::accept(progress, limits, ratio);
            self.advance();
        } else {
            control::refuse(progress);
        }
    }

    /// Takes the trial point.
    fn advance(&mut self) {
        std::mem::swap(&mut self.x, &mut self.trial);
        std::mem::swap(&mut self.now, &mut self.next);
        std::mem::swap(&mut self.jacobian, &mut self.next_jacobian);
    }

    /// Lowers the cost of a solved motion by the method of multipliers, one barrier step between two updates, then solves on without it.
    /// A motion that is not solved again is taken back.
    fn smooth(
        &mut self,
        layout: &Layout<T>,
        settings: &SolverSettings,
        finish: Finish,
        progress: &mut Progress<T>,
        cancel: &dyn Fn() -> bool,
    ) {
        if settings.smooth.iterations == 0 || layout.pull.iter().all(|p| *p == T::zero()) {
            return;
        }
        let (solved, infeasibility) = (self.x.clone(), progress.infeasibility);
        let onwards = SolverSettings {
            barrier: settings.barrier.min(SMOOTH_BARRIER),
            proximal: settings.proximal_floor,
            pull: 0.,
            max_iterations: progress.iterations as usize + settings.smooth.iterations + settings.max_iterations,
            ..settings.clone()
        };
        let limits = Limits::new(&onwards);
        let renewed = |progress: &Progress<T>, recorded: usize| Progress {
            iterations: progress.iterations,
            factorisations: progress.factorisations,
            recorded: recorded as u32,
            stall_from: recorded as u32,
            infeasibility: progress.infeasibility,
            ..Progress::first(&limits, T::zero())
        };
        *progress = renewed(progress, self.history.len());
        progress.pull = T::of(settings.smooth.weight);
        start_slacks(&self.now.g, limits.barrier, &mut self.slacks);
        let end = progress.iterations + settings.smooth.iterations as u32;
        while progress.iterations < end && !cancel() {
            let before = progress.iterations;
            self.round(layout, &limits, progress);
            if progress.ended() {
                break;
            }
            if progress.iterations > before {
                self.shift_residuals();
            }
        }
        self.shift.clear();
        self.linearise(layout, T::zero());
        *progress = renewed(progress, self.history.len());
        if self.iterate(layout, &limits, finish, progress, cancel) != Status::Solved {
            self.x = solved;
            progress.infeasibility = infeasibility;
        }
    }

    /// Updates the multipliers by which residuals are shifted.
    fn shift_residuals(&mut self) {
        // Equalities: multiplier and residual make the new multiplier. Inequalities have theirs from the barrier.
        for (c, shift) in self.now.c.iter_mut().zip(&mut self.shift.c) {
            let residual = *c - *shift;
            *shift = *c;
            *c += residual;
        }
        for ((g, shift), z) in self.now.g.iter_mut().zip(&mut self.shift.g).zip(&self.slacks.multiplier) {
            *g += *z - *shift;
            *shift = *z;
        }
    }

    /// The last `x` in `f64`, fixed values included.
    pub fn solution(&self) -> Vec<f64> {
        self.x.iter().map(|v| v.as_f64()).collect()
    }

    fn prepare(&mut self, layout: &Layout<T>, start: Option<&[f64]>) {
        self.x.clear();
        self.x.extend_from_slice(&layout.initial);
        if let Some(start) = start {
            for (x, &v) in self.x[..layout.variables].iter_mut().zip(start) {
                *x = T::of(v);
            }
        }
        self.trial.clone_from(&self.x);
        self.direction.resize(layout.variables, T::zero());
        for v in [&mut self.scaling, &mut self.diagonal, &mut self.gradient] {
            v.resize(layout.variables, T::zero());
        }
        self.shared.resize(layout);
        for residuals in [&mut self.now, &mut self.next, &mut self.change, &mut self.linear] {
            residuals.resize(layout);
        }
        // The padding of Jacobian rows must be zero, and no kernel writes it.
        for jacobian in [&mut self.jacobian, &mut self.next_jacobian] {
            jacobian.clear();
            jacobian.resize(layout.jacobian_len, T::zero());
        }
        self.local.resize(layout.widest, T::zero());
        self.shift.resize(layout);
        self.shift.clear();
        self.weight.resize(layout.rows, T::zero());
        self.value.resize(layout.rows, T::zero());
        for v in [&mut self.slacks.slack, &mut self.slacks.multiplier, &mut self.slacks.slack_step, &mut self.slacks.multiplier_step] {
            v.resize(layout.inequalities, T::zero());
        }
        self.factor.resize(layout);
        self.history.clear();
    }

    /// Residuals and Jacobian at `x`.
    fn linearise(&mut self, layout: &Layout<T>, edge_radius: T) {
        let (c, g) = (&mut self.now.c, &mut self.now.g);
        crate::kernels::evaluate(layout, &self.x, edge_radius, &mut self.shared, c, g, Some(&mut self.jacobian));
    }

    /// Trial point and linear residuals there. Returns false when the normal equations could not be factorised.
    fn direction(&mut self, layout: &Layout<T>, progress: &mut Progress<T>) -> bool {
        let closing = progress.state == control::CLOSE;
        let predictor = Aim { mu: T::zero(), correction: T::zero() };
        progress.factorisations += 1;
        if closing {
            closing_rows(layout, &self.now.c, &self.now.g, &mut self.weight, &mut self.value);
        } else {
            barrier_rows(layout, &self.now.c, &self.now.g, &self.slacks, predictor, &mut self.weight, &mut self.value);
        }
        variable_terms(
            &self.scaling,
            progress.proximal(),
            &layout.pull,
            progress.pull,
            &self.x,
            &layout.initial,
            &mut self.diagonal,
            &mut self.gradient,
        );
        let system = NormalEquations {
            jacobian: &self.jacobian,
            weight: &self.weight,
            value: &self.value,
            diagonal: &self.diagonal,
            gradient: &self.gradient,
        };
        if !factorise(layout, &system, &mut self.factor) {
            return false;
        }
        substitute(layout, &mut self.factor, &mut self.direction);
        jacobian_times(layout, &self.jacobian, &self.direction, &mut self.local, &mut self.change.c, &mut self.change.g);
        progress.length = if closing { T::one() } else { self.correct(layout, predictor, progress) };
        let (variables, length) = (layout.variables, progress.length);
        advance(&self.x[..variables], length, &self.direction, &mut self.trial[..variables]);
        advance(&self.now.c, length, &self.change.c, &mut self.linear.c);
        advance(&self.now.g, length, &self.change.g, &mut self.linear.g);
        true
    }

    /// Corrects the direction of the predictor, Mehrotra's way: the barrier parameter it aims for follows from how far the predictor could
    /// go, and the product of its steps is taken into account. Returns the length of the step.
    fn correct(&mut self, layout: &Layout<T>, predictor: Aim<T>, progress: &mut Progress<T>) -> T {
        let reach = slack_steps(&self.now.g, &self.change.g, predictor, &mut self.slacks);
        progress.mu = target(&self.slacks, reach);
        let aim = Aim { mu: progress.mu, correction: reach };
        barrier_rows(layout, &self.now.c, &self.now.g, &self.slacks, aim, &mut self.weight, &mut self.value);
        let right_hand_side = &mut self.trial[..layout.variables];
        transposed_times(layout, &self.jacobian, &self.value, &mut self.local, right_hand_side);
        add(right_hand_side, &self.gradient);
        forward(layout, &mut self.factor, right_hand_side);
        substitute(layout, &mut self.factor, &mut self.direction);
        jacobian_times(layout, &self.jacobian, &self.direction, &mut self.local, &mut self.change.c, &mut self.change.g);
        slack_steps(&self.now.g, &self.change.g, aim, &mut self.slacks)
    }

    fn finished(&self, layout: &Layout<T>, finish: Finish, f: T) -> bool {
        match finish {
            Finish::Infeasibility(tolerance) => f < T::of(tolerance),
            Finish::Rows(tolerance) => rows_hold(layout, &self.now.c, &self.now.g, tolerance),
        }
    }

    /// `F` at the start and after each iteration of the last solve.
    pub fn history(&self) -> Vec<f64> {
        self.history.iter().map(|f| f.as_f64()).collect()
    }
}

/// Whether no row is violated by more than `tolerance` in its own unit, margins aside.
fn rows_hold<T: Real>(layout: &Layout<T>, c: &[T], g: &[T], tolerance: f64) -> bool {
    let k = &layout.constants;
    let tolerance = T::of(tolerance);
    layout.elements.iter().all(|element| {
        let (row, at) = (element.place.row as usize, element.place.inequality as usize);
        let count = (element.rows + element.pairs) as usize;
        let limit = match element.family {
            Family::Dynamics | Family::LinearMomentum | Family::AngularMomentum => {
                let scale = |r: usize| match element.family {
                    Family::Dynamics if r < 3 => k.moment_scale,
                    Family::AngularMomentum => k.moment_scale,
                    _ => k.balance_scale,
                };
                return (0..6).all(|r| c[row + r].abs() <= tolerance * scale(r));
            }
            Family::Reach | Family::Swing | Family::Stride => (tolerance + k.length_margin) * k.length_scale,
            Family::Force => tolerance / k.force_unit + k.force_margin,
        };
        g[at..at + count].iter().all(|&g| g <= limit)
    })
}
