//! Shaders: their texts, the stage that each belongs to, and the buffers that they bind.
//!
//! A shader is in `shaders/<path>.wgsl`, its twin in `src/<path>.rs`. The comment at its beginning states what its text needs:
//!
//! ```text
//! // needs: shared/values shared/jacobian        shared files
//! // binds: jacobian footholds cones heights     buffers, in the order of their bindings, after those of every shader
//! //   in   values    x of the trial point       buffer that it reads
//! //   out  jacobian  2 rows at each place       buffer that it writes; all others are bound read-only
//! ```
//!
//! ```text
//! // binds: jacobian tables                   `tables` holds the tables of `Buffer::JOINED` as words
//! // reads: elements base_blocks              tables in it that have generated functions: `elements_at(slot, i)` reads
//! //                                          an entry, `base_blocks_front(slot, i, k)` an element of an array in an entry
//! ```
//!
//! `shaders/generated.wgsl` shows these functions.
//!
//! Every shader binds `batch`, `running`, `slots`, `progress` and `values` ([`COMMON`]). Its text is preceded by the types of buffers,
//! their structs and the constants that it shares with Rust ([`prelude`]).
//!
//! A shader of rows has no entry point: the one of `shared/entries` calls its function `entry` for each entry of its table
//! ([`Shader::walks`]). The exception is `rows/momentum`, which has its own entry point because several threads share an entry.
//!
//! # What drivers may round
//! Vulkan requires sums and products to be correctly rounded (a product and a sum may be fused), a quotient to be within 2.5 units in the
//! last place, `1 / sqrt` within 2, and `sqrt` within what follows from both. `round`, `floor`, `min` and `max` are exact. Numbers below
//! 2^-126 may become 0, and a compiler may assume that there are no NaNs and infinities. The allowed error of 2^-11 of sine and cosine is
//! too large for a solver in `f32`: `shared/math` has its own functions. `log`, which occurs in the merit and in the stall rule, must be
//! within 3 units, but only within 2^-21 absolute between 0.5 and 2, where the ratios of slacks that hardly change are. Times the barrier
//! parameter this is 2.4e-8 per row at its default. Tested adapters are within 1.9e-7, which is 1e-8 per row.

use crate::backend::tables::{Batch, Buffer, FRONT_COLUMN_BITS, Part, TILE, front_values, kind};
use crate::gait::cost::LEAST_LEG;
use crate::robot::GRAVITY;
use crate::rows::factored::{OWN_BLOCKS, POSE, POSE_BLOCKS};
use crate::rows::momentum::{INNER_POINTS, MOMENTUM_POINTS, STEEP_COSINE};
use crate::rows::swing::{RING_POINTS, RINGS};
use crate::rows::table::{NONE, Wgsl};
use crate::rows::{Family, RowKind, acceleration, force, leg_joints, reach, row_shaders, turn};
use crate::solver::control;
use crate::solver::round::Stage;
use crate::solver::slacks::{BARRIER_FLOOR, FRACTION_TO_THE_BOUNDARY, MULTIPLIER_FLOOR, SLACK_FLOOR};
use crate::solver::start::SCALING_FLOOR;
use crate::solver::weights::{CLOSING_REACH, LARGEST_CLOSING_REACH, REACH_DOUBLINGS};
use crate::terrain::profile::DIMENSIONS;

/// Invocations per workgroup, in every shader, if an adapter allows as many. Workgroup memory limits the number of workgroups on a GPU,
/// so that small ones leave it idle: with 128 and 256 an H200 solves 3,327 and 3,781 candidates/s of `s1` in batches of 16,384.
pub const WORKGROUP: u32 = 256;
/// Invocations per workgroup on software adapters: as many as their vectors have lanes, so that no work for a candidate is repeated.
pub const SOFTWARE_WORKGROUP: u32 = 8;

macro_rules! text {
    ($path:literal) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/", $path, ".wgsl"))
    };
}

