//! Every shader against its Rust twin on the same numbers, on a GPU or a software adapter.
//!
//! Candidates occupy slots. Before a run everything that the shader is not documented to read is filled with poison, a NaN with bits of
//! its own. The twin then writes into a copy. After the run both are compared as a whole: the twin's results within a tolerance,
//! everything else bit for bit. An element that is missing, written twice, or written into a wrong slot makes a test fail.

mod angles;
mod candidates;
mod front;
mod judge;
mod lab;
mod linear;
mod minimise;
mod rounds;
mod rows;
mod solver;

use crate::common::Random;
use candidates::candidates;
use cregopt::backend::gpu::shaders::Shader;
use cregopt::solver::control::{Progress, STEP};
use lab::{Expected, Lab, POISON, SMALL, State, fill, gpu, states};
use solver::barrier_state;
use std::collections::BTreeMap;

// Tolerances are in units of f32 precision, 2^-23, of the larger of the value and the sum of the sizes of its terms; that sum is 1 unless
// stated. llvmpipe rounds every operation as the twins do. Other drivers fuse products with sums, and WGSL allows division and square root
// an error of 2.5 units: both sides then have rounding errors of their own, of about the same size. On an H100 and an H200 (driver 580.159)
// the largest differences are 22 units in `force`, 59 in `cone`, 72 in `cone_curvature` and `swing`, 88 in `reach`, 217 in `sole` and 3,072
// in `joint_speed`.

/// Twin and shader do the same operations in the same order, including a few divisions.
const ARITHMETIC: f32 = 8.;

/// Sums in another order, relative to the sum of the sizes of their terms. Errors of sums over some hundred terms in lanes grow with the
/// square root of their number.
const SUM: f32 = 16.;

/// Rows with sine and cosine, relative to the larger of 1 and the value. These functions are off by two units, the twin's by less; rows
/// multiply that by legs in units of 0.1 m or by moments of some body weights.
const TRIGONOMETRY: f32 = 64.;

/// Force rows: a root, divisions, and normals of ground with a curvature of 33/m. The place in a cell of a grid is off by 2^-18 cells.
const CURVED: f32 = 32.;

/// Deviations of attitude: momenta of up to 1e3 N m s divided by inertias down to 0.05 kg m². See `F32_DEVIATION_TOLERANCE` in
/// `tests/library/reference`.
const DEVIATION: f32 = 256.;

/// Backward error of the front per entry. That of a Cholesky factor is within a few units of the geometric mean of two diagonal entries,
/// and the error of sums of up to some hundred products grows with the square root of their number.
const FRONT: f64 = 16. * f32::EPSILON as f64;

/// Backward error of a substitution per row, relative to the sum of the sizes of its terms: one rounding per term, up to 200 terms, of
/// which most cancel.
const SUBSTITUTION: f64 = 32. * f32::EPSILON as f64;

#[test]
fn a_perturbed_element_is_seen() {
    let Some(device) = gpu("a_perturbed_element_is_seen") else { return };
    let candidates = candidates();
    let mut lab = Lab::new(&device, &candidates, candidates.len(), SMALL, |_, _| {});
    let mut before = lab.poisoned();
    states(&lab, &mut before, &[STEP]);
    let list: Vec<u32> = (1..lab.slots.len() as u32).rev().collect();
    let batch = lab.batch;
    for s in 0..lab.slots.len() {
        let x = lab.of_variables(s, batch.x + before.progress[s].current * batch.x_half);
        let d = lab.of_variables(s, batch.direction);
        let mut random = Random::new(s as u64);
        fill(&mut before.values, x, &mut random, 1., 2.);
        fill(&mut before.values, d, &mut random, 0.1, 1.);
        let g = lab.g(s, before.progress[s].current);
        fill(&mut before.values, g, &mut random, -1., 1.);
        let by = lab.of_inequalities(s, batch.g_change);
        fill(&mut before.values, by, &mut random, -1., 1.);
        barrier_state(&lab, s, &mut before, &mut random, true);
        before.progress[s] = Progress { mu: 0.01, length: 0.5, ..before.progress[s] };
    }
    let got = lab.run(Shader::Advance, &list, &before);
    let expected = Expected { state: got.clone(), sizes: BTreeMap::new() };
    let compare = |got: &State| lab.compare(got, &expected, |name| if name == "x" { ARITHMETIC } else { 0. }, &mut BTreeMap::new());
    assert_eq!(compare(&got), Ok(()));

    let slot = 3;
    let at = lab.x(slot, 1 - before.progress[slot].current).start + 7;
    let right = got.values[at];
    let seen = |change: &dyn Fn(&mut State)| {
        let mut wrong = got.clone();
        change(&mut wrong);
        compare(&wrong).err()
    };
    // Within the tolerance, beyond it, and NaN.
    let unit = right.abs().max(1.) * f32::EPSILON;
    assert_eq!(seen(&|state| state.values[at] = right + 0.9 * ARITHMETIC * unit), None);
    for wrong in [right + 1.2 * ARITHMETIC * unit, right - 1.2 * ARITHMETIC * unit, f32::NAN, f32::INFINITY, POISON] {
        let message = seen(&|state| state.values[at] = wrong).unwrap();
        assert!(message.contains(&format!("slot {slot}")) && message.contains(&lab.slots[slot].candidate.name), "{message}");
        assert!(message.contains("x[") && message.contains("ulp"), "{message}");
    }
    // Written where nothing should be: in a slot that is not listed, in the padding after an array, in another shader's results.
    let unlisted = lab.of_variables(0, batch.direction).start;
    assert!(seen(&|state| state.values[unlisted] += 1.).unwrap().contains("slot 0"));
    let poison = (0..got.values.len()).find(|i| got.values[*i].to_bits() == POISON.to_bits()).unwrap();
    assert!(seen(&|state| state.values[poison] = 0.).unwrap().contains("untouched"));
    assert!(seen(&|state| state.values[poison] = f32::NAN).is_some());
    assert!(seen(&|state| state.jacobian[11] = 0.).unwrap().contains("jacobian[11]"));
    assert!(seen(&|state| state.factor[11] = 0.).unwrap().contains("factor[11]"));
    assert!(seen(&|state| state.progress[2].iterations += 1).unwrap().contains("iterations"));
    assert!(seen(&|state| state.progress[2].mu = 0.010_000_001).unwrap().contains("mu"));
}

#[test]
fn every_shader_has_a_test_here() {
    let rooms = ["front", "judge", "linear", "rounds", "rows", "solver"];
    let text: String =
        rooms.map(|room| std::fs::read_to_string(format!("{}/tests/gpu/parity/{room}.rs", env!("CARGO_MANIFEST_DIR"))).unwrap()).concat();
    for shader in Shader::ALL {
        assert!(text.contains(&format!("Shader::{shader:?},")), "{} is compared nowhere", shader.path());
    }
}
