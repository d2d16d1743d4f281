//! Shaders, their table and their Rust twins agree, without a GPU: texts are parsed and validated, structs, bindings, constants and names
//! compared. And the tables that only shaders read say the same as those of the twins.

mod common;

use common::{Random, gait, hills, layout_with, spider, task, task_for, transcriptions};
use cregopt::backend::gpu::shaders::{Buffer, SHADERS, SOFTWARE_WORKGROUP, Shader, Variant, WORKGROUP, shader};
use cregopt::backend::gpu::tables::{Batch, FrontStep, Gather, Rest, Shape, Slot, Sweep, Touch};
use cregopt::linear::transposed::transposed_times;
use cregopt::nlp::Layout;
use cregopt::nlp::layout::{
    BasePoint, Constants, DynamicsInstant, Element, Family, ForceNode, INNER_POINTS, Impulse, MOMENTUM_POINTS, MomentumInterval,
    MomentumPoint, NONE, Place, ReachFoot, ReachInstant, StanceForce, Stride, SwingNode,
};
use cregopt::nlp::sweep::{Run, Span};
use cregopt::robot::GRAVITY;
use cregopt::settings::SolverSettings;
use cregopt::solver::control::{self, Limits, Progress};
use cregopt::solver::slacks::{BARRIER_FLOOR, MULTIPLIER_FLOOR, SLACK_FLOOR};
use cregopt::terrain::{Profile, Shape as TerrainShape, Terrain};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{AddressSpace, ArraySize, Expression, Handle, Literal, Module, ScalarKind, StorageAccess, Type, TypeInner};
use std::collections::{BTreeMap, BTreeSet};
use std::mem::offset_of;
use std::path::Path;

/// Storage buffers that a shader may bind: what `front` needs. Adapters with fewer are refused, and those that this crate is meant for have
/// 16 or more.
const MOST_BUFFERS: usize = 12;

/// Workgroup memory that every WebGPU adapter has, bytes.
const PORTABLE_MEMORY: u32 = 16 << 10;

/// Workgroup memory of common adapters, bytes.
const MEMORIES: [u32; 4] = [PORTABLE_MEMORY, 32 << 10, 48 << 10, 64 << 10];

/// A front that no workgroup memory holds.
const LARGE_FRONT: usize = 400;

/// Variants with the front in workgroup memory and in storage.
fn variants() -> [Variant; 2] {
    let variants = [Variant::new(60, 100, WORKGROUP, PORTABLE_MEMORY), Variant::new(LARGE_FRONT, 100, SOFTWARE_WORKGROUP, PORTABLE_MEMORY)];
    assert!(variants[0].front > 0 && variants[1].front == 0);
    variants
}

fn parse(shader: &Shader, variant: &Variant) -> Module {
    let text = shader.text(variant);
    naga::front::wgsl::parse_str(&text).unwrap_or_else(|e| panic!("{}: {}", shader.name, e.emit_to_string(&text)))
}

/// All shaders in both variants.
fn modules() -> Vec<(&'static Shader, Variant, Module)> {
    variants().into_iter().flat_map(|variant| SHADERS.iter().map(move |s| (s, variant, parse(s, &variant)))).collect()
}

/// Text, its place and its shared parts by name: what stands in `folder`.
fn texts(folder: &str) -> BTreeMap<String, String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_file());
    files.map(|path| (path.file_stem().unwrap().to_str().unwrap().into(), std::fs::read_to_string(&path).unwrap())).collect()
}

#[test]
fn every_shader_validates() {
    for (shader, variant, module) in modules() {
        let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
        let text = shader.text(&variant);
        validator.validate(&module).unwrap_or_else(|e| panic!("{}: {}", shader.name, e.emit_to_string(&text)));
    }
}

#[test]
fn every_shader_has_one_entry_point_with_the_workgroup_size_of_the_table() {
    for (shader, variant, module) in modules() {
        let entries: Vec<_> = module.entry_points.iter().map(|e| (e.name.as_str(), e.stage, e.workgroup_size)).collect();
        assert_eq!(entries, [("main", naga::ShaderStage::Compute, [variant.workgroup, 1, 1])], "{}", shader.name);
        assert!(variant.workgroup.is_power_of_two(), "sums halve it");
    }
}

