// The walk over the table of a shader, whose entries are done by its `entry`. One thread per entry.
//
// `entries` is written in front: how many a candidate has in the table that the shader walks.

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
