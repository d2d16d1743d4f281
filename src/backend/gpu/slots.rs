//! Buffers for a number of candidates, and their operations: filling slots, dispatches, reading results.

use super::device::{Device, Fault, Pipeline};
use super::shaders::{Binding, LEAST_PANEL_ROWS, Shader, Variant};
use super::upload::Upload;
use crate::backend::tables::{ALIGNMENT, Batch, Buffer, FrontRow, Part, ShaderTables, Sizes, Slot, TILE};
use crate::nlp::Problem;
use crate::rows::factored::FactoredTouch;
use crate::settings::SolverSettings;
use crate::solver::control::Progress;
use std::sync::Arc;
use wgpu::BufferUsages as Use;

/// Candidate whose tables are ready to be sent.
pub struct Prepared {
    /// Index in the population.
    pub index: usize,
    /// Tables that CPU and GPU share.
    pub problem: Problem<f32>,
    /// Tables that only shaders use.
    pub own: ShaderTables,
    /// Sizes of the tables and arrays.
    pub sizes: Sizes,
    /// Entry of the buffer `slots`.
    pub slot: Slot,
    /// Upper bound on the loop iterations of an invocation in the costliest step of the factorisation.
    pub loops: u32,
    /// Estimate of the loop iterations of an invocation in the costliest other shader.
    pub walk: u32,
}

impl Prepared {
    /// Builds the tables of a candidate for workgroups of a given size. `first_height` is the offset of its terrain's heights.
    pub fn new(index: usize, problem: Problem<f32>, first_height: u32, workgroup: u32) -> Prepared {
        let own = ShaderTables::of(&problem);
        let sizes = Sizes::of(&problem, &own);
        let slot = Slot::of(&problem, &own, first_height);
        let loops = (0..own.front_steps.len()).map(|step| loops(&own, step, workgroup)).max().unwrap_or(0);
        let walk = walk(&problem, &own, workgroup as usize);
        Prepared { index, problem, own, sizes, slot, loops, walk }
    }
}

/// Upper bound on the loop iterations of an invocation of the shader `front` in one elimination step.
fn loops(own: &ShaderTables, step: usize, workgroup: u32) -> u32 {
    let step = &own.front_steps[step];
    let shares = |n: u32| n / workgroup + 2;
    let tiles = step.size / TILE as u32 + 1;
    let triangle = shares((tiles + 1) * (tiles + 2) / 2);
    let rows = &own.front_rows[step.rows.range()];
    // Any other number of rows needs fewer.
    let team = (workgroup / LEAST_PANEL_ROWS).max(1);
    let panel = |rows: &[FrontRow]| {
        let columns = rows.iter().map(|row| row.columns.end - row.columns.start).max().unwrap_or(0);
        let spread = (rows.len() as u32 * team).div_ceil(workgroup) * (columns / team + 3);
        shares(tiles) * (LEAST_PANEL_ROWS + 2) + spread + triangle * (rows.len() as u32 + 2)
    };
    let panels = rows.chunks(LEAST_PANEL_ROWS as usize).map(panel).sum::<u32>();
    let eliminations = step.pivots.div_ceil(TILE as u32) * (6 * shares(step.size) + 6 * triangle);
    panels + eliminations + 2 * 21 * triangle + 6 * shares(step.size + 4)
}

