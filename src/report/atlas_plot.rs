//! An atlas of gaits as an SVG picture: cost of transport over speed, the best gait at each speed, and its duty factor and period.

use super::atlas::name;
use super::svg::{AXIS, GRID, Picture, SMALL, Scale, short};
use crate::gait::family::{FAMILIES, GaitFamily, speed_scale, time_scale};
use crate::search::atlas::{Atlas, AtlasPoint, Transition};

/// Horizontal edges of the plots, pixels.
const LEFT: f64 = 78.;
const RIGHT: f64 = 760.;
/// Width of the picture, pixels. The legend is to the right of the plots.
const WIDTH: f64 = 980.;
/// Top and height of the panel of curves, pixels.
const TOP: f64 = 84.;
const CURVES: f64 = 330.;
/// Heights of a line of notes, of the band of best gaits, of a strip, and of a gap, pixels.
const NOTE: f64 = 17.;
const BAND: f64 = 24.;
const STRIP: f64 = 62.;
const GAP: f64 = 14.;

/// Largest cost drawn, in multiples of the smallest cost. Without a limit, uninteresting curves would compress the others.
const LARGEST_COST: f64 = 12.;

/// One colour per family, distinguishable with most colour vision deficiencies. Families of one kind of robot have different colours.
fn color(family: GaitFamily) -> &'static str {
    use GaitFamily::*;
    match family {
        Walk | Tetrapod => "#0072b2",
        Trot | Run | Tripod => "#d55e00",
        Pace | Hop | Ripple => "#009e73",
        Bound | Wave => "#cc79a7",
        Canter | Alternating => "#e69f00",
        RotaryGallop => "#56b4e9",
        TransverseGallop => "#000000",
        Pronk => "#8a8a8a",
    }
}

/// Froude numbers on the second axis.
const FROUDE: [f64; 13] = [0.01, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1., 1.5, 2., 3., 4., 6.];

/// Style of the lines at the transitions.
const TRANSITION: &str = r##"stroke="#777" stroke-width="1" stroke-dasharray="4 3""##;

/// Picture of the atlas on one slope. It has no curves if nothing was certified.
pub fn svg(atlas: &Atlas, slope: f64) -> String {
    let plot = Plot::new(atlas, slope);
    let mut p = Picture::new(WIDTH, plot.bottom() + 46.);
    plot.draw_title(&mut p);
    plot.draw_speed_axes(&mut p);
    plot.draw_costs(&mut p);
    plot.draw_legend(&mut p);
    plot.draw_notes(&mut p);
    plot.draw_band(&mut p);
    plot.draw_strips(&mut p);
    p.finish()
}

/// Contents and layout of the picture on one slope.
struct Plot<'a> {
    atlas: &'a Atlas,
    slope: f64,
    /// Curve of each family, with one point per speed.
    curves: Vec<(GaitFamily, Vec<Option<&'a AtlasPoint>>)>,
    /// Best gait at each speed.
    best: Vec<Option<&'a AtlasPoint>>,
    transitions: Vec<Transition>,
    /// Notes on the transitions, distributed over lines so that they do not overlap: line, centre in pixels, text.
    notes: Vec<(usize, f64, String)>,
    /// Number of lines of notes.
    note_lines: usize,
    /// Speed axis.
    x: Scale,
}

