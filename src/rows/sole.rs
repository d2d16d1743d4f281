//! Wrench of a sole: centre of pressure inside the sole, and tangential force and torsion inside friction, at force nodes or at the Bezier
//! points next to them.
//!
//! With unit normal `n` of the ground, axes `e_x` (heel to toe) and `e_y` of the sole, force `f`, moment `m` about its centre and
//! `t = f - (n.f) n`: `+-m.e_y - s X n.f <= 0`, `+-m.e_x - s Y n.f <= 0` and `|t| + |tau| / r - mu n.f <= 0`, where `X` and `Y` are half of
//! length and width, `s` is [`crate::robot::PRESSURE_SHARE`], `tau = n.m + m.t / n.f` is the moment about the normal through the centre of
//! pressure, and `r` is [`crate::robot::Sole::torsion_radius`]. Each row is tightened by the margin, which also rounds `|t|`, `|tau|` and
//! `1 / n.f`. Forces are in the force unit, moments in the force unit times `X`.
//!
//! Forces at the four corners inside their friction cones produce every such wrench. The set of the wrenches that they can produce is a
//! convex cone, so a curve whose Bezier points are in it is in it everywhere.
//!
//! The ground under a sole is flat: the derivatives with respect to the foothold are left out.

use super::blocks::Placed;
use super::force::basis;
use super::math::{Vec3, add, cross, dot, scale, sub};
use super::table::{NONE, Place};
use super::write::Rows;
use super::{RowKind, Spec, Tables};
use crate::real::Real;

/// Centre of pressure at toe, heel, left and right side, then friction.
pub const SPEC: Spec = Spec { rows: 5, pairs: 0, kind: RowKind::Inequality, unit: "N" };

/// See [`super::Family::allowed`].
pub(super) use super::force_allowed as allowed;

crate::table! {
    /// Wrench at a force node or at a Bezier point next to it.
    pub struct SolePoint<T> {
        /// Weight of the slopes, see [`super::force::ForceNode`].
        pub slope_weight: T,
        /// Positions in `x` of the force node and the moment node.
        pub node: [u32; 2],
        /// Columns of the force node and the moment node.
        pub node_column: [u32; 2],
        /// Position in `x` of the yaw of the sole.
        pub yaw: u32,
        /// Column of the yaw; [`NONE`] if it is fixed.
        pub yaw_column: u32,
        /// Index of the foothold.
        pub foothold: u32,
        /// Place of the rows in the buffers.
        pub place: Place,
    }
}

impl<T> SolePoint<T> {
    /// Entry without positions and columns.
    pub(crate) fn new(slope_weight: T, foothold: u32) -> Self {
        let (node, node_column) = ([NONE; 2], [NONE; 2]);
        SolePoint { slope_weight, node, node_column, yaw: NONE, yaw_column: NONE, foothold, place: Place::default() }
    }
}

/// Writes positions and columns into an entry. Roles: force node, moment node, yaw.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let point = &mut tables.sole_points[entry];
    point.place = at.place;
    point.node = at.positions(0);
    point.node_column = at.columns(0);
    point.yaw = at.seats[2].position;
    point.yaw_column = at.seats[2].column;
}

/// Axes `e_x` and `e_y` of a sole with a yaw on ground with a normal and slopes, and their derivatives with respect to the yaw.
#[inline(always)]
fn axes<T: Real>(normal: Vec3<T>, slope: [T; 2], yaw: T) -> [[Vec3<T>; 2]; 2] {
    let (sin, cos) = yaw.sin_cos();
    let along = [cos, sin, slope[0] * cos + slope[1] * sin];
    let turned = [-sin, cos, slope[1] * cos - slope[0] * sin];
    let inverse = T::one() / dot(along, along).sqrt();
    let x = scale(inverse, along);
    let by_yaw = scale(inverse, sub(turned, scale(dot(x, turned), x)));
    [[x, cross(normal, x)], [by_yaw, cross(normal, by_yaw)]]
}

/// Wrench rows of all points.
///
/// * `residual` - out, at each point's place
/// * `jacobian` - out, 5 rows at each point's place
#[inline(always)]
pub fn sole<T: Real>(tables: &Tables<T>, x: &[T], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    let constants = &tables.constants;
    let (friction, margin, lever) = (constants.friction, constants.force_margin, constants.torsion);
    for point in &tables.sole_points {
        let at_point = |node: u32| -> Vec3<T> {
            let at = node as usize;
            std::array::from_fn(|d| x[at + d] + point.slope_weight * x[at + 3 + d])
        };
        let (force, moment) = (at_point(point.node[0]), at_point(point.node[1]));
        let under = tables.footholds[point.foothold as usize] as usize;
        let ground = tables.terrain.ground(x[under], x[under + 1]);
        let [normal, ..] = basis(&ground).map(|direction| direction.unit);
        let [[e_x, e_y], by_yaw] = axes(normal, ground.slope, x[point.yaw as usize]);
        let push = dot(normal, force);
        let tangential = sub(force, scale(push, normal));
        let across = sub(moment, scale(dot(normal, moment), normal));
        let square = push * push + margin * margin;
        let inverse = push / square;
        let torsion = (dot(normal, moment) + dot(across, tangential) * inverse) * lever;
        let (size, twist) = ((dot(tangential, tangential) + margin * margin).sqrt(), (torsion * torsion + margin * margin).sqrt());
        let at = point.place.inequality as usize;
        let tilts = [dot(moment, e_y), dot(moment, e_x)];
        for i in 0..2 {
            let limit = constants.pressure[i] * push - margin;
            residual[at + 2 * i] = tilts[i] - limit;
            residual[at + 2 * i + 1] = -tilts[i] - limit;
        }
        residual[at + 4] = size + twist - friction * push + margin;
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &point.place);
        // Derivatives with respect to force, moment and yaw.
        let mut put = |row: usize, by_force: Vec3<T>, by_moment: Vec3<T>, by_yaw: T| {
            for (by, column) in [by_force, by_moment].into_iter().zip(point.node_column) {
                rows.put_three(row, column as usize, by);
                rows.put_three(row, column as usize + 3, scale(point.slope_weight, by));
            }
            if point.yaw_column != NONE {
                rows.put(row, point.yaw_column as usize, by_yaw);
            }
        };
        for (i, (axis, turned)) in [(e_y, by_yaw[1]), (e_x, by_yaw[0])].into_iter().enumerate() {
            let by_force = scale(-constants.pressure[i], normal);
            put(2 * i, by_force, axis, dot(moment, turned));
            put(2 * i + 1, by_force, scale(-T::one(), axis), -dot(moment, turned));
        }
        let share = torsion / twist * lever;
        let by_inverse = (margin * margin - push * push) / (square * square) * dot(across, tangential);
        let by_torsion = add(scale(inverse, across), scale(by_inverse, normal));
        let by_force = add(add(scale(T::one() / size, tangential), scale(-friction, normal)), scale(share, by_torsion));
        put(4, by_force, scale(share, add(normal, scale(inverse, tangential))), T::zero());
    }
}