/// Loop iterations of an invocation of the shader that visits all elements row by row, or of those that gather them by variable; the larger
/// number. Invocations stride by the workgroup size and run in lockstep, so each loop costs its longest trip count plus one exit test.
fn walk(problem: &Problem<f32>, own: &ShaderTables, workgroup: usize) -> u32 {
    let by_element = problem.elements.chunks(workgroup).map(|together| {
        let rows = together.iter().map(|e| e.rows).max().unwrap_or(0);
        let columns = longest(together.iter().map(|e| problem.runs[e.runs.range()].iter().map(|run| run.len)));
        // Three rows at once.
        1 + (rows + 1) + rows.div_ceil(3) * (columns.iter().map(|len| 1 + (len + 1)).sum::<u32>() + 1)
    });
    let by_instant = problem.reach_rows.instants.chunks(workgroup).map(|together| {
        let elements = together.iter().map(|instant| instant.elements.range().len() as u32).max().unwrap_or(0);
        // Blocks of the base; per element the axes, its own columns and rows.
        1 + (4 + 1) + (elements + 1) + elements * ((3 + 1) + (3 + 1 + 3 * 2) + (3 + 1))
    });
    // Per instant: its elements, and the step to the next instant.
    let of_instants = |touch: &FactoredTouch| -> u32 {
        problem.reach_rows.instants[touch.instants.range()].iter().map(|instant| 2 + instant.elements.range().len() as u32).sum()
    };
    let by_variable = own.gather_of.chunks(workgroup).map(|together| {
        let gathers = || together.iter().map(|&gather| &own.gathers[gather as usize]);
        let rows = longest(gathers().map(|g| own.touches[g.touches.range()].iter().map(|t| problem.elements[t.element as usize].rows)));
        let factored = longest(gathers().map(|g| own.factored_touches[g.factored.range()].iter().map(of_instants)));
        1 + rows.iter().chain(&factored).map(|count| 1 + (count + 1)).sum::<u32>() + 2
    });
    // The shader `start` also visits inequalities and values.
    let extra = [problem.inequalities, problem.initial.len()].map(|n| n.div_ceil(workgroup) as u32 + 1);
    (by_element.sum::<u32>() + by_instant.sum::<u32>()).max(by_variable.sum::<u32>() + extra.iter().sum::<u32>()) + 2
}

/// Element-wise maximum of lists of different lengths.
fn longest(lists: impl Iterator<Item = impl Iterator<Item = u32>>) -> Vec<u32> {
    let mut largest: Vec<u32> = Vec::new();
    for list in lists {
        for (i, item) in list.enumerate() {
            match largest.get_mut(i) {
                Some(so_far) => *so_far = item.max(*so_far),
                None => largest.push(item),
            }
        }
    }
    largest
}

/// List of slots that a dispatch works on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum List {
    /// Slots whose candidates iterate.
    Running,
    /// Slots that were just filled.
    Starting,
}

/// Buffers for a number of candidates.
pub struct Slots {
    device: Arc<Device>,
    variant: Variant,
    pipelines: Arc<Vec<Pipeline>>,
    groups: Vec<wgpu::BindGroup>,
    upload: Upload,
    buffers: Vec<wgpu::Buffer>,
    /// Copy of the progress of all slots that the host can read.
    progress: wgpu::Buffer,
    /// Copy of solutions that the host can read.
    solutions: wgpu::Buffer,
    /// Number of slots.
    pub capacity: usize,
    /// Sizes of the largest candidate that fits into a slot.
    pub sizes: Sizes,
    /// Sizes and offsets that shaders read.
    pub batch: Batch,
    /// Bytes of all buffers.
    pub bytes: u64,
    /// Number of factorisation steps per dispatch.
    steps_at_once: u32,
    /// Largest number of loop iterations per factorisation step.
    loops: u32,
    heights: Vec<f32>,
    /// Bytes sent to the device so far.
    pub sent: u64,
    /// Bytes read back so far.
    pub received: u64,
}

/// Bytes per slot in a buffer. For heights, which all slots share, the bytes of the whole buffer.
pub(super) fn bytes_of(buffer: Buffer, sizes: &Sizes, batch: &Batch, heights: usize) -> u64 {
    let entries = |n: u32, size: usize| u64::from(n) * size as u64;
    match buffer {
        Buffer::Running => 4,
        Buffer::Slots => size_of::<Slot>() as u64,
        Buffer::Progress => size_of::<Progress<f32>>() as u64,
        Buffer::Values => entries(batch.values, 4),
        Buffer::Jacobian => entries(batch.jacobian, 8),
        Buffer::Factor => entries(batch.factor, 4),
        Buffer::Heights => 4 * heights.max(1) as u64,
        table => sizes.bytes(table),
    }
}

