//! Stages of a search: typical gaits of the families, generations of the cross-entropy method, the neighbourhood of the best gait, and
//! descents along durations.

mod descents;
mod relief;

pub use relief::LowerGround;

use super::batch::{BatchSolver, ScheduleSolver};
use super::cem::{
    self, Candidate, CemSettings, Distribution, FreeDistribution, Generation, GenerationEvaluator, GenerationRecord, PeriodicDistribution,
    PerturbDistribution, RankedCandidate, Sampler, SelectionGoal, StopReason, Stopping,
};
use super::evaluate::Evaluated;
use super::on_demand::best_certified;
use super::timed::{Clock, TimedEvaluator};
use super::{Gait, Gaits, Improvement, SearchEvent, SearchResult, SearchSettings};
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::gait::family::{GaitFamily, default_families};
use crate::gait::joints;
use crate::settings::Transcription;
use crate::task::Task;
use tracing::{debug, info};

/// Evaluator of the generations of a search.
type BatchEvaluator<'a> = TimedEvaluator<'a, BatchSolver<'a>>;

/// State of a running search.
pub(super) struct SearchState<'a, 's> {
    task: &'a Task,
    solver: &'a BatchSolver<'a>,
    settings: &'a SearchSettings,
    seed: u64,
    clock: Clock<'a>,
    on_event: &'s mut dyn FnMut(&SearchEvent),
    /// Best certified candidate.
    best: Option<Candidate<Evaluated>>,
    /// Candidate with the fewest violations while no candidate is certified.
    nearest: Option<Candidate<Evaluated>>,
    /// Best certified candidate of each family.
    by_family: Vec<Candidate<Evaluated>>,
    generations: Vec<GenerationRecord>,
    /// Number of minimisations with which durations were optimised.
    duration_solves: usize,
    /// Search on lower ground, if there was one.
    lower_ground: Option<LowerGround>,
    improvements: Vec<Improvement>,
}

impl<'a, 's> SearchState<'a, 's> {
    /// State before the first generation.
    pub fn new(
        solver: &'a BatchSolver<'a>,
        settings: &'a SearchSettings,
        seed: u64,
        clock: Clock<'a>,
        on_event: &'s mut dyn FnMut(&SearchEvent),
    ) -> Self {
        SearchState {
            task: solver.task,
            solver,
            settings,
            seed,
            clock,
            on_event,
            best: None,
            nearest: None,
            by_family: Vec::new(),
            generations: Vec::new(),
            duration_solves: 0,
            lower_ground: None,
            improvements: Vec::new(),
        }
    }

    /// Runs all stages. Returns the reason for the end.
    pub fn run(&mut self, evaluator: &mut BatchEvaluator) -> Result<StopReason> {
        let settings = self.settings;
        let stop = match &settings.gaits {
            Gaits::Free => {
                let distribution = FreeDistribution::initial(&settings.free, self.task.robot.feet())?;
                self.generations_until_found(evaluator, distribution)?
            }
            Gaits::Around(schedule) => match self.generation(evaluator, vec![(None, schedule.clone())])? {
                Some(stop) => stop,
                None => {
                    let distribution = PerturbDistribution::initial(&self.task.robot, schedule, &settings.perturb)?;
                    self.generations_until_found(evaluator, distribution)?
                }
            },
            Gaits::All => self.periodic(evaluator, &default_families(&self.task.robot))?,
            Gaits::Families(families) => self.periodic(evaluator, families)?,
        };
        let ended = !matches!(stop, StopReason::GenerationLimit | StopReason::Converged);
        let raises = !ended && self.best.is_none() && settings.relief_levels > 0 && self.task.terrain.has_edges();
        let stop = if raises { self.raise_ground(evaluator)?.unwrap_or(stop) } else { stop };
        let refinable = matches!(stop, StopReason::GenerationLimit | StopReason::Converged) && self.learns() && self.moves();
        let stop = if refinable && settings.perturbed_generations > 0 { self.perturbed(evaluator)?.unwrap_or(stop) } else { stop };
        if refinable && settings.optimises_durations() && self.solver.settings.transcription.rows == Transcription::Momentum {
            self.optimise_durations();
        }
        Ok(stop)
    }

    /// The best certified candidate of a family.
    fn best_of(&self, family: GaitFamily) -> Option<&Candidate<Evaluated>> {
        self.by_family.iter().find(|candidate| candidate.family == Some(family))
    }

    /// True if the distribution is fitted to the elites.
    fn learns(&self) -> bool {
        self.settings.free.sampler == Sampler::Cem
    }

    /// True if the best gait has a swing. Other phase times cannot improve standing still.
    fn moves(&self) -> bool {
        self.best.as_ref().is_some_and(|best| best.stances.iter().any(|n| *n > 1))
    }

