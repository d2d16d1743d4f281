//! Places with room for a foot on ground with edges, where the whole foot ball is supported by one patch of ground.
//!
//! Footholds start at such a place, and rows keep them within a box of such places, so that a solution is not attracted into a riser or
//! over a gap. The ground is sampled on two circles around a place. The ground between the samples and the corners of the boxes are checked
//! by the certificate only.

use crate::settings::{Transcription, TranscriptionSettings};
use crate::task::Task;
use crate::terrain::Terrain;
use std::f64::consts::TAU;
use std::sync::LazyLock;

/// Largest deviation of the ground from the tangent plane of a place, in radii; slightly less than the certificate allows.
const OFF_PLANE: f64 = 0.45;
/// Largest penetration of the ground into the foot ball, in radii; slightly less than the certificate allows.
const IN_BALL: f64 = 0.1;
/// Largest deviation of the ground from the plane of a sole, m; slightly less than the certificate allows.
const OFF_SOLE: f64 = 4e-3;
/// Circles on which the ground is sampled, in radii. The outer circle meets any straight edge within one radius.
const CIRCLES: [f64; 2] = [0.5, 1.03];
/// Number of samples per circle.
const SAMPLES: usize = 16;
/// Horizontal distance in m that counts as much as a height difference of 1 m from the desired level. With it a foot goes around a
/// pit rather than into it, and up a slope if the base does.
const ASIDE: f64 = 0.5;
/// Search distance around a guess, as a multiple of the distance that a foothold may move: a gap may be as wide as a step.
const FAR: f64 = 2.;
/// Distance between the places that are tried, in radii.
const STEP: f64 = 0.5;
/// Smallest distance between the places that are tried, as a fraction of the distance that a foothold may move.
const FINEST: f64 = 0.01;
/// Number of bisections that refine the sides of a box.
const HALVINGS: usize = 6;

/// Room for a foothold, world frame, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FootholdRegion {
    /// Nearest place to the requested one with room for the foot, preferably one whose slope friction can hold; the requested place if none
    /// is found.
    pub at: [f64; 2],
    /// Lower sides of a box around `at` that has room along both axes.
    pub low: [f64; 2],
    /// Upper sides of that box.
    pub high: [f64; 2],
}

/// Radius by which the feet of a task keep clear of edges, m; that of a sole is its half diagonal. 0 for point feet and on ground without
/// edges.
pub fn radius(task: &Task, settings: &TranscriptionSettings) -> f64 {
    let asked = settings.rows == Transcription::Momentum && task.terrain.has_edges();
    if asked { task.robot.sole.map_or(task.robot.foot_radius(), |sole| sole.radius()) } else { 0. }
}

/// Search for a place with room for a foot.
pub struct Search<'a> {
    pub terrain: &'a Terrain,
    /// Radius of the foot, m, greater than 0.
    pub radius: f64,
    /// Largest height of the ground above and below the tangent plane of a place, and largest penetration of a foot ball, in radii.
    pub off_plane: f64,
    pub in_ball: f64,
    /// Distance that a foothold may move from its start, m.
    pub around: f64,
    /// Direction along y that is tried first, 1 or -1; it makes the search of left and right feet mirror images.
    pub side: f64,
}

