//! Reach: each foot stays within slabs in the base frame, three at a time. The first three are a box.
//!
//! `v = N R' (foot - p) - center` with a normal per row of `N`, rows `v - half_width + margin <= 0` and `-v - half_width + margin <= 0`,
//! times the length scale. Source: \[3\].

use super::factored::{FactoredInstant, OwnColumns, POSE, POSE_BLOCKS};
use super::foot::foot_motion;
use super::math::{Mat3, Vec3, add, add_weighted, cross, euler, mul, mul_transposed, scale, sub};
use super::momentum::{Deviation, INNER_POINTS};
use super::table::NONE;
use super::write::Rows;
use super::{RowKind, Spec, Tables};
use crate::real::Real;
use crate::terrain::Ground;
use multiversion::multiversion;

/// Number of rows per foot, instant and group of slabs.
pub const ROWS: usize = 3;

/// Two-sided rows.
pub const SPEC: Spec = Spec { rows: ROWS, pairs: ROWS, kind: RowKind::Inequality, unit: "m" };

/// See [`super::Family::allowed`].
pub(super) use super::length_allowed as allowed;

/// Factored rows do not place entries of their own.
pub(super) use super::factored::place;

crate::table! {
    /// Base pose at one instant: the interpolated pose of [`FactoredInstant`](super::factored::FactoredInstant) relative to this one.
    pub struct ReachInstant<T> {
        /// Pose on the straight line from start to goal, m and rad.
        pub reference: [T; 6],
        /// Weights of [`Deviation::pose`] in the interval of the instant.
        pub deviation_weights: [T; INNER_POINTS],
    }

    /// Reach rows of one foot and three slabs.
    ///
    /// Its position is `xy = sum_i xy_weights[i] foothold_i`, `z = sum_i z_weights[i] height(foothold_i) + z_weights[2] swing_height`, with
    /// the footholds and the offset of its [`ReachLeg`] and the swing height of its own columns.
    pub struct ReachFoot<T> {
        /// Weights of the footholds before and after the swing.
        pub xy_weights: [T; 2],
        /// Weights of the heights of these footholds, and of the swing's mid node.
        pub z_weights: [T; 3],
        /// Index in [`Tables::reach_legs`].
        pub leg: u32,
    }

    /// Data that the reach rows of one foot and three slabs share within a phase.
    pub struct ReachLeg<T> {
        /// Middles of the slabs along their normals from the base, m.
        pub center: [T; 3],
        /// Half widths of the slabs, m.
        pub half_widths: [T; 3],
        /// Unit normals of the slabs, base frame.
        pub normals: [[T; 3]; 3],
        /// Indices of the footholds before and after the swing; the second is [`NONE`] in stance.
        pub foothold: [u32; 2],
        /// Constant part of the position, m; zero unless the swing had begun before the motion.
        pub offset: [T; 3],
    }
}

/// Reach rows of all feet at all reach instants.
///
/// The own columns of an element are those of the footholds before and after the swing, and of the swing height.
///
/// * `residual` - out, at each element's place: 3 upper sides, 3 lower sides
/// * `jacobian` - out, 3 rows at each element's place: the derivatives by the pose, then the own columns
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn reach<T: Real>(
    tables: &Tables<T>,
    x: &[T],
    ground: &[Ground<T>],
    deviations: &[Deviation<T>],
    residual: &mut [T],
    mut jacobian: Option<&mut [T]>,
) {
    let (constants, all) = (&tables.constants, &tables.reach_rows);
    let unit = constants.length_scale;
    for (instant, factored) in tables.reach_instants.iter().zip(&all.instants) {
        let pose = base_pose(tables, instant, factored, x, deviations);
        let base_w = [pose[0], pose[1], pose[2]];
        let (rot_wb, axes) = euler([pose[3], pose[4], pose[5]]);
        for number in factored.elements.range() {
            let foot = &tables.reach_feet[number];
            let (leg, place) = (&tables.reach_legs[foot.leg as usize], all.place(number));
            let own = &all.own[all.elements[number].own as usize];
            let height = if own.runs[2].len > 0 { own.runs[2].variable } else { NONE };
            let foot_w = foot_motion(tables, x, ground, leg.foothold, height, foot.xy_weights, foot.z_weights);
            let leg_w = sub(add(foot_w, leg.offset), base_w);
            let normals_w = rot_wb.map(|row| mul(&leg.normals, row));
            let away = sub(mul_transposed(&normals_w, leg_w), leg.center);
            let at = place.inequality as usize;
            for d in 0..3 {
                let room = leg.half_widths[d] - constants.length_margin;
                residual[at + d] = (away[d] - room) * unit;
                residual[at + 3 + d] = (-away[d] - room) * unit;
            }
            let Some(jacobian) = jacobian.as_deref_mut() else { continue };
            let mut rows = Rows::new(jacobian, &place);
            put_by_pose(unit, &normals_w, &axes, leg_w, &mut rows);
            put_by_foot(tables, foot, own, ground, &normals_w, &mut rows);
        }
    }
}

