//! GPU backend: runs the rounds of the CPU for as many candidates at once as the device holds.
//!
//! Each candidate occupies a slot. A submission runs a few rounds of all occupied slots. Then the host reads the progress of each slot and
//! takes out the candidates that have ended. While the device works, the CPU prepares the tables of the next candidates, fills free slots
//! with them, and certifies the motions of those that have ended.

mod cache;
pub mod crossover;
mod device;
pub mod shaders;
mod slots;
mod timer;
mod upload;

pub use cache::Folder;
pub use device::{AdapterReport, Device, Fault, Found};
pub use slots::{List, Prepared, Slots, most_slots};
pub use timer::Timing;

use super::tables::{Buffer, Sizes};
use super::{Backend, Cpu, DeviceChoice, Fallback, Instance, Job, Precision, Solution, locked};
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::nlp::{Curves, Problem, transcription};
use crate::rows::{self, Shared};
use crate::settings::{SolverSettings, TranscriptionSettings};
use crate::solver::control::Progress;
use crate::solver::round::{ROUND, START};
use crate::solver::{Finish, Outcome, Solver, Status, judge};
use crate::task::Task;
use crate::terrain::{Shape, Terrain};
use rayon::prelude::*;
use shaders::Shader;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use timer::Timer;
use tracing::warn;

/// Number of slots on a device with its own memory.
const SLOTS: usize = 2048;
/// Smallest number of slots on a software adapter. More than its threads need make it slower, because they share a cache:
/// on llvmpipe with two threads, 16 slots solve 2.5 candidates/s, 64 slots 1.8.
const SOFTWARE_SLOTS: usize = 16;
/// Number of candidates whose tables are built before the sizes of the slots are chosen.
const SAMPLE: usize = 256;
/// Factor by which slots are larger than the sampled candidates need, to hold larger ones that come later.
const SPARE: f64 = 1.1;
/// Part of the slots that must be free before they are filled. Filling fewer at once takes more submissions.
const REFILL: usize = 8;
/// Shortest and longest duration of a submission; the number of rounds is adapted to it.
const SUBMISSION: [Duration; 2] = [Duration::from_millis(25), Duration::from_millis(80)];
/// Largest number of rounds per submission.
const MOST_ROUNDS: usize = 8;

/// Shaders to dispatch, each over the first so many slots of a list.
type Plan = Vec<(Shader, List, usize)>;

/// Time and memory that a backend's solves used.
#[derive(Debug, Clone, Default)]
pub struct Profile {
    /// Times by shader, if [`Gpu::timed`] was called and the device can time them.
    pub shaders: BTreeMap<&'static str, Timing>,
    /// Time spent waiting for the device, s.
    pub device: f64,
    /// Time spent on building tables, s.
    pub tables: f64,
    /// Time spent on sending tables, s.
    pub sending: f64,
    /// Bytes sent to the device.
    pub sent: u64,
    /// Bytes read back.
    pub received: u64,
    /// Bytes of the buffers.
    pub memory: u64,
    /// Number of slots.
    pub slots: usize,
    /// Number of submissions.
    pub submissions: usize,
    /// Number of rounds.
    pub rounds: usize,
}

/// GPU, and the CPU that takes over if it fails.
#[derive(Debug)]
pub struct Gpu {
    device: Arc<Device>,
    cpu: Cpu,
    slots: Mutex<Option<Slots>>,
    /// Candidates that the CPU had to solve instead, with the reason.
    fallback: Mutex<Option<Fallback>>,
    profile: Mutex<Profile>,
    timed: bool,
    most_slots: usize,
}

impl std::fmt::Debug for Slots {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Slots").field("capacity", &self.capacity).field("bytes", &self.bytes).finish_non_exhaustive()
    }
}

impl Gpu {
    /// Opens the first usable adapter (see [`Device::open`]) and tests it.
    ///
    /// # Errors
    /// [`Error::Device`] if there is no adapter, it cannot be opened, or it computes wrong numbers.
    pub fn open(name: Option<&str>, threads: usize) -> Result<Gpu> {
        Gpu::new(Device::open(name)?, threads)
    }

