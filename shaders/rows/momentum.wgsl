// needs: shared/values shared/jacobian shared/math
// binds: jacobian footholds momentum_intervals impulses
// Momentum rows of the single rigid body over the intervals between base knots. Eight threads per interval: one per point, the last of
// which is the end, and one for the start. Results that other threads need are exchanged through workgroup memory: a single thread per
// interval would need more registers than there are.
//   in   values    x of the trial point, ground
//   out  values    c at each interval's places: velocity, position; angular momentum at the end, its mean; dimensionless
//   out  values    deviations of the pose at the inner points
//   out  jacobian  6 rows at each interval's linear place, 6 at its angular place
// Twin: src/rows/momentum.rs

const END: u32 = INNER_POINTS;
// Threads per interval. The last one handles the start.
const LANES: u32 = MOMENTUM_POINTS + 1u;
const START: u32 = MOMENTUM_POINTS;
const_assert WORKGROUP % LANES == 0u;

// Displacement of the base from the start of the interval to the point, and velocity there; by thread.
var<workgroup> moved: array<vec3<f32>, WORKGROUP>;
var<workgroup> velocity: array<vec3<f32>, WORKGROUP>;
// Exchange buffers of two vectors per thread, see `share`.
var<workgroup> one: array<vec3<f32>, WORKGROUP>;
var<workgroup> other: array<vec3<f32>, WORKGROUP>;

