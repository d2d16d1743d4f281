//! Factored rows: rows that depend on the base only through its pose at an instant.
//!
//! The pose at an instant is interpolated from four blocks of six variables, `pose = reference + sum_i w_i x_i`. The Jacobian of such rows
//! with respect to block `i` is therefore `w_i P`: an interpolation weight times a small dense factor `P`, the derivatives of the rows by
//! the pose. Only `P` is stored, six columns instead of 24, and all elements at an instant share its weights. The other columns of an
//! element, those of at most [`OWN_BLOCKS`] other blocks, are stored as they are, after `P`.
//!
//! [`FactoredRows`] holds these tables for one family and knows everything about their columns. The family's own tables have an entry per
//! instant and per element, with the same indices, and contain the data of its residuals. `nlp/factored.rs` fills the tables,
//! `linear/factored.rs` multiplies and assembles the rows, `shaders/shared/factored.wgsl` reads them. Rows that also depend on the rate of
//! the base have a second factor and a second set of weights, which would be stored in the same way.

use super::table::{NONE, Place, Run, Span};
use super::{Family, Placed, Spec, Tables};
use crate::real::Real;

/// Number of columns of the factor `P`: position and Euler angles of the base.
pub const POSE: usize = 6;

/// Number of blocks from which the pose is interpolated.
pub const POSE_BLOCKS: usize = 4;

/// Largest number of other blocks on which an element depends.
pub const OWN_BLOCKS: usize = 3;

/// Largest number of columns of these blocks: two per block, but one of the last.
pub const OWN_COLUMNS: usize = 2 * OWN_BLOCKS - 1;

crate::table! {
    /// Elements at one instant.
    pub struct FactoredInstant<T> {
        /// Interpolation weights of the base blocks.
        pub weights: [T; POSE_BLOCKS],
        /// Index in [`FactoredRows::base_blocks`].
        pub blocks: u32,
        /// Elements, in [`FactoredRows::elements`].
        pub elements: Span,
    }

    /// One element.
    pub struct FactoredElement {
        /// Index in [`FactoredRows::own`].
        pub own: u32,
        /// Offset in the Jacobian values, see [`Place::jacobian`]; [`FactoredRows::place`] computes the rest of the place.
        pub jacobian: u32,
        /// Distance between two rows in the Jacobian values, see [`Place::stride`].
        pub stride: u32,
    }

    /// Base blocks that consecutive instants share.
    #[derive(PartialEq, Eq)]
    pub struct BaseBlocks {
        /// Positions of the blocks in `x`.
        pub variable: [u32; POSE_BLOCKS],
        /// Indices of the blocks in the front; [`NONE`] for blocks that are fixed or have no weight.
        pub front: [u32; POSE_BLOCKS],
        /// `momentum`: interval of the base that contains the instants.
        pub interval: u32,
    }

    /// Own columns that elements of the same step of the sweep share.
    pub struct OwnColumns {
        /// Columns of each block, in the order of the family's roles. Blocks that are absent or fixed have no columns: their length is 0 and
        /// their index in the front is [`NONE`].
        pub runs: [Run; OWN_BLOCKS],
    }

    /// Elements at consecutive instants that depend on a block of variables in the same columns: those with the same own columns, or, if
    /// the block is one of the base, all of them.
    #[derive(Default, PartialEq)]
    pub struct FactoredTouch {
        /// Instants.
        pub instants: Span,
        /// Own columns of the elements; [`NONE`] for a block of the base.
        pub own: u32,
        /// Index among the base blocks, which selects the weight; [`NONE`] for other blocks.
        pub block: u32,
        /// Column of the first variable of the block.
        pub column: u32,
    }

    /// First indices of the rows. The rows of each element follow those of the element before.
    #[derive(Default, PartialEq, Eq)]
    pub struct FirstRows {
        /// First Jacobian row.
        pub row: u32,
        /// First inequality.
        pub inequality: u32,
    }
}

/// Tables of the factored rows of one family, whose elements have `R` rows.
#[derive(Debug, Clone)]
pub struct FactoredRows<T, const R: usize> {
    /// Family of the rows.
    pub family: Family,
    /// Specification of the family.
    pub spec: Spec,
    /// First indices of the rows.
    pub first: FirstRows,
    /// Instants, in the order of time.
    pub instants: Vec<FactoredInstant<T>>,
    /// Elements, by instant.
    pub elements: Vec<FactoredElement>,
    /// Own columns of the elements.
    pub own: Vec<OwnColumns>,
    /// Base blocks of the instants.
    pub base_blocks: Vec<BaseBlocks>,
    /// Instants of each step of the sweep.
    pub steps: Vec<Span>,
}

