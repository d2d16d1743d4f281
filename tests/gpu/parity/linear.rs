//! Products with the Jacobian, and substitutions with a factor.

use super::candidates::candidates;
use super::front::{System, backward, front_of, with_small_fronts};
use super::lab::{CAPACITY, Expected, LARGE, Lab, POISON, SMALL, Slot, State, fill, gpu, states, stem};
use super::solver::{jacobian_at, solver_step};
use super::{SUBSTITUTION, SUM};
use crate::common::Random;
use cregopt::backend::gpu::shaders::Shader;
use cregopt::linear::front::{Factor, factorise};
use cregopt::linear::{forward, product, transposed};
use cregopt::nlp::Problem;
use cregopt::solver::advance;
use cregopt::solver::control::{CLOSE, EXACT, SHORTER, SOLVED, STEP};
use std::collections::BTreeMap;

fn size(v: &[f32]) -> Vec<f32> {
    v.iter().map(|v| v.abs()).collect()
}

/// A problem whose sizes of products are sums of the sizes of their terms: negative weights of base blocks would make them cancel.
fn with_weights_as_sizes(problem: &Problem<f32>) -> Problem<f32> {
    let mut problem = problem.clone();
    for instant in &mut problem.reach_rows.instants {
        instant.weights = instant.weights.map(f32::abs);
    }
    problem
}

#[test]
fn product_agrees_with_its_twin() {
    solver_step(
        Shader::Product,
        &[STEP, CLOSE, EXACT, SHORTER, SOLVED],
        |s, prepared| {
            // Elements and instants beyond the counts have no product.
            let most = [63, 64, 65, u32::MAX][s / 4 % 4];
            prepared.slot.elements = prepared.slot.elements.min(most);
            prepared.slot.factored_instants = prepared.slot.factored_instants.min(most);
        },
        |lab, s, state, random| {
            let to = lab.jacobian(s, state.progress[s].current);
            state.jacobian[to].copy_from_slice(&jacobian_at(&lab.slots[s]));
            fill(&mut state.values, lab.of_variables(s, lab.batch.direction), random, -1., 1.);
        },
        |lab, s, _, expected| {
            let (batch, state) = (&lab.batch, &mut expected.state);
            if state.progress[s].state > CLOSE {
                return;
            }
            let mut problem = lab.slots[s].problem.clone();
            problem.elements.truncate(lab.slots[s].counts.elements as usize);
            problem.reach_rows.instants.truncate(lab.slots[s].counts.factored_instants as usize);
            let jacobian = state.jacobian[lab.jacobian(s, state.progress[s].current)].to_vec();
            let d = state.values[lab.of_variables(s, batch.direction)].to_vec();
            let times = |problem: &Problem<f32>, jacobian: &[f32], d: &[f32]| {
                let (mut c, mut g) = (vec![POISON; problem.rows.one_sided()], vec![POISON; problem.inequalities]);
                product::jacobian_times(problem, jacobian, d, &mut vec![0.; problem.widest], &mut c, &mut g);
                (c, g)
            };
            let (c, g) = times(&problem, &jacobian, &d);
            let (c_size, g_size) = times(&with_weights_as_sizes(&problem), &size(&jacobian), &size(&d));
            let [c_at, g_at] = [lab.of_equalities(s, batch.c_change), lab.of_inequalities(s, batch.g_change)];
            expected.sizes.extend(c_at.clone().zip(c_size));
            expected.sizes.extend(g_at.clone().zip(g_size.iter().map(|v| v.abs())));
            state.values[c_at].copy_from_slice(&c);
            state.values[g_at].copy_from_slice(&g);
        },
        |name| if ["c_change", "g_change"].contains(&name) { SUM } else { 0. },
    );
}

#[test]
fn transposed_agrees_with_its_twin() {
    solver_step(
        Shader::Transposed,
        &[STEP, CLOSE, SHORTER, EXACT, SOLVED],
        |_, _| {},
        |lab, s, state, random| {
            let to = lab.jacobian(s, state.progress[s].current);
            state.jacobian[to].copy_from_slice(&jacobian_at(&lab.slots[s]));
            fill(&mut state.values, lab.of_rows(s, lab.batch.value), random, -1., 1.);
            fill(&mut state.values, lab.of_variables(s, lab.batch.gradient), random, -1., 1.);
        },
        |lab, s, _, expected| {
            let (batch, problem, state) = (&lab.batch, &lab.slots[s].problem, &mut expected.state);
            if state.progress[s].state != STEP {
                return;
            }
            let jacobian = state.jacobian[lab.jacobian(s, state.progress[s].current)].to_vec();
            let (v, u) = (&state.values[lab.of_rows(s, batch.value)], &state.values[lab.of_variables(s, batch.gradient)]);
            let times = |problem: &Problem<f32>, jacobian: &[f32], v: &[f32], u: &[f32]| {
                let mut out = vec![f32::NAN; problem.variables];
                transposed::transposed_times(problem, jacobian, v, &mut vec![0.; problem.widest], &mut out);
                advance::add(&mut out, u);
                out
            };
            let sums = times(problem, &jacobian, v, u);
            let sizes = times(&with_weights_as_sizes(problem), &size(&jacobian), &size(v), &size(u));
            let at = lab.of_variables(s, batch.right_hand_side);
            expected.sizes.extend(at.clone().zip(sizes));
            state.values[at].copy_from_slice(&sums);
        },
        |name| if name == "right_hand_side" { SUM } else { 0. },
    );
}

