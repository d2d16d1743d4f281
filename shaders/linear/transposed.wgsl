// binds: jacobian elements gathers touches
// Right-hand side of the corrector: the transposed Jacobian times the values of the rows, and what falls on single variables. One thread a
// variable, which gathers from the elements that touch it, in their order.
//   in   values           value [rows], gradient [variables]
//   in   jacobian         at the point
//   out  values           right_hand_side [variables]
// Twin: src/linear/transposed.rs, which scatters in the same order

// Product of the column of variable `i` with the values.
fn transposed_times(slot: u32, half: u32, i: u32) -> f32 {
    let value = slot * batch.values + batch.value;
    let gather = gathers[slot * batch.gathers + i];
    var sum = 0.0;
    for (var k = gather.touches.start; k < gather.touches.end; k++) {
        let touch = touches[slot * batch.touches + k];
        var local = 0.0;
        for (var e = 0u; e < touch.count; e++) {
            let element = elements[slot * batch.elements + touch.element + e];
            let column = (2u * slot + half) * batch.jacobian + element.place.jacobian + touch.column + gather.offset;
            let row = value + element.place.row;
            let stride = element.place.stride;
            if (element.rows == 3u) {
                // Most are reach rows: without a loop.
                local += values[row] * jacobian[column] + values[row + 1u] * jacobian[column + stride]
                    + values[row + 2u] * jacobian[column + 2u * stride];
                continue;
            }
            var of_element = 0.0;
            for (var r = 0u; r < element.rows; r++) {
                of_element += values[row + r] * jacobian[column + r * stride];
            }
            local += of_element;
        }
        sum += touch.weight * local;
    }
    return sum;
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    if (progress[slot].state != STEP) {
        return;
    }
    let base = slot * batch.values;
    for (var i = lane; i < slots[slot].variables; i += WORKGROUP) {
        let product = transposed_times(slot, progress[slot].current, i);
        values[base + batch.right_hand_side + i] = product + values[base + batch.gradient + i];
    }
}
