//! Data sets whose shards are made by workers.

use super::call::working;
use super::convert::Raise;
use super::workers::device;
use crate::backend::locked;
use crate::dataset::{DatasetPlan, Drafts, Progress, ShardId, Spec};
use crate::error::{Error, from_json, to_json};
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::Ordering;

/// Reads the specification of a data set, with the robots and grounds in it. Returns a plan as JSON, for the other functions.
#[pyfunction]
pub fn dataset_plan(py: Python<'_>, spec: PathBuf, on: &str) -> PyResult<String> {
    py.detach(|| {
        let plan = Spec::read(&spec)?.plan().map_err(|e| e.in_file(&spec, None))?;
        to_json(&plan.origin(&on.parse()?))
    })
    .raise()
}

/// Makes the motions of a shard, with duplicates. Returns them as JSON, for [`dataset_make`].
///
/// * `shard` - index of the robot, and number of the shard
/// * `on` - device
#[pyfunction]
pub fn dataset_drafts(py: Python<'_>, plan: &str, shard: (usize, usize), on: &str, threads: usize) -> PyResult<String> {
    working(py, None, |cancelled, _| {
        let plan = DatasetPlan::of(from_json(plan)?);
        let (robot, number) = shard;
        let drafts = plan.drafts(ShardId { robot, number }, &*device(on, threads, &plan.settings)?, cancelled)?;
        drafts.ok_or_else(|| Error::Ended { message: "stopped before every motion was made".into() })?.to_json()
    })
}

/// Makes a data set from motions of [`dataset_drafts`]. Returns the manifest as JSON.
///
/// * `on` - device of the workers
/// * `drafts` - function of the next shards, which are pairs as in [`dataset_drafts`]. It returns the JSON of the first, or None from time
///   to time, so that the call can be cancelled.
/// * `progress` - called with the number of motions so far and that of all motions
#[pyfunction]
pub fn dataset_make(py: Python<'_>, plan: &str, folder: PathBuf, on: &str, drafts: Py<PyAny>, progress: Py<PyAny>) -> PyResult<String> {
    let exception: Mutex<Option<PyErr>> = Mutex::new(None);
    let failed = |error: PyErr| {
        *locked(&exception) = Some(error);
        Error::Ended { message: "the workers failed".into() }
    };
    let made = working(py, None, |cancelled, _| {
        let plan = DatasetPlan::of(from_json(plan)?);
        let mut next_drafts = |next: &[ShardId]| {
            let next: Vec<(usize, usize)> = next.iter().map(|id| (id.robot, id.number)).collect();
            while !cancelled.load(Ordering::Relaxed) && locked(&exception).is_none() {
                let text: Option<String> =
                    Python::attach(|py| drafts.call1(py, (next.clone(),)).and_then(|text| text.extract(py))).map_err(failed)?;
                if let Some(text) = text {
                    return Drafts::from_json(&text, plan.spec.rate).map(Some);
                }
            }
            Ok(None)
        };
        let mut report = |Progress { motions: [done, all], .. }: Progress| {
            if let Err(error) = Python::attach(|py| progress.call1(py, (done, all))) {
                failed(error);
            }
        };
        to_json(&plan.make_from(&folder, &on.parse()?, &mut next_drafts, &mut report)?)
    });
    match locked(&exception).take() {
        Some(error) => Err(error),
        None => made,
    }
}
