//! Blocks of variables by their ids, and their positions once all blocks are known.
//!
//! While a problem is built, blocks have ids, and tables hold [`NONE`] instead of positions and columns. An element lists the blocks that
//! its rows use, in the order of its family's roles. Once the variables are ordered, the family's `place` function receives the same roles
//! as [`Seat`]s and writes positions and columns into its tables.

use super::table::{NONE, Place};

/// A block of variables before it has its position in `x`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct BlockId(pub(crate) u32);

/// Index and block of a foothold.
#[derive(Debug, Clone, Copy)]
pub struct Foothold {
    /// Index of the foothold in [`super::Tables::footholds`].
    pub index: u32,
    /// Block of its two variables.
    pub block: BlockId,
}

/// Use of a block by the rows of an element.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Use {
    /// No block in this role.
    Nothing,
    /// The rows read the block but do not depend on it, because its weight is zero.
    Reads(BlockId),
    /// The rows depend on the block; unless it is fixed they have columns for it.
    Touches(BlockId),
}

/// Position and columns of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seat {
    /// Position in `x`; [`NONE`] without a block.
    pub position: u32,
    /// First column in the element; [`NONE`] if it has no columns.
    pub column: u32,
    /// Index of the first column in the front; [`NONE`] if it has no columns.
    pub front: u32,
}

impl Seat {
    /// Seat of an absent block.
    pub const NOTHING: Seat = Seat { position: NONE, column: NONE, front: NONE };
}

/// Place of an element's rows, and the seats of its blocks in the order of its roles.
#[derive(Debug)]
pub struct Placed<'a> {
    /// Place of the rows in the buffers.
    pub place: Place,
    /// Seats of the blocks.
    pub seats: &'a [Seat],
}

impl Placed<'_> {
    /// Positions in `x` of `N` roles, starting at role `first`.
    pub fn positions<const N: usize>(&self, first: usize) -> [u32; N] {
        std::array::from_fn(|i| self.seats[first + i].position)
    }

    /// Columns of `N` roles, starting at role `first`.
    pub fn columns<const N: usize>(&self, first: usize) -> [u32; N] {
        std::array::from_fn(|i| self.seats[first + i].column)
    }

    /// Indices in the front of `N` roles, starting at role `first`.
    pub fn fronts<const N: usize>(&self, first: usize) -> [u32; N] {
        std::array::from_fn(|i| self.seats[first + i].front)
    }
}
