// State that both substitutions keep for the front of one step: the remaining right-hand side, and the values of the variables that are
// already known.

var<workgroup> local: array<f32, SIDE>;

// Remaining right-hand side of pivot `i`; 0 beyond the last pivot.
fn left(at: FrontStep, i: u32) -> f32 {
    if (i >= at.pivots) {
        return 0.0;
    }
    return local[i];
}
