// Entry point of a shader that has an `entry` function: one thread per entry of the shader's table.
//
// The function `entries` is generated: it returns the number of entries that a candidate has in that table.

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    if (progress[slot].state >= ENDED) {
        return;
    }
    let half = 1u - progress[slot].current;
    for (var i = lane; i < entries(slot); i += WORKGROUP) {
        entry(slot, half, i);
    }
}
