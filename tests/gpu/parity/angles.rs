//! Sine and cosine of shaders, compared with f64.

use super::lab::gpu;
use crate::common::Random;
use cregopt::backend::gpu::shaders::{SHARED, WORKGROUP};
use std::f64::consts::{FRAC_PI_2, PI};

/// Sines and cosines of three angles per invocation.
const MAIN: &str = "
@group(0) @binding(0) var<storage, read> angles: array<f32>;
@group(0) @binding(1) var<storage, read_write> found: array<f32>;

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let first = 3u * id.x;
    if (first >= arrayLength(&angles)) {
        return;
    }
    let turned = sin_cos(vec3<f32>(angles[first], angles[first + 1u], angles[first + 2u]));
    for (var i = 0u; i < 3u; i++) {
        found[2u * (first + i)] = turned.sin[i];
        found[2u * (first + i) + 1u] = turned.cos[i];
    }
}
";

/// Largest errors of sine and cosine, in units in the last place, of angles within half a turn and of others. Two units come from the
/// rounding of the reduced angle and of the sums. Beyond half a turn the product of the number of quarter turns and the low part of a
/// quarter turn is rounded, too, which matters where the reduced angle is close to zero.
const WITHIN_HALF_A_TURN: f64 = 2.;
const BEYOND: f64 = 2.5;

/// Angles within half a turn and within thirty turns, close to zero, and as near to quarter turns as floats get.
fn angles() -> Vec<f32> {
    let mut random = Random::new(5);
    let mut angles = vec![0., -0.];
    for _ in 0..20_000 {
        let size = 10f64.powf(random.between(-30., 0.));
        angles.extend([random.between(-PI, PI), random.between(-190., 190.), size, -size].map(|v| v as f32));
    }
    for quarters in -120..=120 {
        let near = (f64::from(quarters) * FRAC_PI_2) as f32;
        angles.extend([near, near.next_up(), near.next_down(), near * 1.000_01, near + 1e-3]);
        // Points at which the nearest quarter turn changes.
        let between = ((f64::from(quarters) + 0.5) * FRAC_PI_2) as f32;
        angles.extend([between, between.next_up(), between.next_down()]);
    }
    while angles.len() % 3 > 0 {
        angles.push(1.);
    }
    angles
}

#[test]
fn sine_and_cosine_are_within_two_units_in_the_last_place() {
    let Some(device) = gpu("sine_and_cosine_are_within_two_units_in_the_last_place") else { return };
    let angles = angles();
    let math = SHARED.iter().find(|(name, _)| *name == "shared/math").unwrap().1;
    let text = format!("const WORKGROUP: u32 = {WORKGROUP}u;\n{math}{MAIN}");
    let module =
        device.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source: wgpu::ShaderSource::Wgsl(text.into()) });
    let pipeline = device.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: None,
        layout: None,
        module: &module,
        entry_point: Some("main"),
        compilation_options: Default::default(),
        cache: None,
    });
    let buffer = |values: &[f32], usage| {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        let buffer = device.buffer("angles", bytes.len() as u64, wgpu::BufferUsages::COPY_DST | usage).unwrap();
        device.queue.write_buffer(&buffer, 0, bytes);
        buffer
    };
    let nothing = vec![f32::NAN; 2 * angles.len()];
    let given = buffer(&angles, wgpu::BufferUsages::STORAGE);
    let found = buffer(&nothing, wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC);
    let read = buffer(&nothing, wgpu::BufferUsages::MAP_READ);
    let binds = device.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipeline.get_bind_group_layout(0),
        entries: &[
            wgpu::BindGroupEntry { binding: 0, resource: given.as_entire_binding() },
            wgpu::BindGroupEntry { binding: 1, resource: found.as_entire_binding() },
        ],
    });
    let mut encoder = device.device.create_command_encoder(&Default::default());
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &binds, &[]);
        pass.dispatch_workgroups((angles.len() as u32 / 3).div_ceil(WORKGROUP), 1, 1);
    }
    encoder.copy_buffer_to_buffer(&found, 0, &read, 0, read.size());
    device.queue.submit([encoder.finish()]);
    let found: Vec<f32> = bytemuck::pod_collect_to_vec(&device.read(&read, read.size()).unwrap());

    let mut worst = [0f64; 2];
    for (angle, found) in angles.iter().zip(found.as_chunks::<2>().0) {
        let (sine, cosine) = f64::from(*angle).sin_cos();
        for (name, found, expected) in [("sine", found[0], sine), ("cosine", found[1], cosine)] {
            let size = expected.abs() as f32;
            let error = (f64::from(found) - expected).abs() / f64::from(size.next_up() - size);
            let beyond = f64::from(angle.abs()) > PI;
            let limit = if beyond { BEYOND } else { WITHIN_HALF_A_TURN };
            assert!(error <= limit, "{name} of {angle:e} is {found:e} instead of {expected:e}: {error:.2} ulp, {limit} are allowed");
            worst[usize::from(beyond)] = worst[usize::from(beyond)].max(error);
        }
    }
    eprintln!("sine and cosine: {:.2} ulp off within half a turn, {:.2} beyond", worst[0], worst[1]);
}
