//! Limit on the length of the step in one swing, which bounds the foot's speed.
//!
//! A step from `a` to `b` satisfies `(|b - a|^2 / limit - limit) / 2 <= 0`, times the length scale.

use super::blocks::Placed;
use super::table::{NONE, Place};
use super::write::Rows;
use super::{Constants, RowKind, Spec, Tables};
use crate::real::Real;

/// One row per swing.
pub const SPEC: Spec = Spec { rows: 1, pairs: 0, kind: RowKind::Inequality, unit: "m" };

/// See [`super::Family::allowed`]. These rows have no margin.
pub(super) fn allowed<T: Real>(constants: &Constants<T>, _: usize, tolerance: T) -> T {
    tolerance * constants.length_scale
}

crate::table! {
    /// Length of the step of one swing.
    pub struct Stride<T> {
        /// Longest admissible step, m.
        pub limit: T,
        /// Indices of the footholds before and after the swing.
        pub foothold: [u32; 2],
        /// Columns of the footholds.
        pub foothold_column: [u32; 2],
        /// Place of the row in the buffers.
        pub place: Place,
    }
}

/// Writes columns into an entry. Roles: foothold before, foothold after.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let stride = &mut tables.strides[entry];
    stride.place = at.place;
    stride.foothold_column = at.columns(0);
}

/// Step rows of all swings.
///
/// * `residual` - out, at each entry's place
/// * `jacobian` - out, one row at each entry's place
#[inline(always)]
pub fn stride<T: Real>(tables: &Tables<T>, x: &[T], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    let unit = tables.constants.length_scale;
    let half = T::of(0.5);
    for stride in &tables.strides {
        let [a, b] = stride.foothold.map(|f| tables.footholds[f as usize] as usize);
        let step = [x[b] - x[a], x[b + 1] - x[a + 1]];
        let squares = step[0] * step[0] + step[1] * step[1];
        residual[stride.place.inequality as usize] = half * (squares / stride.limit - stride.limit) * unit;
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &stride.place);
        for (i, sign) in [-unit, unit].into_iter().enumerate() {
            if stride.foothold_column[i] != NONE {
                for d in 0..2 {
                    rows.put(0, stride.foothold_column[i] as usize + d, sign * step[d] / stride.limit);
                }
            }
        }
    }
}
