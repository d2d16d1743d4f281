//! Elastic primal-dual augmented-Lagrangian Gauss-Newton solver for one candidate.
//!
//! For scaled equalities `c(x) = 0` and inequalities `g(x) <= 0` with slacks `s`, multipliers `z` and penalty `rho = 1`, it minimises
//! `rho/2 |c|^2 + rho/2 |g + s|^2 - mu sum ln s` with a proximal term. Eliminating slacks and multipliers leaves one positive definite
//! system per iteration,
//!
//! `(eps D + rho Jc'Jc + Jg' W Jg) d = -(rho Jc' c + Jg'(z + w (g - z/rho + mu/z)))`, `w = 1 / (s/z + 1/rho)`,
//!
//! whose weights are bounded by `rho`, which makes it safe in f32. Each factorisation is used twice: a predictor with `mu = 0` determines
//! how far the barrier parameter can be reduced, and Mehrotra's corrector computes the step for that parameter. The multipliers have a step
//! length of their own. A step is refused if the merit does not decrease and the residuals are far from their linear model. It is then
//! shortened to a quarter and to a sixteenth, which costs no factorisation, and after that recomputed with larger `eps`. Near a solution,
//! closing steps (Gauss-Newton on the rows that are violated or nearly active) converge quadratically.
//!
//! The cost of a solved candidate can then be minimised, see [`minimise`].

pub mod advance;
mod close;
pub mod control;
pub mod correct;
pub mod judge;
pub mod minimise;
pub mod objective;
pub mod round;
pub mod slacks;
pub mod start;
mod status;
pub mod weights;

pub use close::{CONTINUE_BELOW, can_close, close};
pub use status::{Outcome, Status};

use crate::linear::NormalEquations;
use crate::linear::forward::forward;
use crate::linear::front::{Factor, factorise};
use crate::linear::product::jacobian_times;
use crate::linear::substitute::substitute;
use crate::linear::transposed::transposed_times;
use crate::nlp::Problem;
use crate::real::Real;
use crate::rows::{self, RowKind, Shared};
use crate::settings::SolverSettings;
use advance::{add, advance};
use aligned_vec::{AVec, CACHELINE_ALIGN};
use control::{CLOSE, EXACT, Limits, MINIMISE, Progress, RESTORE, REVERT, SHORTER, SOLVE, STEP};
use correct::correct;
use judge::{infeasibility, infeasibility_fall, merit_falls, nonlinearity, smoothing_fall, update_slacks};
use minimise::{add_shifts, subtract_shifts, update_shifts};
use objective::Objective;
use round::{ROUND, START, Stage, When};
use slacks::{BarrierTarget, Lengths, Slacks, largest, slack_steps};
use start::{column_scaling, resume_slacks, start_slacks};
use tracing::{Level, enabled, trace};
use weights::{barrier_rows, closing_reach, closing_rows, variable_terms};

/// Termination criterion of a solve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Finish {
    /// The scaled infeasibility `F`, margins included, is below this value.
    Infeasibility(f64),
    /// No row is violated by more than this value in its own unit (N, N m, m); margins do not count.
    Rows(f64),
}

/// Point near a minimum of the cost from which a solve is resumed, e.g. that of slightly different durations.
#[derive(Debug, Clone, Copy)]
pub struct Resume<'a> {
    /// Values of the variables, as in [`Problem::initial`].
    pub x: &'a [f64],
    /// Multipliers of the rows.
    pub multipliers: &'a Residuals<f64>,
    /// Barrier parameter at the start.
    pub barrier: f64,
    /// Largest number of iterations of the minimisation.
    pub iterations: usize,
}

/// Residuals at one point.
#[derive(Debug, Default, Clone)]
pub struct Residuals<T> {
    /// Residuals of equalities and cost rows.
    pub c: Vec<T>,
    /// Residuals of inequalities.
    pub g: Vec<T>,
}

