//! Every tunable value of the transcription and the solver, with unit, default and limits.
//!
//! # Settings that matter
//! | setting | default | effect |
//! |---|---|---|
//! | `transcription.interval` | by the robot: half of `sqrt(l / g)`, 0.025 to 0.1 s | between base knots; longer is faster, until the attitude drifts |
//! | `transcription.goal_velocity` | `zero` | `free`: arrives at any speed |
//! | `transcription.clearance`, `swing_height` | 0.03 m, 0.2 m | height of a foot in mid-swing: above the ground at least, above lift-off and landing at most |
//! | `transcription.legs` | `limited` | `free`, the paper's: feet up to 20 m/s, any acceleration, three weights on a foot |
//! | `transcription.foot_speed` | 1.9 sqrt(g l) | of a swinging foot, horizontal; 4.2 m/s for a robot half a metre high |
//! | `transcription.foot_acceleration` | 20 g | of a swinging foot |
//! | `--force-limit`, `force_limit` in a robot's file | 3, 2.5 or 1.2 weights with one, two or more feet | normal force of a foot. Free legs have 3; certified of the reference candidates, all with pyramids, with 2, 3, 10 weights: 58, 77, 78 of 240 |
//! | `leg_mass` in a robot's file | 3 % of the mass | a leg's mass as if it were at the foot: what swinging costs |
//! | `--smooth` | off | 20 more iterations on a cost of forces, their slopes, tilt and rates: rms forces fall by 2 to 3 %, a fifth slower; 51 of 55 reference candidates stay certified, with pyramids 28 of 41 (free legs) |
//! | `solver.smoothing` | 0.1 | pull to smooth forces while the barrier is large; with 0 f32 solves 26 of the 240 reference candidates instead of 56 |
//! | `solver.max_iterations` | 200 | median of the solved ones, closing included: 12 (biped), 19 to 24 (quadrupeds) |
//! | `solver.stall.budget` | 200 | further iterations a candidate may seem to need before it is given up |
//! | `solver.edge_radius` | 0.04 m | rounding of terrain edges; 0 loses gaits that step over one |
//! | `search.population`, `search.generations` | 16, 3 | candidates a generation, generations over families; more is slower and cheaper gaits |
//! | `search.cost.*` | 1; `joint_excess` 50 | weights of leg work, swing work and effort, and of what joints do beyond their limits |
//! | `search.free.*` | the paper's | `list` shows the presets |

use crate::error::{Error, Result, check_range};
use crate::gait::trajectory::GoalVelocity;
use crate::solver::control::{NEVER_HOPELESS, hopeless_of_a_row};
use crate::terrain::Terrain;
use serde::{Deserialize, Serialize};

/// Which rows stand for the motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Transcription {
    /// Impulses over intervals: motions that hold between the instants.
    Momentum,
    /// TOWR's rows, for comparisons: dynamics at instants 0.1 s apart, forces at nodes.
    Towr,
}

impl Transcription {
    /// Name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Transcription::Momentum => "momentum",
            Transcription::Towr => "towr",
        }
    }
}

/// How friction limits forces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Friction {
    /// TOWR's pyramid, which circumscribes the cone: a foot that pushes diagonally may slip.
    Pyramid,
    /// The cone.
    Cone,
}

/// What is asked of legs and motors, besides TOWR's rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Legs {
    /// What the legs of a robot of its size can do: speed and acceleration of its feet, and about one weight on each foot.
    Limited,
    /// Nothing, as in the paper \[1\].
    Free,
}

/// How the motion is turned into variables and rows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct TranscriptionSettings {
    /// Which rows.
    pub rows: Transcription,
    /// Interval of base knots and dynamics rows, s; see [`crate::nlp::transcription::interval`] when absent. Longer: fewer variables, motions
    /// that hold less between instants.
    pub interval: Option<f64>,
    /// `towr`: interval of reach rows, s.
    pub reach_interval: f64,
    /// Cubic pieces of the force in a stance, at least 2.
    pub force_pieces: usize,
    /// Tightening of reach and swing rows, m. Too small: rows that the f32 solution touches fail the f64 check; too large: fewer gaits.
    pub length_margin: f64,
    /// Tightening of force rows, in body weights.
    pub force_margin: f64,
    /// How friction limits forces; see [`TranscriptionSettings::friction`] when absent.
    pub friction: Option<Friction>,
    /// `momentum`: velocity of the base at the goal.
    pub goal_velocity: GoalVelocity,
    /// `momentum`: height of a foot above the terrain in mid-swing, m, at least.
    pub clearance: f64,
    /// `momentum`: height of a swinging foot above the highest of lift-off, landing and the terrain in mid-swing, m, at most.
    pub swing_height: f64,
    /// `momentum`: what legs can do, where nothing else is said.
    pub legs: Legs,
    /// `momentum`: horizontal speed of a swinging foot, m/s, at most; see [`crate::nlp::transcription::legs::foot_speed`] when absent.
    pub foot_speed: Option<f64>,
    /// `momentum`: acceleration of a swinging foot, m/s², at most; see [`crate::nlp::transcription::legs::foot_acceleration`] when absent.
    pub foot_acceleration: Option<f64>,
}

