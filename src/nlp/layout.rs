//! Variables, elements and index tables of one candidate in the `towr` transcription.
//!
//! `x` holds the variables in elimination order, followed by the fixed values (start of the base, first footholds, goal). Variables
//! come in blocks: a base coefficient (position and angles, 6), a force node (value and slope, 6), a foothold (2), a swing height (1).
//! All of `x` is scaled: m, rad, and for forces the weight per foot (slopes: that per piece duration).

use super::sweep::{self, Block, Run, Step};
use super::{Real, initial_guess};
use crate::gait::spline::{BSpline, hermite};
use crate::gait::{Phase, Schedule};
use crate::robot::GRAVITY;
use crate::settings::TranscriptionSettings;
use crate::task::Task;
use crate::terrain::Terrain;
use std::ops::Range;
use std::sync::Arc;

/// No such column or node: a fixed value, or a force node that is zero.
pub const NONE: u32 = u32::MAX;

/// Average swing duration that TOWR assumes for the mid-swing velocity, s.
pub const SWING_DURATION: f64 = 0.3;

/// Values that follow the Jacobian rows of a foot's reach: its three rows by the pose of the base, padded to a multiple of 8.
pub const POSE_VALUES: usize = 24;

/// Row families, for scaling and reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// Newton-Euler equations, 6 equalities an instant: moments, then forces.
    Dynamics,
    /// Reach box, 3 two-sided rows a foot and instant.
    Reach,
    /// Normal force (two-sided) and friction pyramid (4), a force node.
    Force,
    /// Mid node of a swing above the terrain, one row.
    Swing,
}

/// Where an element's rows stand in the buffers.
#[derive(Debug, Clone, Copy, Default)]
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
#[derive(Debug, Clone)]
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
    pub runs: Range<u32>,
}

/// Base pose at one time: `reference + sum_i weights[i] x[variable[i]..][..6]`.
#[derive(Debug, Clone, Copy)]
pub struct BasePoint<T> {
    /// Pose on the straight line from start to goal, m and rad.
    pub reference: [T; 6],
    /// Weights of the blocks.
    pub weights: [T; 4],
    /// Blocks in `x`.
    pub variable: [u32; 4],
}

/// Dynamics rows at one instant.
#[derive(Debug, Clone)]
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
    pub forces: Range<u32>,
    /// Buffers.
    pub place: Place,
}

/// Force of a foot in contact at one instant: `sum_i (weights[i][0] value_i + weights[i][1] slope_i)`, N.
#[derive(Debug, Clone, Copy)]
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

/// Reach rows at one instant.
#[derive(Debug, Clone)]
pub struct ReachInstant<T> {
    /// Base pose.
    pub base: BasePoint<T>,
    /// Feet, in [`Layout::reach_feet`].
    pub feet: Range<u32>,
}

/// Reach rows of one foot: its position is
/// `xy = sum_i xy_weights[i] foothold_i`, `z = sum_i z_weights[i] height(foothold_i) + z_weights[2] swing_height`.
#[derive(Debug, Clone)]
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
    /// Buffers.
    pub place: Place,
}

/// Force rows of one node.
#[derive(Debug, Clone)]
pub struct ForceNode {
    /// Node in `x`.
    pub node: u32,
    /// Its column.
    pub node_column: u32,
    /// Foothold on whose ground it pushes.
    pub foothold: u32,
    /// Its column.
    pub foothold_column: u32,
    /// Buffers.
    pub place: Place,
}

