//! Proven maxima along polynomial curves. A curve lies in the convex hull of its Bernstein control points, and halving a part reduces the
//! distance between curve and hull to a quarter.
//!
//! The conversions from Hermite pieces are written here a second time on purpose, so that the certificate shares no formula with the
//! solver.

use crate::gait::Curve;
use crate::terrain::{Shape, Terrain};
use nalgebra::Vector3;

/// Number of halvings after which a bound is taken as the value.
const DEPTH: u32 = 48;

/// Largest number of parts examined per piece before the remaining bound is taken as the value: far more than a smooth curve needs.
const PARTS: u32 = 20_000;

/// Largest gap between a bound and the maximum, relative to the largest value of the control points.
const CLOSE: f64 = 1e-12;

/// Control points of a piece.
pub(super) type Control<const N: usize> = [Vector3<f64>; N];

/// Control points of the position on a Hermite piece.
pub(super) fn position(curve: &Curve, piece: usize) -> Control<4> {
    let (a, b) = (&curve.nodes[piece], &curve.nodes[piece + 1]);
    let third = curve.poly_durations[piece] / 3.;
    let value = |n: &[f64; 6]| Vector3::new(n[0], n[1], n[2]);
    let slope = |n: &[f64; 6]| Vector3::new(n[3], n[4], n[5]) * third;
    [value(a), value(a) + slope(a), value(b) - slope(b), value(b)]
}

/// Control points of the velocity on a Hermite piece.
pub(super) fn velocity(curve: &Curve, piece: usize) -> Control<3> {
    let (a, b) = (&curve.nodes[piece], &curve.nodes[piece + 1]);
    let value = |n: &[f64; 6]| Vector3::new(n[0], n[1], n[2]);
    let slope = |n: &[f64; 6]| Vector3::new(n[3], n[4], n[5]);
    // Differences first, so that the velocity of a standing foot is exactly zero.
    let middle = (value(b) - value(a)) * (3. / curve.poly_durations[piece]) - slope(a) - slope(b);
    [slope(a), middle, slope(b)]
}

/// Control points of the acceleration on a Hermite piece.
pub(super) fn acceleration(curve: &Curve, piece: usize) -> Control<2> {
    let [a, b, c] = velocity(curve, piece);
    let by = 2. / curve.poly_durations[piece];
    [(b - a) * by, (c - b) * by]
}

/// Splits a curve into its two halves (de Casteljau).
pub(super) fn halves<const N: usize>(mut c: Control<N>) -> (Control<N>, Control<N>) {
    let (mut left, mut right) = (c, c);
    for level in 1..N {
        for i in 0..N - level {
            c[i] = (c[i] + c[i + 1]) / 2.;
        }
        left[level] = c[0];
        right[N - 1 - level] = c[N - 1 - level];
    }
    (left, right)
}

/// Maximum and its position on the piece, from 0 to 1.
pub(super) type Peak = (f64, f64);

/// Maximum along a curve.
///
/// * `value` - function to maximise, of a point of the curve
/// * `bound` - upper bound of `value` on a part of the curve, from its control points
/// * `floor` - values below it need not be resolved
/// * `close` - largest amount by which the result may be below the true maximum
///
/// Returns infinity if a control point is not finite or `value` is NaN.
fn greatest<const N: usize>(
    control: Control<N>,
    value: impl Fn(&Vector3<f64>) -> f64,
    bound: impl Fn(&Control<N>) -> f64,
    floor: f64,
    close: f64,
) -> Peak {
    if control.iter().any(|c| !c.iter().all(|v| v.is_finite())) {
        return (f64::INFINITY, 0.);
    }
    let mut best = (value(&control[0]), 0.);
    let seen = |at: f64, v: f64, best: &mut Peak| {
        if v.is_nan() || v > best.0 {
            *best = (if v.is_nan() { f64::INFINITY } else { v }, at);
        }
    };
    seen(1., value(&control[N - 1]), &mut best);
    let mut parts = vec![(control, 0., 1., 0)];
    let mut count = 0;
    while let Some((part, start, end, depth)) = parts.pop() {
        let above = bound(&part);
        if above <= best.0.max(floor) + close {
            continue;
        }
        count += 1;
        let middle = (start + end) / 2.;
        if depth >= DEPTH || count > PARTS || !above.is_finite() {
            seen(middle, above, &mut best);
            continue;
        }
        let (left, right) = halves(part);
        seen(middle, value(&right[0]), &mut best);
        parts.extend([(left, start, middle, depth + 1), (right, middle, end, depth + 1)]);
    }
    best
}

