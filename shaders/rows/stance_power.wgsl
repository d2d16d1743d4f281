// needs: shared/values shared/jacobian shared/math shared/hip shared/entries
// binds: jacobian footholds momentum_intervals stance_powers
// Powers of standing legs as cost rows, along the leg and across it. One thread per point of the quadrature.
//   in   values    x of the trial point, ground, deviations
//   out  values    c at each row's place: along, across, m/s
//   out  jacobian  two rows at each place
// Twin: src/rows/stance_power.rs

// Powers of one leg at one point.
fn entry(slot: u32, half: u32, k: u32) {
    let power = &stance_powers[slot * batch.stance_powers + k];
    let base = power.base;
    let here = hip(slot, half, base);
    let x = ix_x(slot, half);
    let stance = &power.stance;
    let foothold = x + footholds[slot * batch.footholds + stance.foothold];
    // `stance_force` of the twin. As a function it takes 80 registers instead of 64 on AMD GPUs.
    var force = vec3<f32>();
    for (var i = 0u; i < 2u; i++) {
        if (stance.node[i] != NONE) {
            let at = x + stance.node[i];
            force += stance.weights[i][0] * three(at) + stance.weights[i][1] * three(at + 3u);
        }
    }
    let leg = vec3<f32>(values[foothold], values[foothold + 1u], ground_height(slot, stance.foothold)) - here.position;
    let inverse = 1.0 / max(sqrt(dot(leg, leg)), LEAST_LEG);
    let e = inverse * leg;
    let v = -here.velocity;
    let pushed = dot(force, e);
    let stretched = dot(e, v);
    let at = ix_equality(slot, half, power.place.row);
    values[at] = pushed * stretched;
    let against_body = v - cross(here.omega, leg);
    values[at + 1u] = dot(force, against_body) - pushed * stretched;

    // Derivatives with respect to e, then to the leg: those of a unit vector.
    let by_e = stretched * force + pushed * v;
    let by_leg = inverse * (by_e - dot(e, by_e) * e);
    put_power(slot, k, rows_at(slot, half, power.place), 0u, here, Powers(stretched * e, pushed * e, by_leg, vec3<f32>()));
    let across = Powers(against_body - stretched * e, force - pushed * e, cross(here.omega, force) - by_leg, cross(force, leg));
    put_power(slot, k, rows_at(slot, half, power.place), 1u, here, across);
}

// Derivatives of a row with respect to force, velocity, leg and angular velocity.
struct Powers {
    force: vec3<f32>,
    velocity: vec3<f32>,
    leg: vec3<f32>,
    omega: vec3<f32>,
}

// Writes one row from its derivatives.
fn put_power(slot: u32, k: u32, rows: Rows, row: u32, here: Hip, by: Powers) {
    let power = &stance_powers[slot * batch.stance_powers + k];
    let stance = &power.stance;
    put_base(rows, row, power.base, here, -by.leg, -by.velocity, by.omega);
    for (var i = 0u; i < 2u; i++) {
        if (stance.node_column[i] != NONE) {
            put_row(rows, row, stance.node_column[i], stance.weights[i][0] * by.force);
            put_row(rows, row, stance.node_column[i] + 3u, stance.weights[i][1] * by.force);
        }
    }
    if (stance.foothold_column != NONE) {
        let by_foothold = by.leg.xy + by.leg.z * ground_slope(slot, stance.foothold);
        put(rows, row, stance.foothold_column, by_foothold.x);
        put(rows, row, stance.foothold_column + 1u, by_foothold.y);
    }
}
