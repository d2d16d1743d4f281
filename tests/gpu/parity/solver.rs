//! Steps of the solver. Inputs are seeded numbers of the size that they have in a solve.

use super::candidates::candidates;
use super::lab::{CAPACITY, Expected, Lab, POISON, SMALL, Slot, State, fill, gpu, states, stem};
use super::minimise::{problem_of, put_residuals, put_shifts, residuals_of, shifts};
use super::{ARITHMETIC, SUM};
use crate::common::{self, Random};
use cregopt::backend::gpu::Prepared;
use cregopt::backend::gpu::shaders::Shader;
use cregopt::nlp::Problem;
use cregopt::rows::RowKind;
use cregopt::solver::Residuals;
use cregopt::solver::control::{self, CLOSE, EXACT, Limits, MINIMISE, Progress, REVERT, SHORTER, SOLVED, STEP};
use cregopt::solver::minimise::subtract_shifts;
use cregopt::solver::objective::Objective;
use cregopt::solver::slacks::{BarrierTarget, FRACTION_TO_THE_BOUNDARY, Lengths, Slacks, largest, mean_product, slack_steps};
use cregopt::solver::{advance, judge, start, weights};
use std::collections::BTreeMap;

/// Random slacks, multipliers and their steps.
pub fn barrier_state(lab: &Lab, s: usize, state: &mut State, random: &mut Random, steps: bool) {
    let batch = &lab.batch;
    for array in [batch.slack, batch.multiplier] {
        for i in lab.of_inequalities(s, array) {
            state.values[i] = (10f64).powf(random.between(-3., 0.5)) as f32;
        }
    }
    if steps {
        for array in [batch.slack_step, batch.multiplier_step] {
            fill(&mut state.values, lab.of_inequalities(s, array), random, -0.5, 0.5);
        }
    }
}

/// Limits of the solve of a slot's candidate.
pub fn limits(lab: &Lab, s: usize) -> Limits<f32> {
    Limits::new(&lab.settings, lab.slots[s].problem.curves.transcription)
}

/// Slacks of a slot in the form of the twin. Steps that are poison become zero, because the twin multiplies them by zero.
pub fn slacks(lab: &Lab, s: usize, state: &State) -> Slacks<f32> {
    let clean = |v: &f32| if v.is_nan() { 0. } else { *v };
    let of = |array| state.values[lab.of_inequalities(s, array)].iter().map(clean).collect();
    let batch = &lab.batch;
    Slacks {
        slack: of(batch.slack),
        multiplier: of(batch.multiplier),
        slack_step: of(batch.slack_step),
        multiplier_step: of(batch.multiplier_step),
    }
}

/// A Jacobian of the right structure: the one at the point.
pub fn jacobian_at(slot: &Slot) -> Vec<f32> {
    common::rows(&slot.problem, &slot.candidate.x, 0.).jacobian
}

/// Random residuals of one half, of a given size.
pub fn residuals(lab: &Lab, s: usize, half: u32, state: &mut State, random: &mut Random, size: f64) {
    fill(&mut state.values, lab.c(s, half), random, -size, size);
    fill(&mut state.values, lab.g(s, half), random, -2. * size, size);
}

/// Runs a shader of the solver.
///
/// * `prepare` - writes its inputs
/// * `twin` - computes the expected results from the shader's own earlier ones, so that each stage is compared on the numbers of the
///   stages before it
pub fn solver_step(
    shader: Shader,
    of_states: &[u32],
    tweak: impl Fn(usize, &mut Prepared),
    prepare: impl Fn(&Lab, usize, &mut State, &mut Random),
    twin: impl Fn(&Lab, usize, &State, &mut Expected),
    tolerance: impl Fn(&str) -> f32,
) {
    let test = format!("{}_agrees_with_its_twin", stem(shader));
    let Some(device) = gpu(&test) else { return };
    let candidates = candidates();
    let mut lab = Lab::new(&device, &candidates, CAPACITY, SMALL, tweak);
    let mut before = lab.poisoned();
    states(&lab, &mut before, of_states);
    let mut random = Random::new(21);
    for s in 0..lab.slots.len() {
        prepare(&lab, s, &mut before, &mut random);
    }
    for list in lab.lists() {
        let got = lab.run(shader, &list, &before);
        let mut expected = Expected { state: before.clone(), sizes: BTreeMap::new() };
        for &s in &list {
            twin(&lab, s as usize, &got, &mut expected);
        }
        lab.check(shader, &got, &expected, &tolerance);
    }
}

