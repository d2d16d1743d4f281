//! The distribution that candidates are drawn from: independent categoricals and Gaussians, fitted to the elites. Source: \[1\].

use super::random::Draws;
use super::{CemSettings, heuristic};
use crate::error::Result;
use crate::gait::Schedule;
use serde::Serialize;

/// A distribution over the categories 0, 1, ...
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Categorical {
    /// Probability of each category.
    pub probabilities: Vec<f64>,
}

impl Categorical {
    /// All categories alike.
    pub fn uniform(categories: usize) -> Categorical {
        Categorical { probabilities: vec![1. / categories as f64; categories] }
    }

    /// The category at `u` in [0, 1) of the cumulative probabilities.
    pub fn pick(&self, u: f64) -> usize {
        let (mut sum, mut last) = (0., 0);
        for (category, &p) in self.probabilities.iter().enumerate() {
            sum += p;
            if p > 0. {
                last = category;
            }
            if u < sum {
                return category;
            }
        }
        // The sum may be rounded to less than 1.
        last
    }

    /// `p_k = (share of elites with k + floor) / (1 + floor * categories)`. Without elites nothing changes.
    pub fn update(&mut self, elites: &[usize], floor: f64) {
        if elites.is_empty() {
            return;
        }
        let norm = 1. + floor * self.probabilities.len() as f64;
        for (category, p) in self.probabilities.iter_mut().enumerate() {
            let share = elites.iter().filter(|&&e| e == category).count() as f64 / elites.len() as f64;
            *p = (share + floor) / norm;
        }
    }

    /// The likeliest category, the lowest of equals.
    pub fn mode(&self) -> usize {
        (1..self.probabilities.len()).fold(0, |best, k| if self.probabilities[k] > self.probabilities[best] { k } else { best })
    }

    /// Whether its largest probability is the largest that the floor allows: all elites agreed.
    pub fn settled(&self, floor: f64) -> bool {
        let largest = (1. + floor) / (1. + floor * self.probabilities.len() as f64);
        self.probabilities[self.mode()] > largest - 1e-9
    }

    /// `-sum p ln p`, nats.
    pub fn entropy(&self) -> f64 {
        -self.probabilities.iter().filter(|&&p| p > 0.).map(|p| p * p.ln()).sum::<f64>()
    }
}

/// A normal distribution of one log duration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Gaussian {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub std: f64,
}

impl Gaussian {
    /// `mean + std z`, moved into `[low, high]`.
    pub fn sample(&self, z: f64, [low, high]: [f64; 2]) -> f64 {
        (self.mean + self.std * z).max(low).min(high)
    }

    /// `std = max(min_std, sqrt(mean over elites of (x - old mean)^2))`, then `mean` = mean of the elites. Without elites nothing changes.
    pub fn update(&mut self, elites: &[f64], min_std: f64) {
        if elites.is_empty() {
            return;
        }
        let n = elites.len() as f64;
        self.std = (elites.iter().map(|x| (x - self.mean).powi(2)).sum::<f64>() / n).sqrt().max(min_std);
        self.mean = elites.iter().sum::<f64>() / n;
    }
}

/// One draw: a category for each discrete dimension and every log duration, used or not.
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
    /// The schedule it describes: each foot uses the first `2 stances - 1` of its durations.
    ///
    /// # Errors
    /// Those of [`Schedule::new`]; none with settings that are valid.
    pub fn schedule(&self, settings: &CemSettings) -> Result<Schedule> {
        let stances = heuristic::stances(settings, &self.picks);
        let feet = stances.len();
        let duration = |phase, foot| self.log_durations[ix_duration(feet, phase, foot)].exp();
        Schedule::new((0..feet).map(|foot| (0..2 * stances[foot] - 1).map(|phase| duration(phase, foot)).collect()).collect())
    }
}

/// The distribution of all dimensions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Distribution {
    /// Discrete dimensions, in the order of [`heuristic::categories`].
    pub categoricals: Vec<Categorical>,
    /// Log durations, `[phases][feet]` for the largest stance count: see [`ix_duration`].
    pub gaussians: Vec<Gaussian>,
}

impl Distribution {
    /// The distribution of the first generation.
    pub fn initial(settings: &CemSettings, feet: usize) -> Distribution {
        let gaussian = Gaussian { mean: settings.initial_mean, std: settings.initial_std };
        Distribution {
            categoricals: heuristic::categories(settings, feet).into_iter().map(Categorical::uniform).collect(),
            gaussians: vec![gaussian; feet * settings.phases()],
        }
    }

    /// Draws a candidate: dimension `d` of the random numbers belongs to categorical `d`, then come the Gaussians.
    pub fn sample(&self, settings: &CemSettings, mut draws: Draws) -> Sample {
        let picks: Vec<usize> = self.categoricals.iter().enumerate().map(|(d, c)| c.pick(draws.uniform(d))).collect();
        let gaussians = self.gaussians.iter().enumerate();
        let log_durations = gaussians.map(|(d, g)| g.sample(draws.normal(picks.len() + d), settings.log_duration)).collect();
        Sample { picks, log_durations }
    }

    /// Fits every dimension to the elites, also those that no elite uses. Without elites nothing changes.
    pub fn update(&mut self, settings: &CemSettings, elites: &[&Sample]) {
        for (d, categorical) in self.categoricals.iter_mut().enumerate() {
            categorical.update(&elites.iter().map(|e| e.picks[d]).collect::<Vec<_>>(), settings.floor);
        }
        for (d, gaussian) in self.gaussians.iter_mut().enumerate() {
            gaussian.update(&elites.iter().map(|e| e.log_durations[d]).collect::<Vec<_>>(), settings.min_std);
        }
    }

