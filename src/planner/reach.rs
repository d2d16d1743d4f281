//! Reach of the feet in a state: wider for feet at their limits, and for states from which no candidate holds.

use super::{Planner, RobotState, whole_turns};
use crate::robot::{LARGEST_TURN, Reach, ReachBox, Robot, Sole};
use crate::settings::Stretch;
use std::sync::Arc;

/// Factors of the reach along x, y and z for states from which no candidate holds. A reach box is the largest of which a leg attains all
/// corners, so that the leg attains more in the middle of its sides. Go1 at 0.5 m/s survives six of six pushes of 1.7 N s/kg with them, and
/// one without.
const FACTORS: [f64; 3] = [2., 2., 1.3];
/// Distance from the side of its reach box within which a foot gets a wider box, base heights, and time for which a foot may go on moving
/// outwards, s; and by how much a box is widened at most, base heights: a robot that has fallen has no plan.
const SLACK: f64 = 0.04;
const OUTWARD: f64 = 0.1;
const WIDENED: f64 = 0.25;
/// Angle by which the limit of the yaw of soles is beyond a sole that exceeds it, rad.
const TURN_SLACK: f64 = 0.02;

/// A wider reach. Sides that face a neighbour stay where they are, because legs that cross hit each other.
pub(super) fn stretched(robot: &Robot) -> Reach {
    let boxes: Vec<ReachBox> = (0..robot.feet()).map(|foot| robot.reach.of(foot)).collect();
    // Sides of the box of a foot along an axis, in the frame of the base.
    let sides = |foot: usize, axis: usize| [boxes[foot].low, boxes[foot].high].map(|side| robot.nominal_feet[foot][axis] + side[axis]);
    let reach = (0..robot.feet()).map(|foot| {
        let usual = robot.reach.foot(foot);
        let mut wider = usual.with_sides(|slab| slab.stretched(FACTORS).sides);
        for (axis, across) in [(0, 1), (1, 0)] {
            let ([low, high], [right, left]) = (sides(foot, axis), sides(foot, across));
            let beside = |&other: &usize| sides(other, across)[0] < left && right < sides(other, across)[1];
            for other in (0..robot.feet()).filter(beside) {
                let [from, to] = sides(other, axis);
                let [below, above] = usual.sides[axis];
                if to <= low {
                    wider.sides[axis][0] = below;
                }
                if from >= high {
                    wider.sides[axis][1] = above;
                }
            }
        }
        wider
    });
    Reach::PerFoot(reach.collect())
}

impl Planner {
    /// The robot of the task with the wider reach as well. Along z its own reach, which may already be wider for a foot, is stretched, too.
    pub(super) fn stretching(&self) -> Arc<Robot> {
        let robot = &self.task.robot;
        let reach = (0..robot.feet()).map(|foot| {
            let stretched = self.stretched.foot(foot);
            let mut wider = stretched.slabs();
            robot.reach.foot(foot).with_sides(|slab| {
                let [low, high] = slab.stretched([1., 1., FACTORS[2]]).sides;
                wider.next().map_or([low, high], |wider| [low.min(wider.sides[0]), high.max(wider.sides[1])])
            })
        });
        Arc::new(Robot { reach: Reach::PerFoot(reach.collect()), ..(**robot).clone() })
    }

    /// The robot with wider reach boxes for feet that are at their side or beyond it. Otherwise no motion could start there.
    pub(super) fn reaching(&self, state: &RobotState) -> Arc<Robot> {
        let (robot, base) = (&self.robot, &state.base);
        let slack = SLACK * robot.base_height;
        let mut widened = false;
        let reaching = state.feet.iter().enumerate().map(|(foot, at)| {
            let moved = |time: f64| std::array::from_fn(|i| at.position[i] + time * (at.velocity[i] - base.velocity[i]));
            let mut soon = base.to_base(moved(OUTWARD));
            let late = self.touched.missed[foot].then(|| {
                let [x, y, _] = at.position;
                base.to_base([x, y, self.task.terrain.height(x, y)])
            });
            if let Some(late) = late {
                soon[2] = soon[2].min(late[2]);
            }
            let now = base.to_base(moved(0.));
            robot.reach.foot(foot).with_sides(|slab| {
                let [low, high] = slab.sides;
                let nominal = slab.along(robot.nominal_feet[foot]);
                let [now, soon] = [now, soon].map(|place| slab.along(place) - nominal);
                // A foot that found no ground reaches for it.
                let down = if late.is_some() { -slab.normal[2] } else { 0. };
                let below = now < low + slack || down < 0. && soon < low + slack;
                let above = now > high - slack || down > 0. && soon > high - slack;
                widened |= below || above;
                let most = WIDENED * robot.base_height;
                let side = |side: f64, beyond: f64, is: bool| if is { beyond.clamp(side - most, side + most) } else { side };
                [side(low, low.min(now.min(soon) - slack), below), side(high, high.max(now.max(soon) + slack), above)]
            })
        });
        let reach = Reach::PerFoot(reaching.collect());
        let sole = robot.sole.map(|sole| self.turning(state, sole));
        if widened || sole != robot.sole { Arc::new(Robot { reach, sole, ..(**robot).clone() }) } else { robot.clone() }
    }

