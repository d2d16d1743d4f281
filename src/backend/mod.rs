//! Where a population is solved.

mod cpu;

pub use cpu::Cpu;

use crate::gait::Schedule;
use crate::settings::{SolverSettings, TranscriptionSettings};
use crate::solver::Outcome;
use crate::task::Task;

/// One candidate: a task and a schedule whose feet all end at a multiple of the interval.
#[derive(Debug, Clone)]
pub struct Problem<'a> {
    /// The task.
    pub task: &'a Task,
    /// The aligned schedule.
    pub schedule: Schedule,
}

/// What a backend returns for a candidate.
#[derive(Debug, Clone)]
pub struct Solution {
    /// How the solve ended.
    pub outcome: Outcome,
    /// Values of the variables, as in [`crate::nlp::Layout::initial`].
    pub x: Vec<f64>,
}

/// Scalar of the main solve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// `f32`, closed in `f64`.
    F32,
    /// `f64` throughout.
    F64,
}

/// Solves batches of candidates.
pub trait Backend: Send + Sync {
    /// Name of the device, for results.
    fn device(&self) -> String;

    /// Solves every problem and hands each solution to `finish`, in any order and from any thread.
    ///
    /// `skip(index)` is asked before and during each solve; when it says so, that candidate is dropped (`finish` is not called).
    fn solve(
        &self,
        problems: &[Problem],
        transcription: &TranscriptionSettings,
        settings: &SolverSettings,
        precision: Precision,
        skip: &(dyn Fn(usize) -> bool + Sync),
        finish: &(dyn Fn(usize, Solution) + Sync),
    );
}
