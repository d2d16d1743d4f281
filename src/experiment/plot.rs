//! Plots of experiments in the paper's form, as SVG.

use super::plan::{Case, Group, Method};
use super::run::Run;
use super::summary::{Line, Spread, lines, title, with};
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::report::samples::{FOOT_COLORS, foot_names};
use crate::report::svg::{AXIS, GRID, Picture, SMALL, Scale, short, with_room};
use crate::robot::Robot;
use crate::scenario::Scenario;
use crate::search::cem::Objective;

/// Width of every picture, pixels.
const WIDTH: f64 = 980.;
/// Height of a box or of a foot's bar, pixels.
const BAR: f64 = 24.;
/// Heights of a caption, of the axis below a panel, and of the gap between panels, pixels.
const CAPTION: f64 = 26.;
const AXIS_ROOM: f64 = 42.;
const GAP: f64 = 12.;
/// Height of a panel of curves, pixels.
const CURVES: f64 = 300.;
/// Style of captions.
const HEAD: &str = r##"font-size="14" font-weight="bold" fill="#111""##;
/// Style of explanations.
const NOTE: &str = r##"font-size="11.5" fill="#555""##;

/// Colour of a method by its rows and solver. Variants of one method share it.
fn color(method: Method) -> &'static str {
    match method {
        Method::Cregopt | Method::Random | Method::NoStall => FOOT_COLORS[0],
        Method::CregoptTowr | Method::RandomTowr | Method::NoStallTowr => FOOT_COLORS[5],
        Method::Ipopt | Method::RandomIpopt => FOOT_COLORS[1],
        Method::Towr => FOOT_COLORS[2],
        Method::ContactImplicit => FOOT_COLORS[4],
    }
}

/// Description of a method without code marks.
fn words(method: Method) -> String {
    method.about().replace('`', "")
}

