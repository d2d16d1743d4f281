//! Gaits that repeat, entered at the phase in which the feet are.

use crate::error::Result;
use crate::gait::Schedule;
use crate::gait::family::GaitFamily;
use serde::{Deserialize, Serialize};

/// Shortest time for which a foot stays on the ground or in the air after the start of a schedule, s.
const SHORTEST_FIRST: f64 = 0.02;
/// Shortest stance that is planned between two swings, s.
const SHORTEST_STANCE: f64 = 0.06;
/// Distance of the boundaries of phases from the horizon, s.
const CLEAR_OF_END: f64 = 0.005;
/// Part of a swing that may have passed when a standing foot still lifts off for the rest of it.
const LATEST_LIFT: f64 = 0.35;

/// Contact of a foot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// True if the foot is in the air.
    pub in_air: bool,
    /// Time since its last touchdown or lift-off, s.
    pub since: f64,
    /// Shortest time in which a foot in the air can land, s.
    pub landing: f64,
}

impl Contact {
    /// A foot that has stood for long enough to lift off.
    pub const STANDING: Contact = Contact { in_air: false, since: 1., landing: 0. };
}

/// Gait that repeats one stride, at a point of the stride.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cycle {
    /// Family; `None` if all feet land and stand.
    pub family: Option<GaitFamily>,
    /// Duration of a swing, s.
    pub swing: f64,
    /// Duration of a stance, s.
    pub stance: f64,
    /// Fraction of the stride that has passed.
    pub phase: f64,
}

impl Cycle {
    /// Duration of a stride, s.
    pub fn period(&self) -> f64 {
        self.swing + self.stance
    }

    /// The gait after a time, s.
    pub fn after(self, time: f64) -> Cycle {
        Cycle { phase: (self.phase + time / self.period()).rem_euclid(1.), ..self }
    }

    /// Fraction of the stride since the lift-off of a foot with a phase offset.
    fn since_lift(&self, offset: f64) -> f64 {
        (self.phase - offset).rem_euclid(1.)
    }

    /// Times of the next two changes of a foot's contact, s.
    ///
    /// If the foot is where the gait has it, these are the times of the gait. Otherwise a foot in the air lands soon, and a standing foot
    /// still lifts off if most of its swing is left.
    fn first_changes(&self, offset: f64, contact: Contact) -> [f64; 2] {
        let (at, period, swing) = (self.since_lift(offset), self.period(), self.swing / self.period());
        let (until_land, until_lift) = ((swing - at) * period, (1. - at) * period);
        let expected = at < swing;
        match (contact.in_air, expected) {
            (true, true) => {
                let land = until_land.max(SHORTEST_FIRST).max(contact.landing);
                [land, (until_land + self.stance).max(land + SHORTEST_STANCE)]
            }
            (true, false) => {
                let land = self.landing(contact);
                [land, if until_lift < land + SHORTEST_STANCE { until_lift + period } else { until_lift }]
            }
            (false, true) => {
                let lifts = at < LATEST_LIFT * swing && contact.since >= SHORTEST_STANCE;
                if lifts { [SHORTEST_FIRST, until_land] } else { [until_land + self.stance, until_land + self.stance + self.swing] }
            }
            (false, false) => {
                let lift = until_lift.max(SHORTEST_FIRST);
                [lift, lift + self.swing]
            }
        }
    }

    /// Time after which a foot in the air lands if the gait has it on the ground, s.
    fn landing(&self, contact: Contact) -> f64 {
        (self.swing - contact.since).clamp(SHORTEST_FIRST, self.swing).max(contact.landing)
    }

    /// Schedule from now on.
    ///
    /// * `offsets` - phase offset of each foot
    /// * `contacts` - contact of each foot now
    /// * `horizon` - s
    ///
    /// # Errors
    /// The errors of [`Schedule::new`].
    pub fn schedule(&self, offsets: &[f64], contacts: &[Contact], horizon: f64) -> Result<Schedule> {
        let foot = |(&offset, &contact): (&f64, &Contact)| {
            let mut durations = if contact.in_air { vec![0.] } else { Vec::new() };
            let (mut time, mut in_air) = (0., contact.in_air);
            let changes = match self.family {
                Some(_) => self.first_changes(offset, contact).to_vec(),
                None if in_air => vec![self.landing(contact)],
                None => Vec::new(),
            };
            for number in 0.. {
                let next = match changes.get(number) {
                    Some(&time) => time,
                    None if self.family.is_none() => f64::INFINITY,
                    None => time + if in_air { self.swing } else { self.stance },
                };
                if next > horizon - CLEAR_OF_END {
                    // A foot in the air lands after the horizon.
                    let end = if in_air { next.max(horizon + CLEAR_OF_END) } else { horizon };
                    durations.push(end - time);
                    durations.extend(in_air.then_some(horizon - end));
                    break;
                }
                durations.push(next - time);
                (time, in_air) = (next, !in_air);
            }
            durations
        };
        Schedule::new(offsets.iter().zip(contacts).map(foot).collect())
    }

