//! Own robot: import of a URDF file, and the joints along a gait.

use cregopt::gait::joints::follow;
use cregopt::robot::import::Import;
use cregopt::{Cpu, Goal, Search, Task, Terrain};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let imported = Import::default().file(Path::new("tests/data/quadruped.urdf"))?;
    for note in &imported.notes {
        println!("note: {note}");
    }
    println!("{:.1} kg, {} feet", imported.robot.mass, imported.robot.feet());
    let task = Task::new(imported.robot, Terrain::flat(), Goal::at(1., 0.2).yaw(0.3))?;
    let found = Search::new(&task).generations(1).run(&Cpu::new(0)?)?;
    assert!(found.best.feasible());
    // Positions, velocities and torques at 100 Hz.
    let joints = follow(found.best.trajectory(), &task.robot, &task.terrain, 100.)?;
    let last = joints.samples.last().ok_or("no sample")?;
    println!("{} joints, at {:.2} s: {:.3?} rad", joints.joints.len(), last.time, last.positions);
    assert!(joints.limits.kept, "{:?}", joints.limits);
    Ok(())
}
