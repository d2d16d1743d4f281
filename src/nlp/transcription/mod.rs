//! Transcriptions: conversions of a motion into variables and rows. Each has a file and implements the trait `Transcribe`.

pub mod initial_guess;
pub mod legs;
pub mod momentum;
pub mod towr;

use super::builder::Builder;
use super::problem::Curves;
use crate::gait::trajectory::MotionLimits;
use crate::gait::{Curve, Phase};
use crate::real::Real;
use crate::robot::{FORCE_LIMIT_WEIGHTS, Robot};
use crate::rows::blocks::BlockId;
use crate::rows::factored::POSE_BLOCKS;
use crate::rows::reach::ReachInstant;
use crate::settings::{Legs, Transcription, TranscriptionSettings};
use crate::task::Task;

/// Parameters of a swing.
pub(super) struct SwingLaw {
    /// Reference height of the initial mid node, from the two footholds, m.
    pub over: fn(&Task, [f64; 2], [f64; 2]) -> f64,
    /// Height of the initial mid node above that reference, m.
    pub above: f64,
    /// Fractions of the swing at which its height is constrained.
    pub parts: &'static [f64],
    /// Smallest height in the middle of the swing, m; at the other fractions it is 0.
    pub clearance: f64,
    /// True if the height has an upper limit.
    pub limited: bool,
    /// Longest step, m; `None` without a limit.
    pub longest_step: Option<f64>,
    /// Accelerations at both ends of a swing, per step length and per height, 1/s²; `None` without a limit.
    pub accelerations: Option<[f64; 2]>,
}

/// Instant of reach rows.
pub(super) struct ReachTime<T> {
    pub t: f64,
    pub feet: std::ops::Range<usize>,
    /// Step of the sweep.
    pub step: usize,
    /// See [`BaseBlocks`](crate::rows::factored::BaseBlocks).
    pub interval: u32,
    /// Interpolation weights of the base blocks.
    pub weights: [T; POSE_BLOCKS],
    /// Base blocks.
    pub blocks: [BlockId; POSE_BLOCKS],
    /// Entry in the table of reach instants.
    pub entry: ReachInstant<T>,
}

/// Initial values of a block, and the weights that attract its variables to them.
pub(super) struct Guess {
    pub initial: [f64; 6],
    pub smoothing: [f64; 6],
}

/// Parts in which transcriptions differ.
pub(super) trait Transcribe<T: Real> {
    /// Number of steps of the sweep for a number of intervals.
    fn steps(&self, intervals: usize) -> usize;
    /// Adds the blocks of the base.
    fn base_blocks(&self, b: &mut Builder<T>);
    /// Adds the rows that couple base, forces and footholds.
    fn dynamics(&self, b: &mut Builder<T>);
    /// Instants with reach rows, in the order of time.
    fn reach_times(&self, b: &Builder<T>) -> Vec<ReachTime<T>>;
    /// Weight that attracts footholds to their initial values, 1/m².
    fn foothold_smoothing(&self) -> f64;
    /// Initial foothold of a stance, m.
    fn foothold(&self, b: &Builder<T>, foot: usize, stance: usize, stances: usize) -> [f64; 2];
    /// Initial force at time `t`.
    fn force(&self, b: &Builder<T>, t: f64) -> Guess;
    /// Initial yaw of a sole at time `t`, rad.
    fn yaw(&self, b: &Builder<T>, t: f64) -> f64;
    /// Weights of the slope at which force rows apply around node `node` of a stance with `pieces` pieces.
    fn slopes(&self, node: usize, pieces: usize) -> &'static [f64];
    /// Distance between the footholds divided by the speed of the swing's mid node, s. Shorter means a faster foot in mid-swing.
    fn mid_time(&self, span: Phase) -> f64;
    /// Parameters of a swing phase.
    fn swing(&self, settings: &TranscriptionSettings, task: &Task, span: Phase) -> SwingLaw;
    /// Limits that motions satisfy in addition to their rows.
    fn limits(&self, settings: &TranscriptionSettings, robot: &Robot) -> Option<MotionLimits>;
    /// Curves of base position and Euler angles of a solution.
    fn base_curves(&self, task: &Task, curves: &Curves, x: &[f64]) -> [Curve; 2];
}

/// Implementation of a transcription.
pub(super) fn of<T: Real>(rows: Transcription) -> &'static dyn Transcribe<T> {
    match rows {
        Transcription::Momentum => &momentum::Momentum,
        Transcription::Towr => &towr::Towr,
    }
}

/// Interval between base knots, which is also that of the dynamics rows, s.
pub fn interval(settings: &TranscriptionSettings, robot: &Robot) -> f64 {
    settings.interval.unwrap_or_else(|| match settings.rows {
        Transcription::Momentum => momentum::interval(robot),
        Transcription::Towr => towr::INTERVAL,
    })
}

/// Largest normal force of a foot in a task, N: that of the task, else of the robot, else of the transcription.
pub fn force_limit(settings: &TranscriptionSettings, task: &Task) -> f64 {
    let own = || match (settings.rows, settings.legs) {
        (Transcription::Momentum, Legs::Limited) => task.robot.default_force_limit(),
        (Transcription::Momentum, Legs::Free) => FORCE_LIMIT_WEIGHTS * task.robot.weight(),
        (Transcription::Towr, _) => towr::FORCE_LIMIT,
    };
    task.force_limit.or(task.robot.force_limit).unwrap_or_else(own)
}
