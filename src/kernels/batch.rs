//! What every shader sees: sizes of the batch, the candidate of each slot, and the tables that only shaders use.
//!
//! One workgroup works on one slot. Every table and array holds the same number of entries a slot, enough for the largest candidate.
//! Twin: `shaders/shared/batch.wgsl` and `shaders/shared/tables.wgsl`. All members have four bytes, so that the layouts agree.

use super::control::{Limits, Progress};
use crate::nlp::Layout;
use crate::nlp::layout::{
    BasePoint, DynamicsInstant, Element, ForceNode, Impulse, MomentumInterval, Place, ReachFoot, ReachInstant, StanceForce, Stride,
    SwingNode,
};
use crate::nlp::layout::{Constants, Family, MOMENTUM_POINTS, MomentumPoint};
use crate::nlp::sweep::Run;
use crate::nlp::sweep::Span;
use crate::settings::{SolverSettings, Transcription};
use crate::terrain::{Profile, Shape as TerrainShape, Terrain};
use bytemuck::{NoUninit, Pod, Zeroable};

/// Marks tables that are sent as bytes.
macro_rules! sent {
    ($($table:ty),*) => {
        // SAFETY: `#[repr(C)]`, with members of four bytes alone and so without padding; `tests/shader_layout.rs` adds them up.
        $(unsafe impl NoUninit for $table {})*
    };
}

sent!(Constants<f32>, MomentumPoint<f32>, BasePoint<f32>, DynamicsInstant<f32>, StanceForce<f32>, MomentumInterval<f32>, Impulse<f32>);
sent!(ReachInstant<f32>, ReachFoot<f32>, ForceNode<f32>, SwingNode<f32>, Stride<f32>, Element, Place, Run, Slot);

// SAFETY: likewise, and any bits are a value of its members.
unsafe impl Zeroable for Progress<f32> {}
// SAFETY: likewise.
unsafe impl Pod for Progress<f32> {}

/// Sizes and settings of a batch.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
#[allow(missing_docs, reason = "see shaders/shared/batch.wgsl")]
pub struct Batch {
    pub footholds: u32,
    pub dynamics: u32,
    pub stance_forces: u32,
    pub momentum: u32,
    pub impulses: u32,
    pub reach: u32,
    pub reach_feet: u32,
    pub force_nodes: u32,
    pub swing_nodes: u32,
    pub strides: u32,
    pub elements: u32,
    pub runs: u32,
    pub steps: u32,
    pub rests: u32,
    pub gathers: u32,
    pub touches: u32,
    pub values: u32,
    pub jacobian: u32,
    pub factor: u32,
    pub x: u32,
    pub x_half: u32,
    pub initial: u32,
    pub pull: u32,
    pub direction: u32,
    pub scaling: u32,
    pub diagonal: u32,
    pub gradient: u32,
    pub right_hand_side: u32,
    pub ground: u32,
    pub deviations: u32,
    pub c: u32,
    pub c_half: u32,
    pub c_change: u32,
    pub g: u32,
    pub g_half: u32,
    pub g_change: u32,
    pub weight: u32,
    pub value: u32,
    pub slack: u32,
    pub multiplier: u32,
    pub slack_step: u32,
    pub multiplier_step: u32,
    pub history: u32,
    pub carry: u32,
    pub front: u32,
    pub flags: u32,
    pub max_iterations: u32,
    pub stall_start: u32,
    pub stall_window: u32,
    pub stall_budget: f32,
    pub tolerance: f32,
    pub barrier: f32,
    pub proximal_floor: f32,
    pub pull_weight: f32,
    pub closing: f32,
}

/// Terrain of a candidate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Shape {
    /// Which one.
    pub kind: u32,
    /// Samples of a grid along x.
    pub rows: u32,
    /// Along y.
    pub columns: u32,
    /// Its first height among those of all grids.
    pub first: u32,
    /// Its lower corner, m.
    pub low: [f32; 2],
    /// Its samples per metre.
    pub per_metre: [f32; 2],
}

