//! Rectangular grid of heights with bilinear interpolation.

use super::Ground;
use crate::error::{Error, Result, check_range};
use num_traits::Float;
use serde::{Deserialize, Serialize};

/// Grid of heights.
///
/// Row `i` is at `x = low[0] + i (high[0] - low[0]) / rows`, column `j` at `y = low[1] + j (high[1] - low[1]) / columns`. As in \[4\], the
/// number of cells equals the number of samples, so the last row and column extend to the upper edge.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// Lower corner (x, y), m.
    pub low: [f64; 2],
    /// Upper corner (x, y), m.
    pub high: [f64; 2],
    /// Heights, m, `[rows along x][columns along y]`.
    pub heights: Vec<Vec<f64>>,
}

impl Grid {
    /// Step of 0.15 m from \[4\]: 50 x 50 samples over 20 x 20 m, rows from 35 on at 0.15 m.
    pub fn step() -> Grid {
        let heights = (0..50).map(|i| vec![if i >= 35 { 0.15 } else { 0. }; 50]).collect();
        Grid { low: [-10.; 2], high: [10.; 2], heights }
    }

    /// Checks corners, sizes and heights.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first field that is out of its limits.
    pub fn validate(&self) -> Result<()> {
        for axis in 0..2 {
            check_range(&format!("terrain.grid.low[{axis}]"), self.low[axis], -1000., 1000.)?;
            check_range(&format!("terrain.grid.high[{axis}]"), self.high[axis], self.low[axis] + 1e-3, 1000.)?;
        }
        let (rows, columns) = (self.heights.len(), self.heights.first().map_or(0, Vec::len));
        if !(2..=4096).contains(&rows) || !(2..=4096).contains(&columns) {
            return Err(Error::invalid("terrain.grid.heights", format!("{rows} x {columns}"), "2 x 2 to 4096 x 4096"));
        }
        for (i, row) in self.heights.iter().enumerate() {
            if row.len() != columns {
                return Err(Error::invalid(
                    format!("terrain.grid.heights[{i}]"),
                    format!("{} columns", row.len()),
                    format!("{columns} columns"),
                ));
            }
            for (j, &h) in row.iter().enumerate() {
                check_range(&format!("terrain.grid.heights[{i}][{j}]"), h, -100., 100.)?;
            }
        }
        Ok(())
    }

    /// True if the ground between two corners (x, y), m, is one plane, to 1 nm, and lies within the samples. Outside the samples the ground
    /// is level.
    pub fn is_plane(&self, low: [f64; 2], high: [f64; 2]) -> bool {
        // Range of samples that encloses a side.
        let samples = |axis: usize, count: usize| {
            let at = |v: f64| (v - self.low[axis]) * count as f64 / (self.high[axis] - self.low[axis]);
            let (first, last) = (at(low[axis]), at(high[axis]));
            (first >= 0. && last <= (count - 1) as f64).then(|| (first as usize, last.ceil() as usize))
        };
        let (Some((i, last_i)), Some((j, last_j))) = (samples(0, self.heights.len()), samples(1, self.heights[0].len())) else {
            return false;
        };
        let corner = self.heights[i][j];
        let along_x = (self.heights[last_i][j] - corner) / (last_i - i).max(1) as f64;
        let along_y = (self.heights[i][last_j] - corner) / (last_j - j).max(1) as f64;
        self.heights[i..=last_i].iter().zip(0..).all(|(row, di)| {
            let plane = |dj: i32| corner + f64::from(di) * along_x + f64::from(dj) * along_y;
            row[j..=last_j].iter().zip(0..).all(|(height, dj)| (height - plane(dj)).abs() < 1e-9)
        })
    }

