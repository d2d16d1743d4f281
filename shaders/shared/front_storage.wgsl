// Front in storage, for fronts that are too large for workgroup memory: value by value of the tiles.

// Row `i` of a tile.
fn front_row(slot: u32, tile: u32, i: u32) -> vec4<f32> {
    let at = slot * batch.values + batch.front + 4u * i * batch.tiles + tile;
    return vec4<f32>(values[at], values[at + batch.tiles], values[at + 2u * batch.tiles], values[at + 3u * batch.tiles]);
}

fn put_front_row(slot: u32, tile: u32, i: u32, v: vec4<f32>) {
    let at = slot * batch.values + batch.front + 4u * i * batch.tiles + tile;
    values[at] = v.x;
    values[at + batch.tiles] = v.y;
    values[at + 2u * batch.tiles] = v.z;
    values[at + 3u * batch.tiles] = v.w;
}

fn front_value(slot: u32, tile: u32, i: u32, j: u32) -> f32 {
    return values[slot * batch.values + batch.front + (4u * i + j) * batch.tiles + tile];
}

fn put_front_value(slot: u32, tile: u32, i: u32, j: u32, v: f32) {
    values[slot * batch.values + batch.front + (4u * i + j) * batch.tiles + tile] = v;
}

fn front_barrier() {
    storageBarrier();
    workgroupBarrier();
}
