//! Curvature of the friction cones, for the minimisation of a cost.
//!
//! The residual of a cone row, `size - mu n.f` with `size = sqrt(|t|^2 + m^2)`, is convex in the force. Its second derivative is
//! `(u u' + (m / size)^2 e e') / size` with the unit vector `e` along the tangential force and `u` across it. A Gauss-Newton step leaves it
//! out and moves forces of small size far around their cones. These rows have its root as their Jacobian, a residual of zero, and the
//! multiplier of the cone as their weight.

use super::blocks::Placed;
use super::force::ForceNode;
use super::math::{cross, dot, scale, sub};
use super::write::Rows;
use super::{RowKind, Spec, Tables};
use crate::real::Real;
use multiversion::multiversion;

/// Across the tangential force, then along it.
pub const SPEC: Spec = Spec { rows: 2, pairs: 0, kind: RowKind::Cost, unit: "" };

/// See [`super::Family::allowed`].
pub(super) use super::any_residual as allowed;

/// Force of the cone of the same index in [`Tables::cones`].
pub type ConeCurvature<T> = ForceNode<T>;

/// Writes positions and columns into an entry. Roles: force node, foothold.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    tables.cone_curvatures[entry].sit(at);
}

/// Curvature rows of all cones. The footholds have no part in it.
///
/// * `residual` - out, by row: zeros
/// * `jacobian` - out, two rows at each place
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn cone_curvature<T: Real>(tables: &Tables<T>, x: &[T], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    let margin = tables.constants.force_margin;
    for node in &tables.cone_curvatures {
        let at = node.place.row as usize;
        residual[at..at + SPEC.rows].fill(T::zero());
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let force = node.force(x);
        let [n, tangent, _] = node.directions(tables, x, T::zero());
        let tangential = sub(force, scale(dot(n.unit, force), n.unit));
        let squared = dot(tangential, tangential);
        let size = (squared + margin * margin).sqrt();
        // Any direction does if there is no tangential force.
        let along = if squared > T::zero() { scale(T::one() / squared.sqrt(), tangential) } else { tangent.unit };
        let root = T::one() / size.sqrt();
        let across = scale(root, cross(n.unit, along));
        node.put_by_force(&mut Rows::new(jacobian, &node.place), &[across, scale(root * margin / size, along)]);
    }
}
