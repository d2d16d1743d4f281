//! The distribution of \[1\] over the stance count of each foot and the duration of each phase.

use super::marginals::{Categorical, Gaussian};
use super::random::Draws;
use super::{CemSettings, Distribution, heuristic};
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::robot::MAX_FEET;
use serde::Serialize;

/// One draw: a category per discrete dimension and all log durations, including unused ones.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Categories, in the order of [`heuristic::categories`].
    pub picks: Vec<usize>,
    /// Log durations (durations in s), `[phases][feet]`: see [`ix_duration`].
    pub log_durations: Vec<f64>,
}

/// Index of a log duration; the foot is contiguous, as in \[4\].
pub fn ix_duration(feet: usize, phase: usize, foot: usize) -> usize {
    phase * feet + foot
}

impl Sample {
    /// Schedule that the sample describes: each foot uses the first `2 stances - 1` of its durations.
    ///
    /// # Errors
    /// Errors of [`Schedule::new`]. Valid settings cause none.
    fn schedule(&self, settings: &CemSettings) -> Result<Schedule> {
        let stances = heuristic::stances(settings, &self.picks);
        let feet = stances.len();
        let duration = |phase, foot| self.log_durations[ix_duration(feet, phase, foot)].exp();
        Schedule::new((0..feet).map(|foot| (0..2 * stances[foot] - 1).map(|phase| duration(phase, foot)).collect()).collect())
    }
}

/// Distribution of \[1\]: categoricals over the stance counts and Gaussians over the logarithms of all phase durations.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FreeDistribution {
    #[serde(skip)]
    settings: CemSettings,
    /// Discrete dimensions, in the order of [`heuristic::categories`].
    pub categoricals: Vec<Categorical>,
    /// Log durations, `[phases][feet]` for the largest stance count: see [`ix_duration`].
    pub gaussians: Vec<Gaussian>,
}

impl FreeDistribution {
    /// Distribution of the first generation.
    ///
    /// * `feet` - number of feet of the robot, at most [`MAX_FEET`]
    ///
    /// # Errors
    /// [`Error::Invalid`] names the setting that is outside its limits.
    pub fn initial(settings: &CemSettings, feet: usize) -> Result<FreeDistribution> {
        settings.validate()?;
        if feet == 0 || feet > MAX_FEET {
            return Err(Error::invalid("feet", feet, format!("1 to {MAX_FEET}")));
        }
        let gaussian = Gaussian { mean: settings.initial_mean, std: settings.initial_std };
        Ok(FreeDistribution {
            settings: settings.clone(),
            categoricals: heuristic::categories(settings, feet).into_iter().map(Categorical::uniform).collect(),
            gaussians: vec![gaussian; feet * settings.phases()],
        })
    }
}

impl Distribution for FreeDistribution {
    type Sample = Sample;

    /// Random dimension `d` belongs to categorical `d`; the dimensions of the Gaussians follow.
    fn sample(&self, mut draws: Draws) -> Sample {
        let picks: Vec<usize> = self.categoricals.iter().enumerate().map(|(d, c)| c.pick(draws.uniform(d))).collect();
        let gaussians = self.gaussians.iter().enumerate();
        let log_durations = gaussians.map(|(d, g)| g.sample(draws.normal(picks.len() + d), self.settings.log_duration)).collect();
        Sample { picks, log_durations }
    }

    fn schedule(&self, sample: &Sample) -> Result<Schedule> {
        sample.schedule(&self.settings)
    }

    /// Fits every dimension, including those that no elite uses.
    fn update(&mut self, elites: &[&Sample]) {
        for (d, categorical) in self.categoricals.iter_mut().enumerate() {
            categorical.update(&elites.iter().map(|e| e.picks[d]).collect::<Vec<_>>(), self.settings.floor);
        }
        for (d, gaussian) in self.gaussians.iter_mut().enumerate() {
            gaussian.update(&elites.iter().map(|e| e.log_durations[d]).collect::<Vec<_>>(), self.settings.min_std);
        }
    }

    fn entropy(&self) -> f64 {
        self.categoricals.iter().map(Categorical::entropy).sum::<f64>() / self.categoricals.len() as f64
    }

    /// Largest standard deviation of the log durations that the likeliest stance counts use.
    fn largest_std(&self) -> f64 {
        let modes: Vec<usize> = self.categoricals.iter().map(Categorical::mode).collect();
        let stances = heuristic::stances(&self.settings, &modes);
        let feet = stances.len();
        let used = (0..feet).flat_map(|foot| (0..2 * stances[foot] - 1).map(move |phase| ix_duration(feet, phase, foot)));
        used.map(|i| self.gaussians[i].std).fold(0., f64::max)
    }

    /// True if all elites agreed on every category and [`Distribution::largest_std`] is below [`CemSettings::converged_std`].
    ///
    /// The probability floor would still let other stance counts be drawn, so a better one may be missed. The paper \[1\] always runs all
    /// generations; a `converged_std` of 0 does the same.
    fn converged(&self) -> bool {
        self.categoricals.iter().all(|c| c.settled(self.settings.floor)) && self.largest_std() < self.settings.converged_std
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_elites_change_nothing() {
        let settings = CemSettings::default();
        let mut d = FreeDistribution::initial(&settings, 2).unwrap();
        d.update(&[]);
        assert_eq!(d, FreeDistribution::initial(&settings, 2).unwrap());
    }

    #[test]
    fn a_sample_uses_the_durations_of_its_own_phases() {
        // Two feet with 1 and 2 stances. The duration of (phase, foot) is at phase * 2 + foot.
        let settings = CemSettings { min_stances: 1, max_stances: 2, heuristic: false, ..Default::default() };
        let sample = Sample { picks: vec![0, 1], log_durations: vec![-1., -2., -1.1, -2.1, -1.2, -2.2] };
        let want = [vec![(-1f64).exp()], vec![(-2f64).exp(), (-2.1f64).exp(), (-2.2f64).exp()]];
        assert_eq!(sample.schedule(&settings).unwrap().durations(), want);
        // Only the first foot's first duration and the second foot's three count.
        let mut d = FreeDistribution::initial(&settings, 2).unwrap();
        d.update(&[&sample]);
        d.gaussians.iter_mut().for_each(|g| g.std = 1e-3);
        d.gaussians[ix_duration(2, 1, 0)].std = 1.;
        assert_eq!(d.largest_std(), 1e-3);
        assert!(d.converged());
        d.gaussians[ix_duration(2, 2, 1)].std = 0.1;
        assert!(!d.converged());
    }

    #[test]
    fn a_candidate_drawn_alone_is_the_one_drawn_among_all() {
        let settings = CemSettings::default();
        let d = FreeDistribution::initial(&settings, 4).unwrap();
        let all: Vec<Sample> = (0..16).map(|i| d.sample(Draws::new(1, 2, i))).collect();
        let alone = std::thread::spawn(move || d.sample(Draws::new(1, 2, 7))).join().unwrap();
        assert_eq!(all[7], alone);
        assert_ne!(all[6], alone);
    }

    #[test]
    fn even_the_longest_and_shortest_samples_are_schedules() {
        let settings = CemSettings { log_duration: [1e-3f64.ln() + 1e-9, (120f64 / 25.).ln() - 1e-9], ..Default::default() };
        settings.validate().unwrap();
        for value in settings.log_duration {
            let sample = Sample { picks: vec![2; 7], log_durations: vec![value; 6 * settings.phases()] };
            assert_eq!(sample.schedule(&settings).unwrap().stances(5), 13);
        }
    }
}
