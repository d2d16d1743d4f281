//! Continuation over the relief of the ground, if a search finds no gait: a gait on lower ground, whose ground then rises step by step.
//!
//! Onto a block, feet must swing for longer than in any gait of a family, and at the right stride only. On ground of half the height the
//! gaits of the families are found, and each rise needs only small changes of the phase times.

use super::{BatchEvaluator, SearchState};
use crate::backend::Solution;
use crate::error::Result;
use crate::nlp::Problem;
use crate::search::batch::BatchSolver;
use crate::search::cem::{self, Candidate, Generation, PerturbSettings, StopReason};
use crate::search::evaluate::{Evaluated, EvaluationContext, LowerSettings};
use crate::search::timed::TimedEvaluator;
use crate::search::{Gaits, SearchEvent, SearchSettings};
use crate::settings::SolverSettings;
use crate::solver::{Finish, Solver, close};
use tracing::{debug, info};

/// Shares of the relief on which a first gait is searched, one after the other.
const FIRST: [f64; 3] = [0.5, 0.25, 0.125];
/// First rise below a motion, as a share of the relief; its factors after a rise that the motion followed and after another one.
const STEP: f64 = 0.05;
const GROWTH: f64 = 1.5;
const SHRINKING: f64 = 0.5;
/// First rise at which other phase times are tried.
const CHANGED_STEP: f64 = 0.02;
/// Least rise.
const LEAST_STEP: f64 = 2e-3;
/// Barrier parameter of a solve that starts from the motion on slightly lower ground.
const WARM_BARRIER: f64 = 1e-3;
/// Candidates per generation and generations per level.
const POPULATION: usize = 64;
const GENERATIONS: usize = 2;
/// Standard deviations of the times of lift-off and touchdown, and of the time scale, see [`PerturbSettings`].
const STD: f64 = 0.1;

/// Ground on which a search found gaits that it did not find on the ground of the task.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LowerGround {
    /// Largest share of the relief on which a gait was found: 1 for the ground of the task, 0 if there was none.
    pub share: f64,
    /// Number of levels on which gaits were searched.
    pub levels: usize,
    /// Number of solves.
    pub candidates: usize,
}

impl LowerGround {
    /// Next share of the relief. The last rise ends on the ground of the task itself.
    fn next(&self, step: f64) -> f64 {
        if self.share + step > 1. - LEAST_STEP { 1. } else { self.share + step }
    }
}

impl SearchState<'_, '_> {
    /// Searches for a gait on lower ground and raises that ground. A gait on the ground of the task becomes one of the search.
    ///
    /// Returns the reason if the search ends.
    pub(super) fn raise_ground(&mut self, evaluator: &mut BatchEvaluator) -> Result<Option<StopReason>> {
        let mut ground = LowerGround { share: 0., levels: 0, candidates: 0 };
        let found = self.raised(&mut ground);
        info!(share = ground.share, levels = ground.levels, candidates = ground.candidates, "lower ground");
        self.lower_ground = Some(ground);
        if let Some(gait) = found?.filter(|_| ground.share == 1.) {
            evaluator.first_feasible_after.get_or_insert(self.clock.seconds());
            let (settings, generation, solution) = (self.settings.cem(1), self.generations.len(), gait.solution);
            let schedule = (*solution.schedule).clone();
            let ranked =
                [Candidate::new(&settings, gait.family, generation, 0, schedule, solution.evaluation, Some(Box::new(solution)))];
            let record = cem::summarise(generation, ranked.iter(), 0., 0.);
            self.process(&Generation { record: &record, ranked: &ranked });
            return Ok(self.settings.first.then_some(StopReason::FirstFeasible));
        }
        Ok(self.over().then(|| self.clock.stop_reason()))
    }

    /// True if the search must end.
    fn over(&self) -> bool {
        self.clock.cancelled() || self.clock.expired()
    }