/// Clearance row of one swing.
#[derive(Debug, Clone)]
pub struct SwingNode {
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

/// Physical constants and row scales.
#[derive(Debug, Clone, Copy)]
pub struct Constants<T> {
    /// Mass, kg.
    pub mass: T,
    /// Weight, N.
    pub weight: T,
    /// Inertia in the base frame, kg m².
    pub inertia: [[T; 3]; 3],
    /// Half-widths of the reach box, m.
    pub reach: [T; 3],
    /// Scale of moment rows, 1/(N m).
    pub moment_scale: T,
    /// Scale of force balance rows, 1/N.
    pub balance_scale: T,
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
    /// Constants.
    pub constants: Constants<T>,
    /// Ground.
    pub terrain: Arc<Terrain>,
    /// Footholds in `x`: kernels name a foothold by its index here.
    pub footholds: Vec<u32>,
    /// Dynamics instants.
    pub dynamics: Vec<DynamicsInstant<T>>,
    /// Forces at dynamics instants.
    pub stance_forces: Vec<StanceForce<T>>,
    /// Reach instants.
    pub reach: Vec<ReachInstant<T>>,
    /// Feet at reach instants.
    pub reach_feet: Vec<ReachFoot<T>>,
    /// Force nodes.
    pub force_nodes: Vec<ForceNode>,
    /// Swings.
    pub swing_nodes: Vec<SwingNode>,
    /// Elements, in the order of the sweep.
    pub elements: Vec<Element>,
    /// Columns of the elements.
    pub runs: Vec<Run>,
    /// The sweep.
    pub steps: Vec<Step>,
    /// Front-to-front moves and front contents, see [`Step`].
    pub front_runs: Vec<Run>,
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
    /// Base coefficients.
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

/// An element before its columns are known.
struct Draft {
    family: Family,
    /// Index in the family's table.
    entry: usize,
    step: usize,
    blocks: Vec<u32>,
}

struct Builder<'a, T> {
    task: &'a Task,
    settings: &'a TranscriptionSettings,
    spline: BSpline,
    horizon: f64,
    intervals: usize,
    blocks: Vec<Block>,
    drafts: Vec<Draft>,
    /// Block ids for now.
    curves: Curves,
    foothold_blocks: Vec<u32>,
    /// Index in `foothold_blocks` of each foot's first foothold.
    first_foothold: Vec<usize>,
    dynamics: Vec<DynamicsInstant<T>>,
    stance_forces: Vec<StanceForce<T>>,
    reach: Vec<ReachInstant<T>>,
    reach_feet: Vec<ReachFoot<T>>,
    force_nodes: Vec<ForceNode>,
    swing_nodes: Vec<SwingNode>,
}

impl<T: Real> Layout<T> {
    /// Tables for one schedule, whose feet all end at a multiple of the interval ([`Schedule::aligned`]).
    pub fn new(task: &Task, schedule: &Schedule, settings: &TranscriptionSettings) -> Layout<T> {
        let mut builder = Builder::new(task, schedule, settings);
        builder.base_blocks();
        builder.foot_blocks();
        builder.dynamics_elements();
        builder.reach_elements();
        builder.force_elements();
        builder.swing_elements();
        builder.finish()
    }

    /// Bytes of the tables and of the buffers of one solve.
    pub fn memory(&self) -> usize {
        let value = size_of::<T>();
        let tables = size_of_val(&self.dynamics[..])
            + size_of_val(&self.stance_forces[..])
            + size_of_val(&self.reach[..])
            + size_of_val(&self.reach_feet[..])
            + size_of_val(&self.force_nodes[..])
            + size_of_val(&self.swing_nodes[..])
            + size_of_val(&self.elements[..])
            + size_of_val(&self.runs[..])
            + size_of_val(&self.steps[..])
            + size_of_val(&self.front_runs[..]);
        let buffers = self.jacobian_len + self.factor_len + 2 * self.front_stride * self.front_stride;
        tables + value * (buffers + 6 * self.initial.len() + 6 * self.rows + 8 * self.inequalities)
    }
}

impl<'a, T: Real> Builder<'a, T> {
    fn new(task: &'a Task, schedule: &Schedule, settings: &'a TranscriptionSettings) -> Self {
        let intervals = schedule.intervals(settings.interval);
        let feet = (0..schedule.feet()).map(|foot| FootBlocks { phases: schedule.phases(foot), ..FootBlocks::default() }).collect();
        Builder {
            task,
            settings,
            spline: BSpline::new(intervals, settings.interval),
            horizon: intervals as f64 * settings.interval,
            intervals,
            blocks: Vec::new(),
            drafts: Vec::new(),
            curves: Curves { intervals, interval: settings.interval, base: Vec::new(), feet },
            foothold_blocks: Vec::new(),
            first_foothold: Vec::new(),
            dynamics: Vec::new(),
            stance_forces: Vec::new(),
            reach: Vec::new(),
            reach_feet: Vec::new(),
            force_nodes: Vec::new(),
            swing_nodes: Vec::new(),
        }
    }

