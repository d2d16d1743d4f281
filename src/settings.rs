//! Settings of the transcription and the solver, with units, defaults and limits.
//!
//! # Settings that matter most
//! | setting | default | effect |
//! |---|---|---|
//! | `transcription.interval` | 0.025 to 0.1 s | time between base knots; longer is faster, until the attitude drifts |
//! | `transcription.goal_velocity` | `zero` | `free`: the robot may arrive at any speed |
//! | `transcription.clearance` | 0.03 m | smallest height of a foot above the ground in mid-swing |
//! | `transcription.swing_height` | 0.2 m | largest height of a foot above lift-off and touchdown in mid-swing |
//! | `transcription.legs` | `limited` | `free` as in the paper: feet up to 20 m/s, any acceleration, 3 body weights per foot |
//! | `transcription.foot_speed` | 1.9 sqrt(g l) | horizontal speed of a swinging foot; 4.2 m/s for a robot half a metre high |
//! | `transcription.foot_acceleration` | 20 g, less for soles | acceleration of a swinging foot |
//! | `--force-limit`, `force_limit` in a robot's file | 1.2 body weights (1) | largest normal force of a foot |
//! | `leg_mass` in a robot's file | 3 % of the mass | equivalent mass of a leg at its foot, which determines the cost of swinging |
//! | `--smooth` | off | 20 more iterations that lower forces, their slopes, tilt and rates (2) |
//! | `solver.optimise.iterations` | 0 | iterations that minimise the cost of a motion, see [`OptimiseSettings`]; searches have their own |
//! | `solver.smoothing` | 0.1 | pull to smooth forces while the barrier is large (3) |
//! | `solver.max_iterations` | 200 | iteration limit (4) |
//! | `solver.stall.budget` | 200 | predicted number of further iterations above which a candidate is terminated early |
//! | `solver.edge_radius` | 0.04 m | rounding of terrain edges; with 0, gaits that step over an edge are lost |
//! | `search.population` | 16 | candidates per generation; more is slower and finds cheaper gaits |
//! | `search.generations` | 3 | generations over gait families; more is slower and finds cheaper gaits |
//! | `search.relief_levels` | 60 | levels of rising ground that are tried after a search on uneven ground has failed; 0 leaves this out |
//! | `search.optimise_iterations` | 6 | iterations that minimise the cost of each candidate; 0 is fast, and gaits cost a tenth more |
//! | `search.duration_steps` | 21 | steps for the durations and strides of the best gaits; 0 is fast, and gaits cost a tenth more |
//! | `search.cost.*` | 1; `joint_excess` 50 | weights of leg work, swing work and effort, and of joint motion beyond the joint limits |
//! | `search.free.*` | the paper's | settings of the free distribution; `list` shows the presets |
//!
//! 1. For robots with more than two feet; 2.5 with two feet, 3 with one. Free legs have 3. With pyramids and limits of 2, 3 and 10 body
//!    weights, 58, 77 and 78 of the 240 reference candidates are certified.
//! 2. The rms forces fall by 2 to 3 %, and a solve takes a fifth longer. 51 of 55 reference candidates stay certified; with pyramids, 28 of
//!    41 (free legs).
//! 3. With 0 the f32 solver solves 26 of the 240 reference candidates instead of 56.
//! 4. Median of the solved candidates, closing steps included: 12 (biped), 19 to 24 (quadrupeds).
//!
//! The default of `transcription.interval` is half of `sqrt(l / g)`, with the nominal leg height `l`.

use crate::error::{Error, Result, check_range};
use crate::gait::cost::CostWeights;
use crate::gait::trajectory::GoalVelocity;
use crate::robot::Reach;
use crate::terrain::Terrain;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Rows that describe the motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Transcription {
    /// Impulses over intervals: the motion also holds between the instants.
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

/// Friction model of the force rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Friction {
    /// TOWR's pyramid, which circumscribes the cone: a foot that pushes diagonally may slip.
    Pyramid,
    /// Exact friction cone.
    Cone,
}

/// Limits of legs and motors beyond TOWR's rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Legs {
    /// Limits of typical legs of the robot's size: speed and acceleration of the feet, and about one body weight per foot.
    Limited,
    /// No limits, as in the paper \[1\].
    Free,
}

/// Wider reach of the feet at the start of a motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Stretch {
    /// The wider reach, with the slabs of the robot's reach.
    pub reach: Arc<Reach>,
    /// Time before which a stance or swing begins that has this reach, s. The first stance and the first swing of a foot always have it.
    pub until: f64,
}

