//! Builder of a [`Problem`]: collects blocks of variables and elements over them, then assigns places and columns.

use super::Problem;
use super::columns::Columns;
use super::factored::FactoredDrafts;
use super::footing::{self, FootholdRegion};
use super::ground_path::GroundPath;
use super::problem::{Curves, Element, FootBlocks};
use super::sweep::{self, Block};
use crate::gait::trajectory::MotionLimits;
use crate::gait::{AlignedSchedule, Phase};
use crate::real::Real;
use crate::robot::{GRAVITY, PRESSURE_SHARE};
use crate::rows::blocks::{BlockId, Foothold, Placed, Use};
use crate::rows::cone_curvature;
use crate::rows::factored::{OWN_BLOCKS, POSE_BLOCKS};
use crate::rows::reach::{ReachFoot, ReachInstant, ReachLeg};
use crate::rows::table::{NONE, Span};
use crate::rows::{Constants, Family, RowCounts, RowKind, Tables};
use crate::settings::{Transcription, TranscriptionSettings};
use crate::task::Task;
use nalgebra::Matrix3;
use std::ops::Range;

/// Radius at which the ground ahead of swinging soles is sampled, relative to that of the sole: it moves on between two instants.
const SOLE_LEAD: f64 = 1.1;

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
    /// Moment nodes of each stance of a sole, where there are force nodes; empty for other feet.
    pub moment_nodes: Vec<Vec<Option<BlockId>>>,
    /// Yaw of a sole in each stance; empty for other feet.
    pub yaws: Vec<BlockId>,
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
        // A first stance without length belongs to no time.
        while *from < last && (self.phases[*from].end + close < t || (*from == 0 && self.phases[0].duration() <= 0.)) {
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
    /// Factored rows of the reach family.
    reach: FactoredDrafts,
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
    /// * `limits` - limits that motions satisfy in addition to their rows
    /// * `steps` - number of steps of the sweep
    pub fn new(
        task: &'a Task,
        schedule: &AlignedSchedule,
        settings: &'a TranscriptionSettings,
        force_limit: f64,
        limits: Option<MotionLimits>,
        steps: usize,
    ) -> Self {
        let (interval, intervals) = (schedule.interval(), schedule.count());
        let constants = constants(task, settings, interval, force_limit, limits.and_then(|limits| limits.foot_acceleration));
        let feet = (0..schedule.feet()).map(|foot| FootDraft { phases: schedule.phases(foot), ..FootDraft::default() }).collect();
        Builder {
            task,
            settings,
            ground_path: (settings.rows == Transcription::Momentum).then(|| GroundPath::new(task)).flatten(),
            interval,
            horizon: schedule.end(),
            intervals,
            steps,
            tables: Tables::new(constants, task.terrain.clone(), interval),
            base: Vec::new(),
            feet,
            blocks: Vec::new(),
            drafts: Vec::new(),
            uses: Vec::new(),
            reach: FactoredDrafts::default(),
            footholds: Vec::new(),
            force_limit,
            limits,
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

    /// Unit of the moments of soles: the force unit times the half length of a sole, N m; 0 without soles.
    pub fn moment_unit(&self) -> f64 {
        self.task.robot.sole.map_or(0., |sole| self.force_unit() * sole.half_extents()[0])
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
        sweep::touch(&mut self.blocks, draft.step, uses);
        let first = self.uses.len();
        self.uses.extend_from_slice(uses);
        self.drafts.push(Draft { uses: first..self.uses.len(), ..draft });
    }

    /// Reserves capacity for reach rows.
    pub fn reserve_reach(&mut self, instants: usize, feet: usize) {
        self.tables.reach_instants.reserve_exact(instants);
        self.tables.reach_feet.reserve_exact(feet);
        self.reach.reserve(&mut self.tables.reach_rows, instants, feet);
    }

    /// Adds an instant of reach rows without feet. Its step must not be before that of the previous instant.
    ///
    /// * `weights` - interpolation weights of the base blocks
    /// * `interval` - see [`BaseBlocks`](crate::rows::factored::BaseBlocks)
    pub fn reach_instant(
        &mut self,
        entry: ReachInstant<T>,
        step: usize,
        interval: u32,
        weights: [T; POSE_BLOCKS],
        base: [BlockId; POSE_BLOCKS],
    ) {
        self.reach.instant(&mut self.tables.reach_rows, &mut self.blocks, step, interval, weights, base);
        self.tables.reach_instants.push(entry);
    }

    /// Adds the data that the reach rows of one foot share in a phase. Returns the index by which feet refer to it.
    ///
    /// * `uses` - blocks of the footholds before and after the swing, and of the swing height
    pub fn reach_leg(&mut self, entry: ReachLeg<T>, uses: [Use; OWN_BLOCKS]) -> u32 {
        self.tables.reach_legs.push(entry);
        self.reach.own(uses)
    }

    /// Adds a foot to the last instant of reach rows.
    pub fn reach_foot(&mut self, entry: ReachFoot<T>) {
        self.reach.element(&mut self.tables.reach_rows, &mut self.blocks, entry.leg);
        self.tables.reach_feet.push(entry);
    }

    /// Step for a row at time `t` that does not extend the life of a block.
    pub fn step_within(&self, t: f64, block: BlockId) -> usize {
        let step = ((t / self.interval) as usize).min(self.steps - 1);
        let block = &self.blocks[block.0 as usize];
        if block.first <= block.last { step.clamp(block.first, block.last) } else { step }
    }

    /// Orders the variables and assigns rows and columns to every element and positions in `x` to every table entry.
    pub fn finish(mut self) -> Problem<T> {
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
        let counts = RowCounts::of_specs(drafts.iter().map(|d| d.family.spec()).chain(self.tables.reach_rows.specs()));
        let mut columns = Columns::new(&self.blocks, &positions, &fronts, counts);
        let mut elements = Vec::with_capacity(drafts.len());
        let costs = counts.of(RowKind::Cost);
        let mut cost_weights = vec![T::zero(); costs.len()];
        let mut runs = Vec::with_capacity(3 * drafts.len());
        for draft in &drafts {
            let spec = draft.family.spec();
            let first_run = runs.len();
            columns.assign(draft.step, &self.uses[draft.uses.clone()], 0);
            columns.add_runs(&mut runs);
            let place = columns.place(spec, draft.pairs, columns.count);
            if spec.kind == RowKind::Cost {
                cost_weights[place.row as usize - costs.start..][..spec.rows].fill(T::of(draft.weight));
            }
            draft.family.place(&mut self.tables, draft.entry, &Placed { place, seats: &columns.seats });
            let (rows, pairs) = (spec.rows as u32, draft.pairs as u32);
            elements.push(Element { family: draft.family, rows, pairs, place, runs: Span::added(first_run, &runs) });
            steps[draft.step].elements.end = elements.len() as u32;
        }
        sweep::close(steps.iter_mut().map(|step| &mut step.elements));
        std::mem::take(&mut self.reach).place(&mut self.tables.reach_rows, &mut columns, self.steps);
        let next = columns.next;
        for (curvature, cone) in self.tables.cone_curvatures.iter().zip(&self.tables.cones) {
            let multiplier = (cone.place.inequality + 1) as f64;
            cost_weights[curvature.place.row as usize - costs.start..][..cone_curvature::SPEC.rows].fill(T::of(-1. - multiplier));
        }

        self.tables.footholds = self.footholds.iter().map(|&id| positions[id.0 as usize]).collect();
        let curves = self.curves(&positions);
        Problem {
            variables,
            rows: counts,
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
        let nodes = |stances: Vec<Vec<Option<BlockId>>>| {
            stances.into_iter().map(|nodes| nodes.into_iter().map(|node| node.map_or(NONE, at)).collect()).collect()
        };
        let feet = std::mem::take(&mut self.feet).into_iter().map(|foot| FootBlocks {
            phases: foot.phases,
            footholds: foot.footholds.iter().map(|f| at(f.block)).collect(),
            heights: foot.heights.into_iter().map(at).collect(),
            force_nodes: nodes(foot.force_nodes),
            moment_nodes: nodes(foot.moment_nodes),
            yaws: foot.yaws.into_iter().map(at).collect(),
        });
        Curves {
            transcription: self.settings.rows,
            limits: self.limits,
            force_limit: self.force_limit,
            force_unit: self.force_unit(),
            moment_unit: self.moment_unit(),
            intervals: self.intervals,
            interval: self.interval,
            variables: self.blocks.iter().filter(|b| !b.fixed).map(|b| b.len).sum(),
            base: std::mem::take(&mut self.base).into_iter().map(at).collect(),
            feet: feet.collect(),
        }
    }
}

fn constants<T: Real>(
    task: &Task,
    settings: &TranscriptionSettings,
    interval: f64,
    force_limit: f64,
    foot_acceleration: Option<f64>,
) -> Constants<T> {
    let robot = &task.robot;
    let unit = robot.weight() / robot.feet() as f64;
    let [along, across] = robot.sole.map_or([0.; 2], |sole| sole.half_extents());
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
        foot_radius: T::of(footing::radius(task, settings) * robot.sole.map_or(1., |_| SOLE_LEAD)),
        ball_radius: T::of(if robot.sole.is_some() { 0. } else { footing::radius(task, settings) }),
        foot_acceleration: T::of(foot_acceleration.unwrap_or(f64::INFINITY)),
        pressure: robot.sole.map_or([0.; 2], |_| [PRESSURE_SHARE, PRESSURE_SHARE * across / along]).map(T::of),
        torsion: T::of(robot.sole.map_or(0., |sole| along / sole.torsion_radius())),
    }
}
