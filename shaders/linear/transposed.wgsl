// Right-hand side of the corrector: the transposed Jacobian times the values of the rows, and what falls on single variables. One thread a
// variable, which gathers from the elements that touch it, in their order.
//   in   values           value [rows], gradient [variables]
//   in   jacobian         at the point
//   out  values           right_hand_side [variables]
// Twin: src/linear/transposed.rs, which scatters in the same order

@group(0) @binding(0) var<uniform> batch: Batch;
@group(0) @binding(1) var<storage, read> running: array<u32>;
@group(0) @binding(2) var<storage, read> slots: array<Slot>;
@group(0) @binding(3) var<storage, read> progress: array<Progress>;
@group(0) @binding(4) var<storage, read_write> values: array<f32>;
@group(0) @binding(5) var<storage, read> jacobian: array<f32>;
@group(0) @binding(6) var<storage, read> elements: array<Element>;
@group(0) @binding(7) var<storage, read> gathers: array<Gather>;
@group(0) @binding(8) var<storage, read> touches: array<Touch>;

// Product of the column of variable `i` with the values.
fn transposed_times(slot: u32, half: u32, i: u32) -> f32 {
    let value = slot * batch.values + batch.value;
    let gather = gathers[slot * batch.gathers + i];
    var sum = 0.0;
    for (var k = gather.touches.start; k < gather.touches.end; k++) {
        let touch = touches[slot * batch.touches + k];
        let element = elements[slot * batch.elements + touch.element];
        let column = (2u * slot + half) * batch.jacobian + element.place.jacobian + touch.column + gather.offset;
        var local = 0.0;
        for (var r = 0u; r < element.rows; r++) {
            local += values[value + element.place.row + r] * jacobian[column + r * element.place.stride];
        }
        sum += local;
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
