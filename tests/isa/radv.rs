//! Shaders compiled for the instruction set of a GPU that is not in this machine. Mesa's driver for AMD cards, RADV, compiles for any of
//! its chips and reports the compiler's statistics of a shader. No shader runs.

use crate::common::{problem_with, reference_candidates, towr};
use ash::{Entry, khr, vk};
use cregopt::backend::gpu::shaders::{Binding, Shader, Variant, WORKGROUP};
use cregopt::backend::tables::{ShaderTables, Sizes};
use cregopt::settings::TranscriptionSettings;
use naga::back::spv;
use naga::proc::{BoundsCheckPolicies, BoundsCheckPolicy};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use std::ffi::CStr;
use std::path::PathBuf;

/// A GPU and the width of its waves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Chip {
    /// RADV's name of the chip.
    pub family: &'static str,
    /// Lanes per wave: 32 or 64.
    pub lanes: u32,
}

/// RDNA 2 in both of its widths, and GCN 5.
pub const CHIPS: [Chip; 3] =
    [Chip { family: "navi21", lanes: 32 }, Chip { family: "navi21", lanes: 64 }, Chip { family: "vega10", lanes: 64 }];

impl std::fmt::Display for Chip {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}, waves of {}", self.family, self.lanes)
    }
}

/// Variant of the shaders, as the program chooses it for the scenario s1.
pub struct Rows {
    /// Name of the transcription.
    pub name: &'static str,
    /// Size of its largest front.
    pub front: usize,
}

impl Rows {
    /// `momentum` and `towr` rows.
    pub fn all() -> [Rows; 2] {
        [TranscriptionSettings::default(), towr()].map(|settings| {
            let of_s1 = reference_candidates().into_iter().filter(|c| c.scenario == "s1");
            let sizes = of_s1.map(|c| {
                let layout = problem_with::<f32>(&c.task, &c.schedule, &settings);
                Sizes::of(&layout, &ShaderTables::of(&layout))
            });
            let largest = sizes.reduce(Sizes::max).unwrap_or_default();
            Rows { name: settings.rows.name(), front: largest.front }
        })
    }

    /// Variant for a GPU with this workgroup memory, bytes.
    pub fn variant(&self, workgroup_memory: u32) -> Variant {
        Variant::new(self.front, WORKGROUP, workgroup_memory)
    }
}

/// Statistics of a compiled shader.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Compiled {
    /// Vector registers per lane.
    pub vector_registers: u64,
    /// Scalar registers per wave.
    pub scalar_registers: u64,
    /// Registers of both kinds that were spilled.
    pub spilled: u64,
    /// Scratch memory, bytes per wave.
    pub scratch: u64,
    /// Workgroup memory, bytes.
    pub workgroup_memory: u64,
    /// Waves that a SIMD holds at once.
    pub waves: u64,
    /// Number of instructions.
    pub instructions: u64,
    /// Cycles from begin to end by the compiler's estimate, which also estimates the trip count of each loop.
    pub latency: u64,
}

/// Folders that list drivers.
const FOLDERS: [&str; 3] = ["/usr/share/vulkan/icd.d", "/usr/local/share/vulkan/icd.d", "/etc/vulkan/icd.d"];

/// The file that names RADV to the Vulkan loader; where there are several, that of this machine's architecture.
///
/// # Errors
/// The folders that were searched, if there is no such file.
fn driver() -> Result<PathBuf, String> {
    let files = FOLDERS.iter().filter_map(|folder| std::fs::read_dir(folder).ok()).flatten().filter_map(|file| Some(file.ok()?.path()));
    let named = |path: &PathBuf| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("radeon_icd"));
    let mut found: Vec<PathBuf> = files.filter(|path| named(path) && path.extension().is_some_and(|e| e == "json")).collect();
    found.sort_by_key(|path| (!path.to_string_lossy().contains(std::env::consts::ARCH), path.clone()));
    found.into_iter().next().ok_or_else(|| format!("no radeon_icd*.json in {}", FOLDERS.join(", ")))
}

/// RADV for one chip.
pub struct Radv {
    device: ash::Device,
    instance: ash::Instance,
    executables: khr::pipeline_executable_properties::Device,
    /// Workgroup memory of the chip, bytes.
    pub workgroup_memory: u32,
    // Owns everything above.
    _entry: Entry,
}

