//! Builds the [`Layout`] of a candidate: blocks of variables, elements over them, then places and columns for all.
//!
//! What differs between transcriptions (base, dynamics, the instants of reach rows) is in [`super::towr`] and [`super::momentum`].

use super::layout::{
    BasePoint, Constants, Curves, DynamicsInstant, Element, Family, FootBlocks, ForceNode, Impulse, MomentumInterval, NONE, POSE_VALUES,
    Place, ReachFoot, ReachInstant, StanceForce, Stride, SwingNode,
};
use super::sweep::{self, Block, Run, Span};
use super::{Layout, Real, initial_guess, momentum, towr};
use crate::gait::spline::hermite;
use crate::gait::{Phase, Schedule};
use crate::robot::GRAVITY;
use crate::settings::{Transcription, TranscriptionSettings};
use crate::task::Task;
use nalgebra::Matrix3;

/// An element before its columns are known.
struct Draft {
    family: Family,
    /// Index in the family's table.
    entry: usize,
    step: usize,
    blocks: Vec<u32>,
}

/// A layout in the making. Tables name blocks by their ids until [`Builder::finish`].
pub(super) struct Builder<'a, T> {
    pub task: &'a Task,
    pub settings: &'a TranscriptionSettings,
    /// Between base knots, s.
    pub interval: f64,
    /// Of all feet, s.
    pub horizon: f64,
    /// Intervals between base knots.
    pub intervals: usize,
    /// Steps of the sweep.
    steps: usize,
    blocks: Vec<Block>,
    drafts: Vec<Draft>,
    pub curves: Curves,
    pub foothold_blocks: Vec<u32>,
    /// Index in `foothold_blocks` of each foot's first foothold.
    pub first_foothold: Vec<usize>,
    pub dynamics: Vec<DynamicsInstant<T>>,
    pub stance_forces: Vec<StanceForce<T>>,
    pub momentum: Vec<MomentumInterval<T>>,
    pub impulses: Vec<Impulse<T>>,
    reach: Vec<ReachInstant<T>>,
    reach_feet: Vec<ReachFoot<T>>,
    force_nodes: Vec<ForceNode<T>>,
    swing_nodes: Vec<SwingNode<T>>,
    strides: Vec<Stride<T>>,
}

impl<T: Real> Layout<T> {
    /// Tables for one schedule, whose feet all end at a multiple of the interval ([`Schedule::aligned`]).
    pub fn new(task: &Task, schedule: &Schedule, settings: &TranscriptionSettings) -> Layout<T> {
        let mut builder = Builder::new(task, schedule, settings);
        match settings.rows {
            Transcription::Towr => towr::base_blocks(&mut builder),
            Transcription::Momentum => momentum::base_blocks(&mut builder),
        }
        builder.foot_blocks();
        match settings.rows {
            Transcription::Towr => {
                towr::dynamics_elements(&mut builder);
                towr::reach_elements(&mut builder);
            }
            Transcription::Momentum => {
                momentum::interval_elements(&mut builder);
                momentum::reach_elements(&mut builder);
            }
        }
        builder.force_elements();
        builder.swing_elements();
        builder.finish()
    }

