//! SVG pictures, written by hand. Legends beside curves, bars of a gait and two kinds of axes are easier to draw than to configure in a
//! plotting library.

use std::fmt::Write;

/// Style of an axis.
pub const AXIS: &str = r##"stroke="#333" stroke-width="1""##;
/// Style of a grid line.
pub const GRID: &str = r##"stroke="#e4e4e4" stroke-width="1""##;
/// Style of small text.
pub const SMALL: &str = r##"font-size="12" fill="#333""##;
/// Style of a title.
pub const TITLE: &str = r##"font-size="15" font-weight="bold" fill="#111""##;

/// Linear or logarithmic map from values to pixels.
#[derive(Debug, Clone, Copy)]
pub struct Scale {
    /// Smallest value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
    /// Pixel positions of `low` and `high`.
    pub pixels: [f64; 2],
    /// True if the scale is logarithmic.
    pub log: bool,
}

impl Scale {
    /// A linear scale.
    pub fn straight([low, high]: [f64; 2], pixels: [f64; 2]) -> Scale {
        Scale { low, high, pixels, log: false }
    }

    /// Pixel position of a value.
    pub fn at(&self, value: f64) -> f64 {
        let f = |v: f64| if self.log { v.max(1e-12).ln() } else { v };
        let part = (f(value) - f(self.low)) / (f(self.high) - f(self.low));
        self.pixels[0] + part * (self.pixels[1] - self.pixels[0])
    }

    /// Round values in the range: about `most` or fewer on a linear scale; 1, 1.5, 2, 3, 5, 7 times powers of ten on a logarithmic one.
    pub fn ticks(&self, most: usize) -> Vec<f64> {
        let inside = |v: &f64| *v >= self.low * (1. - 1e-9) && *v <= self.high * (1. + 1e-9);
        if self.log {
            let tens = (-3..=4).map(|e| 10f64.powi(e));
            return tens.flat_map(|ten| [1., 1.5, 2., 3., 5., 7.].map(|v| v * ten)).filter(inside).collect();
        }
        let rough = (self.high - self.low) / most as f64;
        let ten = 10f64.powf(rough.log10().floor());
        let step = [1., 2., 2.5, 5., 10.].map(|v| v * ten).into_iter().find(|&s| s >= rough).unwrap_or(10. * ten);
        let first = (self.low / step).ceil() as i64;
        (first..).map(|i| i as f64 * step).take_while(|&v| v <= self.high + 1e-9 * step).collect()
    }

    /// Ticks as in [`Scale::ticks`], but at least two if possible: one tick does not show the length of the axis.
    pub fn at_least_two(&self, most: usize) -> Vec<f64> {
        (most..most + 8).map(|most| self.ticks(most)).find(|ticks| ticks.len() > 1).unwrap_or_default()
    }
}

/// Range of values, extended on both sides by a part of its length; `None` without values.
pub fn with_room(values: impl IntoIterator<Item = f64>, part: f64) -> Option<[f64; 2]> {
    let start = [f64::INFINITY, f64::NEG_INFINITY];
    let [low, high] = values.into_iter().fold(start, |[low, high], v| [low.min(v), high.max(v)]);
    if low > high {
        return None;
    }
    let room = part * (high - low).max(1e-3 * high.abs()).max(1e-3);
    Some([low - room, high + room])
}

