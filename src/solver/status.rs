//! How a solve ended.

use crate::solver::control;
use serde::{Deserialize, Serialize};

/// How the solve of one candidate ended. Not an error: the last point is kept in every case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// Every row holds to the tolerance that was asked for.
    Solved,
    /// The iteration limit was reached.
    MaxIterations,
    /// No progress: the stall rule ended it, or every attempt to step was refused.
    Stalled,
    /// A residual became infinite or no number.
    NonFinite,
    /// Ended from outside, because an answer was found or the user asked for the end.
    Cancelled,
}

impl Status {
    /// Status of a state of [`control`], none while the solve goes on.
    pub fn of(state: u32) -> Option<Status> {
        match state {
            control::SOLVED => Some(Status::Solved),
            control::MAX_ITERATIONS => Some(Status::MaxIterations),
            control::STALLED => Some(Status::Stalled),
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
            Status::NonFinite => "not finite",
            Status::Cancelled => "cancelled",
        })
    }
}

/// How a solve ended and what it took.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Outcome {
    /// How it ended.
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
