//! What a certificate says: kinds of rows, what they are held to, and how many are violated.

use super::dense::{DenseReport, readable};
use super::rollout::RolloutReport;
use crate::robot::{GRAVITY, Robot};
use serde::Serialize;
use std::fmt;

/// Largest violation of a row of TOWR's that does not count, in the unit of the row: N_vc as in the paper \[1\].
pub const TOLERANCE: f64 = 1e-4;

/// Largest violations that do not count, by what a row measures.
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
    /// Those of TOWR's rows.
    pub const TOWR: Tolerances = Tolerances {
        force: TOLERANCE,
        moment: TOLERANCE,
        length: TOLERANCE,
        speed: TOLERANCE,
        acceleration: TOLERANCE,
        angle: TOLERANCE,
        rate: TOLERANCE,
    };

    /// Those of a robot, for `momentum` motions: with its weight `W` and the length `l` of its legs 1e-4 `W` and 1e-4 `W l`, 5e-4 `l` and
    /// 5e-4 `sqrt(g l)`, 1e-3 `g`, 1e-4 rad and 1e-4 `sqrt(g / l)`.
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

/// Limits of a `momentum` motion between its instants: distance of the base from its rollout, m,
pub const ROLLOUT_POSITION: f64 = 0.01;
/// angle between the base and its rollout, degrees,
pub const ROLLOUT_ATTITUDE: f64 = 1.;
/// how far a foot may be outside its box, m,
pub const DENSE_REACH: f64 = 5e-3;
/// and below the terrain, m.
pub const PENETRATION: f64 = 1e-3;

/// How far the ground within a radius of a foothold may be off its plane, above or below, in radii.
///
/// What turns by no more than half of a slope within the foot carries it as a plane does: a ball in such an edge is lifted by no more than an
/// eighth of its radius, which a sole gives. At a gap or a riser the ground is off by its depth or height, so that a foot
/// keeps a whole radius from every one of more than half a radius.
pub const FOOTHOLD_PLANE: f64 = 0.5;

/// How deep the ball of a foot may get into the ground in a swing, in radii: what an edge takes of it that a foothold may have.
/// With slopes of a quarter to either side `1 - cos(2 atan(1 / 4)) = 0.118`.
pub const BALL_DEPTH: f64 = 0.125;

/// Shortest piece of a curve, s. Shorter ones carry nothing that a robot does.
pub const SHORTEST_PIECE: f64 = 1e-3;
/// Highest speed of a foot in any motion but TOWR's, m/s,
pub const FOOT_SPEED: f64 = 30.;
/// and sum of the Euler rates of a base, in `sqrt(g / l)` of its legs.
pub const BASE_RATE: f64 = 10.;

/// Kinds of rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Family {
    /// Newton and Euler equations of the base, every 0.1 s and at the end.
    Dynamics,
    /// Momentum, position and attitude at the end of every base piece as the forces make them. Only asked of `momentum` motions.
    Momentum,
    /// Acceleration of the base continuous between its pieces. Only asked of TOWR's own transcription.
    BaseAcceleration,
    /// Feet inside their boxes, every 0.08 s and at the end; of `momentum` motions up to [`DENSE_REACH`] outside.
    Reach,
    /// Standing feet on the terrain, mid nodes of a swing not below it.
    Terrain,
    /// Normal force between 0 and its limit, the friction cone; of other motions than `momentum` TOWR's pyramid, which circumscribes it.
    Force,
    /// Mid node of a two-piece swing halfway between the footholds, with the velocity that TOWR prescribes, in TOWR's own transcription; of
    /// `momentum` motions high enough, not too high, not too fast.
    Swing,
    /// Start of base and feet, goal of the base.
    Bounds,
    /// What TOWR's variables hold by construction: standing feet stand, swinging feet carry nothing, nodes at phase boundaries.
    Structure,
    /// What no robot does, whatever its rows: pieces shorter than [`SHORTEST_PIECE`], feet faster than [`FOOT_SPEED`], a base that turns faster than
    /// [`BASE_RATE`], accelerates more than its feet can push by a weight, or gets below the terrain; a goal below it. On whole curves.
    Possible,
    /// What must hold between the instants, beyond its limit, on whole curves. Only asked of `momentum` motions whose other rows hold.
    Motion,
    /// The ball that a foot is comes no deeper into the ground in a swing than [`BALL_DEPTH`], and stands where the ground within its radius is
    /// no farther off a plane than [`FOOTHOLD_PLANE`]. On whole curves. Only asked of `momentum` motions on ground with edges whose other rows hold.
    Footing,
}

