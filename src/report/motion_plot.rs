//! A motion as a picture for a paper: its gait, forces, base over time, and a view from above.

use super::samples::{FOOT_COLORS, Sample, Sampler, Stance, foot_names};
use super::svg::{AXIS, GRID, Picture, SMALL, Scale, TITLE, short, with_room};
use crate::error::{Error, Result};
use crate::files;
use crate::gait::Trajectory;
use crate::robot::Robot;
use crate::terrain::Terrain;
use std::path::Path;

/// Width of a picture and horizontal edges of its panels, pixels. Legends are to the right of the panels.
const WIDTH: f64 = 960.;
const LEFT: f64 = 80.;
const RIGHT: f64 = 800.;
/// Top of the first panel, pixels.
const TOP: f64 = 58.;
/// Heights of a foot's bar, of the force panel, of the other panels, and of the gap between panels, pixels.
const BAR: f64 = 18.;
const FORCES: f64 = 140.;
const PANEL: f64 = 104.;
const GAP: f64 = 14.;
/// Room for the time axis, pixels.
const TIME_AXIS: f64 = 52.;
/// Largest height of the view from above, pixels.
const MOST_ABOVE: f64 = 380.;
/// Number of terrain cells for contours along the longer side of the view from above.
const CONTOUR_CELLS: f64 = 240.;
/// Samples per curve over the whole motion: more than there are pixels.
const SAMPLES: f64 = 2000.;

/// Colours of curves that belong to no foot.
const INK: [&str; 3] = ["#1d2733", "#a05a00", "#6b7785"];
/// Dash patterns of these colours.
const DASHES: [&str; 3] = ["", r#"stroke-dasharray="6 3""#, r#"stroke-dasharray="2 2.5""#];
/// Style of limits.
const LIMIT: &str = r##"stroke="#b3261e" stroke-width="1.2" stroke-dasharray="7 4""##;

/// Contents of a picture.
pub struct MotionPlot<'a> {
    /// Title, such as the gait and the verdict.
    pub title: String,
    /// The motion.
    pub trajectory: &'a Trajectory,
    /// Robot of the motion.
    pub robot: &'a Robot,
    /// Terrain of the motion.
    pub terrain: &'a Terrain,
    /// Largest normal force of a foot, N.
    pub force_limit: f64,
}

/// A curve of a panel over time, with one value per sample.
struct Curve {
    name: String,
    color: &'static str,
    dash: &'static str,
    values: Vec<Option<f64>>,
}

/// A panel of curves over time.
struct Panel {
    /// Quantity and unit.
    label: &'static str,
    height: f64,
    curves: Vec<Curve>,
    limit: Option<(f64, String)>,
    /// Largest value in view; curves are cut off above it.
    cap: f64,
    /// True if the axis includes 0.
    from_zero: bool,
    /// True if a legend names the curves.
    legend: bool,
}

/// File format of a picture, chosen by the ending of its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Svg,
    Png,
}

fn format_of(path: &Path) -> Result<Format> {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    match ending.as_str() {
        "svg" => Ok(Format::Svg),
        "png" if cfg!(feature = "pictures") => Ok(Format::Png),
        "png" => Err(Error::Missing {
            message: format!("{}: this program was built without the feature `pictures` (cargo build --features pictures)", path.display()),
        }),
        _ => Err(Error::invalid("name of the picture", path.display(), "one that ends in .svg or .png")),
    }
}

/// Checks that a picture of this name can be written, before any work is done.
///
/// # Errors
/// [`Error::Invalid`] if the name ends in neither `.svg` nor `.png`, [`Error::Missing`] if this build has no `png`; [`Error::Io`] if the
/// system refuses.
pub fn check(path: &Path) -> Result<()> {
    format_of(path)?;
    files::check_writable(path)
}

/// Writes the picture of a motion.
///
/// # Errors
/// See [`check`] and [`svg`].
pub fn write(plot: &MotionPlot, path: &Path) -> Result<()> {
    match format_of(path)? {
        Format::Svg => files::write(path, &svg(plot)?),
        #[cfg(feature = "pictures")]
        Format::Png => files::write_bytes(path, &super::png::png(&svg(plot)?)?),
        #[cfg(not(feature = "pictures"))]
        Format::Png => Ok(()),
    }
}

