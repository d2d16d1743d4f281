//! Specification of a data set: robots, grounds, commands, gait families and their number, in TOML.

use super::manifest::{Origin, RobotEntry};
use crate::app::named;
use crate::app::options::merge;
use crate::error::{Error, Result, check_name, check_range, from_toml};
use crate::export::MOST_RATE;
use crate::files;
use crate::gait::family::{GaitFamily, default_families, families};
use crate::gait::joints::RATES;
use crate::gait::trajectory::NamedOr;
use crate::robot::Robot;
use crate::search::atlas::FORCE_PIECES;
use crate::search::evaluate::LowerSettings;
use crate::settings::Transcription;
use crate::terrain::Terrain;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

/// Largest number of motions in a data set.
pub const MOST_MOTIONS: usize = 10_000_000;
/// Largest number of draws in a shard.
pub const MOST_DRAWS: usize = 100_000;
/// Number of iterations that minimise the cost of each motion, unless the specification has another number.
pub const ITERATIONS: usize = 6;

/// Ends of a motion: the state of the base at the start and at the end, and the contact schedule between them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// From rest to rest: the base accelerates over 30 % of the motion and decelerates over 30 %.
    Rest,
    /// From rest to the commanded velocity, reached after 30 % of the motion.
    Start,
    /// At the commanded velocity from start to end, entered at any phase of the gait. All feet stand at the start.
    Steady,
    /// Like [`Kind::Steady`], with a stride in the middle that repeats exactly; only for commands without turn.
    Periodic,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Kind; 4] = [Kind::Rest, Kind::Start, Kind::Steady, Kind::Periodic];

    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Rest => "rest",
            Kind::Start => "start",
            Kind::Steady => "steady",
            Kind::Periodic => "periodic",
        }
    }
}

/// Ground with the places where motions start.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GroundPlaces {
    /// Terrain: a name, or a file as `--terrain` accepts it.
    pub terrain: String,
    /// Range of the start along x, m.
    #[serde(default)]
    pub x: [f64; 2],
    /// Range of the start along y, m.
    #[serde(default)]
    pub y: [f64; 2],
    /// Range of the yaw at the start, rad.
    #[serde(default)]
    pub yaw: [f64; 2],
}

/// Ranges of commands, in the frame of the base at the start.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandRanges {
    /// Range of the forward speed, m/s; of the displacement, m, with [`CommandRanges::displacement`].
    pub forward: [f64; 2],
    /// Range of the speed to the left, m/s; of the displacement, m.
    #[serde(default)]
    pub sideways: [f64; 2],
    /// Range of the yaw rate, rad/s; of the turn, rad.
    #[serde(default)]
    pub yaw: [f64; 2],
    /// True if the ranges are those of the displacement in the whole motion.
    #[serde(default)]
    pub displacement: bool,
    /// Robots that get these commands, as in [`Spec::robots`]; all if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robots: Option<Vec<String>>,
    /// Families that get these commands; all of the robot's if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub families: Option<Vec<GaitFamily>>,
}

/// Specification of a data set. Unknown keys are refused; paths are relative to the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spec {
    /// Number of certified motions, divided evenly among the robots.
    pub count: usize,
    /// Seed of all draws.
    #[serde(default = "seed")]
    pub seed: u64,
    /// Duration of each motion, s.
    #[serde(default = "length")]
    pub length: f64,
    /// Number of frames per second, Hz; `length` times `rate` is a whole number.
    #[serde(default = "rate")]
    pub rate: f64,
    /// Robots: names, or JSON or TOML files.
    pub robots: Vec<String>,
    /// Grounds: names, files, or tables with ranges of the start. Default: flat.
    #[serde(default = "flat")]
    pub grounds: Vec<NamedOr<GroundPlaces>>,
    /// Gait families; those that a robot cannot have are skipped. Default: those of a search.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub families: Option<Vec<GaitFamily>>,
    /// Kinds of motions.
    #[serde(default = "kinds")]
    pub kinds: Vec<Kind>,
    /// Commands.
    pub commands: Vec<CommandRanges>,
    /// True to drop motions that exceed a speed or torque limit of a joint.
    #[serde(default)]
    pub joint_limits: bool,
    /// Largest number of draws per motion. Too small: hard commands end with fewer motions than asked. Too large: impossible commands take
    /// long.
    #[serde(default = "attempts")]
    pub attempts: usize,
    /// Number of draws in a shard. Too small: many files. Too large: an interruption loses much work.
    #[serde(default = "draws")]
    pub shard: usize,
    /// Licence of the data, for the metadata.
    #[serde(default = "licence")]
    pub licence: String,
    /// Settings of the lower level: tables `transcription` and `solver`.
    #[serde(default, skip_serializing_if = "toml::Table::is_empty")]
    pub settings: toml::Table,
}

