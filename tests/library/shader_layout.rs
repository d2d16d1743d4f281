//! Agreement of shaders, their bindings and their files, without a GPU. Texts are parsed and validated; sizes and offsets of buffer
//! contents are compared with the types from which their declarations were written; tables that only shaders read are compared with those
//! of the twins.

use crate::common::{Random, cones, gait, hills, problem_with, spider, task, task_for, transcriptions};
use cregopt::backend::gpu::shaders::{
    Binding, SHARED, SOFTWARE_WORKGROUP, Shader, Variant, WORKGROUP, bindings, constants, generated, prelude, reads,
};
use cregopt::backend::tables::{Batch, Buffer, FrontRow, FrontStep, Part, ShaderTables, Shape, Slot, front_values};
use cregopt::linear::transposed::transposed_times;
use cregopt::nlp::Problem;
use cregopt::nlp::problem::Element;
use cregopt::rows::Constants;
use cregopt::rows::dynamics::DynamicsInstant;
use cregopt::rows::factored::{BaseBlocks, FactoredElement, FactoredInstant, FactoredTouch, FirstRows, OwnColumns};
use cregopt::rows::foot::StanceForce;
use cregopt::rows::footing::Footing;
use cregopt::rows::force::ForceNode;
use cregopt::rows::momentum::MomentumInterval;
use cregopt::rows::reach::{ReachFoot, ReachInstant, ReachLeg};
use cregopt::rows::sole::SolePoint;
use cregopt::rows::swing::SwingNode;
use cregopt::rows::table::{NONE, Place};
use cregopt::rows::turn::Turn;
use cregopt::solver::control::Progress;
use cregopt::solver::round::{ROUND, START, Stage};
use naga::valid::{Capabilities, GlobalUse, ModuleInfo, ValidationFlags, Validator};
use naga::{AddressSpace, ArraySize, Expression, Handle, Literal, Module, StorageAccess, Type, TypeInner};
use std::collections::{BTreeMap, BTreeSet};
use std::mem::offset_of;
use std::path::{Path, PathBuf};

/// Number of storage buffers that a shader may bind on every WebGPU device.
const MOST_BUFFERS: usize = 8;

/// Workgroup memory of every WebGPU adapter, bytes.
const PORTABLE_MEMORY: u32 = 16 << 10;

/// Workgroup memory of common adapters, bytes.
const MEMORIES: [u32; 4] = [PORTABLE_MEMORY, 32 << 10, 48 << 10, 64 << 10];

/// Size of a front that no workgroup memory holds.
const LARGE_FRONT: usize = 400;

/// Variants with the front in workgroup memory and in storage.
fn variants() -> [Variant; 2] {
    let variants = [Variant::new(60, WORKGROUP, PORTABLE_MEMORY), Variant::new(LARGE_FRONT, SOFTWARE_WORKGROUP, PORTABLE_MEMORY)];
    assert!(variants[0].front > 0 && variants[1].front == 0);
    variants
}

fn parse(shader: Shader, variant: &Variant) -> Module {
    let text = shader.text(variant);
    naga::front::wgsl::parse_str(&text).unwrap_or_else(|e| panic!("{}: {}", shader.path(), e.emit_to_string(&text)))
}

/// All shaders in both variants.
fn modules() -> Vec<(Shader, Variant, Module)> {
    variants().into_iter().flat_map(|variant| Shader::ALL.iter().map(move |&s| (s, variant, parse(s, &variant)))).collect()
}

/// Validates a module and returns the validator's information about it.
fn validate(shader: Shader, variant: &Variant, module: &Module) -> ModuleInfo {
    let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
    let text = shader.text(variant);
    validator.validate(module).unwrap_or_else(|e| panic!("{}: {}", shader.path(), e.emit_to_string(&text)))
}

#[test]
fn every_shader_validates() {
    for (shader, variant, module) in modules() {
        validate(shader, &variant, &module);
    }
}

#[test]
fn every_shader_has_one_entry_point_with_the_workgroup_size_of_the_variant() {
    for (shader, variant, module) in modules() {
        let entries: Vec<_> = module.entry_points.iter().map(|e| (e.name.as_str(), e.stage, e.workgroup_size)).collect();
        assert_eq!(entries, [("main", naga::ShaderStage::Compute, [variant.workgroup, 1, 1])], "{}", shader.path());
        assert!(variant.workgroup.is_power_of_two(), "sums halve it");
    }
}

