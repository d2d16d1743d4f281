//! Parallel Ipopt solves, each in its own process that runs this program's hidden command `ipopt-worker`.
//!
//! A worker reads one [`Job`] per line from its input and writes one [`Answer`] or error per line. A solve that is no longer needed is
//! stopped by ending its process. [`super::ipopt`] explains why processes are needed.

use super::ipopt::{self, Options};
use super::job::{Answer, Job};
use crate::backend::locked;
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::search::cem::Evaluation;
use crate::search::{Certify, ScheduleSolver};
use crate::task::Task;
use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

/// Hidden command of this program that runs [`serve`].
pub const COMMAND: &str = "ipopt-worker";

/// Interval between checks of the running solves.
const WATCH: Duration = Duration::from_millis(5);

/// Pool of worker processes.
#[derive(Debug, Clone)]
pub struct Workers {
    program: PathBuf,
    /// Number of processes.
    pub count: usize,
}

/// Answer to a job, or the error message.
type Reply = std::result::Result<Answer, String>;

/// Worker: its process and the index of its current job.
#[derive(Default)]
struct Desk {
    child: Option<Child>,
    job: Option<usize>,
}

impl Desk {
    /// Ends the process if there is one.
    fn end(&mut self) {
        if let Some(mut child) = self.child.take() {
            // The process may have ended already.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Number of threads; 0 selects one per processor.
pub fn threads_or_all(threads: usize) -> usize {
    if threads == 0 { std::thread::available_parallelism().map_or(1, |n| n.get()) } else { threads }
}

impl Workers {
    /// Creates a pool of `count` processes of `program`, which must implement [`COMMAND`]; 0 selects one per processor.
    pub fn new(program: PathBuf, count: usize) -> Workers {
        Workers { program, count: threads_or_all(count) }
    }

    /// Device name for results.
    pub fn device(&self) -> String {
        format!("ipopt {}, {} processes", ipopt::VERSION.unwrap_or("none"), self.count)
    }

    /// Solves jobs in order and passes each answer to `finish`, from any thread.
    ///
    /// `skip(index)` is called before and during each solve; if it returns true, the job is dropped.
    ///
    /// # Errors
    /// [`Error::Io`] if a process cannot be started; [`Error::Format`] if a job is refused or its process ends without an answer.
    pub fn solve(&self, jobs: &[Job], skip: &(dyn Fn(usize) -> bool + Sync), finish: &(dyn Fn(usize, Answer) + Sync)) -> Result<()> {
        let (next, done) = (AtomicUsize::new(0), AtomicBool::new(false));
        let desks: Vec<Mutex<Desk>> = (0..self.count.min(jobs.len())).map(|_| Mutex::default()).collect();
        let failure = Mutex::new(None);
        std::thread::scope(|scope| {
            let work = |desk: &Mutex<Desk>| {
                if let Err(error) = self.work(desk, jobs, &next, skip, finish) {
                    next.store(jobs.len(), Ordering::Relaxed);
                    locked(&failure).get_or_insert(error);
                }
                locked(desk).end();
            };
            let threads: Vec<_> = desks.iter().map(|desk| scope.spawn(move || work(desk))).collect();
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    for desk in &desks {
                        let mut desk = locked(desk);
                        if desk.job.is_some_and(skip) {
                            desk.end();
                        }
                    }
                    std::thread::sleep(WATCH);
                }
            });
            for thread in threads {
                // A panic in `finish` ends one worker; the others take its remaining jobs.
                let _ = thread.join();
            }
            done.store(true, Ordering::Relaxed);
        });
        locked(&failure).take().map_or(Ok(()), Err)
    }

