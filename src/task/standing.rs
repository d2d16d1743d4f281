//! Standing pose on the ground: base parallel to the ground, or level on soles, at a height from which the feet reach it.

use super::state::BaseState;
use crate::robot::Robot;
use crate::terrain::Terrain;

/// Largest default tilt along the ground, rad.
const LARGEST_TILT: f64 = 0.6;

/// Distance of a corrected height from both ends of the range that the feet reach, relative to the range.
const INSIDE: f64 = 0.25;

/// Base at rest above a point, parallel to the ground under its nominal feet, at the robot's base height above the ground or the closest
/// height from which all feet reach the ground.
///
/// * `fixed_feet` - true if the feet are at their nominal positions, false if they may be anywhere in reach
/// * `tilt` - roll and pitch, rad. Default: along the ground
pub(super) fn standing(
    robot: &Robot,
    terrain: &Terrain,
    [x, y]: [f64; 2],
    yaw: f64,
    tilt: Option<[f64; 2]>,
    fixed_feet: bool,
) -> BaseState {
    let mut state = BaseState::level([x, y, robot.base_height + terrain.height(x, y)], yaw);
    if !terrain.has_edges() && tilt.is_none() {
        return state;
    }
    let [roll, pitch] = tilt.unwrap_or_else(|| {
        let heights: Vec<f64> = (0..robot.feet()).map(|foot| ground_under(robot, terrain, &state, foot)).collect();
        tilt_over(robot, &heights)
    });
    state.angles = [roll, pitch, yaw];
    if tilt.is_some() || state.angles[..2] != [0.; 2] {
        state.position[2] += mean_height(robot, terrain, &state);
    }
    let [low, high] = heights(robot, terrain, &state, fixed_feet);
    let height = state.position[2];
    if low < high && !(low..=high).contains(&height) {
        // Keeps a distance from the ends of the reachable range.
        let inside = INSIDE * (high - low);
        state.position[2] = height.clamp(low + inside, high - inside);
    }
    state
}

/// Roll and pitch of the plane closest to the ground under the nominal feet, rad; zero if the ground has equal height there, and for a
/// robot with soles: its few feet must stay under its centre of mass.
///
/// * `heights` - height of the ground under each nominal foot, m
pub(crate) fn tilt_over(robot: &Robot, heights: &[f64]) -> [f64; 2] {
    if robot.sole.is_some() || heights.iter().all(|h| (h - heights[0]).abs() < 1e-9) {
        return [0.; 2];
    }
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / heights.len() as f64;
    let center = [0, 1].map(|i| mean(&mut robot.nominal_feet.iter().map(|foot| foot[i])));
    let height = mean(&mut heights.iter().copied());
    // Least squares over the feet. If the feet are in a line, the slope across it is zero.
    let (mut xx, mut xy, mut yy, mut xh, mut yh) = (0., 0., 0., 0., 0.);
    for (foot, h) in robot.nominal_feet.iter().zip(heights) {
        let (x, y, h) = (foot[0] - center[0], foot[1] - center[1], h - height);
        (xx, xy, yy, xh, yh) = (xx + x * x, xy + x * y, yy + y * y, xh + x * h, yh + y * h);
    }
    let determinant = xx * yy - xy * xy;
    let [along, across] = if determinant > 1e-6 * (xx + yy).powi(2) {
        [(yy * xh - xy * yh) / determinant, (xx * yh - xy * xh) / determinant]
    } else {
        // All feet are on a line with direction d: the slope along it is sum (d.p) h / sum (d.p)^2.
        let angle = 0.5 * (2. * xy).atan2(xx - yy);
        let (sin, cos) = angle.sin_cos();
        let slope = (cos * xh + sin * yh) / (xx + yy).max(1e-12);
        [slope * cos, slope * sin]
    };
    let pitch = -along.atan();
    let roll = (across * pitch.cos()).atan();
    [roll.clamp(-LARGEST_TILT, LARGEST_TILT), pitch.clamp(-LARGEST_TILT, LARGEST_TILT)]
}

