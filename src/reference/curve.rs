//! Piecewise cubic curves over the variables of a nonlinear program, with derivatives by nodes and by phase durations.
//!
//! The Hermite weights are deliberately written here again, so that the reference programs share no formula with the solver.

use super::nlp::Rows;
use nalgebra::Vector3;

/// Cubic Hermite curve in three dimensions. The phases of a foot, or of the base, are divided into pieces of equal duration.
#[derive(Debug, Clone, Default)]
pub struct Curve {
    /// Variable of each node value, `[x, y, z, dx/dt, dy/dt, dz/dt]`; `None` if it is zero by construction.
    pub nodes: Vec<[Option<usize>; 6]>,
    /// Phase of each piece.
    pub phases: Vec<usize>,
}

/// Durations of the phases of a curve.
#[derive(Debug, Clone)]
pub struct Timing {
    /// Duration of each phase, s.
    pub durations: Vec<f64>,
    /// Variables of all durations except the last, which fills the horizon; empty if the durations are fixed.
    pub variables: Vec<usize>,
}

/// Value of a curve with its derivatives.
#[derive(Debug, Clone)]
pub struct Point {
    /// The value.
    pub value: Vector3<f64>,
    /// Derivatives `(variable, dimension, derivative)`.
    pub by: Vec<(usize, usize, f64)>,
}

impl Point {
    /// Pushes the derivatives of a row whose gradient with respect to this point is `gradient`.
    pub fn push(&self, gradient: Vector3<f64>, rows: &mut Rows) {
        self.push_where([true; 3], gradient, rows);
    }

    /// [`Point::push`] for a row that depends on one dimension only.
    pub fn push_axis(&self, axis: usize, gradient: f64, rows: &mut Rows) {
        self.push_where([0, 1, 2].map(|d| d == axis), Vector3::repeat(gradient), rows);
    }

    /// [`Point::push`] for a row that depends on some dimensions only. The others get no entry, not even zeros.
    pub fn push_where(&self, depends: [bool; 3], gradient: Vector3<f64>, rows: &mut Rows) {
        for &(variable, dimension, derivative) in &self.by {
            if depends[dimension] {
                rows.entry(variable, gradient[dimension] * derivative);
            }
        }
    }
}

/// Weights of the two nodes of a piece (value, slope, value, slope) in a derivative of the curve.
///
/// * `t` - time since the start of the piece, s
/// * `duration` - duration of the piece, s
/// * `order` - 0 value, 1 slope, 2 second derivative
pub fn weights(t: f64, duration: f64, order: usize) -> [f64; 4] {
    let (s, d) = (t / duration, duration);
    match order {
        0 => {
            let (s2, s3) = (s * s, s * s * s);
            [1. - 3. * s2 + 2. * s3, d * (s - 2. * s2 + s3), 3. * s2 - 2. * s3, d * (s3 - s2)]
        }
        1 => [6. * (s * s - s) / d, 1. - 4. * s + 3. * s * s, 6. * (s - s * s) / d, 3. * s * s - 2. * s],
        _ => [(12. * s - 6.) / (d * d), (6. * s - 4.) / d, (6. - 12. * s) / (d * d), (6. * s - 2.) / d],
    }
}

/// Derivatives of the value weights with respect to the duration of the piece, at a fixed time since its start.
fn weights_by_duration(t: f64, duration: f64) -> [f64; 4] {
    let (s, d) = (t / duration, duration);
    let (s2, s3) = (s * s, s * s * s);
    [6. * (s2 - s3) / d, 2. * (s2 - s3), 6. * (s3 - s2) / d, s2 - 2. * s3]
}

impl Timing {
    /// Timing with durations that are not variables.
    pub fn fixed(durations: Vec<f64>) -> Timing {
        Timing { durations, variables: Vec::new() }
    }

    /// Timing of the same phases with the durations at `x`.
    pub fn at(&self, x: &[f64]) -> Timing {
        let mut timing = self.clone();
        if let [durations @ .., last] = timing.durations.as_mut_slice() {
            let before: f64 = durations.iter().sum();
            for (duration, &variable) in durations.iter_mut().zip(&self.variables) {
                *duration = x[variable];
            }
            *last += before - durations.iter().sum::<f64>();
        }
        timing
    }
}

impl Curve {
    /// Value and slope of a node at `x`.
    pub fn node(&self, node: usize, x: &[f64]) -> [f64; 6] {
        self.nodes[node].map(|variable| variable.map_or(0., |v| x[v]))
    }

