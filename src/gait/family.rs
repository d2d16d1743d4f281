//! Gait families, and periodic gaits as schedules.
//!
//! In a periodic gait all feet repeat one stride: swing for `s`, stance for `d`, period `P = s + d`. A family defines the time in the
//! stride at which each foot lifts off: its phase offset `phi` in \[0, 1\). Lengths and times scale with the base height `l`: time `sqrt(l
//! / g)`, speed `sqrt(g l)`, Froude number `v^2 / (g l)`. Animals of different size that move alike have the same Froude number and change
//! their gaits at the same Froude numbers (R. McN. Alexander, "The Gaits of Bipedal and Quadrupedal Animals", IJRR 3(2), 1984).
//!
//! Feet are identified by their positions, not by their order: pairs one behind the other, or any other arrangement.

use super::Schedule;
use super::schedule::MAX_PHASES;
use super::swing::TOP_SPEED;
use crate::error::{Error, Result, check_range};
use crate::robot::{GRAVITY, Robot};
use crate::task::Task;
use serde::{Deserialize, Serialize};

/// Shortest phase in requested gaits, in [`time_scale`]s. Too small: feet so fast that motors and controllers cannot follow.
pub const MIN_PHASE_SCALED: f64 = 0.75;

/// Highest speed of a swinging foot for which strides are planned, in [`speed_scale`]s.
pub const FOOT_SPEED_SCALED: f64 = 1.9;

/// Share of the reach box that the base may use along an axis in one stance at travel speed. The optimised motion may be more even than
/// planned and need less. Too large: the faster families are not found over short distances (measured: from 1.15 on); too small: short
/// strides.
pub const REACH_SHARE: f64 = 1.;

/// Largest acceleration for which strides are planned, in `g`, at a friction coefficient of 1 or more; proportionally less with less
/// friction. Too large: short distances are requested in less time than a body needs to lean into them.
pub const ACCELERATION: f64 = 0.15;

/// Fraction of the horizon over which a planned motion accelerates from rest, and again over which it decelerates to rest.
pub const RAMP: f64 = 0.3;

/// Mean speed of a motion from rest to rest, in travel speeds.
pub const MEAN_SPEED: f64 = 1. - RAMP;

/// Distance, m, and turn, rad, below which the goal counts as the start.
const STILL: f64 = 1e-9;

/// Time scale of a falling body of the robot's height, s: `sqrt(l / g)`.
pub fn time_scale(robot: &Robot) -> f64 {
    (robot.base_height / GRAVITY).sqrt()
}

/// Speed at which a step of the robot's height becomes flight, m/s: `sqrt(g l)`.
pub fn speed_scale(robot: &Robot) -> f64 {
    (GRAVITY * robot.base_height).sqrt()
}

/// Froude number of a speed in m/s: `v^2 / (g l)`.
pub fn froude(robot: &Robot, speed: f64) -> f64 {
    (speed / speed_scale(robot)).powi(2)
}

/// Order in which the feet of a gait follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum GaitFamily {
    /// One foot after the other, hind before front on each side; on two feet left and right in turn, one always on the ground.
    Walk,
    /// Diagonal pairs in turn.
    Trot,
    /// Left and right pairs in turn.
    Pace,
    /// Front and hind pairs in turn.
    Bound,
    /// Three beats: a hind foot, a diagonal pair, a front foot.
    Canter,
    /// Hind feet in quick succession, then front feet the other way round.
    RotaryGallop,
    /// Hind feet in quick succession, then front feet the same way round.
    TransverseGallop,
    /// All four feet at once.
    Pronk,
    /// Two feet in turn, with flight in between.
    Run,
    /// All of one or two feet at once.
    Hop,
    /// Six feet, two triangles in turn.
    Tripod,
    /// Six feet, two in the air: three pairs in turn.
    Tetrapod,
    /// Six feet, a wave from hind to front on each side, the sides half a stride apart, waves overlapping.
    Ripple,
    /// One foot at a time, from hind to front on one side, then on the other.
    Wave,
    /// Alternate feet in turn with the feet between them.
    Alternating,
}

/// Values of a family that are known to work. A search starts from them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Typical {
    /// Share of a stride in which a foot stands.
    pub duty: f64,
    /// Duration of a swing, [`time_scale`]s.
    pub swing: f64,
    /// Travel speed, [`speed_scale`]s.
    pub speed: f64,
}

