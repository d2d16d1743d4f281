// needs: shared/values shared/jacobian shared/math shared/foot shared/hip shared/entries
// binds: jacobian footholds momentum_intervals swing_powers
// Powers of swinging legs as cost rows. One thread per point of the quadrature.
//   in   values    x of the trial point, ground, deviations
//   out  values    c at each row's place, m/s
//   out  jacobian  one row at each place
// Twin: src/rows/swing_power.rs

// Power of one leg at one point.
fn entry(slot: u32, half: u32, k: u32) {
    let power = &swing_powers[slot * batch.swing_powers + k];
    let base = power.base;
    let here = hip(slot, half, base);
    let x = ix_x(slot, half);
    // Velocity and acceleration of the foot.
    let offset = power.offset;
    let velocity = foot_motion(slot, x, power.foothold, power.height, power.xy_weights[0], power.z_weights[0])
        + vec3<f32>(offset[0][0], offset[0][1], offset[0][2]);
    let acceleration = foot_motion(slot, x, power.foothold, power.height, power.xy_weights[1], power.z_weights[1])
        + vec3<f32>(offset[1][0], offset[1][1], offset[1][2]);
    let v = velocity - here.velocity;
    values[ix_equality(slot, half, power.place.row)] = dot(acceleration, v);

    let rows = rows_at(slot, half, power.place);
    put_base(rows, 0u, base, here, vec3<f32>(), -acceleration, vec3<f32>());
    for (var i = 0u; i < 2u; i++) {
        if (power.foothold_column[i] == NONE) {
            continue;
        }
        let slope = ground_slope(slot, power.foothold[i]);
        let by_velocity = power.xy_weights[0][i] * acceleration.xy + power.z_weights[0][i] * acceleration.z * slope;
        let by_acceleration = power.xy_weights[1][i] * v.xy + power.z_weights[1][i] * v.z * slope;
        put(rows, 0u, power.foothold_column[i], by_velocity.x + by_acceleration.x);
        put(rows, 0u, power.foothold_column[i] + 1u, by_velocity.y + by_acceleration.y);
    }
    if (power.height_column != NONE) {
        put(rows, 0u, power.height_column, power.z_weights[0][2] * acceleration.z + power.z_weights[1][2] * v.z);
    }
}
