//! Swinging feet: how high above the terrain, how far in one step.
//!
//! `low - (z - height(x, y)) + margin <= 0` and, where the row is two-sided, `(z - height(x, y)) - high + margin <= 0`, times the length
//! scale. A step is no longer than its limit: `(|b - a|^2 / limit - limit) / 2`, times the same.

use super::Rows;
use crate::nlp::layout::NONE;
use crate::nlp::{Layout, Real};
use crate::settings::Transcription;
use crate::terrain::Ground;

/// Height rows of all swings, and their step rows.
///
/// * `residual` - out, at each row's place: low, high; or the step
/// * `jacobian` - out, one row at each place
#[inline(always)]
pub fn swing<T: Real>(layout: &Layout<T>, x: &[T], ground: &[Ground<T>], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    let constants = &layout.constants;
    let unit = constants.length_scale;
    for swing in &layout.swing_nodes {
        let footholds = swing.foothold.map(|f| layout.footholds[f as usize] as usize);
        let mut at = [T::zero(); 2];
        let mut height = swing.z_weights[2] * x[swing.height as usize];
        for i in 0..2 {
            at[0] += swing.xy_weights[i] * x[footholds[i]];
            at[1] += swing.xy_weights[i] * x[footholds[i] + 1];
            height += swing.z_weights[i] * ground[swing.foothold[i] as usize].height;
        }
        let under = layout.terrain.ground(at[0], at[1]);
        let place = swing.place.inequality as usize;
        residual[place] = (under.height - height + swing.low + constants.length_margin) * unit;
        if layout.transcription == Transcription::Momentum {
            residual[place + 1] = (height - under.height - swing.high + constants.length_margin) * unit;
        }
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &swing.place);
        rows.put(0, swing.height_column as usize, -swing.z_weights[2] * unit);
        for i in 0..2 {
            if swing.foothold_column[i] != NONE {
                let slope = ground[swing.foothold[i] as usize].slope;
                for d in 0..2 {
                    let value = swing.xy_weights[i] * under.slope[d] - swing.z_weights[i] * slope[d];
                    rows.put(0, swing.foothold_column[i] as usize + d, value * unit);
                }
            }
        }
    }
    let half = T::of(0.5);
    for stride in &layout.strides {
        let [a, b] = stride.foothold.map(|f| layout.footholds[f as usize] as usize);
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
