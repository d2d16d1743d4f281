//! A task: which robot, on which ground, from where to where.

use crate::error::{Error, Result, check_range};
use crate::gait::{Curve, FootCurves, Trajectory};
use crate::robot::Robot;
use crate::terrain::Terrain;
use std::sync::Arc;

/// What is to be done. The robot starts at rest above the origin with yaw 0 and its feet at their nominal positions on the ground.
#[derive(Debug, Clone, PartialEq)]
pub struct Task {
    /// The robot.
    pub robot: Arc<Robot>,
    /// The ground.
    pub terrain: Arc<Terrain>,
    /// Final base position, world frame, m.
    pub base_target: [f64; 3],
    /// Final yaw, rad; final roll and pitch are zero.
    pub yaw_target: f64,
    /// Largest normal force of a foot, N; the robot's or the transcription's when none is asked for.
    pub force_limit: Option<f64>,
}

/// Where the base is to end, at rest and level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Goal {
    /// Position, world frame, m.
    pub xy: [f64; 2],
    /// Height, m; without it as high above the ground as at the start, or as near to that as the feet reach the ground from.
    pub z: Option<f64>,
    /// Yaw, rad.
    pub yaw: f64,
}

impl Goal {
    /// Above a point of the ground, with the yaw of the start.
    pub fn at(x: f64, y: f64) -> Goal {
        Goal { xy: [x, y], z: None, yaw: 0. }
    }

    /// A position, with the yaw of the start.
    pub fn position([x, y, z]: [f64; 3]) -> Goal {
        Goal { xy: [x, y], z: Some(z), yaw: 0. }
    }

    /// The same with a yaw, rad.
    pub fn yaw(self, yaw: f64) -> Goal {
        Goal { yaw, ..self }
    }
}

impl Task {
    /// A validated task, with no force limit of its own.
    ///
    /// # Errors
    /// [`Error::Invalid`] when the goal is off the terrain, or a number is out of its limits.
    pub fn new(robot: impl Into<Arc<Robot>>, terrain: impl Into<Arc<Terrain>>, goal: Goal) -> Result<Task> {
        let (robot, terrain, Goal { xy: [x, y], z, yaw }) = (robot.into(), terrain.into(), goal);
        let base_target = match z {
            Some(z) => [x, y, z],
            None => {
                terrain.check_inside("goal", x, y)?;
                [x, y, robot.base_height + terrain.height(x, y)]
            }
        };
        let mut task = Task { robot, terrain, base_target, yaw_target: yaw, force_limit: None };
        task.validate()?;
        if z.is_none() && task.terrain.has_edges() {
            let [low, high] = task.heights_at_goal();
            let height = task.base_target[2];
            if low < high && !(low..=high).contains(&height) {
                // Not at the very end of what feet reach.
                let inside = 0.25 * (high - low);
                task.base_target[2] = height.clamp(low + inside, high - inside);
                task.validate()?;
            }
        }
        Ok(task)
    }

    /// Checks robot, terrain and goal.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first value that is out of its limits.
    pub fn validate(&self) -> Result<()> {
        self.robot.validate()?;
        self.terrain.validate()?;
        let [x, y, z] = self.base_target;
        for (axis, v) in [x, y, z].into_iter().enumerate() {
            check_range(&format!("base_target[{axis}]"), v, -1000., 1000.)?;
        }
        self.terrain.check_inside("base_target", x, y)?;
        if z <= self.terrain.height(x, y) {
            return Err(Error::invalid(
                "base_target[2]",
                z,
                format!("above the terrain, which is {} m high there", self.terrain.height(x, y)),
            ));
        }
        check_range("yaw_target", self.yaw_target, -20. * std::f64::consts::PI, 20. * std::f64::consts::PI)?;
        self.force_limit.map_or(Ok(()), |limit| check_range("force_limit", limit, 1e-3, 1e7))
    }

