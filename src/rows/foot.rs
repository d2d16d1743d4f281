//! Force and motion of a foot between its nodes.

use super::Tables;
use super::blocks::Placed;
use super::math::{Vec3, add, scale};
use super::table::NONE;
use super::write::Rows;
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

crate::table! {
    /// Two derivatives of the position of a swinging foot at one instant, such as velocity and acceleration.
    pub struct SwingMotion<T> {
        /// Weights of the footholds before and after, for x and y.
        pub xy_weights: [[T; 2]; 2],
        /// Weights of the heights of the footholds and of the mid node, for z.
        pub z_weights: [[T; 3]; 2],
        /// Constant parts; zero unless the swing had begun before the motion.
        pub offset: [[T; 3]; 2],
        /// Position of the swing height in `x`.
        pub height: u32,
        /// Column of the swing height.
        pub height_column: u32,
        /// Footholds before and after.
        pub foothold: [u32; 2],
        /// First columns of the footholds.
        pub foothold_column: [u32; 2],
    }
}

impl<T> StanceForce<T> {
    /// Writes positions and columns. Roles from `first` on: the two nodes, the foothold.
    pub(super) fn place(&mut self, at: &Placed, first: usize) {
        self.node = at.positions(first);
        self.node_column = at.columns(first);
        self.foothold_column = at.seats[first + 2].column;
    }
}

impl<T> SwingMotion<T> {
    /// Writes positions and columns. Roles from `first` on: the swing height, the footholds before and after.
    pub(super) fn place(&mut self, at: &Placed, first: usize) {
        self.height = at.seats[first].position;
        self.height_column = at.seats[first].column;
        self.foothold_column = at.columns(first + 1);
    }
}

/// Writes the columns of force and foothold of a row.
///
/// * `by_force`, `by_foot` - derivatives of the row with respect to the force and to the position of the foot
#[inline(always)]
pub fn put_stance<T: Real>(rows: &mut Rows<T>, row: usize, stance: &StanceForce<T>, under: &Ground<T>, [by_force, by_foot]: [Vec3<T>; 2]) {
    for i in 0..2 {
        if stance.node_column[i] != NONE {
            let column = stance.node_column[i] as usize;
            rows.put_three(row, column, scale(stance.weights[i][0], by_force));
            rows.put_three(row, column + 3, scale(stance.weights[i][1], by_force));
        }
    }
    if stance.foothold_column != NONE {
        for d in 0..2 {
            rows.put(row, stance.foothold_column as usize + d, by_foot[d] + under.slope[d] * by_foot[2]);
        }
    }
}

/// Both derivatives of the position of a swinging foot, world frame.
#[inline(always)]
pub fn swing_motion<T: Real>(tables: &Tables<T>, x: &[T], ground: &[Ground<T>], swing: &SwingMotion<T>) -> [Vec3<T>; 2] {
    [0, 1].map(|order| {
        let (xy_weights, z_weights) = (swing.xy_weights[order], swing.z_weights[order]);
        add(foot_motion(tables, x, ground, swing.foothold, swing.height, xy_weights, z_weights), swing.offset[order])
    })
}

/// Writes the columns of footholds and swing height of a row.
///
/// * `by` - derivatives of the row with respect to both derivatives of the foot's position
#[inline(always)]
pub fn put_swing<T: Real>(rows: &mut Rows<T>, row: usize, swing: &SwingMotion<T>, ground: &[Ground<T>], by: [Vec3<T>; 2]) {
    for i in 0..2 {
        if swing.foothold_column[i] == NONE {
            continue;
        }
        let slope = ground[swing.foothold[i] as usize].slope;
        for d in 0..2 {
            let mut sum = T::zero();
            for order in 0..2 {
                sum += swing.xy_weights[order][i] * by[order][d] + swing.z_weights[order][i] * slope[d] * by[order][2];
            }
            rows.put(row, swing.foothold_column[i] as usize + d, sum);
        }
    }
    if swing.height_column != NONE {
        let rise = swing.z_weights[0][2] * by[0][2] + swing.z_weights[1][2] * by[1][2];
        rows.put(row, swing.height_column as usize, rise);
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
