//! Verdicts on trial points.

use super::candidates::candidates;
use super::lab::{CAPACITY, Expected, Lab, SMALL, State, fill, gpu, states};
use super::minimise::{draw_shifts, minimised, problem_of, put_residuals, put_shifts, residuals_of, shifts};
use super::solver::{barrier_state, limits, residuals, slacks, truncated_counts};
use super::{ARITHMETIC, SUM};
use crate::common::Random;
use cregopt::backend::gpu::shaders::Shader;
use cregopt::rows::RowKind;
use cregopt::settings::Transcription;
use cregopt::solver::Residuals;
use cregopt::solver::control::{
    self, ATTEMPTS, CLOSE, ENDED, EXACT, Limits, MINIMISE, Progress, RESTORE_NEXT, SHORTENINGS, SHORTER, SOLVE, SOLVED, STEP,
};
use cregopt::solver::judge;
use cregopt::solver::minimise::{add_shifts, subtract_shifts, update_shifts};
use cregopt::solver::objective::Objective;
use cregopt::solver::slacks::Lengths;
use std::collections::BTreeMap;
use std::ops::Range;

/// Progress before a verdict, with a distinct value in every member.
fn before_verdict(s: usize, progress: Progress<f32>, random: &mut Random) -> Progress<f32> {
    Progress {
        attempts: [0, 1, SHORTENINGS, SHORTENINGS + 2, ATTEMPTS - 1][random.index(0..=4)],
        iterations: 3 * s as u32,
        factorisations: 4 * s as u32,
        recorded: 5 * s as u32,
        stall_from: s as u32,
        mu: random.between(1e-3, 0.1) as f32,
        smoothing: [0., 0.05][s % 2],
        // Close to the floor: a quarter of it would be below.
        eps: [1e-3, 3e-6][s / 2 % 2],
        closing_eps: [2e-6, 4e-3][s / 3 % 2],
        closing_below: 1e-4,
        closing_from: 7e-4,
        length: random.between(0.2, 1.) as f32,
        dual_length: [0.3, 1.][s % 2],
        ..progress
    }
}

/// A trial point that follows the linear model except for noise, equalities first.
struct Trial {
    noise: Vec<f64>,
}

impl Trial {
    /// Draws everything that a verdict depends on.
    fn draw(lab: &Lab, s: usize, state: &mut State, random: &mut Random) -> Trial {
        let (batch, progress) = (&lab.batch, state.progress[s]);
        residuals(lab, s, progress.current, state, random, 1.);
        // The changes lead downhill, or anywhere.
        let down = random.between(-0.2, 1.);
        for (at, by) in lab.changes(s, progress.current) {
            for (at, by) in at.zip(by) {
                state.values[by] = (-down * f64::from(state.values[at]) + random.between(-0.1, 0.1)) as f32;
            }
        }
        for half in [0, 1] {
            fill(&mut state.values, lab.of_variables(s, batch.x + half * batch.x_half), random, -1., 1.);
        }
        fill(&mut state.values, lab.of_variables(s, batch.initial), random, -1., 1.);
        fill(&mut state.values, lab.of_variables(s, batch.smoothing), random, 0., 1.);
        barrier_state(lab, s, state, random, true);
        if progress.phase == MINIMISE {
            let size = 10f64.powf(random.between(0., 4.));
            draw_shifts(lab, s, state, random, size);
        }
        let problem = &lab.slots[s].problem;
        let trial = Trial { noise: (0..problem.rows.one_sided() + problem.inequalities).map(|_| random.between(-1., 1.)).collect() };
        trial.put(lab, s, state, 10f64.powf(random.between(-3., 0.3)));
        trial
    }

    /// Writes the trial point whose distance from the linear model is `miss` times the noise, without the shifts.
    fn put(&self, lab: &Lab, s: usize, state: &mut State, miss: f64) {
        let progress = state.progress[s];
        let mut noise = self.noise.iter();
        let trial = lab.changes(s, 1 - progress.current).map(|(to, _)| to);
        for ((at, by), to) in lab.changes(s, progress.current).into_iter().zip(trial) {
            for ((at, by), to) in at.zip(by).zip(to) {
                let linear = f64::from(state.values[at]) + f64::from(progress.length) * f64::from(state.values[by]);
                state.values[to] = (linear + miss * noise.next().unwrap()) as f32;
            }
        }
        if progress.phase == MINIMISE {
            let mut trial = residuals_of(lab, s, 1 - progress.current, state);
            subtract_shifts(&mut trial, &shifts(lab, s, state));
            put_residuals(lab, s, 1 - progress.current, state, &trial);
        }
    }

