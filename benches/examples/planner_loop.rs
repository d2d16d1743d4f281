//! Planning online: 50 updates a second, with a robot that follows its plans exactly.

use cregopt::planner::{Command, Planner, PlannerSettings, RobotState};
use cregopt::{Goal, Robot, Task, Terrain};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let robot = Robot::named("anymal")?;
    let standing = Task::new(robot.clone(), Terrain::flat(), Goal::at(0., 0.))?;
    let mut state = RobotState::standing(&standing);
    let mut planner = Planner::new(robot, Terrain::flat(), PlannerSettings::default())?;
    let command = Command { velocity: [0.5, 0.], yaw_rate: 0.2 };
    let mut gait = None;
    for tick in 0..50 {
        let update = planner.update(&state, &command, f64::from(tick) / 50.)?;
        if gait != Some(update.plan.gait.family) {
            gait = Some(update.plan.gait.family);
            println!("{:.2} s: {}", f64::from(tick) / 50., update.plan.gait.family.map_or("stand".into(), |family| family.to_string()));
        }
        // A real robot measures its state; this one is where the plan says.
        state = update.plan.state(f64::from(tick + 1) / 50.);
    }
    let [x, y, _] = state.base.position;
    println!("after 1 s at ({x:.2}, {y:.2}) m, yaw {:.2} rad", state.base.yaw());
    assert!(x > 0.2);
    Ok(())
}
