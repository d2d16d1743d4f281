//! Force and motion of a foot between its nodes.

use super::Tables;
use super::math::Vec3;
use super::table::NONE;
use crate::real::Real;
use crate::terrain::Ground;

crate::table! {
    /// Force of a foot in contact at one instant: `sum_i (weights[i][0] value_i + weights[i][1] slope_i)`.
    pub struct StanceForce<T> {
        /// Hermite weights of value and slope of two nodes, times the scale of the variables.
        pub weights: [[T; 2]; 2],
        /// Positions of the nodes in `x`; [`NONE`] where the force is zero.
        pub node: [u32; 2],
        /// Columns of the nodes.
        pub node_column: [u32; 2],
        /// Index of the foothold.
        pub foothold: u32,
        /// Column of the foothold.
        pub foothold_column: u32,
    }
}

/// Force of a foot in contact, world frame, in the unit of its weights.
#[inline(always)]
pub fn stance_force<T: Real>(stance: &StanceForce<T>, x: &[T]) -> Vec3<T> {
    let mut force_w = [T::zero(); 3];
    for i in 0..2 {
        if stance.node[i] != NONE {
            let at = stance.node[i] as usize;
            for d in 0..3 {
                force_w[d] += stance.weights[i][0] * x[at + d] + stance.weights[i][1] * x[at + 3 + d];
            }
        }
    }
    force_w
}

/// Position of a foot, world frame, or a derivative of it: the weighted sum of the footholds before and after a swing and of the height of
/// its mid node.
///
/// * `foothold` - indices of the footholds; the second is [`NONE`] in stance
/// * `height` - position of the swing height in `x`; [`NONE`] in stance
#[inline(always)]
pub fn foot_motion<T: Real>(
    tables: &Tables<T>,
    x: &[T],
    ground: &[Ground<T>],
    foothold: [u32; 2],
    height: u32,
    xy_weights: [T; 2],
    z_weights: [T; 3],
) -> Vec3<T> {
    let mut foot_w = [T::zero(); 3];
    for i in 0..2 {
        if foothold[i] == NONE {
            continue;
        }
        let at = tables.footholds[foothold[i] as usize] as usize;
        foot_w[0] += xy_weights[i] * x[at];
        foot_w[1] += xy_weights[i] * x[at + 1];
        foot_w[2] += z_weights[i] * ground[foothold[i] as usize].height;
    }
    if height != NONE {
        foot_w[2] += z_weights[2] * x[height as usize];
    }
    foot_w
}
