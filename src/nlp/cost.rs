//! Cost rows of a candidate: effort of the forces, powers of standing and of swinging legs.
//!
//! The objective is that of [`crate::gait::cost`], of the whole motion, or of a periodic stride that costs alone. Effort is exact. The
//! price of joints beyond their limits is quadratic, see [`joint_torque`](crate::rows::joint_torque), and only legs in [closed
//! form](crate::rows::leg_joints) have it. Powers are integrated by Gauss-Legendre rules between the nodes of the curves that they are
//! made of: the knots of the base, and the force nodes of a stance or the middle of a swing, where accelerations jump.

use super::builder::Builder;
use super::foot_blocks::{ForcePoint, force_points, swing_curve};
use super::swing_curve::{FootWeights, SwingCurve};
use super::transcription::Transcribe;
use super::transcription::momentum::{deviation_rates, deviation_weights};
use crate::gait::Phase;
use crate::gait::cost::{CostWeights, distance, trunk_force};
use crate::gait::family::speed_scale;
use crate::gait::spline::{HERMITE_GRAM, hermite, hermite_acceleration, hermite_rate};
use crate::gait::trajectory::GoalVelocity;
use crate::quadrature::{GAUSS_3, GAUSS_6};
use crate::real::Real;
use crate::robot::GRAVITY;
use crate::rows::Family;
use crate::rows::blocks::{BlockId, Foothold, Use};
use crate::rows::effort::Effort;
use crate::rows::foot::{StanceForce, SwingMotion};
use crate::rows::force::ForceNode;
use crate::rows::goal::Goal;
use crate::rows::hip::HipPoint;
use crate::rows::joint_speed::JointSpeed;
use crate::rows::joint_torque::JointTorque;
use crate::rows::leg_joints::JointLeg;
use crate::rows::stance_power::StancePower;
use crate::rows::swing_power::SwingPower;
use crate::rows::table::{NONE, Place};
use crate::settings::Friction;
use std::ops::Range;

/// Speed by which the cost of a motion with a free end is divided, in `sqrt(g l)`, instead of by its distance over time.
const PLANNING_SPEED: f64 = 0.3;
/// Price of the distance of a free end from the goal, for one base height or rad.
const GOAL_PRICE: f64 = 40.;
/// Price of the distance of the velocity from its approach to that of the goal, for one `sqrt(g l)` or half of `sqrt(g / l)` at all
/// times.
const RATE_PRICE: f64 = 400.;
/// Time in which the velocity of the goal is approached, s.
pub(crate) const RESPONSE: f64 = 0.15;

/// Price of the square of the excess of a joint over its limits, in weights of the joint excess over 1 s. An excess of a twentieth of a
/// limit that lasts a twentieth of a second costs half of what the excess itself does.
const EXCESS_RATE: f64 = 200.;

/// Smallest pivot of a Gram matrix, relative to its scale.
const LEAST_PIVOT: f64 = 1e-12;

/// Shortest part of a quadrature, s.
const SHORTEST: f64 = 1e-6;

/// Adds the cost rows.
pub(super) fn cost_elements<T: Real>(own: &dyn Transcribe<T>, b: &mut Builder<T>, weights: &CostWeights) {
    let (task, robot) = (b.task, &b.task.robot);
    let displacement = std::array::from_fn(|i| task.goal.position[i] - task.start.position[i]);
    // If the end is free, the price of effort does not depend on where the goal is.
    let near = b.settings.goal_velocity == GoalVelocity::Near;
    let distance = match task.stride.filter(|stride| stride.costs_alone) {
        Some(stride) => distance(robot, stride.displacement, 0.),
        None if near => PLANNING_SPEED * speed_scale(robot) * b.horizon,
        None => distance(robot, displacement, task.turn()),
    };
    let weight = robot.weight();
    curvature_elements(own, b);
    // Without a price there is no row: a row without a weight would count half of its square.
    if weights.effort > 0. {
        let price = weights.effort * (GRAVITY * robot.base_height).sqrt() / (weight * weight * distance);
        effort_elements(b, price);
        trunk_elements(b, price);
    }
    if weights.leg_work > 0. {
        stance_elements(b, weights.leg_work / distance);
    }
    if weights.swing_work > 0. {
        swing_elements(own, b, weights.swing_work / distance);
    }
    if near {
        goal_elements(b);
    }
    if weights.joint_excess > 0. {
        joint_elements(own, b, weights.joint_excess * EXCESS_RATE);
    }
}

