//! The factorisation.

use super::FRONT;
use super::candidates::{Candidate, candidates};
use super::lab::{CAPACITY, Expected, LARGE, Lab, SMALL, Slot, State, gpu, skipped, states, with_its_workgroups};
use super::solver::jacobian_at;
use crate::common::{Random, any_jacobian, with_any_rows};
use cregopt::backend::gpu::Prepared;
use cregopt::backend::gpu::shaders::{Shader, Variant, WORKGROUP};
use cregopt::linear::NormalEquations;
use cregopt::linear::front::{Factor, factorise};
use cregopt::nlp::Problem;
use cregopt::nlp::sweep::Step;
use cregopt::solver::control::{CLOSE, EXACT, SHORTER, SOLVED, STEP};
use nalgebra::{DMatrix, DVector};
use std::collections::{BTreeMap, BTreeSet};

/// Random weights with single-variable terms. Some weights are zero, with zero values. As in `tests/library/reference`.
pub struct System {
    pub weight: Vec<f32>,
    pub value: Vec<f32>,
    pub diagonal: Vec<f32>,
    pub gradient: Vec<f32>,
}

impl System {
    pub fn new(problem: &Problem<f32>, random: &mut Random, zeros: f64) -> System {
        let weight: Vec<f32> =
            (0..problem.rows.all()).map(|_| if random.between(0., 1.) < zeros { 0. } else { random.between(0.01, 1.) as f32 }).collect();
        let value = weight.iter().map(|&w| if w == 0. { 0. } else { random.between(-1., 1.) as f32 }).collect();
        let diagonal = (0..problem.variables).map(|_| 1e-3 * random.between(0.01, 10.) as f32).collect();
        let gradient = (0..problem.variables).map(|_| random.between(-1., 1.) as f32).collect();
        System { weight, value, diagonal, gradient }
    }

    pub fn equations<'a>(&'a self, jacobian: &'a [f32]) -> NormalEquations<'a, f32> {
        NormalEquations { jacobian, weight: &self.weight, value: &self.value, diagonal: &self.diagonal, gradient: &self.gradient }
    }

    /// `E + J' W J`, `-(u + J' v)`, and the sizes of the terms of the latter, in f64.
    pub fn dense(&self, problem: &Problem<f32>, jacobian: &[f32]) -> (DMatrix<f64>, DVector<f64>, DVector<f64>) {
        let wide = |v: &[f32]| DVector::from_iterator(v.len(), v.iter().map(|v| f64::from(*v)));
        let mut matrix = DMatrix::from_diagonal(&wide(&self.diagonal));
        let mut rhs = -wide(&self.gradient);
        let mut size = rhs.abs();
        for (element, runs) in problem.all_elements().zip(problem.columns()) {
            let place = &element.place;
            for r in 0..element.rows as usize {
                let row = &jacobian[place.jacobian as usize + r * place.stride as usize..];
                let entries: Vec<(usize, f64)> = runs
                    .iter()
                    .flat_map(|(run, weight)| {
                        (0..run.len)
                            .map(move |i| ((run.variable + i) as usize, f64::from(*weight) * f64::from(row[(run.column + i) as usize])))
                    })
                    .filter(|entry| entry.1 != 0.)
                    .collect();
                let (w, v) = (f64::from(self.weight[place.row as usize + r]), f64::from(self.value[place.row as usize + r]));
                for &(a, left) in &entries {
                    rhs[a] -= v * left;
                    size[a] += (v * left).abs();
                    for &(b, right) in &entries {
                        matrix[(b, a)] += w * left * right;
                    }
                }
            }
        }
        (matrix, rhs, size)
    }
}

/// Entries of the factor that have values: each pivot row from the diagonal to the right-hand side.
fn factor_entries(problem: &Problem<f32>) -> Vec<usize> {
    let of_row = |step: &Step, i: u32| {
        let row = step.factor + i * step.stride;
        (row + i) as usize..=(row + step.size) as usize
    };
    problem.steps.iter().flat_map(|step| (0..step.pivots).flat_map(move |i| of_row(step, i))).collect()
}

