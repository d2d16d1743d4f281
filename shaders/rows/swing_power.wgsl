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
    let velocity = swing_motion(slot, x, power.foot, 0u);
    let acceleration = swing_motion(slot, x, power.foot, 1u);
    let v = velocity - here.velocity;
    values[ix_equality(slot, half, power.place.row)] = dot(acceleration, v);

    let rows = rows_at(slot, half, power.place);
    put_base(rows, 0u, base, here, vec3<f32>(), -acceleration, vec3<f32>());
    put_swing(slot, rows, 0u, power.foot, acceleration, v);
}
