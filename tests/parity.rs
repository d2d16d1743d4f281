//! Every shader against its Rust twin on the same numbers, on a GPU or a software adapter.
//!
//! A bank holds candidates in slots. Before a run everything that the shader is not documented to read is poison, a NaN of its own; then the
//! twin writes into a copy. After the run both are compared as a whole: what the twin wrote within a tolerance, all else bit for bit, so an
//! element that is left out, written twice over, or written into a slot that was not asked for, fails.
//!
//! `CREGOPT_TEST_ADAPTER` names the adapter; without one tests are skipped, unless `GPU_TESTS=require`.

mod common;

use common::{Random, gait, hills, layout_with, point, spider, task, task_for, transcriptions};
use cregopt::backend::gpu::shaders::{Buffer, SHADERS, Variant, WORKGROUP};
use cregopt::backend::gpu::tables::{Batch, Sizes};
use cregopt::backend::gpu::{Bank, Device, Prepared};
use cregopt::gait::Schedule;
use cregopt::linear::front::{Factor, NormalEquations, factorise};
use cregopt::nlp::Layout;
use cregopt::nlp::layout::Deviation;
use cregopt::rows::{Shared, advance, dynamics, foothold, force, forward, judge, momentum, product, reach, rows, start, swing, transposed};
use cregopt::settings::{SolverSettings, StallSettings, TranscriptionSettings};
use cregopt::solver::control::{self, CLOSE, ENDED, EXACT, Limits, Progress, SOLVED, STEP};
use cregopt::solver::slacks::{Aim, BARRIER_FLOOR, Slacks, mean_product, slack_steps};
use cregopt::task::Task;
use cregopt::terrain::{Ground, Shape, Terrain};
use nalgebra::{DMatrix, DVector};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock};

// Tolerances are in units of f32 precision, 2^-23, of the larger of the value and the size of the terms that it is the sum of. Where nothing
// else is said that size is 1. llvmpipe rounds every operation as the twins do; other drivers may fuse a product with a sum, and WGSL
// gives division and square root 2.5 units.

/// Where twin and shader take the same steps in the same order, a few of them divisions.
const ARITHMETIC: f32 = 8.;

/// Sums in another order, against the sum of the sizes of their terms. In lanes of some hundred terms errors grow like the root of their
/// number.
const SUM: f32 = 16.;

/// Rows with sine and cosine, against the larger of 1 and the value. Drivers are a few units off in those (WGSL asks for no more than 2^-11
/// absolute, which no f32 solver could use), and rows multiply that by legs in units of 0.1 m or by moments of some body weights.
const TRIGONOMETRY: f32 = 64.;

/// Force rows: a root and divisions, and normals of ground that bends by 33/m.
const CURVED: f32 = 16.;

/// Deviations of attitude divide momenta of up to 1e3 N m s by inertias down to 0.05 kg m²; see `F32_DEVIATION_TOLERANCE` in reference.rs.
const DEVIATION: f32 = 256.;

/// Backward error of the front, entry by entry: that of a Cholesky factor is within a few units of the geometric mean of two diagonal
/// entries, and sums of up to some hundred products grow like the root of their number.
const FRONT: f64 = 16. * f32::EPSILON as f64;

/// Backward error of a substitution in each row, relative to the sum of the sizes of its terms: one rounding a term, up to 200 of them, of
/// which most cancel.
const SUBSTITUTION: f64 = 32. * f32::EPSILON as f64;

/// Nobody writes this NaN.
const POISON: f32 = f32::from_bits(0x7fd5_eed5);

/// Slots of a bank.
const CAPACITY: usize = 70;

/// Sizes of the list of running slots: one, and around what a workgroup or a warp would hold.
const COUNTS: [usize; 4] = [1, 63, 64, 65];

/// The largest front, and most columns of an element, that leave the front within the portable 16 KiB of workgroup memory.
const SMALL: [usize; 2] = [80, 160];

/// Those of banks whose front no common adapter keeps in workgroup memory: 81 KiB.
const LARGE: [usize; 2] = [200, 256];

/// Says so even where the output of tests that pass is not shown.
#[expect(clippy::explicit_write, reason = "the harness keeps what eprintln prints")]
fn skipped(test: &str, why: &str) {
    writeln!(std::io::stderr(), "`{test}` skipped: {why}").unwrap();
}

/// The adapter, opened once, with the workgroups of GPUs; `None`, said by name, when this machine has none.
fn gpu(test: &str) -> Option<Arc<Device>> {
    static DEVICE: OnceLock<Result<Arc<Device>, String>> = OnceLock::new();
    let device = DEVICE.get_or_init(|| {
        let name = std::env::var("CREGOPT_TEST_ADAPTER").ok();
        let device = Device::open(name.as_deref(), true).map_err(|e| e.to_string())?;
        eprintln!("parity on {} ({}, {})", device.report.name, device.report.interface, device.report.driver);
        Ok(Arc::new(device.with_workgroup(WORKGROUP)))
    });
    match device {
        Ok(device) => Some(device.clone()),
        Err(why) => {
            assert!(std::env::var("GPU_TESTS").as_deref() != Ok("require"), "`{test}` needs a GPU: {why}");
            skipped(test, why);
            None
        }
    }
}

/// The same adapter with workgroups of another size, those of software adapters.
fn with_its_workgroups(test: &str) -> Option<Arc<Device>> {
    static DEVICE: OnceLock<Option<Arc<Device>>> = OnceLock::new();
    gpu(test)?;
    let open = || Device::open(std::env::var("CREGOPT_TEST_ADAPTER").ok().as_deref(), true).ok().map(Arc::new);
    DEVICE.get_or_init(open).clone()
}

/// A candidate, and a point at which it is evaluated.
struct Candidate {
    name: String,
    feet: usize,
    layout: Layout<f32>,
    x: Vec<f32>,
    first_height: u32,
}

impl Candidate {
    fn new(task: Task, schedule: Schedule, settings: &TranscriptionSettings, random: &mut Random) -> Candidate {
        let layout = layout_with::<f32>(&task, &schedule, settings);
        let exact = layout_with::<f64>(&task, &schedule, settings);
        let x = point(&exact, random, EDGE_RADIUS).into_iter().map(|v| v as f32).collect();
        let first_height = grids().1.iter().find(|g| g.0 == task.terrain.name).map_or(0, |g| g.1);
        let name = format!("{} on {}, {}", task.robot.name, task.terrain.name, settings.rows.name());
        Candidate { name, feet: task.robot.feet(), layout, x, first_height }
    }
}

/// Rounding of edges for the force rows, m.
const EDGE_RADIUS: f64 = 0.04;

/// Heights of all grids behind some that are no grid's, and where each grid begins.
fn grids() -> (Vec<f32>, Vec<(String, u32)>) {
    let (mut heights, mut firsts) = (vec![POISON; 5], Vec::new());
    for terrain in [Terrain::named("step").unwrap(), hills()] {
        let Shape::Grid(grid) = &terrain.shape else { panic!() };
        firsts.push((terrain.name.clone(), heights.len() as u32));
        heights.extend(grid.heights.iter().flatten().map(|h| *h as f32));
    }
    (heights, firsts)
}

/// Small candidates: robots with one to eight feet on every terrain, in both transcriptions, some turned by more than half a turn.
fn candidates() -> Vec<Candidate> {
    let named = |name| Terrain::named(name).unwrap();
    let mut random = Random::new(11);
    let mut candidates = Vec::new();
    for settings in transcriptions() {
        let tasks = [
            task("monoped", "stairs", [2.2, 0.1], 0.3),
            task("biped", "chimney-lr", [2.2, 0.], -0.4),
            task("anymal", "step", [4.5, -0.2], 0.),
            task("pexod", "slope", [2.8, 0.2], 0.5),
            task_for(spider(8), named("gap"), [2.2, -0.1], 0.7),
            task_for(spider(1), hills(), [2.5, 1.], -1.),
            task("biped", "block", [2.2, 0.1], 3.1),
            task("anymal", "flat", [1., -0.3], std::f64::consts::PI),
            task_for(spider(6), hills(), [-3., 1.5], 6.2),
            task("monoped", "chimney", [2., 0.2], -3.1),
        ];
        for task in tasks {
            let feet = task.robot.feet();
            let schedule = gait(&mut random, feet, if feet > 4 { 1..=2 } else { 2..=3 });
            candidates.push(Candidate::new(task, schedule, &settings, &mut random));
        }
    }
    candidates
}

/// Candidates with more entries than a workgroup has invocations in every table.
fn long_candidates() -> Vec<Candidate> {
    let mut random = Random::new(12);
    let fine = |own: TranscriptionSettings| TranscriptionSettings { interval: Some(0.05), ..own };
    transcriptions()
        .map(fine)
        .iter()
        .map(|settings| {
            let task = task_for(spider(8), hills(), [2., 1.], 0.4);
            Candidate::new(task, gait(&mut random, 8, 10..=10), settings, &mut random)
        })
        .collect()
}

/// What shaders write.
#[derive(Clone)]
struct State {
    values: Vec<f32>,
    jacobian: Vec<f32>,
    factor: Vec<f32>,
    progress: Vec<Progress<f32>>,
}

/// What the twin writes, and the sizes of the terms where they are not 1.
struct Expected {
    state: State,
    sizes: BTreeMap<usize, f32>,
}

/// A bank and who is in it.
struct Lab<'a> {
    device: Arc<Device>,
    bank: Bank,
    batch: Batch,
    slots: Vec<Slot<'a>>,
    settings: SolverSettings,
}

/// A slot's candidate, and how many entries it has in this test.
struct Slot<'a> {
    candidate: &'a Candidate,
    layout: Layout<f32>,
    counts: cregopt::backend::gpu::tables::Slot,
    loops: u32,
}

/// Names of the arrays in the values of a slot, by where they begin.
fn arrays(batch: &Batch) -> Vec<(u32, &'static str)> {
    vec![
        (batch.x, "x"),
        (batch.initial, "initial"),
        (batch.pull, "pull"),
        (batch.direction, "direction"),
        (batch.scaling, "scaling"),
        (batch.diagonal, "diagonal"),
        (batch.gradient, "gradient"),
        (batch.right_hand_side, "right_hand_side"),
        (batch.ground, "ground"),
        (batch.deviations, "deviations"),
        (batch.c, "c"),
        (batch.c_change, "c_change"),
        (batch.g, "g"),
        (batch.g_change, "g_change"),
        (batch.weight, "weight"),
        (batch.value, "value"),
        (batch.slack, "slack"),
        (batch.multiplier, "multiplier"),
        (batch.slack_step, "slack_step"),
        (batch.multiplier_step, "multiplier_step"),
        (batch.history, "history"),
        (batch.carry, "carry"),
        (batch.front, "front"),
        (batch.flags, "flags"),
    ]
}

/// Names of the members of `Progress`; the first seven are integers.
const PROGRESS: [&str; 16] = [
    "state",
    "current",
    "iterations",
    "factorisations",
    "attempts",
    "recorded",
    "stall_from",
    "infeasibility",
    "mu",
    "pull",
    "eps",
    "closing_eps",
    "closing_below",
    "closing_from",
    "edge_radius",
    "length",
];

impl<'a> Lab<'a> {
    /// A bank with candidate `s % n` in slot `s`, changed by `tweak`.
    fn new(
        device: &Arc<Device>,
        candidates: &'a [Candidate],
        slots: usize,
        front: [usize; 2],
        tweak: impl Fn(usize, &mut Prepared),
    ) -> Self {
        Lab::with_loops(device, candidates, slots, front, 1, tweak)
    }