impl<T: Real> Residuals<T> {
    fn resize(&mut self, problem: &Problem<T>) {
        self.c.resize(problem.rows.one_sided(), T::zero());
        self.g.resize(problem.inequalities, T::zero());
    }

    /// Arrays of these residuals, each with that of others.
    fn pairs<'a>(&'a mut self, others: &'a Residuals<T>) -> [(&'a mut [T], &'a [T]); 2] {
        [(&mut self.c, &others.c), (&mut self.g, &others.g)]
    }
}

/// Buffers for one candidate at a time. Created once per thread and reused, so that a solve allocates only when the candidate is larger
/// than all before.
#[derive(Debug)]
pub struct Solver<T> {
    x: Vec<T>,
    trial: Vec<T>,
    /// Values of the direction for the columns of one element.
    local: Vec<T>,
    direction: Vec<T>,
    scaling: Vec<T>,
    diagonal: Vec<T>,
    gradient: Vec<T>,
    right_hand_side: Vec<T>,
    shared: Shared<T>,
    now: Residuals<T>,
    next: Residuals<T>,
    change: Residuals<T>,
    linear: Residuals<T>,
    /// Jacobian at the current point, aligned to cache lines.
    jacobian: AVec<T>,
    /// Jacobian at the trial point, aligned to cache lines.
    next_jacobian: AVec<T>,
    /// Augmented-Lagrangian multipliers by which the residuals of equalities and inequalities are shifted while a cost is minimised.
    shift: Residuals<T>,
    /// Solved point from which the minimisation started.
    solved: Vec<T>,
    weight: Vec<T>,
    value: Vec<T>,
    slacks: Slacks<T>,
    factor: Factor<T>,
    /// True if the last factorisation met a pivot that is not positive.
    failed: bool,
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
            right_hand_side: Vec::new(),
            shared: Shared::default(),
            now: Residuals::default(),
            next: Residuals::default(),
            change: Residuals::default(),
            linear: Residuals::default(),
            jacobian: AVec::new(CACHELINE_ALIGN),
            next_jacobian: AVec::new(CACHELINE_ALIGN),
            shift: Residuals::default(),
            solved: Vec::new(),
            weight: Vec::new(),
            value: Vec::new(),
            slacks: Slacks::default(),
            factor: Factor::default(),
            failed: false,
            history: Vec::new(),
        }
    }
}

/// Data of one solve that stay constant.
#[derive(Clone, Copy)]
struct Solve<'a, T> {
    problem: &'a Problem<T>,
    limits: Limits<T>,
    finish: Finish,
}

impl<T: Real> Solver<T> {
    /// Solves one candidate from `start`, or from the initial values of the problem.
    ///
    /// The result does not depend on earlier solves. `cancel` ends the solve at the next iteration.
    pub fn solve(
        &mut self,
        problem: &Problem<T>,
        settings: &SolverSettings,
        finish: Finish,
        start: Option<&[f64]>,
        cancel: &dyn Fn() -> bool,
    ) -> Outcome {
        self.prepare(problem, start);
        let solve = Solve { problem, limits: Limits::new(settings, problem.curves.transcription), finish };
        let progress = solve.limits.first_progress(settings, problem);
        self.run(&solve, progress, cancel)
    }

    /// Minimises the cost of one candidate from a point near the minimum, then solves its rows.
    ///
    /// The outcome is not [`Status::Solved`] if the rows could not be solved again.
    pub fn resume(
        &mut self,
        problem: &Problem<T>,
        settings: &SolverSettings,
        finish: Finish,
        from: &Resume,
        cancel: &dyn Fn() -> bool,
    ) -> Outcome {
        self.prepare(problem, Some(from.x));
        let solve = Solve { problem, limits: Limits::new(settings, problem.curves.transcription), finish };
        for (shift, of) in [(&mut self.shift.c, &from.multipliers.c), (&mut self.shift.g, &from.multipliers.g)] {
            shift.clear();
            shift.extend(of.iter().map(|v| T::of(*v)));
        }
        self.shift.resize(problem);
        let progress = Progress::resumed(&solve.limits, T::of(from.barrier), from.iterations as u32);
        self.run(&solve, progress, cancel)
    }