/// Factor of a slot by the twin, with its right-hand side.
fn twin_factor(slot: &Slot, random: &mut Random) -> Vec<f32> {
    let system = System::new(&slot.problem, random, 0.2);
    let mut factor = Factor::default();
    factor.resize(&slot.problem);
    // Entries that the twin does not write are not read.
    factor.pivot_rows.fill(POISON);
    assert!(factorise(&slot.problem, &system.equations(&jacobian_at(slot)), &mut factor));
    factor.pivot_rows.to_vec()
}

/// Runs a substitution on fronts of the workgroup memory and on large ones.
fn substitution(
    shader: Shader,
    of_states: &[u32],
    prepare: impl Fn(&Lab, usize, &mut State, &mut Random),
    check: impl Fn(&Lab, usize, &State, &State, &mut Expected) -> f64,
) {
    let test = format!("{}_solves_its_triangle", stem(shader));
    let Some(device) = gpu(&test) else { return };
    let (small, all) = (with_small_fronts(device.workgroup), candidates());
    let labs = [Lab::new(&device, &small, CAPACITY, SMALL, |_, _| {}), Lab::new(&device, &all, all.len(), LARGE, |_, _| {})];
    for mut lab in labs {
        let mut random = Random::new(71);
        let mut before = lab.poisoned();
        states(&lab, &mut before, of_states);
        let factors: Vec<Vec<f32>> = lab.slots.iter().take(all.len()).map(|slot| twin_factor(slot, &mut random)).collect();
        for s in 0..lab.slots.len() {
            // Equal candidates have equal factors.
            let same = (0..factors.len()).find(|i| std::ptr::eq(lab.slots[*i].candidate, lab.slots[s].candidate)).unwrap();
            let at = lab.factor(s);
            before.factor[at].copy_from_slice(&factors[same]);
            prepare(&lab, s, &mut before, &mut random);
        }
        let mut worst = 0f64;
        for list in lab.lists() {
            let got = lab.run(shader, &list, &before);
            let mut expected = Expected { state: before.clone(), sizes: BTreeMap::new() };
            for &s in &list {
                let error = check(&lab, s as usize, &before, &got, &mut expected);
                assert!(
                    error <= SUBSTITUTION,
                    "{}, slot {s}, {}: backward error {error:e}",
                    stem(shader),
                    lab.slots[s as usize].candidate.name
                );
                worst = worst.max(error);
            }
            lab.check(shader, &got, &expected, |_| 0.);
        }
        eprintln!("{}: backward error up to {:.2} units", stem(shader), worst / f64::from(f32::EPSILON));
    }
}

#[test]
fn substitute_solves_its_triangle() {
    substitution(
        Shader::Substitute,
        &[STEP, CLOSE, SHORTER, EXACT, SOLVED],
        |_, _, _, _| {},
        |lab, s, before, got, expected| {
            if before.progress[s].state > CLOSE {
                return 0.;
            }
            let (problem, factor) = (&lab.slots[s].problem, &before.factor[lab.factor(s)]);
            let at = lab.of_variables(s, lab.batch.direction);
            let d = &got.values[at.clone()];
            expected.state.values[at].copy_from_slice(d);
            let mut worst = 0.;
            for step in &problem.steps {
                let front = front_of(problem, step);
                for i in 0..step.pivots as usize {
                    let row = &factor[step.factor as usize + i * step.stride as usize..];
                    let y = f64::from(row[step.size as usize]);
                    let (mut left, mut size) = (y, y.abs());
                    for (j, &variable) in front.iter().enumerate().skip(i) {
                        let term = f64::from(row[j]) * f64::from(d[variable]);
                        left -= term;
                        size += term.abs();
                    }
                    worst = backward(left, size, worst);
                }
            }
            worst
        },
    );
}

#[test]
fn forward_solves_its_triangle() {
    substitution(
        Shader::Forward,
        &[STEP, SHORTER, CLOSE, STEP, EXACT, SOLVED],
        |lab, s, state, random| {
            let at = lab.of_variables(s, lab.batch.right_hand_side);
            fill(&mut state.values, at, random, -1., 1.);
        },
        |lab, s, before, got, expected| {
            if before.progress[s].state != STEP {
                return 0.;
            }
            let problem = &lab.slots[s].problem;
            let at = lab.of_variables(s, lab.batch.right_hand_side);
            let (given, left) = (&before.values[at.clone()], &got.values[at.clone()]);
            let first = lab.factor(s).start;
            // Contributions of pivots to later variables, from the shader's own solution.
            let mut sums: Vec<f64> = given.iter().map(|v| f64::from(*v)).collect();
            let mut sizes: Vec<f64> = sums.iter().map(|v| v.abs()).collect();
            let mut worst = 0.;
            for step in &problem.steps {
                let front = front_of(problem, step);
                for i in 0..step.pivots as usize {
                    let row = first + step.factor as usize + i * step.stride as usize;
                    let column = row + step.size as usize;
                    let y = f64::from(got.factor[column]);
                    expected.state.factor[column] = got.factor[column];
                    let pivot = f64::from(before.factor[row + i]) * y;
                    let variable = front[i];
                    worst = backward(pivot + sums[variable], pivot.abs() + sizes[variable], worst);
                    for (j, &later) in front.iter().enumerate().skip(i + 1) {
                        let term = f64::from(before.factor[row + j]) * y;
                        sums[later] += term;
                        sizes[later] += term.abs();
                    }
                }
            }
            // The twin leaves the same right-hand side on the same numbers, except for rounding.
            let mut twin = Factor::default();
            twin.resize(problem);
            twin.pivot_rows.copy_from_slice(&before.factor[lab.factor(s)]);
            let mut gradient = given.to_vec();
            forward::forward(problem, &mut twin, &mut gradient);
            assert!(left.iter().all(|v| v.is_finite()) && gradient.iter().all(|v| v.is_finite()));
            expected.state.values[at].copy_from_slice(left);
            worst
        },
    );
}
