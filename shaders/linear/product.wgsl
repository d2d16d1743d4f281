// binds: jacobian elements runs
// Products of the Jacobian with the direction. One thread an element.
//   in   values    direction
//   in   jacobian  at the point
//   out  values    c_change [equalities]; g_change [inequalities], with the sign of their side
// Twin: src/linear/product.rs

// Products of up to three Jacobian rows, the first of which begins at `first`, with the direction; 0 for the others.
fn rows_times(slot: u32, element: Element, first: u32, count: u32) -> vec3<f32> {
    let direction = slot * batch.values + batch.direction;
    let stride = element.place.stride;
    var sums = vec3<f32>();
    for (var k = element.runs.start; k < element.runs.end; k++) {
        let run = runs[slot * batch.runs + k];
        for (var i = 0u; i < run.len; i++) {
            let d = run.weight * values[direction + run.variable + i];
            let at = first + run.column + i;
            sums.x += jacobian[at] * d;
            if (count > 1u) {
                sums.y += jacobian[at + stride] * d;
            }
            if (count > 2u) {
                sums.z += jacobian[at + 2u * stride] * d;
            }
        }
    }
    return sums;
}

// Products of the rows of one element.
fn jacobian_times(slot: u32, half: u32, element: Element) {
    let base = slot * batch.values;
    let place = element.place;
    var products = vec3<f32>();
    for (var r = 0u; r < element.rows; r++) {
        if (r % 3u == 0u) {
            let first = (2u * slot + half) * batch.jacobian + place.jacobian + r * place.stride;
            products = rows_times(slot, element, first, element.rows - r);
        }
        let product = products[r % 3u];
        if (place.row < slots[slot].equalities) {
            values[base + batch.c_change + place.row + r] = product;
        } else {
            values[base + batch.g_change + place.inequality + r] = product;
            if (r < element.pairs) {
                values[base + batch.g_change + place.inequality + element.rows + r] = -product;
            }
        }
    }
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    if (progress[slot].state > CLOSE) {
        return;
    }
    for (var i = lane; i < slots[slot].elements; i += WORKGROUP) {
        jacobian_times(slot, progress[slot].current, elements[slot * batch.elements + i]);
    }
}
