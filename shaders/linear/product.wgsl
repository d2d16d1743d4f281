// needs: shared/kind shared/factored_product
// binds: jacobian tables
// reads: elements runs base_blocks factored_instants factored_elements factored_own
// Products of the Jacobian with the direction. One thread per element; for factored rows one per instant, whose elements share the change
// of the pose.
//   in   values    direction
//   in   jacobian  at the point
//   out  values    c_change [equalities]; g_change [inequalities], with the sign of their side
// Twin: src/linear/product.rs

// Products of up to three Jacobian rows with the direction; 0 for the others. `first` is the index of the first value of the first row.
fn rows_times(slot: u32, element: Element, first: u32, count: u32) -> vec3<f32> {
    let direction = slot * batch.values + batch.direction;
    let stride = element.place.stride;
    var sums = vec3<f32>();
    for (var k = element.runs.start; k < element.runs.end; k++) {
        let run = runs_at(slot, k);
        for (var i = 0u; i < run.len; i++) {
            let d = values[direction + run.variable + i];
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

// Writes the product of row `r` of an element of `rows` rows.
fn put_product(slot: u32, place: Place, rows: u32, pairs: u32, r: u32, product: f32) {
    let base = slot * batch.values;
    if (row_kind(slots[slot].rows, place.row) != INEQUALITY) {
        values[base + batch.c_change + place.row + r] = product;
    } else {
        let at = base + batch.g_change + place.inequality + r;
        values[at] = product;
        if (r < pairs) {
            values[at + rows] = -product;
        }
    }
}

// Products of the rows of one element.
fn jacobian_times(slot: u32, half: u32, element: Element) {
    let place = element.place;
    var products = vec3<f32>();
    for (var r = 0u; r < element.rows; r++) {
        if (r % 3u == 0u) {
            let first = (2u * slot + half) * batch.jacobian + place.jacobian + r * place.stride;
            products = rows_times(slot, element, first, element.rows - r);
        }
        put_product(slot, place, element.rows, element.pairs, r, products[r % 3u]);
    }
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    if (progress[slot].state > CLOSE) {
        return;
    }
    let half = progress[slot].current;
    for (var i = lane; i < slots[slot].elements; i += WORKGROUP) {
        jacobian_times(slot, half, elements_at(slot, i));
    }
    for (var i = lane; i < slots[slot].factored_instants; i += WORKGROUP) {
        factored_times(slot, half, i);
    }
}
