//! Decisions at the begin of a round: sixty rounds of candidates that converge, stall and fail.

use super::ARITHMETIC;
use super::candidates::{EDGE_RADIUS, candidates};
use super::lab::{CAPACITY, Expected, Lab, POISON, SMALL, State, fill, gpu};
use super::solver::{barrier_state, limits, slacks};
use crate::common::Random;
use cregopt::backend::gpu::shaders::Shader;
use cregopt::solver::control::{self, CLOSE, EXACT, Progress, SOLVED, STEP};
use cregopt::solver::slacks::largest;
use std::collections::BTreeMap;

/// First barrier parameter.
const BARRIER: f32 = 0.05;

/// Random state of a candidate before its first round.
fn prepare(lab: &Lab, s: usize, before: &mut State, random: &mut Random) {
    for half in [0, 1] {
        let (c, g) = (lab.c(s, half), lab.g(s, half));
        before.values[c].fill(0.);
        before.values[g].fill(-1.);
        let x = lab.x(s, half);
        fill(&mut before.values, x, random, -1., 1.);
    }
    barrier_state(lab, s, before, random, false);
    for array in [lab.batch.scaling, lab.batch.smoothing, lab.batch.initial] {
        fill(&mut before.values, lab.of_variables(s, array), random, 0., 1.);
    }
    before.progress[s] = Progress {
        current: s as u32 % 2,
        early_termination_limit: [20., f32::MAX][s % 2],
        ..Progress::first(&limits(lab, s), BARRIER, if s.is_multiple_of(3) { 0. } else { EDGE_RADIUS as f32 })
    };
}

/// Infeasibility of the next round: the one that follows from the rate; now and then a limit, hit exactly or nearly, or NaN; more often
/// in the states in which it matters.
fn infeasibility(lab: &Lab, progress: &Progress<f32>, follows: f32, round: usize, random: &mut Random) -> f32 {
    let closing = progress.state == CLOSE;
    let special = [lab.settings.closing as f32, lab.settings.tolerance as f32, 0.1 * progress.closing_from, progress.closing_below];
    let special = special[random.index(usize::from(closing)..=3)];
    match random.index(if closing { 0..=5 } else { 0..=11 }) {
        0 => special,
        1 => special * [0.999999, 1.000001, 0.5][random.index(0..=2)],
        // A NaN that hardware leaves as it is.
        2 if round > 20 => [POISON, f32::INFINITY, 1e-9][random.index(0..=2)],
        _ => follows,
    }
}

/// Two residuals with a given infeasibility, whose sum does not depend on order or fusing: the second, which another invocation adds,
/// compensates for the rounding of the first.
fn residuals_of(f: f32) -> [f32; 2] {
    let mut c = (2. * f).sqrt();
    if c * c > 2. * f {
        c = c.next_down();
    }
    let g = if f.is_finite() { (2. * f - c * c).sqrt() } else { 0. };
    [c, g]
}

/// Takes a step or refuses it, and clears the residuals for the next round. A slot that ended is filled again, with `true`: its ring has
/// values of another candidate.
fn go_on(lab: &Lab, s: usize, before: &mut State, random: &mut Random) -> bool {
    let progress = &mut before.progress[s];
    let mut again = false;
    match progress.state {
        STEP | CLOSE => {
            if progress.state == STEP && random.index(0..=2) == 0 {
                control::refuse(progress);
            }
            progress.length = random.between(0.05, 1.) as f32;
            control::accept(progress, &limits(lab, s), [0.1, 0.5, 0.9][random.index(0..=2)]);
        }
        EXACT => control::renew(progress),
        _ => {
            let eps = if s.is_multiple_of(2) { 0. } else { 0.04 };
            *progress = Progress { current: progress.current, ..Progress::first(&limits(lab, s), BARRIER, eps) };
            again = true;
        }
    }
    for half in [0, 1] {
        let (c, g) = (lab.c(s, half), lab.g(s, half));
        before.values[c].fill(0.);
        before.values[g].fill(-1.);
    }
    assert!(before.progress[s].current < 2);
    again
}

