// Shifts of the residuals by multipliers while a cost is minimised. Each invocation handles its share: the indices that it also has in
// other loops over equalities and inequalities, so that no barrier is needed between them. `half` is the half of the buffers to change.
// Twin: src/solver/minimise.rs

// Numbers of equalities and inequalities. Read once, see shaders/solver/judge.wgsl.
struct Counts {
    equalities: u32,
    inequalities: u32,
}

fn counts_of(slot: u32) -> Counts {
    return Counts(slots[slot].rows.equalities, slots[slot].inequalities);
}

// Adds the shifts, times a sign, to the residuals. Cost rows have none.
fn add_shifts(slot: u32, half: u32, lane: u32, counts: Counts, sign: f32) {
    let base = slot * batch.values;
    for (var i = lane; i < counts.equalities; i += WORKGROUP) {
        values[base + batch.c + half * batch.c_half + i] += sign * values[base + batch.shift_c + i];
    }
    for (var i = lane; i < counts.inequalities; i += WORKGROUP) {
        values[base + batch.g + half * batch.g_half + i] += sign * values[base + batch.shift_g + i];
    }
}

// Sets the shifts to zero.
fn clear_shifts(slot: u32, lane: u32, counts: Counts) {
    let base = slot * batch.values;
    for (var i = lane; i < counts.equalities; i += WORKGROUP) {
        values[base + batch.shift_c + i] = 0.0;
    }
    for (var i = lane; i < counts.inequalities; i += WORKGROUP) {
        values[base + batch.shift_g + i] = 0.0;
    }
}

// Updates the shifts after an accepted step, and with them the residuals of the new point.
fn update_shifts(slot: u32, half: u32, lane: u32, counts: Counts) {
    let base = slot * batch.values;
    // Equalities: the new multiplier is the sum of multiplier and residual. Inequalities take their multipliers from the barrier.
    for (var i = lane; i < counts.equalities; i += WORKGROUP) {
        let at = base + batch.c + half * batch.c_half + i;
        let c = values[at];
        let residual = c - values[base + batch.shift_c + i];
        values[base + batch.shift_c + i] = c;
        values[at] = c + residual;
    }
    for (var i = lane; i < counts.inequalities; i += WORKGROUP) {
        let z = values[base + batch.multiplier + i];
        values[base + batch.g + half * batch.g_half + i] += z - values[base + batch.shift_g + i];
        values[base + batch.shift_g + i] = z;
    }
}
