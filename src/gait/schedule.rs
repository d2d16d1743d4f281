//! Contact schedules: stance and swing phases of each foot.

use crate::error::{Error, Result};
use crate::robot::MAX_FEET;
use serde::{Deserialize, Serialize};

/// Longest horizon, s.
pub const MAX_HORIZON: f64 = 120.;
/// Largest number of phases of one foot.
pub const MAX_PHASES: usize = 1001;
/// Shortest phase, s.
pub const MIN_PHASE: f64 = 1e-3;

/// Duration that stays when the number of strides changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kept {
    /// The time for which a foot swings in all, and so its mean speed in the air.
    TimeInAir,
    /// Each swing, and so the rhythm of the gait; the horizon changes more.
    Swings,
}

/// Interval in which one foot's contact does not change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Phase {
    /// Start, s.
    pub start: f64,
    /// End, s.
    pub end: f64,
    /// True if the foot stands.
    pub stance: bool,
}

impl Phase {
    /// Duration, s.
    pub fn duration(&self) -> f64 {
        self.end - self.start
    }
}

/// Phase durations of all feet, s, alternating stance, swing, ..., stance. In files a list of lists, `[feet][phases]`.
///
/// A foot may be in the air at either end. If its first duration is 0, it swings at the start. If its last duration is not positive, it
/// swings at the end, and lands that long after the end: the sum of its durations is still the time of the end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(try_from = "Vec<Vec<f64>>", into = "Vec<Vec<f64>>")]
pub struct Schedule {
    durations: Vec<Vec<f64>>,
}

impl TryFrom<Vec<Vec<f64>>> for Schedule {
    type Error = Error;

    fn try_from(durations: Vec<Vec<f64>>) -> Result<Schedule> {
        Schedule::new(durations)
    }
}

impl From<Schedule> for Vec<Vec<f64>> {
    fn from(schedule: Schedule) -> Self {
        schedule.durations
    }
}

impl Schedule {
    /// Creates and validates a schedule.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the foot and the phase: no feet or more than [`MAX_FEET`]; an even number of phases (the foot would end in
    /// swing) or more than [`MAX_PHASES`]; durations that are not finite or shorter than [`MIN_PHASE`], except those of feet in the air at
    /// an end; a total of more than [`MAX_HORIZON`].
    pub fn new(durations: Vec<Vec<f64>>) -> Result<Schedule> {
        if durations.is_empty() || durations.len() > MAX_FEET {
            return Err(Error::invalid("durations", format!("{} feet", durations.len()), format!("1 to {MAX_FEET} feet")));
        }
        for (foot, phases) in durations.iter().enumerate() {
            let place = format!("durations, foot {foot}");
            if phases.is_empty() || phases.len() > MAX_PHASES {
                return Err(Error::invalid(place, format!("{} phases", phases.len()), format!("1 to {MAX_PHASES} phases")));
            }
            if phases.len() % 2 == 0 {
                return Err(Error::invalid(
                    place,
                    format!("{} phases", phases.len()),
                    "an odd number: stance and swing alternate, the first and the last phase are stance",
                ));
            }
            let last = phases.len() - 1;
            for (phase, &d) in phases.iter().enumerate() {
                // The tolerance allows for durations that are differences of rounded times.
                let least = MIN_PHASE * (1. - 1e-9);
                let lifted = phase == 0 && last > 0 && d == 0.;
                // The swing must begin before the end.
                let lands_later = phase == last && last > 0 && d <= 0. && phases[last - 1] + d >= least;
                if !(d.is_finite() && (d >= least || lifted || lands_later)) {
                    return Err(Error::invalid(format!("{place}, phase {phase}"), format!("{d} s"), format!("at least {MIN_PHASE} s")));
                }
            }
            let total: f64 = phases.iter().sum();
            if total > MAX_HORIZON {
                return Err(Error::invalid(place, format!("{total} s in all"), format!("at most {MAX_HORIZON} s")));
            }
        }
        Ok(Schedule { durations })
    }

    /// Durations, s, `[feet][phases]`.
    pub fn durations(&self) -> &[Vec<f64>] {
        &self.durations
    }

    /// Number of feet.
    pub fn feet(&self) -> usize {
        self.durations.len()
    }

    /// Number of stance phases of a foot.
    pub fn stances(&self, foot: usize) -> usize {
        self.durations[foot].len().div_ceil(2)
    }