impl Default for TranscriptionSettings {
    fn default() -> Self {
        TranscriptionSettings {
            rows: Transcription::Momentum,
            interval: None,
            reach_interval: 0.08,
            force_pieces: 3,
            length_margin: 1e-3,
            force_margin: 1e-3,
            friction: None,
            goal_velocity: GoalVelocity::Zero,
            clearance: 0.03,
            swing_height: 0.2,
            legs: Legs::Limited,
            foot_speed: None,
            foot_acceleration: None,
        }
    }
}

impl TranscriptionSettings {
    /// The defaults of a transcription.
    pub fn of(rows: Transcription) -> Self {
        TranscriptionSettings { rows, ..TranscriptionSettings::default() }
    }

    /// Those of the paper \[1\], which asks nothing of legs and motors.
    pub fn paper(rows: Transcription) -> Self {
        TranscriptionSettings { legs: Legs::Free, ..TranscriptionSettings::of(rows) }
    }

    /// How friction limits forces: `momentum` motions are certified with the cone and use it, TOWR has its pyramid.
    pub fn friction(&self) -> Friction {
        self.friction.unwrap_or(match self.rows {
            Transcription::Momentum => Friction::Cone,
            Transcription::Towr => Friction::Pyramid,
        })
    }
}

/// How the solver iterates. Symbols as in [`crate::solver`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct SolverSettings {
    /// Iteration limit.
    pub max_iterations: usize,
    /// Scaled infeasibility `F` below which the f32 solve ends; the f64 closing steps do the rest.
    pub tolerance: f64,
    /// Row violation below which an f64 solve ends, in the row's own unit (N, N m, m). What a certificate tolerates: [`verify`](mod@crate::verify).
    pub row_tolerance: f64,
    /// First barrier parameter `mu`; see [`SolverSettings::barrier`] when absent. Smaller: more is solved where
    /// friction is scarce, less where it is not, in more iterations.
    pub barrier: Option<f64>,
    /// First proximal weight `eps`. Larger: shorter, safer steps.
    pub proximal: f64,
    /// Weight, at the first barrier parameter, of what draws a motion to its smooth initial guess. It vanishes with the barrier: it leads
    /// to gentler forces, and takes none away. Only `momentum` has it.
    pub smoothing: f64,
    /// Smallest proximal weight.
    pub proximal_floor: f64,
    /// Rounding of terrain edges until closing steps start, m. 0: feet cannot cross an edge; large: feet may end on the wrong side of it.
    pub edge_radius: f64,
    /// `F` below which closing steps are tried. Smaller: iterations that they would save, with 0 edges that stay rounded; larger: they close on
    /// the wrong rows, and candidates that are hard are lost.
    pub closing: f64,
    /// Closing steps in f64 after an f32 solve, before other ways are tried.
    pub closing_steps: usize,
    /// Make what is feasible pleasant, too.
    pub smooth: SmoothSettings,
    /// End candidates that make no progress.
    pub stall: StallSettings,
}

impl Default for SolverSettings {
    fn default() -> Self {
        SolverSettings {
            max_iterations: 200,
            tolerance: 1e-7,
            row_tolerance: 2e-5,
            barrier: None,
            proximal: 1e-3,
            smoothing: 0.1,
            proximal_floor: 1e-6,
            edge_radius: 0.04,
            closing: 1e-3,
            closing_steps: 8,
            smooth: SmoothSettings::default(),
            stall: StallSettings::default(),
        }
    }
}

/// Iterations on a solved motion that lower its cost: forces against equal shares of the weight, their slopes, attitude and rates of the base
/// against the initial guess. Only `momentum` has a cost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct SmoothSettings {
    /// How many; 0: none.
    pub iterations: usize,
    /// Weight of the cost against the rows. Larger: faster, until multipliers of the rows cannot follow.
    pub weight: f64,
}

impl Default for SmoothSettings {
    fn default() -> Self {
        SmoothSettings { iterations: 0, weight: 0.01 }
    }
}

/// When a candidate counts as stalled: at the rate of the last `window` iterations, `F` would need more than `budget` further
/// iterations to fall to 1e-6. Calibrated in `benches/README.md`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct StallSettings {
    /// Whether the rule is in force.
    pub enabled: bool,
    /// First iteration at which it may end a candidate.
    pub start: usize,
    /// Iterations over which the rate is taken. Too short: a slow patch ends a candidate that would have gone on.
    pub window: usize,
    /// Iterations that a candidate may still need. Too small: candidates are lost; too large: failing ones cost more.
    pub budget: f64,
    /// A candidate is given up in its first iterations when it lacks this many times what it may after as many: see
    /// [`Progress::hopeless`](crate::solver::control::Progress::hopeless). Too small: candidates are lost; 0: none is given up for it.
    pub hopeless_above: f64,
}

