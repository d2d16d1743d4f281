//! Everything elementwise between two factorisations: barrier weights, slack and multiplier steps, step length, merit, update.

use crate::nlp::{Layout, Real};
use multiversion::multiversion;

/// Barrier state of the inequalities, each `[inequalities]`.
#[derive(Debug, Default)]
pub struct Slacks<T> {
    /// Slacks `s`, positive.
    pub slack: Vec<T>,
    /// Multipliers `z`, positive.
    pub multiplier: Vec<T>,
    /// Steps of the slacks.
    pub slack_step: Vec<T>,
    /// Steps of the multipliers.
    pub multiplier_step: Vec<T>,
}

/// Smallest slack.
pub const SLACK_FLOOR: f64 = 1e-6;
/// Smallest multiplier.
pub const MULTIPLIER_FLOOR: f64 = 1e-8;

/// Spreads values of the inequalities over their Jacobian rows: `out[row] = upper +- lower`.
#[inline(always)]
fn per_row<T: Real>(layout: &Layout<T>, weight: &mut [T], value: &mut [T], of: impl Fn(usize) -> (T, T)) {
    for element in &layout.elements {
        let (rows, pairs) = (element.rows as usize, element.pairs as usize);
        let (row, at) = (element.place.row as usize, element.place.inequality as usize);
        if row < layout.equalities {
            continue;
        }
        for r in 0..rows {
            let (mut w, mut v) = of(at + r);
            if r < pairs {
                let lower = of(at + rows + r);
                w += lower.0;
                v -= lower.1;
            }
            weight[row + r] = w;
            value[row + r] = v;
        }
    }
}

/// Where a barrier step aims: at products `s z = mu - correction ds dz`, with the steps of the predictor.
#[derive(Debug, Clone, Copy)]
pub struct Aim<T> {
    /// Barrier parameter.
    pub mu: T,
    /// Share of the second-order term that is corrected for; 0 in the predictor itself.
    pub correction: T,
}

impl<T: Real> Aim<T> {
    #[inline(always)]
    fn product(&self, slacks: &Slacks<T>, i: usize) -> T {
        self.mu - self.correction * slacks.slack_step[i] * slacks.multiplier_step[i]
    }
}

/// Row weights of a barrier step: `W = rho` and `w = 1 / (s/z + 1/rho)`, `v = rho c` and `z + w (g - z/rho + mu/z)`, with `rho = 1`.
#[multiversion(targets("x86_64+avx2"))]
pub fn barrier_rows<T: Real>(layout: &Layout<T>, c: &[T], g: &[T], slacks: &Slacks<T>, aim: Aim<T>, weight: &mut [T], value: &mut [T]) {
    let one = T::one();
    weight[..layout.equalities].fill(one);
    value[..layout.equalities].copy_from_slice(c);
    per_row(layout, weight, value, |i| {
        let (s, z) = (slacks.slack[i], slacks.multiplier[i]);
        let w = one / (s / z + one);
        (w, z + w * (g[i] - z + aim.product(slacks, i) / z))
    });
}

/// What falls on single variables: `eps D + weight pull` and `weight pull (x - initial)`.
#[multiversion(targets("x86_64+avx2"))]
#[allow(clippy::too_many_arguments, reason = "separate slices: the compiler knows that they do not overlap")]
pub fn variable_terms<T: Real>(
    scaling: &[T],
    proximal: T,
    pull: &[T],
    weight: T,
    x: &[T],
    initial: &[T],
    diagonal: &mut [T],
    gradient: &mut [T],
) {
    for i in 0..diagonal.len() {
        let pull = weight * pull[i];
        diagonal[i] = proximal * scaling[i] + pull;
        gradient[i] = pull * (x[i] - initial[i]);
    }
}

/// Cost of being away from the initial values: `sum pull (x - initial)^2 / 2`.
#[multiversion(targets("x86_64+avx2"))]
pub fn pull_cost<T: Real>(pull: &[T], x: &[T], initial: &[T]) -> T {
    let mut lanes = [T::zero(); 8];
    for i in 0..pull.len() {
        let away = x[i] - initial[i];
        lanes[i % 8] += pull[i] * away * away;
    }
    T::of(0.5) * lanes.into_iter().sum::<T>()
}

/// Row weights of a closing step: the equalities and the violated inequalities.
#[multiversion(targets("x86_64+avx2"))]
pub fn closing_rows<T: Real>(layout: &Layout<T>, c: &[T], g: &[T], weight: &mut [T], value: &mut [T]) {
    let (zero, one) = (T::zero(), T::one());
    weight[..layout.equalities].fill(one);
    value[..layout.equalities].copy_from_slice(c);
    per_row(layout, weight, value, |i| if g[i] > zero { (one, g[i]) } else { (zero, zero) });
}