    fn block(&mut self, fixed: bool, initial: Vec<f64>) -> u32 {
        self.blocks.push(Block { initial, fixed, first: usize::MAX, last: 0 });
        (self.blocks.len() - 1) as u32
    }

    /// Straight line from start to goal: pose at time `t`.
    fn reference(&self, t: f64) -> [f64; 6] {
        let (start, goal, part) = (self.task.base_start(), self.task.base_target, t / self.horizon);
        std::array::from_fn(|i| match i {
            0..3 => start[i] + part * (goal[i] - start[i]),
            5 => part * self.task.yaw_target,
            _ => 0.,
        })
    }

    /// Base coefficients as deviations from the reference line. The first two (start pose at rest) and the last (goal) are fixed.
    fn base_blocks(&mut self) {
        let count = self.spline.coefficients();
        let start = self.reference(0.);
        let rise = initial_guess::final_base_height(self.task) - self.task.base_target[2];
        for j in 0..count {
            let on_line = self.reference(self.spline.greville(j));
            let fixed = j < 2 || j == count - 1;
            let initial = if j < 2 {
                (0..6).map(|i| start[i] - on_line[i]).collect()
            } else if j == count - 1 {
                vec![0.; 6]
            } else {
                vec![0., 0., self.spline.greville(j) / self.horizon * rise, 0., 0., 0.]
            };
            let id = self.block(fixed, initial);
            self.curves.base.push(id);
        }
    }

    /// Footholds, swing heights and force nodes. The force is zero, value and slope, where a stance meets a swing.
    fn foot_blocks(&mut self) {
        for foot in 0..self.curves.feet.len() {
            let stances = self.curves.feet[foot].phases.len().div_ceil(2);
            self.first_foothold.push(self.foothold_blocks.len());
            for stance in 0..stances {
                let foothold = self.block(stance == 0, initial_guess::foothold(self.task, foot, stance, stances).to_vec());
                self.foothold_blocks.push(foothold);
                self.curves.feet[foot].footholds.push(foothold);
                if stance + 1 < stances {
                    let height = self.block(false, vec![initial_guess::swing_height(self.task, foot, stance, stances)]);
                    self.curves.feet[foot].heights.push(height);
                }
                let pieces = self.settings.force_pieces;
                let mut nodes = Vec::with_capacity(pieces + 1);
                for node in 0..=pieces {
                    let zero = (node == 0 && stance > 0) || (node == pieces && stance + 1 < stances);
                    nodes.push(if zero { NONE } else { self.block(false, vec![0., 0., 1., 0., 0., 0.]) });
                }
                self.curves.feet[foot].force_nodes.push(nodes);
            }
        }
    }

    /// Adds an element and extends the lives of its free blocks to its step.
    fn element(&mut self, family: Family, entry: usize, step: usize, blocks: impl IntoIterator<Item = u32>) {
        let blocks: Vec<u32> = blocks.into_iter().filter(|&b| b != NONE && !self.blocks[b as usize].fixed).collect();
        for &b in &blocks {
            let block = &mut self.blocks[b as usize];
            block.first = block.first.min(step);
            block.last = block.last.max(step);
        }
        self.drafts.push(Draft { family, entry, step, blocks });
    }

