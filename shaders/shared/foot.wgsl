// needs: shared/values shared/jacobian
// Motion of a foot between its nodes. Shaders that need this bind footholds.
// Twin: src/rows/foot.rs

// Position of a foot, world frame, or a derivative of it: the weighted sum of the footholds before and after a swing and of the height of
// its mid node.
//   feet    indices of the footholds; the second is NONE in stance
//   height  position of the swing height in x; NONE in stance
fn foot_motion(slot: u32, x: u32, feet: array<u32, 2>, height: u32, by_xy: array<f32, 2>, by_z: array<f32, 3>) -> vec3<f32> {
    var foothold = feet;
    var xy_weights = by_xy;
    var z_weights = by_z;
    var foot_w = vec3<f32>();
    for (var i = 0u; i < 2u; i++) {
        if (foothold[i] == NONE) {
            continue;
        }
        let at = x + footholds[slot * batch.footholds + foothold[i]];
        foot_w.x += xy_weights[i] * values[at];
        foot_w.y += xy_weights[i] * values[at + 1u];
        foot_w.z += z_weights[i] * ground_height(slot, foothold[i]);
    }
    if (height != NONE) {
        foot_w.z += z_weights[2] * values[x + height];
    }
    return foot_w;
}

// A derivative of the position of a swinging foot, world frame.
//   order  0 or 1
fn swing_motion(slot: u32, x: u32, of_foot: SwingMotion, order: u32) -> vec3<f32> {
    var swing = of_foot;
    let offset = swing.offset[order];
    return foot_motion(slot, x, swing.foothold, swing.height, swing.xy_weights[order], swing.z_weights[order])
        + vec3<f32>(offset[0], offset[1], offset[2]);
}

// Writes the columns of footholds and swing height of a row.
//   by_first, by_second   derivatives of the row with respect to both derivatives of the foot's position
fn put_swing(slot: u32, rows: Rows, row: u32, of_foot: SwingMotion, by_first: vec3<f32>, by_second: vec3<f32>) {
    var swing = of_foot;
    for (var i = 0u; i < 2u; i++) {
        if (swing.foothold_column[i] == NONE) {
            continue;
        }
        let slope = ground_slope(slot, swing.foothold[i]);
        let first = swing.xy_weights[0][i] * by_first.xy + swing.z_weights[0][i] * by_first.z * slope;
        let second = swing.xy_weights[1][i] * by_second.xy + swing.z_weights[1][i] * by_second.z * slope;
        put(rows, row, swing.foothold_column[i], first.x + second.x);
        put(rows, row, swing.foothold_column[i] + 1u, first.y + second.y);
    }
    if (swing.height_column != NONE) {
        put(rows, row, swing.height_column, swing.z_weights[0][2] * by_first.z + swing.z_weights[1][2] * by_second.z);
    }
}
