//! Curvature of the friction cones, for the minimisation of a cost.
//!
//! The residual of a cone row, `size - mu n.f` with `size = sqrt(|t|^2 + m^2)`, is convex in the force. Its second derivative is
//! `(u u' + (m / size)^2 e e') / size` with the unit vector `e` along the tangential force and `u` across it. A Gauss-Newton step leaves it
//! out and moves forces of small size far around their cones. These rows have its root as their Jacobian, a residual of zero, and the
//! multiplier of the cone as their weight.

use super::blocks::Placed;
use super::force::ForceNode;
use super::math::{cross, dot, scale, sub};
use super::write::Rows;
use super::{RowKind, Spec, Tables};
use crate::real::Real;
use multiversion::multiversion;

/// Across the tangential force, then along it.
pub const SPEC: Spec = Spec { rows: 2, pairs: 0, kind: RowKind::Cost, unit: "" };

/// See [`super::Family::allowed`].
pub(super) use super::any_residual as allowed;

/// Force of the cone of the same index in [`Tables::cones`].
pub type ConeCurvature<T> = ForceNode<T>;

/// Writes positions and columns into an entry. Roles: force node, foothold.
pub(super) fn place<T: Real>(tables: &mut Tables<T>, entry: usize, at: &Placed) {
    tables.cone_curvatures[entry].sit(at);
}

/// Curvature rows of all cones. The footholds have no part in it.
///
/// * `residual` - out, by row: zeros
/// * `jacobian` - out, two rows at each place
#[multiversion(targets("x86_64+avx2+fma"))]
pub fn cone_curvature<T: Real>(tables: &Tables<T>, x: &[T], residual: &mut [T], mut jacobian: Option<&mut [T]>) {
    let margin = tables.constants.force_margin;
    for node in &tables.cone_curvatures {
        let at = node.place.row as usize;
        residual[at..at + SPEC.rows].fill(T::zero());
        let Some(jacobian) = jacobian.as_deref_mut() else { continue };
        let force = node.force(x);
        let [n, tangent, _] = node.directions(tables, x, T::zero());
        let tangential = sub(force, scale(dot(n.unit, force), n.unit));
        let squared = dot(tangential, tangential);
        let size = (squared + margin * margin).sqrt();
        // Any direction does if there is no tangential force.
        let along = if squared > T::zero() { scale(T::one() / squared.sqrt(), tangential) } else { tangent.unit };
        let root = T::one() / size.sqrt();
        let across = scale(root, cross(n.unit, along));
        node.put_by_force(&mut Rows::new(jacobian, &node.place), &[across, scale(root * margin / size, along)]);
    }
}

#[cfg(test)]
mod tests {
    use super::super::cone;
    use crate::gait::Schedule;
    use crate::gait::cost::CostWeights;
    use crate::nlp::Problem;
    use crate::real::Real;
    use crate::robot::Robot;
    use crate::rows::RowKind;
    use crate::settings::{Friction, TranscriptionSettings};
    use crate::solver::objective::Objective;
    use crate::task::{Goal, Task};
    use crate::terrain::Terrain;
    use std::collections::BTreeSet;

    /// A quadruped that walks from level ground onto a slope, with cones of different feet and stances in every step of the sweep.
    fn problem<T: Real>() -> Problem<T> {
        let task = Task::new(Robot::named("anymal").unwrap(), Terrain::named("slope").unwrap(), Goal::at(2.2, 0.1)).unwrap();
        let pair = [vec![0.4, 0.2, 0.2, 0.2, 0.6], vec![0.6, 0.2, 0.2, 0.2, 0.4]];
        let schedule = Schedule::new(vec![pair[0].clone(), pair[1].clone(), pair[1].clone(), pair[0].clone()]).unwrap();
        let settings = TranscriptionSettings { friction: Some(Friction::Cone), ..TranscriptionSettings::default() };
        Problem::with_cost(&task, &schedule.aligned(0.1), &settings, Some(&CostWeights::default()))
    }

