// needs: shared/reduce shared/kind
// Slacks and multipliers of the inequalities: their steps, and the target of a barrier step.
// Twin: src/solver/slacks.rs

// Target of a barrier step: products `s z = mu - correction ds dz`, with `ds` and `dz` of the predictor.
struct BarrierTarget {
    mu: f32,
    correction: f32,
}

// Computes and stores the steps of slack and multiplier of inequality `i`.
//   g, g_change   residual, and its change along the direction
// Returns the reciprocals of the step lengths at which slack and multiplier reach zero.
fn slack_step(base: u32, i: u32, g: f32, g_change: f32, aim: BarrierTarget) -> vec2<f32> {
    let s = values[base + batch.slack + i];
    let z = values[base + batch.multiplier + i];
    let ds_at = base + batch.slack_step + i;
    let dz_at = base + batch.multiplier_step + i;
    let ratio = s / z;
    // Without a correction the old steps must not be read: they may hold any value.
    var second = 0.0;
    if (aim.correction != 0.0) {
        second = aim.correction * values[ds_at] * values[dz_at];
    }
    let centre = (aim.mu - second) / z;
    let w = 1.0 / (ratio + 1.0);
    let dz = w * (g_change + g - z + centre);
    let ds = centre - s - ratio * dz;
    values[ds_at] = ds;
    values[dz_at] = dz;
    return vec2<f32>(-ds / s, -dz / z);
}

// Fraction-to-boundary rule: longest step in (0, 1]. `steepest` is the reciprocal of the step length at which the first slack or multiplier
// reaches zero.
fn fraction_to_the_boundary(steepest: f32) -> f32 {
    return select(1.0, FRACTION_TO_THE_BOUNDARY / steepest, steepest > FRACTION_TO_THE_BOUNDARY);
}

// Steps of all slacks and multipliers; each invocation handles its share. Every invocation of the workgroup must call this function.
//   half  half of the buffers that holds the point
// Returns the longest steps of the slacks and of the multipliers.
fn slack_steps(slot: u32, half: u32, lane: u32, aim: BarrierTarget) -> vec2<f32> {
    let base = slot * batch.values;
    let g = base + batch.g + half * batch.g_half;
    var steepest = vec2<f32>();
    for (var i = lane; i < slots[slot].inequalities; i += WORKGROUP) {
        steepest = max(steepest, slack_step(base, i, values[g + i], values[base + batch.g_change + i], aim));
    }
    let primal = fraction_to_the_boundary(max_over(lane, steepest.x));
    return vec2<f32>(primal, fraction_to_the_boundary(max_over(lane, steepest.y)));
}

// Product of slack and multiplier `i` after a step of `lengths`.
fn product_after(base: u32, i: u32, lengths: vec2<f32>) -> f32 {
    let s = values[base + batch.slack + i] + lengths.x * values[base + batch.slack_step + i];
    let z = values[base + batch.multiplier + i] + lengths.y * values[base + batch.multiplier_step + i];
    return s * z;
}

// Target of the barrier parameter by Mehrotra's rule, from the mean product before and after the predictor; at least `least`.
fn target_barrier(before: f32, after: f32, least: f32) -> f32 {
    let share = clamp(after / before, 0.0, 1.0);
    return max(before * share * share, least);
}

// Weight of inequality `i` in a barrier step, and its value: `w = 1 / (s/z + 1/rho)`, `z + w (g - z/rho + mu/z)`, with `rho = 1`.
fn barrier_row(base: u32, i: u32, g: f32, aim: BarrierTarget) -> vec2<f32> {
    let s = values[base + batch.slack + i];
    let z = values[base + batch.multiplier + i];
    var second = 0.0;
    if (aim.correction != 0.0) {
        second = aim.correction * values[base + batch.slack_step + i] * values[base + batch.multiplier_step + i];
    }
    let w = 1.0 / (s / z + 1.0);
    return vec2<f32>(w, z + w * (g - z + (aim.mu - second) / z));
}

// Weights and values of the rows of one element in a barrier step. An equality has weight 1, and its value is its residual. Cost rows
// keep their weights and values.
fn barrier_rows(slot: u32, half: u32, element: Element, aim: BarrierTarget) {
    let base = slot * batch.values;
    let g = base + batch.g + half * batch.g_half;
    for (var r = 0u; r < element.rows; r++) {
        let row = element.place.row + r;
        let kind = row_kind(slots[slot].rows, row);
        if (kind == COST) {
            continue;
        }
        if (kind == EQUALITY) {
            values[base + batch.weight + row] = 1.0;
            values[base + batch.value + row] = values[base + batch.c + half * batch.c_half + row];
            continue;
        }
        let upper = element.place.inequality + r;
        var sum = barrier_row(base, upper, values[g + upper], aim);
        if (r < element.pairs) {
            let lower = element.place.inequality + element.rows + r;
            let side = barrier_row(base, lower, values[g + lower], aim);
            sum = vec2<f32>(sum.x + side.x, sum.y - side.y);
        }
        values[base + batch.weight + row] = sum.x;
        values[base + batch.value + row] = sum.y;
    }
}
