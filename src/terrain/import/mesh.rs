//! Surfaces of triangles as grids of heights.

use super::{MOST, Map, Placement};
use crate::error::{Error, Result};

/// Number of samples along the longer side of a mesh for which the default cell is chosen. The cell is rounded down to 1, 2 or 5 times a
/// power of ten, so that a side has up to 2.5 times as many samples. Fewer samples blur steps; more make terrain files large.
const SAMPLES: f64 = 200.;

/// Smallest default cell, m: the size of the smallest feet.
const LEAST_CELL: f64 = 0.01;

/// Distance by which a triangle is enlarged, in cells. It closes the cracks between triangles that rounding opens, as in files of 32-bit
/// floats.
const REACH: f64 = 1e-3;

/// Triangles with z up, m.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Mesh {
    pub vertices: Vec<[f64; 3]>,
    /// Vertices of each triangle, in any order.
    pub triangles: Vec<[usize; 3]>,
}

/// Coordinates of a vertex: the first three of several words.
pub(super) fn coordinates(place: &str, words: &[&str]) -> Result<[f64; 3]> {
    if words.len() < 3 {
        return Err(Error::invalid(place, format!("{} coordinates", words.len()), "at least 3: x, y and z in m"));
    }
    let mut point = [0.; 3];
    for (value, word) in point.iter_mut().zip(words) {
        *value = finite(place, word.parse().ok(), word)?;
    }
    Ok(point)
}

/// Value of a coordinate.
pub(super) fn finite(place: &str, value: Option<f64>, shown: impl std::fmt::Display) -> Result<f64> {
    value
        .filter(|v| v.is_finite())
        .ok_or_else(|| Error::invalid(place, format!("coordinate `{shown}`").escape_debug(), "a finite number, m"))
}

impl Mesh {
    /// Adds a polygon as a fan of triangles around its first corner, as is exact for a convex one.
    ///
    /// * `corners` - indices of vertices that exist
    pub fn add_face(&mut self, place: &str, corners: &[usize]) -> Result<()> {
        let [first, rest @ ..] = corners else { return Err(Error::invalid(place, "0 vertices", "at least 3")) };
        if rest.len() < 2 {
            return Err(Error::invalid(place, format!("{} vertices", corners.len()), "at least 3"));
        }
        self.triangles.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
        Ok(())
    }

    /// Samples the highest surface on a grid whose first sample is the lower corner of the mesh. Samples below no triangle are NaN. Vertical
    /// triangles do not count.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a mesh without triangles, and for too many or too few samples.
    pub fn map(&self, placement: &Placement) -> Result<Map> {
        let used = || self.triangles.iter().flatten().map(|vertex| self.vertices[*vertex]);
        if self.triangles.is_empty() {
            let limit = "a surface: with at least one face (a point cloud must be meshed first)";
            return Err(Error::invalid("mesh", format!("{} vertices without faces", self.vertices.len()), limit));
        }
        let bound = |axis: usize, pick: fn(f64, f64) -> f64| used().map(|p| p[axis]).reduce(pick).unwrap_or_default();
        let low = [0, 1].map(|axis| bound(axis, f64::min));
        let extent = [0, 1].map(|axis| bound(axis, f64::max) - low[axis]);
        let (cell, note) = match placement.cell {
            Some(cell) => (cell, String::new()),
            None => {
                let cell = round_down(extent[0].max(extent[1]) / SAMPLES).max(LEAST_CELL);
                (cell, format!("cell of {cell} m chosen for a mesh of {:.3} x {:.3} m", extent[0], extent[1]))
            }
        };
        let mut counts = [0; 2];
        for (axis, name) in ["x", "y"].iter().enumerate() {
            let samples = (extent[axis] / cell + REACH).floor() + 1.;
            if !(2. ..=MOST as f64).contains(&samples) {
                let value = format!("{:.3} m, which is {samples} samples every {cell} m", extent[axis]);
                return Err(Error::invalid(format!("extent of the mesh along {name}"), value, format!("2 to {MOST} samples (--cell)")));
            }
            counts[axis] = samples as usize;
        }
        let mut heights = vec![vec![f64::NAN; counts[1]]; counts[0]];
        for triangle in &self.triangles {
            let corners = triangle.map(|vertex| {
                let [x, y, z] = self.vertices[vertex];
                [(x - low[0]) / cell, (y - low[1]) / cell, z]
            });
            raise(&mut heights, corners);
        }
        Ok(Map { heights, place: Some((low, cell)), note })
    }
}