#[test]
fn shaders_bind_what_the_table_says() {
    for (shader, _, module) in modules() {
        let mut bound: Vec<(u32, String)> = Vec::new();
        for (_, variable) in module.global_variables.iter() {
            let Some(binding) = &variable.binding else { continue };
            assert_eq!(binding.group, 0, "{}", shader.name);
            let access = match variable.space {
                AddressSpace::Uniform => "uniform",
                AddressSpace::Storage { access: StorageAccess::LOAD } => "read",
                AddressSpace::Storage { access } if access == StorageAccess::LOAD | StorageAccess::STORE => "read_write",
                other => panic!("{}: {other:?}", shader.name),
            };
            bound.push((binding.binding, format!("{access} {}: {}", variable.name.as_deref().unwrap(), type_name(&module, variable.ty))));
        }
        bound.sort();
        let mut expected = vec!["uniform batch: Batch".to_string()];
        for (buffer, written) in shader.buffers {
            let access = if *written { "read_write" } else { "read" };
            expected.push(format!("{access} {}: [{}]", buffer.name(), entry(*buffer)));
        }
        if shader.sweep {
            expected.push("uniform sweep: Sweep".into());
        }
        let expected: Vec<(u32, String)> = (0..).zip(expected).collect();
        assert_eq!(bound, expected, "{}", shader.name);
        assert!(shader.buffers.len() <= MOST_BUFFERS, "{} binds {} storage buffers", shader.name, shader.buffers.len());
    }
}

/// What a buffer holds.
fn entry(buffer: Buffer) -> &'static str {
    match buffer {
        Buffer::Running | Buffer::Footholds => "u32",
        Buffer::Values | Buffer::Jacobian | Buffer::Factor | Buffer::Heights => "f32",
        Buffer::Slots => "Slot",
        Buffer::Progress => "Progress",
        Buffer::DynamicsInstants => "DynamicsInstant",
        Buffer::StanceForces => "StanceForce",
        Buffer::MomentumIntervals => "MomentumInterval",
        Buffer::Impulses => "Impulse",
        Buffer::ReachInstants => "ReachInstant",
        Buffer::ReachFeet => "ReachFoot",
        Buffer::ForceNodes => "ForceNode",
        Buffer::SwingNodes => "SwingNode",
        Buffer::Strides => "Stride",
        Buffer::Elements => "Element",
        Buffer::Runs => "Run",
        Buffer::FrontSteps => "FrontStep",
        Buffer::Rests => "Rest",
        Buffer::Gathers => "Gather",
        Buffer::Touches => "Touch",
    }
}

#[test]
fn buffers_stand_in_the_order_of_their_numbers() {
    for (i, buffer) in Buffer::ALL.into_iter().enumerate() {
        assert_eq!(buffer as usize, i, "{}", buffer.name());
        assert!(SHADERS.iter().any(|s| s.buffers.iter().any(|b| b.0 == buffer)), "no shader binds {}", buffer.name());
    }
    let names: BTreeSet<&str> = Buffer::ALL.into_iter().map(Buffer::name).collect();
    assert_eq!(names.len(), Buffer::ALL.len());
}

/// A type as Rust would write it, without paths and scalars.
fn type_name(module: &Module, ty: Handle<Type>) -> String {
    match &module.types[ty].inner {
        TypeInner::Scalar(scalar) => match (scalar.kind, scalar.width) {
            (ScalarKind::Float, 4) => "f32".into(),
            (ScalarKind::Uint, 4) => "u32".into(),
            other => format!("{other:?}"),
        },
        TypeInner::Array { base, size: ArraySize::Constant(size), .. } => format!("[{}; {size}]", type_name(module, *base)),
        TypeInner::Array { base, .. } => format!("[{}]", type_name(module, *base)),
        TypeInner::Struct { .. } => module.types[ty].name.clone().unwrap(),
        other => format!("{other:?}"),
    }
}

/// The same for a Rust type.
fn rust_name<T>() -> String {
    let (mut name, mut word) = (String::new(), String::new());
    for c in std::any::type_name::<T>().replace("<f32>", "").chars() {
        if c.is_alphanumeric() || c == '_' {
            word.push(c);
        } else if c == ':' {
            word.clear();
        } else {
            name.push_str(&std::mem::take(&mut word));
            name.push(c);
        }
    }
    name.push_str(&word);
    // Sent as its number.
    if name == "Family" { "u32".into() } else { name }
}

