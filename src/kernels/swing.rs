//! Swing clearance: the mid node of a swing, halfway between the footholds, is not under the terrain.
//!
//! `height(mid) - z + margin <= 0`, times the length scale. Source: \[3\].

use super::Rows;
use crate::nlp::layout::NONE;
use crate::nlp::{Layout, Real};

/// Clearance rows of all swings.
///
/// * `residual` - out, one at each swing's place
/// * `jacobian` - out, one row at each swing's place
#[inline(always)]
pub fn swing<T: Real>(layout: &Layout<T>, x: &[T], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    let constants = &layout.constants;
    let unit = constants.length_scale;
    let half = T::of(0.5);
    for swing in &layout.swing_nodes {
        let (a, b) = (layout.footholds[swing.foothold[0] as usize] as usize, layout.footholds[swing.foothold[1] as usize] as usize);
        let under = layout.terrain.ground(half * (x[a] + x[b]), half * (x[a + 1] + x[b + 1]));
        residual[swing.place.inequality as usize] = (under.height - x[swing.height as usize] + constants.length_margin) * unit;
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &swing.place);
        rows.put(0, swing.height_column as usize, -unit);
        for i in 0..2 {
            if swing.foothold_column[i] != NONE {
                for d in 0..2 {
                    rows.put(0, swing.foothold_column[i] as usize + d, half * under.slope[d] * unit);
                }
            }
        }
    }
}
