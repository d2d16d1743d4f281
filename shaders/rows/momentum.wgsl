// needs: shared/values shared/jacobian shared/math shared/entries
// binds: jacobian footholds momentum_intervals impulses
// Momentum rows of the single rigid body over the intervals between base knots. One thread per interval.
//   in   values    x of the trial point, ground
//   out  values    c at each interval's places: velocity, position; angular momentum at the end, its mean; dimensionless
//   out  values    deviations of the pose at the inner points
//   out  jacobian  6 rows at each interval's linear place, 6 at its angular place
// Twin: src/rows/momentum.rs

const END: u32 = INNER_POINTS;

// Angular momentum `R I R' omega` and its derivatives.
struct AngularMomentum {
    // Rotation from base to world.
    rot_wb: Mat3,
    // Its value, N m s.
    value: vec3<f32>,
    // With respect to each Euler angle, `[angle]`.
    by_angle: Mat3,
    // With respect to each rate.
    by_rate: Mat3,
}

// Angular momentum of a body from its Euler angles and their rates.
fn angular_momentum(inertia: Mat3, angles: vec3<f32>, rates: vec3<f32>) -> AngularMomentum {
    let turned = euler(angles);
    let rot_wb = turned.rot_wb;
    let axes = turned.axes;
    let omega = along(axes, rates);
    let value = inertia_times(rot_wb, inertia, omega);
    // Turning the body about an axis while omega stays: axis x L - I_w (axis x omega).
    let by_roll = cross(axes[0], value) - inertia_times(rot_wb, inertia, cross(axes[0], omega));
    let by_pitch = cross(axes[1], value) - inertia_times(rot_wb, inertia, cross(axes[1], omega));
    // The pitch carries the roll axis along, the yaw everything.
    let carried = inertia_times(rot_wb, inertia, rates[0] * cross(axes[1], axes[0]));
    return AngularMomentum(
        rot_wb,
        value,
        Mat3(by_roll, by_pitch + carried, cross(axes[2], value)),
        Mat3(inertia_times(rot_wb, inertia, axes[0]), inertia_times(rot_wb, inertia, axes[1]), inertia_times(rot_wb, inertia, axes[2])),
    );
}

// `R I R' v`.
fn inertia_times(rot_wb: Mat3, inertia: Mat3, v: vec3<f32>) -> vec3<f32> {
    return mul(rot_wb, mul(inertia, mul_transposed(rot_wb, v)));
}

// `[points]` of vectors.
alias Points = array<vec3<f32>, MOMENTUM_POINTS>;

// Attitude and planned angular momentum at an inner point.
struct Inside {
    angles: vec3<f32>,
    rot_wb: Mat3,
    momentum: vec3<f32>,
}

