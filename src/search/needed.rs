//! Early exit of a batch: the candidates that can still matter.

use super::cem::rank_order;
use crate::backend::locked;
use std::sync::Mutex;

/// Tracks which candidates of a batch are needed: those that may still rank before the last of enough feasible ones.
///
/// The final set does not depend on the order in which candidates are registered, and always contains the best ones.
pub(super) struct NeededCandidates {
    /// Upper bound of the objective of each candidate.
    bounds: Vec<f64>,
    /// Number of best feasible candidates that are needed.
    enough: usize,
    /// Objective and index of the best feasible candidates, best first.
    best: Mutex<Vec<(f64, usize)>>,
}

impl NeededCandidates {
    /// Starts with every candidate needed.
    ///
    /// * `bounds` - upper bound of the objective of each candidate
    /// * `enough` - number of best feasible candidates that are needed
    pub fn new(bounds: Vec<f64>, enough: usize) -> Self {
        NeededCandidates { bounds, enough, best: Mutex::default() }
    }

    /// True if all candidates are needed regardless of the results.
    fn all(&self) -> bool {
        self.enough >= self.bounds.len()
    }

    /// Order in which to solve the candidates: by decreasing bound if that can make others unnecessary.
    pub fn solve_order(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.bounds.len()).collect();
        if !self.all() {
            order.sort_by(|&i, &j| rank_order((self.bounds[i], i), (self.bounds[j], j)));
        }
        order
    }

    /// Registers a feasible candidate.
    ///
    /// * `objective` - clamped to the bound of the candidate
    pub fn record(&self, index: usize, objective: f64) {
        if self.all() {
            return;
        }
        let objective = objective.min(self.bounds[index]);
        let mut best = locked(&self.best);
        let place = best.partition_point(|&other| rank_order(other, (objective, index)).is_lt());
        if place < self.enough {
            best.insert(place, (objective, index));
            best.truncate(self.enough);
        }
    }

    /// True if the candidate is needed.
    pub fn contains(&self, index: usize) -> bool {
        if self.all() {
            return true;
        }
        let best = locked(&self.best);
        best.len() < self.enough || best.last().is_some_and(|&last| rank_order((self.bounds[index], index), last).is_le())
    }
}
