//! Problem of one candidate: its variables, its elements of rows, and the tables that the loops use.
//!
//! `x` contains the variables in elimination order, followed by the fixed values (start of the base, first footholds, goal). Variables form
//! blocks: base coefficient or knot (position and angles, or their rates, 6), force node (value and slope, 6), foothold (2), swing height
//! (1); for soles also moment node (6) and yaw (1). All of `x` is scaled: m, rad, s; forces by the weight per foot, moments by that and the
//! half length of a sole, slopes of both also by the piece duration.
//! `nlp/builder.rs` writes these tables; the ones that define the rows are [`Tables`], listed in [`crate::rows`].

use super::sweep::Step;
use crate::gait::Phase;
use crate::gait::trajectory::MotionLimits;
use crate::real::Real;
use crate::rows::table::{Place, Run, Span};
use crate::rows::{Family, RowCounts, RowKind, Tables};
use crate::settings::Transcription;
use std::ops::{Deref, DerefMut};

crate::table! {
    /// Group of rows over the same columns.
    pub struct Element {
        /// Family of its rows.
        pub family: Family,
        /// Number of Jacobian rows.
        pub rows: u32,
        /// Number of two-sided rows, which are the first.
        pub pairs: u32,
        /// Place of the rows in the buffers.
        pub place: Place,
        /// Columns as runs of variables, in [`Problem::runs`]; empty for factored rows, which know their columns themselves.
        pub runs: Span,
    }
}

impl Element {
    /// Kind of its rows.
    #[inline(always)]
    pub fn kind(&self) -> RowKind {
        self.family.spec().kind
    }
}

/// Problem of one candidate as flat tables.
#[derive(Debug, Clone)]
pub struct Problem<T> {
    /// Number of variables.
    pub variables: usize,
    /// Numbers of Jacobian rows by kind.
    pub rows: RowCounts,
    /// Number of inequalities: a two-sided row has two.
    pub inequalities: usize,
    /// Number of Jacobian values.
    pub jacobian_len: usize,
    /// Initial `x`, fixed values included.
    pub initial: Vec<T>,
    /// Weight of the attraction of each variable to its initial value while the barrier parameter is large, `[variables]`.
    pub smoothing: Vec<T>,
    /// Tables that define the rows.
    pub tables: Tables<T>,
    /// Weight of the absolute value of each cost row in the objective; 0 if half of its square counts instead. `-1 - i` for a row that is
    /// no part of the cost: its weight is the multiplier of the inequality `i`. `[costs]`
    pub cost_weights: Vec<T>,
    /// Elements in the order of the sweep, except those of factored rows, which follow all others: see [`Problem::all_elements`].
    pub elements: Vec<Element>,
    /// Columns of the elements.
    pub runs: Vec<Run>,
    /// Steps of the sweep.
    pub steps: Vec<Step>,
    /// Front-to-front moves and front contents, see [`Step`].
    pub front_runs: Vec<Run>,
    /// Largest number of columns of an element, padding included.
    pub widest: usize,
    /// Distance between two rows of the front, sufficient for the largest front and a right-hand side.
    pub front_stride: usize,
    /// Number of values in the factor.
    pub factor_len: usize,
    /// Data for converting `x` into a motion.
    pub curves: Curves,
}

impl<T> Deref for Problem<T> {
    type Target = Tables<T>;

    fn deref(&self) -> &Tables<T> {
        &self.tables
    }
}

impl<T> DerefMut for Problem<T> {
    fn deref_mut(&mut self) -> &mut Tables<T> {
        &mut self.tables
    }
}

impl<T: Real> Problem<T> {
    /// Largest normal force of a foot, N.
    pub fn force_limit(&self) -> f64 {
        self.curves.force_limit
    }

    /// All elements, those of factored rows last.
    pub fn all_elements(&self) -> impl Iterator<Item = Element> {
        self.elements.iter().copied().chain(self.reach_rows.as_elements())
    }

    /// Dependencies of the rows of each of [`Problem::all_elements`]: columns as runs of variables, with the weight by which the Jacobian
    /// values apply to these variables, which is 1 except in factored rows.
    pub fn columns(&self) -> Vec<Vec<(Run, T)>> {
        let own = |element: &Element| self.runs[element.runs.range()].iter().map(|run| (*run, T::one())).collect();
        self.elements.iter().map(own).chain(self.reach_rows.columns()).collect()
    }
}

/// Data for converting `x` into a motion: positions of the blocks of each curve, and units. It outlives the tables, which are much larger.
#[derive(Debug, Clone)]
pub struct Curves {
    /// Transcription that was solved.
    pub transcription: Transcription,
    /// Limits that motions satisfy in addition to their rows.
    pub limits: Option<MotionLimits>,
    /// Largest normal force of a foot, N.
    pub force_limit: f64,
    /// Unit of forces in `x`: the weight per foot, N.
    pub force_unit: f64,
    /// Unit of the moments of soles in `x`, N m; 0 without soles.
    pub moment_unit: f64,
    /// Number of intervals.
    pub intervals: usize,
    /// Length of an interval, s.
    pub interval: f64,
    /// Number of variables; the fixed values follow them in `x`.
    pub variables: usize,
    /// Blocks of the base. `towr`: spline coefficients; `momentum`: pose and rates, alternating, of each knot.
    pub base: Vec<u32>,
    /// Blocks of each foot.
    pub feet: Vec<FootBlocks>,
}

/// Positions in `x` of one foot's blocks.
#[derive(Debug, Clone, Default)]
pub struct FootBlocks {
    /// Phases of the foot.
    pub phases: Vec<Phase>,
    /// Foothold of each stance.
    pub footholds: Vec<u32>,
    /// Swing height of each swing.
    pub heights: Vec<u32>,
    /// Force nodes of each stance; [`NONE`](crate::rows::table::NONE) where the force is zero.
    pub force_nodes: Vec<Vec<u32>>,
    /// Moment nodes of each stance of a sole, where there are force nodes; empty for other feet.
    pub moment_nodes: Vec<Vec<u32>>,
    /// Yaw of a sole in each stance; empty for other feet.
    pub yaws: Vec<u32>,
}
