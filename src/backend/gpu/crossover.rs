//! From how many candidates at once on a GPU is done sooner than the CPU: measured once for an adapter with its driver, this program and a number
//! of threads, and kept.

use super::kept::Folder;
use super::{AdapterReport, Device, Found, Gpu};
use crate::backend::{Backend, Cpu, Job, Precision, Problem};
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::nlp::transcription;
use crate::scenario::Scenario;
use crate::settings::{SolverSettings, TranscriptionSettings};
use serde::{Deserialize, Serialize};
use std::time::Instant;
use tracing::{debug, info};

/// The file that holds all that were measured.
const FILE: &str = "crossovers.json";

/// Batches that are timed on the device, one after the other until one takes [`LONG`].
const BATCHES: [usize; 5] = [16, 64, 256, 1024, 4096];

/// What is long enough to be measured well, and the last of the batches, s.
const LONG: f64 = 0.3;

/// No batch is larger than this.
const MOST: usize = 1 << 16;

/// What an adapter and the CPU of this machine take for candidates of a quadruped's trot, and from how many on the adapter is sooner done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Crossover {
    /// Name of the adapter.
    pub adapter: String,
    /// Its driver and version.
    pub driver: String,
    /// Version of this program.
    pub version: String,
    /// Threads of the CPU.
    pub threads: usize,
    /// Time of the CPU a candidate, s.
    pub cpu: f64,
    /// Time until the adapter is open and tested, s.
    pub opening: f64,
    /// Batches, and the time that each took on the adapter, s.
    pub gpu: Vec<(usize, f64)>,
    /// Candidates at once from which it is sooner done, opening included; `None`: the CPU is, always.
    pub from: Option<usize>,
}

/// The smallest batch from which on a device is sooner done than the CPU, by straight lines between the batches that were timed and beyond them.
///
/// * `cpu` - time of the CPU a candidate, s
/// * `opening` - time until the device is open, s
/// * `gpu` - growing batches and their times, s
pub fn crossover(cpu: f64, opening: f64, gpu: &[(usize, f64)]) -> Option<usize> {
    let points: Vec<(f64, f64)> = [(0., opening)].into_iter().chain(gpu.iter().map(|(n, t)| (*n as f64, opening + t))).collect();
    let last_slower = points.iter().rposition(|(n, t)| cpu * n <= *t)?;
    // The line on which it overtakes; behind the last point the one before it goes on.
    let right = (last_slower + 1).min(points.len() - 1);
    let [(n0, t0), (n1, t1)] = [*points.get(right.checked_sub(1)?)?, points[right]];
    let slope = (t1 - t0) / (n1 - n0);
    let from = ((t0 - slope * n0) / (cpu - slope)).ceil();
    (slope < cpu && from <= MOST as f64).then_some(from as usize)
}

impl Crossover {
    /// What is kept of an adapter.
    pub fn known(folder: &Folder, adapter: &AdapterReport, threads: usize) -> Option<Crossover> {
        all(folder).into_iter().find(|c| c.is_of(adapter, threads))
    }

    /// Measures, in about a second on a GPU that is worth it.
    ///
    /// # Errors
    /// [`Error::Device`] when the device gives up.
    pub fn measure(gpu: &Gpu) -> Result<Crossover> {
        let report = &gpu.open_device().report;
        let start = Instant::now();
        drop(Gpu::open(Some(&report.name), gpu.threads())?);
        let opening = start.elapsed().as_secs_f64();
        // Compiles what the batches need.
        time(gpu, 1)?;
        let mut times = Vec::new();
        for batch in BATCHES {
            times.push((batch, time(gpu, batch)?));
            if let Some(fallback) = gpu.fallback() {
                return Err(Error::Device { message: format!("{}: {}", report.name, fallback.reason) });
            }
            if times.last().is_some_and(|(_, seconds)| *seconds > LONG) {
                break;
            }
        }
        let candidates = 4 * gpu.threads();
        let each = time(&gpu.cpu, candidates)? / candidates as f64;
        Ok(Crossover {
            adapter: report.name.clone(),
            driver: report.driver.clone(),
            version: env!("CARGO_PKG_VERSION").into(),
            threads: gpu.threads(),
            cpu: each,
            opening,
            from: crossover(each, opening, &times),
            gpu: times,
        })
    }