    /// Runs a solve from its initial state.
    fn run(&mut self, solve: &Solve<T>, mut progress: Progress<T>, cancel: &dyn Fn() -> bool) -> Outcome {
        for stage in START {
            self.stage(stage, solve, &mut progress);
        }
        let status = self.iterate(solve, &mut progress, cancel);
        Outcome {
            status,
            iterations: progress.iterations as usize,
            factorisations: progress.factorisations as usize,
            infeasibility: progress.infeasibility.as_f64(),
        }
    }

    /// Runs rounds until the solve ends. Returns the status; `x` holds the last point. If a minimisation is cancelled, `x` returns to the
    /// solved point.
    fn iterate(&mut self, solve: &Solve<T>, progress: &mut Progress<T>, cancel: &dyn Fn() -> bool) -> Status {
        loop {
            if let Some(status) = Status::of(progress.state) {
                if status != Status::Solved {
                    trace!("{status} at infeasibility {:.2e}", progress.infeasibility.as_f64());
                }
                return status;
            }
            if progress.attempts == 0 && cancel() {
                if progress.phase == SOLVE || progress.minimise_iterations == 0 {
                    return Status::Cancelled;
                }
                self.revert(progress);
                return Status::Solved;
            }
            for (stage, when) in ROUND {
                self.turn(stage, when, solve, progress);
            }
        }
    }

    /// Runs a stage of the round if the state of the solve needs it.
    fn turn(&mut self, stage: Stage, when: When, solve: &Solve<T>, progress: &mut Progress<T>) {
        let judged = matches!(stage, Stage::Judge | Stage::Weights);
        let evaluated = stage == Stage::Rows && progress.state == EXACT;
        let directed = progress.state <= CLOSE && !self.failed && (when == When::Always || progress.state == STEP);
        let shorter = progress.state == SHORTER && matches!(stage, Stage::Advance | Stage::Rows);
        if judged || evaluated || directed || shorter {
            self.stage(stage, solve, progress);
        }
    }

    fn stage(&mut self, stage: Stage, solve: &Solve<T>, progress: &mut Progress<T>) {
        let problem = solve.problem;
        match stage {
            Stage::Start => self.start(solve, progress),
            Stage::Weights => {
                self.begin(solve, progress);
                self.weigh(solve, progress);
            }
            Stage::Factorise => {
                let system = NormalEquations {
                    jacobian: &self.jacobian,
                    weight: &self.weight,
                    value: &self.value,
                    diagonal: &self.diagonal,
                    gradient: &self.gradient,
                };
                self.failed = !factorise(problem, &system, &mut self.factor);
            }
            Stage::Substitute => substitute(problem, &mut self.factor, &mut self.direction),
            Stage::Product => {
                jacobian_times(problem, &self.jacobian, &self.direction, &mut self.local, &mut self.change.c, &mut self.change.g);
            }
            Stage::Correct => {
                let (now, rows) = (&self.now, [&mut self.weight[..], &mut self.value]);
                progress.mu = correct(problem, &now.c, &now.g, &self.change.g, &mut self.slacks, progress.barrier_floor, rows);
            }
            Stage::Transposed => {
                transposed_times(problem, &self.jacobian, &self.value, &mut self.local, &mut self.right_hand_side);
                add(&mut self.right_hand_side, &self.gradient);
            }
            Stage::Forward => forward(problem, &mut self.factor, &mut self.right_hand_side),
            Stage::Advance => self.advance(problem, progress),
            Stage::Rows => self.evaluate(problem, progress),
            Stage::Judge => self.judge(solve, progress),
        }
    }