/// Number of slots of these sizes that the limits of a device allow.
pub fn most_slots(device: &Device, sizes: &Sizes, settings: &SolverSettings, heights: usize) -> usize {
    let variant = device.variant(sizes.front);
    let batch = Batch::new(sizes, settings, variant.front == 0, 1);
    // Shaders count words in 32 bits.
    let limit = device.limits.max_storage_buffer_binding_size.min(device.limits.max_buffer_size).min(4 * u64::from(u32::MAX));
    // Workgroup memory and heights do not depend on the number of slots.
    if variant.workgroup_memory() > device.limits.max_compute_workgroup_storage_size
        || bytes_of(Buffer::Heights, sizes, &batch, heights) > limit
    {
        return 0;
    }
    // Joined tables begin at multiples of the alignment.
    let limit = limit - ALIGNMENT * Buffer::JOINED.len() as u64;
    let slots = |buffer: Buffer| if buffer == Buffer::Heights { u64::MAX } else { limit / bytes_of(buffer, sizes, &batch, heights) };
    let most = Buffer::ALL.iter().map(|b| slots(*b)).min().unwrap_or(0);
    most.min(u64::from(device.limits.max_compute_workgroups_per_dimension)) as usize
}

/// Creates the storage buffers for `capacity` candidates, in the order of [`Buffer::ALL`]. Returns them and their size in bytes.
///
/// * `heights` - number of samples of all grids
fn storage(device: &Device, sizes: &Sizes, batch: &Batch, capacity: usize, heights: usize) -> Result<(Vec<wgpu::Buffer>, u64), Fault> {
    let mut bytes = 0;
    let mut buffers: Vec<wgpu::Buffer> = Vec::new();
    for &buffer in Buffer::ALL {
        if batch.first(buffer).is_some() {
            buffers.push(buffers[Buffer::Tables as usize].clone());
            continue;
        }
        let size = match buffer {
            Buffer::Running => 2 * running_bytes(capacity),
            Buffer::Heights => bytes_of(buffer, sizes, batch, heights),
            Buffer::Tables => {
                let joined = |b: &Buffer| (capacity as u64 * sizes.bytes(*b)).next_multiple_of(ALIGNMENT);
                Buffer::JOINED.iter().map(joined).sum()
            }
            _ => capacity as u64 * bytes_of(buffer, sizes, batch, 0),
        };
        bytes += size;
        if bytes > device.memory {
            return Err(Fault::OutOfMemory);
        }
        buffers.push(device.buffer(buffer.name(), size, Use::STORAGE | Use::COPY_DST | Use::COPY_SRC)?);
    }
    Ok((buffers, bytes))
}

/// Size of one list of running slots, bytes.
fn running_bytes(capacity: usize) -> u64 {
    (4 * capacity as u64).next_multiple_of(ALIGNMENT)
}

/// Uniform buffers of a batch.
struct Uniforms {
    batch: wgpu::Buffer,
    /// Parts of the factorisation, one per dispatch.
    parts: wgpu::Buffer,
}

impl Uniforms {
    /// Creates and fills the buffers.
    ///
    /// * `steps_at_once` - steps of the factorisation per dispatch
    fn new(device: &Device, batch: &Batch, steps_at_once: u32) -> Result<Uniforms, Fault> {
        let uniform = device.buffer("batch", size_of::<Batch>() as u64, Use::UNIFORM | Use::COPY_DST)?;
        device.queue.write_buffer(&uniform, 0, bytemuck::bytes_of(batch));
        let count = batch.front_steps.div_ceil(steps_at_once);
        let parts = device.buffer("part", ALIGNMENT * u64::from(count), Use::UNIFORM | Use::COPY_DST)?;
        for part in 0..count {
            let steps = Part { first: part * steps_at_once, last: (part + 1) * steps_at_once };
            device.queue.write_buffer(&parts, ALIGNMENT * u64::from(part), bytemuck::bytes_of(&steps));
        }
        Ok(Uniforms { batch: uniform, parts })
    }

