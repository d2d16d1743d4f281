// needs: shared/factored_place
// Products of factored rows with the direction. Twin: `FactoredRows::times` of src/linear/factored.rs

// Values of the rows of a factored element, `stride` apart, in the column at index `at`.
fn column_at(at: u32, stride: u32) -> vec3<f32> {
    return vec3<f32>(jacobian[at], jacobian[at + stride], jacobian[at + 2u * stride]);
}

// Products of the rows of all elements at one instant, which share the change of the pose.
fn factored_times(slot: u32, half: u32, instant: u32) {
    let direction = slot * batch.values + batch.direction;
    var position = vec3<f32>();
    var angles = vec3<f32>();
    let blocks = factored_instants_at(slot, instant).blocks;
    for (var i = 0u; i < POSE_BLOCKS; i++) {
        if (base_blocks_front(slot, blocks, i) == NONE) {
            continue;
        }
        let weight = factored_instants_weights(slot, instant, i);
        let at = direction + base_blocks_variable(slot, blocks, i);
        position += weight * vec3<f32>(values[at], values[at + 1u], values[at + 2u]);
        angles += weight * vec3<f32>(values[at + 3u], values[at + 4u], values[at + 5u]);
    }
    let elements = factored_instants_at(slot, instant).elements;
    for (var number = elements.start; number < elements.end; number++) {
        let place = factored_place_at(slot, number);
        let first = (2u * slot + half) * batch.jacobian + place.jacobian;
        var products = vec3<f32>();
        for (var c = 0u; c < 3u; c++) {
            products += column_at(first + c, place.stride) * position[c] + column_at(first + 3u + c, place.stride) * angles[c];
        }
        let own = factored_elements_at(slot, number).own;
        for (var k = 0u; k < OWN_BLOCKS; k++) {
            let run = factored_own_runs(slot, own, k);
            if (run.len == 0u) {
                continue;
            }
            let column = first + run.column;
            let at = direction + run.variable;
            var sum = column_at(column, place.stride) * values[at];
            for (var i = 1u; i < run.len; i++) {
                sum += column_at(column + i, place.stride) * values[at + i];
            }
            products += sum;
        }
        for (var r = 0u; r < FACTORED_ROWS; r++) {
            put_product(slot, place, FACTORED_ROWS, FACTORED_PAIRS, r, products[r]);
        }
    }
}
