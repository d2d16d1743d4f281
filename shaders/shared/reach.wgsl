// Places of the reach rows. Twin: `Tables::reach_place` of src/rows/reach.rs

// Place of the rows of a foot at an instant. Their Jacobian begins at `jacobian_at`.
fn reach_place(slot: u32, number: u32, jacobian_at: u32, stride: u32) -> Place {
    let first = slots[slot].reach_rows;
    return Place(first.row + 3u * number, first.inequality + 6u * number, jacobian_at, stride);
}

// Rows of a foot at an instant as an element, without its columns.
fn reach_element(slot: u32, number: u32) -> Element {
    return Element(REACH, 3u, 3u, reach_place(slot, number, 0u, 0u), Span(0u, 0u));
}
