//! Algorithm 1 of \[1\]: the search itself.

use super::distribution::{Distribution, Sample};
use super::random::Draws;
use super::{Candidate, CemSettings, Evaluate, Evaluation, GenerationRecord, Outcome, Sampler, StopReason, Stopping};
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::robot::MAX_FEET;

/// Searches for the schedule with the largest objective.
///
/// The same settings, feet, seed and answers of the evaluator give the same outcome.
///
/// * `feet` - feet of the robot, at most [`MAX_FEET`]
/// * `progress` - called after every generation
///
/// # Errors
/// [`Error::Invalid`] names the setting that is out of its limits.
pub fn run<E: Evaluate>(
    settings: &CemSettings,
    feet: usize,
    seed: u64,
    evaluator: &mut E,
    progress: &mut dyn FnMut(&GenerationRecord),
) -> Result<Outcome<E::Solution>> {
    settings.validate()?;
    if feet == 0 || feet > MAX_FEET {
        return Err(Error::invalid("feet", feet, format!("1 to {MAX_FEET}")));
    }
    let until_feasible = settings.stopping == Stopping::FirstFeasible;
    let first_only = until_feasible && !settings.whole_generation;
    let mut distribution = Distribution::initial(settings, feet);
    let mut best: Option<Candidate<E::Solution>> = None;
    let mut generations = Vec::new();
    let mut stop = None;

    for generation in 0..settings.generations {
        if evaluator.cancelled() {
            stop = Some(StopReason::Cancelled);
            break;
        }
        // Sample N candidates and evaluate them.
        let draw = |candidate| distribution.sample(settings, Draws::new(seed, generation, candidate));
        let samples: Vec<Sample> = (0..settings.population).map(draw).collect();
        let schedules = samples.iter().map(|s| s.schedule(settings)).collect::<Result<Vec<_>>>()?;
        let results = evaluator.evaluate(generation, &schedules, first_only);

        // Sort by J, best first; the M first are the elites.
        let ranked = rank(settings, generation, schedules, results, first_only);
        let elites: Vec<&Sample> = ranked.iter().take(settings.elites).map(|c| &samples[c.index]).collect();

        // Stop, or update the distribution.
        if until_feasible && ranked.iter().any(|c| c.evaluation.feasible) {
            stop = Some(StopReason::FirstFeasible);
        } else if evaluator.cancelled() {
            stop = Some(StopReason::Cancelled);
        } else if settings.sampler == Sampler::Cem {
            distribution.update(settings, &elites);
            if !until_feasible && distribution.converged(settings) {
                stop = Some(StopReason::Converged);
            }
        }

        // Keep the best ever.
        let mut record = summarise(settings, generation, &ranked, &distribution);
        let former = best.as_ref().map_or(f64::NEG_INFINITY, |b| b.objective);
        record.best_ever_objective = record.best_objective.into_iter().chain(finite(former)).reduce(f64::max);
        let mut ranked = ranked.into_iter();
        if stop == Some(StopReason::FirstFeasible) {
            best = ranked.find(|c| c.evaluation.feasible);
        } else if let Some(first) = ranked.next().filter(|c| best.is_none() || c.objective > former) {
            best = Some(first);
        }
        progress(&record);
        generations.push(record);
        if stop.is_some() {
            break;
        }
    }
    Ok(Outcome { best, generations, stop: stop.unwrap_or(StopReason::GenerationLimit), distribution })
}

/// The evaluated candidates of a generation by falling objective, ties by index.
///
/// With `first_only`, candidates after the first feasible one are dropped: which of them were evaluated depends on timing.
fn rank<S>(
    settings: &CemSettings,
    generation: usize,
    schedules: Vec<Schedule>,
    results: Vec<Option<(Evaluation, S)>>,
    first_only: bool,
) -> Vec<Candidate<S>> {
    let mut ranked = Vec::new();
    for (index, (schedule, result)) in schedules.into_iter().zip(results).enumerate() {
        let Some((evaluation, solution)) = result else { continue };
        let stances: Vec<usize> = (0..schedule.feet()).map(|foot| schedule.stances(foot)).collect();
        let objective = settings.objective.value(&stances, &evaluation, settings.penalty);
        ranked.push(Candidate { generation, index, stances, schedule, objective, evaluation, solution });
        if first_only && evaluation.feasible {
            break;
        }
    }
    ranked.sort_by(|a, b| b.objective.total_cmp(&a.objective).then(a.index.cmp(&b.index)));
    ranked
}

/// The record of a generation, the best ever still without the generations before.
fn summarise<S>(settings: &CemSettings, generation: usize, ranked: &[Candidate<S>], distribution: &Distribution) -> GenerationRecord {
    let objectives: Vec<f64> = ranked.iter().filter_map(|c| finite(c.objective)).collect();
    GenerationRecord {
        generation,
        evaluated: ranked.len(),
        feasible: ranked.iter().filter(|c| c.evaluation.feasible).count(),
        best_objective: objectives.first().copied(),
        mean_objective: finite(objectives.iter().sum::<f64>() / objectives.len() as f64),
        best_ever_objective: objectives.first().copied(),
        lowest_n_violated: ranked.iter().map(|c| c.evaluation.n_violated).min(),
        entropy: distribution.entropy(),
        largest_std: distribution.largest_std(settings),
    }
}

/// A number, unless it is infinite or none.
fn finite(x: f64) -> Option<f64> {
    x.is_finite().then_some(x)
}

#[cfg(test)]
#[path = "run_tests.rs"]
mod tests;
