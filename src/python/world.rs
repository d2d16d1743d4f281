//! Robots, terrains and tasks.

use super::convert::{Raise, from_python, place, raised, to_python};
use super::motion::Trajectory;
use super::search::Gait;
use crate::app::label::Provenance;
use crate::app::scenario_file::{ScenarioFile, Start, of_state};
use crate::app::world::yaw_warning;
use crate::app::{Mission, Overrides, Setup, Waypoint, named};
use crate::error::Error;
use crate::files;
use crate::robot::import::{Import, Imported, Soles};
use crate::scenario::Scenario;
use crate::task::Goal;
use crate::terrain::import::{self, Placement, terrain_of_heights};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyUserWarning};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;
use std::ffi::CString;
use std::path::PathBuf;
use std::sync::Arc;

/// Legged robot as the solver models it: a rigid body with feet that reach inside boxes and slabs.
///
/// Parameters
/// ----------
/// name : str
///     Built-in robot (``cregopt.ROBOTS``), or path of a JSON or TOML file.
///
/// Notes
/// -----
/// The origin of the base frame is the centre of mass: x forward, y left, z up. Units are SI.
#[pyclass(frozen, eq, module = "cregopt")]
pub struct Robot {
    /// Model of the solver.
    pub robot: Arc<crate::Robot>,
    /// Further data from its URDF, if it was imported.
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
        named::robot(name).map(Robot::of).raise()
    }

    /// Reads a robot from a JSON or TOML file.
    #[staticmethod]
    fn from_file(path: PathBuf) -> PyResult<Self> {
        crate::Robot::read(&path).map(Robot::of).raise()
    }

    /// Imports a robot from a URDF, as ``cregopt robot import`` does: mass, inertia, feet, their reach, forces that the joints bear, and
    /// the joints.
    ///
    /// All values hold in one configuration of the joints. ``imported`` lists computed and guessed values.
    ///
    /// Parameters
    /// ----------
    /// source : path or str
    ///     URDF file, or its text, which begins with ``<``; meshes are not needed.
    /// feet : list of str, optional
    ///     Links of the feet; by default those on the ground in the configuration.
    /// configuration : dict of str to float, optional
    ///     Joint values in which the robot stands, rad or m. Other joints are at zero, or in the middle of their limits if zero is outside.
    ///     Without values, the legs are bent so that the robot stands.
    /// name : str, optional
    ///     Name of the robot; by default the name in the file, with ``-imported`` appended if a built-in robot has it.
    /// sole : str or tuple of float, optional
    ///     Soles of the feet: ``"none"`` (points or balls), or length and width, m; by default ``"auto"``, the flat lower sides of the
    ///     collision shapes if the legs have six joints.
    ///
    /// Raises
    /// ------
    /// Error
    ///     For text that is not XML, and a model that is not a legged robot. The error names the file and the place in it.
    #[staticmethod]
    #[pyo3(signature = (source, feet = None, configuration = None, name = None, sole = None))]
    fn from_urdf(
        py: Python<'_>,
        source: &Bound<'_, PyAny>,
        feet: Option<Vec<String>>,
        configuration: Option<&Bound<'_, PyDict>>,
        name: Option<String>,
        sole: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        imported(py, source, options(feet, configuration, name, sole)?, Import::urdf)
    }

    /// Imports a robot from an MJCF file, the format of MuJoCo, as ``cregopt robot import`` does, without MuJoCo.
    ///
    /// As ``from_urdf``: links are bodies. Joints have no speed limits; their torques are those of the motors. Without a configuration the
    /// robot stands as in the keyframe ``home``, or else the first one; without a keyframe, and on soles, on bent legs. Only a file may
    /// include other files.
    ///
    /// Raises
    /// ------
    /// Error
    ///     As ``from_urdf``; also for a body whose mass is only in a mesh.
    #[staticmethod]
    #[pyo3(signature = (source, feet = None, configuration = None, name = None, sole = None))]
    fn from_mjcf(
        py: Python<'_>,
        source: &Bound<'_, PyAny>,
        feet: Option<Vec<String>>,
        configuration: Option<&Bound<'_, PyDict>>,
        name: Option<String>,
        sole: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        imported(py, source, options(feet, configuration, name, sole)?, Import::mjcf)
    }

    /// Makes a robot from a dictionary with the keys of a robot file.
    #[staticmethod]
    fn from_dict(description: &Bound<'_, PyDict>) -> PyResult<Self> {
        let robot: crate::Robot = from_python(description, "robot")?;
        robot.validate_own().raise()?;
        Ok(Robot::of(robot))
    }

    /// Copy of an existing robot in another process. Unlike in ``from_dict``, it may have the name of a built-in robot with a larger reach,
    /// which the diagnosis of a failure uses.
    #[staticmethod]
    fn _again(description: &Bound<'_, PyDict>) -> PyResult<Self> {
        let robot: crate::Robot = from_python(description, "robot")?;
        robot.validate().raise()?;
        Ok(Robot::of(robot))
    }

    /// Dictionary with the keys of a robot file.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &*self.robot)
    }

    /// Writes a robot file: .json or .toml.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        self.robot.file_text(&path).and_then(|text| files::write(&path, &text)).raise()
    }

    /// Further results of the import; None for other robots.
    ///
    /// Keys: ``center_of_mass`` (x, y, z in the root link, m), ``feet`` (for each the name of its ``link`` and ``frame``, the origin of
    /// that link relative to the centre of mass, m), ``foot_speed`` (speed that every foot reaches along x and y at the limits of its
    /// joints, m/s, or None), ``configuration`` (value of every joint that moves, rad or m) and ``notes`` (sentences on guesses, omissions
    /// and oddities).
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

