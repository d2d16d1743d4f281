//! The whole search: gaits are drawn, solved and certified, and the cheapest is returned.
//!
//! It is anytime. First come the typical gaits of every family that the robot can have, the shortest before all others (a plain trot or
//! tripod where the first gait is enough); then generations of the cross-entropy method over families, durations, speed and offsets, fitted to the cost, more of them while no gait is certified
//! or none that the robot's joints can follow; then the neighbourhood of the best.
//! Every improvement is reported. Once there is a certified gait, candidates are taken at the solver's word, and only those that would be the
//! best of their family are certified, in the order of their cost until one holds. What decides is counted in candidates, so that a seed gives
//! the same gait at any number of threads; time and the user only end a search.

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

/// A gait that a search returns, with its motion.
#[derive(Debug, Clone)]
pub struct Gait {
    /// Its family, where it is one of a family or near one.
    pub family: Option<GaitFamily>,
    /// The candidate that it was: generation, index, schedule as drawn, objective, and how it was solved.
    pub candidate: Candidate<Evaluated>,
    trajectory: Trajectory,
    certificate: Report,
}

impl Gait {
    /// Whether every row of its certificate holds.
    pub fn feasible(&self) -> bool {
        self.candidate.solution.feasible
    }

    /// Its motion, contact schedule and forces.
    pub fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }

    /// What the independent check says of it.
    pub fn certificate(&self) -> &Report {
        &self.certificate
    }

    /// Its schedule, whose feet all end with the motion.
    pub fn schedule(&self) -> &Schedule {
        &self.candidate.solution.schedule
    }

    /// With its motion and its certificate.
    fn new(family: Option<GaitFamily>, candidate: Candidate<Evaluated>, task: &Task, lower: &LowerSettings) -> Result<Gait> {
        let trajectory = candidate.solution.trajectory(task, &lower.transcription);
        let certificate = verify(&trajectory, &task.robot, &task.terrain, force_limit(&lower.transcription, task))?;
        Ok(Gait { family, candidate, trajectory, certificate })
    }

    /// Brought to a local optimum of its cost, phase durations among the variables; see [`refine`]. A gait that is not certified stays as it is.
    ///
    /// * `task`, `search`, `lower` - those that it was found with
    /// * `backend` - on whose threads of the CPU this is done
    /// * `cancelled` - asked now and then whether to end with the best so far
    ///
    /// # Errors
    /// As [`refine`].
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

/// A better gait than all before it.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Improvement {
    /// Its family, where it is one of a family or near one.
    pub family: Option<GaitFamily>,
    /// Generation that had it.
    pub generation: usize,
    /// Candidates evaluated until the end of that generation.
    pub candidates: usize,
    /// Time from the start, s.
    pub seconds: f64,
    /// Its objective, maximised.
    pub objective: f64,
}

