// needs: shared/triangle shared/factored_front
// binds: jacobian factor tables part
// reads: elements runs front_steps rests base_blocks factored_instants factored_elements factored_own
// Frontal Cholesky factorisation in time order: assemble, eliminate, move on. One workgroup per candidate; steps `part.first` to
// `part.last`.
//   in      values    weight, value [rows]; diagonal, gradient [variables]
//   in      jacobian  at the point
//   in out  values    carry: what remains of the front between two steps, `[rest][rest]` and its right-hand side
//   out     factor    pivot rows, [pivots][stride] at each step; the right-hand side is in column `size`
//   out     values    flags: 1 if a pivot is not positive
// Solves `(E + J' W J) d = -(u + J' v)` together with substitute.wgsl.
// Twins: src/linear/front.rs, src/linear/factored.rs. Their sums have another order: they eliminate pivots one by one.

// Front indices of the columns of an element. Two buffers alternate, so that the next element can be prepared.
var<workgroup> columns: array<u32, 2 * COLUMNS>;
// Four rows of the factor, by column.
var<workgroup> panel: array<vec4<f32>, SIDE>;

fn add_front(slot: u32, i: u32, v: f32) {
    put_front(slot, i, front_at(slot, i) + v);
}

// Writes the front indices of the columns of an element. Returns the number of columns; 0 if all variables of the element are fixed.
fn spread(slot: u32, element: Element, side: u32, lane: u32) -> u32 {
    if (element.runs.start == element.runs.end) {
        return 0u;
    }
    let last = runs_at(slot, element.runs.end - 1u);
    for (var k = element.runs.start + lane; k < element.runs.end; k += WORKGROUP) {
        let run = runs_at(slot, k);
        for (var i = 0u; i < run.len; i++) {
            columns[side + run.column + i] = run.front + i;
        }
    }
    return last.column + last.len;
}

// Up to six rows of an element that are added together, restricted to every `step`-th column from `offset` on.
struct Rows {
    // Index of the first Jacobian value, and the offsets of the rows relative to it.
    first: u32,
    at: vec3<u32>,
    at2: vec3<u32>,
    count: u32,
    w: vec3<f32>,
    v: vec3<f32>,
    w2: vec3<f32>,
    v2: vec3<f32>,
    step: u32,
    offset: u32,
}

// Up to three consecutive values, starting at an index; 0 for the others.
fn values_from(at: u32, count: u32) -> vec3<f32> {
    var v = vec3<f32>(values[at], 0.0, 0.0);
    if (count > 1u) {
        v.y = values[at + 1u];
    }
    if (count > 2u) {
        v.z = values[at + 2u];
    }
    return v;
}

// Up to six rows of an element, starting at row `top`.
fn six_rows(slot: u32, half: u32, element: Element, top: u32) -> Rows {
    let w = slot * batch.values + batch.weight + element.place.row + top;
    let v = slot * batch.values + batch.value + element.place.row + top;
    let count = min(element.rows - top, 6u);
    var rows: Rows;
    rows.first = (2u * slot + half) * batch.jacobian + element.place.jacobian + top * element.place.stride;
    rows.at = element.place.stride * vec3<u32>(0u, 1u, 2u);
    rows.at2 = element.place.stride * vec3<u32>(3u, 4u, 5u);
    rows.count = count;
    rows.w = values_from(w, count);
    rows.v = values_from(v, count);
    if (count > 3u) {
        rows.w2 = values_from(w + 3u, count - 3u);
        rows.v2 = values_from(v + 3u, count - 3u);
    }
    rows.step = 1u;
    return rows;
}

// The two rows of linear momentum along one axis. They touch only the columns of that axis.
fn rows_along(rows: Rows, axis: u32) -> Rows {
    var along: Rows;
    along.first = rows.first;
    along.at = vec3<u32>(rows.at[axis], rows.at2[axis], 0u);
    along.count = 2u;
    along.w = vec3<f32>(rows.w[axis], rows.w2[axis], 0.0);
    along.v = vec3<f32>(rows.v[axis], rows.v2[axis], 0.0);
    along.step = 3u;
    along.offset = axis;
    return along;
}

// Values of up to three rows in one column; 0 for the others.
fn column_of(first: u32, at: vec3<u32>, count: u32) -> vec3<f32> {
    var v = vec3<f32>(jacobian[first + at.x], 0.0, 0.0);
    if (count > 1u) {
        v.y = jacobian[first + at.y];
    }
    if (count > 2u) {
        v.z = jacobian[first + at.z];
    }
    return v;
}