#[test]
fn start_agrees_with_its_twin() {
    solver_step(
        Shader::Start,
        &[STEP, SOLVED, CLOSE],
        |_, _| {},
        |lab, s, state, random| {
            // The initial point is a trial point.
            let half = 1 - state.progress[s].current;
            state.progress[s].mu = random.between(1e-4, 1.) as f32;
            let all = lab.range(s, lab.batch.x + half * lab.batch.x_half, lab.batch.x_half as usize);
            fill(&mut state.values, all, random, -5., 5.);
            fill(&mut state.values, lab.g(s, half), random, -2., 1.);
            let to = lab.jacobian(s, half);
            state.jacobian[to].copy_from_slice(&jacobian_at(&lab.slots[s]));
        },
        |lab, s, _, expected| {
            let (problem, state) = (&lab.slots[s].problem, &mut expected.state);
            let half = 1 - state.progress[s].current;
            let mut scaling = vec![f32::NAN; problem.variables];
            let (mut counts, mut local) = (vec![0.; problem.rows.all()], vec![0.; problem.widest]);
            start::column_scaling(problem, &state.jacobian[lab.jacobian(s, half)], &mut counts, &mut local, &mut scaling);
            state.values[lab.of_variables(s, lab.batch.scaling)].copy_from_slice(&scaling);
            let mut slacks = slacks(lab, s, state);
            start::start_slacks(&state.values[lab.g(s, half)], state.progress[s].mu, &mut slacks);
            state.values[lab.of_inequalities(s, lab.batch.slack)].copy_from_slice(&slacks.slack);
            state.values[lab.of_inequalities(s, lab.batch.multiplier)].copy_from_slice(&slacks.multiplier);
            let [from, to] = [half, 1 - half].map(|half| lab.range(s, lab.batch.x + half * lab.batch.x_half, lab.batch.x_half as usize));
            state.values.copy_within(from, to.start);
            state.progress[s].current = half;
            state.progress[s].state = STEP;
        },
        |name| match name {
            "scaling" => SUM,
            "slack" | "multiplier" => ARITHMETIC,
            _ => 0.,
        },
    );
}

/// Sizes of the terms of a row's value in a barrier step.
pub fn row_sizes(lab: &Lab, s: usize, expected: &mut Expected, g: &[f32], slacks: &Slacks<f32>, aim: BarrierTarget<f32>) {
    let problem = &lab.slots[s].problem;
    let size = |i: usize| {
        let (s, z) = (slacks.slack[i], slacks.multiplier[i]);
        let product = aim.mu + (aim.correction * slacks.slack_step[i] * slacks.multiplier_step[i]).abs();
        z + (g[i].abs() + z + product / z) / (s / z + 1.)
    };
    for element in problem.all_elements().filter(|e| e.kind() == RowKind::Inequality) {
        for r in 0..element.rows {
            let upper = (element.place.inequality + r) as usize;
            let lower = if r < element.pairs { size(upper + element.rows as usize) } else { 0. };
            let at = lab.of_rows(s, lab.batch.value).start + (element.place.row + r) as usize;
            expected.sizes.insert(at, size(upper) + lower);
        }
    }
}

/// Random inputs of `weights`: a state at the begin of a round, residuals, slacks and variables.
pub fn prepare_weights(lab: &Lab, s: usize, state: &mut State, random: &mut Random) {
    let progress = &mut state.progress[s];
    let half = progress.current;
    let attempts = progress.attempts;
    *progress = Progress {
        state: progress.state,
        current: half,
        attempts,
        factorisations: s as u32,
        recorded: s as u32,
        // The window is never full; the stall rule has a test of its own.
        stall_from: s as u32,
        iterations: s as u32 / 2,
        infeasibility: if attempts == 0 { POISON } else { 3. },
        mu: random.between(1e-3, 0.1) as f32,
        smoothing: random.between(0.01, 0.1) as f32,
        eps: 3e-4,
        closing_eps: 7e-5,
        // Closes after refused attempts, and the first of the rest.
        early_termination_limit: progress.early_termination_limit,
        ..Progress::first(&limits(lab, s), progress.barrier, progress.edge_radius)
    };
    if progress.state == EXACT {
        // Rows become exact only before a round.
        progress.attempts = 0;
    }
    // A few are near the end: most of their rows hold.
    let near = s.is_multiple_of(5);
    residuals(lab, s, half, state, random, if near { 1e-6 } else { 1. });
    if near {
        let quiet = lab.g(s, half);
        state.values[quiet].iter_mut().for_each(|g| *g = if *g > 0. { *g } else { *g - 0.1 });
    }
    // Nearly active: inside and outside the reach of closing steps.
    let first = lab.g(s, half).start;
    state.values[first..first + 2].copy_from_slice(&[-5e-5, -2e-4]);
    barrier_state(lab, s, state, random, false);
    fill(&mut state.values, lab.of_variables(s, lab.batch.scaling), random, 0.01, 30.);
    for array in [lab.batch.smoothing, lab.batch.initial] {
        fill(&mut state.values, lab.of_variables(s, array), random, 0., 1.);
    }
    fill(&mut state.values, lab.x(s, half), random, -2., 2.);
}

