//! Trajectories as Hermite nodes, in the form of TOWR's variables \[3\]. `solve` writes them and `verify` reads them.

use super::schedule::{lands_after, starts_in_swing};
use crate::error::{Error, Result};
use crate::robot::Robot;
use crate::task::{BaseState, SwingState};
use crate::terrain::Terrain;
use serde::de::value::MapAccessDeserializer;
use serde::de::{self, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;
use std::marker::PhantomData;

/// Piecewise cubic Hermite curve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Curve {
    /// Durations of the pieces, s.
    pub poly_durations: Vec<f64>,
    /// Nodes at the ends of the pieces, one more than pieces: value and slope, `[x, y, z, dx/dt, dy/dt, dz/dt]`.
    pub nodes: Vec<[f64; 6]>,
}

impl Curve {
    /// Value and slope at the end.
    pub fn end(&self) -> [[f64; 3]; 2] {
        self.nodes.last().map_or([[0.; 3]; 2], |&[x, y, z, dx, dy, dz]| [[x, y, z], [dx, dy, dz]])
    }

    /// Checks that sizes agree and numbers are finite.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the piece or the node.
    pub fn validate(&self, place: &str) -> Result<()> {
        if self.poly_durations.is_empty() || self.nodes.len() != self.poly_durations.len() + 1 {
            return Err(Error::invalid(
                format!("{place}.nodes"),
                format!("{} nodes for {} pieces", self.nodes.len(), self.poly_durations.len()),
                "at least one piece and one node more than pieces",
            ));
        }
        for (i, d) in self.poly_durations.iter().enumerate() {
            if !(d.is_finite() && *d > 0.) {
                return Err(Error::invalid(format!("{place}.poly_durations[{i}]"), d, "a positive number of seconds"));
            }
        }
        for (i, node) in self.nodes.iter().enumerate() {
            if let Some(v) = node.iter().find(|v| !v.is_finite()) {
                return Err(Error::invalid(format!("{place}.nodes[{i}]"), v, "a finite number"));
            }
        }
        Ok(())
    }
}

/// Motion and force of one foot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FootCurves {
    /// Position, world frame, m and m/s.
    pub motion: Curve,
    /// Contact force on the robot, world frame, N and N/s. That of a sole acts at its centre.
    pub force: Curve,
    /// Contact moment of a sole on the robot about its centre, world frame, N m and N m/s. Absent for a ball or point.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moment: Option<Curve>,
    /// Yaw of a sole in each stance, world frame, rad; absent for a ball or point. In a swing from `a` to `b` it is
    /// `a + (b - a) (3 u^2 - 2 u^3)` at fraction `u` of the swing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub yaws: Option<Vec<f64>>,
}

/// Part of the turn of a sole that is done at fraction `u` of its swing.
pub(crate) fn turn_done(u: f64) -> f64 {
    u * u * (3. - 2. * u)
}

/// Yaw of one sole over time.
pub(crate) struct SoleYaws {
    /// Phase durations, s; stances are even.
    durations: Vec<f64>,
    /// Yaw in each stance, rad.
    yaws: Vec<f64>,
}

impl SoleYaws {
    /// Yaw at a time, rad.
    pub fn at(&self, time: f64) -> f64 {
        let mut start = 0.;
        for (phase, &duration) in self.durations.iter().enumerate() {
            if time < start + duration {
                let (from, to) = (self.yaws[phase / 2], self.yaws[phase.div_ceil(2)]);
                return from + (to - from) * turn_done(((time - start) / duration).max(0.));
            }
            start += duration;
        }
        self.yaws.last().copied().unwrap_or(0.)
    }
}

impl FootCurves {
    /// Curves of a ball or point.
    pub fn new(motion: Curve, force: Curve) -> FootCurves {
        FootCurves { motion, force, moment: None, yaws: None }
    }
}

/// Name of a built-in description, or a complete description of the user's own.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(untagged)]
pub enum NamedOr<T> {
    /// Name of a built-in description.
    Name(String),
    /// Complete description.
    Own(T),
}

/// Selects the variant by the type of the value, so that errors are those of the description.
impl<'de, T: Deserialize<'de>> Deserialize<'de> for NamedOr<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct Kinds<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Kinds<T> {
            type Value = NamedOr<T>;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a name or an object")
            }

            fn visit_str<E: de::Error>(self, name: &str) -> std::result::Result<NamedOr<T>, E> {
                Ok(NamedOr::Name(name.into()))
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> std::result::Result<NamedOr<T>, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map)).map(NamedOr::Own)
            }
        }
        deserializer.deserialize_any(Kinds(PhantomData))
    }
}

