//! Candidates of an update.

use super::{Cycle, Planner};
use crate::error::Result;
use crate::gait::family::{GaitFamily, time_scale};
use crate::gait::{AlignedSchedule, Schedule};
use crate::nlp::transcription::{interval, legs};
use crate::robot::Robot;
use crate::search::cem::random::Draws;
use crate::task::Task;
use std::sync::Arc;

/// Range of the durations of swings and stances, relative to the typical ones of the family.
const SWINGS: [f64; 2] = [0.75, 1.4];
const STANCES: [f64; 2] = [0.6, 1.8];
/// Number of phases at which a family can be entered.
const ENTRIES: usize = 24;

/// Candidate of an update.
pub(super) struct Candidate {
    pub gait: Cycle,
    pub task: Task,
    pub schedule: AlignedSchedule,
}

impl Planner {
    /// Gaits that every update solves: the gait in force, and standing.
    ///
    /// * `start` - of the plan, s
    pub(super) fn steady(&self, start: f64) -> Vec<Cycle> {
        let current = self.plan.as_ref().map(|plan| plan.gait.after(start - plan.start));
        let swing = current.map_or(time_scale(&self.task.robot), |gait| gait.swing);
        let standing = Cycle { family: None, swing, stance: swing, phase: 0. };
        let stands = current.is_some_and(|gait| gait.family.is_none());
        current.into_iter().chain((!stands).then_some(standing)).take(self.settings.candidates).collect()
    }

    /// Gaits beside the steady ones: the families that are due, then changes of those that held at the last update.
    pub(super) fn others(&self, steady: &[Cycle]) -> Vec<Cycle> {
        let mut gaits = steady.to_vec();
        let due = self.families.iter().filter(|(family, _)| self.alternatives.is_due(*family));
        gaits.extend(due.filter_map(|(family, offsets)| {
            let at = |i: usize| Cycle { phase: i as f64 / ENTRIES as f64, ..self.typical(*family) };
            let mismatch = |cycle: &Cycle| cycle.mismatch(offsets, &self.contacts);
            (0..ENTRIES).map(at).min_by(|a, b| mismatch(a).total_cmp(&mismatch(b)))
        }));
        // A gait that has just been found cheap is worth changing; at first any one is.
        let near = |family| self.plan.is_none() || self.in_force() == Some(Some(family)) || self.alternatives.holds(family);
        let originals: Vec<usize> = (0..gaits.len()).filter(|&i| gaits[i].family.is_some_and(near)).collect();
        let first = gaits.len();
        while self.settings.change_durations && !originals.is_empty() && gaits.len() < self.settings.candidates {
            // Half of the changes are of the gait in force, if it moves.
            let number = gaits.len() - first;
            let of = originals[if number.is_multiple_of(2) { 0 } else { number / 2 % originals.len() }];
            let gait = gaits[of];
            let mut draws = Draws::new(self.settings.seed, (self.updates % (1 << 32)) as usize, gaits.len());
            let mut change = |dimension: usize, part: f64| part * self.settings.spread * draws.normal(dimension);
            let typical = gait.family.map_or(gait, |family| self.typical(family));
            let within = |value: f64, typical: f64, [low, high]: [f64; 2]| value.clamp(low * typical, high * typical);
            gaits.push(Cycle {
                swing: within(gait.swing * change(0, 1.).exp(), typical.swing, SWINGS),
                stance: within(gait.stance * change(1, 1.5).exp(), typical.stance, STANCES),
                phase: (gait.phase + change(2, 0.5)).rem_euclid(1.),
                ..gait
            });
        }
        gaits.truncate(self.settings.candidates);
        gaits.split_off(steady.len())
    }

    /// Gaits as candidates.
    pub(super) fn candidates(&self, gaits: &[Cycle]) -> Result<Vec<Candidate>> {
        let (horizon, interval) = (self.horizon(), interval(&self.transcription, &self.task.robot));
        let robot = self.later();
        let candidate = |&gait: &Cycle| {
            let schedule = gait.schedule(self.offsets(&gait), &self.contacts, horizon)?;
            Ok(Candidate { gait, task: self.startable(&robot, &schedule), schedule: schedule.aligned(interval) })
        };
        gaits.iter().map(candidate).collect()
    }

    /// The task of a robot with feet in the air that are no faster than their limit, and that descend no faster than a cubic to the ground
    /// can, in the time that a schedule gives them.
    fn startable(&self, robot: &Arc<Robot>, schedule: &Schedule) -> Task {
        let mut task = Task { robot: robot.clone(), ..self.task.clone() };
        let fastest = legs::foot_speed(&self.transcription, &self.robot);
        for (state, durations) in task.start_swings.iter_mut().zip(schedule.durations()) {
            let Some(state) = state else { continue };
            let [x, y, z] = state.position;
            let ground = self.task.terrain.height(x, y);
            let time = state.rise(durations[1]).unwrap_or(durations[1]);
            let height = (z - ground).max(0.);
            state.position[2] = ground + height;
            let [vx, vy, vz] = state.velocity;
            let slower = (fastest / vx.hypot(vy)).min(1.);
            state.velocity = [slower * vx, slower * vy, descent(height, vz, time)];
        }
        task
    }

    /// A family with its typical durations.
    fn typical(&self, family: GaitFamily) -> Cycle {
        let (typical, time) = (family.typical(self.task.robot.feet()), time_scale(&self.task.robot));
        let swing = typical.swing * time;
        Cycle { family: Some(family), swing, stance: swing * typical.duty / (1. - typical.duty), phase: 0. }
    }

    fn offsets(&self, gait: &Cycle) -> &[f64] {
        let of = |family: GaitFamily| self.families.iter().find(|(name, _)| *name == family);
        gait.family.and_then(of).or(self.families.first()).map_or(&[], |(_, offsets)| offsets)
    }
}

/// The velocity in z of a foot at a height, m/s, limited so that a cubic to rest on the ground after `time` s stays above the ground.
pub(super) fn descent(height: f64, velocity: f64, time: f64) -> f64 {
    velocity.max(-3. * height / time)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planner::{Command, PlannerSettings, RobotState};
    use crate::terrain::Terrain;

    #[test]
    fn families_that_lost_rest_until_the_command_changes() {
        let mut planner = Planner::new(Robot::named("anymal").unwrap(), Terrain::flat(), PlannerSettings::default()).unwrap();
        let (state, families) = (RobotState::standing(&planner.task), planner.families.len());
        let stand = Command::default();
        let mut candidates = |command: &Command, now: f64| planner.update(&state, command, now).unwrap().candidates;
        assert_eq!(candidates(&stand, 0.), PlannerSettings::default().candidates);
        // Standing costs much less than any gait.
        assert_eq!(candidates(&stand, 0.02), 1);
        assert_eq!(candidates(&Command { velocity: [0.5, 0.], ..stand }, 0.04), 1 + families);
    }
}