/// Base pose at an instant, with the deviation from the cubic between the knots if there is one.
#[inline(always)]
fn base_pose<T: Real>(
    tables: &Tables<T>,
    instant: &ReachInstant<T>,
    factored: &FactoredInstant<T>,
    x: &[T],
    deviations: &[Deviation<T>],
) -> [T; POSE] {
    let mut pose = instant.reference;
    let blocks = tables.reach_rows.blocks_of(factored);
    for i in 0..POSE_BLOCKS {
        add_weighted(&mut pose, factored.weights[i], &x[blocks.variable[i] as usize..]);
    }
    if let Some(deviation) = deviations.get(blocks.interval as usize) {
        for (w, deviation) in instant.deviation_weights.iter().zip(&deviation.pose) {
            add_weighted(&mut pose, *w, deviation);
        }
    }
    pose
}

/// Writes the derivatives with respect to the base pose: `-N R'` and `d(N R' leg)/d angle_i = N R' (leg x axis_i)`.
///
/// * `normals_w` - `R N'`: the normals in the world are its columns
/// * `leg_w` - vector from the base to the foot
#[inline(always)]
fn put_by_pose<T: Real>(unit: T, normals_w: &Mat3<T>, axes: &[Vec3<T>; 3], leg_w: Vec3<T>, rows: &mut Rows<T>) {
    let mut turns = *axes;
    for turn in &mut turns {
        *turn = scale(unit, mul_transposed(normals_w, cross(leg_w, *turn)));
    }
    let mut pose = [[T::zero(); POSE]; 3];
    for r in 0..3 {
        for d in 0..3 {
            pose[r][d] = -normals_w[d][r] * unit;
            pose[r][3 + d] = turns[d][r];
        }
    }
    for r in 0..3 {
        rows.put_first(r, &pose[r]);
    }
}

/// Writes the derivatives with respect to the footholds and the swing height of a foot.
#[inline(always)]
fn put_by_foot<T: Real>(
    tables: &Tables<T>,
    foot: &ReachFoot<T>,
    own: &OwnColumns,
    ground: &[Ground<T>],
    normals_w: &Mat3<T>,
    rows: &mut Rows<T>,
) {
    let (leg, unit) = (&tables.reach_legs[foot.leg as usize], tables.constants.length_scale);
    let [before, after, height] = own.runs;
    for (i, run) in [before, after].iter().enumerate().filter(|(_, run)| run.len > 0) {
        let c = run.column as usize;
        let slope = ground[leg.foothold[i] as usize].slope;
        for r in 0..3 {
            for d in 0..2 {
                rows.put(r, c + d, (foot.xy_weights[i] * normals_w[d][r] + foot.z_weights[i] * slope[d] * normals_w[2][r]) * unit);
            }
        }
    }
    if height.len > 0 {
        for r in 0..3 {
            rows.put(r, height.column as usize, foot.z_weights[2] * normals_w[2][r] * unit);
        }
    }
}
