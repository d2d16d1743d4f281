//! Residuals against formulas, Jacobians against central differences, f32 against f64.

use super::formulas::{accelerations, expected, expected_cones, expected_momentum};
use super::{
    DIFFERENCE_STEP, F32_DEVIATION_TOLERANCE, F32_TOLERANCE, JACOBIAN_TOLERANCE, RESIDUAL_TOLERANCE, assert_close, cases, first_difference,
    in_scalar,
};
use crate::common::{
    Random, Rows, cones, dense_jacobian, families, frozen_at, gait, hills, jointed, mid_stride, momentum, one_sided, point, problem_with,
    problem_with_cost, rows, rows_with, soled, spider, straight, striding, task, task_for, tilted, towr, transcriptions,
};
use cregopt::gait::Trajectory;
use cregopt::gait::trajectory::GoalVelocity;
use cregopt::nlp::problem::Element;
use cregopt::nlp::transcription::force_limit;
use cregopt::nlp::{Problem, trajectory};
use cregopt::robot::{GRAVITY, Robot};
use cregopt::rows::swing::SwingNode;
use cregopt::rows::table::NONE;
use cregopt::rows::{Family, RowKind};
use cregopt::settings::{Transcription, TranscriptionSettings};
use cregopt::terrain::{Shape, Terrain};
use cregopt::verify::report::CheckFamily;
use cregopt::verify::verify_rows;
use nalgebra::{DMatrix, DVector};

#[test]
fn node_values_give_towrs_rows_the_residuals_of_the_reduced_problem() {
    for (seed, case) in cases().iter().enumerate() {
        let problem = problem_with::<f64>(&case.task, &case.schedule, &towr());
        let x = point(&problem, &mut Random::new(seed as u64), 0.);
        let rows = rows(&problem, &x, 0.);
        let (c, g) = expected(&case.task, &trajectory(&case.task, &problem.curves, &x), &problem);
        assert_close(&rows.c, &c, RESIDUAL_TOLERANCE, &format!("{}, equalities", case.name));
        assert_close(&rows.g, &g, RESIDUAL_TOLERANCE, &format!("{}, inequalities", case.name));
    }
}

#[test]
fn node_values_give_the_momentum_residuals() {
    for (seed, case) in cases().iter().enumerate() {
        let problem = problem_with::<f64>(&case.task, &case.schedule, &TranscriptionSettings::default());
        let x = point(&problem, &mut Random::new(seed as u64), 0.);
        let c = expected_momentum(&case.task, &trajectory(&case.task, &problem.curves, &x), &problem);
        assert_close(&rows_with(&problem, &x, 0., &mut straight(&problem)).c, &c, RESIDUAL_TOLERANCE, &case.name);
    }
}

#[test]
fn node_values_give_the_cone_residuals() {
    for (seed, case) in cases().iter().enumerate() {
        let problem = problem_with::<f64>(&case.task, &case.schedule, &cones());
        assert!(problem.force_nodes.is_empty() && problem.cones.len() > problem.footholds.len());
        let x = point(&problem, &mut Random::new(seed as u64), 0.);
        let g = expected_cones(&case.task, &trajectory(&case.task, &problem.curves, &x), &problem);
        let own: Vec<usize> = (0..g.len()).filter(|&i| !g[i].is_nan()).collect();
        assert_eq!(own.len(), 3 * problem.cones.len());
        let of = |values: &[f64]| own.iter().map(|&i| values[i]).collect::<Vec<f64>>();
        assert_close(&of(&rows(&problem, &x, 0.).g), &of(&g), RESIDUAL_TOLERANCE, &case.name);
        // Some forces lie inside their cones, some outside.
        let cone = |inside: bool| problem.cones.iter().any(|c| (g[c.place.inequality as usize + 1] < 0.) == inside);
        assert!(cone(true) && cone(false), "{}", case.name);
    }
}

