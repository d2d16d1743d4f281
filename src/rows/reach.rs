//! Reach boxes: each foot stays within a box in the base frame.
//!
//! `v = R' (foot - p) - center`, rows `v - half_width + margin <= 0` and `-v - half_width + margin <= 0`, times the length scale.
//! Source: \[3\].

use super::blocks::{Placed, Seat};
use super::math::{Mat3, Vec3, cross, euler, mul_transposed, scale, sub};
use super::momentum::{Deviation, INNER_POINTS};
use super::table::{NONE, Place, Run, Span};
use super::write::Rows;
use super::{RowKind, Spec, Tables};
use crate::real::Real;
use crate::terrain::Ground;
use multiversion::multiversion;

/// Three two-sided rows per foot and instant.
pub const SPEC: Spec = Spec { rows: 3, pairs: 3, kind: RowKind::Inequality, unit: "m" };

/// Number of columns for the base pose; they are the first columns of every foot.
pub(crate) const POSE: usize = 6;
/// Number of base blocks that determine the pose at an instant.
pub(crate) const POSE_BLOCKS: usize = 4;
/// Number of a foot's own columns: two per foothold, one of the swing height.
pub(crate) const OWN_COLUMNS: usize = 5;

/// See [`super::Family::allowed`].
pub(super) use super::length_allowed as allowed;

crate::table! {
    /// Base pose at one time: `reference + sum_i weights[i] x[variable[i]..][..6]`, with the variables of its [`BaseBlocks`].
    pub struct BasePoint<T> {
        /// Pose on the straight line from start to goal, m and rad.
        pub reference: [T; 6],
        /// Hermite or spline weights of the blocks.
        pub weights: [T; 4],
        /// Index in [`Tables::base_blocks`].
        pub blocks: u32,
        /// Weights of [`Deviation::pose`].
        pub deviation_weights: [T; INNER_POINTS],
    }

    /// Blocks that determine the base pose, shared by consecutive instants.
    #[derive(PartialEq, Eq)]
    pub struct BaseBlocks {
        /// Positions of the blocks in `x`.
        pub variable: [u32; 4],
        /// Indices of the blocks in the front; [`NONE`] for blocks that are fixed or have no weight.
        pub front: [u32; 4],
        /// `momentum`: interval whose deviation applies.
        pub interval: u32,
    }

    /// Reach rows at one instant.
    pub struct ReachInstant<T> {
        /// Base pose.
        pub base: BasePoint<T>,
        /// Feet, in `reach_feet`.
        pub feet: Span,
    }

    /// Reach rows of one foot.
    ///
    /// Its position is `xy = sum_i xy_weights[i] foothold_i`, `z = sum_i z_weights[i] height(foothold_i) + z_weights[2] swing_height`, with
    /// the footholds and the swing height of its [`ReachLeg`].
    pub struct ReachFoot<T> {
        /// Weights of the footholds before and after the swing.
        pub xy_weights: [T; 2],
        /// Weights of the heights of these footholds, and of the swing's mid node.
        pub z_weights: [T; 3],
        /// Index in [`Tables::reach_legs`].
        pub leg: u32,
        /// Offset in the Jacobian values, see [`Place::jacobian`]; [`Tables::reach_place`] computes the rest of the place.
        pub jacobian: u32,
        /// Distance between two rows in the Jacobian values, see [`Place::stride`].
        pub stride: u32,
    }

    /// Data that the reach rows of one foot share within a phase and a step of the sweep.
    pub struct ReachLeg<T> {
        /// Centre of the box in the base frame, m.
        pub center: [T; 3],
        /// Half widths of the box, m.
        pub half_widths: [T; 3],
        /// Indices of the footholds before and after the swing; the second is [`NONE`] in stance.
        pub foothold: [u32; 2],
        /// Position of the swing height in `x`, or [`NONE`] in stance.
        pub height: u32,
        /// Columns of the footholds.
        pub foothold_column: [u32; 2],
        /// Column of the swing height.
        pub height_column: u32,
        /// Indices of the footholds and of the swing height in the front.
        pub front: [u32; 3],
    }

    /// First indices of the reach rows. Each foot at each instant follows the one before.
    #[derive(Default, PartialEq, Eq)]
    pub struct ReachRows {
        /// First Jacobian row.
        pub row: u32,
        /// First inequality.
        pub inequality: u32,
    }
}

