//! A [`Layout`] in the making: blocks of variables, elements over them, then places and columns for all.

use super::Layout;
use super::footing::{self, Footing};
use super::layout::{Curves, Element, FootBlocks};
use super::sweep::{self, Block};
use super::transcription::ground_path::GroundPath;
use super::transcription::{self, legs};
use crate::gait::trajectory::MotionLimits;
use crate::gait::{AlignedSchedule, Phase};
use crate::real::Real;
use crate::robot::GRAVITY;
use crate::rows::blocks::{BlockId, Foothold, Placed, Seat, Use};
use crate::rows::table::{NONE, Place, Run, Span};
use crate::rows::{Constants, Family, Tables};
use crate::settings::{Transcription, TranscriptionSettings};
use crate::task::Task;
use nalgebra::Matrix3;
use std::ops::Range;

/// An element before its columns are known.
struct Draft {
    family: Family,
    /// Index in the family's table.
    entry: usize,
    step: usize,
    pairs: usize,
    /// In [`Builder::uses`].
    uses: Range<usize>,
}

/// Blocks of one foot.
#[derive(Default)]
pub(super) struct FootDraft {
    pub phases: Vec<Phase>,
    /// One a stance.
    pub footholds: Vec<Foothold>,
    /// Room for every foothold but the first; none where feet keep from no edge.
    pub footings: Vec<Footing>,
    /// One a swing.
    pub heights: Vec<BlockId>,
    /// Nodes of each stance's force; none where the force is zero.
    pub force_nodes: Vec<Vec<Option<BlockId>>>,
}

impl FootDraft {
    /// Index of the phase at time `t`; at a boundary the stance.
    pub fn phase_at(&self, t: f64) -> usize {
        let close = 1e-9;
        let last = self.phases.len() - 1;
        let phase = self.phases.partition_point(|p| p.end + close < t).min(last);
        let lands = !self.phases[phase].stance && phase < last && t >= self.phases[phase].end - close;
        phase + usize::from(lands)
    }
}

/// A layout in the making.
pub(super) struct Builder<'a, T> {
    pub task: &'a Task,
    pub settings: &'a TranscriptionSettings,
    /// Between base knots, s.
    pub interval: f64,
    /// How the base is to follow the ground at first.
    pub ground_path: Option<GroundPath>,
    /// Of all feet, s.
    pub horizon: f64,
    /// Intervals between base knots.
    pub intervals: usize,
    /// Steps of the sweep.
    steps: usize,
    pub tables: Tables<T>,
    /// Base: in `towr` spline coefficients; in `momentum` pose and rates at each knot in turn.
    pub base: Vec<BlockId>,
    pub feet: Vec<FootDraft>,
    blocks: Vec<Block>,
    drafts: Vec<Draft>,
    uses: Vec<Use>,
    footholds: Vec<BlockId>,
    /// Largest normal force of a foot, N.
    force_limit: f64,
    /// What motions keep to besides.
    limits: Option<MotionLimits>,
}

impl<'a, T: Real> Builder<'a, T> {
    /// * `force_limit` - largest normal force of a foot, N
    /// * `steps` - of the sweep
    pub fn new(task: &'a Task, schedule: &AlignedSchedule, settings: &'a TranscriptionSettings, force_limit: f64, steps: usize) -> Self {
        let (interval, intervals) = (schedule.interval(), schedule.count());
        let feet = (0..schedule.feet()).map(|foot| FootDraft { phases: schedule.phases(foot), ..FootDraft::default() }).collect();
        Builder {
            task,
            settings,
            ground_path: (settings.rows == Transcription::Momentum).then(|| GroundPath::new(task)).flatten(),
            interval,
            horizon: schedule.end(),
            intervals,
            steps,
            tables: Tables::new(constants(task, settings, interval, force_limit), task.terrain.clone(), interval),
            base: Vec::new(),
            feet,
            blocks: Vec::new(),
            drafts: Vec::new(),
            uses: Vec::new(),
            footholds: Vec::new(),
            force_limit,
            limits: transcription::of::<T>(settings.rows).limits(settings, &task.robot),
        }
    }