// Angular momentum `R I R' omega` and its derivatives.
struct AngularMomentum {
    // Rotation from base to world.
    rot_wb: Mat3,
    // Angular momentum, N m s.
    value: vec3<f32>,
    // Derivative with respect to each Euler angle, `[angle]`.
    by_angle: Mat3,
    // Derivative with respect to each rate of an Euler angle.
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

// Indices and scales of one thread's interval.
struct At {
    slot: u32,
    half: u32,
    // Index of the interval among those of its candidate, and in the table.
    k: u32,
    entry: u32,
    // First thread of the interval, and the index of this thread within it: a point, or the start.
    first: u32,
    q: u32,
    // Range of the interval in the table of impulses.
    impulses: u32,
    impulses_end: u32,
    // Jacobian rows of the angular element.
    angular: Rows,
    // Scales of the angular rows: at the end, and of the mean.
    end_scale: f32,
    mean_scale: f32,
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    if (progress[slot].state >= ENDED) {
        return;
    }
    for (var done = 0u; done < entries(slot); done += WORKGROUP / LANES) {
        interval_rows(slot, done + lane / LANES, lane);
    }
}

// Momentum rows of one interval. Twin: `momentum_interval`. Every thread of the workgroup must call this function, even one without an
// interval.
fn interval_rows(slot: u32, k: u32, lane: u32) {
    let present = k < entries(slot);
    var at: At;
    var momentum: AngularMomentum;
    var angles: vec3<f32>;
    if (present) {
        at = place(slot, k, lane);
        angles = angles_at(at);
        momentum = angular_momentum(mat3(slots[slot].constants.inertia), angles, rates_at(at));
    }
    // Derivatives by attitude and its rates, one Euler angle at a time.
    share(lane, momentum.by_angle[0], momentum.by_rate[0]);
    if (present) {
        put_by_attitude(at, 0u);
    }
    share(lane, momentum.by_angle[1], momentum.by_rate[1]);
    if (present) {
        put_by_attitude(at, 1u);
    }
    share(lane, momentum.by_angle[2], momentum.by_rate[2]);
    if (present) {
        put_by_attitude(at, 2u);
    }

    var gained: vec3<f32>;
    var forces: Impulses;
    if (present && at.q < MOMENTUM_POINTS) {
        forces = impulses_until(at);
        gained = follow(at, forces, lane);
        if (at.q == END) {
            put_linear(at, forces);
        }
    }
    share(lane, gained, momentum.value);
    var missing: Missing;
    if (present) {
        missing = put_angular(at, momentum.value);
    }
    deviate(at, present, lane, angles, momentum.rot_wb, momentum.value, missing);

    // Last, because the attitude then needs no registers any more.
    share(lane, forces.first, slots[slot].points[min(lane % LANES, END)].time * forces.first - forces.second);
    if (present) {
        put_by_start(at);
        put_by_footholds(at);
        put_by_forces(at);
        put_by_moments(at);
    }
}

// Publishes two vectors of each thread to the other threads, after the previous ones have been read.
fn share(lane: u32, a: vec3<f32>, b: vec3<f32>) {
    workgroupBarrier();
    one[lane] = a;
    other[lane] = b;
    workgroupBarrier();
}

fn place(slot: u32, k: u32, lane: u32) -> At {
    let entry = slot * batch.momentum_intervals + k;
    let span = momentum_intervals[entry].impulses;
    let end_scale = slots[slot].constants.moment_scale / slots[slot].constants.interval;
    let half = 1u - progress[slot].current;
    return At(
        slot,
        half,
        k,
        entry,
        lane - lane % LANES,
        lane % LANES,
        slot * batch.impulses + span.start,
        slot * batch.impulses + span.end,
        rows_at(slot, half, momentum_intervals[entry].angular),
        end_scale,
        2.0 * end_scale,
    );
}

// Linear part of a block's deviation from the reference line. Blocks: pose and rates at the start, pose and rates at the end.
fn linear_state(at: At, block: u32) -> vec3<f32> {
    return three(ix_x(at.slot, at.half) + momentum_intervals[at.entry].variable[block]);
}

fn angular_state(at: At, block: u32) -> vec3<f32> {
    return three(ix_x(at.slot, at.half) + momentum_intervals[at.entry].variable[block] + 3u);
}

// Euler angles of the planned motion at this thread's point.
fn angles_at(at: At) -> vec3<f32> {
    let interval = &momentum_intervals[at.entry];
    if (at.q >= END) {
        let side = select(0u, 1u, at.q == END);
        return motion(interval.reference[side]).angular + angular_state(at, 2u * side);
    }
    let point = &slots[at.slot].points[at.q];
    var angles = motion(interval.reference[0]).angular + point.time * motion(interval.rate).angular;
    for (var i = 0u; i < 4u; i++) {
        angles += point.value[i] * angular_state(at, i);
    }
    return angles;
}

// Rates of the Euler angles of the planned motion at this thread's point.
fn rates_at(at: At) -> vec3<f32> {
    var rates = motion(momentum_intervals[at.entry].rate).angular;
    if (at.q >= END) {
        return rates + angular_state(at, select(1u, 3u, at.q == END));
    }
    for (var i = 0u; i < 4u; i++) {
        rates += slots[at.slot].points[at.q].rate[i] * angular_state(at, i);
    }
    return rates;
}

// Derivatives of the angular rows by one Euler angle and its rate, at the start and at the end. `one` and `other` hold the derivatives of
// the angular momentum by them. Two threads per block: one writes the rows at the end, the other the rows of the mean.
fn put_by_attitude(at: At, angle: u32) {
    let block = at.q / 2u;
    let column = momentum_intervals[at.entry].angular_column[block];
    if (column == NONE) {
        return;
    }
    let side = at.first + select(END, START, block < 2u);
    var by_end = select(other[side], one[side], block % 2u == 0u);
    if (at.q % 2u == 0u) {
        put_column(at.angular, 0u, column + 3u + angle, select(by_end, -by_end, block < 2u) * at.end_scale);
        return;
    }
    var by_mean = vec3<f32>();
    for (var q = 0u; q < END; q++) {
        let point = &slots[at.slot].points[q];
        by_mean += point.mean * point.value[block] * one[at.first + q] + point.mean * point.rate[block] * other[at.first + q];
    }
    if (block < 2u) {
        by_mean -= by_end;
    }
    put_column(at.angular, 3u, column + 3u + angle, by_mean * at.mean_scale);
}

// First to third integral of the forces of all feet from the start of an interval to a point, and the moment of the first integral about
// the base at the start.
struct Impulses {
    first: vec3<f32>,
    second: vec3<f32>,
    third: vec3<f32>,
    moment: vec3<f32>,
}

fn base_at_start(at: At) -> vec3<f32> {
    return motion(momentum_intervals[at.entry].reference[0]).linear + linear_state(at, 0u);
}

fn velocity_at_start(at: At) -> vec3<f32> {
    return motion(momentum_intervals[at.entry].rate).linear + linear_state(at, 1u);
}

// Vector from the base at the start of the interval to a foothold.
fn arm_to(at: At, base_w: vec3<f32>, foothold: u32) -> vec3<f32> {
    let under = ix_x(at.slot, at.half) + footholds[at.slot * batch.footholds + foothold];
    return vec3<f32>(values[under], values[under + 1u], ground_height(at.slot, foothold)) - base_w;
}

// Range of the interval's moment nodes in the table of impulses.
fn moments_of(at: At) -> Span {
    let moments = momentum_intervals[at.entry].moments;
    let first = at.slot * batch.impulses;
    return Span(first + moments.start, first + moments.end);
}

fn impulses_until(at: At) -> Impulses {
    let x = ix_x(at.slot, at.half);
    let base_w = base_at_start(at);
    var sum: Impulses;
    var impulse = at.impulses;
    while (impulse < at.impulses_end) {
        let foothold = impulses[impulse].foothold;
        var first = vec3<f32>();
        for (; impulse < at.impulses_end && impulses[impulse].foothold == foothold; impulse++) {
            let node = x + impulses[impulse].node;
            let value = three(node);
            let slope = three(node + 3u);
            let w = &impulses[impulse].weights[at.q];
            first += w[0][0] * value + w[0][1] * slope;
            sum.second += w[1][0] * value + w[1][1] * slope;
            sum.third += w[2][0] * value + w[2][1] * slope;
        }
        sum.first += first;
        sum.moment += cross(arm_to(at, base_w, foothold), first);
    }
    let moments = moments_of(at);
    for (var i = moments.start; i < moments.end; i++) {
        let node = x + impulses[i].node;
        let w = &impulses[i].weights[at.q];
        sum.moment += w[0][0] * three(node) + w[0][1] * three(node + 3u);
    }
    return sum;
}

// Computes the linear motion from the start to this thread's point. Returns the angular momentum gained.
fn follow(at: At, forces: Impulses, lane: u32) -> vec3<f32> {
    let mass = slots[at.slot].constants.mass;
    let t = slots[at.slot].points[at.q].time;
    let velocity_w = velocity_at_start(at);
    var velocity_q = velocity_w + forces.first / mass;
    var moved_q = t * velocity_w + forces.second / mass;
    velocity_q.z += -GRAVITY * t;
    moved_q.z += 0.5 * -GRAVITY * t * t;
    velocity[lane] = velocity_q;
    moved[lane] = moved_q;
    let lever = 0.5 * mass * t * t * velocity_w + forces.third;
    let carried = cross(lever, vec3<f32>(0.0, 0.0, -GRAVITY)) - mass * cross(moved_q, velocity_q);
    return forces.moment + carried;
}

// Residuals of the linear rows. Called by the thread of the end.
fn put_linear(at: At, forces: Impulses) {
    let constants = &slots[at.slot].constants;
    let mass = constants.mass;
    let h = constants.interval;
    let gravity_w = vec3<f32>(0.0, 0.0, -GRAVITY);
    let velocity_start = linear_state(at, 1u);
    let sped_up = mass * (linear_state(at, 3u) - velocity_start - h * gravity_w) - forces.first;
    let moved_on = mass * (linear_state(at, 2u) - linear_state(at, 0u) - h * velocity_start - 0.5 * h * h * gravity_w) - forces.second;
    let linear_scale = constants.balance_scale / h;
    let to = ix_equality(at.slot, at.half, momentum_intervals[at.entry].linear.row);
    put_three(to, sped_up * linear_scale);
    put_three(to + 3u, moved_on * (2.0 * linear_scale / h));
}

// Derivatives by pose and velocity at the start and at the end. `one` holds the first integrals `J`, `other` holds `tau J - P`. One thread
// per block writes the velocity and position rows; two more write the angular rows, -[J]x and -[tau J - P]x at the start.
fn put_by_start(at: At) {
    let interval = &momentum_intervals[at.entry];
    let constants = &slots[at.slot].constants;
    if (at.q < 4u) {
        if (interval.linear_column[at.q] == NONE) {
            return;
        }
        let mass = constants.mass;
        let h = constants.interval;
        let linear_scale = constants.balance_scale / h;
        let rows = rows_at(at.slot, at.half, interval.linear);
        // The pose changes the position rows. The rates at the start change both kinds of rows, those at the end only the velocity rows.
        let by_velocity = select(0.0, select(mass, -mass, at.q == 1u), at.q % 2u == 1u);
        let by_position = select(select(select(0.0, mass, at.q == 2u), -mass * h, at.q == 1u), -mass, at.q == 0u);
        for (var d = 0u; d < 3u; d++) {
            put(rows, d, interval.linear_column[at.q] + d, by_velocity * linear_scale);
            put(rows, 3u + d, interval.linear_column[at.q] + d, by_position * (2.0 * linear_scale / h));
        }
        return;
    }
    let block = at.q - 4u;
    if (block > 1u || interval.angular_column[block] == NONE) {
        return;
    }
    var mean = vec3<f32>();
    for (var q = 0u; q < END; q++) {
        mean += slots[at.slot].points[q].mean * select(other[at.first + q], one[at.first + q], block == 0u);
    }
    let last = select(other[at.first + END], one[at.first + END], block == 0u);
    put_cross(at.angular, 0u, interval.angular_column[block], -at.end_scale * last);
    put_cross(at.angular, 3u, interval.angular_column[block], -at.mean_scale * mean);
}

// Derivatives of the angular rows by the footholds: -d(arm x J)/d arm = [J]x; the height of a foothold follows the slope. One thread per
// foothold: that of its first force node.
fn put_by_footholds(at: At) {
    let x = ix_x(at.slot, at.half);
    for (var impulse = at.impulses + at.q; impulse < at.impulses_end; impulse += LANES) {
        let foothold = impulses[impulse].foothold;
        let column = impulses[impulse].foothold_column;
        if (column == NONE || (impulse > at.impulses && impulses[impulse - 1u].foothold == foothold)) {
            continue;
        }
        var first = vec3<f32>();
        var mean = vec3<f32>();
        for (var i = impulse; i < at.impulses_end && impulses[i].foothold == foothold; i++) {
            let node = x + impulses[i].node;
            let value = three(node);
            let slope = three(node + 3u);
            let w = &impulses[i].weights[END][0];
            first += w[0] * value + w[1] * slope;
            // Mean of the weights instead of the mean of the weighted values: equal up to rounding.
            var mean_weights = vec2<f32>();
            for (var q = 0u; q < END; q++) {
                let w = &impulses[i].weights[q][0];
                mean_weights += slots[at.slot].points[q].mean * vec2<f32>(w[0], w[1]);
            }
            mean += mean_weights.x * value + mean_weights.y * slope;
        }
        let slope = ground_slope(at.slot, foothold);
        put_by_foothold(at.angular, 0u, column, at.end_scale * first, slope);
        put_by_foothold(at.angular, 3u, column, at.mean_scale * mean, slope);
    }
}

// Writes `[j]x` by a foothold, whose height follows the slope, into three rows.
fn put_by_foothold(rows: Rows, row: u32, column: u32, j: vec3<f32>, slope: vec2<f32>) {
    let along_z = vec3<f32>(j.y, -j.x, 0.0);
    put_column(rows, row, column, vec3<f32>(0.0, j.z, -j.y) + slope.x * along_z);
    put_column(rows, row, column + 1u, vec3<f32>(-j.z, 0.0, j.x) + slope.y * along_z);
}

// Derivatives by the forces; one thread per value or slope of a force node. Angular rows: `-[a]x` with `a = w_1 (x_i - p_k - d) + w_2 v -
// w_3 g`, where `w` are the integrals of the node's basis function.
fn put_by_forces(at: At) {
    let constants = &slots[at.slot].constants;
    let linear_scale = constants.balance_scale / constants.interval;
    let position_scale = 2.0 * linear_scale / constants.interval;
    let base_w = base_at_start(at);
    let linear = rows_at(at.slot, at.half, momentum_intervals[at.entry].linear);
    for (var task = at.q; task < 2u * (at.impulses_end - at.impulses); task += LANES) {
        let impulse = at.impulses + task / 2u;
        let part = task % 2u;
        let w = &impulses[impulse].weights[END];
        for (var d = 0u; d < 3u; d++) {
            let column = impulses[impulse].linear_column + 3u * part + d;
            put(linear, d, column, -w[0][part] * linear_scale);
            put(linear, 3u + d, column, -w[1][part] * position_scale);
        }
        let arm = arm_to(at, base_w, impulses[impulse].foothold);
        var mean = vec3<f32>();
        for (var q = 0u; q < END; q++) {
            mean += slots[at.slot].points[q].mean * lever(impulse, q, part, arm - moved[at.first + q], velocity[at.first + q]);
        }
        let column = impulses[impulse].angular_column + 3u * part;
        put_cross(at.angular, 0u, column, -at.end_scale * lever(impulse, END, part, arm - moved[at.first + END], velocity[at.first + END]));
        put_cross(at.angular, 3u, column, -at.mean_scale * mean);
    }
}

// Derivatives of the angular rows by the moments; one thread per value or slope of a moment node.
fn put_by_moments(at: At) {
    let moments = moments_of(at);
    for (var task = at.q; task < 2u * (moments.end - moments.start); task += LANES) {
        let impulse = moments.start + task / 2u;
        let part = task % 2u;
        var mean = 0.0;
        for (var q = 0u; q < END; q++) {
            mean += slots[at.slot].points[q].mean * impulses[impulse].weights[q][0][part];
        }
        let column = impulses[impulse].angular_column + 3u * part;
        put_diagonal(at.angular, 0u, column, -at.end_scale * impulses[impulse].weights[END][0][part]);
        put_diagonal(at.angular, 3u, column, -at.mean_scale * mean);
    }
}

// Vector `a` of `put_by_forces` at one point.
fn lever(impulse: u32, q: u32, part: u32, arm: vec3<f32>, velocity: vec3<f32>) -> vec3<f32> {
    let w = &impulses[impulse].weights[q];
    var a = w[0][part] * arm + w[1][part] * velocity;
    a.z += w[2][part] * GRAVITY;
    return a;
}

// Difference between the angular momentum that the forces give and that of the planned motion.
struct Missing {
    // Excess of the angular momentum from the forces over the planned one at a point, minus a quadratic that absorbs the residuals of the
    // rows.
    beyond: vec3<f32>,
    // Residual of the mean, without its deviation and its scale.
    mean: vec3<f32>,
}

// Residuals of the angular rows at the end. `one` holds the angular momenta gained, `other` the planned ones.
fn put_angular(at: At, value: vec3<f32>) -> Missing {
    let points = &slots[at.slot].points;
    var gained_mean = vec3<f32>();
    var planned = vec3<f32>();
    for (var q = 0u; q < MOMENTUM_POINTS; q++) {
        gained_mean += points[q].mean * one[at.first + q];
    }
    for (var q = 0u; q < END; q++) {
        planned += points[q].mean * other[at.first + q];
    }
    let start = other[at.first + START];
    let end = other[at.first + END];
    let gained_end = one[at.first + END];
    if (at.q == END) {
        let to = ix_equality(at.slot, at.half, momentum_intervals[at.entry].angular.row);
        put_three(to, (end - start - gained_end) * at.end_scale);
    }
    let beyond_end = start + gained_end - end;
    let beyond_mean = start + gained_mean - planned;
    let u = points[min(at.q, END)].time / slots[at.slot].constants.interval;
    let quadratic = u * (6.0 * beyond_mean - 2.0 * beyond_end) + u * u * (3.0 * beyond_end - 6.0 * beyond_mean);
    return Missing(start + one[at.first + min(at.q, END)] - value - quadratic, planned - start - gained_mean);
}

// Deviation of the motion inside an interval from the cubic through its knots, and the residuals of the mean angular momentum.
//
// Position: the difference from the cubic through the end state that the forces lead to. Attitude: the rotation vector with `eps' = I_w^-1
// (e - eps x L)`, where `e` is the excess of the angular momentum from the forces over the planned one, minus a quadratic that absorbs the
// residuals of the rows. Thus rows that do not hold yet bend nothing.
fn deviate(at: At, present: bool, lane: u32, angles: vec3<f32>, rot_wb: Mat3, momentum: vec3<f32>, missing: Missing) {
    let inner = present && at.q < END;
    let constants = &slots[at.slot].constants;
    let points = &slots[at.slot].points;
    // Two passes: the second one includes the rotation found by the first.
    var turned = vec3<f32>();
    for (var turn = 0u; turn < 2u; turn++) {
        var rate = vec3<f32>();
        if (inner) {
            rate = inertia_times(rot_wb, mat3(constants.inverse_inertia), missing.beyond - cross(turned, momentum));
        }
        share(lane, rate, vec3<f32>());
        turned = vec3<f32>();
        if (inner) {
            for (var r = 0u; r < END; r++) {
                turned += points[at.q].integral[r] * one[at.first + r];
            }
        }
    }
    if (!inner) {
        return;
    }
    let w = &points[at.q].value;
    let cubic = w[1] * velocity_at_start(at) + w[2] * moved[at.first + END] + w[3] * velocity[at.first + END];
    let to = ix_deviation(at.slot, at.k, at.q);
    put_three(to, moved[lane] - cubic);
    // Converts the rotation vector to Euler angles by the inverse of the axes, which is kept finite at steep pitch.
    let turns = sin_cos(angles);
    let sz = turns.sin.z;
    let cz = turns.cos.z;
    let sy = turns.sin.y;
    let cos_pitch = turns.cos.y;
    let cy = select(cos_pitch, STEEP_COSINE, abs(cos_pitch) < STEEP_COSINE);
    let forward = cz * turned.x + sz * turned.y;
    put_three(to + 3u, vec3<f32>(forward / cy, cz * turned.y - sz * turned.x, turned.z + forward * sy / cy));
    if (at.q == END / 2u) {
        var mean_rate = vec3<f32>();
        for (var q = 0u; q < END; q++) {
            mean_rate += points[q].mean * one[at.first + q];
        }
        let deviation = -inertia_times(rot_wb, mat3(constants.inertia), mean_rate);
        let row = ix_equality(at.slot, at.half, momentum_intervals[at.entry].angular.row) + 3u;
        put_three(row, (missing.mean + deviation) * at.mean_scale);
    }
}