/// Products `J d`: for equalities in `c_change`, for inequalities (with the sign of their side) in `g_change`.
///
/// * `local` - scratch, `[widest]`
#[multiversion(targets("x86_64+avx2"))]
pub fn jacobian_times<T: Real>(layout: &Layout<T>, jacobian: &[T], d: &[T], local: &mut [T], c_change: &mut [T], g_change: &mut [T]) {
    for element in &layout.elements {
        let place = &element.place;
        let (rows, pairs) = (element.rows as usize, element.pairs as usize);
        let (row, at, stride) = (place.row as usize, place.inequality as usize, place.stride as usize);
        // The element's part of d; the padding of Jacobian rows is zero.
        local[..stride].fill(T::zero());
        for run in &layout.runs[element.runs.start as usize..element.runs.end as usize] {
            local[run.column as usize..(run.column + run.len) as usize]
                .copy_from_slice(&d[run.variable as usize..(run.variable + run.len) as usize]);
        }
        for r in 0..rows {
            let product = super::front::dot(&jacobian[place.jacobian as usize + r * stride..][..stride], &local[..stride]);
            if row < layout.equalities {
                c_change[row + r] = product;
            } else {
                g_change[at + r] = product;
                if r < pairs {
                    g_change[at + rows + r] = -product;
                }
            }
        }
    }
}

/// Steps of slacks and multipliers for `d`: `dz = w (J d + g - z/rho + mu/z)`, `ds = -(s - mu/z) - (s/z) dz`.
///
/// Returns the largest step in `(0, 1]` that keeps a twentieth of every slack and multiplier.
#[multiversion(targets("x86_64+avx2"))]
pub fn slack_steps<T: Real>(g: &[T], g_change: &[T], aim: Aim<T>, slacks: &mut Slacks<T>) -> T {
    let one = T::one();
    let count = g.len();
    let (s, z) = (&slacks.slack[..count], &slacks.multiplier[..count]);
    let (ds, dz) = (&mut slacks.slack_step[..count], &mut slacks.multiplier_step[..count]);
    let g_change = &g_change[..count];
    let mut steepest = [T::zero(); 8];
    for i in 0..count {
        let ratio = s[i] / z[i];
        let centre = (aim.mu - aim.correction * ds[i] * dz[i]) / z[i];
        let w = one / (ratio + one);
        dz[i] = w * (g_change[i] + g[i] - z[i] + centre);
        ds[i] = centre - s[i] - ratio * dz[i];
        // -change / value: the reciprocal of the step at which it reaches zero.
        let steep = (-ds[i] / s[i]).max(-dz[i] / z[i]);
        steepest[i % 8] = steepest[i % 8].max(steep);
    }
    let steepest = steepest.into_iter().fold(T::zero(), T::max);
    if steepest * T::of(1. / 0.95) > one { T::of(0.95) / steepest } else { one }
}

/// Transposed product `out = J' v`.
#[multiversion(targets("x86_64+avx2"))]
pub fn transposed_times<T: Real>(layout: &Layout<T>, jacobian: &[T], v: &[T], local: &mut [T], out: &mut [T]) {
    out.fill(T::zero());
    for element in &layout.elements {
        let place = &element.place;
        let (row, stride) = (place.row as usize, place.stride as usize);
        local[..stride].fill(T::zero());
        for r in 0..element.rows as usize {
            let v = v[row + r];
            let values = &jacobian[place.jacobian as usize + r * stride..][..stride];
            for (sum, value) in local[..stride].chunks_exact_mut(8).zip(values.chunks_exact(8)) {
                for l in 0..8 {
                    sum[l] += v * value[l];
                }
            }
        }
        for run in &layout.runs[element.runs.start as usize..element.runs.end as usize] {
            let (to, from, len) = (run.variable as usize, run.column as usize, run.len as usize);
            for i in 0..len {
                out[to + i] += local[from + i];
            }
        }
    }
}

/// Infeasibility `F = (|c|^2 + |max(g, 0)|^2) / 2`.
#[multiversion(targets("x86_64+avx2"))]
pub fn infeasibility<T: Real>(c: &[T], g: &[T]) -> T {
    let half = T::of(0.5);
    let mut lanes = [T::zero(); 8];
    for i in 0..g.len() {
        // Not `max`, which would drop a NaN.
        let over = if g[i] <= T::zero() { T::zero() } else { g[i] };
        lanes[i % 8] += over * over;
    }
    half * (super::front::dot(c, c) + lanes.into_iter().sum::<T>())
}

