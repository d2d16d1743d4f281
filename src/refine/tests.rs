use super::variables::SHORT;
use super::*;
use crate::backend::Cpu;
use crate::gait::cost::cost as price_of;
use crate::gait::family::{GaitFamily, PeriodicGait};
use crate::robot::Robot;
use crate::search::evaluate::{Evaluated, LowerSettings, evaluate};
use crate::task::{Goal, PeriodicStride};
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
    assert!(found.feasible, "no {} gait was found", family.name());
    found
}

fn lower() -> LowerSettings {
    let mut settings = LowerSettings::default();
    settings.transcription.friction = Some(Friction::Cone);
    settings
}

/// Calls `then` with a few steps of a turning biped: task, space, price and point.
fn with_walk(then: impl Fn(&Task, &Space, &Price, &Point)) {
    let task = task("biped", "flat", [0.3, 0.05], 0.3);
    let lower = lower();
    let gait = found(&task, GaitFamily::Walk, &lower);
    let space = Space::new(&task, &gait.schedule, &lower.transcription, &RefineSettings::default());
    let price = Price::new(&space, &CostWeights::default(), task.robot.leg_mass());
    let point = space.start(&gait.schedule, &gait.x);
    then(&task, &space, &price, &point);
}

#[test]
fn a_point_can_be_rebuilt_from_its_variables() {
    with_walk(|_, space, _, point| {
        let again = space.point(point.v.clone()).unwrap();
        assert_eq!(again.x.len(), point.x.len());
        for (a, b) in again.x.iter().zip(&point.x) {
            assert!((a - b).abs() < 1e-12);
        }
    });
}

#[test]
fn the_model_of_the_cost_agrees_with_the_cost() {
    with_walk(|task, _, price, point| {
        let motion = trajectory(task, &point.problem.curves, &point.x);
        let cost = price_of(&motion, &task.robot, task.robot.leg_mass(), &CostWeights::default()).unwrap();
        let value = price.value(point, 0.);
        // The two quadratures differ where powers change sign.
        assert!((value - cost.total).abs() < 1e-3 * cost.total, "{value} is not {}", cost.total);
        assert!((price.model(point, 0.).value() - value).abs() < 1e-12 * value);
    });
}

#[test]
fn derivatives_of_the_cost_agree_with_central_differences() {
    with_walk(|_, space, price, point| {
        let model = price.model(point, 0.);
        let mut by = model.effort_by.clone();
        for term in &model.terms {
            term.by.iter().for_each(|&(i, d)| by[i] += term.weight * term.value.signum() * d);
        }
        let here = price.value(point, 0.);
        for i in 0..space.variables.count {
            let (length, step) = (space.variables.step[i], 1e-5);
            let at = |sign: f64| {
                let mut v = point.v.clone();
                v[i] += sign * step * length;
                price.value(&space.point(v).unwrap(), 0.)
            };
            // At zero power the one-sided derivatives differ, and any value between them is correct.
            let (left, right) = ((here - at(-1.)) / step, (at(1.) - here) / step);
            let (by, close) = (by[i] * length, 2e-5);
            assert!(by > left.min(right) - close && by < left.max(right) + close, "variable {i}: {by} is not between {left} and {right}");
        }
    });
}

