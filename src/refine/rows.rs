//! Rows of a point to first order in all variables, including durations.
//!
//! Derivatives with respect to the problem's variables are the Jacobians of the elements. Those with respect to phase boundaries and the
//! interval are central differences of rebuilt problems; rows are matched by their meaning, not by their position. A boundary affects only
//! nearby rows, so boundaries far apart share one difference.
//!
//! The Jacobian of the elements treats the deviation of the base from its cubic inside intervals as constant. This is good enough to find a
//! motion, but not to optimise it: without the derivatives of the deviation the last steps towards an optimum bring half of the predicted
//! decrease, however short they are. Central differences per interval add them.

use super::convex_cost::Gradient;
use super::variables::{Point, Space};
use crate::error::Result;
use crate::nlp::Problem;
use crate::nlp::transcription::momentum::reach_timings;
use crate::rows::math::{Vec3, add, dot, scale, sub};
use crate::rows::momentum::{Deviation, MomentumInterval};
use crate::rows::reach::ReachInstant;
use crate::rows::table::{NONE, Place, Span};
use crate::rows::{RowKind, Shared, Spec, Tables};
use crate::rows::{
    acceleration, cone, effort, footing, force, joint_speed, joint_torque, momentum, reach, residuals, stance_power, stride, swing,
    swing_power,
};
use crate::solver::objective::Objective;
use crate::terrain::Ground;
use rayon::prelude::*;
use std::collections::HashMap;
use std::ops::Range;

/// Step of the central differences, in intervals for a boundary and relative for the interval.
const DIFFERENCE: f64 = 1e-5;

/// Step of the forward differences, in the same units.
const FORWARD_DIFFERENCE: f64 = 1e-6;

/// Derivatives smaller than this are dropped.
const NOTHING: f64 = 1e-12;

/// Derivatives from deviations smaller than this are dropped.
const SMALL: f64 = 1e-6;

/// `value + by . dv`: zero for an equality, at most zero for an inequality. A two-sided row is also at least `-room`.
#[derive(Debug, Clone)]
pub(super) struct Row {
    pub value: f64,
    /// Value of the lower side, at most zero.
    pub lower: Option<f64>,
    pub by: Gradient,
}

/// A friction cone: `|(value_1, value_2, value_3, m)| <= value_0`, each value linear.
#[derive(Debug, Clone)]
pub(super) struct Cone {
    /// `mu n.f - m`, then the tangential force.
    pub value: [f64; 4],
    pub by: [Gradient; 4],
    /// Margin that rounds the tip of the cone.
    pub margin: f64,
}

/// All rows around a point.
#[derive(Debug, Clone, Default)]
pub(super) struct Linear {
    pub equalities: Vec<Row>,
    pub inequalities: Vec<Row>,
    pub cones: Vec<Cone>,
}

/// Rows of an element, with their meaning.
pub(super) struct Known {
    pub place: Place,
    pub spec: Spec,
    /// Number of linearised rows.
    pub rows: usize,
    pairs: usize,
    /// Times at which phase boundaries can affect the rows, in intervals.
    pub window: Range<f64>,
}

impl Known {
    /// Values of the rows, and of their lower sides, from arrays of all rows.
    ///
    /// * `c`, `g` - as in [`crate::solver::Residuals`]
    pub fn values<'a>(&'a self, c: &'a [f64], g: &'a [f64]) -> impl Iterator<Item = (f64, Option<f64>)> + 'a {
        let (row, at) = (self.place.row as usize, self.place.inequality as usize);
        (0..self.rows).map(move |r| match self.spec.kind {
            RowKind::Inequality => (g[at + r], (r < self.pairs).then(|| g[at + self.spec.rows + r])),
            RowKind::Equality | RowKind::Cost => (c[row + r], None),
        })
    }
}

/// Values of rows and of their lower sides.
pub(super) type Values = Vec<(f64, Option<f64>)>;