#[test]
fn node_values_give_the_accelerations_of_swinging_feet() {
    for (seed, case) in cases().iter().enumerate() {
        let problem = problem_with::<f64>(&case.task, &case.schedule, &TranscriptionSettings::default());
        let x = point(&problem, &mut Random::new(seed as u64), 0.);
        let rows = rows(&problem, &x, 0.);
        let nodes = trajectory(&case.task, &problem.curves, &x);
        let mut entries = problem.accelerations.iter();
        for (foot, durations) in nodes.ee.iter().zip(&nodes.durations) {
            for swing in 0..durations.len() / 2 {
                // The motion of a foot has one piece per stance and two per swing.
                let [up, down] = [1, 2].map(|piece| accelerations(&foot.motion, 3 * swing + piece).map(|a| a.norm()));
                let row = |a: f64| ((a / (20. * GRAVITY)).powi(2) - 1. + 2e-3) / 2.;
                let at = entries.next().unwrap().place.inequality as usize;
                assert_close(&rows.g[at..at + 2], &[row(up[0]), row(down[1])], RESIDUAL_TOLERANCE, &case.name);
                // The acceleration has its extremes at the ends, not in the middle: no row is missing there.
                assert!(up[1].max(down[0]) <= (1. + 1e-9) * up[0].max(down[1]), "{}: {up:?}, {down:?}", case.name);
            }
        }
        assert!(entries.next().is_none() && problem.accelerations.len() > 4);
    }
    let case = &cases()[0];
    assert!(problem_with::<f64>(&case.task, &case.schedule, &momentum()).accelerations.is_empty(), "free legs have no limit");
}

#[test]
fn eliminated_rows_hold_at_any_point() {
    for (seed, case) in cases().iter().enumerate() {
        let problem = problem_with::<f64>(&case.task, &case.schedule, &towr());
        let x = point(&problem, &mut Random::new(seed as u64), 0.);
        let limit = |settings: &TranscriptionSettings| force_limit(settings, &case.task);
        let nodes = trajectory(&case.task, &problem.curves, &x);
        let report = verify_rows(&nodes, &case.task.robot, &case.task.terrain, limit(&towr())).unwrap();
        for family in [CheckFamily::BaseAcceleration, CheckFamily::Swing, CheckFamily::Bounds, CheckFamily::Structure] {
            assert_eq!(report.family(family).violated, 0, "{}\n{report}", case.name);
        }
        assert!(report.family(CheckFamily::Dynamics).violated > 0, "a random point does not move like a rigid body");

        let problem = problem_with::<f64>(&case.task, &case.schedule, &TranscriptionSettings::default());
        let x = point(&problem, &mut Random::new(seed as u64), 0.);
        let nodes = trajectory(&case.task, &problem.curves, &x);
        let report = verify_rows(&nodes, &case.task.robot, &case.task.terrain, limit(&TranscriptionSettings::default())).unwrap();
        for family in [CheckFamily::Bounds, CheckFamily::Structure] {
            assert_eq!(report.family(family).violated, 0, "{}\n{report}", case.name);
        }
        assert!(report.family(CheckFamily::Momentum).violated > 0, "nor does this one");
    }
}

/// Sets derivatives of cost rows with respect to variables without a column to zero: such blocks are read only.
fn without_read_only(problem: &Problem<f64>, jacobian: &mut DMatrix<f64>) {
    for (element, runs) in problem.all_elements().zip(problem.columns()).filter(|(element, _)| element.kind() == RowKind::Cost) {
        let has = |variable: usize| runs.iter().any(|(run, _)| (run.variable..run.variable + run.len).contains(&(variable as u32)));
        for variable in (0..problem.variables).filter(|&variable| !has(variable)) {
            (0..element.rows).for_each(|r| jacobian[((element.place.row + r) as usize, variable)] = 0.);
        }
    }
}

/// Sets the rows of cone curvatures to zero: they are roots of second derivatives, and their residual is zero everywhere.
fn without_curvature(problem: &Problem<f64>, jacobian: &mut DMatrix<f64>) {
    for element in problem.all_elements().filter(|element| element.family == Family::ConeCurvature) {
        jacobian.rows_mut(element.place.row as usize, element.rows as usize).fill(0.);
    }
}

