//! Symbolic analysis of the frontal factorisation: a sort by the time of each variable's last row.
//!
//! The sweep visits the instants in order. The front of a step contains the variables that have a row at or before the step and one at or
//! after it; its pivots are the variables whose last row is at the step. Variables are numbered in that order, so the pivots of a step are
//! consecutive and come first in a front sorted by variable.

use crate::rows::blocks::Use;
use crate::rows::table::{Run, Span};

/// One step of the sweep.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct Step {
    /// Size of the front.
    pub size: u32,
    /// Number of pivots: the first variables of the front, which are eliminated in this step.
    pub pivots: u32,
    /// Index of the first pivot in `x`.
    pub variable: u32,
    /// Offset of the pivot rows in the factor, `[pivots][stride]`; the right-hand side is in column `size`.
    pub factor: u32,
    /// Distance between two pivot rows in the factor.
    pub stride: u32,
    /// Elements assembled in this step, except factored ones, see [`FactoredRows::steps`](crate::rows::factored::FactoredRows::steps).
    pub elements: Span,
    /// Part of the previous front that is carried over: runs from index `column` there to index `front` here.
    pub moves: Span,
    /// Variables that remain in the front after its pivots, as runs.
    pub rest: Span,
}

/// Block that has no position in `x` yet.
pub(super) struct Block {
    pub initial: [f64; 6],
    /// Number of variables; only the first `len` entries of the arrays are used.
    pub len: usize,
    /// Weights that attract the variables to their initial values.
    pub smoothing: [f64; 6],
    pub fixed: bool,
    /// First step of the sweep that touches the block.
    pub first: usize,
    /// Last step of the sweep that touches the block.
    pub last: usize,
}

/// Result of the symbolic analysis.
pub(super) struct Fronts {
    pub steps: Vec<Step>,
    pub runs: Vec<Run>,
    pub stride: usize,
    pub factor_len: usize,
    /// Contents of each step's front, as runs.
    contents: Vec<Vec<Run>>,
}

impl Fronts {
    /// Writes the index in a step's front of each of its variables.
    pub fn write(&self, step: usize, in_front: &mut [u32]) {
        for run in &self.contents[step] {
            for i in 0..run.len {
                in_front[(run.variable + i) as usize] = run.front + i;
            }
        }
    }
}

/// Extends the lives of the free blocks that rows touch to the step of the rows.
pub(super) fn touch(blocks: &mut [Block], step: usize, uses: &[Use]) {
    for used in uses {
        if let Use::Touches(id) = used
            && let block = &mut blocks[id.0 as usize]
            && !block.fixed
        {
            block.first = block.first.min(step);
            block.last = block.last.max(step);
        }
    }
}

/// Completes the spans of consecutive steps, of which only the ends of those with entries are known: the others become empty, in order.
pub(super) fn close<'a>(spans: impl Iterator<Item = &'a mut Span>) {
    let mut end = 0;
    for span in spans {
        *span = Span { start: end, end: span.end.max(end) };
        end = span.end;
    }
}

/// Position of every block in `x`: free blocks by their last step, then their first, then fixed blocks.
pub(super) fn order(blocks: &[Block]) -> Vec<u32> {
    let mut ids: Vec<usize> = (0..blocks.len()).collect();
    ids.sort_by_key(|&i| (blocks[i].fixed, blocks[i].last, std::cmp::Reverse(blocks[i].first), i));
    let mut positions = vec![0; blocks.len()];
    let mut next = 0;
    for id in ids {
        positions[id] = next;
        next += blocks[id].len as u32;
    }
    positions
}

/// Computes the fronts of all steps.
pub(super) fn fronts(blocks: &[Block], positions: &[u32], steps: usize) -> Fronts {
    let mut free: Vec<usize> = (0..blocks.len()).filter(|&i| !blocks[i].fixed).collect();
    free.sort_by_key(|&i| positions[i]);
    let mut result =
        Fronts { steps: Vec::with_capacity(steps), runs: Vec::new(), stride: 0, factor_len: 0, contents: Vec::with_capacity(steps) };
    let mut first_free = 0;
    // Indices into `free`: blocks in the front of the current step, and later blocks in the order of their first step.
    let mut alive: Vec<usize> = Vec::new();
    let mut ahead: Vec<usize> = (0..free.len()).collect();
    ahead.sort_by_key(|&i| blocks[free[i]].first);
    let mut ahead = ahead.into_iter().peekable();
    for k in 0..steps {
        while first_free < free.len() && blocks[free[first_free]].last < k {
            first_free += 1;
        }
        let mut contents: Vec<Run> = Vec::new();
        let (mut size, mut pivots) = (0u32, 0u32);
        let variable = free.get(first_free).map_or(0, |&i| positions[i]);
        alive.retain(|&i| i >= first_free);
        while let Some(i) = ahead.next_if(|&i| blocks[free[i]].first <= k) {
            alive.push(i);
        }
        alive.sort_unstable();
        for &i in &alive {
            let (block, at) = (&blocks[free[i]], positions[free[i]]);
            let len = block.len as u32;
            push_run(&mut contents, 0, Run { variable: at, front: size, column: 0, len });
            size += len;
            if block.last == k {
                pivots += len;
            }
        }
        let first_move = result.runs.len();
        if let Some(previous) = result.contents.last() {
            let gone = result.steps[k - 1].pivots;
            for old in previous {
                let skip = gone.saturating_sub(old.front).min(old.len);
                // A run of the old front is one run of the new front, or several if new variables came between.
                let mut from = skip;
                while from < old.len {
                    let variable = old.variable + from;
                    let at = contents.partition_point(|r| r.variable <= variable) - 1;
                    let new = contents[at];
                    let len = (old.len - from).min(new.variable + new.len - variable);
                    let run = Run { variable, front: new.front + variable - new.variable, column: old.front + from, len };
                    // Between two runs there may be variables that belong to neither front, so `variable` need not be consecutive.
                    match result.runs[first_move..].last_mut() {
                        Some(last) if last.front + last.len == run.front && last.column + last.len == run.column => last.len += len,
                        _ => result.runs.push(run),
                    }
                    from += len;
                }
            }
        }
        let first_rest = result.runs.len();
        for run in &contents {
            let skip = pivots.saturating_sub(run.front).min(run.len);
            if skip < run.len {
                result.runs.push(Run { variable: run.variable + skip, front: run.front + skip, column: 0, len: run.len - skip });
            }
        }
        let stride = (size + 1).next_multiple_of(8);
        result.steps.push(Step {
            size,
            pivots,
            variable,
            factor: result.factor_len as u32,
            stride,
            elements: Span::default(),
            moves: Span { start: first_move as u32, end: first_rest as u32 },
            rest: Span { start: first_rest as u32, end: result.runs.len() as u32 },
        });
        result.factor_len += (pivots * stride) as usize;
        result.stride = result.stride.max((size as usize + 1).next_multiple_of(16));
        result.contents.push(contents);
    }
    result
}

/// Appends a run, or extends the last one (from index `from` on) if the variables are consecutive.
fn push_run(runs: &mut Vec<Run>, from: usize, run: Run) {
    match runs[from..].last_mut() {
        Some(last) if last.variable + last.len == run.variable => last.len += run.len,
        _ => runs.push(run),
    }
}