/// All constraints in an order that does not depend on durations.
pub(super) fn known(space: &Space, problem: &Problem<f64>) -> Vec<Known> {
    let curves = &problem.curves;
    let mut all = Vec::new();
    for (k, interval) in problem.momentum_intervals.iter().enumerate() {
        for (place, spec) in [(interval.linear, momentum::LINEAR), (interval.angular, momentum::ANGULAR)] {
            all.push(Known { place, spec, rows: spec.rows, pairs: 0, window: k as f64..k as f64 + 1. });
        }
    }
    let phases: Vec<_> = curves.feet.iter().map(|f| &f.phases[..]).collect();
    let timings = reach_timings(&phases, curves.interval, curves.intervals);
    let mut numbered: Vec<_> = timings.iter().zip(&problem.reach_rows.instants).collect();
    numbered.sort_by_key(|(timing, _)| timing.number);
    for (_, instant) in numbered {
        let k = f64::from(problem.reach_rows.blocks_of(instant).interval);
        for element in instant.elements.range() {
            let place = problem.reach_rows.place(element);
            all.push(Known { place, spec: reach::SPEC, rows: 3, pairs: 3, window: k..k + 1. });
        }
    }
    for node in &problem.cones {
        all.push(Known { place: node.place, spec: cone::SPEC, rows: 1, pairs: 1, window: 0.0..0. });
    }
    for node in &problem.swing_nodes {
        all.push(Known { place: node.place, spec: swing::SPEC, rows: 1, pairs: node.two_sided as usize, window: 0.0..0. });
    }
    for footing in &problem.footings {
        all.push(Known { place: footing.place, spec: footing::SPEC, rows: 2, pairs: 2, window: 0.0..0. });
    }
    let swings = (0..curves.feet.len()).flat_map(|foot| curves.feet[foot].phases.iter().filter(|p| !p.stance));
    let windows: Vec<Range<f64>> = swings.map(|swing| swing.start / curves.interval..swing.end / curves.interval).collect();
    for (stride, window) in problem.strides.iter().zip(&windows) {
        all.push(Known { place: stride.place, spec: stride::SPEC, rows: 1, pairs: 0, window: window.clone() });
    }
    for (acceleration, window) in problem.accelerations.iter().zip(&windows) {
        all.push(Known { place: acceleration.place, spec: acceleration::SPEC, rows: 2, pairs: 0, window: window.clone() });
    }
    for node in &problem.force_nodes {
        all.push(Known { place: node.place, spec: force::SPEC, rows: force::SPEC.rows, pairs: force::SPEC.pairs, window: 0.0..0. });
    }
    debug_assert_eq!(space.intervals, curves.intervals);
    all
}

/// Parts of the cost, each with the times at which phase boundaries can affect it, in intervals: the powers in every interval, then the
/// effort of every stance. Their number does not depend on the durations, as that of the cost rows does.
///
/// * `c` - residuals of the problem
pub(super) fn cost_parts(problem: &Problem<f64>, c: &[f64], objective: &Objective<f64>) -> Vec<(Range<f64>, f64)> {
    let curves = &problem.curves;
    let first = problem.rows.of(RowKind::Cost).start;
    let cost = |place: &Place, spec: Spec| {
        let rows = place.row as usize..place.row as usize + spec.rows;
        rows.map(|row| objective.of_row(c[row], problem.cost_weights[row - first])).sum::<f64>()
    };
    let mut parts: Vec<(Range<f64>, f64)> = (0..curves.intervals).map(|k| (k as f64..k as f64 + 1., 0.)).collect();
    for power in &problem.stance_powers {
        parts[power.base.interval as usize].1 += cost(&power.place, stance_power::SPEC);
    }
    for power in &problem.swing_powers {
        parts[power.base.interval as usize].1 += cost(&power.place, swing_power::SPEC);
    }
    for torque in &problem.joint_torques {
        parts[torque.base.interval as usize].1 += cost(&torque.place, joint_torque::SPEC);
    }
    for speed in &problem.joint_speeds {
        parts[speed.base.interval as usize].1 += cost(&speed.place, joint_speed::SPEC);
    }
    let mut efforts = problem.efforts.iter();
    for foot in &curves.feet {
        for (stance, nodes) in foot.phases.iter().step_by(2).zip(&foot.force_nodes) {
            // Problems without a weight of the effort have none of these rows.
            let of_stance = efforts.by_ref().take(nodes.iter().filter(|node| **node != NONE).count());
            let window = stance.start / curves.interval..stance.end / curves.interval;
            parts.push((window, of_stance.map(|effort| cost(&effort.place, effort::SPEC)).sum()));
        }
    }
    parts
}