impl Radv {
    /// Opens RADV for a chip. Calls must not overlap, because environment variables select the chip.
    ///
    /// # Errors
    /// The reason: no driver, no loader, or a driver that does not know the chip.
    pub fn open(family: &str) -> Result<Radv, String> {
        let driver = driver()?;
        // SAFETY: Rust's own reads of the environment are behind a lock; the driver reads it below, in this thread.
        unsafe {
            std::env::set_var("VK_ICD_FILENAMES", driver);
            std::env::set_var("NODEVICE_SELECT", "1");
            std::env::set_var("RADV_FORCE_FAMILY", family);
            std::env::set_var("RADV_DEBUG", "nocache");
        }
        // SAFETY: the library is the Vulkan loader, by its name.
        let entry = unsafe { Entry::load() }.map_err(|e| format!("no loader of Vulkan: {e}"))?;
        let refused = |what: &str, e: vk::Result| format!("{what} for {family}: {e}");
        let application = vk::ApplicationInfo::default().api_version(vk::API_VERSION_1_3);
        // SAFETY: no object refers to one that is destroyed before it, here and in the rest of this file.
        unsafe {
            let instance = entry
                .create_instance(&vk::InstanceCreateInfo::default().application_info(&application), None)
                .map_err(|e| refused("no instance", e))?;
            let opened = Radv::device(&instance).map_err(|e| refused("no device", e));
            let (device, workgroup_memory) = opened.inspect_err(|_| instance.destroy_instance(None))?;
            let executables = khr::pipeline_executable_properties::Device::new(&instance, &device);
            Ok(Radv { device, instance, executables, workgroup_memory, _entry: entry })
        }
    }

    /// The first device, with the features that are needed here, and its workgroup memory.
    ///
    /// # Safety
    /// The instance must be alive.
    unsafe fn device(instance: &ash::Instance) -> Result<(ash::Device, u32), vk::Result> {
        let queue = [vk::DeviceQueueCreateInfo::default().queue_priorities(&[1.])];
        let extensions = [khr::pipeline_executable_properties::NAME.as_ptr()];
        let mut executables = vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default().pipeline_executable_info(true);
        let mut memory_model = vk::PhysicalDeviceVulkan12Features::default().vulkan_memory_model(true);
        let mut widths = vk::PhysicalDeviceVulkan13Features::default().subgroup_size_control(true);
        let create = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queue)
            .enabled_extension_names(&extensions)
            .push_next(&mut executables)
            .push_next(&mut memory_model)
            .push_next(&mut widths);
        // SAFETY: the pointers are to the values above.
        unsafe {
            let physical = instance.enumerate_physical_devices()?.into_iter().next().ok_or(vk::Result::ERROR_DEVICE_LOST)?;
            let memory = instance.get_physical_device_properties(physical).limits.max_compute_shared_memory_size;
            Ok((instance.create_device(physical, &create, None)?, memory))
        }
    }

    /// Compiles a shader as the program does.
    ///
    /// # Errors
    /// The fault of the shader, or the driver's refusal.
    pub fn compile(&self, shader: Shader, variant: &Variant, lanes: u32) -> Result<Compiled, String> {
        let refused = |e: vk::Result| format!("{}: {e}", shader.path());
        let words = words(&shader.text(variant)).map_err(|why| format!("{}: {why}", shader.path()))?;
        let kinds = shader.bindings()?.into_iter().map(|binding| match binding {
            Binding::Batch => vk::DescriptorType::UNIFORM_BUFFER,
            Binding::Part => vk::DescriptorType::UNIFORM_BUFFER_DYNAMIC,
            Binding::Storage(..) => vk::DescriptorType::STORAGE_BUFFER,
        });
        let binding = |(number, kind)| {
            let stage = vk::ShaderStageFlags::COMPUTE;
            vk::DescriptorSetLayoutBinding::default().binding(number).descriptor_type(kind).descriptor_count(1).stage_flags(stage)
        };
        let bindings: Vec<_> = (0..).zip(kinds).map(binding).collect();
        let device = &self.device;
        // SAFETY: the handles are those created here; after a refusal the rest is destroyed with the device.
        unsafe {
            let sets = [device
                .create_descriptor_set_layout(&vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings), None)
                .map_err(refused)?];
            let layout =
                device.create_pipeline_layout(&vk::PipelineLayoutCreateInfo::default().set_layouts(&sets), None).map_err(refused)?;
            let module = device.create_shader_module(&vk::ShaderModuleCreateInfo::default().code(&words), None).map_err(refused)?;
            let mut width = vk::PipelineShaderStageRequiredSubgroupSizeCreateInfo::default().required_subgroup_size(lanes);
            let stage = vk::PipelineShaderStageCreateInfo::default()
                .stage(vk::ShaderStageFlags::COMPUTE)
                .module(module)
                .name(c"main")
                .push_next(&mut width);
            let create =
                vk::ComputePipelineCreateInfo::default().flags(vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR).stage(stage).layout(layout);
            let created = device.create_compute_pipelines(vk::PipelineCache::null(), &[create], None);
            let pipeline = created.map_err(|(_, e)| refused(e))?[0];
            let info = vk::PipelineExecutableInfoKHR::default().pipeline(pipeline);
            let statistics = self.executables.get_pipeline_executable_statistics(&info).map_err(refused)?;
            device.destroy_pipeline(pipeline, None);
            device.destroy_shader_module(module, None);
            device.destroy_pipeline_layout(layout, None);
            device.destroy_descriptor_set_layout(sets[0], None);
            compiled(&statistics).map_err(|why| format!("{}: {why}", shader.path()))
        }
    }
}