    fn with_loops(
        device: &Arc<Device>,
        candidates: &'a [Candidate],
        slots: usize,
        [front, columns]: [usize; 2],
        loops: u32,
        tweak: impl Fn(usize, &mut Prepared),
    ) -> Self {
        let settings = SolverSettings {
            edge_radius: EDGE_RADIUS,
            max_iterations: 25,
            stall: StallSettings { enabled: true, start: 12, window: 7, budget: 200. },
            ..SolverSettings::default()
        };
        let prepare = |s: usize| {
            let candidate = &candidates[s % candidates.len()];
            let mut prepared = Prepared::new(s, candidate.layout.clone(), candidate.first_height, device.workgroup);
            tweak(s, &mut prepared);
            prepared
        };
        let prepared: Vec<Prepared> = (0..slots).map(prepare).collect();
        let sizes = prepared.iter().map(|p| p.sizes).reduce(Sizes::max).unwrap();
        let sizes = Sizes { front, columns, ..sizes };
        let mut bank = Bank::new(device, sizes, &settings, slots, &grids().0, loops).unwrap();
        bank.fill(&[(0, &prepared[..])], &settings);
        let of = |p: Prepared| Slot {
            candidate: &candidates[p.index % candidates.len()],
            counts: p.slot,
            loops: p.loops * p.sweep.steps.len() as u32,
            layout: p.layout,
        };
        Lab { device: device.clone(), batch: bank.batch, bank, slots: prepared.into_iter().map(of).collect(), settings }
    }

    /// All poison.
    fn poisoned(&self) -> State {
        let n = self.slots.len();
        let float = POISON;
        let progress = Progress {
            infeasibility: float,
            mu: float,
            pull: float,
            eps: float,
            closing_eps: float,
            closing_below: float,
            closing_from: float,
            edge_radius: float,
            length: float,
            ..Progress::default()
        };
        State {
            values: vec![POISON; n * self.batch.values as usize],
            jacobian: vec![POISON; n * 2 * self.batch.jacobian as usize],
            factor: vec![POISON; n * self.batch.factor as usize],
            progress: vec![progress; n],
        }
    }

    /// Where an array of a slot stands in the values.
    fn range(&self, slot: usize, array: u32, len: usize) -> Range<usize> {
        let at = slot * self.batch.values as usize + array as usize;
        at..at + len
    }

    fn x(&self, slot: usize, half: u32) -> Range<usize> {
        self.range(slot, self.batch.x + half * self.batch.x_half, self.slots[slot].layout.initial.len())
    }

    fn c(&self, slot: usize, half: u32) -> Range<usize> {
        self.range(slot, self.batch.c + half * self.batch.c_half, self.slots[slot].layout.equalities)
    }

    fn g(&self, slot: usize, half: u32) -> Range<usize> {
        self.range(slot, self.batch.g + half * self.batch.g_half, self.slots[slot].layout.inequalities)
    }

    fn of_variables(&self, slot: usize, array: u32) -> Range<usize> {
        self.range(slot, array, self.slots[slot].layout.variables)
    }

    fn of_rows(&self, slot: usize, array: u32) -> Range<usize> {
        self.range(slot, array, self.slots[slot].layout.rows)
    }

    fn of_inequalities(&self, slot: usize, array: u32) -> Range<usize> {
        self.range(slot, array, self.slots[slot].layout.inequalities)
    }

    fn of_equalities(&self, slot: usize, array: u32) -> Range<usize> {
        self.range(slot, array, self.slots[slot].layout.equalities)
    }

    /// Residuals of one half and their changes: equalities, inequalities.
    fn changes(&self, slot: usize, half: u32) -> [(Range<usize>, Range<usize>); 2] {
        let batch = &self.batch;
        [(self.c(slot, half), self.of_equalities(slot, batch.c_change)), (self.g(slot, half), self.of_inequalities(slot, batch.g_change))]
    }

    fn flags(&self, slot: usize) -> usize {
        self.range(slot, self.batch.flags, 1).start
    }

    fn jacobian(&self, slot: usize, half: u32) -> Range<usize> {
        let at = (2 * slot + half as usize) * self.batch.jacobian as usize;
        at..at + self.slots[slot].layout.jacobian_len
    }

    fn factor(&self, slot: usize) -> Range<usize> {
        let at = slot * self.batch.factor as usize;
        at..at + self.slots[slot].layout.factor_len
    }

    /// Writes a state, runs a shader over a list of slots, and reads the state.
    fn run(&mut self, shader: &'static str, list: &[u32], before: &State) -> State {
        let device = self.device.clone();
        self.bank.write_buffer(&device, Buffer::Values, bytemuck::cast_slice(&before.values));
        self.bank.write_buffer(&device, Buffer::Jacobian, bytemuck::cast_slice(&before.jacobian));
        self.bank.write_buffer(&device, Buffer::Factor, bytemuck::cast_slice(&before.factor));
        self.bank.write_buffer(&device, Buffer::Progress, bytemuck::cast_slice(&before.progress));
        self.bank.run(&device, &[shader], list).unwrap();
        let bound = |buffer| SHADERS.iter().any(|s| s.name == shader && s.buffers.contains(&(buffer, true)));
        let read = |buffer| self.bank.read_buffer(buffer).unwrap();
        // What it binds to read alone stays as it is.
        let floats = |buffer, before: &Vec<f32>| if bound(buffer) { bytemuck::pod_collect_to_vec(&read(buffer)) } else { before.clone() };
        State {
            values: floats(Buffer::Values, &before.values),
            jacobian: floats(Buffer::Jacobian, &before.jacobian),
            factor: floats(Buffer::Factor, &before.factor),
            progress: bytemuck::pod_collect_to_vec(&read(Buffer::Progress)),
        }
    }

    /// Compares what a shader left with what its twin did.
    fn check(&self, shader: &str, got: &State, expected: &Expected, tolerance: impl Fn(&str) -> f32) {
        let mut worst: BTreeMap<&str, f32> = BTreeMap::new();
        if let Err(difference) = self.compare(got, expected, tolerance, &mut worst) {
            panic!("{shader}: {difference}");
        }
        note(shader, &worst);
    }

    /// The first difference, or the largest errors by array in units of the tolerance.
    fn compare(
        &self,
        got: &State,
        expected: &Expected,
        tolerance: impl Fn(&str) -> f32,
        worst: &mut BTreeMap<&'static str, f32>,
    ) -> Result<(), String> {
        let names = arrays(&self.batch);
        let stride = self.batch.values as usize;
        for (i, (a, b)) in got.values.iter().zip(&expected.state.values).enumerate() {
            if a.to_bits() == b.to_bits() {
                continue;
            }
            let (slot, at) = (i / stride, (i % stride) as u32);
            let (start, name) = names[names.partition_point(|n| n.0 <= at) - 1];
            let size = expected.sizes.get(&i).copied().unwrap_or(1.);
            self.differs(slot, name, (at - start) as usize, *a, *b, size, tolerance(name), worst)?;
        }
        let of_slot = |len: u32| move |i: usize| (i / len as usize, i % len as usize);
        let jacobian = (&got.jacobian, &expected.state.jacobian, "jacobian", 2 * self.batch.jacobian);
        let factor = (&got.factor, &expected.state.factor, "factor", self.batch.factor);
        for (got, expected, name, len) in [jacobian, factor] {
            for (i, (a, b)) in got.iter().zip(expected).enumerate() {
                if a.to_bits() != b.to_bits() {
                    let (slot, at) = of_slot(len)(i);
                    self.differs(slot, name, at, *a, *b, 1., tolerance(name), worst)?;
                }
            }
        }
        for (slot, (a, b)) in got.progress.iter().zip(&expected.state.progress).enumerate() {
            let (a, b): (&[u32], &[u32]) = (bytemuck::cast_slice(bytemuck::bytes_of(a)), bytemuck::cast_slice(bytemuck::bytes_of(b)));
            for (k, name) in PROGRESS.into_iter().enumerate() {
                if k < 7 && a[k] != b[k] {
                    return Err(format!("slot {slot}, {}: {name} is {}, its twin has {}", self.slots[slot].candidate.name, a[k], b[k]));
                }
                if a[k] != b[k] {
                    // Relative to the value alone.
                    self.differs(slot, name, 0, f32::from_bits(a[k]), f32::from_bits(b[k]), 0., tolerance(name), worst)?;
                }
            }
        }
        Ok(())
    }

    /// Whether two numbers with different bits differ by too much.
    #[allow(clippy::too_many_arguments, reason = "what its message says")]
    fn differs(
        &self,
        slot: usize,
        name: &'static str,
        index: usize,
        got: f32,
        expected: f32,
        size: f32,
        tolerance: f32,
        worst: &mut BTreeMap<&'static str, f32>,
    ) -> Result<(), String> {
        let unit = f32::EPSILON * expected.abs().max(size);
        let error = (f64::from(got) - f64::from(expected)).abs() / f64::from(unit);
        // Poison is no error that is small enough; zeros of both signs are the same number.
        if error <= f64::from(tolerance) || got == expected {
            let worst = worst.entry(name).or_default();
            *worst = worst.max(error as f32);
            return Ok(());
        }
        let poison = |v: f32| if v.to_bits() == POISON.to_bits() { " (untouched)" } else { "" };
        Err(format!(
            "slot {slot}, {}: {name}[{index}] is {got:e}{}, its twin has {expected:e}{}: {} ulp, {error:.1} units of {size:e}, {tolerance} are allowed",
            self.slots[slot].candidate.name,
            poison(got),
            poison(expected),
            ulps(got, expected),
        ))
    }

    /// Lists of slots: of each size the last ones, in reversed order, so that the first ones are left out.
    fn lists(&self) -> Vec<Vec<u32>> {
        let n = self.slots.len();
        let reversed = |count: usize| (n - count..n).rev().map(|s| s as u32).collect();
        if n == CAPACITY { COUNTS.map(reversed).into() } else { vec![reversed(n), reversed(n - 1)] }
    }
}

/// Floats between two numbers.
fn ulps(a: f32, b: f32) -> u64 {
    let order = |v: f32| {
        let bits = i64::from(v.to_bits() & 0x7fff_ffff);
        if v.is_sign_negative() { -bits } else { bits }
    };
    order(a).abs_diff(order(b))
}

/// Keeps the largest errors of each shader and prints those that grew; `cargo test -- --nocapture` shows them.
fn note(shader: &str, worst: &BTreeMap<&str, f32>) {
    static WORST: Mutex<BTreeMap<String, f32>> = Mutex::new(BTreeMap::new());
    let mut all = WORST.lock().unwrap();
    for (name, error) in worst {
        let entry = all.entry(format!("{shader}: {name}")).or_default();
        if *error > *entry {
            *entry = *error;
            eprintln!("worst so far: {shader}: {name} {error:.2} units");
        }
    }
}

fn fill(state: &mut [f32], range: Range<usize>, random: &mut Random, low: f64, high: f64) {
    state[range].iter_mut().for_each(|v| *v = random.between(low, high) as f32);
}

/// Slots in every state: those that ended must stay as they are.
fn states(lab: &Lab, state: &mut State, of: &[u32]) {
    for (slot, progress) in state.progress.iter_mut().enumerate() {
        progress.state = of[slot % of.len()];
        progress.current = (slot / of.len()) as u32 % 2;
        progress.edge_radius = if slot % 3 == 0 { 0. } else { EDGE_RADIUS as f32 };
        progress.attempts = slot as u32 % 3;
        progress.recorded = slot as u32;
    }
    assert_eq!(state.progress.len(), lab.slots.len());
}

// ---- Evaluation of the rows.

