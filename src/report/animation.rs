//! A motion as an animated SVG for pages without scripts: the robot seen from the side and slightly from above, its gait below, in real
//! time.

use super::samples::{FOOT_COLORS, Sample, Sampler, body_size, foot_names, hips};
use super::svg::Picture;
use crate::error::Result;
use crate::gait::Trajectory;
use crate::robot::Robot;
use crate::terrain::Terrain;
use std::fmt::Write;

/// Frames per second. The viewer interpolates between them.
const RATE: f64 = 20.;

/// Width of the picture, pixels.
const WIDTH: f64 = 880.;
/// Margin, pixels.
const MARGIN: f64 = 26.;
/// Height of a bar of the gait, pixels.
const BAR: f64 = 9.;
/// Height of a bar with the gap below it, pixels.
const LINE: f64 = 13.;

/// Projection of 1 m to the left of the direction of travel: to the right and up in the picture, m.
const SIDEWAYS: [f64; 2] = [0.3, 0.22];

/// Ground shown before the start and after the end, and to either side, in leg heights.
const AROUND: [f64; 2] = [1.6, 1.1];

/// Drawn length of a force equal to the robot's weight, in leg heights.
const FORCE: f64 = 0.9;

/// Projection of world points to pixels.
struct View {
    /// Direction of travel (x, y), unit.
    ahead: [f64; 2],
    /// Upper left corner of the scene in the projected plane, m.
    corner: [f64; 2],
    /// Pixels per metre.
    scale: f64,
}

impl View {
    /// Coordinates along the direction of travel and to its left, m.
    fn along(&self, [x, y, _]: [f64; 3]) -> [f64; 2] {
        let [c, s] = self.ahead;
        [c * x + s * y, c * y - s * x]
    }

    /// Projected coordinates to the right and up, m.
    fn flat(&self, point: [f64; 3]) -> [f64; 2] {
        let [ahead, left] = self.along(point);
        [ahead + SIDEWAYS[0] * left, point[2] + SIDEWAYS[1] * left]
    }

    fn pixel(&self, point: [f64; 3]) -> [f64; 2] {
        let [u, v] = self.flat(point);
        [(u - self.corner[0]) * self.scale + MARGIN, (self.corner[1] - v) * self.scale + MARGIN]
    }
}

