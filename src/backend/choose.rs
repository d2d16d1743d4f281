//! Choice of the device that solves: the CPU, a GPU, or whichever is faster for a batch.

use super::{Backend, Cpu, Precision};
use crate::error::{Error, Result};
use std::fmt;
use std::str::FromStr;
use tracing::warn;

/// Batch size from which [`DeviceChoice::Auto`] looks for a GPU. Smaller batches are solved on the CPU before a GPU is open.
pub const AUTO_BATCH: usize = 64;

/// Largest number of threads of the CPU.
const MAX_THREADS: usize = 4096;

/// Devices that can be chosen, for errors.
const CHOICES: &str = "auto, cpu, gpu, or gpu: and part of an adapter's name";

/// Choice of a device. Its text is that of `--device` and of `device` in a scenario file: `auto`, `cpu`, `gpu` or `gpu:NAME`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// A hardware GPU for batches at which it measured faster than the CPU, else the CPU.
    #[default]
    Auto,
    /// The CPU.
    Cpu,
    /// A GPU or a software adapter: the first one, or one whose name contains a text.
    Gpu(Option<String>),
}

impl DeviceChoice {
    /// Choice of the adapter with a name. The name is cut at its first bracket, because a driver puts its version there.
    pub fn adapter(name: &str) -> DeviceChoice {
        DeviceChoice::Gpu(name.split(" (").next().filter(|name| !name.is_empty()).map(Into::into))
    }

    /// Opens the device.
    ///
    /// * `batch` - number of candidates per batch; decides between CPU and GPU for [`DeviceChoice::Auto`]
    /// * `threads` - threads of the CPU; 0: one per processor
    ///
    /// # Errors
    /// [`Error::Invalid`] for too many threads or a GPU in f64; [`Error::Device`] if the chosen adapter is missing or fails its self-test.
    pub fn open(&self, batch: usize, threads: usize, precision: Precision) -> Result<Box<dyn Backend>> {
        let threads = check_threads(threads)?;
        let cpu = || Ok(Box::new(Cpu::new(threads)?) as Box<dyn Backend>);
        match (self, precision) {
            (DeviceChoice::Cpu, _) | (DeviceChoice::Auto, Precision::F64) => cpu(),
            (DeviceChoice::Gpu(_), Precision::F64) => {
                Err(Error::invalid("device", "gpu", "`cpu` or `auto` with precision f64, which only the CPU has"))
            }
            (DeviceChoice::Gpu(name), _) => gpu(name.as_deref(), threads),
            (DeviceChoice::Auto, _) if batch < AUTO_BATCH => cpu(),
            (DeviceChoice::Auto, _) => faster(batch, Cpu::new(threads)?).or_else(|error| {
                warn!("on the CPU: {error}");
                cpu()
            }),
        }
    }
}

impl FromStr for DeviceChoice {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        match text.split_once(':') {
            None if text == "auto" => Ok(DeviceChoice::Auto),
            None if text == "cpu" => Ok(DeviceChoice::Cpu),
            None if text == "gpu" => Ok(DeviceChoice::Gpu(None)),
            Some(("gpu", name)) if !name.is_empty() => Ok(DeviceChoice::Gpu(Some(name.into()))),
            _ => Err(Error::invalid("device", format!("`{}`", text.escape_debug()), CHOICES)),
        }
    }
}

impl fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            DeviceChoice::Auto => f.write_str("auto"),
            DeviceChoice::Cpu => f.write_str("cpu"),
            DeviceChoice::Gpu(None) => f.write_str("gpu"),
            DeviceChoice::Gpu(Some(name)) => write!(f, "gpu:{name}"),
        }
    }
}

/// Checks a number of threads; 0 stands for one per processor.
///
/// # Errors
/// [`Error::Invalid`] for more than 4096.
pub fn check_threads(threads: usize) -> Result<usize> {
    if threads > MAX_THREADS {
        return Err(Error::invalid("threads", threads, format!("at most {MAX_THREADS}")));
    }
    Ok(threads)
}

/// Opens a GPU or a software adapter: the first one, or one of a name.
#[cfg(feature = "gpu")]
fn gpu(name: Option<&str>, threads: usize) -> Result<Box<dyn Backend>> {
    Ok(Box::new(super::Gpu::open(name, threads)?))
}

/// Opens a GPU if it is faster for the batch; returns the CPU otherwise.
#[cfg(feature = "gpu")]
fn faster(batch: usize, cpu: Cpu) -> Result<Box<dyn Backend>> {
    use super::gpu::{Folder, crossover::choose};
    choose(batch, cpu, &Folder::of_user())
}

#[cfg(not(feature = "gpu"))]
fn gpu(_: Option<&str>, _: usize) -> Result<Box<dyn Backend>> {
    Err(Error::Device { message: "this program was built without the feature `gpu`".into() })
}

#[cfg(not(feature = "gpu"))]
fn faster(_: usize, cpu: Cpu) -> Result<Box<dyn Backend>> {
    gpu(None, cpu.threads())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_choice_is_read_back_from_its_text() {
        for text in ["auto", "cpu", "gpu", "gpu:llvmpipe", "gpu:A: B"] {
            assert_eq!(text.parse::<DeviceChoice>().unwrap().to_string(), text);
        }
        for text in ["", "gpuu", "gpu:", "cpu:1", "Auto"] {
            assert!(text.parse::<DeviceChoice>().unwrap_err().to_string().contains("auto, cpu, gpu"), "{text}");
        }
    }

    #[test]
    fn the_choice_of_an_adapter_leaves_out_the_version_of_its_driver() {
        assert_eq!(DeviceChoice::adapter("llvmpipe (LLVM 15.0.6, 256 bits)").to_string(), "gpu:llvmpipe");
        assert_eq!(DeviceChoice::adapter("NVIDIA H100").to_string(), "gpu:NVIDIA H100");
    }

    #[test]
    fn f64_is_refused_on_a_gpu_and_solved_on_the_cpu() {
        assert!(DeviceChoice::Gpu(None).open(1, 1, Precision::F64).is_err());
        assert_eq!(DeviceChoice::Auto.open(AUTO_BATCH, 1, Precision::F64).unwrap().choice(), DeviceChoice::Cpu);
        assert!(DeviceChoice::Cpu.open(1, 5000, Precision::F32).is_err());
    }
}
