//! Rows that make a stride of the motion repeat.

use super::builder::Builder;
use crate::real::Real;
use crate::rows::Family;
use crate::rows::blocks::{BlockId, Use};
use crate::rows::periodic::Periodic;
use crate::rows::table::{NONE, Place};

/// Adds the rows of the periodic stride of the task, if it has one: they link pose and rates of the base at both ends, the footholds that
/// each foot uses there, and the heights of its swings there.
///
/// The forces of a stance during which the stride begins are not linked to those a stride later. They may jump there.
pub(super) fn rows<T: Real>(b: &mut Builder<T>) {
    let Some(stride) = b.task.stride else { return };
    let (start, end) = (stride.start, stride.start + stride.intervals);
    let moved = stride.displacement;
    // The base blocks are deviations from the reference line.
    let (line, duration) = (b.reference_rate(), stride.intervals as f64 * b.interval);
    let by: [f64; 6] = std::array::from_fn(|i| moved.get(i).copied().unwrap_or_default() - line[i] * duration);
    link(b, [2 * start, 2 * end].map(|block| b.base[block]), &by);
    link(b, [2 * start + 1, 2 * end + 1].map(|block| b.base[block]), &[0.; 6]);
    for foot in 0..b.feet.len() {
        let blocks = &b.feet[foot];
        let phase = stride.first_phase(blocks.phases.iter().map(|p| p.end), b.interval);
        let (stance, swings) = (phase / 2, phase % 2 == 1);
        let footholds: Vec<BlockId> = blocks.footholds[stance..].iter().map(|f| f.block).collect();
        let heights = swings.then(|| [blocks.heights[stance], blocks.heights[stance + 1]]);
        for pair in footholds.windows(2).take(1 + usize::from(swings)) {
            link(b, [pair[0], pair[1]], &moved[..2]);
        }
        if let Some(heights) = heights {
            link(b, heights, &moved[2..]);
        }
    }
}

/// Adds the rows of two blocks whose difference is given.
fn link<T: Real>(b: &mut Builder<T>, blocks: [BlockId; 2], difference: &[f64]) {
    // As late as the block at the end comes into the sweep.
    let step = b.step_within(0., blocks[1]);
    for (component, by) in difference.iter().enumerate() {
        b.tables.periodics.push(Periodic {
            difference: T::of(*by),
            component: component as u32,
            variable: [NONE; 2],
            column: [NONE; 2],
            place: Place::default(),
        });
        b.element(Family::Periodic, b.tables.periodics.len() - 1, step, &blocks.map(Use::Touches));
    }
}
