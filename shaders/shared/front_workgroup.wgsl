// Front in workgroup memory, by row of the tiles.

var<workgroup> front: array<vec4<f32>, FRONT / 4u>;

// Row `i` of a tile.
fn front_row(slot: u32, tile: u32, i: u32) -> vec4<f32> {
    return front[i * (FRONT / 16u) + tile];
}

fn put_front_row(slot: u32, tile: u32, i: u32, v: vec4<f32>) {
    front[i * (FRONT / 16u) + tile] = v;
}

fn front_value(slot: u32, tile: u32, i: u32, j: u32) -> f32 {
    return front[i * (FRONT / 16u) + tile][j];
}

fn put_front_value(slot: u32, tile: u32, i: u32, j: u32, v: f32) {
    front[i * (FRONT / 16u) + tile][j] = v;
}

fn front_barrier() {
    workgroupBarrier();
}
