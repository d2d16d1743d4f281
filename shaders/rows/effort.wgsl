// needs: shared/values shared/jacobian shared/entries
// binds: jacobian efforts
// Effort of the forces as cost rows. One thread per force node.
//   in   values    x of the trial point
//   out  values    c at each row's place: both rows of x, of y, of z
//   out  jacobian  six rows at each place
// Twin: src/rows/effort.rs

// Effort rows of one force node.
fn entry(slot: u32, half: u32, k: u32) {
    let effort = &efforts[slot * batch.efforts + k];
    let x = ix_x(slot, half);
    let at = ix_equality(slot, half, effort.place.row);
    for (var d = 0u; d < 3u; d++) {
        for (var r = 0u; r < 2u; r++) {
            var sum = 0.0;
            for (var i = 0u; i < 2u; i++) {
                if (effort.node[i] != NONE) {
                    let node = x + effort.node[i] + d;
                    sum += effort.factor[r][2u * i] * values[node] + effort.factor[r][2u * i + 1u] * values[node + 3u];
                }
            }
            values[at + 2u * d + r] = sum;
        }
    }

    let rows = rows_at(slot, half, effort.place);
    for (var i = 0u; i < 2u; i++) {
        if (effort.column[i] == NONE) {
            continue;
        }
        for (var d = 0u; d < 3u; d++) {
            for (var r = 0u; r < 2u; r++) {
                put(rows, 2u * d + r, effort.column[i] + d, effort.factor[r][2u * i]);
                put(rows, 2u * d + r, effort.column[i] + 3u + d, effort.factor[r][2u * i + 1u]);
            }
        }
    }
}