/// Starts the slacks at the current point.
fn restart_slacks(lab: &Lab, s: usize, state: &mut State, progress: &Progress<f32>) {
    let mut slacks = slacks(lab, s, state);
    start::start_slacks(&state.values[lab.g(s, progress.current)], progress.mu, &mut slacks);
    state.values[lab.of_inequalities(s, lab.batch.slack)].copy_from_slice(&slacks.slack);
    state.values[lab.of_inequalities(s, lab.batch.multiplier)].copy_from_slice(&slacks.multiplier);
}

/// `Solver::choose`.
fn choose(lab: &Lab, s: usize, state: &mut State, progress: &mut Progress<f32>) {
    let (problem, now) = (&lab.slots[s].problem, residuals_of(lab, s, progress.current, state));
    let f = judge::infeasibility(&now.c[problem.rows.of(RowKind::Equality)], &now.g);
    let ring = lab.range(s, lab.batch.history, 0).start + progress.recorded as usize % lab.settings.stall.window;
    let largest = largest(&slacks(lab, s, state).multiplier);
    control::begin(progress, &limits(lab, s), f, POISON, largest, f < lab.settings.tolerance as f32);
    if progress.state != EXACT {
        state.values[ring] = f;
    }
    if progress.phase == MINIMISE {
        let x = lab.of_variables(s, lab.batch.x + progress.current * lab.batch.x_half);
        state.values.copy_within(x, lab.of_variables(s, lab.batch.solved).start);
        let equalities = problem.rows.of(RowKind::Equality).len();
        put_shifts(lab, s, state, &Residuals { c: vec![0.; equalities], g: vec![0.; problem.inequalities] });
        restart_slacks(lab, s, state, progress);
    }
}

/// `Solver::begin`.
fn begin(lab: &Lab, s: usize, state: &mut State, progress: &mut Progress<f32>) {
    let half = progress.current;
    if control::is_minimised(progress) {
        let mut now = residuals_of(lab, s, half, state);
        subtract_shifts(&mut now, &shifts(lab, s, state));
        put_residuals(lab, s, half, state, &now);
        control::restore(progress, &limits(lab, s));
        restart_slacks(lab, s, state, progress);
    }
    match progress.phase {
        MINIMISE => progress.state = STEP,
        REVERT => {}
        _ => choose(lab, s, state, progress),
    }
    if progress.phase == REVERT {
        let x = lab.of_variables(s, lab.batch.x + half * lab.batch.x_half);
        state.values.copy_within(lab.of_variables(s, lab.batch.solved), x.start);
        control::revert(progress);
    }
}

/// Expected results of `weights`: progress, and the weights and gradients of rows and variables.
pub fn weights_of_twin(lab: &Lab, s: usize, expected: &mut Expected) {
    let batch = &lab.batch;
    let state = &mut expected.state;
    let mut progress = state.progress[s];
    if progress.ended() {
        return;
    }
    let half = progress.current;
    if progress.attempts == 0 {
        begin(lab, s, state, &mut progress);
    }
    let Residuals { c, g } = residuals_of(lab, s, half, state);
    let problem = &problem_of(lab, s, state);
    progress.factorisations += u32::from(progress.state <= CLOSE);
    state.progress[s] = progress;
    if progress.state == EXACT {
        let (from, to) = (lab.of_variables(s, batch.x + half * batch.x_half), lab.x(s, 1 - half).start);
        state.values.copy_within(from, to);
    }
    if progress.state > CLOSE {
        return;
    }
    let slacks = slacks(lab, s, state);
    let aim = BarrierTarget::predictor();
    let (mut weight, mut value) = (vec![f32::NAN; problem.rows.all()], vec![f32::NAN; problem.rows.all()]);
    if progress.state == CLOSE {
        let reach = weights::closing_reach(progress.infeasibility, progress.attempts);
        weights::closing_rows(problem, &c, &g, reach, &mut weight, &mut value);
    } else {
        weights::barrier_rows(problem, &c, &g, &slacks, aim, &mut weight, &mut value);
    }
    Objective::of(&limits(lab, s), &progress).rows(problem, &c, &slacks.multiplier, &mut weight, &mut value);
    let of = |array| state.values[lab.of_variables(s, array)].to_vec();
    let (scaling, smoothing, x, initial) = (of(batch.scaling), of(batch.smoothing), of(batch.x + half * batch.x_half), of(batch.initial));
    let (mut diagonal, mut gradient) = (vec![f32::NAN; problem.variables], vec![f32::NAN; problem.variables]);
    let filled = Problem { smoothing, initial, ..problem.clone() };
    weights::variable_terms(&filled, &scaling, progress.proximal(), progress.smoothing, &x, &mut diagonal, &mut gradient);
    state.values[lab.of_rows(s, batch.weight)].copy_from_slice(&weight);
    state.values[lab.of_rows(s, batch.value)].copy_from_slice(&value);
    state.values[lab.of_variables(s, batch.diagonal)].copy_from_slice(&diagonal);
    state.values[lab.of_variables(s, batch.gradient)].copy_from_slice(&gradient);
    if progress.state == STEP {
        row_sizes(lab, s, expected, &g, &slacks, aim);
    }
}