    /// Tests an opened device and uses it.
    ///
    /// # Errors
    /// [`Error::Device`] if it computes wrong numbers.
    pub fn new(device: Device, threads: usize) -> Result<Gpu> {
        Gpu::beside(Cpu::new(threads)?, device)
    }

    /// Tests an opened device and uses it, with a given CPU that takes over if the device fails.
    ///
    /// # Errors
    /// [`Error::Device`] if it computes wrong numbers.
    pub fn beside(cpu: Cpu, device: Device) -> Result<Gpu> {
        let device = Arc::new(device);
        let most_slots = if device.report.software { SOFTWARE_SLOTS.max(2 * cpu.threads()) } else { SLOTS };
        let gpu =
            Gpu { device, cpu, slots: Mutex::default(), fallback: Mutex::default(), profile: Mutex::default(), timed: false, most_slots };
        gpu.self_test()?;
        Ok(gpu)
    }

    /// Limits the number of candidates that are on the device at once.
    pub fn with_slots(mut self, slots: usize) -> Gpu {
        self.most_slots = slots.max(1);
        self
    }

    /// Times every shader. Each one then runs in its own pass.
    pub fn timed(mut self) -> Gpu {
        self.timed = self.device.timestamps;
        self
    }

    /// Opened device.
    pub fn open_device(&self) -> &Arc<Device> {
        &self.device
    }

    /// Profile since the last call.
    pub fn take_profile(&self) -> Profile {
        std::mem::take(&mut *locked(&self.profile))
    }

    /// Solves a small problem whose result is known. It detects drivers that cut loops short or miscompile, before they spoil results.
    fn self_test(&self) -> Result<()> {
        let failed = |what: String| Error::Device { message: format!("{}: failed its self-test: {what}", self.device.report.name) };
        let (task, schedule) = self_test_problem()?;
        let lower = TranscriptionSettings::default();
        let settings = SolverSettings::default();
        let schedule = schedule.aligned(transcription::interval(&lower, &task.robot));
        let problem = Problem::<f32>::new(&task, &schedule, &lower);
        let instances = [Instance { task: &task, schedule }];
        let answer = Mutex::new(None);
        let job = Job { instances: &instances, transcription: &lower, settings: &settings, precision: Precision::F32, certified: false };
        self.work(&job, &|_| false, &|_, solution| *locked(&answer) = Some(solution), &mut [false]).map_err(|f| failed(f.to_string()))?;
        let answer = locked(&answer).take();
        let Some(Solution { outcome, x, .. }) = answer else { return Err(failed("no answer".into())) };
        // Evaluate the rows at its solution on the CPU.
        let (mut c, mut g) = (vec![0.; problem.rows.one_sided()], vec![0.; problem.inequalities]);
        let mut shared = Shared::default();
        shared.resize(&problem);
        let x: Vec<f32> = x.iter().map(|v| *v as f32).collect();
        rows::residuals(&problem, &x, 0., &mut shared, &mut c, &mut g, None);
        let f = f64::from(judge::infeasibility(&c, &g));
        if outcome.status != Status::Solved || f > 10. * settings.tolerance {
            let expected = Solver::default().solve(&problem, &settings, Finish::Infeasibility(settings.tolerance), None, &|| false);
            let limit = self.device.loop_limit.map_or(String::new(), |n| format!(", the driver ends loops after {n} iterations"));
            return Err(failed(format!("{} at infeasibility {f:.1e}, the CPU: {}{limit}", outcome.status, expected.status)));
        }
        self.take_profile();
        Ok(())
    }