// Adds `J' W J` and `-J' v` of the given rows over `count` columns to the front.
fn add_rows(slot: u32, rows: Rows, side: u32, count: u32, size: u32, lane: u32) {
    if (all(rows.w == vec3<f32>()) && all(rows.w2 == vec3<f32>())) {
        return;
    }
    // Tiles of two by two columns.
    let pairs = (count + 1u) / 2u;
    for (var e = lane; e < cells(pairs); e += WORKGROUP) {
        let at = 2u * cell(pairs, e);
        if (at.y >= count) {
            continue;
        }
        let a = rows.step * at.x + rows.offset;
        let b = rows.step * at.y + rows.offset;
        let next_a = rows.step * min(at.x + 1u, count - 1u) + rows.offset;
        let next_b = rows.step * min(at.y + 1u, count - 1u) + rows.offset;
        let first = rows.first;
        let n = rows.count;
        let left = mat2x3<f32>(rows.w * column_of(first + a, rows.at, n), rows.w * column_of(first + next_a, rows.at, n));
        let right = mat2x3<f32>(column_of(first + b, rows.at, n), column_of(first + next_b, rows.at, n));
        var sums = transpose(left) * right;
        if (n > 3u) {
            let m = n - 3u;
            let left2 = mat2x3<f32>(rows.w2 * column_of(first + a, rows.at2, m), rows.w2 * column_of(first + next_a, rows.at2, m));
            let right2 = mat2x3<f32>(column_of(first + b, rows.at2, m), column_of(first + next_b, rows.at2, m));
            sums += transpose(left2) * right2;
        }
        let from_a = ix_front(size, columns[side + a], 0u);
        let from_next = ix_front(size, columns[side + next_a], 0u);
        let to_b = columns[side + b];
        let to_next = columns[side + next_b];
        // On the diagonal, (a + 1, b) is below the diagonal. Beyond the last column there is nothing to add.
        let two_rows = at.x < at.y;
        let two_columns = at.y + 1u < count;
        add_front(slot, from_a + to_b, sums[0].x);
        if (two_rows) {
            add_front(slot, from_next + to_b, sums[0].y);
        }
        if (two_columns) {
            add_front(slot, from_a + to_next, sums[1].x);
            add_front(slot, from_next + to_next, sums[1].y);
        }
    }
    for (var i = lane; i < count; i += WORKGROUP) {
        let a = rows.step * i + rows.offset;
        var sum = dot(rows.v, column_of(rows.first + a, rows.at, rows.count));
        if (rows.count > 3u) {
            sum += dot(rows.v2, column_of(rows.first + a, rows.at2, rows.count - 3u));
        }
        add_front(slot, ix_front(size, columns[side + a], size), -sum);
    }
}

// Adds one element to the front.
fn assemble(slot: u32, half: u32, element: Element, side: u32, count: u32, size: u32, lane: u32) {
    if (element.family == LINEAR_MOMENTUM) {
        let rows = six_rows(slot, half, element, 0u);
        for (var axis = 0u; axis < 3u; axis++) {
            add_rows(slot, rows_along(rows, axis), side, count / 3u, size, lane);
        }
        return;
    }
    for (var top = 0u; top < element.rows; top += 6u) {
        if (top > 0u) {
            front_barrier();
        }
        add_rows(slot, six_rows(slot, half, element, top), side, count, size, lane);
    }
}

// Initialises the front of a step: zero, plus what remains of the previous front.
fn begin_front(slot: u32, k: u32, size: u32, lane: u32) {
    for (var i = lane; i < ix_front(size, size, size); i += WORKGROUP) {
        put_front(slot, i, 0.0);
    }
    front_barrier();
    if (k == 0u) {
        return;
    }
    let before = front_steps_at(slot, k - 1u);
    let count = before.size - before.pivots;
    let rest = before.rest.start;
    let carry = slot * batch.values + batch.carry;
    for (var e = lane; e < cells(count); e += WORKGROUP) {
        let at = cell(count, e);
        if (at.y < count) {
            put_front(slot, ix_front(size, rests_at(slot, rest + at.x).next, rests_at(slot, rest + at.y).next), values[carry + at.x * count + at.y]);
        }
    }
    for (var a = lane; a < count; a += WORKGROUP) {
        put_front(slot, ix_front(size, rests_at(slot, rest + a).next, size), values[carry + count * count + a]);
    }
    front_barrier();
}

// Saves what remains of a front after its pivots are eliminated.
fn carry_over(slot: u32, size: u32, pivots: u32, lane: u32) {
    let count = size - pivots;
    let carry = slot * batch.values + batch.carry;
    for (var e = lane; e < cells(count); e += WORKGROUP) {
        let at = cell(count, e);
        if (at.y < count) {
            values[carry + at.x * count + at.y] = front_at(slot, ix_front(size, pivots + at.x, pivots + at.y));
        }
    }
    for (var a = lane; a < count; a += WORKGROUP) {
        values[carry + count * count + a] = front_at(slot, ix_front(size, pivots + a, size));
    }
    storageBarrier();
    workgroupBarrier();
}

// Element (p + k, j) of the front; 0 left of the diagonal and for rows `count` and later of the panel.
fn panel_value(slot: u32, size: u32, p: u32, k: u32, j: u32, count: u32) -> f32 {
    // A single return statement: with two of them and 14 calls, SwiftShader compiles for minutes.
    var value = 0.0;
    if (k < count && j >= p + k) {
        value = front_at(slot, ix_front(size, p + k, j));
    }
    return value;
}

