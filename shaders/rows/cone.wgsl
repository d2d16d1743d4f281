// needs: shared/values shared/jacobian shared/math shared/terrain shared/contact shared/entries
// binds: jacobian footholds cones heights
// Force limit and exact friction cone of the ground under the foothold, at force nodes or at the Bezier points next to them. One thread per
// row group of a node.
//   in   values    x of the trial point
//   out  values    g at each node's place: normal limit, cone, push; dimensionless, feasible when <= 0
//   out  jacobian  2 rows at each node's place
// Twin: src/rows/cone.rs

// Cone rows of one node.
fn entry(slot: u32, half: u32, i: u32) {
    let node = &cones[slot * batch.cones + i];
    let constants = &slots[slot].constants;
    let friction = constants.friction;
    let margin = constants.force_margin;
    let x = ix_x(slot, half);
    let force = three(x + node.node) + node.slope_weight * three(x + node.node + 3u);
    let under = x + footholds[slot * batch.footholds + node.foothold];
    var directions = basis(rounded_ground(slots[slot].shape, values[under], values[under + 1u], progress[slot].edge_radius));
    let n = directions[0];
    let normal = dot(n.unit, force);
    let tangential = force - normal * n.unit;
    let size = sqrt(dot(tangential, tangential) + margin * margin);
    let at = ix_inequality(slot, half, node.place.inequality);
    values[at] = normal - constants.force_limit + margin;
    values[at + 1u] = size - friction * normal + margin;
    values[at + 2u] = -normal + margin;

    let rows = rows_at(slot, half, node.place);
    let by_force = (1.0 / size) * tangential + -friction * n.unit;
    put_by_force(rows, 0u, node.node_column, node.slope_weight, n.unit);
    put_by_force(rows, 1u, node.node_column, node.slope_weight, by_force);
    if (node.foothold_column == NONE) {
        return;
    }
    for (var d = 0u; d < 2u; d++) {
        let by_n = dot(n.by[d], force);
        put(rows, 0u, node.foothold_column + d, by_n);
        // d|t|^2 / 2 = -(n.f) (dn.f), because t is orthogonal to n, and n to dn.
        put(rows, 1u, node.foothold_column + d, -(normal / size + friction) * by_n);
    }
}
