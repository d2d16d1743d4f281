//! The table of shaders: their text, and the buffers that they bind.
//!
//! A shader stands in `shaders/<name>.wgsl`, its twin in `src/kernels/<name>.rs`. `tests/shader_layout.rs` holds text and table together.

/// Invocations of a workgroup, in every shader.
pub const WORKGROUP: u32 = 64;
/// The same on software adapters: as many as their vectors have lanes, so that nothing is done twice for one candidate.
pub const SOFTWARE_WORKGROUP: u32 = 8;

/// Buffers that shaders bind, by their names there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[allow(missing_docs, reason = "named as in the shaders")]
pub enum Buffer {
    Running,
    Slots,
    Progress,
    Values,
    Jacobian,
    Factor,
    Footholds,
    DynamicsInstants,
    StanceForces,
    MomentumIntervals,
    Impulses,
    ReachInstants,
    ReachFeet,
    ForceNodes,
    SwingNodes,
    Strides,
    Elements,
    Runs,
    FrontSteps,
    Rests,
    Gathers,
    Touches,
    Heights,
}

impl Buffer {
    /// All of them, in the order of their numbers.
    pub const ALL: [Buffer; 23] = [
        Buffer::Running,
        Buffer::Slots,
        Buffer::Progress,
        Buffer::Values,
        Buffer::Jacobian,
        Buffer::Factor,
        Buffer::Footholds,
        Buffer::DynamicsInstants,
        Buffer::StanceForces,
        Buffer::MomentumIntervals,
        Buffer::Impulses,
        Buffer::ReachInstants,
        Buffer::ReachFeet,
        Buffer::ForceNodes,
        Buffer::SwingNodes,
        Buffer::Strides,
        Buffer::Elements,
        Buffer::Runs,
        Buffer::FrontSteps,
        Buffer::Rests,
        Buffer::Gathers,
        Buffer::Touches,
        Buffer::Heights,
    ];

    /// Name in the shaders.
    pub fn name(self) -> &'static str {
        match self {
            Buffer::Running => "running",
            Buffer::Slots => "slots",
            Buffer::Progress => "progress",
            Buffer::Values => "values",
            Buffer::Jacobian => "jacobian",
            Buffer::Factor => "factor",
            Buffer::Footholds => "footholds",
            Buffer::DynamicsInstants => "dynamics_instants",
            Buffer::StanceForces => "stance_forces",
            Buffer::MomentumIntervals => "momentum_intervals",
            Buffer::Impulses => "impulses",
            Buffer::ReachInstants => "reach_instants",
            Buffer::ReachFeet => "reach_feet",
            Buffer::ForceNodes => "force_nodes",
            Buffer::SwingNodes => "swing_nodes",
            Buffer::Strides => "strides",
            Buffer::Elements => "elements",
            Buffer::Runs => "runs",
            Buffer::FrontSteps => "front_steps",
            Buffer::Rests => "rests",
            Buffer::Gathers => "gathers",
            Buffer::Touches => "touches",
            Buffer::Heights => "heights",
        }
    }
}

/// A shader.
#[derive(Debug, Clone, Copy)]
pub struct Shader {
    /// File stem of shader and twin.
    pub name: &'static str,
    /// Text of its file and of the shared files that it needs.
    pub parts: &'static [&'static str],
    /// Storage buffers of the bindings from 1 on (0 is the uniform `batch`), and whether they are written.
    pub buffers: &'static [(Buffer, bool)],
    /// Whether it has one more uniform, `sweep`: the steps of the factorisation to take.
    pub sweep: bool,
}

macro_rules! shader {
    ($name:literal, [$($shared:literal),*], [$($buffer:ident $($write:literal)?),*] $(, $sweep:ident)?) => {
        Shader {
            name: $name,
            parts: &[
                $(include_str!(concat!("../../shaders/shared/", $shared, ".wgsl")),)*
                include_str!(concat!("../../shaders/", $name, ".wgsl")),
            ],
            buffers: &[$((Buffer::$buffer, shader!(@write $($write)?))),*],
            sweep: shader!(@sweep $($sweep)?),
        }
    };
    (@write) => { false };
    (@write $write:literal) => { true };
    (@sweep) => { false };
    (@sweep sweep) => { true };
}

