//! On-demand certification: certifies the solved candidates of a generation that would be the best of their family, in the order of their
//! cost.

use super::batch::{BatchSolver, ScheduleSolver};
use super::cem::{CemSettings, RankedCandidate};
use super::evaluate::{Certify, Evaluated};
use crate::gait::Schedule;
use crate::gait::family::GaitFamily;
use rayon::prelude::*;
use std::collections::{BTreeMap, VecDeque};
use tracing::debug;

/// Solved candidates of a family, best first. The first one whose certificate is valid is wanted.
struct FamilyCandidates<'a> {
    family: Option<GaitFamily>,
    /// Objective that a candidate has to exceed.
    threshold: f64,
    /// Candidates without a certificate yet.
    open: VecDeque<&'a RankedCandidate<Evaluated>>,
    /// First candidate whose certificate is valid.
    certified: Option<RankedCandidate<Evaluated>>,
}

impl FamilyCandidates<'_> {
    /// Certifies one candidate after the other until a certificate is valid or `certify` returns `None`.
    ///
    /// * `certify` - certifies a candidate; `None` if its solution was dropped
    fn certify(&mut self, certify: impl Fn(&RankedCandidate<Evaluated>) -> Option<RankedCandidate<Evaluated>>) {
        while self.certified.is_none()
            && let Some(candidate) = self.open.front().and_then(|next| certify(next))
        {
            self.open.pop_front();
            self.certified = Some(candidate).filter(|c| c.evaluation.feasible && c.objective > self.threshold);
        }
    }
}

/// Number of candidates per family that are solved again in one batch if their solutions were dropped.
const SOLVED_AGAIN: usize = 32;

/// Certified candidates that replace the best of their family: the first one of each family whose certificate is valid.
///
/// * `open` - solved candidates without a certificate, best first
/// * `best` - objective of the best gait of a family so far
pub(super) fn best_certified(
    open: &[&RankedCandidate<Evaluated>],
    best: impl Fn(Option<GaitFamily>) -> Option<f64>,
    settings: &CemSettings,
    solver: &BatchSolver,
) -> Vec<RankedCandidate<Evaluated>> {
    let mut groups = by_family(open, best);
    let BatchSolver { task, settings: lower, backend, cost, .. } = *solver;
    // Candidates that were solved again, by index.
    let mut solved_again: BTreeMap<usize, Evaluated> = BTreeMap::new();
    loop {
        let certify = |c: &RankedCandidate<Evaluated>| {
            let solution = c.solution.as_deref().or_else(|| solved_again.get(&c.index))?.clone().certify(task, lower, cost);
            Some(c.evaluated_again(settings, solution.evaluation, Some(Box::new(solution))))
        };
        backend.pool().install(|| groups.par_iter_mut().for_each(|group| group.certify(certify)));
        // Solved again outside the parallel loop, because a device takes one batch at a time.
        let missing = |group: &FamilyCandidates| group.certified.is_none() && !group.open.is_empty();
        let next: Vec<&RankedCandidate<Evaluated>> = groups
            .iter()
            .filter(|group| missing(group))
            .flat_map(|group| group.open.iter().copied().take(SOLVED_AGAIN))
            .filter(|c| c.solution.is_none())
            .collect();
        if next.is_empty() {
            return groups.into_iter().filter_map(|group| group.certified).collect();
        }
        debug!(candidates = next.len(), "solved again");
        let schedules: Vec<Schedule> = next.iter().map(|c| c.schedule.clone()).collect();
        let results = solver.solve_again(&schedules, Certify::Unsolved).into_iter();
        solved_again = next.iter().zip(results).filter_map(|(c, result)| Some((c.index, result?.1))).collect();
        let failed: Vec<usize> = next.iter().map(|c| c.index).filter(|index| !solved_again.contains_key(index)).collect();
        for group in &mut groups {
            group.open.retain(|c| !failed.contains(&c.index));
        }
    }
}

/// Groups candidates by family, without those that are no better than the best of their family.
fn by_family<'a>(open: &[&'a RankedCandidate<Evaluated>], best: impl Fn(Option<GaitFamily>) -> Option<f64>) -> Vec<FamilyCandidates<'a>> {
    let mut groups: Vec<FamilyCandidates> = Vec::new();
    for &candidate in open {
        match groups.iter_mut().find(|group| group.family == candidate.family) {
            Some(group) => group.open.push_back(candidate),
            None => {
                let threshold = best(candidate.family).unwrap_or(f64::NEG_INFINITY);
                groups.push(FamilyCandidates { family: candidate.family, threshold, open: VecDeque::from([candidate]), certified: None });
            }
        }
    }
    for FamilyCandidates { threshold, open, .. } in &mut groups {
        let better = open.iter().position(|c| c.objective <= *threshold).unwrap_or(open.len());
        open.truncate(better);
    }
    groups
}