    /// Solves the candidates that the device can solve, and sets `done` for those that need no further work.
    fn work(
        &self,
        job: &Job,
        skip: &(dyn Fn(usize) -> bool + Sync),
        finish: &(dyn Fn(usize, Solution) + Sync),
        done: &mut [bool],
    ) -> std::result::Result<(), Fault> {
        let mut slots = locked(&self.slots);
        let mut run = Work::new(self, job, skip, done);
        let result = self
            .cpu
            .pool()
            .in_place_scope(|scope| run.all(&mut slots, &mut |index, solution| scope.spawn(move |_| finish(index, solution))));
        if let Some(slots) = &mut *slots {
            self.count(slots);
        }
        if result.is_err() {
            // The buffers may be lost.
            *slots = None;
        }
        result
    }

    /// Adds to the profile what slots have transferred.
    fn count(&self, slots: &mut Slots) {
        let mut profile = locked(&self.profile);
        profile.sent += std::mem::take(&mut slots.sent);
        profile.received += std::mem::take(&mut slots.received);
        profile.memory = profile.memory.max(slots.bytes);
        profile.slots = profile.slots.max(slots.capacity);
    }
}

/// Self-test problem: a biped that makes two steps.
fn self_test_problem() -> Result<(Task, Schedule)> {
    let scenario = crate::scenario::Scenario::named("biped")?;
    let mut task = scenario.task(1)?;
    task.goal.position[..2].copy_from_slice(&[0.2, 0.]);
    let schedule = Schedule::new(vec![vec![0.4, 0.2, 0.3, 0.2, 0.3], vec![0.2, 0.2, 0.3, 0.2, 0.5]])?;
    Ok((task, schedule))
}

/// Occupied slot.
#[derive(Debug)]
struct Running {
    slot: u32,
    /// Index of its candidate in the population.
    index: usize,
    /// Number of values of `x`, including the fixed ones.
    len: usize,
    variables: usize,
    curves: Curves,
}

/// State of one call of [`Gpu::work`].
struct Work<'a> {
    gpu: &'a Gpu,
    job: &'a Job<'a>,
    skip: &'a (dyn Fn(usize) -> bool + Sync),
    done: &'a mut [bool],
    /// Samples of all grids, and the offset of those of each terrain.
    heights: Vec<f32>,
    terrains: Vec<(Arc<Terrain>, u32)>,
    /// Index of the first candidate that has no tables yet.
    next: usize,
    prepared: VecDeque<Prepared>,
    running: Vec<Running>,
    /// Candidates that were filled in and have not started.
    starting: Vec<Running>,
    free: Vec<u32>,
    rounds: usize,
}

impl<'a> Work<'a> {
    fn new(gpu: &'a Gpu, job: &'a Job<'a>, skip: &'a (dyn Fn(usize) -> bool + Sync), done: &'a mut [bool]) -> Self {
        let (mut heights, mut terrains): (Vec<f32>, Vec<(Arc<Terrain>, u32)>) = Default::default();
        for instance in job.instances {
            let terrain = &instance.task.terrain;
            if terrains.iter().all(|(known, _)| !Arc::ptr_eq(known, terrain)) {
                terrains.push((terrain.clone(), heights.len() as u32));
                if let Shape::Grid(grid) = &terrain.shape {
                    heights.extend(grid.heights.iter().flatten().map(|h| *h as f32));
                }
            }
        }
        Work {
            gpu,
            job,
            skip,
            done,
            heights,
            terrains,
            next: 0,
            prepared: VecDeque::new(),
            running: Vec::new(),
            starting: Vec::new(),
            free: Vec::new(),
            rounds: 1,
        }
    }

    /// Solves all candidates.
    fn all(&mut self, slots: &mut Option<Slots>, finish: &mut dyn FnMut(usize, Solution)) -> std::result::Result<(), Fault> {
        // A device that was lost in an earlier call makes tables pointless.
        self.gpu.device.check()?;
        // Slots of an earlier call have other heights, and possibly other settings.
        loop {
            self.prepare(SAMPLE);
            let Some(sizes) = self.prepared.iter().map(|p| p.sizes).reduce(|a, b| a.max(b)) else { return Ok(()) };
            self.make_slots(slots, sizes)?;
            let Some(slots) = slots.as_mut() else { return Ok(()) };
            self.free = (0..slots.capacity as u32).rev().collect();
            while self.step(slots, finish)? {}
            debug_assert!(self.running.is_empty());
        }
    }