// Momentum rows of one interval: `momentum_interval` of the twin.
fn entry(slot: u32, half: u32, k: u32) {
    let interval = &momentum_intervals[slot * batch.momentum_intervals + k];
    let points = &slots[slot].points;
    let constants = &slots[slot].constants;
    let mass = constants.mass;
    let h = constants.interval;
    let gravity = -GRAVITY;
    let inertia = mat3(constants.inertia);
    let x = ix_x(slot, half);
    // Deviations from the reference line: pose and rates at the start, pose and rates at the end.
    var state: array<Motion, 4>;
    for (var i = 0u; i < 4u; i++) {
        let at = x + interval.variable[i];
        state[i] = Motion(three(at), three(at + 3u));
    }
    let line = motion(interval.rate);
    let reference = array<Motion, 2>(motion(interval.reference[0]), motion(interval.reference[1]));
    let base_w = reference[0].linear + state[0].linear;
    let velocity_w = line.linear + state[1].linear;

    let linear_scale = constants.balance_scale / h;
    let position_scale = 2.0 * linear_scale / h;
    let end_scale = constants.moment_scale / h;
    let mean_scale = 2.0 * end_scale;

    // Impulses of all feet, and their moments about the base at the start.
    var first = Points();
    var second = Points();
    var third = Points();
    var moment = Points();
    let angular_rows = rows_at(slot, half, interval.angular);
    let impulses_start = slot * batch.impulses + interval.impulses.start;
    let impulses_end = slot * batch.impulses + interval.impulses.end;
    var impulse = impulses_start;
    while (impulse < impulses_end) {
        let foothold = impulses[impulse].foothold;
        let column = impulses[impulse].foothold_column;
        var foot_first = Points();
        for (; impulse < impulses_end && impulses[impulse].foothold == foothold; impulse++) {
            let at = x + impulses[impulse].node;
            let value = three(at);
            let slope = three(at + 3u);
            for (var q = 0u; q < MOMENTUM_POINTS; q++) {
                let w = &impulses[impulse].weights[q];
                foot_first[q] += w[0][0] * value + w[0][1] * slope;
                second[q] += w[1][0] * value + w[1][1] * slope;
                third[q] += w[2][0] * value + w[2][1] * slope;
            }
        }
        let at = x + footholds[slot * batch.footholds + foothold];
        let arm = vec3<f32>(values[at], values[at + 1u], ground_height(slot, foothold)) - base_w;
        var mean = vec3<f32>();
        for (var q = 0u; q < MOMENTUM_POINTS; q++) {
            first[q] += foot_first[q];
            moment[q] += cross(arm, foot_first[q]);
            mean += points[q].mean * foot_first[q];
        }
        // -d(arm x J)/d arm = [J]x; the height follows the slope.
        if (column != NONE) {
            let slope = ground_slope(slot, foothold);
            put_by_foothold(angular_rows, 0u, column, end_scale * foot_first[END], slope);
            put_by_foothold(angular_rows, 3u, column, mean_scale * mean, slope);
        }
    }

    // The linear motion that follows, and the angular momentum gained.
    let gravity_w = vec3<f32>(0.0, 0.0, gravity);
    var moved: Points;
    var velocity: Points;
    var gained: Points;
    var gained_mean = vec3<f32>();
    for (var q = 0u; q < MOMENTUM_POINTS; q++) {
        let t = points[q].time;
        let fallen = 0.5 * gravity * t * t;
        velocity[q] = velocity_w + first[q] / mass;
        moved[q] = t * velocity_w + second[q] / mass;
        velocity[q].z += gravity * t;
        moved[q].z += fallen;
        let lever = 0.5 * mass * t * t * velocity_w + third[q];
        let carried = cross(lever, gravity_w) - mass * cross(moved[q], velocity[q]);
        gained[q] = moment[q] + carried;
        gained_mean += points[q].mean * gained[q];
    }

    var start = angular_momentum(inertia, reference[0].angular + state[0].angular, line.angular + state[1].angular);
    var end = angular_momentum(inertia, reference[1].angular + state[2].angular, line.angular + state[3].angular);
    // Mean of the planned angular momentum, and its derivatives by angles and rates at the start and at the end.
    var planned = vec3<f32>();
    var planned_by: array<Mat3, 4>;
    var inside: array<Inside, INNER_POINTS>;
    for (var q = 0u; q < END; q++) {
        let point = &points[q];
        var angles = reference[0].angular + point.time * line.angular;
        var rates = line.angular;
        for (var i = 0u; i < 4u; i++) {
            angles += point.value[i] * state[i].angular;
            rates += point.rate[i] * state[i].angular;
        }
        var here = angular_momentum(inertia, angles, rates);
        planned += point.mean * here.value;
        inside[q] = Inside(angles, here.rot_wb, here.value);
        for (var i = 0u; i < 4u; i++) {
            let value = point.mean * point.value[i];
            let slope = point.mean * point.rate[i];
            for (var d = 0u; d < 3u; d++) {
                planned_by[i][d] += value * here.by_angle[d] + slope * here.by_rate[d];
            }
        }
    }

    let beyond_end = start.value + gained[END] - end.value;
    let beyond_mean = start.value + gained_mean - planned;
    let deviation_mean = deviate(slot, k, velocity_w, start.value, &gained, &inside, beyond_end, beyond_mean, &moved, &velocity);
    let linear_at = ix_equality(slot, half, interval.linear.row);
    let sped_up = mass * (state[3].linear - state[1].linear - h * gravity_w) - first[END];
    let moved_on = mass * (state[2].linear - state[0].linear - h * state[1].linear - 0.5 * h * h * gravity_w) - second[END];
    put_three(linear_at, sped_up * linear_scale);
    put_three(linear_at + 3u, moved_on * position_scale);
    let angular_at = ix_equality(slot, half, interval.angular.row);
    put_three(angular_at, (end.value - start.value - gained[END]) * end_scale);
    put_three(angular_at + 3u, (planned - start.value - gained_mean + deviation_mean) * mean_scale);

    let linear_rows = rows_at(slot, half, interval.linear);
    for (impulse = impulses_start; impulse < impulses_end; impulse++) {
        let w = &impulses[impulse].weights[END];
        for (var part = 0u; part < 2u; part++) {
            for (var d = 0u; d < 3u; d++) {
                let column = impulses[impulse].linear_column + 3u * part + d;
                put(linear_rows, d, column, -w[0][part] * linear_scale);
                put(linear_rows, 3u + d, column, -w[1][part] * position_scale);
            }
        }
    }
    // Velocity and position rows by pose and rates at the start, pose and rates at the end.
    var by = array<vec2<f32>, 4>(vec2<f32>(0.0, -mass), vec2<f32>(-mass, -mass * h), vec2<f32>(0.0, mass), vec2<f32>(mass, 0.0));
    for (var i = 0u; i < 4u; i++) {
        if (interval.linear_column[i] != NONE) {
            for (var d = 0u; d < 3u; d++) {
                let column = interval.linear_column[i] + d;
                put(linear_rows, d, column, by[i].x * linear_scale);
                put(linear_rows, 3u + d, column, by[i].y * position_scale);
            }
        }
    }

    angular_by_forces(slot, x, impulses_start, impulses_end, base_w, &moved, &velocity, end_scale, mean_scale, angular_rows);
    // By position and velocity at the start: -[J]x and -[tau J - P]x.
    var by_position = vec3<f32>();
    var by_velocity = vec3<f32>();
    for (var q = 0u; q < END; q++) {
        let t = points[q].time;
        let mean = points[q].mean;
        by_position += mean * first[q];
        by_velocity += mean * (t * first[q] - second[q]);
    }
    if (interval.angular_column[0] != NONE) {
        put_cross(angular_rows, 0u, interval.angular_column[0], -end_scale * first[END]);
        put_cross(angular_rows, 3u, interval.angular_column[0], -mean_scale * by_position);
    }
    if (interval.angular_column[1] != NONE) {
        put_cross(angular_rows, 0u, interval.angular_column[1], -end_scale * (h * first[END] - second[END]));
        put_cross(angular_rows, 3u, interval.angular_column[1], -mean_scale * by_velocity);
    }
    var ends = array<Mat3, 4>(start.by_angle, start.by_rate, end.by_angle, end.by_rate);
    for (var i = 0u; i < 4u; i++) {
        if (interval.angular_column[i] == NONE) {
            continue;
        }
        let column = interval.angular_column[i] + 3u;
        for (var d = 0u; d < 3u; d++) {
            var by_end = ends[i][d];
            var by_mean = planned_by[i][d];
            if (i < 2u) {
                by_mean -= by_end;
                by_end = -by_end;
            }
            put_column(angular_rows, 0u, column + d, by_end * end_scale);
            put_column(angular_rows, 3u, column + d, by_mean * mean_scale);
        }
    }
}