/// Truncates tables so that their numbers of entries lie around the workgroup size.
fn around_the_workgroup(s: usize, prepared: &mut Prepared) {
    let count = [63, 64, 65, usize::MAX][s / 2 % 4];
    let (layout, slot) = (&mut prepared.layout, &mut prepared.slot);
    layout.dynamics_instants.truncate(count);
    layout.momentum_intervals.truncate(count);
    layout.reach_instants.truncate(count);
    layout.force_nodes.truncate(count);
    layout.swing_nodes.truncate(count);
    layout.strides.truncate(count);
    slot.dynamics = layout.dynamics_instants.len() as u32;
    slot.momentum = layout.momentum_intervals.len() as u32;
    slot.reach = layout.reach_instants.len() as u32;
    slot.force_nodes = layout.force_nodes.len() as u32;
    slot.swing_nodes = layout.swing_nodes.len() as u32;
    slot.strides = layout.strides.len() as u32;
    slot.footholds = slot.footholds.min(count as u32);
}

/// Runs an evaluation shader on small candidates and on long ones, and its twin.
///
/// * `counted` - entries that the shader walks
/// * `twin` - writes what it should at the trial point: slot, its layout, x, ground and deviations there, out
fn evaluation(
    shader: &'static str,
    counted: fn(&cregopt::backend::gpu::tables::Slot) -> u32,
    tolerance: f32,
    twin: impl Fn(&Lab, usize, &[f32], &Shared<f32>, &mut Expected),
) {
    let test = format!("{shader}_agrees_with_its_twin");
    let Some(device) = gpu(&test) else { return };
    let (small, long) = (candidates(), long_candidates());
    let labs = [Lab::new(&device, &small, CAPACITY, SMALL, |_, _| {}), Lab::new(&device, &long, 8, SMALL, around_the_workgroup)];
    let long_counts: BTreeSet<u32> = labs[1].slots.iter().map(|s| counted(&s.counts)).collect();
    assert!([63, 64, 65].iter().all(|n| long_counts.contains(n)), "entries of the long candidates: {long_counts:?}");
    for mut lab in labs {
        let mut before = lab.poisoned();
        states(&lab, &mut before, &[STEP, CLOSE, EXACT, SOLVED, STEP]);
        // The same for all lists: x, ground and deviations at the trial point.
        let mut shared = Vec::new();
        for (s, slot) in lab.slots.iter().enumerate() {
            let (layout, x) = (&slot.layout, &slot.candidate.x);
            let at = common::shared(layout);
            let mut at =
                Shared { ground: at.ground, deviations: vec![Deviation::default(); layout.momentum_intervals.len()], frozen: false };
            foothold::footholds(layout, x, &mut at.ground);
            let mut c = vec![0.; layout.equalities];
            momentum::momentum(layout, x, &at.ground, &mut at.deviations, false, &mut c, None);
            let trial = 1 - before.progress[s].current;
            before.values[lab.x(s, trial)].copy_from_slice(x);
            if shader != "foothold" {
                let to = lab.range(s, lab.batch.ground, 3 * at.ground.len());
                before.values[to].copy_from_slice(&flat(&at.ground));
            }
            if shader == "reach" {
                let to = lab.range(s, lab.batch.deviations, 36 * at.deviations.len());
                before.values[to].copy_from_slice(&poses(&at.deviations));
            }
            shared.push(at);
        }
        for list in lab.lists() {
            let mut expected = Expected { state: before.clone(), sizes: BTreeMap::new() };
            for &s in &list {
                let s = s as usize;
                if before.progress[s].state < ENDED {
                    twin(&lab, s, &lab.slots[s].candidate.x, &shared[s], &mut expected);
                }
            }
            let got = lab.run(shader, &list, &before);
            lab.check(shader, &got, &expected, |name| match name {
                "deviations" => DEVIATION,
                "c" | "g" | "jacobian" | "ground" => tolerance,
                _ => 0.,
            });
        }
    }
}

fn flat(ground: &[Ground<f32>]) -> Vec<f32> {
    ground.iter().flat_map(|g| [g.height, g.slope[0], g.slope[1]]).collect()
}

fn poses(deviations: &[Deviation<f32>]) -> Vec<f32> {
    deviations.iter().flat_map(|d| d.pose.into_iter().flatten()).collect()
}

/// Residuals and Jacobian of the trial point, in the state.
fn trial<'s>(lab: &Lab, s: usize, equality: bool, state: &'s mut State) -> (&'s mut [f32], &'s mut [f32]) {
    let half = 1 - state.progress[s].current;
    let residual = if equality { lab.c(s, half) } else { lab.g(s, half) };
    (&mut state.values[residual], &mut state.jacobian[lab.jacobian(s, half)])
}

#[test]
fn foothold_agrees_with_its_twin() {
    evaluation(
        "foothold",
        |slot| slot.footholds,
        ARITHMETIC,
        |lab, s, _, shared, expected| {
            let count = lab.slots[s].counts.footholds as usize;
            let ground = flat(&shared.ground[..count]);
            // Slopes of the terrains reach 17.
            let to = lab.range(s, lab.batch.ground, ground.len());
            expected.state.values[to].copy_from_slice(&ground);
        },
    );
}

#[test]
fn dynamics_agrees_with_its_twin() {
    evaluation(
        "dynamics",
        |slot| slot.dynamics,
        TRIGONOMETRY,
        |lab, s, x, shared, expected| {
            let (c, jacobian) = trial(lab, s, true, &mut expected.state);
            dynamics::dynamics(&lab.slots[s].layout, x, &shared.ground, c, Some(jacobian));
        },
    );
}

#[test]
fn momentum_agrees_with_its_twin() {
    evaluation(
        "momentum",
        |slot| slot.momentum,
        TRIGONOMETRY,
        |lab, s, x, shared, expected| {
            let layout = &lab.slots[s].layout;
            let mut deviations = vec![Deviation::default(); layout.momentum_intervals.len()];
            let (c, jacobian) = trial(lab, s, true, &mut expected.state);
            momentum::momentum(layout, x, &shared.ground, &mut deviations, false, c, Some(jacobian));
            let to = lab.range(s, lab.batch.deviations, 36 * deviations.len());
            expected.state.values[to].copy_from_slice(&poses(&deviations));
        },
    );
}

#[test]
fn reach_agrees_with_its_twin() {
    evaluation(
        "reach",
        |slot| slot.reach,
        TRIGONOMETRY,
        |lab, s, x, shared, expected| {
            let (g, jacobian) = trial(lab, s, false, &mut expected.state);
            reach::reach(&lab.slots[s].layout, x, &shared.ground, &shared.deviations, g, Some(jacobian));
        },
    );
}

#[test]
fn force_agrees_with_its_twin() {
    evaluation(
        "force",
        |slot| slot.force_nodes,
        CURVED,
        |lab, s, x, _, expected| {
            let edge_radius = expected.state.progress[s].edge_radius;
            let (g, jacobian) = trial(lab, s, false, &mut expected.state);
            force::force(&lab.slots[s].layout, x, edge_radius, g, Some(jacobian));
        },
    );
}

#[test]
fn swing_agrees_with_its_twin() {
    for counted in
        [|slot: &cregopt::backend::gpu::tables::Slot| slot.swing_nodes, |slot: &cregopt::backend::gpu::tables::Slot| slot.strides]
    {
        // Rows are in units of 0.1 m.
        evaluation("swing", counted, 8. * ARITHMETIC, |lab, s, x, shared, expected| {
            let (g, jacobian) = trial(lab, s, false, &mut expected.state);
            swing::swing(&lab.slots[s].layout, x, &shared.ground, g, Some(jacobian));
        });
    }
}

// ---- Steps of the solver. Inputs are seeded numbers of the size that they have in a solve.

/// Random slacks, multipliers and their steps.
fn barrier_state(lab: &Lab, s: usize, state: &mut State, random: &mut Random, steps: bool) {
    let batch = &lab.batch;
    for array in [batch.slack, batch.multiplier] {
        for i in lab.of_inequalities(s, array) {
            state.values[i] = (10f64).powf(random.between(-3., 0.5)) as f32;
        }
    }
    if steps {
        for array in [batch.slack_step, batch.multiplier_step] {
            fill(&mut state.values, lab.of_inequalities(s, array), random, -0.5, 0.5);
        }
    }
}

/// Slacks of a slot, as the twin has them. Steps that are poison become zero: the twin multiplies them by zero.
fn slacks(lab: &Lab, s: usize, state: &State) -> Slacks<f32> {
    let clean = |v: &f32| if v.is_nan() { 0. } else { *v };
    let of = |array| state.values[lab.of_inequalities(s, array)].iter().map(clean).collect();
    let batch = &lab.batch;
    Slacks {
        slack: of(batch.slack),
        multiplier: of(batch.multiplier),
        slack_step: of(batch.slack_step),
        multiplier_step: of(batch.multiplier_step),
    }
}

/// A Jacobian of the right structure: that at the point.
fn jacobian_at(slot: &Slot) -> Vec<f32> {
    common::rows(&slot.layout, &slot.candidate.x, 0.).jacobian
}

/// Random residuals of one half, of a size.
fn residuals(lab: &Lab, s: usize, half: u32, state: &mut State, random: &mut Random, size: f64) {
    fill(&mut state.values, lab.c(s, half), random, -size, size);
    fill(&mut state.values, lab.g(s, half), random, -2. * size, size);
}

/// Runs a shader of the solver.
///
/// * `prepare` - writes its inputs
/// * `twin` - what it should do, given what it did: later stages are compared on the numbers of the earlier ones
fn solver_step(
    shader: &'static str,
    of_states: &[u32],
    tweak: impl Fn(usize, &mut Prepared),
    prepare: impl Fn(&Lab, usize, &mut State, &mut Random),
    twin: impl Fn(&Lab, usize, &State, &mut Expected),
    tolerance: impl Fn(&str) -> f32,
) {
    let test = format!("{shader}_agrees_with_its_twin");
    let Some(device) = gpu(&test) else { return };
    let candidates = candidates();
    let mut lab = Lab::new(&device, &candidates, CAPACITY, SMALL, tweak);
    let mut before = lab.poisoned();
    states(&lab, &mut before, of_states);
    let mut random = Random::new(21);
    for s in 0..lab.slots.len() {
        prepare(&lab, s, &mut before, &mut random);
    }
    for list in lab.lists() {
        let got = lab.run(shader, &list, &before);
        let mut expected = Expected { state: before.clone(), sizes: BTreeMap::new() };
        for &s in &list {
            twin(&lab, s as usize, &got, &mut expected);
        }
        lab.check(shader, &got, &expected, &tolerance);
    }
}

#[test]
fn start_agrees_with_its_twin() {
    solver_step(
        "start",
        &[STEP, SOLVED, CLOSE],
        |_, _| {},
        |lab, s, state, random| {
            // The initial point is a trial point.
            let half = 1 - state.progress[s].current;
            state.progress[s].mu = random.between(1e-4, 1.) as f32;
            let all = lab.range(s, lab.batch.x + half * lab.batch.x_half, lab.batch.x_half as usize);
            fill(&mut state.values, all, random, -5., 5.);
            fill(&mut state.values, lab.g(s, half), random, -2., 1.);
            let to = lab.jacobian(s, half);
            state.jacobian[to].copy_from_slice(&jacobian_at(&lab.slots[s]));
        },
        |lab, s, _, expected| {
            let (layout, state) = (&lab.slots[s].layout, &mut expected.state);
            let half = 1 - state.progress[s].current;
            let mut scaling = vec![f32::NAN; layout.variables];
            start::column_scaling(layout, &state.jacobian[lab.jacobian(s, half)], &mut scaling);
            state.values[lab.of_variables(s, lab.batch.scaling)].copy_from_slice(&scaling);
            let mut slacks = slacks(lab, s, state);
            start::start_slacks(&state.values[lab.g(s, half)], state.progress[s].mu, &mut slacks);
            state.values[lab.of_inequalities(s, lab.batch.slack)].copy_from_slice(&slacks.slack);
            state.values[lab.of_inequalities(s, lab.batch.multiplier)].copy_from_slice(&slacks.multiplier);
            let [from, to] = [half, 1 - half].map(|half| lab.range(s, lab.batch.x + half * lab.batch.x_half, lab.batch.x_half as usize));
            state.values.copy_within(from, to.start);
            state.progress[s].current = half;
            state.progress[s].state = STEP;
        },
        |name| match name {
            "scaling" => SUM,
            "slack" | "multiplier" => ARITHMETIC,
            _ => 0.,
        },
    );
}

