// State that both substitutions keep for the front of one step: some pivot rows, the remaining right-hand side, and the values of the
// variables that are already known.

// Invocations that work on one of these rows.
const TEAM: u32 = max(WORKGROUP / PANEL_ROWS, 1u);
const TEAMS: u32 = WORKGROUP / TEAM;

var<workgroup> staged: array<f32, PANEL_ROWS * SIDE>;
var<workgroup> local: array<f32, SIDE>;

// Copies the pivot rows from `first` on, from the diagonal to the last variable, to workgroup memory. Rows beyond the last pivot are those
// of the identity matrix.
fn stage(slot: u32, at: FrontStep, first: u32, lane: u32) {
    let rows = slot * batch.factor + at.factor;
    // Solutions take four pivots together, also the last ones.
    for (var j = first + lane; j < (at.size + 3u) / 4u * 4u; j += WORKGROUP) {
        for (var r = 0u; r < PANEL_ROWS; r++) {
            let i = first + r;
            let v = factor[rows + min(i, at.pivots - 1u) * at.stride + min(j, at.size - 1u)];
            staged[r * SIDE + j] = select(v, select(0.0, 1.0, i == j), i >= at.pivots);
        }
    }
    workgroupBarrier();
}

// Remaining right-hand side of pivot `i`; 0 beyond the last pivot.
fn left(at: FrontStep, i: u32) -> f32 {
    return select(0.0, local[i], i < at.pivots);
}
