//! The search: draws schedules, solves and certifies them, and returns the cheapest gait.
//!
//! The search is anytime and has five stages:
//! 1. The typical gait of every family that is possible for the robot, shortest first. If the first gait ends the search, the families keep
//!    their order instead, which begins with the family most likely to work, e.g. a trot.
//! 2. Generations of the cross-entropy method over families, durations, speed and phase offsets. Additional generations run while no gait
//!    is certified, or none that the joints of the robot can follow.
//! 3. If no gait was found on uneven ground: a first gait on ground of half the relief, which then rises step by step while gaits in the
//!    neighbourhood of the last one hold.
//! 4. Generations in the neighbourhood of the best gait.
//! 5. Descents along the durations of the best gaits, and along those of the best gait with fewer and more strides. ANYmal's gaits of 6 m
//!    with half a turn cost 1.83 with the 24 strides that they were drawn with, 1.34 with 12, and 1.25 if the horizon may become shorter
//!    with each stride and forces have four pieces.
//!
//! Every improvement is reported. Once a certified gait exists, the search ranks candidates by the solver's status and certifies only those
//! that would be the best of their family, in the order of their cost, until a certificate is valid.
//!
//! All decisions count candidates, not time, so a seed gives the same gait with any number of threads. A time limit or a cancellation only
//! ends the search.

pub mod atlas;
mod batch;
pub mod cem;
pub mod diagnosis;
pub mod evaluate;
mod needed;
mod on_demand;
mod population;
pub mod precheck;
mod settings;
mod stages;
mod timed;

pub use batch::{BatchSolver, Incumbent, ScheduleSolver};
pub use evaluate::{Cancelled, Certify};
pub use settings::{Gaits, SearchSettings};
pub use stages::LowerGround;
pub use timed::{CemSearchResult, search_with};

use crate::backend::{Backend, Solution};
use crate::error::Result;
use crate::gait::family::GaitFamily;
use crate::gait::{Schedule, Trajectory};
use crate::nlp::Curves;
use crate::nlp::transcription::force_limit;
use crate::refine::{RefineSettings, Refined, refine};
use crate::task::Task;
use crate::verify::{Report, verify};
use cem::{Candidate, GenerationRecord, Objective, StopReason};
use evaluate::{Evaluated, EvaluationContext, LowerSettings};
use population::MAX_SOLUTIONS;
use stages::SearchState;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use timed::{Clock, TimedEvaluator};

/// Gait that a search returns, with its motion and certificate.
#[derive(Debug, Clone)]
pub struct Gait {
    /// Candidate that the gait was: family, generation, index, schedule as drawn, objective and solution.
    pub candidate: Candidate<Evaluated>,
    trajectory: Trajectory,
    certificate: Report,
}

impl Gait {
    /// True if every row of the certificate holds.
    pub fn feasible(&self) -> bool {
        self.candidate.solution.feasible
    }

    /// Motion, contact schedule and forces.
    pub fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }

    /// Certificate of the independent check.
    pub fn certificate(&self) -> &Report {
        &self.certificate
    }

    /// Schedule, in which all feet end with the motion.
    pub fn schedule(&self) -> &Schedule {
        &self.candidate.solution.schedule
    }

    /// Computes the motion and the certificate of a candidate.
    fn new(candidate: Candidate<Evaluated>, task: &Task, lower: &LowerSettings) -> Result<Gait> {
        let trajectory = candidate.solution.trajectory(task, &lower.transcription);
        let certificate = verify(&trajectory, &task.robot, &task.terrain, force_limit(&lower.transcription, task))?;
        Ok(Gait { candidate, trajectory, certificate })
    }

    /// Refines the gait to a local optimum of its cost, with the phase durations among the variables; see [`refine`]. A gait without a
    /// valid certificate stays unchanged.
    ///
    /// * `task`, `search`, `lower` - task and settings of the search that found the gait
    /// * `backend` - backend whose CPU threads are used
    /// * `cancelled` - returns true if the refinement is to end with the best gait so far
    ///
    /// # Errors
    /// Errors of [`refine`].
    pub fn refined(
        &self,
        task: &Task,
        search: &SearchSettings,
        lower: &LowerSettings,
        settings: &RefineSettings,
        backend: &dyn Backend,
        cancelled: Cancelled,
    ) -> Result<(Gait, Refined)> {
        let Evaluated { outcome, schedule, x, .. } = &self.candidate.solution;
        let refined = || refine(task, schedule, x, &lower.transcription, &search.cost, settings, cancelled);
        let refined = backend.pool().install(refined)?;
        let curves = Curves::new(task, &refined.schedule, &lower.transcription);
        let solution = Solution { outcome: *outcome, x: refined.x.clone(), variables: curves.variables, curves, closed: true };
        let context = EvaluationContext { task, schedule: &refined.schedule, settings: lower, weights: Some(&search.cost) };
        let solution = context.examined(solution);
        let candidate = self.candidate.evaluated_again(&search.cem(1), solution.evaluation, solution);
        Ok((Gait::new(candidate, task, lower)?, refined))
    }
}

/// Gait that is better than all before it.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Improvement {
    /// Gait family, if the gait was drawn from one or from the neighbourhood of one.
    pub family: Option<GaitFamily>,
    /// Generation of the gait.
    pub generation: usize,
    /// Number of candidates evaluated by the end of that generation.
    pub candidates: usize,
    /// Time from the start, s.
    pub seconds: f64,
    /// Objective of the gait, maximised.
    pub objective: f64,
}

