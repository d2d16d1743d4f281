//! Parts that all transcriptions share: footholds, swings and forces of the feet, and their rows.

use super::builder::Builder;
use super::footing;
use super::swing_curve::{FootWeights, SwingCurve};
use super::transcription::{ReachTime, SwingLaw, Transcribe};
use crate::gait::spline::{hermite, hermite_acceleration};
use crate::gait::swing::TOP_SPEED;
use crate::real::Real;
use crate::robot::{FootReach, Reach, Slab};
use crate::rows::Family;
use crate::rows::acceleration::Acceleration;
use crate::rows::blocks::{BlockId, Foothold, Use};
use crate::rows::footing::Footing;
use crate::rows::force::ForceNode;
use crate::rows::reach::{self, ReachFoot, ReachLeg};
use crate::rows::sole::SolePoint;
use crate::rows::stride::Stride;
use crate::rows::swing::SwingNode;
use crate::rows::table::{NONE, Place};
use crate::rows::turn::{Turn, YAW};
use crate::settings::Friction;
use crate::task::SwingState;

/// Adds the rows of the feet: reach boxes, forces, swings and the boxes of footholds.
pub(super) fn rows<T: Real>(own: &dyn Transcribe<T>, b: &mut Builder<T>) {
    reach_elements(own, b);
    force_elements(own, b);
    swing_elements(own, b);
    footing_elements(b);
    turn_elements(b);
}

/// Adds the blocks of footholds, swing heights and force nodes. Value and slope of the force are zero where a stance meets a swing.
pub(super) fn blocks<T: Real>(own: &dyn Transcribe<T>, b: &mut Builder<T>) {
    let radius = footing::radius(b.task, b.settings);
    for foot in 0..b.feet.len() {
        let stances = b.feet[foot].phases.len().div_ceil(2);
        let mut places: Vec<[f64; 2]> = (0..stances).map(|stance| own.foothold(b, foot, stance, stances)).collect();
        if radius > 0. {
            // The first foothold is given.
            let search = footing::Search::of(b.task, foot, radius);
            for (stance, place) in places.iter_mut().enumerate().skip(1) {
                let span = b.feet[foot].phases[2 * stance];
                let level = b.reference((span.start + span.end) / 2.)[2] - b.task.robot.base_height;
                let room = search.footing(*place, level);
                *place = room.at;
                b.feet[foot].footings.push(room);
            }
        }
        for (stance, &here) in places.iter().enumerate() {
            let foothold = b.foothold(stance == 0, here, own.foothold_smoothing());
            b.feet[foot].footholds.push(foothold);
            if let Some(&next) = places.get(stance + 1) {
                let law = own.swing(b.settings, b.task, b.feet[foot].phases[2 * stance + 1]);
                let mid = (law.over)(b.task, here, next) + law.above;
                let descends = swing_curve(own, b, foot, stance).mid().is_none();
                let height = b.block(descends, [mid], [0.; 6]);
                b.feet[foot].heights.push(height);
            }
            let pieces = b.settings.force_pieces();
            let span = b.feet[foot].phases[2 * stance];
            let mut nodes = Vec::with_capacity(pieces + 1);
            for node in 0..=pieces {
                let zero = (node == 0 && stance > 0) || (node == pieces && stance + 1 < stances) || span.duration() <= 0.;
                nodes.push((!zero).then(|| {
                    let guess = own.force(b, span.start + span.duration() * node as f64 / pieces as f64);
                    b.block(false, guess.initial, guess.smoothing)
                }));
            }
            if b.task.robot.sole.is_some() {
                let moments = nodes.iter().map(|node| node.map(|_| b.block(false, [0.; 6], [1.; 6]))).collect();
                b.feet[foot].moment_nodes.push(moments);
                let yaw = match stance {
                    0 => b.task.start_yaws[foot],
                    _ => own.yaw(b, (span.start + span.end) / 2.),
                };
                let yaw = b.block(stance == 0, [yaw], [YAW_SMOOTHING; 6]);
                b.feet[foot].yaws.push(yaw);
            }
            b.feet[foot].force_nodes.push(nodes);
        }
    }
}

/// Weight that attracts the yaw of a sole to its initial guess, relative to 1 for a force of the weight per foot, 1/rad².
const YAW_SMOOTHING: f64 = 1.;

