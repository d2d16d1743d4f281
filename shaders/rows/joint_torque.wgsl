// needs: shared/values shared/jacobian shared/math shared/hip shared/leg_joints shared/entries
// binds: jacobian footholds momentum_intervals joint_torques
// Torques of standing legs beyond the limits of their joints, as cost rows. One thread per point of the quadrature.
//   in   values    x of the trial point, ground, deviations
//   out  values    c at each row's place: one per joint
//   out  jacobian  three rows at each place
// Twin: src/rows/joint_torque.rs

// Torques of one leg at one point.
fn entry(slot: u32, half: u32, k: u32) {
    let torque = &joint_torques[slot * batch.joint_torques + k];
    let here = hip(slot, half, torque.base);
    let x = ix_x(slot, half);
    let stance = &torque.stance;
    let foothold = x + footholds[slot * batch.footholds + stance.foothold];
    // `stance_force` and, below, `put_stance` of the twin. As a function the latter takes 88 to 96 registers instead of 80 on AMD GPUs.
    var force = vec3<f32>();
    for (var i = 0u; i < 2u; i++) {
        if (stance.node[i] != NONE) {
            let at = x + stance.node[i];
            force += stance.weights[i][0] * three(at) + stance.weights[i][1] * three(at + 3u);
        }
    }
    let leg = &torque.leg;
    let to_contact = vec3<f32>(0.0, 0.0, -leg.radius);
    let contact = vec3<f32>(values[foothold], values[foothold + 1u], ground_height(slot, stance.foothold));
    let foot = contact - to_contact - here.position;
    var joints = leg_joints(*leg, here.rot_wb, foot);
    let rows = rows_at(slot, half, torque.place);
    for (var j = 0u; j < 3u; j++) {
        let axis = joint_axis(joints, j);
        let column = joints.columns[j] + cross(axis, to_contact);
        let per_torque = leg.per_torque[j];
        let excess = beyond(-dot(column, force) * per_torque);
        values[ix_equality(slot, half, torque.place.row + j)] = torque.weight * excess.x;
        let unit = -(torque.weight * excess.y * per_torque);
        var by_foot = vec3<f32>();
        for (var i = 0u; i < 3u; i++) {
            by_foot += unit * dot(column_by(joints, j, i, to_contact), force) * joints.inverse[i];
        }
        let by_force = unit * column;
        // The ball is above the contact in the world: its centre turns against the leg.
        let by_contact = unit * cross(force, axis);
        let turned = cross(foot, by_foot) + cross(force, by_force) + cross(to_contact, by_contact);
        put_turned(rows, j, torque.base, here, -by_foot, vec3<f32>(), vec3<f32>(), -turned);
        for (var i = 0u; i < 2u; i++) {
            if (stance.node_column[i] != NONE) {
                put_row(rows, j, stance.node_column[i], stance.weights[i][0] * by_force);
                put_row(rows, j, stance.node_column[i] + 3u, stance.weights[i][1] * by_force);
            }
        }
        if (stance.foothold_column != NONE) {
            let by_foothold = by_foot.xy + by_foot.z * ground_slope(slot, stance.foothold);
            put(rows, j, stance.foothold_column, by_foothold.x);
            put(rows, j, stance.foothold_column + 1u, by_foothold.y);
        }
    }
}