    /// Index of the phase of a foot at time `t`; at a boundary the stance.
    fn phase_at(&self, foot: usize, t: f64) -> usize {
        let phases = &self.curves.feet[foot].phases;
        let close = 1e-9;
        let stance = phases.iter().position(|p| p.stance && t >= p.start - close && t <= p.end + close);
        stance.or_else(|| phases.iter().position(|p| t <= p.end)).unwrap_or(phases.len() - 1)
    }

    fn dynamics_elements(&mut self) {
        for k in 0..=self.intervals {
            let t = k as f64 * self.settings.interval;
            // At a knot three of the four functions are alive: the first three of the interval that starts there.
            let (interval, skip) = if k < self.intervals { (k, 0) } else { (k - 1, 1) };
            let weights = std::array::from_fn(|derivative| {
                let basis = self.spline.basis(interval, t, derivative);
                std::array::from_fn(|i| T::of(basis[i + skip]))
            });
            let coefficients: [u32; 3] = std::array::from_fn(|i| self.curves.base[k + i]);
            let first_force = self.stance_forces.len() as u32;
            let mut blocks = coefficients.to_vec();
            for foot in 0..self.curves.feet.len() {
                let phase = self.phase_at(foot, t);
                if !self.curves.feet[foot].phases[phase].stance {
                    continue;
                }
                let force = self.stance_force(foot, phase, t);
                blocks.extend(force.node);
                blocks.push(self.foothold_blocks[force.foothold as usize]);
                self.stance_forces.push(force);
            }
            let (start, goal) = (self.reference(0.), self.reference(self.horizon));
            self.dynamics.push(DynamicsInstant {
                reference: self.reference(t).map(T::of),
                rate: std::array::from_fn(|i| T::of((goal[i] - start[i]) / self.horizon)),
                weights,
                variable: coefficients,
                column: [NONE; 3],
                forces: first_force..self.stance_forces.len() as u32,
                place: Place::default(),
            });
            self.element(Family::Dynamics, k, k, blocks);
        }
    }

    fn force_unit(&self) -> f64 {
        self.task.robot.weight() / self.task.robot.feet() as f64
    }

    fn stance_force(&self, foot: usize, phase: usize, t: f64) -> StanceForce<T> {
        let span = self.curves.feet[foot].phases[phase];
        let nodes = &self.curves.feet[foot].force_nodes[phase / 2];
        let pieces = self.settings.force_pieces;
        let duration = span.duration() / pieces as f64;
        let piece = (((t - span.start) / duration).max(0.) as usize).min(pieces - 1);
        let w = hermite(t - span.start - piece as f64 * duration, duration);
        let (value, slope) = (self.force_unit(), self.force_unit() / duration);
        StanceForce {
            weights: [[T::of(w[0] * value), T::of(w[1] * slope)], [T::of(w[2] * value), T::of(w[3] * slope)]],
            node: [nodes[piece], nodes[piece + 1]],
            node_column: [NONE; 2],
            foothold: (self.first_foothold[foot] + phase / 2) as u32,
            foothold_column: NONE,
        }
    }

