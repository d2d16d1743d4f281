//! The shaders: their texts, which stage each belongs to, and the buffers that they bind.
//!
//! A shader stands in `shaders/<path>.wgsl`, its twin in `src/<path>.rs`. The comment that it begins with says what is put in front of it:
//!
//! ```text
//! // needs: shared/values shared/jacobian        shared files
//! // binds: jacobian footholds cones heights     buffers, in the order of their bindings, behind those of every shader
//! //   in   values    x of the trial point       what it reads
//! //   out  jacobian  2 rows at each place       what it writes: bound to be written, all others to be read alone
//! ```
//!
//! ```text
//! // binds: jacobian tables                   `tables` are those of `Buffer::JOINED`, as words
//! // reads: elements reach_feet               whose entries `elements_at(slot, i)`, and what arrays in them hold
//! //                                          `reach_legs_front(slot, i, k)` reads: functions written in front of the text
//! ```
//!
//! Every shader binds `batch`, `running`, `slots`, `progress` and `values` ([`COMMON`]). Types of buffers, their structs and the constants that
//! it has in common with Rust are written in front of it, too ([`prelude`]).
//!
//! A shader of rows has no entry point of its own: that of `shared/entries` calls its function `entry` for each entry of the table that it
//! walks ([`Shader::walks`]). `rows/momentum` alone walks its table itself, for several threads have an entry there.
//!
//! # What drivers may round
//! Vulkan asks of sums and products, each alone or a product and a sum in one, that they are rounded, of a quotient 2.5 units in the last place, of
//! `1 / sqrt` 2 and of `sqrt` what follows from both; `round`, `floor`, `min` and `max` are exact. Numbers below 2^-126 may become 0, and NaNs and
//! infinities may be taken for numbers. The 2^-11 of sine and cosine are too little for a solver in `f32`: `shared/math` has its own. Of `log`, in the
//! merit and in the stall rule, it asks 3 units, but 2^-21 absolute between 0.5 and 2, where slacks that hardly change have their ratios: times
//! the barrier parameter, 2.4e-8 a row at its default. Adapters tested are within 1.9e-7, that is 1e-8 a row.

use super::tables::{Batch, Buffer, Part, kind};
use crate::robot::GRAVITY;
use crate::rows::momentum::{INNER_POINTS, MOMENTUM_POINTS};
use crate::rows::table::{NONE, Wgsl};
use crate::rows::{Family, RowKind, acceleration, row_shaders};
use crate::solver::control;
use crate::solver::round::Stage;
use crate::solver::slacks::{BARRIER_FLOOR, MULTIPLIER_FLOOR, SLACK_FLOOR, TO_THE_BOUNDARY};

/// Invocations of a workgroup, in every shader.
pub const WORKGROUP: u32 = 64;
/// The same on software adapters: as many as their vectors have lanes, so that nothing is done twice for one candidate.
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
        /// A shader.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[allow(missing_docs, reason = "named as their files")]
        pub enum Shader {
            $($row,)*
            $($shader,)*
        }

        impl Shader {
            /// All of them, in the order of their numbers.
            pub const ALL: &[Shader] = &[$(Shader::$row,)* $(Shader::$shader,)*];
            /// Those that evaluate the rows at the trial point, in their order.
            pub const ROWS: &[Shader] = &[$(Shader::$row,)*];

            /// File of shader and twin, without ending.
            pub fn path(self) -> &'static str {
                match self {
                    $(Shader::$row => $row_path,)*
                    $(Shader::$shader => $path,)*
                }
            }

            /// Its own text.
            pub fn source(self) -> &'static str {
                match self {
                    $(Shader::$row => text!($row_path),)*
                    $(Shader::$shader => text!($path),)*
                }
            }

            /// Name of the table whose entries it walks, of those that evaluate rows.
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

/// Files that shaders share, by their names.
pub const SHARED: &[(&str, &str)] = &[
    ("shared/entries", text!("shared/entries")),
    ("shared/values", text!("shared/values")),
    ("shared/kind", text!("shared/kind")),
    ("shared/jacobian", text!("shared/jacobian")),
    ("shared/reach", text!("shared/reach")),
    ("shared/gather", text!("shared/gather")),
    ("shared/math", text!("shared/math")),
    ("shared/terrain", text!("shared/terrain")),
    ("shared/contact", text!("shared/contact")),
    ("shared/round", text!("shared/round")),
    ("shared/reduce", text!("shared/reduce")),
    ("shared/slacks", text!("shared/slacks")),
    ("shared/control", text!("shared/control")),
    ("shared/triangle", text!("shared/triangle")),
    ("shared/pivots", text!("shared/pivots")),
    ("shared/front_workgroup", text!("shared/front_workgroup")),
    ("shared/front_storage", text!("shared/front_storage")),
];

/// What a shader binds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Binding {
    /// Sizes of the batch, a uniform.
    Batch,
    /// Which steps of the factorisation to take, a uniform.
    Part,
    /// A buffer, and whether it is written.
    Storage(Buffer, bool),
}

/// What every shader binds, in this order, before all else.
pub const COMMON: [&str; 5] = ["batch", "running", "slots", "progress", "values"];

impl Binding {
    /// What stands for a name in the lines `// binds:`.
    fn named(name: &str, written: bool) -> Option<Binding> {
        match name {
            "batch" => Some(Binding::Batch),
            "part" => Some(Binding::Part),
            _ => Buffer::ALL.iter().find(|b| b.name() == name).map(|b| Binding::Storage(*b, written)),
        }
    }

