//! Rows of this solver as a program for a general solver: the feasibility problem of one candidate, soles included.
//!
//! In contrast to [`super::towr`], this formulation is not independent. Values and Jacobians are those of [`crate::rows`], so both solvers
//! see the same problem, and their verdicts and times compare the methods alone.

use super::ipopt;
use super::nlp::{INFINITY, Nlp, Options, Rows, Statistics, Variables};
use crate::error::Result;
use crate::gait::AlignedSchedule;
use crate::nlp::Problem;
use crate::rows::table::Run;
use crate::rows::{RowKind, Shared, residuals};
use crate::settings::TranscriptionSettings;
use crate::task::Task;

/// Rows of a candidate.
struct OwnRows {
    problem: Problem<f64>,
    columns: Vec<Vec<(Run, f64)>>,
    variables: Variables,
}

impl OwnRows {
    fn new(problem: Problem<f64>) -> OwnRows {
        let mut variables = Variables::default();
        problem.initial[..problem.variables].iter().for_each(|&x| {
            variables.free(x);
        });
        OwnRows { columns: problem.columns(), problem, variables }
    }

    /// Values of all variables and fixed values, as in [`Problem::initial`].
    fn whole(&self, x: &[f64]) -> Vec<f64> {
        x.iter().chain(&self.problem.initial[x.len()..]).copied().collect()
    }
}

impl Nlp for OwnRows {
    fn variables(&self) -> &Variables {
        &self.variables
    }

    fn rows(&self, x: &[f64], rows: &mut Rows) {
        let problem = &self.problem;
        let (mut shared, mut jacobian) = (Shared::default(), vec![0.; problem.jacobian_len]);
        shared.resize(problem);
        let (mut c, mut g) = (vec![0.; problem.rows.one_sided()], vec![0.; problem.inequalities]);
        residuals(problem, &self.whole(x), 0., &mut shared, &mut c, &mut g, Some(&mut jacobian));
        for (element, columns) in problem.all_elements().zip(&self.columns) {
            let (place, count) = (element.place, element.rows as usize);
            let (row, upper) = (place.row as usize, place.inequality as usize);
            for r in 0..count {
                match element.kind() {
                    RowKind::Cost => continue,
                    RowKind::Equality => rows.row(c[row + r], [0.; 2]),
                    // The lower side of a two-sided row is `-value - room <= 0`.
                    RowKind::Inequality => {
                        let value = g[upper + r];
                        let low = if r < element.pairs as usize { value + g[upper + count + r] } else { -INFINITY };
                        rows.row(value, [low, 0.]);
                    }
                }
                for (run, weight) in columns {
                    let first = place.jacobian as usize + r * place.stride as usize + run.column as usize;
                    for i in (0..run.len as usize).filter(|i| run.variable as usize + i < x.len()) {
                        rows.entry(run.variable as usize + i, weight * jacobian[first + i]);
                    }
                }
            }
        }
    }
}

/// Finds a motion that satisfies the `momentum` rows of a candidate. Returns the values of the variables, as in [`Problem::initial`], also
/// if Ipopt fails.
///
/// # Errors
/// [`crate::Error::Missing`] without Ipopt.
pub fn solve(
    task: &Task,
    schedule: &AlignedSchedule,
    settings: &TranscriptionSettings,
    options: &Options,
) -> Result<(Vec<f64>, Statistics)> {
    let program = OwnRows::new(Problem::new(task, schedule, settings));
    let (x, statistics) = ipopt::solve(&program, None, options)?;
    Ok((program.whole(&x), statistics))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gait::family::{GaitFamily, PeriodicGait};
    use crate::nlp::transcription::interval;
    use crate::robot::Robot;
    use crate::settings::Transcription;
    use crate::task::Goal;
    use crate::terrain::Terrain;

    #[test]
    fn derivatives_of_the_rows_of_a_humanoid_agree_with_differences() {
        let task = Task::new(Robot::named("humanoid").unwrap(), Terrain::flat(), Goal::at(0.4, 0.1)).unwrap();
        let settings = TranscriptionSettings::of(Transcription::Momentum);
        let schedule = PeriodicGait::typical(GaitFamily::Walk, &task).unwrap().schedule().unwrap();
        let program = OwnRows::new(Problem::new(&task, &schedule.aligned(interval(&settings, &task.robot)), &settings));
        let start = &program.variables.initial;
        let evaluated = |x: &[f64]| {
            let mut rows = Rows::default();
            program.rows(x, &mut rows);
            rows
        };
        let x: Vec<f64> = start.iter().enumerate().map(|(i, x)| x + 0.01 * (i as f64).sin()).collect();
        let here = evaluated(&x);
        let counts = program.problem.rows;
        assert_eq!(here.values.len(), (counts.equalities + counts.inequalities) as usize);
        let d = 1e-6;
        let mut checked = 0;
        for variable in (0..x.len()).step_by(7) {
            let moved =
                |by: f64| evaluated(&x.iter().enumerate().map(|(i, x)| if i == variable { x + by } else { *x }).collect::<Vec<_>>());
            let (after, before) = (moved(d), moved(-d));
            let mut derivatives = vec![0.; here.values.len()];
            here.entries.iter().filter(|e| e.1 as usize == variable).for_each(|e| derivatives[e.0 as usize] += e.2);
            for (row, derivative) in derivatives.iter().enumerate() {
                let difference = (after.values[row] - before.values[row]) / (2. * d);
                // Reach and angular momentum take the deviation of the base from its cubic as constant.
                assert!((difference - derivative).abs() < 0.05 * (1. + difference.abs()), "row {row}: {derivative}, but {difference}");
                checked += usize::from(*derivative != 0.);
                // The width of a two-sided row is constant.
                assert!((after.limits[row][0] - here.limits[row][0]).abs() < 1e-9 || here.limits[row][0] == -INFINITY);
            }
        }
        assert!(checked > 500, "{checked}");
    }
}