impl<'a> Plot<'a> {
    fn new(atlas: &'a Atlas, slope: f64) -> Plot<'a> {
        let speeds = &atlas.plan.speeds;
        let (fastest, slowest) = (speeds.iter().copied().fold(0., f64::max), speeds.iter().copied().fold(f64::MAX, f64::min));
        let pad = 0.04 * (fastest - slowest).max(0.2 * fastest);
        let x = Scale { low: (slowest - pad).max(0.), high: fastest + pad, pixels: [LEFT, RIGHT], log: false };
        let transitions = atlas.transitions(slope);
        // End of the last note on each line.
        let mut ends: Vec<f64> = Vec::new();
        let note = |t: &Transition| {
            let text = format!("{} \u{2192} {}: {:.2} m/s, Fr {:.2}", words(t.from), words(t.to), t.speed, t.froude);
            let half = 3.1 * text.chars().count() as f64;
            let at = x.at(t.speed).clamp(LEFT + half, RIGHT - half);
            let line = ends.iter().position(|&end| end + 10. < at - half).unwrap_or(ends.len());
            if line == ends.len() {
                ends.push(0.);
            }
            ends[line] = at + half;
            (line, at, text)
        };
        let notes = transitions.iter().map(note).collect();
        let families = FAMILIES.into_iter().filter(|f| atlas.plan.families.contains(f));
        let curves = families.map(|f| (f, atlas.curve(f, slope))).collect();
        Plot { atlas, slope, curves, best: atlas.best(slope), transitions, notes, note_lines: ends.len(), x }
    }

    /// Top of the band of best gaits.
    fn band(&self) -> f64 {
        TOP + CURVES + 10. + NOTE * self.note_lines as f64
    }

    /// Tops of the strips of duty factor and period.
    fn strips(&self) -> [f64; 2] {
        [self.band() + BAND + GAP, self.band() + BAND + 2. * GAP + STRIP]
    }

    /// Bottom of the lower strip.
    fn bottom(&self) -> f64 {
        self.strips()[1] + STRIP
    }

    fn draw_title(&self, p: &mut Picture) {
        let ground = if self.slope == 0. { "level ground".into() } else { format!("slope {}", short(self.slope)) };
        let title = format!("{}: what gaits cost, {ground}", self.atlas.plan.robot.name);
        p.text(LEFT, 24., "start", r#"font-size="17" font-weight="bold""#, &title);
        let about = format!(
            "{} motions of {} problems certified; every curve through the best member of its family",
            self.atlas.certified(),
            self.atlas.points.len()
        );
        p.text(LEFT, 42., "start", SMALL, &about);
    }

    /// Draws the speed axes: m/s at the bottom, Froude numbers at the top.
    fn draw_speed_axes(&self, p: &mut Picture) {
        let (x, strips, bottom) = (&self.x, self.strips(), self.bottom());
        for v in x.ticks(10) {
            for [top, end] in [[TOP, TOP + CURVES], [strips[0], strips[0] + STRIP], [strips[1], bottom]] {
                p.line([x.at(v), top], [x.at(v), end], GRID);
            }
            p.line([x.at(v), bottom], [x.at(v), bottom + 5.], AXIS);
            p.text(x.at(v), bottom + 19., "middle", SMALL, &short(v));
        }
        p.text((LEFT + RIGHT) / 2., bottom + 38., "middle", r#"font-size="13""#, "travel speed, m/s");
        let mut last = 0.;
        for froude in FROUDE {
            let at = x.at(speed_scale(&self.atlas.plan.robot) * froude.sqrt());
            if !(LEFT..=RIGHT - 14.).contains(&at) || at - last < 32. {
                continue;
            }
            last = at;
            p.line([at, TOP - 5.], [at, TOP], AXIS);
            p.text(at, TOP - 9., "middle", SMALL, &short(froude));
        }
        p.text(RIGHT + 10., TOP - 9., "start", SMALL, "Froude number v\u{b2} / g l");
    }

    /// Draws the panel of costs over speed.
    fn draw_costs(&self, p: &mut Picture) {
        let x = &self.x;
        let totals = || self.curves.iter().flat_map(|(_, c)| c.iter().flatten()).filter_map(|p| p.total());
        let least = totals().fold(f64::MAX, f64::min);
        let most = totals().fold(0., f64::max).min(LARGEST_COST * least);
        if most > 0. {
            let y = Scale { low: least / 1.12, high: (most * 1.08).max(1.5 * least), pixels: [TOP + CURVES, TOP], log: true };
            for v in y.ticks(0) {
                p.line([LEFT, y.at(v)], [RIGHT, y.at(v)], GRID);
                p.text(LEFT - 8., y.at(v) + 4., "end", SMALL, &short(v));
            }
            p.begin_clip("curves", [LEFT, TOP], [RIGHT, TOP + CURVES]);
            for t in &self.transitions {
                p.line([x.at(t.speed), TOP], [x.at(t.speed), TOP + CURVES], TRANSITION);
            }
            for (family, curve) in &self.curves {
                let at = |point: &Option<&AtlasPoint>| point.and_then(|q| Some([x.at(q.speed), y.at(q.total()?)]));
                p.points(&curve.iter().map(at).collect::<Vec<_>>(), color(*family), 2.);
            }
            p.end_clip();
        }
        frame(p, TOP, TOP + CURVES);
        p.turned(22., TOP + CURVES / 2., 13, "cost of transport");
    }

    /// Draws the legend, cheapest family first.
    fn draw_legend(&self, p: &mut Picture) {
        let cheapest = |c: &[Option<&AtlasPoint>]| c.iter().flatten().filter_map(|q| q.total()).fold(f64::INFINITY, f64::min);
        let mut legend: Vec<&(GaitFamily, Vec<Option<&AtlasPoint>>)> = self.curves.iter().collect();
        legend.sort_by(|a, b| cheapest(&a.1).total_cmp(&cheapest(&b.1)));
        for (i, (family, _)) in legend.into_iter().enumerate() {
            let at = TOP + 14. + 34. * i as f64;
            let of = || self.atlas.points.iter().filter(|q| q.family == *family && q.slope == self.slope);
            p.points(&[Some([RIGHT + 14., at - 4.]), Some([RIGHT + 40., at - 4.])], color(*family), 2.);
            p.text(RIGHT + 50., at, "start", r#"font-size="13""#, &words(Some(*family)));
            let share = format!("{} of {} certified", of().filter(|q| q.certified).count(), of().count());
            p.text(RIGHT + 50., at + 14., "start", r##"font-size="11" fill="#666""##, &share);
        }
    }

    /// Draws the notes on the transitions.
    fn draw_notes(&self, p: &mut Picture) {
        for ((line, at, text), t) in self.notes.iter().zip(&self.transitions) {
            let y = self.band() - 6. - NOTE * (self.note_lines - 1 - line) as f64;
            p.line([self.x.at(t.speed), TOP + CURVES], [self.x.at(t.speed), y - 11.], TRANSITION);
            p.text(*at, y, "middle", r##"font-size="11.5" fill="#222""##, text);
        }
    }

    /// Draws the band of best gaits.
    fn draw_band(&self, p: &mut Picture) {
        let band = self.band();
        let mut edges = vec![LEFT];
        edges.extend(self.transitions.iter().map(|t| self.x.at(t.speed)));
        edges.push(RIGHT);
        let mut families: Vec<Option<GaitFamily>> = self.best.iter().map(|b| b.map(|q| q.family)).collect();
        families.dedup();
        for (edge, family) in edges.windows(2).zip(families) {
            let fill = family.map_or("#dddddd", color);
            p.box_of([edge[0], band], [edge[1], band + BAND], &format!(r#"fill="{fill}" stroke="white" stroke-width="1""#));
            let text = words(family);
            if edge[1] - edge[0] > 7.5 * text.len() as f64 {
                let ink = if family.is_some() { "white" } else { "#333" };
                let style = format!(r#"font-size="13" font-weight="bold" fill="{ink}""#);
                p.text((edge[0] + edge[1]) / 2., band + 17., "middle", &style, &text);
            }
        }
        p.text(RIGHT + 10., band + 17., "start", SMALL, "cheapest gait");
    }

    /// Draws the strips of duty factor and period of the best gait.
    fn draw_strips(&self, p: &mut Picture) {
        let time = time_scale(&self.atlas.plan.robot);
        let longest = self.best.iter().flatten().map(|q| q.period / time).fold(1., f64::max);
        let of_duty: fn(&AtlasPoint, f64) -> f64 = |q, _| q.duty;
        let of_period: fn(&AtlasPoint, f64) -> f64 = |q, time| q.period / time;
        let contents = [(1., "its duty factor", of_duty), (1.15 * longest, "its period, \u{221a}(l / g)", of_period)];
        for (top, (high, title, value)) in self.strips().into_iter().zip(contents) {
            let scale = Scale { low: 0., high, pixels: [top + STRIP, top], log: false };
            for v in scale.ticks(3) {
                p.line([LEFT, scale.at(v)], [RIGHT, scale.at(v)], GRID);
                p.text(LEFT - 8., scale.at(v) + 4., "end", SMALL, &short(v));
            }
            let points: Vec<_> = self.best.iter().map(|q| q.map(|q| [self.x.at(q.speed), scale.at(value(q, time))])).collect();
            p.points(&points, "#444", 1.4);
            frame(p, top, top + STRIP);
            p.text(RIGHT + 10., top + STRIP / 2. + 4., "start", SMALL, title);
        }
    }
}

/// Name of a gait with spaces.
fn words(family: Option<GaitFamily>) -> String {
    name(family).replace('-', " ")
}

/// Draws the frame of a panel.
fn frame(p: &mut Picture, top: f64, bottom: f64) {
    p.box_of([LEFT, top], [RIGHT, bottom], r##"fill="none" stroke="#333" stroke-width="1""##);
}
