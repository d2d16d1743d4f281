//! Robots, terrains and tasks.

use super::convert::{Raise, from_python, place, raised, to_python};
use super::motion::Trajectory;
use super::search::Gait;
use crate::cli::args;
use crate::cli::leg::Way;
use crate::cli::scenario_file::{ScenarioFile, Start, of_state};
use crate::cli::solve::Solve;
use crate::error::Error;
use crate::files;
use crate::robot::import::{Import, Imported};
use crate::scenario::Scenario;
use crate::task::Goal;
use crate::terrain::import::{Placement, terrain_of_heights};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;
use std::ffi::CString;
use std::path::PathBuf;
use std::sync::Arc;

/// A legged robot as the solver sees it: a rigid body with feet that reach inside boxes.
///
/// Parameters
/// ----------
/// name : str
///     A built-in robot (``cregopt.ROBOTS``), or the path of a JSON or TOML file.
///
/// Notes
/// -----
/// The base frame sits in the centre of mass: x forward, y left, z up. Units are SI.
#[pyclass(frozen, eq, module = "cregopt")]
pub struct Robot {
    /// As the solver sees it.
    pub robot: Arc<crate::Robot>,
    /// What its URDF says besides, where it came from one.
    import: Option<Box<Imported>>,
}

impl PartialEq for Robot {
    fn eq(&self, other: &Robot) -> bool {
        self.robot == other.robot
    }
}

#[pymethods]
impl Robot {
    #[new]
    fn new(name: &str) -> PyResult<Self> {
        args::robot(name).map(Robot::of).raise()
    }

    /// Reads a robot from a JSON or TOML file.
    #[staticmethod]
    fn from_file(path: PathBuf) -> PyResult<Self> {
        crate::Robot::read(&path).map(Robot::of).raise()
    }

    /// A robot from a URDF, as ``cregopt robot import`` makes it: mass, inertia, feet, their reach, what the joints bear, and the joints.
    ///
    /// All of it holds in one configuration of the joints. ``imported`` of the robot says what was computed and guessed.
    ///
    /// Parameters
    /// ----------
    /// source : path or str
    ///     A URDF file, or the text of one, which begins with ``<``; meshes are not needed.
    /// feet : list of str, optional
    ///     Links of the feet; else those that stand on the ground in the configuration.
    /// configuration : dict of str to float, optional
    ///     Joint values in which it stands, rad or m; the others are at zero, or in the middle of their limits when zero is outside. Without any, legs
    ///     are bent so that the robot stands.
    /// name : str, optional
    ///     Name of the robot; the file's by default, with ``-imported`` behind it where a built-in robot has that.
    ///
    /// Raises
    /// ------
    /// Error
    ///     For text that is no XML, and a model that is no legged robot: names the file and the place in it.
    #[staticmethod]
    #[pyo3(signature = (source, feet = None, configuration = None, name = None))]
    fn from_urdf(
        py: Python<'_>,
        source: &Bound<'_, PyAny>,
        feet: Option<Vec<String>>,
        configuration: Option<&Bound<'_, PyDict>>,
        name: Option<String>,
    ) -> PyResult<Self> {
        let pairs = configuration.map(|given| given.iter().map(|(joint, value)| Ok((joint.extract()?, value.extract()?))).collect());
        let configuration = pairs.transpose().map_err(|_: PyErr| {
            let shown = configuration.and_then(|given| given.repr().ok()).map_or_else(String::new, |text| text.to_string());
            raised(Error::invalid("configuration", shown, "values of joints by their names, in rad or m"))
        })?;
        let import = Import { feet: feet.unwrap_or_default(), configuration: configuration.unwrap_or_default(), name };
        let text = source.extract::<String>().ok().filter(|text| text.trim_start_matches('\u{feff}').trim_start().starts_with('<'));
        let imported = match text {
            Some(text) => py.detach(|| import.urdf(text.trim_start_matches('\u{feff}'))),
            None => {
                let path: PathBuf = source.extract()?;
                py.detach(|| import.urdf_file(&path))
            }
        };
        let imported = imported.raise()?;
        Ok(Robot { robot: Arc::new(imported.robot.clone()), import: Some(Box::new(imported)) })
    }

    /// A robot from a dictionary with the keys of a robot file.
    #[staticmethod]
    fn from_dict(description: &Bound<'_, PyDict>) -> PyResult<Self> {
        let robot: crate::Robot = from_python(description, "robot")?;
        robot.validate_own().raise()?;
        Ok(Robot::of(robot))
    }

    /// A robot that there is already, for copies in other processes: where the reason of a failure is looked for, a built-in robot reaches farther.
    #[staticmethod]
    fn _again(description: &Bound<'_, PyDict>) -> PyResult<Self> {
        let robot: crate::Robot = from_python(description, "robot")?;
        robot.validate().raise()?;
        Ok(Robot::of(robot))
    }

