// Front in workgroup memory.

var<workgroup> front: array<f32, FRONT>;

fn front_at(slot: u32, i: u32) -> f32 {
    return front[i];
}

fn put_front(slot: u32, i: u32, v: f32) {
    front[i] = v;
}

fn front_barrier() {
    workgroupBarrier();
}
