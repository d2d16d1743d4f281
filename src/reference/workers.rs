//! Several Ipopts at once, each in a process of its own: this program's hidden command `ipopt-worker`.
//!
//! A worker reads a [`Job`] a line from its input and writes an [`Answer`] or an error a line. A solve that is no longer wanted is ended with its
//! process. Why processes: see [`super::ipopt`].

use super::job::{Answer, Job};
use crate::error::{Error, Result};
use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

/// The hidden command of this program that [`serve`]s.
pub const COMMAND: &str = "ipopt-worker";

/// How often running solves are looked at.
const WATCH: Duration = Duration::from_millis(5);

/// Where jobs are solved.
#[derive(Debug, Clone)]
pub struct Workers {
    program: PathBuf,
    /// Processes.
    pub count: usize,
}

/// Answer to a job, or why there is none.
type Reply = std::result::Result<Answer, String>;

/// A worker that may be at work on a job.
#[derive(Default)]
struct Desk {
    child: Mutex<Option<Child>>,
    /// Index of the job, `usize::MAX` without one.
    job: AtomicUsize,
}

impl Desk {
    /// Ends the process, if there is one.
    fn end(&self) {
        let mut child = self.child.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        if let Some(mut child) = child.take() {
            // It may have ended by itself.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

impl Workers {
    /// Processes of `program`, which must know [`COMMAND`]: `count` of them, or one a processor when that is 0.
    pub fn new(program: PathBuf, count: usize) -> Workers {
        let count = if count == 0 { std::thread::available_parallelism().map_or(1, |n| n.get()) } else { count };
        Workers { program, count }
    }

    /// Solves jobs in order and hands each answer to `finish`, from any thread.
    ///
    /// `skip(index)` is asked before and during each solve; when it says so, that job is dropped.
    ///
    /// # Errors
    /// [`Error::Io`] when a process cannot be started; [`Error::Format`] when a job is refused or its process ends without an answer.
    pub fn solve(&self, jobs: &[Job], skip: &(dyn Fn(usize) -> bool + Sync), finish: &(dyn Fn(usize, Answer) + Sync)) -> Result<()> {
        let (next, done) = (AtomicUsize::new(0), AtomicBool::new(false));
        let desks: Vec<Desk> = (0..self.count.min(jobs.len())).map(|_| Desk::default()).collect();
        let failure = Mutex::new(None);
        std::thread::scope(|scope| {
            let work = |desk: &Desk| {
                if let Err(error) = self.work(desk, jobs, &next, skip, finish) {
                    next.store(jobs.len(), Ordering::Relaxed);
                    failure.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).get_or_insert(error);
                }
                desk.end();
            };
            let threads: Vec<_> = desks.iter().map(|desk| scope.spawn(move || work(desk))).collect();
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    for desk in &desks {
                        let job = desk.job.load(Ordering::Relaxed);
                        if job != usize::MAX && skip(job) {
                            desk.end();
                        }
                    }
                    std::thread::sleep(WATCH);
                }
            });
            for thread in threads {
                // A panic of `finish` is passed on when the scope ends.
                let _ = thread.join();
            }
            done.store(true, Ordering::Relaxed);
        });
        failure.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner()).map_or(Ok(()), Err)
    }

    /// Takes jobs until there are none.
    fn work(
        &self,
        desk: &Desk,
        jobs: &[Job],
        next: &AtomicUsize,
        skip: &(dyn Fn(usize) -> bool + Sync),
        finish: &(dyn Fn(usize, Answer) + Sync),
    ) -> Result<()> {
        let mut pipes = None;
        loop {
            desk.job.store(usize::MAX, Ordering::Relaxed);
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(job) = jobs.get(index) else { return Ok(()) };
            if skip(index) {
                continue;
            }
            let (input, output) = match &mut pipes {
                Some(pipes) => pipes,
                None => pipes.insert(self.start(desk)?),
            };
            desk.job.store(index, Ordering::Relaxed);
            let mut line = String::new();
            // A process that was ended reads and writes nothing: what failed is told below.
            let _ = writeln!(input, "{}", serde_json::to_string(job)?).and_then(|()| input.flush());
            let _ = output.read_line(&mut line);
            if !line.ends_with('\n') {
                pipes = None;
                if skip(index) {
                    continue;
                }
                return Err(Error::Format { message: format!("Ipopt's process ended without an answer to candidate {index}") });
            }
            match serde_json::from_str::<Reply>(&line)? {
                Ok(answer) => finish(index, answer),
                Err(message) => return Err(Error::Format { message: format!("candidate {index}: {message}") }),
            }
        }
    }

    fn start(&self, desk: &Desk) -> Result<(std::process::ChildStdin, BufReader<std::process::ChildStdout>)> {
        let io = |source| Error::Io { action: "start", path: self.program.clone(), source };
        let mut child =
            Command::new(&self.program).arg(COMMAND).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().map_err(io)?;
        let pipes = child.stdin.take().zip(child.stdout.take());
        *desk.child.lock().unwrap_or_else(|poisoned| poisoned.into_inner()) = Some(child);
        pipes.map(|(input, output)| (input, BufReader::new(output))).ok_or_else(|| io(std::io::ErrorKind::BrokenPipe.into()))
    }
}

/// Answers jobs, one JSON object a line, until the input ends.
///
/// # Errors
/// [`Error::Io`] when input or output breaks.
pub fn serve(input: impl BufRead, mut output: impl Write) -> Result<()> {
    let io = |action| move |source| Error::Io { action, path: "pipe".into(), source };
    for line in input.lines() {
        let line = line.map_err(io("read"))?;
        let reply: Reply = crate::error::from_json::<Job>(&line).and_then(Job::run).map_err(|e| e.to_string());
        writeln!(output, "{}", serde_json::to_string(&reply)?).and_then(|()| output.flush()).map_err(io("write"))?;
    }
    Ok(())
}
