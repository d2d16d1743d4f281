//! Uploads of candidates to their slots.
//!
//! All that the device needs of a candidate is packed into one record. A few large copies take the records to the device, where
//! `shaders/upload.wgsl` distributes each among the tables and arrays of its slot. Slots need not be adjacent. The buffers on the host are
//! kept, because memory that a device can read is slow to allocate.

use super::device::{Device, Fault};
use super::slots::{Prepared, bytes_of};
use crate::backend::tables::{ALIGNMENT, Batch, Buffer, Sizes, first_progress};
use crate::rows::table::Wgsl;
use crate::settings::SolverSettings;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use wgpu::BufferUsages as Use;

/// Size of a buffer of records, bytes, unless a single record is larger.
const BYTES: u64 = 64 << 20;
/// Words in front of the sections of a record: the number of its slot. Mapped ranges begin at multiples of 8 bytes.
const HEAD: u32 = 2;

crate::table! {
    /// Place of a section in the records, and in a buffer of the slots.
    #[derive(Default)]
    pub struct Move {
        /// Words of a record.
        pub record: u32,
        /// First word in the record.
        pub at: u32,
        /// First word in the buffer, in slot 0.
        pub first: u32,
        /// Words from one slot to the next in the buffer.
        pub stride: u32,
        /// Number of words.
        pub words: u32,
        /// 1 for a section that becomes 0 and is in no record.
        pub clear: u32,
    }
}

/// Section of a record.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Section {
    Slot,
    Progress,
    Table(Buffer),
    /// From `x` to the smoothing weights.
    FirstValues,
    CostWeights,
    /// Shaders write only Jacobian values that can be nonzero; the others and the padding must be zero.
    Jacobian,
}

impl Section {
    fn buffer(self) -> Buffer {
        match self {
            Section::Slot => Buffer::Slots,
            Section::Progress => Buffer::Progress,
            Section::Table(table) => table,
            Section::FirstValues | Section::CostWeights => Buffer::Values,
            Section::Jacobian => Buffer::Jacobian,
        }
    }

    /// Sections of a batch with their places. The places in the records follow each other.
    fn all(sizes: &Sizes, batch: &Batch) -> Vec<(Section, Move)> {
        let whole = |section: Section| {
            let (buffer, clear) = (section.buffer(), u32::from(section == Section::Jacobian));
            let (first, words) = (batch.first(buffer).unwrap_or(0), (bytes_of(buffer, sizes, batch, 0) / 4) as u32);
            (section, Move { first, stride: words, words, clear, ..Move::default() })
        };
        let of_values = |section: Section, words: Range<u32>| {
            (section, Move { first: words.start, stride: batch.values, words: words.len() as u32, ..Move::default() })
        };
        let tables = Buffer::TABLES.iter().filter(|table| sizes.entries(**table) > 0);
        let mut sections: Vec<(Section, Move)> = [Section::Slot, Section::Progress, Section::Jacobian]
            .into_iter()
            .chain(tables.map(|t| Section::Table(*t)))
            .map(whole)
            .collect();
        sections.push(of_values(Section::FirstValues, batch.x..batch.direction));
        sections.push(of_values(Section::CostWeights, batch.cost_weights..batch.shift_c));
        sections.retain(|(_, place)| place.words > 0);
        let mut record = HEAD;
        for (_, place) in sections.iter_mut().filter(|(_, place)| place.clear == 0) {
            place.at = record;
            record += place.words;
        }
        record = record.next_multiple_of(2);
        sections.iter_mut().for_each(|(_, place)| place.record = record);
        sections
    }

    /// Passes on the pieces of the section of a candidate, each with its first word in it.
    fn pieces(self, candidate: &Prepared, batch: &Batch, settings: &SolverSettings, put: &mut dyn FnMut(u32, &[u8])) {
        let problem = &candidate.problem;
        match self {
            Section::Slot => put(0, bytemuck::bytes_of(&candidate.slot)),
            Section::Progress => put(0, bytemuck::bytes_of(&first_progress(problem, settings))),
            Section::Table(table) => {
                if let Some(table) = table.table(problem, &candidate.own) {
                    put(0, table.bytes);
                }
            }
            Section::FirstValues => {
                put(0, bytemuck::cast_slice(&problem.initial));
                put(batch.initial - batch.x, bytemuck::cast_slice(&problem.initial));
                put(batch.smoothing - batch.x, bytemuck::cast_slice(&problem.smoothing));
            }
            Section::CostWeights => put(0, bytemuck::cast_slice(&problem.cost_weights)),
            // Cleared.
            Section::Jacobian => {}
        }
    }
}

/// Buffer of records that the host can write once it is mapped.
struct Host {
    buffer: wgpu::Buffer,
    mapped: Arc<AtomicBool>,
}

/// Uploads to the slots of one batch.
pub struct Upload {
    pipeline: wgpu::ComputePipeline,
    sections: Vec<(Section, Move)>,
    /// Bind group of each section.
    groups: Vec<wgpu::BindGroup>,
    staged: wgpu::Buffer,
    hosts: Vec<Host>,
    /// Bytes of a record, and number of records in a buffer.
    record: u64,
    records: usize,
}

