//! CPU backend: solves candidates in index order, one per thread.

use super::{Backend, DeviceChoice, Job, Precision, Solution};
use crate::error::{Error, Result};
use crate::nlp::Problem;
use crate::real::Real;
use crate::solver::{Finish, Solver, Status};
use std::sync::atomic::{AtomicUsize, Ordering};

/// CPU of this machine with a pool of threads.
#[derive(Debug)]
pub struct Cpu {
    pool: rayon::ThreadPool,
}

impl Cpu {
    /// Starts a pool of `threads` threads; 0 means one per processor.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the system does not start the threads.
    pub fn new(threads: usize) -> Result<Cpu> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.map(|pool| Cpu { pool })
            .map_err(|e| Error::invalid("threads", format!("{threads}: {e}"), "a number of threads that the system starts"))
    }

    /// Takes candidates in index order: with an early exit the first ones matter most.
    fn work<T: Real>(
        &self,
        job: &Job,
        finish_at: Finish,
        skip: &(dyn Fn(usize) -> bool + Sync),
        finish: &(dyn Fn(usize, Solution) + Sync),
    ) {
        let next = AtomicUsize::new(0);
        self.pool.scope(|scope| {
            for _ in 0..self.threads().min(job.instances.len()) {
                scope.spawn(|_| {
                    let mut solver = Solver::<T>::default();
                    loop {
                        let index = next.fetch_add(1, Ordering::Relaxed);
                        let Some(instance) = job.instances.get(index) else { break };
                        if skip(index) {
                            continue;
                        }
                        let problem = Problem::<T>::with_cost(
                            instance.task,
                            &instance.schedule,
                            job.transcription,
                            job.settings.optimise.objective(),
                        );
                        let _log = tracing::trace_span!("candidate", index).entered();
                        let outcome = solver.solve(&problem, job.settings, finish_at, None, &|| skip(index));
                        if outcome.status != Status::Cancelled {
                            let Problem { variables, curves, .. } = problem;
                            finish(index, Solution { outcome, x: solver.solution(), variables, curves, closed: false });
                        }
                    }
                });
            }
        });
    }
}

impl Backend for Cpu {
    fn device(&self) -> String {
        format!("cpu, {} threads", self.threads())
    }

    fn choice(&self) -> DeviceChoice {
        DeviceChoice::Cpu
    }

    fn pool(&self) -> &rayon::ThreadPool {
        &self.pool
    }

    fn batch(&self) -> usize {
        16 * self.threads()
    }

    fn solve(&self, job: &Job, skip: &(dyn Fn(usize) -> bool + Sync), finish: &(dyn Fn(usize, Solution) + Sync)) {
        match job.precision {
            Precision::F32 => self.work::<f32>(job, Finish::Infeasibility(job.settings.tolerance), skip, finish),
            Precision::F64 => self.work::<f64>(job, Finish::Rows(job.settings.row_tolerance), skip, finish),
        }
    }
}
