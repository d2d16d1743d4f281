//! Own ground: a ramp and a plateau from a height map, with a gait across it.

use cregopt::terrain::import::{Placement, terrain_of_heights};
use cregopt::{Cpu, Goal, Robot, Search, Task};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Samples every 0.1 m, from x = y = -2 m on: level up to x = 0.5 m, then a ramp to 0.15 m.
    let height = |i: usize| (0.1 * i as f64 - 2.5).clamp(0., 0.6) / 4.;
    let heights = (0..60).map(|i| vec![height(i); 40]).collect();
    let placement = Placement { cell: Some(0.1), origin: Some([-2., -2.]), friction: 0.7, ..Placement::default() };
    let terrain = terrain_of_heights("ramp".into(), heights, &placement)?.terrain;
    println!("ground at the goal: {:.3} m", terrain.height(2., 0.));

    // Without a height the goal is at the robot's `base_height` above the ground.
    let task = Task::new(Robot::named("anymal")?, terrain, Goal::at(2., 0.))?;
    let found = Search::new(&task).first().run(&Cpu::new(0)?)?;
    assert!(found.best.feasible());
    for (foot, [x, y]) in found.best.trajectory().end_feet().iter().enumerate() {
        println!("foot {foot} ends at ({x:.2}, {y:.2}, {:.2}) m", task.terrain.height(*x, *y));
    }
    Ok(())
}
