//! Residuals and weights of cost rows while the cost of a solved point is minimised, and the phases of a solve.

use super::lab::{Lab, State, fill};
use super::solver::{limits, prepare_weights, solver_step, weights_of_twin};
use super::{ARITHMETIC, SUM};
use crate::common::Random;
use cregopt::backend::gpu::shaders::Shader;
use cregopt::nlp::Problem;
use cregopt::rows::RowKind;
use cregopt::solver::Residuals;
use cregopt::solver::control::{self, CLOSE, MINIMISE, Progress, RESTORE, RESTORE_NEXT, REVERT, SHORTER, SOLVE, SOLVED, STEP};
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::ops::Range;

/// Ranges of the shifts of equalities and inequalities of a slot.
fn shift_ranges(lab: &Lab, s: usize) -> [Range<usize>; 2] {
    let equalities = lab.slots[s].problem.rows.of(RowKind::Equality).len();
    [lab.range(s, lab.batch.shift_c, equalities), lab.of_inequalities(s, lab.batch.shift_g)]
}

fn read(state: &State, [c, g]: [Range<usize>; 2]) -> Residuals<f32> {
    Residuals { c: state.values[c].to_vec(), g: state.values[g].to_vec() }
}

fn write(state: &mut State, [c, g]: [Range<usize>; 2], from: &Residuals<f32>) {
    state.values[c].copy_from_slice(&from.c);
    state.values[g].copy_from_slice(&from.g);
}

/// Shifts of a slot. Cost rows have none.
pub fn shifts(lab: &Lab, s: usize, state: &State) -> Residuals<f32> {
    read(state, shift_ranges(lab, s))
}

pub fn put_shifts(lab: &Lab, s: usize, state: &mut State, shifts: &Residuals<f32>) {
    write(state, shift_ranges(lab, s), shifts);
}

/// Residuals of one half.
pub fn residuals_of(lab: &Lab, s: usize, half: u32, state: &State) -> Residuals<f32> {
    read(state, [lab.c(s, half), lab.g(s, half)])
}

pub fn put_residuals(lab: &Lab, s: usize, half: u32, state: &mut State, residuals: &Residuals<f32>) {
    write(state, [lab.c(s, half), lab.g(s, half)], residuals);
}

fn cost_weights_range(lab: &Lab, s: usize) -> Range<usize> {
    lab.range(s, lab.batch.cost_weights, lab.slots[s].problem.rows.of(RowKind::Cost).len())
}

/// Random shifts, and random weights of the cost rows of a given size. Every third row is quadratic, and every seventh has the multiplier
/// of an inequality as its weight.
pub fn draw_shifts(lab: &Lab, s: usize, state: &mut State, random: &mut Random, size: f64) {
    for range in shift_ranges(lab, s) {
        fill(&mut state.values, range, random, -0.1, 0.1);
    }
    for (i, at) in cost_weights_range(lab, s).enumerate() {
        state.values[at] = match i {
            _ if i % 7 == 1 => -1. - random.index(0..=lab.slots[s].problem.inequalities - 1) as f32,
            _ if i % 3 == 0 => 0.,
            _ => random.between(0.1, 1.) as f32 * size as f32,
        };
    }
}

/// Problem of a slot with the weights of its cost rows.
pub fn problem_of(lab: &Lab, s: usize, state: &State) -> Problem<f32> {
    Problem { cost_weights: state.values[cost_weights_range(lab, s)].to_vec(), ..lab.slots[s].problem.clone() }
}

/// Puts a slot, whose inputs were drawn, into one of ten situations in the course of a minimisation.
fn prepare(lab: &Lab, s: usize, state: &mut State, random: &mut Random) {
    prepare_weights(lab, s, state, random);
    draw_shifts(lab, s, state, random, 1.);
    let solved = lab.of_variables(s, lab.batch.solved);
    fill(&mut state.values, solved, random, -2., 2.);
    let progress = &mut state.progress[s];
    if progress.ended() {
        return;
    }
    let limit = lab.settings.max_iterations as u32;
    *progress = Progress {
        // Each of them is near a solution in one of five candidates; the first one needs it.
        phase: [SOLVE, MINIMISE, MINIMISE, RESTORE_NEXT, RESTORE, RESTORE, REVERT, MINIMISE][s % 8],
        state: [STEP, STEP, SHORTER, STEP, STEP, CLOSE, STEP, SHORTER][s % 8],
        attempts: u32::from(s % 8 == 7),
        minimise_iterations: 12,
        minimise_until: 40,
        iterations: [3, 39, 40, 30, 39 + limit, 40 + limit, 50, 40][s % 8],
        infeasibility: 2e-8,
        solved_infeasibility: 3e-8,
        rounding: [0.01, 0.003][s % 2],
        edge_radius: 0.,
        ..*progress
    };
}

#[test]
fn weights_agrees_with_its_twin_in_every_phase() {
    let seen = RefCell::new(BTreeSet::new());
    solver_step(
        Shader::Weights,
        &[STEP, STEP, STEP, STEP, STEP, STEP, STEP, STEP, STEP, STEP, SOLVED],
        |_, _| {},
        prepare,
        |lab, s, _, expected| {
            let before = expected.state.progress[s];
            weights_of_twin(lab, s, expected);
            let after = expected.state.progress[s];
            seen.borrow_mut().insert((before.phase, after.phase, after.ended()));
        },
        |name| match name {
            "infeasibility" | "solved_infeasibility" | "history" | "closing_from" => SUM,
            "weight" | "value" | "diagonal" | "gradient" | "smoothing" | "slack" | "multiplier" => ARITHMETIC,
            _ => 0.,
        },
    );
    let seen = seen.into_inner();
    let expected = [
        (SOLVE, SOLVE, false),
        (SOLVE, MINIMISE, false),
        (MINIMISE, MINIMISE, false),
        (MINIMISE, RESTORE, false),
        (RESTORE_NEXT, RESTORE, false),
        (RESTORE, RESTORE, false),
        (RESTORE, RESTORE, true),
        (RESTORE, REVERT, true),
        (REVERT, REVERT, true),
    ];
    // The shader test above is skipped without an adapter.
    assert!(seen.is_empty() || expected.iter().all(|change| seen.contains(change)), "{seen:?}");
}

/// Verdict after an accepted step while the cost is minimised.
///
/// * `predicted`, `cost` - predicted decrease, and weighted cost at the trial point
pub fn minimised(lab: &Lab, s: usize, verdict: &mut Progress<f32>, predicted: f64, cost: f64) {
    control::minimised(verdict, &limits(lab, s).minimise, predicted as f32, cost as f32, lab.slots[s].problem.inequalities);
}
