//! Stance and reach of robots that stand on soles. `cregopt.mujoco` uses the same rules and numbers for MuJoCo's models.

use super::body::composite;
use super::faces::{self, Faces, Sides};
use super::feet::{self, Contact};
use super::soles::FootSole;
use super::tree::Tree;
use crate::error::Result;
use crate::robot::FootReach;
use crate::robot::leg::{Leg, PRECISION};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// Distance that joints keep from the ends of their ranges, rad or m; at most a quarter of the range.
const SPARE: f64 = 0.05;
/// Share of the distance to the middle of their ranges by which joints are bent before stances are searched.
const PREBENT: f64 = 0.1;
/// Heights of the centre of mass that are tried, relative to the configuration without given values: first, last, number.
const HEIGHTS: (f64, f64, usize) = (0.75, 1.25, 51);
/// Heights of the centre of mass below the largest one that are tried, as shares of it.
const CROUCHES: [f64; 5] = [0.05, 0.06, 0.07, 0.08, 0.1];
/// Largest yaws of a sole relative to the base, rad: the first with which a walk is possible.
const TURNS: [f64; 6] = [0.3, 0.25, 0.2, 0.15, 0.1, 0.05];
/// Smallest distance between soles, m.
const APART: f64 = 0.02;
/// Largest box that is tried, as shares of the height of the centre of mass: rear, inner, lower side; front, outer, upper side.
const BOX: Sides = [[0.3, 0.15, 0.08], [0.3, 0.25, 0.25]];
/// Shares of the largest box that a walk needs, and its points that it needs, as shares of the sides: a step is long when the foot is at
/// its middle height, and legs that bend one way attain no large box.
const NEEDED: Sides = [[0.57, 0.3, 0.57], [0.57, 0.4, 0.384]];
const POINTS: [[f64; 3]; 3] = [[1., 0.5, 0.], [0.5, 0.5, 1.], [0., 1., 0.5]];
/// Number of bisections of a share.
const HALVINGS: usize = 7;
/// Share of the attained distances that becomes the reach.
const KEPT: f64 = 0.9;
/// Smallest acceptable box, as a share of the needed one.
const SMALLEST: f64 = 0.05;
/// Number of times that the legs follow the centre of mass, which they move, and its displacement, m, that ends this.
const ROUNDS: usize = 50;
const SETTLED: f64 = 1e-7;

/// Configuration in which a robot stands on soles, with its reach.
#[derive(Debug)]
pub struct Upright {
    /// Values of all joints, rad or m.
    pub values: Vec<f64>,
    /// Reach of each foot.
    pub reach: Vec<FootReach>,
    /// Largest yaw of a sole relative to the base, rad.
    pub turn: f64,
}

/// Feet with soles: links, and soles in their frames.
pub type Feet<'a> = &'a [(usize, FootSole)];

/// Contacts of soles in a configuration.
pub fn contacts(frames: &[Isometry3<f64>], soles: Feet) -> Vec<Contact> {
    let contact = |&(link, sole): &(usize, FootSole)| {
        let center = (frames[link] * sole.frame).translation.vector;
        Contact { link, center, radius: 0., touching: 1, sole: Some(sole.frame.rotation) }
    };
    soles.iter().map(contact).collect()
}

/// Stance on bent legs, or the given configuration, and the reach in it. `None` if the soles cannot move there.
///
/// The stance has level soles with yaw 0, side by side below the centre of mass. It is the highest in which the feet attain the box that a
/// walk needs with the largest yaw. The faces of the reach grow from there.
///
/// * `given` - true if the stance is `values`
///
/// # Errors
/// See [`feet::legs`].
pub fn upright(tree: &Tree, values: &[f64], soles: Feet, given: bool) -> Result<Option<Upright>> {
    let stances = if given { vec![(0., values.to_vec())] } else { stances(tree, values, soles)? };
    let tallest = stances.iter().map(|stance| stance.0).fold(0., f64::max);
    let mut best: Option<(Workspace, f64, f64, &[f64])> = None;
    'all: for turn in TURNS {
        for crouch in if given { &CROUCHES[..1] } else { &CROUCHES[..] } {
            let away = |stance: &&(f64, Vec<f64>)| (stance.0 - (1. - crouch) * tallest).abs();
            let Some((_, values)) = stances.iter().min_by(|a, b| away(a).total_cmp(&away(b))) else { return Ok(None) };
            let space = Workspace::new(tree, values, soles)?;
            let share = share(|share| space.attains_needed(share, turn));
            if best.as_ref().is_none_or(|(_, _, most, _)| share > *most) {
                best = Some((space, turn, share, values));
            }
            if share == 1. {
                break 'all;
            }
        }
    }
    let Some((space, turn, share, values)) = best.filter(|(_, _, share, _)| *share >= SMALLEST) else { return Ok(None) };
    let start = faces::around(&space.needed(share), &POINTS);
    let scaled = |share: f64| start.map(|distance| share * distance);
    let attained = |faces: &Faces| space.attains_faces(faces, turn);
    let grown = faces::grow(&faces::around(&space.largest, &[[1.; 3]]), scaled(self::share(|share| attained(&scaled(share)))), attained);
    let reach = space.mirrored.iter().map(|&mirrored| faces::reach(&grown, KEPT, mirrored)).collect();
    Ok(Some(Upright { values: values.to_vec(), reach, turn }))
}

