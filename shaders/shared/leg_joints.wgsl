// needs: shared/math
// Joints of a leg in closed form, for the cost rows of torques and speeds.
// Twin: src/rows/leg_joints.rs

// Joints of a leg for one position of its foot, world frame.
struct LegJoints {
    // Axes of the first joint and of the other two, unit.
    first: vec3<f32>,
    second: vec3<f32>,
    // Columns of the Jacobian of the foot, m.
    columns: Mat3,
    // Rows of its inverse, 1/m.
    inverse: Mat3,
}

// Joints of a leg. Where the foot is out of reach, those of a nearly stretched leg.
//   rot_wb  base to world
//   foot    centre of the ball relative to the base, world frame, m
fn leg_joints(leg: JointLeg, rot_wb: Mat3, foot: vec3<f32>) -> LegJoints {
    let axis = vec3<f32>(leg.axis[0], leg.axis[1], leg.axis[2]);
    let nominal_across = vec3<f32>(leg.across[0], leg.across[1], leg.across[2]);
    let nominal_third = cross(axis, nominal_across);
    let r = mul_transposed(rot_wb, foot) - vec3<f32>(leg.anchor[0], leg.anchor[1], leg.anchor[2]);
    // Turn of the first joint: `second[1] (cos u + sin v) = offset - second[0] axis . r`.
    let u = dot(nominal_across, r);
    let v = dot(nominal_third, r);
    let around = u * u + v * v;
    let p = (leg.offset - leg.second[0] * dot(axis, r)) / leg.second[1];
    let q = leg.sides[0] * sqrt(max(around - p * p, LEAST_BEND * around));
    let norm = 1.0 / sqrt(around * (p * p + q * q));
    let cosine = (p * u - q * v) * norm;
    let sine = (p * v + q * u) * norm;
    let across = cosine * nominal_across + sine * nominal_third;
    let third = cross(axis, across);
    let second = leg.second[0] * axis + leg.second[1] * across;
    // The planar leg.
    let from_second = r - along(Mat3(axis, across, third), vec3<f32>(leg.arm[0], leg.arm[1], leg.arm[2]));
    let planar = from_second - dot(from_second, second) * second;
    let thigh = leg.links[0];
    let shank = leg.links[1];
    let square = max(dot(planar, planar), LEAST_BEND * thigh * thigh);
    let distance = sqrt(square);
    let ahead = (thigh * thigh - shank * shank + square) / (distance + distance);
    let aside = leg.sides[1] * sqrt(max(thigh * thigh - ahead * ahead, LEAST_BEND * thigh * thigh));
    let direction = (1.0 / distance) * planar;
    let from_third = from_second - (ahead * direction + aside * cross(second, direction));
    let columns = Mat3(mul(rot_wb, cross(axis, r)), mul(rot_wb, cross(second, from_second)), mul(rot_wb, cross(second, from_third)));
    let volume = cross(columns[1], columns[2]);
    let determinant = 1.0 / dot(columns[0], volume);
    let inverse =
        Mat3(determinant * volume, determinant * cross(columns[2], columns[0]), determinant * cross(columns[0], columns[1]));
    return LegJoints(mul(rot_wb, axis), mul(rot_wb, second), columns, inverse);
}

// Axis of joint j.
fn joint_axis(joints: LegJoints, j: u32) -> vec3<f32> {
    return select(joints.second, joints.first, j == 0u);
}

// Derivative with respect to joint k of the column of joint j, for a foot at to_contact from the centre of its ball.
//   to_contact  constant vector in the base frame, in world coordinates, m
fn column_by(joints: LegJoints, j: u32, k: u32, to_contact: vec3<f32>) -> vec3<f32> {
    var columns = joints.columns;
    let by_centre = cross(joint_axis(joints, min(k, j)), columns[max(k, j)]);
    // The last two axes are parallel: only the first joint turns them.
    if (k == 0u && j > 0u) {
        return by_centre + cross(cross(joints.first, joints.second), to_contact);
    }
    return by_centre;
}

// Excess of a share of a limit over FREE_SHARE, with its sign, and its derivative.
fn beyond(share: f32) -> vec2<f32> {
    let excess = abs(share) - FREE_SHARE;
    if (excess <= 0.0) {
        return vec2<f32>();
    }
    return vec2<f32>(select(excess, -excess, share < 0.0), 1.0);
}