    /// Builds tables until `count` candidates have theirs, or no candidate is left.
    fn prepare(&mut self, count: usize) {
        let start = Instant::now();
        while self.prepared.len() < count && self.next < self.job.instances.len() {
            let wanted = (count - self.prepared.len()).min(self.job.instances.len() - self.next);
            let indices = self.next..self.next + wanted;
            self.next += wanted;
            let this = &*self;
            let made: Vec<Option<Prepared>> = self.gpu.cpu.pool().install(|| indices.into_par_iter().map(|i| this.tables(i)).collect());
            for (index, prepared) in (self.next - wanted..).zip(made) {
                match prepared {
                    None => self.done[index] = true,
                    // Left for the CPU. The number of loop iterations is estimated from the shader texts; drivers took up to a twentieth
                    // more. The number for a factorisation is an upper bound.
                    Some(Prepared { walk, loops, .. })
                        if self.gpu.device.loop_limit.is_some_and(|limit| walk > limit - limit / 8 || loops > limit) => {}
                    Some(prepared) => self.prepared.push_back(prepared),
                }
            }
        }
        locked(&self.gpu.profile).tables += start.elapsed().as_secs_f64();
    }

    fn tables(&self, index: usize) -> Option<Prepared> {
        if (self.skip)(index) {
            return None;
        }
        let instance = &self.job.instances[index];
        let Job { transcription, settings, .. } = self.job;
        let problem = Problem::<f32>::with_cost(instance.task, &instance.schedule, transcription, settings.optimise.objective());
        let first = self.terrains.iter().find(|(t, _)| Arc::ptr_eq(t, &instance.task.terrain)).map_or(0, |t| t.1);
        Some(Prepared::new(index, problem, first, self.gpu.device.workgroup))
    }

    /// Makes slots for candidates of these sizes: as many as there are candidates left, as the device allows, and as fit into its memory.
    fn make_slots(&mut self, slots: &mut Option<Slots>, sizes: Sizes) -> std::result::Result<(), Fault> {
        let (device, settings) = (&self.gpu.device, self.job.settings);
        let left = self.prepared.len() + self.job.instances.len() - self.next;
        let loops = self.prepared.iter().map(|p| p.loops).max().unwrap_or(0);
        let wanted = self.gpu.most_slots.min(left);
        if let Some(slots) = slots.as_ref()
            && slots.serves(sizes, settings, &self.heights, loops)
            && slots.capacity >= wanted
        {
            return Ok(());
        }
        if let Some(mut old) = slots.take() {
            self.gpu.count(&mut old);
        }
        let sizes = sizes.enlarged(SPARE);
        let mut capacity = wanted.min(most_slots(device, &sizes, settings, self.heights.len()));
        if capacity == 0 {
            return Err(Fault::OutOfMemory);
        }
        loop {
            let loops = (f64::from(loops) * SPARE) as u32;
            match Slots::new(device, sizes, settings, capacity, &self.heights, loops) {
                Ok(made) => {
                    *slots = Some(made);
                    return Ok(());
                }
                Err(Fault::OutOfMemory) if capacity > 1 => capacity /= 2,
                Err(fault) => return Err(fault),
            }
        }
    }

