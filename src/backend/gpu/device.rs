//! Adapters of this machine, and an opened one: device, limits and pipelines.

use super::cache::{Folder, Pipelines};
use super::shaders::{Binding, SOFTWARE_WORKGROUP, Shader, Variant, WORKGROUP};
use crate::backend::locked;
use crate::backend::tables::Buffer;
use crate::error::{Error, Result};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, mpsc};

/// Number of loop iterations per invocation after which some software adapters leave every loop.
const LOOP_LIMIT: u32 = 65_535;

/// Smallest binding that a device must support, bytes.
const LEAST_BINDING: u64 = 64 << 20;

/// Number of storage buffers of the shader that binds most.
fn most_buffers() -> u32 {
    Shader::ALL.iter().map(|s| s.buffers().count() as u32).max().unwrap_or(0)
}

/// An adapter of this machine.
#[derive(Debug, Clone, serde::Serialize)]
pub struct AdapterReport {
    /// Name of the adapter.
    pub name: String,
    /// Kind: discrete, integrated, virtual, other or software.
    pub kind: String,
    /// Graphics interface, for example Vulkan.
    pub interface: String,
    /// Driver and its version.
    pub driver: String,
    /// True if it computes on a CPU.
    pub software: bool,
    /// Workgroup memory, bytes.
    pub workgroup_memory: u32,
    /// Largest storage binding, bytes.
    pub storage_binding: u64,
    /// Storage buffers that a shader may bind.
    pub storage_buffers: u32,
    /// Reason why it cannot be used; `None` if it can.
    pub unusable: Option<String>,
}

fn instance() -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    // No flags that depend on how this program was built.
    descriptor.flags = wgpu::InstanceFlags::empty();
    wgpu::Instance::new(descriptor)
}

fn report(adapter: &wgpu::Adapter) -> AdapterReport {
    let (info, limits) = (adapter.get_info(), adapter.limits());
    let kind = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => "discrete",
        wgpu::DeviceType::IntegratedGpu => "integrated",
        wgpu::DeviceType::VirtualGpu => "virtual",
        wgpu::DeviceType::Cpu => "software",
        wgpu::DeviceType::Other => "other",
    };
    let buffers = limits.max_storage_buffers_per_shader_stage;
    let unusable = if buffers < most_buffers() {
        Some(format!("{buffers} storage buffers per shader, but {} are needed", most_buffers()))
    } else if limits.max_storage_buffer_binding_size < LEAST_BINDING {
        Some(format!("storage bindings of {} MiB, but 64 MiB are needed", limits.max_storage_buffer_binding_size >> 20))
    } else {
        None
    };
    AdapterReport {
        name: info.name,
        kind: kind.into(),
        interface: info.backend.to_string(),
        driver: format!("{} {}", info.driver, info.driver_info).trim().into(),
        software: info.device_type == wgpu::DeviceType::Cpu,
        workgroup_memory: limits.max_compute_workgroup_storage_size,
        storage_binding: limits.max_storage_buffer_binding_size,
        storage_buffers: buffers,
        unusable,
    }
}

/// Adapter that is not opened yet.
pub struct Found {
    /// Description of the adapter.
    pub report: AdapterReport,
    adapter: wgpu::Adapter,
}

impl Found {
    /// Adapters of this machine, in the order of preference.
    pub fn all() -> Vec<Found> {
        let instance = instance();
        let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
        let mut all: Vec<_> = adapters.into_iter().map(|adapter| Found { report: report(&adapter), adapter }).collect();
        let rank = |kind: &str| ["discrete", "integrated", "virtual", "other", "software"].iter().position(|k| *k == kind);
        all.sort_by_key(|Found { report, .. }| (report.unusable.is_some(), rank(&report.kind)));
        all
    }

    /// Finds the adapter that [`Device::open`] takes.
    ///
    /// # Errors
    /// [`Error::Device`] lists the adapters found, or says why the adapter cannot be used.
    pub fn find(name: Option<&str>) -> Result<Found> {
        let wanted = name.map(str::to_lowercase);
        let all = Found::all();
        let fits = |r: &AdapterReport| wanted.as_ref().is_none_or(|name| r.name.to_lowercase().contains(name));
        let names: Vec<String> = all.iter().map(|Found { report: r, .. }| format!("{} ({}, {})", r.name, r.kind, r.interface)).collect();
        let list = if names.is_empty() { "no adapter".into() } else { names.join("; ") };
        let Some(found) = all.into_iter().find(|found| fits(&found.report)) else {
            let wanted = name.map_or("a GPU".into(), |n| format!("an adapter named `{n}`"));
            return Err(Error::Device { message: format!("{wanted} was asked for; this machine has {list}") });
        };
        found.fit()
    }