/// Adds the distance of the last pose from the goal, and those of the rates at all knots from an exponential approach to the goal's.
///
/// With the rates at the end alone a plan would put off every change of velocity, and so would the next.
fn goal_elements<T: Real>(b: &mut Builder<T>) {
    let (start, goal, line_rate) = (&b.task.start, &b.task.goal, b.reference_rate());
    let (length, speed) = (b.task.robot.base_height, speed_scale(&b.task.robot));
    // Half of the square of a row with this weight is `price` for one base height or rad, one `sqrt(g l)` or half of `sqrt(g / l)`.
    let weights = |price: f64, linear: f64, angular: f64| -> [f64; 6] {
        std::array::from_fn(|i| (2. * price).sqrt() / if i < 3 { linear } else { angular })
    };
    let per_knot = RATE_PRICE / b.intervals as f64;
    let line = b.reference(b.horizon);
    let mut rows = vec![(2 * b.intervals, std::array::from_fn(|i| goal.pose()[i] - line[i]), weights(GOAL_PRICE, length, 1.))];
    for knot in 1..=b.intervals {
        let left = (-(knot as f64) * b.interval / RESPONSE).exp();
        let rate: [f64; 6] = std::array::from_fn(|i| goal.rate()[i] + left * (start.rate()[i] - goal.rate()[i]) - line_rate[i]);
        rows.push((2 * knot + 1, rate, weights(per_knot, speed, speed / length / 2.)));
    }
    for (block, desired, weight) in rows {
        let (variable, column, place) = (NONE, NONE, Place::default());
        b.tables.goals.push(Goal { weight: weight.map(T::of), desired: desired.map(T::of), variable, column, place });
        let step = (block / 2).min(b.intervals - 1);
        b.cost_element(Family::Goal, b.tables.goals.len() - 1, step, 0., &[Use::Touches(b.base[block])]);
    }
}

/// Adds the curvatures of the friction cones, in the order of the cones.
fn curvature_elements<T: Real>(own: &dyn Transcribe<T>, b: &mut Builder<T>) {
    if b.settings.friction() != Friction::Cone {
        return;
    }
    for ForcePoint { node, foothold, step, slope, .. } in force_points(own, b) {
        b.tables.cone_curvatures.push(ForceNode::new(T::of(slope), foothold.index));
        let at = b.tables.cone_curvatures.len() - 1;
        b.cost_element(Family::ConeCurvature, at, step, 0., &[Use::Touches(node), Use::Reads(foothold.block)]);
    }
}

/// Part of the motion that costs, s: the periodic stride if it costs alone.
fn costly<T: Real>(b: &Builder<T>) -> Range<f64> {
    b.task.stride.filter(|stride| stride.costs_alone).map_or(0.0..b.horizon, |stride| stride.times(b.interval))
}

