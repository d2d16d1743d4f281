//! Terrain around a motion as a mesh of lines along x and y.

use super::samples::Sample;
use crate::terrain::{Profile, Shape, Terrain};
use serde::Serialize;

/// Most lines along an axis. Of a finer grid only every second, third, ... line is drawn.
const MOST_LINES: usize = 200;

/// Number of pieces in which a curved patch is drawn.
const PIECES: usize = 64;

/// Distance to either side of a jump at which its two heights are taken, m.
const ASIDE: f64 = 1e-9;

/// Terrain shown around a motion, in leg heights, and its minimum, m.
const MARGIN: (f64, f64) = (3., 0.5);

/// Heights above a rectangle of the plane.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GroundMesh {
    /// Lines along x, m, ascending. A value appears twice where the ground jumps.
    pub xs: Vec<f64>,
    /// Lines along y, m, ascending.
    pub ys: Vec<f64>,
    /// Heights, m: first all heights of the first line along x, then those of the second, ...
    pub heights: Vec<f64>,
    /// True if lines of a grid were left out.
    pub coarser: bool,
}

impl GroundMesh {
    /// Terrain around a motion and its goal.
    ///
    /// * `leg` - leg height, m
    pub fn around(samples: &[Sample], goal: [f64; 3], leg: f64, terrain: &Terrain) -> GroundMesh {
        let margin = (MARGIN.0 * leg).max(MARGIN.1);
        let places = || {
            let feet = samples.iter().flat_map(|s| s.feet.iter().map(|f| f.position));
            feet.chain(samples.iter().map(|s| s.base.position)).chain([goal])
        };
        // Millimetres are precise enough for the edge of the mesh.
        let rounded = |value: f64| (value * 1e3).round() / 1e3;
        let low = [0, 1].map(|axis| rounded(places().map(|p| p[axis]).fold(f64::INFINITY, f64::min) - margin));
        let high = [0, 1].map(|axis| rounded(places().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max) + margin));
        GroundMesh::new(terrain, low, high)
    }

    /// Terrain from `low` to `high` (x, y), m.
    pub fn new(terrain: &Terrain, low: [f64; 2], high: [f64; 2]) -> GroundMesh {
        let (mut xs, ys, coarser) = match &terrain.shape {
            Shape::Flat => (vec![low[0], high[0]], vec![low[1], high[1]], false),
            Shape::Profile(profile) => (profile_lines(*profile, low[0], high[0]), vec![low[1], high[1]], false),
            Shape::Grid(grid) => {
                let mut coarser = false;
                let [xs, ys] = [0, 1].map(|axis| {
                    let samples = [grid.heights.len(), grid.heights[0].len()][axis];
                    let cell = (grid.high[axis] - grid.low[axis]) / samples as f64;
                    let lines = (0..samples).map(|i| grid.low[axis] + i as f64 * cell);
                    let inside: Vec<f64> = lines.filter(|&v| v > low[axis] && v < high[axis]).collect();
                    let step = inside.len().div_ceil(MOST_LINES).max(1);
                    coarser |= step > 1;
                    [low[axis]].into_iter().chain(inside.into_iter().step_by(step)).chain([high[axis]]).collect::<Vec<f64>>()
                });
                (xs, ys, coarser)
            }
        };
        let aside = |x: f64, sign: f64| ys.iter().map(|&y| terrain.height(x + sign * ASIDE, y)).collect::<Vec<f64>>();
        let jumps = |x: f64| aside(x, -1.).iter().zip(aside(x, 1.)).any(|(before, after)| (before - after).abs() > 1e-6);
        let mut heights = Vec::with_capacity(xs.len() * ys.len());
        let mut lines = Vec::with_capacity(xs.len());
        for x in xs.drain(..) {
            if x > low[0] && x < high[0] && matches!(terrain.shape, Shape::Profile(_)) && jumps(x) {
                for sign in [-1., 1.] {
                    lines.push(x);
                    heights.extend(aside(x, sign));
                }
            } else {
                lines.push(x);
                heights.extend(ys.iter().map(|&y| terrain.height(x, y)));
            }
        }
        GroundMesh { xs: lines, ys, heights, coarser }
    }
}

/// Lines at the edges of a profile, and between them where it is curved.
fn profile_lines(profile: Profile, low: f64, high: f64) -> Vec<f64> {
    let mut lines = vec![low, high];
    lines.extend(profile.edges());
    for edges in profile.edges().windows(2) {
        let middle: f64 = (edges[0] + edges[1]) / 2.;
        if profile.ground(middle, 0.).curvature[0][0] != 0. {
            lines.extend((1..PIECES).map(|i| edges[0] + (edges[1] - edges[0]) * i as f64 / PIECES as f64));
        }
    }
    lines.retain(|&x| x >= low && x <= high);
    lines.sort_by(f64::total_cmp);
    lines.dedup();
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::Grid;

    fn mesh(name: &str) -> GroundMesh {
        GroundMesh::new(&Terrain::named(name).unwrap(), [-1., -2.], [6., 2.])
    }

    #[test]
    fn risers_of_stairs_are_two_lines_at_one_position() {
        let stairs = mesh("stairs");
        assert_eq!(stairs.xs, [-1., 1.0, 1.0, 1.4, 1.4, 2.4, 2.4, 6.]);
        let along: Vec<f64> = stairs.heights.iter().step_by(2).copied().collect();
        assert_eq!(along, [0., 0., 0.2, 0.2, 0.4, 0.4, 0., 0.]);
        // The ramp up to the block is not a jump; its far end is.
        assert_eq!(mesh("block").xs, [-1., 0.7, 0.73, 4.2, 4.2, 6.]);
        // A wall in y begins with a jump.
        let chimney = mesh("chimney");
        assert_eq!(chimney.xs, [-1., 1., 1., 2.5, 2.5, 6.]);
        assert_eq!(chimney.heights.len(), 12);
    }

    #[test]
    fn a_mesh_lies_on_the_ground() {
        for name in ["step", "gap", "slope"] {
            let (mesh, terrain) = (mesh(name), Terrain::named(name).unwrap());
            assert!(mesh.xs.is_sorted() && !mesh.coarser, "{name}");
            for (i, &x) in mesh.xs.iter().enumerate() {
                for (j, &y) in mesh.ys.iter().enumerate() {
                    assert!((mesh.heights[i * mesh.ys.len() + j] - terrain.height(x, y)).abs() < 1e-9, "{name} at {x}, {y}");
                }
            }
            // Between the lines, the mesh follows the terrain.
            for (i, pair) in mesh.xs.windows(2).enumerate() {
                let middle = (mesh.heights[i * mesh.ys.len()] + mesh.heights[(i + 1) * mesh.ys.len()]) / 2.;
                assert!((terrain.height((pair[0] + pair[1]) / 2., mesh.ys[0]) - middle).abs() < 1e-3, "{name} at {}", pair[0]);
            }
        }
    }

    #[test]
    fn a_fine_grid_is_thinned_and_marked() {
        let heights = vec![vec![0.; 900]; 900];
        let shape = Shape::Grid(Grid { low: [-2.; 2], high: [8.; 2], heights });
        let mesh = GroundMesh::new(&Terrain { name: "fine".into(), friction: 1., shape }, [-1., -1.], [7., 1.]);
        assert!(mesh.coarser && mesh.xs.len() <= MOST_LINES + 2 && mesh.heights.len() == mesh.xs.len() * mesh.ys.len());
    }
}
