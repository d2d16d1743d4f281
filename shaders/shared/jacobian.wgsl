// Jacobian rows of one element. Twin: `Rows` of src/rows/write.rs

struct Rows {
    first: u32,
    stride: u32,
}

// Rows at a place, in the half of the trial point. The columns of a row are contiguous.
fn rows_at(slot: u32, half: u32, place: Place) -> Rows {
    return Rows((2u * slot + half) * batch.jacobian + place.jacobian, place.stride);
}

fn put(rows: Rows, row: u32, column: u32, value: f32) {
    jacobian[rows.first + row * rows.stride + column] = value;
}

// Writes three values of a row, starting at a column.
fn put_row(rows: Rows, row: u32, column: u32, v: vec3<f32>) {
    put(rows, row, column, v.x);
    put(rows, row, column + 1u, v.y);
    put(rows, row, column + 2u, v.z);
}

// Writes three values of a column, starting at a row.
fn put_column(rows: Rows, row: u32, column: u32, v: vec3<f32>) {
    put(rows, row, column, v.x);
    put(rows, row + 1u, column, v.y);
    put(rows, row + 2u, column, v.z);
}

// Writes `a` times the identity matrix into three rows, starting at a row and a column.
fn put_diagonal(rows: Rows, row: u32, column: u32, a: f32) {
    put_row(rows, row, column, vec3<f32>(a, 0.0, 0.0));
    put_row(rows, row + 1u, column, vec3<f32>(0.0, a, 0.0));
    put_row(rows, row + 2u, column, vec3<f32>(0.0, 0.0, a));
}

// Writes `[a]x` into three rows, starting at a row and a column.
fn put_cross(rows: Rows, row: u32, column: u32, a: vec3<f32>) {
    put_row(rows, row, column, vec3<f32>(0.0, -a.z, a.y));
    put_row(rows, row + 1u, column, vec3<f32>(a.z, 0.0, -a.x));
    put_row(rows, row + 2u, column, vec3<f32>(-a.y, a.x, 0.0));
}
