// Sums over the rows that touch a variable, in their order. The shader says what they add: `of_foot` of the reach rows of a foot at an instant,
// `of_element` of the rows of an element, both in one column, and `of_weight`, by what rows count that touch the base through its pose.

// What reach rows at consecutive instants add.
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

// What all rows add that touch variable `i`.
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