/// Adds the effort rows of forces, and of the moments of soles over their half length.
///
/// * `price` - cost of the integral of `|f|^2`, 1/(N² s)
fn effort_elements<T: Real>(b: &mut Builder<T>, price: f64) {
    let (unit, part) = (b.force_unit(), costly(b));
    for foot in 0..b.feet.len() {
        let stances = b.feet[foot].force_nodes.iter().enumerate().chain(b.feet[foot].moment_nodes.iter().enumerate());
        let stances: Vec<(usize, Vec<Option<BlockId>>)> = stances.map(|(stance, nodes)| (stance, nodes.clone())).collect();
        for (stance, nodes) in stances {
            let span = b.feet[foot].phases[2 * stance];
            let pieces = nodes.len() - 1;
            let piece = span.duration() / pieces as f64;
            let free: Vec<usize> = (0..=pieces).filter(|&i| nodes[i].is_some()).collect();
            let within = |t: f64| ((t.clamp(part.start, part.end) - span.start) / piece).clamp(0., pieces as f64);
            let factor = effort_factor(&free, pieces, within(span.start)..within(span.end), 2. * price * unit * unit * piece);
            for (at, &i) in free.iter().enumerate().filter(|(at, _)| factor[*at] != [[0.; 4]; 2]) {
                let next = free.get(at + 1).and_then(|&i| nodes[i]);
                let Some(node) = nodes[i] else { continue };
                b.tables.efforts.push(Effort {
                    factor: factor[at].map(|row| row.map(T::of)),
                    node: [NONE; 2],
                    column: [NONE; 2],
                    place: Place::default(),
                });
                let step = b.step_within(span.start + piece * (i as f64 + 0.5), node);
                let uses = [Use::Touches(node), next.map_or(Use::Nothing, Use::Touches)];
                b.cost_element(Family::Effort, b.tables.efforts.len() - 1, step, 0., &uses);
            }
        }
    }
}

/// Adds the effort of the moment that holds the trunk upright, by the trapezoidal rule over the knots whose pose is free.
///
/// * `price` - cost of the integral of `|f|^2`, 1/(N² s)
fn trunk_elements<T: Real>(b: &mut Builder<T>, price: f64) {
    let force = trunk_force(&b.task.robot);
    if force == 0. {
        return;
    }
    let (arrives, part) = (b.settings.goal_velocity != GoalVelocity::Near, costly(b));
    for knot in 1..=b.intervals - usize::from(arrives) {
        let t = knot as f64 * b.interval;
        // Half of the interval before and half of that after the knot.
        let [from, to] = [-0.5, 0.5].map(|half| (t + half * b.interval).clamp(part.start, part.end));
        if to - from < SHORTEST {
            continue;
        }
        let weight = force * (2. * price * (to - from)).sqrt();
        let line = b.reference(t);
        let of_tilt = |value: [f64; 2]| [0., 0., 0., value[0], value[1], 0.].map(T::of);
        let (weight, desired) = (of_tilt([weight; 2]), of_tilt([-line[3], -line[4]]));
        b.tables.goals.push(Goal { weight, desired, variable: NONE, column: NONE, place: Place::default() });
        let step = knot.min(b.intervals - 1);
        b.cost_element(Family::Goal, b.tables.goals.len() - 1, step, 0., &[Use::Touches(b.base[2 * knot])]);
    }
}

/// Two rows per free node of the Cholesky factor of a stance's Gram matrix.
///
/// * `free` - nodes whose force is not fixed at zero
/// * `part` - part of the stance that costs, in pieces
/// * `scale` - of the Gram matrix of one piece
fn effort_factor(free: &[usize], pieces: usize, part: Range<f64>, scale: f64) -> Vec<[[f64; 4]; 2]> {
    let n = 2 * free.len();
    let mut gram = vec![vec![0.; n]; n];
    for piece in 0..pieces {
        let at = |i: usize| free.iter().position(|&node| node == piece + i / 2).map(|node| 2 * node + i % 2);
        let [from, to] = [part.start, part.end].map(|u| (u - piece as f64).clamp(0., 1.));
        for (i, row) in hermite_gram(from, to).iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                if let (Some(r), Some(c)) = (at(i), at(j)) {
                    gram[r][c] += scale * value;
                }
            }
        }
    }
    let mut factor = vec![vec![0.; n + 2]; n];
    for i in 0..n {
        for j in i..n {
            let rest = gram[i][j] - (0..i).map(|k| factor[k][i] * factor[k][j]).sum::<f64>();
            // Functions that are zero in the part have no pivot.
            let pivot = factor[i][i];
            factor[i][j] = if i == j && rest > LEAST_PIVOT * scale {
                rest.sqrt()
            } else if i < j && pivot > 0. {
                rest / pivot
            } else {
                0.
            };
        }
    }
    (0..free.len()).map(|node| [0, 1].map(|r| std::array::from_fn(|c| factor[2 * node + r][2 * node + c]))).collect()
}

