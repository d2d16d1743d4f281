//! Plots of experiments in the paper's form, as SVG.

use super::plan::{Case, Group};
use super::run::Run;
use super::summary::{Line, Spread, lines, title, with};
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::search::cem::Objective;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, ValueFormatter};
use plotters::prelude::*;

/// Width of every plot, pixels.
const WIDTH: u32 = 900;
/// Height of a box, of a foot's bar, pixels.
const BAR: u32 = 26;
/// Height of what stands around a panel, pixels.
const MARGIN: u32 = 90;
/// Height of a panel of curves, pixels.
const CURVES: u32 = 320;
/// One colour a method or setting.
const PALETTE: [RGBColor; 6] = [
    RGBColor(31, 119, 180),
    RGBColor(214, 39, 40),
    RGBColor(44, 160, 44),
    RGBColor(148, 103, 189),
    RGBColor(255, 127, 14),
    RGBColor(23, 190, 207),
];

/// An error of the plotting library as ours.
fn failed(error: impl std::fmt::Display) -> Error {
    Error::Format { message: format!("plot: {error}") }
}

/// A vertical axis of rows with names, the first on top; row `i` has its middle at `i + 0.5`.
#[derive(Clone)]
struct NamedRows(Vec<String>);

impl Ranged for NamedRows {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (low, high): (i32, i32)) -> i32 {
        let part = value / self.0.len().max(1) as f64;
        high + (part * f64::from(low - high)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        (0..self.0.len()).map(|i| i as f64 + 0.5).collect()
    }

    fn range(&self) -> std::ops::Range<f64> {
        0.0..self.0.len() as f64
    }
}

impl ValueFormatter<f64> for NamedRows {
    fn format_ext(&self, place: &f64) -> String {
        self.0.get(place.floor().max(0.) as usize).cloned().unwrap_or_default()
    }
}

/// Panels, one under the other, each with its height.
fn panels<'a>(text: &'a mut String, heights: &[u32]) -> Result<Vec<DrawingArea<SVGBackend<'a>, plotters::coord::Shift>>> {
    let root = SVGBackend::with_string(text, (WIDTH, heights.iter().sum::<u32>().max(1))).into_drawing_area();
    root.fill(&WHITE).map_err(failed)?;
    let mut rest = root;
    let mut areas = Vec::new();
    for &height in heights {
        let (area, below) = rest.split_vertically(height);
        areas.push(area);
        rest = below;
    }
    Ok(areas)
}

/// Times to the first feasible motion: a panel a scenario, a box a method; whiskers to the extremes, crosses for runs that found none.
///
/// # Errors
/// [`Error::Format`] when the library cannot draw.
pub fn times(runs: &[Run]) -> Result<String> {
    let lines = lines(runs);
    let scenarios: Vec<&[Line]> = lines.chunk_by(|a, b| a.group.scenario == b.group.scenario).collect();
    let heights: Vec<u32> = scenarios.iter().map(|lines| MARGIN + BAR * lines.len() as u32).collect();
    let all = Spread::of(runs.iter().map(Run::first_or_all)).ok_or_else(|| failed("no runs"))?;
    let heuristics = runs.iter().any(|run| run.case.heuristic) && runs.iter().any(|run| !run.case.heuristic);
    let mut text = String::new();
    for (area, lines) in panels(&mut text, &heights)?.iter().zip(scenarios) {
        let name = |group: &Group| match (heuristics, group.heuristic) {
            (false, _) => group.method.name().to_owned(),
            (true, true) => format!("{}, heuristic", group.method),
            (true, false) => format!("{}, none", group.method),
        };
        let names: Vec<String> = lines.iter().map(|line| name(&line.group)).collect();
        let mut chart = ChartBuilder::on(area)
            .caption(format!("{}: time to the first feasible motion, s", lines[0].group.scenario), ("sans-serif", 16))
            .margin(8)
            .x_label_area_size(28)
            .y_label_area_size(170)
            .build_cartesian_2d((all.min * 0.7..all.max * 1.4).log_scale(), NamedRows(names))
            .map_err(failed)?;
        let mut mesh = chart.configure_mesh();
        mesh.disable_y_mesh().x_label_formatter(&|t| format!("{t}"));
        mesh.draw().map_err(failed)?;
        for (i, line) in lines.iter().enumerate() {
            let Some(s) = Spread::of(line.runs.iter().map(|run| run.first_or_all())) else { continue };
            let (color, middle) = (PALETTE[line.group.method as usize % PALETTE.len()], i as f64 + 0.5);
            let path = |points| PathElement::new(points, color.stroke_width(2));
            let whiskers = [vec![(s.min, middle), (s.lower, middle)], vec![(s.upper, middle), (s.max, middle)]];
            chart.draw_series(whiskers.map(path)).map_err(failed)?;
            chart
                .draw_series([Rectangle::new([(s.lower, middle - 0.3), (s.upper, middle + 0.3)], color.mix(0.35).filled())])
                .map_err(failed)?;
            chart.draw_series([path(vec![(s.median, middle - 0.3), (s.median, middle + 0.3)])]).map_err(failed)?;
            let lost = line.runs.iter().filter(|run| !run.success);
            chart.draw_series(lost.map(|run| Cross::new((run.seconds, middle), 4, BLACK.filled()))).map_err(failed)?;
        }
    }
    Ok(text)
}