impl Drop for Radv {
    fn drop(&mut self) {
        // SAFETY: no object that was created with them is in use.
        unsafe {
            self.device.destroy_device(None);
            self.instance.destroy_instance(None);
        }
    }
}

/// Values of the driver's statistics.
fn compiled(statistics: &[vk::PipelineExecutableStatisticKHR]) -> Result<Compiled, String> {
    let of = |wanted: &CStr| {
        let found = statistics.iter().find(|s| s.name_as_c_str().is_ok_and(|name| name == wanted));
        // SAFETY: RADV has 64-bit integers only, as the format says.
        found
            .filter(|s| s.format == vk::PipelineExecutableStatisticFormatKHR::UINT64)
            .map(|s| unsafe { s.value.u64 })
            .ok_or_else(|| format!("the driver does not say its {wanted:?}"))
    };
    Ok(Compiled {
        vector_registers: of(c"VGPRs")?,
        scalar_registers: of(c"SGPRs")?,
        spilled: of(c"Spilled VGPRs")? + of(c"Spilled SGPRs")?,
        scratch: of(c"Scratch size")?,
        workgroup_memory: of(c"LDS size")?,
        waves: of(c"Subgroups per SIMD")?,
        instructions: of(c"Instructions")?,
        latency: of(c"Latency")?,
    })
}

/// SPIR-V of a text, as wgpu makes it for Vulkan 1.3 from a module without run-time checks (`Device::compile` in
/// src/backend/gpu/device.rs).
fn words(text: &str) -> Result<Vec<u32>, String> {
    let module = naga::front::wgsl::parse_str(text).map_err(|e| e.emit_to_string(text))?;
    let info = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module).map_err(|e| e.emit_to_string(text))?;
    let unchecked = BoundsCheckPolicy::Unchecked;
    let options = spv::Options {
        lang_version: (1, 6),
        flags: spv::WriterFlags::LABEL_VARYINGS | spv::WriterFlags::FORCE_POINT_SIZE,
        // Bindings keep their numbers.
        fake_missing_bindings: true,
        capabilities: Some([spv::Capability::Shader, spv::Capability::Matrix].into_iter().collect()),
        bounds_check_policies: BoundsCheckPolicies { index: unchecked, buffer: unchecked, image_load: unchecked, binding_array: unchecked },
        zero_initialize_workgroup_memory: spv::ZeroInitializeWorkgroupMemoryMode::None,
        force_loop_bounding: false,
        emit_int_div_checks: false,
        ..spv::Options::default()
    };
    let pipeline = spv::PipelineOptions { shader_stage: naga::ShaderStage::Compute, entry_point: "main".into() };
    spv::write_vec(&module, &info, &options, Some(&pipeline)).map_err(|e| e.to_string())
}
