//! Batch size above which a GPU is faster than the CPU. Measured once per adapter, driver, program version and thread count, then cached.

use super::cache::Folder;
use super::{AdapterReport, Device, Found, Gpu};
use crate::backend::{Backend, Cpu, Instance, Job, Precision};
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::nlp::transcription;
use crate::scenario::Scenario;
use crate::settings::{SolverSettings, TranscriptionSettings};
use serde::{Deserialize, Serialize};
use std::time::Instant;
use tracing::{debug, info};

/// File of all measurements.
const FILE: &str = "crossovers.json";

/// Batch sizes to time on the device, in this order, until one takes [`LONG`].
const BATCHES: [usize; 5] = [16, 64, 256, 1024, 4096];

/// Time that can be measured well, s. The first batch that takes longer is the last one.
const LONG: f64 = 0.3;

/// Largest batch size that counts.
const MOST: usize = 1 << 16;

/// Measured times of an adapter and of this machine's CPU for trots of a quadruped, and the batch size above which the adapter is faster.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Crossover {
    /// Name of the adapter.
    pub adapter: String,
    /// Driver of the adapter and its version.
    pub driver: String,
    /// Version of this program.
    pub version: String,
    /// Number of CPU threads.
    pub threads: usize,
    /// Time of the CPU per candidate, s.
    pub cpu: f64,
    /// Time to open and test the adapter, s.
    pub opening: f64,
    /// Batch sizes and the time of each on the adapter, s.
    pub gpu: Vec<(usize, f64)>,
    /// Smallest batch for which the adapter is faster, including the time to open it; `None` if the CPU is always faster.
    pub from: Option<usize>,
}

/// Smallest batch size above which a device is always faster than the CPU. Times are interpolated linearly between the measured batches and
/// extrapolated beyond them.
///
/// * `cpu` - time of the CPU per candidate, s
/// * `opening` - time to open the device, s
/// * `gpu` - increasing batch sizes and their times, s
pub fn crossover(cpu: f64, opening: f64, gpu: &[(usize, f64)]) -> Option<usize> {
    let points: Vec<(f64, f64)> = [(0., opening)].into_iter().chain(gpu.iter().map(|(n, t)| (*n as f64, opening + t))).collect();
    let last_slower = points.iter().rposition(|(n, t)| cpu * n <= *t)?;
    // Segment on which the device overtakes the CPU; beyond the last point the last segment continues.
    let right = (last_slower + 1).min(points.len() - 1);
    let [(n0, t0), (n1, t1)] = [*points.get(right.checked_sub(1)?)?, points[right]];
    let slope = (t1 - t0) / (n1 - n0);
    let from = ((t0 - slope * n0) / (cpu - slope)).ceil();
    (slope < cpu && from <= MOST as f64).then_some(from as usize)
}

impl Crossover {
    /// Cached measurement of an adapter, or `None`.
    pub fn known(folder: &Folder, adapter: &AdapterReport, threads: usize) -> Option<Crossover> {
        all(folder).into_iter().find(|c| c.is_of(adapter, threads))
    }

    /// Measures an adapter. Takes about a second on a GPU that is worth using.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn measure(gpu: &Gpu) -> Result<Crossover> {
        let report = &gpu.open_device().report;
        let start = Instant::now();
        drop(Gpu::open(Some(&report.name), gpu.threads())?);
        let opening = start.elapsed().as_secs_f64();
        // Compiles the pipelines of the batches.
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

    /// Saves the measurement, which replaces an earlier one of the same adapter and thread count.
    pub fn keep(&self, folder: &Folder) {
        let of = |c: &Crossover| c.adapter == self.adapter && c.threads == self.threads;
        let mut kept: Vec<Crossover> = all(folder).into_iter().filter(|c| !of(c)).collect();
        kept.push(self.clone());
        if let Ok(text) = serde_json::to_string_pretty(&kept) {
            folder.write(FILE, text.as_bytes());
        }
    }

    /// True if the adapter is faster for a batch of this size.
    pub fn pays(&self, batch: usize) -> bool {
        self.from.is_some_and(|from| batch >= from)
    }

    /// True if the measurement belongs to this adapter with its current driver, to this program version and to this number of threads.
    pub fn is_of(&self, adapter: &AdapterReport, threads: usize) -> bool {
        let known = (&self.adapter, &self.driver, &self.version[..], self.threads);
        known == (&adapter.name, &adapter.driver, env!("CARGO_PKG_VERSION"), threads)
    }
}

