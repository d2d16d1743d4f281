//! The search: draws schedules, solves and certifies them, and returns the cheapest gait.
//!
//! The search is anytime and has three stages:
//! 1. The typical gait of every family that is possible for the robot, shortest first. If the first gait ends the search, the families keep
//!    their order, which begins with a trot or tripod.
//! 2. Generations of the cross-entropy method over families, durations, speed and phase offsets. Additional generations run while no gait
//!    is certified, or none that the joints of the robot can follow.
//! 3. Generations in the neighbourhood of the best gait.
//!
//! Every improvement is reported. Once a certified gait exists, the search ranks candidates by the solver's status and certifies only those
//! that would be the best of their family, in the order of their cost, until a certificate is valid.
//!
//! All decisions count candidates, not time, so a seed gives the same gait with any number of threads. A time limit or a cancellation only
//! ends the search.

pub mod atlas;
mod batch;
pub mod cem;
mod contenders;
pub mod diagnosis;
pub mod evaluate;
mod population;
pub mod precheck;
mod settings;

pub use batch::{BatchSolver, Found, LowerLevel, Solved, search_with};
pub use evaluate::{Cancelled, Certify};
pub use settings::{Gaits, SearchSettings};

use crate::backend::Backend;
use crate::error::{Error, Result};
use crate::gait::family::{GaitFamily, families};
use crate::gait::joints;
use crate::gait::{Schedule, Trajectory};
use crate::nlp::Layout;
use crate::nlp::transcription::force_limit;
use crate::refine::{RefineSettings, Refined, refine};
use crate::task::Task;
use crate::verify::{Report, verify};
use batch::{Clock, Timed};
use cem::{
    Aim, Candidate, CemSettings, Distribution, Evaluator, FreeDistribution, Generation, GenerationRecord, Member, PeriodicDistribution,
    PerturbDistribution, Sampler, StopReason, Stopping,
};
use contenders::best_certified;
use evaluate::{Evaluated, LowerSettings, examined};
use population::KEPT;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use tracing::{debug, info};

