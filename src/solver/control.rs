//! Control of the iteration for one candidate: barrier steps, closing steps, proximal weight, and termination.
//!
//! A solve is a sequence of rounds. A round begins with the infeasibility at the current point ([`begin`]), computes a trial point, and
//! ends by accepting ([`accept`]) or refusing it ([`refuse`]). A refused step is first shortened along the same direction, which costs no
//! factorisation. If that fails too, the next direction is computed with a larger proximal weight ([`damp`]).
//!
//! If the settings ask for it, a solved candidate goes through two more phases: barrier steps minimise its cost ([`MINIMISE`]), then the
//! rows are solved again ([`RESTORE`]). If that fails, the solve returns to the solved point ([`REVERT`]).

use super::slacks::BARRIER_FLOOR;
use crate::nlp::Problem;
use crate::real::Real;
use crate::rows::table::NONE;
use crate::settings::{NO_LIMIT, OptimiseSettings, SmoothSettings, SolverSettings, Transcription};

/// The next trial point is a barrier step.
pub const STEP: u32 = 0;
/// The next trial point is a closing step: Gauss-Newton on the equalities and on the inequalities that are violated or nearly active.
pub const CLOSE: u32 = 1;
/// The next trial point is the current point itself, re-evaluated with exact instead of rounded terrain edges.
pub const EXACT: u32 = 2;
/// The next trial point is the refused barrier step, shortened.
pub const SHORTER: u32 = 3;
/// First of the states in which the solve has ended.
pub const ENDED: u32 = SOLVED;
/// See [`Status::Solved`](crate::solver::Status::Solved).
pub const SOLVED: u32 = 4;
/// See [`Status::MaxIterations`](crate::solver::Status::MaxIterations).
pub const MAX_ITERATIONS: u32 = 5;
/// See [`Status::Stalled`](crate::solver::Status::Stalled).
pub const STALLED: u32 = 6;
/// See [`Status::NonFinite`](crate::solver::Status::NonFinite).
pub const NON_FINITE: u32 = 7;
/// See [`Status::TerminatedEarly`](crate::solver::Status::TerminatedEarly).
pub const TERMINATED_EARLY: u32 = 8;
/// See [`Status::StepsRefused`](crate::solver::Status::StepsRefused).
pub const STEPS_REFUSED: u32 = 9;

/// Phase of a solve: the rows are solved.
pub const SOLVE: u32 = 0;
/// Phase of a solve: the cost of the solved point is minimised.
pub const MINIMISE: u32 = 1;
/// Phase of a solve: the minimisation is over, and the next round begins to restore the rows.
pub const RESTORE_NEXT: u32 = 2;
/// Phase of a solve: the rows are solved again, without the cost.
pub const RESTORE: u32 = 3;
/// Phase of a solve: restoring failed, and the next round returns to the solved point.
pub const REVERT: u32 = 4;

/// Largest barrier parameter with which smoothing starts: near rows bend the cost early.
pub const SMOOTH_BARRIER: f64 = 2e-4;
/// Barrier parameter with which the rows are solved again after the cost rows were minimised: the active rows are known.
pub const RESTORE_BARRIER: f64 = 1e-6;
/// Length of a step from which its predicted fall of the cost says how far the optimum is.
pub const TRUSTED_LENGTH: f64 = 0.5;

/// Largest ratio of the infeasibilities after and before a closing step for which closing steps continue. While the rows are restored
/// after a minimisation, they always continue: barrier steps from an optimum on its limits are refused in f32. With this limit the
/// restoration failed for 3 of 47 periodic gaits, and their minimisation was lost.
pub const CLOSING_RATE: f64 = 0.1;
/// Ratio to the infeasibility at which closing steps failed, below which they are tried again.
pub const CLOSING_AGAIN: f64 = 0.1;
/// Largest ratio of `gap` to the predicted decrease for which [`acceptable`] accepts a trial point whose merit does not fall.
pub const NEAR_LINEAR: f64 = 0.3;
/// Smallest predicted decrease with which [`acceptable`] compares `gap`, as a fraction of the infeasibility.
pub const NEAR_LINEAR_FLOOR: f64 = 0.05;
/// Ratio of actual to predicted decrease above which the proximal weight shrinks.
pub const GOOD_RATIO: f64 = 0.7;
/// Ratio of actual to predicted decrease below which the proximal weight grows.
pub const POOR_RATIO: f64 = 0.25;
/// As [`POOR_RATIO`], while a cost is minimised. The model leaves out the curvature of the constraints: without more damping the iterations
/// oscillate about the optimum. A hexapod's tripod gait of 0.5 m was at 1.978 after 20 and after 40 iterations; it is at 1.958 and 1.954.
pub const MINIMISE_POOR_RATIO: f64 = 0.5;
/// Divisor of the proximal weight after a good step.
pub const GOOD_DIVISOR: f64 = 4.;
/// Factor of the proximal weight after a poor step.
pub const POOR_FACTOR: f64 = 2.;
/// As [`POOR_FACTOR`], while a cost is minimised.
pub const MINIMISE_POOR_FACTOR: f64 = 4.;
/// Smallest barrier parameter of a minimisation, as a multiple of the predicted fall of a whole step per inequality. Without it the barrier
/// parameter falls long before the cost does, and slacks near zero shorten every step: HyQ's bound of 3 m was at 2.264 after 40
/// iterations; it is at 2.144, and its optimum is 2.142.
pub const BARRIER_PER_FALL: f64 = 2.;
/// Upper limit of this smallest barrier parameter. With 1e-6 and less damping the tripod gait was at 2.073 after 40 iterations.
pub const LARGEST_BARRIER_FLOOR: f64 = 3e-7;
/// Target infeasibility from which the stall rule extrapolates the iterations still needed.
pub const STALL_TARGET: f64 = 1e-6;
/// Infeasibility above which the stall rule applies. Below it, rounding errors can stop the progress for a few iterations.
pub const STALL_ABOVE: f64 = 1e-5;
/// First iteration after which early termination applies. When it was 5 instead of 2, failing candidates ended after 8.4 instead of 7.3
/// iterations, and as many solvable ones were lost.
pub const EARLY_TERMINATION_FROM: u32 = 2;
/// Last iteration after which early termination applies. Later, slow progress is judged by the stall rule alone.
pub const EARLY_TERMINATION_TO: u32 = 15;
/// Last iterations for which the first and the second of [`early_termination_rates`] apply.
pub const EARLY_TERMINATION_KNEES: [u32; 2] = [4, 7];
/// Number of shorter steps that are tried along a refused direction.
pub const SHORTENINGS: u32 = 2;
/// Factor by which each shorter step reduces the step length. Two quarters solve 587 of 976 candidates, two halvings 564, four
/// halvings 582, and a larger proximal weight without shorter steps 545.
pub const SHORTENING: f64 = 0.25;
/// Refused attempts after which an iteration ends as stalled. Every attempt after the shorter steps has a larger proximal weight.
pub const ATTEMPTS: u32 = SHORTENINGS + 6;
/// Growth factor of the proximal weight after a refused attempt.
pub const PROXIMAL_GROWTH: f64 = 6.;
/// As [`PROXIMAL_GROWTH`], for closing steps. Near the tip of a friction cone only strongly damped steps decrease the infeasibility. Of 240
/// trots that were minimised in 12 iterations, the rows of 10 were not restored with barrier steps instead, of 5 with 6, of none with 36.
pub const CLOSING_GROWTH: f64 = 36.;