#[test]
fn weights_agrees_with_its_twin() {
    solver_step(
        Shader::Weights,
        &[STEP, CLOSE, STEP, SOLVED, CLOSE, SHORTER, EXACT],
        |_, _| {},
        prepare_weights,
        |lab, s, _, expected| weights_of_twin(lab, s, expected),
        |name| match name {
            "infeasibility" | "history" | "closing_from" => SUM,
            "weight" | "value" | "diagonal" | "gradient" | "smoothing" => ARITHMETIC,
            _ => 0.,
        },
    );
}

#[test]
fn correct_agrees_with_its_twin() {
    solver_step(
        Shader::Correct,
        &[STEP, CLOSE, SHORTER, EXACT, STEP, SOLVED],
        |_, _| {},
        |lab, s, state, random| {
            let half = state.progress[s].current;
            residuals(lab, s, half, state, random, 1.);
            let by = lab.of_inequalities(s, lab.batch.g_change);
            // Small changes leave the full step.
            let size = if s % 4 == 0 { 1e-3 } else { 1. };
            fill(&mut state.values, by, random, -size, size);
            barrier_state(lab, s, state, random, false);
            state.progress[s].barrier_floor = [1e-9, 0.5][s % 2];
            let flag = lab.flags(s);
            state.values[flag] = f32::from(s % 7 == 3);
        },
        |lab, s, got, expected| {
            let (batch, problem) = (&lab.batch, &lab.slots[s].problem);
            let state = &mut expected.state;
            let half = state.progress[s].current;
            if state.progress[s].state != STEP || state.values[lab.flags(s)] != 0. {
                return;
            }
            let (c, g) = (state.values[lab.c(s, half)].to_vec(), state.values[lab.g(s, half)].to_vec());
            steps_of_slacks(lab, s, expected, BarrierTarget::predictor());
            // From its own steps on.
            let own = slacks(lab, s, got);
            let all = mean_product(&own, Lengths::none());
            let share = mean_product(&own, lengths_of(&own)) / all;
            let state = &mut expected.state;
            state.progress[s].mu = (all * share.clamp(0., 1.) * share.clamp(0., 1.)).max(state.progress[s].barrier_floor);
            let aim = BarrierTarget::corrector(got.progress[s].mu);
            // Cost rows keep their weights and values.
            let [mut weight, mut value] = [batch.weight, batch.value].map(|array| state.values[lab.of_rows(s, array)].to_vec());
            weights::barrier_rows(problem, &c, &g, &own, aim, &mut weight, &mut value);
            state.values[lab.of_rows(s, batch.weight)].copy_from_slice(&weight);
            state.values[lab.of_rows(s, batch.value)].copy_from_slice(&value);
            row_sizes(lab, s, expected, &g, &own, aim);
        },
        |name| match name {
            "mu" => SUM,
            "weight" | "value" | "slack_step" | "multiplier_step" => ARITHMETIC,
            _ => 0.,
        },
    );
}

