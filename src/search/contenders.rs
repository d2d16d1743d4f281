//! Which solved candidates of a generation are certified: those that would be the best of their family, in the order of their cost.

use super::batch::{BatchSolver, LowerLevel};
use super::cem::{Candidate, CemSettings, Member};
use super::evaluate::{Certify, Evaluated};
use crate::gait::Schedule;
use crate::gait::family::GaitFamily;
use rayon::prelude::*;
use std::collections::{BTreeMap, VecDeque};
use tracing::debug;

/// Solved candidates of a family, best first, among which the first is sought whose certificate holds.
struct Contenders<'a> {
    family: Option<GaitFamily>,
    /// The objective that they have to exceed.
    best: f64,
    /// Those that are not certified yet.
    open: VecDeque<&'a Member<Evaluated>>,
    found: Option<Member<Evaluated>>,
}

impl Contenders<'_> {
    /// Certifies one after the other until one holds, or the solution of the next is not there.
    fn certify(&mut self, certified: impl Fn(&Member<Evaluated>) -> Option<Member<Evaluated>>) {
        while self.found.is_none()
            && let Some(candidate) = self.open.front().and_then(|next| certified(next))
        {
            self.open.pop_front();
            self.found = Some(candidate).filter(|c| c.evaluation.feasible && c.objective > self.best);
        }
    }
}

/// Candidates of a family that are solved again at once where their solutions were let go of.
const AGAIN: usize = 32;

/// Of solved candidates, best first, those that take the place of the best of their family: of each family the first whose certificate holds.
///
/// * `best` - objective of the best of a family so far
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
    // Candidates by index that were solved again.
    let mut again: BTreeMap<usize, Evaluated> = BTreeMap::new();
    loop {
        let certified = |c: &Member<Evaluated>| {
            let solution = c.solution.as_deref().or_else(|| again.get(&c.index))?.clone().certify(task, lower, cost);
            let evaluation = solution.evaluation();
            Some(Candidate::new(settings, c.generation, c.index, c.schedule.clone(), evaluation, Some(Box::new(solution))))
        };
        backend.pool().install(|| groups.par_iter_mut().for_each(|group| group.certify(certified)));
        // Solved again by none of those threads: a device takes one batch at a time.
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