// Reciprocal of the pivot's square root; 0 beyond the last row of the panel.
fn reciprocal(pivot: f32, k: u32, count: u32) -> f32 {
    return select(0.0, 1.0 / sqrt(pivot), k < count);
}

// Eliminates up to four pivots, starting at `p`: `A = U' U` row by row; the rest becomes the Schur complement. Returns false if a pivot is
// not positive.
fn eliminate(slot: u32, at: FrontStep, p: u32, lane: u32) -> bool {
    let size = at.size;
    let count = min(4u, at.pivots - p);
    // Every invocation factorises the diagonal block redundantly.
    let d0 = panel_value(slot, size, p, 0u, p, count);
    let r0 = reciprocal(d0, 0u, count);
    let u01 = panel_value(slot, size, p, 0u, p + 1u, count) * r0;
    let u02 = panel_value(slot, size, p, 0u, p + 2u, select(0u, count, count > 2u)) * r0;
    let u03 = panel_value(slot, size, p, 0u, p + 3u, select(0u, count, count > 3u)) * r0;
    let d1 = panel_value(slot, size, p, 1u, p + 1u, count) - u01 * u01;
    let r1 = reciprocal(d1, 1u, count);
    let u12 = (panel_value(slot, size, p, 1u, p + 2u, select(0u, count, count > 2u)) - u01 * u02) * r1;
    let u13 = (panel_value(slot, size, p, 1u, p + 3u, select(0u, count, count > 3u)) - u01 * u03) * r1;
    let d2 = panel_value(slot, size, p, 2u, p + 2u, count) - u02 * u02 - u12 * u12;
    let r2 = reciprocal(d2, 2u, count);
    let u23 = (panel_value(slot, size, p, 2u, p + 3u, select(0u, count, count > 3u)) - u02 * u03 - u12 * u13) * r2;
    let d3 = panel_value(slot, size, p, 3u, p + 3u, count) - u03 * u03 - u13 * u13 - u23 * u23;
    let r3 = reciprocal(d3, 3u, count);
    let positive = d0 > 0.0 && (count < 2u || d1 > 0.0) && (count < 3u || d2 > 0.0) && (count < 4u || d3 > 0.0);
    for (var j = p + lane; j <= size; j += WORKGROUP) {
        let y0 = panel_value(slot, size, p, 0u, j, count) * r0;
        let y1 = select(0.0, (panel_value(slot, size, p, 1u, j, count) - u01 * y0) * r1, j > p);
        let y2 = select(0.0, (panel_value(slot, size, p, 2u, j, count) - u02 * y0 - u12 * y1) * r2, j > p + 1u);
        let y3 = select(0.0, (panel_value(slot, size, p, 3u, j, count) - u03 * y0 - u13 * y1 - u23 * y2) * r3, j > p + 2u);
        let y = vec4<f32>(y0, y1, y2, y3);
        panel[j] = y;
        let row = slot * batch.factor + at.factor + p * at.stride + j;
        for (var k = 0u; k < count; k++) {
            factor[row + k * at.stride] = y[k];
        }
    }
    workgroupBarrier();
    // The remaining rows, with the right-hand side as their last column, in tiles of four by four.
    let first = p + count;
    let tiles = (size - first + 4u) / 4u;
    for (var e = lane; e < cells(tiles); e += WORKGROUP) {
        let at = first + 4u * cell(tiles, e);
        let i = at.x;
        if (i >= size || at.y > size) {
            continue;
        }
        let rows = mat4x4<f32>(panel[i], panel[min(i + 1u, size)], panel[min(i + 2u, size)], panel[min(i + 3u, size)]);
        let starts = vec4<u32>(
            ix_front(size, i, 0u),
            ix_front(size, i + 1u, 0u),
            ix_front(size, i + 2u, 0u),
            ix_front(size, i + 3u, 0u),
        );
        for (var j = at.y; j < min(at.y + 4u, size + 1u); j++) {
            let sums = panel[j] * rows;
            // Number of rows down to the diagonal.
            let depth = min(j + 1u, size) - i;
            add_front(slot, starts.x + j, -sums.x);
            if (depth > 1u) {
                add_front(slot, starts.y + j, -sums.y);
            }
            if (depth > 2u) {
                add_front(slot, starts.z + j, -sums.z);
            }
            if (depth > 3u) {
                add_front(slot, starts.w + j, -sums.w);
            }
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
        begin_front(slot, k, at.size, lane);
        var side = 0u;
        for (var i = at.elements.start; i < at.elements.end; i++) {
            let element = elements_at(slot, i);
            let count = spread(slot, element, side, lane);
            front_barrier();
            assemble(slot, half, element, side, count, at.size, lane);
            side = COLUMNS - side;
        }
        assemble_factored(slot, half, at, lane);
        for (var i = lane; i < at.pivots; i += WORKGROUP) {
            add_front(slot, ix_front(at.size, i, i), values[base + batch.diagonal + at.variable + i]);
            add_front(slot, ix_front(at.size, i, at.size), -values[base + batch.gradient + at.variable + i]);
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
