//! Searches, and the gaits that they return.

use super::call::working;
use super::convert::{Raise, from_python, raised, to_python};
use super::joints::Joints;
use super::motion::{Certificate, Samples, Trajectory};
use super::workers::Workers;
use super::world::{Robot, Task};
use crate::backend::{Cpu, locked};
use crate::cli::args::World;
use crate::cli::held::{Asked, Held};
use crate::cli::leg::{Leg, left_over, leg_folder};
use crate::cli::scenario_file::ScenarioFile;
use crate::cli::solve::{Solve, text};
use crate::cli::to_json;
use crate::cli::view::{Found, said, scene};
use crate::error::{Error, Result, from_value};
use crate::files;
use crate::report::motion_plot;
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;
use std::ffi::CString;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

/// A gait that a search returned, with its motion, and how it was found.
#[pyclass(frozen, module = "cregopt")]
pub struct Gait {
    /// Its search.
    pub leg: Arc<Leg>,
    /// The legs of the way before it.
    before: Arc<[Arc<Leg>]>,
    /// Which of its gaits: 0 is the best.
    index: usize,
}

#[pymethods]
impl Gait {
    /// Whether every row of its certificate holds. Without, it is the candidate that violates least.
    #[getter]
    fn feasible(&self) -> bool {
        self.gait().feasible()
    }

