//! The refinement as a smooth nonlinear program, for comparisons with Ipopt.
//!
//! Variables, rows and cost are those of the refinement with two exceptions: absolute values of powers are rounded, `sqrt(power^2 +
//! rounding^2)`, because Ipopt needs continuous derivatives; and friction cones are formulated as the solver's rows. Phase boundaries move
//! by less than one base interval, so that the sparsity pattern is fixed: the entries of a row are all variables that can affect it within
//! that range.

use super::RefineSettings;
use super::convex_cost::Price;
use super::rows;
use super::variables::{Point, Space};
use crate::error::Result;
use crate::gait::AlignedSchedule;
use crate::gait::cost::CostWeights;
use crate::nlp::Problem;
use crate::nlp::transcription::momentum::PIECE;
use crate::reference::ipopt;
use crate::reference::nlp::{INFINITY, Nlp, Options, Rows, Statistics, Variables};
use crate::settings::{Friction, TranscriptionSettings};
use crate::task::Task;

/// Largest displacement of a phase boundary, in intervals.
const FARTHEST: f64 = 0.9;

/// Refinement problem around a gait.
#[derive(Debug)]
pub(super) struct Program<'a> {
    space: &'a Space<'a>,
    price: &'a Price<'a>,
    /// Rounding of powers, J per point of a cell.
    pub rounding: f64,
    variables: Variables,
    /// Variables of each row.
    entries: Vec<Vec<usize>>,
}

impl<'a> Program<'a> {
    pub fn new(space: &'a Space<'a>, price: &'a Price<'a>, point: &Point, rounding: f64) -> Result<Self> {
        let length = &space.variables.step;
        let initial: Vec<f64> = point.v.iter().zip(length).map(|(v, l)| v / l).collect();
        let mut bounds = vec![[-INFINITY, INFINITY]; initial.len()];
        for at in space.variables.feet.iter().flat_map(|f| &f.boundaries).flatten() {
            bounds[*at] = [initial[*at] - FARTHEST / length[*at], initial[*at] + FARTHEST / length[*at]];
        }
        if let Some(at) = space.variables.interval {
            bounds[at] = space.interval_limits().map(|h| h / length[at]);
        }
        // Variables that affect the neighbouring intervals.
        let linear = rows::linear(space, point)?;
        let locals: Vec<Vec<usize>> = (0..space.intervals).map(|k| price.locals(point, k)).collect();
        let interval_of = rows::intervals(space, &point.problem);
        let held = space.variables.feet.iter().flat_map(|f| &f.boundaries).all(Option::is_none);
        // Without boundaries that move, a row stays in its interval.
        let width = if held { 0 } else { 2 };
        let rows = linear.equalities.iter().chain(&linear.inequalities);
        let entries = rows.zip(&interval_of).map(|(row, interval)| {
            let mut all: Vec<usize> = row.by.iter().map(|(i, _)| *i).collect();
            if let Some(k) = *interval {
                all.extend(locals[k.saturating_sub(width)..(k + width + 1).min(locals.len())].iter().flatten());
            }
            all.sort_unstable();
            all.dedup();
            all
        });
        Ok(Program { space, price, rounding, variables: Variables { initial, bounds }, entries: entries.collect() })
    }

    fn point(&self, x: &[f64]) -> Option<Point> {
        self.space.point(x.iter().zip(&self.space.variables.step).map(|(x, l)| x * l).collect()).ok()
    }

    /// Largest violation of a row, and the cost without rounding.
    #[cfg(test)]
    pub fn judged(&self, x: &[f64]) -> Option<(f64, f64, Point)> {
        let point = self.point(x)?;
        Some((rows::Residuals::new(&point.problem, &point.x, false).violation(), self.price.value(&point, 0.), point))
    }
}