    /// The description, with the keys of a robot file.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &*self.robot)
    }

    /// Writes a robot file: .json or .toml.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        self.robot.file_text(&path).and_then(|text| files::write(&path, &text)).raise()
    }

    /// What the import from a URDF found besides; None for other robots.
    ///
    /// Keys: ``center_of_mass`` (x, y, z in the root link, m), ``feet`` (of each the name of its ``link`` and where that has its origin from the centre
    /// of mass, ``frame``, m), ``foot_speed`` (which every foot has along x and y at the limits of its joints, m/s, or None), ``configuration`` (value
    /// of every joint that moves, rad or m) and ``notes`` (what was guessed, left out or looks odd, as sentences).
    #[getter]
    fn imported<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let Some(import) = &self.import else { return Ok(None) };
        let feet: Vec<_> = import.feet.iter().map(|foot| json!({"link": foot.link, "frame": foot.frame})).collect();
        let configuration: serde_json::Map<_, _> = import.configuration.iter().map(|(name, value)| (name.clone(), json!(value))).collect();
        let Imported { center_of_mass, foot_speed, notes, .. } = &**import;
        let found = json!({
            "center_of_mass": center_of_mass, "feet": feet, "foot_speed": foot_speed, "configuration": configuration, "notes": notes,
        });
        to_python(py, &found).map(Some)
    }

    /// Name, used in results.
    #[getter]
    fn name(&self) -> &str {
        &self.robot.name
    }

    /// Mass, kg.
    #[getter]
    fn mass(&self) -> f64 {
        self.robot.mass
    }

    /// Number of feet.
    #[getter]
    fn feet(&self) -> usize {
        self.robot.feet()
    }

    /// Nominal positions of the feet, base frame, m, shape (feet, 3).
    #[getter]
    fn nominal_feet<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let numbers = self.robot.nominal_feet.iter().flatten().copied().collect();
        PyArray1::from_vec(py, numbers).reshape([self.robot.feet(), 3])
    }

    fn __repr__(&self) -> String {
        format!("Robot({:?}, {} kg, {} feet)", self.robot.name, self.robot.mass, self.robot.feet())
    }
}

impl Robot {
    fn of(robot: impl Into<Arc<crate::Robot>>) -> Robot {
        Robot { robot: robot.into(), import: None }
    }
}

/// The ground: heights over (x, y), and its friction.
///
/// Parameters
/// ----------
/// name : str, default "flat"
///     A built-in terrain (``cregopt.TERRAINS``), or the path of a JSON or TOML file.
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

    /// Reads a terrain from a JSON or TOML file.
    #[staticmethod]
    fn from_file(path: PathBuf) -> PyResult<Self> {
        crate::Terrain::read(&path).map(|terrain| Terrain(Arc::new(terrain))).raise()
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

    /// Height at (x, y) of the world frame, m; holes of a height map are deep.
    fn height(&self, x: f64, y: f64) -> f64 {
        self.0.height(x, y)
    }

    fn __repr__(&self) -> String {
        format!("Terrain({:?}, friction {})", self.0.name, self.0.friction)
    }
}