    /// Scales the noise so that the merit falls by a share of the predicted fall. Leaves the point as it is if no scale does.
    fn aim(&self, lab: &Lab, s: usize, state: &mut State, share: f64) {
        let mut beyond = |miss: f64| {
            self.put(lab, s, state, miss);
            let Falls { fall, predicted, .. } = falls(lab, s, state);
            fall > share * predicted.abs()
        };
        let [mut low, mut high] = [0., 4.];
        if !beyond(low) || beyond(high) {
            return;
        }
        for _ in 0..12 {
            let middle = 0.5 * (low + high);
            *(if beyond(middle) { &mut low } else { &mut high }) = middle;
        }
        self.put(lab, s, state, low);
    }
}

/// Falls as in `Solver::judge`. In f64, to determine the margin of a verdict.
struct Falls {
    /// Fall of the merit.
    fall: f64,
    /// Fall of its linear model.
    predicted: f64,
    /// Distance between both.
    gap: f64,
    /// Sum of the sizes of these numbers and of their parts.
    size: f64,
    /// Weighted cost at the trial point.
    cost: f64,
}

/// Residuals of the trial point, with the shifts.
fn trial_residuals(lab: &Lab, s: usize, state: &State) -> Residuals<f32> {
    let progress = state.progress[s];
    let mut trial = residuals_of(lab, s, 1 - progress.current, state);
    if progress.phase == MINIMISE {
        add_shifts(&mut trial, &shifts(lab, s, state));
    }
    trial
}

fn falls(lab: &Lab, s: usize, state: &State) -> Falls {
    let (batch, progress) = (&lab.batch, state.progress[s]);
    let (half, to) = (progress.current, 1 - progress.current);
    let wide = |values: &[f32]| values.iter().map(|v| f64::from(*v)).collect::<Vec<f64>>();
    let of = |range: Range<usize>| wide(&state.values[range]);
    let trial = trial_residuals(lab, s, state);
    // Cost rows follow the equalities.
    let equalities = lab.slots[s].problem.rows.of(RowKind::Equality);
    let all = [of(lab.c(s, half)), wide(&trial.c)];
    let [c, c_to] = [0, 1].map(|i| all[i][equalities.clone()].to_vec());
    let (g, g_to) = (of(lab.g(s, half)), wide(&trial.g));
    let length = f64::from(progress.length);
    let linear = |at: &[f64], by: &[f64]| at.iter().zip(by).map(|(at, by)| at + length * by).collect::<Vec<f64>>();
    let all_linear = linear(&all[0], &of(lab.of_equalities(s, batch.c_change)));
    let c_linear = all_linear[equalities.clone()].to_vec();
    let g_linear = linear(&g, &of(lab.of_inequalities(s, batch.g_change)));
    let [fall, predicted] = if progress.state == CLOSE {
        [(&c_to, &g_to), (&c_linear, &g_linear)].map(|(c_to, g_to)| judge::infeasibility_fall(&c, &g, c_to, g_to))
    } else {
        judge::merit_falls(&c, &g, [(&c_to, &g_to), (&c_linear, &g_linear)], f64::from(progress.mu))
    };
    let x = |half: u32| of(lab.of_variables(s, batch.x + half * batch.x_half));
    let (smoothing, initial) = (of(lab.of_variables(s, batch.smoothing)), of(lab.of_variables(s, batch.initial)));
    let smoothed = f64::from(progress.smoothing) * judge::smoothing_fall(&smoothing, &x(half), &x(to), &initial);
    let gap = judge::nonlinearity(&c_to, &c_linear, &g_to, &g_linear);
    let (objective, problem) = (Objective::of(&limits(lab, s), &progress), problem_of(lab, s, state));
    let narrow = |values: &[f64]| values.iter().map(|v| *v as f32).collect::<Vec<f32>>();
    let fall_to = |to: &[f64]| f64::from(objective.fall(&problem, &narrow(&all[0]), &narrow(to)));
    let [of_costs, of_linear] = [fall_to(&all[1]), fall_to(&all_linear)];
    let size = fall.abs() + predicted.abs() + gap + smoothed.abs() + of_costs.abs() + of_linear.abs();
    let cost = f64::from(objective.cost(&problem, &trial.c));
    Falls { fall: fall + smoothed + of_costs, predicted: predicted + smoothed + of_linear, gap, size, cost }
}

/// Least distance of a fall from a limit, relative to the sizes of the falls. Falls and their prediction are sums in another order: a
/// decision that depends on their last digits cannot be compared.
const CLEAR: f64 = 1e-3;

