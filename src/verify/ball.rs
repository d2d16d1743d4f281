//! Foot balls: penetration of the ground by a foot's ball during a swing, and deviation of the ground around a foothold from its plane.
//!
//! A foot is the point at which a ball touches the ground. At lift-off and touchdown the centre of the ball is one radius away from that
//! point along the ground normal. During the swing the offset from point to centre is interpolated linearly, so the path of the centre is a
//! cubic.
//!
//! The penetration is the radius minus the distance of the centre from everything at or below the surface. It changes by no more than the
//! centre moves. On a part of a path it therefore exceeds its value at the middle by at most the distance from there to the rest of the
//! part; parts are halved until this bound decides. Distances are bounded in the same manner over ever smaller rectangles of ground, so
//! vertical risers and obstacles between samples count.

use super::bernstein::{Control, breaks, halves, position};
use super::curves::{ContactAxes, Extreme, FootMotion, nearest};
use crate::terrain::{Shape, Terrain};
use nalgebra::{Vector2, Vector3};
use std::collections::VecDeque;

/// Accuracy of distances, m. Depths are underestimated by at most twice as much, 0.1 mm.
const CLOSE: f64 = 5e-5;

/// Largest number of rectangles examined per distance, and of parts per path piece. Afterwards the remaining bound is taken as the value.
const LOOKS: u32 = 5_000;

/// Largest number of patches created per path piece before its bound is taken as the value. Grids much finer than a foot have many under
/// it.
const PATCHES: usize = 2_000_000;

/// Largest width of the strip between two patches at a jump in height, m.
const STRIP: f64 = 4e-9;

/// Ground over a rectangle that no patch boundary crosses: one polynomial of second order, or a strip with a jump.
#[derive(Clone, Copy)]
struct Patch {
    low: Vector2<f64>,
    high: Vector2<f64>,
    /// Heights at the corners, `[x][y]`.
    corners: [[f64; 2]; 2],
}

impl Patch {
    fn corner(&self, i: usize, j: usize) -> Vector2<f64> {
        Vector2::new([self.low.x, self.high.x][i], [self.low.y, self.high.y][j])
    }

    /// Returns the point of the rectangle nearest to `to`.
    fn nearest(&self, to: Vector2<f64>) -> Vector2<f64> {
        to.sup(&self.low).inf(&self.high)
    }

    /// Splits the rectangle across its longer side.
    fn halves(&self, terrain: &Terrain) -> [Patch; 2] {
        let (size, middle) = (self.high - self.low, (self.low + self.high) / 2.);
        let axis = usize::from(size.y > size.x);
        let (mut first, mut second) = (*self, *self);
        first.high[axis] = middle[axis];
        second.low[axis] = middle[axis];
        for side in 0..2 {
            if axis == 0 {
                let height = terrain.height(middle.x, [self.low.y, self.high.y][side]);
                (first.corners[1][side], second.corners[0][side]) = (height, height);
            } else {
                let height = terrain.height([self.low.x, self.high.x][side], middle.y);
                (first.corners[side][1], second.corners[side][0]) = (height, height);
            }
        }
        [first, second]
    }

    /// Lower bound of the distance of a point from this ground and everything below it, m.
    ///
    /// The height is bilinear or convex, so its maximum is at a corner. It exceeds the tangent plane at the centre by no more than the
    /// second-order term of its expansion.
    fn distance_bound(&self, terrain: &Terrain, from: &Vector3<f64>) -> f64 {
        let highest = self.corners.concat().into_iter().fold(f64::NEG_INFINITY, f64::max);
        let aside = (self.nearest(from.xy()) - from.xy()).norm();
        let beside = aside.hypot((from.z - highest).max(0.));
        let half = (self.high - self.low) / 2.;
        if self.corners.concat().into_iter().all(|height| height == highest) || half.min() * 2. < STRIP {
            return beside;
        }
        let middle = self.low + half;
        let ground = terrain.ground(middle.x, middle.y);
        let [[xx, xy], [_, yy]] = ground.curvature;
        let rest = (xx.max(0.) * half.x * half.x + yy.max(0.) * half.y * half.y) / 2. + xy.abs() * half.x * half.y;
        let slope = Vector2::from(ground.slope);
        let plane = ground.height + slope.dot(&(from.xy() - middle)) + rest;
        beside.max((from.z - plane) / slope.norm().hypot(1.))
    }