/// Smoothed merit `M = |c|^2 / 2 + sum phi(g)`, `phi(g) = (g + s)^2 / 2 - mu ln s` at the best slack `s = (q - g) / 2`,
/// `q = sqrt(g^2 + b^2)`, `b = 2 sqrt(mu)`. Its derivative is `(g + q) / 2`, a smooth `max(g, 0)`.
///
/// Logarithms are taken of products of eight slacks. In `f64`, for the products' sake.
#[multiversion(targets("x86_64+avx2"))]
pub fn merit<T: Real>(c: &[T], g: &[T], mu: T) -> f64 {
    let half = T::of(0.5);
    let b2 = T::of(4.) * mu;
    let mut squares = [T::zero(); 8];
    let mut logs = 0.;
    for chunk in g.chunks(8) {
        let mut slack = [T::one(); 8];
        for (l, &g) in chunk.iter().enumerate() {
            let q = (g * g + b2).sqrt();
            // The smaller of the two is b^2 / (4 larger): no cancellation.
            let larger = half * (q + g.abs());
            let smaller = mu / larger;
            let over = if g > T::zero() { larger } else { smaller };
            slack[l] = if g > T::zero() { smaller } else { larger };
            squares[l] += over * over;
        }
        let mut product = 1.;
        for s in slack {
            product *= s.as_f64();
        }
        logs += product.ln();
    }
    let squares = half * (super::front::dot(c, c) + squares.into_iter().sum::<T>());
    squares.as_f64() - mu.as_f64() * logs
}

/// Squared distance of residuals from their linear model: `(|c - c_lin|^2 + |g - g_lin|^2) / 2`.
#[multiversion(targets("x86_64+avx2"))]
pub fn nonlinearity<T: Real>(c: &[T], c_linear: &[T], g: &[T], g_linear: &[T]) -> T {
    let mut lanes = [T::zero(); 8];
    for (value, linear) in [(c, c_linear), (g, g_linear)] {
        for i in 0..value.len() {
            let gap = value[i] - linear[i];
            lanes[i % 8] += gap * gap;
        }
    }
    T::of(0.5) * lanes.into_iter().sum::<T>()
}

/// `a += b`.
#[multiversion(targets("x86_64+avx2"))]
pub fn add<T: Real>(a: &mut [T], b: &[T]) {
    for (a, b) in a.iter_mut().zip(b) {
        *a += *b;
    }
}

/// `out = a + step * b`.
#[multiversion(targets("x86_64+avx2"))]
pub fn advance<T: Real>(a: &[T], step: T, b: &[T], out: &mut [T]) {
    for i in 0..out.len() {
        out[i] = a[i] + step * b[i];
    }
}

/// Mean of the products `s z` after a step.
#[multiversion(targets("x86_64+avx2"))]
pub fn mean_product<T: Real>(slacks: &Slacks<T>, step: T) -> T {
    let count = slacks.slack.len();
    let mut lanes = [T::zero(); 8];
    for i in 0..count {
        let s = slacks.slack[i] + step * slacks.slack_step[i];
        let z = slacks.multiplier[i] + step * slacks.multiplier_step[i];
        lanes[i % 8] += s * z;
    }
    lanes.into_iter().sum::<T>() / T::of(count.max(1) as f64)
}

/// Moves slacks and multipliers along their steps, keeps them off zero, and returns their mean product.
#[multiversion(targets("x86_64+avx2"))]
pub fn update_slacks<T: Real>(slacks: &mut Slacks<T>, step: T) -> T {
    let count = slacks.slack.len();
    let mut lanes = [T::zero(); 8];
    let (slack_floor, multiplier_floor) = (T::of(SLACK_FLOOR), T::of(MULTIPLIER_FLOOR));
    for i in 0..count {
        let s = slacks.slack[i] + step * slacks.slack_step[i];
        let z = slacks.multiplier[i] + step * slacks.multiplier_step[i];
        lanes[i % 8] += s * z;
        slacks.slack[i] = s.max(slack_floor);
        slacks.multiplier[i] = z.max(multiplier_floor);
    }
    lanes.into_iter().sum::<T>() / T::of(count.max(1) as f64)
}

/// Column scaling `D_j = sum_eq J_ij^2 + 1/2 sum_ineq J_ij^2`, at least 1e-2.
#[multiversion(targets("x86_64+avx2"))]
pub fn column_scaling<T: Real>(layout: &Layout<T>, jacobian: &[T], diagonal: &mut [T]) {
    diagonal.fill(T::zero());
    for element in &layout.elements {
        let place = &element.place;
        for r in 0..element.rows as usize {
            // A two-sided row counts twice.
            let sides = if (place.row as usize) < layout.equalities || r < element.pairs as usize { T::one() } else { T::of(0.5) };
            let row = &jacobian[place.jacobian as usize + r * place.stride as usize..][..place.stride as usize];
            for run in &layout.runs[element.runs.start as usize..element.runs.end as usize] {
                for i in 0..run.len as usize {
                    let v = row[run.column as usize + i];
                    diagonal[run.variable as usize + i] += sides * v * v;
                }
            }
        }
    }
    for d in diagonal {
        *d = d.max(T::of(1e-2));
    }
}
