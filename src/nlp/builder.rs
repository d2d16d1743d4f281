//! Builder of a [`Layout`]: collects blocks of variables and elements over them, then assigns places and columns.

use super::Layout;
use super::footing::{self, FootholdRegion};
use super::layout::{Curves, Element, FootBlocks};
use super::sweep::{self, Block};
use super::transcription::ground_path::GroundPath;
use super::transcription::{self, legs};
use crate::gait::trajectory::MotionLimits;
use crate::gait::{AlignedSchedule, Phase};
use crate::real::Real;
use crate::robot::GRAVITY;
use crate::rows::blocks::{BlockId, Foothold, Placed, Seat, Use};
use crate::rows::reach::{self, BaseBlocks, BasePoint, ReachFoot, ReachInstant, ReachLeg, ReachRows};
use crate::rows::table::{NONE, Place, Run, Span};
use crate::rows::{Constants, Family, RowCounts, RowKind, Spec, Tables};
use crate::settings::{Transcription, TranscriptionSettings};
use crate::task::Task;
use nalgebra::Matrix3;
use std::ops::Range;

/// Element whose columns are not known yet.
struct Draft {
    family: Family,
    /// Index in the family's table.
    entry: usize,
    step: usize,
    pairs: usize,
    /// Weight of the absolute values of cost rows; 0 for quadratic ones.
    weight: f64,
    /// Range in [`Builder::uses`].
    uses: Range<usize>,
}

/// Instant of reach rows whose columns are not known yet.
struct ReachDraft {
    step: usize,
    /// Interval whose deviation applies.
    interval: u32,
    /// Blocks of its base pose.
    base: [Use; 4],
}

/// Leg whose columns are not known yet.
struct LegDraft<T> {
    leg: ReachLeg<T>,
    /// Blocks that its rows use in addition to the base pose.
    uses: [Use; 3],
    /// Last step for which the leg was placed, its index in [`Tables::reach_legs`] for that step, and its number of columns including those
    /// of the pose.
    placed: (usize, usize, u32),
}

/// Blocks of one foot.
#[derive(Default)]
pub(super) struct FootDraft {
    pub phases: Vec<Phase>,
    /// Foothold of each stance.
    pub footholds: Vec<Foothold>,
    /// Box of each foothold but the first; empty if feet keep no distance from edges.
    pub footings: Vec<FootholdRegion>,
    /// Swing height of each swing.
    pub heights: Vec<BlockId>,
    /// Force nodes of each stance; `None` where the force is zero.
    pub force_nodes: Vec<Vec<Option<BlockId>>>,
}

impl FootDraft {
    /// Index of the phase at time `t`; at a boundary between phases, the stance.
    pub fn phase_at(&self, t: f64) -> usize {
        self.phase_from(&mut 0, t)
    }

    /// Index of the phase at time `t`, as [`FootDraft::phase_at`], for calls in order of time.
    ///
    /// * `from` - index of a phase at or before the result, initially 0; advanced by each call
    pub fn phase_from(&self, from: &mut usize, t: f64) -> usize {
        let close = 1e-9;
        let last = self.phases.len() - 1;
        while *from < last && self.phases[*from].end + close < t {
            *from += 1;
        }
        let phase = &self.phases[*from];
        let lands = !phase.stance && *from < last && t >= phase.end - close;
        *from + usize::from(lands)
    }
}

/// State of the builder.
pub(super) struct Builder<'a, T> {
    pub task: &'a Task,
    pub settings: &'a TranscriptionSettings,
    /// Interval between base knots, s.
    pub interval: f64,
    /// Ground path of the base in the initial guess.
    pub ground_path: Option<GroundPath>,
    /// Horizon of all feet, s.
    pub horizon: f64,
    /// Number of intervals between base knots.
    pub intervals: usize,
    /// Number of steps of the sweep.
    steps: usize,
    pub tables: Tables<T>,
    /// Blocks of the base. `towr`: spline coefficients; `momentum`: pose and rates, alternating, of each knot.
    pub base: Vec<BlockId>,
    pub feet: Vec<FootDraft>,
    blocks: Vec<Block>,
    drafts: Vec<Draft>,
    uses: Vec<Use>,
    /// Instants of reach rows, in the order of their table.
    reach: Vec<ReachDraft>,
    /// Legs of the reach rows. Until [`Builder::finish`], feet refer to these indices.
    legs: Vec<LegDraft<T>>,
    footholds: Vec<BlockId>,
    /// Largest normal force of a foot, N.
    force_limit: f64,
    /// Limits that motions satisfy in addition to their rows.
    limits: Option<MotionLimits>,
}

