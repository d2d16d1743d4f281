//! Standing configuration for a file without one: legs bent, feet below the joints that swing them.

use crate::robot::leg::{Leg, PRECISION};
use nalgebra::Vector3;

/// Height of the foot below the leg's first bending joint relative to the leg length, for robots with at most two legs and with more.
/// Bipeds stand more upright.
const BENT: [f64; 2] = [0.93, 0.75];
/// Dot product of unit axes above which they count as parallel.
const PARALLEL: f64 = 0.9;
/// Horizontal part of a leg at rest, relative to its length, above which the leg sprawls like an insect's.
const SPRAWLS: f64 = 0.7;
/// Horizontal distance of a sprawling leg's foot from its first bending joint, in leg lengths.
const OUT: f64 = 0.55;
/// Depth of a sprawling leg's foot below its first bending joint, in leg lengths.
const DOWN: f64 = 0.5;

/// Joints that bend a leg: the largest group of revolute joints about parallel horizontal axes, at least two.
fn bending(leg: &Leg, axes: &[Vector3<f64>]) -> Option<Vec<usize>> {
    let level = |j: &usize| leg.chain[*j].turns && axes[*j].z.abs() < 0.5;
    let parallel = |to: usize| (0..axes.len()).filter(level).filter(|&j| axes[j].dot(&axes[to]).abs() > PARALLEL).collect::<Vec<_>>();
    // Of several groups of equal size the last is chosen: it contains the knee.
    (0..axes.len()).filter(level).map(parallel).max_by_key(Vec::len).filter(|joints| joints.len() > 1)
}

/// Desired foot position of a leg, whose height is a lower bound, and the joints that bend the leg.
struct StanceTarget {
    place: Vector3<f64>,
    joints: Vec<usize>,
}

fn aim(leg: &Leg, bent: f64) -> Option<StanceTarget> {
    let at = leg.posture(&leg.nominal());
    let joints = bending(leg, &at.axes)?;
    let (first, axis) = (at.anchors[joints[0]], at.axes[joints[0]]);
    let points: Vec<Vector3<f64>> = joints.iter().map(|&j| at.anchors[j]).chain([at.tip]).collect();
    let length: f64 = points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let out = at.tip - first;
    // The bending joints cannot change the offset along their axis.
    let aside = axis * axis.dot(&out);
    let flat = Vector3::new(out.x, out.y, 0.) - Vector3::new(aside.x, aside.y, 0.);
    let place = if flat.norm() > SPRAWLS * length {
        first + aside + flat.normalize() * (OUT * length) - Vector3::z() * (DOWN * length)
    } else {
        first + aside - Vector3::z() * (bent * length)
    };
    Some(StanceTarget { place, joints })
}

/// Joint values of each leg with which the robot stands on level ground; `None` if a leg cannot reach such a pose.
pub fn standing(legs: &[Leg]) -> Option<Vec<Vec<f64>>> {
    let bent = BENT[usize::from(legs.len() > 2)];
    // Angle of the first bending joint that shortens two equal links to this length.
    let angle = bent.acos();
    let aims: Vec<StanceTarget> = legs.iter().map(|leg| aim(leg, bent)).collect::<Option<_>>()?;
    let ground = aims.iter().map(|aim| aim.place.z).fold(f64::NEG_INFINITY, f64::max);
    let of_leg = |(leg, aim): (&Leg, &StanceTarget)| {
        let target = Vector3::new(aim.place.x, aim.place.y, ground);
        let folded = |sign: f64| {
            let mut q = leg.nominal();
            for (number, &j) in aim.joints.iter().enumerate() {
                // Bend there and back, so that links below keep their orientation.
                let by = [1., -2., 1.].get(number).copied().unwrap_or(0.) * sign * angle;
                // Axes may have either sign.
                let axis = leg.posture(&q).axes[j].dot(&leg.posture(&leg.nominal()).axes[aim.joints[0]]);
                q[j] += by * axis.signum();
            }
            q
        };
        let starts = [leg.nominal(), folded(-1.), folded(1.)];
        let reached = starts.iter().filter_map(|start| {
            let (q, missed) = leg.approach(&target, start);
            (missed <= 100. * PRECISION).then_some(q)
        });
        // The solution farthest from its limits; of two equal ones the first.
        let room = |q: &[f64]| {
            let of_joint = |(joint, v): (&crate::robot::leg::LegJoint, &f64)| (v - joint.limits[0]).min(joint.limits[1] - v);
            leg.chain.iter().zip(q).map(of_joint).fold(f64::INFINITY, f64::min)
        };
        reached.reduce(|best, q| if room(&q) > room(&best) + 1e-6 { q } else { best })
    };
    legs.iter().zip(&aims).map(of_leg).collect()
}