/// Residuals at a point.
pub(super) struct Residuals {
    pub c: Vec<f64>,
    pub g: Vec<f64>,
    jacobian: Vec<f64>,
    shared: Shared<f64>,
}

impl Residuals {
    /// Residuals of a problem at `x`, with or without the Jacobian.
    pub fn new(problem: &Problem<f64>, x: &[f64], derivatives: bool) -> Residuals {
        let mut shared = Shared::default();
        shared.resize(problem);
        let (mut c, mut g) = (vec![0.; problem.rows.one_sided()], vec![0.; problem.inequalities]);
        let mut jacobian = vec![0.; if derivatives { problem.jacobian_len } else { 0 }];
        residuals(problem, x, 0., &mut shared, &mut c, &mut g, derivatives.then_some(&mut jacobian[..]));
        Residuals { c, g, jacobian, shared }
    }

    /// Largest scaled violation.
    pub fn violation(&self) -> f64 {
        let c = self.c.iter().map(|c| c.abs());
        c.chain(self.g.iter().map(|g| g.max(0.))).fold(0., f64::max)
    }

    pub fn values(&self, known: &[Known]) -> Values {
        known.iter().flat_map(|element| element.values(&self.c, &self.g)).collect()
    }
}

/// Linearised rows around a point.
pub(super) fn linear(space: &Space, point: &Point) -> Result<Linear> {
    let problem = &point.problem;
    let here = Residuals::new(problem, &point.x, true);
    let known = known(space, problem);
    let columns = space.columns(problem);
    let mut element_of = vec![NONE; problem.rows.all()];
    for (i, element) in problem.all_elements().enumerate() {
        element_of[element.place.row as usize] = i as u32;
    }
    let runs = problem.columns();
    let mut rows: Vec<Row> = Vec::new();
    for (element, at) in known.iter().map(|e| (e, element_of[e.place.row as usize] as usize)) {
        for r in 0..element.rows {
            let mut by = Gradient::new();
            for (run, weight) in &runs[at] {
                for i in 0..run.len as usize {
                    let value =
                        here.jacobian[element.place.jacobian as usize + r * element.place.stride as usize + run.column as usize + i];
                    let (variable, scale) = columns[run.variable as usize + i];
                    if value != 0. {
                        by.push((variable, weight * value * scale));
                    }
                }
            }
            rows.push(Row { value: 0., lower: None, by });
        }
    }
    let bends = bends(problem, &point.x, &here, &element_of);
    add_deviations(problem, &here, &known, &bends, &columns, &mut rows);
    let values = here.values(&known);
    for (row, value) in rows.iter_mut().zip(&values) {
        (row.value, row.lower) = *value;
    }
    by_times(space, point, &known, &values, &mut rows)?;
    let mut linear = Linear { cones: cones(problem, &point.x, &here.shared.ground, &columns), ..Linear::default() };
    let mut rows = rows.into_iter();
    for element in &known {
        let into = match element.spec.kind {
            RowKind::Equality => &mut linear.equalities,
            RowKind::Inequality => &mut linear.inequalities,
            RowKind::Cost => continue,
        };
        into.extend(rows.by_ref().take(element.rows));
    }
    linear.inequalities.extend(shortest_phases(space, point));
    linear.inequalities.extend(interval_limits(space, point));
    Ok(linear)
}

/// Derivatives of the deviation in one interval: position in `x`, and change of the pose at the inner points and of the mean angular
/// momentum.
type Bends = Vec<(usize, Deviation<f64>)>;

