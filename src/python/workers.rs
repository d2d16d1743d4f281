//! Backend that solves the candidates of a search in other processes, while the search itself runs in this one.

use super::call::working;
use super::convert::{from_python, raised, to_python};
use super::world::Task;
use crate::app::Mission;
use crate::backend::{Backend, Cpu, DeviceChoice, Fallback, Instance, Job, Precision, Solution, locked};
use crate::error::{Error, from_json};
use crate::gait::{AlignedSchedule, Schedule};
use crate::nlp::transcription::interval;
use crate::nlp::{Curves, Problem};
use crate::search::evaluate::{LowerSettings, check_candidate};
use crate::solver::{Outcome, Status, close};
use numpy::{IntoPyArray, PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyString;
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

/// Answer of a worker for one candidate, as a tuple: status, iterations, factorisations, infeasibility, closed in f64 or not, and `x`.
#[derive(FromPyObject, IntoPyObject)]
pub struct Answer(String, usize, usize, f64, bool, Py<PyArray1<f64>>);

/// Number of candidates that a worker's device left to the CPU, and the reason.
type Left = Option<(usize, String)>;

/// Answer in Rust types.
struct Solved {
    outcome: Outcome,
    closed: bool,
    x: Vec<f64>,
}

impl Answer {
    fn of(py: Python<'_>, Solved { outcome, closed, x }: Solved) -> PyResult<Answer> {
        let Outcome { status, iterations, factorisations, infeasibility } = outcome;
        let status = to_python(py, &status)?.extract()?;
        Ok(Answer(status, iterations, factorisations, infeasibility, closed, x.into_pyarray(py).unbind()))
    }

    fn solved(self, py: Python<'_>) -> PyResult<Solved> {
        let Answer(status, iterations, factorisations, infeasibility, closed, x) = self;
        let status: Status = from_python(PyString::new(py, &status).as_any(), "status")?;
        Ok(Solved { outcome: Outcome { status, iterations, factorisations, infeasibility }, closed, x: x.bind(py).to_vec()? })
    }
}

/// Part of a [`Job`] that workers receive as JSON, apart from the schedules.
#[derive(Serialize, Deserialize)]
struct JobPart {
    lower: LowerSettings,
    certified: bool,
}

/// Backend that consists of workers.
pub struct Workers<'a> {
    /// Choice of the device that each worker solves on.
    pub choice: DeviceChoice,
    /// Name in results.
    pub device: String,
    /// Function ``solve(task, part, schedules)``; ``part`` is JSON. It returns an iterator over pairs: an index, and the value of
    /// [`solve_chunk`] for the schedules from that index on. Pairs come in any order. The iterator also yields None from time to time, so
    /// that it can be cancelled.
    pub solve: Py<PyAny>,
    /// Threads of this process, which handle the answers.
    pub cpu: Cpu,
    /// Work that the devices of the workers left to their CPUs.
    pub fallback: Mutex<Option<Fallback>>,
    /// Flag that is set when the workers fail, because nothing else would end the search.
    pub cancelled: &'a AtomicBool,
    /// Exception of the failure.
    pub exception: &'a Mutex<Option<PyErr>>,
}

impl Workers<'_> {
    /// Solves problems of one task.
    ///
    /// * `first` - index of the first problem in the job
    fn solve_task(
        &self,
        (first, instances): (usize, &[Instance]),
        job: &Job,
        skip: &(dyn Fn(usize) -> bool + Sync),
        finish: &(dyn Fn(usize, Solution) + Sync),
    ) -> PyResult<()> {
        let Some(Instance { task, .. }) = instances.first() else { return Ok(()) };
        let lower = LowerSettings { transcription: job.transcription.clone(), solver: job.settings.clone(), precision: job.precision };
        let part = serde_json::to_string(&JobPart { lower, certified: job.certified }).map_err(raised)?;
        let schedules: Vec<&[Vec<f64>]> = instances.iter().map(|instance| instance.schedule.durations()).collect();
        let answers = Python::attach(|py| {
            let mission = Mission::new((*task).clone());
            self.solve.call1(py, (Task(Arc::new(mission)), part, schedules))?.bind(py).try_iter().map(|answers| answers.unbind().into_any())
        })?;
        let mut open = vec![true; instances.len()];
        self.pool().in_place_scope(|scope| {
            while (0..open.len()).any(|i| open[i] && !skip(first + i)) {
                let next = Python::attach(|py| -> PyResult<_> {
                    let Some(next) = answers.bind(py).try_iter()?.next() else {
                        return Err(raised(Error::Ended { message: "workers ended before every candidate was solved".into() }));
                    };
                    let Some((at, (answers, left))) = next?.extract::<Option<(usize, (Vec<Answer>, Left))>>()? else { return Ok(None) };
                    if let Some((candidates, reason)) = left {
                        Fallback::add(&self.fallback, candidates, reason);
                    }
                    let solved = answers.into_iter().map(|answer| answer.solved(py)).collect::<PyResult<Vec<Solved>>>()?;
                    Ok(Some((at, solved)))
                })?;
                for (index, solved) in next.into_iter().flat_map(|(at, solved)| (at..).zip(solved)) {
                    let Some(instance) = instances.get(index).filter(|_| std::mem::take(&mut open[index])) else { continue };
                    scope.spawn(move |_| {
                        let curves = Curves::new(instance.task, &instance.schedule, job.transcription);
                        let Solved { outcome, closed, x } = solved;
                        finish(first + index, Solution { outcome, x, variables: curves.variables, curves, closed });
                    });
                }
            }
            // Cancels the chunks that are still running.
            Python::attach(|py| answers.call_method0(py, "close")).map(|_| ())
        })
    }
}