/// Name of a type in a text; a buffer's type has brackets.
fn type_name(module: &Module, ty: Handle<Type>) -> String {
    match &module.types[ty].inner {
        TypeInner::Scalar(naga::Scalar::F32) => "f32".into(),
        TypeInner::Scalar(naga::Scalar::U32) => "u32".into(),
        TypeInner::Array { base, size: ArraySize::Dynamic, .. } => format!("[{}]", type_name(module, *base)),
        other => module.types[ty].name.clone().unwrap_or_else(|| format!("{other:?}")),
    }
}

/// Name and size of the entries of a buffer.
fn entry(buffer: Buffer) -> (String, usize) {
    match buffer {
        Buffer::Running => ("u32".into(), 4),
        Buffer::Values | Buffer::Jacobian | Buffer::Factor | Buffer::Heights => ("f32".into(), 4),
        Buffer::Slots => ("Slot".into(), size_of::<Slot>()),
        Buffer::Progress => ("Progress".into(), size_of::<Progress<f32>>()),
        table => ((table.entry().name)(), table.entry().size),
    }
}

/// Bindings that a shader declares.
fn stated(shader: Shader) -> Vec<Binding> {
    shader.bindings().unwrap_or_else(|why| panic!("{}: {why}", shader.path()))
}

#[test]
fn declared_bindings_match_the_module() {
    for (shader, _, module) in modules() {
        let mut bound: Vec<(u32, String)> = Vec::new();
        for (_, variable) in module.global_variables.iter() {
            let Some(binding) = &variable.binding else { continue };
            assert_eq!(binding.group, 0, "{}", shader.path());
            let access = match variable.space {
                AddressSpace::Uniform => "uniform",
                AddressSpace::Storage { access: StorageAccess::LOAD } => "read",
                AddressSpace::Storage { access } if access == StorageAccess::LOAD | StorageAccess::STORE => "read_write",
                other => panic!("{}: {other:?}", shader.path()),
            };
            bound.push((binding.binding, format!("{access} {}: {}", variable.name.as_deref().unwrap(), type_name(&module, variable.ty))));
        }
        bound.sort();
        let of = |binding: Binding| match binding {
            Binding::Batch => "uniform batch: Batch".to_string(),
            Binding::Part => "uniform part: Part".to_string(),
            Binding::Storage(buffer, written) => {
                format!("{} {}: [{}]", if written { "read_write" } else { "read" }, buffer.name(), entry(buffer).0)
            }
        };
        let expected: Vec<(u32, String)> = (0..).zip(stated(shader).into_iter().map(of)).collect();
        assert_eq!(bound, expected, "{}", shader.path());
        let buffers = shader.buffers().count();
        assert!(buffers <= MOST_BUFFERS, "{} binds {buffers} storage buffers", shader.path());
        assert!(shader.walks().is_none_or(|table| shader.table().is_some_and(|b| b.name() == table)), "{} walks no table", shader.path());
    }
}

#[test]
fn shaders_use_their_bindings_and_write_only_declared_ones() {
    for (shader, variant, module) in modules() {
        let info = validate(shader, &variant, &module);
        let used = |name: &str| {
            let (handle, _) = module.global_variables.iter().find(|(_, v)| v.name.as_deref() == Some(name)).unwrap();
            info.get_entry_point(0)[handle]
        };
        for binding in stated(shader) {
            let (name, written) = match binding {
                Binding::Batch => ("batch", false),
                Binding::Part => ("part", false),
                Binding::Storage(buffer, written) => (buffer.name(), written),
            };
            assert!(!used(name).is_empty(), "{} binds {name} in vain", shader.path());
            assert_eq!(used(name).contains(GlobalUse::WRITE), written, "{} writes {name}, or says so", shader.path());
        }
    }
}

#[test]
fn wrongly_declared_bindings_are_refused() {
    let text = "// needs: shared/values\n// binds: jacobian cones part\n// Cones.\n//   in      cones\n//   in out  jacobian  one row\n\n//   out  factor";
    let (read, written) = (|buffer| Binding::Storage(buffer, false), |buffer| Binding::Storage(buffer, true));
    let common = [Binding::Batch, read(Buffer::Running), read(Buffer::Slots), read(Buffer::Progress), read(Buffer::Values)];
    let own = [written(Buffer::Jacobian), read(Buffer::Cones), Binding::Part];
    assert_eq!(bindings(text), Ok([&common[..], &own].concat()));
    for (from, to, seen) in [
        ("binds: jacobian cones", "binds: jacobian cone cones", "it binds cone, which is no buffer"),
        ("binds: jacobian cones", "binds: jacobian slots cones", "it binds slots twice"),
        ("binds: jacobian cones", "binds: jacobian", "says that cones goes in or out, but does not bind it"),
        ("in out  jacobian", "out  factor", "says that factor goes in or out, but does not bind it"),
        ("cones part\n", "cones part\n// reads: runs\n", "reads runs, which is not in the tables that it binds"),
        ("cones part\n", "cones tables\n// reads: cones\n", "reads cones, which is not in the tables that it binds"),
    ] {
        let why = bindings(&text.replace(from, to)).unwrap_err();
        assert!(why.contains(seen), "{to}: {why}");
    }
}