    /// Largest sum of a foot's durations, s.
    pub fn horizon(&self) -> f64 {
        self.durations.iter().map(|d| d.iter().sum()).fold(0., f64::max)
    }

    /// Number of intervals of length `interval` that cover the horizon.
    pub fn intervals(&self, interval: f64) -> usize {
        ((self.horizon() / interval - 1e-9).ceil() as usize).max(1)
    }

    /// Stretches every foot's last stance to a common horizon, a multiple of `interval`.
    ///
    /// The paper \[1\] stretches to the longest foot. The remainder of less than one interval makes knots and instants uniform.
    pub fn aligned(&self, interval: f64) -> AlignedSchedule {
        let intervals = self.intervals(interval);
        AlignedSchedule { schedule: self.ended_at(intervals as f64 * interval), interval, intervals }
    }

    /// Wraps a copy of a schedule that [`Schedule::aligned`] has produced, without changing its durations in the last bit.
    ///
    /// # Errors
    /// [`Error::Invalid`] if not all feet end at the same multiple of `interval`.
    #[cfg(feature = "python")]
    pub(crate) fn aligned_before(self, interval: f64) -> Result<AlignedSchedule> {
        let intervals = self.intervals(interval);
        let end = intervals as f64 * interval;
        for (foot, phases) in self.durations.iter().enumerate() {
            let total: f64 = phases.iter().sum();
            if (total - end).abs() > 1e-9 {
                return Err(Error::invalid(format!("durations, foot {foot}"), format!("{total} s in all"), format!("{end} s")));
            }
        }
        Ok(AlignedSchedule { schedule: self, interval, intervals })
    }

    /// Scales all durations so that the longest foot lasts as given.
    ///
    /// * `duration` - s
    ///
    /// # Errors
    /// [`Error::Invalid`] if a phase becomes shorter than [`MIN_PHASE`], or the duration exceeds [`MAX_HORIZON`].
    pub fn lasting(&self, duration: f64) -> Result<Schedule> {
        let factor = duration / self.horizon();
        Schedule::new(self.durations.iter().map(|phases| phases.iter().map(|phase| phase * factor).collect()).collect())
    }

    /// Stretches every foot's last stance to the end of the longest foot, as in the paper \[1\].
    pub fn stretched(&self) -> Schedule {
        self.ended_at(self.horizon())
    }

    /// The schedule with another number of strides: each foot repeats or leaves out some of its swings, evenly spread, together with the
    /// stances before them. All feet end when the last one did. `None` if a foot has fewer than two swings before or none after, or is in
    /// the air at an end.
    ///
    /// * `kept` - duration that stays
    /// * `strides` - number of swings of a foot after the change, from that before it; at least half of it
    pub fn with_strides(&self, kept: Kept, strides: impl Fn(usize) -> usize) -> Option<Schedule> {
        let changed = |phases: &Vec<f64>| {
            let before = phases.len() / 2;
            let after = strides(before);
            let in_air = starts_in_swing(phases) || lands_after(phases).is_some();
            if in_air || before < 2 || after == 0 || 2 * after < before {
                return None;
            }
            let mut changed: Vec<f64> = (0..after).flat_map(|i| phases[(2 * i + 1) * before / (2 * after) * 2..][..2].to_vec()).collect();
            changed.extend(phases.last());
            if kept == Kept::TimeInAir {
                let swings = |phases: &[f64]| phases.iter().skip(1).step_by(2).sum::<f64>();
                let factor = swings(phases) / swings(&changed);
                changed.iter_mut().skip(1).step_by(2).for_each(|swing| *swing *= factor);
            }
            Some(changed)
        };
        let durations = self.durations.iter().map(changed).collect::<Option<Vec<_>>>()?;
        Schedule::new(durations).ok().map(|schedule| schedule.stretched())
    }

    fn ended_at(&self, horizon: f64) -> Schedule {
        let mut durations = self.durations.clone();
        for phases in &mut durations {
            let total: f64 = phases.iter().sum();
            if let Some(last) = phases.last_mut() {
                let lands_later = *last <= 0.;
                *last += horizon - total;
                // A foot that lands at the end, up to rounding, or soon before it stands from then on for no time.
                if lands_later && last.abs() < MIN_PHASE {
                    *last = 0.;
                }
            }
        }
        Schedule { durations }
    }

