// What both substitutions keep of the front of one step: what is left of the right-hand side, and for variables that are known their values.

var<workgroup> local: array<f32, SIDE>;

// What is left for pivot `i`, 0 beyond the last.
fn left(at: FrontStep, i: u32) -> f32 {
    if (i >= at.pivots) {
        return 0.0;
    }
    return local[i];
}