// Writes `[j]x` by a foothold, whose height follows the slope, into three rows.
fn put_by_foothold(rows: Rows, row: u32, column: u32, j: vec3<f32>, slope: vec2<f32>) {
    let along_z = vec3<f32>(j.y, -j.x, 0.0);
    put_column(rows, row, column, vec3<f32>(0.0, j.z, -j.y) + slope.x * along_z);
    put_column(rows, row, column + 1u, vec3<f32>(-j.z, 0.0, j.x) + slope.y * along_z);
}

// How the motion inside an interval deviates from the cubic through its knots. Returns the deviation of the mean angular momentum.
//
// In position by the difference to the cubic through the end that the forces lead to. In attitude by the rotation vector
// `eps' = I_w^-1 (e - eps x L)`, where `e` is the angular momentum that the forces give beyond the planned one, less a quadratic
// that takes what is missing in the rows, so that rows that do not hold yet bend nothing.
fn deviate(
    slot: u32,
    k: u32,
    velocity_w: vec3<f32>,
    momentum_start: vec3<f32>,
    gained: ptr<function, Points>,
    inside: ptr<function, array<Inside, INNER_POINTS>>,
    beyond_end: vec3<f32>,
    beyond_mean: vec3<f32>,
    moved: ptr<function, Points>,
    velocity: ptr<function, Points>,
) -> vec3<f32> {
    let points = &slots[slot].points;
    let interval = slots[slot].constants.interval;
    for (var q = 0u; q < END; q++) {
        let w = &points[q].value;
        let cubic = w[1] * velocity_w + w[2] * moved[END] + w[3] * velocity[END];
        put_three(ix_deviation(slot, k, q), moved[q] - cubic);
    }
    // Twice: the second time with the turning of what has been gained.
    var beyond: array<vec3<f32>, INNER_POINTS>;
    for (var q = 0u; q < END; q++) {
        let u = points[q].time / interval;
        let quadratic = u * (6.0 * beyond_mean - 2.0 * beyond_end) + u * u * (3.0 * beyond_end - 6.0 * beyond_mean);
        beyond[q] = momentum_start + gained[q] - inside[q].momentum - quadratic;
    }
    let inverse_inertia = mat3(slots[slot].constants.inverse_inertia);
    var turned: array<vec3<f32>, INNER_POINTS>;
    var rate: array<vec3<f32>, INNER_POINTS>;
    for (var turn = 0u; turn < 2u; turn++) {
        for (var q = 0u; q < END; q++) {
            let change = beyond[q] - cross(turned[q], inside[q].momentum);
            rate[q] = inertia_times(inside[q].rot_wb, inverse_inertia, change);
        }
        for (var q = 0u; q < END; q++) {
            turned[q] = vec3<f32>();
            for (var r = 0u; r < END; r++) {
                turned[q] += points[q].integral[r] * rate[r];
            }
        }
    }
    var mean_rate = vec3<f32>();
    for (var q = 0u; q < END; q++) {
        mean_rate += points[q].mean * rate[q];
        // From a rotation vector to Euler angles: the inverse of the axes, kept finite where the pitch is steep.
        let angles = reduced(inside[q].angles);
        let sz = sin(angles.z);
        let cz = cos(angles.z);
        let sy = sin(angles.y);
        let cos_pitch = cos(angles.y);
        let cy = select(cos_pitch, 0.1, abs(cos_pitch) < 0.1);
        let forward = cz * turned[q].x + sz * turned[q].y;
        put_three(
            ix_deviation(slot, k, q) + 3u,
            vec3<f32>(forward / cy, cz * turned[q].y - sz * turned[q].x, turned[q].z + forward * sy / cy),
        );
    }
    return -inertia_times(inside[END / 2u].rot_wb, mat3(slots[slot].constants.inertia), mean_rate);
}