    /// True if a foot is in the air at the start.
    pub fn starts_in_swing(&self, foot: usize) -> bool {
        starts_in_swing(&self.durations[foot])
    }

    /// Time between the end and the next touchdown of a foot that is in the air at the end, s; `None` for a foot that stands there.
    pub fn lands_after(&self, foot: usize) -> Option<f64> {
        lands_after(&self.durations[foot])
    }

    /// Phases of a foot with their times. The last swing of a foot that lands later ends after the horizon; its last stance ends before it
    /// starts. The first stance of a foot that starts in the air has no length.
    pub fn phases(&self, foot: usize) -> Vec<Phase> {
        let mut start = 0.;
        let phases = self.durations[foot].iter().enumerate();
        phases
            .map(|(i, &d)| {
                let phase = Phase { start, end: start + d, stance: i % 2 == 0 };
                start = phase.end;
                phase
            })
            .collect()
    }
}

/// See [`Schedule::starts_in_swing`].
pub(crate) fn starts_in_swing(durations: &[f64]) -> bool {
    durations.len() > 1 && durations[0] == 0.
}

/// See [`Schedule::lands_after`].
pub(crate) fn lands_after(durations: &[f64]) -> Option<f64> {
    durations.last().filter(|&&d| durations.len() > 1 && d <= 0.).map(|d| -d)
}

/// Schedule whose feet all end after the same whole number of intervals, as a problem requires. Only [`Schedule::aligned`] creates it.
#[derive(Debug, Clone, PartialEq)]
pub struct AlignedSchedule {
    schedule: Schedule,
    interval: f64,
    intervals: usize,
}

impl AlignedSchedule {
    /// Length of an interval, s.
    pub fn interval(&self) -> f64 {
        self.interval
    }

    /// Number of intervals.
    pub fn count(&self) -> usize {
        self.intervals
    }

    /// End of all feet, s.
    pub fn end(&self) -> f64 {
        self.intervals as f64 * self.interval
    }
}

impl std::ops::Deref for AlignedSchedule {
    type Target = Schedule;

