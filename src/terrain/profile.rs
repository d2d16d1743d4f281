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

impl Profile {
    /// Boundaries between patches along x, m; the height may jump there.
    pub fn edges(self) -> &'static [f64] {
        match self {
            Profile::Block => &[0.7, 0.7 + 0.03, 0.7 + 3.5],
            Profile::Stairs => &[1.0, 1.4, 2.4],
            Profile::Gap => &[1.0, 1.0 + 0.6],
            Profile::Slope => &[1.0, 2.0, 3.0],
            Profile::Chimney => &[1.0, 2.5],
            Profile::ChimneyLr => &[0.5, 1.5, 2.5],
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
                let (start, ramp, length, height) = (0.7, 0.03, 3.5, 0.5);
                if within(start + ramp, start + length) {
                    ground.height = c(height);
                } else if within(start, start + ramp) {
                    ground.height = c(height / ramp) * (x - c(start));
                    ground.slope[0] = c(height / ramp);
                }
            }
            Profile::Stairs => {
                if x >= c(1.0) && x < c(1.4) {
                    ground.height = c(0.2);
                } else if x >= c(1.4) && x < c(2.4) {
                    ground.height = c(0.4);
                }
            }
            Profile::Gap => {
                // Zero at both edges, -depth in the middle.
                let (start, width, depth) = (1.0, 0.6, 1.5);
                if within(start, start + width) {
                    let a = 4. * depth / (width * width);
                    let u = x - c(start + width / 2.);
                    ground.height = c(a) * u * u - c(depth);
                    ground.slope[0] = c(2. * a) * u;
                    ground.curvature[0][0] = c(2. * a);
                }
            }
            Profile::Slope => {
                let (start, top, end, height) = (1.0, 2.0, 3.0, 0.7);
                if x >= c(start) && x < c(top) {
                    ground.height = c(height) * (x - c(start));
                    ground.slope[0] = c(height);
                } else if x >= c(top) && x < c(end) {
                    ground.height = c(height) - c(height) * (x - c(top));
                    ground.slope[0] = c(-height);
                }
            }
            Profile::Chimney => {
                if within(1.0, 2.5) {
                    ground.height = c(3.) * (y - c(0.5));
                    ground.slope[1] = c(3.);
                }
            }
            Profile::ChimneyLr => {
                // The second wall applies at the common edge.
                if within(1.5, 2.5) {
                    ground.height = c(-2.) * (y + c(0.5));
                    ground.slope[1] = c(-2.);
                } else if within(0.5, 1.5) {
                    ground.height = c(2.) * (y - c(0.5));
                    ground.slope[1] = c(2.);
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
