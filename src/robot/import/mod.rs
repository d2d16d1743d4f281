//! Robots from URDF files: mass, inertia, feet, reach and forces of a [`Robot`], computed from links and joints.
//!
//! All numbers hold in one configuration of the joints, in which the links form one rigid body. The base frame of the robot has the axes of
//! the root link and its origin in the centre of mass.

mod body;
mod feet;
mod reach;
mod stance;
#[cfg(test)]
mod tests;
mod tree;
pub mod urdf;

pub use urdf::MAX_URDF;

use super::leg::Leg;
use super::{FORCE_LIMIT_WEIGHTS, MAX_FEET, Reach, Robot};
use crate::error::{Error, Result, check_range};
use crate::files;
use feet::Contact;
use nalgebra::Vector3;
use std::path::Path;
use tree::Tree;

/// Options of an import: information that a URDF file does not contain.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Import {
    /// Links of the feet. If empty, the links that are on the ground in the configuration.
    pub feet: Vec<String>,
    /// Values of joints by name, rad or m. The others are at zero, or in the middle of their limits if zero is outside.
    pub configuration: Vec<(String, f64)>,
    /// Name of the robot. Default: the name in the file.
    pub name: Option<String>,
}

/// An imported robot, and information for the user.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// Robot for the solver.
    pub robot: Robot,
    /// Feet, in the order of the robot's.
    pub feet: Vec<Foot>,
    /// Speed along x and y that every foot can reach at its joint speed limits in the configuration, m/s. `None` if no joint has a speed
    /// limit, or a foot cannot move along one of the axes.
    pub foot_speed: Option<f64>,
    /// Centre of mass in the frame of the root link, m.
    pub center_of_mass: [f64; 3],
    /// Value of every joint that moves, rad or m.
    pub configuration: Vec<(String, f64)>,
    /// Notes for the user: everything guessed, left out or unusual.
    pub notes: Vec<String>,
}

/// An imported foot.
#[derive(Debug, Clone, PartialEq)]
pub struct Foot {
    /// Link of the foot.
    pub link: String,
    /// Origin of the link's frame relative to the centre of mass, m. The contact point is in [`Robot::nominal_feet`].
    pub frame: [f64; 3],
}

impl Import {
    /// Computes a robot from the text of a URDF file.
    ///
    /// * mass, inertia, centre of mass: of all links as one rigid body
    /// * nominal feet: the lowest point of the collision shapes of each foot's link, spheres before other shapes; the origin of the link's
    ///   frame if it has only meshes
    /// * reach: for each foot the largest box that its joints reach within their limits, see `import/reach.rs`
    /// * force limit: vertical force that the joint efforts can bear at the weakest foot, at most [`FORCE_LIMIT_WEIGHTS`] weights
    /// * joints: the joints of each foot's leg
    /// * name: the given one, or the file's. `-imported` is appended if a different built-in robot has that name
    /// * leg mass: `sum m_i (d_i / l)^2` over the links that a leg moves, with the distances `d_i` of their centres of mass and `l` of the
    ///   foot from the leg's first joint; the mean of all legs
    ///
    /// # Errors
    /// [`Error::Format`] for text that is not XML, [`Error::Invalid`] for a model that is not a legged robot. Each names the place.
    pub fn urdf(&self, text: &str) -> Result<Imported> {
        let model = urdf::parse(text)?;
        let tree = Tree::new(&model)?;
        let (values, stands) = self.values(&model, &tree)?;
        let frames = tree.frames(&values);
        let weighed = |link: usize| model.links[link].inertial.as_ref().map(|inertial| (&frames[link], inertial));
        let body = body::composite((0..model.links.len()).filter_map(weighed));
        if body.mass <= 0. {
            let with = model.links.iter().filter(|link| link.inertial.is_some()).count();
            let value = format!("0 kg: {with} of {} links have <inertial>", model.links.len());
            return Err(Error::invalid("mass of all links", value, "positive"));
        }
        let center = body.center;
        let links = if self.feet.is_empty() { feet::find(&tree, &frames, &center)? } else { self.named_feet(&tree)? };
        let contacts: Vec<Contact> = links.iter().map(|&link| feet::contact(&tree, &frames, link)).collect();
        let legs = feet::legs(&tree, &frames, &values, &center, &contacts)?;
        let nominal_feet: Vec<[f64; 3]> = contacts.iter().map(|contact| (contact.point() - center).into()).collect();
        let base_height = nominal_feet.iter().map(|foot| -foot[2]).fold(f64::NEG_INFINITY, f64::max);
        if base_height <= 0. {
            let limit = "above: give a --configuration in which it stands";
            return Err(Error::invalid("centre of mass above the lowest foot", format!("{base_height:.4} m"), limit));
        }
        let reach = legs.iter().enumerate().map(|(foot, leg)| reach::grow(leg, &reach::room(leg, foot, &nominal_feet)));
        let leg_masses = legs.iter().map(|leg| leg_mass(leg, feet::moved_by(&tree, leg).into_iter().filter_map(weighed), &center));
        let mut robot = Robot {
            name: self.name.clone().unwrap_or_else(|| model.name.clone()),
            mass: body.mass,
            inertia: std::array::from_fn(|r| std::array::from_fn(|c| body.inertia[(r, c)])),
            base_height,
            reach: Reach::PerFoot(reach.collect::<Result<_>>()?),
            force_limit: None,
            leg_mass: Some(leg_masses.sum::<f64>() / legs.len() as f64),
            nominal_feet,
            joints: None,
            foot_radius: contacts.iter().map(|c| (c.radius > 0.).then_some(c.radius)).reduce(least).flatten(),
            sole: None,
        };
        let vertical = legs.iter().map(|leg| leg.vertical_force(&leg.posture(&leg.nominal()))).fold(f64::INFINITY, f64::min);
        robot.force_limit = vertical.is_finite().then(|| vertical.min(FORCE_LIMIT_WEIGHTS * robot.weight()));
        if robot.name.is_empty() {
            robot.name = "robot".into();
        }
        let speeds = legs.iter().map(|leg| leg.horizontal_speed(&leg.posture(&leg.nominal())));
        let slowest = speeds.collect::<Option<Vec<f64>>>().map(|speeds| speeds.into_iter().fold(f64::INFINITY, f64::min));
        robot.joints = Some(legs);
        let mut notes = self.notes(&tree, &robot, &contacts, vertical, stands);
        if let Some(what) = robot.differs_from_named().filter(|_| self.name.is_none()) {
            let own = format!("{}-imported", robot.name);
            notes.push(format!("the built-in robot `{}` has another {what}; this one is called `{own}`", robot.name));
            robot.name = own;
        }
        robot.validate_own()?;
        let moving = model.joints.iter().zip(&values).filter(|(joint, _)| joint.motion != urdf::Motion::Fixed);
        Ok(Imported {
            feet: contacts.iter().map(|contact| foot(&tree, &frames[contact.link].translation.vector, contact, &center)).collect(),
            foot_speed: slowest.filter(|speed| speed.is_finite()),
            center_of_mass: center.into(),
            configuration: moving.map(|(joint, &value)| (joint.name.clone(), value)).collect(),
            notes,
            robot,
        })
    }