/// Settings of the transcription, which turns a motion into variables and rows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct TranscriptionSettings {
    /// Kind of rows.
    pub rows: Transcription,
    /// Time between base knots, which is also that between dynamics rows, s. Too short: many variables, slow solves. Too long: the attitude
    /// drifts between the instants. If absent, [`crate::nlp::transcription::interval`] chooses it.
    pub interval: Option<f64>,
    /// `towr` only: time between reach rows, s. Too short: many rows, slow solves. Too long: feet may leave their reach between the rows.
    pub reach_interval: f64,
    /// Number of cubic pieces of the force in a stance, at least 2. Too few: the force cannot follow what the motion needs, which costs
    /// effort. Too many: many variables, slow solves. If absent, [`TranscriptionSettings::force_pieces`] chooses it.
    pub force_pieces: Option<usize>,
    /// Tightening of reach, swing and footing rows, m. Too small: rows that the f32 solution touches fail the f64 check. Too large: fewer
    /// gaits are feasible.
    pub length_margin: f64,
    /// Height by which the reach of a foot shrinks at its top and at its bottom, m, at most a quarter of it. At the bottom a leg is stretched.
    /// Too small: optimal motions stretch legs until they cannot correct an error. Too large: fewer gaits are feasible. A search that
    /// minimises a cost has its own, see `search.reach_margin`.
    pub reach_margin: f64,
    /// Tightening of force rows, in body weights. Too small: rows that the f32 solution touches fail the f64 check. Too large: less force
    /// and friction can be used. The cone needs at least 1e-6.
    pub force_margin: f64,
    /// Friction model. If absent, [`TranscriptionSettings::friction`] chooses it.
    pub friction: Option<Friction>,
    /// `momentum` only: velocity of the base at the goal.
    pub goal_velocity: GoalVelocity,
    /// `momentum` only: smallest height of a foot above the terrain in mid-swing, m. Too small: a foot may scuff the ground. Too large:
    /// swings need more reach and acceleration, and fewer gaits are feasible.
    pub clearance: f64,
    /// `momentum` only: largest height of a swinging foot above the highest of lift-off, touchdown and the terrain in mid-swing, m. It must
    /// exceed the clearance and both margins by 1 mm. Too small: feet have little room to swing. Too large: feet may swing higher than
    /// necessary.
    pub swing_height: f64,
    /// `momentum` only: limits of the legs, where the settings below and the robot's force limit give none.
    pub legs: Legs,
    /// `momentum` only: largest horizontal speed of a swinging foot, m/s. Too small: fast gaits are infeasible. Too large: motors cannot
    /// follow. If absent, [`crate::nlp::transcription::legs::foot_speed`] chooses it.
    pub foot_speed: Option<f64>,
    /// `momentum` only: largest acceleration of a swinging foot, m/s². Too small: gaits with short swings are infeasible. Too large: motors
    /// cannot follow. If absent, [`crate::nlp::transcription::legs::foot_acceleration`] chooses it.
    pub foot_acceleration: Option<f64>,
    /// Wider reach at the start. Not in files, because a certificate has one reach for the whole motion. Here it is that of a robot with
    /// the wider reach.
    #[serde(skip)]
    pub stretch: Option<Stretch>,
}

impl Default for TranscriptionSettings {
    fn default() -> Self {
        TranscriptionSettings {
            rows: Transcription::Momentum,
            interval: None,
            reach_interval: 0.08,
            force_pieces: None,
            length_margin: 1e-3,
            reach_margin: 0.,
            force_margin: 1e-3,
            friction: None,
            goal_velocity: GoalVelocity::Zero,
            clearance: 0.03,
            swing_height: 0.2,
            legs: Legs::Limited,
            foot_speed: None,
            foot_acceleration: None,
            stretch: None,
        }
    }
}

impl TranscriptionSettings {
    /// Default settings of a kind of rows.
    pub fn of(rows: Transcription) -> Self {
        TranscriptionSettings { rows, ..TranscriptionSettings::default() }
    }

    /// Settings of the paper \[1\]: no limits of legs and motors, and three pieces of the force in a stance, as in TOWR.
    pub fn paper(rows: Transcription) -> Self {
        TranscriptionSettings { legs: Legs::Free, force_pieces: Some(3), ..TranscriptionSettings::of(rows) }
    }