/// What a search tells while it runs.
#[derive(Debug)]
pub enum Progress<'a> {
    /// A generation has ended.
    Generation(&'a GenerationRecord),
    /// There is a better certified gait.
    Improvement(&'a Improvement),
}

/// How a search ended.
#[derive(Debug)]
pub struct SearchResult {
    /// The best certified gait; the candidate that violates least when none was found.
    pub best: Gait,
    /// The best of other families, cheapest first, when they were asked for.
    pub alternatives: Vec<Gait>,
    /// One record a generation.
    pub generations: Vec<GenerationRecord>,
    /// Each gait that was the best so far.
    pub improvements: Vec<Improvement>,
    /// Why it ended.
    pub stop: StopReason,
    /// Time from the start to the end of the first certification that succeeded, s.
    pub first_feasible_after: Option<f64>,
    /// Time of the whole search, s.
    pub seconds: f64,
}

/// Who is told while a search runs.
type Listener<'a> = Box<dyn FnMut(&Progress) + Send + 'a>;

/// A search for a gait.
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
    /// Solutions that are kept of a generation: nothing that it finds depends on it.
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

    /// Settings of the search.
    pub fn settings(self, settings: SearchSettings) -> Self {
        Search { settings, ..self }
    }

    /// Settings of the lower level: variables, rows, iterations.
    pub fn lower(self, lower: LowerSettings) -> Self {
        Search { lower, ..self }
    }

    /// Seed of all random numbers.
    pub fn seed(self, seed: u64) -> Self {
        Search { seed, ..self }
    }

    /// Candidates a generation; elites keep their share.
    pub fn population(mut self, population: usize) -> Self {
        self.settings = self.settings.with_population(population);
        self
    }

    /// Most generations behind the families' typical gaits.
    pub fn generations(mut self, generations: usize) -> Self {
        self.settings.generations = generations;
        self
    }

    /// Which gaits are looked at.
    pub fn gaits(mut self, gaits: Gaits) -> Self {
        self.settings.gaits = gaits;
        self
    }

    /// Ends with the first certified gait.
    pub fn first(mut self) -> Self {
        self.settings.first = true;
        self
    }

    /// Ends when this is set, with the best so far.
    pub fn cancelled_by(self, flag: &'a AtomicBool) -> Self {
        Search { cancelled: Some(flag), ..self }
    }

    /// Is told of generations and improvements.
    pub fn on_progress(self, progress: impl FnMut(&Progress) + Send + 'a) -> Self {
        Search { progress: Some(Box::new(progress)), ..self }
    }

    /// Searches.
    ///
    /// # Errors
    /// [`Error::Invalid`] for settings or a task out of their limits, [`Error::Unknown`] for a family that the robot cannot have,
    /// [`Error::Ended`] when no candidate was solved before the end.
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

/// A search while it runs.
struct Session<'a, 's> {
    task: &'a Task,
    level: &'a BatchSolver<'a>,
    settings: &'a SearchSettings,
    seed: u64,
    clock: Clock<'a>,
    tell: &'s mut dyn FnMut(&Progress),
    /// The best certified candidate.
    best: Option<(Option<GaitFamily>, Candidate<Evaluated>)>,
    /// While there is none, the one that violates least.
    nearest: Option<(Option<GaitFamily>, Candidate<Evaluated>)>,
    /// The best certified candidate of each family.
    by_family: Vec<(GaitFamily, Candidate<Evaluated>)>,
    generations: Vec<GenerationRecord>,
    improvements: Vec<Improvement>,
}

/// What a schedule is to a search: its family, and the schedule.
type Named = (Option<GaitFamily>, Schedule);

/// The lower level of a search.
type Level<'a> = Timed<'a, BatchSolver<'a>>;

impl Session<'_, '_> {
    /// All stages. Returns why the search ended.
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

    /// Whether draws follow what was found.
    fn learns(&self) -> bool {
        self.settings.free.sampler == Sampler::Cem
    }

    /// Whether the best gait has a swing: standing still cannot be improved by other times.
    fn moves(&self) -> bool {
        self.best.as_ref().is_some_and(|(_, b)| b.stances.iter().any(|n| *n > 1))
    }

    /// Typical gaits of families, then generations over them.
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
        // Too long a way for one family need not be for another.
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
            // Standing still is no family's own, and nothing is better.
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
        // The families that did well are looked at more closely.
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

    /// The planned generations over a distribution, and further ones while there is no gait, or none that the robot's joints can follow.
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

    /// Whether there is a gait, and one within the limits of the robot's joints where such are preferred.
    fn within_joint_limits(&self) -> Result<bool> {
        let Some((_, best)) = &self.best else { return Ok(false) };
        let dear = best.evaluation.cost.is_some_and(|cost| cost.joint_cost > 0.);
        if !dear || !self.settings.prefers_joint_limits() {
            return Ok(true);
        }
        let trajectory = best.solution.trajectory(self.task, &self.level.settings.transcription);
        Ok(joints::limits(&trajectory, &self.task.robot)?.is_none_or(|limits| limits.kept))
    }

    /// Generations around the best gait.
    fn perturbed(&mut self, timed: &mut Level) -> Result<Option<StopReason>> {
        let Some((family, best)) = &self.best else { return Ok(None) };
        let family = *family;
        let settings = self.settings;
        let distribution = PerturbDistribution::initial(&self.task.robot, &best.solution.schedule, &settings.perturb)?;
        let (stop, _) = self.cem(timed, &settings.cem(settings.perturbed_generations), distribution, family)?;
        Ok(Some(stop))
    }

    /// One generation of given schedules. Returns why the search ends with it, if it does.
    fn generation(&mut self, timed: &mut Level, mut named: Vec<Named>) -> Result<Option<StopReason>> {
        let generation = self.generations.len();
        if !self.settings.first {
            // What is short is solved soonest.
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

    /// Generations of the cross-entropy method over a distribution.
    ///
    /// * `family` - that of all samples, where the distribution knows of none
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

    /// Looks at a generation: is there anything better than before?
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

    /// Looks at a candidate: is it better than those before?
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

    /// Tells of the best gait when it is a new one.
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

    /// The result, with motions and certificates of what is returned.
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
