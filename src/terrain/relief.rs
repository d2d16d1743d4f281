//! Terrains with a share of the relief: easier ground, from which a search raises a gait to the real one.

use super::{Grid, Profile, Shape, Terrain};

/// Distance between the samples of a profile along x, m. The edges of all profiles lie on samples.
const SAMPLE: f64 = 0.01;
/// Largest number of samples of a grid along one axis.
const MOST_SAMPLES: usize = 4096;

impl Terrain {
    /// Copy of the terrain whose heights differ from `level` by a share of what they do.
    ///
    /// A profile becomes a grid of samples 1 cm apart, so that its risers become ramps of that width. Beyond the area the heights at its
    /// edge continue.
    ///
    /// * `share` - 0 for level ground, 1 for the heights of this terrain
    /// * `level` - height that stays, m
    /// * `area` - lower and upper corner (x, y) of the ground that is needed, m
    pub fn with_relief(&self, share: f64, level: f64, area: [[f64; 2]; 2]) -> Terrain {
        let grid = match &self.shape {
            Shape::Flat => return self.clone(),
            Shape::Profile(profile) => sampled(*profile, area),
            Shape::Grid(grid) => grid.clone(),
        };
        let scaled = |height: &f64| level + share * (height - level);
        let heights = grid.heights.iter().map(|row| row.iter().map(scaled).collect()).collect();
        Terrain { shape: Shape::Grid(Grid { heights, ..grid }), ..self.clone() }
    }
}

/// Samples of a profile over an area. Two columns suffice, because all profiles are linear along y.
fn sampled(profile: Profile, [low, high]: [[f64; 2]; 2]) -> Grid {
    let first = (low[0] / SAMPLE).floor();
    let rows = ((high[0] / SAMPLE - first).ceil() as usize + 1).clamp(2, MOST_SAMPLES);
    // A sample at an edge belongs to the patch behind it: rounding does not decide.
    let row = |i: usize| [low[1], high[1]].map(|y| profile.ground((first + i as f64) * SAMPLE + 1e-9, y).height).to_vec();
    // A grid of n samples covers n times their distance.
    let beyond = [(first + rows as f64) * SAMPLE, 2. * high[1] - low[1]];
    Grid { low: [first * SAMPLE, low[1]], high: beyond, heights: (0..rows).map(row).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AREA: [[f64; 2]; 2] = [[-1., -1.], [5., 1.]];

    #[test]
    fn heights_are_a_share_of_those_of_the_terrain() {
        for name in ["step", "block", "stairs", "slope", "gap", "chimney-lr"] {
            let terrain = Terrain::named(name).unwrap();
            let half = terrain.with_relief(0.5, 0., AREA);
            half.validate().unwrap();
            assert_eq!(half.friction, terrain.friction);
            let above_half = terrain.with_relief(0.5, 0.1, AREA);
            for i in 0..50 {
                // On samples, inside of the area.
                let (x, y) = (-0.9 + 0.1 * f64::from(i), 0.1 * f64::from(i % 7) - 0.3);
                let whole = terrain.height(x + 1e-9, y);
                assert!((half.height(x, y) - 0.5 * whole).abs() < 1e-6, "{name} at {x}: {} of {whole}", half.height(x, y));
                assert!((above_half.height(x, y) - (0.1 + 0.5 * (whole - 0.1))).abs() < 1e-6);
            }
        }
        assert_eq!(Terrain::flat().with_relief(0.3, 0., AREA), Terrain::flat());
    }
}