/// Entries left of the diagonal in the diagonal block of four pivots: the shader writes whole blocks, with zeros there.
fn left_of_diagonal(problem: &Problem<f32>) -> Vec<usize> {
    let of_row = |step: &Step, i: u32| {
        let row = step.factor + i * step.stride;
        (row + i / 4 * 4) as usize..(row + i) as usize
    };
    problem.steps.iter().flat_map(|step| (0..step.pivots).flat_map(move |i| of_row(step, i))).collect()
}

/// Variables of the front of a step, in order.
pub fn front_of(problem: &Problem<f32>, step: &Step) -> Vec<usize> {
    let pivots = step.variable..step.variable + step.pivots;
    let rest = problem.front_runs[step.rest.range()].iter().flat_map(|run| run.variable..run.variable + run.len);
    pivots.chain(rest).map(|v| v as usize).collect()
}

/// Largest ratio of a residual to the sizes of its terms; infinite if one is NaN.
pub fn backward(residual: f64, size: f64, worst: f64) -> f64 {
    let error = residual.abs() / size;
    if error.is_nan() { f64::INFINITY } else { worst.max(error) }
}

/// Backward error of a factor and its right-hand side in the normal equations `A d = b`: the largest of `|A - U'U|` relative to the
/// geometric mean of its two diagonal entries, and of `|b - U'y|` relative to the sizes of its terms.
fn misses(problem: &Problem<f32>, factor: &[f32], (matrix, rhs, size): &(DMatrix<f64>, DVector<f64>, DVector<f64>)) -> f64 {
    let (mut matrix_left, mut left, mut size) = (matrix.clone(), rhs.clone(), size.clone());
    for step in &problem.steps {
        let front = front_of(problem, step);
        for i in 0..step.pivots as usize {
            let row = &factor[step.factor as usize + i * step.stride as usize..][..=step.size as usize];
            let y = f64::from(row[step.size as usize]);
            for (a, &variable) in front.iter().enumerate().skip(i) {
                let u = f64::from(row[a]);
                left[variable] -= u * y;
                size[variable] += (u * y).abs();
                for (b, &other) in front.iter().enumerate().skip(i) {
                    matrix_left[(other, variable)] -= u * f64::from(row[b]);
                }
            }
        }
    }
    let mut worst = 0.;
    for i in 0..problem.variables {
        worst = backward(left[i], size[i], worst);
        for j in 0..problem.variables {
            worst = backward(matrix_left[(i, j)], (matrix[(i, i)] * matrix[(j, j)]).sqrt(), worst);
        }
    }
    worst
}

/// Inputs of the factorisation of a slot.
fn put_system(lab: &Lab, s: usize, state: &mut State, system: &System, jacobian: &[f32]) {
    let batch = &lab.batch;
    let at = lab.jacobian(s, state.progress[s].current);
    state.jacobian[at].copy_from_slice(jacobian);
    for (at, values) in [
        (lab.of_rows(s, batch.weight), &system.weight),
        (lab.of_rows(s, batch.value), &system.value),
        (lab.of_variables(s, batch.diagonal), &system.diagonal),
        (lab.of_variables(s, batch.gradient), &system.gradient),
    ] {
        state.values[at].copy_from_slice(values);
    }
}

/// Factorises the systems of all slots and checks the factors.
fn check_front(lab: &mut Lab, lists: &[Vec<u32>], what: &str) {
    check_front_at(lab, lists, what, jacobian_at);
}