/// Best cost so far over generations: a panel an objective, a curve a setting; medians with the band between the quartiles.
///
/// A generation counts from the first at which half the runs have a feasible gait: penalties of infeasible ones would hide the rest.
///
/// # Errors
/// [`Error::Format`] when the library cannot draw.
pub fn objectives(runs: &[Run]) -> Result<String> {
    let lines = lines(runs);
    let panels_of: Vec<&[Line]> = lines.chunk_by(|a, b| a.group.objective == b.group.objective).collect();
    let mut text = String::new();
    for (area, lines) in panels(&mut text, &vec![CURVES; panels_of.len()])?.iter().zip(panels_of) {
        let objective = lines[0].group.objective;
        let curves: Vec<Vec<(f64, Spread)>> = lines.iter().map(|line| curve(line)).collect();
        let points = || curves.iter().flatten();
        let Some(range) = Spread::of(points().flat_map(|(_, s)| [s.lower, s.upper])) else { continue };
        let generations = points().map(|(g, _)| *g).fold(1., f64::max);
        let pad = 0.05 * (range.max - range.min).max(1e-9);
        let mut chart = ChartBuilder::on(area)
            .caption(format!("{}: best so far, median and quartiles of the runs", title(objective)), ("sans-serif", 16))
            .margin(8)
            .x_label_area_size(32)
            .y_label_area_size(60)
            .build_cartesian_2d(1f64..generations, range.min - pad..range.max + pad)
            .map_err(failed)?;
        chart.configure_mesh().x_desc("generation").x_label_formatter(&|g| format!("{g:.0}")).draw().map_err(failed)?;
        for (i, (line, curve)) in lines.iter().zip(&curves).enumerate() {
            let color = PALETTE[i % PALETTE.len()];
            let band = curve.iter().map(|(g, s)| (*g, s.lower)).chain(curve.iter().rev().map(|(g, s)| (*g, s.upper)));
            chart.draw_series([Polygon::new(band.collect::<Vec<_>>(), color.mix(0.2))]).map_err(failed)?;
            let group = &line.group;
            let name = format!("population {}, {} heuristic, {} generations", group.population, with(group.heuristic), group.generations);
            chart
                .draw_series(LineSeries::new(curve.iter().map(|(g, s)| (*g, s.median)), color.stroke_width(2)))
                .map_err(failed)?
                .label(name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], color.stroke_width(2)));
        }
        let mut labels = chart.configure_series_labels();
        labels.position(SeriesLabelPosition::LowerLeft).background_style(WHITE.mix(0.8)).border_style(BLACK).draw().map_err(failed)?;
    }
    Ok(text)
}

/// Generation, from 1, with the spread of the costs that the runs had reached.
fn curve(line: &Line) -> Vec<(f64, Spread)> {
    let penalty = line.runs[0].case.search().map_or(0., |settings| settings.penalty);
    let longest = line.runs.iter().map(|run| run.best_objectives.len()).max().unwrap_or(0);
    let at = |generation: usize| {
        // Any violation costs a penalty, more than all stances or forces together.
        let reached = line.runs.iter().filter_map(|run| run.best_objectives.get(generation).copied().flatten());
        let costs: Vec<f64> = reached.map(|j| -j).filter(|cost| *cost < penalty).collect();
        let enough = 2 * costs.len() >= line.runs.len();
        Spread::of(costs).filter(|_| enough).map(|spread| (generation as f64 + 1., spread))
    };
    (0..longest).filter_map(at).collect()
}

/// Gaits: stance bars of each foot over time, one panel for the best run of each group that found one.
///
/// # Errors
/// [`Error::Format`] when the library cannot draw.
pub fn gaits(runs: &[Run]) -> Result<String> {
    let lines = lines(runs);
    let best = |line: &Line| {
        let found = line.runs.iter().filter(|run| run.success && !run.durations.is_empty());
        // The lowest cost; of equals the first. Baselines have none.
        let cost = |run: &Run| run.cost().unwrap_or(0.);
        found.copied().cloned().reduce(|a, b| if cost(&b) < cost(&a) { b } else { a })
    };
    let winners: Vec<Run> = lines.iter().filter_map(best).collect();
    let heights: Vec<u32> = winners.iter().map(|run| MARGIN + BAR * run.durations.len() as u32).collect();
    let mut text = String::new();
    for (area, run) in panels(&mut text, &heights)?.iter().zip(&winners) {
        let schedule = Schedule::new(run.durations.clone())?;
        let names: Vec<String> = (0..schedule.feet()).map(|foot| format!("foot {foot}")).collect();
        let caption = match run.case.objective {
            Objective::Feasibility => {
                let target = run.case.target.map(|t| format!(", target {t}")).unwrap_or_default();
                format!("{}{target}, {}, heuristic: {}", run.case.scenario, run.case.method, run.case.heuristic)
            }
            _ => {
                let Case { population, generations, heuristic, .. } = run.case;
                format!("{}, population {population}, {generations} generations, heuristic: {heuristic}", title(run.case.objective))
            }
        };
        let caption = format!("{caption}, seed {}: {} stance phases", run.case.seed, run.stances());
        let mut chart = ChartBuilder::on(area)
            .caption(caption, ("sans-serif", 15))
            .margin(8)
            .x_label_area_size(28)
            .y_label_area_size(50)
            .build_cartesian_2d(0f64..schedule.horizon(), NamedRows(names))
            .map_err(failed)?;
        chart.configure_mesh().disable_y_mesh().x_desc("s").draw().map_err(failed)?;
        for foot in 0..schedule.feet() {
            let bars = schedule.phases(foot).into_iter().filter(|phase| phase.stance);
            let bar = |phase: crate::gait::schedule::Phase| {
                Rectangle::new([(phase.start, foot as f64 + 0.2), (phase.end, foot as f64 + 0.8)], PALETTE[0].filled())
            };
            chart.draw_series(bars.map(bar)).map_err(failed)?;
        }
    }
    Ok(text)
}
