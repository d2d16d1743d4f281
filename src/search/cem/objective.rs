//! What the search maximises.

use super::Evaluation;
use crate::error::{Error, Result};
use crate::gait::cost::Cost;
use serde::{Deserialize, Serialize};

/// The term `f` of the objective `J = f - alpha N_vc`, maximised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Objective {
    /// `f = 0`: any feasible gait.
    Feasibility,
    /// `f = -(sum of the stance counts)`.
    FewestStances,
    /// `f = -(mean of |normal force| over all force nodes)`, N.
    LeastForce,
    /// `f = -(cost of transport)`, see [`crate::gait::cost`].
    Transport,
    /// `f = -horizon`, s.
    Time,
    /// `f = -(mean over time of sum |f|^2)`, squared weights.
    Effort,
}

/// Objectives by name, each with what it seeks.
pub const OBJECTIVES: [(&str, Objective); 6] = [
    ("transport", Objective::Transport),
    ("feasibility", Objective::Feasibility),
    ("fewest-stances", Objective::FewestStances),
    ("least-force", Objective::LeastForce),
    ("time", Objective::Time),
    ("effort", Objective::Effort),
];

impl Objective {
    /// An objective by name.
    ///
    /// # Errors
    /// [`Error::Unknown`] lists [`OBJECTIVES`].
    pub fn named(name: &str) -> Result<Objective> {
        let known = || OBJECTIVES.map(|(name, _)| name).join(", ");
        let found = OBJECTIVES.iter().find(|(n, _)| *n == name);
        found.map(|(_, objective)| *objective).ok_or_else(|| Error::Unknown { what: "objective", name: name.into(), known: known() })
    }

    /// `J = f - alpha N_vc`; negative infinity, behind every finite value, when that is no number.
    ///
    /// * `stances` - stance phases of each foot
    /// * `penalty` - `alpha`, in the unit of `f` per violated constraint
    ///
    /// Costs of motions that were not found are no costs: they count as one penalty more.
    pub fn value(self, stances: &[usize], evaluation: &Evaluation, penalty: f64) -> f64 {
        let of_cost = |part: fn(&Cost) -> f64| evaluation.cost.as_ref().map_or(-penalty, |cost| -part(cost));
        let f = match self {
            Objective::Transport => of_cost(|cost| cost.total),
            Objective::Time => of_cost(|cost| cost.horizon),
            Objective::Effort => of_cost(|cost| cost.effort),
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
        let evaluation = Evaluation { n_violated: 3, feasible: false, certified: true, mean_normal_force: 80., cost: None };
        assert_eq!(Objective::Feasibility.value(&[7, 8], &evaluation, 100.), -300.);
        assert_eq!(Objective::FewestStances.value(&[7, 8], &evaluation, 100.), -315.);
        assert_eq!(Objective::LeastForce.value(&[7, 8], &evaluation, 100.), -380.);
    }

    #[test]
    fn an_objective_that_is_no_number_is_behind_all_others() {
        let evaluation = Evaluation { n_violated: 0, feasible: true, certified: true, mean_normal_force: f64::NAN, cost: None };
        assert_eq!(Objective::LeastForce.value(&[7], &evaluation, 100.), f64::NEG_INFINITY);
        assert_eq!(Objective::Feasibility.value(&[7], &evaluation, 100.), 0.);
    }
}