macro_rules! all_shaders {
    ($($row:ident $row_path:literal $table:ident,)*) => {
        shaders! {
            rows { $($row $row_path $table,)* }
            solver {
                Start "solver/start",
                Weights "solver/weights",
                Front "linear/front",
                Substitute "linear/substitute",
                Product "linear/product",
                Correct "solver/correct",
                Transposed "linear/transposed",
                Forward "linear/forward",
                Advance "solver/advance",
                Judge "solver/judge",
            }
        }
    };
}

macro_rules! shaders {
    (rows { $($row:ident $row_path:literal $table:ident,)* } solver { $($shader:ident $path:literal,)* }) => {
        /// Shader.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[allow(missing_docs, reason = "named as their files")]
        pub enum Shader {
            $($row,)*
            $($shader,)*
        }

        impl Shader {
            /// All shaders, in the order of their numbers.
            pub const ALL: &[Shader] = &[$(Shader::$row,)* $(Shader::$shader,)*];
            /// Shaders that evaluate the rows at the trial point, in their order.
            pub const ROWS: &[Shader] = &[$(Shader::$row,)*];

            /// Path of shader and twin, without suffix.
            pub fn path(self) -> &'static str {
                match self {
                    $(Shader::$row => $row_path,)*
                    $(Shader::$shader => $path,)*
                }
            }

            /// Text of the shader's own file.
            pub fn source(self) -> &'static str {
                match self {
                    $(Shader::$row => text!($row_path),)*
                    $(Shader::$shader => text!($path),)*
                }
            }

            /// Name of the table whose entries the shader visits; `None` if it does not evaluate rows.
            pub fn walks(self) -> Option<&'static str> {
                match self {
                    $(Shader::$row => Some(stringify!($table)),)*
                    _ => None,
                }
            }
        }
    };
}
row_shaders!(all_shaders);

/// Shared files by name.
pub const SHARED: &[(&str, &str)] = &[
    ("shared/entries", text!("shared/entries")),
    ("shared/values", text!("shared/values")),
    ("shared/kind", text!("shared/kind")),
    ("shared/foot", text!("shared/foot")),
    ("shared/hip", text!("shared/hip")),
    ("shared/leg_joints", text!("shared/leg_joints")),
    ("shared/jacobian", text!("shared/jacobian")),
    ("shared/factored", text!("shared/factored")),
    ("shared/all_elements", text!("shared/all_elements")),
    ("shared/factored_place", text!("shared/factored_place")),
    ("shared/factored_product", text!("shared/factored_product")),
    ("shared/gather", text!("shared/gather")),
    ("shared/math", text!("shared/math")),
    ("shared/terrain", text!("shared/terrain")),
    ("shared/contact", text!("shared/contact")),
    ("shared/round", text!("shared/round")),
    ("shared/reduce", text!("shared/reduce")),
    ("shared/slacks", text!("shared/slacks")),
    ("shared/start_slacks", text!("shared/start_slacks")),
    ("shared/shifts", text!("shared/shifts")),
    ("shared/objective", text!("shared/objective")),
    ("shared/control", text!("shared/control")),
    ("shared/triangle", text!("shared/triangle")),
    ("shared/pivots", text!("shared/pivots")),
    ("shared/front_workgroup", text!("shared/front_workgroup")),
    ("shared/front_storage", text!("shared/front_storage")),
];

/// Binding of a shader.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Binding {
    /// Sizes of the batch, a uniform.
    Batch,
    /// Range of factorisation steps, a uniform.
    Part,
    /// Storage buffer; true if the shader writes it.
    Storage(Buffer, bool),
}

/// Names that every shader binds, in this order, before all others.
pub const COMMON: [&str; 5] = ["batch", "running", "slots", "progress", "values"];

impl Binding {
    /// Binding for a name in a `// binds:` line.
    fn named(name: &str, written: bool) -> Option<Binding> {
        match name {
            "batch" => Some(Binding::Batch),
            "part" => Some(Binding::Part),
            _ => Buffer::ALL.iter().find(|b| b.name() == name).map(|b| Binding::Storage(*b, written)),
        }
    }