/// A struct: its name, its size, and of each member name, offset, size and type.
#[derive(Debug, PartialEq)]
struct Struct {
    name: String,
    size: usize,
    members: Vec<(String, usize, String)>,
}

/// Size and type of a member.
fn member<S, M>(_: fn(&S) -> &M) -> (usize, String) {
    (size_of::<M>(), rust_name::<M>())
}

macro_rules! structs {
    ($($twin:ty { $($member:ident)* })*) => {
        vec![$({
            let members = vec![$({
                let (size, name) = member(|s: &$twin| &s.$member);
                (stringify!($member).to_string(), offset_of!($twin, $member), size, name)
            }),*];
            let sum: usize = members.iter().map(|m| m.2).sum();
            assert_eq!(sum, size_of::<$twin>(), "{}: padding, or a member that is not in this list", rust_name::<$twin>());
            assert_eq!(align_of::<$twin>(), 4);
            let members = members.into_iter().map(|(name, offset, _, of)| (name, offset, of)).collect();
            Struct { name: rust_name::<$twin>(), size: size_of::<$twin>(), members }
        }),*]
    };
}

/// Rust structs that shaders read.
fn structs() -> Vec<Struct> {
    /// What `Bank` writes for the binding `sweep`.
    #[repr(C)]
    struct Sweep {
        first: u32,
        last: u32,
    }
    structs! {
        Batch { footholds dynamics stance_forces momentum impulses reach reach_feet force_nodes swing_nodes strides elements runs steps rests
            gathers touches values jacobian factor x x_half initial pull direction scaling diagonal gradient right_hand_side ground deviations
            c c_half c_change g g_half g_change weight value slack multiplier slack_step multiplier_step history carry front flags
            max_iterations stall_start stall_window stall_budget tolerance barrier proximal_floor pull_weight closing }
        Shape { kind rows columns first low per_metre }
        Constants<f32> { mass weight inertia inverse_inertia reach moment_scale balance_scale interval length_scale force_unit force_limit
            friction length_margin force_margin }
        MomentumPoint<f32> { time mean value rate integral }
        Slot { variables equalities rows inequalities footholds dynamics momentum reach force_nodes swing_nodes strides elements steps
            two_sided shape constants points }
        Progress<f32> { state current iterations factorisations attempts recorded stall_from infeasibility mu pull eps closing_eps
            closing_below closing_from edge_radius length }
        Span { start end }
        Run { variable slot column len }
        Place { row inequality jacobian stride }
        Element { family rows pairs place runs }
        BasePoint<f32> { reference weights variable slot interval deviation_weights }
        DynamicsInstant<f32> { reference rate weights variable column forces place }
        StanceForce<f32> { weights node node_column foothold foothold_column }
        MomentumInterval<f32> { reference rate variable linear_column angular_column impulses linear angular }
        Impulse<f32> { weights node linear_column angular_column foothold foothold_column }
        ReachInstant<f32> { base feet }
        ReachFoot<f32> { nominal xy_weights z_weights foothold height base_column foothold_column height_column slot place }
        ForceNode<f32> { node node_column slope_weight foothold foothold_column place }
        SwingNode<f32> { xy_weights z_weights low high height height_column foothold foothold_column place }
        Stride<f32> { limit foothold foothold_column place }
        FrontStep { size pivots variable factor stride elements reach rest }
        Rest { variable slot }
        Gather { touches offset }
        Touch { element column }
        Sweep { first last }
    }
}

/// Structs that stand in buffers, by the types of the bindings.
fn sent(module: &Module) -> BTreeMap<String, Struct> {
    fn collect(module: &Module, ty: Handle<Type>, found: &mut BTreeMap<String, Struct>) {
        match &module.types[ty].inner {
            TypeInner::Array { base, .. } => collect(module, *base, found),
            TypeInner::Struct { members, span } => {
                let name = module.types[ty].name.clone().unwrap();
                let of = |m: &naga::StructMember| (m.name.clone().unwrap(), m.offset as usize, type_name(module, m.ty));
                let entry = Struct { name: name.clone(), size: *span as usize, members: members.iter().map(of).collect() };
                found.insert(name, entry);
                members.iter().for_each(|m| collect(module, m.ty, found));
            }
            _ => {}
        }
    }
    let mut found = BTreeMap::new();
    for (_, variable) in module.global_variables.iter().filter(|v| v.1.binding.is_some()) {
        collect(module, variable.ty, &mut found);
    }
    found
}