/// Maximum of a convex function along a curve, to [`CLOSE`].
///
/// `f(sum B_i c_i) <= sum B_i f(c_i) <= max f(c_i)`
pub(super) fn convex<const N: usize>(control: Control<N>, f: impl Fn(&Vector3<f64>) -> f64, floor: f64) -> Peak {
    let scale = control.iter().map(|c| f(c).abs()).fold(0., f64::max);
    greatest(control, &f, |part| part.iter().map(&f).fold(f64::NEG_INFINITY, f64::max), floor, CLOSE * scale)
}

/// Largest depth of a curve below the terrain, m, to 1e-6 m; negative if the curve is above it.
pub(super) fn depth<const N: usize>(control: Control<N>, terrain: &Terrain, floor: f64) -> Peak {
    if terrain.shape == Shape::Flat {
        return convex(control, |p| -p.z, floor);
    }
    let value = |p: &Vector3<f64>| terrain.height(p.x, p.y) - p.z;
    greatest(control, value, |part| depth_bound(terrain, part), floor, 1e-6)
}

/// Upper bound of the depth of a part of a curve, m.
///
/// If the part stays on one patch of the terrain, a polynomial of second order, the height is expanded about the centre of the part's
/// bounding box. Otherwise the highest ground within the box is used for the whole part.
pub(super) fn depth_bound<const N: usize>(terrain: &Terrain, part: &Control<N>) -> f64 {
    let mut low = part[0];
    let mut high = part[0];
    for c in part {
        low = low.inf(c);
        high = high.sup(c);
    }
    let breaks = [breaks(terrain, 0, low.x, high.x), breaks(terrain, 1, low.y, high.y)];
    if breaks.iter().all(|b| b.is_empty()) {
        let middle = (low + high) / 2.;
        let half = (high - low) / 2.;
        let ground = terrain.ground(middle.x, middle.y);
        let above = |p: &Vector3<f64>| ground.height + ground.slope[0] * (p.x - middle.x) + ground.slope[1] * (p.y - middle.y) - p.z;
        let [[xx, xy], [_, yy]] = ground.curvature;
        let rest = (xx.max(0.) * half.x * half.x + yy.max(0.) * half.y * half.y) / 2. + xy.abs() * half.x * half.y;
        return part.iter().map(above).fold(f64::NEG_INFINITY, f64::max) + rest;
    }
    // The height of a patch is bilinear or convex, so its maximum is at a corner.
    let [xs, ys] = [(breaks[0].clone(), low.x, high.x), (breaks[1].clone(), low.y, high.y)].map(|(mut values, low, high)| {
        values.extend([low, high]);
        values
    });
    let heights = xs.iter().flat_map(|&x| ys.iter().map(move |&y| terrain.height(x, y)));
    heights.fold(f64::NEG_INFINITY, f64::max) - low.z
}

