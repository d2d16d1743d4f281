//! Terrain as the feet find it: the map, corrected by the points at which the feet last bore load.

use crate::terrain::{Grid, Shape, Terrain};
use std::sync::Arc;

/// Distance of a foot from the map from which the map is corrected, m: several times the error of a measured position.
pub(super) const APART: f64 = 0.02;
/// Share by which the height of a contact follows the measured one.
const SHARE: f64 = 0.3;
/// Depth under a foot that found no ground at which the ground is expected, base heights.
const DEEPER: f64 = 0.15;
/// Samples of a corrected map along each side, and the distance between them, base heights.
const SAMPLES: usize = 24;
const SPACING: f64 = 0.25;

/// Last contact of each foot.
#[derive(Debug, Clone)]
pub(super) struct Touched {
    /// Point, world frame, m; `None` before the first contact.
    points: Vec<Option<[f64; 3]>>,
    /// True for a foot that found no ground.
    pub missed: Vec<bool>,
    /// True for a foot that has not borne load since it swung.
    pub hangs: Vec<bool>,
}

impl Touched {
    pub fn new(feet: usize) -> Touched {
        Touched { points: vec![None; feet], missed: vec![false; feet], hangs: vec![false; feet] }
    }

    /// Takes a foot that is loaded.
    pub fn bears(&mut self, foot: usize, [x, y, z]: [f64; 3]) {
        let before = self.points[foot].map_or(z, |[_, _, before]| before);
        let height = if (z - before).abs() > APART { z } else { before + SHARE * (z - before) };
        self.points[foot] = Some([x, y, height]);
        (self.missed[foot], self.hangs[foot]) = (false, false);
    }

    /// Takes a foot that found no ground: the ground is deeper.
    pub fn misses(&mut self, foot: usize, [x, y, z]: [f64; 3], base_height: f64) {
        self.points[foot] = Some([x, y, z - DEEPER * base_height]);
        self.missed[foot] = true;
    }

    /// The map if all contacts are near it. Otherwise a grid around the contacts: each sample is off the map by the mean of the contacts'
    /// differences, weighted by the fourth power of the distance.
    pub fn correct(&self, map: &Arc<Terrain>, base_height: f64) -> Arc<Terrain> {
        let points: Vec<[f64; 3]> = self.points.iter().flatten().map(|&[x, y, z]| [x, y, z - map.height(x, y)]).collect();
        if points.iter().all(|[.., off]| off.abs() < APART) {
            return map.clone();
        }
        let spacing = SPACING * base_height;
        let half = spacing * SAMPLES as f64 / 2.;
        // Corners on a fixed raster: the ground does not move with the robot.
        let low: [f64; 2] = std::array::from_fn(|axis| {
            let middle = points.iter().map(|point| point[axis]).sum::<f64>() / points.len() as f64;
            ((middle - half) / spacing).round() * spacing
        });
        let height = |x: f64, y: f64| {
            let (mut sum, mut weights) = (0., 0.);
            for [px, py, off] in &points {
                let near = (x - px).powi(2) + (y - py).powi(2) + (0.1 * spacing).powi(2);
                (sum, weights) = (sum + off / near.powi(2), weights + near.powi(-2));
            }
            map.height(x, y) + sum / weights
        };
        let along = |axis: usize| (0..SAMPLES).map(move |i| low[axis] + spacing * i as f64);
        let heights = along(0).map(|x| along(1).map(|y| height(x, y)).collect()).collect();
        let high = low.map(|low| low + 2. * half);
        Arc::new(Terrain { name: "touched".into(), friction: map.friction, shape: Shape::Grid(Grid { low, high, heights }) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FEET: [[f64; 2]; 4] = [[0.2, 0.1], [0.2, -0.1], [-0.2, 0.1], [-0.2, -0.1]];

    /// Contacts of four feet at their heights, m.
    fn touched(heights: [f64; 4]) -> Touched {
        let mut touched = Touched::new(4);
        for (foot, ([x, y], z)) in FEET.into_iter().zip(heights).enumerate() {
            touched.bears(foot, [x, y, z]);
        }
        touched
    }

    #[test]
    fn contacts_near_the_map_leave_it_as_it_is() {
        let map = Arc::new(Terrain::flat());
        assert!(Arc::ptr_eq(&touched([0.015, -0.015, 0., 0.01]).correct(&map, 0.3), &map));
        assert!(Arc::ptr_eq(&Touched::new(4).correct(&map, 0.3), &map));
    }

    #[test]
    fn the_ground_continues_as_the_nearest_feet_found_it() {
        let map = Arc::new(Terrain::flat());
        let corrected = touched([-0.1, -0.1, 0., 0.]).correct(&map, 0.3);
        corrected.validate().unwrap();
        for ([x, y], height) in FEET.into_iter().zip([-0.1, -0.1, 0., 0.]) {
            assert!((corrected.height(x, y) - height).abs() < 0.01, "{}", corrected.height(x, y));
        }
        // In front of the feet and behind them, and between them.
        assert!((corrected.height(0.35, 0.) + 0.1).abs() < 0.01 && corrected.height(-0.35, 0.).abs() < 0.01);
        assert!((corrected.height(0., 0.) + 0.05).abs() < 0.01);
        assert_eq!(corrected.friction, map.friction);
    }

    #[test]
    fn contacts_are_averaged_and_jumps_are_taken_at_once() {
        let mut touched = touched([0.; 4]);
        touched.bears(0, [0.2, 0.1, 0.01]);
        assert_eq!(touched.points[0], Some([0.2, 0.1, 0.003]));
        touched.bears(0, [0.25, 0.1, 0.08]);
        assert_eq!(touched.points[0], Some([0.25, 0.1, 0.08]));
        touched.misses(0, [0.25, 0.1, -0.02], 0.3);
        assert_eq!((touched.points[0], touched.missed[0]), (Some([0.25, 0.1, -0.02 - DEEPER * 0.3]), true));
        touched.bears(0, [0.25, 0.1, -0.04]);
        assert!(!touched.missed[0]);
    }
}
