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
use crate::kernels::front::{self, Factor, NormalEquations};
use crate::kernels::step::{self, Aim, Slacks};
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

    /// What a step must lower: the infeasibility in closing steps, the smoothed merit else.
    fn merit(&self, closing: bool, mu: T) -> f64 {
        if closing { step::infeasibility(&self.c, &self.g).as_f64() } else { step::merit(&self.c, &self.g, mu) }
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
    history: Vec<f64>,
    /// Iteration from which the stall rule looks back: before it other rows were in force.
    stall_from: usize,
    /// Rounding of terrain edges in force; 0 once closing steps began.
    edge_radius: T,
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
            stall_from: 0,
            edge_radius: T::zero(),
        }
    }
}

/// How an attempt to step ended.
enum Attempt {
    Accepted { step: f64, ratio: f64 },
    Refused,
}

/// Part of the infeasibility that a closing step may leave.
const CLOSING_RATE: f64 = 0.1;
/// Infeasibility above which the stall rule speaks, in that at which closing starts: below it rounding makes it rest now and then.
const STALL_ABOVE: f64 = 10.;
/// Barrier parameter at which a cost begins to be lowered: near rows bend it early.
const SMOOTH_BARRIER: f64 = 1e-3;
/// Smallest barrier parameter.
const BARRIER_FLOOR: f64 = 1e-9;
/// Attempts to step before an iteration gives up, each with a larger proximal weight.
const ATTEMPTS: usize = 6;
/// Growth of the proximal weight after a refused attempt.
const PROXIMAL_GROWTH: f64 = 6.;

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
        self.edge_radius = if layout.terrain.has_edges() { T::of(settings.edge_radius) } else { T::zero() };
        self.linearise(layout);
        step::column_scaling(layout, &self.jacobian, &mut self.scaling);
        let mut outcome = Outcome { status: Status::MaxIterations, iterations: 0, factorisations: 0, infeasibility: f64::NAN };
        outcome.status = self.iterate(layout, settings, finish, &mut outcome, cancel);
        if outcome.status == Status::Solved {
            self.smooth(layout, settings, finish, &mut outcome, cancel);
        }
        outcome
    }

    /// Barrier and closing steps from the linearisation at `x` to the end. Returns how it ended; `x` is the last point.
    fn iterate(
        &mut self,
        layout: &Layout<T>,
        settings: &SolverSettings,
        finish: Finish,
        outcome: &mut Outcome,
        cancel: &dyn Fn() -> bool,
    ) -> Status {
        let mut mu = settings.barrier;
        self.start_slacks(layout, mu);
        let (mut eps, mut closing_eps) = (settings.proximal, settings.proximal_floor);
        let mut closing_below = settings.closing;
        let mut closing = false;
        let mut closing_from = f64::INFINITY;
        loop {
            let f = step::infeasibility(&self.now.c, &self.now.g).as_f64();
            outcome.infeasibility = f;
            self.history.push(f);
            if !f.is_finite() {
                return Status::NonFinite;
            }
            if f < settings.closing && self.edge_radius > T::zero() {
                // Near enough: from here on the exact rows.
                self.edge_radius = T::zero();
                self.linearise(layout);
                self.history.pop();
                self.stall_from = self.history.len();
                continue;
            }
            if self.finished(layout, finish, f) {
                return Status::Solved;
            }
            if outcome.iterations >= settings.max_iterations {
                return Status::MaxIterations;
            }
            if self.stalled(settings) {
                return Status::Stalled;
            }
            if cancel() {
                return Status::Cancelled;
            }
            if closing && f > CLOSING_RATE * closing_from && settings.closing.is_finite() {
                // It closes on the wrong rows: back to the barrier until they are better known.
                closing = false;
                closing_below = closing_below.min(0.1 * f);
            }
            closing = closing || f < closing_below;
            closing_from = f;
            let pull = if closing { 0. } else { settings.pull * mu / settings.barrier };
            if !closing {
                closing_eps = settings.proximal_floor;
            }
            let eps = if closing { &mut closing_eps } else { &mut eps };
            match self.attempt(layout, closing, &mut mu, pull, eps, outcome) {
                Attempt::Refused if closing => {
                    // Back to the barrier until the violated rows are better known.
                    closing = false;
                    closing_below *= 0.1;
                    continue;
                }
                Attempt::Refused => return Status::Stalled,
                Attempt::Accepted { step, ratio } => {
                    if ratio > 0.7 {
                        *eps = (*eps / 4.).max(settings.proximal_floor);
                    } else if ratio < 0.25 {
                        *eps *= 2.;
                    }
                    if !closing {
                        step::update_slacks(&mut self.slacks, T::of(step));
                    }
                }
            }
            self.advance();
            outcome.iterations += 1;
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
    fn smooth(&mut self, layout: &Layout<T>, settings: &SolverSettings, finish: Finish, outcome: &mut Outcome, cancel: &dyn Fn() -> bool) {
        if settings.smooth.iterations == 0 || layout.pull.iter().all(|p| *p == T::zero()) {
            return;
        }
        let (solved, infeasibility) = (self.x.clone(), outcome.infeasibility);
        let onwards = SolverSettings { barrier: settings.barrier.min(SMOOTH_BARRIER), pull: 0., ..settings.clone() };
        let (mut mu, mut eps) = (onwards.barrier, settings.proximal_floor);
        self.start_slacks(layout, mu);
        for _ in 0..settings.smooth.iterations {
            if cancel() {
                break;
            }
            let Attempt::Accepted { step, .. } = self.attempt(layout, false, &mut mu, settings.smooth.weight, &mut eps, outcome) else {
                break;
            };
            step::update_slacks(&mut self.slacks, T::of(step));
            self.advance();
            outcome.iterations += 1;
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
        self.shift.clear();
        self.linearise(layout);
        self.stall_from = self.history.len();
        let limits = SolverSettings { max_iterations: outcome.iterations + settings.max_iterations, ..onwards };
        if self.iterate(layout, &limits, finish, outcome, cancel) != Status::Solved {
            self.x = solved;
            outcome.infeasibility = infeasibility;
        }
    }

    /// Slacks at a point, and the multipliers that go with a barrier parameter.
    fn start_slacks(&mut self, layout: &Layout<T>, mu: f64) {
        // At the default barrier 0.1; what starts near its end starts with small slacks, too.
        let least = T::of((0.2 * mu).sqrt());
        for i in 0..layout.inequalities {
            let s = self.now.g[i].abs().max(least);
            self.slacks.slack[i] = s;
            self.slacks.multiplier[i] = T::of(mu) / s;
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
        self.stall_from = 0;
    }

    /// Residuals and Jacobian at `x`.
    fn linearise(&mut self, layout: &Layout<T>) {
        crate::kernels::evaluate(
            layout,
            &self.x,
            self.edge_radius,
            &mut self.shared,
            &mut self.now.c,
            &mut self.now.g,
            Some(&mut self.jacobian),
        );
    }

    /// Looks for a step from the linearisation at `x`; on success `trial` holds the new point.
    fn attempt(&mut self, layout: &Layout<T>, closing: bool, mu: &mut f64, pull: f64, eps: &mut f64, outcome: &mut Outcome) -> Attempt {
        let f = outcome.infeasibility;
        let predictor = Aim { mu: T::zero(), correction: T::zero() };
        for _ in 0..ATTEMPTS {
            outcome.factorisations += 1;
            if closing {
                step::closing_rows(layout, &self.now.c, &self.now.g, &mut self.weight, &mut self.value);
            } else {
                step::barrier_rows(layout, &self.now.c, &self.now.g, &self.slacks, predictor, &mut self.weight, &mut self.value);
            }
            step::variable_terms(
                &self.scaling,
                T::of(*eps),
                &layout.pull,
                T::of(pull),
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
            if !front::factorise(layout, &system, &mut self.factor) {
                *eps *= PROXIMAL_GROWTH;
                continue;
            }
            front::substitute(layout, &mut self.factor, &mut self.direction);
            step::jacobian_times(layout, &self.jacobian, &self.direction, &mut self.local, &mut self.change.c, &mut self.change.g);
            let length = if closing { T::one() } else { self.correct(layout, predictor, mu) };
            step::advance(&self.x[..layout.variables], length, &self.direction, &mut self.trial[..layout.variables]);
            step::advance(&self.now.c, length, &self.change.c, &mut self.linear.c);
            step::advance(&self.now.g, length, &self.change.g, &mut self.linear.g);
            // With the Jacobian: nearly every trial is accepted.
            crate::kernels::evaluate(
                layout,
                &self.trial,
                self.edge_radius,
                &mut self.shared,
                &mut self.next.c,
                &mut self.next.g,
                Some(&mut self.next_jacobian),
            );
            step::add(&mut self.next.c, &self.shift.c);
            step::add(&mut self.next.g, &self.shift.g);
            let mu_t = T::of(*mu);
            let pull_cost = |x: &[T]| pull * step::pull_cost(&layout.pull, &x[..layout.variables], &layout.initial).as_f64();
            let merit = self.now.merit(closing, mu_t) + pull_cost(&self.x);
            let pulled = pull_cost(&self.trial);
            let (merit_next, merit_linear) = (self.next.merit(closing, mu_t) + pulled, self.linear.merit(closing, mu_t) + pulled);
            let predicted = merit - merit_linear;
            let falls = merit_next < merit;
            let near_linear = !closing && {
                let gap = step::nonlinearity(&self.next.c, &self.linear.c, &self.next.g, &self.linear.g).as_f64();
                gap < 0.3 * predicted.max(0.05 * f)
            };
            if falls || near_linear {
                let ratio = if predicted > 0. { (merit - merit_next) / predicted } else { 0. };
                return Attempt::Accepted { step: length.as_f64(), ratio };
            }
            *eps *= PROXIMAL_GROWTH;
        }
        Attempt::Refused
    }

    /// Corrects the direction of the predictor, Mehrotra's way: the farther the predictor could go, the lower the barrier it aims for, and
    /// the product of its steps is taken into account. Returns the length of the step.
    fn correct(&mut self, layout: &Layout<T>, predictor: Aim<T>, mu: &mut f64) -> T {
        let reach = step::slack_steps(&self.now.g, &self.change.g, predictor, &mut self.slacks);
        let before = step::mean_product(&self.slacks, T::zero()).as_f64();
        let after = step::mean_product(&self.slacks, reach).as_f64();
        *mu = (before * (after / before).clamp(0., 1.).powi(2)).max(BARRIER_FLOOR);
        let aim = Aim { mu: T::of(*mu), correction: reach };
        step::barrier_rows(layout, &self.now.c, &self.now.g, &self.slacks, aim, &mut self.weight, &mut self.value);
        let gradient = &mut self.trial[..layout.variables];
        step::transposed_times(layout, &self.jacobian, &self.value, &mut self.local, gradient);
        for (sum, own) in gradient.iter_mut().zip(&self.gradient) {
            *sum += *own;
        }
        front::forward(layout, &mut self.factor, gradient);
        front::substitute(layout, &mut self.factor, &mut self.direction);
        step::jacobian_times(layout, &self.jacobian, &self.direction, &mut self.local, &mut self.change.c, &mut self.change.g);
        step::slack_steps(&self.now.g, &self.change.g, aim, &mut self.slacks)
    }

    fn finished(&self, layout: &Layout<T>, finish: Finish, f: f64) -> bool {
        match finish {
            Finish::Infeasibility(tolerance) => f < tolerance,
            Finish::Rows(tolerance) => rows_hold(layout, &self.now.c, &self.now.g, tolerance),
        }
    }

    /// The stall rule, see [`crate::settings::StallSettings`]. Closing steps are never cut short.
    fn stalled(&self, settings: &SolverSettings) -> bool {
        let (rule, done) = (&settings.stall, self.history.len() - 1);
        if !rule.enabled || done < rule.start.max(self.stall_from + rule.window) {
            return false;
        }
        let (now, before) = (self.history[done], self.history[done - rule.window]);
        // Logarithmic distance left against that covered in the window, in windows.
        now > STALL_ABOVE * settings.closing && (now / settings.closing).ln() * rule.window as f64 > rule.budget * (before / now).ln()
    }

    /// `F` at the start and after each iteration of the last solve.
    pub fn history(&self) -> &[f64] {
        &self.history
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