/// Ground: heights over (x, y), and friction.
///
/// Parameters
/// ----------
/// name : str, default "flat"
///     Built-in terrain (``cregopt.TERRAINS``), or path of a JSON or TOML file, of a mesh (.obj, .ply) or of a grid map (.mcap).
/// friction : float, optional
///     Friction coefficient that replaces the terrain's.
#[pyclass(frozen, eq, module = "cregopt")]
#[derive(PartialEq)]
pub struct Terrain(pub Arc<crate::Terrain>);

#[pymethods]
impl Terrain {
    #[new]
    #[pyo3(signature = (name = "flat", friction = None))]
    fn new(name: &str, friction: Option<f64>) -> PyResult<Self> {
        let terrain = named::terrain(name).raise()?;
        let Some(friction) = friction else { return Ok(Terrain(terrain)) };
        Terrain::of(crate::Terrain { friction, ..(*terrain).clone() })
    }

    /// Reads a terrain from a JSON or TOML file, a mesh (.obj, .ply) or a grid map (.mcap).
    #[staticmethod]
    fn from_file(path: PathBuf) -> PyResult<Self> {
        crate::Terrain::read(&path).map(|terrain| Terrain(Arc::new(terrain))).raise()
    }

    /// Imports a map or a mesh, as ``cregopt terrain import`` does. Places without a known height are holes, which admit no foothold.
    ///
    /// Parameters
    /// ----------
    /// path : path
    ///     ``.csv``, ``.npy`` (``z[i, j]`` as in ``heights``), ``.png`` (grey, x to the right, y up), ``.obj``, ``.ply`` (m, z up), or
    ///     ``.mcap`` with messages ``grid_map_msgs/msg/GridMap``.
    /// name : str, optional
    ///     Name, used in results; by default that of the file.
    /// cell : float, optional
    ///     Distance between samples, m; needed for ``.csv``, ``.npy`` and ``.png``. By default that of a grid map, or 1/200 of the longer side
    ///     of a mesh, rounded down.
    /// origin : tuple of float, optional
    ///     Position of the first sample (x, y), m; by default that of a mesh or grid map, otherwise (0, 0).
    /// height_scale : float, default 1
    ///     Factor on heights; for a picture the height of white, m.
    /// friction : float, default 0.8
    ///     Friction coefficient.
    /// layer : str, optional
    ///     Layer of a grid map, by default ``"elevation"``.
    /// topic : str, optional
    ///     Topic of a grid map, whose last message is read; by default the only one.
    #[staticmethod]
    #[pyo3(
        signature = (path, name = None, **placement),
        text_signature = "(path, name=None, *, cell=None, origin=None, height_scale=1.0, friction=0.8, layer=None, topic=None)"
    )]
    fn from_map(path: PathBuf, name: Option<&str>, placement: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let placement: Placement = placement.map_or_else(|| Ok(Placement::default()), |given| from_python(given, "from_map"))?;
        import::read(&path, &placement, name).raise().and_then(|imported| Terrain::of(imported.terrain))
    }

    /// Makes a terrain from a dictionary with the keys of a terrain file.
    #[staticmethod]
    fn from_dict(description: &Bound<'_, PyDict>) -> PyResult<Self> {
        Terrain::of(from_python(description, "terrain")?)
    }

    /// Makes a terrain from a height map.
    ///
    /// Parameters
    /// ----------
    /// z : array_like, shape (n, m)
    ///     Heights, m: ``z[i, j]`` is at ``x = origin[0] + i * cell``, ``y = origin[1] + j * cell``. Values that are not finite are holes,
    ///     which admit no foothold.
    /// cell : float
    ///     Distance between samples, m.
    /// origin : tuple of float, default (0, 0)
    ///     Position of the first sample (x, y), m. Robots start at (0, 0) by default.
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
        let placement = Placement { cell: Some(cell), origin: Some(origin), friction, ..Placement::default() };
        terrain_of_heights(name.into(), heights, &placement).raise().and_then(|imported| Terrain::of(imported.terrain))
    }

    /// Dictionary with the keys of a terrain file.
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

    /// Height at (x, y) in the world frame, m; holes of a height map are deep.
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