    /// Declaration as the binding of a number.
    fn declaration(self, number: u32) -> String {
        let variable = match self {
            Binding::Batch => format!("var<uniform> batch: {}", Batch::name()),
            Binding::Part => format!("var<uniform> part: {}", Part::name()),
            Binding::Storage(buffer, written) => {
                let access = if written { "read_write" } else { "read" };
                format!("var<storage, {access}> {}: array<{}>", buffer.name(), (buffer.entry().name)())
            }
        };
        format!("@group(0) @binding({number}) {variable};\n")
    }
}

/// Names that the header of a text lists after a keyword.
fn stated<'a>(text: &'a str, word: &str) -> impl Iterator<Item = &'a str> {
    let header = text.lines().map_while(|line| line.strip_prefix("//"));
    header.filter_map(move |line| line.trim_start().strip_prefix(word)).flat_map(str::split_whitespace)
}

/// Tables that a text reads from `tables`, or a message about what is wrong with the statement.
pub fn reads(text: &str) -> Result<Vec<Buffer>, String> {
    let bound = stated(text, "binds:").any(|name| name == Buffer::Tables.name());
    let joined = |name: &str| {
        let found = Buffer::JOINED.iter().find(|b| b.name() == name).copied();
        found.filter(|_| bound).ok_or_else(|| format!("it reads {name}, which is not in the tables that it binds"))
    };
    stated(text, "reads:").map(joined).collect()
}

/// Text of everything that is generated for shaders: [`prelude`], and the functions that read each table of [`Buffer::JOINED`].
///
/// A shader gets the functions of those tables that it reads. `shaders/generated.wgsl` is a copy of this text, for readers.
pub fn generated() -> String {
    let readers: String = Buffer::JOINED.iter().map(|table| readers(*table)).collect();
    (prelude() + &readers).trim_end().to_string()
        + "
"
}

/// Functions that read the entries of a table, and the arrays in them, from `tables`.
fn readers(table: Buffer) -> String {
    let (name, entry) = (table.name(), table.entry());
    let words = entry.size / 4;
    let reader = |name: &str, more: &str, of: &str, at: &str, value: &str| {
        let first = format!("batch.first_{table} + (slot * batch.{table} + i) * {words}u", table = table.name());
        format!("fn {name}(slot: u32, i: u32{more}) -> {of} {{\n    let at = {first}{at};\n    return {value};\n}}\n\n")
    };
    let mut text = reader(&format!("{name}_at"), "", &(entry.name)(), "", &(entry.read)(0));
    let mut arrays = Vec::new();
    (entry.arrays)(name, 0, &mut arrays);
    for array in arrays {
        text += &reader(&array.name, ", k: u32", &array.of, &format!(" + {}u * k", array.words), &(array.read)(array.first));
    }
    text
}

/// Bindings of a shader in order, as the header of its text states them, or a message about what is wrong with the header.
pub fn bindings(text: &str) -> Result<Vec<Binding>, String> {
    reads(text)?;
    let header = || text.lines().map_while(|line| line.strip_prefix("//"));
    let names: Vec<&str> = COMMON.into_iter().chain(stated(text, "binds:")).collect();
    if let Some(twice) = (1..names.len()).find(|&i| names[..i].contains(&names[i])) {
        return Err(format!("it binds {} twice", names[twice]));
    }
    let mut written = Vec::new();
    for line in header() {
        let mut words = line.strip_prefix("   ").unwrap_or_default().split_whitespace().peekable();
        let reads = words.next_if_eq(&"in").is_some();
        let writes = words.next_if_eq(&"out").is_some();
        let Some(name) = words.next().filter(|_| reads || writes) else { continue };
        if !names.contains(&name) {
            return Err(format!("it says that {name} goes in or out, but does not bind it"));
        }
        if writes {
            written.push(name);
        }
    }
    let binding = |name: &&str| Binding::named(name, written.contains(name)).ok_or_else(|| format!("it binds {name}, which is no buffer"));
    names.iter().map(binding).collect()
}

