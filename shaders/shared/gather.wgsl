// Sums over the rows that touch a variable, in row order. The including shader defines the summands: `of_foot` for the reach rows of a foot
// at an instant and `of_element` for the rows of an element, both in one column, and `of_weight`, the factor of the rows that touch the
// base through its pose.

// Sum over the reach rows at consecutive instants.
fn of_reach(slot: u32, half: u32, touch: ReachTouch, column: u32) -> f32 {
    var sum = 0.0;
    for (var instant = touch.instants.start; instant < touch.instants.end; instant++) {
        let feet = reach_instants_at(slot, instant).feet;
        var of_feet = 0.0;
        for (var f = feet.start; f < feet.end; f++) {
            if (touch.leg == NONE || touch.leg == reach_feet_at(slot, f).leg) {
                of_feet += of_foot(slot, half, f, column);
            }
        }
        if (touch.leg == NONE) {
            of_feet *= of_weight(reach_instants_base_weights(slot, instant, touch.block));
        }
        sum += of_feet;
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
        sum += of_element(slot, half, elements_at(slot, touch.element), touch.column + offset);
    }
    for (var k = gather.reach.start; k < gather.reach.end; k++) {
        let touch = reach_touches_at(slot, k);
        sum += of_reach(slot, half, touch, touch.column + offset);
    }
    return sum;
}