impl<T> Tables<T> {
    /// Place of the reach rows of a foot at an instant.
    ///
    /// * `number` - index in [`Tables::reach_feet`]
    #[inline(always)]
    pub fn reach_place(&self, number: usize) -> Place {
        let ReachFoot { jacobian, stride, .. } = self.reach_feet[number];
        let ReachRows { row, inequality } = self.reach_rows;
        let (rows, sides) = (SPEC.rows as u32, (SPEC.rows + SPEC.pairs) as u32);
        Place { row: row + rows * number as u32, inequality: inequality + sides * number as u32, jacobian, stride }
    }
}

impl<T> ReachLeg<T> {
    /// Columns of the free footholds and of the swing height.
    ///
    /// * `footholds` - see [`Tables::footholds`]
    pub fn own_runs(&self, footholds: &[u32]) -> impl Iterator<Item = Run> {
        (0..3).filter_map(|i| self.own_run(i, footholds))
    }

    /// One of these runs: of the foothold before (0) or after (1) the swing, or of the swing height (2). `None` if the block is absent or
    /// fixed.
    #[inline(always)]
    pub fn own_run(&self, i: usize, footholds: &[u32]) -> Option<Run> {
        let front = self.front[i];
        if front == NONE {
            None
        } else if i < 2 {
            Some(Run { variable: footholds[self.foothold[i] as usize], front, column: self.foothold_column[i], len: 2 })
        } else {
            Some(Run { variable: self.height, front, column: self.height_column, len: 1 })
        }
    }
}

impl BaseBlocks {
    /// Blocks at known seats.
    pub(crate) fn placed(seats: &[Seat], interval: u32) -> BaseBlocks {
        BaseBlocks { variable: std::array::from_fn(|i| seats[i].position), front: std::array::from_fn(|i| seats[i].front), interval }
    }
}

/// Writes positions and columns into a leg, whose index is `entry`. Roles: foothold before, foothold after, swing height. The base has
/// separate seats.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let leg = &mut tables.reach_legs[entry];
    leg.foothold_column = at.columns(0);
    leg.height_column = at.seats[2].column;
    leg.height = at.seats[2].position;
    leg.front = at.fronts(0);
}

/// Reach rows of all feet at all reach instants.
///
/// * `residual` - out, at each foot's place ([`Tables::reach_place`]): 3 upper sides, 3 lower sides
/// * `jacobian` - out, 3 rows at each foot's place: 6 columns for the base pose, from which those of the base blocks follow by their
///   weights, then the columns of footholds and swing height
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn reach<T: Real>(
    tables: &Tables<T>,
    x: &[T],
    ground: &[Ground<T>],
    deviations: &[Deviation<T>],
    residual: &mut [T],
    mut jacobian: Option<&mut [T]>,
) {
    let constants = &tables.constants;
    let unit = constants.length_scale;
    for instant in &tables.reach_instants {
        let pose = base_pose(tables, instant, x, deviations);
        let base_w = [pose[0], pose[1], pose[2]];
        let (rot_wb, axes) = euler([pose[3], pose[4], pose[5]]);
        for number in instant.feet.range() {
            let foot = &tables.reach_feet[number];
            let (leg, place) = (&tables.reach_legs[foot.leg as usize], tables.reach_place(number));
            let leg_w = sub(foot_position(tables, foot, x, ground), base_w);
            let offset_b = sub(mul_transposed(&rot_wb, leg_w), leg.center);
            let at = place.inequality as usize;
            for d in 0..3 {
                let room = leg.half_widths[d] - constants.length_margin;
                residual[at + d] = (offset_b[d] - room) * unit;
                residual[at + 3 + d] = (-offset_b[d] - room) * unit;
            }
            let Some(jacobian) = jacobian.as_deref_mut() else { continue };
            let mut rows = Rows::new(jacobian, &place);
            put_by_pose(unit, &rot_wb, &axes, leg_w, &mut rows);
            put_by_foot(tables, foot, ground, &rot_wb, &mut rows);
        }
    }
}

