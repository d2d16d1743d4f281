//! On-demand certification: certifies the solved candidates of a generation that would be the best of their family, in the order of their
//! cost.

use super::batch::{BatchSolver, LowerLevel};
use super::cem::{Candidate, CemSettings, Member};
use super::evaluate::{Certify, Evaluated};
use crate::gait::Schedule;
use crate::gait::family::GaitFamily;
use rayon::prelude::*;
use std::collections::{BTreeMap, VecDeque};
use tracing::debug;

/// Solved candidates of a family, best first. The first one whose certificate is valid is wanted.
struct Contenders<'a> {
    family: Option<GaitFamily>,
    /// Objective that a candidate has to exceed.
    best: f64,
    /// Candidates without a certificate yet.
    open: VecDeque<&'a Member<Evaluated>>,
    found: Option<Member<Evaluated>>,
}

impl Contenders<'_> {
    /// Certifies one candidate after the other until a certificate is valid or the solution of the next one was dropped.
    fn certify(&mut self, certified: impl Fn(&Member<Evaluated>) -> Option<Member<Evaluated>>) {
        while self.found.is_none()
            && let Some(candidate) = self.open.front().and_then(|next| certified(next))
        {
            self.open.pop_front();
            self.found = Some(candidate).filter(|c| c.evaluation.feasible && c.objective > self.best);
        }
    }
}

/// Number of candidates per family that are solved again in one batch if their solutions were dropped.
const AGAIN: usize = 32;

/// Certified candidates that replace the best of their family: the first one of each family whose certificate is valid.
///
/// * `open` - solved candidates without a certificate, best first
/// * `best` - objective of the best gait of a family so far
pub(super) fn best_certified(
    open: &[(Option<GaitFamily>, &Member<Evaluated>)],
    best: impl Fn(Option<GaitFamily>) -> Option<f64>,
    settings: &CemSettings,
    level: &BatchSolver,
) -> Vec<(Option<GaitFamily>, Member<Evaluated>)> {
    let mut groups: Vec<Contenders> = Vec::new();
    for &(family, candidate) in open {
        match groups.iter_mut().find(|group| group.family == family) {
            Some(group) => group.open.push_back(candidate),
            None => {
                let best = best(family).unwrap_or(f64::NEG_INFINITY);
                groups.push(Contenders { family, best, open: VecDeque::from([candidate]), found: None });
            }
        }
    }
    for Contenders { best, open, .. } in &mut groups {
        let behind = open.iter().position(|c| c.objective <= *best).unwrap_or(open.len());
        open.truncate(behind);
    }
    let BatchSolver { task, settings: lower, backend, cost } = *level;
    // Candidates that were solved again, by index.
    let mut again: BTreeMap<usize, Evaluated> = BTreeMap::new();
    loop {
        let certified = |c: &Member<Evaluated>| {
            let solution = c.solution.as_deref().or_else(|| again.get(&c.index))?.clone().certify(task, lower, cost);
            let evaluation = solution.evaluation();
            Some(Candidate::new(settings, c.generation, c.index, c.schedule.clone(), evaluation, Some(Box::new(solution))))
        };
        backend.pool().install(|| groups.par_iter_mut().for_each(|group| group.certify(certified)));
        // Solved again outside the parallel loop, because a device takes one batch at a time.
        let missing = |group: &Contenders| group.found.is_none() && !group.open.is_empty();
        let next: Vec<&Member<Evaluated>> = groups
            .iter()
            .filter(|g| missing(g))
            .flat_map(|g| g.open.iter().copied().take(AGAIN))
            .filter(|c| c.solution.is_none())
            .collect();
        if next.is_empty() {
            return groups.into_iter().filter_map(|group| Some((group.family, group.found?))).collect();
        }
        debug!(candidates = next.len(), "solved again");
        let schedules: Vec<Schedule> = next.iter().map(|c| c.schedule.clone()).collect();
        let solved = level.again(&schedules, Certify::Unsolved).into_iter();
        again = next.iter().zip(solved).filter_map(|(c, solved)| Some((c.index, solved?.solution))).collect();
        let failed: Vec<usize> = next.iter().map(|c| c.index).filter(|index| !again.contains_key(index)).collect();
        for group in &mut groups {
            group.open.retain(|c| !failed.contains(&c.index));
        }
    }
}
