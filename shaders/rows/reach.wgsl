// needs: shared/values shared/jacobian shared/math shared/foot shared/factored_place shared/entries
// binds: jacobian footholds tables
// reads: base_blocks factored_instants factored_elements factored_own reach_instants reach_feet reach_legs
// Reach: each foot stays within slabs in the base frame, three at a time. One thread per reach instant.
//   in   values    x of the trial point, ground, deviations
//   out  values    g at each foot's place: 3 upper sides, 3 lower sides; dimensionless, feasible when <= 0
//   out  jacobian  3 rows at each foot's place: 6 columns by the base pose, which the base blocks share by weight, then the foot's own
// Twin: src/rows/reach.rs          Source: [3]

// Reach rows of all feet at one instant.
fn entry(slot: u32, half: u32, k: u32) {
    let at = factored_instants_at(slot, k);
    let blocks = at.blocks;
    let x = ix_x(slot, half);
    var pose = motion(reach_instants_at(slot, k).reference);
    for (var i = 0u; i < POSE_BLOCKS; i++) {
        pose = add_weighted(pose, factored_instants_weights(slot, k, i), x + base_blocks_variable(slot, blocks, i));
    }
    let interval = base_blocks_at(slot, blocks).interval;
    if (interval < slots[slot].momentum_intervals) {
        for (var q = 0u; q < INNER_POINTS; q++) {
            pose = add_weighted(pose, reach_instants_deviation_weights(slot, k, q), ix_deviation(slot, interval, q));
        }
    }
    let base_w = pose.linear;
    let turned = euler(pose.angular);
    for (var i = at.elements.start; i < at.elements.end; i++) {
        reach_foot(slot, half, i, base_w, turned.rot_wb, turned.axes);
    }
}

// Reach rows of one foot and three slabs.
fn reach_foot(slot: u32, half: u32, number: u32, base_w: vec3<f32>, rot_wb: Mat3, axes: Mat3) {
    let foot = reach_feet_at(slot, number);
    let leg = reach_legs_at(slot, foot.leg);
    let place = factored_place_at(slot, number);
    let own = factored_elements_at(slot, number).own;
    let height = factored_own_runs(slot, own, 2u);
    let constants = &slots[slot].constants;
    let unit = constants.length_scale;
    let x = ix_x(slot, half);
    let swing_height = select(NONE, height.variable, height.len > 0u);
    let offset = vec3<f32>(leg.offset[0], leg.offset[1], leg.offset[2]);
    let leg_w = foot_motion(slot, x, leg.foothold, swing_height, foot.xy_weights, foot.z_weights) + offset - base_w;
    let center = vec3<f32>(leg.center[0], leg.center[1], leg.center[2]);
    let n = leg.normals;
    let normals = Mat3(vec3<f32>(n[0][0], n[0][1], n[0][2]), vec3<f32>(n[1][0], n[1][1], n[1][2]), vec3<f32>(n[2][0], n[2][1], n[2][2]));
    let normals_w = Mat3(mul(normals, rot_wb[0]), mul(normals, rot_wb[1]), mul(normals, rot_wb[2]));
    let away = mul_transposed(normals_w, leg_w) - center;
    let at = ix_inequality(slot, half, place.inequality);
    let room = vec3<f32>(leg.half_widths[0], leg.half_widths[1], leg.half_widths[2]) - constants.length_margin;
    put_three(at, (away - room) * unit);
    put_three(at + 3u, (-away - room) * unit);

    let rows = rows_at(slot, half, place);
    // Columns of the rows by the pose: d(N R' leg)/d angle_i = N R' (leg x axis_i).
    for (var d = 0u; d < 3u; d++) {
        put_column(rows, 0u, d, -normals_w[d] * unit);
        put_column(rows, 0u, 3u + d, unit * mul_transposed(normals_w, cross(leg_w, axes[d])));
    }
    for (var i = 0u; i < 2u; i++) {
        let run = factored_own_runs(slot, own, i);
        if (run.len == 0u) {
            continue;
        }
        let c = run.column;
        let slope = ground_slope(slot, leg.foothold[i]);
        for (var d = 0u; d < 2u; d++) {
            put_column(rows, 0u, c + d, (foot.xy_weights[i] * normals_w[d] + foot.z_weights[i] * slope[d] * normals_w[2]) * unit);
        }
    }
    if (height.len > 0u) {
        put_column(rows, 0u, height.column, foot.z_weights[2] * normals_w[2] * unit);
    }
}