impl Backend for Workers<'_> {
    fn device(&self) -> String {
        self.device.clone()
    }

    fn choice(&self) -> DeviceChoice {
        self.choice.clone()
    }

    fn fallback(&self) -> Option<Fallback> {
        locked(&self.fallback).clone()
    }

    fn pool(&self) -> &rayon::ThreadPool {
        self.cpu.pool()
    }

    fn solve(&self, job: &Job, skip: &(dyn Fn(usize) -> bool + Sync), finish: &(dyn Fn(usize, Solution) + Sync)) {
        let mut first = 0;
        for instances in job.instances.chunk_by(|a, b| std::ptr::eq(a.task, b.task)) {
            if let Err(exception) = self.solve_task((first, instances), job, skip, finish) {
                locked(self.exception).get_or_insert(exception);
                self.cancelled.store(true, Ordering::Relaxed);
            }
            first += instances.len();
        }
    }
}

/// Open device, with the key that it was opened for.
struct Opened {
    key: (String, usize, Precision),
    device: Arc<dyn Backend>,
}

/// Device of this process, which stays open between chunks: a GPU takes longer to open than to solve a chunk.
static OPENED: Mutex<Option<Opened>> = Mutex::new(None);

pub(super) fn device(name: &str, threads: usize, lower: &LowerSettings) -> crate::Result<Arc<dyn Backend>> {
    let mut opened = locked(&OPENED);
    let key = (name.to_owned(), threads, lower.precision);
    if let Some(Opened { device, .. }) = opened.as_ref().filter(|opened| opened.key == key) {
        return Ok(device.clone());
    }
    let device: Arc<dyn Backend> = name.parse::<DeviceChoice>()?.open(1, threads, lower.precision)?.into();
    *opened = Some(Opened { key, device: device.clone() });
    Ok(device)
}

/// Solves a chunk of schedules from [`Workers`]. Candidates that will be certified but are not solved are closed in f64, which can take as
/// long as the solve.
///
/// * `part` - JSON from [`Workers`]
/// * `on` - device
///
/// Returns an [`Answer`] per schedule, in order, and the work [`Left`] to the CPU.
#[pyfunction]
pub fn solve_chunk(
    py: Python<'_>,
    task: &Task,
    part: &str,
    schedules: Vec<Vec<Vec<f64>>>,
    on: &str,
    threads: usize,
) -> PyResult<(Vec<Answer>, Left)> {
    let task = &task.0.task;
    let (solved, left) = working(py, None, |cancelled, _| {
        let JobPart { lower, certified } = from_json(part)?;
        lower.validate()?;
        let interval = interval(&lower.transcription, &task.robot);
        let aligned = |durations| -> crate::Result<AlignedSchedule> {
            let schedule = Schedule::new(durations)?;
            check_candidate(task, &schedule, &lower)?;
            schedule.aligned_before(interval)
        };
        let instance = |durations| aligned(durations).map(|schedule| Instance { task, schedule });
        let instances: Vec<Instance> = schedules.into_iter().map(instance).collect::<crate::Result<_>>()?;
        let results: Vec<Mutex<Option<Solved>>> = instances.iter().map(|_| Mutex::new(None)).collect();
        let is_cancelled = || cancelled.load(Ordering::Relaxed);
        let finish = |index: usize, Solution { outcome, x, closed, .. }: Solution| {
            let leave = !certified || closed || outcome.status == Status::Solved || lower.precision == Precision::F64;
            let solved = if leave {
                Solved { outcome, closed, x }
            } else {
                let problem = Problem::<f64>::new(task, &instances[index].schedule, &lower.transcription);
                let (outcome, x) = close(&problem, outcome, x, &lower.solver, &is_cancelled);
                Solved { outcome, closed: true, x }
            };
            *locked(&results[index]) = Some(solved);
        };
        let LowerSettings { transcription, solver, precision } = &lower;
        let job = Job { instances: &instances, transcription, settings: solver, precision: *precision, certified };
        let device = device(on, threads, &lower)?;
        let left_before = device.fallback().map_or(0, |f| f.candidates);
        device.solve(&job, &|_| is_cancelled(), &finish);
        let left = device.fallback().filter(|f| f.candidates > left_before).map(|f| (f.candidates - left_before, f.reason));
        let all: Option<Vec<Solved>> = results.iter().map(|result| locked(result).take()).collect();
        all.map(|all| (all, left)).ok_or_else(|| Error::Ended { message: "stopped before every schedule was solved".into() })
    })?;
    Ok((solved.into_iter().map(|solved| Answer::of(py, solved)).collect::<PyResult<_>>()?, left))
}