/// Jacobian of one-sided residuals by central differences, `[rows][variables]`.
fn differences(problem: &Problem<f64>, x: &[f64], edge_radius: f64) -> DMatrix<f64> {
    let mut result = DMatrix::zeros(problem.rows.all(), problem.variables);
    // Derivatives treat the deviations from the cubics between knots as constants.
    let mut given = frozen_at(problem, x, edge_radius);
    let mut x = x.to_vec();
    for column in 0..problem.variables {
        let mut moved = |by: f64| {
            let before = x[column];
            x[column] += by;
            let Rows { c, g, .. } = rows_with(problem, &x, edge_radius, &mut given);
            x[column] = before;
            DVector::from_vec(one_sided(problem, &c, &g))
        };
        let difference = moved(DIFFERENCE_STEP) - moved(-DIFFERENCE_STEP);
        result.set_column(column, &(difference / (2. * DIFFERENCE_STEP)));
    }
    result
}

/// Compares the Jacobian of all rows at a random point with central differences.
fn check_jacobian(name: &str, problem: &Problem<f64>, seed: u64, edge_radius: f64) {
    let x = point(problem, &mut Random::new(seed), edge_radius);
    let mut analytic = dense_jacobian(problem, &rows(problem, &x, edge_radius).jacobian);
    without_curvature(problem, &mut analytic);
    let mut numeric = differences(problem, &x, edge_radius);
    without_read_only(problem, &mut numeric);
    let difference = first_difference(analytic.as_slice(), numeric.as_slice(), JACOBIAN_TOLERANCE);
    if let Some((row, variable)) = difference.map(|i| (i % problem.rows.all(), i / problem.rows.all())) {
        let of_row = |e: &Element| (e.place.row..e.place.row + e.rows).contains(&(row as u32));
        let family = problem.all_elements().find(of_row).unwrap().family;
        let (a, b) = (analytic[(row, variable)], numeric[(row, variable)]);
        panic!("{name}, edge radius {edge_radius}, {family:?} row {row}, variable {variable}: {a:e} against {b:e}");
    }
}

/// Settings with fewer force pieces than in the search. The draws of points depend on their number.
fn few_pieces(settings: TranscriptionSettings) -> TranscriptionSettings {
    TranscriptionSettings { force_pieces: Some(3), ..settings }
}

#[test]
fn jacobians_match_central_differences() {
    for (seed, case) in cases().iter().enumerate() {
        for settings in families() {
            // Fewer stances than in the search, because every variable takes two evaluations.
            let settings = few_pieces(settings);
            let schedule = gait(&mut Random::new(seed as u64), case.task.robot.feet(), 3..=6);
            let problem = problem_with_cost::<f64>(&case.task, &schedule, &settings);
            for edge_radius in [0., 0.04] {
                check_jacobian(&case.name, &problem, seed as u64, edge_radius);
            }
        }
    }
}

#[test]
fn jacobians_in_mid_stride_match_central_differences() {
    let tasks =
        [task("anymal", "flat", [0.4, 0.1], 0.2), task("biped", "slope", [0.3, 0.1], 0.2), task_for(spider(5), hills(), [0.3, 0.2], 0.4)];
    for (seed, task) in tasks.iter().enumerate() {
        // Swings that rise, and swings that only descend.
        for (since, descend) in [(0.05, false), (0.2, true)] {
            for own in [TranscriptionSettings::default(), cones()] {
                let settings = TranscriptionSettings { goal_velocity: GoalVelocity::Near, ..own };
                let (task, schedule) = mid_stride(task, since);
                let problem = problem_with_cost::<f64>(&task, &schedule, &settings);
                // The end is free.
                assert!(problem.curves.base.iter().skip(2).all(|&block| (block as usize) < problem.variables));
                let started = |s: &SwingNode<f64>| s.offset != [0.; 3];
                let heights: Vec<bool> = problem.swing_nodes.iter().filter(|s| started(s)).map(|s| s.height_column == NONE).collect();
                let level = !task.terrain.has_edges();
                assert!(heights.iter().all(|&fixed| fixed == descend) && (heights.is_empty() == (level && descend)), "{heights:?}");
                assert!(problem.accelerations.iter().any(|a| (a.height_column == NONE) == descend && a.foothold_column[0] == NONE));
                assert!(problem.strides.iter().any(|s| s.foothold_column[0] == NONE));
                assert!(problem.swing_powers.iter().any(|p| p.foot.offset != [[0.; 3]; 2]) && !problem.goals.is_empty());
                check_jacobian(&format!("{} on {}, {since}", task.robot.name, task.terrain.name), &problem, seed as u64, 0.);
            }
        }
    }
}

