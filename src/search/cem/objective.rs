//! What the search maximises.

use super::Evaluation;
use serde::{Deserialize, Serialize};

/// The term `f` of the objective `J = f - alpha N_vc`, maximised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Objective {
    /// `f = 0`: any feasible gait.
    Feasibility,
    /// `f = -(sum of the stance counts)`.
    FewestStances,
    /// `f = -(mean of |normal force| over all force nodes)`, N.
    LeastForce,
}

impl Objective {
    /// `J = f - alpha N_vc`; negative infinity, behind every finite value, when that is no number.
    ///
    /// * `stances` - stance phases of each foot
    /// * `penalty` - `alpha`, in the unit of `f` per violated constraint
    pub fn value(self, stances: &[usize], evaluation: &Evaluation, penalty: f64) -> f64 {
        let f = match self {
            Objective::Feasibility => 0.,
            Objective::FewestStances => -(stances.iter().sum::<usize>() as f64),
            Objective::LeastForce => -evaluation.mean_normal_force.abs(),
        };
        let j = f - penalty * evaluation.n_violated as f64;
        if j.is_nan() { f64::NEG_INFINITY } else { j }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objectives_are_penalised_by_violations() {
        let evaluation = Evaluation { n_violated: 3, feasible: false, mean_normal_force: 80. };
        assert_eq!(Objective::Feasibility.value(&[7, 8], &evaluation, 100.), -300.);
        assert_eq!(Objective::FewestStances.value(&[7, 8], &evaluation, 100.), -315.);
        assert_eq!(Objective::LeastForce.value(&[7, 8], &evaluation, 100.), -380.);
    }

    #[test]
    fn an_objective_that_is_no_number_is_behind_all_others() {
        let evaluation = Evaluation { n_violated: 0, feasible: true, mean_normal_force: f64::NAN };
        assert_eq!(Objective::LeastForce.value(&[7], &evaluation, 100.), f64::NEG_INFINITY);
        assert_eq!(Objective::Feasibility.value(&[7], &evaluation, 100.), 0.);
    }
}