impl<'a, T: Real> Builder<'a, T> {
    /// Creates a builder without blocks and elements.
    ///
    /// * `force_limit` - largest normal force of a foot, N
    /// * `steps` - number of steps of the sweep
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
            reach: Vec::new(),
            legs: Vec::new(),
            footholds: Vec::new(),
            force_limit,
            limits: transcription::of::<T>(settings.rows).limits(settings, &task.robot),
        }
    }

    /// Adds a block of at most six variables. `smoothing` holds the weights that attract them to their initial values.
    pub fn block<const N: usize>(&mut self, fixed: bool, initial: [f64; N], smoothing: [f64; 6]) -> BlockId {
        let initial = std::array::from_fn(|i| initial.get(i).copied().unwrap_or_default());
        self.blocks.push(Block { initial, len: N, smoothing, fixed, first: usize::MAX, last: 0 });
        BlockId(self.blocks.len() as u32 - 1)
    }

    /// Adds a foothold.
    pub fn foothold(&mut self, fixed: bool, initial: [f64; 2], smoothing: f64) -> Foothold {
        let block = self.block(fixed, initial, [smoothing; 6]);
        self.footholds.push(block);
        Foothold { index: self.footholds.len() as u32 - 1, block }
    }

    /// Pose on the straight line from start to goal at time `t`.
    pub fn reference(&self, t: f64) -> [f64; 6] {
        self.task.line(t / self.horizon)
    }

    /// Rate of the straight line from start to goal, m/s and rad/s.
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
    /// * `uses` - blocks that its rows use, in the order of the family's roles
    pub fn element(&mut self, family: Family, entry: usize, step: usize, uses: &[Use]) {
        self.element_of(family, entry, step, family.spec().pairs, uses);
    }

    /// Adds an element like [`Builder::element`], but with its own number of two-sided rows.
    pub fn element_of(&mut self, family: Family, entry: usize, step: usize, pairs: usize, uses: &[Use]) {
        self.draft(Draft { family, entry, step, pairs, weight: 0., uses: 0..0 }, uses);
    }

    /// Adds an element of cost rows. Cost rows do not change the elimination order: a block that no constraint touches at this step is read
    /// only.
    ///
    /// * `weight` - of the absolute values of the rows in the objective; 0 if half of their squares count instead
    pub fn cost_element(&mut self, family: Family, entry: usize, step: usize, weight: f64, uses: &[Use]) {
        let alive = |id: BlockId| (self.blocks[id.0 as usize].first..=self.blocks[id.0 as usize].last).contains(&step);
        let uses: Vec<Use> = uses
            .iter()
            .map(|used| match *used {
                Use::Touches(id) if !alive(id) => Use::Reads(id),
                used => used,
            })
            .collect();
        self.draft(Draft { family, entry, step, pairs: 0, weight, uses: 0..0 }, &uses);
    }

    fn draft(&mut self, draft: Draft, uses: &[Use]) {
        self.touch(draft.step, uses);
        let first = self.uses.len();
        self.uses.extend_from_slice(uses);
        self.drafts.push(Draft { uses: first..self.uses.len(), ..draft });
    }

    /// Reserves capacity for reach rows.
    pub fn reserve_reach(&mut self, instants: usize, feet: usize) {
        self.tables.reach_instants.reserve_exact(instants);
        self.reach.reserve_exact(instants);
        self.tables.reach_feet.reserve_exact(feet);
    }

    /// Adds an instant of reach rows. Its step must not be before that of the previous instant.
    ///
    /// * `interval` - see [`BaseBlocks`]
    pub fn reach_instant(&mut self, base: BasePoint<T>, interval: u32, step: usize, uses: [Use; 4]) {
        self.touch(step, &uses);
        let end = self.tables.reach_feet.len() as u32;
        self.tables.reach_instants.push(ReachInstant { base, feet: Span { start: end, end } });
        self.reach.push(ReachDraft { step, interval, base: uses });
    }

    /// Adds the data that reach rows of one foot share in a phase. Returns the index by which feet refer to it.
    pub fn reach_leg(&mut self, leg: ReachLeg<T>, uses: [Use; 3]) -> u32 {
        self.legs.push(LegDraft { leg, uses, placed: (usize::MAX, 0, 0) });
        self.legs.len() as u32 - 1
    }

    /// Adds a foot to the last instant of reach rows.
    pub fn reach_foot(&mut self, foot: ReachFoot<T>) {
        if let (Some(instant), Some(draft)) = (self.tables.reach_instants.last_mut(), self.reach.last()) {
            instant.feet.end += 1;
            let uses = self.legs[foot.leg as usize].uses;
            self.touch(draft.step, &uses);
            self.tables.reach_feet.push(foot);
        }
    }

    /// Extends the lives of the free blocks that rows touch to the step of the rows.
    fn touch(&mut self, step: usize, uses: &[Use]) {
        for used in uses {
            if let Use::Touches(id) = used
                && let block = &mut self.blocks[id.0 as usize]
                && !block.fixed
            {
                block.first = block.first.min(step);
                block.last = block.last.max(step);
            }
        }
    }

    /// Step for a row at time `t` that does not extend the life of a block.
    pub fn step_within(&self, t: f64, block: BlockId) -> usize {
        let step = ((t / self.interval) as usize).min(self.steps - 1);
        let block = &self.blocks[block.0 as usize];
        if block.first <= block.last { step.clamp(block.first, block.last) } else { step }
    }

    /// Orders the variables and assigns rows and columns to every element and positions in `x` to every table entry.
    pub fn finish(mut self) -> Layout<T> {
        let positions = sweep::order(&self.blocks);
        let variables: usize = self.blocks.iter().filter(|b| !b.fixed).map(|b| b.len).sum();
        let total: usize = self.blocks.iter().map(|b| b.len).sum();
        let mut initial = vec![T::zero(); total];
        let mut smoothing = vec![T::zero(); variables];
        for (block, &at) in self.blocks.iter().zip(&positions) {
            for (i, &v) in block.initial[..block.len].iter().enumerate() {
                initial[at as usize + i] = T::of(v);
                if !block.fixed {
                    smoothing[at as usize + i] = T::of(block.smoothing[i]);
                }
            }
        }
        let mut fronts = sweep::fronts(&self.blocks, &positions, self.steps);
        let mut steps = std::mem::take(&mut fronts.steps);

        let mut drafts = std::mem::take(&mut self.drafts);
        drafts.sort_by_key(|d| d.step);
        let mut next = Next::after(drafts.iter().map(|d| d.family.spec()), self.tables.reach_feet.len());
        let mut elements = Vec::with_capacity(drafts.len());
        let costs = next.counts.of(RowKind::Cost);
        let mut cost_weights = vec![T::zero(); costs.len()];
        let mut runs = Vec::with_capacity(3 * drafts.len());
        let mut columns = Columns::default();
        // Index of each variable in the front of the current step.
        let mut in_front = vec![NONE; variables];
        let mut step = usize::MAX;
        for draft in &drafts {
            if draft.step != step {
                step = draft.step;
                fronts.write(step, &mut in_front);
            }
            let spec = draft.family.spec();
            let first_run = runs.len();
            columns.assign(&self.blocks, &positions, &self.uses[draft.uses.clone()], &in_front, 0);
            columns.add_runs(&mut runs);
            let place = next.place(spec, draft.pairs, columns.count);
            if spec.kind == RowKind::Cost {
                cost_weights[place.row as usize - costs.start..][..spec.rows].fill(T::of(draft.weight));
            }
            draft.family.place(&mut self.tables, draft.entry, &Placed { place, seats: &columns.seats });
            let (rows, pairs) = (spec.rows as u32, draft.pairs as u32);
            elements.push(Element { family: draft.family, rows, pairs, place, runs: Span::added(first_run, &runs) });
            steps[step].elements.end = elements.len() as u32;
        }
        self.tables.reach_rows = ReachRows { row: next.row[RowKind::Inequality as usize] as u32, inequality: next.inequality as u32 };
        let spec = Family::Reach.spec();
        // Step, interval and blocks of the previous instant.
        let mut last = None;
        for (instant, draft) in self.reach.iter().enumerate() {
            if draft.step != step {
                step = draft.step;
                fronts.write(step, &mut in_front);
            }
            let base = (step, draft.interval, &draft.base);
            if last != Some(base) {
                last = Some(base);
                columns.assign(&self.blocks, &positions, &draft.base, &in_front, 0);
                self.tables.base_blocks.push(BaseBlocks::placed(&columns.seats, draft.interval));
            }
            let ReachInstant { base, feet } = &mut self.tables.reach_instants[instant];
            base.blocks = self.tables.base_blocks.len() as u32 - 1;
            for foot in feet.range() {
                let draft = &mut self.legs[self.tables.reach_feet[foot].leg as usize];
                if draft.placed.0 != step {
                    columns.assign(&self.blocks, &positions, &draft.uses, &in_front, reach::POSE as u32);
                    draft.placed = (step, self.tables.reach_legs.len(), columns.count);
                    self.tables.reach_legs.push(draft.leg);
                    let at = Placed { place: Place::default(), seats: &columns.seats };
                    Family::Reach.place(&mut self.tables, draft.placed.1, &at);
                }
                let (_, leg, count) = draft.placed;
                let Place { jacobian, stride, .. } = next.place(spec, spec.pairs, count);
                let foot = &mut self.tables.reach_feet[foot];
                (foot.leg, foot.jacobian, foot.stride) = (leg as u32, jacobian, stride);
            }
            steps[step].reach.end = instant as u32 + 1;
        }
        // Steps without elements get empty ranges that keep the order.
        let (mut end, mut reach_end) = (0, 0);
        for step in &mut steps {
            step.elements = Span { start: end, end: step.elements.end.max(end) };
            step.reach = Span { start: reach_end, end: step.reach.end.max(reach_end) };
            (end, reach_end) = (step.elements.end, step.reach.end);
        }

        self.tables.footholds = self.footholds.iter().map(|&id| positions[id.0 as usize]).collect();
        let curves = self.curves(&positions);
        Layout {
            variables,
            rows: next.counts,
            inequalities: next.inequality,
            jacobian_len: next.jacobian,
            initial,
            smoothing,
            cost_weights,
            tables: self.tables,
            elements,
            runs,
            steps,
            front_runs: fronts.runs,
            widest: next.widest,
            front_stride: fronts.stride,
            factor_len: fronts.factor_len,
            curves,
        }
    }

    /// Orders the variables and returns the positions of the blocks in `x`, without rows and columns.
    pub fn finish_curves(mut self) -> Curves {
        let positions = sweep::order(&self.blocks);
        self.curves(&positions)
    }

    /// Positions in `x` of the blocks of each curve. Takes the blocks of the base and the feet.
    ///
    /// * `positions` - position of each block
    fn curves(&mut self, positions: &[u32]) -> Curves {
        let at = |id: BlockId| positions[id.0 as usize];
        let feet = std::mem::take(&mut self.feet).into_iter().map(|foot| FootBlocks {
            phases: foot.phases,
            footholds: foot.footholds.iter().map(|f| at(f.block)).collect(),
            heights: foot.heights.into_iter().map(at).collect(),
            force_nodes: foot.force_nodes.into_iter().map(|nodes| nodes.into_iter().map(|n| n.map_or(NONE, at)).collect()).collect(),
        });
        Curves {
            transcription: self.settings.rows,
            limits: self.limits,
            force_limit: self.force_limit,
            force_unit: self.force_unit(),
            intervals: self.intervals,
            interval: self.interval,
            variables: self.blocks.iter().filter(|b| !b.fixed).map(|b| b.len).sum(),
            base: std::mem::take(&mut self.base).into_iter().map(at).collect(),
            feet: feet.collect(),
        }
    }
}

