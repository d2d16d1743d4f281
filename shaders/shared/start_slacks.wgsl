// Start of the slacks and multipliers of a barrier parameter. Twin: `start_slacks` of src/solver/start.rs

// Sets the slacks to `max(|g|, sqrt(mu))` and the multipliers to `mu / s`; each invocation handles its share.
//   half          half of the buffers that holds the point
//   inequalities  number of inequalities
fn start_slacks(slot: u32, half: u32, lane: u32, inequalities: u32, mu: f32) {
    let base = slot * batch.values;
    for (var i = lane; i < inequalities; i += WORKGROUP) {
        let s = max(abs(values[base + batch.g + half * batch.g_half + i]), sqrt(mu));
        values[base + batch.slack + i] = s;
        values[base + batch.multiplier + i] = mu / s;
    }
}
