//! Robots from URDF and MJCF files: mass, inertia, feet, reach and forces of a [`Robot`], computed from links and joints.
//!
//! All numbers hold in one configuration of the joints, in which the links form one rigid body. The base frame of the robot has the axes of
//! the root link and its origin in the centre of mass.

mod body;
mod faces;
mod feet;
mod mjcf;
mod model;
mod reach;
mod soles;
mod stance;
#[cfg(test)]
mod tests;
mod tree;
mod upright;
mod urdf;
mod xml;

pub use xml::MAX_FILE;

use super::leg::{Leg, SOLE_JOINTS};
use super::{FORCE_LIMIT_WEIGHTS, FootReach, MAX_FEET, Reach, Robot, Sole};
use crate::error::{Error, Result, check_range};
use crate::files;
use body::Body;
use feet::Contact;
use model::{Inertial, Model, Motion};
use nalgebra::{Isometry3, Vector3};
use soles::FootSole;
use std::path::Path;
use tree::Tree;

/// Options of an import: information that the file of a robot does not contain.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Import {
    /// Links of the feet. If empty, the links that are on the ground in the configuration.
    pub feet: Vec<String>,
    /// Values of joints by name, rad or m. The others are at zero, or in the middle of their limits if zero is outside.
    pub configuration: Vec<(String, f64)>,
    /// Name of the robot. Default: the name in the file.
    pub name: Option<String>,
    /// Soles of the feet.
    pub soles: Soles,
}

/// Soles of the feet of an imported robot.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub enum Soles {
    /// Flat lower sides of the collision shapes. Feet without them, and legs that cannot hold them level, end in points or balls.
    #[default]
    Found,
    /// Length and width, m. The centre is that of the flat lower side, or else the contact point; the sole is level in the configuration.
    Size([f64; 2]),
    /// Feet are points or balls.
    Absent,
}

impl std::str::FromStr for Soles {
    type Err = Error;

    /// Parses `auto`, `none` or `LENGTH,WIDTH`, m.
    fn from_str(text: &str) -> Result<Soles> {
        let wrong = || Error::invalid("sole", format!("`{}`", text.escape_debug()), "auto, none or LENGTH,WIDTH in m");
        match text.trim() {
            "auto" => Ok(Soles::Found),
            "none" => Ok(Soles::Absent),
            size => {
                let (length, width) = size.split_once(',').ok_or_else(wrong)?;
                let number = |text: &str| text.trim().parse::<f64>().map_err(|_| wrong());
                Ok(Soles::Size([number(length)?, number(width)?]))
            }
        }
    }
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

/// Robot in the configuration in which it stands.
struct Posed {
    values: Vec<f64>,
    frames: Vec<Isometry3<f64>>,
    body: Body,
    contacts: Vec<Contact>,
    legs: Vec<Leg>,
    /// Box of each foot.
    reach: Vec<FootReach>,
    sole: Option<Sole>,
    notes: Vec<String>,
}

impl Posed {
    /// Pose without boxes.
    fn new(tree: &Tree, values: Vec<f64>, contacts: impl FnOnce(&[Isometry3<f64>], &Body) -> Result<Vec<Contact>>) -> Result<Posed> {
        let frames = tree.frames(&values);
        let body = whole(tree, &frames);
        let contacts = contacts(&frames, &body)?;
        let legs = feet::legs(tree, &frames, &values, &body.center, &contacts)?;
        Ok(Posed { values, frames, body, contacts, legs, reach: vec![], sole: None, notes: vec![] })
    }
}

/// All links of a robot as one body.
fn whole(tree: &Tree, frames: &[Isometry3<f64>]) -> Body {
    body::composite((0..frames.len()).filter_map(|link| Some((&frames[link], tree.model.links[link].inertial.as_ref()?))))
}

impl Import {
    /// Computes a robot from the text of a URDF file.
    ///
    /// * mass, inertia, centre of mass: of all links as one rigid body
    /// * soles: the largest rectangle on the lower side of the collision shapes of each foot, for legs with at least six joints, see
    ///   `import/soles.rs`; its centre is the nominal foot. Without a given configuration the robot stands on bent knees, see
    ///   `import/upright.rs`
    /// * nominal feet without soles: the lowest point of the collision shapes of each foot's link, spheres before other shapes; the origin of
    ///   the link's frame if it has only meshes
    /// * reach: for each foot the largest box that its joints reach within their limits, see `import/reach.rs`; for soles also
    ///   faces that cut its corners, see `import/faces.rs`
    /// * force limit: vertical force that the joint efforts can bear at the weakest foot, at most [`FORCE_LIMIT_WEIGHTS`] weights
    /// * joints: the joints of each foot's leg
    /// * name: the given one, or the file's. `-imported` is appended if a different built-in robot has that name
    /// * leg mass: `sum m_i (d_i / l)^2` over the links that a leg moves, with the distances `d_i` of their centres of mass and `l` of the
    ///   foot from the leg's first joint; the mean of all legs
    ///
    /// # Errors
    /// [`Error::Format`] for text that is not XML, [`Error::Invalid`] for a model that is not a legged robot. Each names the place.
    pub fn urdf(&self, text: &str) -> Result<Imported> {
        self.model(&urdf::read(&xml::document(text, urdf::FORMAT)?)?)
    }

