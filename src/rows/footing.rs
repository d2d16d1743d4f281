//! Footholds on ground with edges: each stays within a box in which the whole foot has support.
//!
//! `x - high + margin <= 0` and `low - x + margin <= 0` along x and y, times the length scale.

use super::blocks::Placed;
use super::table::{NONE, Place};
use super::write::Rows;
use super::{RowKind, Spec, Tables};
use crate::real::Real;

/// Two two-sided rows per foothold.
pub const SPEC: Spec = Spec { rows: 2, pairs: 2, kind: RowKind::Inequality, unit: "m" };

/// See [`super::Family::allowed`].
pub(super) use super::length_allowed as allowed;

crate::table! {
    /// Box of one foothold.
    pub struct Footing<T> {
        /// Lower sides, m.
        pub low: [T; 2],
        /// Upper sides, m.
        pub high: [T; 2],
        /// Index of the foothold.
        pub foothold: u32,
        /// First column of the foothold.
        pub foothold_column: u32,
        /// Place of the rows in the buffers.
        pub place: Place,
    }
}

/// Writes columns into an entry. Role: the foothold.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let footing = &mut tables.footings[entry];
    footing.place = at.place;
    footing.foothold_column = at.seats[0].column;
}

/// Rows of all footholds that have a box.
///
/// * `residual` - out, at each entry's place: 2 upper sides, 2 lower sides
/// * `jacobian` - out, 2 rows at each entry's place
#[inline(always)]
pub fn footing<T: Real>(tables: &Tables<T>, x: &[T], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    let (unit, margin) = (tables.constants.length_scale, tables.constants.length_margin);
    for footing in &tables.footings {
        let at = tables.footholds[footing.foothold as usize] as usize;
        let place = footing.place.inequality as usize;
        for d in 0..2 {
            residual[place + d] = (x[at + d] - footing.high[d] + margin) * unit;
            residual[place + 2 + d] = (footing.low[d] - x[at + d] + margin) * unit;
        }
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &footing.place);
        if footing.foothold_column != NONE {
            for d in 0..2 {
                rows.put(d, footing.foothold_column as usize + d, unit);
                rows.put(d, footing.foothold_column as usize + 1 - d, T::zero());
            }
        }
    }
}