/// Curve of a swing.
///
/// * `swing` - index among the swings of the foot
pub(super) fn swing_curve<T: Real>(own: &dyn Transcribe<T>, b: &Builder<T>, foot: usize, swing: usize) -> SwingCurve {
    SwingCurve::new(b.task, foot, swing, &b.feet[foot].phases, |span| own.mid_time(span))
}

/// Adds the reach rows of the feet at every instant.
fn reach_elements<T: Real>(own: &dyn Transcribe<T>, b: &mut Builder<T>) {
    let times = own.reach_times(b);
    let groups_of = |reach: &Reach| (0..b.feet.len()).map(|foot| groups(&reach.foot(foot))).collect::<Vec<_>>();
    let usual = groups_of(&b.task.robot.reach);
    let wider = b.settings.stretch.as_ref().map(|stretch| (stretch.until, groups_of(&stretch.reach)));
    b.reserve_reach(times.len(), times.iter().flat_map(|time| &usual[time.feet.clone()]).map(Vec::len).sum());
    let mut phases = vec![0; b.feet.len()];
    // Phase of each foot at its previous instant, and its legs in that phase, one per group of slabs.
    let mut legs = vec![(usize::MAX, Vec::new()); b.feet.len()];
    for ReachTime { t, feet, step, interval, weights, blocks, entry } in times {
        b.reach_instant(entry, step, interval, weights, blocks);
        for foot in feet {
            let phase = b.feet[foot].phase_from(&mut phases[foot], t);
            let curve = (phase % 2 == 1).then(|| swing_curve(own, b, foot, phase / 2));
            let FootWeights { xy, z, offset } = curve.map_or(FootWeights::STANCE, |curve| curve.weights(t, hermite));
            // The offset of a swing that had begun before changes with time.
            if legs[foot].0 != phase || curve.is_some_and(|curve| curve.started()) {
                let start = b.feet[foot].phases[phase].start;
                let groups = wider.as_ref().filter(|(until, _)| phase < 2 || start < *until).map_or(&usual, |(_, wider)| wider);
                let of_group = |slabs| {
                    let (leg, uses) = reach_leg(b, foot, slabs, phase, offset);
                    b.reach_leg(leg, uses)
                };
                legs[foot] = (phase, groups[foot].iter().map(of_group).collect());
            }
            let (xy_weights, z_weights) = (xy.map(T::of), z.map(T::of));
            legs[foot].1.iter().for_each(|&leg| b.reach_foot(ReachFoot { xy_weights, z_weights, leg }));
        }
    }
}

/// Slabs of a foot in groups, each of which has an element at every instant. A last group that is not full repeats its first slab.
fn groups(reach: &FootReach) -> Vec<[Slab; reach::ROWS]> {
    let slabs: Vec<Slab> = reach.slabs().collect();
    slabs.chunks(reach::ROWS).map(|group| std::array::from_fn(|i| *group.get(i).unwrap_or(&group[0]))).collect()
}

/// Data that the reach rows of a foot share in a phase, and the blocks that they use.
fn reach_leg<T: Real>(b: &Builder<T>, foot: usize, slabs: &[Slab; reach::ROWS], phase: usize, offset: [f64; 3]) -> (ReachLeg<T>, [Use; 3]) {
    let blocks = &b.feet[foot];
    let before = blocks.footholds[phase / 2];
    let (after, uses) = if blocks.phases[phase].stance {
        (NONE, [Use::Touches(before.block), Use::Nothing, Use::Nothing])
    } else {
        let after = blocks.footholds[phase / 2 + 1];
        (after.index, [before.block, after.block, blocks.heights[phase / 2]].map(Use::Touches))
    };
    let nominal = b.task.robot.nominal_feet[foot];
    let half_width = |slab: Slab| {
        let half = (slab.sides[1] - slab.sides[0]) / 2.;
        half - (slab.normal[2].abs() * b.settings.reach_margin).min(half / 2.)
    };
    let leg = ReachLeg {
        center: slabs.map(|slab| T::of(slab.along(nominal) + (slab.sides[0] + slab.sides[1]) / 2.)),
        half_widths: slabs.map(|slab| T::of(half_width(slab))),
        normals: slabs.map(|slab| slab.normal.map(T::of)),
        foothold: [before.index, after],
        offset: offset.map(T::of),
    };
    (leg, uses)
}