impl Search<'_> {
    /// Search for one foot of a task's robot.
    pub fn of(task: &Task, foot: usize, radius: f64) -> Search<'_> {
        let [along, across, _] = task.robot.reach.of(foot).widths();
        let side = if task.robot.nominal_feet[foot][1] < 0. { -1. } else { 1. };
        let [off_plane, in_ball] = if task.robot.sole.is_some() { [OFF_SOLE / radius; 2] } else { [OFF_PLANE, IN_BALL] };
        Search { terrain: &task.terrain, radius, off_plane, in_ball, around: along.max(across), side }
    }

    /// Distance between the places that are tried, m.
    fn step(&self) -> f64 {
        (STEP * self.radius).max(FINEST * self.around)
    }

    /// Footing near a place.
    ///
    /// * `level` - height of the ground for which the base has its planned height, m
    pub fn footing(&self, at: [f64; 2], level: f64) -> FootholdRegion {
        let good = |place| self.has_room(place) && self.is_gentle(place);
        let room = |place| self.has_room(place);
        if let Some(found) = self.nearest(at, level, good) {
            return self.boxed(found, good);
        }
        match self.nearest(at, level, room) {
            Some(found) => self.boxed(found, room),
            None => FootholdRegion { at, low: at.map(|v| v - self.around), high: at.map(|v| v + self.around) },
        }
    }

    /// Nearest admissible place, including the cost of its height, among the places on circles of growing radius.
    fn nearest(&self, at: [f64; 2], level: f64, will_do: impl Fn([f64; 2]) -> bool) -> Option<[f64; 2]> {
        /// Order of the directions, axes first: if the ground varies along one axis only, the nearest place is there.
        const DIRECTIONS: [usize; SAMPLES] = [0, 8, 4, 12, 2, 6, 10, 14, 1, 3, 5, 7, 9, 11, 13, 15];
        let circles = (FAR * self.around / self.step()).ceil() as usize;
        let mut best = (f64::INFINITY, None);
        for circle in 0..=circles {
            let distance = circle as f64 * self.step();
            if distance >= best.0 {
                break;
            }
            for &k in &DIRECTIONS[..if circle == 0 { 1 } else { SAMPLES }] {
                let [x, y] = on_circle([0.; 2], distance, k);
                let place = [at[0] + x, at[1] + self.side * y];
                let far = distance + ASIDE * (self.terrain.height(place[0], place[1]) - level).abs();
                // Among places that differ only by rounding, the first is kept.
                if far < best.0 - 1e-9 && will_do(place) {
                    best = (far, Some(place));
                }
            }
        }
        best.1
    }

    /// Footing at a place, with the box around it.
    fn boxed(&self, at: [f64; 2], will_do: impl Fn([f64; 2]) -> bool) -> FootholdRegion {
        let [low, high] = [-1., 1.].map(|sign| at.map(|v| v + sign * self.around));
        let reached = CIRCLES[1] * self.radius;
        if self.terrain.is_plane(low.map(|v| v - reached), high.map(|v| v + reached)) {
            return FootholdRegion { at, low, high };
        }
        let step = self.step();
        let side = |axis: usize, sign: f64| {
            let moved = |by: f64| {
                let mut place = at;
                place[axis] += sign * by;
                place
            };
            let mut inside = 0.;
            while inside < self.around {
                let next = (inside + step).min(self.around);
                if !will_do(moved(next)) {
                    let mut outside = next;
                    for _ in 0..HALVINGS {
                        let middle = (inside + outside) / 2.;
                        *(if will_do(moved(middle)) { &mut inside } else { &mut outside }) = middle;
                    }
                    break;
                }
                inside = next;
            }
            moved(inside)[axis]
        };
        FootholdRegion { at, low: [side(0, -1.), side(1, -1.)], high: [side(0, 1.), side(1, 1.)] }
    }

    /// True if the whole foot ball at a place is supported by the tangent plane of the ground.
    fn has_room(&self, at: [f64; 2]) -> bool {
        let reached = CIRCLES[1] * self.radius;
        if self.terrain.is_plane(at.map(|v| v - reached), at.map(|v| v + reached)) {
            return true;
        }
        let here = self.terrain.ground(at[0], at[1]);
        CIRCLES.iter().all(|part| {
            // Height of the lower side of a ball at rest.
            let ball = 1. - (1. - part * part).max(0.).sqrt();
            let (highest, lowest) = (self.off_plane.min(ball + self.in_ball) * self.radius, -self.off_plane * self.radius);
            (0..SAMPLES).all(|k| {
                let [x, y] = on_circle(at, part * self.radius, k);
                let off = self.terrain.height(x, y) - here.height - here.slope[0] * (x - at[0]) - here.slope[1] * (y - at[1]);
                (lowest..=highest).contains(&off)
            })
        })
    }

    /// True if friction holds a foot here without support from another foot.
    fn is_gentle(&self, at: [f64; 2]) -> bool {
        let [x, y] = self.terrain.ground(at[0], at[1]).slope;
        x.hypot(y) <= self.terrain.friction
    }
}

