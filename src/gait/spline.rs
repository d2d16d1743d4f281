//! Curves: cubic Hermite pieces between nodes, and the clamped uniform cubic B-spline of the base.

use crate::real::Number;

/// Weights of (value, slope, next value, next slope) of a cubic Hermite piece of length `duration`, `t` s after its start.
///
/// `h00 = 2u^3 - 3u^2 + 1`, `h10 = (u^3 - 2u^2 + u) d`, `h01 = -2u^3 + 3u^2`, `h11 = (u^3 - u^2) d`, `u = t/d`.
pub fn hermite<D: Number>(t: D, duration: D) -> [D; 4] {
    let u = t / duration;
    let (u2, u3) = (u * u, u * u * u);
    let far = u2 * 3. - u3 * 2.;
    [-far + 1., (u3 - u2 * 2. + u) * duration, far, (u3 - u2) * duration]
}

/// Weights of the time derivative of [`hermite`].
pub fn hermite_rate<D: Number>(t: D, duration: D) -> [D; 4] {
    let u = t / duration;
    let u2 = u * u;
    [(u2 - u) * 6. / duration, u2 * 3. - u * 4. + 1., (u - u2) * 6. / duration, u2 * 3. - u * 2.]
}

/// Weights of the second time derivative of [`hermite`].
pub fn hermite_acceleration<D: Number>(t: D, duration: D) -> [D; 4] {
    let u = t / duration;
    let far = (-u * 12. + 6.) / (duration * duration);
    [-far, (u * 6. - 4.) / duration, far, (u * 6. - 2.) / duration]
}

/// Gram matrix of the Hermite basis (value, slope, next value, next slope): integrals of products over a piece of length 1.
pub const HERMITE_GRAM: [[f64; 4]; 4] = [
    [13. / 35., 11. / 210., 9. / 70., -13. / 420.],
    [11. / 210., 1. / 105., 13. / 420., -1. / 140.],
    [9. / 70., 13. / 420., 13. / 35., -11. / 210.],
    [-13. / 420., -1. / 140., -11. / 210., 1. / 105.],
];

/// Clamped uniform cubic B-spline over `intervals` intervals of length `interval`: `intervals + 3` coefficients.
#[derive(Debug, Clone, Copy)]
pub struct BSpline {
    intervals: usize,
    interval: f64,
}

impl BSpline {
    /// Creates a spline over at least one interval of length `interval`, s.
    pub fn new(intervals: usize, interval: f64) -> BSpline {
        BSpline { intervals, interval }
    }

    /// Number of coefficients.
    pub fn coefficients(&self) -> usize {
        self.intervals + 3
    }

    /// Knot `i` of the knot vector, s. The end knots are repeated four times.
    fn knot(&self, i: usize) -> f64 {
        (i.max(3) - 3).min(self.intervals) as f64 * self.interval
    }

    /// Greville abscissa of a coefficient, s: coefficients that are linear in these times give a straight line.
    pub fn greville(&self, coefficient: usize) -> f64 {
        (1..=3).map(|i| self.knot(coefficient + i)).sum::<f64>() / 3.
    }

    /// Values of the four basis functions `k..k + 4` of interval `k` at time `t` since the start of the spline, s, or their derivatives.
    ///
    /// Cox-de Boor recursion; a derivative lowers the degree and takes differences of the coefficients.
    pub fn basis(&self, k: usize, t: f64, derivative: usize) -> [f64; 4] {
        let span = k + 3;
        // Basis of degree 3 - derivative on this span.
        let degree = 3 - derivative;
        let mut b = [0.; 4];
        b[0] = 1.;
        for p in 1..=degree {
            let mut saved = 0.;
            for r in 0..p {
                let (right, left) = (self.knot(span + r + 1), self.knot(span + 1 + r - p));
                let part = b[r] / (right - left);
                b[r] = saved + (right - t) * part;
                saved = (t - left) * part;
            }
            b[p] = saved;
        }
        // Raise the degree: d/dt sum c_i N_i,p = sum p (c_i - c_{i-1}) / (u_{i+p} - u_i) N_i,p-1.
        for p in degree + 1..=3 {
            let mut raised = [0.; 4];
            for r in 0..p {
                // Function r of degree p - 1 is N_{span - p + 1 + r}.
                let i = span + 1 + r - p;
                let part = p as f64 * b[r] / (self.knot(i + p) - self.knot(i));
                raised[r + 1] += part;
                raised[r] -= part;
            }
            b = raised;
        }
        b
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hermite_interpolates_values_and_slopes() {
        assert_eq!(hermite(0., 0.3), [1., 0., 0., 0.]);
        let end = hermite(0.3, 0.3);
        assert!(end[0].abs() < 1e-15 && (end[2] - 1.).abs() < 1e-15);
        let d = 1e-6;
        let slope: Vec<f64> = (0..4).map(|i| (hermite(d, 0.3)[i] - hermite(-d, 0.3)[i]) / (2. * d)).collect();
        assert!((slope[1] - 1.).abs() < 1e-6 && slope[0].abs() < 1e-6);
    }

    #[test]
    fn basis_is_a_partition_of_unity_and_derivatives_match_differences() {
        let s = BSpline::new(7, 0.1);
        let d = 1e-5;
        for k in 0..7 {
            for u in [0.01, 0.37, 0.5, 0.99] {
                let t = (k as f64 + u) * 0.1;
                assert!((s.basis(k, t, 0).iter().sum::<f64>() - 1.).abs() < 1e-12);
                for i in 0..4 {
                    let first = (s.basis(k, t + d, 0)[i] - s.basis(k, t - d, 0)[i]) / (2. * d);
                    let second = (s.basis(k, t + d, 1)[i] - s.basis(k, t - d, 1)[i]) / (2. * d);
                    assert!((s.basis(k, t, 1)[i] - first).abs() < 1e-5 * first.abs().max(1.));
                    assert!((s.basis(k, t, 2)[i] - second).abs() < 1e-5 * second.abs().max(1.));
                }
            }
        }
    }

    #[test]
    fn greville_coefficients_give_a_line() {
        let s = BSpline::new(5, 0.1);
        for k in 0..5 {
            let t = (k as f64 + 0.3) * 0.1;
            let value: f64 = (0..4).map(|i| s.basis(k, t, 0)[i] * s.greville(k + i)).sum();
            assert!((value - t).abs() < 1e-12);
        }
        assert_eq!(s.basis(0, 0., 0)[0], 1.);
        assert_eq!(s.coefficients(), 8);
    }
}
