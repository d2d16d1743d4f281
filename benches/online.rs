//! Planning online without a simulator: a robot that follows its plans exactly, except for pushes that change its velocity.
//!
//!     cargo bench --bench online -- [--robot NAME] [--seconds 5] [--speed 0.5[,V]...] [--push VX,VY] [--families NAME,...] \
//!         [--candidates 16] [--horizon H] [--optimise 4] [--threads 0] [--verbose]
//!
//! Times of the updates, and for each speed the gaits in force and the mean cost of their plans, from 2 s on until the robot stops.

use cregopt::gait::family::GaitFamily;
use cregopt::planner::{Command, Planner, PlannerSettings, RobotState, Update};
use cregopt::{Goal, Result, Robot, Task, Terrain};
use std::collections::BTreeMap;

/// Updates per second.
const RATE: f64 = 50.;
/// Time in which a robot reaches the commanded speed, and from the end of the command to the end of the drive, s.
const SETTLED: f64 = 2.;
const STOPPING: f64 = 1.;

fn text(name: &str) -> Option<String> {
    let arguments: Vec<String> = std::env::args().collect();
    let at = arguments.iter().position(|a| a == name)?;
    arguments.get(at + 1).cloned()
}

fn number<T: std::str::FromStr>(name: &str, value: &str) -> T {
    value.parse().unwrap_or_else(|_| panic!("{name} {value}: not a value of this option"))
}

fn option<T: std::str::FromStr>(name: &str, default: T) -> T {
    text(name).map_or(default, |value| number(name, &value))
}

fn numbers(name: &str, default: &str) -> Vec<f64> {
    text(name).unwrap_or_else(|| default.to_string()).split(',').map(|value| number(name, value)).collect()
}

/// Updates of a drive.
struct Drive {
    /// Durations of the updates, ms, ascending.
    times: Vec<f64>,
    /// Number of updates that kept the plan before.
    kept: usize,
    /// Number of updates with each gait in force while the robot moves steadily.
    gaits: BTreeMap<&'static str, usize>,
    /// Sum of the costs of the plans of these updates.
    cost: f64,
    /// State at the end.
    state: RobotState,
}

fn print(now: f64, state: &RobotState, update: &Update) {
    let ([x, y, z], [vx, vy, _], gait) = (state.base.position, state.base.velocity, &update.plan.gait);
    println!(
        "{now:.2} x {x:.3} {y:.3} {z:.3} v {vx:.3} {vy:.3} {:?} swing {:.3} stance {:.3} phase {:.2} cost {:.3} solved {} of {} its {} {:.1} ms {}",
        gait.family,
        gait.swing,
        gait.stance,
        gait.phase,
        update.plan.cost,
        update.solved,
        update.candidates,
        update.iterations,
        1e3 * update.seconds,
        if update.renewed { "" } else { "held" }
    );
}

fn drive(robot: &Robot, settings: &PlannerSettings, speed: f64) -> Result<Drive> {
    let mut planner = Planner::new(robot.clone(), Terrain::flat(), settings.clone())?;
    let state = RobotState::standing(&Task::new(robot.clone(), Terrain::flat(), Goal::at(0., 0.))?);
    let mut drive = Drive { times: Vec::new(), kept: 0, gaits: BTreeMap::new(), cost: 0., state };
    let (seconds, push) = (option("--seconds", 5.), numbers("--push", "0,0"));
    let verbose = std::env::args().any(|a| a == "--verbose");
    for tick in 0..(seconds * RATE) as usize {
        let now = tick as f64 / RATE;
        if tick == (seconds * RATE / 2.) as usize {
            drive.state.base.velocity[0] += push[0];
            drive.state.base.velocity[1] += push[1];
        }
        let moves = now < seconds - STOPPING;
        let command = Command { velocity: [if moves { speed } else { 0. }, 0.], yaw_rate: 0. };
        let update = planner.update(&drive.state, &command, now)?;
        drive.times.push(1e3 * update.seconds);
        drive.kept += usize::from(!update.renewed);
        if moves && now >= SETTLED {
            *drive.gaits.entry(update.plan.gait.family.map_or("stand", GaitFamily::name)).or_default() += 1;
            drive.cost += update.plan.cost;
        }
        if verbose {
            print(now, &drive.state, &update);
        }
        drive.state = update.plan.state(now + 1. / RATE);
    }
    drive.times.sort_by(f64::total_cmp);
    Ok(drive)
}

fn main() -> Result<()> {
    let robot = Robot::named(&option("--robot", "anymal".to_string()))?;
    let families = text("--families").map(|names| names.split(',').map(GaitFamily::named).collect::<Result<Vec<_>>>()).transpose()?;
    let settings = PlannerSettings {
        candidates: option("--candidates", 16),
        threads: option("--threads", 0),
        horizon: text("--horizon").map(|value| number("--horizon", &value)),
        optimise_iterations: option("--optimise", 4),
        families,
        ..PlannerSettings::default()
    };
    for speed in numbers("--speed", "0.5") {
        let drive = drive(&robot, &settings, speed)?;
        let at = |part: f64| drive.times[((drive.times.len() - 1) as f64 * part) as usize];
        let count = drive.gaits.values().sum::<usize>().max(1) as f64;
        let gaits: Vec<String> =
            drive.gaits.iter().map(|(name, updates)| format!("{name} {:.0} %", 100. * *updates as f64 / count)).collect();
        println!(
            "{speed} m/s: {} updates, median {:.1} ms, 99th percentile {:.1} ms, {} kept the plan before; {}, cost {:.3}",
            drive.times.len(),
            at(0.5),
            at(0.99),
            drive.kept,
            gaits.join(", "),
            drive.cost / count
        );
        let base = &drive.state.base;
        println!("at {:.2} m at the end, velocity {:?}", base.position[0], base.velocity);
    }
    Ok(())
}