#[test]
fn structs_in_buffers_have_the_members_and_offsets_of_their_twins() {
    let twins: BTreeMap<String, Struct> = structs().into_iter().map(|s| (s.name.clone(), s)).collect();
    let mut seen = BTreeSet::new();
    for (shader, _, module) in modules() {
        for (name, found) in sent(&module) {
            let twin = twins.get(&name).unwrap_or_else(|| panic!("{}: `{name}` stands in a buffer and has no twin", shader.name));
            assert_eq!(found, *twin, "{}", shader.name);
            seen.insert(name);
        }
    }
    let all: BTreeSet<String> = twins.into_keys().collect();
    assert_eq!(seen, all, "twins that no shader reads");
}

#[test]
fn a_struct_that_differs_is_seen() {
    let variant = variants()[0];
    let text = shader("rows").unwrap().text(&variant);
    let twin = structs().into_iter().find(|s| s.name == "Progress").unwrap();
    for (from, to) in [
        ("    mu: f32,\n    pull", "    pulled: f32,\n    pull"),
        ("    length: f32,\n}", "    length: u32,\n}"),
        ("    pull: f32,\n    eps: f32", "    eps: f32,\n    pull: f32"),
    ] {
        assert_eq!(text.matches(from).count(), 1, "{from}");
        let changed = text.replace(from, to).replace(".mu", ".state").replace(".length = reach", ".length = u32(reach)");
        // `Progress` alone: the rest need not fit any more.
        let start = changed.find("struct Progress").unwrap();
        let text = &changed[start..start + changed[start..].find('}').unwrap() + 1];
        let module = naga::front::wgsl::parse_str(&format!("{text}\n@group(0) @binding(0) var<storage> p: Progress;")).unwrap();
        assert_ne!(sent(&module)["Progress"], twin, "{to}");
    }
}

/// Bits of a module-scope constant.
fn bits(module: &Module, constant: &naga::Constant) -> u32 {
    match module.global_expressions[constant.init] {
        Expression::Literal(Literal::U32(v)) => v,
        Expression::Literal(Literal::F32(v)) => v.to_bits(),
        ref other => panic!("{:?}: {other:?}", constant.name),
    }
}

/// The largest positive number for which something holds that holds up to some number.
fn threshold(holds: impl Fn(f32) -> bool) -> f32 {
    let (mut low, mut high) = (f32::MIN_POSITIVE.to_bits(), f32::MAX.to_bits());
    assert!(holds(f32::from_bits(low)) && !holds(f32::from_bits(high)));
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        *(if holds(f32::from_bits(middle)) { &mut low } else { &mut high }) = middle;
    }
    f32::from_bits(low)
}

