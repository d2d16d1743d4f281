// Terrain: height, slope and curvature at (x, y). Reads the samples of grids from `heights`.
// Twins: src/terrain/mod.rs, src/terrain/profile.rs, src/terrain/grid.rs          Source: [3], [4]

struct Ground {
    height: f32,
    slope: vec2<f32>,
    // curvature[i][j] = d slope[i] / d (x, y)[j].
    curvature: array<vec2<f32>, 2>,
}

// Level ground at `height`, m.
fn level(height: f32) -> Ground {
    return Ground(height, vec2<f32>(), array<vec2<f32>, 2>());
}

// Height, slope and curvature at (x, y), m. Outside a grid the height of its edge continues.
fn ground(shape: Shape, x: f32, y: f32) -> Ground {
    if (shape.kind == FLAT) {
        return level(0.0);
    }
    if (shape.kind == GRID) {
        return grid_ground(shape, x, y);
    }
    return profile_ground(shape.kind, x, y);
}

// Ground at (x, y), m, whose slope is averaged over `radius` to both sides along each axis, m.
//
// The height stays exact. With radius 0 it equals `ground`.
fn rounded_ground(shape: Shape, x: f32, y: f32, radius: f32) -> Ground {
    let exact = ground(shape, x, y);
    // The treads of stairs are level and the risers vertical: there is no slope to average.
    if (radius == 0.0 || shape.kind == FLAT || shape.kind == STAIRS) {
        return exact;
    }
    let width = radius + radius;
    let east = ground(shape, x + radius, y);
    let west = ground(shape, x - radius, y);
    let north = ground(shape, x, y + radius);
    let south = ground(shape, x, y - radius);
    return Ground(
        exact.height,
        vec2<f32>((east.height - west.height) / width, (north.height - south.height) / width),
        array<vec2<f32>, 2>((east.slope - west.slope) / width, (north.slope - south.slope) / width),
    );
}

fn within(x: f32, low: f32, high: f32) -> bool {
    return x >= low && x <= high;
}

// Height, slope and curvature of an analytic profile. Its constants are computed in f64 and rounded once.
fn profile_ground(kind: u32, x: f32, y: f32) -> Ground {
    var ground = level(0.0);
    switch (kind) {
        case BLOCK: {
            if (within(x, BLOCK_TOP, BLOCK_END)) {
                ground.height = BLOCK_HEIGHT;
            } else if (within(x, BLOCK_START, BLOCK_TOP)) {
                ground.height = BLOCK_SLOPE * (x - BLOCK_START);
                ground.slope.x = BLOCK_SLOPE;
            }
        }
        case STAIRS: {
            if (x >= STAIRS_START && x < STAIRS_TOP) {
                ground.height = STAIRS_FIRST_HEIGHT;
            } else if (x >= STAIRS_TOP && x < STAIRS_END) {
                ground.height = STAIRS_HEIGHT;
            }
        }
        case GAP: {
            // Zero at both edges and -depth in the middle.
            if (within(x, GAP_START, GAP_END)) {
                let u = x - GAP_MIDDLE;
                ground.height = GAP_BEND * u * u - GAP_DEPTH;
                ground.slope.x = 2.0 * GAP_BEND * u;
                ground.curvature[0].x = 2.0 * GAP_BEND;
            }
        }
        case SLOPE: {
            if (x >= SLOPE_START && x < SLOPE_TOP) {
                ground.height = SLOPE_RISE * (x - SLOPE_START);
                ground.slope.x = SLOPE_RISE;
            } else if (x >= SLOPE_TOP && x < SLOPE_END) {
                ground.height = SLOPE_RISE - SLOPE_RISE * (x - SLOPE_TOP);
                ground.slope.x = -SLOPE_RISE;
            }
        }
        case CHIMNEY: {
            if (within(x, CHIMNEY_START, CHIMNEY_END)) {
                ground.height = CHIMNEY_SLOPE * (y - CHIMNEY_Y);
                ground.slope.y = CHIMNEY_SLOPE;
            }
        }
        case CHIMNEY_LR: {
            // On the common edge of both walls the second one counts.
            if (within(x, CHIMNEY_LR_MIDDLE, CHIMNEY_LR_END)) {
                ground.height = -CHIMNEY_LR_SLOPE * (y + CHIMNEY_LR_Y);
                ground.slope.y = -CHIMNEY_LR_SLOPE;
            } else if (within(x, CHIMNEY_LR_START, CHIMNEY_LR_MIDDLE)) {
                ground.height = CHIMNEY_LR_SLOPE * (y - CHIMNEY_LR_Y);
                ground.slope.y = CHIMNEY_LR_SLOPE;
            }
        }
        default: {}
    }
    return ground;
}

// Cell, fraction within the cell, and samples per metre (0 where `v` is clamped).
struct Located {
    cell: u32,
    fraction: f32,
    per_metre: f32,
}

fn locate(v: f32, low: f32, per_metre: f32, samples: u32) -> Located {
    let u = (v - low) * per_metre;
    let last = f32(samples - 1u);
    let inside = u >= 0.0 && u <= last;
    // Also 0 if u is NaN.
    let clamped = select(0.0, min(u, last), u >= 0.0);
    let cell = min(u32(floor(clamped)), samples - 2u);
    return Located(cell, clamped - f32(cell), select(0.0, per_metre, inside));
}

// Height, slope and curvature of a grid. Beyond the last sample the height of the edge continues.
fn grid_ground(shape: Shape, x: f32, y: f32) -> Ground {
    let i = locate(x, shape.low[0], shape.per_metre[0], shape.rows);
    let j = locate(y, shape.low[1], shape.per_metre[1], shape.columns);
    let a = i.fraction;
    let b = j.fraction;
    // Columns of a row are contiguous.
    let at = shape.first + i.cell * shape.columns + j.cell;
    let h00 = heights[at];
    let h10 = heights[at + shape.columns];
    let h01 = heights[at + 1u];
    let h11 = heights[at + shape.columns + 1u];
    let along_x = h10 - h00;
    let along_y = h01 - h00;
    let twist = h11 - h10 - h01 + h00;
    let bend = twist * i.per_metre * j.per_metre;
    return Ground(
        h00 + a * along_x + b * along_y + a * b * twist,
        vec2<f32>((along_x + b * twist) * i.per_metre, (along_y + a * twist) * j.per_metre),
        array<vec2<f32>, 2>(vec2<f32>(0.0, bend), vec2<f32>(bend, 0.0)),
    );
}
