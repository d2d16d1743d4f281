//! Motions, their samples and their certificates.

use super::convert::{Raise, from_python, to_python};
use super::joints::Joints;
use super::search::Gait;
use super::world::{Robot, Terrain};
use crate::app::terms::{robot_of, terrain_of};
use crate::app::world::World;
use crate::app::{TermOverrides, VerificationTerms};
use crate::error::Result;
use crate::export::{Format, Sampled};
use crate::files;
use crate::report::samples::{FootSample, Sample, SoleSample};
use crate::verify::Report;
use numpy::{Element, IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Motion with its contact schedule and contact forces, as piecewise cubic curves.
#[pyclass(frozen, eq, module = "cregopt")]
#[derive(PartialEq)]
pub struct Trajectory {
    /// Curves, with robot and ground.
    pub motion: Arc<crate::Trajectory>,
    /// Largest normal force of a foot, N, if it was given apart from the motion.
    pub force_limit: Option<f64>,
}

#[pymethods]
impl Trajectory {
    /// Reads a trajectory from a JSON file.
    #[staticmethod]
    fn from_file(path: PathBuf) -> PyResult<Self> {
        read(&path).map(Trajectory::of).raise()
    }

    /// Makes a trajectory from a dictionary with the keys of a trajectory file.
    #[staticmethod]
    fn from_dict(description: &Bound<'_, PyDict>) -> PyResult<Self> {
        let motion: crate::Trajectory = from_python(description, "trajectory")?;
        motion.validate().raise()?;
        Ok(Trajectory::of(motion))
    }

    /// Dictionary with the keys of a trajectory file.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &*self.motion)
    }

    /// Text of a trajectory file.
    fn to_json(&self) -> PyResult<String> {
        self.text().raise()
    }

    /// Writes a trajectory file.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        self.text().and_then(|text| files::write(&path, &format!("{text}\n"))).raise()
    }

    /// Largest normal force of a foot, N, if it was given apart from the motion; for copies in other processes.
    #[getter]
    fn _force_limit(&self) -> Option<f64> {
        self.force_limit
    }

    /// Copy with another such force limit.
    fn _limited(&self, force_limit: Option<f64>) -> Self {
        Trajectory { motion: self.motion.clone(), force_limit }
    }

    /// Phase durations, stance first, s: one list per foot.
    #[getter]
    fn schedule(&self) -> Vec<Vec<f64>> {
        self.motion.durations.clone()
    }

    /// Time from the start to the end, s.
    #[getter]
    fn horizon(&self) -> f64 {
        self.motion.horizon
    }

    /// Samples the motion.
    ///
    /// Parameters
    /// ----------
    /// rate : float, default 100
    ///     Sampling rate, Hz, from time 0; the last sample is the end of the motion.
    ///
    /// Returns
    /// -------
    /// Samples
    ///
    /// Raises
    /// ------
    /// Error
    ///     For a rate that is not positive or too high.
    #[pyo3(signature = (rate = 100.))]
    pub fn sample(&self, py: Python<'_>, rate: f64) -> PyResult<Samples> {
        let sampled = py.detach(|| {
            let world = World::of(None, None, None);
            let ((robot, _), (terrain, _)) = (robot_of(&world, &self.motion)?, terrain_of(&world, &self.motion)?);
            Sampled::new(&self.motion, &robot, &terrain, rate)
        });
        Samples::new(py, &sampled.raise()?)
    }

    /// Computes the joints along the motion, for a robot imported from a URDF.
    ///
    /// Parameters
    /// ----------
    /// rate : float, default 100
    ///     Sampling rate, Hz, from time 0; the last sample is the end of the motion.
    /// robot : Robot, optional
    ///     Robot that replaces the one in the motion.
    ///
    /// Returns
    /// -------
    /// Joints
    ///
    /// Raises
    /// ------
    /// Error
    ///     For a robot without joints or with another number of feet.
    #[pyo3(signature = (rate = 100., robot = None))]
    pub fn joints(&self, py: Python<'_>, rate: f64, robot: Option<&Robot>) -> PyResult<Joints> {
        Joints::along(py, self, rate, robot)
    }

    /// Writes the motion in a format of another program, as ``cregopt export`` does.
    ///
    /// Parameters
    /// ----------
    /// path : path
    ///     File to write.
    /// format : {"csv", "mcap", "ros2"}
    ///     Table with units in its header; MCAP with the schemas of Foxglove; MCAP with messages of ROS 2: trajectories of base and joints,
    ///     wrenches and contacts of the feet.
    /// rate : float, default 100
    ///     Sampling rate, Hz, from time 0; the last sample is the end of the motion.
    ///
    /// Raises
    /// ------
    /// Error
    ///     For an unknown format, and a rate that is not positive or too high.
    #[pyo3(signature = (path, format, rate = 100.))]
    fn export(&self, py: Python<'_>, path: PathBuf, format: &Bound<'_, PyAny>, rate: f64) -> PyResult<()> {
        let format: Format = from_python(format, "format")?;
        let written = py.detach(|| {
            let world = World::of(None, None, None);
            let ((robot, _), (terrain, _)) = (robot_of(&world, &self.motion)?, terrain_of(&world, &self.motion)?);
            files::write_bytes(&path, &format.bytes(&self.motion, &robot, &terrain, rate)?.0)
        });
        written.raise()
    }

    fn __repr__(&self) -> String {
        format!("Trajectory({:.3} s, {} feet)", self.motion.horizon, self.motion.ee.len())
    }
}