/// Constants that are private in `control.rs`, from what it does.
fn rules() -> [(&'static str, u32); 4] {
    let limits = Limits::<f32> { closing: 1., pull: 0., max_iterations: u32::MAX, ..Limits::new(&SolverSettings::default()) };
    let begun = |limits: &Limits<f32>, mut progress: Progress<f32>, f: f32, before: f32| {
        control::begin(&mut progress, limits, f, before, false);
        progress.state
    };
    let closing = |f| Progress {
        state: control::CLOSE,
        closing_from: 1.,
        closing_below: 0.,
        stall_from: u32::MAX / 2,
        ..Progress::first(&limits, f)
    };
    let rate = threshold(|f| begun(&limits, closing(0.), f, f) == control::CLOSE);
    // At rest, with nothing left of the budget.
    let strict = Limits { stall_start: 0, stall_window: 0, stall_budget: -1., ..limits };
    let late = Progress { recorded: 1, ..Progress::first(&strict, 0.) };
    let rests = |f: f32| begun(&Limits { stall_window: 1, stall_budget: 1., ..strict }, late, f, f) == control::STALLED;
    let above = threshold(|f| !rests(f));
    let (mut refused, mut attempts) = (Progress::first(&limits, 0.), 0);
    control::refuse(&mut refused);
    let growth = refused.eps / limits.proximal;
    let mut progress = Progress::<f32>::default();
    while progress.state == control::STEP {
        control::refuse(&mut progress);
        attempts += 1;
    }
    [("CLOSING_RATE", rate.to_bits()), ("STALL_ABOVE", above.to_bits()), ("PROXIMAL_GROWTH", growth.to_bits()), ("ATTEMPTS", attempts)]
}

#[test]
fn constants_are_those_of_the_twins() {
    let kind = |shape: TerrainShape| Shape::of(&Terrain { name: String::new(), friction: 1., shape }, 0).kind;
    let TerrainShape::Grid(grid) = hills().shape else { panic!() };
    let twins: BTreeMap<&str, u32> = BTreeMap::from([
        ("NONE", NONE),
        ("INNER_POINTS", INNER_POINTS as u32),
        ("MOMENTUM_POINTS", MOMENTUM_POINTS as u32),
        ("END", INNER_POINTS as u32),
        ("GRAVITY", (GRAVITY as f32).to_bits()),
        ("FLAT", kind(TerrainShape::Flat)),
        ("BLOCK", kind(TerrainShape::Profile(Profile::Block))),
        ("STAIRS", kind(TerrainShape::Profile(Profile::Stairs))),
        ("GAP", kind(TerrainShape::Profile(Profile::Gap))),
        ("SLOPE", kind(TerrainShape::Profile(Profile::Slope))),
        ("CHIMNEY", kind(TerrainShape::Profile(Profile::Chimney))),
        ("CHIMNEY_LR", kind(TerrainShape::Profile(Profile::ChimneyLr))),
        ("GRID", kind(TerrainShape::Grid(grid))),
        ("STEP", control::STEP),
        ("CLOSE", control::CLOSE),
        ("EXACT", control::EXACT),
        ("ENDED", control::ENDED),
        ("SOLVED", control::SOLVED),
        ("MAX_ITERATIONS", control::MAX_ITERATIONS),
        ("STALLED", control::STALLED),
        ("NON_FINITE", control::NON_FINITE),
        ("BARRIER_FLOOR", (BARRIER_FLOOR as f32).to_bits()),
        ("SLACK_FLOOR", (SLACK_FLOOR as f32).to_bits()),
        ("MULTIPLIER_FLOOR", (MULTIPLIER_FLOOR as f32).to_bits()),
        ("LINEAR_MOMENTUM", Family::LinearMomentum as u32),
        ("REACH", Family::Reach as u32),
        ("TAU", std::f32::consts::TAU.to_bits()),
    ]);
    let rules = BTreeMap::from(rules());
    let mut seen = BTreeSet::new();
    for (shader, variant, module) in modules() {
        let of_variant = BTreeMap::from([
            ("WORKGROUP", variant.workgroup),
            ("FRONT", variant.front),
            ("SIDE", variant.side),
            ("COLUMNS", variant.columns),
        ]);
        let mut parts = [0f32; 2];
        for (_, constant) in module.constants.iter() {
            let Some(name) = constant.name.as_deref() else { continue };
            let value = bits(&module, constant);
            match name {
                // Shaders alone reduce angles; see below.
                "TAU_HIGH" => parts[0] = f32::from_bits(value),
                "TAU_LOW" => parts[1] = f32::from_bits(value),
                _ => {
                    let twin = of_variant.get(name).or(twins.get(name)).or(rules.get(name));
                    let twin = twin.unwrap_or_else(|| panic!("{}: the constant {name} has no twin here", shader.name));
                    assert_eq!(value, *twin, "{}: {name} is {} or {}", shader.name, f32::from_bits(value), f32::from_bits(*twin));
                }
            }
            seen.insert(name.to_string());
        }
        if parts[0] != 0. {
            assert!((f64::from(parts[0]) + f64::from(parts[1]) - std::f64::consts::TAU).abs() < 1e-10);
            assert!(parts[0].to_bits().trailing_zeros() >= 14, "up to 2^14 turns of it are exact");
        }
    }
    for name in twins.keys().chain(rules.keys()) {
        assert!(seen.contains(*name), "no shader has the constant {name}");
    }
}

#[test]
fn shaders_table_and_twins_have_the_same_names() {
    let table: BTreeSet<String> = SHADERS.iter().map(|s| s.name.to_string()).collect();
    assert_eq!(table.len(), SHADERS.len());
    let shaders = texts("shaders");
    assert_eq!(shaders.keys().cloned().collect::<BTreeSet<_>>(), table);
    // Twins of what several shaders share, and what is no kernel.
    let others = [
        ("batch", "shared/batch.wgsl, shared/tables.wgsl"),
        ("control", "shared/control.wgsl"),
        ("math", "shared/math.wgsl"),
        ("slacks", "shared/slacks.wgsl"),
        ("shaders", "the table"),
        ("mod", "all rows at once"),
    ];
    // Whose twin is not one file: the corrector's half of slacks.rs and rows.rs.
    let spread = ["correct"];
    let twins: BTreeSet<String> = texts("src/kernels").into_keys().collect();
    let with_twin = table.iter().filter(|name| !spread.contains(&name.as_str())).cloned();
    let expected = with_twin.chain(others.map(|(name, _)| name.to_string())).collect();
    assert_eq!(twins, expected, "src/kernels");
    for name in &table {
        assert!(shaders[name].contains("// Twin"), "{name}.wgsl does not name its twin");
        let parts = shader(name).unwrap().parts;
        assert_eq!(*parts.last().unwrap(), shaders[name], "the table has another text for {name}");
    }
    // Shared files: each is a part of a shader, or ends those that sweep.
    for (name, text) in texts("shaders/shared") {
        let used = SHADERS.iter().any(|s| s.parts.contains(&text.as_str()) || variants().iter().any(|v| s.text(v).ends_with(&text)));
        assert!(used, "no shader has shared/{name}.wgsl");
    }
}

#[test]
fn workgroup_memory_is_within_the_limit_of_the_variant() {
    for limit in MEMORIES {
        let mut in_storage = 0;
        let fronts =
            [1, 40, 60, 65, 70, 72, 74, 76, 78, 80, 90, 100, 110, 115, 118, 120, 122, 140, 150, 155, 160, 165, 170, 175, LARGE_FRONT];
        for front in fronts {
            let variant = Variant::new(front, 190, WORKGROUP, limit);
            assert!(variant.front == 0 || variant.front as usize >= front * (front + 3) / 2, "it does not hold its front");
            assert!(variant.side as usize > front && variant.columns >= 190);
            in_storage += usize::from(variant.front == 0);
            for shader in &SHADERS {
                let module = parse(shader, &variant);
                let used: u32 = module
                    .global_variables
                    .iter()
                    .filter(|v| v.1.space == AddressSpace::WorkGroup)
                    .map(|(_, v)| module.types[v.ty].inner.size(module.to_ctx()).next_multiple_of(16))
                    .sum();
                let what = format!("{} for a front of {front} of {limit} bytes", shader.name);
                assert!(used <= limit, "{what}: {used} bytes of workgroup memory");
                let portable = front * (front + 3) / 2 * 4 < 12 << 10;
                assert!(!portable || used <= PORTABLE_MEMORY, "{what}: {used} bytes, more than the portable 16 KiB");
            }
        }
        assert!((1..fronts.len()).contains(&in_storage));
    }
}

/// Layouts with one to eight feet, short and long, some at an odd interval.
fn layouts() -> Vec<Layout<f32>> {
    let mut random = Random::new(5);
    let mut layouts = Vec::new();
    for own in transcriptions() {
        let tasks = [
            task("monoped", "slope", [1.5, 0.], 0.),
            task("biped", "flat", [1., 0.2], 0.3),
            task("anymal", "step", [2., 0.], 0.),
            task_for(spider(6), hills(), [1., 1.], 0.5),
            task_for(spider(8), hills(), [1., -1.], -0.5),
        ];
        for (i, task) in tasks.iter().enumerate() {
            let mut settings = own.clone();
            if i % 2 == 1 {
                settings.interval = Some(0.17);
                settings.reach_interval = 0.05;
            }
            layouts.push(layout_with(task, &gait(&mut random, task.robot.feet(), 1..=6), &settings));
        }
    }
    layouts
}

#[test]
fn gathering_over_touches_gives_the_transposed_product() {
    let mut random = Random::new(6);
    for layout in layouts() {
        let sweep = Sweep::of(&layout);
        let mut fill = |len: usize| -> Vec<f32> { (0..len).map(|_| random.between(-1., 1.) as f32).collect() };
        let (jacobian, v) = (fill(layout.jacobian_len), fill(layout.rows));
        let mut expected = vec![f32::NAN; layout.variables];
        transposed_times(&layout, &jacobian, &v, &mut vec![0.; layout.widest], &mut expected);
        assert_eq!(sweep.gathers.len(), layout.variables);
        for (variable, gather) in sweep.gathers.iter().enumerate() {
            let touches = &sweep.touches[gather.touches.range()];
            assert!(touches.windows(2).all(|pair| pair[0].element < pair[1].element), "in the order of the elements");
            let mut sum = 0f32;
            for touch in touches {
                let element = &layout.elements[touch.element as usize];
                let column = (element.place.jacobian + touch.column + gather.offset) as usize;
                let mut local = 0.;
                for r in 0..element.rows as usize {
                    local += v[element.place.row as usize + r] * jacobian[column + r * element.place.stride as usize];
                }
                sum += local;
            }
            assert_eq!(sum.to_bits(), expected[variable].to_bits(), "variable {variable}");
        }
        // Each block's touches stand there once.
        let blocks = sweep.gathers.iter().filter(|g| g.offset == 0).map(|g| g.touches.range().len()).sum::<usize>();
        assert_eq!(blocks, sweep.touches.len());
    }
}

#[test]
fn rests_name_what_stays_of_a_front_and_its_slot_in_the_next() {
    for layout in layouts() {
        let sweep = Sweep::of(&layout);
        assert_eq!(sweep.steps.len(), layout.steps.len());
        let mut moved = 0;
        for (k, (step, of)) in sweep.steps.iter().zip(&layout.steps).enumerate() {
            let same = [step.size, step.pivots, step.variable, step.factor, step.stride];
            assert_eq!(same, [of.size, of.pivots, of.variable, of.factor, of.stride]);
            assert_eq!(step.elements, of.elements);
            let rests = &sweep.rests[step.rest.range()];
            assert_eq!(rests.len() as u32, step.size - step.pivots);
            // By the contents of the front.
            let mut stays: Vec<u32> = vec![NONE; rests.len()];
            for run in &layout.front_runs[of.rest.range()] {
                for i in 0..run.len {
                    stays[(run.slot + i - of.pivots) as usize] = run.variable + i;
                }
            }
            assert_eq!(rests.iter().map(|r| r.variable).collect::<Vec<_>>(), stays);
            // By the moves into the next one.
            let Some(next) = layout.steps.get(k + 1) else {
                assert!(rests.is_empty(), "something is left at the end");
                continue;
            };
            let mut slots = vec![NONE; rests.len()];
            for run in &layout.front_runs[next.moves.range()] {
                for i in 0..run.len {
                    let rest = (run.column + i - of.pivots) as usize;
                    assert_eq!(rests[rest].variable, run.variable + i);
                    slots[rest] = run.slot + i;
                }
            }
            assert_eq!(rests.iter().map(|r| r.slot).collect::<Vec<_>>(), slots);
            assert!(slots.iter().all(|slot| *slot < next.size));
            moved += slots.len();
        }
        assert!(moved > 0 || layout.steps.len() == 1);
    }
}

#[test]
fn reach_instants_of_a_step_are_those_of_its_elements() {
    for layout in layouts() {
        let mut next = 0;
        for step in &Sweep::of(&layout).steps {
            assert_eq!(step.reach.start, next, "they follow each other");
            next = step.reach.end;
            let places = |e: &&Element| e.family == Family::Reach;
            let elements = layout.elements[step.elements.range()].iter().filter(places).map(|e| e.place.row);
            let feet =
                layout.reach_instants[step.reach.range()].iter().flat_map(|i| &layout.reach_feet[i.feet.range()]).map(|f| f.place.row);
            assert_eq!(feet.collect::<Vec<_>>(), elements.collect::<Vec<_>>());
        }
        assert_eq!(next as usize, layout.reach_instants.len());
    }
}