fn seed() -> u64 {
    1
}

fn length() -> f64 {
    2.
}

fn rate() -> f64 {
    50.
}

fn flat() -> Vec<NamedOr<GroundPlaces>> {
    vec![NamedOr::Name("flat".into())]
}

fn kinds() -> Vec<Kind> {
    vec![Kind::Rest, Kind::Start, Kind::Steady]
}

fn attempts() -> usize {
    20
}

fn draws() -> usize {
    128
}

fn licence() -> String {
    "not stated".into()
}

/// Ground of a plan.
#[derive(Debug, Clone)]
pub struct Ground {
    /// Terrain.
    pub terrain: Arc<Terrain>,
    /// Ranges of x, y, m, and yaw, rad, at the start.
    pub start: [[f64; 2]; 3],
}

/// Robot of a plan with everything that is drawn for it.
#[derive(Debug, Clone)]
pub struct Subject {
    /// Robot.
    pub robot: Arc<Robot>,
    /// Name of its folder.
    pub folder: String,
    /// Number of motions to make.
    pub count: usize,
    /// Combinations of ground, family, command and kind that are drawn in turn: indices of ground and command.
    pub combinations: Vec<(usize, GaitFamily, usize, Kind)>,
}

/// Specification with robots and grounds read.
#[derive(Debug, Clone)]
pub struct DatasetPlan {
    /// The specification.
    pub spec: Spec,
    /// Robots.
    pub subjects: Vec<Subject>,
    /// Grounds.
    pub grounds: Vec<Ground>,
    /// Settings of the lower level; the interval is that of the robot.
    pub settings: LowerSettings,
}

impl Spec {
    /// Reads a specification. Files in it become relative to the working directory.
    ///
    /// # Errors
    /// [`Error::InFile`] for a file that is not a specification; [`Error::Io`] for one that cannot be read.
    pub fn read(path: &Path) -> Result<Spec> {
        let mut spec: Spec = from_toml(&files::read(path)?).map_err(|e| e.in_file(path, None))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let resolve = |name: &mut String| {
            let own = Path::new(name.as_str());
            if own.extension().is_some() || own.components().count() > 1 {
                *name = folder.join(&*name).to_string_lossy().into_owned();
            }
        };
        spec.robots.iter_mut().for_each(resolve);
        spec.commands.iter_mut().filter_map(|ranges| ranges.robots.as_mut()).flatten().for_each(resolve);
        spec.grounds.iter_mut().for_each(|ground| match ground {
            NamedOr::Name(name) => resolve(name),
            NamedOr::Own(places) => resolve(&mut places.terrain),
        });
        spec.validate().map_err(|e| e.in_file(path, None))?;
        Ok(spec)
    }

