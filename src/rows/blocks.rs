//! Blocks of variables by their ids, and where they come to stand once all are known.
//!
//! While a layout is built, blocks have ids and tables hold [`NONE`] in their place. An element says in which roles its rows use blocks; once
//! variables are ordered, each family's `place` gets the same roles back as [`Seat`]s and writes positions and columns into its tables.

use super::table::{NONE, Place};

/// A block of variables before it has its position in `x`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct BlockId(pub(crate) u32);

/// A foothold: its index among all, and its block.
#[derive(Debug, Clone, Copy)]
pub struct Foothold {
    /// Index in [`super::Tables::footholds`].
    pub index: u32,
    /// Its two variables.
    pub block: BlockId,
}

/// How the rows of an element use a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Use {
    /// There is no such block here.
    Nothing,
    /// They read it but do not depend on it: its weight is zero.
    Reads(BlockId),
    /// They depend on it; where it is not fixed they have columns for it.
    Touches(BlockId),
}

/// Where a block stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seat {
    /// In `x`; [`NONE`] without a block.
    pub position: u32,
    /// First column in the element; [`NONE`] where it has none.
    pub column: u32,
    /// Index of that column in the front; [`NONE`] likewise.
    pub front: u32,
}

impl Seat {
    /// Without a block.
    pub const NOTHING: Seat = Seat { position: NONE, column: NONE, front: NONE };
}

/// Where the rows of an element and the blocks that it uses stand, in the order of its roles.
#[derive(Debug)]
pub struct Placed<'a> {
    /// Its rows.
    pub place: Place,
    /// Its blocks.
    pub seats: &'a [Seat],
}

impl Placed<'_> {
    /// Positions of the roles from `first` on.
    pub fn positions<const N: usize>(&self, first: usize) -> [u32; N] {
        std::array::from_fn(|i| self.seats[first + i].position)
    }

    /// Columns of the roles from `first` on.
    pub fn columns<const N: usize>(&self, first: usize) -> [u32; N] {
        std::array::from_fn(|i| self.seats[first + i].column)
    }

    /// Indices in the front of the roles from `first` on.
    pub fn fronts<const N: usize>(&self, first: usize) -> [u32; N] {
        std::array::from_fn(|i| self.seats[first + i].front)
    }
}