#[test]
fn jacobians_of_soles_match_central_differences() {
    let biped = || soled(Robot::named("biped").unwrap());
    let named = |name| Terrain::named(name).unwrap();
    // The derivatives with respect to a foothold take the ground under a sole as flat: slopes do not vary here.
    let tasks = [task_for(biped(), named("flat"), [1., 0.2], 0.8), task_for(soled(spider(4)), tilted(), [0.5, 0.2], -0.6)];
    for (seed, task) in tasks.iter().enumerate() {
        for own in [TranscriptionSettings::default(), cones()] {
            let schedule = gait(&mut Random::new(seed as u64), task.robot.feet(), 3..=5);
            let problem = problem_with_cost::<f64>(task, &schedule, &own);
            assert!(!problem.sole_points.is_empty() && !problem.turns.is_empty());
            assert!(problem.momentum_intervals.iter().all(|interval| interval.moments.end > interval.moments.start));
            check_jacobian(&task.robot.name, &problem, seed as u64, 0.);
        }
    }
}

#[test]
fn jacobians_of_joint_limits_match_central_differences() {
    let standing = || [task_for(jointed(Robot::named("anymal").unwrap()), Terrain::named("flat").unwrap(), [0.4, 0.1], 0.4)];
    let moving = || [0.05, 0.2].map(|since| mid_stride(&task_for(jointed(spider(5)), hills(), [0.3, 0.2], 0.4), since));
    let whole = standing().map(|task| (task, gait(&mut Random::new(3), 4, 3..=5)));
    for (seed, (task, schedule)) in whole.into_iter().chain(moving()).enumerate() {
        let settings = few_pieces(TranscriptionSettings { goal_velocity: GoalVelocity::Near, ..TranscriptionSettings::default() });
        let problem = problem_with_cost::<f64>(&task, &schedule, &settings);
        let c = rows(&problem, &point(&problem, &mut Random::new(seed as u64), 0.), 0.).c;
        for family in [Family::JointTorque, Family::JointSpeed] {
            let of_family = problem.all_elements().filter(|element| element.family == family);
            let values: Vec<f64> = of_family.flat_map(|e| c[e.place.row as usize..][..3].to_vec()).collect();
            let beyond = values.iter().filter(|value| **value != 0.).count();
            assert!(20 < beyond && beyond + 20 < values.len(), "{family:?}: {beyond} of {} beyond the limits", values.len());
        }
        check_jacobian(&format!("{} on {}", task.robot.name, task.terrain.name), &problem, seed as u64, 0.);
    }
}

#[test]
fn jacobians_of_a_periodic_stride_match_central_differences() {
    for (seed, task) in [task("anymal", "flat", [0.4, 0.1], 0.2), task_for(spider(5), hills(), [0.3, 0.2], 0.4)].iter().enumerate() {
        let (task, schedule) = striding(task);
        let problem = problem_with_cost::<f64>(&task, &schedule, &momentum());
        check_jacobian(&format!("{} on {}", task.robot.name, task.terrain.name), &problem, seed as u64, 0.);
    }
}