/// Sizes of the terms of a row's value in a barrier step.
fn row_sizes(lab: &Lab, s: usize, expected: &mut Expected, g: &[f32], slacks: &Slacks<f32>, aim: Aim<f32>) {
    let layout = &lab.slots[s].layout;
    let size = |i: usize| {
        let (s, z) = (slacks.slack[i], slacks.multiplier[i]);
        let product = aim.mu + (aim.correction * slacks.slack_step[i] * slacks.multiplier_step[i]).abs();
        z + (g[i].abs() + z + product / z) / (s / z + 1.)
    };
    for element in layout.elements.iter().filter(|e| e.place.row as usize >= layout.equalities) {
        for r in 0..element.rows {
            let upper = (element.place.inequality + r) as usize;
            let lower = if r < element.pairs { size(upper + element.rows as usize) } else { 0. };
            let at = lab.of_rows(s, lab.batch.value).start + (element.place.row + r) as usize;
            expected.sizes.insert(at, size(upper) + lower);
        }
    }
}

#[test]
fn rows_agrees_with_its_twin() {
    solver_step(
        "rows",
        &[STEP, CLOSE, STEP, SOLVED, CLOSE, EXACT],
        |_, _| {},
        |lab, s, state, random| {
            let progress = &mut state.progress[s];
            let half = progress.current;
            let attempts = progress.attempts;
            *progress = Progress {
                state: progress.state,
                current: half,
                attempts,
                factorisations: s as u32,
                recorded: s as u32,
                // Its window is never full; the stall rule has a test of its own.
                stall_from: s as u32,
                iterations: s as u32 / 2,
                infeasibility: if attempts == 0 { POISON } else { 3. },
                mu: random.between(1e-3, 0.1) as f32,
                pull: random.between(0.01, 0.1) as f32,
                eps: 3e-4,
                closing_eps: 7e-5,
                // Refused attempts close, and the first of the rest.
                ..Progress::first(&Limits::new(&lab.settings), progress.edge_radius)
            };
            if progress.state == EXACT {
                // Rows become exact only before a round.
                progress.attempts = 0;
            }
            // A few are near the end: most of their rows hold.
            let near = s % 5 == 0;
            residuals(lab, s, half, state, random, if near { 1e-6 } else { 1. });
            if near {
                let quiet = lab.g(s, half);
                state.values[quiet].iter_mut().for_each(|g| *g = if *g > 0. { *g } else { *g - 0.1 });
            }
            barrier_state(lab, s, state, random, false);
            fill(&mut state.values, lab.of_variables(s, lab.batch.scaling), random, 0.01, 30.);
            for array in [lab.batch.pull, lab.batch.initial] {
                fill(&mut state.values, lab.of_variables(s, array), random, 0., 1.);
            }
            fill(&mut state.values, lab.x(s, half), random, -2., 2.);
        },
        |lab, s, _, expected| {
            let (batch, layout) = (&lab.batch, &lab.slots[s].layout);
            let state = &mut expected.state;
            let mut progress = state.progress[s];
            if progress.ended() {
                return;
            }
            let half = progress.current;
            let (c, g) = (state.values[lab.c(s, half)].to_vec(), state.values[lab.g(s, half)].to_vec());
            if progress.attempts == 0 {
                let f = judge::infeasibility(&c, &g);
                let ring = lab.range(s, batch.history, 0).start + progress.recorded as usize % lab.settings.stall.window;
                control::begin(&mut progress, &Limits::new(&lab.settings), f, POISON, f < lab.settings.tolerance as f32);
                if progress.state != EXACT {
                    state.values[ring] = f;
                }
            }
            progress.factorisations += u32::from(progress.state <= CLOSE);
            state.progress[s] = progress;
            if progress.state == EXACT {
                let (from, to) = (lab.of_variables(s, batch.x + half * batch.x_half), lab.x(s, 1 - half).start);
                state.values.copy_within(from, to);
            }
            if progress.state > CLOSE {
                return;
            }
            let slacks = slacks(lab, s, state);
            let aim = Aim { mu: 0., correction: 0. };
            let (mut weight, mut value) = (vec![f32::NAN; layout.rows], vec![f32::NAN; layout.rows]);
            if progress.state == CLOSE {
                rows::closing_rows(layout, &c, &g, &mut weight, &mut value);
            } else {
                rows::barrier_rows(layout, &c, &g, &slacks, aim, &mut weight, &mut value);
            }
            let of = |array| state.values[lab.of_variables(s, array)].to_vec();
            let (scaling, pull, x, initial) = (of(batch.scaling), of(batch.pull), of(batch.x + half * batch.x_half), of(batch.initial));
            let (mut diagonal, mut gradient) = (vec![f32::NAN; layout.variables], vec![f32::NAN; layout.variables]);
            rows::variable_terms(&scaling, progress.proximal(), &pull, progress.pull, &x, &initial, &mut diagonal, &mut gradient);
            state.values[lab.of_rows(s, batch.weight)].copy_from_slice(&weight);
            state.values[lab.of_rows(s, batch.value)].copy_from_slice(&value);
            state.values[lab.of_variables(s, batch.diagonal)].copy_from_slice(&diagonal);
            state.values[lab.of_variables(s, batch.gradient)].copy_from_slice(&gradient);
            if progress.state == STEP {
                row_sizes(lab, s, expected, &g, &slacks, aim);
            }
        },
        |name| match name {
            "infeasibility" | "history" | "closing_from" => SUM,
            "weight" | "value" | "diagonal" | "gradient" | "pull" => ARITHMETIC,
            _ => 0.,
        },
    );
}

#[test]
fn correct_agrees_with_its_twin() {
    solver_step(
        "correct",
        &[STEP, CLOSE, STEP, EXACT, STEP, SOLVED],
        |_, _| {},
        |lab, s, state, random| {
            let half = state.progress[s].current;
            residuals(lab, s, half, state, random, 1.);
            let by = lab.of_inequalities(s, lab.batch.g_change);
            // Small changes leave the full step.
            let size = if s % 4 == 0 { 1e-3 } else { 1. };
            fill(&mut state.values, by, random, -size, size);
            barrier_state(lab, s, state, random, false);
            let flag = lab.flags(s);
            state.values[flag] = f32::from(s % 7 == 3);
        },
        |lab, s, got, expected| {
            let (batch, layout) = (&lab.batch, &lab.slots[s].layout);
            let state = &mut expected.state;
            let half = state.progress[s].current;
            if state.progress[s].state != STEP || state.values[lab.flags(s)] != 0. {
                return;
            }
            let (c, g) = (state.values[lab.c(s, half)].to_vec(), state.values[lab.g(s, half)].to_vec());
            steps_of_slacks(lab, s, expected, Aim { mu: 0., correction: 0. });
            // From its own steps on.
            let own = slacks(lab, s, got);
            let length = length_of(&own);
            let reach = got.progress[s].length;
            let (all, share) = (mean_product(&own, 0.), mean_product(&own, reach) / mean_product(&own, 0.));
            let state = &mut expected.state;
            state.progress[s].length = length;
            state.progress[s].mu = (all * share.clamp(0., 1.) * share.clamp(0., 1.)).max(BARRIER_FLOOR as f32);
            let aim = Aim { mu: got.progress[s].mu, correction: reach };
            let (mut weight, mut value) = (vec![f32::NAN; layout.rows], vec![f32::NAN; layout.rows]);
            rows::barrier_rows(layout, &c, &g, &own, aim, &mut weight, &mut value);
            state.values[lab.of_rows(s, batch.weight)].copy_from_slice(&weight);
            state.values[lab.of_rows(s, batch.value)].copy_from_slice(&value);
            row_sizes(lab, s, expected, &g, &own, aim);
        },
        |name| match name {
            "mu" => SUM,
            "weight" | "value" | "slack_step" | "multiplier_step" | "length" => ARITHMETIC,
            _ => 0.,
        },
    );
}

/// Steps of slacks and multipliers into their place, with the sizes of their terms.
fn steps_of_slacks(lab: &Lab, s: usize, expected: &mut Expected, aim: Aim<f32>) {
    let (batch, state) = (&lab.batch, &mut expected.state);
    let mut steps = slacks(lab, s, state);
    let g = state.values[lab.g(s, state.progress[s].current)].to_vec();
    let by = state.values[lab.of_inequalities(s, batch.g_change)].to_vec();
    let count = lab.slots[s].counts.inequalities as usize;
    let cut = |v: &mut Vec<f32>| v.truncate(count);
    let Slacks { slack, multiplier, slack_step, multiplier_step } = &mut steps;
    [slack, multiplier, slack_step, multiplier_step].into_iter().for_each(cut);
    let (old_ds, old_dz) = (steps.slack_step.clone(), steps.multiplier_step.clone());
    slack_steps(&g[..count], &by[..count], aim, &mut steps);
    let [ds_at, dz_at] = [batch.slack_step, batch.multiplier_step].map(|array| lab.of_inequalities(s, array).start);
    for i in 0..count {
        let (s, z) = (steps.slack[i], steps.multiplier[i]);
        let centre = (aim.mu + (aim.correction * old_ds[i] * old_dz[i]).abs()) / z;
        let dz = (by[i].abs() + g[i].abs() + z + centre) / (s / z + 1.);
        state.values[ds_at + i] = steps.slack_step[i];
        state.values[dz_at + i] = steps.multiplier_step[i];
        expected.sizes.insert(dz_at + i, dz);
        expected.sizes.insert(ds_at + i, centre + s + s / z * dz);
    }
}

/// The largest step that keeps a twentieth of every slack and multiplier, by their steps.
fn length_of(slacks: &Slacks<f32>) -> f32 {
    let by = |value: &[f32], step: &[f32]| value.iter().zip(step).fold(0f32, |steepest, (v, by)| steepest.max(-by / v));
    let steepest = by(&slacks.slack, &slacks.slack_step).max(by(&slacks.multiplier, &slacks.multiplier_step));
    if steepest * (1. / 0.95) > 1. { 0.95 / steepest } else { 1. }
}

/// Counts of variables and rows around the workgroup size. Only loops over them may depend on that.
fn truncated_counts(s: usize, prepared: &mut Prepared) {
    let (layout, slot) = (&mut prepared.layout, &mut prepared.slot);
    let cut = |n: u32, k: usize| n.min([63, 64, 65, 1, u32::MAX][(s + k) % 5]);
    slot.variables = cut(slot.variables, 0);
    slot.inequalities = cut(slot.inequalities, 1);
    slot.equalities = cut(slot.equalities, 2);
    layout.variables = slot.variables as usize;
    layout.inequalities = slot.inequalities as usize;
    layout.equalities = slot.equalities as usize;
}

