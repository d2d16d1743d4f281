//! Kinematic tree of a model, and the frames of its links in a configuration.

use super::model::{Joint, Model, Motion};
use crate::error::{Error, Result};
use crate::robot::leg::joint_motion;
use nalgebra::Isometry3;
use std::collections::HashMap;

/// Tolerance by which a value may exceed a limit, rad or m. Files contain rounded limits.
const SLACK: f64 = 1e-6;
/// Longest chain of joints that follow each other (mimic).
const LONGEST_MIMIC: usize = 16;

/// A model whose links form one tree.
#[derive(Debug)]
pub struct Tree<'a> {
    /// Parsed model.
    pub model: &'a Model,
    /// Links, parents before their children.
    pub order: Vec<usize>,
    /// Joint above each link; `None` for the root.
    pub above: Vec<Option<usize>>,
    /// Link above each link; `None` for the root.
    pub parents: Vec<Option<usize>>,
    links: HashMap<&'a str, usize>,
    joints: HashMap<&'a str, usize>,
}

/// The most similar names, at most three, for an error message.
fn near<'n>(name: &str, names: impl Iterator<Item = &'n str>) -> String {
    let mut ranked: Vec<(f64, &str)> = names.map(|n| (strsim::jaro_winkler(&name.to_lowercase(), &n.to_lowercase()), n)).collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    ranked.iter().take(3).map(|(_, n)| format!("`{}`", n.escape_debug())).collect::<Vec<_>>().join(", ")
}

/// Index by name. Each name must be unique.
fn index<'a>(what: &str, names: impl Iterator<Item = &'a str>) -> Result<HashMap<&'a str, usize>> {
    let mut index = HashMap::new();
    for (i, name) in names.enumerate() {
        if index.insert(name, i).is_some() {
            return Err(Error::invalid(format!("{what} `{}`", name.escape_debug()), "defined twice", "defined once"));
        }
    }
    Ok(index)
}