    /// Number of frames of a motion.
    pub fn frames(&self) -> usize {
        (self.length * self.rate).round() as usize + 1
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first value outside its limits.
    pub fn validate(&self) -> Result<()> {
        check_range("count", self.count as f64, 1., MOST_MOTIONS as f64)?;
        check_range("length", self.length, 0.2, 20.)?;
        check_range("rate", self.rate, RATES[0], MOST_RATE.min(RATES[1]))?;
        let frames = self.length * self.rate;
        if (frames - frames.round()).abs() > 1e-6 || frames < 1. {
            return Err(Error::invalid("rate", self.rate, format!("such that rate x length {} is a whole number", self.length)));
        }
        check_range("attempts", self.attempts as f64, 1., 1e4)?;
        check_range("shard", self.shard as f64, 1., MOST_DRAWS as f64)?;
        check_name("licence", &self.licence)?;
        let lists = [self.robots.len(), self.grounds.len(), self.commands.len(), self.kinds.len()];
        for (name, len) in ["robots", "grounds", "commands", "kinds"].into_iter().zip(lists) {
            if len == 0 {
                return Err(Error::invalid(name, "empty", "at least one"));
            }
        }
        let range = |place: String, [low, high]: [f64; 2], limit: f64| {
            check_range(&format!("{place}[0]"), low, -limit, limit)?;
            check_range(&format!("{place}[1]"), high, low, limit)
        };
        for (i, ranges) in self.commands.iter().enumerate() {
            for (name, values) in [("forward", ranges.forward), ("sideways", ranges.sideways), ("yaw", ranges.yaw)] {
                range(format!("commands[{i}].{name}"), values, 100.)?;
            }
            if let Some(name) = ranges.robots.iter().flatten().find(|name| !self.robots.contains(name)) {
                let unknown = Error::Unknown { what: "robot", name: name.clone(), known: self.robots.join(", ") };
                return Err(unknown.within(format!("commands[{i}]")));
            }
        }
        for (i, ground) in self.grounds.iter().enumerate() {
            if let NamedOr::Own(places) = ground {
                for (name, values) in [("x", places.x), ("y", places.y), ("yaw", places.yaw)] {
                    range(format!("grounds[{i}].{name}"), values, 1000.)?;
                }
            }
        }
        match self.settings.keys().find(|key| !["transcription", "solver"].contains(&key.as_str())) {
            Some(name) => Err(Error::Unknown { what: "table of settings", name: name.clone(), known: "transcription, solver".into() }),
            None => Ok(()),
        }
    }

    /// Settings of the lower level: those of this file over short minimisations with the force pieces of an atlas.
    fn lower_settings(&self) -> Result<LowerSettings> {
        let mut settings = LowerSettings::default();
        settings.solver.optimise.iterations = ITERATIONS;
        settings.transcription.force_pieces = Some(FORCE_PIECES);
        let table = |name: &str| match self.settings.get(name) {
            None => Ok(toml::Table::new()),
            Some(toml::Value::Table(table)) => Ok(table.clone()),
            Some(other) => Err(Error::invalid(format!("settings.{name}"), other, "a table")),
        };
        settings.transcription = merge(settings.transcription, &table("transcription")?, "settings.transcription")?;
        settings.solver = merge(settings.solver, &table("solver")?, "settings.solver")?;
        settings.validate()?;
        if settings.transcription.rows != Transcription::Momentum {
            return Err(Error::invalid("settings.transcription.rows", settings.transcription.rows.name(), "`momentum`"));
        }
        Ok(settings)
    }

    /// Reads robots and grounds.
    ///
    /// # Errors
    /// Errors of the files; [`Error::Invalid`] for a robot without a combination of family and command, and for two robots with the same
    /// name.
    pub fn plan(mut self) -> Result<DatasetPlan> {
        self.validate()?;
        let settings = self.lower_settings()?;
        let terrain = |ground: &NamedOr<GroundPlaces>| match ground {
            NamedOr::Name(name) | NamedOr::Own(GroundPlaces { terrain: name, .. }) => named::terrain(name),
        };
        let terrains = self.grounds.iter().map(terrain).collect::<Result<Vec<_>>>()?;
        let grounds = self.grounds_on(terrains);
        let subject = |(i, name): (usize, &String)| {
            let robot = named::robot(name)?;
            let place = format!("robots[{i}] `{}`", robot.name.escape_debug());
            let combinations = self.combinations(name, &robot, grounds.len());
            if combinations.is_empty() {
                return Err(Error::invalid(place, "no combination of family and command", "given at least one"));
            }
            // The first robots make one motion more if the number is not divisible.
            let count = self.count / self.robots.len() + usize::from(i < self.count % self.robots.len());
            if count == 0 {
                return Err(Error::invalid("count", self.count, format!("at least {}, the number of robots", self.robots.len())));
            }
            let plain = |c: char| if c.is_ascii_alphanumeric() || "-_".contains(c) { c } else { '_' };
            Ok(Subject { folder: robot.name.chars().map(plain).collect(), robot, count, combinations })
        };
        let subjects = self.robots.iter().enumerate().map(subject).collect::<Result<Vec<Subject>>>()?;
        for (i, subject) in subjects.iter().enumerate() {
            if subjects[..i].iter().any(|other| other.folder == subject.folder) {
                return Err(Error::invalid(format!("robots[{i}]"), &subject.folder, "a robot with another name than those before"));
            }
        }
        self.name_content(&subjects, &grounds);
        Ok(DatasetPlan { spec: self, subjects, grounds, settings })
    }

    /// Grounds with the ranges of the start.
    ///
    /// * `terrains` - those of [`Spec::grounds`]
    fn grounds_on(&self, terrains: impl IntoIterator<Item = Arc<Terrain>>) -> Vec<Ground> {
        let ground = |(ground, terrain): (&NamedOr<GroundPlaces>, Arc<Terrain>)| {
            let start = match ground {
                NamedOr::Name(_) => [[0.; 2]; 3],
                NamedOr::Own(places) => [places.x, places.y, places.yaw],
            };
            Ground { terrain, start }
        };
        self.grounds.iter().zip(terrains).map(ground).collect()
    }

    /// Replaces names of files by the names in them, so that the specification does not depend on the working directory.
    fn name_content(&mut self, subjects: &[Subject], grounds: &[Ground]) {
        for name in self.commands.iter_mut().filter_map(|ranges| ranges.robots.as_mut()).flatten() {
            if let Some(i) = self.robots.iter().position(|robot| robot == name) {
                name.clone_from(&subjects[i].robot.name);
            }
        }
        self.robots = subjects.iter().map(|subject| subject.robot.name.clone()).collect();
        for (ground, Ground { terrain, .. }) in self.grounds.iter_mut().zip(grounds) {
            match ground {
                NamedOr::Name(name) => name.clone_from(&terrain.name),
                NamedOr::Own(places) => places.terrain.clone_from(&terrain.name),
            }
        }
    }

    /// Combinations of ground, family, command and kind for a robot. Neighbours differ in as many of them as possible.
    fn combinations(&self, name: &String, robot: &Robot, grounds: usize) -> Vec<(usize, GaitFamily, usize, Kind)> {
        let own = match &self.families {
            Some(asked) => families(robot).into_iter().filter(|family| asked.contains(family)).collect(),
            None => default_families(robot),
        };
        let mut all = Vec::new();
        for (command, ranges) in self.commands.iter().enumerate() {
            if ranges.robots.as_ref().is_some_and(|robots| !robots.contains(name)) {
                continue;
            }
            for ground in 0..grounds {
                for &kind in &self.kinds {
                    let fits = |family: &&GaitFamily| ranges.families.as_ref().is_none_or(|families| families.contains(family));
                    all.extend(own.iter().filter(fits).map(|&family| (ground, family, command, kind)));
                }
            }
        }
        all
    }
}

impl DatasetPlan {
    /// Plan of the data of a manifest.
    pub fn of(origin: Origin) -> DatasetPlan {
        let Origin { spec, settings, robots, grounds, .. } = origin;
        let grounds = spec.grounds_on(grounds.into_iter().map(Arc::new));
        let subject = |RobotEntry { folder, count, robot }: RobotEntry| {
            let combinations = spec.combinations(&robot.name, &robot, grounds.len());
            Subject { robot: Arc::new(robot), folder, count, combinations }
        };
        let subjects = robots.into_iter().map(subject).collect();
        DatasetPlan { spec, subjects, grounds, settings }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEAST: &str = "count = 4\nrobots = [\"anymal\"]\n[[commands]]\nforward = [0.1, 0.4]\n";

    fn refused(text: &str) -> String {
        from_toml::<Spec>(text).and_then(Spec::plan).unwrap_err().to_string()
    }

    #[test]
    fn a_short_specification_has_defaults() {
        let plan = from_toml::<Spec>(LEAST).unwrap().plan().unwrap();
        assert_eq!((plan.spec.frames(), plan.spec.seed, plan.grounds.len()), (101, 1, 1));
        // All families of a search, three kinds.
        let families = default_families(&plan.subjects[0].robot).len();
        assert_eq!(plan.subjects[0].combinations.len(), 3 * families);
        assert_eq!(plan.settings.solver.optimise.iterations, ITERATIONS);
    }

    #[test]
    fn the_example_is_valid() {
        let plan = from_toml::<Spec>(include_str!("../../benches/examples/dataset.toml")).unwrap().plan().unwrap();
        assert_eq!((plan.subjects.len(), plan.grounds.len(), plan.spec.licence.as_str()), (2, 3, "CC0-1.0"));
        // One family of the humanoid, four kinds.
        assert_eq!(plan.subjects[1].combinations.len(), 3 * 4);
    }

    #[test]
    fn motions_are_divided_among_robots_and_families_are_those_of_the_robot() {
        let text = "count = 5\nrobots = [\"anymal\", \"biped\"]\nfamilies = [\"trot\", \"walk\"]\nkinds = [\"rest\"]\n\
            [[commands]]\nforward = [0.1, 0.4]\n[[commands]]\nforward = [1, 1]\nrobots = [\"biped\"]\n";
        let plan = from_toml::<Spec>(text).unwrap().plan().unwrap();
        let of = |i: usize| (plan.subjects[i].count, plan.subjects[i].combinations.len());
        assert_eq!((of(0), of(1)), ((3, 2), (2, 2)));
    }

    #[test]
    fn errors_name_place_value_and_limit() {
        assert!(refused(&format!("cuont = 4\n{LEAST}")).contains("unknown field `cuont`; did you mean `count`?"));
        assert!(refused(&LEAST.replace("0.1, 0.4", "0.4, 0.1")).starts_with("commands[0].forward[1]: 0.1"));
        assert!(refused(&LEAST.replace("count = 4", "count = 4\nrate = 33.3")).starts_with("rate: 33.3, but it must be such that"));
        assert!(refused(&LEAST.replace("anymal", "anymall")).contains("did you mean `anymal`?"));
        assert!(refused(&LEAST.replace("count = 4", "count = 4\nfamilies = [\"run\"]")).contains("robots[0] `anymal`: no combination"));
        assert!(refused(&LEAST.replace("count = 4", "count = 4\ngrounds = [{terrain = \"step\", z = 1}]")).contains("unknown field `z`"));
        assert!(refused(&LEAST.replace("[[c", "[settings.search]\nelites = 1\n[[c")).contains("unknown table of settings `search`"));
        assert!(refused(&LEAST.replace("[\"anymal\"]", "[\"anymal\", \"anymal\"]")).starts_with("robots[1]: anymal"));
    }
}
