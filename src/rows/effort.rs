//! Effort of the forces as cost rows: the integral of `|f|^2` over a stance is a quadratic form in the force nodes.
//!
//! `M` is the Gram matrix of the Hermite basis over the pieces of a stance. With its Cholesky factor `M = U'U`, half of `|U y|^2` is the
//! cost of one axis, where `y` holds values and slopes of the free nodes. `M` is block tridiagonal, so two rows of `U` touch one node and
//! the next.

use super::blocks::Placed;
use super::table::{NONE, Place};
use super::write::Rows;
use super::{RowKind, Spec, Tables};
use crate::real::Real;

/// Two rows per axis.
pub const SPEC: Spec = Spec { rows: 6, pairs: 0, kind: RowKind::Cost, unit: "" };

/// See [`super::Family::allowed`].
pub(super) use super::any_residual as allowed;

crate::table! {
    /// Effort rows of one force node.
    pub struct Effort<T> {
        /// Two rows of the Cholesky factor: columns of value and slope of the node, value and slope of the next node.
        pub factor: [[T; 4]; 2],
        /// Positions of the node and the next one in `x`; [`NONE`] if there is no next one.
        pub node: [u32; 2],
        /// First columns of the node and the next one.
        pub column: [u32; 2],
        /// Place of the rows.
        pub place: Place,
    }
}

/// Roles: the node, the next node.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let effort = &mut tables.efforts[entry];
    effort.place = at.place;
    effort.node = at.positions(0);
    effort.column = at.columns(0);
}

/// Effort rows of all force nodes.
///
/// * `residual` - out, by row: both rows of x, of y, of z
/// * `jacobian` - out, six rows at each place
#[inline(always)]
pub fn effort<T: Real>(tables: &Tables<T>, x: &[T], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    for effort in &tables.efforts {
        let at = effort.place.row as usize;
        for d in 0..3 {
            for r in 0..2 {
                let mut sum = T::zero();
                for i in 0..2 {
                    if effort.node[i] != NONE {
                        let node = effort.node[i] as usize + d;
                        sum += effort.factor[r][2 * i] * x[node] + effort.factor[r][2 * i + 1] * x[node + 3];
                    }
                }
                residual[at + 2 * d + r] = sum;
            }
        }
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &effort.place);
        for i in 0..2 {
            if effort.column[i] == NONE {
                continue;
            }
            let column = effort.column[i] as usize;
            for d in 0..3 {
                for r in 0..2 {
                    rows.put(2 * d + r, column + d, effort.factor[r][2 * i]);
                    rows.put(2 * d + r, column + 3 + d, effort.factor[r][2 * i + 1]);
                }
            }
        }
    }
}