    /// A motion of this task, from its curves.
    ///
    /// * `transcription` - name of the rows that it was made for
    /// * `force_limit` - largest normal force of a foot that it was made for, N
    /// * `durations` - s, `[feet][phases]`
    /// * `base` - position, and Euler angles
    pub fn trajectory(
        &self,
        transcription: &str,
        force_limit: f64,
        durations: Vec<Vec<f64>>,
        horizon: f64,
        base: [Curve; 2],
        ee: Vec<FootCurves>,
    ) -> Trajectory {
        Trajectory {
            transcription: Some(transcription.into()),
            version: Some(env!("CARGO_PKG_VERSION").into()),
            init_base: Some(self.base_start()),
            base_target: self.base_target,
            yaw_target: self.yaw_target,
            force_limit: Some(force_limit),
            ..Trajectory::new(durations, horizon, base, ee)
        }
    }

    /// Base position at the start, world frame, m.
    pub fn base_start(&self) -> [f64; 3] {
        [0., 0., self.robot.base_height + self.terrain.height(0., 0.)]
    }

    /// Lowest and highest ground that a foot has within its reach along x and y at the goal, m.
    pub fn ground_at_goal(&self, foot: usize) -> [f64; 2] {
        let reach = self.robot.reach.of(foot);
        let ([middle_x, middle_y, _], [half_x, half_y, _]) = (reach.center(), reach.half_widths());
        let (sin, cos) = self.yaw_target.sin_cos();
        let center = self.foothold_goal(foot);
        // At a place in the box, its half-widths being 1.
        let height = |u: f64, v: f64| {
            let (x, y) = (middle_x + u.clamp(-1., 1.) * half_x, middle_y + v.clamp(-1., 1.) * half_y);
            self.terrain.height(center[0] + cos * x - sin * y, center[1] + sin * x + cos * y)
        };
        // Samples all over the box, then ever closer about the best.
        [-1., 1.].map(|sign| {
            let mut best = (sign * height(0., 0.), 0., 0.);
            let mut look = |center: (f64, f64), width: f64, samples: i32| {
                for i in -samples..=samples {
                    for j in -samples..=samples {
                        let (u, v) =
                            (center.0 + width * f64::from(i) / f64::from(samples), center.1 + width * f64::from(j) / f64::from(samples));
                        let value = sign * height(u, v);
                        if value > best.0 {
                            best = (value, u, v);
                        }
                    }
                }
                (best.1, best.2)
            };
            let mut at = look((0., 0.), 1., 20);
            for width in [0.05, 0.0125, 0.003] {
                at = look(at, width, 4);
            }
            sign * best.0
        })
    }

    /// Lowest and highest base at the goal from which every foot reaches ground, m; empty, with the lowest above the highest, where no height will do.
    pub fn heights_at_goal(&self) -> [f64; 2] {
        (0..self.robot.feet()).fold([f64::NEG_INFINITY, f64::INFINITY], |[low, high], foot| {
            let ([lowest, highest], nominal) = (self.ground_at_goal(foot), self.robot.nominal_feet[foot][2]);
            let reach = self.robot.reach.of(foot);
            [low.max(lowest - nominal - reach.high[2]), high.min(highest - nominal - reach.low[2])]
        })
    }

    /// Foothold of a foot at the start (x, y), world frame, m.
    pub fn foothold_start(&self, foot: usize) -> [f64; 2] {
        let [x, y, _] = self.robot.nominal_feet[foot];
        [x, y]
    }

    /// Nominal foothold of a foot at the goal (x, y), world frame, m.
    pub fn foothold_goal(&self, foot: usize) -> [f64; 2] {
        let [x, y, _] = self.robot.nominal_feet[foot];
        let (sin, cos) = self.yaw_target.sin_cos();
        [self.base_target[0] + cos * x - sin * y, self.base_target[1] + sin * x + cos * y]
    }
}