    /// Adds a block, at most six variables, drawn to their initial values as firmly as `smoothing` says.
    pub fn block(&mut self, fixed: bool, initial: Vec<f64>, smoothing: [f64; 6]) -> BlockId {
        self.blocks.push(Block { initial, smoothing, fixed, first: usize::MAX, last: 0 });
        BlockId(self.blocks.len() as u32 - 1)
    }

    /// Adds a foothold.
    pub fn foothold(&mut self, fixed: bool, initial: [f64; 2], smoothing: f64) -> Foothold {
        let block = self.block(fixed, initial.to_vec(), [smoothing; 6]);
        self.footholds.push(block);
        Foothold { index: self.footholds.len() as u32 - 1, block }
    }

    /// Straight line from start to goal: pose at time `t`.
    pub fn reference(&self, t: f64) -> [f64; 6] {
        self.task.line(t / self.horizon)
    }

    /// Rate of that line, m/s and rad/s.
    pub fn reference_rate(&self) -> [f64; 6] {
        let (start, goal) = (self.reference(0.), self.reference(self.horizon));
        std::array::from_fn(|i| (goal[i] - start[i]) / self.horizon)
    }

    /// Force unit of the variables: the weight per foot, N.
    pub fn force_unit(&self) -> f64 {
        self.task.robot.weight() / self.task.robot.feet() as f64
    }

    /// Adds an element and extends the lives of the free blocks that it touches to its step.
    ///
    /// * `entry` - index in the family's table
    /// * `uses` - what its rows use, in the roles of the family
    pub fn element(&mut self, family: Family, entry: usize, step: usize, uses: &[Use]) {
        self.element_of(family, entry, step, family.spec().pairs, uses);
    }

    /// As [`Builder::element`], with another number of two-sided rows than the family's.
    pub fn element_of(&mut self, family: Family, entry: usize, step: usize, pairs: usize, uses: &[Use]) {
        for used in uses {
            if let Use::Touches(id) | Use::Shares(id) = used
                && let block = &mut self.blocks[id.0 as usize]
                && !block.fixed
            {
                block.first = block.first.min(step);
                block.last = block.last.max(step);
            }
        }
        let first = self.uses.len();
        self.uses.extend_from_slice(uses);
        self.drafts.push(Draft { family, entry, step, pairs, uses: first..self.uses.len() });
    }

    /// Step of a row at time `t` that should not lengthen the life of a block.
    pub fn step_within(&self, t: f64, block: BlockId) -> usize {
        let step = ((t / self.interval) as usize).min(self.steps - 1);
        let block = &self.blocks[block.0 as usize];
        if block.first <= block.last { step.clamp(block.first, block.last) } else { step }
    }