impl Family {
    /// Every family, in the order of [`RowReport::families`].
    pub const ALL: [Family; 12] = [
        Family::Dynamics,
        Family::Momentum,
        Family::BaseAcceleration,
        Family::Reach,
        Family::Terrain,
        Family::Force,
        Family::Swing,
        Family::Bounds,
        Family::Structure,
        Family::Possible,
        Family::Motion,
        Family::Footing,
    ];

    /// Name, as in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Family::Dynamics => "dynamics",
            Family::Momentum => "momentum",
            Family::BaseAcceleration => "base-acceleration",
            Family::Reach => "reach",
            Family::Terrain => "terrain",
            Family::Force => "force",
            Family::Swing => "swing",
            Family::Bounds => "bounds",
            Family::Structure => "structure",
            Family::Possible => "possible",
            Family::Motion => "motion",
            Family::Footing => "footing",
        }
    }

    /// Units of its rows; where there are several, the name of the row says which.
    pub fn unit(self) -> &'static str {
        match self {
            Family::Dynamics => "N, N m",
            Family::Momentum => "N, N m, rad",
            Family::BaseAcceleration => "m/s2, rad/s2",
            Family::Reach | Family::Terrain | Family::Footing => "m",
            Family::Force => "N",
            Family::Swing => "m, m/s",
            Family::Bounds => "m, rad, 1/s",
            Family::Structure => "m, m/s, N, N/s, s",
            Family::Possible => "s, m, m/s, rad/s, m g",
            Family::Motion => "m, deg, m g",
        }
    }
}

impl fmt::Display for Family {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(self.name())
    }
}

/// The most violated row of a family, by its tolerance.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Worst {
    /// Its violation, in its unit; infinite (`null` in JSON) when it was no number.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub violation: f64,
    /// Which row, e.g. `moment x`.
    pub row: String,
    /// Foot; none for the base.
    pub foot: Option<usize>,
    /// Time, s.
    pub time: f64,
}

/// Count of one kind of rows.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FamilyReport {
    /// Which.
    pub family: Family,
    /// Units of its rows.
    pub unit: &'static str,
    /// Number of rows.
    pub rows: usize,
    /// Those violated by more than their tolerance.
    pub violated: usize,
    /// Largest violation, 0 without rows.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub max_violation: f64,
    /// The row that has it, if there is any row.
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
    /// Whether no row is violated.
    pub feasible: bool,
    /// What does not count.
    pub tolerances: Tolerances,
    /// By kind, in the order of [`Family::ALL`].
    pub families: Vec<FamilyReport>,
}

/// Result of [`super::verify`].
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Report {
    /// At the rows.
    #[serde(flatten)]
    pub rows: RowReport,
    /// Between the instants.
    pub dense: DenseReport,
    /// Under the planned forces alone; none when the inertia has no inverse.
    pub rollout: Option<RolloutReport>,
}

impl std::ops::Deref for Report {
    type Target = RowReport;

    fn deref(&self) -> &RowReport {
        &self.rows
    }
}

impl RowReport {
    /// Count of one kind of rows.
    pub fn family(&self, family: Family) -> &FamilyReport {
        // `families` is `Family::ALL` mapped in order.
        &self.families[family as usize]
    }
}

impl fmt::Display for RowReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let verdict = if self.feasible { "feasible" } else { "not feasible" };
        writeln!(f, "{verdict}: {} of {} rows violated by more than its tolerance", self.n_violated, self.n_rows)?;
        writeln!(f, "{}", self.tolerances)?;
        writeln!(f)?;
        writeln!(f, "{:<18}{:>6}{:>10}{:>11}  {:<18} worst row", "rows", "count", "violated", "worst", "unit")?;
        for family in &self.families {
            let worst = family.worst.as_ref().map_or("-".into(), |worst| readable(worst.violation));
            write!(f, "{:<18}{:>6}{:>10}{worst:>11}  {:<18}", family.family, family.rows, family.violated, family.unit)?;
            // A row that holds exactly is as good as any other.
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