/// Derivatives of the deviations of all intervals.
fn bends(problem: &Problem<f64>, x: &[f64], here: &Residuals, element_of: &[u32]) -> Vec<Bends> {
    let of_interval = |interval: &MomentumInterval<f64>| {
        let element = &problem.elements[element_of[interval.angular.row as usize] as usize];
        let positions = problem.runs[element.runs.range()].iter().flat_map(|run| run.variable as usize..(run.variable + run.len) as usize);
        // Tables with a single interval.
        let mut tables = Tables::new(problem.constants, problem.terrain.clone(), problem.curves.interval);
        tables.footholds.clone_from(&problem.footholds);
        tables.impulses = problem.impulses[interval.impulses.range()].to_vec();
        let alone = MomentumInterval {
            impulses: Span::added(0, &tables.impulses),
            moments: Span::default(),
            linear: Place::default(),
            angular: Place { row: momentum::LINEAR.rows as u32, ..Place::default() },
            ..*interval
        };
        tables.momentum_intervals = vec![alone];
        let (mut x, mut ground) = (x.to_vec(), here.shared.ground.clone());
        let mut rows = [0.; momentum::LINEAR.rows + momentum::ANGULAR.rows];
        let bend = |at: usize| {
            let foothold = problem.footholds.iter().position(|&f| f as usize == at || f as usize + 1 == at);
            let before = x[at];
            let mut moved = |to: f64| {
                x[at] = to;
                if let Some(f) = foothold {
                    let at = problem.footholds[f] as usize;
                    ground[f] = problem.terrain.ground(x[at], x[at + 1]);
                }
                let mut deviation = [Deviation::default()];
                momentum::momentum(&tables, &x, &ground, &mut deviation, false, &mut rows, None);
                deviation[0]
            };
            let (up, down) = (moved(before + DIFFERENCE), moved(before - DIFFERENCE));
            moved(before);
            let slope = |up: f64, down: f64| (up - down) / (2. * DIFFERENCE);
            let pose = std::array::from_fn(|q| std::array::from_fn(|d| slope(up.pose[q][d], down.pose[q][d])));
            (at, Deviation { pose, mean: std::array::from_fn(|d| slope(up.mean[d], down.mean[d])) })
        };
        positions.map(bend).collect()
    };
    problem.momentum_intervals.par_iter().map(of_interval).collect()
}

/// Interval of each momentum and reach row; `None` for other rows. In the order of [`linear`].
#[cfg(feature = "ipopt")]
pub(super) fn intervals(space: &Space, problem: &Problem<f64>) -> Vec<Option<usize>> {
    let known = known(space, problem);
    let of = |kind: RowKind| {
        let elements = known.iter().filter(move |e| e.spec.kind == kind);
        elements.flat_map(|e| vec![(e.window.end == e.window.start + 1.).then_some(e.window.start as usize); e.rows])
    };
    // Rows of the shortest phases come after all others.
    of(RowKind::Equality).chain(of(RowKind::Inequality)).chain(std::iter::repeat_n(None, 16 * known.len())).collect()
}

/// Adds the derivatives of the deviations to the rows of the mean angular momentum and of reach.
fn add_deviations(problem: &Problem<f64>, here: &Residuals, known: &[Known], bends: &[Bends], columns: &[(usize, f64)], rows: &mut [Row]) {
    let mut first = HashMap::new();
    let mut row = 0;
    for element in known {
        first.insert(element.place.row, row);
        row += element.rows;
    }
    let mut put = |place: &Place, r: usize, at: usize, value: f64| {
        let (variable, scale) = columns[at];
        if let Some(row) = first.get(&place.row)
            && (value * scale).abs() > SMALL
        {
            rows[row + r].by.push((variable, value * scale));
        }
    };
    let mean_scale = 2. * problem.constants.moment_scale / problem.constants.interval;
    for (interval, bends) in problem.momentum_intervals.iter().zip(bends) {
        for (at, bend) in bends {
            (0..3).for_each(|d| put(&interval.angular, 3 + d, *at, bend.mean[d] * mean_scale));
        }
    }
    for (ReachInstant { deviation_weights: weights, .. }, instant) in problem.reach_instants.iter().zip(&problem.reach_rows.instants) {
        for (at, bend) in &bends[problem.reach_rows.blocks_of(instant).interval as usize] {
            let pose: [f64; 6] = std::array::from_fn(|d| weights.iter().zip(&bend.pose).map(|(w, pose)| w * pose[d]).sum());
            if pose.iter().all(|p| p.abs() < 0.01 * SMALL) {
                continue;
            }
            for element in instant.elements.range() {
                let place = problem.reach_rows.place(element);
                // The first columns are those of the pose.
                let (by_pose, stride) = (&here.jacobian[place.jacobian as usize..], place.stride as usize);
                for r in 0..3 {
                    put(&place, r, *at, (0..6).map(|d| by_pose[r * stride + d] * pose[d]).sum());
                }
            }
        }
    }
}