    /// Distance of a point from a point of this ground that is close to the nearest one, m: an upper bound.
    fn distance(&self, terrain: &Terrain, from: &Vector3<f64>) -> f64 {
        let at = self.nearest(from.xy());
        let ground = terrain.ground(at.x, at.y);
        let slope = Vector2::from(ground.slope);
        let above = from.z - ground.height - slope.dot(&(from.xy() - at));
        // The foot of the perpendicular to the tangent plane.
        let foot = self.nearest(from.xy() + slope * (above / (1. + slope.norm_squared())));
        [at, foot]
            .map(|q| (q - from.xy()).norm().hypot((from.z - terrain.height(q.x, q.y)).max(0.)))
            .into_iter()
            .fold(f64::INFINITY, f64::min)
    }
}

/// Splits a rectangle into patches.
fn patches(terrain: &Terrain, low: Vector2<f64>, high: Vector2<f64>) -> Vec<Patch> {
    let [xs, ys] = [0, 1].map(|axis| {
        let mut lines = vec![low[axis]];
        lines.extend(breaks(terrain, axis, low[axis], high[axis]));
        lines.push(high[axis]);
        lines
    });
    let heights: Vec<Vec<f64>> = xs.iter().map(|&x| ys.iter().map(|&y| terrain.height(x, y)).collect()).collect();
    let mut all = Vec::with_capacity(xs.len() * ys.len());
    for (i, x) in xs.windows(2).enumerate() {
        for (j, y) in ys.windows(2).enumerate() {
            let corners = [[heights[i][j], heights[i][j + 1]], [heights[i + 1][j], heights[i + 1][j + 1]]];
            all.push(Patch { low: Vector2::new(x[0], y[0]), high: Vector2::new(x[1], y[1]), corners });
        }
    }
    all
}

/// Distance of a point from the ground and everything below it, m, to [`CLOSE`]; `within` if it is larger.
fn distance(terrain: &Terrain, from: &Vector3<f64>, within: f64) -> f64 {
    distance_counting(terrain, from, within, &mut 0)
}

/// [`distance`] that also adds the number of created patches to `made`.
fn distance_counting(terrain: &Terrain, from: &Vector3<f64>, within: f64, made: &mut usize) -> f64 {
    let around = Vector2::repeat(within);
    // Breadth first, so the largest patches come first: if much of the ground is equally far away, only small patches remain at the limit.
    let mut open = VecDeque::from(patches(terrain, from.xy() - around, from.xy() + around));
    *made += open.len();
    let (mut best, mut looks) = (within, 0);
    while let Some(patch) = open.pop_front() {
        let bound = patch.distance_bound(terrain, from);
        if bound >= best - CLOSE {
            continue;
        }
        looks += 1;
        if looks > LOOKS {
            best = bound;
            continue;
        }
        best = best.min(patch.distance(terrain, from));
        if bound < best - CLOSE {
            open.extend(patch.halves(terrain));
        }
    }
    best
}

/// Upper bound of all heights of a terrain, m.
fn highest(terrain: &Terrain) -> f64 {
    match &terrain.shape {
        Shape::Flat => 0.,
        Shape::Grid(grid) => grid.heights.iter().flatten().fold(f64::NEG_INFINITY, |highest, &h| highest.max(h)),
        // The walls of chimneys are infinitely high.
        Shape::Profile(_) => f64::INFINITY,
    }
}

/// Depth of a standing foot's ball in the ground, m; values below `floor` are returned as `floor`.
pub(super) fn standing_depth(terrain: &Terrain, foothold: Vector3<f64>, radius: f64, floor: f64) -> f64 {
    let middle = foothold + ContactAxes::new(terrain, foothold).normal * radius;
    radius - distance(terrain, &middle, radius - floor)
}