/// Factorises the systems of all slots with a Jacobian per slot, and checks the factors.
fn check_front_at(lab: &mut Lab, lists: &[Vec<u32>], what: &str, mut jacobian_of: impl FnMut(&Slot) -> Vec<f32>) {
    let mut random = Random::new(51);
    let mut before = lab.poisoned();
    states(lab, &mut before, &[STEP, CLOSE, STEP, SHORTER, EXACT, CLOSE, SOLVED]);
    let mut systems = Vec::new();
    for s in 0..lab.slots.len() {
        let problem = &lab.slots[s].problem;
        let mut system = System::new(problem, &mut random, [0., 0.4, 0.9][s % 3]);
        // Some are not positive definite, at different pivots.
        if s % 8 == 5 {
            let at = [0, problem.variables / 2, problem.variables - 1][s / 8 % 3];
            system.diagonal[at] = -1e3;
        }
        let jacobian = jacobian_of(&lab.slots[s]);
        put_system(lab, s, &mut before, &system, &jacobian);
        systems.push((system, jacobian));
    }
    let mut worst = 0f64;
    let (mut checked, mut refused) = (BTreeMap::new(), 0);
    for list in lists {
        let got = lab.run(Shader::Front, list, &before);
        // Values that must not change, except those that the sweep keeps between its steps.
        let mut expected = Expected { state: before.clone(), sizes: BTreeMap::new() };
        for &s in list {
            let s = s as usize;
            if before.progress[s].state > CLOSE {
                continue;
            }
            let problem = &lab.slots[s].problem;
            let (system, jacobian) = &systems[s];
            let mut twin = Factor::default();
            twin.resize(problem);
            let positive = factorise(problem, &system.equations(jacobian), &mut twin);
            expected.state.values[lab.flags(s)] = f32::from(!positive);
            let scratch = lab.range(s, lab.batch.carry, (lab.batch.flags - lab.batch.carry) as usize);
            expected.state.values[scratch.clone()].copy_from_slice(&got.values[scratch]);
            let first = lab.factor(s).start;
            for at in left_of_diagonal(problem) {
                if got.factor[first + at] == 0. {
                    expected.state.factor[first + at] = 0.;
                }
            }
            for at in factor_entries(problem) {
                let v = got.factor[first + at];
                assert!(!positive || v.is_finite(), "{what}, slot {s}, {}: factor[{at}] is {v}", lab.slots[s].candidate.name);
                expected.state.factor[first + at] = v;
            }
            if !positive {
                refused += 1;
                continue;
            }
            let factor = &got.factor[lab.factor(s)];
            if let Some(checked) = checked.insert(s, factor.to_vec()) {
                // Whatever other slots are in the list.
                assert!(
                    checked.iter().zip(factor).all(|(a, b)| a.to_bits() == b.to_bits()),
                    "{what}, slot {s}: another factor in another list"
                );
            } else {
                let error = misses(problem, factor, &system.dense(problem, jacobian));
                assert!(error <= FRONT, "{what}, slot {s}, {}: backward error {error:e}", lab.slots[s].candidate.name);
                worst = worst.max(error);
            }
        }
        lab.check(Shader::Front, &got, &expected, |_| 0.);
    }
    assert!(refused > 0 || lab.slots.len() < 8);
    eprintln!("front, {what}: backward error up to {:.2} units", worst / f64::from(f32::EPSILON));
}

/// Candidates whose front fits into the smallest workgroup memory.
pub fn with_small_fronts(workgroup: u32) -> Vec<Candidate> {
    let fits = |c: &Candidate| {
        let sizes = Prepared::new(0, c.problem.clone(), 0, workgroup).sizes;
        sizes.front <= SMALL
    };
    let candidates: Vec<Candidate> = candidates().into_iter().filter(fits).collect();
    let feet: BTreeSet<usize> = candidates.iter().map(|c| c.feet).collect();
    assert!(feet.len() >= 3, "feet of those with small fronts: {feet:?}");
    candidates
}

#[test]
fn front_in_workgroup_memory_solves_the_normal_equations() {
    let Some(device) = gpu("front_in_workgroup_memory_solves_the_normal_equations") else { return };
    let candidates = with_small_fronts(device.workgroup);
    assert!(Variant::new(SMALL, device.workgroup, 16 << 10).front > 0);
    assert!(device.variant(SMALL).front > 0);
    let mut lab = Lab::new(&device, &candidates, CAPACITY, SMALL, |_, _| {});
    let lists = lab.lists();
    check_front(&mut lab, &lists, "front in workgroup memory");
}