#[test]
fn buffers_are_in_the_order_of_their_numbers() {
    for (i, &buffer) in Buffer::ALL.iter().enumerate() {
        assert_eq!(buffer as usize, i, "{}", buffer.name());
        let uses = |s: &Shader| s.buffers().any(|b| b.0 == buffer) || reads(s.source()).unwrap().contains(&buffer);
        assert!(Shader::ALL.iter().any(uses), "no shader binds or reads {}", buffer.name());
    }
    let names: BTreeSet<&str> = Buffer::ALL.iter().map(|b| b.name()).collect();
    assert_eq!(names.len(), Buffer::ALL.len());
}

/// Size of a type without padding, bytes, or the reason why it is not sound.
fn packed(module: &Module, ty: Handle<Type>) -> Result<usize, String> {
    match &module.types[ty].inner {
        TypeInner::Scalar(scalar) if scalar.width == 4 => Ok(4),
        TypeInner::Array { base, size, stride } => {
            let of_one = packed(module, *base)?;
            if *stride as usize != of_one {
                return Err(format!("an array of {} has gaps", type_name(module, *base)));
            }
            Ok(if let ArraySize::Constant(n) = size { n.get() as usize * of_one } else { of_one })
        }
        TypeInner::Struct { members, span } => {
            let mut size = 0;
            for member in members {
                if member.offset as usize != size {
                    return Err(format!("padding before {}", member.name.as_deref().unwrap()));
                }
                size += packed(module, member.ty)?;
            }
            if *span as usize == size { Ok(size) } else { Err(format!("padding at the end of {}", type_name(module, ty))) }
        }
        other => Err(format!("{other:?} has members that are not of four bytes")),
    }
}

/// Offset of a member of a struct.
fn offset(module: &Module, of: &str, member: &str) -> Option<usize> {
    let (_, ty) = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(of))?;
    let TypeInner::Struct { members, .. } = &ty.inner else { return None };
    members.iter().find(|m| m.name.as_deref() == Some(member)).map(|m| m.offset as usize)
}

/// Some members of each kind of struct, including the last ones: names and offsets.
macro_rules! offsets {
    ($($name:ident: $type:ty { $($member:ident)* })*) => {
        [$($((stringify!($name), stringify!($member), offset_of!($type, $member)),)*)*]
    };
}

/// Returns the first difference between the structs of a module and their types.
fn structs_differ(module: &Module) -> Result<(), String> {
    for (_, variable) in module.global_variables.iter().filter(|v| v.1.binding.is_some()) {
        let name = variable.name.as_deref().unwrap();
        let size = match name {
            "batch" => size_of::<Batch>(),
            "part" => size_of::<Part>(),
            _ => entry(*Buffer::ALL.iter().find(|b| b.name() == name).unwrap()).1,
        };
        let packed = packed(module, variable.ty).map_err(|why| format!("{name}: {why}"))?;
        if packed != size {
            return Err(format!("{name}: {packed} bytes, its type has {size}"));
        }
    }
    let offsets = offsets! {
        Batch: Batch { values x cost_weights flags stall_budget closing minimise_tolerance cost_limit }
        Slot: Slot { first_factored footholds shape constants points }
        Progress: Progress<f32> { phase infeasibility mu eps edge_radius length solved_infeasibility }
        Shape: Shape { low per_metre }
        Constants: Constants<f32> { inertia moment_scale friction force_margin }
        DynamicsInstant: DynamicsInstant<f32> { weights forces place }
        StanceForce: StanceForce<f32> { weights foothold_column }
        MomentumInterval: MomentumInterval<f32> { rate impulses angular }
        FactoredInstant: FactoredInstant<f32> { weights blocks elements }
        FactoredElement: FactoredElement { own stride }
        OwnColumns: OwnColumns { runs }
        BaseBlocks: BaseBlocks { variable front interval }
        FactoredTouch: FactoredTouch { own column }
        FirstRows: FirstRows { row inequality }
        ReachInstant: ReachInstant<f32> { reference deviation_weights }
        ReachFoot: ReachFoot<f32> { z_weights leg }
        ReachLeg: ReachLeg<f32> { half_widths foothold }
        ForceNode: ForceNode<f32> { slope_weight place }
        SwingNode: SwingNode<f32> { low two_sided upper place }
        Footing: Footing<f32> { high foothold_column place }
        SolePoint: SolePoint<f32> { node yaw_column place }
        Turn: Turn<f32> { limit base_column place }
        Element: Element { family pairs runs }
        FrontStep: FrontStep { rows rest }
        FrontRow: FrontRow { row columns instant }
        Part: Part { first last }
    };
    for (of, member, expected) in offsets {
        match offset(module, of, member) {
            Some(found) if found != expected => return Err(format!("{of}.{member} stands at {found}, in its type at {expected}")),
            Some(_) => {}
            None if module.types.iter().any(|t| t.1.name.as_deref() == Some(of)) => return Err(format!("{of} has no {member}")),
            None => return Err(format!("no {of}")),
        }
    }
    Ok(())
}

