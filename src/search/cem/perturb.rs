//! Distribution over the neighbourhood of a schedule: the phases stay, the times of lift-off and touchdown change.
//!
//! The times are perturbed instead of the durations. With perturbed durations a longer first phase would delay all later phases of its
//! foot, and feet that should swing together would drift apart.

use super::Distribution;
use super::marginals::{Gaussian, fit};
use super::random::Draws;
use crate::error::{Result, check_range};
use crate::gait::family::{GaitFamily, MIN_PHASE_SCALED, time_scale};
use crate::gait::{Phase, Schedule};
use crate::robot::Robot;
use serde::{Deserialize, Serialize};

/// Settings of the distribution over the neighbourhood of a schedule.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct PerturbSettings {
    /// Initial standard deviation of each switch time, as a fraction of the shorter adjacent phase. Too small: nothing new is tried; too
    /// large: feet that should move together lose their synchrony.
    pub std: f64,
    /// Initial standard deviation of the logarithm of the time scale that all times share. Too small: one pace only; too large: most draws
    /// fail.
    pub pace_std: f64,
    /// Smallest standard deviation. Too small: the search freezes; too large: it never converges.
    pub min_std: f64,
    /// Number of elites that the old Gaussian counts as. 0: the elites alone decide; too large: no learning.
    pub memory: f64,
    /// The distribution counts as converged if its largest standard deviation is below this. 0: never.
    pub converged_std: f64,
}

impl Default for PerturbSettings {
    fn default() -> Self {
        PerturbSettings { std: 0.05, pace_std: 0.05, min_std: 1e-3, memory: 0., converged_std: 5e-3 }
    }
}

impl PerturbSettings {
    /// Checks every field.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] names the first field that is outside its limits.
    pub fn validate(&self) -> Result<()> {
        check_range("search.perturb.std", self.std, 1e-9, 1.)?;
        check_range("search.perturb.pace_std", self.pace_std, 1e-9, 1.)?;
        check_range("search.perturb.min_std", self.min_std, 1e-9, 1.)?;
        check_range("search.perturb.memory", self.memory, 0., 1e6)?;
        check_range("search.perturb.converged_std", self.converged_std, 0., 10.)
    }
}

/// Distribution over schedules that have the phases of a given one.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PerturbDistribution {
    settings: PerturbSettings,
    /// Gait family of the given schedule, if it has one.
    #[serde(skip)]
    pub family: Option<GaitFamily>,
    /// Logarithm of the time scale: all times are multiplied by its exponential.
    pub pace: Gaussian,
    /// Shift of each switch time, as a fraction of the shorter adjacent phase, `[feet][phases - 1]`.
    pub switches: Vec<Vec<Gaussian>>,
    #[serde(skip)]
    around: Vec<Vec<Phase>>,
    /// Shortest phase, s. A shorter phase of the given schedule may stay as short as it is.
    shortest: f64,
}

/// One draw of [`PerturbDistribution`]: the logarithm of the time scale and the shifts of the switch times.
#[derive(Debug, Clone, PartialEq)]
pub struct PerturbSample {
    pace: f64,
    moves: Vec<Vec<f64>>,
}

impl PerturbDistribution {
    /// Distribution of the first generation, around a schedule of the robot.
    ///
    /// No phase becomes shorter than [`MIN_PHASE_SCALED`], unless the given one is shorter.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for bad settings.
    pub fn initial(robot: &Robot, around: &Schedule, settings: &PerturbSettings) -> Result<PerturbDistribution> {
        settings.validate()?;
        let around = around.stretched();
        let around: Vec<Vec<Phase>> = (0..around.feet()).map(|foot| around.phases(foot)).collect();
        let still = Gaussian { mean: 0., std: settings.std };
        Ok(PerturbDistribution {
            pace: Gaussian { mean: 0., std: settings.pace_std },
            switches: around.iter().map(|phases| vec![still; phases.len() - 1]).collect(),
            around,
            settings: settings.clone(),
            family: None,
            shortest: MIN_PHASE_SCALED * time_scale(robot),
        })
    }

    /// Phase durations of a foot after its switch times are shifted, s.
    fn durations(&self, phases: &[Phase], moves: &[f64], pace: f64) -> Vec<f64> {
        let mut start = 0.;
        let mut durations = Vec::with_capacity(phases.len());
        for (i, phase) in phases.iter().enumerate() {
            let room = phases.get(i + 1).map_or(0., |next| phase.duration().min(next.duration()));
            let end = (phase.end + moves.get(i).copied().unwrap_or(0.) * room) * pace;
            let duration = (end - start).max(self.shortest.min(phase.duration()));
            durations.push(duration);
            start += duration;
        }
        durations
    }
}

impl Distribution for PerturbDistribution {
    type Sample = PerturbSample;