/// Largest of 1, 2 and 5 times a power of ten that is at most a positive value.
fn round_down(value: f64) -> f64 {
    let power = 10f64.powf(value.log10().floor());
    let factor = [5., 2.].into_iter().find(|factor| factor * power <= value).unwrap_or(1.);
    // The power of ten has rounding errors.
    format!("{:.0e}", factor * power).parse().unwrap_or(factor * power)
}

/// Raises the heights under a triangle to it.
///
/// * `corners` - x and y in cells from the first sample, and z in m
fn raise(heights: &mut [Vec<f64>], corners: [[f64; 3]; 3]) {
    let [a, b, c] = corners;
    let area = cross(a, b, c);
    if area == 0. {
        return;
    }
    // Lengths of the sides that are opposite to the corners.
    let sides = [(b, c), (c, a), (a, b)].map(|(from, to)| (to[0] - from[0]).hypot(to[1] - from[1]));
    let range = |axis: usize, count: usize| {
        let low = corners.iter().map(|p| p[axis]).fold(f64::INFINITY, f64::min) - REACH;
        let high = corners.iter().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max) + REACH;
        low.ceil().max(0.) as usize..count.min(high.floor().max(-1.) as usize + 1)
    };
    let columns = range(1, heights[0].len());
    let (low, high) = (a[2].min(b[2]).min(c[2]), a[2].max(b[2]).max(c[2]));
    for i in range(0, heights.len()) {
        for j in columns.clone() {
            let p = [i as f64, j as f64, 0.];
            // Distances from the sides times twice the area; negative outside.
            let parts = [cross(p, b, c), cross(a, p, c), cross(a, b, p)].map(|part| part * area.signum());
            if parts.iter().zip(sides).all(|(part, side)| *part >= -REACH * side) {
                // Within the enlargement, and after rounding, the height remains between those of the corners.
                let weights = parts.map(|part| part.max(0.));
                let z = weights.iter().zip(corners).map(|(weight, corner)| weight * corner[2]).sum::<f64>() / weights.iter().sum::<f64>();
                heights[i][j] = heights[i][j].max(z.clamp(low, high));
            }
        }
    }
}

