// needs: shared/triangle
// binds: jacobian factor tables part
// reads: front_steps rests front_rows front_columns factored_instants
// Frontal Cholesky factorisation in time order: assemble, eliminate, move on. One workgroup per candidate; steps `part.first` to
// `part.last`.
//   in      values    weight, value [rows]; diagonal, gradient [variables]
//   in      jacobian  at the point
//   in out  values    carry: what remains of the front between two steps, `[rest][rest + 1]` with its right-hand side
//   out     factor    pivot rows, [pivots][stride] at each step; the right-hand side is in column `size`
//   out     values    flags: 1 if a pivot is not positive
// Solves `(E + J' W J) d = -(u + J' v)` together with substitute.wgsl.
// Twins: src/linear/front.rs, src/linear/factored.rs. Their sums have another order: they add element by element, and eliminate pivots one
// by one.
//
// The front consists of tiles of four by four values, those on and above the diagonal; its last column is the right-hand side. Both the
// assembly and the elimination write rows to `panel` and then add the products of their columns to all tiles.

// Invocations that spread one row, and rows that are spread together.
const TEAM: u32 = max(WORKGROUP / PANEL_ROWS, 1u);
const TEAMS: u32 = WORKGROUP / TEAM;

// Rows by column. Scalars, because invocations write neighbouring columns at the same time, and a backend may write a whole vector where
// one component changes.
var<workgroup> panel: array<f32, PANEL_ROWS * SIDE>;
// By four columns: 1 if a row of the panel touches them.
var<workgroup> touched: array<atomic<u32>, SIDE / 4u>;
// By index in the front: index in what remains of the front before. NONE if the variable is new.
var<workgroup> before: array<u32, SIDE>;

// Four columns of a row, from `4 * group` on.
fn panel_columns(row: u32, group: u32) -> vec4<f32> {
    let at = row * SIDE + 4u * group;
    return vec4<f32>(panel[at], panel[at + 1u], panel[at + 2u], panel[at + 3u]);
}

// Number of tiles on the diagonal of a front with its right-hand side.
fn diagonal_tiles(size: u32) -> u32 {
    return size / 4u + 1u;
}

// Adds to element (i, j) of the front.
fn add_front(slot: u32, tiles: u32, i: u32, j: u32, v: f32) {
    let t = number_of(tiles, i / 4u, j / 4u);
    put_front_value(slot, t, i % 4u, j % 4u, front_value(slot, t, i % 4u, j % 4u) + v);
}

// Sets the panel to zero.
fn clear_panel(lane: u32) {
    for (var i = lane; i < PANEL_ROWS * SIDE; i += WORKGROUP) {
        panel[i] = 0.0;
    }
    for (var i = lane; i < SIDE / 4u; i += WORKGROUP) {
        atomicStore(&touched[i], 0u);
    }
}

// Spreads the Jacobian rows `rows` to the columns of the front, each times the root of its weight.
fn spread(slot: u32, half: u32, rows: Span, size: u32, lane: u32) {
    let base = slot * batch.values;
    for (var n = rows.start + lane / TEAM; n < rows.end; n += TEAMS) {
        let row = front_rows_at(slot, n);
        let weight = values[base + batch.weight + row.row];
        let root = sqrt(weight);
        let jacobian_row = (2u * slot + half) * batch.jacobian + row.jacobian;
        for (var c = row.columns.start + lane % TEAM; c < row.columns.end; c += TEAM) {
            // As `front_column` of src/backend/tables.rs packs them.
            let packed = front_columns_at(slot, c);
            let variable = extractBits(packed, 0u, FRONT_COLUMN_BITS);
            let column = extractBits(packed, FRONT_COLUMN_BITS, FRONT_COLUMN_BITS);
            let block = packed >> (2u * FRONT_COLUMN_BITS);
            var v = root * jacobian[jacobian_row + column];
            if (block > 0u) {
                v *= factored_instants_weights(slot, row.instant, block - 1u);
            }
            panel[(n - rows.start) * SIDE + variable] = v;
            atomicStore(&touched[variable / 4u], 1u);
        }
        if (lane % TEAM == 0u && weight > 0.0) {
            panel[(n - rows.start) * SIDE + size] = -values[base + batch.value + row.row] / root;
            atomicStore(&touched[size / 4u], 1u);
        }
    }
}