crate::table! {
    /// State of the solve of one candidate.
    #[derive(Default, PartialEq)]
    pub struct Progress<T> {
        /// Purpose of the next trial point, or how the solve ended.
        pub state: u32,
        /// Half of the buffers (0 or 1) that holds the current point; the other half holds the trial point.
        pub current: u32,
        /// Accepted steps.
        pub iterations: u32,
        /// Factorisations, refused attempts included.
        pub factorisations: u32,
        /// Attempts refused since the last accepted step.
        pub attempts: u32,
        /// Number of infeasibilities recorded.
        pub recorded: u32,
        /// First record that the stall rule may use; earlier records belong to rounded rows or to another phase.
        pub stall_from: u32,
        /// Phase of the solve, from [`SOLVE`] to [`REVERT`].
        pub phase: u32,
        /// Largest number of iterations of the minimisation; 0 if the candidate has no cost to minimise.
        pub minimise_iterations: u32,
        /// Number of accepted steps at which the minimisation ends.
        pub minimise_until: u32,
        /// Infeasibility `F` at the current point.
        pub infeasibility: T,
        /// Barrier parameter.
        pub mu: T,
        /// Smallest barrier parameter of the next step.
        pub barrier_floor: T,
        /// Initial barrier parameter.
        pub barrier: T,
        /// Weight of the smoothing term, which attracts the variables to their initial values.
        pub smoothing: T,
        /// Proximal weight of barrier steps.
        pub eps: T,
        /// Proximal weight of closing steps.
        pub closing_eps: T,
        /// Infeasibility below which closing steps are tried.
        pub closing_below: T,
        /// Infeasibility before the last barrier or closing step.
        pub closing_from: T,
        /// Radius with which terrain edges are rounded, m; 0 once closing steps have begun.
        pub edge_radius: T,
        /// Early-termination limit on `infeasibility * largest inequality multiplier / length of the last step`. Without a solution the
        /// multipliers grow, the steps become short and the infeasibility stays, so the product of the three reveals it before any one of
        /// them does. Calibrated on 23,400 candidates that were solved without any rule; `benches/README.md` shows the losses.
        pub early_termination_limit: T,
        /// Length of the primal step to the trial point, 0 to 1.
        pub length: T,
        /// Length of the step of the multipliers, 0 to 1.
        pub dual_length: T,
        /// Rounding of the absolute values of cost rows, m/s.
        pub rounding: T,
        /// Infeasibility at the solved point from which the minimisation started.
        pub solved_infeasibility: T,
    }
}

/// [`SolverSettings`] as scalars of the solver.
#[derive(Debug, Clone, Copy)]
pub struct Limits<T> {
    /// Iteration limit.
    pub max_iterations: u32,
    /// First record at which the stall rule may end a solve; [`NONE`] disables the rule.
    pub stall_start: u32,
    /// Number of iterations over which the stall rule measures the rate of convergence.
    pub stall_window: u32,
    /// Largest number of further iterations that the stall rule allows a candidate.
    pub stall_budget: T,
    /// Initial proximal weight.
    pub proximal: T,
    /// Smallest proximal weight.
    pub proximal_floor: T,
    /// Weight of the smoothing term at the initial barrier parameter.
    pub smoothing: T,
    /// Infeasibility below which closing steps start.
    pub closing: T,
    /// See [`early_termination_rates`].
    pub early_termination_rates: [T; 3],
    /// Minimisation of the cost of a solved candidate.
    pub minimise: Minimisation<T>,
}

/// [`SmoothSettings`] and [`OptimiseSettings`] as scalars of the solver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Minimisation<T> {
    /// Largest number of iterations; 0 disables the minimisation.
    pub iterations: u32,
    /// Barrier parameter at the start.
    pub barrier: T,
    /// Barrier parameter with which the rows are solved again.
    pub restore_barrier: T,
    /// Weight of the smoothing term; 0 without smoothing.
    pub smoothing: T,
    /// Weight of the cost rows; 0 if they are not minimised.
    pub weight: T,
    /// Rounding of the absolute values of cost rows at the start, m/s.
    pub rounding: T,
    /// Smallest rounding, m/s.
    pub rounding_floor: T,
    /// Predicted relative fall of the cost at which the minimisation ends.
    pub tolerance: T,
    /// Weighted cost above which the minimisation ends.
    pub cost_limit: T,
}

impl<T: Real> Minimisation<T> {
    /// Minimisation with these settings: of the smoothing term, of the cost rows, or of their sum.
    pub fn new(settings: &SolverSettings, transcription: Transcription) -> Self {
        let SolverSettings { smooth, optimise, .. } = settings;
        let (smooths, optimises) = (smooth.iterations > 0, optimise.iterations > 0);
        let part = |on: bool, value: f64| if on { T::of(value) } else { T::zero() };
        let least = |smoothing: f64, objective: f64| match (smooths, optimises) {
            (true, true) => smoothing.min(objective),
            (true, false) => smoothing,
            (false, _) => objective,
        };
        let SmoothSettings { weight: smoothing, .. } = *smooth;
        let OptimiseSettings { weight, barrier, rounding, rounding_floor, tolerance, cost_limit, .. } = *optimise;
        let smooth_barrier = settings.barrier(transcription).min(SMOOTH_BARRIER);
        Minimisation {
            iterations: smooth.iterations.max(optimise.iterations) as u32,
            barrier: T::of(least(smooth_barrier, barrier)),
            restore_barrier: T::of(least(smooth_barrier, RESTORE_BARRIER)),
            smoothing: part(smooths, smoothing),
            weight: part(optimises, weight),
            rounding: T::of(rounding),
            rounding_floor: T::of(rounding_floor),
            tolerance: T::of(tolerance),
            cost_limit: T::of(cost_limit.map_or(NO_LIMIT, |limit| weight * limit)),
        }
    }

    /// Rounding of absolute values at a barrier parameter, m/s: it follows the root of the parameter down to its floor.
    fn rounding_at(&self, mu: T) -> T {
        let part = (mu / self.barrier).sqrt().min(T::one());
        (self.rounding * part).max(self.rounding_floor)
    }

    /// True if a candidate has a cost with these weights.
    fn applies_to(&self, problem: &Problem<T>) -> bool {
        let smooths = self.smoothing > T::zero() && problem.smoothing.iter().any(|weight| *weight != T::zero());
        smooths || (self.weight > T::zero() && !problem.cost_weights.is_empty())
    }
}

/// Factors by which [`Progress::early_termination_limit`] shrinks per iteration: up to the first of [`EARLY_TERMINATION_KNEES`], up to the
/// second, and afterwards.
pub fn early_termination_rates(transcription: Transcription) -> [f64; 3] {
    match transcription {
        Transcription::Momentum => [0.1, 0.2, 0.8],
        Transcription::Towr => [0.25, 0.45, 0.6],
    }
}

impl<T: Real> Limits<T> {
    /// Limits of a solve with these settings.
    pub fn new(settings: &SolverSettings, transcription: Transcription) -> Self {
        let stall = &settings.stall;
        Limits {
            max_iterations: settings.max_iterations as u32,
            stall_start: if stall.enabled { stall.start as u32 } else { NONE },
            stall_window: stall.window as u32,
            stall_budget: T::of(stall.budget),
            proximal: T::of(settings.proximal),
            proximal_floor: T::of(settings.proximal_floor),
            smoothing: T::of(settings.smoothing),
            closing: T::of(settings.closing),
            early_termination_rates: early_termination_rates(transcription).map(T::of),
            minimise: Minimisation::new(settings, transcription),
        }
    }

    /// Initial state of the solve of one candidate.
    pub fn first_progress(&self, settings: &SolverSettings, problem: &Problem<T>) -> Progress<T> {
        let (transcription, rows) = (problem.curves.transcription, problem.rows.all());
        let (barrier, early_termination_limit) = (settings.barrier(transcription), settings.early_termination_limit(transcription, rows));
        let first = Progress::first(self, T::of(barrier), T::of(settings.edge_radius_on(&problem.terrain)));
        let minimise_iterations = if self.minimise.applies_to(problem) { self.minimise.iterations } else { 0 };
        Progress { early_termination_limit: T::of(early_termination_limit), minimise_iterations, ..first }
    }
}

