//! Content of a certificate: families of rows, their tolerances and limits, and the number of violated rows.

use super::curves::readable;
use super::dense::DenseReport;
use super::rollout::RolloutReport;
use crate::robot::{GRAVITY, Robot};
use serde::Serialize;
use std::fmt;

/// Largest violation of a TOWR row that does not count, in the unit of the row: N_vc as in the paper \[1\].
pub const TOLERANCE: f64 = 1e-4;

/// Largest violations that do not count, per kind of quantity.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Tolerances {
    /// Forces, N.
    pub force: f64,
    /// Moments, N m.
    pub moment: f64,
    /// Lengths, m.
    pub length: f64,
    /// Speeds, m/s.
    pub speed: f64,
    /// Accelerations, m/s².
    pub acceleration: f64,
    /// Angles, rad.
    pub angle: f64,
    /// Angular velocities, rad/s.
    pub rate: f64,
}

impl Tolerances {
    /// Tolerances of TOWR's rows.
    pub const TOWR: Tolerances = Tolerances {
        force: TOLERANCE,
        moment: TOLERANCE,
        length: TOLERANCE,
        speed: TOLERANCE,
        acceleration: TOLERANCE,
        angle: TOLERANCE,
        rate: TOLERANCE,
    };

    /// Tolerances of `momentum` motions of a robot with weight `W` and leg length `l`: 1e-4 `W`, 1e-4 `W l`, 5e-4 `l`, 5e-4 `sqrt(g l)`,
    /// 1e-3 `g`, 1e-4 rad and 1e-4 `sqrt(g / l)`.
    pub fn of(robot: &Robot) -> Tolerances {
        let (weight, leg) = (robot.weight(), robot.leg_height());
        Tolerances {
            force: 1e-4 * weight,
            moment: 1e-4 * weight * leg,
            length: 5e-4 * leg,
            speed: 5e-4 * (GRAVITY * leg).sqrt(),
            acceleration: 1e-3 * GRAVITY,
            angle: 1e-4,
            rate: 1e-4 * (GRAVITY / leg).sqrt(),
        }
    }
}

impl fmt::Display for Tolerances {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "tolerances: {:.1e} N, {:.1e} N m, {:.1e} m, {:.1e} m/s, ", self.force, self.moment, self.length, self.speed)?;
        write!(f, "{:.1e} m/s2, {:.1e} rad, {:.1e} rad/s", self.acceleration, self.angle, self.rate)
    }
}

/// Largest distance of the base from its rollout in a `momentum` motion, m.
pub const ROLLOUT_POSITION: f64 = 0.01;
/// Largest angle between the base and its rollout in a `momentum` motion, degrees.
pub const ROLLOUT_ATTITUDE: f64 = 1.;
/// Largest distance of a foot outside its reach box between the instants of a `momentum` motion, m.
pub const DENSE_REACH: f64 = 5e-3;
/// Largest depth of a foot below the terrain between the instants of a `momentum` motion, m.
pub const PENETRATION: f64 = 1e-3;

/// Largest deviation, above or below, of the ground within one radius of a foothold from its plane, in radii.
///
/// An edge whose slope changes by at most 1/2 under the foot counts as flat: it lifts the ball by at most 1/8 of its radius, which a
/// compliant sole absorbs. At a gap or a riser the ground deviates by its depth or height, so a foot stays one full radius away from each
/// that is deeper or higher than half a radius.
pub const FOOTHOLD_PLANE: f64 = 0.5;

/// Largest penetration of the foot ball during a swing, in radii. Equal to the depth that an admissible foothold edge causes: with slopes
/// of 1/4 on both sides `1 - cos(2 atan(1 / 4)) = 0.118`.
pub const BALL_DEPTH: f64 = 0.125;

/// Largest distance of the ground from the plane of a standing sole, m.
pub const SOLE_OFF_GROUND: f64 = 5e-3;
/// Largest yaw of a standing sole relative to the base beyond its limit between the ends of a stance, rad.
pub const DENSE_TURN: f64 = 0.02;