/// Conditions on the velocity of the base at the goal, and on its pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum GoalVelocity {
    /// Velocity of the goal: zero unless the goal specifies another one.
    Zero,
    /// Any velocity.
    Free,
    /// Any pose and velocity. Their distance from the goal is a term of the cost.
    Near,
}

/// Limits that a motion was computed to satisfy, in addition to its rows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct MotionLimits {
    /// Smallest height of a foot above the terrain in mid-swing, m.
    pub clearance: f64,
    /// Largest height of a foot in mid-swing, above the highest of lift-off, touchdown and the terrain there, m.
    pub swing_height: f64,
    /// Largest horizontal speed of a foot, m/s.
    pub foot_speed: f64,
    /// Largest acceleration of a swinging foot, m/s²; unlimited if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub foot_acceleration: Option<f64>,
    /// Velocity of the base at the goal.
    pub goal_velocity: GoalVelocity,
}

/// Motion with its contact schedule and forces. Unknown keys are ignored on reading.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Trajectory {
    /// Scenario that it belongs to, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scenario: Option<String>,
    /// Target of the scenario, 1 to 20.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<usize>,
    /// Robot; taken from the scenario if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub robot: Option<NamedOr<Robot>>,
    /// Terrain; taken from the scenario if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub terrain: Option<NamedOr<Terrain>>,
    /// Transcription whose rows it was computed to satisfy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transcription: Option<String>,
    /// Seed of the search that found it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Version of the program that wrote it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub version: Option<String>,
    /// Base position at the start, m; above the origin if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub init_base: Option<[f64; 3]>,
    /// Base at the start, if it is not at rest, level and with yaw 0; its position equals `init_base`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<BaseState>,
    /// Position of each foot at the start (x, y), m; its nominal position under the base if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_feet: Option<Vec<[f64; 2]>>,
    /// State of each foot that is in the air at the start, `null` for a foot that stands; all feet stand if absent. `[feet]`
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_swings: Option<Vec<Option<SwingState>>>,
    /// Yaw of each sole at the start, world frame, rad; that of the base if absent. `[feet]`
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_yaws: Option<Vec<f64>>,
    /// Requested base position at the end, m.
    pub base_target: [f64; 3],
    /// Requested yaw at the end, rad.
    pub yaw_target: f64,
    /// Requested base at the end, if it is not at rest and level; position and yaw equal `base_target` and `yaw_target`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub goal: Option<BaseState>,
    /// Largest normal force of a foot that it was computed for, N.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_limit: Option<f64>,
    /// Further limits that it was computed to satisfy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limits: Option<MotionLimits>,
    /// Phase durations, s, `[feet][phases]`.
    pub durations: Vec<Vec<f64>>,
    /// Horizon, s.
    #[serde(rename = "T")]
    pub horizon: f64,
    /// Base position, world frame.
    pub base_lin: Curve,
    /// Base Euler angles roll, pitch and yaw and their rates; rotation `Rz(yaw) Ry(pitch) Rx(roll)`.
    pub base_ang: Curve,
    /// Curves of each foot.
    pub ee: Vec<FootCurves>,
}

impl Trajectory {
    /// Creates a motion from its curves. Its goal is the place where its base ends; all labels and limits are absent.
    ///
    /// * `durations` - s, `[feet][phases]`
    /// * `horizon` - s
    /// * `base` - curves of the position and of the Euler angles
    pub fn new(durations: Vec<Vec<f64>>, horizon: f64, [base_lin, base_ang]: [Curve; 2], ee: Vec<FootCurves>) -> Trajectory {
        Trajectory {
            scenario: None,
            target: None,
            robot: None,
            terrain: None,
            transcription: None,
            seed: None,
            version: None,
            init_base: None,
            start: None,
            start_feet: None,
            start_swings: None,
            start_yaws: None,
            base_target: base_lin.end()[0],
            yaw_target: base_ang.end()[0][2],
            goal: None,
            force_limit: None,
            limits: None,
            durations,
            horizon,
            base_lin,
            base_ang,
            ee,
        }
    }

    /// Reads a trajectory from JSON text and checks its form.
    ///
    /// # Errors
    /// [`Error::Format`] for malformed JSON; [`Error::Invalid`] for inconsistent sizes or impossible numbers.
    pub fn from_json(text: &str) -> Result<Trajectory> {
        let trajectory: Trajectory = crate::error::from_json(text)?;
        trajectory.validate()?;
        Ok(trajectory)
    }

