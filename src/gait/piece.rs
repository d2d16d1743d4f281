//! Cubic pieces of a trajectory's curves as polynomials in time.

use super::Curve;
use nalgebra::Vector3;

/// Times closer than this count as equal, s.
pub(crate) const SAME_TIME: f64 = 1e-6;

/// Piece of a curve: `p = p0 + p1 t + p2 t^2 + p3 t^3`.
pub(crate) struct Piece {
    pub(crate) start: f64,
    pub(crate) length: f64,
    p: [Vector3<f64>; 4],
}

impl Piece {
    pub(crate) fn end(&self) -> f64 {
        self.start + self.length
    }

    /// Value and slope of a curve at a time, clamped to the curve. At a node the earlier piece counts.
    pub(crate) fn at(curve: &[Piece], time: f64) -> [Vector3<f64>; 2] {
        // The slack keeps the side of a node when times are sums of other durations.
        let piece = &curve[curve.partition_point(|piece| piece.end() < time - 1e-9).min(curve.len() - 1)];
        let t = (time - piece.start).clamp(0., piece.length);
        [piece.value_after(t), piece.first_after(t)]
    }

    /// Value `t` s after the start of the piece.
    pub(crate) fn value_after(&self, t: f64) -> Vector3<f64> {
        self.p[0] + (self.p[1] + (self.p[2] + self.p[3] * t) * t) * t
    }

    /// First derivative `t` s after the start of the piece.
    pub(crate) fn first_after(&self, t: f64) -> Vector3<f64> {
        self.p[1] + (self.p[2] * 2. + self.p[3] * (3. * t)) * t
    }

    pub(crate) fn value(&self, time: f64) -> Vector3<f64> {
        self.value_after(time - self.start)
    }

    pub(crate) fn first(&self, time: f64) -> Vector3<f64> {
        self.first_after(time - self.start)
    }

    pub(crate) fn second(&self, time: f64) -> Vector3<f64> {
        self.p[2] * 2. + self.p[3] * (6. * (time - self.start))
    }

    /// Part of the piece between two times; `None` if it is shorter than [`SAME_TIME`].
    pub(crate) fn between(&self, [from, to]: [f64; 2]) -> Option<Piece> {
        let (start, end) = (self.start.max(from), self.end().min(to));
        if end - start < SAME_TIME {
            return None;
        }
        if start == self.start && end == self.end() {
            return Some(Piece { ..*self });
        }
        Some(Piece { start, length: end - start, p: [self.value(start), self.first(start), self.second(start) / 2., self.p[3]] })
    }

    /// Bernstein coefficients of the value.
    pub(crate) fn control(&self) -> [Vector3<f64>; 4] {
        let [p0, p1, p2, _] = self.p;
        let (near, far) = (p0 + p1 * (self.length / 3.), self.value(self.end()));
        [p0, near, near + (p1 + p2 * self.length) * (self.length / 3.), far]
    }

    /// Bernstein coefficients of the first derivative.
    pub(crate) fn control_rate(&self) -> [Vector3<f64>; 3] {
        [self.p[1], self.p[1] + self.p[2] * self.length, self.first(self.end())]
    }
}

/// Pieces of a Hermite curve.
pub(crate) fn pieces(curve: &Curve) -> Vec<Piece> {
    let vector = |n: &[f64]| Vector3::new(n[0], n[1], n[2]);
    let mut start = 0.;
    let ends = curve.nodes.windows(2).zip(&curve.poly_durations);
    ends.map(|(n, &length)| {
        let (a, b, next) = (vector(&n[0]), vector(&n[0][3..]), vector(&n[1][3..]));
        // Differences first, so that a standing foot has exactly zero velocity.
        let mean = (vector(&n[1]) - a) / length;
        let p = [a, b, (mean * 3. - b * 2. - next) / length, (b + next - mean * 2.) / (length * length)];
        let piece = Piece { start, length, p };
        start += length;
        piece
    })
    .collect()
}
