// needs: shared/values shared/terrain shared/entries
// binds: footholds heights
// Ground under every foothold, which other kernels use. One thread per foothold.
//   in   values    x of the trial point
//   out  values    ground: height, slope x, slope y
// Twin: src/rows/ground.rs

fn entry(slot: u32, half: u32, i: u32) {
    let at = ix_x(slot, half) + footholds[slot * batch.footholds + i];
    let under = ground(slots[slot].shape, values[at], values[at + 1u]);
    put_three(ix_ground(slot, i), vec3<f32>(under.height, under.slope));
}