#[test]
fn front_takes_elements_of_any_number_of_rows() {
    let Some(device) = gpu("front_takes_elements_of_any_number_of_rows") else { return };
    let mut candidates = with_small_fronts(device.workgroup);
    candidates.iter_mut().for_each(|candidate| with_any_rows(&mut candidate.problem));
    let mut random = Random::new(52);
    let mut lab = Lab::new(&device, &candidates, candidates.len(), SMALL, |_, _| {});
    let lists = lab.lists();
    check_front_at(&mut lab, &lists, "any number of rows", |slot| any_jacobian(&slot.problem, &slot.candidate.x, &mut random));
}

#[test]
fn front_in_storage_solves_the_normal_equations() {
    let Some(device) = gpu("front_in_storage_solves_the_normal_equations") else { return };
    assert_eq!(device.variant(LARGE).front, 0, "this adapter would keep the front in workgroup memory");
    let candidates = candidates();
    let mut lab = Lab::new(&device, &candidates, candidates.len(), LARGE, |_, _| {});
    let largest = lab.slots.iter().map(|s| s.problem.steps.iter().map(|step| step.size).max().unwrap()).max().unwrap();
    assert!(largest as usize <= LARGE && largest as usize > SMALL, "the largest front has {largest} variables");
    let lists = lab.lists();
    check_front(&mut lab, &lists, "front in storage");
}

#[test]
fn front_of_another_workgroup_size_solves_the_normal_equations() {
    let test = "front_of_another_workgroup_size_solves_the_normal_equations";
    let Some(device) = with_its_workgroups(test) else { return };
    if device.workgroup == WORKGROUP {
        return skipped(test, "this adapter has no other one");
    }
    let candidates = with_small_fronts(device.workgroup);
    let mut lab = Lab::new(&device, &candidates, candidates.len(), SMALL, |_, _| {});
    let lists = lab.lists();
    check_front(&mut lab, &lists, "small workgroups");
}

#[test]
fn a_sweep_in_several_dispatches_gives_the_same_factor() {
    let test = "a_sweep_in_several_dispatches_gives_the_same_factor";
    let Some(device) = gpu(test) else { return };
    let Some(limit) = device.loop_limit else {
        skipped(test, "this adapter cuts no loops short, so every sweep is one dispatch");
        return;
    };
    let candidates = with_small_fronts(device.workgroup);
    let n = candidates.len();
    let factors = [1, limit / 3, limit].map(|loops| {
        let mut lab = Lab::with_loops(&device, &candidates, n, SMALL, loops, |_, _| {});
        let mut random = Random::new(61);
        let mut before = lab.poisoned();
        states(&lab, &mut before, &[STEP, CLOSE]);
        for s in 0..n {
            let problem = &lab.slots[s].problem;
            assert!(problem.steps.len() > 3);
            assert!(lab.slots[s].loops < limit, "one dispatch is too long for this adapter: {}", lab.slots[s].loops);
            let mut system = System::new(problem, &mut random, 0.2);
            if s % 4 == 1 {
                // The failure of the first step must not be forgotten.
                system.diagonal[0] = -1e3;
            }
            put_system(&lab, s, &mut before, &system, &jacobian_at(&lab.slots[s]));
        }
        let list: Vec<u32> = (0..n as u32).rev().collect();
        let got = lab.run(Shader::Front, &list, &before);
        let flags: Vec<f32> = (0..n).map(|s| got.values[lab.flags(s)]).collect();
        // The values of failed factors are arbitrary.
        let numbers = |s: usize| got.factor[lab.factor(s)].iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
        (flags.clone(), (0..n).filter(|s| flags[*s] == 0.).flat_map(numbers).collect::<Vec<u32>>())
    });
    assert_eq!(factors[0].0, (0..n).map(|s| f32::from(s % 4 == 1)).collect::<Vec<_>>());
    for (several, what) in factors[1..].iter().zip(["three steps a dispatch", "one step a dispatch"]) {
        assert_eq!(factors[0].0, several.0, "{what}: flags");
        let first = factors[0].1.iter().zip(&several.1).position(|(a, b)| a != b);
        assert_eq!(first, None, "{what}: first factor entry that differs");
    }
}
