//! First gait: ANYmal walks 2 m on flat ground.
//!
//! Prints the certificate and writes the motion, which `cregopt view` shows.

use cregopt::app::label::{Provenance, label};
use cregopt::{Cpu, Goal, Robot, Search, Task, Terrain};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let task = Task::new(Robot::named("anymal")?, Terrain::flat(), Goal::at(2., 0.))?;
    let found = Search::new(&task).seed(1).generations(1).run(&Cpu::new(0)?)?;
    println!("{}", found.best.certificate());
    assert!(found.best.feasible());
    let file = std::env::temp_dir().join("first_gait.json");
    // With its robot and terrain, the file is complete.
    let motion = label(found.best.trajectory().clone(), &task, Provenance::default(), Some(1));
    std::fs::write(&file, serde_json::to_string(&motion)?)?;
    println!("cregopt view {}", file.display());
    Ok(())
}