    #[test]
    fn the_square_of_the_jacobian_is_the_derivative_of_the_cone_gradient() {
        let problem = problem::<f64>();
        let jacobian = |x: &[f64], curvature: bool| {
            let mut jacobian = vec![0.; problem.jacobian_len];
            if curvature {
                let mut c = vec![f64::NAN; problem.rows.one_sided()];
                super::cone_curvature(&problem, x, &mut c, Some(&mut jacobian));
                let rows = problem.cone_curvatures.iter().map(|node| &c[node.place.row as usize..][..2]);
                assert!(rows.flatten().all(|c| *c == 0.));
            } else {
                cone::cone(&problem, x, 0., &mut vec![0.; problem.inequalities], Some(&mut jacobian));
            }
            jacobian
        };
        let margin = problem.constants.force_margin;
        let (mut sloped, mut without_tangential) = (0, 0);
        // Small and large forces, then vertical ones, which have no tangential part on level ground.
        for (size, vertical) in [(margin, false), (1., false), (1., true)] {
            let mut x = problem.initial.clone();
            for (i, node) in problem.cones.iter().enumerate() {
                for d in 0..6 {
                    let free = if vertical { f64::from(u8::from(d == 2)) } else { (1. + (7 * i + d) as f64).sin() };
                    x[node.node as usize + d] = size * free;
                }
            }
            let step = 1e-4 * margin;
            // Every cone depends on its own node only, so all are moved at once.
            let by: Vec<Vec<f64>> = (0..6)
                .map(|d| {
                    let side = |sign: f64| {
                        let mut x = x.clone();
                        let nodes: BTreeSet<usize> = problem.cones.iter().map(|node| node.node as usize).collect();
                        nodes.iter().for_each(|node| x[node + d] += sign * step);
                        jacobian(&x, false)
                    };
                    side(1.).iter().zip(side(-1.)).map(|(up, down)| (up - down) / (2. * step)).collect()
                })
                .collect();
            let root = jacobian(&x, true);
            for node in &problem.cone_curvatures {
                let cone = problem.cones.iter().find(|c| c.node == node.node && c.slope_weight == node.slope_weight).unwrap();
                let [normal, ..] = node.directions(&problem, &x, 0.);
                sloped += usize::from(normal.unit[2] < 0.99);
                without_tangential += usize::from(vertical && normal.unit[2] == 1.);
                let entry = |r: usize, d: usize| {
                    root[node.place.jacobian as usize + r * node.place.stride as usize + node.node_column as usize + d]
                };
                let square = |i: usize, j: usize| entry(0, i) * entry(0, j) + entry(1, i) * entry(1, j);
                let largest = (0..6).map(|d| square(d, d)).fold(0., f64::max);
                for (i, by) in by.iter().enumerate() {
                    for j in 0..6 {
                        let at = cone.place.jacobian as usize + cone.place.stride as usize + cone.node_column as usize + j;
                        let (got, expected) = (square(i, j), by[at]);
                        assert!((got - expected).abs() < 1e-6 * largest, "{node:?}, entry ({i}, {j}): {got} is not {expected}");
                    }
                }
            }
        }
        assert!(sloped > 0 && without_tangential > 0);
    }

    #[test]
    fn the_weight_is_the_multiplier_of_the_cone_of_the_same_force() {
        fn check<T: Real>() {
            let problem = problem::<T>();
            let multipliers: Vec<T> = (0..problem.inequalities).map(|i| T::of(0.5 + i as f64)).collect();
            let (mut weight, mut value) = (vec![T::zero(); problem.rows.all()], vec![T::one(); problem.rows.all()]);
            let c = vec![T::zero(); problem.rows.one_sided()];
            let objective = Objective { weight: T::of(0.02), rounding: T::of(0.01) };
            objective.rows(&problem, &c, &multipliers, &mut weight, &mut value);
            assert_eq!(problem.cone_curvatures.len(), problem.cones.len());
            for node in &problem.cone_curvatures {
                let mut same = problem.cones.iter().filter(|cone| cone.node == node.node && cone.slope_weight == node.slope_weight);
                let cone = same.next().unwrap();
                assert!(same.next().is_none() && cone.foothold == node.foothold);
                let expected = T::of(0.5 + f64::from(cone.place.inequality + 1));
                for row in node.place.row as usize..node.place.row as usize + 2 {
                    assert!(weight[row] == expected && value[row] == T::zero());
                }
            }
            // Without a cost all weights are zero.
            Objective::none().rows(&problem, &c, &multipliers, &mut weight, &mut value);
            assert!(weight[problem.rows.of(RowKind::Cost)].iter().all(|w| *w == T::zero()));
        }
        check::<f32>();
        check::<f64>();
    }
}
