//! How the solve of a candidate goes on: barrier steps, closing steps, proximal weight, and when it ends.
//!
//! A solve is a sequence of rounds. A round begins with the infeasibility at the point ([`begin`]), makes a trial point, and ends with the
//! verdict on it: taken ([`accept`]) or not ([`refuse`]). What is refused is tried again by a shorter step along the same direction, which costs
//! no factorisation, and then with a larger proximal weight ([`damp`]).

use crate::nlp::Layout;
use crate::real::Real;
use crate::rows::table::NONE;
use crate::settings::{SolverSettings, Transcription};

/// The next trial point is a barrier step.
pub const STEP: u32 = 0;
/// The next trial point is a closing step: Gauss-Newton on the equalities and the violated rows.
pub const CLOSE: u32 = 1;
/// The next trial point is the point itself: rows that were rounded become exact.
pub const EXACT: u32 = 2;
/// The next trial point is a barrier step by a part of the length that was refused.
pub const SHORTER: u32 = 3;
/// States from here on are ends.
pub const ENDED: u32 = SOLVED;
/// See [`crate::solver::Status`].
pub const SOLVED: u32 = 4;
/// Likewise.
pub const MAX_ITERATIONS: u32 = 5;
/// Likewise.
pub const STALLED: u32 = 6;
/// Likewise.
pub const NON_FINITE: u32 = 7;

/// Part of the infeasibility that a closing step may leave.
pub const CLOSING_RATE: f64 = 0.1;
/// Infeasibility to which the stall rule counts how many iterations are left.
pub const STALL_TARGET: f64 = 1e-6;
/// Infeasibility above which it speaks: below it rounding makes it rest now and then.
pub const STALL_ABOVE: f64 = 1e-5;
/// Limit on what a candidate lacks that no candidate exceeds. Shaders need not know infinities.
pub const NEVER_HOPELESS: f64 = f32::MAX as f64;
/// Iterations after which a candidate may be given up for what it lacks: from here on
pub const HOPELESS_FROM: u32 = 2;
/// to here. Who gets farther may be slow; what it does is the stall rule's to judge.
pub const HOPELESS_TO: u32 = 15;
/// Iterations up to which the first, and the second, of [`hopeless_rates`] hold.
pub const HOPELESS_KNEES: [u32; 2] = [4, 7];
/// Shorter steps that are tried along a refused direction,
pub const SHORTENINGS: u32 = 2;
/// and the part of the length that each keeps.
pub const SHORTENING: f64 = 0.25;
/// Refused attempts with which an iteration gives up: behind the shorter steps each has a larger proximal weight.
pub const ATTEMPTS: u32 = SHORTENINGS + 6;
/// Growth of the proximal weight after a refused attempt.
pub const PROXIMAL_GROWTH: f64 = 6.;

crate::table! {
    /// How far the solve of a candidate is.
    #[derive(Default, PartialEq)]
    pub struct Progress<T> {
        /// What the next trial point is for, or how the solve ended.
        pub state: u32,
        /// Half of the buffers in which the point is; the other one has the trial point.
        pub current: u32,
        /// Accepted steps.
        pub iterations: u32,
        /// Factorisations, refused attempts included.
        pub factorisations: u32,
        /// Attempts refused since the last accepted step.
        pub attempts: u32,
        /// Infeasibilities recorded.
        pub recorded: u32,
        /// Record from which the stall rule looks back: before it other rows were in force.
        pub stall_from: u32,
        /// Infeasibility `F` at the point.
        pub infeasibility: T,
        /// Barrier parameter.
        pub mu: T,
        /// First barrier parameter.
        pub barrier: T,
        /// Weight of the smoothing: how firmly the initial values draw.
        pub smoothing: T,
        /// Proximal weight of barrier steps.
        pub eps: T,
        /// Proximal weight of closing steps.
        pub closing_eps: T,
        /// Infeasibility below which closing steps are tried.
        pub closing_below: T,
        /// Infeasibility before the last step.
        pub closing_from: T,
        /// Rounding of terrain edges in force; 0 once closing steps began, m.
        pub edge_radius: T,
        /// The solve is given up when it lacks more than this: infeasibility, times the largest multiplier of an inequality, over the length of
        /// the last step. Where there is no solution multipliers grow, steps are short and the infeasibility stays, and the product of the three
        /// tells it before each of them does. Calibrated in `benches/README.md`.
        pub hopeless: T,
        /// Length of the step to the trial point.
        pub length: T,
        /// Length of the step of the multipliers.
        pub dual_length: T,
    }
}

