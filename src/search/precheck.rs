//! Checks of a task before the search, in milliseconds: can the robot stand at the start and at the goal, is there terrain under its feet,
//! and are the requested gaits long enough for the distance?

use super::{Gaits, SearchSettings};
use crate::error::Error;
use crate::gait::Schedule;
use crate::gait::swing::TOP_SPEED;
use crate::nlp::transcription::{force_limit, legs};
use crate::robot::{Robot, Slab};
use crate::settings::{Transcription, TranscriptionSettings};
use crate::task::Task;
use crate::verify::TOLERANCE;
use crate::verify::report::DENSE_REACH;
use serde::Serialize;

/// Obstacle to a gait that the check found.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Finding {
    /// True if no gait can exist; otherwise a gait is unlikely.
    pub certain: bool,
    /// Subject of the finding, e.g. `goal, foot 2`.
    pub place: String,
    /// Observation, with numbers.
    pub found: String,
    /// Advice to remove the obstacle.
    pub remedy: String,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}, but it must be {}", self.place, self.found, self.remedy)
    }
}

impl From<Finding> for Error {
    fn from(finding: Finding) -> Error {
        Error::Invalid { place: finding.place, value: finding.found, limit: finding.remedy }
    }
}

/// Obstacles to a gait for a task, certain ones first. Empty if the task may well have a gait.
pub fn precheck(task: &Task, search: &SearchSettings, settings: &TranscriptionSettings) -> Vec<Finding> {
    let mut findings = Vec::new();
    findings.extend(feet_out_of_reach(task));
    findings.extend(ground_out_of_reach(task, settings, End::Start));
    findings.extend(ground_out_of_reach(task, settings, End::Goal));
    findings.extend(outside_terrain(task));
    findings.extend(implausible_body(&task.robot));
    findings.extend(weight_not_carried(task, settings));
    match &search.gaits {
        Gaits::Around(schedule) => findings.extend(schedule_too_short(task, settings, schedule)),
        Gaits::Free => findings.extend(free_schedules_too_short(task, search, settings)),
        Gaits::All | Gaits::Families(_) => {}
    }
    findings.sort_by_key(|finding| !finding.certain);
    findings
}

/// End of the motion at which the robot stands.
#[derive(Clone, Copy, PartialEq)]
enum End {
    /// Start, with the feet at the footholds of the task.
    Start,
    /// Goal, with the feet anywhere within reach.
    Goal,
}

/// Lowest and highest ground that a foot can stand on at one end, m.
fn ground_under(task: &Task, end: End, foot: usize) -> [f64; 2] {
    match end {
        End::Start => [task.ground_at_start(foot); 2],
        End::Goal => task.ground_at_goal(foot),
    }
}

/// Finding if a foot at the start is outside its reach: along x or y of the base frame, or beyond a diagonal face.
fn feet_out_of_reach(task: &Task) -> Option<Finding> {
    let robot = &task.robot;
    let place = |foot: usize| {
        let [x, y] = task.foothold_start(foot);
        task.start.to_base([x, y, task.terrain.height(x, y)])
    };
    let excess = |foot: usize| {
        let (place, nominal) = (place(foot), robot.nominal_feet[foot]);
        let offset: [f64; 3] = std::array::from_fn(|d| place[d] - nominal[d]);
        let beyond = |(number, slab): (usize, Slab)| {
            let [low, high] = slab.sides;
            ((slab.along(offset) - high).max(low - slab.along(offset)), foot, number)
        };
        // [`ground_out_of_reach`] looks at the heights.
        robot.reach.foot(foot).slabs().enumerate().filter(|(number, _)| *number != 2).map(beyond).collect::<Vec<_>>()
    };
    let (excess, foot, number) = (0..robot.feet()).flat_map(excess).max_by(|a, b| a.0.total_cmp(&b.0))?;
    let (place, nominal, slab) = (place(foot), robot.nominal_feet[foot], robot.reach.foot(foot).slab(number));
    let at = match number {
        0 | 1 => format!("at {} = {:.3} m in the base frame", ["x", "y"][number], place[number]),
        _ => format!("at {place:.3?} m in the base frame, {:.3} m along {:.3?}", slab.along(place), slab.normal),
    };
    let [low, high] = slab.sides.map(|side| slab.along(nominal) + side);
    (excess > TOLERANCE).then(|| Finding {
        certain: excess > DENSE_REACH + TOLERANCE,
        place: format!("start, foot {foot}"),
        found: format!("it is {at}, {excess:.3} m outside its reach"),
        remedy: format!("within reach, from {low:.3} to {high:.3} m: move the foot or the base at the start"),
    })
}