    /// Bytes of the tables and of the buffers of one solve.
    pub fn memory(&self) -> usize {
        let value = size_of::<T>();
        let tables = size_of_val(&self.dynamics[..])
            + size_of_val(&self.stance_forces[..])
            + size_of_val(&self.momentum[..])
            + size_of_val(&self.impulses[..])
            + size_of_val(&self.reach[..])
            + size_of_val(&self.reach_feet[..])
            + size_of_val(&self.force_nodes[..])
            + size_of_val(&self.swing_nodes[..])
            + size_of_val(&self.strides[..])
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
        let interval = settings.interval_for(&task.robot);
        let intervals = schedule.intervals(interval);
        let feet = (0..schedule.feet()).map(|foot| FootBlocks { phases: schedule.phases(foot), ..FootBlocks::default() }).collect();
        Builder {
            task,
            settings,
            interval,
            horizon: intervals as f64 * interval,
            intervals,
            steps: intervals + usize::from(settings.rows == Transcription::Towr),
            blocks: Vec::new(),
            drafts: Vec::new(),
            curves: Curves { intervals, interval, base: Vec::new(), feet },
            foothold_blocks: Vec::new(),
            first_foothold: Vec::new(),
            dynamics: Vec::new(),
            stance_forces: Vec::new(),
            momentum: Vec::new(),
            impulses: Vec::new(),
            reach: Vec::new(),
            reach_feet: Vec::new(),
            force_nodes: Vec::new(),
            swing_nodes: Vec::new(),
            strides: Vec::new(),
        }
    }

    /// Adds a block and returns its id.
    pub fn block(&mut self, fixed: bool, initial: Vec<f64>) -> u32 {
        self.blocks.push(Block { initial, pull: [0.; 6], fixed, first: usize::MAX, last: 0 });
        (self.blocks.len() - 1) as u32
    }

    /// Has a block pulled to its initial values.
    pub fn pull(&mut self, block: u32, pull: [f64; 6]) {
        self.blocks[block as usize].pull = pull;
    }

    /// Straight line from start to goal: pose at time `t`.
    pub fn reference(&self, t: f64) -> [f64; 6] {
        let (start, goal, part) = (self.task.base_start(), self.task.base_target, t / self.horizon);
        std::array::from_fn(|i| match i {
            0..3 => start[i] + part * (goal[i] - start[i]),
            5 => part * self.task.yaw_target,
            _ => 0.,
        })
    }

    /// Rate of that line, m/s and rad/s.
    pub fn reference_rate(&self) -> [f64; 6] {
        let (start, goal) = (self.reference(0.), self.reference(self.horizon));
        std::array::from_fn(|i| (goal[i] - start[i]) / self.horizon)
    }

    /// Footholds, swing heights and force nodes. The force is zero, value and slope, where a stance meets a swing.
    fn foot_blocks(&mut self) {
        for foot in 0..self.curves.feet.len() {
            let stances = self.curves.feet[foot].phases.len().div_ceil(2);
            self.first_foothold.push(self.foothold_blocks.len());
            for stance in 0..stances {
                let foothold_guess = self.foothold_guess(foot, stance, stances);
                let foothold = self.block(stance == 0, foothold_guess.to_vec());
                self.foothold_blocks.push(foothold);
                self.curves.feet[foot].footholds.push(foothold);
                if stance + 1 < stances {
                    let next = self.foothold_guess(foot, stance + 1, stances);
                    let above = match self.settings.rows {
                        Transcription::Towr => 0.,
                        Transcription::Momentum => self.settings.clearance,
                    };
                    let mid = initial_guess::swing_height(self.task, foothold_guess, next) + above;
                    let height = self.block(false, vec![mid]);
                    self.curves.feet[foot].heights.push(height);
                }
                let pieces = self.settings.force_pieces;
                let mut nodes = Vec::with_capacity(pieces + 1);
                for node in 0..=pieces {
                    let zero = (node == 0 && stance > 0) || (node == pieces && stance + 1 < stances);
                    nodes.push(if zero { NONE } else { self.force_block(foot, stance, node) });
                }
                self.curves.feet[foot].force_nodes.push(nodes);
            }
        }
    }

    fn foothold_guess(&self, foot: usize, stance: usize, stances: usize) -> [f64; 2] {
        match self.settings.rows {
            Transcription::Towr => initial_guess::foothold(self.task, foot, stance, stances),
            Transcription::Momentum if stance == 0 => self.task.foothold_start(foot),
            Transcription::Momentum if stance + 1 == stances => self.task.foothold_goal(foot),
            Transcription::Momentum => {
                let span = self.curves.feet[foot].phases[2 * stance];
                let (pose, _) = momentum::base_guess(self, (span.start + span.end) / 2.);
                initial_guess::under_base(self.task, foot, pose)
            }
        }
    }

