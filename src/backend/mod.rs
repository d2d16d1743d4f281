//! Where a population is solved.

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

/// One candidate.
#[derive(Debug, Clone)]
pub struct Problem<'a> {
    /// The task.
    pub task: &'a Task,
    /// Its schedule.
    pub schedule: AlignedSchedule,
}

/// What a backend is to do.
#[derive(Debug, Clone, Copy)]
pub struct Job<'a> {
    /// Candidates.
    pub problems: &'a [Problem<'a>],
    /// Variables and rows.
    pub transcription: &'a TranscriptionSettings,
    /// Iterations.
    pub settings: &'a SolverSettings,
    /// Scalar.
    pub precision: Precision,
    /// Whether each candidate is certified: what f32 leaves near a solution then goes on in f64, and a backend may do that where it has the time.
    pub certified: bool,
}

/// What a backend returns for a candidate.
#[derive(Debug, Clone)]
pub struct Solution {
    /// How the solve ended.
    pub outcome: Outcome,
    /// Values of the variables, as in [`crate::nlp::Layout::initial`].
    pub x: Vec<f64>,
    /// Number of variables; fixed values follow them in `x`.
    pub variables: usize,
    /// What makes a motion of `x`.
    pub curves: Curves,
    /// Whether [`close`](crate::solver::close) was tried on it where it was solved; else whoever certifies it does.
    pub closed: bool,
}

/// Scalar of the main solve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// f32, closed in f64.
    F32,
    /// f64 throughout.
    F64,
}

/// Candidates that a device left to the CPU.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Fallback {
    /// How many.
    pub candidates: usize,
    /// Why, the last time.
    pub reason: String,
}

impl Fallback {
    /// Adds candidates to those that were left before.
    pub fn add(to: &Mutex<Option<Fallback>>, candidates: usize, reason: String) {
        let mut known = locked(to);
        let before = known.as_ref().map_or(0, |f| f.candidates);
        *known = Some(Fallback { candidates: before + candidates, reason });
    }
}

impl std::fmt::Display for Fallback {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} candidates on the cpu, for {}", self.candidates, self.reason)
    }
}

/// Solves batches of candidates.
pub trait Backend: Send + Sync {
    /// Name of the device, for results.
    fn device(&self) -> String;

    /// Choice that opens this device again; `auto` if no choice does.
    fn choice(&self) -> DeviceChoice {
        DeviceChoice::Auto
    }

    /// What it could not do itself so far.
    fn fallback(&self) -> Option<Fallback> {
        None
    }

    /// Threads of the CPU that it uses, for what is done on the CPU before and after its solves, too.
    fn pool(&self) -> &rayon::ThreadPool;

    /// How many those are.
    fn threads(&self) -> usize {
        self.pool().current_num_threads()
    }

    /// Problems that are worth handing over at once: with more nothing is faster.
    fn batch(&self) -> usize {
        8192
    }

    /// Solves every problem and hands each solution to `finish`, in any order and from any thread.
    ///
    /// `skip(index)` is asked before and during each solve; when it says so, that candidate is dropped (`finish` is not called).
    fn solve(&self, job: &Job, skip: &(dyn Fn(usize) -> bool + Sync), finish: &(dyn Fn(usize, Solution) + Sync));
}

/// What a mutex holds, whatever became of the thread that held it before.
pub(crate) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
