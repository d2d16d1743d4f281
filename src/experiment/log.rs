//! Log of finished runs: one JSON object per line, written as runs end.

use super::plan::Case;
use super::run::{Run, machine};
use crate::error::{Error, Result, from_json};
use crate::files;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Log of an experiment. Runs of other machines, versions or thread counts are kept in the file but ignored.
#[derive(Debug)]
pub struct Log {
    path: PathBuf,
    /// Locked, so that no other run can append.
    file: fs::File,
    machine: String,
    threads: usize,
    runs: Vec<Run>,
}

impl Log {
    /// Opens or creates a log. An incomplete last line is removed from the file.
    ///
    /// * `threads` - thread count of the runs that are used
    ///
    /// # Errors
    /// See [`files::open_alone`]; [`Error::InFile`] for a line that is not a run.
    pub fn open(path: &Path, threads: usize) -> Result<Log> {
        let file = files::open_alone(path)?;
        let mut log = Log { path: path.to_owned(), file, machine: machine(), threads, runs: Vec::new() };
        let text = files::read(path)?;
        let whole = &text[..text.rfind('\n').map_or(0, |end| end + 1)];
        for (number, line) in files::lines(whole) {
            let run = from_json(line).map_err(|e| e.in_file(path, Some(number)))?;
            log.keep(run);
        }
        if whole.len() < text.len() {
            log.file.set_len(whole.len() as u64).map_err(|source| Error::Io { action: "write", path: path.to_owned(), source })?;
        }
        Ok(log)
    }

    /// Runs made by this version on an equal machine with as many threads, in the order in which they were made.
    pub fn runs(&self) -> &[Run] {
        &self.runs
    }

    /// True if a run is finished.
    pub fn has(&self, case: &Case) -> bool {
        self.runs.iter().any(|run| run.case == *case)
    }

    /// Appends a run, in memory and to the file.
    ///
    /// # Errors
    /// [`Error::Io`] if the system refuses.
    pub fn add(&mut self, run: Run) -> Result<()> {
        let line = serde_json::to_string(&run)? + "\n";
        let io = |source| Error::Io { action: "write", path: self.path.clone(), source };
        self.file.write_all(line.as_bytes()).and_then(|()| self.file.sync_data()).map_err(io)?;
        self.keep(run);
        Ok(())
    }

    fn keep(&mut self, run: Run) {
        // A single solve uses one thread anyway.
        let threads = run.threads == self.threads || !run.case.method.searches();
        if run.version == env!("CARGO_PKG_VERSION") && run.machine == self.machine && threads {
            self.runs.push(run);
        }
    }
}