    /// Computes a robot from a URDF file.
    ///
    /// # Errors
    /// See [`Import::urdf`], with the file's name; also for a file that cannot be read or is larger than [`MAX_URDF`].
    pub fn urdf_file(&self, path: &Path) -> Result<Imported> {
        let text = files::read_at_most(path, MAX_URDF as u64)?;
        self.urdf(&text).map_err(|e| e.in_file(path, None))
    }

    /// Values of all joints, and true if they were chosen here: without a given configuration the robot stands on bent legs if it can.
    fn values(&self, model: &urdf::Model, tree: &Tree) -> Result<(Vec<f64>, bool)> {
        let mut values = tree.configuration(&self.configuration)?;
        if !self.configuration.is_empty() {
            return Ok((values, false));
        }
        let frames = tree.frames(&values);
        let center =
            body::composite((0..model.links.len()).filter_map(|link| Some((&frames[link], model.links[link].inertial.as_ref()?)))).center;
        let links = if self.feet.is_empty() { feet::find(tree, &frames, &center) } else { self.named_feet(tree) };
        let legs = links.and_then(|links| {
            let contacts: Vec<Contact> = links.iter().map(|&link| feet::contact(tree, &frames, link)).collect();
            feet::legs(tree, &frames, &values, &center, &contacts)
        });
        // Errors in the legs are reported later, where the legs are required.
        let Some((legs, standing)) = legs.ok().and_then(|legs| stance::standing(&legs).map(|q| (legs, q))) else {
            return Ok((values, false));
        };
        for (leg, q) in legs.iter().zip(standing) {
            for (joint, value) in leg.chain.iter().zip(q) {
                if let Some(j) = model.joints.iter().position(|other| other.name == joint.name) {
                    values[j] = value;
                }
            }
        }
        tree.follow(&mut values)?;
        Ok((values, true))
    }

    fn named_feet(&self, tree: &Tree) -> Result<Vec<usize>> {
        if self.feet.len() > MAX_FEET {
            return Err(Error::invalid("feet", format!("{} named", self.feet.len()), format!("at most {MAX_FEET}")));
        }
        let mut links = Vec::new();
        for name in &self.feet {
            let link = tree.link("feet", name)?;
            if links.contains(&link) {
                return Err(Error::invalid("feet", format!("`{}`", name.escape_debug()), "named once"));
            }
            links.push(link);
        }
        Ok(links)
    }