    /// Makes the initial point, which was evaluated as a trial point, the current point; initialises scaling, slacks and multipliers.
    fn start(&mut self, solve: &Solve<T>, progress: &Progress<T>) {
        self.take_trial();
        column_scaling(solve.problem, &self.jacobian, &mut self.value, &mut self.local, &mut self.scaling);
        if progress.phase == MINIMISE {
            add_shifts(&mut self.now, &self.shift);
            resume_slacks(&self.now.g, progress.mu, &mut self.slacks);
        } else {
            start_slacks(&self.now.g, progress.mu, &mut self.slacks);
        }
    }

    /// Begins a round in the phase of the solve, or ends the solve.
    fn begin(&mut self, solve: &Solve<T>, progress: &mut Progress<T>) {
        if progress.attempts > 0 || progress.ended() {
            return;
        }
        if control::is_minimised(progress) {
            subtract_shifts(&mut self.now, &self.shift);
            control::restore(progress, &solve.limits);
            start_slacks(&self.now.g, progress.mu, &mut self.slacks);
        }
        match progress.phase {
            // Barrier steps only, also after a shortened one.
            MINIMISE => progress.state = STEP,
            REVERT => {}
            _ => self.choose(solve, progress),
        }
        if progress.phase == REVERT {
            self.revert(progress);
        }
    }

    /// Chooses the purpose of the round, starts the minimisation, or ends the solve.
    fn choose(&mut self, solve: &Solve<T>, progress: &mut Progress<T>) {
        let f = infeasibility(&self.now.c[solve.problem.rows.of(RowKind::Equality)], &self.now.g);
        let before = self.history.len().checked_sub(solve.limits.stall_window as usize).map_or(f, |at| self.history[at]);
        let largest = largest(&self.slacks.multiplier);
        control::begin(progress, &solve.limits, f, before, largest, self.finished(solve, f));
        if progress.state == EXACT {
            self.trial.clone_from(&self.x);
        } else {
            self.history.push(f);
        }
        if progress.phase == MINIMISE {
            self.solved.clone_from(&self.x);
            for shift in [&mut self.shift.c, &mut self.shift.g] {
                shift.clear();
            }
            self.shift.resize(solve.problem);
            start_slacks(&self.now.g, progress.mu, &mut self.slacks);
        }
    }

    /// Returns to the solved point from which the minimisation started.
    fn revert(&mut self, progress: &mut Progress<T>) {
        self.x.clone_from(&self.solved);
        control::revert(progress);
    }

    /// Computes the weights and values of the rows and the terms on single variables.
    fn weigh(&mut self, solve: &Solve<T>, progress: &mut Progress<T>) {
        let problem = solve.problem;
        if progress.state > CLOSE {
            return;
        }
        progress.factorisations += 1;
        self.failed = false;
        let now = &self.now;
        if progress.state == CLOSE {
            let reach = closing_reach(progress.infeasibility, progress.attempts);
            closing_rows(problem, &now.c, &now.g, reach, &mut self.weight, &mut self.value);
        } else {
            barrier_rows(problem, &now.c, &now.g, &self.slacks, BarrierTarget::predictor(), &mut self.weight, &mut self.value);
        }
        Objective::of(&solve.limits, progress).rows(problem, &now.c, &self.slacks.multiplier, &mut self.weight, &mut self.value);
        let (proximal, weight) = (progress.proximal(), progress.smoothing);
        variable_terms(problem, &self.scaling, proximal, weight, &self.x, &mut self.diagonal, &mut self.gradient);
    }

    /// Computes the step length, the trial point, and the linear model of the residuals there.
    fn advance(&mut self, problem: &Problem<T>, progress: &mut Progress<T>) {
        let lengths = match progress.state {
            CLOSE => Lengths::whole(),
            SHORTER => Lengths { primal: progress.length, dual: progress.dual_length },
            _ => slack_steps(&self.now.g, &self.change.g, BarrierTarget::corrector(progress.mu), &mut self.slacks),
        };
        (progress.length, progress.dual_length) = (lengths.primal, lengths.dual);
        let (variables, length) = (problem.variables, progress.length);
        advance(&self.x[..variables], length, &self.direction, &mut self.trial[..variables]);
        advance(&self.now.c, length, &self.change.c, &mut self.linear.c);
        advance(&self.now.g, length, &self.change.g, &mut self.linear.g);
    }