    /// Gait on the highest ground on which one is found.
    fn raised(&self, ground: &mut LowerGround) -> Result<Option<Candidate<Evaluated>>> {
        let first = SearchSettings { first: true, relief_levels: 0, seconds: None, ..self.settings.clone() };
        let mut lower = self.solver.settings.clone();
        lower.solver.optimise.iterations = 0;
        let mut gait = None;
        for share in FIRST {
            if gait.is_none() && self.may_go_on(ground) {
                gait = self.on_level(share, &first, &lower, ground)?;
            }
        }
        let Some(mut gait) = gait else { return Ok(None) };
        let mut step = CHANGED_STEP;
        loop {
            self.follow(&mut gait, &lower, ground);
            if ground.share == 1. || step < LEAST_STEP || !self.may_go_on(ground) {
                return Ok(Some(gait));
            }
            let around = SearchSettings {
                gaits: Gaits::Around((*gait.solution.schedule).clone()),
                generations: GENERATIONS,
                further_generations: 0,
                perturb: PerturbSettings { std: STD, pace_std: STD, ..first.perturb.clone() },
                ..first.clone()
            };
            match self.on_level(ground.next(step), &around.with_population(POPULATION), &lower, ground)? {
                Some(found) => {
                    gait = Candidate { family: gait.family, ..found };
                    step = CHANGED_STEP;
                }
                None => step *= SHRINKING,
            }
        }
    }

    /// True if gaits may be searched on another level.
    fn may_go_on(&self, ground: &LowerGround) -> bool {
        ground.levels < self.settings.relief_levels && !self.over()
    }

    /// First gait that a search finds on ground with a share of the relief.
    fn on_level(
        &self,
        share: f64,
        settings: &SearchSettings,
        lower: &LowerSettings,
        ground: &mut LowerGround,
    ) -> Result<Option<Candidate<Evaluated>>> {
        ground.levels += 1;
        let Ok(task) = self.task.with_relief(share) else { return Ok(None) };
        let BatchSolver { backend, cost, .. } = *self.solver;
        let solver = BatchSolver { task: &task, settings: lower, backend, cost, incumbent: None };
        let mut evaluator = TimedEvaluator::new(&solver, self.clock).certifying_on_demand();
        let mut ignore = |_: &SearchEvent| {};
        // Each level has its own random numbers: the same ones would repeat the same change.
        let seed = self.seed.wrapping_add(ground.levels as u64);
        let mut state = SearchState::new(&solver, settings, seed, self.clock, &mut ignore);
        state.run(&mut evaluator)?;
        ground.candidates += state.generations.iter().map(|record| record.evaluated).sum::<usize>();
        debug!(share, found = state.best.is_some(), "level");
        if state.best.is_some() {
            ground.share = ground.share.max(share);
        }
        Ok(state.best)
    }

    /// Raises the ground below a motion as far as the motion can follow: each solve starts from the motion before.
    fn follow(&self, gait: &mut Candidate<Evaluated>, lower: &LowerSettings, ground: &mut LowerGround) {
        let mut step = STEP;
        while ground.share < 1. && step >= LEAST_STEP && !self.over() {
            let next = ground.next(step);
            let followed = self.followed(next, &gait.solution, lower);
            ground.candidates += 1;
            debug!(share = next, found = followed.is_some(), "rise");
            match followed {
                Some(solution) => {
                    gait.solution = solution;
                    ground.share = next;
                    step *= GROWTH;
                }
                None => step = SHRINKING * (next - ground.share),
            }
        }
    }

    /// The motion of a gait on ground with another share of the relief, solved in f64 from the present one; `None` if it is not certified.
    fn followed(&self, share: f64, gait: &Evaluated, lower: &LowerSettings) -> Option<Evaluated> {
        let (task, schedule) = (self.task.with_relief(share).ok()?, &gait.schedule);
        let cancelled = || self.over();
        let problem = Problem::<f64>::new(&task, schedule, &lower.transcription);
        if problem.initial.len() != gait.x.len() {
            return None;
        }
        let settings = SolverSettings { barrier: Some(WARM_BARRIER), ..lower.solver.clone() };
        let mut solver = Solver::<f64>::default();
        let outcome = solver.solve(&problem, &settings, Finish::Infeasibility(settings.tolerance), Some(&gait.x), &cancelled);
        let (outcome, x) = close(&problem, outcome, solver.solution(), &settings, &cancelled);
        let solution = Solution { outcome, x, variables: problem.curves.variables, curves: problem.curves, closed: true };
        let context = EvaluationContext { task: &task, schedule, settings: lower, weights: self.solver.cost };
        Some(context.examined(solution)).filter(|solution| solution.feasible)
    }
}
