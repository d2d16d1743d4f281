// Where reach rows stand. Twin: `ReachRows` of src/rows/reach.rs

// The place of the rows of a foot at an instant.
fn reach_place(slot: u32, number: u32, foot: ReachFoot) -> Place {
    let first = slots[slot].reach_rows;
    return Place(first.row + 3u * number, first.inequality + 6u * number, foot.jacobian, foot.stride);
}

// Those rows as an element, without their columns.
fn reach_element(slot: u32, number: u32) -> Element {
    let first = slots[slot].reach_rows;
    return Element(REACH, 3u, 3u, Place(first.row + 3u * number, first.inequality + 6u * number, 0u, 0u), Span(0u, 0u));
}
