//! Result of a GPU's compiler for every shader: registers, spills, scratch, workgroup memory, waves, instructions and estimated latency.
//!
//! `cargo bench --bench isa`. It needs no GPU, because Mesa's driver for AMD cards compiles for chips that are absent. Prints Markdown.

#[path = "../../tests/common/mod.rs"]
mod common;
#[path = "../../tests/isa/radv.rs"]
mod radv;

use cregopt::backend::gpu::shaders::Shader;
use radv::{CHIPS, Radv, Rows};

fn table() -> Result<(), String> {
    for rows in Rows::all() {
        for chip in CHIPS {
            let radv = Radv::open(chip.family)?;
            let variant = rows.variant(radv.workgroup_memory);
            println!("\n`{}` rows (front {}), {chip}:\n", rows.name, rows.front);
            println!(
                "| shader | VGPRs | SGPRs | spilled | scratch, B | workgroup memory, B | waves per SIMD | instructions | latency, cycles |"
            );
            println!("|---|---|---|---|---|---|---|---|---|");
            for &shader in Shader::ALL {
                let of = radv.compile(shader, &variant, chip.lanes)?;
                println!(
                    "| {} | {} | {} | {} | {} | {} | {} | {} | {} |",
                    shader.path(),
                    of.vector_registers,
                    of.scalar_registers,
                    of.spilled,
                    of.scratch,
                    of.workgroup_memory,
                    of.waves,
                    of.instructions,
                    of.latency
                );
            }
        }
    }
    Ok(())
}

fn main() {
    if let Err(why) = Radv::open(CHIPS[0].family) {
        println!("Nothing is compiled: Mesa's driver for AMD cards is not available ({why}).");
        return;
    }
    if let Err(why) = table() {
        eprintln!("error: {why}");
        std::process::exit(1);
    }
}
