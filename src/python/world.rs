//! Robots, terrains and tasks.

use super::convert::{Raise, from_python, place, raised, to_python};
use super::motion::Trajectory;
use super::search::Gait;
use crate::cli::args;
use crate::cli::scenario_file::{Start, of_state};
use crate::error::Error;
use crate::report::files;
use crate::task::Goal;
use crate::terrain::import::{Placement, terrain_of_heights};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::Arc;

/// A legged robot as the solver sees it: a rigid body with feet that reach inside boxes.
///
/// Parameters
/// ----------
/// name : str
///     A built-in robot (``cregopt.ROBOTS``), or the path of a JSON file.
///
/// Notes
/// -----
/// The base frame sits in the centre of mass: x forward, y left, z up. Units are SI.
#[pyclass(frozen, eq, module = "cregopt")]
#[derive(PartialEq)]
pub struct Robot(pub Arc<crate::Robot>);

#[pymethods]
impl Robot {
    #[new]
    fn new(name: &str) -> PyResult<Self> {
        args::robot(name).map(Robot).raise()
    }

    /// Reads a robot from a JSON file.
    #[staticmethod]
    fn from_file(path: PathBuf) -> PyResult<Self> {
        files::read(&path).and_then(|text| crate::Robot::from_json(&text).map_err(|e| e.in_file(&path, None))).raise().map(Robot::of)
    }

    /// A robot from a dictionary with the keys of a robot file.
    #[staticmethod]
    fn from_dict(description: &Bound<'_, PyDict>) -> PyResult<Self> {
        let robot: crate::Robot = from_python(description, "robot")?;
        robot.validate().raise()?;
        Ok(Robot::of(robot))
    }

    /// The description, with the keys of a robot file.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &*self.0)
    }

    /// Name, used in results.
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    /// Mass, kg.
    #[getter]
    fn mass(&self) -> f64 {
        self.0.mass
    }

    /// Number of feet.
    #[getter]
    fn feet(&self) -> usize {
        self.0.feet()
    }

    /// Nominal positions of the feet, base frame, m, shape (feet, 3).
    #[getter]
    fn nominal_feet<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let numbers = self.0.nominal_feet.iter().flatten().copied().collect();
        PyArray1::from_vec(py, numbers).reshape([self.0.feet(), 3])
    }

    fn __repr__(&self) -> String {
        format!("Robot({:?}, {} kg, {} feet)", self.0.name, self.0.mass, self.0.feet())
    }
}

impl Robot {
    fn of(robot: crate::Robot) -> Robot {
        Robot(Arc::new(robot))
    }
}

/// The ground: heights over (x, y), and its friction.
///
/// Parameters
/// ----------
/// name : str, default "flat"
///     A built-in terrain (``cregopt.TERRAINS``), or the path of a JSON file.
/// friction : float, optional
///     Friction coefficient instead of its own.
#[pyclass(frozen, eq, module = "cregopt")]
#[derive(PartialEq)]
pub struct Terrain(pub Arc<crate::Terrain>);

#[pymethods]
impl Terrain {
    #[new]
    #[pyo3(signature = (name = "flat", friction = None))]
    fn new(name: &str, friction: Option<f64>) -> PyResult<Self> {
        let terrain = args::terrain(name).raise()?;
        let Some(friction) = friction else { return Ok(Terrain(terrain)) };
        Terrain::of(crate::Terrain { friction, ..(*terrain).clone() })
    }

    /// Reads a terrain from a JSON file.
    #[staticmethod]
    fn from_file(path: PathBuf) -> PyResult<Self> {
        let read = files::read(&path).and_then(|text| crate::Terrain::from_json(&text).map_err(|e| e.in_file(&path, None)));
        read.raise().and_then(Terrain::of)
    }

    /// A terrain from a dictionary with the keys of a terrain file.
    #[staticmethod]
    fn from_dict(description: &Bound<'_, PyDict>) -> PyResult<Self> {
        Terrain::of(from_python(description, "terrain")?)
    }

    /// A terrain from a height map.
    ///
    /// Parameters
    /// ----------
    /// z : array_like, shape (n, m)
    ///     Heights, m: ``z[i, j]`` stands at ``x = origin[0] + i * cell``, ``y = origin[1] + j * cell``. What is not a finite number is a hole,
    ///     in which nothing can stand.
    /// cell : float
    ///     Distance of samples, m.
    /// origin : tuple of float, default (0, 0)
    ///     Where the first sample stands (x, y), m. Robots start at (0, 0) unless told otherwise.
    /// friction : float, default 0.8
    ///     Friction coefficient.
    /// name : str, default "heights"
    ///     Name, used in results.
    #[staticmethod]
    #[pyo3(signature = (z, cell, origin = [0., 0.], friction = 0.8, name = "heights"))]
    fn heights(z: &Bound<'_, PyAny>, cell: f64, origin: [f64; 2], friction: f64, name: &str) -> PyResult<Self> {
        let array = z.py().import("numpy")?.call_method1("asarray", (z, "float64"))?;
        let Ok(array) = array.cast::<PyArray2<f64>>() else {
            let dimensions: usize = array.getattr("ndim")?.extract()?;
            return Err(raised(Error::invalid("height map", format!("{dimensions} dimensions"), "2: x and y")));
        };
        let columns = array.shape()[1];
        let numbers: Vec<f64> = array.readonly().as_array().iter().copied().collect();
        let heights = if columns == 0 { Vec::new() } else { numbers.chunks(columns).map(<[f64]>::to_vec).collect() };
        let placement = Placement { cell, origin, height_scale: 1., friction };
        terrain_of_heights(name.into(), heights, &placement).raise().and_then(|imported| Terrain::of(imported.terrain))
    }

