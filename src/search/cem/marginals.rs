//! Distributions of single dimensions that are fitted to elites: categoricals and Gaussians. Source: \[1\].

use serde::Serialize;

/// Discrete distribution over the categories 0, 1, ...
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Categorical {
    /// Probability of each category.
    pub probabilities: Vec<f64>,
}

impl Categorical {
    /// Uniform distribution.
    pub fn uniform(categories: usize) -> Categorical {
        Categorical { probabilities: vec![1. / categories as f64; categories] }
    }

    /// Category whose interval of the cumulative probabilities contains `u` in [0, 1).
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
        // Rounding can leave the sum below 1.
        last
    }

    /// Fits the probabilities: `p_k = (share of elites with k + floor) / (1 + floor * categories)`. Changes nothing without elites.
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

    /// Likeliest category; the lowest one in a tie.
    pub fn mode(&self) -> usize {
        (1..self.probabilities.len()).fold(0, |best, k| if self.probabilities[k] > self.probabilities[best] { k } else { best })
    }

    /// True if the largest probability is the largest that the floor allows, i.e. all elites agreed.
    pub fn settled(&self, floor: f64) -> bool {
        let largest = (1. + floor) / (1. + floor * self.probabilities.len() as f64);
        self.probabilities[self.mode()] > largest - 1e-9
    }

    /// Entropy `-sum p ln p`, nats.
    pub fn entropy(&self) -> f64 {
        -self.probabilities.iter().filter(|&&p| p > 0.).map(|p| p * p.ln()).sum::<f64>()
    }
}

/// Normal distribution of one dimension.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Gaussian {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub std: f64,
}

impl Gaussian {
    /// Sample `mean + std z`, clamped to `[low, high]`.
    pub fn sample(&self, z: f64, [low, high]: [f64; 2]) -> f64 {
        (self.mean + self.std * z).max(low).min(high)
    }

    /// Fits the Gaussian: `std = max(min_std, sqrt(mean over elites of (x - old mean)^2))`, then `mean` = mean of the elites. Changes
    /// nothing without elites.
    pub fn update(&mut self, elites: &[f64], min_std: f64) {
        if elites.is_empty() {
            return;
        }
        let n = elites.len() as f64;
        self.std = (elites.iter().map(|x| (x - self.mean).powi(2)).sum::<f64>() / n).sqrt().max(min_std);
        self.mean = elites.iter().sum::<f64>() / n;
    }
}

/// Fits a Gaussian to elites, where the old Gaussian counts as `memory` elites. Changes nothing without elites.
///
/// With `n` elites and `k` = `memory`: `std^2 = (sum (x - old mean)^2 + k old std^2) / (n + k)`, at least `min_std`, then
/// `mean = (sum x + k old mean) / (n + k)`. `k = 0` gives the update of \[1\].
pub fn fit(gaussian: &mut Gaussian, elites: &[f64], memory: f64, min_std: f64) {
    if elites.is_empty() {
        return;
    }
    let count = elites.len() as f64 + memory;
    let squares: f64 = elites.iter().map(|x| (x - gaussian.mean).powi(2)).sum();
    gaussian.std = ((squares + memory * gaussian.std * gaussian.std) / count).sqrt().max(min_std);
    gaussian.mean = (elites.iter().sum::<f64>() + memory * gaussian.mean) / count;
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
    fn the_std_is_measured_about_the_old_mean() {
        // Elites -1 and -2, old mean -1: sqrt((0 + 1) / 2). About the new mean it would be 0.5.
        let mut g = Gaussian { mean: -1., std: 3. };
        g.update(&[-1., -2.], 1e-3);
        assert_eq!((g.mean, g.std), (-1.5, 0.5f64.sqrt()));
        g.update(&[-1.5, -1.5], 1e-3);
        assert_eq!((g.mean, g.std), (-1.5, 1e-3));
    }

    #[test]
    fn samples_are_clamped_to_the_limits() {
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
    fn without_memory_the_fit_equals_that_of_the_paper() {
        let (mut ours, mut theirs) = (Gaussian { mean: -1., std: 3. }, Gaussian { mean: -1., std: 3. });
        fit(&mut ours, &[-1., -2.], 0., 1e-3);
        theirs.update(&[-1., -2.], 1e-3);
        assert_eq!(ours, theirs);
    }
}
