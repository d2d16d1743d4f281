// needs: shared/values shared/jacobian shared/math shared/entries
// binds: jacobian footholds dynamics_instants stance_forces
// Newton-Euler equations of the single rigid body at the dynamics instants. One thread per instant.
//   in   values    x of the trial point, ground
//   out  values    c at each instant's place: moment / (m g l), balance / (m g)
//   out  jacobian  6 rows at each instant's place
// Twin: src/rows/dynamics.rs          Source: [3]

// Rate of angular momentum of a rotating body and its derivatives.
struct Spin {
    // `I_w omega' + omega x I_w omega`, N m.
    moment: vec3<f32>,
    // Derivative of the moment with respect to each Euler angle, `[angle]`.
    by_angle: Mat3,
    // Derivative of the moment with respect to each rate of an Euler angle.
    by_rate: Mat3,
    // Derivative of the moment with respect to each acceleration of an Euler angle.
    by_acceleration: Mat3,
}

// Rotating body: attitude, motion, and quantities that follow from them.
struct Body {
    rot_wb: Mat3,
    inertia: Mat3,
    omega: vec3<f32>,
    omega_dot: vec3<f32>,
    // `I_w omega`.
    momentum: vec3<f32>,
    // `I_w omega'`.
    inertial: vec3<f32>,
}

// `I_w v` with `I_w = R I R'`.
fn inertia_times(body: Body, v: vec3<f32>) -> vec3<f32> {
    return mul(body.rot_wb, mul(body.inertia, mul_transposed(body.rot_wb, v)));
}

// Change of the moment if `omega` and `omega'` change by `w` and `a` at constant attitude.
fn by_motion(body: Body, w: vec3<f32>, a: vec3<f32>) -> vec3<f32> {
    return inertia_times(body, a) + (cross(w, body.momentum) + cross(body.omega, inertia_times(body, w)));
}

// Change of the moment if the body turns about an axis: `d(I_w v) = axis x I_w v - I_w (axis x v)`.
fn by_turn(body: Body, axis: vec3<f32>) -> vec3<f32> {
    let turned = cross(axis, body.inertial) - inertia_times(body, cross(axis, body.omega_dot));
    let momentum_turned = cross(axis, body.momentum) - inertia_times(body, cross(axis, body.omega));
    return turned + cross(body.omega, momentum_turned);
}

// Rate of angular momentum from Euler angles, their rates and accelerations.
//
// With axes `E = (e_r, e_p, e_z)`: `omega = E angles'` and
// `omega' = E angles'' + (pitch' e_p + yaw' e_z) x roll' e_r + yaw' e_z x pitch' e_p`.
// A change of yaw rotates everything, a change of pitch rotates `e_r`, and a change of roll rotates no axis.
fn spin(inertia: Mat3, angles: vec3<f32>, rates: vec3<f32>, accelerations: vec3<f32>) -> Spin {
    let turned = euler(angles);
    let e_r = turned.axes[0];
    let e_p = turned.axes[1];
    let e_z = turned.axes[2];
    // Angular velocity that rotates the roll axis, and the contribution of each rate to omega.
    let carrier = rates[1] * e_p + rates[2] * e_z;
    let roll = rates[0] * e_r;
    let pitch = rates[1] * e_p;
    let yaw = rates[2] * e_z;
    let bias = cross(carrier, roll) + cross(yaw, pitch);
    let omega = along(turned.axes, rates);
    let omega_dot = along(turned.axes, accelerations) + bias;
    var body = Body(turned.rot_wb, inertia, omega, omega_dot, omega, omega_dot);
    body.momentum = inertia_times(body, omega);
    body.inertial = inertia_times(body, omega_dot);

    let moment = body.inertial + cross(omega, body.momentum);
    let e_r_pitched = cross(e_p, e_r);
    let roll_pitched = rates[0] * e_r_pitched;
    let by_pitch = by_motion(body, roll_pitched, accelerations[0] * e_r_pitched + cross(carrier, roll_pitched));
    return Spin(
        moment,
        Mat3(by_turn(body, e_r), by_turn(body, e_p) + by_pitch, cross(e_z, moment)),
        Mat3(
            by_motion(body, e_r, cross(carrier, e_r)),
            by_motion(body, e_p, cross(e_p, roll) + cross(yaw, e_p)),
            by_motion(body, e_z, cross(e_z, roll + pitch)),
        ),
        Mat3(inertia_times(body, e_r), inertia_times(body, e_p), inertia_times(body, e_z)),
    );
}

