//! Flat soles of feet: rectangles on the lower side of the collision shapes of a foot.

use super::model::{Motion, Shape};
use super::tree::Tree;
use nalgebra::{Isometry3, Matrix2, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use std::f64::consts::{FRAC_PI_6, TAU};

/// Largest angle between the normal of a sole and the vertical in the configuration in which soles are searched, rad.
const TILT: f64 = FRAC_PI_6;
/// Height differences of a flat sole, m.
const FLAT: f64 = 5e-4;
/// Smallest length and width of a sole, m.
const SMALLEST: [f64; 2] = [0.02, 0.01];
/// Inclinations to the vertical of the directions in which the lowest points are searched, rad, and their number of azimuths.
const INCLINATIONS: [f64; 4] = [0.02, 0.1, 0.25, 0.5];
const AZIMUTHS: usize = 24;
/// Number of points on the rim of a cylinder.
const RIM: usize = 24;
/// Number of steps between the ends of a sole's polygon.
const STEPS: usize = 40;

/// Sole of a foot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FootSole {
    /// Centre and axes (forward, left, up) of the rectangle, in the frame of the foot's link.
    pub frame: Isometry3<f64>,
    /// Length forward, m.
    pub length: f64,
    /// Width, m.
    pub width: f64,
}

/// Ball: centre and radius, m.
type Ball = (Vector3<f64>, f64);

/// Balls whose convex hull is a shape, a cylinder's up to the number of points on its rim.
fn balls(shape: Shape, at: &Isometry3<f64>) -> Vec<Ball> {
    let signs = [-1., 1.];
    let corner = |x: f64, y: f64, z: f64| Vector3::new(x, y, z);
    let (local, radius) = match shape {
        Shape::Sphere(radius) => (vec![Vector3::zeros()], radius),
        Shape::Capsule(radius, length) => (signs.map(|s| corner(0., 0., s * length / 2.)).to_vec(), radius),
        Shape::Box([x, y, z]) => {
            let sign = |number: usize, axis: usize| if number >> axis & 1 == 0 { -0.5 } else { 0.5 };
            ((0..8).map(|n| corner(sign(n, 0) * x, sign(n, 1) * y, sign(n, 2) * z)).collect(), 0.)
        }
        Shape::Cylinder(radius, length) => {
            let rim = (0..RIM).map(|i| (i as f64 * TAU / RIM as f64).sin_cos());
            (rim.flat_map(|(sin, cos)| signs.map(|s| corner(radius * cos, radius * sin, s * length / 2.))).collect(), 0.)
        }
    };
    local.into_iter().map(|point| (at.rotation * point + at.translation.vector, radius)).collect()
}

/// Sole of a foot: the largest rectangle along x on the lower side of all shapes that move with the link; `None` without a flat side.
pub fn of_foot(tree: &Tree, frames: &[Isometry3<f64>], foot: usize) -> Option<FootSole> {
    let mover = |mut link: usize| {
        while let (Some(joint), Some(parent)) = (tree.above[link], tree.parents[link]) {
            if tree.model.joints[joint].motion != Motion::Fixed {
                break;
            }
            link = parent;
        }
        link
    };
    let end = mover(foot);
    let own = (0..frames.len()).filter(|&link| mover(link) == end);
    let shapes = own.flat_map(|link| tree.model.links[link].collisions.iter().map(move |c| (c.shape, frames[link] * c.origin)));
    let sole = largest(&shapes.flat_map(|(shape, at)| balls(shape, &at)).collect::<Vec<_>>())?;
    Some(FootSole { frame: frames[foot].inverse() * sole.frame, ..sole })
}

