// needs: shared/factored_place
// Sums over the rows that touch a variable, in row order. The including shader defines the summands: `of_rows` for the rows of an
// element and `of_factored` for those of a factored one, both in one column, and `of_weight`, the factor by
// which an interpolation weight counts.

// Sum over the factored rows at consecutive instants.
fn of_instants(slot: u32, half: u32, touch: FactoredTouch, column: u32) -> f32 {
    var sum = 0.0;
    for (var instant = touch.instants.start; instant < touch.instants.end; instant++) {
        let elements = factored_instants_at(slot, instant).elements;
        var of_elements = 0.0;
        for (var number = elements.start; number < elements.end; number++) {
            if (touch.own == NONE || touch.own == factored_elements_at(slot, number).own) {
                of_elements += of_factored(slot, half, factored_place_at(slot, number), column);
            }
        }
        if (touch.own == NONE) {
            of_elements *= of_weight(factored_instants_weights(slot, instant, touch.block));
        }
        sum += of_elements;
    }
    return sum;
}

// Sum over all rows that touch variable `i`.
fn gathered(slot: u32, half: u32, i: u32) -> f32 {
    let gather = gathers_at(slot, gather_of_at(slot, i));
    let offset = i - gather.variable;
    var sum = 0.0;
    for (var k = gather.touches.start; k < gather.touches.end; k++) {
        let touch = touches_at(slot, k);
        sum += of_rows(slot, half, elements_at(slot, touch.element), touch.column + offset);
    }
    for (var k = gather.factored.start; k < gather.factored.end; k++) {
        let touch = factored_touches_at(slot, k);
        sum += of_instants(slot, half, touch, touch.column + offset);
    }
    return sum;
}
