//! The neighbourhood of a schedule: the same phases, with other times at which feet leave and touch the ground.
//!
//! Times are moved, not durations: a foot whose first phase gets longer would otherwise be late in all that follow, and feet that should swing
//! together would drift apart.

use super::Distribution;
use super::marginals::{Gaussian, fit};
use super::random::Draws;
use crate::error::{Result, check_range};
use crate::gait::family::{MIN_PHASE, time_scale};
use crate::gait::{Phase, Schedule};
use crate::robot::Robot;
use serde::{Deserialize, Serialize};

/// How the neighbourhood of a schedule is drawn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct PerturbSettings {
    /// First standard deviation of every switch, in the shorter of the phases beside it. Too small: nothing new; too large: feet that belong
    /// together lose each other.
    pub std: f64,
    /// First standard deviation of the logarithm of the pace of all.
    pub pace_std: f64,
    /// Smallest standard deviation. Too small: the search freezes.
    pub min_std: f64,
    /// Elites that the old Gaussian counts as.
    pub memory: f64,
    /// Largest standard deviation at which the distribution counts as converged; 0: never.
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
    /// [`crate::Error::Invalid`] names the first field that is out of its limits.
    pub fn validate(&self) -> Result<()> {
        check_range("search.perturb.std", self.std, 1e-9, 1.)?;
        check_range("search.perturb.pace_std", self.pace_std, 1e-9, 1.)?;
        check_range("search.perturb.min_std", self.min_std, 1e-9, 1.)?;
        check_range("search.perturb.memory", self.memory, 0., 1e6)?;
        check_range("search.perturb.converged_std", self.converged_std, 0., 10.)
    }
}

/// Distribution over schedules with the phases of a given one.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PerturbDistribution {
    settings: PerturbSettings,
    /// Logarithm of the pace: all times are multiplied by its exponential.
    pub pace: Gaussian,
    /// By how much each switch is moved, in the shorter of the phases beside it, `[feet][phases - 1]`.
    pub switches: Vec<Vec<Gaussian>>,
    #[serde(skip)]
    around: Vec<Vec<Phase>>,
    /// Shortest phase, s, where the given one is not shorter.
    shortest: f64,
}

/// One draw of [`PerturbDistribution`]: the logarithm of the pace, then the moves.
#[derive(Debug, Clone, PartialEq)]
pub struct PerturbSample {
    pace: f64,
    moves: Vec<Vec<f64>>,
}

impl PerturbDistribution {
    /// The distribution of the first generation: around a schedule of the robot.
    ///
    /// Phases are not made shorter than [`MIN_PHASE`], but where the given one is.
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
            shortest: MIN_PHASE * time_scale(robot),
        })
    }

    /// Durations of a foot whose switches are moved.
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

    /// Dimension 0 is the pace.
    fn sample(&self, mut draws: Draws) -> PerturbSample {
        let pace = self.pace.sample(draws.normal(0), [-1., 1.]);
        let mut dimension = 0;
        let mut draw = |gaussian: &Gaussian| {
            dimension += 1;
            gaussian.sample(draws.normal(dimension), [-0.5, 0.5])
        };
        PerturbSample { pace, moves: self.switches.iter().map(|foot| foot.iter().map(&mut draw).collect()).collect() }
    }

    /// Feet may end at different times: the last stances are stretched later.
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
        let shortest = MIN_PHASE * time_scale(&robot);
        for candidate in 0..50 {
            let schedule = distribution.schedule(&distribution.sample(Draws::new(1, 0, candidate))).unwrap();
            for foot in 0..2 {
                assert_eq!(schedule.stances(foot), around.stances(foot));
                for (moved, was) in schedule.phases(foot).iter().zip(around.phases(foot)) {
                    assert!(moved.duration() >= shortest - 1e-12);
                    // Neighbours do not add up: each switch is near its own time.
                    assert!((moved.end / was.end).ln().abs() < 0.35, "{moved:?} for {was:?}");
                }
            }
        }
    }

    #[test]
    fn without_moves_it_is_the_schedule_itself() {
        let (robot, around) = trot();
        let distribution = PerturbDistribution::initial(&robot, &around, &PerturbSettings::default()).unwrap();
        let same = distribution.schedule(&PerturbSample { pace: 0., moves: vec![vec![0.; 4]; 2] }).unwrap();
        for (a, b) in same.durations().iter().flatten().zip(around.durations().iter().flatten()) {
            assert!((a - b).abs() < 1e-12);
        }
    }

    #[test]
    fn a_switch_is_moved_by_part_of_the_shorter_phase() {
        let (robot, around) = trot();
        let distribution = PerturbDistribution::initial(&robot, &around, &PerturbSettings::default()).unwrap();
        let mut moves = vec![vec![0.; 4]; 2];
        // Foot 0, the first touch-down: phases of 0.25 and 0.3 s beside it.
        moves[0][1] = 0.2;
        let moved = distribution.schedule(&PerturbSample { pace: 0., moves }).unwrap();
        for (got, want) in moved.durations()[0].iter().zip([0.3, 0.3, 0.25, 0.25, 0.6]) {
            assert!((got - want).abs() < 1e-12, "{got}");
        }
    }

    #[test]
    fn elites_move_and_narrow_it() {
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