/// Base pose at an instant, with the deviation from the cubic between the knots if there is one.
#[inline(always)]
fn base_pose<T: Real>(tables: &Tables<T>, instant: &ReachInstant<T>, x: &[T], deviations: &[Deviation<T>]) -> [T; 6] {
    let mut pose = instant.base.reference;
    let blocks = &tables.base_blocks[instant.base.blocks as usize];
    for i in 0..4 {
        let at = blocks.variable[i] as usize;
        for d in 0..6 {
            pose[d] += instant.base.weights[i] * x[at + d];
        }
    }
    if let Some(deviation) = deviations.get(blocks.interval as usize) {
        for (w, deviation) in instant.base.deviation_weights.iter().zip(&deviation.pose) {
            for d in 0..6 {
                pose[d] += *w * deviation[d];
            }
        }
    }
    pose
}

/// Position of a foot, world frame.
#[inline(always)]
fn foot_position<T: Real>(tables: &Tables<T>, foot: &ReachFoot<T>, x: &[T], ground: &[Ground<T>]) -> Vec3<T> {
    let leg = &tables.reach_legs[foot.leg as usize];
    let mut foot_w = [T::zero(); 3];
    for i in 0..2 {
        if leg.foothold[i] == NONE {
            continue;
        }
        let at = tables.footholds[leg.foothold[i] as usize] as usize;
        foot_w[0] += foot.xy_weights[i] * x[at];
        foot_w[1] += foot.xy_weights[i] * x[at + 1];
        foot_w[2] += foot.z_weights[i] * ground[leg.foothold[i] as usize].height;
    }
    if leg.height != NONE {
        foot_w[2] += foot.z_weights[2] * x[leg.height as usize];
    }
    foot_w
}

/// Writes the derivatives with respect to the base pose: `-R'` and `d(R' leg)/d angle_i = R' (leg x axis_i)`.
///
/// * `leg_w` - vector from the base to the foot
#[inline(always)]
fn put_by_pose<T: Real>(unit: T, rot_wb: &Mat3<T>, axes: &[Vec3<T>; 3], leg_w: Vec3<T>, rows: &mut Rows<T>) {
    let mut turns = *axes;
    for turn in &mut turns {
        *turn = scale(unit, mul_transposed(rot_wb, cross(leg_w, *turn)));
    }
    let mut pose = [[T::zero(); POSE]; 3];
    for r in 0..3 {
        for d in 0..3 {
            pose[r][d] = -rot_wb[d][r] * unit;
            pose[r][3 + d] = turns[d][r];
        }
    }
    for r in 0..3 {
        rows.put_first(r, &pose[r]);
    }
}

/// Writes the derivatives with respect to the footholds and the swing height of a foot.
#[inline(always)]
fn put_by_foot<T: Real>(tables: &Tables<T>, foot: &ReachFoot<T>, ground: &[Ground<T>], rot_wb: &Mat3<T>, rows: &mut Rows<T>) {
    let (leg, unit) = (&tables.reach_legs[foot.leg as usize], tables.constants.length_scale);
    for i in 0..2 {
        if leg.foothold[i] == NONE || leg.foothold_column[i] == NONE {
            continue;
        }
        let c = leg.foothold_column[i] as usize;
        let slope = ground[leg.foothold[i] as usize].slope;
        for r in 0..3 {
            for d in 0..2 {
                rows.put(r, c + d, (foot.xy_weights[i] * rot_wb[d][r] + foot.z_weights[i] * slope[d] * rot_wb[2][r]) * unit);
            }
        }
    }
    if leg.height != NONE {
        for r in 0..3 {
            rows.put(r, leg.height_column as usize, foot.z_weights[2] * rot_wb[2][r] * unit);
        }
    }
}
