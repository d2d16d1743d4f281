//! Continuation over the relief of the ground, if a search finds no gait: a gait on lower ground, whose ground then rises step by step.
//!
//! Onto a block, feet must swing for longer than in any gait of a family, and at the right stride only. On ground of half the height the
//! gaits of the families are found, and each rise needs only small changes of the phase times.

use super::{BatchEvaluator, SearchState};
use crate::error::Result;
use crate::search::batch::BatchSolver;
use crate::search::cem::{Candidate, PerturbSettings, StopReason};
use crate::search::evaluate::Evaluated;
use crate::search::timed::TimedEvaluator;
use crate::search::{Gaits, SearchEvent, SearchSettings};
use tracing::debug;

/// Shares of the relief on which a first gait is searched, one after the other.
const FIRST: [f64; 3] = [0.5, 0.25, 0.125];
/// Largest number of ascents, each with its own random numbers.
const ASCENTS: u64 = 3;
/// First rise, as a share of the relief; its factor after a level with a gait and after one without; and its least value.
const STEP: f64 = 0.08;
const GROWTH: f64 = 1.3;
const SHRINKING: f64 = 0.5;
const LEAST_STEP: f64 = 2e-3;
/// Candidates per generation and generations per level.
const POPULATION: usize = 64;
const GENERATIONS: usize = 2;
/// Standard deviations of the times of lift-off and touchdown, and of the time scale, see [`PerturbSettings`].
const STD: f64 = 0.1;

/// Ground on which a search found gaits that it did not find on the ground of the task.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LowerGround {
    /// Largest share of the relief on which a gait was found: 1 for the ground of the task, 0 without a gait.
    pub share: f64,
    /// Number of levels that were tried.
    pub levels: usize,
    /// Number of candidates on lower ground.
    pub candidates: usize,
}

impl SearchState<'_, '_> {
    /// Searches for a gait on lower ground and raises that ground. A gait on the ground of the task becomes one of the search.
    ///
    /// Returns the reason if the search ends.
    pub(super) fn raise_ground(&mut self, evaluator: &mut BatchEvaluator) -> Result<Option<StopReason>> {
        let mut ground = LowerGround { share: 0., levels: 0, candidates: 0 };
        let mut gait = None;
        for ascent in 0..ASCENTS {
            // Other random numbers will hardly find a gait if the lowest ground has none.
            let hopeless = ascent > 0 && ground.share == 0.;
            if gait.is_none() && !hopeless && self.may_go_on(&ground) {
                gait = self.raised(ascent, &mut ground)?;
            }
        }
        self.lower_ground = Some(ground);
        match gait {
            Some(gait) => self.generation(evaluator, vec![(gait.family, (*gait.solution.schedule).clone())]),
            None => Ok(self.clock.over().then(|| self.clock.stop_reason())),
        }
    }

    /// True if gaits may be searched on another level.
    fn may_go_on(&self, ground: &LowerGround) -> bool {
        ground.levels < self.settings.relief_levels && !self.clock.over()
    }

    /// Gait on the ground of the task that is reached from lower ground.
    fn raised(&mut self, ascent: u64, ground: &mut LowerGround) -> Result<Option<Candidate<Evaluated>>> {
        let first = SearchSettings { first: true, relief_levels: 0, ..self.settings.clone() };
        let (mut gait, mut share) = (None, 0.);
        for lower in FIRST {
            if gait.is_none() && self.may_go_on(ground) {
                (gait, share) = (self.on_level(lower, &first, ascent, ground)?, lower);
            }
        }
        let Some(mut gait) = gait else { return Ok(None) };
        let mut step = STEP;
        while share < 1. {
            if step < LEAST_STEP || !self.may_go_on(ground) {
                return Ok(None);
            }
            let around = SearchSettings {
                gaits: Gaits::Around((*gait.solution.schedule).clone()),
                generations: GENERATIONS,
                further_generations: 0,
                perturb: PerturbSettings { std: STD, pace_std: STD, ..first.perturb.clone() },
                ..first.clone()
            };
            step = step.min(1. - share);
            // The last rise ends on the ground of the task itself.
            let next = if share + step > 1. - LEAST_STEP { 1. } else { share + step };
            // Each level has its own random numbers: the same ones would repeat the same change.
            let level = ground.levels as u64;
            match self.on_level(next, &around.with_population(POPULATION), level, ground)? {
                Some(found) => {
                    gait = Candidate { family: gait.family, ..found };
                    (share, step) = (next, step * GROWTH);
                }
                None => step *= SHRINKING,
            }
        }
        Ok(Some(gait))
    }

    /// First gait that a search finds on ground with a share of the relief.
    ///
    /// * `further` - number that is added to the seed
    fn on_level(
        &mut self,
        share: f64,
        settings: &SearchSettings,
        further: u64,
        ground: &mut LowerGround,
    ) -> Result<Option<Candidate<Evaluated>>> {
        ground.levels += 1;
        let Ok(task) = self.task.with_relief(share) else { return Ok(None) };
        let BatchSolver { settings: lower, backend, cost, .. } = *self.solver;
        let mut lower = lower.clone();
        lower.solver.optimise.iterations = 0;
        let solver = BatchSolver { task: &task, settings: &lower, backend, cost, incumbent: None };
        let mut evaluator = TimedEvaluator::new(&solver, self.clock).certifying_on_demand();
        let mut ignore = |_: &SearchEvent| {};
        let mut state = SearchState::new(&solver, settings, self.seed.wrapping_add(further), self.clock, &mut ignore);
        state.run(&mut evaluator)?;
        ground.candidates += state.generations.iter().map(|record| record.evaluated).sum::<usize>();
        let found = state.best;
        if found.is_some() {
            ground.share = ground.share.max(share);
        }
        debug!(share, found = found.is_some(), candidates = ground.candidates, "level");
        (self.on_event)(&SearchEvent::LowerGround(ground));
        Ok(found)
    }
}
