// needs: shared/values shared/jacobian shared/entries
// binds: jacobian goals
// Distance of a pose or of rates at a knot from those of the goal, as cost rows. One thread per pose or rates.
//   in   values    x of the trial point
//   out  values    c at each row's place
//   out  jacobian  six rows at each place
// Twin: src/rows/goal.rs

// Goal rows of one block.
fn entry(slot: u32, half: u32, k: u32) {
    let goal = &goals[slot * batch.goals + k];
    let x = ix_x(slot, half) + goal.variable;
    let at = ix_equality(slot, half, goal.place.row);
    let rows = rows_at(slot, half, goal.place);
    for (var d = 0u; d < 6u; d++) {
        values[at + d] = goal.weight[d] * (values[x + d] - goal.desired[d]);
        if (goal.column != NONE) {
            put(rows, d, goal.column + d, goal.weight[d]);
        }
    }
}
