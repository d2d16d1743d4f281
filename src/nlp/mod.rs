//! Trajectory optimisation problem of one candidate: its variables, its rows and the tables that the loops use.
//!
//! Rows form elements. An element is a small group of rows with the same columns, such as the six dynamics rows of an instant. Each family
//! computes residuals and dense Jacobians of its elements. All later stages (assembly, products, steps) work on elements, so they are the
//! same for every transcription.

mod builder;
mod columns;
mod cost;
mod factored;
mod foot_blocks;
mod footing;
mod ground_path;
mod periodic;
pub mod problem;
pub mod sweep;
mod swing_curve;
mod trajectory;
pub mod transcription;

pub(crate) use cost::RESPONSE;
pub use problem::{Curves, Problem};
pub use trajectory::trajectory;

use crate::gait::AlignedSchedule;
use crate::gait::cost::CostWeights;
use crate::real::Real;
use crate::settings::{Transcription, TranscriptionSettings};
use crate::task::Task;
use builder::Builder;

impl<T: Real> Problem<T> {
    /// Builds the problem of a schedule.
    pub fn new(task: &Task, schedule: &AlignedSchedule, settings: &TranscriptionSettings) -> Self {
        Problem::with_cost(task, schedule, settings, None)
    }

    /// Builds the problem of a schedule, with the rows of an objective if one is given. Only `momentum` has these rows.
    pub fn with_cost(task: &Task, schedule: &AlignedSchedule, settings: &TranscriptionSettings, cost: Option<&CostWeights>) -> Self {
        let mut builder = builder(task, schedule, settings);
        if let Some(weights) = cost.filter(|_| settings.rows == Transcription::Momentum) {
            cost::cost_elements(transcription::of(settings.rows), &mut builder, weights);
        }
        builder.finish()
    }
}

impl Curves {
    /// Positions of the blocks in `x`, equal to [`Problem::curves`]. Faster than building a whole problem, because rows get no columns.
    pub fn new(task: &Task, schedule: &AlignedSchedule, settings: &TranscriptionSettings) -> Curves {
        builder::<f64>(task, schedule, settings).finish_curves()
    }
}

/// Builder with all blocks and elements of the problem of a schedule.
fn builder<'a, T: Real>(task: &'a Task, schedule: &AlignedSchedule, settings: &'a TranscriptionSettings) -> Builder<'a, T> {
    let own = transcription::of(settings.rows);
    let (force_limit, limits) = (transcription::force_limit(settings, task), own.limits(settings, &task.robot));
    let mut builder = Builder::new(task, schedule, settings, force_limit, limits, own.steps(schedule.count()));
    own.base_blocks(&mut builder);
    foot_blocks::blocks(own, &mut builder);
    own.dynamics(&mut builder);
    foot_blocks::rows(own, &mut builder);
    periodic::rows(&mut builder);
    builder
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gait::family::{PeriodicGait, families};
    use crate::robot::Reach;
    use crate::scenario::SCENARIOS;
    use crate::settings::Stretch;
    use std::sync::Arc;

    #[test]
    fn curves_without_a_layout_equal_those_of_the_layout() {
        for scenario in SCENARIOS {
            let task = scenario.task(1).unwrap();
            let schedule = PeriodicGait::typical(families(&task.robot)[0], &task).unwrap().schedule().unwrap();
            for rows in [Transcription::Momentum, Transcription::Towr] {
                let settings = TranscriptionSettings::of(rows);
                let schedule = schedule.aligned(transcription::interval(&settings, &task.robot));
                let problem = Problem::<f64>::new(&task, &schedule, &settings);
                let curves = Curves::new(&task, &schedule, &settings);
                assert_eq!(format!("{curves:?}"), format!("{:?}", problem.curves), "{}", scenario.name);
                assert_eq!(curves.variables, problem.variables);
            }
        }
    }

    #[test]
    fn phases_that_begin_early_have_the_wider_reach_and_later_ones_the_usual() {
        let task = SCENARIOS[0].task(1).unwrap();
        let schedule = PeriodicGait::typical(families(&task.robot)[0], &task).unwrap().schedule().unwrap();
        let legs_of = |stretch| {
            let settings = TranscriptionSettings { stretch, ..TranscriptionSettings::default() };
            let schedule = schedule.aligned(transcription::interval(&settings, &task.robot));
            Problem::<f64>::new(&task, &schedule, &settings).reach_legs.clone()
        };
        let (usual, factors) = (legs_of(None), [2., 1.5, 1.2]);
        let ratios = |until: f64| {
            let wider = |foot| task.robot.reach.foot(foot).with_sides(|slab| slab.stretched(factors).sides);
            let reach = Arc::new(Reach::PerFoot((0..task.robot.feet()).map(wider).collect()));
            let wider = legs_of(Some(Stretch { reach, until }));
            usual.iter().zip(&wider).map(|(a, b)| [0, 1, 2].map(|i| b.half_widths[i] / a.half_widths[i])).collect::<Vec<_>>()
        };
        let is = |ratio: &[f64; 3], factors: [f64; 3]| ratio.iter().zip(factors).all(|(a, b)| (a - b).abs() < 1e-12);
        let first = ratios(0.).iter().filter(|ratio| is(ratio, factors)).count();
        assert!(first == 2 * task.robot.feet(), "the first stance and the first swing of each foot");
        assert!(ratios(1e3).iter().all(|ratio| is(ratio, factors)));
        let half = ratios(schedule.horizon() / 2.);
        let (wide, narrow) = half.iter().partition::<Vec<_>, _>(|ratio| is(ratio, factors));
        assert!(wide.len() > task.robot.feet() && narrow.len() > task.robot.feet() && narrow.iter().all(|ratio| is(ratio, [1.; 3])));
    }
}
