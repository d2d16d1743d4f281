//! Columns of elements and places of their rows, assigned once the variables have been ordered.

use super::sweep::{Block, Fronts};
use crate::rows::blocks::{BlockId, Seat, Use};
use crate::rows::table::{NONE, Place, Run};
use crate::rows::{RowCounts, RowKind, Spec};

/// Assigns columns to one element after another, and places to their rows.
pub(super) struct Columns<'a> {
    blocks: &'a [Block],
    positions: &'a [u32],
    fronts: &'a Fronts,
    /// Step of the last element.
    step: usize,
    /// Index of each variable in the front of that step.
    in_front: Vec<u32>,
    /// Blocks that have columns in the last element, by position in `x`.
    present: Vec<BlockColumns>,
    /// Number of columns of the last element.
    pub count: u32,
    /// First column of each block that has one, by its id; stale for the other blocks.
    of_block: Vec<u32>,
    /// Seats of the blocks that the last element uses.
    pub seats: Vec<Seat>,
    /// Place of the next rows.
    pub next: Next,
}

/// Place of the next rows.
pub(super) struct Next {
    /// Next row of each kind.
    row: [usize; 3],
    /// Next inequality; finally, the number of inequalities.
    pub inequality: usize,
    /// Offset of the next Jacobian values; finally, their number.
    pub jacobian: usize,
    /// Largest number of columns so far, padding included.
    pub widest: usize,
}

/// Columns of one block.
struct BlockColumns {
    id: BlockId,
    position: u32,
    len: u32,
    column: u32,
    front: u32,
}

impl<'a> Columns<'a> {
    /// State before the first element.
    ///
    /// * `counts` - numbers of the rows of all elements
    pub fn new(blocks: &'a [Block], positions: &'a [u32], fronts: &'a Fronts, counts: RowCounts) -> Self {
        let variables = blocks.iter().filter(|b| !b.fixed).map(|b| b.len).sum();
        let row = [RowKind::Equality, RowKind::Cost, RowKind::Inequality].map(|kind| counts.of(kind).start);
        Columns {
            blocks,
            positions,
            fronts,
            step: usize::MAX,
            in_front: vec![NONE; variables],
            present: Vec::new(),
            count: 0,
            of_block: vec![NONE; blocks.len()],
            seats: Vec::new(),
            next: Next { row, inequality: 0, jacobian: 0, widest: 0 },
        }
    }

    /// Assigns columns, after the first `others`, to the free blocks that an element of a step touches: each block once, in the order of
    /// `x`.
    pub fn assign(&mut self, step: usize, uses: &[Use], others: u32) {
        if self.step != step {
            self.step = step;
            self.fronts.write(step, &mut self.in_front);
        }
        let Columns { blocks, positions, in_front, .. } = self;
        let position = |id: BlockId| positions[id.0 as usize];
        self.present.clear();
        for used in uses {
            if let Use::Touches(id) = *used
                && let block = &blocks[id.0 as usize]
                && !block.fixed
            {
                let (position, len) = (position(id), block.len as u32);
                self.present.push(BlockColumns { id, position, len, column: 0, front: in_front[position as usize] });
            }
        }
        self.present.sort_unstable_by_key(|b| b.position);
        self.present.dedup_by_key(|b| b.id);
        self.count = others;
        for block in &mut self.present {
            block.column = self.count;
            self.of_block[block.id.0 as usize] = self.count;
            self.count += block.len;
        }
        let seat = |used: &Use| match used {
            Use::Nothing => Seat::NOTHING,
            Use::Touches(id) if !blocks[id.0 as usize].fixed => {
                let position = position(*id);
                Seat { position, column: self.of_block[id.0 as usize], front: in_front[position as usize] }
            }
            Use::Reads(id) | Use::Touches(id) => Seat { position: position(*id), ..Seat::NOTHING },
        };
        self.seats.clear();
        self.seats.extend(uses.iter().map(seat));
    }

    /// Columns of a block that the last element uses; a run of length 0 without columns.
    pub fn run(&self, role: usize, used: &Use) -> Run {
        let Seat { position, column, front } = self.seats[role];
        let len = match used {
            Use::Touches(id) if front != NONE => self.blocks[id.0 as usize].len as u32,
            _ => 0,
        };
        Run { variable: position, front, column, len }
    }

    /// Appends the columns as runs, each as long as possible.
    pub fn add_runs(&self, runs: &mut Vec<Run>) {
        let first = runs.len();
        for &BlockColumns { position, len, column, front, .. } in &self.present {
            match runs[first..].last_mut() {
                Some(last) if last.variable + last.len == position => last.len += len,
                _ => runs.push(Run { variable: position, front, column, len }),
            }
        }
    }

    /// Place of the rows of an element.
    ///
    /// * `columns` - number of its columns
    pub fn place(&mut self, spec: Spec, pairs: usize, columns: u32) -> Place {
        let next = &mut self.next;
        let stride = columns.next_multiple_of(8);
        let row = &mut next.row[spec.kind as usize];
        let place = Place { row: *row as u32, inequality: next.inequality as u32, jacobian: next.jacobian as u32, stride };
        *row += spec.rows;
        if spec.kind == RowKind::Inequality {
            next.inequality += spec.rows + pairs;
        }
        next.jacobian += spec.rows * stride as usize;
        next.widest = next.widest.max(stride as usize);
        place
    }

    /// Row and inequality at which the rows of the next element of a kind are placed.
    pub fn next_rows(&self, kind: RowKind) -> [u32; 2] {
        [self.next.row[kind as usize], self.next.inequality].map(|index| index as u32)
    }
}
