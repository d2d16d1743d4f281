//! Curve of a swinging foot, as weights of its footholds and of the height of its mid node.
//!
//! A whole swing has a mid node halfway between the footholds in x and y, where its velocity is their distance divided by `mid_time`, which
//! the transcription defines. Both pieces start and end at rest in z; at the footholds the foot is at rest in all directions.
//!
//! A swing that had begun before the motion continues from a given position and velocity. In x and y it is one cubic to the foothold. In z
//! it has a mid node halfway through the whole swing if that is ahead by at least a quarter of the remaining time; otherwise it is one
//! cubic, too.

use crate::gait::Phase;
use crate::gait::spline::{hermite, hermite_rate};
use crate::task::{SwingState, Task};

/// Linear form of one derivative of a foot's position at one time.
pub(super) struct FootWeights {
    /// Weights of the footholds before and after the swing, for x and y.
    pub xy: [f64; 2],
    /// Weights of the heights of these footholds and of the mid node, for z.
    pub z: [f64; 3],
    /// Constant part.
    pub offset: [f64; 3],
}

impl FootWeights {
    /// Weights of a standing foot.
    pub const STANCE: FootWeights = FootWeights { xy: [1., 0.], z: [1., 0., 0.], offset: [0.; 3] };
}

/// Curve of one swing.
#[derive(Debug, Clone, Copy)]
pub(super) struct SwingCurve {
    /// The swing. One that had begun before starts at 0.
    span: Phase,
    /// Distance between the footholds divided by the speed of the mid node, s.
    mid_time: f64,
    /// State at the start of a swing that had begun before.
    from: Option<SwingState>,
}

impl SwingCurve {
    /// Curve of a swing of a foot.
    ///
    /// * `swing` - index among the swings of the foot
    /// * `phases` - of the foot
    /// * `mid_time` - distance between the footholds divided by the speed of the mid node, for a swing phase, s
    pub fn new(task: &Task, foot: usize, swing: usize, phases: &[Phase], mid_time: impl Fn(Phase) -> f64) -> SwingCurve {
        let span = phases[2 * swing + 1];
        let started = swing == 0 && phases[0].duration() <= 0.;
        SwingCurve { span, mid_time: mid_time(span), from: task.start_swings[foot].filter(|_| started) }
    }

    /// True if the swing had begun before the motion.
    pub fn started(&self) -> bool {
        self.from.is_some()
    }

    /// Time between the start of the swing and its mid node, s; `None` if the foot only descends.
    pub fn mid(&self) -> Option<f64> {
        let duration = self.span.duration();
        match self.from {
            None => Some(duration / 2.),
            Some(state) => state.rise(duration),
        }
    }

    /// Weights of the foot's position at time `t`. With the derivatives of [`hermite`] as `basis` they are those of its velocity or
    /// acceleration.
    pub fn weights(&self, t: f64, basis: fn(f64, f64) -> [f64; 4]) -> FootWeights {
        let (duration, u) = (self.span.duration(), t - self.span.start);
        let Some(SwingState { position: [.., height], velocity, .. }) = self.from else {
            let half = duration / 2.;
            let (xy, z) = if u < half {
                let w = basis(u, half);
                ([w[0] + 0.5 * w[2] - w[3] / self.mid_time, 0.5 * w[2] + w[3] / self.mid_time], [w[0], 0., w[2]])
            } else {
                let w = basis(u - half, half);
                ([0.5 * w[0] - w[1] / self.mid_time, w[2] + 0.5 * w[0] + w[1] / self.mid_time], [0., w[2], w[0]])
            };
            return FootWeights { xy, z, offset: [0.; 3] };
        };
        let along = basis(u, duration);
        let (z, rise) = match self.mid() {
            Some(mid) if u < mid => {
                let w = basis(u, mid);
                ([0., 0., w[2]], w[0] * height + w[1] * velocity[2])
            }
            Some(mid) => {
                let w = basis(u - mid, duration - mid);
                ([0., w[2], w[0]], 0.)
            }
            None => ([0., along[2], 0.], along[0] * height + along[1] * velocity[2]),
        };
        FootWeights { xy: [along[0], along[2]], z, offset: [along[1] * velocity[0], along[1] * velocity[1], rise] }
    }

