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
    values[at + 1u] = dot(force, v) - pushed * stretched;

    // Derivatives with respect to e, then to the leg: those of a unit vector.
    let by_e = stretched * force + pushed * v;
    let by_leg = inverse * (by_e - dot(e, by_e) * e);
    put_power(slot, half, k, 0u, here, stretched * e, pushed * e, by_leg);
    put_power(slot, half, k, 1u, here, v - stretched * e, force - pushed * e, -by_leg);
}

// Writes one row from its derivatives with respect to force, velocity and leg.
fn put_power(slot: u32, half: u32, k: u32, row: u32, here: Hip, by_force: vec3<f32>, by_velocity: vec3<f32>, by_leg: vec3<f32>) {
    let power = &stance_powers[slot * batch.stance_powers + k];
    let stance = &power.stance;
    let rows = rows_at(slot, half, power.place);
    put_base(rows, row, power.base, here, -by_leg, -by_velocity);
    for (var i = 0u; i < 2u; i++) {
        if (stance.node_column[i] != NONE) {
            put_row(rows, row, stance.node_column[i], stance.weights[i][0] * by_force);
            put_row(rows, row, stance.node_column[i] + 3u, stance.weights[i][1] * by_force);
        }
    }
    if (stance.foothold_column != NONE) {
        let by_foothold = by_leg.xy + by_leg.z * ground_slope(slot, stance.foothold);
        put(rows, row, stance.foothold_column, by_foothold.x);
        put(rows, row, stance.foothold_column + 1u, by_foothold.y);
    }
}
