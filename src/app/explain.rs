//! Explanations of failures: checks before a search, and the diagnosis after one that found no gait.

use super::request::Request;
use crate::backend::Backend;
use crate::error::Result;
use crate::refine::check_robot;
use crate::search::SearchResult;
use crate::search::diagnosis::{Diagnosis, Relaxation, diagnose};
use crate::search::precheck::{Finding, precheck};
use crate::task::Task;
use std::time::Duration;

/// Share of the search time that a diagnosis may take. Too small: fewer causes are tried; too large: a failure is reported late.
const DIAGNOSIS_SHARE: f64 = 0.25;
/// Time that a diagnosis may take in any case.
const LEAST_DIAGNOSIS: Duration = Duration::from_secs(2);

/// Checks a task before its search. Returns the findings that make a gait unlikely.
///
/// # Errors
/// The first finding that rules out every gait; a refinement that the robot cannot have.
pub fn check(task: &Task, request: &Request) -> Result<Vec<Finding>> {
    if request.refines {
        check_robot(&task.robot)?;
    }
    let findings = precheck(task, &request.search, &request.lower.transcription);
    match findings.iter().find(|finding| finding.certain) {
        Some(certain) => Err(certain.clone().into()),
        None => Ok(findings),
    }
}

/// Diagnosis of a search that found no gait; `None` if it found one.
///
/// # Errors
/// Errors of [`diagnose`].
pub fn explain(
    task: &Task,
    request: &Request,
    found: &SearchResult,
    backend: &dyn Backend,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<Option<Diagnosis>> {
    if found.best.feasible() {
        return Ok(None);
    }
    let limit = Duration::from_secs_f64(DIAGNOSIS_SHARE * found.seconds).max(LEAST_DIAGNOSIS);
    let mut diagnosis = diagnose(task, &found.best, &request.search.gaits, &request.lower, backend, limit, cancelled)?;
    if let Some(ground) = found.lower_ground.filter(|ground| ground.share > 0. && ground.share < 1.) {
        diagnosis.relaxations.insert(0, Relaxation::relief(ground.share));
    }
    Ok(Some(diagnosis))
}