    /// First hardware GPU, or `None`.
    ///
    /// # Errors
    /// [`Error::Device`] says why the GPU cannot be used.
    pub fn gpu() -> Result<Option<Found>> {
        Found::all().into_iter().find(|found| !found.report.software).map(Found::fit).transpose()
    }

    /// Returns the adapter if it can be used.
    ///
    /// # Errors
    /// [`Error::Device`] says why it cannot be used.
    pub fn fit(self) -> Result<Found> {
        match &self.report.unusable {
            Some(why) => Err(Error::Device { message: format!("{} cannot be used: {why}", self.report.name) }),
            None => Ok(self),
        }
    }
}

/// Reason why a device could not continue.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Fault {
    /// Not enough device memory.
    OutOfMemory,
    /// A candidate needs more loop iterations than the driver executes.
    LoopLimit,
    /// The device is lost, or it refused an operation.
    Lost(String),
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Fault::OutOfMemory => f.write_str("the device is out of memory"),
            Fault::LoopLimit => f.write_str("the driver leaves loops early"),
            Fault::Lost(why) => write!(f, "the device was lost: {why}"),
        }
    }
}

/// Compiled shader.
pub struct Pipeline {
    /// Shader that was compiled.
    pub shader: Shader,
    /// Bindings of the shader.
    pub bindings: Vec<Binding>,
    /// Layout of the bindings.
    pub layout: wgpu::BindGroupLayout,
    /// Pipeline for dispatches.
    pub pipeline: wgpu::ComputePipeline,
}

/// Opened device.
pub struct Device {
    /// Description of its adapter.
    pub report: AdapterReport,
    /// Device of wgpu.
    pub device: wgpu::Device,
    /// Queue of the device.
    pub queue: wgpu::Queue,
    /// Limits of the device.
    pub limits: wgpu::Limits,
    /// True if passes can be timed.
    pub timestamps: bool,
    /// Invocations per workgroup.
    pub workgroup: u32,
    /// Limit on the bytes of the buffers of all slots.
    pub memory: u64,
    /// Number of loop iterations after which the driver cuts an invocation short; `None` if it does not.
    pub loop_limit: Option<u32>,
    pipelines: Mutex<BTreeMap<Variant, Arc<Vec<Pipeline>>>>,
    /// Pipelines of earlier runs.
    kept: Option<Pipelines>,
    /// First error that occurred outside of an error scope.
    fault: Arc<Mutex<Option<Fault>>>,
}

impl std::fmt::Debug for Device {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Device").field("report", &self.report).finish_non_exhaustive()
    }
}

fn keep(fault: &Mutex<Option<Fault>>, new: Fault) {
    locked(fault).get_or_insert(new);
}

/// Calls wgpu, which panics if the driver loses its device during the call, and turns such a panic into a fault.
fn outlived<T>(call: impl FnOnce() -> T) -> std::result::Result<T, Fault> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(call)).map_err(|panic| {
        let why = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
        Fault::Lost(why.unwrap_or("a wait ended in a panic").into())
    })
}

impl Device {
    /// Opens the first usable adapter whose name contains `name` (in any case). Without a name, software adapters come last.
    ///
    /// # Errors
    /// [`Error::Device`] lists the adapters found, or says why the adapter could not be opened.
    pub fn open(name: Option<&str>) -> Result<Device> {
        Device::open_with(name, Folder::of_user())
    }

    /// Opens an adapter like [`Device::open`], with another folder for compiled pipelines.
    ///
    /// # Errors
    /// The errors of [`Device::open`].
    pub fn open_with(name: Option<&str>, folder: Folder) -> Result<Device> {
        Device::of(Found::find(name)?, folder)
    }