    /// Orders the variables, gives every element its rows and columns, and every entry its positions in `x`.
    pub fn finish(mut self) -> Layout<T> {
        let positions = sweep::order(&self.blocks);
        let variables: usize = self.blocks.iter().filter(|b| !b.fixed).map(|b| b.initial.len()).sum();
        let total: usize = self.blocks.iter().map(|b| b.initial.len()).sum();
        let mut initial = vec![T::zero(); total];
        let mut smoothing = vec![T::zero(); variables];
        for (block, &at) in self.blocks.iter().zip(&positions) {
            for (i, &v) in block.initial.iter().enumerate() {
                initial[at as usize + i] = T::of(v);
                if !block.fixed {
                    smoothing[at as usize + i] = T::of(block.smoothing[i]);
                }
            }
        }
        let mut fronts = sweep::fronts(&self.blocks, &positions, self.steps);
        let mut steps = std::mem::take(&mut fronts.steps);

        let mut drafts = std::mem::take(&mut self.drafts);
        drafts.sort_by_key(|d| (d.family == Family::Reach, d.step));
        let first_reach = drafts.partition_point(|d| d.family != Family::Reach);
        let rows_of = |equality: bool| drafts.iter().map(|d| d.family.spec()).filter(|s| s.equality == equality).map(|s| s.rows).sum();
        let equalities: usize = rows_of(true);
        let mut widest = 0;
        let (mut equality, mut row, mut inequality, mut jacobian) = (0, equalities, 0, 0);
        let mut elements = Vec::with_capacity(drafts.len());
        let mut runs = Vec::with_capacity(2 * drafts.len());
        let mut columns = Columns::default();
        // Index in the front of the step at hand, of each variable that is in it.
        let mut in_front = vec![NONE; variables];
        let mut step = usize::MAX;
        let mut instant = 0;
        for draft in &drafts {
            if draft.step != step {
                step = draft.step;
                fronts.write(step, &mut in_front);
            }
            let spec = draft.family.spec();
            let first_run = runs.len();
            columns.assign(&self.blocks, &positions, &self.uses[draft.uses.clone()], &in_front);
            if draft.family != Family::Reach {
                columns.add_runs(&mut runs);
            }
            let stride = columns.count.next_multiple_of(8);
            widest = widest.max(stride as usize);
            let first_row = if spec.equality { equality } else { row };
            let place = Place { row: first_row as u32, inequality: inequality as u32, jacobian: jacobian as u32, stride };
            if spec.equality {
                equality += spec.rows;
            } else {
                row += spec.rows;
                inequality += spec.rows + draft.pairs;
            }
            jacobian += spec.rows * stride as usize;
            draft.family.place(&mut self.tables, draft.entry, &Placed { place, seats: &columns.seats });
            elements.push(Element {
                family: draft.family,
                rows: spec.rows as u32,
                pairs: draft.pairs as u32,
                place,
                runs: Span::added(first_run, &runs),
            });
            if draft.family == Family::Reach {
                // Instants stand in the order of their feet.
                let instants = &self.tables.reach_instants;
                instant += usize::from(instants[instant].feet.end as usize <= draft.entry);
                steps[draft.step].reach.end = instant as u32 + 1;
            } else {
                steps[draft.step].elements.end = elements.len() as u32;
            }
        }
        // Steps without any: empty ranges that keep the order.
        let (mut end, mut reach_end) = (0, 0);
        for step in &mut steps {
            step.elements = Span { start: end, end: step.elements.end.max(end) };
            step.reach = Span { start: reach_end, end: step.reach.end.max(reach_end) };
            (end, reach_end) = (step.elements.end, step.reach.end);
        }

        let (at, force_unit) = (|id: BlockId| positions[id.0 as usize], self.force_unit());
        self.tables.footholds = self.footholds.iter().map(|&id| at(id)).collect();
        let feet = self.feet.into_iter().map(|foot| FootBlocks {
            phases: foot.phases,
            footholds: foot.footholds.iter().map(|f| at(f.block)).collect(),
            heights: foot.heights.into_iter().map(at).collect(),
            force_nodes: foot.force_nodes.into_iter().map(|nodes| nodes.into_iter().map(|n| n.map_or(NONE, at)).collect()).collect(),
        });
        let base = self.base.into_iter().map(at).collect();
        Layout {
            variables,
            equalities,
            rows: row,
            inequalities: inequality,
            jacobian_len: jacobian,
            initial,
            smoothing,
            tables: self.tables,
            elements,
            first_reach,
            runs,
            steps,
            front_runs: fronts.runs,
            widest,
            front_stride: fronts.stride,
            factor_len: fronts.factor_len,
            curves: Curves {
                transcription: self.settings.rows,
                limits: self.limits,
                force_limit: self.force_limit,
                force_unit,
                intervals: self.intervals,
                interval: self.interval,
                base,
                feet: feet.collect(),
            },
        }
    }
}