#[test]
fn structs_in_buffers_have_the_bytes_of_their_types() {
    for (shader, _, module) in modules() {
        assert_eq!(structs_differ(&module), Ok(()), "{}", shader.path());
    }
}

/// Words that an expression reads, in their order.
fn words_read(expression: &str) -> Vec<usize> {
    expression.split("tables[at + ").skip(1).map(|rest| rest.split_once("u]").unwrap().0.parse().unwrap()).collect()
}

#[test]
fn entries_of_joined_tables_are_made_of_all_their_words_in_order() {
    for table in Buffer::JOINED {
        let entry = table.entry();
        assert_eq!(words_read(&(entry.read)(0)), (0..entry.size / 4).collect::<Vec<_>>(), "{}", table.name());
    }
    let mut arrays = Vec::new();
    for table in [Buffer::BaseBlocks, Buffer::FactoredInstants, Buffer::FactoredOwn, Buffer::ReachLegs, Buffer::Elements] {
        (table.entry().arrays)(table.name(), 0, &mut arrays);
    }
    for (name, offset, of) in [
        ("factored_instants_weights", offset_of!(FactoredInstant<f32>, weights), "f32"),
        ("base_blocks_front", offset_of!(BaseBlocks, front), "u32"),
        ("factored_own_runs", offset_of!(OwnColumns, runs), "Run"),
        ("reach_legs_half_widths", offset_of!(ReachLeg<f32>, half_widths), "f32"),
    ] {
        let array = arrays.iter().find(|a| a.name == name).unwrap();
        let words = (offset / 4..offset / 4 + array.words as usize).collect();
        assert_eq!((words_read(&(array.read)(array.first)), &array.of[..]), (words, of), "{name}");
    }
    assert!(arrays.iter().all(|a| !a.name.starts_with("elements")), "an element has no arrays");
}

