//! Index tables of one candidate: its variables, its elements of rows, and what the kernels walk to fill them.
//!
//! `x` holds the variables in elimination order, followed by the fixed values (start of the base, first footholds, goal). Variables
//! come in blocks: a base coefficient or knot (position and angles, or their rates, 6), a force node (value and slope, 6), a foothold
//! (2), a swing height (1). All of `x` is scaled: m, rad, s, and for forces the weight per foot (slopes: that per piece duration).
//! `nlp/builder.rs` writes these tables.

use super::sweep::{Run, Span, Step};
use crate::gait::Phase;
use crate::gait::trajectory::MotionLimits;
use crate::settings::Transcription;
use crate::terrain::Terrain;
use std::sync::Arc;

/// No such column or node: a fixed value, or a force node that is zero.
pub const NONE: u32 = u32::MAX;

/// Values that follow the Jacobian rows of a foot's reach: its three rows by the pose of the base, padded to a multiple of 8.
pub const POSE_VALUES: usize = 24;

/// Row families, for scaling and reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Family {
    /// `towr`: Newton-Euler equations, 6 equalities an instant: moments, then forces.
    Dynamics,
    /// `momentum`: change of linear momentum, then of position, over an interval, 6 equalities.
    LinearMomentum,
    /// `momentum`: angular momentum at the end of an interval, then its mean, 6 equalities.
    AngularMomentum,
    /// Reach box, 3 two-sided rows a foot and instant.
    Reach,
    /// Normal force (two-sided) and friction pyramid (4), at a force node or a control point beside it.
    Force,
    /// Height of a swinging foot above the terrain, one row, in `momentum` two-sided.
    Swing,
    /// `momentum`: horizontal speed in mid-swing, one row a swing.
    Stride,
}

impl Family {
    /// Whether its rows are equalities.
    pub fn equality(self) -> bool {
        matches!(self, Family::Dynamics | Family::LinearMomentum | Family::AngularMomentum)
    }
}

/// Where an element's rows stand in the buffers.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C)]
pub struct Place {
    /// First Jacobian row; equalities come first, so for them also the index of the residual.
    pub row: u32,
    /// First inequality; the upper sides of all rows, then the lower sides of the first `pairs`.
    pub inequality: u32,
    /// Offset in the Jacobian values, row-major.
    pub jacobian: u32,
    /// Distance of two rows there, a multiple of 8; the padding is zero.
    pub stride: u32,
}

/// A group of rows over the same columns.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct Element {
    /// Family of its rows.
    pub family: Family,
    /// Number of Jacobian rows.
    pub rows: u32,
    /// How many of them (the first) have a lower side too.
    pub pairs: u32,
    /// Where they stand.
    pub place: Place,
    /// Its columns as runs of variables, in [`Layout::runs`].
    pub runs: Span,
}

/// Base pose at one time: `reference + sum_i weights[i] x[variable[i]..][..6]`.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct BasePoint<T> {
    /// Pose on the straight line from start to goal, m and rad.
    pub reference: [T; 6],
    /// Weights of the blocks.
    pub weights: [T; 4],
    /// Blocks in `x`.
    pub variable: [u32; 4],
    /// Their slots in the front, [`NONE`] where they are fixed or have no part.
    pub slot: [u32; 4],
    /// `momentum`: the interval whose deviation counts here.
    pub interval: u32,
    /// Weights of [`Deviation::pose`].
    pub deviation_weights: [T; INNER_POINTS],
}

/// Dynamics rows at one instant.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct DynamicsInstant<T> {
    /// Pose on the reference line and its rate.
    pub reference: [T; 6],
    /// Rate of the reference line, m/s and rad/s.
    pub rate: [T; 6],
    /// Spline weights of value, first and second derivative for three coefficients.
    pub weights: [[T; 3]; 3],
    /// Coefficients in `x`.
    pub variable: [u32; 3],
    /// Their columns.
    pub column: [u32; 3],
    /// Feet in contact, in [`Layout::stance_forces`].
    pub forces: Span,
    /// Buffers.
    pub place: Place,
}

/// Force of a foot in contact at one instant: `sum_i (weights[i][0] value_i + weights[i][1] slope_i)`, N.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct StanceForce<T> {
    /// Hermite weights of value and slope of two nodes, times the scale of the variables.
    pub weights: [[T; 2]; 2],
    /// Nodes in `x`, or [`NONE`].
    pub node: [u32; 2],
    /// Their columns.
    pub node_column: [u32; 2],
    /// Foothold.
    pub foothold: u32,
    /// Its column.
    pub foothold_column: u32,
}

/// Nodes of the Gauss-Legendre rule at which the motion inside an interval is taken.
pub const INNER_POINTS: usize = 6;
/// Points of an interval at which its momentum is taken: the inner ones, then the end.
pub const MOMENTUM_POINTS: usize = INNER_POINTS + 1;

