//! Counter-based random numbers: each dimension of each candidate can be drawn alone, in any order and on any thread.
//!
//! The seed gives the ChaCha8 key, (generation, candidate) the stream and the dimension the position in it.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Number of 32-bit words of the stream per dimension: two 64-bit numbers, even if only one is used.
const WORDS: u128 = 4;

/// Random numbers of one candidate.
///
/// Uniform numbers are identical on every platform. Normal ones may differ in the last bit if `ln` and `cos` do.
#[derive(Debug, Clone)]
pub struct Draws {
    rng: ChaCha8Rng,
}

impl Draws {
    /// Random numbers of a candidate. Generation and candidate index must be below 2^32, as [`super::CemSettings::validate`] ensures.
    pub fn new(seed: u64, generation: usize, candidate: usize) -> Draws {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream((generation as u64) << 32 | candidate as u64);
        Draws { rng }
    }

    /// Uniform number in [0, 1), a multiple of 2^-53.
    pub fn uniform(&mut self, dimension: usize) -> f64 {
        unit(self.words(dimension)[0])
    }

    /// Standard normal number by the Box-Muller transform: `sqrt(-2 ln u) cos(2 pi v)`, u in (0, 1], v in [0, 1).
    pub fn normal(&mut self, dimension: usize) -> f64 {
        let [a, b] = self.words(dimension);
        let (u, v) = (1. - unit(a), unit(b));
        (-2. * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }

    /// The two 64-bit numbers of a dimension.
    fn words(&mut self, dimension: usize) -> [u64; 2] {
        let position = dimension as u128 * WORDS;
        // Seeking refills the generator's buffer, which is unnecessary if dimensions are drawn in order.
        if self.rng.get_word_pos() != position {
            self.rng.set_word_pos(position);
        }
        [self.rng.next_u64(), self.rng.next_u64()]
    }
}

/// Number in [0, 1) from the upper 53 bits.
fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_and_thread_do_not_matter() {
        let mut draws = Draws::new(3, 1, 7);
        let forward: Vec<f64> = (0..100).map(|d| if d % 3 == 0 { draws.uniform(d) } else { draws.normal(d) }).collect();
        let backward = std::thread::spawn(|| {
            let mut draws = Draws::new(3, 1, 7);
            let mut values: Vec<f64> = (0..100).rev().map(|d| if d % 3 == 0 { draws.uniform(d) } else { draws.normal(d) }).collect();
            values.reverse();
            values
        });
        assert_eq!(forward, backward.join().unwrap());
        assert_eq!(forward[42], Draws::new(3, 1, 7).uniform(42));
    }

    #[test]
    fn seed_generation_candidate_and_dimension_all_change_the_number() {
        let base = Draws::new(1, 2, 3).uniform(4);
        for other in
            [Draws::new(2, 2, 3).uniform(4), Draws::new(1, 3, 3).uniform(4), Draws::new(1, 2, 4).uniform(4), Draws::new(1, 2, 3).uniform(5)]
        {
            assert_ne!(base, other);
        }
    }

    #[test]
    fn moments_match_those_of_the_distributions() {
        // 100,000 numbers. Each moment may deviate by 5 standard errors.
        let n = 100_000;
        let (mut uniform, mut normal) = ([0.; 2], [0.; 4]);
        for candidate in 0..n / 100 {
            let mut draws = Draws::new(11, 0, candidate);
            for d in 0..100 {
                let (u, z) = (draws.uniform(d), draws.normal(100 + d));
                assert!((0. ..1.).contains(&u) && z.is_finite());
                uniform.iter_mut().enumerate().for_each(|(k, m)| *m += u.powi(k as i32 + 1) / n as f64);
                normal.iter_mut().enumerate().for_each(|(k, m)| *m += z.powi(k as i32 + 1) / n as f64);
            }
        }
        let error = 5. / (n as f64).sqrt();
        // The variances of u and u^2 are 1/12 and 4/45, those of z, z^2, z^3, z^4 are 1, 2, 15, 96.
        for (got, want, variance) in [(uniform[0], 0.5, 1. / 12.), (uniform[1], 1. / 3., 4. / 45.)].into_iter().chain([
            (normal[0], 0., 1.),
            (normal[1], 1., 2.),
            (normal[2], 0., 15.),
            (normal[3], 3., 96f64),
        ]) {
            assert!((got - want).abs() < error * f64::sqrt(variance), "{got} is not {want}");
        }
    }

    #[test]
    fn the_numbers_of_seed_1_never_change() {
        // Expected values from an independent implementation of ChaCha8, of rand's expansion of a 64-bit seed (PCG32) and of the formulas
        // above.
        let mut draws = Draws::new(1, 0, 0);
        assert_eq!(
            [draws.uniform(0), draws.uniform(1), Draws::new(1, 5, 7).uniform(200)],
            [0.40248566366484806, 0.5965601809348549, 0.30913791814459757]
        );
        for (got, want) in [
            (draws.normal(0), 0.8881529718908301),
            (draws.normal(1), 0.25808989365040697),
            (Draws::new(1, 5, 7).normal(200), -0.6742362782119263),
        ] {
            assert!(f64::abs(got - want) < 1e-14, "{got:?} is not {want:?}");
        }
    }
}
