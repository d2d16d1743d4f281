// needs: shared/kind shared/gather shared/start_slacks
// binds: jacobian tables
// reads: elements factored_instants factored_elements gather_of gathers touches factored_touches
// Start of a solve, after the rows have been evaluated at the initial point: column scaling, first slacks and multipliers. One workgroup
// per candidate.
//   in      jacobian  at the initial point
//   in out  values    x, whose half of the trial point is filled; scaling [variables]; slack, multiplier [inequalities]
//   in out  progress
// Twin: src/solver/start.rs

// Sum of squares in one column of the rows of a factored element. These rows are two-sided: each counts twice, at half weight.
fn of_factored(slot: u32, half: u32, place: Place, column: u32) -> f32 {
    let first = (2u * slot + half) * batch.jacobian + place.jacobian + column;
    let v = vec3<f32>(jacobian[first], jacobian[first + place.stride], jacobian[first + 2u * place.stride]);
    return dot(v, v);
}

// Weighted sum of squares in one column of the rows of an element: weight 1 for equalities and two-sided rows, 1/2 for one-sided rows, 0
// for costs.
fn of_rows(slot: u32, half: u32, element: Element, column: u32) -> f32 {
    let first = (2u * slot + half) * batch.jacobian + element.place.jacobian + column;
    let kind = row_kind(slots[slot].rows, element.place.row);
    if (kind == COST) {
        return 0.0;
    }
    let twice = select(element.pairs, element.rows, kind == EQUALITY);
    var sum = 0.0;
    for (var r = 0u; r < element.rows; r++) {
        let v = jacobian[first + r * element.place.stride];
        sum += select(0.5, 1.0, r < twice) * v * v;
    }
    return sum;
}

// Factor by which an interpolation weight counts: its square.
fn of_weight(weight: f32) -> f32 {
    return weight * weight;
}

// Scaling of a column: `D_j = sum_eq J_ij^2 + 1/2 sum_ineq J_ij^2`, at least SCALING_FLOOR.
fn column_scaling(slot: u32, half: u32, i: u32) -> f32 {
    return max(gathered(slot, half, i), SCALING_FLOOR);
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    let base = slot * batch.values;
    // The initial point was evaluated as if it were a trial point.
    let half = 1u - progress[slot].current;
    let mu = progress[slot].mu;
    workgroupBarrier();
    for (var i = lane; i < slots[slot].variables; i += WORKGROUP) {
        values[base + batch.scaling + i] = column_scaling(slot, half, i);
    }
    start_slacks(slot, half, lane, slots[slot].inequalities, mu);
    for (var i = lane; i < batch.x_half; i += WORKGROUP) {
        values[base + batch.x + (1u - half) * batch.x_half + i] = values[base + batch.x + half * batch.x_half + i];
    }
    if (lane == 0u) {
        progress[slot].current = half;
        progress[slot].state = STEP;
    }
}