    /// Part of a buffer that a shader's binding refers to.
    fn bound<'a>(
        &'a self,
        binding: &Binding,
        buffers: &'a [wgpu::Buffer],
        sizes: &Sizes,
        batch: &Batch,
        capacity: usize,
    ) -> wgpu::BufferBinding<'a> {
        let whole = |buffer| wgpu::BufferBinding { buffer, offset: 0, size: None };
        let sized = |buffer, offset, size| wgpu::BufferBinding { buffer, offset, size: std::num::NonZeroU64::new(size) };
        match binding {
            Binding::Batch => whole(&self.batch),
            Binding::Part => sized(&self.parts, 0, size_of::<Part>() as u64),
            Binding::Storage(Buffer::Running, _) => sized(&buffers[Buffer::Running as usize], 0, running_bytes(capacity)),
            Binding::Storage(buffer, _) => match batch.first(*buffer) {
                None => whole(&buffers[*buffer as usize]),
                Some(first) => sized(&buffers[*buffer as usize], 4 * u64::from(first), capacity as u64 * sizes.bytes(*buffer)),
            },
        }
    }
}

impl Slots {
    /// Creates buffers for `capacity` candidates of these sizes.
    ///
    /// * `heights` - samples of all grids
    /// * `loops` - loop iterations of an invocation in the costliest step of a factorisation
    pub fn new(
        device: &Arc<Device>,
        sizes: Sizes,
        settings: &SolverSettings,
        capacity: usize,
        heights: &[f32],
        loops: u32,
    ) -> Result<Slots, Fault> {
        let variant = device.variant(sizes.front);
        let batch = Batch::new(&sizes, settings, variant.front == 0, capacity);
        let pipelines = device.pipelines(variant)?;
        let (buffers, bytes) = storage(device, &sizes, &batch, capacity, heights.len())?;
        if !heights.is_empty() {
            device.queue.write_buffer(&buffers[Buffer::Heights as usize], 0, bytemuck::cast_slice(heights));
        }
        // If the driver cuts loops short, a dispatch takes only as many steps as the driver certainly completes.
        let steps_at_once = device.loop_limit.map_or(batch.front_steps, |limit| (limit / loops.max(1)).clamp(1, batch.front_steps));
        let uniforms = Uniforms::new(device, &batch, steps_at_once)?;
        let bound = |binding: &Binding| uniforms.bound(binding, &buffers, &sizes, &batch, capacity);
        let group = |p: &Pipeline| {
            let resources = p.bindings.iter().map(|b| wgpu::BindingResource::Buffer(bound(b)));
            let entries: Vec<_> = (0..).zip(resources).map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
            let label = Some(p.shader.path());
            device.device.create_bind_group(&wgpu::BindGroupDescriptor { label, layout: &p.layout, entries: &entries })
        };
        let groups = pipelines.iter().map(group).collect();
        let upload = Upload::new(device, &buffers, &sizes, &batch, capacity)?;
        let progress_bytes = (capacity * size_of::<Progress<f32>>()) as u64;
        let progress = device.buffer("read progress", progress_bytes, Use::MAP_READ | Use::COPY_DST)?;
        let solutions = device.buffer("read solutions", 4 * (capacity * sizes.all).max(1) as u64, Use::MAP_READ | Use::COPY_DST)?;
        device.check()?;
        Ok(Slots {
            device: device.clone(),
            variant,
            pipelines,
            groups,
            upload,
            buffers,
            progress,
            solutions,
            capacity,
            sizes,
            batch,
            bytes,
            steps_at_once,
            loops,
            heights: heights.to_vec(),
            sent: 0,
            received: 0,
        })
    }

    /// True if these slots can be reused for candidates of these sizes with these settings.
    pub fn serves(&self, sizes: Sizes, settings: &SolverSettings, heights: &[f32], loops: u32) -> bool {
        let batch = Batch::new(&self.sizes, settings, self.variant.front == 0, self.capacity);
        self.sizes.hold(sizes) && self.batch == batch && self.heights == heights && self.loops >= loops
    }

