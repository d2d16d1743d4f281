//! Yaw of a standing sole relative to the base: `|yaw - yaw of the base| <= limit`, tightened by a margin, rad.

use super::blocks::Placed;
use super::table::{NONE, Place};
use super::write::Rows;
use super::{Constants, RowKind, Spec, Tables};
use crate::real::Real;

/// One two-sided row.
pub const SPEC: Spec = Spec { rows: 1, pairs: 1, kind: RowKind::Inequality, unit: "rad" };

/// Tightening of the rows, rad.
pub const MARGIN: f64 = 1e-3;

/// See [`super::Family::allowed`].
pub(super) fn allowed<T: Real>(_: &Constants<T>, _: usize, tolerance: T) -> T {
    tolerance + T::of(MARGIN)
}

/// Index of the yaw in a pose.
pub const YAW: usize = 5;

crate::table! {
    /// Yaw of one sole at one time.
    pub struct Turn<T> {
        /// Hermite weights of pose and rates at the start, pose and rates at the end of the interval.
        pub weights: [T; 4],
        /// Yaw of the reference line, rad.
        pub reference: T,
        /// Largest difference, rad.
        pub limit: T,
        /// Positions in `x` of pose and rates at the start, pose and rates at the end of the interval.
        pub base: [u32; 4],
        /// Columns of these blocks; [`NONE`] if they are fixed.
        pub base_column: [u32; 4],
        /// Position in `x` of the yaw of the sole.
        pub yaw: u32,
        /// Column of the yaw; [`NONE`] if it is fixed.
        pub yaw_column: u32,
        /// Place of the row in the buffers.
        pub place: Place,
    }
}

/// Writes positions and columns into an entry. Roles: the four base blocks, the yaw.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let turn = &mut tables.turns[entry];
    turn.place = at.place;
    turn.base = at.positions(0);
    turn.base_column = at.columns(0);
    turn.yaw = at.seats[4].position;
    turn.yaw_column = at.seats[4].column;
}

/// Rows of all entries.
///
/// * `residual` - out, at each entry's place: upper side, lower side
/// * `jacobian` - out, one row at each entry's place
#[inline(always)]
pub fn turn<T: Real>(tables: &Tables<T>, x: &[T], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    for turn in &tables.turns {
        let mut apart = x[turn.yaw as usize] - turn.reference;
        for i in 0..4 {
            apart -= turn.weights[i] * x[turn.base[i] as usize + YAW];
        }
        let (at, limit) = (turn.place.inequality as usize, turn.limit - T::of(MARGIN));
        residual[at] = apart - limit;
        residual[at + 1] = -apart - limit;
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &turn.place);
        for (i, &column) in turn.base_column.iter().enumerate().filter(|(_, column)| **column != NONE) {
            for d in 0..=YAW {
                rows.put(0, column as usize + d, if d == YAW { -turn.weights[i] } else { T::zero() });
            }
        }
        if turn.yaw_column != NONE {
            rows.put(0, turn.yaw_column as usize, T::one());
        }
    }
}
