//! Planning online.

use super::convert::{Raise, from_python, raised};
use super::motion::{Samples, Trajectory};
use super::world::{Robot, Terrain};
use crate::backend::locked;
use crate::error::Error;
use crate::export::Sampled;
use crate::gait::trajectory::NamedOr;
use crate::planner::{Command, FootState, PlannerSettings};
use crate::task::BaseState;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Arc, Mutex};

/// Measured state of a robot.
///
/// Parameters
/// ----------
/// position, velocity : array, shape (3,)
///     Centre of mass, world frame, m and m/s.
/// rotation : array, shape (3, 3)
///     Rotation matrix from base to world.
/// angular_velocity : array, shape (3,)
///     World frame, rad/s.
/// feet, feet_velocity : array, shape (feet, 3)
///     Contact points of the feet, in the robot's order, world frame, m and m/s.
/// contacts : list of bool
///     True for loaded feet.
/// yaws : array, shape (feet,), optional
///     Yaws of the soles, world frame, rad; by default that of the base. Without effect for feet without soles.
#[pyclass(frozen, module = "cregopt")]
pub struct RobotState(crate::planner::RobotState);

#[pymethods]
impl RobotState {
    #[new]
    #[pyo3(signature = (position, rotation, velocity, angular_velocity, feet, feet_velocity, contacts, yaws = None))]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        position: [f64; 3],
        rotation: [[f64; 3]; 3],
        velocity: [f64; 3],
        angular_velocity: [f64; 3],
        feet: Vec<[f64; 3]>,
        feet_velocity: Vec<[f64; 3]>,
        contacts: Vec<bool>,
        yaws: Option<Vec<f64>>,
    ) -> PyResult<Self> {
        let base = BaseState::of_rotation(position, rotation, velocity, angular_velocity);
        let yaws = yaws.unwrap_or_else(|| vec![base.yaw(); feet.len()]);
        if [feet_velocity.len(), contacts.len(), yaws.len()] != [feet.len(); 3] {
            let [velocities, loads, turns] = [feet_velocity.len(), contacts.len(), yaws.len()];
            let value = format!("{} positions, {velocities} velocities, {loads} contacts, {turns} yaws", feet.len());
            return Err(raised(Error::invalid("feet", value, "one of each per foot")));
        }
        let feet = feet.into_iter().zip(feet_velocity).zip(contacts).zip(yaws);
        let feet = feet.map(|(((position, velocity), contact), yaw)| FootState { position, velocity, contact, yaw }).collect();
        Ok(RobotState(crate::planner::RobotState { base, feet }))
    }
}

/// Plan of one update: a motion that starts at a time, and its gait.
#[pyclass(frozen, module = "cregopt")]
pub struct Plan(Arc<crate::planner::Plan>);

#[pymethods]
impl Plan {
    /// Time at which the motion starts, s, on the clock of the updates.
    #[getter]
    fn start(&self) -> f64 {
        self.0.start
    }

    /// Family of the gait; None if all feet land and stand.
    #[getter]
    fn gait(&self) -> Option<&'static str> {
        self.0.gait.family.map(|family| family.name())
    }

    /// Durations of swing and stance in the gait, s, and the fraction of its stride that has passed at the start.
    #[getter]
    fn cycle(&self) -> (f64, f64, f64) {
        (self.0.gait.swing, self.0.gait.stance, self.0.gait.phase)
    }

    /// Cost, per weight and a typical distance; it includes the distance from the command.
    #[getter]
    fn cost(&self) -> f64 {
        self.0.cost
    }

    /// Phase durations, s: one list per foot. A first duration of 0 and a last one that is not positive belong to feet in the air.
    #[getter]
    fn schedule(&self) -> Vec<Vec<f64>> {
        self.0.motion.durations.clone()
    }

    /// Duration of the motion, s.
    #[getter]
    fn horizon(&self) -> f64 {
        self.0.motion.horizon
    }

    /// Terrain for which the motion holds: the planner's, or if contacts of the feet were off it, a grid through their last contacts.
    #[getter]
    fn terrain(&self) -> Terrain {
        Terrain(self.0.terrain.clone())
    }

    /// The motion, with robot and terrain.
    #[getter]
    fn trajectory(&self) -> Trajectory {
        let motion = crate::Trajectory {
            robot: Some(NamedOr::Own((*self.0.robot).clone())),
            terrain: Some(NamedOr::Own((*self.0.terrain).clone())),
            ..self.0.motion.clone()
        };
        Trajectory { motion: Arc::new(motion), force_limit: None }
    }

    /// Samples the motion; see ``Trajectory.sample``. The times of the samples begin at 0.
    #[pyo3(signature = (rate = 100.))]
    fn sample(&self, py: Python<'_>, rate: f64) -> PyResult<Samples> {
        let sampled = py.detach(|| Sampled::new(&self.0.motion, &self.0.robot, &self.0.terrain, rate));
        Samples::new(py, &sampled.raise()?)
    }
}