/// Picture of a motion as SVG.
///
/// # Errors
/// [`Error::Invalid`] if the trajectory is malformed, or robot and trajectory disagree on the number of feet.
pub fn svg(plot: &MotionPlot) -> Result<String> {
    let sampler = Sampler::new(plot.trajectory, plot.robot, plot.terrain)?;
    let horizon = plot.trajectory.horizon;
    let samples = sampler.samples(SAMPLES / horizon);
    let names = foot_names(plot.robot);
    let stances: Vec<Vec<Stance>> = (0..sampler.feet()).map(|foot| sampler.stances(foot)).collect();
    let panels = panels(plot, &samples, &names);
    let bars = BAR * names.len() as f64;
    let over_time = TOP + bars + panels.iter().map(|panel| GAP + panel.height).sum::<f64>();
    let above = Above::new(plot, &samples, &stances, over_time + TIME_AXIS + 22.);
    let mut p = Picture::new(WIDTH, above.bottom() + 46.);

    p.text(LEFT, 24., "start", TITLE, &format!("{} on {}", plot.robot.name, plot.terrain.name));
    p.text(LEFT, 42., "start", SMALL, &plot.title);

    let x = Scale::straight([0., horizon], [LEFT, RIGHT]);
    draw_bars(&mut p, &x, &names, &stances, horizon);
    let mut top = TOP + bars;
    for panel in &panels {
        top += GAP;
        draw_panel(&mut p, &x, panel, top, &samples);
        top += panel.height;
    }
    for t in x.ticks(12) {
        p.line([x.at(t), top], [x.at(t), top + 5.], AXIS);
        p.text(x.at(t), top + 19., "middle", SMALL, &short(t));
    }
    p.text((LEFT + RIGHT) / 2., top + 37., "middle", r#"font-size="13""#, "time, s");
    above.draw(&mut p, plot, &samples, &stances, &names);
    Ok(p.finish())
}

fn panels(plot: &MotionPlot, samples: &[Sample], names: &[String]) -> Vec<Panel> {
    let feet = |value: &dyn Fn(&Sample, usize) -> Option<f64>| -> Vec<Curve> {
        let curve = |(foot, name): (usize, &String)| Curve {
            name: name.clone(),
            color: FOOT_COLORS[foot],
            dash: "",
            values: samples.iter().map(|s| value(s, foot)).collect(),
        };
        names.iter().enumerate().map(curve).collect()
    };
    let base = |names: &[&str], value: &dyn Fn(&Sample, usize) -> f64| -> Vec<Curve> {
        let curve = |(i, name): (usize, &&str)| Curve {
            name: (*name).into(),
            color: INK[i],
            dash: DASHES[i],
            values: samples.iter().map(|s| Some(value(s, i))).collect(),
        };
        names.iter().enumerate().map(curve).collect()
    };
    let panel =
        |label, curves, from_zero| Panel { label, height: PANEL, legend: false, curves, limit: None, cap: f64::INFINITY, from_zero };
    let limit = (plot.force_limit, format!("limit {} N", short((plot.force_limit * 10.).round() / 10.)));
    let mut panels = vec![
        Panel {
            height: FORCES,
            limit: Some(limit),
            legend: true,
            ..panel("normal force, N", feet(&|s, foot| s.feet[foot].stance.then_some(s.feet[foot].normal_force)), true)
        },
        Panel {
            limit: Some((100., "edge of the cone".into())),
            cap: 200.,
            ..panel("friction use, %", feet(&|s, foot| s.feet[foot].friction_use.map(|u| 100. * u)), true)
        },
        panel("base height, m", base(&["height"], &|s, _| s.base.position[2]), false),
    ];
    let degrees = |s: &Sample, i: usize| s.base.angles[i].to_degrees();
    let most = |i: usize| samples.iter().map(|s| s.base.angles[i].abs()).fold(0., f64::max);
    // Yaw has its own panel if it would compress roll and pitch.
    if most(2) > 3. * most(0).max(most(1)).max(0.01) {
        panels.push(Panel { legend: true, ..panel("attitude, deg", base(&["roll", "pitch"], &degrees), false) });
        panels.push(panel("yaw, deg", base(&["yaw"], &|s, _| degrees(s, 2)), false));
    } else {
        panels.push(Panel { legend: true, ..panel("attitude, deg", base(&["roll", "pitch", "yaw"], &degrees), false) });
    }
    let speed = |s: &Sample, _| s.base.velocity.iter().map(|v| v * v).sum::<f64>().sqrt();
    panels.push(panel("base speed, m/s", base(&["speed"], &speed), true));
    panels
}

fn draw_bars(p: &mut Picture, x: &Scale, names: &[String], stances: &[Vec<Stance>], horizon: f64) {
    for (foot, (name, stances)) in names.iter().zip(stances).enumerate() {
        let top = TOP + BAR * foot as f64;
        p.box_of([x.at(0.), top + 2.], [x.at(horizon), top + BAR - 2.], r##"fill="#f0f2f4""##);
        for stance in stances {
            let [start, end] = stance.times.map(|t| x.at(t));
            p.box_of([start, top + 2.], [end, top + BAR - 2.], &format!(r#"fill="{}""#, FOOT_COLORS[foot]));
        }
        p.text(LEFT - 8., top + BAR / 2. + 4., "end", SMALL, name);
    }
    p.text(RIGHT + 12., TOP + 13., "start", SMALL, "stance of each foot");
}

fn draw_panel(p: &mut Picture, x: &Scale, panel: &Panel, top: f64, samples: &[Sample]) {
    let bottom = top + panel.height;
    let values = panel.curves.iter().flat_map(|c| c.values.iter().flatten().map(|v| v.min(panel.cap)));
    let zero = panel.from_zero.then_some(0.);
    let room = with_room(values.chain(zero).chain(panel.limit.as_ref().map(|l| l.0)), 0.06).unwrap_or([0., 1.]);
    let low = if panel.from_zero && room[0] > -0.1 * room[1] { 0. } else { room[0] };
    let y = Scale::straight([low, room[1]], [bottom, top]);
    for t in x.ticks(12) {
        p.line([x.at(t), top], [x.at(t), bottom], GRID);
    }
    for v in y.at_least_two((panel.height / 24.) as usize) {
        p.line([LEFT, y.at(v)], [RIGHT, y.at(v)], GRID);
        p.text(LEFT - 8., y.at(v) + 4., "end", SMALL, &short(v));
    }
    p.turned(24., (top + bottom) / 2., 12, panel.label);
    if let Some((limit, name)) = &panel.limit {
        p.line([LEFT, y.at(*limit)], [RIGHT, y.at(*limit)], LIMIT);
        p.text(RIGHT + 12., y.at(*limit) + 4., "start", r##"font-size="12" fill="#b3261e""##, name);
    }
    p.begin_clip(&format!("panel{top:.0}"), [LEFT, top], [RIGHT, bottom]);
    for curve in &panel.curves {
        let at = |(s, value): (&Sample, &Option<f64>)| value.map(|v| [x.at(s.time), y.at(v)]);
        let points: Vec<_> = samples.iter().zip(&curve.values).map(at).collect();
        p.curve(&points, &format!(r#"stroke="{}" stroke-width="1.5" {}"#, curve.color, curve.dash));
    }
    p.end_clip();
    if panel.legend {
        let first = if panel.limit.is_some() { top + 34. } else { top + 20. };
        for (i, curve) in panel.curves.iter().enumerate() {
            let (at, column) = (first + 18. * (i % 5) as f64, RIGHT + 12. + 62. * (i / 5) as f64);
            p.line([column, at - 4.], [column + 24., at - 4.], &format!(r#"stroke="{}" stroke-width="2.2" {}"#, curve.color, curve.dash));
            p.text(column + 30., at, "start", SMALL, &curve.name);
        }
    }
    p.box_of([LEFT, top], [RIGHT, bottom], r##"fill="none" stroke="#333" stroke-width="1""##);
}

/// View from above: x to the right, y up, one scale for both.
struct Above {
    x: Scale,
    y: Scale,
}

impl Above {
    fn new(plot: &MotionPlot, samples: &[Sample], stances: &[Vec<Stance>], top: f64) -> Above {
        let goal = plot.trajectory.base_target;
        let places = || {
            let feet = stances.iter().flatten().map(|s| s.foothold);
            feet.chain(samples.iter().map(|s| s.base.position)).chain([goal])
        };
        let margin = 0.5 * plot.robot.leg_height();
        let range = |axis: usize| {
            let values = || places().map(|p| p[axis]);
            [values().fold(f64::INFINITY, f64::min) - margin, values().fold(f64::NEG_INFINITY, f64::max) + margin]
        };
        let ([left, right], [low, high]) = (range(0), range(1));
        let scale = ((RIGHT - LEFT) / (right - left)).min(MOST_ABOVE / (high - low));
        // A motion along y leaves room at the sides.
        let spare = ((RIGHT - LEFT) / scale - (right - left)) / 2.;
        let height = (high - low) * scale;
        Above { x: Scale::straight([left - spare, right + spare], [LEFT, RIGHT]), y: Scale::straight([low, high], [top + height, top]) }
    }

    fn top(&self) -> f64 {
        self.y.pixels[1]
    }

    fn bottom(&self) -> f64 {
        self.y.pixels[0]
    }

    fn at(&self, [x, y, _]: [f64; 3]) -> [f64; 2] {
        [self.x.at(x), self.y.at(y)]
    }

    fn draw(&self, p: &mut Picture, plot: &MotionPlot, samples: &[Sample], stances: &[Vec<Stance>], names: &[String]) {
        let (top, bottom) = (self.top(), self.bottom());
        let step = tick_step(&self.x);
        for v in ticks_of(&self.x, step) {
            p.line([self.x.at(v), top], [self.x.at(v), bottom], GRID);
            p.text(self.x.at(v), bottom + 18., "middle", SMALL, &short(v));
        }
        let across = ticks_of(&self.y, step);
        for v in if across.len() < 2 { self.y.at_least_two(2) } else { across } {
            p.line([LEFT, self.y.at(v)], [RIGHT, self.y.at(v)], GRID);
            p.text(LEFT - 8., self.y.at(v) + 4., "end", SMALL, &short(v));
        }
        p.text((LEFT + RIGHT) / 2., bottom + 36., "middle", r#"font-size="13""#, "x, m");
        p.turned(24., (top + bottom) / 2., 12, "y, m");
        p.begin_clip("above", [LEFT, top], [RIGHT, bottom]);
        let contours = self.contours(p, plot.terrain);
        let path: Vec<_> = samples.iter().map(|s| Some(self.at(s.base.position))).collect();
        p.curve(&path, &format!(r#"stroke="{}" stroke-width="2""#, INK[0]));
        for (foot, stances) in stances.iter().enumerate() {
            for stance in stances {
                let style = format!(r#"fill="{}" fill-opacity="0.85""#, FOOT_COLORS[foot]);
                if stance.corners.is_empty() {
                    p.circle(self.at(stance.foothold), 4.2, &style);
                } else {
                    let corners: Vec<[f64; 2]> = stance.corners.iter().map(|&corner| self.at(corner)).collect();
                    p.polygon(&corners, &style);
                }
            }
        }
        self.outline(p, plot.robot, &samples[0], r##"stroke="#6b7785" stroke-dasharray="4 3""##);
        if let Some(last) = samples.last() {
            self.outline(p, plot.robot, last, &format!(r#"stroke="{}""#, INK[0]));
        }
        p.end_clip();
        p.box_of([LEFT, top], [RIGHT, bottom], r##"fill="none" stroke="#333" stroke-width="1""##);
        self.legend(p, names, contours);
    }

    /// Draws the nominal feet around the base as a polygon, and the heading as a line.
    fn outline(&self, p: &mut Picture, robot: &Robot, sample: &Sample, style: &str) {
        let (sin, cos) = sample.base.angles[2].sin_cos();
        let [bx, by, _] = sample.base.position;
        let place = |[x, y]: [f64; 2]| self.at([bx + cos * x - sin * y, by + sin * x + cos * y, 0.]);
        let extent = |axis: usize| robot.nominal_feet.iter().map(|f| f[axis].abs()).fold(0.2 * robot.leg_height(), f64::max);
        let (length, width) = (extent(0), 0.6 * extent(1));
        let corners = [[length, width], [-length, width], [-length, -width], [length, -width]].map(place);
        p.polygon(&corners, &format!(r#"fill="none" stroke-width="1.2" {style}"#));
        p.line(place([0., 0.]), place([1.35 * length, 0.]), &format!(r#"stroke-width="1.2" {style}"#));
    }

    /// Draws contours of the terrain. Returns their distance in height, m, or `None` on level ground.
    fn contours(&self, p: &mut Picture, terrain: &Terrain) -> Option<f64> {
        let (width, height) = (self.x.high - self.x.low, self.y.high - self.y.low);
        let cell = width.max(height) / CONTOUR_CELLS;
        let (columns, rows) = ((width / cell).ceil() as usize, (height / cell).ceil() as usize);
        let place = |i: usize, j: usize| {
            let (x, y) = (self.x.low + width * i as f64 / columns as f64, self.y.low + height * j as f64 / rows as f64);
            [x, y, terrain.height(x, y)]
        };
        let ground: Vec<Vec<[f64; 3]>> = (0..=columns).map(|i| (0..=rows).map(|j| place(i, j)).collect()).collect();
        let heights = || ground.iter().flatten().map(|g| g[2]);
        let (low, high) = (heights().fold(f64::INFINITY, f64::min), heights().fold(f64::NEG_INFINITY, f64::max));
        if high - low < 1e-6 {
            return None;
        }
        let scale = Scale::straight([low, high], [0., 1.]);
        let step = tick_step(&scale);
        for level in ticks_of(&scale, step) {
            for i in 0..columns {
                for j in 0..rows {
                    let corners = [ground[i][j], ground[i + 1][j], ground[i + 1][j + 1], ground[i][j + 1]];
                    for [from, to] in crossings(&corners, level) {
                        p.line(self.at(from), self.at(to), r##"stroke="#8a6d3b" stroke-width="0.8""##);
                    }
                }
            }
        }
        Some(step)
    }

    fn legend(&self, p: &mut Picture, names: &[String], contours: Option<f64>) {
        let (x, mut y) = (RIGHT + 12., self.top() + 12.);
        let mut entry = |p: &mut Picture, text: &str, style: &str, dot: bool| {
            if dot {
                p.circle([x + 12., y - 4.], 4.2, style);
            } else {
                p.line([x, y - 4.], [x + 24., y - 4.], style);
            }
            p.text(x + 30., y, "start", SMALL, text);
            y += 17.;
        };
        entry(p, "path of base", &format!(r#"stroke="{}" stroke-width="2""#, INK[0]), false);
        entry(p, "base at the start", r##"stroke="#6b7785" stroke-width="1.2" stroke-dasharray="4 3""##, false);
        entry(p, "base at the end", &format!(r#"stroke="{}" stroke-width="1.2""#, INK[0]), false);
        if let Some(step) = contours {
            entry(p, &format!("{} m of height", short(step)), r##"stroke="#8a6d3b" stroke-width="1""##, false);
        }
        // A low view has no room for one entry per foot; the panels above show the colours.
        if self.bottom() - self.top() > 17. * (5 + names.len()) as f64 {
            for (foot, name) in names.iter().enumerate() {
                entry(p, &format!("footholds {name}"), &format!(r#"fill="{}""#, FOOT_COLORS[foot]), true);
            }
        } else {
            entry(p, "footholds", r##"fill="#6b7785""##, true);
        }
    }
}

/// Round distance between ticks that gives about eight over a scale.
fn tick_step(scale: &Scale) -> f64 {
    let ticks = scale.ticks(8);
    ticks.windows(2).next().map_or(scale.high - scale.low, |pair| pair[1] - pair[0])
}

/// Multiples of a step within a scale.
fn ticks_of(scale: &Scale, step: f64) -> Vec<f64> {
    let first = (scale.low / step).ceil() as i64;
    (first..).map(|i| i as f64 * step).take_while(|&v| v <= scale.high).collect()
}

/// Contour segments of a level in one cell, between points on the cell's edges.
fn crossings(corners: &[[f64; 3]; 4], level: f64) -> Vec<[[f64; 3]; 2]> {
    let mut points = Vec::with_capacity(4);
    for i in 0..4 {
        let (a, b) = (corners[i], corners[(i + 1) % 4]);
        if (a[2] > level) != (b[2] > level) {
            let part = (level - a[2]) / (b[2] - a[2]);
            points.push(std::array::from_fn(|d| a[d] + part * (b[d] - a[d])));
        }
    }
    points.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gait::trajectory::Curve as MotionCurve;
    use crate::gait::{FootCurves, Trajectory};

    /// A biped that stands on its left foot and steps with its right, 0.4 m ahead, while it turns.
    fn step() -> Trajectory {
        let curve = |durations: &[f64], nodes: &[[f64; 6]]| MotionCurve { poly_durations: durations.to_vec(), nodes: nodes.to_vec() };
        let base = curve(&[1.], &[[0., 0., 0.6, 0., 0., 0.], [0.2, 0., 0.6, 0., 0., 0.]]);
        let angles = curve(&[1.], &[[0.; 6], [0., 0., 3., 0., 0., 0.]]);
        let left = curve(&[1.], &[[0., 0.2, 0., 0., 0., 0.]; 2]);
        let right = curve(
            &[0.3, 0.4, 0.3],
            &[[0., -0.2, 0., 0., 0., 0.], [0., -0.2, 0., 0., 0., 0.], [0.4, -0.2, 0., 0., 0., 0.], [0.4, -0.2, 0., 0., 0., 0.]],
        );
        let push = curve(&[1.], &[[0., 0., 150., 0., 0., 0.]; 2]);
        let some = curve(&[0.3, 0.4, 0.3], &[[0., 0., 50., 0., 0., 0.], [0.; 6], [0.; 6], [0., 0., 50., 0., 0., 0.]]);
        let feet = vec![FootCurves::new(left, push), FootCurves::new(right, some)];
        Trajectory::new(vec![vec![1.], vec![0.3, 0.4, 0.3]], 1., [base, angles], feet)
    }

    fn picture(terrain: &str) -> String {
        let (robot, terrain) = (Robot::named("biped").unwrap(), Terrain::named(terrain).unwrap());
        svg(&MotionPlot { title: "a step".into(), trajectory: &step(), robot: &robot, terrain: &terrain, force_limit: 490.3 }).unwrap()
    }

    #[test]
    fn every_panel_is_named_with_its_unit() {
        let picture = picture("flat");
        let labels =
            ["normal force, N", "limit 490.3 N", "friction use, %", "base height, m", "attitude, deg", "yaw, deg", "base speed, m/s"];
        for label in labels.into_iter().chain(["time, s", "x, m", "y, m", ">L<", ">R<", "biped on flat", "a step"]) {
            assert!(picture.contains(label), "no {label}");
        }
        assert!(!picture.contains("NaN") && !picture.contains("inf"));
        // One bar per stance: one for the left foot, two for the right one.
        assert_eq!(picture.matches(&format!(r#"height="{:.1}" fill="{}""#, BAR - 4., FOOT_COLORS[0])).count(), 1);
        assert_eq!(picture.matches(&format!(r#"height="{:.1}" fill="{}""#, BAR - 4., FOOT_COLORS[1])).count(), 2);
        // Level ground has no contours.
        assert!(!picture.contains("of height"));
    }

    #[test]
    fn a_force_far_outside_its_cone_does_not_compress_the_other_curves() {
        let (robot, terrain, mut trajectory) = (Robot::named("biped").unwrap(), Terrain::flat(), step());
        trajectory.ee[0].force.nodes[0][0] = 15_000.;
        let plot = MotionPlot { title: String::new(), trajectory: &trajectory, robot: &robot, terrain: &terrain, force_limit: 490. };
        let sampler = Sampler::new(&trajectory, &robot, &terrain).unwrap();
        assert_eq!(sampler.at(0.).feet[0].friction_use, Some(100.));
        let picture = svg(&plot).unwrap();
        assert!(picture.contains(">200</text>") && !picture.contains(">10000</text>"));
    }

    #[test]
    fn contours_lie_at_their_height() {
        let corners = [[0., 0., 0.], [1., 0., 1.], [1., 1., 1.], [0., 1., 0.]];
        assert_eq!(crossings(&corners, 0.25), [[[0.25, 0., 0.25], [0.25, 1., 0.25]]]);
        assert!(crossings(&corners, 1.).is_empty() && crossings(&corners, 2.).is_empty());
        assert!(picture("chimney-lr").contains("of height"));
    }

    #[test]
    fn the_file_name_selects_svg_or_png() {
        let error = |name: &str| check(Path::new(name)).unwrap_err().to_string();
        assert!(error("plot.pdf").contains(".svg or .png") && error("plot").contains(".svg or .png"));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("step.svg");
        let (robot, terrain, trajectory) = (Robot::named("biped").unwrap(), Terrain::flat(), step());
        let plot = MotionPlot { title: String::new(), trajectory: &trajectory, robot: &robot, terrain: &terrain, force_limit: 500. };
        write(&plot, &path).unwrap();
        assert_eq!(std::fs::read_to_string(path).unwrap(), svg(&plot).unwrap());
        #[cfg(feature = "pictures")]
        {
            let path = folder.path().join("step.PNG");
            write(&plot, &path).unwrap();
            assert!(std::fs::read(path).unwrap().starts_with(b"\x89PNG\r\n"));
        }
    }
}
