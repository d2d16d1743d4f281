//! Data that shaders read: sizes of the batch, the candidate of each slot, and the tables that only shaders use.
//!
//! One workgroup works on one slot. Every table and array has the same number of entries per slot, enough for the largest candidate. There
//! is a single list of tables: that of [`crate::rows`], followed by those of the solver. Buffers, sizes, uploads and the declarations in
//! WGSL are generated from it.
//!
//! Every device supports eight storage buffers per shader. The factorisation needs more tables than that leaves, so these
//! ([`Buffer::JOINED`]) are joined in one buffer, `tables`. A shader binds each of them as an array of its entries, or all of them as
//! words.

use crate::nlp::Problem;
use crate::rows::factored::{FactoredInstant, FactoredRows, FactoredTouch, FirstRows, POSE};
use crate::rows::momentum::{INNER_POINTS, MOMENTUM_POINTS, MomentumPoint};
use crate::rows::table::{MemberArray, Place, Run, Span, Wgsl};
use crate::rows::{Constants, Family, RowCounts, row_tables};
use crate::settings::{SolverSettings, Transcription};
use crate::solver::control::{Limits, Progress, early_termination_rates};
use crate::terrain::{Profile, Shape as TerrainShape, Terrain};

/// Alignment of the offsets of bindings, bytes: the largest that any device requires.
pub const ALIGNMENT: u64 = 256;

/// Table in the form in which it is sent.
#[derive(Debug, Clone, Copy)]
pub struct Sent<'a> {
    /// Bytes of its entries.
    pub bytes: &'a [u8],
    /// Number of entries.
    pub count: usize,
}

fn sent<E: bytemuck::NoUninit>(entries: &[E]) -> Sent<'_> {
    Sent { bytes: bytemuck::cast_slice(entries), count: entries.len() }
}

/// Type of the entries of a buffer.
#[derive(Debug, Clone, Copy)]
pub struct Entry {
    /// Bytes per entry.
    pub size: usize,
    /// Name in shaders.
    pub name: fn() -> String,
    /// Declaration in shaders, see [`Wgsl::declare`].
    pub declare: fn(&mut Vec<(String, String)>),
    /// Construction from words in shaders, see [`Wgsl::read`].
    pub read: fn(u32) -> String,
    /// Arrays in the type, see [`Wgsl::arrays`].
    pub arrays: fn(&str, u32, &mut Vec<MemberArray>),
}

impl Entry {
    fn of<E: Wgsl>() -> Entry {
        Entry { size: size_of::<E>(), name: E::name, declare: E::declare, read: E::read, arrays: E::arrays }
    }

    /// Type of the entries that a function returns.
    fn returned<E: Wgsl>(_: for<'a> fn(&'a Problem<f32>, &'a ShaderTables) -> &'a [E]) -> Entry {
        Entry::of::<E>()
    }
}

macro_rules! all_tables {
    ($($table:ident $buffer:ident [$entry:ty],)*) => {
        gpu_tables! { problem, own,
            joined {
                first_elements Elements,
                first_runs Runs,
                first_front_steps FrontSteps,
                first_rests Rests,
                first_front_rows FrontRows,
                first_front_columns FrontColumns,
                first_base_blocks BaseBlocks,
                first_factored_instants FactoredInstants,
                first_factored_elements FactoredElements,
                first_factored_own FactoredOwn,
                first_reach_instants ReachInstants,
                first_reach_feet ReachFeet,
                first_reach_legs ReachLegs,
                first_gather_of GatherOf,
                first_gathers Gathers,
                first_touches Touches,
                first_factored_touches FactoredTouches,
            }
            $($table $buffer (&problem.tables.$table),)*
            base_blocks BaseBlocks (&problem.reach_rows.base_blocks),
            factored_instants FactoredInstants (&problem.reach_rows.instants),
            factored_elements FactoredElements (&problem.reach_rows.elements),
            factored_own FactoredOwn (&problem.reach_rows.own),
            elements Elements (&problem.elements),
            runs Runs (&problem.runs),
            front_steps FrontSteps (&own.front_steps),
            rests Rests (&own.rests),
            front_rows FrontRows (&own.front_rows),
            front_columns FrontColumns (&own.front_columns),
            gather_of GatherOf (&own.gather_of),
            gathers Gathers (&own.gathers),
            touches Touches (&own.touches),
            factored_touches FactoredTouches (&own.factored_touches),
        }
    };
}