// Angular rows by the forces: `-[a]x` with `a = w_1 (x_i - p_k - d) + w_2 v - w_3 g`, `w` the integrals of the node's basis function.
fn angular_by_forces(
    slot: u32,
    x: u32,
    impulses_start: u32,
    impulses_end: u32,
    base_w: vec3<f32>,
    moved: ptr<function, Points>,
    velocity: ptr<function, Points>,
    end_scale: f32,
    mean_scale: f32,
    rows: Rows,
) {
    for (var impulse = impulses_start; impulse < impulses_end; impulse++) {
        let foothold = impulses[impulse].foothold;
        let at = x + footholds[slot * batch.footholds + foothold];
        let arm = vec3<f32>(values[at], values[at + 1u], ground_height(slot, foothold)) - base_w;
        for (var part = 0u; part < 2u; part++) {
            var mean = vec3<f32>();
            for (var q = 0u; q < END; q++) {
                mean += slots[slot].points[q].mean * lever(impulse, q, part, arm - moved[q], velocity[q]);
            }
            let column = impulses[impulse].angular_column + 3u * part;
            put_cross(rows, 0u, column, -end_scale * lever(impulse, END, part, arm - moved[END], velocity[END]));
            put_cross(rows, 3u, column, -mean_scale * mean);
        }
    }
}

// `a` at one point.
fn lever(impulse: u32, q: u32, part: u32, arm: vec3<f32>, velocity: vec3<f32>) -> vec3<f32> {
    let w = &impulses[impulse].weights[q];
    var a = w[0][part] * arm + w[1][part] * velocity;
    a.z += w[2][part] * GRAVITY;
    return a;
}
