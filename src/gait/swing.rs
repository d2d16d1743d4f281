//! Law of a swing: horizontal speed and acceleration of a foot between two footholds.

/// Horizontal speed of a foot in mid-swing, relative to its mean speed.
///
/// One cubic from rest to rest has 1.5. The slower the foot is in mid-swing, the faster it leaves the ground, and the less the moving base
/// drags it out of reach at first. With 1.5, 1, 0.75, 0.5 and 0.25, 3, 5, 9, 9 and 9 of 16 reference candidates were solved on s1, and 2,
/// 3, 5, 5 and 4 on s3. The smaller the value, the higher the top speed, which is lowest near 1.
pub const MID_SPEED: f64 = 0.75;

/// Largest horizontal speed in a swing, relative to the mean speed: maximum of `v(u) = (6 - 2 c) u - (6 - 3 c) u^2` in each half, with `c`
/// = [`MID_SPEED`].
pub const TOP_SPEED: f64 = (6. - 2. * MID_SPEED) * (6. - 2. * MID_SPEED) / (4. * (6. - 3. * MID_SPEED));

/// Acceleration at lift-off and touchdown, in step lengths per squared swing duration: derivative of the `v(u)` of [`TOP_SPEED`] at its
/// ends, `4 (3 - c)`.
pub const TOP_ACCELERATION: f64 = 4. * (3. - MID_SPEED);
