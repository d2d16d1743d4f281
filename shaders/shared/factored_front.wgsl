// needs: shared/factored_place
// Factored rows in the front. Twin: `FactoredRows::assemble` of src/linear/factored.rs

// Number of products of two columns of the base pose, and of the values of `by_pose`.
const POSE_PRODUCTS: u32 = POSE * POSE;
const POSE_SUMS: u32 = POSE_PRODUCTS + POSE;
// Number of columns of the base blocks, and of the columns by which the own columns of an element are multiplied, values included.
const BASE_COLUMNS: u32 = POSE_BLOCKS * POSE;
const OTHER_COLUMNS: u32 = BASE_COLUMNS + OWN_COLUMNS + 1u;
// Number of pairs of base blocks.
const BLOCK_PAIRS: u32 = POSE_BLOCKS * (POSE_BLOCKS + 1u) / 2u;

// Sums over the elements at one instant: `P' W P` and `P' v`, with the factors `P`, the derivatives of the rows by the pose.
var<workgroup> by_pose: array<f32, POSE_SUMS>;

// One of the values of `by_pose`: `P' W P` row by row, then `P' v`.
fn pose_sum(slot: u32, half: u32, elements: Span, e: u32) -> f32 {
    let base = slot * batch.values;
    var sum = 0.0;
    for (var number = elements.start; number < elements.end; number++) {
        let place = factored_place_at(slot, number);
        let pose = (2u * slot + half) * batch.jacobian + place.jacobian;
        for (var r = 0u; r < FACTORED_ROWS; r++) {
            if (e < POSE_PRODUCTS) {
                let left = values[base + batch.weight + place.row + r] * jacobian[pose + r * place.stride + e / POSE];
                sum += left * jacobian[pose + r * place.stride + e % POSE];
            } else {
                sum += values[base + batch.value + place.row + r] * jacobian[pose + r * place.stride + e - POSE_PRODUCTS];
            }
        }
    }
    return sum;
}

// Front index and Jacobian column of own column `f` of an element. NONE if it does not exist or its variable is fixed.
fn own_column(slot: u32, own: u32, f: u32) -> vec2<u32> {
    let run = factored_own_runs(slot, own, f / 2u);
    if (f % 2u >= run.len) {
        return vec2<u32>(NONE, NONE);
    }
    return vec2<u32>(run.front, run.column) + f % 2u;
}

// Adds the products of an element's own columns with column `other`: one of the base blocks, an own column or the values.
fn add_own(slot: u32, half: u32, instant: u32, blocks: u32, number: u32, size: u32, other: u32) {
    let all = factored_elements_at(slot, number).own;
    let place = factored_place_at(slot, number);
    let first = (2u * slot + half) * batch.jacobian + place.jacobian;
    let rows = place.stride * vec3<u32>(0u, 1u, 2u);
    let row = slot * batch.values + place.row;
    var right = vec3<f32>(values[row + batch.weight], values[row + batch.weight + 1u], values[row + batch.weight + 2u]);
    var at = size;
    if (other < BASE_COLUMNS) {
        let block = other / POSE;
        at = base_blocks_front(slot, blocks, block);
        if (at == NONE) {
            return;
        }
        at += other % POSE;
        right *= column_of(first + other % POSE, rows, FACTORED_ROWS);
        right *= factored_instants_weights(slot, instant, block);
    } else if (other < BASE_COLUMNS + OWN_COLUMNS) {
        let second = own_column(slot, all, other - BASE_COLUMNS);
        if (second.x == NONE) {
            return;
        }
        at = second.x;
        right *= column_of(first + second.y, rows, FACTORED_ROWS);
    } else {
        right = -vec3<f32>(values[row + batch.value], values[row + batch.value + 1u], values[row + batch.value + 2u]);
    }
    for (var f = 0u; f < OWN_COLUMNS; f++) {
        let own = own_column(slot, all, f);
        // For two own columns, only the upper triangle.
        if (own.x != NONE && (other < BASE_COLUMNS || own.x <= at)) {
            add_front(slot, ix_front(size, min(own.x, at), max(own.x, at)), dot(column_of(first + own.y, rows, FACTORED_ROWS), right));
        }
    }
}

// One of the pairs of base blocks.
fn block_pair(pair: u32) -> vec2<u32> {
    let i = select(select(select(0u, 1u, pair > 3u), 2u, pair > 6u), 3u, pair > 8u);
    let before = i * POSE_BLOCKS - (i * (i - min(i, 1u))) / 2u;
    return vec2<u32>(i, i + pair - before);
}

// Adds one of the products of the columns of the base blocks at an instant: POSE_PRODUCTS per pair of blocks.
fn add_pose(slot: u32, instant: u32, blocks: u32, size: u32, e: u32) {
    let pair = block_pair(e / POSE_PRODUCTS);
    let rows = base_blocks_front(slot, blocks, pair.x);
    let columns = base_blocks_front(slot, blocks, pair.y);
    let c = (e % POSE_PRODUCTS) / POSE;
    let d = e % POSE;
    // Upper triangle of a diagonal block; otherwise the block above the diagonal, whichever of the two blocks comes first. The sums are
    // symmetric.
    if (rows != NONE && columns != NONE && (pair.x != pair.y || c <= d)) {
        let weight = factored_instants_weights(slot, instant, pair.x) * factored_instants_weights(slot, instant, pair.y);
        add_front(slot, ix_front(size, min(rows, columns) + c, max(rows, columns) + d), weight * by_pose[e % POSE_PRODUCTS]);
    }
}

// Adds `J' W J` and `-J' v` of the factored rows of all instants of a step, which share their base blocks.
//
// With the weights `w` of an instant, the factors `P` and an element's own columns `A`, the block of base blocks `i` and `j` is
// `w_i w_j sum P' W P`, and that of base block `i` and own columns `w_i P' W A`.
fn assemble_factored(slot: u32, half: u32, at: FrontStep, lane: u32) {
    for (var instant = at.factored.start; instant < at.factored.end; instant++) {
        let elements = factored_instants_at(slot, instant).elements;
        let blocks = factored_instants_at(slot, instant).blocks;
        front_barrier();
        for (var e = lane; e < POSE_SUMS; e += WORKGROUP) {
            by_pose[e] = pose_sum(slot, half, elements, e);
        }
        workgroupBarrier();
        for (var e = lane; e < BLOCK_PAIRS * POSE_PRODUCTS; e += WORKGROUP) {
            add_pose(slot, instant, blocks, at.size, e);
        }
        for (var e = lane; e < BASE_COLUMNS; e += WORKGROUP) {
            let block = base_blocks_front(slot, blocks, e / POSE);
            if (block != NONE) {
                let sum = factored_instants_weights(slot, instant, e / POSE) * by_pose[POSE_PRODUCTS + e % POSE];
                add_front(slot, ix_front(at.size, block + e % POSE, at.size), -sum);
            }
        }
        for (var e = lane; e < OTHER_COLUMNS * (elements.end - elements.start); e += WORKGROUP) {
            add_own(slot, half, instant, blocks, elements.start + e / OTHER_COLUMNS, at.size, e % OTHER_COLUMNS);
        }
    }
    front_barrier();
}
