//! Backends that solve a population: CPU and GPU.

pub mod choose;
mod cpu;
#[cfg(feature = "gpu")]
pub mod gpu;
#[cfg(feature = "gpu")]
pub mod tables;

pub use choose::DeviceChoice;
pub use cpu::Cpu;
#[cfg(feature = "gpu")]
pub use gpu::Gpu;

use crate::gait::AlignedSchedule;
use crate::nlp::Curves;
use crate::settings::{SolverSettings, TranscriptionSettings};
use crate::solver::Outcome;
use crate::task::Task;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// One candidate: a task and a contact schedule.
#[derive(Debug, Clone)]
pub struct Instance<'a> {
    /// The task.
    pub task: &'a Task,
    /// Its schedule.
    pub schedule: AlignedSchedule,
}

/// Work for a backend.
#[derive(Debug, Clone, Copy)]
pub struct Job<'a> {
    /// Candidates.
    pub instances: &'a [Instance<'a>],
    /// Settings of the variables and rows.
    pub transcription: &'a TranscriptionSettings,
    /// Settings of the iteration.
    pub settings: &'a SolverSettings,
    /// Scalar of the main solve.
    pub precision: Precision,
    /// True if each candidate will be certified. What f32 leaves near a solution then continues in f64, and a backend may do that on idle
    /// threads.
    pub certified: bool,
}

/// Solution of one candidate.
#[derive(Debug, Clone)]
pub struct Solution {
    /// Outcome of the solve.
    pub outcome: Outcome,
    /// Values of the variables, as in [`crate::nlp::Problem::initial`].
    pub x: Vec<f64>,
    /// Number of variables; fixed values follow them in `x`.
    pub variables: usize,
    /// Curves that turn `x` into a motion.
    pub curves: Curves,
    /// True if the backend already tried [`close`](crate::solver::close) on it. Otherwise the caller that certifies it must do so.
    pub closed: bool,
}

/// Scalar of the main solve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// f32, then closing steps in f64.
    F32,
    /// f64 throughout.
    F64,
}

impl Precision {
    /// Text for results.
    pub fn described(self) -> &'static str {
        match self {
            Precision::F32 => "f32 closed in f64",
            Precision::F64 => "f64",
        }
    }
}

/// Candidates that a device left to the CPU, with the reason.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Fallback {
    /// Number of candidates.
    pub candidates: usize,
    /// Most recent reason.
    pub reason: String,
}

impl Fallback {
    /// Adds candidates to those recorded before.
    pub fn add(to: &Mutex<Option<Fallback>>, candidates: usize, reason: String) {
        let mut known = locked(to);
        let before = known.as_ref().map_or(0, |f| f.candidates);
        *known = Some(Fallback { candidates: before + candidates, reason });
    }
}

impl std::fmt::Display for Fallback {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} candidates solved on the CPU: {}", self.candidates, self.reason)
    }
}

/// Solver of batches of candidates.
pub trait Backend: Send + Sync {
    /// Name of the device, for results.
    fn device(&self) -> String;

    /// Choice that opens this device again; `auto` if no choice does.
    fn choice(&self) -> DeviceChoice {
        DeviceChoice::Auto
    }

    /// Candidates that the CPU had to solve instead of the device so far, or `None`.
    fn fallback(&self) -> Option<Fallback> {
        None
    }

    /// CPU threads of this backend. The work before and after its solves uses them as well.
    fn pool(&self) -> &rayon::ThreadPool;

    /// Number of CPU threads.
    fn threads(&self) -> usize {
        self.pool().current_num_threads()
    }

    /// Largest useful batch: more problems per call are not faster.
    fn batch(&self) -> usize {
        8192
    }

    /// Solves every problem and passes each solution to `finish`, in any order and from any thread.
    ///
    /// The backend calls `skip(index)` before and during each solve. If it returns true, the backend drops that candidate and does not call
    /// `finish`.
    fn solve(&self, job: &Job, skip: &(dyn Fn(usize) -> bool + Sync), finish: &(dyn Fn(usize, Solution) + Sync));
}

/// Locks a mutex, even if a thread panicked while it held it.
pub(crate) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