macro_rules! gpu_tables {
    (
        $problem:ident, $own:ident,
        joined { $($first:ident $joined:ident,)* }
        $($table:ident $buffer:ident ($entries:expr),)*
    ) => {
        /// Buffers that shaders bind, named as there.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        #[allow(missing_docs, reason = "named as in the shaders")]
        pub enum Buffer {
            Running,
            Slots,
            Progress,
            Values,
            Jacobian,
            Factor,
            Heights,
            Tables,
            $($buffer,)*
        }

        impl Buffer {
            /// All buffers, in the order of their numbers.
            pub const ALL: &[Buffer] = &[
                Buffer::Running, Buffer::Slots, Buffer::Progress, Buffer::Values, Buffer::Jacobian, Buffer::Factor, Buffer::Heights,
                Buffer::Tables, $(Buffer::$buffer,)*
            ];
            /// Buffers that hold tables of candidates.
            pub const TABLES: &[Buffer] = &[$(Buffer::$buffer,)*];
            /// Tables that are joined in [`Buffer::Tables`], in their order there.
            pub const JOINED: &[Buffer] = &[$(Buffer::$joined,)*];

            /// Name in the shaders.
            pub fn name(self) -> &'static str {
                match self {
                    Buffer::Running => "running",
                    Buffer::Slots => "slots",
                    Buffer::Progress => "progress",
                    Buffer::Values => "values",
                    Buffer::Jacobian => "jacobian",
                    Buffer::Factor => "factor",
                    Buffer::Heights => "heights",
                    Buffer::Tables => "tables",
                    $(Buffer::$buffer => stringify!($table),)*
                }
            }

            /// Type of the entries.
            pub fn entry(self) -> Entry {
                match self {
                    Buffer::Running | Buffer::Tables => Entry::of::<u32>(),
                    Buffer::Slots => Entry::of::<Slot>(),
                    Buffer::Progress => Entry::of::<Progress<f32>>(),
                    Buffer::Values | Buffer::Jacobian | Buffer::Factor | Buffer::Heights => Entry::of::<f32>(),
                    $(Buffer::$buffer => Entry::returned(|$problem, $own| {
                        let _ = ($problem, $own);
                        &$entries[..]
                    }),)*
                }
            }

            /// Entries of a candidate's table; `None` for buffers that are not tables.
            pub fn table<'a>(self, $problem: &'a Problem<f32>, $own: &'a ShaderTables) -> Option<Sent<'a>> {
                match self {
                    $(Buffer::$buffer => Some(sent($entries)),)*
                    _ => None,
                }
            }
        }

        crate::table! {
            /// Sizes and settings of a batch.
            #[derive(Default, PartialEq)]
            pub struct Batch {
                $(
                    #[doc = concat!("Entries per slot in `", stringify!($table), "`.")]
                    pub $table: u32,
                )*
                $(
                    #[doc = concat!("Offset of the table `", stringify!($joined), "` in `tables`, words.")]
                    pub $first: u32,
                )*
                /// Values per slot.
                pub values: u32,
                /// Jacobian values per slot, in each of its two halves.
                pub jacobian: u32,
                /// Values of the factor per slot.
                pub factor: u32,
                /// Offset of `x` in the values of a slot: two halves of `[all]`, at the point and at the trial point.
                pub x: u32,
                /// Length of a half of `x`.
                pub x_half: u32,
                /// Offset of the initial values, `[all]`.
                pub initial: u32,
                /// Offset of the smoothing weights, `[variables]`.
                pub smoothing: u32,
                /// Offset of the direction, `[variables]`.
                pub direction: u32,
                /// Offset of the column scaling, `[variables]`.
                pub scaling: u32,
                /// Offset of the diagonal terms in single variables, `[variables]`.
                pub diagonal: u32,
                /// Offset of the gradient of the terms in single variables, `[variables]`.
                pub gradient: u32,
                /// Offset of the right-hand side of the corrector, `[variables]`.
                pub right_hand_side: u32,
                /// Offset of height and slopes under the footholds, `[footholds][3]`.
                pub ground: u32,
                /// Offset of the deviations of the pose at the inner points, `[intervals][6][6]`.
                pub deviations: u32,
                /// Offset of the equality residuals: two halves of `[equalities]`.
                pub c: u32,
                /// Length of a half of the equality residuals.
                pub c_half: u32,
                /// Offset of the change of the equality residuals along the direction, `[equalities]`.
                pub c_change: u32,
                /// Offset of the inequality residuals: two halves of `[inequalities]`.
                pub g: u32,
                /// Length of a half of the inequality residuals.
                pub g_half: u32,
                /// Offset of the change of the inequality residuals along the direction, `[inequalities]`.
                pub g_change: u32,
                /// Offset of the weights of the rows, `[rows]`.
                pub weight: u32,
                /// Offset of the values of the rows, `[rows]`.
                pub value: u32,
                /// Offset of the slacks, `[inequalities]`.
                pub slack: u32,
                /// Offset of the multipliers, `[inequalities]`.
                pub multiplier: u32,
                /// Offset of the steps of the slacks, `[inequalities]`.
                pub slack_step: u32,
                /// Offset of the steps of the multipliers, `[inequalities]`.
                pub multiplier_step: u32,
                /// Offset of the weights of the absolute values of cost rows, `[costs]`; empty if the batch minimises no cost.
                pub cost_weights: u32,
                /// Offset of the shifts of the equality residuals, as long as a half of `c`; empty if the batch minimises no cost.
                pub shift_c: u32,
                /// Offset of the shifts of the inequality residuals, `[inequalities]`; empty if the batch minimises no cost.
                pub shift_g: u32,
                /// Offset of the solved point from which the minimisation started, `[variables]`; empty if the batch minimises no cost.
                pub solved: u32,
                /// Offset of the recorded infeasibilities, `[window]`.
                pub history: u32,
                /// Offset of what remains of a front between two steps, `[rest][rest + 1]` with its right-hand side.
                pub carry: u32,
                /// Offset of the front, if workgroup memory does not hold it: each value of all tiles in turn, `[4][4][tiles]`.
                pub front: u32,
                /// Number of tiles of the largest front.
                pub tiles: u32,
                /// Offset of the flag, `[1]`: 1 if the last factorisation failed.
                pub flags: u32,
                /// Iteration limit, see [`Limits`].
                pub max_iterations: u32,
                /// First record at which the stall rule may act; `NONE` disables it.
                pub stall_start: u32,
                /// Window of the stall rule, see [`Limits`].
                pub stall_window: u32,
                /// Iteration budget of the stall rule, see [`Limits`].
                pub stall_budget: f32,
                /// Infeasibility below which a solve has succeeded.
                pub tolerance: f32,
                /// Smallest proximal weight.
                pub proximal_floor: f32,
                /// Weight of the smoothing at the first barrier parameter.
                pub smoothing_weight: f32,
                /// Infeasibility below which closing steps are tried.
                pub closing: f32,
                /// Barrier parameter at the start of the minimisation, see [`crate::solver::control::Minimisation`].
                pub minimise_barrier: f32,
                /// Barrier parameter with which the rows are solved again.
                pub restore_barrier: f32,
                /// Weight of the smoothing in the minimisation.
                pub minimise_smoothing: f32,
                /// Weight of the cost rows.
                pub cost_weight: f32,
                /// Rounding of the absolute values of cost rows at the start, m/s.
                pub rounding: f32,
                /// Smallest rounding, m/s.
                pub rounding_floor: f32,
                /// Predicted relative fall of the cost at which the minimisation ends.
                pub minimise_tolerance: f32,
                /// Weighted cost above which the minimisation ends.
                pub cost_limit: f32,
            }

            /// Candidate of a slot: numbers of entries in its tables, and its constants.
            pub struct Slot {
                /// Number of variables.
                pub variables: u32,
                /// Numbers of Jacobian rows by kind.
                pub rows: RowCounts,
                /// Number of inequalities.
                pub inequalities: u32,
                /// First indices of the factored rows.
                pub first_factored: FirstRows,
                /// Decay of the early termination limit, see [`early_termination_rates`].
                pub early_termination_rates: [f32; 3],
                $(
                    #[doc = concat!("Number of entries in `", stringify!($table), "`.")]
                    pub $table: u32,
                )*
                /// Terrain.
                pub shape: Shape,
                /// Constants.
                pub constants: Constants<f32>,
                /// Points of the momentum intervals.
                pub points: [MomentumPoint<f32>; MOMENTUM_POINTS],
            }
        }

        impl Slot {
            /// Slot of a candidate. `first_height` is the offset of its terrain's heights, if that is a grid.
            pub fn of(problem: &Problem<f32>, own: &ShaderTables, first_height: u32) -> Slot {
                let count = |buffer: Buffer| buffer.table(problem, own).map_or(0, |t| t.count as u32);
                Slot {
                    variables: problem.variables as u32,
                    rows: problem.rows,
                    inequalities: problem.inequalities as u32,
                    first_factored: problem.reach_rows.first,
                    early_termination_rates: early_termination_rates(problem.curves.transcription).map(|rate| rate as f32),
                    $($table: count(Buffer::$buffer),)*
                    shape: Shape::of(&problem.terrain, first_height),
                    constants: problem.constants,
                    points: problem.momentum_points,
                }
            }
        }

        impl Batch {
            /// Sizes and offsets of a batch of candidates.
            ///
            /// * `front_in_storage` - true if workgroup memory does not hold the front
            /// * `slots` - number of slots in the buffers
            pub fn new(sizes: &Sizes, settings: &SolverSettings, front_in_storage: bool, slots: usize) -> Batch {
                let mut values = 0u32;
                let mut array = |len: usize| {
                    let at = values;
                    values += len as u32;
                    at
                };
                // Limits that depend on the transcription are in the slots.
                let limits = Limits::<f32>::new(settings, Transcription::Momentum);
                let minimise = limits.minimise;
                let minimised = |len: usize| if minimise.iterations > 0 { len } else { 0 };
                let size = |n: usize| n.max(1) as u32;
                let mut words = 0;
                let mut joined = |buffer: Buffer| {
                    let at = words;
                    words += (sizes.bytes(buffer) * slots as u64).next_multiple_of(ALIGNMENT) / 4;
                    at as u32
                };
                Batch {
                    $($table: size(sizes.entries(Buffer::$buffer)),)*
                    $($first: joined(Buffer::$joined),)*
                    jacobian: size(sizes.jacobian),
                    factor: size(sizes.factor),
                    x: array(2 * sizes.all),
                    x_half: sizes.all as u32,
                    initial: array(sizes.all),
                    smoothing: array(sizes.variables),
                    direction: array(sizes.variables),
                    scaling: array(sizes.variables),
                    diagonal: array(sizes.variables),
                    gradient: array(sizes.variables),
                    right_hand_side: array(sizes.variables),
                    ground: array(3 * sizes.entries(Buffer::Footholds)),
                    deviations: array(POSE * INNER_POINTS * sizes.entries(Buffer::MomentumIntervals)),
                    c: array(2 * sizes.one_sided),
                    c_half: sizes.one_sided as u32,
                    c_change: array(sizes.one_sided),
                    g: array(2 * sizes.inequalities),
                    g_half: sizes.inequalities as u32,
                    g_change: array(sizes.inequalities),
                    weight: array(sizes.rows),
                    value: array(sizes.rows),
                    slack: array(sizes.inequalities),
                    multiplier: array(sizes.inequalities),
                    slack_step: array(sizes.inequalities),
                    multiplier_step: array(sizes.inequalities),
                    cost_weights: array(minimised(sizes.costs)),
                    shift_c: array(minimised(sizes.one_sided)),
                    shift_g: array(minimised(sizes.inequalities)),
                    solved: array(minimised(sizes.variables)),
                    history: array(settings.stall.window),
                    carry: array(sizes.rest * (sizes.rest + 1)),
                    front: array(if front_in_storage { front_values(sizes.front) } else { 0 }),
                    tiles: (front_values(sizes.front) / (TILE * TILE)) as u32,
                    flags: array(1),
                    values,
                    max_iterations: limits.max_iterations,
                    stall_start: limits.stall_start,
                    stall_window: limits.stall_window,
                    stall_budget: limits.stall_budget,
                    tolerance: settings.tolerance as f32,
                    proximal_floor: limits.proximal_floor,
                    smoothing_weight: limits.smoothing,
                    closing: limits.closing,
                    minimise_barrier: minimise.barrier,
                    restore_barrier: minimise.restore_barrier,
                    minimise_smoothing: minimise.smoothing,
                    cost_weight: minimise.weight,
                    rounding: minimise.rounding,
                    rounding_floor: minimise.rounding_floor,
                    minimise_tolerance: minimise.tolerance,
                    cost_limit: minimise.cost_limit,
                }
            }

            /// Offset of a table in [`Buffer::Tables`], words; `None` if it has its own buffer.
            pub fn first(&self, buffer: Buffer) -> Option<u32> {
                match buffer {
                    $(Buffer::$joined => Some(self.$first),)*
                    _ => None,
                }
            }
        }
    };
}
row_tables!(all_tables);