    /// Computes a robot from the text of an MJCF file, as from a URDF. The text includes no other files.
    ///
    /// * links: the bodies of the tree with the most joints; joints have no speed limits, and their efforts are those of their motors
    /// * stance without a given configuration: the keyframe `home`, or else the first one. Robots on soles take the posture of their arms and
    ///   trunk from it, and stand on bent knees
    ///
    /// # Errors
    /// As [`Import::urdf`]; also for bodies whose mass is only in a mesh.
    pub fn mjcf(&self, text: &str) -> Result<Imported> {
        self.model(&mjcf::read(&xml::document(text, mjcf::FORMAT)?, None)?)
    }

    /// Computes a robot from a URDF or MJCF file. MJCF files may include others.
    ///
    /// # Errors
    /// As [`Import::urdf`] and [`Import::mjcf`], with the file's name; also for a file that cannot be read or is larger than [`MAX_FILE`].
    pub fn file(&self, path: &Path) -> Result<Imported> {
        let text = files::read_at_most(path, MAX_FILE as u64)?;
        let imported = xml::document(&text, "a URDF or MJCF file").and_then(|document| {
            let mjcf = document.root_element().has_tag_name(mjcf::OUTERMOST);
            self.model(&if mjcf { mjcf::read(&document, path.parent()) } else { urdf::read(&document) }?)
        });
        imported.map_err(|e| e.in_file(path, None))
    }

    /// Computes a robot from links and joints.
    fn model(&self, model: &Model) -> Result<Imported> {
        let tree = Tree::new(model)?;
        let kept = model.stance.iter().filter(|(joint, _)| !self.configuration.iter().any(|(other, _)| other == joint));
        let values = tree.configuration(&kept.chain(&self.configuration).cloned().collect::<Vec<_>>())?;
        self.check_mass(&tree, &values)?;
        let mut unsoled = Vec::new();
        let posed = match self.on_soles(&tree, &values, &mut unsoled)? {
            Some(posed) => posed,
            None => self.on_given_points(&tree, values)?,
        };
        let Posed { values, frames, body, contacts, legs, reach, sole, notes: mut posed_notes } = posed;
        let center = body.center;
        let weighed = |link: usize| model.links[link].inertial.as_ref().map(|inertial| (&frames[link], inertial));
        let nominal_feet: Vec<[f64; 3]> = contacts.iter().map(|contact| (contact.point() - center).into()).collect();
        let base_height = nominal_feet.iter().map(|foot| -foot[2]).fold(f64::NEG_INFINITY, f64::max);
        let leg_masses = legs.iter().map(|leg| leg_mass(leg, feet::moved_by(&tree, leg).into_iter().filter_map(weighed), &center));
        let mut robot = Robot {
            name: self.name.clone().unwrap_or_else(|| model.name.clone()),
            mass: body.mass,
            inertia: std::array::from_fn(|r| std::array::from_fn(|c| body.inertia[(r, c)])),
            base_height,
            reach: Reach::PerFoot(reach),
            force_limit: None,
            leg_mass: Some(leg_masses.sum::<f64>() / legs.len() as f64),
            nominal_feet,
            joints: None,
            foot_radius: contacts.iter().map(|c| (c.radius > 0.).then_some(c.radius)).reduce(least).flatten(),
            sole,
        };
        let vertical = legs.iter().map(|leg| leg.vertical_force(&leg.posture(&leg.nominal()))).fold(f64::INFINITY, f64::min);
        robot.force_limit = vertical.is_finite().then(|| vertical.min(FORCE_LIMIT_WEIGHTS * robot.weight()));
        if robot.name.is_empty() {
            robot.name = "robot".into();
        }
        let speeds = legs.iter().map(|leg| leg.horizontal_speed(&leg.posture(&leg.nominal())));
        let slowest = speeds.collect::<Option<Vec<f64>>>().map(|speeds| speeds.into_iter().fold(f64::INFINITY, f64::min));
        robot.joints = Some(legs);
        let mut notes = self.notes(&tree, &robot, &contacts, vertical);
        posed_notes.append(&mut unsoled);
        posed_notes.append(&mut notes);
        let mut notes = posed_notes;
        notes.extend(model.notes.iter().cloned());
        if let Some(what) = robot.differs_from_named().filter(|_| self.name.is_none()) {
            let own = format!("{}-imported", robot.name);
            notes.push(format!("the built-in robot `{}` has another {what}; this one is called `{own}`", robot.name));
            robot.name = own;
        }
        robot.validate_own()?;
        let moving = model.joints.iter().zip(&values).filter(|(joint, _)| joint.motion != Motion::Fixed);
        Ok(Imported {
            feet: contacts.iter().map(|contact| foot(&tree, &frames[contact.link].translation.vector, contact, &center)).collect(),
            foot_speed: slowest.filter(|speed| speed.is_finite()),
            center_of_mass: center.into(),
            configuration: moving.map(|(joint, &value)| (joint.name.clone(), value)).collect(),
            notes,
            robot,
        })
    }

