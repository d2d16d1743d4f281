//! Searches and their gaits.

use super::call::working;
use super::convert::{Raise, from_python, raised, to_python};
use super::joints::Joints;
use super::motion::{Certificate, Samples, Trajectory};
use super::workers::Workers;
use super::world::{Robot, Task};
use crate::app::options::LowerOptions;
use crate::app::page::{Exhibit, description};
use crate::app::save::{left_over, stage_folder};
use crate::app::summary::text;
use crate::app::world::World;
use crate::app::{MissionStage, Overrides, ScenarioFile, Setup, TermOverrides, VerificationTerms};
use crate::backend::{Cpu, locked};
use crate::error::{Error, Result, from_value, to_json};
use crate::files;
use crate::report::motion_plot;
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;
use std::ffi::CString;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

/// Gait that a search returned, with its motion and its search.
#[pyclass(frozen, module = "cregopt")]
pub struct Gait {
    /// MissionStage that found the gait.
    pub stage: Arc<MissionStage>,
    /// Earlier stages of the mission.
    before: Arc<[Arc<MissionStage>]>,
    /// Index among the gaits of the stage; 0: the best.
    index: usize,
}

#[pymethods]
impl Gait {
    /// True if every row of the certificate is satisfied; otherwise the gait is the candidate that violates least.
    #[getter]
    fn feasible(&self) -> bool {
        self.gait().feasible()
    }

