//! Ground under every foothold, shared by the other kernels.

use crate::nlp::{Layout, Real};
use crate::terrain::Ground;

/// Height, slope and curvature under each foothold.
///
/// * `ground` - out, `[footholds]`
#[inline(always)]
pub fn footholds<T: Real>(layout: &Layout<T>, x: &[T], ground: &mut [Ground<T>]) {
    for (&at, ground) in layout.footholds.iter().zip(ground) {
        let at = at as usize;
        *ground = layout.terrain.ground(x[at], x[at + 1]);
    }
}