impl<T: Real> Progress<T> {
    /// Initial state of a solve without early termination.
    ///
    /// * `barrier` - see [`SolverSettings::barrier`]
    pub fn first(limits: &Limits<T>, barrier: T, edge_radius: T) -> Self {
        Progress {
            barrier,
            mu: barrier,
            barrier_floor: T::of(BARRIER_FLOOR),
            eps: limits.proximal,
            closing_eps: limits.proximal_floor,
            closing_below: limits.closing,
            closing_from: T::infinity(),
            edge_radius,
            early_termination_limit: T::of(NO_LIMIT),
            length: T::one(),
            dual_length: T::one(),
            ..Progress::default()
        }
    }

    /// Initial state of a solve that begins with the minimisation, from a point near a minimum.
    ///
    /// * `barrier` - barrier parameter at the start
    /// * `iterations` - largest number of iterations of the minimisation
    pub fn resumed(limits: &Limits<T>, barrier: T, iterations: u32) -> Self {
        let mut progress = Progress::first(limits, barrier, T::zero());
        enter(&mut progress, limits, MINIMISE, barrier);
        progress.minimise_until = iterations;
        progress.smoothing = limits.minimise.smoothing;
        progress.rounding = limits.minimise.rounding_at(barrier);
        progress
    }

    /// True if the solve has ended.
    pub fn ended(&self) -> bool {
        self.state >= ENDED
    }

    /// Proximal weight in force.
    pub fn proximal(&self) -> T {
        if self.state == CLOSE { self.closing_eps } else { self.eps }
    }

    /// Sets the proximal weight in force.
    fn set_proximal(&mut self, eps: T) {
        if self.state == CLOSE {
            self.closing_eps = eps;
        } else {
            self.eps = eps;
        }
    }
}

/// Chooses the purpose of the round, starts the minimisation, or ends the solve. Not for the phases [`MINIMISE`] and [`REVERT`].
///
/// * `f` - infeasibility at the current point
/// * `before` - infeasibility `stall_window` records ago; arbitrary if there are fewer records
/// * `largest` - largest multiplier of an inequality
/// * `feasible` - true if all rows are satisfied
pub fn begin<T: Real>(progress: &mut Progress<T>, limits: &Limits<T>, f: T, before: T, largest: T, feasible: bool) {
    progress.infeasibility = f;
    progress.recorded += 1;
    if !f.is_finite() {
        progress.state = NON_FINITE;
    } else if f < limits.closing && progress.edge_radius > T::zero() {
        // Close enough to a solution: evaluate the exact rows from here on.
        progress.edge_radius = T::zero();
        progress.recorded -= 1;
        progress.stall_from = progress.recorded;
        progress.state = EXACT;
    } else if feasible {
        progress.state = SOLVED;
    } else if progress.iterations >= last_iteration(progress, limits) {
        progress.state = MAX_ITERATIONS;
    } else if stalled(progress, limits, f, before) {
        progress.state = STALLED;
    } else if ends_early(progress, f, largest) {
        progress.state = TERMINATED_EARLY;
    } else {
        let mut closing = progress.state == CLOSE;
        let slow = f > T::of(CLOSING_RATE) * progress.closing_from;
        if closing && slow && progress.phase != RESTORE && limits.closing.is_finite() {
            // Closing steps act on the wrong set of violated rows: return to barrier steps until the set is better known.
            closing = false;
            progress.closing_below = progress.closing_below.min(T::of(CLOSING_AGAIN) * f);
        }
        closing = closing || f < progress.closing_below;
        progress.closing_from = f;
        progress.state = if closing { CLOSE } else { STEP };
        let smooths = !closing && progress.phase == SOLVE;
        progress.smoothing = if smooths { limits.smoothing * progress.mu / progress.barrier } else { T::zero() };
        if !closing {
            progress.closing_eps = limits.proximal_floor;
        }
    }
    if may_end_early(progress) && progress.state != EXACT {
        let knees = EARLY_TERMINATION_KNEES.iter().filter(|&&knee| progress.recorded > knee).count();
        progress.early_termination_limit *= limits.early_termination_rates[knees];
    }
    if progress.phase == RESTORE && progress.ended() && progress.state != SOLVED && can_revert(progress) {
        progress.phase = REVERT;
    } else if progress.phase == SOLVE && progress.state == SOLVED && progress.minimise_iterations > 0 {
        minimise(progress, limits);
    }
}

/// True if the minimisation started from a solved point of this solve. A resumed one did not, see [`Progress::resumed`].
fn can_revert<T: Real>(progress: &Progress<T>) -> bool {
    progress.minimise_iterations > 0
}

/// Iteration limit of the phase.
fn last_iteration<T: Real>(progress: &Progress<T>, limits: &Limits<T>) -> u32 {
    if progress.phase == RESTORE { progress.minimise_until + limits.max_iterations } else { limits.max_iterations }
}

/// Begins a phase with barrier steps, whose proximal weight is the smallest.
fn enter<T: Real>(progress: &mut Progress<T>, limits: &Limits<T>, phase: u32, barrier: T) {
    progress.phase = phase;
    progress.state = STEP;
    progress.stall_from = progress.recorded;
    progress.mu = barrier;
    progress.barrier_floor = T::of(BARRIER_FLOOR);
    progress.barrier = barrier;
    progress.smoothing = T::zero();
    progress.eps = limits.proximal_floor;
    progress.closing_eps = limits.proximal_floor;
    progress.closing_below = limits.closing;
    progress.edge_radius = T::zero();
    progress.length = T::one();
    progress.dual_length = T::one();
}

/// Begins the minimisation at a solved point.
fn minimise<T: Real>(progress: &mut Progress<T>, limits: &Limits<T>) {
    enter(progress, limits, MINIMISE, limits.minimise.barrier);
    progress.minimise_until = progress.iterations + progress.minimise_iterations;
    progress.smoothing = limits.minimise.smoothing;
    progress.rounding = limits.minimise.rounding;
    progress.solved_infeasibility = progress.infeasibility;
}

/// True if the minimisation is over and the rows must be restored.
pub fn is_minimised<T: Real>(progress: &Progress<T>) -> bool {
    progress.phase == RESTORE_NEXT || (progress.phase == MINIMISE && progress.iterations >= progress.minimise_until)
}

/// Begins to solve the rows again.
pub fn restore<T: Real>(progress: &mut Progress<T>, limits: &Limits<T>) {
    enter(progress, limits, RESTORE, limits.minimise.restore_barrier);
}

/// Ends the solve at the solved point from which the minimisation started.
pub fn revert<T: Real>(progress: &mut Progress<T>) {
    progress.phase = REVERT;
    progress.state = SOLVED;
    progress.infeasibility = progress.solved_infeasibility;
}

/// Updates the minimisation after an accepted step: ends it near the optimum or above the limit of the cost, rounds absolute values less as
/// the barrier falls, and keeps the barrier in proportion to the predicted fall. Above the limit, a resumed minimisation ends the solve,
/// because it has no solved point.
///
/// * `predicted` - decrease of merit and cost that the linear model predicted for the step
/// * `cost` - weighted cost at the new point
/// * `inequalities` - number of inequalities
pub fn minimised<T: Real>(progress: &mut Progress<T>, minimise: &Minimisation<T>, predicted: T, cost: T, inequalities: usize) {
    let sharp = progress.rounding <= minimise.rounding_floor;
    // Only a long step says how far the optimum is.
    let trusted = minimise.weight > T::zero() && sharp && progress.length > T::of(TRUSTED_LENGTH);
    if cost > minimise.cost_limit && !can_revert(progress) {
        progress.state = TERMINATED_EARLY;
    } else if cost > minimise.cost_limit || (trusted && predicted < minimise.tolerance * cost) {
        progress.phase = RESTORE_NEXT;
    }
    progress.rounding = minimise.rounding_at(progress.mu);
    let floor = T::of(BARRIER_PER_FALL) * predicted / (progress.length * T::of(inequalities.max(1) as f64));
    progress.barrier_floor = floor.min(T::of(LARGEST_BARRIER_FLOOR)).max(T::of(BARRIER_FLOOR));
}