#[test]
fn advance_agrees_with_its_twin() {
    solver_step(
        "advance",
        &[STEP, CLOSE, STEP, EXACT, STEP, SOLVED],
        truncated_counts,
        |lab, s, state, random| {
            let half = state.progress[s].current;
            state.progress[s].mu = random.between(1e-3, 0.1) as f32;
            state.progress[s].length = random.between(0.1, 1.) as f32;
            fill(&mut state.values, lab.of_variables(s, lab.batch.x + half * lab.batch.x_half), random, -5., 5.);
            fill(&mut state.values, lab.of_variables(s, lab.batch.direction), random, -1., 1.);
            fill(&mut state.values, lab.g(s, half), random, -2., 1.);
            let size = if s % 4 == 0 { 1e-3 } else { 1. };
            fill(&mut state.values, lab.of_inequalities(s, lab.batch.g_change), random, -size, size);
            barrier_state(lab, s, state, random, true);
        },
        |lab, s, got, expected| {
            let progress = expected.state.progress[s];
            if progress.state > CLOSE {
                return;
            }
            let mut length = 1.;
            if progress.state == STEP {
                steps_of_slacks(lab, s, expected, Aim { mu: progress.mu, correction: progress.length });
                length = length_of(&slacks(lab, s, got));
            }
            let (batch, state) = (&lab.batch, &mut expected.state);
            state.progress[s].length = length;
            let [x, to] = [progress.current, 1 - progress.current].map(|half| lab.of_variables(s, batch.x + half * batch.x_half));
            let (x, d) = (state.values[x].to_vec(), state.values[lab.of_variables(s, batch.direction)].to_vec());
            advance::advance(&x, got.progress[s].length, &d, &mut state.values[to]);
        },
        |name| match name {
            "slack_step" | "multiplier_step" | "length" | "x" => ARITHMETIC,
            _ => 0.,
        },
    );
}

#[test]
fn product_agrees_with_its_twin() {
    solver_step(
        "product",
        &[STEP, CLOSE, EXACT, SOLVED],
        |s, prepared| {
            // Elements that are not there have no product.
            prepared.slot.elements = prepared.slot.elements.min([63, 64, 65, u32::MAX][s / 4 % 4]);
        },
        |lab, s, state, random| {
            let to = lab.jacobian(s, state.progress[s].current);
            state.jacobian[to].copy_from_slice(&jacobian_at(&lab.slots[s]));
            fill(&mut state.values, lab.of_variables(s, lab.batch.direction), random, -1., 1.);
        },
        |lab, s, _, expected| {
            let (batch, state) = (&lab.batch, &mut expected.state);
            if state.progress[s].state > CLOSE {
                return;
            }
            let mut layout = lab.slots[s].layout.clone();
            layout.elements.truncate(lab.slots[s].counts.elements as usize);
            let jacobian = state.jacobian[lab.jacobian(s, state.progress[s].current)].to_vec();
            let d = state.values[lab.of_variables(s, batch.direction)].to_vec();
            let times = |jacobian: &[f32], d: &[f32]| {
                let (mut c, mut g) = (vec![POISON; layout.equalities], vec![POISON; layout.inequalities]);
                product::jacobian_times(&layout, jacobian, d, &mut vec![0.; layout.widest], &mut c, &mut g);
                (c, g)
            };
            let (c, g) = times(&jacobian, &d);
            let size = |v: &[f32]| v.iter().map(|v| v.abs()).collect::<Vec<_>>();
            let (c_size, g_size) = times(&size(&jacobian), &size(&d));
            let [c_at, g_at] = [lab.of_equalities(s, batch.c_change), lab.of_inequalities(s, batch.g_change)];
            expected.sizes.extend(c_at.clone().zip(c_size));
            expected.sizes.extend(g_at.clone().zip(g_size.iter().map(|v| v.abs())));
            state.values[c_at].copy_from_slice(&c);
            state.values[g_at].copy_from_slice(&g);
        },
        |name| if ["c_change", "g_change"].contains(&name) { SUM } else { 0. },
    );
}

#[test]
fn transposed_agrees_with_its_twin() {
    solver_step(
        "transposed",
        &[STEP, CLOSE, STEP, EXACT, SOLVED],
        |_, _| {},
        |lab, s, state, random| {
            let to = lab.jacobian(s, state.progress[s].current);
            state.jacobian[to].copy_from_slice(&jacobian_at(&lab.slots[s]));
            fill(&mut state.values, lab.of_rows(s, lab.batch.value), random, -1., 1.);
            fill(&mut state.values, lab.of_variables(s, lab.batch.gradient), random, -1., 1.);
        },
        |lab, s, _, expected| {
            let (batch, layout, state) = (&lab.batch, &lab.slots[s].layout, &mut expected.state);
            if state.progress[s].state != STEP {
                return;
            }
            let jacobian = state.jacobian[lab.jacobian(s, state.progress[s].current)].to_vec();
            let (v, u) = (&state.values[lab.of_rows(s, batch.value)], &state.values[lab.of_variables(s, batch.gradient)]);
            let times = |jacobian: &[f32], v: &[f32], u: &[f32]| {
                let mut out = vec![f32::NAN; layout.variables];
                transposed::transposed_times(layout, jacobian, v, &mut vec![0.; layout.widest], &mut out);
                advance::add(&mut out, u);
                out
            };
            let size = |v: &[f32]| v.iter().map(|v| v.abs()).collect::<Vec<_>>();
            let (sums, sizes) = (times(&jacobian, v, u), times(&size(&jacobian), &size(v), &size(u)));
            let at = lab.of_variables(s, batch.right_hand_side);
            expected.sizes.extend(at.clone().zip(sizes));
            state.values[at].copy_from_slice(&sums);
        },
        |name| if name == "right_hand_side" { SUM } else { 0. },
    );
}

// ---- Decisions.

/// Progress before a verdict, with every member a number of its own.
fn before_verdict(s: usize, progress: Progress<f32>, random: &mut Random) -> Progress<f32> {
    Progress {
        attempts: s as u32 % 6,
        iterations: 3 * s as u32,
        factorisations: 4 * s as u32,
        recorded: 5 * s as u32,
        stall_from: s as u32,
        mu: random.between(1e-3, 0.1) as f32,
        pull: [0., 0.05][s % 2],
        // Near the floor a quarter would be below it.
        eps: [1e-3, 3e-5][s / 2 % 2],
        closing_eps: [2e-5, 4e-3][s / 3 % 2],
        closing_below: 1e-4,
        closing_from: 7e-4,
        length: random.between(0.2, 1.) as f32,
        ..progress
    }
}

/// A trial point that keeps to the linear model but for some noise, equalities first.
struct Trial {
    noise: Vec<f64>,
}

impl Trial {
    /// Draws all that a verdict depends on.
    fn draw(lab: &Lab, s: usize, state: &mut State, random: &mut Random) -> Trial {
        let (batch, progress) = (&lab.batch, state.progress[s]);
        residuals(lab, s, progress.current, state, random, 1.);
        // Changes lead down, or anywhere.
        let down = random.between(-0.2, 1.);
        for (at, by) in lab.changes(s, progress.current) {
            for (at, by) in at.zip(by) {
                state.values[by] = (-down * f64::from(state.values[at]) + random.between(-0.1, 0.1)) as f32;
            }
        }
        for half in [0, 1] {
            fill(&mut state.values, lab.of_variables(s, batch.x + half * batch.x_half), random, -1., 1.);
        }
        fill(&mut state.values, lab.of_variables(s, batch.initial), random, -1., 1.);
        fill(&mut state.values, lab.of_variables(s, batch.pull), random, 0., 1.);
        barrier_state(lab, s, state, random, true);
        let layout = &lab.slots[s].layout;
        let trial = Trial { noise: (0..layout.equalities + layout.inequalities).map(|_| random.between(-1., 1.)).collect() };
        trial.put(lab, s, state, 10f64.powf(random.between(-3., 0.3)));
        trial
    }

    /// Writes the trial point that misses the linear model by so much.
    fn put(&self, lab: &Lab, s: usize, state: &mut State, miss: f64) {
        let progress = state.progress[s];
        let mut noise = self.noise.iter();
        let trial = lab.changes(s, 1 - progress.current).map(|(to, _)| to);
        for ((at, by), to) in lab.changes(s, progress.current).into_iter().zip(trial) {
            for ((at, by), to) in at.zip(by).zip(to) {
                let linear = f64::from(state.values[at]) + f64::from(progress.length) * f64::from(state.values[by]);
                state.values[to] = (linear + miss * noise.next().unwrap()) as f32;
            }
        }
    }

    /// Misses by so much that the merit falls by a share of what was predicted; by much where there is no such point.
    fn aim(&self, lab: &Lab, s: usize, state: &mut State, share: f64) {
        let mut beyond = |miss: f64| {
            self.put(lab, s, state, miss);
            let [fall, predicted, ..] = falls(lab, s, state);
            fall > share * predicted.abs()
        };
        let [mut low, mut high] = [0., 4.];
        if !beyond(low) || beyond(high) {
            return;
        }
        for _ in 0..12 {
            let middle = 0.5 * (low + high);
            *(if beyond(middle) { &mut low } else { &mut high }) = middle;
        }
        self.put(lab, s, state, low);
    }
}

/// Falls as in `Solver::round`: of the merit and of its linear model, the distance between both, and what the pull has in them. In f64, so as
/// to know how clear a verdict is.
fn falls(lab: &Lab, s: usize, state: &State) -> [f64; 4] {
    let (batch, progress) = (&lab.batch, state.progress[s]);
    let (half, to) = (progress.current, 1 - progress.current);
    let of = |range: Range<usize>| state.values[range].iter().map(|v| f64::from(*v)).collect::<Vec<f64>>();
    let (c, g, c_to, g_to) = (of(lab.c(s, half)), of(lab.g(s, half)), of(lab.c(s, to)), of(lab.g(s, to)));
    let length = f64::from(progress.length);
    let linear = |at: &[f64], by: &[f64]| at.iter().zip(by).map(|(at, by)| at + length * by).collect::<Vec<f64>>();
    let c_linear = linear(&c, &of(lab.of_equalities(s, batch.c_change)));
    let g_linear = linear(&g, &of(lab.of_inequalities(s, batch.g_change)));
    let falls = |c_to: &[f64], g_to: &[f64]| {
        if progress.state == CLOSE {
            judge::infeasibility_fall(&c, &g, c_to, g_to)
        } else {
            judge::merit_fall(&c, &g, c_to, g_to, f64::from(progress.mu))
        }
    };
    let x = |half: u32| of(lab.of_variables(s, batch.x + half * batch.x_half));
    let (pull, initial) = (of(lab.of_variables(s, batch.pull)), of(lab.of_variables(s, batch.initial)));
    let pulled = f64::from(progress.pull) * judge::pull_fall(&pull, &x(half), &x(to), &initial);
    let gap = judge::nonlinearity(&c_to, &c_linear, &g_to, &g_linear);
    [falls(&c_to, &g_to) + pulled, falls(&c_linear, &g_linear) + pulled, gap, pulled]
}