/// Boundaries that share no row: variable, and the times at which it affects rows, in intervals.
type Colour = Vec<(usize, Range<f64>)>;

/// Groups of phase boundaries such that no two of a group affect the same row.
fn colours(space: &Space, point: &Point) -> Vec<Colour> {
    let h = point.schedule.interval();
    let mut all: Colour = Vec::new();
    for (foot, of_foot) in space.variables.feet.iter().enumerate() {
        let phases = &point.problem.curves.feet[foot].phases;
        for (i, variable) in of_foot.boundaries.iter().enumerate() {
            if let Some(at) = variable {
                all.push((*at, (phases[i].start / h - 1e-3).floor()..(phases[i + 1].end / h + 1e-3).ceil()));
            }
        }
    }
    all.sort_by(|a, b| a.1.start.total_cmp(&b.1.start).then(a.0.cmp(&b.0)));
    let mut colours: Vec<Colour> = Vec::new();
    for boundary in all {
        match colours.iter_mut().find(|c| c.last().is_none_or(|last| last.1.end <= boundary.1.start)) {
            Some(colour) => colour.push(boundary),
            None => colours.push(vec![boundary]),
        }
    }
    colours
}

/// Adds the derivatives with respect to phase boundaries and the interval.
fn by_times(space: &Space, point: &Point, known_here: &[Known], here: &Values, rows: &mut [Row]) -> Result<()> {
    let values = |problem: &Problem<f64>, x: &[f64]| -> Vec<f64> {
        Residuals::new(problem, x, false).values(&known(space, problem)).iter().map(|(value, _)| *value).collect()
    };
    let windows: Vec<Range<f64>> = known_here.iter().flat_map(|e| std::iter::repeat_n(e.window.clone(), e.rows)).collect();
    let here: Vec<f64> = here.iter().map(|(value, _)| *value).collect();
    by_group(space, point, &windows, &here, &values, Sides::Both, &mut |row, variable, value| rows[row].by.push((variable, value)))
}

/// Points whose difference is a derivative.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Sides {
    /// Central differences.
    Both,
    /// Forward differences, which need half as many problems.
    Ahead,
}

/// Derivatives of values with respect to phase boundaries and the interval.
///
/// * `windows` - times at which phase boundaries can affect each value, in intervals
/// * `here` - values at the point
/// * `values` - values of a problem at `x`
/// * `sides` - differences to take
/// * `put` - takes each derivative: index of the value, variable, derivative
pub(super) fn by_group(
    space: &Space,
    point: &Point,
    windows: &[Range<f64>],
    here: &[f64],
    values: &(impl Fn(&Problem<f64>, &[f64]) -> Vec<f64> + Sync),
    sides: Sides,
    put: &mut dyn FnMut(usize, usize, f64),
) -> Result<()> {
    let everywhere = f64::NEG_INFINITY..f64::INFINITY;
    let interval = space.variables.interval.map(|at| vec![(at, everywhere)]);
    let groups: Vec<Colour> = colours(space, point).into_iter().chain(interval).collect();
    let moved = |group: &Colour, sign: f64| -> Result<(f64, Vec<f64>)> {
        let mut v = point.v.clone();
        let unit = if group.first().is_some_and(|(at, _)| Some(*at) == space.variables.interval) { v[group[0].0] } else { 1. };
        let step = unit * if sides == Sides::Both { DIFFERENCE } else { FORWARD_DIFFERENCE };
        group.iter().for_each(|(at, _)| v[*at] += sign * step);
        let there = space.point(v)?;
        Ok((step, values(&there.problem, &there.x)))
    };
    let same = |there: &Vec<f64>| there.len() == here.len();
    let differences = groups.par_iter().map(|group| {
        let (step, up) = moved(group, 1.)?;
        let down = if sides == Sides::Both || !same(&up) { Some(moved(group, -1.)?.1) } else { None };
        // A one-sided difference is used if the number of values changes on the other side.
        let (up, down, width) = match (Some(&up).filter(|up| same(up)), down.as_ref().filter(|down| same(down))) {
            (Some(up), Some(down)) => (&up[..], &down[..], 2. * step),
            (Some(up), None) => (&up[..], here, step),
            (None, Some(down)) => (here, &down[..], step),
            (None, None) => (here, here, step),
        };
        Ok(up.iter().zip(down).map(|(up, down)| (up - down) / width).collect())
    });
    let differences: Vec<Vec<f64>> = differences.collect::<Result<_>>()?;
    for (group, difference) in groups.iter().zip(&differences) {
        for (i, (element, value)) in windows.iter().zip(difference).enumerate() {
            let touches = |window: &Range<f64>| window.start < element.end && element.start < window.end;
            let everywhere = |window: &Range<f64>| window.start == f64::NEG_INFINITY;
            if let Some((at, _)) = group.iter().find(|(_, window)| everywhere(window) || touches(window))
                && value.abs() > NOTHING
            {
                put(i, *at, *value);
            }
        }
    }
    Ok(())
}

