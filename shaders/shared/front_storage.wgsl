// Front in storage, for fronts that are too large for workgroup memory.

fn front_at(slot: u32, i: u32) -> f32 {
    return values[slot * batch.values + batch.front + i];
}

fn put_front(slot: u32, i: u32, v: f32) {
    values[slot * batch.values + batch.front + i] = v;
}

fn front_barrier() {
    storageBarrier();
    workgroupBarrier();
}