/// All families. Among those of one kind of robot the most likely to work comes first.
pub const FAMILIES: [GaitFamily; 15] = {
    use GaitFamily::*;
    [Trot, Walk, Pace, Bound, Canter, RotaryGallop, TransverseGallop, Pronk, Run, Hop, Tripod, Tetrapod, Ripple, Wave, Alternating]
};

impl std::fmt::Display for GaitFamily {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

impl GaitFamily {
    /// Name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            GaitFamily::Walk => "walk",
            GaitFamily::Trot => "trot",
            GaitFamily::Pace => "pace",
            GaitFamily::Bound => "bound",
            GaitFamily::Canter => "canter",
            GaitFamily::RotaryGallop => "rotary-gallop",
            GaitFamily::TransverseGallop => "transverse-gallop",
            GaitFamily::Pronk => "pronk",
            GaitFamily::Run => "run",
            GaitFamily::Hop => "hop",
            GaitFamily::Tripod => "tripod",
            GaitFamily::Tetrapod => "tetrapod",
            GaitFamily::Ripple => "ripple",
            GaitFamily::Wave => "wave",
            GaitFamily::Alternating => "alternating",
        }
    }

    /// Returns the family of the given name.
    ///
    /// # Errors
    /// [`Error::Unknown`] for another name; it lists [`FAMILIES`].
    pub fn named(name: &str) -> Result<GaitFamily> {
        FAMILIES.into_iter().find(|f| f.name() == name).ok_or_else(|| Error::Unknown {
            what: "gait",
            name: name.into(),
            known: FAMILIES.map(GaitFamily::name).join(", "),
        })
    }

    /// Typical values for a robot with this number of feet.
    pub fn typical(self, feet: usize) -> Typical {
        let (duty, swing, speed) = match self {
            GaitFamily::Walk if feet == 2 => (0.6, 1.1, 0.5),
            GaitFamily::Walk => (0.7, 0.9, 0.4),
            GaitFamily::Trot | GaitFamily::Pace | GaitFamily::Bound | GaitFamily::Canter => (0.5, 1., 0.65),
            GaitFamily::RotaryGallop | GaitFamily::TransverseGallop => (0.45, 1., 0.7),
            GaitFamily::Pronk => (0.5, 0.8, 0.5),
            GaitFamily::Hop => (0.6, 0.8, 0.5),
            GaitFamily::Run => (0.45, 1.1, 0.8),
            GaitFamily::Tripod | GaitFamily::Alternating => (0.5, 1., 0.65),
            GaitFamily::Tetrapod | GaitFamily::Ripple => (0.67, 1., 0.5),
            GaitFamily::Wave => (1. - 1. / feet.max(2) as f64, 1., 0.4),
        };
        Typical { duty, swing, speed }
    }
}

/// Arrangement of the feet.
#[derive(Debug, Clone, PartialEq)]
enum Places {
    /// Pairs one behind the other: row of each foot, counted from the front, and true for a left foot.
    Pairs(Vec<(usize, bool)>),
    /// Any other arrangement: rank of each foot by its angle around the centre of all feet.
    Ring(Vec<usize>),
}

impl Places {
    /// Arrangement of a robot's feet, by their nominal positions.
    ///
    /// Feet form pairs if equally many are left and right of the centre, and both feet of a pair are in front of both feet of the next.
    fn of(robot: &Robot) -> Places {
        let feet = &robot.nominal_feet;
        let middle = [0, 1].map(|axis| feet.iter().map(|f| f[axis]).sum::<f64>() / feet.len() as f64);
        let side = |left: bool| {
            let mut side: Vec<usize> =
                (0..feet.len()).filter(|&f| if left { feet[f][1] > middle[1] } else { feet[f][1] < middle[1] }).collect();
            side.sort_by(|&a, &b| feet[b][0].total_cmp(&feet[a][0]));
            side
        };
        let (left, right) = (side(true), side(false));
        let rows: Vec<[f64; 2]> = left.iter().zip(&right).map(|(&l, &r)| [feet[l][0], feet[r][0]]).collect();
        let apart = rows.windows(2).all(|w| w[0][0].min(w[0][1]) > w[1][0].max(w[1][1]));
        if left.len() == right.len() && 2 * left.len() == feet.len() && apart {
            let mut places = vec![(0, false); feet.len()];
            for row in 0..left.len() {
                places[left[row]] = (row, true);
                places[right[row]] = (row, false);
            }
            return Places::Pairs(places);
        }
        let angle = |f: usize| (feet[f][1] - middle[1]).atan2(feet[f][0] - middle[0]);
        let mut order: Vec<usize> = (0..feet.len()).collect();
        order.sort_by(|&a, &b| angle(a).total_cmp(&angle(b)));
        let mut ranks = vec![0; feet.len()];
        for (rank, foot) in order.into_iter().enumerate() {
            ranks[foot] = rank;
        }
        Places::Ring(ranks)
    }
}