    /// Evaluates the typical gaits of the families, then runs generations over them.
    fn periodic(&mut self, evaluator: &mut BatchEvaluator, families: &[GaitFamily]) -> Result<StopReason> {
        let settings = self.settings;
        let mut distribution = PeriodicDistribution::initial(self.task, families, &settings.periodic)?;
        let (mut typical, mut refused) = (Vec::new(), Vec::new());
        for (sample, family) in distribution.means().iter().zip(families) {
            match distribution.schedule(sample).and_then(|schedule| self.solver.check(&schedule).map(|()| schedule)) {
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
        let stands_still = |schedule: &Schedule| (0..schedule.feet()).all(|foot| schedule.stances(foot) == 1);
        if let Some((_, still)) = typical.iter().find(|(_, schedule)| stands_still(schedule)) {
            // Standing still belongs to no family, and no gait is better.
            let still = vec![(None, still.clone())];
            if let Some(stop) = self.generation(evaluator, still)? {
                return Ok(stop);
            }
            if self.best.is_some() {
                return Ok(StopReason::Converged);
            }
        }
        if let Some(stop) = self.generation(evaluator, typical)? {
            return Ok(stop);
        }
        // Families that did well are drawn more often.
        let mut ranked: Vec<(usize, f64)> =
            families.iter().enumerate().filter_map(|(i, family)| Some((i, self.best_of(*family)?.objective))).collect();
        ranked.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let means = distribution.means();
        let elites: Vec<_> = ranked.iter().take(settings.elites).map(|(i, _)| &means[*i]).collect();
        if self.learns() {
            distribution.update_families(&elites);
        }
        self.generations_until_found(evaluator, distribution)
    }

    /// Runs the planned generations over a distribution, then further ones while no gait exists or none that the joints can follow.
    fn generations_until_found<D: Distribution>(&mut self, evaluator: &mut BatchEvaluator, distribution: D) -> Result<StopReason> {
        let settings = self.settings;
        let (mut stop, mut distribution) = match settings.generations {
            0 => (StopReason::GenerationLimit, distribution),
            planned => self.cem(evaluator, &settings.cem(planned), distribution)?,
        };
        for _ in 0..settings.further_generations {
            if stop != StopReason::GenerationLimit || self.within_joint_limits()? {
                break;
            }
            let mut further = settings.cem(1);
            if self.best.is_none() {
                further.stopping = Stopping::FirstFeasible;
            }
            (stop, distribution) = self.cem(evaluator, &further, distribution)?;
            if stop == StopReason::FirstFeasible && !settings.first {
                stop = StopReason::GenerationLimit;
            }
        }
        Ok(stop)
    }

    /// True if a gait exists and, where that is preferred, its joints stay within their limits.
    fn within_joint_limits(&self) -> Result<bool> {
        let Some(best) = &self.best else { return Ok(false) };
        let exceeded = best.evaluation.cost.is_some_and(|cost| cost.joint_cost > 0.);
        if !exceeded || !self.settings.prefers_joint_limits() {
            return Ok(true);
        }
        let trajectory = best.solution.trajectory(self.task, &self.solver.settings.transcription);
        Ok(joints::limits(&trajectory, &self.task.robot, &self.task.terrain)?.is_none_or(|limits| limits.kept))
    }

    /// Runs generations in the neighbourhood of the best gait.
    fn perturbed(&mut self, evaluator: &mut BatchEvaluator) -> Result<Option<StopReason>> {
        let Some(best) = &self.best else { return Ok(None) };
        let settings = self.settings;
        let mut distribution = PerturbDistribution::initial(&self.task.robot, &best.solution.schedule, &settings.perturb)?;
        distribution.family = best.family;
        let (stop, _) = self.cem(evaluator, &settings.cem(settings.perturbed_generations), distribution)?;
        Ok(Some(stop))
    }

    /// Runs one generation of given schedules. Returns the reason if the search ends with it.
    fn generation(
        &mut self,
        evaluator: &mut BatchEvaluator,
        mut schedules: Vec<(Option<GaitFamily>, Schedule)>,
    ) -> Result<Option<StopReason>> {
        let generation = self.generations.len();
        if !self.settings.first {
            // Short schedules are solved fastest.
            schedules.sort_by(|(_, a), (_, b)| a.horizon().total_cmp(&b.horizon()));
        }
        let (families, schedules): (Vec<Option<GaitFamily>>, Vec<Schedule>) = schedules.into_iter().unzip();
        let settings = self.settings.cem(1);
        let goal = SelectionGoal::all(&settings, &schedules).or_first(self.settings.first);
        let results = evaluator.evaluate(generation, &schedules, &goal);
        evaluator.take_error()?;
        let ranked = cem::candidates(&settings, generation, families.into_iter().zip(schedules), results);
        let record = cem::summarise(generation, ranked.iter(), 0., 0.);
        self.process(&Generation { record: &record, ranked: &ranked });
        let found = self.best.is_some() && self.settings.first;
        Ok(if found { Some(StopReason::FirstFeasible) } else { evaluator.cancelled().then(|| self.clock.stop_reason()) })
    }

    /// Runs generations of the cross-entropy method over a distribution.
    fn cem<D: Distribution>(&mut self, evaluator: &mut BatchEvaluator, settings: &CemSettings, distribution: D) -> Result<(StopReason, D)> {
        let first = self.generations.len();
        let outcome = cem::run_observed(settings, distribution, self.seed, first, evaluator, &mut |generation| self.process(generation))?;
        evaluator.take_error()?;
        let stop = if outcome.stop == StopReason::Cancelled { self.clock.stop_reason() } else { outcome.stop };
        Ok((stop, outcome.distribution))
    }

    /// Processes a completed generation: keeps better candidates and reports progress.
    fn process(&mut self, generation: &Generation<Evaluated>) {
        let (open, others): (Vec<_>, Vec<_>) = generation.ranked.iter().partition(|c| c.evaluation.feasible && !c.evaluation.certified);
        others.into_iter().for_each(|candidate| self.keep(candidate));
        let best = |family: Option<GaitFamily>| match family {
            Some(family) => self.best_of(family).map(|c| c.objective),
            None => self.best.as_ref().map(|c| c.objective),
        };
        let certified = best_certified(&open, best, &self.settings.cem(1), self.solver);
        certified.iter().for_each(|candidate| self.keep(candidate));
        let best_ever_objective = self.best.as_ref().or(self.nearest.as_ref()).map(|best| best.objective);
        let record = GenerationRecord { best_ever_objective, ..generation.record.clone() };
        debug!(
            generation = record.generation,
            evaluated = record.evaluated,
            feasible = record.feasible,
            fewest_violations = record.lowest_n_violated,
            "generation"
        );
        (self.on_event)(&SearchEvent::Generation(&record));
        self.generations.push(record);
        self.report_improvement();
        let cost = self.best.as_ref().and_then(|best| best.evaluation.cost);
        if let (Some(incumbent), Some(cost)) = (self.solver.incumbent, cost) {
            incumbent.set(cost.total);
        }
    }

    /// Keeps a candidate if it is better than those before.
    fn keep(&mut self, candidate: &RankedCandidate<Evaluated>) {
        let better = |old: &Candidate<Evaluated>| candidate.objective > old.objective;
        let with_solution = || candidate.clone().with_solution(|schedule| Some(self.solver.certify_again(schedule)?.1));
        if !candidate.evaluation.feasible {
            if self.best.is_none()
                && self.nearest.as_ref().is_none_or(|old| candidate.evaluation.n_violated < old.evaluation.n_violated)
                && let Some(candidate) = with_solution()
            {
                self.nearest = Some(candidate);
            }
            return;
        }
        let of_family = self.by_family.iter().position(|old| old.family == candidate.family);
        let best_of_family = candidate.family.is_some() && of_family.is_none_or(|at| better(&self.by_family[at]));
        let best = self.best.as_ref().is_none_or(better);
        if !best && !best_of_family {
            return;
        }
        let Some(candidate) = with_solution() else { return };
        match of_family {
            Some(at) if best_of_family => self.by_family[at] = candidate.clone(),
            None if best_of_family => self.by_family.push(candidate.clone()),
            _ => {}
        }
        if best {
            self.best = Some(candidate);
        }
    }

    /// Reports the best gait if it is new.
    fn report_improvement(&mut self) {
        let Some(best) = &self.best else { return };
        if self.improvements.last().is_some_and(|last| last.objective >= best.objective) {
            return;
        }
        let improvement = Improvement {
            family: best.family,
            generation: best.generation,
            candidates: self.generations.iter().map(|g| g.evaluated).sum(),
            seconds: self.clock.seconds(),
            objective: best.objective,
        };
        (self.on_event)(&SearchEvent::Improvement(&improvement));
        self.improvements.push(improvement);
    }

    /// Result of the search, with the motions and certificates of the gaits in it.
    pub fn finish(self, stop: StopReason, first_feasible_after: Option<f64>) -> Result<SearchResult> {
        let gait = |candidate| Gait::new(candidate, self.task, self.solver.settings);
        let best = self.best.or(self.nearest).ok_or_else(|| Error::Ended { message: format!("no candidate was solved ({stop})") })?;
        let mut others: Vec<_> = self.by_family.into_iter().filter(|other| other.family != best.family).collect();
        others.sort_by(|a, b| b.objective.total_cmp(&a.objective));
        others.truncate(self.settings.alternatives.saturating_sub(1));
        Ok(SearchResult {
            best: gait(best)?,
            alternatives: others.into_iter().map(gait).collect::<Result<_>>()?,
            generations: self.generations,
            duration_solves: self.duration_solves,
            lower_ground: self.lower_ground,
            improvements: self.improvements,
            stop,
            first_feasible_after,
            seconds: self.clock.seconds(),
        })
    }
}
