//! Reach boxes: each foot stays within a box around its nominal position in the base frame.
//!
//! `v = R' (foot - p) - nominal`, rows `v - reach + margin <= 0` and `-v - reach + margin <= 0`, times the length scale. Source: \[3\].

use super::Rows;
use super::math::{cross, euler, mul_transposed, scale, sub};
use crate::nlp::layout::{Deviation, NONE};
use crate::nlp::{Layout, Real};
use crate::terrain::Ground;
use multiversion::multiversion;

/// Reach rows of all feet at all reach instants.
///
/// * `residual` - out, at each foot's place: 3 upper sides, 3 lower sides
/// * `jacobian` - out, 3 rows at each foot's place, then the same rows by the base pose, `[3][6]`
#[multiversion(targets("x86_64+avx2"))]
pub fn reach<T: Real>(
    layout: &Layout<T>,
    x: &[T],
    ground: &[Ground<T>],
    deviations: &[Deviation<T>],
    residual: &mut [T],
    mut jacobian: Option<&mut [T]>,
) {
    let constants = &layout.constants;
    let zero = T::zero();
    let unit = constants.length_scale;
    for instant in &layout.reach {
        let mut pose = instant.base.reference;
        for i in 0..4 {
            let at = instant.base.variable[i] as usize;
            for d in 0..6 {
                pose[d] += instant.base.weights[i] * x[at + d];
            }
        }
        if let Some(deviation) = deviations.get(instant.base.interval as usize) {
            for (w, deviation) in instant.base.deviation_weights.iter().zip(&deviation.pose) {
                for d in 0..6 {
                    pose[d] += *w * deviation[d];
                }
            }
        }
        let base_w = [pose[0], pose[1], pose[2]];
        let (rot_wb, axes) = euler([pose[3], pose[4], pose[5]]);
        for foot in &layout.reach_feet[instant.feet.range()] {
            let mut foot_w = [zero; 3];
            for i in 0..2 {
                if foot.foothold[i] == NONE {
                    continue;
                }
                let at = layout.footholds[foot.foothold[i] as usize] as usize;
                foot_w[0] += foot.xy_weights[i] * x[at];
                foot_w[1] += foot.xy_weights[i] * x[at + 1];
                foot_w[2] += foot.z_weights[i] * ground[foot.foothold[i] as usize].height;
            }
            if foot.height != NONE {
                foot_w[2] += foot.z_weights[2] * x[foot.height as usize];
            }
            let leg_w = sub(foot_w, base_w);
            let offset_b = sub(mul_transposed(&rot_wb, leg_w), foot.nominal);
            let at = foot.place.inequality as usize;
            for d in 0..3 {
                let room = constants.reach[d] - constants.length_margin;
                residual[at + d] = (offset_b[d] - room) * unit;
                residual[at + 3 + d] = (-offset_b[d] - room) * unit;
            }
            let Some(jacobian) = jacobian.as_deref_mut() else { continue };
            let mut rows = Rows::new(jacobian, &foot.place);
            // d(R' leg)/d angle_i = R' (leg x axis_i).
            let mut turns = axes;
            for turn in &mut turns {
                *turn = scale(unit, mul_transposed(&rot_wb, cross(leg_w, *turn)));
            }
            let mut pose = [[zero; 6]; 3];
            for r in 0..3 {
                for d in 0..3 {
                    pose[r][d] = -rot_wb[d][r] * unit;
                    pose[r][3 + d] = turns[d][r];
                }
            }
            rows.put_after(3, &pose);
            for i in 0..4 {
                if foot.base_column[i] == NONE {
                    continue;
                }
                let (c, w) = (foot.base_column[i] as usize, instant.base.weights[i]);
                for r in 0..3 {
                    for d in 0..6 {
                        rows.put(r, c + d, w * pose[r][d]);
                    }
                }
            }
            for i in 0..2 {
                if foot.foothold[i] == NONE || foot.foothold_column[i] == NONE {
                    continue;
                }
                let c = foot.foothold_column[i] as usize;
                let slope = ground[foot.foothold[i] as usize].slope;
                for r in 0..3 {
                    for d in 0..2 {
                        rows.put(r, c + d, (foot.xy_weights[i] * rot_wb[d][r] + foot.z_weights[i] * slope[d] * rot_wb[2][r]) * unit);
                    }
                }
            }
            if foot.height != NONE {
                for r in 0..3 {
                    rows.put(r, foot.height_column as usize, foot.z_weights[2] * rot_wb[2][r] * unit);
                }
            }
        }
    }
}