impl std::fmt::Display for Crossover {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.from {
            Some(from) => write!(f, "faster than {} threads for batches of {from} or more", self.threads)?,
            None => write!(f, "slower than {} threads at any size", self.threads)?,
        }
        let batches: Vec<String> = self.gpu.iter().map(|(n, t)| format!("{n} in {t:.2} s")).collect();
        write!(f, " (opened in {:.2} s, {}; CPU: {:.1} ms per candidate)", self.opening, batches.join(", "), 1e3 * self.cpu)
    }
}

/// All cached measurements; empty if the file cannot be used.
fn all(folder: &Folder) -> Vec<Crossover> {
    let Some(bytes) = folder.read(FILE) else { return Vec::new() };
    serde_json::from_slice(&bytes).inspect_err(|e| debug!("measuring again, {FILE} is not usable: {e}")).unwrap_or_default()
}

/// Time in which a backend solves a batch of trots, s.
fn time(backend: &dyn Backend, batch: usize) -> Result<f64> {
    let (rows, settings) = (TranscriptionSettings::default(), SolverSettings::default());
    let task = Scenario::named("s1")?.task_to([1., 0.])?;
    let [early, late] = [vec![0.3, 0.3, 0.3, 0.3, 0.6], vec![0.6, 0.3, 0.3, 0.3, 0.3]];
    let trot = Schedule::new(vec![early.clone(), late.clone(), late, early])?.aligned(transcription::interval(&rows, &task.robot));
    let instances = vec![Instance { task: &task, schedule: trot }; batch];
    let job = Job { instances: &instances, transcription: &rows, settings: &settings, precision: Precision::F32, certified: false };
    let start = Instant::now();
    backend.solve(&job, &|_| false, &|_, _| ());
    Ok(start.elapsed().as_secs_f64())
}

/// First hardware GPU if it is faster for a batch of this size, otherwise the given CPU. Measures the GPU if no measurement is cached.
///
/// # Errors
/// [`Error::Device`] if the GPU cannot be used.
pub fn choose(batch: usize, cpu: Cpu, folder: &Folder) -> Result<Box<dyn Backend>> {
    let Some(adapter) = Found::gpu()? else {
        debug!("using the CPU: no hardware GPU found");
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
    fn the_crossover_is_where_the_lines_of_device_and_cpu_intersect() {
        let ms = 1. / 1024.;
        // 0.5 s to open and 1 ms per candidate, against 11 ms.
        assert_eq!(crossover(11. * ms, 0.5, &[(16, 16. * ms), (64, 64. * ms), (256, 256. * ms)]), Some(52));
        // Beyond the measured batches the last segment continues: 0.5 s, 128 ms and 1 ms per candidate, against 2 ms.
        assert_eq!(crossover(2. * ms, 0.5, &[(16, 144. * ms), (64, 192. * ms)]), Some(640));
        // Constant time: 1 s for any batch.
        assert_eq!(crossover(8. * ms, 0., &[(16, 1.), (1024, 1.)]), Some(128));
        // A single batch: the line starts at the opening time.
        assert_eq!(crossover(32. * ms, 1., &[(16, 256. * ms)]), Some(64));
    }

    #[test]
    fn a_device_that_is_never_faster_has_no_crossover() {
        assert_eq!(crossover(0.02, 0.3, &[(16, 5.6)]), None);
        // As fast as the CPU per candidate, but it must be opened first.
        assert_eq!(crossover(0.25, 1., &[(16, 4.), (64, 16.)]), None);
        // The crossover is above the largest batch.
        assert_eq!(crossover(0.001, 100., &[(16, 0.008), (64, 0.032)]), None);
        assert_eq!(crossover(0.001, 1., &[]), None);
    }

    #[test]
    fn an_outlier_does_not_place_the_crossover_too_low() {
        // The second batch took long: the batch before it does not count.
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
    fn a_measurement_is_found_by_adapter_driver_version_and_number_of_threads() {
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
        assert_eq!(Crossover::known(&kept, &first, 2), None, "measured by another version");
        std::fs::write(folder.path().join(FILE), "{").unwrap();
        assert_eq!(Crossover::known(&kept, &second, 2), None);
    }
}
