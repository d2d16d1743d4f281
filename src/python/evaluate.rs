//! Evaluation of given schedules as one batch.

use super::call::working;
use super::convert::raised;
use super::motion::Trajectory;
use super::search::setup;
use super::world::Task;
use crate::app::Mission;
use crate::app::label::label;
use crate::error::Error;
use crate::gait::Schedule;
use crate::search::evaluate::{Evaluated, check_candidate, evaluate as solved};
use numpy::{IntoPyArray, PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Number of schedules of an evaluation that a notebook shows.
const SHOWN: usize = 10;

/// Results of ``n`` schedules, as arrays in their order.
#[pyclass(frozen, get_all, module = "cregopt")]
pub struct Evaluation {
    /// True if the certificate is satisfied, bool, shape (n,).
    feasible: Py<PyArray1<bool>>,
    /// Number of violated rows of the certificate, int64, shape (n,).
    n_violated: Py<PyArray1<i64>>,
    /// Largest violation of a row, in the unit of the row (N, N m, m, rad, ...), float64, shape (n,).
    max_violation: Py<PyArray1<f64>>,
    /// Cost per weight and distance, so without unit, float64, shape (n,): ``total`` of ``Gait.cost``; nan if the schedule is not feasible.
    cost: Py<PyArray1<f64>>,
    /// Number of solver iterations, int64, shape (n,).
    iterations: Py<PyArray1<i64>>,
    /// Time from the start to the end, s, float64, shape (n,).
    horizon: Py<PyArray1<f64>>,
    /// Motions, feasible or not, if they were requested.
    trajectories: Option<Vec<Py<Trajectory>>>,
}

#[pymethods]
impl Evaluation {
    #[new]
    #[pyo3(signature = (feasible, n_violated, max_violation, cost, iterations, horizon, trajectories = None))]
    fn new(
        feasible: Bound<'_, PyArray1<bool>>,
        n_violated: Py<PyArray1<i64>>,
        max_violation: Py<PyArray1<f64>>,
        cost: Py<PyArray1<f64>>,
        iterations: Py<PyArray1<i64>>,
        horizon: Py<PyArray1<f64>>,
        trajectories: Option<Vec<Py<Trajectory>>>,
    ) -> PyResult<Self> {
        let py = feasible.py();
        let n = feasible.len()?;
        let lengths = [
            ("n_violated", n_violated.bind(py).len()?),
            ("max_violation", max_violation.bind(py).len()?),
            ("cost", cost.bind(py).len()?),
            ("iterations", iterations.bind(py).len()?),
            ("horizon", horizon.bind(py).len()?),
            ("trajectories", trajectories.as_ref().map_or(n, Vec::len)),
        ];
        if let Some((name, length)) = lengths.into_iter().find(|&(_, length)| length != n) {
            return Err(raised(Error::invalid(name, format!("{length} values"), format!("{n}, as many as in `feasible`"))));
        }
        Ok(Evaluation { feasible: feasible.unbind(), n_violated, max_violation, cost, iterations, horizon, trajectories })
    }

    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.feasible.bind(py).len()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let feasible = self.feasible.bind(py).call_method0("sum")?;
        Ok(format!("Evaluation({feasible} of {} feasible)", self.__len__(py)?))
    }

    /// Table of the best schedules, for notebooks: the cheapest, then those that violate least.
    fn _repr_html_(&self, py: Python<'_>) -> PyResult<String> {
        let feasible = self.feasible.bind(py).to_vec()?;
        let (violated, iterations) = (self.n_violated.bind(py).to_vec()?, self.iterations.bind(py).to_vec()?);
        let (worst, cost) = (self.max_violation.bind(py).to_vec()?, self.cost.bind(py).to_vec()?);
        let horizon = self.horizon.bind(py).to_vec()?;
        let mut order: Vec<usize> = (0..feasible.len()).collect();
        // A missing cost is nan, which sorts after all numbers.
        order.sort_by(|&a, &b| {
            (!feasible[a], violated[a])
                .cmp(&(!feasible[b], violated[b]))
                .then(cost[a].total_cmp(&cost[b]))
                .then(worst[a].total_cmp(&worst[b]))
        });
        let row = |&i: &usize| {
            let (verdict, price) = if feasible[i] { ("yes", format!("{:.3}", cost[i])) } else { ("no", String::new()) };
            let (rows, by) = (violated[i], worst[i]);
            let (time, steps) = (horizon[i], iterations[i]);
            format!(
                "<tr><td>{i}</td><td>{verdict}</td><td>{price}</td><td>{time:.2}</td><td>{rows}</td><td>{by:.1e}</td><td>{steps}</td></tr>"
            )
        };
        let rows: String = order.iter().take(SHOWN).map(row).collect();
        let count = feasible.iter().filter(|&&feasible| feasible).count();
        let shown = if feasible.len() > SHOWN { format!("; the best {SHOWN}:") } else { String::new() };
        Ok(format!(
            "<p>{count} of {} schedules feasible{shown}</p><table><thead><tr><th>schedule</th><th>feasible</th><th>cost</th><th>horizon, s</th>\
             <th>rows violated</th><th>largest violation</th><th>iterations</th></tr></thead><tbody>{rows}</tbody></table>",
            feasible.len()
        ))
    }
}