impl Nlp for Program<'_> {
    fn variables(&self) -> &Variables {
        &self.variables
    }

    fn rows(&self, x: &[f64], rows: &mut Rows) {
        let linear = self.point(x).and_then(|point| rows::linear(self.space, &point).ok());
        let length = &self.space.variables.step;
        let mut dense = vec![0.; x.len()];
        let count = self.entries.len();
        let Some(linear) = linear else {
            for entries in &self.entries {
                rows.row(f64::NAN, [0., 0.]);
                entries.iter().for_each(|&i| rows.entry(i, 0.));
            }
            return;
        };
        let equalities = linear.equalities.iter().map(|r| (r, true));
        for ((row, equality), entries) in equalities.chain(linear.inequalities.iter().map(|r| (r, false))).zip(&self.entries).take(count) {
            row.by.iter().for_each(|&(i, d)| dense[i] += d * length[i]);
            let low = match row.lower {
                _ if equality => 0.,
                // The lower side is `-value - room <= 0`.
                Some(lower) => row.value + lower,
                None => -INFINITY,
            };
            rows.row(row.value, [low, 0.]);
            entries.iter().for_each(|&i| rows.entry(i, dense[i]));
            row.by.iter().for_each(|&(i, _)| dense[i] = 0.);
        }
        for cone in &linear.cones {
            // |t| - mu n + m, rounded by the margin.
            let [room, t @ ..] = cone.value;
            let size = (t.iter().map(|t| t * t).sum::<f64>() + cone.margin * cone.margin).sqrt();
            rows.row(size - room, [-INFINITY, 0.]);
            for (value, by) in [-1., t[0] / size, t[1] / size, t[2] / size].into_iter().zip(&cone.by) {
                by.iter().for_each(|&(i, d)| rows.entry(i, value * d * length[i]));
            }
        }
    }

    fn objective(&self, x: &[f64], gradient: Option<&mut [f64]>) -> f64 {
        let Some(point) = self.point(x) else { return f64::NAN };
        if gradient.is_none() {
            return self.price.sum(&point, &|power| power.hypot(self.rounding));
        }
        let model = self.price.model(&point, 0.);
        let value = model.effort + model.terms.iter().map(|t| t.weight * t.value.hypot(self.rounding)).sum::<f64>();
        let Some(gradient) = gradient else { return value };
        let length = &self.space.variables.step;
        let mut by = model.effort_by;
        for term in &model.terms {
            let size = term.value.hypot(self.rounding);
            term.by.iter().for_each(|&(i, d)| by[i] += term.weight * term.value / size * d);
        }
        gradient.iter_mut().zip(by).zip(length).for_each(|((g, d), l)| *g = d * l);
        value
    }
}

/// Minimises the cost of a gait with its durations held by Ipopt. Returns the values of the variables, as in [`Problem::initial`].
///
/// * `x` - initial point; `None`: the initial values of the problem
/// * `transcription` - settings of the problem, with `momentum` rows. Friction is the exact cone whatever the settings say
/// * `rounding` - rounding of absolute values of powers, m/s times the weight, over a piece of `PIECE` seconds
///
/// # Errors
/// [`crate::Error::Invalid`] if the schedule does not fit the task.
pub fn minimise(
    task: &Task,
    (schedule, x): (&AlignedSchedule, Option<&[f64]>),
    transcription: &TranscriptionSettings,
    weights: &CostWeights,
    rounding: f64,
    options: &Options,
) -> Result<(Vec<f64>, Statistics)> {
    let held = RefineSettings { durations: false, horizon: false, ..RefineSettings::default() };
    let cones = TranscriptionSettings { friction: Some(Friction::Cone), ..transcription.clone() };
    let space = Space::new(task, schedule, &cones, &held);
    let price = Price::new(&space, weights, task.robot.leg_mass());
    let x = x.map_or_else(|| Problem::<f64>::new(task, schedule, &cones).initial, <[f64]>::to_vec);
    let point = space.start(schedule, &x);
    let program = Program::new(&space, &price, &point, rounding * task.robot.weight() * 0.5 * PIECE)?;
    let (end, statistics) = ipopt::solve(&program, None, options)?;
    let end = space.point(end.iter().zip(&space.variables.step).map(|(x, length)| x * length).collect())?;
    Ok((end.x, statistics))
}
