//! Initial values of the solver, as in TOWR \[3\].
//!
//! The base moves along a line, and its height towards the nominal leg height above the goal. Footholds are spread along the line from the
//! first to the last nominal foothold. Every foot in contact carries an equal share of the weight.

use crate::task::{BaseState, Task};

/// Base height towards which the initial guess moves, m.
pub fn final_base_height(task: &Task) -> f64 {
    let [x, y, _] = task.goal.position;
    task.terrain.height(x, y) - task.robot.nominal_feet[0][2]
}

/// Initial foothold (x, y) of the stance with index `stance` of `stances`, m.
///
/// TOWR spreads the motion nodes evenly over the line, three per stance and swing. A stance is placed at its second node.
pub fn foothold(task: &Task, foot: usize, stance: usize, stances: usize) -> [f64; 2] {
    let (start, goal) = (task.foothold_start(foot), task.foothold_goal(foot));
    if stance == 0 {
        return start;
    }
    let nodes = 3 * stances - 1;
    let part = (3 * stance + 1) as f64 / (nodes - 1) as f64;
    [start[0] + part * (goal[0] - start[0]), start[1] + part * (goal[1] - start[1])]
}

/// Foothold (x, y) of a foot in the middle of its reach under a base pose (position, then Euler angles), m.
pub fn under_base(task: &Task, foot: usize, pose: [f64; 6]) -> [f64; 2] {
    let [px, py, pz, roll, pitch, yaw] = pose;
    let base = BaseState { angles: [roll, pitch, yaw], ..BaseState::level([px, py, pz], 0.) };
    let ([x, y, z], [dx, dy, _]) = (task.robot.nominal_feet[foot], task.robot.reach.of(foot).center());
    let [x, y, _] = base.to_world([x + dx, y + dy, z]);
    [x, y]
}

/// Height of the terrain under the mid node of a swing between two footholds, m.
pub fn swing_height(task: &Task, a: [f64; 2], b: [f64; 2]) -> f64 {
    task.terrain.height((a[0] + b[0]) / 2., (a[1] + b[1]) / 2.)
}

/// Height of the highest of three points: two footholds and the terrain midway between them, m.
pub fn highest(task: &Task, a: [f64; 2], b: [f64; 2]) -> f64 {
    let height = |[x, y]: [f64; 2]| task.terrain.height(x, y);
    height(a).max(height(b)).max(swing_height(task, a, b))
}
