//! Algorithm 1 of \[1\]: the cross-entropy loop.

use super::random::Draws;
use super::{
    Candidate, CemOutcome, CemSettings, Distribution, GenerationEvaluator, GenerationRecord, GenerationResults, Sampler, SelectionGoal,
    StopReason, Stopping, rank_order,
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
    /// Candidates, best first, each with its family if the distribution has families.
    pub ranked: &'a [(Option<GaitFamily>, Candidate<Option<Box<S>>>)],
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
        let ranked = rank(settings, generation, schedules, results, first_only);
        let elites: Vec<&D::Sample> = ranked.iter().take(settings.elites).map(|c| &samples[c.index]).collect();
        let families: Vec<Option<GaitFamily>> = ranked.iter().map(|c| distribution.family(&samples[c.index])).collect();

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
        let ranked: Vec<_> = families.into_iter().zip(ranked).collect();
        observe(&Generation { record: &record, ranked: &ranked });
        let mut ranked = ranked.into_iter().map(|(_, candidate)| candidate);
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

/// Evaluated candidates of a generation by decreasing objective, ties by index.
///
/// `first_only` drops candidates after the first feasible one, because timing decides which of them were evaluated.
fn rank<S>(
    settings: &CemSettings,
    generation: usize,
    schedules: Vec<Schedule>,
    results: GenerationResults<S>,
    first_only: bool,
) -> Vec<Candidate<Option<Box<S>>>> {
    let mut ranked = Vec::new();
    for (index, (schedule, result)) in schedules.into_iter().zip(results).enumerate() {
        let Some((evaluation, solution)) = result else { continue };
        ranked.push(Candidate::new(settings, generation, index, schedule, evaluation, solution));
        if first_only && evaluation.feasible {
            break;
        }
    }
    ranked.sort_by(|a, b| rank_order((a.objective, a.index), (b.objective, b.index)));
    ranked
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
