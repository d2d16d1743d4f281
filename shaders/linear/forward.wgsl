// needs: shared/pivots
// binds: factor front_steps rests
// Forward substitution with the factor, for the right-hand side of the corrector. One workgroup per candidate.
//   in out  values  right_hand_side [variables]
//   in out  factor  pivot rows; the right-hand side in column `size` is replaced
// Twin: src/linear/forward.rs. Its sums have another order.

// Solves for four pivots from `p` on, whose rows begin at `row` of the staged ones, and updates the right-hand side of the others.
fn solve(slot: u32, at: FrontStep, p: u32, row: u32, lane: u32) {
    let s0 = row * SIDE + p;
    let s1 = s0 + SIDE;
    let s2 = s1 + SIDE;
    let s3 = s2 + SIDE;
    // Every invocation solves redundantly.
    let y0 = left(at, p) / staged[s0];
    let y1 = select(0.0, (left(at, p + 1u) - staged[s0 + 1u] * y0) / staged[s1 + 1u], p + 1u < at.pivots);
    let y2 = select(0.0, (left(at, p + 2u) - staged[s0 + 2u] * y0 - staged[s1 + 2u] * y1) / staged[s2 + 2u], p + 2u < at.pivots);
    let y3 = select(
        0.0,
        (left(at, p + 3u) - staged[s0 + 3u] * y0 - staged[s1 + 3u] * y1 - staged[s2 + 3u] * y2) / staged[s3 + 3u],
        p + 3u < at.pivots,
    );
    workgroupBarrier();
    for (var j = min(p + 4u, at.pivots) + lane; j < at.size; j += WORKGROUP) {
        let by = j - p;
        local[j] -= staged[s0 + by] * y0 + staged[s1 + by] * y1 + staged[s2 + by] * y2 + staged[s3 + by] * y3;
    }
    if (lane < min(4u, at.pivots - p)) {
        var y = vec4<f32>(y0, y1, y2, y3);
        factor[slot * batch.factor + at.factor + (p + lane) * at.stride + at.size] = y[lane];
    }
    workgroupBarrier();
}

fn forward(slot: u32, at: FrontStep, lane: u32) {
    let right_hand_side = slot * batch.values + batch.right_hand_side;
    for (var i = lane; i < at.size; i += WORKGROUP) {
        if (i < at.pivots) {
            local[i] = -values[right_hand_side + at.variable + i];
        } else {
            local[i] = 0.0;
        }
    }
    for (var first = 0u; first < at.pivots; first += PANEL_ROWS) {
        stage(slot, at, first, lane);
        for (var p = first; p < min(first + PANEL_ROWS, at.pivots); p += 4u) {
            solve(slot, at, p, p - first, lane);
        }
    }
    for (var a = lane; a < at.size - at.pivots; a += WORKGROUP) {
        values[right_hand_side + rests[slot * batch.rests + at.rest.start + a].variable] -= local[at.pivots + a];
    }
    storageBarrier();
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    if (progress[slot].state != STEP) {
        return;
    }
    for (var k = 0u; k < slots[slot].front_steps; k++) {
        forward(slot, front_steps[slot * batch.front_steps + k], lane);
        workgroupBarrier();
    }
}
