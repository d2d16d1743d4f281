// Where reach rows stand. Twin: `Tables::reach_place` of src/rows/reach.rs

// The place of the rows of a foot at an instant, whose Jacobian stands where its entry says.
fn reach_place(slot: u32, number: u32, jacobian_at: u32, stride: u32) -> Place {
    let first = slots[slot].reach_rows;
    return Place(first.row + 3u * number, first.inequality + 6u * number, jacobian_at, stride);
}

// Those rows as an element, without their columns.
fn reach_element(slot: u32, number: u32) -> Element {
    return Element(REACH, 3u, 3u, reach_place(slot, number, 0u, 0u), Span(0u, 0u));
}