impl<'a> Tree<'a> {
    /// Orders the links of a model.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the links do not form one tree: duplicate or missing names, several roots, loops.
    pub fn new(model: &'a Model) -> Result<Tree<'a>> {
        if model.links.is_empty() {
            return Err(Error::invalid("links", "none", "at least one"));
        }
        let links = index("link", model.links.iter().map(|link| link.name.as_str()))?;
        let joints = index("joint", model.joints.iter().map(|joint| joint.name.as_str()))?;
        let count = model.links.len();
        let (mut above, mut parents, mut children) = (vec![None; count], vec![None; count], vec![Vec::new(); count]);
        for (j, joint) in model.joints.iter().enumerate() {
            let place = format!("joint `{}`", joint.name.escape_debug());
            let find = |end: &str, name: &str| {
                links.get(name).copied().ok_or_else(|| {
                    let limit = format!("a link of the file, such as {}", near(name, links.keys().copied()));
                    Error::invalid(format!("{place}, {end}"), format!("`{}`", name.escape_debug()), limit)
                })
            };
            let (parent, child) = (find("parent", &joint.parent)?, find("child", &joint.child)?);
            if let Some(other) = above[child].replace(j) {
                let value = format!("joints `{}` and `{}` move it", model.joints[other].name.escape_debug(), joint.name.escape_debug());
                let link = format!("link `{}`", joint.child.escape_debug());
                return Err(Error::invalid(link, value, "moved by one joint: loops of links are not supported"));
            }
            parents[child] = Some(parent);
            children[parent].push(child);
        }
        let roots: Vec<usize> = (0..count).filter(|&link| above[link].is_none()).collect();
        let &[root] = roots.as_slice() else {
            let names: Vec<String> = roots.iter().take(4).map(|&r| format!("`{}`", model.links[r].name.escape_debug())).collect();
            let value = if roots.is_empty() { "none".into() } else { format!("{}: {}", roots.len(), names.join(", ")) };
            return Err(Error::invalid("links that no joint moves", value, "one, the base: joints must form a tree without loops"));
        };
        let mut order = vec![root];
        let mut next = 0;
        while let Some(&link) = order.get(next) {
            order.extend(&children[link]);
            next += 1;
        }
        if order.len() < count {
            let mut lost = vec![true; count];
            order.iter().for_each(|&link| lost[link] = false);
            let lost = lost.iter().position(|&l| l).unwrap_or_default();
            let link = format!("link `{}`", model.links[lost].name.escape_debug());
            return Err(Error::invalid(link, "in a loop of joints", "connected to the base"));
        }
        Ok(Tree { model, order, above, parents, links, joints })
    }

    /// Link with a name.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the most similar names.
    pub fn link(&self, place: &str, name: &str) -> Result<usize> {
        self.links.get(name).copied().ok_or_else(|| {
            let limit = format!("a link of the file, such as {}", near(name, self.model.links.iter().map(|l| l.name.as_str())));
            Error::invalid(place, format!("`{}`", name.escape_debug()), limit)
        })
    }

    /// Links without child joints.
    pub fn leaves(&self) -> impl Iterator<Item = usize> {
        let mut leaf = vec![true; self.parents.len()];
        self.parents.iter().flatten().for_each(|&parent| leaf[parent] = false);
        (0..leaf.len()).filter(move |&link| leaf[link])
    }

    /// Joints from the base to a link, starting at the base.
    pub fn path(&self, mut link: usize) -> Vec<usize> {
        let mut path = Vec::new();
        while let (Some(joint), Some(parent)) = (self.above[link], self.parents[link]) {
            path.push(joint);
            link = parent;
        }
        path.reverse();
        path
    }

    /// Values of all joints, rad or m: the given ones; otherwise zero, or the middle of the limits if zero is outside.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a joint that does not exist, does not move or follows another, or whose value is outside its limits.
    pub fn configuration(&self, given: &[(String, f64)]) -> Result<Vec<f64>> {
        let resting = |joint: &Joint| match joint.limits {
            [lower, upper] if lower > 0. || upper < 0. => {
                if upper.is_infinite() {
                    lower
                } else if lower.is_infinite() {
                    upper
                } else {
                    (lower + upper) / 2.
                }
            }
            _ => 0.,
        };
        let mut values: Vec<f64> = self.model.joints.iter().map(resting).collect();
        let mut seen = vec![false; values.len()];
        for (name, value) in given {
            let place = format!("configuration, joint `{}`", name.escape_debug());
            let Some(&j) = self.joints.get(name.as_str()) else {
                let moving = self.model.joints.iter().filter(|joint| joint.motion != Motion::Fixed);
                let limit = format!("a joint of the file, such as {}", near(name, moving.map(|joint| joint.name.as_str())));
                return Err(Error::invalid("configuration", format!("`{}`", name.escape_debug()), limit));
            };
            let joint = &self.model.joints[j];
            if joint.motion == Motion::Fixed {
                return Err(Error::invalid(place, value, "left out: this joint is fixed"));
            }
            if let Some(mimic) = &joint.mimic {
                return Err(Error::invalid(place, value, format!("left out: it follows joint `{}`", mimic.joint.escape_debug())));
            }
            if std::mem::replace(&mut seen[j], true) {
                return Err(Error::invalid(place, value, "given once"));
            }
            let [lower, upper] = joint.limits;
            if !(value.is_finite() && *value >= lower - SLACK && *value <= upper + SLACK) {
                return Err(Error::invalid(place, value, format!("within its limits, {lower} to {upper}")));
            }
            values[j] = value.clamp(lower, upper);
        }
        self.follow(&mut values)?;
        Ok(values)
    }

    /// Sets joints that follow others (mimic) to their values.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a joint that follows a missing joint, or itself.
    pub fn follow(&self, values: &mut [f64]) -> Result<()> {
        for j in 0..values.len() {
            values[j] = self.followed(j, values)?;
        }
        Ok(())
    }

    /// Value of a joint that may follow another one, and that one a third.
    fn followed(&self, joint: usize, values: &[f64]) -> Result<f64> {
        let (mut factor, mut offset, mut at) = (1., 0., joint);
        for _ in 0..LONGEST_MIMIC {
            let Some(mimic) = &self.model.joints[at].mimic else { return Ok(factor * values[at] + offset) };
            let Some(&other) = self.joints.get(mimic.joint.as_str()) else {
                let place = format!("joint `{}`, mimic", self.model.joints[at].name.escape_debug());
                let limit = format!("a joint of the file, such as {}", near(&mimic.joint, self.joints.keys().copied()));
                return Err(Error::invalid(place, format!("`{}`", mimic.joint.escape_debug()), limit));
            };
            (offset, factor, at) = (offset + factor * mimic.offset, factor * mimic.multiplier, other);
        }
        let place = format!("joint `{}`, mimic", self.model.joints[joint].name.escape_debug());
        Err(Error::invalid(place, "a loop or a long chain", format!("a joint that moves by itself after at most {LONGEST_MIMIC} others")))
    }

    /// Frame of every link in that of the base, for values of all joints.
    pub fn frames(&self, values: &[f64]) -> Vec<Isometry3<f64>> {
        let mut frames = vec![Isometry3::identity(); self.parents.len()];
        for &link in &self.order {
            if let (Some(j), Some(parent)) = (self.above[link], self.parents[link]) {
                let joint = &self.model.joints[j];
                frames[link] = frames[parent] * self.transform(joint, values[j]);
            }
        }
        frames
    }

    /// Frame of a joint's child in that of its parent.
    pub fn transform(&self, joint: &Joint, value: f64) -> Isometry3<f64> {
        match joint.motion {
            Motion::Fixed => joint.origin,
            motion => joint.origin * joint_motion(motion == Motion::Revolute, &joint.axis, value),
        }
    }
}