    /// Evaluates residuals and Jacobian at the trial point. The Jacobian is always computed, because nearly every trial point is accepted.
    fn evaluate(&mut self, problem: &Problem<T>, progress: &Progress<T>) {
        let (c, g) = (&mut self.next.c, &mut self.next.g);
        rows::residuals(problem, &self.trial, progress.edge_radius, &mut self.shared, c, g, Some(&mut self.next_jacobian));
    }

    /// Accepts or refuses the trial point.
    fn judge(&mut self, solve: &Solve<T>, progress: &mut Progress<T>) {
        if progress.state == EXACT {
            self.take_trial();
            return control::renew(progress);
        }
        if self.failed {
            return control::damp(progress);
        }
        let minimises = progress.phase == MINIMISE;
        if minimises {
            add_shifts(&mut self.next, &self.shift);
        }
        let (problem, now, next, linear) = (solve.problem, &self.now, &self.next, &self.linear);
        let equalities = problem.rows.of(RowKind::Equality);
        let [c, next_c, linear_c] = [now, next, linear].map(|at| &at.c[equalities.clone()]);
        let closing = progress.state == CLOSE;
        let [fall, predicted] = if closing {
            [(next, next_c), (linear, linear_c)].map(|(to, to_c)| infeasibility_fall(c, &now.g, to_c, &to.g))
        } else {
            merit_falls(c, &now.g, [(next_c, &next.g[..]), (linear_c, &linear.g[..])], progress.mu)
        };
        let smoothed = progress.smoothing * smoothing_fall(&problem.smoothing, &self.x, &self.trial, &problem.initial);
        let objective = Objective::of(&solve.limits, progress);
        let costs = [next, linear].map(|to| objective.fall(problem, &now.c, &to.c));
        let (fall, predicted) = (fall + smoothed + costs[0], predicted + smoothed + costs[1]);
        let gap = nonlinearity(next_c, linear_c, &next.g, &linear.g);
        if control::acceptable(progress, fall, predicted, gap) {
            if !closing {
                update_slacks(&mut self.slacks, Lengths { primal: progress.length, dual: progress.dual_length });
            }
            let ratio = if predicted > T::zero() { fall / predicted } else { T::zero() };
            control::accept(progress, &solve.limits, ratio);
            self.take_trial();
            if minimises {
                update_shifts(problem, &mut self.now, &mut self.shift, &self.slacks);
                control::minimised(progress, &solve.limits.minimise, predicted, objective.cost(problem, &self.now.c), problem.inequalities);
            }
            if enabled!(Level::TRACE) {
                self.log(solve, progress, minimises);
            }
        } else {
            control::refuse(progress);
        }
    }

    /// Logs the point after an accepted step.
    fn log(&self, solve: &Solve<T>, progress: &Progress<T>, minimises: bool) {
        let (problem, mut now) = (solve.problem, self.now.clone());
        if minimises {
            subtract_shifts(&mut now, &self.shift);
        }
        let purpose = match (progress.state, progress.phase) {
            _ if minimises => "minimise",
            (_, RESTORE) => "restore",
            (CLOSE, _) => "close",
            _ => "solve",
        };
        let f = infeasibility(&now.c[problem.rows.of(RowKind::Equality)], &now.g).as_f64();
        let objective = Objective { weight: T::one(), rounding: solve.limits.minimise.rounding_floor };
        let priced = !problem.cost_weights.is_empty();
        let cost = if priced { format!("cost {:.4}, ", objective.cost(problem, &now.c).as_f64()) } else { String::new() };
        let (step, barrier) = (progress.length.as_f64(), progress.mu.as_f64());
        trace!("iteration {}, {purpose}: infeasibility {f:.2e}, {cost}step {step:.3}, barrier {barrier:.1e}", progress.iterations);
    }

