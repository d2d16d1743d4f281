//! Contact forces inside the exact friction cone of the ground under the foothold, with an upper limit on the normal force, at force nodes
//! or at the Bezier points next to them.
//!
//! With unit normal `n` of the ground and `t = f - (n.f) n`: `n.f <= f_max`, `sqrt(|t|^2 + m^2) - mu n.f <= 0`, `-n.f <= 0`, each tightened
//! by the margin `m`, which also rounds the tip of the cone. Forces are in the force unit. These rows replace those of [`super::force`],
//! whose pyramid circumscribes the cone.

use super::blocks::Placed;
use super::force::ForceNode;
use super::math::{add, dot, scale, sub};
use super::table::NONE;
use super::write::Rows;
use super::{RowKind, Spec, Tables};
use crate::real::Real;
use multiversion::multiversion;

/// Upper limit of the normal force, then the cone. Unilateral contact (`-n.f <= 0`) is the lower side of the first row.
pub const SPEC: Spec = Spec { rows: 2, pairs: 1, kind: RowKind::Inequality, unit: "N" };

/// See [`super::Family::allowed`].
pub(super) use super::force_allowed as allowed;

/// Force to which the cone rows apply.
pub type Cone<T> = ForceNode<T>;

/// Writes positions and columns into an entry. Roles: force node, foothold.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    tables.cones[entry].sit(at);
}

/// Cone rows of all nodes.
///
/// * `edge_radius` - radius with which terrain edges are rounded, m; 0 for the exact rows
/// * `residual` - out, at each node's place: normal limit, cone, unilateral contact
/// * `jacobian` - out, 2 rows at each node's place
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn cone<T: Real>(tables: &Tables<T>, x: &[T], edge_radius: T, residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    let constants = &tables.constants;
    let (friction, margin) = (constants.friction, constants.force_margin);
    for node in &tables.cones {
        let force = node.force(x);
        let [n, ..] = node.directions(tables, x, edge_radius);
        let normal = dot(n.unit, force);
        let tangential = sub(force, scale(normal, n.unit));
        let size = (dot(tangential, tangential) + margin * margin).sqrt();
        let at = node.place.inequality as usize;
        residual[at] = normal - constants.force_limit + margin;
        residual[at + 1] = size - friction * normal + margin;
        residual[at + 2] = -normal + margin;
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &node.place);
        node.put_by_force(&mut rows, &[n.unit, add(scale(T::one() / size, tangential), scale(-friction, n.unit))]);
        if node.foothold_column == NONE {
            continue;
        }
        let c = node.foothold_column as usize;
        for d in 0..2 {
            let by_n = dot(n.by[d], force);
            rows.put(0, c + d, by_n);
            // d|t|^2 / 2 = -(n.f) t.dn = -(n.f) (dn.f), because t is orthogonal to n, and n to dn.
            rows.put(1, c + d, -(normal / size + friction) * by_n);
        }
    }
}
