//! Long calls: other threads of Python go on meanwhile, Ctrl-C ends them, and their news are told.

use super::convert::{raised, to_python};
use crate::cli::leg::News;
use crate::error::{Error, Result};
use crate::search::SearchEvent;
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use std::ffi::CString;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

/// How often signals are looked for.
const SIGNALS: Duration = Duration::from_millis(20);

/// Stack of the working thread, bytes: as that of a main thread.
const STACK: usize = 8 << 20;

/// What is told, in a form that can wait for Python.
enum Event {
    Warning(String),
    Progress(&'static str, serde_json::Value),
}

impl Event {
    fn of(news: News) -> Option<Event> {
        match news {
            News::Begun | News::Ended => None,
            News::Warning(finding) => Some(Event::Warning(finding.to_string())),
            News::Progress(SearchEvent::Generation(record)) => Some(Event::Progress("generation", serde_json::to_value(record).ok()?)),
            News::Progress(SearchEvent::Improvement(better)) => Some(Event::Progress("improvement", serde_json::to_value(better).ok()?)),
        }
    }

    /// Warns, or calls back.
    fn tell(self, py: Python<'_>, callback: Option<&Py<PyAny>>) -> PyResult<()> {
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

/// Works on a thread of its own without the lock of the interpreter. An exception of a signal or of the callback ends the work and is raised.
///
/// * `progress` - is called with a dictionary now and then, on the caller's thread
/// * `work` - is told when to end, and tells its news
pub fn working<T: Send>(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&AtomicBool, &mut (dyn FnMut(News) + Send)) -> Result<T> + Send,
) -> PyResult<T> {
    let cancelled = &AtomicBool::new(false);
    let (sender, receiver) = channel();
    let told = progress.is_some();
    py.detach(move || {
        std::thread::scope(|scope| {
            let worker = std::thread::Builder::new().stack_size(STACK).spawn_scoped(scope, move || {
                work(cancelled, &mut |news| {
                    if told || matches!(news, News::Warning(_)) {
                        // Who listens waits for the end of this thread.
                        let _ = Event::of(news).map(|event| sender.send(event));
                    }
                })
            });
            let worker = worker.map_err(|source| raised(Error::Io { action: "start", path: "a thread".into(), source }))?;
            let mut exception = None;
            loop {
                let heard = match receiver.recv_timeout(SIGNALS) {
                    Err(RecvTimeoutError::Disconnected) => break,
                    _ if exception.is_some() => continue,
                    Ok(event) => Python::attach(|py| event.tell(py, progress).and_then(|()| py.check_signals())),
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