    fn reach_elements(&mut self) {
        let every = self.settings.reach_interval;
        let mut times: Vec<f64> = (0..=(self.horizon / every + 1e-9) as usize).map(|i| i as f64 * every).collect();
        if self.horizon - times[times.len() - 1] > 1e-6 {
            times.push(self.horizon);
        }
        for t in times {
            let t = t.min(self.horizon);
            let interval = ((t / self.settings.interval + 1e-9) as usize).min(self.intervals - 1);
            // The last instant goes with the last dynamics rows.
            let step = if t >= self.horizon - 1e-9 { self.intervals } else { interval };
            let coefficients: [u32; 4] = std::array::from_fn(|i| self.curves.base[interval + i]);
            let first_foot = self.reach_feet.len() as u32;
            for foot in 0..self.curves.feet.len() {
                let reach = self.reach_foot(foot, t);
                let footholds = reach.foothold.iter().filter(|&&f| f != NONE).map(|&f| self.foothold_blocks[f as usize]);
                let blocks: Vec<u32> = coefficients.into_iter().chain(footholds).chain([reach.height]).collect();
                self.reach_feet.push(reach);
                self.element(Family::Reach, self.reach_feet.len() - 1, step, blocks);
            }
            self.reach.push(ReachInstant {
                base: BasePoint {
                    reference: self.reference(t).map(T::of),
                    weights: self.spline.basis(interval, t, 0).map(T::of),
                    variable: coefficients,
                },
                feet: first_foot..self.reach_feet.len() as u32,
            });
        }
    }

    /// Weights of a foot's position at time `t`. The mid node of a swing stands halfway between the footholds and moves with
    /// their distance / [`SWING_DURATION`]; both pieces start and end at rest in z, and at the footholds altogether.
    fn reach_foot(&self, foot: usize, t: f64) -> ReachFoot<T> {
        let phase = self.phase_at(foot, t);
        let span = self.curves.feet[foot].phases[phase];
        let before = (self.first_foothold[foot] + phase / 2) as u32;
        let (xy, z, after, height) = if span.stance {
            ([1., 0.], [1., 0., 0.], NONE, NONE)
        } else {
            let half = span.duration() / 2.;
            let u = t - span.start;
            let (xy, z) = if u < half {
                let w = hermite(u, half);
                ([w[0] + 0.5 * w[2] - w[3] / SWING_DURATION, 0.5 * w[2] + w[3] / SWING_DURATION], [w[0], 0., w[2]])
            } else {
                let w = hermite(u - half, half);
                ([0.5 * w[0] - w[1] / SWING_DURATION, w[2] + 0.5 * w[0] + w[1] / SWING_DURATION], [0., w[2], w[0]])
            };
            (xy, z, before + 1, self.curves.feet[foot].heights[phase / 2])
        };
        ReachFoot {
            nominal: self.task.robot.nominal_feet[foot].map(T::of),
            xy_weights: xy.map(T::of),
            z_weights: z.map(T::of),
            foothold: [before, after],
            height,
            base_column: [NONE; 4],
            foothold_column: [NONE; 2],
            height_column: NONE,
            place: Place::default(),
        }
    }

    /// Step of a row at time `t` that should not lengthen the life of `block`.
    fn step_within(&self, t: f64, block: u32) -> usize {
        let step = ((t / self.settings.interval) as usize).min(self.intervals);
        let block = &self.blocks[block as usize];
        if block.first <= block.last { step.clamp(block.first, block.last) } else { step }
    }

    fn force_elements(&mut self) {
        for foot in 0..self.curves.feet.len() {
            for stance in 0..self.curves.feet[foot].force_nodes.len() {
                let span = self.curves.feet[foot].phases[2 * stance];
                let foothold = self.first_foothold[foot] + stance;
                for (i, node) in self.curves.feet[foot].force_nodes[stance].clone().into_iter().enumerate() {
                    if node == NONE {
                        continue;
                    }
                    let t = span.start + span.duration() * i as f64 / self.settings.force_pieces as f64;
                    let step = self.step_within(t, node);
                    self.force_nodes.push(ForceNode {
                        node,
                        node_column: NONE,
                        foothold: foothold as u32,
                        foothold_column: NONE,
                        place: Place::default(),
                    });
                    self.element(Family::Force, self.force_nodes.len() - 1, step, [node, self.foothold_blocks[foothold]]);
                }
            }
        }
    }