/// Adds the boxes of all footholds but the first of each foot.
fn footing_elements<T: Real>(b: &mut Builder<T>) {
    for foot in 0..b.feet.len() {
        for stance in 1..=b.feet[foot].footings.len() {
            let (room, foothold) = (b.feet[foot].footings[stance - 1], b.feet[foot].footholds[stance]);
            let step = b.step_within(b.feet[foot].phases[2 * stance].start, foothold.block);
            // Widened if necessary, so that the box is not empty after its margins are subtracted.
            let least = |i: usize| ((room.high[i] - room.low[i]) / 2.).max(b.settings.length_margin);
            let side = |sign: f64| std::array::from_fn(|i| T::of((room.low[i] + room.high[i]) / 2. + sign * least(i)));
            let (low, high) = (side(-1.), side(1.));
            b.tables.footings.push(Footing { low, high, foothold: foothold.index, foothold_column: NONE, place: Place::default() });
            b.element(Family::Footing, b.tables.footings.len() - 1, step, &[Use::Touches(foothold.block)]);
        }
    }
}

/// A force that is limited: at a free force node or at a Bezier point next to it.
pub(super) struct ForcePoint {
    pub node: BlockId,
    pub foothold: Foothold,
    /// Step of its rows in the sweep.
    pub step: usize,
    /// Weight of the slope of the node.
    pub slope: f64,
    /// Moment node and yaw of a sole.
    pub sole: Option<[BlockId; 2]>,
}

/// All limited forces.
pub(super) fn force_points<T: Real>(own: &dyn Transcribe<T>, b: &Builder<T>) -> Vec<ForcePoint> {
    let pieces = b.settings.force_pieces();
    let mut points = Vec::new();
    for foot in &b.feet {
        for (stance, nodes) in foot.force_nodes.iter().enumerate() {
            let (span, foothold) = (foot.phases[2 * stance], foot.footholds[stance]);
            for (i, node) in nodes.iter().enumerate() {
                let Some(node) = *node else { continue };
                let step = b.step_within(span.start + span.duration() * i as f64 / pieces as f64, node);
                let sole = foot.moment_nodes.get(stance).and_then(|moments| moments[i]).map(|moment| [moment, foot.yaws[stance]]);
                points.extend(own.slopes(i, pieces).iter().map(|&slope| ForcePoint { node, foothold, step, slope, sole }));
            }
        }
    }
    points
}

fn force_elements<T: Real>(own: &dyn Transcribe<T>, b: &mut Builder<T>) {
    for ForcePoint { node, foothold, step, slope, sole } in force_points(own, b) {
        let (family, table) = match b.settings.friction() {
            Friction::Pyramid => (Family::Force, &mut b.tables.force_nodes),
            Friction::Cone => (Family::Cone, &mut b.tables.cones),
        };
        table.push(ForceNode::new(T::of(slope), foothold.index));
        let at = table.len() - 1;
        b.element(family, at, step, &[Use::Touches(node), Use::Touches(foothold.block)]);
        if let Some([moment, yaw]) = sole {
            b.tables.sole_points.push(SolePoint::new(T::of(slope), foothold.index));
            b.element(Family::Sole, b.tables.sole_points.len() - 1, step, &[node, moment, yaw].map(Use::Touches));
        }
    }
}

/// Parts of a stance at which the yaw of a sole is limited.
const TURN_PARTS: [f64; 5] = [0., 0.25, 0.5, 0.75, 1.];

/// Adds the limits of the yaw of standing soles relative to the base.
fn turn_elements<T: Real>(b: &mut Builder<T>) {
    let Some(sole) = b.task.robot.sole else { return };
    let h = b.interval;
    for foot in 0..b.feet.len() {
        for stance in 0..b.feet[foot].yaws.len() {
            let (span, yaw) = (b.feet[foot].phases[2 * stance], b.feet[foot].yaws[stance]);
            let end = span.end.min(b.horizon);
            // The state at the start is given.
            for t in TURN_PARTS.map(|part| span.start + part * (end - span.start)).into_iter().filter(|t| *t > 0.) {
                let k = ((t / h - 1e-9) as usize).min(b.intervals - 1);
                b.tables.turns.push(Turn {
                    weights: hermite(t - k as f64 * h, h).map(T::of),
                    reference: T::of(b.reference(t)[YAW]),
                    limit: T::of(sole.turn),
                    base: [NONE; 4],
                    base_column: [NONE; 4],
                    yaw: NONE,
                    yaw_column: NONE,
                    place: Place::default(),
                });
                let [pose, rate, next_pose, next_rate] = std::array::from_fn(|i| Use::Touches(b.base[2 * k + i]));
                b.element(Family::Turn, b.tables.turns.len() - 1, k, &[pose, rate, next_pose, next_rate, Use::Touches(yaw)]);
            }
        }
    }
}