#[test]
fn a_struct_that_differs_is_seen() {
    // One binding of each struct that is not in a table.
    let bindings = "@group(0) @binding(0) var<uniform> batch: Batch;
        @group(0) @binding(1) var<storage> slots: array<Slot>;
        @group(0) @binding(2) var<storage> progress: array<Progress>;
        @group(0) @binding(3) var<storage> reach_legs: array<ReachLeg>;";
    let check = |text: &str| structs_differ(&naga::front::wgsl::parse_str(&format!("{text}{bindings}")).unwrap());
    let text = prelude();
    assert_eq!(check(&text), Ok(()));
    for (from, to, seen) in [
        ("    mu: f32,\n    barrier_floor: f32,\n", "    barrier_floor: f32,\n    mu: f32,\n", "Progress.mu"),
        ("    mu: f32,\n    barrier_floor: f32,\n", "    mu: f32,\n", "progress"),
        ("    mu: f32,\n    barrier_floor: f32,\n", "    mu: f32,\n    barrier_floor: vec3<f32>,\n", "progress"),
        ("    cost_limit: f32,\n}", "    cost_limit: f32,\n    more: u32,\n}", "batch"),
        ("    center: array<f32, 3>,\n", "    center: vec3<f32>,\n", "reach_legs"),
        ("    per_metre: array<f32, 2>,\n", "", "slots"),
        ("    angular: Place,\n", "    angle: Place,\n", "MomentumInterval has no angular"),
    ] {
        assert_eq!(text.matches(from).count(), 1, "{from}");
        let difference = check(&text.replace(from, to)).unwrap_err();
        assert!(difference.contains(seen), "{to}: {difference}");
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

#[test]
fn constants_arrive_with_all_their_bits_and_are_used() {
    let (whole, real) = constants();
    let mut twins: BTreeMap<&str, u32> = whole.into_iter().chain(real.into_iter().map(|(name, v)| (name, v.to_bits()))).collect();
    twins.extend([("QUARTERS_PER_RADIAN", std::f32::consts::FRAC_2_PI.to_bits()), ("END", twins["INNER_POINTS"])]);
    // Threads of an interval: one per point, and one for the start.
    twins.extend([("START", twins["MOMENTUM_POINTS"]), ("LANES", twins["MOMENTUM_POINTS"] + 1)]);
    for (shader, variant, module) in modules() {
        let Variant { workgroup, front, side, rows } = variant;
        let mut of_variant = BTreeMap::from([("WORKGROUP", workgroup), ("FRONT", front), ("SIDE", side), ("PANEL_ROWS", rows)]);
        // Invocations that work on one row of a panel.
        let team = (workgroup / rows).max(1);
        of_variant.extend([("TEAM", team), ("TEAMS", workgroup / team)]);
        let mut quarter = [0f32; 3];
        for (_, constant) in module.constants.iter() {
            let Some(name) = constant.name.as_deref() else { continue };
            let value = bits(&module, constant);
            match name {
                // Only shaders reduce angles; checked below.
                "QUARTER_HIGH" => quarter[0] = f32::from_bits(value),
                "QUARTER_MIDDLE" => quarter[1] = f32::from_bits(value),
                "QUARTER_LOW" => quarter[2] = f32::from_bits(value),
                // Only shaders have these; `tests/gpu/parity` compares their results with f64.
                "SINE_3" | "SINE_5" | "SINE_7" | "COSINE_4" | "COSINE_6" | "COSINE_8" => {}
                _ => {
                    let twin = of_variant.get(name).or(twins.get(name));
                    let twin = twin.unwrap_or_else(|| panic!("{}: the constant {name} has no twin", shader.path()));
                    assert_eq!(value, *twin, "{}: {name} is {} or {}", shader.path(), f32::from_bits(value), f32::from_bits(*twin));
                }
            }
        }
        if quarter[0] != 0. {
            // The remainder of a quarter turn after each part, from large to small, is exact until the last.
            let left = quarter.iter().fold(std::f64::consts::FRAC_PI_2, |left, part| left - f64::from(*part));
            assert!(left.abs() < 3e-16, "{left:e}");
            let exact = |part: &f32| part.to_bits().trailing_zeros() >= 11;
            assert!(quarter[..2].iter().all(exact), "up to 2^11 times these are exact");
        }
    }
    let texts: Vec<&str> = Shader::ALL.iter().map(|s| s.source()).chain(SHARED.iter().map(|s| s.1)).collect();
    for name in twins.keys() {
        assert!(texts.iter().any(|text| words(text).any(|word| word == *name)), "no shader uses {name}");
    }
}

/// Literals that are not constants of a twin: zero, one, half, twice, and small counts and indices.
const STRUCTURAL: [&str; 16] = ["0.0", "0.5", "1.0", "2.0", "0u", "1u", "2u", "3u", "4u", "0", "1", "2", "3", "4", "5", "6"];

/// Other literals in shaders, by file, with the reason why they are not shared with a twin as constants.
const ALLOWED: [(&str, &[&str], &str); 7] = [
    ("shared/control", &["0x7f800000u"], "bits of the exponent of f32"),
    ("shared/math", &["4.0", "0.25", "3.0"], "quarters of a turn"),
    ("shared/front_workgroup", &["16u"], "values of a tile"),
    ("shared/factored_product", &["5u"], "index of the last of six values"),
    ("rows/momentum", &["3.0", "6.0"], "quadratic with a given mean and end"),
    ("rows/goal", &["6u"], "components of a pose or of rates"),
    ("solver/judge", &["4.0"], "root of a quadratic equation"),
];

/// Literals of a text with their line numbers, without comments and declarations of constants. The latter are compared with their twins by
/// `constants_arrive_with_all_their_bits_and_are_used`.
fn literals(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let code = (1..).zip(text.lines()).map(|(number, line)| (number, line.split("//").next().unwrap()));
    code.filter(|(_, line)| !line.starts_with("const ")).flat_map(|(number, line)| {
        let word = |c: char| c.is_alphanumeric() || ['_', '.'].contains(&c);
        // The sign of an exponent splits a literal; both of its halves are found.
        line.split(move |c| !word(c)).filter(|w| w.starts_with(|c: char| c.is_ascii_digit())).map(move |literal| (number, literal))
    })
}

#[test]
fn numbers_in_shaders_are_structural_constants_of_twins_or_listed() {
    let mut used = vec![BTreeSet::new(); ALLOWED.len()];
    let mut strange = Vec::new();
    for (path, text) in Shader::ALL.iter().map(|s| (s.path(), s.source())).chain(SHARED.iter().copied()) {
        for (line, literal) in literals(text).filter(|(_, literal)| !STRUCTURAL.contains(literal)) {
            match ALLOWED.iter().position(|(file, literals, _)| *file == path && literals.contains(&literal)) {
                Some(i) => {
                    used[i].insert(literal);
                }
                None => strange.push(format!("shaders/{path}.wgsl:{line}: {literal}")),
            }
        }
    }
    let advice = "name them in Rust and add them to `constants()` of src/backend/gpu/shaders.rs, or list them in ALLOWED with a reason";
    assert!(strange.is_empty(), "{advice}:\n{}", strange.join("\n"));
    for ((file, literals, _), used) in ALLOWED.iter().zip(used) {
        assert_eq!(literals.len(), used.len(), "{file} no longer contains all of {literals:?}");
    }
}

#[test]
fn literals_are_found_outside_comments_and_constants() {
    let text = "const A: f32 = 0.7;\n// 0.3\nlet v1 = x2 * vec3<f32>(0.3, 1e-3, -4u); // 5\n    v.x = a[7];";
    assert_eq!(literals(text).collect::<Vec<_>>(), [(3, "0.3"), (3, "1e"), (3, "3"), (3, "4u"), (4, "7")]);
}

/// Variable that makes the test below write the file that it compares.
const WRITE: &str = "WRITE_GENERATED";

#[test]
fn the_file_of_generated_declarations_is_up_to_date() {
    let path = project().join("shaders/generated.wgsl");
    let test = "the_file_of_generated_declarations_is_up_to_date";
    let header = format!(
        "// Generated: constants, structs and table readers that precede the shaders, see `generated` of src/backend/gpu/shaders.rs. The\n\
         // program does not read this file. To write it:\n\
         // {WRITE}=1 cargo test --test library {test}\n\n"
    );
    let text = header + &generated();
    if std::env::var_os(WRITE).is_some() {
        std::fs::write(&path, &text).unwrap();
    }
    let found = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(found == text, "shaders/generated.wgsl is out of date; to write it: {WRITE}=1 cargo test --test library {test}");
    // Every line is part of the text of a shader.
    let texts: Vec<String> = Shader::ALL.iter().map(|s| s.text(&variants()[0])).collect();
    for part in generated().split("\n\n") {
        assert!(texts.iter().any(|text| text.contains(part)), "no shader contains {part}");
    }
}

/// Words of a text, without comments.
fn words(text: &str) -> impl Iterator<Item = &str> {
    let code = text.lines().map(|line| line.split("//").next().unwrap());
    code.flat_map(|line| line.split(|c: char| !c.is_alphanumeric() && c != '_')).filter(|word| !word.is_empty())
}

/// Shared files that a text names as needed.
fn needs(text: &str) -> impl Iterator<Item = &str> {
    text.lines().filter_map(|line| line.strip_prefix("// needs:")).flat_map(str::split_whitespace)
}

#[test]
fn every_need_is_a_shared_file_and_every_shared_file_is_needed() {
    let texts = || Shader::ALL.iter().map(|s| (s.path(), s.source())).chain(SHARED.iter().copied());
    let shared: BTreeMap<&str, &str> = SHARED.iter().copied().collect();
    for (path, text) in texts() {
        for name in needs(text) {
            let needed = shared.get(name).unwrap_or_else(|| panic!("{path} needs {name}, which is no shared file"));
            // At least one of its declarations is used by the text or by another file that the text needs.
            let declared = needed.lines().filter_map(|line| {
                let (keyword, rest) = line.split_once(' ')?;
                let declares = ["fn", "struct", "alias", "const", "var<workgroup>"].contains(&keyword);
                declares.then(|| words(rest).next().unwrap())
            });
            // A file that walks a table is for a text without an entry point of its own.
            let uses = |name: &str| {
                if name == "main" {
                    return words(text).all(|word| word != "main");
                }
                [text]
                    .into_iter()
                    .chain(needs(text).filter_map(|n| shared.get(n).copied()))
                    .any(|of| of != *needed && words(of).any(|word| word == name))
            };
            assert!(declared.into_iter().any(uses), "{path} needs {name} in vain");
        }
    }
    for (name, text) in SHARED {
        let needed = texts().any(|(_, of)| needs(of).any(|need| need == *name));
        // The variant chooses where the front is kept.
        let chosen =
            variants().iter().any(|v| needs(Shader::Front.source()).all(|need| need != *name) && Shader::Front.text(v).contains(text));
        assert!(needed || chosen, "no shader needs {name}");
    }
}

#[test]
fn every_shader_belongs_to_one_stage_of_a_round() {
    let mut stages: Vec<Stage> = START.into_iter().chain(ROUND.map(|(stage, _)| stage)).collect();
    stages.sort_by_key(|stage| *stage as usize);
    stages.dedup();
    let mut shaders: Vec<Shader> = stages.into_iter().flat_map(Shader::of).copied().collect();
    shaders.sort();
    assert_eq!(shaders, Shader::ALL);
}

/// Files of a folder of this project without their extension, as paths from `root`.
fn files(root: &str, folder: &str) -> BTreeSet<String> {
    let path = project().join(root).join(folder);
    let files = std::fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_file());
    files.map(|path| format!("{folder}/{}", path.file_stem().unwrap().to_str().unwrap())).collect()
}

fn project() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).into()
}