impl Trajectory {
    fn of(motion: crate::Trajectory) -> Trajectory {
        Trajectory { motion: Arc::new(motion), force_limit: None }
    }

    fn text(&self) -> Result<String> {
        Ok(serde_json::to_string(&*self.motion)?)
    }
}

fn read(path: &Path) -> Result<crate::Trajectory> {
    crate::Trajectory::from_json(&files::read(path)?).map_err(|e| e.in_file(path, None))
}

/// Motion at ``n`` instants: world frame (z up), SI units, arrays of float64 except ``contacts``.
#[pyclass(frozen, get_all, module = "cregopt")]
pub struct Samples {
    /// Time, s, shape (n,).
    time: Py<PyArray1<f64>>,
    /// Position of the base, which is the centre of mass, m, shape (n, 3).
    base_position: Py<PyArray2<f64>>,
    /// Unit quaternion w, x, y, z from base to world, shape (n, 4); its sign is continuous.
    base_quaternion: Py<PyArray2<f64>>,
    /// Roll, pitch, yaw, rad, shape (n, 3); base to world is ``Rz(yaw) Ry(pitch) Rx(roll)``.
    base_angles: Py<PyArray2<f64>>,
    /// Velocity of the base, m/s, shape (n, 3).
    base_velocity: Py<PyArray2<f64>>,
    /// Angular velocity of the base, world frame, rad/s, shape (n, 3).
    base_angular_velocity: Py<PyArray2<f64>>,
    /// Positions of the feet, m, shape (n, feet, 3).
    feet_position: Py<PyArray3<f64>>,
    /// Velocities of the feet, m/s, shape (n, feet, 3).
    feet_velocity: Py<PyArray3<f64>>,
    /// Forces of the ground on the feet, N, shape (n, feet, 3).
    forces: Py<PyArray3<f64>>,
    /// Moments of the ground on the soles about their centres, N m, shape (n, feet, 3); zero for feet without soles.
    moments: Py<PyArray3<f64>>,
    /// Yaws of the soles, rad, shape (n, feet); zero for feet without soles.
    yaws: Py<PyArray2<f64>>,
    /// True while a foot is in stance, bool, shape (n, feet). At a change of contact, the phase that begins counts.
    contacts: Py<PyArray2<bool>>,
    /// Names of the feet.
    feet_names: Vec<String>,
}

#[pymethods]
impl Samples {
    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.time.bind(py).len()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("Samples({} instants, {} feet)", self.__len__(py)?, self.feet_names.len()))
    }
}

impl Samples {
    pub fn new(py: Python<'_>, sampled: &Sampled) -> PyResult<Samples> {
        let Sampled { samples, names } = sampled;
        let (times, feet) = (samples.len(), names.len());
        let of_base = |of: fn(&Sample) -> [f64; 3]| table(py, samples.iter().flat_map(of), [times, 3]);
        let of_feet = |of: fn(&FootSample) -> [f64; 3]| {
            let numbers: Vec<f64> = samples.iter().flat_map(|s| s.feet.iter().flat_map(of)).collect();
            numbers.into_pyarray(py).reshape([times, feet, 3]).map(Bound::unbind)
        };
        Ok(Samples {
            time: samples.iter().map(|s| s.time).collect::<Vec<_>>().into_pyarray(py).unbind(),
            base_position: of_base(|s| s.base.position)?,
            base_quaternion: table(py, samples.iter().flat_map(|s| s.base.quaternion), [times, 4])?,
            base_angles: of_base(|s| s.base.angles)?,
            base_velocity: of_base(|s| s.base.velocity)?,
            base_angular_velocity: of_base(|s| s.base.angular_velocity)?,
            feet_position: of_feet(|foot| foot.position)?,
            feet_velocity: of_feet(|foot| foot.velocity)?,
            forces: of_feet(|foot| foot.force)?,
            moments: of_feet(|foot| foot.sole.as_ref().map_or([0.; 3], |sole| sole.moment))?,
            yaws: table(
                py,
                samples.iter().flat_map(|s| s.feet.iter().map(|f| f.sole.as_ref().map_or(0., SoleSample::yaw))),
                [times, feet],
            )?,
            contacts: table(py, samples.iter().flat_map(|s| s.feet.iter().map(|foot| foot.stance)), [times, feet])?,
            feet_names: names.clone(),
        })
    }
}