/// Fractions of a swing over an edge at which the height of a sole is constrained. They are dense where it rises and falls, so that toe and
/// heel do not meet a riser between two instants.
const EDGE_PARTS: [f64; 23] = {
    let (mut parts, mut i, mut at) = ([0.; 23], 0, 2);
    while i < parts.len() {
        parts[i] = at as f64 / 32.;
        at += if (4 <= at && at < 12) || (20 <= at && at < 28) { 1 } else { 2 };
        i += 1;
    }
    parts
};

/// True if the ground under the initial guess of a swing of a sole is not one plane.
///
/// * `swing` - index among the swings of the foot
fn crosses_edge<T: Real>(b: &Builder<T>, foot: usize, swing: usize) -> bool {
    let Some(sole) = b.task.robot.sole else { return false };
    let after = |swing: usize| b.feet[foot].footings.get(swing).map(|room| room.at);
    let from = if swing == 0 { Some(b.task.foothold_start(foot)) } else { after(swing - 1) };
    let Some((from, to)) = from.zip(after(swing)) else { return false };
    let side = |of: fn(f64, f64) -> f64, by: f64| std::array::from_fn(|i| of(from[i], to[i]) + by);
    !b.task.terrain.is_plane(side(f64::min, -sole.radius()), side(f64::max, sole.radius()))
}

fn swing_elements<T: Real>(own: &dyn Transcribe<T>, b: &mut Builder<T>) {
    for foot in 0..b.feet.len() {
        for swing in 0..b.feet[foot].heights.len() {
            let (span, height) = (b.feet[foot].phases[2 * swing + 1], b.feet[foot].heights[swing]);
            let around = [b.feet[foot].footholds[swing], b.feet[foot].footholds[swing + 1]];
            let foothold = around.map(|f| f.index);
            let touched = around.map(|f| Use::Touches(f.block));
            let law = own.swing(b.settings, b.task, span);
            let curve = swing_curve(own, b, foot, swing);
            // On level ground lower and upper limit are one two-sided row.
            let level = !b.task.terrain.has_edges();
            let two_sided = law.limited && level;
            let parts = if crosses_edge(b, foot, swing) { &EDGE_PARTS } else { law.parts };
            let lows = parts.iter().map(|part| (part, false));
            for (&part, upper) in lows.chain((law.limited && !level).then_some((&0.5, true))) {
                // The middle of a swing is the middle of the whole swing, from its lift-off; a foot that only descends has none.
                let t = match curve.mid() {
                    Some(mid) if part == 0.5 => span.start + mid,
                    None if part == 0.5 => continue,
                    _ => span.start + part * span.duration(),
                };
                let step = b.step_within(t, height);
                let FootWeights { xy, z, offset } = curve.weights(t, hermite);
                // A foot that is about to land, or has just lifted off, has no room for the margin.
                let low = match part {
                    0.5 => law.clearance,
                    _ if curve.started() => -b.settings.length_margin,
                    _ => 0.,
                };
                b.tables.swing_nodes.push(SwingNode {
                    xy_weights: xy.map(T::of),
                    z_weights: z.map(T::of),
                    offset: offset.map(T::of),
                    low: T::of(low),
                    high: T::of(b.settings.swing_height),
                    two_sided: u32::from(two_sided),
                    upper: u32::from(upper),
                    height: NONE,
                    height_column: NONE,
                    foothold,
                    foothold_column: [NONE; 2],
                    place: Place::default(),
                });
                let entry = b.tables.swing_nodes.len() - 1;
                b.element_of(Family::Swing, entry, step, usize::from(two_sided), &[Use::Touches(height), touched[0], touched[1]]);
            }
            if curve.started() {
                started_limits(b, foot, &law, &curve);
                continue;
            }
            if let Some(longest) = law.longest_step {
                let step = b.step_within((span.start + span.end) / 2., height);
                b.tables.strides.push(Stride { limit: T::of(longest), foothold, foothold_column: [NONE; 2], place: Place::default() });
                b.element(Family::Stride, b.tables.strides.len() - 1, step, &touched);
            }
            if let Some(by) = law.accelerations {
                let step = b.step_within((span.start + span.end) / 2., height);
                b.tables.accelerations.push(Acceleration::new(by.map(T::of), foothold));
                let entry = b.tables.accelerations.len() - 1;
                b.element(Family::Acceleration, entry, step, &[Use::Touches(height), touched[0], touched[1]]);
            }
        }
    }
}