/// Finding if the ground at one end is too high or too low for the vertical reach of a foot.
fn ground_out_of_reach(task: &Task, settings: &TranscriptionSettings, end: End) -> Option<Finding> {
    let robot = &task.robot;
    let state = if end == End::Start { &task.start } else { &task.goal };
    let base = state.position;
    // Lowest and highest points within reach along the world vertical, which are farther if the base is tilted.
    let levels = |foot: usize| {
        let (nominal, reach) = (robot.nominal_feet[foot][2], robot.reach.of(foot));
        [reach.low[2], reach.high[2]].map(|to| (nominal + to) / state.rotation()[2][2])
    };
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    // Largest excess over the reach, its foot and the nearest ground.
    let mut worst = (0., 0, 0.);
    for foot in 0..robot.feet() {
        let ([bottom, top], [lowest, highest]) = (levels(foot), ground_under(task, end, foot));
        low = low.max(lowest - top);
        high = high.min(highest - bottom);
        for (excess, ground) in [(lowest - (base[2] + top), lowest), (base[2] + bottom - highest, highest)] {
            if excess > worst.0 {
                worst = (excess, foot, ground);
            }
        }
    }
    let (excess, foot, ground) = worst;
    if excess <= TOLERANCE {
        return None;
    }
    let allowed = if settings.rows == Transcription::Momentum { DENSE_REACH } else { 0. };
    let under = base[2] - ground;
    let [bottom, top] = levels(foot);
    let (name, what) = match end {
        End::Start => ("start", "the ground under it"),
        End::Goal => ("goal", "the nearest ground within its reach along x and y"),
    };
    Some(Finding {
        certain: excess > allowed + TOLERANCE,
        place: format!("{name}, foot {foot}"),
        found: format!("{what} is {under:.3} m below the base, {excess:.3} m outside its reach from {:.3} to {:.3} m below", -top, -bottom),
        remedy: height_remedy(task, end, base, [low, high]),
    })
}

/// Advice for a base from which not all feet reach the ground.
///
/// * `base` - position of the base, world frame, m
/// * `low`, `high` - lowest and highest base from which all feet reach the ground, m; contradictory if `low > high`
fn height_remedy(task: &Task, end: End, base: [f64; 3], [low, high]: [f64; 2]) -> String {
    if low > high {
        let spread = "level enough for all feet: no height of the base is within reach of all";
        match end {
            End::Start => format!("{spread}; use a larger `reach` of the robot, or move the terrain under it"),
            End::Goal => format!("{spread}; choose another goal, or a larger `reach` of the robot"),
        }
    } else {
        match end {
            End::Start => {
                let ground = task.terrain.height(base[0], base[1]);
                format!(
                    "within reach: use a `base_height` of the robot from {:.3} to {:.3} m, or a larger `reach`",
                    low - ground,
                    high - ground
                )
            }
            End::Goal => {
                let [x, y, _] = base;
                format!(
                    "within reach: use a Z from {low:.3} to {high:.3} m (`--goal {x},{y},Z`), another goal, or a larger `reach` of the robot"
                )
            }
        }
    }
}

