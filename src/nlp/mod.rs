//! Trajectory optimisation problem of one candidate: its variables, its rows and the tables that the loops use.
//!
//! Rows form elements. An element is a small group of rows with the same columns, such as the six dynamics rows of an instant. Each family
//! computes residuals and dense Jacobians of its elements. All later stages (assembly, products, steps) work on elements, so they are the
//! same for every transcription.

mod builder;
mod columns;
mod factored;
mod foot_blocks;
mod footing;
mod ground_path;
pub mod layout;
pub mod sweep;
mod trajectory;
pub mod transcription;

pub use layout::{Curves, Layout};
pub use trajectory::trajectory;

use crate::gait::AlignedSchedule;
use crate::real::Real;
use crate::settings::TranscriptionSettings;
use crate::task::Task;
use builder::Builder;

impl<T: Real> Layout<T> {
    /// Builds the problem of a schedule.
    pub fn new(task: &Task, schedule: &AlignedSchedule, settings: &TranscriptionSettings) -> Self {
        let own = transcription::of(settings.rows);
        let (force_limit, limits) = (transcription::force_limit(settings, task), own.limits(settings, &task.robot));
        let mut builder = Builder::new(task, schedule, settings, force_limit, limits, own.steps(schedule.count()));
        own.base_blocks(&mut builder);
        foot_blocks::blocks(own, &mut builder);
        own.dynamics(&mut builder);
        foot_blocks::rows(own, &mut builder);
        builder.finish()
    }
}
