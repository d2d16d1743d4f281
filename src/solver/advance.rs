//! Vector updates for the trial point and for the linear model of the residuals there.

use crate::real::Real;
use multiversion::multiversion;

/// `out = a + step * b`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn advance<T: Real>(a: &[T], step: T, b: &[T], out: &mut [T]) {
    for i in 0..out.len() {
        out[i] = a[i] + step * b[i];
    }
}

/// `a += b`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn add<T: Real>(a: &mut [T], b: &[T]) {
    for (a, b) in a.iter_mut().zip(b) {
        *a += *b;
    }
}
