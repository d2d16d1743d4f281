//! Ground under every foothold, used by several families.

use super::Tables;
use crate::real::Real;
use crate::terrain::Ground;

/// Height, slope and curvature under each foothold.
///
/// * `ground` - out, `[footholds]`
#[inline(always)]
pub fn ground<T: Real>(tables: &Tables<T>, x: &[T], ground: &mut [Ground<T>]) {
    for (&at, ground) in tables.footholds.iter().zip(ground) {
        let at = at as usize;
        *ground = tables.terrain.ground(x[at], x[at + 1]);
    }
}