    /// Friction model: by default the cone for `momentum`, whose motions are certified with it, and the pyramid for `towr`.
    pub fn friction(&self) -> Friction {
        self.friction.unwrap_or(match self.rows {
            Transcription::Momentum => Friction::Cone,
            Transcription::Towr => Friction::Pyramid,
        })
    }

    /// Number of cubic pieces of the force in a stance: by default 4, and 3 for `towr`, as in TOWR.
    ///
    /// Of the 240 reference candidates 54, 63, 63 and 61 are certified with 3, 4, 5 and 6 pieces. Minimised motions cost 5 to 7 % less with
    /// 4 than with 3 and take 10 % longer, and 8 to 13 % less with 6 in a third more time.
    pub fn force_pieces(&self) -> usize {
        self.force_pieces.unwrap_or(match self.rows {
            Transcription::Momentum => 4,
            Transcription::Towr => 3,
        })
    }
}

/// Settings of the solver. [`crate::solver`] defines the symbols.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct SolverSettings {
    /// Iteration limit. Too small: slow candidates end unsolved. Too large: failing candidates that the stall rule misses take long.
    pub max_iterations: usize,
    /// Scaled infeasibility `F` at which the f32 solve ends; f64 closing steps do the rest. Too small: f32 rounding prevents solves from
    /// reaching it. Too large: closing steps start too far from a solution.
    pub tolerance: f64,
    /// Row violation at which an f64 solve ends, in the row's own unit (N, N m, m). Too small: solves do not end. Too large: motions fail
    /// the certificate, see [`verify`](mod@crate::verify).
    pub row_tolerance: f64,
    /// First barrier parameter `mu`. Smaller: more candidates are solved where friction is scarce and fewer where it is not, in more
    /// iterations. If absent, [`SolverSettings::barrier`] chooses it.
    pub barrier: Option<f64>,
    /// First proximal weight `eps`. Too small: first steps are long and often rejected. Too large: steps are short, and more iterations are
    /// needed.
    pub proximal: f64,
    /// Weight, at the first barrier parameter, of the pull to the smooth initial guess; `momentum` only. It leads to gentler forces and
    /// vanishes with the barrier, so it excludes no solution. Too small: fewer candidates are solved. Too large: more iterations are
    /// needed. With 0, 0.05, 0.1 and 0.2 f32 solved 428, 588, 587 and 582 of 976 candidates.
    pub smoothing: f64,
    /// Smallest proximal weight. Too small: a rejected direction needs more attempts, each with a factorisation, until the weight matters.
    /// Too large: steps stay short, and more iterations are needed.
    pub proximal_floor: f64,
    /// Rounding of terrain edges until closing steps start, m. Too small: feet cannot cross an edge. Too large: feet may end on the wrong
    /// side of it.
    pub edge_radius: f64,
    /// Infeasibility `F` below which closing steps are tried. Too small: iterations that closing steps would save; with 0 edges stay
    /// rounded. Too large: closing steps act on the wrong rows, and hard candidates are lost. With 1e-6, 1e-3 and 1e-2 128 periodic gaits
    /// of s1 took 817, 759 and 693 iterations, but of 96 free draws 12, 12 and 10 were solved.
    pub closing: f64,
    /// Largest number of f64 closing steps after an f32 solve, before costlier methods are tried. Too small: those methods are used
    /// needlessly. Too large: time is lost on candidates that do not converge.
    pub closing_steps: usize,
    /// Smoothing of motions that are already feasible.
    pub smooth: SmoothSettings,
    /// Minimisation of the cost of motions that are already feasible.
    pub optimise: OptimiseSettings,
    /// Early termination of candidates that make no progress.
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
            closing_steps: 20,
            smooth: SmoothSettings::default(),
            optimise: OptimiseSettings::default(),
            stall: StallSettings::default(),
        }
    }
}

/// Settings of the iterations that lower the cost of a solved motion. The cost measures forces against equal shares of the weight, their
/// slopes, and attitude and rates of the base against the initial guess. Only `momentum` has it.
///
/// With [`OptimiseSettings`] as well, the sum of both costs is minimised, in the larger number of iterations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct SmoothSettings {
    /// Number of iterations; 0 disables smoothing. More: smoother motions, slower solves.
    pub iterations: usize,
    /// Weight of the cost relative to the rows. Too small: many iterations have little effect. Too large: the multipliers of the rows
    /// cannot follow.
    pub weight: f64,
}

impl Default for SmoothSettings {
    fn default() -> Self {
        SmoothSettings { iterations: 0, weight: 0.01 }
    }
}

