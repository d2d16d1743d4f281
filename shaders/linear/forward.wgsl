// needs: shared/pivots
// binds: factor front_steps rests
// Forward substitution with the factor, for the right-hand side of the corrector. One workgroup per candidate.
//   in out  values  right_hand_side [variables]
//   in out  factor  pivot rows; the right-hand side in column `size` is replaced
// Twin: src/linear/forward.rs. Its sums have another order.

// Element (i, j) of the pivot rows; of the identity matrix beyond the last pivot.
fn pivot_row(rows: u32, at: FrontStep, i: u32, j: u32) -> f32 {
    if (i >= at.pivots) {
        return select(0.0, 1.0, i == j);
    }
    return factor[rows + i * at.stride + j];
}

fn forward(slot: u32, at: FrontStep, lane: u32) {
    let right_hand_side = slot * batch.values + batch.right_hand_side;
    let rows = slot * batch.factor + at.factor;
    for (var i = lane; i < at.size; i += WORKGROUP) {
        if (i < at.pivots) {
            local[i] = -values[right_hand_side + at.variable + i];
        } else {
            local[i] = 0.0;
        }
    }
    workgroupBarrier();
    // Four pivots at a time; every invocation solves for them redundantly.
    for (var p = 0u; p < at.pivots; p += 4u) {
        let y0 = left(at, p) / pivot_row(rows, at, p, p);
        let y1 = (left(at, p + 1u) - pivot_row(rows, at, p, p + 1u) * y0) / pivot_row(rows, at, p + 1u, p + 1u);
        let y2 = (left(at, p + 2u) - pivot_row(rows, at, p, p + 2u) * y0 - pivot_row(rows, at, p + 1u, p + 2u) * y1)
            / pivot_row(rows, at, p + 2u, p + 2u);
        let y3 = (left(at, p + 3u) - pivot_row(rows, at, p, p + 3u) * y0 - pivot_row(rows, at, p + 1u, p + 3u) * y1
            - pivot_row(rows, at, p + 2u, p + 3u) * y2) / pivot_row(rows, at, p + 3u, p + 3u);
        workgroupBarrier();
        for (var j = p + 4u + lane; j < at.size; j += WORKGROUP) {
            local[j] -= pivot_row(rows, at, p, j) * y0 + pivot_row(rows, at, p + 1u, j) * y1
                + pivot_row(rows, at, p + 2u, j) * y2 + pivot_row(rows, at, p + 3u, j) * y3;
        }
        // If the last four rows extend beyond the pivots, the columns there must be updated as well.
        for (var j = at.pivots + lane; j < min(p + 4u, at.size); j += WORKGROUP) {
            local[j] -= pivot_row(rows, at, p, j) * y0
                + select(0.0, pivot_row(rows, at, p + 1u, j) * y1, p + 1u < at.pivots)
                + select(0.0, pivot_row(rows, at, p + 2u, j) * y2, p + 2u < at.pivots);
        }
        if (lane < min(4u, at.pivots - p)) {
            var y = vec4<f32>(y0, y1, y2, y3);
            factor[rows + (p + lane) * at.stride + at.size] = y[lane];
        }
        workgroupBarrier();
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
