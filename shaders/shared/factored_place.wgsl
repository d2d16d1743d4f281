// needs: shared/factored
// Places of factored rows with their Jacobian, from `factored_elements`.

// Place of the rows of a factored element.
fn factored_place_at(slot: u32, number: u32) -> Place {
    let element = factored_elements_at(slot, number);
    return factored_place(slot, number, element.jacobian, element.stride);
}