/// One of the [`SAMPLES`] points of a circle.
fn on_circle([x, y]: [f64; 2], radius: f64, k: usize) -> [f64; 2] {
    static DIRECTIONS: LazyLock<[(f64, f64); SAMPLES]> =
        LazyLock::new(|| std::array::from_fn(|k| (TAU * k as f64 / SAMPLES as f64).sin_cos()));
    let (sin, cos) = DIRECTIONS[k];
    [x + radius * cos, y + radius * sin]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;
    use crate::task::Goal;
    use crate::terrain::{Grid, Shape};

    fn task(robot: &str, terrain: Terrain) -> Task {
        Task::new(Robot::named(robot).unwrap(), terrain, Goal::at(2.5, 0.)).unwrap()
    }

    fn named(terrain: &str) -> Task {
        task("anymal", Terrain::named(terrain).unwrap())
    }

    /// Footing of ANYmal's first foot near (x, 0.1).
    fn near(task: &Task, x: f64) -> FootholdRegion {
        Search::of(task, 0, radius(task, &TranscriptionSettings::default())).footing([x, 0.1], 0.)
    }

    #[test]
    fn a_foothold_over_a_gap_moves_to_its_rim_and_keeps_its_distance() {
        // The gap is from 1.0 to 1.6 m; its walls have a slope of 10.
        let task = named("gap");
        let radius = task.robot.foot_radius();
        let rim = |room: &FootholdRegion| if room.at[0] < 1.3 { room.high[0] - 1. } else { 1.6 - room.low[0] };
        for x in [1.05, 1.2, 1.29, 1.31, 1.5, 0.9, 1.7] {
            let room = near(&task, x);
            assert!(room.at[0] < 1. - 0.9 * radius || room.at[0] > 1.6 + 0.9 * radius, "{x}: {room:?}");
            assert!(rim(&room) < -0.9 * radius && rim(&room) > -1.1 * radius, "{x}: {room:?}");
            // Along y the box has its full width.
            let across = [room.low[1] - (0.1 - 0.3), room.high[1] - (0.1 + 0.3), room.at[1] - 0.1];
            assert!(across.iter().all(|v| v.abs() < 1e-12), "{room:?}");
        }
        // A foothold that has room stays.
        assert_eq!(near(&task, 0.9).at, [0.9, 0.1]);
    }

    #[test]
    fn a_foothold_avoids_the_floor_of_a_pit_and_uses_a_tread() {
        let terrain = |height: fn(usize) -> f64| {
            let heights = (0..300).map(|i| vec![height(i); 2]).collect();
            Terrain { shape: Shape::Grid(Grid { low: [-1., -2.], high: [5., 2.], heights }), ..Terrain::flat() }
        };
        // 1 m deep beyond 1.0 m, with a wall of 2 cm: the floor is nearer.
        let room = near(&task("anymal", terrain(|i| if i >= 100 { -1. } else { 0. })), 0.996);
        assert!(room.at[0] < 0.96 && room.high[0] < 0.96, "{room:?}");
        // 0.5 m deep from 1.0 to 1.2 m, with walls of 2 cm.
        let room = near(&task("anymal", terrain(|i| if (100..110).contains(&i) { -0.5 } else { 0. })), 1.08);
        assert!(room.at[0] < 1. && room.high[0] < 0.96, "{room:?}");
        // Treads of 0.3 m, risers of 0.12 m with a length of 2 cm.
        let room = near(&task("anymal", terrain(|i| 0.12 * ((i.max(85) - 85) / 15) as f64)), 1.08);
        assert!(room.low[0] > 1. + 0.02 && room.high[0] < 1.28 - 0.02 && room.high[0] - room.low[0] > 0.2, "{room:?}");
    }

    #[test]
    fn a_box_on_a_plane_needs_no_samples_and_has_room() {
        let task = named("step");
        for at in [[2.9, 0.1], [3.8, 0.1], [4.5, -0.2]] {
            let search = Search { radius: 0.031, around: 0.15, ..Search::of(&task, 0, 0.031) };
            let on_plane = search.boxed(at, |_| panic!("{at:?} was sampled"));
            assert_eq!([on_plane.low, on_plane.high], [-0.15, 0.15].map(|by| at.map(|v| v + by)));
            assert!([on_plane.low, on_plane.high, at].iter().all(|place| search.has_room(*place)));
        }
    }

    #[test]
    fn the_radius_is_zero_without_edges_and_small_slope_changes_are_not_edges() {
        let settings = TranscriptionSettings::default();
        assert_eq!(radius(&named("flat"), &settings), 0.);
        let towr = TranscriptionSettings { rows: Transcription::Towr, ..settings.clone() };
        assert_eq!(radius(&named("gap"), &towr), 0.);
        let pointed = Robot { foot_radius: Some(0.), ..Robot::named("anymal").unwrap() };
        assert_eq!(radius(&Task { robot: pointed.into(), ..named("gap") }, &settings), 0.);
        // The ramp of the step begins at 3.6 m and has a slope of 0.375.
        let room = near(&named("step"), 3.6);
        assert_eq!(room.at, [3.6, 0.1]);
        let sides = [room.low[0] - 3.3, room.high[0] - 3.9, room.low[1] + 0.2, room.high[1] - 0.4];
        assert!(sides.iter().all(|v| v.abs() < 1e-12), "{room:?}");
    }
}