/// Gram matrix of the cubic Hermite functions of a piece of length 1, over a part of it.
fn hermite_gram(from: f64, to: f64) -> [[f64; 4]; 4] {
    if (from, to) == (0., 1.) {
        return HERMITE_GRAM;
    }
    let mut gram = [[0.; 4]; 4];
    for [at, weight] in *GAUSS_6 {
        let basis = hermite(from + at * (to - from), 1.);
        for (row, a) in gram.iter_mut().zip(basis) {
            row.iter_mut().zip(basis).for_each(|(sum, b)| *sum += weight * (to - from) * a * b);
        }
    }
    gram
}

/// Base at fraction `u` of interval `k`, and a point (x, y) of it at its height.
fn hip_point<T: Real>(b: &Builder<T>, [x, y]: [f64; 2], (k, u): (usize, f64)) -> HipPoint<T> {
    let h = b.interval;
    HipPoint {
        reference: b.reference((k as f64 + u) * h).map(T::of),
        value: hermite(u * h, h).map(T::of),
        rate: hermite_rate(u * h, h).map(T::of),
        deviation: deviation_weights(u).map(T::of),
        deviation_rate: deviation_rates(u).map(|rate| T::of(rate / h)),
        interval: k as u32,
        column: [NONE; 4],
        hip: [x, y].map(T::of),
    }
}

/// Hip of a foot, base frame: x, y, m.
fn hip_of<T: Real>(b: &Builder<T>, foot: usize) -> [f64; 2] {
    let [x, y, _] = b.task.robot.nominal_feet[foot];
    [x, y]
}

/// Interval of a time, and the fraction of it that has passed.
fn interval_at<T: Real>(b: &Builder<T>, t: f64) -> (usize, f64) {
    let k = ((t / b.interval) as usize).min(b.intervals - 1);
    (k, t / b.interval - k as f64)
}

/// Use of the base blocks of interval `k`, and of three others.
fn uses<T: Real>(b: &Builder<T>, k: usize, others: [Use; 3]) -> [Use; 7] {
    let base: [Use; 4] = std::array::from_fn(|i| Use::Touches(b.base[2 * k + i]));
    let ([pose, rate, next_pose, next_rate], [first, second, third]) = (base, others);
    [pose, rate, next_pose, next_rate, first, second, third]
}

/// Stance of a foot, and the points of its quadrature: times and weights, s.
struct StancePoints {
    foot: usize,
    stance: usize,
    points: Vec<(f64, f64)>,
}

/// All stances that last.
fn stances<T: Real>(b: &Builder<T>) -> Vec<StancePoints> {
    let all = (0..b.feet.len()).flat_map(|foot| (0..b.feet[foot].force_nodes.len()).map(move |stance| (foot, stance)));
    let lasting = all.filter(|&(foot, stance)| b.feet[foot].phases[2 * stance].duration() > 0.);
    let points = |(foot, stance): (usize, usize)| {
        let span = b.feet[foot].phases[2 * stance];
        let pieces = b.feet[foot].force_nodes[stance].len() - 1;
        let nodes = (0..=pieces).map(|i| span.start + span.duration() / pieces as f64 * i as f64);
        StancePoints { foot, stance, points: points(span, nodes, b.interval, costly(b)) }
    };
    lasting.map(points).collect()
}