/// Largest share, at most 1, that bisection finds attained.
fn share(attained: impl Fn(f64) -> bool) -> f64 {
    let halve = |[low, high]: [f64; 2], _| {
        let middle = (low + high) / 2.;
        if attained(middle) { [middle, high] } else { [low, middle] }
    };
    if attained(1.) { 1. } else { (0..HALVINGS).fold([0., 1.], halve)[0] }
}

/// Lower and upper side along an axis of a box in the form of [`BOX`], for a foot on the left or, mirrored, on the right.
fn side(sides: &Sides, axis: usize, mirrored: bool) -> [f64; 2] {
    if axis == 1 && mirrored { [-sides[1][axis], sides[0][axis]] } else { [-sides[0][axis], sides[1][axis]] }
}

/// Legs with limits that leave [`SPARE`].
fn spared(mut legs: Vec<Leg>) -> Vec<Leg> {
    for joint in legs.iter_mut().flat_map(|leg| &mut leg.chain) {
        let [lower, upper] = joint.limits;
        let spare = SPARE.min((upper - lower) / 4.);
        joint.limits = [lower + spare, upper - spare];
    }
    legs
}

/// Centre of mass of all links, frame of the root link, m.
fn center_of_mass(tree: &Tree, frames: &[Isometry3<f64>]) -> Vector3<f64> {
    composite((0..frames.len()).filter_map(|link| Some((&frames[link], tree.model.links[link].inertial.as_ref()?)))).center
}

/// Values of all joints with those of the legs replaced.
///
/// # Errors
/// See [`Tree::follow`].
fn with_joints(tree: &Tree, values: &[f64], legs: &[Leg], joints: &[Vec<f64>]) -> Result<Vec<f64>> {
    let mut all = values.to_vec();
    for (joint, value) in legs.iter().zip(joints).flat_map(|(leg, q)| leg.chain.iter().zip(q)) {
        if let Some(j) = tree.model.joints.iter().position(|other| other.name == joint.name) {
            all[j] = *value;
        }
    }
    tree.follow(&mut all).map(|()| all)
}

/// Heights of the centre of mass above level soles, m, and values of all joints: stances with bent knees.
fn stances(tree: &Tree, values: &[f64], soles: Feet) -> Result<Vec<(f64, Vec<f64>)>> {
    let frames = tree.frames(values);
    let contacts = contacts(&frames, soles);
    let legs = spared(feet::legs(tree, &frames, values, &Vector3::zeros(), &contacts)?);
    let mean = contacts.iter().map(|contact| contact.center).sum::<Vector3<f64>>() / contacts.len() as f64;
    let height = center_of_mass(tree, &frames).z - mean.z;
    // A stretched knee bends towards the middle of its range.
    let bent = |leg: &Leg| {
        let towards = |joint: &crate::robot::leg::LegJoint| {
            let middle = (joint.limits[0] + joint.limits[1]) / 2.;
            if middle.is_finite() { joint.nominal + PREBENT * (middle - joint.nominal) } else { joint.nominal }
        };
        leg.chain.iter().map(towards).collect::<Vec<f64>>()
    };
    let mut joints: Vec<Vec<f64>> = legs.iter().map(bent).collect();
    let with = |joints: &[Vec<f64>]| with_joints(tree, values, &legs, joints);
    let mut found = Vec::new();
    let (first, last, count) = HEIGHTS;
    for i in 0..count {
        let wanted = height * (first + (last - first) * i as f64 / (count - 1) as f64);
        let mut trial = joints.clone();
        let mut center = center_of_mass(tree, &tree.frames(&with(&trial)?));
        for _ in 0..ROUNDS {
            let mut missed: f64 = 0.;
            for ((leg, q), contact) in legs.iter().zip(&mut trial).zip(&contacts) {
                let place = center + Vector3::new(0., contact.center.y - mean.y, -wanted);
                let (reached, left) = leg.approach_sole(&Isometry3::from_parts(place.into(), UnitQuaternion::identity()), q);
                (*q, missed) = (reached, missed.max(left));
            }
            let all = with(&trial)?;
            let moved = center_of_mass(tree, &tree.frames(&all));
            let settled = (moved - center).norm() < SETTLED;
            center = moved;
            if settled {
                if missed <= PRECISION {
                    found.push((wanted, all));
                    joints = trial;
                }
                break;
            }
        }
    }
    Ok(found)
}