/// Settings of the iterations that minimise the cost of a solved motion: the cost that the search ranks gaits by. Only
/// `momentum` has it. Durations stay as they are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct OptimiseSettings {
    /// Largest number of iterations; 0 disables the minimisation. Too small: the cost is above its minimum.
    pub iterations: usize,
    /// Weight of the cost relative to the constraints. Too small: rounding hides the cost in f32. Too large: the multipliers of the
    /// constraints cannot follow.
    pub weight: f64,
    /// Barrier parameter at the start. Too small: steps are short, because constraints are close. Too large: more iterations are needed.
    pub barrier: f64,
    /// Rounding of the absolute values of powers at the start, m/s. Too small: powers that are zero hold the motion where it is.
    pub rounding: f64,
    /// Rounding of the absolute values of powers at the end, m/s. Too small: more iterations are needed. Too large: another cost is
    /// minimised.
    pub rounding_floor: f64,
    /// Predicted relative fall of the cost at which the minimisation ends. Too small: iterations that gain nothing. Too large: the cost is
    /// above its minimum.
    pub tolerance: f64,
    /// Cost above which the minimisation of a candidate ends after any iteration; `None`: no limit. A search for the least cost of transport
    /// has its own. Too small: candidates are terminated early that would have become cheap.
    pub cost_limit: Option<f64>,
    /// Weights of the terms of the cost; a search sets its own (`search.cost`). Joints beyond their limits have a quadratic price in it.
    pub cost: CostWeights,
}

impl Default for OptimiseSettings {
    fn default() -> Self {
        let cost = CostWeights::default();
        OptimiseSettings {
            iterations: 0,
            weight: 0.02,
            barrier: 1e-4,
            rounding: 1e-2,
            rounding_floor: 3e-4,
            tolerance: 2e-5,
            cost_limit: None,
            cost,
        }
    }
}

impl OptimiseSettings {
    /// Weights of the cost that is minimised, if one is.
    pub fn objective(&self) -> Option<&CostWeights> {
        (self.iterations > 0).then_some(&self.cost)
    }
}

/// Limit that is never reached. Finite, because WGSL has no portable infinity.
pub const NO_LIMIT: f64 = f32::MAX as f64;

/// Early-termination limit after the first iterations, per row; see [`crate::solver::control::Progress::early_termination_limit`].
fn early_termination_per_row(transcription: Transcription) -> f64 {
    match transcription {
        Transcription::Momentum => 8.,
        Transcription::Towr => 30.,
    }
}

/// Former names of settings and their present ones. Files and options that use a former name are still read.
pub const RENAMED: [(&str, &str); 1] = [("hopeless_above", "early_termination")];

/// Present name of a setting.
pub fn present_name(key: &str) -> &str {
    RENAMED.iter().find(|(former, _)| *former == key).map_or(key, |(_, present)| present)
}

/// Settings of early termination.
///
/// A candidate counts as stalled if `F`, at the rate of the last `window` iterations, would need more than `budget` further iterations to
/// fall to 1e-6. `benches/README.md` shows how many candidates early termination loses, and how many iterations it saves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct StallSettings {
    /// True if candidates may be terminated early.
    pub enabled: bool,
    /// First iteration at which the stall rule may end a candidate. Too small: candidates with a slow start are lost. Too large: failing
    /// ones cost more.
    pub start: usize,
    /// Number of iterations over which the rate is measured. Too small: a slow stretch ends a candidate that would have recovered; a window
    /// of 3 instead of 4 lost 19 instead of 13 of 7,794 solvable candidates. Too large: failing ones cost more.
    pub window: usize,
    /// Largest predicted number of further iterations. Too small: candidates are lost. Too large: failing ones cost more. With 120, 200, 400
    /// and 800 the rule lost 5, 3, 2 and none of 1,505 solvable candidates and saved 79, 78, 76 and 74 % of the iterations (`towr`).
    pub budget: f64,
    /// Factor of early termination in the first iterations: a candidate ends if its infeasibility measure exceeds this multiple of the
    /// limit for its iteration, see [`Progress`](crate::solver::control::Progress). Too small: candidates are lost. Too large: failing
    /// ones cost more. 0 disables this rule.
    #[serde(alias = "hopeless_above")]
    pub early_termination: f64,
}

impl Default for StallSettings {
    fn default() -> Self {
        StallSettings { enabled: true, start: 10, window: 4, budget: 200., early_termination: 1. }
    }
}

