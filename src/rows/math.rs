//! Vectors, matrices and Euler angles.

use crate::real::Real;

/// Vector with three components.
pub type Vec3<T> = [T; 3];
/// 3 x 3 matrix by rows.
pub type Mat3<T> = [[T; 3]; 3];

/// Vector sum.
#[inline(always)]
pub fn add<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Vector difference.
#[inline(always)]
pub fn sub<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Scalar multiple of a vector.
#[inline(always)]
pub fn scale<T: Real>(s: T, a: Vec3<T>) -> Vec3<T> {
    [s * a[0], s * a[1], s * a[2]]
}

/// Dot product.
#[inline(always)]
pub fn dot<T: Real>(a: Vec3<T>, b: Vec3<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Cross product.
#[inline(always)]
pub fn cross<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Matrix times vector.
#[inline(always)]
pub fn mul<T: Real>(m: &Mat3<T>, a: Vec3<T>) -> Vec3<T> {
    [dot(m[0], a), dot(m[1], a), dot(m[2], a)]
}

/// Transposed matrix times vector.
#[inline(always)]
pub fn mul_transposed<T: Real>(m: &Mat3<T>, a: Vec3<T>) -> Vec3<T> {
    add(add(scale(a[0], m[0]), scale(a[1], m[1])), scale(a[2], m[2]))
}

/// Rotation `Rz(yaw) Ry(pitch) Rx(roll)` from base to world, and the rotation axes of the three angles in world coordinates.
///
/// `omega = axes[0] roll' + axes[1] pitch' + axes[2] yaw'`, and `d rot / d angle_i = [axes[i]]x rot`.
#[inline(always)]
pub fn euler<T: Real>(angles: Vec3<T>) -> (Mat3<T>, [Vec3<T>; 3]) {
    let (sx, cx) = angles[0].sin_cos();
    let (sy, cy) = angles[1].sin_cos();
    let (sz, cz) = angles[2].sin_cos();
    let rot_wb = [
        [cy * cz, sx * sy * cz - cx * sz, cx * sy * cz + sx * sz],
        [cy * sz, sx * sy * sz + cx * cz, cx * sy * sz - sx * cz],
        [-sy, sx * cy, cx * cy],
    ];
    let zero = T::zero();
    (rot_wb, [[cy * cz, cy * sz, -sy], [-sz, cz, zero], [zero, zero, T::one()]])
}

/// Adds `w` times the first six values to a motion.
#[inline(always)]
pub fn add_weighted<T: Real>(sum: &mut [T; 6], w: T, values: &[T]) {
    for d in 0..6 {
        sum[d] += w * values[d];
    }
}

/// `sum_i v[i] axes[i]`.
#[inline(always)]
pub fn along<T: Real>(axes: &[Vec3<T>; 3], v: Vec3<T>) -> Vec3<T> {
    add(add(scale(v[0], axes[0]), scale(v[1], axes[1])), scale(v[2], axes[2]))
}