impl Shader {
    /// Shaders of a stage, in their order.
    pub fn of(stage: Stage) -> &'static [Shader] {
        match stage {
            Stage::Weights => &[Shader::Weights],
            Stage::Factorise => &[Shader::Front],
            Stage::Substitute => &[Shader::Substitute],
            Stage::Product => &[Shader::Product],
            Stage::Correct => &[Shader::Correct],
            Stage::Transposed => &[Shader::Transposed],
            Stage::Forward => &[Shader::Forward],
            Stage::Advance => &[Shader::Advance],
            Stage::Rows => Shader::ROWS,
            Stage::Judge => &[Shader::Judge],
            Stage::Start => &[Shader::Start],
        }
    }

    /// Table that the shader visits. If it has no entries, the shader has nothing to do.
    pub fn table(self) -> Option<Buffer> {
        Buffer::TABLES.iter().find(|b| Some(b.name()) == self.walks()).copied()
    }

    /// Bindings of the shader, see [`bindings`].
    pub fn bindings(self) -> Result<Vec<Binding>, String> {
        bindings(self.source())
    }

    /// Storage buffers that the shader binds; true for those that it writes.
    pub fn buffers(self) -> impl Iterator<Item = (Buffer, bool)> {
        self.bindings().unwrap_or_default().into_iter().filter_map(|binding| match binding {
            Binding::Storage(buffer, written) => Some((buffer, written)),
            _ => None,
        })
    }

    /// Complete text. It has no bindings if the header is invalid.
    pub fn text(self, variant: &Variant) -> String {
        let Variant { workgroup, front, side, rows } = variant;
        let mut text = prelude();
        text += &format!("const WORKGROUP: u32 = {workgroup}u;\nconst FRONT: u32 = {front}u;\n");
        text += &format!("const SIDE: u32 = {side}u;\nconst PANEL_ROWS: u32 = {rows}u;\n\n");
        for (number, binding) in (0..).zip(self.bindings().unwrap_or_default()) {
            text += &binding.declaration(number);
        }
        for table in reads(self.source()).unwrap_or_default() {
            text += "\n";
            text += &readers(table);
        }
        if let Some(table) = self.walks() {
            text += &format!("\nfn entries(slot: u32) -> u32 {{\n    return slots[slot].{table};\n}}\n");
        }
        text += "\n";
        let mut named = Vec::new();
        needs(self.source(), &mut named);
        if self == Shader::Front {
            named.push(if *front > 0 { "shared/front_workgroup" } else { "shared/front_storage" });
        }
        for name in named {
            text += SHARED.iter().find(|(shared, _)| *shared == name).map_or("", |(_, text)| text);
        }
        text + self.source()
    }
}

/// Collects the shared files that a text needs, each once and after those that it needs itself. Lines `// needs: a b` state them.
fn needs<'a>(text: &'a str, into: &mut Vec<&'a str>) {
    for name in text.lines().filter_map(|line| line.strip_prefix("// needs:")).flat_map(str::split_whitespace) {
        if !into.contains(&name) {
            if let Some((_, shared)) = SHARED.iter().find(|(shared, _)| *shared == name) {
                needs(shared, into);
            }
            into.push(name);
        }
    }
}

