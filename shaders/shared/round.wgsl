// The progress of a candidate as all invocations of its workgroup see it, whichever of them writes it later.

var<workgroup> at_start: Progress;

// The progress before anything of this shader is done. Every invocation of the workgroup must come here.
fn progress_at_start(slot: u32, lane: u32) -> Progress {
    if (lane == 0u) {
        at_start = progress[slot];
    }
    return workgroupUniformLoad(&at_start);
}