    /// True if a candidate fits into a slot.
    pub fn takes(&self, candidate: &Prepared) -> bool {
        self.sizes.hold(candidate.sizes) && self.loops >= candidate.loops
    }

    /// Buffer by name. Joined tables share one buffer.
    pub fn buffer(&self, buffer: Buffer) -> &wgpu::Buffer {
        &self.buffers[buffer as usize]
    }

    /// Fills slots with candidates.
    pub fn fill(&mut self, slots: &[u32], candidates: &[Prepared], settings: &SolverSettings) -> Result<(), Fault> {
        self.sent += self.upload.fill(&self.device, slots, candidates, &self.batch, settings)?;
        Ok(())
    }

    /// Writes a list of slots.
    pub fn list(&mut self, list: List, slots: &[u32]) {
        self.device.queue.write_buffer(self.buffer(Buffer::Running), u64::from(self.list_at(list)), bytemuck::cast_slice(slots));
    }

    fn list_at(&self, list: List) -> u32 {
        match list {
            List::Running => 0,
            List::Starting => (4 * self.capacity as u64).next_multiple_of(ALIGNMENT) as u32,
        }
    }

    /// Dispatches one shader over the first `count` slots of a list. Does nothing if no candidate has entries in the shader's table.
    pub fn dispatch(&self, pass: &mut wgpu::ComputePass, shader: Shader, list: List, count: usize) {
        if shader.table().is_some_and(|table| self.sizes.entries(table) == 0) {
            return;
        }
        pass.set_pipeline(&self.pipelines[shader as usize].pipeline);
        let in_parts = self.pipelines[shader as usize].bindings.contains(&Binding::Part);
        let parts = if in_parts { self.batch.front_steps.div_ceil(self.steps_at_once) } else { 1 };
        for part in 0..parts {
            let offsets = [self.list_at(list), part * ALIGNMENT as u32];
            pass.set_bind_group(0, &self.groups[shader as usize], &offsets[..1 + usize::from(in_parts)]);
            pass.dispatch_workgroups(count as u32, 1, 1);
        }
    }

    /// Encodes the copy of the progress of all slots to a buffer that can be read.
    pub fn copy_progress(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.copy_buffer_to_buffer(self.buffer(Buffer::Progress), 0, &self.progress, 0, self.progress.size());
    }

    /// Reads the progress that [`Slots::copy_progress`] copied.
    pub fn read_progress(&mut self) -> Result<Vec<Progress<f32>>, Fault> {
        self.received += self.progress.size();
        Ok(bytemuck::pod_collect_to_vec(&self.device.read(&self.progress, self.progress.size())?))
    }

    /// Reads `x` of slots. Each item is a slot and its current half.
    pub fn read_solutions(&mut self, slots: &[(u32, u32)]) -> Result<Vec<Vec<f32>>, Fault> {
        let len = 4 * self.sizes.all as u64;
        let mut encoder = self.device.device.create_command_encoder(&Default::default());
        for (i, (slot, half)) in slots.iter().enumerate() {
            let at = u64::from(*slot) * u64::from(self.batch.values) + u64::from(self.batch.x + half * self.batch.x_half);
            encoder.copy_buffer_to_buffer(self.buffer(Buffer::Values), 4 * at, &self.solutions, i as u64 * len, len);
        }
        self.device.queue.submit([encoder.finish()]);
        let bytes = self.device.read(&self.solutions, slots.len() as u64 * len)?;
        self.received += bytes.len() as u64;
        let values: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes);
        Ok(values.chunks(self.sizes.all).map(<[f32]>::to_vec).collect())
    }

    /// Reads a whole buffer; for a joined table, all joined tables. For tests.
    pub fn read_buffer(&self, buffer: Buffer) -> Result<Vec<u8>, Fault> {
        let from = self.buffer(buffer);
        let to = self.device.buffer("read", from.size(), Use::MAP_READ | Use::COPY_DST)?;
        let mut encoder = self.device.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(from, 0, &to, 0, from.size());
        self.device.queue.submit([encoder.finish()]);
        self.device.read(&to, from.size())
    }
}