/// Families that a robot can have, the most likely to work first.
pub fn families(robot: &Robot) -> Vec<GaitFamily> {
    let known: Vec<GaitFamily> = FAMILIES.into_iter().filter(|&f| known_offsets(f, robot).is_some()).collect();
    // On these robots wave and alternating gait duplicate families that they have already, except the hexapod's wave.
    match (robot.feet(), Places::of(robot)) {
        (1, _) | (2 | 4, Places::Pairs(_)) => {
            known.into_iter().filter(|f| !matches!(f, GaitFamily::Wave | GaitFamily::Alternating)).collect()
        }
        (6, Places::Pairs(_)) => known.into_iter().filter(|&f| f != GaitFamily::Alternating).collect(),
        _ => known,
    }
}

/// Families that a search of all gaits draws from: those of [`families`] without the pace, and for soles without flight phases.
///
/// With its best motion and durations a pace is often a quadruped's cheapest gait. But it stands on the legs of one side, and nothing in
/// the cost keeps it from tipping over: of nine paces played in MuJoCo five fell, of 39 other gaits none.
///
/// Between rests a run of a humanoid costs as much as a walk, to 1 or 2 %, although at constant speed a walk costs 5 to 19 % less below a
/// Froude number of 0.5.
pub fn default_families(robot: &Robot) -> Vec<GaitFamily> {
    let flies = |family: GaitFamily| matches!(family, GaitFamily::Run | GaitFamily::Hop);
    let left_out = |family: GaitFamily| family == GaitFamily::Pace || robot.sole.is_some() && flies(family);
    families(robot).into_iter().filter(|family| !left_out(*family)).collect()
}

/// Phase offset of each foot, in \[0, 1\): the fraction of a stride after which it lifts off.
///
/// # Errors
/// [`Error::Unknown`] if the robot cannot have the family; it lists those that it can have.
pub fn offsets(family: GaitFamily, robot: &Robot) -> Result<Vec<f64>> {
    known_offsets(family, robot).ok_or_else(|| Error::Unknown {
        what: "gait of this robot",
        name: family.name().into(),
        known: families(robot).into_iter().map(GaitFamily::name).collect::<Vec<_>>().join(", "),
    })
}

fn known_offsets(family: GaitFamily, robot: &Robot) -> Option<Vec<f64>> {
    let feet = robot.feet();
    let places = match Places::of(robot) {
        Places::Pairs(places) => places,
        Places::Ring(ranks) => {
            return match family {
                GaitFamily::Wave => Some(ranks.iter().map(|&rank| rank as f64 / feet as f64).collect()),
                GaitFamily::Alternating => Some(ranks.iter().map(|&rank| 0.5 * (rank % 2) as f64).collect()),
                GaitFamily::Hop if feet == 1 => Some(vec![0.]),
                _ => None,
            };
        }
    };
    let rows = feet / 2;
    // Offset of the left or right foot of a row, counted from the front.
    let offset = |row: usize, left: bool| -> Option<f64> {
        let front = row == 0;
        // From hind to front on the left; later by `right` on the right.
        let wave = |step: f64, right: f64| ((rows - 1 - row) as f64 * step + if left { 0. } else { right }) % 1.;
        let of_four = |table: [f64; 4]| table[2 * row + usize::from(!left)];
        Some(match (family, feet) {
            (GaitFamily::Wave, _) | (GaitFamily::Walk, 4) => wave(1. / feet as f64, 0.5),
            (GaitFamily::Alternating, _) | (GaitFamily::Walk | GaitFamily::Run, 2) | (GaitFamily::Trot, 4) | (GaitFamily::Tripod, 6) => {
                0.5 * ((row + usize::from(!left)) % 2) as f64
            }
            (GaitFamily::Hop, 2) | (GaitFamily::Pronk, 4) => 0.,
            (GaitFamily::Pace, 4) => {
                if left {
                    0.
                } else {
                    0.5
                }
            }
            (GaitFamily::Bound, 4) => {
                if front {
                    0.
                } else {
                    0.5
                }
            }
            (GaitFamily::Canter, 4) => of_four([0.3, 0., 0., 0.7]),
            (GaitFamily::RotaryGallop, 4) => of_four([0., 0.1, 0.6, 0.5]),
            (GaitFamily::TransverseGallop, 4) => of_four([0.1, 0., 0.6, 0.5]),
            (GaitFamily::Tetrapod, 6) => wave(1. / 3., 2. / 3.),
            (GaitFamily::Ripple, 6) => wave(1. / 3., 0.5),
            _ => return None,
        })
    };
    places.into_iter().map(|(row, left)| offset(row, left)).collect()
}