/// Finding if the base at the start or a foot at either end is outside the terrain, where the height map is extrapolated from its edge.
fn outside_terrain(task: &Task) -> Option<Finding> {
    let feet = 0..task.robot.feet();
    let starts = feet.clone().map(|foot| (format!("start, foot {foot}"), task.foothold_start(foot)));
    let goals = feet.map(|foot| (format!("goal, foot {foot}"), task.foothold_goal(foot)));
    let places = std::iter::once(("start".to_string(), [task.start.position[0], task.start.position[1]])).chain(starts).chain(goals);
    places.into_iter().find_map(|(place, [x, y])| match task.terrain.check_inside(&place, x, y) {
        Err(Error::Invalid { place, value, limit }) => Some(Finding {
            certain: false,
            place,
            found: format!("{value} m is outside the height map; the terrain is extrapolated from its edge"),
            remedy: limit,
        }),
        _ => None,
    })
}

/// Plausible gyration radii `sqrt(tr I / 2 m)` relative to the distance of the farthest foot. Known robots: 0.35 (flat hexapod) to 0.97
/// (monoped).
const GYRATION: [f64; 2] = [0.1, 1.5];
/// Plausible masses relative to the cube of the distance of the farthest foot, kg/m³. Known robots: 60 (hexapod) to 270 (small quadruped).
const DENSITY: [f64; 2] = [3., 3000.];

/// Finding if mass, inertia and size do not fit together, e.g. because of mixed-up units.
fn implausible_body(robot: &Robot) -> Option<Finding> {
    let size = robot.nominal_feet.iter().map(|[x, y, z]| (x * x + y * y + z * z).sqrt()).fold(0., f64::max);
    let trace: f64 = (0..3).map(|i| robot.inertia[i][i]).sum();
    let gyration = (trace.max(0.) / (2. * robot.mass)).sqrt();
    let odd = |place: &str, found: String, remedy: String| Some(Finding { certain: false, place: place.into(), found, remedy });
    let square = 2. * robot.mass * size * size;
    if !(GYRATION[0] * size..=GYRATION[1] * size).contains(&gyration) {
        let found = format!(
            "a mass of {} kg with an inertia of trace {trace:.4} kg m² has a gyration radius of {gyration:.3} m, with feet within {size:.3} m",
            robot.mass
        );
        let limits = GYRATION.map(|part| part * part * square);
        odd(
            "robot.inertia",
            found,
            format!("an inertia of trace {:.4} to {:.4} kg m² for a body of this mass and size", limits[0], limits[1]),
        )
    } else {
        let cube = size.powi(3);
        let found = format!("{} kg with feet within {size:.3} m", robot.mass);
        let remedy = format!("from {:.3} to {:.1} kg for a body of this size", DENSITY[0] * cube, DENSITY[1] * cube);
        if (DENSITY[0] * cube..=DENSITY[1] * cube).contains(&robot.mass) { None } else { odd("robot.mass", found, remedy) }
    }
}

/// Finding if all feet together cannot carry the weight.
fn weight_not_carried(task: &Task, settings: &TranscriptionSettings) -> Option<Finding> {
    let (feet, limit, weight) = (task.robot.feet(), force_limit(settings, task), task.robot.weight());
    (feet as f64 * limit < weight).then(|| Finding {
        certain: false,
        place: "force limit".into(),
        found: format!("{feet} feet with at most {limit:.1} N each carry {:.1} N of the weight of {weight:.1} N", feet as f64 * limit),
        remedy: format!("above {:.1} N (`--force-limit`, or `force_limit` of the robot)", weight / feet as f64),
    })
}

/// Half of the largest distance that the base can travel over a foot in stance, m.
fn half_travel(task: &Task) -> f64 {
    task.robot.reach_boxes().map(|reach| reach.farthest()).fold(0., f64::max)
}

/// Smallest distance that a foot has to travel, from its start until it is within reach of its place at the goal, m.
fn travel_of_foot(task: &Task, foot: usize) -> f64 {
    let (from, to) = (task.foothold_start(foot), task.foothold_goal(foot));
    ((to[0] - from[0]).hypot(to[1] - from[1]) - task.robot.reach.of(foot).farthest()).max(0.)
}

/// Foot with the largest distance to travel, and that distance, m.
fn farthest_foot(task: &Task) -> (usize, f64) {
    (0..task.robot.feet()).map(|foot| (foot, travel_of_foot(task, foot))).fold((0, 0.), |a, b| if b.1 > a.1 { b } else { a })
}

