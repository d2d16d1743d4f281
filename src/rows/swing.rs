//! Height of swinging feet: lower limit above the terrain, upper limit above lift-off and touchdown.
//!
//! `low - (z - height(x, y)) + margin <= 0` and `z - highest - high + margin <= 0`, times the length scale, where `highest` is the maximum
//! height of both footholds and of the ground under the foot: over a pit a foot need not go down. On level ground these three are equal,
//! and both limits form one two-sided row. On other ground the upper limit is a separate row in the middle of the swing; it suffices there,
//! because z rises to the middle and falls from it.
//!
//! On ground with edges a foot is a ball whose lower side must also clear the ground around it:
//! `z >= height(x + o, y + o') - s.o - lift(o)` at offsets `o` within the radius. `s` is a slope interpolated from that of the lift-off
//! foothold to that of the touchdown foothold, and `lift` is the height of the ball's lower side at the offset. A sole is a disc with its
//! half diagonal as radius and no lift.

use super::blocks::Placed;
use super::table::{NONE, Place};
use super::write::Rows;
use super::{RowKind, Spec, Tables};
use crate::real::Real;
use crate::terrain::Ground;

/// One row; two-sided in `momentum` on level ground.
pub const SPEC: Spec = Spec { rows: 1, pairs: 1, kind: RowKind::Inequality, unit: "m" };

/// See [`super::Family::allowed`].
pub(super) use super::length_allowed as allowed;

crate::table! {
    /// Height of a foot above the terrain at one point of a swing; weights as in [`super::reach::ReachFoot`].
    pub struct SwingNode<T> {
        /// Weights of the footholds before and after the swing.
        pub xy_weights: [T; 2],
        /// Weights of the heights of these footholds, and of the swing's mid node.
        pub z_weights: [T; 3],
        /// Constant part of the position, m; zero unless the swing had begun before the motion.
        pub offset: [T; 3],
        /// Lowest height above the terrain, m.
        pub low: T,
        /// Largest height above lift-off and touchdown, m; used if the row has an upper side.
        pub high: T,
        /// 1 if the row is two-sided.
        pub two_sided: u32,
        /// 1 if the row is the upper limit alone.
        pub upper: u32,
        /// Position of the swing height in `x`.
        pub height: u32,
        /// Column of the swing height.
        pub height_column: u32,
        /// Indices of the footholds before and after the swing.
        pub foothold: [u32; 2],
        /// Columns of the footholds.
        pub foothold_column: [u32; 2],
        /// Place of the row in the buffers.
        pub place: Place,
    }
}

/// Rings around the foot on which the ground is sampled: distance, and height of the lower side of the ball there, in radii.
pub const RINGS: [[f64; 2]; 2] = [[0.6, 0.2], [0.96, 0.72]];
/// Number of samples on the rings.
pub const RING_POINTS: usize = 4 * RINGS.len();

/// Offset of sample `k` around a foot, on both sides along both axes, and the lift of the ball there, in radii.
fn around<T: Real>(k: usize) -> ([T; 2], T) {
    let [distance, lift] = RINGS[k / 4].map(T::of);
    let mut offset = [T::zero(); 2];
    offset[k % 2] = if (k / 2).is_multiple_of(2) { distance } else { -distance };
    (offset, lift)
}

/// Writes positions and columns into an entry. Roles: swing height, foothold before, foothold after.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    let swing = &mut tables.swing_nodes[entry];
    swing.place = at.place;
    swing.height = at.seats[0].position;
    swing.height_column = at.seats[0].column;
    swing.foothold_column = at.columns(1);
}