#[test]
fn periodic_rows_are_the_differences_of_states_a_stride_apart() {
    let (task, schedule) = striding(&task("anymal", "flat", [0.4, 0.1], 0.2));
    let problem = problem_with::<f64>(&task, &schedule, &momentum());
    let x = point(&problem, &mut Random::new(3), 0.);
    let (motion, c) = (trajectory(&task, &problem.curves, &x), rows(&problem, &x, 0.).c);
    let stride = task.stride.unwrap();
    // The curves of the base have four pieces in an interval.
    let [start, end] = [4 * stride.start, 4 * (stride.start + stride.intervals)];
    let mut differences = Vec::new();
    for part in 0..2 {
        for curve in [&motion.base_lin, &motion.base_ang] {
            let moved = |i: usize| if part == 0 && std::ptr::eq(curve, &motion.base_lin) { stride.displacement[i] } else { 0. };
            differences.extend((0..3).map(|i| curve.nodes[end][3 * part + i] - curve.nodes[start][3 * part + i] - moved(i)));
        }
    }
    // Nodes of a foot: two of each stance, one in the middle of each swing.
    for (foot, curves) in motion.ee.iter().enumerate() {
        let nodes = &curves.motion.nodes;
        let apart = |node: usize, axis: usize| nodes[node + 3][axis] - nodes[node][axis] - stride.displacement[axis];
        match foot % 2 {
            0 => differences.extend([apart(0, 0), apart(0, 1)]),
            _ => differences.extend([apart(0, 0), apart(0, 1), apart(3, 0), apart(3, 1), apart(2, 2)]),
        }
    }
    let own: Vec<f64> = problem.periodics.iter().map(|p| c[p.place.row as usize] / 10.).collect();
    assert_close(&own, &differences, RESIDUAL_TOLERANCE, "periodic rows");
    assert!(own.iter().filter(|d| d.abs() > 1e-3).count() > 15);
}

#[test]
fn cost_rows_do_not_change_the_order_of_the_variables() {
    for case in &cases() {
        for settings in families() {
            let without = problem_with::<f64>(&case.task, &case.schedule, &settings);
            let with = problem_with_cost::<f64>(&case.task, &case.schedule, &settings);
            assert_eq!(with.rows.costs > 0, settings.rows == Transcription::Momentum);
            assert_eq!((with.variables, &with.initial), (without.variables, &without.initial), "{}", case.name);
            assert_eq!((with.factor_len, with.front_stride), (without.factor_len, without.front_stride), "{}", case.name);
            assert_eq!(with.curves.base, without.curves.base, "{}", case.name);
        }
    }
}

#[test]
fn the_cases_have_footholds_on_slopes_where_there_are_any() {
    for (seed, case) in cases().iter().enumerate().filter(|(_, case)| case.task.terrain.shape != Shape::Flat) {
        for settings in transcriptions().map(few_pieces) {
            let problem = problem_with::<f64>(&case.task, &case.schedule, &settings);
            let x = point(&problem, &mut Random::new(seed as u64), 0.);
            let slope = |at: usize| case.task.terrain.ground(x[at], x[at + 1]).slope;
            let on_slope = problem.footholds.iter().filter(|&&f| slope(f as usize) != [0.; 2]);
            let count = on_slope.count();
            // Footholds that keep clear of edges begin next to a gap; those that `point` has moved are in it.
            let least = if problem.footings.is_empty() || case.task.terrain.name != "gap" { 3 } else { 1 };
            assert!(count >= least, "{}: {count} of {}", case.name, problem.footholds.len());
        }
    }
}

#[test]
fn a_wrong_entry_is_seen() {
    let case = &cases()[0];
    for settings in transcriptions() {
        let problem = problem_with::<f64>(&case.task, &gait(&mut Random::new(0), 4, 3..=3), &settings);
        let x = point(&problem, &mut Random::new(0), 0.);
        let Rows { jacobian, .. } = rows(&problem, &x, 0.);
        let numeric = differences(&problem, &x, 0.);
        let mut analytic = dense_jacobian(&problem, &jacobian);
        assert_eq!(first_difference(analytic.as_slice(), numeric.as_slice(), JACOBIAN_TOLERANCE), None);
        let middle = analytic.len() / 2;
        let small = 3. * JACOBIAN_TOLERANCE * numeric.as_slice()[middle].abs().max(1.);
        for wrong in [small, -small, f64::NAN, f64::INFINITY] {
            let right = std::mem::replace(&mut analytic.as_mut_slice()[middle], wrong + numeric.as_slice()[middle]);
            assert_eq!(first_difference(analytic.as_slice(), numeric.as_slice(), JACOBIAN_TOLERANCE), Some(middle), "off by {wrong}");
            analytic.as_mut_slice()[middle] = right;
        }
    }
    // A foot that is 1 um off changes a moment.
    for settings in transcriptions() {
        let problem = problem_with::<f64>(&case.task, &gait(&mut Random::new(0), 4, 3..=3), &settings);
        let x = point(&problem, &mut Random::new(0), 0.);
        let c = rows_with(&problem, &x, 0., &mut straight(&problem)).c;
        let formula = |nodes: &Trajectory| match settings.rows {
            Transcription::Towr => expected(&case.task, nodes, &problem).0,
            Transcription::Momentum => expected_momentum(&case.task, nodes, &problem),
        };
        let nodes = trajectory(&case.task, &problem.curves, &x);
        let mut moved = nodes.clone();
        moved.ee[0].motion.nodes.iter_mut().for_each(|node| node[0] += 1e-6);
        assert_eq!(first_difference(&c, &formula(&nodes), RESIDUAL_TOLERANCE), None);
        assert!(first_difference(&c, &formula(&moved), RESIDUAL_TOLERANCE).is_some());
    }
}

