//! Planning online without a simulator: a robot that follows its plans exactly, except for pushes that change its velocity.
//!
//!     cargo bench --bench online -- [--robot NAME] [--seconds 5] [--speed 0.5] [--push VX,VY] \
//!         [--candidates 16] [--horizon 0.8] [--optimise 4] [--threads 0] [--verbose]

use cregopt::planner::{Command, Planner, PlannerSettings, RobotState};
use cregopt::{Goal, Result, Robot, Task, Terrain};

/// Updates per second.
const RATE: f64 = 50.;

fn option<T: std::str::FromStr>(name: &str, default: T) -> T {
    let arguments: Vec<String> = std::env::args().collect();
    let value = arguments.iter().position(|a| a == name).and_then(|at| arguments.get(at + 1));
    value.map_or(default, |v| v.parse().unwrap_or_else(|_| panic!("{name} {v}: not a value of this option")))
}

fn main() -> Result<()> {
    let robot = Robot::named(&option("--robot", "anymal".to_string()))?;
    let push = option("--push", "0,0".to_string());
    let push: Vec<f64> = push.split(',').map(|v| v.parse().expect("--push: two numbers, m/s")).collect();
    let settings = PlannerSettings {
        candidates: option("--candidates", 16),
        threads: option("--threads", 0),
        horizon: Some(option("--horizon", 0.8)),
        optimise_iterations: option("--optimise", 4),
        ..PlannerSettings::default()
    };
    let mut planner = Planner::new(robot.clone(), Terrain::flat(), settings)?;
    let task = Task::new(robot, Terrain::flat(), Goal::at(0., 0.))?;
    let mut state = RobotState::standing(&task);
    let (seconds, speed) = (option("--seconds", 5.), option("--speed", 0.5));
    let verbose = std::env::args().any(|a| a == "--verbose");
    let (mut times, mut failed) = (Vec::new(), 0);
    for tick in 0..(seconds * RATE) as usize {
        let now = tick as f64 / RATE;
        if tick == (seconds * RATE / 2.) as usize {
            state.base.velocity[0] += push[0];
            state.base.velocity[1] += push[1];
        }
        let command = Command { velocity: [if now < seconds - 1. { speed } else { 0. }, 0.], yaw_rate: 0. };
        let update = planner.update(&state, &command, now)?;
        times.push(1e3 * update.seconds);
        failed += usize::from(!update.renewed);
        let plan = &update.plan;
        if verbose {
            let [x, y, z] = state.base.position;
            let [vx, vy, _] = state.base.velocity;
            println!(
                "{now:.2} x {x:.3} {y:.3} {z:.3} v {vx:.3} {vy:.3} {:?} swing {:.3} stance {:.3} phase {:.2} cost {:.3} solved {} of {} its {} {:.1} ms {}",
                plan.gait.family,
                plan.gait.swing,
                plan.gait.stance,
                plan.gait.phase,
                plan.cost,
                update.solved,
                update.candidates,
                update.iterations,
                1e3 * update.seconds,
                if update.renewed { "" } else { "held" }
            );
        }
        state = plan.state(now + 1. / RATE);
    }
    times.sort_by(f64::total_cmp);
    let at = |part: f64| times[((times.len() - 1) as f64 * part) as usize];
    println!("{} updates: median {:.1} ms, 99th percentile {:.1} ms; {failed} kept the plan before", times.len(), at(0.5), at(0.99));
    println!("at {:.2} m after {seconds} s, velocity {:?}", state.base.position[0], state.base.velocity);
    Ok(())
}
