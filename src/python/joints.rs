//! Joints along motions, for robots with joints.

use super::convert::{Raise, to_python};
use super::motion::{Trajectory, table};
use super::world::Robot;
use crate::app::terms::{ground_of, robot_of};
use crate::app::world::World;
use crate::gait::joints::{JointMotion, JointSample, follow};
use numpy::{IntoPyArray, PyArray1, PyArray2};
use pyo3::prelude::*;

/// The ``m`` joints of a robot at ``n`` instants of a motion, foot after foot in the robot's order, each chain from the base to the foot.
///
/// A joint turns (rad, rad/s, N m) or slides (m, m/s, N), see ``turns``. Legs have no mass here: efforts balance the contact forces alone.
#[pyclass(frozen, get_all, module = "cregopt")]
pub struct Joints {
    /// Time, s, shape (n,).
    time: Py<PyArray1<f64>>,
    /// Positions, rad or m, shape (n, m).
    positions: Py<PyArray2<f64>>,
    /// Velocities, rad/s or m/s, shape (n, m).
    velocities: Py<PyArray2<f64>>,
    /// Torques or forces of the joints on the links that they move, N m or N, shape (n, m).
    efforts: Py<PyArray2<f64>>,
    /// Names of the joints in the robot's URDF.
    names: Vec<String>,
    /// True for a joint that turns, False for one that slides, bool, shape (m,).
    turns: Py<PyArray1<bool>>,
    /// Use of the joint limits, with the keys of ``cregopt robot joints --json``: ``position_margin``, ``velocity``, ``effort`` (each with
    /// ``name``, ``unit``, ``time``, ``value`` and ``limit``, or None without limits), ``miss`` (largest distance of a foot from its place,
    /// m) and ``kept``.
    limits: Py<PyAny>,
    /// True if no limit is exceeded and every foot reaches its place in the motion.
    kept: bool,
}

#[pymethods]
impl Joints {
    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.time.bind(py).len()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let within = if self.kept { "within" } else { "beyond" };
        Ok(format!("Joints({} instants, {} joints, {within} their limits)", self.__len__(py)?, self.names.len()))
    }
}

impl Joints {
    /// Joints along a motion, of the given robot or of the one in the motion.
    pub fn along(py: Python<'_>, trajectory: &Trajectory, rate: f64, robot: Option<&Robot>) -> PyResult<Joints> {
        let given = robot.map(|robot| robot.robot.clone());
        let followed = py.detach(|| {
            let world = World::of(given, None, None);
            let (robot, _) = robot_of(&world, &trajectory.motion)?;
            let terrain = ground_of(&world, &trajectory.motion, &robot)?;
            follow(&trajectory.motion, &robot, &terrain, rate)
        });
        let JointMotion { joints, samples, limits } = followed.raise()?;
        let shape = [samples.len(), joints.len()];
        let numbers = |of: fn(&JointSample) -> &[f64]| table(py, samples.iter().flat_map(of).copied(), shape);
        Ok(Joints {
            time: samples.iter().map(|s| s.time).collect::<Vec<_>>().into_pyarray(py).unbind(),
            positions: numbers(|s| &s.positions)?,
            velocities: numbers(|s| &s.velocities)?,
            efforts: numbers(|s| &s.efforts)?,
            names: joints.iter().map(|joint| joint.name.clone()).collect(),
            turns: joints.iter().map(|joint| joint.turns).collect::<Vec<_>>().into_pyarray(py).unbind(),
            limits: to_python(py, &limits)?.unbind(),
            kept: limits.kept,
        })
    }
}