/// One of [`MOMENTUM_POINTS`] points of every interval.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C)]
pub struct MomentumPoint<T> {
    /// Time since the start of the interval, s.
    pub time: T,
    /// Weight in the mean over the interval; 0 at the end.
    pub mean: T,
    /// Hermite weights there of value and rate at the start, value and rate at the end.
    pub value: [T; 4],
    /// The same for the rate.
    pub rate: [T; 4],
    /// Weights of the inner points in the integral from the start to here, s.
    pub integral: [T; INNER_POINTS],
}

/// Momentum rows of one interval.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct MomentumInterval<T> {
    /// Pose on the reference line at the start and at the end.
    pub reference: [[T; 6]; 2],
    /// Rate of the reference line, m/s and rad/s.
    pub rate: [T; 6],
    /// Blocks in `x`: pose and rates at the start, pose and rates at the end, as deviations from the reference line.
    pub variable: [u32; 4],
    /// Their columns in the linear element.
    pub linear_column: [u32; 4],
    /// Their columns in the angular element.
    pub angular_column: [u32; 4],
    /// Force nodes at work, in [`Layout::impulses`], those of one foothold together.
    pub impulses: Span,
    /// Buffers of the linear element.
    pub linear: Place,
    /// Buffers of the angular element.
    pub angular: Place,
}

/// What one force node does in one interval.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct Impulse<T> {
    /// At each point `tau`, for value and slope of the node with basis function `b`: `int b`, `int (tau - s) b` and
    /// `int (tau - s)^2 / 2 b ds` from the start of the interval, times the scale of the variables.
    pub weights: [[[T; 2]; 3]; MOMENTUM_POINTS],
    /// Node in `x`.
    pub node: u32,
    /// Its column in the linear element.
    pub linear_column: u32,
    /// Its column in the angular element.
    pub angular_column: u32,
    /// Foothold.
    pub foothold: u32,
    /// Its column in the angular element.
    pub foothold_column: u32,
}

/// Reach rows at one instant.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct ReachInstant<T> {
    /// Base pose.
    pub base: BasePoint<T>,
    /// Feet, in [`Layout::reach_feet`].
    pub feet: Span,
}

/// Reach rows of one foot: its position is
/// `xy = sum_i xy_weights[i] foothold_i`, `z = sum_i z_weights[i] height(foothold_i) + z_weights[2] swing_height`.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct ReachFoot<T> {
    /// Nominal position in the base frame, m.
    pub nominal: [T; 3],
    /// Weights of the footholds before and after.
    pub xy_weights: [T; 2],
    /// Weights of their heights, and of the swing's mid node.
    pub z_weights: [T; 3],
    /// Footholds; the second is [`NONE`] in stance.
    pub foothold: [u32; 2],
    /// Swing height in `x`, or [`NONE`] in stance.
    pub height: u32,
    /// Columns of the base blocks.
    pub base_column: [u32; 4],
    /// Columns of the footholds.
    pub foothold_column: [u32; 2],
    /// Column of the swing height.
    pub height_column: u32,
    /// Slots of the footholds and of the swing height in the front.
    pub slot: [u32; 3],
    /// Buffers.
    pub place: Place,
}

/// Force rows at a node or beside it: at `value + slope_weight slope`.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct ForceNode<T> {
    /// Node in `x`.
    pub node: u32,
    /// Its column.
    pub node_column: u32,
    /// Weight of the slope: 0 at the node, -1/3 and 1/3 at the Bezier points of the pieces before and after it.
    pub slope_weight: T,
    /// Foothold on whose ground it pushes.
    pub foothold: u32,
    /// Its column.
    pub foothold_column: u32,
    /// Buffers.
    pub place: Place,
}

/// Height of a foot above the terrain at one point of a swing; weights as in [`ReachFoot`].
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct SwingNode<T> {
    /// Weights of the footholds before and after.
    pub xy_weights: [T; 2],
    /// Weights of their heights, and of the swing's mid node.
    pub z_weights: [T; 3],
    /// Lowest height above the terrain, m.
    pub low: T,
    /// Highest, m, where the row is two-sided.
    pub high: T,
    /// Swing height in `x`.
    pub height: u32,
    /// Its column.
    pub height_column: u32,
    /// Footholds before and after.
    pub foothold: [u32; 2],
    /// Their columns.
    pub foothold_column: [u32; 2],
    /// Buffers.
    pub place: Place,
}

/// Length of the step of one swing, which bounds the foot's speed.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct Stride<T> {
    /// Longest step, m.
    pub limit: T,
    /// Footholds before and after.
    pub foothold: [u32; 2],
    /// Their columns.
    pub foothold_column: [u32; 2],
    /// Buffers.
    pub place: Place,
}