    /// Keeps it, in the place of an earlier one of the same adapter.
    pub fn keep(&self, folder: &Folder) {
        let of = |c: &Crossover| c.adapter == self.adapter && c.threads == self.threads;
        let mut kept: Vec<Crossover> = all(folder).into_iter().filter(|c| !of(c)).collect();
        kept.push(self.clone());
        if let Ok(text) = serde_json::to_string_pretty(&kept) {
            folder.write(FILE, text.as_bytes());
        }
    }

    /// Whether a batch is sooner done on the adapter.
    pub fn pays(&self, batch: usize) -> bool {
        self.from.is_some_and(|from| batch >= from)
    }

    /// Whether it is of an adapter as it is now, of this program, and of a number of threads.
    pub fn is_of(&self, adapter: &AdapterReport, threads: usize) -> bool {
        let known = (&self.adapter, &self.driver, &self.version[..], self.threads);
        known == (&adapter.name, &adapter.driver, env!("CARGO_PKG_VERSION"), threads)
    }
}

impl std::fmt::Display for Crossover {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.from {
            Some(from) => write!(f, "faster than {} threads from {from} candidates at once on", self.threads)?,
            None => write!(f, "slower than {} threads at any size", self.threads)?,
        }
        let batches: Vec<String> = self.gpu.iter().map(|(n, t)| format!("{n} in {t:.2} s")).collect();
        write!(f, " (opened in {:.2} s, {}; the CPU {:.1} ms a candidate)", self.opening, batches.join(", "), 1e3 * self.cpu)
    }
}

/// All that were kept; none where the file is not what it should be.
fn all(folder: &Folder) -> Vec<Crossover> {
    let Some(bytes) = folder.read(FILE) else { return Vec::new() };
    serde_json::from_slice(&bytes).inspect_err(|e| debug!("measured anew: {FILE}: {e}")).unwrap_or_default()
}

/// Time in which a backend solves a batch of trots, s.
fn time(backend: &dyn Backend, batch: usize) -> Result<f64> {
    let (rows, settings) = (TranscriptionSettings::default(), SolverSettings::default());
    let task = Scenario::named("s1")?.task_to([1., 0.])?;
    let [early, late] = [vec![0.3, 0.3, 0.3, 0.3, 0.6], vec![0.6, 0.3, 0.3, 0.3, 0.3]];
    let trot = Schedule::new(vec![early.clone(), late.clone(), late, early])?.aligned(transcription::interval(&rows, &task.robot));
    let problems = vec![Problem { task: &task, schedule: trot }; batch];
    let job = Job { problems: &problems, transcription: &rows, settings: &settings, precision: Precision::F32, certified: false };
    let start = Instant::now();
    backend.solve(&job, &|_| false, &|_, _| ());
    Ok(start.elapsed().as_secs_f64())
}