    /// Force node that carries its share of the weight: TOWR's among all feet, else among those in contact at its time.
    fn force_block(&mut self, foot: usize, stance: usize, node: usize) -> u32 {
        if self.settings.rows == Transcription::Towr {
            return self.block(false, vec![0., 0., 1., 0., 0., 0.]);
        }
        let span = self.curves.feet[foot].phases[2 * stance];
        let t = span.start + span.duration() * node as f64 / self.settings.force_pieces as f64;
        let feet = self.curves.feet.len();
        let in_contact = (0..feet).filter(|&f| self.curves.feet[f].phases[self.phase_at(f, t)].stance).count();
        let id = self.block(false, vec![0., 0., feet as f64 / in_contact as f64, 0., 0., 0.]);
        self.pull(id, [1.; 6]);
        id
    }

    /// Adds an element and extends the lives of its free blocks to its step.
    pub fn element(&mut self, family: Family, entry: usize, step: usize, blocks: impl IntoIterator<Item = u32>) {
        let blocks: Vec<u32> = blocks.into_iter().filter(|&b| b != NONE && !self.blocks[b as usize].fixed).collect();
        for &b in &blocks {
            let block = &mut self.blocks[b as usize];
            block.first = block.first.min(step);
            block.last = block.last.max(step);
        }
        self.drafts.push(Draft { family, entry, step, blocks });
    }

    /// Index of the phase of a foot at time `t`; at a boundary the stance.
    pub fn phase_at(&self, foot: usize, t: f64) -> usize {
        let phases = &self.curves.feet[foot].phases;
        let close = 1e-9;
        let stance = phases.iter().position(|p| p.stance && t >= p.start - close && t <= p.end + close);
        stance.or_else(|| phases.iter().position(|p| t <= p.end)).unwrap_or(phases.len() - 1)
    }

    /// Force unit of the variables: the weight per foot, N.
    pub fn force_unit(&self) -> f64 {
        self.task.robot.weight() / self.task.robot.feet() as f64
    }

    /// Reach rows of some feet at time `t`, at the end of what was added before; `base` has block ids.
    pub fn reach_instant(&mut self, t: f64, feet: std::ops::Range<usize>, step: usize, base: BasePoint<T>) {
        let first_foot = self.reach_feet.len() as u32;
        let coefficients: Vec<u32> = (0..4).filter(|&i| base.weights[i] != T::zero()).map(|i| base.variable[i]).collect();
        for foot in feet {
            let reach = self.reach_foot(foot, t);
            let footholds = reach.foothold.iter().filter(|&&f| f != NONE).map(|&f| self.foothold_blocks[f as usize]);
            let blocks: Vec<u32> = coefficients.iter().copied().chain(footholds).chain([reach.height]).collect();
            self.reach_feet.push(reach);
            self.element(Family::Reach, self.reach_feet.len() - 1, step, blocks);
        }
        self.reach.push(ReachInstant { base, feet: Span { start: first_foot, end: self.reach_feet.len() as u32 } });
    }

    /// Weights of a foot's position at time `t` in the phase `span` of a swing: of the footholds in x and y, and of their heights and
    /// the mid node's in z.
    ///
    /// The mid node of a swing stands halfway between the footholds and moves with their distance over a time that the transcription
    /// gives; both pieces start and end at rest in z, and at the footholds altogether.
    fn swing_weights(&self, span: Phase, t: f64) -> ([f64; 2], [f64; 3]) {
        let half = span.duration() / 2.;
        let u = t - span.start;
        let mid_time = match self.settings.rows {
            Transcription::Towr => towr::SWING_DURATION,
            Transcription::Momentum => span.duration() / momentum::MID_SPEED,
        };
        if u < half {
            let w = hermite(u, half);
            ([w[0] + 0.5 * w[2] - w[3] / mid_time, 0.5 * w[2] + w[3] / mid_time], [w[0], 0., w[2]])
        } else {
            let w = hermite(u - half, half);
            ([0.5 * w[0] - w[1] / mid_time, w[2] + 0.5 * w[0] + w[1] / mid_time], [0., w[2], w[0]])
        }
    }