/// How the motion inside an interval deviates from the cubic between its knots, under the forces of the last evaluation.
///
/// Rows take it as given: their derivatives leave it out.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C)]
pub struct Deviation<T> {
    /// Of the pose, at the inner points, m and rad.
    pub pose: [[T; 6]; INNER_POINTS],
    /// Of the mean of the angular momentum over the interval, when the attitude at its end is to be exact, N m s.
    pub mean: [T; 3],
}

/// Physical constants and row scales.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct Constants<T> {
    /// Mass, kg.
    pub mass: T,
    /// Weight, N.
    pub weight: T,
    /// Inertia in the base frame, kg m².
    pub inertia: [[T; 3]; 3],
    /// Its inverse.
    pub inverse_inertia: [[T; 3]; 3],
    /// Half-widths of the reach box, m.
    pub reach: [T; 3],
    /// Scale of moments, 1/(N m).
    pub moment_scale: T,
    /// Scale of forces in balance, 1/N.
    pub balance_scale: T,
    /// Interval of base knots, s.
    pub interval: T,
    /// Scale of reach and swing rows, 1/m.
    pub length_scale: T,
    /// Force unit of the variables, N; force rows are divided by it.
    pub force_unit: T,
    /// Largest normal force in that unit.
    pub force_limit: T,
    /// Friction coefficient.
    pub friction: T,
    /// Tightening of reach and swing rows, m.
    pub length_margin: T,
    /// Tightening of force rows, in force units.
    pub force_margin: T,
}

/// The problem of one candidate as flat tables.
#[derive(Debug, Clone)]
pub struct Layout<T> {
    /// Which rows.
    pub transcription: Transcription,
    /// Number of variables.
    pub variables: usize,
    /// Number of equalities.
    pub equalities: usize,
    /// Number of Jacobian rows, equalities included.
    pub rows: usize,
    /// Number of inequalities.
    pub inequalities: usize,
    /// Number of Jacobian values.
    pub jacobian_len: usize,
    /// Initial `x`, the fixed values included.
    pub initial: Vec<T>,
    /// How firmly each variable is pulled to its initial value while the barrier is large, `[variables]`.
    pub pull: Vec<T>,
    /// Constants.
    pub constants: Constants<T>,
    /// What `momentum` motions keep to besides, for their trajectories.
    pub limits: Option<MotionLimits>,
    /// Ground.
    pub terrain: Arc<Terrain>,
    /// Footholds in `x`: kernels name a foothold by its index here.
    pub footholds: Vec<u32>,
    /// Dynamics instants.
    pub dynamics: Vec<DynamicsInstant<T>>,
    /// Forces at dynamics instants.
    pub stance_forces: Vec<StanceForce<T>>,
    /// Points of every momentum interval.
    pub momentum_points: [MomentumPoint<T>; MOMENTUM_POINTS],
    /// Momentum intervals.
    pub momentum: Vec<MomentumInterval<T>>,
    /// What force nodes do in them.
    pub impulses: Vec<Impulse<T>>,
    /// Reach instants.
    pub reach: Vec<ReachInstant<T>>,
    /// Feet at reach instants.
    pub reach_feet: Vec<ReachFoot<T>>,
    /// Force nodes.
    pub force_nodes: Vec<ForceNode<T>>,
    /// Points of swings.
    pub swing_nodes: Vec<SwingNode<T>>,
    /// Steps.
    pub strides: Vec<Stride<T>>,
    /// Elements, in the order of the sweep.
    pub elements: Vec<Element>,
    /// Columns of the elements.
    pub runs: Vec<Run>,
    /// The sweep.
    pub steps: Vec<Step>,
    /// Front-to-front moves and front contents, see [`Step`].
    pub front_runs: Vec<Run>,
    /// Most columns of an element, padding included.
    pub widest: usize,
    /// Distance of two rows of the front, large enough for the largest and a right-hand side.
    pub front_stride: usize,
    /// Number of values of the factor.
    pub factor_len: usize,
    /// Where each curve's blocks are, to turn `x` back into node values.
    pub curves: Curves,
}

/// Positions in `x` of the blocks of each curve.
#[derive(Debug, Clone, Default)]
pub struct Curves {
    /// Number of intervals.
    pub intervals: usize,
    /// Their length, s.
    pub interval: f64,
    /// Base: in `towr` spline coefficients; in `momentum` pose and rates at each knot in turn.
    pub base: Vec<u32>,
    /// Per foot.
    pub feet: Vec<FootBlocks>,
}

/// Positions in `x` of one foot's blocks.
#[derive(Debug, Clone, Default)]
pub struct FootBlocks {
    /// Phases.
    pub phases: Vec<Phase>,
    /// One a stance.
    pub footholds: Vec<u32>,
    /// One a swing.
    pub heights: Vec<u32>,
    /// Nodes of each stance's force, [`NONE`] where the force is zero.
    pub force_nodes: Vec<Vec<u32>>,
}
