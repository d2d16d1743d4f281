// needs: shared/slacks shared/round
// The length of the step, and the trial point. One workgroup a candidate.
//   in      values    x, c and g at the point, direction, c_change, g_change, slacks and multipliers
//   in out  progress  length: of the predictor, then of the step
//   out     values    x of the trial point; slack_step, multiplier_step of a barrier step
// Twins: src/solver/advance.rs, src/solver/slacks.rs

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    let base = slot * batch.values;
    let now = progress_at_start(slot, lane);
    if (now.state > CLOSE) {
        return;
    }
    var length = 1.0;
    if (now.state == STEP) {
        length = slack_steps(slot, now.current, lane, Aim(now.mu, now.length));
    }
    let x = base + batch.x;
    for (var i = lane; i < slots[slot].variables; i += WORKGROUP) {
        let here = values[x + now.current * batch.x_half + i];
        values[x + (1u - now.current) * batch.x_half + i] = here + length * values[base + batch.direction + i];
    }
    if (lane == 0u) {
        progress[slot].length = length;
    }
}
