//! Box about its nominal position that a leg reaches.

use crate::error::{Error, Result};
use crate::robot::leg::Leg;
use nalgebra::Vector3;

/// Largest distance of a side from the nominal position along x, y and z, in leg lengths. A step forward needs more room than a step to the
/// side.
const FARTHEST: [f64; 3] = [0.5, 0.3, 0.3];
/// First growth step relative to the largest distance. All sides grow in the same way.
const FIRST_STEP: f64 = 0.125;
/// Number of times that the step is halved before a side stops growing.
const HALVINGS: usize = 4;
/// Number of grid points along each edge of a face or box.
const GRID: usize = 5;
/// Narrowest box that a robot may have, m.
const NARROWEST: f64 = 2e-3;

/// Lower and upper sides along x, y and z about the nominal position, m.
pub type Sides = [[f64; 2]; 3];

/// Grows the six sides of the box in turn, the outward ones first. A side grows by its step if every point of a grid on its new face can be
/// reached; otherwise its step is halved.
///
/// The inverse kinematics of a point starts from the joints of the nearest point reached before, so the whole box is reached on one branch
/// without a jump. At the end a grid over the whole box is checked.
///
/// * `room` - largest extent of the sides, m, from [`room`]
///
/// # Errors
/// [`Error::Invalid`] if the leg cannot move along an axis.
pub fn grow(leg: &Leg, room: &Sides) -> Result<Sides> {
    let nominal = leg.nominal();
    let start = leg.posture(&nominal).tip;
    let mut reached = Reached { leg, start, known: vec![(start, nominal)] };
    let (mut sides, mut halvings) = ([[0.; 2]; 3], [[0; 2]; 3]);
    while halvings.iter().flatten().any(|&h| h <= HALVINGS) {
        for side in 0..6 {
            // Outward sides first, so that mirrored legs get mirrored boxes.
            let axis = side % 3;
            let end = usize::from((start[axis] > 0.) == (side < 3));
            let limit = room[axis][end];
            if halvings[axis][end] > HALVINGS {
                continue;
            }
            let step = FIRST_STEP * FARTHEST[axis] * leg.length() / (1 << halvings[axis][end]) as f64;
            let mut grown = sides;
            grown[axis][end] = if end == 0 { (sides[axis][0] - step).max(limit) } else { (sides[axis][1] + step).min(limit) };
            if grown != sides && reached.all(face(&grown, axis, end)) {
                sides = grown;
            } else {
                halvings[axis][end] += 1;
            }
        }
    }
    // Points between the faces were reached when the faces passed them. A hole that the faces jumped over is detected here.
    while !reached.all(grid(&sides)) {
        sides.iter_mut().flatten().for_each(|v| *v *= 0.9);
        if sides.iter().all(|[low, high]| high - low < NARROWEST) {
            break;
        }
    }
    let sides = sides.map(|side| side.map(|v| (v * 1e4).trunc() / 1e4));
    for (axis, [low, high]) in sides.into_iter().enumerate() {
        if high - low < NARROWEST {
            let (place, count) = (format!("foot `{}`", leg.foot.escape_debug()), leg.chain.len());
            let value = format!("reaches {:.4} m along {} with {count} joints", high - low, ["x", "y", "z"][axis]);
            let limit = format!("at least {NARROWEST} m: a leg needs three joints, and a --configuration in which it is bent");
            return Err(Error::invalid(place, value, limit));
        }
    }
    Ok(sides)
}

/// Largest extent of the sides: no side goes beyond the middle between two feet, less the foot radius, or beyond [`FARTHEST`].
///
/// * `feet` - nominal positions of all feet, base frame, m
pub fn room(leg: &Leg, foot: usize, feet: &[[f64; 3]]) -> Sides {
    let mut room = FARTHEST.map(|farthest| [-farthest * leg.length(), farthest * leg.length()]);
    for other in (0..feet.len()).filter(|&other| other != foot) {
        let apart = [0, 1].map(|axis| feet[other][axis] - feet[foot][axis]);
        let axis = if apart[0].abs() > apart[1].abs() { 0 } else { 1 };
        let middle = (apart[axis].abs() / 2. - leg.radius).max(0.);
        let end = if apart[axis] > 0. { 1 } else { 0 };
        room[axis][end] = if end == 0 { room[axis][0].max(-middle) } else { room[axis][1].min(middle) };
    }
    room
}