// Dynamics rows of one instant. Twin: `dynamics_instant`.
fn entry(slot: u32, half: u32, k: u32) {
    let instant = &dynamics_instants[slot * batch.dynamics_instants + k];
    let constants = &slots[slot].constants;
    let x = ix_x(slot, half);
    var pose = motion(instant.reference);
    var rate = motion(instant.rate);
    var acceleration = Motion();
    for (var i = 0u; i < 3u; i++) {
        let at = x + instant.variable[i];
        pose = add_weighted(pose, instant.weights[0][i], at);
        rate = add_weighted(rate, instant.weights[1][i], at);
        acceleration = add_weighted(acceleration, instant.weights[2][i], at);
    }
    let base_w = pose.linear;
    var spin = spin(mat3(constants.inertia), pose.angular, rate.angular, acceleration.angular);

    let moment_scale = constants.moment_scale;
    let balance_scale = constants.balance_scale;
    var force_sum = vec3<f32>();
    var moment_sum = vec3<f32>();
    let rows = rows_at(slot, half, instant.place);
    for (var f = instant.forces.start; f < instant.forces.end; f++) {
        let stance = &stance_forces[slot * batch.stance_forces + f];
        var force_w = vec3<f32>();
        for (var i = 0u; i < 2u; i++) {
            if (stance.node[i] != NONE) {
                let at = x + stance.node[i];
                force_w += stance.weights[i][0] * three(at) + stance.weights[i][1] * three(at + 3u);
            }
        }
        let at = x + footholds[slot * batch.footholds + stance.foothold];
        let arm = vec3<f32>(values[at], values[at + 1u], ground_height(slot, stance.foothold)) - base_w;
        force_sum += force_w;
        moment_sum += cross(arm, force_w);
        // d(-arm x f)/df = -[arm]x, d(-f)/df = -1.
        let minus_arm = -moment_scale * arm;
        for (var i = 0u; i < 2u; i++) {
            if (stance.node[i] == NONE) {
                continue;
            }
            for (var part = 0u; part < 2u; part++) {
                let w = stance.weights[i][part];
                let c = stance.node_column[i] + 3u * part;
                put_cross(rows, 0u, c, w * minus_arm);
                put_diagonal(rows, 3u, c, -w * balance_scale);
            }
        }
        // d(-arm x f)/d arm = [f]x; the height of a foothold follows the slope.
        if (stance.foothold_column != NONE) {
            let c = stance.foothold_column;
            let f = moment_scale * force_w;
            let slope = ground_slope(slot, stance.foothold);
            // [f]x e_x = (0, f_z, -f_y), [f]x e_y = (-f_z, 0, f_x), [f]x e_z = (f_y, -f_x, 0).
            let along_x = vec3<f32>(0.0, f.z, -f.y) + slope.x * vec3<f32>(f.y, -f.x, 0.0);
            let along_y = vec3<f32>(-f.z, 0.0, f.x) + slope.y * vec3<f32>(f.y, -f.x, 0.0);
            put_column(rows, 0u, c, along_x);
            put_column(rows, 0u, c + 1u, along_y);
            put_column(rows, 3u, c, vec3<f32>());
            put_column(rows, 3u, c + 1u, vec3<f32>());
        }
    }

    let at = ix_equality(slot, half, instant.place.row);
    let gravity = vec3<f32>(0.0, 0.0, constants.weight);
    put_three(at, (spin.moment - moment_sum) * moment_scale);
    put_three(at + 3u, (constants.mass * acceleration.linear - force_sum + gravity) * balance_scale);
    // d(-(x - p) x f)/dp = -[sum f]x.
    let minus_force = -moment_scale * force_sum;
    for (var i = 0u; i < 3u; i++) {
        if (instant.column[i] == NONE) {
            continue;
        }
        let c = instant.column[i];
        let w0 = instant.weights[0][i];
        let w1 = instant.weights[1][i];
        let w2 = instant.weights[2][i];
        put_cross(rows, 0u, c, w0 * minus_force);
        put_diagonal(rows, 3u, c, constants.mass * w2 * balance_scale);
        for (var d = 0u; d < 3u; d++) {
            put_column(rows, 3u, c + 3u + d, vec3<f32>());
            let turn = w0 * spin.by_angle[d] + w1 * spin.by_rate[d] + w2 * spin.by_acceleration[d];
            put_column(rows, 0u, c + 3u + d, turn * moment_scale);
        }
    }
}
