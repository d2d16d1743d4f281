//! `devices`: lists the GPU adapters of this machine.

use super::{Failure, Verdict, print, to_json};
use crate::backend::choose::{AUTO_BATCH, check_threads};
use crate::backend::gpu::crossover::Crossover;
use crate::backend::gpu::{AdapterReport, Device, Folder, Found, Gpu};
use crate::backend::{Backend, Cpu, DeviceChoice};
use clap::Args;
use serde::Serialize;

#[derive(Debug, Args)]
pub struct Devices {
    /// Open each adapter and test it on a small problem with a known solution
    #[arg(long)]
    test: bool,
    /// Re-measure the batch size above which this adapter is faster than the CPU
    #[arg(long, value_name = "NAME")]
    measure: Option<String>,
    /// Threads of the CPU in that measurement; 0: one per processor
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Output of the command.
#[derive(Serialize)]
struct Report {
    adapters: Vec<Tested>,
    /// Device that `--device auto` uses for large batches.
    auto: String,
    /// Batch size from which `--device auto` looks for a GPU.
    auto_batch: usize,
}

#[derive(Serialize)]
struct Tested {
    #[serde(flatten)]
    adapter: AdapterReport,
    /// `passed`, or the reason of the failure.
    #[serde(skip_serializing_if = "Option::is_none")]
    self_test: Option<String>,
    /// Measurement against the CPU, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    crossover: Option<Crossover>,
}

impl Devices {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let folder = Folder::of_user();
        let threads = Cpu::new(check_threads(self.threads)?)?.threads();
        // Held here, because there may be no cache.
        let measured = self.measure.as_ref().map(|name| Crossover::measure(&Gpu::open(Some(name), threads)?)).transpose()?;
        if let Some(measured) = &measured {
            measured.keep(&folder);
        }
        let tested = |found: Found| {
            let adapter = found.report.clone();
            // The adapter itself, because two adapters may have the same name.
            let test = || found.fit().and_then(|fit| Gpu::new(Device::of(fit, folder.clone())?, 1));
            let self_test = self.test.then(|| test().map_or_else(|e| e.to_string(), |_| "passed".into()));
            let own = measured.clone().filter(|m| m.is_of(&adapter, threads));
            let crossover = own.or_else(|| Crossover::known(&folder, &adapter, threads));
            Tested { adapter, self_test, crossover }
        };
        let adapters: Vec<Tested> = Found::all().into_iter().map(tested).collect();
        let taken = adapters.iter().find(|a| !a.adapter.software && a.adapter.unusable.is_none());
        let auto = taken.map_or(DeviceChoice::Cpu, |a| DeviceChoice::Gpu(Some(a.adapter.name.clone()))).to_string();
        let report = Report { adapters, auto, auto_batch: AUTO_BATCH };
        print(&if self.json { to_json(&report)? } else { report.text() })?;
        Ok(Verdict::Feasible)
    }
}

impl Report {
    fn text(&self) -> String {
        let mut text = String::new();
        for Tested { adapter: a, self_test, crossover } in &self.adapters {
            text += &format!("{} ({}, {}, {})\n", a.name, a.kind, a.interface, a.driver);
            text += &format!(
                "    {} KiB of workgroup memory, storage bindings of {} MiB, {} per shader\n",
                a.workgroup_memory >> 10,
                a.storage_binding >> 20,
                a.storage_buffers
            );
            if let Some(why) = &a.unusable {
                text += &format!("    cannot be used: {why}\n");
            }
            if let Some(result) = self_test {
                text += &format!("    self-test: {result}\n");
            }
            if let Some(crossover) = crossover {
                text += &format!("    {crossover}\n");
            }
        }
        if self.adapters.is_empty() {
            text += "no adapter: a Vulkan, Metal or DX12 driver is needed\n";
        }
        text + &match self.auto.as_str() {
            "cpu" => "--device auto takes the CPU; --device gpu selects a software adapter\n".to_string(),
            gpu => {
                let name = gpu.strip_prefix("gpu:").unwrap_or(gpu);
                let crossover = self.adapters.iter().find(|a| a.adapter.name == name).and_then(|a| a.crossover.as_ref());
                match crossover.map(|c| c.from) {
                    None => format!("--device auto measures {gpu} at the first batch of {} candidates or more\n", self.auto_batch),
                    Some(None) => "--device auto takes the CPU\n".into(),
                    Some(Some(from)) => {
                        format!("--device auto takes {gpu} for batches of {} candidates or more, else the CPU\n", from.max(self.auto_batch))
                    }
                }
            }
        }
    }
}
