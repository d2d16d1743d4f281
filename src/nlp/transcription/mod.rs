//! Transcriptions: how a motion is turned into variables and rows. What differs between them is what `Transcribe` asks; each has a file.

pub mod ground_path;
pub mod initial_guess;
pub mod legs;
pub mod momentum;
pub mod towr;

use super::builder::Builder;
use super::layout::Curves;
use crate::gait::trajectory::MotionLimits;
use crate::gait::{Curve, Phase};
use crate::real::Real;
use crate::robot::{FORCE_LIMIT, Robot};
use crate::rows::blocks::BlockId;
use crate::rows::reach::BasePoint;
use crate::settings::{Legs, Transcription, TranscriptionSettings};
use crate::task::Task;

/// How feet swing.
pub(super) struct SwingLaw {
    /// What the mid node is above at first, between two footholds,
    pub over: fn(&Task, [f64; 2], [f64; 2]) -> f64,
    /// and by how much, m.
    pub above: f64,
    /// Parts of the swing at which its height is held.
    pub parts: &'static [f64],
    /// Lowest height in the middle, m; elsewhere it is 0.
    pub clearance: f64,
    /// Whether the height has an upper limit, too.
    pub limited: bool,
    /// Longest step, m.
    pub longest_step: Option<f64>,
    /// Accelerations at both ends of a swing, for a step and a height, 1/s²; none where they have no limit.
    pub accelerations: Option<[f64; 2]>,
}

/// An instant of reach rows.
pub(super) struct ReachTime<T> {
    pub t: f64,
    pub feet: std::ops::Range<usize>,
    /// Step of the sweep.
    pub step: usize,
    /// Base pose, without blocks.
    pub base: BasePoint<T>,
    /// Whose deviation counts, see [`BaseBlocks`](crate::rows::reach::BaseBlocks).
    pub interval: u32,
    /// Its blocks.
    pub blocks: [BlockId; 4],
}

/// Where a block starts, and how firmly it is drawn there.
pub(super) struct Guess {
    pub initial: [f64; 6],
    pub smoothing: [f64; 6],
}

/// The questions whose answers make a transcription.
pub(super) trait Transcribe<T: Real> {
    /// Steps of the sweep over so many intervals.
    fn steps(&self, intervals: usize) -> usize;
    /// Adds the blocks of the base.
    fn base_blocks(&self, b: &mut Builder<T>);
    /// Adds the rows that tie base, forces and footholds together.
    fn dynamics(&self, b: &mut Builder<T>);
    /// Instants at which feet are held within reach, in the order of time.
    fn reach_times(&self, b: &Builder<T>) -> Vec<ReachTime<T>>;
    /// How firmly footholds are drawn to where they start, 1/m².
    fn foothold_smoothing(&self) -> f64;
    /// Initial foothold of a stance, m.
    fn foothold(&self, b: &Builder<T>, foot: usize, stance: usize, stances: usize) -> [f64; 2];
    /// Initial force at time `t`.
    fn force(&self, b: &Builder<T>, t: f64) -> Guess;
    /// Weights of the slope at which force rows are held about node `node` of a stance of `pieces` pieces.
    fn slopes(&self, node: usize, pieces: usize) -> &'static [f64];
    /// Time over which the mid node of a swing would cover the distance of the footholds, s: the shorter, the faster is the foot there.
    fn mid_time(&self, span: Phase) -> f64;
    /// How feet swing over a phase.
    fn swing(&self, settings: &TranscriptionSettings, task: &Task, span: Phase) -> SwingLaw;
    /// What its motions keep to besides their rows.
    fn limits(&self, settings: &TranscriptionSettings, robot: &Robot) -> Option<MotionLimits>;
    /// Base position and Euler angles of a solution.
    fn base_curves(&self, task: &Task, curves: &Curves, x: &[f64]) -> [Curve; 2];
}

/// Who answers for a transcription.
pub(super) fn of<T: Real>(rows: Transcription) -> &'static dyn Transcribe<T> {
    match rows {
        Transcription::Momentum => &momentum::Momentum,
        Transcription::Towr => &towr::Towr,
    }
}

/// Interval of base knots and dynamics rows for a robot, s.
pub fn interval(settings: &TranscriptionSettings, robot: &Robot) -> f64 {
    settings.interval.unwrap_or_else(|| match settings.rows {
        Transcription::Momentum => momentum::interval(robot),
        Transcription::Towr => towr::INTERVAL,
    })
}

/// Largest normal force of a foot in a task, N: that asked for, else the robot's, else the transcription's.
pub fn force_limit(settings: &TranscriptionSettings, task: &Task) -> f64 {
    let own = || match (settings.rows, settings.legs) {
        (Transcription::Momentum, Legs::Limited) => task.robot.default_force_limit(),
        (Transcription::Momentum, Legs::Free) => FORCE_LIMIT * task.robot.weight(),
        (Transcription::Towr, _) => towr::FORCE_LIMIT,
    };
    task.force_limit.or(task.robot.force_limit).unwrap_or_else(own)
}
