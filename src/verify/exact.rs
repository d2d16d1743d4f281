//! Maxima over whole curves, in closed form or bounded on every piece, without sampling.

use super::bernstein::{Peak, acceleration, convex, depth, position, velocity};
use super::curves::{ContactAxes, DenseState, Extreme, FootMotion, Motion, TimedCurve};
use crate::terrain::Terrain;
use nalgebra::Vector3;

/// Number of halvings of a reach interval after which its bound is taken as the value.
const REACH_DEPTH: u32 = 16;

/// Gap between bound and value below which a reach interval is not halved further, m.
const REACH_CLOSE: f64 = 1e-8;

/// Records the maximum of a piece. `peak` computes it from the largest value so far.
fn note(extreme: &mut Extreme, peak: impl FnOnce(f64) -> Peak, foot: Option<usize>, curve: &TimedCurve, piece: usize) {
    let (value, at) = peak(extreme.value);
    extreme.update(value, foot, curve.times[piece] + at * curve.length(piece));
}

/// Maxima over standing feet, N: pulling force, normal force above its limit, and force outside the friction cone, `|f_t| - mu f_n`.
pub(super) fn forces(motion: &Motion, terrain: &Terrain, force_limit: f64, floor: f64) -> [Extreme; 3] {
    let mut extremes = [Extreme::default(); 3];
    for (foot, curves) in motion.feet.iter().enumerate() {
        let curve = &curves.force;
        for piece in 0..curve.pieces() {
            let Some(foothold) = curves.foothold(curve.times[piece] + curve.length(piece) / 2.) else { continue };
            let (normal, control) = (ContactAxes::new(terrain, foothold).normal, position(curve.curve, piece));
            let [pull, limit, friction] = &mut extremes;
            note(pull, |best| convex(control, |f| -f.dot(&normal), floor.max(best)), Some(foot), curve, piece);
            let above = |f: &Vector3<f64>| f.dot(&normal) - force_limit;
            note(limit, |best| convex(control, above, floor.max(best)), Some(foot), curve, piece);
            let outside = |f: &Vector3<f64>| {
                let push = f.dot(&normal);
                (f - normal * push).norm() - terrain.friction * push
            };
            note(friction, |best| convex(control, outside, floor.max(best)), Some(foot), curve, piece);
        }
    }
    extremes
}

/// Largest depth of a foot below the terrain, m.
pub(super) fn penetration(motion: &Motion, terrain: &Terrain, floor: f64) -> Extreme {
    let mut extreme = Extreme::default();
    for (foot, curves) in motion.feet.iter().enumerate() {
        for piece in 0..curves.motion.pieces() {
            let below = |best| depth(position(curves.motion.curve, piece), terrain, floor.max(best));
            note(&mut extreme, below, Some(foot), &curves.motion, piece);
        }
    }
    extreme
}

/// Largest distance of a standing foot from its foothold, m.
pub(super) fn standing(motion: &Motion, floor: f64) -> Extreme {
    let mut extreme = Extreme::default();
    for (foot, curves) in motion.feet.iter().enumerate() {
        let curve = &curves.motion;
        for piece in 0..curve.pieces() {
            let Some(foothold) = curves.foothold(curve.times[piece] + curve.length(piece) / 2.) else { continue };
            let off = |best| convex(position(curve.curve, piece), |p| (p - foothold).norm(), floor.max(best));
            note(&mut extreme, off, Some(foot), curve, piece);
        }
    }
    extreme
}

/// Largest depth of the base below the terrain, m.
pub(super) fn base_depth(motion: &Motion, terrain: &Terrain) -> Extreme {
    let mut extreme = Extreme::default();
    let curve = &motion.base_lin;
    for piece in 0..curve.pieces() {
        note(&mut extreme, |best| depth(position(curve.curve, piece), terrain, best), None, curve, piece);
    }
    extreme
}

/// Largest speed of a foot over a range of pieces, m/s: total, or only the horizontal component.
pub(super) fn foot_speed(curves: &FootMotion, pieces: std::ops::Range<usize>, horizontal: bool, floor: f64) -> Extreme {
    let mut extreme = Extreme::default();
    let curve = &curves.motion;
    for piece in pieces {
        let speed = |v: &Vector3<f64>| if horizontal { v.xy().norm() } else { v.norm() };
        note(&mut extreme, |best| convex(velocity(curve.curve, piece), speed, floor.max(best)), None, curve, piece);
    }
    extreme
}

/// Largest acceleration of a foot over a range of pieces, m/s². The acceleration is linear on each piece.
pub(super) fn foot_acceleration(curves: &FootMotion, pieces: std::ops::Range<usize>) -> Extreme {
    ends(&curves.motion, pieces, |a| a.norm())
}

/// Maximum of a convex function of a curve's acceleration. The acceleration is linear on each piece, so the maximum is at an end.
pub(super) fn ends(curve: &TimedCurve, pieces: std::ops::Range<usize>, f: impl Fn(&Vector3<f64>) -> f64) -> Extreme {
    let mut extreme = Extreme::default();
    for piece in pieces {
        for (at, a) in acceleration(curve.curve, piece).iter().enumerate() {
            note(&mut extreme, |_| (f(a), at as f64), None, curve, piece);
        }
    }
    extreme
}

