// needs: shared/values
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
