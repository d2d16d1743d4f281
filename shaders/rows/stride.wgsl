// needs: shared/values shared/jacobian shared/entries
// binds: jacobian footholds strides
// Step length limit: the distance that a foot covers in one swing, which bounds its speed. One thread per step.
//   in   values    x of the trial point
//   out  values    g at each step's place; dimensionless, feasible when <= 0
//   out  jacobian  one row at each place
// Twin: src/rows/stride.rs

// Row of one step.
fn entry(slot: u32, half: u32, k: u32) {
    let stride = &strides[slot * batch.strides + k];
    let unit = slots[slot].constants.length_scale;
    let x = ix_x(slot, half);
    let a = x + footholds[slot * batch.footholds + stride.foothold[0]];
    let b = x + footholds[slot * batch.footholds + stride.foothold[1]];
    let step = vec2<f32>(values[b] - values[a], values[b + 1u] - values[a + 1u]);
    let squares = step.x * step.x + step.y * step.y;
    values[ix_inequality(slot, half, stride.place.inequality)] = 0.5 * (squares / stride.limit - stride.limit) * unit;

    let rows = rows_at(slot, half, stride.place);
    for (var i = 0u; i < 2u; i++) {
        if (stride.foothold_column[i] != NONE) {
            let sign = select(unit, -unit, i == 0u);
            put(rows, 0u, stride.foothold_column[i], sign * step.x / stride.limit);
            put(rows, 0u, stride.foothold_column[i] + 1u, sign * step.y / stride.limit);
        }
    }
}
