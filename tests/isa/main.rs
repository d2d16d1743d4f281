//! Results of a real GPU's compiler for the shaders, without the GPU: no register spills, no scratch memory, and enough waves to hide each
//! other's memory latency. No software adapter shows any of that.
//!
//! Without Mesa's driver for AMD cards the test reports that it is skipped; with `GPU_TESTS=require` it fails instead, on Linux.

#[path = "../common/mod.rs"]
mod common;
mod radv;

use cregopt::backend::gpu::shaders::Shader;
use radv::{CHIPS, Chip, Radv, Rows};
use std::collections::BTreeSet;
use std::io::Write;

/// Least number of waves per SIMD, in the order of [`CHIPS`], of the shaders that do not fill it: as many as Mesa 22.3 gives them.
///
/// Rows and their products need more registers than all waves together have, most of all the joint speeds, which carry the inverse of a
/// Jacobian and its changes; `front` keeps its front in workgroup memory, and substitutions stage sixteen pivot rows
/// there, as long as the side of the front. With four force pieces instead of three that leaves room for 24 to 30 waves instead of 32. The
/// stages of the solver copy the progress of their candidate, 24 words.
const LEAST_WAVES: &[(Shader, [u64; 3])] = &[
    (Shader::Dynamics, [12, 12, 3]),
    (Shader::Momentum, [12, 12, 3]),
    (Shader::Reach, [16, 16, 4]),
    (Shader::Force, [16, 20, 5]),
    (Shader::Swing, [21, 24, 6]),
    (Shader::Cone, [21, 32, 8]),
    (Shader::Sole, [16, 16, 4]),
    (Shader::StancePower, [12, 12, 3]),
    (Shader::SwingPower, [16, 16, 4]),
    (Shader::JointTorque, [12, 12, 3]),
    (Shader::JointSpeed, [9, 8, 2]),
    (Shader::ConeCurvature, [32, 32, 9]),
    (Shader::Front, [6, 6, 2]),
    (Shader::Substitute, [26, 24, 7]),
    (Shader::Forward, [29, 30, 7]),
    (Shader::Product, [21, 24, 7]),
    (Shader::Judge, [32, 32, 8]),
    (Shader::Weights, [32, 32, 9]),
    (Shader::Correct, [32, 32, 9]),
    (Shader::Advance, [32, 32, 9]),
];
/// Number of waves that fill a SIMD.
const ALL_WAVES: [u64; 3] = [32, 32, 10];

/// Prints the reason even where the output of passing tests is hidden.
#[expect(clippy::explicit_write, reason = "the harness keeps what eprintln prints")]
fn skipped(why: &str) {
    writeln!(std::io::stderr(), "`no_shader_spills_and_each_has_enough_waves` skipped: {why}").unwrap();
}

/// Faults of a shader on a chip.
fn faults(radv: &Radv, rows: &Rows, shader: Shader, chip: Chip, least: u64) -> Vec<String> {
    let of = radv.compile(shader, &rows.variant(radv.workgroup_memory), chip.lanes).unwrap();
    let what = format!("{} ({} rows, {chip})", shader.path(), rows.name);
    let mut faults = Vec::new();
    if of.spilled > 0 {
        faults.push(format!("{what} spills {} registers", of.spilled));
    }
    if of.scratch > 0 {
        faults.push(format!("{what} uses {} bytes of scratch memory a wave", of.scratch));
    }
    if of.waves < least {
        faults.push(format!("{what}: {} waves a SIMD, {least} are asked for; {} registers", of.waves, of.vector_registers));
    }
    faults
}

#[test]
fn no_shader_spills_and_each_has_enough_waves() {
    if let Err(why) = Radv::open(CHIPS[0].family) {
        let required = cfg!(target_os = "linux") && std::env::var("GPU_TESTS").as_deref() == Ok("require");
        assert!(!required, "Mesa's driver for AMD cards is needed: {why}");
        return skipped(&why);
    }
    let named: BTreeSet<Shader> = LEAST_WAVES.iter().map(|(shader, _)| *shader).collect();
    assert_eq!(named.len(), LEAST_WAVES.len(), "a shader is named twice");
    let mut wrong = Vec::new();
    let all_rows = Rows::all();
    for (i, chip) in CHIPS.into_iter().enumerate() {
        let radv = Radv::open(chip.family).unwrap();
        for rows in &all_rows {
            for &shader in Shader::ALL {
                let least = LEAST_WAVES.iter().find(|named| named.0 == shader).map_or(ALL_WAVES, |named| named.1);
                wrong.extend(faults(&radv, rows, shader, chip, least[i]));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
