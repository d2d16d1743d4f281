// needs: shared/values shared/jacobian shared/math shared/terrain shared/contact shared/entries
// binds: jacobian footholds force_nodes heights
// Force limit and friction pyramid of the ground under the foothold, at force nodes or at the Bezier points next to them. One thread per
// row group of a node.
//   in   values    x of the trial point
//   out  values    g at each node's place: normal limit, 4 friction rows, push; dimensionless, feasible when <= 0
//   out  jacobian  5 rows at each node's place
// Twin: src/rows/force.rs          Source: [3]

// Force rows of one node.
fn entry(slot: u32, half: u32, i: u32) {
    let node = &force_nodes[slot * batch.force_nodes + i];
    let constants = &slots[slot].constants;
    let x = ix_x(slot, half);
    let force = three(x + node.node) + node.slope_weight * three(x + node.node + 3u);
    let under = x + footholds[slot * batch.footholds + node.foothold];
    let directions = basis(rounded_ground(slots[slot].shape, values[under], values[under + 1u], progress[slot].edge_radius));
    let n = directions[0];
    let t1 = directions[1];
    let t2 = directions[2];
    let minus_mu_n = -constants.friction * n.unit;
    var normals = array<vec3<f32>, FORCE_ROWS>(
        n.unit,
        t1.unit + minus_mu_n,
        minus_mu_n - t1.unit,
        t2.unit + minus_mu_n,
        minus_mu_n - t2.unit,
    );
    let at = ix_inequality(slot, half, node.place.inequality);
    for (var r = 0u; r < FORCE_ROWS; r++) {
        let bound = select(0.0, constants.force_limit, r == 0u);
        values[at + r] = dot(normals[r], force) - bound + constants.force_margin;
    }
    values[at + FORCE_ROWS] = -dot(n.unit, force) + constants.force_margin;

    let rows = rows_at(slot, half, node.place);
    for (var r = 0u; r < FORCE_ROWS; r++) {
        put_by_force(rows, r, node.node_column, node.slope_weight, normals[r]);
    }
    if (node.foothold_column == NONE) {
        return;
    }
    for (var d = 0u; d < 2u; d++) {
        let c = node.foothold_column + d;
        let by_n = dot(n.by[d], force);
        let by_t1 = dot(t1.by[d], force);
        let by_t2 = dot(t2.by[d], force);
        put(rows, 0u, c, by_n);
        put(rows, 1u, c, by_t1 - constants.friction * by_n);
        put(rows, 2u, c, -by_t1 - constants.friction * by_n);
        put(rows, 3u, c, by_t2 - constants.friction * by_n);
        put(rows, 4u, c, -by_t2 - constants.friction * by_n);
    }
}