/// Task: start of the robot, goal of its base, and waypoints.
///
/// Parameters
/// ----------
/// robot : Robot
/// terrain : Terrain
/// goal : (x, y), (x, y, z) or dict
///     Goal of the base, world frame, m. Without z, the base ends at the robot's ``base_height`` above the ground, or at a height from
///     which all feet reach it. A dictionary has the keys of ``[goal]`` in a scenario file: ``xy``, ``z``, ``yaw``, ``tilt``, ``velocity``,
///     ``rates``, and ``time``, the time of arrival in s from the start of the task.
/// yaw : float, optional
///     Yaw at the goal, rad; by default that of the dictionary, or 0.
/// start : (x, y), (x, y, z), dict, Trajectory or Gait, optional
///     Start of the base, by default above the origin, with the feet at their nominal places. A dictionary has the keys of ``[start]`` in a
///     scenario file, including ``feet``. A motion stands for its end, with base and feet.
/// start_yaw : float, optional
///     Yaw at the start, rad; by default that of the dictionary, or 0.
/// force_limit : float, optional
///     Largest normal force of a foot, N; the robot's by default.
/// via : list of (x, y), (x, y, z) or dict, optional
///     Waypoints at which the base stops, in order, in the form of ``goal``. Without a yaw in a dictionary, the yaw is interpolated between
///     start and goal. Each waypoint ends a stage, which has a gait of its own: see ``Gait.stages``.
///
/// Raises
/// ------
/// Error
///     For an invalid value. ``cregopt.search`` checks whether a gait can reach the goal.
#[pyclass(frozen, module = "cregopt")]
pub struct Task(pub Arc<Mission>);

