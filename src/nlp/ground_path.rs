//! Path of the base over uneven ground for the initial guess. It follows the ground under the feet, and bridges pits that the feet can step
//! over.

use crate::task::{BaseState, Task, tilt_over};

/// Number of parts into which the path is divided.
const PARTS: usize = 64;

/// Offset of the base from the straight line: height (m), roll and pitch (rad) at the ends of all parts.
#[derive(Debug, Clone)]
pub struct GroundPath(Vec<[f64; 3]>);

impl GroundPath {
    /// Ground path of a task; `None` if the straight line is as good.
    pub fn new(task: &Task) -> Option<GroundPath> {
        let robot = &task.robot;
        // Half the length of the robot, which bridges a pit as long as itself.
        let half = robot.nominal_feet.iter().map(|foot| foot[0].hypot(foot[1])).fold(0., f64::max);
        let [x, y] = task.displacement();
        // If the base turns, its feet move on arcs.
        let length = x.hypot(y).max(half * task.turn().abs());
        if !task.terrain.has_edges() || length == 0. {
            return None;
        }
        let window = ((half * PARTS as f64 / length).round() as usize).clamp(1, PARTS);
        let level = |part: usize| {
            let [x, y, _, _, _, yaw] = task.line(part as f64 / PARTS as f64);
            BaseState::level([x, y, 0.], yaw)
        };
        let track = |foot: usize| -> Vec<f64> {
            let ground = |part: usize| {
                let [x, y, _] = level(part).to_world(robot.nominal_feet[foot]);
                task.terrain.height(x, y)
            };
            filled(&(0..=PARTS).map(ground).collect::<Vec<f64>>(), window)
        };
        let tracks: Vec<Vec<f64>> = (0..robot.feet()).map(track).collect();
        let off_line = |part: usize| {
            let heights: Vec<f64> = tracks.iter().map(|track| track[part]).collect();
            let [roll, pitch] = tilt_over(robot, &heights);
            let z = robot.base_height + heights.iter().sum::<f64>() / heights.len() as f64;
            let line = task.line(part as f64 / PARTS as f64);
            [z - line[2], roll - line[3], pitch - line[4]]
        };
        let path: Vec<[f64; 3]> = (0..=PARTS).map(off_line).collect();
        let (first, last) = (path[0], path[PARTS]);
        // Start and end are those of the task.
        let anchored = |(part, at): (usize, &[f64; 3])| {
            let u = part as f64 / PARTS as f64;
            std::array::from_fn(|i| at[i] - first[i] - u * (last[i] - first[i]))
        };
        let path = smooth(&path.iter().enumerate().map(anchored).collect::<Vec<_>>(), window.div_ceil(2));
        Some(GroundPath(smooth(&path, window.div_ceil(4))))
    }

    /// Offset of height, roll and pitch from the line at a fraction of the path, and the derivatives with respect to that fraction.
    pub fn at(&self, part: f64) -> [[f64; 3]; 2] {
        let scaled = part.clamp(0., 1.) * PARTS as f64;
        let index = (scaled as usize).min(PARTS - 1);
        let (before, after, u) = (self.0[index], self.0[index + 1], scaled - index as f64);
        [std::array::from_fn(|i| before[i] + u * (after[i] - before[i])), std::array::from_fn(|i| (after[i] - before[i]) * PARTS as f64)]
    }
}

/// Heights with pits up to two windows long filled: the maximum over every window, then the minimum of these maxima.
fn filled(heights: &[f64], window: usize) -> Vec<f64> {
    let over = |values: &[f64], best: fn(f64, f64) -> f64| -> Vec<f64> {
        let at = |i: usize| {
            values[i.saturating_sub(window)..(i + window + 1).min(values.len())].iter().copied().reduce(best).unwrap_or_default()
        };
        (0..values.len()).map(at).collect()
    };
    over(&over(heights, f64::max), f64::min)
}

/// Moving averages over windows that shrink towards the ends, which keep their values.
fn smooth(values: &[[f64; 3]], window: usize) -> Vec<[f64; 3]> {
    let mean = |i: usize| {
        let width = window.min(i).min(values.len() - 1 - i);
        let part = &values[i - width..=i + width];
        std::array::from_fn(|d| part.iter().map(|v| v[d]).sum::<f64>() / part.len() as f64)
    };
    (0..values.len()).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;
    use crate::task::Goal;
    use crate::terrain::Terrain;

    fn path(terrain: &str, x: f64) -> Option<GroundPath> {
        let task = Task::new(Robot::named("anymal").unwrap(), Terrain::named(terrain).unwrap(), Goal::at(x, 0.)).unwrap();
        GroundPath::new(&task)
    }

    #[test]
    fn the_path_follows_a_slope_and_bridges_a_pit() {
        assert!(path("flat", 3.).is_none());
        // 1.5 m deep and 0.6 m long: the robot bridges it.
        let gap = path("gap", 3.).unwrap();
        assert!(gap.0.iter().flatten().all(|v| v.abs() < 1e-12), "{gap:?}");
        // Up 0.7 m from x = 1 to 2 and down again: steepest at 1.5, level at the top, and mirrored.
        let slope = path("slope", 4.).unwrap();
        let [[_, roll, up], _] = slope.at(1.5 / 4.);
        assert!(roll.abs() < 1e-12 && (up + 0.7f64.atan()).abs() < 0.1, "{up}");
        let [[top, _, level], _] = slope.at(0.5);
        assert!(top > 0.4 && top < 0.7 && level.abs() < 0.05, "{top} {level}");
        assert!((slope.at(2.5 / 4.)[0][2] + up).abs() < 0.05);
        assert_eq!([slope.at(0.)[0], slope.at(1.)[0]], [[0.; 3]; 2]);
    }

    #[test]
    fn the_path_follows_a_slope_on_which_the_body_turns() {
        let (robot, terrain) = (Robot::named("anymal").unwrap(), Terrain::named("slope").unwrap());
        let [start, goal] = [Goal::at(1.5, 0.), Goal::at(1.5, 0.).yaw(std::f64::consts::PI)];
        let task = Task::between(robot, terrain, start, goal).unwrap();
        // Nose up at the start, nose down at the end, rolled halfway: by less than the slope, because hollows on the path of a foot are
        // filled.
        let [[z, roll, pitch], _] = GroundPath::new(&task).unwrap().at(0.5);
        assert!((-0.7f64.atan()..-0.25).contains(&roll) && pitch.abs() < 0.05 && z.abs() < 0.1, "{z} {roll} {pitch}");
    }

    #[test]
    fn the_rate_is_the_derivative_of_the_path() {
        let path = path("stairs", 3.).unwrap();
        for part in [0.11, 0.37, 0.505, 0.93] {
            let d = 1e-7;
            let [[before, _], [after, _]] = [path.at(part - d), path.at(part + d)];
            let [_, rate] = path.at(part);
            assert!((0..3).all(|i| ((after[i] - before[i]) / (2. * d) - rate[i]).abs() < 1e-5));
        }
    }
}
