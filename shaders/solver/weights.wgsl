// needs: shared/reduce shared/slacks shared/control shared/round shared/all_elements shared/shifts shared/start_slacks shared/objective
// binds: elements
// Start of a round: kind of step, another phase or termination, then weights and values of the rows in the normal equations, and the
// terms in single variables. One workgroup per candidate.
//   in      values    x at the point, cost_weights
//   in out  progress
//   in out  values    c and g at the point, slacks and multipliers; shift_c, shift_g, solved
//   out     values    history; weight, value [rows]; diagonal, gradient [variables]; x of the trial point when the rows become exact
// Twins: src/solver/weights.rs, `begin` in src/solver/control.rs, `infeasibility` in src/solver/judge.rs, `largest` in src/solver/slacks.rs

// One invocation's share of the infeasibility `F = (|c|^2 + |max(g, 0)|^2) / 2`.
fn infeasibility(slot: u32, half: u32, lane: u32, counts: Counts) -> f32 {
    let c = slot * batch.values + batch.c + half * batch.c_half;
    let g = slot * batch.values + batch.g + half * batch.g_half;
    var sum = 0.0;
    for (var i = lane; i < counts.equalities; i += WORKGROUP) {
        sum += values[c + i] * values[c + i];
    }
    for (var i = lane; i < counts.inequalities; i += WORKGROUP) {
        // `max` would drop a NaN.
        let over = select(values[g + i], 0.0, values[g + i] <= 0.0);
        sum += over * over;
    }
    return 0.5 * sum;
}

// Largest multiplier in one invocation's share.
fn largest_multiplier(slot: u32, lane: u32, counts: Counts) -> f32 {
    let z = slot * batch.values + batch.multiplier;
    var largest = 0.0;
    for (var i = lane; i < counts.inequalities; i += WORKGROUP) {
        largest = max(largest, values[z + i]);
    }
    return largest;
}

// Copies the values of the variables; each invocation handles its share.
fn copy_variables(slot: u32, lane: u32, from_first: u32, to_first: u32) {
    let base = slot * batch.values;
    for (var i = lane; i < slots[slot].variables; i += WORKGROUP) {
        values[base + to_first + i] = values[base + from_first + i];
    }
}

// Chooses the purpose of the round, starts the minimisation, or ends the solve. Every invocation of the workgroup must call this
// function.
fn choose(slot: u32, lane: u32, before: Progress, counts: Counts) -> Progress {
    let f = sum_over(lane, infeasibility(slot, before.current, lane, counts));
    let largest = max_over(lane, largest_multiplier(slot, lane, counts));
    // The history is a ring buffer: this record replaces the one from `stall_window` records ago.
    let record = slot * batch.values + batch.history + before.recorded % batch.stall_window;
    let now = begin(slot, before, f, values[record], largest, f < batch.tolerance);
    workgroupBarrier();
    if (lane == 0u && now.state != EXACT) {
        values[record] = f;
    }
    if (now.phase == MINIMISE) {
        copy_variables(slot, lane, batch.x + now.current * batch.x_half, batch.solved);
        clear_shifts(slot, lane, counts);
        start_slacks(slot, now.current, lane, counts.inequalities, now.mu);
    }
    return now;
}

// Begins a round in the phase of the solve, or ends the solve. Every invocation of the workgroup must call this function.
fn begin_round(slot: u32, lane: u32, before: Progress) -> Progress {
    var now = before;
    let counts = counts_of(slot);
    if (is_minimised(now)) {
        add_shifts(slot, now.current, lane, counts, -1.0);
        now = restore(now);
        start_slacks(slot, now.current, lane, counts.inequalities, now.mu);
    }
    if (now.phase == MINIMISE) {
        // Barrier steps only, also after a shortened one.
        now.state = STEP;
    } else if (now.phase != REVERT) {
        now = choose(slot, lane, now, counts);
    }
    if (now.phase == REVERT) {
        copy_variables(slot, lane, batch.solved, batch.x + now.current * batch.x_half);
        now = revert(now);
    }
    // Other invocations read the residuals and slacks.
    storageBarrier();
    return now;
}

// Distance from zero within which an inequality takes part in a closing step after a number of refused attempts.
fn closing_reach(infeasibility: f32, attempts: u32) -> f32 {
    return min(CLOSING_REACH * sqrt(infeasibility), LARGEST_CLOSING_REACH) * f32(1u << (REACH_DOUBLINGS * attempts));
}

// Weights and values of the rows of one element in a closing step: the equalities and the inequalities that are violated or nearly active.
// Cost rows are left out.
fn closing_rows(slot: u32, half: u32, element: Element, reach: f32) {
    let base = slot * batch.values;
    let g = base + batch.g + half * batch.g_half;
    for (var r = 0u; r < element.rows; r++) {
        let row = element.place.row + r;
        let kind = row_kind(slots[slot].rows, row);
        var sum = vec2<f32>(1.0, values[base + batch.c + half * batch.c_half + min(row, slots[slot].rows.equalities - 1u)]);
        if (kind == COST) {
            continue;
        }
        if (kind == INEQUALITY) {
            let upper = values[g + element.place.inequality + r];
            sum = vec2<f32>(select(0.0, 1.0, upper > -reach), select(0.0, upper, upper > 0.0));
            if (r < element.pairs) {
                let lower = values[g + element.place.inequality + element.rows + r];
                sum += vec2<f32>(select(0.0, 1.0, lower > -reach), select(0.0, -lower, lower > 0.0));
            }
        }
        values[base + batch.weight + row] = sum.x;
        values[base + batch.value + row] = sum.y;
    }
}

// Weights and values of the rows of one element in the current kind of step.
fn row_weights(slot: u32, now: Progress, element: Element) {
    if (now.state == CLOSE) {
        closing_rows(slot, now.current, element, closing_reach(now.infeasibility, now.attempts));
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
        now = begin_round(slot, lane, now);
    }
    if (lane == 0u) {
        now.factorisations += select(0u, 1u, now.state <= CLOSE);
        progress[slot] = now;
    }
    if (now.state == EXACT) {
        copy_variables(slot, lane, batch.x + now.current * batch.x_half, batch.x + (1u - now.current) * batch.x_half);
    }
    if (now.state > CLOSE) {
        return;
    }
    for (var i = lane; i < all_elements(slot); i += WORKGROUP) {
        row_weights(slot, now, any_element(slot, i));
    }
    objective_rows(slot, now.current, lane, objective_of(now));
    for (var i = lane; i < slots[slot].variables; i += WORKGROUP) {
        variable_terms(base, now.current, i, proximal(now), now.smoothing);
    }
}