/// Shortest piece of a curve, s. No motion of a robot needs a shorter one.
pub const SHORTEST_PIECE: f64 = 1e-3;
/// Highest speed of a foot in any motion except TOWR's, m/s.
pub const MAX_FOOT_SPEED: f64 = 30.;
/// Largest sum of the absolute Euler rates of the base, in `sqrt(g / l)` with the leg length `l`.
pub const BASE_RATE: f64 = 10.;

/// Families of rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum CheckFamily {
    /// Newton-Euler equations of the base, every 0.1 s and at the end.
    Dynamics,
    /// Momentum, position and attitude at the end of every base piece match the integrated forces. Only for `momentum` motions.
    Momentum,
    /// Continuous acceleration of the base between its pieces. Only for TOWR's own transcription.
    BaseAcceleration,
    /// Feet inside their reach boxes, every 0.08 s and at the end; in `momentum` motions up to [`DENSE_REACH`] outside.
    Reach,
    /// Standing feet on the terrain; mid nodes of a swing not below it.
    Terrain,
    /// Normal force between 0 and its limit, and force inside the friction cone; except for `momentum` motions inside TOWR's pyramid, which
    /// circumscribes it.
    Force,
    /// Swings. In TOWR's own transcription: mid node of a two-piece swing halfway between the footholds, with the velocity that TOWR
    /// prescribes. In `momentum` motions: clearance and swing height in the middle, speed and acceleration of the foot within their limits.
    Swing,
    /// Start of base and feet, goal of the base.
    Bounds,
    /// Properties that TOWR's variables have by construction: standing feet do not move, swinging feet carry no force, nodes at phase
    /// boundaries.
    Structure,
    /// Limits that no robot can exceed, for every transcription and on whole curves: pieces shorter than [`SHORTEST_PIECE`], feet faster
    /// than [`MAX_FOOT_SPEED`], a base that turns faster than [`BASE_RATE`], accelerates more than its feet can push plus one weight, or is
    /// below the terrain; a goal below the terrain.
    Possible,
    /// Excess over the limits that must hold between the instants, on whole curves. Only for `momentum` motions whose other rows hold.
    Motion,
    /// Foot balls, on whole curves: penetration of the ground during a swing up to [`BALL_DEPTH`], and footholds where the ground within
    /// one radius deviates from a plane by at most [`FOOTHOLD_PLANE`]. Only for `momentum` motions on uneven ground whose other rows hold.
    Footing,
    /// Soles, on whole curves: wrenches that forces at the corners can produce, flat ground under standing soles up to [`SOLE_OFF_GROUND`],
    /// soles above the ground in swings up to [`PENETRATION`], yaw relative to the base up to [`DENSE_TURN`] beyond its limit, no overlap.
    /// Only for robots with soles.
    Sole,
}

impl CheckFamily {
    /// Every family, in the order of [`RowReport::families`].
    pub const ALL: [CheckFamily; 13] = [
        CheckFamily::Dynamics,
        CheckFamily::Momentum,
        CheckFamily::BaseAcceleration,
        CheckFamily::Reach,
        CheckFamily::Terrain,
        CheckFamily::Force,
        CheckFamily::Swing,
        CheckFamily::Bounds,
        CheckFamily::Structure,
        CheckFamily::Possible,
        CheckFamily::Motion,
        CheckFamily::Footing,
        CheckFamily::Sole,
    ];

    /// Name, as in JSON.
    pub fn name(self) -> &'static str {
        match self {
            CheckFamily::Dynamics => "dynamics",
            CheckFamily::Momentum => "momentum",
            CheckFamily::BaseAcceleration => "base-acceleration",
            CheckFamily::Reach => "reach",
            CheckFamily::Terrain => "terrain",
            CheckFamily::Force => "force",
            CheckFamily::Swing => "swing",
            CheckFamily::Bounds => "bounds",
            CheckFamily::Structure => "structure",
            CheckFamily::Possible => "possible",
            CheckFamily::Motion => "motion",
            CheckFamily::Footing => "footing",
            CheckFamily::Sole => "sole",
        }
    }

    /// Units of its rows. If there are several, the name of a row identifies its unit.
    pub fn unit(self) -> &'static str {
        match self {
            CheckFamily::Dynamics => "N, N m",
            CheckFamily::Momentum => "N, N m, rad",
            CheckFamily::BaseAcceleration => "m/s2, rad/s2",
            CheckFamily::Reach | CheckFamily::Terrain | CheckFamily::Footing => "m",
            CheckFamily::Force => "N",
            CheckFamily::Swing => "m, m/s",
            CheckFamily::Bounds => "m, rad, 1/s",
            CheckFamily::Structure => "m, m/s, N, N/s, s",
            CheckFamily::Possible => "s, m, m/s, rad/s, m g",
            CheckFamily::Motion => "m, deg, m g",
            CheckFamily::Sole => "m, rad, m g",
        }
    }
}