    /// Nodes of the curve and durations of its pieces.
    ///
    /// * `footholds` - before and after; the former is not used by a swing that had begun before
    /// * `height` - of the mid node
    pub fn pieces(&self, footholds: [[f64; 3]; 2], height: f64) -> (Vec<[f64; 6]>, Vec<f64>) {
        let duration = self.span.duration();
        let at_rest = |[x, y, z]: [f64; 3]| [x, y, z, 0., 0., 0.];
        let (start, end) = match self.from {
            None => (at_rest(footholds[0]), at_rest(footholds[1])),
            Some(SwingState { position: [x, y, z], velocity: [vx, vy, vz], .. }) => ([x, y, z, vx, vy, vz], at_rest(footholds[1])),
        };
        let Some(mid) = self.mid() else { return (vec![start, end], vec![duration]) };
        if self.from.is_some() {
            let (place, rate) = (hermite(mid, duration), hermite_rate(mid, duration));
            let at = |w: [f64; 4], d: usize| w[0] * start[d] + w[1] * start[d + 3] + w[2] * end[d];
            let node = [at(place, 0), at(place, 1), height, at(rate, 0), at(rate, 1), 0.];
            return (vec![start, node, end], vec![mid, duration - mid]);
        }
        let [a, b] = footholds;
        let speed = |d: usize| (b[d] - a[d]) / self.mid_time;
        let node = [(a[0] + b[0]) / 2., (a[1] + b[1]) / 2., height, speed(0), speed(1), 0.];
        (vec![start, node, end], vec![duration / 2.; 2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gait::spline::hermite_acceleration;

    /// Value of the curve or of a derivative by its weights.
    fn by_weights(curve: &SwingCurve, footholds: [[f64; 3]; 2], height: f64, t: f64, basis: fn(f64, f64) -> [f64; 4]) -> [f64; 3] {
        let FootWeights { xy, z, offset } = curve.weights(t, basis);
        let [a, b] = footholds;
        let along = |d: usize| offset[d] + xy[0] * a[d] + xy[1] * b[d];
        [along(0), along(1), offset[2] + z[0] * a[2] + z[1] * b[2] + z[2] * height]
    }

    #[test]
    fn weights_and_pieces_are_the_same_curve() {
        let (span, height) = (Phase { start: 0., end: 0.3, stance: false }, 0.17);
        let state = |since| SwingState { position: [0.1, -0.2, 0.06], velocity: [0.9, 0.1, 0.4], since };
        for from in [None, Some(state(0.05)), Some(state(0.2))] {
            let curve = SwingCurve { span, mid_time: 0.4, from };
            // A swing that had begun before starts above its first foothold, whose height does not matter.
            let footholds = [[0.1, -0.2, 0.02], [0.35, -0.15, 0.04]];
            let (nodes, durations) = curve.pieces(footholds, height);
            assert_eq!(nodes.len(), if from.is_some_and(|s| s.since > 0.1) { 2 } else { 3 });
            assert!((durations.iter().sum::<f64>() - 0.3).abs() < 1e-12);
            let mut start = 0.;
            for (pair, duration) in nodes.windows(2).zip(&durations) {
                for (u, basis) in [0., 0.3, 0.8]
                    .into_iter()
                    .flat_map(|u| [(u, hermite as fn(f64, f64) -> _), (u, hermite_rate), (u, hermite_acceleration)])
                {
                    let w = basis(u * duration, *duration);
                    let expected = by_weights(&curve, footholds, height, start + u * duration, basis);
                    for d in 0..3 {
                        let value = w[0] * pair[0][d] + w[1] * pair[0][d + 3] + w[2] * pair[1][d] + w[3] * pair[1][d + 3];
                        assert!((value - expected[d]).abs() < 1e-9 * (1. + value.abs()), "{from:?} axis {d}: {value} {expected:?}");
                    }
                }
                start += duration;
            }
        }
    }
}