/// [`SolverSettings`] in the solver's scalar.
#[derive(Debug, Clone, Copy)]
pub struct Limits<T> {
    /// Iteration limit.
    pub max_iterations: u32,
    /// First record at which the stall rule may end a solve; [`NONE`]: no rule.
    pub stall_start: u32,
    /// Iterations over which its rate is taken.
    pub stall_window: u32,
    /// Iterations that a candidate may still need.
    pub stall_budget: T,
    /// First proximal weight.
    pub proximal: T,
    /// Smallest proximal weight.
    pub proximal_floor: T,
    /// Weight of the smoothing at the first barrier parameter.
    pub smoothing: T,
    /// Infeasibility below which closing steps start.
    pub closing: T,
    /// See [`hopeless_rates`].
    pub hopeless_rates: [T; 3],
}

/// [`Progress::hopeless`] after [`HOPELESS_FROM`] iterations, of a row.
pub fn hopeless_of_a_row(transcription: Transcription) -> f64 {
    match transcription {
        Transcription::Momentum => 8.,
        Transcription::Towr => 30.,
    }
}

/// Parts of [`Progress::hopeless`] that are left with each further iteration, up to each of [`HOPELESS_KNEES`] and beyond.
pub fn hopeless_rates(transcription: Transcription) -> [f64; 3] {
    match transcription {
        Transcription::Momentum => [0.1, 0.2, 0.8],
        Transcription::Towr => [0.25, 0.45, 0.6],
    }
}

impl<T: Real> Limits<T> {
    /// Limits of a solve.
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
            hopeless_rates: hopeless_rates(transcription).map(T::of),
        }
    }

    /// Before the first round of a candidate.
    pub fn first_progress(&self, settings: &SolverSettings, layout: &Layout<T>) -> Progress<T> {
        let (transcription, rows) = (layout.curves.transcription, layout.rows.all());
        let (barrier, hopeless) = (settings.barrier(transcription), settings.hopeless(transcription, rows));
        let first = Progress::first(self, T::of(barrier), T::of(settings.edge_radius_on(&layout.terrain)));
        Progress { hopeless: T::of(hopeless), ..first }
    }
}

impl<T: Real> Progress<T> {
    /// Before the first round, never given up for what is lacking.
    ///
    /// * `barrier` - see [`SolverSettings::barrier`]
    pub fn first(limits: &Limits<T>, barrier: T, edge_radius: T) -> Self {
        Progress {
            barrier,
            mu: barrier,
            eps: limits.proximal,
            closing_eps: limits.proximal_floor,
            closing_below: limits.closing,
            closing_from: T::infinity(),
            edge_radius,
            hopeless: T::of(NEVER_HOPELESS),
            length: T::one(),
            dual_length: T::one(),
            ..Progress::default()
        }
    }

    /// Whether the solve has ended.
    pub fn ended(&self) -> bool {
        self.state >= ENDED
    }

    /// Proximal weight in force.
    pub fn proximal(&self) -> T {
        if self.state == CLOSE { self.closing_eps } else { self.eps }
    }

    /// Gives the proximal weight in force another value.
    fn set_proximal(&mut self, eps: T) {
        if self.state == CLOSE {
            self.closing_eps = eps;
        } else {
            self.eps = eps;
        }
    }
}