    /// Opens an adapter.
    ///
    /// # Errors
    /// [`Error::Device`] says why it could not be opened.
    pub fn of(Found { report, adapter }: Found, folder: Folder) -> Result<Device> {
        let refused = |message: String| Error::Device { message: format!("{}: {message}", report.name) };
        let limits = adapter.limits();
        let features = adapter.features() & (wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::PIPELINE_CACHE);
        let request = adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("cregopt"),
            required_features: features,
            required_limits: limits.clone(),
            ..Default::default()
        });
        let (device, queue) = pollster::block_on(request).map_err(|e| refused(e.to_string()))?;
        let fault = Arc::new(Mutex::new(None));
        let to = fault.clone();
        device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| {
            keep(&to, if matches!(e, wgpu::Error::OutOfMemory { .. }) { Fault::OutOfMemory } else { Fault::Lost(e.to_string()) });
        }));
        let to = fault.clone();
        device.set_device_lost_callback(move |reason, message| keep(&to, Fault::Lost(format!("{reason:?} {message}").trim().into())));
        let kept = Pipelines::open(folder, &device, &adapter.get_info());
        let workgroup = if report.software { SOFTWARE_WORKGROUP } else { WORKGROUP.min(limits.max_compute_invocations_per_workgroup) };
        let mut device = Device {
            report,
            workgroup,
            memory: u64::MAX,
            device,
            queue,
            limits,
            timestamps: features.contains(wgpu::Features::TIMESTAMP_QUERY),
            loop_limit: None,
            pipelines: Mutex::default(),
            kept,
            fault,
        };
        let counted = device.count_to(3 * LOOP_LIMIT).map_err(|f| Error::Device { message: format!("{}: {f}", device.report.name) })?;
        if counted != 3 * LOOP_LIMIT {
            device.loop_limit = Some(counted.min(LOOP_LIMIT));
        }
        Ok(device)
    }

    /// Uses workgroups of another size.
    pub fn with_workgroup(mut self, workgroup: u32) -> Device {
        self.workgroup = workgroup;
        self
    }

    /// Variant of the shaders for fronts of a size.
    pub fn variant(&self, front: usize) -> Variant {
        Variant::new(front, self.workgroup, self.limits.max_compute_workgroup_storage_size)
    }

    /// Returns the first error since the last call. After the loss of the device it always returns that error.
    pub fn check(&self) -> std::result::Result<(), Fault> {
        let mut fault = locked(&self.fault);
        match &*fault {
            None => Ok(()),
            // Memory may become available again; a lost device stays lost.
            Some(Fault::OutOfMemory) => Err(fault.take().unwrap_or(Fault::OutOfMemory)),
            Some(lost) => Err(lost.clone()),
        }
    }

    /// Waits until all submitted work is done.
    pub fn wait(&self) -> std::result::Result<(), Fault> {
        let polled = outlived(|| self.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|e| Fault::Lost(e.to_string())));
        if let Err(fault) = polled.and_then(|polled| polled) {
            keep(&self.fault, fault);
        }
        self.check()
    }

    /// Creates a buffer.
    pub fn buffer(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> std::result::Result<wgpu::Buffer, Fault> {
        self.new_buffer(label, size, usage, false)
    }

    /// Creates a buffer that the host can write at once.
    pub fn mapped_buffer(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> std::result::Result<wgpu::Buffer, Fault> {
        self.new_buffer(label, size, usage, true)
    }

    fn new_buffer(&self, label: &str, size: u64, usage: wgpu::BufferUsages, mapped: bool) -> std::result::Result<wgpu::Buffer, Fault> {
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: mapped });
        if pollster::block_on(memory.pop()).is_some() {
            return Err(Fault::OutOfMemory);
        }
        self.check()?;
        Ok(buffer)
    }

    /// Reads the first `len` bytes of a buffer that can be mapped.
    pub fn read(&self, buffer: &wgpu::Buffer, len: u64) -> std::result::Result<Vec<u8>, Fault> {
        let slice = buffer.slice(..len);
        let (answer, answered) = mpsc::channel();
        slice.map_async(wgpu::MapMode::Read, move |result| answer.send(result).unwrap_or(()));
        self.wait()?;
        // Any thread that polls or submits runs the callbacks of all: another thread may be about to run this one.
        match answered.recv() {
            Ok(Ok(())) => {}
            other => return Err(Fault::Lost(format!("a read-back failed: {other:?}"))),
        }
        let bytes = slice.get_mapped_range().map_err(|e| Fault::Lost(e.to_string()))?.to_vec();
        buffer.unmap();
        Ok(bytes)
    }

    fn entry(binding: u32, ty: wgpu::BufferBindingType, has_dynamic_offset: bool) -> wgpu::BindGroupLayoutEntry {
        let ty = wgpu::BindingType::Buffer { ty, has_dynamic_offset, min_binding_size: None };
        wgpu::BindGroupLayoutEntry { binding, visibility: wgpu::ShaderStages::COMPUTE, ty, count: None }
    }

    fn compile(&self, shader: Shader, variant: &Variant) -> std::result::Result<Pipeline, Fault> {
        let label = Some(shader.path());
        let bindings = shader.bindings().map_err(|why| Fault::Lost(format!("{}: {why}", shader.path())))?;
        let entry = |(at, binding): (u32, &Binding)| match binding {
            Binding::Batch => Device::entry(at, wgpu::BufferBindingType::Uniform, false),
            Binding::Part => Device::entry(at, wgpu::BufferBindingType::Uniform, true),
            Binding::Storage(buffer, written) => {
                Device::entry(at, wgpu::BufferBindingType::Storage { read_only: !written }, *buffer == Buffer::Running)
            }
        };
        let entries: Vec<_> = (0..).zip(&bindings).map(entry).collect();
        let layout = self.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label, entries: &entries });
        let text = wgpu::ShaderModuleDescriptor { label, source: wgpu::ShaderSource::Wgsl(shader.text(variant).into()) };
        // SAFETY: every index comes from tables that this crate builds and from counts that belong to them; the parity tests run these
        // shaders.
        let module = unsafe { self.device.create_shader_module_trusted(text, wgpu::ShaderRuntimeChecks::unchecked()) };
        let pipeline_layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label,
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let pipeline = self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label,
            layout: Some(&pipeline_layout),
            module: &module,
            entry_point: Some("main"),
            // Every shader writes its workgroup memory before it reads it.
            compilation_options: wgpu::PipelineCompilationOptions { zero_initialize_workgroup_memory: false, ..Default::default() },
            cache: self.kept.as_ref().map(Pipelines::cache),
        });
        Ok(Pipeline { shader, bindings, layout, pipeline })
    }

    /// Pipelines of a variant, in the order of [`Shader::ALL`]. They are compiled on first use.
    pub fn pipelines(&self, variant: Variant) -> std::result::Result<Arc<Vec<Pipeline>>, Fault> {
        let mut cached = locked(&self.pipelines);
        if let Some(pipelines) = cached.get(&variant) {
            return Ok(pipelines.clone());
        }
        let pipelines = Shader::ALL.par_iter().map(|shader| self.compile(*shader, &variant));
        let pipelines = Arc::new(pipelines.collect::<std::result::Result<Vec<_>, Fault>>()?);
        self.check()?;
        if let Some(kept) = &self.kept {
            kept.save();
        }
        cached.insert(variant, pipelines.clone());
        Ok(pipelines)
    }

    /// Pipeline of a shader that stands alone, with bindings as in its text.
    pub fn pipeline(&self, label: &str, text: &str) -> wgpu::ComputePipeline {
        let source = wgpu::ShaderSource::Wgsl(text.into());
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(label), source });
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(label),
            layout: None,
            module: &module,
            entry_point: Some("main"),
            compilation_options: Default::default(),
            cache: self.kept.as_ref().map(Pipelines::cache),
        })
    }

    /// Lets one invocation count in two loops and returns its count: some drivers leave loops early.
    fn count_to(&self, count: u32) -> std::result::Result<u32, Fault> {
        const TEXT: &str = "
            @group(0) @binding(0) var<storage, read_write> counted: array<u32>;
            @compute @workgroup_size(64)
            fn main(@builtin(local_invocation_index) lane: u32) {
                let count = counted[lane];
                var n = 0u;
                for (var i = 0u; i < count / 2u; i++) { n += 1u + (n >> 31u); }
                for (var i = count / 2u; i < count; i++) { n += 1u + (n >> 31u); }
                counted[lane] = n;
            }";
        let pipeline = self.pipeline("count", TEXT);
        use wgpu::BufferUsages as Use;
        let bytes = 4 * u64::from(WORKGROUP);
        let counted = self.buffer("count", bytes, Use::STORAGE | Use::COPY_DST | Use::COPY_SRC)?;
        let answer = self.buffer("count", bytes, Use::MAP_READ | Use::COPY_DST)?;
        let counts = [count; WORKGROUP as usize];
        self.queue.write_buffer(&counted, 0, bytemuck::cast_slice(&counts));
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: counted.as_entire_binding() }],
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(1, 1, 1);
        drop(pass);
        encoder.copy_buffer_to_buffer(&counted, 0, &answer, 0, bytes);
        self.queue.submit([encoder.finish()]);
        let answer = self.read(&answer, bytes)?;
        Ok(answer.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).min().unwrap_or(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_in_a_wait_is_a_lost_device() {
        assert_eq!(outlived(|| 3), Ok(3));
        let lost = |message: &'static str| outlived(|| std::panic::resume_unwind(Box::new(message.to_string())));
        assert_eq!(lost("no queue"), Err::<(), _>(Fault::Lost("no queue".into())));
    }
}
