// needs: shared/values shared/jacobian shared/math shared/terrain shared/contact shared/entries
// binds: jacobian footholds cone_curvatures heights
// Curvature of the friction cones as rows that are no part of the cost. One thread per cone.
//   in   values    x of the trial point
//   out  values    c at each row's place: zeros
//   out  jacobian  two rows at each place
// Twin: src/rows/cone_curvature.rs

// Curvature rows of one cone.
fn entry(slot: u32, half: u32, i: u32) {
    let node = &cone_curvatures[slot * batch.cone_curvatures + i];
    let margin = slots[slot].constants.force_margin;
    let x = ix_x(slot, half);
    let at = ix_equality(slot, half, node.place.row);
    values[at] = 0.0;
    values[at + 1u] = 0.0;

    let force = three(x + node.node) + node.slope_weight * three(x + node.node + 3u);
    let under = x + footholds[slot * batch.footholds + node.foothold];
    var directions = basis(rounded_ground(slots[slot].shape, values[under], values[under + 1u], 0.0));
    let n = directions[0].unit;
    let tangential = force - dot(n, force) * n;
    let squared = dot(tangential, tangential);
    let size = sqrt(squared + margin * margin);
    // Any direction does if there is no tangential force.
    var along = directions[1].unit;
    if (squared > 0.0) {
        along = (1.0 / sqrt(squared)) * tangential;
    }
    let root = 1.0 / sqrt(size);
    let rows = rows_at(slot, half, node.place);
    put_by_force(rows, 0u, node.node_column, node.slope_weight, root * cross(n, along));
    put_by_force(rows, 1u, node.node_column, node.slope_weight, (root * margin / size) * along);
}