/// Place of the next rows.
#[derive(Default)]
struct Next {
    /// Of all rows.
    counts: RowCounts,
    /// Next row of each kind.
    row: [usize; 3],
    inequality: usize,
    jacobian: usize,
    /// Largest number of columns so far, padding included.
    widest: usize,
}

impl Next {
    /// Before the first element.
    ///
    /// * `specs` - of all elements but those of reach rows
    /// * `reach` - number of elements of reach rows
    fn after(specs: impl Iterator<Item = Spec>, reach: usize) -> Next {
        let mut rows = [0, 0, reach * reach::SPEC.rows];
        specs.for_each(|spec| rows[spec.kind as usize] += spec.rows);
        let [equalities, costs, inequalities] = rows.map(|count| count as u32);
        let counts = RowCounts { equalities, costs, inequalities };
        let row = [RowKind::Equality, RowKind::Cost, RowKind::Inequality].map(|kind| counts.of(kind).start);
        Next { counts, row, ..Next::default() }
    }

    /// Place of the rows of one element.
    fn place(&mut self, spec: Spec, pairs: usize, columns: u32) -> Place {
        let stride = columns.next_multiple_of(8);
        let row = &mut self.row[spec.kind as usize];
        let place = Place { row: *row as u32, inequality: self.inequality as u32, jacobian: self.jacobian as u32, stride };
        *row += spec.rows;
        if spec.kind == RowKind::Inequality {
            self.inequality += spec.rows + pairs;
        }
        self.jacobian += spec.rows * stride as usize;
        self.widest = self.widest.max(stride as usize);
        place
    }
}