/// Friction cones at force nodes and beside them, as in [`cone`].
fn cones(problem: &Problem<f64>, x: &[f64], ground: &[Ground<f64>], columns: &[(usize, f64)]) -> Vec<Cone> {
    let constants = &problem.constants;
    let (friction, margin) = (constants.friction, constants.force_margin);
    let of = |node: &cone::Cone<f64>| {
        let at = node.node as usize;
        let force: Vec3<f64> = std::array::from_fn(|d| x[at + d] + node.slope_weight * x[at + 3 + d]);
        let [n, ..] = crate::rows::force::basis(&ground[node.foothold as usize]);
        let normal = dot(n.unit, force);
        let tangential = sub(force, scale(normal, n.unit));
        let value = [friction * normal - margin, tangential[0], tangential[1], tangential[2]];
        let mut by: [Gradient; 4] = Default::default();
        let mut put = |variable: usize, derivative: [f64; 4]| {
            for (by, d) in by.iter_mut().zip(derivative) {
                if d != 0. {
                    by.push((variable, d));
                }
            }
        };
        for part in 0..2 {
            let weight = if part == 0 { 1. } else { node.slope_weight };
            for d in 0..3 {
                let t: Vec3<f64> = std::array::from_fn(|i| weight * (f64::from(u8::from(i == d)) - n.unit[d] * n.unit[i]));
                put(columns[at + 3 * part + d].0, [friction * weight * n.unit[d], t[0], t[1], t[2]]);
            }
        }
        let under = problem.footholds[node.foothold as usize] as usize;
        for d in (0..2).filter(|d| under + d < problem.variables) {
            let by_n = dot(n.by[d], force);
            let t = scale(-1., add(scale(by_n, n.unit), scale(normal, n.by[d])));
            put(columns[under + d].0, [friction * by_n, t[0], t[1], t[2]]);
        }
        Cone { value, by, margin }
    };
    problem.cones.iter().map(of).collect()
}

/// Row for the range of the interval, if it is a variable.
pub(super) fn interval_limits(space: &Space, point: &Point) -> Option<Row> {
    let ([low, high], h) = (space.interval_limits(), point.schedule.interval());
    let row = |at| Row { value: (h - high) / space.interval, lower: Some((low - h) / space.interval), by: vec![(at, 1. / space.interval)] };
    space.variables.interval.map(row)
}

/// Rows for the shortest phases: `shortest - (end - start) h <= 0`, in initial intervals.
pub(super) fn shortest_phases<'a>(space: &'a Space, point: &'a Point) -> impl Iterator<Item = Row> + 'a {
    let h = point.schedule.interval();
    let feet = space.variables.feet.iter().enumerate();
    feet.flat_map(move |(foot, of_foot)| {
        let phases = &point.problem.curves.feet[foot].phases;
        (0..phases.len()).filter_map(move |i| {
            let (start, end) = (i.checked_sub(1).and_then(|b| of_foot.boundaries[b]), of_foot.boundaries.get(i).copied().flatten());
            let mut by = Gradient::new();
            by.extend(start.map(|at| (at, h / space.interval)));
            by.extend(end.map(|at| (at, -h / space.interval)));
            by.extend(space.variables.interval.map(|at| (at, -phases[i].duration() / h / space.interval)));
            let value = (space.shortest[foot][i] - phases[i].duration()) / space.interval;
            (!by.is_empty()).then_some(Row { value, lower: None, by })
        })
    })
}