/// Largest excess of the ball's penetration over the allowed one during a swing, m; 0 if it stays within.
///
/// * `swing` - times of lift-off and touchdown, s
/// * `allowed` - allowed penetration, m: within two radii of the lift-off (horizontally), and elsewhere
pub(super) fn swing_depth(curves: &FootMotion, swing: [f64; 2], terrain: &Terrain, radius: f64, allowed: [f64; 2]) -> Extreme {
    let motion = &curves.motion;
    let nodes = swing.map(|time| nearest(&motion.times, time));
    let ends = nodes.map(|node| ContactAxes::new(terrain, motion.value(node)).normal * radius);
    let ground = Below { terrain, radius, top: highest(terrain), start: (motion.value(nodes[0]) + ends[0]).xy(), allowed };
    let mut extreme = Extreme { value: 0., time: swing[0], foot: None };
    for piece in nodes[0]..nodes[1] {
        let (start, length) = (motion.times[piece], motion.length(piece));
        let offset = |third: usize| {
            let part = (start + length * third as f64 / 3. - swing[0]) / (swing[1] - swing[0]);
            ends[0] + (ends[1] - ends[0]) * part
        };
        let control: Control<4> = position(motion.curve, piece);
        let path = std::array::from_fn(|i| control[i] + offset(i));
        let (value, at) = ground.path_depth(path, extreme.value);
        if value > extreme.value {
            extreme = Extreme { value, time: start + at * length, foot: None };
        }
    }
    extreme
}

/// The ground below the path of a ball.
struct Below<'a> {
    terrain: &'a Terrain,
    radius: f64,
    /// Upper bound of all heights, m.
    top: f64,
    /// Horizontal position of the ball's centre at lift-off, m.
    start: Vector2<f64>,
    /// See [`swing_depth`].
    allowed: [f64; 2],
}

impl Below<'_> {
    /// Allowed penetration on a part of the path of the ball's centre, m.
    fn allowed(&self, part: &Control<4>) -> f64 {
        let [at_start, elsewhere] = self.allowed;
        if part.iter().all(|c| (c.xy() - self.start).norm() < 2. * self.radius) { at_start } else { elsewhere }
    }

    /// Largest excess over the allowed penetration on a path piece, m (at least `floor`), and its position on the piece, 0 to 1.
    fn path_depth(&self, path: Control<4>, floor: f64) -> (f64, f64) {
        let Below { terrain, radius, .. } = *self;
        if !path.iter().all(|c| c.iter().all(|v| v.is_finite())) {
            return (f64::INFINITY, 0.);
        }
        let mut best = (floor, 0.);
        let mut parts = vec![(path, 0., 1.)];
        let (mut looks, mut made) = (0, 0);
        while let Some((part, start, end)) = parts.pop() {
            let allowed = self.allowed(&part);
            if part.iter().all(|c| c.z - radius > self.top - allowed) {
                continue;
            }
            looks += 1;
            let (left, right) = halves(part);
            let (middle, at) = (right[0], (start + end) / 2.);
            let apart = part.iter().map(|c| (c - middle).norm()).fold(0., f64::max);
            let enough = looks > LOOKS || made > PATCHES;
            // The distance query of a long part would cover too much ground.
            if apart <= radius || enough {
                let within = radius - best.0 - allowed + apart;
                let over = radius - distance_counting(terrain, &middle, within, &mut made) - allowed;
                let bound = (over + apart).min(radius - allowed);
                if over > best.0 {
                    best = (over, at);
                }
                if bound <= best.0 + CLOSE {
                    continue;
                }
                if enough {
                    best = (bound, at);
                    continue;
                }
            }
            parts.extend([(left, start, at), (right, at, end)]);
        }
        best
    }
}

