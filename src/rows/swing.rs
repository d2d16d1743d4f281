//! Swinging feet: how high above the terrain, and how high above lift-off and landing.
//!
//! `low - (z - height(x, y)) + margin <= 0` and `z - highest - high + margin <= 0`, times the length scale, where `highest` is that of both
//! footholds and of the ground under the foot: over a pit a foot need not go down. Both are one two-sided row on level ground, where the
//! three are the same; elsewhere the upper limit has a row of its own, in the middle of the swing. z rises to it and falls from it.

use super::blocks::Placed;
use super::table::{NONE, Place};
use super::write::Rows;
use super::{Spec, Tables};
use crate::real::Real;
use crate::terrain::Ground;

/// One row; of `momentum` on level ground two-sided.
pub const SPEC: Spec = Spec { rows: 1, pairs: 1, equality: false, after: 0, unit: "m" };

/// See [`super::Family::allowed`].
pub(super) use super::length_allowed as allowed;

crate::table! {
    /// Height of a foot above the terrain at one point of a swing; weights as in [`super::reach::ReachFoot`].
    pub struct SwingNode<T> {
        /// Weights of the footholds before and after.
        pub xy_weights: [T; 2],
        /// Weights of their heights, and of the swing's mid node.
        pub z_weights: [T; 3],
        /// Lowest height above the terrain, m.
        pub low: T,
        /// Highest above lift-off and landing, m, where the row has an upper side.
        pub high: T,
        /// 1: the row is two-sided.
        pub two_sided: u32,
        /// 1: the row is the upper limit alone.
        pub upper: u32,
        /// Swing height in `x`.
        pub height: u32,
        /// Its column.
        pub height_column: u32,
        /// Footholds before and after.
        pub foothold: [u32; 2],
        /// Their columns.
        pub foothold_column: [u32; 2],
        /// Buffers.
        pub place: Place,
    }
}

/// Roles: the swing height, the footholds before and after.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let swing = &mut tables.swing_nodes[entry];
    swing.place = at.place;
    swing.height = at.seats[0].position;
    swing.height_column = at.seats[0].column;
    swing.foothold_column = at.columns(1);
}

/// Height rows of all swings.
///
/// * `residual` - out, at each row's place: low, then high where it is two-sided; or high alone
/// * `jacobian` - out, one row at each place
#[inline(always)]
pub fn swing<T: Real>(tables: &Tables<T>, x: &[T], ground: &[Ground<T>], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    let constants = &tables.constants;
    let unit = constants.length_scale;
    for swing in &tables.swing_nodes {
        let footholds = swing.foothold.map(|f| tables.footholds[f as usize] as usize);
        let mut at = [T::zero(); 2];
        let mut height = swing.z_weights[2] * x[swing.height as usize];
        for i in 0..2 {
            at[0] += swing.xy_weights[i] * x[footholds[i]];
            at[1] += swing.xy_weights[i] * x[footholds[i] + 1];
            height += swing.z_weights[i] * ground[swing.foothold[i] as usize].height;
        }
        let under = tables.terrain.ground(at[0], at[1]);
        // What the height is above, and how each foothold moves it.
        let mut above = under.height;
        let mut weights = swing.xy_weights;
        let mut slopes = [under.slope; 2];
        let mut side = -T::one();
        let place = swing.place.inequality as usize;
        if swing.upper == 1 {
            side = T::one();
            for i in 0..2 {
                let foothold = &ground[swing.foothold[i] as usize];
                if foothold.height > above {
                    above = foothold.height;
                    weights = [T::zero(); 2];
                    weights[i] = T::one();
                    slopes[i] = foothold.slope;
                }
            }
            residual[place] = (height - above - swing.high + constants.length_margin) * unit;
        } else {
            residual[place] = (above - height + swing.low + constants.length_margin) * unit;
        }
        if swing.two_sided == 1 {
            residual[place + 1] = (height - above - swing.high + constants.length_margin) * unit;
        }
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &swing.place);
        rows.put(0, swing.height_column as usize, side * swing.z_weights[2] * unit);
        for i in 0..2 {
            if swing.foothold_column[i] != NONE {
                let slope = ground[swing.foothold[i] as usize].slope;
                for d in 0..2 {
                    let value = swing.z_weights[i] * slope[d] - weights[i] * slopes[i][d];
                    rows.put(0, swing.foothold_column[i] as usize + d, side * value * unit);
                }
            }
        }
    }
}