    /// Its declaration as the binding of a number.
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

/// What the lines of the comment that a text begins with name behind a word.
fn stated<'a>(text: &'a str, word: &str) -> impl Iterator<Item = &'a str> {
    let header = text.lines().map_while(|line| line.strip_prefix("//"));
    header.filter_map(move |line| line.trim_start().strip_prefix(word)).flat_map(str::split_whitespace)
}

/// The tables that a text reads out of `tables`; what is wrong with its words otherwise.
pub fn reads(text: &str) -> Result<Vec<Buffer>, String> {
    let bound = stated(text, "binds:").any(|name| name == Buffer::Tables.name());
    let joined = |name: &str| {
        let found = Buffer::JOINED.iter().find(|b| b.name() == name).copied();
        found.filter(|_| bound).ok_or_else(|| format!("it reads {name}, which is not in the tables that it binds"))
    };
    stated(text, "reads:").map(joined).collect()
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

/// The bindings of a shader in their order, as the comment that its text begins with states them; what is wrong with it otherwise.
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

    /// The table that it walks; without entries there it has nothing to do.
    pub fn table(self) -> Option<Buffer> {
        Buffer::TABLES.iter().find(|b| Some(b.name()) == self.walks()).copied()
    }

    /// Its bindings, see [`bindings`].
    pub fn bindings(self) -> Result<Vec<Binding>, String> {
        bindings(self.source())
    }

    /// Buffers that it binds, and whether they are written.
    pub fn buffers(self) -> impl Iterator<Item = (Buffer, bool)> {
        self.bindings().unwrap_or_default().into_iter().filter_map(|binding| match binding {
            Binding::Storage(buffer, written) => Some((buffer, written)),
            _ => None,
        })
    }

    /// Whole text; without bindings where they cannot be made out.
    pub fn text(self, variant: &Variant) -> String {
        let Variant { workgroup, front, side, columns } = variant;
        let mut text = prelude();
        text += &format!("const WORKGROUP: u32 = {workgroup}u;\nconst FRONT: u32 = {front}u;\n");
        text += &format!("const SIDE: u32 = {side}u;\nconst COLUMNS: u32 = {columns}u;\n\n");
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

/// Shared files that a text needs, each once and behind those that it needs itself: lines `// needs: a b` say so.
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

/// Constants that shaders and twins have in common: name and value, in `u32` and in `f32`.
pub fn constants() -> (Named<u32>, Named<f32>) {
    let whole = vec![
        ("NONE", NONE),
        ("INNER_POINTS", INNER_POINTS as u32),
        ("MOMENTUM_POINTS", MOMENTUM_POINTS as u32),
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
        ("NON_FINITE", control::NON_FINITE),
        ("SHORTENINGS", control::SHORTENINGS),
        ("ATTEMPTS", control::ATTEMPTS),
        ("HOPELESS_FROM", control::HOPELESS_FROM),
        ("HOPELESS_TO", control::HOPELESS_TO),
        ("HOPELESS_KNEE", control::HOPELESS_KNEES[0]),
        ("HOPELESS_LATE_KNEE", control::HOPELESS_KNEES[1]),
        ("LINEAR_MOMENTUM", Family::LinearMomentum as u32),
        ("REACH", Family::Reach as u32),
        ("EQUALITY", RowKind::Equality as u32),
        ("COST", RowKind::Cost as u32),
        ("INEQUALITY", RowKind::Inequality as u32),
    ];
    let real = vec![
        ("ACCELERATION_MARGIN", acceleration::MARGIN as f32),
        ("GRAVITY", GRAVITY as f32),
        ("CLOSING_RATE", control::CLOSING_RATE as f32),
        ("SHORTENING", control::SHORTENING as f32),
        ("STALL_TARGET", control::STALL_TARGET as f32),
        ("STALL_ABOVE", control::STALL_ABOVE as f32),
        ("PROXIMAL_GROWTH", control::PROXIMAL_GROWTH as f32),
        ("BARRIER_FLOOR", BARRIER_FLOOR as f32),
        ("SLACK_FLOOR", SLACK_FLOOR as f32),
        ("TO_THE_BOUNDARY", TO_THE_BOUNDARY as f32),
        ("MULTIPLIER_FLOOR", MULTIPLIER_FLOOR as f32),
    ];
    (whole, real)
}

/// What stands in front of every shader: [`constants`] and the structs of all buffers.
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

/// What the text of shaders depends on: how large the front is, and where it is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Variant {
    /// Invocations of a workgroup.
    pub workgroup: u32,
    /// Values of the front in workgroup memory; 0: it is kept in storage.
    pub front: u32,
    /// Largest size of a front with its right-hand side.
    pub side: u32,
    /// Most columns of an element.
    pub columns: u32,
}

impl Variant {
    /// The variant for fronts of a size and elements of a number of columns, within a limit of workgroup memory, bytes.
    ///
    /// The front has the portable 16 KiB where that is enough, else as many times 8 KiB as it needs, else storage.
    pub fn new(front: usize, columns: usize, workgroup: u32, limit: u32) -> Variant {
        let side = (front as u32 + 1).next_multiple_of(16);
        let columns = (columns as u32).max(1).next_multiple_of(16);
        let without = Variant { workgroup, front: 0, side, columns };
        let others = without.workgroup_memory();
        let needed = 4 * (front * (front + 3) / 2) as u32 + others;
        let memory = needed.next_multiple_of(8 << 10).max(16 << 10).min(limit);
        Variant { front: if needed <= memory { (memory - others) / 4 } else { 0 }, ..without }
    }

    /// Workgroup memory that a factorisation takes, bytes: the front, and `panel`, `columns` and `by_pose` of front.wgsl, in the multiples of 16
    /// that adapters count.
    pub fn workgroup_memory(&self) -> u32 {
        4 * (self.front + 4 * self.side + 2 * self.columns + 44)
    }
}
