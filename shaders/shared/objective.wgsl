// Objective of the cost rows. A row with a weight of its own counts its absolute value, rounded to `sqrt(r^2 + rounding^2) - rounding`; a
// row without one counts half of its square. A row whose weight is negative, `-1 - i`, has the multiplier of the inequality `i` as its
// weight and is no part of the cost.
// Twin: src/solver/objective.rs

struct Objective {
    weight: f32,
    rounding: f32,
}

// Objective of the current phase: that of the cost rows while the cost is minimised.
fn objective_of(progress: Progress) -> Objective {
    if (progress.phase == MINIMISE) {
        return Objective(batch.cost_weight, progress.rounding);
    }
    return Objective(0.0, 1.0);
}

fn rounded(objective: Objective, r: f32) -> f32 {
    return sqrt(r * r + objective.rounding * objective.rounding);
}

// Cost of a row, without the weight of the objective.
//   of_row  weight of its absolute value; 0 if half of its square counts, negative if the row is no part of the cost
fn cost_of_row(objective: Objective, r: f32, of_row: f32) -> f32 {
    if (of_row < 0.0) {
        return 0.0;
    }
    if (of_row == 0.0) {
        return 0.5 * r * r;
    }
    return of_row * (rounded(objective, r) - objective.rounding);
}

// Decrease of the cost of a row from `r` to `to`, without the weight of the objective.
fn fall_of_row(objective: Objective, r: f32, to: f32, of_row: f32) -> f32 {
    if (of_row < 0.0) {
        return 0.0;
    }
    let squares = (r - to) * (r + to);
    if (of_row == 0.0) {
        return 0.5 * squares;
    }
    return of_row * squares / (rounded(objective, r) + rounded(objective, to));
}

// Weights and values of the cost rows in the normal equations; each invocation handles its share.
fn objective_rows(slot: u32, half: u32, lane: u32, objective: Objective) {
    let base = slot * batch.values;
    let rows = slots[slot].rows;
    for (var i = lane; i < rows.costs; i += WORKGROUP) {
        let row = rows.equalities + i;
        let r = values[base + batch.c + half * batch.c_half + row];
        var weight = objective.weight;
        // Without an objective there may be no weights to read.
        if (weight != 0.0) {
            let of_row = values[base + batch.cost_weights + i];
            if (of_row < 0.0) {
                weight = values[base + batch.multiplier + u32(-1.0 - of_row)];
            } else if (of_row > 0.0) {
                weight = weight * of_row / rounded(objective, r);
            }
        }
        values[base + batch.weight + row] = weight;
        values[base + batch.value + row] = weight * r;
    }
}
