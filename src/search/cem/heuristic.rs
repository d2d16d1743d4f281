//! Mapping from categories to stance counts, with and without the triplet heuristic of \[1\].
//!
//! The heuristic keeps the stance counts of the feet close to each other: one categorical picks a triplet of neighbouring counts, and each
//! foot picks one of the three. `stances = min_stances + TRIPLETS[t] + pick`.

use super::CemSettings;

/// First stance count of each triplet, above `min_stances`.
pub const TRIPLETS: [usize; 3] = [2, 4, 6];
/// Number of stance counts in a triplet.
pub const PICKS: usize = 3;
/// Largest stance count with the heuristic, above `min_stances`.
pub const LARGEST: usize = TRIPLETS[TRIPLETS.len() - 1] + PICKS - 1;

/// Number of categories of each discrete dimension: one dimension per foot; with the heuristic, the triplet comes first.
pub fn categories(settings: &CemSettings, feet: usize) -> Vec<usize> {
    if settings.heuristic {
        let mut sizes = vec![PICKS; feet + 1];
        sizes[0] = TRIPLETS.len();
        sizes
    } else {
        vec![settings.max_stances - settings.min_stances + 1; feet]
    }
}

/// Stance count of each foot.
///
/// * `picks` - category of each discrete dimension, in the order of [`categories`]
pub fn stances(settings: &CemSettings, picks: &[usize]) -> Vec<usize> {
    match picks {
        [triplet, picks @ ..] if settings.heuristic => picks.iter().map(|pick| settings.min_stances + TRIPLETS[*triplet] + pick).collect(),
        picks => picks.iter().map(|pick| settings.min_stances + pick).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triplets_start_2_4_6_above_the_smallest_count() {
        let settings = CemSettings { min_stances: 5, max_stances: 13, heuristic: true, ..Default::default() };
        assert_eq!(categories(&settings, 4), [3, 3, 3, 3, 3]);
        assert_eq!(stances(&settings, &[0, 0, 1, 2, 0]), [7, 8, 9, 7]);
        assert_eq!(stances(&settings, &[1, 0, 1, 2, 0]), [9, 10, 11, 9]);
        assert_eq!(stances(&settings, &[2, 0, 1, 2, 0]), [11, 12, 13, 11]);
        assert_eq!(settings.largest_stances(), 13);
    }

    #[test]
    fn without_the_heuristic_every_count_is_a_category() {
        let settings = CemSettings { min_stances: 3, max_stances: 11, heuristic: false, ..Default::default() };
        assert_eq!(categories(&settings, 2), [9, 9]);
        assert_eq!(stances(&settings, &[0, 8]), [3, 11]);
    }
}