/// Stall rule, see [`crate::settings::StallSettings`]. It never interrupts closing steps.
fn stalled<T: Real>(progress: &Progress<T>, limits: &Limits<T>, f: T, before: T) -> bool {
    let done = progress.recorded - 1;
    if limits.stall_start == NONE || done < limits.stall_start.max(progress.stall_from + limits.stall_window) {
        return false;
    }
    // Logarithmic decrease still needed, relative to the decrease over the window, in windows.
    let window = T::of(f64::from(limits.stall_window));
    f > T::of(STALL_ABOVE) && (f / T::of(STALL_TARGET)).ln() * window > limits.stall_budget * (before / f).ln()
}

/// True if the candidate exceeds the early-termination limit for its iteration.
fn ends_early<T: Real>(progress: &Progress<T>, f: T, largest: T) -> bool {
    may_end_early(progress) && f * largest > progress.early_termination_limit * progress.length
}

/// True if early termination applies after this number of iterations.
fn may_end_early<T: Real>(progress: &Progress<T>) -> bool {
    progress.phase == SOLVE && progress.recorded > EARLY_TERMINATION_FROM && progress.recorded <= EARLY_TERMINATION_TO + 1
}

/// True if the trial point is acceptable: the merit decreases, or the residuals are close to their linear model.
///
/// * `fall` - actual decrease of the merit
/// * `predicted` - decrease of the merit predicted by the linear model
/// * `gap` - half the squared distance of the residuals from that model
pub fn acceptable<T: Real>(progress: &Progress<T>, fall: T, predicted: T, gap: T) -> bool {
    let near_linear = gap < T::of(NEAR_LINEAR) * predicted.max(T::of(NEAR_LINEAR_FLOOR) * progress.infeasibility);
    fall.is_finite() && gap.is_finite() && (fall > T::zero() || (progress.state != CLOSE && near_linear))
}

/// Makes the trial point the current point.
///
/// * `ratio` - actual over predicted decrease of the merit
pub fn accept<T: Real>(progress: &mut Progress<T>, limits: &Limits<T>, ratio: T) {
    let eps = progress.proximal();
    // A shortened step leaves the proximal weight unchanged: its direction was good.
    let whole = progress.state != SHORTER;
    let minimises = progress.phase == MINIMISE;
    let (poor, factor) = if minimises { (MINIMISE_POOR_RATIO, MINIMISE_POOR_FACTOR) } else { (POOR_RATIO, POOR_FACTOR) };
    if whole && ratio > T::of(GOOD_RATIO) {
        progress.set_proximal((eps / T::of(GOOD_DIVISOR)).max(limits.proximal_floor));
    } else if whole && ratio < T::of(poor) {
        progress.set_proximal(eps * T::of(factor));
    }
    progress.iterations += 1;
    renew(progress);
}

/// Swaps the buffers after the current point was re-evaluated with exact rows.
pub fn renew<T: Real>(progress: &mut Progress<T>) {
    progress.attempts = 0;
    progress.current = 1 - progress.current;
}

/// Rejects the trial point: shortens the step along the same direction, or requests a new direction.
pub fn refuse<T: Real>(progress: &mut Progress<T>) {
    if progress.state == CLOSE || progress.attempts >= SHORTENINGS {
        return damp(progress);
    }
    progress.attempts += 1;
    progress.state = SHORTER;
    progress.length *= T::of(SHORTENING);
    progress.dual_length *= T::of(SHORTENING);
}