    /// Checks that the links have a mass.
    fn check_mass(&self, tree: &Tree, values: &[f64]) -> Result<()> {
        if whole(tree, &tree.frames(values)).mass > 0. {
            return Ok(());
        }
        let links = &tree.model.links;
        let with = links.iter().filter(|link| link.inertial.is_some()).count();
        Err(Error::invalid("mass of all links", format!("0 kg: {with} of {} links have <inertial>", links.len()), "positive"))
    }

    /// Links of the feet: the named ones, or those on the ground.
    fn links(&self, tree: &Tree, frames: &[Isometry3<f64>], center: &Vector3<f64>) -> Result<Vec<usize>> {
        if self.feet.is_empty() { feet::find(tree, frames, center) } else { self.named_feet(tree) }
    }

    /// Pose on soles; `None` if the feet are points or balls, with a reason in `notes` if they have flat lower sides.
    fn on_soles(&self, tree: &Tree, values: &[f64], notes: &mut Vec<String>) -> Result<Option<Posed>> {
        let frames = tree.frames(values);
        let links = match (self.soles, self.links(tree, &frames, &whole(tree, &frames).center)) {
            (Soles::Absent, _) => return Ok(None),
            // Reported again where points need them.
            (Soles::Found, Err(_)) => return Ok(None),
            (_, links) => links?,
        };
        let contacts: Vec<Contact> = links.iter().map(|&link| feet::contact(tree, &frames, link)).collect();
        let found: Vec<Option<FootSole>> = links.iter().map(|&link| soles::of_foot(tree, &frames, link)).collect();
        let soles: Option<Vec<(usize, FootSole)>> = match self.soles {
            Soles::Size([length, width]) => {
                let placed = contacts.iter().zip(&found).map(|(contact, found)| {
                    let level = Isometry3::from_parts(contact.point().into(), Default::default());
                    let frame = found.map_or_else(|| frames[contact.link].inverse() * level, |sole| sole.frame);
                    (contact.link, FootSole { frame, length, width })
                });
                Some(placed.collect())
            }
            _ => links.iter().copied().zip(&found).map(|(link, sole)| Some((link, (*sole)?))).collect(),
        };
        let Some(soles) = soles else {
            if found.iter().any(Option::is_some) {
                notes.push("some feet have flat soles, others have none: all are modelled as points".into());
            }
            return Ok(None);
        };
        let legs = feet::legs(tree, &frames, values, &Vector3::zeros(), &contacts)?;
        let refused = |value: String, limit: &str, notes: &mut Vec<String>| match self.soles {
            Soles::Size(_) => Err(Error::invalid("sole", value, limit)),
            _ => {
                notes.push(format!("no soles: {value}, but a sole needs {limit}"));
                Ok(None)
            }
        };
        if let Some(leg) = legs.iter().find(|leg| leg.chain.len() < SOLE_JOINTS) {
            let value = format!("the leg of `{}` has {} joints", leg.foot.escape_debug(), leg.chain.len());
            return refused(value, &format!("at least {SOLE_JOINTS} joints, to be level wherever the foot is"), notes);
        }
        let given = !self.configuration.is_empty();
        let Some(stance) = upright::upright(tree, values, &soles, given)? else {
            let value = "level soles cannot move".to_owned() + if given { " in the configuration" } else { "" };
            return refused(value, "bent knees: give another --configuration", notes);
        };
        let [length, width] = [|s: &FootSole| s.length, |s: &FootSole| s.width].map(|of| {
            let least = soles.iter().map(|(_, sole)| of(sole)).fold(f64::INFINITY, f64::min);
            (least * 1e6).round() / 1e6
        });
        let mut posed = Posed::new(tree, stance.values, |frames, _| Ok(upright::contacts(frames, &soles)))?;
        posed.reach = stance.reach;
        posed.sole = Some(Sole { length, width, turn: stance.turn });
        if !given {
            posed.notes.push(
                "no configuration was given: knees are bent so that the robot can walk, with its centre of mass above its soles".into(),
            );
        }
        let origin = if self.soles == Soles::Found { "found below the collision shapes" } else { "of the given size" };
        posed.notes.push(format!("feet have soles of {length} x {width} m, {origin}, that turn by up to {} rad", stance.turn));
        Ok(Some(posed))
    }