#[pymethods]
impl Task {
    #[new]
    #[pyo3(
        signature = (robot, terrain, goal, yaw = None, start = None, start_yaw = None, **more),
        text_signature = "(robot, terrain, goal, yaw=None, start=None, start_yaw=None, *, force_limit=None, via=None)"
    )]
    fn new(
        robot: &Robot,
        terrain: &Terrain,
        goal: &Bound<'_, PyAny>,
        yaw: Option<f64>,
        start: Option<&Bound<'_, PyAny>>,
        start_yaw: Option<f64>,
        more: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let py = goal.py();
        let More { force_limit, via } = More::of(more)?;
        let goal = waypoint(goal, "goal")?.goal;
        let goal = goal.yaw(yaw.unwrap_or(goal.yaw));
        if let Some(warning) = yaw_warning(goal.yaw) {
            PyErr::warn(py, &py.get_type::<PyUserWarning>(), &CString::new(warning)?, 1)?;
        }
        let waypoints = via.iter().enumerate().map(|(i, place)| waypoint(place, &format!("via[{i}]")));
        let waypoints: Vec<Waypoint> = waypoints.collect::<PyResult<_>>()?;
        let place = Place { robot: robot.robot.clone(), terrain: terrain.0.clone(), goal, force_limit };
        let task = place.from(start, start_yaw)?;
        task.validate().raise()?;
        for (i, waypoint) in waypoints.iter().enumerate() {
            task.to(waypoint.goal).map_err(|e| e.within(format_args!("via[{i}]"))).raise()?;
        }
        let mission = Mission { waypoints, ..Mission::new(task) };
        mission.check_times().raise()?;
        Ok(Task(Arc::new(mission)))
    }

    /// Task of a scenario. Other keys of its file, such as seed and gaits, are used by ``cregopt.solve``.
    ///
    /// Parameters
    /// ----------
    /// scenario : path or str
    ///     Scenario file (.toml), as ``cregopt init`` writes one, or a built-in scenario (``cregopt.SCENARIOS``).
    /// target : int, optional
    ///     Target of a built-in scenario, 1 to 20; by default the file's, or 10.
    #[staticmethod]
    #[pyo3(signature = (scenario, target = None))]
    fn from_scenario(scenario: PathBuf, target: Option<usize>) -> PyResult<Self> {
        let mission = |file: ScenarioFile| Setup::new(file, Overrides { target, ..Overrides::default() })?.mission();
        let is_file = scenario.extension().is_some() || scenario.components().count() != 1 || scenario.exists();
        // Built-in names take precedence over files of the same name.
        let mission = match Scenario::named(&scenario.to_string_lossy()) {
            Ok(built_in) => mission(ScenarioFile { scenario: Some(built_in.name.into()), ..ScenarioFile::default() }),
            Err(_) if is_file => ScenarioFile::read(&scenario).and_then(|file| mission(file).map_err(|e| e.in_file(&scenario, None))),
            Err(unknown) => Err(unknown),
        };
        mission.map(|mission| Task(Arc::new(mission))).raise()
    }

    /// Robot.
    #[getter]
    fn robot(&self) -> Robot {
        Robot::of(self.0.task.robot.clone())
    }

    /// Ground.
    #[getter]
    fn terrain(&self) -> Terrain {
        Terrain(self.0.task.terrain.clone())
    }

    /// Start, with the keys of ``[start]`` in a scenario file.
    #[getter]
    fn start<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &Start::in_state(&self.0.task.start, &self.0.task.start_feet))
    }

    /// Goal, with the keys of ``[goal]`` in a scenario file.
    #[getter]
    fn goal<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &Goal { time: self.0.task.duration, ..of_state(&self.0.task.goal) })
    }

    /// Waypoints, with the keys of ``[[waypoints]]`` in a scenario file; those without ``yaw`` have an interpolated yaw.
    #[getter]
    fn via<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let place = |Waypoint { goal, turns_evenly }: &Waypoint| {
            let place = to_python(py, goal)?;
            if *turns_evenly {
                place.del_item("yaw")?;
            }
            Ok(place)
        };
        self.0.waypoints.iter().map(place).collect()
    }

    /// Largest normal force of a foot, N, or None if it was not given.
    #[getter]
    fn force_limit(&self) -> Option<f64> {
        self.0.task.force_limit
    }

    /// Built-in scenario and its target (1 to 20) that the task was named by, each None otherwise.
    #[getter]
    fn scenario(&self) -> (Option<&str>, Option<usize>) {
        (self.0.provenance.scenario, self.0.provenance.target)
    }

    /// Copy with a scenario and target, for other processes.
    fn _named(&self, scenario: &str, target: Option<usize>) -> PyResult<Task> {
        let scenario = Some(Scenario::named(scenario).raise()?.name);
        Ok(Task(Arc::new(Mission { provenance: Provenance { scenario, target }, ..(*self.0).clone() })))
    }

    fn __repr__(&self) -> String {
        let task = &self.0.task;
        let [from, to] = [&task.start, &task.goal].map(|state| state.position);
        let via = match self.0.waypoints.len() {
            0 => String::new(),
            1 => " by 1 waypoint".into(),
            several => format!(" by {several} waypoints"),
        };
        format!("Task({:?} on {:?}, from {from:?} to {to:?} m{via})", task.robot.name, task.terrain.name)
    }
}