impl OwnColumns {
    /// Runs of the blocks that have columns.
    pub fn present(&self) -> impl Iterator<Item = Run> {
        self.runs.into_iter().filter(|run| run.front != NONE)
    }
}

impl BaseBlocks {
    /// Blocks that have columns: index of each, and its variables by the columns of `P`.
    #[inline(always)]
    pub fn present(&self) -> impl Iterator<Item = (usize, Run)> {
        let BaseBlocks { variable, front, .. } = *self;
        let run = move |i: usize| Run { variable: variable[i], front: front[i], column: 0, len: POSE as u32 };
        (0..POSE_BLOCKS).filter(move |&i| front[i] != NONE).map(move |i| (i, run(i)))
    }
}

impl<T: Real, const R: usize> FactoredRows<T, R> {
    /// Empty tables of a family.
    pub fn new(family: Family) -> Self {
        FactoredRows {
            family,
            spec: family.spec(),
            first: FirstRows::default(),
            instants: Vec::new(),
            elements: Vec::new(),
            own: Vec::new(),
            base_blocks: Vec::new(),
            steps: Vec::new(),
        }
    }

    /// Place of an element's rows.
    ///
    /// * `number` - index in [`FactoredRows::elements`]
    #[inline(always)]
    pub fn place(&self, number: usize) -> Place {
        let FactoredElement { jacobian, stride, .. } = self.elements[number];
        let FirstRows { row, inequality } = self.first;
        let (rows, sides) = (R as u32, (R + self.spec.pairs) as u32);
        Place { row: row + rows * number as u32, inequality: inequality + sides * number as u32, jacobian, stride }
    }

    /// Base blocks of an instant.
    #[inline(always)]
    pub fn blocks_of(&self, instant: &FactoredInstant<T>) -> &BaseBlocks {
        &self.base_blocks[instant.blocks as usize]
    }

    /// Dependencies of each element's rows: columns as runs of variables, with the weight by which the Jacobian values apply to these
    /// variables.
    pub fn columns(&self) -> impl Iterator<Item = Vec<(Run, T)>> {
        self.instants.iter().flat_map(|instant| {
            self.elements[instant.elements.range()].iter().map(|element| {
                let base = self.blocks_of(instant).present().map(|(i, run)| (run, instant.weights[i]));
                let own = self.own[element.own as usize].present().map(|run| (run, T::one()));
                let mut all: Vec<(Run, T)> = base.chain(own).collect();
                all.sort_by_key(|(run, _)| run.column);
                all
            })
        })
    }

    /// Runs of variables that the rows touch, with the instants and columns at which they do: first those of the base.
    #[cfg(feature = "gpu")]
    pub fn touched(&self) -> Vec<(Run, FactoredTouch)> {
        let mut of_own = vec![Span::default(); self.own.len()];
        let mut of_blocks = vec![Span::default(); self.base_blocks.len()];
        for (i, instant) in (0..).zip(&self.instants) {
            let with = |span: Span| Span { start: if span.end == 0 { i } else { span.start }, end: i + 1 };
            let of_block = &mut of_blocks[instant.blocks as usize];
            *of_block = with(*of_block);
            for element in &self.elements[instant.elements.range()] {
                let of_own = &mut of_own[element.own as usize];
                *of_own = with(*of_own);
            }
        }
        let mut touched = Vec::new();
        for (blocks, &instants) in self.base_blocks.iter().zip(&of_blocks) {
            let touch = |block: usize| FactoredTouch { instants, own: NONE, block: block as u32, column: 0 };
            touched.extend(blocks.present().map(|(block, run)| (run, touch(block))));
        }
        for (number, (own, &instants)) in (0..).zip(self.own.iter().zip(&of_own)) {
            touched.extend(own.present().map(|run| (run, FactoredTouch { instants, own: number, block: NONE, column: run.column })));
        }
        touched
    }
}

/// Does nothing: `nlp/factored.rs` places factored rows, whose tables have no entries with a place of their own.
pub(super) fn place<T: Real>(_: &mut Tables<T>, _: usize, _: &Placed) {}