    /// Runs one submission and the host work around it. Returns false if no candidate is running and none fits in.
    fn step(&mut self, slots: &mut Slots, finish: &mut dyn FnMut(usize, Solution)) -> std::result::Result<bool, Fault> {
        let (skip, done, free) = (self.skip, &mut *self.done, &mut self.free);
        self.running.retain(|&Running { slot, index, .. }| {
            let dropped = skip(index);
            if dropped {
                done[index] = true;
                free.push(slot);
            }
            !dropped
        });
        if self.running.is_empty() && self.starting.is_empty() {
            self.fill(slots)?;
        }
        let starting: Vec<u32> = self.starting.iter().map(|r| r.slot).collect();
        self.running.append(&mut self.starting);
        if self.running.is_empty() {
            return Ok(false);
        }
        if !starting.is_empty() {
            slots.list(List::Starting, &starting);
        }
        let list: Vec<u32> = self.running.iter().map(|r| r.slot).collect();
        slots.list(List::Running, &list);
        let mut timer = None;
        let mut encoder = self.gpu.device.device.create_command_encoder(&Default::default());
        let plan = plan(starting.len(), list.len(), self.rounds);
        if self.gpu.timed {
            timer = Some(Timer::new(&self.gpu.device, plan.len()));
        }
        encode(slots, &mut encoder, &plan, timer.as_mut());
        slots.copy_progress(&mut encoder);
        if let Some(timer) = &timer {
            timer.resolve(&mut encoder);
        }
        self.gpu.device.queue.submit([encoder.finish()]);
        let sent = Instant::now();
        // While the device works: build the tables of the next candidates, and fill free slots. The device fills them after these rounds.
        self.prepare(slots.capacity.div_ceil(2));
        if REFILL * self.free.len() >= slots.capacity {
            self.fill(slots)?;
        }
        let waiting = Instant::now();
        let progress = slots.read_progress()?;
        let elapsed = sent.elapsed();
        {
            let mut profile = locked(&self.gpu.profile);
            profile.device += waiting.elapsed().as_secs_f64();
            profile.submissions += 1;
            profile.rounds += self.rounds;
            if let Some(timer) = timer {
                timer.add_to(&mut profile.shaders, plan.iter().map(|p| p.0.path()))?;
            }
        }
        if elapsed < SUBMISSION[0] {
            self.rounds = (2 * self.rounds).min(MOST_ROUNDS);
        } else if elapsed > SUBMISSION[1] {
            self.rounds = (self.rounds / 2).max(1);
        }
        self.collect(slots, &progress, finish)?;
        Ok(true)
    }

    /// Fills free slots. Their candidates start with the next submission.
    fn fill(&mut self, slots: &mut Slots) -> std::result::Result<(), Fault> {
        self.prepare(self.free.len());
        let start = Instant::now();
        let fits = self.prepared.iter().take(self.free.len()).take_while(|p| slots.takes(p)).count();
        let filled: Vec<u32> = self.free.drain(..fits).collect();
        let candidates: Vec<Prepared> = self.prepared.drain(..fits).collect();
        self.starting.extend(filled.iter().zip(&candidates).map(|(&slot, c)| {
            let Problem { variables, ref curves, .. } = c.problem;
            Running { slot, index: c.index, len: c.sizes.all, variables, curves: curves.clone() }
        }));
        self.gpu.cpu.pool().install(|| slots.fill(&filled, &candidates, self.job.settings))?;
        locked(&self.gpu.profile).sending += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Passes on the solutions of candidates that have ended, and frees their slots.
    fn collect(
        &mut self,
        slots: &mut Slots,
        progress: &[Progress<f32>],
        finish: &mut dyn FnMut(usize, Solution),
    ) -> std::result::Result<(), Fault> {
        let all = std::mem::take(&mut self.running).into_iter();
        let (ended, running): (Vec<Running>, Vec<Running>) = all.partition(|r| progress[r.slot as usize].ended());
        self.running = running;
        if ended.is_empty() {
            return Ok(());
        }
        let halves: Vec<(u32, u32)> = ended.iter().map(|r| (r.slot, progress[r.slot as usize].current)).collect();
        let solutions = slots.read_solutions(&halves)?;
        self.free.extend(ended.iter().map(|r| r.slot));
        for (Running { slot, index, len, variables, curves }, x) in ended.into_iter().zip(solutions) {
            let progress = &progress[slot as usize];
            let outcome = Outcome {
                status: Status::of(progress.state).unwrap_or(Status::Stalled),
                iterations: progress.iterations as usize,
                factorisations: progress.factorisations as usize,
                infeasibility: f64::from(progress.infeasibility),
            };
            self.done[index] = true;
            finish(index, Solution { outcome, x: x[..len].iter().map(|v| f64::from(*v)).collect(), variables, curves, closed: false });
        }
        Ok(())
    }
}

/// Shaders of a submission: the start of the slots that were just filled, then rounds of all slots.
fn plan(starting: usize, running: usize, rounds: usize) -> Plan {
    let of = |stages: &mut dyn Iterator<Item = crate::solver::round::Stage>, list: List, count: usize| -> Plan {
        stages.flat_map(Shader::of).map(|shader| (*shader, list, count)).collect()
    };
    let mut plan = if starting > 0 { of(&mut START.into_iter(), List::Starting, starting) } else { Plan::new() };
    for _ in 0..rounds {
        plan.extend(of(&mut ROUND.into_iter().map(|(stage, _)| stage), List::Running, running));
    }
    plan
}

/// Encodes shaders in order: all in one pass, or, if they are timed, each in its own pass.
fn encode(slots: &Slots, encoder: &mut wgpu::CommandEncoder, plan: &Plan, timer: Option<&mut Timer>) {
    match timer {
        None => {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            for (shader, list, count) in plan {
                slots.dispatch(&mut pass, *shader, *list, *count);
            }
        }
        Some(timer) => {
            for (i, (shader, list, count)) in plan.iter().enumerate() {
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                    label: Some(shader.path()),
                    timestamp_writes: Some(timer.writes(i as u32)),
                });
                slots.dispatch(&mut pass, *shader, *list, *count);
            }
        }
    }
}