#[test]
fn judge_agrees_with_its_twin() {
    // Falls and their prediction are sums in another order: where a decision hangs on their last digits there is none to compare. By how
    // much the ratios must be clear of a limit.
    const CLEAR: f64 = 1e-3;
    let Some(device) = gpu("judge_agrees_with_its_twin") else { return };
    let candidates = candidates();
    let mut lab = Lab::new(&device, &candidates, CAPACITY, SMALL, truncated_counts);
    let (batch, limits) = (lab.batch, Limits::<f32>::new(&lab.settings));
    let mut outcomes: BTreeMap<&str, usize> = BTreeMap::new();
    for seed in 0..3 {
        let mut random = Random::new(31 + seed);
        let mut before = lab.poisoned();
        states(&lab, &mut before, &[STEP, CLOSE, STEP, EXACT, CLOSE, STEP, SOLVED]);
        let mut verdicts = Vec::new();
        for s in 0..lab.slots.len() {
            let state = before.progress[s].state;
            let failed = s % 9 == 4;
            let mut verdict = before.progress[s];
            // Until it is clear.
            loop {
                if state >= ENDED {
                    break;
                }
                let rounds = before.progress[s];
                before.progress[s] = before_verdict(s + seed as usize, Progress { infeasibility: 1., ..rounds }, &mut random);
                if s % 4 == 3 {
                    // Large enough that logarithms of slacks decide.
                    before.progress[s].mu *= 30.;
                }
                let flag = lab.flags(s);
                before.values[flag] = f32::from(failed);
                let trial = Trial::draw(&lab, s, &mut before, &mut random);
                verdict = before.progress[s];
                if failed && state <= CLOSE {
                    control::refuse(&mut verdict);
                    *outcomes.entry("failed").or_default() += 1;
                    break;
                }
                if state == EXACT {
                    control::renew(&mut verdict);
                    *outcomes.entry("exact").or_default() += 1;
                    break;
                }
                // Close to a limit, on one side or the other, or anywhere.
                let side = [0.95, 1.05][random.index(0..=1)];
                match random.index(0..=5) {
                    0 => trial.aim(&lab, s, &mut before, 0.25 * side),
                    1 => trial.aim(&lab, s, &mut before, 0.7 * side),
                    2 => trial.aim(&lab, s, &mut before, 0.05 * (side - 1.)),
                    3 => {
                        trial.aim(&lab, s, &mut before, -0.1);
                        let gap = falls(&lab, s, &before)[2];
                        before.progress[s].infeasibility = (gap / (0.3 * 0.05) * side) as f32;
                    }
                    _ => {}
                }
                verdict = before.progress[s];
                let [fall, predicted, gap, pulled] = falls(&lab, s, &before);
                let wide = Progress { state, infeasibility: f64::from(verdict.infeasibility), ..Progress::<f64>::default() };
                let model = 0.3 * predicted.max(0.05 * wide.infeasibility);
                let size = fall.abs() + predicted.abs() + gap + pulled.abs();
                let near = |a: f64, b: f64| (a - b).abs() <= CLEAR * size;
                if [0., 0.25, 0.7].iter().any(|limit| near(fall, limit * predicted)) || near(predicted, 0.) || near(gap, model) {
                    continue;
                }
                if control::acceptable(&wide, fall, predicted, gap) {
                    let ratio = if predicted > 0. { fall / predicted } else { 0. };
                    control::accept(&mut verdict, &limits, ratio as f32);
                    let why = ["taken at ratios below 0.25", "between", "above 0.7"][usize::from(ratio > 0.25) + usize::from(ratio > 0.7)];
                    *outcomes.entry(why).or_default() += 1;
                    if fall < 0. {
                        *outcomes.entry("taken near the linear model").or_default() += 1;
                    }
                } else {
                    control::refuse(&mut verdict);
                    *outcomes.entry(if verdict.attempts == 0 { "given up" } else { "refused" }).or_default() += 1;
                }
                break;
            }
            verdicts.push((verdict, failed));
        }
        for list in lab.lists() {
            let got = lab.run("judge", &list, &before);
            let mut expected = Expected { state: before.clone(), sizes: BTreeMap::new() };
            for &s in &list {
                let s = s as usize;
                let (verdict, failed) = verdicts[s];
                let state = &mut expected.state;
                let progress = state.progress[s];
                let taken = progress.state == STEP && !failed && verdict.current != progress.current;
                state.progress[s] = verdict;
                if taken {
                    let mut slacks = slacks(&lab, s, state);
                    judge::update_slacks(&mut slacks, progress.length);
                    for (array, values) in [(batch.slack, &slacks.slack), (batch.multiplier, &slacks.multiplier)] {
                        let at = lab.of_inequalities(s, array);
                        state.values[at].copy_from_slice(values);
                    }
                }
            }
            lab.check("judge", &got, &expected, |name| match name {
                "slack" | "multiplier" | "eps" | "closing_eps" | "closing_below" => ARITHMETIC,
                _ => 0.,
            });
        }
    }
    eprintln!("verdicts: {outcomes:?}");
    for what in
        ["failed", "exact", "taken at ratios below 0.25", "between", "above 0.7", "taken near the linear model", "refused", "given up"]
    {
        assert!(outcomes.get(what).is_some_and(|n| *n > 2), "no verdict {what:?} among {outcomes:?}");
    }
}

#[test]
fn rows_begins_rounds_as_its_twin_does() {
    let Some(device) = gpu("rows_begins_rounds_as_its_twin_does") else { return };
    let candidates = candidates();
    let mut lab = Lab::new(&device, &candidates, CAPACITY, SMALL, |_, _| {});
    let (batch, limits) = (lab.batch, Limits::<f32>::new(&lab.settings));
    let window = lab.settings.stall.window;
    let tolerance = lab.settings.tolerance as f32;
    let mut random = Random::new(41);
    let mut before = lab.poisoned();
    let n = lab.slots.len();
    // Infeasibilities, newest last, as the twin keeps them.
    let mut histories: Vec<Vec<f32>> = vec![Vec::new(); n];
    for s in 0..n {
        for half in [0, 1] {
            let (c, g) = (lab.c(s, half), lab.g(s, half));
            before.values[c].fill(0.);
            before.values[g].fill(-1.);
            let x = lab.x(s, half);
            fill(&mut before.values, x, &mut random, -1., 1.);
        }
        barrier_state(&lab, s, &mut before, &mut random, false);
        for array in [batch.scaling, batch.pull, batch.initial] {
            fill(&mut before.values, lab.of_variables(s, array), &mut random, 0., 1.);
        }
        before.progress[s] =
            Progress { current: s as u32 % 2, ..Progress::first(&limits, if s % 3 == 0 { 0. } else { EDGE_RADIUS as f32 }) };
    }
    // How fast each falls a round; some rest.
    let rates: Vec<f64> = (0..n).map(|_| [1., 0.98, 0.9, 0.7, 0.4, 0.09, 1.05][random.index(0..=6)]).collect();
    let list: Vec<u32> = (0..n as u32 - 3).rev().collect();
    let mut seen: BTreeMap<u32, usize> = BTreeMap::new();
    for round in 0..40 {
        let mut expected = Expected { state: before.clone(), sizes: BTreeMap::new() };
        for &s in &list {
            let s = s as usize;
            let progress = before.progress[s];
            let last = histories[s].last().copied().map_or(10f64.powf(random.between(-1., 2.)), f64::from);
            // Now and then a limit, hit exactly or nearly, or no number; more often where it matters.
            let special = [limits.closing, tolerance, 0.1 * progress.closing_from, progress.closing_below];
            let special = if progress.state == CLOSE { special[random.index(1..=3)] } else { special[random.index(0..=3)] };
            let f = match random.index(if progress.state == CLOSE { 0..=5 } else { 0..=11 }) {
                0 => special,
                1 => special * [0.999999, 1.000001, 0.5][random.index(0..=2)],
                2 if round > 20 => [f32::NAN, f32::INFINITY, 1e-9][random.index(0..=2)],
                _ => (last * rates[s]) as f32,
            };
            // Two residuals whose sum is the same in any order, fused or not: the second, which another invocation adds, makes up for the
            // rounding of the first.
            let mut c = (2. * f).sqrt();
            if c * c > 2. * f {
                c = c.next_down();
            }
            let g = if f.is_finite() { (2. * f - c * c).sqrt() } else { 0. };
            for state in [&mut before, &mut expected.state] {
                let (c_at, g_at) = (lab.c(s, progress.current).start, lab.g(s, progress.current).start + 1);
                state.values[c_at] = c;
                state.values[g_at] = if g > 0. { g } else { -1. };
            }
            assert!(!f.is_finite() || 0.5 * (c * c + g * g) == f, "{f:e}");
            let history = &mut histories[s];
            let earlier = history.len().checked_sub(window).map_or(f, |at| history[at]);
            let ring = lab.range(s, batch.history, 0).start + progress.recorded as usize % window;
            assert_eq!(progress.recorded as usize, history.len());
            let mut begun = progress;
            control::begin(&mut begun, &limits, f, earlier, f < tolerance);
            if begun.state != EXACT {
                history.push(f);
                expected.state.values[ring] = f;
            }
            begun.factorisations += u32::from(begun.state <= CLOSE);
            *seen.entry(begun.state).or_default() += 1;
            expected.state.progress[s] = begun;
        }
        // What follows from the state is compared in the test above.
        let mut got = lab.run("rows", &list, &before);
        let written = [lab.batch.x..lab.batch.initial, lab.batch.diagonal..lab.batch.right_hand_side, lab.batch.weight..lab.batch.slack];
        for s in 0..n {
            for range in &written {
                let range = lab.range(s, range.start, (range.end - range.start) as usize);
                expected.state.values[range.clone()].copy_from_slice(&got.values[range.clone()]);
                // Input of the next round is as of this one.
                got.values[range.clone()].copy_from_slice(&before.values[range]);
            }
        }
        let mut as_got = Expected { state: expected.state.clone(), sizes: BTreeMap::new() };
        for s in 0..n {
            for range in &written {
                let range = lab.range(s, range.start, (range.end - range.start) as usize);
                as_got.state.values[range.clone()].copy_from_slice(&got.values[range]);
            }
        }
        // `pull` and the start of a slower closing are products; the rest is the same to the last bit.
        lab.check("rows", &got, &as_got, |name| if ["pull", "closing_below"].contains(&name) { ARITHMETIC } else { 0. });
        before.values.copy_from_slice(&got.values);
        before.progress.copy_from_slice(&expected.state.progress);
        for &s in &list {
            let s = s as usize;
            let progress = &mut before.progress[s];
            match progress.state {
                STEP | CLOSE => control::accept(progress, &limits, [0.1, 0.5, 0.9][random.index(0..=2)]),
                EXACT => control::renew(progress),
                _ => {
                    // The slot is filled again; what its ring holds is another candidate's.
                    *progress =
                        Progress { current: progress.current, ..Progress::first(&limits, if s.is_multiple_of(2) { 0. } else { 0.04 }) };
                    histories[s].clear();
                }
            }
            let progress = before.progress[s];
            for half in [0, 1] {
                let (c, g) = (lab.c(s, half), lab.g(s, half));
                before.values[c].fill(0.);
                before.values[g].fill(-1.);
            }
            assert!(progress.current < 2);
        }
    }
    eprintln!("states begun: {seen:?}");
    for state in [STEP, CLOSE, EXACT, SOLVED, control::MAX_ITERATIONS, control::STALLED, control::NON_FINITE] {
        assert!(seen.get(&state).is_some_and(|n| *n > 2), "no round began in state {state}: {seen:?}");
    }
}

// ---- The factorisation and the substitutions.

/// Random weights, some of them zero, with values that are zero there too; what falls on single variables. As in reference.rs.
struct System {
    weight: Vec<f32>,
    value: Vec<f32>,
    diagonal: Vec<f32>,
    gradient: Vec<f32>,
}

