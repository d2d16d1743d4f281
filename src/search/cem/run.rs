//! Algorithm 1 of \[1\]: the cross-entropy loop.

use super::random::Draws;
use super::{
    Candidate, CemOutcome, CemSettings, Distribution, GenerationEvaluator, GenerationRecord, GenerationResults, RankedCandidate, Sampler,
    SelectionGoal, StopReason, Stopping, rank_order,
};
use crate::error::Result;
use crate::gait::Schedule;
use crate::gait::family::GaitFamily;

/// Searches for the schedule with the largest objective.
///
/// The outcome is a function of settings, distribution, seed and the evaluator's answers.
///
/// * `distribution` - distribution of the first generation
/// * `first` - number of the first generation; runs with the same seed and different numbers draw different candidates
/// * `progress` - called after every generation
///
/// # Errors
/// [`crate::Error::Invalid`] names the setting that is outside its limits.
pub fn run<D: Distribution, E: GenerationEvaluator>(
    settings: &CemSettings,
    distribution: D,
    seed: u64,
    first: usize,
    evaluator: &mut E,
    progress: &mut dyn FnMut(&GenerationRecord),
) -> Result<CemOutcome<E::Solution, D>> {
    run_observed(settings, distribution, seed, first, evaluator, &mut |generation| progress(generation.record))
}

/// A completed generation.
#[derive(Debug)]
pub struct Generation<'a, S> {
    /// Statistics of the generation.
    pub record: &'a GenerationRecord,
    /// Candidates, best first.
    pub ranked: &'a [RankedCandidate<S>],
}

/// Runs the search as [`run`] does and shows the candidates of every generation to `observe`.
///
/// # Errors
/// As [`run`].
pub fn run_observed<D: Distribution, E: GenerationEvaluator>(
    settings: &CemSettings,
    mut distribution: D,
    seed: u64,
    first: usize,
    evaluator: &mut E,
    observe: &mut dyn FnMut(&Generation<E::Solution>),
) -> Result<CemOutcome<E::Solution, D>> {
    settings.validate()?;
    let until_feasible = settings.stopping == Stopping::FirstFeasible;
    let first_only = until_feasible && !settings.whole_generation;
    let mut best: Option<Candidate<E::Solution>> = None;
    let mut generations = Vec::new();
    let mut stop = None;

    for generation in first..first + settings.generations {
        if evaluator.cancelled() {
            stop = Some(StopReason::Cancelled);
            break;
        }
        // Sample N candidates and evaluate them.
        let (samples, schedules) = draw(&distribution, settings.population, (seed, generation), evaluator)?;
        let enough = if until_feasible { usize::MAX } else { settings.elites };
        let goal = SelectionGoal { enough, ..SelectionGoal::all(settings, &schedules) }.or_first(first_only);
        let results = evaluator.evaluate(generation, &schedules, &goal);

        // Sort by J, best first. The first M are the elites.
        let families = samples.iter().map(|sample| distribution.family(sample));
        let mut ranked = candidates(settings, generation, families.zip(schedules), results);
        // Timing decides which candidates after the first feasible one were evaluated.
        let first_feasible = ranked.iter().position(|c| c.evaluation.feasible).filter(|_| first_only);
        ranked.truncate(first_feasible.map_or(usize::MAX, |first| first + 1));
        ranked.sort_by(|a, b| rank_order((a.objective, a.index), (b.objective, b.index)));
        let elites: Vec<&D::Sample> = ranked.iter().take(settings.elites).map(|c| &samples[c.index]).collect();

        // Stop, or update the distribution.
        if until_feasible && ranked.iter().any(|c| c.evaluation.feasible) {
            stop = Some(StopReason::FirstFeasible);
        } else if evaluator.cancelled() {
            stop = Some(StopReason::Cancelled);
        } else if settings.sampler == Sampler::Cem {
            distribution.update(&elites);
            if !until_feasible && distribution.converged() {
                stop = Some(StopReason::Converged);
            }
        }

        // Keep the best ever.
        let mut record = summarise(generation, ranked.iter(), distribution.entropy(), distribution.largest_std());
        let former = best.as_ref().map_or(f64::NEG_INFINITY, |b| b.objective);
        record.best_ever_objective = record.best_objective.into_iter().chain(finite(former)).reduce(f64::max);
        observe(&Generation { record: &record, ranked: &ranked });
        let mut ranked = ranked.into_iter();
        let better = if stop == Some(StopReason::FirstFeasible) {
            ranked.find(|c| c.evaluation.feasible)
        } else {
            ranked.next().filter(|c| best.is_none() || c.objective > former)
        };
        best = better.and_then(|c| c.with_solution(|schedule| evaluator.solve_again(schedule))).or(best);
        generations.push(record);
        if stop.is_some() {
            break;
        }
    }
    Ok(CemOutcome { best, generations, stop: stop.unwrap_or(StopReason::GenerationLimit), distribution })
}

