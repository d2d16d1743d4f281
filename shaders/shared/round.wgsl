// Snapshot of a candidate's progress that is the same for all invocations of its workgroup, even if one of them writes it later.

var<workgroup> at_start: Progress;

// Progress before this shader changes it. Every invocation of the workgroup must call this function.
fn progress_at_start(slot: u32, lane: u32) -> Progress {
    if (lane == 0u) {
        at_start = progress[slot];
    }
    return workgroupUniformLoad(&at_start);
}