/// Animated picture of a motion.
///
/// # Errors
/// See [`Sampler::new`].
pub fn animation(trajectory: &Trajectory, robot: &Robot, terrain: &Terrain) -> Result<String> {
    let sampler = Sampler::new(trajectory, robot, terrain)?;
    let samples = sampler.samples(RATE);
    let scene = Scene::new(&samples, robot, terrain);
    let view = &scene.view;
    let mut picture = Picture::new(WIDTH, scene.height + LINE * robot.feet() as f64 + MARGIN);
    let outline: Vec<[f64; 2]> = scene.outline.iter().map(|&p| view.pixel(p)).collect();
    picture.polygon(&outline, r##"fill="#eef3f7" stroke="#b8c4cf" stroke-width="1""##);
    for (foot, color) in FOOT_COLORS.iter().enumerate().take(robot.feet()) {
        for stance in sampler.stances(foot) {
            let style = format!(r#"fill="none" stroke="{color}" stroke-width="1" opacity="0.45""#);
            if stance.corners.is_empty() {
                picture.circle(view.pixel(stance.foothold), 0.035 * robot.leg_height() * view.scale, &style);
            } else {
                let corners: Vec<[f64; 2]> = stance.corners.iter().map(|&corner| view.pixel(corner)).collect();
                picture.polygon(&corners, &style);
            }
        }
    }
    let moving = Moving { samples: &samples, duration: trajectory.horizon, view };
    // Legs of the far side first, then the body, then legs of the near side.
    let legs = |picture: &mut Picture, far_side: bool| {
        let side = (0..robot.feet()).filter(|&foot| (robot.nominal_feet[foot][1] > 0.) == far_side);
        side.for_each(|foot| moving.leg(picture, robot, foot));
    };
    legs(&mut picture, true);
    moving.body(&mut picture, robot);
    legs(&mut picture, false);
    draw_gait(&mut picture, &sampler, robot, trajectory.horizon, scene.height);
    Ok(picture.finish())
}

/// Layout of the scene: projection, ground and size.
struct Scene {
    view: View,
    /// Edges of the ground on both sides of the path, as a closed polygon, world frame.
    outline: Vec<[f64; 3]>,
    /// Height of the scene in the picture, pixels.
    height: f64,
}

impl Scene {
    /// Fits the ground and all base positions into the width of the picture.
    fn new(samples: &[Sample], robot: &Robot, terrain: &Terrain) -> Scene {
        let leg = robot.leg_height();
        let (from, to) = (samples[0].base.position, samples[samples.len() - 1].base.position);
        let displacement = [to[0] - from[0], to[1] - from[1]];
        let length = displacement[0].hypot(displacement[1]);
        let ahead = if length > 0.1 * leg { displacement.map(|v| v / length) } else { [1., 0.] };
        let mut view = View { ahead, corner: [0.; 2], scale: 1. };

        let side = robot.nominal_feet.iter().map(|foot| foot[0].hypot(foot[1])).fold(0., f64::max) + AROUND[1] * leg * 0.5;
        let ends = [view.along(from)[0] - side - AROUND[0] * leg, view.along(to)[0] + side + AROUND[0] * leg];
        let middle = view.along(from)[1];
        let ground = |u: f64, left: f64| {
            let [c, s] = ahead;
            let (x, y) = (c * u - s * (middle + left), s * u + c * (middle + left));
            [x, y, terrain.height(x, y)]
        };
        const PARTS: usize = 240;
        let edge = |left: f64| -> Vec<[f64; 3]> {
            (0..=PARTS).map(|i| ground(ends[0] + (ends[1] - ends[0]) * i as f64 / PARTS as f64, left)).collect()
        };
        let (near, far) = (edge(-side), edge(side));
        let flat = near.iter().chain(&far).map(|&p| view.flat(p)).chain(samples.iter().map(|s| {
            let [x, y, z] = s.base.position;
            view.flat([x, y, z + 0.8 * leg])
        }));
        let bounds = flat.fold([[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]], |[low, high], [u, v]| {
            [[low[0].min(u), low[1].min(v)], [high[0].max(u), high[1].max(v)]]
        });
        view.scale = (WIDTH - 2. * MARGIN) / (bounds[1][0] - bounds[0][0]);
        view.corner = [bounds[0][0], bounds[1][1]];
        let height = (bounds[1][1] - bounds[0][1]) * view.scale + 2. * MARGIN;
        Scene { view, outline: near.into_iter().chain(far.into_iter().rev()).collect(), height }
    }
}

/// Draws the gait below `top`, with a cursor at the current time.
fn draw_gait(picture: &mut Picture, sampler: &Sampler, robot: &Robot, horizon: f64, top: f64) {
    let (x0, x1) = (MARGIN + 30., WIDTH - MARGIN);
    let time = |t: f64| x0 + (x1 - x0) * t / horizon;
    for (foot, name) in foot_names(robot).into_iter().enumerate() {
        let y = top + LINE * foot as f64;
        picture.text(MARGIN, y + BAR, "start", r##"font-size="10" fill="#333""##, &name);
        picture.box_of([x0, y], [x1, y + BAR], r##"fill="#f0f1f2""##);
        for stance in sampler.stances(foot) {
            let [start, end] = stance.times.map(time);
            picture.box_of([start, y], [end, y + BAR], &format!(r#"fill="{}""#, FOOT_COLORS[foot]));
        }
    }
    let bottom = top + LINE * robot.feet() as f64;
    let cursor = format!(
        r##"<line x1="{x0:.1}" y1="{top:.1}" x2="{x0:.1}" y2="{bottom:.1}" stroke="#111" stroke-width="1.5"><animateTransform attributeName="transform" type="translate" values="0;{:.1}" dur="{horizon:.2}s" repeatCount="indefinite"/></line>"##,
        x1 - x0
    );
    picture.element(&cursor);
    picture.text(x1, bottom + 14., "end", r##"font-size="10" fill="#333""##, &format!("{horizon:.2} s, at real speed"));
}

/// World position of a point given in the base frame, m.
fn to_world(sample: &Sample, point: [f64; 3]) -> [f64; 3] {
    let [w, x, y, z] = sample.base.quaternion;
    let rotation = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
    let place = rotation * nalgebra::Vector3::from(point);
    std::array::from_fn(|i| sample.base.position[i] + place[i])
}

type Place<'a> = &'a dyn Fn(&Sample) -> [f64; 3];

/// Elements that follow the motion.
struct Moving<'a> {
    samples: &'a [Sample],
    /// Duration, s.
    duration: f64,
    view: &'a View,
}

impl Moving<'_> {
    /// Draws a leg, with the force of its foot.
    fn leg(&self, picture: &mut Picture, robot: &Robot, foot: usize) {
        let (leg, weight, hip) = (robot.leg_height(), robot.weight(), hips(robot)[foot]);
        let color = FOOT_COLORS[foot];
        let width = 0.06 * leg * self.view.scale;
        let at = |s: &Sample| s.feet[foot].position;
        let tip = |s: &Sample| {
            let (p, f) = (s.feet[foot].force_origin(), s.feet[foot].force);
            std::array::from_fn(|i| p[i] + FORCE * leg * f[i] / weight)
        };
        self.line(
            picture,
            |s| s.feet[foot].force_origin(),
            tip,
            &format!(r#"stroke="{color}" stroke-width="{:.1}" opacity="0.5""#, 0.5 * width),
        );
        let style = format!(r#"stroke="{color}" stroke-width="{width:.1}" stroke-linecap="round""#);
        self.line(picture, at, |s| to_world(s, hip), &style);
        let Some(sole) = robot.sole else {
            return self.circle(picture, at, 0.075 * leg * self.view.scale, &format!(r#"fill="{color}""#));
        };
        let end = |share: f64| {
            move |s: &Sample| {
                let along = s.feet[foot].sole.as_ref().map_or([0.; 3], |sole| sole.axes[0]);
                std::array::from_fn(|i| s.feet[foot].position[i] + share * sole.length * along[i])
            }
        };
        self.line(picture, end(-0.5), end(0.5), &style);
    }

    /// Draws the upper and the near face of the body.
    fn body(&self, picture: &mut Picture, robot: &Robot) {
        let half = body_size(robot).map(|v| v / 2.);
        let corner = |sx: f64, sy: f64, sz: f64| move |s: &Sample| to_world(s, [sx * half[0], sy * half[1], sz * half[2]]);
        let face = r##"stroke="#33414d" stroke-width="1" stroke-linejoin="round""##;
        let upper: [Place; 4] = [&corner(1., 1., 1.), &corner(-1., 1., 1.), &corner(-1., -1., 1.), &corner(1., -1., 1.)];
        self.polygon(picture, &upper, &format!(r##"fill="#9aa9b5" {face}"##));
        let near: [Place; 4] = [&corner(1., -1., 1.), &corner(-1., -1., 1.), &corner(-1., -1., -1.), &corner(1., -1., -1.)];
        self.polygon(picture, &near, &format!(r##"fill="#7d8d9a" {face}"##));
    }

    /// Animation of an attribute over all samples.
    fn animate(&self, attribute: &str, value: impl Fn(&Sample) -> String) -> String {
        let mut text = format!(r#"<animate attributeName="{attribute}" dur="{:.2}s" repeatCount="indefinite" keyTimes=""#, self.duration);
        let separated = |text: &mut String, number: usize, value: std::fmt::Arguments| {
            // Writing to a string cannot fail.
            let _ = write!(text, "{}{value}", if number > 0 { ";" } else { "" });
        };
        for (number, sample) in self.samples.iter().enumerate() {
            separated(&mut text, number, format_args!("{:.4}", (sample.time / self.duration).min(1.)));
        }
        text += r#"" values=""#;
        for (number, sample) in self.samples.iter().enumerate() {
            separated(&mut text, number, format_args!("{}", value(sample)));
        }
        text + r#""/>"#
    }

    fn line(&self, picture: &mut Picture, from: impl Fn(&Sample) -> [f64; 3], to: impl Fn(&Sample) -> [f64; 3], style: &str) {
        let ends = |s: &Sample| [self.view.pixel(from(s)), self.view.pixel(to(s))];
        let [[x1, y1], [x2, y2]] = ends(&self.samples[0]);
        let parts = [("x1", 0, 0), ("y1", 0, 1), ("x2", 1, 0), ("y2", 1, 1)];
        let moves: String = parts.iter().map(|&(name, end, axis)| self.animate(name, |s| format!("{:.1}", ends(s)[end][axis]))).collect();
        picture.element(&format!(r#"<line x1="{x1:.1}" y1="{y1:.1}" x2="{x2:.1}" y2="{y2:.1}" {style}>{moves}</line>"#));
    }

    fn circle(&self, picture: &mut Picture, at: impl Fn(&Sample) -> [f64; 3], radius: f64, style: &str) {
        let [x, y] = self.view.pixel(at(&self.samples[0]));
        let moves: String = [("cx", 0), ("cy", 1)]
            .iter()
            .map(|&(name, axis)| self.animate(name, |s| format!("{:.1}", self.view.pixel(at(s))[axis])))
            .collect();
        picture.element(&format!(r#"<circle cx="{x:.1}" cy="{y:.1}" r="{radius:.1}" {style}>{moves}</circle>"#));
    }

    fn polygon(&self, picture: &mut Picture, corners: &[Place], style: &str) {
        let points = |s: &Sample| {
            let pixels = corners.iter().map(|corner| self.view.pixel(corner(s)));
            pixels.map(|[x, y]| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ")
        };
        let moves = self.animate("points", points);
        picture.element(&format!(r#"<polygon points="{}" {style}>{moves}</polygon>"#, points(&self.samples[0])));
    }
}
