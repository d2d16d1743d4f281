// needs: shared/values shared/jacobian shared/entries
// binds: jacobian periodics
// Difference of a variable between the end and the start of a periodic stride. One thread per component of a block.
//   in   values    x of the trial point
//   out  values    c at each row's place; satisfied when zero
//   out  jacobian  one row at each place
// Twin: src/rows/periodic.rs

// Periodic row of one component.
fn entry(slot: u32, half: u32, k: u32) {
    let periodic = &periodics[slot * batch.periodics + k];
    let unit = slots[slot].constants.length_scale;
    let x = ix_x(slot, half);
    let start = values[x + periodic.variable[0]];
    let end = values[x + periodic.variable[1]];
    values[ix_equality(slot, half, periodic.place.row)] = (end - start - periodic.difference) * unit;

    let rows = rows_at(slot, half, periodic.place);
    for (var i = 0u; i < 2u; i++) {
        if (periodic.column[i] != NONE) {
            put(rows, 0u, periodic.column[i], select(unit, -unit, i == 0u));
        }
    }
}