/// Kinds of terrain.
pub mod kind {
    #![allow(missing_docs, reason = "named as the profiles")]
    pub const FLAT: u32 = 0;
    pub const BLOCK: u32 = 1;
    pub const STAIRS: u32 = 2;
    pub const GAP: u32 = 3;
    pub const SLOPE: u32 = 4;
    pub const CHIMNEY: u32 = 5;
    pub const CHIMNEY_LR: u32 = 6;
    pub const GRID: u32 = 7;
}

crate::table! {
    /// Terrain of a candidate.
    #[derive(Default, PartialEq)]
    pub struct Shape {
        /// Kind of terrain, see [`kind`].
        pub kind: u32,
        /// Number of samples of a grid along x.
        pub rows: u32,
        /// Number of samples of a grid along y.
        pub columns: u32,
        /// Index of the grid's first height among those of all grids.
        pub first: u32,
        /// Lower corner of a grid, m.
        pub low: [f32; 2],
        /// Samples per metre along x and y.
        pub per_metre: [f32; 2],
    }

    /// Range of factorisation steps.
    pub struct Part {
        /// First step.
        pub first: u32,
        /// One past the last step.
        pub last: u32,
    }

    /// One step of the factorisation, see [`crate::nlp::sweep::Step`].
    #[derive(Default)]
    pub struct FrontStep {
        /// Size of the front.
        pub size: u32,
        /// Number of pivots: the first variables of the front, which this step eliminates.
        pub pivots: u32,
        /// First pivot.
        pub variable: u32,
        /// Offset of its rows in the factor.
        pub factor: u32,
        /// Distance between two rows of the factor.
        pub stride: u32,
        /// Rows added to the front in this step, in the table of [`FrontRow`].
        pub rows: Span,
        /// Variables that remain after the pivots, in the table of [`Rest`].
        pub rest: Span,
    }

    /// Jacobian row in the order in which the factorisation adds rows to fronts.
    #[derive(Default)]
    pub struct FrontRow {
        /// Number of the row.
        pub row: u32,
        /// Offset of its values in the Jacobian values.
        pub jacobian: u32,
        /// Columns that are not zero, in the table of `front_column`.
        pub columns: Span,
        /// Instant with the interpolation weights of a factored row.
        pub instant: u32,
    }

    /// Variable that remains in the front after a step.
    #[derive(Default, PartialEq)]
    pub struct Rest {
        /// Number of the variable.
        pub variable: u32,
        /// Index in the next front.
        pub next: u32,
    }

    /// Rows that touch a block of variables.
    #[derive(Default, PartialEq)]
    pub struct Gather {
        /// First variable of the block.
        pub variable: u32,
        /// Elements, in the table of [`Touch`], in element order.
        pub touches: Span,
        /// Factored rows, in the table of [`FactoredTouch`], in the order of the instants.
        pub factored: Span,
    }

    /// Element that touches a block of variables.
    #[derive(Default, PartialEq)]
    pub struct Touch {
        /// Number of the element.
        pub element: u32,
        /// Column of the first variable of the block.
        pub column: u32,
    }
}

