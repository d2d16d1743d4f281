// needs: shared/slacks shared/round
// Step length and trial point. One workgroup per candidate.
//   in      values    x, c and g at the point, direction, c_change, g_change, slacks and multipliers
//   in      progress  mu; length and dual_length of a shortened step
//   out     progress  length, dual_length
//   out     values    x of the trial point; slack_step, multiplier_step of a barrier step
// Twins: src/solver/advance.rs, src/solver/slacks.rs

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    let base = slot * batch.values;
    let now = progress_at_start(slot, lane);
    if (now.state > CLOSE && now.state != SHORTER) {
        return;
    }
    var lengths = vec2<f32>(1.0);
    if (now.state == SHORTER) {
        lengths = vec2<f32>(now.length, now.dual_length);
    } else if (now.state == STEP) {
        lengths = slack_steps(slot, now.current, lane, BarrierTarget(now.mu, 1.0));
    }
    let x = base + batch.x;
    for (var i = lane; i < slots[slot].variables; i += WORKGROUP) {
        let here = values[x + now.current * batch.x_half + i];
        values[x + (1u - now.current) * batch.x_half + i] = here + lengths.x * values[base + batch.direction + i];
    }
    if (lane == 0u) {
        progress[slot].length = lengths.x;
        progress[slot].dual_length = lengths.y;
    }
}
