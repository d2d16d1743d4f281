// needs: shared/factored
// All elements, in the order of `Problem::all_elements` of src/nlp/problem.rs: those of the table `elements`, then the factored ones.

// Number of all elements of a candidate.
fn all_elements(slot: u32) -> u32 {
    return slots[slot].elements + slots[slot].factored_elements;
}

// An element. That of factored rows has neither columns nor the place of its Jacobian.
fn any_element(slot: u32, i: u32) -> Element {
    let others = slots[slot].elements;
    var element = Element(FACTORED, FACTORED_ROWS, FACTORED_PAIRS, Place(), Span());
    if (i < others) {
        element = elements[slot * batch.elements + i];
    } else {
        element.place = factored_place(slot, i - others, 0u, 0u);
    }
    return element;
}
