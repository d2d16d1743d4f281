//! Difference of a variable between the end and the start of a periodic stride: one that repeats has that of the stride's displacement.

use super::blocks::Placed;
use super::table::{NONE, Place};
use super::write::Rows;
use super::{Constants, RowKind, Spec, Tables};
use crate::real::Real;

/// One row per component of a block.
pub const SPEC: Spec = Spec { rows: 1, pairs: 0, kind: RowKind::Equality, unit: "" };

/// See [`super::Family::allowed`]. The unit is that of the variable: m, rad, m/s or rad/s.
pub(super) fn allowed<T: Real>(constants: &Constants<T>, _: usize, tolerance: T) -> T {
    tolerance * constants.length_scale
}

crate::table! {
    /// Periodic row of one component of two blocks.
    pub struct Periodic<T> {
        /// Difference of the component in a stride, in the unit of the variable.
        pub difference: T,
        /// Index of the component in its block.
        pub component: u32,
        /// Positions of the component in `x`, at the start and at the end.
        pub variable: [u32; 2],
        /// Columns of the component.
        pub column: [u32; 2],
        /// Place of the row.
        pub place: Place,
    }
}

/// Roles: block at the start, block at the end.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let periodic = &mut tables.periodics[entry];
    periodic.place = at.place;
    periodic.variable = at.positions(0).map(|position| position + periodic.component);
    periodic.column = at.columns(0).map(|column| if column == NONE { NONE } else { column + periodic.component });
}

/// Periodic rows.
///
/// * `residual` - out, by row
/// * `jacobian` - out, one row at each place
#[inline(always)]
pub fn periodic<T: Real>(tables: &Tables<T>, x: &[T], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    let unit = tables.constants.length_scale;
    for periodic in &tables.periodics {
        let [start, end] = periodic.variable.map(|variable| x[variable as usize]);
        residual[periodic.place.row as usize] = (end - start - periodic.difference) * unit;
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &periodic.place);
        for (i, by) in [-unit, unit].into_iter().enumerate() {
            if periodic.column[i] != NONE {
                rows.put(0, periodic.column[i] as usize, by);
            }
        }
    }
}