/// Keywords of ``Task`` after the common ones.
struct More<'py> {
    force_limit: Option<f64>,
    via: Vec<Bound<'py, PyAny>>,
}

impl<'py> More<'py> {
    fn of(keywords: Option<&Bound<'py, PyDict>>) -> PyResult<More<'py>> {
        let mut more = More { force_limit: None, via: Vec::new() };
        for (name, value) in keywords.into_iter().flatten() {
            match name.extract::<String>()?.as_str() {
                "force_limit" => more.force_limit = value.extract()?,
                "via" => more.via = value.extract::<Option<_>>()?.unwrap_or_default(),
                other => return Err(PyTypeError::new_err(format!("Task() got an unexpected keyword argument '{other}'"))),
            }
        }
        Ok(more)
    }
}

/// Parts of a task apart from its start.
struct Place {
    robot: Arc<crate::Robot>,
    terrain: Arc<crate::Terrain>,
    goal: Goal,
    force_limit: Option<f64>,
}

impl Place {
    /// Task from a start of any kind.
    fn from(self, start: Option<&Bound<'_, PyAny>>, start_yaw: Option<f64>) -> PyResult<crate::Task> {
        let Place { robot, terrain, goal, force_limit } = self;
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
                if start.is_instance_of::<PyDict>() { from_python(start, "start")? } else { Start::at(waypoint(start, "start")?.goal) }
            }
        };
        start.turned(start_yaw).and_then(|start| start.task(robot, terrain, goal, force_limit)).raise()
    }
}

/// Goal or waypoint from a dictionary, or from two or three numbers. Without a yaw, it turns evenly.
fn waypoint(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Waypoint> {
    if let Ok(keys) = value.cast::<PyDict>() {
        return Ok(Waypoint { goal: from_python(value, name)?, turns_evenly: !keys.contains("yaw")? });
    }
    let ([x, y], z) = place(value, name)?;
    Ok(Waypoint { goal: Goal { z, ..Goal::at(x, y) }, turns_evenly: true })
}

/// Options of an import from Python arguments.
fn options(
    feet: Option<Vec<String>>,
    configuration: Option<&Bound<'_, PyDict>>,
    name: Option<String>,
    sole: Option<&Bound<'_, PyAny>>,
) -> PyResult<Import> {
    let soles = match sole {
        None => Soles::Found,
        Some(sole) => match sole.extract::<[f64; 2]>() {
            Ok(size) => Soles::Size(size),
            Err(_) => sole.extract::<String>()?.parse().raise()?,
        },
    };
    let pairs = configuration.map(|given| given.iter().map(|(joint, value)| Ok((joint.extract()?, value.extract()?))).collect());
    let configuration = pairs.transpose().map_err(|_: PyErr| {
        let shown = configuration.and_then(|given| given.repr().ok()).map_or_else(String::new, |text| text.to_string());
        raised(Error::invalid("configuration", shown, "values of joints by their names, in rad or m"))
    })?;
    Ok(Import { feet: feet.unwrap_or_default(), configuration: configuration.unwrap_or_default(), name, soles })
}

/// Imports a robot from a text, which begins with `<`, or from a file.
fn imported(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    import: Import,
    of_text: fn(&Import, &str) -> crate::error::Result<Imported>,
) -> PyResult<Robot> {
    let text = source.extract::<String>().ok();
    let text = text.as_deref().map(|text| text.trim_start_matches('\u{feff}')).filter(|text| text.trim_start().starts_with('<'));
    let imported = match text {
        Some(text) => py.detach(|| of_text(&import, text)),
        None => {
            let path: PathBuf = source.extract()?;
            py.detach(|| import.file(&path))
        }
    };
    let imported = imported.raise()?;
    Ok(Robot { robot: Arc::new(imported.robot.clone()), import: Some(Box::new(imported)) })
}
