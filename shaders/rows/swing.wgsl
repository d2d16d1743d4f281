// needs: shared/values shared/jacobian shared/terrain shared/entries
// binds: jacobian footholds swing_nodes heights
// Swinging feet: how high above the terrain, and above lift-off and landing. One thread per point of a swing.
//   in   values    x of the trial point, ground
//   out  values    g at each row's place: low, then high where it is two-sided, or high alone; dimensionless, feasible when <= 0
//   out  jacobian  one row at each place
// Twin: src/rows/swing.rs

// Height row of one point of a swing.
fn entry(slot: u32, half: u32, k: u32) {
    let swing = &swing_nodes[slot * batch.swing_nodes + k];
    let constants = &slots[slot].constants;
    let unit = constants.length_scale;
    let x = ix_x(slot, half);
    var at = vec2<f32>();
    var height = swing.z_weights[2] * values[x + swing.height];
    for (var i = 0u; i < 2u; i++) {
        let foothold = x + footholds[slot * batch.footholds + swing.foothold[i]];
        at.x += swing.xy_weights[i] * values[foothold];
        at.y += swing.xy_weights[i] * values[foothold + 1u];
        height += swing.z_weights[i] * ground_height(slot, swing.foothold[i]);
    }
    let under = ground(slots[slot].shape, at.x, at.y);
    // What the height is above, and how each foothold moves it.
    var above = under.height;
    var weights = swing.xy_weights;
    var slopes = array<vec2<f32>, 2>(under.slope, under.slope);
    var side = -1.0;
    let place = ix_inequality(slot, half, swing.place.inequality);
    if (swing.upper == 1u) {
        side = 1.0;
        for (var i = 0u; i < 2u; i++) {
            let foothold = ground_height(slot, swing.foothold[i]);
            if (foothold > above) {
                above = foothold;
                weights = array<f32, 2>();
                weights[i] = 1.0;
                slopes[i] = ground_slope(slot, swing.foothold[i]);
            }
        }
        values[place] = (height - above - swing.high + constants.length_margin) * unit;
    } else {
        values[place] = (above - height + swing.low + constants.length_margin) * unit;
    }
    if (swing.two_sided == 1u) {
        values[place + 1u] = (height - above - swing.high + constants.length_margin) * unit;
    }

    let rows = rows_at(slot, half, swing.place);
    put(rows, 0u, swing.height_column, side * swing.z_weights[2] * unit);
    for (var i = 0u; i < 2u; i++) {
        if (swing.foothold_column[i] != NONE) {
            let slope = ground_slope(slot, swing.foothold[i]);
            let value = swing.z_weights[i] * slope - weights[i] * slopes[i];
            put(rows, 0u, swing.foothold_column[i], side * value.x * unit);
            put(rows, 0u, swing.foothold_column[i] + 1u, side * value.y * unit);
        }
    }
}