    /// Time by which the contacts of the feet and of the gait are apart, s: summed over the feet.
    pub fn mismatch(&self, offsets: &[f64], contacts: &[Contact]) -> f64 {
        let of_foot = |(&offset, contact): (&f64, &Contact)| {
            let at = self.since_lift(offset) * self.period();
            let (since, expected) = if at < self.swing { (at, true) } else { (at - self.swing, false) };
            if expected == contact.in_air {
                // The time for which a foot has stood matters little.
                return if contact.in_air { (since - contact.since).abs() } else { 0. };
            }
            let left = if expected { self.swing } else { self.stance } - since;
            self.period() / 4. + since.min(left)
        };
        offsets.iter().zip(contacts).map(of_foot).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TROT: [f64; 4] = [0., 0.5, 0.5, 0.];
    const STANDS: Contact = Contact::STANDING;

    fn trot(phase: f64) -> Cycle {
        Cycle { family: Some(GaitFamily::Trot), swing: 0.2, stance: 0.3, phase }
    }

    fn durations(cycle: &Cycle, contacts: [Contact; 4], horizon: f64) -> Vec<Vec<f64>> {
        let schedule = cycle.schedule(&TROT, &contacts, horizon).unwrap();
        for phases in schedule.durations() {
            assert!((phases.iter().sum::<f64>() - horizon).abs() < 1e-12);
        }
        schedule.durations().to_vec()
    }

    fn close(got: &[f64], expected: &[f64]) {
        assert!(got.len() == expected.len() && got.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{got:?} {expected:?}");
    }

    #[test]
    fn feet_that_are_where_the_gait_has_them_follow_it() {
        // 0.05 s into the swing of the first pair; the second lifts off after 0.2 s.
        let air = Contact { in_air: true, since: 0.05, landing: 0. };
        let got = durations(&trot(0.1), [air, STANDS, STANDS, air], 0.8);
        close(&got[0], &[0., 0.15, 0.3, 0.2, 0.15]);
        close(&got[1], &[0.2, 0.2, 0.3, 0.2, -0.1]);
        assert_eq!(trot(0.1).mismatch(&TROT, &[air, STANDS, STANDS, air]), 0.);
        // 0.3 s later the second pair is in the middle of its swing.
        assert!((trot(0.1).after(0.3).phase - 0.7).abs() < 1e-12);
    }

    #[test]
    fn feet_that_are_elsewhere_join_the_gait() {
        let air = |since| Contact { in_air: true, since, landing: 0. };
        // A foot in the air that should stand lands and keeps the next lift-off.
        let got = durations(&trot(0.5), [air(0.15), STANDS, STANDS, STANDS], 0.8);
        close(&got[0], &[0., 0.05, 0.2, 0.2, 0.3, 0.2, -0.15]);
        // Standing feet whose swing has just begun lift off; later they wait for the next one.
        close(&got[1], &[0.02, 0.18, 0.3, 0.2, 0.1]);
        close(&durations(&trot(0.7), [STANDS; 4], 0.8)[1], &[0.4, 0.2, 0.2]);
        // A foot that has just landed does not lift off again.
        close(&durations(&trot(0.5), [Contact { in_air: false, since: 0.01, landing: 0. }; 4], 0.8)[1], &[0.5, 0.2, 0.1]);
        assert!(trot(0.5).mismatch(&TROT, &[air(0.15), STANDS, STANDS, STANDS]) > 0.1);
    }

    #[test]
    fn to_stand_feet_land_and_stay() {
        let stand = Cycle { family: None, ..trot(0.3) };
        let got = durations(&stand, [Contact { in_air: true, since: 0.05, landing: 0. }, STANDS, STANDS, STANDS], 0.8);
        close(&got[0], &[0., 0.15, 0.65]);
        close(&got[1], &[0.8]);
    }

    #[test]
    fn boundaries_keep_clear_of_the_horizon() {
        for step in 0..200 {
            let horizon = 0.5 + 0.001 * step as f64;
            let air = Contact { in_air: true, since: 0.05, landing: 0. };
            for phases in durations(&trot(0.1), [air, STANDS, STANDS, air], horizon) {
                let last = phases[phases.len() - 1];
                assert!(last <= -CLEAR_OF_END + 1e-12 || last >= CLEAR_OF_END - 1e-12, "{phases:?}");
            }
        }
    }
}