impl Shape {
    /// Shape of a terrain. `first` is the offset of its heights, if it is a grid.
    pub fn of(terrain: &Terrain, first: u32) -> Shape {
        let profile = |kind| Shape { kind, ..Shape::default() };
        match &terrain.shape {
            TerrainShape::Flat => profile(kind::FLAT),
            TerrainShape::Profile(Profile::Block) => profile(kind::BLOCK),
            TerrainShape::Profile(Profile::Stairs) => profile(kind::STAIRS),
            TerrainShape::Profile(Profile::Gap) => profile(kind::GAP),
            TerrainShape::Profile(Profile::Slope) => profile(kind::SLOPE),
            TerrainShape::Profile(Profile::Chimney) => profile(kind::CHIMNEY),
            TerrainShape::Profile(Profile::ChimneyLr) => profile(kind::CHIMNEY_LR),
            TerrainShape::Grid(grid) => {
                let samples = [grid.heights.len(), grid.heights[0].len()];
                Shape {
                    kind: kind::GRID,
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

/// Rows and columns of the tiles of a front.
pub const TILE: usize = 4;

/// Values of all tiles of a front with its right-hand side: those on and above the diagonal.
pub fn front_values(size: usize) -> usize {
    let tiles = size / TILE + 1;
    tiles * (tiles + 1) / 2 * TILE * TILE
}

/// Bits of an index in `front_column`. A front with more variables does not fit into any workgroup memory.
pub const FRONT_COLUMN_BITS: u32 = 12;

/// Column of a row in a front, packed in a word.
///
/// * `front` - index of the variable in the front
/// * `column` - column among the Jacobian values of the row
/// * `block` - base block whose interpolation weight multiplies the value, plus one; 0 for values that are stored as they are
fn front_column(front: u32, column: u32, block: u32) -> u32 {
    front | column << FRONT_COLUMN_BITS | block << (2 * FRONT_COLUMN_BITS)
}

/// Tables that only shaders use.
#[derive(Debug, Clone, Default)]
pub struct ShaderTables {
    /// Steps of the factorisation.
    pub front_steps: Vec<FrontStep>,
    /// Variables that remain in their fronts.
    pub rests: Vec<Rest>,
    /// Rows that the factorisation adds to its fronts, by step.
    pub front_rows: Vec<FrontRow>,
    /// Their columns, see `front_column`. Rows with the same columns share them.
    pub front_columns: Vec<u32>,
    /// Block of each variable, an index into `gathers`, `[variables]`.
    pub gather_of: Vec<u32>,
    /// Rows that touch each block.
    pub gathers: Vec<Gather>,
    /// Elements by block.
    pub touches: Vec<Touch>,
    /// Factored rows by block.
    pub factored_touches: Vec<FactoredTouch>,
}

impl ShaderTables {
    /// Tables of a problem.
    pub fn of(problem: &Problem<f32>) -> ShaderTables {
        let mut tables = ShaderTables::default();
        for (k, step) in problem.steps.iter().enumerate() {
            let first_rest = tables.rests.len();
            for run in &problem.front_runs[step.rest.range()] {
                tables.rests.extend((0..run.len).map(|i| Rest { variable: run.variable + i, next: 0 }));
            }
            if let Some(next) = problem.steps.get(k + 1) {
                for run in &problem.front_runs[next.moves.range()] {
                    for i in 0..run.len {
                        tables.rests[first_rest + (run.column + i - step.pivots) as usize].next = run.front + i;
                    }
                }
            }
            let rows = tables.add_front_rows(problem, k);
            tables.front_steps.push(FrontStep {
                size: step.size,
                pivots: step.pivots,
                variable: step.variable,
                factor: step.factor,
                stride: step.stride,
                rows,
                rest: Span::added(first_rest, &tables.rests),
            });
        }
        tables.gather(problem);
        tables
    }

    /// Adds the rows of a step of the factorisation with their columns.
    fn add_front_rows(&mut self, problem: &Problem<f32>, step: usize) -> Span {
        let first = self.front_rows.len();
        for element in &problem.elements[problem.steps[step].elements.range()] {
            // Rows of linear momentum touch only the columns of their axis.
            let axes = if element.family == Family::LinearMomentum { 3 } else { 1 };
            let runs = &problem.runs[element.runs.range()];
            let columns = || runs.iter().flat_map(|run| (0..run.len).map(move |i| front_column(run.front + i, run.column + i, 0)));
            let of_axis: [Span; 3] = std::array::from_fn(|axis| match axis < axes {
                true => self.add_front_columns(columns().skip(axis).step_by(axes)),
                false => Span::default(),
            });
            let Place { row, jacobian, stride, .. } = element.place;
            self.front_rows.extend((0..element.rows).map(|r| FrontRow {
                row: row + r,
                jacobian: jacobian + r * stride,
                columns: of_axis[r as usize % axes],
                instant: 0,
            }));
        }
        self.add_factored_rows(&problem.reach_rows, step);
        Span::added(first, &self.front_rows)
    }

    /// Adds the factored rows of a step.
    fn add_factored_rows<const R: usize>(&mut self, rows: &FactoredRows<f32, R>, step: usize) {
        let mut shared: Vec<([u32; 2], Span)> = Vec::new();
        for instant in rows.steps[step].range() {
            let FactoredInstant { blocks, elements, .. } = rows.instants[instant];
            for number in elements.range() {
                let own = rows.elements[number].own;
                let known = shared.iter().rev().find(|(of, _)| *of == [own, blocks]);
                let columns = known.map(|(_, columns)| *columns).unwrap_or_else(|| {
                    let base = rows.base_blocks[blocks as usize].present();
                    let base = base.flat_map(|(block, run)| (0..run.len).map(move |i| front_column(run.front + i, i, block as u32 + 1)));
                    let own = rows.own[own as usize].present();
                    let own = own.flat_map(|run| (0..run.len).map(move |i| front_column(run.front + i, run.column + i, 0)));
                    self.add_front_columns(base.chain(own))
                });
                if known.is_none() {
                    shared.push(([own, blocks], columns));
                }
                let Place { row, jacobian, stride, .. } = rows.place(number);
                let of_row = |r| FrontRow { row: row + r, jacobian: jacobian + r * stride, columns, instant: instant as u32 };
                self.front_rows.extend((0..R as u32).map(of_row));
            }
        }
    }

    /// Adds the columns of rows.
    fn add_front_columns(&mut self, columns: impl Iterator<Item = u32>) -> Span {
        let first = self.front_columns.len();
        self.front_columns.extend(columns);
        Span::added(first, &self.front_columns)
    }

    /// Finds the blocks: the longest runs of variables that the same rows touch.
    fn gather(&mut self, problem: &Problem<f32>) {
        let (by_elements, factored) = (touched(problem), problem.reach_rows.touched());
        // A block begins where a run begins or ends.
        let mut begins = vec![false; problem.variables + 1];
        for run in by_elements.iter().map(|(run, _)| run).chain(factored.iter().map(|(run, _)| run)) {
            begins[run.variable as usize] = true;
            begins[(run.variable + run.len) as usize] = true;
        }
        for variable in 0..problem.variables {
            if begins[variable] || variable == 0 {
                self.gathers.push(Gather { variable: variable as u32, ..Gather::default() });
            }
            self.gather_of.push(self.gathers.len() as u32 - 1);
        }
        let (spans, touches) = self.by_block(&by_elements, |touch, by| Touch { column: touch.column + by, ..touch });
        let (factored_spans, factored) = self.by_block(&factored, |touch, by| FactoredTouch { column: touch.column + by, ..touch });
        (self.touches, self.factored_touches) = (touches, factored);
        for (gather, (touches, factored)) in self.gathers.iter_mut().zip(spans.into_iter().zip(factored_spans)) {
            (gather.touches, gather.factored) = (touches, factored);
        }
    }

    /// Sorts entries that touch runs of variables by block. Returns the range of each block, and all entries.
    ///
    /// * `from` - entry of a block that begins the given number of columns after the run
    fn by_block<E: Copy + Default>(&self, touched: &[(Run, E)], from: impl Fn(E, u32) -> E) -> (Vec<Span>, Vec<E>) {
        let blocks_of = |run: &Run| {
            let [first, last] = [run.variable, run.variable + run.len - 1].map(|variable| self.gather_of[variable as usize] as usize);
            first..=last
        };
        let mut ends = vec![0u32; self.gathers.len() + 1];
        for block in touched.iter().flat_map(|(run, _)| blocks_of(run)) {
            ends[block + 1] += 1;
        }
        for block in 0..self.gathers.len() {
            ends[block + 1] += ends[block];
        }
        let starts = ends.clone();
        let mut entries = vec![E::default(); ends[self.gathers.len()] as usize];
        for (run, entry) in touched {
            for block in blocks_of(run) {
                entries[ends[block] as usize] = from(*entry, self.gathers[block].variable - run.variable);
                ends[block] += 1;
            }
        }
        (starts.windows(2).map(|w| Span { start: w[0], end: w[1] }).collect(), entries)
    }
}

/// Runs of variables that elements touch.
fn touched(problem: &Problem<f32>) -> Vec<(Run, Touch)> {
    let of_run = |element: usize, run: &Run| (*run, Touch { element: element as u32, column: run.column });
    let elements = problem.elements.iter().enumerate();
    elements.flat_map(|(i, element)| problem.runs[element.runs.range()].iter().map(move |run| of_run(i, run))).collect()
}

/// Number of entries of each table.
#[derive(Debug, Clone, Copy, PartialEq)]
struct TableCounts([usize; Buffer::TABLES.len()]);

impl Default for TableCounts {
    fn default() -> Self {
        TableCounts([0; Buffer::TABLES.len()])
    }
}

/// Sizes of the largest candidate of a batch.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[allow(missing_docs, reason = "largest of the numbers in `Problem`")]
pub struct Sizes {
    pub all: usize,
    pub variables: usize,
    pub one_sided: usize,
    pub costs: usize,
    pub rows: usize,
    pub inequalities: usize,
    pub jacobian: usize,
    pub factor: usize,
    /// Entries of each table, in the order of [`Buffer::TABLES`].
    tables: TableCounts,
    /// Size of the largest front, without its right-hand side.
    pub front: usize,
    /// Largest number of variables that remain in a front.
    pub rest: usize,
}

impl Sizes {
    /// Sizes of one candidate.
    pub fn of(problem: &Problem<f32>, own: &ShaderTables) -> Sizes {
        let largest = |of: fn(&FrontStep) -> u32| own.front_steps.iter().map(of).max().unwrap_or(0) as usize;
        Sizes {
            all: problem.initial.len(),
            variables: problem.variables,
            one_sided: problem.rows.one_sided(),
            costs: problem.rows.costs as usize,
            rows: problem.rows.all(),
            inequalities: problem.inequalities,
            jacobian: problem.jacobian_len,
            factor: problem.factor_len,
            tables: TableCounts(std::array::from_fn(|i| Buffer::TABLES[i].table(problem, own).map_or(0, |t| t.count))),
            front: largest(|s| s.size),
            rest: largest(|s| s.size - s.pivots),
        }
    }

    /// Number of entries of a table; 0 for other buffers.
    pub fn entries(&self, buffer: Buffer) -> usize {
        Buffer::TABLES.iter().position(|b| *b == buffer).map_or(0, |i| self.tables.0[i])
    }

    /// Bytes of a table, at least those of one entry; for [`Buffer::Tables`] those of all joined tables; 0 for other buffers.
    pub fn bytes(&self, buffer: Buffer) -> u64 {
        if buffer == Buffer::Tables {
            return Buffer::JOINED.iter().map(|b| self.bytes(*b)).sum();
        }
        if Buffer::TABLES.contains(&buffer) { (self.entries(buffer).max(1) * buffer.entry().size) as u64 } else { 0 }
    }

    /// Sizes that hold both candidates.
    pub fn max(self, other: Sizes) -> Sizes {
        Sizes {
            tables: TableCounts(std::array::from_fn(|i| self.tables.0[i].max(other.tables.0[i]))),
            front: self.front.max(other.front),
            rest: self.rest.max(other.rest),
            ..self.with_lengths(|own, other| own.max(other), &other)
        }
    }

    /// Sizes enlarged by a factor, except those that determine the workgroup memory.
    pub fn enlarged(self, factor: f64) -> Sizes {
        let larger = |n: usize| (n as f64 * factor).ceil() as usize;
        Sizes { tables: TableCounts(self.tables.0.map(larger)), ..self.with_lengths(|own, _| larger(own), &self) }
    }

    /// Combines the lengths of arrays of two sizes.
    fn with_lengths(self, of: impl Fn(usize, usize) -> usize, other: &Sizes) -> Sizes {
        Sizes {
            all: of(self.all, other.all),
            variables: of(self.variables, other.variables),
            one_sided: of(self.one_sided, other.one_sided),
            costs: of(self.costs, other.costs),
            rows: of(self.rows, other.rows),
            inequalities: of(self.inequalities, other.inequalities),
            jacobian: of(self.jacobian, other.jacobian),
            factor: of(self.factor, other.factor),
            ..self
        }
    }

    /// True if a candidate of other sizes fits into these.
    pub fn hold(&self, other: Sizes) -> bool {
        self.max(other) == *self
    }
}

/// Progress of a candidate before its first round. Its initial values are in the first half and are evaluated as a trial point.
pub fn first_progress(problem: &Problem<f32>, settings: &SolverSettings) -> Progress<f32> {
    Progress { current: 1, ..Limits::new(settings, problem.curves.transcription).first_progress(settings, problem) }
}

// SAFETY: `#[repr(C)]`, all members have four bytes, and every bit pattern is valid.
unsafe impl bytemuck::Zeroable for Progress<f32> {}
// SAFETY: `#[repr(C)]`, all members have four bytes, and every bit pattern is valid.
unsafe impl bytemuck::AnyBitPattern for Progress<f32> {}