/// Gait whose feet repeat one stride.
///
/// With `P = swing + stance` and `n = strides`, the motion takes `T = lead_in + n P + P max(phi) + tail`. Foot `i` stands for
/// `lead_in + phi_i P`, then swings for `swing` and stands for `stance`, `n` times; its last stance is stretched to `T`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PeriodicGait {
    /// Family that defines the offsets.
    pub family: GaitFamily,
    /// Phase offset `phi` of each foot, in strides, at least 0.
    pub offsets: Vec<f64>,
    /// Duration of a swing, s.
    pub swing: f64,
    /// Duration of a stance between two swings, s.
    pub stance: f64,
    /// Number of strides; with 0 all feet stand.
    pub strides: usize,
    /// Time during which all feet stand at the start, s.
    pub lead_in: f64,
    /// Time during which all feet stand at the end, in addition to `stance`, s.
    pub tail: f64,
}

/// Duration of the first stance of a typical gait, [`time_scale`]s.
pub const TYPICAL_LEAD_IN: f64 = 1.;
/// Tail of a typical gait, [`time_scale`]s.
pub const TYPICAL_TAIL: f64 = 0.5;

impl PeriodicGait {
    /// Gait of a family at its typical values, with the number of strides that a task requires.
    ///
    /// # Errors
    /// The errors of [`offsets`].
    pub fn typical(family: GaitFamily, task: &Task) -> Result<PeriodicGait> {
        let (robot, time) = (&task.robot, time_scale(&task.robot));
        let Typical { duty, swing, speed } = family.typical(robot.feet());
        let gait = PeriodicGait {
            family,
            offsets: offsets(family, robot)?,
            swing: swing * time,
            stance: swing * time * duty / (1. - duty),
            strides: 0,
            lead_in: TYPICAL_LEAD_IN * time,
            tail: TYPICAL_TAIL * time,
        };
        Ok(gait.for_travel(task, speed * speed_scale(robot)))
    }

    /// Sets the number of strides that a task requires at a travel speed in m/s; zero if the goal is the start.
    ///
    /// The travel speed is the highest speed at which a nominal foothold moves with the base, including turns. It is reduced to a speed
    /// that the feet can follow, see [`PeriodicGait::least_horizon`]. The strides fill the duration of the task, if it has one. Their number
    /// is rounded up.
    pub fn for_travel(self, task: &Task, speed: f64) -> PeriodicGait {
        let [x, y] = task.displacement();
        if x.hypot(y) < STILL && task.turn().abs() < STILL {
            return PeriodicGait { strides: 0, ..self };
        }
        let least = self.least_horizon(task, speed).max(task.duration.unwrap_or_default());
        let missing = least - PeriodicGait { strides: 0, ..self.clone() }.horizon();
        // The margin avoids a whole stride for a rounding error. The cast saturates for numbers that are too large and for NaN.
        let strides = (missing / self.period() - 1e-9).ceil().max(1.) as usize;
        PeriodicGait { strides, ..self }
    }