// Adds `sign` times the products of two sets of four columns of the panel to a tile.
fn add_products(slot: u32, tile: u32, at: vec2<u32>, rows: u32, sign: f32) {
    var sums = mat4x4<f32>();
    for (var row = 0u; row < rows; row++) {
        let left = panel_columns(row, at.x);
        let right = panel_columns(row, at.y);
        sums[0] += left.x * right;
        sums[1] += left.y * right;
        sums[2] += left.z * right;
        sums[3] += left.w * right;
    }
    put_front_row(slot, tile, 0u, front_row(slot, tile, 0u) + sign * sums[0]);
    put_front_row(slot, tile, 1u, front_row(slot, tile, 1u) + sign * sums[1]);
    put_front_row(slot, tile, 2u, front_row(slot, tile, 2u) + sign * sums[2]);
    put_front_row(slot, tile, 3u, front_row(slot, tile, 3u) + sign * sums[3]);
}

// Adds the spread rows to the tiles that they touch.
fn add_rows(slot: u32, tiles: u32, rows: u32, lane: u32) {
    for (var e = lane; e < cells(tiles); e += WORKGROUP) {
        let at = cell(tiles, e);
        if (at.y < tiles && atomicLoad(&touched[at.x]) + atomicLoad(&touched[at.y]) == 2u) {
            add_products(slot, number_of(tiles, at.x, at.y), at, rows, 1.0);
        }
    }
    front_barrier();
}

// Elements of what remains of the front before, in a row and four columns of `count` and the right-hand side; 0 for new variables. All are
// read at once, some of them in vain.
fn carried(slot: u32, row: u32, columns: vec4<u32>, count: u32) -> vec4<f32> {
    // NONE is larger than any index.
    let low = min(vec4<u32>(row), columns);
    let high = max(vec4<u32>(row), columns);
    let last = vec4<u32>(count);
    let at = slot * batch.values + batch.carry + min(low, last - min(last, vec4<u32>(1u))) * (count + 1u) + min(high, last);
    let v = vec4<f32>(values[at.x], values[at.y], values[at.z], values[at.w]);
    return select(vec4<f32>(), v, (low < last) & (high <= last));
}

// Initialises the front of a step: what remains of the previous front, otherwise zero.
fn begin_front(slot: u32, k: u32, size: u32, lane: u32) {
    let tiles = diagonal_tiles(size);
    for (var i = lane; i < 4u * tiles; i += WORKGROUP) {
        before[i] = NONE;
    }
    workgroupBarrier();
    var count = 0u;
    if (k > 0u) {
        let previous = front_steps_at(slot, k - 1u);
        count = previous.size - previous.pivots;
        for (var a = lane; a <= count; a += WORKGROUP) {
            if (a < count) {
                before[rests_at(slot, previous.rest.start + a).next] = a;
            } else {
                before[size] = count;
            }
        }
    }
    workgroupBarrier();
    for (var e = lane; e < cells(tiles); e += WORKGROUP) {
        let at = cell(tiles, e);
        if (at.y >= tiles) {
            continue;
        }
        let j = 4u * at.y;
        let columns = vec4<u32>(before[j], before[j + 1u], before[j + 2u], before[j + 3u]);
        let t = number_of(tiles, at.x, at.y);
        let i = 4u * at.x;
        put_front_row(slot, t, 0u, carried(slot, before[i], columns, count));
        put_front_row(slot, t, 1u, carried(slot, before[i + 1u], columns, count));
        put_front_row(slot, t, 2u, carried(slot, before[i + 2u], columns, count));
        put_front_row(slot, t, 3u, carried(slot, before[i + 3u], columns, count));
    }
    front_barrier();
}

// Saves what remains of a front after its pivots are eliminated.
fn carry_over(slot: u32, size: u32, pivots: u32, lane: u32) {
    let tiles = diagonal_tiles(size);
    let first = pivots / 4u;
    let carry = slot * batch.values + batch.carry;
    for (var e = lane; e < cells(tiles - first); e += WORKGROUP) {
        let at = first + cell(tiles - first, e);
        if (at.y >= tiles) {
            continue;
        }
        for (var i = 0u; i < 4u; i++) {
            let row = 4u * at.x + i;
            let v = front_row(slot, number_of(tiles, at.x, at.y), i);
            for (var j = 0u; j < 4u; j++) {
                let column = 4u * at.y + j;
                if (row >= pivots && row < size && row <= column && column <= size) {
                    values[carry + (row - pivots) * (size - pivots + 1u) + column - pivots] = v[j];
                }
            }
        }
    }
    storageBarrier();
    workgroupBarrier();
}

// Reciprocal of the pivot's square root; 0 beyond the last row of the panel.
fn reciprocal(pivot: f32, k: u32, count: u32) -> f32 {
    return select(0.0, inverseSqrt(pivot), k < count);
}

