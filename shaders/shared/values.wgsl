// Index functions of the arrays in `values`, one per array, and functions that read and write them. Innermost indices are contiguous.
//
// `half` is the half that holds the trial point.

// Index of the first value of x.
fn ix_x(slot: u32, half: u32) -> u32 {
    return slot * batch.values + batch.x + half * batch.x_half;
}

// Index of the residual of an equality.
fn ix_equality(slot: u32, half: u32, equality: u32) -> u32 {
    return slot * batch.values + batch.c + half * batch.c_half + equality;
}

// Index of the residual of an inequality.
fn ix_inequality(slot: u32, half: u32, inequality: u32) -> u32 {
    return slot * batch.values + batch.g + half * batch.g_half + inequality;
}

// Index of the height under a foothold; the two slopes follow it.
fn ix_ground(slot: u32, foothold: u32) -> u32 {
    return slot * batch.values + batch.ground + 3u * foothold;
}

// Index of the deviation of the pose at an inner point of an interval.
fn ix_deviation(slot: u32, interval: u32, q: u32) -> u32 {
    return slot * batch.values + batch.deviations + POSE * (INNER_POINTS * interval + q);
}

// Three consecutive values, starting at an index.
fn three(at: u32) -> vec3<f32> {
    return vec3<f32>(values[at], values[at + 1u], values[at + 2u]);
}

// Writes three consecutive values, starting at an index.
fn put_three(at: u32, v: vec3<f32>) {
    values[at] = v.x;
    values[at + 1u] = v.y;
    values[at + 2u] = v.z;
}

// Height of the ground under a foothold.
fn ground_height(slot: u32, foothold: u32) -> f32 {
    return values[ix_ground(slot, foothold)];
}

// Slope of the ground under a foothold.
fn ground_slope(slot: u32, foothold: u32) -> vec2<f32> {
    let at = ix_ground(slot, foothold);
    return vec2<f32>(values[at + 1u], values[at + 2u]);
}

// Pose, its rate, or its acceleration.
struct Motion {
    linear: vec3<f32>,
    angular: vec3<f32>,
}

// Motion from its table entry.
fn motion(v: array<f32, 6>) -> Motion {
    return Motion(vec3<f32>(v[0], v[1], v[2]), vec3<f32>(v[3], v[4], v[5]));
}

// `a + w b`, where `b` is the motion in the six values that start at `at`.
fn add_weighted(a: Motion, w: f32, at: u32) -> Motion {
    return Motion(a.linear + w * three(at), a.angular + w * three(at + 3u));
}