#[test]
fn f32_kernels_agree_with_f64_kernels() {
    for (seed, case) in cases().iter().enumerate() {
        for settings in families() {
            let problem = problem_with::<f64>(&case.task, &case.schedule, &settings);
            let layout_f32 = problem_with::<f32>(&case.task, &case.schedule, &settings);
            let x_f32: Vec<f32> = in_scalar(&point(&problem, &mut Random::new(100 + seed as u64), 0.04));
            let x: Vec<f64> = x_f32.iter().map(|&v| v.into()).collect();
            for edge_radius in [0., 0.04] {
                // Both with the same deviations, which have a tolerance of their own.
                let mut shared = frozen_at(&problem, &x, edge_radius);
                let mut shared_f32 = frozen_at(&layout_f32, &x_f32, edge_radius);
                for (narrow, wide) in shared_f32.deviations.iter_mut().zip(&mut shared.deviations) {
                    let pairs = narrow.pose.iter_mut().flatten().zip(wide.pose.iter_mut().flatten());
                    for (narrow, wide) in pairs.chain(narrow.mean.iter_mut().zip(&mut wide.mean)) {
                        let gap = (f64::from(*narrow) - *wide).abs();
                        assert!(gap <= F32_DEVIATION_TOLERANCE * wide.abs().max(1.), "{}: {narrow:e} against {wide:e}", case.name);
                        *wide = f64::from(*narrow);
                    }
                }
                let wide = rows_with(&problem, &x, edge_radius, &mut shared);
                let narrow = rows_with(&layout_f32, &x_f32, edge_radius, &mut shared_f32);
                let widened = |values: &[f32]| values.iter().map(|&v| v.into()).collect::<Vec<f64>>();
                let close = |got: &[f32], expected: &[f64], tolerance: f64, what: &str| {
                    let what = format!("{}, {}, edge radius {edge_radius}, {what}", case.name, settings.rows.name());
                    assert_close(&widened(got), expected, tolerance, &what);
                };
                close(&narrow.c, &wide.c, F32_TOLERANCE, "equalities");
                close(&narrow.g, &wide.g, F32_TOLERANCE, "inequalities");
                // The tangential force is the remainder of the force without its normal part, so its error is that of the normal part. The
                // cone's gradient has the direction of the tangential force, and the error of its dependence on the normal grows with the
                // square of the ratio of both.
                let constants = &problem.constants;
                let direction = |inequality: usize| {
                    let normal = wide.g[inequality] + constants.force_limit - constants.force_margin;
                    let tangential = wide.g[inequality + 1] + constants.friction * normal - constants.force_margin;
                    4. * f64::from(f32::EPSILON) * (normal / tangential).powi(2)
                };
                for element in problem.all_elements() {
                    let start = element.place.jacobian as usize;
                    let part = start..start + element.rows as usize * element.place.stride as usize;
                    let own = if element.family == cregopt::rows::Family::Cone { direction(element.place.inequality as usize) } else { 0. };
                    let what = format!("Jacobian of {:?} at {start}", element.family);
                    close(&narrow.jacobian[part.clone()], &wide.jacobian[part], F32_TOLERANCE.max(own), &what);
                }
            }
        }
    }
}