/// Array with two dimensions.
pub fn table<T: Element>(py: Python<'_>, numbers: impl Iterator<Item = T>, shape: [usize; 2]) -> PyResult<Py<PyArray2<T>>> {
    numbers.collect::<Vec<_>>().into_pyarray(py).reshape(shape).map(Bound::unbind)
}

/// Result of the independent verification of a motion: violated rows, and the largest deviations between the instants of the rows.
///
/// ``str()`` gives a text, ``dict()`` the values.
#[pyclass(frozen, module = "cregopt")]
pub struct Certificate {
    report: Report,
    /// Terms of the verification, each with its source; empty for a gait of a search.
    #[pyo3(get)]
    terms: Vec<String>,
}

#[pymethods]
impl Certificate {
    /// True if every row is satisfied.
    #[getter]
    fn feasible(&self) -> bool {
        self.report.feasible
    }

    /// Number of violated rows.
    #[getter]
    fn n_violated(&self) -> usize {
        self.report.n_violated
    }

    /// Largest violation of a row, in its own unit.
    #[getter]
    fn max_violation(&self) -> f64 {
        self.report.max_violation
    }

    /// Dictionary with the keys of ``certificate`` in result.json.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.report)
    }

    /// Keys of :meth:`to_dict`.
    fn keys<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.to_dict(py)?.call_method0("keys")
    }

    fn __getitem__<'py>(&self, py: Python<'py>, key: &str) -> PyResult<Bound<'py, PyAny>> {
        self.to_dict(py)?.get_item(key)
    }

    fn __str__(&self) -> String {
        self.terms.iter().map(|term| format!("{term}\n")).collect::<String>() + &self.report.to_string()
    }

    fn __repr__(&self) -> String {
        format!("Certificate(feasible={}, n_violated={})", if self.report.feasible { "True" } else { "False" }, self.report.n_violated)
    }
}

impl Certificate {
    /// Certificate with the terms of the verification.
    pub fn new(report: Report, terms: Vec<String>) -> Certificate {
        Certificate { report, terms }
    }
}

/// Verifies a motion: counts the rows that it violates on whole curves, and integrates its forces.
///
/// Parameters
/// ----------
/// trajectory : Trajectory, Gait, dict or path
/// robot : Robot, optional
///     Robot that replaces the one in the motion.
/// terrain : Terrain, optional
///     Terrain that replaces the one in the motion.
/// force_limit : float, optional
///     Largest normal force of a foot, N, that replaces the limit in the motion.
///
/// Returns
/// -------
/// Certificate
///     ``terms`` lists the robot, ground, ends and limits that were used.
///
/// Raises
/// ------
/// Error
///     For a malformed motion, a robot with another number of feet, and a robot or terrain that is neither given nor known.
#[pyfunction]
#[pyo3(signature = (trajectory, robot = None, terrain = None, force_limit = None))]
pub fn verify(
    py: Python<'_>,
    trajectory: &Bound<'_, PyAny>,
    robot: Option<&Robot>,
    terrain: Option<&Terrain>,
    force_limit: Option<f64>,
) -> PyResult<Certificate> {
    let (motion, own_limit) = if let Ok(gait) = trajectory.cast::<Gait>() {
        (gait.get().motion(), gait.get().stage.task.force_limit)
    } else if let Ok(own) = trajectory.cast::<Trajectory>() {
        (own.get().motion.clone(), own.get().force_limit)
    } else if trajectory.is_instance_of::<PyDict>() {
        (Arc::new(from_python(trajectory, "trajectory")?), None)
    } else {
        (Arc::new(read(&trajectory.extract::<PathBuf>()?).raise()?), None)
    };
    let world = World::of(robot.map(|r| r.robot.clone()), terrain.map(|t| t.0.clone()), force_limit.or(own_limit));
    let verified = py.detach(|| {
        motion.validate()?;
        world.check_force_limit()?;
        let terms = VerificationTerms::new(&world, &motion, &TermOverrides::default())?;
        Ok((terms.verify()?, terms.lines))
    });
    let (report, lines) = verified.raise()?;
    Ok(Certificate::new(report, lines))
}
