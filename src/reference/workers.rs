//! Several Ipopts at once, each in a process of its own: this program's hidden command `ipopt-worker`.
//!
//! A worker reads a [`Job`] a line from its input and writes an [`Answer`] or an error a line. A solve that is no longer wanted is ended with its
//! process. Why processes: see [`super::ipopt`].

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

/// A worker: its process, and the index of the job that it is at work on.
#[derive(Default)]
struct Desk {
    child: Option<Child>,
    job: Option<usize>,
}

impl Desk {
    /// Ends the process, if there is one.
    fn end(&mut self) {
        if let Some(mut child) = self.child.take() {
            // It may have ended by itself.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// A number of threads, where 0 is one a processor.
pub fn threads_or_all(threads: usize) -> usize {
    if threads == 0 { std::thread::available_parallelism().map_or(1, |n| n.get()) } else { threads }
}

impl Workers {
    /// Processes of `program`, which must know [`COMMAND`]: `count` of them, or one a processor when that is 0.
    pub fn new(program: PathBuf, count: usize) -> Workers {
        Workers { program, count: threads_or_all(count) }
    }

    /// Name for results.
    pub fn device(&self) -> String {
        format!("ipopt {}, {} processes", ipopt::VERSION.unwrap_or("none"), self.count)
    }

    /// Solves jobs in order and hands each answer to `finish`, from any thread.
    ///
    /// `skip(index)` is asked before and during each solve; when it says so, that job is dropped.
    ///
    /// # Errors
    /// [`Error::Io`] when a process cannot be started; [`Error::Format`] when a job is refused or its process ends without an answer.
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
                // A panic of `finish` ends one worker; the jobs it had left go to the others.
                let _ = thread.join();
            }
            done.store(true, Ordering::Relaxed);
        });
        locked(&failure).take().map_or(Ok(()), Err)
    }

    /// Solves jobs; the answers have their order, none where `cancelled` came first.
    ///
    /// # Errors
    /// As [`Workers::solve`].
    pub fn answers(&self, jobs: &[Job], cancelled: &AtomicBool) -> Result<Vec<Option<Answer>>> {
        let answers: Vec<Mutex<Option<Answer>>> = jobs.iter().map(|_| Mutex::default()).collect();
        let finish = |index: usize, answer| *locked(&answers[index]) = Some(answer);
        self.solve(jobs, &|_| cancelled.load(Ordering::Relaxed), &finish)?;
        Ok(answers.iter().map(|answer| locked(answer).take()).collect())
    }

    /// Takes jobs until there are none.
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
            // It may have been ended after its last answer.
            pipes = pipes.filter(|_| locked(desk).child.is_some());
            let (input, output) = match &mut pipes {
                Some(pipes) => pipes,
                None => pipes.insert(self.start(desk)?),
            };
            locked(desk).job = Some(index);
            let mut line = String::new();
            // A process that was ended reads and writes nothing: what failed is told below.
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

/// The lower level of the paper \[1\]: each schedule to Ipopt, its feet stretched to the longest.
#[derive(Debug, Clone, Copy)]
pub struct IpoptLevel<'a> {
    /// The task.
    pub task: &'a Task,
    /// Processes.
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