/// Largest deviation, above or below, of the ground within `radius` of a foothold from its tangent plane there, m; at least `floor`.
pub(super) fn off_plane(terrain: &Terrain, foothold: Vector3<f64>, radius: f64, floor: f64) -> f64 {
    let here = foothold.xy();
    let ground = terrain.ground(here.x, here.y);
    if !ground.height.is_finite() {
        return f64::INFINITY;
    }
    let slope = Vector2::from(ground.slope);
    let off = |at: Vector2<f64>, height: f64| (height - ground.height - slope.dot(&(at - here))).abs();
    let mut best = floor;
    let mut looks = 0;
    let mut open = patches(terrain, here - Vector2::repeat(radius), here + Vector2::repeat(radius));
    while let Some(patch) = open.pop() {
        if (patch.nearest(here) - here).norm() > radius {
            continue;
        }
        let (half, mut bound) = ((patch.high - patch.low) / 2., 0_f64);
        for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let corner = patch.corner(i, j);
            bound = bound.max(off(corner, patch.corners[i][j]));
            let within = here + (corner - here).cap_magnitude(radius);
            best = best.max(off(within, terrain.height(within.x, within.y)));
        }
        // A bilinear height deviates most at a corner; a profile bends by its curvature in between.
        let middle = patch.low + half;
        let [[xx, _], [_, yy]] = terrain.ground(middle.x, middle.y).curvature;
        bound += (xx.abs() * half.x * half.x + yy.abs() * half.y * half.y) / 2.;
        if bound <= best + CLOSE {
            continue;
        }
        looks += 1;
        if looks > LOOKS {
            best = bound;
            continue;
        }
        open.extend(patch.halves(terrain));
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::{Grid, Terrain};

    /// Pseudo-random number from 0 to 1.
    fn random(state: &mut u64) -> f64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (*state >> 40) as f64 / (1_u64 << 24) as f64
    }

    /// A grid of twisted 5 cm cells, and every built-in profile.
    fn terrains() -> Vec<Terrain> {
        let heights = (0..60).map(|i| (0..20).map(|j| 0.01 * f64::from((i * 7 + j * 3) % 5)).collect()).collect();
        let grid = Terrain { shape: Shape::Grid(Grid { low: [0.; 2], high: [3., 1.], heights }), ..Terrain::flat() };
        let named = ["stairs", "gap", "slope", "block", "chimney", "chimney-lr"].map(|name| Terrain::named(name).unwrap());
        named.into_iter().chain([grid]).collect()
    }

    #[test]
    fn distance_matches_a_dense_search() {
        let mut state = 1;
        for terrain in terrains() {
            let mut close = 0;
            for _ in 0..60 {
                let (x, y) = (0.6 + 2. * random(&mut state), 0.2 + 0.6 * random(&mut state));
                let from = Vector3::new(x, y, terrain.height(x, y) + 0.05 * random(&mut state));
                let got = distance(&terrain, &from, 0.04);
                let mut least = 0.04_f64;
                for (i, j) in (-80..=80).flat_map(|i| (-80..=80).map(move |j| (i, j))) {
                    let (dx, dy) = (5e-4 * f64::from(i), 5e-4 * f64::from(j));
                    let below = (from.z - terrain.height(x + dx, y + dy)).max(0.);
                    least = least.min(Vector3::new(dx, dy, below).norm());
                }
                // Samples are 0.5 mm apart and never nearer than the nearest point.
                assert!(got <= least + CLOSE && got > least - 6e-4, "{} at {x}, {y}: {got} against {least}", terrain.name);
                close += usize::from(least < 0.04);
            }
            assert!(close > 10, "{}", terrain.name);
        }
    }

    #[test]
    fn deviation_from_the_plane_matches_a_dense_search() {
        let mut state = 2;
        for terrain in terrains() {
            for _ in 0..60 {
                let (x, y) = (0.6 + 2. * random(&mut state), 0.2 + 0.6 * random(&mut state));
                let ground = terrain.ground(x, y);
                let got = off_plane(&terrain, Vector3::new(x, y, ground.height), 0.03, 0.);
                let mut most = 0_f64;
                for (i, k) in (0..=60).flat_map(|i| (0..360).map(move |k| (i, k))) {
                    let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 360.).sin_cos();
                    let (dx, dy) = (5e-4 * f64::from(i) * cos, 5e-4 * f64::from(i) * sin);
                    most = most.max((terrain.height(x + dx, y + dy) - ground.height - ground.slope[0] * dx - ground.slope[1] * dy).abs());
                }
                // Half a sample step on the steepest ground (0.5 m in 0.03 m); half of a jump between samples.
                assert!(got >= most - CLOSE && got <= most + 0.011 || got > 0.19, "{} at {x}, {y}: {got} against {most}", terrain.name);
            }
        }
    }

    #[test]
    fn ball_depth_beside_a_riser_is_its_radius_minus_the_distance() {
        // Steps of 0.2 m at 1.0 m and 1.4 m.
        let stairs = Terrain::named("stairs").unwrap();
        let path = |x: f64, z: f64| [0.8, 0.8 + (x - 0.8) / 3., 0.8 + (x - 0.8) * 2. / 3., x].map(|x| Vector3::new(x, 0., z));
        let below = |allowed| Below { terrain: &stairs, radius: 0.05, top: f64::INFINITY, start: Vector2::new(0.8, 0.), allowed };
        let depth = |x: f64, z: f64| below([0.; 2]).path_depth(path(x, z), 0.);
        let close = |got: f64, expected: f64| assert!((got - expected).abs() < 2. * CLOSE, "{got} against {expected}");
        close(depth(0.94, 0.1).0, 0.);
        let (value, at) = depth(0.97, 0.1);
        close(value, 0.02);
        assert!((at - 1.).abs() < 0.01);
        // Above the edge: the radius minus the distance from the edge.
        close(depth(1.2, 0.23).0, 0.02);
        close(depth(0.97, 0.24).0, 0.05 - 0.03_f64.hypot(0.04));
        // Inside the step: the depth is at most the radius.
        close(depth(1.2, 0.1).0, 0.05);
        assert_eq!(below([0.; 2]).path_depth([Vector3::new(f64::NAN, 0., 0.); 4], 0.).0, f64::INFINITY);
        // The allowance at the start holds within two radii of it and no farther.
        let from = |x: f64| Below { start: Vector2::new(x, 0.), ..below([0.03, 0.005]) }.path_depth(path(0.97, 0.1), 0.).0;
        close(from(0.8), 0.015);
        close(from(0.93), 0.);
    }

    #[test]
    fn a_slope_counts_as_a_plane_and_an_edge_deviates_by_the_ground_beyond_it() {
        // The ground rises with slope 0.7 from x = 1 m to 2 m and descends again.
        let slope = Terrain::named("slope").unwrap();
        let at = |x: f64| Vector3::new(x, 0.2, slope.height(x, 0.2));
        assert!(standing_depth(&slope, at(1.5), 0.05, -0.01).abs() < CLOSE && off_plane(&slope, at(1.5), 0.05, 0.) < 1e-12);
        // 2 cm before the top: 3 cm of the radius lie beyond it, where the slope differs by 1.4.
        assert!((off_plane(&slope, at(1.98), 0.05, 0.) - 1.4 * 0.03).abs() < CLOSE);
        // At the bottom corner of the slope: `1 - cos(atan 0.7)` of the radius.
        let corner = 0.05 * (1. - 1. / 0.7_f64.hypot(1.));
        assert!((standing_depth(&slope, at(1. - 1e-9), 0.05, 0.) - corner).abs() < 2. * CLOSE);
        let stairs = Terrain::named("stairs").unwrap();
        for (x, off) in [(0.94, 0.), (0.96, 0.2), (1.04, 0.2), (1.06, 0.), (1.34, 0.), (1.36, 0.2)] {
            let got = off_plane(&stairs, Vector3::new(x, 0., stairs.height(x, 0.)), 0.05, 0.);
            assert!((got - off).abs() < 1e-12, "{x}: {got}");
        }
    }
}