    /// The description, with the keys of a terrain file.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &*self.0)
    }

    /// Name, used in results.
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    /// Friction coefficient.
    #[getter]
    fn friction(&self) -> f64 {
        self.0.friction
    }

    /// Height at (x, y), m.
    fn height(&self, x: f64, y: f64) -> f64 {
        self.0.height(x, y)
    }

    fn __repr__(&self) -> String {
        format!("Terrain({:?}, friction {})", self.0.name, self.0.friction)
    }
}

impl Terrain {
    fn of(terrain: crate::Terrain) -> PyResult<Terrain> {
        terrain.validate().raise()?;
        Ok(Terrain(Arc::new(terrain)))
    }
}

/// What is to be done: how the robot stands at first, and where its base is to be at the end.
///
/// Parameters
/// ----------
/// robot : Robot
/// terrain : Terrain
/// goal : (x, y), (x, y, z) or dict
///     Where the base is to end, world frame, m. Without z as high above the ground as the robot's ``base_height``, or as its feet reach. A
///     dictionary has the keys of ``[goal]`` in a scenario file: ``xy``, ``z``, ``yaw``, ``tilt``, ``velocity``, ``rates``.
/// yaw : float, optional
///     Yaw at the end, rad; 0, or that of the dictionary.
/// start : (x, y), (x, y, z), dict, Trajectory or Gait, optional
///     Where the base starts, above the origin by default, with the feet at their nominal places. A dictionary has the keys of ``[start]`` in
///     a scenario file, ``feet`` among them. After a motion: where that ends, with base and feet as they are then.
/// start_yaw : float, optional
///     Yaw at the start, rad; 0, or that of the dictionary.
/// force_limit : float, optional
///     Largest normal force of a foot, N; the robot's by default.
#[pyclass(frozen, module = "cregopt")]
pub struct Task(pub Arc<crate::Task>);

#[pymethods]
impl Task {
    #[new]
    #[pyo3(signature = (robot, terrain, goal, yaw = None, start = None, start_yaw = None, force_limit = None))]
    fn new(
        robot: &Robot,
        terrain: &Terrain,
        goal: &Bound<'_, PyAny>,
        yaw: Option<f64>,
        start: Option<&Bound<'_, PyAny>>,
        start_yaw: Option<f64>,
        force_limit: Option<f64>,
    ) -> PyResult<Self> {
        let goal: Goal = if goal.is_instance_of::<PyDict>() { from_python(goal, "goal")? } else { on_ground(goal, "goal")? };
        let goal = goal.yaw(yaw.unwrap_or(goal.yaw));
        let (robot, terrain) = (robot.0.clone(), terrain.0.clone());
        let start = match start {
            None => Start::default(),
            Some(start) => {
                let motion = start.cast::<Gait>().map(|gait| gait.get().motion()).ok();
                let motion = motion.or_else(|| start.cast::<Trajectory>().map(|motion| motion.get().motion.clone()).ok());
                if let Some(motion) = motion {
                    if let Some(yaw) = start_yaw {
                        return Err(raised(Error::invalid("start_yaw", yaw, "left out where the start is the end of a motion")));
                    }
                    let task = crate::Task::between(robot, terrain, goal, goal).and_then(|task| task.after(&motion));
                    return Task::of(crate::Task { force_limit, ..task.raise()? });
                }
                if start.is_instance_of::<PyDict>() { from_python(start, "start")? } else { Start::at(on_ground(start, "start")?) }
            }
        };
        let start = Start { yaw: start_yaw.unwrap_or(start.yaw), ..start };
        Task::of(start.task(robot, terrain, goal, force_limit).raise()?)
    }

    /// The robot.
    #[getter]
    fn robot(&self) -> Robot {
        Robot(self.0.robot.clone())
    }

    /// The ground.
    #[getter]
    fn terrain(&self) -> Terrain {
        Terrain(self.0.terrain.clone())
    }

    /// State at the start, with the keys of ``[start]`` in a scenario file.
    #[getter]
    fn start<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &Start::in_state(&self.0.start, &self.0.start_feet))
    }

    /// State that is asked for at the end, with the keys of ``[goal]`` in a scenario file.
    #[getter]
    fn goal<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &of_state(&self.0.goal))
    }

    /// Largest normal force of a foot, N, if it was given.
    #[getter]
    fn force_limit(&self) -> Option<f64> {
        self.0.force_limit
    }

    fn __repr__(&self) -> String {
        let [from, to] = [&self.0.start, &self.0.goal].map(|state| state.position);
        format!("Task({:?} on {:?}, from {from:?} to {to:?} m)", self.0.robot.name, self.0.terrain.name)
    }
}

impl Task {
    fn of(task: crate::Task) -> PyResult<Task> {
        task.validate().raise()?;
        Ok(Task(Arc::new(task)))
    }
}

/// A place as two or three numbers say it.
fn on_ground(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Goal> {
    let ([x, y], z) = place(value, name)?;
    Ok(Goal { z, ..Goal::at(x, y) })
}