impl System {
    fn new(layout: &Layout<f32>, random: &mut Random, zeros: f64) -> System {
        let weight: Vec<f32> =
            (0..layout.rows).map(|_| if random.between(0., 1.) < zeros { 0. } else { random.between(0.01, 1.) as f32 }).collect();
        let value = weight.iter().map(|&w| if w == 0. { 0. } else { random.between(-1., 1.) as f32 }).collect();
        let diagonal = (0..layout.variables).map(|_| 1e-3 * random.between(0.01, 10.) as f32).collect();
        let gradient = (0..layout.variables).map(|_| random.between(-1., 1.) as f32).collect();
        System { weight, value, diagonal, gradient }
    }

    fn equations<'a>(&'a self, jacobian: &'a [f32]) -> NormalEquations<'a, f32> {
        NormalEquations { jacobian, weight: &self.weight, value: &self.value, diagonal: &self.diagonal, gradient: &self.gradient }
    }

    /// `E + J' W J`, `-(u + J' v)`, and the sizes of the terms of that, in f64.
    fn dense(&self, layout: &Layout<f32>, jacobian: &[f32]) -> (DMatrix<f64>, DVector<f64>, DVector<f64>) {
        let wide = |v: &[f32]| DVector::from_iterator(v.len(), v.iter().map(|v| f64::from(*v)));
        let mut matrix = DMatrix::from_diagonal(&wide(&self.diagonal));
        let mut rhs = -wide(&self.gradient);
        let mut size = rhs.abs();
        for element in &layout.elements {
            let place = &element.place;
            for r in 0..element.rows as usize {
                let row = &jacobian[place.jacobian as usize + r * place.stride as usize..];
                let entries: Vec<(usize, f64)> = layout.runs[element.runs.range()]
                    .iter()
                    .flat_map(|run| (0..run.len).map(move |i| ((run.variable + i) as usize, f64::from(row[(run.column + i) as usize]))))
                    .filter(|entry| entry.1 != 0.)
                    .collect();
                let (w, v) = (f64::from(self.weight[place.row as usize + r]), f64::from(self.value[place.row as usize + r]));
                for &(a, left) in &entries {
                    rhs[a] -= v * left;
                    size[a] += (v * left).abs();
                    for &(b, right) in &entries {
                        matrix[(b, a)] += w * left * right;
                    }
                }
            }
        }
        (matrix, rhs, size)
    }
}

/// Entries of the factor that hold numbers: each pivot row from the diagonal to the right-hand side.
fn factor_entries(layout: &Layout<f32>) -> Vec<usize> {
    let of_row = |step: &cregopt::nlp::sweep::Step, i: u32| {
        let row = step.factor + i * step.stride;
        (row + i) as usize..=(row + step.size) as usize
    };
    layout.steps.iter().flat_map(|step| (0..step.pivots).flat_map(move |i| of_row(step, i))).collect()
}

/// Entries left of the diagonal in the block of four pivots on it: the shader writes whole blocks, with zeros there.
fn left_of_diagonal(layout: &Layout<f32>) -> Vec<usize> {
    let of_row = |step: &cregopt::nlp::sweep::Step, i: u32| {
        let row = step.factor + i * step.stride;
        (row + i / 4 * 4) as usize..(row + i) as usize
    };
    layout.steps.iter().flat_map(|step| (0..step.pivots).flat_map(move |i| of_row(step, i))).collect()
}

/// By how much a factor and its right-hand side miss the normal equations `A d = b`: the largest of `|A - U'U|` by the geometric mean of its
/// two diagonal entries, and of `|b - U'y|` by the sizes of its terms.
fn misses(layout: &Layout<f32>, factor: &[f32], (matrix, rhs, size): &(DMatrix<f64>, DVector<f64>, DVector<f64>)) -> f64 {
    let (mut matrix_left, mut left, mut size) = (matrix.clone(), rhs.clone(), size.clone());
    for step in &layout.steps {
        let front = front_of(layout, step);
        for i in 0..step.pivots as usize {
            let row = &factor[step.factor as usize + i * step.stride as usize..][..=step.size as usize];
            let y = f64::from(row[step.size as usize]);
            for (a, &variable) in front.iter().enumerate().skip(i) {
                let u = f64::from(row[a]);
                left[variable] -= u * y;
                size[variable] += (u * y).abs();
                for (b, &other) in front.iter().enumerate().skip(i) {
                    matrix_left[(other, variable)] -= u * f64::from(row[b]);
                }
            }
        }
    }
    let mut worst = 0.;
    for i in 0..layout.variables {
        worst = backward(left[i], size[i], worst);
        for j in 0..layout.variables {
            worst = backward(matrix_left[(i, j)], (matrix[(i, i)] * matrix[(j, j)]).sqrt(), worst);
        }
    }
    worst
}

/// Inputs of the factorisation of a slot.
fn put_system(lab: &Lab, s: usize, state: &mut State, system: &System, jacobian: &[f32]) {
    let batch = &lab.batch;
    let at = lab.jacobian(s, state.progress[s].current);
    state.jacobian[at].copy_from_slice(jacobian);
    for (at, values) in [
        (lab.of_rows(s, batch.weight), &system.weight),
        (lab.of_rows(s, batch.value), &system.value),
        (lab.of_variables(s, batch.diagonal), &system.diagonal),
        (lab.of_variables(s, batch.gradient), &system.gradient),
    ] {
        state.values[at].copy_from_slice(values);
    }
}

/// Factorises systems of all slots and checks what the factors solve.
fn check_front(lab: &mut Lab, lists: &[Vec<u32>], what: &str) {
    let mut random = Random::new(51);
    let mut before = lab.poisoned();
    states(lab, &mut before, &[STEP, CLOSE, STEP, STEP, EXACT, CLOSE, SOLVED]);
    let mut systems = Vec::new();
    for s in 0..lab.slots.len() {
        let layout = &lab.slots[s].layout;
        let mut system = System::new(layout, &mut random, [0., 0.4, 0.9][s % 3]);
        // Some are not positive definite, at one pivot or another.
        if s % 8 == 5 {
            let at = [0, layout.variables / 2, layout.variables - 1][s / 8 % 3];
            system.diagonal[at] = -1e3;
        }
        let jacobian = jacobian_at(&lab.slots[s]);
        put_system(lab, s, &mut before, &system, &jacobian);
        systems.push((system, jacobian));
    }
    let mut worst = 0f64;
    let (mut checked, mut refused) = (BTreeMap::new(), 0);
    for list in lists {
        let got = lab.run("front", list, &before);
        // What must not change, with room for what the sweep keeps between its steps.
        let mut expected = Expected { state: before.clone(), sizes: BTreeMap::new() };
        for &s in list {
            let s = s as usize;
            if before.progress[s].state > CLOSE {
                continue;
            }
            let layout = &lab.slots[s].layout;
            let (system, jacobian) = &systems[s];
            let mut twin = Factor::default();
            twin.resize(layout);
            let positive = factorise(layout, &system.equations(jacobian), &mut twin);
            expected.state.values[lab.flags(s)] = f32::from(!positive);
            let scratch = lab.range(s, lab.batch.carry, (lab.batch.flags - lab.batch.carry) as usize);
            expected.state.values[scratch.clone()].copy_from_slice(&got.values[scratch]);
            let first = lab.factor(s).start;
            for at in left_of_diagonal(layout) {
                if got.factor[first + at] == 0. {
                    expected.state.factor[first + at] = 0.;
                }
            }
            for at in factor_entries(layout) {
                let v = got.factor[first + at];
                assert!(!positive || v.is_finite(), "{what}, slot {s}, {}: factor[{at}] is {v}", lab.slots[s].candidate.name);
                expected.state.factor[first + at] = v;
            }
            if !positive {
                refused += 1;
                continue;
            }
            let factor = &got.factor[lab.factor(s)];
            if let Some(checked) = checked.insert(s, factor.to_vec()) {
                // Whoever else is in the list.
                assert!(
                    checked.iter().zip(factor).all(|(a, b)| a.to_bits() == b.to_bits()),
                    "{what}, slot {s}: another factor in another list"
                );
            } else {
                let error = misses(layout, factor, &system.dense(layout, jacobian));
                assert!(error <= FRONT, "{what}, slot {s}, {}: backward error {error:e}", lab.slots[s].candidate.name);
                worst = worst.max(error);
            }
        }
        lab.check("front", &got, &expected, |_| 0.);
    }
    assert!(refused > 0 || lab.slots.len() < 8);
    eprintln!("front, {what}: backward error up to {:.2} units", worst / f64::from(f32::EPSILON));
}

/// Candidates whose front fits into the smallest workgroup memory.
fn with_small_fronts(workgroup: u32) -> Vec<Candidate> {
    let fits = |c: &Candidate| {
        let sizes = Prepared::new(0, c.layout.clone(), 0, workgroup).sizes;
        sizes.front <= SMALL[0] && sizes.columns <= SMALL[1]
    };
    let candidates: Vec<Candidate> = candidates().into_iter().filter(fits).collect();
    let feet: BTreeSet<usize> = candidates.iter().map(|c| c.feet).collect();
    assert!(feet.len() >= 3, "feet of those with small fronts: {feet:?}");
    candidates
}

#[test]
fn front_in_workgroup_memory_solves_the_normal_equations() {
    let Some(device) = gpu("front_in_workgroup_memory_solves_the_normal_equations") else { return };
    let candidates = with_small_fronts(device.workgroup);
    assert!(Variant::new(SMALL[0], SMALL[1], device.workgroup, 16 << 10).front > 0);
    assert!(device.variant(SMALL[0], SMALL[1]).front > 0);
    let mut lab = Lab::new(&device, &candidates, CAPACITY, SMALL, |_, _| {});
    let lists = lab.lists();
    check_front(&mut lab, &lists, "front in workgroup memory");
}

#[test]
fn front_in_storage_solves_the_normal_equations() {
    let Some(device) = gpu("front_in_storage_solves_the_normal_equations") else { return };
    assert_eq!(device.variant(LARGE[0], LARGE[1]).front, 0, "this adapter would keep the front in workgroup memory");
    let candidates = candidates();
    let mut lab = Lab::new(&device, &candidates, candidates.len(), LARGE, |_, _| {});
    let largest = lab.slots.iter().map(|s| s.layout.steps.iter().map(|step| step.size).max().unwrap()).max().unwrap();
    assert!(largest as usize <= LARGE[0] && largest as usize > SMALL[0], "the largest front has {largest} variables");
    let lists = lab.lists();
    check_front(&mut lab, &lists, "front in storage");
}

#[test]
fn front_of_another_workgroup_size_solves_the_normal_equations() {
    let test = "front_of_another_workgroup_size_solves_the_normal_equations";
    let Some(device) = with_its_workgroups(test) else { return };
    if device.workgroup == WORKGROUP {
        return skipped(test, "this adapter has no other one");
    }
    let candidates = with_small_fronts(device.workgroup);
    let mut lab = Lab::new(&device, &candidates, candidates.len(), SMALL, |_, _| {});
    let lists = lab.lists();
    check_front(&mut lab, &lists, "small workgroups");
}