    /// Makes the trial point the current point.
    fn take_trial(&mut self) {
        std::mem::swap(&mut self.x, &mut self.trial);
        std::mem::swap(&mut self.now, &mut self.next);
        std::mem::swap(&mut self.jacobian, &mut self.next_jacobian);
    }

    /// The last point `x` in `f64`, fixed values included.
    pub fn solution(&self) -> Vec<f64> {
        self.x.iter().map(|v| v.as_f64()).collect()
    }

    fn prepare(&mut self, problem: &Problem<T>, start: Option<&[f64]>) {
        self.x.clear();
        self.x.extend_from_slice(&problem.initial);
        if let Some(start) = start {
            for (x, &v) in self.x[..problem.variables].iter_mut().zip(start) {
                *x = T::of(v);
            }
        }
        self.trial.clone_from(&self.x);
        self.direction.resize(problem.variables, T::zero());
        for v in [&mut self.scaling, &mut self.diagonal, &mut self.gradient, &mut self.right_hand_side] {
            v.resize(problem.variables, T::zero());
        }
        self.shared.resize(problem);
        for residuals in [&mut self.now, &mut self.next, &mut self.change, &mut self.linear] {
            residuals.resize(problem);
        }
        // The padding of Jacobian rows must be zero, because no kernel writes it.
        for jacobian in [&mut self.jacobian, &mut self.next_jacobian] {
            jacobian.clear();
            jacobian.resize(problem.jacobian_len, T::zero());
        }
        self.local.resize(problem.widest, T::zero());
        self.weight.resize(problem.rows.all(), T::zero());
        self.value.resize(problem.rows.all(), T::zero());
        for v in [&mut self.slacks.slack, &mut self.slacks.multiplier, &mut self.slacks.slack_step, &mut self.slacks.multiplier_step] {
            v.resize(problem.inequalities, T::zero());
        }
        self.factor.resize(problem);
        self.history.clear();
    }

    fn finished(&self, solve: &Solve<T>, f: T) -> bool {
        match solve.finish {
            Finish::Infeasibility(tolerance) => f < T::of(tolerance),
            Finish::Rows(tolerance) => rows_hold(solve.problem, &self.now.c, &self.now.g, tolerance),
        }
    }

    /// Cost of the last point by the cost rows of its problem.
    pub fn cost(&self, problem: &Problem<T>, settings: &SolverSettings) -> f64 {
        let objective = Objective { weight: T::one(), rounding: T::of(settings.optimise.rounding_floor) };
        objective.cost(problem, &self.now.c).as_f64()
    }

    /// Multipliers of the rows at the end of the last minimisation, relative to the weight of the cost.
    pub fn multipliers(&self) -> Residuals<f64> {
        let values = |v: &[T]| v.iter().map(|v| v.as_f64()).collect();
        Residuals { c: values(&self.shift.c), g: values(&self.shift.g) }
    }

    /// Infeasibility `F` at the start and after each iteration of the last solve.
    pub fn history(&self) -> Vec<f64> {
        self.history.iter().map(|f| f.as_f64()).collect()
    }
}

/// True if no row is violated by more than `tolerance` in its own unit, margins excluded.
fn rows_hold<T: Real>(problem: &Problem<T>, c: &[T], g: &[T], tolerance: f64) -> bool {
    let tolerance = T::of(tolerance);
    problem.all_elements().all(|element| {
        let (row, at, rows) = (element.place.row as usize, element.place.inequality as usize, element.rows as usize);
        let allowed = |r: usize| element.family.allowed(&problem.constants, r, tolerance);
        match element.kind() {
            RowKind::Equality => (0..rows).all(|r| c[row + r].abs() <= allowed(r)),
            RowKind::Cost => true,
            RowKind::Inequality => (0..rows + element.pairs as usize).all(|r| g[at + r] <= allowed(r)),
        }
    })
}