/// Shaders in the order in which a round uses them first.
pub const SHADERS: [Shader; 16] = [
    shader!("foothold", ["batch", "values", "terrain"], [Running, Slots, Progress, Values "rw", Footholds, Heights]),
    shader!("dynamics", ["batch", "tables", "values", "jacobian", "math"],
        [Running, Slots, Progress, Values "rw", Jacobian "rw", Footholds, DynamicsInstants, StanceForces]),
    shader!("momentum", ["batch", "tables", "values", "jacobian", "math"],
        [Running, Slots, Progress, Values "rw", Jacobian "rw", Footholds, MomentumIntervals, Impulses]),
    shader!("reach", ["batch", "tables", "values", "jacobian", "math"],
        [Running, Slots, Progress, Values "rw", Jacobian "rw", Footholds, ReachInstants, ReachFeet]),
    shader!("force", ["batch", "tables", "values", "jacobian", "math", "terrain"],
        [Running, Slots, Progress, Values "rw", Jacobian "rw", Footholds, ForceNodes, Heights]),
    shader!("swing", ["batch", "tables", "values", "jacobian", "terrain"],
        [Running, Slots, Progress, Values "rw", Jacobian "rw", Footholds, SwingNodes, Strides, Heights]),
    shader!("start", ["batch", "tables"], [Running, Slots, Progress "rw", Values "rw", Jacobian, Elements, Gathers, Touches]),
    shader!("rows", ["batch", "tables", "reduce", "slacks", "control"], [Running, Slots, Progress "rw", Values "rw", Elements]),
    shader!("front", ["batch", "tables", "triangle"],
        [Running, Slots, Progress, Values "rw", Jacobian, Factor "rw", Elements, Runs, FrontSteps, Rests, ReachInstants, ReachFeet], sweep),
    shader!("substitute", ["batch", "tables", "pivots"], [Running, Slots, Progress, Values "rw", Factor, FrontSteps, Rests]),
    shader!("product", ["batch", "tables"], [Running, Slots, Progress, Values "rw", Jacobian, Elements, Runs]),
    shader!("correct", ["batch", "tables", "reduce", "slacks"], [Running, Slots, Progress "rw", Values "rw", Elements]),
    shader!("transposed", ["batch", "tables"], [Running, Slots, Progress, Values "rw", Jacobian, Elements, Gathers, Touches]),
    shader!("forward", ["batch", "tables", "pivots"], [Running, Slots, Progress, Values "rw", Factor "rw", FrontSteps, Rests]),
    shader!("advance", ["batch", "tables", "reduce", "slacks"], [Running, Slots, Progress "rw", Values "rw"]),
    shader!("judge", ["batch", "reduce", "control"], [Running, Slots, Progress "rw", Values "rw"]),
];

/// Shader of a name in [`SHADERS`].
pub fn shader(name: &str) -> Option<&'static Shader> {
    SHADERS.iter().find(|s| s.name == name)
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
        // `panel`, `columns` and `by_pose` of front.wgsl, in the multiples of 16 bytes that adapters count.
        let others = 4 * (4 * side + 2 * columns + 44);
        let needed = 4 * (front * (front + 3) / 2) as u32 + others;
        let memory = needed.next_multiple_of(8 << 10).max(16 << 10).min(limit);
        let front = if needed <= memory { (memory - others) / 4 } else { 0 };
        Variant { workgroup, front, side, columns }
    }
}

impl Shader {
    /// Whole text.
    pub fn text(&self, variant: &Variant) -> String {
        let Variant { workgroup, front, side, columns } = variant;
        let mut text = self.parts.concat();
        text += &format!("\nconst WORKGROUP: u32 = {workgroup}u;");
        text += &format!("\nconst FRONT: u32 = {front}u;\nconst SIDE: u32 = {side}u;\nconst COLUMNS: u32 = {columns}u;\n");
        if self.sweep {
            text += if *front > 0 {
                include_str!("../../shaders/shared/front_workgroup.wgsl")
            } else {
                include_str!("../../shaders/shared/front_storage.wgsl")
            };
        }
        text
    }
}