    /// Random dimension 0 is the time scale; those of the switch times follow.
    fn sample(&self, mut draws: Draws) -> PerturbSample {
        let pace = self.pace.sample(draws.normal(0), [-1., 1.]);
        let mut dimension = 0;
        let mut draw = |gaussian: &Gaussian| {
            dimension += 1;
            gaussian.sample(draws.normal(dimension), [-0.5, 0.5])
        };
        PerturbSample { pace, moves: self.switches.iter().map(|foot| foot.iter().map(&mut draw).collect()).collect() }
    }

    /// Feet may end at different times; the last stances are stretched later.
    fn schedule(&self, sample: &PerturbSample) -> Result<Schedule> {
        let feet = self.around.iter().zip(&sample.moves);
        Schedule::new(feet.map(|(phases, moves)| self.durations(phases, moves, sample.pace.exp())).collect())
    }

    fn update(&mut self, elites: &[&PerturbSample]) {
        let PerturbSettings { memory, min_std, .. } = self.settings;
        fit(&mut self.pace, &elites.iter().map(|e| e.pace).collect::<Vec<_>>(), memory, min_std);
        for (foot, gaussians) in self.switches.iter_mut().enumerate() {
            for (switch, gaussian) in gaussians.iter_mut().enumerate() {
                fit(gaussian, &elites.iter().map(|e| e.moves[foot][switch]).collect::<Vec<_>>(), memory, min_std);
            }
        }
    }

    fn entropy(&self) -> f64 {
        0.
    }

    fn largest_std(&self) -> f64 {
        self.switches.iter().flatten().map(|g| g.std).fold(self.pace.std, f64::max)
    }

    fn converged(&self) -> bool {
        self.largest_std() < self.settings.converged_std
    }

    fn family(&self, _sample: &PerturbSample) -> Option<GaitFamily> {
        self.family
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trot() -> (Robot, Schedule) {
        let feet = [vec![0.3, 0.25, 0.3, 0.25, 0.6], vec![0.55, 0.25, 0.3, 0.25, 0.35]];
        (Robot::named("biped").unwrap(), Schedule::new(feet.to_vec()).unwrap())
    }

    #[test]
    fn perturbed_schedules_keep_their_phases_and_stay_near() {
        let (robot, around) = trot();
        let distribution = PerturbDistribution::initial(&robot, &around, &PerturbSettings::default()).unwrap();
        let shortest = MIN_PHASE_SCALED * time_scale(&robot);
        for candidate in 0..50 {
            let schedule = distribution.schedule(&distribution.sample(Draws::new(1, 0, candidate))).unwrap();
            for foot in 0..2 {
                assert_eq!(schedule.stances(foot), around.stances(foot));
                for (moved, was) in schedule.phases(foot).iter().zip(around.phases(foot)) {
                    assert!(moved.duration() >= shortest - 1e-12);
                    // Shifts do not accumulate: each switch stays near its own time.
                    assert!((moved.end / was.end).ln().abs() < 0.35, "{moved:?} for {was:?}");
                }
            }
        }
    }

    #[test]
    fn without_shifts_the_schedule_is_unchanged() {
        let (robot, around) = trot();
        let distribution = PerturbDistribution::initial(&robot, &around, &PerturbSettings::default()).unwrap();
        let same = distribution.schedule(&PerturbSample { pace: 0., moves: vec![vec![0.; 4]; 2] }).unwrap();
        for (a, b) in same.durations().iter().flatten().zip(around.durations().iter().flatten()) {
            assert!((a - b).abs() < 1e-12);
        }
    }

    #[test]
    fn a_switch_is_shifted_by_a_fraction_of_the_shorter_adjacent_phase() {
        let (robot, around) = trot();
        let distribution = PerturbDistribution::initial(&robot, &around, &PerturbSettings::default()).unwrap();
        let mut moves = vec![vec![0.; 4]; 2];
        // First touchdown of foot 0, between phases of 0.25 and 0.3 s.
        moves[0][1] = 0.2;
        let moved = distribution.schedule(&PerturbSample { pace: 0., moves }).unwrap();
        for (got, want) in moved.durations()[0].iter().zip([0.3, 0.3, 0.25, 0.25, 0.6]) {
            assert!((got - want).abs() < 1e-12, "{got}");
        }
    }

    #[test]
    fn elites_move_and_narrow_the_distribution() {
        let (robot, around) = trot();
        let mut distribution = PerturbDistribution::initial(&robot, &around, &PerturbSettings::default()).unwrap();
        let elite = PerturbSample { pace: -0.1, moves: vec![vec![0.1; 4]; 2] };
        distribution.update(&[]);
        assert_eq!(distribution.pace.mean, 0.);
        distribution.update(&[&elite]);
        distribution.update(&[&elite]);
        assert_eq!((distribution.pace.mean, distribution.switches[1][3].mean), (-0.1, 0.1));
        assert!(distribution.converged());
    }
}
