// needs: shared/values shared/jacobian shared/entries
// binds: jacobian footholds accelerations
// Acceleration limit of swinging feet at lift-off and at touchdown. One thread per swing.
//   in   values    x of the trial point, ground
//   out  values    g at each swing's place: lift-off, touchdown; dimensionless, feasible when <= 0
//   out  jacobian  two rows at each place
// Twin: src/rows/acceleration.rs

// Acceleration rows of one swing.
fn entry(slot: u32, half: u32, k: u32) {
    let swing = &accelerations[slot * batch.accelerations + k];
    let limit = slots[slot].constants.foot_acceleration;
    let x = ix_x(slot, half);
    let a = x + footholds[slot * batch.footholds + swing.foothold[0]];
    let b = x + footholds[slot * batch.footholds + swing.foothold[1]];
    let by_step = swing.by_step / limit;
    let by_height = swing.by_height / limit;
    let step = by_step * vec2<f32>(values[b] - values[a], values[b + 1u] - values[a + 1u]);
    let squares = step.x * step.x + step.y * step.y;
    let at = ix_inequality(slot, half, swing.place.inequality);
    let rows = rows_at(slot, half, swing.place);
    for (var r = 0u; r < 2u; r++) {
        let rise = by_height * (values[x + swing.height] - ground_height(slot, swing.foothold[r]));
        values[at + r] = 0.5 * (squares + rise * rise - (1.0 - ACCELERATION_MARGIN));
        if (swing.height_column != NONE) {
            put(rows, r, swing.height_column, by_height * rise);
        }
        for (var i = 0u; i < 2u; i++) {
            if (swing.foothold_column[i] == NONE) {
                continue;
            }
            var value = select(by_step * step, -by_step * step, i == 0u);
            if (i == r) {
                // The rise is measured from the foothold of this row.
                value -= by_height * rise * ground_slope(slot, swing.foothold[i]);
            }
            put(rows, r, swing.foothold_column[i], value.x);
            put(rows, r, swing.foothold_column[i] + 1u, value.y);
        }
    }
}
