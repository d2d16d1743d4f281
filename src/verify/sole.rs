//! Soles: wrenches that friction and pressure can produce, flat ground under standing soles, soles clear of the ground in swings and of
//! each other, and their yaw relative to the base.
//!
//! Nothing is certified by samples alone. A wrench can be produced if forces at the four corners inside their friction cones can produce
//! it; the set of these wrenches is a convex cone, so a piece whose control points are in it is in it everywhere. All other quantities are
//! bounded on parts of the motion by how fast they change, and parts are halved until the bound decides.

use super::bernstein::{Control, depth_bound, halves, position};
use super::curves::{Extreme, FootMotion, Motion, SAME_TIME, TimedCurve};
use super::exact::foot_speed;
use crate::gait::trajectory::turn_done;
use crate::robot::Sole;
use crate::terrain::Terrain;
use nalgebra::{Vector2, Vector3};

/// Largest number of halvings of a part of a motion; afterwards its bound is the value.
const DEPTH: u32 = 14;

/// Largest rate of `3 u^2 - 2 u^3`.
const FASTEST_BLEND: f64 = 1.5;

/// Sole of a foot at one time.
pub(crate) struct Posture {
    /// Centre of the rectangle, m.
    pub centre: Vector3<f64>,
    /// Unit vectors from heel to toe, and to the left.
    pub axes: [Vector3<f64>; 2],
}

impl Posture {
    /// Point of the sole at a share of its half extents.
    pub fn point(&self, sole: &Sole, share: [f64; 2]) -> Vector3<f64> {
        let [x, y] = sole.half_extents();
        self.centre + self.axes[0] * (share[0] * x) + self.axes[1] * (share[1] * y)
    }
}

/// Unit vectors along a sole with a yaw on ground with slopes: from heel to toe, and to the left.
fn axes(slope: Vector2<f64>, yaw: f64) -> [Vector3<f64>; 2] {
    let (sin, cos) = yaw.sin_cos();
    let normal = Vector3::new(-slope.x, -slope.y, 1.).normalize();
    let x = Vector3::new(cos, sin, slope.x * cos + slope.y * sin).normalize();
    [x, normal.cross(&x)]
}

/// Slope of the ground under a point.
fn slope(terrain: &Terrain, at: Vector3<f64>) -> Vector2<f64> {
    terrain.ground(at.x, at.y).slope.into()
}

/// Posture of a sole at a time. In a swing, yaw and slope change from those of the stance before to those of the stance after.
pub(crate) fn posture(curves: &FootMotion, terrain: &Terrain, time: f64) -> Posture {
    let centre = curves.motion.at(time).value;
    let (_, phase) = curves.phases(time);
    let yaws = curves.yaws.unwrap_or(&[]);
    let of = |stance: usize| (yaws.get(stance).copied().unwrap_or(0.), slope(terrain, curves.stance_place(stance)));
    if phase % 2 == 0 {
        let (yaw, slope) = of(phase / 2);
        return Posture { centre, axes: axes(slope, yaw) };
    }
    let [start, end] = curves.phase_bounds(phase);
    let blend = turn_done(((time - start) / (end - start)).clamp(0., 1.));
    let ((yaw, level), (next_yaw, next_level)) = (of(phase / 2), of(phase / 2 + 1));
    Posture { centre, axes: axes(level + (next_level - level) * blend, yaw + (next_yaw - yaw) * blend) }
}

/// Amounts by which a wrench exceeds what the corners of a sole can produce, N: centre of pressure outside the sole, as moment per half
/// length or width; and tangential force with torsion outside friction.
fn wrench_excess(sole: &Sole, axes: &[Vector3<f64>; 2], friction: f64, force: &Vector3<f64>, moment: &Vector3<f64>) -> [f64; 2] {
    let [half_length, half_width] = sole.half_extents();
    let normal = axes[0].cross(&axes[1]);
    let push = force.dot(&normal);
    let tangential = force - normal * push;
    let [about_x, about_y, about_normal] = [axes[0], axes[1], normal].map(|axis| moment.dot(&axis));
    let outside = (about_y.abs() / half_length - push).max(about_x.abs() / half_width - push);
    if push <= 0. {
        return [outside, tangential.norm() + moment.norm() / half_width - push];
    }
    // Centre of pressure, within the sole.
    let along = (-about_y / push).clamp(-half_length, half_length);
    let aside = (about_x / push).clamp(-half_width, half_width);
    let torsion = about_normal - (along * tangential.dot(&axes[1]) - aside * tangential.dot(&axes[0]));
    let farthest = (half_length + along.abs()).hypot(half_width + aside.abs());
    let radius = (half_length * half_length + half_width * half_width - along * along - aside * aside) / farthest;
    // A centre of pressure at a corner leaves no torsion.
    let twist = if torsion == 0. { 0. } else { torsion.abs() / radius.max(1e-9) };
    [outside, tangential.norm() + twist - friction * push]
}