/// Values with their names in shaders.
type Named<T> = Vec<(&'static str, T)>;

/// Constants that shaders and twins share: names and values, in `u32` and in `f32`.
pub fn constants() -> (Named<u32>, Named<f32>) {
    let whole = vec![
        ("NONE", NONE),
        ("INNER_POINTS", INNER_POINTS as u32),
        ("MOMENTUM_POINTS", MOMENTUM_POINTS as u32),
        ("POSE", POSE as u32),
        ("POSE_BLOCKS", POSE_BLOCKS as u32),
        ("OWN_BLOCKS", OWN_BLOCKS as u32),
        ("FACTORED_ROWS", reach::SPEC.rows as u32),
        ("FACTORED_PAIRS", reach::SPEC.pairs as u32),
        ("FORCE_ROWS", force::SPEC.rows as u32),
        ("RING_POINTS", RING_POINTS as u32),
        ("TURN_YAW", turn::YAW as u32),
        ("FLAT", kind::FLAT),
        ("BLOCK", kind::BLOCK),
        ("STAIRS", kind::STAIRS),
        ("GAP", kind::GAP),
        ("SLOPE", kind::SLOPE),
        ("CHIMNEY", kind::CHIMNEY),
        ("CHIMNEY_LR", kind::CHIMNEY_LR),
        ("GRID", kind::GRID),
        ("STEP", control::STEP),
        ("CLOSE", control::CLOSE),
        ("EXACT", control::EXACT),
        ("SHORTER", control::SHORTER),
        ("ENDED", control::ENDED),
        ("SOLVED", control::SOLVED),
        ("MAX_ITERATIONS", control::MAX_ITERATIONS),
        ("STALLED", control::STALLED),
        ("TERMINATED_EARLY", control::TERMINATED_EARLY),
        ("STEPS_REFUSED", control::STEPS_REFUSED),
        ("NON_FINITE", control::NON_FINITE),
        ("SOLVE", control::SOLVE),
        ("MINIMISE", control::MINIMISE),
        ("RESTORE_NEXT", control::RESTORE_NEXT),
        ("RESTORE", control::RESTORE),
        ("REVERT", control::REVERT),
        ("SHORTENINGS", control::SHORTENINGS),
        ("REACH_DOUBLINGS", REACH_DOUBLINGS),
        ("ATTEMPTS", control::ATTEMPTS),
        ("EARLY_TERMINATION_FROM", control::EARLY_TERMINATION_FROM),
        ("EARLY_TERMINATION_TO", control::EARLY_TERMINATION_TO),
        ("EARLY_TERMINATION_KNEE", control::EARLY_TERMINATION_KNEES[0]),
        ("EARLY_TERMINATION_LATE_KNEE", control::EARLY_TERMINATION_KNEES[1]),
        ("FRONT_COLUMN_BITS", FRONT_COLUMN_BITS),
        ("FACTORED", Family::Reach as u32),
        ("EQUALITY", RowKind::Equality as u32),
        ("COST", RowKind::Cost as u32),
        ("INEQUALITY", RowKind::Inequality as u32),
    ];
    let [[inner_ring, inner_lift], [outer_ring, outer_lift]] = RINGS;
    let mut real = vec![
        ("ACCELERATION_MARGIN", acceleration::MARGIN as f32),
        ("GRAVITY", GRAVITY as f32),
        ("STEEP_COSINE", STEEP_COSINE as f32),
        ("TURN_MARGIN", turn::MARGIN as f32),
        ("LEAST_LEG", LEAST_LEG as f32),
        ("FREE_SHARE", leg_joints::FREE_SHARE as f32),
        ("LEAST_BEND", leg_joints::LEAST_BEND as f32),
        ("INNER_RING", inner_ring as f32),
        ("INNER_LIFT", inner_lift as f32),
        ("OUTER_RING", outer_ring as f32),
        ("OUTER_LIFT", outer_lift as f32),
        ("CLOSING_RATE", control::CLOSING_RATE as f32),
        ("CLOSING_AGAIN", control::CLOSING_AGAIN as f32),
        ("NEAR_LINEAR", control::NEAR_LINEAR as f32),
        ("NEAR_LINEAR_FLOOR", control::NEAR_LINEAR_FLOOR as f32),
        ("GOOD_RATIO", control::GOOD_RATIO as f32),
        ("POOR_RATIO", control::POOR_RATIO as f32),
        ("MINIMISE_POOR_RATIO", control::MINIMISE_POOR_RATIO as f32),
        ("MINIMISE_POOR_FACTOR", control::MINIMISE_POOR_FACTOR as f32),
        ("BARRIER_PER_FALL", control::BARRIER_PER_FALL as f32),
        ("LARGEST_BARRIER_FLOOR", control::LARGEST_BARRIER_FLOOR as f32),
        ("GOOD_DIVISOR", control::GOOD_DIVISOR as f32),
        ("POOR_FACTOR", control::POOR_FACTOR as f32),
        ("SHORTENING", control::SHORTENING as f32),
        ("STALL_TARGET", control::STALL_TARGET as f32),
        ("STALL_ABOVE", control::STALL_ABOVE as f32),
        ("TRUSTED_LENGTH", control::TRUSTED_LENGTH as f32),
        ("PROXIMAL_GROWTH", control::PROXIMAL_GROWTH as f32),
        ("CLOSING_GROWTH", control::CLOSING_GROWTH as f32),
        ("BARRIER_FLOOR", BARRIER_FLOOR as f32),
        ("SLACK_FLOOR", SLACK_FLOOR as f32),
        ("CLOSING_REACH", CLOSING_REACH as f32),
        ("LARGEST_CLOSING_REACH", LARGEST_CLOSING_REACH as f32),
        ("FRACTION_TO_THE_BOUNDARY", FRACTION_TO_THE_BOUNDARY as f32),
        ("MULTIPLIER_FLOOR", MULTIPLIER_FLOOR as f32),
        ("SCALING_FLOOR", SCALING_FLOOR as f32),
    ];
    real.extend(DIMENSIONS.iter().map(|&(name, value)| (name, value as f32)));
    (whole, real)
}

/// Text in front of every shader: [`constants`] and the structs of all buffers.
pub fn prelude() -> String {
    let (whole, real) = constants();
    let mut text = String::new();
    for (name, value) in whole {
        text += &format!("const {name}: u32 = {value}u;\n");
    }
    for (name, value) in real {
        text += &format!("const {name}: f32 = {value:?}f;\n");
    }
    let mut structs = Vec::new();
    Batch::declare(&mut structs);
    Part::declare(&mut structs);
    for buffer in Buffer::ALL {
        (buffer.entry().declare)(&mut structs);
    }
    structs.into_iter().fold(text + "\n", |text, (_, declaration)| text + &declaration + "\n")
}

/// Numbers of rows that `linear/front` may add to a front together, the best first: many save passes over the front, few leave workgroup
/// memory to it. As many as an elimination step has pivots are needed.
pub const PANEL_ROWS: [u32; 3] = [16, 8, LEAST_PANEL_ROWS];
/// Smallest of these numbers.
pub(super) const LEAST_PANEL_ROWS: u32 = TILE as u32;

/// Parameters of the shader texts: size and location of the front, and sizes of the workgroup memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Variant {
    /// Invocations of a workgroup.
    pub workgroup: u32,
    /// Values of the front in workgroup memory, in whole tiles; 0 if the front is in storage.
    pub front: u32,
    /// Length of a row of the front with its right-hand side, rounded up.
    pub side: u32,
    /// Rows that are added to the front together.
    pub rows: u32,
}