    /// Pose on points or balls in the given configuration, in that of the file, or else on bent legs. The pose of the file must have as many
    /// feet on the ground as bent legs.
    ///
    /// * `values` - values of all joints as given or in the file, rad or m
    fn on_given_points(&self, tree: &Tree, values: Vec<f64>) -> Result<Posed> {
        if !self.configuration.is_empty() {
            return self.on_points(tree, values, false);
        }
        let bent = self.on_points(tree, tree.configuration(&[])?, true);
        let stance = (!tree.model.stance.is_empty()).then(|| self.on_points(tree, values, false)).and_then(Result::ok);
        match stance.filter(|stance| bent.as_ref().map_or(0, |bent| bent.contacts.len()) <= stance.contacts.len()) {
            Some(mut posed) => {
                posed.notes.push("no configuration was given: the robot stands as in the keyframe of its file".into());
                Ok(posed)
            }
            None => bent,
        }
    }

    /// Pose on points or balls.
    ///
    /// * `bent` - bends the legs so that the robot stands, if it can
    fn on_points(&self, tree: &Tree, mut values: Vec<f64>, bent: bool) -> Result<Posed> {
        let contacts = |frames: &[Isometry3<f64>], body: &Body| {
            let links = self.links(tree, frames, &body.center)?;
            Ok(links.iter().map(|&link| feet::contact(tree, frames, link)).collect())
        };
        let mut notes = Vec::new();
        if bent {
            // Errors in the legs are reported below.
            let legs = Posed::new(tree, values.clone(), contacts).map(|posed| posed.legs);
            if let Some((legs, standing)) = legs.ok().and_then(|legs| stance::standing(&legs).map(|q| (legs, q))) {
                for (joint, value) in legs.iter().zip(standing).flat_map(|(leg, q)| leg.chain.iter().zip(q)) {
                    if let Some(j) = tree.model.joints.iter().position(|other| other.name == joint.name) {
                        values[j] = value;
                    }
                }
                tree.follow(&mut values)?;
                notes.push("no configuration was given: legs are bent so that the robot stands".into());
            }
        }
        let mut posed = Posed::new(tree, values, contacts)?;
        let nominal: Vec<[f64; 3]> = posed.contacts.iter().map(|contact| (contact.point() - posed.body.center).into()).collect();
        let height = nominal.iter().map(|foot| -foot[2]).fold(f64::NEG_INFINITY, f64::max);
        if height <= 0. {
            let limit = "above: give a --configuration in which it stands";
            return Err(Error::invalid("centre of mass above the lowest foot", format!("{height:.4} m"), limit));
        }
        let boxes =
            posed.legs.iter().enumerate().map(|(foot, leg)| reach::grow(leg, &reach::room(leg, foot, &nominal)).map(FootReach::from));
        posed.reach = boxes.collect::<Result<_>>()?;
        posed.notes = notes;
        Ok(posed)
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
    fn notes(&self, tree: &Tree, robot: &Robot, contacts: &[Contact], vertical: f64) -> Vec<String> {
        let mut notes = Vec::new();
        let name = |contact: &Contact| format!("`{}`", tree.model.links[contact.link].name.escape_debug());
        let names = |of: &dyn Fn(&&Contact) -> bool| contacts.iter().filter(of).map(name).collect::<Vec<_>>().join(", ");
        if self.feet.is_empty() {
            notes.push(format!("feet were not named; lowest in the configuration are {}", names(&|_| true)));
        }
        let (flat, bare) =
            (names(&|c| c.sole.is_none() && (c.touching > 1 || c.touching == 1 && c.radius == 0.)), names(&|c| c.touching == 0));
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
fn leg_mass<'a>(leg: &Leg, links: impl Iterator<Item = (&'a nalgebra::Isometry3<f64>, &'a Inertial)>, center: &Vector3<f64>) -> f64 {
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