impl Shape {
    /// Shape of a terrain whose heights, when it is a grid, stand from `first` on.
    pub fn of(terrain: &Terrain, first: u32) -> Shape {
        let profile = |kind| Shape { kind, ..Shape::default() };
        match &terrain.shape {
            TerrainShape::Flat => profile(0),
            TerrainShape::Profile(Profile::Block) => profile(1),
            TerrainShape::Profile(Profile::Stairs) => profile(2),
            TerrainShape::Profile(Profile::Gap) => profile(3),
            TerrainShape::Profile(Profile::Slope) => profile(4),
            TerrainShape::Profile(Profile::Chimney) => profile(5),
            TerrainShape::Profile(Profile::ChimneyLr) => profile(6),
            TerrainShape::Grid(grid) => {
                let samples = [grid.heights.len(), grid.heights[0].len()];
                Shape {
                    kind: 7,
                    rows: samples[0] as u32,
                    columns: samples[1] as u32,
                    first,
                    low: grid.low.map(|v| v as f32),
                    per_metre: std::array::from_fn(|axis| (samples[axis] as f64 / (grid.high[axis] - grid.low[axis])) as f32),
                }
            }
        }
    }
}

/// The candidate of a slot: how many entries of each table it has, and its constants.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
#[allow(missing_docs, reason = "counts of the tables in `Layout`")]
pub struct Slot {
    pub variables: u32,
    pub equalities: u32,
    pub rows: u32,
    pub inequalities: u32,
    pub footholds: u32,
    pub dynamics: u32,
    pub momentum: u32,
    pub reach: u32,
    pub force_nodes: u32,
    pub swing_nodes: u32,
    pub strides: u32,
    pub elements: u32,
    pub steps: u32,
    /// 1: height rows of swings are two-sided.
    pub two_sided: u32,
    pub shape: Shape,
    pub constants: Constants<f32>,
    pub points: [MomentumPoint<f32>; MOMENTUM_POINTS],
}

impl Slot {
    /// The slot of a layout.
    pub fn of(layout: &Layout<f32>, first_height: u32) -> Slot {
        Slot {
            variables: layout.variables as u32,
            equalities: layout.equalities as u32,
            rows: layout.rows as u32,
            inequalities: layout.inequalities as u32,
            footholds: layout.footholds.len() as u32,
            dynamics: layout.dynamics.len() as u32,
            momentum: layout.momentum.len() as u32,
            reach: layout.reach.len() as u32,
            force_nodes: layout.force_nodes.len() as u32,
            swing_nodes: layout.swing_nodes.len() as u32,
            strides: layout.strides.len() as u32,
            elements: layout.elements.len() as u32,
            steps: layout.steps.len() as u32,
            two_sided: u32::from(layout.transcription == Transcription::Momentum),
            shape: Shape::of(&layout.terrain, first_height),
            constants: layout.constants,
            points: layout.momentum_points,
        }
    }
}

/// One step of the sweep, see [`crate::nlp::sweep::Step`].
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
#[allow(missing_docs, reason = "see `Step`")]
pub struct FrontStep {
    pub size: u32,
    pub pivots: u32,
    pub variable: u32,
    pub factor: u32,
    pub stride: u32,
    pub elements: Span,
    /// Reach instants.
    pub reach: Span,
    /// What stays after its pivots, in the table of [`Rest`].
    pub rest: Span,
}

/// A variable that stays in the front of a step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Rest {
    /// Its number.
    pub variable: u32,
    /// Its slot in the next front.
    pub slot: u32,
}

/// The elements that touch one variable.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Gather {
    /// In the table of [`Touch`], in the order of the elements.
    pub touches: Span,
    /// How far the variable stands behind the first one of its block.
    pub offset: u32,
}

/// An element that touches a block of variables.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Touch {
    /// The element.
    pub element: u32,
    /// Column of the first variable of the block.
    pub column: u32,
}

/// Tables that only shaders use.
#[derive(Debug, Clone, Default)]
pub struct Sweep {
    /// Steps of the factorisation.
    pub steps: Vec<FrontStep>,
    /// What stays of their fronts.
    pub rests: Vec<Rest>,
    /// Elements by variable, `[variables]`.
    pub gathers: Vec<Gather>,
    /// Elements by block.
    pub touches: Vec<Touch>,
}

impl Sweep {
    /// Tables of a layout.
    pub fn of(layout: &Layout<f32>) -> Sweep {
        let mut sweep = Sweep::default();
        let mut next_reach = 0;
        for (k, step) in layout.steps.iter().enumerate() {
            let start = sweep.rests.len() as u32;
            for run in &layout.front_runs[step.rest.range()] {
                sweep.rests.extend((0..run.len).map(|i| Rest { variable: run.variable + i, slot: 0 }));
            }
            if let Some(next) = layout.steps.get(k + 1) {
                for run in &layout.front_runs[next.moves.range()] {
                    for i in 0..run.len {
                        sweep.rests[(start + run.column + i - step.pivots) as usize].slot = run.slot + i;
                    }
                }
            }
            let first_reach = next_reach;
            let mut feet = layout.elements[step.elements.range()].iter().filter(|e| e.family == Family::Reach).count();
            while feet > 0 {
                feet -= layout.reach[next_reach].feet.range().len();
                next_reach += 1;
            }
            sweep.steps.push(FrontStep {
                size: step.size,
                pivots: step.pivots,
                variable: step.variable,
                factor: step.factor,
                stride: step.stride,
                elements: step.elements,
                reach: Span { start: first_reach as u32, end: next_reach as u32 },
                rest: Span { start, end: sweep.rests.len() as u32 },
            });
        }
        sweep.gather(layout);
        sweep
    }