    fn swing_elements(&mut self) {
        for foot in 0..self.curves.feet.len() {
            for (swing, height) in self.curves.feet[foot].heights.clone().into_iter().enumerate() {
                let span = self.curves.feet[foot].phases[2 * swing + 1];
                let foothold: [u32; 2] = std::array::from_fn(|i| (self.first_foothold[foot] + swing + i) as u32);
                let step = self.step_within((span.start + span.end) / 2., height);
                let around = foothold.map(|f| self.foothold_blocks[f as usize]);
                self.swing_nodes.push(SwingNode {
                    height,
                    height_column: NONE,
                    foothold,
                    foothold_column: [NONE; 2],
                    place: Place::default(),
                });
                self.element(Family::Swing, self.swing_nodes.len() - 1, step, [height, around[0], around[1]]);
            }
        }
    }

    /// Orders the variables, gives every element its rows and columns, and replaces block ids by positions in `x`.
    fn finish(mut self) -> Layout<T> {
        let positions = sweep::order(&self.blocks);
        let variables: usize = self.blocks.iter().filter(|b| !b.fixed).map(|b| b.initial.len()).sum();
        let total: usize = self.blocks.iter().map(|b| b.initial.len()).sum();
        let mut initial = vec![T::zero(); total];
        for (block, &at) in self.blocks.iter().zip(&positions) {
            for (i, &v) in block.initial.iter().enumerate() {
                initial[at as usize + i] = T::of(v);
            }
        }
        let mut fronts = sweep::fronts(&self.blocks, &positions, self.intervals + 1);

        self.drafts.sort_by_key(|d| d.step);
        let equalities = 6 * self.dynamics.len();
        let (mut equality, mut row, mut inequality, mut jacobian) = (0, equalities, 0, 0);
        let mut elements = Vec::with_capacity(self.drafts.len());
        let mut runs: Vec<Run> = Vec::new();
        let mut steps = std::mem::take(&mut fronts.steps);
        for draft in std::mem::take(&mut self.drafts) {
            let (rows, pairs) = match draft.family {
                Family::Dynamics => (6, 0),
                Family::Reach => (3, 3),
                Family::Force => (5, 1),
                Family::Swing => (1, 0),
            };
            let mut blocks: Vec<u32> = draft.blocks.clone();
            blocks.sort_by_key(|&b| positions[b as usize]);
            blocks.dedup();
            let first_run = runs.len();
            let mut columns = Vec::with_capacity(blocks.len());
            let mut column = 0u32;
            for b in blocks {
                let (variable, len) = (positions[b as usize], self.blocks[b as usize].initial.len() as u32);
                columns.push((b, column));
                let extends = runs[first_run..].last().is_some_and(|r| r.variable + r.len == variable);
                match runs.last_mut().filter(|_| extends) {
                    Some(run) => run.len += len,
                    None => runs.push(Run { variable, slot: fronts.slot(draft.step, variable), column, len }),
                }
                column += len;
            }
            let stride = column.next_multiple_of(8);
            let first_row = if draft.family == Family::Dynamics { equality } else { row };
            let place = Place { row: first_row as u32, inequality: inequality as u32, jacobian: jacobian as u32, stride };
            if draft.family == Family::Dynamics {
                equality += rows;
            } else {
                row += rows;
                inequality += rows + pairs;
            }
            jacobian += rows * stride as usize + if draft.family == Family::Reach { POSE_VALUES } else { 0 };
            self.resolve(&draft, place, &columns, &positions);
            let element =
                Element { family: draft.family, rows: rows as u32, pairs: pairs as u32, place, runs: first_run as u32..runs.len() as u32 };
            steps[draft.step].elements.end = elements.len() as u32 + 1;
            elements.push(element);
        }
        // Steps without elements: empty ranges that keep the order.
        let mut end = 0;
        for step in &mut steps {
            step.elements = end..step.elements.end.max(end);
            end = step.elements.end;
        }

        let at = |ids: &mut Vec<u32>| ids.iter_mut().filter(|id| **id != NONE).for_each(|id| *id = positions[*id as usize]);
        at(&mut self.curves.base);
        for foot in &mut self.curves.feet {
            at(&mut foot.footholds);
            at(&mut foot.heights);
            foot.force_nodes.iter_mut().for_each(&at);
        }
        at(&mut self.foothold_blocks);
        Layout {
            variables,
            equalities,
            rows: row,
            inequalities: inequality,
            jacobian_len: jacobian,
            initial,
            constants: self.constants(),
            terrain: self.task.terrain.clone(),
            footholds: self.foothold_blocks,
            dynamics: self.dynamics,
            stance_forces: self.stance_forces,
            reach: self.reach,
            reach_feet: self.reach_feet,
            force_nodes: self.force_nodes,
            swing_nodes: self.swing_nodes,
            elements,
            runs,
            steps,
            front_runs: fronts.runs,
            front_stride: fronts.stride,
            factor_len: fronts.factor_len,
            curves: self.curves,
        }
    }