/// Largest rectangle along x on the lower side of the convex hull of balls, in their frame.
fn largest(balls: &[Ball]) -> Option<FootSole> {
    let depth = |down: &Vector3<f64>, (centre, radius): &Ball| down.dot(centre) + radius;
    let mut lowest = Vec::new();
    for direction in 0..INCLINATIONS.len() * AZIMUTHS {
        let (tilt, (sin, cos)) = (INCLINATIONS[direction / AZIMUTHS], ((direction % AZIMUTHS) as f64 * TAU / AZIMUTHS as f64).sin_cos());
        let down = Vector3::new(tilt.sin() * cos, tilt.sin() * sin, -tilt.cos());
        let farthest = balls.iter().copied().reduce(|a, b| if depth(&down, &b) > depth(&down, &a) { b } else { a })?;
        if !lowest.contains(&farthest) {
            lowest.push(farthest);
        }
    }
    let down = flat_side(&lowest)?;
    let bottom = balls.iter().map(|ball| depth(&down, ball)).fold(f64::NEG_INFINITY, f64::max);
    let touching = balls.iter().filter(|ball| depth(&down, ball) > bottom - 2. * FLAT).map(|(centre, radius)| centre + down * *radius);
    let touching: Vec<Vector3<f64>> = touching.collect();
    let forward = (Vector3::x() - down * down.x).normalize();
    let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[forward, (-down).cross(&forward), -down]));
    let local: Vec<Vector3<f64>> = touching.iter().map(|point| axes.inverse() * point).collect();
    let (middle, [length, width]) = rectangle(&local.iter().map(|p| p.xy()).collect::<Vec<_>>())?;
    if length < SMALLEST[0] || width < SMALLEST[1] {
        return None;
    }
    let height = local.iter().map(|p| p.z).sum::<f64>() / local.len() as f64;
    let centre = axes * Vector3::new(middle.x, middle.y, height);
    Some(FootSole { frame: Isometry3::from_parts(Translation3::from(centre), UnitQuaternion::from_rotation_matrix(&axes)), length, width })
}

/// Unit normal, outwards, of the plane that touches three balls from below and cuts off no other; of the three farthest apart.
fn flat_side(balls: &[Ball]) -> Option<Vector3<f64>> {
    let mut best: Option<(f64, Vector3<f64>)> = None;
    for i in 0..balls.len() {
        for j in i + 1..balls.len() {
            for k in j + 1..balls.len() {
                let [a, b, c] = [balls[i], balls[j], balls[k]];
                let (ab, ac) = (b.0 - a.0, c.0 - a.0);
                let across = ab.cross(&ac);
                let doubled = across.norm();
                if doubled <= SMALLEST[0] * SMALLEST[1] || best.is_some_and(|(other, _)| other >= doubled) {
                    continue;
                }
                // In the plane of the centres the normal compensates the differences of the radii.
                let gram = Matrix2::new(ab.dot(&ab), ab.dot(&ac), ab.dot(&ac), ac.dot(&ac));
                let Some(shares) = gram.try_inverse().map(|inverse| inverse * Vector2::new(a.1 - b.1, a.1 - c.1)) else { continue };
                let within = ab * shares.x + ac * shares.y;
                let down = within - across * (across.z.signum() / doubled) * (1. - within.norm_squared()).max(0.).sqrt();
                let plane = down.dot(&a.0) + a.1;
                let cuts = balls.iter().any(|(centre, radius)| down.dot(centre) + radius >= plane + FLAT);
                if !cuts && down.z < -TILT.cos() {
                    best = Some((doubled, down.normalize()));
                }
            }
        }
    }
    best.map(|(_, down)| down)
}

