// needs: shared/values shared/jacobian shared/math shared/terrain shared/contact shared/entries
// binds: jacobian footholds sole_points heights
// Wrench of a sole: centre of pressure, and friction with torsion, at force nodes or at the Bezier points next to them. One thread per
// point.
//   in   values    x of the trial point
//   out  values    g at each point's place: toe, heel, left and right side, friction; dimensionless, feasible when <= 0
//   out  jacobian  5 rows at each point's place
// Twin: src/rows/sole.rs

// Wrench rows of one point.
fn entry(slot: u32, half: u32, i: u32) {
    let point = &sole_points[slot * batch.sole_points + i];
    let constants = &slots[slot].constants;
    let friction = constants.friction;
    let margin = constants.force_margin;
    let lever = constants.torsion;
    let x = ix_x(slot, half);
    let force = three(x + point.node[0]) + point.slope_weight * three(x + point.node[0] + 3u);
    let moment = three(x + point.node[1]) + point.slope_weight * three(x + point.node[1] + 3u);
    let under = x + footholds[slot * batch.footholds + point.foothold];
    let contact = ground(slots[slot].shape, values[under], values[under + 1u]);
    var directions = basis(contact);
    let normal = directions[0].unit;
    // Axes of the sole and their derivatives by its yaw.
    let turn = sin_cos(vec3<f32>(values[x + point.yaw], 0.0, 0.0));
    let sin = turn.sin.x;
    let cos = turn.cos.x;
    let heading = vec3<f32>(cos, sin, contact.slope.x * cos + contact.slope.y * sin);
    let turned = vec3<f32>(-sin, cos, contact.slope.y * cos - contact.slope.x * sin);
    let scale = 1.0 / sqrt(dot(heading, heading));
    let e_x = scale * heading;
    let e_y = cross(normal, e_x);
    let e_x_by_yaw = scale * (turned - dot(e_x, turned) * e_x);
    let e_y_by_yaw = cross(normal, e_x_by_yaw);

    let push = dot(normal, force);
    let tangential = force - push * normal;
    let across = moment - dot(normal, moment) * normal;
    let square = push * push + margin * margin;
    let inverse = push / square;
    let torsion = (dot(normal, moment) + dot(across, tangential) * inverse) * lever;
    let size = sqrt(dot(tangential, tangential) + margin * margin);
    let twist = sqrt(torsion * torsion + margin * margin);
    let at = ix_inequality(slot, half, point.place.inequality);
    let about_y = dot(moment, e_y);
    let about_x = dot(moment, e_x);
    let limit_y = constants.pressure[0] * push - margin;
    let limit_x = constants.pressure[1] * push - margin;
    values[at] = about_y - limit_y;
    values[at + 1u] = -about_y - limit_y;
    values[at + 2u] = about_x - limit_x;
    values[at + 3u] = -about_x - limit_x;
    values[at + 4u] = size + twist - friction * push + margin;

    let rows = rows_at(slot, half, point.place);
    let by_force_y = -constants.pressure[0] * normal;
    let by_force_x = -constants.pressure[1] * normal;
    put_wrench(rows, 0u, i, slot, by_force_y, e_y, dot(moment, e_y_by_yaw));
    put_wrench(rows, 1u, i, slot, by_force_y, -1.0 * e_y, -dot(moment, e_y_by_yaw));
    put_wrench(rows, 2u, i, slot, by_force_x, e_x, dot(moment, e_x_by_yaw));
    put_wrench(rows, 3u, i, slot, by_force_x, -1.0 * e_x, -dot(moment, e_x_by_yaw));
    let share = torsion / twist * lever;
    let by_inverse = (margin * margin - push * push) / (square * square) * dot(across, tangential);
    let by_torsion = inverse * across + by_inverse * normal;
    let by_force = (1.0 / size) * tangential + -friction * normal + share * by_torsion;
    put_wrench(rows, 4u, i, slot, by_force, share * (normal + inverse * tangential), 0.0);
}

// Writes the derivatives of a row by force, moment and yaw of a point.
fn put_wrench(rows: Rows, row: u32, i: u32, slot: u32, by_force: vec3<f32>, by_moment: vec3<f32>, by_yaw: f32) {
    let point = &sole_points[slot * batch.sole_points + i];
    put_by_force(rows, row, point.node_column[0], point.slope_weight, by_force);
    put_by_force(rows, row, point.node_column[1], point.slope_weight, by_moment);
    if (point.yaw_column != NONE) {
        put(rows, row, point.yaw_column, by_yaw);
    }
}