/// Places of the steps of slacks and multipliers, with the sizes of their terms.
pub fn steps_of_slacks(lab: &Lab, s: usize, expected: &mut Expected, aim: BarrierTarget<f32>) {
    let (batch, state) = (&lab.batch, &mut expected.state);
    let mut steps = slacks(lab, s, state);
    let g = state.values[lab.g(s, state.progress[s].current)].to_vec();
    let by = state.values[lab.of_inequalities(s, batch.g_change)].to_vec();
    let count = lab.slots[s].counts.inequalities as usize;
    let cut = |v: &mut Vec<f32>| v.truncate(count);
    let Slacks { slack, multiplier, slack_step, multiplier_step } = &mut steps;
    [slack, multiplier, slack_step, multiplier_step].into_iter().for_each(cut);
    let (old_ds, old_dz) = (steps.slack_step.clone(), steps.multiplier_step.clone());
    slack_steps(&g[..count], &by[..count], aim, &mut steps);
    let [ds_at, dz_at] = [batch.slack_step, batch.multiplier_step].map(|array| lab.of_inequalities(s, array).start);
    for i in 0..count {
        let (s, z) = (steps.slack[i], steps.multiplier[i]);
        let centre = (aim.mu + (aim.correction * old_ds[i] * old_dz[i]).abs()) / z;
        let dz = (by[i].abs() + g[i].abs() + z + centre) / (s / z + 1.);
        state.values[ds_at + i] = steps.slack_step[i];
        state.values[dz_at + i] = steps.multiplier_step[i];
        expected.sizes.insert(dz_at + i, dz);
        expected.sizes.insert(ds_at + i, centre + s + s / z * dz);
    }
}

/// Step lengths of slacks and multipliers by the fraction-to-the-boundary rule.
pub fn lengths_of(slacks: &Slacks<f32>) -> Lengths<f32> {
    let most = FRACTION_TO_THE_BOUNDARY as f32;
    let by = |value: &[f32], step: &[f32]| {
        let steepest = value.iter().zip(step).fold(0f32, |steepest, (v, by)| steepest.max(-by / v));
        if steepest > most { most / steepest } else { 1. }
    };
    Lengths { primal: by(&slacks.slack, &slacks.slack_step), dual: by(&slacks.multiplier, &slacks.multiplier_step) }
}

/// Numbers of variables and rows around the workgroup size. Only loops over them may depend on that.
pub fn truncated_counts(s: usize, prepared: &mut Prepared) {
    let (problem, slot) = (&mut prepared.problem, &mut prepared.slot);
    let cut = |n: u32, k: usize| n.min([63, 64, 65, 1, u32::MAX][(s + k) % 5]);
    slot.variables = cut(slot.variables, 0);
    slot.inequalities = cut(slot.inequalities, 1);
    slot.rows.equalities = cut(slot.rows.equalities, 2);
    problem.variables = slot.variables as usize;
    problem.inequalities = slot.inequalities as usize;
    problem.rows = slot.rows;
}

#[test]
fn advance_agrees_with_its_twin() {
    solver_step(
        Shader::Advance,
        &[STEP, CLOSE, SHORTER, EXACT, STEP, SOLVED],
        truncated_counts,
        |lab, s, state, random| {
            let half = state.progress[s].current;
            state.progress[s].mu = random.between(1e-3, 0.1) as f32;
            state.progress[s].length = random.between(0.1, 1.) as f32;
            state.progress[s].dual_length = random.between(0.1, 1.) as f32;
            fill(&mut state.values, lab.of_variables(s, lab.batch.x + half * lab.batch.x_half), random, -5., 5.);
            fill(&mut state.values, lab.of_variables(s, lab.batch.direction), random, -1., 1.);
            fill(&mut state.values, lab.g(s, half), random, -2., 1.);
            let size = if s % 4 == 0 { 1e-3 } else { 1. };
            fill(&mut state.values, lab.of_inequalities(s, lab.batch.g_change), random, -size, size);
            barrier_state(lab, s, state, random, true);
        },
        |lab, s, got, expected| {
            let progress = expected.state.progress[s];
            if progress.state > CLOSE && progress.state != SHORTER {
                return;
            }
            let mut lengths = Lengths::whole();
            if progress.state == SHORTER {
                lengths = Lengths { primal: progress.length, dual: progress.dual_length };
            } else if progress.state == STEP {
                steps_of_slacks(lab, s, expected, BarrierTarget::corrector(progress.mu));
                lengths = lengths_of(&slacks(lab, s, got));
            }
            let (batch, state) = (&lab.batch, &mut expected.state);
            (state.progress[s].length, state.progress[s].dual_length) = (lengths.primal, lengths.dual);
            let [x, to] = [progress.current, 1 - progress.current].map(|half| lab.of_variables(s, batch.x + half * batch.x_half));
            let (x, d) = (state.values[x].to_vec(), state.values[lab.of_variables(s, batch.direction)].to_vec());
            advance::advance(&x, got.progress[s].length, &d, &mut state.values[to]);
        },
        |name| match name {
            "slack_step" | "multiplier_step" | "length" | "dual_length" | "x" => ARITHMETIC,
            _ => 0.,
        },
    );
}
