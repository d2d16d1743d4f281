// needs: shared/values shared/jacobian shared/entries
// binds: jacobian footholds footings
// Boxes of footholds on ground with edges: within its box the whole foot has room. One thread per foothold.
//   in   values    x of the trial point
//   out  values    g at each foothold's place: 2 upper sides, 2 lower sides; dimensionless, feasible when <= 0
//   out  jacobian  2 rows at each place
// Twin: src/rows/footing.rs

// Footing rows of one foothold.
fn entry(slot: u32, half: u32, k: u32) {
    let footing = &footings[slot * batch.footings + k];
    let unit = slots[slot].constants.length_scale;
    let margin = slots[slot].constants.length_margin;
    let at = ix_x(slot, half) + footholds[slot * batch.footholds + footing.foothold];
    let place = ix_inequality(slot, half, footing.place.inequality);
    for (var d = 0u; d < 2u; d++) {
        values[place + d] = (values[at + d] - footing.high[d] + margin) * unit;
        values[place + 2u + d] = (footing.low[d] - values[at + d] + margin) * unit;
    }

    let rows = rows_at(slot, half, footing.place);
    if (footing.foothold_column != NONE) {
        for (var d = 0u; d < 2u; d++) {
            put(rows, d, footing.foothold_column + d, unit);
            put(rows, d, footing.foothold_column + 1u - d, 0.0);
        }
    }
}
