// needs: shared/gather
// binds: jacobian tables
// reads: elements factored_instants factored_elements gather_of gathers touches factored_touches
// Right-hand side of the corrector: the transposed Jacobian times the values of the rows, plus the gradient of the terms in single
// variables. One thread per variable, which gathers from the rows that touch it, in row order.
//   in   values           value [rows], gradient [variables]
//   in   jacobian         at the point
//   out  values           right_hand_side [variables]
// Twin: src/linear/transposed.rs, which scatters in the same order

// Product of one column with the values, over the rows of a factored element.
fn of_factored(slot: u32, half: u32, place: Place, column: u32) -> f32 {
    let first = (2u * slot + half) * batch.jacobian + place.jacobian + column;
    let v = slot * batch.values + batch.value + place.row;
    return values[v] * jacobian[first] + values[v + 1u] * jacobian[first + place.stride] + values[v + 2u] * jacobian[first + 2u * place.stride];
}

// Product of one column with the values, over the rows of an element.
fn of_rows(slot: u32, half: u32, element: Element, column: u32) -> f32 {
    let first = (2u * slot + half) * batch.jacobian + element.place.jacobian + column;
    let v = slot * batch.values + batch.value + element.place.row;
    var sum = 0.0;
    for (var r = 0u; r < element.rows; r++) {
        sum += values[v + r] * jacobian[first + r * element.place.stride];
    }
    return sum;
}

// Factor by which an interpolation weight counts: the weight itself.
fn of_weight(weight: f32) -> f32 {
    return weight;
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    if (progress[slot].state != STEP) {
        return;
    }
    let base = slot * batch.values;
    for (var i = lane; i < slots[slot].variables; i += WORKGROUP) {
        let product = gathered(slot, progress[slot].current, i);
        values[base + batch.right_hand_side + i] = product + values[base + batch.gradient + i];
    }
}