    /// Blocks are the longest runs of variables that the same elements touch.
    fn gather(&mut self, layout: &Layout<f32>) {
        // Where runs begin or end, blocks do.
        let mut begins = vec![false; layout.variables + 1];
        for run in &layout.runs {
            begins[run.variable as usize] = true;
            begins[(run.variable + run.len) as usize] = true;
        }
        let mut block_of = Vec::with_capacity(layout.variables);
        let mut firsts: Vec<u32> = Vec::new();
        for variable in 0..layout.variables {
            if begins[variable] || firsts.is_empty() {
                firsts.push(variable as u32);
            }
            block_of.push(firsts.len() - 1);
        }
        let blocks_of = |run: &crate::nlp::sweep::Run| block_of[run.variable as usize]..=block_of[(run.variable + run.len - 1) as usize];
        let mut ends = vec![0u32; firsts.len() + 1];
        for run in &layout.runs {
            for block in blocks_of(run) {
                ends[block + 1] += 1;
            }
        }
        for block in 0..firsts.len() {
            ends[block + 1] += ends[block];
        }
        let starts = ends.clone();
        self.touches = vec![Touch::default(); ends[firsts.len()] as usize];
        for (element, entry) in layout.elements.iter().enumerate() {
            for run in &layout.runs[entry.runs.range()] {
                for block in blocks_of(run) {
                    let column = run.column + firsts[block] - run.variable;
                    self.touches[ends[block] as usize] = Touch { element: element as u32, column };
                    ends[block] += 1;
                }
            }
        }
        self.gathers = (0..layout.variables)
            .map(|variable| {
                let block = block_of[variable];
                let touches = Span { start: starts[block], end: starts[block + 1] };
                Gather { touches, offset: variable as u32 - firsts[block] }
            })
            .collect();
    }
}

/// What the largest candidate of a batch needs.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[allow(missing_docs, reason = "largest of the numbers in `Layout` and `Sweep`")]
pub struct Sizes {
    pub all: usize,
    pub variables: usize,
    pub equalities: usize,
    pub rows: usize,
    pub inequalities: usize,
    pub jacobian: usize,
    pub factor: usize,
    pub footholds: usize,
    pub dynamics: usize,
    pub stance_forces: usize,
    pub momentum: usize,
    pub impulses: usize,
    pub reach: usize,
    pub reach_feet: usize,
    pub force_nodes: usize,
    pub swing_nodes: usize,
    pub strides: usize,
    pub elements: usize,
    pub runs: usize,
    pub steps: usize,
    pub rests: usize,
    pub touches: usize,
    /// Largest front, without its right-hand side.
    pub front: usize,
    /// Most that stays of a front.
    pub rest: usize,
    /// Most columns of an element.
    pub columns: usize,
}

impl Sizes {
    /// Sizes of one candidate.
    pub fn of(layout: &Layout<f32>, sweep: &Sweep) -> Sizes {
        let largest = |of: fn(&FrontStep) -> u32| sweep.steps.iter().map(of).max().unwrap_or(0) as usize;
        Sizes {
            all: layout.initial.len(),
            variables: layout.variables,
            equalities: layout.equalities,
            rows: layout.rows,
            inequalities: layout.inequalities,
            jacobian: layout.jacobian_len,
            factor: layout.factor_len,
            footholds: layout.footholds.len(),
            dynamics: layout.dynamics.len(),
            stance_forces: layout.stance_forces.len(),
            momentum: layout.momentum.len(),
            impulses: layout.impulses.len(),
            reach: layout.reach.len(),
            reach_feet: layout.reach_feet.len(),
            force_nodes: layout.force_nodes.len(),
            swing_nodes: layout.swing_nodes.len(),
            strides: layout.strides.len(),
            elements: layout.elements.len(),
            runs: layout.runs.len(),
            steps: layout.steps.len(),
            rests: sweep.rests.len(),
            touches: sweep.touches.len(),
            front: largest(|s| s.size),
            rest: largest(|s| s.size - s.pivots),
            columns: layout.widest,
        }
    }