/// Robot in a stance. Boxes have the form of [`BOX`], in m.
struct Workspace<'a> {
    tree: &'a Tree<'a>,
    values: &'a [f64],
    /// Legs from the centre of mass.
    legs: Vec<Leg>,
    /// Centre of mass, frame of the root link, m.
    center: Vector3<f64>,
    /// True for the feet on the right.
    mirrored: Vec<bool>,
    largest: Sides,
}

impl<'a> Workspace<'a> {
    fn new(tree: &'a Tree, values: &'a [f64], soles: Feet) -> Result<Workspace<'a>> {
        let frames = tree.frames(values);
        let (center, contacts) = (center_of_mass(tree, &frames), contacts(&frames, soles));
        let legs = spared(feet::legs(tree, &frames, values, &center, &contacts)?);
        let places: Vec<Vector3<f64>> = contacts.iter().map(|contact| contact.center - center).collect();
        let height = -places.iter().map(|place| place.z).sum::<f64>() / places.len() as f64;
        let apart = |a: &Vector3<f64>, b: &Vector3<f64>| if a.y * b.y < 0. { (a.y - b.y).abs() } else { f64::INFINITY };
        let gap = places.iter().flat_map(|a| places.iter().map(move |b| apart(a, b))).fold(f64::INFINITY, f64::min);
        let width = soles.iter().map(|(_, sole)| sole.width).fold(f64::INFINITY, f64::min);
        let mut largest = BOX.map(|end| end.map(|share| share * height));
        largest[0][1] = largest[0][1].min(((gap - width - APART) / 2.).max(0.));
        Ok(Workspace { tree, values, legs, center, mirrored: places.iter().map(|place| place.y < 0.).collect(), largest })
    }

    /// Share of the box that a walk needs.
    fn needed(&self, share: f64) -> Sides {
        std::array::from_fn(|end| std::array::from_fn(|axis| share * NEEDED[end][axis] * self.largest[end][axis]))
    }

    /// True if the feet attain the points of a share of the box that a walk needs.
    fn attains_needed(&self, share: f64, turn: f64) -> bool {
        let signs = (0..8).map(|number| [0, 1, 2].map(|axis| if number >> axis & 1 == 0 { -1. } else { 1. }));
        let points = signs.flat_map(|signs| POINTS.map(|point| std::array::from_fn(|axis| signs[axis] * point[axis])));
        self.attains(&self.needed(share), points, turn)
    }

    /// True if the feet attain the points of faces.
    fn attains_faces(&self, faces: &Faces, turn: f64) -> bool {
        // The points are in m, but for y.
        let sides = [[1., faces[9], 1.], [1., faces[8], 1.]];
        self.attains(&sides, faces::points(faces).into_iter(), turn)
    }

    /// True if the feet attain points of a box with level soles that are turned by `turn`, rad, either way, all feet at once, with a level
    /// base and the centre of mass at its place.
    fn attains(&self, sides: &Sides, mut points: impl Iterator<Item = [f64; 3]>, turn: f64) -> bool {
        points.all(|point| [-turn, turn].iter().all(|&yaw| self.attains_point(sides, &point, yaw)))
    }

    /// True if the feet attain a point of a box: coordinates along the axes, from -1 at the low sides to 1 at the high ones.
    fn attains_point(&self, sides: &Sides, point: &[f64; 3], yaw: f64) -> bool {
        let level = UnitQuaternion::from_euler_angles(0., 0., yaw);
        let mut joints: Vec<Vec<f64>> = self.legs.iter().map(Leg::nominal).collect();
        let places: Vec<Vector3<f64>> = (self.legs.iter().zip(&self.mirrored))
            .map(|(leg, &mirrored)| {
                let at = |axis: usize| {
                    let [low, high] = side(sides, axis, mirrored);
                    if point[axis] > 0. { point[axis] * high } else { -point[axis] * low }
                };
                leg.posture(&leg.nominal()).tip + Vector3::new(at(0), at(1), at(2))
            })
            .collect();
        // The legs move the centre of mass in the base, and the base gives way.
        let mut given = Vector3::zeros();
        for _ in 0..ROUNDS {
            let mut missed: f64 = 0.;
            for ((leg, q), place) in self.legs.iter().zip(&mut joints).zip(&places) {
                let (reached, left) = leg.approach_sole(&Isometry3::from_parts((place - given).into(), level), q);
                (*q, missed) = (reached, missed.max(left));
            }
            let Ok(all) = with_joints(self.tree, self.values, &self.legs, &joints) else { return false };
            let off = center_of_mass(self.tree, &self.tree.frames(&all)) - self.center + given;
            if off.norm() < PRECISION {
                return missed <= PRECISION;
            }
            given -= off;
        }
        false
    }
}