/// Columns of one element, and where the blocks that it uses stand.
#[derive(Default)]
struct Columns {
    /// Blocks that have columns, by position.
    blocks: Vec<BlockColumns>,
    count: u32,
    seats: Vec<Seat>,
}

/// Columns of one block.
struct BlockColumns {
    id: BlockId,
    position: u32,
    len: u32,
    /// Whether its columns, the first ones, are those of other blocks, too.
    shared: bool,
    column: u32,
    front: u32,
}

impl Columns {
    /// Free blocks that the rows touch, each once and in the order of `x`, become columns.
    fn assign(&mut self, blocks: &[Block], positions: &[u32], uses: &[Use], in_front: &[u32]) {
        let position = |id: BlockId| positions[id.0 as usize];
        self.blocks.clear();
        // Rows have the shared columns whether a block with them is free or not.
        self.count = 0;
        for used in uses {
            let (id, shared) = match *used {
                Use::Touches(id) => (id, false),
                Use::Shares(id) => (id, true),
                Use::Nothing | Use::Reads(_) => continue,
            };
            let block = &blocks[id.0 as usize];
            let (position, len) = (position(id), block.initial.len() as u32);
            if shared {
                self.count = len;
            }
            if !block.fixed {
                self.blocks.push(BlockColumns { id, position, len, shared, column: 0, front: in_front[position as usize] });
            }
        }
        self.blocks.sort_unstable_by_key(|b| b.position);
        self.blocks.dedup_by_key(|b| b.id);
        for block in self.blocks.iter_mut().filter(|b| !b.shared) {
            block.column = self.count;
            self.count += block.len;
        }
        let seat = |used: &Use| match used {
            Use::Nothing => Seat::NOTHING,
            Use::Reads(id) => Seat { position: position(*id), ..Seat::NOTHING },
            Use::Touches(id) | Use::Shares(id) => {
                let has = self.blocks.iter().find(|b| b.id == *id);
                Seat { position: position(*id), column: has.map_or(NONE, |b| b.column), front: has.map_or(NONE, |b| b.front) }
            }
        };
        self.seats.clear();
        self.seats.extend(uses.iter().map(seat));
    }

    /// The columns as runs, as long as they can be.
    fn add_runs(&self, runs: &mut Vec<Run>) {
        let first = runs.len();
        for &BlockColumns { position, len, column, front, .. } in &self.blocks {
            match runs[first..].last_mut() {
                Some(last) if last.variable + last.len == position => last.len += len,
                _ => runs.push(Run { variable: position, front, column, len }),
            }
        }
    }
}

fn constants<T: Real>(task: &Task, settings: &TranscriptionSettings, interval: f64, force_limit: f64) -> Constants<T> {
    let robot = &task.robot;
    let unit = robot.weight() / robot.feet() as f64;
    let inverse = Matrix3::from_fn(|r, c| robot.inertia[r][c]).try_inverse().unwrap_or_else(Matrix3::zeros);
    Constants {
        mass: T::of(robot.mass),
        weight: T::of(robot.mass * GRAVITY),
        inertia: robot.inertia.map(|row| row.map(T::of)),
        inverse_inertia: std::array::from_fn(|r| std::array::from_fn(|c| T::of(inverse[(r, c)]))),
        moment_scale: T::of(1. / (robot.weight() * robot.leg_height())),
        balance_scale: T::of(1. / robot.weight()),
        interval: T::of(interval),
        length_scale: T::of(10.),
        force_unit: T::of(unit),
        force_limit: T::of(force_limit / unit),
        friction: T::of(task.terrain.friction),
        length_margin: T::of(settings.length_margin),
        force_margin: T::of(settings.force_margin * robot.feet() as f64),
        foot_radius: T::of(footing::radius(task, settings)),
        foot_acceleration: T::of(legs::foot_acceleration(settings).unwrap_or(f64::INFINITY)),
    }
}
