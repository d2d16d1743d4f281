// Vectors, matrices and Euler angles. WGSL has operators for sum, difference and multiple of vectors.
// Twin: src/rows/math.rs

// Quarter turn as a sum of three constants. Products of the first two with integers up to 2,048 are exact.
const QUARTER_HIGH: f32 = 1.5703125;
const QUARTER_MIDDLE: f32 = 0.0004838109;
const QUARTER_LOW: f32 = 1.5893255e-8;
const QUARTERS_PER_RADIAN: f32 = 0.63661977;

// Coefficients of `sin r = r + SINE_3 r^3 + ...` and `cos r = 1 - r^2 / 2 + COSINE_4 r^4 + ...` for `r` up to an eighth of a turn. They
// minimise the largest relative error (Remez exchange in r^2): 2^-28 and 2^-33, and 2^-26 and 2^-32 after rounding the coefficients to f32.
const SINE_3: f32 = -0.16666655;
const SINE_5: f32 = 0.00833216;
const SINE_7: f32 = -0.00019515282;
const COSINE_4: f32 = 0.041666646;
const COSINE_6: f32 = -0.0013887316;
const COSINE_8: f32 = 2.4433157e-5;

// 3 x 3 matrix by rows.
alias Mat3 = array<vec3<f32>, 3>;

// Dot product. The built-in function leaves the order of summation open.
fn dot(a: vec3<f32>, b: vec3<f32>) -> f32 {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

// Cross product. The built-in function may be fused.
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
    let turned = sin_cos(angles);
    let s = turned.sin;
    let c = turned.cos;
    let rot_wb = Mat3(
        vec3<f32>(c.y * c.z, s.x * s.y * c.z - c.x * s.z, c.x * s.y * c.z + s.x * s.z),
        vec3<f32>(c.y * s.z, s.x * s.y * s.z + c.x * c.z, c.x * s.y * s.z - s.x * c.z),
        vec3<f32>(-s.y, s.x * c.y, c.x * c.y),
    );
    let axes = Mat3(vec3<f32>(c.y * c.z, c.y * s.z, -s.y), vec3<f32>(-s.z, c.z, 0.0), vec3<f32>(0.0, 0.0, 1.0));
    return Euler(rot_wb, axes);
}

struct SinCos {
    sin: vec3<f32>,
    cos: vec3<f32>,
}

// Sine and cosine of angles within thirty turns. The error is at most two units in the last place within half a turn, and slightly larger
// beyond. The built-in functions may be off by 2^-11, and by any amount beyond half a turn.
fn sin_cos(angles: vec3<f32>) -> SinCos {
    let quarters = round(angles * QUARTERS_PER_RADIAN);
    let r = angles - quarters * QUARTER_HIGH - quarters * QUARTER_MIDDLE - quarters * QUARTER_LOW;
    let z = r * r;
    let s = r + r * z * (SINE_3 + z * (SINE_5 + z * SINE_7));
    let c = 1.0 - 0.5 * z + z * z * (COSINE_4 + z * (COSINE_6 + z * COSINE_8));
    // Quadrant, 0 to 3. Odd quadrants exchange sine and cosine; the last two negate the sine, the middle two the cosine.
    let quarter = quarters - 4.0 * floor(0.25 * quarters);
    let one = quarter == vec3<f32>(1.0);
    let two = quarter == vec3<f32>(2.0);
    let three = quarter == vec3<f32>(3.0);
    let sine = select(s, c, one | three);
    let cosine = select(c, s, one | three);
    return SinCos(select(sine, -sine, two | three), select(cosine, -cosine, one | two));
}

// `sum_i v[i] axes[i]`.
fn along(axes: Mat3, v: vec3<f32>) -> vec3<f32> {
    return v.x * axes[0] + v.y * axes[1] + v.z * axes[2];
}

// Matrix from its table entry.
fn mat3(m: array<array<f32, 3>, 3>) -> Mat3 {
    return Mat3(vec3<f32>(m[0][0], m[0][1], m[0][2]), vec3<f32>(m[1][0], m[1][1], m[1][2]), vec3<f32>(m[2][0], m[2][1], m[2][2]));
}