/// Distance from start to goal in the horizontal plane, m.
fn distance(task: &Task) -> f64 {
    let [x, y] = task.displacement();
    x.hypot(y)
}

/// Largest mean speed of a foot in swing, m/s; `None` if no row limits it.
fn step_speed(task: &Task, settings: &TranscriptionSettings) -> Option<f64> {
    (settings.rows == Transcription::Momentum).then(|| legs::foot_speed(settings, &task.robot) / TOP_SPEED)
}

/// Finding if a schedule is too short for the distance.
fn schedule_too_short(task: &Task, settings: &TranscriptionSettings, schedule: &Schedule) -> Option<Finding> {
    if schedule.feet() != task.robot.feet() {
        return None;
    }
    if let Some(speed) = step_speed(task, settings) {
        let short = |foot: usize| {
            let swings: f64 = schedule.phases(foot).iter().filter(|p| !p.stance).map(|p| p.duration()).sum();
            let by = format!("{swings:.3} s in swing at {speed:.2} m/s");
            let how = "more swings, longer ones, a nearer goal or a larger `transcription.foot_speed`";
            too_little_swing(format!("gait, foot {foot}"), &by, speed, swings, travel_of_foot(task, foot), how)
        };
        let finding = (0..schedule.feet()).find_map(short);
        if finding.is_some() {
            return finding;
        }
    }
    let stances = consecutive_stances(schedule)?;
    let (distance, most) = (distance(task), half_travel(task) * (2 * stances - 1) as f64);
    (distance > most).then(|| Finding {
        certain: false,
        place: "gait".into(),
        found: format!("{stances} consecutive stances carry the base {most:.3} m of {distance:.3} m, limited by the reach of the feet"),
        remedy: format!(
            "{} or more: more stances in more time, a nearer goal, or a larger `reach` of the robot",
            ((distance / half_travel(task) + 1.) / 2.).ceil()
        ),
    })
}

/// Smallest number of stances that together cover the horizon; `None` if there is a flight phase.
fn consecutive_stances(schedule: &Schedule) -> Option<usize> {
    let stances: Vec<_> = (0..schedule.feet()).flat_map(|foot| schedule.phases(foot)).filter(|p| p.stance).collect();
    let (mut until, mut count) = (0., 0);
    while until < schedule.horizon() - 1e-9 {
        let next = stances.iter().filter(|p| p.start <= until + 1e-9).map(|p| p.end).fold(until, f64::max);
        if next <= until + 1e-9 {
            return None;
        }
        (until, count) = (next, count + 1);
    }
    Some(count)
}

/// Finding if the longest schedule of the free distribution is too short for the distance.
fn free_schedules_too_short(task: &Task, search: &SearchSettings, settings: &TranscriptionSettings) -> Option<Finding> {
    let speed = step_speed(task, settings)?;
    let (free, (foot, needed)) = (&search.free, farthest_foot(task));
    let swings = free.max_stances - 1;
    let longest = swings as f64 * free.log_duration[1].exp();
    let by = format!("{swings} swings, {longest:.3} s in total at {speed:.2} m/s");
    let how = "a larger `search.free.max_stances` or `search.free.log_duration`, or a nearer goal";
    too_little_swing(format!("gaits, foot {foot}"), &by, speed, longest, needed, how)
}

