// needs: shared/values shared/jacobian shared/math
// Position and velocity of a hip and their derivatives, for the powers of legs. Shaders that need this bind momentum_intervals.
// Twin: src/rows/hip.rs

// Position and velocity of a hip, world frame. Derivatives of the position with respect to each Euler angle are those of the velocity with
// respect to each rate.
struct Hip {
    // Base to world.
    rot_wb: Mat3,
    position: vec3<f32>,
    velocity: vec3<f32>,
    position_by: Mat3,
    velocity_by: Mat3,
    // Angular velocity of the base, its derivatives with respect to each Euler angle, and the axes of the angles: its derivatives with
    // respect to their rates.
    omega: vec3<f32>,
    omega_by: Mat3,
    axes: Mat3,
}

// The hip at a point.
fn hip(slot: u32, half: u32, point: HipPoint) -> Hip {
    var at = point;
    let x = ix_x(slot, half);
    let interval = &momentum_intervals[slot * batch.momentum_intervals + at.interval];
    var pose = motion(at.reference);
    var rate = motion(interval.rate);
    for (var i = 0u; i < 4u; i++) {
        pose = add_weighted(pose, at.value[i], x + interval.variable[i]);
        rate = add_weighted(rate, at.rate[i], x + interval.variable[i]);
    }
    for (var q = 0u; q < INNER_POINTS; q++) {
        let deviation = ix_deviation(slot, at.interval, q);
        pose = add_weighted(pose, at.deviation[q], deviation);
        rate = add_weighted(rate, at.deviation_rate[q], deviation);
    }
    let turned = euler(pose.angular);
    let axes = turned.axes;
    let omega = along(axes, rate.angular);
    let arm = mul(turned.rot_wb, vec3<f32>(at.hip[0], at.hip[1], 0.0));
    let position_by = Mat3(cross(axes[0], arm), cross(axes[1], arm), cross(axes[2], arm));
    // The pitch moves the roll axis, the yaw moves both.
    let omega_by = Mat3(vec3<f32>(), rate.angular.x * cross(axes[1], axes[0]), cross(axes[2], omega));
    let velocity_by = Mat3(
        cross(omega, position_by[0]),
        cross(omega_by[1], arm) + cross(omega, position_by[1]),
        cross(omega_by[2], arm) + cross(omega, position_by[2]),
    );
    return Hip(turned.rot_wb, pose.linear + arm, rate.linear + cross(omega, arm), position_by, velocity_by, omega, omega_by, axes);
}

// Writes the base columns of a row.
//   by_position, by_velocity, by_omega   derivatives of the row with respect to the hip and to the angular velocity
fn put_base(
    rows: Rows,
    row: u32,
    point: HipPoint,
    hip: Hip,
    by_position: vec3<f32>,
    by_velocity: vec3<f32>,
    by_omega: vec3<f32>,
) {
    let by_angle = mul(hip.position_by, by_position) + mul(hip.velocity_by, by_velocity) + mul(hip.omega_by, by_omega);
    put_columns(rows, row, point, hip, by_position, by_velocity, by_omega, by_angle);
}

// Writes the base columns of a row that also depends on the attitude of the base itself.
//   by_turn   derivatives with respect to a rotation of the base, about the axes of the world
fn put_turned(
    rows: Rows,
    row: u32,
    point: HipPoint,
    hip: Hip,
    by_position: vec3<f32>,
    by_velocity: vec3<f32>,
    by_omega: vec3<f32>,
    by_turn: vec3<f32>,
) {
    let by_angle =
        mul(hip.position_by, by_position) + mul(hip.velocity_by, by_velocity) + mul(hip.omega_by, by_omega) + mul(hip.axes, by_turn);
    put_columns(rows, row, point, hip, by_position, by_velocity, by_omega, by_angle);
}

// Writes the base columns of a row from its derivatives and those with respect to the Euler angles.
fn put_columns(
    rows: Rows,
    row: u32,
    point: HipPoint,
    hip: Hip,
    by_position: vec3<f32>,
    by_velocity: vec3<f32>,
    by_omega: vec3<f32>,
    by_angle: vec3<f32>,
) {
    var at = point;
    let by_rate = mul(hip.position_by, by_velocity) + mul(hip.axes, by_omega);
    for (var i = 0u; i < 4u; i++) {
        if (at.column[i] != NONE) {
            put_row(rows, row, at.column[i], at.value[i] * by_position + at.rate[i] * by_velocity);
            put_row(rows, row, at.column[i] + 3u, at.value[i] * by_angle + at.rate[i] * by_rate);
        }
    }
}
