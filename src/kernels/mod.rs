//! The numerical kernels: plain loops over flat buffers and the index tables of a [`Layout`], without allocation.
//!
//! One file a kernel; those in [`shaders::SHADERS`] have a WGSL shader of the same name. No kernel uses fused multiply-add, and every sum
//! has a fixed order, so results do not depend on the processor's vector width.

pub mod advance;
pub mod batch;
pub mod control;
pub mod dynamics;
pub mod foothold;
pub mod force;
pub mod forward;
pub mod front;
pub mod judge;
pub mod math;
pub mod momentum;
pub mod product;
pub mod reach;
pub mod rows;
pub mod shaders;
pub mod slacks;
pub mod start;
pub mod substitute;
pub mod swing;
pub mod transposed;

use crate::nlp::layout::{Deviation, Place};
use crate::nlp::{Layout, Real};
use crate::terrain::Ground;

/// Jacobian rows of one element.
struct Rows<'a, T> {
    values: &'a mut [T],
    stride: usize,
}

impl<'a, T> Rows<'a, T> {
    #[inline(always)]
    fn new(jacobian: &'a mut [T], place: &Place) -> Self {
        Rows { values: &mut jacobian[place.jacobian as usize..], stride: place.stride as usize }
    }

    #[inline(always)]
    fn put(&mut self, row: usize, column: usize, value: T) {
        self.values[row * self.stride + column] = value;
    }

    /// Values behind the last of `rows` rows.
    #[inline(always)]
    fn put_after<const R: usize, const C: usize>(&mut self, rows: usize, values: &[[T; C]; R])
    where
        T: Copy,
    {
        for (target, row) in self.values[rows * self.stride..].chunks_exact_mut(C).zip(values) {
            target.copy_from_slice(row);
        }
    }
}

/// What the rows of a candidate share at one `x`.
#[derive(Debug, Clone)]
pub struct Shared<T> {
    /// Ground under the footholds, `[footholds]`.
    pub ground: Vec<Ground<T>>,
    /// How the base deviates from its cubic inside intervals, `[intervals]`.
    pub deviations: Vec<Deviation<T>>,
    /// Whether the deviations stay as they are, as the derivatives of the rows take them.
    pub frozen: bool,
}

impl<T: Real> Default for Shared<T> {
    fn default() -> Self {
        Shared { ground: Vec::new(), deviations: Vec::new(), frozen: false }
    }
}

impl<T: Real> Shared<T> {
    /// Makes room for a layout.
    pub fn resize(&mut self, layout: &Layout<T>) {
        self.ground.resize(layout.footholds.len(), Ground::level(T::zero()));
        self.deviations.resize(layout.momentum.len(), Deviation::default());
    }
}

/// Residuals (and, when asked for, Jacobian values) of all elements at `x`.
///
/// * `edge_radius` - over which edges of the terrain are rounded for the force rows, m; 0 for the exact rows
/// * `shared` - what rows share
/// * `equality` - out, `c`, `[equalities]`, dimensionless; zero when it holds
/// * `inequality` - out, `g`, `[inequalities]`, dimensionless; holds when `g <= 0`
/// * `jacobian` - out, values of every element, `[rows][stride]`
#[inline(always)]
pub fn evaluate<T: Real>(
    layout: &Layout<T>,
    x: &[T],
    edge_radius: T,
    shared: &mut Shared<T>,
    equality: &mut [T],
    inequality: &mut [T],
    mut jacobian: Option<&mut [T]>,
) {
    let Shared { ground, deviations, frozen } = shared;
    foothold::footholds(layout, x, ground);
    dynamics::dynamics(layout, x, ground, equality, jacobian.as_deref_mut());
    momentum::momentum(layout, x, ground, deviations, *frozen, equality, jacobian.as_deref_mut());
    reach::reach(layout, x, ground, deviations, inequality, jacobian.as_deref_mut());
    force::force(layout, x, edge_radius, inequality, jacobian.as_deref_mut());
    swing::swing(layout, x, ground, inequality, jacobian);
}