#[test]
fn every_shader_has_a_twin_file_and_names_it() {
    let folders = ["rows", "linear", "solver"];
    let all: BTreeSet<String> = Shader::ALL.iter().map(|s| s.path().to_string()).collect();
    assert_eq!(all.len(), Shader::ALL.len());
    assert_eq!(folders.map(|folder| files("shaders", folder)).into_iter().flatten().collect::<BTreeSet<_>>(), all);
    let shared: BTreeSet<String> = SHARED.iter().map(|(name, _)| name.to_string()).collect();
    assert_eq!(files("shaders", "shared"), shared);
    // Twins of code that several shaders share, parts of a twin, and files that are not kernels.
    let others =
        ["rows/blocks", "rows/factored", "rows/foot", "rows/hip", "rows/leg_joints", "rows/math", "rows/mod", "rows/table", "rows/write"];
    let others = others.into_iter().chain(["linear/factored", "linear/mod", "linear/simd"]);
    let more = [
        "solver/close",
        "solver/control",
        "solver/minimise",
        "solver/mod",
        "solver/objective",
        "solver/round",
        "solver/slacks",
        "solver/status",
    ];
    let twins: BTreeSet<String> = folders.map(|folder| files("src", folder)).into_iter().flatten().collect();
    assert_eq!(twins, all.iter().cloned().chain(others.chain(more).map(String::from)).collect());
    for shader in Shader::ALL {
        let named = shader.source().lines().find(|line| line.starts_with("// Twin")).unwrap_or_default();
        assert!(named.contains(&format!("src/{}.rs", shader.path())), "{} does not name its twin", shader.path());
    }
    for (path, text) in Shader::ALL.iter().map(|s| (s.path(), s.source())).chain(SHARED.iter().copied()) {
        for file in text.split(|c: char| c.is_whitespace() || [',', '`', ':'].contains(&c)).filter(|word| word.starts_with("src/")) {
            let file = file.trim_end_matches('.');
            assert!(project().join(file).is_file(), "{path} names {file}, which is not there");
        }
    }
}