impl Upload {
    /// * `buffers` - buffers of the slots, in the order of [`Buffer::ALL`]
    /// * `capacity` - number of slots
    pub fn new(device: &Device, buffers: &[wgpu::Buffer], sizes: &Sizes, batch: &Batch, capacity: usize) -> Result<Upload, Fault> {
        let sections = Section::all(sizes, batch);
        let record = sections.first().map_or(0, |(_, place)| 4 * u64::from(place.record));
        let records = (BYTES / record.max(1)).clamp(1, capacity as u64) as usize;
        let staged = device.buffer("staged records", record * records as u64, Use::STORAGE | Use::COPY_DST)?;
        let places = device.buffer("places of sections", ALIGNMENT * sections.len() as u64, Use::UNIFORM | Use::COPY_DST)?;
        for (i, (_, place)) in (0..).zip(&sections) {
            device.queue.write_buffer(&places, ALIGNMENT * i, bytemuck::bytes_of(place));
        }
        let mut structs = Vec::new();
        Move::declare(&mut structs);
        let text: String = structs.into_iter().map(|(_, text)| text).collect();
        let pipeline = device.pipeline("upload", &(text + include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/upload.wgsl"))));
        let layout = pipeline.get_bind_group_layout(0);
        let group = |(i, (section, _)): (u64, &(Section, Move))| {
            let size = std::num::NonZeroU64::new(size_of::<Move>() as u64);
            let place = wgpu::BufferBinding { buffer: &places, offset: ALIGNMENT * i, size };
            let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
            device.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("upload"),
                layout: &layout,
                entries: &[
                    entry(0, wgpu::BindingResource::Buffer(place)),
                    entry(1, staged.as_entire_binding()),
                    entry(2, buffers[section.buffer() as usize].as_entire_binding()),
                ],
            })
        };
        let groups = (0..).zip(&sections).map(group).collect();
        device.check()?;
        Ok(Upload { pipeline, sections, groups, staged, hosts: Vec::new(), record, records })
    }

    /// Fills slots with candidates. Returns the number of bytes sent.
    pub fn fill(
        &mut self,
        device: &Device,
        slots: &[u32],
        candidates: &[Prepared],
        batch: &Batch,
        settings: &SolverSettings,
    ) -> Result<u64, Fault> {
        let mut sent = 0;
        for (slots, candidates) in slots.chunks(self.records).zip(candidates.chunks(self.records)) {
            let host = self.mapped(device)?;
            self.pack(&host.buffer, slots, candidates, batch, settings)?;
            host.buffer.unmap();
            let bytes = self.record * slots.len() as u64;
            let mut encoder = device.device.create_command_encoder(&Default::default());
            encoder.copy_buffer_to_buffer(&host.buffer, 0, &self.staged, 0, bytes);
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&self.pipeline);
            for group in &self.groups {
                pass.set_bind_group(0, group, &[]);
                pass.dispatch_workgroups(slots.len() as u32, 1, 1);
            }
            drop(pass);
            device.queue.submit([encoder.finish()]);
            host.mapped.store(false, Ordering::Relaxed);
            let mapped = host.mapped.clone();
            host.buffer.slice(..).map_async(wgpu::MapMode::Write, move |result| mapped.store(result.is_ok(), Ordering::Release));
            self.hosts.push(host);
            sent += bytes;
        }
        Ok(sent)
    }

    /// Buffer of records that is mapped: one that the device has read, or a new one.
    fn mapped(&mut self, device: &Device) -> Result<Host, Fault> {
        if let Some(at) = self.hosts.iter().position(|host| host.mapped.load(Ordering::Acquire)) {
            return Ok(self.hosts.swap_remove(at));
        }
        let buffer = device.mapped_buffer("records", self.record * self.records as u64, Use::MAP_WRITE | Use::COPY_SRC)?;
        Ok(Host { buffer, mapped: Arc::default() })
    }

    /// Writes records. All threads take part.
    fn pack(
        &self,
        to: &wgpu::Buffer,
        slots: &[u32],
        candidates: &[Prepared],
        batch: &Batch,
        settings: &SolverSettings,
    ) -> Result<(), Fault> {
        let lost = |e: wgpu::MapRangeError| Fault::Lost(e.to_string());
        let views = (0..slots.len() as u64).map(|i| to.get_mapped_range_mut(i * self.record..(i + 1) * self.record).map_err(lost));
        let views = views.collect::<Result<Vec<_>, Fault>>()?;
        views.into_par_iter().zip(slots.par_iter().zip(candidates)).for_each(|(mut view, (slot, candidate))| {
            let mut filled = 0;
            let mut put = |word: u32, bytes: &[u8]| {
                let at = 4 * word as usize;
                // Sections and their pieces follow each other.
                view.slice(filled..at).fill(0);
                filled = at + bytes.len();
                view.slice(at..filled).copy_from_slice(bytes);
            };
            put(0, bytemuck::bytes_of(slot));
            for (section, place) in self.sections.iter().filter(|(_, place)| place.clear == 0) {
                section.pieces(candidate, batch, settings, &mut |word, bytes| put(place.at + word, bytes));
            }
            view.slice(filled..).fill(0);
        });
        Ok(())
    }
}