    fn deref(&self) -> &Schedule {
        &self.schedule
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn aligned_ends_every_foot_at_the_same_multiple() {
        let s = Schedule::new(vec![vec![0.3, 0.2, 0.33], vec![0.25]]).unwrap();
        let a = s.aligned(0.1);
        assert_eq!(s.intervals(0.1), 9);
        for foot in 0..2 {
            assert!((a.durations()[foot].iter().sum::<f64>() - 0.9).abs() < 1e-12);
        }
        // Aligning twice changes at most the last bit of a sum.
        for (once, twice) in a.durations().iter().flatten().zip(a.aligned(0.1).durations().iter().flatten()) {
            assert!((once - twice).abs() < 1e-14);
        }
        assert_eq!((a.stances(0), a.stances(1)), (2, 1));
        assert!(a.phases(0)[0].stance && !a.phases(0)[1].stance);
    }

    #[test]
    fn the_shortest_phase_is_accepted_between_rounded_times() {
        const { assert!(1.001 - 1. < MIN_PHASE) };
        Schedule::new(vec![vec![1., 1.001 - 1., 1.]]).unwrap();
        assert!(Schedule::new(vec![vec![1., 0.999_99 * MIN_PHASE, 1.]]).is_err());
    }

    #[test]
    fn feet_may_be_in_the_air_at_both_ends() {
        let s = Schedule::new(vec![vec![0., 0.2, 0.3, 0.25, -0.1], vec![0.65]]).unwrap();
        assert!(s.starts_in_swing(0) && !s.starts_in_swing(1));
        assert_eq!((s.lands_after(0), s.lands_after(1)), (Some(0.1), None));
        assert!((s.horizon() - 0.65).abs() < 1e-12);
        // The touchdown stays where it is when the horizon is rounded up.
        let a = s.aligned(0.1);
        assert!((a.end() - 0.7).abs() < 1e-12 && (a.lands_after(0).unwrap() - 0.05).abs() < 1e-12);
        assert!((a.phases(0)[3].end - 0.75).abs() < 1e-12);
        assert_eq!(Schedule::new(vec![vec![0.3, 0.3, -0.1], vec![0.5]]).unwrap().aligned(0.1).lands_after(0), Some(0.1));
        let lands = Schedule::new(vec![vec![0.3, 0.2, 0.], vec![0.5]]).unwrap();
        assert_eq!(lands.aligned(0.1).lands_after(0), Some(0.));
        // The last swing must begin before the end, and only ends may lack a stance.
        for refused in [vec![0.3, 0.2, -0.2], vec![0.3, 0., 0.3], vec![0.3, 0.2, 0., 0.2, 0.3], vec![0.]] {
            assert!(Schedule::new(vec![refused]).is_err());
        }
    }

    #[test]
    fn another_number_of_strides_keeps_the_time_in_the_air_or_the_swings() {
        let s = Schedule::new(vec![vec![0.3, 0.2, 0.4, 0.21, 0.5, 0.19, 0.6, 0.2, 0.7], vec![0.5, 0.2, 0.4, 0.2, 0.5, 0.2, 0.6, 0.2, 0.5]])
            .unwrap();
        let swings = |s: &Schedule, foot: usize| s.durations()[foot].iter().skip(1).step_by(2).sum::<f64>();
        for (strides, stances) in [(3, [0.3, 0.5, 0.6, 0.7].as_slice()), (6, &[0.3, 0.4, 0.4, 0.5, 0.6, 0.6, 0.7]), (2, &[0.4, 0.6, 0.7])] {
            let changed = s.with_strides(Kept::TimeInAir, |before| before + strides - 4).unwrap();
            let found: Vec<f64> = changed.durations()[0].iter().step_by(2).copied().collect();
            assert!(found.iter().zip(stances).all(|(a, b)| (a - b).abs() < 1e-12) && found.len() == stances.len(), "{found:?}");
            assert!((0..2).all(|foot| (swings(&changed, foot) - swings(&s, foot)).abs() < 1e-12 && changed.stances(foot) == strides + 1));
            assert!((0..2).all(|foot| (changed.durations()[foot].iter().sum::<f64>() - changed.horizon()).abs() < 1e-12));
            let same = s.with_strides(Kept::Swings, |before| before + strides - 4).unwrap();
            let mean = |s: &Schedule| swings(s, 1) / (s.stances(1) - 1) as f64;
            assert!((mean(&same) - mean(&s)).abs() < 1e-12 && same.stances(0) == strides + 1);
        }
        for refused in [0, 1] {
            assert_eq!(s.with_strides(Kept::Swings, |_| refused), None);
        }
        for phases in [vec![0.3, 0.2, 0.6], vec![0., 0.2, 0.3, 0.2, 0.4], vec![0.3, 0.2, 0.3, 0.3, -0.1]] {
            assert_eq!(Schedule::new(vec![phases]).unwrap().with_strides(Kept::Swings, |before| before), None);
        }
    }

    #[test]
    fn a_schedule_is_scaled_to_a_duration() {
        let s = Schedule::new(vec![vec![0.3, 0.2, 0.5], vec![0.25], vec![0., 0.5, 0.3, 0.4, -0.2]]).unwrap();
        let scaled = s.lasting(2.5).unwrap();
        assert_eq!(scaled.durations().iter().map(Vec::len).collect::<Vec<_>>(), [3, 1, 5]);
        for (duration, expected) in scaled.durations().iter().flatten().zip([0.75, 0.5, 1.25, 0.625, 0., 1.25, 0.75, 1., -0.5]) {
            assert!((duration - expected).abs() < 1e-12, "{scaled:?}");
        }
        assert!((scaled.horizon() - 2.5).abs() < 1e-12);
        let short = s.lasting(0.004).unwrap_err().to_string();
        assert!(short.starts_with("durations, foot 0, phase 1: 0.000") && short.ends_with("at least 0.001 s"), "{short}");
        assert!(s.lasting(121.).unwrap_err().to_string().contains("at most 120 s"));
    }

    #[test]
    fn errors_in_schedules_name_the_place_and_the_reason() {
        let refused = |durations: Vec<Vec<f64>>| Schedule::new(durations).unwrap_err().to_string();
        assert!(refused(vec![]).contains("0 feet"));
        assert!(refused(vec![vec![1.]; 9]).contains("9 feet"));
        assert!(refused(vec![vec![1.], vec![]]).contains("foot 1"));
        assert!(refused(vec![vec![1., 2.]]).contains("odd number"));
        assert!(refused(vec![vec![1., -0.1, 1.]]).contains("foot 0, phase 1"));
        assert!(refused(vec![vec![f64::NAN]]).contains("NaN"));
        assert!(refused(vec![vec![1e9]]).contains("at most 120"));
    }
}