    /// Notes for the user: everything guessed, left out or unusual.
    fn notes(&self, tree: &Tree, robot: &Robot, contacts: &[Contact], vertical: f64, stands: bool) -> Vec<String> {
        let mut notes = Vec::new();
        if stands {
            notes.push("no configuration was given: legs are bent so that the robot stands".into());
        }
        let name = |contact: &Contact| format!("`{}`", tree.model.links[contact.link].name.escape_debug());
        let names = |of: &dyn Fn(&&Contact) -> bool| contacts.iter().filter(of).map(name).collect::<Vec<_>>().join(", ");
        if self.feet.is_empty() {
            notes.push(format!("feet were not named; lowest in the configuration are {}", names(&|_| true)));
        }
        let (flat, bare) = (names(&|c| c.touching > 1 || c.touching == 1 && c.radius == 0.), names(&|c| c.touching == 0));
        if !flat.is_empty() {
            notes.push(format!("flat feet are modelled as points, at the part of the sole below the ankle: {flat}"));
        }
        if !bare.is_empty() {
            notes.push(format!("feet without collision shapes other than meshes touch the ground at the origin of their frames: {bare}"));
        }
        if vertical.is_infinite() {
            notes.push("no joint's effort limits the forces of feet; the robot's weight and number of feet do".into());
        } else if vertical > FORCE_LIMIT_WEIGHTS * robot.weight() {
            notes.push(format!("the joints bear {vertical:.0} N at a foot; the force limit is {FORCE_LIMIT_WEIGHTS} weights"));
        }
        let ground = robot.nominal_feet.iter().map(|foot| foot[2]);
        let uneven = ground.clone().fold(f64::NEG_INFINITY, f64::max) - ground.fold(f64::INFINITY, f64::min);
        if uneven > 1e-3 {
            notes.push(format!("in the configuration the highest foot is {uneven:.3} m above the lowest"));
        }
        if let Some(outside) = out_of_support(&robot.nominal_feet).filter(|&outside| outside > 0.) {
            notes.push(format!(
                "in the configuration the centre of mass is {outside:.3} m outside the feet: it would tip over; give another configuration"
            ));
        }
        notes
    }
}

/// The smaller of two radii; `None` if one is missing.
fn least(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    a.zip(b).map(|(a, b)| a.min(b))
}

fn foot(tree: &Tree, frame: &Vector3<f64>, contact: &Contact, center: &Vector3<f64>) -> Foot {
    Foot { link: tree.model.links[contact.link].name.clone(), frame: (frame - center).into() }
}

/// Point mass at the foot with the same moment of inertia about the leg's first joint as the links (taken as points), kg. At most the mass
/// of the leg.
fn leg_mass<'a>(leg: &Leg, links: impl Iterator<Item = (&'a nalgebra::Isometry3<f64>, &'a urdf::Inertial)>, center: &Vector3<f64>) -> f64 {
    let at = leg.posture(&leg.nominal());
    let length = (at.tip - at.anchors[0]).norm();
    let (mut moment, mut mass) = (0., 0.);
    for (frame, part) in links {
        let from_hip = (frame * part.origin).translation.vector - center - at.anchors[0];
        moment += part.mass * from_hip.norm_squared();
        mass += part.mass;
    }
    if moment < mass * length * length { moment / (length * length) } else { mass }
}

/// Horizontal distance of the origin from the convex hull of the feet, m, negative inside; `None` for fewer than three feet.
fn out_of_support(feet: &[[f64; 3]]) -> Option<f64> {
    if feet.len() < 3 {
        return None;
    }
    // Largest signed distance of the origin from any edge line of the hull.
    let mut outside = f64::NEG_INFINITY;
    for a in feet {
        for b in feet {
            let (along, length) = ([b[0] - a[0], b[1] - a[1]], (b[0] - a[0]).hypot(b[1] - a[1]));
            let beyond = |p: &[f64; 3]| ((p[0] - a[0]) * along[1] - (p[1] - a[1]) * along[0]) / length;
            if length > 0. && feet.iter().all(|p| beyond(p) <= 1e-12) {
                outside = outside.max(beyond(&[0.; 3]));
            }
        }
    }
    outside.is_finite().then_some(outside)
}

/// Parses `joint=value,...`, values in rad or m.
///
/// # Errors
/// [`Error::Invalid`] names the part that is not such a pair.
pub fn configuration(text: &str) -> Result<Vec<(String, f64)>> {
    let pair = |part: &str| {
        let wrong = || Error::invalid("configuration", format!("`{}`", part.escape_debug()), "JOINT=VALUE, in rad or m");
        let (joint, value) = part.split_once('=').ok_or_else(wrong)?;
        let value: f64 = value.trim().parse().map_err(|_| wrong())?;
        check_range(&format!("configuration, joint `{}`", joint.trim().escape_debug()), value, -1e3, 1e3)?;
        Ok((joint.trim().into(), value))
    };
    text.split(',').filter(|part| !part.trim().is_empty()).map(pair).collect()
}