    /// Requested base at the end.
    pub fn goal_state(&self) -> BaseState {
        self.goal.unwrap_or(BaseState::level(self.base_target, self.yaw_target))
    }

    /// Base at the start. If the file does not specify it: above the origin, at the robot's base height.
    pub fn start_state(&self, robot: &Robot, terrain: &Terrain) -> BaseState {
        let position = || self.init_base.unwrap_or([0., 0., robot.base_height + terrain.height(0., 0.)]);
        self.start.unwrap_or_else(|| BaseState::level(position(), 0.))
    }

    /// Base at the end of the curves.
    pub fn end_state(&self) -> BaseState {
        let [[position, velocity], [angles, rates]] = [&self.base_lin, &self.base_ang].map(Curve::end);
        BaseState { position, angles, velocity, rates }
    }

    /// Position of each foot at the end of the curves (x, y), world frame, m.
    pub fn end_feet(&self) -> Vec<[f64; 2]> {
        let end = |foot: &FootCurves| {
            let [[x, y, _], _] = foot.motion.end();
            [x, y]
        };
        self.ee.iter().map(end).collect()
    }

    /// State of each foot that is in the air at the end; `None` for a foot that stands. `[feet]`
    pub fn end_swings(&self) -> Vec<Option<SwingState>> {
        let end = |foot: usize| {
            let (phases, [position, velocity]) = (&self.durations[foot], self.ee[foot].motion.end());
            let left = lands_after(phases)?;
            // A swing from the start to the end had begun before.
            let before = self.start_swing(foot).filter(|_| phases.len() == 3).map_or(0., |state| state.since);
            Some(SwingState { position, velocity, since: before + phases[phases.len() - 2] - left })
        };
        (0..self.ee.len()).map(end).collect()
    }

    /// Yaw of each sole at the end, rad; `None` for feet without soles. For a foot in the air it is that of its next stance. `[feet]`
    pub fn end_yaws(&self) -> Option<Vec<f64>> {
        self.ee.iter().map(|foot| foot.yaws.as_ref().and_then(|yaws| yaws.last().copied())).collect()
    }

    /// Yaw of a sole over time; `None` for a ball or point.
    pub(crate) fn sole_yaws(&self, foot: usize) -> Option<SoleYaws> {
        let yaws = self.ee[foot].yaws.clone()?;
        Some(SoleYaws { durations: self.durations[foot].clone(), yaws })
    }

    /// State of a foot that is in the air at the start.
    pub fn start_swing(&self, foot: usize) -> Option<SwingState> {
        self.start_swings.as_ref().and_then(|swings| swings.get(foot).copied().flatten())
    }

    /// Checks that a robot has as many feet as the motion.
    ///
    /// # Errors
    /// [`Error::Invalid`] names both numbers.
    pub fn check_feet(&self, robot: &Robot) -> Result<()> {
        if self.ee.len() == robot.feet() {
            return Ok(());
        }
        let limit = format!("{} feet, as the robot `{}` has", robot.feet(), robot.name);
        Err(Error::invalid("ee", format!("{} feet", self.ee.len()), limit))
    }

    /// Checks moment and yaws of a foot: both or neither.
    fn validate_sole(&self, foot: usize) -> Result<()> {
        let FootCurves { moment, yaws, .. } = &self.ee[foot];
        if moment.is_some() != yaws.is_some() {
            let [have, limit] =
                if yaws.is_some() { ["absent", "a curve: the foot has `yaws`"] } else { ["a curve", "absent without `yaws`"] };
            return Err(Error::invalid(format!("ee[{foot}].moment"), have, limit));
        }
        moment.as_ref().map_or(Ok(()), |moment| moment.validate(&format!("ee[{foot}].moment")))?;
        let (Some(yaws), stances) = (yaws, self.durations[foot].len().div_ceil(2)) else { return Ok(()) };
        if yaws.len() != stances {
            return Err(Error::invalid(format!("ee[{foot}].yaws"), format!("{} yaws", yaws.len()), format!("{stances}, one per stance")));
        }
        match yaws.iter().position(|yaw| !yaw.is_finite()) {
            Some(i) => Err(Error::invalid(format!("ee[{foot}].yaws[{i}]"), yaws[i], "a finite number")),
            None => Ok(()),
        }
    }