impl StancePoints {
    /// Force of the foot at a time, and the use of its nodes and its foothold.
    ///
    /// * `unit` - by which the variables are multiplied
    fn force<T: Real>(&self, b: &Builder<T>, t: f64, unit: f64) -> (StanceForce<T>, [Use; 3]) {
        let feet = &b.feet[self.foot];
        let (span, foothold, nodes) = (feet.phases[2 * self.stance], feet.footholds[self.stance], &feet.force_nodes[self.stance]);
        let pieces = nodes.len() - 1;
        let piece = span.duration() / pieces as f64;
        let since = t - span.start;
        let first = ((since / piece) as usize).min(pieces - 1);
        let [value, slope, next, next_slope] = hermite(since - first as f64 * piece, piece);
        let force = StanceForce {
            weights: [[value, slope / piece], [next, next_slope / piece]].map(|weights| weights.map(|w| T::of(w * unit))),
            node: [NONE; 2],
            node_column: [NONE; 2],
            foothold: foothold.index,
            foothold_column: NONE,
        };
        let [node, next] = [first, first + 1].map(|i| nodes[i].map_or(Use::Nothing, Use::Touches));
        (force, [node, next, Use::Touches(foothold.block)])
    }
}

/// Adds the powers of standing legs.
///
/// * `price` - cost of a power of 1 m/s over 1 s
fn stance_elements<T: Real>(b: &mut Builder<T>, price: f64) {
    let unit = b.force_unit() / b.task.robot.weight();
    for of in stances(b) {
        let hip = hip_of(b, of.foot);
        for &(t, duration) in &of.points {
            let (k, u) = interval_at(b, t);
            let (stance, others) = of.force(b, t, unit);
            b.tables.stance_powers.push(StancePower { base: hip_point(b, hip, (k, u)), stance, place: Place::default() });
            let uses = uses(b, k, others);
            b.cost_element(Family::StancePower, b.tables.stance_powers.len() - 1, k, price * duration, &uses);
        }
    }
}

/// Swing of a foot, and the points of its quadrature: times and weights, s.
struct SwingPoints {
    foot: usize,
    curve: SwingCurve,
    height: BlockId,
    around: [Foothold; 2],
    points: Vec<(f64, f64)>,
}

/// All swings.
fn swings<T: Real>(own: &dyn Transcribe<T>, b: &Builder<T>) -> Vec<SwingPoints> {
    let all = (0..b.feet.len()).flat_map(|foot| (0..b.feet[foot].heights.len()).map(move |swing| (foot, swing)));
    let points = |(foot, swing): (usize, usize)| {
        let (span, height) = (b.feet[foot].phases[2 * swing + 1], b.feet[foot].heights[swing]);
        let curve = swing_curve(own, b, foot, swing);
        let mid = curve.mid().map_or(span.start, |mid| span.start + mid);
        let points = points(span, [span.start, mid, span.end].into_iter(), b.interval, costly(b));
        SwingPoints { foot, curve, height, around: [b.feet[foot].footholds[swing], b.feet[foot].footholds[swing + 1]], points }
    };
    all.map(points).collect()
}

impl SwingPoints {
    /// Entry of two derivatives of the position of the foot.
    fn motion<T: Real>(&self, derivatives: [FootWeights; 2]) -> SwingMotion<T> {
        let [first, second] = derivatives;
        SwingMotion {
            xy_weights: [first.xy, second.xy].map(|w| w.map(T::of)),
            z_weights: [first.z, second.z].map(|w| w.map(T::of)),
            offset: [first.offset, second.offset].map(|w| w.map(T::of)),
            height: NONE,
            height_column: NONE,
            foothold: self.around.map(|foothold| foothold.index),
            foothold_column: [NONE; 2],
        }
    }

    /// Use of the swing height and of the footholds.
    fn others(&self) -> [Use; 3] {
        [Use::Touches(self.height), Use::Touches(self.around[0].block), Use::Touches(self.around[1].block)]
    }
}