/// Largest excess of the wrenches of all soles, N: pressure, friction. See [`wrench_excess`].
pub(super) fn wrenches(motion: &Motion, sole: &Sole, terrain: &Terrain, allowed: f64) -> [Extreme; 2] {
    let mut extremes = [Extreme::default(); 2];
    for (foot, curves) in motion.feet.iter().enumerate() {
        let Some(moment) = &curves.moment else { continue };
        let mut times: Vec<f64> = curves.force.times.iter().chain(&moment.times).copied().collect();
        times.sort_by(f64::total_cmp);
        times.dedup_by(|b, a| *b - *a < SAME_TIME);
        for window in times.windows(2) {
            let middle = (window[0] + window[1]) / 2.;
            let Some(foothold) = curves.foothold(middle) else { continue };
            let yaw = curves.yaw(middle);
            let axes = axes(slope(terrain, foothold), yaw);
            let piece = |curve: &TimedCurve| {
                let piece = curve.piece_around(middle);
                part_of(position(curve.curve, piece), curve.times[piece], curve.length(piece), [window[0], window[1]])
            };
            let mut parts = vec![(piece(&curves.force), piece(moment), window[0], window[1], 0)];
            while let Some((force, torque, start, end, depth)) = parts.pop() {
                let excess: Vec<[f64; 2]> =
                    force.iter().zip(&torque).map(|(f, m)| wrench_excess(sole, &axes, terrain.friction, f, m)).collect();
                // NaN is kept.
                let within = excess.iter().flatten().all(|value| *value <= allowed);
                let ends = [excess[0], excess[3]];
                if within || depth >= DEPTH || ends.iter().flatten().any(|value| value.is_nan() || *value > allowed) {
                    for (i, extreme) in extremes.iter_mut().enumerate() {
                        let all = if within || depth < DEPTH { &[ends[0][i], ends[1][i]][..] } else { &[excess[1][i], excess[2][i]] };
                        all.iter().for_each(|value| extreme.update(*value, Some(foot), (start + end) / 2.));
                    }
                    continue;
                }
                let ((first, last), (turn, next)) = (halves(force), halves(torque));
                let middle = (start + end) / 2.;
                parts.extend([(first, turn, start, middle, depth + 1), (last, next, middle, end, depth + 1)]);
            }
        }
    }
    extremes
}

/// Control points of the part of a cubic between two times.
///
/// * `control` - of the whole cubic, which starts at `start` and lasts `length` s
fn part_of(control: Control<4>, start: f64, length: f64, [from, to]: [f64; 2]) -> Control<4> {
    let [low, high] = [from, to].map(|time| ((time - start) / length).clamp(0., 1.));
    // Blossom of the cubic.
    let blossom = |at: [f64; 3]| {
        let mut points = control.to_vec();
        for t in at {
            points = points.windows(2).map(|pair| pair[0] * (1. - t) + pair[1] * t).collect();
        }
        points[0]
    };
    [[low, low, low], [low, low, high], [low, high, high], [high, high, high]].map(blossom)
}

/// Largest distance of the ground from the plane of a standing sole, at nine points of the sole, m. The first stance is given.
pub(super) fn off_ground(motion: &Motion, sole: &Sole, terrain: &Terrain) -> Extreme {
    let mut extreme = Extreme::default();
    for (foot, curves) in motion.feet.iter().enumerate() {
        for swing in curves.swings().filter(|swing| !curves.lands_later(*swing)) {
            let at = posture(curves, terrain, swing[1] + 2. * SAME_TIME);
            for share in NINE {
                let point = at.point(sole, share);
                extreme.update((terrain.height(point.x, point.y) - point.z).abs(), Some(foot), swing[1]);
            }
        }
    }
    extreme
}

/// Points of a sole, as shares of its half extents: corners, middles of the sides, centre.
const NINE: [[f64; 2]; 9] = [[-1., -1.], [-1., 0.], [-1., 1.], [0., -1.], [0., 0.], [0., 1.], [1., -1.], [1., 0.], [1., 1.]];