/// Draws the frame of a panel over its curves.
fn frame(p: &mut Picture, [left, top]: [f64; 2], [right, bottom]: [f64; 2]) {
    p.box_of([left, top], [right, bottom], r##"fill="none" stroke="#333" stroke-width="1""##);
}

/// Times to the first feasible motion: one panel per scenario, one box per method, whiskers to the extremes, crosses for runs that found
/// none.
///
/// # Errors
/// [`Error::Format`] without runs.
pub fn times(runs: &[Run]) -> Result<String> {
    const LEFT: f64 = 370.;
    const RIGHT: f64 = WIDTH - 20.;
    let lines = lines(runs);
    let scenarios: Vec<&[Line]> = lines.chunk_by(|a, b| a.group.scenario == b.group.scenario).collect();
    let all = Spread::of(runs.iter().map(Run::first_or_all)).ok_or_else(|| Error::Format { message: "plot: no runs".into() })?;
    let heuristics = runs.iter().any(|run| run.case.heuristic) && runs.iter().any(|run| !run.case.heuristic);
    let panel = |lines: &[Line]| CAPTION + BAR * lines.len() as f64 + AXIS_ROOM + GAP;
    let mut p = Picture::new(WIDTH, 24. + scenarios.iter().map(|lines| panel(lines)).sum::<f64>());
    let note = "line: median; box: quartiles; whiskers: extremes; cross: nothing found, all its time";
    p.text(RIGHT, 16., "end", NOTE, note);
    let x = Scale { low: all.min * 0.7, high: all.max * 1.4, pixels: [LEFT, RIGHT], log: true };
    let mut top = 24.;
    for lines in scenarios {
        let scenario = &lines[0].group.scenario;
        let about = Scenario::named(scenario).map(|s| format!(": {}", s.about)).unwrap_or_default();
        p.text(20., top + 16., "start", HEAD, &format!("{scenario}{about}"));
        let (first, bottom) = (top + CAPTION, top + CAPTION + BAR * lines.len() as f64);
        for tick in x.ticks(0) {
            // Powers of ten are labelled; 3 is also labelled if there is room.
            let ten = (tick.log10() - tick.log10().round()).abs() < 1e-9;
            p.line([x.at(tick), first], [x.at(tick), bottom], GRID);
            if ten || x.high / x.low < 100. && tick.to_string().ends_with('3') {
                p.line([x.at(tick), bottom], [x.at(tick), bottom + 5.], AXIS);
                p.text(x.at(tick), bottom + 18., "middle", SMALL, &short(tick));
            }
        }
        p.text((LEFT + RIGHT) / 2., bottom + 35., "middle", SMALL, "time to the first feasible motion, s");
        for (i, line) in lines.iter().enumerate() {
            let Some(s) = Spread::of(line.runs.iter().map(|run| run.first_or_all())) else { continue };
            let middle = first + BAR * (i as f64 + 0.5);
            let Group { method, heuristic, .. } = line.group;
            let name = if heuristics { format!("{}, {} heuristic", words(method), with(heuristic)) } else { words(method) };
            p.text(LEFT - 10., middle + 4., "end", SMALL, &name);
            let stroke = format!(r#"stroke="{}" stroke-width="2""#, color(method));
            for [from, to] in [[s.min, s.lower], [s.upper, s.max]] {
                p.line([x.at(from), middle], [x.at(to), middle], &stroke);
            }
            let fill = format!(r#"fill="{}" fill-opacity="0.35""#, color(method));
            p.box_of([x.at(s.lower), middle - 0.3 * BAR], [x.at(s.upper), middle + 0.3 * BAR], &fill);
            p.line([x.at(s.median), middle - 0.3 * BAR], [x.at(s.median), middle + 0.3 * BAR], &stroke);
            for run in line.runs.iter().filter(|run| !run.success) {
                for sign in [-1., 1.] {
                    let at = x.at(run.seconds);
                    p.line([at - 4., middle - 4. * sign], [at + 4., middle + 4. * sign], r#"stroke="black" stroke-width="1.3""#);
                }
            }
        }
        frame(&mut p, [LEFT, first], [RIGHT, bottom]);
        top += panel(lines);
    }
    Ok(p.finish())
}

/// Best cost so far over generations: one panel per objective, one curve per setting, with medians and a band between the quartiles.
///
/// Curves begin at the first generation in which half the runs have a feasible gait. Penalties of infeasible ones would hide the rest.
///
/// # Errors
/// [`Error::Format`] without runs.
pub fn objectives(runs: &[Run]) -> Result<String> {
    const LEFT: f64 = 70.;
    const RIGHT: f64 = 670.;
    let lines = lines(runs);
    if lines.is_empty() {
        return Err(Error::Format { message: "plot: no runs".into() });
    }
    let panels: Vec<&[Line]> = lines.chunk_by(|a, b| a.group.objective == b.group.objective).collect();
    let mut p = Picture::new(WIDTH, (CAPTION + CURVES + AXIS_ROOM + GAP) * panels.len() as f64);
    let mut start = 0.;
    for (number, lines) in panels.into_iter().enumerate() {
        let (top, bottom) = (start + CAPTION, start + CAPTION + CURVES);
        start = bottom + AXIS_ROOM + GAP;
        let curves: Vec<Vec<(f64, Spread)>> = lines.iter().map(|line| curve(line)).collect();
        let points = || curves.iter().flatten();
        let objective = lines[0].group.objective;
        p.text(LEFT, top - 9., "start", HEAD, title(objective));
        p.text(RIGHT + 16., top + 10., "start", NOTE, "best so far: median, and quartiles of the runs");
        let Some(range) = with_room(points().flat_map(|(_, s)| [s.lower, s.upper]), 0.05) else { continue };
        let generations = points().map(|(g, _)| *g).fold(2., f64::max);
        let x = Scale::straight([1., generations], [LEFT, RIGHT]);
        let y = Scale::straight(range, [bottom, top]);
        for v in x.ticks(12).into_iter().filter(|v| v.fract() == 0.) {
            p.line([x.at(v), top], [x.at(v), bottom], GRID);
            p.text(x.at(v), bottom + 18., "middle", SMALL, &short(v));
        }
        // Stance phases are counted, so the axis has no fractional ticks.
        for v in y.ticks(8).into_iter().filter(|v| objective != Objective::FewestStances || v.fract() == 0.) {
            p.line([LEFT, y.at(v)], [RIGHT, y.at(v)], GRID);
            p.text(LEFT - 8., y.at(v) + 4., "end", SMALL, &short(v));
        }
        p.text((LEFT + RIGHT) / 2., bottom + 35., "middle", SMALL, "generation");
        p.begin_clip(&format!("panel{number}"), [LEFT, top], [RIGHT, bottom]);
        for (i, curve) in curves.iter().enumerate() {
            let lower = curve.iter().map(|(g, s)| [x.at(*g), y.at(s.lower)]);
            let band: Vec<[f64; 2]> = lower.chain(curve.iter().rev().map(|(g, s)| [x.at(*g), y.at(s.upper)])).collect();
            p.polygon(&band, &format!(r#"fill="{}" fill-opacity="0.18""#, FOOT_COLORS[i % FOOT_COLORS.len()]));
        }
        for (i, curve) in curves.iter().enumerate() {
            let medians: Vec<_> = curve.iter().map(|(g, s)| Some([x.at(*g), y.at(s.median)])).collect();
            p.curve(&medians, &format!(r#"stroke="{}" stroke-width="2""#, FOOT_COLORS[i % FOOT_COLORS.len()]));
        }
        p.end_clip();
        frame(&mut p, [LEFT, top], [RIGHT, bottom]);
        for (i, line) in lines.iter().enumerate() {
            let Group { population, heuristic, generations, .. } = &line.group;
            let at = top + 34. + 20. * i as f64;
            let style = format!(r#"stroke="{}" stroke-width="2.4""#, FOOT_COLORS[i % FOOT_COLORS.len()]);
            p.line([RIGHT + 16., at - 4.], [RIGHT + 40., at - 4.], &style);
            let name = format!("{population} candidates, {generations} generations, {} heuristic", with(*heuristic));
            p.text(RIGHT + 46., at, "start", r##"font-size="11" fill="#333""##, &name);
        }
    }
    Ok(p.finish())
}

/// Generations, from 1, with the spread of the costs reached by the runs.
fn curve(line: &Line) -> Vec<(f64, Spread)> {
    let penalty = line.runs[0].case.search().map_or(0., |settings| settings.penalty);
    let longest = line.runs.iter().map(|run| run.best_objectives.len()).max().unwrap_or(0);
    let at = |generation: usize| {
        // Any violation adds a penalty larger than all stance phases or forces together.
        let reached = line.runs.iter().filter_map(|run| run.best_objectives.get(generation).copied().flatten());
        let costs: Vec<f64> = reached.map(|j| -j).filter(|cost| *cost < penalty).collect();
        let enough = 2 * costs.len() >= line.runs.len();
        Spread::of(costs).filter(|_| enough).map(|spread| (generation as f64 + 1., spread))
    };
    (0..longest).filter_map(at).collect()
}

/// Caption of a gait: what it is the best of.
fn caption(run: &Run) -> String {
    let Case { scenario, target, method, heuristic, objective, population, generations, seed, .. } = &run.case;
    let heuristic = with(*heuristic);
    let what = match objective {
        Objective::Feasibility => {
            let target = target.map(|t| format!(", target {t}")).unwrap_or_default();
            format!("{scenario}{target}: {}, {heuristic} heuristic", words(*method))
        }
        _ => format!("{}: {population} candidates, {generations} generations, {heuristic} heuristic", title(*objective)),
    };
    format!("{what}, seed {seed}: {} stance phases", run.stances())
}

/// Gaits as stance bars of each foot over time: one panel for the best run of each group that found one.
///
/// # Errors
/// [`Error::Invalid`] for an invalid schedule, [`Error::Unknown`] for an unknown robot.
pub fn gaits(runs: &[Run]) -> Result<String> {
    const LEFT: f64 = 60.;
    const RIGHT: f64 = WIDTH - 20.;
    let lines = lines(runs);
    let best = |line: &Line| {
        let found = line.runs.iter().filter(|run| run.success && !run.durations.is_empty());
        // The lowest cost; of equal ones the first. Baselines have no cost.
        let cost = |run: &Run| run.cost().unwrap_or(0.);
        found.copied().cloned().reduce(|a, b| if cost(&b) < cost(&a) { b } else { a })
    };
    let winners: Vec<Run> = lines.iter().filter_map(best).collect();
    let panel = |run: &Run| CAPTION + BAR * run.durations.len() as f64 + AXIS_ROOM + GAP;
    let mut p = Picture::new(WIDTH, winners.iter().map(panel).sum::<f64>().max(1.));
    let mut start = 0.;
    for run in &winners {
        let schedule = Schedule::new(run.durations.clone())?;
        let names = foot_names(&Robot::named(Scenario::named(&run.case.scenario)?.robot)?);
        let (top, bottom) = (start + CAPTION, start + CAPTION + BAR * schedule.feet() as f64);
        start += panel(run);
        p.text(LEFT, top - 9., "start", r##"font-size="13" fill="#111""##, &caption(run));
        let x = Scale::straight([0., schedule.horizon()], [LEFT, RIGHT]);
        for v in x.ticks(12) {
            p.line([x.at(v), top], [x.at(v), bottom], GRID);
            p.line([x.at(v), bottom], [x.at(v), bottom + 5.], AXIS);
            p.text(x.at(v), bottom + 18., "middle", SMALL, &short(v));
        }
        p.text((LEFT + RIGHT) / 2., bottom + 35., "middle", SMALL, "time, s");
        for foot in 0..schedule.feet() {
            let row = top + BAR * foot as f64;
            p.text(LEFT - 8., row + BAR / 2. + 4., "end", SMALL, names.get(foot).map_or("", |name| name));
            for phase in schedule.phases(foot).into_iter().filter(|phase| phase.stance) {
                let fill = format!(r#"fill="{}""#, FOOT_COLORS[foot % FOOT_COLORS.len()]);
                p.box_of([x.at(phase.start), row + 3.], [x.at(phase.end), row + BAR - 3.], &fill);
            }
        }
        frame(&mut p, [LEFT, top], [RIGHT, bottom]);
    }
    Ok(p.finish())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// Stored runs of the machine on which the tables of an experiment were made, and a stored picture of them.
    fn stored(experiment: u8, picture: &str) -> (Vec<Run>, String) {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/experiments");
        let read = |name: String| std::fs::read_to_string(folder.join(name)).unwrap();
        let tables: serde_json::Value = serde_json::from_str(&read(format!("experiment{experiment}.json"))).unwrap();
        let log = read(format!("experiment{experiment}.jsonl"));
        let mut runs: Vec<Run> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        runs.retain(|run| tables["machine"] == *run.machine);
        assert!(!runs.is_empty(), "no runs of {}", tables["machine"]);
        (runs, read(format!("experiment{experiment}_{picture}.svg")))
    }

    #[test]
    fn stored_pictures_agree_with_the_stored_runs() {
        for experiment in 1..=3 {
            let (runs, picture) = stored(experiment, "gaits");
            assert!(gaits(&runs).unwrap() == picture, "gaits of experiment {experiment}");
        }
        for experiment in 1..=2 {
            let (runs, picture) = stored(experiment, "times");
            assert!(times(&runs).unwrap() == picture, "times of experiment {experiment}");
        }
        let (runs, picture) = stored(3, "objectives");
        assert!(objectives(&runs).unwrap() == picture, "objectives");
        assert!(times(&[]).is_err() && objectives(&[]).is_err());
    }

    #[test]
    fn labels_are_words_instead_of_identifiers() {
        for (experiment, picture) in [(1, "times"), (2, "times"), (1, "gaits"), (3, "gaits"), (3, "objectives")] {
            let (_, picture) = stored(experiment, picture);
            let texts = picture.split("<text").skip(1).filter_map(|t| t.split_once('>')?.1.split_once("</text>"));
            for (text, _) in texts {
                assert!(
                    !text.contains('`')
                        && !text.contains('_')
                        && !Method::ALL.iter().any(|m| m.name().contains('-') && m.name() != "contact-implicit" && text.contains(m.name())),
                    "{text}"
                );
            }
        }
    }
}