/// Adds the powers of swinging legs.
///
/// * `price` - cost of a power of 1 m/s over 1 s
fn swing_elements<T: Real>(own: &dyn Transcribe<T>, b: &mut Builder<T>, price: f64) {
    let share_of_leg = b.task.robot.leg_mass() / b.task.robot.weight();
    for of in swings(own, b) {
        let hip = hip_of(b, of.foot);
        for &(t, duration) in &of.points {
            let (k, u) = interval_at(b, t);
            let [velocity, acceleration] = [of.curve.weights(t, hermite_rate), of.curve.weights(t, hermite_acceleration)];
            // The power is that of the force on the leg, in weights.
            let (xy, z) = (acceleration.xy.map(|w| w * share_of_leg), acceleration.z.map(|w| w * share_of_leg));
            let offset = acceleration.offset.map(|w| w * share_of_leg);
            b.tables.swing_powers.push(SwingPower {
                base: hip_point(b, hip, (k, u)),
                foot: of.motion([velocity, FootWeights { xy, z, offset }]),
                place: Place::default(),
            });
            let uses = uses(b, k, of.others());
            b.cost_element(Family::SwingPower, b.tables.swing_powers.len() - 1, k, price * duration, &uses);
        }
    }
}

/// Adds the torques of standing legs and the joint speeds of swinging legs beyond their limits, at the middle of each part of the
/// quadrature.
///
/// * `price` - cost of the square of an excess over 1 s
fn joint_elements<T: Real>(own: &dyn Transcribe<T>, b: &mut Builder<T>, price: f64) {
    let Some(legs) = &b.task.robot.joints else { return };
    // Legs without a closed form have no rows.
    let forms: Vec<Option<JointLeg<T>>> = legs.iter().map(JointLeg::of).collect();
    let weight = |duration: f64| T::of((2. * price * duration).sqrt());
    for of in stances(b) {
        let Some(leg) = forms[of.foot] else { continue };
        for (t, duration) in middles(&of.points) {
            let (k, u) = interval_at(b, t);
            let (base, weight) = (hip_point(b, [0.; 2], (k, u)), weight(duration));
            let (stance, others) = of.force(b, t, b.force_unit());
            b.tables.joint_torques.push(JointTorque { base, stance, leg, weight, place: Place::default() });
            let uses = uses(b, k, others);
            b.cost_element(Family::JointTorque, b.tables.joint_torques.len() - 1, k, 0., &uses);
        }
    }
    for of in swings(own, b) {
        let Some(leg) = forms[of.foot] else { continue };
        for (t, duration) in middles(&of.points) {
            let (k, u) = interval_at(b, t);
            let motion = [of.curve.weights(t, hermite), of.curve.weights(t, hermite_rate)];
            b.tables.joint_speeds.push(JointSpeed {
                base: hip_point(b, [0.; 2], (k, u)),
                foot: of.motion(motion),
                leg,
                weight: weight(duration),
                place: Place::default(),
            });
            let uses = uses(b, k, of.others());
            b.cost_element(Family::JointSpeed, b.tables.joint_speeds.len() - 1, k, 0., &uses);
        }
    }
}

/// Middle of each part of a quadrature, which has three points: times and durations, s.
fn middles(points: &[(f64, f64)]) -> impl Iterator<Item = (f64, f64)> {
    points.chunks_exact(3).map(|part| (part[1].0, part.iter().map(|point| point.1).sum()))
}

/// Points of the quadrature of a phase between knots and other nodes, where its power is not smooth, within a part of the motion: times
/// and weights, s.
///
/// * `nodes` - start and end of the phase, and nodes between them
fn points(phase: Phase, nodes: impl Iterator<Item = f64>, interval: f64, part: Range<f64>) -> Vec<(f64, f64)> {
    let low = (phase.start + SHORTEST).max(part.start);
    let knots = ((low / interval).ceil() as usize..).map(|k| k as f64 * interval).take_while(|t| *t < (phase.end - SHORTEST).min(part.end));
    let mut cuts: Vec<f64> = nodes.map(|t| t.clamp(part.start, part.end)).chain(knots).collect();
    cuts.sort_by(f64::total_cmp);
    cuts.dedup_by(|b, a| *b - *a < SHORTEST);
    cuts.windows(2).flat_map(|w| GAUSS_3.map(|[at, share]| (w[0] + at * (w[1] - w[0]), share * (w[1] - w[0])))).collect()
}
