//! Tasks on easier ground: heights that are a share of the true ones.

use super::standing::ground_under;
use super::{BaseState, Task, tilt_over};
use crate::error::Result;
use crate::robot::Robot;
use crate::terrain::Terrain;

/// Ground around start and goal that a motion may need, in distances of the farthest foot from the base.
const AROUND: f64 = 4.;

impl Task {
    /// The task on ground with a share of its relief, about the ground below the start. Both ends of the motion stay at their heights and
    /// tilts relative to the ground under the feet.
    ///
    /// * `share` - 0 for level ground, 1 for this task
    ///
    /// # Errors
    /// [`Error::Invalid`](crate::Error::Invalid) if the task is not valid there.
    pub fn with_relief(&self, share: f64) -> Result<Task> {
        if share == 1. {
            return Ok(self.clone());
        }
        let ends = [self.start.position, self.goal.position];
        let around = AROUND * self.robot.nominal_feet.iter().map(|foot| foot[0].hypot(foot[1])).fold(0.1, f64::max);
        let area =
            [[0, 1].map(|axis| ends[0][axis].min(ends[1][axis]) - around), [0, 1].map(|axis| ends[0][axis].max(ends[1][axis]) + around)];
        let level = self.terrain.height(ends[0][0], ends[0][1]);
        let terrain = self.terrain.with_relief(share, level, area);
        let moved = |state: &BaseState| {
            let [(before, [roll, pitch]), (after, [new_roll, new_pitch])] =
                [&*self.terrain, &terrain].map(|on| under(&self.robot, on, state));
            let [x, y, z] = state.position;
            let [old_roll, old_pitch, yaw] = state.angles;
            let angles = [old_roll + new_roll - roll, old_pitch + new_pitch - pitch, yaw];
            BaseState { position: [x, y, z + after - before], angles, ..*state }
        };
        let start_swings = self.start_swings.iter().map(|swing| {
            swing.map(|mut swing| {
                let [x, y, _] = swing.position;
                swing.position[2] += terrain.height(x, y) - self.terrain.height(x, y);
                swing
            })
        });
        let (start, goal, start_swings) = (moved(&self.start), moved(&self.goal), start_swings.collect());
        let task = Task { terrain: terrain.into(), start, goal, start_swings, ..self.clone() };
        task.validate()?;
        Ok(task)
    }
}

/// Mean height of the ground under the nominal feet of a robot, m, and roll and pitch along it, rad.
fn under(robot: &Robot, terrain: &Terrain, state: &BaseState) -> (f64, [f64; 2]) {
    let level = BaseState::level(state.position, state.yaw());
    let heights: Vec<f64> = (0..robot.feet()).map(|foot| ground_under(robot, terrain, &level, foot)).collect();
    (heights.iter().sum::<f64>() / heights.len() as f64, tilt_over(robot, &heights))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::Goal;

    fn task(terrain: &str, start: f64, goal: f64) -> Task {
        let (robot, terrain) = (Robot::named("anymal").unwrap(), Terrain::named(terrain).unwrap());
        Task::between(robot, terrain, Goal::at(start, 0.), Goal::at(goal, 0.)).unwrap()
    }

    #[test]
    fn both_ends_keep_their_height_above_the_ground() {
        let onto = task("block", 0., 2.);
        assert_eq!(onto.with_relief(1.).unwrap(), onto);
        let half = onto.with_relief(0.5).unwrap();
        assert_eq!(half.start, onto.start);
        assert!((onto.goal.position[2] - 1.).abs() < 1e-9 && (half.goal.position[2] - 0.75).abs() < 1e-9);
        // From the block down, about the height of the block.
        let down = task("block", 3., 5.5).with_relief(0.5).unwrap();
        assert!((down.start.position[2] - 1.).abs() < 1e-9 && (down.goal.position[2] - 0.75).abs() < 1e-9);
    }

    #[test]
    fn the_base_stays_along_the_ground() {
        let (whole, half) = (task("slope", 0., 1.5), task("slope", 0., 1.5).with_relief(0.5).unwrap());
        // The default tilt on the slope of 0.7 is limited to 0.6 rad.
        assert!((whole.goal.angles[1] + 0.6).abs() < 1e-9 && (half.goal.angles[1] + 0.35f64.atan()).abs() < 1e-6, "{:?}", half.goal);
    }
}