/// A number with at most three decimals and without trailing zeros.
pub fn short(value: f64) -> String {
    let text = format!("{value:.3}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.replace('-', "\u{2212}") }
}

/// A picture to which elements are added. Lengths are in pixels from the upper left corner.
#[derive(Debug)]
pub struct Picture(String);

impl Picture {
    /// An empty white picture.
    pub fn new(width: f64, height: f64) -> Picture {
        Picture(format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
             font-family=\"Helvetica, Arial, sans-serif\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
        ))
    }

    /// Text of the SVG file.
    pub fn finish(self) -> String {
        self.0 + "</svg>\n"
    }

    fn add(&mut self, element: std::fmt::Arguments) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.0, "{element}");
    }

    /// Adds an element verbatim.
    pub fn element(&mut self, element: &str) {
        self.add(format_args!("{element}"));
    }

    /// Adds text.
    ///
    /// * `anchor` - the part of the text that lies at x: `start`, `middle` or `end`
    pub fn text(&mut self, x: f64, y: f64, anchor: &str, style: &str, text: &str) {
        let text = text.replace('&', "&amp;").replace('<', "&lt;");
        self.add(format_args!(r#"<text x="{x:.1}" y="{y:.1}" text-anchor="{anchor}" {style}>{text}</text>"#));
    }

    /// Adds centred text that reads upwards, such as the name of a vertical axis.
    pub fn turned(&mut self, x: f64, y: f64, size: u32, text: &str) {
        self.text(x, y, "middle", &format!(r#"font-size="{size}" transform="rotate(-90 {x:.1} {y:.1})""#), text);
    }

    /// Adds a line.
    pub fn line(&mut self, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2], style: &str) {
        self.add(format_args!(r#"<line x1="{x1:.1}" y1="{y1:.1}" x2="{x2:.1}" y2="{y2:.1}" {style}/>"#));
    }

    /// Adds a rectangle between its upper left and its lower right corner.
    pub fn box_of(&mut self, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2], style: &str) {
        let (width, height) = (x2 - x1, y2 - y1);
        self.add(format_args!(r#"<rect x="{x1:.1}" y="{y1:.1}" width="{width:.1}" height="{height:.1}" {style}/>"#));
    }

    /// Adds a circle.
    pub fn circle(&mut self, [x, y]: [f64; 2], radius: f64, style: &str) {
        self.add(format_args!(r#"<circle cx="{x:.1}" cy="{y:.1}" r="{radius:.1}" {style}/>"#));
    }

    /// Adds a polygon.
    pub fn polygon(&mut self, points: &[[f64; 2]], style: &str) {
        let points: Vec<String> = points.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
        self.add(format_args!(r#"<polygon points="{}" {style}/>"#, points.join(" ")));
    }

    /// Adds a polyline, interrupted where a point is `None`.
    pub fn curve(&mut self, points: &[Option<[f64; 2]>], style: &str) {
        for run in points.split(Option::is_none) {
            let run: Vec<String> = run.iter().flatten().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
            if run.len() > 1 {
                self.add(format_args!(r#"<polyline points="{}" fill="none" stroke-linejoin="round" {style}/>"#, run.join(" ")));
            }
        }
    }

    /// Adds a polyline like [`Picture::curve`], with a dot at every point.
    pub fn points(&mut self, points: &[Option<[f64; 2]>], color: &str, width: f64) {
        self.curve(points, &format!(r#"stroke="{color}" stroke-width="{width}""#));
        for point in points.iter().flatten() {
            self.circle(*point, width + 0.9, &format!(r#"fill="{color}""#));
        }
    }

    /// Clips the elements that follow to a rectangle.
    ///
    /// * `id` - unique in the picture
    pub fn begin_clip(&mut self, id: &str, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) {
        let (width, height) = (x2 - x1, y2 - y1);
        self.add(format_args!(
            r##"<clipPath id="{id}"><rect x="{x1:.1}" y="{y1:.1}" width="{width:.1}" height="{height:.1}"/></clipPath><g clip-path="url(#{id})">"##
        ));
    }

    /// Ends the clipping that began last.
    pub fn end_clip(&mut self) {
        self.0 += "</g>\n";
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(Scale::straight([0., 4.8], [0., 100.]).ticks(5), [0., 1., 2., 3., 4.]);
        assert_eq!(Scale::straight([-0.3, 0.3], [0., 100.]).ticks(3).len(), 3);
        let log = Scale { low: 0.009, high: 1.2, pixels: [0., 100.], log: true };
        assert!((log.ticks(0).len(), log.ticks(0)[0]) == (13, 0.01));
        let narrow = Scale::straight([0.3, 1.4], [0., 1.]);
        assert_eq!((narrow.ticks(1), narrow.at_least_two(1).len()), (vec![], 2));
        assert_eq!(Scale::straight([2., 4.], [10., 30.]).at(3.), 20.);
    }

    #[test]
    fn numbers_are_short_and_text_is_escaped() {
        assert_eq!((short(0.5), short(-2.), short(100.), short(-1e-9)), ("0.5".into(), "\u{2212}2".into(), "100".into(), "0".into()));
        let mut picture = Picture::new(10., 10.);
        picture.text(0., 0., "start", SMALL, "<script>&");
        assert!(picture.finish().contains(">&lt;script>&amp;</text>"));
    }

    #[test]
    fn curves_break_at_missing_points() {
        let mut picture = Picture::new(10., 10.);
        picture.curve(&[Some([0., 0.]), Some([1., 1.]), None, Some([2., 2.]), None, Some([3., 3.]), Some([4., 4.])], "");
        assert_eq!(picture.finish().matches("<polyline").count(), 2);
    }
}