impl fmt::Display for CheckFamily {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Most violated row of a family, relative to its tolerance.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Worst {
    /// Violation, in the unit of the row; infinite (`null` in JSON) if it was NaN.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub violation: f64,
    /// Name of the row, e.g. `moment x`.
    pub row: String,
    /// Index of the foot; `None` for the base.
    pub foot: Option<usize>,
    /// Time, s.
    pub time: f64,
}

/// Count of the rows of one family.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FamilyReport {
    /// CheckFamily that is counted.
    pub family: CheckFamily,
    /// Units of its rows.
    pub unit: &'static str,
    /// Number of rows.
    pub rows: usize,
    /// Number of rows violated by more than their tolerance.
    pub violated: usize,
    /// Largest violation; 0 without rows.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub max_violation: f64,
    /// Row with the largest violation relative to its tolerance; `None` without rows.
    pub worst: Option<Worst>,
}

/// Count of all rows.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RowReport {
    /// Number of rows.
    pub n_rows: usize,
    /// Number of violated rows: N_vc.
    pub n_violated: usize,
    /// Largest violation of any row, in its own unit.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub max_violation: f64,
    /// True if no row is violated.
    pub feasible: bool,
    /// Largest violations that do not count.
    pub tolerances: Tolerances,
    /// Counts per family, in the order of [`CheckFamily::ALL`].
    pub families: Vec<FamilyReport>,
}

/// Result of [`super::verify`].
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Report {
    /// Violations of the rows.
    #[serde(flatten)]
    pub rows: RowReport,
    /// Worst values between the instants.
    pub dense: DenseReport,
    /// Deviation of the motion integrated under the planned forces alone; `None` if the inertia has no inverse.
    pub rollout: Option<RolloutReport>,
}

impl std::ops::Deref for Report {
    type Target = RowReport;

    fn deref(&self) -> &RowReport {
        &self.rows
    }
}

impl RowReport {
    /// Count of the rows of one family.
    pub fn family(&self, family: CheckFamily) -> &FamilyReport {
        // `families` is `CheckFamily::ALL` mapped in order.
        &self.families[family as usize]
    }
}

impl fmt::Display for RowReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let verdict = if self.feasible { "feasible" } else { "not feasible" };
        writeln!(f, "{verdict}: {} of {} rows violated by more than their tolerance", self.n_violated, self.n_rows)?;
        writeln!(f, "{}", self.tolerances)?;
        writeln!(f)?;
        writeln!(f, "{:<18}{:>6}{:>10}{:>11}  {:<18} worst row", "rows", "count", "violated", "worst", "unit")?;
        for family in &self.families {
            let worst = family.worst.as_ref().map_or("-".into(), |worst| readable(worst.violation));
            write!(f, "{:<18}{:>6}{:>10}{worst:>11}  {:<18}", family.family, family.rows, family.violated, family.unit)?;
            // All rows that hold exactly are equally good, so no worst one is named.
            if let Some(worst) = family.worst.as_ref().filter(|worst| worst.violation > 0.) {
                write!(f, " {} at {:.3} s", worst.row, worst.time)?;
                write!(f, "{}", worst.foot.map(|foot| format!(", foot {foot}")).unwrap_or_default())?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(f, "{}", self.rows)?;
        writeln!(f, "between the instants, {} samples", self.dense.samples)?;
        write!(f, "{}", self.dense)?;
        let Some(rollout) = &self.rollout else { return Ok(()) };
        writeln!(f, "\nintegrated from the start under the planned forces alone, off the plan by")?;
        write!(f, "{rollout}")
    }
}
