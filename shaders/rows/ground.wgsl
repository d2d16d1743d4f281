// needs: shared/values shared/terrain
// binds: footholds heights
// Ground under every foothold, shared by the other kernels. One thread per foothold.
//   in   values    x of the trial point
//   out  values    ground: height, slope x, slope y
// Twin: src/rows/ground.rs

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