/// Names of the verdicts, and whether they occur while the rows are solved and while a cost is minimised.
const OUTCOMES: [(&str, [bool; 2]); 13] = [
    ("failed", [true, true]),
    ("exact", [true, false]),
    ("taken at ratios below 0.25", [true, true]),
    ("between", [true, true]),
    ("above 0.7", [true, true]),
    ("taken near the linear model", [true, true]),
    ("shortened", [true, true]),
    ("back to the barrier", [true, false]),
    ("refused", [true, true]),
    ("every step refused", [true, true]),
    ("optimal", [false, true]),
    ("not optimal", [false, true]),
    ("above the limit of the cost", [false, true]),
];

/// Verdict of the twin on the trial point of a slot, with its names in [`OUTCOMES`]; `None` if a limit is too close.
fn verdict_of_twin(lab: &Lab, limits: &Limits<f32>, s: usize, before: &State) -> Option<(Progress<f32>, Vec<&'static str>)> {
    let mut verdict = before.progress[s];
    let state = verdict.state;
    let Falls { fall, predicted, gap, size, cost } = falls(lab, s, before);
    let wide = Progress { state, infeasibility: f64::from(verdict.infeasibility), ..Progress::<f64>::default() };
    let model = 0.3 * predicted.max(0.05 * wide.infeasibility);
    let near = |a: f64, b: f64| (a - b).abs() <= CLEAR * size;
    if [0., 0.25, 0.5, 0.7].iter().any(|limit| near(fall, limit * predicted)) || near(predicted, 0.) || near(gap, model) {
        return None;
    }
    let phase = verdict.phase;
    let most = f64::from(limits.minimise.cost_limit);
    if phase == MINIMISE && (near(predicted, lab.settings.optimise.tolerance * cost) || near(cost, most)) {
        return None;
    }
    let mut names = Vec::new();
    if control::acceptable(&wide, fall, predicted, gap) {
        let ratio = if predicted > 0. { fall / predicted } else { 0. };
        control::accept(&mut verdict, limits, ratio as f32);
        names.push(["taken at ratios below 0.25", "between", "above 0.7"][usize::from(ratio > 0.25) + usize::from(ratio > 0.7)]);
        if fall < 0. {
            names.push("taken near the linear model");
        }
        if phase == MINIMISE {
            minimised(lab, s, &mut verdict, predicted, cost);
            names.push(match verdict.phase {
                _ if cost > most => "above the limit of the cost",
                RESTORE_NEXT => "optimal",
                _ => "not optimal",
            });
        }
    } else {
        control::refuse(&mut verdict);
        names.push(match verdict.state {
            SHORTER => "shortened",
            control::STEPS_REFUSED => "every step refused",
            _ if verdict.phase != phase => "every step refused",
            STEP if state == CLOSE => "back to the barrier",
            _ => "refused",
        });
    }
    Some((verdict, names))
}

/// Draws a trial point of a slot whose verdict is clear. Returns the verdict and its names.
fn draw_verdict(
    lab: &Lab,
    limits: &Limits<f32>,
    s: usize,
    seed: usize,
    before: &mut State,
    random: &mut Random,
) -> (Progress<f32>, Vec<&'static str>) {
    let rounds = before.progress[s];
    if rounds.state >= ENDED {
        return (rounds, Vec::new());
    }
    loop {
        before.progress[s] = before_verdict(s + seed, Progress { infeasibility: 1., ..before.progress[s] }, random);
        if s % 4 == 3 {
            // Large enough for the logarithms of slacks to decide.
            before.progress[s].mu *= 30.;
        }
        if rounds.phase == MINIMISE {
            let progress = &mut before.progress[s];
            let floor = lab.settings.optimise.rounding_floor as f32;
            progress.mu = 10f64.powf(random.between(-7., -1.)) as f32;
            progress.rounding = if random.index(0..=3) == 0 { 2. * floor } else { floor };
        }
        let flag = lab.flags(s);
        before.values[flag] = f32::from(failed(s));
        let trial = Trial::draw(lab, s, before, random);
        let mut verdict = before.progress[s];
        if failed(s) && rounds.state <= CLOSE {
            control::damp(&mut verdict);
            return (verdict, vec!["failed"]);
        }
        if rounds.state == EXACT {
            control::renew(&mut verdict);
            return (verdict, vec!["exact"]);
        }
        // Close to a limit, on either side, or anywhere.
        let side = [0.95, 1.05][random.index(0..=1)];
        match random.index(0..=5) {
            0 => trial.aim(lab, s, before, 0.25 * side),
            1 => trial.aim(lab, s, before, 0.7 * side),
            2 => trial.aim(lab, s, before, 0.05 * (side - 1.)),
            3 => {
                trial.aim(lab, s, before, -0.1);
                let gap = falls(lab, s, before).gap;
                before.progress[s].infeasibility = (gap / (0.3 * 0.05) * side) as f32;
            }
            _ => {}
        }
        if let Some(clear) = verdict_of_twin(lab, limits, s, before) {
            return clear;
        }
    }
}

