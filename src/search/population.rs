//! Results of a population while it is solved: the evaluations of all candidates and the solutions of the best ones. A solution takes some
//! ten kilobytes, and those of poor candidates are rarely needed. If one is needed after all, it is recomputed.

use super::cem::{Evaluation, GenerationResults, rank_order};

/// Number of solutions kept per population. Too small: solutions are recomputed; too large: memory.
pub(super) const MAX_SOLUTIONS: usize = 256;

/// Results of the candidates of a generation, added in any order.
pub(super) struct Population<S> {
    /// Evaluation of each candidate, with the time at which it was added, s.
    evaluations: Vec<Option<(Evaluation, f64)>>,
    /// Objective, index and solution of the best candidates, best first.
    best: Vec<(f64, usize, Box<S>)>,
    /// Largest number of solutions to keep.
    max_solutions: usize,
}

impl<S> Population<S> {
    /// An empty population.
    pub fn new(candidates: usize, max_solutions: usize) -> Self {
        Population { evaluations: vec![None; candidates], best: Vec::new(), max_solutions }
    }

    /// Adds a candidate, and drops the solution of the worst one if there are too many.
    ///
    /// * `seconds` - present time, s
    pub fn add(&mut self, index: usize, objective: f64, seconds: f64, evaluation: Evaluation, solution: S) {
        self.evaluations[index] = Some((evaluation, seconds));
        let place = self.best.partition_point(|(other, at, _)| rank_order((*other, *at), (objective, index)).is_lt());
        if place < self.max_solutions {
            self.best.insert(place, (objective, index, Box::new(solution)));
            self.best.truncate(self.max_solutions);
        }
    }

    /// Drops the candidates that are not needed.
    pub fn retain(&mut self, needed: impl Fn(usize) -> bool) {
        self.evaluations.iter_mut().enumerate().filter(|(index, _)| !needed(*index)).for_each(|(_, evaluation)| *evaluation = None);
    }

    /// Time at which the first feasible candidate was added, s.
    pub fn first_feasible_after(&self) -> Option<f64> {
        self.evaluations.iter().flatten().filter(|(evaluation, _)| evaluation.feasible).map(|(_, seconds)| *seconds).reduce(f64::min)
    }

    /// Evaluation of each candidate, with its solution if it was kept.
    pub fn results(self) -> GenerationResults<S> {
        let mut results: Vec<_> = self.evaluations.into_iter().map(|result| result.map(|(evaluation, _)| (evaluation, None))).collect();
        for (_, index, solution) in self.best {
            if let Some((_, kept)) = &mut results[index] {
                *kept = Some(solution);
            }
        }
        results
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Adds candidates with these objectives in this order of indices. Returns the indices whose solutions are kept.
    fn kept(objectives: &[f64], order: &[usize], max_solutions: usize) -> Vec<usize> {
        let mut population = Population::new(objectives.len(), max_solutions);
        for &index in order {
            let evaluation = Evaluation { n_violated: index, feasible: true, certified: true, mean_normal_force: 0., cost: None };
            population.add(index, objectives[index], 0., evaluation, index);
            assert!(population.best.len() <= max_solutions);
        }
        let results = population.results();
        assert!(results.iter().enumerate().all(|(i, result)| result.as_ref().is_some_and(|(e, _)| e.n_violated == i)));
        let solutions = results.into_iter().flatten().filter_map(|(_, solution)| solution.map(|s| *s));
        solutions.collect()
    }

    #[test]
    fn the_best_candidates_keep_their_solutions_in_any_order_of_arrival() {
        let objectives = [3., 1., f64::NEG_INFINITY, 3., 2., 3.];
        for order in [[0, 1, 2, 3, 4, 5], [5, 4, 3, 2, 1, 0], [2, 5, 0, 1, 3, 4]] {
            // The first one wins a tie.
            assert_eq!(kept(&objectives, &order, 2), [0, 3]);
            assert_eq!(kept(&objectives, &order, 4), [0, 3, 4, 5]);
            assert_eq!(kept(&objectives, &order, 9), [0, 1, 2, 3, 4, 5]);
            assert!(kept(&objectives, &order, 0).is_empty());
        }
    }

    #[test]
    fn candidates_that_are_not_needed_have_no_result() {
        let mut population = Population::new(3, 3);
        for (index, seconds) in [(0, 2.), (2, 1.)] {
            let evaluation = Evaluation { n_violated: 0, feasible: true, certified: true, mean_normal_force: 0., cost: None };
            population.add(index, 0., seconds, evaluation, ());
        }
        assert_eq!(population.first_feasible_after(), Some(1.));
        population.retain(|index| index < 2);
        assert_eq!(population.first_feasible_after(), Some(2.));
        let results = population.results();
        assert!(results[0].as_ref().is_some_and(|(_, solution)| solution.is_some()));
        assert!(results[1].is_none() && results[2].is_none());
    }
}