/// Event of a running search.
#[derive(Debug)]
pub enum SearchEvent<'a> {
    /// A generation ended.
    Generation(&'a GenerationRecord),
    /// A better certified gait was found.
    Improvement(&'a Improvement),
    /// Gaits were searched on lower ground.
    LowerGround(&'a LowerGround),
}

/// Result of a search.
#[derive(Debug)]
pub struct SearchResult {
    /// Best certified gait, or the candidate with the fewest violations if no gait was found.
    pub best: Gait,
    /// Best gaits of other families, cheapest first, if [`SearchSettings::alternatives`] requests them.
    pub alternatives: Vec<Gait>,
    /// Statistics of each generation.
    pub generations: Vec<GenerationRecord>,
    /// Number of minimisations with which durations were optimised at the end.
    pub duration_solves: usize,
    /// Search on lower ground, if the search needed one.
    pub lower_ground: Option<LowerGround>,
    /// Every gait that was the best so far.
    pub improvements: Vec<Improvement>,
    /// Reason for the end.
    pub stop: StopReason,
    /// Time from the start to the end of the first successful certification, s.
    pub first_feasible_after: Option<f64>,
    /// Total time of the search, s.
    pub seconds: f64,
}

/// Callback for the events of a search.
type EventCallback<'a> = Box<dyn FnMut(&SearchEvent) + Send + 'a>;

/// Search for a gait.
///
/// ```
/// use cregopt::{Cpu, Goal, Robot, Search, Task, Terrain};
///
/// let task = Task::new(Robot::named("biped")?, Terrain::flat(), Goal::at(1.0, 0.0))?;
/// let found = Search::new(&task).seed(1).population(4).generations(1).run(&Cpu::new(0)?)?;
/// assert!(found.best.feasible());
/// println!("{}", found.best.certificate());
/// # Ok::<(), cregopt::Error>(())
/// ```
pub struct Search<'a> {
    task: &'a Task,
    settings: SearchSettings,
    lower: LowerSettings,
    seed: u64,
    cancelled: Option<&'a AtomicBool>,
    on_event: Option<EventCallback<'a>>,
    /// Number of solutions kept per generation. The result does not depend on it.
    max_solutions: usize,
}

impl std::fmt::Debug for Search<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Search").field("settings", &self.settings).field("seed", &self.seed).finish_non_exhaustive()
    }
}

impl<'a> Search<'a> {
    /// A search with the default settings and seed 1.
    pub fn new(task: &'a Task) -> Self {
        let (settings, lower) = (SearchSettings::default(), LowerSettings::default());
        Search { task, settings, lower, seed: 1, cancelled: None, on_event: None, max_solutions: MAX_SOLUTIONS }
    }

    /// Sets the settings of the search.
    pub fn settings(self, settings: SearchSettings) -> Self {
        Search { settings, ..self }
    }

    /// Sets the settings of the lower level: variables, rows, solver.
    pub fn lower(self, lower: LowerSettings) -> Self {
        Search { lower, ..self }
    }

    /// Sets the seed of all random numbers.
    pub fn seed(self, seed: u64) -> Self {
        Search { seed, ..self }
    }

    /// Sets the number of candidates per generation; the elites keep their share of it.
    pub fn population(mut self, population: usize) -> Self {
        self.settings = self.settings.with_population(population);
        self
    }

    /// Sets the largest number of generations after the typical gaits of the families.
    pub fn generations(mut self, generations: usize) -> Self {
        self.settings.generations = generations;
        self
    }

    /// Sets the gaits that are searched.
    pub fn gaits(mut self, gaits: Gaits) -> Self {
        self.settings.gaits = gaits;
        self
    }

    /// Makes the search end with the first certified gait.
    pub fn first(mut self) -> Self {
        self.settings.first = true;
        self
    }

    /// Sets a flag that ends the search with the best gait so far.
    pub fn cancelled_by(self, flag: &'a AtomicBool) -> Self {
        Search { cancelled: Some(flag), ..self }
    }

    /// Sets a callback for generations and improvements.
    pub fn on_progress(self, on_event: impl FnMut(&SearchEvent) + Send + 'a) -> Self {
        Search { on_event: Some(Box::new(on_event)), ..self }
    }

    /// Runs the search.
    ///
    /// # Errors
    /// [`Invalid`](crate::Error::Invalid) for settings or a task outside their limits, [`Unknown`](crate::Error::Unknown) for a family that the
    /// robot cannot have, [`Ended`](crate::Error::Ended) if no candidate was solved before the end.
    pub fn run(self, backend: &dyn Backend) -> Result<SearchResult> {
        let Search { task, settings, mut lower, seed, cancelled, mut on_event, max_solutions } = self;
        settings.validate()?;
        lower.validate()?;
        task.validate()?;
        settings.minimise(&task.robot, &mut lower);
        let incumbent = Incumbent::default();
        // The cost of the solver's rows is that of the search.
        let limits = settings.objective == Objective::Transport;
        let solver = BatchSolver { task, settings: &lower, backend, cost: Some(&settings.cost), incumbent: limits.then_some(&incumbent) };
        let clock = Clock::new(cancelled, settings.seconds.map(Duration::from_secs_f64));
        let mut on_event = |event: &SearchEvent| {
            if let Some(on_event) = on_event.as_mut() {
                on_event(event);
            }
        };
        let mut evaluator = TimedEvaluator::new(&solver, clock).certifying_on_demand().max_solutions(max_solutions);
        let mut state = SearchState::new(&solver, &settings, seed, clock, &mut on_event);
        let stop = state.run(&mut evaluator)?;
        state.finish(stop, evaluator.first_feasible_after)
    }
}

#[cfg(test)]
mod tests;
