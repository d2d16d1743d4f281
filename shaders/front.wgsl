// The frontal Cholesky factorisation in time order: assemble, eliminate, slide on. One workgroup a candidate, steps `sweep.first` to
// `sweep.last` of its sweep.
//   in      values    weight, value [rows]; diagonal, gradient [variables]
//   in      jacobian  at the point
//   in out  values    carry: what stays of the front between two steps, `[rest][rest]` and its right-hand side
//   out     factor    pivot rows, [pivots][stride] at each step; the right-hand side stands in column `size`
//   out     values    flags: 1 when a pivot is not positive
// Solves `(E + J' W J) d = -(u + J' v)` together with substitute.wgsl.
// Twin: src/kernels/front.rs. Its sums have another order: rows of reach are added by pose there, pivots are eliminated one by one.

struct Sweep {
    first: u32,
    last: u32,
}

@group(0) @binding(0) var<uniform> batch: Batch;
@group(0) @binding(1) var<storage, read> running: array<u32>;
@group(0) @binding(2) var<storage, read> slots: array<Slot>;
@group(0) @binding(3) var<storage, read> progress: array<Progress>;
@group(0) @binding(4) var<storage, read_write> values: array<f32>;
@group(0) @binding(5) var<storage, read> jacobian: array<f32>;
@group(0) @binding(6) var<storage, read_write> factor: array<f32>;
@group(0) @binding(7) var<storage, read> elements: array<Element>;
@group(0) @binding(8) var<storage, read> runs: array<Run>;
@group(0) @binding(9) var<storage, read> front_steps: array<FrontStep>;
@group(0) @binding(10) var<storage, read> rests: array<Rest>;
@group(0) @binding(11) var<uniform> sweep: Sweep;

// Slots of the columns of an element, those of the next one beside them.
var<workgroup> columns: array<u32, 2 * COLUMNS>;
// Four rows of the factor, column by column.
var<workgroup> panel: array<vec4<f32>, SIDE>;

// Puts the columns of an element in their place. Returns how many they are: none where all that it touches is fixed.
fn spread(slot: u32, element: Element, side: u32, lane: u32) -> u32 {
    if (element.runs.start == element.runs.end) {
        return 0u;
    }
    let last = runs[slot * batch.runs + element.runs.end - 1u];
    for (var k = element.runs.start + lane; k < element.runs.end; k += WORKGROUP) {
        let run = runs[slot * batch.runs + k];
        for (var i = 0u; i < run.len; i++) {
            columns[side + run.column + i] = run.slot + i;
        }
    }
    return last.column + last.len;
}

// Three values of a Jacobian column; rows beyond the last repeat it, their weights are 0.
fn column_of(first: u32, stride: u32, rows: u32, r: u32, column: u32) -> vec3<f32> {
    let last = rows - 1u;
    return vec3<f32>(
        jacobian[first + min(r, last) * stride + column],
        jacobian[first + min(r + 1u, last) * stride + column],
        jacobian[first + min(r + 2u, last) * stride + column],
    );
}

// Three of the weights or values of an element's rows; 0 beyond the last.
fn of_rows(at: u32, rows: u32, r: u32) -> vec3<f32> {
    return vec3<f32>(
        select(0.0, values[at + min(r, rows - 1u)], r < rows),
        select(0.0, values[at + min(r + 1u, rows - 1u)], r + 1u < rows),
        select(0.0, values[at + min(r + 2u, rows - 1u)], r + 2u < rows),
    );
}

// Adds `J' W J` and `-J' v` of one element to the front.
fn assemble(slot: u32, half: u32, element: Element, side: u32, count: u32, size: u32, lane: u32) {
    let base = slot * batch.values;
    let rows = element.rows;
    let stride = element.place.stride;
    let first = (2u * slot + half) * batch.jacobian + element.place.jacobian;
    let w = of_rows(base + batch.weight + element.place.row, rows, 0u);
    let v = of_rows(base + batch.value + element.place.row, rows, 0u);
    let w2 = of_rows(base + batch.weight + element.place.row, rows, 3u);
    let v2 = of_rows(base + batch.value + element.place.row, rows, 3u);
    if (all(w == vec3<f32>()) && all(w2 == vec3<f32>())) {
        return;
    }
    for (var e = lane; e < cells(count); e += WORKGROUP) {
        let at = cell(count, e);
        if (at.y >= count) {
            continue;
        }
        var sum = dot(w * column_of(first, stride, rows, 0u, at.x), column_of(first, stride, rows, 0u, at.y));
        if (rows > 3u) {
            sum += dot(w2 * column_of(first, stride, rows, 3u, at.x), column_of(first, stride, rows, 3u, at.y));
        }
        let i = ix_front(size, columns[side + at.x], columns[side + at.y]);
        put_front(slot, i, front_at(slot, i) + sum);
    }
    for (var a = lane; a < count; a += WORKGROUP) {
        var sum = dot(v, column_of(first, stride, rows, 0u, a));
        if (rows > 3u) {
            sum += dot(v2, column_of(first, stride, rows, 3u, a));
        }
        let i = ix_front(size, columns[side + a], size);
        put_front(slot, i, front_at(slot, i) - sum);
    }
}

