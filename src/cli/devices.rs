//! `devices`: adapters of this machine.

use super::args::{AUTO_BATCH, check_threads};
use super::{Failure, Verdict, print, to_json};
use crate::backend::gpu::crossover::Crossover;
use crate::backend::gpu::{AdapterReport, Device, Folder, Found, Gpu};
use crate::backend::{Backend, Cpu};
use clap::Args;
use serde::Serialize;

#[derive(Debug, Args)]
pub struct Devices {
    /// Open each adapter and have it solve a small problem with a known end
    #[arg(long)]
    test: bool,
    /// Measure again from how many candidates on the adapter of this name is done sooner than the CPU
    #[arg(long, value_name = "NAME")]
    measure: Option<String>,
    /// Threads of the CPU in that; 0 is one a processor
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// What is printed.
#[derive(Serialize)]
struct Report {
    adapters: Vec<Tested>,
    /// What `--device auto` takes for large batches.
    auto: String,
    /// Size from which a batch is large enough to look for a GPU.
    auto_batch: usize,
}

#[derive(Serialize)]
struct Tested {
    #[serde(flatten)]
    adapter: AdapterReport,
    /// `passed`, or why not.
    #[serde(skip_serializing_if = "Option::is_none")]
    self_test: Option<String>,
    /// What was measured, if it was.
    #[serde(skip_serializing_if = "Option::is_none")]
    crossover: Option<Crossover>,
}

impl Devices {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let folder = Folder::of_user();
        let threads = Cpu::new(check_threads(self.threads)?)?.threads();
        // Known below even where nothing is kept.
        let measured = self.measure.as_ref().map(|name| Crossover::measure(&Gpu::open(Some(name), threads)?)).transpose()?;
        if let Some(measured) = &measured {
            measured.keep(&folder);
        }
        let tested = |found: Found| {
            let adapter = found.report.clone();
            // Itself: two may have one name.
            let test = || found.fit().and_then(|fit| Gpu::new(Device::of(fit, folder.clone())?, 1));
            let self_test = self.test.then(|| test().map_or_else(|e| e.to_string(), |_| "passed".into()));
            let own = measured.clone().filter(|m| m.is_of(&adapter, threads));
            let crossover = own.or_else(|| Crossover::known(&folder, &adapter, threads));
            Tested { adapter, self_test, crossover }
        };
        let adapters: Vec<Tested> = Found::all().into_iter().map(tested).collect();
        let taken = adapters.iter().find(|a| !a.adapter.software && a.adapter.unusable.is_none());
        let auto = taken.map_or("cpu".into(), |a| format!("gpu:{}", a.adapter.name));
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
                "    {} KiB workgroup memory, storage bindings of {} MiB, {} a shader\n",
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
            "cpu" => "--device auto takes the CPU; a software adapter has to be asked for: --device gpu\n".to_string(),
            gpu => {
                let name = gpu.strip_prefix("gpu:").unwrap_or(gpu);
                let crossover = self.adapters.iter().find(|a| a.adapter.name == name).and_then(|a| a.crossover.as_ref());
                match crossover.map(|c| c.from) {
                    None => format!("--device auto measures {gpu} when it meets {} candidates at once or more\n", self.auto_batch),
                    Some(None) => "--device auto takes the CPU\n".into(),
                    Some(Some(from)) => {
                        format!("--device auto takes {gpu} from {} candidates at once on, else the CPU\n", from.max(self.auto_batch))
                    }
                }
            }
        }
    }
}
