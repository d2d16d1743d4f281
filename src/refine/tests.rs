use super::*;
use crate::backend::Cpu;
use crate::gait::cost::cost as price_of;
use crate::gait::family::{GaitFamily, PeriodicGait};
use crate::robot::Robot;
use crate::search::evaluate::{Evaluated, LowerSettings, evaluate};
use crate::task::Goal;
use crate::terrain::Terrain;

pub(super) fn task(robot: &str, terrain: &str, [x, y]: [f64; 2], yaw: f64) -> Task {
    let (robot, terrain) = (Robot::named(robot).unwrap(), Terrain::named(terrain).unwrap());
    Task::new(robot, terrain, Goal::at(x, y).yaw(yaw)).unwrap()
}

pub(super) fn found(task: &Task, family: GaitFamily, settings: &LowerSettings) -> Evaluated {
    let schedule = PeriodicGait::typical(family, task).unwrap().schedule().unwrap();
    let backend = Cpu::new(1).unwrap();
    let mut results = evaluate(&[(task, &schedule)], settings, None, &backend, false, &|| false).unwrap();
    let found = results.pop().flatten().unwrap();
    assert!(found.feasible, "{} is not found", family.name());
    found
}

fn lower() -> LowerSettings {
    let mut settings = LowerSettings::default();
    settings.transcription.friction = Friction::Cone;
    settings
}

/// A trot over a short way, its space, and its point.
fn with_trot(then: impl Fn(&Task, &Space, &Price, &Point)) {
    let task = task("anymal", "flat", [0.6, 0.1], 0.3);
    let lower = lower();
    let gait = found(&task, GaitFamily::Trot, &lower);
    let space = Space::new(&task, &gait.schedule, &lower.transcription, &RefineSettings::default());
    let price = Price::new(&space, &CostWeights::default(), task.robot.leg_mass());
    let point = space.start(&gait.schedule, &gait.x);
    then(&task, &space, &price, &point);
}

#[test]
fn a_point_is_made_again_from_its_variables() {
    with_trot(|_, space, _, point| {
        let again = space.point(point.v.clone()).unwrap();
        assert_eq!(again.x.len(), point.x.len());
        for (a, b) in again.x.iter().zip(&point.x) {
            assert!((a - b).abs() < 1e-12);
        }
    });
}

#[test]
fn the_model_of_the_cost_is_the_cost() {
    with_trot(|task, _, price, point| {
        let motion = trajectory(task, &point.layout, &point.x);
        let cost = price_of(&motion, &task.robot, task.robot.leg_mass(), &CostWeights::default()).unwrap();
        let value = price.value(point);
        // Their quadratures differ where powers change their sign.
        assert!((value - cost.total).abs() < 1e-3 * cost.total, "{value} is not {}", cost.total);
        assert!((price.model(point).value() - value).abs() < 1e-12 * value);
    });
}

#[test]
fn derivatives_of_the_cost_are_those_of_central_differences() {
    with_trot(|_, space, price, point| {
        let model = price.model(point);
        let mut by = model.effort_by.clone();
        for term in &model.terms {
            term.by.iter().for_each(|&(i, d)| by[i] += term.weight * term.value.signum() * d);
        }
        let here = price.value(point);
        for i in 0..space.variables.count {
            let (length, step) = (space.variables.step[i], 1e-5);
            let at = |sign: f64| {
                let mut v = point.v.clone();
                v[i] += sign * step * length;
                price.value(&space.point(v).unwrap())
            };
            // Where a power is zero the two sides differ, and any slope in between is right.
            let (left, right) = ((here - at(-1.)) / step, (at(1.) - here) / step);
            let (by, close) = (by[i] * length, 2e-5);
            assert!(by > left.min(right) - close && by < left.max(right) + close, "variable {i}: {by} is not between {left} and {right}");
        }
    });
}

#[test]
fn derivatives_of_the_rows_are_those_of_central_differences() {
    with_trot(|_, space, _, point| {
        let linear = rows::linear(space, point).unwrap();
        let dense = |rows: &[rows::Row]| -> Vec<Vec<f64>> {
            let row = |r: &rows::Row| {
                let mut dense = vec![0.; space.variables.count];
                r.by.iter().for_each(|&(i, d)| dense[i] += d * space.variables.step[i]);
                dense
            };
            rows.iter().map(row).collect()
        };
        let (by, by_inequality) = (dense(&linear.equalities), dense(&linear.inequalities));
        let mut worst: (f64, usize, usize) = (0., 0, 0);
        let mut worst_time: (f64, usize, usize) = (0., 0, 0);
        let times = space.variables.feet.iter().flat_map(|f| &f.boundaries).flatten().copied().min().unwrap();
        for i in 0..space.variables.count {
            let at = |sign: f64| {
                let mut v = point.v.clone();
                v[i] += sign * 1e-5 * space.variables.step[i];
                rows::linear(space, &space.point(v).unwrap()).unwrap()
            };
            let (up, down) = (at(1.), at(-1.));
            for (r, (u, d)) in up.equalities.iter().zip(&down.equalities).enumerate() {
                let off = ((u.value - d.value) / 2e-5 - by[r][i]).abs();
                let worst = if i < times { &mut worst } else { &mut worst_time };
                if off > worst.0 {
                    *worst = (off, r, i);
                }
            }
            for (r, (u, d)) in up.inequalities.iter().zip(&down.inequalities).enumerate() {
                let off = ((u.value - d.value) / 2e-5 - by_inequality[r][i]).abs();
                let worst = if i < times { &mut worst } else { &mut worst_time };
                if off > worst.0 {
                    *worst = (off, 10_000 + r, i);
                }
            }
        }
        assert!(worst_time.0 < 1e-5 && worst.0 < 1e-5, "{worst:?} {worst_time:?}");
    });
}

#[test]
fn a_trot_becomes_cheaper_and_stays_certified() {
    let task = task("anymal", "flat", [0.6, 0.], 0.);
    let gait = found(&task, GaitFamily::Trot, &LowerSettings::default());
    let settings = RefineSettings { durations: false, horizon: false, iterations: 12, ..RefineSettings::default() };
    let transcription = TranscriptionSettings::default();
    let refined = refine(&task, &gait.schedule, &gait.x, &transcription, &CostWeights::default(), &settings, &|| false).unwrap();
    eprintln!("{:?} {} -> {} {:?}", refined.status, refined.before.total, refined.after.total, refined.optimality);
    assert!(refined.certified && refined.after.total < 0.95 * refined.before.total);
    assert_eq!(refined.changed, 0);
}