/// True for the slots whose factorisation failed.
fn failed(s: usize) -> bool {
    s % 9 == 4
}

/// State of the listed slots after their verdicts.
fn judged(lab: &Lab, before: &State, list: &[u32], verdicts: &[Progress<f32>]) -> Expected {
    let mut expected = Expected { state: before.clone(), sizes: BTreeMap::new() };
    for &s in list {
        let s = s as usize;
        let (state, verdict) = (&mut expected.state, verdicts[s]);
        let progress = state.progress[s];
        let stepped = matches!(progress.state, STEP | SHORTER) && !(failed(s) && progress.state == STEP);
        state.progress[s] = verdict;
        let minimises = progress.phase == MINIMISE && stepped;
        if minimises {
            state.progress[s] = progress;
            let trial = trial_residuals(lab, s, state);
            put_residuals(lab, s, 1 - progress.current, state, &trial);
            state.progress[s] = verdict;
        }
        if stepped && verdict.current != progress.current {
            let mut slacks = slacks(lab, s, state);
            judge::update_slacks(&mut slacks, Lengths { primal: progress.length, dual: progress.dual_length });
            for (array, values) in [(lab.batch.slack, &slacks.slack), (lab.batch.multiplier, &slacks.multiplier)] {
                let at = lab.of_inequalities(s, array);
                state.values[at].copy_from_slice(values);
            }
            if minimises {
                let (mut now, mut shift) = (residuals_of(lab, s, verdict.current, state), shifts(lab, s, state));
                update_shifts(&lab.slots[s].problem, &mut now, &mut shift, &slacks);
                put_residuals(lab, s, verdict.current, state, &now);
                put_shifts(lab, s, state, &shift);
            }
        }
    }
    expected
}

/// Compares the verdicts in a phase, in which the candidates have these states in turn.
fn agrees(test: &str, phase: u32, of_states: &[u32]) {
    let Some(device) = gpu(test) else { return };
    let candidates = candidates();
    let mut lab = Lab::new(&device, &candidates, CAPACITY, SMALL, truncated_counts);
    let limits = Limits::<f32>::new(&lab.settings, Transcription::Momentum);
    let mut outcomes: BTreeMap<&str, usize> = BTreeMap::new();
    for seed in 0..8 {
        let mut random = Random::new(31 + seed as u64);
        let mut before = lab.poisoned();
        states(&lab, &mut before, of_states);
        before.progress.iter_mut().for_each(|progress| progress.phase = phase);
        let mut verdicts = Vec::new();
        for s in 0..lab.slots.len() {
            let (verdict, names) = draw_verdict(&lab, &limits, s, seed, &mut before, &mut random);
            verdicts.push(verdict);
            names.into_iter().for_each(|name| *outcomes.entry(name).or_default() += 1);
        }
        for list in lab.lists() {
            let got = lab.run(Shader::Judge, &list, &before);
            lab.check(Shader::Judge, &got, &judged(&lab, &before, &list, &verdicts), |name| match name {
                "slack" | "multiplier" | "eps" | "closing_eps" | "closing_below" | "length" | "dual_length" => ARITHMETIC,
                "c" | "g" | "shift_c" | "shift_g" | "rounding" => ARITHMETIC,
                "barrier_floor" => SUM,
                _ => 0.,
            });
        }
    }
    eprintln!("verdicts: {outcomes:?}");
    for (what, [in_solve, in_minimise]) in OUTCOMES {
        let expected = if phase == SOLVE { in_solve } else { in_minimise };
        assert_eq!(outcomes.get(what).is_some_and(|n| *n > 2), expected, "verdict {what:?} among {outcomes:?}");
    }
}

#[test]
fn judge_agrees_with_its_twin() {
    agrees("judge_agrees_with_its_twin", SOLVE, &[STEP, CLOSE, SHORTER, EXACT, CLOSE, STEP, SHORTER, SOLVED]);
}

#[test]
fn judge_agrees_with_its_twin_while_a_cost_is_minimised() {
    agrees("judge_agrees_with_its_twin_while_a_cost_is_minimised", MINIMISE, &[STEP, SHORTER, STEP, SHORTER, STEP, SOLVED]);
}