    /// Height, slope and curvature at (x, y); beyond the last sample the height at the edge continues.
    pub fn ground<T: Float>(&self, x: T, y: T) -> Ground<T> {
        let c = |v: f64| T::from(v).unwrap_or_else(T::nan);
        // Cell, fraction within it, samples per metre (0 where clamped).
        let locate = |v: T, axis: usize, samples: usize| {
            let per_metre = c(samples as f64 / (self.high[axis] - self.low[axis]));
            let u = (v - c(self.low[axis])) * per_metre;
            let last = c((samples - 1) as f64);
            let inside = u >= T::zero() && u <= last;
            let clamped = if u.is_nan() { T::zero() } else { u.max(T::zero()).min(last) };
            let cell = clamped.to_usize().unwrap_or(0).min(samples - 2);
            (cell, clamped - c(cell as f64), if inside { per_metre } else { T::zero() })
        };
        let (i, a, da) = locate(x, 0, self.heights.len());
        let (j, b, db) = locate(y, 1, self.heights[0].len());
        let h = |i: usize, j: usize| c(self.heights[i][j]);
        let (h00, h10, h01, h11) = (h(i, j), h(i + 1, j), h(i, j + 1), h(i + 1, j + 1));
        let (along_x, along_y, twist) = (h10 - h00, h01 - h00, h11 - h10 - h01 + h00);
        Ground {
            height: h00 + a * along_x + b * along_y + a * b * twist,
            slope: [(along_x + b * twist) * da, (along_y + a * twist) * db],
            curvature: [[T::zero(), twist * da * db], [twist * da * db, T::zero()]],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn step_rises_between_rows_34_and_35() {
        let step = Grid::step();
        for (x, height) in [(3.59, 0.), (3.8, 0.075), (4.01, 0.15), (9.9, 0.15), (-12., 0.)] {
            assert!((step.ground(x, 1.234).height - height).abs() < 1e-12, "x = {x}");
        }
        assert!((step.ground(3.7, 0.).slope[0] - 0.375).abs() < 1e-12);
        assert_eq!(step.ground(20., 0.).slope, [0., 0.]);
    }

    #[test]
    fn derivatives_match_central_differences() {
        let heights = (0..6).map(|i| (0..5).map(|j| f64::from(i * i) * 0.03 - 0.02 * f64::from(j * i)).collect()).collect();
        let grid = Grid { low: [-1., 0.], high: [2., 2.5], heights };
        grid.validate().unwrap();
        let d = 1e-6;
        for n in 0..50 {
            let (x, y) = (-0.97 + 0.0471 * f64::from(n), 0.03 + 0.0371 * f64::from(n));
            let g = grid.ground(x, y);
            assert!(((grid.ground(x + d, y).height - grid.ground(x - d, y).height) / (2. * d) - g.slope[0]).abs() < 1e-7);
            assert!(((grid.ground(x, y + d).height - grid.ground(x, y - d).height) / (2. * d) - g.slope[1]).abs() < 1e-7);
            assert!(((grid.ground(x, y + d).slope[0] - grid.ground(x, y - d).slope[0]) / (2. * d) - g.curvature[0][1]).abs() < 1e-7);
        }
    }

    #[test]
    fn a_plane_ends_at_edges_and_at_the_end_of_the_grid() {
        let plane = |i: usize, j: usize| 0.1 * i as f64 - 0.07 * j as f64;
        let heights = (0..20).map(|i| (0..30).map(|j| plane(i, j) + if i > 12 && j > 12 { 1e-6 } else { 0. }).collect()).collect();
        let grid = Grid { low: [-1., 2.], high: [3., 8.], heights };
        // Samples every 0.2 m, the last ones at x = 2.8 m and y = 7.8 m.
        for (low, high, is) in [
            ([-1., 2.], [1.39, 7.79], true),
            ([-1., 2.], [2.79, 4.39], true),
            ([-1., 2.], [1.5, 4.5], false),
            ([1.61, 4.61], [2.79, 7.79], true),
            ([0.3, 3.3], [0.3, 3.3], true),
            ([-1.1, 2.], [1., 3.], false),
            ([-1., 2.], [1., 7.9], false),
            ([f64::NAN, 2.], [1., 3.], false),
        ] {
            assert_eq!(grid.is_plane(low, high), is, "{low:?} to {high:?}");
        }
    }

    #[test]
    fn ragged_and_oversized_grids_are_refused() {
        let mut grid = Grid::step();
        grid.heights[7].pop();
        assert!(grid.validate().unwrap_err().to_string().contains("heights[7]"));
        grid.heights = vec![vec![0.; 2]; 5000];
        assert!(grid.validate().unwrap_err().to_string().contains("5000"));
    }
}
