//! Writer for Jacobian rows.

use super::math::{Vec3, add, scale};
use super::table::Place;
use crate::real::Real;

/// Jacobian rows of one element.
pub struct Rows<'a, T> {
    values: &'a mut [T],
    stride: usize,
}

impl<'a, T> Rows<'a, T> {
    /// Rows of the element at a place.
    #[inline(always)]
    pub fn new(jacobian: &'a mut [T], place: &Place) -> Self {
        Rows { values: &mut jacobian[place.jacobian as usize..], stride: place.stride as usize }
    }

    /// Writes one value.
    #[inline(always)]
    pub fn put(&mut self, row: usize, column: usize, value: T) {
        self.values[row * self.stride + column] = value;
    }

    /// Writes the first columns of a row.
    #[inline(always)]
    pub fn put_first<const C: usize>(&mut self, row: usize, values: &[T; C])
    where
        T: Copy,
    {
        self.values[row * self.stride..][..C].copy_from_slice(values);
    }
}

impl<T: Real> Rows<'_, T> {
    /// Writes the cross-product matrix `[a]x` into three rows, starting at a row and a column.
    #[inline(always)]
    pub fn put_cross(&mut self, row: usize, column: usize, a: Vec3<T>) {
        let zero = T::zero();
        let matrix = [[zero, -a[2], a[1]], [a[2], zero, -a[0]], [-a[1], a[0], zero]];
        for r in 0..3 {
            self.put_three(row + r, column, matrix[r]);
        }
    }

    /// Writes the derivatives of `-x cross a` with respect to (x, y) of a foothold into three rows and two columns: `[a]x` times the
    /// derivatives of the foothold's position, whose height changes with the slope of the ground.
    #[inline(always)]
    pub fn put_by_foothold(&mut self, row: usize, column: usize, a: Vec3<T>, slope: [T; 2]) {
        let zero = T::zero();
        // [a]x e_x = (0, a_z, -a_y), [a]x e_y = (-a_z, 0, a_x), [a]x e_z = (a_y, -a_x, 0).
        let along_z = [a[1], -a[0], zero];
        let along_x = add([zero, a[2], -a[1]], scale(slope[0], along_z));
        let along_y = add([-a[2], zero, a[0]], scale(slope[1], along_z));
        for r in 0..3 {
            self.put(row + r, column, along_x[r]);
            self.put(row + r, column + 1, along_y[r]);
        }
    }

    /// Writes three values of a row, starting at a column.
    #[inline(always)]
    pub fn put_three(&mut self, row: usize, column: usize, values: Vec3<T>) {
        self.values[row * self.stride + column..][..3].copy_from_slice(&values);
    }
}
