//! A stride that repeats within a motion.

use crate::error::{Error, Result, check_range};
use crate::gait::AlignedSchedule;
use std::ops::Range;

/// Largest relative difference between the phases at the start and at the end of a stride.
const SAME_PHASES: f64 = 1e-6;

/// Periodic stride within a motion: at its end, pose and rates of the base, footholds and swing heights are those at its start, moved by a
/// displacement. Every foot steps once.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeriodicStride {
    /// Index of the base knot at the start.
    pub start: usize,
    /// Number of intervals between base knots.
    pub intervals: usize,
    /// Displacement in one stride, world frame, m.
    pub displacement: [f64; 3],
    /// True if the cost that is minimised is that of this stride, and what comes before and after only leads to it; false for the cost of
    /// the whole motion.
    pub costs_alone: bool,
}

impl PeriodicStride {
    /// Start and end, s.
    ///
    /// * `interval` - time between base knots, s
    pub fn times(&self, interval: f64) -> Range<f64> {
        self.start as f64 * interval..(self.start + self.intervals) as f64 * interval
    }

    /// Index of the phase of a foot at the start, from the ends of its phases; at a boundary between phases, the later one.
    pub(crate) fn first_phase(&self, ends: impl Iterator<Item = f64>, interval: f64) -> usize {
        let start = self.times(interval).start + SAME_PHASES * interval;
        ends.take_while(|end| *end < start).count()
    }

    /// Checks that the stride lies between the ends of a schedule whose phases repeat in it.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the value that is outside its limits, or the foot whose phases do not repeat.
    pub(crate) fn check(&self, schedule: &AlignedSchedule) -> Result<()> {
        let (count, interval) = (schedule.count(), schedule.interval());
        check_range("stride.intervals", self.intervals as f64, 1., count as f64)?;
        check_range("stride.start", self.start as f64, 0., (count - self.intervals) as f64)?;
        for (axis, value) in self.displacement.into_iter().enumerate() {
            check_range(&format!("stride.displacement[{axis}]"), value, -1e3, 1e3)?;
        }
        let Range { start, end } = self.times(interval);
        for foot in 0..schedule.feet() {
            let phases = schedule.phases(foot);
            let first = self.first_phase(phases.iter().map(|p| p.end), interval);
            // A foot that stands at both ends has made its step between them; a swing that is cut must be cut at the same place.
            let repeats = |i: usize| {
                let [this, next] = [first + i, first + 2 + i].map(|at| phases.get(at).map(|p| p.start));
                this.zip(next).is_some_and(|(this, next)| (next - this - (end - start)).abs() < SAME_PHASES)
            };
            let steps_once = phases.get(first + 2).is_some_and(|p| p.start < end + SAME_PHASES && p.end > end - SAME_PHASES);
            if !(steps_once && (first.is_multiple_of(2) || repeats(0) && repeats(1))) {
                let place = format!("durations, foot {foot}");
                return Err(Error::invalid(
                    place,
                    "phases that do not repeat",
                    format!("one step in the stride from {start} s to {end} s"),
                ));
            }
        }
        Ok(())
    }
}