/// Rejects the direction: requests one with a larger proximal weight, returns from closing to barrier steps, or ends the solve.
/// While the rows are restored, closing steps are first tried with larger proximal weights: barrier steps from an optimum on its limits are
/// refused.
/// A minimisation that stalls is over; rows that cannot be restored revert to the solved point.
///
/// An infinite [`SolverSettings::closing`] allows closing steps only. Such solves run on the CPU only, see `src/solver/close.rs`.
pub fn damp<T: Real>(progress: &mut Progress<T>) {
    let damps = progress.phase == RESTORE && progress.attempts + 1 < ATTEMPTS;
    if progress.state == CLOSE && progress.closing_below.is_finite() && !damps {
        // Return to barrier steps until the set of violated rows is better known.
        progress.state = STEP;
        progress.attempts = 0;
        progress.closing_below = T::of(CLOSING_AGAIN) * progress.closing_below.min(progress.infeasibility);
        return;
    }
    let growth = if progress.state == CLOSE { CLOSING_GROWTH } else { PROXIMAL_GROWTH };
    progress.set_proximal(progress.proximal() * T::of(growth));
    progress.attempts = progress.attempts.max(SHORTENINGS) + 1;
    if progress.state == SHORTER {
        progress.state = STEP;
    }
    if progress.attempts == ATTEMPTS {
        progress.attempts = 0;
        match progress.phase {
            MINIMISE => (progress.state, progress.phase) = (STEP, RESTORE_NEXT),
            RESTORE if can_revert(progress) => (progress.state, progress.phase) = (STEP, REVERT),
            _ => progress.state = STEPS_REFUSED,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::StallSettings;

    const BARRIER: f64 = 0.0625;

    const LIMITS: Limits<f64> = Limits {
        max_iterations: 50,
        stall_start: 10,
        stall_window: 4,
        stall_budget: 200.,
        proximal: 1e-3,
        proximal_floor: 1e-5,
        smoothing: 0.1,
        closing: 1e-6,
        early_termination_rates: [1.; 3],
        minimise: Minimisation {
            iterations: 12,
            barrier: 4e-4,
            restore_barrier: 1e-5,
            smoothing: 0.01,
            weight: 0.02,
            rounding: 1e-2,
            rounding_floor: 1e-3,
            tolerance: 0.1,
            cost_limit: 2.,
        },
    };

    fn first() -> Progress<f64> {
        Progress::first(&LIMITS, BARRIER, 0.)
    }

    /// State after the beginning of a round at infeasibility `f`, with unsatisfied rows and no decrease to measure.
    fn begun(mut progress: Progress<f64>, limits: &Limits<f64>, f: f64) -> Progress<f64> {
        begin(&mut progress, limits, f, f64::INFINITY, 1., false);
        progress
    }

    /// State in a closing step from infeasibility `f`.
    fn closing(f: f64) -> Progress<f64> {
        let progress = begun(first(), &LIMITS, f);
        assert_eq!(progress.state, CLOSE);
        progress
    }

    fn refused(mut progress: Progress<f64>, times: u32) -> Progress<f64> {
        (0..times).for_each(|_| refuse(&mut progress));
        progress
    }

    fn accepted(mut progress: Progress<f64>, ratio: f64) -> Progress<f64> {
        accept(&mut progress, &LIMITS, ratio);
        progress
    }

    fn assert_close(got: f64, expected: f64) {
        assert!((got - expected).abs() <= 1e-14 * expected.abs(), "{got:e} against {expected:e}");
    }

    #[test]
    fn limits_match_the_settings() {
        let stall = StallSettings { start: 7, window: 3, budget: 90., ..StallSettings::default() };
        let settings = SolverSettings { max_iterations: 12, smoothing: 0.5, closing: 1e-3, stall, ..SolverSettings::default() };
        let limits = Limits::<f64>::new(&settings, Transcription::Momentum);
        assert_eq!((limits.max_iterations, limits.stall_start, limits.stall_window, limits.stall_budget), (12, 7, 3, 90.));
        assert_eq!((limits.smoothing, limits.closing), (0.5, 1e-3));
        assert_eq!((limits.proximal, limits.proximal_floor), (settings.proximal, settings.proximal_floor));
        let stall = StallSettings { enabled: false, ..StallSettings::default() };
        assert_eq!(Limits::<f64>::new(&SolverSettings { stall, ..settings }, Transcription::Towr).stall_start, NONE);
    }

    #[test]
    fn a_solve_starts_with_a_barrier_step_at_the_configured_weights() {
        let progress = begun(Progress::first(&LIMITS, BARRIER, 0.04), &LIMITS, 3.);
        let expected = Progress {
            state: STEP,
            recorded: 1,
            infeasibility: 3.,
            mu: BARRIER,
            barrier_floor: BARRIER_FLOOR,
            barrier: BARRIER,
            smoothing: 0.1,
            eps: 1e-3,
            closing_eps: 1e-5,
            closing_below: 1e-6,
            closing_from: 3.,
            edge_radius: 0.04,
            early_termination_limit: NO_LIMIT,
            length: 1.,
            dual_length: 1.,
            ..Progress::default()
        };
        assert_eq!(progress, expected);
        assert_eq!(progress.proximal(), 1e-3);
        assert!(!progress.ended());
    }

    #[test]
    fn smoothing_vanishes_with_the_barrier_and_in_closing_steps() {
        let progress = begun(Progress { mu: 0.0125, ..first() }, &LIMITS, 1.);
        assert_close(progress.smoothing, 0.02);
        assert_eq!(begun(progress, &LIMITS, 1e-7).smoothing, 0.);
    }

    #[test]
    fn end_conditions_are_checked_in_order() {
        // All conditions but the one on the infeasibility are true at first and are removed one after the other; the first that is true
        // wins.
        let all = Progress { iterations: LIMITS.max_iterations, recorded: 20, edge_radius: 0.04, ..first() };
        let state = |progress: &Progress<f64>, f: f64, feasible: bool| {
            let mut progress = *progress;
            // No decrease over the window.
            begin(&mut progress, &LIMITS, f, f, 1., feasible);
            assert_eq!(progress.infeasibility.to_bits(), f.to_bits());
            progress.state
        };
        let (near, far) = (0.9 * LIMITS.closing, 1.);
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(state(&all, bad, true), NON_FINITE);
        }
        assert_eq!(state(&all, near, true), EXACT);
        let exact = Progress { edge_radius: 0., ..all };
        assert_eq!((state(&exact, near, true), state(&all, far, true)), (SOLVED, SOLVED));
        assert_eq!((state(&exact, near, false), state(&all, far, false)), (MAX_ITERATIONS, MAX_ITERATIONS));
        let early = Progress { iterations: LIMITS.max_iterations - 1, ..all };
        assert_eq!(state(&early, far, false), STALLED);
        assert_eq!(state(&Progress { recorded: 0, ..early }, far, false), STEP);
        let early = Progress { edge_radius: 0., ..early };
        assert_eq!(state(&early, near, false), CLOSE);
        for (end, ended) in [
            (STEP, false),
            (CLOSE, false),
            (EXACT, false),
            (SHORTER, false),
            (SOLVED, true),
            (MAX_ITERATIONS, true),
            (STALLED, true),
            (TERMINATED_EARLY, true),
            (STEPS_REFUSED, true),
        ] {
            assert_eq!(Progress { state: end, ..first() }.ended(), ended);
        }
        assert!(Progress { state: NON_FINITE, ..first() }.ended());
    }

    #[test]
    fn rows_become_exact_once_near_a_solution() {
        let rounded = Progress { recorded: 12, iterations: 12, attempts: 0, ..Progress::first(&LIMITS, BARRIER, 0.04) };
        assert_eq!(begun(rounded, &LIMITS, LIMITS.closing).state, STEP, "not close enough");
        let mut progress = begun(rounded, &LIMITS, 0.5 * LIMITS.closing);
        // The record is withdrawn, because it belongs to the rounded rows.
        let expected = Progress { state: EXACT, edge_radius: 0., stall_from: 12, infeasibility: 0.5 * LIMITS.closing, ..rounded };
        assert_eq!(progress, expected);
        renew(&mut progress);
        assert_eq!(progress, Progress { current: 1, ..expected });
        assert_eq!(begun(progress, &LIMITS, 0.5 * LIMITS.closing).state, CLOSE);
        // The infeasibility of the exact rows may be larger.
        let progress = begun(progress, &LIMITS, 0.1);
        assert_eq!((progress.state, progress.recorded), (STEP, 13));
    }

    #[test]
    fn no_round_begins_at_or_above_the_iteration_limit() {
        let state = |iterations, max_iterations| {
            let limits = Limits { max_iterations, ..LIMITS };
            begun(Progress { iterations, ..first() }, &limits, 1.).state
        };
        assert_eq!([state(49, 50), state(50, 50), state(51, 50), state(0, 0)], [STEP, MAX_ITERATIONS, MAX_ITERATIONS, MAX_ITERATIONS]);
    }

    #[test]
    fn a_solve_stalls_if_its_rate_needs_more_iterations_than_the_budget() {
        let state = |f: f64, before: f64, limits: &Limits<f64>| {
            let mut progress = Progress { recorded: 10, ..first() };
            begin(&mut progress, limits, f, before, 1., false);
            progress.state
        };
        // From 1 to 1e-6 in 200 iterations: a factor of exp(0.069 * 4) per window of 4.
        let needed = (1e6_f64.ln() / 200. * 4.).exp();
        assert_eq!([state(1., 0.99 * needed, &LIMITS), state(1., 1.01 * needed, &LIMITS)], [STALLED, STEP]);
        assert_eq!([state(1., 1., &LIMITS), state(1., 0.5, &LIMITS)], [STALLED, STALLED], "constant, then increasing");
        // Just above a solution the infeasibility may stay constant.
        assert_eq!([state(11e-6, 11e-6, &LIMITS), state(9e-6, 9e-6, &LIMITS)], [STALLED, STEP]);
        assert_eq!(state(1., 1., &Limits { stall_start: NONE, ..LIMITS }), STEP);
    }

    #[test]
    fn the_stall_rule_waits_for_its_start_and_for_a_window_of_unchanged_rows() {
        let stalls = |recorded, stall_from| {
            let mut progress = Progress { recorded, stall_from, ..first() };
            begin(&mut progress, &LIMITS, 1., 1., 1., false);
            progress.state == STALLED
        };
        assert_eq!([stalls(9, 0), stalls(10, 0), stalls(11, 0)], [false, true, true]);
        assert_eq!([stalls(13, 10), stalls(14, 10)], [false, true]);
        assert_eq!([stalls(9, 3), stalls(10, 3)], [false, true]);
    }

    #[test]
    fn a_candidate_terminates_early_above_the_limit_for_its_iteration() {
        let limits = Limits { early_termination_rates: [0.125, 0.5, 0.25], ..LIMITS };
        let start = Progress { early_termination_limit: 4096., length: 0.5, ..first() };
        // All values but the last are below the limit, which applies from the third record on.
        let most = [4096., 512., 64., 32., 16., 8., 2., 0.5];
        for last in 0..most.len() {
            let mut progress = start;
            let lacking = [1e9, 1e9].into_iter().chain(most[..last].iter().map(|l| 0.99 * l)).chain([1.01 * most[last]]);
            let states: Vec<u32> = lacking
                .map(|lacking| {
                    // The step length contributes a factor of 0.5, the multiplier one of 0.25.
                    begin(&mut progress, &limits, lacking * 0.5 / 0.25, f64::INFINITY, 0.25, false);
                    progress.state
                })
                .collect();
            assert_eq!(states.iter().position(|state| *state == TERMINATED_EARLY), Some(2 + last), "{states:?}");
        }
        // Afterwards only the stall rule applies.
        let begun = |recorded| {
            let mut progress = Progress { recorded, ..start };
            begin(&mut progress, &Limits { stall_start: NONE, ..LIMITS }, 1e9, f64::INFINITY, 1., false);
            progress.state
        };
        assert_eq!([begun(EARLY_TERMINATION_TO), begun(EARLY_TERMINATION_TO + 1)], [TERMINATED_EARLY, STEP]);
    }

    #[test]
    fn the_early_termination_limit_is_proportional_to_the_rows_and_to_the_setting() {
        let settings = |stall| SolverSettings { stall, ..SolverSettings::default() };
        let stall = StallSettings::default();
        for transcription in [Transcription::Momentum, Transcription::Towr] {
            let of = |stall, rows| settings(stall).early_termination_limit(transcription, rows);
            let one = of(stall.clone(), 100);
            assert!(one > 0. && early_termination_rates(transcription).iter().all(|rate| 0. < *rate && *rate < 1.));
            assert_eq!(of(stall.clone(), 300), 3. * one);
            assert_eq!(of(StallSettings { early_termination: 2., ..stall.clone() }, 100), 2. * one);
            for never in [StallSettings { enabled: false, ..stall.clone() }, StallSettings { early_termination: 0., ..stall.clone() }] {
                assert_eq!(of(never, 100), NO_LIMIT);
            }
        }
    }

    #[test]
    fn the_initial_barrier_depends_on_the_transcription_unless_it_is_set() {
        let (settings, both) = (SolverSettings::default(), [Transcription::Momentum, Transcription::Towr]);
        assert_eq!(both.map(|t| settings.barrier(t)), [0.02, 0.2]);
        let set = SolverSettings { barrier: Some(0.07), ..settings };
        assert_eq!(both.map(|t| set.barrier(t)), [0.07; 2]);
        assert!(set.validate().is_ok() && SolverSettings { barrier: Some(0.), ..set }.validate().is_err());
    }

    #[test]
    fn closing_steps_continue_while_each_leaves_at_most_a_tenth() {
        let progress = closing(9e-7);
        assert_eq!((progress.closing_from, progress.proximal()), (9e-7, LIMITS.proximal_floor));
        let next = begun(progress, &LIMITS, 0.9e-7);
        assert_eq!((next.state, next.closing_from, next.closing_below), (CLOSE, 0.9e-7, 1e-6));
        // The ratio is relative to the previous step, not to the first.
        assert_eq!(begun(next, &LIMITS, 0.8e-7).state, STEP);
        assert_eq!(begun(next, &LIMITS, 0.8e-8).state, CLOSE);
    }

    #[test]
    fn slow_closing_pauses_until_a_tenth_of_its_infeasibility() {
        let progress = Progress { closing_eps: 0.3, mu: 0.0125, ..closing(9e-7) };
        let back = begun(progress, &LIMITS, 5e-7);
        assert_eq!((back.state, back.closing_eps, back.closing_from), (STEP, LIMITS.proximal_floor, 5e-7));
        assert_close(back.closing_below, 5e-8);
        assert_close(back.smoothing, 0.02);
        assert_eq!(begun(back, &LIMITS, 6e-8).state, STEP);
        assert_eq!(begun(back, &LIMITS, 4e-8).state, CLOSE);
        // The threshold never rises.
        let low = Progress { closing_below: 1e-9, ..progress };
        assert_eq!(begun(low, &LIMITS, 5e-7).closing_below, 1e-9);
    }

    #[test]
    fn slow_closing_continues_while_rows_are_restored() {
        let restoring = Progress { phase: RESTORE, ..closing(9e-7) };
        let next = begun(restoring, &LIMITS, 8e-7);
        assert_eq!((next.state, next.closing_from, next.closing_below), (CLOSE, 8e-7, 1e-6));
    }

    #[test]
    fn unlimited_closing_continues_even_if_it_is_slow() {
        let limits = Limits { closing: f64::INFINITY, ..LIMITS };
        let mut progress = Progress::first(&limits, BARRIER, 0.);
        for f in [10., 9., 8.5] {
            progress = begun(progress, &limits, f);
            assert_eq!((progress.state, progress.smoothing, progress.closing_below), (CLOSE, 0., f64::INFINITY));
        }
    }

    #[test]
    fn a_closing_limit_of_zero_disables_closing_steps() {
        let limits = Limits { closing: 0., stall_start: NONE, ..LIMITS };
        for f in [1., 1e-12, 0.] {
            assert_eq!(begun(Progress::first(&limits, BARRIER, 0.04), &limits, f).state, STEP);
        }
    }

    #[test]
    fn an_accepted_step_adapts_the_proximal_weight_to_its_ratio() {
        let eps = |ratio: f64| accepted(first(), ratio).eps;
        assert_eq!([0.71, 1., 3., f64::INFINITY].map(eps), [2.5e-4; 4]);
        assert_eq!([0.25, 0.5, 0.7].map(eps), [1e-3; 3]);
        assert_eq!([0.24, 0., -2., f64::NEG_INFINITY].map(eps), [2e-3; 4]);
        let low = Progress { eps: 3e-5, ..first() };
        assert_eq!(accepted(low, 1.).eps, LIMITS.proximal_floor);
        let minimising = |ratio: f64| accepted(Progress { eps: 1e-3, ..minimising() }, ratio).eps;
        assert_eq!([0.71, 0.7, 0.5, 0.49, -2.].map(minimising), [2.5e-4, 1e-3, 1e-3, 4e-3, 4e-3]);
    }

    #[test]
    fn an_accepted_step_is_counted_and_swaps_the_buffers() {
        let progress = Progress { attempts: 3, iterations: 4, current: 0, ..first() };
        let next = accepted(progress, 0.5);
        assert_eq!(next, Progress { attempts: 0, iterations: 5, current: 1, ..progress });
        assert_eq!(accepted(next, 0.5), Progress { attempts: 0, iterations: 6, current: 0, ..progress });
    }

    #[test]
    fn barrier_and_closing_steps_have_separate_proximal_weights() {
        let close = Progress { closing_eps: 0.04, ..closing(1e-7) };
        assert_eq!(close.proximal(), 0.04);
        let [taken, doubled, dropped] = [accepted(close, 1.), accepted(close, 0.1), refused(close, 1)];
        assert_eq!([taken.closing_eps, doubled.closing_eps], [0.01, 0.08]);
        assert_eq!([taken.eps, doubled.eps, dropped.eps], [LIMITS.proximal; 3]);
        for step in [accepted(first(), 1.), accepted(first(), 0.1), refused(first(), 3)] {
            assert_eq!(step.closing_eps, LIMITS.proximal_floor);
        }
    }

    #[test]
    fn a_refused_step_is_shortened_to_a_quarter_and_to_a_sixteenth() {
        let start = Progress { iterations: 4, current: 1, length: 0.8, dual_length: 0.4, ..begun(first(), &LIMITS, 1.) };
        let shorter = Progress { state: SHORTER, attempts: 1, length: 0.2, dual_length: 0.1, ..start };
        assert_eq!(refused(start, 1), shorter);
        assert_eq!(refused(start, 2), Progress { attempts: 2, length: 0.05, dual_length: 0.025, ..shorter });
        // The ratio of a shortened step leaves the proximal weight unchanged.
        for ratio in [0.1, 0.5, 0.9] {
            let taken = accepted(shorter, ratio);
            assert_eq!(taken, Progress { attempts: 0, iterations: 5, current: 0, ..shorter });
            assert_eq!(begun(taken, &LIMITS, 0.5).state, STEP);
        }
    }

    #[test]
    fn after_the_shorter_steps_six_larger_weights_end_the_solve() {
        // Zero length, so that shortening does not change it.
        let start = Progress { iterations: 4, current: 1, length: 0., dual_length: 0., ..begun(first(), &LIMITS, 1.) };
        for times in 1..6 {
            let progress = refused(start, SHORTENINGS + times);
            assert_close(progress.eps, 1e-3 * 6_f64.powi(times as i32));
            assert_eq!(progress, Progress { attempts: SHORTENINGS + times, eps: progress.eps, ..start });
        }
        let end = refused(start, ATTEMPTS);
        assert_eq!(end, Progress { state: STEPS_REFUSED, attempts: 0, eps: end.eps, ..start });
        // An accepted step resets the count of refused attempts.
        assert_eq!(refused(accepted(refused(start, ATTEMPTS - 1), 0.5), ATTEMPTS - 1).state, STEP);
    }

    #[test]
    fn without_a_factorisation_no_shorter_step_is_tried() {
        let start = begun(first(), &LIMITS, 1.);
        let mut progress = start;
        damp(&mut progress);
        assert_eq!(progress, Progress { attempts: SHORTENINGS + 1, eps: 6e-3, ..start });
    }

    #[test]
    fn a_refused_closing_step_returns_to_barrier_steps() {
        let start = closing(5e-7);
        let back = refused(start, 1);
        assert_eq!(back, Progress { state: STEP, closing_below: back.closing_below, ..start });
        assert_close(back.closing_below, 5e-8);
        // The next round starts from the same point with a barrier step.
        let again = begun(back, &LIMITS, 5e-7);
        assert_eq!((again.state, again.smoothing, again.closing_eps), (STEP, LIMITS.smoothing, LIMITS.proximal_floor));
        assert_eq!([begun(again, &LIMITS, 6e-8).state, begun(again, &LIMITS, 4e-8).state], [STEP, CLOSE]);
        // The threshold never rises.
        assert_close(refused(Progress { closing_below: 1e-9, ..start }, 1).closing_below, 1e-10);
    }

    #[test]
    fn unlimited_closing_is_retried_with_larger_weights() {
        let limits = Limits { closing: f64::INFINITY, ..LIMITS };
        let start = begun(Progress::first(&limits, BARRIER, 0.), &limits, 10.);
        let next = refused(start, 1);
        assert_eq!((next.state, next.attempts, next.eps), (CLOSE, SHORTENINGS + 1, LIMITS.proximal));
        assert_close(next.closing_eps, CLOSING_GROWTH * LIMITS.proximal_floor);
        assert_eq!(refused(start, 6).state, STEPS_REFUSED);
    }

    /// State after the rows of a candidate with a cost were solved in 5 iterations.
    fn minimising() -> Progress<f64> {
        let mut progress = Progress { minimise_iterations: 12, iterations: 5, recorded: 6, edge_radius: 0.04, ..first() };
        begin(&mut progress, &LIMITS, 1e-5, f64::INFINITY, 1., true);
        progress
    }

    /// State in which the rows are solved again after 9 of 12 iterations.
    fn restoring() -> Progress<f64> {
        let mut progress = Progress { phase: RESTORE_NEXT, iterations: 14, ..minimising() };
        assert!(is_minimised(&progress));
        restore(&mut progress, &LIMITS);
        progress
    }

    #[test]
    fn the_minimisation_has_the_settings_of_its_costs() {
        let settings = |smooth, optimise| SolverSettings {
            smooth: SmoothSettings { iterations: smooth, weight: 0.5 },
            optimise: OptimiseSettings { iterations: optimise, weight: 0.25, barrier: 1e-4, ..OptimiseSettings::default() },
            ..SolverSettings::default()
        };
        let of = |smooth, optimise| {
            let all = Minimisation::<f64>::new(&settings(smooth, optimise), Transcription::Momentum);
            (all.iterations, all.barrier, all.restore_barrier, all.smoothing, all.weight)
        };
        assert_eq!(of(20, 0), (20, SMOOTH_BARRIER, SMOOTH_BARRIER, 0.5, 0.));
        assert_eq!(of(0, 12), (12, 1e-4, RESTORE_BARRIER, 0., 0.25));
        assert_eq!(of(20, 12), (20, 1e-4, RESTORE_BARRIER, 0.5, 0.25));
        assert_eq!(of(0, 0).0, 0);
        assert_eq!(Minimisation::<f64>::new(&settings(0, 12), Transcription::Momentum).cost_limit, NO_LIMIT);
        let limited = SolverSettings { optimise: OptimiseSettings { cost_limit: Some(3.), ..settings(0, 12).optimise }, ..settings(0, 12) };
        assert_eq!(Minimisation::<f64>::new(&limited, Transcription::Momentum).cost_limit, 0.75);
        let narrow = SolverSettings { barrier: Some(1e-5), ..settings(20, 0) };
        assert_eq!(Minimisation::<f64>::new(&narrow, Transcription::Towr).barrier, 1e-5);
    }

    #[test]
    fn a_solved_candidate_with_a_cost_begins_to_minimise_it() {
        let progress = minimising();
        let expected = Progress {
            state: STEP,
            phase: MINIMISE,
            iterations: 5,
            recorded: 7,
            stall_from: 7,
            minimise_iterations: 12,
            minimise_until: 17,
            infeasibility: 1e-5,
            solved_infeasibility: 1e-5,
            mu: 4e-4,
            barrier: 4e-4,
            smoothing: 0.01,
            eps: LIMITS.proximal_floor,
            rounding: 1e-2,
            ..first()
        };
        assert_eq!(progress, expected);
        let mut without = Progress { minimise_iterations: 0, ..first() };
        begin(&mut without, &LIMITS, 1e-5, f64::INFINITY, 1., true);
        assert_eq!((without.state, without.phase), (SOLVED, SOLVE));
    }

    #[test]
    fn the_minimisation_ends_at_its_iteration_limit_near_the_optimum_or_above_the_limit_of_the_cost() {
        let progress = minimising();
        assert!(!is_minimised(&Progress { iterations: 16, ..progress }) && is_minimised(&Progress { iterations: 17, ..progress }));
        assert!(!is_minimised(&Progress { iterations: 17, phase: RESTORE, ..progress }));
        let phase = |rounding, length, predicted: f64| {
            let mut progress = Progress { rounding, length, ..progress };
            minimised(&mut progress, &LIMITS.minimise, predicted, 1., 100);
            progress.phase
        };
        assert_eq!(phase(1e-3, 0.6, 0.09), RESTORE_NEXT);
        assert_eq!([phase(2e-3, 0.6, 0.09), phase(1e-3, 0.4, 0.09), phase(1e-3, 0.6, 0.11)], [MINIMISE; 3]);
        for (cost, expected) in [(2., MINIMISE), (2.1, RESTORE_NEXT)] {
            let mut progress = progress;
            minimised(&mut progress, &LIMITS.minimise, 1., cost, 100);
            assert_eq!((progress.state, progress.phase), (STEP, expected), "cost {cost}");
        }
        // A resumed minimisation has no solved point, and ends at once.
        let mut resumed = Progress { minimise_iterations: 0, ..progress };
        minimised(&mut resumed, &LIMITS.minimise, 1., 2.1, 100);
        assert_eq!((resumed.state, resumed.phase), (TERMINATED_EARLY, MINIMISE));
        // Smoothing alone has no optimality test.
        let mut smooth = Progress { rounding: 1e-3, ..progress };
        minimised(&mut smooth, &Minimisation { weight: 0., ..LIMITS.minimise }, -1., 0., 100);
        assert_eq!(smooth.phase, MINIMISE);
    }

    #[test]
    fn the_rounding_follows_the_root_of_the_barrier_down_to_its_floor() {
        let rounding = |mu| {
            let mut progress = Progress { mu, ..minimising() };
            minimised(&mut progress, &LIMITS.minimise, 1., 1., 100);
            progress.rounding
        };
        assert_close(rounding(1e-4), 5e-3);
        assert_eq!([rounding(1e-9), rounding(1.)], [1e-3, 1e-2]);
    }

    #[test]
    fn the_barrier_stays_in_proportion_to_the_predicted_fall() {
        let floor = |predicted, length| {
            let mut progress = Progress { length, ..minimising() };
            minimised(&mut progress, &LIMITS.minimise, predicted, 1., 400);
            progress.barrier_floor
        };
        assert_close(floor(1e-5, 1.), 5e-8);
        assert_close(floor(1e-5, 0.25), 2e-7);
        assert_eq!([floor(1., 1.), floor(1e-9, 1.), floor(-1., 0.5)], [LARGEST_BARRIER_FLOOR, BARRIER_FLOOR, BARRIER_FLOOR]);
        let mut progress = Progress { barrier_floor: 1e-7, ..minimising() };
        restore(&mut progress, &LIMITS);
        assert_eq!(progress.barrier_floor, BARRIER_FLOOR);
    }

    #[test]
    fn a_minimisation_that_stalls_is_restored() {
        let progress = refused(Progress { length: 0., dual_length: 0., ..minimising() }, ATTEMPTS);
        assert_eq!((progress.state, progress.phase, progress.attempts), (STEP, RESTORE_NEXT, 0));
        assert!(is_minimised(&progress));
    }

    #[test]
    fn the_rows_are_solved_again_without_a_cost() {
        let progress = restoring();
        let expected = Progress { phase: RESTORE, iterations: 14, mu: 1e-5, barrier: 1e-5, smoothing: 0., ..minimising() };
        assert_eq!(progress, expected);
        let next = begun(progress, &LIMITS, 1.);
        assert_eq!((next.state, next.smoothing, next.recorded), (STEP, 0., 8));
        assert_eq!(begun(progress, &LIMITS, 0.5 * LIMITS.closing).state, CLOSE);
        // The limit counts from the end of the minimisation, and a solved candidate is not minimised again.
        let mut last = Progress { iterations: 66, ..progress };
        begin(&mut last, &LIMITS, 1., 2., 1., false);
        assert_eq!((last.state, last.phase), (STEP, RESTORE));
        begin(&mut last, &LIMITS, 1e-7, 2., 1., true);
        assert_eq!((last.state, last.phase, last.infeasibility), (SOLVED, RESTORE, 1e-7));
    }

    #[test]
    fn refused_closing_steps_that_restore_the_rows_are_damped_until_they_are_accepted() {
        let start = begun(restoring(), &LIMITS, 0.5 * LIMITS.closing);
        let next = refused(start, 3);
        assert_eq!((next.state, next.phase, next.attempts), (CLOSE, RESTORE, SHORTENINGS + 3));
        assert_close(next.closing_eps, CLOSING_GROWTH.powi(3) * LIMITS.proximal_floor);
        let taken = accepted(next, 0.5);
        assert_eq!((taken.state, taken.phase, taken.attempts), (CLOSE, RESTORE, 0));
        assert_eq!(begun(taken, &LIMITS, 0.4 * LIMITS.closing).state, CLOSE);
        // Barrier steps follow after the last attempt.
        let back = refused(start, 6);
        assert_eq!((back.state, back.phase, back.attempts), (STEP, RESTORE, 0));
        assert_close(back.closing_below, CLOSING_AGAIN * start.infeasibility);
        assert_eq!(refused(back, ATTEMPTS).phase, REVERT);
    }

    #[test]
    fn rows_that_cannot_be_restored_revert_to_the_solved_point() {
        let phase = |progress: Progress<f64>, f: f64| begun(progress, &LIMITS, f).phase;
        assert_eq!(phase(Progress { iterations: 67, ..restoring() }, 1.), REVERT);
        assert_eq!(phase(restoring(), f64::NAN), REVERT);
        let mut stalled = Progress { recorded: 20, ..restoring() };
        begin(&mut stalled, &LIMITS, 1., 1., 1., false);
        assert_eq!(stalled.phase, REVERT);
        let refused = refused(Progress { length: 0., dual_length: 0., ..restoring() }, ATTEMPTS);
        assert_eq!((refused.state, refused.phase, refused.attempts), (STEP, REVERT, 0));
        for mut progress in [refused, stalled] {
            revert(&mut progress);
            assert_eq!((progress.state, progress.phase, progress.infeasibility), (SOLVED, REVERT, 1e-5));
        }
    }

    #[test]
    fn a_resumed_solve_begins_with_the_minimisation() {
        let progress = Progress::resumed(&LIMITS, 1e-4, 3);
        let expected = Progress {
            phase: MINIMISE,
            minimise_until: 3,
            mu: 1e-4,
            barrier: 1e-4,
            smoothing: 0.01,
            eps: LIMITS.proximal_floor,
            rounding: 5e-3,
            ..first()
        };
        assert_eq!((progress.state, progress.edge_radius, progress.minimise_iterations), (STEP, 0., 0));
        assert_eq!(progress, expected);
        assert_eq!([1e-9, 1.].map(|barrier| Progress::resumed(&LIMITS, barrier, 3).rounding), [1e-3, 1e-2]);
        assert!(!is_minimised(&Progress { iterations: 2, ..progress }) && is_minimised(&Progress { iterations: 3, ..progress }));
        assert!(is_minimised(&Progress::resumed(&LIMITS, 1e-4, 0)));
    }

    #[test]
    fn a_resumed_solve_whose_rows_cannot_be_restored_ends_with_the_failure() {
        let mut progress = Progress { iterations: 3, ..Progress::resumed(&LIMITS, 1e-4, 3) };
        restore(&mut progress, &LIMITS);
        let ended = |progress: Progress<f64>, f: f64| {
            let progress = begun(progress, &LIMITS, f);
            (progress.state, progress.phase)
        };
        assert_eq!(ended(Progress { iterations: 52, ..progress }, 1.), (STEP, RESTORE));
        assert_eq!(ended(Progress { iterations: 53, ..progress }, 1.), (MAX_ITERATIONS, RESTORE));
        assert_eq!(ended(progress, f64::NAN), (NON_FINITE, RESTORE));
        let mut stalled = Progress { recorded: 20, ..progress };
        begin(&mut stalled, &LIMITS, 1., 1., 1., false);
        assert_eq!((stalled.state, stalled.phase), (STALLED, RESTORE));
        let refused = refused(Progress { length: 0., dual_length: 0., ..progress }, ATTEMPTS);
        assert_eq!((refused.state, refused.phase), (STEPS_REFUSED, RESTORE));
        // It is not minimised again once it is solved.
        begin(&mut progress, &LIMITS, 1e-7, 2., 1., true);
        assert_eq!((progress.state, progress.phase), (SOLVED, RESTORE));
    }

    #[test]
    fn a_trial_point_is_accepted_if_the_merit_decreases() {
        let (step, close) = (begun(first(), &LIMITS, 1.), closing(1e-7));
        let shorter = Progress { state: SHORTER, ..step };
        for progress in [step, shorter, close] {
            assert!(acceptable(&progress, 1e-300, 1., 1e9));
            for fall in [0., -1., f64::NAN] {
                assert!(!acceptable(&progress, fall, 1., 1e9));
                assert!(!acceptable(&progress, fall, 1., f64::NAN));
            }
        }
    }

    #[test]
    fn a_barrier_step_is_also_accepted_near_its_linear_model() {
        let (step, close) = (begun(first(), &LIMITS, 1.), closing(1e-7));
        // The limit on the gap is 0.3 times the predicted decrease, or 0.3 times a twentieth of the infeasibility.
        for step in [step, Progress { state: SHORTER, ..step }] {
            assert_eq!([0.29, 0.31].map(|gap| acceptable(&step, -1., 1., gap)), [true, false]);
        }
        for predicted in [0.01, 0., -1.] {
            assert_eq!([0.0149, 0.0151].map(|gap| acceptable(&step, -1., predicted, gap)), [true, false]);
        }
        assert!(!acceptable(&close, -1., 1., 0.), "a closing step must decrease the infeasibility");
    }
}
