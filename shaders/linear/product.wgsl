// needs: shared/kind shared/reach
// binds: jacobian tables footholds
// reads: elements runs base_blocks reach_instants reach_feet reach_legs
// Products of the Jacobian with the direction. One thread per element; for reach rows one per instant, whose feet share the change of its
// pose.
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
        if (row_kind(slots[slot].rows, place.row) != INEQUALITY) {
            values[base + batch.c_change + place.row + r] = product;
        } else {
            values[base + batch.g_change + place.inequality + r] = product;
            if (r < element.pairs) {
                values[base + batch.g_change + place.inequality + element.rows + r] = -product;
            }
        }
    }
}

// Values of three Jacobian rows, `stride` apart, in the column at index `at`.
fn column_at(at: u32, stride: u32) -> vec3<f32> {
    return vec3<f32>(jacobian[at], jacobian[at + stride], jacobian[at + 2u * stride]);
}

// Products of the reach rows of all feet at one instant.
fn reach_times(slot: u32, half: u32, instant: u32) {
    let direction = slot * batch.values + batch.direction;
    var position = vec3<f32>();
    var angles = vec3<f32>();
    let blocks = reach_instants_at(slot, instant).base.blocks;
    for (var i = 0u; i < 4u; i++) {
        if (base_blocks_front(slot, blocks, i) == NONE) {
            continue;
        }
        let weight = reach_instants_base_weights(slot, instant, i);
        let at = direction + base_blocks_variable(slot, blocks, i);
        position += weight * vec3<f32>(values[at], values[at + 1u], values[at + 2u]);
        angles += weight * vec3<f32>(values[at + 3u], values[at + 4u], values[at + 5u]);
    }
    let feet = reach_instants_at(slot, instant).feet;
    for (var f = feet.start; f < feet.end; f++) {
        let foot = reach_feet_at(slot, f);
        let place = reach_place(slot, f, foot.jacobian, foot.stride);
        let stride = place.stride;
        let first = (2u * slot + half) * batch.jacobian + place.jacobian;
        var products = vec3<f32>();
        for (var c = 0u; c < 3u; c++) {
            products += column_at(first + c, stride) * position[c] + column_at(first + 3u + c, stride) * angles[c];
        }
        for (var i = 0u; i < 2u; i++) {
            if (reach_legs_front(slot, foot.leg, i) != NONE) {
                let at = direction + footholds[slot * batch.footholds + reach_legs_foothold(slot, foot.leg, i)];
                let column = first + reach_legs_foothold_column(slot, foot.leg, i);
                products += column_at(column, stride) * values[at] + column_at(column + 1u, stride) * values[at + 1u];
            }
        }
        if (reach_legs_front(slot, foot.leg, 2u) != NONE) {
            let leg = reach_legs_at(slot, foot.leg);
            products += column_at(first + leg.height_column, stride) * values[direction + leg.height];
        }
        let to = slot * batch.values + batch.g_change + place.inequality;
        for (var r = 0u; r < 3u; r++) {
            values[to + r] = products[r];
            values[to + 3u + r] = -products[r];
        }
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
    for (var i = lane; i < slots[slot].reach_instants; i += WORKGROUP) {
        reach_times(slot, half, i);
    }
}