impl Variant {
    /// Variant for fronts of a size, within a limit of workgroup memory, bytes.
    ///
    /// The workgroup memory holds the front and as many rows as the limit allows: the portable 16 KiB, or the required multiple of 8 KiB. If
    /// the front does not fit with the fewest rows, it is in storage.
    pub fn new(front: usize, workgroup: u32, limit: u32) -> Variant {
        let side = (front as u32 + 1).next_multiple_of(16);
        let values = front_values(front) as u32;
        let of_rows = PANEL_ROWS.map(|rows| Variant { workgroup, front: 0, side, rows });
        for without in of_rows {
            let others = without.workgroup_memory();
            if others + 4 * values <= limit {
                let memory = (others + 4 * values).next_multiple_of(8 << 10).max(16 << 10).min(limit);
                let tile = (TILE * TILE) as u32;
                return Variant { front: (memory - others) / (4 * tile) * tile, ..without };
            }
        }
        let [.., least] = of_rows;
        of_rows.into_iter().find(|without| without.workgroup_memory() <= limit).unwrap_or(least)
    }

    /// Workgroup memory of a factorisation, bytes: the front, and `panel`, `before` and `touched` of linear/front.wgsl.
    pub fn workgroup_memory(&self) -> u32 {
        4 * (self.front + self.rows * self.side + self.side + self.side / 4)
    }
}