impl Terrain {
    fn of(terrain: crate::Terrain) -> PyResult<Terrain> {
        terrain.validate_own().raise()?;
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
/// via : list of (x, y), (x, y, z) or dict, optional
///     Places on the way at which the base is to stop, in order, as ``goal`` has them. The yaw of a dictionary is its own; without one it is on the
///     way from the start's to the goal's. Each place is the end of a leg, which has a gait of its own: see ``Gait.legs``.
///
/// Raises
/// ------
/// Error
///     For a value that cannot be. Whether a gait can get there is asked by ``cregopt.search``.
#[pyclass(frozen, module = "cregopt")]
pub struct Task(pub Arc<Way>);

#[pymethods]
impl Task {
    #[new]
    #[pyo3(signature = (robot, terrain, goal, yaw = None, start = None, start_yaw = None, force_limit = None, via = None))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        py: Python<'_>,
        robot: &Robot,
        terrain: &Terrain,
        goal: &Bound<'_, PyAny>,
        yaw: Option<f64>,
        start: Option<&Bound<'_, PyAny>>,
        start_yaw: Option<f64>,
        force_limit: Option<f64>,
        via: Option<Vec<Bound<'_, PyAny>>>,
    ) -> PyResult<Self> {
        let (goal, _) = end(goal, "goal")?;
        let goal = goal.yaw(yaw.unwrap_or(goal.yaw));
        if let Some(doubt) = args::in_degrees(goal.yaw) {
            PyErr::warn(py, &py.get_type::<PyUserWarning>(), &CString::new(doubt)?, 1)?;
        }
        let places = via.unwrap_or_default().into_iter().enumerate().map(|(i, place)| end(&place, &format!("via[{i}]")));
        let places: Vec<(Goal, bool)> = places.collect::<PyResult<_>>()?;
        let task = from(start, start_yaw, robot.robot.clone(), terrain.0.clone(), goal, force_limit)?;
        task.validate().raise()?;
        for (i, &(place, _)) in places.iter().enumerate() {
            task.to(place).map_err(|e| e.within(format_args!("via[{i}]"))).raise()?;
        }
        Ok(Task(Arc::new(Way { task, places, named: (None, None) })))
    }

    /// The task of a scenario; what else its file asks, such as seed and gaits, is for ``cregopt.solve``.
    ///
    /// Parameters
    /// ----------
    /// scenario : path or str
    ///     A scenario file (.toml), as ``cregopt init`` writes one, or a built-in scenario (``cregopt.SCENARIOS``).
    /// target : int, optional
    ///     Target of a built-in scenario, 1 to 20; else the file's, or 10.
    #[staticmethod]
    #[pyo3(signature = (scenario, target = None))]
    fn from_scenario(scenario: PathBuf, target: Option<usize>) -> PyResult<Self> {
        let way = |file: ScenarioFile| Solve::default().at_target(target).over(file)?.way();
        let is_file = scenario.extension().is_some() || scenario.components().count() != 1 || scenario.exists();
        // A built-in name is one, whatever files there are.
        let way = match Scenario::named(&scenario.to_string_lossy()) {
            Ok(built_in) => way(ScenarioFile { scenario: Some(built_in.name.into()), ..ScenarioFile::default() }),
            Err(_) if is_file => ScenarioFile::read(&scenario).and_then(|file| way(file).map_err(|e| e.in_file(&scenario, None))),
            Err(unknown) => Err(unknown),
        };
        way.map(|way| Task(Arc::new(way))).raise()
    }

    /// The robot.
    #[getter]
    fn robot(&self) -> Robot {
        Robot::of(self.0.task.robot.clone())
    }

    /// The ground.
    #[getter]
    fn terrain(&self) -> Terrain {
        Terrain(self.0.task.terrain.clone())
    }

    /// State at the start, with the keys of ``[start]`` in a scenario file.
    #[getter]
    fn start<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &Start::in_state(&self.0.task.start, &self.0.task.start_feet))
    }

    /// State that is asked for at the end, with the keys of ``[goal]`` in a scenario file.
    #[getter]
    fn goal<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &of_state(&self.0.task.goal))
    }

    /// Places on the way, with the keys of ``[[waypoints]]`` in a scenario file; those without a ``yaw`` have it on the way.
    #[getter]
    fn via<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let place = |(goal, turns_evenly): &(Goal, bool)| {
            let place = to_python(py, goal)?;
            if *turns_evenly {
                place.del_item("yaw")?;
            }
            Ok(place)
        };
        self.0.places.iter().map(place).collect()
    }

    /// Largest normal force of a foot, N, if it was given.
    #[getter]
    fn force_limit(&self) -> Option<f64> {
        self.0.task.force_limit
    }

    /// Built-in scenario and its target (1 to 20) that it was named by, each None where it was not.
    #[getter]
    fn scenario(&self) -> (Option<&str>, Option<usize>) {
        self.0.named
    }

    /// The same with a name, for copies in other processes.
    fn _named(&self, scenario: &str, target: Option<usize>) -> PyResult<Task> {
        let name = Scenario::named(scenario).raise()?.name;
        Ok(Task(Arc::new(Way { named: (Some(name), target), ..(*self.0).clone() })))
    }

    fn __repr__(&self) -> String {
        let task = &self.0.task;
        let [from, to] = [&task.start, &task.goal].map(|state| state.position);
        let via = if self.0.places.is_empty() { String::new() } else { format!(" over {} places", self.0.places.len()) };
        format!("Task({:?} on {:?}, from {from:?} to {to:?} m{via})", task.robot.name, task.terrain.name)
    }
}

/// The task of going to a goal from a start of any kind.
fn from(
    start: Option<&Bound<'_, PyAny>>,
    start_yaw: Option<f64>,
    robot: Arc<crate::Robot>,
    terrain: Arc<crate::Terrain>,
    goal: Goal,
    force_limit: Option<f64>,
) -> PyResult<crate::Task> {
    let start = match start {
        None => Start::default(),
        Some(start) => {
            let motion = start.cast::<Gait>().map(|gait| gait.get().motion()).ok();
            let motion = motion.or_else(|| start.cast::<Trajectory>().map(|motion| motion.get().motion.clone()).ok());
            if let Some(motion) = motion {
                if let Some(yaw) = start_yaw {
                    return Err(raised(Start::turned_after(yaw)));
                }
                let task = crate::Task::between(robot, terrain, goal, goal).and_then(|task| task.after(&motion));
                return Ok(crate::Task { force_limit, ..task.raise()? });
            }
            if start.is_instance_of::<PyDict>() { from_python(start, "start")? } else { Start::at(end(start, "start")?.0) }
        }
    };
    start.turned(start_yaw).and_then(|start| start.task(robot, terrain, goal, force_limit)).raise()
}

/// An end or a place on the way, as a dictionary or two or three numbers say it, and whether it leaves its yaw open.
fn end(value: &Bound<'_, PyAny>, name: &str) -> PyResult<(Goal, bool)> {
    if let Ok(keys) = value.cast::<PyDict>() {
        return Ok((from_python(value, name)?, !keys.contains("yaw")?));
    }
    let ([x, y], z) = place(value, name)?;
    Ok((Goal { z, ..Goal::at(x, y) }, true))
}