    /// Enough for both.
    pub fn max(self, other: Sizes) -> Sizes {
        macro_rules! largest {
            ($($field:ident)*) => { Sizes { $($field: self.$field.max(other.$field)),* } };
        }
        largest!(all variables equalities rows inequalities jacobian factor footholds dynamics stance_forces momentum impulses reach reach_feet
            force_nodes swing_nodes strides elements runs steps rests touches front rest columns)
    }

    /// Sizes by a factor larger; what decides on workgroup memory stays.
    pub fn enlarged(self, factor: f64) -> Sizes {
        let larger = |n: usize| (n as f64 * factor).ceil() as usize;
        macro_rules! enlarge {
            ($($field:ident)*) => { Sizes { $($field: larger(self.$field),)* ..self } };
        }
        enlarge!(all variables equalities rows inequalities jacobian factor footholds dynamics stance_forces momentum impulses reach reach_feet
            force_nodes swing_nodes strides elements runs steps rests touches)
    }

    /// Values of the largest front, packed, with its right-hand side.
    pub fn front_values(&self) -> usize {
        self.front * (self.front + 3) / 2
    }

    /// Whether other sizes fit into these.
    pub fn hold(&self, other: Sizes) -> bool {
        self.max(other) == *self
    }
}

impl Batch {
    /// Sizes and offsets of a batch of candidates.
    ///
    /// * `front_in_storage` - whether workgroup memory does not hold the front
    pub fn new(sizes: &Sizes, settings: &SolverSettings, front_in_storage: bool) -> Batch {
        let mut values = 0u32;
        let mut array = |len: usize| {
            let at = values;
            values += len as u32;
            at
        };
        let limits = Limits::<f32>::new(settings);
        let size = |n: usize| n.max(1) as u32;
        Batch {
            footholds: size(sizes.footholds),
            dynamics: size(sizes.dynamics),
            stance_forces: size(sizes.stance_forces),
            momentum: size(sizes.momentum),
            impulses: size(sizes.impulses),
            reach: size(sizes.reach),
            reach_feet: size(sizes.reach_feet),
            force_nodes: size(sizes.force_nodes),
            swing_nodes: size(sizes.swing_nodes),
            strides: size(sizes.strides),
            elements: size(sizes.elements),
            runs: size(sizes.runs),
            steps: size(sizes.steps),
            rests: size(sizes.rests),
            gathers: size(sizes.variables),
            touches: size(sizes.touches),
            jacobian: size(sizes.jacobian),
            factor: size(sizes.factor),
            x: array(2 * sizes.all),
            x_half: sizes.all as u32,
            initial: array(sizes.all),
            pull: array(sizes.variables),
            direction: array(sizes.variables),
            scaling: array(sizes.variables),
            diagonal: array(sizes.variables),
            gradient: array(sizes.variables),
            right_hand_side: array(sizes.variables),
            ground: array(3 * sizes.footholds),
            deviations: array(36 * sizes.momentum),
            c: array(2 * sizes.equalities),
            c_half: sizes.equalities as u32,
            c_change: array(sizes.equalities),
            g: array(2 * sizes.inequalities),
            g_half: sizes.inequalities as u32,
            g_change: array(sizes.inequalities),
            weight: array(sizes.rows),
            value: array(sizes.rows),
            slack: array(sizes.inequalities),
            multiplier: array(sizes.inequalities),
            slack_step: array(sizes.inequalities),
            multiplier_step: array(sizes.inequalities),
            history: array(settings.stall.window),
            carry: array(sizes.rest * (sizes.rest + 1)),
            front: array(if front_in_storage { sizes.front_values() } else { 0 }),
            flags: array(1),
            values,
            max_iterations: limits.max_iterations,
            stall_start: limits.stall_start,
            stall_window: limits.stall_window,
            stall_budget: limits.stall_budget,
            tolerance: settings.tolerance as f32,
            barrier: limits.barrier,
            proximal_floor: limits.proximal_floor,
            pull_weight: limits.pull,
            closing: limits.closing,
        }
    }
}

/// Progress of a candidate whose initial values stand in the first half: they are evaluated as a trial point.
pub fn first_progress(layout: &Layout<f32>, settings: &SolverSettings) -> Progress<f32> {
    let edge_radius = settings.edge_radius_on(&layout.terrain) as f32;
    Progress { current: 1, ..Progress::first(&Limits::new(settings), edge_radius) }
}
