//! Status and outcome of a solve.

use crate::solver::control;
use serde::{Deserialize, Serialize};

/// Status at the end of the solve of one candidate. Not an error: the last point is returned in every case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// Every row is satisfied to the requested tolerance.
    Solved,
    /// The iteration limit was reached.
    MaxIterations,
    /// Progress was too slow: the stall rule ended the solve.
    Stalled,
    /// After a few iterations the infeasibility was too high for a candidate that can be solved.
    TerminatedEarly,
    /// Every attempted step was refused, even short ones.
    StepsRefused,
    /// A residual became infinite or NaN.
    NonFinite,
    /// Cancelled from outside, because an answer was found or the user requested it.
    Cancelled,
}

impl Status {
    /// Status for a state of [`control`]; `None` while the solve is running.
    pub fn of(state: u32) -> Option<Status> {
        match state {
            control::SOLVED => Some(Status::Solved),
            control::MAX_ITERATIONS => Some(Status::MaxIterations),
            control::STALLED => Some(Status::Stalled),
            control::TERMINATED_EARLY => Some(Status::TerminatedEarly),
            control::STEPS_REFUSED => Some(Status::StepsRefused),
            control::NON_FINITE => Some(Status::NonFinite),
            _ => None,
        }
    }
}

impl std::fmt::Display for Status {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Status::Solved => "solved",
            Status::MaxIterations => "iteration limit",
            Status::Stalled => "stalled",
            Status::TerminatedEarly => "terminated early",
            Status::StepsRefused => "every step refused",
            Status::NonFinite => "not finite",
            Status::Cancelled => "cancelled",
        })
    }
}

/// Status and effort of a solve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Outcome {
    /// Status at the end of the solve.
    pub status: Status,
    /// Accepted steps.
    pub iterations: usize,
    /// Factorisations, refused attempts included.
    #[serde(rename = "factorizations")]
    pub factorisations: usize,
    /// Scaled infeasibility `F` at the last point.
    #[serde(skip)]
    pub infeasibility: f64,
}
