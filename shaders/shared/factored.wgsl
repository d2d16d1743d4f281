// Places of factored rows, whose Jacobian with respect to the base is a factor by the pose times interpolation weights.
// Twin: `FactoredRows::place` of src/rows/factored.rs

// Place of the rows of a factored element. Their Jacobian begins at `jacobian_at`.
fn factored_place(slot: u32, number: u32, jacobian_at: u32, stride: u32) -> Place {
    let first = slots[slot].first_factored;
    let inequality = first.inequality + (FACTORED_ROWS + FACTORED_PAIRS) * number;
    return Place(first.row + FACTORED_ROWS * number, inequality, jacobian_at, stride);
}
