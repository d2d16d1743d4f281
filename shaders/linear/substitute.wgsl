// needs: shared/pivots
// binds: factor front_steps rests
// Back substitution with the factor: from its right-hand side to the direction. One workgroup per candidate.
//   in   factor  pivot rows and right-hand side
//   out  values  direction [variables]
// Twin: src/linear/substitute.rs. Its sums have another order.

// Element (i, j) of the pivot rows; of the identity matrix beyond the last pivot.
fn pivot_row(rows: u32, at: FrontStep, i: u32, j: u32) -> f32 {
    if (i >= at.pivots || j >= at.pivots) {
        return select(0.0, 1.0, i == j);
    }
    return factor[rows + i * at.stride + j];
}

fn back(slot: u32, at: FrontStep, lane: u32) {
    let direction = slot * batch.values + batch.direction;
    let rows = slot * batch.factor + at.factor;
    for (var a = lane; a < at.size - at.pivots; a += WORKGROUP) {
        local[at.pivots + a] = values[direction + rests[slot * batch.rests + at.rest.start + a].variable];
    }
    workgroupBarrier();
    for (var i = lane; i < at.pivots; i += WORKGROUP) {
        let row = rows + i * at.stride;
        var sum = factor[row + at.size];
        for (var j = at.pivots; j < at.size; j++) {
            sum -= factor[row + j] * local[j];
        }
        local[i] = sum;
    }
    workgroupBarrier();
    // Four pivots at a time; every invocation solves for them redundantly.
    for (var left_over = (at.pivots + 3u) / 4u; left_over > 0u; left_over--) {
        let p = 4u * (left_over - 1u);
        let y3 = left(at, p + 3u) / pivot_row(rows, at, p + 3u, p + 3u);
        let y2 = (left(at, p + 2u) - pivot_row(rows, at, p + 2u, p + 3u) * y3) / pivot_row(rows, at, p + 2u, p + 2u);
        let y1 = (left(at, p + 1u) - pivot_row(rows, at, p + 1u, p + 3u) * y3 - pivot_row(rows, at, p + 1u, p + 2u) * y2)
            / pivot_row(rows, at, p + 1u, p + 1u);
        let y0 = (left(at, p) - pivot_row(rows, at, p, p + 3u) * y3 - pivot_row(rows, at, p, p + 2u) * y2
            - pivot_row(rows, at, p, p + 1u) * y1) / pivot_row(rows, at, p, p);
        workgroupBarrier();
        for (var i = lane; i < p; i += WORKGROUP) {
            local[i] -= pivot_row(rows, at, i, p) * y0 + pivot_row(rows, at, i, p + 1u) * y1
                + pivot_row(rows, at, i, p + 2u) * y2 + pivot_row(rows, at, i, p + 3u) * y3;
        }
        if (lane < min(4u, at.pivots - p)) {
            var y = vec4<f32>(y0, y1, y2, y3);
            values[direction + at.variable + p + lane] = y[lane];
        }
        workgroupBarrier();
    }
    storageBarrier();
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    // In a closing step the substitution after the corrector repeats that of the predictor, with the same result.
    if (progress[slot].state > CLOSE) {
        return;
    }
    for (var k = slots[slot].front_steps; k > 0u; k--) {
        back(slot, front_steps[slot * batch.front_steps + k - 1u], lane);
        workgroupBarrier();
    }
}
