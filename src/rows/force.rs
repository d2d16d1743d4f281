//! Contact forces inside the friction pyramid of the ground under the foothold, with an upper limit on the normal force, at force nodes or
//! at the Bezier points next to them.
//!
//! With unit normal `n` and tangents `t1`, `t2` of the ground: `n.f <= f_max`, `+-t1.f - mu n.f <= 0`, `+-t2.f - mu n.f <= 0`, `-n.f <= 0`,
//! each tightened by a margin. Forces are in the force unit. Source: \[3\].

use super::blocks::Placed;
use super::math::{Vec3, add, dot, scale, sub};
use super::table::{NONE, Place};
use super::write::Rows;
use super::{RowKind, Spec, Tables};
use crate::real::Real;
use crate::terrain::Ground;
use multiversion::multiversion;

/// Upper limit of the normal force, then four sides of the pyramid. Unilateral contact (`-n.f <= 0`) is the lower side of the first row.
pub const SPEC: Spec = Spec { rows: 5, pairs: 1, kind: RowKind::Inequality, unit: "N" };

/// See [`super::Family::allowed`].
pub(super) use super::force_allowed as allowed;

crate::table! {
    /// Force at a node or at a Bezier point next to it: `value + slope_weight slope`.
    pub struct ForceNode<T> {
        /// Position of the node in `x`.
        pub node: u32,
        /// Column of the node.
        pub node_column: u32,
        /// Weight of the slope: 0 at the node, -1/3 and 1/3 at the Bezier points of the pieces before and after it.
        pub slope_weight: T,
        /// Index of the foothold whose ground the force acts on.
        pub foothold: u32,
        /// Column of the foothold.
        pub foothold_column: u32,
        /// Place of the rows in the buffers.
        pub place: Place,
    }
}

impl<T> ForceNode<T> {
    /// Entry without positions and columns, which [`ForceNode::sit`] writes.
    pub(crate) fn new(slope_weight: T, foothold: u32) -> Self {
        ForceNode { node: NONE, node_column: NONE, slope_weight, foothold, foothold_column: NONE, place: Place::default() }
    }

    /// Force at this point, in force units.
    #[inline(always)]
    pub(super) fn force(&self, x: &[T]) -> Vec3<T>
    where
        T: Real,
    {
        let at = self.node as usize;
        std::array::from_fn(|d| x[at + d] + self.slope_weight * x[at + 3 + d])
    }

    /// Normal and tangents of the ground under the foothold.
    ///
    /// * `edge_radius` - radius with which terrain edges are rounded, m; 0 for the exact ground
    #[inline(always)]
    pub(super) fn directions(&self, tables: &Tables<T>, x: &[T], edge_radius: T) -> [Direction<T>; 3]
    where
        T: Real,
    {
        let under = tables.footholds[self.foothold as usize] as usize;
        basis(&tables.terrain.rounded_ground(x[under], x[under + 1], edge_radius))
    }

    /// Writes the derivatives of the rows with respect to the force: columns of the node's value and of its weighted slope.
    #[inline(always)]
    pub(super) fn put_by_force<const R: usize>(&self, rows: &mut Rows<T>, by_force: &[Vec3<T>; R])
    where
        T: Real,
    {
        let c = self.node_column as usize;
        for r in 0..R {
            for d in 0..3 {
                rows.put(r, c + d, by_force[r][d]);
                rows.put(r, c + 3 + d, self.slope_weight * by_force[r][d]);
            }
        }
    }

    /// Writes place, positions and columns. Roles: force node, foothold.
    pub(super) fn sit(&mut self, at: &Placed) {
        self.place = at.place;
        self.node = at.seats[0].position;
        self.node_column = at.seats[0].column;
        self.foothold_column = at.seats[1].column;
    }
}

/// Writes positions and columns into an entry. Roles: force node, foothold.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    tables.force_nodes[entry].sit(at);
}

/// Unit vector and its derivatives with respect to x and y.
pub(crate) struct Direction<T> {
    pub unit: Vec3<T>,
    pub by: [Vec3<T>; 2],
}

/// Normalises `v`, whose derivatives are `by`: `d(v/|v|) = (dv - u (u.dv)) / |v|`.
#[inline(always)]
fn normalised<T: Real>(v: Vec3<T>, by: [Vec3<T>; 2]) -> Direction<T> {
    let inverse = T::one() / dot(v, v).sqrt();
    let unit = scale(inverse, v);
    let mut direction = Direction { unit, by };
    for dv in &mut direction.by {
        *dv = scale(inverse, sub(*dv, scale(dot(unit, *dv), unit)));
    }
    direction
}

/// Normal and the two tangents of the ground.
#[inline(always)]
pub(crate) fn basis<T: Real>(ground: &Ground<T>) -> [Direction<T>; 3] {
    let (zero, one) = (T::zero(), T::one());
    let ([hx, hy], [[hxx, hxy], [hyx, hyy]]) = (ground.slope, ground.curvature);
    [
        normalised([-hx, -hy, one], [[-hxx, -hyx, zero], [-hxy, -hyy, zero]]),
        normalised([one, zero, hx], [[zero, zero, hxx], [zero, zero, hxy]]),
        normalised([zero, one, hy], [[zero, zero, hyx], [zero, zero, hyy]]),
    ]
}

/// Force rows of all nodes.
///
/// * `edge_radius` - radius with which terrain edges are rounded, m; 0 for the exact rows
/// * `residual` - out, at each node's place: normal limit, 4 friction rows, unilateral contact
/// * `jacobian` - out, 5 rows at each node's place; unilateral contact is the lower side of the first
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn force<T: Real>(tables: &Tables<T>, x: &[T], edge_radius: T, residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    let constants = &tables.constants;
    let (zero, one) = (T::zero(), T::one());
    for node in &tables.force_nodes {
        let force = node.force(x);
        let [n, t1, t2] = node.directions(tables, x, edge_radius);
        let minus_mu_n = scale(-constants.friction, n.unit);
        let normals = [n.unit, add(t1.unit, minus_mu_n), sub(minus_mu_n, t1.unit), add(t2.unit, minus_mu_n), sub(minus_mu_n, t2.unit)];
        let at = node.place.inequality as usize;
        for r in 0..5 {
            let bound = if r == 0 { constants.force_limit } else { zero };
            residual[at + r] = dot(normals[r], force) - bound + constants.force_margin;
        }
        residual[at + 5] = -dot(n.unit, force) + constants.force_margin;
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &node.place);
        node.put_by_force(&mut rows, &normals);
        if node.foothold_column == NONE {
            continue;
        }
        let c = node.foothold_column as usize;
        for d in 0..2 {
            let by_n = dot(n.by[d], force);
            let by_t = [dot(t1.by[d], force), dot(t2.by[d], force)];
            rows.put(0, c + d, by_n);
            for (r, side) in [(1, one), (2, -one), (3, one), (4, -one)] {
                rows.put(r, c + d, side * by_t[(r - 1) / 2] - constants.friction * by_n);
            }
        }
    }
}
