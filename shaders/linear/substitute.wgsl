// needs: shared/pivots
// binds: factor front_steps rests
// Back substitution with the factor: from its right-hand side to the direction. One workgroup per candidate.
//   in   factor  pivot rows and right-hand side
//   out  values  direction [variables]
// Twin: src/linear/substitute.rs. Its sums have another order.

// Sums of each invocation for a row.
var<workgroup> sums: array<f32, PANEL_ROWS * TEAM>;

// Subtracts the products with the variables from `known` on from the right-hand side of the staged rows.
fn subtract_known(at: FrontStep, first: u32, known: u32, lane: u32) {
    for (var row = lane / TEAM; row < PANEL_ROWS; row += TEAMS) {
        var sum = 0.0;
        for (var j = known + lane % TEAM; j < at.size; j += TEAM) {
            sum += staged[row * SIDE + j] * local[j];
        }
        sums[row * TEAM + lane % TEAM] = sum;
    }
    workgroupBarrier();
    for (var i = first + lane; i < known; i += WORKGROUP) {
        var sum = 0.0;
        for (var member = 0u; member < TEAM; member++) {
            sum += sums[(i - first) * TEAM + member];
        }
        local[i] -= sum;
    }
    workgroupBarrier();
}

// Solves for four pivots from `p` on and subtracts their products from the right-hand side of the staged rows before them.
fn solve(slot: u32, at: FrontStep, first: u32, p: u32, lane: u32) {
    let s0 = (p - first) * SIDE + p;
    let s1 = s0 + SIDE;
    let s2 = s1 + SIDE;
    let s3 = s2 + SIDE;
    // Every invocation solves redundantly. The values beyond the last pivot are zero.
    let y3 = left(at, p + 3u) / staged[s3 + 3u];
    let y2 = (left(at, p + 2u) - staged[s2 + 3u] * y3) / staged[s2 + 2u];
    let y1 = (left(at, p + 1u) - staged[s1 + 3u] * y3 - staged[s1 + 2u] * y2) / staged[s1 + 1u];
    let y0 = (left(at, p) - staged[s0 + 3u] * y3 - staged[s0 + 2u] * y2 - staged[s0 + 1u] * y1) / staged[s0];
    workgroupBarrier();
    for (var i = first + lane; i < p; i += WORKGROUP) {
        let row = (i - first) * SIDE + p;
        local[i] -= staged[row] * y0 + staged[row + 1u] * y1 + staged[row + 2u] * y2 + staged[row + 3u] * y3;
    }
    if (lane < min(4u, at.pivots - p)) {
        var y = vec4<f32>(y0, y1, y2, y3);
        local[p + lane] = y[lane];
        values[slot * batch.values + batch.direction + at.variable + p + lane] = y[lane];
    }
    workgroupBarrier();
}

fn back(slot: u32, at: FrontStep, lane: u32) {
    let direction = slot * batch.values + batch.direction;
    let rows = slot * batch.factor + at.factor;
    for (var i = lane; i < at.size; i += WORKGROUP) {
        if (i < at.pivots) {
            local[i] = factor[rows + i * at.stride + at.size];
        } else {
            local[i] = values[direction + rests[slot * batch.rests + at.rest.start + i - at.pivots].variable];
        }
    }
    for (var chunk = (at.pivots + PANEL_ROWS - 1u) / PANEL_ROWS; chunk > 0u; chunk--) {
        let first = (chunk - 1u) * PANEL_ROWS;
        let known = min(first + PANEL_ROWS, at.pivots);
        stage(slot, at, first, lane);
        subtract_known(at, first, known, lane);
        for (var four = (known - first + 3u) / 4u; four > 0u; four--) {
            solve(slot, at, first, first + 4u * (four - 1u), lane);
        }
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