/// Finding if a foot cannot travel far enough in its swings.
///
/// * `by` - description of the swings
/// * `speed`, `seconds` - largest mean speed, m/s, and total duration of the swings, s
/// * `needed` - distance to travel, m
/// * `how` - advice
fn too_little_swing(place: String, by: &str, speed: f64, seconds: f64, needed: f64, how: &str) -> Option<Finding> {
    (needed > speed * seconds).then(|| Finding {
        certain: false,
        place,
        found: format!("{by}, so the foot travels {:.3} m of {needed:.3} m", speed * seconds),
        remedy: format!("at least {:.3} s in swing: {how}", needed / speed),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{FootReach, ROBOTS, Reach};
    use crate::scenario::{SCENARIOS, TARGETS};
    use crate::task::{BaseState, Goal};
    use crate::terrain::Terrain;

    fn check(task: &Task) -> Vec<Finding> {
        precheck(task, &SearchSettings::default(), &TranscriptionSettings::default())
    }

    fn task(robot: &str, terrain: &str, goal: Goal) -> Task {
        Task::new(Robot::named(robot).unwrap(), Terrain::named(terrain).unwrap(), goal).unwrap()
    }

    #[test]
    fn the_scenarios_and_flat_ground_give_no_findings() {
        for scenario in SCENARIOS {
            for target in 1..=TARGETS {
                assert_eq!(check(&scenario.task(target).unwrap()), [], "{} {target}", scenario.name);
            }
        }
        for robot in ROBOTS {
            assert_eq!(check(&task(robot, "flat", Goal::at(1., 0.5).yaw(2.))), [], "{robot}");
        }
    }

    #[test]
    fn a_goal_across_a_step_is_rejected_with_its_numbers() {
        // The ground rises by 0.15 m from x = 3.6 to 4. The hind feet are at 3.66 m and reach to 3.81 m.
        let found = check(&task("anymal", "step", Goal::position([4., 0., 0.65])));
        let ground = 0.15 * (3.81 - 3.6) / 0.4;
        let excess = 0.65 - ground - 0.52;
        assert!(found[0].certain && found[0].place == "goal, foot 2", "{}", found[0]);
        assert!(found[0].found.contains(&format!("{excess:.3} m outside")), "{}", found[0]);
        // The fore feet are on 0.15 m, the hind feet on `ground` at most.
        let heights = format!("from {:.3} to {:.3} m", 0.15 + 0.42 - 0.1, ground + 0.42 + 0.1);
        assert!(found[0].remedy.contains(&heights), "{}", found[0]);
        let [low, high] = [0.15 + 0.42 - 0.1, ground + 0.42 + 0.1];
        for z in [low + 1e-3, high - 1e-3] {
            assert_eq!(check(&task("anymal", "step", Goal::position([4., 0., z]))), []);
        }
        // Without a given height the base is parallel to the ground from 3.66 to 4.34 m.
        let own = task("anymal", "step", Goal::at(4., 0.));
        let slope = (0.15 - 0.15 * 0.06 / 0.4) / 0.68f64;
        assert!((own.goal.angles[1] + slope.atan()).abs() < 1e-9, "{:?}", own.goal);
        assert_eq!(check(&own), []);
    }

    #[test]
    fn a_base_that_is_too_high_is_rejected_at_the_start_and_at_the_goal() {
        let robot = Robot { base_height: 0.6, ..Robot::named("anymal").unwrap() };
        let found = check(&Task::new(robot, Terrain::flat(), Goal::position([1., 0., 0.5])).unwrap());
        assert_eq!((found.len(), found[0].certain, &found[0].place[..]), (1, true, "start, foot 0"));
        assert!(found[0].found.contains("0.080 m outside") && found[0].remedy.contains("0.320 to 0.520 m"), "{}", found[0]);
        let found = check(&task("anymal", "flat", Goal::position([1., 0., 0.53])));
        assert!(found[0].certain && found[0].found.contains("0.010 m outside"), "{}", found[0]);
        // The certificate accepts a foot that is 5 mm outside.
        assert!(!check(&task("anymal", "flat", Goal::position([1., 0., 0.523])))[0].certain);
    }

    #[test]
    fn a_mass_inertia_and_size_that_do_not_fit_together_are_reported() {
        let anymal = Robot::named("anymal").unwrap();
        let look = |robot: Robot| check(&Task::new(robot, Terrain::flat(), Goal::at(1., 0.)).unwrap());
        let heavy = look(Robot { inertia: anymal.inertia.map(|row| row.map(|v| 100. * v)), ..anymal.clone() });
        assert!(!heavy[0].certain && heavy[0].place == "robot.inertia" && heavy[0].found.contains("2.8"), "{}", heavy[0]);
        // Mass and inertia in units that are 1000 times too large.
        let scaled = Robot { mass: 29_500., inertia: anymal.inertia.map(|row| row.map(|v| 1000. * v)), ..anymal.clone() };
        assert!(look(scaled).iter().any(|f| f.place == "robot.mass" && f.found.contains("29500 kg")));
        assert_eq!(look(anymal), []);
    }

    #[test]
    fn feet_outside_their_reach_at_a_given_start_are_rejected() {
        let robot = Robot::named("anymal").unwrap();
        let level = BaseState::level([1., 2., 0.5], 0.7);
        let task = |feet| Task::of_states(robot.clone(), Terrain::flat(), level, feet, BaseState::level([2., 2., 0.5], 0.)).unwrap();
        assert_eq!(check(&task(None)), []);
        let mut feet = task(None).start_feet;
        feet[3][0] -= 0.4;
        let found = check(&task(Some(feet)));
        assert!(found[0].certain && found[0].place == "start, foot 3" && found[0].found.contains("outside its reach"), "{}", found[0]);
        // Inside its box, but beyond a face that cuts it.
        let slab = Slab { normal: [0.6, 0., 0.8], sides: [-0.08, 0.08] };
        let cut = FootReach { sides: [[-0.4, 0.4]; 3], diagonals: vec![slab] };
        let robot = Robot { name: "cut".into(), reach: Reach::PerFoot(vec![cut; 4]), ..robot };
        let [level, goal] = [0., 1.].map(|x| BaseState::level([x, 0., robot.base_height], 0.));
        let task = |feet| Task::of_states(robot.clone(), Terrain::flat(), level, feet, goal).unwrap();
        let mut feet = task(None).start_feet;
        assert_eq!(check(&task(Some(feet.clone()))), []);
        feet[1][0] += 0.3;
        let below = robot.base_height + robot.nominal_feet[1][2];
        let excess = 0.6 * 0.3 - 0.8 * below - 0.08;
        let found = check(&task(Some(feet)));
        let text = format!("{excess:.3} m outside its reach");
        assert!(found[0].certain && found[0].place == "start, foot 1" && found[0].found.contains(&text), "{} {text}", found[0]);
    }

    #[test]
    fn a_schedule_too_short_for_the_distance_is_reported() {
        let trot = vec![vec![0.4, 0.2, 0.4], vec![0.2, 0.2, 0.6], vec![0.2, 0.2, 0.6], vec![0.4, 0.2, 0.4]];
        let search = SearchSettings { gaits: Gaits::Around(Schedule::new(trot).unwrap()), ..SearchSettings::default() };
        let look = |x: f64| precheck(&task("anymal", "flat", Goal::at(x, 0.)), &search, &TranscriptionSettings::default());
        assert_eq!(look(0.3), []);
        let found = look(3.);
        assert!(found.len() == 1 && !found[0].certain && found[0].found.contains("0.200 s in swing"), "{}", found[0]);
        // One stance lasts from 0 to 0.4 s and one to the end: half and one whole travel over a foot.
        let free = TranscriptionSettings { foot_speed: Some(100.), ..TranscriptionSettings::default() };
        let found = precheck(&task("anymal", "flat", Goal::at(1., 0.)), &search, &free);
        assert!(
            found[0].found.contains("2 consecutive stances")
                && found[0].found.contains(&format!("{:.3} m of 1.000 m", 3. * 0.15f64.hypot(0.1))),
            "{}",
            found[0]
        );
    }

    #[test]
    fn feet_that_cannot_carry_the_weight_and_feet_outside_the_terrain_are_reported() {
        let weak = Task { force_limit: Some(20.), ..task("biped", "flat", Goal::at(0.3, 0.)) };
        let found = check(&weak);
        assert!(!found[0].certain && found[0].found.contains("40.0 N of the weight of 196.1 N"), "{}", found[0]);
        let found = check(&task("anymal", "step", Goal::at(9.9, 0.)));
        assert!(!found[0].certain && found[0].place == "goal, foot 0" && found[0].remedy.contains("-10 to 10"), "{}", found[0]);
    }
}
