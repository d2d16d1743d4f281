//! The scalar of the solver.

/// Scalar of the solver: `f32` for speed, `f64` for certification.
pub trait Real: num_traits::Float + num_traits::NumAssign + std::iter::Sum + Default + std::fmt::Debug + Send + Sync + 'static {
    /// Nearest value to an `f64`.
    fn of(value: f64) -> Self;
    /// This value as an `f64`.
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