    /// Writes places, columns and positions into the entries of one element.
    fn resolve(&mut self, draft: &Draft, place: Place, columns: &[(u32, u32)], positions: &[u32]) {
        let column = |block: u32| columns.iter().find(|c| c.0 == block).map_or(NONE, |c| c.1);
        let position = |block: u32| if block == NONE { NONE } else { positions[block as usize] };
        match draft.family {
            Family::Dynamics => {
                let entry = &mut self.dynamics[draft.entry];
                entry.place = place;
                entry.column = entry.variable.map(column);
                entry.variable = entry.variable.map(position);
                for force in &mut self.stance_forces[entry.forces.start as usize..entry.forces.end as usize] {
                    force.node_column = force.node.map(column);
                    force.node = force.node.map(position);
                    force.foothold_column = column(self.foothold_blocks[force.foothold as usize]);
                }
            }
            Family::Reach => {
                let at = self.reach.partition_point(|r| r.feet.end as usize <= draft.entry);
                let instant = &mut self.reach[at];
                let base = &mut instant.base;
                let entry = &mut self.reach_feet[draft.entry];
                // The base blocks of an instant stay ids until its last foot has its columns.
                entry.base_column = base.variable.map(column);
                if draft.entry + 1 == instant.feet.end as usize {
                    base.variable = base.variable.map(position);
                }
                entry.place = place;
                entry.foothold_column = entry.foothold.map(|f| if f == NONE { NONE } else { column(self.foothold_blocks[f as usize]) });
                entry.height_column = column(entry.height);
                entry.height = position(entry.height);
            }
            Family::Force => {
                let entry = &mut self.force_nodes[draft.entry];
                entry.place = place;
                entry.node_column = column(entry.node);
                entry.node = position(entry.node);
                entry.foothold_column = column(self.foothold_blocks[entry.foothold as usize]);
            }
            Family::Swing => {
                let entry = &mut self.swing_nodes[draft.entry];
                entry.place = place;
                entry.height_column = column(entry.height);
                entry.height = position(entry.height);
                entry.foothold_column = entry.foothold.map(|f| column(self.foothold_blocks[f as usize]));
            }
        }
    }

    fn constants(&self) -> Constants<T> {
        let robot = &self.task.robot;
        let unit = self.force_unit();
        Constants {
            mass: T::of(robot.mass),
            weight: T::of(robot.mass * GRAVITY),
            inertia: robot.inertia.map(|row| row.map(T::of)),
            reach: robot.reach.map(T::of),
            moment_scale: T::of(1. / (robot.weight() * robot.leg_height())),
            balance_scale: T::of(1. / robot.weight()),
            length_scale: T::of(10.),
            force_unit: T::of(unit),
            force_limit: T::of(self.task.force_limit / unit),
            friction: T::of(self.task.terrain.friction),
            length_margin: T::of(self.settings.length_margin),
            force_margin: T::of(self.settings.force_margin * robot.feet() as f64),
        }
    }
}