/// Twice the signed area of a triangle in x and y.
fn cross(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn every(cell: f64) -> Placement {
        Placement { cell: Some(cell), ..Placement::default() }
    }

    /// Rectangle of two triangles at a height.
    fn add(mesh: &mut Mesh, [x0, x1]: [f64; 2], [y0, y1]: [f64; 2], z: f64) {
        let first = mesh.vertices.len();
        mesh.vertices.extend([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]);
        mesh.triangles.extend([[first, first + 1, first + 2], [first + 3, first + 2, first]]);
    }

    #[test]
    fn the_highest_surface_counts_and_places_without_one_are_holes() {
        let mut mesh = Mesh::default();
        // A table of 0.4 m on two strips of ground with a gap of 0.2 m.
        add(&mut mesh, [-1., 0.], [0., 1.], 0.1);
        add(&mut mesh, [0.2, 1.], [0., 1.], 0.);
        add(&mut mesh, [0.5, 0.8], [0.3, 0.7], 0.4);
        add(&mut mesh, [0.5, 0.8], [0.3, 0.7], 0.35);
        let map = mesh.map(&every(0.1)).unwrap();
        let ([x, y], cell) = map.place.unwrap();
        assert_eq!((x, y, cell, map.heights.len(), map.heights[0].len()), (-1., 0., 0.1, 21, 11));
        for (i, row) in map.heights.iter().enumerate() {
            for (j, &height) in row.iter().enumerate() {
                let expected = match i {
                    0..=10 => 0.1,
                    11 => f64::NAN,
                    15..=18 if (3..=7).contains(&j) => 0.4,
                    _ => 0.,
                };
                assert!(height == expected || height.is_nan() && expected.is_nan(), "row {i}, column {j}: {height} m, not {expected} m");
            }
        }
    }

    #[test]
    fn a_mesh_of_single_precision_has_the_heights_of_its_points_and_no_holes() {
        let (rows, columns, cell) = (60, 41, 0.05);
        let height = |i: usize, j: usize| 0.3 * (0.2 * i as f64).sin() * (0.3 * j as f64).cos();
        let single = |v: f64| f64::from(v as f32);
        let mut mesh = Mesh::default();
        for i in 0..rows {
            for j in 0..columns {
                mesh.vertices.push([single(-7.3 + cell * i as f64), single(4.1 + cell * j as f64), single(height(i, j))]);
                if i > 0 && j > 0 {
                    let at = i * columns + j;
                    mesh.triangles.extend([[at, at - 1, at - columns], [at - columns, at - columns - 1, at - 1]]);
                }
            }
        }
        let map = mesh.map(&every(cell)).unwrap();
        assert_eq!((map.heights.len(), map.heights[0].len()), (rows, columns));
        for i in 0..rows {
            for j in 0..columns {
                assert!((map.heights[i][j] - height(i, j)).abs() < 1e-5, "{i}, {j}: {}", map.heights[i][j]);
            }
        }
    }

    #[test]
    fn samples_of_random_triangles_match_their_planes() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let (mut inside, mut outside) = (0, 0);
        for _ in 0..200 {
            let mut mesh = Mesh::default();
            for number in 0..4 {
                mesh.vertices.extend((0..3).map(|_| [0, 1, 2].map(|_| random.random_range(-1.0..1.0))));
                mesh.triangles.push([3 * number, 3 * number + 1, 3 * number + 2]);
            }
            let map = mesh.map(&every(0.05)).unwrap();
            let ([x0, y0], cell) = map.place.unwrap();
            for _ in 0..50 {
                let (i, j) = (random.random_range(0..map.heights.len()), random.random_range(0..map.heights[0].len()));
                let (x, y) = (x0 + cell * i as f64, y0 + cell * j as f64);
                // Height by barycentric coordinates from a linear system.
                let mut expected = f64::NAN;
                let mut close = false;
                for triangle in &mesh.triangles {
                    let [a, b, c] = triangle.map(|vertex| mesh.vertices[vertex]);
                    let sides = Matrix2::new(b[0] - a[0], c[0] - a[0], b[1] - a[1], c[1] - a[1]);
                    let Some(parts) = sides.try_inverse().map(|inverse| inverse * Vector2::new(x - a[0], y - a[1])) else { continue };
                    let (u, v) = (parts.x, parts.y);
                    let least = u.min(v).min(1. - u - v);
                    close |= least.abs() < 0.02;
                    if least >= 0. {
                        expected = expected.max(a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2]));
                    }
                }
                if close {
                    continue;
                }
                let height = map.heights[i][j];
                assert!(
                    (height - expected).abs() < 1e-9 || height.is_nan() && expected.is_nan(),
                    "({x}, {y}): {height} m, not {expected} m"
                );
                if expected.is_nan() {
                    outside += 1;
                } else {
                    inside += 1;
                }
            }
        }
        assert!(inside > 1000 && outside > 1000, "{inside} inside, {outside} outside");
    }

    #[test]
    fn a_cell_is_chosen_by_the_extent_and_stated() {
        for (extent, cell) in [(12., 0.05), (10., 0.05), (40., 0.2), (1., 0.01), (0.3, 0.01), (19.9, 0.05), (20., 0.1)] {
            let mut mesh = Mesh::default();
            add(&mut mesh, [0., 0.3], [0., extent], 0.);
            let map = mesh.map(&Placement::default()).unwrap();
            assert_eq!(map.place.unwrap().1, cell, "{extent} m");
            assert_eq!(map.note, format!("cell of {cell} m chosen for a mesh of 0.300 x {extent:.3} m"));
        }
    }

    #[test]
    fn too_many_or_too_few_samples_are_refused() {
        let mut mesh = Mesh::default();
        add(&mut mesh, [0., 50.], [0., 0.5], 0.);
        let refused = |cell: f64| mesh.map(&every(cell)).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(
            refused(0.01).starts_with("extent of the mesh along x: 50.000 m, which is 5001 samples every 0.01 m, but it must be 2 to 4096")
        );
        assert!(refused(1.).starts_with("extent of the mesh along y: 0.500 m, which is 1 samples every 1 m, but it must be 2 to 4096"));
        // Vertical walls alone are no ground.
        let wall = Mesh { vertices: vec![[0., 0., 0.], [1., 1., 0.], [1., 1., 1.]], triangles: vec![[0, 1, 2]] };
        assert!(wall.map(&every(0.5)).unwrap().heights.iter().flatten().all(|height| height.is_nan()));
    }
}
