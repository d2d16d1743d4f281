//! Analytic terrains of TOWR \[3\]. Heights in m; all features are ahead of the origin, along +x.

use super::Ground;
use num_traits::Float;
use serde::{Deserialize, Serialize};

/// Analytic height profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Profile {
    /// Block 0.5 m high from x = 0.7 to 4.2 m, with a ramp 0.03 m wide up to it.
    Block,
    /// Stairs of height 0.2 m from x = 1.0 m and 0.4 m from x = 1.4 m, back to 0 at x = 2.4 m.
    Stairs,
    /// Parabolic ditch, 1.5 m deep, from x = 1.0 to 1.6 m.
    Gap,
    /// Ramp up to 0.7 m from x = 1 to 2 m and down again to x = 3 m.
    Slope,
    /// Wall of slope 3 in y from x = 1.0 to 2.5 m.
    Chimney,
    /// Wall of slope 2 that rises to the left from x = 0.5 to 1.5 m, then one that rises to the right up to x = 2.5 m.
    ChimneyLr,
}

/// Declares the dimensions of the profiles, and their list for shaders.
macro_rules! dimensions {
    ($($(#[$about:meta])* $name:ident = $value:expr;)*) => {
        $($(#[$about])* const $name: f64 = $value;)*
        /// Dimensions of the profiles with their names in shaders.
        pub const DIMENSIONS: &[(&str, f64)] = &[$((stringify!($name), $name),)*];
    };
}

/// Width of the ramp up to the block, m.
const BLOCK_RAMP: f64 = 0.03;
/// Width of the gap, m.
const GAP_WIDTH: f64 = 0.6;

dimensions! {
    /// Beginning of the ramp, m.
    BLOCK_START = 0.7;
    /// End of the ramp, m.
    BLOCK_TOP = BLOCK_START + BLOCK_RAMP;
    /// End of the block, m.
    BLOCK_END = BLOCK_START + 3.5;
    /// Height of the block, m.
    BLOCK_HEIGHT = 0.5;
    /// Slope of the ramp.
    BLOCK_SLOPE = BLOCK_HEIGHT / BLOCK_RAMP;
    /// Beginning of the first stair, m.
    STAIRS_START = 1.0;
    /// Beginning of the second stair, m.
    STAIRS_TOP = 1.4;
    /// End of the second stair, m.
    STAIRS_END = 2.4;
    /// Height of the first stair, m.
    STAIRS_FIRST_HEIGHT = 0.2;
    /// Height of the second stair, m.
    STAIRS_HEIGHT = 0.4;
    /// First edge of the gap, m.
    GAP_START = 1.0;
    /// Second edge of the gap, m.
    GAP_END = GAP_START + GAP_WIDTH;
    /// Middle of the gap, m.
    GAP_MIDDLE = GAP_START + GAP_WIDTH / 2.;
    /// Depth in the middle of the gap, m.
    GAP_DEPTH = 1.5;
    /// Half the curvature of the gap, 1/m: the height is zero at both edges.
    GAP_BEND = 4. * GAP_DEPTH / (GAP_WIDTH * GAP_WIDTH);
    /// Beginning of the ramp up, m.
    SLOPE_START = 1.0;
    /// Top of the ramps, m.
    SLOPE_TOP = 2.0;
    /// End of the ramp down, m.
    SLOPE_END = 3.0;
    /// Slope of the ramps, and their height over 1 m.
    SLOPE_RISE = 0.7;
    /// Beginning of the wall, m.
    CHIMNEY_START = 1.0;
    /// End of the wall, m.
    CHIMNEY_END = 2.5;
    /// Slope of the wall along y.
    CHIMNEY_SLOPE = 3.;
    /// y at which the wall has height 0, m.
    CHIMNEY_Y = 0.5;
    /// Beginning of the left wall, m.
    CHIMNEY_LR_START = 0.5;
    /// End of the left wall and beginning of the right one, m.
    CHIMNEY_LR_MIDDLE = 1.5;
    /// End of the right wall, m.
    CHIMNEY_LR_END = 2.5;
    /// Slope of both walls along y; the right one rises to the right.
    CHIMNEY_LR_SLOPE = 2.;
    /// Distance from the x axis at which each wall has height 0, m.
    CHIMNEY_LR_Y = 0.5;
}

impl Profile {
    /// Boundaries between patches along x, m; the height may jump there.
    pub fn edges(self) -> &'static [f64] {
        match self {
            Profile::Block => &[BLOCK_START, BLOCK_TOP, BLOCK_END],
            Profile::Stairs => &[STAIRS_START, STAIRS_TOP, STAIRS_END],
            Profile::Gap => &[GAP_START, GAP_END],
            Profile::Slope => &[SLOPE_START, SLOPE_TOP, SLOPE_END],
            Profile::Chimney => &[CHIMNEY_START, CHIMNEY_END],
            Profile::ChimneyLr => &[CHIMNEY_LR_START, CHIMNEY_LR_MIDDLE, CHIMNEY_LR_END],
        }
    }

    /// True if only one patch lies between `low` and `high` along x, m, and it has no curvature.
    pub fn is_plane(self, low: f64, high: f64) -> bool {
        let within = |edge: &f64| (low..=high).contains(edge);
        !self.edges().iter().any(within) && self.ground(low, 0.).curvature == [[0.; 2]; 2]
    }

    /// Height, slope and curvature at (x, y).
    pub fn ground<T: Float>(self, x: T, y: T) -> Ground<T> {
        let c = |v: f64| T::from(v).unwrap_or_else(T::nan);
        let zero = T::zero();
        let within = |low: f64, high: f64| x >= c(low) && x <= c(high);
        let mut ground = Ground::level(zero);
        match self {
            Profile::Block => {
                if within(BLOCK_TOP, BLOCK_END) {
                    ground.height = c(BLOCK_HEIGHT);
                } else if within(BLOCK_START, BLOCK_TOP) {
                    ground.height = c(BLOCK_SLOPE) * (x - c(BLOCK_START));
                    ground.slope[0] = c(BLOCK_SLOPE);
                }
            }
            Profile::Stairs => {
                if x >= c(STAIRS_START) && x < c(STAIRS_TOP) {
                    ground.height = c(STAIRS_FIRST_HEIGHT);
                } else if x >= c(STAIRS_TOP) && x < c(STAIRS_END) {
                    ground.height = c(STAIRS_HEIGHT);
                }
            }
            Profile::Gap => {
                // Zero at both edges, -depth in the middle.
                if within(GAP_START, GAP_END) {
                    let u = x - c(GAP_MIDDLE);
                    ground.height = c(GAP_BEND) * u * u - c(GAP_DEPTH);
                    ground.slope[0] = c(2. * GAP_BEND) * u;
                    ground.curvature[0][0] = c(2. * GAP_BEND);
                }
            }
            Profile::Slope => {
                if x >= c(SLOPE_START) && x < c(SLOPE_TOP) {
                    ground.height = c(SLOPE_RISE) * (x - c(SLOPE_START));
                    ground.slope[0] = c(SLOPE_RISE);
                } else if x >= c(SLOPE_TOP) && x < c(SLOPE_END) {
                    ground.height = c(SLOPE_RISE) - c(SLOPE_RISE) * (x - c(SLOPE_TOP));
                    ground.slope[0] = c(-SLOPE_RISE);
                }
            }
            Profile::Chimney => {
                if within(CHIMNEY_START, CHIMNEY_END) {
                    ground.height = c(CHIMNEY_SLOPE) * (y - c(CHIMNEY_Y));
                    ground.slope[1] = c(CHIMNEY_SLOPE);
                }
            }
            Profile::ChimneyLr => {
                // The second wall applies at the common edge.
                if within(CHIMNEY_LR_MIDDLE, CHIMNEY_LR_END) {
                    ground.height = c(-CHIMNEY_LR_SLOPE) * (y + c(CHIMNEY_LR_Y));
                    ground.slope[1] = c(-CHIMNEY_LR_SLOPE);
                } else if within(CHIMNEY_LR_START, CHIMNEY_LR_MIDDLE) {
                    ground.height = c(CHIMNEY_LR_SLOPE) * (y - c(CHIMNEY_LR_Y));
                    ground.slope[1] = c(CHIMNEY_LR_SLOPE);
                }
            }
        }
        ground
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_at_landmarks() {
        let h = |p: Profile, x: f64, y: f64| p.ground(x, y).height;
        assert!((h(Profile::Block, 0.715, 0.) - 0.25).abs() < 1e-12);
        assert_eq!(h(Profile::Block, 1., 0.), 0.5);
        assert_eq!(h(Profile::Block, 4.3, 0.), 0.);
        assert_eq!((h(Profile::Stairs, 1.2, 0.), h(Profile::Stairs, 1.4, 0.), h(Profile::Stairs, 2.4, 0.)), (0.2, 0.4, 0.));
        assert!((h(Profile::Gap, 1.3, 0.) + 1.5).abs() < 1e-12 && h(Profile::Gap, 1.0, 0.).abs() < 1e-12);
        assert!((h(Profile::Slope, 2., 0.) - 0.7).abs() < 1e-12 && (h(Profile::Slope, 2.5, 0.) - 0.35).abs() < 1e-12);
        assert_eq!(h(Profile::Chimney, 2., 1.5), 3.);
        assert_eq!(h(Profile::ChimneyLr, 1., 1.), 1.);
        assert_eq!(h(Profile::ChimneyLr, 2., -1.), 1.);
    }

    #[test]
    fn a_plane_is_one_patch_without_curvature() {
        assert!(Profile::Slope.is_plane(1.01, 1.99) && Profile::Slope.is_plane(3.01, 9.) && Profile::Gap.is_plane(-5., 0.99));
        assert!(!Profile::Slope.is_plane(0.9, 1.1) && !Profile::Slope.is_plane(0., 5.) && !Profile::Gap.is_plane(1.2, 1.4));
    }

    #[test]
    fn derivatives_match_central_differences() {
        let d = 1e-5;
        for p in [Profile::Block, Profile::Stairs, Profile::Gap, Profile::Slope, Profile::Chimney, Profile::ChimneyLr] {
            for i in 0..200 {
                // Irrational steps avoid the edges.
                let (x, y) = (-0.5 + 0.0271828 * f64::from(i), 0.3 - 0.00314159 * f64::from(i));
                let edge = p.ground(x + d, y).curvature != p.ground(x - d, y).curvature;
                let g = p.ground(x, y);
                let dx = (p.ground(x + d, y).height - p.ground(x - d, y).height) / (2. * d);
                let dy = (p.ground(x, y + d).height - p.ground(x, y - d).height) / (2. * d);
                if !edge && dx.abs() < 1e3 {
                    assert!((dx - g.slope[0]).abs() < 1e-6 && (dy - g.slope[1]).abs() < 1e-6, "{p:?} at {x}, {y}");
                }
                let dxx = (p.ground(x + d, y).slope[0] - p.ground(x - d, y).slope[0]) / (2. * d);
                if dxx.abs() < 1e3 {
                    assert!((dxx - g.curvature[0][0]).abs() < 1e-5, "{p:?} at {x}, {y}");
                }
            }
        }
    }
}