/// Gait that a search returns, with its motion and certificate.
#[derive(Debug, Clone)]
pub struct Gait {
    /// Gait family, if the gait was drawn from one or from the neighbourhood of one.
    pub family: Option<GaitFamily>,
    /// Candidate that the gait was: generation, index, schedule as drawn, objective and solution.
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
    fn new(family: Option<GaitFamily>, candidate: Candidate<Evaluated>, task: &Task, lower: &LowerSettings) -> Result<Gait> {
        let trajectory = candidate.solution.trajectory(task, &lower.transcription);
        let certificate = verify(&trajectory, &task.robot, &task.terrain, force_limit(&lower.transcription, task))?;
        Ok(Gait { family, candidate, trajectory, certificate })
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
        let layout = Layout::<f64>::new(task, &refined.schedule, &lower.transcription);
        let solution =
            examined(task, &refined.schedule, (&layout.curves, layout.variables), (*outcome, refined.x.clone()), lower, Some(&search.cost));
        let (old, as_drawn) = (&self.candidate, self.candidate.schedule.clone());
        let candidate = Candidate::new(&search.cem(1), old.generation, old.index, as_drawn, solution.evaluation(), solution);
        Ok((Gait::new(self.family, candidate, task, lower)?, refined))
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
pub enum Progress<'a> {
    /// A generation ended.
    Generation(&'a GenerationRecord),
    /// A better certified gait was found.
    Improvement(&'a Improvement),
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
type Listener<'a> = Box<dyn FnMut(&Progress) + Send + 'a>;

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
    progress: Option<Listener<'a>>,
    /// Number of solutions kept per generation. The result does not depend on it.
    kept: usize,
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
        Search { task, settings, lower, seed: 1, cancelled: None, progress: None, kept: KEPT }
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
    pub fn on_progress(self, progress: impl FnMut(&Progress) + Send + 'a) -> Self {
        Search { progress: Some(Box::new(progress)), ..self }
    }

    /// Runs the search.
    ///
    /// # Errors
    /// [`Error::Invalid`] for settings or a task outside their limits, [`Error::Unknown`] for a family that the robot cannot have,
    /// [`Error::Ended`] if no candidate was solved before the end.
    pub fn run(self, backend: &dyn Backend) -> Result<SearchResult> {
        let Search { task, settings, lower, seed, cancelled, mut progress, kept } = self;
        settings.validate()?;
        lower.validate()?;
        task.validate()?;
        let level = BatchSolver { task, settings: &lower, backend, cost: Some(&settings.cost) };
        let clock = Clock::new(cancelled, settings.seconds.map(Duration::from_secs_f64));
        let mut tell = |p: &Progress| {
            if let Some(progress) = progress.as_mut() {
                progress(p);
            }
        };
        let mut timed = Timed::new(&level, clock).on_demand().keeping(kept);
        let mut session = Session {
            task,
            level: &level,
            settings: &settings,
            seed,
            clock,
            tell: &mut tell,
            best: None,
            nearest: None,
            by_family: Vec::new(),
            generations: Vec::new(),
            improvements: Vec::new(),
        };
        let stop = session.all(&mut timed)?;
        session.finish(stop, &lower, timed.first_feasible_after)
    }
}

/// State of a running search.
struct Session<'a, 's> {
    task: &'a Task,
    level: &'a BatchSolver<'a>,
    settings: &'a SearchSettings,
    seed: u64,
    clock: Clock<'a>,
    tell: &'s mut dyn FnMut(&Progress),
    /// Best certified candidate, with its family.
    best: Option<(Option<GaitFamily>, Candidate<Evaluated>)>,
    /// Candidate with the fewest violations while no candidate is certified, with its family.
    nearest: Option<(Option<GaitFamily>, Candidate<Evaluated>)>,
    /// Best certified candidate of each family.
    by_family: Vec<(GaitFamily, Candidate<Evaluated>)>,
    generations: Vec<GenerationRecord>,
    improvements: Vec<Improvement>,
}

/// Schedule with its family, if it has one.
type Named = (Option<GaitFamily>, Schedule);

/// Lower level of the search.
type Level<'a> = Timed<'a, BatchSolver<'a>>;

impl Session<'_, '_> {
    /// Runs all stages. Returns the reason for the end.
    fn all(&mut self, timed: &mut Level) -> Result<StopReason> {
        let settings = self.settings;
        let stop = match &settings.gaits {
            Gaits::Free => {
                let distribution = FreeDistribution::initial(&settings.free, self.task.robot.feet())?;
                self.until_found(timed, distribution)?
            }
            Gaits::Around(schedule) => match self.generation(timed, vec![(None, schedule.clone())])? {
                Some(stop) => stop,
                None => {
                    let distribution = PerturbDistribution::initial(&self.task.robot, schedule, &settings.perturb)?;
                    self.until_found(timed, distribution)?
                }
            },
            Gaits::All => self.periodic(timed, &families(&self.task.robot))?,
            Gaits::Families(families) => self.periodic(timed, families)?,
        };
        let goes_on = matches!(stop, StopReason::GenerationLimit | StopReason::Converged) && self.learns() && self.moves();
        if goes_on && settings.perturbed_generations > 0 { self.perturbed(timed).map(|s| s.unwrap_or(stop)) } else { Ok(stop) }
    }

    /// True if the distribution is fitted to the elites.
    fn learns(&self) -> bool {
        self.settings.free.sampler == Sampler::Cem
    }

    /// True if the best gait has a swing. Other phase times cannot improve standing still.
    fn moves(&self) -> bool {
        self.best.as_ref().is_some_and(|(_, b)| b.stances.iter().any(|n| *n > 1))
    }

    /// Evaluates the typical gaits of the families, then runs generations over them.
    fn periodic(&mut self, timed: &mut Level, families: &[GaitFamily]) -> Result<StopReason> {
        let settings = self.settings;
        let mut distribution = PeriodicDistribution::initial(self.task, families, &settings.periodic)?;
        let (mut typical, mut refused): (Vec<Named>, Vec<(GaitFamily, Error)>) = (Vec::new(), Vec::new());
        for (sample, family) in distribution.means().iter().zip(families) {
            match distribution.schedule(sample).and_then(|schedule| self.level.check(&schedule).map(|()| schedule)) {
                Ok(schedule) => typical.push((Some(*family), schedule)),
                Err(error) => refused.push((*family, error)),
            }
        }
        // A distance that is too long for one family may be possible for another.
        for (family, error) in refused {
            if typical.is_empty() {
                return Err(error);
            }
            info!("without {family}: {error}");
        }
        let families: Vec<GaitFamily> = typical.iter().filter_map(|(family, _)| *family).collect();
        if families.len() < distribution.families.len() {
            distribution = PeriodicDistribution::initial(self.task, &families, &settings.periodic)?;
        }
        let stands = |schedule: &Schedule| (0..schedule.feet()).all(|foot| schedule.stances(foot) == 1);
        if let Some((_, still)) = typical.iter().find(|(_, schedule)| stands(schedule)) {
            // Standing still belongs to no family, and no gait is better.
            let still = vec![(None, still.clone())];
            if let Some(stop) = self.generation(timed, still)? {
                return Ok(stop);
            }
            if self.best.is_some() {
                return Ok(StopReason::Converged);
            }
        }
        if let Some(stop) = self.generation(timed, typical)? {
            return Ok(stop);
        }
        // Families that did well are drawn more often.
        let mut ranked: Vec<(usize, f64)> = families
            .iter()
            .enumerate()
            .filter_map(|(i, family)| self.by_family.iter().find(|(f, _)| f == family).map(|(_, c)| (i, c.objective)))
            .collect();
        ranked.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let means = distribution.means();
        let elites: Vec<_> = ranked.iter().take(settings.elites).map(|(i, _)| &means[*i]).collect();
        if self.learns() {
            distribution.update_families(&elites);
        }
        self.until_found(timed, distribution)
    }

    /// Runs the planned generations over a distribution, then further ones while no gait exists or none that the joints can follow.
    fn until_found<D: Distribution>(&mut self, timed: &mut Level, distribution: D) -> Result<StopReason> {
        let settings = self.settings;
        let (mut stop, mut distribution) = match settings.generations {
            0 => (StopReason::GenerationLimit, distribution),
            planned => self.cem(timed, &settings.cem(planned), distribution, None)?,
        };
        for _ in 0..settings.further_generations {
            if stop != StopReason::GenerationLimit || self.within_joint_limits()? {
                break;
            }
            let mut further = settings.cem(1);
            if self.best.is_none() {
                further.stopping = Stopping::FirstFeasible;
            }
            (stop, distribution) = self.cem(timed, &further, distribution, None)?;
            if stop == StopReason::FirstFeasible && !settings.first {
                stop = StopReason::GenerationLimit;
            }
        }
        Ok(stop)
    }

    /// True if a gait exists and, where that is preferred, its joints stay within their limits.
    fn within_joint_limits(&self) -> Result<bool> {
        let Some((_, best)) = &self.best else { return Ok(false) };
        let exceeded = best.evaluation.cost.is_some_and(|cost| cost.joint_cost > 0.);
        if !exceeded || !self.settings.prefers_joint_limits() {
            return Ok(true);
        }
        let trajectory = best.solution.trajectory(self.task, &self.level.settings.transcription);
        Ok(joints::limits(&trajectory, &self.task.robot)?.is_none_or(|limits| limits.kept))
    }

    /// Runs generations in the neighbourhood of the best gait.
    fn perturbed(&mut self, timed: &mut Level) -> Result<Option<StopReason>> {
        let Some((family, best)) = &self.best else { return Ok(None) };
        let family = *family;
        let settings = self.settings;
        let distribution = PerturbDistribution::initial(&self.task.robot, &best.solution.schedule, &settings.perturb)?;
        let (stop, _) = self.cem(timed, &settings.cem(settings.perturbed_generations), distribution, family)?;
        Ok(Some(stop))
    }

    /// Runs one generation of given schedules. Returns the reason if the search ends with it.
    fn generation(&mut self, timed: &mut Level, mut named: Vec<Named>) -> Result<Option<StopReason>> {
        let generation = self.generations.len();
        if !self.settings.first {
            // Short schedules are solved fastest.
            named.sort_by(|(_, a), (_, b)| a.horizon().total_cmp(&b.horizon()));
        }
        let (families, schedules): (Vec<Option<GaitFamily>>, Vec<Schedule>) = named.into_iter().unzip();
        let settings = self.settings.cem(1);
        let aim = Aim::all(&settings, &schedules).or_first(self.settings.first);
        let results = timed.evaluate(generation, &schedules, &aim);
        timed.failure()?;
        let candidates = schedules.into_iter().zip(results).zip(families).enumerate();
        let ranked: Vec<(Option<GaitFamily>, Member<Evaluated>)> = candidates
            .filter_map(|(index, ((schedule, result), family))| {
                let (evaluation, solution) = result?;
                Some((family, Candidate::new(&settings, generation, index, schedule, evaluation, solution)))
            })
            .collect();
        let record = cem::summarise(generation, ranked.iter().map(|(_, candidate)| candidate), 0., 0.);
        self.look(&Generation { record: &record, ranked: &ranked }, None);
        let found = self.best.is_some() && self.settings.first;
        Ok(if found { Some(StopReason::FirstFeasible) } else { timed.cancelled().then(|| self.clock.stop()) })
    }

    /// Runs generations of the cross-entropy method over a distribution.
    ///
    /// * `family` - family of all samples of a distribution without families
    fn cem<D: Distribution>(
        &mut self,
        timed: &mut Level,
        settings: &CemSettings,
        distribution: D,
        family: Option<GaitFamily>,
    ) -> Result<(StopReason, D)> {
        let first = self.generations.len();
        let outcome = cem::run_observed(settings, distribution, self.seed, first, timed, &mut |generation| self.look(generation, family))?;
        timed.failure()?;
        let stop = if outcome.stop == StopReason::Cancelled { self.clock.stop() } else { outcome.stop };
        Ok((stop, outcome.distribution))
    }

    /// Processes a completed generation: keeps better candidates and reports progress.
    fn look(&mut self, generation: &Generation<Evaluated>, family: Option<GaitFamily>) {
        let mut open = Vec::new();
        for (own, candidate) in generation.ranked {
            let family = own.or(family);
            if candidate.evaluation.feasible && !candidate.evaluation.certified {
                open.push((family, candidate));
            } else {
                self.keep(family, candidate);
            }
        }
        let best = |family: Option<GaitFamily>| match family {
            Some(family) => self.by_family.iter().find(|(f, _)| *f == family).map(|(_, c)| c.objective),
            None => self.best.as_ref().map(|(_, c)| c.objective),
        };
        for (family, candidate) in best_certified(&open, best, &self.settings.cem(1), self.level) {
            self.keep(family, &candidate);
        }
        let best_ever_objective = self.best.as_ref().or(self.nearest.as_ref()).map(|(_, best)| best.objective);
        let record = GenerationRecord { best_ever_objective, ..generation.record.clone() };
        debug!(
            generation = record.generation,
            evaluated = record.evaluated,
            feasible = record.feasible,
            fewest_violations = record.lowest_n_violated,
            "generation"
        );
        (self.tell)(&Progress::Generation(&record));
        self.generations.push(record);
        self.report();
    }

    /// Keeps a candidate if it is better than those before.
    fn keep(&mut self, family: Option<GaitFamily>, candidate: &Member<Evaluated>) {
        let better = |old: &Candidate<Evaluated>| candidate.objective > old.objective;
        let solved = || candidate.clone().solved(|schedule| Some(self.level.certified_again(schedule)?.solution));
        if !candidate.evaluation.feasible {
            if self.best.is_none()
                && self.nearest.as_ref().is_none_or(|(_, old)| candidate.evaluation.n_violated < old.evaluation.n_violated)
                && let Some(solved) = solved()
            {
                self.nearest = Some((family, solved));
            }
            return;
        }
        let of_family = family.map(|family| (family, self.by_family.iter().position(|(f, _)| *f == family)));
        let best_of_family = of_family.filter(|(_, at)| at.is_none_or(|at| better(&self.by_family[at].1)));
        let best = self.best.as_ref().is_none_or(|(_, old)| better(old));
        if !best && best_of_family.is_none() {
            return;
        }
        let Some(candidate) = solved() else { return };
        match best_of_family {
            Some((_, Some(at))) => self.by_family[at].1 = candidate.clone(),
            Some((family, None)) => self.by_family.push((family, candidate.clone())),
            None => {}
        }
        if best {
            self.best = Some((family, candidate));
        }
    }

    /// Reports the best gait if it is new.
    fn report(&mut self) {
        let Some((family, best)) = &self.best else { return };
        if self.improvements.last().is_some_and(|last| last.objective >= best.objective) {
            return;
        }
        let improvement = Improvement {
            family: *family,
            generation: best.generation,
            candidates: self.generations.iter().map(|g| g.evaluated).sum(),
            seconds: self.clock.seconds(),
            objective: best.objective,
        };
        (self.tell)(&Progress::Improvement(&improvement));
        self.improvements.push(improvement);
    }

    /// Result of the search, with the motions and certificates of the gaits in it.
    fn finish(self, stop: StopReason, lower: &LowerSettings, first_feasible_after: Option<f64>) -> Result<SearchResult> {
        let gait = |(family, candidate): (Option<GaitFamily>, Candidate<Evaluated>)| Gait::new(family, candidate, self.task, lower);
        let best = self.best.or(self.nearest).ok_or_else(|| Error::Ended { message: format!("no candidate was solved ({stop})") })?;
        let mut others: Vec<(GaitFamily, Candidate<Evaluated>)> =
            self.by_family.into_iter().filter(|(family, _)| Some(*family) != best.0).collect();
        others.sort_by(|a, b| b.1.objective.total_cmp(&a.1.objective));
        others.truncate(self.settings.alternatives.saturating_sub(1));
        Ok(SearchResult {
            best: gait(best)?,
            alternatives: others.into_iter().map(|(family, candidate)| gait((Some(family), candidate))).collect::<Result<_>>()?,
            generations: self.generations,
            improvements: self.improvements,
            stop,
            first_feasible_after,
            seconds: self.clock.seconds(),
        })
    }
}

#[cfg(test)]
mod tests;
