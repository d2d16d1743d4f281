//! Scalar type of the solver.

use num_dual::DualNum;

/// Scalar of the solver: `f32` for speed, `f64` for certified motions.
pub trait Real: num_traits::Float + num_traits::NumAssign + std::iter::Sum + Default + std::fmt::Debug + Send + Sync + 'static {
    /// Converts from `f64` to the nearest value.
    fn of(value: f64) -> Self;
    /// Converts to `f64`.
    fn as_f64(self) -> f64;
}

impl Real for f32 {
    #[inline(always)]
    fn of(value: f64) -> Self {
        value as f32
    }
    #[inline(always)]
    fn as_f64(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    #[inline(always)]
    fn of(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn as_f64(self) -> f64 {
        self
    }
}

/// Double-precision scalars with or without derivatives.
pub trait Number: DualNum<Primitive = f64> + Copy {}
impl<D: DualNum<Primitive = f64> + Copy> Number for D {}