    /// Shortest horizon for a task at a travel speed in m/s, s.
    ///
    /// On the line from start to goal with an even turn, a nominal foothold moves by `w = R' (x, y) + yaw e_z x foot` in the base frame per
    /// unit of the path. The highest speed is 1 / [`MEAN_SPEED`] of the mean speed. At that speed, `w` must not be faster than `speed`,
    /// must not leave [`REACH_SHARE`] of the reach within a stance, and must not make the foot, which catches up during the swing only,
    /// faster than [`FOOT_SPEED_SCALED`]. The base must not accelerate faster than [`ACCELERATION`], where a rad of yaw counts as `l`.
    pub fn least_horizon(&self, task: &Task, speed: f64) -> f64 {
        /// Number of parts of the path that are examined.
        const PARTS: usize = 32;
        let (robot, yaw) = (&task.robot, task.turn());
        let [x, y] = task.displacement();
        let fastest = FOOT_SPEED_SCALED * speed_scale(robot) * self.swing / (TOP_SPEED * self.period());
        let speed = speed.min(fastest);
        let mut least: f64 = 0.;
        for part in 0..=PARTS {
            let (sin, cos) = (yaw * part as f64 / PARTS as f64).sin_cos();
            for (number, foot) in robot.nominal_feet.iter().enumerate() {
                let rate = [cos * x + sin * y - yaw * foot[1], cos * y - sin * x + yaw * foot[0]];
                least = least.max(rate[0].hypot(rate[1]) / speed);
                for axis in 0..2 {
                    least = least.max(rate[axis].abs() * self.stance / (REACH_SHARE * robot.reach.width(number, axis)));
                }
            }
        }
        let acceleration = ACCELERATION * GRAVITY * task.terrain.friction.min(1.);
        let distance = x.hypot(y) + robot.base_height * yaw.abs();
        // From rest to distance / (MEAN_SPEED T) in a ramp of (1 - MEAN_SPEED) T.
        let ramps = (distance / (MEAN_SPEED * (1. - MEAN_SPEED) * acceleration)).sqrt();
        ramps.max(least / MEAN_SPEED)
    }

    /// Duration of a stride, s.
    pub fn period(&self) -> f64 {
        self.swing + self.stance
    }

    /// Share of a stride in which a foot stands.
    pub fn duty(&self) -> f64 {
        self.stance / self.period()
    }

    /// Duration of the motion, s.
    pub fn horizon(&self) -> f64 {
        let latest = self.offsets.iter().copied().fold(0., f64::max);
        self.lead_in + (self.strides as f64 + latest) * self.period() + self.tail
    }