    /// Mean entropy of the categoricals, nats.
    pub fn entropy(&self) -> f64 {
        self.categoricals.iter().map(Categorical::entropy).sum::<f64>() / self.categoricals.len() as f64
    }

    /// Largest standard deviation among the log durations that the likeliest stance counts use.
    pub fn largest_std(&self, settings: &CemSettings) -> f64 {
        let modes: Vec<usize> = self.categoricals.iter().map(Categorical::mode).collect();
        let stances = heuristic::stances(settings, &modes);
        let feet = stances.len();
        let used = (0..feet).flat_map(|foot| (0..2 * stances[foot] - 1).map(move |phase| ix_duration(feet, phase, foot)));
        used.map(|i| self.gaussians[i].std).fold(0., f64::max)
    }

    /// Whether the search has settled: all elites agreed on every category, and [`Distribution::largest_std`] is below
    /// [`CemSettings::converged_std`].
    ///
    /// The floor still lets other stance counts be drawn after that, so a better one may be missed. The paper \[1\] always runs all
    /// generations: a `converged_std` of 0 does the same.
    pub fn converged(&self, settings: &CemSettings) -> bool {
        self.categoricals.iter().all(|c| c.settled(settings.floor)) && self.largest_std(settings) < settings.converged_std
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probabilities_are_elite_shares_plus_the_floor_renormalised() {
        // Shares 3/4, 1/4, 0; plus 0.05; divided by 1.15.
        let mut c = Categorical::uniform(3);
        c.update(&[0, 0, 1, 0], 0.05);
        for (p, want) in c.probabilities.iter().zip([0.8 / 1.15, 0.3 / 1.15, 0.05 / 1.15]) {
            assert!((p - want).abs() < 1e-15);
        }
        assert!(!c.settled(0.05));
        c.update(&[2, 2], 0.05);
        assert!(c.settled(0.05) && c.mode() == 2);
        assert!((c.probabilities[2] - 1.05 / 1.15).abs() < 1e-15);
        c.update(&[1], 0.);
        assert_eq!((c.probabilities.as_slice(), c.entropy()), (&[0., 1., 0.][..], 0.));
    }

    #[test]
    fn the_std_is_about_the_old_mean() {
        // Elites -1 and -2, old mean -1: sqrt((0 + 1) / 2); about the new mean it would be 0.5.
        let mut g = Gaussian { mean: -1., std: 3. };
        g.update(&[-1., -2.], 1e-3);
        assert_eq!((g.mean, g.std), (-1.5, 0.5f64.sqrt()));
        g.update(&[-1.5, -1.5], 1e-3);
        assert_eq!((g.mean, g.std), (-1.5, 1e-3));
    }

    #[test]
    fn no_elites_change_nothing() {
        let settings = CemSettings::default();
        let mut d = Distribution::initial(&settings, 2);
        d.update(&settings, &[]);
        assert_eq!(d, Distribution::initial(&settings, 2));
    }

    #[test]
    fn samples_are_moved_into_the_limits() {
        let g = Gaussian { mean: -1.75, std: 1. };
        assert_eq!([-3., 0.25, 3.].map(|z| g.sample(z, [-2.5, -1.])), [-2.5, -1.5, -1.]);
    }

    #[test]
    fn categories_are_picked_by_cumulative_probability() {
        let c = Categorical { probabilities: vec![0.25, 0., 0.75, 0.] };
        assert_eq!([0., 0.2499, 0.25, 0.99].map(|u| c.pick(u)), [0, 0, 2, 2]);
        let short = Categorical { probabilities: vec![0.3, 0.6, 0.] };
        assert_eq!(short.pick(0.95), 1);
    }

    #[test]
    fn a_sample_uses_the_durations_of_its_own_phases() {
        // Two feet with 1 and 2 stances; duration of (phase, foot) at phase * 2 + foot.
        let settings = CemSettings { min_stances: 1, max_stances: 2, heuristic: false, ..Default::default() };
        let sample = Sample { picks: vec![0, 1], log_durations: vec![-1., -2., -1.1, -2.1, -1.2, -2.2] };
        let want = [vec![(-1f64).exp()], vec![(-2f64).exp(), (-2.1f64).exp(), (-2.2f64).exp()]];
        assert_eq!(sample.schedule(&settings).unwrap().durations(), want);
        // Only the first foot's first duration and the second foot's three count.
        let mut d = Distribution::initial(&settings, 2);
        d.update(&settings, &[&sample]);
        d.gaussians.iter_mut().for_each(|g| g.std = 1e-3);
        d.gaussians[ix_duration(2, 1, 0)].std = 1.;
        assert_eq!(d.largest_std(&settings), 1e-3);
        assert!(d.converged(&settings));
        d.gaussians[ix_duration(2, 2, 1)].std = 0.1;
        assert!(!d.converged(&settings));
    }

    #[test]
    fn a_candidate_drawn_alone_is_the_one_drawn_among_all() {
        let settings = CemSettings::default();
        let d = Distribution::initial(&settings, 4);
        let all: Vec<Sample> = (0..16).map(|i| d.sample(&settings, Draws::new(1, 2, i))).collect();
        let alone = std::thread::spawn(move || d.sample(&settings, Draws::new(1, 2, 7))).join().unwrap();
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
