// needs: shared/values shared/jacobian shared/terrain shared/entries
// binds: jacobian footholds swing_nodes heights
// Height of swinging feet above the terrain, and above lift-off and touchdown. One thread per point of a swing.
//   in   values    x of the trial point, ground
//   out  values    g at each row's place: low, then high if it is two-sided, or high alone; dimensionless, feasible when <= 0
//   out  jacobian  one row at each place
// Twin: src/rows/swing.rs

// Offset of place `k` around a foot, to both sides along both axes, and the height of the ball's lower side there; in radii.
fn around(k: u32) -> vec3<f32> {
    let ring = select(vec2<f32>(OUTER_RING, OUTER_LIFT), vec2<f32>(INNER_RING, INNER_LIFT), k < 4u);
    let distance = select(-ring.x, ring.x, k / 2u % 2u == 0u);
    return select(vec3<f32>(0.0, distance, ring.y), vec3<f32>(distance, 0.0, ring.y), k % 2u == 0u);
}

// Height row of one point of a swing.
fn entry(slot: u32, half: u32, k: u32) {
    let swing = &swing_nodes[slot * batch.swing_nodes + k];
    let constants = &slots[slot].constants;
    let unit = constants.length_scale;
    let x = ix_x(slot, half);
    var at = vec2<f32>(swing.offset[0], swing.offset[1]);
    var height = swing.offset[2] + swing.z_weights[2] * values[x + swing.height];
    for (var i = 0u; i < 2u; i++) {
        let foothold = x + footholds[slot * batch.footholds + swing.foothold[i]];
        at.x += swing.xy_weights[i] * values[foothold];
        at.y += swing.xy_weights[i] * values[foothold + 1u];
        height += swing.z_weights[i] * ground_height(slot, swing.foothold[i]);
    }
    let under = ground(slots[slot].shape, at.x, at.y);
    // Reference height, and its derivative by each foothold.
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
        // The clearance applies to the ground under the foot only; the ground around the foot requires no clearance.
        var least = above;
        if (constants.foot_radius > 0.0) {
            var bends: array<array<vec2<f32>, 2>, 2>;
            for (var i = 0u; i < 2u; i++) {
                let foothold = x + footholds[slot * batch.footholds + swing.foothold[i]];
                bends[i] = ground(slots[slot].shape, values[foothold], values[foothold + 1u]).curvature;
            }
            let level_slope = swing.xy_weights[0] * ground_slope(slot, swing.foothold[0]) + swing.xy_weights[1] * ground_slope(slot, swing.foothold[1]);
            for (var k = 0u; k < RING_POINTS; k++) {
                let place_around = around(k);
                let offset = place_around.xy * constants.foot_radius;
                let beside = ground(slots[slot].shape, at.x + offset.x, at.y + offset.y);
                let needed = beside.height - level_slope.x * offset.x - level_slope.y * offset.y - place_around.z * constants.ball_radius - swing.low;
                if (needed > least) {
                    least = needed;
                    for (var i = 0u; i < 2u; i++) {
                        slopes[i] = beside.slope - offset.x * bends[i][0] - offset.y * bends[i][1];
                    }
                }
            }
        }
        values[place] = (least - height + swing.low + constants.length_margin) * unit;
    }
    if (swing.two_sided == 1u) {
        values[place + 1u] = (height - above - swing.high + constants.length_margin) * unit;
    }

    let rows = rows_at(slot, half, swing.place);
    if (swing.height_column != NONE) {
        put(rows, 0u, swing.height_column, side * swing.z_weights[2] * unit);
    }
    for (var i = 0u; i < 2u; i++) {
        if (swing.foothold_column[i] != NONE) {
            let slope = ground_slope(slot, swing.foothold[i]);
            let value = swing.z_weights[i] * slope - weights[i] * slopes[i];
            put(rows, 0u, swing.foothold_column[i], side * value.x * unit);
            put(rows, 0u, swing.foothold_column[i] + 1u, side * value.y * unit);
        }
    }
}
