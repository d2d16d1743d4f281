//! Execution times of shaders on the device.

use super::device::{Device, Fault};
use std::collections::BTreeMap;
use std::sync::Arc;
use wgpu::BufferUsages as Use;

/// Number of dispatches and total time of one shader.
#[derive(Debug, Clone, Copy, Default)]
pub struct Timing {
    /// Dispatches.
    pub count: usize,
    /// Time on the device, s.
    pub seconds: f64,
}

/// Timestamps of the passes of one submission.
pub(super) struct Timer {
    device: Arc<Device>,
    queries: wgpu::QuerySet,
    count: u32,
    resolved: wgpu::Buffer,
    answer: wgpu::Buffer,
}

impl Timer {
    /// Timer for a number of passes.
    pub fn new(device: &Arc<Device>, passes: usize) -> Timer {
        let count = 2 * passes as u32;
        let buffer = |label, usage| {
            let size = 8 * u64::from(count);
            device.device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
        };
        Timer {
            device: device.clone(),
            queries: device.device.create_query_set(&wgpu::QuerySetDescriptor { label: None, ty: wgpu::QueryType::Timestamp, count }),
            count,
            resolved: buffer("times", Use::QUERY_RESOLVE | Use::COPY_SRC),
            answer: buffer("read times", Use::MAP_READ | Use::COPY_DST),
        }
    }

    /// Timestamp queries of the begin and the end of a pass.
    pub fn writes(&self, pass: u32) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * pass),
            end_of_pass_write_index: Some(2 * pass + 1),
        }
    }

    /// Encodes the copy of the timestamps to a buffer that can be read.
    pub fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.resolve_query_set(&self.queries, 0..self.count, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.answer, 0, self.answer.size());
    }

    /// Adds the times of the passes to those of their shaders.
    pub fn add_to(&self, shaders: &mut BTreeMap<&'static str, Timing>, passes: impl Iterator<Item = &'static str>) -> Result<(), Fault> {
        let times: Vec<u64> = bytemuck::pod_collect_to_vec(&self.device.read(&self.answer, self.answer.size())?);
        let period = f64::from(self.device.queue.get_timestamp_period()) * 1e-9;
        for (name, time) in passes.zip(times.chunks_exact(2)) {
            let timing = shaders.entry(name).or_default();
            timing.count += 1;
            timing.seconds += time[1].saturating_sub(time[0]) as f64 * period;
        }
        Ok(())
    }
}