impl Backend for Gpu {
    fn device(&self) -> String {
        let report = &self.device.report;
        format!("gpu: {} ({}, {})", report.name, report.interface, report.driver)
    }

    fn choice(&self) -> DeviceChoice {
        DeviceChoice::adapter(&self.device.report.name)
    }

    fn fallback(&self) -> Option<Fallback> {
        locked(&self.fallback).clone()
    }

    fn pool(&self) -> &rayon::ThreadPool {
        self.cpu.pool()
    }

    fn solve(&self, job: &Job, skip: &(dyn Fn(usize) -> bool + Sync), finish: &(dyn Fn(usize, Solution) + Sync)) {
        // The shaders exist in f32 only.
        if job.precision == Precision::F64 {
            return self.cpu.solve(job, skip, finish);
        }
        let mut done = vec![false; job.instances.len()];
        let result = self.work(job, skip, finish, &mut done);
        let left: Vec<usize> = (0..done.len()).filter(|i| !done[*i]).collect();
        if !left.is_empty() {
            let fault = result.err().unwrap_or(Fault::LoopLimit);
            let instances: Vec<Instance> = left.iter().map(|i| job.instances[*i].clone()).collect();
            let wanted = left.iter().filter(|i| !skip(**i)).count();
            if wanted > 0 {
                if self.fallback().is_none() {
                    warn!("warning: {fault}; the CPU takes over");
                }
                Fallback::add(&self.fallback, wanted, fault.to_string());
            }
            self.cpu.solve(&Job { instances: &instances, ..*job }, &|i| skip(left[i]), &|i, solution| finish(left[i], solution));
        }
    }
}

/// Access to slots for tests of single shaders.
impl Slots {
    /// Dispatches shaders over a list of slots and waits.
    ///
    /// # Errors
    /// [`Fault`] if the device fails.
    pub fn run(&mut self, device: &Device, shaders: &[Shader], slots: &[u32]) -> std::result::Result<(), Fault> {
        self.list(List::Running, slots);
        let mut encoder = device.device.create_command_encoder(&Default::default());
        let plan: Plan = shaders.iter().map(|s| (*s, List::Running, slots.len())).collect();
        encode(self, &mut encoder, &plan, None);
        device.queue.submit([encoder.finish()]);
        device.wait()
    }

    /// Overwrites a whole buffer of four-byte values.
    pub fn write_buffer(&mut self, device: &Device, buffer: Buffer, bytes: &[u8]) {
        device.queue.write_buffer(self.buffer(buffer), 0, bytes);
    }
}