/// Rectangle of the largest area along the axes in the convex hull of points: centre, and lengths along x and y.
fn rectangle(points: &[Vector2<f64>]) -> Option<(Vector2<f64>, [f64; 2])> {
    let ends = points.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], p| [low.min(p.x), high.max(p.x)]);
    let step = |i: usize| ends[0] + (ends[1] - ends[0]) * i as f64 / STEPS as f64;
    let mut at: Vec<f64> = points.iter().map(|p| p.x).chain((0..=STEPS).map(step)).collect();
    at.sort_by(f64::total_cmp);
    at.dedup();
    // Side of the hull at each x: the extremes of all segments between two points.
    let sides = at.iter().map(|&x| {
        let mut side = [f64::INFINITY, f64::NEG_INFINITY];
        for p in points {
            for q in points.iter().filter(|q| (p.x..=q.x).contains(&x)) {
                let share = if q.x > p.x { (x - p.x) / (q.x - p.x) } else { 0. };
                let y = (1. - share) * p.y + share * q.y;
                side = [side[0].min(y), side[1].max(y)];
            }
        }
        side
    });
    let sides: Vec<[f64; 2]> = sides.collect();
    let mut best: Option<(f64, Vector2<f64>, [f64; 2])> = None;
    for (i, x) in at.iter().enumerate() {
        for (j, other) in at.iter().enumerate().skip(i + 1) {
            let (bottom, top) = (sides[i][0].max(sides[j][0]), sides[i][1].min(sides[j][1]));
            let area = (other - x) * (top - bottom);
            if top > bottom && best.is_none_or(|(most, ..)| area > most) {
                best = Some((area, Vector2::new((x + other) / 2., (bottom + top) / 2.), [other - x, top - bottom]));
            }
        }
    }
    best.map(|(_, middle, lengths)| (middle, lengths))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64, z: f64) -> Isometry3<f64> {
        Isometry3::translation(x, y, z)
    }

    #[test]
    fn the_lower_side_of_a_box_is_its_sole_even_if_it_is_tilted() {
        let turned = at(0.1, 0.05, -0.3) * UnitQuaternion::from_euler_angles(0., -0.2, 0.);
        let sole = largest(&balls(Shape::Box([0.2, 0.1, 0.04]), &turned)).unwrap();
        assert!((sole.length - 0.2).abs() < 1e-9 && (sole.width - 0.1).abs() < 1e-9, "{sole:?}");
        let below = turned * nalgebra::Point3::new(0., 0., -0.02);
        assert!((sole.frame.translation.vector - below.coords).norm() < 1e-9, "{sole:?}");
        assert!((sole.frame.rotation * Vector3::z() - turned.rotation * Vector3::z()).norm() < 1e-9);
        // 31 degrees off the vertical is no sole.
        assert_eq!(
            largest(&balls(Shape::Box([0.2, 0.1, 0.04]), &(at(0., 0., 0.) * UnitQuaternion::from_euler_angles(0.541, 0., 0.)))),
            None
        );
    }

    #[test]
    fn balls_of_different_radii_and_disks_have_soles_and_a_ball_has_none() {
        // Four balls on the ground, the front ones larger: a trapezium of 0.2 m with sides of 0.08 m at the rear and 0.04 m in front. The
        // largest rectangle over a length l from the rear is as wide as the trapezium at its front end: 0.08 - 0.2 l, area largest at 0.2.
        let sphere = |x: f64, y: f64, radius: f64| balls(Shape::Sphere(radius), &at(x, y, radius));
        let four = [sphere(0., 0.04, 0.01), sphere(0., -0.04, 0.01), sphere(0.2, 0.02, 0.03), sphere(0.2, -0.02, 0.03)].concat();
        let sole = largest(&four).unwrap();
        assert!((sole.length - 0.2).abs() < 1e-9 && (sole.width - 0.04).abs() < 1e-9, "{sole:?}");
        assert!((sole.frame.translation.vector - Vector3::new(0.1, 0., 0.)).norm() < 1e-9);
        // The largest rectangle in a disk of radius 0.1 is the square of 0.2 / sqrt 2; the rim has 24 corners.
        let disk = largest(&balls(Shape::Cylinder(0.1, 0.02), &at(0., 0., 0.01))).unwrap();
        assert!((disk.length * disk.width - 0.02).abs() < 4e-4 && disk.frame.translation.vector.norm() < 1e-3, "{disk:?}");
        assert_eq!(largest(&balls(Shape::Sphere(0.1), &at(0., 0., 0.))), None);
        // Two capsules side by side.
        let capsule = |y: f64| balls(Shape::Capsule(0.02, 0.1), &(at(0., y, 0.) * UnitQuaternion::from_euler_angles(0., TAU / 4., 0.)));
        let two = largest(&[capsule(0.03), capsule(-0.03)].concat()).unwrap();
        assert!((two.length - 0.1).abs() < 1e-9 && (two.width - 0.06).abs() < 1e-9);
        assert!((two.frame.translation.vector.z + 0.02).abs() < 1e-9);
    }
}