/// Positions that the leg has reached, with the joint values.
struct Reached<'a> {
    leg: &'a Leg,
    start: Vector3<f64>,
    known: Vec<(Vector3<f64>, Vec<f64>)>,
}

impl Reached<'_> {
    /// True if all these positions relative to the nominal one can be reached.
    fn all(&mut self, places: impl Iterator<Item = Vector3<f64>>) -> bool {
        places.into_iter().all(|place| self.one(self.start + place))
    }

    fn one(&mut self, place: Vector3<f64>) -> bool {
        let distance = |known: &(Vector3<f64>, Vec<f64>)| (known.0 - place).norm_squared();
        let Some(nearest) = self.known.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))) else { return false };
        if nearest.0 == place {
            return true;
        }
        let Some(joints) = self.leg.reach(&place, &nearest.1) else { return false };
        self.known.push((place, joints));
        true
    }
}

/// Grid points along an edge, including its ends.
fn along([low, high]: [f64; 2]) -> impl Iterator<Item = f64> + Clone {
    (0..GRID).map(move |i| low + (high - low) * i as f64 / (GRID - 1) as f64)
}

fn grid(&[x, y, z]: &Sides) -> impl Iterator<Item = Vector3<f64>> + use<> {
    along(x).flat_map(move |x| along(y).flat_map(move |y| along(z).map(move |z| Vector3::new(x, y, z))))
}

/// Grid points of a face.
fn face(sides: &Sides, axis: usize, end: usize) -> impl Iterator<Item = Vector3<f64>> + use<> {
    let at = sides[axis][end];
    let across = *sides;
    let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
    along(across[u]).flat_map(move |a| {
        along(across[v]).map(move |b| {
            let mut place = Vector3::from_element(at);
            (place[u], place[v]) = (a, b);
            place
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::leg::LegJoint;
    use nalgebra::{Isometry3, Unit};

    /// A carriage with prismatic joints along x, y and z. Its box equals its limits.
    fn carriage(limits: [[f64; 2]; 3]) -> Leg {
        let joint = |axis: usize| LegJoint {
            name: format!("slide {axis}"),
            turns: false,
            origin: Isometry3::identity(),
            axis: Unit::new_normalize(Vector3::ith(axis, 1.)),
            limits: limits[axis],
            velocity: None,
            effort: None,
            nominal: 0.,
        };
        Leg { foot: "foot".into(), tip: [0., 0., -1.], radius: 0.05, sole: None, chain: (0..3).map(joint).collect() }
    }

    #[test]
    fn the_box_of_a_carriage_equals_its_limits() {
        let rails = [[-0.2, 0.4], [-0.05, 0.1], [-0.01, 0.25]];
        let leg = carriage(rails);
        let sides = grow(&leg, &room(&leg, 0, &[[0., 0., -1.]])).unwrap();
        let finest = FIRST_STEP * FARTHEST[0] / (1 << HALVINGS) as f64;
        for (side, rail) in sides.iter().flatten().zip(rails.iter().flatten()) {
            assert!(side.abs() <= rail.abs() && side.abs() > rail.abs() - finest - 1e-4, "{sides:?}");
        }
        assert_eq!(grow(&leg, &room(&leg, 0, &[[0., 0., -1.]])).unwrap(), sides);
    }

    #[test]
    fn boxes_end_midway_between_feet_and_at_the_largest_distance() {
        let leg = carriage([[-9., 9.]; 3]);
        let feet = [[0.3, 0.2, -1.], [0.3, -0.2, -1.], [-0.3, 0.2, -1.]];
        let expected = [[-0.25, 0.5], [-0.15, 0.3], [-0.3, 0.3]];
        let sides = room(&leg, 0, &feet);
        assert!(sides.iter().flatten().zip(expected.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-12), "{sides:?}");
        assert!(grow(&leg, &sides).unwrap().iter().flatten().zip(sides.iter().flatten()).all(|(a, b)| (a - b).abs() <= 1e-4));
    }

    #[test]
    fn a_leg_that_cannot_move_along_an_axis_is_refused() {
        let leg = carriage([[-0.2, 0.2], [0., 0.], [-0.2, 0.2]]);
        let error = grow(&leg, &room(&leg, 0, &[[0., 0., -1.]])).unwrap_err().to_string();
        assert!(error.contains("foot `foot`") && error.contains("along y") && error.contains("0.002"), "{error}");
    }
}
