// needs: shared/reduce shared/slacks shared/control shared/round shared/all_elements
// binds: elements
// Start of a round: kind of step or termination, then weights and values of the rows in the normal equations, and the terms in single
// variables. One workgroup per candidate.
//   in      values    x, c and g at the point, slacks and multipliers
//   in out  progress
//   out     values    history; weight, value [rows]; diagonal, gradient [variables]; x of the trial point when the rows become exact
// Twins: src/solver/weights.rs, `begin` in src/solver/control.rs, `infeasibility` in src/solver/judge.rs, `largest` in src/solver/slacks.rs

// One invocation's share of the infeasibility `F = (|c|^2 + |max(g, 0)|^2) / 2`.
fn infeasibility(slot: u32, half: u32, lane: u32) -> f32 {
    let c = slot * batch.values + batch.c + half * batch.c_half;
    let g = slot * batch.values + batch.g + half * batch.g_half;
    var sum = 0.0;
    for (var i = lane; i < slots[slot].rows.equalities; i += WORKGROUP) {
        sum += values[c + i] * values[c + i];
    }
    for (var i = lane; i < slots[slot].inequalities; i += WORKGROUP) {
        // `max` would drop a NaN.
        let over = select(values[g + i], 0.0, values[g + i] <= 0.0);
        sum += over * over;
    }
    return 0.5 * sum;
}

// Largest multiplier in one invocation's share.
fn largest_multiplier(slot: u32, lane: u32) -> f32 {
    let z = slot * batch.values + batch.multiplier;
    var largest = 0.0;
    for (var i = lane; i < slots[slot].inequalities; i += WORKGROUP) {
        largest = max(largest, values[z + i]);
    }
    return largest;
}

// Weights and values of the rows of one element in a closing step: the equalities and the violated inequalities.
fn closing_rows(slot: u32, half: u32, element: Element) {
    let base = slot * batch.values;
    let g = base + batch.g + half * batch.g_half;
    for (var r = 0u; r < element.rows; r++) {
        let row = element.place.row + r;
        let kind = row_kind(slots[slot].rows, row);
        var sum = vec2<f32>(1.0, values[base + batch.c + half * batch.c_half + min(row, slots[slot].rows.equalities - 1u)]);
        if (kind == COST) {
            sum = vec2<f32>();
        } else if (kind == INEQUALITY) {
            let upper = values[g + element.place.inequality + r];
            sum = select(vec2<f32>(0.0, 0.0), vec2<f32>(1.0, upper), upper > 0.0);
            if (r < element.pairs) {
                let lower = values[g + element.place.inequality + element.rows + r];
                sum += select(vec2<f32>(0.0, 0.0), vec2<f32>(1.0, -lower), lower > 0.0);
            }
        }
        values[base + batch.weight + row] = sum.x;
        values[base + batch.value + row] = sum.y;
    }
}

// Weights and values of the rows of one element in the current kind of step.
fn row_weights(slot: u32, now: Progress, element: Element) {
    if (now.state == CLOSE) {
        closing_rows(slot, now.current, element);
    } else {
        barrier_rows(slot, now.current, element, BarrierTarget(0.0, 0.0));
    }
}

// Terms in a single variable: `eps D + weight smoothing` on the diagonal, `weight smoothing (x - initial)` in the gradient.
fn variable_terms(base: u32, half: u32, i: u32, eps: f32, weight: f32) {
    let smoothing = weight * values[base + batch.smoothing + i];
    values[base + batch.diagonal + i] = eps * values[base + batch.scaling + i] + smoothing;
    values[base + batch.gradient + i] = smoothing * (values[base + batch.x + half * batch.x_half + i] - values[base + batch.initial + i]);
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    let base = slot * batch.values;
    var now = progress_at_start(slot, lane);
    if (now.state >= ENDED) {
        return;
    }
    if (now.attempts == 0u) {
        let f = sum_over(lane, infeasibility(slot, now.current, lane));
        let largest = max_over(lane, largest_multiplier(slot, lane));
        // The history is a ring buffer: this record replaces the one from `stall_window` records ago.
        let record = base + batch.history + now.recorded % batch.stall_window;
        now = begin(slot, now, f, values[record], largest, f < batch.tolerance);
        workgroupBarrier();
        if (lane == 0u && now.state != EXACT) {
            values[record] = f;
        }
    }
    if (lane == 0u) {
        now.factorisations += select(0u, 1u, now.state <= CLOSE);
        progress[slot] = now;
    }
    if (now.state == EXACT) {
        let x = base + batch.x;
        for (var i = lane; i < slots[slot].variables; i += WORKGROUP) {
            values[x + (1u - now.current) * batch.x_half + i] = values[x + now.current * batch.x_half + i];
        }
    }
    if (now.state > CLOSE) {
        return;
    }
    for (var i = lane; i < all_elements(slot); i += WORKGROUP) {
        row_weights(slot, now, any_element(slot, i));
    }
    for (var i = lane; i < slots[slot].variables; i += WORKGROUP) {
        variable_terms(base, now.current, i, proximal(now), now.smoothing);
    }
}
