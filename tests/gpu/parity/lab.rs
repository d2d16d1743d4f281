//! Slots full of candidates: poison before a shader runs, a copy for its twin, and the comparison afterwards.

use super::candidates::{Candidate, EDGE_RADIUS, grids};
use crate::common::Random;
use cregopt::backend::gpu::shaders::{Shader, WORKGROUP};
use cregopt::backend::gpu::{Device, Folder, List, Prepared, Slots};
use cregopt::backend::tables::{Batch, Buffer, Sizes, Slot as Counts};
use cregopt::nlp::Problem;
use cregopt::settings::{OptimiseSettings, SmoothSettings, SolverSettings, StallSettings};
use cregopt::solver::control::Progress;
use std::collections::BTreeMap;
use std::io::Write;
use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock};

/// A NaN that no shader writes. It has the bits that NVIDIA's hardware gives to every NaN, so that it stays the same when it is moved.
pub const POISON: f32 = f32::from_bits(0x7fff_ffff);

/// Number of slots of a lab.
pub const CAPACITY: usize = 70;

/// Sizes of the list of running slots: one, and around the size of a workgroup or a warp.
pub const COUNTS: [usize; 4] = [1, 63, 64, 65];

/// Largest front that fits into the portable 16 KiB of workgroup memory.
pub const SMALL: usize = 79;

/// Front that does not fit into the workgroup memory of common adapters: 83 KiB.
pub const LARGE: usize = 200;

/// Prints the reason even where the output of passing tests is hidden.
#[expect(clippy::explicit_write, reason = "the harness keeps what eprintln prints")]
pub fn skipped(test: &str, why: &str) {
    writeln!(std::io::stderr(), "`{test}` skipped: {why}").unwrap();
}