    fn reach_foot(&self, foot: usize, t: f64) -> ReachFoot<T> {
        let phase = self.phase_at(foot, t);
        let span = self.curves.feet[foot].phases[phase];
        let before = (self.first_foothold[foot] + phase / 2) as u32;
        let (xy, z, after, height) = if span.stance {
            ([1., 0.], [1., 0., 0.], NONE, NONE)
        } else {
            let (xy, z) = self.swing_weights(span, t);
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
            slot: [NONE; 3],
            place: Place::default(),
        }
    }

    /// Step of a row at time `t` that should not lengthen the life of `block`.
    fn step_within(&self, t: f64, block: u32) -> usize {
        let step = ((t / self.interval) as usize).min(self.steps - 1);
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
                    // A cubic lies in the hull of its Bezier points; a node lies between those beside it.
                    let slope_weights: &[f64] = match self.settings.rows {
                        Transcription::Towr => &[0.],
                        Transcription::Momentum if i == 0 => &[0., 1. / 3.],
                        Transcription::Momentum if i == self.settings.force_pieces => &[-1. / 3., 0.],
                        Transcription::Momentum => &[-1. / 3., 1. / 3.],
                    };
                    for &slope_weight in slope_weights {
                        self.force_nodes.push(ForceNode {
                            node,
                            node_column: NONE,
                            slope_weight: T::of(slope_weight),
                            foothold: foothold as u32,
                            foothold_column: NONE,
                            place: Place::default(),
                        });
                        self.element(Family::Force, self.force_nodes.len() - 1, step, [node, self.foothold_blocks[foothold]]);
                    }
                }
            }
        }
    }

    fn swing_elements(&mut self) {
        // Parts of a swing at which its height is held. On flat ground the mid node speaks for all: z rises to it and falls from it.
        let parts: &[f64] = match self.settings.rows {
            Transcription::Momentum if self.task.terrain.has_edges() => &[0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875],
            _ => &[0.5],
        };
        for foot in 0..self.curves.feet.len() {
            for (swing, height) in self.curves.feet[foot].heights.clone().into_iter().enumerate() {
                let span = self.curves.feet[foot].phases[2 * swing + 1];
                let foothold: [u32; 2] = std::array::from_fn(|i| (self.first_foothold[foot] + swing + i) as u32);
                let around = foothold.map(|f| self.foothold_blocks[f as usize]);
                for &part in parts {
                    let t = span.start + part * span.duration();
                    let step = self.step_within(t, height);
                    let (xy, z) = self.swing_weights(span, t);
                    let low = if part == 0.5 && self.settings.rows == Transcription::Momentum { self.settings.clearance } else { 0. };
                    self.swing_nodes.push(SwingNode {
                        xy_weights: xy.map(T::of),
                        z_weights: z.map(T::of),
                        low: T::of(low),
                        high: T::of(self.settings.swing_height),
                        height,
                        height_column: NONE,
                        foothold,
                        foothold_column: [NONE; 2],
                        place: Place::default(),
                    });
                    self.element(Family::Swing, self.swing_nodes.len() - 1, step, [height, around[0], around[1]]);
                }
                if self.settings.rows == Transcription::Momentum {
                    let step = self.step_within((span.start + span.end) / 2., height);
                    self.strides.push(Stride {
                        limit: T::of(self.settings.foot_speed * span.duration() / momentum::TOP_SPEED),
                        foothold,
                        foothold_column: [NONE; 2],
                        place: Place::default(),
                    });
                    self.element(Family::Stride, self.strides.len() - 1, step, around);
                }
            }
        }
    }

    /// Orders the variables, gives every element its rows and columns, and replaces block ids by positions in `x`.
    fn finish(mut self) -> Layout<T> {
        let positions = sweep::order(&self.blocks);
        let variables: usize = self.blocks.iter().filter(|b| !b.fixed).map(|b| b.initial.len()).sum();
        let total: usize = self.blocks.iter().map(|b| b.initial.len()).sum();
        let mut initial = vec![T::zero(); total];
        let mut pull = vec![T::zero(); variables];
        for (block, &at) in self.blocks.iter().zip(&positions) {
            for (i, &v) in block.initial.iter().enumerate() {
                initial[at as usize + i] = T::of(v);
                if !block.fixed {
                    pull[at as usize + i] = T::of(block.pull[i]);
                }
            }
        }
        let mut fronts = sweep::fronts(&self.blocks, &positions, self.steps);

        self.drafts.sort_by_key(|d| d.step);
        let equalities = 6 * self.dynamics.len() + 12 * self.momentum.len();
        let mut widest = 0;
        let (mut equality, mut row, mut inequality, mut jacobian) = (0, equalities, 0, 0);
        let mut elements = Vec::with_capacity(self.drafts.len());
        let mut runs: Vec<Run> = Vec::new();
        let mut steps = std::mem::take(&mut fronts.steps);
        for draft in std::mem::take(&mut self.drafts) {
            let (rows, pairs) = match draft.family {
                Family::Dynamics | Family::LinearMomentum | Family::AngularMomentum => (6, 0),
                Family::Reach => (3, 3),
                Family::Force => (5, 1),
                Family::Swing => (1, usize::from(self.settings.rows == Transcription::Momentum)),
                Family::Stride => (1, 0),
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
            widest = widest.max(stride as usize);
            let first_row = if draft.family.equality() { equality } else { row };
            let place = Place { row: first_row as u32, inequality: inequality as u32, jacobian: jacobian as u32, stride };
            if draft.family.equality() {
                equality += rows;
            } else {
                row += rows;
                inequality += rows + pairs;
            }
            jacobian += rows * stride as usize + if draft.family == Family::Reach { POSE_VALUES } else { 0 };
            self.resolve(&draft, place, &columns, &positions, &runs[first_run..]);
            let element = Element {
                family: draft.family,
                rows: rows as u32,
                pairs: pairs as u32,
                place,
                runs: Span { start: first_run as u32, end: runs.len() as u32 },
            };
            steps[draft.step].elements.end = elements.len() as u32 + 1;
            elements.push(element);
        }
        // Steps without elements: empty ranges that keep the order.
        let mut end = 0;
        for step in &mut steps {
            step.elements = Span { start: end, end: step.elements.end.max(end) };
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
            transcription: self.settings.rows,
            variables,
            equalities,
            rows: row,
            inequalities: inequality,
            jacobian_len: jacobian,
            initial,
            pull,
            constants: self.constants(),
            limits: match self.settings.rows {
                Transcription::Towr => None,
                Transcription::Momentum => Some(self.settings.limits()),
            },
            terrain: self.task.terrain.clone(),
            footholds: self.foothold_blocks,
            dynamics: self.dynamics,
            stance_forces: self.stance_forces,
            momentum_points: momentum::points(self.interval),
            momentum: self.momentum,
            impulses: self.impulses,
            reach: self.reach,
            reach_feet: self.reach_feet,
            force_nodes: self.force_nodes,
            swing_nodes: self.swing_nodes,
            strides: self.strides,
            elements,
            runs,
            steps,
            front_runs: fronts.runs,
            widest,
            front_stride: fronts.stride,
            factor_len: fronts.factor_len,
            curves: self.curves,
        }
    }

    /// Writes places, columns and positions into the entries of one element.
    fn resolve(&mut self, draft: &Draft, place: Place, columns: &[(u32, u32)], positions: &[u32], runs: &[Run]) {
        let column = |block: u32| columns.iter().find(|c| c.0 == block).map_or(NONE, |c| c.1);
        let slot = |column: u32| {
            let run = runs.iter().rfind(|run| column != NONE && column >= run.column);
            run.map_or(NONE, |run| run.slot + column - run.column)
        };
        let position = |block: u32| if block == NONE { NONE } else { positions[block as usize] };
        match draft.family {
            Family::Dynamics => {
                let entry = &mut self.dynamics[draft.entry];
                entry.place = place;
                entry.column = entry.variable.map(column);
                entry.variable = entry.variable.map(position);
                for force in &mut self.stance_forces[entry.forces.range()] {
                    force.node_column = force.node.map(column);
                    force.node = force.node.map(position);
                    force.foothold_column = column(self.foothold_blocks[force.foothold as usize]);
                }
            }
            Family::LinearMomentum => {
                let entry = &mut self.momentum[draft.entry];
                entry.linear = place;
                entry.linear_column = entry.variable.map(column);
                for impulse in &mut self.impulses[entry.impulses.range()] {
                    impulse.linear_column = column(impulse.node);
                }
            }
            // Comes after the linear one, which still needs ids.
            Family::AngularMomentum => {
                let entry = &mut self.momentum[draft.entry];
                entry.angular = place;
                entry.angular_column = entry.variable.map(column);
                entry.variable = entry.variable.map(position);
                for impulse in &mut self.impulses[entry.impulses.range()] {
                    impulse.angular_column = column(impulse.node);
                    impulse.node = position(impulse.node);
                    impulse.foothold_column = column(self.foothold_blocks[impulse.foothold as usize]);
                }
            }
            Family::Reach => {
                let at = self.reach.partition_point(|r| r.feet.end as usize <= draft.entry);
                let instant = &mut self.reach[at];
                let base = &mut instant.base;
                let entry = &mut self.reach_feet[draft.entry];
                // The base blocks of an instant stay ids until its last foot has its columns.
                entry.base_column = base.variable.map(column);
                base.slot = entry.base_column.map(slot);
                if draft.entry + 1 == instant.feet.end as usize {
                    base.variable = base.variable.map(position);
                }
                entry.place = place;
                entry.foothold_column = entry.foothold.map(|f| if f == NONE { NONE } else { column(self.foothold_blocks[f as usize]) });
                entry.height_column = column(entry.height);
                entry.height = position(entry.height);
                entry.slot = [entry.foothold_column[0], entry.foothold_column[1], entry.height_column].map(slot);
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
            Family::Stride => {
                let entry = &mut self.strides[draft.entry];
                entry.place = place;
                entry.foothold_column = entry.foothold.map(|f| column(self.foothold_blocks[f as usize]));
            }
        }
    }

    fn constants(&self) -> Constants<T> {
        let robot = &self.task.robot;
        let unit = self.force_unit();
        let inverse = Matrix3::from_fn(|r, c| robot.inertia[r][c]).try_inverse().unwrap_or_else(Matrix3::zeros);
        Constants {
            mass: T::of(robot.mass),
            weight: T::of(robot.mass * GRAVITY),
            inertia: robot.inertia.map(|row| row.map(T::of)),
            inverse_inertia: std::array::from_fn(|r| std::array::from_fn(|c| T::of(inverse[(r, c)]))),
            reach: robot.reach.map(T::of),
            moment_scale: T::of(1. / (robot.weight() * robot.leg_height())),
            balance_scale: T::of(1. / robot.weight()),
            interval: T::of(self.interval),
            length_scale: T::of(10.),
            force_unit: T::of(unit),
            force_limit: T::of(self.task.force_limit / unit),
            friction: T::of(self.task.terrain.friction),
            length_margin: T::of(self.settings.length_margin),
            force_margin: T::of(self.settings.force_margin * robot.feet() as f64),
        }
    }
}