#[test]
fn workgroup_memory_is_within_the_limit_of_the_variant() {
    for limit in MEMORIES {
        let mut in_storage = 0;
        let fronts =
            [1, 40, 60, 65, 70, 72, 74, 76, 78, 80, 90, 100, 110, 115, 118, 120, 122, 140, 150, 155, 160, 165, 170, 175, LARGE_FRONT];
        for front in fronts {
            let variant = Variant::new(front, WORKGROUP, limit);
            assert!(variant.front == 0 || variant.front as usize >= front_values(front), "it does not hold its front");
            assert!(variant.side as usize > front && (4..=16).contains(&variant.rows));
            in_storage += usize::from(variant.front == 0);
            for &shader in Shader::ALL {
                let module = parse(shader, &variant);
                let used: u32 = module
                    .global_variables
                    .iter()
                    .filter(|v| v.1.space == AddressSpace::WorkGroup)
                    .map(|(_, v)| module.types[v.ty].inner.size(module.to_ctx()).next_multiple_of(16))
                    .sum();
                let what = format!("{} for a front of {front} of {limit} bytes", shader.path());
                assert!(used <= limit, "{what}: {used} bytes of workgroup memory");
                let portable = 4 * front_values(front) < 10 << 10;
                assert!(!portable || used <= PORTABLE_MEMORY, "{what}: {used} bytes, more than the portable 16 KiB");
            }
        }
        assert!((1..fronts.len()).contains(&in_storage));
    }
}

/// Layouts with one to eight feet, short and long, some with an odd interval.
fn problems() -> Vec<Problem<f32>> {
    let mut random = Random::new(5);
    let mut problems = Vec::new();
    for own in transcriptions().into_iter().chain([cones()]) {
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
            problems.push(problem_with(task, &gait(&mut random, task.robot.feet(), 1..=6), &settings));
        }
    }
    problems
}