/// The adapter, opened once, with the workgroups of GPUs. Returns `None` after reporting which test is skipped.
pub fn gpu(test: &str) -> Option<Arc<Device>> {
    static DEVICE: OnceLock<Result<Arc<Device>, String>> = OnceLock::new();
    let device = DEVICE.get_or_init(|| {
        let name = std::env::var("CREGOPT_TEST_ADAPTER").ok();
        let device = Device::open_with(name.as_deref(), Folder::default()).map_err(|e| e.to_string())?;
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

/// The adapter with the workgroup size of software adapters.
pub fn with_its_workgroups(test: &str) -> Option<Arc<Device>> {
    static DEVICE: OnceLock<Option<Arc<Device>>> = OnceLock::new();
    gpu(test)?;
    let open = || Device::open_with(std::env::var("CREGOPT_TEST_ADAPTER").ok().as_deref(), Folder::default()).ok().map(Arc::new);
    DEVICE.get_or_init(open).clone()
}

/// Buffers that shaders write.
#[derive(Clone)]
pub struct State {
    pub values: Vec<f32>,
    pub jacobian: Vec<f32>,
    pub factor: Vec<f32>,
    pub progress: Vec<Progress<f32>>,
}

/// Results of the twin, and the sizes of the terms where they are not 1.
pub struct Expected {
    pub state: State,
    pub sizes: BTreeMap<usize, f32>,
}

/// Buffers and the candidates in their slots.
pub struct Lab<'a> {
    pub device: Arc<Device>,
    buffers: Slots,
    pub batch: Batch,
    pub slots: Vec<Slot<'a>>,
    pub settings: SolverSettings,
}

/// Candidate of a slot, and the number of its entries in this test.
pub struct Slot<'a> {
    pub candidate: &'a Candidate,
    pub problem: Problem<f32>,
    pub counts: Counts,
    pub loops: u32,
}

/// Names of the arrays in the values of a slot, by their start.
pub fn arrays(batch: &Batch) -> Vec<(u32, &'static str)> {
    vec![
        (batch.x, "x"),
        (batch.initial, "initial"),
        (batch.smoothing, "smoothing"),
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
        (batch.cost_weights, "cost_weights"),
        (batch.shift_c, "shift_c"),
        (batch.shift_g, "shift_g"),
        (batch.solved, "solved"),
        (batch.history, "history"),
        (batch.carry, "carry"),
        (batch.front, "front"),
        (batch.flags, "flags"),
    ]
}

/// Names of the members of `Progress`, integers first.
pub const PROGRESS: [&str; 25] = [
    "state",
    "current",
    "iterations",
    "factorisations",
    "attempts",
    "recorded",
    "stall_from",
    "phase",
    "minimise_iterations",
    "minimise_until",
    "infeasibility",
    "mu",
    "barrier_floor",
    "barrier",
    "smoothing",
    "eps",
    "closing_eps",
    "closing_below",
    "closing_from",
    "edge_radius",
    "early_termination_limit",
    "length",
    "dual_length",
    "rounding",
    "solved_infeasibility",
];

/// Number of integers among them.
const INTEGERS: usize = 10;
const _: () = assert!(size_of::<Progress<f32>>() == 4 * PROGRESS.len());

impl<'a> Lab<'a> {
    /// Fills slot `s` with candidate `s % n`, changed by `tweak`.
    pub fn new(
        device: &Arc<Device>,
        candidates: &'a [Candidate],
        slots: usize,
        front: usize,
        tweak: impl Fn(usize, &mut Prepared),
    ) -> Self {
        Lab::with_loops(device, candidates, slots, front, 1, tweak)
    }

    pub fn with_loops(
        device: &Arc<Device>,
        candidates: &'a [Candidate],
        slots: usize,
        front: usize,
        loops: u32,
        tweak: impl Fn(usize, &mut Prepared),
    ) -> Self {
        let settings = SolverSettings {
            edge_radius: EDGE_RADIUS,
            max_iterations: 25,
            stall: StallSettings { start: 12, window: 7, ..StallSettings::default() },
            // Only solves with `minimise_iterations` minimise a cost.
            smooth: SmoothSettings { iterations: 12, ..SmoothSettings::default() },
            optimise: OptimiseSettings { iterations: 12, tolerance: 0.5, cost_limit: Some(2e4), ..OptimiseSettings::default() },
            ..SolverSettings::default()
        };
        let prepare = |s: usize| {
            let candidate = &candidates[s % candidates.len()];
            let mut prepared = Prepared::new(s, candidate.problem.clone(), candidate.first_height, device.workgroup);
            tweak(s, &mut prepared);
            prepared
        };
        let prepared: Vec<Prepared> = (0..slots).map(prepare).collect();
        let mut sizes = prepared.iter().map(|p| p.sizes).reduce(Sizes::max).unwrap();
        sizes.front = front;
        let mut buffers = Slots::new(device, sizes, &settings, slots, &grids().0, loops).unwrap();
        buffers.fill(&(0..slots as u32).collect::<Vec<_>>(), &prepared, &settings).unwrap();
        let of = |p: Prepared| Slot {
            candidate: &candidates[p.index % candidates.len()],
            counts: p.slot,
            loops: p.loops * p.own.front_steps.len() as u32,
            problem: p.problem,
        };
        Lab { device: device.clone(), batch: buffers.batch, buffers, slots: prepared.into_iter().map(of).collect(), settings }
    }

    /// State full of poison.
    pub fn poisoned(&self) -> State {
        let n = self.slots.len();
        let float = POISON;
        let progress = Progress {
            infeasibility: float,
            mu: float,
            barrier_floor: float,
            smoothing: float,
            eps: float,
            closing_eps: float,
            closing_below: float,
            closing_from: float,
            edge_radius: float,
            length: float,
            dual_length: float,
            barrier: float,
            rounding: float,
            solved_infeasibility: float,
            ..Progress::default()
        };
        State {
            values: vec![POISON; n * self.batch.values as usize],
            jacobian: vec![POISON; n * 2 * self.batch.jacobian as usize],
            factor: vec![POISON; n * self.batch.factor as usize],
            progress: vec![progress; n],
        }
    }

    /// Range of an array of a slot in the values.
    pub fn range(&self, slot: usize, array: u32, len: usize) -> Range<usize> {
        let at = slot * self.batch.values as usize + array as usize;
        at..at + len
    }

    pub fn x(&self, slot: usize, half: u32) -> Range<usize> {
        self.range(slot, self.batch.x + half * self.batch.x_half, self.slots[slot].problem.initial.len())
    }

    pub fn c(&self, slot: usize, half: u32) -> Range<usize> {
        self.range(slot, self.batch.c + half * self.batch.c_half, self.slots[slot].problem.rows.one_sided())
    }

    pub fn g(&self, slot: usize, half: u32) -> Range<usize> {
        self.range(slot, self.batch.g + half * self.batch.g_half, self.slots[slot].problem.inequalities)
    }

    pub fn of_variables(&self, slot: usize, array: u32) -> Range<usize> {
        self.range(slot, array, self.slots[slot].problem.variables)
    }

    pub fn of_rows(&self, slot: usize, array: u32) -> Range<usize> {
        self.range(slot, array, self.slots[slot].problem.rows.all())
    }

    pub fn of_inequalities(&self, slot: usize, array: u32) -> Range<usize> {
        self.range(slot, array, self.slots[slot].problem.inequalities)
    }

    pub fn of_equalities(&self, slot: usize, array: u32) -> Range<usize> {
        self.range(slot, array, self.slots[slot].problem.rows.one_sided())
    }

    /// Ranges of the residuals of one half and of their changes: equalities, inequalities.
    pub fn changes(&self, slot: usize, half: u32) -> [(Range<usize>, Range<usize>); 2] {
        let batch = &self.batch;
        [(self.c(slot, half), self.of_equalities(slot, batch.c_change)), (self.g(slot, half), self.of_inequalities(slot, batch.g_change))]
    }

    pub fn flags(&self, slot: usize) -> usize {
        self.range(slot, self.batch.flags, 1).start
    }

    pub fn jacobian(&self, slot: usize, half: u32) -> Range<usize> {
        let at = (2 * slot + half as usize) * self.batch.jacobian as usize;
        at..at + self.slots[slot].problem.jacobian_len
    }

    pub fn factor(&self, slot: usize) -> Range<usize> {
        let at = slot * self.batch.factor as usize;
        at..at + self.slots[slot].problem.factor_len
    }

    /// Writes a state, runs a shader over a list of slots, and reads the state.
    pub fn run(&mut self, shader: Shader, list: &[u32], before: &State) -> State {
        let queue = &self.device.queue;
        let write = |buffer, bytes: &[u8]| queue.write_buffer(self.buffers.buffer(buffer), 0, bytes);
        write(Buffer::Values, bytemuck::cast_slice(&before.values));
        write(Buffer::Jacobian, bytemuck::cast_slice(&before.jacobian));
        write(Buffer::Factor, bytemuck::cast_slice(&before.factor));
        write(Buffer::Progress, bytemuck::cast_slice(&before.progress));
        self.buffers.list(List::Running, list);
        let mut encoder = self.device.device.create_command_encoder(&Default::default());
        self.buffers.dispatch(&mut encoder.begin_compute_pass(&Default::default()), shader, List::Running, list.len());
        queue.submit([encoder.finish()]);
        let bound = |buffer| shader.buffers().any(|bound| bound == (buffer, true));
        let read = |buffer| self.buffers.read_buffer(buffer).unwrap();
        // Buffers that are bound for reading only stay as they are.
        let floats = |buffer, before: &Vec<f32>| if bound(buffer) { bytemuck::pod_collect_to_vec(&read(buffer)) } else { before.clone() };
        State {
            values: floats(Buffer::Values, &before.values),
            jacobian: floats(Buffer::Jacobian, &before.jacobian),
            factor: floats(Buffer::Factor, &before.factor),
            progress: bytemuck::pod_collect_to_vec(&read(Buffer::Progress)),
        }
    }

    /// Compares the results of a shader with those of its twin.
    pub fn check(&self, shader: Shader, got: &State, expected: &Expected, tolerance: impl Fn(&str) -> f32) {
        let mut worst: BTreeMap<&str, f32> = BTreeMap::new();
        if let Err(difference) = self.compare(got, expected, tolerance, &mut worst) {
            panic!("{}: {difference}; worst: {worst:?}", shader.path());
        }
        note(shader, &worst);
    }

    /// Returns the first difference. Collects the largest error of each array, also those beyond the tolerance.
    pub fn compare(
        &self,
        got: &State,
        expected: &Expected,
        tolerance: impl Fn(&str) -> f32,
        worst: &mut BTreeMap<&'static str, f32>,
    ) -> Result<(), String> {
        let names = arrays(&self.batch);
        let stride = self.batch.values as usize;
        let mut first = Ok(());
        for (i, (a, b)) in got.values.iter().zip(&expected.state.values).enumerate() {
            if a.to_bits() == b.to_bits() {
                continue;
            }
            let (slot, at) = (i / stride, (i % stride) as u32);
            let (start, name) = names[names.partition_point(|n| n.0 <= at) - 1];
            let size = expected.sizes.get(&i).copied().unwrap_or(1.);
            first = first.and(self.differs(slot, name, (at - start) as usize, *a, *b, size, tolerance(name), worst));
        }
        let of_slot = |len: u32| move |i: usize| (i / len as usize, i % len as usize);
        let jacobian = (&got.jacobian, &expected.state.jacobian, "jacobian", 2 * self.batch.jacobian);
        let factor = (&got.factor, &expected.state.factor, "factor", self.batch.factor);
        for (got, expected, name, len) in [jacobian, factor] {
            for (i, (a, b)) in got.iter().zip(expected).enumerate() {
                if a.to_bits() != b.to_bits() {
                    let (slot, at) = of_slot(len)(i);
                    first = first.and(self.differs(slot, name, at, *a, *b, 1., tolerance(name), worst));
                }
            }
        }
        for (slot, (a, b)) in got.progress.iter().zip(&expected.state.progress).enumerate() {
            let (a, b): (&[u32], &[u32]) = (bytemuck::cast_slice(bytemuck::bytes_of(a)), bytemuck::cast_slice(bytemuck::bytes_of(b)));
            for (k, name) in PROGRESS.into_iter().enumerate() {
                if k < INTEGERS && a[k] != b[k] {
                    return Err(format!("slot {slot}, {}: {name} is {}, its twin has {}", self.slots[slot].candidate.name, a[k], b[k]));
                }
                if a[k] != b[k] {
                    // Relative to the value alone.
                    let [a, b] = [a[k], b[k]].map(f32::from_bits);
                    first = first.and(self.differs(slot, name, 0, a, b, 0., tolerance(name), worst));
                }
            }
        }
        first
    }

    /// Fails if two floats with different bits differ by more than the tolerance.
    #[allow(clippy::too_many_arguments, reason = "what its message says")]
    pub fn differs(
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
        let worst = worst.entry(name).or_default();
        *worst = worst.max(error as f32);
        // Poison is never within a tolerance; zeros of both signs are equal.
        if error <= f64::from(tolerance) || got == expected {
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

    /// Lists of slots: of each size the last ones in reversed order, so that the first ones are left out.
    pub fn lists(&self) -> Vec<Vec<u32>> {
        let n = self.slots.len();
        let reversed = |count: usize| (n - count..n).rev().map(|s| s as u32).collect();
        if n == CAPACITY { COUNTS.map(reversed).into() } else { vec![reversed(n), reversed(n - 1)] }
    }
}

/// Number of floats between two floats.
pub fn ulps(a: f32, b: f32) -> u64 {
    let order = |v: f32| {
        let bits = i64::from(v.to_bits() & 0x7fff_ffff);
        if v.is_sign_negative() { -bits } else { bits }
    };
    order(a).abs_diff(order(b))
}

/// Name of a shader in the names of its tests.
pub fn stem(shader: Shader) -> &'static str {
    shader.path().rsplit('/').next().unwrap()
}

/// Keeps the largest errors of each shader and prints new maxima; `cargo test -- --nocapture` shows them.
pub fn note(shader: Shader, worst: &BTreeMap<&str, f32>) {
    static WORST: Mutex<BTreeMap<String, f32>> = Mutex::new(BTreeMap::new());
    let mut all = WORST.lock().unwrap();
    for (name, error) in worst {
        let entry = all.entry(format!("{}: {name}", stem(shader))).or_default();
        if *error > *entry {
            *entry = *error;
            eprintln!("worst so far: {}: {name} {error:.2} units", stem(shader));
        }
    }
}

pub fn fill(state: &mut [f32], range: Range<usize>, random: &mut Random, low: f64, high: f64) {
    state[range].iter_mut().for_each(|v| *v = random.between(low, high) as f32);
}

/// Sets slots to every state in turn: those that ended must stay as they are.
pub fn states(lab: &Lab, state: &mut State, of: &[u32]) {
    for (slot, progress) in state.progress.iter_mut().enumerate() {
        progress.state = of[slot % of.len()];
        progress.current = (slot / of.len()) as u32 % 2;
        progress.edge_radius = if slot % 3 == 0 { 0. } else { EDGE_RADIUS as f32 };
        progress.attempts = slot as u32 % 3;
        progress.recorded = slot as u32;
    }
    assert_eq!(state.progress.len(), lab.slots.len());
}