/// Largest sum of the absolute Euler rates of the base, rad/s. It bounds the angular velocity.
pub(super) fn base_rate(curve: &TimedCurve, floor: f64) -> Extreme {
    let mut extreme = Extreme::default();
    for piece in 0..curve.pieces() {
        note(&mut extreme, |best| convex(velocity(curve.curve, piece), |r| r.lp_norm(1), floor.max(best)), None, curve, piece);
    }
    extreme
}

/// Sum of the largest force of every foot, N.
pub(super) fn push(motion: &Motion) -> f64 {
    let greatest = |curve: &TimedCurve| {
        let peaks = (0..curve.pieces()).map(|piece| convex(position(curve.curve, piece), |f| f.norm(), 0.).0);
        peaks.fold(0., f64::max)
    };
    motion.feet.iter().map(|foot| greatest(&foot.force)).sum()
}

/// Bounds of the angular velocity and acceleration of the base, rad/s and rad/s², on the piece that contains a time.
///
/// The axes of the Euler angles are unit vectors that rotate no faster than the sum of the rates of the angles before them.
pub(super) fn turning(angles: &TimedCurve, time: f64) -> [f64; 2] {
    let greatest = |control: &[Vector3<f64>]| control.iter().map(|c| c.lp_norm(1)).fold(0., f64::max);
    let [rates, turn] = angles.on(time, |curve, piece| [greatest(&velocity(curve, piece)), greatest(&acceleration(curve, piece))]);
    [rates, turn + rates * rates]
}

/// Quantities that bound the curvature of a foot's path in the base frame, over an interval without nodes.
struct Bend {
    /// Angular velocity, rad/s.
    omega: f64,
    /// Angular acceleration, rad/s².
    alpha: f64,
    /// Acceleration of the base at both ends, m/s².
    base: [Vector3<f64>; 2],
}

/// Largest distance of a foot outside the worst slab of its reach, m.
///
/// Over an interval of length `h` a twice differentiable function exceeds the larger of its end values by at most `h^2 / 8 max |f''|`. With
/// `r` the foot relative to the base: `|(R' r)''| <= |r''| + 2 |w| |r'| + (|w'| + |w|^2) |r|`. An interval is halved until the bound is
/// below `floor` or within [`REACH_CLOSE`] of the value.
pub(super) fn reach(motion: &Motion, floor: f64) -> Extreme {
    let mut times: Vec<f64> = motion.base_lin.times.iter().chain(&motion.base_ang.times).copied().collect();
    times.extend(motion.feet.iter().flat_map(|foot| &foot.motion.times));
    times.retain(|&t| t <= motion.horizon);
    times.push(motion.horizon);
    times.sort_by(f64::total_cmp);
    times.dedup_by(|a, b| *a - *b < 1e-9);
    let mut extreme = Extreme::default();
    let mut before = motion.base(times[0]);
    let mut parts = Vec::new();
    let excess = |base: &DenseState, foot: usize, at: Vector3<f64>| {
        let worse = |a: f64, b: f64| if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) };
        motion.reach_excess(base, foot, at).fold(f64::NEG_INFINITY, worse)
    };
    for interval in times.windows(2) {
        let (start, end) = (interval[0], interval[1]);
        let after = motion.base(end);
        let middle = (start + end) / 2.;
        let [omega, alpha] = turning(&motion.base_ang, middle);
        let bend = Bend { omega, alpha, base: motion.base_lin.on(middle, acceleration) };
        for (foot, curves) in motion.feet.iter().enumerate() {
            let path = curves.motion.on(middle, acceleration);
            // All accelerations are linear on their pieces, so the difference is largest at some pair of ends.
            let apart = path.iter().flat_map(|a| bend.base.iter().map(move |b| (a - b).norm())).fold(0., f64::max);
            let at = |time: f64, base: &DenseState| {
                let p = curves.motion.at(time);
                (excess(base, foot, p.value), (p.value - base.position).norm(), (p.first - base.velocity).norm())
            };
            parts.push((start, at(start, &before), end, at(end, &after), 0));
            while let Some((start, first, end, last, depth)) = parts.pop() {
                let length = end - start;
                extreme.update(first.0, Some(foot), start);
                extreme.update(last.0, Some(foot), end);
                let speed = first.2.max(last.2) + apart * length / 2.;
                let arm = first.1.max(last.1) + speed * length / 2.;
                let curvature = apart + 2. * bend.omega * speed + (bend.alpha + bend.omega * bend.omega) * arm;
                let above = first.0.max(last.0) + length * length / 8. * curvature;
                if above <= floor.max(extreme.value) {
                    continue;
                }
                let middle = (start + end) / 2.;
                if depth >= REACH_DEPTH || above - first.0.max(last.0) < REACH_CLOSE || !above.is_finite() {
                    extreme.update(above, Some(foot), middle);
                    continue;
                }
                let half = at(middle, &motion.base(middle));
                parts.extend([(start, first, middle, half, depth + 1), (middle, half, end, last, depth + 1)]);
            }
        }
        before = after;
    }
    extreme
}
