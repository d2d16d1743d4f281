// needs: shared/reduce shared/control shared/round shared/shifts shared/objective
// Acceptance test of the trial point, and the update of slacks and multipliers if it is accepted. One workgroup per candidate.
//   in      values    x, c and g at both points, c_change, g_change, steps of slacks and multipliers, flag of a failed factorisation,
//                     cost_weights
//   in out  progress
//   in out  values    slack, multiplier; while a cost is minimised, c and g at the trial point, shift_c, shift_g
// Twins: src/solver/judge.rs, src/solver/control.rs

// Violation `max(g, 0)`. A NaN stays NaN.
fn over(g: f32) -> f32 {
    return select(g, 0.0, g <= 0.0);
}

// Smoothed `max(g, 0)` and the corresponding slack: `(q + g) / 2` and `(q - g) / 2` with `q = sqrt(g^2 + 4 mu)`.
fn smoothed(g: f32, mu: f32) -> vec2<f32> {
    let q = sqrt(g * g + 4.0 * mu);
    // The smaller of the two is mu / larger, which avoids cancellation.
    let larger = 0.5 * (q + abs(g));
    let smaller = mu / larger;
    return select(vec2<f32>(smaller, larger), vec2<f32>(larger, smaller), g > 0.0);
}

// Twice the decrease of the infeasibility of an inequality from `a` to `b`.
fn infeasibility_fall(a: f32, b: f32) -> f32 {
    return (over(a) - over(b)) * (over(a) + over(b));
}

// Twice the decrease of the smoothed merit of an inequality from `a` to `b`.
fn merit_fall(a: f32, b: f32, mu: f32) -> f32 {
    let here = smoothed(a, mu);
    let there = smoothed(b, mu);
    return (here.x - there.x) * (here.x + there.x) + 2.0 * mu * log(there.y / here.y);
}

// Twice the decrease of the cost of the distance from the initial values.
fn smoothing_fall(smoothing: f32, away: f32, away_to: f32) -> f32 {
    return smoothing * (away - away_to) * (away + away_to);
}

// One invocation's share of the weighted cost rows: their decrease to the trial point, that of their linear model, and their sum at the
// trial point.
fn costs(slot: u32, now: Progress, lane: u32) -> vec3<f32> {
    let base = slot * batch.values;
    let objective = objective_of(now);
    let rows = slots[slot].rows;
    var sums = vec3<f32>();
    // Without a weight there may be no weights of rows to read.
    let count = select(rows.costs, 0u, objective.weight == 0.0);
    for (var i = lane; i < count; i += WORKGROUP) {
        let row = rows.equalities + i;
        let of_row = values[base + batch.cost_weights + i];
        let r = values[base + batch.c + now.current * batch.c_half + row];
        let to = values[base + batch.c + (1u - now.current) * batch.c_half + row];
        let linear = r + now.length * values[base + batch.c_change + row];
        sums.x += fall_of_row(objective, r, to, of_row);
        sums.y += fall_of_row(objective, r, linear, of_row);
        sums.z += cost_of_row(objective, to, of_row);
    }
    return objective.weight * sums;
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    let base = slot * batch.values;
    let now = progress_at_start(slot, lane);
    if (now.state >= ENDED) {
        return;
    }
    let failed = now.state <= CLOSE && values[base + batch.flags] != 0.0;
    if (now.state == EXACT || failed) {
        if (lane == 0u) {
            if (failed) {
                progress[slot] = damp(now);
            } else {
                progress[slot] = renew(now);
            }
        }
        return;
    }
    let trial = 1u - now.current;
    // Read once: SwiftShader reads a value that two loops use only in the first loop, and an invocation that leaves that loop before others
    // then has 0.
    let counts = counts_of(slot);
    let minimises = now.phase == MINIMISE;
    var fall = 0.0;
    var predicted = 0.0;
    var gap = 0.0;
    var cost = 0.0;
    if (minimises) {
        add_shifts(slot, trial, lane, counts, 1.0);
        // The sums below are twice the decreases.
        let of_rows = costs(slot, now, lane);
        fall = 2.0 * of_rows.x;
        predicted = 2.0 * of_rows.y;
        cost = sum_over(lane, of_rows.z);
    }
    for (var i = lane; i < counts.equalities; i += WORKGROUP) {
        let c = values[base + batch.c + now.current * batch.c_half + i];
        let to = values[base + batch.c + trial * batch.c_half + i];
        let linear = c + now.length * values[base + batch.c_change + i];
        fall += (c - to) * (c + to);
        predicted += (c - linear) * (c + linear);
        gap += (to - linear) * (to - linear);
    }
    for (var i = lane; i < counts.inequalities; i += WORKGROUP) {
        let g = values[base + batch.g + now.current * batch.g_half + i];
        let to = values[base + batch.g + trial * batch.g_half + i];
        let linear = g + now.length * values[base + batch.g_change + i];
        if (now.state == CLOSE) {
            fall += infeasibility_fall(g, to);
            predicted += infeasibility_fall(g, linear);
        } else {
            fall += merit_fall(g, to, now.mu);
            predicted += merit_fall(g, linear, now.mu);
        }
        gap += (to - linear) * (to - linear);
    }
    var smoothed_fall = 0.0;
    for (var i = lane; i < slots[slot].variables; i += WORKGROUP) {
        let initial = values[base + batch.initial + i];
        let away = values[base + batch.x + now.current * batch.x_half + i] - initial;
        let away_to = values[base + batch.x + trial * batch.x_half + i] - initial;
        smoothed_fall += smoothing_fall(values[base + batch.smoothing + i], away, away_to);
    }
    smoothed_fall = now.smoothing * 0.5 * sum_over(lane, smoothed_fall);
    fall = 0.5 * sum_over(lane, fall) + smoothed_fall;
    predicted = 0.5 * sum_over(lane, predicted) + smoothed_fall;
    gap = 0.5 * sum_over(lane, gap);
    let taken = acceptable(now, fall, predicted, gap);
    if (taken && now.state != CLOSE) {
        for (var i = lane; i < counts.inequalities; i += WORKGROUP) {
            let s = base + batch.slack + i;
            let z = base + batch.multiplier + i;
            values[s] = max(values[s] + now.length * values[base + batch.slack_step + i], SLACK_FLOOR);
            values[z] = max(values[z] + now.dual_length * values[base + batch.multiplier_step + i], MULTIPLIER_FLOOR);
        }
    }
    if (taken && minimises) {
        update_shifts(slot, trial, lane, counts);
    }
    if (lane == 0u) {
        // Read again: keeping the progress in registers for the whole shader is costly.
        if (taken) {
            let after = accept(progress[slot], select(0.0, fall / predicted, predicted > 0.0));
            if (minimises) {
                progress[slot] = minimised(after, predicted, cost, counts.inequalities);
            } else {
                progress[slot] = after;
            }
        } else {
            progress[slot] = refuse(progress[slot]);
        }
    }
}