/// Share of the acceleration limit that is always left along x and y at the start of a swing that had begun before.
const LEAST_ALONG: f64 = 0.2;

/// Adds the limits of speed and acceleration of a swing that had begun before, as those of steps from fixed points.
///
/// With position `a`, velocity `v` and remaining time `T`, a foothold `x` gives in x and y
///
/// * the velocity `(1 - u)^2 v + 2 u (1 - u) w` at `u T` with `w = 3 / T (x - a - v T / 3)`. It stays below the limit `V` if
///   `|w| <= V + sqrt(V (V - |v|))`.
/// * the acceleration `6 / T^2 (x - a - 2 v T / 3)` at the start and `-6 / T^2 (x - a - v T / 3)` at touchdown.
///
/// At the start, the acceleration in z is that to the lowest allowed mid node. That of a foot that only descends is known at both ends.
fn started_limits<T: Real>(b: &mut Builder<T>, foot: usize, law: &SwingLaw, curve: &SwingCurve) {
    let Some(SwingState { position: [x, y, z], velocity: [vx, vy, vz], .. }) = b.task.start_swings[foot] else { return };
    let (duration, after, height) = (b.feet[foot].phases[1].end, b.feet[foot].footholds[1], b.feet[foot].heights[0]);
    let step = b.step_within(duration / 2., height);
    let from = |part: f64| [x + vx * duration * part, y + vy * duration * part];
    let before = b.foothold(true, from(1. / 3.), 0.);
    if let Some(longest) = law.longest_step {
        let fastest = longest * TOP_SPEED / duration;
        let largest = fastest + (fastest * (fastest - vx.hypot(vy)).max(0.)).sqrt();
        let (limit, foothold) = (T::of(largest * duration / 3.), [before.index, after.index]);
        b.tables.strides.push(Stride { limit, foothold, foothold_column: [NONE; 2], place: Place::default() });
        b.element(Family::Stride, b.tables.strides.len() - 1, step, &[before, after].map(|f| Use::Touches(f.block)));
    }
    if law.accelerations.is_some() {
        let by_step = 6. / (duration * duration);
        let by_height = curve.mid().map_or(0., |mid| 6. / ((duration - mid) * (duration - mid)));
        let limit = b.tables.constants.foot_acceleration.as_f64();
        let ground = b.task.terrain.height(x, y);
        let (time, top) = curve.mid().map_or((duration, ground), |mid| (mid, ground + law.clearance));
        // Factor of an acceleration along x and y beside that in z at a time.
        let beside = |t: f64| {
            let [by_start, by_velocity, by_end, _] = hermite_acceleration(t, time);
            let upwards = by_start * z + by_velocity * vz + by_end * top;
            limit / (limit * limit - upwards * upwards).max((LEAST_ALONG * limit).powi(2)).sqrt()
        };
        let start = b.foothold(true, from(2. / 3.), 0.);
        let landing = if curve.mid().is_some() { [by_step, by_height] } else { [by_step * beside(time), 0.] };
        for (before, by) in [(before, landing), (start, [by_step * beside(0.), 0.])] {
            b.tables.accelerations.push(Acceleration::new(by.map(T::of), [before.index, after.index]));
            let uses = [Use::Touches(height), Use::Touches(before.block), Use::Touches(after.block)];
            b.element(Family::Acceleration, b.tables.accelerations.len() - 1, step, &uses);
        }
    }
}