/// Height of the ground under the nominal position of a foot, m.
pub(super) fn ground_under(robot: &Robot, terrain: &Terrain, state: &BaseState, foot: usize) -> f64 {
    let [x, y, _] = state.to_world(robot.nominal_feet[foot]);
    terrain.height(x, y)
}

/// Height to add to the base so that its height above the ground, averaged over the nominal feet, is the robot's base height, m.
fn mean_height(robot: &Robot, terrain: &Terrain, state: &BaseState) -> f64 {
    let excess = |foot: usize| {
        let [x, y, z] = state.to_world(robot.nominal_feet[foot]);
        // The base height may exceed the depth of the nominal feet.
        let above = robot.base_height + robot.nominal_feet[foot][2];
        terrain.height(x, y) + above - z
    };
    (0..robot.feet()).map(excess).sum::<f64>() / robot.feet() as f64
}

/// Height of the ground at a point, measured from the base along its own vertical, m. For a level base it is the terrain height.
pub(super) fn ground_at(terrain: &Terrain, state: &BaseState, [x, y]: [f64; 2]) -> f64 {
    let [ux, uy, uz] = state.rotation().map(|row| row[2]);
    terrain.height(x, y) + ((x - state.position[0]) * ux + (y - state.position[1]) * uy) / uz
}

/// Lowest and highest ground under a foot, m, measured from the base along its own vertical: under the nominal position, or anywhere in the
/// foot's reach along x and y.
pub(super) fn ground_of_foot(robot: &Robot, terrain: &Terrain, state: &BaseState, foot: usize, fixed_feet: bool) -> [f64; 2] {
    let (nominal, reach) = (robot.nominal_feet[foot], robot.reach.of(foot));
    let (center, half_widths) = (reach.center(), reach.half_widths());
    // Ground at a point of the box; u and v are -1 and 1 at its sides.
    let height = |u: f64, v: f64| {
        let along = |axis: usize, part: f64| nominal[axis] + center[axis] + part.clamp(-1., 1.) * half_widths[axis];
        let at = [along(0, u), along(1, v), nominal[2]];
        let [x, y, _] = state.to_world(at);
        ground_at(terrain, state, [x, y])
    };
    if fixed_feet {
        let [x, y, _] = state.to_world(nominal);
        return [ground_at(terrain, state, [x, y]); 2];
    }
    // Samples over the whole box, then refines around the best one.
    [-1., 1.].map(|sign| {
        let mut best = (sign * height(0., 0.), 0., 0.);
        let mut look = |center: (f64, f64), width: f64, samples: i32| {
            for i in -samples..=samples {
                for j in -samples..=samples {
                    let (u, v) =
                        (center.0 + width * f64::from(i) / f64::from(samples), center.1 + width * f64::from(j) / f64::from(samples));
                    let value = sign * height(u, v);
                    if value > best.0 {
                        best = (value, u, v);
                    }
                }
            }
            (best.1, best.2)
        };
        let mut at = look((0., 0.), 1., 20);
        for width in [0.05, 0.0125, 0.003] {
            at = look(at, width, 4);
        }
        sign * best.0
    })
}

/// Lowest and highest base position from which every foot reaches the ground, m. The first exceeds the second if no height fits.
pub(super) fn heights(robot: &Robot, terrain: &Terrain, state: &BaseState, fixed_feet: bool) -> [f64; 2] {
    let upright = state.rotation()[2][2];
    (0..robot.feet()).fold([f64::NEG_INFINITY, f64::INFINITY], |[low, high], foot| {
        let [lowest, highest] = ground_of_foot(robot, terrain, state, foot, fixed_feet);
        let (nominal, reach) = (robot.nominal_feet[foot][2], robot.reach.of(foot));
        [low.max(lowest - (nominal + reach.high[2]) / upright), high.min(highest - (nominal + reach.low[2]) / upright)]
    })
}