/// Coordinates at which patches of a terrain meet, strictly inside an interval of an axis, m; at a jump also the points on both sides.
pub(super) fn breaks(terrain: &Terrain, axis: usize, low: f64, high: f64) -> Vec<f64> {
    match &terrain.shape {
        Shape::Flat => Vec::new(),
        Shape::Grid(grid) => {
            let samples = [grid.heights.len(), grid.heights[0].len()][axis];
            let cell = (grid.high[axis] - grid.low[axis]) / samples as f64;
            let line = |i: usize| grid.low[axis] + i as f64 * cell;
            let first = (((low - grid.low[axis]) / cell).floor().max(0.) as usize).min(samples - 1);
            (first..samples).map(line).skip_while(|&x| x <= low).take_while(|&x| x < high).collect()
        }
        Shape::Profile(_) if axis == 1 => Vec::new(),
        Shape::Profile(profile) => {
            // A part that ends at a break may belong to either side of it.
            let inside = profile.edges().iter().filter(|&&x| x > low - 1e-9 && x < high + 1e-9 && low < high);
            inside.flat_map(|&x| [x - 1e-9, x, x + 1e-9]).map(|x| x.clamp(low, high)).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::Grid;

    fn curve(a: [f64; 6], b: [f64; 6], duration: f64) -> Curve {
        Curve { poly_durations: vec![duration], nodes: vec![a, b] }
    }

    #[test]
    fn maxima_match_the_polynomial() {
        // z = s u (1 - u)^2 d has its maximum, 4/27 s d, at u = 1/3.
        let c = curve([0., 0., 0., 0., 0., 3.], [0.; 6], 0.2);
        let (value, at) = convex(position(&c, 0), |p| p.z, 0.);
        assert!((value - 4. / 27. * 0.6).abs() < 1e-12 && (at - 1. / 3.).abs() < 1e-5, "{value} at {at}");
        // From rest to rest over 0.1 m in 0.2 s: the peak speed is in the middle, 1.5 times the mean.
        let c = curve([0.; 6], [0.06, 0.08, 0., 0., 0., 0.], 0.2);
        let (value, at) = convex(velocity(&c, 0), |v| v.norm(), 0.);
        assert!((value - 0.75).abs() < 1e-11 && (at - 0.5).abs() < 1e-5);
        assert!((acceleration(&c, 0)[0].norm() - 6. * 0.1 / 0.04).abs() < 1e-9);
        assert_eq!(convex(position(&curve([f64::NAN; 6], [0.; 6], 1.), 0), |p| p.z, 0.).0, f64::INFINITY);
    }

    /// The proven maximum is never below that of many samples and hardly above it.
    #[test]
    fn bounds_hold_for_samples_and_are_tight() {
        let heights = (0..9).map(|i| (0..9).map(|j| 0.05 * f64::from((i * 7 + j * 3) % 5)).collect()).collect();
        let grid = Terrain { shape: Shape::Grid(Grid { low: [-1.; 2], high: [3.; 2], heights }), ..Terrain::flat() };
        let named = ["stairs", "gap", "slope", "block", "chimney", "chimney-lr"].map(|name| Terrain::named(name).unwrap());
        let mut state = 1_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f64 / (1_u64 << 24) as f64
        };
        for terrain in named.iter().chain([&grid]) {
            for _ in 0..50 {
                let mut node = || [random() * 3., random(), random() * 0.5, random() - 0.5, random() - 0.5, random() - 0.5];
                let c = curve(node(), node(), 0.4);
                let control = position(&c, 0);
                let (value, _) = depth(control, terrain, f64::NEG_INFINITY);
                let at = |u: f64| {
                    let (v, w) = (u, 1. - u);
                    let p =
                        control[0] * (w * w * w) + control[1] * (3. * v * w * w) + control[2] * (3. * v * v * w) + control[3] * (v * v * v);
                    terrain.height(p.x, p.y) - p.z
                };
                let sampled = (0..=20_000).map(|i| at(f64::from(i) / 20_000.)).fold(f64::NEG_INFINITY, f64::max);
                assert!(value >= sampled - 2e-6 && value < sampled + 1e-2, "{}: {value} against {sampled}", terrain.name);
            }
        }
    }
}