/// Decides what the round is for, or ends the solve.
///
/// * `f` - infeasibility at the point
/// * `before` - that `stall_window` records ago; any value where there are not as many
/// * `largest` - multiplier of an inequality
/// * `held` - whether the rows hold
pub fn begin<T: Real>(progress: &mut Progress<T>, limits: &Limits<T>, f: T, before: T, largest: T, held: bool) {
    progress.infeasibility = f;
    progress.recorded += 1;
    if !f.is_finite() {
        progress.state = NON_FINITE;
    } else if f < limits.closing && progress.edge_radius > T::zero() {
        // Near enough: from here on the exact rows.
        progress.edge_radius = T::zero();
        progress.recorded -= 1;
        progress.stall_from = progress.recorded;
        progress.state = EXACT;
    } else if held {
        progress.state = SOLVED;
    } else if progress.iterations >= limits.max_iterations {
        progress.state = MAX_ITERATIONS;
    } else if stalled(progress, limits, f, before) || is_hopeless(progress, f, largest) {
        progress.state = STALLED;
    } else {
        let mut closing = progress.state == CLOSE;
        if closing && f > T::of(CLOSING_RATE) * progress.closing_from && limits.closing.is_finite() {
            // It closes on the wrong rows: back to the barrier until they are better known.
            closing = false;
            progress.closing_below = progress.closing_below.min(T::of(0.1) * f);
        }
        closing = closing || f < progress.closing_below;
        progress.closing_from = f;
        progress.state = if closing { CLOSE } else { STEP };
        progress.smoothing = if closing { T::zero() } else { limits.smoothing * progress.mu / progress.barrier };
        if !closing {
            progress.closing_eps = limits.proximal_floor;
        }
    }
    if may_be_given_up(progress) && progress.state != EXACT {
        let knees = HOPELESS_KNEES.iter().filter(|&&knee| progress.recorded > knee).count();
        progress.hopeless *= limits.hopeless_rates[knees];
    }
}

/// The stall rule, see [`crate::settings::StallSettings`]. Closing steps are never cut short.
fn stalled<T: Real>(progress: &Progress<T>, limits: &Limits<T>, f: T, before: T) -> bool {
    let done = progress.recorded - 1;
    if limits.stall_start == NONE || done < limits.stall_start.max(progress.stall_from + limits.stall_window) {
        return false;
    }
    // Logarithmic distance left against that covered in the window, in windows.
    let window = T::of(f64::from(limits.stall_window));
    f > T::of(STALL_ABOVE) && (f / T::of(STALL_TARGET)).ln() * window > limits.stall_budget * (before / f).ln()
}

/// Whether it lacks more than it may after as many iterations.
fn is_hopeless<T: Real>(progress: &Progress<T>, f: T, largest: T) -> bool {
    may_be_given_up(progress) && f * largest > progress.hopeless * progress.length
}

/// Whether what is lacking may end the solve now.
fn may_be_given_up<T: Real>(progress: &Progress<T>) -> bool {
    progress.recorded > HOPELESS_FROM && progress.recorded <= HOPELESS_TO + 1
}

/// Whether a trial point is taken: the merit falls, or the residuals are close to their linear model.
///
/// * `fall` - of the merit
/// * `predicted` - fall of the merit by the linear model
/// * `gap` - squared distance of the residuals from that model
pub fn acceptable<T: Real>(progress: &Progress<T>, fall: T, predicted: T, gap: T) -> bool {
    let near_linear = gap < T::of(0.3) * predicted.max(T::of(0.05) * progress.infeasibility);
    fall > T::zero() || (progress.state != CLOSE && near_linear)
}

/// The trial point becomes the point.
///
/// * `ratio` - fall of the merit by the predicted one
pub fn accept<T: Real>(progress: &mut Progress<T>, limits: &Limits<T>, ratio: T) {
    let eps = progress.proximal();
    // A shorter step leaves the weight as it is: its direction was good.
    let whole = progress.state != SHORTER;
    if whole && ratio > T::of(0.7) {
        progress.set_proximal((eps / T::of(4.)).max(limits.proximal_floor));
    } else if whole && ratio < T::of(0.25) {
        progress.set_proximal(eps * T::of(2.));
    }
    progress.iterations += 1;
    renew(progress);
}

/// The trial point, which is the point with other rows, takes its place.
pub fn renew<T: Real>(progress: &mut Progress<T>) {
    progress.attempts = 0;
    progress.current = 1 - progress.current;
}