/// Largest depth of nine points of a swinging sole in the ground, m; not resolved below `allowed`.
pub(super) fn penetration(motion: &Motion, sole: &Sole, terrain: &Terrain, allowed: f64) -> Extreme {
    let mut extreme = Extreme::default();
    for (foot, curves) in motion.feet.iter().enumerate() {
        for piece in 0..curves.motion.pieces() {
            let [from, to] = [curves.motion.times[piece], curves.motion.times[piece + 1]];
            if curves.foothold((from + to) / 2.).is_some() {
                continue;
            }
            // Largest rate at which a point moves relative to the centre, along any axis.
            let rate = blend_rate(curves, terrain, (from + to) / 2.) * sole.radius();
            for share in NINE {
                let mut parts = vec![(position(curves.motion.curve, piece), from, to, 0)];
                while let Some((part, start, end, depth)) = parts.pop() {
                    let middle = (start + end) / 2.;
                    let at = posture(curves, terrain, middle);
                    let point = at.point(sole, share);
                    let (offset, loose) = (point - at.centre, rate * (end - start) / 2.);
                    let around: [Vector3<f64>; 32] = std::array::from_fn(|i| {
                        let side = |bit: usize| if i >> bit & 1 == 0 { -loose } else { loose };
                        part[i >> 3] + offset + Vector3::new(side(0), side(1), side(2))
                    });
                    let above = depth_bound(terrain, &around);
                    if above <= allowed.max(extreme.value) {
                        continue;
                    }
                    let here = terrain.height(point.x, point.y) - point.z;
                    if depth >= DEPTH || !above.is_finite() || here > allowed {
                        extreme.update(if here > allowed { here } else { above }, Some(foot), middle);
                        continue;
                    }
                    let (first, last) = halves(part);
                    parts.extend([(first, start, middle, depth + 1), (last, middle, end, depth + 1)]);
                }
            }
        }
    }
    extreme
}

/// Largest rate of the axes of a swinging sole at a time in a swing, 1/s: of its yaw and of its slope.
fn blend_rate(curves: &FootMotion, terrain: &Terrain, time: f64) -> f64 {
    let (_, phase) = curves.phases(time);
    let [start, end] = curves.phase_bounds(phase);
    let yaws = curves.yaws.unwrap_or(&[]);
    let (stance, next) = (phase / 2, phase / 2 + 1);
    let turned = yaws.get(next).zip(yaws.get(stance)).map_or(0., |(a, b)| (a - b).abs());
    let tilted = (slope(terrain, curves.stance_place(next)) - slope(terrain, curves.stance_place(stance))).norm();
    (turned + tilted) * FASTEST_BLEND / (end - start)
}

/// Largest difference between the yaw of a standing sole and that of the base, beyond the limit of the sole, rad; not resolved below
/// `allowed`.
pub(super) fn turned(motion: &Motion, sole: &Sole, rate: f64, allowed: f64) -> Extreme {
    let mut extreme = Extreme::default();
    for (foot, curves) in motion.feet.iter().enumerate() {
        let value = |time: f64, yaw: f64| (motion.base_ang.at(time).value.z - yaw).abs() - sole.turn;
        for (stance, yaw) in curves.yaws.unwrap_or(&[]).iter().enumerate() {
            let [start, end] = curves.phase_bounds(2 * stance).map(|time| time.min(motion.horizon));
            largest(&mut extreme, Some(foot), [start, end], rate, allowed, |time| value(time, *yaw));
        }
    }
    extreme
}

/// Largest overlap of two soles, seen from above, m: the least distance by which one must move to clear the other.
pub(super) fn overlap(motion: &Motion, sole: &Sole, terrain: &Terrain, allowed: f64) -> Extreme {
    let mut extreme = Extreme::default();
    let fastest: Vec<f64> = motion
        .feet
        .iter()
        .map(|curves| {
            let speed = foot_speed(curves, 0..curves.motion.pieces(), true, 0.).value;
            let swings = curves.swings().map(|swing| blend_rate(curves, terrain, (swing[0] + swing[1]) / 2.));
            speed + sole.radius() * swings.fold(0., f64::max)
        })
        .collect();
    for (foot, curves) in motion.feet.iter().enumerate() {
        for (other, beside) in motion.feet.iter().enumerate().skip(foot + 1) {
            let rate = fastest[foot] + fastest[other];
            largest(&mut extreme, Some(other), [0., motion.horizon], rate, allowed, |time| {
                let [a, b] = [curves, beside].map(|curves| posture(curves, terrain, time));
                -gap(sole, &a, &b)
            });
        }
    }
    extreme
}