/// Solves schedules of a task; `options` has the keys of a scenario file.
#[pyfunction]
pub fn evaluate(
    py: Python<'_>,
    task: &Task,
    schedules: Vec<Vec<Vec<f64>>>,
    options: &Bound<'_, PyDict>,
    trajectories: bool,
) -> PyResult<Evaluation> {
    let setup = setup(options)?;
    let Mission { task, waypoints, provenance } = &*task.0;
    if !waypoints.is_empty() {
        return Err(raised(Error::invalid("task.via", format!("{} places", waypoints.len()), "none: schedules are for one motion")));
    }
    let (results, motions) = working(py, None, |cancelled, _| {
        let request = setup.request()?;
        let fitting = |durations| {
            let schedule = Schedule::new(durations)?;
            check_candidate(task, &schedule, &request.lower).map(|()| schedule)
        };
        let numbered = schedules.into_iter().enumerate();
        let schedule = |(i, durations)| fitting(durations).map_err(|e| e.within(format_args!("schedules[{i}]")));
        let schedules: Vec<Schedule> = numbered.map(schedule).collect::<crate::Result<_>>()?;
        let backend = setup.backend(schedules.len(), request.lower.precision)?;
        let candidates: Vec<(&crate::Task, &Schedule)> = schedules.iter().map(|schedule| (task, schedule)).collect();
        let is_cancelled = || cancelled.load(Ordering::Relaxed);
        let results = solved(&candidates, &request.lower, Some(&request.search.cost), &*backend, false, &is_cancelled)?;
        let Some(results) = results.into_iter().collect::<Option<Vec<Evaluated>>>() else {
            return Err(Error::Ended { message: "stopped before every schedule was solved".into() });
        };
        let motion = |result: &Evaluated| label(result.trajectory(task, &request.lower.transcription), task, *provenance, None);
        let motions: Option<Vec<_>> = trajectories.then(|| results.iter().map(motion).collect());
        Ok((results, motions))
    })?;
    let count = |value: usize| i64::try_from(value).unwrap_or(i64::MAX);
    let force_limit = task.force_limit;
    let own = |motion| Py::new(py, Trajectory { motion: Arc::new(motion), force_limit });
    Ok(Evaluation {
        feasible: column(py, &results, |r| r.feasible),
        n_violated: column(py, &results, |r| count(r.n_violated)),
        max_violation: column(py, &results, |r| r.max_violation),
        cost: column(py, &results, |r| r.cost.as_ref().map_or(f64::NAN, |cost| cost.total)),
        iterations: column(py, &results, |r| count(r.outcome.iterations)),
        horizon: column(py, &results, |r| r.horizon),
        trajectories: motions.map(|motions| motions.into_iter().map(own).collect::<PyResult<_>>()).transpose()?,
    })
}

fn column<T: numpy::Element>(py: Python<'_>, results: &[Evaluated], of: impl Fn(&Evaluated) -> T) -> Py<PyArray1<T>> {
    results.iter().map(of).collect::<Vec<_>>().into_pyarray(py).unbind()
}