/// The trial point is dropped: another one along its direction, nearer, is tried, or another direction.
pub fn refuse<T: Real>(progress: &mut Progress<T>) {
    if progress.state == CLOSE || progress.attempts >= SHORTENINGS {
        return damp(progress);
    }
    progress.attempts += 1;
    progress.state = SHORTER;
    progress.length *= T::of(SHORTENING);
    progress.dual_length *= T::of(SHORTENING);
}

/// The direction is dropped: another one is made with a larger proximal weight, or with the barrier, or the solve ends.
pub fn damp<T: Real>(progress: &mut Progress<T>) {
    if progress.state == CLOSE && progress.closing_below.is_finite() {
        // Back to the barrier until the violated rows are better known.
        progress.state = STEP;
        progress.attempts = 0;
        progress.closing_below = T::of(0.1) * progress.closing_below.min(progress.infeasibility);
        return;
    }
    progress.set_proximal(progress.proximal() * T::of(PROXIMAL_GROWTH));
    progress.attempts = progress.attempts.max(SHORTENINGS) + 1;
    if progress.state == SHORTER {
        progress.state = STEP;
    }
    if progress.attempts == ATTEMPTS {
        progress.attempts = 0;
        progress.state = STALLED;
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
        hopeless_rates: [1.; 3],
    };

    fn first() -> Progress<f64> {
        Progress::first(&LIMITS, BARRIER, 0.)
    }

    /// After the beginning of a round at infeasibility `f`, with rows that do not hold and no look back.
    fn begun(mut progress: Progress<f64>, limits: &Limits<f64>, f: f64) -> Progress<f64> {
        begin(&mut progress, limits, f, f64::INFINITY, 1., false);
        progress
    }

    /// In a closing step from infeasibility `f`.
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
    fn limits_are_those_of_the_settings() {
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
    fn a_solve_starts_with_a_barrier_step_at_the_weights_of_the_settings() {
        let progress = begun(Progress::first(&LIMITS, BARRIER, 0.04), &LIMITS, 3.);
        let expected = Progress {
            state: STEP,
            recorded: 1,
            infeasibility: 3.,
            mu: BARRIER,
            barrier: BARRIER,
            smoothing: 0.1,
            eps: 1e-3,
            closing_eps: 1e-5,
            closing_below: 1e-6,
            closing_from: 3.,
            edge_radius: 0.04,
            hopeless: NEVER_HOPELESS,
            length: 1.,
            dual_length: 1.,
            ..Progress::default()
        };
        assert_eq!(progress, expected);
        assert_eq!(progress.proximal(), 1e-3);
        assert!(!progress.ended());
    }

    #[test]
    fn the_smoothing_vanishes_with_the_barrier_and_in_closing_steps() {
        let progress = begun(Progress { mu: 0.0125, ..first() }, &LIMITS, 1.);
        assert_close(progress.smoothing, 0.02);
        assert_eq!(begun(progress, &LIMITS, 1e-7).smoothing, 0.);
    }

    #[test]
    fn the_ends_are_looked_for_in_their_order() {
        // Everything is true of this one at once, but for the infeasibility; what comes first wins, and one after the other is taken away.
        let all = Progress { iterations: LIMITS.max_iterations, recorded: 20, edge_radius: 0.04, ..first() };
        let state = |progress: &Progress<f64>, f: f64, held: bool| {
            let mut progress = *progress;
            // No fall in the window.
            begin(&mut progress, &LIMITS, f, f, 1., held);
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
        for (end, ended) in
            [(STEP, false), (CLOSE, false), (EXACT, false), (SHORTER, false), (SOLVED, true), (MAX_ITERATIONS, true), (STALLED, true)]
        {
            assert_eq!(Progress { state: end, ..first() }.ended(), ended);
        }
        assert!(Progress { state: NON_FINITE, ..first() }.ended());
    }

    #[test]
    fn near_the_end_the_rows_become_exact_once() {
        let rounded = Progress { recorded: 12, iterations: 12, attempts: 0, ..Progress::first(&LIMITS, BARRIER, 0.04) };
        assert_eq!(begun(rounded, &LIMITS, LIMITS.closing).state, STEP, "not near enough");
        let mut progress = begun(rounded, &LIMITS, 0.5 * LIMITS.closing);
        // The record is taken back: it belongs to the rows as they were.
        let expected = Progress { state: EXACT, edge_radius: 0., stall_from: 12, infeasibility: 0.5 * LIMITS.closing, ..rounded };
        assert_eq!(progress, expected);
        renew(&mut progress);
        assert_eq!(progress, Progress { current: 1, ..expected });
        assert_eq!(begun(progress, &LIMITS, 0.5 * LIMITS.closing).state, CLOSE);
        // Exact rows may be farther off.
        let progress = begun(progress, &LIMITS, 0.1);
        assert_eq!((progress.state, progress.recorded), (STEP, 13));
    }

    #[test]
    fn no_round_begins_beyond_the_iteration_limit() {
        let state = |iterations, max_iterations| {
            let limits = Limits { max_iterations, ..LIMITS };
            begun(Progress { iterations, ..first() }, &limits, 1.).state
        };
        assert_eq!([state(49, 50), state(50, 50), state(51, 50), state(0, 0)], [STEP, MAX_ITERATIONS, MAX_ITERATIONS, MAX_ITERATIONS]);
    }

    #[test]
    fn a_solve_stalls_where_its_rate_would_take_longer_than_the_budget() {
        let state = |f: f64, before: f64, limits: &Limits<f64>| {
            let mut progress = Progress { recorded: 10, ..first() };
            begin(&mut progress, limits, f, before, 1., false);
            progress.state
        };
        // From 1 to 1e-6 in 200 iterations: by the factor exp(0.069 * 4) in a window of 4.
        let needed = (1e6_f64.ln() / 200. * 4.).exp();
        assert_eq!([state(1., 0.99 * needed, &LIMITS), state(1., 1.01 * needed, &LIMITS)], [STALLED, STEP]);
        assert_eq!([state(1., 1., &LIMITS), state(1., 0.5, &LIMITS)], [STALLED, STALLED], "it rests, it rises");
        // Near the end it may rest.
        assert_eq!([state(11e-6, 11e-6, &LIMITS), state(9e-6, 9e-6, &LIMITS)], [STALLED, STEP]);
        assert_eq!(state(1., 1., &Limits { stall_start: NONE, ..LIMITS }), STEP);
    }

    #[test]
    fn the_stall_rule_waits_for_its_start_and_for_a_window_of_the_same_rows() {
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
    fn a_candidate_is_given_up_for_what_no_solved_one_lacks_after_as_many_iterations() {
        let limits = Limits { hopeless_rates: [0.125, 0.5, 0.25], ..LIMITS };
        let start = Progress { hopeless: 4096., length: 0.5, ..first() };
        // As long as the last is below the limit, which is asked for from the third record on.
        let most = [4096., 512., 64., 32., 16., 8., 2., 0.5];
        for last in 0..most.len() {
            let mut progress = start;
            let lacking = [1e9, 1e9].into_iter().chain(most[..last].iter().map(|l| 0.99 * l)).chain([1.01 * most[last]]);
            let states: Vec<u32> = lacking
                .map(|lacking| {
                    // Half of it by the length of the step, a quarter by the multiplier.
                    begin(&mut progress, &limits, lacking * 0.5 / 0.25, f64::INFINITY, 0.25, false);
                    progress.state
                })
                .collect();
            assert_eq!(states.iter().position(|state| *state == STALLED), Some(2 + last), "{states:?}");
        }
        // Later on the stall rule alone decides.
        let begun = |recorded| {
            let mut progress = Progress { recorded, ..start };
            begin(&mut progress, &Limits { stall_start: NONE, ..LIMITS }, 1e9, f64::INFINITY, 1., false);
            progress.state
        };
        assert_eq!([begun(HOPELESS_TO), begun(HOPELESS_TO + 1)], [STALLED, STEP]);
    }

    #[test]
    fn what_may_be_lacking_grows_with_the_rows_and_the_setting() {
        let settings = |stall| SolverSettings { stall, ..SolverSettings::default() };
        let stall = StallSettings::default();
        for transcription in [Transcription::Momentum, Transcription::Towr] {
            let of = |stall, rows| settings(stall).hopeless(transcription, rows);
            let one = of(stall.clone(), 100);
            assert!(one > 0. && hopeless_rates(transcription).iter().all(|rate| 0. < *rate && *rate < 1.));
            assert_eq!(of(stall.clone(), 300), 3. * one);
            assert_eq!(of(StallSettings { hopeless_above: 2., ..stall.clone() }, 100), 2. * one);
            for never in [StallSettings { enabled: false, ..stall.clone() }, StallSettings { hopeless_above: 0., ..stall.clone() }] {
                assert_eq!(of(never, 100), NEVER_HOPELESS);
            }
        }
    }

    #[test]
    fn the_first_barrier_is_that_of_the_rows_unless_it_is_set() {
        let (settings, both) = (SolverSettings::default(), [Transcription::Momentum, Transcription::Towr]);
        assert_eq!(both.map(|t| settings.barrier(t)), [0.02, 0.2]);
        let set = SolverSettings { barrier: Some(0.07), ..settings };
        assert_eq!(both.map(|t| set.barrier(t)), [0.07; 2]);
        assert!(set.validate().is_ok() && SolverSettings { barrier: Some(0.), ..set }.validate().is_err());
    }

    #[test]
    fn closing_steps_go_on_while_each_leaves_a_tenth() {
        let progress = closing(9e-7);
        assert_eq!((progress.closing_from, progress.proximal()), (9e-7, LIMITS.proximal_floor));
        let next = begun(progress, &LIMITS, 0.9e-7);
        assert_eq!((next.state, next.closing_from, next.closing_below), (CLOSE, 0.9e-7, 1e-6));
        // Measured by the last step, not by the first.
        assert_eq!(begun(next, &LIMITS, 0.8e-7).state, STEP);
        assert_eq!(begun(next, &LIMITS, 0.8e-8).state, CLOSE);
    }

    #[test]
    fn closing_that_is_too_slow_waits_for_a_tenth_of_where_it_was() {
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
    fn what_always_closes_closes_slowly_too() {
        let limits = Limits { closing: f64::INFINITY, ..LIMITS };
        let mut progress = Progress::first(&limits, BARRIER, 0.);
        for f in [10., 9., 8.5] {
            progress = begun(progress, &limits, f);
            assert_eq!((progress.state, progress.smoothing, progress.closing_below), (CLOSE, 0., f64::INFINITY));
        }
    }

    #[test]
    fn what_never_closes_keeps_to_barrier_steps() {
        let limits = Limits { closing: 0., stall_start: NONE, ..LIMITS };
        for f in [1., 1e-12, 0.] {
            assert_eq!(begun(Progress::first(&limits, BARRIER, 0.04), &limits, f).state, STEP);
        }
    }

    #[test]
    fn an_accepted_step_sets_the_next_proximal_weight_by_its_ratio() {
        let eps = |ratio: f64| accepted(first(), ratio).eps;
        assert_eq!([0.71, 1., 3., f64::INFINITY].map(eps), [2.5e-4; 4]);
        assert_eq!([0.25, 0.5, 0.7].map(eps), [1e-3; 3]);
        assert_eq!([0.24, 0., -2., f64::NEG_INFINITY].map(eps), [2e-3; 4]);
        let low = Progress { eps: 3e-5, ..first() };
        assert_eq!(accepted(low, 1.).eps, LIMITS.proximal_floor);
    }

    #[test]
    fn an_accepted_step_counts_and_changes_buffers() {
        let progress = Progress { attempts: 3, iterations: 4, current: 0, ..first() };
        let next = accepted(progress, 0.5);
        assert_eq!(next, Progress { attempts: 0, iterations: 5, current: 1, ..progress });
        assert_eq!(accepted(next, 0.5), Progress { attempts: 0, iterations: 6, current: 0, ..progress });
    }

    #[test]
    fn barrier_and_closing_steps_have_proximal_weights_of_their_own() {
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
    fn a_refused_step_is_tried_by_a_quarter_and_by_a_quarter_of_that_along_the_same_direction() {
        let start = Progress { iterations: 4, current: 1, length: 0.8, dual_length: 0.4, ..begun(first(), &LIMITS, 1.) };
        let shorter = Progress { state: SHORTER, attempts: 1, length: 0.2, dual_length: 0.1, ..start };
        assert_eq!(refused(start, 1), shorter);
        assert_eq!(refused(start, 2), Progress { attempts: 2, length: 0.05, dual_length: 0.025, ..shorter });
        // What it says of the proximal weight is nothing.
        for ratio in [0.1, 0.5, 0.9] {
            let taken = accepted(shorter, ratio);
            assert_eq!(taken, Progress { attempts: 0, iterations: 5, current: 0, ..shorter });
            assert_eq!(begun(taken, &LIMITS, 0.5).state, STEP);
        }
    }

    #[test]
    fn behind_the_shorter_steps_six_larger_weights_end_the_solve() {
        // Of no length, so that shorter ones are the same.
        let start = Progress { iterations: 4, current: 1, length: 0., dual_length: 0., ..begun(first(), &LIMITS, 1.) };
        for times in 1..6 {
            let progress = refused(start, SHORTENINGS + times);
            assert_close(progress.eps, 1e-3 * 6_f64.powi(times as i32));
            assert_eq!(progress, Progress { attempts: SHORTENINGS + times, eps: progress.eps, ..start });
        }
        let end = refused(start, ATTEMPTS);
        assert_eq!(end, Progress { state: STALLED, attempts: 0, eps: end.eps, ..start });
        // A step that is taken starts the count anew.
        assert_eq!(refused(accepted(refused(start, ATTEMPTS - 1), 0.5), ATTEMPTS - 1).state, STEP);
    }

    #[test]
    fn without_a_factor_there_is_no_direction_to_go_less_far() {
        let start = begun(first(), &LIMITS, 1.);
        let mut progress = start;
        damp(&mut progress);
        assert_eq!(progress, Progress { attempts: SHORTENINGS + 1, eps: 6e-3, ..start });
    }

    #[test]
    fn a_refused_closing_step_leads_back_to_the_barrier() {
        let start = closing(5e-7);
        let back = refused(start, 1);
        assert_eq!(back, Progress { state: STEP, closing_below: back.closing_below, ..start });
        assert_close(back.closing_below, 5e-8);
        // The same point again, now with a barrier step.
        let again = begun(back, &LIMITS, 5e-7);
        assert_eq!((again.state, again.smoothing, again.closing_eps), (STEP, LIMITS.smoothing, LIMITS.proximal_floor));
        assert_eq!([begun(again, &LIMITS, 6e-8).state, begun(again, &LIMITS, 4e-8).state], [STEP, CLOSE]);
        // The threshold never rises.
        assert_close(refused(Progress { closing_below: 1e-9, ..start }, 1).closing_below, 1e-10);
    }

    #[test]
    fn what_always_closes_is_tried_with_larger_weights() {
        let limits = Limits { closing: f64::INFINITY, ..LIMITS };
        let start = begun(Progress::first(&limits, BARRIER, 0.), &limits, 10.);
        let next = refused(start, 1);
        assert_eq!((next.state, next.attempts, next.eps), (CLOSE, SHORTENINGS + 1, LIMITS.proximal));
        assert_close(next.closing_eps, 6. * LIMITS.proximal_floor);
        assert_eq!(refused(start, 6).state, STALLED);
    }

    #[test]
    fn a_trial_point_is_taken_where_the_merit_falls() {
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
    fn a_barrier_step_is_taken_near_its_linear_model_too() {
        let (step, close) = (begun(first(), &LIMITS, 1.), closing(1e-7));
        // The gap is below 0.3 of what was predicted, or of a twentieth of the infeasibility.
        for step in [step, Progress { state: SHORTER, ..step }] {
            assert_eq!([0.29, 0.31].map(|gap| acceptable(&step, -1., 1., gap)), [true, false]);
        }
        for predicted in [0.01, 0., -1.] {
            assert_eq!([0.0149, 0.0151].map(|gap| acceptable(&step, -1., predicted, gap)), [true, false]);
        }
        assert!(!acceptable(&close, -1., 1., 0.), "closing steps lower the infeasibility or are refused");
    }
}