    /// Value of a node as a point, or its slope if `slope` is true.
    pub fn node_point(&self, node: usize, x: &[f64], slope: bool) -> Point {
        let offset = if slope { 3 } else { 0 };
        let at = self.node(node, x);
        let variables = (0..3).filter_map(|d| Some((self.nodes[node][offset + d]?, d, 1.)));
        Point { value: Vector3::from_fn(|d, _| at[offset + d]), by: variables.collect() }
    }

    /// Number of pieces of a phase.
    fn pieces_of(&self, phase: usize) -> usize {
        self.phases.iter().filter(|&&p| p == phase).count()
    }

    /// Durations of the pieces, s.
    pub fn piece_durations(&self, timing: &Timing) -> Vec<f64> {
        self.phases.iter().map(|&phase| timing.durations[phase] / self.pieces_of(phase) as f64).collect()
    }

    /// Point of the curve at a time.
    ///
    /// With fixed durations only the two nodes around the time have entries. With free durations the piece depends on the durations; then
    /// every node and every duration has an entry.
    ///
    /// * `timing` - timing at `x`
    /// * `order` - 0 value, 1 slope, 2 second derivative; only 0 with free durations
    pub fn at(&self, x: &[f64], timing: &Timing, time: f64, order: usize) -> Point {
        // Find the phase by its end; the last phase takes the rest from rounding.
        let last = timing.durations.len() - 1;
        let (mut phase, mut start) = (0, 0.);
        while phase < last && time > start + timing.durations[phase] {
            start += timing.durations[phase];
            phase += 1;
        }
        let pieces = self.pieces_of(phase);
        let first = self.phases.partition_point(|&p| p < phase);
        let duration = timing.durations[phase] / pieces as f64;
        let within = (((time - start) / duration).max(0.) as usize).min(pieces - 1);
        let (piece, local) = (first + within, time - start - within as f64 * duration);
        if timing.variables.is_empty() {
            return self.on_piece(x, piece, duration, local, order);
        }
        debug_assert_eq!(order, 0, "curves with free durations give values only");
        let value = |weights| self.combine(x, piece, weights);
        let w = weights(local, duration, 0);
        let mut by = Vec::with_capacity(6 * self.nodes.len());
        for node in 0..self.nodes.len() {
            for derivative in 0..2 {
                let weight = if node == piece || node == piece + 1 { w[2 * (node - piece) + derivative] } else { 0. };
                self.push_node(node, derivative, weight, &mut by);
            }
        }
        let slope = value(weights(local, duration, 1));
        // A longer earlier phase delays the curve. A longer current phase stretches its pieces, and those before delay this one.
        let around = (value(weights_by_duration(local, duration)) - slope * within as f64) / pieces as f64;
        for (j, &variable) in timing.variables.iter().enumerate() {
            let mut derivative = match j.cmp(&phase) {
                std::cmp::Ordering::Less => -slope,
                std::cmp::Ordering::Equal => around,
                std::cmp::Ordering::Greater => Vector3::zeros(),
            };
            if phase == last {
                // The last phase shrinks by the same amount.
                derivative -= around;
            }
            by.extend((0..3).map(|d| (variable, d, derivative[d])));
        }
        Point { value: value(w), by }
    }

    /// Point of the curve on a piece, with entries for its two nodes.
    ///
    /// * `local` - time since the start of the piece, s
    pub fn on_piece(&self, x: &[f64], piece: usize, duration: f64, local: f64, order: usize) -> Point {
        let w = weights(local, duration, order);
        let mut by = Vec::with_capacity(12);
        for (i, weight) in w.into_iter().enumerate() {
            self.push_node(piece + i / 2, i % 2, weight, &mut by);
        }
        Point { value: self.combine(x, piece, w), by }
    }

    fn push_node(&self, node: usize, derivative: usize, weight: f64, by: &mut Vec<(usize, usize, f64)>) {
        by.extend((0..3).filter_map(|d| Some((self.nodes[node][3 * derivative + d]?, d, weight))));
    }

    fn combine(&self, x: &[f64], piece: usize, weights: [f64; 4]) -> Vector3<f64> {
        let (a, b) = (self.node(piece, x), self.node(piece + 1, x));
        Vector3::from_fn(|d, _| weights[0] * a[d] + weights[1] * a[d + 3] + weights[2] * b[d] + weights[3] * b[d + 3])
    }
}
