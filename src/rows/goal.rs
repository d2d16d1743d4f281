//! Distance of a pose or of rates at a knot from those of the goal, as cost rows: each component times a weight.

use super::blocks::Placed;
use super::table::{NONE, Place};
use super::write::Rows;
use super::{RowKind, Spec, Tables};
use crate::real::Real;

/// One row per component of a block.
pub const SPEC: Spec = Spec { rows: 6, pairs: 0, kind: RowKind::Cost, unit: "" };

/// See [`super::Family::allowed`].
pub(super) use super::any_residual as allowed;

crate::table! {
    /// Goal rows of the pose or of the rates.
    pub struct Goal<T> {
        /// Weight of each component, 1/m and 1/rad, or s/m and s/rad.
        pub weight: [T; 6],
        /// Value at which the cost of each component is 0.
        pub desired: [T; 6],
        /// Position of the block in `x`.
        pub variable: u32,
        /// First column of the block.
        pub column: u32,
        /// Place of the rows.
        pub place: Place,
    }
}

/// Role: the block.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let goal = &mut tables.goals[entry];
    goal.place = at.place;
    goal.variable = at.seats[0].position;
    goal.column = at.seats[0].column;
}

/// Goal rows.
///
/// * `residual` - out, by row
/// * `jacobian` - out, six rows at each place
#[inline(always)]
pub fn goal<T: Real>(tables: &Tables<T>, x: &[T], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    for goal in &tables.goals {
        let (at, first) = (goal.place.row as usize, goal.variable as usize);
        for d in 0..6 {
            residual[at + d] = goal.weight[d] * (x[first + d] - goal.desired[d]);
        }
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &goal.place);
        for d in 0..6 {
            if goal.column != NONE {
                rows.put(d, goal.column as usize + d, goal.weight[d]);
            }
        }
    }
}