    /// Schedule of the gait.
    ///
    /// # Errors
    /// [`Error::Invalid`] for offsets that are negative or not finite, for more strides than a schedule can hold, and the errors of
    /// [`Schedule::new`].
    pub fn schedule(&self) -> Result<Schedule> {
        check_range("strides", self.strides as f64, 0., ((MAX_PHASES - 1) / 2) as f64)?;
        for (foot, &offset) in self.offsets.iter().enumerate() {
            check_range(&format!("offsets[{foot}]"), offset, 0., 100.)?;
        }
        let horizon = self.horizon();
        let foot = |offset: &f64| {
            let mut durations = vec![self.lead_in + offset * self.period()];
            durations.extend([self.swing, self.stance].repeat(self.strides));
            let end: f64 = durations.iter().sum();
            if let Some(last) = durations.last_mut() {
                *last += horizon - end;
            }
            durations
        };
        Schedule::new(self.offsets.iter().map(foot).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::ROBOTS;
    use crate::scenario::Scenario;
    use crate::task::Goal;
    use crate::terrain::Terrain;
    use std::f64::consts::PI;

    fn task(robot: &str, x: f64, y: f64, yaw: f64) -> Task {
        Task::new(Robot::named(robot).unwrap(), Terrain::flat(), Goal::at(x, y).yaw(yaw)).unwrap()
    }

    #[test]
    fn built_in_robots_have_the_gaits_of_their_kind() {
        let names = |robot| families(&Robot::named(robot).unwrap()).into_iter().map(GaitFamily::name).collect::<Vec<_>>();
        assert_eq!(names("monoped"), ["hop"]);
        assert_eq!(names("biped"), ["walk", "run", "hop"]);
        assert_eq!(names("anymal"), ["trot", "walk", "pace", "bound", "canter", "rotary-gallop", "transverse-gallop", "pronk"]);
        assert_eq!(names("pexod"), ["tripod", "tetrapod", "ripple", "wave"]);
    }

    #[test]
    fn names_survive_json_and_errors_list_what_is_known() {
        for family in FAMILIES {
            assert_eq!(serde_json::to_string(&family).unwrap(), format!("\"{}\"", family.name()));
            assert_eq!(GaitFamily::named(family.name()).unwrap(), family);
        }
        assert!(GaitFamily::named("crawl").unwrap_err().to_string().contains("walk"));
        let refused = offsets(GaitFamily::Trot, &Robot::named("biped").unwrap()).unwrap_err().to_string();
        assert_eq!(refused, "unknown gait of this robot `trot`; known: walk, run, hop");
    }

    #[test]
    fn offsets_of_the_quadruped_match_the_literature() {
        // Left front, right front, left hind, right hind.
        let of = |family| offsets(family, &Robot::named("anymal").unwrap()).unwrap();
        assert_eq!(of(GaitFamily::Trot), [0., 0.5, 0.5, 0.]);
        assert_eq!(of(GaitFamily::Walk), [0.25, 0.75, 0., 0.5]);
        assert_eq!(of(GaitFamily::Pace), [0., 0.5, 0., 0.5]);
        assert_eq!(of(GaitFamily::Bound), [0., 0., 0.5, 0.5]);
        assert_eq!(of(GaitFamily::Pronk), [0.; 4]);
        // A diagonal pair together, the other two feet before and after it.
        assert_eq!(of(GaitFamily::Canter), [0.3, 0., 0., 0.7]);
        // Right hind, left hind, then left front first in the rotary, right front first in the transverse gallop.
        assert_eq!(of(GaitFamily::RotaryGallop), [0., 0.1, 0.6, 0.5]);
        assert_eq!(of(GaitFamily::TransverseGallop), [0.1, 0., 0.6, 0.5]);
        assert_eq!(of(GaitFamily::Wave), of(GaitFamily::Walk));
        assert_eq!(of(GaitFamily::Alternating), of(GaitFamily::Trot));
    }

    #[test]
    fn offsets_of_two_and_six_feet() {
        let of = |robot, family| offsets(family, &Robot::named(robot).unwrap()).unwrap();
        assert_eq!(of("biped", GaitFamily::Walk), [0., 0.5]);
        assert_eq!(of("biped", GaitFamily::Hop), [0., 0.]);
        assert_eq!(of("monoped", GaitFamily::Hop), [0.]);
        // Front, middle, hind; left and right of each.
        assert_eq!(of("pexod", GaitFamily::Tripod), [0., 0.5, 0.5, 0., 0., 0.5]);
        let near = |got: Vec<f64>, sixths: [i32; 6]| {
            assert!(got.iter().zip(sixths).all(|(g, s)| (g - f64::from(s) / 6.).abs() < 1e-15), "{got:?}");
        };
        near(of("pexod", GaitFamily::Wave), [2, 5, 1, 4, 0, 3]);
        near(of("pexod", GaitFamily::Tetrapod), [4, 2, 2, 0, 0, 4]);
        near(of("pexod", GaitFamily::Ripple), [4, 1, 2, 5, 0, 3]);
    }

    #[test]
    fn the_order_of_the_feet_does_not_change_the_gait() {
        for name in ["anymal", "pexod", "biped"] {
            let robot = Robot::named(name).unwrap();
            let n = robot.feet();
            let order: Vec<usize> = (0..n).map(|i| (i * 5 + 3) % n).collect();
            let shuffled = Robot { nominal_feet: order.iter().map(|&f| robot.nominal_feet[f]).collect(), ..robot.clone() };
            assert_eq!(families(&robot), families(&shuffled));
            for family in families(&robot) {
                let (had, got) = (offsets(family, &robot).unwrap(), offsets(family, &shuffled).unwrap());
                assert_eq!(got, order.iter().map(|&f| had[f]).collect::<Vec<_>>(), "{name}, {}", family.name());
            }
        }
    }

    #[test]
    fn other_arrangements_get_the_wave_and_the_alternating_gait() {
        let anymal = Robot::named("anymal").unwrap();
        let with = |feet: Vec<[f64; 3]>| Robot { nominal_feet: feet, ..anymal.clone() };
        // Feet in a plus: front, left, hind, right. By angle around the centre: right, front, left, hind.
        let plus = with(vec![[0.3, 0., -0.4], [0., 0.3, -0.4], [-0.3, 0., -0.4], [0., -0.3, -0.4]]);
        let three = with(vec![[0.3, 0., -0.4], [-0.2, 0.3, -0.4], [-0.2, -0.3, -0.4]]);
        let eight = with((0..8).map(|i| [0.3 - 0.2 * (i / 2) as f64, if i % 2 == 0 { 0.2 } else { -0.2 }, -0.4]).collect());
        for robot in [&plus, &three, &eight] {
            assert_eq!(families(robot), [GaitFamily::Wave, GaitFamily::Alternating]);
        }
        let mut wave = offsets(GaitFamily::Wave, &plus).unwrap();
        assert_eq!(offsets(GaitFamily::Alternating, &plus).unwrap()[0], offsets(GaitFamily::Alternating, &plus).unwrap()[2]);
        wave.sort_by(f64::total_cmp);
        assert_eq!(wave, [0., 0.25, 0.5, 0.75]);
        assert_eq!(offsets(GaitFamily::Alternating, &eight).unwrap(), [0., 0.5, 0.5, 0., 0., 0.5, 0.5, 0.]);
    }

    #[test]
    fn a_trot_of_two_strides_in_numbers() {
        // P = 0.5, T = 0.3 + 2 * 0.5 + 0.5 * 0.5 + 0.1 = 1.65.
        let robot = Robot::named("anymal").unwrap();
        let gait = PeriodicGait {
            family: GaitFamily::Trot,
            offsets: offsets(GaitFamily::Trot, &robot).unwrap(),
            swing: 0.2,
            stance: 0.3,
            strides: 2,
            lead_in: 0.3,
            tail: 0.1,
        };
        let near = |got: &[f64], want: [f64; 5]| got.len() == 5 && got.iter().zip(want).all(|(g, w)| (g - w).abs() < 1e-12);
        let schedule = gait.schedule().unwrap();
        for foot in [0, 3] {
            assert!(near(&schedule.durations()[foot], [0.3, 0.2, 0.3, 0.2, 0.65]), "{:?}", schedule.durations());
        }
        for foot in [1, 2] {
            assert!(near(&schedule.durations()[foot], [0.55, 0.2, 0.3, 0.2, 0.4]), "{:?}", schedule.durations());
        }
        assert!((gait.horizon() - 1.65).abs() < 1e-12 && (gait.duty() - 0.6).abs() < 1e-12);
        assert!(PeriodicGait { offsets: vec![-0.1; 4], ..gait.clone() }.schedule().unwrap_err().to_string().contains("offsets[0]"));
        assert!(PeriodicGait { strides: 501, ..gait }.schedule().unwrap_err().to_string().contains("strides"));
    }

    #[test]
    fn diagonal_pairs_of_a_trot_never_swing_together() {
        let gait = PeriodicGait::typical(GaitFamily::Trot, &task("anymal", 2., 0., 0.)).unwrap();
        let schedule = gait.schedule().unwrap();
        assert!(gait.duty() >= 0.5);
        for a in schedule.phases(0).iter().filter(|p| !p.stance) {
            assert!(schedule.phases(1).iter().filter(|p| !p.stance).all(|b| b.end <= a.start + 1e-9 || b.start >= a.end - 1e-9));
        }
        assert_eq!(schedule.durations()[0], schedule.durations()[3]);
    }

    #[test]
    fn standing_still_is_one_stance_per_foot() {
        for name in ROBOTS {
            let task = task(name, 0., 0., 0.);
            for family in families(&task.robot) {
                let gait = PeriodicGait::typical(family, &task).unwrap();
                assert_eq!(gait.strides, 0);
                assert!(gait.schedule().unwrap().durations().iter().all(|d| d.len() == 1));
            }
        }
    }

    #[test]
    fn every_family_of_every_robot_has_valid_schedules_for_every_goal() {
        for name in ROBOTS {
            for (x, y, yaw) in [(0.1, 0., 0.), (6., 0., PI), (-2., 0., 0.), (0., 2., 0.), (0., 0., PI), (0., 0., -0.01), (10., 0., 0.)] {
                let task = task(name, x, y, yaw);
                for family in families(&task.robot) {
                    let gait = PeriodicGait::typical(family, &task).unwrap();
                    let schedule = gait.schedule().unwrap();
                    assert!(gait.strides >= 1 && schedule.feet() == task.robot.feet());
                    assert!((schedule.horizon() - gait.horizon()).abs() < 1e-9);
                    // No phase is shorter than the shortest requested one.
                    let floor = MIN_PHASE_SCALED * time_scale(&task.robot);
                    assert!(schedule.durations().iter().flatten().all(|&d| d >= floor - 1e-9), "{name} {}", family.name());
                }
            }
        }
    }

    #[test]
    fn strides_follow_from_speed_and_reach() {
        let gait = |stance| PeriodicGait {
            family: GaitFamily::Trot,
            offsets: vec![0., 0.5, 0.5, 0.],
            swing: 0.25,
            stance,
            strides: 0,
            lead_in: 0.2,
            tail: 0.05,
        };
        let straight = Scenario::named("s1").unwrap().task_to([7., 0.]).unwrap();
        // 7 m at 0.5 m/s, 0.35 m/s on average: 20 s. Lead-in, tail and half a stride of 0.5 s take 0.5 s: 39 strides remain.
        assert_eq!(gait(0.25).for_travel(&straight, 0.5).strides, 39);
        // With more time, strides fill it; with less, those that the speed needs remain.
        let lasting = |duration: f64| Task { duration: Some(duration), ..straight.clone() };
        assert_eq!([25., 10.].map(|duration| gait(0.25).for_travel(&lasting(duration), 0.5).strides), [49, 39]);
        // With a stance of 0.6 s the base can travel at 0.3 / 0.6 = 0.5 m/s: 20 s.
        assert!((gait(0.6).least_horizon(&straight, 1.) - 20.).abs() < 1e-9);
        // The reach to the side is two thirds of that: 30 s.
        let sideways = Scenario::named("s1").unwrap().task_to([0., 7.]).unwrap();
        assert!((gait(0.6).least_horizon(&sideways, 1.) - 30.).abs() < 1e-9);
        // A hind foot that reaches only 0.05 m ahead has two thirds of the range: 30 s.
        let side = |ahead: f64| [[-0.15, ahead], [-0.1, 0.1], [-0.1, 0.1]];
        let reach = crate::robot::Reach::boxes(vec![side(0.15), side(0.15), side(0.15), side(0.05)]);
        let mut shorter = straight.clone();
        shorter.robot = std::sync::Arc::new(crate::robot::Robot { reach, ..(*straight.robot).clone() });
        assert!((gait(0.6).least_horizon(&shorter, 1.) - 30.).abs() < 1e-9);
        // Half a turn on the spot: feet travel 0.34 pi to the side, with 0.2 m per stance of 0.5 s.
        let turn = task("anymal", 0., 0., PI);
        assert!((gait(0.5).least_horizon(&turn, 9.) - 0.34 * PI * 0.5 / 0.2 / 0.7).abs() < 1e-9);
        // With short stances the turn of the body limits: 0.5 pi at 0.15 g in ramps of 0.3 T, to 1 / 0.7 of the mean speed.
        assert!((gait(0.2).least_horizon(&turn, 9.) - (0.5 * PI / (0.21 * 0.15 * 9.80665)).sqrt()).abs() < 1e-9);
        // A foot has half of the time to cover the whole distance: at most 1.9 sqrt(g l) / 1.35 / 2 = 1.558 m/s.
        let limit = 1.9 * (9.80665f64 * 0.5).sqrt() / 1.35 / 2.;
        let short = PeriodicGait { swing: 0.05, stance: 0.05, ..gait(0.25) };
        assert!((short.least_horizon(&straight, 9.) - 7. / limit / 0.7).abs() < 1e-9);
    }

    #[test]
    fn scales_of_a_robot_half_a_metre_high() {
        let robot = Robot::named("anymal").unwrap();
        assert!((time_scale(&robot) - 0.2258).abs() < 1e-4 && (speed_scale(&robot) - 2.2144).abs() < 1e-4);
        assert!((froude(&robot, speed_scale(&robot)) - 1.).abs() < 1e-12);
    }
}
