// needs: shared/values shared/terrain
// Ground under every foothold, shared by the other kernels. One thread per foothold.
//   in   values    x of the trial point
//   out  values    ground: height, slope x, slope y
// Twin: src/rows/ground.rs

@group(0) @binding(0) var<uniform> batch: Batch;
@group(0) @binding(1) var<storage, read> running: array<u32>;
@group(0) @binding(2) var<storage, read> slots: array<Slot>;
@group(0) @binding(3) var<storage, read> progress: array<Progress>;
@group(0) @binding(4) var<storage, read_write> values: array<f32>;
@group(0) @binding(5) var<storage, read> footholds: array<u32>;
@group(0) @binding(6) var<storage, read> heights: array<f32>;

fn foothold(slot: u32, half: u32, i: u32) {
    let at = ix_x(slot, half) + footholds[slot * batch.footholds + i];
    let under = ground(slots[slot].shape, values[at], values[at + 1u]);
    put_three(ix_ground(slot, i), vec3<f32>(under.height, under.slope));
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    if (progress[slot].state >= ENDED) {
        return;
    }
    let half = 1u - progress[slot].current;
    for (var i = lane; i < slots[slot].footholds; i += WORKGROUP) {
        foothold(slot, half, i);
    }
}
