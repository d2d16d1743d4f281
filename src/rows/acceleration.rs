//! Acceleration limit of swinging feet at lift-off and touchdown.
//!
//! A swing consists of two cubics, whose accelerations are linear in time: the extremes are at the ends of the swing and around its middle,
//! and those at the ends are larger. With the step `d` from foothold to foothold and the height `h` of the mid node over one of them,
//! `a^2 = (by_step d)^2 + (by_height h)^2`; rows `((a / a_max)^2 - 1 + margin) / 2 <= 0`.

use super::blocks::Placed;
use super::table::{NONE, Place};
use super::write::Rows;
use super::{Constants, RowKind, Spec, Tables};
use crate::real::Real;
use crate::terrain::Ground;

/// One row at lift-off, one at touchdown.
pub const SPEC: Spec = Spec { rows: 2, pairs: 0, kind: RowKind::Inequality, unit: "m/s2" };

/// Tightening of the rows, relative to the square of the limit.
pub(crate) const MARGIN: f64 = 2e-3;

/// See [`super::Family::allowed`].
pub(super) fn allowed<T: Real>(constants: &Constants<T>, _: usize, tolerance: T) -> T {
    tolerance / constants.foot_acceleration + T::of(MARGIN / 2.)
}

crate::table! {
    /// Accelerations at the ends of one swing.
    pub struct Acceleration<T> {
        /// Acceleration per step length, 1/s².
        pub by_step: T,
        /// Acceleration per height of the mid node, 1/s².
        pub by_height: T,
        /// Position of the swing height in `x`.
        pub height: u32,
        /// Column of the swing height.
        pub height_column: u32,
        /// Indices of the footholds before and after the swing.
        pub foothold: [u32; 2],
        /// Columns of the footholds.
        pub foothold_column: [u32; 2],
        /// Place of the rows in the buffers.
        pub place: Place,
    }
}

impl<T> Acceleration<T> {
    /// Entry without positions and columns, which [`place`] writes.
    pub(crate) fn new([by_step, by_height]: [T; 2], foothold: [u32; 2]) -> Self {
        let none = [NONE; 2];
        Acceleration { by_step, by_height, height: NONE, height_column: NONE, foothold, foothold_column: none, place: Place::default() }
    }
}

/// Writes positions and columns into an entry. Roles: swing height, foothold before, foothold after.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let swing = &mut tables.accelerations[entry];
    swing.place = at.place;
    swing.height = at.seats[0].position;
    swing.height_column = at.seats[0].column;
    swing.foothold_column = at.columns(1);
}

/// Acceleration rows of all swings.
///
/// * `residual` - out, at each entry's place: lift-off, touchdown
/// * `jacobian` - out, two rows at each entry's place
#[inline(always)]
pub fn acceleration<T: Real>(tables: &Tables<T>, x: &[T], ground: &[Ground<T>], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    let limit = tables.constants.foot_acceleration;
    let (half, start) = (T::of(0.5), T::one() - T::of(MARGIN));
    for swing in &tables.accelerations {
        let [a, b] = swing.foothold.map(|f| tables.footholds[f as usize] as usize);
        let by_step = swing.by_step / limit;
        let by_height = swing.by_height / limit;
        let step = [by_step * (x[b] - x[a]), by_step * (x[b + 1] - x[a + 1])];
        let squares = step[0] * step[0] + step[1] * step[1];
        let rise: [T; 2] = std::array::from_fn(|r| by_height * (x[swing.height as usize] - ground[swing.foothold[r] as usize].height));
        let at = swing.place.inequality as usize;
        for r in 0..2 {
            residual[at + r] = half * (squares + rise[r] * rise[r] - start);
        }
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &swing.place);
        for r in 0..2 {
            if swing.height_column != NONE {
                rows.put(r, swing.height_column as usize, by_height * rise[r]);
            }
            for i in 0..2 {
                if swing.foothold_column[i] == NONE {
                    continue;
                }
                for d in 0..2 {
                    let along = if i == 0 { -by_step * step[d] } else { by_step * step[d] };
                    // The height of row `r` is measured from foothold `r` only.
                    let over = if i == r { by_height * rise[r] * ground[swing.foothold[i] as usize].slope[d] } else { T::zero() };
                    rows.put(r, swing.foothold_column[i] as usize + d, along - over);
                }
            }
        }
    }
}
