// needs: shared/jacobian
// Contact forces under a foothold: normal and tangents of the ground with their derivatives, and the derivatives of a row by the force of a
// node.
// Twins: `basis` and `ForceNode` of src/rows/force.rs

// Writes the derivatives of a row by the force of a node: by its value and by its weighted slope.
fn put_by_force(rows: Rows, row: u32, column: u32, slope_weight: f32, by_force: vec3<f32>) {
    put_row(rows, row, column, by_force);
    put_row(rows, row, column + 3u, slope_weight * by_force);
}

// Unit vector and its derivatives with respect to x and y.
struct Direction {
    unit: vec3<f32>,
    by: array<vec3<f32>, 2>,
}

// Normalises `v`, whose derivatives are `by`: `d(v/|v|) = (dv - u (u.dv)) / |v|`.
fn normalised(v: vec3<f32>, by_x: vec3<f32>, by_y: vec3<f32>) -> Direction {
    let inverse = 1.0 / sqrt(dot(v, v));
    let unit = inverse * v;
    return Direction(
        unit,
        array<vec3<f32>, 2>(inverse * (by_x - dot(unit, by_x) * unit), inverse * (by_y - dot(unit, by_y) * unit)),
    );
}

// Normal and both tangents of the ground.
fn basis(ground: Ground) -> array<Direction, 3> {
    let h = ground.slope;
    let hx = ground.curvature[0];
    let hy = ground.curvature[1];
    return array<Direction, 3>(
        normalised(vec3<f32>(-h.x, -h.y, 1.0), vec3<f32>(-hx.x, -hy.x, 0.0), vec3<f32>(-hx.y, -hy.y, 0.0)),
        normalised(vec3<f32>(1.0, 0.0, h.x), vec3<f32>(0.0, 0.0, hx.x), vec3<f32>(0.0, 0.0, hx.y)),
        normalised(vec3<f32>(0.0, 1.0, h.y), vec3<f32>(0.0, 0.0, hy.x), vec3<f32>(0.0, 0.0, hy.y)),
    );
}