/// Largest number of draws for one candidate, if draws give schedules that cannot be evaluated.
const DRAWS: usize = 8;

/// Draws the candidates of a generation. Leaves out a candidate if none of its [`DRAWS`] draws can be evaluated.
///
/// # Errors
/// The reason why the last draw was refused, if no candidate remains.
fn draw<D: Distribution, E: GenerationEvaluator>(
    distribution: &D,
    population: usize,
    (seed, generation): (u64, usize),
    evaluator: &E,
) -> Result<(Vec<D::Sample>, Vec<Schedule>)> {
    let mut refused = None;
    let mut drawn = |number: usize| {
        let sample = distribution.sample(Draws::new(seed, generation, number));
        let schedule = distribution.schedule(&sample).and_then(|schedule| evaluator.check(&schedule).map(|()| schedule));
        schedule.map(|schedule| (sample, schedule)).map_err(|error| refused = Some(error)).ok()
    };
    let attempts = |candidate: usize| (0..DRAWS).map(move |attempt| candidate + attempt * population);
    let candidates: (Vec<D::Sample>, Vec<Schedule>) =
        (0..population).filter_map(|candidate| attempts(candidate).find_map(&mut drawn)).unzip();
    match refused {
        Some(error) if candidates.0.is_empty() => Err(error),
        _ => Ok(candidates),
    }
}

/// Evaluated candidates of a generation, in the order of their draws.
///
/// * `draws` - family and schedule of each draw
pub(in crate::search) fn candidates<S>(
    settings: &CemSettings,
    generation: usize,
    draws: impl Iterator<Item = (Option<GaitFamily>, Schedule)>,
    results: GenerationResults<S>,
) -> Vec<RankedCandidate<S>> {
    let evaluated = draws.zip(results).enumerate().filter_map(|(index, ((family, schedule), result))| {
        let (evaluation, solution) = result?;
        Some(Candidate::new(settings, family, generation, index, schedule, evaluation, solution))
    });
    evaluated.collect()
}

/// Statistics of one generation from its candidates in any order. `best_ever_objective` does not include former generations yet.
pub(in crate::search) fn summarise<'a, S: 'a>(
    generation: usize,
    candidates: impl ExactSizeIterator<Item = &'a Candidate<S>> + Clone,
    entropy: f64,
    largest_std: f64,
) -> GenerationRecord {
    let objectives: Vec<f64> = candidates.clone().filter_map(|c| finite(c.objective)).collect();
    let best = objectives.iter().copied().reduce(f64::max);
    GenerationRecord {
        generation,
        evaluated: candidates.len(),
        feasible: candidates.clone().filter(|c| c.evaluation.feasible).count(),
        best_objective: best,
        mean_objective: finite(objectives.iter().sum::<f64>() / objectives.len() as f64),
        best_ever_objective: best,
        lowest_n_violated: candidates.map(|c| c.evaluation.n_violated).min(),
        entropy,
        largest_std,
    }
}

/// The number, or `None` if it is infinite or NaN.
fn finite(x: f64) -> Option<f64> {
    x.is_finite().then_some(x)
}

#[cfg(test)]
#[path = "run_tests.rs"]
mod tests;