    /// Solves jobs and returns their answers in order; `None` for jobs that `cancelled` stopped.
    ///
    /// # Errors
    /// The errors of [`Workers::solve`].
    pub fn answers(&self, jobs: &[Job], cancelled: &AtomicBool) -> Result<Vec<Option<Answer>>> {
        let answers: Vec<Mutex<Option<Answer>>> = jobs.iter().map(|_| Mutex::default()).collect();
        let finish = |index: usize, answer| *locked(&answers[index]) = Some(answer);
        self.solve(jobs, &|_| cancelled.load(Ordering::Relaxed), &finish)?;
        Ok(answers.iter().map(|answer| locked(answer).take()).collect())
    }

    /// Takes jobs until none is left.
    fn work(
        &self,
        desk: &Mutex<Desk>,
        jobs: &[Job],
        next: &AtomicUsize,
        skip: &(dyn Fn(usize) -> bool + Sync),
        finish: &(dyn Fn(usize, Answer) + Sync),
    ) -> Result<()> {
        let mut pipes = None;
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(job) = jobs.get(index) else { return Ok(()) };
            if skip(index) {
                continue;
            }
            // The process may have been ended after its last answer.
            pipes = pipes.filter(|_| locked(desk).child.is_some());
            let (input, output) = match &mut pipes {
                Some(pipes) => pipes,
                None => pipes.insert(self.start(desk)?),
            };
            locked(desk).job = Some(index);
            let mut line = String::new();
            // A process that was ended reads and writes nothing: the check below reports the failure.
            let _ = writeln!(input, "{}", serde_json::to_string(job)?).and_then(|()| input.flush());
            let _ = output.read_line(&mut line);
            locked(desk).job = None;
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

    fn start(&self, desk: &Mutex<Desk>) -> Result<(std::process::ChildStdin, BufReader<std::process::ChildStdout>)> {
        let io = |source| Error::Io { action: "start", path: self.program.clone(), source };
        let mut child = Command::new(&self.program)
            .arg(COMMAND)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .map_err(io)?;
        let pipes = child.stdin.take().zip(child.stdout.take());
        locked(desk).child = Some(child);
        pipes.map(|(input, output)| (input, BufReader::new(output))).ok_or_else(|| io(std::io::ErrorKind::BrokenPipe.into()))
    }
}

/// Answers jobs, one JSON object per line, until the input ends.
///
/// # Errors
/// [`Error::Io`] if reading or writing fails.
pub fn serve(input: impl BufRead, mut output: impl Write) -> Result<()> {
    let io = |action| move |source| Error::Io { action, path: "pipe".into(), source };
    for line in input.lines() {
        let line = line.map_err(io("read"))?;
        let reply: Reply = crate::error::from_json::<Job>(&line).and_then(Job::run).map_err(|e| e.to_string());
        writeln!(output, "{}", serde_json::to_string(&reply)?).and_then(|()| output.flush()).map_err(io("write"))?;
    }
    Ok(())
}

/// Lower level of the paper \[1\]: Ipopt solves each schedule, with its feet stretched to the longest one.
#[derive(Debug, Clone, Copy)]
pub struct IpoptLevel<'a> {
    /// The task.
    pub task: &'a Task,
    /// Worker processes.
    pub workers: &'a Workers,
    /// Ipopt's options.
    pub options: Options,
}

impl ScheduleSolver for IpoptLevel<'_> {
    type Solution = Answer;

    fn solve(
        &self,
        schedules: &[Schedule],
        _: Certify,
        skip: &(dyn Fn(usize) -> bool + Sync),
        finish: &(dyn Fn(usize, Evaluation, Answer) + Sync),
    ) -> Result<()> {
        let jobs: Vec<Job> = schedules.iter().map(|schedule| Job::fixed(self.task, schedule, self.options)).collect();
        self.workers.solve(&jobs, skip, &|index, answer: Answer| {
            let Answer { n_violated, feasible, mean_normal_force, .. } = answer;
            let evaluation = Evaluation { n_violated, feasible, certified: true, mean_normal_force, cost: None };
            finish(index, evaluation, answer);
        })
    }
}
