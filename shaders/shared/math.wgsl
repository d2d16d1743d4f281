// Vectors, matrices and Euler angles. Sum, difference and multiple are operators here.
// Twin: src/rows/math.rs

const TAU: f32 = 6.2831853;
// In two parts: whole turns times the first are exact.
const TAU_HIGH: f32 = 6.28125;
const TAU_LOW: f32 = 0.0019353072;

// Rows of a 3 x 3 matrix.
alias Mat3 = array<vec3<f32>, 3>;

// Dot product; the built-in one leaves the order of the sum open.
fn dot(a: vec3<f32>, b: vec3<f32>) -> f32 {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

// Cross product; the built-in one may be fused.
fn cross(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

// Matrix times vector.
fn mul(m: Mat3, a: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot(m[0], a), dot(m[1], a), dot(m[2], a));
}

// Transposed matrix times vector.
fn mul_transposed(m: Mat3, a: vec3<f32>) -> vec3<f32> {
    return a.x * m[0] + a.y * m[1] + a.z * m[2];
}

struct Euler {
    rot_wb: Mat3,
    axes: Mat3,
}

// Rotation `Rz(yaw) Ry(pitch) Rx(roll)` from base to world, and the axes about which the angles turn, in world coordinates.
//
// `omega = axes[0] roll' + axes[1] pitch' + axes[2] yaw'`, and `d rot / d angle_i = [axes[i]]x rot`.
fn euler(angles: vec3<f32>) -> Euler {
    let a = reduced(angles);
    let s = sin(a);
    let c = cos(a);
    let rot_wb = Mat3(
        vec3<f32>(c.y * c.z, s.x * s.y * c.z - c.x * s.z, c.x * s.y * c.z + s.x * s.z),
        vec3<f32>(c.y * s.z, s.x * s.y * s.z + c.x * c.z, c.x * s.y * s.z - s.x * c.z),
        vec3<f32>(-s.y, s.x * c.y, c.x * c.y),
    );
    let axes = Mat3(vec3<f32>(c.y * c.z, c.y * s.z, -s.y), vec3<f32>(-s.z, c.z, 0.0), vec3<f32>(0.0, 0.0, 1.0));
    return Euler(rot_wb, axes);
}

// Angles within half a turn, where WGSL promises an accuracy of sine and cosine; those that are there stay as they are.
fn reduced(angles: vec3<f32>) -> vec3<f32> {
    let turns = round(angles / TAU);
    return angles - turns * TAU_HIGH - turns * TAU_LOW;
}

// `sum_i v[i] axes[i]`.
fn along(axes: Mat3, v: vec3<f32>) -> vec3<f32> {
    return v.x * axes[0] + v.y * axes[1] + v.z * axes[2];
}

// A matrix from its table.
fn mat3(m: array<array<f32, 3>, 3>) -> Mat3 {
    return Mat3(vec3<f32>(m[0][0], m[0][1], m[0][2]), vec3<f32>(m[1][0], m[1][1], m[1][2]), vec3<f32>(m[2][0], m[2][1], m[2][2]));
}