    /// The sole with a larger limit of its yaw if a standing one is at the limit or beyond it. Otherwise no motion could start there.
    fn turning(&self, state: &RobotState, sole: Sole) -> Sole {
        let standing = state.feet.iter().zip(&self.contacts).filter(|(_, contact)| !contact.in_air);
        let turned = standing.flat_map(|(at, _)| {
            let apart = state.base.yaw() - at.yaw;
            let now = apart - whole_turns(apart);
            [now, now + OUTWARD * state.base.rates[2]].map(|angle| angle.abs() + TURN_SLACK)
        });
        Sole { turn: turned.fold(sole.turn, f64::max).min(LARGEST_TURN), ..sole }
    }

    /// Gives each foot the reach of the task in the stance and the swing with which it begins, and that of the robot later. Otherwise steps
    /// towards a neighbour would become longer and longer, until feet hit each other.
    pub(super) fn limit_later_steps(&mut self) {
        let wider = &self.task.robot.reach;
        let stretch = (*wider != self.robot.reach).then(|| Stretch { reach: Arc::new(wider.clone()), until: 0. });
        (self.transcription.stretch, self.full.stretch) = (stretch.clone(), stretch);
    }

    /// The robot of the problems of an update, without the reach that feet have only at the start.
    pub(super) fn later(&self) -> Arc<Robot> {
        let robot = &self.task.robot;
        if robot.reach == self.robot.reach {
            return robot.clone();
        }
        Arc::new(Robot { reach: self.robot.reach.clone(), ..(**robot).clone() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planner::{Command, PlannerSettings};
    use crate::terrain::Terrain;

    #[test]
    fn the_wider_reach_ends_where_a_neighbour_begins() {
        let robot = Robot::named("anymal").unwrap();
        let (usual, wider) = (robot.reach.clone(), stretched(&robot));
        for (foot, [x, y, _]) in robot.nominal_feet.iter().enumerate() {
            let ([usual, wider], outside) = ([usual.of(foot), wider.of(foot)], [x, y].map(|v| usize::from(*v > 0.)));
            for (axis, outer) in outside.into_iter().enumerate() {
                let [usual, wider] = [usual, wider].map(|of| [of.low[axis], of.high[axis]]);
                assert_eq!(wider[outer], FACTORS[axis] * usual[outer]);
                assert_eq!(wider[1 - outer], usual[1 - outer]);
            }
            assert_eq!([wider.low[2], wider.high[2]], [usual.low[2], usual.high[2]].map(|side| FACTORS[2] * side));
        }
    }

    #[test]
    fn a_foot_beyond_its_side_gets_a_wider_reach_for_its_first_steps_only() {
        let mut planner = Planner::new(Robot::named("anymal").unwrap(), Terrain::flat(), PlannerSettings::default()).unwrap();
        let mut state = RobotState::standing(&planner.task);
        let side = planner.robot.reach.of(1).high[1];
        state.feet[1].position[1] += side + 0.02;
        planner.update(&state, &Command::default(), 0.).unwrap();
        let (wider, usual) = (&planner.task.robot.reach, &planner.robot.reach);
        assert!(wider.of(1).high[1] > side + 0.02, "{wider:?}");
        let first = Some(Stretch { reach: Arc::new(wider.clone()), until: 0. });
        assert!(planner.transcription.stretch == first && planner.full.stretch == first);
        let candidates = planner.candidates(&planner.steady(0.02)).unwrap();
        assert!(candidates.iter().all(|candidate| candidate.task.robot.reach == *usual));
    }
}