/// The first GPU that is none in software where a batch is sooner done on it, otherwise the CPU that was given; measured where that is not known yet.
///
/// # Errors
/// [`Error::Device`] when it is not fit.
pub fn choose(batch: usize, cpu: Cpu, folder: &Folder) -> Result<Box<dyn Backend>> {
    let Some(adapter) = Found::gpu()? else {
        debug!("on the CPU: no adapter is a GPU");
        return Ok(Box::new(cpu));
    };
    let known = Crossover::known(folder, &adapter.report, cpu.threads());
    if let Some(known) = &known {
        debug!("{}: {known}", known.adapter);
        if !known.pays(batch) {
            return Ok(Box::new(cpu));
        }
    }
    let gpu = Gpu::beside(cpu, Device::of(adapter, Folder::of_user())?)?;
    if known.is_none() {
        let measured = Crossover::measure(&gpu)?;
        info!("{}: {measured}", measured.adapter);
        measured.keep(folder);
        if !measured.pays(batch) {
            return Ok(Box::new(gpu.cpu));
        }
    }
    Ok(Box::new(gpu))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_pays_from_where_its_line_crosses_that_of_the_cpu() {
        let ms = 1. / 1024.;
        // 0.5 s to open and 1 ms a candidate against 11 ms.
        assert_eq!(crossover(11. * ms, 0.5, &[(16, 16. * ms), (64, 64. * ms), (256, 256. * ms)]), Some(52));
        // Beyond what was timed the last line goes on: 0.5 s and 128 ms and 1 ms a candidate against 2 ms.
        assert_eq!(crossover(2. * ms, 0.5, &[(16, 144. * ms), (64, 192. * ms)]), Some(640));
        // Fuller batches cost no more: 1 s for any.
        assert_eq!(crossover(8. * ms, 0., &[(16, 1.), (1024, 1.)]), Some(128));
        // With one batch alone, from the time of opening on.
        assert_eq!(crossover(32. * ms, 1., &[(16, 256. * ms)]), Some(64));
    }

    #[test]
    fn a_device_that_never_pays_is_left() {
        assert_eq!(crossover(0.02, 0.3, &[(16, 5.6)]), None);
        // As fast as the CPU, but to be opened.
        assert_eq!(crossover(0.25, 1., &[(16, 4.), (64, 16.)]), None);
        // So late that no batch is as large.
        assert_eq!(crossover(0.001, 100., &[(16, 0.008), (64, 0.032)]), None);
        assert_eq!(crossover(0.001, 1., &[]), None);
    }

    #[test]
    fn a_time_that_is_off_does_not_make_it_pay_too_early() {
        // The second batch took long: what came before does not count.
        assert_eq!(crossover(0.01, 0.1, &[(16, 0.01), (64, 2.), (256, 0.5)]).map(|n| (64..256).contains(&n)), Some(true));
    }

    fn report(name: &str, driver: &str) -> AdapterReport {
        AdapterReport {
            name: name.into(),
            kind: "discrete".into(),
            interface: "vulkan".into(),
            driver: driver.into(),
            software: false,
            workgroup_memory: 0,
            storage_binding: 0,
            storage_buffers: 8,
            unusable: None,
        }
    }

    #[test]
    fn what_was_measured_is_known_of_that_adapter_driver_and_number_of_threads() {
        let folder = tempfile::tempdir().unwrap();
        let kept = Folder::at(folder.path());
        let of = |adapter: &str, from| Crossover {
            adapter: adapter.into(),
            driver: "1.0".into(),
            version: env!("CARGO_PKG_VERSION").into(),
            threads: 2,
            cpu: 0.02,
            opening: 0.5,
            gpu: vec![(16, 0.1), (64, 0.4)],
            from,
        };
        let (first, second) = (report("first", "1.0"), report("second", "1.0"));
        assert_eq!(Crossover::known(&kept, &first, 2), None);
        of("first", Some(100)).keep(&kept);
        of("second", None).keep(&kept);
        of("first", Some(120)).keep(&kept);
        let known = Crossover::known(&kept, &first, 2).unwrap();
        assert_eq!(known, of("first", Some(120)));
        assert!(known.pays(120) && !known.pays(119));
        assert!(!Crossover::known(&kept, &second, 2).unwrap().pays(MOST));
        assert_eq!(Crossover::known(&kept, &first, 4), None);
        assert_eq!(Crossover::known(&kept, &report("first", "1.1"), 2), None);
        let older = Crossover { version: "0.0.1".into(), ..known };
        older.keep(&kept);
        assert_eq!(Crossover::known(&kept, &first, 2), None, "another version's");
        std::fs::write(folder.path().join(FILE), "{").unwrap();
        assert_eq!(Crossover::known(&kept, &second, 2), None);
    }
}