    /// Checks that repeated statements about start and goal agree.
    fn validate_ends(&self) -> Result<()> {
        let differs = |end: &str, what: String, other: String| Err(Error::invalid(end, what, format!("as elsewhere in the file, {other}")));
        if let Some(start) = &self.start {
            start.validate("start")?;
            if self.init_base.is_some_and(|p| p != start.position) {
                return differs(
                    "start.position",
                    format!("{:?}", start.position),
                    format!("`init_base` {:?}", self.init_base.unwrap_or_default()),
                );
            }
        }
        if let Some(goal) = &self.goal {
            goal.validate("goal")?;
            if (goal.position, goal.yaw()) != (self.base_target, self.yaw_target) {
                let other = format!("`base_target` {:?} and `yaw_target` {}", self.base_target, self.yaw_target);
                return differs("goal", format!("position {:?}, yaw {}", goal.position, goal.yaw()), other);
            }
        }
        if let Some(swings) = &self.start_swings {
            if swings.len() != self.durations.len() {
                let limit = format!("{} feet, as in `durations`", self.durations.len());
                return Err(Error::invalid("start_swings", format!("{} feet", swings.len()), limit));
            }
            for (foot, swing) in swings.iter().enumerate() {
                swing.map_or(Ok(()), |swing| swing.validate(foot))?;
            }
        }
        for (foot, phases) in self.durations.iter().enumerate() {
            let lifted = starts_in_swing(phases);
            if lifted != self.start_swing(foot).is_some() {
                let [have, limit] = if lifted {
                    ["none", "the state of this foot, whose first stance lasts 0 s"]
                } else {
                    ["a state", "`null` for a foot that stands at the start"]
                };
                return Err(Error::invalid(format!("start_swings[{foot}]"), have, limit));
            }
        }
        if let Some(yaws) = &self.start_yaws {
            if yaws.len() != self.durations.len() {
                let limit = format!("{} feet, as in `durations`", self.durations.len());
                return Err(Error::invalid("start_yaws", format!("{} feet", yaws.len()), limit));
            }
            if let Some(yaw) = yaws.iter().find(|yaw| !yaw.is_finite()) {
                return Err(Error::invalid("start_yaws", yaw, "finite numbers"));
            }
        }
        match &self.start_feet {
            Some(feet) if feet.len() != self.durations.len() => Err(Error::invalid(
                "start_feet",
                format!("{} feet", feet.len()),
                format!("{} feet, as in `durations`", self.durations.len()),
            )),
            Some(feet) if feet.iter().flatten().any(|v| !v.is_finite()) => {
                Err(Error::invalid("start_feet", "not finite", "finite numbers"))
            }
            _ => Ok(()),
        }
    }

    /// Checks sizes and numbers; physics is not checked.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the place.
    pub fn validate(&self) -> Result<()> {
        crate::gait::Schedule::new(self.durations.clone())?;
        if self.ee.len() != self.durations.len() {
            return Err(Error::invalid(
                "ee",
                format!("{} feet", self.ee.len()),
                format!("{} feet, as in `durations`", self.durations.len()),
            ));
        }
        self.base_lin.validate("base_lin")?;
        self.base_ang.validate("base_ang")?;
        for (foot, curves) in self.ee.iter().enumerate() {
            curves.motion.validate(&format!("ee[{foot}].motion"))?;
            curves.force.validate(&format!("ee[{foot}].force"))?;
            self.validate_sole(foot)?;
        }
        self.validate_ends()?;
        let finite = self.base_target.iter().chain(self.init_base.iter().flatten()).chain([&self.yaw_target]).all(|v| v.is_finite());
        if !finite {
            return Err(Error::invalid("base_target, yaw_target or init_base", "not finite", "finite numbers"));
        }
        let totals = self.durations.iter().map(|d| d.iter().sum::<f64>());
        let curves = self
            .ee
            .iter()
            .flat_map(|e| [Some(&e.motion), Some(&e.force), e.moment.as_ref()])
            .flatten()
            .chain([&self.base_lin, &self.base_ang]);
        for total in totals.chain(curves.map(|c| c.poly_durations.iter().sum())) {
            if (total - self.horizon).abs() > 1e-6 || !self.horizon.is_finite() {
                return Err(Error::invalid(
                    "T",
                    format!("{} s", self.horizon),
                    format!("the end of every curve and foot; one ends at {total} s"),
                ));
            }
        }
        Ok(())
    }
}