    /// What it costs, and what its legs have to do, by the keys of ``cost`` in result.json; None where it is not feasible.
    ///
    /// ``total`` is ``leg_work``, ``swing_work`` and ``effort_cost`` by their weights, each a weight and distance, so without unit, and
    /// ``joint_cost``, what joints cost that go beyond their limits, of a robot with joints. Besides:
    /// ``effort`` (mean of the squared forces, weights²), ``distance`` (m), ``horizon`` (s), ``peak_force`` (weights), ``tilt`` (degrees),
    /// ``foot_speed`` and ``touch_down_speed`` (m/s), ``foot_acceleration`` (m/s²), ``swing_moment`` (weight times the length of a leg).
    #[getter]
    fn cost<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.gait().candidate.solution.cost.as_ref().map(|cost| to_python(py, cost)).transpose()
    }

    /// Its family, where it is one of a family or near one.
    #[getter]
    fn family(&self) -> Option<String> {
        self.gait().family.map(|family| family.to_string())
    }

    /// What the independent check says of it.
    #[getter]
    fn certificate(&self) -> Certificate {
        Certificate::new(self.gait().certificate().clone(), Vec::new())
    }

    /// Phase durations, stance first, s: a list for each foot.
    #[getter]
    fn schedule(&self) -> Vec<Vec<f64>> {
        self.gait().candidate.solution.durations()
    }

    /// Its motion and forces.
    #[getter]
    fn trajectory(&self) -> Trajectory {
        Trajectory { motion: self.motion(), force_limit: self.leg.task.force_limit }
    }

    /// The best gaits of other families, cheapest first, where they were asked for.
    #[getter]
    fn alternatives(&self) -> Vec<Gait> {
        let others = if self.index == 0 { self.leg.found.alternatives.len() } else { 0 };
        (1..=others).map(|index| Gait { leg: self.leg.clone(), before: self.before.clone(), index }).collect()
    }

    /// The gaits of all legs of the way to here, of which this is the last: more than one where its task has places on the way.
    #[getter]
    fn legs(&self) -> Vec<Gait> {
        let leg = |number: usize| Gait { leg: self.before[number].clone(), before: self.before[..number].into(), index: 0 };
        let last = Gait { leg: self.leg.clone(), before: self.before.clone(), index: self.index };
        (0..self.before.len()).map(leg).chain([last]).collect()
    }

    /// Why nothing was found, with the keys of ``diagnosis`` in result.json; None where it is feasible.
    #[getter]
    fn diagnosis<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.leg.diagnosis.as_ref().map(|diagnosis| to_python(py, diagnosis)).transpose()
    }

    /// The task that it is for: that of its leg.
    #[getter]
    fn task(&self) -> Task {
        Task(Arc::new(self.leg.way()))
    }

    /// Time of its search, s.
    #[getter]
    fn seconds(&self) -> f64 {
        self.leg.found.seconds
    }

    /// The motion at instants; see ``Trajectory.sample``.
    #[pyo3(signature = (rate = 100.))]
    fn sample(&self, py: Python<'_>, rate: f64) -> PyResult<Samples> {
        self.trajectory().sample(py, rate)
    }

    /// The joints along the motion; see ``Trajectory.joints``.
    #[pyo3(signature = (rate = 100., robot = None))]
    fn joints(&self, py: Python<'_>, rate: f64, robot: Option<&Robot>) -> PyResult<Joints> {
        self.trajectory().joints(py, rate, robot)
    }

    /// The whole search, with the keys of result.json.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.leg.result(&self.leg.run()))
    }

    /// The whole search, as the text of result.json.
    fn to_json(&self) -> PyResult<String> {
        to_json(&self.leg.result(&self.leg.run())).raise()
    }

    /// Writes result.json, trajectory.json and scenario.toml into a folder, as ``cregopt solve --out`` does: of each leg into a folder leg-1, leg-2
    /// and on where there is more than one. Warns of motions of an earlier gait that stay beside them.
    fn save(&self, py: Python<'_>, folder: PathBuf) -> PyResult<()> {
        let legs: Vec<&Leg> = self.before.iter().chain([&self.leg]).map(|leg| &**leg).collect();
        let write = |(number, leg): (usize, &&Leg)| {
            let own = leg_folder(&folder, number, legs.len());
            files::make_folder(&own).and_then(|()| leg.write(&own))
        };
        py.detach(|| (1..).zip(&legs).try_for_each(write)).raise()?;
        for old in left_over(&folder, legs.len(), legs.len()) {
            let said = CString::new(format!("{} has the motion of an earlier gait", old.display()))?;
            PyErr::warn(py, &py.get_type::<PyUserWarning>(), &said, 1)?;
        }
        Ok(())
    }

    /// Writes a picture of the gait, its forces and its way: .svg or .png.
    fn plot(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| motion_plot::check(&path).and_then(|()| motion_plot::write(&self.leg.plot(self.gait()), &path))).raise()
    }

    /// Writes a page for a browser: the robot moving, its forces, its certificate.
    ///
    /// Parameters
    /// ----------
    /// path : path, optional
    ///     The page; without, a new file among the temporary ones, which is opened.
    ///
    /// Returns
    /// -------
    /// str
    ///     The path.
    #[pyo3(signature = (path = None))]
    fn view(&self, py: Python<'_>, path: Option<PathBuf>) -> PyResult<String> {
        let page = py.detach(|| self.page()).raise()?;
        if let Some(path) = path {
            files::write(&path, &page).raise()?;
            return Ok(path.display().to_string());
        }
        let options = PyDict::new(py);
        options.set_item("prefix", "cregopt-")?;
        let folder: PathBuf = py.import("tempfile")?.call_method("mkdtemp", (), Some(&options))?.extract()?;
        let path = folder.join("view.html");
        files::write(&path, &page).raise()?;
        py.import("webbrowser")?.call_method1("open", (format!("file://{}", path.display()),))?;
        Ok(path.display().to_string())
    }

    /// The picture of :meth:`plot`, for notebooks: as an image, for pictures in one document would share the names of their parts.
    fn _repr_html_(&self, py: Python<'_>) -> PyResult<String> {
        let svg = py.detach(|| motion_plot::svg(&self.leg.plot(self.gait()))).raise()?;
        let code: String =
            py.import("base64")?.call_method1("b64encode", (svg.as_bytes(),))?.call_method1("decode", ("ascii",))?.extract()?;
        Ok(format!(r#"<img style="max-width: 100%" alt="{}" src="data:image/svg+xml;base64,{code}"/>"#, self.__repr__()))
    }

    fn __str__(&self) -> PyResult<String> {
        text(&self.leg.result(&self.leg.run()), None).raise()
    }

    fn __repr__(&self) -> String {
        let (gait, solution) = (self.gait(), &self.gait().candidate.solution);
        let family = gait.family.map(|f| format!("{f}, ")).unwrap_or_default();
        let cost = solution.cost.as_ref().map(|c| format!(", cost {:.3}", c.total)).unwrap_or_default();
        format!("Gait({family}{:.2} s{cost}, {}feasible)", solution.horizon, if gait.feasible() { "" } else { "not " })
    }
}

impl Gait {
    /// Of each leg.
    fn of(legs: Vec<Leg>) -> Vec<Gait> {
        let legs: Vec<Arc<Leg>> = legs.into_iter().map(Arc::new).collect();
        let gait = |(number, leg): (usize, &Arc<Leg>)| Gait { leg: leg.clone(), before: legs[..number].into(), index: 0 };
        legs.iter().enumerate().map(gait).collect()
    }

    fn gait(&self) -> &crate::Gait {
        self.leg.gaits().nth(self.index).unwrap_or(&self.leg.found.best)
    }

    /// Its motion, with where it comes from.
    pub fn motion(&self) -> Arc<crate::Trajectory> {
        Arc::new(self.leg.trajectory(self.gait()))
    }

    fn page(&self) -> Result<String> {
        let (gait, trajectory) = (self.gait(), self.leg.trajectory(self.gait()));
        let held = Held::new(&World::of(None, None, self.leg.task.force_limit), &trajectory, &Asked::default())?;
        let about = said(gait.family.map(|f| f.to_string()), gait.candidate.solution.cost.as_ref().map(|cost| cost.total));
        let name = format!("{} on {}", held.robot.name, held.terrain.name);
        crate::view::page(&[scene(&Found { name, trajectory, held, about })])
    }
}

/// What is asked, from the keys of a scenario file. Settings may be None there, for which TOML has no word.
pub fn asked(options: &Bound<'_, PyDict>) -> PyResult<Solve> {
    let mut tree: Value = from_python(options, "options")?;
    let mut nulls = Vec::new();
    if let Some(settings) = tree.get_mut("settings") {
        take_nulls(settings, "", &mut nulls);
    }
    let file: ScenarioFile = from_value(tree).raise()?;
    file.check_settings().raise()?;
    let mut solve = Solve::default().over(file).raise()?;
    solve.lower.set = nulls;
    Ok(solve)
}

/// Takes the leaves that are null out of a tree: `path=null` each.
fn take_nulls(tree: &mut Value, path: &str, nulls: &mut Vec<String>) {
    let Value::Object(object) = tree else { return };
    object.retain(|key, value| {
        let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        take_nulls(value, &path, nulls);
        if value.is_null() {
            nulls.push(format!("{path}=null"));
        }
        !value.is_null()
    });
}

/// Searches for the cheapest gait of a task, leg by leg where it has places on the way; `options` have the keys of a scenario file.
///
/// * `workers` - who solves instead of the device that was asked for: their name and [`Workers::solve`]
#[pyfunction]
#[pyo3(signature = (task, options, progress = None, workers = None))]
pub fn search(
    py: Python<'_>,
    task: &Task,
    options: &Bound<'_, PyDict>,
    progress: Option<Py<PyAny>>,
    workers: Option<(String, Py<PyAny>)>,
) -> PyResult<Gait> {
    let solve = asked(options)?;
    let exception = Mutex::new(None);
    let legs = working(py, progress.as_ref(), |cancelled, hear| {
        let asking = solve.asking()?;
        let backend = match workers {
            Some((device, solve)) => {
                let (cpu, fallback) = (Cpu::new(0)?, Mutex::default());
                Box::new(Workers { device, solve, cpu, fallback, cancelled, exception: &exception })
            }
            None => solve.lower.place.backend(asking.search.population, asking.lower.precision).map_err(Error::from)?,
        };
        task.0.search(&asking, None, &*backend, cancelled, hear, &mut |_, _| Ok(()))
    });
    if let Some(exception) = locked(&exception).take() {
        return Err(exception);
    }
    let legs = legs?;
    Gait::of(legs).pop().ok_or_else(|| raised(Error::Ended { message: "stopped before any leg was searched".into() }))
}

/// Searches as a scenario file asks: a gait for each leg of its way, to the first that has none.
#[pyfunction]
#[pyo3(signature = (path, out = None, progress = None))]
pub fn solve(py: Python<'_>, path: PathBuf, out: Option<PathBuf>, progress: Option<Py<PyAny>>) -> PyResult<Vec<Gait>> {
    let read = ScenarioFile::read(&path).and_then(|file| {
        let out = out.or(file.out.clone());
        Solve::default().over(ScenarioFile { out, ..file }).map_err(|e| e.in_file(&path, None))
    });
    let solve = read.raise()?;
    let legs = working(py, progress.as_ref(), |cancelled, hear| Ok(solve.legs(cancelled, hear, &mut |_, _| Ok(()))?.0))?;
    Ok(Gait::of(legs))
}
