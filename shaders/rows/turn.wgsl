// needs: shared/values shared/jacobian shared/entries
// binds: jacobian turns
// Yaw of standing soles relative to the base. One thread per sole and time.
//   in   values    x of the trial point
//   out  values    g at each place: upper side, lower side; rad, feasible when <= 0
//   out  jacobian  1 row at each place
// Twin: src/rows/turn.rs

// Turn row of one sole.
fn entry(slot: u32, half: u32, k: u32) {
    let turn = &turns[slot * batch.turns + k];
    let x = ix_x(slot, half);
    var apart = values[x + turn.yaw] - turn.reference;
    for (var i = 0u; i < 4u; i++) {
        apart -= turn.weights[i] * values[x + turn.base[i] + TURN_YAW];
    }
    let at = ix_inequality(slot, half, turn.place.inequality);
    let limit = turn.limit - TURN_MARGIN;
    values[at] = apart - limit;
    values[at + 1u] = -apart - limit;

    let rows = rows_at(slot, half, turn.place);
    for (var i = 0u; i < 4u; i++) {
        if (turn.base_column[i] != NONE) {
            for (var d = 0u; d < TURN_YAW; d++) {
                put(rows, 0u, turn.base_column[i] + d, 0.0);
            }
            put(rows, 0u, turn.base_column[i] + TURN_YAW, -turn.weights[i]);
        }
    }
    if (turn.yaw_column != NONE) {
        put(rows, 0u, turn.yaw_column, 1.0);
    }
}