impl Default for StallSettings {
    fn default() -> Self {
        StallSettings { enabled: true, start: 10, window: 4, budget: 200., hopeless_above: 1. }
    }
}

impl TranscriptionSettings {
    /// Checks every field.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] names the first field that is out of its limits.
    pub fn validate(&self) -> Result<()> {
        if let Some(interval) = self.interval {
            check_range("transcription.interval", interval, 0.01, 1.)?;
        }
        check_range("transcription.reach_interval", self.reach_interval, 0.005, 1.)?;
        check_range("transcription.force_pieces", self.force_pieces as f64, 2., 16.)?;
        check_range("transcription.length_margin", self.length_margin, 0., 0.1)?;
        check_range("transcription.force_margin", self.force_margin, 0., 0.1)?;
        if self.friction() == Friction::Cone {
            // The margin rounds the tip of the cone, where a force of nothing has no direction.
            check_range("transcription.force_margin with cones", self.force_margin, 1e-6, 0.1)?;
            if self.rows == Transcription::Towr {
                return Err(Error::invalid("transcription.friction", "cone", "`pyramid` with the rows `towr`"));
            }
        }
        check_range("transcription.clearance", self.clearance, 0., 10.)?;
        // Both rows of a swing hold with their margins.
        let margins = if self.rows == Transcription::Momentum { 2. * self.length_margin } else { 0. };
        check_range("transcription.swing_height", self.swing_height, self.clearance + margins + 1e-3, 100.)?;
        if let Some(speed) = self.foot_speed {
            check_range("transcription.foot_speed", speed, 0.1, 1000.)?;
        }
        self.foot_acceleration.map_or(Ok(()), |a| check_range("transcription.foot_acceleration", a, 1., 1e6))
    }
}

impl SolverSettings {
    /// First barrier parameter: 0.02 with the rows `momentum`, 0.2 with `towr`, whose violations are larger at first.
    pub fn barrier(&self, transcription: Transcription) -> f64 {
        self.barrier.unwrap_or(match transcription {
            Transcription::Momentum => 0.02,
            Transcription::Towr => 0.2,
        })
    }

    /// What a candidate may lack after [`HOPELESS_FROM`](crate::solver::control::HOPELESS_FROM) iterations, see
    /// [`Progress::hopeless`](crate::solver::control::Progress::hopeless).
    ///
    /// * `rows` - how many it has
    pub fn hopeless(&self, transcription: Transcription, rows: usize) -> f64 {
        if !self.stall.enabled || self.stall.hopeless_above == 0. {
            return NEVER_HOPELESS;
        }
        self.stall.hopeless_above * hopeless_of_a_row(transcription) * rows as f64
    }

    /// Rounding of the edges of a terrain until closing steps start, m; 0 where it has none.
    pub fn edge_radius_on(&self, terrain: &Terrain) -> f64 {
        if terrain.has_edges() { self.edge_radius } else { 0. }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] names the first field that is out of its limits.
    pub fn validate(&self) -> Result<()> {
        check_range("solver.max_iterations", self.max_iterations as f64, 0., 1e6)?;
        check_range("solver.tolerance", self.tolerance, 1e-12, 1.)?;
        check_range("solver.row_tolerance", self.row_tolerance, 1e-9, 1.)?;
        if let Some(barrier) = self.barrier {
            check_range("solver.barrier", barrier, 1e-6, 1e3)?;
        }
        check_range("solver.proximal", self.proximal, 1e-9, 1e3)?;
        check_range("solver.smoothing", self.smoothing, 0., 1e3)?;
        check_range("solver.proximal_floor", self.proximal_floor, 1e-9, self.proximal)?;
        check_range("solver.edge_radius", self.edge_radius, 0., 1.)?;
        check_range("solver.closing", self.closing, 0., 1e3)?;
        check_range("solver.closing_steps", self.closing_steps as f64, 0., 100.)?;
        check_range("solver.smooth.iterations", self.smooth.iterations as f64, 0., 1e4)?;
        check_range("solver.smooth.weight", self.smooth.weight, 1e-9, 1e3)?;
        check_range("solver.stall.start", self.stall.start as f64, 1., 1e6)?;
        check_range("solver.stall.window", self.stall.window as f64, 1., 1e3)?;
        check_range("solver.stall.budget", self.stall.budget, 1., 1e6)?;
        check_range("solver.stall.hopeless_above", self.stall.hopeless_above, 0., 1e6)
    }
}