#[test]
fn a_sweep_in_several_dispatches_gives_the_same_factor() {
    let test = "a_sweep_in_several_dispatches_gives_the_same_factor";
    let Some(device) = gpu(test) else { return };
    let Some(limit) = device.loop_limit else {
        skipped(test, "this adapter cuts no loops short, so every sweep is one dispatch");
        return;
    };
    let candidates = with_small_fronts(device.workgroup);
    let n = candidates.len();
    let factors = [1, limit / 3, limit].map(|loops| {
        let mut lab = Lab::with_loops(&device, &candidates, n, SMALL, loops, |_, _| {});
        let mut random = Random::new(61);
        let mut before = lab.poisoned();
        states(&lab, &mut before, &[STEP, CLOSE]);
        for s in 0..n {
            let layout = &lab.slots[s].layout;
            assert!(layout.steps.len() > 3);
            assert!(lab.slots[s].loops < limit, "one dispatch is too long for this adapter: {}", lab.slots[s].loops);
            let mut system = System::new(layout, &mut random, 0.2);
            if s % 4 == 1 {
                // The first step fails; it must not be forgotten.
                system.diagonal[0] = -1e3;
            }
            put_system(&lab, s, &mut before, &system, &jacobian_at(&lab.slots[s]));
        }
        let list: Vec<u32> = (0..n as u32).rev().collect();
        let got = lab.run("front", &list, &before);
        let flags: Vec<f32> = (0..n).map(|s| got.values[lab.flags(s)]).collect();
        // Of those that failed the numbers are any.
        let numbers = |s: usize| got.factor[lab.factor(s)].iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
        (flags.clone(), (0..n).filter(|s| flags[*s] == 0.).flat_map(numbers).collect::<Vec<u32>>())
    });
    assert_eq!(factors[0].0, (0..n).map(|s| f32::from(s % 4 == 1)).collect::<Vec<_>>());
    for (several, what) in factors[1..].iter().zip(["three steps a dispatch", "one step a dispatch"]) {
        assert_eq!(factors[0].0, several.0, "{what}: flags");
        let first = factors[0].1.iter().zip(&several.1).position(|(a, b)| a != b);
        assert_eq!(first, None, "{what}: first factor entry that differs");
    }
}

/// A slot's factor by the twin, with its right-hand side.
fn twin_factor(slot: &Slot, random: &mut Random) -> Vec<f32> {
    let system = System::new(&slot.layout, random, 0.2);
    let mut factor = Factor::default();
    factor.resize(&slot.layout);
    // Where the twin writes nothing there is nothing to read.
    factor.rows.fill(POISON);
    assert!(factorise(&slot.layout, &system.equations(&jacobian_at(slot)), &mut factor));
    factor.rows
}

/// Variables of the front of a step, in its order.
fn front_of(layout: &Layout<f32>, step: &cregopt::nlp::sweep::Step) -> Vec<usize> {
    let pivots = step.variable..step.variable + step.pivots;
    let rest = layout.front_runs[step.rest.range()].iter().flat_map(|run| run.variable..run.variable + run.len);
    pivots.chain(rest).map(|v| v as usize).collect()
}

/// Runs a substitution on workgroup-size fronts and on large ones.
fn substitution(
    shader: &'static str,
    of_states: &[u32],
    prepare: impl Fn(&Lab, usize, &mut State, &mut Random),
    check: impl Fn(&Lab, usize, &State, &State, &mut Expected) -> f64,
) {
    let test = format!("{shader}_solves_its_triangle");
    let Some(device) = gpu(&test) else { return };
    let (small, all) = (with_small_fronts(device.workgroup), candidates());
    let labs = [Lab::new(&device, &small, CAPACITY, SMALL, |_, _| {}), Lab::new(&device, &all, all.len(), LARGE, |_, _| {})];
    for mut lab in labs {
        let mut random = Random::new(71);
        let mut before = lab.poisoned();
        states(&lab, &mut before, of_states);
        let factors: Vec<Vec<f32>> = lab.slots.iter().take(20).map(|slot| twin_factor(slot, &mut random)).collect();
        for s in 0..lab.slots.len() {
            // Equal candidates have equal factors.
            let same = (0..factors.len()).find(|i| std::ptr::eq(lab.slots[*i].candidate, lab.slots[s].candidate)).unwrap();
            let at = lab.factor(s);
            before.factor[at].copy_from_slice(&factors[same]);
            prepare(&lab, s, &mut before, &mut random);
        }
        let mut worst = 0f64;
        for list in lab.lists() {
            let got = lab.run(shader, &list, &before);
            let mut expected = Expected { state: before.clone(), sizes: BTreeMap::new() };
            for &s in &list {
                let error = check(&lab, s as usize, &before, &got, &mut expected);
                assert!(error <= SUBSTITUTION, "{shader}, slot {s}, {}: backward error {error:e}", lab.slots[s as usize].candidate.name);
                worst = worst.max(error);
            }
            lab.check(shader, &got, &expected, |_| 0.);
        }
        eprintln!("{shader}: backward error up to {:.2} units", worst / f64::from(f32::EPSILON));
    }
}

/// Largest ratio of a residual and the sizes of its terms; infinite where one is no number.
fn backward(residual: f64, size: f64, worst: f64) -> f64 {
    let error = residual.abs() / size;
    if error.is_nan() { f64::INFINITY } else { worst.max(error) }
}

#[test]
fn substitute_solves_its_triangle() {
    substitution(
        "substitute",
        &[STEP, CLOSE, STEP, EXACT, SOLVED],
        |_, _, _, _| {},
        |lab, s, before, got, expected| {
            if before.progress[s].state > CLOSE {
                return 0.;
            }
            let (layout, factor) = (&lab.slots[s].layout, &before.factor[lab.factor(s)]);
            let at = lab.of_variables(s, lab.batch.direction);
            let d = &got.values[at.clone()];
            expected.state.values[at].copy_from_slice(d);
            let mut worst = 0.;
            for step in &layout.steps {
                let front = front_of(layout, step);
                for i in 0..step.pivots as usize {
                    let row = &factor[step.factor as usize + i * step.stride as usize..];
                    let y = f64::from(row[step.size as usize]);
                    let (mut left, mut size) = (y, y.abs());
                    for (j, &variable) in front.iter().enumerate().skip(i) {
                        let term = f64::from(row[j]) * f64::from(d[variable]);
                        left -= term;
                        size += term.abs();
                    }
                    worst = backward(left, size, worst);
                }
            }
            worst
        },
    );
}

#[test]
fn forward_solves_its_triangle() {
    substitution(
        "forward",
        &[STEP, STEP, CLOSE, STEP, EXACT, SOLVED],
        |lab, s, state, random| {
            let at = lab.of_variables(s, lab.batch.right_hand_side);
            fill(&mut state.values, at, random, -1., 1.);
        },
        |lab, s, before, got, expected| {
            if before.progress[s].state != STEP {
                return 0.;
            }
            let layout = &lab.slots[s].layout;
            let at = lab.of_variables(s, lab.batch.right_hand_side);
            let (given, left) = (&before.values[at.clone()], &got.values[at.clone()]);
            let first = lab.factor(s).start;
            // What pivots subtract from later variables, by the shader's own solution.
            let mut sums: Vec<f64> = given.iter().map(|v| f64::from(*v)).collect();
            let mut sizes: Vec<f64> = sums.iter().map(|v| v.abs()).collect();
            let mut worst = 0.;
            for step in &layout.steps {
                let front = front_of(layout, step);
                for i in 0..step.pivots as usize {
                    let row = first + step.factor as usize + i * step.stride as usize;
                    let column = row + step.size as usize;
                    let y = f64::from(got.factor[column]);
                    expected.state.factor[column] = got.factor[column];
                    let pivot = f64::from(before.factor[row + i]) * y;
                    let variable = front[i];
                    worst = backward(pivot + sums[variable], pivot.abs() + sizes[variable], worst);
                    for (j, &later) in front.iter().enumerate().skip(i + 1) {
                        let term = f64::from(before.factor[row + j]) * y;
                        sums[later] += term;
                        sizes[later] += term.abs();
                    }
                }
            }
            // And the twin on the same numbers leaves the same right-hand side, but for rounding: what it is no one reads.
            let mut twin = Factor::default();
            twin.resize(layout);
            twin.rows.copy_from_slice(&before.factor[lab.factor(s)]);
            let mut gradient = given.to_vec();
            forward::forward(layout, &mut twin, &mut gradient);
            assert!(left.iter().all(|v| v.is_finite()) && gradient.iter().all(|v| v.is_finite()));
            expected.state.values[at].copy_from_slice(left);
            worst
        },
    );
}

// ---- The check itself.

#[test]
fn a_perturbed_element_is_seen() {
    let Some(device) = gpu("a_perturbed_element_is_seen") else { return };
    let candidates = candidates();
    let mut lab = Lab::new(&device, &candidates, candidates.len(), SMALL, |_, _| {});
    let mut before = lab.poisoned();
    states(&lab, &mut before, &[STEP]);
    let list: Vec<u32> = (1..lab.slots.len() as u32).rev().collect();
    let batch = lab.batch;
    for s in 0..lab.slots.len() {
        let x = lab.of_variables(s, batch.x + before.progress[s].current * batch.x_half);
        let d = lab.of_variables(s, batch.direction);
        let mut random = Random::new(s as u64);
        fill(&mut before.values, x, &mut random, 1., 2.);
        fill(&mut before.values, d, &mut random, 0.1, 1.);
        let g = lab.g(s, before.progress[s].current);
        fill(&mut before.values, g, &mut random, -1., 1.);
        let by = lab.of_inequalities(s, batch.g_change);
        fill(&mut before.values, by, &mut random, -1., 1.);
        barrier_state(&lab, s, &mut before, &mut random, true);
        before.progress[s] = Progress { mu: 0.01, length: 0.5, ..before.progress[s] };
    }
    let got = lab.run("advance", &list, &before);
    let expected = Expected { state: got.clone(), sizes: BTreeMap::new() };
    let compare = |got: &State| lab.compare(got, &expected, |name| if name == "x" { ARITHMETIC } else { 0. }, &mut BTreeMap::new());
    assert_eq!(compare(&got), Ok(()));

    let slot = 3;
    let at = lab.x(slot, 1 - before.progress[slot].current).start + 7;
    let right = got.values[at];
    let seen = |change: &dyn Fn(&mut State)| {
        let mut wrong = got.clone();
        change(&mut wrong);
        compare(&wrong).err()
    };
    // Within the tolerance, beyond it, and no number.
    let unit = right.abs().max(1.) * f32::EPSILON;
    assert_eq!(seen(&|state| state.values[at] = right + 0.9 * ARITHMETIC * unit), None);
    for wrong in [right + 1.2 * ARITHMETIC * unit, right - 1.2 * ARITHMETIC * unit, f32::NAN, f32::INFINITY, POISON] {
        let message = seen(&|state| state.values[at] = wrong).unwrap();
        assert!(message.contains(&format!("slot {slot}")) && message.contains(&lab.slots[slot].candidate.name), "{message}");
        assert!(message.contains("x[") && message.contains("ulp"), "{message}");
    }
    // Written where nothing should be: a slot that is not listed, the padding behind an array, what another shader owns.
    let unlisted = lab.of_variables(0, batch.direction).start;
    assert!(seen(&|state| state.values[unlisted] += 1.).unwrap().contains("slot 0"));
    let poison = (0..got.values.len()).find(|i| got.values[*i].to_bits() == POISON.to_bits()).unwrap();
    assert!(seen(&|state| state.values[poison] = 0.).unwrap().contains("untouched"));
    assert!(seen(&|state| state.values[poison] = f32::NAN).is_some());
    assert!(seen(&|state| state.jacobian[11] = 0.).unwrap().contains("jacobian[11]"));
    assert!(seen(&|state| state.factor[11] = 0.).unwrap().contains("factor[11]"));
    assert!(seen(&|state| state.progress[2].iterations += 1).unwrap().contains("iterations"));
    assert!(seen(&|state| state.progress[2].mu = 0.010_000_001).unwrap().contains("mu"));
}

#[test]
fn every_shader_has_a_test_here() {
    let text = include_str!("parity.rs");
    for shader in &SHADERS {
        assert!(text.contains(&format!("\"{}\",", shader.name)), "{} is compared nowhere", shader.name);
    }
}