/// Largest separation of two rectangles along the normals of their sides, seen from above, m; negative if they overlap.
fn gap(sole: &Sole, a: &Posture, b: &Posture) -> f64 {
    let [x, y] = sole.half_extents();
    let half =
        |posture: &Posture, axis: Vector2<f64>| posture.axes[0].xy().dot(&axis).abs() * x + posture.axes[1].xy().dot(&axis).abs() * y;
    let apart = (b.centre - a.centre).xy();
    let sides = [a, b].into_iter().flat_map(|posture| posture.axes.map(|axis| axis.xy().normalize()));
    sides.map(|axis| apart.dot(&axis).abs() - half(a, axis) - half(b, axis)).fold(f64::NEG_INFINITY, f64::max)
}

/// Records the maximum of a function of time that changes by at most `rate` per second; not resolved below `allowed`.
fn largest(extreme: &mut Extreme, foot: Option<usize>, span: [f64; 2], rate: f64, allowed: f64, value: impl Fn(f64) -> f64) {
    let mut parts = vec![(span[0], span[1], 0)];
    while let Some((start, end, depth)) = parts.pop() {
        let middle = (start + end) / 2.;
        let here = value(middle);
        let above = here + rate * (end - start) / 2.;
        if above <= allowed.max(extreme.value) {
            continue;
        }
        if here > allowed.max(extreme.value) || !above.is_finite() {
            extreme.update(here, foot, middle);
        }
        if depth >= DEPTH || !above.is_finite() {
            extreme.update(above, foot, middle);
            continue;
        }
        parts.extend([(start, middle, depth + 1), (middle, end, depth + 1)]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrenches_of_corner_forces_inside_their_cones_are_accepted_at_the_centre_and_bounded_at_the_edge() {
        let sole = Sole { length: 0.2, width: 0.08, turn: 0.4 };
        let axes = axes(Vector2::new(0.1, -0.2), 0.7);
        let normal = axes[0].cross(&axes[1]);
        let friction = 0.6;
        let corners = [[1., 1.], [1., -1.], [-1., 1.], [-1., -1.]];
        let mut state = 1_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let [x, y] = sole.half_extents();
        // A wrench that the check accepts is the sum of corner forces: bilinear pressure, parallel friction and rotation about the centre
        // of pressure.
        for _ in 0..2_000 {
            let push = 100. * random();
            let c = [x * (2. * random() - 1.), y * (2. * random() - 1.)];
            let angle = std::f64::consts::TAU * random();
            let (share, sign) = (random(), if random() < 0.5 { -1. } else { 1. });
            let farthest = (x + c[0].abs()).hypot(y + c[1].abs());
            let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
            for corner in corners {
                let at = axes[0] * (corner[0] * x) + axes[1] * (corner[1] * y);
                let p = push / 4. * (1. + corner[0] * c[0] / x) * (1. + corner[1] * c[1] / y);
                let arm = at - axes[0] * c[0] - axes[1] * c[1];
                let parallel = (axes[0] * angle.cos() + axes[1] * angle.sin()) * (friction * share * p);
                let f = normal * p + parallel + normal.cross(&arm) * (sign * friction * (1. - share) * p / farthest);
                assert!((f - normal * p).norm() <= friction * p * (1. + 1e-9));
                force += f;
                moment += at.cross(&f);
            }
            let [pressure, excess] = wrench_excess(&sole, &axes, friction, &force, &moment);
            assert!(pressure < 1e-9 * push && excess < 1e-9 * push, "{pressure} {excess}");
            // The whole of friction is used.
            assert!(excess > -1e-9 * push, "{excess}");
        }
        let up = normal * 50.;
        assert!((wrench_excess(&sole, &axes, friction, &up, &(axes[1] * (50. * x + 1.)))[0] - 1. / x).abs() < 1e-9);
        assert!((wrench_excess(&sole, &axes, friction, &up, &(axes[0] * (50. * y + 1.)))[0] - 1. / y).abs() < 1e-9);
        assert!(wrench_excess(&sole, &axes, friction, &-up, &Vector3::zeros()).iter().all(|excess| *excess > 49.));
    }
}
