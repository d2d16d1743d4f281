//! Long calls: they release the interpreter lock, report progress, and end on Ctrl-C.

use super::convert::{raised, to_python};
use crate::app::ProgressEvent;
use crate::error::{Error, Result};
use crate::search::SearchEvent;
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use std::ffi::CString;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

/// Interval at which signals are checked.
const SIGNALS: Duration = Duration::from_millis(20);

/// Stack of the working thread, bytes: that of a main thread.
const STACK: usize = 8 << 20;

/// Progress event in a form that can wait for the interpreter lock.
enum Event {
    Warning(String),
    Progress(&'static str, serde_json::Value),
}

impl Event {
    fn of(event: ProgressEvent) -> Option<Event> {
        match event {
            ProgressEvent::Started | ProgressEvent::Ended => None,
            ProgressEvent::Warning(finding) => Some(Event::Warning(finding.to_string())),
            ProgressEvent::Progress(SearchEvent::Generation(record)) => {
                Some(Event::Progress("generation", serde_json::to_value(record).ok()?))
            }
            ProgressEvent::Progress(SearchEvent::Improvement(better)) => {
                Some(Event::Progress("improvement", serde_json::to_value(better).ok()?))
            }
            ProgressEvent::Progress(SearchEvent::LowerGround(ground)) => {
                Some(Event::Progress("lower-ground", serde_json::to_value(ground).ok()?))
            }
        }
    }

    /// Warns, or calls the callback.
    fn report(self, py: Python<'_>, callback: Option<&Py<PyAny>>) -> PyResult<()> {
        match (self, callback) {
            (Event::Warning(text), _) => {
                let text = CString::new(text).unwrap_or_default();
                PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 2)
            }
            (Event::Progress(kind, record), Some(callback)) => {
                let record = to_python(py, &record)?;
                record.set_item("event", kind)?;
                callback.call1(py, (record,)).map(|_| ())
            }
            (Event::Progress(..), None) => Ok(()),
        }
    }
}

/// Runs work on a thread of its own without the interpreter lock. An exception from a signal or from the callback ends the work and is
/// raised.
///
/// * `progress` - callback that receives a dictionary per event, on the thread of the caller
/// * `work` - receives the flag that cancels it, and a function that takes its events
pub fn working<T: Send>(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&AtomicBool, &mut (dyn FnMut(ProgressEvent) + Send)) -> Result<T> + Send,
) -> PyResult<T> {
    let cancelled = &AtomicBool::new(false);
    let (sender, receiver) = channel();
    let listens = progress.is_some();
    py.detach(move || {
        std::thread::scope(|scope| {
            let worker = std::thread::Builder::new().stack_size(STACK).spawn_scoped(scope, move || {
                work(cancelled, &mut |event| {
                    if listens || matches!(event, ProgressEvent::Warning(_)) {
                        // The receiver lives until this thread ends.
                        let _ = Event::of(event).map(|event| sender.send(event));
                    }
                })
            });
            let worker = worker.map_err(|source| raised(Error::Io { action: "start", path: "a thread".into(), source }))?;
            let mut exception = None;
            loop {
                let heard = match receiver.recv_timeout(SIGNALS) {
                    Err(RecvTimeoutError::Disconnected) => break,
                    _ if exception.is_some() => continue,
                    Ok(event) => Python::attach(|py| event.report(py, progress).and_then(|()| py.check_signals())),
                    Err(RecvTimeoutError::Timeout) => Python::attach(|py| py.check_signals()),
                };
                if let Err(raised) = heard {
                    cancelled.store(true, Ordering::Relaxed);
                    exception = Some(raised);
                }
            }
            let done = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            exception.map_or_else(|| done.map_err(raised), Err)
        })
    })
}
