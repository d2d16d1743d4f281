//! Families beside the one in force: their last motions, and when they are tried again.

use super::candidates::Candidate;
use super::solve::Solved;
use super::warm::Before;
use crate::gait::Trajectory;
use crate::gait::family::GaitFamily;
use crate::nlp::trajectory;

/// Largest number of updates without a family.
const LONGEST_REST: u32 = 8;

/// State of one family.
struct Alternative {
    family: GaitFamily,
    /// Motion of its cheapest candidate at the last update, and the time at which the motion starts, s.
    motion: Option<(f64, Trajectory)>,
    /// Number of updates until it is tried again.
    left: u32,
    /// Number of updates for which it rests if no candidate of it holds at the next one.
    rest: u32,
}

/// All families.
///
/// A family without a candidate that holds, or whose cost is too high, rests for 1, 2, 4, then 8 updates, and one more for each family
/// before it in the list, so that not all are tried at once.
pub(super) struct Alternatives {
    of: Vec<Alternative>,
}

impl Alternatives {
    pub fn new(families: impl Iterator<Item = GaitFamily>) -> Alternatives {
        Alternatives { of: families.map(|family| Alternative { family, motion: None, left: 0, rest: 1 }).collect() }
    }

    /// True if the family is tried at the next update.
    pub fn is_due(&self, family: GaitFamily) -> bool {
        self.of.iter().any(|one| one.family == family && one.left == 0)
    }

    /// True if a candidate of the family held at the last update.
    pub fn holds(&self, family: GaitFamily) -> bool {
        self.of.iter().any(|one| one.family == family && one.motion.is_some())
    }

    /// Tries all families at the next update.
    pub fn wake(&mut self) {
        self.of.iter_mut().for_each(|one| (one.left, one.rest) = (0, 1));
    }

    /// Motions of the last update, from a start on.
    ///
    /// * `yaw` - measured, rad
    pub fn guesses(&self, start: f64, yaw: f64) -> impl Iterator<Item = (GaitFamily, Before)> {
        let motions = self.of.iter().filter_map(|one| Some((one.family, one.motion.as_ref()?)));
        motions.map(move |(family, (begin, motion))| (family, Before::new(motion, start - begin).turned_to(yaw)))
    }

    /// Keeps the motions of the cheapest candidates of an update.
    pub fn learn(&mut self, candidates: &[Candidate], solved: &[Option<Solved>], start: f64) {
        for (number, one) in self.of.iter_mut().enumerate() {
            one.motion = None;
            if one.left > 0 {
                one.left -= 1;
                continue;
            }
            let of = candidates.iter().zip(solved).filter(|(candidate, _)| candidate.gait.family == Some(one.family));
            let holds = of.filter_map(|(candidate, solved)| Some((candidate, solved.as_ref()?)));
            match holds.min_by(|(_, a), (_, b)| a.cost.total_cmp(&b.cost)) {
                Some((candidate, best)) => {
                    one.motion = Some((start, trajectory(&candidate.task, &best.curves, &best.x)));
                    (one.left, one.rest) = (0, 1);
                }
                None => {
                    one.left = one.rest + number as u32;
                    one.rest = (2 * one.rest).min(LONGEST_REST);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_family_without_a_solution_rests_longer_and_longer_until_it_is_woken() {
        let families = [GaitFamily::Trot, GaitFamily::Walk];
        let mut alternatives = Alternatives::new(families.into_iter());
        let due = |count: usize, alternatives: &mut Alternatives| -> [Vec<usize>; 2] {
            let mut due = [Vec::new(), Vec::new()];
            for update in 0..count {
                let now = families.map(|family| alternatives.is_due(family));
                due.iter_mut().zip(now).filter(|(_, now)| *now).for_each(|(due, _)| due.push(update));
                alternatives.learn(&[], &[], update as f64);
            }
            due
        };
        assert_eq!(due(30, &mut alternatives), [vec![0, 2, 5, 10, 19, 28], vec![0, 3, 7, 13, 23]]);
        alternatives.wake();
        assert_eq!(due(6, &mut alternatives), [vec![0, 2, 5], vec![0, 3]]);
        assert!(!alternatives.is_due(GaitFamily::Pace));
        assert_eq!(alternatives.guesses(0., 0.).count(), 0);
    }
}