// The front of a step before its rows: zero, and what stays of the previous one.
fn begin_front(slot: u32, k: u32, size: u32, lane: u32) {
    for (var i = lane; i < ix_front(size, size, size); i += WORKGROUP) {
        put_front(slot, i, 0.0);
    }
    front_barrier();
    if (k == 0u) {
        return;
    }
    let before = front_steps[slot * batch.steps + k - 1u];
    let count = before.size - before.pivots;
    let rest = slot * batch.rests + before.rest.start;
    let carry = slot * batch.values + batch.carry;
    for (var e = lane; e < cells(count); e += WORKGROUP) {
        let at = cell(count, e);
        if (at.y < count) {
            put_front(slot, ix_front(size, rests[rest + at.x].slot, rests[rest + at.y].slot), values[carry + at.x * count + at.y]);
        }
    }
    for (var a = lane; a < count; a += WORKGROUP) {
        put_front(slot, ix_front(size, rests[rest + a].slot, size), values[carry + count * count + a]);
    }
    front_barrier();
}

// Keeps what stays of a front after its pivots.
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

// Value of the front in row `p + k`, column `j`, 0 left of the diagonal and from row `count` of the panel on.
fn panel_value(slot: u32, size: u32, p: u32, k: u32, j: u32, count: u32) -> f32 {
    if (k >= count || j < p + k) {
        return 0.0;
    }
    return front_at(slot, ix_front(size, p + k, j));
}

// Reciprocal pivot, 0 beyond the last row of the panel.
fn reciprocal(pivot: f32, k: u32, count: u32) -> f32 {
    return select(0.0, 1.0 / sqrt(pivot), k < count);
}

// Eliminates up to four pivots from `p` on: `A = U' U` row by row, the rest becomes the Schur complement. Returns false when a pivot is not
// positive.
fn eliminate(slot: u32, at: FrontStep, p: u32, lane: u32) -> bool {
    let size = at.size;
    let count = min(4u, at.pivots - p);
    // Every invocation factorises the block on the diagonal for itself.
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
    // The rest, with the right-hand side as its last column.
    let first = p + count;
    let rest = size - first + 1u;
    for (var e = lane; e < cells(rest); e += WORKGROUP) {
        let ab = cell(rest, e) + first;
        if (ab.x < size && ab.y <= size) {
            let i = ix_front(size, ab.x, ab.y);
            put_front(slot, i, front_at(slot, i) - dot(panel[ab.x], panel[ab.y]));
        }
    }
    front_barrier();
    return positive;
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let slot = running[group.x];
    if (progress[slot].state > CLOSE) {
        return;
    }
    let half = progress[slot].current;
    let base = slot * batch.values;
    var positive = true;
    for (var k = sweep.first; k < min(sweep.last, slots[slot].steps); k++) {
        let at = front_steps[slot * batch.steps + k];
        begin_front(slot, k, at.size, lane);
        var side = 0u;
        for (var i = at.elements.start; i < at.elements.end; i++) {
            let element = elements[slot * batch.elements + i];
            let count = spread(slot, element, side, lane);
            front_barrier();
            assemble(slot, half, element, side, count, at.size, lane);
            side = COLUMNS - side;
        }
        front_barrier();
        for (var i = lane; i < at.pivots; i += WORKGROUP) {
            let d = ix_front(at.size, i, i);
            put_front(slot, d, front_at(slot, d) + values[base + batch.diagonal + at.variable + i]);
            let u = ix_front(at.size, i, at.size);
            put_front(slot, u, front_at(slot, u) - values[base + batch.gradient + at.variable + i]);
        }
        front_barrier();
        for (var p = 0u; p < at.pivots; p += 4u) {
            positive = eliminate(slot, at, p, lane) && positive;
        }
        carry_over(slot, at.size, at.pivots, lane);
    }
    if (lane == 0u) {
        let failed = sweep.first > 0u && values[base + batch.flags] != 0.0;
        values[base + batch.flags] = select(1.0, 0.0, positive && !failed);
    }
}
