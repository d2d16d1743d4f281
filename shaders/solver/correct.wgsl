// needs: shared/reduce shared/slacks shared/round shared/all_elements
// binds: elements
// Mehrotra's corrector: longest step of the predictor, target of the barrier parameter, and values of the rows. One workgroup per
// candidate.
//   in      values    g at the point, g_change, slacks and multipliers
//   in out  progress  mu; barrier_floor
//   out     values    slack_step, multiplier_step [inequalities]; weight, value [rows]
// Twin: src/solver/correct.rs

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    let base = slot * batch.values;
    let now = progress_at_start(slot, lane);
    // If the factorisation failed there is nothing to correct, and the barrier parameter must stay.
    if (now.state != STEP || values[base + batch.flags] != 0.0) {
        return;
    }
    let count = slots[slot].inequalities;
    let reach = slack_steps(slot, now.current, lane, BarrierTarget(0.0, 0.0));
    var before = 0.0;
    var after = 0.0;
    for (var i = lane; i < count; i += WORKGROUP) {
        before += product_after(base, i, vec2<f32>());
        after += product_after(base, i, reach);
    }
    before = sum_over(lane, before) / f32(max(count, 1u));
    after = sum_over(lane, after) / f32(max(count, 1u));
    let aim = BarrierTarget(target_barrier(before, after, now.barrier_floor), 1.0);
    // The steps that other invocations wrote are read below.
    storageBarrier();
    for (var i = lane; i < all_elements(slot); i += WORKGROUP) {
        barrier_rows(slot, now.current, any_element(slot, i), aim);
    }
    if (lane == 0u) {
        progress[slot].mu = aim.mu;
    }
}