#[test]
fn gathering_over_touches_gives_the_transposed_product() {
    let mut random = Random::new(6);
    for problem in problems() {
        let own = ShaderTables::of(&problem);
        let mut fill = |len: usize| -> Vec<f32> { (0..len).map(|_| random.between(-1., 1.) as f32).collect() };
        let (jacobian, v) = (fill(problem.jacobian_len), fill(problem.rows.all()));
        let mut expected = vec![f32::NAN; problem.variables];
        transposed_times(&problem, &jacobian, &v, &mut vec![0.; problem.widest], &mut expected);
        assert_eq!(own.gather_of.len(), problem.variables);
        let of_rows = |place: Place, rows: u32, column: u32| {
            let at = |r: usize| (place.jacobian + column) as usize + r * place.stride as usize;
            (0..rows as usize).fold(0f32, |sum, r| v[place.row as usize + r].mul_add(jacobian[at(r)], sum))
        };
        let foot = |number: usize, column: u32| of_rows(problem.reach_rows.place(number), 3, column);
        for (variable, &gather) in own.gather_of.iter().enumerate() {
            let gather = &own.gathers[gather as usize];
            let offset = variable as u32 - gather.variable;
            let touches = &own.touches[gather.touches.range()];
            assert!(touches.is_sorted_by(|a, b| a.element < b.element), "in the order of the elements");
            let factored = &own.factored_touches[gather.factored.range()];
            assert!(factored.is_sorted_by(|a, b| a.instants.end <= b.instants.start), "in the order of the instants");
            let mut sum = 0f32;
            for touch in touches {
                let element = &problem.elements[touch.element as usize];
                sum += of_rows(element.place, element.rows, touch.column + offset);
            }
            for touch in factored {
                for instant in &problem.reach_rows.instants[touch.instants.range()] {
                    let touches = |f: &usize| touch.own == NONE || touch.own == problem.reach_rows.elements[*f].own;
                    let of_elements = instant.elements.range().filter(touches).fold(0., |sum, f| sum + foot(f, touch.column + offset));
                    let weight = if touch.own == NONE { instant.weights[touch.block as usize] } else { 1. };
                    sum = weight.mul_add(of_elements, sum);
                }
            }
            assert_eq!(sum.to_bits(), expected[variable].to_bits(), "variable {variable}");
        }
        // The touches of each block occur once.
        assert_eq!(own.gathers.iter().map(|g| g.touches.range().len()).sum::<usize>(), own.touches.len());
        assert_eq!(own.gathers.iter().map(|g| g.factored.range().len()).sum::<usize>(), own.factored_touches.len());
    }
}

#[test]
fn rests_name_the_remainder_of_a_front_and_its_place_in_the_next() {
    for problem in problems() {
        let own = ShaderTables::of(&problem);
        assert_eq!(own.front_steps.len(), problem.steps.len());
        let mut moved = 0;
        for (k, (step, of)) in own.front_steps.iter().zip(&problem.steps).enumerate() {
            let same = [step.size, step.pivots, step.variable, step.factor, step.stride];
            assert_eq!(same, [of.size, of.pivots, of.variable, of.factor, of.stride]);
            let rests = &own.rests[step.rest.range()];
            assert_eq!(rests.len() as u32, step.size - step.pivots);
            // From the contents of the front.
            let mut stays: Vec<u32> = vec![NONE; rests.len()];
            for run in &problem.front_runs[of.rest.range()] {
                for i in 0..run.len {
                    stays[(run.front + i - of.pivots) as usize] = run.variable + i;
                }
            }
            assert_eq!(rests.iter().map(|r| r.variable).collect::<Vec<_>>(), stays);
            // From the moves into the next front.
            let Some(next) = problem.steps.get(k + 1) else {
                assert!(rests.is_empty(), "something is left at the end");
                continue;
            };
            let of_next = problem.front_runs[next.rest.range()].iter().flat_map(|run| (0..run.len).map(|i| run.variable + i));
            let contents: Vec<u32> = (next.variable..next.variable + next.pivots).chain(of_next).collect();
            let mut nexts = vec![NONE; rests.len()];
            for run in &problem.front_runs[next.moves.range()] {
                for i in 0..run.len {
                    let rest = (run.column + i - of.pivots) as usize;
                    assert_eq!(rests[rest].variable, contents[(run.front + i) as usize]);
                    nexts[rest] = run.front + i;
                }
            }
            assert_eq!(rests.iter().map(|r| r.next).collect::<Vec<_>>(), nexts);
            assert!(nexts.iter().all(|at| *at < next.size));
            moved += nexts.len();
        }
        assert!(moved > 0 || problem.steps.len() == 1);
    }
}