/// Height rows of all swings.
///
/// * `residual` - out, at each entry's place: lower limit, then the upper limit if two-sided; or the upper limit alone
/// * `jacobian` - out, one row at each entry's place
#[inline(always)]
pub fn swing<T: Real>(tables: &Tables<T>, x: &[T], ground: &[Ground<T>], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    let constants = &tables.constants;
    let unit = constants.length_scale;
    for swing in &tables.swing_nodes {
        let footholds = swing.foothold.map(|f| tables.footholds[f as usize] as usize);
        let mut at = [swing.offset[0], swing.offset[1]];
        let mut height = swing.offset[2] + swing.z_weights[2] * x[swing.height as usize];
        for i in 0..2 {
            at[0] += swing.xy_weights[i] * x[footholds[i]];
            at[1] += swing.xy_weights[i] * x[footholds[i] + 1];
            height += swing.z_weights[i] * ground[swing.foothold[i] as usize].height;
        }
        let under = tables.terrain.ground(at[0], at[1]);
        // Height from which z is measured, and its slopes with respect to the position of each foothold.
        let mut above = under.height;
        let mut weights = swing.xy_weights;
        let mut slopes = [under.slope; 2];
        let mut side = -T::one();
        let place = swing.place.inequality as usize;
        if swing.upper == 1 {
            side = T::one();
            for i in 0..2 {
                let foothold = &ground[swing.foothold[i] as usize];
                if foothold.height > above {
                    above = foothold.height;
                    weights = [T::zero(); 2];
                    weights[i] = T::one();
                    slopes[i] = foothold.slope;
                }
            }
            residual[place] = (height - above - swing.high + constants.length_margin) * unit;
        } else {
            // The clearance applies to the ground under the foot only; the ground around the foot requires no clearance.
            let mut least = above;
            if constants.foot_radius > T::zero() {
                let grounds = swing.foothold.map(|f| &ground[f as usize]);
                let level: [T; 2] =
                    std::array::from_fn(|d| swing.xy_weights[0] * grounds[0].slope[d] + swing.xy_weights[1] * grounds[1].slope[d]);
                for k in 0..RING_POINTS {
                    let (offset, lift) = around::<T>(k);
                    let offset = offset.map(|o| o * constants.foot_radius);
                    let beside = tables.terrain.ground(at[0] + offset[0], at[1] + offset[1]);
                    let needed = beside.height - level[0] * offset[0] - level[1] * offset[1] - lift * constants.ball_radius - swing.low;
                    if needed > least {
                        least = needed;
                        slopes = grounds.map(|g| {
                            std::array::from_fn(|d| beside.slope[d] - offset[0] * g.curvature[0][d] - offset[1] * g.curvature[1][d])
                        });
                    }
                }
            }
            residual[place] = (least - height + swing.low + constants.length_margin) * unit;
        }
        if swing.two_sided == 1 {
            residual[place + 1] = (height - above - swing.high + constants.length_margin) * unit;
        }
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let mut rows = Rows::new(jacobian, &swing.place);
        if swing.height_column != NONE {
            rows.put(0, swing.height_column as usize, side * swing.z_weights[2] * unit);
        }
        for i in 0..2 {
            if swing.foothold_column[i] != NONE {
                let slope = ground[swing.foothold[i] as usize].slope;
                for d in 0..2 {
                    let value = swing.z_weights[i] * slope[d] - weights[i] * slopes[i][d];
                    rows.put(0, swing.foothold_column[i] as usize + d, side * value * unit);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Shared, residuals};
    use super::SwingNode;
    use crate::gait::Schedule;
    use crate::nlp::Problem;
    use crate::robot::Robot;
    use crate::settings::TranscriptionSettings;
    use crate::task::{Goal, Task};
    use crate::terrain::{Grid, Shape, Terrain};

    fn rows(problem: &Problem<f64>, x: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let mut shared = Shared::default();
        shared.resize(problem);
        let (mut c, mut g) = (vec![0.; problem.rows.one_sided()], vec![0.; problem.inequalities]);
        let mut jacobian = vec![0.; problem.jacobian_len];
        residuals(problem, x, 0., &mut shared, &mut c, &mut g, Some(&mut jacobian[..]));
        (g, jacobian)
    }

    #[test]
    fn over_a_pit_the_upper_limit_is_measured_from_the_footholds() {
        let pair = [vec![0.4, 0.2, 0.2, 0.2, 0.6], vec![0.6, 0.2, 0.2, 0.2, 0.4]];
        let schedule = Schedule::new(vec![pair[0].clone(), pair[1].clone(), pair[1].clone(), pair[0].clone()]).unwrap();
        let settings = TranscriptionSettings::default();
        for (terrain, x, both) in [("gap", 1.9, 1), ("slope", 3.1, 1), ("flat", 1.9, 0)] {
            let task = Task::new(Robot::named("anymal").unwrap(), Terrain::named(terrain).unwrap(), Goal::at(x, 0.)).unwrap();
            let problem = Problem::<f64>::new(&task, &schedule.aligned(0.1), &settings);
            let uppers: Vec<_> = problem.swing_nodes.iter().filter(|s| s.upper == 1).collect();
            assert_eq!(uppers.len(), 8 * both);
            assert_eq!(problem.swing_nodes.iter().any(|s| s.two_sided == 1), both == 0);
            let (g, jacobian) = rows(&problem, &problem.initial);
            // A two-sided row measures both limits from the ground under the foot.
            for both in problem.swing_nodes.iter().filter(|s| s.two_sided == 1) {
                let expected = 10. * (settings.clearance - settings.swing_height + settings.length_margin);
                assert!((g[both.place.inequality as usize + 1] - expected).abs() < 1e-9, "{terrain}");
            }
            let mut deep = 0;
            for upper in uppers {
                // Initially a mid node has the required clearance above the highest of the three heights.
                let expected = 10. * (settings.clearance - settings.swing_height + settings.length_margin);
                assert!((g[upper.place.inequality as usize] - expected).abs() < 1e-9, "{terrain}: {}", g[upper.place.inequality as usize]);
                let at = upper.foothold.map(|f| problem.footholds[f as usize] as usize);
                let mid = [0, 1].map(|d| (problem.initial[at[0] + d] + problem.initial[at[1] + d]) / 2.);
                deep += usize::from(task.terrain.height(mid[0], mid[1]) < -0.2);
                let columns = (0..2).flat_map(|i| (0..2).map(move |d| (at[i] + d, upper.foothold_column[i], d as u32)));
                let height = (upper.height as usize, upper.height_column, 0);
                for (variable, column, d) in columns.chain([height]).filter(|c| c.1 != crate::rows::table::NONE) {
                    let side = |step: f64| {
                        let mut x = problem.initial.clone();
                        x[variable] += step;
                        rows(&problem, &x).0[upper.place.inequality as usize]
                    };
                    let slope = (side(1e-6) - side(-1e-6)) / 2e-6;
                    let exact = jacobian[upper.place.jacobian as usize + (column + d) as usize];
                    assert!((slope - exact).abs() < 1e-6, "{terrain}, {variable}: {exact}, by differences {slope}");
                }
            }
            assert_eq!(deep > 0, terrain == "gap");
        }
    }

    #[test]
    fn a_sole_over_an_edge_moves_little_between_instants_while_it_rises() {
        // A riser of 0.1 m between samples at x = 0.45 m and 0.475 m.
        let heights = (0..281).map(|i| vec![if i > 98 { 0.1 } else { 0. }; 161]).collect();
        let grid = Grid { low: [-2.; 2], high: [5.025, 2.025], heights };
        let terrain = Terrain { name: "riser".into(), friction: 0.8, shape: Shape::Grid(grid) };
        let settings = TranscriptionSettings::default();
        for (robot, dense) in [("humanoid", true), ("biped", false)] {
            let task = Task::new(Robot::named(robot).unwrap(), terrain.clone(), Goal::at(1.5, 0.)).unwrap();
            let schedule = Schedule::new(vec![vec![0.3, 0.4, 0.5, 0.4, 0.5, 0.4, 0.8], vec![0.7, 0.4, 0.5, 0.4, 0.5, 0.4, 0.4]]).unwrap();
            let problem = Problem::<f64>::new(&task, &schedule.aligned(0.1), &settings);
            let (mut crossing, mut others) = (0, 0);
            for swing in problem.swing_nodes.chunk_by(|a, b| a.foothold == b.foothold) {
                let at = swing[0].foothold.map(|f| problem.initial[problem.footholds[f as usize] as usize]);
                let crosses = task.robot.sole.is_some_and(|sole| at[0] - sole.radius() < 0.475 && at[1] + sole.radius() > 0.45);
                let lows: Vec<_> = swing.iter().filter(|node| node.upper == 0).collect();
                // The foot rises and falls most where its height is a mean of those of a foothold and the mid node.
                let between = |node: &SwingNode<f64>| (0.15..0.85).contains(&node.z_weights[2]);
                let pairs = lows.windows(2).filter(|pair| pair.iter().all(|&node| between(node)));
                let most = pairs.map(|pair| pair[1].xy_weights[1] - pair[0].xy_weights[1]).fold(0., f64::max);
                if crosses {
                    assert!(most > 0. && most < 0.05, "{robot}: {most}");
                    crossing += 1;
                } else {
                    assert!(lows.len() == 9 && most > 0.1, "{robot}: {} instants, {most}", lows.len());
                    others += 1;
                }
            }
            assert!((crossing > 0) == dense && others > 0, "{robot}: {crossing} {others}");
        }
    }
}
