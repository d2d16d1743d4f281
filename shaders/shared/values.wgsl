// Where things stand in `values`, one function an array, and how to read them. Innermost indices are contiguous.
//
// `half` is that of the trial point.

// First value of x.
fn ix_x(slot: u32, half: u32) -> u32 {
    return slot * batch.values + batch.x + half * batch.x_half;
}

// Residual of an equality.
fn ix_equality(slot: u32, half: u32, equality: u32) -> u32 {
    return slot * batch.values + batch.c + half * batch.c_half + equality;
}

// Residual of an inequality.
fn ix_inequality(slot: u32, half: u32, inequality: u32) -> u32 {
    return slot * batch.values + batch.g + half * batch.g_half + inequality;
}

// Height under a foothold, before the two slopes.
fn ix_ground(slot: u32, foothold: u32) -> u32 {
    return slot * batch.values + batch.ground + 3u * foothold;
}

// Deviation of the pose at an inner point of an interval.
fn ix_deviation(slot: u32, interval: u32, q: u32) -> u32 {
    return slot * batch.values + batch.deviations + 6u * (INNER_POINTS * interval + q);
}

// Three values from an index on.
fn three(at: u32) -> vec3<f32> {
    return vec3<f32>(values[at], values[at + 1u], values[at + 2u]);
}

// Writes three values from an index on.
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

// A pose, its rate or its acceleration.
struct Motion {
    linear: vec3<f32>,
    angular: vec3<f32>,
}

// From a table.
fn motion(v: array<f32, 6>) -> Motion {
    return Motion(vec3<f32>(v[0], v[1], v[2]), vec3<f32>(v[3], v[4], v[5]));
}

// `a + w b`, where `b` stands in the six values from an index on.
fn add_weighted(a: Motion, w: f32, at: u32) -> Motion {
    return Motion(a.linear + w * three(at), a.angular + w * three(at + 3u));
}
