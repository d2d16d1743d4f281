// needs: shared/values shared/jacobian shared/math shared/foot shared/hip shared/leg_joints shared/entries
// binds: jacobian footholds momentum_intervals joint_speeds
// Speeds of the joints of swinging legs beyond their limits, as cost rows. One thread per point of the quadrature.
//   in   values    x of the trial point, ground, deviations
//   out  values    c at each row's place: one per joint
//   out  jacobian  three rows at each place
// Twin: src/rows/joint_speed.rs

// Speeds of the joints of one leg at one point.
fn entry(slot: u32, half: u32, k: u32) {
    let speed = &joint_speeds[slot * batch.joint_speeds + k];
    let here = hip(slot, half, speed.base);
    let x = ix_x(slot, half);
    let position = swing_motion(slot, x, speed.foot, 0u);
    let foot_velocity = swing_motion(slot, x, speed.foot, 1u);
    let leg = &speed.leg;
    let center = position + vec3<f32>(0.0, 0.0, leg.radius);
    let foot = center - here.position;
    let velocity = foot_velocity - here.velocity - cross(here.omega, foot);
    var joints = leg_joints(*leg, here.rot_wb, foot);
    let rates = mul(joints.inverse, velocity);
    // Changes of `J q'` with each joint at constant `q'`.
    var changes = Mat3();
    for (var i = 0u; i < 3u; i++) {
        let still = vec3<f32>();
        changes[i] = rates.x * column_by(joints, 0u, i, still) + rates.y * column_by(joints, 1u, i, still)
            + rates.z * column_by(joints, 2u, i, still);
    }
    let rows = rows_at(slot, half, speed.place);
    for (var j = 0u; j < 3u; j++) {
        let per_speed = leg.per_speed[j];
        let excess = beyond(rates[j] * per_speed);
        values[ix_equality(slot, half, speed.place.row + j)] = speed.weight * excess.x;
        let by_velocity = (speed.weight * excess.y * per_speed) * joints.inverse[j];
        var by_posture = vec3<f32>();
        for (var i = 0u; i < 3u; i++) {
            by_posture -= dot(by_velocity, changes[i]) * joints.inverse[i];
        }
        // The velocity of the base at the foot depends on where the foot is.
        let by_foot = by_posture + cross(here.omega, by_velocity);
        let turned = cross(foot, by_posture) + cross(velocity, by_velocity);
        put_turned(rows, j, speed.base, here, -by_foot, -by_velocity, cross(by_velocity, foot), -turned);
        put_swing(slot, rows, j, speed.foot, by_foot, by_velocity);
    }
}