    /// Cost, and the demands on the legs, with the keys of ``cost`` in result.json; None for an infeasible gait.
    ///
    /// ``total`` is the weighted sum of ``leg_work``, ``swing_work`` and ``effort_cost``, each per weight and distance, so without unit,
    /// plus ``joint_cost``, the cost of exceeded joint limits for a robot with joints. Further keys:
    /// ``effort`` (mean of the squared forces, weights²), ``distance`` (m), ``horizon`` (s), ``peak_force`` (weights), ``tilt`` (degrees),
    /// ``foot_speed`` and ``touch_down_speed`` (m/s), ``foot_acceleration`` (m/s²), ``swing_moment`` (weight times the length of a leg).
    #[getter]
    fn cost<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.gait().candidate.solution.cost.as_ref().map(|cost| to_python(py, cost)).transpose()
    }

    /// Family of the gait, if it belongs to one or is near one.
    #[getter]
    fn family(&self) -> Option<String> {
        self.gait().candidate.family.map(|family| family.to_string())
    }

    /// Result of the independent verification.
    #[getter]
    fn certificate(&self) -> Certificate {
        Certificate::new(self.gait().certificate().clone(), Vec::new())
    }

    /// Phase durations, stance first, s: one list per foot.
    #[getter]
    fn schedule(&self) -> Vec<Vec<f64>> {
        self.gait().candidate.solution.durations()
    }

    /// Motion and forces.
    #[getter]
    fn trajectory(&self) -> Trajectory {
        Trajectory { motion: self.motion(), force_limit: self.stage.task.force_limit }
    }

    /// Best gaits of other families, cheapest first, if ``alternatives`` were requested.
    #[getter]
    fn alternatives(&self) -> Vec<Gait> {
        let others = if self.index == 0 { self.stage.found.alternatives.len() } else { 0 };
        (1..=others).map(|index| Gait { stage: self.stage.clone(), before: self.before.clone(), index }).collect()
    }

    /// Gaits of all stages of the mission up to this one, which is the last: more than one if the task has waypoints.
    #[getter]
    fn stages(&self) -> Vec<Gait> {
        let earlier = |number: usize| Gait { stage: self.before[number].clone(), before: self.before[..number].into(), index: 0 };
        let last = Gait { stage: self.stage.clone(), before: self.before.clone(), index: self.index };
        (0..self.before.len()).map(earlier).chain([last]).collect()
    }

    /// Reasons why no gait was found, with the keys of ``diagnosis`` in result.json; None for a feasible gait.
    #[getter]
    fn diagnosis<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.stage.diagnosis.as_ref().map(|diagnosis| to_python(py, diagnosis)).transpose()
    }

    /// Task of the stage that found the gait.
    #[getter]
    fn task(&self) -> Task {
        Task(Arc::new(self.stage.mission()))
    }

    /// Duration of the search, s.
    #[getter]
    fn seconds(&self) -> f64 {
        self.stage.found.seconds
    }

    /// Samples the motion; see ``Trajectory.sample``.
    #[pyo3(signature = (rate = 100.))]
    fn sample(&self, py: Python<'_>, rate: f64) -> PyResult<Samples> {
        self.trajectory().sample(py, rate)
    }

    /// Computes the joints along the motion; see ``Trajectory.joints``.
    #[pyo3(signature = (rate = 100., robot = None))]
    fn joints(&self, py: Python<'_>, rate: f64, robot: Option<&Robot>) -> PyResult<Joints> {
        self.trajectory().joints(py, rate, robot)
    }

    /// Result of the search as a dictionary with the keys of result.json.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        to_python(py, &self.stage.result())
    }

    /// Result of the search as the text of result.json.
    fn to_json(&self) -> PyResult<String> {
        to_json(&self.stage.result()).raise()
    }

    /// Writes result.json, trajectory.json and scenario.toml to a folder, as ``cregopt solve --out`` does; with several stages, to one
    /// folder per stage: stage-1, stage-2, ... Warns about motions of an earlier gait that remain in the folder.
    fn save(&self, py: Python<'_>, folder: PathBuf) -> PyResult<()> {
        let stages: Vec<&MissionStage> = self.before.iter().chain([&self.stage]).map(|stage| &**stage).collect();
        let write = |(number, stage): (usize, &&MissionStage)| {
            let own = stage_folder(&folder, number, stages.len());
            files::make_folder(&own).and_then(|()| stage.write(&own))
        };
        py.detach(|| (1..).zip(&stages).try_for_each(write)).raise()?;
        for old in left_over(&folder, stages.len(), stages.len()) {
            let warning = CString::new(format!("{} has the motion of an earlier gait", old.display()))?;
            PyErr::warn(py, &py.get_type::<PyUserWarning>(), &warning, 1)?;
        }
        Ok(())
    }

    /// Writes a picture of the gait, its forces and its path: .svg, or .png if built with the feature `pictures`.
    fn plot(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| motion_plot::check(&path).and_then(|()| motion_plot::write(&self.stage.plot(self.gait()), &path))).raise()
    }

    /// Writes a web page with the moving robot, its forces and its certificate.
    ///
    /// Parameters
    /// ----------
    /// path : path, optional
    ///     Page to write. Without it, a temporary file is written and opened in a browser.
    ///
    /// Returns
    /// -------
    /// str
    ///     Path of the page.
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

    /// Picture of :meth:`plot`, for notebooks. It is embedded as an image, because several SVGs in one document would share the names of
    /// their parts.
    fn _repr_html_(&self, py: Python<'_>) -> PyResult<String> {
        let svg = py.detach(|| motion_plot::svg(&self.stage.plot(self.gait()))).raise()?;
        let code: String =
            py.import("base64")?.call_method1("b64encode", (svg.as_bytes(),))?.call_method1("decode", ("ascii",))?.extract()?;
        Ok(format!(r#"<img style="max-width: 100%" alt="{}" src="data:image/svg+xml;base64,{code}"/>"#, self.__repr__()))
    }

    fn __str__(&self) -> PyResult<String> {
        text(&self.stage.result(), None).raise()
    }

    fn __repr__(&self) -> String {
        let (gait, solution) = (self.gait(), &self.gait().candidate.solution);
        let family = gait.candidate.family.map(|f| format!("{f}, ")).unwrap_or_default();
        let cost = solution.cost.as_ref().map(|c| format!(", cost {:.3}", c.total)).unwrap_or_default();
        format!("Gait({family}{:.2} s{cost}, {}feasible)", solution.horizon, if gait.feasible() { "" } else { "not " })
    }
}

impl Gait {
    /// Best gait of each stage.
    fn of(stages: Vec<MissionStage>) -> Vec<Gait> {
        let stages: Vec<Arc<MissionStage>> = stages.into_iter().map(Arc::new).collect();
        let gait = |(number, stage): (usize, &Arc<MissionStage>)| Gait { stage: stage.clone(), before: stages[..number].into(), index: 0 };
        stages.iter().enumerate().map(gait).collect()
    }

    fn gait(&self) -> &crate::Gait {
        self.stage.gaits().nth(self.index).unwrap_or(&self.stage.found.best)
    }

    /// Motion with robot, terrain, scenario and seed.
    pub fn motion(&self) -> Arc<crate::Trajectory> {
        Arc::new(self.stage.trajectory(self.gait()))
    }

    fn page(&self) -> Result<String> {
        let (gait, trajectory) = (self.gait(), self.stage.trajectory(self.gait()));
        let terms = VerificationTerms::new(&World::of(None, None, self.stage.task.force_limit), &trajectory, &TermOverrides::default())?;
        let report = terms.verify()?;
        let about = description(gait.candidate.family.map(|f| f.to_string()), gait.candidate.solution.cost.as_ref().map(|cost| cost.total));
        let name = format!("{} on {}", terms.robot.name, terms.terrain.name);
        crate::view::page(&[Exhibit { name, trajectory, terms, report, about }.scene()])
    }
}

/// Setup from a dictionary with the keys of a scenario file. Settings may be None there, which TOML cannot express.
pub fn setup(options: &Bound<'_, PyDict>) -> PyResult<Setup> {
    let mut tree: Value = from_python(options, "options")?;
    let mut nulls = Vec::new();
    if let Some(settings) = tree.get_mut("settings") {
        take_nulls(settings, "", &mut nulls);
    }
    let file: ScenarioFile = from_value(tree).raise()?;
    file.check_settings().raise()?;
    let lower = LowerOptions { set: nulls, ..LowerOptions::default() };
    Setup::new(file, Overrides { lower, ..Overrides::default() }).raise()
}

/// Moves the null leaves of a tree to assignments `path=null`.
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

/// Searches for the cheapest gait of a task, stage by stage if it has waypoints; `options` has the keys of a scenario file.
///
/// * `workers` - solver that replaces the device of the options: its device (``cpu`` or ``gpu``), its name in results, and
///   [`Workers::solve`]
#[pyfunction]
#[pyo3(signature = (task, options, progress = None, workers = None))]
pub fn search(
    py: Python<'_>,
    task: &Task,
    options: &Bound<'_, PyDict>,
    progress: Option<Py<PyAny>>,
    workers: Option<(String, String, Py<PyAny>)>,
) -> PyResult<Gait> {
    let setup = setup(options)?;
    let exception = Mutex::new(None);
    let stages = working(py, progress.as_ref(), |cancelled, on_event| {
        let request = setup.request()?;
        let backend = match workers {
            Some((choice, device, solve)) => {
                let (choice, cpu, fallback) = (choice.parse()?, Cpu::new(0)?, Mutex::default());
                Box::new(Workers { choice, device, solve, cpu, fallback, cancelled, exception: &exception })
            }
            None => setup.backend(request.search.population, request.lower.precision)?,
        };
        task.0.search_with(&request, &*backend, None, cancelled, on_event, &mut |_, _| Ok(()))
    });
    if let Some(exception) = locked(&exception).take() {
        return Err(exception);
    }
    Gait::of(stages?).pop().ok_or_else(|| raised(Error::Ended { message: "stopped before any stage was searched".into() }))
}

/// Runs the search of a scenario file. Returns a gait per stage, up to the first stage without one.
#[pyfunction]
#[pyo3(signature = (path, out = None, progress = None))]
pub fn solve(py: Python<'_>, path: PathBuf, out: Option<PathBuf>, progress: Option<Py<PyAny>>) -> PyResult<Vec<Gait>> {
    let read = ScenarioFile::read(&path).and_then(|file| {
        let out = out.or(file.out.clone());
        Setup::new(ScenarioFile { out, ..file }, Overrides::default()).map_err(|e| e.in_file(&path, None))
    });
    let setup = read.raise()?;
    let stages = working(py, progress.as_ref(), |cancelled, on_event| {
        let (request, mission) = (setup.request()?, setup.mission()?);
        let backend = setup.backend(request.search.population, request.lower.precision)?;
        mission.search_with(&request, &*backend, setup.out().as_deref(), cancelled, on_event, &mut |_, _| Ok(()))
    })?;
    Ok(Gait::of(stages))
}