#[test]
fn derivatives_of_the_rows_agree_with_central_differences() {
    with_walk(|_, space, _, point| {
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

/// Few pieces, whose first motion leaves much to refine.
fn coarse() -> TranscriptionSettings {
    TranscriptionSettings { force_pieces: Some(3), ..TranscriptionSettings::default() }
}

/// A short trot, refined for some iterations.
fn refined(settings: &RefineSettings) -> (Task, Refined) {
    let task = task("anymal", "flat", [0.4, 0.], 0.);
    let transcription = coarse();
    let gait = found(&task, GaitFamily::Trot, &LowerSettings { transcription: transcription.clone(), ..LowerSettings::default() });
    let refined = refine(&task, &gait.schedule, &gait.x, &transcription, &CostWeights::default(), settings, &|| false).unwrap();
    assert!(refined.certified && refined.schedule.count() == gait.schedule.count());
    (task, refined)
}

#[test]
fn a_trot_with_fixed_durations_becomes_cheaper() {
    let (_, r) = refined(&RefineSettings { durations: false, horizon: false, iterations: 8, ..RefineSettings::default() });
    assert!(r.after.total < 0.9 * r.before.total && r.iterations <= 8 && r.status != RefineStatus::Stalled);
    assert!(r.changed == 0 && r.largest_change < 1e-12 && (r.after.horizon - r.before.horizon).abs() < 1e-12);
}

#[test]
fn free_durations_reduce_the_cost_further_without_too_short_phases() {
    let (_, given) = refined(&RefineSettings { durations: false, horizon: false, iterations: 8, ..RefineSettings::default() });
    let (task, free) = refined(&RefineSettings { iterations: 8, ..RefineSettings::default() });
    assert!(free.after.total < given.after.total && free.changed > 0);
    let shortest = MIN_PHASE_SCALED * crate::gait::family::time_scale(&task.robot);
    assert!(free.schedule.durations().iter().flatten().all(|d| *d > shortest * (1. - SHORT)));
}

#[test]
fn a_duration_of_the_task_is_kept_while_phases_change() {
    let task = Task { duration: Some(1.37), ..task("anymal", "flat", [0.4, 0.], 0.) };
    let gait = found(&task, GaitFamily::Trot, &LowerSettings::default());
    assert!((gait.horizon - 1.37).abs() < 1e-9, "{} s", gait.horizon);
    let (transcription, weights, settings) =
        (TranscriptionSettings::default(), CostWeights::default(), RefineSettings { iterations: 4, ..RefineSettings::default() });
    let refined = refine(&task, &gait.schedule, &gait.x, &transcription, &weights, &settings, &|| false).unwrap();
    assert!(refined.changed > 0 && (refined.after.horizon - 1.37).abs() < 1e-9, "{} s", refined.after.horizon);
    let solver = crate::settings::SolverSettings::default();
    let given = (&gait.schedule, &gait.x[..]);
    let mut descent = DurationDescent::new(&task, given, &transcription, &weights, &solver, &|| false).unwrap();
    descent.advance(4, &|| false);
    let timed = descent.timed();
    assert!((timed.schedule.end() - 1.37).abs() < 1e-9 && timed.schedule.durations() != gait.schedule.durations());
}

#[test]
fn forces_of_a_refined_gait_lie_inside_friction_cones_between_nodes() {
    let (task, r) = refined(&RefineSettings { iterations: 6, ..RefineSettings::default() });
    let motion = r.trajectory(&task, &coarse());
    for foot in &motion.ee {
        for (ends, length) in foot.force.nodes.windows(2).zip(&foot.force.poly_durations) {
            for i in 0..=20 {
                let w = crate::gait::spline::hermite(f64::from(i) / 20. * length, *length);
                let f: [f64; 3] =
                    std::array::from_fn(|d| w[0] * ends[0][d] + w[1] * ends[0][3 + d] + w[2] * ends[1][d] + w[3] * ends[1][3 + d]);
                assert!(f[0].hypot(f[1]) <= task.terrain.friction * f[2] + 1e-6, "{f:?}");
            }
        }
    }
}

#[test]
fn the_refined_gait_does_not_depend_on_the_number_of_threads() {
    let settings = RefineSettings { iterations: 3, ..RefineSettings::default() };
    let with = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| refined(&settings).1);
    let (one, three) = (with(1), with(3));
    assert!(one.x == three.x && one.schedule == three.schedule && one.iterations == three.iterations);
}

#[test]
fn a_refinement_without_iterations_or_cancelled_returns_a_certified_gait_of_no_higher_cost() {
    let (_, r) = refined(&RefineSettings { iterations: 0, ..RefineSettings::default() });
    assert!(r.status == RefineStatus::MaxIterations && r.after.total <= r.before.total && r.optimality.is_none());
    let task = task("biped", "flat", [0.3, 0.], 0.);
    let gait = found(&task, GaitFamily::Walk, &LowerSettings::default());
    let (transcription, settings) = (TranscriptionSettings::default(), RefineSettings::default());
    let ended = refine(&task, &gait.schedule, &gait.x, &transcription, &CostWeights::default(), &settings, &|| true).unwrap();
    assert!(ended.status == RefineStatus::Cancelled && ended.certified && ended.changed == 0, "{:?}", ended.status);
}

#[test]
fn invalid_inputs_are_refused() {
    let task = task("biped", "flat", [0.3, 0.], 0.);
    let gait = found(&task, GaitFamily::Walk, &LowerSettings::default());
    let refused = |x: &[f64], transcription: &TranscriptionSettings, settings: &RefineSettings| {
        refine(&task, &gait.schedule, x, transcription, &CostWeights::default(), settings, &|| false).unwrap_err().to_string()
    };
    let (transcription, settings) = (TranscriptionSettings::default(), RefineSettings::default());
    assert!(refused(&gait.x[1..], &transcription, &settings).contains("x: "));
    let towr = TranscriptionSettings { rows: Transcription::Towr, ..transcription.clone() };
    assert!(refused(&gait.x, &towr, &settings).contains("momentum"));
    assert!(refused(&gait.x, &transcription, &RefineSettings { trust: f64::NAN, ..settings.clone() }).contains("refine.trust"));
    let stride = Some(PeriodicStride { start: 0, intervals: 2, displacement: [0.; 3], costs_alone: true });
    let task = Task { stride, ..task.clone() };
    let periodic = refine(&task, &gait.schedule, &gait.x, &transcription, &CostWeights::default(), &settings, &|| false);
    assert!(periodic.unwrap_err().to_string().contains("stride"));
}

#[test]
fn curvature_is_learned_from_a_quadratic() {
    // Second derivatives 4 along (1, 1) / sqrt 2 and -3 along (1, -1) / sqrt 2: the first is found, the second is not convex and left out.
    let mut history = History::default();
    let times = |s: [f64; 2]| vec![0.5 * s[0] + 3.5 * s[1], 3.5 * s[0] + 0.5 * s[1]];
    for s in [[1., 1.], [0.1, 0.1]] {
        history.push(s.to_vec(), times(s), &[0., 0.], 1.);
    }
    let curvature = history.curvature(1e-3);
    assert!((curvature.along(&[1., 1.]) - 8.).abs() < 1e-9);
    assert!((curvature.along(&[1., -1.]) - 2e-3).abs() < 1e-9);
    history.push(vec![1., -1.], times([1., -1.]), &[0., 0.], 1.);
    assert!(history.curvature(1e-3).along(&[1., -1.]) > 0.);
}

#[test]
fn a_hop_whose_rows_close_slowly_is_refined() {
    let task = task("monoped", "flat", [0.5, 0.], 0.);
    let gait = found(&task, GaitFamily::Hop, &LowerSettings::default());
    let settings = RefineSettings { iterations: 2, ..RefineSettings::default() };
    let transcription = TranscriptionSettings::default();
    let r = refine(&task, &gait.schedule, &gait.x, &transcription, &CostWeights::default(), &settings, &|| false).unwrap();
    assert!(r.certified && r.status != RefineStatus::NotClosed && r.after.total < r.before.total);
}