#[test]
fn weights_begins_rounds_as_its_twin_does() {
    let Some(device) = gpu("weights_begins_rounds_as_its_twin_does") else { return };
    let candidates = candidates();
    let mut lab = Lab::new(&device, &candidates, CAPACITY, SMALL, |_, _| {});
    let batch = lab.batch;
    let window = lab.settings.stall.window;
    let tolerance = lab.settings.tolerance as f32;
    let mut random = Random::new(41);
    let mut before = lab.poisoned();
    let n = lab.slots.len();
    // Infeasibilities as the twin keeps them, newest last.
    let mut histories: Vec<Vec<f32>> = vec![Vec::new(); n];
    (0..n).for_each(|s| prepare(&lab, s, &mut before, &mut random));
    let multipliers: Vec<f32> = (0..n).map(|s| largest(&slacks(&lab, s, &before).multiplier)).collect();
    // Factor by which the infeasibility of each candidate falls per round; some rest.
    let rates: Vec<f64> = (0..n).map(|_| [1., 0.98, 0.9, 0.7, 0.4, 0.09, 1.05][random.index(0..=6)]).collect();
    let list: Vec<u32> = (0..n as u32 - 3).rev().collect();
    let mut seen: BTreeMap<u32, usize> = BTreeMap::new();
    for round in 0..60 {
        let mut expected = Expected { state: before.clone(), sizes: BTreeMap::new() };
        for &s in &list {
            let s = s as usize;
            let progress = before.progress[s];
            let last = histories[s].last().copied().map_or(10f64.powf(random.between(-1., 2.)), f64::from);
            let f = infeasibility(&lab, &progress, (last * rates[s]) as f32, round, &mut random);
            let [c, g] = residuals_of(f);
            for state in [&mut before, &mut expected.state] {
                let (c_at, g_at) = (lab.c(s, progress.current).start, lab.g(s, progress.current).start + 1);
                state.values[c_at] = c;
                state.values[g_at] = if g > 0. { g } else { -1. };
            }
            assert!(!f.is_finite() || 0.5 * (c * c + g * g) == f, "{f:e}");
            let history = &mut histories[s];
            let earlier = history.len().checked_sub(window).map_or(f, |at| history[at]);
            let ring = lab.range(s, batch.history, 0).start + progress.recorded as usize % window;
            assert_eq!(progress.recorded as usize, history.len());
            let mut begun = progress;
            control::begin(&mut begun, &limits(&lab, s), f, earlier, multipliers[s], f < tolerance);
            if begun.state != EXACT {
                history.push(f);
                expected.state.values[ring] = f;
            }
            begun.factorisations += u32::from(begun.state <= CLOSE);
            *seen.entry(begun.state).or_default() += 1;
            expected.state.progress[s] = begun;
        }
        // Values that follow from the state are compared in the test of `solver`.
        let mut got = lab.run(Shader::Weights, &list, &before);
        let written = [lab.batch.x..lab.batch.initial, lab.batch.diagonal..lab.batch.right_hand_side, lab.batch.weight..lab.batch.slack];
        for s in 0..n {
            for range in &written {
                let range = lab.range(s, range.start, (range.end - range.start) as usize);
                expected.state.values[range.clone()].copy_from_slice(&got.values[range.clone()]);
                // The next round has the same input as this one.
                got.values[range.clone()].copy_from_slice(&before.values[range]);
            }
        }
        let mut as_got = Expected { state: expected.state.clone(), sizes: BTreeMap::new() };
        for s in 0..n {
            for range in &written {
                let range = lab.range(s, range.start, (range.end - range.start) as usize);
                as_got.state.values[range.clone()].copy_from_slice(&got.values[range]);
            }
        }
        // `smoothing` and the start of a slower closing are products; everything else has the same bits.
        lab.check(Shader::Weights, &got, &as_got, |name| if ["smoothing", "closing_below"].contains(&name) { ARITHMETIC } else { 0. });
        before.values.copy_from_slice(&got.values);
        before.progress.copy_from_slice(&expected.state.progress);
        for &s in &list {
            let s = s as usize;
            if go_on(&lab, s, &mut before, &mut random) {
                histories[s].clear();
            }
        }
    }
    eprintln!("states begun: {seen:?}");
    for state in [STEP, CLOSE, EXACT, SOLVED, control::MAX_ITERATIONS, control::STALLED, control::TERMINATED_EARLY, control::NON_FINITE] {
        assert!(seen.get(&state).is_some_and(|n| *n > 2), "no round began in state {state}: {seen:?}");
    }
}