impl TranscriptionSettings {
    /// Checks every field.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] names the first field that is outside its limits.
    pub fn validate(&self) -> Result<()> {
        if let Some(interval) = self.interval {
            check_range("transcription.interval", interval, 0.01, 1.)?;
        }
        check_range("transcription.reach_interval", self.reach_interval, 0.005, 1.)?;
        check_range("transcription.force_pieces", self.force_pieces() as f64, 2., 16.)?;
        check_range("transcription.length_margin", self.length_margin, 0., 0.1)?;
        check_range("transcription.reach_margin", self.reach_margin, 0., 10.)?;
        check_range("transcription.force_margin", self.force_margin, 0., 0.1)?;
        if self.friction() == Friction::Cone {
            // The margin rounds the tip of the cone, where the zero force has no direction.
            check_range("transcription.force_margin with cones", self.force_margin, 1e-6, 0.1)?;
            if self.rows == Transcription::Towr {
                return Err(Error::invalid("transcription.friction", "cone", "`pyramid` with the rows `towr`"));
            }
        }
        if self.goal_velocity == GoalVelocity::Near && self.rows == Transcription::Towr {
            return Err(Error::invalid("transcription.goal_velocity", "near", "`zero` or `free` with the rows `towr`"));
        }
        check_range("transcription.clearance", self.clearance, 0., 10.)?;
        // Both rows of a swing must hold with their margins.
        let margins = if self.rows == Transcription::Momentum { 2. * self.length_margin } else { 0. };
        check_range("transcription.swing_height", self.swing_height, self.clearance + margins + 1e-3, 100.)?;
        if let Some(speed) = self.foot_speed {
            check_range("transcription.foot_speed", speed, 0.1, 1000.)?;
        }
        self.foot_acceleration.map_or(Ok(()), |a| check_range("transcription.foot_acceleration", a, 1., 1e6))
    }
}

impl SolverSettings {
    /// First barrier parameter: by default 0.02 for `momentum`, and 0.2 for `towr`, whose violations are larger at first. With 0.005, 0.02,
    /// 0.05 and 0.1 f32 solved 571, 587, 587 and 569 of 976 `momentum` candidates, with 9,907, 10,264, 10,548 and 11,426 factorisations.
    pub fn barrier(&self, transcription: Transcription) -> f64 {
        self.barrier.unwrap_or(match transcription {
            Transcription::Momentum => 0.02,
            Transcription::Towr => 0.2,
        })
    }

    /// Early termination limit after [`EARLY_TERMINATION_FROM`](crate::solver::control::EARLY_TERMINATION_FROM) iterations, see
    /// [`Progress::early_termination_limit`](crate::solver::control::Progress::early_termination_limit).
    ///
    /// * `rows` - number of rows of the candidate
    pub fn early_termination_limit(&self, transcription: Transcription, rows: usize) -> f64 {
        if !self.stall.enabled || self.stall.early_termination == 0. {
            return NO_LIMIT;
        }
        self.stall.early_termination * early_termination_per_row(transcription) * rows as f64
    }

    /// Rounding of the edges of a terrain until closing steps start, m; 0 for terrain without edges.
    pub fn edge_radius_on(&self, terrain: &Terrain) -> f64 {
        if terrain.has_edges() { self.edge_radius } else { 0. }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] names the first field that is outside its limits.
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
        check_range("solver.optimise.iterations", self.optimise.iterations as f64, 0., 1e4)?;
        check_range("solver.optimise.weight", self.optimise.weight, 1e-9, 1e3)?;
        check_range("solver.optimise.barrier", self.optimise.barrier, 1e-9, 1.)?;
        check_range("solver.optimise.rounding", self.optimise.rounding, 1e-9, 1e3)?;
        check_range("solver.optimise.rounding_floor", self.optimise.rounding_floor, 1e-9, self.optimise.rounding)?;
        check_range("solver.optimise.tolerance", self.optimise.tolerance, 0., 1.)?;
        self.optimise.cost_limit.map_or(Ok(()), |limit| check_range("solver.optimise.cost_limit", limit, 0., 1e12))?;
        self.optimise.cost.validate()?;
        check_range("solver.stall.start", self.stall.start as f64, 1., 1e6)?;
        check_range("solver.stall.window", self.stall.window as f64, 1., 1e3)?;
        check_range("solver.stall.budget", self.stall.budget, 1., 1e6)?;
        check_range("solver.stall.early_termination", self.stall.early_termination, 0., 1e6)
    }
}