/// Result of one update.
#[pyclass(frozen, get_all, module = "cregopt")]
pub struct Update {
    /// The plan in force.
    plan: Py<Plan>,
    /// True if this update made the plan, False if no candidate held and the plan before stays.
    renewed: bool,
    /// True if this update made the plan with wider limits of the legs, because no candidate held with the usual ones.
    stretched: bool,
    /// Number of candidates that were solved.
    solved: usize,
    /// Number of candidates.
    candidates: usize,
    /// Iterations of all candidates.
    iterations: usize,
    /// Duration of the update, s.
    seconds: f64,
}

/// Chooses gaits online: the gait is chosen again many times a second, from any state.
///
/// Parameters
/// ----------
/// robot : Robot
/// terrain : Terrain
/// settings : dict, optional
///     ``horizon`` (s, default 0.8, on soles 1.2), ``candidates`` (16), ``families`` (names; by default all of the robot),
///     ``change_durations`` (True), ``iterations`` (20), ``optimise_iterations`` (4), ``hysteresis`` (0.05), ``spread`` (0.15), ``latency``
///     (s, 0), ``deadline`` (s, by default none), ``reach_margin`` (base heights, 0.03), ``threads`` (0: one per processor), ``seed`` (1),
///     ``cost`` (weights).
#[pyclass(frozen, module = "cregopt")]
pub struct Planner(Mutex<crate::planner::Planner>);

#[pymethods]
impl Planner {
    #[new]
    #[pyo3(signature = (robot, terrain, settings = None))]
    fn new(robot: &Robot, terrain: &Terrain, settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let settings: PlannerSettings = settings.map_or_else(|| Ok(PlannerSettings::default()), |s| from_python(s, "settings"))?;
        crate::planner::Planner::new(robot.robot.clone(), terrain.0.clone(), settings).map(|p| Planner(Mutex::new(p))).raise()
    }

    /// Chooses a gait and plans its motion from a state.
    ///
    /// Parameters
    /// ----------
    /// state : RobotState
    /// command : tuple of float
    ///     Velocity forward and to the left, m/s, and yaw rate, rad/s, in the horizontal axes of the base.
    /// now : float
    ///     Time of the state, s, on any clock that does not go back.
    ///
    /// Returns
    /// -------
    /// Update
    ///
    /// Raises
    /// ------
    /// Error
    ///     For a state out of range, and if no candidate holds and there is no plan before.
    fn update(&self, py: Python<'_>, state: &RobotState, command: [f64; 3], now: f64) -> PyResult<Update> {
        let [x, y, yaw_rate] = command;
        let command = Command { velocity: [x, y], yaw_rate };
        let update = py.detach(|| locked(&self.0).update(&state.0, &command, now)).raise()?;
        let crate::planner::Update { plan, renewed, stretched, solved, candidates, iterations, seconds } = update;
        Ok(Update { plan: Py::new(py, Plan(plan))?, renewed, stretched, solved, candidates, iterations, seconds })
    }

    /// Replaces the terrain, for example by a map as the robot sees it now.
    fn set_terrain(&self, terrain: &Terrain) -> PyResult<()> {
        locked(&self.0).set_terrain(terrain.0.clone()).raise()
    }
}