/// Columns of one element, and the seats of the blocks that it uses.
#[derive(Default)]
struct Columns {
    /// Blocks that have columns, by position in `x`.
    blocks: Vec<BlockColumns>,
    count: u32,
    /// First column of each block that has one, by its id; stale for the other blocks.
    of_block: Vec<u32>,
    seats: Vec<Seat>,
}

/// Columns of one block.
struct BlockColumns {
    id: BlockId,
    position: u32,
    len: u32,
    column: u32,
    front: u32,
}

impl Columns {
    /// Assigns columns, after the first `others`, to the free blocks that the rows touch: each block once, in the order of `x`.
    fn assign(&mut self, blocks: &[Block], positions: &[u32], uses: &[Use], in_front: &[u32], others: u32) {
        let position = |id: BlockId| positions[id.0 as usize];
        self.blocks.clear();
        for used in uses {
            if let Use::Touches(id) = *used
                && let block = &blocks[id.0 as usize]
                && !block.fixed
            {
                let (position, len) = (position(id), block.len as u32);
                self.blocks.push(BlockColumns { id, position, len, column: 0, front: in_front[position as usize] });
            }
        }
        self.blocks.sort_unstable_by_key(|b| b.position);
        self.blocks.dedup_by_key(|b| b.id);
        self.count = others;
        self.of_block.resize(blocks.len(), NONE);
        for block in &mut self.blocks {
            block.column = self.count;
            self.of_block[block.id.0 as usize] = self.count;
            self.count += block.len;
        }
        let seat = |used: &Use| match used {
            Use::Nothing => Seat::NOTHING,
            Use::Touches(id) if !blocks[id.0 as usize].fixed => {
                let position = position(*id);
                Seat { position, column: self.of_block[id.0 as usize], front: in_front[position as usize] }
            }
            Use::Reads(id) | Use::Touches(id) => Seat { position: position(*id), ..Seat::NOTHING },
        };
        self.seats.clear();
        self.seats.extend(uses.iter().map(seat));
    }

    /// Appends the columns as runs, each as long as possible.
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