// Eliminates up to four pivots, starting at `p`, a multiple of four: `A = U' U` row by row; the rest becomes the Schur complement. Returns
// false if a pivot is not positive.
fn eliminate(slot: u32, at: FrontStep, p: u32, lane: u32) -> bool {
    let size = at.size;
    let tiles = diagonal_tiles(size);
    let count = min(4u, at.pivots - p);
    // Every invocation factorises the block on the diagonal redundantly.
    let block = number_of(tiles, p / 4u, p / 4u);
    let a0 = front_row(slot, block, 0u);
    let a1 = front_row(slot, block, 1u);
    let a2 = front_row(slot, block, 2u);
    let d0 = a0.x;
    let r0 = reciprocal(d0, 0u, count);
    let u01 = a0.y * r0;
    let u02 = a0.z * r0;
    let u03 = a0.w * r0;
    let d1 = a1.y - u01 * u01;
    let r1 = reciprocal(d1, 1u, count);
    let u12 = (a1.z - u01 * u02) * r1;
    let u13 = (a1.w - u01 * u03) * r1;
    let d2 = a2.z - u02 * u02 - u12 * u12;
    let r2 = reciprocal(d2, 2u, count);
    let u23 = (a2.w - u02 * u03 - u12 * u13) * r2;
    let d3 = front_row(slot, block, 3u).w - u03 * u03 - u13 * u13 - u23 * u23;
    let r3 = reciprocal(d3, 3u, count);
    let positive = d0 > 0.0 && (count < 2u || d1 > 0.0) && (count < 3u || d2 > 0.0) && (count < 4u || d3 > 0.0);
    for (var j = p + lane; j <= size; j += WORKGROUP) {
        let t = number_of(tiles, p / 4u, j / 4u);
        let c = j % 4u;
        let y0 = front_value(slot, t, 0u, c) * r0;
        let y1 = select(0.0, (front_value(slot, t, 1u, c) - u01 * y0) * r1, j > p);
        let y2 = select(0.0, (front_value(slot, t, 2u, c) - u02 * y0 - u12 * y1) * r2, j > p + 1u);
        let y3 = select(0.0, (front_value(slot, t, 3u, c) - u03 * y0 - u13 * y1 - u23 * y2) * r3, j > p + 2u);
        let y = vec4<f32>(y0, y1, y2, y3);
        let row = slot * batch.factor + at.factor + p * at.stride + j;
        for (var k = 0u; k < 4u; k++) {
            panel[k * SIDE + j] = y[k];
            if (k < count) {
                factor[row + k * at.stride] = y[k];
            }
        }
    }
    workgroupBarrier();
    let first = (p + count) / 4u;
    for (var e = lane; e < cells(tiles - first); e += WORKGROUP) {
        let tile = first + cell(tiles - first, e);
        if (tile.y < tiles) {
            add_products(slot, number_of(tiles, tile.x, tile.y), tile, 4u, -1.0);
        }
    }
    front_barrier();
    return positive;
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    if (progress[slot].state > CLOSE) {
        return;
    }
    let half = progress[slot].current;
    let base = slot * batch.values;
    var positive = true;
    for (var k = part.first; k < min(part.last, slots[slot].front_steps); k++) {
        let at = front_steps_at(slot, k);
        let tiles = diagonal_tiles(at.size);
        begin_front(slot, k, at.size, lane);
        for (var i = lane; i < at.pivots; i += WORKGROUP) {
            add_front(slot, tiles, i, i, values[base + batch.diagonal + at.variable + i]);
        }
        // The right-hand side may be in the same tile as the diagonal.
        front_barrier();
        for (var i = lane; i < at.pivots; i += WORKGROUP) {
            add_front(slot, tiles, i, at.size, -values[base + batch.gradient + at.variable + i]);
        }
        for (var top = at.rows.start; top < at.rows.end; top += PANEL_ROWS) {
            clear_panel(lane);
            workgroupBarrier();
            let rows = Span(top, min(top + PANEL_ROWS, at.rows.end));
            spread(slot, half, rows, at.size, lane);
            front_barrier();
            add_rows(slot, tiles, rows.end - rows.start, lane);
        }
        front_barrier();
        for (var p = 0u; p < at.pivots; p += 4u) {
            positive = eliminate(slot, at, p, lane) && positive;
        }
        carry_over(slot, at.size, at.pivots, lane);
    }
    if (lane == 0u) {
        let failed = part.first > 0u && values[base + batch.flags] != 0.0;
        values[base + batch.flags] = select(1.0, 0.0, positive && !failed);
    }
}
